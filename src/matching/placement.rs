//! From matched nodes to a first pose of the part, to be refined.

use nalgebra::{Isometry3, Matrix3, Matrix4, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};

/// Singular values whose second is below this share of the first belong to points on a line.
const LINE_MAX: f64 = 1e-6;
/// How far beside an eigenvalue, as a share of it.
const NEAR_EIGENVALUE: f64 = 1e-9;
/// More steps than Newton's method has ever needed.
const NEWTON_MAX: usize = 50;

/// The rigid motion that brings `from` nearest to `to`, in the least-squares sense (Kabsch,
/// doi:10.1107/S0567739476001873). Points on one line leave the angle about it open; it is then the smallest turn.
/// `None` for fewer than two pairs.
pub fn rigid_motion(pairs: &[(Point3<f64>, Point3<f64>)]) -> Option<Isometry3<f64>> {
    if pairs.len() < 2 {
        return None;
    }
    let n = pairs.len() as f64;
    let mean_from = pairs.iter().map(|p| p.0.coords).sum::<Vector3<f64>>() / n;
    let mean_to = pairs.iter().map(|p| p.1.coords).sum::<Vector3<f64>>() / n;
    let on_a_line = || {
        let (a, b) = (pairs[1].0 - pairs[0].0, pairs[1].1 - pairs[0].1);
        smallest_turn(&a, &b)
    };
    let rotation = if pairs.len() == 2 {
        on_a_line()
    } else {
        let (mut cross, mut squares) = (Matrix3::zeros(), 0.0);
        for (from, to) in pairs {
            let (from, to) = (from.coords - mean_from, to.coords - mean_to);
            cross += to * from.transpose();
            squares += (from.norm_squared() + to.norm_squared()) / 2.0;
        }
        nearest_rotation(&cross, squares).unwrap_or_else(on_a_line)
    };
    let shift = mean_to - rotation * mean_from;
    shift.iter().all(|v| v.is_finite()).then(|| Isometry3::from_parts(Translation3::from(shift), rotation))
}

/// The rotation that turns vectors nearest to others, from the sum of the products to * from^T, and half the sum of the
/// squares of all of them. `None` where they lie on a line, so that the angle about it is open.
///
/// Its quaternion belongs to the largest eigenvalue of a symmetric matrix of four rows (Horn, doi:10.1364/JOSAA.4.000629),
/// which Newton's method finds from above as a root of its polynomial (Theobald, doi:10.1107/S0108767305015266).
fn nearest_rotation(cross: &Matrix3<f64>, squares: f64) -> Option<UnitQuaternion<f64>> {
    let total = cross.norm_squared();
    // Of singular values a > b > c: a²b² + a²c² + b²c², against (a² + b² + c²)².
    let minors = cross.column(0).cross(&cross.column(1)).norm_squared()
        + cross.column(1).cross(&cross.column(2)).norm_squared()
        + cross.column(2).cross(&cross.column(0)).norm_squared();
    // What is not finite has no rotation, either.
    if !(minors > LINE_MAX * LINE_MAX * total * total && squares.is_finite()) {
        return None;
    }
    let s = cross.transpose();
    let (x, y, z) = (s.m23 - s.m32, s.m31 - s.m13, s.m12 - s.m21);
    let (xy, xz, yz) = (s.m12 + s.m21, s.m13 + s.m31, s.m23 + s.m32);
    let n = Matrix4::from([
        [s.m11 + s.m22 + s.m33, x, y, z],
        [x, s.m11 - s.m22 - s.m33, xy, xz],
        [y, xy, s.m22 - s.m11 - s.m33, yz],
        [z, xz, yz, s.m33 - s.m11 - s.m22],
    ]);
    // Its eigenvalues are the sums of the singular values with none or two of them negative.
    let (c2, c1, c0) = (-2.0 * total, -8.0 * cross.determinant(), total * total - 4.0 * minors);
    let mut largest = squares;
    for _ in 0..NEWTON_MAX {
        let square = largest * largest;
        let value = (square + c2) * square + c1 * largest + c0;
        let slope = (4.0 * square + 2.0 * c2) * largest + c1;
        let step = value / slope;
        if !step.is_finite() {
            break;
        }
        largest -= step;
        if step.abs() < 1e-13 * largest.abs() {
            break;
        }
    }
    // So near to an eigenvalue the inverse is the product of its vector with itself, times a large number.
    let product = (n - Matrix4::identity() * (largest * (1.0 + NEAR_EIGENVALUE))).try_inverse()?;
    let [w, x, y, z] = (product * product.column(product.diagonal().iamax())).into();
    UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 0.0)
}

/// The smallest turn that brings one direction to another.
fn smallest_turn(from: &Vector3<f64>, to: &Vector3<f64>) -> UnitQuaternion<f64> {
    let lengths = (from.norm_squared() * to.norm_squared()).sqrt();
    // With an angle of a between them, 1 + cos a and sin a are the cosine and the sine of a / 2, times 2 cos(a / 2).
    let half = Quaternion::from_parts(lengths + from.dot(to), from.cross(to));
    UnitQuaternion::try_new(half, 1e-9 * lengths).unwrap_or_else(|| half_turn(from))
}

fn half_turn(axis_to_reverse: &Vector3<f64>) -> UnitQuaternion<f64> {
    let other =
        if axis_to_reverse.x.abs() < 0.9 * axis_to_reverse.norm() { Vector3::x() } else { Vector3::y() };
    let axis = nalgebra::Unit::new_normalize(axis_to_reverse.cross(&other));
    UnitQuaternion::from_axis_angle(&axis, std::f64::consts::PI)
}

