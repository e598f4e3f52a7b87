//! What the fuzz targets share: frames made of arbitrary bytes, and what must hold of every decoded one.

use arbitrary::{Result, Unstructured};
use warplight_protocol::codec::{DecodeError, FrameShape, Limits, StripDecoder, StripEncoder};
use warplight_protocol::frame::{
    ColorCoding, ColorFormat, DepthBound, DepthCoding, DepthFormat, FrameFormat, Interfaces, MAX_LAYERS, Plan, Tree, UNDEFINED,
    VolumeFormat, VolumeRange,
};
use warplight_protocol::optics::Interface;
use warplight_protocol::camera::{FieldOfView, Projection};
use warplight_protocol::{Camera, ImageSize, Pose};

/// Limits that keep one run short.
pub const LIMITS: Limits =
    Limits { control_bytes: 4 << 10, strip_bytes: 64 << 10, frame_pixels: 4 << 10, frame_bytes: 512 << 10 };

/// A shape that [`FrameShape::check`] accepts.
pub fn shape(u: &mut Unstructured<'_>) -> Result<FrameShape> {
    let size = ImageSize::new(u.int_in_range(1..=40)?, u.int_in_range(1..=24)?);
    let mut camera = Camera::symmetric(1.3, size);
    camera.fov.left *= f32::from(u.int_in_range(0..=8_u8)?) / 4.0;
    if u.ratio(1, 8)? {
        // The smallest there is: 192 x 32 pixels would be beyond the limits above.
        camera = Camera::perspective(ImageSize::new(7, 42), FieldOfView { left: -1.2, right: 1.2, down: -1.2, up: 1.2 });
        camera.projection = Projection::Cube;
    }
    let plan = u.choose(&[Plan::diffuse(), Plan::mirror(), Plan::water(), Plan::solid()])?.clone();
    let kinds = [
        Interface::Mirror,
        Interface::Dielectric { eta: 1.5 },
        Interface::Pane { eta: 1.5 },
        Interface::Conductor { eta: [0.2, 0.9, 1.1], k: [3.9, 2.4, 2.2] },
    ];
    let entries = u.int_in_range(0..=4)?;
    let interfaces = (0..entries).map(|_| u.choose(&kinds).copied()).collect::<Result<_>>()?;
    let mut color = *u.choose(&ColorFormat::ALL)?;
    let color_coding = match u.int_in_range(0..=3)? {
        0 => ColorCoding::Bounded { error: u.int_in_range(ColorCoding::ERRORS)? },
        1 => ColorCoding::Video { quantiser: u.int_in_range(ColorCoding::QUANTISERS)? },
        _ => ColorCoding::Exact,
    };
    if !color_coding.is_valid(color) {
        color = ColorFormat::Root8;
    }
    let depth = if u.arbitrary()? {
        DepthFormat::Bounded(DepthBound {
            error_centi_px: u.int_in_range(DepthBound::ERRORS_CENTI_PX)?,
            motion_mm: u.int_in_range(DepthBound::MOTIONS_MM)?,
            child_factor: u.int_in_range(DepthBound::CHILD_FACTORS)?,
        })
    } else {
        DepthFormat::Codes {
            root_bits: u.int_in_range(FrameFormat::DEPTH_BITS)?,
            child_bits: u.int_in_range(FrameFormat::DEPTH_BITS)?,
        }
    };
    let format = FrameFormat {
        color,
        color_coding,
        depth,
        child_depth: *u.choose(&[DepthCoding::Relative, DepthCoding::Unfolded])?,
        normal_bits: u.int_in_range(FrameFormat::NORMAL_BITS)?,
        shape_bits: if u.arbitrary()? { u.int_in_range(FrameFormat::SHAPE_BITS)? } else { 0 },
        volume: VolumeFormat {
            layers: if camera.projection == Projection::Cube { 0 } else { u.int_in_range(0..=MAX_LAYERS as u8)? },
            depth_bits: u.int_in_range(VolumeFormat::DEPTH_BITS)?,
            optical_depth_bits: u.int_in_range(VolumeFormat::OPTICAL_DEPTH_BITS)?,
            source: if color_coding == ColorCoding::Exact { *u.choose(&ColorFormat::ALL)? } else { ColorFormat::Root8 },
            ..VolumeFormat::NONE
        },
    };
    let far_m = *u.choose(&[1.0, 1e-9, 1e9])?;
    let volume = VolumeRange { near_m: if u.arbitrary()? { 0.0 } else { 0.99 * far_m }, far_m };
    let strip_rows = u.int_in_range(1..=9)?;
    let exposure = *u.choose(&[1.0, 0.25, 3.0, 1e-12, 1e12])?;
    Ok(FrameShape { camera, plan, interfaces: Interfaces(interfaces), format, volume, strip_rows, exposure })
}

