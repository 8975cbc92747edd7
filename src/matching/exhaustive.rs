//! Exact search: every match under the fitness limit, by branch and bound.
//!
//! Depth first over the anchors of the model. Every anchor has a domain: the candidates that it may still be. Matching
//! an anchor takes out of all other domains what is not at the model's distance from it (one AND with rows of bits out
//! of [`neighbours`](super::neighbours)), so a pair of the wrong length is never visited. Next comes the anchor with the
//! fewest candidates among those that a span joins to a matched one; it is matched with each of them in turn, then left
//! out, as long as enough remain ([`MatchModel::required`](super::problem::MatchModel::required)). What lengths, gaps,
//! background and left-out anchors cost already bounds the fitness from below; a span's pixels are read when its second
//! end is matched and the lengths have passed, and only once ([`measures`](super::measures)). Where an anchor is left out,
//! a line through it is a span from then on.
//!
//! Given are all matches under the limit but those that are part of a fitter one with one node more: they hold the
//! same pose with less to prove it. Where a left-out anchor has a candidate that goes with all that may still be
//! matched, and costs less than leaving it out whatever that will be, all below is such a part and is not visited. Of
//! matches that are the same turned, where the part looks the same turned, one is given.
//!
//! Parts of two nodes, which all straight wires are, need none of this: their pairs are listed in `pairs.rs`, either way
//! round.
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
use super::costs::{Cost, Rates};
use super::fitness::{Judge, ROUNDING, StereoMatch, Terms, UNMATCHED, may_be};
use super::found::Found;
pub use super::limits::Limits;
use super::measures::Measures;
use super::neighbours::Neighbours;
use super::pairs::is_pair;
use super::problem::{ANCHORS_MAX, Span};
use super::rows::{self, CHUNK};
use crate::level::Level;
use crate::part::EDGES_MAX;

/// Workspace of the exact search.
#[derive(Clone, Debug)]
pub struct Exhaustive {
    pub(super) level: Level,
    pub(super) neighbours: Neighbours,
    pub(super) measures: Measures,
    /// For every depth and anchor a row of one bit a candidate: what the anchor may still be.
    pub(super) domains: Vec<u64>,
    /// How many those are.
    pub(super) counts: Vec<[u32; ANCHORS_MAX]>,
    /// The spans at every anchor, each with its other anchor.
    joints: Vec<(u16, u16)>,
    joints_from: [u32; ANCHORS_MAX + 1],
    nodes_max: usize,
    pub(super) steps: u64,
    pub(super) complete: bool,
}

