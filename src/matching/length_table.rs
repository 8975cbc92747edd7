//! Candidate pairs found by their distance in space.
//!
//! The anchors of the model are put in an order in which each hangs on an earlier one by a span (its parent). For
//! every anchor and every candidate of its parent the table lists the candidates at the model's distance, hashed by
//! (anchor, parent's candidate): a harmony drawn from it has the right lengths before it is judged.
//!
//! ```
//! use pickcell::matching::drawn::DrawnScene;
//! use pickcell::matching::length_table::LengthTable;
//! use pickcell::time::Budget;
//!
//! let scene = DrawnScene::new(2, 5, 1); // five rods of 90 mm, two nodes each
//! let all = scene.candidates.all();
//! let mut table = LengthTable::new(all.len());
//! let in_time = table.fill(&scene.model, &scene.candidates, 6.0, true, &Budget::Iterations(1));
//! assert!(in_time);
//!
//! // Either end of each rod has the other one.
//! let firsts: std::collections::BTreeSet<u16> = table.first().iter().copied().collect();
//! assert!(firsts.len() >= 10);
//! for &first in &firsts {
//!     for &second in table.at_length(1, first.into()) {
//!         let [a, b] = [first, second].map(|n| nalgebra::Point3::from(all[usize::from(n)].point_mm));
//!         assert!(((a - b).norm() - 90.0).abs() < 6.1);
//!     }
//! }
//! ```

use super::candidates::Candidates;
use super::fitness::may_be;
use super::problem::{ANCHORS_MAX, MatchModel};
use super::rows::{self, CHUNK, for_bits};
use crate::level::Level;
use crate::time::Budget;

/// Workspace that holds the table of one part and one pair of pictures.
#[derive(Clone, Debug)]
pub struct LengthTable {
    level: Level,
    anchors: usize,
    candidates: usize,
    order: [u8; ANCHORS_MAX],
    parent: [u8; ANCHORS_MAX],
    /// For place `k >= 1` of the order and candidate `c` of the parent, items `from[(k - 1) * candidates + c]` on.
    from: Vec<u32>,
    items: Vec<u16>,
    /// The parent's candidate of every item.
    owners: Vec<u16>,
    row: Vec<u64>,
    /// Candidates that look like an anchor of the order's place, one list after the other.
    fitting: Vec<u16>,
    fitting_from: [u32; ANCHORS_MAX + 1],
}

/// Most pairs that are kept; those beyond are not drawn.
const ITEMS_MAX: usize = 1 << 17;

impl LengthTable {
    /// Reserves all memory for up to `nodes_max` candidates.
    pub fn new(nodes_max: usize) -> Self {
        Self {
            level: Level::detect(),
            anchors: 0,
            candidates: 0,
            order: [0; ANCHORS_MAX],
            parent: [0; ANCHORS_MAX],
            from: Vec::with_capacity((ANCHORS_MAX - 1) * nodes_max + 1),
            items: Vec::with_capacity(ITEMS_MAX),
            owners: Vec::with_capacity(ITEMS_MAX),
            row: vec![0; nodes_max.div_ceil(CHUNK)],
            fitting: Vec::with_capacity(ANCHORS_MAX * nodes_max),
            fitting_from: [0; ANCHORS_MAX + 1],
        }
    }

    /// Lists the pairs, with `pairs` false only what looks like each anchor; says whether that was done in time.
    pub fn fill(
        &mut self,
        model: &MatchModel,
        candidates: &Candidates,
        tolerance_mm: f64,
        pairs: bool,
        budget: &Budget,
    ) -> bool {
        self.hang(model);
        let all = candidates.all();
        self.candidates = all.len();
        self.fitting.clear();
        for k in 0..self.anchors {
            self.fitting_from[k] = self.fitting.len() as u32;
            let role = model.anchors[self.order[k] as usize].role;
            let fits = all.iter().enumerate().filter(|(_, c)| c.explained && may_be(role, c.role));
            self.fitting.extend(fits.map(|(n, _)| n as u16));
        }
        self.fitting_from[self.anchors] = self.fitting.len() as u32;
        self.from.clear();
        self.items.clear();
        self.owners.clear();
        let words = candidates.points().words();
        if self.row.len() < words {
            self.row.resize(words, 0);
        }
        for k in 1..self.anchors {
            let (anchor, parent) = (self.order[k] as usize, self.parent[k] as usize);
            let wanted_mm = [model.distance_mm(parent, anchor) as f32];
            let (role, parents) = (model.anchors[anchor].role, model.anchors[parent].role);
            for (c, at) in all.iter().enumerate() {
                self.from.push(self.items.len() as u32);
                if !pairs || !at.explained || !may_be(parents, at.role) || self.items.len() == ITEMS_MAX {
                    continue;
                }
                if budget.is_over() {
                    return false;
                }
                let from = (at.point_mm, [at.left, at.right]);
                let tolerance_mm = tolerance_mm as f32;
                rows::at_distance(
                    self.level,
                    candidates.points(),
                    from,
                    &wanted_mm,
                    tolerance_mm,
                    &mut self.row,
                );
                for_bits(&self.row[..words], |n| {
                    // Behind the last there are others, which are nowhere.
                    let Some(other) = all.get(n) else { return };
                    if may_be(role, other.role) && self.items.len() < ITEMS_MAX {
                        self.items.push(n as u16);
                        self.owners.push(c as u16);
                    }
                });
            }
        }
        self.from.push(self.items.len() as u32);
        true
    }

    /// Orders the anchors along the spans, from the first.
    fn hang(&mut self, model: &MatchModel) {
        self.anchors = model.anchors.len();
        let mut placed = 1u32;
        (self.order[0], self.parent[0]) = (0, 0);
        for k in 1..self.anchors {
            let hangs = |a: usize, b: usize| placed >> a & 1 == 1 && placed >> b & 1 == 0;
            let next = model.pieces().iter().find_map(|s| match s {
                s if hangs(s.from, s.to) => Some((s.from, s.to)),
                s if hangs(s.to, s.from) => Some((s.to, s.from)),
                _ => None,
            });
            // a part in two pieces: any anchor, by its distance from the first
            let (parent, anchor) = next.unwrap_or((0, placed.trailing_ones() as usize));
            (self.order[k], self.parent[k]) = (anchor as u8, parent as u8);
            placed |= 1 << anchor;
        }
    }

    /// The anchor at a place of the order, and its parent.
    #[inline]
    pub fn anchor(&self, place: usize) -> (usize, usize) {
        (self.order[place] as usize, self.parent[place] as usize)
    }

    /// The candidates for the anchor at `place`, 1 or more, where its parent is `candidate`.
    #[inline]
    pub fn at_length(&self, place: usize, candidate: usize) -> &[u16] {
        let k = (place - 1) * self.candidates + candidate;
        &self.items[self.from[k] as usize..self.from[k + 1] as usize]
    }

    /// The candidates of the first anchor that have a second one at its length, each as often as it has.
    #[inline]
    pub fn first(&self) -> &[u16] {
        let end = if self.anchors < 2 { 0 } else { self.from[self.candidates] as usize };
        &self.owners[..end]
    }

    /// The candidates that look like the anchor at `place`.
    #[inline]
    pub fn fitting(&self, place: usize) -> &[u16] {
        &self.fitting[self.fitting_from[place] as usize..self.fitting_from[place + 1] as usize]
    }
}
