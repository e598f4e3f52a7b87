//! Wavefront OBJ models: vertices, texture coordinates, normals, polygons, groups of one material.
//!
//! A vertex of ours is a distinct triple of position, texture coordinates and normal; polygons become fans about
//! their first corner, which is right where they are convex. Positions are read in f64 and counted from an origin
//! of the model's own where it lies far away. In the file v runs upwards, here downwards: it is turned over.
//! Materials come from the .mtl files that the model names ([`super::mtl`]) and that lie beside it; what cannot be
//! read there is a warning, not an error. Left out: points, lines, free-form curves and surfaces. Cost: one pass,
//! a hash lookup per corner.

use super::part::{bounds, origin_for};
use super::untrusted::{MAX_FILE_BYTES, MAX_ITEMS, MAX_TRIANGLES, MAX_VERTICES, check_limit, read_file};
use super::{Color, Material, Mesh, Part, SceneError, Surface, mtl};
use glam::{DAffine3, DVec3, Vec2, Vec3};
use std::borrow::Cow;
use std::collections::HashMap;
use std::path::Path;

/// What an OBJ file says about shapes.
#[derive(Debug, Default)]
pub(super) struct Model {
    /// What positions are counted from.
    pub(super) origin: DVec3,
    pub(super) mesh: Mesh,
    /// Names that `mesh.materials` counts; the first, without a name, is for what has none.
    pub(super) materials: Vec<String>,
    /// Names of the files with materials.
    pub(super) libraries: Vec<String>,
    /// What is left out.
    pub(super) left_out: Vec<&'static str>,
}

/// Reads a model with its materials.
pub(super) fn load(path: &Path) -> Result<Part, SceneError> {
    let file = path.display().to_string();
    let model = parse(&file, &read_file(path, MAX_FILE_BYTES)?)?;
    let mut part = Part::default();
    mtl::read(path, &model, &mut part)?;
    part.place(&model.mesh, &DAffine3::from_translation(model.origin), &file, |index| index)?;
    part.warnings.extend(model.left_out.iter().map(|what| format!("{file}: {what} are left out")));
    Ok(part)
}

/// What a surface is made of that has no material: Lambert reflection of one half.
pub(super) fn plain_material() -> Material {
    Material::new("default", Surface::Diffuse { albedo: Color::Constant(Vec3::splat(0.5)) })
}

/// Reads the text of a model; `file` names it in messages.
pub(super) fn parse(file: &str, bytes: &[u8]) -> Result<Model, SceneError> {
    let text = String::from_utf8_lossy(bytes);
    let mut reader = Reader { file, materials: vec![String::new()], ..Reader::default() };
    let mut lines = text.lines().enumerate();
    while let Some((index, line)) = lines.next() {
        reader.line = index + 1;
        let mut line = Cow::Borrowed(line);
        while line.ends_with('\\') {
            let next = lines.next().map_or("", |(_, next)| next);
            let joined = format!("{} {next}", line.trim_end_matches('\\'));
            check_limit(file, "bytes of a line", MAX_LINE_BYTES, joined.len() as u64)?;
            line = Cow::Owned(joined);
        }
        reader.statement(&line)?;
    }
    reader.finish()
}

/// Longest line that is put together from several: a polygon of ten thousand corners.
const MAX_LINE_BYTES: u64 = 1 << 20;

#[derive(Default)]
struct Reader<'a> {
    file: &'a str,
    line: usize,
    positions: Vec<DVec3>,
    uvs: Vec<Vec2>,
    normals: Vec<Vec3>,
    /// Our vertex by position, texture coordinates and normal, each counted from 1; 0 where there is none.
    vertices: HashMap<[u32; 3], u32>,
    corners: Vec<[u32; 3]>,
    triangles: Vec<[u32; 3]>,
    triangle_materials: Vec<u32>,
    materials: Vec<String>,
    material: u32,
    libraries: Vec<String>,
    left_out: Vec<&'static str>,
    polygon: Vec<u32>,
}

