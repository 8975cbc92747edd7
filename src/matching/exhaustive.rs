//! Exact search: every match under the fitness limit, by branch and bound.
//!
//! Depth first over the anchors of the model. A stereo node is tried for an anchor only where its distance to every
//! node already matched is the model's within a tolerance; what the lengths cost already bounds the fitness from
//! below, so no pixel is read before all lengths fit. Matches may leave anchors unmatched, as long as three (two
//! for a straight part) remain.

use super::fitness::{Judge, MatchedPoint, StereoMatch, UNMATCHED};
use super::nodes::{ImageNode, NodeRole};
use super::problem::{ANCHORS_MAX, StereoNode};
use crate::time::Budget;

/// Limits of the search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params {
    /// Matches of this fitness or more are not found.
    pub fitness_max: f64,
    /// Two nodes' distance may differ from the model's by this many mm.
    pub length_tolerance_mm: f64,
    /// Most matches that are kept; the fittest stay.
    pub matches_max: usize,
}

impl Default for Params {
    fn default() -> Self {
        Self { fitness_max: 1.0, length_tolerance_mm: 6.0, matches_max: 256 }
    }
}

/// Workspace of the exact search.
#[derive(Clone, Debug)]
pub struct Exhaustive {
    params: Params,
    matches: Vec<StereoMatch>,
    steps: u64,
    complete: bool,
}

impl Exhaustive {
    /// Reserves all memory.
    pub fn new(params: Params) -> Self {
        Self { params, matches: Vec::with_capacity(params.matches_max + 1), steps: 0, complete: true }
    }

    /// The matches of the last run, fittest first.
    pub fn matches(&self) -> &[StereoMatch] {
        &self.matches
    }

    /// Nodes of the tree that the last run visited.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// Whether the last run saw the whole tree before its budget was spent.
    pub fn is_complete(&self) -> bool {
        self.complete
    }

    /// Finds the matches of the judge's part among `nodes`.
    pub fn run(
        &mut self,
        judge: &Judge,
        nodes: &[StereoNode],
        left: &[ImageNode],
        right: &[ImageNode],
        budget: Budget,
    ) {
        self.matches.clear();
        self.steps = 0;
        self.complete = true;
        let anchors = judge.model.anchors.len();
        let required = if judge.model.straight { anchors } else { anchors.min(3) };
        let mut tree = Tree { judge, nodes, left, right, budget, spare: anchors - required };
        let mut chosen = [UNMATCHED; ANCHORS_MAX];
        tree.descend(self, 0, &mut chosen, 0.0);
        self.matches.sort_unstable_by(|a, b| a.fitness.total_cmp(&b.fitness));
    }

    fn keep(&mut self, found: StereoMatch) {
        self.matches.push(found);
        if self.matches.len() > self.params.matches_max {
            let worst = (0..self.matches.len())
                .max_by(|&a, &b| self.matches[a].fitness.total_cmp(&self.matches[b].fitness))
                .unwrap_or(0);
            self.matches.swap_remove(worst);
        }
    }
}

struct Tree<'a> {
    judge: &'a Judge<'a>,
    nodes: &'a [StereoNode],
    left: &'a [ImageNode],
    right: &'a [ImageNode],
    budget: Budget,
    /// How many anchors may still stay unmatched.
    spare: usize,
}

impl Tree<'_> {
    fn descend(
        &mut self,
        search: &mut Exhaustive,
        anchor: usize,
        chosen: &mut [u16; ANCHORS_MAX],
        cost: f64,
    ) {
        let model = self.judge.model;
        if anchor == model.anchors.len() {
            self.finish(search, chosen);
            return;
        }
        for n in 0..self.nodes.len() {
            search.steps += 1;
            if self.budget.is_spent(search.steps) {
                search.complete = false;
                return;
            }
            let node = &self.nodes[n];
            if !may_be(model.anchors[anchor].role, node.role) {
                continue;
            }
            let Some(more) = self.length_cost(search, anchor, n, chosen) else { continue };
            if cost + more >= search.params.fitness_max {
                continue;
            }
            chosen[anchor] = n as u16;
            self.descend(search, anchor + 1, chosen, cost + more);
            chosen[anchor] = UNMATCHED;
            if !search.complete {
                return;
            }
        }
        if self.spare > 0 {
            self.spare -= 1;
            self.descend(search, anchor + 1, chosen, cost + self.judge.weights.unmatched);
            self.spare += 1;
        }
    }

    /// What the lengths to the nodes already matched add to the fitness at least; `None` over the tolerance, or
    /// where a picture's node is taken already.
    fn length_cost(&self, search: &Exhaustive, anchor: usize, n: usize, chosen: &[u16]) -> Option<f64> {
        let node = &self.nodes[n];
        let model = self.judge.model;
        let mut cost = 0.0;
        for (before, &c) in chosen[..anchor].iter().enumerate().filter(|(_, c)| **c != UNMATCHED) {
            let other = &self.nodes[c as usize];
            if other.left == node.left || other.right == node.right {
                return None;
            }
            let error = ((other.point_mm - node.point_mm).norm() - model.distance_mm(before, anchor)).abs();
            if error > search.params.length_tolerance_mm {
                return None;
            }
            if model.anchors[anchor]
                .legs
                .iter()
                .any(|l| (l.1 - model.distance_mm(before, anchor)).abs() < 1e-9)
            {
                cost += error * self.judge.weights.length_3d_per_mm / model.spans.len() as f64;
            }
        }
        Some(cost)
    }

    fn finish(&self, search: &mut Exhaustive, chosen: &[u16; ANCHORS_MAX]) {
        let mut points = [None; ANCHORS_MAX];
        for (p, &c) in points.iter_mut().zip(chosen).take(self.judge.model.anchors.len()) {
            if c != UNMATCHED {
                *p = Some(MatchedPoint::new(&self.nodes[c as usize], self.left, self.right));
            }
        }
        let fitness =
            self.judge.terms(&points[..self.judge.model.anchors.len()]).fitness(&self.judge.weights);
        if fitness < search.params.fitness_max {
            search.keep(StereoMatch { nodes: *chosen, fitness });
        }
    }
}

/// Whether a stereo node can be an anchor of the model: an end may be hidden where wires meet, and so may a bend.
pub fn may_be(anchor: NodeRole, node: NodeRole) -> bool {
    anchor == node || node == NodeRole::Junction
}
