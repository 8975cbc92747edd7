//! One of the searches, for all parts of a cell: image nodes in, stereo matches out.
//!
//! All take the same candidates and the same fitness, and all give distinct matches under the threshold.
//!
//! | method | with a closed gate | with the gate open |
//! |---|---|---|
//! | `exhaustive` | [`exhaustive`] over the stereo nodes | the same over all pairs that some match can hold |
//! | `harmony`, `improved`, `self-adaptive` | [`harmony`], drawn by length, restarted | as the paper has them, restarted |
//! | `random` | [`random`] over the stereo nodes | over all pairs |
//! | `auto` | `exhaustive`, up to [`Params::exact_steps_max`] steps a part; parts whose tree is larger go to `harmony` | the same |
//!
//! Measured for `auto` (`cargo bench --bench search` on a shared x86-64 core with AVX-512; medians in microseconds, gate
//! and tables included; K nodes of the part, N nodes a picture):
//!
//! | K, N | exact, all matches | Harmony Search by length, one match |
//! |---|---|---|
//! | 2, 30 | 7 | 5 |
//! | 2, 60 | 18 | 12 |
//! | 3, 30 | 7 | 5 |
//! | 4, 32 | 14 | 6 |
//! | 8, 56 | 110 | 59 |
//!
//! So the exact search comes first: it finds all there is in twice the time in which the other finds one.
//!
//! The exact search takes the parts one after the other, those with few nodes first, whose trees are small; the others take
//! them round by round in turn, so that none takes the whole budget. What a search does depends on its seed and on how many iterations it made, not on the
//! kind of budget: a run cut by the clock after n iterations is the run with a budget of n.
//!
//! ```
//! use pickcell::matching::drawn::DrawnScene;
//! use pickcell::matching::gate::GateParams;
//! use pickcell::matching::search::{Method, Params, Search};
//! use pickcell::time::Budget;
//!
//! let scene = DrawnScene::new(2, 3, 1); // three rods, two nodes each
//! let params = Params { method: Method::Harmony, fitness_max: 0.6, ..Params::default() };
//! let mut search = Search::new(params, GateParams::default(), 1);
//! let [left, right] = &scene.nodes;
//! let budget = Budget::Iterations(100_000);
//! search.run(&scene.rig, left, right, [0.0, 9.0], |_| scene.judge(), budget, 7);
//! assert!(search.matches(0).len() >= 6, "each rod, either way round");
//! ```

use rand::SeedableRng;
use rand_pcg::Pcg32;

use super::candidates::Candidates;
use super::exhaustive::{self, Exhaustive};
use super::fitness::{Judge, StereoMatch};
use super::found::Found;
use super::gate::{Gate, GateParams, Mode};
use super::harmony::{self, Ending, Harmony, Variant};
use super::length_table::LengthTable;
use super::nodes::ImageNode;
use super::open::{OpenPairs, Pictures};
use super::pool::{Dice, Pool};
use super::problem::{ANCHORS_MAX, StereoNode};
use super::random::{self, Random};
use crate::rig::Rig;
use crate::time::Budget;

/// Which search.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Method {
    /// The exact one where its tree fits, Harmony Search beyond.
    #[default]
    Auto,
    /// Harmony Search.
    Harmony,
    /// Harmony Search with rates that change with time.
    Improved,
    /// Harmony Search with rates taken from its memory.
    SelfAdaptive,
    /// Random search.
    Random,
    /// Exhaustive search with branch and bound.
    Exhaustive,
}

/// Parameters of a search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params {
    /// Which.
    pub method: Method,
    /// Matches of this fitness or more are none; nor are parts, once they are fitted.
    pub fitness_max: f64,
    /// Two nodes' distance may differ from the model's by this many mm.
    pub length_tolerance_mm: f64,
    /// Most matches that are kept of a part; the fittest stay.
    pub matches_max: usize,
    /// Most steps of the exact search for one part with [`Method::Auto`]: beyond, its tree is taken not to fit.
    pub exact_steps_max: u64,
    /// Parameters of the Harmony Searches; the variant follows from the method.
    pub harmony: harmony::Params,
    /// Parameters of the random search.
    pub random: random::Params,
}

impl Default for Params {
    fn default() -> Self {
        Self {
            method: Method::Auto,
            fitness_max: 1.0,
            length_tolerance_mm: 6.0,
            matches_max: 256,
            exact_steps_max: 500_000,
            harmony: Default::default(),
            random: Default::default(),
        }
    }
}

/// With the gate open a harmony is right by chance much less often: rounds are given this many times the patience.
const OPEN_PATIENCE: u32 = 10;

