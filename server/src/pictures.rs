//! Pictures of a session's live frames: from planes of radiance to what the link takes.
//!
//! Two steps, because a frame that is never sent must never be encoded: the next picture would be predicted from one that
//! the client does not have.
//!
//! 1. When a frame is rendered, [`PictureSource`] makes [`RenderedPictures`] of its planes: codes, with what is unknown
//!    filled. The session keeps them with the frame, and drops them where another frame replaces it.
//! 2. When the frame has begun to be sent, which nothing takes back, [`PictureStream`] encodes them, all planes in
//!    parallel, while its strips are under way.
//!
//! The canvas is anchored at the pixels of the session's first frame: a frame with another guard band lies elsewhere in it,
//! and its picture where it was. It grows in steps of 64 pixels when a frame does not fit, and shrinks after
//! 30 pictures that had no need of it; either takes a key picture. Encoders live as long as the session: a new
//! session begins with key pictures.
//!
//! Cost: about 2 ms for each plane of 1024 x 1024 at the first step, 3 to 8 ms at the second.

mod weights;

use crate::service::render_pool;
use rayon::ThreadPool;
use rayon::prelude::*;
use warplight_protocol::Camera;
use warplight_protocol::codec::{FrameShape, PlaneKind};
use warplight_protocol::frame::{ColorCoding, FrameId, Tree, TreeRows};
use warplight_protocol::message::PictureMessage;
use warplight_protocol::video::{Canvas, Picture, PictureEncoder, PictureHead, Placement, VideoError, White, quantise};

/// Canvases grow and shrink by so many pixels: four steps of a guard band.
const STEP_PX: i64 = 64;
/// Pictures for which a canvas that is larger than needed is kept: some seconds, about as long as turns follow on turns.
const KEEP_PICTURES: u32 = 30;

/// The planes of one frame, ready to be encoded.
#[derive(Debug, Default)]
pub struct RenderedPictures {
    pixels: usize,
    planes: Vec<RenderedPicture>,
}

impl RenderedPictures {
    /// Pixels of the frame.
    pub fn pixels(&self) -> usize {
        self.pixels
    }
}

#[derive(Debug)]
struct RenderedPicture {
    node: u8,
    kind: PlaneKind,
    /// Quantisers that it is coarser than the most important picture.
    coarser: u8,
    white: f32,
    placement: Placement,
    picture: Picture,
}

/// Makes pictures of rendered frames.
#[derive(Debug, Default)]
pub struct PictureSource {
    place: Place,
    whites: Vec<White>,
}

impl PictureSource {
    /// The pictures of a rendered frame; none where its format has none. Runs on the pool that it is called on.
    pub fn render(&mut self, shape: &FrameShape, tree: &mut Tree) -> Option<RenderedPictures> {
        let kinds = shape.pictures();
        if kinds.is_empty() {
            return None;
        }
        let coarser = weights::coarser(tree, &kinds);
        self.whites.resize_with(kinds.len(), White::default);
        let placement = self.place.of(&shape.camera);
        let bands = tree.bands_mut(shape.camera.size.height);
        let rows = bands.first()?;
        let planes =
            kinds.into_par_iter().zip(coarser).zip(&mut self.whites).map(|(((node, kind), coarser), white)| {
                let white = white.next(shape, rows, node, kind);
                let mut picture = Picture::new(placement.canvas);
                draw(shape, rows, node, kind, white, &placement, &mut picture);
                RenderedPicture { node, kind, coarser, white, placement, picture }
            });
        Some(RenderedPictures { pixels: shape.camera.size.pixels(), planes: planes.collect() })
    }
}

fn draw(
    shape: &FrameShape,
    rows: &TreeRows<'_>,
    node: u8,
    kind: PlaneKind,
    white: f32,
    placement: &Placement,
    picture: &mut Picture,
) {
    let index = usize::from(node);
    let size = shape.camera.size;
    let (color, channels, known) = match kind {
        PlaneKind::Source => {
            let layer = &rows.layers[index];
            let channels = layer.source.each_ref().map(|channel| &channel[..]);
            (shape.format.volume.source, channels, Some(&layer.optical_depth[..]))
        }
        _ => {
            let planes = &rows.nodes[index];
            let channels = planes.radiance.each_ref().map(|channel| &channel[..]);
            (shape.format.color, channels, (index > 0).then_some(&planes.distance[..]))
        }
    };
    quantise(color, white, size, channels, known, placement, picture);
}

/// The canvas of a session and where it lies.
#[derive(Debug, Default)]
struct Place {
    /// The first frame's camera: pixels are counted from its first.
    anchor: Option<Camera>,
    /// Left, top, right and bottom of the canvas.
    sides: [i64; 4],
    unneeded: u32,
}

