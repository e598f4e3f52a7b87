//! glTF files as they should be, as they should not be, and as they are found outside.

mod hostile;
mod materials;

use super::super::{Color, Light, Material, Scene, SceneError, Surface, TextureKind};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use glam::{DVec3, Vec3};
use serde_json::{Value, json};
use std::path::Path;

/// A triangle in the plane z = 0 with a camera two metres before it.
fn triangle() -> Value {
    let mut bytes: Vec<u8> =
        [0.0_f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0].iter().flat_map(|v| v.to_le_bytes()).collect();
    bytes.extend([0_u16, 1, 2].iter().flat_map(|v| v.to_le_bytes()));
    let uri = format!("data:application/octet-stream;base64,{}", STANDARD.encode(&bytes));
    json!({
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [
            {"children": [1, 2], "translation": [10.0, 0.0, 0.0]},
            {"mesh": 0, "scale": [2.0, 2.0, 2.0]},
            {"camera": 0, "name": "eye", "translation": [0.0, 0.0, 2.0]}
        ],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 0.7, "znear": 0.1}}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
        "materials": [{"name": "paint", "pbrMetallicRoughness": {"baseColorFactor": [0.2, 0.4, 0.6, 1.0], "metallicFactor": 0.0}}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]},
            {"bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR"}
        ],
        "bufferViews": [{"buffer": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 6}],
        "buffers": [{"byteLength": 42, "uri": uri}]
    })
}

fn load(document: &Value) -> Result<Scene, SceneError> {
    load_bytes("x.gltf", document.to_string().as_bytes())
}

fn load_bytes(name: &str, bytes: &[u8]) -> Result<Scene, SceneError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).unwrap();
    Scene::load(path.to_str().unwrap())
}

/// The triangle with one thing changed, and the error that it gives.
fn error_with(change: impl Fn(&mut Value)) -> String {
    let mut document = triangle();
    change(&mut document);
    let line = load(&document).unwrap_err().to_string();
    assert!(line.contains("x.gltf: ") && !line.contains('\n'), "{line}");
    line
}

/// The triangle with another material: as read, and the warnings but that of the plain sky.
fn material_with(material: &Value) -> (Material, String) {
    let mut document = triangle();
    document["materials"][0] = material.clone();
    let scene = load(&document).unwrap();
    let warnings: Vec<_> = scene.warnings.iter().filter(|line| !line.contains("plain sky")).cloned().collect();
    (scene.materials[0].clone(), warnings.join("\n"))
}

/// Gives a document these images, as data, and a texture for each of them.
fn add_images(document: &mut Value, images: &[image::RgbaImage]) {
    let uri = |image: &image::RgbaImage| {
        let mut bytes = Vec::new();
        image.write_to(&mut std::io::Cursor::new(&mut bytes), image::ImageFormat::Png).unwrap();
        json!({"uri": format!("data:image/png;base64,{}", STANDARD.encode(&bytes))})
    };
    document["images"] = images.iter().map(uri).collect();
    document["textures"] = (0..images.len()).map(|index| json!({"source": index})).collect();
}

#[test]
fn nodes_place_meshes_and_cameras() {
    let scene = load(&triangle()).unwrap();
    assert_eq!(scene.name, "x");
    assert_eq!(scene.mesh.positions[1], Vec3::new(12.0, 0.0, 0.0));
    assert_eq!(scene.mesh.normals[0], Vec3::ZERO);
    assert_eq!(scene.cameras[0].name, "eye");
    assert!((scene.cameras[0].vertical_fov_rad - 0.7).abs() < 1e-6);
    assert_eq!(scene.head.position, DVec3::new(10.0, 0.0, 2.0));
    assert!((scene.head.orientation * DVec3::NEG_Z - DVec3::NEG_Z).length() < 1e-9);
}

#[test]
fn without_lights_there_is_a_plain_sky_and_a_warning() {
    let scene = load(&triangle()).unwrap();
    assert!(!scene.environment.is_black());
    assert!(scene.warnings.iter().any(|line| line.contains("lit by a plain sky")));
    assert_eq!(scene.warnings.len(), 1, "{:?}", scene.warnings);
}

#[test]
fn emission_shows_on_both_sides_only_where_the_material_does() {
    let emission = |double_sided: bool| {
        let mut document = triangle();
        document["materials"][0] = json!({
            "doubleSided": double_sided, "emissiveFactor": [1.0, 0.5, 0.25],
            "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 8.0}}
        });
        let scene = load(&document).unwrap();
        assert!(scene.environment.is_black());
        (scene.materials[0].emission, scene.materials[0].emission_two_sided)
    };
    assert_eq!(emission(false), (Color::Constant(Vec3::new(8.0, 4.0, 2.0)), false));
    assert!(emission(true).1);
}

