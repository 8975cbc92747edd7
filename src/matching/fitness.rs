//! The fitness of a match (paper IV-D): how far the matched nodes are from being the part.
//!
//! Fitness is a sum of terms, each in its own unit times a weight, so that a perfect match has 0 and the number on
//! the overlay can be read: 0.1 is a millimetre of length, or two pixels, or 5 % of the wire missing.
//!
//! | term | paper | unit | default weight |
//! |---|---|---|---|
//! | length in space: mean over the spans of the difference between the nodes' distance and the model's | (7) | mm | 0.1 |
//! | length in the pictures: mean over spans and pictures of the difference between the nodes' distance in pixels and the projected length of a segment of the model's length at the triangulated middle and direction | (8) | px | 0.05 |
//! | wire missing: 1 - share of foreground pixels on the projected spans, both pictures | "percentage of pixels" | 1 | 2 |
//! | gap: mean over the nodes of the distance from the epipolar line | "penalty" | px | 0.05 |
//! | nodes of the model without a match | | count | 0.1 |
//! | contradictions | "penalty" | count | 1 |
//!
//! Only spans with both ends matched are measured; where a node is left out at which two of them meet in line, the line that both
//! make up is one. Where there is none, the wire of the whole part is looked up, laid through the matched nodes; of a part with lines
//! also where a matched node is on no span, if more of it is missing so: a line alone would say nothing of the wire to that node.
//!
//! Contradictions are what no part can show: two image nodes that no point in space explains; one image node taken
//! twice; a node that looks like an end where the part has a bend, or the like; a distance between any two nodes that is
//! off by more than the tolerance; fewer matched nodes than hold a pose; a span of which more than half is background (a
//! neighbour on top would be foreground too). They have a weight so that a search can tell a
//! bad harmony from a worse one, but a match with any is no match, whatever the threshold.
//!
//! What is cheap comes first: no pixel is read where lengths alone put the fitness over the limit that the caller
//! gives. Spans are projected with three exact points, the rest lies on the parabola through them: for a wire of
//! 90 mm seen by the scenes' cameras within 0.1 px of the exact projection across the wire (tested). The expected
//! length in pixels is scaled from the seen one by perspective alone: the lens is taken to stretch both alike, as it does lengths
//! that differ little.

use nalgebra::{Isometry3, Point3, Vector3};

use super::candidates::Candidate;
use super::looks::{Parabola, missing_on};
use super::nodes::NodeRole;
use super::placement::rigid_motion;
use super::problem::{ANCHORS_MAX, MatchModel, Span};
use crate::level::Level;
use crate::rig::Rig;
use crate::vision::bits::BitImage;

/// Stands for a node of the model that is not matched.
pub const UNMATCHED: u16 = u16::MAX;

/// The weights of the terms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weights {
    /// Per mm of length in space.
    pub length_3d_per_mm: f64,
    /// Per pixel of length in the pictures.
    pub length_2d_per_px: f64,
    /// For all of the wire missing.
    pub missing: f64,
    /// Per pixel of distance from the epipolar line.
    pub gap_per_px: f64,
    /// Per node of the model without a match.
    pub unmatched: f64,
    /// Per contradiction.
    pub contradiction: f64,
}

impl Default for Weights {
    fn default() -> Self {
        Self {
            length_3d_per_mm: 0.1,
            length_2d_per_px: 0.05,
            missing: 2.0,
            gap_per_px: 0.05,
            unmatched: 0.1,
            contradiction: 1.0,
        }
    }
}

/// The terms of a fitness, before their weights.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Terms {
    /// Mean difference of length in space, mm.
    pub length_3d_mm: f64,
    /// Mean difference of length in the pictures, px.
    pub length_2d_px: f64,
    /// Share of the wire that is not foreground.
    pub missing: f64,
    /// Mean distance from the epipolar line, px.
    pub gap_px: f64,
    /// Nodes of the model without a match.
    pub unmatched: f64,
    /// What no part can show.
    pub contradictions: f64,
}

