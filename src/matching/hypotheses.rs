//! Rough poses of a part: from matches of its nodes, and from single nodes with the wire that leaves them.
//!
//! A match of three nodes (two of a straight part) holds a pose. Where a neighbour hides the other nodes, one node
//! and the directions of its wire do: an end with its line for a straight part, a bend or a junction with its legs
//! for any other. An end of a bent part leaves the turn about its wire open: those are taken at which the rest of its
//! wire is foreground.
//!
//! ```
//! use pickcell::matching::drawn::DrawnScene;
//! use pickcell::matching::exhaustive::{Exhaustive, Limits};
//! use pickcell::matching::found::Found;
//! use pickcell::matching::hypotheses::of_match;
//! use pickcell::time::Budget;
//!
//! let scene = DrawnScene::new(4, 1, 1); // a bent part of four nodes
//! let mut found = Found::new(16);
//! let limits = Limits { fitness_max: 0.6, budget: Budget::Iterations(10_000), steps_max: u64::MAX };
//! Exhaustive::new(scene.candidates.all().len()).run(&scene.judge(), &scene.candidates, limits, &mut found);
//! found.sort();
//!
//! let rough = of_match(0, &scene.model, &found.matches()[0], scene.gate.nodes()).unwrap();
//! for anchor in &scene.model.anchors {
//!     let [is, was] = [rough.left_from_part, scene.left_from_part[0]].map(|pose| pose * anchor.position_mm);
//!     assert!((is - was).norm() < 8.0, "nodes are seen to half a pixel, which is some millimetres of depth");
//! }
//! ```

use std::f64::consts::TAU;

use arrayvec::ArrayVec;
use nalgebra::{Isometry3, Point3, Translation3, Unit, UnitQuaternion, Vector3};

use super::fitness::{Judge, StereoMatch, UNMATCHED};
use super::lines::on_level;
use super::nodes::{ImageNode, NodeRole};
use super::placement::{motion_of_directions, rigid_motion};
use super::problem::{ANCHORS_MAX, Anchor, MatchModel, StereoNode, is_same_direction, leg_direction};
use crate::rig::Rig;

/// A rough pose of a part.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Hypothesis {
    /// Index of the part.
    pub part: usize,
    /// From the part's frame to the left camera's.
    pub left_from_part: Isometry3<f64>,
    /// Fitness of the match that it comes from.
    pub fitness: f64,
    /// The match: for every anchor a stereo node, or [`UNMATCHED`].
    pub nodes: [u16; ANCHORS_MAX],
}

/// The pose that a match of nodes holds; `None` where too few are matched.
pub fn of_match(
    part: usize,
    model: &MatchModel,
    found: &StereoMatch,
    nodes: &[StereoNode],
) -> Option<Hypothesis> {
    let mut pairs = [(Point3::origin(), Point3::origin()); ANCHORS_MAX];
    let mut count = 0;
    for (anchor, &n) in model.anchors.iter().zip(&found.nodes).filter(|(_, n)| **n != UNMATCHED) {
        pairs[count] = (anchor.position_mm, nodes[n as usize].point_mm);
        count += 1;
    }
    let left_from_part = rigid_motion(&pairs[..count])?;
    Some(Hypothesis { part, left_from_part, fitness: found.fitness, nodes: found.nodes })
}

/// What single nodes need to hold a pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SingleParams {
    /// The angle between two legs may differ from the model's by this many radians.
    pub angle_tolerance_rad: f64,
    /// The sine of the angle between the planes that hold a direction in space, at least; below it the wire is
    /// taken to lie level, at the node's depth.
    pub hold_min: f64,
    /// Share of the part's wire that must be foreground.
    pub coverage_min: f64,
}

impl Default for SingleParams {
    fn default() -> Self {
        Self { angle_tolerance_rad: 20f64.to_radians(), hold_min: 0.03, coverage_min: 0.8 }
    }
}

/// A leg of a stereo node in space, left camera's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
struct SpaceLeg {
    /// Unit direction; of wire along the baseline, which may have any slope, the level one.
    direction: Vector3<f64>,
    /// Of wire along the baseline, a point that it may lead to as well.
    towards: Option<Vector3<f64>>,
}

