//! PLY models (Turk 1994): ascii, binary little-endian and big-endian.
//!
//! Read are the elements `vertex` (x, y, z; nx, ny, nz; u, v or s, t or texture_u, texture_v) and `face`
//! (vertex_indices or vertex_index); all others are skipped. Polygons become fans about their first corner.
//! Positions are read in f64 and counted from an origin of the model's own where it lies far away. Texture
//! coordinates stand as in the file: as a model of ours v is turned over, since programs that write PLY have it run
//! upwards; Mitsuba takes it as it is. Vertex colours are left out, with a warning. Limits: a count in the header
//! never sizes an allocation that the rest of the file could not fill.

use super::obj::plain_material;
use super::part::{bounds, origin_for};
use super::untrusted::{MAX_FILE_BYTES, MAX_TRIANGLES, MAX_VERTICES, check_limit, read_file};
use super::{Mesh, Part, SceneError};
use glam::{DAffine3, DVec3, Vec2};
use std::path::Path;

/// What a PLY file says about shapes; `mesh.materials` is 0 throughout.
#[derive(Debug, Default)]
pub(super) struct Model {
    /// What positions are counted from.
    pub(super) origin: DVec3,
    pub(super) mesh: Mesh,
    pub(super) has_colors: bool,
}

/// Reads a model of ours.
pub(super) fn load(path: &Path) -> Result<Part, SceneError> {
    let file = path.display().to_string();
    let mut model = parse(&file, &read_file(path, MAX_FILE_BYTES)?)?;
    model.mesh.uvs.iter_mut().for_each(|uv| uv.y = 1.0 - uv.y);
    let mut part = Part::default();
    part.materials.push(plain_material());
    part.place(&model.mesh, &DAffine3::from_translation(model.origin), &file, |index| index)?;
    if model.has_colors {
        part.warnings.push(format!("{file}: vertex colours are left out"));
    }
    Ok(part)
}

/// Reads a file; `file` names it in messages.
pub(super) fn parse(file: &str, bytes: &[u8]) -> Result<Model, SceneError> {
    let malformed = |reason: String| SceneError::Malformed { file: file.to_owned(), reason };
    let (header, body) = Header::read(bytes).map_err(malformed)?;
    let mut values = Values { format: header.format, rest: body };
    let (mut vertices, mut faces) = (Vertices::default(), Faces::default());
    for element in &header.elements {
        let limit = if element.name == "face" { MAX_TRIANGLES } else { MAX_VERTICES };
        check_limit(file, "elements", limit, element.count)?;
        let truncated =
            |index: u64| malformed(format!("{} {index}: expected more numbers, the file ends", element.name));
        match element.name.as_str() {
            "vertex" => {
                let slots: Vec<usize> = element.properties.iter().map(|property| vertex_slot(&property.name)).collect();
                vertices.has_colors |= element.properties.iter().any(|p| p.name == "red" || p.name == "diffuse_red");
                if ["x", "y", "z"].iter().any(|&axis| !element.properties.iter().any(|p| p.name == axis)) {
                    return Err(malformed("vertex: expected the properties x, y and z".to_owned()));
                }
                for index in 0..element.count {
                    let mut row = [0.0; SLOTS];
                    for (property, &slot) in element.properties.iter().zip(&slots) {
                        match property.list_count {
                            None => row[slot] = values.number(property.number).ok_or_else(|| truncated(index))?,
                            Some(_) => values.list(property, |_| ()).ok_or_else(|| truncated(index))?,
                        }
                    }
                    vertices.push(&row);
                }
            }
            "face" => {
                let is_corners = |name: &str| name == "vertex_indices" || name == "vertex_index";
                if element.count > 0 && !element.properties.iter().any(|property| is_corners(&property.name)) {
                    return Err(malformed("face: expected the list vertex_indices".to_owned()));
                }
                for index in 0..element.count {
                    for property in &element.properties {
                        match property.list_count {
                            Some(_) if is_corners(&property.name) => {
                                faces.polygon.clear();
                                values
                                    .list(property, |corner| faces.polygon.push(corner))
                                    .ok_or_else(|| truncated(index))?;
                                faces.fan(file, index)?;
                            }
                            Some(_) => values.list(property, |_| ()).ok_or_else(|| truncated(index))?,
                            None => drop(values.number(property.number).ok_or_else(|| truncated(index))?),
                        }
                    }
                }
            }
            other => {
                if other == "tristrips" {
                    return Err(SceneError::Unsupported {
                        file: file.to_owned(),
                        feature: "PLY with tristrips".to_owned(),
                    });
                }
                // An element without properties takes no bytes: nothing to skip.
                let count = if element.properties.is_empty() { 0 } else { element.count };
                for index in 0..count {
                    for property in &element.properties {
                        let read = match property.list_count {
                            Some(_) => values.list(property, |_| ()),
                            None => values.number(property.number).map(drop),
                        };
                        read.ok_or_else(|| truncated(index))?;
                    }
                }
            }
        }
    }
    assemble(file, vertices, faces)
}

