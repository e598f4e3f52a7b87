//! Files that are wrong on purpose: each gives one clear line, or a picture of finite numbers.

use super::*;
use crate::integrator::PathTracer;
use crate::testing::{render, settings};
use image::{Rgba, RgbaImage};
use std::sync::Arc;
use warplight_protocol::{Camera, ImageSize};

#[test]
fn texture_indices_out_of_range_are_refused_in_every_place() {
    for pointer in [
        "/pbrMetallicRoughness/baseColorTexture",
        "/pbrMetallicRoughness/metallicRoughnessTexture",
        "/normalTexture",
        "/emissiveTexture",
        "/extensions/KHR_materials_specular/specularTexture",
        "/extensions/KHR_materials_transmission/transmissionTexture",
        "/extensions/KHR_materials_clearcoat/clearcoatTexture",
        "/extensions/KHR_materials_anisotropy/anisotropyTexture",
    ] {
        let line = error_with(|document| {
            let mut material = json!({
                "pbrMetallicRoughness": {}, "emissiveFactor": [1, 1, 1], "extensions": {
                    "KHR_materials_specular": {}, "KHR_materials_transmission": {"transmissionFactor": 1},
                    "KHR_materials_clearcoat": {"clearcoatFactor": 1},
                    "KHR_materials_anisotropy": {"anisotropyStrength": 1}
                }
            });
            let (parent, key) = pointer.rsplit_once('/').unwrap();
            let parent = if parent.is_empty() { &mut material } else { material.pointer_mut(parent).unwrap() };
            parent[key] = json!({"index": 77});
            document["materials"][0] = material;
            add_images(document, &[RgbaImage::from_pixel(2, 2, Rgba([9; 4]))]);
        });
        assert!(line.contains("exture") || line.contains("index"), "{pointer}: {line}");
    }
    let with = |texture: Value| {
        error_with(|document| {
            document["materials"][0]["extensions"] =
                json!({"KHR_materials_clearcoat": {"clearcoatFactor": 1, "clearcoatTexture": texture}});
        })
    };
    assert!(with(json!({"index": 3})).contains("texture 3: expected one of 0 textures"));
    assert!(with(json!({"index": -1})).contains("material 'paint': clearcoatTexture: expected an object"));
    assert!(with(json!("a.png")).contains("material 'paint': clearcoatTexture: expected an object"));
}

#[test]
fn a_texture_without_its_image_is_refused() {
    error_with(|document| {
        document["textures"] = json!([{}]);
        document["materials"][0]["normalTexture"] = json!({"index": 0});
    });
    error_with(|document| {
        document["textures"] = json!([{"source": 4}]);
        document["materials"][0]["normalTexture"] = json!({"index": 0});
    });
    error_with(|document| {
        add_images(document, &[RgbaImage::from_pixel(2, 2, Rgba([9; 4]))]);
        document["textures"] = json!([{"source": 0, "sampler": 4}]);
        document["materials"][0]["normalTexture"] = json!({"index": 0});
    });
}

#[test]
fn numbers_of_extensions_that_are_none_are_refused() {
    let line = error_with(|document| {
        document["materials"][0]["extensions"] = json!({"KHR_materials_clearcoat": {"clearcoatFactor": "much"}});
    });
    assert!(line.contains("material 'paint': clearcoatFactor: expected a number, found \"much\""), "{line}");
}

#[test]
fn lights_that_are_none_are_refused() {
    let with = |light: &Value| {
        error_with(|document| {
            document["extensions"]["KHR_lights_punctual"]["lights"] = json!([light]);
            document["nodes"][1]["extensions"]["KHR_lights_punctual"]["light"] = json!(0);
        })
    };
    assert!(with(&json!({"type": "point", "intensity": -1.0})).contains("light 'node 1': expected an intensity"));
    assert!(with(&json!({"type": "point", "intensity": 1e30})).contains("light 'node 1': expected an intensity"));
    let cone = |inner: f32, outer: f32| {
        with(&json!({"type": "spot", "spot": {"innerConeAngle": inner, "outerConeAngle": outer}}))
    };
    assert!(cone(-0.1, 0.5).contains("innerConeAngle") && cone(0.1, 3.0).contains("innerConeAngle"));
    assert!(cone(0.0, 0.0).contains("innerConeAngle"));
    with(&json!({"type": "spot"}));
    with(&json!({"type": "lamp"}));
    error_with(|document| document["nodes"][1]["extensions"]["KHR_lights_punctual"]["light"] = json!(3));
}

