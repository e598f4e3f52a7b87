//! `probe`: what a link and a server are good for, before a session.
//!
//! A session of a few seconds in the wanted mode, with a head that stands where the scene has its person; nothing of its
//! own on the wire. First pings alone: no pose, so no frame is rendered, and the link is idle. Then poses, and frames as a
//! replay would get them, with pings between their strips. What is reported is what was seen:
//!
//! - round trip and jitter (mean difference of one to the next, as in RFC 3550) of the idle link, and with frames;
//! - throughput: the most that arrived in any [`WINDOW`]. It is what the link carries only where the server waited for it
//!   before its frames had left, and a lower bound elsewhere;
//! - whether the mode fits: frames came at the asked rate. If not, which took longer than a frame interval.

use super::Failure;
use super::coding::CodingArgs;
use super::trust::TrustArgs;
use crate::assemble::ReadyFrame;
use crate::measure::Percentiles;
use crate::net::{Command, Connection, News};
use crate::replay::ReplayError;
use anyhow::Context;
use clap::Args;
use serde::Serialize;
use std::collections::VecDeque;
use std::time::{Duration, Instant};
use warplight_protocol::message::{Capabilities, Hello, PoseSample, Prediction, Viewport, Welcome};
use warplight_protocol::{Camera, ImageSize, Timestamp, Token};

/// A server that does not answer is given up after this.
const PATIENCE: Duration = Duration::from_secs(5);
/// Throughput is taken over this long: shorter shows the burst that a shaper lets through.
const WINDOW: Duration = Duration::from_millis(250);
/// Time between pings, and between poses, which a display of 60 Hz would send.
const BEAT: Duration = Duration::from_millis(16);
/// Frames fit that come at this part of the asked rate.
const ENOUGH: f64 = 0.9;
/// A frame whose last bytes left so long after they were encoded had to wait for the link.
const HELD_UP: Duration = Duration::from_millis(10);

/// Arguments of `probe`.
#[derive(Debug, Args)]
pub(super) struct ProbeArgs {
    /// Server to look at (host:port).
    // What the arguments of trust require.
    #[arg(id = "connect", value_name = "ADDR")]
    address: String,
    #[command(flatten)]
    trust: TrustArgs,
    /// Wanted size of frames.
    #[arg(long, default_value = "384x384", value_name = "WxH")]
    size: ImageSize,
    /// Wanted frames per second.
    #[arg(long, default_value_t = 10.0, value_parser = super::replay::rate)]
    frame_hz: f64,
    /// Vertical field of view in degrees.
    #[arg(long, default_value_t = 80.0, value_parser = super::replay::field_of_view)]
    fov_deg: f64,
    /// Seconds to look, a quarter of them at the idle link.
    #[arg(long, default_value_t = 6, value_parser = clap::value_parser!(u16).range(1..=600))]
    seconds: u16,
    #[command(flatten)]
    coding: CodingArgs,
    /// Print JSON instead of a table.
    #[arg(long)]
    json: bool,
}

/// What was found.
#[derive(Debug, Serialize)]
struct Findings {
    address: String,
    server: String,
    scene: String,
    size: [u32; 2],
    /// Round trips of the idle link in milliseconds.
    round_trip_ms: Option<Percentiles>,
    jitter_ms: Option<f64>,
    /// Round trips while frames came.
    loaded_round_trip_ms: Option<Percentiles>,
    throughput_mbps: f64,
    /// The link carries more than that.
    throughput_is_lower_bound: bool,
    wanted_hz: f64,
    frame_hz: f64,
    frame_bytes: Option<Percentiles>,
    /// From sampling a pose to its frame being ready.
    age_ms: Option<Percentiles>,
    /// Rendering and encoding.
    server_ms: Option<Percentiles>,
    decode_ms: Option<Percentiles>,
    fits: bool,
    verdict: String,
}

/// What was seen so far.
#[derive(Debug, Default)]
struct Seen {
    welcome: Option<Welcome>,
    idle_ms: Vec<f64>,
    loaded_ms: Vec<f64>,
    arrivals: Vec<Timestamp>,
    bytes: Vec<f64>,
    ages_ms: Vec<f64>,
    server_ms: Vec<f64>,
    decode_ms: Vec<f64>,
    held_up: usize,
    /// Bytes from the server by these times, over the last [`WINDOW`].
    traffic: VecDeque<(Timestamp, u64)>,
    most_mbps: f64,
}

impl Seen {
    fn frame(&mut self, frame: &ReadyFrame) {
        let (begin, end) = (&frame.begin, &frame.end);
        let millis = |from: Timestamp, to: Timestamp| to.since(from).as_secs_f64() * 1e3;
        self.arrivals.push(frame.received);
        self.bytes.push(frame.bytes as f64);
        self.ages_ms.push(millis(begin.pose_time, frame.decoded));
        self.server_ms.push(millis(end.render_start, end.encoded));
        self.decode_ms.push(frame.decode_time.as_secs_f64() * 1e3);
        self.held_up += usize::from(end.sent.since(end.encoded) > HELD_UP);
    }

