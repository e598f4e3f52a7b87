//! What materials and lights of a file become.

use super::*;
use crate::scene::{
    Coat, Cutout, Distribution, Environment, Falloff, Finish, NormalMap, Scalar, Standard, TexelFilter, Texture,
    Transfer, Wrap,
};
use glam::Vec2;
use image::{Rgba, RgbaImage};

/// A picture whose red, green and alpha change and whose blue is black.
fn ramp() -> RgbaImage {
    RgbaImage::from_fn(4, 4, |x, y| Rgba([x as u8 * 60, y as u8 * 70, 0, 255 - x as u8 * 20]))
}

/// The triangle with this material and these images.
fn scene_with(material: &Value, images: &[RgbaImage]) -> Scene {
    let mut document = triangle();
    document["materials"][0] = material.clone();
    add_images(&mut document, images);
    load(&document).unwrap()
}

fn standard(surface: &Surface) -> Standard {
    let Surface::Standard(standard) = surface else { panic!("{surface:?}") };
    *standard
}

#[test]
fn a_material_without_specular_part_is_plain_lambert() {
    let (material, warnings) = material_with(&json!({
        "pbrMetallicRoughness": {"baseColorFactor": [0.2, 0.4, 0.6, 1.0], "metallicFactor": 0.0},
        "extensions": {"KHR_materials_specular": {"specularFactor": 0.0}}
    }));
    assert_eq!(material.surface, Surface::Diffuse { albedo: Color::Constant(Vec3::new(0.2, 0.4, 0.6)) });
    assert_eq!(warnings, "");
}

#[test]
fn a_white_smooth_metal_is_a_mirror_and_any_other_is_standard() {
    let metal = |roughness: f32, blue: f32| {
        material_with(&json!({"pbrMetallicRoughness": {
            "roughnessFactor": roughness, "baseColorFactor": [1.0, 1.0, blue, 1.0]
        }}))
    };
    assert_eq!(metal(0.0, 1.0).0.surface, Surface::Mirror { filter: Vec3::ONE });
    let (material, warnings) = metal(0.5, 1.0);
    let rough = standard(&material.surface);
    // Alpha is the square of roughness.
    assert_eq!(rough.finish, Finish::isotropic(Distribution::Ggx, Scalar::Constant(0.25)));
    assert_eq!((rough.metallic, warnings.as_str()), (Scalar::Constant(1.0), ""));
    assert!(standard(&metal(0.0, 0.5).0.surface).finish.is_smooth());
}

#[test]
fn plastic_has_the_layer_that_its_extensions_say() {
    let (material, warnings) = material_with(&json!({
        "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.3},
        "extensions": {
            "KHR_materials_ior": {"ior": 1.8},
            "KHR_materials_specular": {"specularFactor": 0.5, "specularColorFactor": [2.0, 1.0, 0.5]},
            "KHR_materials_clearcoat": {"clearcoatFactor": 0.75, "clearcoatRoughnessFactor": 0.2}
        }
    }));
    let plastic = standard(&material.surface);
    assert_eq!((plastic.ior, plastic.specular), (1.8, Scalar::Constant(0.5)));
    assert_eq!(plastic.specular_color, Color::Constant(Vec3::new(2.0, 1.0, 0.5)));
    let coat = plastic.coat.unwrap();
    assert_eq!(coat.strength, Scalar::Constant(0.75));
    assert!((coat.alpha.most() - 0.04).abs() < 1e-7);
    assert_eq!(warnings, "");
    // Without plastic, specular factor 0 is not Lambert reflection, and a coat is over Lambert reflection too.
    let coated = json!({
        "pbrMetallicRoughness": {"metallicFactor": 0.0},
        "extensions": {"KHR_materials_specular": {"specularFactor": 0.0}, "KHR_materials_clearcoat": {"clearcoatFactor": 1.0}}
    });
    assert_eq!(
        standard(&material_with(&coated).0.surface).coat,
        Some(Coat { strength: Scalar::Constant(1.0), alpha: Scalar::Constant(0.0) })
    );
}

