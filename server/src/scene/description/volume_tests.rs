//! `[[volume]]`, from text to media.

use super::super::super::Scene;
use super::*;

/// A scene of one volume with these keys, and a file to name.
fn load_with(keys: &str) -> Result<Scene, SceneError> {
    let folder = tempfile::tempdir().unwrap();
    let header = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 4 2 8\nspacings: 1 2 0.5\nspace units: \"mm\"\n\
                  encoding: raw\n\n";
    let samples: Vec<u8> = (0..64).map(|index| index * 3).collect();
    std::fs::write(folder.path().join("a.nrrd"), [header.as_bytes(), &samples].concat()).unwrap();
    let path = folder.path().join("x.toml");
    std::fs::write(
        &path,
        format!("[environment]\nkind = \"constant\"\nradiance = 1\n[[volume]]\nname = \"v\"\n{keys}"),
    )
    .unwrap();
    Scene::load(path.to_str().unwrap())
}

fn scene(keys: &str) -> Scene {
    load_with(keys).unwrap_or_else(|error| panic!("{error}\n{keys}"))
}

/// The corners of all there is.
fn bounds(scene: &Scene) -> (Vec3, Vec3) {
    scene.mesh.bounds().unwrap()
}

const FILE: &str = "source = { kind = \"file\", file = \"a.nrrd\" }\nextinction = 1\n";

#[test]
fn a_volume_is_a_medium_and_the_box_about_it() {
    let scene = scene("extinction = [1, 2, 3]\nalbedo = 0.5\nemission = 0.25\nsize = [2, 4, 6]\nphase_g = 0.3\n");
    assert_eq!(
        (scene.media.len(), scene.mesh.triangles.len(), scene.warnings.len()),
        (1, 12, 0),
        "{:?}",
        scene.warnings
    );
    let material = &scene.materials[scene.mesh.materials[0] as usize];
    assert_eq!((material.surface, material.interior), (Surface::Null, Some(0)));
    assert_eq!(bounds(&scene), (Vec3::new(-1.0, -2.0, -3.0), Vec3::new(1.0, 2.0, 3.0)));
    let optical = scene.media[0].at(Vec3::ZERO);
    assert_eq!(optical.extinction, Vec3::new(1.0, 2.0, 3.0));
    assert_eq!(optical.scattering, Vec3::new(0.5, 1.0, 1.5));
    assert_eq!(optical.emission, Vec3::splat(0.25));
    assert_eq!(scene.media[0].phase.g, 0.3);
}

#[test]
fn a_box_has_the_units_of_its_file_unless_it_is_told_otherwise() {
    let half = |keys: &str| bounds(&scene(&format!("{FILE}{keys}"))).1;
    // 4, 4 and 4 mm.
    assert!((half("") - 0.002).abs().max_element() < 1e-8);
    assert!((half("size = 3") - 1.5).abs().max_element() < 1e-6);
    assert!((half("size = [1, 2, 3]") - Vec3::new(0.5, 1.0, 1.5)).abs().max_element() < 1e-6);
    assert!((half("voxel = 0.1") - Vec3::new(0.2, 0.1, 0.4)).abs().max_element() < 1e-6);
    let moved = bounds(&scene(&format!("{FILE}size = 2\ntransform = {{ translate = [5, 0, 0], scale = 2 }}")));
    assert!((moved.0 - Vec3::new(3.0, -2.0, -2.0)).length() < 1e-6, "{moved:?}");
}

/// The values of the file grow by 3 along x, 12 along y and 24 along z, from cell to cell.
#[test]
fn the_axis_that_is_called_up_points_upwards_and_nothing_is_mirrored() {
    for (up, axis, sign) in
        [("x", 0, 1.0), ("y", 1, 1.0), ("z", 2, 1.0), ("-x", 0, -1.0), ("-y", 1, -1.0), ("-z", 2, -1.0)]
    {
        let scene = scene(&format!("{FILE}voxel = 1\nup = \"{up}\"\n"));
        let density = |point: Vec3| scene.media[0].at(scene_point(&scene, point)).extinction.x;
        let slope = |direction: Vec3| (density(direction * 0.25) - density(direction * -0.25)) / 0.5;
        let steps = [3.0, 12.0, 24.0];
        assert!((slope(Vec3::Y) - sign * steps[axis]).abs() < 1e-3, "{up}: {}", slope(Vec3::Y));
        // The gradients along world's axes are the file's: a turn keeps their handedness.
        let Matter::Density { unit_from_world, .. } = &scene.media[0].matter else { panic!() };
        assert!(unit_from_world.matrix3.determinant() > 0.0, "{up}");
    }
}

