//! Which candidates are at the model's distance from one that is matched: rows of bits, made when they are asked for
//! and kept as long as there is room.

use super::candidates::Candidates;
use super::problem::{ANCHORS_MAX, MatchModel};
use super::rows::{self, CHUNK};
use crate::level::Level;

/// Workspace that holds the rows of one part and one pair of pictures.
#[derive(Clone, Debug)]
pub struct Neighbours {
    level: Level,
    rows: Vec<u64>,
    /// What every slot holds: the run, the anchor, the candidate.
    keys: Vec<u64>,
    run: u32,
    anchors: usize,
    /// Words a row has: one bit a candidate.
    words: usize,
    slots: usize,
    distances_mm: Vec<f32>,
    tolerance_mm: f32,
}

/// Words of the rows that are kept, where the candidates of one anchor do not need more.
const WORDS: usize = 1 << 17;

/// Rows so short are made in the time that it takes to read some pixels.
pub(super) const QUICK_WORDS: usize = 2;

impl Neighbours {
    /// Reserves all memory for up to `nodes_max` candidates.
    pub fn new(nodes_max: usize) -> Self {
        let words = WORDS.max(nodes_max.div_ceil(CHUNK) * ANCHORS_MAX);
        Self {
            level: Level::detect(),
            rows: vec![0; words],
            keys: vec![0; words],
            run: 0,
            anchors: 0,
            words: 0,
            slots: 0,
            distances_mm: Vec::with_capacity(ANCHORS_MAX * ANCHORS_MAX),
            tolerance_mm: 0.0,
        }
    }

    /// Begins with a part and a pair of pictures: at least one candidate, and not more than there is memory for.
    pub fn begin(&mut self, model: &MatchModel, candidates: &Candidates, tolerance_mm: f64) {
        self.run = self.run.wrapping_add(1);
        if self.run == 0 {
            // every 2^32 runs: nothing may be taken for one of them
            self.keys.fill(0);
            self.run = 1;
        }
        self.anchors = model.anchors.len();
        self.words = candidates.points().words();
        self.slots = self.rows.len() / (self.anchors * self.words).max(1);
        self.distances_mm.clear();
        self.distances_mm.extend(model.distances_mm.iter().map(|d| *d as f32));
        self.tolerance_mm = tolerance_mm as f32;
    }

    /// Whether the rows of a candidate are there or soon made.
    #[inline]
    pub fn is_quick(&self, anchor: usize, n: usize) -> bool {
        self.words <= QUICK_WORDS || self.keys[self.slot(anchor, n)] == self.key(anchor, n)
    }

    #[inline]
    fn key(&self, anchor: usize, n: usize) -> u64 {
        (self.run as u64) << 32 | (anchor as u64) << 16 | n as u64
    }

    #[inline]
    fn slot(&self, anchor: usize, n: usize) -> usize {
        (n * self.anchors + anchor) % self.slots
    }

    /// The candidates that can be each anchor where candidate `n` is `anchor`, a row of bits an anchor: at the model's
    /// distance within the tolerance, and of other image nodes in both pictures. What they look like is not looked at.
    #[inline]
    pub fn of(&mut self, candidates: &Candidates, anchor: usize, n: usize) -> &[u64] {
        let (key, slot) = (self.key(anchor, n), self.slot(anchor, n));
        let length = self.anchors * self.words;
        if self.keys[slot] != key {
            self.keys[slot] = key;
            self.fill(candidates, anchor, n, slot * length);
        }
        &self.rows[slot * length..(slot + 1) * length]
    }

    #[inline(never)]
    fn fill(&mut self, candidates: &Candidates, anchor: usize, n: usize, from: usize) {
        let rows = &mut self.rows[from..from + self.anchors * self.words];
        let new = &candidates.all()[n];
        let wanted_mm = &self.distances_mm[anchor * self.anchors..(anchor + 1) * self.anchors];
        let at = (new.point_mm, [new.left, new.right]);
        rows::at_distance(self.level, candidates.points(), at, wanted_mm, self.tolerance_mm, rows);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matching::drawn::DrawnScene;
    use crate::matching::fitness::distance_mm;

    #[test]
    fn rows_hold_what_is_at_the_distance_also_where_there_is_room_for_few() {
        let scene = DrawnScene::new(4, 9, 3);
        let (all, model) = (scene.candidates.all(), &scene.model);
        for room in [WORDS, 8 * scene.candidates.points().words()] {
            let mut neighbours = Neighbours::new(all.len());
            neighbours.rows.truncate(room);
            neighbours.begin(model, &scene.candidates, 6.0);
            let mut any = 0;
            for k in 0..3 * all.len() {
                let (anchor, n) = (k % 4, (k * 7) % all.len());
                let (rows, words) =
                    (neighbours.of(&scene.candidates, anchor, n), scene.candidates.points().words());
                for a in 0..4 {
                    for (c, other) in all.iter().enumerate() {
                        let bit = rows[a * words + c / CHUNK] >> (c % CHUNK) & 1 == 1;
                        let apart = other.left != all[n].left && other.right != all[n].right;
                        let off = (distance_mm(&all[n], other) - model.distance_mm(anchor, a) as f32).abs();
                        assert_eq!(bit, apart && off <= 6.0);
                        any += bit as u32;
                    }
                }
            }
            assert!(any > 100);
        }
    }
}
