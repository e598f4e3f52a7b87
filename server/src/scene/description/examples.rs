//! The examples of docs/scene-format.md, held against the code.

use super::super::Scene;
use super::parse;
use std::collections::BTreeSet;

const DOCUMENT: &str = include_str!("../../../../docs/scene-format.md");

/// The toml blocks of the document.
fn examples() -> impl Iterator<Item = &'static str> {
    DOCUMENT.split("```toml\n").skip(1).map(|block| block.split("```").next().unwrap())
}

/// A folder with the files that the examples name.
fn folder_with_files() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    image::RgbImage::from_pixel(2, 2, image::Rgb([100; 3])).save(path("photograph.png")).unwrap();
    image::Rgb32FImage::from_pixel(4, 2, image::Rgb([0.5; 3])).save(path("sky.hdr")).unwrap();
    let vase = r#"{"asset": {"version": "2.0"}, "materials": [{"name": "Body"}]}"#;
    let mut bytes = b"glTF\x02\0\0\0".to_vec();
    let json = format!("{vase:<64}");
    bytes.extend((json.len() as u32 + 20).to_le_bytes());
    bytes.extend((json.len() as u32).to_le_bytes());
    bytes.extend(b"JSON");
    bytes.extend(json.as_bytes());
    std::fs::write(path("vase.glb"), bytes).unwrap();
    let scan = "NRRD0004\ntype: int16\ndimension: 3\nsizes: 2 1 1\nendian: little\nencoding: raw\n\n\0\0\x01\0";
    std::fs::write(path("scan.nrrd"), scan).unwrap();
    folder
}

#[test]
fn every_example_loads() {
    let folder = folder_with_files();
    assert!(examples().count() >= 10);
    for (index, text) in examples().enumerate() {
        let path = folder.path().join(format!("{index}.toml"));
        std::fs::write(&path, text).unwrap();
        Scene::load(path.to_str().unwrap()).unwrap_or_else(|error| panic!("{error}\n{text}"));
    }
}

/// An unknown key makes the parser list the known ones: each of them stands in the document.
#[test]
fn every_key_is_documented() {
    let with_kind = |section: &str, kinds: &[&str]| -> Vec<String> {
        kinds.iter().map(|kind| format!("[[{section}]]\nkind = \"{kind}\"\nno_such_key = 1\n")).collect()
    };
    let mut texts = vec!["no_such_key = 1".to_owned(), "[head]\nno_such_key = 1".to_owned()];
    texts.push("[[motion]]\nno_such_key = 1".to_owned());
    texts.push("[[motion]]\nlight = 1\nkeys = [{ no_such_key = 1 }]".to_owned());
    texts.push("[[camera]]\nno_such_key = 1".to_owned());
    texts.push("[environment]\nkind = \"image\"\nno_such_key = 1".to_owned());
    texts.push(
        "[[shape]]\nkind = \"box\"\nmaterial = \"a\"\nsize = [1, 1, 1]\ntransform = { no_such_key = 1 }".to_owned(),
    );
    texts
        .push("[[shape]]\nkind = \"water\"\nmaterial = \"a\"\nsize = [1, 1]\nwaves = [{ no_such_key = 1 }]".to_owned());
    texts.extend(with_kind(
        "texture",
        &["image", "checker", "stripes", "wood", "tiles", "marble", "rings", "hills", "none"],
    ));
    texts.extend(with_kind("material", &["diffuse", "mirror", "conductor", "dielectric", "pane", "standard", "none"]));
    texts.extend(with_kind("light", &["point", "spot", "directional", "none"]));
    let nested = |keys: &str| format!("[[material]]\nname = \"a\"\nkind = \"standard\"\nbase = 1\n{keys}");
    texts.push(nested("coat = { no_such_key = 1 }"));
    texts.push(nested("cutout = { no_such_key = 1 }"));
    texts.push(nested("distribution = \"none\""));
    let spot = "[[light]]\nkind = \"spot\"\nposition = [0, 0, 0]\nlook_at = [1, 0, 0]\nintensity = 1";
    texts.push(format!("{spot}\nfalloff = \"none\""));
    let image = "[[texture]]\nname = \"a\"\nkind = \"image\"\nfile = \"a\"";
    texts.extend([format!("{image}\nwrap = \"none\""), format!("{image}\nfilter = \"none\"")]);
    texts.extend(with_kind("shape", &["sphere", "box", "quad", "cylinder", "water", "mesh", "none"]));
    texts.push("[[volume]]\nno_such_key = 1".to_owned());
    texts.push("[[volume]]\nup = \"none\"".to_owned());
    texts.extend(
        ["file", "cloud", "clouds", "phantom", "shells", "none"]
            .map(|kind| format!("[[volume]]\nname = \"a\"\nsource = {{ kind = \"{kind}\", no_such_key = 1 }}\n")),
    );
    let mut keys = BTreeSet::new();
    for text in texts {
        let line = parse("x.toml", &text).unwrap_err().to_string();
        let (_, known) = line.split_once("expected").unwrap_or_else(|| panic!("{line}"));
        keys.extend(known.split('`').skip(1).step_by(2).map(str::to_owned));
    }
    assert!(keys.len() > 80, "{keys:?}");
    for key in keys {
        let written =
            [format!("`{key}`"), format!("`\"{key}\"`"), format!("{key} ="), format!("[[{key}]]"), format!("[{key}]")];
        assert!(written.iter().any(|form| DOCUMENT.contains(form)), "{key} is not in docs/scene-format.md");
    }
}
