//! Mitsuba's shapes: a mesh or a sphere, a BSDF, and perhaps an area light.
//!
//! Spheres stay exact where they are not textured or anisotropic, turned inside out or scaled differently along the axes; else they
//! are meshes, as disks and cylinders are. Where a cylinder's ends are given, its texture begins elsewhere than
//! Mitsuba's: the turn about the axis is free.

use super::super::untrusted::{MAX_COORDINATE_M, MAX_FILE_BYTES, MAX_ITEMS, check_limit, read_file};
use super::super::{Color, Material, Mesh, SceneError, Surface, obj, ply};
use super::node::{Node, Plugin};
use super::spectrum::Role;
use super::{Loader, primitives, transform};
use glam::{DAffine3, DMat3, DQuat, DVec3, Vec3};

/// Shapes of Mitsuba that have no counterpart here.
const LEFT_OUT: [&str; 9] =
    ["serialized", "instance", "shapegroup", "bsplinecurve", "linearcurve", "sdfgrid", "blender", "ellipsoids", "hair"];

impl<'a> Loader<'a> {
    /// Puts a shape into the scene.
    pub(super) fn shape(&mut self, node: &'a Node) -> Result<(), SceneError> {
        let plugin = Plugin::new(node);
        let label = node.label();
        if node.kind() == "merge" {
            for child in plugin.children(|child| child.tag == "shape") {
                self.shape(child)?;
            }
            return Ok(());
        }
        if LEFT_OUT.contains(&node.kind()) {
            self.note(format!("shapes of type '{}' are left out", node.kind()), &label);
            return Ok(());
        }
        let material = self.surface_of(&plugin)?;
        let to_world = match plugin.transform("to_world")? {
            Some(node) => transform::read(node)?,
            None => DAffine3::IDENTITY,
        };
        let is_flipped = plugin.boolean("flip_normals", false)?;
        // Where u and v run matters: Mitsuba's spheres have their poles on Z.
        let has_directions = {
            let mut moved = material.clone();
            moved.shift_textures(1);
            moved != material || material.surface.is_anisotropic()
        };
        let index = self.material_index(node, material)?;
        let (mut mesh, world_from_mesh) = match node.kind() {
            "obj" | "ply" => self.mesh_file(&plugin, &to_world)?,
            "rectangle" => (primitives::rectangle(), to_world),
            "cube" => (primitives::cube(), to_world),
            "disk" => (primitives::disk(), to_world),
            "cylinder" => {
                let p0 = plugin.point("p0")?.unwrap_or(DVec3::ZERO);
                let p1 = plugin.point("p1")?.unwrap_or(DVec3::Z);
                let radius = plugin.float("radius", 1.0, SMALLEST..=LARGEST)?;
                let axis = p1 - p0;
                let direction = axis.try_normalize().ok_or_else(|| node.error("p1 away from p0", "p0 itself"))?;
                let scale = DVec3::new(radius, radius, axis.length());
                let turn = DQuat::from_rotation_arc(DVec3::Z, direction);
                (primitives::cylinder(), to_world * DAffine3::from_scale_rotation_translation(scale, turn, p0))
            }
            "sphere" => {
                let centre = plugin.point("center")?.unwrap_or(DVec3::ZERO);
                let radius = plugin.float("radius", 1.0, SMALLEST..=LARGEST)?;
                let (centre_in_world, scale) = (to_world.transform_point3(centre), uniform_scale(&to_world.matrix3));
                let within = DVec3::splat(f64::from(MAX_COORDINATE_M));
                match scale {
                    Some(scale) if !has_directions && !is_flipped => {
                        let radius = radius * scale;
                        if !(centre_in_world.abs() + radius).cmple(within).all() || radius < SMALLEST {
                            return Err(node.error(format_args!("a sphere within {} m", within.x), centre_in_world));
                        }
                        self.part.place_sphere(centre_in_world, radius, index);
                        self.note_unused(&plugin);
                        return Ok(());
                    }
                    _ => {
                        let local =
                            DAffine3::from_scale_rotation_translation(DVec3::splat(radius), DQuat::IDENTITY, centre);
                        (primitives::sphere(), to_world * local)
                    }
                }
            }
            other => {
                let expected = "a shape of type obj, ply, sphere, rectangle, cube, disk or cylinder";
                return Err(node.value_error(expected, other));
            }
        };
        if is_flipped {
            primitives::flip(&mut mesh);
        }
        self.note_unused(&plugin);
        self.part.place(&mesh, &world_from_mesh, &node.place.file.name, |_| index)
    }