impl SpaceLeg {
    /// The directions that a leg along the baseline may have where it encloses an angle with this cosine with
    /// another, held one: the two that its picture leaves.
    fn at_angle(&self, other: &SpaceLeg, cos: f64) -> [Option<Vector3<f64>>; 2] {
        let Some(ray) = self.towards.filter(|_| other.towards.is_none()) else { return [None; 2] };
        let (level, d) = (self.direction, other.direction);
        // (level + t ray) · d = cos |level + t ray|, squared.
        let (a, b, c2) = (level.dot(&d), ray.dot(&d), cos * cos);
        let (p, q, r) = (
            b * b - c2 * ray.norm_squared(),
            a * b - c2 * level.dot(&ray),
            a * a - c2 * level.norm_squared(),
        );
        let root = (q * q - p * r).max(0.0).sqrt();
        [root, -root].map(|root| {
            let t = (root - q) / p;
            let along = level + ray * t;
            let is_so = t.abs() < SLOPE_TAN_MAX && (a + t * b) * cos >= 0.0;
            is_so.then(|| along.normalize())
        })
    }
}

/// No wire is steeper than about this against the picture.
const SLOPE_TAN_MAX: f64 = 1.2;

const SPACE_LEGS_MAX: usize = 8;

/// A stereo node by itself.
#[derive(Clone, Copy, Debug)]
pub struct SingleNode<'a> {
    /// Its index.
    pub index: usize,
    /// The node.
    pub node: &'a StereoNode,
    /// What the left and the right picture show of it.
    pub images: [&'a ImageNode; 2],
}

impl SingleNode<'_> {
    /// The hypothesis that it is this anchor of a part, for which this share of the wire speaks; `unknown` more things are
    /// not known than the other anchors.
    fn hypothesis(
        &self,
        (part, anchor): (usize, usize),
        judge: &Judge,
        (left_from_part, coverage): (Isometry3<f64>, f64),
        unknown: usize,
    ) -> Hypothesis {
        let mut nodes = [UNMATCHED; ANCHORS_MAX];
        nodes[anchor] = self.index as u16;
        let unmatched = (judge.model.anchors.len() - 1 + unknown) as f64;
        let fitness = judge.weights.missing * (1.0 - coverage)
            + judge.weights.unmatched * unmatched
            + judge.weights.gap_per_px * self.node.gap_px;
        Hypothesis { part, left_from_part, fitness, nodes }
    }
}

fn keep(hypothesis: Hypothesis, pool: &mut Vec<Hypothesis>) {
    if pool.len() < pool.capacity() {
        pool.push(hypothesis);
    }
}

/// Adds to `pool` the poses of part `part` that one stereo node and its legs hold, of those that `may_lie` allows. Legs whose
/// direction in space the pictures do not tell are taken to be level, at right angles to the unit vector `down` (left camera's
/// frame).
pub fn of_single_node(
    params: &SingleParams,
    part: usize,
    judge: &Judge,
    single: &SingleNode,
    down: &Vector3<f64>,
    may_lie: impl Fn(&Isometry3<f64>) -> bool,
    pool: &mut Vec<Hypothesis>,
) {
    let node = single.node;
    let legs = space_legs(params, judge.rig, node, single.images, down);
    for (a, anchor) in judge.model.anchors.iter().enumerate() {
        if anchor.is_repeated || !super::fitness::may_be(anchor.role, node.role) {
            continue;
        }
        let mut try_at = |directions: &[(Vector3<f64>, Vector3<f64>)]| {
            let pose =
                motion_of_directions(&anchor.position_mm, &node.point_mm, directions).filter(&may_lie)?;
            let coverage = judge.coverage(&pose, params.coverage_min)?;
            keep(single.hypothesis((part, a), judge, (pose, coverage), 0), pool);
            Some(())
        };
        if judge.model.straight {
            for leg in &legs {
                try_at(&[(anchor.legs[0].0, leg.direction)]);
            }
        } else {
            for_leg_pairs(params, anchor, &legs, |pairs| try_at(pairs).is_some());
        }
    }
}

/// Adds to `pool` the poses of a bent part `part` that an end, which holds it but for a turn about the wire there, and the
/// foreground hold, of those that `may_lie` allows; `down` as in [`of_single_node`].
pub fn of_single_end(
    params: &SingleParams,
    part: usize,
    judge: &Judge,
    single: &SingleNode,
    down: &Vector3<f64>,
    may_lie: impl Fn(&Isometry3<f64>) -> bool,
    pool: &mut Vec<Hypothesis>,
) {
    let node = single.node;
    if node.role != NodeRole::End || judge.model.straight {
        return;
    }
    let legs = space_legs(params, judge.rig, node, single.images, down);
    for (a, anchor) in judge.model.anchors.iter().enumerate() {
        let [(along, _)] = anchor.legs[..] else { continue };
        if anchor.is_repeated {
            continue;
        }
        for leg in &legs {
            let Some(start) =
                motion_of_directions(&anchor.position_mm, &node.point_mm, &[(along, leg.direction)])
            else {
                continue;
            };
            let turned = |turn: usize| turned_about(&node.point_mm, &leg.direction, turn) * start;
            for_turns(judge, params.coverage_min, turned, &may_lie, |pose| {
                keep(single.hypothesis((part, a), judge, pose, 1), pool);
            });
        }
    }
}

