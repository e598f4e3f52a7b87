//! Shells inside each other: a distance from the centre that is rippled, and empty in windows.
//!
//! The field is smooth, so that a transfer function with a thin peak for each shell shows as many shells as it has
//! peaks: what pre-integration and layers are tested by. Through the windows in the outer part what is inside
//! is seen, and moves against it.
//!
//! Cost: a few sines a cell.

use glam::Vec3;

/// Values within windows: beyond those of every shell.
pub(super) const EMPTY: f32 = 2.0;

/// The field at a point of [-1, 1]^3.
pub(super) fn value(point: Vec3) -> f32 {
    let radius = point.length();
    let direction = point / radius.max(1e-6);
    let longitude = direction.z.atan2(direction.x);
    // Ripples vanish at the poles, where longitudes meet.
    let round = direction.x.hypot(direction.z);
    let ripples = 0.022 * round * round * (6.0 * longitude).sin() * (7.0 * direction.y).cos();
    let field = radius + ripples;
    // Bands around, each with windows in it; between them ribs.
    let window = (3.0 * longitude + 2.4 * direction.y).sin() * (5.5 * direction.y).cos();
    let open = smooth((window - 0.12) / 0.16) * smooth((radius - 0.56) / 0.08);
    field + (EMPTY - field).max(0.0) * open
}

fn smooth(part: f32) -> f32 {
    let part = part.clamp(0.0, 1.0);
    part * part * (3.0 - 2.0 * part)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inside_the_windows_it_is_the_radius_but_for_ripples() {
        for index in 0..1000 {
            let angle = index as f32;
            let direction = Vec3::new(angle.sin(), (angle * 1.7).sin(), angle.cos()).normalize();
            for radius in [0.0, 0.1, 0.35, 0.55] {
                assert!((value(direction * radius) - radius).abs() <= 0.0221);
            }
            assert!(value(direction * 0.8) >= 0.8 - 0.0221);
        }
    }

    #[test]
    fn about_a_third_of_the_outermost_shell_is_open() {
        let open = (0..10_000)
            .filter(|&index| {
                // A spiral of equal areas.
                let y = 1.0 - 2.0 * (index as f32 + 0.5) / 10_000.0;
                let (sine, cosine) = (index as f32 * 2.399_963).sin_cos();
                let round = (1.0 - y * y).sqrt();
                value(Vec3::new(round * cosine, y, round * sine) * 0.8) > 1.0
            })
            .count();
        assert!((1500..5000).contains(&open), "{open}");
    }
}
