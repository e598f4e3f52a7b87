//! What a replay found out: `report.json` for programs, `index.html` for people, a few lines for the
//! terminal. The last stage of the pipeline; it computes nothing new but the doubts about itself.

pub mod page;
mod schema;
mod series;
mod summary;
mod warnings;
mod write;

#[cfg(test)]
mod sample;

pub use schema::{ClockKind, ClockOffset, Display, Latency, Link, ModeQuality, Prediction, Reference, Report, SCHEMA};
pub use series::{DisplaySeries, FrameSeries, QualitySeries, Series};
pub use summary::summary;
pub use warnings::doubts;
pub use write::write_whole;