impl Terms {
    /// The weighted sum.
    pub fn fitness(&self, w: &Weights) -> f64 {
        self.length_3d_mm * w.length_3d_per_mm
            + self.length_2d_px * w.length_2d_per_px
            + self.missing * w.missing
            + self.gap_px * w.gap_per_px
            + self.unmatched * w.unmatched
            + self.contradictions * w.contradiction
    }

    /// Whether it is a match at all.
    pub fn is_match(&self) -> bool {
        self.contradictions == 0.0
    }
}

/// Nodes of the model and the stereo nodes that are taken for them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StereoMatch {
    /// For every anchor of the model an index of a stereo node, or [`UNMATCHED`].
    pub nodes: [u16; ANCHORS_MAX],
    /// Weighted sum of the terms.
    pub fitness: f64,
}

/// Everything a match is judged by.
#[derive(Clone, Copy)]
pub struct Judge<'a> {
    /// The rig.
    pub rig: &'a Rig,
    /// Binary pictures, left and right.
    pub masks: [&'a BitImage; 2],
    /// The part.
    pub model: &'a MatchModel,
    /// The weights.
    pub weights: Weights,
    /// Two nodes' distance may differ from the model's by this many mm.
    pub length_tolerance_mm: f64,
    /// Which instructions read the pictures; the result does not depend on it.
    pub level: Level,
}

/// A candidate for each anchor of the model; `None` where it is not matched.
pub type Chosen<'c> = [Option<&'c Candidate>];

/// Cost of a length that cannot be compared, in its unit.
const NO_LENGTH: f32 = 1e3;