    fn traffic(&mut self, now: Timestamp, bytes: u64) {
        self.traffic.push_back((now, bytes));
        // The oldest that is a window old stays.
        while self.traffic.get(1).is_some_and(|(at, _)| now.since(*at) >= WINDOW) {
            self.traffic.pop_front();
        }
        if let Some(&(from, before)) = self.traffic.front().filter(|(from, _)| now.since(*from) >= WINDOW) {
            let mbps = (bytes - before) as f64 * 8e-6 / now.since(from).as_secs_f64();
            self.most_mbps = self.most_mbps.max(mbps);
        }
    }

    /// Frames per second between the first and the last.
    fn frame_hz(&self) -> f64 {
        let (Some(&first), Some(&last)) = (self.arrivals.first(), self.arrivals.last()) else { return 0.0 };
        let secs = last.since(first).as_secs_f64();
        if secs > 0.0 { (self.arrivals.len() - 1) as f64 / secs } else { 0.0 }
    }

    fn findings(&self, args: &ProbeArgs) -> Findings {
        let spread = |samples: &[f64]| Percentiles::from_samples(samples).ok();
        let (frame_hz, waited) = (self.frame_hz(), 2 * self.held_up > self.arrivals.len());
        let fits = frame_hz >= ENOUGH * args.frame_hz;
        let median = |samples: &[f64]| spread(samples).map_or(0.0, |spread| spread.p50);
        let interval_ms = 1e3 / args.frame_hz;
        let verdict = if fits {
            "yes".to_owned()
        } else if self.arrivals.is_empty() {
            "no: no frame came".to_owned()
        } else if waited {
            let needed = median(&self.bytes) * 8e-6 * args.frame_hz;
            format!("no: the link: frames need {needed:.1} Mbit/s")
        } else if median(&self.server_ms) > interval_ms {
            format!("no: the server: {:.0} ms for a frame", median(&self.server_ms))
        } else if median(&self.decode_ms) > interval_ms {
            format!("no: this client: {:.0} ms to decode a frame", median(&self.decode_ms))
        } else {
            "no: frames come late, and no stage alone takes longer than their interval".to_owned()
        };
        let jumps: Vec<f64> = self.idle_ms.windows(2).map(|pair| (pair[1] - pair[0]).abs()).collect();
        let welcome = self.welcome.as_ref();
        Findings {
            address: args.address.clone(),
            server: welcome.map_or_else(String::new, |welcome| welcome.software.clone()),
            scene: welcome.map_or_else(String::new, |welcome| welcome.scene.clone()),
            size: [args.size.width, args.size.height],
            round_trip_ms: spread(&self.idle_ms),
            jitter_ms: spread(&jumps).map(|jumps| jumps.mean),
            loaded_round_trip_ms: spread(&self.loaded_ms),
            throughput_mbps: self.most_mbps,
            throughput_is_lower_bound: !waited,
            wanted_hz: args.frame_hz,
            frame_hz,
            frame_bytes: spread(&self.bytes),
            age_ms: spread(&self.ages_ms),
            server_ms: spread(&self.server_ms),
            decode_ms: spread(&self.decode_ms),
            fits,
            verdict,
        }
    }
}

/// Runs the command.
pub(super) fn run(args: &ProbeArgs) -> Result<(), Failure> {
    let hello = Hello {
        capabilities: Capabilities::ALL,
        software: concat!("warplight-client ", env!("CARGO_PKG_VERSION"), " probe").to_owned(),
        camera: Camera::symmetric((args.fov_deg as f32).to_radians(), args.size),
        viewport: Viewport::Plane,
        frame_hz: args.frame_hz as f32,
        format: args.coding.format(),
        target_kbps: args.coding.target_kbps(),
        prediction: Prediction::default(),
        token: Token::NONE,
        // Whether it fits as it is, not what would be left of it.
        adapt: false,
    };
    let unreachable = |source| ReplayError::Connect { address: args.address.clone(), source };
    let connection =
        Connection::start(args.trust.endpoint(&args.address)?, hello, Instant::now()).map_err(unreachable)?;
    let mut seen = Seen::default();
    let deadline = connection.now() + PATIENCE;
    let mut lost = None;
    while seen.welcome.is_none() {
        if connection.now() >= deadline {
            let why = lost.take().unwrap_or_else(|| "no answer".to_owned());
            return Err(unreachable(std::io::Error::new(std::io::ErrorKind::TimedOut, why)).into());
        }
        match connection.wait_for_news(BEAT) {
            Some(News::Open(welcome)) => seen.welcome = Some(welcome),
            Some(News::Failed(end)) => return Err(ReplayError::from(end).into()),
            Some(News::Lost { why, .. }) => lost = Some(why),
            _ => {}
        }
    }
    let length = Duration::from_secs(u64::from(args.seconds));
    let start = connection.now();
    let (frames_start, end) = (start + length / 4, start + length);
    let mut beat = start;
    while connection.now() < end {
        let now = connection.now();
        let with_frames = now >= frames_start;
        connection.tell(Command::Ping);
        if let Some(welcome) = seen.welcome.as_ref().filter(|_| with_frames) {
            connection.tell(Command::Pose(PoseSample { time: now, pose: welcome.head }));
        }
        seen.traffic(now, connection.traffic().down_bytes());
        while let Some(news) = connection.news() {
            match news {
                News::RoundTrip(time) => {
                    let of = if with_frames { &mut seen.loaded_ms } else { &mut seen.idle_ms };
                    of.push(time.as_secs_f64() * 1e3);
                }
                News::Frame(frame) => {
                    seen.frame(&frame);
                    connection.tell(Command::Retire(frame));
                }
                News::Lost { why, .. } => return Err(unreachable(std::io::Error::other(why)).into()),
                News::Failed(end) => return Err(ReplayError::from(end).into()),
                News::Open(_) | News::Statistics(_) | News::Over => {}
            }
        }
        beat += BEAT;
        connection.sleep_until(beat);
    }
    connection.tell(Command::Close);
    let findings = seen.findings(args);
    if args.json {
        println!("{}", serde_json::to_string_pretty(&findings).context("findings as JSON")?);
    } else {
        print!("{}", table(&findings));
    }
    Ok(())
}

