//! What the pictures say for and against a part at a pose.

use nalgebra::{Isometry3, Point3, Vector2, Vector3};

use super::model::{PoseModel, Station};
use super::refine::{Refine, View};

/// What one picture shows of one piece of the part.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Sight {
    /// Outside the picture.
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
}

/// The pictures' verdict on a pose.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Verdict {
    /// For every station of the model, what the left and the right picture show.
    pub pieces: Vec<[PieceSight; 2]>,
    /// Share of the length with both outlines seen, left and right.
    pub clear: [f64; 2],
    /// Share with at least one outline seen.
    pub outlined: [f64; 2],
    /// Share of background where wire should be.
    pub missing: [f64; 2],
    /// How far wire of the same width goes straight on where the part ends or bends, in mm; the longest.
    pub overrun_mm: f64,
    /// Free ends that are seen, in both pictures together.
    pub ends_seen: u32,
    /// Second largest distance of a seen end from the expected one, in pixels: one alone may belong to a neighbour.
    pub end_offset_px: f64,
    /// Sum of the distances of all seen ends from the expected ones, in pixels.
    pub ends_off_px: f64,
    /// Root mean square distance of the seen middles from the expected ones, in pixels.
    pub offset_px: f64,
    /// Width of the outlines over the silhouette's, median.
    pub width_ratio: f64,
}

/// A place where the part's wire stops or turns away, and the direction in which it would have gone on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stop {
    /// Place in the part's frame.
    pub position_mm: Point3<f64>,
    /// Unit direction in the part's frame.
    pub onward: Vector3<f64>,
}

/// How far from its expected place an end is looked for, in pixels.
const END_SEARCH_PX: f64 = 6.0;

/// How far onward is looked, in thicknesses.
const ONWARD_THICKNESSES: [f64; 5] = [1.5, 2.5, 3.5, 4.5, 5.5];

/// Judges `pose` from both pictures. `widths` is scratch memory.
pub fn verify(
    refine: &Refine,
    model: &PoseModel,
    stops: &[Stop],
    pose: &Isometry3<f64>,
    views: &[View; 2],
    widths: &mut Vec<f64>,
    verdict: &mut Verdict,
) {
    verdict.pieces.clear();
    widths.clear();
    let (mut squares, mut seen) = (0.0, 0.0);
    for station in &model.stations {
        let mut piece = [PieceSight::default(); 2];
        for (piece, view) in piece.iter_mut().zip(views) {
            let Some(sighting) = refine.sight(model, station, pose, view, 1.0) else { continue };
            *piece = PieceSight {
                sight: Sight::Crossed,
                expected_px: sighting.expected_px,
                across: sighting.across,
                half_width_px: sighting.half_width_px,
            };
            let half = sighting.half_width_px;
            let near = 0.35 * half + 0.4;
            let section = sighting.section.unwrap_or_default();
            piece.sight = match section.middle_and_width() {
                Some((middle, width))
                    if (0.5..1.25).contains(&(width / (2.0 * half))) && middle.abs() < near =>
                {
                    widths.push(width / (2.0 * half));
                    squares += middle * middle;
                    seen += 1.0;
                    Sight::Clear
                }
                _ if !sighting.object
                    && section.middle_and_width().is_none_or(|(m, _)| m.abs() > near + 0.5 * half) =>
                {
                    Sight::Missing
                }
                _ => {
                    let side = |px: Option<f64>| px.is_some_and(|p| (p.abs() - 0.85 * half).abs() < near);
                    if side(section.low_px) || side(section.high_px) {
                        Sight::OneSide
                    } else {
                        Sight::Crossed
                    }
                }
            };
        }
        verdict.pieces.push(piece);
    }
    for side in 0..2 {
        let share = |wanted: fn(Sight) -> bool| {
            model
                .stations
                .iter()
                .zip(&verdict.pieces)
                .map(|(s, p)| if wanted(p[side].sight) { s.length_mm } else { 0.0 })
                .sum::<f64>()
                / model.length_mm
        };
        verdict.clear[side] = share(|s| s == Sight::Clear);
        verdict.outlined[side] = share(|s| matches!(s, Sight::Clear | Sight::OneSide));
        verdict.missing[side] = share(|s| matches!(s, Sight::Missing | Sight::Outside));
    }
    verdict.offset_px = if seen > 0.0 { (squares / seen).sqrt() } else { f64::INFINITY };
    verdict.width_ratio = median(widths);
    (verdict.ends_seen, verdict.end_offset_px) = (0, 0.0);
    verdict.ends_off_px = 0.0;
    let mut largest: f64 = 0.0;
    for end in &model.ends {
        for view in views {
            if let Some(beyond) = refine.sight_end(model, end, pose, view, END_SEARCH_PX) {
                verdict.ends_seen += 1;
                verdict.end_offset_px = verdict.end_offset_px.max(beyond.abs().min(largest));
                verdict.ends_off_px += beyond.abs();
                largest = largest.max(beyond.abs());
            }
        }
    }
    verdict.overrun_mm =
        stops.iter().map(|stop| overrun_mm(refine, model, stop, pose, views)).fold(0.0, f64::max);
}

fn median(values: &mut [f64]) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// How far clean wire goes on beyond a stop, in both pictures.
fn overrun_mm(
    refine: &Refine,
    model: &PoseModel,
    stop: &Stop,
    pose: &Isometry3<f64>,
    views: &[View; 2],
) -> f64 {
    let mut reached: [f64; 2] = [0.0; 2];
    for (reached, view) in reached.iter_mut().zip(views) {
        for beyond in ONWARD_THICKNESSES {
            let station = Station {
                position_mm: stop.position_mm + stop.onward * (beyond * 2.0 * model.radius_mm),
                tangent: stop.onward,
                edge: 0,
                length_mm: 0.0,
                at_joint: false,
            };
            let clean = refine
                .sight(model, &station, pose, view, 1.0)
                .and_then(|s| Some((s, s.section?)))
                .is_some_and(|(s, section)| {
                    section.middle_and_width().is_some_and(|(middle, width)| {
                        (0.6..1.2).contains(&(width / (2.0 * s.half_width_px)))
                            && middle.abs() < 0.35 * s.half_width_px + 0.3
                    })
                });
            if clean {
                *reached += 2.0 * model.radius_mm;
            }
        }
    }
    reached[0].min(reached[1])
}
