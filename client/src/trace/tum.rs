//! The TUM trace format (Sturm et al. 2012): one pose per line, `t tx ty tz qx qy qz qw`, seconds and
//! metres, `#` starts a comment. The pose is world_from_head, right-handed, +Y up, looking along -Z.
//!
//! A trace file is untrusted: its size is limited before it is read, and the first thing that is wrong
//! ends the reading with a line that names file, line number, field and what was expected. Quaternions are
//! recorded with three to eight digits, so a length off by a tenth is taken and normalised; beyond that
//! the columns are not a quaternion.

use super::{MAX_DURATION_SECS, MAX_POSES, Sample, Trace, TraceError};
use glam::{DQuat, DVec3};
use std::fmt::Write as _;
use std::io::Read;
use std::path::Path;
use warplight_protocol::Pose;

/// Largest trace file, in bytes: [`MAX_POSES`] poses at about 70 bytes each.
pub const MAX_FILE_BYTES: u64 = 256 << 20;

const COLUMNS: [&str; 8] = ["t", "tx", "ty", "tz", "qx", "qy", "qz", "qw"];

impl Trace {
    /// Reads a TUM file.
    ///
    /// # Errors
    /// A file that cannot be read, is larger than [`MAX_FILE_BYTES`] or is not a trace.
    pub fn read(path: &Path) -> Result<Trace, TraceError> {
        let file = std::fs::File::open(path).map_err(TraceError::io(path))?;
        let mut text = Vec::new();
        // One byte more than allowed tells a file that is too large from one that just fits.
        file.take(MAX_FILE_BYTES + 1).read_to_end(&mut text).map_err(TraceError::io(path))?;
        let name = path.display().to_string();
        if text.len() as u64 > MAX_FILE_BYTES {
            let (allowed, requested) = (MAX_FILE_BYTES, text.len() as u64);
            return Err(TraceError::LimitExceeded { file: name, limit: "bytes", allowed, requested });
        }
        Trace::parse(&String::from_utf8_lossy(&text), &name)
    }

    /// Reads TUM text; `file` is the name that errors carry.
    ///
    /// # Errors
    /// Anything that is not a trace, see [`TraceError`].
    pub fn parse(text: &str, file: &str) -> Result<Trace, TraceError> {
        let mut samples: Vec<Sample> = Vec::new();
        for (index, line) in text.lines().enumerate() {
            let pose_text = line.split('#').next().unwrap_or_default().trim();
            if pose_text.is_empty() {
                continue;
            }
            let refuse = |field, expected: String, found: String| TraceError::Malformed {
                file: file.to_owned(),
                line: index + 1,
                field,
                expected,
                found: readable(&found),
            };
            let sample = parse_line(pose_text, &refuse)?;
            if let Some(last) = samples.last()
                && sample.time_secs <= last.time_secs
            {
                let expected = format!("a time later than the line before ({})", last.time_secs);
                return Err(refuse("t", expected, sample.time_secs.to_string()));
            }
            let start = samples.first().map_or(sample.time_secs, |first| first.time_secs);
            if sample.time_secs - start > MAX_DURATION_SECS {
                let expected = format!("at most {MAX_DURATION_SECS} s after the first pose");
                return Err(refuse("t", expected, sample.time_secs.to_string()));
            }
            if samples.len() == MAX_POSES {
                let (allowed, requested) = (MAX_POSES as u64, MAX_POSES as u64 + 1);
                return Err(TraceError::LimitExceeded { file: file.to_owned(), limit: "poses", allowed, requested });
            }
            samples.push(sample);
        }
        if samples.len() < 2 {
            return Err(TraceError::TooFewPoses { file: file.to_owned(), expected: 2, found: samples.len() });
        }
        Ok(Trace::from_rising(samples))
    }

