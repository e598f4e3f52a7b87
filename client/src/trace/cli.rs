//! `warplight-client trace info | convert | synth`.

use super::{Trace, TraceError};
use clap::{Args, Subcommand};
use std::path::PathBuf;

/// Head traces: facts, resampling, seeded synthesis.
#[derive(Debug, Args)]
pub struct TraceArgs {
    /// What to do.
    #[command(subcommand)]
    pub command: TraceCommand,
}

/// What to do with a trace.
#[derive(Debug, Subcommand)]
pub enum TraceCommand {
    /// Print length, rate, gaps and speeds of a trace.
    Info(InfoArgs),
    /// Write a part of a trace, or the trace at a constant rate.
    Convert(ConvertArgs),
    /// Write a trace made from a seed, with the statistics of recorded ones.
    Synth(SynthArgs),
}

/// Arguments of `trace info`.
#[derive(Debug, Args)]
pub struct InfoArgs {
    /// Trace in TUM format.
    pub trace: PathBuf,
    /// Print one JSON document.
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `trace convert`.
#[derive(Debug, Args)]
pub struct ConvertArgs {
    /// Trace in TUM format.
    pub trace: PathBuf,
    /// Start of the part, in seconds since the first pose.
    #[arg(long, default_value_t = 0.0)]
    pub from_s: f64,
    /// End of the part, in seconds since the first pose [default: the end].
    #[arg(long, default_value_t = f64::INFINITY, hide_default_value = true)]
    pub to_s: f64,
    /// Resample to this rate, in hertz [default: keep the samples].
    #[arg(long)]
    pub rate_hz: Option<f64>,
    /// File to write.
    #[arg(short, long)]
    pub output: PathBuf,
}

/// Arguments of `trace synth`.
#[derive(Debug, Args)]
pub struct SynthArgs {
    /// Seed; the same seed gives the same trace.
    #[arg(long, default_value_t = super::BUILT_IN_SEED)]
    pub seed: u64,
    /// Length in seconds.
    #[arg(long, default_value_t = super::BUILT_IN_SECS)]
    pub duration_s: f64,
    /// Poses per second.
    #[arg(long, default_value_t = super::BUILT_IN_RATE_HZ)]
    pub rate_hz: f64,
    /// File to write.
    #[arg(short, long)]
    pub output: PathBuf,
}

/// Runs a trace command and returns what belongs on stdout.
///
/// # Errors
/// Always the fault of the input: exit status 2.
pub fn run(args: &TraceArgs) -> Result<String, TraceError> {
    match &args.command {
        TraceCommand::Info(args) => info(args),
        TraceCommand::Convert(args) => convert(args),
        TraceCommand::Synth(args) => synth(args),
    }
}

fn info(args: &InfoArgs) -> Result<String, TraceError> {
    let facts = Trace::read(&args.trace)?.facts();
    if !args.json {
        return Ok(facts.to_string());
    }
    let document = serde_json::json!({ "schema": 1, "trace": args.trace.display().to_string(), "facts": facts });
    Ok(document.to_string())
}

fn convert(args: &ConvertArgs) -> Result<String, TraceError> {
    let mut trace = Trace::read(&args.trace)?;
    if args.from_s != 0.0 || args.to_s != f64::INFINITY {
        trace = trace.cut(args.from_s, args.to_s)?;
    }
    if let Some(rate_hz) = args.rate_hz {
        trace = trace.resampled(rate_hz)?;
    }
    trace.write_tum(&args.output, &format!("from {}", args.trace.display()))?;
    Ok(written(&trace, args.output.display()))
}

fn synth(args: &SynthArgs) -> Result<String, TraceError> {
    let trace = Trace::synthesise(args.seed, args.duration_s, args.rate_hz)?;
    trace.write_tum(&args.output, &format!("synthesised by warplight from seed {}", args.seed))?;
    Ok(written(&trace, args.output.display()))
}

fn written(trace: &Trace, path: impl std::fmt::Display) -> String {
    format!("{path}: {} poses, {:.2} s", trace.samples().len(), trace.duration_secs())
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Program {
        #[command(flatten)]
        trace: TraceArgs,
    }

    fn run_line(line: &[&str]) -> Result<String, TraceError> {
        run(&Program::try_parse_from([&["trace"], line].concat()).unwrap().trace)
    }

    #[test]
    fn a_trace_is_made_converted_and_described() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name).display().to_string();
        let (made, part) = (path("made.tum"), path("part.tum"));
        let said = run_line(&["synth", "--seed", "3", "--duration-s", "4", "--rate-hz", "100", "-o", &made]).unwrap();
        assert!(said.ends_with("401 poses, 4.00 s"), "{said}");
        let cut = ["convert", &made, "--from-s", "1", "--to-s", "3", "--rate-hz", "50", "-o", &part];
        assert!(run_line(&cut).unwrap().ends_with("101 poses, 2.00 s"));

        let facts: serde_json::Value = serde_json::from_str(&run_line(&["info", &part, "--json"]).unwrap()).unwrap();
        assert_eq!(facts["facts"]["poses"], 101);
        let text = run_line(&["info", &part]).unwrap();
        assert!(text.contains("101 in 2.00 s, 50.0 Hz"), "{text}");
    }

    #[test]
    fn bad_input_is_one_line() {
        for line in [
            &["info", "/nowhere.tum"][..],
            &["synth", "--duration-s=-1", "-o", "/tmp/never.tum"],
            &["synth", "--rate-hz", "NaN", "-o", "/tmp/never.tum"],
            &["synth", "-o", "/nowhere/never.tum"],
        ] {
            let said = run_line(line).unwrap_err().to_string();
            assert_eq!(said.lines().count(), 1, "{said}");
        }
    }
}
