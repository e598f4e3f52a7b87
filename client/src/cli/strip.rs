//! `replay --strip`: reference, `diffuse` and `specular` side by side with captions, for a README.
//!
//! From the compared refresh in which the two modes' pictures differ most (mean difference of display codes); it is
//! not an average one, and whoever shows it says so.

use super::Failure;
use crate::replay::{AssessedRefresh, Assessment, QualityRun};
use crate::report::strip;
use crate::warp::Mode;
use anyhow::Context;
use image::RgbImage;
use std::path::Path;

/// What is shown beside the reference.
pub(super) const MODES: [Mode; 2] = [Mode::Diffuse, Mode::Specular];

/// Writes the strip.
pub(super) fn write(path: &Path, quality: &QualityRun, trace: &str) -> Result<(), Failure> {
    let chosen = quality.refreshes.iter().filter_map(|refresh| {
        let [diffuse, specular] = MODES.map(|mode| refresh.modes.iter().find(|shown| shown.mode == mode));
        Some((refresh, diffuse?, specular?))
    });
    let differs = |(_, a, b): &(&AssessedRefresh, &Assessment, &Assessment)| difference(&a.picture, &b.picture);
    let Some((refresh, diffuse, specular)) = chosen.max_by_key(differs) else {
        return Err(Failure::Input("--strip: no refresh was compared; --quality-every 0 leaves none".to_owned()));
    };
    // The name of its file: a path would not fit.
    let trace = Path::new(trace).file_name().map_or(trace.into(), |name| name.to_string_lossy());
    let reference = format!("reference, {:.2} s into trace {trace}", refresh.time.as_secs_f64());
    let [painted, warped] = [diffuse, specular].map(|shown| {
        let error = shown.compared.error;
        format!("{}: {:.1} dB, FLIP {:.3}", shown.mode.name(), error.psnr_db, error.flip)
    });
    let pictures =
        [(&reference[..], &refresh.reference), (&painted[..], &diffuse.picture), (&warped[..], &specular.picture)];
    strip(&pictures).save(path).with_context(|| format!("{}", path.display()))?;
    Ok(())
}

/// Sum of the differences of all codes.
fn difference(a: &RgbImage, b: &RgbImage) -> u64 {
    a.iter().zip(b.iter()).map(|(a, b)| u64::from(a.abs_diff(*b))).sum()
}
