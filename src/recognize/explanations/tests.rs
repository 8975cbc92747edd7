//! Explanations of drawn pictures and of a recorded pair.

use std::path::Path;

use nalgebra::Point3;

use super::*;
use crate::frame::{Frame, FramePair};
use crate::grasp::Blocked;
use crate::part::Part;
use crate::pose::section::HALF_WAY;
use crate::pose::slide;
use crate::recognize::lighting::Lighting;
use crate::recognize::views::views;
use crate::recognize::{FoundPart, Params, Recognition, Recognizer};
use crate::rig::CameraModel;
use crate::session::read_picture;
use crate::time::{Budget, Timestamp};

/// What a pair of the recorded session, ten rods over each other, made the recogniser know.
fn after_a_pair() -> Recognizer {
    let replay = Path::new(env!("CARGO_MANIFEST_DIR")).join("replay");
    let picture = |side: &str| read_picture(&replay.join("conveyor").join(side).join("0000.jpg")).unwrap();
    let pair = FramePair { left: picture("left"), right: picture("right") };
    let rig = Rig::read(replay.join("conveyor/calibration.yaml")).unwrap();
    let part = Part::read(replay.join("parts/rod-90.toml")).unwrap();
    // None of these is there, but many seem so.
    let shorter = rod("rod-60", 60.0);
    let mut recognizer = Recognizer::new(Params::default(), rig, vec![part, shorter]).unwrap();
    recognizer.run(&pair, Budget::Iterations(100_000), 1, &mut Recognition::default()).unwrap();
    recognizer
}

/// The competition with every worth asked again each time.
fn compete_slowly(
    explanations: &mut Explanations,
    parts: &[Prepared],
    params: &select::Params,
) -> Vec<usize> {
    explanations.claims.iter_mut().for_each(ClaimMap::clear);
    let mut standing = Vec::new();
    loop {
        let most = (0..explanations.count)
            .filter(|i| !standing.contains(i))
            .map(|i| (i, explanations.list[i].worth(parts, params, &explanations.claims).now_mm))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        let Some((index, _)) = most.filter(|(_, worth_mm)| *worth_mm > 0.0) else { return standing };
        explanations.claim(index);
        standing.push(index);
    }
}

#[test]
fn every_coarse_pose_is_refined_but_once() {
    let Recognizer { explanations, parts, .. } = after_a_pair();
    let refined = &explanations.refined;
    assert!(refined.len() > 10 && refined.iter().any(|r| r.led_to.is_some()));
    for (k, a) in refined.iter().enumerate() {
        assert!(a.led_to.is_none_or(|index| explanations.list[index].hypothesis.part == a.part));
        let is_same =
            |b: &Refined| b.part == a.part && parts[a.part].distance_mm(&a.coarse, &b.coarse) < SAME_START_MM;
        assert!(!refined[..k].iter().any(is_same));
    }
}

#[test]
fn the_competition_ends_as_if_every_worth_were_asked_again_each_time() {
    let Recognizer { mut explanations, parts, params, .. } = after_a_pair();
    let expected = compete_slowly(&mut explanations, &parts, &params.select);
    explanations.decided = None;
    let whole = || Budget::Iterations(0).exchanges(1.0);
    assert!(explanations.weigh(&parts, &params.select, &mut whole()));
    assert_eq!(explanations.standing, expected);
    // What is known already is not held again, and the same.
    explanations.weigh(&parts, &params.select, &mut whole());
    assert_eq!(explanations.standing, expected);
    let mut over = Budget::Until(Timestamp(0)).exchanges(1.0);
    assert!(!explanations.weigh(&parts, &params.select, &mut over), "nothing was weighed");
    assert_eq!(explanations.standing, expected);
    assert_eq!(expected.len(), 10);
    assert!(explanations.count > 10, "others were refused");
}

/// Lit rods of 3 mm from one place to another, both in the left camera's frame, on a dark floor.
fn drawn(rig: &Rig, rods: &[[Point3<f64>; 2]]) -> FramePair {
    drawn_in_light(rig, rods, |inside_px| (inside_px + 0.5).clamp(0.0, 1.0) * (1.0 + 0.05 * inside_px))
}

