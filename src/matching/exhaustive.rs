//! Exact search: every match under the fitness limit, by branch and bound.
//!
//! Depth first over the anchors of the model. Every anchor has a domain: the candidates that it may still be. Matching
//! an anchor takes out of all other domains what is not at the model's distance from it (a row of bits out of
//! [`rows`] for the first node, a look at the few that are left for all others), so a pair of the wrong
//! length is never visited. Next comes the anchor with the fewest candidates among those that a span joins to a
//! matched one; it is matched with each of them in turn, then left out, as long as enough remain ([`MatchModel::required`](super::problem::MatchModel::required)). What lengths, gaps, background and
//! left-out anchors cost already bounds the fitness from below; a span's pixels are read when its second end is
//! matched and the lengths have passed.
//!
//! Given are all matches under the limit but those that are part of a fitter one with one node more: they hold the
//! same pose with less to prove it.
//!
//! ```
//! use pickcell::matching::drawn::DrawnScene;
//! use pickcell::matching::exhaustive::{Exhaustive, Limits};
//! use pickcell::matching::found::Found;
//! use pickcell::time::Budget;
//!
//! let scene = DrawnScene::new(2, 3, 1); // three rods, two nodes each
//! let mut found = Found::new(16);
//! let mut search = Exhaustive::new(scene.candidates.all().len());
//! let limits = Limits { fitness_max: 0.6, budget: Budget::Iterations(1000), steps_max: u64::MAX };
//! search.run(&scene.judge(), &scene.candidates, limits, &mut found);
//! assert!(search.is_complete());
//! assert_eq!(found.matches().len(), 6, "each rod, either way round");
//! ```

use super::candidates::{Candidate, Candidates};
use super::fitness::{Judge, StereoMatch, UNMATCHED, distance_mm, is_bare, may_be};
use super::found::Found;
use super::problem::ANCHORS_MAX;
use super::rows::{self, CHUNK};
use crate::time::Budget;
use crate::vision::level::Level;

/// Where the search ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Matches of this fitness or more are not found.
    pub fitness_max: f64,
    /// What it may use up.
    pub budget: Budget,
    /// Most nodes of the tree that are visited.
    pub steps_max: u64,
}

/// Workspace of the exact search.
#[derive(Clone, Debug)]
pub struct Exhaustive {
    level: Level,
    /// One bit a candidate and anchor: what looks right.
    looks_right: Vec<u64>,
    /// One bit a candidate and anchor: what is at the right distance from the first node.
    rows: Vec<u64>,
    /// The domains of all depths but the first, one list after the other.
    lists: Vec<u16>,
    /// Where the list of a depth and an anchor is.
    domains: Vec<[(u32, u32); ANCHORS_MAX]>,
    nodes_max: usize,
    steps: u64,
    complete: bool,
}

/// Entries of all lists together, for every candidate that there is memory for.
const LISTS_PER_NODE: usize = 4 * ANCHORS_MAX;

impl Exhaustive {
    /// Reserves all memory for up to `nodes_max` candidates.
    pub fn new(nodes_max: usize) -> Self {
        let words = nodes_max.div_ceil(CHUNK).max(1) * ANCHORS_MAX;
        Self {
            level: Level::detect(),
            looks_right: vec![0; words],
            rows: vec![0; words],
            lists: Vec::with_capacity(LISTS_PER_NODE * nodes_max),
            domains: vec![[(0, 0); ANCHORS_MAX]; ANCHORS_MAX + 1],
            nodes_max,
            steps: 0,
            complete: true,
        }
    }

    /// Nodes of the tree that the last run visited.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// Whether the last run saw the whole tree before its budget was spent.
    pub fn is_complete(&self) -> bool {
        self.complete
    }