fn assemble(file: &str, vertices: Vertices, faces: Faces) -> Result<Model, SceneError> {
    let malformed = |reason: String| SceneError::Malformed { file: file.to_owned(), reason };
    let count = vertices.positions.len();
    if let Some(bad) = vertices.positions.iter().position(|position| !position.is_finite()) {
        return Err(malformed(format!("vertex {bad}: expected finite coordinates")));
    }
    let mut triangles = Vec::with_capacity(faces.triangles.len());
    for (triangle, face) in faces.triangles.iter().zip(&faces.face_of_triangle) {
        let index = |corner: f64| (corner >= 0.0 && corner < count as f64).then_some(corner as u32);
        let [Some(a), Some(b), Some(c)] = triangle.map(index) else {
            return Err(malformed(format!("face {face}: expected the numbers of {count} vertices")));
        };
        triangles.push([a, b, c]);
    }
    let origin = bounds(vertices.positions.iter().copied()).map_or(DVec3::ZERO, |(low, high)| origin_for(low, high));
    let mesh = Mesh {
        positions: vertices.positions.iter().map(|&position| (position - origin).as_vec3()).collect(),
        normals: vertices.normals.iter().map(|normal| normal.normalize_or_zero().as_vec3()).collect(),
        uvs: vertices.uvs,
        materials: vec![0; triangles.len()],
        triangles,
    };
    Ok(Model { origin, mesh, has_colors: vertices.has_colors })
}

/// Types of numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Number {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Number {
    fn named(name: &str) -> Option<Number> {
        Some(match name {
            "char" | "int8" => Number::I8,
            "uchar" | "uint8" => Number::U8,
            "short" | "int16" => Number::I16,
            "ushort" | "uint16" => Number::U16,
            "int" | "int32" => Number::I32,
            "uint" | "uint32" => Number::U32,
            "float" | "float32" => Number::F32,
            "double" | "float64" => Number::F64,
            _ => return None,
        })
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Format {
    Ascii,
    Little,
    Big,
}

#[derive(Debug)]
struct Property {
    name: String,
    number: Number,
    /// Type of the length of a list; `None` where it is one number.
    list_count: Option<Number>,
}

#[derive(Debug)]
struct Element {
    name: String,
    count: u64,
    properties: Vec<Property>,
}

#[derive(Debug)]
struct Header {
    format: Format,
    elements: Vec<Element>,
}

/// Longest header: some hundred lines are usual.
const MAX_HEADER_LINES: usize = 4096;

impl Header {
    /// The header and what follows it.
    fn read(bytes: &[u8]) -> Result<(Header, &[u8]), String> {
        let mut rest = bytes;
        let (mut format, mut elements) = (None, Vec::<Element>::new());
        for line_number in 1..=MAX_HEADER_LINES {
            let end =
                rest.iter().position(|&byte| byte == b'\n').ok_or("expected a PLY header that ends with end_header")?;
            let line = String::from_utf8_lossy(&rest[..end]).into_owned();
            rest = &rest[end + 1..];
            let words: Vec<&str> = line.split_whitespace().collect();
            let expected = |what: &str| {
                let found: String = line.trim().chars().take(40).collect();
                format!("line {line_number}: expected {what}, found '{}'", found.escape_debug())
            };
            if line_number == 1 {
                if words != ["ply"] {
                    return Err(expected("ply"));
                }
                continue;
            }
            match words[..] {
                ["format", name, _] => {
                    format = Some(match name {
                        "ascii" => Format::Ascii,
                        "binary_little_endian" => Format::Little,
                        "binary_big_endian" => Format::Big,
                        _ => return Err(expected("format ascii, binary_little_endian or binary_big_endian")),
                    });
                }
                ["element", name, count] => {
                    let count = count.parse().map_err(|_| expected("element, a name and a number"))?;
                    elements.push(Element { name: name.to_owned(), count, properties: Vec::new() });
                }
                ["property", "list", count, number, name] => {
                    let types = Number::named(count).zip(Number::named(number));
                    let (count, number) = types.ok_or_else(|| expected("property list, two types and a name"))?;
                    let element = elements.last_mut().ok_or_else(|| expected("an element before its properties"))?;
                    element.properties.push(Property { name: name.to_owned(), number, list_count: Some(count) });
                }
                ["property", number, name] => {
                    let number = Number::named(number).ok_or_else(|| expected("property, a type and a name"))?;
                    let element = elements.last_mut().ok_or_else(|| expected("an element before its properties"))?;
                    element.properties.push(Property { name: name.to_owned(), number, list_count: None });
                }
                ["end_header"] => {
                    let format = format.ok_or("expected a line 'format ...' in the header")?;
                    return Ok((Header { format, elements }, rest));
                }
                [] | ["comment" | "obj_info", ..] => {}
                _ => return Err(expected("format, element, property, comment or end_header")),
            }
        }
        Err(format!("expected end_header within {MAX_HEADER_LINES} lines"))
    }
}

/// The numbers behind the header, one after the other.
struct Values<'a> {
    format: Format,
    rest: &'a [u8],
}

