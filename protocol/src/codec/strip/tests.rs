//! Exact means here: what the decoder writes is, bit by bit, what quantising and dequantising each value by
//! itself gives. Prediction, packing and compression lose nothing; quantisation is tested with its format.

use super::*;
use crate::codec::samples::Packing;
use crate::codec::{Limits, PLANE_HEADER_BYTES, STRIP_HEADER_BYTES, curvature, depth};
use crate::curvature::{MAX_CURVATURE_PER_M, ShapeOperator};
use crate::frame::{
    ColorCoding, ColorFormat, DepthBound, DepthCoding, DepthFormat, FrameFormat, Interfaces, MAX_LAYERS, Plan, Tree,
    VolumeFormat, VolumeRange,
};
use crate::optics::Interface;
use crate::stability::bound;
use crate::{Camera, ImageSize, Pose};
use glam::Vec3;
use proptest::prelude::*;

/// xorshift64* (Vigna 2016), so that a tree is one number.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u32 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 32) as u32
    }

    fn below(&mut self, count: u32) -> u32 {
        ((u64::from(self.next()) * u64::from(count)) >> 32) as u32
    }

    fn unit(&mut self) -> f32 {
        self.next() as f32 / u32::MAX as f32
    }
}

const EXTREMES: [f32; 12] = [
    f32::NAN,
    f32::INFINITY,
    f32::NEG_INFINITY,
    -1.0,
    -0.0,
    0.0,
    1e-45,
    f32::MIN_POSITIVE,
    1e-6,
    1e8,
    f32::MAX,
    f32::MIN,
];

/// A tree of smooth surfaces, holes and infinities, one node in eight knowing nothing; with `extremes`, one value in eight is no reasonable one.
fn tree(shape: &FrameShape, seed: u64, extremes: bool) -> Tree {
    let mut random = Random(seed | 1);
    let mut tree = shape.tree(Pose::IDENTITY);
    let entries = shape.interfaces.0.len() as u32;
    for node in 0..tree.nodes.len() {
        let planes = &mut tree.nodes[node];
        let knows_nothing = node > 0 && random.below(8) == 0;
        let (slope, offset) = (random.unit() * 0.1, 0.1 + random.unit() * 20.0);
        for pixel in 0..planes.distance.len() {
            let mut value = |usual: f32| match random.below(16) {
                0 | 1 if extremes => EXTREMES[random.below(EXTREMES.len() as u32) as usize],
                _ => usual * (1.0 + 0.01 * random.unit()),
            };
            let radiance = Vec3::new(value(0.3), value(1.5), value(0.01));
            let distance = value(offset + slope * pixel as f32);
            let normal = Vec3::new(value(0.3), value(-0.5), value(0.8));
            let entries_of_shape = [value(-2.0), value(0.1), value(40.0)];
            planes.set_radiance(pixel, radiance);
            planes.distance[pixel] = match random.below(8) {
                0 if node > 0 => UNDEFINED,
                _ if knows_nothing => UNDEFINED,
                1 => f32::INFINITY,
                // Behind the eye is an extreme of its own: 0.0 is no distance but the mark of no distance.
                _ => distance,
            };
            if !planes.interface.is_empty() {
                let most = if extremes { 256 } else { entries + 1 };
                planes.interface[pixel] = random.below(most) as u8;
                planes.set_normal(pixel, if extremes { normal } else { normal.normalize() });
            }
            if planes.shape_at(pixel).is_some() {
                planes.set_shape(pixel, ShapeOperator::from_array(entries_of_shape));
            }
        }
    }
    for (index, layer) in tree.layers.iter_mut().enumerate() {
        for pixel in 0..layer.front.len() {
            let mut value = |usual: f32| match random.below(16) {
                0 | 1 if extremes => EXTREMES[random.below(EXTREMES.len() as u32) as usize],
                _ => usual * (1.0 + 0.01 * random.unit()),
            };
            (layer.front[pixel], layer.back[pixel]) = (value(index as f32), value(index as f32 + 0.9));
            for channel in &mut layer.source {
                channel[pixel] = value(0.7);
            }
            layer.optical_depth[pixel] = value(0.2);
            if random.below(4) == 0 {
                layer.optical_depth[pixel] = 0.0;
            }
        }
    }
    tree
}

fn plans() -> impl Strategy<Value = Plan> {
    prop::sample::select(vec![Plan::diffuse(), Plan::mirror(), Plan::water(), Plan::solid()])
}

