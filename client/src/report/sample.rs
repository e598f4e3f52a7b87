//! A report and pictures with plausible made-up numbers, for the tests of this folder.

use super::page::PictureSet;
use super::{
    ClockKind, Display, DisplaySeries, FrameSeries, Latency, Limit, Link, ModeQuality, NodeReport, Prediction,
    QualitySeries, Reference, Report, SCHEMA, Series, SpecularQuality, SpecularReport, Spike, Spikes, Viewport, doubts,
};
use crate::measure::{Percentiles, compare};
use image::{Rgb, RgbImage};
use std::collections::BTreeMap;

const SECONDS: f64 = 10.0;
const HZ: f64 = 90.0;
/// Name and how far the mode is from the reference.
const MODES: [(&str, f64); 6] =
    [("none", 1.0), ("rotation", 0.55), ("planar", 0.5), ("diffuse", 0.3), ("mesh", 0.33), ("specular", 0.07)];

fn spread(samples: &[f64]) -> Option<Percentiles> {
    Percentiles::from_samples(samples).ok()
}

/// Around `mean`, with a tail upwards; `salt` makes series differ.
fn tailed(count: usize, mean: f64, salt: f64) -> Vec<f64> {
    let noise = |index: usize| ((index as f64 * 12.9898 + salt * 78.233).sin() * 43_758.545).fract().abs();
    (0..count).map(|index| mean * (0.8 + 0.3 * noise(index) + 0.9 * noise(index + 7919).powi(12))).collect()
}

/// A report with a fault or two, warnings included.
pub(super) fn report() -> Report {
    let mut report = sound_report();
    report.display.missed = 17;
    for quality in &mut report.quality {
        quality.compared_frames = 15;
    }
    report.warnings = doubts(&report);
    report
}

