//! Head poses, and the two ways they travel.
//!
//! A [`Pose`] maps view to world and is held in f64: ten kilometres from the origin an f32 position
//! moves in steps of a millimetre. On the wire it takes 25 bytes, one more than the twelve half floats
//! of the thesis (Lochmann, 3.2.5), whose matrix is off by up to half a metre a kilometre away; both are
//! here, so that the cost of the second can be shown.

use crate::codec::bits::{BitReader, BitWriter};
use glam::{DMat3, DQuat, DVec3, Vec3};
use half::f16;
use serde::{Deserialize, Serialize};

/// world_from_view: a rigid motion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// The eye in world, in metres.
    pub position: DVec3,
    /// Turns directions in view into directions in world; unit length.
    pub orientation: DQuat,
}

/// A rigid motion in f32, for points near the eye: `target_from_source`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigidMotion {
    /// Rotation, by columns.
    pub rotation: glam::Mat3,
    /// Translation in metres.
    pub translation: Vec3,
}

impl RigidMotion {
    /// Moves a point.
    pub fn point(&self, point: Vec3) -> Vec3 {
        self.rotation * point + self.translation
    }

    /// Turns a direction.
    pub fn direction(&self, direction: Vec3) -> Vec3 {
        self.rotation * direction
    }
}

impl Pose {
    /// The eye at the origin of the world, looking along -Z.
    pub const IDENTITY: Pose = Pose { position: DVec3::ZERO, orientation: DQuat::IDENTITY };

    /// Bytes of the precise wire form.
    pub const WIRE_BYTES: usize = 25;
    /// Bytes of the thesis's form.
    pub const HALF_BYTES: usize = 24;
    /// Largest coordinate of the precise wire form, in metres.
    pub const MAX_COORDINATE_M: f64 = 32_767.0;

    /// An eye at `position` that looks at `target`, upright; straight up or down it looks with -Z up.
    pub fn look_at(position: DVec3, target: DVec3) -> Pose {
        let back = (position - target).try_normalize().unwrap_or(DVec3::Z);
        let right = DVec3::Y.cross(back).try_normalize().unwrap_or(DVec3::X);
        let up = back.cross(right);
        Pose { position, orientation: DQuat::from_mat3(&DMat3::from_cols(right, up, back)).normalize() }
    }

    /// A point in view, moved to world.
    pub fn point_in_world(&self, point_in_view: DVec3) -> DVec3 {
        self.orientation * point_in_view + self.position
    }

    /// `self_from_other`: what moves a point in the other pose's view into this one's. Formed in f64, so
    /// it stays exact far from the origin.
    pub fn view_from(&self, other: &Pose) -> RigidMotion {
        let view_from_world = self.orientation.inverse();
        RigidMotion {
            rotation: DMat3::from_quat(view_from_world * other.orientation).as_mat3(),
            translation: (view_from_world * (other.position - self.position)).as_vec3(),
        }
    }

    /// The rotation between the two poses, in radians from 0 to pi; blind to the sign of a quaternion.
    pub fn angle_to(&self, other: &Pose) -> f64 {
        let between = self.orientation.inverse() * other.orientation;
        2.0 * between.xyz().length().atan2(between.w.abs())
    }

    /// The pose `t` of the way from `self` to `other`, along the shorter arc; `t` beyond 0 to 1
    /// extrapolates.
    pub fn interpolate(&self, other: &Pose, t: f64) -> Pose {
        let mut between = self.orientation.inverse() * other.orientation;
        if between.w < 0.0 {
            between = -between;
        }
        let turned = self.orientation * DQuat::from_scaled_axis(scaled_axis(between) * t);
        Pose { position: self.position + (other.position - self.position) * t, orientation: turned.normalize() }
    }

