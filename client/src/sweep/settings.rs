//! The settings of each knob of the surface warp; all others stay at their defaults.
//!
//! The head moves 5 cm aside unless the knob is the move itself: what a lively head does in a tenth of a second.

use super::Request;
use crate::trace::Trace;
use crate::warp::{Normals, Solver};
use glam::DVec3;
use warplight_protocol::Pose;
use warplight_protocol::frame::{DepthCoding, FrameFormat};

/// The default move to the right.
const MOVE_M: f64 = 0.05;
/// Oldest frame of a sweep over the age.
const OLDEST_MS: f64 = 400.0;

/// One setting: how a frame is coded, decoded and warped, and to where.
#[derive(Clone, Debug)]
pub(super) struct Setting {
    pub(super) value: String,
    pub(super) solver: Solver,
    pub(super) normals: Normals,
    pub(super) format: FrameFormat,
    /// old_from_new view, the poses of the head as seen from where the frame was rendered.
    pub(super) moves: Vec<Pose>,
}

impl Setting {
    fn new(value: impl ToString) -> Setting {
        Setting {
            value: value.to_string(),
            solver: Solver::default(),
            normals: Normals::default(),
            format: FrameFormat::exact(),
            moves: vec![aside(DVec3::X * MOVE_M)],
        }
    }
}

fn aside(position: DVec3) -> Pose {
    Pose { position, ..Pose::IDENTITY }
}

fn by_solver(solver: Solver) -> Setting {
    Setting { solver, ..Setting::new(solver) }
}

/// Every solver at its usual number of steps.
pub(super) fn solvers(request: &Request<'_>) -> Vec<Setting> {
    let all = [
        Solver::Unfolded,
        Solver::ImageDistance,
        Solver::default(),
        Solver::GaussNewton { steps: 3 },
        Solver::Descent { steps: 10 },
        Solver::Descent { steps: 32 },
    ];
    all.into_iter().take(if request.quick { 5 } else { 6 }).map(by_solver).collect()
}

/// Solvers with steps, by their number.
pub(super) fn steps(request: &Request<'_>) -> Vec<Setting> {
    let (frozen, newton, descent): (&[u8], &[u8], &[u8]) = match request.quick {
        true => (&[1, 2, 3], &[1, 3], &[10]),
        false => (&[1, 2, 3, 4, 6], &[1, 2, 3, 5], &[5, 10, 20, 32]),
    };
    let frozen = frozen.iter().map(|&steps| Solver::FrozenDistance { steps: Some(steps) });
    let newton = newton.iter().map(|&steps| Solver::GaussNewton { steps });
    let descent = descent.iter().map(|&steps| Solver::Descent { steps });
    frozen.chain(newton).chain(descent).map(by_solver).collect()
}

/// Transmitted normals by their bits, normals from depth by the bits of that.
pub(super) fn normals(request: &Request<'_>) -> Vec<Setting> {
    let (own, depth): (&[u8], &[u8]) = match request.quick {
        true => (&[8, 10, 12], &[16, 24]),
        false => (&[6, 8, 10, 11, 12, 14, 16], &[16, 20, 24]),
    };
    let transmitted = own.iter().map(|&bits| Setting {
        format: FrameFormat { normal_bits: bits, ..FrameFormat::exact() },
        ..Setting::new(format!("transmitted:{bits}"))
    });
    let from_depth = [Normals::FromDepthGaussian, Normals::FromDepthBilateral].into_iter().flat_map(|normals| {
        depth.iter().map(move |&bits| {
            let format = FrameFormat::exact().with_depth_bits(bits, bits);
            Setting { normals, format, ..Setting::new(format!("{}:{bits}", normals.name())) }
        })
    });
    transmitted.chain(from_depth).collect()
}

/// Bits of the root's depth, of the children's, and of both.
pub(super) fn depth_bits(request: &Request<'_>) -> Vec<Setting> {
    let pairs: &[(u8, u8)] = match request.quick {
        true => &[(10, 10), (12, 12), (16, 16), (24, 24)],
        false => &[(8, 8), (10, 10), (12, 12), (14, 14), (16, 8), (16, 12), (16, 16), (20, 16), (20, 20), (24, 24)],
    };
    let setting = |&(root, child): &(u8, u8)| Setting {
        format: FrameFormat::exact().with_depth_bits(root, child),
        ..Setting::new(format!("{root}/{child}"))
    };
    pairs.iter().map(setting).collect()
}

/// Depth of children relative and unfolded.
pub(super) fn depth_codings(request: &Request<'_>) -> Vec<Setting> {
    let bits: &[u8] = if request.quick { &[16] } else { &[8, 12, 16, 20] };
    let codings = [("relative", DepthCoding::Relative), ("unfolded", DepthCoding::Unfolded)];
    let setting = |(name, child_depth), child_depth_bits| Setting {
        format: FrameFormat { child_depth, ..FrameFormat::exact() }.with_depth_bits(16, child_depth_bits),
        ..Setting::new(format!("{name}:{child_depth_bits}"))
    };
    codings.into_iter().flat_map(|coding| bits.iter().map(move |&bits| setting(coding, bits))).collect()
}

/// A head that moves as the trace says, by the age of the frame.
pub(super) fn frame_ages(request: &Request<'_>) -> Vec<Setting> {
    let (ages, instants): (&[f64], usize) = match request.quick {
        true => (&[25.0, 100.0], 3),
        false => (&[10.0, 25.0, 50.0, 100.0, 200.0, OLDEST_MS], 12),
    };
    let setting = |&age: &f64| Setting {
        moves: (0..instants).map(|instant| moved_since(request.trace, age, (instant, instants))).collect(),
        ..Setting::new(age)
    };
    ages.iter().map(setting).collect()
}

/// Where the head is at one of several instants, as seen from where it was.
fn moved_since(trace: &Trace, age_ms: f64, (instant, instants): (usize, usize)) -> Pose {
    let first = (OLDEST_MS * 1e-3).min(trace.duration_secs());
    let at = first + (trace.duration_secs() - first) * (instant as f64 + 0.5) / instants as f64;
    let (old, new) = (trace.pose_at(at - age_ms * 1e-3), trace.pose_at(at));
    let back = old.orientation.inverse();
    Pose { position: back * (new.position - old.position), orientation: (back * new.orientation).normalize() }
}

/// Moves to the right, down and forward.
pub(super) fn head_translations(request: &Request<'_>) -> Vec<Setting> {
    let centimetres: &[f64] = if request.quick { &[2.0, 5.0] } else { &[1.0, 2.0, 5.0, 10.0] };
    let setting = |&way: &f64| Setting {
        moves: [DVec3::X, DVec3::NEG_Y, DVec3::NEG_Z].map(|axis| aside(axis * way * 1e-2)).to_vec(),
        ..Setting::new(way)
    };
    centimetres.iter().map(setting).collect()
}
