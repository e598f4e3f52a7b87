//! The settings of each knob of a session; all others stay at their defaults: the scene's own nodes, frames as large as the
//! display, five a second.

use super::super::Request;
use warplight_protocol::ImageSize;
use warplight_protocol::frame::Plan;

/// Frames per second: with few of them frames are old, and what the warp knows shows.
const FRAME_HZ: f64 = 5.0;

/// One setting.
#[derive(Clone, Debug)]
pub(in crate::sweep) struct Setting {
    pub(in crate::sweep) value: String,
    /// The nodes of a frame, if not those that the scene calls for.
    pub(super) plan: Option<Plan>,
    /// Sides of a frame over those of the display, in percent.
    pub(super) side_percent: u32,
    /// Frames per second.
    pub(super) frame_hz: f64,
    /// Whether time and bytes are those of a second.
    pub(super) is_per_second: bool,
}

impl Setting {
    fn new(value: impl ToString) -> Setting {
        let value = value.to_string();
        Setting { value, plan: None, side_percent: 100, frame_hz: FRAME_HZ, is_per_second: false }
    }

    /// Whether the knob is which nodes a frame has.
    pub(super) fn is_of_nodes(&self) -> bool {
        self.plan.is_some()
    }

    /// The size of a frame for a display.
    pub(super) fn size_of_frame(&self, display: ImageSize) -> ImageSize {
        let side = |side: u32| ((side * self.side_percent + 50) / 100).max(1);
        ImageSize::new(side(display.width), side(display.height))
    }
}

/// Ever deeper trees. What has no node of its own is baked into its parent, and moves with that. A scene that calls for
/// fewer nodes has the rest of them empty.
pub(in crate::sweep) fn tree_depths(request: &Request<'_>) -> Vec<Setting> {
    let named =
        [("D", Plan::diffuse()), ("D,R", Plan::mirror()), ("D,R,F", Plan::water()), ("D,R,F,FF", Plan::solid())];
    let mut plans: Vec<(&str, Plan)> = named.into();
    if !request.quick {
        let deeper = ["D,R,RR,F,FF", "D,R,RR,F,FR,FF", "D,R,RR,F,FR,FF,FFF"];
        plans.extend(deeper.into_iter().filter_map(|letters| Some((letters, letters.parse().ok()?))));
    }
    plans.into_iter().map(|(name, plan)| Setting { plan: Some(plan), ..Setting::new(name) }).collect()
}

/// Frames from a quarter of the display's sides to all of them.
pub(in crate::sweep) fn resolutions(request: &Request<'_>) -> Vec<Setting> {
    let sides: &[u32] = if request.quick { &[25, 50, 75, 100] } else { &[25, 35, 50, 60, 75, 90, 100, 125] };
    sides.iter().map(|&side_percent| Setting { side_percent, ..Setting::new(side_percent) }).collect()
}

/// Frames per second, each twice as many: every frame of a rate is one of all higher ones, too.
pub(in crate::sweep) fn frame_rates(request: &Request<'_>) -> Vec<Setting> {
    let rates: &[f64] = if request.quick { &[2.5, 5.0, 10.0, 20.0] } else { &[2.5, 5.0, 10.0, 20.0, 40.0] };
    rates.iter().map(|&frame_hz| Setting { frame_hz, is_per_second: true, ..Setting::new(frame_hz) }).collect()
}
