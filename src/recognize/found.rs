//! From an explanation that stands to what is told of the part.

use arrayvec::ArrayVec;
use nalgebra::Vector3;

use super::Params;
use super::explanations::Explanation;
use super::prepared::Prepared;
use super::result::{FoundNode, FoundPart, Seen};
use super::spread::sigmas;
use crate::grasp::{self, Grasp};
use crate::matching::select;
use crate::part::NODES_MAX;
use crate::picture::Picture;
use crate::rig::Rig;
use crate::vision::halve::in_whole;

/// The part that an explanation is.
pub(super) fn found(
    params: &Params,
    rig: &Rig,
    pictures: &[Picture; 2],
    prepared: &Prepared,
    e: &Explanation,
    iterations: u64,
) -> FoundPart {
    let pose = e.fit.left_from_part;
    let placed = prepared.placed(&pose, Vector3::zeros());
    let grasp = grasp::grasp_of(&params.grasp, &placed);
    let (sigma_mm, sigma_axis_rad) = sigmas(&params.grasp, prepared, &pose, e, &grasp);
    let nodes = prepared.nodes_seen(rig, &pose, pictures.each_ref().map(Picture::nodes)).map(
        |(left_mm, px, seen)| {
            let [left_px, right_px] = px.map(|px| in_whole(px, pictures[0].halvings()));
            FoundNode { left_mm, left_px, right_px, seen }
        },
    );
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
        proven: e.is_proven,
        clear: e.verdict.clear[0].min(e.verdict.clear[1]),
    }
}

impl FoundPart {
    /// Takes it at another place along its wire.
    pub(super) fn slide_to(
        &mut self,
        grasp: &Grasp,
        params: &grasp::Params,
        prepared: &Prepared,
        e: &Explanation,
    ) {
        self.grasp = *grasp;
        (self.sigma_mm, self.sigma_axis_rad) = sigmas(params, prepared, &self.left_from_part, e, grasp);
    }
}
