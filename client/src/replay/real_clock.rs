//! A replay in real time: the session runs on the network thread, the display loop here.
//!
//! At each refresh the head pose of that moment is read off the trace, sent, and the latest frame warped to it, by the point
//! that the display's budget chooses, where there is one. Frames are taken in beside it (`intake`).
//! The picture is on the display at the next refresh; one that is not ready by then is a miss.

use super::intake::Intake;
use super::screen::Screen;
use super::shown::Shown;
use super::{Capture, DisplayRecord, Progress, Recording, ReplayError, ReplayPlan};
use crate::assemble::ReadyFrame;
use crate::budget::DisplayPoint;
use crate::net::{Command, Connection, Endpoint, News};
use crate::trace::Trace;
use std::sync::Arc;
use std::time::{Duration, Instant};
use warplight_protocol::Timestamp;
use warplight_protocol::message::{FramePurpose, PoseSample};

/// A server that cannot be reached at all is given up after this; one that was lost is waited for as long.
const PATIENCE: Duration = Duration::from_secs(10);
/// A still of many samples takes its time.
const STILL_PATIENCE: Duration = Duration::from_secs(300);

/// Replays `plan` against a server.
pub fn run(
    plan: &ReplayPlan,
    endpoint: Endpoint,
    progress: &mut dyn FnMut(Progress),
) -> Result<Recording, ReplayError> {
    let address = endpoint.address.clone();
    let connect = |source| ReplayError::Connect { address: address.clone(), source };
    let connection = Connection::start(endpoint, plan.hello(), Instant::now()).map_err(connect)?;
    let mut player = Player {
        plan,
        connection,
        trace: None,
        shown: Shown::default(),
        intake: None,
        recording: Recording { metrics: plan.metrics.clone(), ..Recording::default() },
        lost: None,
        stills_missing: 0,
        over: false,
    };
    progress(Progress::Connecting);
    player.wait_for_first_frame(&address)?;
    player.play(progress)?;
    player.fetch_references(progress)?;
    player.close();
    Ok(player.recording)
}

struct Player<'a> {
    plan: &'a ReplayPlan,
    connection: Connection,
    trace: Option<Trace>,
    shown: Shown,
    /// From the first refresh on.
    intake: Option<Intake>,
    recording: Recording,
    lost: Option<String>,
    stills_missing: usize,
    over: bool,
}

