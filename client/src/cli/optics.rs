//! Flags of `replay` for what stands between frames and eyes.

use super::replay::number;
use crate::display::{Lens, Optics, Shutter};
use clap::Args;
use std::time::Duration;

/// Instants of an open shutter: at a head's fastest, 300 degrees a second, a 60th of a second is then sampled in steps
/// of half a degree.
const SHUTTER_SAMPLES: usize = 8;

/// Arguments.
#[derive(Debug, Args)]
pub(super) struct OpticsArgs {
    /// A picture for each eye from every frame, the eyes this many millimetres apart [default distance: 63].
    #[arg(long, value_name = "MM", num_args = 0..=1, default_missing_value = "63", value_parser = eye_distance)]
    stereo: Option<f64>,
    /// A lens of this diameter in millimetres instead of a pinhole.
    #[arg(long, value_name = "MM", requires = "focus", value_parser = millimetres)]
    aperture: Option<f64>,
    /// Depth in focus in metres.
    #[arg(long, value_name = "M", requires = "aperture", value_parser = metres)]
    focus: Option<f64>,
    /// Warps that make up a picture through a lens.
    #[arg(long, value_name = "N", default_value_t = 16, value_parser = clap::value_parser!(u16).range(1..=1024))]
    lens_samples: u16,
    /// A shutter that is open for this many milliseconds before each refresh.
    #[arg(long, value_name = "T", value_parser = shutter)]
    shutter_ms: Option<f64>,
    /// Smooth stair-cased edges, in what is displayed and in the reference.
    #[arg(long)]
    smooth_edges: bool,
}

fn eye_distance(text: &str) -> Result<f64, String> {
    number(text, "a distance from 1 to 500 mm", |value| (1.0..=500.0).contains(&value))
}

fn millimetres(text: &str) -> Result<f64, String> {
    number(text, "a diameter from 0.01 to 1000 mm", |value| (0.01..=1000.0).contains(&value))
}

fn metres(text: &str) -> Result<f64, String> {
    number(text, "a depth from 0.01 to 100000 m", |value| (0.01..=1e5).contains(&value))
}

fn shutter(text: &str) -> Result<f64, String> {
    number(text, "a time from 0.01 to 1000 ms", |value| (0.01..=1000.0).contains(&value))
}

impl OpticsArgs {
    pub(super) fn optics(&self) -> Optics {
        let lens = self.aperture.zip(self.focus).map(|(aperture_mm, focus_m)| Lens {
            aperture_m: aperture_mm * 1e-3,
            focus_m,
            samples: usize::from(self.lens_samples),
        });
        let shutter = self
            .shutter_ms
            .map(|millis| Shutter { open: Duration::from_secs_f64(millis * 1e-3), samples: SHUTTER_SAMPLES });
        Optics { eye_distance_m: self.stereo.map(|mm| mm * 1e-3), lens, shutter, smooth_edges: self.smooth_edges }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::display::Eye;
    use clap::Parser;

    #[derive(Parser)]
    struct Alone {
        #[command(flatten)]
        optics: OpticsArgs,
    }

    fn parsed(arguments: &[&str]) -> Result<Optics, clap::Error> {
        Alone::try_parse_from(["replay"].iter().chain(arguments)).map(|alone| alone.optics.optics())
    }

    #[test]
    fn without_flags_it_is_a_pinhole() {
        assert_eq!(parsed(&[]).unwrap(), Optics::default());
    }

    #[test]
    fn units_are_those_that_the_flags_name() {
        let optics = parsed(&["--stereo", "--aperture", "8", "--focus", "1.5", "--shutter-ms", "5"]).unwrap();
        assert!((optics.eye_distance_m.unwrap() - Eye::DISTANCE_MM * 1e-3).abs() < 1e-12);
        let lens = optics.lens.unwrap();
        assert!((lens.aperture_m - 0.008).abs() < 1e-12 && lens.focus_m == 1.5 && lens.samples == 16);
        assert_eq!(optics.shutter.unwrap().open, Duration::from_millis(5));
        assert_eq!(parsed(&["--stereo", "70"]).unwrap().eye_distance_m, Some(0.07));
    }

    #[test]
    fn what_makes_no_sense_is_refused() {
        for arguments in [
            &["--aperture", "8"][..],
            &["--focus", "1"],
            &["--aperture", "0", "--focus", "1"],
            &["--aperture", "8", "--focus", "NaN"],
            &["--stereo", "-3"],
            &["--shutter-ms", "inf"],
            &["--lens-samples", "0"],
        ] {
            assert!(parsed(arguments).is_err(), "{arguments:?}");
        }
    }
}
