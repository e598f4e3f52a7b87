//! How rough a surface is at a point, and along which direction: a finish looked up.

use super::microfacet::{Facets, SMOOTH_ALPHA};
use crate::accel::SurfacePoint;
use crate::scene::{Anisotropy, Finish, Scalar, Scene};
use glam::{Vec2, Vec3};

/// Up to this alpha a rough reflection or refraction may be shown by a node of its own, with the geometry of
/// the mirror direction. Half of what a GGX lobe reflects then comes from within 2 alpha = 0.2 rad of that
/// direction: what is reflected is blurred, but still moves as the mirror image does. In a wider lobe the
/// reflected points lie so far apart that none of them tells how their sum moves. A choice, not yet measured.
pub(super) const SHARP_ALPHA: f32 = 0.1;

/// Whether an alpha gives a lobe at all.
pub(crate) fn is_rough(alpha: f32) -> bool {
    alpha >= SMOOTH_ALPHA
}

/// Whether the lobe is so narrow that it may be shown as if it were sharp.
pub(crate) fn is_narrow(alpha: Vec2) -> bool {
    alpha.max_element() <= SHARP_ALPHA
}

/// Whether the finish may be smooth or nearly sharp anywhere.
pub(crate) fn may_be_narrow(finish: &Finish) -> bool {
    let strength = if finish.anisotropy.texture.is_some() { 0.0 } else { finish.anisotropy.strength };
    may_be_narrow_scalar(&finish.alpha) && along(0.0, strength) <= SHARP_ALPHA
}

/// The same of an alpha alone.
pub(crate) fn may_be_narrow_scalar(alpha: &Scalar) -> bool {
    match *alpha {
        Scalar::Constant(alpha) => alpha <= SHARP_ALPHA,
        Scalar::Textured { .. } => true,
    }
}

/// Alpha along the rougher direction (KHR_materials_anisotropy).
fn along(alpha: f32, strength: f32) -> f32 {
    alpha + (1.0 - alpha) * strength * strength
}

/// The facets of a finish at a point, `None` where it is smooth, and the rougher direction in world where there
/// is one.
pub(crate) fn facets_at(scene: &Scene, finish: &Finish, point: &SurfacePoint) -> (Option<Facets>, Option<Vec3>) {
    let alpha = finish.alpha.at(&scene.textures, point.uv);
    let alpha = if alpha.is_finite() { alpha.max(0.0) } else { 0.0 };
    let Anisotropy { mut strength, rotation_rad, texture } = finish.anisotropy;
    if strength == 0.0 {
        return (is_rough(alpha).then(|| Facets::new(finish.distribution, Vec2::splat(alpha))), None);
    }
    let mut turn = Vec2::from_angle(rotation_rad);
    if let Some(texture) = texture.and_then(|texture| scene.textures.get(texture as usize)) {
        let texel = texture.sample(point.uv);
        strength *= texel.z.clamp(0.0, 1.0);
        turn = turn.rotate((2.0 * texel.truncate() - Vec2::ONE).normalize_or(Vec2::X));
    }
    let alphas = Vec2::new(along(alpha, strength.clamp(0.0, 1.0)), alpha);
    if !is_rough(alphas.x) {
        return (None, None);
    }
    let [u, v] = point.tangents(scene);
    (Some(Facets::new(finish.distribution, alphas)), Some(turn.x * u + turn.y * v))
}