/// Adds to `pool` the poses of a bent part `part` that two ends, which hold it but for a turn about the line through both, and
/// the foreground hold, of those that `may_lie` allows. How steep the line through ends near each other is nobody sees; it is
/// taken to lie level, across `down`.
pub fn of_two_ends(
    params: &SingleParams,
    part: usize,
    judge: &Judge,
    [one, other]: [&SingleNode; 2],
    down: &Vector3<f64>,
    may_lie: impl Fn(&Isometry3<f64>) -> bool,
    pool: &mut Vec<Hypothesis>,
) {
    let is_end = |single: &SingleNode| single.node.role == NodeRole::End;
    let mut apart = other.node.point_mm - one.node.point_mm;
    if apart.norm() < STEEP_THICKNESSES_MIN * judge.model.thickness_mm {
        apart -= down * down.dot(&apart);
    }
    let apart_mm = apart.norm();
    if !(is_end(one) && is_end(other)) || apart_mm < judge.model.thickness_mm {
        return;
    }
    let middle_mm = nalgebra::center(&one.node.point_mm, &other.node.point_mm);
    let ends_mm = [middle_mm - apart / 2.0, middle_mm + apart / 2.0];
    let anchors = &judge.model.anchors;
    let ends = || anchors.iter().enumerate().filter(|(_, anchor)| anchor.role == NodeRole::End);
    // What is the same by a symmetry of the part is tried once.
    for (a, first) in ends().filter(|(_, anchor)| !anchor.is_repeated) {
        for (b, second) in ends().filter(|(b, _)| *b != a) {
            if (judge.model.distance_mm(a, b) - apart_mm).abs() > judge.length_tolerance_mm {
                continue;
            }
            let pairs = [(first.position_mm, ends_mm[0]), (second.position_mm, ends_mm[1])];
            let Some(start) = rigid_motion(&pairs) else { continue };
            let turned = |turn: usize| turned_about(&middle_mm, &apart, turn) * start;
            for_turns(judge, params.coverage_min, turned, &may_lie, |pose| {
                let mut hypothesis = one.hypothesis((part, a), judge, pose, 0);
                hypothesis.nodes[b] = other.index as u16;
                keep(hypothesis, pool);
            });
        }
    }
}

/// Ends nearer to each other than so many thicknesses do not tell how steep the line through both is.
const STEEP_THICKNESSES_MIN: f64 = 4.0;

/// Gives the poses, of all turns, that the foreground holds, each with its share of it.
fn for_turns(
    judge: &Judge,
    coverage_min: f64,
    turned: impl Fn(usize) -> Isometry3<f64>,
    may_lie: impl Fn(&Isometry3<f64>) -> bool,
    mut found: impl FnMut((Isometry3<f64>, f64)),
) {
    let coverages = std::array::from_fn(|turn| {
        let pose = Some(turned(turn)).filter(&may_lie);
        pose.and_then(|pose| judge.coverage(&pose, coverage_min)).unwrap_or(0.0)
    });
    for_runs(&coverages, |turn| found((turned(turn), coverages[turn])));
}

/// Into how many angles a part that is held but for a turn is turned.
const TURNS: usize = 24;

/// One of the [`TURNS`] about a line through a point.
fn turned_about(point: &Point3<f64>, direction: &Vector3<f64>, turn: usize) -> Isometry3<f64> {
    let angle_rad = turn as f64 * (TAU / TURNS as f64);
    let rotation = UnitQuaternion::from_axis_angle(&Unit::new_normalize(*direction), angle_rad);
    Isometry3::from_parts(Translation3::from(point - rotation * point), rotation)
}