/// The state of one part in a search.
#[derive(Clone, Debug)]
struct Turn {
    found: Found,
    table: LengthTable,
    stale: u32,
    done: bool,
}

/// Workspace of the searches.
#[derive(Clone, Debug)]
pub struct Search {
    params: Params,
    gate_params: GateParams,
    gate: Gate,
    candidates: Candidates,
    along_curve: bool,
    exhaustive: Exhaustive,
    harmony: Harmony,
    random: Random,
    open: Option<OpenPairs>,
    turns: Vec<Turn>,
    iterations: u64,
    spent: bool,
    on_open_pairs: bool,
}

impl Search {
    /// Reserves all memory for this many parts.
    pub fn new(params: Params, gate_params: GateParams, parts: usize) -> Self {
        let nodes_max = gate_params.nodes_max.min(u16::MAX as usize - 1);
        let gate_params = GateParams { nodes_max, ..gate_params };
        let variant = match params.method {
            Method::Improved => Variant::Improved,
            Method::SelfAdaptive => Variant::SelfAdaptive,
            _ => Variant::Standard,
        };
        let patience = if gate_params.mode == Mode::None { OPEN_PATIENCE } else { 1 };
        let stale_improvisations = params.harmony.stale_improvisations.saturating_mul(patience);
        let open =
            gate_params.mode == Mode::None && !matches!(params.method, Method::Exhaustive | Method::Auto);
        let turn = || Turn {
            found: Found::new(params.matches_max),
            table: LengthTable::new(nodes_max),
            stale: 0,
            done: false,
        };
        Self {
            params,
            gate_params,
            gate: Gate::new(gate_params),
            candidates: Candidates::new(nodes_max),
            along_curve: false,
            exhaustive: Exhaustive::new(nodes_max),
            harmony: Harmony::new(harmony::Params { variant, stale_improvisations, ..params.harmony }),
            random: Random::new(params.random),
            open: open.then(|| OpenPairs::new(gate_params)),
            turns: (0..parts).map(|_| turn()).collect(),
            iterations: 0,
            spent: false,
            on_open_pairs: open,
        }
    }

    /// The stereo nodes that the matches of the last run point to.
    pub fn nodes(&self) -> &[StereoNode] {
        match &self.open {
            Some(open) if self.on_open_pairs => open.nodes(),
            _ => self.gate.nodes(),
        }
    }

    /// Stereo nodes that the closed gate would let through: with their wire each may hold a pose by itself. None where
    /// an open gate was searched by chance, as the paper has it.
    pub fn near_nodes(&self) -> impl Iterator<Item = (usize, &StereoNode)> {
        let nodes = if self.on_open_pairs { &[][..] } else { self.gate.nodes() };
        nodes.iter().enumerate().filter(|(_, n)| self.gate_params.is_near(n))
    }

    /// The matches of a part, fittest first.
    ///
    /// # Panics
    /// Where there are not so many parts.
    pub fn matches(&self, part: usize) -> &[StereoMatch] {
        self.turns[part].found.matches()
    }

    /// Steps, improvisations and draws of the last run.
    pub fn iterations(&self) -> u64 {
        self.iterations
    }

    /// Whether the budget was spent before the last run was through, or there were more candidates than it looks through.
    pub fn is_out_of_time(&self) -> bool {
        self.spent || self.gate.is_truncated()
    }

    /// Begins with a new pair of pictures: runs the gate. `thickness_mm`: the thinnest and the thickest part.
    pub fn begin(&mut self, rig: &Rig, left: &[ImageNode], right: &[ImageNode], thickness_mm: [f64; 2]) {
        (self.iterations, self.spent) = (0, false);
        for turn in &mut self.turns {
            turn.found.clear();
            (turn.stale, turn.done) = (0, false);
        }
        if let Some(open) = &mut self.open {
            open.begin([left, right]);
            return;
        }
        self.gate.run(rig, left, right, thickness_mm);
        self.along_curve = !matches!(self.params.method, Method::Exhaustive | Method::Auto | Method::Random);
        self.candidates.fill(&rig.geometry(), self.gate.nodes(), left, right, self.along_curve);
    }

