//! Rate control: a target in bits per second becomes the quantiser of colour and the promise about depth, frame by frame.
//!
//! Part of the session: asked for the format of each live frame, told what it took. Between planes the bytes are spread by
//! what an error costs in the displayed picture ([`crate::stream`] coarsens the planes that are seen through weak
//! reflections); here it is decided how fine the plane is that matters most.
//!
//! The frame may have what the target leaves it since the last one, less a part of what earlier frames overdrew. From the
//! last frame's bytes the quantiser follows that would have met this: the bytes of H.264 halve with every 6 steps of it, as
//! its step doubles. With near-lossless colour a bit per sample is saved wherever the error doubles. Rising is fast and
//! falling slow, so that a target is kept on average and not only reached. Geometry has what colour leaves, and no less than
//! half: beyond that the promise about depth gives way, and comes back where there is room. Nothing is ever better than what
//! the client asked for; colour that must be exact stays exact, whatever the target it has set. Where the target is what the
//! link carries ([`super::adapt`]) it gives way too, as a bound on its error, and so do depths; but there is a floor under the
//! quality, beneath which fewer and smaller frames are better.
//!
//! Limits: the model of one frame ago; a cut to another view overdraws once. Cost: nothing measurable.

use std::time::Duration;
use warplight_protocol::Timestamp;
use warplight_protocol::frame::{ColorCoding, DepthBound, DepthFormat, FrameFormat};

/// Steps of the quantiser that halve H.264's bytes.
const STEPS_PER_HALF: f64 = 6.0;
/// Most steps up and down from one frame to the next.
const MOST_STEPS: (f64, f64) = (8.0, 2.0);
/// Part of what was overdrawn that the next frame pays back.
const PAYBACK: f64 = 0.25;
/// Part of a frame that geometry may have before its promise gives way.
const GEOMETRY_SHARE: f64 = 0.5;
/// How much of its coarseness depth keeps from one frame to the next where there is room.
const DEPTH_RETURN: f64 = 0.8;
/// The floor: coarser than this a picture is worse than half as many of them.
const FLOOR_QUANTISER: u8 = 40;
/// The same for bounds, in codes.
const FLOOR_ERROR: u8 = 10;
/// A frame's share is that of no more than this time: a session that paused has not saved up.
const LONGEST_BEAT: Duration = Duration::from_secs(1);

/// The state of one session.
#[derive(Clone, Debug)]
pub(super) struct RateControl {
    bytes_per_s: f64,
    /// Whether the target is what the link carries, and not the client's wish.
    must_fit: bool,
    /// Whether there is a floor under the quality.
    has_floor: bool,
    asked: FrameFormat,
    /// Steps of the quantiser, or halvings of the error, beyond what was asked for.
    coarser: f64,
    /// Factor on the promised error of depth.
    depth_factor: f64,
    overdrawn_bytes: f64,
    last_begun: Option<Timestamp>,
    /// What the target gives the frame that was begun last, and what that frame may have.
    income_bytes: f64,
    share_bytes: f64,
}

impl RateControl {
    /// Towards so many thousand bits per second, for a client that asked for this format; 0: as it was asked for.
    pub(super) fn new(target_kbps: u32, asked: FrameFormat) -> RateControl {
        RateControl {
            bytes_per_s: f64::from(target_kbps) * 125.0,
            must_fit: false,
            has_floor: false,
            asked,
            coarser: 0.0,
            depth_factor: 1.0,
            overdrawn_bytes: 0.0,
            last_begun: None,
            income_bytes: 0.0,
            share_bytes: 0.0,
        }
    }

    /// Aims at so many bytes per second from now on, 0 for as many as are needed: because the link carries no more
    /// (`must_fit`) or because the client said so. `has_floor` where something else than quality can give way.
    pub(super) fn aim(&mut self, bytes_per_s: f64, must_fit: bool, has_floor: bool) {
        (self.bytes_per_s, self.must_fit, self.has_floor) = (bytes_per_s, must_fit, has_floor);
        if bytes_per_s == 0.0 {
            (self.coarser, self.depth_factor, self.overdrawn_bytes) = (0.0, 1.0, 0.0);
        }
        self.coarser = self.coarser.min(self.most_steps());
    }

    /// Whether frames are coarser than was asked for.
    pub(super) fn gives_way(&self) -> bool {
        self.color_coding() != self.asked.color_coding || self.depth() != self.asked.depth
    }

    /// How much smaller frames would be if all were given up that may be, at most 1.
    pub(super) fn smallest(&self) -> f64 {
        (-(self.most_steps() - self.coarser) / STEPS_PER_HALF).exp2().min(1.0)
    }