    /// Finite, near enough to travel, and with an orientation of unit length (to 1e-3).
    pub fn is_valid(&self) -> bool {
        // Coordinate by coordinate: the largest of them would hide one that is no number.
        self.position.to_array().iter().all(|coordinate| coordinate.abs() <= Self::MAX_COORDINATE_M)
            && (self.orientation.length() - 1.0).abs() < 1e-3
    }

    /// The precise wire form: coordinates in steps of 2^-20 m, and the three smaller components of the
    /// orientation in 30 bits each behind the index of the largest. `None` where the pose is not valid.
    pub fn to_wire(&self) -> Option<[u8; Self::WIRE_BYTES]> {
        if !self.is_valid() {
            return None;
        }
        let mut bits = BitWriter::default();
        for coordinate in self.position.to_array() {
            let steps = (coordinate * POSITION_STEPS_PER_M).round() as i64;
            bits.write(steps as u64 & mask(POSITION_BITS), POSITION_BITS);
        }
        let q = self.orientation.normalize().to_array();
        let largest = (0..4).max_by(|&a, &b| q[a].abs().total_cmp(&q[b].abs())).unwrap_or(3);
        let sign = 1.0_f64.copysign(q[largest]);
        bits.write(largest as u64, 2);
        for index in (0..4).filter(|&index| index != largest) {
            let code = (q[index] * sign * SMALL_COMPONENT_STEPS).round() as i64;
            bits.write((code + SMALL_COMPONENT_STEPS_INT) as u64, COMPONENT_BITS);
        }
        let bytes = bits.finish();
        bytes.try_into().ok()
    }

    /// Reads the precise wire form; `None` where a component is out of range or padding is not zero.
    pub fn from_wire(bytes: &[u8; Self::WIRE_BYTES]) -> Option<Pose> {
        let mut bits = BitReader::new(bytes);
        let mut position = [0.0; 3];
        for coordinate in &mut position {
            let unsigned = bits.read(POSITION_BITS)?;
            let shift = 64 - POSITION_BITS;
            *coordinate = (((unsigned << shift) as i64) >> shift) as f64 / POSITION_STEPS_PER_M;
        }
        let largest = bits.read(2)? as usize;
        let mut q = [0.0; 4];
        let mut sum_of_squares = 0.0;
        for index in (0..4).filter(|&index| index != largest) {
            let code = bits.read(COMPONENT_BITS)? as i64 - SMALL_COMPONENT_STEPS_INT;
            q[index] = code as f64 / SMALL_COMPONENT_STEPS;
            sum_of_squares += q[index] * q[index];
        }
        let no_padding = bits.read(Self::WIRE_BYTES * 8 - 3 * POSITION_BITS - 2 - 3 * COMPONENT_BITS)? == 0;
        // The largest component is at least 1/2, so the others hold at most 3/4 (and rounding).
        if sum_of_squares > 0.75 + 1e-6 || !no_padding {
            return None;
        }
        q[largest] = (1.0 - sum_of_squares).sqrt();
        let pose = Pose { position: DVec3::from_array(position), orientation: DQuat::from_array(q).normalize() };
        pose.is_valid().then_some(pose)
    }

    /// The thesis's form: the upper three rows of world_from_view as half floats, row by row.
    pub fn to_half_matrix(&self) -> [u8; Self::HALF_BYTES] {
        let rotation = DMat3::from_quat(self.orientation);
        let mut bytes = [0; Self::HALF_BYTES];
        for row in 0..3 {
            for column in 0..4 {
                let value = if column < 3 { rotation.col(column)[row] } else { self.position[row] };
                let at = 2 * (4 * row + column);
                bytes[at..at + 2].copy_from_slice(&f16::from_f64(value).to_le_bytes());
            }
        }
        bytes
    }

