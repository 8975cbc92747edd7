//! Rough poses of a part: from matches of its nodes, and from single nodes with the wire that leaves them.
//!
//! A match of three nodes (two of a straight part) holds a pose. Where a neighbour hides the other nodes, one node
//! and the directions of its wire do: an end with its line for a straight part, a bend or a junction with its legs
//! for any other.

use nalgebra::{Isometry3, Point3, Vector3};

use super::fitness::{Judge, StereoMatch, UNMATCHED};
use super::nodes::ImageNode;
use super::placement::{motion_of_directions, rigid_motion};
use super::problem::{ANCHORS_MAX, Anchor, MatchModel, StereoNode, leg_direction};
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

/// Adds to `pool` the poses of part `part` that one stereo node and its legs hold.
#[allow(clippy::too_many_arguments)]
pub fn of_single_node(
    params: &SingleParams,
    part: usize,
    judge: &Judge,
    rig: &Rig,
    index: usize,
    node: &StereoNode,
    left: &[ImageNode],
    right: &[ImageNode],
    pool: &mut Vec<Hypothesis>,
) {
    let mut legs = [SpaceLeg { direction: Vector3::zeros(), towards: None }; SPACE_LEGS_MAX];
    let count =
        space_legs(params, rig, node, &left[node.left as usize], &right[node.right as usize], &mut legs);
    let legs = &legs[..count];
    for (a, anchor) in judge.model.anchors.iter().enumerate() {
        if anchor.is_repeated || !super::fitness::may_be(anchor.role, node.role) {
            continue;
        }
        let mut keep = |pose: Option<Isometry3<f64>>| {
            let Some(left_from_part) = pose else { return false };
            let Some(coverage) = judge.coverage(&left_from_part, params.coverage_min) else { return false };
            if pool.len() == pool.capacity() {
                return false;
            }
            let mut nodes = [UNMATCHED; ANCHORS_MAX];
            nodes[a] = index as u16;
            let unmatched = (judge.model.anchors.len() - 1) as f64;
            let fitness = judge.weights.missing * (1.0 - coverage)
                + judge.weights.unmatched * unmatched
                + judge.weights.gap_per_px * node.gap_px;
            pool.push(Hypothesis { part, left_from_part, fitness, nodes });
            true
        };
        if judge.model.straight {
            for leg in legs {
                keep(motion_of_directions(
                    &anchor.position_mm,
                    &node.point_mm,
                    &[(anchor.legs[0].0, leg.direction)],
                ));
            }
        } else {
            for_leg_pairs(params, anchor, legs, |pairs| {
                keep(motion_of_directions(&anchor.position_mm, &node.point_mm, pairs))
            });
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

/// Directions in space of the legs that both pictures show.
fn space_legs(
    params: &SingleParams,
    rig: &Rig,
    node: &StereoNode,
    left: &ImageNode,
    right: &ImageNode,
    legs: &mut [SpaceLeg; SPACE_LEGS_MAX],
) -> usize {
    let mut count = 0;
    for l in left.legs() {
        for r in right.legs() {
            if count == SPACE_LEGS_MAX {
                return count;
            }
            if l.direction_px.dot(&r.direction_px) < 0.86 {
                continue;
            }
            let held = leg_direction(rig, l, r).filter(|(_, hold)| *hold >= params.hold_min).map(|(d, _)| d);
            let leg = match held {
                Some(direction) => Some(SpaceLeg { direction, towards: None }),
                None => level_direction(node, l)
                    .map(|direction| SpaceLeg { direction, towards: Some(l.far_ray.push(1.0)) }),
            };
            if let Some(leg) = leg {
                legs[count] = leg;
                count += 1;
            }
        }
    }
    count
}

/// The direction of a leg that lies at the depth of its node.
fn level_direction(node: &StereoNode, leg: &super::nodes::Leg) -> Option<Vector3<f64>> {
    (leg.far_ray - leg.near_ray).push(0.0).scale(node.point_mm.z).try_normalize(1e-9)
}

#[cfg(test)]
mod tests {
    use super::*;

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