#[test]
fn textures_of_roughness_and_metalness_are_data_and_constant_channels_are_constants() {
    let material = json!({
        "pbrMetallicRoughness": {
            "roughnessFactor": 0.5, "metallicRoughnessTexture": {"index": 0},
            "baseColorTexture": {"index": 0}
        },
        "extensions": {"KHR_materials_transmission": {"transmissionFactor": 0.5, "transmissionTexture": {"index": 0}}}
    });
    let scene = scene_with(&material, &[ramp()]);
    let found = standard(&scene.materials[0].surface);
    // Blue is 0 in all of the image.
    assert_eq!(found.metallic, Scalar::Constant(0.0));
    let Scalar::Textured { texture, channel: 1, factor: 0.25, squared: true } = found.finish.alpha else {
        panic!("{:?}", found.finish)
    };
    assert!(matches!(found.transmission, Scalar::Textured { channel: 0, factor: 0.5, squared: false, .. }));
    let (data, Color::Textured { texture: color, .. }) = (&scene.textures[texture as usize], found.base) else {
        panic!()
    };
    let (TextureKind::Image(data), TextureKind::Image(color)) = (&data.kind, &scene.textures[color as usize].kind)
    else {
        panic!()
    };
    assert_eq!((data.transfer, color.transfer), (Transfer::Linear, Transfer::Srgb));
    // One image, decoded once; one texture for each way to read it.
    assert!(std::sync::Arc::ptr_eq(&data.texels, &color.texels));
    assert_eq!(scene.textures.len(), 2);
    // Row 2 has green 140: at its centre alpha is (0.5 * 140 / 255)^2.
    let alpha = found.finish.alpha.at(&scene.textures, Vec2::new(0.125, 0.625));
    assert!((alpha - (0.5_f32 * 140.0 / 255.0).powi(2)).abs() < 1e-6, "{alpha}");
}

/// Glass by KHR_materials_transmission, with or without other extensions.
fn clear(thickness: f32, metallic_roughness: &Value, extensions: Value) -> Value {
    let mut material = json!({"name": "glass", "pbrMetallicRoughness": metallic_roughness, "extensions": extensions});
    material["extensions"]["KHR_materials_transmission"] = json!({"transmissionFactor": 1.0});
    material["extensions"]["KHR_materials_volume"] = json!({
        "thicknessFactor": thickness, "attenuationDistance": 2.0, "attenuationColor": [0.5, 1.0, 1.0]
    });
    material
}

#[test]
fn thick_transmission_is_a_solid_that_absorbs_and_disperses() {
    let smooth = json!({"metallicFactor": 0.0, "roughnessFactor": 0.2, "baseColorFactor": [0.9, 0.8, 0.7, 1.0]});
    let extensions = json!({"KHR_materials_ior": {"ior": 1.33}, "KHR_materials_dispersion": {"dispersion": 0.5}});
    let (material, warnings) = material_with(&clear(1.0, &smooth, extensions));
    let Surface::Dielectric { ior, dispersion, filter, absorption, finish } = material.surface else {
        panic!("{material:?}")
    };
    assert_eq!((ior, dispersion), (1.33, 0.5));
    assert_eq!(filter, Color::Constant(Vec3::new(0.9, 0.8, 0.7)));
    assert!((absorption - Vec3::new(0.5_f32.ln() / -2.0, 0.0, 0.0)).length() < 1e-6);
    assert!((finish.alpha.most() - 0.04).abs() < 1e-7);
    assert_eq!(warnings, "");
}

#[test]
fn thin_transmission_is_a_pane_and_anything_partial_is_standard() {
    let smooth = json!({"metallicFactor": 0.0, "roughnessFactor": 0.0});
    let (material, _) = material_with(&clear(0.0, &smooth, json!({})));
    let pane = Surface::ThinDielectric { ior: 1.5, filter: Color::Constant(Vec3::ONE), finish: Finish::SMOOTH };
    assert_eq!(material.surface, pane);

    let half_metal = json!({"metallicFactor": 0.5, "roughnessFactor": 0.0});
    let (material, warnings) = material_with(&clear(1.0, &half_metal, json!({})));
    assert_eq!(standard(&material.surface).transmission, Scalar::Constant(1.0));
    assert!(warnings.contains("drawn as thin walls: 'glass'"), "{warnings}");

    let coat = json!({"KHR_materials_clearcoat": {"clearcoatFactor": 1.0}});
    assert!(standard(&material_with(&clear(0.0, &smooth, coat.clone())).0.surface).coat.is_some());
    let (material, warnings) = material_with(&clear(1.0, &smooth, coat));
    assert!(matches!(material.surface, Surface::Dielectric { .. }));
    assert!(warnings.contains("clear coats of solid glass are left out: 'glass'"), "{warnings}");
}

