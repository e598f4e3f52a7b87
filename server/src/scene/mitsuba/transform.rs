//! Transforms: `<translate>`, `<rotate>`, `<scale>`, `<lookat>` and `<matrix>`, each applied after those before it.
//!
//! Mitsuba's `<lookat>` has its own +Z run to the target and +X to the left. Formed in f64, so that a chain of them
//! loses nothing.

use super::super::SceneError;
use super::node::Node;
use glam::{Affine2, DAffine3, DMat3, DQuat, DVec2, DVec3, Mat2};

/// The transform of a `<transform>` element.
pub(super) fn read(node: &Node) -> Result<DAffine3, SceneError> {
    let mut whole = DAffine3::IDENTITY;
    for child in &node.children {
        whole = step(child)? * whole;
    }
    let is_usable = whole.is_finite() && whole.matrix3.determinant() != 0.0;
    if is_usable { Ok(whole) } else { Err(node.error("a transform that can be undone", "one that flattens space")) }
}

/// The part of a transform that acts on texture coordinates. `<matrix>` may be 3 by 3; of larger ones the upper
/// left corner counts, as in Mitsuba.
pub(super) fn read_uv(node: &Node) -> Result<Affine2, SceneError> {
    let mut whole = glam::DAffine2::IDENTITY;
    for child in &node.children {
        let numbers = matrix_numbers(child)?;
        let step = match (child.tag, numbers.as_deref()) {
            // Mitsuba cuts a 4 by 4 matrix to 3 by 3: its third column is the translation of texture coordinates.
            ("matrix", Some(&[a, b, tx, c, d, ty, _, _, _] | &[a, b, tx, _, c, d, ty, ..])) => {
                glam::DAffine2::from_cols(DVec2::new(a, c), DVec2::new(b, d), DVec2::new(tx, ty))
            }
            _ => {
                let DAffine3 { matrix3, translation } = step(child)?;
                glam::DAffine2 {
                    matrix2: glam::DMat2::from_cols(matrix3.x_axis.truncate(), matrix3.y_axis.truncate()),
                    translation: translation.truncate(),
                }
            }
        };
        whole = step * whole;
    }
    let matrix2: Mat2 = whole.matrix2.as_mat2();
    Ok(Affine2 { matrix2, translation: whole.translation.as_vec2() })
}

fn matrix_numbers(node: &Node) -> Result<Option<Vec<f64>>, SceneError> {
    if node.tag != "matrix" {
        return Ok(None);
    }
    let text = node.required("value")?;
    let numbers = node.numbers(text)?;
    match numbers.len() {
        9 | 16 => Ok(Some(numbers)),
        _ => Err(node.value_error("9 or 16 numbers", text)),
    }
}

fn step(node: &Node) -> Result<DAffine3, SceneError> {
    match node.tag {
        "translate" => Ok(DAffine3::from_translation(node.triple("value", 0.0)?)),
        "scale" => Ok(DAffine3::from_scale(node.triple("value", 1.0)?)),
        "rotate" => {
            let axis = node.triple("value", 0.0)?;
            let angle_deg = node.number(node.required("angle")?)?;
            let axis = axis.try_normalize().ok_or_else(|| node.error("an axis", "0"))?;
            Ok(DAffine3::from_quat(DQuat::from_axis_angle(axis, angle_deg.to_radians())))
        }
        "lookat" => lookat(node),
        "matrix" => {
            let numbers = matrix_numbers(node)?.unwrap_or_default();
            let at = |row: usize, column: usize| numbers[row * if numbers.len() == 16 { 4 } else { 3 } + column];
            let column = |column: usize| DVec3::new(at(0, column), at(1, column), at(2, column));
            let matrix3 = DMat3::from_cols(column(0), column(1), column(2));
            let translation = if numbers.len() == 16 { column(3) } else { DVec3::ZERO };
            if numbers.len() == 16 && numbers[12..] != [0.0, 0.0, 0.0, 1.0] {
                return Err(node.error("a last row of 0 0 0 1", format_args!("{:?}", &numbers[12..])));
            }
            Ok(DAffine3 { matrix3, translation })
        }
        other => Err(node.error("<translate>, <rotate>, <scale>, <lookat> or <matrix>", format_args!("<{other}>"))),
    }
}

