//! How much an error of a picture shows: what rate control spreads the bits of a frame by.
//!
//! A node is displayed times the Fresnel weights above it, a layer times its opacity and what the layers before it let
//! through. Errors add up by their squares, so a picture counts with the root of the mean square of its weights over the
//! pixels that it knows. Least squares of the displayed error for given bits (Shoham 1988: equal slopes) asks for
//! a quantiser step that is inversely proportional to the weight, and the steps of H.264 double with every 6 quantisers.
//!
//! Pixels are sampled, a few thousand of them. Cost: a tenth of a millisecond.

use warplight_protocol::codec::PlaneKind;
use warplight_protocol::frame::{Arrival, Tree, UNDEFINED};
use warplight_protocol::optics;

/// Quantisers that double the step.
const STEPS_PER_DOUBLING: f64 = 6.0;
/// Most quantisers that a picture is coarser than the most important: a reflection that is weak now may be strong from
/// where the head is next.
const MOST: f64 = 12.0;
/// Pixels that are looked at.
const SAMPLES: usize = 4096;

/// Sums of squared weights and pixels of every picture.
#[derive(Clone, Copy, Debug, Default)]
struct Sum {
    squares: f64,
    pixels: u32,
}

impl Sum {
    fn add(&mut self, weight: f64) {
        self.squares += weight * weight;
        self.pixels += 1;
    }
}

/// By how many quantisers each picture of a frame is coarser than one that is seen as it is.
pub(super) fn coarser(tree: &Tree, pictures: &[(u8, PlaneKind)]) -> Vec<u8> {
    let mut nodes = vec![Sum::default(); tree.nodes.len()];
    let mut layers = vec![Sum::default(); tree.layers.len()];
    let pixels = tree.camera.size.pixels();
    // Not a divisor of the width, so that columns are not met again and again.
    let stride = (pixels / SAMPLES).max(1) | 1;
    for pixel in (0..pixels).step_by(stride) {
        let ray = tree.camera.ray_in_view(tree.camera.size.pixel_centre(pixel)).normalize();
        let mut through = 1.0;
        for (layer, sum) in tree.layers.iter().zip(&mut layers) {
            if let Some(segment) = layer.at(pixel) {
                let opacity = f64::from(segment.opacity());
                sum.add(through * opacity);
                through *= 1.0 - opacity;
            }
        }
        gather(tree, 0, pixel, ray, through, &mut nodes);
    }
    let quantisers = |sum: &Sum| {
        if sum.pixels == 0 {
            // Nothing is known of what was not met.
            return 0;
        }
        let weight = (sum.squares / f64::from(sum.pixels)).sqrt();
        let steps = -STEPS_PER_DOUBLING * weight.log2();
        steps.round().clamp(0.0, MOST) as u8
    };
    let of = |&(index, kind): &(u8, PlaneKind)| {
        let sums = if kind.is_of_layer() { &layers } else { &nodes };
        sums.get(usize::from(index)).map_or(0, quantisers)
    };
    pictures.iter().map(of).collect()
}

/// Adds the weights of a pixel's node and of what is behind it.
fn gather(tree: &Tree, node: usize, pixel: usize, direction: glam::Vec3, weight: f64, sums: &mut [Sum]) {
    let planes = &tree.nodes[node];
    if node > 0 && planes.distance[pixel] == UNDEFINED {
        return;
    }
    sums[node].add(weight);
    let Some(interface) = planes.interface.get(pixel).and_then(|&index| tree.interfaces.at(index)) else { return };
    let normal = planes.normal_at(pixel);
    let cos_incident = -direction.dot(normal);
    if let Some(child) = tree.plan.child(node, Arrival::Reflected) {
        let own = f64::from(interface.reflectance(cos_incident).max_element());
        gather(tree, child, pixel, optics::reflect(direction, normal), weight * own, sums);
    }
    if let Some(child) = tree.plan.child(node, Arrival::Refracted)
        && let Some(refracted) = interface.refracted(direction, normal)
    {
        let own = f64::from(interface.transmittance(cos_incident).max_element());
        gather(tree, child, pixel, refracted, weight * own, sums);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use warplight_protocol::frame::{Interfaces, Plan};
    use warplight_protocol::optics::Interface;
    use warplight_protocol::{Camera, ImageSize, Pose};

    /// A pane of water that is looked at from straight above.
    fn water() -> Tree {
        let camera = Camera::symmetric(0.01, ImageSize::new(64, 64));
        let interfaces = Interfaces(vec![Interface::Dielectric { eta: 1.333 }]);
        let mut tree = Tree::new(Pose::IDENTITY, camera, Plan::water(), interfaces);
        for pixel in 0..camera.size.pixels() {
            tree.nodes[0].interface[pixel] = 1;
            tree.nodes[0].set_normal(pixel, Vec3::Z);
            tree.nodes.iter_mut().for_each(|planes| planes.distance[pixel] = 1.0);
        }
        tree
    }

    const NODES: [(u8, PlaneKind); 3] = [(0, PlaneKind::Radiance), (1, PlaneKind::Radiance), (2, PlaneKind::Radiance)];

    #[test]
    fn a_weak_reflection_may_be_as_coarse_as_it_is_weak() {
        // Fresnel at normal incidence: 2 % are reflected, so the whole allowance; 98 % are not.
        assert_eq!(coarser(&water(), &NODES), [0, MOST as u8, 0]);
        let mut mirror = water();
        mirror.interfaces = Interfaces(vec![Interface::Mirror]);
        mirror.nodes[2].distance.fill(UNDEFINED);
        assert_eq!(coarser(&mirror, &NODES), [0, 0, 0]);
    }

    #[test]
    fn a_layer_counts_by_its_opacity_and_what_is_before_it() {
        let mut tree = water();
        tree.set_layers(2);
        for layer in &mut tree.layers {
            layer.front.fill(0.1);
            layer.back.fill(0.2);
        }
        // Half opaque; a quarter of the light is left for the second to have all of, half of half.
        tree.layers[0].optical_depth.fill(2_f32.ln());
        tree.layers[1].optical_depth.fill(50.0);
        let layers = [(0, PlaneKind::Source), (1, PlaneKind::Source)];
        assert_eq!(coarser(&tree, &layers), [6, 6]);
        // And nothing reaches the surface behind.
        assert_eq!(coarser(&tree, &NODES)[0], MOST as u8);
    }
}
