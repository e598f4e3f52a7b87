//! What becomes of frames and of the display over links that stall, jitter and are cut, and with a server that is killed:
//! every frame that was sent is shown, replaced or lost, none is shown twice as new, and the display never stops.

use std::time::Duration;
use warplight_client::link::LinkModel;
use warplight_tests::{Pair, PairOptions};

const DISPLAY_HZ: f64 = 90.0;

fn options(link: LinkModel, seed: u64) -> PairOptions {
    PairOptions {
        link,
        frame_hz: 10.0,
        render: Duration::from_millis(80),
        frame_bytes: 100_000,
        pose_hz: DISPLAY_HZ,
        seed,
    }
}

fn link() -> LinkModel {
    LinkModel { latency: Duration::from_millis(20), rate_bits_per_sec: Some(20e6), ..LinkModel::default() }
}

/// After everything has arrived: each fate was counted where it happens.
fn adds_up(pair: &mut Pair, what: &str) {
    pair.drain();
    let (fates, refreshes) = (pair.fates(), pair.refreshes());
    assert_eq!(fates.sent, fates.shown + fates.replaced + fates.lost, "{what}: {fates:?}");
    assert_eq!(refreshes.shown_twice, 0, "{what}: {refreshes:?}");
    let elapsed_secs = pair.now().as_secs();
    assert!((refreshes.all as f64 - elapsed_secs * DISPLAY_HZ).abs() <= 1.5, "{what}: {refreshes:?}");
    let interval_secs = 1.0 / DISPLAY_HZ;
    assert!(refreshes.longest_pause.as_secs_f64() < interval_secs + 2e-6, "{what}: the display stopped: {refreshes:?}");
    let without = refreshes.all - refreshes.with_frame;
    // Until the first frame has come: a round trip, its rendering and its transfer.
    assert!(without as f64 * interval_secs < 0.7, "{what}: {refreshes:?}");
}

/// When the first frame of the session after the first arrived, in seconds.
fn resumed_at_secs(pair: &Pair) -> f64 {
    let first = pair.arrivals().iter().find(|arrival| arrival.session > 0);
    first.expect("a frame after the reconnection").at.as_secs()
}

#[test]
fn a_stalling_jittering_link_loses_nothing() {
    let stall = Some((Duration::from_secs(5), Duration::from_secs(1)));
    for seed in 0..20 {
        let mut pair = Pair::new(options(LinkModel { stall, jitter: Duration::from_millis(30), ..link() }, seed));
        pair.drive(Duration::from_secs(30));
        assert_eq!(pair.reconnects(), 0);
        adds_up(&mut pair, "stalls and jitter");
        assert_eq!(pair.fates().lost, 0);
    }
}

#[test]
fn after_a_cut_of_three_seconds_the_session_resumes_within_one() {
    for seed in 0..50 {
        let at = Duration::from_millis(5000 + 37 * seed);
        let cut = Some((at, Duration::from_secs(3)));
        let mut pair = Pair::new(options(LinkModel { cut, jitter: Duration::from_millis(30), ..link() }, seed));
        pair.drive(Duration::from_secs(20));
        assert_eq!(pair.reconnects(), 1, "{seed}");
        let back_secs = (at + Duration::from_secs(3)).as_secs_f64();
        let resumed_secs = resumed_at_secs(&pair);
        assert!(resumed_secs > back_secs && resumed_secs < back_secs + 1.0, "{seed}: {back_secs} {resumed_secs}");
        adds_up(&mut pair, "a cut");
        assert!(pair.fates().lost > 0, "{:?}", pair.fates());
    }
}

/// A cut that is over before either end has noticed: what is left of the connection is reset.
#[test]
fn after_a_short_cut_it_resumes_within_a_second_too() {
    for seed in 0..20 {
        let at = Duration::from_millis(5000 + 37 * seed);
        let cut = Some((at, Duration::from_millis(500)));
        let mut pair = Pair::new(options(LinkModel { cut, ..link() }, seed));
        pair.drive(Duration::from_secs(10));
        let back_secs = at.as_secs_f64() + 0.5;
        assert!(resumed_at_secs(&pair) < back_secs + 1.0, "{seed}");
        adds_up(&mut pair, "a short cut");
    }
}

#[test]
fn a_server_that_is_killed_and_started_again_is_found_within_a_second() {
    for seed in 0..50 {
        let mut pair = Pair::new(options(link(), seed));
        pair.drive(Duration::from_millis(4000 + 23 * seed));
        let back_secs = pair.now().as_secs() + 1.0;
        pair.restart_server(Duration::from_secs(1));
        pair.drive(Duration::from_secs(5));
        assert_eq!(pair.reconnects(), 1, "{seed}");
        assert!(resumed_at_secs(&pair) < back_secs + 1.0, "{seed}");
        adds_up(&mut pair, "a restart");
    }
}

#[test]
fn with_all_of_it_at_once_every_frame_is_accounted_for() {
    let stall = Some((Duration::from_secs(5), Duration::from_secs(1)));
    let cut = Some((Duration::from_secs(17), Duration::from_secs(3)));
    for seed in 0..20 {
        let model = LinkModel { stall, cut, jitter: Duration::from_millis(30), ..link() };
        let mut pair = Pair::new(options(model, seed));
        pair.drive(Duration::from_millis(8000 + 91 * seed));
        pair.restart_server(Duration::from_millis(700));
        pair.drive(Duration::from_secs(30));
        assert!(pair.reconnects() >= 2, "{}", pair.reconnects());
        adds_up(&mut pair, "all at once");
        let fates = pair.fates();
        assert!(fates.shown > 200, "{fates:?}");
    }
}

/// A quarter of what the frames need, for a minute.
#[test]
fn at_a_quarter_of_the_rate_nothing_is_queued_and_the_rest_is_never_sent() {
    let model = LinkModel { rate_bits_per_sec: Some(2e6), ..link() };
    let mut pair = Pair::new(options(model, 3));
    pair.drive(Duration::from_secs(60));
    let transfer_ms = 100_000.0 * 8.0 / 2e3;
    let worst_ms = pair.arrivals().iter().map(|arrival| arrival.age.as_secs_f64() * 1e3).fold(0.0, f64::max);
    println!("frame age at most {worst_ms:.0} ms for a transfer of {transfer_ms:.0} ms");
    // Two frame intervals and a transfer; and the link's own delay, both ways, with the pose's wait for a refresh.
    assert!(worst_ms < 2.0 * 100.0 + transfer_ms + 2.0 * 20.0 + 12.0, "{worst_ms} ms");
    // The frame being sent and the one behind it.
    assert!(pair.most_waiting_bytes() <= 2 * 100_000, "{} bytes wait", pair.most_waiting_bytes());
    adds_up(&mut pair, "a quarter of the rate");
    let fates = pair.fates();
    assert!(fates.lost == 0 && fates.replaced == 0 && fates.unsent > 400, "{fates:?}");
    assert!(fates.sent > 140, "the link is idle: {fates:?}");
}