    /// Adds the matches of the judge's part within `limits` to `found`. Candidates beyond the
    /// number that there is memory for are not looked at; the search is then not complete.
    pub fn run(&mut self, judge: &Judge, candidates: &Candidates, limits: Limits, found: &mut Found) {
        self.steps = 0;
        self.complete = true;
        if candidates.all().is_empty() {
            return;
        }
        if candidates.all().len() > self.nodes_max {
            self.complete = false;
            return;
        }
        let anchors = judge.model.anchors.len();
        let mut tree = Tree {
            search: self,
            judge,
            candidates,
            words: candidates.points().words(),
            limits,
            found,
            chosen: [None; ANCHORS_MAX],
            left_out: 0,
            spare: anchors - judge.model.required(),
        };
        tree.start();
        let everyone = if anchors == 32 { u32::MAX } else { (1 << anchors) - 1 };
        tree.descend(0, everyone, Cost::default());
    }
}

/// What the matched nodes cost already, before weights and means.
#[derive(Clone, Copy, Debug, Default)]
struct Cost {
    length_3d_mm: f32,
    length_2d_px: f32,
    missing: u32,
    gap_px: f32,
    left_out: u32,
}

struct Tree<'a, 'j> {
    search: &'a mut Exhaustive,
    judge: &'a Judge<'j>,
    candidates: &'a Candidates,
    words: usize,
    limits: Limits,
    found: &'a mut Found,
    chosen: [Option<u16>; ANCHORS_MAX],
    /// Anchors that were left out, one bit each.
    left_out: u32,
    /// How many anchors may be left out.
    spare: usize,
}

impl Tree<'_, '_> {
    fn row(&self, anchor: usize) -> std::ops::Range<usize> {
        anchor * self.words..(anchor + 1) * self.words
    }

    /// What may be each anchor before anything is matched.
    fn start(&mut self) {
        self.search.lists.clear();
        for (a, anchor) in self.judge.model.anchors.iter().enumerate() {
            let row = self.row(a);
            let domain = &mut self.search.looks_right[row];
            domain.fill(0);
            for (n, c) in self.candidates.all().iter().enumerate() {
                domain[n / CHUNK] |= ((c.explained && may_be(anchor.role, c.role)) as u64) << (n % CHUNK);
            }
        }
    }

    /// What a bound is compared with; its rounding must not cost a match. Where no more matches are kept, those that
    /// are no fitter than the kept ones need not be found.
    fn most(&self) -> f64 {
        self.found.threshold(self.limits.fitness_max) * (1.0 + 1e-6)
    }

    /// What is matched costs at least this in the end.
    fn bound(&self, cost: &Cost) -> f64 {
        let (w, model) = (&self.judge.weights, self.judge.model);
        // spans of an anchor that is left out are not measured: all others are in the mean at most
        let (mut spans, mut looks) = (0, 0);
        for span in model.spans.iter().filter(|s| (self.left_out >> s.from | self.left_out >> s.to) & 1 == 0)
        {
            (spans, looks) = (spans + 1, looks + 2 * span.looks);
        }
        let (spans, looks) = (spans.max(1) as f64, looks.max(1) as f64);
        cost.length_3d_mm as f64 * w.length_3d_per_mm / spans
            + cost.length_2d_px as f64 * w.length_2d_per_px / (2.0 * spans)
            + cost.missing as f64 * w.missing / looks
            + cost.gap_px as f64 * w.gap_per_px / model.anchors.len() as f64
            + cost.left_out as f64 * w.unmatched
    }

    /// `open`: the anchors not decided yet, one bit each.
    fn descend(&mut self, depth: usize, open: u32, cost: Cost) {
        if self.bound(&cost) >= self.most() {
            return;
        }
        if open == 0 {
            self.finish();
            return;
        }
        let Some(anchor) = self.next_anchor(depth, open) else { return };
        let rest = open & !(1 << anchor);
        if depth == 0 {
            for w in 0..self.words {
                let mut bits = self.search.looks_right[self.row(anchor).start + w];
                while bits != 0 && self.search.complete {
                    let n = w * CHUNK + bits.trailing_zeros() as usize;
                    bits &= bits - 1;
                    self.step(depth, anchor, n, rest, cost);
                }
            }
        } else {
            let (begin, end) = self.search.domains[depth][anchor];
            for k in begin..end {
                self.step(depth, anchor, self.search.lists[k as usize] as usize, rest, cost);
                if !self.search.complete {
                    return;
                }
            }
        }
        if !self.search.complete {
            return;
        }
        if (self.left_out.count_ones() as usize) < self.spare {
            self.left_out |= 1 << anchor;
            // the domains of this depth stay as they are: nothing was matched
            self.descend(depth, rest, Cost { left_out: cost.left_out + 1, ..cost });
            self.left_out &= !(1 << anchor);
        }
    }

