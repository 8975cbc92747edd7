//! How far the right camera has turned since the rig was calibrated, as the parts tell.
//!
//! What turns the right camera moves all that its picture shows, and nothing in the left one. A pose can follow some of
//! that; what it cannot, all parts show alike. So each part gives normal equations of the turn, with its own pose solved
//! for beside it (the Schur complement of the fit's normal equations), and the sum over all parts has the answer.

use nalgebra::{Matrix3, Matrix6x3, Point3, SMatrix, Vector3};

use super::covariance::Observation;
use super::equations::{Solution, Unknowns};

/// What has been seen of a turn of the right camera about its optical centre: normal equations of the rotation vector,
/// radians, along the left camera's axes.
///
/// ```
/// use nalgebra::{Isometry3, Vector3};
/// use pickcell::part::Part;
/// use pickcell::pose::drawn::DrawnPair;
/// use pickcell::pose::model::PoseModel;
/// use pickcell::pose::refine::{Params, Refine, TurnSeen};
///
/// let rod = PoseModel::new(&Part::read(concat!(env!("CARGO_MANIFEST_DIR"), "/replay/parts/rod-90.toml"))?);
/// // Since the calibration the right camera has turned about the baseline, by half a pixel at 600 pixels of focal length.
/// let turn = Vector3::x() * (0.5 / 600.0);
/// let mut seen = TurnSeen::default();
/// for yaw in [0.4, 1.2, 2.2] {
///     let truth = Isometry3::new(Vector3::new(5.0, -10.0, 470.0), Vector3::z() * yaw);
///     let mut drawn = DrawnPair::new(&[(&rod, truth)]);
///     drawn.rig = drawn.rig.with_right_turned(&-turn);
///     let mut refine = Refine::new(Params { lift_radii: 0.0, ..Params::default() }, &drawn.rig);
///     let fit = refine.fine(&rod, &truth, &drawn.views()).unwrap();
///     seen += &refine.spread(&rod, &fit, &drawn.views()).turn;
/// }
/// let told = seen.normal.try_inverse().unwrap() * seen.right_side;
/// assert!(((told - turn).x * 600.0).abs() < 0.1);
/// # Ok::<(), pickcell::part::PartError>(())
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TurnSeen {
    /// Inverse covariance of it, 1/radians².
    pub normal: Matrix3<f64>,
    /// The turn that is seen is the solution of `normal * turn = right_side`.
    pub right_side: Vector3<f64>,
}

impl TurnSeen {
    /// What these measurements of a part tell. `solution` is that of its fit, `variance` by how much squares of residuals
    /// exceed what was assumed.
    pub(super) fn of(
        observations: &[Observation],
        solution: &Solution,
        variance: f64,
        part_centre: &Point3<f64>,
        right_eye: &Point3<f64>,
    ) -> Self {
        // A turn of the camera moves the picture as the opposite turn of the part about the camera would.
        let mut twist_per_turn = Matrix6x3::zeros();
        twist_per_turn.fixed_view_mut::<3, 3>(0, 0).copy_from(&(part_centre - right_eye).cross_matrix());
        twist_per_turn.fixed_view_mut::<3, 3>(3, 0).copy_from(&-Matrix3::identity());
        let (mut normal, mut with_pose) = (Matrix3::zeros(), SMatrix::<f64, 8, 3>::zeros());
        let (mut right_side, mut of_pose) = (Vector3::zeros(), Unknowns::zeros());
        for o in observations {
            let weighed = o.gradient * o.weight;
            of_pose += weighed * o.residual_px;
            if o.in_right() {
                let gradient = twist_per_turn.tr_mul(&o.gradient.fixed_rows::<6>(0));
                normal += gradient * gradient.transpose() * o.weight;
                with_pose += weighed * gradient.transpose();
                right_side += gradient * (o.weight * o.residual_px);
            }
        }
        // That the pose is near where it was found says nothing of the turn.
        let Some(inverse) = solution.inverse_at_large() else { return Self::default() };
        let follows = with_pose.transpose() * inverse;
        Self {
            normal: (normal - follows * with_pose) / variance,
            right_side: (right_side - follows * of_pose) / variance,
        }
    }
}

impl std::ops::AddAssign<&TurnSeen> for TurnSeen {
    fn add_assign(&mut self, other: &Self) {
        self.normal += other.normal;
        self.right_side += other.right_side;
    }
}