#[test]
fn an_index_of_zero_is_infinite_and_one_below_one_is_none() {
    let with = |ior: f32| {
        material_with(&json!({
            "pbrMetallicRoughness": {"metallicFactor": 0.0}, "extensions": {"KHR_materials_ior": {"ior": ior}}
        }))
    };
    let (infinite, warnings) = with(0.0);
    let ior = standard(&infinite.surface).ior;
    assert!(((ior - 1.0) / (ior + 1.0)).powi(2) > 0.99 && warnings.is_empty());
    for bad in [0.5, -1.5, -0.001] {
        let (material, warnings) = with(bad);
        assert_eq!(standard(&material.surface).ior, 1.5);
        assert!(warnings.contains("an index of refraction below 1"), "{warnings}");
    }
    let smooth = json!({"metallicFactor": 0.0, "roughnessFactor": 0.3});
    for ior in [0.0, 0.3, 1.0, 1e30] {
        let (material, _) = material_with(&clear(1.0, &smooth, json!({"KHR_materials_ior": {"ior": ior}})));
        let Surface::Dielectric { ior, .. } = material.surface else { panic!() };
        assert!((1.0001..=10.0).contains(&ior), "{ior}");
    }
}

#[test]
fn anisotropy_has_strength_rotation_and_texture() {
    let material = json!({"extensions": {"KHR_materials_anisotropy": {
        "anisotropyStrength": 0.6, "anisotropyRotation": 1.5, "anisotropyTexture": {"index": 0}
    }}});
    let scene = scene_with(&material, &[ramp()]);
    let anisotropy = standard(&scene.materials[0].surface).finish.anisotropy;
    assert_eq!((anisotropy.strength, anisotropy.rotation_rad, anisotropy.texture), (0.6, 1.5, Some(0)));
    let TextureKind::Image(image) = &scene.textures[0].kind else { panic!() };
    assert_eq!(image.transfer, Transfer::Linear);
}

#[test]
fn unlit_materials_emit_their_base_colour_and_reflect_nothing() {
    let (material, warnings) = material_with(&json!({
        "pbrMetallicRoughness": {"baseColorFactor": [0.2, 0.4, 0.6, 1.0]}, "emissiveFactor": [1.0, 1.0, 1.0],
        "extensions": {"KHR_materials_unlit": {}}
    }));
    assert_eq!(material.surface, Surface::Diffuse { albedo: Color::Constant(Vec3::ZERO) });
    assert_eq!(material.emission, Color::Constant(Vec3::new(0.2, 0.4, 0.6)));
    assert_eq!(warnings, "");
}

#[test]
fn alpha_makes_holes_where_the_mode_says_so() {
    let cutout = |mode: &str, alpha: f32, textured: bool| {
        let mut material =
            json!({"alphaMode": mode, "pbrMetallicRoughness": {"baseColorFactor": [1.0, 1.0, 1.0, alpha]}});
        if textured {
            material["pbrMetallicRoughness"]["baseColorTexture"] = json!({"index": 0});
        }
        scene_with(&material, &[ramp()]).materials[0].cutout
    };
    assert_eq!(cutout("OPAQUE", 0.0, true), None);
    assert_eq!(cutout("BLEND", 1.0, false), None);
    assert_eq!(cutout("MASK", 0.6, false), None);
    assert_eq!(cutout("MASK", 0.4, false), Some(Cutout { opacity: Scalar::Constant(0.4), threshold: Some(0.5) }));
    assert_eq!(cutout("BLEND", 0.25, false), Some(Cutout { opacity: Scalar::Constant(0.25), threshold: None }));
    let opacity = Scalar::Textured { texture: 0, channel: 3, factor: 0.5, squared: false };
    assert_eq!(cutout("BLEND", 0.5, true), Some(Cutout { opacity, threshold: None }));
}

