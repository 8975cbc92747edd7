//! Where and how wide a piece of wire is expected in a picture, and how that depends on the pose.

use nalgebra::{Matrix2x3, Point3, Vector2, Vector3, Vector6};

use super::refine::View;
use super::section::Profiler;
use super::width::ONE_WIRE;
use crate::vision::bits::{BitImage, nearest};

/// Where the width is looked at before an end, in half widths; the last one not of a dark wire, which its shadow
/// widens on one side.
const BARE_HALF_WIDTHS: [f64; 3] = [0.8, 1.6, 2.8];
/// See [`super::refine::EndSighting::mask_beyond_px`].
const HIDDEN_PX_MAX: u32 = 12;

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

/// Whether the wire just before an end seen `beyond` pixels beyond its expected place is as wide as one wire: an
/// end that lies on another wire is not where the bright region ends, nor one of which a neighbour hides a corner.
pub(super) fn end_is_bare(aim: &Aim, beyond: f64, profiler: &Profiler) -> bool {
    let places = if profiler.dark_parts() { &BARE_HALF_WIDTHS[..2] } else { &BARE_HALF_WIDTHS[..] };
    places.iter().all(|&back| {
        let at = aim.px + aim.along * (beyond - back * aim.half_width_px);
        profiler
            .across(at, aim.across, aim.half_width_px, 1.5)
            .and_then(|s| s.middle_and_width())
            .is_some_and(|(middle, width)| {
                let ratio = width / (2.0 * aim.half_width_px);
                ONE_WIRE.contains(&ratio) && middle.abs() < 0.5 * aim.half_width_px + 1.0
            })
    })
}

/// How far the mask goes on along a wire beyond its expected end.
pub(super) fn mask_beyond_px(mask: &BitImage, aim: &Aim) -> f64 {
    let object = |k: u32| {
        let at = aim.px + aim.along * f64::from(k);
        mask.get(nearest(at.x), nearest(at.y))
    };
    f64::from((0..HIDDEN_PX_MAX).find(|&k| !object(k + 1)).unwrap_or(HIDDEN_PX_MAX))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{Frame, LumaView};

    /// Whether an end is bare of a level wire 6 pixels wide, beside which something lies that begins some pixels before
    /// the end; dark on a light floor, or with all light turned round.
    fn is_bare(dark_parts: bool, begins_before_px: i32) -> bool {
        let grey = |x: i32, y: i32| match y {
            17..=22 if x <= 40 => 50u8,
            23..=26 if x <= 40 - begins_before_px => 60 + 30 * (y - 22) as u8,
            _ => 200,
        };
        let pixels = (0..40).flat_map(|y| (0..60).map(move |x| grey(x, y)));
        let pixels = pixels.flat_map(|v| [if dark_parts { v } else { 255 - v }; 3]);
        let frame = Frame::from_rgb(60, 40, pixels.collect());
        let aim = Aim {
            px: Vector2::new(40.5, 19.5),
            along: Vector2::x(),
            across: Vector2::y(),
            half_width_px: 3.0,
            jacobian: Matrix2x3::zeros(),
        };
        end_is_bare(&aim, 0.0, &Profiler::new(LumaView::new(&frame).unwrap(), dark_parts, 12.0))
    }

    #[test]
    fn only_close_to_its_end_must_a_dark_wire_be_bare_of_shadow() {
        assert!(is_bare(true, 8) && !is_bare(true, 4));
        assert!(is_bare(false, 10) && !is_bare(false, 8));
    }
}
