//! The plan of a frame: which nodes its ray tree has. It comes from the scene and from nothing else.

use serde::{Deserialize, Serialize};

/// How the light of a node arrives at its parent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Arrival {
    /// The node is the root: seen by the eye.
    Direct,
    /// By reflection at the parent's surface.
    Reflected,
    /// By refraction through the parent's surface.
    Refracted,
}

/// A node of the tree.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Node {
    /// Index of the parent, which always comes first; the root names itself.
    pub parent: u8,
    /// How its light arrives there.
    pub arrival: Arrival,
}

/// Most nodes a plan may have.
pub const MAX_NODES: usize = 15;

/// Nodes in pre-order, the root first.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(try_from = "Vec<Node>", into = "Vec<Node>")]
pub struct Plan {
    nodes: Vec<Node>,
}

/// What is wrong with a list of nodes.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PlanError {
    /// No node, or more than [`MAX_NODES`].
    #[error("a plan has 1 to {MAX_NODES} nodes, found {0}")]
    Count(usize),
    /// Only the first node is the root.
    #[error("node {0}: the first node and no other is the root")]
    Root(usize),
    /// A parent must stand before its child, in pre-order.
    #[error("node {0}: its parent {1} does not come before it in pre-order")]
    Order(usize, u8),
    /// Two children of one parent by the same arrival.
    #[error("node {0}: its parent {1} has such a child already")]
    Twice(usize, u8),
    /// A text that names no nodes.
    #[error("expected nodes like D,R,F,FF: D, and paths of R and F whose beginnings are there, too, found '{0}'")]
    Letters(String),
}

const fn node(parent: u8, arrival: Arrival) -> Node {
    Node { parent, arrival }
}

impl Plan {
    /// {D}: nothing but diffuse surfaces.
    pub fn diffuse() -> Plan {
        Plan { nodes: vec![node(0, Arrival::Direct)] }
    }

    /// {D, R}: mirrors and metals.
    pub fn mirror() -> Plan {
        Plan { nodes: vec![node(0, Arrival::Direct), node(0, Arrival::Reflected)] }
    }

    /// {D, R, F}: one refracting boundary, such as water.
    pub fn water() -> Plan {
        let mut plan = Plan::mirror();
        plan.nodes.push(node(0, Arrival::Refracted));
        plan
    }

    /// {D, R, F, FF}: solids, which light must leave again.
    pub fn solid() -> Plan {
        let mut plan = Plan::water();
        plan.nodes.push(node(2, Arrival::Refracted));
        plan
    }

    /// A plan of these nodes, if they are a tree in pre-order.
    pub fn new(nodes: Vec<Node>) -> Result<Plan, PlanError> {
        if nodes.is_empty() || nodes.len() > MAX_NODES {
            return Err(PlanError::Count(nodes.len()));
        }
        // In pre-order the parent of each node is on the path from the root to the node before it.
        let mut path: Vec<u8> = Vec::new();
        for (index, node) in nodes.iter().enumerate() {
            if (index == 0) != (node.arrival == Arrival::Direct) || (index == 0 && node.parent != 0) {
                return Err(PlanError::Root(index));
            }
            if index > 0 {
                while path.last().is_some_and(|&last| last != node.parent) {
                    path.pop();
                }
                if path.is_empty() {
                    return Err(PlanError::Order(index, node.parent));
                }
                if nodes[1..index].contains(node) {
                    return Err(PlanError::Twice(index, node.parent));
                }
            }
            path.push(index as u8);
        }
        Ok(Plan { nodes })
    }

    /// Its first nodes, as many as there are: children come after their parents, so it is a plan, too.
    pub fn first(&self, nodes: usize) -> Plan {
        Plan { nodes: self.nodes[..nodes.clamp(1, self.nodes.len())].to_vec() }
    }

    /// The nodes, root first.
    pub fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    /// The child of `parent` whose light arrives by `arrival`.
    pub fn child(&self, parent: usize, arrival: Arrival) -> Option<usize> {
        (1..self.nodes.len())
            .find(|&index| usize::from(self.nodes[index].parent) == parent && self.nodes[index].arrival == arrival)
    }

    /// Whether a node has children, and so carries interfaces and normals.
    pub fn has_children(&self, node: usize) -> bool {
        self.nodes.iter().skip(1).any(|child| usize::from(child.parent) == node)
    }

    /// Steps from the root to a node, root first.
    pub fn path(&self, node: usize) -> Vec<usize> {
        let mut path = vec![node];
        let mut at = node;
        while at != 0 {
            at = usize::from(self.nodes[at].parent);
            path.push(at);
        }
        path.reverse();
        path
    }

    /// Short name of a node: D for the root, then the letters of its path, such as FF.
    pub fn letters(&self, node: usize) -> String {
        if node == 0 {
            return "D".to_owned();
        }
        self.path(node)[1..]
            .iter()
            .map(|&step| if self.nodes[step].arrival == Arrival::Reflected { 'R' } else { 'F' })
            .collect()
    }

