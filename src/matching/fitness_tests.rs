//! Each term alone can refuse a candidate; fast projection against the exact one.

use nalgebra::{Isometry3, Vector2, Vector3};

use super::*;
use crate::matching::drawn::DrawnScene;

const LIMIT: f64 = 1.0;

/// The true candidates of a drawn scene's first part, as if the pictures had no noise.
fn perfect(scene: &DrawnScene) -> Vec<Candidate> {
    let geometry = scene.rig.geometry();
    let pose = scene.left_from_part[0];
    let true_one = |(n, anchor): (usize, &crate::matching::problem::Anchor)| {
        let point = pose * anchor.position_mm;
        let px = [scene.rig.project_left(&point).unwrap(), scene.rig.project_right(&point).unwrap()]
            .map(|px| [px.x as f32, px.y as f32]);
        let right = geometry.rotation * point.coords + geometry.translation_mm;
        Candidate {
            point_mm: [point.x as f32, point.y as f32, point.z as f32],
            right_z_mm: right.z as f32,
            node_px: px,
            seen_px: px,
            gap_px: 0.0,
            left: n as u16,
            right: n as u16,
            stereo: n as u16,
            role: anchor.role,
            explained: true,
        }
    };
    scene.model.anchors.iter().enumerate().map(true_one).collect()
}

fn terms(judge: &Judge, candidates: &[Candidate], limit: f64) -> Option<Terms> {
    let chosen: Vec<_> = candidates.iter().map(Some).collect();
    judge.terms(&chosen, limit)
}

#[test]
fn a_part_seen_without_noise_has_no_fitness() {
    for anchors in [2, 3, 5, 8] {
        let scene = DrawnScene::new(anchors, 1, 3);
        let t = terms(&scene.judge(), &perfect(&scene), LIMIT).unwrap();
        assert!(t.is_match() && t.fitness(&Weights::default()) < 0.01, "{t:?}");
    }
}

#[test]
fn the_wrong_length_in_space_alone_refuses() {
    let scene = DrawnScene::new(2, 1, 3);
    let mut judge = scene.judge();
    let mut model = scene.model.clone();
    model.spans[0].length_mm += 12.0;
    (judge.model, judge.weights.length_2d_per_px, judge.length_tolerance_mm) = (&model, 0.0, 20.0);
    assert_eq!(terms(&judge, &perfect(&scene), LIMIT), None);
    let t = terms(&judge, &perfect(&scene), 2.0).unwrap();
    assert!((t.length_3d_mm - 12.0).abs() < 1e-3 && t.missing == 0.0 && t.gap_px == 0.0 && t.is_match());
}

#[test]
fn the_wrong_length_in_the_pictures_alone_refuses() {
    let scene = DrawnScene::new(2, 1, 3);
    let mut candidates = perfect(&scene);
    // both nodes drawn apart along the wire, in both pictures, their points in space left as they are
    for side in 0..2 {
        let [a, b] = [candidates[0].seen_px[side], candidates[1].seen_px[side]];
        let along = [b[0] - a[0], b[1] - a[1]];
        let length = along[0].hypot(along[1]);
        candidates[1].node_px[side] = [0, 1].map(|k| b[k] + along[k] / length * 22.0);
    }
    assert_eq!(terms(&scene.judge(), &candidates, LIMIT), None);
    let t = terms(&scene.judge(), &candidates, 2.0).unwrap();
    assert!((t.length_2d_px - 22.0).abs() < 0.01 && t.length_3d_mm < 0.01 && t.missing == 0.0, "{t:?}");
}

#[test]
fn missing_wire_alone_refuses() {
    let scene = DrawnScene::new(2, 1, 3);
    let empty = BitImage::new(640, 480);
    let judge = Judge { masks: [&scene.masks[0], &empty], ..scene.judge() };
    assert_eq!(terms(&judge, &perfect(&scene), LIMIT), None);
    let t = terms(&judge, &perfect(&scene), 1.5).unwrap();
    assert!(t.missing == 0.5 && t.length_3d_mm < 0.01 && t.is_match(), "{t:?}");
}

#[test]
fn a_gap_alone_refuses() {
    let scene = DrawnScene::new(2, 1, 3);
    let mut candidates = perfect(&scene);
    candidates.iter_mut().for_each(|c| c.gap_px = 21.0);
    assert_eq!(terms(&scene.judge(), &candidates, LIMIT), None);
    assert!(terms(&scene.judge(), &candidates, 1.1).is_some());
}

