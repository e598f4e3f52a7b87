//! The choice of a point that fits a budget, from the times that were measured so far.
//!
//! What a point is expected to take is the time of its table, times the work (pixels over those of the table), times the
//! **speed** of this machine now, times a factor **of its own**, since tables are of other frames. Both factors are
//! geometric running means of measured over expected; the first measurements at a point teach its own factor, later ones
//! the speed. Since what must not be late is not the mean, the expectation is multiplied by the ninth decile of measured
//! over expected of late.
//!
//! A point is left for a cheaper one after [`MISFITS`] measurements in a row in which it does not fit: then what was
//! measured is believed at once (the median of those), and the most accurate point that fits is taken. It is left for a better one when that would
//! fit into [`RISE_BELOW`] of the budget for a number of measurements in a row, twice as many after every rise that did not
//! last ([`Tempo`]): between two points a choice does not flutter.
//!
//! Limits: a point that nobody has used is known by its table alone; a wrong one is corrected by trying it, which may cost
//! as many late pictures as a fall takes.

use super::{Front, PointCost};

/// Measurements in a row that must not fit, before a cheaper point: one alone may be a hiccup of the machine.
const MISFITS: usize = 3;
/// Part of the budget that a better point may be expected to take.
const RISE_BELOW: f64 = 0.85;
/// Measurements after a change that teach the new point's own factor, not the speed.
const SETTLING: u32 = 8;
/// Weight of a measurement in a point's own factor while it settles, and in the speed later.
const GAINS: [f64; 2] = [0.3, 0.08];
/// Weight by which factors of points that are not used go back to one: what was wrong may be forgotten within minutes.
const FORGETTING: f64 = 1e-3;
/// What was measured last, over what is expected, above which the speed is known.
const STEADY: f64 = 0.8;
/// Part of a point's own factor that each measurement makes one of the machine: both at once cannot be told apart at one
/// point, and a table is wrong less often than a machine is slow.
const SHIFT: f64 = 0.02;
/// A single measurement counts as at most this many times what was expected, and at least its inverse.
const FARTHEST: f64 = 4.0;
/// Measurements whose ninth decile is the margin.
const RECENT: usize = 64;
/// The margin before as many as [`RECENT`]/4 are known.
const FIRST_MARGIN: f64 = 1.2;

/// After how many measurements a better point is tried.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tempo {
    /// At first.
    pub first: u32,
    /// At most, after rises that did not last.
    pub longest: u32,
}

impl Tempo {
    /// For refreshes of a display: half a second at 60 Hz, half a minute at most.
    pub const DISPLAY: Tempo = Tempo { first: 30, longest: 1920 };
    /// For frames of a server: seconds, and minutes at most.
    pub const FRAMES: Tempo = Tempo { first: 8, longest: 512 };
}

/// Chooses, measurement by measurement.
#[derive(Clone, Debug)]
pub struct Chooser {
    points: Vec<PointCost>,
    budget_ms: f64,
    tempo: Tempo,
    /// Nothing was measured yet.
    is_new: bool,
    speed: f64,
    own: Vec<f64>,
    recent: [f64; RECENT],
    measured: usize,
    margin: f64,
    /// Work of the last measurement, in units of the table.
    work: f64,
    current: usize,
    since_change: u32,
    misfits: usize,
    /// Measured over the table's time, of the last.
    last: [f64; MISFITS],
    fits: u32,
    patience: u32,
    /// The last change was a rise.
    has_risen: bool,
    changes: u32,
}

impl Chooser {
    /// One of a front that has at least one point, for a budget; `work` is what the first picture will be, in units of the
    /// table. `None` for a front without points.
    pub fn new(front: Front, budget_ms: f64, work: f64, tempo: Tempo) -> Option<Chooser> {
        let points = front.points().to_vec();
        let own = vec![1.0; points.len()];
        let mut chooser = Chooser {
            points,
            budget_ms,
            tempo,
            is_new: true,
            speed: 1.0,
            own,
            recent: [1.0; RECENT],
            measured: 0,
            margin: FIRST_MARGIN,
            work: work.max(f64::MIN_POSITIVE),
            current: 0,
            since_change: 0,
            misfits: 0,
            last: [1.0; MISFITS],
            fits: 0,
            patience: tempo.first,
            has_risen: false,
            changes: 0,
        };
        chooser.current = chooser.most_accurate_within(chooser.budget_ms)?;
        Some(chooser)
    }

    /// The points it chooses from.
    pub fn points(&self) -> &[PointCost] {
        &self.points
    }

    /// The point in use, by its place on the front.
    pub fn current(&self) -> usize {
        self.current
    }

    /// How often it changed.
    pub fn changes(&self) -> u32 {
        self.changes
    }

    /// What there is time for.
    pub fn budget_ms(&self) -> f64 {
        self.budget_ms
    }

