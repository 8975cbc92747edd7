//! The exact search against brute force.

use proptest::prelude::*;

use super::*;
use crate::matching::candidates::Candidate;
use crate::matching::drawn::DrawnScene;
use crate::matching::nodes::NodeRole;
use crate::matching::problem::MatchModel;
use crate::time::Budget;

/// All matches under the threshold but those that are part of one with one node more and no worse, by trying
/// everything.
fn brute_force(judge: &Judge, all: &[Candidate], fitness_max: f64) -> Vec<StereoMatch> {
    fn extend(
        judge: &Judge,
        all: &[Candidate],
        chosen: &mut Vec<Option<usize>>,
        out: &mut Vec<Vec<Option<usize>>>,
    ) {
        if chosen.len() == judge.model.anchors.len() {
            out.push(chosen.clone());
            return;
        }
        for c in (0..all.len()).map(Some).chain([None]) {
            chosen.push(c);
            extend(judge, all, chosen, out);
            chosen.pop();
        }
    }
    let mut complete = Vec::new();
    extend(judge, all, &mut Vec::new(), &mut complete);
    let fitness = |chosen: &[Option<usize>]| {
        let chosen: Vec<_> = chosen.iter().map(|c| c.map(|c| &all[c])).collect();
        let terms = judge.terms(&chosen, f64::INFINITY).filter(|t| t.is_match())?;
        Some(terms.fitness(&judge.weights))
    };
    let mut found = Vec::new();
    for chosen in complete {
        let Some(f) = fitness(&chosen).filter(|f| *f < fitness_max) else { continue };
        let extended = (0..chosen.len()).filter(|a| chosen[*a].is_none()).any(|a| {
            (0..all.len()).any(|n| {
                let mut more = chosen.clone();
                more[a] = Some(n);
                fitness(&more).is_some_and(|g| g <= f)
            })
        });
        if !extended {
            let mut nodes = [UNMATCHED; ANCHORS_MAX];
            for (node, c) in nodes.iter_mut().zip(&chosen) {
                *node = c.map_or(UNMATCHED, |c| all[c].stereo);
            }
            found.push(StereoMatch { nodes, fitness: f });
        }
    }
    found
}

fn exact(scene: &DrawnScene, limits: Limits) -> (Found, Exhaustive) {
    let mut found = Found::new(4096);
    let mut search = Exhaustive::new(scene.candidates.all().len());
    search.run(&scene.judge(), &scene.candidates, limits, &mut found);
    found.sort();
    (found, search)
}

fn limits(fitness_max: f64, iterations: u64) -> Limits {
    Limits { fitness_max, budget: Budget::Iterations(iterations), steps_max: u64::MAX }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]
    #[test]
    fn finds_what_brute_force_finds(
        (anchors, parts) in prop_oneof![Just((2, 6)), Just((3, 3)), Just((4, 2))],
        seed in 0u64..1000,
        fitness_max in 0.2f64..2.5,
    ) {
        let scene = DrawnScene::new(anchors, parts, seed);
        prop_assume!(scene.candidates.all().len().pow(anchors as u32) < 400_000);
        let (found, search) = exact(&scene, limits(fitness_max, u64::MAX));
        prop_assert!(search.is_complete());
        let mut expected = brute_force(&scene.judge(), scene.candidates.all(), fitness_max);
        expected.sort_by(|a, b| a.fitness.total_cmp(&b.fitness).then(a.nodes.cmp(&b.nodes)));
        prop_assert_eq!(found.matches(), &expected[..]);
    }
}

#[test]
fn a_hidden_node_leaves_a_match_of_the_others() {
    let scene = DrawnScene::new(4, 1, 11);
    let mut hidden = scene.clone();
    hidden.nodes[0].retain(|n| n.role == NodeRole::End || n.position_px != first_bend(&scene));
    let [l, r] = &hidden.nodes;
    hidden.gate.run(&hidden.rig, l, r, [0.0, 1e9]);
    hidden.candidates.fill(&hidden.rig.geometry(), hidden.gate.nodes(), l, r, false);
    let whole = exact(&scene, limits(1.0, u64::MAX)).0;
    let rest = exact(&hidden, limits(1.0, u64::MAX)).0;
    assert_eq!(whole.matches()[0].nodes[..4].iter().filter(|n| **n == UNMATCHED).count(), 0);
    assert_eq!(rest.matches()[0].nodes[..4].iter().filter(|n| **n == UNMATCHED).count(), 1);
    assert!(rest.matches()[0].fitness > whole.matches()[0].fitness);
}

fn first_bend(scene: &DrawnScene) -> nalgebra::Vector2<f64> {
    scene.nodes[0].iter().find(|n| n.role == NodeRole::Bend).unwrap().position_px
}

#[test]
fn a_budget_and_a_count_of_steps_are_kept() {
    let scene = DrawnScene::new(3, 5, 2);
    let whole = exact(&scene, limits(1.0, u64::MAX)).1;
    assert!(whole.is_complete());
    let again = exact(&scene, limits(1.0, whole.steps()));
    assert!(again.1.is_complete(), "a budget of what was used is enough");
    let cut = exact(&scene, limits(1.0, 7)).1;
    assert!(!cut.is_complete() && cut.steps() == 7);
    let cut = exact(&scene, Limits { steps_max: 5, ..limits(1.0, 7) }).1;
    assert!(!cut.is_complete() && cut.steps() == 5);
}

#[test]
fn of_matches_that_are_the_same_turned_one_is_found() {
    let file = |name: &str| std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("replay/parts").join(name);
    for (name, turn) in [("tee.toml", [1, 0, 2, 3]), ("zed.toml", [1, 0, 3, 2])] {
        let model = MatchModel::new(&crate::part::Part::read(file(name)).unwrap());
        for seed in 0..4 {
            let mut scene = DrawnScene::of(model.clone(), 4, seed);
            let once = exact(&scene, limits(1.5, u64::MAX)).0;
            scene.model.turned = None;
            let twice = exact(&scene, limits(1.5, u64::MAX)).0;
            let turned = |m: &StereoMatch| {
                let mut nodes = [UNMATCHED; ANCHORS_MAX];
                turn.iter().enumerate().for_each(|(k, &t)| nodes[t] = m.nodes[k]);
                nodes
            };
            assert!(once.matches().len() >= 4, "{name}: {}", once.matches().len());
            assert_eq!(2 * once.matches().len(), twice.matches().len(), "{name}, seed {seed}");
            for found in twice.matches() {
                let ways = [found.nodes, turned(found)];
                assert_eq!(once.matches().iter().filter(|m| ways.contains(&m.nodes)).count(), 1, "{name}");
            }
        }
    }
}