fn formats() -> impl Strategy<Value = FrameFormat> {
    let color = prop::sample::select(ColorFormat::ALL.to_vec());
    let depth = prop::sample::select(vec![DepthCoding::Relative, DepthCoding::Unfolded]);
    let shape_bits = prop_oneof![Just(0), FrameFormat::SHAPE_BITS];
    let widths = (FrameFormat::DEPTH_BITS, FrameFormat::DEPTH_BITS, FrameFormat::NORMAL_BITS, shape_bits);
    (color, widths, depth, volume_formats()).prop_map(
        |(color, (root_bits, child_bits, normal_bits, shape_bits), child_depth, volume)| FrameFormat {
            color,
            color_coding: ColorCoding::Exact,
            depth: DepthFormat::Codes { root_bits, child_bits },
            child_depth,
            normal_bits,
            shape_bits,
            volume,
        },
    )
}

fn volume_formats() -> impl Strategy<Value = VolumeFormat> {
    let source = prop::sample::select(ColorFormat::ALL.to_vec());
    let layers = prop_oneof![Just(0), 1..=MAX_LAYERS as u8];
    (layers, VolumeFormat::DEPTH_BITS, VolumeFormat::OPTICAL_DEPTH_BITS, source).prop_map(
        |(layers, depth_bits, optical_depth_bits, source)| VolumeFormat {
            layers,
            depth_bits,
            optical_depth_bits,
            source,
            ..VolumeFormat::NONE
        },
    )
}

/// The same, with bounds and without colour.
fn any_shapes() -> impl Strategy<Value = FrameShape> {
    let coding = prop_oneof![
        Just(ColorCoding::Exact),
        ColorCoding::ERRORS.prop_map(|error| ColorCoding::Bounded { error }),
        Just(ColorCoding::Video { quantiser: 30 }),
    ];
    let bound = (DepthBound::ERRORS_CENTI_PX, DepthBound::MOTIONS_MM, DepthBound::CHILD_FACTORS)
        .prop_map(|(error_centi_px, motion_mm, child_factor)| DepthBound { error_centi_px, motion_mm, child_factor });
    (shapes(), coding, prop::option::of(bound)).prop_map(|(mut shape, coding, bound)| {
        shape.format.color_coding = coding;
        shape.format.depth = bound.map_or(shape.format.depth, DepthFormat::Bounded);
        if !coding.is_valid(shape.format.color) {
            shape.format.color = ColorFormat::Root8;
        }
        if coding != ColorCoding::Exact {
            shape.format.volume.source = ColorFormat::Root8;
        }
        shape
    })
}

fn shapes() -> impl Strategy<Value = FrameShape> {
    let entry = prop::sample::select(vec![Interface::Mirror, Interface::Dielectric { eta: 1.5 }]);
    let sizes = prop_oneof![Just((1, 1)), Just((17, 1)), Just((1, 19)), (1..40_u32, 1..20_u32)];
    let exposure = prop::sample::select(vec![1.0_f32, 0.37, 8.0]);
    (sizes, plans(), prop::collection::vec(entry, 0..5), formats(), 1..9_u16, exposure).prop_map(
        |((width, height), plan, interfaces, format, strip_rows, exposure)| {
            let mut camera = Camera::symmetric(1.2, ImageSize::new(width, height));
            camera.fov.left *= 0.6;
            FrameShape {
                camera,
                plan,
                interfaces: Interfaces(interfaces),
                format,
                volume: VolumeRange { near_m: 0.0, far_m: 12.0 },
                strip_rows,
                exposure,
            }
        },
    )
}

fn encode(shape: &FrameShape, tree: &mut Tree) -> Vec<Vec<u8>> {
    let mut encoder = StripEncoder::default();
    let bands = tree.bands_mut(u32::from(shape.strip_rows));
    let strips = bands.iter().map(|rows| {
        let mut strip = Vec::new();
        let sizes = encoder.encode(shape, rows, &mut strip);
        assert_eq!(sizes.iter().map(|plane| plane.bytes).sum::<usize>(), strip.len() - STRIP_HEADER_BYTES);
        strip
    });
    strips.collect()
}

/// A tree of the shape whose every value is left over from something else.
fn dirty(shape: &FrameShape) -> Tree {
    let mut tree = shape.tree(Pose::IDENTITY);
    for planes in &mut tree.nodes {
        planes.distance.fill(-7.0);
        planes.interface.fill(99);
        let floats = planes.radiance.iter_mut().chain(&mut planes.normal).chain(&mut planes.shape);
        floats.for_each(|plane| plane.fill(f32::NAN));
    }
    for layer in &mut tree.layers {
        let planes = [&mut layer.front, &mut layer.back, &mut layer.optical_depth].into_iter().chain(&mut layer.source);
        planes.for_each(|plane| plane.fill(f32::NAN));
    }
    tree
}