fn lookat(node: &Node) -> Result<DAffine3, SceneError> {
    let point = |name: &str| node.required(name).and_then(|_| node.triple(name, 0.0));
    let (origin, target) = (point("origin")?, point("target")?);
    let forward = (target - origin)
        .try_normalize()
        .ok_or_else(|| node.error("a target away from the origin", "the origin itself"))?;
    let up = if node.attribute("up").is_some() { point("up")? } else { DVec3::ZERO };
    let left = match up.cross(forward).try_normalize() {
        Some(left) => left,
        None if up == DVec3::ZERO => forward.any_orthonormal_vector(),
        None => return Err(node.error("an up that is not along the view", "one that is")),
    };
    Ok(DAffine3 { matrix3: DMat3::from_cols(left, forward.cross(left), forward), translation: origin })
}

#[cfg(test)]
mod tests {
    use super::super::xml::Tree;
    use super::*;
    use glam::Vec2;
    use std::path::Path;

    fn parse<T>(steps: &str, read: impl Fn(&Node) -> Result<T, SceneError>) -> Result<T, String> {
        let text = format!("<scene version='3.0.0'><transform name='to_world'>{steps}</transform></scene>");
        let tree = Tree::from_text(Path::new("x.xml"), &text).map_err(|error| error.to_string())?;
        read(&tree.root.children[0]).map_err(|error| error.to_string())
    }

    fn moved(steps: &str, point: DVec3) -> DVec3 {
        parse(steps, read).unwrap().transform_point3(point)
    }

    #[test]
    fn steps_are_applied_in_their_order() {
        let steps = "<scale value='2'/><rotate z='1' angle='90'/><translate x='10' y='1'/>";
        assert!((moved(steps, DVec3::X) - DVec3::new(10.0, 3.0, 0.0)).length() < 1e-12);
        assert!((moved("<scale x='2' z='3'/>", DVec3::ONE) - DVec3::new(2.0, 1.0, 3.0)).length() < 1e-12);
        assert!((moved("<rotate value='0, 0, 2' angle='-90'/>", DVec3::X) - DVec3::NEG_Y).length() < 1e-12);
        assert_eq!(moved("<matrix value='0 -1 0 5  1 0 0 6  0 0 1 7  0 0 0 1'/>", DVec3::X), DVec3::new(5.0, 7.0, 7.0));
        assert_eq!(moved("<matrix value='0 -1 0 1 0 0 0 0 1'/>", DVec3::X), DVec3::Y);
    }

    #[test]
    fn lookat_has_its_z_to_the_target_and_its_x_to_the_left() {
        let steps = "<lookat origin='1, 2, 3' target='1, 2, 8' up='0, 1, 0'/>";
        assert!((moved(steps, DVec3::Z) - DVec3::new(1.0, 2.0, 4.0)).length() < 1e-12);
        // Looking along +Z with +Y up, the left hand points along +X.
        assert!((moved(steps, DVec3::X) - DVec3::new(2.0, 2.0, 3.0)).length() < 1e-12);
    }

    #[test]
    fn texture_coordinates_take_the_corner_of_a_matrix() {
        let uv = |steps: &str| parse(steps, read_uv).unwrap().transform_point2(Vec2::new(1.0, 2.0));
        assert_eq!(uv("<scale x='3' y='-1'/><translate x='1'/>"), Vec2::new(4.0, -2.0));
        assert_eq!(uv("<matrix value='16 0 0 0 0 8 0 0 0 0 16 0 0 0 0 1'/>"), Vec2::new(16.0, 16.0));
        assert_eq!(uv("<matrix value='1 0 5 0 1 6 0 0 1'/>"), Vec2::new(6.0, 8.0));
    }

    #[test]
    fn what_is_no_transform_is_named() {
        for (steps, part) in [
            ("<rotate angle='3'/>", "<rotate>: expected an axis, found 0"),
            ("<rotate x='1'/>", "attribute 'angle'"),
            ("<scale value='0'/>", "<transform> 'to_world': expected a transform that can be undone"),
            ("<scale value='1 2'/>", "one or three numbers, found '1 2'"),
            ("<translate x='nan'/>", "a number, found 'nan'"),
            ("<translate x='1e300'/>", "a number"),
            ("<matrix value='1 2 3'/>", "9 or 16 numbers"),
            ("<lookat origin='0 0 0' target='0 0 0' up='0 1 0'/>", "away from the origin"),
            ("<lookat origin='0 0 0' target='0 1 0' up='0 1 0'/>", "not along the view"),
            ("<float value='1'/>", "found <float>"),
        ] {
            let line = parse(steps, read).unwrap_err();
            assert!(line.starts_with("x.xml: line 1, column ") && line.contains(part), "{line} / {part}");
        }
    }
}