/// A tree of any floats there are, NaN and infinities too. Where the input ends, its numbers go on by
/// themselves, so that short inputs are whole frames.
pub fn tree(shape: &FrameShape, u: &mut Unstructured<'_>) -> Result<Tree> {
    let mut random = u.arbitrary::<u64>()? | 1;
    let mut next = move |u: &mut Unstructured<'_>| {
        if !u.is_empty() {
            return u.arbitrary();
        }
        // xorshift64 (Marsaglia 2003).
        random ^= random << 13;
        random ^= random >> 7;
        random ^= random << 17;
        Ok((random >> 56) as u8)
    };
    let mut tree = shape.tree(Pose::IDENTITY);
    for planes in &mut tree.nodes {
        let NodeFloats { floats } = NodeFloats::of(planes);
        for value in floats {
            *value = match next(u)? {
                0 => f32::from_le_bytes([next(u)?, next(u)?, next(u)?, next(u)?]),
                1 => f32::INFINITY,
                2 => f32::NAN,
                small => f32::from(small - 3) / 16.0,
            };
        }
        for value in &mut planes.interface {
            *value = next(u)? % 8;
        }
    }
    for value in tree.layers.iter_mut().flat_map(layer_floats) {
        *value = match next(u)? {
            0 => f32::from_le_bytes([next(u)?, next(u)?, next(u)?, next(u)?]),
            1 => f32::INFINITY,
            2 => f32::NAN,
            small => f32::from(small - 3) / 128.0,
        };
    }
    Ok(tree)
}

fn layer_floats(layer: &mut warplight_protocol::frame::LayerPlanes) -> impl Iterator<Item = &mut f32> {
    let depths = layer.front.iter_mut().chain(&mut layer.back).chain(&mut layer.optical_depth);
    depths.chain(layer.source.iter_mut().flatten())
}

struct NodeFloats<'a> {
    floats: Vec<&'a mut f32>,
}

impl NodeFloats<'_> {
    fn of(planes: &mut warplight_protocol::frame::NodePlanes) -> NodeFloats<'_> {
        let vectors = planes.radiance.iter_mut().chain(&mut planes.normal).chain(&mut planes.shape).flatten();
        NodeFloats { floats: vectors.chain(&mut planes.distance).collect() }
    }
}

/// The strips of a tree.
pub fn encode(shape: &FrameShape, tree: &mut Tree) -> Vec<Vec<u8>> {
    let mut encoder = StripEncoder::default();
    let one = |rows: &_| {
        let mut strip = Vec::new();
        encoder.encode(shape, rows, &mut strip);
        strip
    };
    tree.bands_mut(u32::from(shape.strip_rows)).iter().map(one).collect()
}

/// Decodes strips, in whichever order they come, into a tree full of leftovers.
pub fn decode<'a>(
    shape: &FrameShape,
    strips: impl IntoIterator<Item = &'a [u8]>,
) -> std::result::Result<Tree, DecodeError> {
    let mut tree = shape.tree(Pose::IDENTITY);
    for planes in &mut tree.nodes {
        planes.interface.fill(255);
        NodeFloats::of(planes).floats.into_iter().for_each(|value| *value = f32::NAN);
    }
    tree.layers.iter_mut().flat_map(layer_floats).for_each(|value| *value = f32::NAN);
    let mut decoder = StripDecoder::default();
    let mut bands = tree.bands_mut(u32::from(shape.strip_rows));
    let mut decoded = vec![false; bands.len()];
    for strip in strips {
        let band = StripDecoder::rows(shape, strip)?.start as usize / usize::from(shape.strip_rows);
        decoder.decode(shape, strip, &mut bands[band])?;
        decoded[band] = true;
    }
    // Strips of a video leave colour as it was: no number.
    let is_video = matches!(shape.format.color_coding, ColorCoding::Video { .. });
    for rows in bands.iter_mut().filter(|_| is_video) {
        let of_nodes = rows.nodes.iter_mut().flat_map(|node| &mut node.radiance);
        for plane in of_nodes.chain(rows.layers.iter_mut().flat_map(|layer| &mut layer.source)) {
            assert!(plane.iter().all(|value| value.is_nan()));
            plane.fill(0.0);
        }
    }
    for (rows, _) in bands.iter().zip(decoded).filter(|(_, decoded)| *decoded) {
        for (node, planes) in rows.nodes.iter().enumerate() {
            for channel in &planes.radiance {
                assert!(channel.iter().all(|value| value.is_finite() && *value >= 0.0), "radiance of node {node}");
            }
            let possible = |distance: f32| distance > 0.0 || (distance == UNDEFINED && node > 0);
            assert!(planes.distance.iter().all(|&distance| possible(distance)), "distance of node {node}");
            let entries = shape.interfaces.0.len();
            assert!(planes.interface.iter().all(|&index| usize::from(index) <= entries), "interface of node {node}");
            let [x, y, z] = &planes.normal;
            for ((x, y), z) in x.iter().zip(y.iter()).zip(z.iter()) {
                assert!((x * x + y * y + z * z - 1.0).abs() < 1e-4, "normal of node {node}");
            }
            assert!(planes.shape.iter().flat_map(|entry| entry.iter()).all(|entry| entry.is_finite()), "shape of node {node}");
        }
        for pixel in 0..rows.layers.first().map_or(0, |layer| layer.front.len()) {
            let mut last_back = 0.0;
            for layer in rows.layers.iter().filter(|layer| layer.optical_depth[pixel] != 0.0) {
                assert!(layer.optical_depth[pixel] > 0.0 && layer.optical_depth[pixel] < 24.1, "optical depth");
                assert!(layer.front[pixel] >= last_back && layer.back[pixel] > layer.front[pixel], "order of segments");
                assert!(layer.source.iter().all(|channel| channel[pixel].is_finite() && channel[pixel] >= 0.0), "source");
                last_back = layer.back[pixel];
            }
        }
    }
    drop(bands);
    Ok(tree)
}
