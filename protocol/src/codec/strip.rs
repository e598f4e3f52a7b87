//! A strip: some rows of all planes of a frame, decodable alone.
//!
//! Each plane is quantised with a scale of its own strip (radiance: white; depth: the nearest point), so a
//! strip can leave before the rest of the frame is rendered. Planes follow the plan's pre-order and stand
//! in one fixed order, so the receiver knows what must come and refuses anything else.

use super::channels::{ChannelCoder, Extents};
use super::curvature::ShapePlane;
use super::depth::DepthPlane;
use super::layers::LayersPlane;
use super::plane::PlaneHeader;
use super::{DecodeError, FrameShape, PlaneBytes, PlaneKind};
use super::{bounded_depth, interface, normal, radiance, samples};
use crate::frame::{DepthFormat, LayerRows, NodeRows, TreeRows, UNDEFINED};
use std::ops::Range;

/// What stands before the planes: first row, rows, number of planes.
struct StripHeader {
    rows: Range<u32>,
    planes: usize,
}

/// Bytes before the planes of a strip.
pub const STRIP_HEADER_BYTES: usize = 5;

impl StripHeader {
    const BYTES: usize = STRIP_HEADER_BYTES;

    fn to_bytes(&self) -> [u8; Self::BYTES] {
        let [s0, s1] = (self.rows.start as u16).to_le_bytes();
        let [r0, r1] = (self.rows.len() as u16).to_le_bytes();
        [s0, s1, r0, r1, self.planes as u8]
    }

    fn from_bytes(bytes: &[u8; Self::BYTES]) -> StripHeader {
        let [s0, s1, r0, r1, planes] = *bytes;
        let start = u32::from(u16::from_le_bytes([s0, s1]));
        let rows = u32::from(u16::from_le_bytes([r0, r1]));
        StripHeader { rows: start..start + rows, planes: usize::from(planes) }
    }
}

/// Packs strips; keeps its buffers from one to the next.
pub struct StripEncoder {
    codes: [Vec<u32>; 3],
    residuals: Vec<u32>,
    packed: Vec<u8>,
    compressed: Vec<u8>,
    defined: Vec<bool>,
    has_interface: Vec<bool>,
    depth: DepthPlane,
    shape: ShapePlane,
    layers: LayersPlane,
    channels: ChannelCoder,
    samples: Vec<i32>,
    compressor: zstd::bulk::Compressor<'static>,
}

impl std::fmt::Debug for StripEncoder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("StripEncoder").finish_non_exhaustive()
    }
}

impl Default for StripEncoder {
    fn default() -> StripEncoder {
        StripEncoder::new(StripEncoder::DEFAULT_LEVEL)
    }
}

impl StripEncoder {
    /// The default zstd level: higher ones cost more time than a frame has.
    pub const DEFAULT_LEVEL: i32 = 1;

    /// An encoder at a zstd level.
    pub fn new(level: i32) -> StripEncoder {
        StripEncoder {
            codes: Default::default(),
            residuals: Vec::new(),
            packed: Vec::new(),
            compressed: Vec::new(),
            defined: Vec::new(),
            has_interface: Vec::new(),
            depth: DepthPlane::default(),
            shape: ShapePlane::default(),
            layers: LayersPlane::default(),
            channels: ChannelCoder::default(),
            samples: Vec::new(),
            // Fails only where no memory is left for the context.
            compressor: zstd::bulk::Compressor::new(level).unwrap_or_default(),
        }
    }

    /// Appends the strip of these rows to `out` and tells what each plane took. The rows are of a tree of the
    /// shape, and the shape is one that [`FrameShape::check`] accepts.
    pub fn encode(&mut self, shape: &FrameShape, rows: &TreeRows<'_>, out: &mut Vec<u8>) -> Vec<PlaneBytes> {
        let planes = shape.planes();
        out.extend_from_slice(&StripHeader { rows: rows.rows.clone(), planes: planes.len() }.to_bytes());
        self.depth.begin(&shape.camera, rows.rows.clone());
        let mut sizes = Vec::with_capacity(planes.len());
        if !rows.layers.is_empty() {
            self.layers.begin(rows.rows.len() * shape.camera.size.width as usize);
        }
        let mut current = None;
        for (node, kind, _) in planes {
            if kind.is_of_layer() {
                let start = out.len();
                self.encode_layer(shape, &rows.layers[usize::from(node)], node, kind, out);
                sizes.push(PlaneBytes { node, kind, bytes: out.len() - start });
                continue;
            }
            if current.replace(node) != Some(node) {
                self.find_defined(&rows.nodes[usize::from(node)]);
            }
            let start = out.len();
            if node > 0 && kind != PlaneKind::Validity && !self.defined.contains(&true) {
                out.extend_from_slice(&PlaneHeader::empty(node, kind).to_bytes());
            } else {
                self.encode_plane(shape, rows, node, kind, out);
            }
            sizes.push(PlaneBytes { node, kind, bytes: out.len() - start });
        }
        sizes
    }

