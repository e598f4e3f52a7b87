//! Times and errors of the ways to bring a layered volume to a new pose, on phantoms.
//!
//! `cargo run --release -p warplight-client --example march_time -- [side] [layers] [rounds]`: medians of so many rounds, in
//! milliseconds, PSNR against the plain walk, DSSIM against the truth.

use glam::Vec4;
use image::RgbImage;
use std::time::Instant;
use warplight_client::march::phantom::{self, Phantom};
use warplight_client::march::{Marcher, Method};
use warplight_client::measure::dssim;
use warplight_protocol::tone::display_from_radiance;

fn main() {
    let mut arguments = std::env::args().skip(1).map(|argument| argument.parse::<usize>().unwrap_or(0));
    let side = arguments.next().unwrap_or(1024) as u32;
    let layers = arguments.next().unwrap_or(4);
    let rounds = arguments.next().unwrap_or(9).max(1);
    let camera = phantom::camera(side);
    println!("{side}x{side}, {layers} layers, {} threads", rayon::current_num_threads());
    for phantom in Phantom::ALL {
        let tree = phantom.frame(&phantom::orbit(0.0), &camera, layers);
        let mut marcher = Marcher::default();
        let prepare = median(rounds, || marcher.prepare(&tree));
        println!("{}: prepare {prepare:.1} ms", phantom.name());
        for degrees in [0.0, 5.0, 10.0, 15.0_f64] {
            let pose = phantom::orbit(degrees.to_radians());
            let truth = phantom.picture(&pose, &camera);
            let mut plain = Vec::new();
            marcher.march(Method::Plain, &tree, &pose, &camera, None, &mut plain);
            println!("  {degrees:4} degrees, plain: DSSIM {:.4}", error(&truth, &plain, side));
            for method in [Method::Slabs, Method::MeanDepth] {
                let mut out = Vec::new();
                let time = median(rounds.min(5), || {
                    marcher.march(method, &tree, &pose, &camera, None, &mut out);
                });
                println!("    {}: {time:.1} ms, DSSIM {:.4}", method.name(), error(&truth, &out, side));
            }
            for stride in [1.0, 1.5, 2.0, 3.0] {
                marcher.set_stride(stride);
                let mut out = Vec::new();
                let mut statistics = Default::default();
                let time = median(rounds, || {
                    statistics = marcher.march(Method::Layers, &tree, &pose, &camera, None, &mut out);
                });
                let (error, psnr) = (error(&truth, &out, side), psnr(&plain, &out));
                println!("    stride {stride}: {time:6.1} ms, {psnr:.1} dB, DSSIM {error:.4}, {statistics:?}");
            }
        }
    }
}

fn median(rounds: usize, mut work: impl FnMut()) -> f64 {
    let mut times: Vec<f64> = (0..rounds)
        .map(|_| {
            let start = Instant::now();
            work();
            start.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[rounds / 2]
}

fn error(truth: &[Vec4], found: &[Vec4], side: u32) -> f64 {
    let codes = |picture: &[Vec4]| {
        let bytes = picture.iter().flat_map(|found| display_from_radiance(found.truncate(), 1.0)).collect();
        RgbImage::from_raw(side, side, bytes).unwrap_or_default()
    };
    dssim(&codes(truth), &codes(found), None).unwrap_or(f64::NAN)
}

fn psnr(a: &[Vec4], b: &[Vec4]) -> f64 {
    let sum: f64 = a.iter().zip(b).map(|(a, b)| f64::from((*a - *b).length_squared())).sum();
    -10.0 * (sum / (4.0 * a.len() as f64)).log10()
}