fn decode<'a>(shape: &FrameShape, strips: impl IntoIterator<Item = &'a Vec<u8>>) -> Result<Tree, DecodeError> {
    let mut tree = dirty(shape);
    let mut bands = tree.bands_mut(u32::from(shape.strip_rows));
    let mut decoder = StripDecoder::default();
    for strip in strips {
        let rows = StripDecoder::rows(shape, strip)?;
        let band = &mut bands[rows.start as usize / usize::from(shape.strip_rows)];
        let sizes = decoder.decode(shape, strip, band)?;
        assert_eq!(sizes.iter().map(|plane| plane.bytes).sum::<usize>(), strip.len() - STRIP_HEADER_BYTES);
    }
    drop(bands);
    Ok(tree)
}

/// The plain form: each value quantised and dequantised by itself, and nothing packed.
fn quantised(shape: &FrameShape, tree: &Tree) -> Tree {
    let mut original = tree.clone();
    let mut result = dirty(shape);
    let table = &shape.interfaces;
    let rows_per_strip = u32::from(shape.strip_rows);
    let mut compander = curvature::Compander::default();
    compander.prepare(shape.format.shape_bits.max(6));
    for (rows, out) in original.bands_mut(rows_per_strip).iter().zip(&mut result.bands_mut(rows_per_strip)) {
        let first = rows.rows.start as usize * shape.camera.size.width as usize;
        let pixels = rows.nodes[0].distance.len();
        let ray_length = |pixel| shape.camera.ray_in_view(shape.camera.size.pixel_centre(first + pixel)).length();
        for node in 0..rows.nodes.len() {
            let bits = shape.depth_bits(node);
            let relative = node > 0 && shape.format.child_depth == DepthCoding::Relative;
            let (own, parent) = (&rows.nodes[node], usize::from(shape.plan.nodes()[node].parent));
            let depth = |pixel: usize| match own.distance[pixel] {
                UNDEFINED if node == 0 => f32::INFINITY,
                UNDEFINED => UNDEFINED,
                alone if relative => alone,
                _ => path_distance(shape, rows, node, pixel) / ray_length(pixel),
            };
            let possible = (0..pixels).map(depth).filter(|depth| *depth > 0.0 && depth.is_finite());
            let near = possible.min_by(f32::total_cmp).unwrap_or(1.0);
            let white = radiance::white(shape, rows, node);
            let has_interface = |pixel: usize| {
                let known = own.interface.get(pixel).is_some_and(|&index| table.at(index).is_some());
                known && (node == 0 || own.distance[pixel] != UNDEFINED)
            };
            let shape_of = |pixel: usize| match has_interface(pixel) {
                true => curvature::received(&shape.format, own, pixel).to_array(),
                false => [0.0; 3],
            };
            let bend = (0..pixels).flat_map(shape_of).fold(0.0_f32, |most, entry| most.max(entry.abs()));
            for pixel in 0..pixels {
                let color = own.radiance.each_ref().map(|channel| channel[pixel]);
                let codes = shape.format.color.quantise_color(color, white);
                for (channel, code) in out.nodes[node].radiance.iter_mut().zip(codes) {
                    channel[pixel] = shape.format.color.dequantise(code, white);
                }
                let depth = depth(pixel);
                let coded = depth::dequantise(depth::quantise(depth, near, bits), near, bits);
                let defined = node == 0 || own.distance[pixel] != UNDEFINED;
                out.nodes[node].distance[pixel] = match node {
                    _ if !defined => UNDEFINED,
                    _ if relative => coded,
                    0 => (coded * ray_length(pixel)).max(f32::MIN_POSITIVE),
                    _ => {
                        let before = path_distance(shape, out, parent, pixel);
                        let difference = coded * ray_length(pixel) - before;
                        let difference = if difference.is_nan() { f32::INFINITY } else { difference };
                        difference.max(before * 1e-6).max(f32::MIN_POSITIVE)
                    }
                };
                for (entries, entry) in out.nodes[node].shape.iter_mut().zip(shape_of(pixel)) {
                    if shape.has_shape_operators(node) {
                        entries[pixel] = compander.dequantise(compander.quantise(entry, bend), bend);
                    }
                }
                if !own.interface.is_empty() {
                    let known = table.at(own.interface[pixel]).is_some() && defined;
                    let normal = [0, 1, 2].map(|axis: usize| own.normal[axis][pixel]);
                    let bits = shape.format.normal_bits;
                    let normal = normal::dequantise(normal::quantise(Vec3::from_array(normal), bits), bits);
                    out.nodes[node].interface[pixel] = if known { own.interface[pixel] } else { 0 };
                    for (axis, value) in normal.to_array().into_iter().enumerate() {
                        out.nodes[node].normal[axis][pixel] = value;
                    }
                }
            }
        }
    }
    result
}

