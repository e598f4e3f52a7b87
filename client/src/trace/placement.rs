//! Puts a trace into a scene: where the scene wants the head, and looking where the scene wants it to look.
//!
//! Only a turn about the vertical axis and a translation: gravity is real in both worlds, so a head that
//! looked down still looks down. The *mean* position of the trace comes to the scene's head, since the
//! first sample of a recording is often the edge of the space that is walked.

use super::{Sample, Trace};
use glam::{DQuat, DVec3};
use warplight_protocol::Pose;

impl Trace {
    /// The trace with its mean position at `head` and its first heading turned to `head`'s.
    pub fn placed_at(&self, head: &Pose) -> Trace {
        let first_heading = self.samples().first().map_or(0.0, |first| heading_rad(&first.head_pose));
        let turn = DQuat::from_rotation_y(heading_rad(head) - first_heading);
        let mean = self.mean_position();
        let place = |sample: &Sample| Sample {
            time_secs: sample.time_secs,
            head_pose: Pose {
                position: head.position + turn * (sample.head_pose.position - mean),
                orientation: (turn * sample.head_pose.orientation).normalize(),
            },
        };
        Trace::from_rising(self.samples().iter().map(place).collect())
    }

    /// Mean of all positions, in metres.
    pub fn mean_position(&self) -> DVec3 {
        let sum: DVec3 = self.samples().iter().map(|sample| sample.head_pose.position).sum();
        sum / self.samples().len().max(1) as f64
    }
}

/// The angle about +Y that turns -Z to where the head faces, in radians. Looking straight up or down it is
/// where the top of the head would face.
pub fn heading_rad(pose: &Pose) -> f64 {
    let forward = pose.orientation * DVec3::NEG_Z;
    // Within half a degree of the vertical the horizontal part of the gaze is noise.
    let facing =
        if forward.x.hypot(forward.z) > 0.01 { forward } else { (pose.orientation * DVec3::Y) * -forward.y.signum() };
    (-facing.x).atan2(-facing.z)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_comes_to_the_head_and_up_stays_up() {
        let trace = Trace::synthesise(5, 10.0, 90.0).unwrap();
        let head = Pose::look_at(DVec3::new(4.0, 1.2, -3.0), DVec3::new(7.0, 0.3, -1.0));
        let placed = trace.placed_at(&head);
        assert!((placed.mean_position() - head.position).length() < 1e-9);
        assert!((heading_rad(&placed.samples()[0].head_pose) - heading_rad(&head)).abs() < 1e-9);
        for (before, after) in trace.samples().iter().zip(placed.samples()) {
            let height = |pose: &Pose| (pose.orientation * DVec3::NEG_Z).y;
            assert!((height(&before.head_pose) - height(&after.head_pose)).abs() < 1e-9);
            let rise = |trace: &Trace, sample: &Sample| sample.head_pose.position.y - trace.mean_position().y;
            assert!((rise(&trace, before) - rise(&placed, after)).abs() < 1e-9);
        }
    }

    #[test]
    fn placing_changes_no_speed() {
        let trace = Trace::synthesise(5, 10.0, 90.0).unwrap();
        let head = Pose::look_at(DVec3::new(-40.0, 1.2, 3.0), DVec3::ZERO);
        let (before, after) = (trace.facts(), trace.placed_at(&head).facts());
        assert!((before.angular_deg_per_s.max - after.angular_deg_per_s.max).abs() < 1e-6);
        assert!((before.linear_m_per_s.mean - after.linear_m_per_s.mean).abs() < 1e-9);
    }

    #[test]
    fn the_heading_does_not_jump_when_the_gaze_passes_the_vertical() {
        let yaw = 0.7;
        for pitch in [-1.58, -std::f64::consts::FRAC_PI_2, -1.5, 0.0, 1.5, std::f64::consts::FRAC_PI_2] {
            let orientation = DQuat::from_rotation_y(yaw) * DQuat::from_rotation_x(pitch);
            let heading = heading_rad(&Pose { position: DVec3::ZERO, orientation });
            assert!((heading - yaw).abs() < 1e-6, "pitch {pitch}: {heading}");
        }
    }
}