    /// The trace as TUM text: microseconds, micrometres, quaternions to 1e-9. `comment` becomes the head
    /// of the file.
    pub fn to_tum(&self, comment: &str) -> String {
        let mut text = String::with_capacity(80 * self.samples().len());
        for line in comment.lines() {
            let _ = writeln!(text, "# {line}");
        }
        text.push_str("# t[s] tx ty tz[m] qx qy qz qw; world_from_head, right-handed, +Y up, looking along -Z\n");
        for Sample { time_secs, head_pose } in self.samples() {
            let (p, q) = (head_pose.position, head_pose.orientation);
            let _ = writeln!(
                text,
                "{time_secs:.6} {:.6} {:.6} {:.6} {:.9} {:.9} {:.9} {:.9}",
                p.x, p.y, p.z, q.x, q.y, q.z, q.w
            );
        }
        text
    }

    /// Writes a TUM file, whole or not at all.
    ///
    /// # Errors
    /// What the operating system says, with the name of the file.
    pub fn write_tum(&self, path: &Path, comment: &str) -> Result<(), TraceError> {
        crate::report::write_whole(path, self.to_tum(comment).as_bytes()).map_err(TraceError::io(path))
    }
}

/// One pose from the text of its line; `refuse` makes the error for a field.
fn parse_line(text: &str, refuse: &impl Fn(&'static str, String, String) -> TraceError) -> Result<Sample, TraceError> {
    let mut columns = text.split_whitespace();
    let mut values = [0.0_f64; 8];
    for (count, (name, value)) in COLUMNS.into_iter().zip(&mut values).enumerate() {
        let Some(column) = columns.next() else {
            return Err(refuse("columns", format!("8 ({})", COLUMNS.join(" ")), count.to_string()));
        };
        match column.parse::<f64>() {
            Ok(number) if number.is_finite() => *value = number,
            _ => return Err(refuse(name, "a finite number".into(), format!("'{column}'"))),
        }
    }
    let extra = columns.count();
    if extra > 0 {
        return Err(refuse("columns", format!("8 ({})", COLUMNS.join(" ")), (8 + extra).to_string()));
    }

    let [time_secs, x, y, z, qx, qy, qz, qw] = values;
    for (name, coordinate) in ["tx", "ty", "tz"].into_iter().zip([x, y, z]) {
        if coordinate.abs() > Pose::MAX_COORDINATE_M {
            return Err(refuse(name, format!("at most {} m", Pose::MAX_COORDINATE_M), coordinate.to_string()));
        }
    }
    let quaternion = DQuat::from_xyzw(qx, qy, qz, qw);
    let length = quaternion.length();
    if !(0.9..=1.1).contains(&length) {
        let found = if length == 0.0 { "a zero quaternion".into() } else { format!("length {length:.3}") };
        return Err(refuse("qx qy qz qw", "a unit quaternion".into(), found));
    }
    let head_pose = Pose { position: DVec3::new(x, y, z), orientation: quaternion.normalize() };
    Ok(Sample { time_secs, head_pose })
}

/// At most 40 characters without control characters: what stands in a file is not let loose on a terminal.
fn readable(found: &str) -> String {
    let clean: String = found.chars().map(|c| if c.is_control() { '?' } else { c }).take(40).collect();
    if found.chars().count() > 40 { clean + "…" } else { clean }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const GOOD: &str = "# a comment\n0.0 1 2 3 0 0 0 1\n\n0.1 1 2 3 0 0 0 -1 # the same turn\n0.2 1 2 3 0 1 0 0\n";

    fn message(text: &str) -> String {
        Trace::parse(text, "head.tum").unwrap_err().to_string()
    }

    #[test]
    fn comments_blank_lines_and_signs_are_understood() {
        let trace = Trace::parse(GOOD, "head.tum").unwrap();
        assert_eq!(trace.samples().len(), 3);
        assert_eq!(trace.samples()[1].head_pose.orientation, DQuat::IDENTITY);
    }

    #[test]
    fn times_count_from_the_first_pose() {
        let trace = Trace::parse("1700000000.5 0 0 0 0 0 0 1\n1700000001.75 0 0 0 0 0 0 1\n", "head.tum").unwrap();
        assert_eq!((trace.samples()[0].time_secs, trace.duration_secs()), (0.0, 1.25));
    }

    #[test]
    fn an_error_names_file_line_field_and_expectation() {
        let cases = [
            ("", "head.tum: poses: expected at least 2, found 0"),
            ("0 1 2 3 0 0 0 1", "head.tum: poses: expected at least 2, found 1"),
            ("0 1 2 3 0 0 0 1\n1 1 NaN 3 0 0 0 1", "head.tum:2: ty: expected a finite number, found 'NaN'"),
            ("0 1 2 3 0 0 inf 1", "head.tum:1: qz: expected a finite number, found 'inf'"),
            ("0,1,2,3,0,0,0,1", "head.tum:1: t: expected a finite number, found '0,1,2,3,0,0,0,1'"),
            ("0 1 2 3 0 0 0", "head.tum:1: columns: expected 8 (t tx ty tz qx qy qz qw), found 7"),
            ("0 1 2 3 0 0 0 1 9", "head.tum:1: columns: expected 8 (t tx ty tz qx qy qz qw), found 9"),
            ("0 1 2 3 0 0 0 0", "head.tum:1: qx qy qz qw: expected a unit quaternion, found a zero quaternion"),
            ("0 1 2 3 0 0 0 2", "head.tum:1: qx qy qz qw: expected a unit quaternion, found length 2.000"),
            ("0 1e6 2 3 0 0 0 1", "head.tum:1: tx: expected at most 32767 m, found 1000000"),
            (
                "#\n5 1 2 3 0 0 0 1\n4 1 2 3 0 0 0 1",
                "head.tum:3: t: expected a time later than the line before (5), found 4",
            ),
            (
                "5 1 2 3 0 0 0 1\n5 1 2 3 0 0 0 1",
                "head.tum:2: t: expected a time later than the line before (5), found 5",
            ),
            (
                "0 1 2 3 0 0 0 1\n1e9 1 2 3 0 0 0 1",
                "head.tum:2: t: expected at most 86400 s after the first pose, found 1000000000",
            ),
        ];
        for (text, expected) in cases {
            assert_eq!(message(text), expected);
        }
    }

    #[test]
    fn what_stands_in_the_file_cannot_flood_the_terminal() {
        let hostile = format!("\u{1b}[2J{} 0 0 0 0 0 0 1", "x".repeat(10_000));
        let said = message(&hostile);
        assert!(said.len() < 120 && !said.contains('\u{1b}'), "{said}");
    }

    #[test]
    fn a_missing_file_is_named() {
        let said = Trace::read(Path::new("/nowhere/head.tum")).unwrap_err().to_string();
        assert!(said.starts_with("/nowhere/head.tum: "), "{said}");
    }

    #[test]
    fn a_written_trace_reads_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("head.tum");
        let trace = Trace::synthesise(3, 2.0, 90.0).unwrap();
        trace.write_tum(&path, "two\nlines").unwrap();
        let back = Trace::read(&path).unwrap();
        assert_eq!(back.samples().len(), trace.samples().len());
        for (a, b) in trace.samples().iter().zip(back.samples()) {
            assert!((a.time_secs - b.time_secs).abs() <= 5.1e-7);
            assert!((a.head_pose.position - b.head_pose.position).length() < 1e-6);
            assert!(a.head_pose.angle_to(&b.head_pose) < 1e-8);
        }
    }

    proptest! {
        #[test]
        fn any_text_gives_a_trace_or_one_line(text in "[-0-9 .eNa#\n]{0,200}") {
            match Trace::parse(&text, "f") {
                Ok(trace) => prop_assert!(trace.samples().iter().all(|sample| sample.head_pose.is_valid())),
                Err(error) => prop_assert!(!error.to_string().contains('\n')),
            }
        }
    }
}