impl Reader<'_> {
    fn error(&self, expected: &str, found: &str) -> SceneError {
        let found: String = found.chars().take(40).collect();
        SceneError::Malformed {
            file: self.file.to_owned(),
            reason: format!("line {}: expected {expected}, found '{}'", self.line, found.escape_debug()),
        }
    }

    fn statement(&mut self, line: &str) -> Result<(), SceneError> {
        let line = line.trim();
        let (keyword, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        match keyword {
            "v" => {
                let [x, y, z] = self.numbers(rest, 3, "three numbers")?;
                check_limit(self.file, "vertices", MAX_VERTICES, self.positions.len() as u64 + 1)?;
                self.positions.push(DVec3::new(x, y, z));
            }
            "vt" => {
                let [u, v, _] = self.numbers(rest, 1, "one to three numbers")?;
                check_limit(self.file, "texture coordinates", MAX_VERTICES, self.uvs.len() as u64 + 1)?;
                self.uvs.push(Vec2::new(u as f32, (1.0 - v) as f32));
            }
            "vn" => {
                let [x, y, z] = self.numbers(rest, 3, "three numbers")?;
                check_limit(self.file, "normals", MAX_VERTICES, self.normals.len() as u64 + 1)?;
                self.normals.push(DVec3::new(x, y, z).normalize_or_zero().as_vec3());
            }
            "f" | "fo" => self.face(rest)?,
            "usemtl" => self.material = self.material_named(rest.trim())?,
            "mtllib" => {
                check_limit(self.file, "material files", MAX_LIBRARIES, self.libraries.len() as u64 + 1)?;
                self.libraries.push(rest.trim().to_owned());
            }
            "p" => self.leave_out("points"),
            "l" => self.leave_out("lines"),
            "vp" | "curv" | "curv2" | "surf" => self.leave_out("free-form curves and surfaces"),
            // Comments, groups, smoothing groups, display attributes: nothing that changes the shape.
            _ => {}
        }
        Ok(())
    }

    fn leave_out(&mut self, what: &'static str) {
        if !self.left_out.contains(&what) {
            self.left_out.push(what);
        }
    }

    /// At least `least` finite numbers; those beyond three are ignored, missing ones are 0.
    fn numbers(&self, text: &str, least: usize, expected: &str) -> Result<[f64; 3], SceneError> {
        let mut numbers = [0.0; 3];
        let mut count = 0;
        for (number, word) in numbers.iter_mut().zip(text.split_whitespace()) {
            let parsed: Option<f64> = word.parse().ok().filter(|value: &f64| value.is_finite());
            *number = parsed.ok_or_else(|| self.error(expected, text))?;
            count += 1;
        }
        if count < least { Err(self.error(expected, text)) } else { Ok(numbers) }
    }

    fn material_named(&mut self, name: &str) -> Result<u32, SceneError> {
        let known = self.materials.iter().position(|known| known == name);
        if known.is_none() {
            check_limit(self.file, "materials", MAX_ITEMS.min(MAX_MATERIALS), self.materials.len() as u64 + 1)?;
            self.materials.push(name.to_owned());
        }
        Ok(known.unwrap_or(self.materials.len() - 1) as u32)
    }

    fn face(&mut self, text: &str) -> Result<(), SceneError> {
        const EXPECTED: &str = "three or more corners such as 1/2/3, 1//3 or -1 of vertices that are above";
        let mut polygon = std::mem::take(&mut self.polygon);
        polygon.clear();
        for word in text.split_whitespace() {
            let key = self.corner(word).ok_or_else(|| self.error(EXPECTED, word))?;
            let next = self.corners.len() as u32;
            let vertex = *self.vertices.entry(key).or_insert(next);
            if vertex == next {
                check_limit(self.file, "vertices", MAX_VERTICES, u64::from(next) + 1)?;
                self.corners.push(key);
            }
            polygon.push(vertex);
        }
        if polygon.len() < 3 {
            return Err(self.error(EXPECTED, text));
        }
        check_limit(self.file, "triangles", MAX_TRIANGLES, (self.triangles.len() + polygon.len() - 2) as u64)?;
        for pair in polygon[1..].windows(2) {
            self.triangles.push([polygon[0], pair[0], pair[1]]);
            self.triangle_materials.push(self.material);
        }
        self.polygon = polygon;
        Ok(())
    }

    /// Position, texture coordinates and normal of a corner, counted from 1, negative numbers from the last one.
    fn corner(&self, word: &str) -> Option<[u32; 3]> {
        let counts = [self.positions.len(), self.uvs.len(), self.normals.len()];
        let mut key = [0; 3];
        let mut parts = word.split('/');
        for (index, (slot, count)) in key.iter_mut().zip(counts).enumerate() {
            let Some(part) = parts.next().filter(|part| !part.is_empty()) else {
                if index == 0 {
                    return None;
                }
                continue;
            };
            let number: i64 = part.parse().ok()?;
            let from_one = if number < 0 { (count as i64).checked_add(number)?.checked_add(1)? } else { number };
            if from_one < 1 || from_one > count as i64 {
                return None;
            }
            *slot = from_one as u32;
        }
        parts.next().is_none().then_some(key)
    }

    fn finish(self) -> Result<Model, SceneError> {
        let used = self.corners.iter().map(|key| self.positions[key[0] as usize - 1]);
        let origin = bounds(used.clone()).map_or(DVec3::ZERO, |(low, high)| origin_for(low, high));
        let at = |index: u32| (index as usize).checked_sub(1);
        let mesh = Mesh {
            positions: used.map(|position| (position - origin).as_vec3()).collect(),
            uvs: self.corners.iter().map(|key| at(key[1]).map_or(Vec2::ZERO, |index| self.uvs[index])).collect(),
            normals: self.corners.iter().map(|key| at(key[2]).map_or(Vec3::ZERO, |i| self.normals[i])).collect(),
            triangles: self.triangles,
            materials: self.triangle_materials,
        };
        let (materials, libraries, left_out) = (self.materials, self.libraries, self.left_out);
        Ok(Model { origin, mesh, materials, libraries, left_out })
    }
}

