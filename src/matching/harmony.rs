//! Harmony Search (paper III-B, Algorithm 1) for stereo matches (IV-D, Algorithm 3), and its variants (III-C).
//!
//! A harmony gives every anchor of the part a [`Note`]; a memory holds HMS of them. An improvisation makes a new one,
//! anchor by anchor: with rate HMCR the anchor's note in a random harmony of the memory, else a random one; a note from the
//! memory is moved with rate PAR. If the new harmony is fitter than the memory's worst it takes its place.
//!
//! # How a note is moved
//! * Standard, open gate: as in Algorithm 3, "inversion of a node compared to a previous": the left node changes places
//!   with the previous anchor's.
//! * Standard, closed gate: such a change would leave the gate. The note becomes another candidate at the model's
//!   distance from the anchor it hangs on, out of the [`LengthTable`](super::length_table::LengthTable); without
//!   `by_length` both stereo nodes change places.
//! * [`improved`], [`self_adaptive`]: by ranks along a curve, see there.
//!
//! # Slips in the printed algorithms, and how they are read here
//! * Algorithms 1 and 3, `s_worst ← s_i | f(s_i) < f(s_j)`: that is the fittest, for fitness is to be small (Table III
//!   replaces the greatest, 77). Read: worst is the greatest fitness.
//! * The same at their ends: `s ← s_i | f(s_i) > f(s_j)` gives back the worst. Read: the least fitness.
//! * `REMOVE s_worst to HM`, `REMOVE s_new to HM`: read: ADD `s_new` to HM.
//! * Algorithm 3, `for i = 0 to HMS` makes HMS + 1 harmonies, `for i = 0 to m` m + 1 variables. Read: up to
//!   HMS - 1 and m - 1.
//! * Algorithm 3, `v[i - 1]` at i = 0: there is none. Read: the last, v[m - 1]; as `s_new` starts as a harmony of the
//!   memory (its first line, `s_new ← M[v[m], w[m]]`) that note is there.
//! * Algorithm 3 inverts `v` only but takes `x_i ← M[v[i], w[i]]` alone. Read: the previous variable keeps the left node
//!   that it got.
//! * `if random <= HMCR` with random in [0, 1): at HMCR = 0 this could still be true. Read: `<`.
//! * Algorithm 1, `for stop_alg() ≠ True`: read: while.
//! * Algorithm 3 ends without `return s`. Read as Algorithm 1.
//! * Table III calls the new harmony number 5 beside the old number 5: it has taken its place.
//! * Equations (2) and (4), "NI is the number of solutions", and `gen` on the left is `gn` on the right: read, as in the
//!   source (doi:10.1016/j.amc.2006.11.033): NI is the number of improvisations, gn counts them.
//! * Section III-B allows HMCR and PAR from 0 to 1, both included; Algorithms 1 and 3 require both in [0, 1), without 1. Read:
//!   0 to 1, both included.
//! * Equations (5) and (6) are said to be by "Wang and Juang" (reference 25). Their source is by Wang and Huang
//!   (doi:10.1016/j.eswa.2009.09.008).
//! * Algorithm 2 (binarization) compares the wrong way round, and paints white and black where the text says 1 and 0; figure 5
//!   shows the object black on white. Read: see [`vision::binarize`](crate::vision::binarize).
//! * Algorithm 2, `for x = 0 to x = Image.width` and `for y = 0 to x = Image.height`: both run one pixel too far, the inner one
//!   ends by x, and there is an `end for` too many. Read: x up to width - 1, and for each y up to height - 1.
//!
//! # What is added
//! A scene holds many parts, and Harmony Search stalls. So every distinct match under the threshold that is met goes
//! to [`Found`], and one that is known already is not let into the memory again; a memory that has not changed for
//! `stale_improvisations` is thrown away and the search begins anew (a round); after `stale_rounds` rounds without a new
//! match it ends. `stop_at_first` is the paper's own criterion: the first match under the threshold ends it.
//!
//! ```
//! use pickcell::matching::drawn::DrawnScene;
//! use pickcell::matching::found::Found;
//! use pickcell::matching::harmony::{Harmony, Params};
//! use pickcell::matching::length_table::LengthTable;
//! use pickcell::matching::pool::{Dice, Pool};
//! use pickcell::time::Budget;
//! use rand::SeedableRng;
//!
//! let scene = DrawnScene::new(2, 3, 1); // three rods, two nodes each
//! let candidates = &scene.candidates;
//! let mut table = LengthTable::new(candidates.all().len());
//! table.fill(&scene.model, candidates, 6.0, true, &Budget::Iterations(0));
//! let mut pool = Pool::Gated { candidates, table: &table, by_length: true };
//! let (mut found, mut used) = (Found::new(16), 0);
//! let mut dice = Dice(rand_pcg::Pcg32::seed_from_u64(1));
//! let params = Params { stop_at_first: true, ..Params::default() };
//! let budget = Budget::Iterations(10_000);
//! Harmony::new(params).run(&scene.judge(), &mut pool, 0.6, &mut found, budget, &mut used, &mut dice);
//! assert!(found.matches().len() == 1 && used < 10_000);
//! ```

