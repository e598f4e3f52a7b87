//! The picture of a tree from the very pose it was rendered for: the server's image, and what the modes
//! that paint reflections on show.
//!
//! Cost: one Fresnel term per specular pixel and node, one exponential per segment of a volume.
//! `L = L_D + F L_R + (1 - F) L_F`, recursively; `L' = S (1 - exp(-tau)) + exp(-tau) L` through a segment.

use super::{Arrival, Tree, UNDEFINED};
use crate::optics;
use glam::Vec3;
use std::ops::Range;

/// Composites the pixels `pixels` of `tree` into `radiance` (linear RGB, as long as the range).
pub fn flatten(tree: &Tree, pixels: Range<usize>, radiance: &mut [Vec3]) {
    for (pixel, out) in pixels.zip(radiance) {
        let ray = tree.camera.ray_in_view(tree.camera.size.pixel_centre(pixel)).normalize();
        *out = through_layers(tree, pixel, radiance_along(tree, 0, pixel, ray));
    }
}

/// What a surface looks like through the volume before it.
fn through_layers(tree: &Tree, pixel: usize, surface: Vec3) -> Vec3 {
    // From the back to the front: each segment covers what is behind it.
    tree.layers.iter().rev().filter_map(|layer| layer.at(pixel)).fold(surface, |behind, segment| {
        let opacity = segment.opacity();
        behind + opacity * (segment.source - behind)
    })
}

fn radiance_along(tree: &Tree, node: usize, pixel: usize, direction: Vec3) -> Vec3 {
    let planes = &tree.nodes[node];
    if planes.distance[pixel] == UNDEFINED {
        return Vec3::ZERO;
    }
    let mut radiance = planes.radiance_at(pixel);
    let interface = planes.interface.get(pixel).and_then(|&index| tree.interfaces.at(index));
    if let Some(interface) = interface {
        let normal = planes.normal_at(pixel);
        let cos_incident = -direction.dot(normal);
        if let Some(child) = tree.plan.child(node, Arrival::Reflected) {
            let weight = interface.reflectance(cos_incident);
            radiance += weight * radiance_along(tree, child, pixel, optics::reflect(direction, normal));
        }
        if let Some(child) = tree.plan.child(node, Arrival::Refracted)
            && let Some(refracted) = interface.refracted(direction, normal)
        {
            let weight = interface.transmittance(cos_incident);
            radiance += weight * radiance_along(tree, child, pixel, refracted);
        }
    }
    radiance
}
