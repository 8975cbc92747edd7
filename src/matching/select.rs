//! Competition: which of many explanations of the same wire stand.
//!
//! Every explanation is worth the length of wire that it shows with both outlines, less what speaks against it.
//! The most valuable one stands and claims its stretches of wire; all others lose what it claimed, until none is
//! left that still has a case.
//!
//! ```
//! use nalgebra::{Isometry3, Vector3};
//! use pickcell::matching::claims::ClaimMap;
//! use pickcell::matching::select::{Params, Worth, worth};
//! use pickcell::part::Part;
//! use pickcell::pose::drawn::DrawnPair;
//! use pickcell::pose::model::PoseModel;
//! use pickcell::pose::refine::{self, Refine};
//! use pickcell::pose::verify::{Verdict, verify};
//!
//! let model = PoseModel::new(&Part::read(concat!(env!("CARGO_MANIFEST_DIR"), "/replay/parts/rod-90.toml"))?);
//! let truth = Isometry3::new(Vector3::new(20.0, -10.0, 470.0), Vector3::z() * 0.9);
//! let drawn = DrawnPair::new(&[(&model, truth)]);
//! let views = drawn.views();
//! let mut refine = Refine::new(refine::Params { lift_radii: 0.0, ..Default::default() }, &drawn.rig);
//! let fit = refine.fine(&model, &truth, &views).unwrap();
//! let mut verdict = Verdict::default();
//! verify(&refine, &model, &[], &fit.left_from_part, &views, &mut verdict);
//!
//! // The first explanation of a wire is worth its length; one more of the same wire is worth nothing.
//! let mut claims = [ClaimMap::new(640, 480), ClaimMap::new(640, 480)];
//! assert!(worth(&Params::default(), &model, &fit, &verdict, &claims).now_mm > 80.0);
//! for (side, claims) in claims.iter_mut().enumerate() {
//!     claims.claim(verdict.pieces.iter().map(|piece| &piece[side]));
//! }
//! assert_eq!(worth(&Params::default(), &model, &fit, &verdict, &claims), Worth::NONE);
//! # Ok::<(), pickcell::part::PartError>(())
//! ```

use nalgebra::Point3;

use super::claims::ClaimMap;
use crate::pose::model::PoseModel;
use crate::pose::refine::Fit;
use crate::pose::verify::{self, Sight, Verdict};

/// When an explanation stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params {
    /// Share of the part's length that must be seen and not claimed by another, in each picture.
    pub seen_min: f64,
    /// Share of the part's length that may be background; twice as much where all ends are seen, for the shadow of another
    /// wire may lie across it.
    pub missing_max: f64,
    /// Share of the part's length, the mean of both pictures, on which both outlines must be seen: one side alone may
    /// be the rim of anything, of a wall in the shadow, too.
    pub both_sides_min: f64,
    /// Share of the part's length whose middle must be object in the mask, in each picture; less by as much as more may be
    /// background.
    pub solid_min: f64,
    /// Root mean square distance between seen and expected middles, at most, in pixels.
    pub offset_px_max: f64,
    /// Distance of a seen end from the expected one, at most, in pixels.
    pub end_offset_px_max: f64,
    /// What an end that is seen where it should be is worth, in mm of wire, for each picture.
    pub seen_end_mm: f64,
    /// Weight of the length of mask beyond hidden ends: an end under a neighbour is believed, one at the neighbour's
    /// far side rather.
    pub hidden_weight: f64,
    /// What a misfit of one more than usual costs, in mm of wire.
    pub misfit_mm: f64,
    /// Weight of wire that others have claimed: two wires seldom lie along each other, one upon the other.
    pub claimed_weight: f64,
    /// Weight of missing and overrunning wire against seen wire.
    pub against: f64,
}

/// Where more is missing nobody knows that it is one part: it is not proved, whatever may stand.
const MISSING_MAX: f64 = 0.08;