impl Values<'_> {
    /// The next number; `None` where there is none.
    fn number(&mut self, number: Number) -> Option<f64> {
        if self.format == Format::Ascii {
            let start = self.rest.iter().position(|byte| !byte.is_ascii_whitespace())?;
            let word = &self.rest[start..];
            let end = word.iter().position(u8::is_ascii_whitespace).unwrap_or(word.len());
            self.rest = &word[end..];
            return std::str::from_utf8(&word[..end]).ok()?.parse().ok();
        }
        let is_little = self.format == Format::Little;
        macro_rules! take {
            ($type:ty) => {{
                let (bytes, rest) = self.rest.split_first_chunk()?;
                self.rest = rest;
                f64::from(if is_little { <$type>::from_le_bytes(*bytes) } else { <$type>::from_be_bytes(*bytes) })
            }};
        }
        Some(match number {
            Number::I8 => take!(i8),
            Number::U8 => take!(u8),
            Number::I16 => take!(i16),
            Number::U16 => take!(u16),
            Number::I32 => take!(i32),
            Number::U32 => take!(u32),
            Number::F32 => take!(f32),
            Number::F64 => take!(f64),
        })
    }

    /// The numbers of a list; `None` where they are not all there.
    fn list(&mut self, property: &Property, mut each: impl FnMut(f64)) -> Option<()> {
        let count = self.number(property.list_count?)?;
        // A polygon of more corners is no polygon.
        if !(0.0..=1e6).contains(&count) {
            return None;
        }
        // Each number takes a byte at least, so a false count ends with the file.
        for _ in 0..count as u64 {
            each(self.number(property.number)?);
        }
        Some(())
    }
}

/// Numbers kept of a vertex: position, normal, texture coordinates, and one for all the rest.
const SLOTS: usize = 9;

fn vertex_slot(name: &str) -> usize {
    match name {
        "x" => 0,
        "y" => 1,
        "z" => 2,
        "nx" => 3,
        "ny" => 4,
        "nz" => 5,
        "u" | "s" | "texture_u" => 6,
        "v" | "t" | "texture_v" => 7,
        _ => 8,
    }
}

#[derive(Default)]
struct Vertices {
    positions: Vec<DVec3>,
    normals: Vec<DVec3>,
    uvs: Vec<Vec2>,
    has_colors: bool,
}

impl Vertices {
    fn push(&mut self, row: &[f64; SLOTS]) {
        self.positions.push(DVec3::new(row[0], row[1], row[2]));
        self.normals.push(DVec3::new(row[3], row[4], row[5]));
        let uv = Vec2::new(row[6] as f32, row[7] as f32);
        self.uvs.push(if uv.is_finite() { uv } else { Vec2::ZERO });
    }
}

#[derive(Default)]
struct Faces {
    triangles: Vec<[f64; 3]>,
    face_of_triangle: Vec<u32>,
    polygon: Vec<f64>,
}

