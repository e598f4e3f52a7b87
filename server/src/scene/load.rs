//! From a scene's name or path to a whole scene: a head, a camera and light are there in any case.

use super::description::{compose, parse};
use super::model::extension;
use super::untrusted::{MAX_TOML_BYTES, read_file};
use super::{Environment, NamedCamera, Part, Scene, SceneError, built_in, mitsuba, model};
use glam::{DVec3, Vec3};
use std::path::Path;
use warplight_protocol::Pose;

impl Scene {
    /// Loads a built-in scene by name, or a scene from a path that ends in .toml, .xml (Mitsuba), .glb, .gltf,
    /// .obj or .ply.
    ///
    /// What the file asks for and is not supported is in `warnings`; what would make the picture
    /// meaningless is an error, whose text is one line.
    pub fn load(spec: &str) -> Result<Scene, SceneError> {
        if let Some(text) = built_in::text(spec) {
            return from_toml(spec, &format!("scenes/{spec}/scene.toml"), None, text);
        }
        let path = Path::new(spec);
        match extension(path).as_str() {
            "toml" => {
                let bytes = read_file(path, MAX_TOML_BYTES)?;
                let text = String::from_utf8(bytes).map_err(|error| SceneError::Malformed {
                    file: spec.to_owned(),
                    reason: format!("expected UTF-8 text, found another byte at {}", error.utf8_error().valid_up_to()),
                })?;
                let folder = path.parent().unwrap_or(Path::new(""));
                from_toml(&name_of(path), spec, Some(folder), &text)
            }
            "glb" | "gltf" => {
                let part = model::load(path)?;
                Ok(finish(name_of(path), spec, part, None, 1.0, None))
            }
            "obj" | "ply" => {
                let part = model::load(path)?;
                Ok(finish(name_of(path), spec, part, None, 1.0, None))
            }
            "xml" => {
                let (part, environment) = mitsuba::load(path)?;
                Ok(finish(name_of(path), spec, part, environment, 1.0, None))
            }
            _ => Err(SceneError::Unknown { spec: spec.to_owned() }),
        }
    }

    /// Names of the built-in scenes, the default first.
    pub fn built_in_names() -> &'static [&'static str] {
        &built_in::NAMES
    }
}

fn from_toml(name: &str, file: &str, folder: Option<&Path>, text: &str) -> Result<Scene, SceneError> {
    let composition = compose(file, folder, &parse(file, text)?)?;
    let environment = composition.environment.unwrap_or(Environment::Black);
    Ok(finish(name.to_owned(), file, composition.part, Some(environment), composition.exposure, composition.head))
}

/// The file's stem; of a file named scene.toml the folder's name, if it has one.
fn name_of(path: &Path) -> String {
    let stem = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    let folder = path.parent().and_then(Path::file_name).map(|folder| folder.to_string_lossy().into_owned());
    if stem == "scene" { folder.unwrap_or(stem) } else { stem }
}

/// Adds what every scene has. A model brings no surroundings (`environment` is `None`): where it has no
/// lights either, it gets a plain sky, since it would be black.
fn finish(
    name: String,
    file: &str,
    mut part: Part,
    environment: Option<Environment>,
    exposure: f32,
    head: Option<Pose>,
) -> Scene {
    part.drop_unseen();
    let dropped = part.mesh.drop_degenerate();
    if dropped > 0 {
        part.warnings.push(format!("{file}: {dropped} triangles without area are dropped"));
    }
    if part.mesh.triangles.is_empty() && part.spheres.is_empty() {
        part.warnings.push(format!("{file}: there is no surface in this scene"));
    }
    let lit = part.has_emission();
    let environment = environment.unwrap_or_else(|| {
        if lit {
            return Environment::Black;
        }
        part.warnings.push(format!("{file}: nothing emits light: lit by a plain sky"));
        plain_sky()
    });
    if !lit && environment.is_black() {
        part.warnings.push(format!("{file}: nothing emits light: pictures will be black"));
    }
    let head = head.or(part.cameras.first().map(|camera| camera.pose)).unwrap_or_else(|| framing(&part));
    if part.cameras.is_empty() {
        part.cameras.push(NamedCamera { name: "head".to_owned(), pose: head, vertical_fov_rad: HEAD_FOV_RAD });
    }
    let media = part.placed_media();
    Scene {
        name,
        origin: part.origin(),
        mesh: part.mesh,
        spheres: part.spheres,
        materials: part.materials,
        textures: part.textures,
        media,
        lights: part.lights,
        environment,
        exposure,
        head,
        cameras: part.cameras,
        motions: part.motions,
        defaults: part.defaults,
        warnings: part.warnings,
    }
}

/// Vertical field of view where none is given: 60 degrees, as the default of scene.toml.
const HEAD_FOV_RAD: f32 = std::f32::consts::FRAC_PI_3;