/// Gives of every run of turns that follow each other, all round, the middle one of those with the largest share; 0 is in no
/// run.
fn for_runs(shares: &[f64; TURNS], mut found: impl FnMut(usize)) {
    let begin = shares.iter().position(|share| *share == 0.0).unwrap_or(0);
    let turns: [usize; TURNS] = std::array::from_fn(|k| (begin + k) % TURNS);
    for run in turns.chunk_by(|a, b| (shares[*a] > 0.0) == (shares[*b] > 0.0)) {
        let most = run.iter().map(|turn| shares[*turn]).fold(0.0, f64::max);
        let largest = || run.iter().filter(|turn| shares[**turn] == most);
        if most > 0.0
            && let Some(turn) = largest().nth((largest().count() - 1) / 2)
        {
            found(*turn);
        }
    }
}

/// Calls `found` with two legs of the model and two in space that enclose the same angle. Where the wire of one lies along
/// the baseline, and `found` does not like it level, with the slopes that give it the angle.
fn for_leg_pairs(
    params: &SingleParams,
    anchor: &Anchor,
    legs: &[SpaceLeg],
    mut found: impl FnMut(&[(Vector3<f64>, Vector3<f64>)]) -> bool,
) {
    for corner in &anchor.corners {
        let [a, b] = corner.map(|leg| anchor.legs[leg].0);
        let wanted = a.angle(&b);
        for (p, first) in legs.iter().enumerate() {
            for second in &legs[p + 1..] {
                let seen = first.direction.angle(&second.direction);
                if (seen - wanted).abs() < params.angle_tolerance_rad
                    && found(&[(a, first.direction), (b, second.direction)])
                {
                    continue;
                }
                let cos = wanted.cos();
                for direction in first.at_angle(second, cos).into_iter().flatten() {
                    found(&[(a, direction), (b, second.direction)]);
                }
                for direction in second.at_angle(first, cos).into_iter().flatten() {
                    found(&[(a, first.direction), (b, direction)]);
                }
            }
        }
    }
}

/// Cosine of the angle between the directions of a leg in both pictures, at least.
const ALIKE_COS_MIN: f64 = 0.86;

/// Directions in space of the legs that both pictures show.
fn space_legs(
    params: &SingleParams,
    rig: &Rig,
    node: &StereoNode,
    [left, right]: [&ImageNode; 2],
    down: &Vector3<f64>,
) -> ArrayVec<SpaceLeg, SPACE_LEGS_MAX> {
    let across = rig.right_from_left_across();
    let pairs = left.legs().iter().flat_map(|l| right.legs().iter().map(move |r| (l, r)));
    let alike = pairs.filter(|(l, r)| is_same_direction(&across, l, r, ALIKE_COS_MIN));
    let legs = alike.filter_map(|(l, r)| match leg_direction(rig, l, r) {
        Some((direction, hold)) if hold >= params.hold_min => Some(SpaceLeg { direction, towards: None }),
        _ => level_direction(node, l, down)
            .map(|direction| SpaceLeg { direction, towards: Some(l.far_ray.push(1.0)) }),
    });
    legs.take(SPACE_LEGS_MAX).collect()
}

