//! Prediction on head traces, recorded and synthetic: how far a pose that is continued for 60 ms is from where the head
//! then was.
//!
//! Baselines: the last pose; constant velocity over the last 30 ms; and constant velocity over the last two samples, which
//! is better than that with a clean tracker and worse with a noisy one.

use glam::DQuat;
use std::path::PathBuf;
use std::time::Duration;
use warplight_client::trace::Trace;
use warplight_protocol::message::{PoseSample, Prediction};
use warplight_protocol::pose::scaled_axis;
use warplight_protocol::{Pose, Timestamp};
use warplight_server::predict::Predictor;

const HORIZON: Duration = Duration::from_millis(60);

/// Mean error of turns in degrees and of positions in millimetres.
#[derive(Clone, Copy, Debug, Default)]
struct Error {
    deg: f64,
    mm: f64,
}

/// Poses as a client samples them: at every refresh of its display, or when the tracker has one.
fn samples(trace: &Trace, hz: Option<f64>) -> Vec<f64> {
    let last = trace.duration_secs() - HORIZON.as_secs_f64();
    match hz {
        Some(hz) => (0..).map(|index| f64::from(index) / hz).take_while(|&secs| secs <= last).collect(),
        None => trace.samples().iter().map(|sample| sample.time_secs).filter(|&secs| secs <= last).collect(),
    }
}

fn mean_error(trace: &Trace, at: &[f64], mut continued: impl FnMut(PoseSample) -> Pose) -> Error {
    let mut sum = Error::default();
    for &secs in at {
        let time = Timestamp { micros: 1_000_000 + (secs * 1e6).round() as u64 };
        let pose = continued(PoseSample { time, pose: trace.pose_at(secs) });
        let truth = trace.pose_at(secs + HORIZON.as_secs_f64());
        sum.deg += pose.angle_to(&truth).to_degrees();
        sum.mm += (pose.position - truth.position).length() * 1e3;
    }
    Error { deg: sum.deg / at.len() as f64, mm: sum.mm / at.len() as f64 }
}

fn by_law(trace: &Trace, at: &[f64], law: Prediction) -> Error {
    let mut predictor = Predictor::new(law);
    mean_error(trace, at, |sample| {
        predictor.push(sample);
        predictor.predict(HORIZON).unwrap()
    })
}

/// Constant velocity between the last two samples that are at least 10 ms apart.
fn by_last_two(trace: &Trace, at: &[f64]) -> Error {
    let mut before: Vec<PoseSample> = Vec::new();
    mean_error(trace, at, |latest| {
        let earlier = before.iter().rev().find(|sample| latest.time.since(sample.time) >= Duration::from_millis(10));
        let pose = earlier.map_or(latest.pose, |earlier| {
            let parts = HORIZON.as_secs_f64() / latest.time.since(earlier.time).as_secs_f64();
            let mut turn = earlier.pose.orientation.inverse() * latest.pose.orientation;
            if turn.w < 0.0 {
                turn = -turn;
            }
            Pose {
                position: latest.pose.position + (latest.pose.position - earlier.pose.position) * parts,
                orientation: latest.pose.orientation * DQuat::from_scaled_axis(scaled_axis(turn) * parts),
            }
        });
        before.push(latest);
        pose
    })
}

/// Compares all laws on a trace; returns the ratios of the adaptive one to constant velocity (30 ms; last two; none).
fn compare(name: &str, trace: &Trace) -> Vec<(String, [Error; 3])> {
    let rates = [("own rate", None), ("60 Hz", Some(60.0)), ("90 Hz", Some(90.0))];
    let ratio = |a: Error, b: Error| Error { deg: a.deg / b.deg, mm: a.mm / b.mm };
    rates
        .into_iter()
        .map(|(rate, hz)| {
            let at = samples(trace, hz);
            let [none, constant, damped, adaptive] = Prediction::ALL.map(|law| by_law(trace, &at, law));
            let last_two = by_last_two(trace, &at);
            println!(
                "{name:24} {rate:8} deg: none {:.3} last two {:.3} constant {:.3} damped {:.3} adaptive {:.3}   mm: none {:.2} last two \
                 {:.2} constant {:.2} adaptive {:.2}",
                none.deg, last_two.deg, constant.deg, damped.deg, adaptive.deg, none.mm, last_two.mm, constant.mm, adaptive.mm
            );
            let ratios = [constant, last_two, none].map(|baseline| ratio(adaptive, baseline));
            (format!("{name} at {rate}"), ratios)
        })
        .collect()
}

fn holds(name: &str, trace: &Trace) {
    for (what, [constant, last_two, none]) in compare(name, trace) {
        assert!(constant.deg <= 1.0 && constant.mm <= 1.0, "{what}: {constant:?} of constant velocity");
        assert!(last_two.deg <= 1.0 && last_two.mm <= 1.0, "{what}: {last_two:?} of the last two samples");
        assert!(none.deg <= 1.0 && none.mm <= 1.0, "{what}: {none:?} of no prediction");
    }
}

#[test]
fn on_recorded_traces_it_is_at_or_below_constant_velocity_and_never_worse_than_none() {
    let Some(data) = std::env::var_os("WARPLIGHT_DATA").map(PathBuf::from) else {
        eprintln!("skipped: WARPLIGHT_DATA is not set, so nothing is predicted on recorded head traces");
        return;
    };
    let mut traces: Vec<PathBuf> =
        std::fs::read_dir(data.join("traces")).unwrap().map(|entry| entry.unwrap().path()).collect();
    traces.retain(|path| path.extension().is_some_and(|extension| extension == "tum"));
    traces.sort();
    assert!(!traces.is_empty());
    for path in traces {
        holds(&path.file_stem().unwrap().to_string_lossy(), &Trace::read(&path).unwrap());
    }
}

#[test]
fn on_synthetic_traces_too() {
    for seed in 1..6 {
        holds(&format!("synthetic {seed}"), &Trace::synthesise(seed, 30.0, 120.0).unwrap());
    }
}
