//! Flags of the display's budget, and the cost model that it is chosen from.

use super::Failure;
use crate::replay::BudgetPlan;
use clap::Args;
use std::path::PathBuf;
use std::time::Duration;
use warplight_server::costs::{CostError, KnownCosts};

/// Arguments about time and what it buys.
#[derive(Debug, Args)]
pub(super) struct BudgetArgs {
    /// Time for the picture of a refresh in milliseconds: steps and pixels of the warp are as many as fit [default: all,
    /// however long they take].
    #[arg(long, value_name = "T", value_parser = super::replay::positive, conflicts_with = "solver")]
    budget_ms: Option<f64>,
    /// Cost model of --budget-ms and --time-budget-ms; its times are refreshed [default: that beside the scene where there
    /// is one, else the built-in one].
    #[arg(long, value_name = "FILE")]
    cost_model: Option<PathBuf>,
}

impl From<CostError> for Failure {
    fn from(error: CostError) -> Failure {
        Failure::Input(format!("--cost-model: {error}"))
    }
}

impl BudgetArgs {
    /// The model of a scene.
    pub(super) fn model(&self, scene: Option<&str>) -> Result<KnownCosts, Failure> {
        Ok(KnownCosts::of(scene, self.cost_model.as_deref())?)
    }

    /// The display's budget, where there is one.
    pub(super) fn plan(&self, known: &KnownCosts) -> Option<BudgetPlan> {
        let time = Duration::from_secs_f64(self.budget_ms? * 1e-3);
        Some(BudgetPlan { time, table: known.model.display.clone(), model: known.name.clone() })
    }
}