/// The direction of a leg that lies as high as its node; the unit vector `down` in the left camera's frame.
fn level_direction(node: &StereoNode, leg: &super::nodes::Leg, down: &Vector3<f64>) -> Option<Vector3<f64>> {
    let [near, far] = [leg.near_ray, leg.far_ray].map(|ray| on_level(&ray, &node.point_mm, down));
    (far? - near?).try_normalize(1e-9)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::super::drawn::DrawnScene;
    use super::super::nodes::Leg;
    use super::*;
    use crate::part::Part;

    /// What both pictures show of an end, by itself.
    fn single_end(scene: &DrawnScene, anchor: usize) -> (StereoNode, [ImageNode; 2]) {
        let pose = scene.left_from_part[0];
        let Anchor { position_mm, legs, .. } = &scene.model.anchors[anchor];
        let points = [0.0, 0.1 * legs[0].1, legs[0].1].map(|mm| pose * (position_mm + legs[0].0 * mm));
        let project = [Rig::project_left, Rig::project_right];
        let images =
            [(&scene.rig.left, project[0]), (&scene.rig.right, project[1])].map(|(camera, project)| {
                let [end, near, far] = points.map(|point| project(&scene.rig, &point).unwrap());
                let mut image = ImageNode::bare(NodeRole::End, end, camera);
                image.push_leg(Leg {
                    direction_px: (far - end).normalize(),
                    far_ray: camera.undistort(far),
                    near_ray: camera.undistort(near),
                });
                image
            });
        let seen_px = images.map(|image| image.position_px);
        let role = NodeRole::End;
        (StereoNode { left: 0, right: 0, point_mm: points[0], seen_px, gap_px: 0.0, role }, images)
    }

    #[test]
    fn a_bent_part_is_turned_about_the_one_end_that_is_seen_until_its_wire_is_there() {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("replay/parts/hook.toml");
        let model = MatchModel::new(&Part::read(file).unwrap());
        for seed in 0..20 {
            let scene = DrawnScene::of(model.clone(), 1, seed);
            let truth = scene.left_from_part[0];
            let (node, images) = single_end(&scene, 0);
            let single = SingleNode { index: 5, node: &node, images: [&images[0], &images[1]] };
            let find = |may_lie: &dyn Fn(&Isometry3<f64>) -> bool| {
                let mut pool = Vec::with_capacity(100);
                of_single_end(
                    &SingleParams::default(),
                    0,
                    &scene.judge(),
                    &single,
                    &Vector3::z(),
                    may_lie,
                    &mut pool,
                );
                pool
            };
            // A step of turns, and what thick wire leaves open.
            let is_near = |h: &Hypothesis| h.left_from_part.rotation.angle_to(&truth.rotation) < 0.5;
            let pool = find(&|_| true);
            assert!(pool.iter().any(|h| is_near(h) && h.nodes[0] == 5), "{seed}: {pool:?}");
            // As an end of the other leg, or turned over, it may fit as well; nothing else does.
            assert!(pool.len() <= 4, "{seed}: {}", pool.len());
            assert!(find(&|_| false).is_empty());
        }
    }

    #[test]
    fn a_bent_part_is_turned_about_the_line_through_both_its_ends_until_its_wire_is_there() {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("replay/parts/hook.toml");
        let model = MatchModel::new(&Part::read(file).unwrap());
        for seed in 0..20 {
            let scene = DrawnScene::of(model.clone(), 1, seed);
            let truth = scene.left_from_part[0];
            let [(a, a_images), (b, b_images)] = [0, 1].map(|anchor| single_end(&scene, anchor));
            let first = SingleNode { index: 5, node: &a, images: [&a_images[0], &a_images[1]] };
            let second = SingleNode { index: 6, node: &b, images: [&b_images[0], &b_images[1]] };
            for two in [[&first, &second], [&second, &first]] {
                let mut pool = Vec::with_capacity(100);
                let params = SingleParams::default();
                of_two_ends(&params, 0, &scene.judge(), two, &Vector3::z(), |_| true, &mut pool);
                let off_rad = |h: &Hypothesis| h.left_from_part.rotation.angle_to(&truth.rotation);
                let nearest_rad =
                    pool.iter().filter(|h| h.nodes[..2] == [5, 6]).map(off_rad).fold(9.0, f64::min);
                // A step of turns, and what thick wire leaves open.
                assert!(nearest_rad < 0.6, "{seed}: {nearest_rad}");
                assert!(pool.len() <= 4, "{seed}: {}", pool.len());
            }
        }
    }

    #[test]
    fn of_the_turns_that_fit_the_middle_one_is_taken_all_round() {
        let mut shares = [0.0; TURNS];
        shares[7..10].fill(0.9);
        (shares[TURNS - 2], shares[TURNS - 1], shares[0]) = (0.8, 1.0, 1.0);
        let mut found = Vec::new();
        for_runs(&shares, |turn| found.push(turn));
        assert_eq!(found, [8, TURNS - 1]);
        for_runs(&[0.0; TURNS], |_| unreachable!("nothing fits"));
        found.clear();
        for_runs(&[1.0; TURNS], |turn| found.push(turn));
        assert_eq!(found.len(), 1);
    }

    #[test]
    fn the_slope_of_wire_along_the_baseline_follows_from_its_corner() {
        let held = Vector3::new(0.67, -0.71, -0.22).normalize();
        let sloping = Vector3::new(-0.9, 0.01, -0.43).normalize();
        // What the pictures show of it: the same plane through the camera.
        let ray = Vector3::new(-0.02, 0.08, 1.0);
        let level = (sloping - ray * sloping.z).normalize();
        let unknown = SpaceLeg { direction: level, towards: Some(ray) };
        let other = SpaceLeg { direction: held, towards: None };
        let found = unknown.at_angle(&other, sloping.dot(&held));
        assert!(found.iter().flatten().any(|d| (d - sloping).norm() < 1e-9), "{found:?}");
        assert_eq!(other.at_angle(&unknown, 0.5), [None; 2]);
    }
}
