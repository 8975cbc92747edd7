//! What the pictures say for and against a part at a pose.
//!
//! ```
//! use nalgebra::{Isometry3, Vector3};
//! use pickcell::part::Part;
//! use pickcell::pose::drawn::DrawnPair;
//! use pickcell::pose::model::PoseModel;
//! use pickcell::pose::refine::{Params, Refine};
//! use pickcell::pose::verify::{Stop, Verdict, verify};
//!
//! let parts = std::path::Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/replay/parts"));
//! let rod = PoseModel::new(&Part::read(parts.join("rod-90.toml"))?);
//! let short = PoseModel::new(&Part::read(parts.join("rod-60.toml"))?);
//! let truth = Isometry3::new(Vector3::new(20.0, -10.0, 470.0), Vector3::z() * 0.9);
//! let drawn = DrawnPair::new(&[(&rod, truth)]);
//!
//! let verdict_on = |model: &PoseModel| {
//!     let mut refine = Refine::new(Params { lift_radii: 0.0, ..Params::default() }, &drawn.rig);
//!     let fit = refine.fine(model, &truth, &drawn.views()).unwrap();
//!     let stops = model.ends.iter().enumerate();
//!     let stops: Vec<Stop> = stops
//!         .map(|(k, end)| Stop { position_mm: end.position_mm, onward: end.outward, end: Some(k) })
//!         .collect();
//!     let mut verdict = Verdict::default();
//!     verify(&refine, model, &stops, &fit.left_from_part, &drawn.views(), &mut verdict);
//!     verdict
//! };
//! let verdict = verdict_on(&rod);
//! assert_eq!((verdict.ends_seen, verdict.missing, verdict.overrun_mm), (4, [0.0; 2], 0.0));
//! assert!(verdict.clear.iter().all(|share| *share > 0.9));
//! // A shorter rod fits the same wire; what speaks against it is that the wire goes on and no end is seen.
//! let verdict = verdict_on(&short);
//! assert!(verdict.ends_seen == 0 && verdict.overrun_mm > 5.0);
//! # Ok::<(), pickcell::part::PartError>(())
//! ```

use nalgebra::{Isometry3, Point3, Vector2, Vector3};

use super::model::PoseModel;
use super::refine::{EndSighting, Refine, Sighting, View};
use super::width::is_one_wire;
use crate::matching::fitness::Terms;

/// What one picture shows of one piece of the part.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Sight {
    /// Behind the camera.
    #[default]
    Outside,
    /// Both outlines where they should be.
    Clear,
    /// One outline where it should be: something touches the other side.
    OneSide,
    /// Object, but no outline of this part: something crosses here.
    Crossed,
    /// Background where wire should be.
    Missing,
}

/// A piece of the part in one picture.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PieceSight {
    /// What is seen.
    pub sight: Sight,
    /// Where the middle is expected.
    pub expected_px: Vector2<f64>,
    /// Unit vector across.
    pub across: Vector2<f64>,
    /// Expected half width.
    pub half_width_px: f64,
    /// Middle, from where it is expected, and width of what is seen, where both outlines are.
    pub seen_px: Option<(f64, f64)>,
}

/// The pictures' verdict on a pose.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Verdict {
    /// For every station of the model, what the left and the right picture show.
    pub pieces: Vec<[PieceSight; 2]>,
    /// Share of the length with both outlines seen, left and right.
    pub clear: [f64; 2],
    /// Share of background where wire should be.
    pub missing: [f64; 2],
    /// Share of the length whose middle is object in the mask.
    pub solid: [f64; 2],
    /// How far wire of the same width goes straight on where the part ends or bends, in mm; the longest.
    pub overrun_mm: f64,
    /// The pieces of that wire, stop by stop.
    pub onward: Vec<OnwardPiece>,
    /// Free ends that are seen, in both pictures together.
    pub ends_seen: u32,
    /// Free ends that are seen in at least one picture.
    pub ends_shown: u32,
    /// Free ends that both pictures show.
    pub ends_in_both: u32,
    /// Second largest distance of a seen end from the expected one, in pixels, but for shadow behind it, see
    /// [`EndSighting::off_px`]: one alone may belong to a neighbour.
    pub end_offset_px: f64,
    /// The largest such distance.
    pub end_farthest_px: f64,
    /// Sum of such distances of all seen ends, in pixels.
    pub ends_off_px: f64,
    /// Sum over hidden ends of how far the mask goes on beyond them, in pixels.
    pub hidden_px: f64,
    /// Root mean square distance of the seen middles from the expected ones, in pixels.
    pub offset_px: f64,
    /// How wide the wire is seen, in the mean of where it is seen clearly, over how wide wire of the part's thickness is seen as a
    /// rule.
    pub width_ratio: Option<f64>,
    /// Whether the wire is seen narrower than any light makes it: it is thinner than the part's, or farther away.
    pub is_narrow: bool,
}