impl Faces {
    /// Takes in the polygon.
    fn fan(&mut self, file: &str, face: u64) -> Result<(), SceneError> {
        let more = self.polygon.len().saturating_sub(2);
        check_limit(file, "triangles", MAX_TRIANGLES, (self.triangles.len() + more) as u64)?;
        let Some((&first, others)) = self.polygon.split_first() else { return Ok(()) };
        for pair in others.windows(2) {
            self.triangles.push([first, pair[0], pair[1]]);
            self.face_of_triangle.push(face as u32);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    const HEADER: &str = "comment made by hand\nelement vertex 4\nproperty float x\nproperty double y\nproperty float z\n\
        property uchar red\nproperty float nx\nproperty float ny\nproperty float nz\nproperty float s\nproperty float t\n\
        element edge 1\nproperty int vertex1\nelement face 1\nproperty uchar flags\nproperty list uchar int vertex_indices\n\
        end_header\n";
    const ROWS: [[f64; 9]; 4] = [
        [0.0, 0.0, 0.0, 9.0, 0.0, 0.0, 2.0, 0.0, 0.0],
        [1.0, 0.0, 0.0, 9.0, 0.0, 0.0, 2.0, 1.0, 0.0],
        [1.0, 1.0, 0.0, 9.0, 0.0, 0.0, 2.0, 1.0, 1.0],
        [0.0, 1.0, 0.0, 9.0, 0.0, 0.0, 2.0, 0.0, 1.0],
    ];

    fn ascii() -> Vec<u8> {
        let rows: String = ROWS.map(|row| row.map(|value| value.to_string()).join(" ") + "\n").concat();
        format!("ply\nformat ascii 1.0\n{HEADER}{rows}77\n5 4 0 1 2 3\n").into_bytes()
    }

    fn binary(is_little: bool) -> Vec<u8> {
        let name = if is_little { "little" } else { "big" };
        let mut bytes = format!("ply\nformat binary_{name}_endian 1.0\n{HEADER}").into_bytes();
        let float = |value: f64| if is_little { (value as f32).to_le_bytes() } else { (value as f32).to_be_bytes() };
        let int = |value: i32| if is_little { value.to_le_bytes() } else { value.to_be_bytes() };
        for row in ROWS {
            bytes.extend(float(row[0]));
            bytes.extend(if is_little { row[1].to_le_bytes() } else { row[1].to_be_bytes() });
            bytes.extend(float(row[2]));
            bytes.push(row[3] as u8);
            row[4..].iter().for_each(|&value| bytes.extend(float(value)));
        }
        bytes.extend(int(77));
        bytes.extend([5, 4]);
        (0..4).for_each(|corner| bytes.extend(int(corner)));
        bytes
    }

    #[test]
    fn the_three_formats_hold_the_same_model() {
        for bytes in [ascii(), binary(true), binary(false)] {
            let model = parse("a.ply", &bytes).unwrap();
            assert_eq!(model.mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
            assert_eq!(model.mesh.positions[2], Vec3::new(1.0, 1.0, 0.0));
            assert_eq!(model.mesh.normals, [Vec3::Z; 4]);
            assert_eq!(model.mesh.uvs[2], Vec2::ONE);
            assert_eq!(model.mesh.materials, [0, 0]);
            assert!(model.has_colors);
        }
    }

    #[test]
    fn a_damaged_file_is_one_line_that_names_it() {
        for whole in [ascii(), binary(true), binary(false)] {
            for length in 0..whole.len() {
                match parse("a.ply", &whole[..length]) {
                    Ok(model) => assert!(model.mesh.triangles.len() <= 2),
                    Err(error) => {
                        let line = error.to_string();
                        assert!(line.starts_with("a.ply: ") && !line.contains('\n'), "{line}");
                    }
                }
            }
        }
    }

    #[test]
    fn what_a_header_claims_is_not_believed() {
        let header = |count: &str, list: &str| {
            format!(
                "ply\nformat binary_little_endian 1.0\nelement vertex {count}\nproperty float x\nproperty float y\n\
                 property float z\nelement face 1\nproperty list {list} int vertex_indices\nend_header\n"
            )
        };
        for (text, part) in [
            (header("30000000", "int"), "vertex 0: expected more numbers"),
            (header("18446744073709551615", "int"), "at most 30000000 are loaded"),
            (header("99999999999999999999999", "int"), "line 3: expected element, a name and a number"),
            (header("-1", "int"), "line 3"),
            (header("0", "int") + "\u{7f}\u{7f}\u{7f}\u{7f}", "face 0: expected more numbers"),
            (header("0", "double"), "face 0"),
            (header("0", "real"), "line 8: expected property list"),
            (header("0", "uchar") + "\u{3}\0\0\0\0\0\0\0\0\0\0\0\0", "face 0: expected the numbers of 0 vertices"),
            ("ply\nformat ascii 1.0\nproperty float x\nend_header\n".to_owned(), "line 3: expected an element"),
            ("ply\nend_header\n".to_owned(), "'format ...'"),
            ("plyx\n".to_owned(), "line 1: expected ply"),
            ("ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n".to_owned(), "x, y and z"),
        ] {
            let line = parse("a.ply", text.as_bytes()).unwrap_err().to_string();
            assert!(line.contains(part), "{line} / {part}");
        }
    }
}