#[test]
fn nodes_without_a_match_alone_refuse() {
    let mut scene = DrawnScene::new(24, 0, 3);
    scene.left_from_part.push(Isometry3::translation(0.0, 0.0, 900.0));
    for mask in &mut scene.masks {
        (0..480).for_each(|y| (0..640).for_each(|x| mask.set(x, y, true)));
    }
    let judge = scene.judge();
    let candidates = perfect(&scene);
    let mut chosen: Vec<_> = candidates.iter().map(Some).collect();
    chosen[12..].fill(None);
    assert_eq!(judge.terms(&chosen, LIMIT), None);
    let t = judge.terms(&chosen, 1.3).unwrap();
    assert!(t.unmatched == 12.0 && t.is_match() && t.length_3d_mm < 0.01, "{t:?}");
}

#[test]
fn every_contradiction_alone_refuses() {
    let scene = DrawnScene::new(3, 1, 3);
    let good = perfect(&scene);
    let refused = |change: &dyn Fn(&mut Candidate)| {
        let mut middle = good[1];
        change(&mut middle);
        let chosen = [Some(&good[0]), Some(&middle), Some(&good[2])];
        assert_eq!(scene.judge().terms(&chosen, LIMIT), None);
        !scene.judge().terms(&chosen, 1e9).unwrap().is_match()
    };
    assert!(refused(&|c| c.explained = false), "no point in space");
    assert!(refused(&|c| c.left = 0), "a node taken twice");
    assert!(refused(&|c| c.role = NodeRole::End), "an end for a bend");
    assert!(refused(&|c| c.point_mm[2] += 30.0), "a distance over the tolerance");
    let one = good[0];
    let t = scene.judge().terms(&[Some(&one), None, None], 1e9).unwrap();
    assert!(!t.is_match() && t.contradictions == 2.0, "too few nodes");
}

#[test]
fn a_bare_span_alone_refuses() {
    let scene = DrawnScene::new(8, 1, 3);
    let mut masks = scene.masks.clone();
    let candidates = perfect(&scene);
    // wire cut out about the middle of the first span, in both pictures
    for (side, mask) in masks.iter_mut().enumerate() {
        let [a, b] = [0, 1].map(|k| candidates[k].seen_px[side]);
        let (x, y) = (((a[0] + b[0]) / 2.0) as usize, ((a[1] + b[1]) / 2.0) as usize);
        let half = ((a[0] - b[0]).hypot(a[1] - b[1]) * 0.4) as usize;
        for y in y.saturating_sub(half)..(y + half).min(480) {
            (x.saturating_sub(half)..(x + half).min(640)).for_each(|x| mask.set(x, y, false));
        }
    }
    let judge = Judge { masks: [&masks[0], &masks[1]], ..scene.judge() };
    assert_eq!(terms(&judge, &candidates, LIMIT), None);
    let t = terms(&judge, &candidates, 1e9).unwrap();
    assert!(t.contradictions >= 1.0 && t.missing < 0.5 && t.length_3d_mm < 0.01, "{t:?}");
}

#[test]
fn the_parabola_keeps_to_the_exact_projection() {
    let scene = DrawnScene::new(2, 40, 8);
    let mut worst = 0f64;
    for pose in &scene.left_from_part {
        let [a, b] = [0, 1].map(|k| pose * scene.model.anchors[k].position_mm);
        let exact = |t: f64| scene.rig.project_left(&(a + (b - a) * t)).unwrap();
        let [from, middle, to] = [0.0, 0.5, 1.0].map(exact);
        let single = |px: Vector2<f64>| px.map(|v| v as f32).into();
        let curve = Parabola::new(single(from), single(middle), single(to));
        for k in 1..20 {
            let t = k as f64 / 20.0;
            let at = Vector2::from(curve.at(2.0 * t as f32 - 1.0).map(f64::from));
            let along = (to - from).normalize();
            worst = worst.max((at - exact(t)).perp(&along).abs());
        }
    }
    assert!(worst < 0.1, "{worst} px");
}

#[test]
fn coverage_is_the_share_of_the_wire_that_is_there() {
    let scene = DrawnScene::new(4, 1, 3);
    let judge = scene.judge();
    assert!(judge.coverage(&scene.left_from_part[0], 0.0).unwrap() > 0.99);
    let behind = Isometry3::new(Vector3::new(0.0, 0.0, -500.0), Vector3::zeros());
    assert_eq!(judge.coverage(&behind, 0.0), Some(0.0));
    let aside = Isometry3::translation(6.0, 6.0, 0.0) * scene.left_from_part[0];
    let share = judge.coverage(&aside, 0.0).unwrap();
    assert!(share < 0.4);
    assert_eq!([share, share + 0.01].map(|least| judge.coverage(&aside, least)), [Some(share), None]);
}
