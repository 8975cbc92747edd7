//! Where and how wide a piece of wire is expected in a picture, and how that depends on the pose.

use nalgebra::{Matrix2x3, Point3, Vector2, Vector3, Vector6};

use super::refine::View;

/// Unit vector from the axis of a wire to where the cameras, and the light above them, see it.
pub(super) fn up(eye: &Point3<f64>, point: &Point3<f64>, tangent: &Vector3<f64>) -> Vector3<f64> {
    let to_eye = eye - point;
    let across = to_eye - tangent * tangent.dot(&to_eye);
    across / across.norm().max(1e-9)
}

/// Where and how a piece of wire is expected in one picture.
pub(super) struct Aim {
    pub(super) px: Vector2<f64>,
    pub(super) along: Vector2<f64>,
    pub(super) across: Vector2<f64>,
    pub(super) half_width_px: f64,
    /// Pixels per mm in the left camera's axes.
    pub(super) jacobian: Matrix2x3<f64>,
}

impl Aim {
    /// Gradient of the pixel's movement along `direction` by displacement and rotation about a centre `arm` away.
    pub(super) fn gradient(&self, direction: &Vector2<f64>, arm: &Vector3<f64>) -> Vector6<f64> {
        let force: Vector3<f64> = self.jacobian.tr_mul(direction);
        let torque = arm.cross(&force);
        Vector6::new(force.x, force.y, force.z, torque.x, torque.y, torque.z)
    }
}

/// Where wire of this radius is expected in one picture; `None` where the camera does not see it.
pub(super) fn aim(radius_mm: f64, point: &Point3<f64>, tangent: &Vector3<f64>, view: &View) -> Option<Aim> {
    let in_camera = Point3::from(view.rotation * point.coords + view.camera_from_left.translation.vector);
    let (px, jacobian) = view.camera.project_with_jacobian(&in_camera)?;
    let jacobian = jacobian * view.rotation;
    let along = jacobian * tangent;
    let norm = along.norm();
    if norm < 1e-6 {
        return None;
    }
    let along = along / norm;
    let across = Vector2::new(-along.y, along.x);
    // A radius at right angles to the line of sight, as many pixels as the picture moves across the wire.
    let half_width_px = radius_mm * jacobian.tr_mul(&across).norm();
    Some(Aim { px, along, across, half_width_px, jacobian })
}