#[test]
fn an_unknown_required_extension_is_refused_by_name() {
    let line = error_with(|d| d["extensionsRequired"] = json!(["KHR_draco_mesh_compression"]));
    assert!(line.ends_with("the required extension 'KHR_draco_mesh_compression' is not supported"), "{line}");
    let mut document = triangle();
    document["extensionsRequired"] = json!(["KHR_materials_ior"]);
    assert!(load(&document).is_ok());
}

#[test]
fn nodes_in_a_circle_or_with_two_parents_are_refused() {
    assert!(error_with(|d| d["nodes"][1]["children"] = json!([0])).contains("node 0: reached twice"));
    assert!(error_with(|d| d["nodes"][0]["children"] = json!([1, 1])).contains("node 1: reached twice"));
}

#[test]
fn a_deep_chain_of_nodes_needs_no_deep_stack() {
    let mut document = triangle();
    let chain: Vec<Value> = (0..50_000).map(|index| json!({"children": [index + 1]})).collect();
    document["nodes"] = Value::Array(chain);
    document["nodes"].as_array_mut().unwrap().push(json!({"mesh": 0}));
    assert_eq!(load(&document).unwrap().mesh.triangles.len(), 1);
}

#[test]
fn indices_out_of_range_are_refused() {
    // The third index becomes 9.
    let with_index_nine = |d: &mut Value| {
        let uri = d["buffers"][0]["uri"].as_str().unwrap().split(',').nth(1).unwrap().to_owned();
        let mut bytes = STANDARD.decode(uri).unwrap();
        bytes[40] = 9;
        d["buffers"][0]["uri"] = json!(format!("data:;base64,{}", STANDARD.encode(bytes)));
    };
    assert!(error_with(with_index_nine).contains("mesh 'mesh 0': index 9 with 3 vertices"));
    for (pointer, what) in [
        ("/meshes/0/primitives/0/material", "material"),
        ("/meshes/0/primitives/0/indices", "indices"),
        ("/nodes/1/mesh", "mesh"),
        ("/bufferViews/0/buffer", "buffer"),
        ("/accessors/0/bufferView", "bufferView"),
        ("/scene", "scene"),
        ("/nodes/2/camera", "camera"),
        ("/meshes/0/primitives/0/attributes/POSITION", "mesh 0"),
    ] {
        let line = error_with(|d| *d.pointer_mut(pointer).unwrap() = json!(77));
        assert!(line.contains(what), "{line}");
    }
}

#[test]
fn what_a_kind_promises_must_be_there() {
    error_with(|d| d["cameras"][0] = json!({"type": "perspective"}));
    error_with(|d| {
        d["cameras"][0] = json!({"type": "perspective", "orthographic": {"xmag": 1, "ymag": 1, "zfar": 1, "znear": 0}})
    });
    error_with(|d| d["nodes"][0]["extensions"] = json!({"KHR_lights_punctual": {"light": 0}}));
    error_with(|d| d["nodes"][0]["skin"] = json!(0));
    error_with(|d| {
        d["materials"][0]["extensions"] = json!({"KHR_materials_transmission": {"transmissionTexture": {"index": 3}}});
    });
    error_with(|d| {
        d["accessors"][0]["sparse"] =
            json!({"count": 1, "indices": {"bufferView": 0, "componentType": 5126}, "values": {"bufferView": 0}})
    });
    error_with(|d| d["accessors"][1]["type"] = json!("VEC2"));
    error_with(|d| d["asset"]["version"] = json!("1.0"));
}

#[test]
fn bytes_that_are_not_there_are_refused_before_they_are_allocated() {
    assert!(error_with(|d| d["accessors"][0]["count"] = json!(4)).contains("accessor 0: reaches beyond"));
    assert!(error_with(|d| d["accessors"][0]["count"] = json!(4_000_000_000_u32)).contains("at most"));
    assert!(error_with(|d| d["accessors"][0]["byteOffset"] = json!(u64::MAX)).contains("accessor 0: reaches beyond"));
    assert!(
        error_with(|d| d["bufferViews"][0]["byteOffset"] = json!(u64::MAX)).contains("buffer view 0: reaches beyond")
    );
    assert!(error_with(|d| d["buffers"][0]["byteLength"] = json!(43)).contains("43 bytes announced, 42 there"));
    assert!(error_with(|d| d["buffers"][0]["byteLength"] = json!(1_u64 << 40)).contains("at most"));
}

#[test]
fn vertices_that_are_no_number_are_refused() {
    let line = error_with(|d| {
        let bytes: Vec<u8> = [f32::NAN; 9].iter().flat_map(|v| v.to_le_bytes()).chain([0, 0, 1, 0, 2, 0]).collect();
        d["buffers"][0]["uri"] = json!(format!("data:;base64,{}", STANDARD.encode(bytes)));
    });
    assert!(line.contains("vertex 0: expected coordinates within"), "{line}");
}