    /// Steps beyond what was asked for that may be taken.
    fn most_steps(&self) -> f64 {
        let halvings = |asked: u8, most: u8| {
            STEPS_PER_HALF * ((2.0 * f64::from(most) + 1.0) / (2.0 * f64::from(asked) + 1.0)).log2().max(0.0)
        };
        let (error, quantiser) = match self.has_floor {
            true => (FLOOR_ERROR, FLOOR_QUANTISER),
            false => (*ColorCoding::ERRORS.end(), *ColorCoding::QUANTISERS.end()),
        };
        match self.asked.color_coding {
            ColorCoding::Exact if self.may_lose() => halvings(0, error),
            ColorCoding::Exact => 0.0,
            ColorCoding::Bounded { error: asked } => halvings(asked, error),
            ColorCoding::Video { quantiser: asked } => f64::from(quantiser.saturating_sub(asked)),
        }
    }

    fn may_lose(&self) -> bool {
        self.must_fit && ColorCoding::Bounded { error: 1 }.is_valid(self.asked.color)
    }

    /// How colour and depth of a frame travel that is begun now, in a session that would like one every `beat`.
    pub(super) fn begin(&mut self, now: Timestamp, beat: Duration) -> (ColorCoding, DepthFormat) {
        let since = self.last_begun.replace(now).map_or(beat, |last| now.since(last));
        let income = self.bytes_per_s * since.clamp(beat.min(LONGEST_BEAT), LONGEST_BEAT).as_secs_f64();
        self.income_bytes = income;
        self.share_bytes = (income - PAYBACK * self.overdrawn_bytes).max(0.25 * income);
        (self.color_coding(), self.depth())
    }

    fn color_coding(&self) -> ColorCoding {
        match self.asked.color_coding {
            ColorCoding::Exact => match self.widened(0) {
                error if error > 0 && self.may_lose() => ColorCoding::Bounded { error },
                _ => ColorCoding::Exact,
            },
            ColorCoding::Bounded { error } => {
                let error = self.widened(error);
                ColorCoding::Bounded { error: error.clamp(*ColorCoding::ERRORS.start(), *ColorCoding::ERRORS.end()) }
            }
            ColorCoding::Video { quantiser } => {
                let coarser = f64::from(quantiser) + self.coarser;
                ColorCoding::Video { quantiser: (coarser.round() as u8).min(*ColorCoding::QUANTISERS.end()) }
            }
        }
    }

    /// A bound on errors as wide as is needed now.
    fn widened(&self, error: u8) -> u8 {
        let width = (2.0 * f64::from(error) + 1.0) * (self.coarser / STEPS_PER_HALF).exp2();
        ((width - 1.0) * 0.5 + 1e-9).min(f64::from(*ColorCoding::ERRORS.end())) as u8
    }

    fn depth(&self) -> DepthFormat {
        match self.asked.depth {
            DepthFormat::Codes { .. } if self.must_fit && self.coarser >= STEPS_PER_HALF => {
                DepthFormat::Bounded(DepthBound::default())
            }
            DepthFormat::Bounded(bound) => {
                let error = (f64::from(bound.error_centi_px) * self.depth_factor).round() as u16;
                let error_centi_px =
                    error.clamp(*DepthBound::ERRORS_CENTI_PX.start(), *DepthBound::ERRORS_CENTI_PX.end());
                DepthFormat::Bounded(DepthBound { error_centi_px, ..bound })
            }
            codes => codes,
        }
    }

