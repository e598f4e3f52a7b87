use super::*;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::sync::Arc;
use warplight_protocol::Timestamp;
use warplight_protocol::frame::FrameId;
use warplight_protocol::message::{FrameEnd, Limiter, LimiterKind, Statistics};

/// Reads Prometheus text as its document says: families with their type, and samples by name and labels.
fn parsed(text: &str) -> (BTreeMap<String, String>, BTreeMap<String, f64>) {
    let (mut types, mut samples) = (BTreeMap::new(), BTreeMap::new());
    assert!(text.is_empty() || text.ends_with('\n'));
    for line in text.lines() {
        if let Some(rest) = line.strip_prefix("# TYPE ") {
            let (name, kind) = rest.split_once(' ').unwrap();
            assert!(["counter", "gauge", "histogram"].contains(&kind));
            assert!(types.insert(name.to_owned(), kind.to_owned()).is_none(), "{name} twice");
        } else if let Some(rest) = line.strip_prefix("# HELP ") {
            assert!(rest.split_once(' ').is_some_and(|(_, help)| !help.is_empty()));
        } else {
            let (key, value) = line.rsplit_once(' ').unwrap();
            let name = key.split('{').next().unwrap();
            assert!(name.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_'), "{name}");
            assert_eq!(key.contains('{'), key.ends_with('}'));
            let family = ["_bucket", "_sum", "_count"].iter().find_map(|end| name.strip_suffix(end)).unwrap_or(name);
            assert!(types.contains_key(family) || types.contains_key(name), "{name} before its type");
            assert!(samples.insert(key.to_owned(), value.parse().unwrap()).is_none(), "{key} twice");
        }
    }
    (types, samples)
}

#[test]
fn a_histogram_counts_what_is_below_each_bound() {
    let metrics = Metrics::default();
    for seconds in [0.0005, 0.005, 0.02, 7.0, f64::NAN] {
        metrics.observe("warplight_frame_age_seconds", &[], seconds);
    }
    let (types, samples) = parsed(&metrics.text());
    assert_eq!(types["warplight_frame_age_seconds"], "histogram");
    let below = |bound: &str| samples[&format!("warplight_frame_age_seconds_bucket{{le=\"{bound}\"}}")];
    assert_eq!(
        [below("0.001"), below("0.005"), below("0.01"), below("0.025"), below("2.5"), below("+Inf")],
        [1.0, 2.0, 2.0, 3.0, 3.0, 4.0]
    );
    assert_eq!(samples["warplight_frame_age_seconds_count"], 4.0);
    assert!((samples["warplight_frame_age_seconds_sum"] - 7.0255).abs() < 1e-9);
}

#[test]
fn labels_may_hold_anything() {
    let metrics = Metrics::default();
    metrics.add("warplight_frames_total", &[("fate", "a \"b\\\n}")], 2.0);
    assert!(metrics.text().contains("warplight_frames_total{fate=\"a \\\"b\\\\\\n}\"} 2\n"), "{}", metrics.text());
}

#[test]
fn a_session_counts_while_it_is_open_and_its_frames_remain() {
    let metrics = Arc::new(Metrics::default());
    let mut session = SessionMetrics::new(metrics.clone());
    let at = |micros: u64| Timestamp { micros };
    let end = FrameEnd {
        id: FrameId(1),
        pose_received: at(0),
        render_start: at(1_000),
        render_end: at(81_000),
        encoded: at(85_000),
        sent: at(90_000),
        spp: 1,
    };
    let limiter = |is_active: bool, active_micros: u64| Limiter {
        kind: LimiterKind::Throughput,
        is_active,
        active_micros,
        why: "slow".to_owned(),
    };
    for frame in 1..=3_u32 {
        let limiters = vec![limiter(true, 100_000 * u64::from(frame))];
        let statistics =
            Statistics { frames_rendered: 2 * frame, frames_sent: frame, limiters, ..Statistics::default() };
        session.sent(&end, 1000, &statistics);
    }
    let (_, samples) = parsed(&metrics.text());
    assert_eq!(samples["warplight_sessions"], 1.0);
    assert_eq!(samples["warplight_frames_total{fate=\"sent\"}"], 3.0);
    assert_eq!(samples["warplight_frames_total{fate=\"rendered\"}"], 6.0);
    assert_eq!(samples["warplight_frame_bytes_total"], 3000.0);
    assert_eq!(samples["warplight_limited{limiter=\"throughput\"}"], 1.0);
    assert!((samples["warplight_limited_seconds_total{limiter=\"throughput\"}"] - 0.3).abs() < 1e-9);
    assert_eq!(samples["warplight_interval_seconds_bucket{interval=\"render\",le=\"0.1\"}"], 3.0);
    drop(session);
    let (_, samples) = parsed(&metrics.text());
    assert_eq!(samples["warplight_sessions"], 0.0);
    assert_eq!(samples["warplight_limited{limiter=\"throughput\"}"], 0.0);
    assert!((samples["warplight_limited_seconds_total{limiter=\"throughput\"}"] - 0.3).abs() < 1e-9);
    assert_eq!(samples["warplight_sessions_total"], 1.0);
}

fn asked(address: SocketAddr, request: &str) -> String {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.write_all(request.as_bytes()).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

#[test]
fn figures_are_got_over_http_and_nothing_else_is() {
    let metrics = Arc::new(Metrics::default());
    metrics.add("warplight_sessions_total", &[], 3.0);
    let address = http::serve(([127, 0, 0, 1], 0).into(), metrics).unwrap();
    // A peer that says nothing keeps nobody for long.
    let silent = TcpStream::connect(address).unwrap();
    let answer = asked(address, "GET /metrics HTTP/1.1\r\nHost: x\r\n\r\n");
    drop(silent);
    let (head, body) = answer.split_once("\r\n\r\n").unwrap();
    assert!(head.starts_with("HTTP/1.1 200 OK\r\n") && head.contains("Content-Type: text/plain; version=0.0.4"));
    assert!(head.contains(&format!("Content-Length: {}", body.len())));
    assert_eq!(parsed(body).1["warplight_sessions_total"], 3.0);
    for (request, status) in
        [("GET / HTTP/1.1\r\n\r\n", "404"), ("POST /metrics HTTP/1.1\r\n\r\n", "405"), ("nonsense\r\n\r\n", "400")]
    {
        assert!(asked(address, request).starts_with(&format!("HTTP/1.1 {status} ")), "{request}");
    }
}
