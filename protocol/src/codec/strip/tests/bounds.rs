//! What frames within bounds promise, from the floats that go in to the floats that come out.

use super::*;
use crate::stability::bound;

/// Distances of a pixel from the eye along the path to a node, in f64.
fn path_m(shape: &FrameShape, tree: &Tree, node: usize, pixel: usize) -> f64 {
    let mut sum = f64::from(tree.nodes[node].distance[pixel]);
    let mut at = node;
    while at != 0 {
        at = usize::from(shape.plan.nodes()[at].parent);
        sum += f64::from(tree.nodes[at].distance[pixel]);
    }
    sum
}

/// Smooth, spiky, stepped, constant, sky, random.
fn distance(kind: usize, x: u32, y: u32, random: &mut Random) -> f32 {
    let smooth = 0.7 + 0.05 * x as f32 + 0.011 * y as f32;
    match kind {
        0 => smooth,
        1 if random.below(7) == 0 => 0.3 + random.unit(),
        1 => smooth,
        2 => 1.0 + 3.0 * (x / 7 % 3) as f32 + (y / 5 % 2) as f32,
        3 => 2.5,
        4 if y < 9 || random.below(30) == 0 => f32::INFINITY,
        4 => smooth,
        5 => 0.3 + 100.0 * random.unit().powi(3),
        _ => 1e4 * random.unit() + 0.3,
    }
}

/// A frame of one kind of depth within a bound.
#[derive(Clone, Copy, Debug)]
struct Case {
    kind: usize,
    bound: DepthBound,
    size: (u32, u32),
    strip_rows: u16,
    child_depth: DepthCoding,
    seed: u64,
}

/// The largest error of any depth of a frame, over what is promised.
fn most_of_the_promise(case: Case) -> f64 {
    let Case { kind, bound, size, strip_rows, child_depth, seed } = case;
    let mut shape = small_shape();
    shape.camera = Camera::symmetric(1.4, ImageSize::new(size.0, size.1));
    shape.camera.fov.left *= 0.8;
    shape.strip_rows = strip_rows;
    shape.format.depth = DepthFormat::Bounded(bound);
    shape.format.child_depth = child_depth;
    let mut random = Random(seed | 1);
    let mut tree = shape.tree(Pose::IDENTITY);
    for node in 0..tree.nodes.len() {
        for pixel in 0..shape.camera.size.pixels() {
            let (x, y) = (pixel as u32 % size.0, pixel as u32 / size.0);
            let known = node == 0 || (random.below(5) > 0 && (x / 9 + y / 6) % 4 > 0);
            tree.nodes[node].distance[pixel] = if known { distance(kind, x, y, &mut random) } else { UNDEFINED };
        }
    }
    // A node knows nothing where its parent does not.
    for pixel in 0..shape.camera.size.pixels() {
        if tree.nodes[2].distance[pixel] == UNDEFINED {
            tree.nodes[3].distance[pixel] = UNDEFINED;
        }
    }
    let back = decode(&shape, &encode(&shape, &mut tree)).unwrap();
    let focal_px = f64::from(shape.camera.focal_px().max_element());
    let mut most = 0.0_f64;
    for node in 0..tree.nodes.len() {
        let factor = if node == 0 { 1.0 } else { f64::from(bound.child_factor) };
        let promised_px = 0.01 * f64::from(bound.error_centi_px) * factor;
        for pixel in 0..shape.camera.size.pixels() {
            let (was, is) = (tree.nodes[node].distance[pixel], back.nodes[node].distance[pixel]);
            assert_eq!(was == UNDEFINED, is == UNDEFINED);
            if was == UNDEFINED {
                continue;
            }
            assert!(was != f32::INFINITY || is == f32::INFINITY);
            // Of a leg the promise is its own.
            let relative = node > 0 && child_depth == DepthCoding::Relative;
            let [was, is] = match relative {
                true => [f64::from(was), f64::from(is)],
                false => [&tree, &back].map(|tree| path_m(&shape, tree, node, pixel)),
            };
            let centre = shape.camera.size.pixel_centre(pixel);
            let length = f64::from(shape.camera.ray_in_view(centre).length());
            let error_px = focal_px * 0.001 * f64::from(bound.motion_mm) * (length / was - length / is).abs();
            most = most.max(error_px / promised_px);
        }
    }
    most
}

