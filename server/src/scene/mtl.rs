//! Materials of Wavefront OBJ models (.mtl) as the nearest materials there are.
//!
//! | .mtl | here |
//! |---|---|
//! | `Kd`, `map_Kd` | Lambert reflection |
//! | `Ks` above 0 | a reflecting layer over it: reflectance at normal incidence `Ks`, alpha = sqrt(2 / (Ns + 2)), as wide as Blinn's lobe; smooth from Ns 1000 |
//! | `d` below 1 (or `Tr`) with `Ni` above 1 | a smooth dielectric |
//! | `d` below 1 otherwise, `map_d` | holes of that density |
//! | `Ke`, `map_Ke` | radiance, on both sides |
//!
//! Everything but Lambert reflection is an approximation of a format that has no physical meaning; a warning names
//! the materials. A missing file is a warning; its materials reflect one half.

use super::obj::{Model, plain_material};
use super::picture::texels;
use super::texture::ImageTexture;
use super::untrusted::{MAX_FILE_BYTES, MAX_IMAGE_BYTES, MAX_TOML_BYTES, check_limit, read_file};
use super::{
    Color, Cutout, Distribution, Finish, Material, Part, Scalar, SceneError, Standard, Surface, Texture, TextureKind,
    Transfer,
};
use glam::Vec3;
use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// What a .mtl file says about one material.
#[derive(Clone, Debug, PartialEq)]
struct Entry {
    diffuse: Vec3,
    specular: Vec3,
    exponent: f32,
    ior: f32,
    opacity: f32,
    emission: Vec3,
    diffuse_map: Option<String>,
    opacity_map: Option<String>,
    emission_map: Option<String>,
    /// Keys that are left out.
    ignored: Vec<&'static str>,
}

impl Default for Entry {
    fn default() -> Entry {
        Entry {
            diffuse: Vec3::splat(0.8),
            specular: Vec3::ZERO,
            exponent: 0.0,
            ior: 1.0,
            opacity: 1.0,
            emission: Vec3::ZERO,
            diffuse_map: None,
            opacity_map: None,
            emission_map: None,
            ignored: Vec::new(),
        }
    }
}

/// Gives `part` the materials that a model names, in the model's order.
pub(super) fn read(model_path: &Path, model: &Model, part: &mut Part) -> Result<(), SceneError> {
    let folder = model_path.parent().unwrap_or(Path::new(""));
    let mut entries: HashMap<String, Entry> = HashMap::new();
    for library in &model.libraries {
        let path = folder.join(library);
        match read_file(&path, MAX_TOML_BYTES) {
            Ok(bytes) => entries.extend(parse(&path.display().to_string(), &String::from_utf8_lossy(&bytes))?),
            Err(error) => part.warnings.push(format!("{error}: its materials reflect one half")),
        }
    }
    let file = model_path.display().to_string();
    let mut maps = Maps { folder, by_name: HashMap::new(), image_bytes: 0 };
    let mut told: BTreeMap<&'static str, Vec<String>> = BTreeMap::new();
    for name in &model.materials {
        let Some(entry) = entries.get(name) else {
            if !name.is_empty() && !model.libraries.is_empty() {
                told.entry("materials that no file has reflect one half").or_default().push(name.clone());
            }
            part.materials.push(if name.is_empty() {
                plain_material()
            } else {
                Material { name: name.clone(), ..plain_material() }
            });
            continue;
        };
        for what in entry.ignored.iter().chain(approximation(entry).iter()) {
            told.entry(*what).or_default().push(name.clone());
        }
        let material = material(name, entry, &mut maps, part)?;
        part.materials.push(material);
    }
    part.warnings.extend(told.into_iter().map(|(what, names)| {
        let named: Vec<String> = names.iter().take(3).map(|name| format!("'{}'", name.escape_debug())).collect();
        let more = if names.len() > 3 { format!(" and {} more", names.len() - 3) } else { String::new() };
        format!("{file}: {what}: {}{more}", named.join(", "))
    }));
    Ok(())
}

fn approximation(entry: &Entry) -> Option<&'static str> {
    if entry.opacity < 1.0 && entry.ior > 1.0 {
        Some("transparent .mtl materials become smooth dielectrics")
    } else if entry.specular != Vec3::ZERO {
        Some("highlights of .mtl materials become a rough reflecting layer")
    } else {
        None
    }
}

/// Images of maps, each read once.
struct Maps<'a> {
    folder: &'a Path,
    by_name: HashMap<(String, bool), Option<u32>>,
    image_bytes: u64,
}

