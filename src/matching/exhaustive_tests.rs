//! The exact search against brute force.

use proptest::prelude::*;

use super::*;
use crate::matching::candidates::Candidate;
use crate::matching::drawn::DrawnScene;
use crate::matching::fitness::distance_mm;
use crate::matching::nodes::NodeRole;
use crate::matching::problem::MatchModel;
use crate::part::Part;
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
            // What two nodes contradict no third one mends.
            let (i, model) = (chosen.len(), judge.model);
            let goes_with = |(j, other): (usize, &Option<usize>)| {
                let (Some(a), Some(b)) = (c.map(|c| &all[c]), other.map(|c| &all[c])) else { return true };
                let off_mm = f64::from(distance_mm(a, b)) - model.distance_mm(i, j);
                a.left != b.left && a.right != b.right && off_mm.abs() <= judge.length_tolerance_mm + 1e-3
            };
            if chosen.iter().enumerate().all(goes_with) {
                chosen.push(c);
                extend(judge, all, chosen, out);
                chosen.pop();
            }
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

/// A part of these nodes and edges.
fn part_of(nodes_mm: &[[f64; 2]], edges: &[[usize; 2]]) -> MatchModel {
    let node = |(n, [x, y]): (usize, &[f64; 2])| {
        format!("[[node]]\nname = \"{n}\"\nposition_mm = [{x}, {y}, 0.0]\n")
    };
    let nodes: String = nodes_mm.iter().enumerate().map(node).collect();
    let edge = |[from, to]: &[usize; 2]| format!("[[edge]]\nfrom = \"{from}\"\nto = \"{to}\"\n");
    let edges: String = edges.iter().map(edge).collect();
    let grasp = "[grasp]\nposition_mm = [9.0, 0.0, 0.0]\napproach = [0.0, 0.0, -1.0]\nclosing = [0.0, 1.0, 0.0]\nwidth_mm = 9.0\n";
    let text = format!("name = \"lines\"\nthickness_mm = 3.0\n{nodes}{edges}{grasp}");
    MatchModel::new(&Part::parse(&text, "lines.toml").expect("a part"))
}

/// A tee, a cross, an H, and a comb with two teeth.
fn part_with_lines(kind: usize) -> MatchModel {
    let star = [[0.0, 0.0], [-25.0, 0.0], [40.0, 0.0], [0.0, 20.0], [0.0, -30.0]];
    let aitch = [[-15.0, 0.0], [15.0, 0.0], [-15.0, -35.0], [-15.0, 10.0], [15.0, -12.0], [15.0, 22.0]];
    let comb = [[-15.0, 0.0], [10.0, 0.0], [-40.0, 0.0], [45.0, 0.0], [-15.0, 22.0], [10.0, 30.0]];
    match kind {
        0 => part_of(&star[..4], &[[0, 1], [0, 2], [0, 3]]),
        1 => part_of(&star, &[[0, 1], [0, 2], [0, 3], [0, 4]]),
        2 => part_of(&aitch, &[[0, 2], [0, 3], [1, 4], [1, 5], [0, 1]]),
        _ => part_of(&comb, &[[2, 0], [0, 1], [1, 3], [0, 4], [1, 5]]),
    }
}

/// The scene without so many junctions of its left picture.
fn without_junctions(mut scene: DrawnScene, hidden: usize) -> DrawnScene {
    let mut junctions = 0..hidden;
    scene.nodes[0].retain(|n| n.role != NodeRole::Junction || junctions.next().is_none());
    let [l, r] = &scene.nodes;
    scene.gate.run(&scene.rig, l, r, [0.0, 1e9]);
    scene.candidates.fill(&scene.rig.geometry(), scene.gate.nodes(), l, r, false);
    scene
}

#[test]
fn where_a_junction_is_left_out_the_bar_through_it_is_measured_and_the_leg_is_looked_for() {
    let scene = without_junctions(DrawnScene::of(part_with_lines(0), 1, 5), 1);
    let best_of = |scene: &DrawnScene| exact(scene, limits(1.0, u64::MAX)).0.matches().first().copied();
    let best = best_of(&scene).expect("a match");
    assert_eq!(best.nodes[..4].iter().filter(|n| **n == UNMATCHED).count(), 1);
    assert!(best.nodes[0] == UNMATCHED && best.fitness < 0.3, "{best:?}");
    let chosen_of = |scene: &DrawnScene| {
        let of = |n: &u16| scene.candidates.all().iter().position(|c| c.stereo == *n);
        best.nodes[..4].iter().map(of).collect::<Vec<_>>()
    };
    let terms_of = |scene: &DrawnScene| {
        let chosen: Vec<_> = chosen_of(scene).iter().map(|c| c.map(|c| &scene.candidates.all()[c])).collect();
        scene.judge().terms(&chosen, f64::INFINITY).expect("no limit")
    };
    let whole = terms_of(&scene);
    assert!(whole.length_3d_mm > 0.0 && whole.length_2d_px > 0.0 && whole.missing < 0.05, "{whole:?}");
    // Wipe out what is drawn on one side of the bar in both pictures: the leg.
    let mut without_leg = scene.clone();
    let ends = chosen_of(&scene);
    for side in 0..2 {
        let px = |n: usize| scene.candidates.all()[ends[n].expect("matched")].seen_px[side];
        let ([a, b], leg) = ([px(1), px(2)], px(3));
        let across = |p: [f32; 2]| {
            let (x, y) = (b[0] - a[0], b[1] - a[1]);
            ((p[1] - a[1]) * x - (p[0] - a[0]) * y) / x.hypot(y)
        };
        for (x, y) in (0..480).flat_map(|y| (0..640).map(move |x| (x, y))) {
            if across([x as f32, y as f32]) * across(leg).signum() > 4.0 {
                without_leg.masks[side].set(x, y, false);
            }
        }
    }
    let bare = terms_of(&without_leg);
    assert!(bare.missing > 0.15 && bare.length_3d_mm == whole.length_3d_mm, "{bare:?}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]
    #[test]
    fn finds_what_brute_force_finds_where_junctions_are_left_out(
        (kind, parts) in prop_oneof![Just((0, 2)), Just((1, 2)), Just((2, 1)), Just((3, 1))],
        hidden in 0usize..3,
        holes in proptest::collection::vec((0usize..64, 0i32..12), 0..10),
        seed in 0u64..1000,
        fitness_max in 0.2f64..2.0,
    ) {
        let mut scene = without_junctions(DrawnScene::of(part_with_lines(kind), parts, seed), hidden);
        let anchors = scene.model.anchors.len();
        prop_assume!(scene.candidates.all().len() <= 24);
        // Wire that is not seen, near nodes.
        for (place, radius) in holes {
            let side = place % 2;
            let near = &scene.nodes[side][place % scene.nodes[side].len()].position_px;
            let (x, y) = (near.x as i32 + 9, near.y as i32);
            let hole = (-radius..radius).flat_map(|dy| (-radius..radius).map(move |dx| (x + dx, y + dy)));
            for (x, y) in hole.filter(|(x, y)| (0..640).contains(x) && (0..480).contains(y)) {
                scene.masks[side].set(x as usize, y as usize, false);
            }
        }
        let (found, search) = exact(&scene, limits(fitness_max, u64::MAX));
        prop_assert!(search.is_complete());
        let mut expected = brute_force(&scene.judge(), scene.candidates.all(), fitness_max);
        expected.sort_by(|a, b| a.fitness.total_cmp(&b.fitness).then(a.nodes[..anchors].cmp(&b.nodes[..anchors])));
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
