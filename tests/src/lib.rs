//! Harness of the end-to-end tests: two sessions, a modelled link between them, and a clock that only the
//! test moves. Latency, stalls and lost connections are tested in microseconds of real time.

pub mod hostile;
mod pair;

pub use pair::{Arrival, Fates, Pair, PairOptions, Refreshes};