#[test]
fn a_missing_texture_file_is_named() {
    let textured = |uri: &str| {
        error_with(|d| {
            d["images"] = json!([{"uri": uri}]);
            d["textures"] = json!([{"source": 0}]);
            d["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = json!({"index": 0});
        })
    };
    let folder = tempfile::tempdir().unwrap();
    let mut document = triangle();
    document["images"] = json!([{"uri": "paint.png"}]);
    document["textures"] = json!([{"source": 0}]);
    document["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = json!({"index": 0});
    let path = folder.path().join("x.gltf");
    std::fs::write(&path, document.to_string()).unwrap();
    let line = Scene::load(path.to_str().unwrap()).unwrap_err().to_string();
    assert!(line.contains("paint.png: No such file"), "{line}");
    image::RgbImage::from_pixel(2, 2, image::Rgb([255; 3])).save(folder.path().join("paint.png")).unwrap();
    let scene = Scene::load(path.to_str().unwrap()).unwrap();
    let TextureKind::Image(image) = &scene.textures[0].kind else { panic!() };
    assert_eq!((image.texels.width(), image.texels.height()), (2, 2));
    assert!(textured("../paint.png").contains("in the folder of the glTF file"));
    assert!(textured("data:image/png;base64,AAAA").contains("image 0: "));
    assert!(error_with(|d| d["images"] = json!([{}])).contains("image 0: expected a uri"));
}

fn glb(document: &Value) -> Vec<u8> {
    let mut json = document.to_string().into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut bytes = b"glTF".to_vec();
    bytes.extend(2_u32.to_le_bytes());
    bytes.extend((json.len() as u32 + 20).to_le_bytes());
    bytes.extend((json.len() as u32).to_le_bytes());
    bytes.extend(b"JSON");
    bytes.extend(json);
    bytes
}

#[test]
fn a_file_chopped_at_any_byte_is_one_clear_line() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.glb");
    let whole = glb(&triangle());
    for length in 0..=whole.len() {
        std::fs::write(&path, &whole[..length]).unwrap();
        match Scene::load(path.to_str().unwrap()) {
            Ok(_) => assert_eq!(length, whole.len()),
            Err(error) => assert!(!error.to_string().contains('\n'), "{error}"),
        }
    }
}

#[test]
fn a_file_with_any_byte_changed_loads_or_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.glb");
    let whole = glb(&triangle());
    for at in 0..whole.len() {
        for value in [0, b'9', b'}', 255] {
            let mut changed = whole.clone();
            changed[at] = value;
            std::fs::write(&path, &changed).unwrap();
            if let Err(error) = Scene::load(path.to_str().unwrap()) {
                assert!(!error.to_string().contains('\n'), "{error}");
            }
        }
    }
}

/// Real files: the folder with `scenes/*.glb` is named by WARPLIGHT_DATA.
#[test]
fn real_files_load() {
    let Some(data) = std::env::var_os("WARPLIGHT_DATA") else {
        eprintln!("skipped: real glTF files (WARPLIGHT_DATA is not set)");
        return;
    };
    let mut found = 0;
    for entry in std::fs::read_dir(Path::new(&data).join("scenes")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|extension| extension != "glb") {
            continue;
        }
        let scene = Scene::load(path.to_str().unwrap()).unwrap();
        eprintln!(
            "{}: {} triangles, {} materials, {} textures",
            scene.name,
            scene.mesh.triangles.len(),
            scene.materials.len(),
            scene.textures.len()
        );
        scene.warnings.iter().for_each(|line| eprintln!("  {line}"));
        let expected = if scene.name == "ClearCoatTest" { "normal maps of clear coats" } else { "lit by a plain sky" };
        assert!(scene.warnings.iter().all(|line| line.contains(expected)), "{:?}", scene.warnings);
        assert!(!scene.mesh.triangles.is_empty() && !scene.cameras.is_empty());
        if scene.name == "CornellBox" {
            assert_eq!(scene.mesh.triangles.len(), 38);
            assert!((scene.cameras[0].vertical_fov_rad.to_degrees() - 39.3077).abs() < 1e-3);
            assert!((scene.head.position - DVec3::new(2.78, 2.73, -8.0)).length() < 1e-5);
            assert_eq!(scene.warnings, Vec::<String>::new());
            let light = scene.materials.iter().find(|material| material.name == "light").unwrap();
            assert!(!light.emission_two_sided && !light.emission.is_black());
        }
        found += 1;
    }
    assert!(found > 0, "no .glb in {}", Path::new(&data).display());
}
