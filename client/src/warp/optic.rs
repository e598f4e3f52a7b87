//! The optical boundaries of a frame in the form that lanes can look up.
//!
//! A dielectric's Fresnel weight is computed exactly, since it has an edge where reflection becomes total. A metal's
//! is smooth over the cosine, and its closed form needs f64 (see [`warplight_protocol::optics`]), so it is tabulated
//! once per frame, [`STEPS`] equal steps of the cosine, and interpolated: off by less than 2e-5, a two-hundredth of a
//! display code.

use crate::lanes::{Floats, Integers, Mask, Vector};
use warplight_protocol::frame::{Arrival, Interfaces};
use warplight_protocol::optics::Interface;

/// Steps of the cosine: the error of interpolation falls with their square.
const STEPS: usize = 1024;
const ENTRIES: usize = STEPS + 1;
/// Tables of an interface: what is reflected and what is refracted.
const KINDS: usize = 2;

/// All boundaries; index 0 is none.
#[derive(Debug, Default)]
pub(super) struct Optics {
    /// The table was made of these.
    of: Interfaces,
    /// Index beyond over index before; 0 where nothing is refracted.
    eta: Vec<f32>,
    /// 1 where weights are tabulated.
    tabulated: Vec<f32>,
    /// Weights per channel, by interface, kind and cosine.
    weights: [Vec<f32>; 3],
}

impl Optics {
    /// Makes the tables, if they are not those of the last frame.
    pub(super) fn prepare(&mut self, interfaces: &Interfaces) {
        if self.of == *interfaces && !self.eta.is_empty() {
            return;
        }
        self.of.clone_from(interfaces);
        self.eta.clear();
        self.tabulated.clear();
        self.weights.iter_mut().for_each(Vec::clear);
        self.push(0.0, None);
        for interface in &interfaces.0 {
            match interface {
                Interface::Mirror | Interface::Conductor { .. } => self.push(0.0, Some(interface)),
                // Straight on, and its weight is as smooth as a metal's.
                Interface::Pane { .. } => self.push(1.0, Some(interface)),
                Interface::Dielectric { eta } => self.push(*eta, None),
            }
        }
    }

    fn push(&mut self, eta: f32, tabulated: Option<&Interface>) {
        self.eta.push(eta);
        self.tabulated.push(if tabulated.is_some() { 1.0 } else { 0.0 });
        for kind in 0..KINDS {
            for entry in 0..ENTRIES {
                let cosine = entry as f32 / STEPS as f32;
                let weight = |interface: &Interface| match kind {
                    0 => interface.reflectance(cosine),
                    _ => interface.transmittance(cosine),
                };
                let weight = tabulated.map_or(glam::Vec3::ZERO, weight);
                for (channel, value) in self.weights.iter_mut().zip(weight.to_array()) {
                    channel.push(value);
                }
            }
        }
    }

    /// The index of refraction at an interface, 0 for none.
    #[inline(always)]
    pub(super) fn eta<F: Floats>(&self, interface: F) -> F {
        let [eta] = F::gather([&self.eta], interface.within(0.0, self.of.0.len() as f32 + 0.5).truncate());
        eta
    }

    /// The same of one interface.
    pub(super) fn eta_of(&self, interface: u8) -> f32 {
        self.eta.get(usize::from(interface)).copied().unwrap_or(0.0)
    }

    /// Weights of the light that arrives by `arrival` at an interface under this cosine.
    #[inline(always)]
    pub(super) fn weights<F: Floats>(&self, interface: F, eta: F, cosine: F, arrival: Arrival) -> [F; 3] {
        let reflects = arrival == Arrival::Reflected;
        let cosine = cosine.within(0.0, 1.0);
        let one = F::splat(1.0);
        let reflectance = fresnel_dielectric(cosine, eta.max(F::splat(1e-3)));
        let dielectric = if reflects { reflectance } else { one - reflectance };
        let dielectric = dielectric.or(F::zero().lt(eta), F::zero());
        let interface = interface.within(0.0, self.of.0.len() as f32 + 0.5).truncate();
        let [tabulated] = F::gather([&self.tabulated], interface);
        let tabulated = F::zero().lt(tabulated);
        if !tabulated.any() {
            return [dielectric; 3];
        }
        let steps = cosine * F::splat(STEPS as f32);
        let step = steps.min(F::splat(STEPS as f32 - 0.5)).truncate();
        let fraction = steps - step.to_floats();
        let kind = if reflects { 0 } else { ENTRIES as i32 };
        let at = interface * F::Integers::splat((KINDS * ENTRIES) as i32) + F::Integers::splat(kind) + step;
        let [r, g, b] = &self.weights;
        let lower = F::gather([r, g, b], at);
        let upper = F::gather([r, g, b], at + F::Integers::splat(1));
        let mut weights = [dielectric; 3];
        for (weight, (lower, upper)) in weights.iter_mut().zip(lower.into_iter().zip(upper)) {
            *weight = fraction.mul_add(upper - lower, lower).or(tabulated, dielectric);
        }
        weights
    }
}