impl Maps<'_> {
    /// The index of a map's texture; `None` where it cannot be read, which is a warning.
    fn texture(&mut self, name: &str, is_linear: bool, part: &mut Part) -> Result<Option<u32>, SceneError> {
        if let Some(&known) = self.by_name.get(&(name.to_owned(), is_linear)) {
            return Ok(known);
        }
        // Windows writes its own separators.
        let path: PathBuf = self.folder.join(name.replace('\\', "/"));
        let read = read_file(&path, MAX_FILE_BYTES).and_then(|bytes| texels(&path.display().to_string(), &bytes));
        let index = match read {
            Ok(texels) => {
                self.image_bytes += texels.bytes();
                check_limit(&path.display().to_string(), "bytes of images", MAX_IMAGE_BYTES, self.image_bytes)?;
                let mut image = ImageTexture::new(Arc::new(texels));
                if is_linear {
                    image.transfer = Transfer::Linear;
                }
                part.textures.push(Texture::new(TextureKind::Image(image)));
                Some(part.textures.len() as u32 - 1)
            }
            Err(error) => {
                part.warnings.push(format!("{error}: the map is left out"));
                None
            }
        };
        self.by_name.insert((name.to_owned(), is_linear), index);
        Ok(index)
    }
}

fn material(name: &str, entry: &Entry, maps: &mut Maps, part: &mut Part) -> Result<Material, SceneError> {
    let mut color = |factor: Vec3, map: &Option<String>, part: &mut Part| -> Result<Color, SceneError> {
        let texture = map.as_deref().map(|map| maps.texture(map, false, part)).transpose()?.flatten();
        Ok(texture.map_or(Color::Constant(factor), |texture| Color::Textured { texture, factor }))
    };
    let base = color(entry.diffuse, &entry.diffuse_map, part)?;
    // A map alone means what it shows.
    let emission =
        if entry.emission_map.is_some() && entry.emission == Vec3::ZERO { Vec3::ONE } else { entry.emission };
    let emission = color(emission, &entry.emission_map, part)?;
    let is_glass = entry.opacity < 1.0 && entry.ior > 1.0;
    let surface = if is_glass {
        Surface::Dielectric {
            ior: entry.ior.clamp(1.0001, 10.0),
            dispersion: 0.0,
            filter: Color::Constant(Vec3::ONE),
            absorption: Vec3::ZERO,
            finish: Finish::SMOOTH,
        }
    } else if entry.specular == Vec3::ZERO {
        Surface::Diffuse { albedo: base }
    } else {
        let alpha = if entry.exponent < SMOOTH_EXPONENT { (2.0 / (entry.exponent + 2.0)).sqrt() } else { 0.0 };
        Surface::Standard(Standard {
            base,
            metallic: Scalar::Constant(0.0),
            finish: Finish::isotropic(Distribution::Ggx, Scalar::Constant(alpha)),
            ior: 1.5,
            specular: Scalar::Constant(1.0),
            // An index of 1.5 reflects 0.04.
            specular_color: Color::Constant(entry.specular / 0.04),
            transmission: Scalar::Constant(0.0),
            coat: None,
        })
    };
    let hole = entry.opacity_map.as_deref().map(|map| maps.texture(map, true, part)).transpose()?.flatten();
    let opacity = match hole {
        Some(texture) => Some(Scalar::Textured { texture, channel: 0, factor: entry.opacity, squared: false }),
        None if entry.opacity < 1.0 && !is_glass => Some(Scalar::Constant(entry.opacity)),
        None => None,
    };
    let cutout = opacity.map(|opacity| Cutout { opacity, threshold: None });
    Ok(Material { emission, emission_two_sided: true, cutout, ..Material::new(name, surface) })
}

/// From this exponent on a highlight is a mirror image to the eye.
const SMOOTH_EXPONENT: f32 = 1000.0;
/// Brightest radiance, as in scene.toml.
const MAX_RADIANCE: f32 = 1e6;