    /// A frame took so many bytes of strips, which hold all but a video's colour, and of pictures.
    pub(super) fn took(&mut self, strip_bytes: u64, picture_bytes: u64) {
        if self.bytes_per_s == 0.0 {
            return;
        }
        // Without pictures strips are counted as colour: nearly all of them is.
        let (color, geometry) = if picture_bytes > 0 { (picture_bytes, strip_bytes) } else { (strip_bytes, 0) };
        let (color, geometry) = (color as f64, geometry as f64);
        // What is left over is worth a frame at most.
        self.overdrawn_bytes = (self.overdrawn_bytes + color + geometry - self.income_bytes).max(-self.income_bytes);
        let left = (self.share_bytes - geometry).max((1.0 - GEOMETRY_SHARE) * self.share_bytes);
        let steps = STEPS_PER_HALF * (color.max(1.0) / left).log2();
        self.coarser = (self.coarser + steps.clamp(-MOST_STEPS.1, MOST_STEPS.0)).clamp(0.0, self.most_steps());
        let overfull = geometry / (GEOMETRY_SHARE * self.share_bytes).max(1.0);
        let most = f64::from(*DepthBound::ERRORS_CENTI_PX.end());
        self.depth_factor = (self.depth_factor * overfull.clamp(DEPTH_RETURN, 2.0)).clamp(1.0, most);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BEAT: Duration = Duration::from_millis(100);
    const GEOMETRY_BYTES: f64 = 60e3;

    fn asked(color_coding: ColorCoding) -> FrameFormat {
        let depth = DepthFormat::Bounded(DepthBound::default());
        FrameFormat { color_coding, depth, ..FrameFormat::default() }
    }

    /// Bytes of colour of a codec that halves with every six steps, and whose pictures change as `busy` says.
    fn color_bytes(format: FrameFormat, busy: f64) -> u64 {
        match format.color_coding {
            ColorCoding::Video { quantiser } => (busy * 400e3 * (-f64::from(quantiser) / 6.0).exp2() * 16.0) as u64,
            ColorCoding::Bounded { error } => (busy * 1e6 * (8.0 - f64::from(2 * error + 1).log2()) / 8.0) as u64,
            ColorCoding::Exact => 1_000_000,
        }
    }

    fn depth_factor(format: FrameFormat) -> f64 {
        let DepthFormat::Bounded(bound) = format.depth else { return 1.0 };
        f64::from(bound.error_centi_px) / f64::from(DepthBound::default().error_centi_px)
    }

    /// Frames of a session: what each took in all, and in which format.
    fn run(
        target_kbps: u32,
        color_coding: ColorCoding,
        frames: u32,
        busy: impl Fn(u32) -> f64,
    ) -> Vec<(u64, FrameFormat)> {
        let mut control = RateControl::new(target_kbps, asked(color_coding));
        (0..frames)
            .map(|frame| {
                let (color_coding, depth) = control.begin(Timestamp::ZERO + BEAT * frame, BEAT);
                let format = FrameFormat { depth, ..asked(color_coding) };
                let color = color_bytes(format, busy(frame));
                let geometry = (GEOMETRY_BYTES / depth_factor(format).sqrt()) as u64;
                match color_coding {
                    ColorCoding::Video { .. } => control.took(geometry, color),
                    _ => control.took(color + geometry, 0),
                }
                (color + geometry, format)
            })
            .collect()
    }

    fn kbps(frames: &[(u64, FrameFormat)]) -> f64 {
        frames.iter().map(|(bytes, _)| *bytes as f64 * 8e-3).sum::<f64>() / (frames.len() as f64 * BEAT.as_secs_f64())
    }

    #[test]
    fn a_target_is_kept_though_pictures_change() {
        for target in [8_000, 12_000, 20_000] {
            let frames = run(target, ColorCoding::Video { quantiser: 18 }, 400, |frame| {
                1.0 + 0.5 * (f64::from(frame) * 0.3).sin() + if frame % 100 < 10 { 2.0 } else { 0.0 }
            });
            let kept = kbps(&frames[20..]) / f64::from(target);
            assert!((0.85..1.03).contains(&kept), "{target}: {kept}");
        }
    }

    #[test]
    fn without_a_target_and_with_a_large_one_the_client_gets_what_it_asked_for() {
        let coding = ColorCoding::Video { quantiser: 30 };
        for target in [0, 500_000] {
            let frames = run(target, coding, 30, |_| 1.0);
            assert!(frames.iter().all(|(_, format)| *format == asked(coding)), "{target}");
        }
    }

    #[test]
    fn what_was_given_up_comes_back() {
        let coding = ColorCoding::Video { quantiser: 24 };
        let frames = run(10_000, coding, 120, |frame| if frame < 30 { 8.0 } else { 0.1 });
        let ColorCoding::Video { quantiser } = frames[29].1.color_coding else { panic!() };
        assert!(quantiser > 30, "{quantiser}");
        assert_eq!(frames[119].1, asked(coding));
    }

    #[test]
    fn a_target_that_cannot_be_met_takes_all_there_is_to_take() {
        let frames = run(100, ColorCoding::Video { quantiser: 24 }, 200, |_| 1.0);
        let (_, last) = frames[199];
        assert_eq!(last.color_coding, ColorCoding::Video { quantiser: 51 });
        let most = f64::from(*DepthBound::ERRORS_CENTI_PX.end());
        assert_eq!(depth_factor(last), most / f64::from(DepthBound::default().error_centi_px), "16 px");
        assert!(last.is_valid());
    }

    #[test]
    fn bounds_widen_as_far_as_needed_and_exact_colour_stays() {
        let frames = run(7_500, ColorCoding::Bounded { error: 1 }, 200, |_| 0.08);
        let kept = kbps(&frames[50..]) / 7_500.0;
        assert!((0.8..1.05).contains(&kept), "{kept}");
        let exact = run(1_000, ColorCoding::Exact, 50, |_| 1.0);
        assert!(exact.iter().all(|(_, format)| format.color_coding == ColorCoding::Exact && format.is_valid()));
    }

    #[test]
    fn a_pause_saves_nothing_up() {
        let mut control = RateControl::new(10_000, asked(ColorCoding::Video { quantiser: 18 }));
        control.begin(Timestamp::ZERO, BEAT);
        control.took(10_000, 500_000);
        control.begin(Timestamp::ZERO + Duration::from_secs(3600), BEAT);
        assert!(control.share_bytes <= 2.0 * control.bytes_per_s);
    }
}