/// The motion that brings a point and the directions that leave it to a point and directions in space. With one
/// direction the angle about it is the smallest turn. `None` where the directions do not fit each other.
pub fn motion_of_directions(
    from: &Point3<f64>,
    to: &Point3<f64>,
    directions: &[(Vector3<f64>, Vector3<f64>)],
) -> Option<Isometry3<f64>> {
    let rotation = match directions {
        [] => return None,
        [(a, b)] => smallest_turn(a, b),
        many => {
            let mut cross = Matrix3::zeros();
            for (a, b) in many {
                cross += b * a.transpose();
            }
            // Two directions span a plane; its normal makes the rotation unique.
            let ((a0, b0), (a1, b1)) = (many[0], many[1]);
            let (na, nb) = (a0.cross(&a1).try_normalize(1e-6)?, b0.cross(&b1).try_normalize(1e-6)?);
            cross += nb * na.transpose();
            nearest_rotation(&cross, many.len() as f64 + 1.0)?
        }
    };
    Some(Isometry3::from_parts(Translation3::from(to.coords - rotation * from.coords), rotation))
}

#[cfg(test)]
mod tests {
    use nalgebra::Rotation3;
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn a_moved_triangle_gives_its_motion_back() {
        let motion = Isometry3::new(Vector3::new(5.0, -3.0, 400.0), Vector3::new(0.3, 2.0, -0.7));
        let corners = [Point3::new(50.0, 0.0, 0.0), Point3::origin(), Point3::new(0.0, 25.0, 0.0)];
        let pairs = corners.map(|p| (p, motion * p));
        let found = rigid_motion(&pairs).unwrap();
        assert!(corners.iter().all(|p| (found * p - motion * p).norm() < 1e-9));
        let found = rigid_motion(&pairs[..2]).unwrap();
        assert!(corners[..2].iter().all(|p| (found * p - motion * p).norm() < 1e-9));
        assert!(rigid_motion(&pairs[..1]).is_none());
    }

    proptest! {
        #[test]
        fn the_smallest_turn_brings_one_direction_to_another(
            from in proptest::array::uniform3(-40.0..40.0f64), to in proptest::array::uniform3(-40.0..40.0f64),
        ) {
            let [from, to] = [from, to].map(Vector3::from);
            prop_assume!(from.norm() > 1e-3 && to.norm() > 1e-3);
            let turn = smallest_turn(&from, &to);
            prop_assert!((turn * from.normalize() - to.normalize()).norm() < 1e-9);
            prop_assert!((turn.angle() - from.angle(&to)).abs() < 1e-6);
            let back = smallest_turn(&from, &-from);
            prop_assert!((back * from + from).norm() < 1e-6 * from.norm(), "{back}");
        }
    }

    /// By singular values (Kabsch, doi:10.1107/S0567739476001873), slower.
    fn nearest_rotation_twin(cross: &Matrix3<f64>) -> UnitQuaternion<f64> {
        let svd = cross.svd(true, true);
        let (u, v_t) = (svd.u.unwrap(), svd.v_t.unwrap());
        let flip = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant().signum()));
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(u * flip * v_t))
    }

    proptest! {
        #[test]
        fn the_nearest_rotation_is_that_of_singular_values(
            turn in proptest::array::uniform3(-3.0..3.0f64), flat in 0.0..1.0f64,
            points in proptest::collection::vec(proptest::array::uniform3(-40.0..40.0f64), 3..8),
            noise in proptest::collection::vec(proptest::array::uniform3(-2.0..2.0f64), 8),
        ) {
            let turn = UnitQuaternion::from_scaled_axis(Vector3::from(turn));
            // Many parts are flat.
            let points = points.into_iter().map(|[x, y, z]| Vector3::new(x, y, if flat < 0.5 { 0.0 } else { z }));
            let pairs: Vec<_> =
                points.zip(noise).map(|(from, noise)| (from, turn * from + Vector3::from(noise))).collect();
            let cross = pairs.iter().map(|(from, to)| to * from.transpose()).sum::<Matrix3<f64>>();
            let squares = pairs.iter().map(|(from, to)| from.norm_squared() + to.norm_squared()).sum::<f64>() / 2.0;
            let values = cross.singular_values();
            prop_assume!(values[1] > 0.01 * values[0]);
            let (found, twin) = (nearest_rotation(&cross, squares).unwrap(), nearest_rotation_twin(&cross));
            prop_assert!(found.angle_to(&twin) < 1e-6, "{} from {}", found, twin);
        }
    }

    #[test]
    fn points_on_a_line_leave_an_angle_open() {
        let points = [-1.0, 0.5, 3.0].map(|t| Vector3::new(1.0, 2.0, -1.0) * t);
        let cross = points.iter().map(|p| p * p.transpose()).sum::<Matrix3<f64>>();
        assert!(nearest_rotation(&cross, cross.trace()).is_none());
        assert!(nearest_rotation(&Matrix3::zeros(), 0.0).is_none());
        assert!(nearest_rotation(&Matrix3::from_element(f64::NAN), f64::NAN).is_none());
    }

    #[test]
    fn a_corner_and_its_legs_give_the_motion() {
        let motion = Isometry3::new(Vector3::new(5.0, -3.0, 400.0), Vector3::new(0.3, 2.0, -0.7));
        let legs = [Vector3::x(), Vector3::y()].map(|d| (d, motion * d));
        let corner = Point3::new(1.0, 2.0, 3.0);
        let found = motion_of_directions(&corner, &(motion * corner), &legs).unwrap();
        assert!((found.to_homogeneous() - motion.to_homogeneous()).norm() < 1e-9);
    }
}
