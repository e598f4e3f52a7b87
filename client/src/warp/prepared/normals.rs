//! Where normals come from: the server, or differences of the frame's own depth.
//!
//! The first design sends no normals; they are crosses of differences of positions, filtered by a Gaussian of 7 x 7
//! texels (Lochmann, 3.2.3). That costs no bytes, but depth has steps, and waves and the rims of balls are blurred. A
//! bilateral filter (Tomasi 1998) keeps what differs by more than the steps explain. Both are rungs of the ladder: they
//! say what transmitted normals are worth. Inner nodes are treated like the root, with points from their parents' rays;
//! so the exit side of a solid suffers twice.
//!
//! Differences are central, one-sided at the edges of a surface: forward ones, as in the first design, are those of a
//! place half a texel away, which on curved surfaces is an error of its own. Where a texel has no neighbour at all its
//! normal faces the ray. Shading normals, of bump maps or of smoothed meshes, cannot be had from depth in any way.
//!
//! Cost: plain code, one pass for points, one for differences and two (Gaussian) or 49 taps (bilateral) for the filter,
//! over texels that have a boundary.

use crate::warp::optic::Optics;
use glam::Vec3;
use rayon::prelude::*;
use warplight_protocol::frame::{Arrival, Node, Tree};
use warplight_protocol::optics::{reflect, refract};

/// Where the normals of boundaries come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Normals {
    /// The server's, with the steps of their code filtered away.
    #[default]
    Transmitted,
    /// From depth, and a Gaussian of 7 x 7 texels.
    FromDepthGaussian,
    /// From depth, and a bilateral filter of 7 x 7 texels.
    FromDepthBilateral,
}

impl Normals {
    /// Every kind.
    pub const ALL: [Normals; 3] = [Normals::Transmitted, Normals::FromDepthGaussian, Normals::FromDepthBilateral];

    /// Name in reports and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Normals::Transmitted => "transmitted",
            Normals::FromDepthGaussian => "from-depth-gaussian",
            Normals::FromDepthBilateral => "from-depth-bilateral",
        }
    }
}

impl std::str::FromStr for Normals {
    type Err = String;
    fn from_str(text: &str) -> Result<Normals, String> {
        Normals::ALL.into_iter().find(|normals| normals.name() == text).ok_or_else(|| {
            let names = Normals::ALL.map(Normals::name).join(", ");
            format!("expected one of {names}, found '{text}'")
        })
    }
}

/// Neighbours at the root further apart than this, in parts of their distance, lie on different surfaces.
const EDGE: f32 = super::root::EDGE;
/// Half the width of the filters.
const REACH: usize = 3;
/// Binomial coefficients from the centre outwards: a Gaussian of 1.2 texels.
const TAPS: [f32; REACH + 1] = [20.0, 15.0, 6.0, 1.0];
/// Normals that differ by this much count for exp(-1/2): ten times what a step of 16-bit depth does at 1.5 m to a
/// difference over two texels, which is 0.2 degrees.
const RANGE_RAD: f32 = 0.035;

/// What is known of a node at every texel, in view of the render pose.
#[derive(Debug, Default)]
struct Surface {
    /// The point it shows; not a number where that is not known or has no boundary.
    point: Vec<Vec3>,
    direction: Vec<Vec3>,
    raw: Vec<Vec3>,
    normal: Vec<Vec3>,
    /// The same by axis.
    axes: [Vec<f32>; 3],
}

/// Normals of a tree from its depth; buffers are kept.
#[derive(Debug, Default)]
pub(super) struct FromDepth {
    surfaces: Vec<Surface>,
}

impl FromDepth {
    /// Computes the normals of all nodes that have children.
    pub(super) fn compute(&mut self, kind: Normals, tree: &Tree, nodes: &[Node], has: &[bool], optics: &Optics) {
        self.surfaces.resize_with(nodes.len(), Surface::default);
        for node in (0..nodes.len()).filter(|&node| has[node]) {
            let (before, after) = self.surfaces.split_at_mut(node);
            let own = &mut after[0];
            match node {
                0 => own.see(tree),
                _ => own.follow(tree, node, nodes[node], &before[usize::from(nodes[node].parent)], optics),
            }
            own.differentiate(tree, node);
            match kind {
                Normals::FromDepthBilateral => own.filter_bilaterally(tree.camera.size.width as usize),
                Normals::FromDepthGaussian | Normals::Transmitted => own.blur(tree.camera.size.width as usize),
            }
            for (axis, values) in own.axes.iter_mut().enumerate() {
                values.clear();
                // Where nothing is known the normal is unused, but it is one.
                let known = own.normal.iter().map(|&normal| if normal == Vec3::ZERO { Vec3::Z } else { normal });
                values.extend(known.map(|normal| normal[axis]));
            }
        }
    }

