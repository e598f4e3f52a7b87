//! A frame that another warper took in: decoded elsewhere while this one made pictures.
//!
//! Taking in a frame takes as long as a picture or longer ([`Warper::prepare`]); on the thread of the display a refresh
//! would wait for it. So a second warper takes the frame in, and the two exchange what that made of it: pointers, no
//! planes. Both keep the memory of the frame before, so nothing is allocated after the second frame.

use super::frames::Frames;
use super::{Mode, Solver, Warper};

impl Warper {
    /// Takes over the frame that `other` took in last for `mode`; what it gives in return is memory only. Earlier frames
    /// stay with this one.
    pub fn adopt(&mut self, mode: Mode, other: &mut Warper) {
        let earlier = self.earlier_frames;
        match mode {
            Mode::None | Mode::Rotation | Mode::Mesh | Mode::Planar => {
                std::mem::swap(&mut self.source, &mut other.source);
                std::mem::swap(&mut self.mean_inverse_depth, &mut other.mean_inverse_depth);
            }
            Mode::Diffuse => self.painted.adopt(&mut other.painted, earlier),
            Mode::Specular | Mode::Slabs | Mode::MeanDepth => {
                self.layered.adopt(&mut other.layered, earlier);
                std::mem::swap(&mut self.marcher, &mut other.marcher);
            }
        }
    }

    /// Chooses how mode `specular` searches the pictures of children, from the next picture on: of those solvers that
    /// frames are taken in alike for, which are all steps of one.
    pub(crate) fn use_solver(&mut self, solver: Solver) {
        self.rung.solver = solver;
        let of = |frames: &mut Frames| frames.prepared_mut().for_each(|frame| frame.solver = solver);
        of(&mut self.layered);
        of(&mut self.painted);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analytic::AnalyticScene;
    use glam::DVec3;
    use image::RgbImage;
    use warplight_protocol::frame::Tree;
    use warplight_protocol::{Camera, ImageSize, Pose};

    fn frames(camera: &Camera) -> (Vec<Tree>, Pose) {
        let scene = AnalyticScene::SWEPT[1];
        let eye = scene.eye();
        let moved = |x: f64| Pose { position: eye.position + DVec3::X * x, ..eye };
        ([0.0, 0.01, 0.02].map(|x| scene.tree(camera, &moved(x))).into(), moved(0.05))
    }

    #[test]
    fn an_adopted_frame_gives_the_picture_of_one_taken_in_and_earlier_ones_are_kept() {
        let camera = Camera::symmetric(1.2, ImageSize::new(96, 80));
        let (trees, display_pose) = frames(&camera);
        for mode in Mode::ALL {
            for earlier in [0, 2] {
                let (mut own, mut display, mut spare) = (Warper::default(), Warper::default(), Warper::default());
                own.set_earlier_frames(earlier);
                display.set_earlier_frames(earlier);
                let (mut expected, mut found) = (RgbImage::default(), RgbImage::default());
                for tree in &trees {
                    own.prepare(mode, tree);
                    own.show(mode, tree, &display_pose, &camera, 1.0, &mut expected);
                    spare.prepare(mode, tree);
                    display.adopt(mode, &mut spare);
                    display.show(mode, tree, &display_pose, &camera, 1.0, &mut found);
                    assert!(expected == found, "{} with {earlier} earlier frames", mode.name());
                }
            }
        }
    }

    #[test]
    fn a_solver_that_is_used_at_once_gives_the_picture_of_one_chosen_before() {
        let camera = Camera::symmetric(1.2, ImageSize::new(96, 80));
        let (trees, display_pose) = frames(&camera);
        let (mut expected, mut found) = (RgbImage::default(), RgbImage::default());
        let mut at_once = Warper::default();
        at_once.prepare(Mode::Specular, &trees[0]);
        for steps in [None, Some(1), Some(4)] {
            let solver = Solver::FrozenDistance { steps };
            let mut before = Warper::default();
            before.set_solver(solver);
            before.prepare(Mode::Specular, &trees[0]);
            before.show(Mode::Specular, &trees[0], &display_pose, &camera, 1.0, &mut expected);
            at_once.use_solver(solver);
            at_once.show(Mode::Specular, &trees[0], &display_pose, &camera, 1.0, &mut found);
            assert!(expected == found, "{solver}");
        }
    }
}
