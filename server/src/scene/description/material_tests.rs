//! Keys of materials and lights: what they become, and what is refused in which words.

use super::super::{
    Anisotropy, Color, Cutout, Distribution, Falloff, Light, Material, NormalMap, Scalar, Scene, SceneError, Surface,
};
use glam::Vec3;

const TEXTURE: &str = "[[texture]]\nname = \"map\"\nkind = \"checker\"\na = 0\nb = 1\n";

fn load(text: &str) -> Result<Scene, SceneError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.toml");
    std::fs::write(&path, text).unwrap();
    Scene::load(path.to_str().unwrap())
}

/// A material named a with these lines, after a texture named map.
fn try_material(lines: &str) -> Result<Material, SceneError> {
    let scene = load(&format!("{TEXTURE}[[material]]\nname = \"a\"\n{lines}\n"))?;
    Ok(scene.materials[0].clone())
}

fn material(lines: &str) -> Material {
    try_material(lines).unwrap_or_else(|error| panic!("{error}"))
}

/// What comes after the file's name in the error.
fn refused(lines: &str) -> String {
    let line = try_material(lines).unwrap_err().to_string();
    assert!(!line.contains('\n'), "{line}");
    line.split_once("x.toml: ").unwrap().1.to_owned()
}

#[test]
fn roughness_is_the_root_of_alpha() {
    let Surface::Conductor { finish, .. } =
        material("kind = \"conductor\"\nmetal = \"gold\"\nroughness = 0.3\ndistribution = \"beckmann\"").surface
    else {
        panic!()
    };
    assert!((finish.alpha.most() - 0.09).abs() < 1e-7);
    assert_eq!((finish.distribution, finish.compensated), (Distribution::Beckmann, true));
    let textured = "kind = \"pane\"\nroughness = { texture = \"map\", channel = \"green\", factor = 0.5 }";
    let Surface::ThinDielectric { finish, ior, .. } = material(textured).surface else { panic!() };
    assert_eq!(finish.alpha, Scalar::Textured { texture: 0, channel: 1, factor: 0.25, squared: true });
    assert_eq!(ior, 1.5);
}

#[test]
fn smooth_kinds_are_smooth_and_standard_is_rough_unless_it_says_otherwise() {
    for kind in ["conductor\"\nmetal = \"gold\"", "dielectric\"\nior = 1.5", "pane\""] {
        let (Surface::Conductor { finish, .. }
        | Surface::Dielectric { finish, .. }
        | Surface::ThinDielectric { finish, .. }) = material(&format!("kind = \"{kind}")).surface
        else {
            panic!()
        };
        assert!(finish.is_smooth());
    }
    let Surface::Standard(plain) = material("kind = \"standard\"\nbase = 0.5").surface else { panic!() };
    assert_eq!((plain.finish.alpha, plain.metallic), (Scalar::Constant(1.0), Scalar::Constant(0.0)));
    assert_eq!((plain.ior, plain.coat), (1.5, None));
}

#[test]
fn abbe_numbers_are_dispersion() {
    let Surface::Dielectric { dispersion, .. } = material("kind = \"dielectric\"\nior = 1.5\nabbe = 40").surface else {
        panic!()
    };
    assert_eq!(dispersion, 0.5);
}

#[test]
fn anisotropy_is_a_number_or_a_table() {
    let of = |keys: &str| {
        let Surface::Standard(standard) =
            material(&format!("kind = \"standard\"\nbase = 1\nanisotropy = {keys}")).surface
        else {
            panic!()
        };
        standard.finish.anisotropy
    };
    assert_eq!(of("0.5"), Anisotropy { strength: 0.5, rotation_rad: 0.0, texture: None });
    let turned = of("{ rotation_deg = 90, texture = \"map\" }");
    assert_eq!((turned.strength, turned.texture), (1.0, Some(0)));
    assert!((turned.rotation_rad - std::f32::consts::FRAC_PI_2).abs() < 1e-6);
}

#[test]
fn every_kind_may_have_holes_bumps_and_light() {
    for kind in ["diffuse\"\nalbedo = 1", "mirror\"", "standard\"\nbase = 1", "dielectric\"\nior = 1.5"] {
        let found = material(&format!(
            "kind = \"{kind}\nemission = 2\nemission_two_sided = true\nnormal_map = {{ texture = \"map\", scale = 0.5 }}\n\
             cutout = {{ opacity = \"map\", threshold = 0.25 }}"
        ));
        assert_eq!((found.emission, found.emission_two_sided), (Color::Constant(Vec3::splat(2.0)), true));
        assert_eq!(found.normal_map, Some(NormalMap { texture: 0, scale: glam::Vec2::splat(0.5) }));
        let opacity = Scalar::Textured { texture: 0, channel: 3, factor: 1.0, squared: false };
        assert_eq!(found.cutout, Some(Cutout { opacity, threshold: Some(0.25) }));
    }
    assert!(material("kind = \"diffuse\"\nalbedo = 1\none_sided = true").one_sided);
    assert_eq!(
        refused("kind = \"pane\"\none_sided = true"),
        "material 'a': one_sided: expected an opaque kind of material, found a transparent one"
    );
}