use super::fitness::Judge;
use super::found::Found;
use super::pool::{Dice, Note, Pool, SILENT};
use super::problem::ANCHORS_MAX;
use super::{improved, self_adaptive};
use crate::time::Budget;

/// Which Harmony Search.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Variant {
    /// Algorithms 1 and 3.
    #[default]
    Standard,
    /// Equations (2) to (4).
    Improved,
    /// Equations (5) and (6).
    SelfAdaptive,
}

/// Parameters of a Harmony Search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params {
    /// Which.
    pub variant: Variant,
    /// Harmonies in the memory (HMS), 2 or more; the paper: 20 to 70.
    pub hms: usize,
    /// Rate of taking a note from the memory (HMCR), 0 to 1; the paper: 0.5 to 0.8.
    pub hmcr: f64,
    /// Rate of moving such a note (PAR), 0 to 1; the paper: 0.1 to 0.3.
    pub par: f64,
    /// Smallest PAR of the variants.
    pub par_min: f64,
    /// Largest PAR of the variants.
    pub par_max: f64,
    /// Improvisations over which the variants' rates run (NI).
    pub improvisations: u32,
    /// Whether notes are drawn from the pairs of the right length (closed gate only).
    pub by_length: bool,
    /// A round ends when its memory has not changed for so many improvisations.
    pub stale_improvisations: u32,
    /// The search ends after so many rounds without a new match.
    pub stale_rounds: u32,
    /// Whether the first match under the threshold ends the search.
    pub stop_at_first: bool,
}

impl Default for Params {
    fn default() -> Self {
        Self {
            variant: Variant::Standard,
            hms: 20,
            hmcr: 0.7,
            par: 0.3,
            par_min: 0.1,
            par_max: 0.5,
            improvisations: 2000,
            by_length: true,
            stale_improvisations: 400,
            stale_rounds: 20,
            stop_at_first: false,
        }
    }
}

/// How a round ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// The memory did not change any more; whether the round met a new match.
    Stale {
        /// A match that was not known before.
        news: bool,
    },
    /// A match, and that was enough.
    Found,
    /// The budget was spent.
    Spent,
}

/// Workspace of a Harmony Search.
#[derive(Clone, Debug)]
pub struct Harmony {
    params: Params,
    memory: Memory,
    new: [Note; ANCHORS_MAX],
}

/// The harmonies and their fitness.
#[derive(Clone, Debug)]
pub(super) struct Memory {
    pub(super) anchors: usize,
    notes: Vec<Note>,
    fitness: Vec<f64>,
    worst: usize,
}

impl Memory {
    fn clear(&mut self, anchors: usize) {
        self.anchors = anchors;
        self.notes.clear();
        self.fitness.clear();
        self.worst = 0;
    }

    fn add(&mut self, notes: &[Note], fitness: f64) {
        self.notes.extend_from_slice(notes);
        self.fitness.push(fitness);
        self.find_worst();
    }

    fn replace_worst(&mut self, notes: &[Note], fitness: f64) {
        let begin = self.worst * self.anchors;
        self.notes[begin..begin + self.anchors].copy_from_slice(notes);
        self.fitness[self.worst] = fitness;
        self.find_worst();
    }

    fn find_worst(&mut self) {
        self.worst = 0;
        for (i, f) in self.fitness.iter().enumerate() {
            if *f > self.fitness[self.worst] {
                self.worst = i;
            }
        }
    }

    /// The notes of all harmonies for one anchor.
    pub(super) fn column(&self, anchor: usize) -> impl Iterator<Item = Note> {
        self.notes.iter().skip(anchor).step_by(self.anchors).copied()
    }
}

impl Harmony {
    /// Reserves all memory.
    pub fn new(params: Params) -> Self {
        let params = Params { hms: params.hms.max(2), ..params };
        let memory = Memory {
            anchors: 0,
            notes: Vec::with_capacity(params.hms * ANCHORS_MAX),
            fitness: Vec::with_capacity(params.hms),
            worst: 0,
        };
        Self { params, memory, new: [SILENT; ANCHORS_MAX] }
    }

    /// The parameters.
    pub fn params(&self) -> &Params {
        &self.params
    }

    /// Rounds until nothing new is met or the budget is spent; says which. `used` counts the harmonies judged and is what
    /// the budget is compared with.
    #[allow(clippy::too_many_arguments)]
    pub fn run(
        &mut self,
        judge: &Judge,
        pool: &mut Pool,
        fitness_max: f64,
        found: &mut Found,
        budget: Budget,
        used: &mut u64,
        dice: &mut Dice,
    ) -> Ending {
        let mut stale = 0;
        while stale < self.params.stale_rounds {
            match self.round(judge, pool, fitness_max, found, budget, used, dice) {
                Ending::Stale { news } => stale = if news { 0 } else { stale + 1 },
                other => return other,
            }
        }
        Ending::Stale { news: false }
    }

