use super::scales::units_of_code;
use super::*;
use crate::codec::{StripDecoder, StripEncoder};
use crate::frame::{ColorCoding, FrameFormat, Interfaces, Plan, Tree, VolumeFormat, VolumeSegment};
use crate::{Camera, ImageSize, Pose};
use glam::Vec3;
use proptest::prelude::*;

const RANGE: VolumeRange = VolumeRange { near_m: 2.0, far_m: 6.0 };

fn shape(volume: VolumeFormat, range: VolumeRange, size: ImageSize) -> FrameShape {
    FrameShape {
        camera: Camera::symmetric(1.0, size),
        plan: Plan::diffuse(),
        interfaces: Interfaces::default(),
        format: FrameFormat { volume, ..FrameFormat::exact() },
        volume: range,
        strip_rows: size.height as u16,
        exposure: 1.0,
    }
}

fn coded(shape: &FrameShape, tree: &mut Tree) -> Tree {
    let mut strip = Vec::new();
    let mut bands = tree.bands_mut(u32::from(shape.strip_rows));
    StripEncoder::default().encode(shape, &bands[0], &mut strip);
    let mut back = shape.tree(Pose::IDENTITY);
    StripDecoder::default().decode(shape, &strip, &mut back.bands_mut(u32::from(shape.strip_rows))[0]).unwrap();
    drop(bands.pop());
    back
}

/// One pixel with these segments, through the codec.
fn through_codec(format: VolumeFormat, range: VolumeRange, segments: &[VolumeSegment]) -> Vec<Option<VolumeSegment>> {
    let format = VolumeFormat { layers: segments.len() as u8, ..format };
    let shape = shape(format, range, ImageSize::new(1, 1));
    let mut tree = shape.tree(Pose::IDENTITY);
    for (layer, segment) in tree.bands_mut(1)[0].layers.iter_mut().zip(segments) {
        layer.set(0, (segment.optical_depth > 0.0).then_some(segment));
    }
    coded(&shape, &mut tree).layers.iter().map(|layer| layer.at(0)).collect()
}

fn segment(front_m: f32, back_m: f32, optical_depth: f32, source: f32) -> VolumeSegment {
    VolumeSegment { front_m, back_m, optical_depth, source: Vec3::splat(source) }
}

/// The depth code at near, at far, behind the eye, infinite and NaN.
#[test]
fn depths_come_back_within_half_a_unit_and_units_rise_with_them() {
    for (range, bits) in [(RANGE, 4), (RANGE, 12), (VolumeRange { near_m: 0.0, far_m: 1000.0 }, 12), (RANGE, 16)] {
        let scale = DepthScale::new(range, bits);
        let largest = scale.highest;
        assert_eq!((scale.units(range.near_m), scale.units(range.far_m)), (0, largest));
        assert_eq!((scale.units(-1.0), scale.units(f32::NAN), scale.units(f32::INFINITY)), (0, 0, largest));
        for units in 0..=largest {
            assert_eq!(scale.units(scale.depth(units)), units);
        }
        for units in 1..=largest {
            assert!(scale.depth(units) > scale.depth(units - 1), "{range:?} {units}");
        }
    }
    // A display of 1000 px focal length, moved by 0.35 m, sees steps of less than 0.1 px.
    let scale = DepthScale::new(RANGE, 12);
    let depth = |code: i32| scale.depth(code * units_of_code(12));
    let worst = (1..4096).map(|code| 1.0 / depth(code - 1) - 1.0 / depth(code)).fold(0.0, f32::max);
    assert!(1000.0 * 0.35 * worst < 0.1, "{worst}");
}

#[test]
fn optical_depths_come_back_within_half_a_unit_of_their_logarithm() {
    for bits in VolumeFormat::OPTICAL_DEPTH_BITS {
        let scale = OpticalDepthScale::new(bits);
        let half_unit = 0.5 * (THICKEST / THINNEST).ln() / scale.highest as f32;
        for step in 0..=1000 {
            let optical_depth = THINNEST * (THICKEST / THINNEST).powf(step as f32 / 1000.0);
            let back = scale.optical_depth(scale.units(optical_depth));
            assert!((back / optical_depth).ln().abs() <= half_unit + 1e-5, "{optical_depth} {back}");
        }
        assert_eq!(scale.units(1e-20), 0);
        assert_eq!(scale.units(f32::INFINITY), scale.highest);
    }
}

/// Half a code, as a difference of logarithms.
fn half_code_of_log(bits: u8) -> f32 {
    0.5 * (THICKEST / THINNEST).ln() * units_of_code(bits) as f32 / OpticalDepthScale::new(bits).highest as f32
}