/// Warped by a head that moves as far as was said: smooth, spiky, stepped, constant, sky and random planes.
#[test]
fn stability_depth_code_within_a_bound() {
    let mut promise = bound!("depth code", "bounded: error on the display, of what is promised", 1.0);
    for (kind, child_depth) in (0..7).flat_map(|kind| [(kind, DepthCoding::Relative), (kind, DepthCoding::Unfolded)]) {
        for (error_centi_px, motion_mm, child_factor) in [(5, 400, 1), (25, 200, 2), (10, 10, 4), (200, 100, 1)] {
            for (seed, strip_rows) in [(1, 7), (2, 39)] {
                let bound = DepthBound { error_centi_px, motion_mm, child_factor };
                let case = Case { kind, bound, size: (61, 43), strip_rows, child_depth, seed };
                promise.see(most_of_the_promise(case), format!("{case:?}"));
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 150, ..ProptestConfig::default() })]

    #[test]
    fn no_depth_is_further_off_than_promised(
        kind in 0..7_usize,
        error_centi_px in 5..=200_u16,
        motion_mm in 10..=400_u16,
        child_factor in 1..=4_u8,
        size in (1..70_u32, 1..50_u32),
        strip_rows in 1..40_u16,
        child_depth in prop::sample::select(vec![DepthCoding::Relative, DepthCoding::Unfolded]),
        seed in any::<u64>(),
    ) {
        let bound = DepthBound { error_centi_px, motion_mm, child_factor };
        let most = most_of_the_promise(Case { kind, bound, size, strip_rows, child_depth, seed });
        prop_assert!(most <= 1.0, "{} times what is promised", most);
    }

    /// Every channel of every node, and of the source of every layer, by its code.
    #[test]
    fn no_colour_is_further_off_than_promised(shape in any_shapes(), error in ColorCoding::ERRORS, seed in any::<u64>()) {
        let mut shape = shape;
        shape.format.color_coding = ColorCoding::Bounded { error };
        shape.format.volume.source = ColorFormat::Root8;
        if !shape.format.color.has_even_steps() {
            shape.format.color = ColorFormat::Root10;
        }
        let exact = FrameFormat { color_coding: ColorCoding::Exact, ..shape.format };
        let exact = FrameShape { format: exact, ..shape.clone() };
        let mut tree = tree(&shape, seed, true);
        let coded = decode(&shape, &encode(&shape, &mut tree)).unwrap();
        let oracle = decode(&exact, &encode(&exact, &mut tree)).unwrap();
        let within = |color: ColorFormat, was: f32, is: f32, white: f32| {
            color.quantise(was, white).abs_diff(color.quantise(is, white)) <= u16::from(error)
        };
        let white = 1.0 / shape.exposure;
        for (node, (was, is)) in oracle.nodes.iter().zip(&coded.nodes).enumerate() {
            // The white of a reflection is that of its strip.
            let reflected = shape.plan.nodes()[node].arrival == crate::frame::Arrival::Reflected;
            for pixel in (0..was.distance.len()).filter(|&pixel| !reflected && was.distance[pixel] != UNDEFINED) {
                for (was, is) in was.radiance.iter().zip(&is.radiance) {
                    prop_assert!(within(shape.format.color, was[pixel], is[pixel], white));
                }
            }
        }
        for (was, is) in oracle.layers.iter().zip(&coded.layers) {
            prop_assert_eq!(&was.optical_depth, &is.optical_depth);
            prop_assert_eq!(&was.back, &is.back);
        }
    }
}

#[test]
fn strips_of_a_video_have_no_colour_and_leave_it_alone() {
    let mut shape = small_shape();
    shape.format.volume.layers = 2;
    shape.volume = VolumeRange { near_m: 0.0, far_m: 5.0 };
    let with = shape.planes();
    shape.format.color_coding = ColorCoding::Video { quantiser: 30 };
    let is_color = |kind| matches!(kind, PlaneKind::Radiance | PlaneKind::Source);
    assert_eq!(shape.planes(), with.into_iter().filter(|plane| !is_color(plane.1)).collect::<Vec<_>>());
    let mut decoded = decode(&shape, &encode(&shape, &mut tree(&shape, 5, false))).unwrap();
    forget_color(&shape, &mut decoded);
    assert_valid(&decoded);
}
