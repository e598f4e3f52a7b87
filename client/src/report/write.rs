//! Files are written whole or not at all, and the same report gives the same bytes.
//!
//! Numbers are rounded to six significant digits on the way out: no measurement of ours has more, and the
//! last bits of a sum would differ between machines. Objects are indented, arrays stand on one line.

use super::Report;
use serde::Serialize;
use serde_json::ser::{CompactFormatter, Formatter, PrettyFormatter, Serializer};
use std::io::{self, Write};
use std::path::Path;
pub use warplight_server::costs::write_whole;

impl Report {
    /// The report as JSON text, ending with a line break.
    ///
    /// # Errors
    /// What serde_json refuses; nothing in a report is of that kind.
    pub fn to_json(&self) -> Result<String, serde_json::Error> {
        rounded_json(self)
    }

    /// Writes `report.json`, whole or not at all.
    ///
    /// # Errors
    /// What the operating system says.
    pub fn write(&self, path: &Path) -> io::Result<()> {
        write_whole(path, self.to_json()?.as_bytes())
    }
}

/// A document as JSON text in the form of reports, ending with a line break.
///
/// # Errors
/// What serde_json refuses.
pub(crate) fn rounded_json(document: &impl Serialize) -> Result<String, serde_json::Error> {
    let mut bytes = Vec::new();
    document.serialize(&mut Serializer::with_formatter(&mut bytes, Rounded::default()))?;
    bytes.push(b'\n');
    String::from_utf8(bytes).map_err(serde::ser::Error::custom)
}

/// Six significant digits; a negative zero becomes zero.
fn rounded(value: f64) -> f64 {
    // Through decimal digits: dividing by a power of ten would leave tails like 0.30000000000000004.
    format!("{value:.5e}").parse::<f64>().unwrap_or(value) + 0.0
}

/// JSON with rounded numbers, indented objects and arrays on one line.
#[derive(Default)]
struct Rounded<'a> {
    pretty: PrettyFormatter<'a>,
    open_arrays: usize,
}

/// Forwards a hook to the indented form outside of arrays and to the compact one inside.
macro_rules! outside_arrays_indented {
    ($($hook:ident($($argument:ident: $kind:ty),*);)*) => {$(
        fn $hook<W: ?Sized + Write>(&mut self, writer: &mut W $(, $argument: $kind)*) -> io::Result<()> {
            if self.open_arrays > 0 {
                CompactFormatter.$hook(writer $(, $argument)*)
            } else {
                self.pretty.$hook(writer $(, $argument)*)
            }
        }
    )*};
}

impl Formatter for Rounded<'_> {
    outside_arrays_indented! {
        begin_object();
        end_object();
        begin_object_key(first: bool);
        end_object_key();
        begin_object_value();
        end_object_value();
    }

    fn write_f64<W: ?Sized + Write>(&mut self, writer: &mut W, value: f64) -> io::Result<()> {
        CompactFormatter.write_f64(writer, rounded(value))
    }

    fn begin_array<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.open_arrays += 1;
        CompactFormatter.begin_array(writer)
    }

    fn end_array<W: ?Sized + Write>(&mut self, writer: &mut W) -> io::Result<()> {
        self.open_arrays -= 1;
        CompactFormatter.end_array(writer)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::sample;

    #[test]
    fn equal_reports_are_equal_bytes_and_read_back() {
        let report = sample::report();
        let text = report.to_json().unwrap();
        assert_eq!(text, sample::report().to_json().unwrap());
        let back: Report = serde_json::from_str(&text).unwrap();
        assert_eq!(back.to_json().unwrap(), text);
        assert_eq!(back.counters, report.counters);
    }

    /// The fields of schema 1, as the contract of the programs names them.
    #[test]
    fn every_field_of_the_schema_is_there() {
        let json: serde_json::Value = serde_json::from_str(&sample::report().to_json().unwrap()).unwrap();
        for path in [
            "/schema /scene /trace /seed /clock /size/1 /effects/0 /display/hz /display/frames /display/missed",
            "/latency_ms/motion_to_photon/p50 /latency_ms/motion_to_photon/p95 /latency_ms/frame_age/p99",
            "/latency_ms/frame_age/max /latency_ms/stages/render/p50 /latency_ms/stages/encode/p50",
            "/latency_ms/stages/send/p50 /latency_ms/stages/decode/p50 /latency_ms/stages/warp/p50",
            "/prediction/horizon_ms /prediction/error_deg/p50 /prediction/error_mm/p50 /link/down_bytes",
            "/link/up_bytes /link/down_mbps /link/frames_sent /link/frames_shown /link/frames_replaced",
            "/link/planes/root.radiance /quality/0/mode /quality/0/psnr_db/p50 /quality/0/dssim/p50",
            "/quality/0/flip/p50 /quality/0/hole_fraction/p50 /quality/0/compared_frames",
            "/quality/0/specular/psnr_db/p50 /quality/0/specular/dssim/p50 /quality/0/specular/flip/p50",
            "/quality/0/specular/pixel_fraction/p50 /reference/specular_noise_psnr_db /optics",
            "/counters/rays.primary /warnings",
        ]
        .join(" ")
        .split(' ')
        {
            assert!(json.pointer(path).is_some(), "{path}");
        }
        assert_eq!((json["schema"].as_u64(), json["clock"].as_str()), (Some(1), Some("virtual")));
    }

    #[test]
    fn numbers_have_six_digits_and_no_tails() {
        for (value, expected) in
            [(0.1 + 0.2, 0.3), (123_456.789, 123_457.0), (-1.234_567_89e-9, -1.234_57e-9), (0.0, 0.0), (1e300, 1e300)]
        {
            assert_eq!(rounded(value), expected);
        }
        assert!(rounded(-0.0).is_sign_positive());
    }

    #[test]
    fn a_file_is_written_whole_or_not_at_all() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("report.json");
        write_whole(&path, b"old").unwrap();
        write_whole(&path, b"new").unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"new");
        assert!(write_whole(&folder.path().join("missing/report.json"), b"x").is_err());
        // A folder in the way: the rename fails and nothing is left behind.
        std::fs::create_dir(folder.path().join("taken")).unwrap();
        std::fs::write(folder.path().join("taken/full"), b"").unwrap();
        assert!(write_whole(&folder.path().join("taken"), b"x").is_err());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2);
    }
}
