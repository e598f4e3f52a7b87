//! Mitsuba's sensors as view points; film, sampler and integrator as defaults of pictures.
//!
//! A Mitsuba camera looks along its own +Z with +Y up and +X to the left of the picture; ours along -Z with +X to
//! the right: half a turn about +Y. Its `fov` is along x unless `fov_axis` says otherwise, ours is vertical.
//! Mitsuba's `max_depth` counts like ours: 1 shows lights only, 2 direct light; -1 is without end.

use super::super::untrusted::MAX_ITEMS;
use super::super::{NamedCamera, SceneError};
use super::node::{Node, Plugin};
use super::{Loader, transform};
use glam::{DMat3, DQuat, DVec3};
use warplight_protocol::{ImageSize, Pose};

/// Longest path where the file sets no end: Russian roulette stops earlier.
const WITHOUT_END: u32 = 4096;

impl<'a> Loader<'a> {
    /// Takes in a sensor. The film and the sampler of the first one count.
    pub(super) fn sensor(&mut self, node: &'a Node) -> Result<(), SceneError> {
        let plugin = Plugin::new(node);
        match node.kind() {
            "perspective" => {}
            "thinlens" => {
                plugin.without_effect(&["aperture_radius", "focus_distance"]);
                self.note("lenses have no aperture: all is in focus", &node.label());
            }
            "orthographic" | "radiancemeter" | "irradiancemeter" | "distant" | "batch" | "fluxmeter" => {
                self.note(format!("sensors of type '{}' are left out", node.kind()), &node.label());
                return Ok(());
            }
            other => return Err(node.value_error("a sensor of type perspective or thinlens", other)),
        }
        plugin.without_effect(&["near_clip", "far_clip", "focus_distance", "srf", "shutter_open", "shutter_close"]);
        for name in ["principal_point_offset_x", "principal_point_offset_y"] {
            if plugin.float(name, 0.0, -1e3..=1e3)? != 0.0 {
                self.note("principal points stay in the middle of the picture", &node.label());
            }
        }
        let (mut size, mut spp) = (None, None);
        for child in plugin.children(|child| matches!(child.tag, "film" | "sampler" | "medium" | "ref")) {
            let found = self.resolve(child)?;
            match found.tag {
                "film" => size = Some(self.film(found)?),
                "sampler" => {
                    let sampler = Plugin::new(found);
                    sampler.without_effect(&["seed", "jitter"]);
                    spp = sampler.integer("sample_count", 1..=1 << 24)?.map(|count| count as u32);
                    self.note_unused(&sampler);
                }
                "medium" => self.note("media are left out", &node.label()),
                other => return Err(found.error("<film>, <sampler> or <medium>", format_args!("<{other}>"))),
            }
        }
        let size = size.unwrap_or(DEFAULT_SIZE);
        let vertical_fov_rad = self.vertical_fov(&plugin, f64::from(size.width) / f64::from(size.height))?;
        let pose = match plugin.transform("to_world")? {
            Some(to_world) => self.pose(to_world)?,
            None => Pose { position: DVec3::ZERO, orientation: DQuat::from_rotation_y(std::f64::consts::PI) },
        };
        if self.part.cameras.is_empty() {
            self.part.defaults.size = Some(size);
            self.part.defaults.spp = spp;
        }
        let number = self.part.cameras.len() + 1;
        super::super::untrusted::check_limit(&node.place.file.name, "sensors", MAX_ITEMS, number as u64)?;
        let name = node.attribute("id").map_or_else(|| format!("sensor {number}"), str::to_owned);
        self.part.cameras.push(NamedCamera { name, pose, vertical_fov_rad });
        self.note_unused(&plugin);
        Ok(())
    }

    fn film(&mut self, node: &'a Node) -> Result<ImageSize, SceneError> {
        let plugin = Plugin::new(node);
        let side = |name: &str, default: u32| {
            Ok::<u32, SceneError>(
                plugin.integer(name, 1..=i64::from(ImageSize::MAX_SIDE))?.map_or(default, |side| side as u32),
            )
        };
        let size = ImageSize::new(side("width", DEFAULT_SIZE.width)?, side("height", DEFAULT_SIZE.height)?);
        if !plugin.children(|child| child.name().starts_with("crop_")).is_empty() {
            self.note("pictures are not cropped", &node.label());
        }
        let filters = plugin.children(|child| child.tag == "rfilter");
        // Mitsuba's default is a Gaussian.
        if filters.first().is_none_or(|filter| filter.kind() != "box") {
            self.note("pixels are filtered by a box", &node.label());
        }
        let output = ["pixel_format", "component_format", "file_format", "banner", "sample_border", "compensate"];
        plugin.without_effect(&output);
        self.note_unused(&plugin);
        Ok(size)
    }

