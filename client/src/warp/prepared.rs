//! A frame decoded: what of a tree does not depend on where the head will be, computed once when it arrives.
//!
//! Root: inverse depth, normal, boundary. Every child, for the frozen-distance step (see `chain`): the point it
//! shows, `W = O + s r`, and how that point moves from texel to texel while its distance s is held,
//! `J = dO/dx + s dr/dx`. O is the parent's point, r the unit direction that leaves the boundary there. Since s is not
//! differentiated, J stays smooth over depth edges of the reflected scene. Differences are central, one-sided at
//! the edges of a surface. A node that has children but is not the root gets the shape operator of its surface as
//! well (`shape`).
//!
//! Planes lie row by row, all planes of a row behind one another: what a tile needs is near, and rows are divided
//! among threads without further ado. A row's stride is not a power of two, or all planes would fall into the same
//! sets of the cache. Directions of J have 8 significant bits: an error of a step is 0.4 % of the step before it,
//! which the next one takes back, and a record is 24 bytes instead of 36.
//!
//! Cost: one pass per node; a band of 32 rows is computed with some rows on either side, as many as
//! differences reach.

mod normals;
mod records;
mod root;
mod scratch;
mod smooth;

use super::optic::Optics;
use super::specular::Solver;
use super::texture::{Texture, texel_of};
use crate::lanes::{Floats, Level, Texel, kernel};
use glam::Vec3;
use normals::FromDepth;
pub use normals::Normals;
use rayon::prelude::*;
use scratch::{Scratch, ScratchPool};
use warplight_protocol::frame::{FrameFormat, MAX_NODES, Node, Plan, Tree, UNDEFINED};
use warplight_protocol::{Camera, ImageSize, Pose};

/// Rows computed together: a multiple of the block's.
pub(super) const BAND: usize = 32;
/// Rows on either side that a band needs for differences: the widest are those of the shape operator.
const MAX_HALO: usize = 3;
/// Side of a block that is flagged as rough or smooth.
pub(super) const BLOCK: usize = 8;
/// Side of a cell whose nearest and farthest depth are splat.
pub(super) const CELL: usize = 4;
/// Distance, in metres, from which on a child counts as infinitely far: 5 cm aside move it by 5e-7 rad, and its
/// point still has digits.
pub(super) const FAR_M: f32 = 1e5;

/// Which plane is where.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Layout {
    /// Words from one plane of a row to the next, and texels from one node to the next.
    pub(super) stride: usize,
    /// Words from one row to the next.
    pub(super) pitch: usize,
    /// Texels from one row to the next.
    pub(super) texel_pitch: usize,
    /// First plane of each node that has children: boundary, normal (3), and but for the root shape (3).
    surface: [usize; MAX_NODES],
    /// First plane of each child: point (3), slopes (3).
    child: [usize; MAX_NODES],
}

impl Layout {
    fn new(plan: &Plan, width: usize) -> Layout {
        // A cache line more than a multiple of them.
        let stride = width.next_multiple_of(16) + 16;
        let mut layout = Layout { stride, texel_pitch: stride * plan.nodes().len(), ..Layout::default() };
        let mut planes = 1;
        for node in 0..plan.nodes().len() {
            if node > 0 {
                layout.child[node] = planes;
                planes += 6;
            }
            if plan.has_children(node) {
                layout.surface[node] = planes;
                planes += if node > 0 { 7 } else { 4 };
            }
        }
        layout.pitch = planes * stride;
        layout
    }
}

/// What is rough about a block of [`BLOCK`] x [`BLOCK`] texels: one bit per node, and [`BOUNDARY_ENDS`].
pub(super) type Roughness = u16;
/// A boundary of the root ends within the block.
pub(super) const BOUNDARY_ENDS: Roughness = 1 << 15;
const _: () = assert!(MAX_NODES <= 15);

/// How frames are decoded and searched.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rung {
    /// How children are searched.
    pub(super) solver: Solver,
    /// Where normals come from.
    pub(super) normals: Normals,
    /// Bits of a coordinate of the transmitted ones.
    pub(super) normal_bits: u8,
}

impl Default for Rung {
    fn default() -> Rung {
        let normal_bits = FrameFormat::default().normal_bits;
        Rung { solver: Solver::default(), normals: Normals::default(), normal_bits }
    }
}

/// A decoded frame.
#[derive(Debug)]
pub(super) struct Prepared {
    pub(super) pose: Pose,
    pub(super) camera: Camera,
    pub(super) nodes: [Node; MAX_NODES],
    pub(super) node_count: usize,
    pub(super) has_children: [bool; MAX_NODES],
    pub(super) layout: Layout,
    pub(super) optics: Optics,
    /// How children are searched.
    pub(super) solver: Solver,
    normals: Normals,
    normal_bits: u8,
    from_depth: FromDepth,
    planes: Vec<u32>,
    texels: Vec<Texel>,
    roughness: Vec<Roughness>,
    /// Largest and smallest inverse depth of each [`CELL`] x [`CELL`] texels.
    pub(super) cells: Vec<[f32; 2]>,
    pool: ScratchPool,
}