/// Width of the lit region of a wire over that of its silhouette, in the mean along a part: no light makes it less. Of
/// polished wire, outlines are taken farther down; but it is dark at its sides.
const LIT_WIDTH_MIN: f64 = 0.62;
const POLISHED_WIDTH_MIN: f64 = 0.5;
/// The same as a rule, and of dark wire.
const LIT_WIDTH: f64 = 0.85;
const POLISHED_WIDTH: f64 = 0.67;
const DARK_WIDTH: f64 = 1.0;

impl Verdict {
    /// Nothing yet, with memory for a part of so many stations and stops.
    pub fn with_room(stations: usize, stops: usize) -> Self {
        let onward = Vec::with_capacity(stops * 2 * ONWARD_THICKNESSES.len());
        Self { pieces: Vec::with_capacity(stations), onward, ..Self::default() }
    }

    /// The terms of the fitness of the fitted part. Its length in space is the model's own; lengths in the pictures
    /// are judged by the ends, gaps by the middles of the wire.
    pub fn terms(&self, nodes_unseen: usize) -> Terms {
        Terms {
            length_3d_mm: 0.0,
            length_2d_px: self.ends_off_px / f64::from(self.ends_seen.max(1)),
            missing: (self.missing[0] + self.missing[1]) / 2.0,
            gap_px: if self.offset_px.is_finite() { self.offset_px } else { 0.0 },
            unmatched: nodes_unseen as f64,
            contradictions: 0.0,
        }
    }
}

/// A place where the part's wire stops or turns away, and the direction in which it would have gone on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stop {
    /// Place in the part's frame.
    pub position_mm: Point3<f64>,
    /// Unit direction in the part's frame.
    pub onward: Vector3<f64>,
    /// Index of the free end that it is, if it is one.
    pub end: Option<usize>,
}

/// Wire that goes on where the part stops, in one picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OnwardPiece {
    /// Index of the stop.
    pub stop: usize,
    /// Picture: 0 left, 1 right.
    pub side: usize,
    /// Where its middle is expected.
    pub expected_px: Vector2<f64>,
    /// Unit vector across.
    pub across: Vector2<f64>,
}

/// How far onward is looked, in thicknesses.
const ONWARD_THICKNESSES: [f64; 6] = [0.75, 1.5, 2.5, 3.5, 4.5, 5.5];

/// Judges the pose that `refine` has just found from what it has seen in both pictures.
pub fn verify(
    refine: &Refine,
    model: &PoseModel,
    stops: &[Stop],
    pose: &Isometry3<f64>,
    views: &[View; 2],
    verdict: &mut Verdict,
) {
    verdict.pieces.clear();
    let (mut squares, mut seen) = (0.0, 0.0);
    let (mut widths, mut clear) = (0.0, 0.0);
    let mut shares = [[0.0; 3]; 2];
    for (station, sightings) in model.stations.iter().zip(refine.sightings()) {
        let mut piece = [PieceSight::default(); 2];
        for side in 0..2 {
            let share = station.length_mm / model.length_mm;
            if let Some(sighting) = &sightings[side] {
                let (sight, offset) = sight_of(sighting);
                shares[side][2] += if sighting.object { share } else { 0.0 };
                if let Some(offset) = offset {
                    squares += offset * offset;
                    seen += 1.0;
                }
                piece[side] = PieceSight {
                    sight,
                    expected_px: sighting.expected_px,
                    across: sighting.across,
                    half_width_px: sighting.half_width_px,
                    seen_px: sighting.section.and_then(|section| section.middle_and_width()),
                };
            }
            match piece[side].sight {
                Sight::Clear => {
                    shares[side][0] += share;
                    let section = sightings[side].as_ref().and_then(|sighting| sighting.section);
                    // Off a shadow, wire is as wide as it should be, whatever it is.
                    if let Some((_, width_px)) = piece[side].seen_px
                        && section.is_some_and(|section| !section.is_off_shadow)
                    {
                        widths += width_px / (2.0 * piece[side].half_width_px);
                        clear += 1.0;
                    }
                }
                Sight::Missing | Sight::Outside => shares[side][1] += share,
                Sight::OneSide | Sight::Crossed => {}
            }
        }
        verdict.pieces.push(piece);
    }
    verdict.clear = shares.map(|s| s[0]);
    verdict.missing = shares.map(|s| s[1]);
    verdict.solid = shares.map(|s| s[2]);
    verdict.offset_px = if seen > 0.0 { f64::sqrt(squares / seen) } else { f64::INFINITY };
    let is_polished = views.iter().any(|view| view.profiler.is_polished());
    let usual = match (is_polished, views.iter().any(|view| view.profiler.dark_parts())) {
        (true, _) => POLISHED_WIDTH,
        (_, true) => DARK_WIDTH,
        _ => LIT_WIDTH,
    };
    verdict.width_ratio = (clear > 0.0).then(|| widths / (clear * usual));
    verdict.is_narrow = widths < clear * if is_polished { POLISHED_WIDTH_MIN } else { LIT_WIDTH_MIN };
    verdict.onward.clear();
    for (index, stop) in stops.iter().enumerate() {
        // Where both see the end, floor lies behind it, and what comes then is another's.
        let end = stop.end.and_then(|end| refine.ends().get(end));
        if end.is_some_and(|end| end.iter().all(|side| side.is_some_and(|e| e.beyond_px.is_some()))) {
            continue;
        }
        look_onward(refine, model, index, stop, pose, views, &mut verdict.onward);
    }
    verdict.overrun_mm = overrun_mm(model, &verdict.onward, |_| true);
    judge_ends(refine, verdict);
}

