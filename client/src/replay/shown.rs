//! The frame that is shown, and those before it that are kept to be asked for what it does not know.

use crate::assemble::ReadyFrame;
use std::collections::VecDeque;
use std::sync::Arc;

/// Frames of a replay, the latest first.
#[derive(Debug, Default)]
pub(super) struct Shown {
    frames: VecDeque<Arc<ReadyFrame>>,
}

impl Shown {
    /// Takes in the latest frame and keeps so many earlier ones; returns one that is not needed any more.
    pub(super) fn replace(&mut self, frame: Arc<ReadyFrame>, earlier: usize) -> Option<Arc<ReadyFrame>> {
        self.frames.push_front(frame);
        if self.frames.len() > earlier + 1 { self.frames.pop_back() } else { None }
    }

    /// The latest frame.
    pub(super) fn latest(&self) -> Option<&Arc<ReadyFrame>> {
        self.frames.front()
    }

    /// Those before it, the newest first.
    pub(super) fn earlier(&self) -> impl Iterator<Item = &Arc<ReadyFrame>> {
        self.frames.iter().skip(1)
    }
}