/// The same with this light so far inside their border, in pixels; their axis is 3.45 inside.
fn drawn_in_light(rig: &Rig, rods: &[[Point3<f64>; 2]], light: fn(f64) -> f64) -> FramePair {
    let frame = |side: usize| {
        let see = |p: &Point3<f64>| if side == 0 { rig.project_left(p) } else { rig.project_right(p) };
        let rods: Vec<_> = rods.iter().map(|rod| rod.map(|p| see(&p).unwrap())).collect();
        let grey = |x: usize, y: usize| {
            let px = Vector2::new(x as f64, y as f64);
            let covered = |[a, b]: &[Vector2<f64>; 2]| {
                let along = (b - a).normalize();
                let half_px = 1.5 * 1150.0 / 500.0;
                let inside = (px - a).dot(&along).min((b - px).dot(&along));
                let beside = half_px - (px - a).perp(&along).abs();
                (inside + 0.5).clamp(0.0, 1.0) * light(beside)
            };
            40.0 + 140.0 * rods.iter().map(covered).fold(0.0, f64::max)
        };
        let pixels = (0..480).flat_map(|y| (0..640).flat_map(move |x| [(x, y); 3]));
        Frame::from_rgb(640, 480, pixels.map(|(x, y)| grey(x, y) as u8).collect())
    };
    FramePair { left: frame(0), right: frame(1) }
}

fn rod(name: &str, length_mm: f64) -> Part {
    let half = length_mm / 2.0;
    let text = format!(
        "name = '{name}'\nthickness_mm = 3.0\nnode = [{{ name = 'a', position_mm = [-{half:.1}, 0.0, 0.0] }}, \
         {{ name = 'b', position_mm = [{half:.1}, 0.0, 0.0] }}]\nedge = [{{ from = 'a', to = 'b' }}]\n\
         grasp = {{ position_mm = [0.0, 0.0, 0.0], approach = [0.0, 0.0, -1.0], closing = [0.0, 1.0, 0.0], \
         width_mm = 8.0 }}\n"
    );
    Part::parse(&text, "test.toml").unwrap()
}

#[test]
fn two_that_explain_all_wire_stand_before_one_that_explains_most_of_it() {
    let camera = CameraModel::pinhole(640, 480, 1150.0, 320.0, 240.0);
    let rig = Rig { left: camera, right: camera, right_from_left: Isometry3::translation(-60.0, 0.0, 0.0) };
    // End to end, without a gap that the mask would show: a rod of 120 mm fits the middle, too.
    let along = Vector3::new(0.5, 0.8, 0.0).normalize();
    let at = |mm: f64| Point3::new(30.0, 0.0, 500.0) + along * mm;
    let pair = drawn(&rig, &[[at(-75.0), at(75.0)]]);
    let mut recognizer =
        Recognizer::new(Params::default(), rig, vec![rod("rod-120", 120.0), rod("rod-75", 75.0)]).unwrap();
    let mut found = Recognition::default();
    recognizer.run(&pair, Budget::Iterations(100_000), 1, &mut found).unwrap();
    let mut middles: Vec<_> = found
        .parts
        .iter()
        .map(|p| (p.part, (p.left_from_part.translation.vector - at(0.0).coords).dot(&along)))
        .collect();
    middles.sort_by(|a, b| a.1.total_cmp(&b.1));
    let [(1, first), (1, second)] = middles[..] else { panic!("{middles:?}") };
    assert!((first + 37.5).abs() < 1.0 && (second - 37.5).abs() < 1.0, "{first} {second}");
}

