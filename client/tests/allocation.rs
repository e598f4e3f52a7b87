//! Frames that arrive and pictures that are shown take no memory after the first ones.

use glam::{DQuat, DVec3, Vec3};
use image::RgbImage;
use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering};
use warplight_client::warp::{Mode, Warper};
use warplight_protocol::frame::{Interfaces, Plan, Tree};
use warplight_protocol::optics::Interface;
use warplight_protocol::{Camera, ImageSize, Pose};

static ALLOCATIONS: AtomicUsize = AtomicUsize::new(0);

struct Counting;

// SAFETY: every call is passed on to the system's allocator.
#[allow(unsafe_code, reason = "an allocator is unsafe to implement")]
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
        // SAFETY: the caller's promise.
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller's promise.
        unsafe { System.dealloc(pointer, layout) }
    }
    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
        // SAFETY: the caller's promise.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static COUNTING: Counting = Counting;

/// A plane of glass before a wall.
fn tree() -> Tree {
    let camera = Camera::symmetric(1.0, ImageSize::new(200, 120));
    let interfaces = Interfaces(vec![Interface::Dielectric { eta: 1.5 }, Interface::Dielectric { eta: 1.0 / 1.5 }]);
    let mut tree = Tree::new(Pose::IDENTITY, camera, Plan::solid(), interfaces);
    for pixel in 0..camera.size.pixels() {
        let length = camera.ray_in_view(camera.size.pixel_centre(pixel)).length();
        let is_glass = pixel % 200 > 60;
        for (node, depth) in [(0, if is_glass { 1.0 } else { 3.0 }), (1, 2.0), (2, 0.1), (3, 2.0)] {
            tree.nodes[node].distance[pixel] = if is_glass || node == 0 { depth * length } else { 0.0 };
            tree.nodes[node].set_radiance(pixel, Vec3::splat(0.3));
        }
        for (node, interface) in [(0, 1), (2, 2)] {
            tree.nodes[node].interface[pixel] = if is_glass { interface } else { 0 };
            tree.nodes[node].set_normal(pixel, Vec3::Z);
        }
    }
    tree
}

#[test]
fn nothing_is_allocated_after_the_first_frame() {
    let tree = tree();
    // On a thread of the pool: entering it from outside queues a job, for which rayon allocates now and then.
    rayon::scope(|_| {
        let mut warper = Warper::default();
        let mut picture = RgbImage::default();
        let mut frame = |number: u32| {
            let aside = f64::from(number) * 0.01;
            let display_pose = Pose {
                position: DVec3::new(aside, -0.5 * aside, 0.3 * aside),
                orientation: DQuat::from_rotation_y(aside),
            };
            warper.prepare(Mode::Specular, &tree);
            let statistics = warper.show(Mode::Specular, &tree, &display_pose, &tree.camera, 1.0, &mut picture);
            assert!(statistics.hole_fraction > 0.0 || number == 0);
        };
        (0..3).for_each(&mut frame);
        let before = ALLOCATIONS.load(Ordering::Relaxed);
        (3..40).for_each(&mut frame);
        assert_eq!(ALLOCATIONS.load(Ordering::Relaxed) - before, 0);
    });
}
