//! Things that move: rigid motions of lights, spheres and triangles along keys.
//!
//! Part of the scene. The scene as loaded is the one that the motions are applied to; [`Scene::at`] gives it at an
//! instant. A frame is rendered at the instant for which it is meant to be displayed, on the client's clock, and so
//! is a still, so that both ends of a replay see the same scene.
//!
//! Method: between keys translation is linear and rotation spherically linear (Shoemake 1985), about a pivot that is
//! moved along. With a period the last key leads back to the first; without one the ends are held.
//!
//! Limits: motions are rigid and known beforehand; a vertex that a moving and a resting triangle share moves. Cost:
//! of [`Origins::place`] a few operations per moved light or vertex.

use super::{Light, Scene, Sphere};
use glam::{DAffine3, DQuat, DVec3, Vec3};
use std::ops::Range;

/// What moves.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Target {
    /// The light without extent of this index.
    Light(u32),
    /// The sphere of this index.
    Sphere(u32),
    /// Triangles, with all their vertices.
    Triangles(Range<u32>),
}

/// Where it is at an instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Key {
    /// Seconds since the start.
    pub at_secs: f64,
    /// From its place in the scene as loaded, in metres.
    pub translate: DVec3,
    /// About the pivot; unit length.
    pub rotate: DQuat,
}

/// How one thing moves.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    /// What moves.
    pub target: Target,
    /// The point that rotations are about, in world, before it is translated.
    pub pivot: DVec3,
    /// At least one, in the order of time.
    pub keys: Vec<Key>,
    /// After so many seconds it starts again; not before the last key.
    pub period_secs: Option<f64>,
}

impl Motion {
    /// `world_from_world_as_loaded` at an instant.
    pub fn at(&self, secs: f64) -> DAffine3 {
        let Some((first, last)) = self.keys.first().zip(self.keys.last()) else { return DAffine3::IDENTITY };
        let period = self.period_secs.filter(|period| *period > 0.0);
        let secs = period.map_or(secs, |period| secs.rem_euclid(period));
        let next = self.keys.partition_point(|key| key.at_secs <= secs);
        // The keys before and behind, and how far it is from the one to the other.
        let between = |a: &Key, b: &Key, since: f64, length: f64| {
            let t = if length > 0.0 { since / length } else { 0.0 };
            (a.translate.lerp(b.translate, t), a.rotate.slerp(b.rotate, t))
        };
        let (translate, rotate) =
            match (next.checked_sub(1).map(|index| &self.keys[index]), self.keys.get(next), period) {
                (Some(a), Some(b), _) => between(a, b, secs - a.at_secs, b.at_secs - a.at_secs),
                (Some(a), None, Some(period)) => {
                    between(a, first, secs - a.at_secs, period - a.at_secs + first.at_secs)
                }
                (None, Some(b), Some(period)) => {
                    between(last, b, secs + period - last.at_secs, b.at_secs + period - last.at_secs)
                }
                (Some(only), None, None) | (None, Some(only), None) => (only.translate, only.rotate),
                (None, None, _) => return DAffine3::IDENTITY,
            };
        DAffine3::from_rotation_translation(rotate, translate + self.pivot - rotate * self.pivot)
    }

    /// Says in words what is wrong with it, if anything is.
    pub fn check(&self, scene: &Scene) -> Result<(), String> {
        let there = match &self.target {
            Target::Light(index) => (*index as usize) < scene.lights.len(),
            Target::Sphere(index) => (*index as usize) < scene.spheres.len(),
            Target::Triangles(range) => range.start < range.end && range.end as usize <= scene.mesh.triangles.len(),
        };
        if !there {
            return Err("expected a target that is there".to_owned());
        }
        if self.keys.is_empty() {
            return Err("expected at least one key".to_owned());
        }
        let finite = |key: &Key| key.at_secs >= 0.0 && key.at_secs.is_finite() && key.translate.is_finite();
        if !self.pivot.is_finite() || !self.keys.iter().all(|key| finite(key) && key.rotate.is_normalized()) {
            return Err("expected keys of finite times from 0 on, translations, and unit rotations".to_owned());
        }
        if !self.keys.windows(2).all(|pair| pair[0].at_secs < pair[1].at_secs) {
            return Err("expected keys in the order of time".to_owned());
        }
        let last = self.keys.last().map_or(0.0, |key| key.at_secs);
        match self.period_secs {
            Some(period) if !(period.is_finite() && period > 0.0 && period >= last) => {
                Err("expected a period above 0, not before the last key".to_owned())
            }
            _ => Ok(()),
        }
    }
}