impl Judge<'_> {
    /// The terms of a match; `None` where its fitness is `limit` or more.
    ///
    /// # Panics
    /// Where there are fewer entries than anchors.
    pub fn terms(&self, chosen: &Chosen, limit: f64) -> Option<Terms> {
        let below = |terms: &Terms| terms.fitness(&self.weights) < limit;
        let mut terms = self.plain_terms(chosen, limit)?;
        if !below(&terms) {
            return None;
        }
        let (mut spans, mut joined) = (0.0, 0u32);
        for (span, a, b) in self.spans(chosen) {
            terms.length_3d_mm += self.length_3d_mm(span, a, b) as f64;
            spans += 1.0;
            joined |= 1 << span.from | 1 << span.to;
        }
        if spans == 0.0 {
            terms.missing = 1.0;
            if terms.is_match() {
                terms.missing = 0.0;
                terms.missing = self.missing_where_laid(chosen, &terms, limit)?;
            }
            return Some(terms).filter(below);
        }
        terms.length_3d_mm /= spans;
        if !below(&terms) {
            return None;
        }
        let sum: f32 = self.spans(chosen).map(|(span, a, b)| self.length_2d_px(span, a, b)).sum();
        terms.length_2d_px = sum as f64 / (2.0 * spans);
        if !below(&terms) {
            return None;
        }
        let looks: u32 = self.spans(chosen).map(|(span, ..)| 2 * span.looks).sum();
        // With one more than these the fitness is over the limit.
        let left = (limit - terms.fitness(&self.weights)) * f64::from(looks) / self.weights.missing;
        let mut missing = 0;
        for (span, a, b) in self.spans(chosen) {
            let of_span = self.missing(span, a, b, (left as u32).saturating_sub(missing));
            terms.contradictions += is_bare(span, of_span) as u32 as f64;
            missing += of_span;
            if f64::from(missing) > left {
                return None;
            }
        }
        if terms.is_match() && self.model.has_lines() && matched(chosen) & !joined != 0 {
            terms.missing = self.missing_where_laid(chosen, &terms, limit)?;
        }
        terms.missing = terms.missing.max(f64::from(missing) / f64::from(looks));
        Some(terms).filter(below)
    }

    /// The terms that need no span: gap, unmatched and contradictions; `None` where these alone are `limit` or more.
    fn plain_terms(&self, chosen: &Chosen, limit: f64) -> Option<Terms> {
        let anchors = &self.model.anchors;
        let (mut matched, mut gap_px, mut contradictions) = (0usize, 0f32, 0usize);
        for (i, anchor) in anchors.iter().enumerate() {
            let Some(a) = chosen[i] else { continue };
            matched += 1;
            gap_px += a.gap_px;
            contradictions += (!a.explained || !may_be(anchor.role, a.role)) as usize;
            for (j, b) in chosen[..i].iter().enumerate() {
                let Some(b) = b else { continue };
                let twice = a.left == b.left || a.right == b.right;
                let off = (distance_mm(a, b) - self.model.distance_mm(i, j) as f32).abs();
                contradictions += (twice || off > self.length_tolerance_mm as f32) as usize;
            }
            // a harmony of many nodes mostly has more than enough after a few
            if contradictions as f64 * self.weights.contradiction >= limit {
                return None;
            }
        }
        contradictions += self.model.required().saturating_sub(matched);
        Some(Terms {
            gap_px: gap_px as f64 / matched.max(1) as f64,
            unmatched: (anchors.len() - matched) as f64,
            contradictions: contradictions as f64,
            ..Terms::default()
        })
    }

    /// The spans with both ends matched by nodes that have a place in space.
    fn spans<'c>(&self, chosen: &'c Chosen) -> impl Iterator<Item = (&Span, &'c Candidate, &'c Candidate)> {
        let matched = matched(chosen);
        self.model.spans.iter().filter(move |span| span.through & matched == 0).filter_map(|span| {
            let (a, b) = (chosen[span.from]?, chosen[span.to]?);
            (a.explained && b.explained).then_some((span, a, b))
        })
    }

    /// Difference of equation (7) for one span.
    #[inline]
    pub(super) fn length_3d_mm(&self, span: &Span, a: &Candidate, b: &Candidate) -> f32 {
        (distance_mm(a, b) - span.length_mm as f32).abs()
    }

    /// Sum over both pictures of the difference of equation (8) for one span.
    pub(super) fn length_2d_px(&self, span: &Span, a: &Candidate, b: &Candidate) -> f32 {
        let seen_mm = distance_mm(a, b);
        if seen_mm < 1e-3 {
            return 2.0 * NO_LENGTH;
        }
        let depths = [(a.point_mm[2], b.point_mm[2]), (a.right_z_mm, b.right_z_mm)];
        let mut sum = 0.0;
        for (side, (za, zb)) in depths.into_iter().enumerate() {
            // A segment about a middle at depth m, its ends at m - h and m + h, looks as long as its length over
            // m² - h²; the one of the model's length has its ends at m ± h · model / seen.
            let share = span.length_mm as f32 / seen_mm;
            let (middle, half) = ((za + zb) / 2.0, (zb - za) / 2.0);
            let beyond = middle * middle - (half * share) * (half * share);
            if beyond <= 0.0 {
                sum += NO_LENGTH;
                continue;
            }
            let scale = share * (middle * middle - half * half) / beyond;
            let expected = apart_px(a.seen_px[side], b.seen_px[side]) * scale;
            sum += (apart_px(a.node_px[side], b.node_px[side]) - expected).abs();
        }
        sum
    }

    /// How many of the `2 * span.looks` pixels on the straight line between two nodes are background; once they
    /// are more than `enough`, how many more does not matter.
    pub(super) fn missing(&self, span: &Span, a: &Candidate, b: &Candidate, enough: u32) -> u32 {
        let middle = Point3::from([0, 1, 2].map(|k| (a.point_mm[k] + b.point_mm[k]) as f64 / 2.0));
        let mut missing = 0;
        for side in 0..2 {
            if missing > enough {
                break;
            }
            missing += match self.project(side, &middle) {
                Some(middle) => {
                    let curve = Parabola::new(a.seen_px[side], middle, b.seen_px[side]);
                    missing_on(self.level, self.masks[side], &curve, span.looks, enough - missing)
                }
                _ => span.looks,
            };
        }
        missing
    }

    /// Where the left (0) or the right camera (1) sees a point.
    #[inline]
    fn project(&self, side: usize, point: &Point3<f64>) -> Option<[f32; 2]> {
        let px = if side == 0 { self.rig.project_left(point) } else { self.rig.project_right(point) };
        px.map(|px| [px.x as f32, px.y as f32])
    }

    /// Share of background on the wire of the part that is laid through the matched nodes, of which the other terms are known;
    /// `None` where it takes their fitness to `limit` or more.
    pub(super) fn missing_where_laid(&self, chosen: &Chosen, others: &Terms, limit: f64) -> Option<f64> {
        let most = (limit - others.fitness(&self.weights)) / self.weights.missing;
        if most <= 0.0 {
            return None;
        }
        let mut pairs = [(Point3::origin(), Point3::origin()); ANCHORS_MAX];
        let mut count = 0;
        for (anchor, candidate) in self.model.anchors.iter().zip(chosen) {
            if let Some(c) = candidate {
                pairs[count] = (anchor.position_mm, Point3::from(c.point_mm.map(f64::from)));
                count += 1;
            }
        }
        let Some(pose) = rigid_motion(&pairs[..count]) else { return Some(1.0) };
        Some(1.0 - self.coverage(&pose, 1.0 - most)?)
    }

    /// Share of foreground on the part's whole wire at a pose, in both pictures; `None` where it is less than `least`.
    pub fn coverage(&self, left_from_part: &Isometry3<f64>, least: f64) -> Option<f64> {
        let all = self.model.wire.iter().map(|piece| 2 * piece.looks).sum::<u32>().max(1);
        // With one more than these it is less.
        let most = ((1.0 - least) * f64::from(all) * ROUNDING).max(0.0) as u32;
        let mut missing = 0;
        for piece in &self.model.wire {
            let along = piece.along_mm.map(|place| left_from_part * place);
            for side in 0..2 {
                missing += match along.map(|point| self.project(side, &point)) {
                    [Some(a), Some(m), Some(b)] => {
                        let curve = Parabola::new(a, m, b);
                        missing_on(self.level, self.masks[side], &curve, piece.looks, most - missing)
                    }
                    _ => piece.looks,
                };
                if missing > most {
                    return None;
                }
            }
        }
        Some(f64::from(all - missing) / f64::from(all)).filter(|share| *share >= least)
    }
}

