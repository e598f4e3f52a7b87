//! From the keys of a scene file to a scene: names are resolved, ranges checked, shapes made.

use super::super::pattern::Pattern;
use super::super::picture::{Encoding, Picture, decode, texels};
use super::super::shapes::{self, Wave};
use super::super::texture::{ImageTexture, TexelFilter, Wrap, image_bytes};
use super::super::untrusted::{MAX_FILE_BYTES, MAX_IMAGE_BYTES, MAX_ITEMS, check_limit, read_file};
use super::super::{Environment, NamedCamera, Part, SceneError, Texture, TextureKind, Transfer, model};
use super::checks::Section;
use super::lights::light;
use super::materials::{MaterialEntry, material};
use super::motions::motion;
use super::place::{pose, transform};
use super::volumes::{VolumeKeys, check_total, volume};
use super::{
    Description, EnvironmentKeys, MAX_RADIANCE, Rgb, ShapeKeys, TexelFilterKey, TextureEntry, WaveKeys, WrapKey,
    index_of,
};
use glam::{DAffine3, Vec2, Vec3};
use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use warplight_protocol::Pose;

/// What a scene file adds to its shapes.
pub(in super::super) struct Composition {
    /// Shapes, materials, textures, cameras and warnings.
    pub(in super::super) part: Part,
    pub(in super::super) environment: Option<Environment>,
    pub(in super::super) exposure: f32,
    pub(in super::super) head: Option<Pose>,
}

/// Composes a scene file. Files it names are relative to `folder`; a built-in scene has none.
pub(in super::super) fn compose(
    file: &str,
    folder: Option<&Path>,
    description: &Description,
) -> Result<Composition, SceneError> {
    let top = Section { file, name: String::new() };
    let items = description.shape.len() + description.material.len() + description.texture.len();
    let items = items + description.light.len() + description.camera.len() + description.motion.len();
    let items = items + description.volume.len();
    check_limit(file, "shapes, volumes, materials, textures, lights, cameras and motions", MAX_ITEMS, items as u64)?;

    let exposure = top.number("exposure", description.exposure, 1e-6..=1e6)?;
    let head = description
        .head
        .as_ref()
        .map(|head| pose(&Section { file, name: "head".to_owned() }, head.position, head.look_at, head.yaw_deg));
    let mut composer = Composer {
        file,
        folder,
        part: Part::default(),
        textures: HashMap::new(),
        materials: HashMap::new(),
        image_bytes: 0,
        volumes: HashSet::new(),
        volume_values: 0,
    };
    for camera in &description.camera {
        let section = Section { file, name: format!("camera '{}'", camera.name.escape_debug()) };
        let vertical_fov_deg = section.number("vertical_fov_deg", camera.vertical_fov_deg, 1.0..=170.0)?;
        composer.part.cameras.push(NamedCamera {
            name: camera.name.clone(),
            pose: pose(&section, camera.position, camera.look_at, camera.yaw_deg)?,
            vertical_fov_rad: vertical_fov_deg.to_radians(),
        });
    }
    description.texture.iter().try_for_each(|entry| composer.texture(entry))?;
    description.material.iter().try_for_each(|entry| composer.material(entry))?;
    for (index, shape) in description.shape.iter().enumerate() {
        composer.shape(index, shape)?;
    }
    description.volume.iter().try_for_each(|keys| composer.volume(keys))?;
    for (index, keys) in description.light.iter().enumerate() {
        let section = Section { file, name: format!("light {}", index + 1) };
        let (light, at) = light(&section, keys)?;
        composer.part.place_light(light, &DAffine3::from_translation(at));
    }
    for (index, keys) in description.motion.iter().enumerate() {
        let section = Section { file, name: format!("motion {}", index + 1) };
        let motion = motion(&section, keys, &composer.part, description.light.len())?;
        composer.part.motions.push(motion);
    }
    let environment = description.environment.as_ref().map(|keys| composer.environment(keys)).transpose()?;
    Ok(Composition { part: composer.part, environment, exposure, head: head.transpose()? })
}

