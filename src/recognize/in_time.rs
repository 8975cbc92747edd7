//! What is offered though time was over before all wire was looked at.
//!
//! Such a part is certain by itself, whatever else there may be; both pictures show all its wire, so that nothing lies on
//! it; and no wire that nobody has claimed comes near it, or near where the fingers go.

use nalgebra::Vector2;

use super::explanations::Explanation;
use super::prepared::Prepared;
use super::result::FoundPart;
use crate::grasp;
use crate::matching::select::{self, ClaimMap};
use crate::picture::Picture;
use crate::pose::verify::{PieceSight, Sight};
use crate::rig::Rig;

/// In half widths of the wire: nearer to the middle of one of its pieces, which are two apart, the skeleton is its own; and
/// within which the middle of another wire would touch it, half as many again for what thinning displaces.
const OWN_HALF_WIDTHS: f64 = 1.5;
const NEAR_HALF_WIDTHS: f64 = 3.0;

/// Whether a part may be offered whatever else there is; `claims` are those of all parts that were found.
pub(super) fn stands_alone(
    params: &grasp::Params,
    rig: &Rig,
    prepared: &Prepared,
    explanation: &Explanation,
    found: &FoundPart,
    pictures: &[Picture; 2],
    claims: &[ClaimMap; 2],
) -> bool {
    let Explanation { fit, verdict, .. } = explanation;
    let model = &prepared.pose_model;
    let mut pieces = model.stations.iter().zip(&verdict.pieces);
    let is_bare = pieces.all(|(s, piece)| s.at_joint || piece.iter().all(|p| p.sight == Sight::Clear));
    if !is_bare || !select::is_certain(fit, verdict, model.ends.len()) {
        return false;
    }
    let at_mm = found.left_from_part * prepared.part.grasp.position_mm;
    let fingers_mm = grasp::fingers_reach_mm(&params.gripper, &found.grasp) + model.radius_mm;
    [rig.project_left(&at_mm), rig.project_right(&at_mm)].into_iter().enumerate().all(|(side, grasp_px)| {
        let (Some(grasp_px), Some(piece)) = (grasp_px, verdict.pieces.first()) else { return false };
        let half_px = piece[side].half_width_px;
        let fingers_px = fingers_mm * half_px / model.radius_mm;
        let is_in_the_way = |at: &Vector2<f64>| {
            let from_wire = |piece: &[PieceSight; 2]| (piece[side].expected_px - at).norm_squared();
            let half_widths =
                verdict.pieces.iter().map(from_wire).fold(f64::INFINITY, f64::min).sqrt() / half_px;
            half_widths > OWN_HALF_WIDTHS
                && (half_widths < NEAR_HALF_WIDTHS || (grasp_px - at).norm() < fingers_px)
        };
        let skeleton = pictures[side].graph().points.iter().map(|&[x, y]| Vector2::new(x.into(), y.into()));
        let unknown = skeleton.filter(|at| !claims[side].is_claimed_by_any(at) && is_in_the_way(at));
        // Claims leave single pixels out; a wire that comes near is seen over more than that.
        (unknown.count() as f64) < half_px
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::FramePair;
    use crate::grasp::Blocked;
    use crate::part::Part;
    use crate::recognize::{Params, Recognition, Recognizer};
    use crate::session::Session;
    use crate::time::Budget;

    /// Whether each part stands alone, and why it is blocked when all was looked at.
    type Standing = Vec<(bool, Option<Blocked>)>;

    /// For the parts of a recorded pair: with what all of them claim, and with nothing claimed.
    fn standing_alone(pair: usize) -> ([Standing; 2], Recognition) {
        let replay = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("replay");
        let session = Session::open(&replay.join("conveyor")).unwrap();
        let [Some(left), Some(right)] = &session.pairs[pair].pictures else { panic!("a whole pair") };
        let frames = FramePair { left: left.read().unwrap(), right: right.read().unwrap() };
        let rig = Rig::read(replay.join("conveyor/calibration.yaml")).unwrap();
        let rod = Part::read(replay.join("parts/rod-90.toml")).unwrap();
        let mut recognizer = Recognizer::new(Params::default(), rig, vec![rod]).unwrap();
        let mut out = Recognition::default();
        recognizer.run(&frames, Budget::Iterations(100_000), 1, &mut out).unwrap();
        let Recognizer { params, rig, parts, pictures, explanations, .. } = &mut recognizer;
        explanations.claim_standing();
        let nothing = [&rig.left, &rig.right].map(|c| ClaimMap::new(c.width, c.height));
        let alone = [explanations.claims(), &nothing].map(|claims| {
            let of = |e: &Explanation| {
                let is_it = |f: &&FoundPart| f.left_from_part == e.fit.left_from_part;
                let found = out.parts.iter().find(is_it).unwrap();
                let alone = stands_alone(&params.grasp, rig, &parts[0], e, found, pictures, claims);
                (alone, found.blocked)
            };
            explanations.standing().map(of).collect()
        });
        (alone, out)
    }

    #[test]
    fn what_stands_alone_is_free_when_all_is_known() {
        let mut alone = 0;
        for pair in [0, 9, 12, 15, 19] {
            let ([_, nothing_claimed], found) = standing_alone(pair);
            for (stands_alone, blocked) in nothing_claimed {
                assert!(!stands_alone || blocked.is_none(), "pair {pair}: {blocked:?} {found:?}");
                alone += usize::from(stands_alone);
            }
        }
        assert!(alone > 3, "{alone}");
    }

    #[test]
    fn wire_that_nobody_claims_is_in_the_way() {
        let ([all_claimed, nothing_claimed], _) = standing_alone(12);
        let count = |alone: &[(bool, Option<Blocked>)]| alone.iter().filter(|(alone, _)| *alone).count();
        assert!(count(&all_claimed) > count(&nothing_claimed), "{all_claimed:?} {nothing_claimed:?}");
    }

    #[test]
    fn nothing_stands_alone_in_a_heap() {
        let (alone, _) = standing_alone(0);
        assert!(alone.iter().flatten().all(|(alone, _)| !alone), "{alone:?}");
    }
}