fn path_distance(shape: &FrameShape, rows: &TreeRows<'_>, node: usize, pixel: usize) -> f32 {
    let mut sum = rows.nodes[node].distance[pixel];
    let mut at = node;
    while at != 0 {
        at = usize::from(shape.plan.nodes()[at].parent);
        sum += rows.nodes[at].distance[pixel].max(0.0);
    }
    sum
}

fn assert_equal_where_defined(found: &Tree, expected: &Tree) {
    for (node, (found, expected)) in found.nodes.iter().zip(&expected.nodes).enumerate() {
        for pixel in 0..expected.distance.len() {
            let at = format!("node {node}, pixel {pixel}");
            assert_eq!(found.distance[pixel].to_bits(), expected.distance[pixel].to_bits(), "distance, {at}");
            if expected.distance[pixel] == UNDEFINED {
                continue;
            }
            assert_eq!(found.radiance_at(pixel), expected.radiance_at(pixel), "radiance, {at}");
            if !expected.interface.is_empty() {
                assert_eq!(found.interface[pixel], expected.interface[pixel], "interface, {at}");
                if expected.interface[pixel] != 0 {
                    assert_eq!(found.normal_at(pixel), expected.normal_at(pixel), "normal, {at}");
                    assert_eq!(found.shape_at(pixel), expected.shape_at(pixel), "shape, {at}");
                }
            }
        }
    }
}

/// Of a video the strips leave colour as it was, which was no number.
fn forget_color(shape: &FrameShape, tree: &mut Tree) {
    if let ColorCoding::Video { .. } = shape.format.color_coding {
        let color = tree.nodes.iter_mut().flat_map(|node| &mut node.radiance);
        for plane in color.chain(tree.layers.iter_mut().flat_map(|layer| &mut layer.source)) {
            assert!(plane.iter().all(|value| value.is_nan()));
            plane.fill(0.0);
        }
    }
}

