//! The wire's axis with its bends.

use nalgebra::{Point3, Unit, Vector3};

use super::Part;

/// A point of a wire's axis, in the part's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CentrelinePoint {
    /// Where it is.
    pub position_mm: Point3<f64>,
    /// The direction of the wire there, from the edge's `from` to its `to`.
    pub tangent: Unit<Vector3<f64>>,
}

/// A stretch of an edge.
#[derive(Clone, Copy, Debug)]
enum Stretch {
    Line {
        begin: Point3<f64>,
        direction: Vector3<f64>,
        length: f64,
    },
    /// `begin` on the circle, `direction` of travel there, `inward` towards the centre.
    Arc {
        begin: Point3<f64>,
        direction: Vector3<f64>,
        inward: Vector3<f64>,
        radius: f64,
        length: f64,
    },
}

impl Stretch {
    fn length(&self) -> f64 {
        match *self {
            Stretch::Line { length, .. } | Stretch::Arc { length, .. } => length,
        }
    }

    /// The point `s` mm behind its beginning.
    fn at(&self, s: f64) -> CentrelinePoint {
        match *self {
            Stretch::Line { begin, direction, .. } => CentrelinePoint {
                position_mm: begin + direction * s,
                tangent: Unit::new_unchecked(direction),
            },
            Stretch::Arc { begin, direction, inward, radius, .. } => {
                let (sine, cosine) = (s / radius).sin_cos();
                CentrelinePoint {
                    position_mm: begin + direction * (radius * sine) + inward * (radius * (1.0 - cosine)),
                    tangent: Unit::new_normalize(direction * cosine + inward * sine),
                }
            }
        }
    }
}

impl Part {
    /// The axis of an edge from its `from` to its `to`, both ends included, in equal steps of `step_mm` or a little
    /// less (in 100 000 steps where they would be more). Corners are arcs of the bend radius that touch both legs;
    /// where a leg is too short for its arcs (an inner leg gives half of its length to each) the radius shrinks
    /// until they fit.
    ///
    /// # Panics
    /// Where there is no such edge, or `step_mm` is not above 0.
    pub fn centreline(&self, edge: usize, step_mm: f64) -> Vec<CentrelinePoint> {
        assert!(step_mm > 0.0, "a step of {step_mm} mm along an edge");
        let stretches = self.stretches(edge);
        let length: f64 = stretches.iter().map(Stretch::length).sum();
        let steps = (length / step_mm).ceil().clamp(1.0, 1e5) as usize;
        let mut points = Vec::with_capacity(steps + 1);
        let (mut current, mut passed) = (0, 0.0);
        for i in 0..=steps {
            let s = length * i as f64 / steps as f64;
            while current + 1 < stretches.len() && s > passed + stretches[current].length() {
                passed += stretches[current].length();
                current += 1;
            }
            points.push(stretches[current].at((s - passed).min(stretches[current].length())));
        }
        points
    }

    /// Length of an edge's axis in mm, bends included.
    ///
    /// # Panics
    /// Where there is no such edge.
    pub fn edge_length_mm(&self, edge: usize) -> f64 {
        self.stretches(edge).iter().map(Stretch::length).sum()
    }

    fn stretches(&self, edge: usize) -> Vec<Stretch> {
        let edge = &self.edges[edge];
        let mut corners = Vec::with_capacity(edge.via.len() + 2);
        corners.push(self.nodes[edge.from].position_mm);
        corners.extend_from_slice(&edge.via);
        corners.push(self.nodes[edge.to].position_mm);
        stretches(&corners, self.bend_radius_mm)
    }
}

/// A line with sharp corners to lines and arcs. Corners that follow each other are apart.
fn stretches(corners: &[Point3<f64>], radius: f64) -> Vec<Stretch> {
    let legs: Vec<Vector3<f64>> = corners.windows(2).map(|c| c[1] - c[0]).collect();
    let mut all = Vec::with_capacity(2 * legs.len());
    let mut begin = corners[0];
    for (i, leg) in legs.iter().enumerate() {
        let direction = leg.normalize();
        let bend = legs.get(i + 1).and_then(|next| {
            bend(corners[i + 1], direction, next.normalize(), radius, rounded_off_mm(&legs, i))
        });
        let cut = bend.as_ref().map_or(0.0, |b| b.cut);
        let end = corners[i + 1] - direction * cut;
        let length = (end - begin).dot(&direction);
        if length > 1e-9 {
            all.push(Stretch::Line { begin, direction, length });
        }
        begin = end;
        if let Some(b) = bend {
            begin = corners[i + 1] + b.leaving * cut;
            all.push(b.arc);
        }
    }
    all
}

/// What of both legs may be rounded off where the one at this index meets the next: an inner leg gives half to each end.
fn rounded_off_mm(legs: &[Vector3<f64>], index: usize) -> f64 {
    let given_mm = |k: usize| {
        let is_inner = k > 0 && k + 1 < legs.len();
        legs[k].norm() * if is_inner { 0.5 } else { 1.0 }
    };
    given_mm(index).min(given_mm(index + 1))
}

/// Largest radius with which all corners between these legs can be rounded.
pub(super) fn bend_radius_max_mm(legs: &[Vector3<f64>]) -> f64 {
    let radius_mm = |k: usize| rounded_off_mm(legs, k) / (legs[k].angle(&legs[k + 1]) / 2.0).tan();
    (0..legs.len() - 1).map(radius_mm).fold(f64::INFINITY, f64::min)
}

/// An arc in a corner.
struct Bend {
    arc: Stretch,
    /// What it takes of each leg.
    cut: f64,
    leaving: Vector3<f64>,
}

/// The arc at `corner`, `None` where the wire goes straight on or the radius is 0.
fn bend(
    corner: Point3<f64>,
    arriving: Vector3<f64>,
    leaving: Vector3<f64>,
    radius: f64,
    cut_max: f64,
) -> Option<Bend> {
    let turn = arriving.angle(&leaving);
    let half = (0.5 * turn).tan();
    let cut = (radius * half).min(cut_max);
    let radius = cut / half;
    if !(turn > 1e-6 && cut > 1e-9 && radius > 1e-9) {
        return None;
    }
    let inward = (leaving - arriving * arriving.dot(&leaving)).normalize();
    let begin = corner - arriving * cut;
    let arc = Stretch::Arc { begin, direction: arriving, inward, radius, length: radius * turn };
    Some(Bend { arc, cut, leaving })
}
