//! Counters of rays, declared where everyone can see what is counted.
//!
//! Tracing code counts into plain [`RayCounts`] of its own and adds them to the shared [`Counters`] once
//! per band of rows, so counting costs no traffic between cores.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// Rays by kind, counted by one worker.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RayCounts {
    /// Rays from the eye.
    pub primary: u64,
    /// Rays that leave a specular surface by reflection.
    pub reflect: u64,
    /// Rays that leave a specular surface by refraction.
    pub refract: u64,
    /// Rays that leave a diffuse surface in a sampled direction.
    pub diffuse: u64,
    /// Rays that leave a rough surface in a sampled direction.
    pub glossy: u64,
    /// Rays that leave a point of a medium in a sampled direction.
    pub scatter: u64,
    /// Steps of rays of view through matter: not rays.
    pub steps: u64,
    /// Rays that ask only whether a light is seen.
    pub shadow: u64,
    /// Samples dropped because their radiance was not finite: not rays, and always to be zero.
    pub dropped: u64,
}

impl RayCounts {
    /// Names, as reports carry them, and counts.
    pub fn named(&self) -> [(&'static str, u64); 9] {
        [
            ("rays.primary", self.primary),
            ("rays.reflect", self.reflect),
            ("rays.refract", self.refract),
            ("rays.diffuse", self.diffuse),
            ("rays.glossy", self.glossy),
            ("rays.scatter", self.scatter),
            ("volume.steps", self.steps),
            ("rays.shadow", self.shadow),
            ("samples.dropped", self.dropped),
        ]
    }

    /// All rays.
    pub fn rays(&self) -> u64 {
        self.primary + self.reflect + self.refract + self.diffuse + self.glossy + self.scatter + self.shadow
    }
}

/// The counts of all workers together.
#[derive(Debug, Default)]
pub struct Counters {
    primary: AtomicU64,
    reflect: AtomicU64,
    refract: AtomicU64,
    diffuse: AtomicU64,
    glossy: AtomicU64,
    scatter: AtomicU64,
    steps: AtomicU64,
    shadow: AtomicU64,
    dropped: AtomicU64,
}

impl Counters {
    /// Adds the counts of one worker.
    pub fn add(&self, counts: &RayCounts) {
        self.primary.fetch_add(counts.primary, Relaxed);
        self.reflect.fetch_add(counts.reflect, Relaxed);
        self.refract.fetch_add(counts.refract, Relaxed);
        self.diffuse.fetch_add(counts.diffuse, Relaxed);
        self.glossy.fetch_add(counts.glossy, Relaxed);
        self.scatter.fetch_add(counts.scatter, Relaxed);
        self.steps.fetch_add(counts.steps, Relaxed);
        self.shadow.fetch_add(counts.shadow, Relaxed);
        self.dropped.fetch_add(counts.dropped, Relaxed);
    }

    /// What was counted so far.
    pub fn snapshot(&self) -> RayCounts {
        RayCounts {
            primary: self.primary.load(Relaxed),
            reflect: self.reflect.load(Relaxed),
            refract: self.refract.load(Relaxed),
            diffuse: self.diffuse.load(Relaxed),
            glossy: self.glossy.load(Relaxed),
            scatter: self.scatter.load(Relaxed),
            steps: self.steps.load(Relaxed),
            shadow: self.shadow.load(Relaxed),
            dropped: self.dropped.load(Relaxed),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_of_workers_add_up() {
        let counters = Counters::default();
        let worker = RayCounts {
            primary: 1,
            reflect: 2,
            refract: 3,
            diffuse: 4,
            glossy: 5,
            scatter: 6,
            steps: 9,
            shadow: 7,
            dropped: 8,
        };
        counters.add(&worker);
        counters.add(&worker);
        assert_eq!(counters.snapshot().named().map(|(_, count)| count), [2, 4, 6, 8, 10, 12, 18, 14, 16]);
        assert_eq!(counters.snapshot().rays(), 56);
    }
}
