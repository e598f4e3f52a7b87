//! Time-critical computing: which point of a front of accuracy against time is used, so that work is done when it must be.
//!
//! Both ends have a budget: the client for a refresh of its display, the server for a frame. Either can work at several
//! **points**, settings that were measured with their error and their time ([`PointCost`]). Those that no other point beats
//! in both are the [`Front`]; of it a [`Chooser`] takes the most accurate one that is expected to fit, as Funkhouser and
//! Sequin 1993 chose levels of detail, and learns from every measured time what the machine really takes
//! (Wimmer and Wonka 2003 measure why it must: an estimate that is not refreshed is off by a factor).
//!
//! Time is an argument, here and everywhere in this crate: equal measurements give equal choices, so virtual clocks stay
//! reproducible. Cost: a hundred floating point operations for each measurement, and no allocation.

mod chooser;
mod front;

pub use chooser::{Chooser, Tempo};
pub use front::{Front, PointCost};