    /// Matches candidate `n` with `anchor` and goes on from there.
    fn step(&mut self, depth: usize, anchor: usize, n: usize, rest: u32, cost: Cost) {
        let steps = self.search.steps;
        if steps == self.limits.steps_max || self.limits.budget.is_spent(steps) {
            self.search.complete = false;
            return;
        }
        self.search.steps += 1;
        if let Some(cost) = self.cost_with(anchor, n, cost) {
            let lists = self.search.lists.len();
            self.chosen[anchor] = Some(n as u16);
            if self.narrow(depth, anchor, n, rest) {
                self.descend(depth + 1, rest, cost);
            }
            self.chosen[anchor] = None;
            self.search.lists.truncate(lists);
        }
    }

    /// The open anchor to be matched next: of those that a span joins to a matched one the one with the fewest
    /// candidates, else any. `None` where too many have no candidate left.
    fn next_anchor(&self, depth: usize, open: u32) -> Option<usize> {
        if depth == 0 {
            return Some(open.trailing_zeros() as usize);
        }
        let mut joined = 0u32;
        for span in &self.judge.model.spans {
            let (from, to) = (self.chosen[span.from].is_some(), self.chosen[span.to].is_some());
            joined |= (from as u32) << span.to | (to as u32) << span.from;
        }
        let (mut best, mut least, mut empty) = (open.trailing_zeros() as usize, u32::MAX, 0);
        let mut bits = open;
        while bits != 0 {
            let a = bits.trailing_zeros() as usize;
            bits &= bits - 1;
            let (begin, end) = self.search.domains[depth][a];
            let count = end - begin;
            empty += (count == 0) as u32;
            let rank = if joined >> a & 1 == 1 { count } else { count.saturating_add(1 << 20) };
            if rank < least {
                (best, least) = (a, rank);
            }
        }
        ((empty + self.left_out.count_ones()) as usize <= self.spare).then_some(best)
    }

    /// The cost with candidate `n` for `anchor`; `None` where a span of it puts the fitness over the limit.
    fn cost_with(&self, anchor: usize, n: usize, mut cost: Cost) -> Option<Cost> {
        let (model, all) = (self.judge.model, self.candidates.all());
        let new = &all[n];
        cost.gap_px += new.gap_px;
        let touching = |k: usize| -> Option<&Candidate> {
            let span = &model.spans[k];
            let other = match (span.from == anchor, span.to == anchor) {
                (true, false) => span.to,
                (false, true) => span.from,
                _ => return None,
            };
            self.chosen[other].map(|c| &all[c as usize])
        };
        let most = self.most();
        for (k, span) in model.spans.iter().enumerate() {
            let Some(other) = touching(k) else { continue };
            cost.length_3d_mm += self.judge.length_3d_mm(span, new, other);
        }
        if self.bound(&cost) >= most {
            return None;
        }
        for (k, span) in model.spans.iter().enumerate() {
            let Some(other) = touching(k) else { continue };
            cost.length_2d_px += self.judge.length_2d_px(span, new, other);
            if self.bound(&cost) >= most {
                return None;
            }
            // the last node of a match is judged as a whole anyway
            if model.spans.len() > 1 {
                let missing = self.judge.missing(span, new, other, span.looks);
                cost.missing += missing;
                if is_bare(span, missing) || self.bound(&cost) >= most {
                    return None;
                }
            }
        }
        Some(cost)
    }