impl Exhaustive {
    /// Reserves all memory for up to `nodes_max` candidates.
    pub fn new(nodes_max: usize) -> Self {
        let words = nodes_max.div_ceil(CHUNK).max(1) * ANCHORS_MAX;
        Self {
            level: Level::detect(),
            neighbours: Neighbours::new(nodes_max),
            measures: Measures::new(),
            domains: vec![0; words * (ANCHORS_MAX + 1)],
            counts: vec![[0; ANCHORS_MAX]; ANCHORS_MAX + 1],
            // Pieces of edges, which bend at anchors, and a line between any two anchors, at both of their ends.
            joints: Vec::with_capacity(2 * (EDGES_MAX + ANCHORS_MAX + ANCHORS_MAX * ANCHORS_MAX / 2)),
            joints_from: [0; ANCHORS_MAX + 1],
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

    /// Adds the matches of the judge's part within `limits` to `found`, which holds none of them yet. Where there
    /// are more candidates than memory for them, none is looked at; the search is then not complete.
    pub fn run(&mut self, judge: &Judge, candidates: &Candidates, limits: Limits, found: &mut Found) {
        self.steps = 0;
        self.complete = true;
        let anchors = judge.model.anchors.len();
        if candidates.all().is_empty() || anchors == 0 {
            return;
        }
        if candidates.all().len() > self.nodes_max {
            self.complete = false;
            return;
        }
        if is_pair(judge.model) {
            self.run_pairs(judge, candidates, limits, found);
        } else {
            self.run_tree(judge, candidates, limits, found);
        }
    }

    fn run_tree(&mut self, judge: &Judge, candidates: &Candidates, limits: Limits, found: &mut Found) {
        let anchors = judge.model.anchors.len();
        self.join(judge);
        self.neighbours.begin(judge.model, candidates, judge.length_tolerance_mm);
        self.measures.begin(judge, found.threshold(limits.fitness_max) * ROUNDING);
        let mut tree = Tree {
            search: self,
            judge,
            candidates,
            all: candidates.all(),
            words: candidates.points().words(),
            limits,
            found,
            chosen: [UNMATCHED; ANCHORS_MAX],
            matched: 0,
            left_out: 0,
            rates: [Rates::default(); ANCHORS_MAX + 1],
            spare: anchors as u32 - judge.model.required() as u32,
        };
        tree.rates[0] = tree.rates_now();
        tree.start();
        let everyone = u32::MAX >> (32 - anchors);
        tree.descend(0, everyone, Cost::default());
    }

    /// Lists the spans at every anchor.
    fn join(&mut self, judge: &Judge) {
        self.joints.clear();
        for a in 0..judge.model.anchors.len() {
            for (k, span) in judge.model.spans.iter().enumerate() {
                if span.from != span.to && (span.from == a || span.to == a) {
                    self.joints.push((k as u16, (span.from + span.to - a) as u16));
                }
            }
            self.joints_from[a + 1] = self.joints.len() as u32;
        }
    }
}

pub(super) struct Tree<'a, 'j> {
    pub(super) search: &'a mut Exhaustive,
    pub(super) judge: &'a Judge<'j>,
    pub(super) candidates: &'a Candidates,
    pub(super) all: &'a [Candidate],
    pub(super) words: usize,
    pub(super) limits: Limits,
    pub(super) found: &'a mut Found,
    pub(super) chosen: [u16; ANCHORS_MAX],
    /// Anchors that are matched, one bit each.
    pub(super) matched: u32,
    /// Anchors that were left out, one bit each.
    pub(super) left_out: u32,
    /// By how many were left out on the way here.
    pub(super) rates: [Rates; ANCHORS_MAX + 1],
    /// How many anchors may be left out.
    spare: u32,
}

impl<'a, 'j> Tree<'a, 'j> {
    pub(super) fn anchors(&self) -> usize {
        self.judge.model.anchors.len()
    }

    /// The domains of a depth, row by row.
    #[inline]
    pub(super) fn domains(&self, depth: usize) -> &[u64] {
        let all = self.anchors() * self.words;
        &self.search.domains[depth * all..(depth + 1) * all]
    }

    #[inline]
    pub(super) fn joints(&self, anchor: usize) -> std::ops::Range<usize> {
        self.search.joints_from[anchor] as usize..self.search.joints_from[anchor + 1] as usize
    }

    #[inline]
    pub(super) fn joint(&self, at: usize) -> (usize, usize) {
        let (span, other) = self.search.joints[at];
        (span as usize, other as usize)
    }

    /// What may be each anchor before anything is matched.
    fn start(&mut self) {
        let words = self.words;
        for (a, anchor) in self.judge.model.anchors.iter().enumerate() {
            let domain = &mut self.search.domains[a * words..(a + 1) * words];
            for (word, candidates) in domain.iter_mut().zip(self.all.chunks(CHUNK)) {
                *word = 0;
                for (n, c) in candidates.iter().enumerate() {
                    *word |= ((c.explained && may_be(anchor.role, c.role)) as u64) << n;
                }
            }
            self.search.counts[0][a] = domain.iter().map(|w| w.count_ones()).sum();
        }
    }

    /// Whether span `k` is one, as far as anchors are left out now.
    #[inline]
    pub(super) fn is_span(&self, k: usize) -> bool {
        self.judge.model.spans[k].through & !self.left_out == 0
    }

    /// The lines through this anchor that are spans where it is left out, and both ends of which are matched.
    pub(super) fn lines_through(&self, anchor: usize) -> impl Iterator<Item = usize> + use<'a, 'j> {
        let (matched, left_out) = (self.matched, self.left_out);
        let is_one = move |span: &Span| {
            let are_matched = matched >> span.from & matched >> span.to & 1 == 1;
            span.through >> anchor & 1 == 1 && span.through & !left_out == 0 && are_matched
        };
        self.judge.model.lines().filter(move |(_, span)| is_one(span)).map(|(k, _)| k)
    }

    /// `open`: the anchors not decided yet, one bit each.
    fn descend(&mut self, depth: usize, open: u32, cost: Cost) {
        if open == 0 {
            self.finish(depth);
            return;
        }
        if self.left_out != 0 && self.is_dominated(depth, open, &cost) {
            return;
        }
        let anchor = self.next_anchor(depth, open);
        let rest = open & !(1 << anchor);
        for w in 0..self.words {
            let mut bits = self.domains(depth)[anchor * self.words + w];
            while bits != 0 {
                let n = w * CHUNK + bits.trailing_zeros() as usize;
                bits &= bits - 1;
                self.step(depth, anchor, n, rest, cost);
                if !self.search.complete {
                    return;
                }
            }
        }
        if self.left_out.count_ones() < self.spare && !self.is_turned(anchor, None) {
            self.left_out |= 1 << anchor;
            // the domains of this depth stay as they are: nothing was matched
            if self.is_viable(depth, rest) {
                self.rates[self.left_out.count_ones() as usize] = self.rates_now();
                if let Some(cost) = self.cost_without(anchor, cost) {
                    self.descend(depth, rest, cost);
                }
            }
            self.left_out &= !(1 << anchor);
        }
    }

    /// Matches candidate `n` with `anchor` and goes on from there.
    #[inline]
    fn step(&mut self, depth: usize, anchor: usize, n: usize, rest: u32, cost: Cost) {
        if !self.limits.allow_step(&mut self.search.steps) {
            self.search.complete = false;
            return;
        }
        if self.is_turned(anchor, Some(n)) || self.is_out_of_length(anchor, n, cost) {
            return;
        }
        // What is quicker comes next: pixels, or rows that have to be made.
        let wanted = rest | self.left_out;
        let narrow_first = self.search.neighbours.is_quick(anchor, n);
        if wanted != 0 && narrow_first && !self.narrow(depth, anchor, n, wanted, rest) {
            return;
        }
        let Some(cost) = self.cost_with(anchor, n, cost) else { return };
        if wanted != 0 && !narrow_first && !self.narrow(depth, anchor, n, wanted, rest) {
            return;
        }
        self.chosen[anchor] = n as u16;
        self.matched |= 1 << anchor;
        self.descend(depth + 1, rest, cost);
        self.matched &= !(1 << anchor);
        self.chosen[anchor] = UNMATCHED;
    }

    /// Whether enough of the open anchors have a candidate left.
    #[inline]
    fn is_viable(&self, depth: usize, open: u32) -> bool {
        let (counts, mut empty, mut bits) = (&self.search.counts[depth], self.left_out.count_ones(), open);
        while bits != 0 {
            empty += (counts[bits.trailing_zeros() as usize] == 0) as u32;
            bits &= bits - 1;
        }
        empty <= self.spare
    }

    /// The open anchor to be matched next: of those that a span joins to a matched one the one with the fewest
    /// candidates, else any with the fewest.
    fn next_anchor(&self, depth: usize, open: u32) -> usize {
        let (mut best, mut least, mut bits) = (0, u32::MAX, open);
        while bits != 0 {
            let a = bits.trailing_zeros() as usize;
            bits &= bits - 1;
            let joined = self.is_joined(a);
            let rank = self.search.counts[depth][a] + if joined { 0 } else { 1 << 20 };
            if rank < least {
                (best, least) = (a, rank);
            }
        }
        best
    }

    /// Whether a span joins it to a matched anchor.
    #[inline]
    pub(super) fn is_joined(&self, anchor: usize) -> bool {
        self.joints(anchor).any(|at| {
            let (k, other) = self.joint(at);
            self.matched >> other & 1 == 1 && self.is_span(k)
        })
    }

    /// The domains of the next depth: of the wanted anchors, what is at the model's distance. Says whether enough of the
    /// open ones have any.
    fn narrow(&mut self, depth: usize, anchor: usize, n: usize, wanted: u32, open: u32) -> bool {
        let (anchors, words) = (self.anchors(), self.words);
        let Exhaustive { level, neighbours, domains, counts, .. } = &mut *self.search;
        let rows = neighbours.of(self.candidates, anchor, n);
        let (before, after) = domains.split_at_mut((depth + 1) * anchors * words);
        let before = &before[depth * anchors * words..];
        rows::intersect(*level, [before, rows], words, wanted, after, &mut counts[depth + 1]);
        self.is_viable(depth + 1, open)
    }

    fn finish(&mut self, depth: usize) {
        let limit = self.limit();
        let Some(terms) = self.terms(limit) else { return };
        let fitness = terms.fitness(&self.judge.weights);
        if self.is_part_of_a_fitter_one(depth, fitness) {
            return;
        }
        let mut nodes = [UNMATCHED; ANCHORS_MAX];
        for (node, &n) in nodes.iter_mut().zip(&self.chosen[..self.anchors()]) {
            *node = self.all.get(n as usize).map_or(UNMATCHED, |c| c.stereo);
        }
        self.found.insert_new(StereoMatch { nodes, fitness });
    }

    /// What [`Judge::terms`] gives for the chosen candidates, which contradict each other in nothing but that a span may
    /// be bare.
    fn terms(&mut self, limit: f64) -> Option<Terms> {
        let anchors = self.anchors();
        let (mut matched, mut gap_px) = (0u32, 0f32);
        for (a, &n) in self.chosen[..anchors].iter().enumerate() {
            if let Some(c) = self.all.get(n as usize) {
                (matched, gap_px) = (matched | 1 << a, gap_px + c.gap_px);
            }
        }
        let count = matched.count_ones() as usize;
        let (mut length_3d_mm, mut length_2d_px, mut missing) = (0f64, 0f32, 0);
        let (mut spans, mut looks, mut joined) = (0.0, 0, 0u32);
        for (k, span) in self.judge.model.spans.iter().enumerate() {
            let (from, to) = (self.chosen[span.from], self.chosen[span.to]);
            if from == UNMATCHED || to == UNMATCHED || span.through & matched != 0 {
                continue;
            }
            let measured = self.search.measures.span(self.judge, self.all, k, from, to)?;
            length_3d_mm += measured.length_3d_mm as f64;
            length_2d_px += measured.length_2d_px;
            missing += measured.missing;
            (spans, looks) = (spans + 1.0, looks + 2 * span.looks);
            joined |= 1 << span.from | 1 << span.to;
        }
        let chosen = || self.chosen.map(|n| self.all.get(n as usize));
        if spans == 0.0 {
            return self.judge.terms(&chosen()[..anchors], limit).filter(|t| t.is_match());
        }
        let mut terms = Terms {
            length_3d_mm: length_3d_mm / spans,
            length_2d_px: length_2d_px as f64 / (2.0 * spans),
            missing: f64::from(missing) / f64::from(looks),
            gap_px: gap_px as f64 / count.max(1) as f64,
            unmatched: (anchors - count) as f64,
            contradictions: 0.0,
        };
        if self.judge.model.has_lines() && matched & !joined != 0 {
            let others = Terms { missing: 0.0, ..terms };
            terms.missing =
                terms.missing.max(self.judge.missing_where_laid(&chosen()[..anchors], &others, limit)?);
        }
        (terms.fitness(&self.judge.weights) < limit).then_some(terms)
    }

    /// Whether one of the anchors left out could be matched too, for a fitness no worse.
    fn is_part_of_a_fitter_one(&mut self, depth: usize, fitness: f64) -> bool {
        // equal is no worse
        let limit = fitness * (1.0 + 1e-9) + 1e-12;
        let mut left_out = self.left_out;
        while left_out != 0 {
            let a = left_out.trailing_zeros() as usize;
            left_out &= left_out - 1;
            for w in 0..self.words {
                let mut bits = self.domains(depth)[a * self.words + w];
                while bits != 0 {
                    self.chosen[a] = (w * CHUNK) as u16 + bits.trailing_zeros() as u16;
                    bits &= bits - 1;
                    let fitter = self.terms(limit).is_some();
                    self.chosen[a] = UNMATCHED;
                    if fitter {
                        return true;
                    }
                }
            }
        }
        false
    }
}

#[cfg(test)]
#[path = "exhaustive_tests.rs"]
mod tests;
