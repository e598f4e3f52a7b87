//! What was seen at the same surface point before, and how much of it still counts.
//!
//! First step of the filter. Reprojection is by the place where the light of a node seems to be: a point on the pixel's
//! ray at the length of the whole way. It is exact for surfaces that are seen directly and in plane mirrors; elsewhere
//! the tests of surface and normal, and the scatter of the neighbours, reject what does not fit (Schied et al. 2017,
//! section 4.1). A lobe that is looked at from another direction reflects something else: history counts no more
//! frames than the head needs to turn a reflection by a part of the lobe.

use super::change::Tile;
use super::{LOBE_PART, Points, Sample, each_point};
use crate::cache::luminance;
use glam::{Vec2, Vec3, Vec4};

/// Frames that a mean runs over at most: 1.6 s at ten frames a second. More are smoother and later where light changes
/// by less than is noticed.
const MAX_FRAMES: f32 = 16.0;
/// A sample is cut down to so many standard deviations above its neighbours' mean; the bias is what lies above.
const FIREFLY_SIGMAS: f32 = 6.0;
/// History is drawn to within so many standard deviations of the neighbours' mean. Fewer lose light where few samples
/// are bright: 2 percent at 3, 3 percent at 1.5 (the table of materials under its lamp and the sky).
const HISTORY_SIGMAS: f32 = 4.0;
/// In a frame in which light has changed somewhere, where late is worse than dark for a moment.
const CHANGED_SIGMAS: f32 = 1.0;
/// Frames that then count at most of a point that has too few neighbours to tell.
const CHANGED_FRAMES: f32 = 0.5;
/// Neighbours that say something about scatter.
const ENOUGH_NEIGHBOURS: f32 = 4.0;
/// Frames from which on a point's own scatter is taken for its variance.
const OWN_FRAMES: f32 = 4.0;
/// The nearest twelve: two pixels across and aside.
const NEIGHBOURS: [(i32, i32); 12] =
    [(-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (1, -1), (-1, 1), (1, 1), (-2, 0), (2, 0), (0, -2), (0, 2)];

/// The mean of a point over its frames.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct History {
    light: Vec3,
    /// Mean squared luminance.
    square: f32,
    frames: f32,
}

impl History {
    pub(super) fn luminance(&self) -> f32 {
        luminance(self.light)
    }

    /// Frames that it is the mean of.
    pub(super) fn frames(&self) -> f32 {
        self.frames
    }
}

/// Frames of a history that still count after light has changed: at a position, at the end of a way of some length, of
/// so many.
pub(super) type Kept<'a> = dyn Fn(Vec3, f32, f32) -> f32 + Sync + 'a;

/// A point's sample and its history, before they are mixed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reprojected {
    pub(super) sample: Vec3,
    /// Variance of a sample's luminance among neighbours.
    variance: f32,
    pub(super) history: History,
}

/// Finds the history of all points, and cuts samples and history down to what their neighbours bear. `kept` where light
/// has changed.
pub(super) fn reproject(
    now: &Points,
    before: &Points,
    samples: &[Sample],
    kept: Option<&Kept<'_>>,
    into: &mut Vec<Reprojected>,
) {
    each_point(now.len(), into, |point| {
        let (site, guide) = (now.sites[point], &now.guides[point]);
        let mut history = found(now, before, point, &samples[point]).unwrap_or_default();
        if let Some(kept) = kept {
            history.frames = kept(guide.position, samples[point].path_m, history.frames);
        }
        let (mut count, mut sum, mut squares) = (0.0, Vec4::ZERO, Vec4::ZERO);
        for (columns, rows) in NEIGHBOURS {
            let Some(other) = now.beside(site, columns, rows) else { continue };
            if now.guides[other].material != guide.material || now.guides[other].normal.dot(guide.normal) < 0.9 {
                continue;
            }
            let light = samples[other].light;
            count += 1.0;
            sum += light;
            squares += light * light;
        }
        let mut sample = samples[point].light.truncate();
        let mut variance = 0.0;
        if count >= ENOUGH_NEIGHBOURS {
            let scatter = |squares: Vec4, mean: Vec4| (squares - mean * mean).max(Vec4::ZERO);
            let mean = sum / count;
            // Where a few neighbours have seen nothing, that is not yet known to be rare.
            let sigma = scatter(squares / count, mean).w.sqrt().max(mean.w);
            let most = (mean.w + FIREFLY_SIGMAS * sigma).max(FIREFLY_SIGMAS * luminance(history.light));
            let light = luminance(sample);
            if light > most {
                sample *= most / light;
            }
            let own = with_luminance(sample);
            (count, sum, squares) = (count + 1.0, sum + own, squares + own * own);
            let mean = sum / count;
            let variances = scatter(squares / count, mean);
            variance = variances.w * count / (count - 1.0);
            let sigmas = if kept.is_some() { CHANGED_SIGMAS } else { HISTORY_SIGMAS };
            let within = sigmas * Vec4::from_array(variances.to_array().map(f32::sqrt)).truncate();
            let drawn = history.light.clamp(mean.truncate() - within, mean.truncate() + within);
            let moved = (drawn - history.light).abs().max_element();
            let before = history.light.max_element();
            if moved > 0.0 {
                history.frames *= (1.0 - moved / (before + moved)).max(0.0);
                // Its scatter about the new mean is what is seen now.
                let light = luminance(drawn);
                history.square = variance + light * light;
                history.light = drawn;
            }
        } else if kept.is_some() {
            history.frames = history.frames.min(CHANGED_FRAMES);
        }
        Reprojected { sample, variance, history }
    });
}