impl Default for Params {
    fn default() -> Self {
        Self {
            seen_min: 0.4,
            missing_max: MISSING_MAX,
            both_sides_min: 0.3,
            solid_min: 0.85,
            offset_px_max: 0.9,
            end_offset_px_max: 2.5,
            seen_end_mm: 2.0,
            misfit_mm: 15.0,
            hidden_weight: 1.0,
            claimed_weight: 0.5,
            against: 3.0,
        }
    }
}

/// The misfit that sound explanations have.
const MISFIT_USUAL: f64 = 0.6;
/// From this misfit on the pictures contradict the pose.
const MISFIT_MAX: f64 = 1.5;
/// The same where less than this share of both outlines is seen in a picture: what fits no better goes from one wire to another
/// that lies nearly along it.
const MISFIT_UNCLEAR_MAX: f64 = 1.2;
const CLEAR_MIN: f64 = 0.6;

/// From so many pixels on an end that is seen beside its place leaves doubt.
const END_FARTHEST_PX_MAX: f64 = 2.0;

/// Length in mm of the wire that an explanation shows and nobody has claimed, left and right; and the length on which it
/// needs wire that others have claimed, the mean of both pictures.
fn free_and_claimed_mm(model: &PoseModel, verdict: &Verdict, claims: &[ClaimMap; 2]) -> ([f64; 2], f64) {
    let (mut free, mut claimed) = ([0.0; 2], 0.0);
    for (station, piece) in model.stations.iter().zip(&verdict.pieces) {
        for side in 0..2 {
            let worth = match piece[side].sight {
                Sight::Outside => continue,
                Sight::Clear => 1.0,
                Sight::OneSide => 0.7,
                Sight::Crossed | Sight::Missing => 0.0,
            };
            if claims[side].is_claimed(&piece[side]) {
                claimed += station.length_mm / 2.0;
            } else {
                free[side] += worth * station.length_mm;
            }
        }
    }
    (free, claimed)
}

/// Whether an explanation leaves no doubt: all ends seen in both pictures where they should be, all wire there, none
/// beyond.
pub fn is_certain(fit: &Fit, verdict: &Verdict, ends: usize) -> bool {
    is_between_its_ends(fit, verdict, ends)
        && verdict.missing == [0.0; 2]
        && verdict.clear.iter().all(|c| *c > 0.75)
}

/// The same, but that some wire may be missing, or hidden.
fn is_between_its_ends(fit: &Fit, verdict: &Verdict, ends: usize) -> bool {
    verdict.ends_seen as usize == 2 * ends
        && verdict.ends_off_px <= 0.5 * verdict.ends_seen as f64
        && verdict.overrun_mm == 0.0
        && verdict.offset_px < 0.35
        && fit.misfit < 1.2
}

/// Whether nothing speaks against an explanation, though not all of it may be seen. `overrun_mm`: how far wire goes on
/// beyond it that is not known to be another's.
pub fn is_sound(fit: &Fit, verdict: &Verdict, overrun_mm: f64) -> bool {
    verdict.ends_seen >= 2 && verdict.offset_px < 0.4 && overrun_mm == 0.0 && fits(fit, verdict)
}

/// Whether an explanation is held along its wire: both pictures see an end of it where it should be, all its wire is
/// there and none beyond that is not known to be another's. The same part can then lie nowhere else on this wire: it would
/// reach beyond the seen end, or stop in the middle of wire.
pub fn is_anchored(fit: &Fit, verdict: &Verdict, overrun_mm: f64) -> bool {
    verdict.ends_in_both > 0 && verdict.offset_px < 0.6 && overrun_mm == 0.0 && fits(fit, verdict)
}

/// Whether ends that are seen are where they should be, and all wire is there. One that is seen far off may belong to a
/// neighbour; or the others do.
fn fits(fit: &Fit, verdict: &Verdict) -> bool {
    verdict.end_offset_px < 1.0
        && verdict.end_farthest_px < END_FARTHEST_PX_MAX
        && verdict.missing.iter().all(|m| *m < 0.02)
        && !is_contradicted(fit, verdict)
}

