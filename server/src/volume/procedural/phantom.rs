//! The head of Shepp and Logan in three dimensions: ten ellipsoids whose values add up (Kak and Slaney 1988,
//! table 3.2), with the contrasts of Toft 1996, which can be seen without stretching them. z is up, y is forward.
//!
//! Cost: ten ellipsoids a cell.

use glam::{Mat3, Vec3};

/// Value, half axes, centre, turns in degrees about z, x and z again.
type Ellipsoid = (f32, [f32; 3], [f32; 3], [f32; 3]);

const ELLIPSOIDS: [Ellipsoid; 10] = [
    (1.0, [0.69, 0.92, 0.81], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]),
    (-0.8, [0.6624, 0.874, 0.78], [0.0, -0.0184, 0.0], [0.0, 0.0, 0.0]),
    (-0.2, [0.11, 0.31, 0.22], [0.22, 0.0, 0.0], [-18.0, 0.0, 10.0]),
    (-0.2, [0.16, 0.41, 0.28], [-0.22, 0.0, 0.0], [18.0, 0.0, 10.0]),
    (0.1, [0.21, 0.25, 0.41], [0.0, 0.35, -0.15], [0.0, 0.0, 0.0]),
    (0.1, [0.046, 0.046, 0.05], [0.0, 0.1, 0.25], [0.0, 0.0, 0.0]),
    (0.1, [0.046, 0.046, 0.05], [0.0, -0.1, 0.25], [0.0, 0.0, 0.0]),
    (0.1, [0.046, 0.023, 0.05], [-0.08, -0.605, 0.0], [0.0, 0.0, 0.0]),
    (0.1, [0.023, 0.023, 0.02], [0.0, -0.606, 0.0], [0.0, 0.0, 0.0]),
    (0.1, [0.023, 0.046, 0.02], [0.06, -0.605, 0.0], [0.0, 0.0, 0.0]),
];

/// The value at a point of [-1, 1]^3; edges are `width` wide.
pub(super) fn value(point: Vec3, width: f32) -> f32 {
    ELLIPSOIDS
        .iter()
        .map(|&(value, axes, centre, turns)| {
            let [phi, theta, psi] = turns.map(f32::to_radians);
            // From space to the ellipsoid's own axes.
            let turned = if turns == [0.0; 3] {
                point - Vec3::from_array(centre)
            } else {
                Mat3::from_rotation_z(-psi)
                    * Mat3::from_rotation_x(-theta)
                    * Mat3::from_rotation_z(-phi)
                    * (point - Vec3::from_array(centre))
            };
            let axes = Vec3::from_array(axes);
            let scaled = turned / axes;
            let radius = scaled.length();
            // Distance from the surface to first order: how far inside over how fast that changes.
            let slope = (scaled / axes).length() / radius.max(1e-6);
            let depth = (1.0 - radius) / slope.max(1e-6);
            value * (0.5 + depth / width).clamp(0.0, 1.0)
        })
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tissues_have_the_values_of_the_table() {
        let at = |x, y, z| value(Vec3::new(x, y, z), 0.01);
        let close = |found: f32, expected: f32| assert!((found - expected).abs() < 1e-6, "{found} {expected}");
        close(at(0.0, 0.9, 0.0), 1.0); // bone
        close(at(0.0, -0.8, 0.0), 0.2); // brain
        close(at(0.22, 0.0, 0.0), 0.0); // ventricle
        close(at(-0.22, 0.1, 0.0), 0.0);
        close(at(0.0, 0.45, -0.15), 0.3); // tumour
        close(at(0.0, 0.0, 0.9), 0.0); // air
        close(at(1.0, 1.0, 1.0), 0.0);
    }

    #[test]
    fn its_mass_is_the_sum_of_its_ellipsoids() {
        let side = 96;
        let sum: f64 = (0..side * side * side)
            .map(|index| {
                let at = [index % side, index / side % side, index / side / side];
                let point = Vec3::from_array(at.map(|axis| (axis as f32 + 0.5) * 2.0 / side as f32 - 1.0));
                f64::from(value(point, 2.0 / side as f32)) * (2.0 / f64::from(side)).powi(3)
            })
            .sum();
        let exact: f64 = ELLIPSOIDS
            .iter()
            .map(|(value, [a, b, c], _, _)| f64::from(value * a * b * c) * 4.0 / 3.0 * std::f64::consts::PI)
            .sum();
        // Edges one cell wide on either side balance each other to first order.
        assert!((sum / exact - 1.0).abs() < 0.01, "{sum} {exact}");
    }
}
