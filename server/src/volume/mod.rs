//! Volumes: matter that fills space instead of bounding it, such as smoke, clouds and what a CT scan shows.
//!
//! Part of the scene. Data comes from a file ([`load`]) or a procedure ([`procedural`]) as a [`Grid`] of values
//! over the unit cube; a [`TransferFunction`] says what the values are, as extinction and colour. A [`Medium`]
//! puts them into the world; the integrator flies through it along [`majorants`], and scatters by its [`Phase`].

mod blocks;
mod file;
pub mod grid;
pub mod majorants;
pub mod medium;
mod mitsuba_vol;
mod nrrd;
pub mod phase;
pub mod procedural;
mod raw;
mod samples;
pub mod transfer;
mod vdb;

pub use blocks::Blocks;
pub use file::{Loaded, load};
pub use grid::{Grid, GridError};
pub use majorants::{Majorants, Segment};
pub use medium::{Albedo, Matter, Medium, Optical};
pub use phase::Phase;
pub use transfer::{ControlPoint, TransferError, TransferFunction};
