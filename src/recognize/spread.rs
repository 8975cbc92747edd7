//! How far a result may be off.

use nalgebra::{Isometry3, Matrix2, Matrix6, Vector2, Vector3};

use super::prepared::Prepared;
use crate::grasp;
use crate::pose::model::PoseModel;
use crate::pose::refine::View;
use crate::pose::verify::{PieceSight, Sight, Verdict};

/// Standard deviations of the grasp's position (along the output frame's axes) and the root mean square angle between
/// the wire's direction there and the true one. `covariance` is that of
/// [`Refine::covariance`](crate::pose::refine::Refine::covariance), `beside` how far the lamp may have displaced the part,
/// in mm of the left camera's frame.
pub(super) fn sigmas(
    params: &grasp::Params,
    prepared: &Prepared,
    pose: &Isometry3<f64>,
    covariance: &Matrix6<f64>,
    beside: &Vector3<f64>,
) -> (Vector3<f64>, f64) {
    let arm = pose * prepared.part.grasp.position_mm - pose * prepared.pose_model.centre_mm;
    let shift = covariance.fixed_view::<3, 3>(0, 0);
    let turn = covariance.fixed_view::<3, 3>(3, 3);
    let mixed = covariance.fixed_view::<3, 3>(0, 3);
    let lever = -arm.cross_matrix();
    let position = shift
        + lever * turn * lever.transpose()
        + mixed * lever.transpose()
        + lever * mixed.transpose()
        + beside * beside.transpose();
    let rotation = params.base_from_left.unwrap_or_default().rotation.to_rotation_matrix();
    let turned = rotation.matrix() * position * rotation.matrix().transpose();
    let wire = pose * prepared.part.grasp.approach.cross(&prepared.part.grasp.closing);
    let across = wire.cross_matrix();
    let axis = across * turn * across.transpose();
    (turned.diagonal().map(|v| v.max(0.0).sqrt()), axis.trace().max(0.0).sqrt())
}

/// How far the lamp may have displaced a part: across, in mm of the left camera's frame, from how far the light of its
/// wires lies beside their middles.
pub(super) fn displaced_by_lamp(
    per_skew: f64,
    model: &PoseModel,
    verdict: &Verdict,
    views: &[View; 2],
) -> Vector3<f64> {
    let mut normal = Matrix2::zeros();
    let mut right_side = Vector2::zeros();
    for piece in verdict.pieces.iter().step_by(SKEW_THICKNESSES * model.per_thickness) {
        for (seen, view) in piece.iter().zip(views).filter(|(seen, _)| seen.sight == Sight::Clear) {
            let PieceSight { expected_px, across, half_width_px, .. } = *seen;
            let skew = seen.seen_px.and_then(|px| view.profiler.skew(expected_px, across, half_width_px, px));
            let Some(skew) = skew else { continue };
            normal += seen.across * seen.across.transpose() + Matrix2::identity() * ALONG_WEIGHT;
            right_side += seen.across * skew;
        }
    }
    let radii = normal.try_inverse().map_or(Vector2::zeros(), |inverse| inverse * right_side) * per_skew;
    Vector3::new(radii.x, radii.y, 0.0) * model.radius_mm
}

/// Stations this many thicknesses apart are looked at.
const SKEW_THICKNESSES: usize = 6;
/// Along a straight wire nothing is seen of the lamp: it is taken for nought there.
const ALONG_WEIGHT: f64 = 0.02;