/// [`warplight_protocol::optics::fresnel_dielectric`] in lanes.
#[inline(always)]
fn fresnel_dielectric<F: Floats>(cos_i: F, eta: F) -> F {
    let one = F::splat(1.0);
    let sin2_t = (one - cos_i * cos_i) / (eta * eta);
    let cos_t = (one - sin2_t).max(F::zero()).sqrt();
    let parallel = (eta * cos_i - cos_t) / (eta * cos_i + cos_t).max(F::splat(f32::MIN_POSITIVE));
    let perpendicular = (cos_i - eta * cos_t) / (cos_i + eta * cos_t).max(F::splat(f32::MIN_POSITIVE));
    let reflectance = F::splat(0.5) * (parallel * parallel + perpendicular * perpendicular);
    // Total reflection; also where both denominators vanish, at grazing incidence on the critical angle.
    let reflectance = reflectance.min(one).or(sin2_t.lt(one), one);
    // Equal indices make no boundary, not even at grazing incidence.
    reflectance.or(F::splat(f32::MIN_POSITIVE).lt((eta - one).abs()), F::zero())
}

/// The direction that leaves a boundary by `arrival`, and where there is one.
#[inline(always)]
pub(super) fn leaving<F: Floats>(direction: Vector<F>, normal: Vector<F>, eta: F, by: Arrival) -> (Vector<F>, F::Mask) {
    match by {
        Arrival::Refracted => {
            let is_refracting = F::zero().lt(eta);
            let (refracted, is_partial) = direction.refract(normal, eta.or(is_refracting, F::splat(1.0)));
            (refracted, is_partial & is_refracting)
        }
        Arrival::Reflected | Arrival::Direct => (direction.reflect(normal), F::zero().lt(F::splat(1.0))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::{Level, kernel};

    #[inline(always)]
    fn all_weights<F: Floats>(
        optics: &Optics,
        interface: f32,
        cosines: &[f32],
        by: Arrival,
        found: &mut [Vec<f32>; 3],
    ) {
        for at in (0..cosines.len()).step_by(F::LANES) {
            let interface = F::splat(interface);
            let weights = optics.weights(interface, optics.eta(interface), F::load(cosines, at), by);
            found.iter_mut().zip(weights).for_each(|(found, weight)| weight.store(found, at));
        }
    }

    kernel!(fn run_weights = all_weights(
        optics: &Optics, interface: f32, cosines: &[f32], by: Arrival, found: &mut [Vec<f32>; 3],
    ));

    #[test]
    fn weights_are_those_of_the_closed_forms() {
        let gold = Interface::Conductor { eta: [0.18, 0.42, 1.37], k: [3.42, 2.35, 1.77] };
        let silver = Interface::Conductor { eta: [0.05, 0.06, 0.05], k: [4.2, 3.4, 2.6] };
        let glass = |eta| Interface::Dielectric { eta };
        let pane = Interface::Pane { eta: 1.5 };
        let all = vec![Interface::Mirror, gold, silver, pane, glass(1.5), glass(1.0 / 1.5), glass(1.0), glass(1e-3)];
        let mut optics = Optics::default();
        optics.prepare(&Interfaces(all.clone()));
        let cosines: Vec<f32> = (0..=5000).map(|step| step as f32 / 5000.0).collect();
        for level in Level::available() {
            for (index, interface) in all.iter().enumerate() {
                for by in [Arrival::Reflected, Arrival::Refracted] {
                    let mut found = [const { Vec::new() }; 3].map(|mut channel: Vec<f32>| {
                        channel.resize(cosines.len(), 0.0);
                        channel
                    });
                    run_weights(level, &optics, index as f32 + 1.0, &cosines, by, &mut found);
                    let mut worst = 0.0_f32;
                    for (at, &cosine) in cosines.iter().enumerate() {
                        let expected = match by {
                            Arrival::Reflected => interface.reflectance(cosine),
                            _ => interface.transmittance(cosine),
                        };
                        for channel in 0..3 {
                            worst = worst.max((found[channel][at] - expected[channel]).abs());
                        }
                    }
                    assert!(worst < 2e-5, "{level:?} {interface:?} {by:?}: {worst}");
                }
            }
        }
    }
}