#[test]
fn an_image_that_claims_to_be_huge_is_refused() {
    let mut bytes = Vec::new();
    let image = RgbaImage::from_pixel(2, 2, Rgba([9; 4]));
    image.write_to(&mut std::io::Cursor::new(&mut bytes), image::ImageFormat::Png).unwrap();
    for (width, height) in [(60_000_u32, 60_000_u32), (16_384, 16_384), (u32::MAX, 1)] {
        let mut claimed = bytes.clone();
        claimed[16..20].copy_from_slice(&width.to_be_bytes());
        claimed[20..24].copy_from_slice(&height.to_be_bytes());
        // The checksum of the header, so that nothing else is wrong with it.
        let checksum = crc32(&claimed[12..29]).to_be_bytes();
        claimed[29..33].copy_from_slice(&checksum);
        let line = error_with(|document| {
            document["images"] = json!([{"uri": format!("data:image/png;base64,{}", STANDARD.encode(&claimed))}]);
            document["textures"] = json!([{"source": 0}]);
            document["materials"][0]["normalTexture"] = json!({"index": 0});
        });
        assert!(line.contains("image 0: "), "{line}");
    }
}

/// ISO 3309, as PNG has it.
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |sum, &byte| {
        (0..8).fold(sum ^ u32::from(byte), |sum, _| if sum & 1 == 1 { sum >> 1 ^ 0xedb8_8320 } else { sum >> 1 })
    })
}

#[test]
fn a_million_empty_nodes_are_refused_and_as_many_as_the_limit_load() {
    let with = |count: usize| {
        let mut document = triangle();
        let nodes = document["nodes"].as_array_mut().unwrap();
        nodes.extend(std::iter::repeat_n(json!({}), count));
        document["scenes"][0]["nodes"] = (0..1).chain(3..3 + count).collect();
        load(&document)
    };
    assert!(with(1_000_000).unwrap_err().to_string().contains("at most 100000"));
    assert_eq!(with(99_000).unwrap().mesh.triangles.len(), 1);
}

#[test]
fn triangles_without_area_are_dropped_with_a_warning() {
    let mut document = triangle();
    let flat = [0.0_f32, 0.0, 0.0, 1.0, 0.0, 0.0, 2.0, 0.0, 0.0];
    let bytes: Vec<u8> = flat.iter().flat_map(|v| v.to_le_bytes()).chain([0, 0, 1, 0, 2, 0]).collect();
    document["buffers"][0]["uri"] = json!(format!("data:;base64,{}", STANDARD.encode(bytes)));
    let scene = load(&document).unwrap();
    assert!(scene.mesh.triangles.is_empty());
    assert!(scene.warnings.iter().any(|line| line.contains("1 triangles without area are dropped")));
    assert_finite(scene);
}

/// Extreme numbers in every place of a material.
#[test]
fn extreme_materials_give_finite_pictures() {
    for number in [-1e30, -1.0, 0.0, 1e-30, 1e30] {
        let mut document = triangle();
        add_images(&mut document, &[RgbaImage::from_fn(2, 2, |x, y| Rgba([x as u8 * 255, y as u8 * 255, 0, 9]))]);
        let texture = json!({"index": 0, "extensions": {"KHR_texture_transform": {
            "offset": [number, number], "rotation": number, "scale": [number, number]
        }}});
        let vector = json!([number, number, number]);
        document["materials"][0] = json!({
            "alphaMode": "MASK", "alphaCutoff": number,
            "pbrMetallicRoughness": {
                "baseColorFactor": [number, number, number, number], "metallicFactor": number,
                "roughnessFactor": number, "metallicRoughnessTexture": texture, "baseColorTexture": texture
            },
            "normalTexture": {"index": 0, "scale": number},
            "extensions": {
                "KHR_materials_ior": {"ior": number},
                "KHR_materials_specular": {"specularFactor": number, "specularColorFactor": vector},
                "KHR_materials_clearcoat": {"clearcoatFactor": number, "clearcoatRoughnessFactor": number},
                "KHR_materials_anisotropy": {"anisotropyStrength": number, "anisotropyRotation": number},
                "KHR_materials_transmission": {"transmissionFactor": number},
                "KHR_materials_dispersion": {"dispersion": number},
                "KHR_materials_volume": {
                    "thicknessFactor": number, "attenuationDistance": number, "attenuationColor": vector
                }
            }
        });
        assert_finite(load(&document).unwrap());
    }
}

/// Renders it and counts samples that are no finite number; there are none.
fn assert_finite(scene: Scene) {
    let (pose, vertical_fov_rad) = (scene.cameras[0].pose, scene.cameras[0].vertical_fov_rad);
    let size = ImageSize::new(12, 12);
    let camera = Camera::symmetric(vertical_fov_rad, size);
    let image = render(&PathTracer::new(Arc::new(scene)), &camera, &pose, &settings(4, 6, 1));
    assert!(image.radiance.iter().all(|radiance| radiance.is_finite()));
}