    /// An axis of the normals of a node.
    pub(super) fn axis(&self, node: usize, axis: usize) -> &[f32] {
        &self.surfaces[node].axes[axis]
    }
}

impl Surface {
    fn fit(&mut self, texels: usize) {
        for plane in [&mut self.point, &mut self.direction, &mut self.raw, &mut self.normal] {
            plane.resize(texels, Vec3::NAN);
        }
    }

    /// The points of the root.
    fn see(&mut self, tree: &Tree) {
        let size = tree.camera.size;
        self.fit(size.pixels());
        let (distance, interface) = (&tree.nodes[0].distance, &tree.nodes[0].interface);
        let to = self.point.par_iter_mut().zip(&mut self.direction).enumerate();
        to.for_each(|(texel, (point, direction))| {
            *point = Vec3::NAN;
            if interface[texel] != 0 {
                *direction = tree.camera.ray_in_view(size.pixel_centre(texel)).normalize();
                *point = known(*direction * distance[texel]);
            }
        });
    }

    /// The points of a node behind its parent's boundary.
    fn follow(&mut self, tree: &Tree, index: usize, node: Node, parent: &Surface, optics: &Optics) {
        self.fit(tree.camera.size.pixels());
        let boundary = &tree.nodes[usize::from(node.parent)].interface;
        let (distance, interface) = (&tree.nodes[index].distance, &tree.nodes[index].interface);
        let to = self.point.par_iter_mut().zip(&mut self.direction).enumerate();
        to.for_each(|(texel, (point, direction))| {
            *point = Vec3::NAN;
            if interface[texel] == 0 || parent.point[texel].is_nan() {
                return;
            }
            let (incident, normal) = (parent.direction[texel], parent.normal[texel]);
            let leaving = match node.arrival {
                Arrival::Refracted => refract(incident, normal, optics.eta_of(boundary[texel])),
                Arrival::Reflected | Arrival::Direct => Some(reflect(incident, normal)),
            };
            let Some(leaving) = leaving else { return };
            *direction = leaving;
            *point = known(parent.point[texel] + leaving * distance[texel]);
        });
    }

    /// Normals as crosses of differences, against the rays.
    fn differentiate(&mut self, tree: &Tree, node: usize) {
        let width = tree.camera.size.width as usize;
        let (root, interface) = (&tree.nodes[0].distance, &tree.nodes[node].interface);
        let Surface { point, direction, raw, .. } = self;
        let (point, direction) = (&*point, &*direction);
        let height = point.len() / width;
        let neighbour = |own: usize, other: Option<usize>| {
            let other = other?;
            let (near, far) = (root[own].min(root[other]), root[own].max(root[other]));
            let is_same = interface[own] == interface[other] && far - near < EDGE * far;
            (is_same && !point[other].is_nan()).then(|| point[other])
        };
        raw.par_chunks_mut(width).enumerate().for_each(|(y, raw)| {
            for (x, raw) in raw.iter_mut().enumerate() {
                let own = y * width + x;
                *raw = Vec3::ZERO;
                if point[own].is_nan() {
                    continue;
                }
                let difference = |before: Option<usize>, after: Option<usize>| {
                    neighbour(own, after).unwrap_or(point[own]) - neighbour(own, before).unwrap_or(point[own])
                };
                let along_x = difference((x > 0).then(|| own - 1), (x + 1 < width).then_some(own + 1));
                let along_y = difference((y > 0).then(|| own - width), (y + 1 < height).then_some(own + width));
                let across = along_x.cross(along_y).normalize_or(-direction[own]);
                *raw = if across.dot(direction[own]) > 0.0 { -across } else { across };
            }
        });
    }