/// What the background is seen through is off by the last segment's half step, not by the sum of all.
#[test]
fn the_error_of_an_optical_depth_is_made_up_for_by_the_next() {
    let format = VolumeFormat::default();
    let half_step = half_code_of_log(format.optical_depth_bits);
    for step in 0..50 {
        let thin = 0.05 * 1.013_f32.powi(step);
        let segments: Vec<_> =
            (0..8).map(|at| segment(2.0 + at as f32 * 0.5, 2.5 + at as f32 * 0.5, thin, 1.0)).collect();
        let back = through_codec(format, RANGE, &segments);
        let sum: f32 = back.iter().flatten().map(|segment| segment.optical_depth).sum();
        assert!((sum - 8.0 * thin).abs() < 1.05 * half_step * thin, "{thin}: {sum}");
    }
}

#[test]
fn what_a_segment_sends_survives_the_coding_of_its_optical_depth() {
    let format = VolumeFormat { source: ColorFormat::Half, optical_depth_bits: 6, ..VolumeFormat::default() };
    for optical_depth in [1e-3, 0.03, 0.4, 3.0, 20.0] {
        let was = segment(2.5, 3.0, optical_depth, 0.7);
        let is = through_codec(format, RANGE, &[was])[0].unwrap();
        let (was, is) = (was.source.x * was.opacity(), is.source.x * is.opacity());
        // A half float has 11 digits.
        assert!((is / was - 1.0).abs() < 6e-4, "{optical_depth}: {was} {is}");
    }
}

/// Layering that degenerates: segments without length, at the far end, out of order, without numbers.
#[test]
fn segments_that_are_none_or_too_short_come_back_in_order() {
    let format = VolumeFormat::default();
    let crowd = [segment(5.9999, 6.0, 1.0, 1.0); 8];
    let back: Vec<_> = through_codec(format, RANGE, &crowd).into_iter().flatten().collect();
    assert_eq!(back.len(), 8);
    assert!(back.windows(2).all(|pair| pair[0].back_m <= pair[1].front_m));
    assert!(back.iter().all(|segment| segment.back_m > segment.front_m && segment.back_m <= 6.001));
    let nothing = [
        segment(3.0, 3.0, 1.0, 1.0),
        segment(4.0, 3.0, 1.0, 1.0),
        segment(f32::NAN, 3.0, 1.0, 1.0),
        segment(3.0, 4.0, f32::NAN, 1.0),
        segment(3.0, 4.0, 0.0, 1.0),
        segment(3.0, 4.0, -1.0, 1.0),
    ];
    assert!(through_codec(format, RANGE, &nothing).iter().all(Option::is_none));
    let infinite = through_codec(format, RANGE, &[segment(3.0, f32::INFINITY, f32::INFINITY, f32::NAN)])[0].unwrap();
    assert!((infinite.back_m - 6.0).abs() < 1e-4 && infinite.optical_depth < 24.1);
    assert_eq!(infinite.source, Vec3::ZERO);
}

/// Whatever a peer sends: the segments of a pixel stand in order, each with a length, within the range.
#[test]
fn any_samples_are_segments_in_order() {
    for bits in [4, 8, 16] {
        let scale = DepthScale::new(RANGE, bits);
        let largest = scale.highest;
        let ends = [0, 1, largest / 2, largest - 1, largest];
        for first in ends.into_iter().flat_map(|gap| ends.map(|back| [gap, back])) {
            for second in ends.into_iter().flat_map(|gap| ends.map(|back| [gap, back])) {
                let mut last_back = [0];
                let mut before = 0;
                for (behind, [gap, back]) in
                    [first, second, second].into_iter().enumerate().map(|(at, ends)| (2 - at as i32, ends))
                {
                    let (mut front, mut back) = ([gap], [back]);
                    put_in_order(&scale, behind, &[true], &mut last_back, &mut front, &mut back);
                    assert!(before <= front[0] && front[0] < back[0] && back[0] <= largest, "{first:?} {second:?}");
                    assert_eq!(last_back, back);
                    before = back[0];
                }
            }
        }
    }
}

