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
    use crate::stability::bound;
    use proptest::prelude::*;
    use std::f64::consts::PI;

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

    /// Turns of all kinds, spread evenly; close to half a turn and to none too.
    fn turns() -> impl Iterator<Item = DQuat> {
        let near = [0.0, 1e-12, 1e-6, PI - 1e-9, PI].map(|angle| DQuat::from_axis_angle(DVec3::Y, angle));
        let spread = (0..20_000).map(|step| {
            let turn = f64::from(step) * 0.37;
            DQuat::from_euler(glam::EulerRot::YXZ, turn, turn * 0.3, turn * 0.1)
        });
        near.into_iter().chain(spread)
    }

    proptest! {
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

    /// The cost of twelve half floats is their spacing: half of it is what they may be off by, and for a rotation 2^-11 of
    /// each of two axes.
    #[test]
    fn stability_pose_on_the_wire() {
        let half_spacing_m = [(1.0, 2.0_f64.powi(-11)), (10.0, 2.0_f64.powi(-8)), (100.0, 1.0 / 32.0), (1000.0, 0.25)];
        let names =
            ["half floats at 1 m, m", "half floats at 10 m, m", "half floats at 100 m, m", "half floats at 1 km, m"];
        let most = (2.0_f64.sqrt() * 2.0_f64.powi(-11)).to_degrees();
        let mut half_turn = bound!("pose on the wire", "half floats, degrees", most);
        for ((distance, half_spacing), name) in half_spacing_m.into_iter().zip(names) {
            let mut half = bound!("pose on the wire", name, half_spacing);
            for orientation in turns() {
                // Below the next power of two, above which the spacing doubles.
                let position = distance * DVec3::new(1.014_56, -0.777_7, 1.01);
                let pose = Pose { position, orientation };
                let back = Pose::from_half_matrix(&pose.to_half_matrix()).unwrap();
                half.see((back.position - pose.position).abs().max_element(), distance);
                half_turn.see(back.angle_to(&pose).to_degrees(), orientation);
            }
        }
        let mut own = bound!("pose on the wire", "own format at 10 km, m", 1e-5);
        let mut own_turn = bound!("pose on the wire", "own format, degrees", 1e-4);
        for (step, orientation) in turns().enumerate() {
            let part = |per_step: f64| 2.0 * (step as f64 * per_step).fract() - 1.0;
            let position = 10_000.0 * DVec3::new(part(0.618_034), part(0.754_878), part(0.569_840));
            let pose = Pose { position, orientation };
            let back = Pose::from_wire(&pose.to_wire().unwrap()).unwrap();
            own.see((back.position - pose.position).length(), position);
            own_turn.see(back.angle_to(&pose).to_degrees(), orientation);
        }
    }

    #[test]
    fn stability_pose_algebra() {
        let mut orthonormal = bound!("pose algebra", "orthonormality after 1e6 increments", 1e-6);
        let step = DQuat::from_euler(glam::EulerRot::YXZ, 1e-4, 2e-4, -1e-4);
        let composed = (0..1_000_000).fold(DQuat::IDENTITY, |orientation, _| orientation * step);
        let m = DMat3::from_quat(composed);
        let errors = (m * m.transpose() - DMat3::IDENTITY).to_cols_array();
        errors.into_iter().chain([composed.length() - 1.0]).for_each(|error| orthonormal.see(error.abs(), composed));

        let mut angle_of = bound!("pose algebra", "angle between poses of either sign, rad", 1e-9);
        let mut way = bound!("pose algebra", "interpolation off its share of the way, rad", 1e-6);
        let mut logarithm = bound!("pose algebra", "logarithm of the exponential, rad", 1e-9);
        let a = Pose::IDENTITY;
        for angle in [0.0, 1e-12, 1e-9, 1e-6, 1.0, PI - 1e-6, PI - 1e-9, PI] {
            let b = Pose { position: DVec3::ZERO, orientation: DQuat::from_axis_angle(DVec3::Y, angle) };
            let flipped = Pose { orientation: -b.orientation, ..b };
            angle_of.see((a.angle_to(&b) - angle).abs(), angle);
            angle_of.see((a.angle_to(&flipped) - angle).abs(), angle);
            angle_of.see(b.angle_to(&flipped), angle);
            let turn = scaled_axis(DQuat::from_scaled_axis(DVec3::Y * angle));
            logarithm.see((turn.length() - angle).abs(), angle);
            for (to, t) in [0.0, 0.3, 1.0].into_iter().flat_map(|t| [(&b, t), (&flipped, t)]) {
                let between = a.interpolate(to, t);
                assert!(between.is_valid());
                way.see((between.angle_to(&a) - t * angle).abs(), format!("{angle} {t}"));
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
