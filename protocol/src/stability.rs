//! Bounds of hard cases: what a test may be off by, and the worst that it was.
//!
//! Part of the tests of every crate, each of which includes this file. Every row of `docs/stability.md` is one or more tests
//! whose names begin with `stability_`, in the crate that owns the arithmetic; such a test states its bounds here and hands
//! in what it sees. Whatever exceeds its bound, or is no number, ends the test.
//!
//! `WARPLIGHT_STABILITY=FOLDER cargo test --workspace stability_` leaves a file for every bound in that (existing) folder;
//! `cargo run -p warplight-tests --example stability -- FOLDER` makes the table of them.

use std::fmt::Display;

/// The rows of the table: where, and its hard cases.
pub(crate) const ROWS: [(&str, &str); 19] = [
    ("segment re-integration", "tau from 1e-12 to 1e4, the new way through a segment from 0 to 1e3 times the old one"),
    ("transmittance of a ray", "1e5 thin segments; one of tau 1e4"),
    ("layering", "empty ray, one voxel, first voxel opaque, saturates in segment 1, more segments than steps"),
    ("depth code", "z near, far, infinite, behind, subnormal, no number; smooth, spiky and stepped planes"),
    ("pose on the wire", "12 half floats at 1, 10, 100, 1000 m (their cost); our own format at 10 km"),
    ("pose algebra", "1e6 composed increments; interpolation at 0 and pi; q and -q"),
    ("prediction", "equal times, time going back, gaps, one sample, no number"),
    ("unproject and project", "z to 0, behind the eye, at infinity, 179 degrees, off-axis, corners of a cube"),
    ("normals from depth", "depth edge, infinite neighbour, collinear neighbours, image border"),
    ("Fresnel", "cosine 0, critical angle +- 1 ulp, eta = 1, eta < 1, k = 0, huge k"),
    ("refract and reflect", "unit vectors off by 1e-4, grazing, slab at 0 and 90 degrees"),
    (
        "ray and box, ray and triangle",
        "axis-parallel, origin on a plane, slivers, coplanar, shared edges, 1e-6 to 1e6, 10 km",
    ),
    ("leaving a surface", "every scale and grazing angle; white furnaces"),
    ("sampling", "roughness 0 and 1e-4, albedo 0 and 1, a light without area, one texel of 1e5, black surroundings"),
    ("accumulation", "1e6 samples, one of them 1e8"),
    ("tone mapping", "0, subnormal, 1e8, negative, infinite, no number"),
    ("specular flow", "flat energy, start outside of the picture, no valid neighbour, two optima"),
    ("epipolar walk", "epipole in the picture, rotation only, along a pixel's edge, eye inside of the volume"),
    ("decoder", "cut at every byte, flipped bits, huge lengths, deep nesting, a bomb"),
];

/// A quantity, what it may be at most, and the most that was seen.
#[derive(Debug)]
pub(crate) struct Bound {
    test: &'static str,
    row: usize,
    quantity: &'static str,
    bound: f64,
    worst: f64,
}

impl Bound {
    /// Of the row whose name begins so; `test` is the path of the function. [`bound!`] fills that in.
    pub(crate) fn new(test: &'static str, row: &str, quantity: &'static str, bound: f64) -> Bound {
        let row = ROWS.iter().position(|(name, _)| name.starts_with(row)).expect("a row of the table");
        Bound { test, row, quantity, bound, worst: 0.0 }
    }

    /// Takes in what was seen; `at` tells where, should it be too much.
    #[track_caller]
    pub(crate) fn see(&mut self, value: f64, at: impl Display) {
        let Bound { quantity, bound, .. } = self;
        assert!(value <= *bound, "{quantity}: {value:e} is above {bound:e} at {at}");
        self.worst = self.worst.max(value);
    }

    /// Takes in something that must not be: a quantity that is a number of such cases.
    #[track_caller]
    pub(crate) fn count(&mut self, is_bad: bool, at: impl Display) {
        self.see(self.worst + f64::from(u8::from(is_bad)), at);
    }
}

impl Drop for Bound {
    fn drop(&mut self) {
        let Some(folder) = std::env::var_os("WARPLIGHT_STABILITY").filter(|_| !std::thread::panicking()) else {
            return;
        };
        let Bound { test, row, quantity, bound, worst } = self;
        let slug = |text: &str| text.replace(|letter: char| !letter.is_ascii_alphanumeric(), "-");
        let file = std::path::Path::new(&folder).join(format!("{row:02}-{}-{}.tsv", slug(test), slug(quantity)));
        let line = format!("{row}\t{test}\t{quantity}\t{bound:.2e}\t{worst:.2e}\n");
        std::fs::write(&file, line).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
    }
}

/// A [`Bound`] of the test that stands around: `bound!("row", "quantity", most)`.
macro_rules! bound {
    ($row:literal, $quantity:expr, $bound:expr) => {{
        fn here() {}
        let test = std::any::type_name_of_val(&here).trim_end_matches("::here");
        $crate::stability::Bound::new(test, $row, $quantity, $bound)
    }};
}
pub(crate) use bound;
