//! Frames are taken in on a thread of their own, so that no refresh waits for one.
//!
//! Between decode and display, on the real clock. What of a frame does not depend on where the head will be takes as long
//! as a picture or longer ([`Warper::prepare`]); the display shows the frame before until it is done, and then takes it over
//! in no time ([`Warper::adopt`]). Of frames that come meanwhile the latest waits; one frame is taken in at a time.
//!
//! Cost: the memory of a second decoded frame, and a frame is shown as much later as taking it in takes.

use crate::assemble::ReadyFrame;
use crate::warp::{Mode, Warper};
use std::io;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use thread_priority::{ThreadPriority, set_current_thread_priority};

/// A tenth of the weight of an ordinary thread (nice 10 on Linux): refreshes go first, and rendering threads, which have
/// nice 15, last: a frame that is rendered is of no use before it is taken in.
const PRIORITY: u8 = 23;

/// A frame, and the warper that takes it in.
type Work = (Arc<ReadyFrame>, Box<Warper>);

/// The thread's ends.
#[derive(Debug)]
pub(super) struct Intake {
    mode: Mode,
    work: Sender<Work>,
    done: Receiver<Work>,
    /// Nothing is being taken in.
    spare: Option<Box<Warper>>,
    waiting: Option<Arc<ReadyFrame>>,
}

impl Intake {
    /// Takes frames in for `mode`, by a warper that is set like the display's.
    ///
    /// # Errors
    /// What the operating system says of threads.
    pub(super) fn start(mode: Mode, warper: Warper) -> io::Result<Intake> {
        let (work, asked) = channel::<Work>();
        let (taken_in, done) = channel();
        // Apart from the threads that make pictures: those would finish this first.
        let pool = rayon::ThreadPoolBuilder::new()
            .thread_name(|index| format!("intake-{index}"))
            .start_handler(|_| give_way(PRIORITY))
            .build()
            .map_err(io::Error::other)?;
        std::thread::Builder::new().name("intake".to_owned()).spawn(move || {
            give_way(PRIORITY);
            for (frame, mut warper) in asked {
                pool.install(|| warper.prepare(mode, &frame.tree));
                if taken_in.send((frame, warper)).is_err() {
                    break;
                }
            }
        })?;
        Ok(Intake { mode, work, done, spare: Some(Box::new(warper)), waiting: None })
    }

    /// A frame has arrived. Returns one that will not be shown.
    pub(super) fn push(&mut self, frame: Arc<ReadyFrame>) -> Option<Arc<ReadyFrame>> {
        let replaced = self.waiting.replace(frame);
        self.begin();
        replaced
    }

    /// The frame that was taken in since the last question, now in `warper`.
    pub(super) fn poll(&mut self, warper: &mut Warper) -> Option<Arc<ReadyFrame>> {
        let (frame, mut other) = self.done.try_recv().ok()?;
        warper.adopt(self.mode, &mut other);
        self.spare = Some(other);
        self.begin();
        Some(frame)
    }

    fn begin(&mut self) {
        let Some(warper) = self.spare.take() else { return };
        match self.waiting.take() {
            // The thread is there as long as this is.
            Some(frame) => drop(self.work.send((frame, warper))),
            None => self.spare = Some(warper),
        }
    }
}

/// Lowers the priority of this thread.
pub(super) fn give_way(priority: u8) {
    let lower = priority.try_into().map_or(ThreadPriority::Min, ThreadPriority::Crossplatform);
    if let Err(error) = set_current_thread_priority(lower) {
        tracing::debug!("a thread keeps its priority: {error:?}");
    }
}