/// Nothing undefined leaves the decoder.
fn assert_valid(tree: &Tree) {
    for (node, planes) in tree.nodes.iter().enumerate() {
        for pixel in 0..planes.distance.len() {
            let radiance = planes.radiance_at(pixel);
            assert!(radiance.is_finite() && radiance.min_element() >= 0.0, "{radiance}");
            let distance = planes.distance[pixel];
            assert!(distance > 0.0 || (distance == UNDEFINED && node > 0), "{distance}");
            if !planes.interface.is_empty() {
                assert!(usize::from(planes.interface[pixel]) <= tree.interfaces.0.len());
                let length = planes.normal_at(pixel).length();
                assert!((length - 1.0).abs() < 1e-5, "{length}");
            }
            if let Some(shape) = planes.shape_at(pixel) {
                assert!(shape.to_array().iter().all(|entry| entry.is_finite()), "{shape:?}");
            }
        }
    }
    for pixel in 0..tree.layers.first().map_or(0, |layer| layer.front.len()) {
        let mut last_back = 0.0;
        for layer in &tree.layers {
            assert!(layer.optical_depth[pixel] >= 0.0 && layer.optical_depth[pixel] < 24.1);
            let Some(segment) = layer.at(pixel) else { continue };
            assert!(segment.front_m >= last_back && segment.back_m > segment.front_m, "{last_back} {segment:?}");
            assert!(segment.source.is_finite() && segment.source.min_element() >= 0.0, "{segment:?}");
            last_back = segment.back_m;
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, ..ProptestConfig::default() })]

    #[test]
    fn planes_come_back_as_they_were_quantised(shape in shapes(), seed in any::<u64>(), extremes in any::<bool>()) {
        prop_assert_eq!(shape.check(&Limits::default()), Ok(()));
        let mut tree = tree(&shape, seed, extremes);
        let strips = encode(&shape, &mut tree);
        let back = decode(&shape, &strips).unwrap();
        assert_valid(&back);
        assert_equal_where_defined(&back, &quantised(&shape, &tree));
        for (was, is) in tree.nodes.iter().zip(&back.nodes).skip(1) {
            for (&was, &is) in was.distance.iter().zip(&is.distance) {
                prop_assert_eq!(was == UNDEFINED, is == UNDEFINED);
                prop_assert!(was != f32::INFINITY || is == f32::INFINITY);
            }
        }
        prop_assert!(tree.nodes[0].distance.iter().zip(&back.nodes[0].distance).all(|(was, is)| *was != f32::INFINITY || *is == f32::INFINITY));
    }

    /// Relative distances and the root's are codes and nothing else, so that a frame may be passed on for ever.
    #[test]
    fn a_decoded_frame_encodes_to_itself(shape in shapes(), seed in any::<u64>()) {
        let shape = FrameShape { format: FrameFormat { child_depth: DepthCoding::Relative, ..shape.format }, ..shape };
        let once = decode(&shape, &encode(&shape, &mut tree(&shape, seed, false))).unwrap();
        // The nearest pixel is the scale of the next coding: in metres it is exact only to half an ulp.
        let twice = decode(&shape, &encode(&shape, &mut once.clone())).unwrap();
        for (once, twice) in once.nodes.iter().zip(&twice.nodes) {
            for (a, b) in once.distance.iter().zip(&twice.distance) {
                prop_assert!(a == b || (a - b).abs() <= a * 3e-7, "{} {}", a, b);
            }
            prop_assert_eq!(&once.interface, &twice.interface);
        }
    }

    #[test]
    fn strips_stand_alone(shape in any_shapes(), seed in any::<u64>()) {
        let mut tree = tree(&shape, seed, false);
        let strips = encode(&shape, &mut tree);
        let decode = |strips: Vec<&Vec<u8>>| {
            let mut tree = decode(&shape, strips).unwrap();
            forget_color(&shape, &mut tree);
            assert_valid(&tree);
            tree
        };
        let forwards = decode(strips.iter().collect());
        let backwards = decode(strips.iter().rev().collect());
        let again = decode(strips.iter().chain(&strips).collect());
        prop_assert_eq!(&forwards, &backwards);
        prop_assert_eq!(&forwards, &again);
        // Nor does an encoder remember: each strip by an encoder of its own has the same bytes.
        for (rows, strip) in tree.bands_mut(u32::from(shape.strip_rows)).iter().zip(&strips) {
            let mut alone = Vec::new();
            StripEncoder::default().encode(&shape, rows, &mut alone);
            prop_assert_eq!(&alone, strip);
        }
    }

    #[test]
    fn what_an_undefined_pixel_holds_costs_nothing(shape in any_shapes(), seed in any::<u64>()) {
        let mut tree = tree(&shape, seed, false);
        let strips = encode(&shape, &mut tree);
        for planes in &mut tree.nodes[1..] {
            for pixel in 0..planes.distance.len() {
                if planes.distance[pixel] == UNDEFINED {
                    planes.set_radiance(pixel, Vec3::splat(1e3));
                    if !planes.interface.is_empty() {
                        planes.interface[pixel] ^= 1;
                        planes.set_normal(pixel, Vec3::NAN);
                    }
                    planes.shape.iter_mut().filter(|entry| !entry.is_empty()).for_each(|entry| entry[pixel] = 1e5);
                }
            }
        }
        // The white of a reflected node depends on its parent's interfaces, of which some were flipped.
        if shape.plan.nodes().len() == 2 {
            prop_assert_eq!(encode(&shape, &mut tree), strips);
        }
    }

    /// Behind the entropy coder, where flipped bits of a zstd frame do not reach.
    #[test]
    fn any_samples_are_refused_or_valid(shape in any_shapes(), seed in any::<u64>(), changes in 1..6_usize) {
        let mut random = Random(seed | 1);
        let mut strips = encode(&shape, &mut tree(&shape, seed, false));
        for strip in &mut strips {
            *strip = with_changed_samples(strip, &mut random, changes);
        }
        if let Ok(mut tree) = decode(&shape, &strips) {
            forget_color(&shape, &mut tree);
            assert_valid(&tree);
        }
    }

    #[test]
    fn any_bytes_are_refused_or_valid(shape in any_shapes(), seed in any::<u64>(), changes in 1..20_usize) {
        let mut random = Random(seed | 1);
        let mut strips = encode(&shape, &mut tree(&shape, seed, false));
        for strip in &mut strips {
            for _ in 0..changes {
                let at = random.below(strip.len() as u32) as usize;
                match random.below(4) {
                    0 => strip[at] = random.next() as u8,
                    1 => strip[at] ^= 1 << random.below(8),
                    2 => strip.insert(at, random.next() as u8),
                    _ if strip.len() > 1 => drop(strip.remove(at)),
                    _ => {}
                }
            }
        }
        if let Ok(mut tree) = decode(&shape, &strips) {
            forget_color(&shape, &mut tree);
            assert_valid(&tree);
        }
    }
}