/// The anchors that are matched, one bit each.
fn matched(chosen: &Chosen) -> u32 {
    chosen.iter().enumerate().fold(0, |bits, (a, c)| bits | u32::from(c.is_some()) << a)
}

/// The rounding of a bound must not cost a match.
pub(super) const ROUNDING: f64 = 1.0 + 1e-6;

/// Whether a stereo node can be an anchor of the model: an end may be hidden where wires meet, and so may a bend.
#[inline]
pub fn may_be(anchor: NodeRole, node: NodeRole) -> bool {
    anchor == node || node == NodeRole::Junction
}

/// Whether so many background pixels are too many for a span with wire.
#[inline]
pub(super) fn is_bare(span: &Span, missing: u32) -> bool {
    missing > span.looks
}

#[inline]
pub(super) fn distance_mm(a: &Candidate, b: &Candidate) -> f32 {
    let d = Vector3::from(a.point_mm) - Vector3::from(b.point_mm);
    (d.x * d.x + d.y * d.y + d.z * d.z).sqrt()
}

#[inline]
fn apart_px(a: [f32; 2], b: [f32; 2]) -> f32 {
    let (x, y) = (a[0] - b[0], a[1] - b[1]);
    (x * x + y * y).sqrt()
}

#[cfg(test)]
#[path = "fitness_tests.rs"]
mod tests;