struct Composer<'a> {
    file: &'a str,
    folder: Option<&'a Path>,
    part: Part,
    /// Index by name.
    textures: HashMap<String, u32>,
    materials: HashMap<String, u32>,
    /// Bytes of texels so far.
    image_bytes: u64,
    /// Names of volumes.
    volumes: HashSet<String>,
    /// Values of grids so far.
    volume_values: u64,
}

impl Composer<'_> {
    fn section(&self, kind: &str, name: &str) -> Section<'_> {
        Section { file: self.file, name: format!("{kind} '{}'", name.escape_debug()) }
    }

    /// The path of a file that the scene names.
    fn path(&self, section: &Section, file: &str) -> Result<PathBuf, SceneError> {
        match self.folder {
            Some(folder) => Ok(folder.join(file)),
            None => {
                Err(section.error("file", "no file in a built-in scene", format_args!("'{}'", file.escape_debug())))
            }
        }
    }

    /// Counts the texels of one more image.
    fn count(&mut self, bytes: u64) -> Result<(), SceneError> {
        self.image_bytes += bytes;
        check_limit(self.file, "bytes of images", MAX_IMAGE_BYTES, self.image_bytes)
    }

    fn texture(&mut self, entry: &TextureEntry) -> Result<(), SceneError> {
        let section = self.section("texture", entry.name());
        let counts = 1e-3..=1e3_f32;
        let color = |field: &str, value: &Rgb| section.rgb(field, *value, 0.0..=1.0).map(|color| color.to_array());
        let kind = match entry {
            TextureEntry::Image { file, linear, wrap, filter, .. } => {
                let path = self.path(&section, file)?;
                let texels = texels(&path.display().to_string(), &read_file(&path, MAX_FILE_BYTES)?)?;
                self.count(texels.bytes())?;
                let transfer = if *linear { Transfer::Linear } else { texels.transfer() };
                let wrap = match wrap {
                    WrapKey::Repeat => Wrap::Repeat,
                    WrapKey::Mirror => Wrap::Mirror,
                    WrapKey::Clamp => Wrap::Clamp,
                };
                let filter = match filter {
                    TexelFilterKey::Linear => TexelFilter::Linear,
                    TexelFilterKey::Nearest => TexelFilter::Nearest,
                };
                TextureKind::Image(ImageTexture { texels: texels.into(), transfer, wrap: [wrap; 2], filter })
            }
            TextureEntry::Checker { a, b, squares, .. } => TextureKind::Checker {
                a: color("a", a)?,
                b: color("b", b)?,
                squares: section.pair("squares", *squares, counts)?.to_array(),
            },
            TextureEntry::Stripes { a, b, count, softness, .. } => TextureKind::Pattern(Pattern::Stripes {
                a: color("a", a)?,
                b: color("b", b)?,
                count: section.number("count", *count, counts)?,
                softness: section.number("softness", *softness, 0.0..=1.0)?,
            }),
            TextureEntry::Wood { light, dark, planks, .. } => TextureKind::Pattern(Pattern::Wood {
                light: color("light", light)?,
                dark: color("dark", dark)?,
                planks: section.pair("planks", *planks, counts)?.to_array(),
            }),
            TextureEntry::Tiles { tile, joint, count, joint_width, variation, .. } => {
                TextureKind::Pattern(Pattern::Tiles {
                    tile: color("tile", tile)?,
                    joint: color("joint", joint)?,
                    count: section.pair("count", *count, counts)?.to_array(),
                    joint_width: section.number("joint_width", *joint_width, 0.0..=1.0)?,
                    variation: section.number("variation", *variation, 0.0..=1.0)?,
                })
            }
            TextureEntry::Marble { stone, vein, count, .. } => TextureKind::Pattern(Pattern::Marble {
                stone: color("stone", stone)?,
                vein: color("vein", vein)?,
                count: section.number("count", *count, counts)?,
            }),
            TextureEntry::Rings { a, b, count, .. } => TextureKind::Pattern(Pattern::Rings {
                a: color("a", a)?,
                b: color("b", b)?,
                count: section.number("count", *count, counts)?,
            }),
            TextureEntry::Hills { sky, haze, sun, ground, seed, .. } => TextureKind::Pattern(Pattern::Hills {
                sky: color("sky", sky)?,
                haze: color("haze", haze)?,
                sun: color("sun", sun)?,
                ground: color("ground", ground)?,
                seed: *seed,
            }),
        };
        let index = self.part.textures.len() as u32;
        if self.textures.insert(entry.name().to_owned(), index).is_some() {
            return Err(self.section("texture", entry.name()).error("name", "a name of its own", "one that is taken"));
        }
        self.part.textures.push(Texture::new(kind));
        Ok(())
    }

    fn material(&mut self, entry: &MaterialEntry) -> Result<(), SceneError> {
        let name = entry.name();
        let made = material(&self.section("material", name), &self.textures, entry)?;
        let index = self.part.materials.len() as u32;
        if self.materials.insert(name.to_owned(), index).is_some() {
            return Err(self.section("material", name).error("name", "a name of its own", "one that is taken"));
        }
        self.part.materials.push(made);
        Ok(())
    }

    fn shape(&mut self, index: usize, keys: &ShapeKeys) -> Result<(), SceneError> {
        let section = Section { file: self.file, name: format!("shape {}", index + 1) };
        let material = |name: &String| index_of(&self.materials, &section, "material", "material", name);
        let repeat = |repeat: &[f32; 2]| section.pair("repeat", *repeat, -1e4..=1e4);
        let (mesh, world_from_shape, material) = match keys {
            ShapeKeys::Sphere { material: name, centre, radius } => {
                let centre = section.point("centre", *centre)?;
                let radius = f64::from(section.length("radius", *radius)?);
                let material = material(name)?;
                self.part.place_sphere(centre, radius, material);
                return Ok(());
            }
            ShapeKeys::Box { material: name, size, repeat: times, transform: keys } => {
                size.iter().try_for_each(|&side| section.length("size", side).map(drop))?;
                let mesh = shapes::cuboid(Vec3::from_array(*size), repeat(times)?);
                (mesh, transform(&section, keys)?, material(name)?)
            }
            ShapeKeys::Quad { material: name, corner, edge_u, edge_v, repeat: times } => {
                let (u, v) = (section.point("edge_u", *edge_u)?, section.point("edge_v", *edge_v)?);
                if u.cross(v).length() < 1e-9 {
                    return Err(section.error("edge_v", "an edge that is not parallel to edge_u, and not 0", v));
                }
                let mesh = shapes::quad(Vec3::ZERO, u.as_vec3(), v.as_vec3(), repeat(times)?);
                (mesh, DAffine3::from_translation(section.point("corner", *corner)?), material(name)?)
            }
            ShapeKeys::Cylinder { material: name, radius, height, segments, repeat: times, transform: keys } => {
                let radius = section.length("radius", *radius)?;
                let height = section.length("height", *height)?;
                let segments = section.count("segments", *segments, 3..=4096)?;
                let mesh = shapes::cylinder(radius, height, segments, repeat(times)?);
                (mesh, transform(&section, keys)?, material(name)?)
            }
            ShapeKeys::Water { material: name, size, cells, waves, repeat: times, transform: keys } => {
                size.iter().try_for_each(|&side| section.length("size", side).map(drop))?;
                cells.iter().try_for_each(|&cells| section.count("cells", cells, 1..=1024).map(drop))?;
                check_limit(self.file, "waves of a water surface", MAX_WAVES, waves.len() as u64)?;
                let waves = waves.iter().map(|keys| wave(&section, keys)).collect::<Result<Vec<_>, _>>()?;
                let mesh = shapes::water(Vec2::from_array(*size), *cells, &waves, repeat(times)?);
                (mesh, transform(&section, keys)?, material(name)?)
            }
            ShapeKeys::Mesh { file, material: all, materials, transform: keys } => {
                let all = all.as_ref().map(material).transpose()?;
                let world_from_shape = transform(&section, keys)?;
                let mut part = model::load(&self.path(&section, file)?)?;
                let mut replacements = HashMap::new();
                for (theirs, ours) in materials {
                    if !part.materials.iter().any(|material| material.name == *theirs) {
                        let known =
                            part.materials.iter().map(|m| m.name.as_str()).take(8).collect::<Vec<_>>().join(", ");
                        let found = format!("'{}'", theirs.escape_debug());
                        return Err(section.error("materials", format_args!("a material of {file} ({known})"), found));
                    }
                    replacements.insert(theirs.as_str(), material(ours)?);
                }
                self.count(image_bytes(&part.textures))?;
                // A model's own view points belong to the model: the scene has its own.
                part.cameras.clear();
                let names: Vec<String> = part.materials.iter().map(|material| material.name.clone()).collect();
                let replace = |index: u32| all.or_else(|| replacements.get(names[index as usize].as_str()).copied());
                return self.part.append(part, &world_from_shape, self.file, replace);
            }
        };
        self.part.place(&mesh, &world_from_shape, self.file, |_| material)
    }

    fn volume(&mut self, keys: &VolumeKeys) -> Result<(), SceneError> {
        let section = self.section("volume", &keys.name);
        let made = volume(&section, keys, self.part.media.len() as u32, |file| self.path(&section, file))?;
        if !self.volumes.insert(keys.name.clone()) {
            return Err(self.section("volume", &keys.name).error("name", "a name of its own", "one that is taken"));
        }
        self.volume_values += made.values;
        check_total(self.file, self.volume_values)?;
        let material = self.part.materials.len() as u32;
        self.part.materials.push(made.material);
        self.part.media.push((made.medium, made.world_from_unit));
        self.part.warnings.extend(made.warnings);
        self.part.place(&made.boundary, &made.world_from_unit, self.file, |_| material)
    }

    fn environment(&mut self, keys: &EnvironmentKeys) -> Result<Environment, SceneError> {
        let section = Section { file: self.file, name: "environment".to_owned() };
        let radiance = |field: &str, value: &Rgb| section.rgb(field, *value, 0.0..=MAX_RADIANCE);
        match keys {
            EnvironmentKeys::Constant { radiance: value } => Ok(Environment::Constant(radiance("radiance", value)?)),
            EnvironmentKeys::Gradient { zenith, horizon, nadir } => Ok(Environment::Gradient {
                zenith: radiance("zenith", zenith)?,
                horizon: radiance("horizon", horizon)?,
                nadir: radiance("nadir", nadir)?,
            }),
            EnvironmentKeys::Image { file, rotation_deg, scale } => {
                let rotation_rad = section.number("rotation_deg", *rotation_deg, -360.0..=360.0)?.to_radians();
                let scale = section.number("scale", *scale, 0.0..=1e6)?;
                let path = self.path(&section, file)?;
                let bytes = read_file(&path, MAX_FILE_BYTES)?;
                let mut picture = decode(&path.display().to_string(), &bytes, Encoding::ByFormat)?;
                self.count(size_of_val(picture.texels.as_slice()) as u64)?;
                picture.texels.iter_mut().flatten().for_each(|value| *value *= scale);
                let Picture { width, height, texels } = picture;
                let image_from_world = Environment::turned_about_y(rotation_rad);
                Ok(Environment::Image { width, height, texels, image_from_world })
            }
        }
    }
}

/// Waves of one surface: each costs one sine per vertex.
const MAX_WAVES: u64 = 64;

fn wave(section: &Section, keys: &WaveKeys) -> Result<Wave, SceneError> {
    let direction = section.pair("waves: direction", keys.direction, -1e6..=1e6)?;
    let Some(direction) = direction.try_normalize() else {
        return Err(section.error("waves: direction", "a direction", "0"));
    };
    Ok(Wave {
        direction,
        length_m: section.length("waves: length_m", keys.length_m)?,
        height_m: section.number("waves: height_m", keys.height_m, 0.0..=1e3)?,
        phase_rad: section.number("waves: phase_deg", keys.phase_deg, -360.0..=360.0)?.to_radians(),
    })
}

impl TextureEntry {
    fn name(&self) -> &str {
        match self {
            TextureEntry::Image { name, .. }
            | TextureEntry::Checker { name, .. }
            | TextureEntry::Stripes { name, .. }
            | TextureEntry::Wood { name, .. }
            | TextureEntry::Tiles { name, .. }
            | TextureEntry::Marble { name, .. }
            | TextureEntry::Rings { name, .. }
            | TextureEntry::Hills { name, .. } => name,
        }
    }
}
