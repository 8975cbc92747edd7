//! Random search: what the paper compares Harmony Search with. Every harmony is drawn anew, each note evenly from all
//! that the gate lets through.
//!
//! ```
//! use pickcell::matching::drawn::DrawnScene;
//! use pickcell::matching::found::Found;
//! use pickcell::matching::random::{Params, Random};
//! use pickcell::matching::length_table::LengthTable;
//! use pickcell::matching::pool::{Dice, Pool};
//! use pickcell::time::Budget;
//! use rand::SeedableRng;
//!
//! let scene = DrawnScene::new(2, 3, 1); // three rods, two nodes each
//! let candidates = &scene.candidates;
//! let mut table = LengthTable::new(candidates.all().len());
//! table.fill(&scene.model, candidates, 6.0, false, &Budget::Iterations(0));
//! let mut pool = Pool::Gated { candidates, table: &table, by_length: false };
//! let (mut found, mut used) = (Found::new(16), 0);
//! let mut dice = Dice(rand_pcg::Pcg32::seed_from_u64(1));
//! let params = Params { stop_at_first: true, ..Params::default() };
//! let budget = Budget::Iterations(10_000);
//! Random::new(params).run(&scene.judge(), &mut pool, 0.6, &mut found, budget, &mut used, &mut dice);
//! assert!(found.matches().len() == 1 && used < 10_000);
//! ```

use super::fitness::Judge;
use super::found::Found;
use super::harmony::Ending;
use super::pool::{Dice, Note, Pool, SILENT};
use super::problem::ANCHORS_MAX;
use crate::time::Budget;

/// Parameters of the random search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params {
    /// A round ends after so many draws without a new match.
    pub stale_draws: u32,
    /// Whether the first match under the threshold ends the search.
    pub stop_at_first: bool,
}

impl Default for Params {
    fn default() -> Self {
        Self { stale_draws: 100_000, stop_at_first: false }
    }
}

/// Workspace of the random search.
#[derive(Clone, Debug)]
pub struct Random {
    params: Params,
    new: [Note; ANCHORS_MAX],
}

impl Random {
    /// With these parameters.
    pub fn new(params: Params) -> Self {
        Self { params, new: [SILENT; ANCHORS_MAX] }
    }

    /// Draws until nothing new is met for long or the budget is spent; `used` counts the draws. The pool must not draw
    /// by length.
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
        let anchors = judge.model.anchors.len();
        let can_spare = judge.model.required() < anchors;
        let (mut unchanged, mut any) = (0, false);
        while unchanged < self.params.stale_draws && !pool.is_empty() {
            if budget.is_spent(*used) {
                return Ending::Spent;
            }
            *used += 1;
            let fitness_max = found.threshold(fitness_max);
            unchanged += 1;
            for place in 0..anchors {
                let (anchor, parent) = pool.anchor(place, anchors);
                self.new[anchor] = pool.draw(place, self.new[parent], can_spare, dice);
            }
            let notes = &self.new[..anchors];
            let Some(terms) = pool.judge(judge, notes, fitness_max).filter(|t| t.is_match()) else {
                continue;
            };
            let Some(met) = pool.match_of(notes, terms.fitness(&judge.weights)) else { continue };
            if found.insert(met) {
                (unchanged, any) = (0, true);
                if self.params.stop_at_first {
                    return Ending::Found;
                }
            }
        }
        Ending::Stale { news: any }
    }
}
