//! Each term of a fitted part alone can refuse it.

use std::path::Path;

use super::*;
use crate::matching::fitness::Weights;
use crate::matching::search;
use crate::part::Part;
use crate::pose::drawn::DrawnPair;
use crate::pose::refine::Params;

fn rod(name: &str) -> PoseModel {
    let part = Path::new(env!("CARGO_MANIFEST_DIR")).join("replay/parts").join(name);
    PoseModel::new(&Part::read(part).unwrap())
}

/// What a drawn pair says of a rod of 90 mm just where this one lies.
fn verdict_on(lying: &PoseModel) -> Verdict {
    let long = rod("rod-90.toml");
    let truth = Isometry3::new(Vector3::new(20.0, -10.0, 470.0), Vector3::z() * 0.9);
    let drawn = DrawnPair::new(&[(lying, truth)]);
    let mut refine = Refine::new(Params { lift_radii: 0.0, ..Params::default() }, &drawn.rig);
    let fit = refine.fine(&long, &truth, &drawn.views()).unwrap();
    let mut verdict = Verdict::default();
    verify(&refine, &long, &[], &fit.left_from_part, &drawn.views(), &mut verdict);
    verdict
}

/// The fitness, and how many terms are more than what the drawing's pixels leave.
fn fitness(verdict: &Verdict, nodes_unseen: usize) -> (f64, usize) {
    let t = verdict.terms(nodes_unseen);
    let large = [t.length_2d_px > 1.0, t.missing > 0.01, t.gap_px > 1.0, t.unmatched > 0.0];
    assert_eq!((t.length_3d_mm, t.contradictions), (0.0, 0.0));
    (t.fitness(&Weights::default()), large.into_iter().filter(|&is_large| is_large).count())
}

#[test]
fn each_term_alone_reaches_the_largest_fitness_allowed() {
    let fitness_max = search::Params::default().fitness_max;
    let good = verdict_on(&rod("rod-90.toml"));
    let (of_good, large) = fitness(&good, 0);
    assert!(of_good < 0.1 * fitness_max && large == 0, "{of_good}");
    // Four ends seen, each 21 pixels from where it should be; two do as well as four.
    let ends_off =
        |seen: u32| Verdict { ends_seen: seen, ends_off_px: 21.0 * f64::from(seen), ..good.clone() };
    let missing = Verdict { missing: [0.5; 2], ..good.clone() };
    let missing_in_one = Verdict { missing: [0.0, 1.0], ..good.clone() };
    let gap = Verdict { offset_px: 21.0, ..good.clone() };
    let refused = [
        ("ends off", ends_off(4), 0),
        ("two ends off", ends_off(2), 0),
        ("missing", missing, 0),
        ("missing in one picture", missing_in_one, 0),
        ("gap", gap, 0),
        ("unmatched", good.clone(), 10),
    ];
    for (term, verdict, nodes_unseen) in refused {
        let (fitness, large) = fitness(&verdict, nodes_unseen);
        assert!(fitness >= fitness_max && large == 1, "{term}: {fitness}, {large} terms");
    }
    // Less of each is a part.
    let less = Verdict { missing: [0.4; 2], ..good.clone() };
    assert!(fitness(&less, 0).0 < fitness_max && fitness(&good, 9).0 < fitness_max);
}

#[test]
fn wire_that_is_drawn_elsewhere_is_missing_and_refused() {
    // On the wire of a shorter rod: a third of it is floor.
    let terms = verdict_on(&rod("rod-60.toml")).terms(0);
    assert!((0.25..0.4).contains(&terms.missing), "{terms:?}");
    assert!(terms.missing * Weights::default().missing > 0.5, "{terms:?}");
}