    /// The Gaussian, along rows and then across them; what has no boundary has no weight.
    fn blur(&mut self, width: usize) {
        let Surface { raw, normal, .. } = self;
        let height = raw.len() / width;
        let along: &[Vec3] = raw;
        normal.par_chunks_mut(width).zip(along.par_chunks(width)).for_each(|(to, from)| {
            for (x, to) in to.iter_mut().enumerate() {
                let (left, right) = (x.saturating_sub(REACH), (x + REACH).min(width - 1));
                let taps = (left..=right).map(|at| from[at] * TAPS[at.abs_diff(x)]);
                *to = taps.fold(Vec3::ZERO, |sum, tap| sum + tap);
            }
        });
        // The raw normals are still needed to know where there are any: their length is 1 or 0.
        let along: &[Vec3] = normal;
        raw.par_chunks_mut(width).enumerate().for_each(|(y, to)| {
            let (above, below) = (y.saturating_sub(REACH), (y + REACH).min(height - 1));
            for (x, to) in to.iter_mut().enumerate().filter(|(_, own)| **own != Vec3::ZERO) {
                let taps = (above..=below).map(|at| along[at * width + x] * TAPS[at.abs_diff(y)]);
                *to = taps.fold(Vec3::ZERO, |sum, tap| sum + tap).normalize_or(*to);
            }
        });
        std::mem::swap(raw, normal);
    }

    /// The bilateral filter: weights of distance in the picture times weights of the difference of normals.
    fn filter_bilaterally(&mut self, width: usize) {
        let Surface { raw, normal, .. } = self;
        let height = raw.len() / width;
        let raw: &[Vec3] = raw;
        normal.par_chunks_mut(width).enumerate().for_each(|(y, to)| {
            let (above, below) = (y.saturating_sub(REACH), (y + REACH).min(height - 1));
            for (x, to) in to.iter_mut().enumerate() {
                let own = raw[y * width + x];
                *to = own;
                if own == Vec3::ZERO {
                    continue;
                }
                let (left, right) = (x.saturating_sub(REACH), (x + REACH).min(width - 1));
                let mut sum = Vec3::ZERO;
                for row in above..=below {
                    for column in left..=right {
                        let other = raw[row * width + column];
                        let range = (other - own).length_squared() * (-0.5 / (RANGE_RAD * RANGE_RAD));
                        sum += other * (TAPS[row.abs_diff(y)] * TAPS[column.abs_diff(x)] * range.exp());
                    }
                }
                *to = sum.normalize_or(own);
            }
        });
    }
}

