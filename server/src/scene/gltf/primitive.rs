//! Mesh primitives to triangles.

use super::super::untrusted::{MAX_TRIANGLES, check_limit};
use super::super::{Mesh, SceneError};
use super::Source;
use super::unsupported::Unsupported;
use glam::{Vec2, Vec3};
use gltf::mesh::Mode;
use gltf::{Primitive, Semantic};

/// One primitive with material `material` and the texture coordinates of set `uv_set`; `None` where it has
/// no triangles. Where the file has no normals they are zero, which means flat.
pub(super) fn triangles(
    source: &Source,
    primitive: &Primitive,
    material: u32,
    uv_set: u32,
    user: &str,
    unsupported: &mut Unsupported,
) -> Result<Option<Mesh>, SceneError> {
    if matches!(primitive.mode(), Mode::Points | Mode::Lines | Mode::LineLoop | Mode::LineStrip) {
        unsupported.note("points and lines are left out", user);
        return Ok(None);
    }
    if primitive.morph_targets().len() > 0 {
        unsupported.note("morph targets are left out", user);
    }
    if let Some(accessor) = primitive.get(&Semantic::Colors(0)) {
        // White ones, which exporters like to write, say nothing.
        let is_white = match accessor.dimensions().multiplicity() {
            3 => source.vectors::<3>(&accessor)?.iter().flatten().all(|&channel| channel == 1.0),
            _ => source.vectors::<4>(&accessor)?.iter().flatten().all(|&channel| channel == 1.0),
        };
        if !is_white {
            unsupported.note("vertex colours are left out", user);
        }
    }
    let Some(accessor) = primitive.get(&Semantic::Positions) else {
        unsupported.note("meshes without positions are left out", user);
        return Ok(None);
    };
    let positions: Vec<Vec3> = source.vectors::<3>(&accessor)?.into_iter().map(Vec3::from_array).collect();
    let count = positions.len();
    let same_count = |found: usize, what: &str| {
        let reason = || format!("mesh '{}': {count} positions but {found} {what}", user.escape_debug());
        if found == count { Ok(()) } else { Err(source.malformed(reason())) }
    };
    let normals = match primitive.get(&Semantic::Normals) {
        Some(accessor) => source.vectors::<3>(&accessor)?.into_iter().map(unit_or_zero).collect(),
        None => vec![Vec3::ZERO; count],
    };
    same_count(normals.len(), "normals")?;
    let uvs = match primitive.get(&Semantic::TexCoords(uv_set)) {
        Some(accessor) => source.vectors::<2>(&accessor)?.into_iter().map(finite_or_zero).collect(),
        None => vec![Vec2::ZERO; count],
    };
    same_count(uvs.len(), "texture coordinates")?;

    let indices = match primitive.indices() {
        Some(accessor) => source.indices(&accessor)?,
        None => (0..count as u32).collect(),
    };
    if let Some(index) = indices.iter().find(|&&index| index as usize >= count) {
        let reason = format!("mesh '{}': index {index} with {count} vertices", user.escape_debug());
        return Err(source.malformed(reason));
    }
    let triangles = assemble(primitive.mode(), &indices);
    check_limit(&source.file, "triangles", MAX_TRIANGLES, triangles.len() as u64)?;
    let materials = vec![material; triangles.len()];
    Ok(Some(Mesh { positions, normals, uvs, triangles, materials }))
}

/// Lists, strips and fans; in a strip every second triangle is turned so that all face the same way.
fn assemble(mode: Mode, indices: &[u32]) -> Vec<[u32; 3]> {
    match mode {
        Mode::Triangles => indices.chunks_exact(3).map(|corner| [corner[0], corner[1], corner[2]]).collect(),
        Mode::TriangleStrip => {
            let turned = |(index, corner): (usize, &[u32])| {
                if index % 2 == 0 { [corner[0], corner[1], corner[2]] } else { [corner[0], corner[2], corner[1]] }
            };
            indices.windows(3).enumerate().map(turned).collect()
        }
        Mode::TriangleFan => match indices.split_first() {
            Some((&first, rest)) => rest.windows(2).map(|corner| [first, corner[0], corner[1]]).collect(),
            None => Vec::new(),
        },
        Mode::Points | Mode::Lines | Mode::LineLoop | Mode::LineStrip => Vec::new(),
    }
}

fn unit_or_zero(normal: [f32; 3]) -> Vec3 {
    Vec3::from_array(normal).normalize_or_zero()
}

fn finite_or_zero(uv: [f32; 2]) -> Vec2 {
    let uv = Vec2::from_array(uv);
    if uv.is_finite() { uv } else { Vec2::ZERO }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strips_and_fans_face_one_way() {
        assert_eq!(assemble(Mode::TriangleStrip, &[0, 1, 2, 3]), [[0, 1, 2], [1, 3, 2]]);
        assert_eq!(assemble(Mode::TriangleFan, &[0, 1, 2, 3]), [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(assemble(Mode::Triangles, &[0, 1, 2, 3]), [[0, 1, 2]]);
        assert!(assemble(Mode::TriangleFan, &[]).is_empty());
    }
}
