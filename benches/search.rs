//! Time to the solution of every search over drawn node sets, gate and tables included: `cargo bench --bench search`.
//!
//! Each cell is the median in microseconds over drawn scenes, with the share of scenes solved in brackets where it is
//! not all of them. Solved: a match under the threshold; for the exact search: all of them. Below it the figures that
//! have a goal, each beside it.

use std::time::Instant;

use pickcell::matching::drawn::DrawnScene;
use pickcell::matching::gate::{GateParams, Mode};
use pickcell::matching::harmony;
use pickcell::matching::random;
use pickcell::matching::search::{Method, Params, Search};
use pickcell::time::Budget;

/// Nodes of the part and parts in the scene.
const CASES: [(usize, usize); 8] = [(2, 4), (2, 8), (2, 15), (2, 30), (3, 10), (4, 8), (8, 7), (8, 3)];
/// Iterations after which a search by chance is given up.
const ITERATIONS: u64 = 100_000;
const FITNESS_MAX: f64 = 0.6;

/// A column of the table.
struct Column {
    name: &'static str,
    method: Method,
    mode: Mode,
    by_length: bool,
    restarts: bool,
}

fn columns() -> [Column; 8] {
    let column = |name, method, mode, by_length, restarts| Column { name, method, mode, by_length, restarts };
    use {Method::*, Mode::*};
    [
        column("as the paper", Harmony, None, false, false),
        column("random", Random, None, false, false),
        column("open, restarted", Harmony, None, false, true),
        column("gated, restarted", Harmony, Epipolar, false, true),
        column("+ by length", Harmony, Epipolar, true, true),
        column("improved", Improved, Epipolar, true, true),
        column("self-adaptive", SelfAdaptive, Epipolar, true, true),
        column("exact, all", Exhaustive, Epipolar, false, false),
    ]
}

impl Column {
    fn search(&self) -> Search {
        let harmony = harmony::Params {
            by_length: self.by_length,
            stale_improvisations: if self.restarts { 400 } else { u32::MAX },
            stale_rounds: u32::MAX,
            stop_at_first: true,
            ..Default::default()
        };
        let random = random::Params { stale_draws: u32::MAX, stop_at_first: true };
        let params =
            Params { method: self.method, fitness_max: FITNESS_MAX, harmony, random, ..Params::default() };
        Search::new(params, GateParams { mode: self.mode, ..GateParams::default() }, 1)
    }

    /// Microseconds for every scene that was solved, and nanoseconds an iteration over all.
    fn run(&self, scenes: &[DrawnScene]) -> (Vec<f64>, f64) {
        let mut search = self.search();
        let (mut solved, mut iterations, mut total_ns) = (Vec::new(), 0, 0.0);
        for (seed, scene) in scenes.iter().enumerate() {
            let [left, right] = &scene.nodes;
            let mut run = || {
                let begin = Instant::now();
                let budget = Budget::Iterations(ITERATIONS);
                search.run(&scene.rig, left, right, [0.0, 1e9], |_| scene.judge(), budget, seed as u64);
                begin.elapsed().as_nanos() as f64
            };
            // the best of a few: other work on the machine is not the search's
            let mut ns = run();
            for _ in 0..if ns < 1e6 { 5 } else { 0 } {
                ns = ns.min(run());
            }
            total_ns += ns;
            iterations += search.iterations();
            if !search.matches(0).is_empty()
                && (self.method != Method::Exhaustive || !search.is_out_of_time())
            {
                solved.push(ns / 1000.0);
            }
        }
        solved.sort_by(f64::total_cmp);
        (solved, total_ns / iterations.max(1) as f64)
    }
}

fn main() {
    // `cargo test --benches` only wants to know that it runs
    let short = !std::env::args().any(|a| a == "--bench");
    let count = if short { 1 } else { 24 };
    let columns = columns();
    print!("| nodes of the part, nodes a picture |");
    columns.iter().for_each(|c| print!(" {} |", c.name));
    println!("\n|---|{}", "---|".repeat(columns.len()));
    let mut goals = Vec::new();
    for (anchors, parts) in if short { &CASES[..1] } else { &CASES[..] } {
        let scenes: Vec<DrawnScene> = (0..count).map(|s| DrawnScene::new(*anchors, *parts, s)).collect();
        print!("| {anchors}, {} |", anchors * parts);
        for column in &columns {
            let (solved, ns) = column.run(&scenes);
            let share = solved.len() as f64 / scenes.len() as f64;
            let median = solved.get(solved.len() / 2).map_or("-".into(), |us| format!("{us:.1}"));
            goals.extend(goal(column, *anchors, anchors * parts, &median, ns));
            let share = if share < 1.0 { format!(" [{:.0} %]", 100.0 * share) } else { String::new() };
            print!(" {median}{share} ({ns:.0} ns) |");
        }
        println!();
    }
    println!("\nIn round brackets: nanoseconds an iteration, gate and tables included.");
    println!("\n| goal | | measured |\n|---|---|---|");
    goals.iter().for_each(|row| println!("{row}"));
}

/// A row of the table of goals, if this cell has one.
fn goal(column: &Column, anchors: usize, nodes: usize, median_us: &str, ns: f64) -> Option<String> {
    let what = format!("part of {anchors} nodes, {nodes} nodes a picture");
    match (column.name, anchors, nodes) {
        ("exact, all", 2, 60) => Some(format!("| all matches, {what} | 20 us | {median_us} us |")),
        ("exact, all", 8, 56) => Some(format!("| all matches, {what} | 150 us | {median_us} us |")),
        ("as the paper", ..) => {
            Some(format!("| an improvisation as in the paper, {what} | 300 ns | {ns:.0} ns |"))
        }
        _ => None,
    }
}