fn parse(file: &str, text: &str) -> Result<HashMap<String, Entry>, SceneError> {
    let mut entries = HashMap::new();
    let mut current: Option<(String, Entry)> = None;
    for (index, line) in text.lines().enumerate() {
        let line = line.trim();
        let (keyword, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        let rest = rest.trim();
        if keyword == "newmtl" {
            entries.extend(current.replace((rest.to_owned(), Entry::default())));
            continue;
        }
        let Some((_, entry)) = &mut current else { continue };
        let number = |least: f32, most: f32| -> Result<f32, SceneError> {
            let value: Option<f32> = rest.split_whitespace().next().and_then(|word| word.parse().ok());
            value.filter(|value| (least..=most).contains(value)).ok_or_else(|| SceneError::Malformed {
                file: file.to_owned(),
                reason: format!("line {}: {keyword}: expected a number from {least} to {most}", index + 1),
            })
        };
        let color = |most: f32| -> Result<Vec3, SceneError> {
            let channels: Vec<f32> = rest.split_whitespace().map(|word| word.parse().unwrap_or(f32::NAN)).collect();
            let color = match channels[..] {
                [grey] => Some(Vec3::splat(grey)),
                [red, green, blue, ..] => Some(Vec3::new(red, green, blue)),
                _ => None,
            };
            // Exporters round to values a little above 1.
            color.filter(|c| c.cmpge(Vec3::ZERO).all() && c.cmple(Vec3::splat(most)).all()).ok_or_else(|| {
                SceneError::Malformed {
                    file: file.to_owned(),
                    reason: format!(
                        "line {}: {keyword}: expected a colour of one or three numbers from 0 to {most}",
                        index + 1
                    ),
                }
            })
        };
        // Options come before the name of a map; the name may have spaces where there are none.
        let map = || {
            if rest.starts_with('-') { rest.rsplit(char::is_whitespace).next() } else { Some(rest) }.map(str::to_owned)
        };
        match keyword {
            "Kd" => entry.diffuse = color(MAX_RADIANCE)?.min(Vec3::ONE),
            "Ks" => entry.specular = color(MAX_RADIANCE)?.min(Vec3::ONE),
            "Ke" => entry.emission = color(MAX_RADIANCE)?,
            "Ns" => entry.exponent = number(0.0, f32::MAX)?,
            "Ni" => entry.ior = number(0.0, f32::MAX)?,
            "d" => entry.opacity = number(0.0, f32::MAX)?.min(1.0),
            "Tr" => entry.opacity = 1.0 - number(0.0, f32::MAX)?.min(1.0),
            "map_Kd" => entry.diffuse_map = map(),
            "map_d" => entry.opacity_map = map(),
            "map_Ke" => entry.emission_map = map(),
            "map_Ks" | "map_Ns" => entry.ignored.push("maps of highlights are left out"),
            "bump" | "map_bump" | "map_Bump" | "norm" | "disp" => {
                entry.ignored.push("bump and normal maps are left out")
            }
            _ => {}
        }
    }
    entries.extend(current);
    Ok(entries)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn part(mtl: &str) -> Part {
        let folder = tempfile::tempdir().unwrap();
        let names: Vec<&str> = mtl.lines().filter_map(|line| line.strip_prefix("newmtl ")).collect();
        let uses: String = names.iter().map(|name| format!("usemtl {name}\nf 1 2 3\n")).collect();
        std::fs::write(folder.path().join("a.mtl"), mtl).unwrap();
        let path = folder.path().join("a.obj");
        std::fs::write(&path, format!("mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\n{uses}")).unwrap();
        super::super::obj::load(&path).unwrap()
    }

    #[test]
    fn colours_become_the_nearest_surface() {
        let part = part(
            "newmtl matt\nKd 0.1 0.2 0.3\nKs 0 0 0\nnewmtl shiny\nKd 0.5 0.5 0.5\nKs 0.04 0.04 0.04\nNs 98\n\
             newmtl glass\nd 0.1\nNi 1.5\nnewmtl net\nd 0.25\nnewmtl lamp\nKe 3 2 1\n",
        );
        let [_, matt, shiny, glass, net, lamp] = &part.materials[..] else { panic!() };
        assert_eq!(matt.surface, Surface::Diffuse { albedo: Color::Constant(Vec3::new(0.1, 0.2, 0.3)) });
        let Surface::Standard(standard) = shiny.surface else { panic!() };
        assert_eq!(standard.finish.alpha, Scalar::Constant(0.02_f32.sqrt()));
        assert_eq!(standard.specular_color, Color::Constant(Vec3::ONE));
        assert!(matches!(glass.surface, Surface::Dielectric { ior: 1.5, .. }) && glass.cutout.is_none());
        assert_eq!(net.cutout.unwrap().opacity, Scalar::Constant(0.25));
        assert_eq!(lamp.emission, Color::Constant(Vec3::new(3.0, 2.0, 1.0)));
        assert_eq!(part.mesh.materials, [1, 2, 3, 4, 5]);
        assert!(
            part.warnings.iter().any(|line| line.ends_with("rough reflecting layer: 'shiny'")),
            "{:?}",
            part.warnings
        );
    }

    #[test]
    fn what_is_missing_is_named_and_what_is_wrong_is_an_error() {
        let part = part("newmtl a\nmap_Kd nowhere.png\nbump b.png\n");
        assert!(part.warnings.iter().any(|line| line.contains("nowhere.png")), "{:?}", part.warnings);
        assert!(part.warnings.iter().any(|line| line.ends_with("bump and normal maps are left out: 'a'")));
        let line = parse("a.mtl", "newmtl a\nKd 1 x\n").map(|_| ()).unwrap_err().to_string();
        assert!(!line.is_empty());
        for bad in ["newmtl a\nKd nan", "newmtl a\nNs -1", "newmtl a\nd x", "newmtl a\nKe 1e9"] {
            assert!(parse("a.mtl", bad).unwrap_err().to_string().starts_with("a.mtl: line 2: "), "{bad}");
        }
    }
}