/// A report that gives no reason for doubt.
pub(super) fn sound_report() -> Report {
    let frames = (SECONDS * HZ) as usize;
    let times: Vec<f64> = (0..frames).map(|frame| frame as f64 / HZ).collect();
    let motion_to_photon = tailed(frames, 12.2, 1.0);
    let frame_age: Vec<f64> = tailed(frames, 9.0, 2.0)
        .iter()
        .enumerate()
        .map(|(frame, jitter)| {
            38.0 + 11.1 * (frame % 3) as f64 + jitter + if (400..425).contains(&frame) { 55.0 } else { 0.0 }
        })
        .collect();
    let stages = [("render", 19.0), ("encode", 3.1), ("write", 0.4), ("send", 11.2), ("decode", 2.4), ("warp", 3.6)];
    let planes = [
        ("root.radiance", 4_811_200),
        ("root.depth", 1_012_400),
        ("root.normal", 640_800),
        ("reflect.radiance", 2_204_000),
        ("reflect.depth", 540_300),
        ("refract.radiance", 1_630_000),
        ("refract.depth", 388_000),
        ("materials", 12_400),
    ];
    let quality_times: Vec<f64> = (0..60).map(|index| f64::from(index) * SECONDS / 60.0).collect();
    let quality_series = |error: f64| QualitySeries {
        psnr_db: quality_times.iter().map(|t| 33.0 - 14.0 * error - 3.0 * (error + 0.1) * (1.3 * t).sin()).collect(),
        specular_psnr_db: quality_times.iter().map(|t| Some(28.0 - 14.0 * error - 3.0 * (1.3 * t).sin())).collect(),
        dssim: quality_times.iter().map(|t| 0.12 * error * (1.2 + (1.3 * t).sin())).collect(),
        flip: quality_times.iter().map(|t| 0.01 + 0.16 * error * (1.3 + (1.3 * t + 0.4).sin())).collect(),
        hole_fraction: quality_times.iter().map(|t| 0.006 * error * (1.0 + (2.0 * t).cos())).collect(),
        time_s: quality_times.clone(),
    };
    let quality: BTreeMap<String, QualitySeries> =
        MODES.into_iter().map(|(mode, error)| (mode.to_owned(), quality_series(error))).collect();
    let mode_quality = |mode: &str| ModeQuality {
        mode: mode.to_owned(),
        psnr_db: spread(&quality[mode].psnr_db),
        dssim: spread(&quality[mode].dssim),
        flip: spread(&quality[mode].flip),
        hole_fraction: spread(&quality[mode].hole_fraction),
        compared_frames: 60,
        specular: Some(SpecularQuality {
            psnr_db: spread(&quality[mode].psnr_db.iter().map(|psnr| psnr - 5.0).collect::<Vec<_>>()),
            dssim: spread(&quality[mode].dssim.iter().map(|dssim| dssim * 2.0).collect::<Vec<_>>()),
            flip: spread(&quality[mode].flip.iter().map(|flip| flip * 2.0).collect::<Vec<_>>()),
            pixel_fraction: spread(&tailed(60, 0.22, 9.0)),
        }),
        eyes: BTreeMap::new(),
    };
    Report {
        schema: SCHEMA,
        scene: "gallery".into(),
        trace: "built-in <seed 1>".into(),
        seed: 7,
        clock: ClockKind::Virtual,
        size: [640, 480],
        mode: "diffuse".into(),
        optics: None,
        effects: ["reflection", "refraction", "absorption", "diffuse"].map(String::from).to_vec(),
        display: Display { hz: HZ, frames: frames as u64, missed: 3 },
        latency_ms: Latency {
            motion_to_photon: spread(&motion_to_photon),
            frame_age: spread(&frame_age),
            stages: stages
                .into_iter()
                .filter_map(|(stage, mean)| Some((stage.to_owned(), spread(&tailed(300, mean, mean))?)))
                .collect(),
            clock_offset: None,
        },
        spikes: Spikes {
            motion_to_photon: 0,
            frame_age: 1,
            listed: vec![Spike {
                time_s: 4.6,
                delay: "frame age".into(),
                ms: 172.0,
                median_ms: 53.0,
                interval: "render".into(),
                interval_ms: 121.0,
                beyond_ms: 102.0,
            }],
        },
        budget: None,
        limits: vec![Limit {
            name: "throughput".into(),
            share: 0.25,
            why: "the link carries 4.10 Mbit/s: coarser colour and depth".into(),
        }],
        prediction: Prediction {
            horizon_ms: 48.5,
            error_deg: spread(&tailed(300, 0.9, 3.0)),
            error_mm: spread(&tailed(300, 3.1, 4.0)),
            law: "adaptive".into(),
            at_horizon_deg: spread(&tailed(300, 0.5, 5.0)),
            at_horizon_mm: spread(&tailed(300, 1.8, 6.0)),
            unpredicted_deg: spread(&tailed(300, 1.4, 7.0)),
            unpredicted_mm: spread(&tailed(300, 6.0, 8.0)),
        },
        viewport: Viewport {
            guard_deg: spread(&tailed(300, 3.1, 6.0)),
            pixels_per_display_pixel: spread(&tailed(300, 1.2, 7.0)),
        },
        link: Link {
            down_bytes: 11_260_310,
            up_bytes: 91_204,
            down_mbps: 9.008,
            frames_sent: 300,
            frames_shown: 296,
            frames_replaced: 4,
            frames_lost: 0,
            frames_unsent: 2,
            reconnects: 0,
            latency_ms: Some(10.0),
            jitter_ms: Some(2.0),
            rate_mbps: None,
            stall_ms: None,
            stall_every_ms: None,
            cut_at_s: None,
            cut_s: None,
            planes: planes.into_iter().map(|(name, bytes)| (name.to_owned(), bytes)).collect(),
        },
        quality: MODES.into_iter().map(|(mode, _)| mode_quality(mode)).collect(),
        reference: Some(Reference { spp: 1024, noise_psnr_db: Some(44.2), specular_noise_psnr_db: Some(41.0) }),
        specular: SpecularReport {
            solver: "frozen-distance".into(),
            normals: "transmitted".into(),
            nodes: [("D", 1.0), ("R", 0.3), ("F", 0.2)]
                .into_iter()
                .filter_map(|(node, seen)| {
                    let of = |mean| spread(&tailed(60, mean, seen));
                    let (seen, undefined, filled) = (of(seen)?, of(0.01 / seen)?, of(0.02 / seen)?);
                    Some(NodeReport { node: node.into(), seen, undefined, filled })
                })
                .collect(),
        },
        counters: [
            ("rays.primary", 92_160_000),
            ("rays.reflect", 31_004_112),
            ("rays.refract", 20_811_007),
            ("rays.shadow", 201_333_808),
        ]
        .into_iter()
        .map(|(name, count)| (name.to_owned(), count))
        .collect(),
        warnings: Vec::new(),
        series: Series {
            display: DisplaySeries {
                time_s: times,
                frame_age_ms: frame_age.into_iter().enumerate().map(|(n, age)| (n >= 5).then_some(age)).collect(),
                motion_to_photon_ms: motion_to_photon.into_iter().map(Some).collect(),
            },
            frames: FrameSeries {
                time_s: (0..300).map(|frame| f64::from(frame) / 30.0).collect(),
                bytes: tailed(300, 37_000.0, 5.0).into_iter().map(|bytes| bytes as u64).collect(),
            },
            quality,
        },
    }
}

/// Pictures of a made-up room, each mode moved by its error.
pub(super) fn pictures() -> Vec<PictureSet> {
    let room = |shift: f64| {
        RgbImage::from_fn(320, 240, |x, y| {
            let (x, y) = (f64::from(x) + shift, f64::from(y));
            let inside = (x - 200.0).hypot(y - 130.0) < 60.0;
            let checker = ((x / 24.0).floor() + (y / 24.0).floor()) % 2.0 == 0.0;
            match (inside, y > 150.0) {
                (true, _) => Rgb([190, 200 - (y / 2.0) as u8, 120 + (x / 4.0) as u8]),
                (false, true) if checker => Rgb([205, 190, 160]),
                (false, true) => Rgb([110, 84, 62]),
                (false, false) => Rgb([70 + (x / 5.0) as u8, 96, 120 + (y / 3.0) as u8]),
            }
        })
    };
    let set = |title: &str, time_s: f64, motion: f64| {
        let reference = room(0.0);
        let modes = MODES.map(|(mode, error)| {
            let shown = room((motion * error).round());
            let compared = compare(&reference, &shown, None).expect("equal sizes");
            (mode.to_owned(), shown, compared.map.to_magma(), compared.error)
        });
        PictureSet { title: title.into(), time_s, reference, modes: modes.to_vec() }
    };
    vec![set("Slow turn & a step", 2.4, 7.0), set("Fastest turn", 6.1, 22.0)]
}
