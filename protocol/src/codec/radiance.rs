//! Radiance planes: green, and the differences of red and blue to it modulo the width, which is reversible
//! and most of the gain of a colour transform.

use super::shape::FrameShape;
use crate::frame::{Arrival, ColorFormat, NodeRows, TreeRows, UNDEFINED};

/// The radiance of the largest code: what saturates the display, or more where the node is only seen through weak
/// reflections: as much as saturates it at a boundary that reflects least when it is met head-on.
pub(crate) fn white(shape: &FrameShape, rows: &TreeRows<'_>, node: usize) -> f32 {
    /// A dielectric reflects a quarter at 78 degrees; beyond this, colour steps of a mirror in the same strip
    /// would show.
    const MOST: f32 = 4.0;
    let display_white = 1.0 / shape.exposure;
    let place = shape.plan.nodes()[node];
    if place.arrival != Arrival::Reflected {
        return display_white;
    }
    // By pixel value; 0 is no boundary.
    let mut headroom = [1.0_f32; 256];
    for (headroom, interface) in headroom[1..].iter_mut().zip(&shape.interfaces.0) {
        *headroom = (1.0 / interface.reflectance(1.0).min_element()).clamp(1.0, MOST);
    }
    let planes = &rows.nodes[node];
    let parent = &rows.nodes[usize::from(place.parent)];
    let mut white = display_white;
    for (pixel, &interface) in parent.interface.iter().enumerate() {
        let most = headroom[usize::from(interface)] * display_white;
        if most > white && planes.distance[pixel] != UNDEFINED {
            let [red, green, blue] = &planes.radiance;
            // `max` drops NaN.
            white = white.max(red[pixel].max(green[pixel]).max(blue[pixel]).min(most));
        }
    }
    white
}

/// The codes of a radiance plane: green, red - green, blue - green.
pub(crate) fn quantise(color: ColorFormat, white: f32, planes: &NodeRows<'_>, codes: &mut [Vec<u32>; 3]) {
    let [red, green, blue] = &planes.radiance;
    let [first, second, third] = codes;
    if color == ColorFormat::Rgb9e5 {
        [&mut *first, &mut *second, &mut *third].into_iter().for_each(Vec::clear);
        for ((&red, &green), &blue) in red.iter().zip(green.iter()).zip(blue.iter()) {
            let [red, green, blue] = color.quantise_color([red, green, blue], white).map(u32::from);
            first.push(green);
            second.push(red);
            third.push(blue);
        }
        return subtract_green(color, codes);
    }
    for (plane, codes) in [(green, &mut *first), (red, &mut *second), (blue, &mut *third)] {
        // A loop of its own for each format, so that each has no branch.
        match color {
            ColorFormat::Linear8 => quantise_channel(plane, |value| ColorFormat::Linear8.quantise(value, white), codes),
            ColorFormat::Root8 => quantise_channel(plane, |value| ColorFormat::Root8.quantise(value, white), codes),
            ColorFormat::Root10 => quantise_channel(plane, |value| ColorFormat::Root10.quantise(value, white), codes),
            ColorFormat::Half => quantise_channel(plane, |value| ColorFormat::Half.quantise(value, white), codes),
            ColorFormat::Srgb8 => quantise_channel(plane, |value| ColorFormat::Srgb8.quantise(value, white), codes),
            // Above: its channels are not each other's concern alone.
            ColorFormat::Rgb9e5 => {}
        }
    }
    subtract_green(color, codes);
}

/// Red and blue less green, modulo the width.
fn subtract_green(color: ColorFormat, [first, second, third]: &mut [Vec<u32>; 3]) {
    let mask = mask(color);
    for codes in [second, third] {
        for (code, &green) in codes.iter_mut().zip(first.iter()) {
            *code = code.wrapping_sub(green) & mask;
        }
    }
}

#[inline(always)]
fn quantise_channel(plane: &[f32], quantise: impl Fn(f32) -> u16, codes: &mut Vec<u32>) {
    codes.clear();
    codes.extend(plane.iter().map(|&value| u32::from(quantise(value))));
}

/// The linear value of every code, made anew where format or white change: most strips share theirs.
#[derive(Debug, Default)]
pub(crate) struct Dequantiser {
    of: Option<(ColorFormat, f32)>,
    values: Vec<f32>,
}