/// Whether the pictures contradict the pose.
fn is_contradicted(fit: &Fit, verdict: &Verdict) -> bool {
    let is_unclear = verdict.clear.iter().any(|clear| *clear < CLEAR_MIN);
    fit.misfit >= if is_unclear { MISFIT_UNCLEAR_MAX } else { MISFIT_MAX }
}

/// How far wire goes on beyond an explanation that nobody has claimed, in mm.
pub fn unclaimed_overrun_mm(model: &PoseModel, verdict: &Verdict, claims: &[ClaimMap; 2]) -> f64 {
    verify::overrun_mm(model, &verdict.onward, |piece| {
        !claims[piece.side].is_claimed_at(&piece.expected_px, &piece.across)
    })
}

/// Whether others have claimed the wire at an end, in either picture.
fn has_claimed_end(model: &PoseModel, verdict: &Verdict, claims: &[ClaimMap; 2]) -> bool {
    let is_at_end = |at: &Point3<f64>| {
        model.ends.iter().any(|end| (end.position_mm - at).norm() < END_RADII * model.radius_mm)
    };
    let pieces = model.stations.iter().zip(&verdict.pieces);
    pieces.filter(|(station, _)| is_at_end(&station.position_mm)).any(|(_, piece)| {
        piece.iter().zip(claims).any(|(seen, claims)| seen.sight != Sight::Outside && claims.is_claimed(seen))
    })
}

/// Within so many radii of an end wire is the end's.
const END_RADII: f64 = 2.2;

/// Where more than one end is seen this far from where it should be, they are not those of the part.
const END_OFFSET_PX_MAX: f64 = 1.5;

/// How far wire may go on beyond what is proved, in radii: beyond a bent part not all of whose ends are seen, and beyond a straight
/// one, though each end is seen in a picture. The edge of a wire across looks like an end in one.
const BENT_GOES_ON_RADII_MAX: f64 = 1.5;
const STRAIGHT_GOES_ON_RADII_MAX: f64 = 2.5;

/// Whether a part is proved to lie there: the pictures do not contradict its pose, and it cannot have slid along itself, for
/// nothing speaks against it, or each free end is seen in a picture, or it is bent. `overrun_mm`: how far wire goes on beyond
/// it that is not known to be another's; two wires that cross look like the legs of a bent part that goes on.
pub fn is_proven(model: &PoseModel, fit: &Fit, verdict: &Verdict, overrun_mm: f64) -> bool {
    let shows_ends = !model.ends.is_empty() && verdict.ends_shown as usize == model.ends.len();
    let stops_within = |radii: f64| overrun_mm <= radii * model.radius_mm;
    let is_held = match model.straight_along {
        Some(_) => {
            shows_ends && stops_within(STRAIGHT_GOES_ON_RADII_MAX)
                || is_sound(fit, verdict, verdict.overrun_mm)
        }
        None => shows_ends || stops_within(BENT_GOES_ON_RADII_MAX),
    };
    is_held
        && verdict.end_offset_px < END_OFFSET_PX_MAX
        && missing(verdict) <= MISSING_MAX
        && !is_contradicted(fit, verdict)
        && !verdict.is_narrow
}

/// Of what shows no end, from this share of its length on both outlines must be seen in either picture.
const ENDLESS_CLEAR_MIN: f64 = 0.35;

/// Whether what is not proved is likely no part: it shows no end, and both outlines on little of its length in a picture, or wire
/// narrower than light makes it. That is what shadows, rims and lines look like that are longer than the part.
pub fn is_unlikely(verdict: &Verdict) -> bool {
    verdict.ends_shown == 0 && (verdict.is_narrow || verdict.clear.iter().any(|c| *c < ENDLESS_CLEAR_MIN))
}

/// Share of the wire that is missing, the mean of both pictures.
fn missing(verdict: &Verdict) -> f64 {
    (verdict.missing[0] + verdict.missing[1]) / 2.0
}

