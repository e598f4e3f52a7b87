//! The specular flow against ray-traced truth ([`crate::analytic`]).
//!
//! A frame of 1024 x 1024 pixels and 90 degrees is traced, goes through the default wire format and is warped to a
//! head moved by 5 cm.

use super::prepared::Prepared;
use super::specular::Specular;
use super::*;
use crate::analytic::{AnalyticScene as Solid, Truth};
use glam::{DQuat, DVec2, DVec3};
use warplight_protocol::ImageSize;
use warplight_protocol::frame::FrameFormat;

const SIZE: ImageSize = ImageSize::new(1024, 1024);

fn camera() -> Camera {
    Camera::symmetric(std::f32::consts::FRAC_PI_2, SIZE)
}

/// The tree as the client gets it.
pub(super) fn through_the_wire(tree: Tree) -> Tree {
    through_the_wire_as(FrameFormat::exact(), tree)
}

fn through_the_wire_as(format: FrameFormat, tree: Tree) -> Tree {
    crate::analytic::through_the_wire(tree, format).unwrap().tree
}

/// Median, 95th percentile, fractions above a degree and undefined, in degrees and percent.
#[derive(Debug)]
struct Errors {
    count: usize,
    median: f64,
    p95: f64,
    above_a_degree: f64,
    undefined: f64,
}

fn errors_of(solid: Solid, aside: DVec3, turn: DQuat, format: FrameFormat, solver: Solver) -> Errors {
    let old = solid.eye();
    let display = Pose { position: old.position + old.orientation * aside, orientation: old.orientation * turn };
    let tree = through_the_wire_as(format, solid.tree(&camera(), &old));
    let mut prepared = Prepared::default();
    prepared.solver = solver;
    prepared.prepare(Level::default(), &tree);
    let flows = Specular::default().flows(Level::default(), &prepared, &display, &camera());
    let errors = Truth::new(solid, &camera(), &old, &display).errors_of(flows.last().unwrap());
    Errors {
        count: errors.count(),
        median: errors.median_deg(),
        p95: errors.p95_deg(),
        above_a_degree: errors.above_a_degree() * 100.0,
        undefined: errors.undefined() * 100.0,
    }
}

/// Over one move, by every rung of the ladder.
fn print_ladder(solid: Solid) -> Vec<(Solver, Errors)> {
    let rungs = [
        Solver::default(),
        Solver::ImageDistance,
        Solver::GaussNewton { steps: 3 },
        Solver::Descent { steps: 10 },
        Solver::Descent { steps: 32 },
        Solver::Unfolded,
    ];
    let of = |solver| {
        let errors = errors_of(solid, DVec3::X * 0.05, DQuat::IDENTITY, FrameFormat::exact(), solver);
        println!(
            "| {solid:?}, {solver:?} | {:.4} | {:.4} | {:.2} | {:.2} |",
            errors.median, errors.p95, errors.above_a_degree, errors.undefined
        );
        (solver, errors)
    };
    rungs.map(of).into()
}

#[test]
fn on_a_mirror_all_rungs_agree_and_on_a_ball_the_unfolded_depth_is_wrong() {
    for (solver, errors) in print_ladder(Solid::TiltedMirror) {
        assert!(errors.median < 0.02, "{solver:?} {errors:?}");
    }
    for (solver, errors) in print_ladder(Solid::ChromeBall) {
        assert_eq!(errors.median < 0.1, solver != Solver::Unfolded, "{solver:?} {errors:?}");
    }
    print_ladder(Solid::Water);
    print_ladder(Solid::GlassBall);
}

/// Over moves along and across the view with a small turn, the worst of each figure.
fn worst_errors(solid: Solid) -> Errors {
    worst_errors_in(solid, FrameFormat::exact())
}

fn worst_errors_in(solid: Solid, format: FrameFormat) -> Errors {
    let moves = [(DVec3::X, 0.02), (-DVec3::Y, -0.01), (-DVec3::Z, 0.0), (DVec3::new(-0.6, 0.5, 0.6), 0.03)];
    let runs = moves.map(|(aside, yaw)| {
        errors_of(solid, aside.normalize() * 0.05, DQuat::from_rotation_y(yaw), format, Solver::default())
    });
    let worst = runs.into_iter().reduce(|a, b| Errors {
        count: a.count + b.count,
        median: a.median.max(b.median),
        p95: a.p95.max(b.p95),
        above_a_degree: a.above_a_degree.max(b.above_a_degree),
        undefined: a.undefined.max(b.undefined),
    });
    let worst = worst.unwrap();
    println!(
        "| {solid:?}{} | {} | {:.4} | {:.4} | {:.2} | {:.2} |",
        if format.shape_bits == 0 { ", shapes of differences" } else { "" },
        worst.count,
        worst.median,
        worst.p95,
        worst.above_a_degree,
        worst.undefined
    );
    worst
}

#[test]
fn a_tilted_mirror_shows_the_mirrored_scene() {
    let errors = worst_errors(Solid::TiltedMirror);
    assert!(errors.median < 0.005 && errors.undefined < 3.0, "{errors:?}");
}

#[test]
fn a_chrome_ball_reflects_where_alhazen_says() {
    let errors = worst_errors(Solid::ChromeBall);
    assert!(errors.median < 0.05 && errors.p95 < 0.15 && errors.undefined < 3.0, "{errors:?}");
}

