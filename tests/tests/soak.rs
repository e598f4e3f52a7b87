//! A long session in virtual time: memory stays what it was, and nothing drifts.
//!
//! Memory is what an allocator that counts says is in use, so what sessions, links and harness hold is all of it. The short
//! form runs with all tests; the long one, 1.1 million poses and over 100 thousand frames, by
//! `cargo test --release -p warplight-tests --test soak -- --ignored --nocapture`.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicIsize, Ordering};
use std::time::Duration;
use warplight_client::link::LinkModel;
use warplight_tests::{Pair, PairOptions};

static IN_USE: AtomicIsize = AtomicIsize::new(0);

struct Counting;

// SAFETY: every call is passed on to the system's allocator.
#[allow(unsafe_code, reason = "an allocator is unsafe to implement")]
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        IN_USE.fetch_add(layout.size() as isize, Ordering::Relaxed);
        // SAFETY: the caller's promise.
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        IN_USE.fetch_sub(layout.size() as isize, Ordering::Relaxed);
        // SAFETY: the caller's promise.
        unsafe { System.dealloc(pointer, layout) }
    }
    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        IN_USE.fetch_add(size as isize - layout.size() as isize, Ordering::Relaxed);
        // SAFETY: the caller's promise.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static COUNTING: Counting = Counting;

/// The counter is of the whole process: one test at a time.
static ALONE: std::sync::Mutex<()> = std::sync::Mutex::new(());

const FRAME_HZ: f64 = 10.0;
const POSE_HZ: f64 = 100.0;

/// What a stretch of a session was like.
#[derive(Debug)]
struct Stretch {
    frames: usize,
    mean_age_ms: f64,
    worst_age_ms: f64,
    /// Most in use at any second's end.
    bytes: isize,
}

fn stretch(pair: &mut Pair, secs: u64) -> Stretch {
    let (mut frames, mut sum_ms, mut worst_ms, mut bytes) = (0, 0.0, 0.0_f64, 0);
    for _ in 0..secs {
        pair.drive(Duration::from_secs(1));
        for arrival in pair.arrivals() {
            let age_ms = arrival.age.as_secs_f64() * 1e3;
            frames += 1;
            sum_ms += age_ms;
            worst_ms = worst_ms.max(age_ms);
        }
        pair.forget_arrivals();
        bytes = bytes.max(IN_USE.load(Ordering::Relaxed));
    }
    Stretch { frames, mean_age_ms: sum_ms / frames.max(1) as f64, worst_age_ms: worst_ms, bytes }
}

/// Runs for 22 times `secs`; the first of them warms up.
fn soak(link: LinkModel, secs: u64) -> (Pair, Vec<Stretch>) {
    let mut pair = Pair::new(PairOptions {
        link,
        frame_hz: FRAME_HZ as f32,
        render: Duration::from_millis(40),
        frame_bytes: 8000,
        pose_hz: POSE_HZ,
        seed: 11,
    });
    let stretches = (0..22).map(|_| stretch(&mut pair, secs)).collect();
    (pair, stretches)
}

fn holds(link: LinkModel, secs: u64, expected_frames_per_s: f64) {
    let _alone = ALONE.lock().unwrap();
    let (pair, stretches) = soak(link, secs);
    let (early, late) = (&stretches[1], &stretches[21]);
    println!("{} s: {early:?} ... {late:?}, {:?}, {:?}", 22 * secs, pair.fates(), pair.refreshes());
    // What varies is what is under way at the end of a second: a frame, poses and what lists have grown to by then.
    assert!(late.bytes <= early.bytes + 4096, "memory grew: {early:?} {late:?}");
    assert!((late.mean_age_ms - early.mean_age_ms).abs() < 2.0, "delay drifts: {early:?} {late:?}");
    let elapsed_secs = pair.now().as_secs();
    // Poses are sampled exactly on time however long it runs.
    assert!((pair.refreshes().all as f64 - elapsed_secs * POSE_HZ).abs() <= 1.5, "{:?}", pair.refreshes());
    let frames: usize = stretches.iter().map(|stretch| stretch.frames).sum();
    let expected = expected_frames_per_s * elapsed_secs;
    assert!((frames as f64 / expected - 1.0).abs() < 0.01, "{frames} frames for {expected}");
}

fn free() -> LinkModel {
    LinkModel { latency: Duration::from_millis(20), jitter: Duration::from_millis(5), ..LinkModel::default() }
}

/// Frames of 8000 bytes ten times a second are 640 kbit/s and a little: a quarter of it.
fn slow() -> LinkModel {
    LinkModel { rate_bits_per_sec: Some(160e3), latency: Duration::from_millis(20), ..LinkModel::default() }
}

#[test]
fn ten_thousand_poses_and_a_thousand_frames_leave_memory_as_it_was() {
    holds(free(), 5, FRAME_HZ);
}

#[test]
fn at_a_quarter_of_the_rate_memory_is_flat_for_a_minute() {
    let _alone = ALONE.lock().unwrap();
    let (pair, stretches) = soak(slow(), 3);
    let (early, late) = (&stretches[1], &stretches[21]);
    println!("{early:?} ... {late:?}, {:?}", pair.fates());
    assert!(late.bytes <= early.bytes + 4096, "memory grew: {early:?} {late:?}");
    let ages = |stretches: &[Stretch]| stretches.iter().map(|stretch| stretch.worst_age_ms).fold(0.0, f64::max);
    let (first, second) = (ages(&stretches[1..11]), ages(&stretches[11..]));
    assert!(second < first + 150.0, "delay grows: {first} {second} ms");
}

#[test]
#[ignore = "takes a minute"]
fn a_million_poses_and_a_hundred_thousand_frames_leave_memory_as_it_was() {
    holds(free(), 500, FRAME_HZ);
}