impl Player<'_> {
    fn on_news(&mut self, news: News) -> Result<(), ReplayError> {
        match news {
            News::Open(welcome) => {
                if self.recording.welcome.is_some() {
                    self.recording.reconnects += 1;
                    if let Some(metrics) = &self.recording.metrics {
                        metrics.add("warplight_reconnects_total", &[], 1.0);
                    }
                }
                self.lost = None;
                self.trace = Some(self.plan.placed_trace(&welcome.head));
                self.recording.welcome = Some(welcome);
            }
            News::Frame(frame) => self.on_frame(frame),
            News::Statistics(statistics) => self.recording.statistics_arrived(statistics),
            News::Lost { why, frame_lost } => {
                self.recording.session_lost(frame_lost);
                tracing::warn!("connection lost: {why}");
                self.lost = Some(why);
            }
            News::Failed(end) => return Err(end.into()),
            News::RoundTrip(_) => {}
            News::Over => self.over = true,
        }
        Ok(())
    }

    fn on_frame(&mut self, frame: Arc<ReadyFrame>) {
        if let FramePurpose::Still(number) = frame.begin.purpose {
            self.stills_missing = self.stills_missing.saturating_sub(1);
            self.recording.reference_arrived(number, &frame.tree, frame.begin.shape.exposure);
            self.connection.tell(Command::Retire(frame));
            return;
        }
        self.recording.frame_arrived(&frame);
        let replaced = match &mut self.intake {
            Some(intake) => intake.push(frame),
            None => self.shown.replace(frame, self.plan.earlier_frames),
        };
        replaced.into_iter().for_each(|old| self.connection.tell(Command::Retire(old)));
    }

    fn drain_news(&mut self) -> Result<(), ReplayError> {
        while let Some(news) = self.connection.news() {
            self.on_news(news)?;
        }
        Ok(())
    }

    /// The head stands still at the start of the trace until there is something to see.
    fn wait_for_first_frame(&mut self, address: &str) -> Result<(), ReplayError> {
        let deadline = self.connection.now() + PATIENCE;
        while self.shown.latest().is_none() {
            let now = self.connection.now();
            if now >= deadline {
                let why = self.lost.take().unwrap_or_else(|| "no frame arrived".to_owned());
                let source = std::io::Error::new(std::io::ErrorKind::TimedOut, why);
                return Err(ReplayError::Connect { address: address.to_owned(), source });
            }
            if let Some(trace) = &self.trace {
                self.connection.tell(Command::Pose(PoseSample { time: now, pose: trace.pose_at(0.0) }));
            }
            if let Some(news) = self.connection.wait_for_news(self.plan.refresh_interval()) {
                self.on_news(news)?;
            }
        }
        Ok(())
    }

    fn play(&mut self, progress: &mut dyn FnMut(Progress)) -> Result<(), ReplayError> {
        let mut screen = Screen::new(self.plan);
        if let Some(first) = self.shown.latest() {
            screen.warper.prepare(self.plan.mode, &first.tree);
        }
        self.intake = Some(Intake::start(self.plan.mode, self.plan.warper()).map_err(ReplayError::Threads)?);
        let start = self.connection.now();
        self.recording.start = start;
        let refreshes = self.plan.refreshes();
        for number in 0..refreshes {
            let refresh = start + self.plan.refresh_time(number);
            self.connection.sleep_until(refresh);
            self.drain_news()?;
            if let Some(frame) = self.intake.as_mut().and_then(|intake| intake.poll(&mut screen.warper))
                && let Some(old) = self.shown.replace(frame, self.plan.earlier_frames)
            {
                self.connection.tell(Command::Retire(old));
            }
            let (Some(trace), Some(frame)) = (&self.trace, self.shown.latest()) else { continue };
            let time = self.plan.refresh_time(number);
            let display_pose = trace.pose_at(time.as_secs_f64());
            let sampled = self.connection.now();
            // A loop that is late skips the refreshes it has missed.
            if sampled >= refresh + self.plan.refresh_interval() {
                continue;
            }
            self.connection.tell(Command::Pose(PoseSample { time: sampled, pose: display_pose }));
            let point = screen.point();
            screen.show(self.plan, trace, time, frame);
            let warped = self.connection.now();
            screen.took(self.plan, warped.since(sampled));
            let frame = frame.clone();
            self.record(number, &frame, point, [sampled, warped], refresh);
            progress(Progress::Displaying(number + 1, refreshes));
        }
        self.recording.budget = screen.budget;
        let traffic = self.connection.traffic();
        self.recording.finish(traffic.down_bytes(), traffic.up_bytes());
        Ok(())
    }

    fn record(
        &mut self,
        number: u64,
        frame: &Arc<ReadyFrame>,
        point: Option<DisplayPoint>,
        [sampled, warped]: [Timestamp; 2],
        refresh: Timestamp,
    ) {
        let time = self.plan.refresh_time(number);
        let Some(trace) = &self.trace else { return };
        let display_pose = trace.pose_at(time.as_secs_f64());
        let interval = self.plan.refresh_interval();
        // On the display at the first refresh after the warp.
        let intervals = (warped.since(refresh).as_secs_f64() / interval.as_secs_f64()).ceil().max(1.0);
        let presented = refresh + interval.mul_f64(intervals);
        self.recording.refreshed(DisplayRecord {
            time,
            motion_to_photon: presented.since(sampled),
            warp: warped.since(sampled),
            frame: frame.begin.id,
            frame_age: presented.since(frame.begin.pose_time),
            missed: intervals > 1.0,
        });
        self.recording.frame_shown(frame.begin.id, warped, presented, display_pose);
        if (self.recording.captures.len() as u64) < self.plan.comparisons_by(number) {
            let capture = Capture::new(self.plan, trace, time, sampled, &self.shown);
            self.recording.captures.extend(capture.map(|capture| Capture { point, ..capture }));
        }
    }

    /// Asks for all stills that the references need.
    fn fetch_references(&mut self, progress: &mut dyn FnMut(Progress)) -> Result<(), ReplayError> {
        let requests = self.recording.reference_requests(self.plan);
        let total = requests.len() as u64;
        for request in requests {
            let number = request.number;
            progress(Progress::Reference(u64::from(number), total));
            self.stills_missing = 1;
            self.connection.tell(Command::Still(request));
            let deadline = self.connection.now() + STILL_PATIENCE;
            while self.stills_missing > 0 {
                if let Some(news) = self.connection.wait_for_news(Duration::from_millis(100)) {
                    self.on_news(news)?;
                }
                if self.lost.is_some() || self.connection.now() >= deadline {
                    tracing::warn!("still {number} of {total} for the references did not arrive");
                    return Ok(());
                }
            }
        }
        Ok(())
    }

    fn close(&mut self) {
        self.connection.tell(Command::Close);
        while !self.over {
            let Some(news) = self.connection.wait_for_news(Duration::from_secs(1)) else { break };
            if self.on_news(news).is_err() {
                break;
            }
        }
    }
}
