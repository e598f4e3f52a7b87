//! What is still to be visited, in a fixed array on the thread's stack.
//!
//! Large enough by construction: a node has eight children, of which one is visited at once and seven wait,
//! and `build` keeps trees within [`MAX_DEPTH`] levels. Clearing 3 KiB for every ray would cost as much as a
//! node or two; hence the unsafe code.

use super::build::MAX_DEPTH;
use super::hierarchy::Child;
use super::lanes::LANES;
use std::mem::MaybeUninit;

/// Seven of each level, and the root.
const CAPACITY: usize = (LANES - 1) * MAX_DEPTH as usize + 1;

/// A child and the distance at which the ray enters its box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Entry {
    pub(super) child: Child,
    pub(super) distance: f32,
}

/// Last in, first out.
pub(super) struct Stack {
    entries: [MaybeUninit<Entry>; CAPACITY],
    len: usize,
}

impl Stack {
    #[inline(always)]
    pub(super) fn new() -> Stack {
        Stack { entries: [const { MaybeUninit::uninit() }; CAPACITY], len: 0 }
    }

    #[inline(always)]
    pub(super) fn push(&mut self, entry: Entry) {
        self.entries[self.len].write(entry);
        self.len += 1;
    }

    #[inline(always)]
    #[allow(unsafe_code)]
    pub(super) fn pop(&mut self) -> Option<Entry> {
        self.len = self.len.checked_sub(1)?;
        // SAFETY: `push` has written all entries below the length it left behind; nothing else raises it.
        Some(unsafe { self.entries[self.len].assume_init() })
    }

    /// Pushes an entry below those of the last `count` that are nearer, which are in order.
    #[inline(always)]
    #[allow(unsafe_code)]
    pub(super) fn push_sorted(&mut self, entry: Entry, count: usize) {
        let mut place = self.len;
        self.push(entry);
        for _ in 0..count.min(place) {
            // SAFETY: written by `push`: below the length.
            let above = unsafe { self.entries[place - 1].assume_init() };
            if above.distance >= entry.distance {
                break;
            }
            self.entries[place].write(above);
            place -= 1;
        }
        self.entries[place].write(entry);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_of_what_was_pushed_in_order_comes_first() {
        let mut stack = Stack::new();
        stack.push(Entry { child: Child::ROOT, distance: -1.0 });
        for (count, distance) in [3.0, 1.0, 4.0, 1.0, 5.0, 9.0, 2.0].into_iter().enumerate() {
            stack.push_sorted(Entry { child: Child::ROOT, distance }, count);
        }
        let popped: Vec<f32> = std::iter::from_fn(|| stack.pop()).map(|entry| entry.distance).collect();
        assert_eq!(popped, [1.0, 1.0, 2.0, 3.0, 4.0, 5.0, 9.0, -1.0]);
    }

    #[test]
    fn the_deepest_tree_fits() {
        let mut stack = Stack::new();
        for _ in 0..MAX_DEPTH as usize * (LANES - 1) + 1 {
            stack.push(Entry { child: Child::ROOT, distance: 0.0 });
        }
        assert_eq!(std::iter::from_fn(|| stack.pop()).count(), CAPACITY);
    }
}
