use super::*;
use crate::codec::{StripDecoder, StripEncoder};
use crate::frame::{FrameFormat, Interfaces, Plan, Tree, VolumeFormat, VolumeSegment};
use crate::{Camera, ImageSize, Pose};
use glam::Vec3;
use proptest::prelude::*;

const RANGE: VolumeRange = VolumeRange { near_m: 2.0, far_m: 6.0 };

fn shape(volume: VolumeFormat, range: VolumeRange, size: ImageSize) -> FrameShape {
    FrameShape {
        camera: Camera::symmetric(1.0, size),
        plan: Plan::diffuse(),
        interfaces: Interfaces::default(),
        format: FrameFormat { volume, ..FrameFormat::default() },
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

/// numerics: the depth code at near, at far, behind the eye, infinite and NaN.
#[test]
fn depths_come_back_within_half_a_step_and_codes_rise_with_them() {
    for (range, bits) in [(RANGE, 12), (VolumeRange { near_m: 0.0, far_m: 1000.0 }, 12), (RANGE, 16)] {
        let scale = DepthScale::new(range, bits);
        let largest = (1_u32 << bits) - 1;
        assert_eq!((scale.code(range.near_m), scale.code(range.far_m)), (0, largest));
        assert_eq!((scale.code(-1.0), scale.code(f32::NAN), scale.code(f32::INFINITY)), (0, 0, largest));
        for code in 0..=largest {
            assert_eq!(scale.code(scale.depth(code)), code);
        }
        for code in 1..=largest {
            assert!(scale.depth(code) > scale.depth(code - 1), "{range:?} {code}");
        }
    }
    // A display of 1000 px focal length, moved by 0.35 m, sees steps of less than 0.1 px.
    let scale = DepthScale::new(RANGE, 12);
    let worst = (1..4096).map(|code| 1.0 / scale.depth(code - 1) - 1.0 / scale.depth(code)).fold(0.0, f32::max);
    assert!(1000.0 * 0.35 * worst < 0.1, "{worst}");
}

#[test]
fn optical_depths_come_back_within_half_a_step_of_their_logarithm() {
    for bits in VolumeFormat::OPTICAL_DEPTH_BITS {
        let scale = OpticalDepthScale::new(bits);
        let half_step = 0.5 / scale.codes_per_log;
        for step in 0..=1000 {
            let optical_depth = THINNEST * (THICKEST / THINNEST).powf(step as f32 / 1000.0);
            let back = scale.optical_depth(scale.code(optical_depth));
            assert!((back / optical_depth).ln().abs() <= half_step + 1e-5, "{optical_depth} {back}");
        }
        assert_eq!(scale.code(1e-20), 1);
        assert_eq!(scale.code(f32::INFINITY), (1 << bits) - 1);
    }
}

/// What the background is seen through is off by the last segment's half step, not by the sum of all.
#[test]
fn the_error_of_an_optical_depth_is_made_up_for_by_the_next() {
    let format = VolumeFormat::default();
    let half_step = 0.5 / OpticalDepthScale::new(format.optical_depth_bits).codes_per_log;
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

/// numerics: layering that degenerates: segments without length, at the far end, out of order, without numbers.
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

#[test]
fn a_segment_that_ends_before_it_starts_is_refused() {
    let shape = shape(VolumeFormat { layers: 1, ..VolumeFormat::default() }, RANGE, ImageSize::new(1, 1));
    let mut plane = LayersPlane::default();
    plane.begin(1);
    let mut tree = shape.tree(Pose::IDENTITY);
    let layer = &mut tree.bands_mut(1)[0].layers[0];
    let mut write =
        |kind, first, second| plane.dequantise(&shape, kind, 1.0, &[vec![first], vec![second], vec![0]], layer);
    write(PlaneKind::OpticalDepth, 7, 0).unwrap();
    assert!(write(PlaneKind::Extent, 7, 7).is_err());
    assert!(write(PlaneKind::Extent, 7, 8).is_ok());
    // The next starts where the last has ended.
    assert!(write(PlaneKind::Extent, 1, 9).is_err());
    assert!(write(PlaneKind::Extent, 0, 9).is_ok());
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
                let step = scale.depth(scale.code(was) + 1) - scale.depth(scale.code(was));
                prop_assert!((was - is).abs() <= 0.55 * step, "{} {}", was, is);
            }
            // The root of a value in 1023 steps up to a white of at most 8; and half a step of the optical depth, which may
            // have been given the error of the one before.
            let sent = was.source.x * was.opacity();
            let error = (is.source.x * is.opacity() - sent).abs();
            let white = 8.0_f32;
            prop_assert!(error <= (2.0 * (white * was.source.x * 1.02).sqrt() / 2046.0 * white.sqrt() + white / 4e6) * is.opacity() + 1e-6, "{} {}", error, sent);
        }
    }
}