/// The history of a point, if it was seen.
fn found(now: &Points, before: &Points, point: usize, sample: &Sample) -> Option<History> {
    let (eye, old_eye) = (now.eye.as_ref()?, before.eye.as_ref()?);
    let (site, guide) = (now.sites[point], &now.guides[point]);
    let pixel = usize::from(site.row) * now.size.width as usize + usize::from(site.column);
    let seen = eye.ray_through_centre(pixel).at(sample.path_m);
    let from_old = seen - old_eye.position;
    let at = old_eye.camera.pixel_from_view(old_eye.view_from_world(from_old))? - Vec2::splat(0.5);
    let (left, top, part) = (at.x.floor(), at.y.floor(), at - at.floor());
    let (mut weights, mut sum) = (0.0, History::default());
    for (right, below) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
        let weight =
            (if right == 1 { part.x } else { 1.0 - part.x }) * (if below == 1 { part.y } else { 1.0 - part.y });
        if weight < 1e-3 {
            continue;
        }
        let Some(other) = before.at(site.node, left as i32 + right, top as i32 + below) else { continue };
        if !guide.is_beside(&before.guides[other]) {
            continue;
        }
        let old = &before.history[other];
        weights += weight;
        sum.light += weight * old.light;
        sum.square += weight * old.square;
        sum.frames += weight * old.frames;
    }
    if weights < 1e-2 {
        return None;
    }
    let turned_rad = from_old.angle_between(seen - eye.position);
    let frames = (LOBE_PART * sample.alpha / turned_rad.max(1e-6)).max(1.0);
    Some(History {
        light: sum.light / weights,
        square: sum.square / weights,
        frames: (sum.frames / weights).min(frames).min(MAX_FRAMES - 1.0),
    })
}

/// Mixes each sample into its history, as far as that still counts, and gives the means with their variance.
pub(super) fn accumulate(now: &mut Points, reprojected: &[Reprojected], tiles: &[Tile], light: &mut Vec<Vec4>) {
    let mut history = std::mem::take(&mut now.history);
    each_point(now.len(), &mut history, |point| {
        let Reprojected { sample, history, .. } = &reprojected[point];
        let frames = Tile::at(tiles, now.size, now.sites[point]).kept(history.frames) + 1.0;
        let part = 1.0 / frames;
        let seen = luminance(*sample);
        History {
            light: history.light + part * (*sample - history.light),
            square: history.square + part * (seen * seen - history.square),
            frames,
        }
    });
    each_point(now.len(), light, |point| {
        let History { light, square, frames } = history[point];
        let mean = luminance(light);
        let own = (square - mean * mean).max(0.0);
        let variance = if frames >= OWN_FRAMES { own } else { own.max(reprojected[point].variance) };
        light.extend(variance / frames)
    });
    now.history = history;
}

pub(super) fn with_luminance(light: Vec3) -> Vec4 {
    light.extend(luminance(light))
}