impl Default for Prepared {
    fn default() -> Prepared {
        let nodes = [Node { parent: 0, arrival: warplight_protocol::frame::Arrival::Direct }; MAX_NODES];
        Prepared {
            pose: Pose::IDENTITY,
            camera: Camera::symmetric(1.0, ImageSize::new(1, 1)),
            nodes,
            node_count: 1,
            has_children: [false; MAX_NODES],
            layout: Layout::default(),
            optics: Optics::default(),
            solver: Solver::default(),
            normals: Normals::default(),
            normal_bits: FrameFormat::default().normal_bits,
            from_depth: FromDepth::default(),
            planes: Vec::new(),
            texels: Vec::new(),
            roughness: Vec::new(),
            cells: Vec::new(),
            pool: ScratchPool::default(),
        }
    }
}

/// What a band is computed from.
struct Input<'a> {
    tree: &'a Tree,
    nodes: &'a [Node],
    has_children: &'a [bool],
    layout: Layout,
    optics: &'a Optics,
    from_depth: Option<&'a FromDepth>,
    /// How far a normal may be moved by the filter that takes the steps of its code away.
    normal_step: f32,
    /// Rows on either side of a band: the widest differences, those of shape operators, are seldom needed.
    halo: usize,
    width: usize,
    height: usize,
}

impl Input<'_> {
    /// Rows that are computed for a band.
    #[inline(always)]
    fn rows(&self) -> usize {
        BAND + 2 * self.halo
    }

    /// The row of the picture that a row of scratch stands for.
    #[inline(always)]
    fn image_row(&self, first: usize, row: usize) -> Option<usize> {
        (first + row).checked_sub(self.halo).filter(|&y| y < self.height)
    }

    /// An axis of the normals of a node, before the steps of their code are filtered away.
    #[inline(always)]
    fn normal(&self, node: usize, axis: usize, pixels: &std::ops::Range<usize>) -> &[f32] {
        let plane = match self.from_depth {
            Some(from_depth) => from_depth.axis(node, axis),
            None => &self.tree.nodes[node].normal[axis],
        };
        &plane[pixels.start..pixels.end]
    }
}

/// What is written of a band.
struct Band<'a> {
    first: usize,
    planes: &'a mut [u32],
    texels: &'a mut [Texel],
    roughness: &'a mut [Roughness],
    cells: &'a mut [[f32; 2]],
}

impl Prepared {
    /// Chooses how the next frame is decoded, and searched.
    pub(super) fn set(&mut self, rung: Rung) {
        Rung { solver: self.solver, normals: self.normals, normal_bits: self.normal_bits } = rung;
    }

    /// Decodes a tree.
    pub(super) fn prepare(&mut self, level: Level, tree: &Tree) {
        let (width, height) = (tree.camera.size.width as usize, tree.camera.size.height as usize);
        let plan = tree.plan.nodes();
        self.pose = tree.render_pose;
        self.camera = tree.camera;
        self.node_count = plan.len();
        for (index, node) in plan.iter().enumerate() {
            self.nodes[index] = *node;
            self.has_children[index] = plan.iter().skip(1).any(|child| usize::from(child.parent) == index);
        }
        self.layout = Layout::new(&tree.plan, width);
        self.optics.prepare(&tree.interfaces);
        let bands = height.div_ceil(BAND);
        let layout = self.layout;
        let (blocks, cells) = (width.div_ceil(BLOCK) * (BAND / BLOCK), width.div_ceil(CELL) * (BAND / CELL));
        self.planes.resize(bands * BAND * layout.pitch, 0);
        self.texels.resize(bands * BAND * layout.texel_pitch, [0; 4]);
        self.roughness.resize(bands * blocks, 0);
        self.cells.resize(bands * cells, [0.0; 2]);
        self.pool.fit(self.node_count, layout.stride);
        let is_from_depth = self.normals != Normals::Transmitted;
        if is_from_depth {
            let has_children = &self.has_children[..plan.len()];
            self.from_depth.compute(self.normals, tree, &self.nodes[..plan.len()], has_children, &self.optics);
        }
        let Prepared { planes, texels, roughness, cells: cell_depths, pool, .. } = self;
        let needs_differences = plan
            .iter()
            .enumerate()
            .skip(1)
            .any(|(node, _)| self.has_children[node] && tree.nodes[node].shape[0].is_empty());
        let input = Input {
            tree,
            nodes: &self.nodes[..plan.len()],
            has_children: &self.has_children[..plan.len()],
            layout,
            optics: &self.optics,
            from_depth: is_from_depth.then_some(&self.from_depth),
            normal_step: if is_from_depth { 0.0 } else { smooth::step(self.normal_bits) },
            halo: if needs_differences { records::SHAPE_REACH } else { 1 },
            width,
            height,
        };
        let rows = planes
            .par_chunks_mut(BAND * layout.pitch)
            .zip(texels.par_chunks_mut(BAND * layout.texel_pitch))
            .zip(roughness.par_chunks_mut(blocks).zip(cell_depths.par_chunks_mut(cells)));
        rows.enumerate().for_each(|(band, ((planes, texels), (roughness, cells)))| {
            let mut band = Band { first: band * BAND, planes, texels, roughness, cells };
            pool.with(|scratch| prepare_band(level, &input, &mut band, scratch));
        });
    }