    /// A mesh from a file, with Mitsuba's normals: those of the file, else smooth ones, else those of the faces.
    fn mesh_file(&mut self, plugin: &Plugin<'a>, to_world: &DAffine3) -> Result<(Mesh, DAffine3), SceneError> {
        let path = self.file(plugin)?;
        let (name, bytes) = (path.display().to_string(), read_file(&path, MAX_FILE_BYTES)?);
        let is_obj = plugin.node.kind() == "obj";
        let (mut mesh, origin) = if is_obj {
            let model = obj::parse(&name, &bytes)?;
            (model.mesh, model.origin)
        } else {
            let model = ply::parse(&name, &bytes)?;
            (model.mesh, model.origin)
        };
        // An OBJ's v has been turned over when it was read, a PLY's has not: Mitsuba's defaults.
        if plugin.boolean("flip_tex_coords", is_obj)? != is_obj {
            mesh.uvs.iter_mut().for_each(|uv| uv.y = 1.0 - uv.y);
        }
        let has_normals = mesh.normals.iter().any(|&normal| normal != Vec3::ZERO);
        if has_normals {
            primitives::turn_to_normals(&mut mesh);
        } else if to_world.matrix3.determinant() < 0.0 {
            // Mitsuba finds the normals after the transform: a mirrored mesh is turned inside out.
            mesh.triangles.iter_mut().for_each(|triangle| triangle.swap(1, 2));
        }
        if plugin.boolean("face_normals", false)? {
            mesh.normals.fill(Vec3::ZERO);
        } else if !has_normals {
            primitives::smooth_normals(&mut mesh);
        }
        Ok((mesh, *to_world * DAffine3::from_translation(origin)))
    }

    /// The material of a shape: its BSDF, and the radiance of its area light.
    fn surface_of(&mut self, plugin: &Plugin<'a>) -> Result<Material, SceneError> {
        let node = plugin.node;
        let mut bsdf = None;
        let mut light = None;
        let (mut interior, mut exterior) = (None, None);
        for child in plugin.children(|child| matches!(child.tag, "bsdf" | "emitter" | "ref" | "medium" | "sensor")) {
            let found = self.resolve(child)?;
            match found.tag {
                "bsdf" => bsdf = Some(found),
                "emitter" => light = Some(found),
                "medium" => match child.name() {
                    "exterior" => exterior = Some(self.medium(found)?),
                    "interior" => interior = Some(self.medium(found)?),
                    other => return Err(child.value_error("a medium of name interior or exterior", other)),
                },
                other => self.note(format!("<{other}> of a shape is left out"), &node.label()),
            }
        }
        let mut material = match bsdf {
            Some(bsdf) => self.material(bsdf)?,
            None => Material {
                one_sided: true,
                ..Material::new(node.label(), Surface::Diffuse { albedo: Color::Constant(Vec3::splat(0.5)) })
            },
        };
        (material.interior, material.exterior) = (interior, exterior);
        if let Some(light) = light {
            if light.kind() != "area" {
                return Err(light.value_error("an emitter of type area within a shape", light.kind()));
            }
            let plugin = Plugin::new(light);
            material.emission = self.color(&plugin, "radiance", 1.0, Role::Emission)?;
            self.note_unused(&plugin);
        }
        Ok(material)
    }

    fn material_index(&mut self, node: &Node, material: Material) -> Result<u32, SceneError> {
        // Most shapes of a large scene share few materials, and the latest most often.
        let known = self.part.materials.iter().rev().take(RECENT).position(|known| *known == material);
        if let Some(back) = known {
            return Ok((self.part.materials.len() - 1 - back) as u32);
        }
        let count = self.part.materials.len() as u64;
        check_limit(&node.place.file.name, "materials", MAX_ITEMS, count + 1)?;
        self.part.materials.push(material);
        Ok(count as u32)
    }
}

/// Materials that a new one is compared with.
const RECENT: usize = 64;
/// Shortest and longest radius in metres.
const SMALLEST: f64 = 1e-9;
const LARGEST: f64 = 1e6;

/// The factor of a matrix that keeps spheres spheres.
fn uniform_scale(matrix: &DMat3) -> Option<f64> {
    let square = matrix.transpose() * *matrix;
    let scale2 = square.x_axis.x;
    let rest = square - DMat3::from_diagonal(DVec3::splat(scale2));
    let largest = rest.to_cols_array().into_iter().fold(0.0, |most: f64, entry| most.max(entry.abs()));
    (scale2 > 0.0 && largest <= 1e-6 * scale2).then(|| scale2.sqrt())
}