/// Most materials of a model: each switch searches their names.
const MAX_MATERIALS: u64 = 10_000;
/// Most files with materials of a model.
const MAX_LIBRARIES: u64 = 64;

#[cfg(test)]
mod tests {
    use super::*;

    fn model(text: &str) -> Model {
        parse("a.obj", text.as_bytes()).unwrap()
    }

    const SQUARE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 1\nvn 0 0 2\nvn 1 0 0\n";

    #[test]
    fn polygons_become_fans_and_keep_their_winding() {
        let square = model(&format!("{SQUARE}f 1 2 3 4\n"));
        assert_eq!(square.mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
        let area: f32 = square
            .mesh
            .triangles
            .iter()
            .map(|triangle| {
                let [a, b, c] = triangle.map(|index| square.mesh.positions[index as usize]);
                (b - a).cross(c - a).z / 2.0
            })
            .sum();
        assert_eq!(area, 1.0);
        assert_eq!(square.mesh.normals, [Vec3::ZERO; 4]);
    }

    #[test]
    fn vertices_are_shared_only_where_normal_and_texture_are_the_same() {
        let mesh = model(&format!("{SQUARE}f 1/1/1 2/2/1 3//1\nf 1/1/1 3//2 4\n")).mesh;
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 3, 4]]);
        assert_eq!((mesh.normals[2], mesh.normals[3], mesh.normals[4]), (Vec3::Z, Vec3::X, Vec3::ZERO));
        assert_eq!((mesh.uvs[0], mesh.uvs[1]), (Vec2::new(0.0, 1.0), Vec2::new(1.0, 0.0)), "v runs downwards here");
    }

    #[test]
    fn negative_numbers_count_from_the_last() {
        let mesh = model("v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 5 5 5\nf 1 2 -1\n").mesh;
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 1, 3]]);
        assert_eq!(mesh.positions[3], Vec3::splat(5.0));
    }

    #[test]
    fn materials_belong_to_what_follows_them() {
        let model = model(&format!(
            "mtllib a b.mtl\n{SQUARE}f 1 2 3\nusemtl red paint\nf 1 2 3\nusemtl blue\nf 2 3 4\nusemtl red paint\nf 1 2 4\n"
        ));
        assert_eq!(model.materials, ["", "red paint", "blue"]);
        assert_eq!(model.mesh.materials, [0, 1, 2, 1]);
        assert_eq!(model.libraries, ["a b.mtl"]);
    }

    #[test]
    fn positions_far_away_keep_their_digits() {
        let text =
            "v 500000.125 4000000.25 10.5\nv 500001.125 4000000.25 10.5\nv 500000.125 4000001.25 10.5\nf 1 2 3\n";
        let model = model(text);
        let back = model.origin + model.mesh.positions[0].as_dvec3();
        assert_eq!(back, DVec3::new(500_000.125, 4_000_000.25, 10.5));
    }

    #[test]
    fn what_is_no_obj_is_one_line_that_names_it() {
        for (text, part) in [
            ("v 1 2", "line 1: expected three numbers, found '1 2'"),
            ("v 1 2 nan", "three numbers"),
            ("v 1 2 1e999", "three numbers"),
            ("v 0 0 0\nf 1 1 2", "line 2: expected three or more corners"),
            ("v 0 0 0\nf 1 1", "corners"),
            ("v 0 0 0\nf 0 1 1", "corners"),
            ("v 0 0 0\nf 1 1 -2", "corners"),
            ("v 0 0 0\nf 1/1 1 1", "corners"),
            ("v 0 0 0\nf 1/////// 1 1", "corners"),
            ("v 0 0 0\nf 99999999999999999999 1 1", "corners"),
            ("v 0 0 0\nf -9223372036854775808 1 1", "corners"),
        ] {
            let line = parse("a.obj", text.as_bytes()).unwrap_err().to_string();
            assert!(line.starts_with("a.obj: ") && line.contains(part) && !line.contains('\n'), "{line}");
        }
        for harmless in ["", "\u{0}\u{1}", "# f 1", "g a\no b\ns 1\n", "v 1 2 3\\\n", "v 1 \\\n2 3\n", "vt 1"] {
            assert!(parse("a.obj", harmless.as_bytes()).is_ok(), "{harmless}");
        }
        assert!(parse("a.obj", &[0xff, 0xfe, b'\n', b'v']).is_err());
        assert_eq!(model("p 1\nl 1 2\nl 2 3\n").left_out, ["points", "lines"]);
    }
}