    /// Lists the domains of the next depth: of every open or left-out anchor, what is at the model's distance. Says
    /// whether there was room.
    fn narrow(&mut self, depth: usize, anchor: usize, n: usize, open: u32) -> bool {
        let (judge, words) = (self.judge, self.words);
        let (model, all) = (judge.model, self.candidates.all());
        let new = &all[n];
        let wanted = open | self.left_out;
        if depth == 0 {
            let mut limits: [rows::Limits; ANCHORS_MAX] = [(1.0, 0.0); ANCHORS_MAX];
            for (a, limits) in limits.iter_mut().enumerate().take(model.anchors.len()) {
                if wanted >> a & 1 == 1 {
                    // a little wider; what is over the tolerance is sorted out below
                    let tolerance_mm = judge.length_tolerance_mm + 1e-3;
                    *limits = rows::limits(model.distance_mm(anchor, a), tolerance_mm);
                }
            }
            let limits = &limits[..model.anchors.len()];
            let points = self.candidates.points();
            rows::within(self.search.level, points, new.point_mm, limits, &mut self.search.rows);
        }
        let Exhaustive { lists, domains, rows, looks_right, .. } = &mut *self.search;
        let mut bits = wanted;
        while bits != 0 {
            let a = bits.trailing_zeros() as usize;
            bits &= bits - 1;
            let (wanted_mm, tolerance_mm) =
                (model.distance_mm(anchor, a) as f32, judge.length_tolerance_mm as f32);
            let fits = |c: usize| {
                let other = &all[c];
                other.left != new.left
                    && other.right != new.right
                    && (distance_mm(new, other) - wanted_mm).abs() <= tolerance_mm
            };
            let first = lists.len() as u32;
            if depth == 0 {
                for w in 0..words {
                    let mut bits = rows[a * words + w] & looks_right[a * words + w];
                    while bits != 0 {
                        let c = w * CHUNK + bits.trailing_zeros() as usize;
                        bits &= bits - 1;
                        if fits(c) && lists.len() < lists.capacity() {
                            lists.push(c as u16);
                        }
                    }
                }
            } else {
                let (begin, end) = domains[depth][a];
                for k in begin..end {
                    let c = lists[k as usize];
                    if fits(c as usize) && lists.len() < lists.capacity() {
                        lists.push(c);
                    }
                }
            }
            domains[depth + 1][a] = (first, lists.len() as u32);
        }
        let room = lists.len() < lists.capacity();
        self.search.complete &= room;
        room
    }

    fn finish(&mut self) {
        let all = self.candidates.all();
        let chosen = self.chosen.map(|c| c.map(|c| &all[c as usize]));
        let anchors = self.judge.model.anchors.len();
        let limit = self.found.threshold(self.limits.fitness_max);
        let Some(terms) = self.judge.terms(&chosen[..anchors], limit) else { return };
        if !terms.is_match() {
            return;
        }
        let fitness = terms.fitness(&self.judge.weights);
        if self.is_part_of_a_fitter_one(chosen, fitness) {
            return;
        }
        let mut nodes = [UNMATCHED; ANCHORS_MAX];
        for (node, c) in nodes.iter_mut().zip(&chosen) {
            *node = c.map_or(UNMATCHED, |c| c.stereo);
        }
        self.found.insert(StereoMatch { nodes, fitness });
    }

    /// Whether one of the anchors left out could be matched too, for a fitness no worse.
    fn is_part_of_a_fitter_one<'c>(
        &'c self,
        mut chosen: [Option<&'c Candidate>; ANCHORS_MAX],
        fitness: f64,
    ) -> bool {
        let anchors = self.judge.model.anchors.len();
        let depth = chosen.iter().flatten().count();
        for a in (0..anchors).filter(|a| self.left_out >> a & 1 == 1) {
            let (begin, end) = self.search.domains[depth][a];
            // equal is no worse
            let limit = fitness * (1.0 + 1e-9) + 1e-12;
            for k in begin..end {
                chosen[a] = Some(&self.candidates.all()[self.search.lists[k as usize] as usize]);
                if self.judge.terms(&chosen[..anchors], limit).is_some_and(|t| t.is_match()) {
                    return true;
                }
                chosen[a] = None;
            }
        }
        false
    }
}

#[cfg(test)]
#[path = "exhaustive_tests.rs"]
mod tests;
