//! Flags that say what frames travel in.

use super::replay::number;
use clap::{Args, ValueEnum};
use warplight_protocol::frame::{ColorCoding, DepthBound, DepthFormat, FrameFormat, Layering, VolumeFormat};

/// The named formats of the planes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    /// What measured best.
    Default,
    /// Nothing but quantised: 8-bit colour, 16-bit inverse depth, as they are.
    Exact,
    /// Quantised as in the thesis: linear 8-bit colour, 16-bit relative depth.
    Thesis,
}

/// How frames are coded.
#[derive(Debug, Args)]
pub(super) struct CodingArgs {
    /// Formats of the planes; the flags below change one each.
    #[arg(long, value_enum, default_value_t = Format::Default)]
    format: Format,
    /// How colour travels: exact, bounded:CODES (each code within so many) or video:QUANTISER (H.264, 0 to 51).
    #[arg(long, value_name = "CODING")]
    color: Option<ColorCoding>,
    /// Largest error of depth in displayed pixels, 0.01 to 16, for a head that moves by --depth-motion-mm; 0: 16 bits, as
    /// they are.
    #[arg(long, value_name = "PX", value_parser = depth_error_px)]
    depth_error_px: Option<f64>,
    /// Motion of the head that the error of depth is promised for, in millimetres.
    #[arg(long, value_name = "MM", value_parser = clap::value_parser!(u16).range(1..=10_000))]
    depth_motion_mm: Option<u16>,
    /// Megabits per second that frames shall take on average; colour and depth get coarser as far as needed.
    #[arg(long, value_name = "MBPS", value_parser = target_mbps)]
    target_mbps: Option<f64>,
    /// Segments of a pixel's volume, where the scene has one: 0 to 8.
    #[arg(long, default_value_t = 4, value_name = "K", value_parser = clap::value_parser!(u8).range(0..=8))]
    layers: u8,
    /// How the server cuts them: quantiles, merged, optimal or slabs.
    #[arg(long, default_value = Layering::Optimal.name(), value_name = "LAYERING")]
    layering: Layering,
}

impl CodingArgs {
    /// The format that is asked of the server.
    pub(super) fn format(&self) -> FrameFormat {
        let format = match self.format {
            Format::Default => FrameFormat::default(),
            Format::Exact => FrameFormat::exact(),
            Format::Thesis => FrameFormat::thesis(),
        };
        let bound = match format.depth {
            DepthFormat::Bounded(bound) => bound,
            DepthFormat::Codes { .. } => DepthBound::default(),
        };
        let depth = match self.depth_error_px {
            None => match (format.depth, self.depth_motion_mm) {
                (DepthFormat::Bounded(bound), Some(motion_mm)) => {
                    DepthFormat::Bounded(DepthBound { motion_mm, ..bound })
                }
                (depth, _) => depth,
            },
            Some(0.0) => FrameFormat::exact().depth,
            Some(error_px) => DepthFormat::Bounded(DepthBound {
                error_centi_px: (100.0 * error_px).round() as u16,
                motion_mm: self.depth_motion_mm.unwrap_or(bound.motion_mm),
                ..bound
            }),
        };
        let volume = VolumeFormat { layers: self.layers, layering: self.layering, ..format.volume };
        FrameFormat { color_coding: self.color.unwrap_or(format.color_coding), depth, volume, ..format }
    }

    /// Thousand bits per second that frames shall take; 0 for as many as they need.
    pub(super) fn target_kbps(&self) -> u32 {
        self.target_mbps.map_or(0, |mbps| (1e3 * mbps).round() as u32)
    }
}

fn depth_error_px(text: &str) -> Result<f64, String> {
    number(text, "0, or 0.01 to 16 pixels", |value| value == 0.0 || (0.01..=16.0).contains(&value))
}

fn target_mbps(text: &str) -> Result<f64, String> {
    number(text, "0.01 to 100000 megabits per second", |value| (0.01..=1e5).contains(&value))
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Alone {
        #[command(flatten)]
        coding: CodingArgs,
    }

    fn format(flags: &str) -> FrameFormat {
        Alone::parse_from(["test"].into_iter().chain(flags.split_whitespace())).coding.format()
    }

    #[test]
    fn each_flag_changes_what_it_names() {
        let usual = format("");
        assert_eq!(usual, FrameFormat { volume: VolumeFormat::default(), ..FrameFormat::default() });
        assert_eq!(format("--color exact").color_coding, ColorCoding::Exact);
        assert_eq!(format("--color bounded:3").color_coding, ColorCoding::Bounded { error: 3 });
        assert_eq!(format("--format exact --color video:30").color_coding, ColorCoding::Video { quantiser: 30 });
        let DepthFormat::Bounded(bound) = format("--depth-error-px 0.5 --depth-motion-mm 100").depth else { panic!() };
        assert_eq!((bound.error_centi_px, bound.motion_mm), (50, 100));
        assert_eq!(format("--depth-error-px 0").depth, DepthFormat::Codes { root_bits: 16, child_bits: 16 });
        assert_eq!(format("--layers 2").volume.layers, 2);
    }

    #[test]
    fn what_is_out_of_range_is_refused() {
        for bad in ["--color video:52", "--color bounded:0", "--color png", "--depth-error-px 20", "--target-mbps 0"] {
            assert!(Alone::try_parse_from(["test"].into_iter().chain(bad.split_whitespace())).is_err(), "{bad}");
        }
        assert_eq!(Alone::parse_from(["test", "--target-mbps", "2.5"]).coding.target_kbps(), 2500);
    }
}