    /// What a point is expected to take of work like the last, rarely more.
    pub fn expected_ms(&self, point: usize) -> f64 {
        self.mean_ms(point) * self.margin
    }

    /// Its expected mean on this machine, of the table's work: what the table should say.
    pub fn refreshed_ms(&self, point: usize) -> f64 {
        self.points[point].time_ms * self.speed * self.own[point]
    }

    /// The next more accurate point, and what it is expected to take.
    pub fn next_better(&self) -> Option<(&PointCost, f64)> {
        let next = self.current + 1;
        self.points.get(next).map(|point| (point, self.expected_ms(next)))
    }

    fn mean_ms(&self, point: usize) -> f64 {
        self.refreshed_ms(point) * self.work
    }

    /// The cheapest where none fits.
    fn most_accurate_within(&self, budget_ms: f64) -> Option<usize> {
        let fits = |&point: &usize| self.expected_ms(point) <= budget_ms;
        (0..self.points.len()).rev().find(fits).or(if self.points.is_empty() { None } else { Some(0) })
    }

    /// The point in use took so long for so much work; true where it is another one from now on.
    pub fn measure(&mut self, work: f64, millis: f64) -> bool {
        if !(work > 0.0 && millis > 0.0 && work.is_finite() && millis.is_finite()) {
            return false;
        }
        self.work = work;
        self.learn(millis);
        self.since_change = self.since_change.saturating_add(1);
        // A margin that nobody has measured is no reason to leave a point.
        let margin = if self.measured < RECENT / 4 { 1.0 } else { self.margin };
        let is_misfit = millis > self.budget_ms || self.mean_ms(self.current) * margin > self.budget_ms;
        self.misfits = if is_misfit { self.misfits + 1 } else { 0 };
        if self.current > 0 && self.misfits >= MISFITS {
            self.believe();
            let fitting = self.most_accurate_within(self.budget_ms).unwrap_or(0);
            if self.has_risen && self.since_change < 4 * self.patience {
                self.patience = (2 * self.patience).min(self.tempo.longest);
            }
            return self.change(fitting.min(self.current - 1), false);
        }
        let better = self.most_accurate_within(RISE_BELOW * self.budget_ms).filter(|&better| better > self.current);
        // While the machine gets faster than it is thought to be, a new point would be taken for the reason.
        let is_known = self.median_of_last() > STEADY * self.speed * self.own[self.current];
        self.fits = if is_misfit || better.is_none() || !is_known { 0 } else { self.fits + 1 };
        match better {
            // One at a time: what the one after costs is known better then.
            Some(_) if self.fits >= self.patience => self.change(self.current + 1, true),
            _ => false,
        }
    }

    fn change(&mut self, point: usize, has_risen: bool) -> bool {
        (self.current, self.has_risen) = (point, has_risen);
        (self.since_change, self.misfits, self.fits) = (0, 0, 0);
        self.changes += 1;
        true
    }

    fn median_of_last(&self) -> f64 {
        let mut sorted = self.last;
        sorted.sort_unstable_by(f64::total_cmp);
        sorted[MISFITS / 2]
    }

    /// What was measured last is what this point takes now.
    fn believe(&mut self) {
        let (ratio, current) = (self.median_of_last(), self.current);
        match self.since_change <= SETTLING {
            true => self.own[current] = ratio / self.speed,
            false => self.speed = ratio / self.own[current],
        }
    }

