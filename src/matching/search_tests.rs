//! All methods with both gates over drawn scenes.

use super::*;
use crate::matching::drawn::DrawnScene;

const METHODS: [Method; 6] = [
    Method::Auto,
    Method::Harmony,
    Method::Improved,
    Method::SelfAdaptive,
    Method::Random,
    Method::Exhaustive,
];

fn run(scene: &DrawnScene, method: Method, mode: Mode, n: u64, seed: u64) -> Search {
    let params = Params { method, fitness_max: 0.6, ..Params::default() };
    let mut search = Search::new(params, GateParams { mode, ..GateParams::default() }, 2);
    for _ in 0..2 {
        let [l, r] = &scene.nodes;
        search.run(&scene.rig, l, r, [0.0, 1e9], |_| scene.judge(), Budget::Iterations(n), seed);
    }
    search
}

/// How many of the scene's rods are among the matches of a part.
fn rods_found(scene: &DrawnScene, search: &Search, part: usize) -> usize {
    let ends = |k: usize| move |pose: &nalgebra::Isometry3<f64>| pose * scene.model.anchors[k].position_mm;
    let is_there = |pose: &&nalgebra::Isometry3<f64>| {
        search.matches(part).iter().any(|m| {
            [0, 1].iter().all(|&k| {
                let found = search.nodes()[m.nodes[k] as usize].point_mm;
                (found - ends(k)(pose)).norm() < 5.0
            })
        })
    };
    scene.left_from_part.iter().filter(is_there).count()
}

#[test]
fn every_method_finds_every_rod_of_both_parts_behind_a_closed_gate() {
    let scene = DrawnScene::new(2, 4, 5);
    for method in METHODS {
        let search = run(&scene, method, Mode::Epipolar, 2_000_000, 1);
        assert_eq!([0, 1].map(|p| rods_found(&scene, &search, p)), [4, 4], "{method:?}");
        assert!(!search.is_out_of_time() && search.iterations() > 0, "{method:?}");
        assert!(search.near_nodes().count() >= 8);
    }
}

#[test]
fn every_method_finds_rods_with_the_gate_open() {
    let scene = DrawnScene::new(2, 3, 5);
    for method in METHODS {
        let search = run(&scene, method, Mode::None, 300_000, 1);
        let least = if matches!(method, Method::Auto | Method::Exhaustive) { 3 } else { 1 };
        assert!(rods_found(&scene, &search, 0) >= least, "{method:?}: {:?}", search.matches(0));
    }
}

#[test]
fn a_seed_repeats_and_a_budget_is_kept_by_every_method() {
    let scene = DrawnScene::new(3, 6, 6);
    for method in METHODS {
        for mode in [Mode::Epipolar, Mode::None] {
            let [one, two] = [4, 4].map(|seed| run(&scene, method, mode, 12, seed));
            assert_eq!(one.matches(0), two.matches(0), "{method:?}");
            assert_eq!(one.nodes(), two.nodes());
            assert!(one.iterations() <= 12 && one.iterations() == two.iterations());
            assert!(one.is_out_of_time() && run(&scene, method, mode, 0, 4).iterations() == 0);
        }
    }
}

#[test]
fn auto_leaves_a_tree_that_is_too_large_to_harmony_search() {
    let scene = DrawnScene::new(2, 4, 5);
    let mut params = Params { exact_steps_max: 3, fitness_max: 0.6, ..Params::default() };
    let mut runs = [Method::Auto, Method::Harmony].map(|method| {
        params.method = method;
        let mut search = Search::new(params, GateParams::default(), 1);
        let [l, r] = &scene.nodes;
        search.run(&scene.rig, l, r, [0.0, 1e9], |_| scene.judge(), Budget::Iterations(1_000_000), 1);
        search
    });
    assert_eq!(rods_found(&scene, &runs[0], 0), 4);
    assert!(runs[0].iterations() > 100 && !runs[0].is_out_of_time());
    runs.reverse();
    assert_eq!(rods_found(&scene, &runs[0], 0), 4);
}

#[test]
fn a_run_cut_by_its_count_is_repeated_by_that_count() {
    let scene = DrawnScene::new(3, 5, 9);
    for method in METHODS {
        let whole = run(&scene, method, Mode::Epipolar, 3_000_000, 1);
        let again = run(&scene, method, Mode::Epipolar, whole.iterations(), 1);
        assert_eq!(whole.matches(1), again.matches(1), "{method:?}");
    }
}