    /// Reads the thesis's form; its rotation is made orthonormal again. `None` where it is not a rotation.
    pub fn from_half_matrix(bytes: &[u8; Self::HALF_BYTES]) -> Option<Pose> {
        let at = |row: usize, column: usize| {
            let at = 2 * (4 * row + column);
            f16::from_le_bytes([bytes[at], bytes[at + 1]]).to_f64()
        };
        let column = |column: usize| DVec3::new(at(0, column), at(1, column), at(2, column));
        let x = column(0).try_normalize()?;
        let z = x.cross(column(1)).try_normalize()?;
        if z.dot(column(2)) < 0.5 {
            return None;
        }
        let rotation = DMat3::from_cols(x, z.cross(x), z);
        let pose = Pose { position: column(3), orientation: DQuat::from_mat3(&rotation).normalize() };
        (pose.position.is_finite() && pose.orientation.is_finite()).then_some(pose)
    }
}

/// Rotation vector of a quaternion with `w >= 0`: axis times angle; exact near zero, where the usual
/// division by the sine is not.
pub fn scaled_axis(rotation: DQuat) -> DVec3 {
    let sine = rotation.xyz().length();
    if sine < 1e-9 {
        return 2.0 * rotation.xyz();
    }
    rotation.xyz() * (2.0 * sine.atan2(rotation.w) / sine)
}

const POSITION_BITS: usize = 36;
/// Steps of about a micrometre: 36 bits then reach beyond 32 km, and half a step is 0.5 um.
const POSITION_STEPS_PER_M: f64 = (1 << 20) as f64;
const COMPONENT_BITS: usize = 30;
/// The smaller components lie within 1/sqrt(2); scaled so that they fill 30 bits with a code to spare.
const SMALL_COMPONENT_STEPS_INT: i64 = (1 << 29) - 1;
const SMALL_COMPONENT_STEPS: f64 = SMALL_COMPONENT_STEPS_INT as f64 * std::f64::consts::SQRT_2;

