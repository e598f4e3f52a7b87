//! What a ray meets in each scene: a boundary in an empty room with balls in it, in f64.
//!
//! The boundary is 1.5 m from the eye, water 1.5 m below it. A mirror is tilted about two axes, since one that faces an
//! axis hides all steps of depth. Planes and balls alone, so that every intersection is a closed form.

use glam::{DQuat, DVec2, DVec3};
use warplight_protocol::curvature::ShapeOperator;
use warplight_protocol::frame::Plan;
use warplight_protocol::{Camera, Pose};

/// A boundary and the room around it, in world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AnalyticScene {
    /// A mirror 1.5 m ahead, tilted, of 2.4 x 2 m.
    TiltedMirror,
    /// A mirror ball of half a metre.
    ChromeBall,
    /// A horizontal plane over a basin.
    Water,
    /// A solid ball of half a metre.
    GlassBall,
    /// A slab of this thickness in metres that faces the eye at an angle.
    Slab(f64),
}

const BALL: (DVec3, f64) = (DVec3::new(0.0, 0.0, -1.5), 0.5);
const WATER_Y: f64 = -1.0;

/// A boundary on the way of a ray, and what is seen in it.
#[derive(Clone, Copy, Debug)]
pub struct Bounce {
    /// The point of the boundary, in world.
    pub at: DVec3,
    /// The normal there, against the ray that arrives.
    pub normal: DVec3,
    /// The direction in which the ray leaves.
    pub direction: DVec3,
    /// How far it goes.
    pub reach: f64,
}

impl Bounce {
    /// The point that it ends at.
    pub fn shown(&self) -> DVec3 {
        self.at + self.direction * self.reach
    }
}

fn ball(origin: DVec3, direction: DVec3, (centre, radius): (DVec3, f64)) -> Option<f64> {
    let from = origin - centre;
    let along = from.dot(direction);
    let root = along * along - from.length_squared() + radius * radius;
    let (near, far) = (-along - root.sqrt(), -along + root.sqrt());
    let first = if near > 1e-7 { near } else { far };
    (root > 0.0 && first > 1e-7).then_some(first)
}

fn mirrored(direction: DVec3, normal: DVec3) -> DVec3 {
    direction - 2.0 * direction.dot(normal) * normal
}

fn refracted(direction: DVec3, normal: DVec3, eta: f64) -> Option<DVec3> {
    let cos_i = -direction.dot(normal);
    let sin2_t = (1.0 - cos_i * cos_i) / (eta * eta);
    (sin2_t < 1.0).then(|| direction / eta + (cos_i / eta - (1.0 - sin2_t).sqrt()) * normal)
}

impl AnalyticScene {
    /// The scenes of a sweep.
    pub const SWEPT: [AnalyticScene; 4] =
        [AnalyticScene::TiltedMirror, AnalyticScene::ChromeBall, AnalyticScene::Water, AnalyticScene::GlassBall];