/// Whether something has moved, by what has to be made ready anew.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Moved {
    /// Lights without extent.
    pub lights: bool,
    /// Spheres or triangles.
    pub surfaces: bool,
}

/// What moves, as it was loaded.
#[derive(Clone, Debug, Default)]
pub struct Origins(Vec<Origin>);

#[derive(Clone, Debug)]
enum Origin {
    Light(Light),
    Sphere(Sphere),
    /// Index, position and normal.
    Vertices(Vec<(u32, Vec3, Vec3)>),
    Nothing,
}

impl Origins {
    /// Of a scene as loaded.
    pub fn of(scene: &Scene) -> Origins {
        let origin = |motion: &Motion| match &motion.target {
            Target::Light(index) => scene.lights.get(*index as usize).map(|light| Origin::Light(*light)),
            Target::Sphere(index) => scene.spheres.get(*index as usize).map(|sphere| Origin::Sphere(*sphere)),
            Target::Triangles(range) => {
                scene.mesh.triangles.get(range.start as usize..range.end as usize).map(|range| {
                    let mut vertices: Vec<u32> = range.iter().flatten().copied().collect();
                    vertices.sort_unstable();
                    vertices.dedup();
                    let mesh = &scene.mesh;
                    let normal = |index: u32| mesh.normals.get(index as usize).copied().unwrap_or(Vec3::ZERO);
                    Origin::Vertices(vertices.iter().map(|&v| (v, mesh.positions[v as usize], normal(v))).collect())
                })
            }
        };
        Origins(scene.motions.iter().map(|motion| origin(motion).unwrap_or(Origin::Nothing)).collect())
    }

    /// Moves a scene, wherever it has been moved before, to an instant.
    pub fn place(&self, scene: &mut Scene, secs: f64) -> Moved {
        let mut moved = Moved::default();
        let Scene { motions, lights, spheres, mesh, .. } = scene;
        for (motion, origin) in motions.iter().zip(&self.0) {
            let motion_to = motion.at(secs);
            let point = |point: Vec3| motion_to.transform_point3(point.as_dvec3()).as_vec3();
            match (&motion.target, origin) {
                (Target::Light(index), Origin::Light(light)) => {
                    let now = light.moved(&motion_to);
                    let place = &mut lights[*index as usize];
                    moved.lights |= *place != now;
                    *place = now;
                }
                (Target::Sphere(index), Origin::Sphere(sphere)) => {
                    let now = Sphere { centre: point(sphere.centre), ..*sphere };
                    let place = &mut spheres[*index as usize];
                    moved.surfaces |= *place != now;
                    *place = now;
                }
                (Target::Triangles(_), Origin::Vertices(vertices)) => {
                    for &(index, position, normal) in vertices {
                        let now = point(position);
                        let place = &mut mesh.positions[index as usize];
                        moved.surfaces |= *place != now;
                        *place = now;
                        if let Some(place) = mesh.normals.get_mut(index as usize) {
                            *place = motion_to.transform_vector3(normal.as_dvec3()).as_vec3();
                        }
                    }
                }
                _ => {}
            }
        }
        moved
    }
}

