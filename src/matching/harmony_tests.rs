//! Harmony Search on small scenes: converges, counts, keeps its budget, repeats itself.

use rand::SeedableRng;

use super::*;
use crate::matching::drawn::DrawnScene;
use crate::matching::gate::{GateParams, Mode};
use crate::matching::length_table::LengthTable;
use crate::matching::open::{OpenPairs, Pictures};
use crate::time::{Budget, Timestamp};

const FITNESS_MAX: f64 = 0.6;

/// Matches and iterations of a run on a scene.
fn run(scene: &DrawnScene, params: Params, mode: Mode, n: u64, seed: u64) -> (Found, u64, Ending) {
    let mut found = Found::new(64);
    let mut table = LengthTable::new(scene.candidates.all().len());
    let by_length = params.by_length;
    assert!(table.fill(&scene.model, &scene.candidates, 6.0, by_length, &Budget::Iterations(0)));
    let mut pairs = OpenPairs::new(GateParams { mode: Mode::None, ..GateParams::default() });
    pairs.begin([&scene.nodes[0], &scene.nodes[1]]);
    let geometry = scene.rig.geometry();
    let pictures = Pictures { geometry: &geometry, nodes: [&scene.nodes[0], &scene.nodes[1]] };
    let mut pool = match mode {
        Mode::Epipolar => Pool::Gated { candidates: &scene.candidates, table: &table, by_length },
        Mode::None => Pool::Open { pairs: &mut pairs, pictures },
    };
    let mut dice = Dice(rand_pcg::Pcg32::seed_from_u64(seed));
    let mut used = 0;
    let ending = Harmony::new(params).run(
        &scene.judge(),
        &mut pool,
        FITNESS_MAX,
        &mut found,
        Budget::Iterations(n),
        &mut used,
        &mut dice,
    );
    found.sort();
    (found, used, ending)
}

const VARIANTS: [Variant; 3] = [Variant::Standard, Variant::Improved, Variant::SelfAdaptive];

#[test]
fn every_variant_finds_a_rod_and_says_after_how_many_improvisations() {
    for (mode, by_length, most) in
        [(Mode::Epipolar, true, 200), (Mode::Epipolar, false, 2_000), (Mode::None, false, 60_000)]
    {
        for variant in VARIANTS {
            let scene = DrawnScene::new(2, 4, 5);
            let params =
                Params { variant, by_length, stop_at_first: true, stale_rounds: 1000, ..Params::default() };
            let (found, used, ending) = run(&scene, params, mode, most, 1);
            assert_eq!(
                (found.matches().len(), ending),
                (1, Ending::Found),
                "{variant:?} {mode:?} after {used}"
            );
            assert!(used > 0 && used <= most);
        }
    }
}

#[test]
fn restarts_find_all_parts_of_a_scene() {
    for variant in VARIANTS {
        let scene = DrawnScene::new(2, 5, 5);
        let (found, used, ending) =
            run(&scene, Params { variant, ..Params::default() }, Mode::Epipolar, 1_000_000, 1);
        assert!(found.matches().len() >= 10, "each rod, either way round: {}", found.matches().len());
        assert!(ending == Ending::Stale { news: false } && used < 1_000_000, "{used}");
    }
}

#[test]
fn the_same_seed_gives_the_same_and_the_budget_is_kept() {
    let scene = DrawnScene::new(4, 3, 7);
    for variant in VARIANTS {
        for mode in [Mode::Epipolar, Mode::None] {
            let params = Params { variant, ..Params::default() };
            let one = run(&scene, params, mode, 777, 9);
            let two = run(&scene, params, mode, 777, 9);
            assert_eq!((one.0.matches(), one.1, one.2), (two.0.matches(), two.1, two.2));
            assert_eq!((one.1, one.2), (777, Ending::Spent));
        }
    }
}

#[test]
fn nothing_to_match_ends_at_once() {
    let scene = DrawnScene::new(2, 0, 1);
    for mode in [Mode::Epipolar, Mode::None] {
        let (found, used, _) = run(&scene, Params::default(), mode, 1000, 1);
        assert!(found.matches().is_empty() && used == 0);
    }
}

#[test]
fn a_better_harmony_takes_the_place_of_the_worst() {
    let mut memory = Memory { anchors: 1, notes: Vec::new(), fitness: Vec::new(), worst: 0 };
    for (note, fitness) in [(1, 10.0), (2, 2.0), (3, 53.0), (4, 21.0), (5, 77.0), (6, 73.0)] {
        memory.add(&[[note, 0]], fitness);
    }
    // the paper's Tables I to III
    memory.replace_worst(&[[7, 0]], 17.0);
    assert_eq!(memory.fitness, [10.0, 2.0, 53.0, 21.0, 17.0, 73.0]);
    assert_eq!(memory.column(0).nth(4), Some([7, 0]));
    assert_eq!(memory.worst, 5);
}

#[test]
fn a_table_of_lengths_is_not_filled_once_time_is_over() {
    let scene = DrawnScene::new(3, 5, 9);
    let mut table = LengthTable::new(scene.candidates.all().len());
    let mut is_filled = |budget| table.fill(&scene.model, &scene.candidates, 6.0, true, &budget);
    assert!(is_filled(Budget::Iterations(0)) && !is_filled(Budget::Until(Timestamp(0))));
}
