//! How far a result may be off.

use nalgebra::{Isometry3, Vector3};

use super::explanations::Explanation;
use super::prepared::Prepared;
use crate::grasp::{self, Grasp};

/// What is not known of how far a lamp displaces parts, as a share of it.
const LAMP_DOUBT: f64 = 0.7;

/// Standard deviations of the grasp's position (along the output frame's axes) and the root mean square angle between
/// the wire's direction there and the true one.
pub(super) fn sigmas(
    params: &grasp::Params,
    prepared: &Prepared,
    pose: &Isometry3<f64>,
    explanation: &Explanation,
    grasp: &Grasp,
) -> (Vector3<f64>, f64) {
    let Explanation { covariance, beside_mm, .. } = explanation;
    let arm = grasp.position_left_mm(params) - pose * prepared.pose_model().centre_mm;
    let shift = covariance.fixed_view::<3, 3>(0, 0);
    let turn = covariance.fixed_view::<3, 3>(3, 3);
    let mixed = covariance.fixed_view::<3, 3>(0, 3);
    let lever = -arm.cross_matrix();
    let position = shift
        + lever * turn * lever.transpose()
        + mixed * lever.transpose()
        + lever * mixed.transpose()
        + beside_mm * beside_mm.transpose() * LAMP_DOUBT.powi(2);
    let rotation = params.base_from_left.unwrap_or_default().rotation.to_rotation_matrix();
    let turned = rotation.matrix() * position * rotation.matrix().transpose();
    let wire = pose * prepared.part.grasp.approach.cross(&prepared.part.grasp.closing);
    let across = wire.cross_matrix();
    let axis = across * turn * across.transpose();
    // What is not a number is not known.
    let root = |variance: f64| if variance.is_nan() { f64::INFINITY } else { variance.max(0.0).sqrt() };
    (turned.diagonal().map(root), root(axis.trace()))
}