/// Takes the planes of a strip apart, changes some bytes of their samples, and compresses them again.
fn with_changed_samples(strip: &[u8], random: &mut Random, changes: usize) -> Vec<u8> {
    let mut out = strip[..STRIP_HEADER_BYTES].to_vec();
    let mut rest = &strip[STRIP_HEADER_BYTES..];
    while let Some((header, behind)) = rest.split_first_chunk::<PLANE_HEADER_BYTES>() {
        let (payload, behind) = behind.split_at(u32::from_le_bytes(header[6..].try_into().unwrap()) as usize);
        if payload.is_empty() {
            out.extend_from_slice(header);
            rest = behind;
            continue;
        }
        // From coarse to fine there is no zstd to get behind.
        let unpacked = zstd::bulk::decompress(payload, 1 << 20);
        let is_zstd = unpacked.is_ok();
        let mut samples = unpacked.unwrap_or_else(|_| payload.to_vec());
        for _ in 0..changes.min(samples.len()) {
            let at = random.below(samples.len() as u32) as usize;
            samples[at] = random.next() as u8;
        }
        let mut header = *header;
        if header[1] == PlaneKind::Shape as u8 {
            let scale = random.unit() * MAX_CURVATURE_PER_M;
            header[2..6].copy_from_slice(&scale.to_le_bytes());
        }
        if header[1] == PlaneKind::Radiance as u8 || header[1] == PlaneKind::Depth as u8 {
            let scale = f32::from_bits(random.next()).abs();
            header[2..6].copy_from_slice(&scale.to_le_bytes());
        }
        let payload = if is_zstd { zstd::bulk::compress(&samples, 1).unwrap() } else { samples };
        header[6..].copy_from_slice(&(payload.len() as u32).to_le_bytes());
        out.extend_from_slice(&header);
        out.extend_from_slice(&payload);
        rest = behind;
    }
    out
}

mod bounds;

fn small_shape() -> FrameShape {
    FrameShape {
        camera: Camera::symmetric(1.0, ImageSize::new(9, 6)),
        plan: Plan::solid(),
        interfaces: Interfaces(vec![Interface::Mirror, Interface::Dielectric { eta: 1.5 }]),
        format: FrameFormat::exact(),
        volume: VolumeRange::default(),
        strip_rows: 4,
        exposure: 1.0,
    }
}

#[test]
fn stability_decoder_cut_and_flipped() {
    let mut taken = bound!("decoder", "strips cut at any byte, or too long, that are taken", 0.0);
    let volume = VolumeRange { near_m: 0.0, far_m: 12.0 };
    let layered = FrameFormat { volume: VolumeFormat::default(), ..FrameFormat::default() };
    let bounded = FrameShape { format: layered, volume, ..small_shape() };
    for shape in [small_shape(), bounded.clone()] {
        for strip in encode(&shape, &mut tree(&shape, 5, false)) {
            for end in 0..strip.len() {
                taken.count(decode(&shape, [&strip[..end].to_vec()]).is_ok(), format!("{end} of {}", strip.len()));
            }
            let mut longer = strip.clone();
            longer.push(0);
            taken.count(decode(&shape, [&longer]).is_ok(), "one byte more");
        }
    }
    let mut invalid = bound!("decoder", "strips with a flipped bit that end in panic or undefined planes", 0.0);
    let strips = encode(&bounded, &mut tree(&bounded, 5, false));
    for (index, bit) in (0..strips.len()).flat_map(|index| (0..strips[index].len() * 8).map(move |bit| (index, bit))) {
        let mut flipped = strips.clone();
        flipped[index][bit / 8] ^= 1 << (bit % 8);
        let outcome = std::panic::catch_unwind(|| {
            if let Ok(tree) = decode(&bounded, &flipped) {
                assert_valid(&tree);
            }
        });
        invalid.count(outcome.is_err(), bit);
    }
}

#[test]
fn any_flipped_bit_is_refused_or_valid() {
    let shape = small_shape();
    let mut strips = encode(&shape, &mut tree(&shape, 5, false));
    let mut refused = 0;
    for bit in 0..strips[1].len() * 8 {
        strips[1][bit / 8] ^= 1 << (bit % 8);
        match decode(&shape, &strips) {
            Ok(tree) => assert_valid(&tree),
            Err(error) => refused += usize::from(!error.to_string().is_empty()),
        }
        strips[1][bit / 8] ^= 1 << (bit % 8);
    }
    assert!(refused > strips[1].len(), "{refused}");
}