    fn find_defined(&mut self, planes: &NodeRows<'_>) {
        self.defined.clear();
        self.defined.extend(planes.distance.iter().map(|&distance| distance != UNDEFINED));
    }

    fn encode_plane(&mut self, shape: &FrameShape, rows: &TreeRows<'_>, node: u8, kind: PlaneKind, out: &mut Vec<u8>) {
        let index = usize::from(node);
        let planes = &rows.nodes[index];
        let width = shape.camera.size.width as usize;

        // Quantise.
        let mut scale = 0.0;
        let mut defined = (index > 0).then_some(&self.defined[..]);
        match kind {
            PlaneKind::Validity => {
                self.codes[0].clear();
                self.codes[0].extend(self.defined.iter().map(|&defined| u32::from(defined)));
                defined = None;
            }
            PlaneKind::Radiance => {
                scale = radiance::white(shape, rows, index);
                radiance::quantise(shape.format.color, scale, planes, &mut self.codes);
            }
            PlaneKind::Depth => {
                if let DepthFormat::Bounded(bound) = shape.format.depth {
                    let (samples, known) = (&mut self.samples, &self.defined);
                    scale = self.depth.quantise_bounded(shape, bound, rows, index, known, samples);
                    let start = begin_plane(out);
                    self.channels.pyramid.encode(width, bounded_depth::ROUNDING, defined, samples, out);
                    return end_plane(node, kind, scale, start, out);
                }
                scale = self.depth.quantise(shape, rows, index, &self.defined, &mut self.codes[0]);
            }
            PlaneKind::Interface => {
                interface::quantise(planes.interface, shape.interfaces.0.len(), &mut self.codes[0]);
                // What the normals and shapes that follow are defined by.
                let pixels = self.codes[0].iter().zip(&self.defined);
                self.has_interface.clear();
                self.has_interface.extend(pixels.map(|(&code, &defined)| code != 0 && (defined || index == 0)));
            }
            PlaneKind::Normal => {
                normal::quantise_plane(shape.format.normal_bits, planes, &self.has_interface, &mut self.codes);
                defined = Some(&self.has_interface);
            }
            PlaneKind::Shape => {
                scale = self.shape.quantise(&shape.format, width, planes, &self.has_interface, &mut self.codes);
                defined = Some(self.shape.counts());
            }
            // Coded by themselves.
            PlaneKind::OpticalDepth | PlaneKind::Extent | PlaneKind::Source => return,
        }

        let (channels, bits) = shape.channels(index, kind);
        if let Some(coding) = shape.coarse_to_fine(kind) {
            let size = Extents { width, height: self.defined.len() / width, bits };
            let start = begin_plane(out);
            match coding {
                0 => self.channels.encode_exact(size, defined, &self.codes[..channels], out),
                error => self.channels.encode_color(size, error, defined, &self.codes[..channels], out),
            }
            return end_plane(node, kind, scale, start, out);
        }

        // Predict and pack.
        let mut packed = std::mem::take(&mut self.packed);
        packed.clear();
        if let Some((predictor, packing)) = kind.coding() {
            for codes in &mut self.codes[..channels] {
                samples::predict(codes, width, bits, predictor, defined, &mut self.residuals);
                packed = samples::pack(&self.residuals, bits, packing, packed);
            }
        }
        self.packed = packed;
        self.compress(node, kind, scale, out);
    }

    fn encode_layer(
        &mut self,
        shape: &FrameShape,
        planes: &LayerRows<'_>,
        layer: u8,
        kind: PlaneKind,
        out: &mut Vec<u8>,
    ) {
        if kind != PlaneKind::Source {
            let start = begin_plane(out);
            match kind {
                PlaneKind::Extent => self.layers.encode_extent(shape, layer, planes, &mut self.channels, out),
                _ => self.layers.encode_optical_depth(shape, planes, &mut self.channels, out),
            }
            return end_plane(layer, kind, 0.0, start, out);
        }
        let width = shape.camera.size.width as usize;
        let (_, bits) = shape.channels(usize::from(layer), kind);
        let (channels, defined, white) = self.layers.source_codes(shape, planes);
        let size = Extents { width, height: defined.len() / width, bits };
        if let Some(coding) = shape.coarse_to_fine(kind) {
            let start = begin_plane(out);
            match coding {
                0 => self.channels.encode_exact(size, Some(defined), channels, out),
                error => self.channels.encode_color(size, error, Some(defined), channels, out),
            }
            return end_plane(layer, kind, white, start, out);
        }
        let mut packed = std::mem::take(&mut self.packed);
        packed.clear();
        if let Some((predictor, packing)) = kind.coding() {
            for codes in channels {
                samples::predict(codes, width, bits, predictor, Some(defined), &mut self.residuals);
                packed = samples::pack(&self.residuals, bits, packing, packed);
            }
        }
        self.packed = packed;
        self.compress(layer, kind, white, out);
    }

