//! What a replay found out: `report.json` for programs, `index.html` for people, a few lines for the
//! terminal. The last stage of the pipeline; it computes nothing new but the doubts about itself.

mod budget;
mod limits;
mod nodes;
pub mod page;
mod schema;
mod series;
mod strip;
mod summary;
mod warnings;
mod write;

#[cfg(test)]
mod sample;

pub use budget::{BudgetPoint, BudgetReport};
pub use limits::{Limit, Spike, Spikes};
pub use nodes::{NodeReport, SpecularReport};
pub use schema::{
    ClockKind, ClockOffset, Display, EyeQuality, Latency, Link, ModeQuality, OpticsUsed, Prediction, Reference, Report,
    SCHEMA, SpecularQuality, Viewport,
};
pub use series::{DisplaySeries, FrameSeries, QualitySeries, Series};
pub use strip::strip;
pub use summary::summary;
pub use warnings::doubts;
pub(crate) use write::rounded_json;
pub use write::write_whole;
