//! Mitsuba's media: `homogeneous` and `heterogeneous`, what they are made of, and how they scatter.
//!
//! `sigma_t` and `albedo` are colours, or volumes: `constvolume`, and `gridvolume` from .vol files. A grid fills its
//! unit cube, placed by `to_world`, and with `use_grid_bbox` the box of its file within that; beyond it there is
//! nothing. `sigma_s` and `sigma_a` of older versions are read, too. Phase functions are `isotropic` and `hg`.
//!
//! Limits: grids are interpolated linearly and clamped, whatever `filter_type` and `wrap_mode` say; extinction and
//! albedo share one cube, that of the extinction.

use super::super::SceneError;
use super::node::{Node, Plugin};
use super::spectrum::Role;
use super::value::{MAX_VALUE, Value};
use super::{Loader, transform};
use crate::volume::{Albedo, Grid, Matter, Medium, Phase, load};
use glam::{Affine3A, DAffine3, Vec3};
use std::sync::Arc;

/// A quantity of a medium.
enum Field {
    Constant(Vec3),
    Grid { grid: Arc<Grid>, world_from_unit: DAffine3 },
}

impl<'a> Loader<'a> {
    /// The index of a medium, which is read once.
    pub(super) fn medium(&mut self, node: &'a Node) -> Result<u32, SceneError> {
        if let Some(&known) = self.media.get(&std::ptr::from_ref(node)) {
            return Ok(known);
        }
        if !matches!(node.kind(), "homogeneous" | "heterogeneous") {
            return Err(node.value_error("a medium of type homogeneous or heterogeneous", node.kind()));
        }
        if self.part.media.len() >= crate::bsdf::MAX_MEDIA {
            return Err(node.error(format_args!("at most {} media", crate::bsdf::MAX_MEDIA), "more"));
        }
        let plugin = Plugin::new(node);
        let scale = plugin.float("scale", 1.0, 0.0..=f64::from(MAX_VALUE))? as f32;
        let (extinction, albedo) = if plugin.has("sigma_s") || plugin.has("sigma_a") {
            let mut part =
                |name| Ok::<_, SceneError>(self.constant(&plugin, name, Role::Factor)?.unwrap_or(Vec3::ZERO));
            let (scattering, absorption) = (part("sigma_s")?, part("sigma_a")?);
            let extinction = scattering + absorption;
            (Field::Constant(extinction), Field::Constant(scattering / extinction.max(Vec3::splat(f32::MIN_POSITIVE))))
        } else {
            (
                self.field(&plugin, "sigma_t", 1.0, Role::Factor)?,
                self.field(&plugin, "albedo", 0.75, Role::Reflectance)?,
            )
        };
        let phase = self.phase(&plugin)?;
        plugin.without_effect(&["sample_emitters", "has_spectral_extinction", "majorant_resolution_factor"]);
        self.note_unused(&plugin);
        let (matter, world_from_unit) = self.matter(node, extinction, albedo, scale)?;
        let index = self.part.media.len() as u32;
        self.part.media.push((Medium { matter, phase }, world_from_unit));
        self.media.insert(std::ptr::from_ref(node), index);
        Ok(index)
    }

    fn matter(
        &mut self,
        node: &Node,
        extinction: Field,
        albedo: Field,
        scale: f32,
    ) -> Result<(Matter, DAffine3), SceneError> {
        let (density, world_from_unit, extinction_per_m) = match (extinction, &albedo) {
            (Field::Constant(extinction), Field::Constant(albedo)) => {
                let (extinction_per_m, albedo) = (extinction * scale, *albedo);
                let matter = Matter::Homogeneous { extinction_per_m, albedo, emission: Vec3::ZERO };
                return Ok((matter, DAffine3::IDENTITY));
            }
            // Everywhere the same, as far as the albedo is known.
            (Field::Constant(extinction), Field::Grid { world_from_unit, .. }) => {
                let one = Grid::new([1; 3], 1, vec![1.0]).map_err(|error| node.error("a grid", error))?;
                (Arc::new(one), *world_from_unit, extinction * scale)
            }
            (Field::Grid { grid, world_from_unit }, _) => (grid, world_from_unit, Vec3::splat(scale)),
        };
        let albedo = match albedo {
            Field::Constant(albedo) => Albedo::Constant(albedo),
            Field::Grid { grid, world_from_unit: placed } => {
                if !placed.abs_diff_eq(world_from_unit, 1e-9) {
                    self.note("an albedo placed otherwise than sigma_t fills the same cube", &node.label());
                }
                Albedo::Grid(grid)
            }
        };
        // Where the cube is said when the part is placed.
        let unit_from_world = Affine3A::IDENTITY;
        let matter = Matter::Density { density, unit_from_world, extinction_per_m, albedo, emission: Vec3::ZERO };
        Ok((matter, world_from_unit))
    }