    /// Appends the plane whose samples are packed, behind its header.
    fn compress(&mut self, node: u8, kind: PlaneKind, scale: f32, out: &mut Vec<u8>) {
        // The buffer has room for the worst case, so that this cannot fail.
        self.compressed.clear();
        self.compressed.reserve(zstd::zstd_safe::compress_bound(self.packed.len()));
        let written = self.compressor.compress_to_buffer(&self.packed, &mut self.compressed).unwrap_or(0);
        let header = PlaneHeader { node, kind, scale, payload_bytes: written as u32 };
        out.extend_from_slice(&header.to_bytes());
        out.extend_from_slice(&self.compressed);
    }
}

/// Leaves room for the header of a plane, and returns where it is.
fn begin_plane(out: &mut Vec<u8>) -> usize {
    out.extend_from_slice(&[0; PlaneHeader::BYTES]);
    out.len() - PlaneHeader::BYTES
}

/// Writes the header of the plane that started there.
fn end_plane(node: u8, kind: PlaneKind, scale: f32, start: usize, out: &mut [u8]) {
    let behind = start + PlaneHeader::BYTES;
    let header = PlaneHeader { node, kind, scale, payload_bytes: (out.len() - behind) as u32 };
    out[start..behind].copy_from_slice(&header.to_bytes());
}

/// Unpacks strips; keeps its buffers from one to the next.
#[derive(Default)]
pub struct StripDecoder {
    codes: [Vec<u32>; 3],
    packed: Vec<u8>,
    defined: Vec<bool>,
    has_interface: Vec<bool>,
    radiance: radiance::Dequantiser,
    depth: DepthPlane,
    shape: ShapePlane,
    layers: LayersPlane,
    channels: ChannelCoder,
    samples: Vec<i32>,
    decompressor: zstd::bulk::Decompressor<'static>,
}

impl std::fmt::Debug for StripDecoder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("StripDecoder").finish_non_exhaustive()
    }
}

impl StripDecoder {
    /// Which rows a strip holds, before it is decoded; refuses rows that are no strip of the shape.
    pub fn rows(shape: &FrameShape, strip: &[u8]) -> Result<Range<u32>, DecodeError> {
        let header = strip.first_chunk().ok_or(DecodeError::Truncated { field: "strip header" })?;
        let rows = StripHeader::from_bytes(header).rows;
        let index = rows.start / u32::from(shape.strip_rows.max(1));
        if rows.is_empty() || shape.rows_of(index as usize) != rows {
            return Err(DecodeError::Malformed { field: "rows of strip", expected: "a strip of the frame" });
        }
        Ok(rows)
    }

    /// Writes a strip into `rows`, which must be those of [`StripDecoder::rows`] in a tree of the shape. On an
    /// error what they hold is meaningless.
    ///
    /// Whatever the bytes: radiance is finite and not negative, distances are above zero or [`UNDEFINED`],
    /// normals have unit length, shape operators are finite, and interfaces are entries of the table or 0. Where a node
    /// knows nothing, its radiance, and where it has no interface, its normal and shape are what the predictor
    /// continued them with.
    pub fn decode(
        &mut self,
        shape: &FrameShape,
        strip: &[u8],
        rows: &mut TreeRows<'_>,
    ) -> Result<Vec<PlaneBytes>, DecodeError> {
        if StripDecoder::rows(shape, strip)? != rows.rows || !have_shape(rows, shape) {
            return Err(DecodeError::Malformed { field: "rows of strip", expected: "the rows asked for" });
        }
        let (header, mut rest) = strip.split_first_chunk().ok_or(DecodeError::Truncated { field: "strip header" })?;
        let planes = shape.planes();
        if StripHeader::from_bytes(header).planes != planes.len() {
            let expected = "as many as the plan calls for";
            return Err(DecodeError::Malformed { field: "number of planes", expected });
        }
        if shape.interfaces.0.is_empty() {
            clear_interfaces(rows);
        }
        self.depth.begin(&shape.camera, rows.rows.clone());
        self.layers.begin(rows.rows.len() * shape.camera.size.width as usize);
        let mut sizes = Vec::with_capacity(planes.len());
        for (node, kind, _) in planes {
            let (header, behind) = rest.split_first_chunk().ok_or(DecodeError::Truncated { field: "plane header" })?;
            let header = PlaneHeader::from_bytes(header)?;
            if header.node != node || header.kind != kind {
                let expected = "pre-order, each kind once";
                return Err(DecodeError::Malformed { field: "order of planes", expected });
            }
            let bytes = header.payload_bytes as usize;
            let (payload, behind) = behind.split_at_checked(bytes).ok_or(DecodeError::Truncated { field: "plane" })?;
            self.decode_plane(shape, rows, &header, payload)?;
            sizes.push(PlaneBytes { node, kind, bytes: PlaneHeader::BYTES + bytes });
            rest = behind;
        }
        if !rest.is_empty() {
            return Err(DecodeError::Malformed { field: "strip", expected: "nothing behind its planes" });
        }
        Ok(sizes)
    }

