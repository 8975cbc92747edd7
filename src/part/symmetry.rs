//! Which rotations map a part onto itself, found from its geometry.
//!
//! A rotation that does so permutes the nodes and the `via` corners among their like, and edges onto edges. Three
//! corners off one line fix it; so all images of one such triple are tried.

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, Unit, UnitQuaternion, Vector3};

use super::{Part, Symmetry};

/// The direction of the line through all points, `None` where one is further than `tolerance` from it.
pub(super) fn line_of(points: &[Point3<f64>], tolerance: f64) -> Option<Unit<Vector3<f64>>> {
    let far = |from: Point3<f64>| {
        let d = |p: &Point3<f64>| (p - from).norm_squared();
        points.iter().copied().max_by(|a, b| d(a).total_cmp(&d(b)))
    };
    let begin = far(*points.first()?)?;
    let direction = Unit::try_new(far(begin)? - begin, 1e-9)?;
    let off = |p: &Point3<f64>| (p - begin).cross(&direction).norm();
    points.iter().all(|p| off(p) <= tolerance).then_some(direction)
}

impl Part {
    /// All symmetries, the identity first.
    pub(super) fn find_symmetries(&self) -> Vec<Symmetry> {
        let corners = self.corner_points();
        let identity = (0..self.nodes.len()).collect();
        let mut found = vec![Symmetry { node_permutation: identity, part_from_part: Isometry3::identity() }];
        match self.straight_axis() {
            Some(axis) => {
                let end_over_end = end_over_end(&corners, axis);
                self.add(&mut found, &corners, end_over_end);
            }
            None => {
                for candidate in self.images_of_a_triple(&corners) {
                    self.add(&mut found, &corners, candidate);
                }
            }
        }
        found
    }

    /// Adds a candidate that maps the part onto itself and is not there yet.
    fn add(&self, found: &mut Vec<Symmetry>, corners: &[Point3<f64>], candidate: Isometry3<f64>) {
        let Some(images) = self.images(corners, &candidate) else { return };
        // the best rotation for this permutation, not only for the triple that led to it
        let part_from_part = fitted(corners, &images, &candidate);
        let is_new = found.iter().all(|s| {
            let turn = s.part_from_part.inverse() * part_from_part;
            turn.rotation.angle() > 1e-3 || turn.translation.vector.norm() > self.symmetry_tolerance_mm()
        });
        if is_new {
            let node_permutation = images[..self.nodes.len()].to_vec();
            found.push(Symmetry { node_permutation, part_from_part });
        }
    }

    /// For every corner the one where it comes to lie, `None` where the part is not mapped onto itself.
    fn images(&self, corners: &[Point3<f64>], turn: &Isometry3<f64>) -> Option<Vec<usize>> {
        let nodes = self.nodes.len();
        let tolerance = self.symmetry_tolerance_mm();
        let mut taken = vec![false; corners.len()];
        let mut images = Vec::with_capacity(corners.len());
        for (i, corner) in corners.iter().enumerate() {
            let moved = turn * corner;
            let alike = if i < nodes { 0..nodes } else { nodes..corners.len() };
            let nearest = alike.filter(|&j| !taken[j]).min_by(|&j, &k| {
                (corners[j] - moved).norm_squared().total_cmp(&(corners[k] - moved).norm_squared())
            })?;
            if (corners[nearest] - moved).norm() > tolerance {
                return None;
            }
            taken[nearest] = true;
            images.push(nearest);
        }
        let edges_of = |lines: Vec<Vec<usize>>| {
            let mut lines: Vec<Vec<usize>> = lines.into_iter().map(without_direction).collect();
            lines.sort_unstable();
            lines
        };
        let before = self.edge_corners();
        let after = before.iter().map(|l| l.iter().map(|&c| images[c]).collect()).collect();
        (edges_of(before) == edges_of(after)).then_some(images)
    }

    /// Indices of the corners of every edge, in order.
    fn edge_corners(&self) -> Vec<Vec<usize>> {
        let mut next_via = self.nodes.len();
        let corners_of = |e: &super::PartEdge| {
            let vias = next_via..next_via + e.via.len();
            next_via = vias.end;
            std::iter::once(e.from).chain(vias).chain(std::iter::once(e.to)).collect()
        };
        self.edges.iter().map(corners_of).collect()
    }