    /// Name in reports and on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            AnalyticScene::TiltedMirror => "mirror",
            AnalyticScene::ChromeBall => "chrome-ball",
            AnalyticScene::Water => "water",
            AnalyticScene::GlassBall => "glass-ball",
            AnalyticScene::Slab(_) => "slab",
        }
    }

    /// Index of refraction behind the boundary; none of a mirror.
    pub fn eta(self) -> Option<f64> {
        match self {
            AnalyticScene::TiltedMirror | AnalyticScene::ChromeBall => None,
            AnalyticScene::Water => Some(1.33),
            AnalyticScene::GlassBall | AnalyticScene::Slab(_) => Some(1.5),
        }
    }

    /// How the surface bends where a ray leaves: alike everywhere and in every direction.
    pub fn exit_shape(self) -> ShapeOperator {
        match self {
            // From inside, the normal turns against the way along a ball.
            AnalyticScene::GlassBall => {
                let curvature = -1.0 / BALL.1 as f32;
                ShapeOperator { s11: curvature, s12: 0.0, s22: curvature }
            }
            _ => ShapeOperator::FLAT,
        }
    }

    /// The nodes of its frames.
    pub fn plan(self) -> Plan {
        match self {
            AnalyticScene::TiltedMirror | AnalyticScene::ChromeBall => Plan::mirror(),
            AnalyticScene::Water => Plan::water(),
            AnalyticScene::GlassBall | AnalyticScene::Slab(_) => Plan::solid(),
        }
    }

    /// The pose from which it is rendered.
    pub fn eye(self) -> Pose {
        match self {
            AnalyticScene::Water => Pose::look_at(DVec3::new(0.0, 0.5, 0.6), DVec3::new(0.0, -0.5, -0.5)),
            _ => Pose::IDENTITY,
        }
    }

    /// Distance to the room and what stands in it.
    pub(super) fn room(self, origin: DVec3, direction: DVec3) -> f64 {
        let (low, high) = match self {
            AnalyticScene::Water => (DVec3::new(-2.5, -2.2, -4.0), DVec3::new(2.5, 2.0, 2.5)),
            _ => (DVec3::new(-3.0, -1.5, -5.0), DVec3::new(3.0, 1.5, 3.0)),
        };
        let to_walls = (low - origin) / direction;
        let walls = to_walls.max((high - origin) / direction).min_element();
        let balls: &[(DVec3, f64)] = match self {
            AnalyticScene::Water => &[
                (DVec3::new(0.6, -1.9, -0.5), 0.25),
                (DVec3::new(-0.5, -1.8, -1.8), 0.3),
                (DVec3::new(0.0, -1.9, -1.1), 0.15),
            ],
            AnalyticScene::GlassBall | AnalyticScene::Slab(_) => &[
                (DVec3::new(0.0, 0.3, -2.9), 0.2),
                (DVec3::new(1.2, 0.7, -2.5), 0.25),
                (DVec3::new(-1.2, 0.5, -2.7), 0.25),
            ],
            _ => &[
                (DVec3::new(0.8, -0.3, 1.0), 0.35),
                (DVec3::new(-0.5, 0.6, 0.4), 0.2),
                (DVec3::new(0.3, -0.7, 0.4), 0.25),
                (DVec3::new(1.8, 0.5, -1.2), 0.3),
            ],
        };
        balls.iter().filter_map(|&of| ball(origin, direction, of)).fold(walls, f64::min)
    }

    /// The first boundary that a ray meets: distance and normal against it.
    fn boundary(self, origin: DVec3, direction: DVec3) -> Option<(f64, DVec3)> {
        let plane = |through: DVec3, normal: DVec3| {
            let distance = (through - origin).dot(normal) / direction.dot(normal);
            (distance > 1e-9).then_some((distance, normal * -direction.dot(normal).signum()))
        };
        match self {
            AnalyticScene::TiltedMirror => {
                let tilt = DQuat::from_euler(glam::EulerRot::YXZ, 0.49, 0.19, 0.0);
                let centre = DVec3::new(0.0, 0.0, -1.5);
                plane(centre, tilt * DVec3::Z).filter(|(distance, _)| {
                    let on = tilt.inverse() * (origin + direction * *distance - centre);
                    on.x.abs() < 1.2 && on.y.abs() < 1.0
                })
            }
            AnalyticScene::ChromeBall | AnalyticScene::GlassBall => {
                let distance = ball(origin, direction, BALL)?;
                let outwards = (origin + direction * distance - BALL.0) / BALL.1;
                Some((distance, outwards * -direction.dot(outwards).signum()))
            }
            AnalyticScene::Water => plane(DVec3::Y * WATER_Y, DVec3::Y).filter(|(distance, _)| {
                let on = origin + direction * *distance;
                on.x.abs() < 2.0 && on.z < 2.0 && on.z > -3.5
            }),
            AnalyticScene::Slab(thickness) => {
                let normal = DVec3::new(0.5, 0.2, 1.0).normalize();
                let front = DVec3::new(0.0, 0.0, -1.2);
                let (first, second) = (plane(front, normal), plane(front - normal * thickness, normal));
                match (first, second) {
                    (Some(a), Some(b)) => Some(if a.0 < b.0 { a } else { b }),
                    (a, b) => a.or(b),
                }
            }
        }
    }

    /// The chain of a ray: one bounce at a mirror or water, two through a solid; and the distance to the first.
    fn chain(self, origin: DVec3, direction: DVec3) -> Option<(f64, Vec<Bounce>)> {
        let (distance, normal) = self.boundary(origin, direction)?;
        if self.room(origin, direction) < distance {
            return None;
        }
        let at = origin + direction * distance;
        let Some(eta) = self.eta() else {
            let direction = mirrored(direction, normal);
            return Some((distance, vec![Bounce { at, normal, direction, reach: self.room(at, direction) }]));
        };
        let inside = refracted(direction, normal, eta)?.normalize();
        if matches!(self, AnalyticScene::Water) {
            return Some((distance, vec![Bounce { at, normal, direction: inside, reach: self.room(at, inside) }]));
        }
        let (reach, exit_normal) = self.boundary(at, inside)?;
        let first = Bounce { at, normal, direction: inside, reach };
        let exit = first.shown();
        let outside = refracted(inside, exit_normal, 1.0 / eta)?.normalize();
        let second = Bounce { at: exit, normal: exit_normal, direction: outside, reach: self.room(exit, outside) };
        Some((distance, vec![first, second]))
    }

    /// The chain of the ray through a position of a picture.
    pub fn chain_at(self, camera: &Camera, pose: &Pose, pixel: DVec2) -> Option<(f64, Vec<Bounce>)> {
        let (focal, centre) = (camera.focal_px().as_dvec2(), camera.centre_px().as_dvec2());
        let slope = (pixel - centre) / focal;
        let direction = pose.orientation * DVec3::new(slope.x, -slope.y, -1.0).normalize();
        self.chain(pose.position, direction)
    }
}