    fn decode_plane(
        &mut self,
        shape: &FrameShape,
        rows: &mut TreeRows<'_>,
        header: &PlaneHeader,
        payload: &[u8],
    ) -> Result<(), DecodeError> {
        let node = usize::from(header.node);
        let width = shape.camera.size.width as usize;
        let (channels, bits) = shape.channels(node, header.kind);

        // Undo the prediction.
        let size = Extents { width, height: rows.rows.len(), bits };
        if header.kind == PlaneKind::Validity {
            self.channels.decode_exact(size, None, payload, &mut self.codes[..1])?;
            self.defined.clear();
            self.defined.extend(self.codes[0].iter().map(|&code| code > 0));
            return Ok(());
        }
        if !header.kind.is_of_layer() && node > 0 && !self.defined.contains(&true) {
            return write_nothing(header, &mut rows.nodes[node]);
        }
        match header.kind {
            PlaneKind::OpticalDepth => {
                return self.layers.decode_optical_depth(shape, &mut rows.layers[node], &mut self.channels, payload);
            }
            PlaneKind::Extent => {
                let (planes, coder) = (&mut rows.layers[node], &mut self.channels);
                return self.layers.decode_extent(shape, header.node, planes, coder, payload);
            }
            _ => {}
        }
        let defined = (node > 0).then_some(&self.defined[..]);
        if header.kind == PlaneKind::Depth && matches!(shape.format.depth, DepthFormat::Bounded(_)) {
            let (samples, rounding) = (&mut self.samples, bounded_depth::ROUNDING);
            self.channels.pyramid.decode(width, size.height, rounding, defined, payload, samples)?;
            self.depth.dequantise_bounded(shape, rows, node, header.scale, defined, samples);
            return Ok(());
        }
        if let Some(coding) = shape.coarse_to_fine(header.kind) {
            let defined = match header.kind {
                PlaneKind::Source => Some(self.layers.defined()),
                PlaneKind::Normal => {
                    let interface = rows.nodes[node].interface.iter();
                    self.has_interface.clear();
                    self.has_interface.extend(interface.map(|&interface| interface > 0));
                    Some(&self.has_interface[..])
                }
                _ => defined,
            };
            let codes = &mut self.codes[..channels];
            match coding {
                0 => self.channels.decode_exact(size, defined, payload, codes)?,
                error => self.channels.decode_color(size, error, defined, payload, codes)?,
            }
        } else {
            self.decode_samples(size, channels, header.kind, payload)?;
        }

        // Undo the quantisation.
        if header.kind.is_of_layer() {
            let planes = &mut rows.layers[node];
            self.layers.dequantise_source(shape, header.scale, &self.codes, planes);
            return Ok(());
        }
        let defined = (node > 0).then_some(&self.defined[..]);
        let planes = &mut rows.nodes[node];
        match header.kind {
            PlaneKind::Validity => {}
            PlaneKind::Radiance => {
                self.radiance.dequantise(shape.format.color, header.scale, &self.codes, planes);
            }
            PlaneKind::Depth => {
                self.depth.dequantise(shape, rows, node, header.scale, defined, &self.codes[0]);
            }
            PlaneKind::Interface => {
                interface::dequantise(&self.codes[0], shape.interfaces.0.len(), defined, planes.interface)?;
            }
            PlaneKind::Normal => normal::dequantise_plane(shape.format.normal_bits, &self.codes, planes),
            PlaneKind::Shape => self.shape.dequantise(shape.format.shape_bits, header.scale, &self.codes, planes),
            PlaneKind::OpticalDepth | PlaneKind::Extent | PlaneKind::Source => {}
        }
        Ok(())
    }