    /// Takes a time into the factors and the margin.
    fn learn(&mut self, millis: f64) {
        let current = self.current;
        if std::mem::take(&mut self.is_new) {
            self.speed = millis / (self.points[current].time_ms * self.work);
            self.since_change = SETTLING;
        }
        self.last[self.measured % MISFITS] = millis / (self.points[current].time_ms * self.work);
        let ratio = millis / self.mean_ms(current);
        self.recent[self.measured % RECENT] = ratio;
        self.measured += 1;
        let bounded = ratio.clamp(1.0 / FARTHEST, FARTHEST);
        match self.since_change < SETTLING {
            true => self.own[current] *= bounded.powf(GAINS[0]),
            false => {
                self.speed *= bounded.powf(GAINS[1]);
                // What lasts is the machine's, and moves from the one factor to the other.
                let shift = self.own[current].powf(SHIFT);
                self.speed *= shift;
                self.own[current] /= shift;
            }
        }
        for (point, own) in self.own.iter_mut().enumerate() {
            if point != current {
                *own = own.powf(1.0 - FORGETTING);
            }
        }
        let known = self.measured.min(RECENT);
        if known >= RECENT / 4 {
            let mut sorted = self.recent;
            let sorted = &mut sorted[..known];
            sorted.sort_unstable_by(f64::total_cmp);
            self.margin = sorted[known * 9 / 10].clamp(1.0, FARTHEST);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Half the error for twice the time.
    fn front() -> Front {
        Front::of((0..6).map(|step| {
            let time_ms = f64::from(1 << step);
            PointCost { point: format!("{time_ms} ms"), error: 1.0 / time_ms, time_ms, spread_ms: 0.0 }
        }))
    }

    /// A machine that takes `slower` times what the table says, a little more or less each time.
    fn takes(chooser: &Chooser, slower: f64, turn: u32) -> f64 {
        chooser.points()[chooser.current()].time_ms * slower * (1.0 + 0.05 * (f64::from(turn) * 2.4).sin())
    }

    fn settled(budget_ms: f64, slower: f64) -> Chooser {
        let mut chooser = Chooser::new(front(), budget_ms, 1.0, Tempo::DISPLAY).unwrap();
        for turn in 0..2000 {
            let millis = takes(&chooser, slower, turn);
            chooser.measure(1.0, millis);
        }
        chooser
    }

    #[test]
    fn more_budget_is_never_a_worse_point_and_what_is_chosen_fits() {
        for slower in [0.2, 1.0, 3.0] {
            let mut least = 0;
            for budget_ms in (1..80).map(|step| f64::from(step) * 0.75) {
                let chooser = settled(budget_ms, slower);
                assert!(chooser.current() >= least, "{budget_ms} ms on a machine {slower} times as slow");
                least = chooser.current();
                let takes = |point: usize| chooser.points()[point].time_ms * slower;
                assert!(takes(least) <= budget_ms || least == 0, "{budget_ms} ms, {slower}");
                // Nothing is left lying about: the next point would not fit with the margin of a rise.
                let next_fits = least + 1 < 6 && takes(least + 1) * 1.06 < RISE_BELOW * budget_ms;
                assert!(!next_fits, "{budget_ms} ms, {slower}");
            }
            assert_eq!(least, if slower > 2.0 { 4 } else { 5 });
        }
    }

    #[test]
    fn a_cost_that_jumps_is_followed_within_three_pictures_and_back_within_seconds() {
        let mut chooser = settled(11.0, 1.0);
        assert_eq!(chooser.points()[chooser.current()].time_ms, 8.0);
        let (mut late, mut turn) = (0, 0);
        let mut run = |chooser: &mut Chooser, slower: f64, pictures: u32| {
            for _ in 0..pictures {
                turn += 1;
                let millis = takes(chooser, slower, turn);
                late += u32::from(millis > 11.0);
                chooser.measure(1.0, millis);
            }
            std::mem::take(&mut late)
        };
        let late = run(&mut chooser, 4.0, 600);
        assert!(late as usize <= MISFITS, "{late} late pictures while the machine is four times as slow");
        assert_eq!(chooser.points()[chooser.current()].time_ms, 2.0);
        let late = run(&mut chooser, 1.0, 1200);
        assert_eq!((late, chooser.points()[chooser.current()].time_ms), (0, 8.0));
    }

    #[test]
    fn between_two_points_the_choice_does_not_flutter() {
        // A table that is wrong: the dearer point takes three times what it says.
        let mut chooser = Chooser::new(front(), 11.0, 1.0, Tempo::DISPLAY).unwrap();
        let mut late = 0;
        for turn in 0..36_000 {
            let wrong = if chooser.current() >= 3 { 3.0 } else { 1.0 };
            let millis = takes(&chooser, wrong, turn);
            late += u32::from(millis > 11.0);
            chooser.measure(1.0, millis);
        }
        // Ten minutes at 60 Hz.
        assert!(chooser.changes() < 60 && late < 360, "{} changes, {late} late", chooser.changes());
    }

    #[test]
    fn equal_measurements_give_equal_choices_and_nonsense_is_not_one() {
        let run = || {
            let chooser = settled(5.0, 1.7);
            (chooser.current(), chooser.changes(), chooser.expected_ms(0).to_bits())
        };
        assert_eq!(run(), run());
        let mut chooser = settled(5.0, 1.0);
        let before = chooser.expected_ms(1);
        for (work, millis) in [(f64::NAN, 1.0), (1.0, f64::NAN), (0.0, 1.0), (1.0, -1.0), (1.0, f64::INFINITY)] {
            assert!(!chooser.measure(work, millis));
        }
        assert_eq!(chooser.expected_ms(1), before);
        assert!(Chooser::new(Front::default(), 5.0, 1.0, Tempo::DISPLAY).is_none());
    }

    #[test]
    fn more_work_is_foreseen() {
        let mut chooser = settled(11.0, 1.0);
        let before = chooser.expected_ms(chooser.current());
        let millis = 2.0 * takes(&chooser, 1.0, 1);
        chooser.measure(2.0, millis);
        let ratio = chooser.expected_ms(chooser.current()) / before;
        assert!((1.9..2.1).contains(&ratio), "{ratio}");
        let (next, expected_ms) = chooser.next_better().unwrap();
        assert!(expected_ms > 30.0 && next.time_ms == 16.0);
    }
}