    /// Width and height in texels.
    #[inline(always)]
    pub(super) fn size(&self) -> (usize, usize) {
        (self.camera.size.width as usize, self.camera.size.height as usize)
    }

    /// All words from this plane of the first row on.
    #[inline(always)]
    fn plane(&self, plane: usize) -> &[u32] {
        &self.planes[plane * self.layout.stride..]
    }

    /// The inverse depths of the root.
    #[inline(always)]
    pub(super) fn inverse_depth(&self) -> &[u32] {
        self.plane(0)
    }

    /// Boundary, normal.
    #[inline(always)]
    pub(super) fn surface(&self, node: usize) -> [&[u32]; 4] {
        std::array::from_fn(|index| self.plane(self.layout.surface[node] + index))
    }

    /// The shape operator of a node's surface; none of the root's.
    #[inline(always)]
    pub(super) fn shape(&self, node: usize) -> [&[u32]; 3] {
        std::array::from_fn(|index| self.plane(self.layout.surface[node] + 4 + index))
    }

    /// Point and slopes of a child.
    #[inline(always)]
    pub(super) fn record(&self, child: usize) -> [&[u32]; 6] {
        std::array::from_fn(|index| self.plane(self.layout.child[child] + index))
    }

    /// The radiance of a node.
    #[inline(always)]
    pub(super) fn texture(&self, node: usize) -> Texture<'_> {
        Texture { texels: &self.texels[node * self.layout.stride..], pitch: self.layout.texel_pitch }
    }

    /// What is rough within the box of these texels, which must be inside the picture.
    #[inline(always)]
    pub(super) fn roughness(&self, left: usize, right: usize, above: usize, below: usize) -> Roughness {
        let blocks = self.size().0.div_ceil(BLOCK);
        let mut rough = 0;
        for row in above / BLOCK..=below / BLOCK {
            for column in left / BLOCK..=right / BLOCK {
                rough |= self.roughness[row * blocks + column];
            }
        }
        rough
    }
}

#[inline(always)]
fn decode_band<F: Floats>(input: &Input<'_>, band: &mut Band<'_>, scratch: &mut Scratch) {
    pack_textures(input, band);
    band.roughness.fill(0);
    let has_boundaries = root::decode::<F>(input, band, scratch);
    let rows = BAND.min(input.height - band.first);
    for child in 1..input.nodes.len() {
        if has_boundaries {
            records::trace::<F>(input, band.first, child, scratch);
            records::write::<F>(input, band, child, scratch);
        } else {
            for row in 0..rows {
                let slopes = row * input.layout.pitch + (input.layout.child[child] + 3) * input.layout.stride;
                band.planes[slopes..slopes + 3 * input.layout.stride].fill(0);
            }
        }
        if input.has_children[child] {
            if has_boundaries {
                smooth::normals::<F>(input, band.first, child, scratch);
                records::write_surface::<F>(input, band, child, scratch);
            } else {
                clear_boundaries(input, band, child);
            }
        }
    }
}

kernel!(fn prepare_band = decode_band(input: &Input<'_>, band: &mut Band<'_>, scratch: &mut Scratch));

/// No boundary at any texel of a node.
fn clear_boundaries(input: &Input<'_>, band: &mut Band<'_>, node: usize) {
    for row in 0..BAND.min(input.height - band.first) {
        let at = row * input.layout.pitch + input.layout.surface[node] * input.layout.stride;
        band.planes[at..at + input.layout.stride].fill(0);
    }
}

#[inline(always)]
fn pack_textures(input: &Input<'_>, band: &mut Band<'_>) {
    let width = input.width;
    for (row, texels) in band.texels.chunks_mut(input.layout.texel_pitch).enumerate() {
        let y = band.first + row;
        if y >= input.height {
            break;
        }
        for (node, texels) in texels.chunks_mut(input.layout.stride).enumerate() {
            let planes = &input.tree.nodes[node];
            let pixels = y * width..(y + 1) * width;
            let [red, green, blue] = planes.radiance.each_ref().map(|channel| &channel[pixels.clone()]);
            let colors = red.iter().zip(green).zip(blue).zip(&planes.distance[pixels]);
            for (texel, (((&red, &green), &blue), &distance)) in texels.iter_mut().zip(colors) {
                *texel = texel_of(Vec3::new(red, green, blue), distance != UNDEFINED);
            }
        }
    }
}
