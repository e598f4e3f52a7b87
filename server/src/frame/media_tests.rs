//! Ray trees in scenes with media: what the root does not show of them, and what its children do.

use super::*;
use crate::march::MediaBounds;
use crate::scene::{Environment, Material, Scene, Surface};
use crate::testing::{SceneBuilder, diffuse, emitter, mirror};
use crate::volume::{Matter, Medium, Phase};
use warplight_protocol::ImageSize;
use warplight_protocol::frame::Layering;

fn null(interior: u32) -> Material {
    Material { interior: Some(interior), ..Material::new("boundary", Surface::Null) }
}

fn absorbing(extinction_per_m: Vec3, albedo: f32) -> Medium {
    let matter = Matter::Homogeneous { extinction_per_m, albedo: Vec3::splat(albedo), emission: Vec3::ZERO };
    Medium { matter, phase: Phase::ISOTROPIC }
}

/// The frame of an eye at the origin that looks along -Z, with layers of volume.
fn frame(scene: Scene, spp: u32) -> Tree {
    let format = VolumeFormat { layers: 2, ..VolumeFormat::default() };
    let range = MediaBounds::of(&scene).range(&Pose::IDENTITY);
    frame_with(scene, spp, Some(LayersRequest { format, range, exactly: false }))
}

fn frame_with(scene: Scene, spp: u32, volume: Option<LayersRequest>) -> Tree {
    let plan = crate::effects::plan_of(&scene);
    let renderer = FrameRenderer::new(Arc::new(scene));
    let camera = Camera::symmetric(0.2, ImageSize::new(8, 8));
    let mut tree = Tree::new(Pose::IDENTITY, camera, plan.clone(), Interfaces::default());
    let request = FrameRequest { render_pose: Pose::IDENTITY, camera, plan, volume, spp, max_depth: 64, seed: 3 };
    renderer.render(&request, &mut tree, &Counters::default(), &|_| {});
    tree
}

fn middle(tree: &Tree, node: usize) -> Vec3 {
    let pixel = 8 * 4 + 4;
    Vec3::from(tree.nodes[node].radiance.each_ref().map(|plane| plane[pixel]))
}

#[test]
fn the_root_shows_the_surface_behind_a_medium_as_if_there_were_none() {
    let lamp = |height: f32| {
        let corner = |x: f32, y: f32| Vec3::new(x, y, height);
        [corner(-5.0, -5.0), corner(5.0, -5.0), corner(5.0, 5.0), corner(-5.0, 5.0)]
    };
    for eye_inside in [false, true] {
        let centre = if eye_inside { Vec3::ZERO } else { Vec3::NEG_Z * 3.0 };
        let mut scene =
            SceneBuilder::new().cube(centre, 2.0, null(0)).quad(lamp(-6.0), emitter(Vec3::new(1.0, 2.0, 3.0))).build();
        scene.media = vec![absorbing(Vec3::splat(5.0), 0.0)];
        let tree = frame(scene, 4);
        assert_eq!(middle(&tree, 0), Vec3::new(1.0, 2.0, 3.0), "eye inside: {eye_inside}");
        assert!((tree.nodes[0].distance[8 * 4 + 4] - 6.0).abs() < 0.01);
        assert_eq!(tree.plan.nodes().len(), 1, "a boundary of a medium calls for no node");
    }
}

/// Beer-Lambert: 2 m of an extinction of 0.5 lie before the lamp.
#[test]
fn without_layers_the_root_shows_its_surface_through_the_medium() {
    let corner = |x: f32, y: f32| Vec3::new(x, y, -6.0);
    let quad = [corner(-5.0, -5.0), corner(5.0, -5.0), corner(5.0, 5.0), corner(-5.0, 5.0)];
    let mut scene = SceneBuilder::new().cube(Vec3::NEG_Z * 3.0, 2.0, null(0)).quad(quad, emitter(Vec3::ONE)).build();
    scene.media = vec![absorbing(Vec3::splat(0.5), 0.0)];
    let tree = frame_with(scene, 4, None);
    let thickness = 2.0 * tree.camera.ray_in_view(tree.camera.size.pixel_centre(8 * 4 + 4)).length();
    let exact = (-0.5 * thickness).exp();
    assert!((middle(&tree, 0) - exact).abs().max_element() < 1e-4, "{} {exact}", middle(&tree, 0));
}

/// A mirror shows a bright sky through fog that lies behind the eye.
#[test]
fn a_reflection_shows_the_media_on_its_way() {
    let mirror_at = |z: f32| {
        let corner = |x: f32, y: f32| Vec3::new(x, y, z);
        [corner(-5.0, -5.0), corner(5.0, -5.0), corner(5.0, 5.0), corner(-5.0, 5.0)]
    };
    let scene = |albedo: f32| {
        let mut scene = SceneBuilder::new()
            .environment(Environment::Constant(Vec3::ONE))
            .quad(mirror_at(-2.0), mirror())
            .cube(Vec3::Z * 6.0, 4.0, null(0))
            .build();
        scene.media = vec![absorbing(Vec3::new(0.0, 0.25, 1.0), albedo)];
        scene
    };
    let tree = frame(scene(0.0), 4);
    let expected = Vec3::new(1.0, (-1.0_f32).exp(), (-4.0_f32).exp());
    // Rays are a hundredth of a radian off the axis.
    assert!((middle(&tree, 1) - expected).abs().max_element() < 1e-3, "{}", middle(&tree, 1));
    // What does not absorb is not there in white light: transmittance and what is scattered add up.
    // A sample of a channel is up to 3, its scatter about 1: 0.004 over 64 pixels of 1024.
    let tree = frame(scene(1.0), 1024);
    let planes = tree.nodes[1].radiance.each_ref();
    let mean = Vec3::from(planes.map(|plane| plane.iter().sum::<f32>() / 64.0));
    assert!((mean - 1.0).abs().max_element() < 0.018, "{mean}");
}

