//! Every effect switched off in every scene: one that the scene does not call for changes no byte of a frame, one that it
//! does changes the picture.
//!
//! Pictures are small and noisy, so a change counts where it is above noise: FLIP between the scene with and without the
//! effect, rendered from the same seed, against FLIP between two seeds of the whole scene. An effect may show in a few pixels
//! only (dispersion at the rim of a prism), so the two are compared over the pixels that differ most, which another seed has
//! found. What is not above noise at first is rendered again with
//! more samples, and then by the scene's other cameras, which stand nearer to its things.

use glam::DVec3;
use image::RgbImage;
use warplight_client::loopback::Loopback;
use warplight_client::measure::{PIXELS_PER_DEGREE, flip};
use warplight_protocol::codec::FrameShape;
use warplight_protocol::frame::{FrameFormat, Interfaces, Tree, VolumeFormat, VolumeRange, flatten};
use warplight_protocol::tone::display_from_radiance;
use warplight_protocol::{Camera, ImageSize, Pose};
use warplight_server::counters::Counters;
use warplight_server::effects::{EffectKind, Effects, Simulated, plan_of, without};
use warplight_server::frame::{BAND_ROWS, FrameRenderer, FrameRequest, LayersRequest};
use warplight_server::march::MediaBounds;
use warplight_server::scene::{NamedCamera, Scene};

const SIDE_PX: u32 = 48;
/// Samples per pixel where pictures are compared.
const SPP: u32 = 32;
const MAX_DEPTH: u32 = 8;
/// Samples of the light in media.
const LIGHT_SAMPLES: usize = 16_384;
/// A change is one where it is noticed so many times as much as noise: two independent noises of the same strength differ by
/// less, averaged over the pixels that count.
const ABOVE_NOISE: f64 = 1.5;
/// FLIP that nobody notices, so that pictures without any noise do not divide by it.
const LEAST_NOISE: f64 = 1e-3;
/// Part of the pixels by which pictures are compared: those that differ most.
const MOST_DIFFERENT: f64 = 0.01;

/// A frame as it is sent, and its picture.
fn frame_of(scene: &Scene, simulated: Simulated, whole: &Scene, view: View, seed: u64) -> (Vec<u8>, RgbImage) {
    let View { pose, camera, spp } = view;
    let renderer = FrameRenderer::limited(std::sync::Arc::new(scene.clone()), simulated);
    let bounds = MediaBounds::of(scene);
    let format = if bounds.is_empty() { VolumeFormat::NONE } else { VolumeFormat::default() };
    let range = if bounds.is_empty() { VolumeRange::default() } else { bounds.range(&pose) };
    let plan = plan_of(whole);
    let request = FrameRequest {
        render_pose: pose,
        camera,
        plan: plan.clone(),
        volume: (!bounds.is_empty()).then_some(LayersRequest { format, range, exactly: false }),
        spp,
        max_depth: MAX_DEPTH,
        seed,
    };
    if !bounds.is_empty() {
        renderer.refine_light(LIGHT_SAMPLES, MAX_DEPTH, seed);
    }
    let mut tree = Tree::new(pose, camera, plan.clone(), Interfaces::default());
    renderer.render(&request, &mut tree, &Counters::default(), &|_| {});
    let mut radiance = vec![Default::default(); camera.size.pixels()];
    flatten(&tree, 0..camera.size.pixels(), &mut radiance);
    let codes = radiance.iter().flat_map(|&radiance| display_from_radiance(radiance, whole.exposure)).collect();
    let picture = RgbImage::from_raw(camera.size.width, camera.size.height, codes).unwrap();
    let shape = FrameShape {
        camera,
        plan,
        interfaces: renderer.interfaces().clone(),
        format: FrameFormat { volume: format, ..FrameFormat::default() },
        volume: range,
        strip_rows: BAND_ROWS as u16,
        exposure: whole.exposure,
    };
    (Loopback::default().encode(&mut tree, &shape).concatenated(), picture)
}

/// From where a scene is looked at, with how many samples per pixel: by its first camera, and if need be by the others, which
/// stand nearer to its things, and by the first again. Of `materials` there is a small view of the ball of dispersing glass
/// from very near, since its fringes are thin.
fn views_of(scene: &Scene) -> Vec<View> {
    // In media frames take longer, and what they do is loud.
    let spp = if MediaBounds::of(scene).is_empty() { SPP } else { SPP / 16 };
    let by = |camera: &NamedCamera, spp| {
        let size = ImageSize::new(SIDE_PX, SIDE_PX);
        View { pose: camera.pose, camera: Camera::symmetric(camera.vertical_fov_rad, size), spp }
    };
    let mut views = vec![by(&scene.cameras[0], spp)];
    if scene.name == "materials" {
        let ball = DVec3::new(0.82, 0.861, -0.72);
        let pose = Pose::look_at(ball + DVec3::new(0.0, 0.12, 0.45), ball);
        views.push(View { pose, camera: Camera::symmetric(0.75, ImageSize::new(32, 32)), spp: 4 * spp });
    }
    views.extend(scene.cameras.iter().rev().map(|camera| by(camera, 8 * spp)));
    views
}

