//! How far a result may be off.

use nalgebra::{Matrix3, Vector3};

use super::prepared::Prepared;
use crate::grasp;
use crate::pose::refine::Fit;

/// Errors of neighbouring sections are alike (shading), so that their mean errs more than if they were not.
const SIGMA_SCALE: f64 = 1.25;

/// What shading moves all sections of a wire alike, in mm: across, and along the line of sight, where the height of
/// the lit line above the axis ([`lift_radii`](crate::pose::refine::Params::lift_radii)) and the angle between the cameras multiply it.
const SHADING_SIGMA_MM: [f64; 2] = [0.03, 0.06];

/// Standard deviations of the grasp's position (along the output frame's axes) and of the wire's direction there.
pub(super) fn sigmas(params: &grasp::Params, prepared: &Prepared, fit: &Fit) -> (Vector3<f64>, f64) {
    let pose = &fit.left_from_part;
    let arm = pose * prepared.part.grasp.position_mm - pose * prepared.pose_model.centre_mm;
    let shift = fit.covariance.fixed_view::<3, 3>(0, 0);
    let turn = fit.covariance.fixed_view::<3, 3>(3, 3);
    let mixed = fit.covariance.fixed_view::<3, 3>(0, 3);
    let lever = -arm.cross_matrix();
    let position =
        shift + lever * turn * lever.transpose() + mixed * lever.transpose() + lever * mixed.transpose();
    let sight = pose.translation.vector.normalize();
    let position = position * (SIGMA_SCALE * fit.misfit.max(1.0)).powi(2)
        + Matrix3::identity() * SHADING_SIGMA_MM[0].powi(2)
        + sight * sight.transpose() * SHADING_SIGMA_MM[1].powi(2);
    let rotation = params.base_from_left.unwrap_or_default().rotation.to_rotation_matrix();
    let turned = rotation.matrix() * position * rotation.matrix().transpose();
    let wire = pose * prepared.part.grasp.approach.cross(&prepared.part.grasp.closing);
    let across = wire.cross_matrix();
    let axis = across * turn * across.transpose();
    // Measurements that agree worse than assumed are worth less.
    let scale = SIGMA_SCALE * fit.misfit.max(1.0);
    (turned.diagonal().map(|v| v.max(0.0).sqrt()), (axis.trace() / 2.0).max(0.0).sqrt() * scale)
}
