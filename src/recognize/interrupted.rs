//! Wire that is interrupted: two parts end to end look like one of their length together, and something narrow and dark may
//! lie across. Narrower than the pictures resolve, neither parts the mask; both make a notch in the light along the wire, at the
//! same place in both pictures.

use super::explanations::Explanation;
use crate::pose::model::{PoseModel, Station};
use crate::pose::refine::View;
use crate::pose::verify::{PieceSight, Sight};

/// A notch is as deep as this share of what the part's light stands out in that picture: some two thirds of the way to the
/// background. Grain makes a quarter of that; stains may make nearly as much.
const NOTCH_SHARE: f64 = 1.0;
/// Where across the wire there is a notch, in half widths from its middle: a scratch does not go through.
const ACROSS: [f64; 3] = [0.0, -0.35, 0.35];
/// How far a notch may lie beyond the stations that it lies between, in pixels.
const BEYOND_PX: f64 = 1.0;
/// Cosine of the angle up to which wire is straight over one or two thicknesses and a station more on either side, and the least share of its length that a picture
/// shows.
const STRAIGHT_COS: f64 = 0.9995;
const LENGTH_SHARE_MIN: f64 = 0.7;

/// Whether the wire of this explanation is interrupted where it is straight and both pictures show it clearly.
pub(super) fn is_interrupted(model: &PoseModel, explanation: &Explanation, views: &[View; 2]) -> bool {
    let pieces = &explanation.verdict.pieces;
    let [Some(left), Some(right)] = explanation.light.above_in else { return false };
    let is_between = |stations: &[Station], pieces: &[[PieceSight; 2]], [a, b]: [usize; 2]| {
        let length_radii = (stations[b].position_mm - stations[a].position_mm).norm() / model.radius_mm;
        is_straight(stations)
            && [0, 1].into_iter().all(|side: usize| {
                let between = [&pieces[a][side], &pieces[b][side]];
                let least_px = LENGTH_SHARE_MIN * length_radii * between[0].half_width_px;
                has_notch(between, least_px, NOTCH_SHARE * [left, right][side], &views[side])
            })
    };
    // A thickness of wire, with a station on either side; and two, where what is in their middle is not seen clearly.
    let has_between = |thicknesses: usize, is_asked: fn(&[PieceSight; 2]) -> bool| {
        let length = thicknesses * model.per_thickness;
        let (count, ends) = (length + 3, [1, length + 1]);
        let mut stretches = model.stations.windows(count).zip(pieces.windows(count));
        stretches.any(|(stations, pieces)| is_asked(&pieces[count / 2]) && is_between(stations, pieces, ends))
    };
    has_between(1, |_| true) || has_between(2, |middle| middle.iter().all(|seen| seen.sight != Sight::Clear))
}

/// Whether stations lie in a row on straight wire.
fn is_straight(stations: &[Station]) -> bool {
    let [first, .., last] = stations else { return false };
    stations.iter().all(|s| s.stretch == first.stretch && !s.at_joint)
        && first.tangent.dot(&last.tangent) > STRAIGHT_COS
}

/// Whether the light falls by more than so many grey levels between two pieces of wire, or just beside them, all across the
/// wire; not where they are not seen clearly and at least so many pixels apart.
fn has_notch([a, b]: [&PieceSight; 2], least_px: f64, deep: f64, view: &View) -> bool {
    let middle = |piece: &PieceSight| {
        let (beside_px, _) = piece.seen_px.filter(|_| piece.sight == Sight::Clear)?;
        Some(piece.expected_px + piece.across * beside_px)
    };
    let Some((from, to)) = middle(a).zip(middle(b)) else { return false };
    let Some(along) = (to - from).try_normalize(least_px) else { return false };
    let (place, near_px) = ((from + to) / 2.0, (to - from).norm() / 2.0 + BEYOND_PX);
    ACROSS.iter().all(|across| {
        let at = place + a.across * (across * a.half_width_px);
        view.profiler.dip(at, along, near_px).is_some_and(|dip| dip > deep)
    })
}