/// What a sighting is, and the distance of the middle where both outlines are seen.
pub(super) fn sight_of(sighting: &Sighting) -> (Sight, Option<f64>) {
    let half = sighting.half_width_px;
    let near = 0.35 * half + 0.4;
    let section = sighting.section.unwrap_or_default();
    let both = section.middle_and_width();
    if let Some((middle, width)) = both
        && is_one_wire(width, 2.0 * half, [0.5, 1.25])
        && middle.abs() < near
    {
        return (Sight::Clear, Some(middle));
    }
    if !sighting.object && both.is_none_or(|(m, _)| m.abs() > near + 0.5 * half) {
        return (Sight::Missing, None);
    }
    let side = |px: Option<f64>| px.is_some_and(|p| (p.abs() - 0.85 * half).abs() < near);
    (if side(section.low_px) || side(section.high_px) { Sight::OneSide } else { Sight::Crossed }, None)
}

fn judge_ends(refine: &Refine, verdict: &mut Verdict) {
    (verdict.ends_seen, verdict.end_offset_px, verdict.end_farthest_px, verdict.ends_off_px) =
        (0, 0.0, 0.0, 0.0);
    let shown = |end: &&[Option<EndSighting>; 2]| end.iter().flatten().any(|e| e.beyond_px.is_some());
    verdict.ends_shown = refine.ends().iter().filter(shown).count() as u32;
    let in_both =
        |end: &&[Option<EndSighting>; 2]| end.iter().all(|side| side.is_some_and(|e| e.beyond_px.is_some()));
    verdict.ends_in_both = refine.ends().iter().filter(in_both).count() as u32;
    verdict.hidden_px = refine.ends().iter().flatten().flatten().map(|e| e.mask_beyond_px).sum();
    for off_px in refine.ends().iter().flatten().flatten().filter_map(EndSighting::off_px) {
        verdict.ends_seen += 1;
        verdict.ends_off_px += off_px;
        verdict.end_offset_px = verdict.end_offset_px.max(off_px.min(verdict.end_farthest_px));
        verdict.end_farthest_px = verdict.end_farthest_px.max(off_px);
    }
}

/// Adds the pieces of clean wire beyond a stop.
fn look_onward(
    refine: &Refine,
    model: &PoseModel,
    index: usize,
    stop: &Stop,
    pose: &Isometry3<f64>,
    views: &[View; 2],
    pieces: &mut Vec<OnwardPiece>,
) {
    let onward = pose.rotation * stop.onward;
    let place = pose * stop.position_mm;
    for (side, view) in views.iter().enumerate() {
        for beyond in ONWARD_THICKNESSES {
            let at = place + onward * (beyond * 2.0 * model.radius_mm);
            let Some(sighting) = refine.look_beyond(model.radius_mm, &at, &onward, view) else { continue };
            let is_clean =
                sighting.section.and_then(|s| s.middle_and_width()).is_some_and(|(middle, width)| {
                    is_one_wire(width, 2.0 * sighting.half_width_px, [0.6, 1.2])
                        && middle.abs() < 0.35 * sighting.half_width_px + 0.3
                });
            if is_clean {
                let Sighting { expected_px, across, .. } = sighting;
                pieces.push(OnwardPiece { stop: index, side, expected_px, across });
            }
        }
    }
}

/// How far wire goes on beyond a stop, the mean of both pictures and the longest of all stops, in mm; `counts` says
/// of a piece whether it belongs to that wire.
pub fn overrun_mm(model: &PoseModel, onward: &[OnwardPiece], counts: impl Fn(&OnwardPiece) -> bool) -> f64 {
    let of_stop = |pieces: &[OnwardPiece]| pieces.iter().filter(|p| counts(p)).count();
    let longest = onward.chunk_by(|a, b| a.stop == b.stop).map(of_stop).max().unwrap_or(0);
    longest as f64 * model.radius_mm
}

#[cfg(test)]
#[path = "verify_tests.rs"]
mod tests;