/// What an explanation is worth, in mm of wire.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Worth {
    /// Given what is claimed.
    pub now_mm: f64,
    /// At most, whatever else may be claimed.
    pub at_most_mm: f64,
}

impl Worth {
    /// Of what does not stand.
    pub const NONE: Self = Self { now_mm: f64::NEG_INFINITY, at_most_mm: f64::NEG_INFINITY };
}

/// What an explanation is worth, given what is claimed.
pub fn worth(
    params: &Params,
    model: &PoseModel,
    fit: &Fit,
    verdict: &Verdict,
    claims: &[ClaimMap; 2],
) -> Worth {
    let missing = missing(verdict);
    // Of what leaves no doubt some may have been too dim for the mask.
    let is_certain = is_certain(fit, verdict, model.ends.len());
    let shadow = if is_between_its_ends(fit, verdict, model.ends.len()) { params.missing_max } else { 0.0 };
    let missing_max = params.missing_max + shadow;
    let is_hollow = verdict.solid[0].min(verdict.solid[1]) < params.solid_min - shadow && !is_certain;
    if missing > missing_max
        || verdict.clear[0] + verdict.clear[1] < 2.0 * params.both_sides_min
        || is_hollow
        || verdict.offset_px > params.offset_px_max
        || verdict.end_offset_px > params.end_offset_px_max
    {
        return Worth::NONE;
    }
    let (free, claimed) = free_and_claimed_mm(model, verdict, claims);
    // Two wires seldom lie along each other; but where all ends of both are seen they do.
    let lies_along = is_certain && !has_claimed_end(model, verdict, claims);
    let least = free[0].min(free[1]);
    if least < params.seen_min * model.length_mm && !lies_along {
        return Worth::NONE;
    }
    let claimed = if lies_along { 0.0 } else { claimed };
    // Wire that goes on is no riddle where it is known whose it is.
    let overrun_mm = unclaimed_overrun_mm(model, verdict, claims);
    let px_per_mm = verdict.pieces.first().map_or(1.0, |p| p[0].half_width_px / model.radius_mm).max(1e-3);
    let against = missing * model.length_mm + verdict.ends_off_px / px_per_mm;
    let ends = params.seen_end_mm * f64::from(verdict.ends_seen)
        - params.hidden_weight * verdict.hidden_px / px_per_mm;
    let misfit = params.misfit_mm * (fit.misfit - MISFIT_USUAL).max(0.0);
    let at_most_mm = (free[0] + free[1]) / 2.0 + ends
        - misfit
        - params.against * against
        - params.claimed_weight * claimed;
    Worth { now_mm: at_most_mm - params.against * overrun_mm, at_most_mm }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use nalgebra::Vector2;

    use super::super::claims::tests::piece;
    use super::*;
    use crate::part::Part;
    use crate::pose::verify::OnwardPiece;

    fn model(part: &str) -> PoseModel {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("replay/parts").join(part);
        PoseModel::new(&Part::read(file).unwrap())
    }

    /// Most of the part in sight, all at one place, with so many of its ends seen.
    fn in_sight(model: &PoseModel, ends_seen: u32) -> Verdict {
        let pieces = vec![[piece(50.0, 50.0, [0.0, 1.0]); 2]; model.stations.len()];
        Verdict { pieces, clear: [0.9; 2], solid: [1.0; 2], ends_seen, ends_shown: 2, ..Verdict::default() }
    }

    #[test]
    fn wire_that_goes_on_and_is_known_to_be_anothers_speaks_against_nobody() {
        let model = model("rod-90.toml");
        let beyond = |x: f64| OnwardPiece {
            stop: 0,
            side: 1,
            expected_px: Vector2::new(x, 50.0),
            across: Vector2::new(0.0, 1.0),
        };
        let verdict = Verdict {
            onward: vec![beyond(50.0), beyond(64.0)],
            ends_in_both: 1,
            ends_seen: 2,
            ..Verdict::default()
        };
        let fit = Fit { misfit: 0.6, ..Fit::default() };
        let mut claims = [ClaimMap::new(100, 100), ClaimMap::new(100, 100)];
        let left_mm = |claims: &[ClaimMap; 2]| {
            let overrun_mm = unclaimed_overrun_mm(&model, &verdict, claims);
            (overrun_mm / model.radius_mm, is_anchored(&fit, &verdict, overrun_mm))
        };
        assert_eq!(left_mm(&claims), (2.0, false));
        claims[1].claim(&[piece(64.0, 50.0, [0.0, 1.0])]);
        assert_eq!(left_mm(&claims), (1.0, false));
        claims[1].claim(&[piece(50.0, 50.0, [0.0, 1.0])]);
        assert_eq!(left_mm(&claims), (0.0, true));
        claims[1].clear();
        assert_eq!(left_mm(&claims), (2.0, false));
    }

    #[test]
    fn a_part_without_free_ends_is_held_by_its_shape_and_doubted_where_wire_goes_on() {
        let mut model = model("hook.toml");
        model.ends.clear();
        let verdict = Verdict { ends_shown: 0, ..in_sight(&model, 0) };
        let fit = Fit { misfit: 0.6, ..Fit::default() };
        assert!(is_certain(&fit, &verdict, 0) && !is_certain(&fit, &verdict, 1));
        let is_proven = |radii: f64| is_proven(&model, &fit, &verdict, radii * model.radius_mm);
        assert_eq!([0.0, 1.4, 1.6].map(is_proven), [true, true, false]);
    }

    #[test]
    fn one_end_that_is_seen_far_off_leaves_doubt() {
        let settled = |end_farthest_px: f64| {
            let verdict = Verdict {
                ends_in_both: 1,
                ends_seen: 3,
                end_offset_px: 0.1,
                end_farthest_px,
                ..Verdict::default()
            };
            let fit = Fit { misfit: 0.9, ..Fit::default() };
            [is_sound(&fit, &verdict, 0.0), is_anchored(&fit, &verdict, 0.0)]
        };
        assert_eq!([0.4, 4.2].map(settled), [[true; 2], [false; 2]]);
    }

    #[test]
    fn what_the_mask_does_not_have_counts_where_there_is_doubt() {
        let model = model("rod-90.toml");
        let claims = [ClaimMap::new(100, 100), ClaimMap::new(100, 100)];
        let worth_mm = |solid: f64, ends_seen: u32| {
            let verdict = Verdict { solid: [solid; 2], ..in_sight(&model, ends_seen) };
            worth(&Params::default(), &model, &Fit::default(), &verdict, &claims).now_mm
        };
        assert!(worth_mm(0.9, 4) > 80.0 && worth_mm(0.9, 3) > 80.0);
        assert!(worth_mm(0.8, 4) > 80.0);
        assert_eq!(worth_mm(0.8, 3), f64::NEG_INFINITY);
    }

    #[test]
    fn the_shadow_of_another_may_lie_across_what_shows_all_its_ends_but_proves_nothing() {
        let model = model("rod-90.toml");
        let claims = [ClaimMap::new(100, 100), ClaimMap::new(100, 100)];
        let judged = |missing: f64, ends_seen: u32| {
            let verdict = Verdict {
                clear: [0.9 - missing; 2],
                missing: [missing; 2],
                solid: [1.0 - missing; 2],
                ..in_sight(&model, ends_seen)
            };
            let worth = worth(&Params::default(), &model, &Fit::default(), &verdict, &claims);
            (worth.now_mm > 0.0, is_proven(&model, &Fit::default(), &verdict, 0.0))
        };
        assert_eq!([judged(0.07, 4), judged(0.07, 3)], [(true, true); 2]);
        assert_eq!([judged(0.12, 4), judged(0.12, 3)], [(true, false), (false, false)]);
        assert_eq!([judged(0.155, 4), judged(0.165, 4)], [(true, false), (false, false)]);
    }

    #[test]
    fn what_shows_all_its_ends_stands_where_another_lies_along_it_and_not_where_its_ends_are_anothers() {
        let model = model("rod-90.toml");
        let along = model.straight_along.unwrap();
        // A pixel a millimetre.
        let pieces: Vec<_> = model
            .stations
            .iter()
            .map(|station| {
                let x = 150.0 + along.dot(&station.position_mm.coords);
                [piece(x, 50.0, [0.0, 1.0]); 2]
            })
            .collect();
        let worth_mm = |claimed: std::ops::Range<f64>, ends_seen: u32| {
            let mut claims = [ClaimMap::new(300, 100), ClaimMap::new(300, 100)];
            let theirs = pieces.iter().filter(|piece| claimed.contains(&piece[0].expected_px.x));
            for (side, claims) in claims.iter_mut().enumerate() {
                claims.claim(theirs.clone().map(|piece| &piece[side]));
            }
            let verdict = Verdict { pieces: pieces.clone(), ..in_sight(&model, ends_seen) };
            worth(&Params::default(), &model, &Fit::default(), &verdict, &claims).now_mm
        };
        // All but 15 mm at either end is another's; the whole; and one end.
        assert!(worth_mm(120.0..180.0, 4) > 20.0);
        assert_eq!(worth_mm(120.0..180.0, 3), f64::NEG_INFINITY);
        assert_eq!([worth_mm(100.0..200.0, 4), worth_mm(120.0..200.0, 4)], [f64::NEG_INFINITY; 2]);
    }

    #[test]
    fn a_bent_part_is_proven_where_the_pictures_do_not_contradict_it_and_a_rod_by_its_ends() {
        let held = |name: &str, verdict: &Verdict, misfit: f64, overrun_mm: f64| {
            is_proven(&model(name), &Fit { misfit, ..Fit::default() }, verdict, overrun_mm)
        };
        let proven = |name: &str, misfit: f64, ends_shown: u32| {
            held(name, &Verdict { ends_shown, clear: [0.9; 2], ..Verdict::default() }, misfit, 0.0)
        };
        let narrow = Verdict { ends_shown: 2, is_narrow: true, ..Verdict::default() };
        assert!(!held("hook.toml", &narrow, 0.5, 0.0) && !held("rod-90.toml", &narrow, 0.5, 0.0));
        // Legs that go on are those of others, unless both ends are seen.
        let shown = |ends_shown| Verdict { ends_shown, ..Verdict::default() };
        assert!(!held("hook.toml", &shown(1), 0.5, 5.0) && held("hook.toml", &shown(2), 0.5, 5.0));
        assert!(proven("hook.toml", 1.2, 0) && !proven("hook.toml", 1.6, 2));
        assert!(proven("rod-90.toml", 1.2, 2) && !proven("rod-90.toml", 1.2, 1));
        assert!(!proven("rod-90.toml", 1.6, 2));
        // What fits no better and is half hidden in a picture goes from one wire there to another.
        let half_hidden = Verdict { ends_shown: 2, clear: [0.5, 0.9], ..Verdict::default() };
        assert!(held("rod-90.toml", &half_hidden, 1.1, 0.0) && !held("rod-90.toml", &half_hidden, 1.3, 0.0));
        // An end that only one picture shows may be the edge of a wire that lies across: beyond it the rod goes on.
        assert!(held("rod-90.toml", &shown(2), 0.5, 2.0) && !held("rod-90.toml", &shown(2), 0.5, 7.5));
    }

    #[test]
    fn what_shows_no_end_is_a_part_if_more_of_its_wire_is_seen() {
        let verdict =
            |ends_shown, clear, is_narrow| Verdict { ends_shown, clear, is_narrow, ..Verdict::default() };
        assert!(is_unlikely(&verdict(0, [0.9, 0.3], false)) && is_unlikely(&verdict(0, [0.9; 2], true)));
        assert!(!is_unlikely(&verdict(0, [0.9, 0.4], false)) && !is_unlikely(&verdict(1, [0.3; 2], true)));
    }
}