fn plain_sky() -> Environment {
    Environment::Gradient { zenith: Vec3::splat(1.0), horizon: Vec3::splat(0.8), nadir: Vec3::splat(0.25) }
}

/// A view along -Z, a little from above, that has the whole scene in sight.
fn framing(part: &Part) -> Pose {
    let mut bounds = part.mesh.bounds();
    for sphere in &part.spheres {
        let (low, high) = (sphere.centre - sphere.radius, sphere.centre + sphere.radius);
        bounds = Some(bounds.map_or((low, high), |(l, h)| (l.min(low), h.max(high))));
    }
    let (low, high) = bounds.unwrap_or((Vec3::splat(-1.0), Vec3::ONE));
    let middle = part.origin() + ((low + high) / 2.0).as_dvec3();
    let radius = f64::from((high - low).length() / 2.0).max(1e-3);
    // The bounding sphere touches the frustum at this distance.
    let distance = radius / f64::from(HEAD_FOV_RAD / 2.0).sin();
    Pose::look_at(middle + DVec3::new(0.0, 0.3, 1.0).normalize() * distance, middle)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_built_in_scene_loads_without_a_warning() {
        for name in Scene::built_in_names() {
            let scene = Scene::load(name).unwrap();
            assert_eq!(scene.warnings, Vec::<String>::new(), "{name}");
            assert_eq!(scene.name, *name);
            assert!(!scene.cameras.is_empty() && !scene.mesh.triangles.is_empty());
            let inside = |index: u32| (index as usize) < scene.mesh.positions.len();
            assert!(scene.mesh.triangles.iter().flatten().all(|&index| inside(index)));
            let known = |index: u32| (index as usize) < scene.materials.len();
            assert!(scene.mesh.materials.iter().all(|&index| known(index)));
            assert!(scene.spheres.iter().all(|sphere| known(sphere.material)));
        }
    }

    #[test]
    fn an_unknown_scene_is_told_which_there_are() {
        let line = Scene::load("galery").unwrap_err().to_string();
        assert!(line.starts_with("unknown scene 'galery': expected one of gallery, cornell, "), "{line}");
    }

    #[test]
    fn a_missing_file_is_named() {
        let line = Scene::load("nowhere/scene.toml").unwrap_err().to_string();
        assert!(line.starts_with("nowhere/scene.toml: No such file"), "{line}");
        assert!(Scene::load("nowhere/a.glb").unwrap_err().to_string().starts_with("nowhere/a.glb: No such file"));
        assert!(Scene::load("nowhere/a.xml").unwrap_err().to_string().starts_with("nowhere/a.xml: No such file"));
    }

    fn from_text(text: &str) -> Result<Scene, SceneError> {
        from_toml("x", "x.toml", None, text)
    }

    const BALL: &str = "[[shape]]\nkind = \"sphere\"\nmaterial = \"glass\"\ncentre = [0, 0, 0]\nradius = 1\n";

    #[test]
    fn a_value_out_of_range_names_file_section_and_field() {
        let glass = |ior: &str| format!("[[material]]\nname = \"glass\"\nkind = \"dielectric\"\nior = {ior}\n{BALL}");
        let line = |ior: &str| from_text(&glass(ior)).unwrap_err().to_string();
        assert_eq!(line("0"), "x.toml: material 'glass': ior: expected a number from 1.0001 to 10, found 0");
        assert_eq!(line("nan"), "x.toml: material 'glass': ior: expected a number from 1.0001 to 10, found NaN");
        assert!(from_text(&glass("1.5")).is_ok());
    }

    #[test]
    fn names_that_are_not_there_or_twice_are_refused() {
        assert_eq!(
            from_text(BALL).unwrap_err().to_string(),
            "x.toml: shape 1: material: expected the name of a [[material]], found 'glass'"
        );
        let mirror = "[[material]]\nname = \"glass\"\nkind = \"mirror\"\n";
        assert!(from_text(&format!("{mirror}{mirror}")).unwrap_err().to_string().contains("a name of its own"));
        assert!(
            from_text(&format!("{mirror}[[shape]]\nkind = \"mesh\"\nfile = \"a.glb\"\n"))
                .unwrap_err()
                .to_string()
                .contains("built-in")
        );
    }

    #[test]
    fn a_scene_without_head_or_camera_is_framed() {
        let scene = from_text(&format!("[[material]]\nname = \"glass\"\nkind = \"mirror\"\n{BALL}")).unwrap();
        let ahead = scene.head.orientation * DVec3::NEG_Z;
        let to_ball = -scene.head.position.normalize();
        assert!((ahead - to_ball).length() < 1e-6);
        assert_eq!(scene.cameras[0].pose, scene.head);
        assert!(scene.warnings[0].contains("pictures will be black"));
    }
}