    fn vertical_fov(&mut self, plugin: &Plugin<'a>, aspect: f64) -> Result<f32, SceneError> {
        let axis = plugin.string("fov_axis")?.unwrap_or("x");
        let (fov_rad, axis) = if plugin.has("fov") {
            (plugin.float("fov", 50.0, 0.1..=179.0)?.to_radians(), axis)
        } else {
            let text = plugin.string("focal_length")?.unwrap_or("50mm");
            let millimetres = plugin.node.number(text.trim().trim_end_matches("mm"))?;
            if !(0.1..=1e4).contains(&millimetres) {
                return Err(plugin.node.value_error("a focal_length from 0.1mm to 10000mm", text));
            }
            // The diagonal of a film of 36 by 24 mm.
            (2.0 * (36.0_f64.hypot(24.0) / (2.0 * millimetres)).atan(), "diagonal")
        };
        let half = (fov_rad / 2.0).tan();
        let vertical_half = match axis {
            "x" => half / aspect,
            "y" => half,
            "diagonal" => half / (1.0 + aspect * aspect).sqrt(),
            "smaller" => {
                if aspect > 1.0 {
                    half
                } else {
                    half / aspect
                }
            }
            "larger" => {
                if aspect > 1.0 {
                    half / aspect
                } else {
                    half
                }
            }
            other => return Err(plugin.node.value_error("the fov_axis x, y, diagonal, smaller or larger", other)),
        };
        let vertical_rad = 2.0 * vertical_half.atan();
        if (1e-3..3.13).contains(&vertical_rad) {
            return Ok(vertical_rad as f32);
        }
        Err(plugin.node.error("a vertical field of view from 0.06 to 179 degrees", vertical_rad.to_degrees()))
    }

    fn pose(&mut self, node: &'a Node) -> Result<Pose, SceneError> {
        let to_world = transform::read(node)?;
        let axes = to_world.matrix3;
        if axes.determinant() < 0.0 {
            self.note("mirroring cameras show the picture unmirrored", &node.label());
        }
        let forward = axes.z_axis.normalize_or(DVec3::Z);
        let right = forward.cross(axes.y_axis).normalize_or(forward.any_orthonormal_vector());
        let orientation = DQuat::from_mat3(&DMat3::from_cols(right, right.cross(forward), -forward)).normalize();
        let pose = Pose { position: to_world.translation, orientation };
        if pose.is_valid() {
            return Ok(pose);
        }
        Err(node.error(format_args!("a camera within {} m", Pose::MAX_COORDINATE_M), to_world.translation))
    }

    /// Takes in an integrator, through those that only wrap another.
    pub(super) fn integrator(&mut self, node: &'a Node) -> Result<(), SceneError> {
        let plugin = Plugin::new(node);
        let nested = plugin.children(|child| child.tag == "integrator");
        match node.kind() {
            "moment" | "aov" | "stokes" => {
                plugin.without_effect(&["aovs"]);
                self.note_unused(&plugin);
                return nested.first().map_or(Ok(()), |nested| self.integrator(nested));
            }
            "direct" => {
                self.part.defaults.max_depth = Some(2);
                plugin.without_effect(&["shading_samples", "emitter_samples", "bsdf_samples"]);
            }
            "path" | "volpath" | "volpathmis" | "prb" | "prbvolpath" | "prb_basic" | "ptracer" => {
                let depth = plugin.integer("max_depth", -1..=1 << 20)?.unwrap_or(-1);
                let depth = u32::try_from(depth).map_or(WITHOUT_END, |depth| depth.clamp(1, WITHOUT_END));
                self.part.defaults.max_depth = Some(depth);
                plugin.without_effect(&["rr_depth"]);
            }
            "depth" | "direct_projective" | "prb_projective" | "emission_reparam" => {
                self.note(format!("integrators of type '{}' become a path tracer", node.kind()), &node.label());
                return Ok(());
            }
            other => return Err(node.value_error("an integrator such as path, direct, volpath, moment or aov", other)),
        }
        if plugin.boolean("hide_emitters", false)? {
            self.note("emitters are not hidden", &node.label());
        }
        self.note_unused(&plugin);
        Ok(())
    }
}

/// Of Mitsuba's films.
const DEFAULT_SIZE: ImageSize = ImageSize::new(768, 576);
