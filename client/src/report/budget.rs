//! What a budget chose, and what the next better choice would cost: schema and words.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The display's budget.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BudgetReport {
    /// Time for the picture of a refresh.
    pub budget_ms: f64,
    /// The cost model that it chose from.
    pub model: String,
    /// The point in use at the end.
    pub point: String,
    /// What nine in ten of its pictures are expected to take at most.
    pub expected_ms: f64,
    /// Its error, in the unit of the model.
    pub error: f64,
    /// The next more accurate point; `null` where there is none.
    pub next_better: Option<BudgetPoint>,
    /// All points that it chose from, from cheap to accurate.
    pub front: Vec<BudgetPoint>,
    /// How often the point changed.
    pub changes: u64,
    /// Pictures that took longer than the budget.
    pub beyond_budget: u64,
    /// Points by their share of the refreshes.
    pub shares: BTreeMap<String, f64>,
}

/// A point of the model's front.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BudgetPoint {
    /// Its name.
    pub point: String,
    /// What nine in ten of its pictures are expected to take at most.
    pub expected_ms: f64,
    /// Its error.
    pub error: f64,
}

impl BudgetReport {
    /// A sentence for people.
    pub fn in_words(&self) -> String {
        let BudgetReport { budget_ms, point, expected_ms, .. } = self;
        let next = match &self.next_better {
            Some(next) => format!("next better {} needs {:.1} ms", next.point, next.expected_ms),
            None => "nothing is better".to_owned(),
        };
        format!("{point}, {expected_ms:.1} ms of {budget_ms:.1}; {next}")
    }
}
