//! From an explanation that stands to what is told of the part.

use arrayvec::ArrayVec;
use nalgebra::Vector2;

use super::Params;
use super::explanations::{Explanation, SAME_END_PX};
use super::prepared::Prepared;
use super::result::{FoundNode, FoundPart, Seen};
use super::spread::{displaced_by_lamp, sigmas};
use crate::grasp;
use crate::matching::nodes::NodeRole;
use crate::matching::select;
use crate::part::NODES_MAX;
use crate::picture::Picture;
use crate::pose::refine::View;
use crate::pose::shading::Shading;
use crate::rig::Rig;
use crate::vision::halve::in_whole;

/// The part that an explanation is.
#[expect(clippy::too_many_arguments)]
pub(super) fn found(
    params: &Params,
    rig: &Rig,
    pictures: &[Picture; 2],
    prepared: &Prepared,
    e: &Explanation,
    shading: &Shading,
    views: &[View; 2],
    iterations: u64,
) -> FoundPart {
    let pose = e.fit.left_from_part;
    let placed = prepared.placed(&pose, 0.0);
    let grasp = grasp::grasp_of(&params.grasp, &placed);
    let beside = displaced_by_lamp(shading.across_per_skew, &prepared.pose_model, &e.verdict, views);
    let (sigma_mm, sigma_axis_rad) = sigmas(&params.grasp, prepared, &pose, &e.covariance, &beside);
    let sees = |side: usize, px: &Vector2<f64>| {
        pictures[side]
            .nodes()
            .iter()
            .any(|n| n.role != NodeRole::Bend && (n.position_px - px).norm() < SAME_END_PX)
    };
    let nodes = prepared.part.nodes.iter().map(|node| {
        let left_mm = pose * node.position_mm;
        let left_px = rig.project_left(&left_mm).unwrap_or_default();
        let right_px = rig.project_right(&left_mm).unwrap_or_default();
        let seen = match (sees(0, &left_px), sees(1, &right_px)) {
            (true, true) => Seen::Both,
            (true, false) => Seen::Left,
            (false, true) => Seen::Right,
            (false, false) => Seen::None,
        };
        let [left_px, right_px] = [left_px, right_px].map(|px| in_whole(px, pictures[0].halvings()));
        FoundNode { left_mm, left_px, right_px, seen }
    });
    let nodes: ArrayVec<FoundNode, NODES_MAX> = nodes.collect();
    let unseen = nodes.iter().filter(|n| n.seen == Seen::None).count();
    FoundPart {
        part: e.hypothesis.part,
        fitness: e.verdict.terms(unseen).fitness(&params.weights),
        left_from_part: pose,
        nodes,
        grasp,
        sigma_mm,
        sigma_axis_rad,
        blocked: None,
        iterations,
        sound: select::is_sound(&e.fit, &e.verdict, e.verdict.overrun_mm),
        proven: select::is_proven(&prepared.pose_model, &e.fit, &e.verdict),
        clear: e.verdict.clear[0].min(e.verdict.clear[1]),
    }
}
