//! Points of the renderer: noise and bias of path-traced pictures and of live frames, against converged ones.
//!
//! The error is the relative squared error of linear radiance ([`relative_mse`]), in which the noise of the converged
//! pictures cancels: there are two of them, of other seeds. `still` has the knobs of pictures that are path-traced,
//! `denoiser` compares live frames with them. Time is that of rendering, on all cores.
//!
//! The head is where a session begins, half a second into the trace of live frames, with their camera. Pictures are small
//! ([`SIDE_PX`]): an error per pixel does not depend on how many there are, only its own uncertainty does.
//!
//! [`relative_mse`]: crate::measure::relative_mse

mod denoiser;
mod still;

use super::SweepError;
use crate::measure::MeasureError;
pub(super) use denoiser::{estimators, measure as denoiser};
use std::collections::BTreeMap;
pub(super) use still::{path_depth, spp};

/// One diffuse scene, and one with everything specular.
pub(super) const STILL_SCENES: [&str; 2] = ["cornell", "gallery"];
/// Long paths of light: between walls, and through glass.
pub(super) const DEPTH_SCENES: [&str; 2] = ["cornell", "glass"];
/// Diffuse light alone, and lobes of every roughness.
pub(super) const LIVE_SCENES: [&str; 2] = ["cornell", "materials"];
/// Longest side of a picture, and of one of a quick sweep: 9216 pixels of three channels tell a squared error to some
/// percent.
pub(super) const SIDE_PX: [u32; 2] = [160, 96];

fn measured(error: MeasureError) -> SweepError {
    SweepError::Scene(error.to_string())
}

fn named<const N: usize>(values: [(&str, f64); N]) -> BTreeMap<String, f64> {
    values.into_iter().map(|(name, value)| (name.to_owned(), value)).collect()
}