/// The renderer of a session in whose scene things move: its first frame must not be dark.
#[test]
fn a_copy_sees_the_light_that_is_there() {
    let mut scene =
        SceneBuilder::new().environment(Environment::Constant(Vec3::ONE)).cube(Vec3::NEG_Z * 3.0, 2.0, null(0)).build();
    scene.media = vec![absorbing(Vec3::splat(0.7), 0.9)];
    let renderer = FrameRenderer::new(Arc::new(scene));
    let camera = Camera::symmetric(0.3, ImageSize::new(4, 4));
    let dark = renderer.media_picture(&Pose::IDENTITY, camera);
    renderer.refine_all_light(1, 4, 5);
    let lit = renderer.media_picture(&Pose::IDENTITY, camera);
    assert!(dark.iter().zip(&lit).all(|(dark, lit)| dark.x == 0.0 && lit.x > 0.1));
    assert_eq!(renderer.copy().media_picture(&Pose::IDENTITY, camera), lit);
}

/// Two media behind each other and a wall in the second, seen from before, and from inside of the first.
#[test]
fn layers_of_a_frame_do_together_what_the_march_says() {
    let corner = |x: f32, y: f32| Vec3::new(x, y, -7.0 + 0.3 * x);
    let wall = [corner(-0.5, -5.0), corner(5.0, -5.0), corner(5.0, 5.0), corner(-0.5, 5.0)];
    for eye_z in [0.0, -2.5] {
        let mut scene = SceneBuilder::new()
            .environment(Environment::Constant(Vec3::ONE))
            .cube(Vec3::NEG_Z * 3.0, 2.0, null(0))
            .cube(Vec3::NEG_Z * 7.0, 2.5, null(1))
            .quad(wall, diffuse(0.5))
            .build();
        scene.media = vec![absorbing(Vec3::splat(0.7), 0.9), absorbing(Vec3::splat(2.0), 0.5)];
        let plan = crate::effects::plan_of(&scene);
        let renderer = FrameRenderer::new(Arc::new(scene));
        renderer.refine_all_light(2, 8, 5);
        let camera = Camera::symmetric(0.3, ImageSize::new(16, 16));
        let pose = Pose { position: glam::DVec3::Z * eye_z, ..Pose::IDENTITY };
        let range = crate::march::MediaBounds::of(renderer.scene()).range(&pose);
        let picture = renderer.media_picture(&pose, camera);
        let (mut behind_the_wall, mut before_the_sky) = (0, 0);
        for (layering, exactly) in
            Layering::ALL.map(|layering| (layering, false)).into_iter().chain([(Layering::Optimal, true)])
        {
            for layers in [1, 2, 4, 8] {
                let format = VolumeFormat { layers, layering, ..VolumeFormat::NONE };
                let volume = Some(LayersRequest { format, range, exactly });
                let mut tree = Tree::new(pose, camera, plan.clone(), Interfaces::default());
                let request = FrameRequest {
                    render_pose: pose,
                    camera,
                    plan: plan.clone(),
                    volume,
                    spp: 1,
                    max_depth: 2,
                    seed: 3,
                };
                renderer.render(&request, &mut tree, &Counters::default(), &|_| {});
                assert_eq!(tree.layers.len(), usize::from(layers));
                for (pixel, expected) in picture.iter().enumerate() {
                    let (mut radiance, mut left) = (Vec3::ZERO, 1.0);
                    for segment in tree.layers.iter().filter_map(|layer| layer.at(pixel)) {
                        radiance += left * segment.opacity() * segment.source;
                        left *= 1.0 - segment.opacity();
                        let root_m = tree.nodes[0].distance[pixel];
                        // Depths in view are below distances.
                        assert!(segment.back_m <= root_m * 1.000_01 && segment.front_m >= 0.0, "{segment:?} {root_m}");
                    }
                    let difference = (radiance.extend(left) - *expected).abs().max_element();
                    assert!(difference <= 1e-5, "{} {layers} {pixel}: {radiance} {left} {expected}", layering.name());
                    let way = |metres: f32| (-metres).exp();
                    // What is left, in closed form: rays are within 0.15 rad of the axis.
                    let first = 0.7 * if eye_z < -2.0 { 1.5 } else { 2.0 };
                    if tree.nodes[0].distance[pixel].is_finite() {
                        behind_the_wall += 1;
                        assert!(expected.w < way(first + 2.0 * 0.9) && expected.w > way(1.03 * (first + 2.0 * 1.6)));
                    } else {
                        before_the_sky += 1;
                        assert!(expected.w <= way(first + 5.0) * 1.0001 && expected.w > way(1.03 * (first + 5.0)));
                    }
                }
            }
        }
        assert!(behind_the_wall > 0 && before_the_sky > 0, "both are seen");
    }
}