    /// The rotations that map one triple of corners to any triple of the same shape.
    fn images_of_a_triple(&self, corners: &[Point3<f64>]) -> Vec<Isometry3<f64>> {
        let tolerance = 2.0 * self.symmetry_tolerance_mm();
        let Some([a, b, c]) = wide_triple(corners) else { return Vec::new() };
        let (ab, ac, bc) = ((b - a).norm(), (c - a).norm(), (c - b).norm());
        let same =
            |p: &Point3<f64>, q: &Point3<f64>, length: f64| ((p - q).norm() - length).abs() <= tolerance;
        let mut candidates = Vec::new();
        for p in corners {
            for q in corners.iter().filter(|q| same(p, q, ab)) {
                for r in corners.iter().filter(|r| same(p, r, ac) && same(q, r, bc)) {
                    let turn = frame(p, q, r) * frame(&a, &b, &c).inverse();
                    candidates.push(turn);
                }
            }
        }
        candidates
    }
}

/// An edge read from either end is the same edge.
fn without_direction(line: Vec<usize>) -> Vec<usize> {
    let back: Vec<usize> = line.iter().rev().copied().collect();
    line.min(back)
}

/// Turned by 180 degrees about a line across the axis, through the middle of all.
fn end_over_end(points: &[Point3<f64>], axis: Unit<Vector3<f64>>) -> Isometry3<f64> {
    let along = |p: &Point3<f64>| p.coords.dot(&axis);
    let (low, high) = points.iter().map(along).fold((f64::MAX, f64::MIN), |(l, h), s| (l.min(s), h.max(s)));
    let middle = points[0] + axis.into_inner() * (0.5 * (low + high) - along(&points[0]));
    let across = Unit::new_normalize(axis.cross(&Vector3::ith(axis.iamin(), 1.0)));
    let turn = UnitQuaternion::from_axis_angle(&across, std::f64::consts::PI);
    Isometry3::from_parts(Translation3::from(middle.coords - turn * middle.coords), turn)
}

/// Two corners far from each other and one far from their line.
fn wide_triple(points: &[Point3<f64>]) -> Option<[Point3<f64>; 3]> {
    let first = *points.first()?;
    let by =
        |key: &dyn Fn(&Point3<f64>) -> f64| points.iter().copied().max_by(|p, q| key(p).total_cmp(&key(q)));
    let a = by(&|p| (p - first).norm_squared())?;
    let b = by(&|p| (p - a).norm_squared())?;
    let c = by(&|p| (p - a).cross(&(b - a)).norm_squared())?;
    Some([a, b, c])
}

/// A frame with origin `a`, x towards `b`, y towards `c`.
fn frame(a: &Point3<f64>, b: &Point3<f64>, c: &Point3<f64>) -> Isometry3<f64> {
    let x = (b - a).normalize();
    let z = x.cross(&(c - a)).normalize();
    let axes = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, z.cross(&x), z]));
    Isometry3::from_parts(Translation3::from(a.coords), UnitQuaternion::from_rotation_matrix(&axes))
}

/// The rotation that maps all points to their images with the least squared error, near `start` (Gauss-Newton on
/// the rotation vector; straight parts keep the turn about their axis that `start` has).
fn fitted(points: &[Point3<f64>], images: &[usize], start: &Isometry3<f64>) -> Isometry3<f64> {
    let centre = points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / points.len() as f64;
    let mut rotation = start.rotation;
    for _ in 0..10 {
        let mut information = Matrix3::identity() * 1e-9;
        let mut right = Vector3::zeros();
        for (p, &image) in points.iter().zip(images) {
            let moved = rotation * (p.coords - centre);
            let wanted = points[image].coords - centre;
            let cross = moved.cross_matrix();
            information += cross.tr_mul(&cross);
            right += moved.cross(&wanted);
        }
        let Some(step) = information.try_inverse().map(|i| i * right) else { break };
        rotation = UnitQuaternion::from_scaled_axis(step) * rotation;
    }
    Isometry3::from_parts(Translation3::from(centre - rotation * centre), rotation)
}