    /// The exact search, if the method has one; `judge_of` gives what matches of each part are judged by.
    pub fn run_exact<'j>(&mut self, judge_of: impl Fn(usize) -> Judge<'j>, budget: Budget) {
        if matches!(self.params.method, Method::Exhaustive | Method::Auto) {
            self.exact(&judge_of, budget);
        }
        for turn in &mut self.turns {
            turn.found.sort();
        }
    }

    /// The search by chance for what the exact one has not done. `used` iterations of the budget are gone, and what it
    /// uses is added.
    pub fn run_by_chance<'j>(
        &mut self,
        rig: &Rig,
        [left, right]: [&[ImageNode]; 2],
        judge_of: impl Fn(usize) -> Judge<'j>,
        budget: Budget,
        used: &mut u64,
        seed: u64,
    ) {
        if self.params.method == Method::Exhaustive || self.spent || self.turns.iter().all(|t| t.done) {
            return;
        }
        let mut dice = Dice(Pcg32::seed_from_u64(seed));
        let geometry = rig.geometry();
        if !self.along_curve && self.open.is_none() && self.params.method != Method::Random {
            // only this search asks for neighbours, and mostly it is not needed
            self.candidates.fill(&geometry, self.gate.nodes(), left, right, true);
            self.along_curve = true;
        }
        let pictures = Pictures { geometry: &geometry, nodes: [left, right] };
        let before = *used;
        self.by_chance(&judge_of, pictures, budget, used, &mut dice);
        self.iterations += *used - before;
        for turn in &mut self.turns {
            turn.found.sort();
        }
    }

    /// All of it: [`begin`](Self::begin), [`run_exact`](Self::run_exact), [`run_by_chance`](Self::run_by_chance).
    #[allow(clippy::too_many_arguments)]
    pub fn run<'j>(
        &mut self,
        rig: &Rig,
        left: &[ImageNode],
        right: &[ImageNode],
        thickness_mm: [f64; 2],
        judge_of: impl Fn(usize) -> Judge<'j>,
        budget: Budget,
        seed: u64,
    ) {
        self.begin(rig, left, right, thickness_mm);
        self.run_exact(&judge_of, budget);
        let mut used = self.iterations;
        self.run_by_chance(rig, [left, right], &judge_of, budget, &mut used, seed);
    }

    fn exact<'j>(&mut self, judge_of: &impl Fn(usize) -> Judge<'j>, budget: Budget) {
        let most = match self.params.method {
            Method::Auto => self.params.exact_steps_max,
            _ => u64::MAX,
        };
        // Parts with few nodes first, whose trees are small: the large tree of another leaves them their budget.
        for anchors in 0..=ANCHORS_MAX {
            let has_so_many = |part: usize| judge_of(part).model.anchors.len() == anchors;
            let turns = self.turns.iter_mut().enumerate();
            for (part, turn) in turns.filter(|(part, _)| has_so_many(*part)) {
                let limits = exhaustive::Limits {
                    fitness_max: self.params.fitness_max,
                    budget: budget.less(self.iterations),
                    steps_max: most,
                };
                self.exhaustive.run(&judge_of(part), &self.candidates, limits, &mut turn.found);
                self.iterations += self.exhaustive.steps();
                turn.done = self.exhaustive.is_complete();
                self.spent |= !turn.done && self.exhaustive.steps() < most;
            }
        }
    }

    fn by_chance<'j>(
        &mut self,
        judge_of: &impl Fn(usize) -> Judge<'j>,
        pictures: Pictures,
        budget: Budget,
        used: &mut u64,
        dice: &mut Dice,
    ) {
        let Self { params, candidates, harmony, random, open, turns, .. } = self;
        let by_length = params.harmony.by_length && params.method != Method::Random;
        for (part, turn) in turns.iter_mut().enumerate().filter(|(_, t)| !t.done) {
            if open.is_none() {
                let tolerance_mm = params.length_tolerance_mm;
                let model = judge_of(part).model;
                if !turn.table.fill(model, candidates, tolerance_mm, by_length, &budget) {
                    self.spent = true;
                    return;
                }
            }
        }
        while turns.iter().any(|t| !t.done) {
            for (part, turn) in turns.iter_mut().enumerate().filter(|(_, t)| !t.done) {
                let mut pool = match open {
                    Some(pairs) => Pool::Open { pairs, pictures },
                    None => Pool::Gated { candidates, table: &turn.table, by_length },
                };
                let judge = judge_of(part);
                let (pool, found) = (&mut pool, &mut turn.found);
                let ending = if params.method == Method::Random {
                    random.run(&judge, pool, params.fitness_max, found, budget, used, dice)
                } else {
                    harmony.round(&judge, pool, params.fitness_max, found, budget, used, dice)
                };
                match ending {
                    Ending::Spent => {
                        self.spent = true;
                        return;
                    }
                    Ending::Found => turn.done = true,
                    Ending::Stale { news: true } => turn.stale = 0,
                    Ending::Stale { news: false } => turn.stale += 1,
                }
                let patience =
                    if params.method == Method::Random { 1 } else { harmony.params().stale_rounds };
                turn.done |= turn.stale >= patience;
            }
        }
    }
}

#[cfg(test)]
#[path = "search_tests.rs"]
mod tests;