    fn field(&mut self, plugin: &Plugin<'a>, name: &str, default: f32, role: Role) -> Result<Field, SceneError> {
        let child = plugin.child(name).map(|child| self.resolve(child)).transpose()?;
        let Some(volume) = child.filter(|child| child.tag == "volume") else {
            return Ok(Field::Constant(match self.value(plugin, name, role)? {
                None => Vec3::splat(default),
                Some(Value::Constant(color)) => color,
                Some(Value::Texture(node)) => {
                    return Err(node.error("a colour or a <volume> of a medium", "a texture"));
                }
            }));
        };
        let volume_plugin = Plugin::new(volume);
        let field = match volume.kind() {
            "constvolume" => {
                let value = self.constant(&volume_plugin, "value", role)?;
                Field::Constant(value.unwrap_or(Vec3::splat(default)))
            }
            "gridvolume" => self.grid(&volume_plugin)?,
            other => return Err(volume.value_error("a volume of type gridvolume or constvolume", other)),
        };
        self.note_unused(&volume_plugin);
        Ok(field)
    }

    fn grid(&mut self, plugin: &Plugin<'a>) -> Result<Field, SceneError> {
        let node = plugin.node;
        let loaded = load(&self.file(plugin)?, None)?;
        self.count(plugin, size_of_val(loaded.grid.values()) as u64)?;
        let to_world = match plugin.transform("to_world")? {
            Some(node) => transform::read(node)?,
            None => DAffine3::IDENTITY,
        };
        if plugin.string("filter_type")?.is_some_and(|filter| filter != "trilinear") {
            self.note("grids are interpolated linearly", &node.label());
        }
        if plugin.string("wrap_mode")?.is_some_and(|wrap| wrap != "clamp") {
            self.note("grids are clamped at their borders", &node.label());
        }
        plugin.without_effect(&["raw", "accel"]);
        if loaded.grid.not_finite() > 0 {
            self.note("values that are not finite became 0 in grids", &node.label());
        }
        let has_box = plugin.boolean("use_grid_bbox", false)?;
        let world_from_unit = if has_box { to_world * loaded.space_from_unit } else { to_world };
        Ok(Field::Grid { grid: Arc::new(loaded.grid), world_from_unit })
    }

    fn phase(&mut self, plugin: &Plugin<'a>) -> Result<Phase, SceneError> {
        let Some(child) = plugin.children(|child| child.tag == "phase" || child.name() == "phase").first().copied()
        else {
            return Ok(Phase::ISOTROPIC);
        };
        let node = self.resolve(child)?;
        let plugin = Plugin::new(node);
        let phase = match node.kind() {
            "isotropic" => Phase::ISOTROPIC,
            "hg" => {
                let most = f64::from(Phase::MOST);
                Phase { g: plugin.float("g", 0.8, -most..=most)? as f32 }
            }
            other @ ("rayleigh" | "sggx" | "blendphase" | "tabphase") => {
                self.note(format!("phase functions of type '{other}' become isotropic"), &node.label());
                return Ok(Phase::ISOTROPIC);
            }
            other => return Err(node.value_error("a phase function of type isotropic or hg", other)),
        };
        self.note_unused(&plugin);
        Ok(phase)
    }
}