fn known(point: Vec3) -> Vec3 {
    if point.is_finite() { point } else { Vec3::NAN }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stability::bound;
    use warplight_protocol::frame::{Interfaces, Plan};
    use warplight_protocol::optics::Interface;
    use warplight_protocol::{Camera, ImageSize, Pose};

    /// A mirror ball of half a metre, 1.5 m ahead, with exact depth: median error of its normals in degrees.
    fn error_deg(kind: Normals, size: ImageSize) -> f32 {
        let camera = Camera::symmetric(1.0, size);
        let mut tree = Tree::new(Pose::IDENTITY, camera, Plan::mirror(), Interfaces(vec![Interface::Mirror]));
        let mut expected = vec![None; camera.size.pixels()];
        for (pixel, expected) in expected.iter_mut().enumerate() {
            let (ray, centre) = (camera.ray_in_view(camera.size.pixel_centre(pixel)).normalize(), Vec3::Z * -1.5);
            let along = ray.dot(centre);
            let root = along * along - centre.length_squared() + 0.25;
            tree.nodes[0].distance[pixel] = if root > 0.0 { along - root.sqrt() } else { 4.0 };
            if root > 0.0 {
                tree.nodes[0].interface[pixel] = 1;
                *expected = Some((ray * (along - root.sqrt()) - centre) * 2.0);
            }
        }
        let (mut optics, mut from_depth) = (Optics::default(), FromDepth::default());
        optics.prepare(&tree.interfaces);
        from_depth.compute(kind, &tree, tree.plan.nodes(), &[true, false], &optics);
        let mut off = Vec::new();
        for (texel, expected) in expected.into_iter().enumerate() {
            let found = Vec3::from_array([0, 1, 2].map(|axis| from_depth.axis(0, axis)[texel]));
            assert!((found.length() - 1.0).abs() < 1e-5);
            off.extend(expected.map(|expected| found.cross(expected).length().asin().to_degrees()));
        }
        off.sort_by(f32::total_cmp);
        off[off.len() / 2]
    }

    /// Central differences and symmetric filters are off by the square of the texel; exact depth adds nothing that
    /// counts.
    #[test]
    fn normals_of_a_ball_come_out_of_its_depth_four_times_better_from_half_the_texel() {
        let sizes = [1, 2].map(|scale| ImageSize::new(160 * scale, 120 * scale));
        let [coarse, fine] = sizes.map(|size| error_deg(Normals::FromDepthGaussian, size));
        assert!(coarse < 0.2 && (3.5..4.5).contains(&(coarse / fine)), "{coarse} {fine}");
        // What bends by more than the range of the other filter is not blurred, so it is nearer on such large texels.
        let bilateral = sizes.map(|size| error_deg(Normals::FromDepthBilateral, size));
        assert!(bilateral[0] < 0.5 * coarse && bilateral[1] < fine, "{bilateral:?} {coarse} {fine}");
    }

    /// A mirror everywhere; distances without order, with edges, holes and infinities, flat and collinear.
    #[test]
    fn stability_normals_from_depth() {
        let mut length = bound!("normals from depth", "length of a normal off 1", 1e-5);
        let mut backwards =
            bound!("normals from depth", "normals that are undefined, or face away, before a filter", 0.0);
        let size = ImageSize::new(23, 17);
        let camera = Camera::symmetric(1.0, size);
        let extremes = [0.0, -1.0, f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e-30, 1e-45, 1e30, f32::MAX];
        for case in 0..60_usize {
            let mut tree = Tree::new(Pose::IDENTITY, camera, Plan::solid(), Interfaces(vec![Interface::Mirror]));
            for (node, pixel) in (0..3).flat_map(|node| (0..size.pixels()).map(move |pixel| (node, pixel))) {
                let (x, y) = (pixel % 23, pixel / 23);
                let noise = (pixel * 7919 + case * 104_729 + node * 31) % 97;
                let ray = camera.ray_in_view(size.pixel_centre(pixel));
                tree.nodes[node].distance[pixel] = match case % 6 {
                    // An edge of depth, along columns and along both.
                    0 => ray.length() * if x < 11 { 1.0 } else { 5.0 },
                    1 => ray.length() * if (x / 3 + y / 2) % 2 == 0 { 1.0 } else { 4.0 },
                    // Every other texel something that is none.
                    2 if noise % 2 == 0 => extremes[noise % extremes.len()],
                    // A plane seen edge on: neighbours in one line with the eye.
                    3 => 1e4_f32.powf(y as f32 / 17.0),
                    4 => extremes[case / 6 % extremes.len()],
                    5 => 0.1 + noise as f32,
                    _ => 2.0,
                };
                if node != 1 {
                    tree.nodes[node].interface[pixel] = u8::from(noise % 5 > 0 || case % 2 == 0);
                    tree.nodes[node].set_normal(pixel, Vec3::Z);
                }
            }
            for kind in [Normals::FromDepthGaussian, Normals::FromDepthBilateral] {
                let (mut optics, mut from_depth) = (Optics::default(), FromDepth::default());
                optics.prepare(&tree.interfaces);
                from_depth.compute(kind, &tree, tree.plan.nodes(), &[true, false, true, false], &optics);
                for (node, texel) in [0, 2].into_iter().flat_map(|node| (0..size.pixels()).map(move |t| (node, t))) {
                    let found = Vec3::from_array([0, 1, 2].map(|axis| from_depth.axis(node, axis)[texel]));
                    length.see((found.length() - 1.0).abs().into(), format!("case {case}, {kind:?}, texel {texel}"));
                    let Surface { point, direction, raw, .. } = &from_depth.surfaces[node];
                    // Of the Gaussian the raw ones are overwritten by the sums along rows.
                    let is_known = !point[texel].is_nan() && kind == Normals::FromDepthBilateral;
                    let faces_away = is_known && raw[texel].dot(direction[texel]) > 1e-6;
                    backwards.count(!found.is_finite() || faces_away, format!("case {case}, {kind:?}, texel {texel}"));
                }
            }
        }
    }

    #[test]
    fn kinds_of_normals_are_read_and_refused_in_words() {
        for kind in Normals::ALL {
            assert_eq!(kind.name().parse(), Ok(kind));
        }
        assert!("guessed".parse::<Normals>().unwrap_err().contains("expected one of transmitted"));
    }
}