#[test]
fn water_refracts_along_fermats_path() {
    let errors = worst_errors(Solid::Water);
    assert!(errors.median < 0.005 && errors.p95 < 0.05 && errors.undefined < 3.0, "{errors:?}");
}

#[test]
fn a_glass_ball_shows_what_two_refractions_do() {
    let errors = worst_errors(Solid::GlassBall);
    assert!(errors.median < 0.02 && errors.p95 < 0.2 && errors.undefined < 3.0, "{errors:?}");
    // The rung below: without the server's shapes, those of the picture's own differences.
    let differences = worst_errors_in(Solid::GlassBall, FrameFormat { shape_bits: 0, ..FrameFormat::exact() });
    assert!(differences.median < 0.1 && differences.p95 < 0.3 && differences.undefined < 3.0, "{differences:?}");
    assert!(
        errors.median < 0.75 * differences.median && errors.p95 < 0.75 * differences.p95,
        "{errors:?} {differences:?}"
    );
}

#[test]
fn a_slab_displaces_what_is_behind_it_by_its_formula() {
    let (thickness, index) = (0.3, 1.5_f64);
    // The truth first: along the normal, the way through the slab ends off the straight one by t (1 - c / root).
    let solid = Solid::Slab(thickness);
    for pixel in [DVec2::new(512.0, 512.0), DVec2::new(100.0, 700.0), DVec2::new(900.0, 90.0)] {
        let Some((_, chain)) = solid.chain_at(&camera(), &solid.eye(), pixel) else { continue };
        let [entry, exit] = chain[..] else { panic!("two bounces") };
        let cosine = -exit.direction.dot(entry.normal);
        let along = |direction: DVec3| (entry.at - exit.at).dot(entry.normal) / -direction.dot(entry.normal);
        // The straight ray through the entry meets the exit plane elsewhere; seen along it, what is behind is nearer.
        let straight = entry.at + exit.direction * along(exit.direction);
        let aside = (straight - exit.at).length();
        let offset = aside / (1.0 - cosine * cosine).sqrt() * cosine;
        let expected = thickness * (1.0 - cosine / (index * index - 1.0 + cosine * cosine).sqrt());
        assert!((offset - expected).abs() < 1e-9, "{offset} {expected}");
    }
    let errors = worst_errors(solid);
    assert!(errors.median < 0.01 && errors.p95 < 0.1 && errors.undefined < 3.0, "{errors:?}");
}

#[test]
fn every_level_finds_the_same_places() {
    for solid in [Solid::ChromeBall, Solid::GlassBall] {
        let tree = through_the_wire(solid.tree(&camera(), &solid.eye()));
        let display = Pose { position: DVec3::new(0.03, -0.02, 0.01), ..solid.eye() };
        let flows = |level| {
            let mut prepared = Prepared::default();
            prepared.prepare(level, &tree);
            Specular::default().flows(level, &prepared, &display, &camera())
        };
        let plain = flows(Level::Portable);
        for level in Level::available() {
            for (node, (a, b)) in plain.iter().zip(flows(level)).enumerate() {
                // Decisions at a threshold may fall either way; where both found something it is the same.
                let differently = a.iter().zip(&b).filter(|(a, b)| a.is_nan() != b.is_nan()).count();
                let both = || a.iter().zip(&b).filter(|(a, b)| !a.is_nan() && !b.is_nan());
                // A tile is interpolated or solved for by such a decision, too: either is within 0.04 px.
                let apart = both().filter(|(a, b)| (**a - **b).abs().max_element() > 0.05).count();
                // The exit surface of the ball folds in the old picture: rounding decides which side of a fold is found.
                let folds = matches!(solid, Solid::GlassBall) && node == 2;
                let few = both().count() / if folds { 100 } else { 500 };
                assert!(
                    differently <= few && apart <= few,
                    "{level:?} {solid:?} {node}: {differently} {apart} of {few}"
                );
            }
        }
    }
}

#[test]
fn a_ball_warped_to_where_it_was_rendered_from_is_the_servers_image() {
    let tree = {
        let mut tree = Solid::GlassBall.tree(&camera(), &Pose::IDENTITY);
        for pixel in 0..SIZE.pixels() {
            let at = SIZE.pixel_centre(pixel) * 0.02;
            let radiance = Vec3::new(0.5 + 0.4 * at.x.sin(), 0.5 + 0.3 * at.y.cos(), 0.4);
            tree.nodes.iter_mut().for_each(|node| node.set_radiance(pixel, radiance));
        }
        through_the_wire(tree)
    };
    // So little that nothing moves, and so much that the shortcut for an unmoved head is not taken.
    let display = Pose { position: DVec3::X * 1e-9, ..Pose::IDENTITY };
    let mut warper = Warper::default();
    warper.prepare(Mode::Specular, &tree);
    let (mut picture, mut expected) = (RgbImage::default(), RgbImage::default());
    warper.show(Mode::Specular, &tree, &Pose::IDENTITY, &camera(), 1.0, &mut expected);
    let statistics = warper.show(Mode::Specular, &tree, &display, &camera(), 1.0, &mut picture);
    let off = |by: u8| {
        let off = picture.iter().zip(expected.iter()).filter(|(a, b)| a.abs_diff(**b) > by).count();
        off as f64 / expected.len() as f64
    };
    println!("off by more than 1: {:.5}, 2: {:.5}, 8: {:.5}; {:?}", off(1), off(2), off(8), &statistics.nodes[..4]);
    assert!(off(1) < 0.01 && off(8) < 0.001, "{} {}", off(1), off(8));
}
