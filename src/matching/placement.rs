//! From matched nodes to a first pose of the part, to be refined.

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

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
        UnitQuaternion::rotation_between(&a, &b).unwrap_or_else(|| half_turn(&a))
    };
    let rotation = if pairs.len() == 2 {
        on_a_line()
    } else {
        let mut cross = Matrix3::zeros();
        for (from, to) in pairs {
            cross += (to.coords - mean_to) * (from.coords - mean_from).transpose();
        }
        let svd = cross.svd(true, true);
        let (u, v_t) = (svd.u?, svd.v_t?);
        if svd.singular_values[1] < 1e-6 * svd.singular_values[0].max(1e-12) {
            on_a_line()
        } else {
            let flip = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant().signum()));
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(u * flip * v_t))
        }
    };
    let shift = mean_to - rotation * mean_from;
    shift.iter().all(|v| v.is_finite()).then(|| Isometry3::from_parts(Translation3::from(shift), rotation))
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
        [(a, b)] => UnitQuaternion::rotation_between(a, b).unwrap_or_else(|| half_turn(a)),
        many => {
            let mut cross = Matrix3::zeros();
            for (a, b) in many {
                cross += b * a.transpose();
            }
            // Two directions span a plane; its normal makes the rotation unique.
            let ((a0, b0), (a1, b1)) = (many[0], many[1]);
            let (na, nb) = (a0.cross(&a1).try_normalize(1e-6)?, b0.cross(&b1).try_normalize(1e-6)?);
            cross += nb * na.transpose();
            let svd = cross.svd(true, true);
            let (u, v_t) = (svd.u?, svd.v_t?);
            let flip = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant().signum()));
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(u * flip * v_t))
        }
    };
    Some(Isometry3::from_parts(Translation3::from(to.coords - rotation * from.coords), rotation))
}

#[cfg(test)]
mod tests {
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

    #[test]
    fn a_corner_and_its_legs_give_the_motion() {
        let motion = Isometry3::new(Vector3::new(5.0, -3.0, 400.0), Vector3::new(0.3, 2.0, -0.7));
        let legs = [Vector3::x(), Vector3::y()].map(|d| (d, motion * d));
        let corner = Point3::new(1.0, 2.0, 3.0);
        let found = motion_of_directions(&corner, &(motion * corner), &legs).unwrap();
        assert!((found.to_homogeneous() - motion.to_homogeneous()).norm() < 1e-9);
    }
}
