//! A scene looks the same wherever it stands in the world, and at whatever scale.

use super::PathTracer;
use crate::film::Image;
use crate::scene::Scene;
use crate::testing::{render, settings};
use base64::Engine;
use glam::{DVec3, Vec3};
use std::path::Path;
use std::sync::Arc;
use warplight_protocol::{Camera, ImageSize};

/// A box, a ball of glass and a lamp over a floor, moved and scaled.
fn toml(shift: DVec3, scale: f64) -> String {
    let at = |x: f64, y: f64, z: f64| {
        let [x, y, z] = (DVec3::new(x, y, z) * scale + shift).to_array();
        format!("[{x:?}, {y:?}, {z:?}]")
    };
    let along = |x: f64, y: f64, z: f64| format!("[{:?}, {:?}, {:?}]", x * scale, y * scale, z * scale);
    format!(
        "[[camera]]\nname = \"a\"\nposition = {}\nlook_at = {}\n\
         [environment]\nkind = \"gradient\"\nzenith = 0.5\nhorizon = 0.2\nnadir = 0.1\n\
         [[material]]\nname = \"clay\"\nkind = \"diffuse\"\nalbedo = [0.7, 0.5, 0.3]\n\
         [[material]]\nname = \"lamp\"\nkind = \"diffuse\"\nalbedo = 0\nemission = 5\n\
         [[material]]\nname = \"glass\"\nkind = \"dielectric\"\nior = 1.5\n\
         [[shape]]\nkind = \"quad\"\nmaterial = \"clay\"\ncorner = {}\nedge_u = {}\nedge_v = {}\n\
         [[shape]]\nkind = \"quad\"\nmaterial = \"lamp\"\ncorner = {}\nedge_u = {}\nedge_v = {}\n\
         [[shape]]\nkind = \"box\"\nmaterial = \"clay\"\nsize = [1, 0.5, 0.75]\n\
         transform = {{ scale = {scale:?}, rotate_deg = [0, 30, 0], translate = {} }}\n\
         [[shape]]\nkind = \"sphere\"\nmaterial = \"glass\"\ncentre = {}\nradius = {:?}\n",
        at(0.0, 1.5, 4.0),
        at(0.0, 0.5, 0.0),
        at(-3.0, 0.0, 3.0),
        along(6.0, 0.0, 0.0),
        along(0.0, 0.0, -6.0),
        at(-0.5, 2.5, -0.5),
        along(1.0, 0.0, 0.0),
        along(0.0, 0.0, 1.0),
        at(0.75, 0.25, 0.5),
        at(-0.75, 0.5, 0.25),
        0.5 * scale,
    )
}

fn picture(path: &Path) -> Image {
    let scene = Scene::load(&path.to_string_lossy()).unwrap();
    let view = scene.cameras[0].clone();
    let camera = Camera::symmetric(view.vertical_fov_rad, ImageSize::new(48, 32));
    render(&PathTracer::new(Arc::new(scene)), &camera, &view.pose, &settings(16, 8, 5))
}

fn picture_of_toml(shift: DVec3, scale: f64) -> Image {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.toml");
    std::fs::write(&path, toml(shift, scale)).unwrap();
    picture(&path)
}

/// Root mean square of the difference over the mean.
fn difference(a: &Image, b: &Image) -> f32 {
    let squares: f32 = a.radiance.iter().zip(&b.radiance).map(|(a, b)| (*a - *b).length_squared()).sum();
    let mean = a.radiance.iter().sum::<Vec3>().length() / a.radiance.len() as f32;
    (squares / a.radiance.len() as f32).sqrt() / mean
}

#[test]
fn a_scene_ten_kilometres_away_is_the_same_to_the_bit() {
    let here = picture_of_toml(DVec3::ZERO, 1.0);
    assert!(here.radiance.iter().any(|radiance| radiance.max_element() > 0.1));
    let there = picture_of_toml(DVec3::new(10_000.0, 0.0, 10_000.0), 1.0);
    assert_eq!(here.radiance, there.radiance);
}

/// Rounding moves an edge by about 1e-6 of a pixel's reach, and so changes a sample in a million by as much as the
/// picture has contrast (10), of 25 000 samples: the difference is mostly that of smooth shading, 1e-5.
#[test]
fn a_scene_looks_the_same_at_every_scale() {
    let here = picture_of_toml(DVec3::ZERO, 1.0);
    for scale in [1e-3, 1e4 / 4.0] {
        let difference = difference(&here, &picture_of_toml(DVec3::ZERO, scale));
        assert!(difference < 1e-2, "{scale}: {difference}");
    }
    // A power of two rounds nothing at all.
    assert_eq!(here.radiance, picture_of_toml(DVec3::ZERO, 1.0 / 1024.0).radiance);
}

fn gltf(shift: DVec3) -> String {
    let corners: [f32; 12] = [-1.0, 0.0, 1.0, 1.0, 0.0, 1.0, 1.0, 0.0, -1.0, -1.0, 0.0, -1.0];
    let mut bytes: Vec<u8> = corners.iter().flat_map(|value| value.to_le_bytes()).collect();
    bytes.extend([0_u16, 1, 2, 0, 2, 3].iter().flat_map(|value| value.to_le_bytes()));
    let data = base64::engine::general_purpose::STANDARD.encode(&bytes);
    let [x, y, z] = shift.to_array();
    serde_json::json!({
        "asset": { "version": "2.0" },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [
            { "translation": [x, y, z], "children": [1, 2, 3] },
            { "mesh": 0 },
            { "mesh": 1, "translation": [0.25, 0.5, 0.125], "scale": [0.25, 0.25, 0.25] },
            { "camera": 0, "translation": [0.0, 1.0, 3.0] },
        ],
        "cameras": [{ "type": "perspective", "perspective": { "yfov": 1.0, "znear": 0.1 } }],
        "meshes": [
            { "primitives": [{ "attributes": { "POSITION": 0 }, "indices": 1, "material": 0 }] },
            { "primitives": [{ "attributes": { "POSITION": 0 }, "indices": 1, "material": 1 }] },
        ],
        "materials": [
            { "extensions": { "KHR_materials_specular": { "specularFactor": 0.0 } } },
            { "emissiveFactor": [1.0, 0.5, 0.25], "doubleSided": true,
              "extensions": { "KHR_materials_specular": { "specularFactor": 0.0 } } },
        ],
        "extensionsUsed": ["KHR_materials_specular"],
        "accessors": [
            { "bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [-1, 0, -1], "max": [1, 0, 1] },
            { "bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR" },
        ],
        "bufferViews": [
            { "buffer": 0, "byteOffset": 0, "byteLength": 48 },
            { "buffer": 0, "byteOffset": 48, "byteLength": 12 },
        ],
        "buffers": [{ "byteLength": 60, "uri": format!("data:application/octet-stream;base64,{data}") }],
    })
    .to_string()
}

#[test]
fn a_gltf_node_may_stand_ten_kilometres_away() {
    let folder = tempfile::tempdir().unwrap();
    let [here, there] = [DVec3::ZERO, DVec3::new(10_000.0, 0.0, 10_000.0)].map(|shift| {
        let path = folder.path().join("a.gltf");
        std::fs::write(&path, gltf(shift)).unwrap();
        picture(&path)
    });
    assert!(here.radiance.iter().any(|radiance| radiance.max_element() > 0.1));
    assert_eq!(here.radiance, there.radiance);
}