#[test]
fn samplers_and_transforms_belong_to_the_texture_and_share_its_texels() {
    let mut document = triangle();
    add_images(&mut document, &[ramp()]);
    document["samplers"] = json!([{"wrapS": 33071, "wrapT": 33648, "magFilter": 9728}]);
    document["textures"] = json!([{"source": 0, "sampler": 0}, {"source": 0}]);
    document["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = json!({"index": 0});
    document["materials"][0]["emissiveFactor"] = json!([1.0, 1.0, 1.0]);
    document["materials"][0]["emissiveTexture"] =
        json!({"index": 1, "extensions": {"KHR_texture_transform": {"offset": [0.5, 0.25]}}});
    document["materials"][0]["normalTexture"] = json!({"index": 1, "scale": 0.5});
    document["extensionsRequired"] = json!(["KHR_texture_transform"]);
    let scene = load(&document).unwrap();
    let image =
        |texture: &Texture| if let TextureKind::Image(image) = &texture.kind { image.clone() } else { panic!() };
    let images: Vec<_> = scene.textures.iter().map(image).collect();
    assert_eq!(images.len(), 3);
    assert_eq!((images[0].wrap, images[0].filter), ([Wrap::Clamp, Wrap::Mirror], TexelFilter::Nearest));
    assert_eq!((images[1].wrap, images[1].filter), ([Wrap::Repeat; 2], TexelFilter::Linear));
    assert_eq!(scene.textures[1].texture_from_surface.translation, Vec2::new(0.5, 0.25));
    assert_eq!(
        (images[2].transfer, scene.materials[0].normal_map),
        (Transfer::Linear, Some(NormalMap { texture: 2, scale: glam::Vec2::splat(0.5) }))
    );
    assert!(images.iter().all(|image| std::sync::Arc::ptr_eq(&image.texels, &images[0].texels)));
}

#[test]
fn different_texture_coordinates_in_one_material_are_warned_about() {
    let material = json!({"name": "two", "pbrMetallicRoughness": {
        "baseColorTexture": {"index": 0}, "metallicRoughnessTexture": {"index": 0, "texCoord": 1}
    }});
    let scene = scene_with(&material, &[ramp()]);
    assert!(
        scene
            .warnings
            .iter()
            .any(|line| line.contains("several sets of texture coordinates") && line.contains("'two'"))
    );
}

#[test]
fn what_is_not_supported_is_named_once_each() {
    let (_, warnings) = material_with(&json!({
        "name": "car",
        "extensions": {
            "KHR_materials_clearcoat": {"clearcoatFactor": 1.0, "clearcoatNormalTexture": {"index": 0}},
            "KHR_materials_sheen": {}, "KHR_materials_iridescence": {}, "KHR_materials_diffuse_transmission": {},
            "KHR_materials_pbrSpecularGlossiness": {}
        }
    }));
    for what in ["normal maps of clear coats are", "sheen is", "iridescence is", "diffuse transmission is"] {
        assert_eq!(warnings.matches(&format!("{what} left out: 'car'")).count(), 1, "{warnings}");
    }
    assert_eq!(warnings.lines().count(), 5, "{warnings}");
}

/// The lights of the triangle's scene with one node for each of these.
fn lights_of(lights: &Value) -> Vec<Light> {
    let mut document = triangle();
    document["extensions"]["KHR_lights_punctual"]["lights"] = lights.clone();
    for index in 0..lights.as_array().unwrap().len() {
        let nodes = document["nodes"].as_array_mut().unwrap();
        // Looks along -Y and is scaled, which must not count.
        nodes.push(json!({
            "translation": [1.0, 2.0, 3.0], "rotation": [-std::f32::consts::FRAC_1_SQRT_2, 0.0, 0.0, std::f32::consts::FRAC_1_SQRT_2],
            "scale": [3.0, 3.0, 3.0], "extensions": {"KHR_lights_punctual": {"light": index}}
        }));
        let last = nodes.len() - 1;
        document["nodes"][0]["children"].as_array_mut().unwrap().push(json!(last));
    }
    let scene = load(&document).unwrap();
    assert_eq!(scene.environment, Environment::Black);
    scene.lights
}

#[test]
fn punctual_lights_shine_along_minus_z_of_their_node() {
    let lights = lights_of(&json!([
        {"type": "point", "intensity": 20.0, "color": [1.0, 0.5, 0.25]},
        {"type": "spot", "intensity": 3.0, "spot": {"innerConeAngle": 0.2, "outerConeAngle": 0.4}},
        {"type": "directional", "intensity": 5.0},
        {"type": "spot", "spot": {"innerConeAngle": 0.4, "outerConeAngle": 0.4}}
    ]));
    let at = Vec3::new(11.0, 2.0, 3.0);
    let Light::Point { position, intensity } = lights[0] else { panic!() };
    assert!(position.distance(at) < 1e-5 && intensity == Vec3::new(20.0, 10.0, 5.0));
    let Light::Spot { position, axis, intensity, inner_rad, outer_rad, falloff } = lights[1] else { panic!() };
    assert!(position.distance(at) < 1e-5 && axis.distance(Vec3::NEG_Y) < 1e-6, "{axis}");
    assert_eq!((intensity, inner_rad, outer_rad, falloff), (Vec3::splat(3.0), 0.2, 0.4, Falloff::SquaredInCosine));
    let Light::Directional { direction, irradiance } = lights[2] else { panic!() };
    assert!(direction.distance(Vec3::NEG_Y) < 1e-6 && irradiance == Vec3::splat(5.0));
    let Light::Spot { inner_rad, outer_rad, .. } = lights[3] else { panic!() };
    assert!(inner_rad < outer_rad && inner_rad > 0.399);
}
