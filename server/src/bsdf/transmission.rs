//! How much light a rough dielectric sends on, reflected and refracted together: by it [`super::dielectric`] is
//! divided.
//!
//! Beyond [`super::energy`] this depends on the relative index, with a kink wherever facets begin to reflect
//! totally. No table over all indices is smooth there, so there is one for each index that is met (both sides of
//! a glass are two, dispersed colours two each), to a thousandth: over alpha and mu, by the same quadrature, at
//! the first use or by [`prepare`].
//!
//! Limits: 0.5 % of the light (tested for indices of 1.33 and more). Closer to 1 the albedo at grazing angles is a
//! steep function of the angle: 0.6 % is wrong at 1.25, up to 4 % at 1.1 and alpha 1. Tables are never dropped: 5 KiB
//! for each index of the scenes that a process loads. Cost: 0.1 s (GGX) to 0.5 s (Beckmann) each, on a loaded core; a
//! look-up is some 10 ns, by a list of the thread's own, without a lock.

use super::energy::{between, direction_of, lattice};
use super::microfacet::{Facets, reflect_about};
use crate::scene::Distribution;
use glam::Vec2;
use std::cell::RefCell;
use std::sync::{Mutex, PoisonError};
use warplight_protocol::optics::{fresnel_dielectric, refract};

/// Nodes over the square roots of alpha and mu, 0 to 1.
const ALPHAS: usize = 32;
const COSINES: usize = 40;
/// Generator and points of the quadrature's lattice.
const LATTICE: [u32; 2] = [987, 1597];
/// Indices are rounded to one in this many, and so tables are shared.
const PER_INDEX: f32 = 1000.0;
/// Indices of the tables: beyond them nothing transparent is known.
const LEAST_INDEX: f32 = 0.1;
const MOST_INDEX: f32 = 10.0;

type Table = [[f32; COSINES]; ALPHAS];

/// What a table is for: the index in units of 1 / [`PER_INDEX`].
type Key = (Distribution, u32);

static TABLES: Mutex<Vec<(Key, &'static Table)>> = Mutex::new(Vec::new());

thread_local! {
    /// Tables that the thread has used.
    static KNOWN: RefCell<Vec<(Key, &'static Table)>> = const { RefCell::new(Vec::new()) };
}

/// Makes the table for an index, so that no path has to wait for it.
pub(crate) fn prepare(distribution: Distribution, eta: f32) {
    table(key(distribution, eta));
}

/// Light that a rough dielectric reflects and refracts, as a fraction of what meets it from a direction of cosine
/// `mu`, without the scaling of radiance by the index.
pub(crate) fn dielectric_albedo(facets: &Facets, eta: f32, mu: f32) -> f32 {
    let key = key(facets.distribution, eta);
    let found = KNOWN.with_borrow(|known| known.iter().find(|(of, _)| *of == key).map(|&(_, table)| table));
    let table = found.unwrap_or_else(|| {
        let table = table(key);
        KNOWN.with_borrow_mut(|known| known.push((key, table)));
        table
    });
    let (row, row_part) = between(facets.mean_alpha().sqrt(), ALPHAS);
    let (node, node_part) = between(mu.clamp(0.0, 1.0).sqrt(), COSINES);
    let along = |row: &[f32; COSINES]| row[node] + (row[node + 1] - row[node]) * node_part;
    let (low, high) = (along(&table[row]), along(&table[row + 1]));
    low + (high - low) * row_part
}

fn key(distribution: Distribution, eta: f32) -> Key {
    (distribution, (eta.clamp(LEAST_INDEX, MOST_INDEX) * PER_INDEX).round() as u32)
}

fn table(key: Key) -> &'static Table {
    // A table is pushed whole or not at all, so a poisoned list is as good as any.
    let mut tables = TABLES.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(&(_, table)) = tables.iter().find(|(of, _)| *of == key) {
        return table;
    }
    let (distribution, index) = key;
    let eta = index as f32 / PER_INDEX;
    let square = |node: usize, nodes: usize| (node as f32 / (nodes - 1) as f32).powi(2);
    let mut made: Box<Table> = Box::new([[1.0; COSINES]; ALPHAS]);
    // A smooth boundary, the first row, keeps all.
    for (row, nodes) in made.iter_mut().enumerate().skip(1) {
        for (node, value) in nodes.iter_mut().enumerate() {
            *value = albedo_by_quadrature(distribution, square(row, ALPHAS), eta, square(node, COSINES));
        }
    }
    let made: &'static Table = Box::leak(made);
    tables.push((key, made));
    made
}

fn albedo_by_quadrature(distribution: Distribution, alpha: f32, eta: f32, mu: f32) -> f32 {
    let facets = Facets::new(distribution, Vec2::splat(alpha));
    let wo = direction_of(mu);
    let (mut sum, mut weights) = (0.0, 0.0);
    for (u, weight) in lattice(distribution, LATTICE) {
        weights += weight;
        let m = facets.sample_visible(wo, u);
        let reflectance = fresnel_dielectric(wo.dot(m), eta);
        let reflected = reflect_about(wo, m);
        if reflected.z > 0.0 {
            sum += weight * reflectance * facets.visible(reflected);
        }
        if let Some(refracted) = refract(-wo, m, eta).filter(|refracted| refracted.z < 0.0) {
            sum += weight * (1.0 - reflectance) * facets.visible(refracted);
        }
    }
    sum / weights
}