impl Dequantiser {
    /// Writes the radiance of a plane of codes.
    pub(crate) fn dequantise(
        &mut self,
        color: ColorFormat,
        white: f32,
        codes: &[Vec<u32>; 3],
        planes: &mut NodeRows<'_>,
    ) {
        let mask = mask(color);
        if self.of != Some((color, white)) {
            self.values.clear();
            self.values.extend((0..=mask).map(|code| color.dequantise(code as u16, white)));
            self.of = Some((color, white));
        }
        let values = &self.values[..=mask as usize];
        let value = |code: u32| values[(code & mask) as usize];
        let [first, second, third] = codes;
        let [red, green, blue] = &mut planes.radiance;
        let codes = first.iter().zip(second).zip(third);
        let pixels = red.iter_mut().zip(green.iter_mut()).zip(blue.iter_mut());
        for (((red, green), blue), ((&first, &second), &third)) in pixels.zip(codes) {
            *red = value(second.wrapping_add(first));
            *green = value(first);
            *blue = value(third.wrapping_add(first));
        }
    }
}

fn mask(color: ColorFormat) -> u32 {
    (1 << color.bits()) - 1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{Interfaces, Plan, Tree, VolumeRange};
    use crate::optics::Interface;
    use crate::{Camera, ImageSize, Pose};

    fn shape(interface: Interface, exposure: f32) -> FrameShape {
        FrameShape {
            camera: Camera::symmetric(1.0, ImageSize::new(4, 2)),
            plan: Plan::water(),
            interfaces: Interfaces(vec![interface]),
            format: Default::default(),
            volume: VolumeRange::default(),
            strip_rows: 2,
            exposure,
        }
    }

    fn white_of(shape: &FrameShape, node: usize, brightest: f32) -> f32 {
        let mut tree = Tree::new(Pose::IDENTITY, shape.camera, shape.plan.clone(), shape.interfaces.clone());
        tree.nodes[0].interface[3] = 1;
        tree.nodes[node].radiance[1][3] = brightest;
        tree.nodes[node].distance[3] = 1.0;
        // What an undefined pixel was left with must not matter.
        tree.nodes[0].interface[5] = 1;
        tree.nodes[node].radiance[1][5] = 1e9;
        white(shape, &tree.bands_mut(2)[0], node)
    }

    #[test]
    fn what_metal_reflects_may_be_as_bright_as_saturates_the_display_in_it() {
        // At normal incidence ((eta - 1)^2 + k^2) / ((eta + 1)^2 + k^2) is reflected.
        let metal = shape(Interface::Conductor { eta: [0.5; 3], k: [1.0; 3] }, 0.5);
        let most = 2.0 * 3.25 / 1.25;
        for (brightest, white) in [(0.1, 2.0), (3.0, 3.0), (1e9, most)] {
            assert!((white_of(&metal, 1, brightest) - white).abs() < 1e-5, "{brightest}");
        }
    }

    #[test]
    fn what_glass_reflects_may_be_brighter_than_the_display() {
        let glass = shape(Interface::Dielectric { eta: 1.5 }, 0.5);
        for (brightest, white) in [(0.1, 2.0), (3.0, 3.0), (1e9, 8.0), (f32::INFINITY, 8.0), (f32::NAN, 2.0)] {
            assert_eq!(white_of(&glass, 1, brightest), white, "{brightest}");
            assert_eq!(white_of(&glass, 2, brightest), 2.0, "refracted");
        }
        assert_eq!(white_of(&shape(Interface::Mirror, 0.5), 1, 1e9), 2.0, "mirror");
    }

    #[test]
    fn the_table_is_the_format_code_by_code() {
        let mut table = Dequantiser::default();
        for color in ColorFormat::ALL {
            for white in [0.25, 4.0] {
                let count = 1_usize << color.bits();
                let green: Vec<u32> = (0..count as u32).collect();
                let difference = vec![3; count];
                let mut planes = [vec![0.0; count], vec![0.0; count], vec![0.0; count]];
                let mut rows = NodeRows {
                    radiance: planes.each_mut().map(Vec::as_mut_slice),
                    distance: &mut [],
                    interface: &mut [],
                    normal: Default::default(),
                    shape: Default::default(),
                };
                table.dequantise(color, white, &[green, difference.clone(), difference], &mut rows);
                for code in 0..count {
                    assert_eq!(planes[1][code], color.dequantise(code as u16, white));
                    assert_eq!(planes[0][code], planes[1][(code + 3) % count]);
                    assert_eq!(planes[2][code], planes[0][code]);
                }
            }
        }
    }
}
