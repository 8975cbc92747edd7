//! The fitness of a match (paper IV-D): how far the matched nodes are from being the part.
//!
//! Fitness is a sum of terms, each in its own unit times a weight, so that a perfect match has 0 and the number on
//! the overlay can be read: 0.1 is a millimetre of length, or two pixels, or 5 % of the wire missing.
//!
//! | term | paper | unit | default weight |
//! |---|---|---|---|
//! | length in space: mean over the spans of the difference between the nodes' distance and the model's | (7) | mm | 0.1 |
//! | length in the pictures: mean over spans and pictures of the difference between the nodes' distance in pixels and the projected length of a segment of the model's length at the triangulated middle and direction | (8) | px | 0.05 |
//! | wire missing: 1 - share of foreground pixels on the projected spans | "percentage of pixels" | 1 | 2 |
//! | gap: mean over the nodes of the distance from the epipolar line | "penalty" | px | 0.05 |
//! | nodes of the model without a match | | count | 0.1 |

use nalgebra::{Isometry3, Point3};

use super::problem::{ANCHORS_MAX, MatchModel, StereoNode};
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
}

impl Default for Weights {
    fn default() -> Self {
        Self { length_3d_per_mm: 0.1, length_2d_per_px: 0.05, missing: 2.0, gap_per_px: 0.05, unmatched: 0.1 }
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
}

impl Terms {
    /// The weighted sum.
    pub fn fitness(&self, w: &Weights) -> f64 {
        self.length_3d_mm * w.length_3d_per_mm
            + self.length_2d_px * w.length_2d_per_px
            + self.missing * w.missing
            + self.gap_px * w.gap_per_px
            + self.unmatched * w.unmatched
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
}

/// Distance in mm between two points of the wire where foreground is looked up.
const LOOK_UP_STEP_MM: f64 = 4.0;

impl Judge<'_> {
    /// The terms of a match, given the left and right pixels and the points of its stereo nodes.
    pub fn terms(&self, points: &[Option<MatchedPoint>]) -> Terms {
        let mut terms = Terms::default();
        let (mut spans, mut looked, mut found) = (0, 0, 0);
        for span in &self.model.spans {
            let (Some(a), Some(b)) = (points[span.from], points[span.to]) else { continue };
            spans += 1;
            terms.length_3d_mm += ((a.point_mm - b.point_mm).norm() - span.length_mm).abs();
            terms.length_2d_px += self.length_2d_px(&a, &b, span.length_mm);
            let (f, l) = self.foreground(&a.point_mm, &b.point_mm);
            found += f;
            looked += l;
        }
        if spans > 0 {
            terms.length_3d_mm /= spans as f64;
            terms.length_2d_px /= 2.0 * spans as f64;
            terms.missing = 1.0 - found as f64 / looked as f64;
        }
        let matched = points.iter().flatten().count();
        terms.gap_px = points.iter().flatten().map(|p| p.gap_px).sum::<f64>() / matched.max(1) as f64;
        terms.unmatched = (self.model.anchors.len() - matched) as f64;
        terms
    }

    /// Sum over both pictures of the difference of equation (8).
    fn length_2d_px(&self, a: &MatchedPoint, b: &MatchedPoint, length_mm: f64) -> f64 {
        let middle = nalgebra::center(&a.point_mm, &b.point_mm);
        let Some(along) = (b.point_mm - a.point_mm).try_normalize(1e-9) else { return 1e3 };
        let (p, q) = (middle - along * (length_mm / 2.0), middle + along * (length_mm / 2.0));
        let expected = |project: &dyn Fn(&Point3<f64>) -> Option<nalgebra::Vector2<f64>>| {
            Some((project(&q)? - project(&p)?).norm())
        };
        let left = expected(&|x| self.rig.project_left(x));
        let right = expected(&|x| self.rig.project_right(x));
        match (left, right) {
            (Some(l), Some(r)) => {
                ((b.left_px - a.left_px).norm() - l).abs() + ((b.right_px - a.right_px).norm() - r).abs()
            }
            _ => 1e3,
        }
    }

    /// Foreground pixels and pixels looked up on the straight line between two points, in both pictures.
    pub fn foreground(&self, a: &Point3<f64>, b: &Point3<f64>) -> (u32, u32) {
        let steps = ((b - a).norm() / LOOK_UP_STEP_MM).ceil().clamp(4.0, 64.0) as usize;
        let (mut found, mut looked) = (0, 0);
        for k in 0..steps {
            let at = a + (b - a) * ((k as f64 + 0.5) / steps as f64);
            for (px, mask) in
                [(self.rig.project_left(&at), self.masks[0]), (self.rig.project_right(&at), self.masks[1])]
            {
                looked += 1;
                found += px.is_some_and(|p| mask.get(p.x.round() as i32, p.y.round() as i32)) as u32;
            }
        }
        (found, looked)
    }

    /// Share of foreground on the part's whole wire at a pose, in both pictures.
    pub fn coverage(&self, left_from_part: &Isometry3<f64>) -> f64 {
        let (mut found, mut looked) = (0, 0);
        for span in &self.model.spans {
            let (f, l) = self.foreground(
                &(left_from_part * self.model.anchors[span.from].position_mm),
                &(left_from_part * self.model.anchors[span.to].position_mm),
            );
            found += f;
            looked += l;
        }
        found as f64 / looked.max(1) as f64
    }
}

/// A stereo node as fitness sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MatchedPoint {
    /// The point in the left camera's frame.
    pub point_mm: Point3<f64>,
    /// Its node in the left picture.
    pub left_px: nalgebra::Vector2<f64>,
    /// Its node in the right picture.
    pub right_px: nalgebra::Vector2<f64>,
    /// Distance from the epipolar line.
    pub gap_px: f64,
}

impl MatchedPoint {
    /// Looks a stereo node up.
    pub fn new(
        node: &StereoNode,
        left: &[super::nodes::ImageNode],
        right: &[super::nodes::ImageNode],
    ) -> Self {
        Self {
            point_mm: node.point_mm,
            left_px: left[node.left as usize].position_px,
            right_px: right[node.right as usize].position_px,
            gap_px: node.gap_px,
        }
    }
}