/// A view of a scene and its samples per pixel.
#[derive(Clone, Copy)]
struct View {
    pose: Pose,
    camera: Camera,
    spp: u32,
}

/// How much the eye notices at each pixel when two pictures alternate.
fn noticed(a: &RgbImage, b: &RgbImage) -> Vec<f32> {
    flip(a, b, PIXELS_PER_DEGREE).unwrap().values().to_vec()
}

/// The pixels with the largest values.
fn largest(values: &[f32]) -> Vec<usize> {
    let mut pixels: Vec<usize> = (0..values.len()).collect();
    pixels.sort_by(|&a, &b| values[b].total_cmp(&values[a]));
    pixels.truncate((values.len() as f64 * MOST_DIFFERENT).ceil() as usize);
    pixels
}

fn mean(values: &[f32], pixels: &[usize]) -> f64 {
    pixels.iter().map(|&pixel| f64::from(values[pixel])).sum::<f64>() / pixels.len() as f64
}

/// The whole scene from four seeds, and noise: what is noticed between two of them, and between the other two.
struct Whole {
    view: View,
    pictures: [RgbImage; 2],
    noise: [Vec<f32>; 2],
}

impl Whole {
    fn new(scene: &Scene, view: View) -> Whole {
        let of_seed = |seed| frame_of(scene, Simulated::ALL, scene, view, seed).1;
        let ([first, second], [third, fourth]) = ([1, 2].map(of_seed), [3, 4].map(of_seed));
        Whole { view, noise: [noticed(&first, &third), noticed(&second, &fourth)], pictures: [first, second] }
    }

    /// How much more the lack of an effect is noticed than noise, where it is noticed most.
    fn lack_of(&self, kind: EffectKind, scene: &Scene) -> f64 {
        let (rest, simulated) = without(scene, kind);
        let [first, second] = [1, 2].map(|seed| frame_of(&rest, simulated, scene, self.view, seed).1);
        // Where the effect shows is found with one seed, and what it does there is measured with another.
        let lack = noticed(&self.pictures[1], &second);
        let above_noise: Vec<f32> = lack.iter().zip(&self.noise[1]).map(|(lack, noise)| lack - noise).collect();
        let pixels = largest(&above_noise);
        // A sample in dispersing glass follows one colour: the scene's noise there is dispersion's own, and louder than its
        // fringes at any number of samples that there is time for. What it is held against is the noise of clear glass.
        let clear = (kind == EffectKind::Dispersion)
            .then(|| noticed(&first, &frame_of(&rest, simulated, scene, self.view, 3).1));
        let noise = clear.as_ref().unwrap_or(&self.noise[0]);
        mean(&noticed(&self.pictures[0], &first), &pixels) / mean(noise, &pixels).max(LEAST_NOISE)
    }
}

#[test]
fn an_effect_that_is_off_changes_no_byte_and_one_that_is_on_changes_the_picture() {
    for name in Scene::built_in_names() {
        let scene = Scene::load(name).unwrap();
        let effects = Effects::of(&scene);
        let once = View { spp: 1, ..views_of(&scene)[0] };
        let (bytes, _) = frame_of(&scene, Simulated::ALL, &scene, once, 1);
        let mut unseen: Vec<EffectKind> = Vec::new();
        for kind in EffectKind::ALL {
            if effects.has(kind) {
                unseen.push(kind);
                continue;
            }
            let (rest, simulated) = without(&scene, kind);
            assert!(frame_of(&rest, simulated, &scene, once, 1).0 == bytes, "{name} without {}", kind.name());
        }
        // Most show at once; what little the others do shows with less noise, or from nearer.
        let mut last = Vec::new();
        for view in views_of(&scene) {
            if !unseen.is_empty() {
                let whole = Whole::new(&scene, view);
                last = unseen.iter().map(|&kind| whole.lack_of(kind, &scene)).collect();
                let mut ratios = last.iter();
                unseen.retain(|_| ratios.next().is_some_and(|&ratio| ratio < ABOVE_NOISE));
                last.retain(|&ratio| ratio < ABOVE_NOISE);
            }
        }
        assert!(unseen.is_empty(), "{name}: {unseen:?} are called for, and {last:?} times noise");
    }
}