#[test]
fn a_rod_with_both_ends_on_others_lies_in_the_middle_of_where_it_can() {
    let camera = CameraModel::pinhole(640, 480, 1150.0, 320.0, 240.0);
    let rig = Rig { left: camera, right: camera, right_from_left: Isometry3::translation(-60.0, 0.0, 0.0) };
    let (along, across) = (Vector3::new(0.5, 0.8, 0.0).normalize(), Vector3::new(0.8, -0.5, 0.0).normalize());
    let at = |mm: f64, beside_mm: f64| Point3::new(30.0, 0.0, 500.0) + along * mm + across * beside_mm;
    let pair = drawn(
        &rig,
        &[
            [at(-37.5, 0.0), at(37.5, 0.0)],
            [at(-37.5, -20.0), at(-37.5, 20.0)],
            [at(37.5, -20.0), at(37.5, 20.0)],
        ],
    );
    let mut recognizer = Recognizer::new(Params::default(), rig, vec![rod("rod-75", 75.0)]).unwrap();
    recognizer.run(&pair, Budget::Iterations(100_000), 1, &mut Recognition::default()).unwrap();
    let Recognizer { pictures, parts, explanations, .. } = recognizer;
    let views = views(&pictures, &rig, &pair, Lighting::default()).unwrap();
    let turn = nalgebra::UnitQuaternion::rotation_between(&Vector3::x(), &along).unwrap();
    for displaced_mm in [-5.0, 0.0, 5.0] {
        let pose = Isometry3::from_parts(at(displaced_mm, 0.0).into(), turn);
        let model = parts[0].pose_model();
        let found = slide::to_middle(&explanations.refine, model, &pose, &views);
        let place_mm = (found.unwrap_or(pose).translation.vector - at(0.0, 0.0).coords).dot(&along);
        // To a place that is looked at: half a thickness.
        assert!(place_mm.abs() < 1.1, "{displaced_mm}: {place_mm}");
    }
}

#[test]
fn two_rods_end_to_end_are_not_offered_as_one_however_the_cameras_are_exposed() {
    let camera = CameraModel::pinhole(640, 480, 1150.0, 320.0, 240.0);
    let rig = Rig { left: camera, right: camera, right_from_left: Isometry3::translation(-60.0, 0.0, 0.0) };
    let at = |mm: f64| Point3::new(30.0 + 0.5 * mm, 0.8 * mm, 500.0);
    let half_mm = 37.5 / f64::hypot(0.5, 0.8);
    let mut recognizer = Recognizer::new(Params::default(), rig, vec![rod("rod-75", 75.0)]).unwrap();
    let mut blocked_with = |gap_mm: f64, right_share: f64| {
        let rods = [[at(-half_mm), at(-gap_mm / 2.0)], [at(gap_mm / 2.0), at(half_mm)]];
        let mut pair = drawn(&rig, &rods);
        pair.right.bytes.iter_mut().for_each(|v| *v = (f64::from(*v) * right_share) as u8);
        let mut found = Recognition::default();
        recognizer.run(&pair, Budget::Iterations(100_000), 1, &mut found).unwrap();
        let [one] = &found.parts[..] else { panic!("{} parts", found.parts.len()) };
        one.blocked
    };
    assert_eq!(blocked_with(0.0, 1.0), None);
    assert_eq!(blocked_with(1.2, 1.0), Some(Blocked::Unknown));
    assert_eq!(blocked_with(1.2, 0.4), Some(Blocked::Unknown));
}

#[test]
fn polished_rods_are_recognised() {
    let camera = CameraModel::pinhole(640, 480, 1150.0, 320.0, 240.0);
    let rig = Rig { left: camera, right: camera, right_from_left: Isometry3::translation(-60.0, 0.0, 0.0) };
    let at = |x: f64, y: f64| Point3::new(x, y, 500.0);
    let rods = [
        [at(-60.0, -40.0), at(0.0, -85.0)],
        [at(10.0, -50.0), at(55.0, 10.0)],
        [at(60.0, 70.0), at(90.0, 1.3)],
        [at(-20.0, 10.0), at(25.0, 70.0)],
    ];
    // A dark body with a line as wide as a third of it along its middle.
    let polished = |inside_px: f64| {
        0.35 * (inside_px + 0.5).clamp(0.0, 1.0) + 1.1 * (inside_px - 2.3 + 0.5).clamp(0.0, 1.0)
    };
    let mut recognizer = Recognizer::new(Params::default(), rig, vec![rod("rod-75", 75.0)]).unwrap();
    let mut found = Recognition::default();
    recognizer
        .run(&drawn_in_light(&rig, &rods, polished), Budget::Iterations(100_000), 1, &mut found)
        .unwrap();
    assert!(recognizer.lighting.outline_256 < HALF_WAY);
    for rod in &rods {
        let middle = nalgebra::center(&rod[0], &rod[1]);
        let near = |p: &&FoundPart| (p.left_from_part.translation.vector - middle.coords).norm() < 1.0;
        assert!(found.parts.iter().any(|p| near(&p)), "{middle} of {:?}", found.parts);
    }
}

