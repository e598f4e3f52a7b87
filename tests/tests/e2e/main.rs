//! End to end: sessions over a modelled link, replays in virtual time, and the programs as processes.

#![allow(clippy::unwrap_used, reason = "all of this is test code, its helpers too")]

mod adaptation;
mod effects;
mod fates;
mod freshness;
mod hostile;
mod identity;
mod mutations;
mod prediction;
mod programs;
mod replays;
