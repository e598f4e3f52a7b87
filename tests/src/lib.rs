//! Harness of the end-to-end tests: two sessions, a modelled link between them, and a clock that only the
//! test moves. Latency, stalls and lost connections are tested in microseconds of real time.

mod pair;

pub use pair::{Arrival, Pair, PairOptions};