/// What is brighter of two pairs, pixel by pixel.
fn brighter_of(one: &FramePair, other: &FramePair) -> FramePair {
    let frame = |a: &Frame, b: &Frame| {
        Frame::from_rgb(640, 480, a.bytes.iter().zip(&b.bytes).map(|(a, b)| *a.max(b)).collect())
    };
    FramePair { left: frame(&one.left, &other.left), right: frame(&one.right, &other.right) }
}

#[test]
fn what_is_in_doubt_and_much_dimmer_than_a_proven_part_is_none() {
    let camera = CameraModel::pinhole(640, 480, 1150.0, 320.0, 240.0);
    let rig = Rig { left: camera, right: camera, right_from_left: Isometry3::translation(-60.0, 0.0, 0.0) };
    let at = |x: f64, y: f64| Point3::new(30.0 + x, y, 500.0);
    // The ends of a stretch of wire lie on others, and do not tell whether it is a part.
    let across = [[at(-40.0, -37.5), at(40.0, -37.5)], [at(-40.0, 37.5), at(40.0, 37.5)]];
    let (stretch, whole) = ([at(20.0, -37.5), at(20.0, 37.5)], [at(-30.0, -25.0), at(-60.0, 43.7)]);
    let mut params = Params::default();
    for range in &mut params.binarize {
        range.colour = crate::vision::binarize::ColourRange::Grey { min: 65, max: 255 };
    }
    let mut recognizer = Recognizer::new(params, rig, vec![rod("rod-75", 75.0)]).unwrap();
    let mut has_stretch = |bright: &[[Point3<f64>; 2]], light: fn(f64) -> f64| {
        let pair = brighter_of(&drawn(&rig, bright), &drawn_in_light(&rig, &[stretch], light));
        let mut found = Recognition::default();
        recognizer.run(&pair, Budget::Iterations(100_000), 1, &mut found).unwrap();
        let middle = at(20.0, 0.0).coords;
        found.parts.iter().any(|p| (p.left_from_part.translation.vector - middle).norm() < 8.0)
    };
    let bright: fn(f64) -> f64 = |inside_px| 0.8 * (inside_px + 0.5).clamp(0.0, 1.0);
    let dim: fn(f64) -> f64 = |inside_px| 0.3 * (inside_px + 0.5).clamp(0.0, 1.0);
    let [a, b] = across;
    assert!(has_stretch(&[a, b, whole], bright), "nearly as bright as a part");
    assert!(!has_stretch(&[a, b, whole], dim), "much dimmer");
    assert!(has_stretch(&[a, b], dim), "of nothing it is known how bright parts are");
}

#[test]
fn wire_longer_than_the_part_is_not_two_parts_that_lie_in_each_other() {
    let camera = CameraModel::pinhole(640, 480, 1150.0, 320.0, 240.0);
    let rig = Rig { left: camera, right: camera, right_from_left: Isometry3::translation(-60.0, 0.0, 0.0) };
    let along = Vector3::new(0.5, 0.8, 0.0).normalize();
    let at = |mm: f64| Point3::new(30.0, 0.0, 500.0) + along * mm;
    let mut recognizer = Recognizer::new(Params::default(), rig, vec![rod("rod-75", 75.0)]).unwrap();
    let mut count = |length_mm: f64| {
        let mut found = Recognition::default();
        let pair = drawn(&rig, &[[at(-length_mm / 2.0), at(length_mm / 2.0)]]);
        recognizer.run(&pair, Budget::Iterations(100_000), 1, &mut found).unwrap();
        found.parts.len()
    };
    assert_eq!([75.0, 115.0, 150.0].map(&mut count), [1, 0, 2], "one, something else, two end to end");
}