    /// One memory, from its random beginning until it does not change any more.
    #[allow(clippy::too_many_arguments)]
    pub fn round(
        &mut self,
        judge: &Judge,
        pool: &mut Pool,
        fitness_max: f64,
        found: &mut Found,
        budget: Budget,
        used: &mut u64,
        dice: &mut Dice,
    ) -> Ending {
        let anchors = judge.model.anchors.len();
        self.memory.clear(anchors);
        if pool.is_empty() || anchors == 0 {
            return Ending::Stale { news: false };
        }
        let can_spare = judge.model.required() < anchors;
        let (mut unchanged, mut generation, mut news) = (0, 0, false);
        while unchanged < self.params.stale_improvisations {
            if budget.is_spent(*used) {
                return Ending::Spent;
            }
            *used += 1;
            let fitness_max = found.threshold(fitness_max);
            let filling = self.memory.fitness.len() < self.params.hms;
            if filling {
                self.draw_all(pool, can_spare, dice);
            } else {
                self.improvise(pool, generation, can_spare, dice);
                generation += 1;
                unchanged += 1;
            }
            let worst = if filling { f64::INFINITY } else { self.memory.fitness[self.memory.worst] };
            let notes = &self.new[..anchors];
            let Some(terms) = pool.judge(judge, notes, worst.max(fitness_max)) else { continue };
            let mut fitness = terms.fitness(&judge.weights);
            if terms.is_match() && fitness < fitness_max {
                let Some(met) = pool.match_of(notes, fitness) else { continue };
                if found.contains(&met) {
                    // known: it would only draw the memory to where the search has been
                    fitness = f64::INFINITY;
                } else if found.insert(met) {
                    news = true;
                    if self.params.stop_at_first {
                        return Ending::Found;
                    }
                }
            }
            if filling {
                self.memory.add(notes, fitness);
            } else if fitness < worst {
                self.memory.replace_worst(notes, fitness);
                unchanged = 0;
            }
        }
        Ending::Stale { news }
    }

    fn draw_all(&mut self, pool: &Pool, can_spare: bool, dice: &mut Dice) {
        let anchors = self.memory.anchors;
        for place in 0..anchors {
            let (anchor, parent) = pool.anchor(place, anchors);
            self.new[anchor] = pool.draw(place, self.new[parent], can_spare, dice);
        }
    }

    /// Algorithm 3's improvisation.
    fn improvise(&mut self, pool: &Pool, generation: u32, can_spare: bool, dice: &mut Dice) {
        let (anchors, params) = (self.memory.anchors, &self.params);
        let memory = &self.memory;
        let hms = memory.fitness.len() as u32;
        let begin = dice.below(hms) as usize * anchors;
        self.new[..anchors].copy_from_slice(&memory.notes[begin..begin + anchors]);
        let par = match params.variant {
            Variant::Standard => params.par,
            Variant::Improved => improved::pitch_rate(params, generation),
            Variant::SelfAdaptive => self_adaptive::pitch_rate(params, generation),
        };
        for place in 0..anchors {
            let (anchor, parent) = pool.anchor(place, anchors);
            if dice.share() >= params.hmcr {
                self.new[anchor] = pool.draw(place, self.new[parent], can_spare, dice);
                continue;
            }
            self.new[anchor] = memory.notes[dice.below(hms) as usize * anchors + anchor];
            if dice.share() >= par {
                continue;
            }
            match params.variant {
                Variant::Standard => invert(&mut self.new, pool, place, anchor, parent, dice),
                Variant::Improved => {
                    let bandwidth = improved::bandwidth(params, generation, pool.ranks());
                    self.new[anchor] = improved::moved(self.new[anchor], bandwidth, pool.ranks(), dice);
                }
                Variant::SelfAdaptive => {
                    self.new[anchor] = self_adaptive::moved(self.new[anchor], memory.column(anchor), dice);
                }
            }
        }
    }
}

/// The standard search's move of a note.
fn invert(new: &mut [Note], pool: &Pool, place: usize, anchor: usize, parent: usize, dice: &mut Dice) {
    match pool {
        Pool::Open { .. } => {
            let previous = new[parent][0];
            new[parent][0] = new[anchor][0];
            new[anchor][0] = previous;
        }
        Pool::Gated { by_length: true, .. } => {
            if let Some(note) = pool.neighbour_at_length(place, new[parent], dice) {
                new[anchor] = note;
            }
        }
        Pool::Gated { .. } => new.swap(anchor, parent),
    }
}

#[cfg(test)]
#[path = "harmony_tests.rs"]
mod tests;