#[test]
fn stability_decoder_of_a_bomb() {
    let shape = small_shape();
    let strips = encode(&shape, &mut tree(&shape, 5, false));
    let bomb = zstd::bulk::compress(&vec![0; 64 << 20], 1).unwrap();
    assert!(bomb.len() < 32 << 10);
    let mut strip = strips[0][..STRIP_HEADER_BYTES + PLANE_HEADER_BYTES].to_vec();
    strip[STRIP_HEADER_BYTES + 6..].copy_from_slice(&(bomb.len() as u32).to_le_bytes());
    strip.extend_from_slice(&bomb);

    let mut decoder = StripDecoder::default();
    let mut tree = dirty(&shape);
    let error = decoder.decode(&shape, &strip, &mut tree.bands_mut(4)[0]).unwrap_err();
    assert!(error.to_string().contains("zstd frame"), "{error}");
    let mut memory = bound!("decoder", "bytes for a plane of 36 pixels, of a bomb of 64 MiB", 1000.0);
    memory.see(decoder.packed.capacity() as f64, "the bomb");

    // A length that is not there.
    strip[STRIP_HEADER_BYTES + 6..][..4].copy_from_slice(&u32::MAX.to_le_bytes());
    let error = decoder.decode(&shape, &strip, &mut tree.bands_mut(4)[0]).unwrap_err();
    assert_eq!(error, DecodeError::Truncated { field: "plane" });
}

#[test]
fn what_is_no_strip_of_the_frame_is_refused_by_name() {
    let shape = small_shape();
    let strips = encode(&shape, &mut tree(&shape, 5, false));
    let refused = |at: usize, value: u8| {
        let mut strip = strips[0].clone();
        strip[at] = value;
        decode(&shape, [&strip]).unwrap_err().to_string()
    };
    let plane = STRIP_HEADER_BYTES;
    assert!(refused(0, 1).contains("rows of strip"), "no strip starts in row 1");
    assert!(refused(0, 8).contains("rows of strip"), "beyond the frame");
    assert!(refused(2, 3).contains("rows of strip"), "too few");
    assert!(refused(2, 0).contains("rows of strip"), "none");
    assert!(refused(4, 2).contains("number of planes"));
    assert!(refused(plane, 1).contains("order of planes"), "node");
    assert!(refused(plane + 1, 3).contains("order of planes"), "kind");
    assert!(refused(plane + 1, 15).contains("kind of plane: 15"), "no kind");
    assert!(refused(plane + 5, 0x80).contains("scale of plane"), "negative white");

    let no_strips = FrameShape { strip_rows: 0, ..shape.clone() };
    assert!(StripDecoder::rows(&no_strips, &strips[0]).is_err());
    let mut other = Tree::new(Pose::IDENTITY, shape.camera, Plan::mirror(), shape.interfaces.clone());
    let mut decoder = StripDecoder::default();
    assert!(decoder.decode(&shape, &strips[0], &mut other.bands_mut(4)[0]).is_err());
}

#[test]
fn a_node_that_knows_nothing_is_only_a_mask() {
    let shape = small_shape();
    let mut tree = tree(&shape, 5, false);
    for node in 1..4 {
        tree.nodes[node].distance.fill(if node == 2 { UNDEFINED } else { 1.0 });
    }
    let strips = encode(&shape, &mut tree);
    for header in planes_of(&strips[0]) {
        let is_empty = header.node == 2 && header.kind != PlaneKind::Validity;
        assert_eq!(header.payload_bytes == 0, is_empty, "{header:?}");
    }
    let back = decode(&shape, &strips).unwrap();
    assert!(back.nodes[2].distance.iter().all(|&distance| distance == UNDEFINED));
    assert_valid(&back);
}

#[test]
fn a_frame_without_interfaces_shows_none_of_the_frame_before() {
    let shape = FrameShape { interfaces: Interfaces::default(), ..small_shape() };
    let back = decode(&shape, &encode(&shape, &mut tree(&shape, 5, false))).unwrap();
    assert!(back.nodes[0].interface.iter().all(|&interface| interface == 0));
    assert_valid(&back);
}