impl Place {
    /// Where a frame of this camera lies.
    fn of(&mut self, camera: &Camera) -> Placement {
        let size = camera.size;
        // Another grid of pixels begins anew.
        let anchor = *self.anchor.get_or_insert(*camera);
        let begin = begin_of(&anchor, camera).unwrap_or_else(|| {
            *self = Place { anchor: Some(*camera), ..Place::default() };
            [0; 2]
        });
        let end = [begin[0] + i64::from(size.width), begin[1] + i64::from(size.height)];
        let down = |px: i64| px.div_euclid(STEP_PX) * STEP_PX;
        let up = |px: i64| -(-px).div_euclid(STEP_PX) * STEP_PX;
        let needed = [down(begin[0]), down(begin[1]), up(end[0]), up(end[1])];
        let [left, top, right, bottom] = self.sides;
        let fits = left <= needed[0] && top <= needed[1] && right >= needed[2] && bottom >= needed[3];
        self.unneeded = if fits && self.sides != needed { self.unneeded + 1 } else { 0 };
        if !fits && right > left {
            // What it held so far it is likely to hold again.
            let [l, t, r, b] = needed;
            self.sides = [left.min(l), top.min(t), right.max(r), bottom.max(b)];
        } else if !fits || self.unneeded > KEEP_PICTURES {
            self.sides = needed;
            self.unneeded = 0;
        }
        // A canvas that is too large, or larger than a receiver accepts for this frame, gives way to a smaller one.
        for sides in [self.sides, needed] {
            self.sides = sides;
            if let Some(placement) = place_in(sides, begin).filter(|placement| placement.check(size).is_ok()) {
                return placement;
            }
        }
        self.sides = [0; 4];
        Placement { canvas: Canvas::around(size), x: 0, y: 0 }
    }
}

fn place_in([left, top, right, bottom]: [i64; 4], begin: [i64; 2]) -> Option<Placement> {
    let canvas = Canvas { width: u16::try_from(right - left).ok()?, height: u16::try_from(bottom - top).ok()? };
    let (x, y) = (u16::try_from(begin[0] - left).ok()?, u16::try_from(begin[1] - top).ok()?);
    Some(Placement { canvas, x, y })
}

/// First column and row of a frame's picture, in pixels of the anchor's; none where the two have different grids, or
/// lie an odd number apart, which halves of chroma do not.
fn begin_of(anchor: &Camera, camera: &Camera) -> Option<[i64; 2]> {
    if anchor.projection != camera.projection {
        return None;
    }
    if anchor == camera {
        return Some([0; 2]);
    }
    let offset = anchor.centre_px() - camera.centre_px();
    let whole = offset.round();
    let stretch = (camera.focal_px() / anchor.focal_px() - 1.0).abs().max_element();
    // A part of a pixel over the whole of a picture does not matter to prediction.
    let same = (offset - whole).abs().max_element() < 0.05 && stretch < 1e-4;
    let [x, y] = [whole.x as i64, whole.y as i64];
    (same && x % 2 == 0 && y % 2 == 0).then_some([x, y])
}

/// Rendered pictures of a frame that is being sent.
#[derive(Debug)]
pub struct EncodeJob {
    /// The frame.
    pub frame: FrameId,
    /// Quantiser of the picture that matters most, 0 to 51; others are coarser, as little as an error in them shows.
    pub quantiser: u8,
    /// What to encode.
    pub pictures: RenderedPictures,
}

/// Encodes the pictures of one session.
#[derive(Debug)]
pub struct PictureStream {
    threads: usize,
    /// From the first picture on.
    pool: Option<ThreadPool>,
    planes: Vec<PlaneStream>,
}

#[derive(Debug, Default)]
struct PlaneStream {
    encoder: PictureEncoder,
    /// The frame whose picture was encoded last.
    reference: Option<FrameId>,
}

impl PictureStream {
    /// A stream that begins with key pictures, with so many threads of its own, 0 for one per core: those that render are
    /// busy with the next frame.
    pub fn new(threads: usize) -> PictureStream {
        PictureStream { threads, pool: None, planes: Vec::new() }
    }

    /// Encodes the pictures of a frame, which from here on must be sent.
    pub fn encode(&mut self, job: &EncodeJob) -> Result<Vec<PictureMessage>, VideoError> {
        let PictureStream { threads, pool, planes } = self;
        if pool.is_none() {
            *pool = render_pool("encode", *threads).ok();
        }
        planes.resize_with(job.pictures.planes.len().max(planes.len()), PlaneStream::default);
        let encode = || {
            let rendered = job.pictures.planes.par_iter().zip(planes);
            rendered.map(|(rendered, plane)| plane.encode(job.frame, job.quantiser, rendered)).collect()
        };
        // Without threads of their own they have those of whoever calls.
        if let Some(pool) = pool { pool.install(encode) } else { encode() }
    }
}

impl PlaneStream {
    fn encode(
        &mut self,
        frame: FrameId,
        quantiser: u8,
        rendered: &RenderedPicture,
    ) -> Result<PictureMessage, VideoError> {
        let &RenderedPicture { node, kind, coarser, white, placement, ref picture } = rendered;
        let quantiser = (quantiser + coarser).min(*ColorCoding::QUANTISERS.end());
        let mut bytes = Vec::new();
        let is_key = self.encoder.encode(picture, quantiser, self.reference.is_none(), &mut bytes)?;
        let reference = self.reference.replace(frame).filter(|_| !is_key);
        Ok(PictureMessage { head: PictureHead { frame, node, kind, reference, placement, white }, bytes })
    }
}

#[cfg(test)]
mod tests;
