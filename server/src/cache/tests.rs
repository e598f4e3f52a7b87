//! The cache against fields of light that are known.

use super::*;

/// The fractional part of a multiple, for sequences that fill an interval evenly.
fn fraction(index: u32, step: u32) -> f32 {
    index.wrapping_mul(step) as f32 / 4_294_967_296.0
}

/// Noise with a mean of 1, without a generator.
fn noise(index: u32) -> f32 {
    2.0 * fraction(index, 0x9e37_79b9)
}

fn place(x: f32, z: f32) -> Place {
    Place { position: Vec3::new(x, 0.3, z), normal: Vec3::Y, cell_m: 0.01 }
}

/// A cache that was given samples of `field` over a square metre, `frames` times.
fn filled(frames: u32, per_frame: u32, max_samples: f32, field: impl Fn(u32, f32, f32) -> f32) -> IrradianceCache {
    let mut cache = IrradianceCache::new(CacheSettings { log2_blocks: 13, max_samples });
    let mut deposits = Deposits::default();
    for frame in 0..frames {
        deposits.clear();
        for index in 0..per_frame {
            let number = frame * per_frame + index;
            // The R2 sequence (Roberts 2018).
            let (x, z) = (fraction(number, 0xc13f_a9a9), fraction(number, 0x91e1_0da5));
            deposits.add_visible(&place(x, z), Vec3::splat(field(frame, x, z) * noise(number / 7)));
        }
        cache.add(std::iter::once(&deposits));
    }
    cache
}

fn irradiance(cache: &IrradianceCache, x: f32, z: f32) -> f32 {
    Stencils::default().irradiance(cache, &place(x, z)).x
}

#[test]
fn few_samples_already_give_a_smooth_field() {
    let cache = filled(1, 3000, 1e4, |_, _, _| 1.0);
    for step in 0..400_u16 {
        let (x, z) = (0.1 + 0.04 * f32::from(step / 20), 0.1 + 0.04 * f32::from(step % 20));
        let value = irradiance(&cache, x, z);
        assert!((value - 1.0).abs() < 0.35, "{value} at {x} {z}");
    }
}

#[test]
fn many_samples_give_the_field_with_its_gradient() {
    let cache = filled(40, 40_000, 1e4, |_, x, _| 1.0 + x);
    let mut worst = 0.0_f32;
    for step in 0..400_u16 {
        let (x, z) = (0.1 + 0.04 * f32::from(step / 20), 0.1 + 0.04 * f32::from(step % 20));
        worst = worst.max((irradiance(&cache, x, z) / (1.0 + x) - 1.0).abs());
    }
    assert!(worst < 0.06, "{worst}");
}

#[test]
fn there_is_no_jump_where_the_width_of_cells_changes() {
    let cache = filled(20, 20_000, 1e4, |_, x, _| 1.0 + x);
    let mut stencils = Stencils::default();
    let mut before = None;
    for step in 0..1000_u16 {
        // Twice as far within the row: one level.
        let cell_m = 0.01 * (1.0 + f32::from(step) * 2e-3);
        let value = stencils.irradiance(&cache, &Place { cell_m, ..place(0.5 + f32::from(step) * 1e-5, 0.5) }).x;
        if let Some(before) = before.replace(value) {
            assert!((value - before).abs() < 0.01, "{before} to {value} at {cell_m}");
        }
    }
}

#[test]
fn light_that_changes_is_followed_at_the_pace_of_the_cap() {
    // 4 samples per cell and frame: 10 frames after the change, a mean over 16 has forgotten 9/10.
    let field = |frame, _, _| if frame < 20 { 1.0 } else { 3.0 };
    let cache = filled(30, 60_000, 16.0, field);
    let value = irradiance(&cache, 0.5, 0.5);
    assert!((value - 3.0).abs() < 0.6, "{value}");
}

#[test]
fn what_is_not_known_is_black_and_another_side_is_another_place() {
    let cache = filled(2, 1000, 1e4, |_, _, _| 1.0);
    let mut stencils = Stencils::default();
    assert_eq!(stencils.irradiance(&cache, &place(9.0, 9.0)), Vec3::ZERO);
    assert_eq!(stencils.irradiance(&cache, &Place { normal: -Vec3::Y, ..place(0.5, 0.5) }), Vec3::ZERO);
    assert_eq!(cache.mean_at(&Place { normal: Vec3::X, ..place(0.5, 0.5) }, 1.0), None);
    assert!(stencils.irradiance(&cache, &place(f32::NAN, f32::INFINITY)).is_finite());
    let bytes = cache.bytes();
    assert_eq!(bytes, 348 << 13);
    let mut cache = cache;
    cache.clear();
    assert_eq!(irradiance(&cache, 0.5, 0.5), 0.0);
}

#[test]
fn contents_do_not_depend_on_the_number_of_threads() {
    let value = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| irradiance(&filled(3, 5000, 100.0, |_, x, z| x * z), 0.4, 0.7))
    };
    assert_eq!(value(1).to_bits(), value(3).to_bits());
}