#[test]
fn values_out_of_range_name_their_field() {
    for (lines, expected) in [
        ("kind = \"pane\"\nroughness = 1.5", "roughness: expected a number from 0 to 1, found 1.5"),
        ("kind = \"pane\"\nroughness = nan", "roughness: expected a number from 0 to 1, found NaN"),
        ("kind = \"pane\"\nroughness = \"mop\"", "roughness: expected the name of a [[texture]], found 'mop'"),
        ("kind = \"pane\"\nior = 1", "ior: expected a number from 1.0001 to 10, found 1"),
        ("kind = \"dielectric\"\nior = 1.5\nabbe = 0", "abbe: expected a number from 5 to 10000, found 0"),
        ("kind = \"standard\"\nbase = 2", "base: expected a number from 0 to 1, found 2"),
        ("kind = \"standard\"\nbase = 1\nmetallic = -1", "metallic: expected a number from 0 to 1, found -1"),
        ("kind = \"standard\"\nbase = 1\ncoat = { roughness = 2 }", "coat: roughness: expected a number from 0 to 1"),
        ("kind = \"standard\"\nbase = 1\nanisotropy = 2", "anisotropy: strength: expected a number from 0 to 1"),
        ("kind = \"mirror\"\nnormal_map = \"mop\"", "normal_map: expected the name of a [[texture]], found 'mop'"),
        ("kind = \"mirror\"\ncutout = { opacity = 3 }", "cutout: opacity: expected a number from 0 to 1, found 3"),
    ] {
        let line = refused(lines);
        assert!(line.starts_with(&format!("material 'a': {expected}")), "{line}");
    }
    assert!(refused("kind = \"pane\"\nroughness = [1, 2]").contains("expected a number, a texture's name, or {"));
    assert!(refused("kind = \"pane\"\nmetallic = 1").contains("unknown field `metallic`"));
    assert!(refused("kind = \"mirror\"\nnormal_map = 3").contains("expected a normal map"));
}

#[test]
fn lights_are_what_their_keys_say() {
    let scene = load(
        "[[light]]\nkind = \"point\"\nposition = [1, 2, 3]\nintensity = [4, 5, 6]\n\
         [[light]]\nkind = \"spot\"\nposition = [0, 3, 0]\nlook_at = [0, 1, 0]\nintensity = 2\ninner_deg = 10\nouter_deg = 20\n\
         [[light]]\nkind = \"directional\"\ndirection = [0, 0, -3]\nirradiance = 7\n",
    )
    .unwrap();
    let point = Light::Point { position: Vec3::new(1.0, 2.0, 3.0), intensity: Vec3::new(4.0, 5.0, 6.0) };
    let directional = Light::Directional { direction: Vec3::NEG_Z, irradiance: Vec3::splat(7.0) };
    assert_eq!((scene.lights[0], scene.lights[2]), (point, directional));
    let Light::Spot { position, axis, intensity, inner_rad, outer_rad, falloff } = scene.lights[1] else { panic!() };
    assert_eq!((position, axis, intensity), (Vec3::Y * 3.0, Vec3::NEG_Y, Vec3::splat(2.0)));
    assert_eq!((inner_rad, outer_rad), (10.0_f32.to_radians(), 20.0_f32.to_radians()));
    assert_eq!(falloff, Falloff::SquaredInCosine);
}

#[test]
fn lights_out_of_range_are_refused_by_number_and_field() {
    let refused = |lines: &str| load(&format!("[[light]]\n{lines}")).unwrap_err().to_string();
    let spot = "kind = \"spot\"\nposition = [0, 0, 0]\nintensity = 1\n";
    for (line, expected) in [
        (refused("kind = \"point\"\nposition = [0, 0, 0]\nintensity = -1"), "light 1: intensity: expected a number"),
        (refused("kind = \"directional\"\ndirection = [0, 0, 0]\nirradiance = 1"), "light 1: direction: expected"),
        (refused(&format!("{spot}look_at = [0, 0, 0]")), "light 1: look_at: expected a point away from position"),
        (
            refused(&format!("{spot}look_at = [0, 1, 0]\ninner_deg = 30\nouter_deg = 30")),
            "light 1: inner_deg: expected an angle below outer_deg 30, found 30",
        ),
        (refused(&format!("{spot}look_at = [0, 1, 0]\nouter_deg = 120")), "light 1: outer_deg: expected a number"),
    ] {
        assert!(line.contains(expected), "{line}");
    }
}