/// Noise, holes, and segments that end where others begin: every sum of optical depths, every end, and what every segment
/// sends, within half a code; in order everywhere.
#[test]
fn layers_of_many_pixels_come_back_within_half_a_code() {
    let size = ImageSize::new(70, 45);
    for (depth_bits, optical_depth_bits, color) in
        [(8, 6, ColorCoding::Exact), (5, 4, ColorCoding::Bounded { error: 3 }), (14, 14, ColorCoding::Exact)]
    {
        let format = VolumeFormat { layers: 3, depth_bits, optical_depth_bits, ..VolumeFormat::default() };
        let mut shape = shape(format, RANGE, size);
        shape.format.color_coding = color;
        let mut tree = shape.tree(Pose::IDENTITY);
        let mut state = 1_u32;
        let mut random = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 24) as f32
        };
        for pixel in 0..size.pixels() {
            let mut at = 2.1 + 0.3 * (pixel as f32 / 900.0).sin();
            for layer in &mut tree.bands_mut(45)[0].layers {
                let front = at + if random() < 0.3 { 0.4 * random() } else { 0.0 };
                at = front + 0.2 + 0.6 * random();
                let optical_depth = 3.0 * random() * random();
                let is_there = random() < 0.8;
                layer.set(pixel, is_there.then_some(&segment(front, at, optical_depth, random())));
            }
        }
        let was = tree.layers.clone();
        let is = coded(&shape, &mut tree);
        let scale = DepthScale::new(RANGE, depth_bits);
        // A unit to round to units, and one to have a length.
        let most_units = units_of_code(depth_bits) / 2 + 2;
        // No source is above it by half a code of the optical depth.
        let white = 8.0;
        let codes_off = if let ColorCoding::Bounded { error } = color { 0.5 + f32::from(error) } else { 0.5 };
        for pixel in 0..size.pixels() {
            let (mut last_back, mut owed) = (0.0, 0.0);
            for (was, is) in was.iter().zip(&is.layers) {
                assert_eq!(was.at(pixel).is_some(), is.at(pixel).is_some());
                let (Some(was), Some(is)) = (was.at(pixel), is.at(pixel)) else { continue };
                for (was, is) in [(was.front_m, is.front_m), (was.back_m, is.back_m)] {
                    assert!(scale.units(was).abs_diff(scale.units(is)) <= most_units as u32, "{was} {is}");
                }
                assert!(last_back <= is.front_m && is.front_m < is.back_m);
                last_back = is.back_m;
                // Half a code of what it and those before it, as decoded, leave to it.
                let wanted = (was.optical_depth + owed).max(0.7 * was.optical_depth).clamp(THINNEST, THICKEST);
                let off = (is.optical_depth / wanted).ln().abs();
                assert!(off <= half_code_of_log(optical_depth_bits) + 1e-4, "{wanted} {is:?}");
                owed = (owed + was.optical_depth - is.optical_depth).clamp(-1.0, 1.0);
                // The root of the source that sends the same, over that of white, in 255 codes.
                let wanted = was.source.y * was.opacity() / is.opacity();
                let code = |source: f32| 255.0 * (source / white).min(1.0).sqrt();
                assert!((code(wanted) - code(is.source.y)).abs() <= codes_off + 0.01, "{was:?} {is:?}");
            }
        }
    }
}

proptest! {
    #[test]
    fn segments_come_back_within_half_a_step_of_each_code(
        starts in prop::collection::vec((0.01_f32..1.0, 0.05_f32..1.0, 1e-3_f32..5.0, 0.0_f32..2.0), 1..8)
    ) {
        let mut at = 2.0;
        let count = starts.len() as f32;
        let segments: Vec<_> = starts.iter().map(|&(gap, length, optical_depth, source)| {
            let front = at + gap * 1.5 / count;
            at = front + length * 2.0 / count;
            segment(front, at, optical_depth, source)
        }).collect();
        let format = VolumeFormat { depth_bits: 14, optical_depth_bits: 10, source: ColorFormat::Root10, ..VolumeFormat::default() };
        let scale = DepthScale::new(RANGE, 14);
        for (was, is) in segments.iter().zip(through_codec(format, RANGE, &segments)) {
            let is = is.unwrap();
            for (was, is) in [(was.front_m, is.front_m), (was.back_m, is.back_m)] {
                // Half a code, and a unit each to round to units and to have a length.
                let most = units_of_code(14) / 2 + 2;
                prop_assert!(scale.units(was).abs_diff(scale.units(is)) <= most as u32, "{} {}", was, is);
            }
            // The root of a source in 1023 steps up to a white of at most 2 times what another optical depth, of 1.1 %
            // steps, calls for.
            let sent = was.source.x * was.opacity();
            let error = (is.source.x * is.opacity() - sent).abs();
            let white = 2.1_f32;
            let code = 2.0 * (white * was.source.x * 1.05).sqrt() / 2046.0 + white / 4e6;
            prop_assert!(error <= code * is.opacity() + 1e-6, "{} {}", error, sent);
        }
    }
}