fn table(found: &Findings) -> String {
    let p50_p95 = |spread: &Option<Percentiles>, unit: &str, scale: f64| match spread {
        Some(spread) => format!("p50 {:.1}  p95 {:.1} {unit}", spread.p50 * scale, spread.p95 * scale),
        None => "not measured".to_owned(),
    };
    let least = found.round_trip_ms.map_or_else(String::new, |spread| format!("min {:.1}  ", spread.min));
    let at_least = if found.throughput_is_lower_bound { "at least " } else { "" };
    let jitter = found.jitter_ms.map_or_else(|| "not measured".to_owned(), |jitter| format!("{jitter:.2} ms"));
    let [width, height] = found.size;
    let rows = [
        ("server", format!("{}: {}, scene {}", found.address, found.server, found.scene)),
        ("round trip", format!("{least}{}", p50_p95(&found.round_trip_ms, "ms", 1.0))),
        ("  with frames", p50_p95(&found.loaded_round_trip_ms, "ms", 1.0)),
        ("jitter", jitter),
        ("throughput", format!("{at_least}{:.1} Mbit/s down", found.throughput_mbps)),
        ("frames", format!("{:.1} of {} per s at {width}x{height}", found.frame_hz, found.wanted_hz)),
        ("  size", p50_p95(&found.frame_bytes, "kB", 1e-3)),
        ("  pose to ready", p50_p95(&found.age_ms, "ms", 1.0)),
        ("fits", found.verdict.clone()),
    ];
    rows.iter().map(|(name, value)| format!("{name:<16}{value}\n")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Alone {
        #[command(flatten)]
        probe: ProbeArgs,
    }

    fn args() -> ProbeArgs {
        Alone::parse_from(["test", "host:1", "--frame-hz", "10"]).probe
    }

    fn at(millis: u64) -> Timestamp {
        Timestamp { micros: 1000 * millis }
    }

    #[test]
    fn throughput_is_the_most_of_any_window() {
        let mut seen = Seen::default();
        // 1 Mbit/s, then 8 for half a second, then nothing.
        let mut bytes = 0;
        for millis in (0..3000).step_by(10) {
            bytes += match millis {
                0..1000 => 1250,
                1000..1500 => 10_000,
                _ => 0,
            };
            seen.traffic(at(millis), bytes);
        }
        assert!((seen.most_mbps - 8.0).abs() < 1e-9, "{}", seen.most_mbps);
        assert!(seen.traffic.len() < 30, "only a window is kept");
    }

    #[test]
    fn the_verdict_names_what_is_too_slow() {
        let seen = |every_ms: u64, server_ms: f64, held_up: usize| Seen {
            arrivals: (0..20).map(|number| at(every_ms * number)).collect(),
            bytes: vec![250_000.0; 20],
            server_ms: vec![server_ms; 20],
            decode_ms: vec![5.0; 20],
            held_up,
            ..Seen::default()
        };
        let fits = seen(100, 80.0, 0).findings(&args());
        assert!(fits.fits && fits.throughput_is_lower_bound && (fits.frame_hz - 10.0).abs() < 1e-9);
        let link = seen(400, 80.0, 20).findings(&args());
        assert!(!link.fits && !link.throughput_is_lower_bound, "{link:?}");
        assert!(link.verdict.contains("the link") && link.verdict.contains("20.0 Mbit/s"), "{}", link.verdict);
        assert!(seen(200, 190.0, 0).findings(&args()).verdict.contains("the server: 190 ms"));
        let nothing = Seen::default().findings(&args());
        assert!(!nothing.fits && nothing.verdict.contains("no frame"));
        assert!(table(&nothing).contains("not measured"));
    }
}