    /// Residuals that a zstd frame holds, undone row by row.
    fn decode_samples(
        &mut self,
        size: Extents,
        channels: usize,
        kind: PlaneKind,
        payload: &[u8],
    ) -> Result<(), DecodeError> {
        let Extents { width, height, bits } = size;
        let pixels = width * height;
        let Some((predictor, packing)) = kind.coding() else { return Ok(()) };
        self.decompress(payload, channels * samples::max_packed_bytes(pixels, bits))?;
        let mut rest = &self.packed[..];
        for codes in &mut self.codes[..channels] {
            let expected = "a residual of the right width for every pixel";
            rest = samples::unpack(rest, pixels, bits, packing, codes)
                .ok_or(DecodeError::Malformed { field: "samples", expected })?;
        }
        if !rest.is_empty() {
            return Err(DecodeError::Malformed { field: "samples", expected: "nothing behind the last" });
        }
        let [first, second, third] = &mut self.codes;
        match channels {
            1 => samples::reconstruct([first], width, bits, predictor),
            2 => samples::reconstruct([first, second], width, bits, predictor),
            _ => samples::reconstruct([first, second, third], width, bits, predictor),
        }
        Ok(())
    }

    /// The room comes from the shape, never from the peer: a bomb ends there.
    fn decompress(&mut self, payload: &[u8], most_bytes: usize) -> Result<(), DecodeError> {
        self.packed.resize(most_bytes, 0);
        match self.decompressor.decompress_to_buffer(payload, &mut self.packed[..]) {
            Ok(bytes) => {
                self.packed.truncate(bytes);
                Ok(())
            }
            Err(_) => {
                let expected = "a zstd frame no longer than its samples";
                Err(DecodeError::Malformed { field: "plane", expected })
            }
        }
    }
}

/// Whether rows are of a tree of the shape, so that none of their slices is too short.
fn have_shape(rows: &TreeRows<'_>, shape: &FrameShape) -> bool {
    let pixels = rows.rows.len() * shape.camera.size.width as usize;
    let layers_fit = |layer: &LayerRows<'_>| {
        let [red, green, blue] = &layer.source;
        [&layer.front, &layer.back, &layer.optical_depth, red, green, blue].iter().all(|plane| plane.len() == pixels)
    };
    rows.nodes.len() == shape.plan.nodes().len()
        && rows.layers.len() == usize::from(shape.format.volume.layers)
        && rows.layers.iter().all(layers_fit)
        && rows.nodes.iter().enumerate().all(|(node, planes)| {
            let inner = if shape.plan.has_children(node) { pixels } else { 0 };
            planes.distance.len() == pixels
                && planes.radiance.iter().all(|channel| channel.len() == pixels)
                && planes.interface.len() == inner
                && planes.normal.iter().all(|axis| axis.len() == inner)
                && planes
                    .shape
                    .iter()
                    .all(|entry| entry.len() == if shape.has_shape_operators(node) { pixels } else { 0 })
        })
}

/// The plane of a node that knows no pixel of the strip.
fn write_nothing(header: &PlaneHeader, planes: &mut NodeRows<'_>) -> Result<(), DecodeError> {
    if *header != PlaneHeader::empty(header.node, header.kind) {
        let expected = "no payload where no pixel is valid";
        return Err(DecodeError::Malformed { field: "plane", expected });
    }
    match header.kind {
        PlaneKind::Validity => {}
        PlaneKind::Radiance => planes.radiance.iter_mut().for_each(|channel| channel.fill(0.0)),
        PlaneKind::Depth => planes.distance.fill(UNDEFINED),
        PlaneKind::Interface => planes.interface.fill(0),
        PlaneKind::Normal => clear_normal(planes),
        PlaneKind::Shape => clear_shape(planes),
        PlaneKind::OpticalDepth | PlaneKind::Extent | PlaneKind::Source => {}
    }
    Ok(())
}

/// A frame without a table of interfaces has no plane that would overwrite those of the frame before it.
fn clear_interfaces(rows: &mut TreeRows<'_>) {
    for planes in &mut rows.nodes {
        planes.interface.fill(0);
        clear_normal(planes);
        clear_shape(planes);
    }
}

fn clear_normal(planes: &mut NodeRows<'_>) {
    let [x, y, z] = &mut planes.normal;
    x.fill(0.0);
    y.fill(0.0);
    z.fill(1.0);
}

fn clear_shape(planes: &mut NodeRows<'_>) {
    planes.shape.iter_mut().for_each(|entry| entry.fill(0.0));
}

#[cfg(test)]
mod tests;
