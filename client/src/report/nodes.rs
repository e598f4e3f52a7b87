//! What mode `specular` lacked, node by node: how much of it is seen, not found, and filled.
//!
//! Fractions of the compared refreshes, as the warp counts them ([`crate::warp::NodeStatistics`]): `seen` of all
//! pixels, `undefined` and `filled` of those at which the node is seen. They tell which node a picture is lost in.

use crate::measure::Percentiles;
use crate::warp::NodeStatistics;
use serde::{Deserialize, Serialize};
use warplight_protocol::frame::Plan;

/// How mode `specular` was set, and what its nodes lacked.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SpecularReport {
    /// How pictures of children were searched.
    pub solver: String,
    /// Where normals came from.
    pub normals: String,
    /// The nodes of the plan; empty where nothing was compared.
    pub nodes: Vec<NodeReport>,
}

/// What one node lacked, over all compared refreshes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NodeReport {
    /// Name of the node.
    pub node: String,
    /// Pixels at which it is seen, as a fraction of all.
    pub seen: Percentiles,
    /// Of those, the ones whose place in the frame was not found.
    pub undefined: Percentiles,
    /// Of those, the ones that were filled from around them.
    pub filled: Percentiles,
}

impl NodeReport {
    /// The nodes of a plan, from the statistics of each refresh.
    pub fn of(plan: &Plan, refreshes: &[&[NodeStatistics]]) -> Vec<NodeReport> {
        let node = |index: usize| {
            let spread = |field: fn(&NodeStatistics) -> f64| {
                let samples: Vec<f64> = refreshes.iter().filter_map(|nodes| nodes.get(index)).map(field).collect();
                Percentiles::from_samples(&samples).ok()
            };
            Some(NodeReport {
                node: plan.name(index),
                seen: spread(|node| node.seen)?,
                undefined: spread(|node| node.undefined)?,
                filled: spread(|node| node.filled)?,
            })
        };
        (0..plan.nodes().len()).filter_map(node).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nodes_are_those_of_the_plan_and_without_refreshes_there_are_none() {
        let picture = |undefined| {
            let mut nodes = [NodeStatistics::default(); 8];
            nodes[1] = NodeStatistics { seen: 0.5, undefined, filled: 0.25 };
            nodes
        };
        let (a, b) = (picture(0.1), picture(0.3));
        let nodes = NodeReport::of(&Plan::water(), &[&a, &b]);
        assert_eq!(nodes.len(), 3);
        assert!((nodes[1].undefined.p50 - 0.2).abs() < 1e-12 && nodes[1].seen.count == 2);
        assert!(NodeReport::of(&Plan::water(), &[]).is_empty());
    }
}
