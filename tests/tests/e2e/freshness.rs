//! Delay stays bounded whatever the link does: the latest frame wins.

use std::time::Duration;
use warplight_client::link::LinkModel;
use warplight_tests::{Pair, PairOptions};

fn options(link: LinkModel) -> PairOptions {
    PairOptions {
        link,
        frame_hz: 10.0,
        render: Duration::from_millis(80),
        frame_bytes: 100_000,
        pose_hz: 90.0,
        seed: 5,
    }
}

fn ages_ms(pair: &Pair) -> Vec<f64> {
    pair.arrivals().iter().map(|arrival| arrival.age.as_secs_f64() * 1e3).collect()
}

#[test]
fn a_free_link_carries_every_frame() {
    let link = LinkModel { latency: Duration::from_millis(20), ..LinkModel::default() };
    let mut pair = Pair::new(options(link));
    pair.drive(Duration::from_secs(10));
    let count = pair.arrivals().len();
    assert!((98..=101).contains(&count), "{count} frames in 10 s at 10 Hz");
    // Up to a pose interval old when it arrives, rendered for 80 ms, 20 ms each way.
    assert!(ages_ms(&pair).iter().all(|&age| (120.0..=135.0).contains(&age)), "{:?}", ages_ms(&pair));
}

#[test]
fn a_link_of_a_quarter_of_the_rate_delays_by_a_transfer_and_no_more() {
    // 8 Mbit/s are wanted and 2 there: a frame takes 400 ms on the wire.
    let link = LinkModel { latency: Duration::from_millis(20), rate_bits_per_sec: Some(2e6), ..LinkModel::default() };
    let mut pair = Pair::new(options(link));
    pair.drive(Duration::from_secs(120));
    let ages = ages_ms(&pair);
    assert!(ages.len() > 280, "{} frames: the link is idle", ages.len());
    // Two frame intervals, the transfer of one frame, and the way there and back.
    let bound_ms = 2.0 * 100.0 + 400.0 + 40.0 + 12.0;
    let worst = ages.iter().copied().fold(0.0, f64::max);
    assert!(worst <= bound_ms, "{worst} ms");
    // And it does not grow. Transfers and beats go in and out of step: a frame takes a little more than four beats, so ages
    // rise by up to a beat and fall again in the course of some half a minute, which halves of two minutes both see.
    let (early, late) = ages[5..].split_at(ages.len() / 2);
    let worst = |ages: &[f64]| ages.iter().copied().fold(0.0, f64::max);
    assert!((worst(late) - worst(early)).abs() < 20.0, "{ages:.0?}");
}

#[test]
fn a_stalled_link_is_fresh_again_at_once() {
    let stall = Some((Duration::from_secs(5), Duration::from_secs(1)));
    let link =
        LinkModel { latency: Duration::from_millis(20), rate_bits_per_sec: Some(50e6), stall, ..LinkModel::default() };
    let mut pair = Pair::new(options(link));
    pair.drive(Duration::from_secs(30));
    assert!(pair.client().is_open() && pair.server().end().is_none());
    // What was on its way during a stall is old; half a second after it nothing is.
    let is_old = |age: Duration| age > Duration::from_millis(300);
    let after_stall = |micros: u64| micros > 5_000_000 && micros % 5_000_000 > 1_500_000;
    for arrival in pair.arrivals() {
        assert!(!(after_stall(arrival.at.micros) && is_old(arrival.age)), "{arrival:?}");
    }
    assert!(pair.arrivals().iter().filter(|arrival| is_old(arrival.age)).count() <= 4 * 5, "at most a few per stall");
}

#[test]
fn frames_arrive_in_order_and_once() {
    let link = LinkModel {
        latency: Duration::from_millis(50),
        jitter: Duration::from_millis(30),
        rate_bits_per_sec: Some(6e6),
        stall: None,
        cut: None,
    };
    let mut pair = Pair::new(options(link));
    pair.drive(Duration::from_secs(20));
    assert!(pair.arrivals().windows(2).all(|pair| pair[0].id < pair[1].id));
}

#[test]
fn the_same_seed_gives_the_same_session() {
    let link =
        LinkModel { latency: Duration::from_millis(30), jitter: Duration::from_millis(20), ..LinkModel::default() };
    let run = || {
        let mut pair = Pair::new(options(link));
        pair.drive(Duration::from_secs(5));
        pair.arrivals().to_vec()
    };
    assert_eq!(run(), run());
}