const fn mask(bits: usize) -> u64 {
    (1 << bits) - 1
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn any_pose(reach_m: f64) -> impl Strategy<Value = Pose> {
        let coordinate = -reach_m..reach_m;
        let component = -1.0..1.0_f64;
        (
            [coordinate.clone(), coordinate.clone(), coordinate],
            [component.clone(), component.clone(), component.clone(), component],
        )
            .prop_filter_map("no direction", |(p, q)| {
                let q = DQuat::from_array(q);
                (q.length() > 1e-3).then(|| Pose { position: DVec3::from_array(p), orientation: q.normalize() })
            })
    }

    proptest! {
        /// numerics: our own pose format, 0.01 mm and 1e-4 degrees at 10 km.
        #[test]
        fn wire_pose_is_exact_ten_kilometres_away(pose in any_pose(10_000.0)) {
            let back = Pose::from_wire(&pose.to_wire().unwrap()).unwrap();
            prop_assert!((back.position - pose.position).length() < 1e-6);
            prop_assert!(back.angle_to(&pose).to_degrees() < 1e-6);
        }

        #[test]
        fn any_bytes_give_a_valid_pose_or_none(bytes in prop::array::uniform25(any::<u8>())) {
            if let Some(pose) = Pose::from_wire(&bytes) {
                prop_assert!(pose.is_valid());
            }
        }

        #[test]
        fn interpolation_ends_where_it_should(a in any_pose(10.0), b in any_pose(10.0)) {
            prop_assert!(a.interpolate(&b, 0.0).angle_to(&a) < 1e-7);
            prop_assert!(a.interpolate(&b, 1.0).angle_to(&b) < 1e-7);
            let halves = a.interpolate(&b, 0.5);
            prop_assert!((halves.angle_to(&a) - halves.angle_to(&b)).abs() < 1e-6);
        }
    }

    /// numerics: twelve half floats at 1, 10, 100, 1000 m; their spacing is the cost that is shown.
    #[test]
    fn half_floats_lose_what_their_spacing_says() {
        let spacing_m = [(1.0, 1e-3), (10.0, 8e-3), (100.0, 6.3e-2), (1000.0, 0.5)];
        for (distance, spacing) in spacing_m {
            let mut worst_angle = 0.0_f64;
            for step in 0..500 {
                let turn = f64::from(step) * 0.37;
                let pose = Pose {
                    position: DVec3::new(distance * 1.234_56, -distance * 0.777_7, distance * 1.01),
                    orientation: DQuat::from_euler(glam::EulerRot::YXZ, turn, turn * 0.3, turn * 0.1),
                };
                let back = Pose::from_half_matrix(&pose.to_half_matrix()).unwrap();
                assert!((back.position - pose.position).abs().max_element() <= spacing);
                worst_angle = worst_angle.max(back.angle_to(&pose).to_degrees());
            }
            assert!((0.005..0.03).contains(&worst_angle), "{worst_angle} deg");
        }
    }

    /// numerics: pose algebra, a million small increments.
    #[test]
    fn a_million_increments_stay_orthonormal() {
        let step =
            Pose { position: DVec3::ZERO, orientation: DQuat::from_euler(glam::EulerRot::YXZ, 1e-4, 2e-4, -1e-4) };
        let mut pose = Pose::IDENTITY;
        for _ in 0..1_000_000 {
            pose.orientation *= step.orientation;
        }
        assert!((pose.orientation.length() - 1.0).abs() < 1e-6);
        let m = DMat3::from_quat(pose.orientation);
        assert!((m * m.transpose() - DMat3::IDENTITY).to_cols_array().iter().all(|e| e.abs() < 1e-6));
    }

    /// numerics: pose algebra, 0, pi, and q against -q.
    #[test]
    fn the_sign_of_a_quaternion_makes_no_jump() {
        let a = Pose::IDENTITY;
        for angle in [0.0, 1e-12, 1e-6, 1.0, std::f64::consts::PI - 1e-9, std::f64::consts::PI] {
            let b = Pose { position: DVec3::ZERO, orientation: DQuat::from_axis_angle(DVec3::Y, angle) };
            let flipped = Pose { orientation: -b.orientation, ..b };
            assert!((a.angle_to(&b) - angle).abs() < 1e-9);
            assert!((a.angle_to(&flipped) - angle).abs() < 1e-9);
            assert!(b.angle_to(&flipped) < 1e-9);
            for t in [0.0, 0.3, 1.0] {
                let between = a.interpolate(&b, t);
                assert!(between.is_valid());
                assert!((between.angle_to(&a) - t * angle).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn one_coordinate_that_is_no_number_is_no_pose() {
        for axis in 0..3 {
            for bad in [f64::NAN, f64::INFINITY, -40_000.0] {
                let mut pose = Pose::IDENTITY;
                pose.position[axis] = bad;
                assert!(!pose.is_valid() && pose.to_wire().is_none());
            }
        }
        for component in 0..4 {
            let mut q = [0.0, 0.0, 0.0, 1.0];
            q[component] = f64::NAN;
            assert!(!Pose { orientation: DQuat::from_array(q), ..Pose::IDENTITY }.is_valid());
        }
    }

    #[test]
    fn looking_along_an_axis_is_that_axis() {
        let forward = Pose::look_at(DVec3::new(1.0, 2.0, 3.0), DVec3::new(1.0, 2.0, -3.0));
        assert!(forward.angle_to(&Pose::IDENTITY) < 1e-9);
        for target in [DVec3::Y, -DVec3::Y, DVec3::ZERO] {
            assert!(Pose::look_at(DVec3::ZERO, target).is_valid());
        }
    }

    #[test]
    fn relative_motion_is_exact_far_from_the_origin() {
        let far = DVec3::new(10_000.0, 0.0, -10_000.0);
        let old = Pose { position: far, orientation: DQuat::from_rotation_y(0.3) };
        let new = Pose { position: far + DVec3::new(0.001, 0.0, 0.0), orientation: old.orientation };
        let motion = new.view_from(&old);
        assert!((motion.translation.length() - 0.001).abs() < 1e-9);
    }
}