/// Media count from the origin of the scene.
fn scene_point(scene: &Scene, world: Vec3) -> Vec3 {
    world - scene.origin.as_vec3()
}

#[test]
fn scans_are_classified_and_densities_scaled() {
    let classified = scene(
        "source = { kind = \"file\", file = \"a.nrrd\" }\nsize = 1\nextinction_scale = 2\n\
         transfer = [[0, [0.1, 0.2, 0.3], 0], [189, 1, 10]]\n",
    );
    let middle = classified.media[0].at(Vec3::ZERO);
    assert!((middle.extinction.x - 10.0).abs() < 1e-4, "{middle:?}");
    assert!((middle.scattering / middle.extinction - Vec3::new(0.55, 0.6, 0.65)).abs().max_element() < 1e-4);
    let density = scene(&format!("{FILE}value_scale = 0.01\n"));
    assert!((density.media[0].at(Vec3::ZERO).extinction.x - 0.945).abs() < 1e-5);
}

#[test]
fn computed_volumes_have_the_proportions_of_their_grids() {
    for kind in ["cloud", "phantom", "shells", "clouds"] {
        let scene =
            scene(&format!("source = {{ kind = \"{kind}\", resolution = [16, 8, 4] }}\nextinction = 1\nsize = 2\n"));
        assert_eq!(bounds(&scene).1, Vec3::new(1.0, 0.5, 0.25), "{kind}");
    }
}

#[test]
fn what_is_wrong_names_the_volume_and_the_key() {
    let error = |keys: &str| {
        let line = load_with(keys).unwrap_err().to_string();
        assert!(!line.contains('\n') && (line.contains("x.toml") || line.contains(".nrrd")), "{line}");
        line
    };
    let file = "source = { kind = \"file\", file = \"a.nrrd\" }\n";
    assert!(error("").contains("volume 'v': extinction: expected extinction or transfer, found neither"));
    assert!(error("extinction = -1").contains("extinction: expected a number from 0 to 1000000, found -1"));
    assert!(error("extinction = nan").contains("found NaN"));
    assert!(error("extinction = 1\nalbedo = 2").contains("albedo: expected a number from 0 to 1, found 2"));
    assert!(error("extinction = 1\nphase_g = 1").contains("phase_g"));
    assert!(error("extinction = 1\nvoxel = 1").contains("voxel: expected a source"));
    assert!(error("extinction = 1\nsize = 0").contains("size: expected a number from 0.000001"));
    assert!(error("extinction = 1\nextinction_scale = 1").contains("nothing without transfer"));
    assert!(error("extinction = 1\nup = \"w\"").contains("unknown variant `w`"));
    assert!(error("extinction = 1\ncolour = 1").contains("unknown field `colour`"));
    assert!(error("transfer = [[0, 1, 1]]").contains("transfer: expected a source"));
    assert!(error(&format!("{FILE}transfer = [[0, 1, 1]]")).contains("extinction: expected nothing beside transfer"));
    assert!(error(&format!("{file}transfer = []")).contains("volume 'v': transfer: expected 1 to 4096 points"));
    assert!(error(&format!("{file}transfer = [[1, 1, 1], [0, 1, 1]]")).contains("point 2: expected a value"));
    assert!(error(&format!("{file}transfer = [[1, 1, 1], [2, 3, 1]]")).contains("point 2: colour: expected"));
    assert!(error(&format!("{file}transfer = [[1, 1, nan]]")).contains("point 1: extinction: expected"));
    assert!(error(&format!("{file}transfer = [[1, 1]]")).contains("expected a point: [value, colour, extinction]"));
    assert!(error(&format!("{FILE}size = 1\nvoxel = 1")).contains("voxel: expected size or voxel, found both"));
    assert!(error(&format!("{FILE}voxel = 30000")).contains("voxel: expected"));
    assert!(error("source = { kind = \"file\", file = \"b.nrrd\" }\nextinction = 1").contains("b.nrrd"));
    assert!(error("source = { kind = \"cloud\", resolution = 0 }\nextinction = 1").contains("source: resolution"));
    assert!(error("source = { kind = \"clouds\", cover = 2 }\nextinction = 1").contains("source: cover"));
    assert!(error("source = { kind = \"smoke\" }\nextinction = 1").contains("unknown variant `smoke`"));
}