impl Scene {
    /// The scene at an instant, for one that is as loaded.
    pub fn at(&self, secs: f64) -> Scene {
        let mut scene = self.clone();
        Origins::of(self).place(&mut scene, secs);
        scene
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{SceneBuilder, diffuse};

    fn key(at_secs: f64, translate: DVec3, angle: f64) -> Key {
        Key { at_secs, translate, rotate: DQuat::from_rotation_y(angle) }
    }

    fn motion(target: Target, keys: Vec<Key>, period_secs: Option<f64>) -> Motion {
        Motion { target, pivot: DVec3::ZERO, keys, period_secs }
    }

    #[test]
    fn between_keys_it_is_linear_and_a_period_leads_back_to_the_first() {
        let keys = vec![key(1.0, DVec3::ZERO, 0.0), key(3.0, DVec3::X * 2.0, 1.0)];
        let once = motion(Target::Light(0), keys.clone(), None);
        let again = motion(Target::Light(0), keys, Some(4.0));
        let x = |motion: &Motion, secs| motion.at(secs).transform_point3(DVec3::ZERO).x;
        assert_eq!([0.0, 1.0, 2.0, 3.0, 9.0].map(|secs| x(&once, secs)), [0.0, 0.0, 1.0, 2.0, 2.0]);
        // Back within the two seconds from the last key to the first of the next round.
        for (secs, expected) in [(1.0, 0.0), (2.0, 1.0), (3.0, 2.0), (3.5, 1.5), (4.0, 1.0), (4.5, 0.5), (5.0, 0.0)] {
            assert!((x(&again, secs) - expected).abs() < 1e-12, "{secs}");
            assert!((x(&again, secs + 4e6) - expected).abs() < 1e-8);
        }
        let turned = once.at(2.0).transform_vector3(DVec3::X);
        assert!((turned - DQuat::from_rotation_y(0.5) * DVec3::X).length() < 1e-12);
    }

    #[test]
    fn rotations_are_about_the_pivot_and_motion_is_rigid() {
        let pivot = DVec3::new(3.0, 1.0, -2.0);
        let motion = Motion { pivot, ..motion(Target::Light(0), vec![key(0.0, DVec3::Y, 2.0)], None) };
        assert!((motion.at(7.0).transform_point3(pivot) - pivot - DVec3::Y).length() < 1e-12);
        assert!((motion.at(7.0).matrix3.determinant() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn lights_spheres_and_triangles_are_placed_from_where_they_were_loaded() {
        let mut scene = SceneBuilder::new()
            .floor(0.0, 1.0, diffuse(0.5))
            .cube(Vec3::Y, 0.5, diffuse(0.5))
            .sphere(Vec3::Z, 0.2, diffuse(0.5))
            .build();
        scene.lights = vec![Light::Point { position: Vec3::Y * 3.0, intensity: Vec3::ONE }];
        let keys = vec![key(0.0, DVec3::ZERO, 0.0), key(1.0, DVec3::X, 1.0)];
        scene.motions = [Target::Light(0), Target::Sphere(0), Target::Triangles(2..14)]
            .map(|target| motion(target, keys.clone(), None))
            .to_vec();
        assert!(scene.motions.iter().all(|motion| motion.check(&scene) == Ok(())));
        let origins = Origins::of(&scene);
        let mut moving = scene.clone();
        assert_eq!(origins.place(&mut moving, 0.0), Moved::default());
        for secs in [0.7, 0.2, 1.0] {
            assert_eq!(origins.place(&mut moving, secs), Moved { lights: true, surfaces: true });
            // No drift: the same as from the start.
            let at = scene.at(secs);
            assert!(at.mesh.positions == moving.mesh.positions && at.spheres == moving.spheres);
        }
        assert!(
            (moving.spheres[0].centre - (DQuat::from_rotation_y(1.0).as_quat() * Vec3::Z + Vec3::X)).length() < 1e-6
        );
        assert_eq!(moving.mesh.positions[..4], scene.mesh.positions[..4]);
        let side = |scene: &Scene| (scene.mesh.positions[8] - scene.mesh.positions[9]).length();
        assert!((side(&moving) - side(&scene)).abs() < 1e-6);
        assert!(
            matches!(moving.lights[0], Light::Point { position, .. } if (position - Vec3::new(1.0, 3.0, 0.0)).length() < 1e-6)
        );
    }

    #[test]
    fn motions_that_make_no_sense_are_refused_in_words() {
        let scene = SceneBuilder::new().floor(0.0, 1.0, diffuse(0.5)).build();
        let good =
            motion(Target::Triangles(0..2), vec![key(0.0, DVec3::ZERO, 0.0), key(1.0, DVec3::X, 0.0)], Some(1.0));
        assert_eq!(good.check(&scene), Ok(()));
        for (bad, says) in [
            (Motion { target: Target::Light(0), ..good.clone() }, "target"),
            (Motion { target: Target::Triangles(1..3), ..good.clone() }, "target"),
            (Motion { keys: vec![], ..good.clone() }, "one key"),
            (Motion { keys: vec![key(f64::NAN, DVec3::ZERO, 0.0)], ..good.clone() }, "finite"),
            (Motion { keys: vec![key(2.0, DVec3::ZERO, 0.0), key(1.0, DVec3::ZERO, 0.0)], ..good.clone() }, "order"),
            (Motion { period_secs: Some(0.5), ..good.clone() }, "period"),
        ] {
            assert!(bad.check(&scene).unwrap_err().contains(says));
            assert!(bad.at(0.3).is_finite() || says == "finite");
        }
    }
}