/// A glass ball: an exit surface of one curvature within a circle, nothing around it. And the same as a sheet of glass.
#[test]
fn shapes_of_balls_and_planes_cost_next_to_nothing() {
    const SIDE: u32 = 512;
    let shape =
        FrameShape { camera: Camera::symmetric(1.4, ImageSize::new(SIDE, SIDE)), strip_rows: 32, ..small_shape() };
    for (curvature, meant_bits) in [(-2.0, 0.02), (0.0, 0.015)] {
        let mut tree = shape.tree(Pose::IDENTITY);
        for pixel in 0..shape.camera.size.pixels() {
            let at = shape.camera.size.pixel_centre(pixel) / SIDE as f32 - 0.5;
            tree.nodes[0].distance[pixel] = 2.0;
            if at.length() < 0.4 {
                let slope = at.length() * 2.0;
                tree.nodes[2].distance[pixel] = 0.5;
                tree.nodes[2].interface[pixel] = 2;
                tree.nodes[2].set_normal(pixel, Vec3::new(-at.x, at.y, slope.mul_add(-slope, 1.0).sqrt()).normalize());
                tree.nodes[2].set_shape(pixel, ShapeOperator { s11: curvature, s12: 0.0, s22: curvature });
            } else {
                // Left over from something else: it must not be sent.
                tree.nodes[2].set_shape(pixel, ShapeOperator { s11: 1e9, s12: f32::NAN, s22: -3.0 });
            }
        }
        let mut encoder = StripEncoder::default();
        let (mut bytes, mut strips) = (0, Vec::new());
        for rows in tree.bands_mut(32) {
            let mut strip = Vec::new();
            let planes = encoder.encode(&shape, &rows, &mut strip);
            bytes +=
                planes.iter().filter(|plane| plane.kind == PlaneKind::Shape).map(|plane| plane.bytes).sum::<usize>();
            strips.push(strip);
        }
        let bits = bytes as f64 * 8.0 / f64::from(SIDE * SIDE);
        println!("curvature {curvature}: {bytes} bytes, {bits:.4} bits/pixel");
        assert!(bits < meant_bits, "curvature {curvature}: {bits}");
        let back = decode(&shape, &strips).unwrap();
        for pixel in (0..shape.camera.size.pixels()).filter(|&pixel| back.nodes[2].interface[pixel] > 0) {
            assert_eq!(back.nodes[2].shape_at(pixel), tree.nodes[2].shape_at(pixel));
        }
        // Without them the frame is the rest of its planes, to the byte.
        let format = FrameFormat { shape_bits: 0, ..shape.format };
        let without = encode(&FrameShape { format, ..shape.clone() }, &mut tree);
        let whole = |strips: &[Vec<u8>]| strips.iter().map(Vec::len).sum::<usize>();
        assert_eq!(whole(&without) + bytes, whole(&strips));
    }
}

/// Frames whose format has no shape operators are decoded into trees that have none, and the other way round.
#[test]
fn a_tree_with_planes_that_the_format_does_not_have_is_no_place_for_it() {
    let with = small_shape();
    let without = FrameShape { format: FrameFormat { shape_bits: 0, ..with.format }, ..with.clone() };
    for (of, other) in [(&with, &without), (&without, &with)] {
        let strips = encode(of, &mut tree(of, 5, false));
        let mut decoder = StripDecoder::default();
        assert!(decoder.decode(of, &strips[0], &mut other.tree(Pose::IDENTITY).bands_mut(4)[0]).is_err());
        let mut tree = other.tree(Pose::IDENTITY);
        of.fit(&mut tree, Pose::IDENTITY);
        assert!(decoder.decode(of, &strips[0], &mut tree.bands_mut(4)[0]).is_ok());
    }
}

/// An undefined child must not spend the codes of the others on the depth of its parent.
#[test]
fn the_nearest_depth_is_that_of_a_defined_pixel() {
    let shape = FrameShape { plan: Plan::mirror(), ..small_shape() };
    let mut tree = tree(&shape, 5, false);
    tree.nodes[0].distance.fill(0.5);
    tree.nodes[1].distance.fill(UNDEFINED);
    tree.nodes[1].distance[7] = 10.0;
    let strip = &encode(&shape, &mut tree)[0];
    let depth_header = planes_of(strip).into_iter().find(|header| header.node == 1 && header.kind == PlaneKind::Depth);
    assert!(depth_header.unwrap().scale > 8.0);
}

fn planes_of(strip: &[u8]) -> Vec<PlaneHeader> {
    let mut headers = Vec::new();
    let mut rest = &strip[STRIP_HEADER_BYTES..];
    while let Some((header, behind)) = rest.split_first_chunk() {
        headers.push(PlaneHeader::from_bytes(header).unwrap());
        rest = &behind[headers[headers.len() - 1].payload_bytes as usize..];
    }
    headers
}

#[test]
fn packing_room_holds_either_packing() {
    for bits in 1..=24 {
        for count in 1..50 {
            let residuals = vec![(1 << bits) - 1; count];
            for packing in [Packing::Runs, Packing::Bytes] {
                let bytes = samples::pack(&residuals, bits, packing, Vec::new());
                assert!(bytes.len() <= samples::max_packed_bytes(count, bits));
            }
        }
    }
}