    /// Long name of a node, as planes are named in reports: root, reflect, refract.refract.
    pub fn name(&self, node: usize) -> String {
        if node == 0 {
            return "root".to_owned();
        }
        let step = |&step: &usize| if self.nodes[step].arrival == Arrival::Reflected { "reflect" } else { "refract" };
        self.path(node)[1..].iter().map(step).collect::<Vec<_>>().join(".")
    }
}

/// The letters of its nodes, in any order: `D,R,F,FF`.
impl std::str::FromStr for Plan {
    type Err = PlanError;
    fn from_str(text: &str) -> Result<Plan, PlanError> {
        let unknown = || PlanError::Letters(text.to_owned());
        let mut names: Vec<String> = text.split(',').map(|name| name.trim().to_uppercase()).collect();
        let root = names.iter().position(|name| name == "D").ok_or_else(unknown)?;
        names[root].clear();
        // Pre-order, with R before F.
        names.sort_by_key(|name| name.replace('R', "A"));
        let mut nodes = Vec::new();
        for (index, name) in names.iter().enumerate() {
            nodes.push(match name.chars().last() {
                None => node(0, Arrival::Direct),
                Some(last) => {
                    let parent =
                        names[..index].iter().position(|parent| *parent == name[..name.len() - last.len_utf8()]);
                    let parent = parent.and_then(|parent| u8::try_from(parent).ok()).ok_or_else(unknown)?;
                    match last {
                        'R' => node(parent, Arrival::Reflected),
                        'F' => node(parent, Arrival::Refracted),
                        _ => return Err(unknown()),
                    }
                }
            });
        }
        Plan::new(nodes)
    }
}

impl TryFrom<Vec<Node>> for Plan {
    type Error = PlanError;
    fn try_from(nodes: Vec<Node>) -> Result<Plan, PlanError> {
        Plan::new(nodes)
    }
}

impl From<Plan> for Vec<Node> {
    fn from(plan: Plan) -> Vec<Node> {
        plan.nodes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_named_plans_are_plans() {
        for (plan, letters) in [
            (Plan::diffuse(), vec!["D"]),
            (Plan::mirror(), vec!["D", "R"]),
            (Plan::water(), vec!["D", "R", "F"]),
            (Plan::solid(), vec!["D", "R", "F", "FF"]),
        ] {
            assert_eq!(Plan::new(plan.nodes().to_vec()).unwrap(), plan);
            let found: Vec<_> = (0..plan.nodes().len()).map(|node| plan.letters(node)).collect();
            assert_eq!(found, letters);
        }
        assert_eq!(Plan::solid().name(3), "refract.refract");
        assert_eq!(Plan::solid().child(2, Arrival::Refracted), Some(3));
        assert_eq!(Plan::solid().child(2, Arrival::Reflected), None);
    }

    #[test]
    fn what_is_no_tree_in_pre_order_is_refused() {
        let root = node(0, Arrival::Direct);
        let reflected = node(0, Arrival::Reflected);
        let refracted = node(0, Arrival::Refracted);
        assert_eq!(Plan::new(vec![]), Err(PlanError::Count(0)));
        assert_eq!(Plan::new(vec![root; MAX_NODES + 1]), Err(PlanError::Count(MAX_NODES + 1)));
        assert_eq!(Plan::new(vec![reflected]), Err(PlanError::Root(0)));
        assert_eq!(Plan::new(vec![root, root]), Err(PlanError::Root(1)));
        assert_eq!(Plan::new(vec![root, reflected, reflected]), Err(PlanError::Twice(2, 0)));
        assert_eq!(Plan::new(vec![root, node(7, Arrival::Reflected)]), Err(PlanError::Order(1, 7)));
        // The child of node 1 stands behind node 2: not pre-order.
        let late = node(1, Arrival::Refracted);
        assert_eq!(Plan::new(vec![root, reflected, refracted, late]), Err(PlanError::Order(3, 1)));
    }

    #[test]
    fn plans_are_read_from_the_letters_of_their_nodes() {
        let names = |plan: &Plan| (0..plan.nodes().len()).map(|node| plan.letters(node)).collect::<Vec<_>>().join(",");
        for plan in [Plan::diffuse(), Plan::mirror(), Plan::water(), Plan::solid()] {
            assert_eq!(names(&plan).parse::<Plan>(), Ok(plan));
        }
        assert_eq!(names(&"ff, r, d, f, fr, rr, ffr".parse::<Plan>().unwrap()), "D,R,RR,F,FR,FF,FFR");
        for bad in ["", "R", "D,X", "D,FF", "D,D", "D,R,R", "D,é"] {
            assert!(bad.parse::<Plan>().is_err(), "{bad}");
        }
    }
}
