//! How light lies on wire: where the lamp stands, how far that displaces what is seen of a part, and how much a part
//! stands out.
//!
//! A lamp at one side lights round wire farther on that side: the middle between both borders of the lit region lies beside
//! the axis, so many radii towards the lamp. In one bin that is the same for all parts. Light within those borders lies still
//! farther towards the lamp, and so tells how far they do; beside dark parts their shadow does. A piece of wire tells what is across
//! it, in each picture; those that lie in different directions together tell all. The shadow beneath a dark part draws it down besides.

use nalgebra::{Matrix2, Vector2, Vector3};

use crate::pose::model::PoseModel;
use crate::pose::refine::View;
use crate::pose::verify::{PieceSight, Sight, Verdict};

/// Stations this many thicknesses apart are looked at, and of a short part so many at least.
const APART_THICKNESSES: usize = 6;
const PIECES_MIN: usize = 4;
/// Weight of no displacement along a part's wire, where nothing is seen of it, against all that is seen across.
const ALONG_WEIGHT: f64 = 0.02;
/// How many parts speak for a lamp straight above, unseen.
const ABOVE_PARTS: f64 = 0.3;

/// Farther no lamp above the bin displaces wire: at 45 degrees its light reaches from there on one side to the rim on the
/// other, and the middle lies 0.15 radii beside the axis.
const LAMP_RADII_MAX: f64 = 0.25;

/// Blur draws the outlines of dark wire towards the shadow beneath it, down on the floor: it is seen lower, by so many radii
/// over the square of its half width in pixels of the camera. From rendered scenes of 18 rigs, of wire 4 to 14 pixels wide:
/// 1.1 to 1.6 on the floor, half of that on other wire.
const LOWER_BLURRED_PX2: f64 = 1.2;
/// No wire is seen lower by more radii than this.
const LOWER_RADII_MAX: f64 = 0.83;

/// How light lies on the wire of one part.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Light {
    /// The equations of where it lies, in half widths along x and y of the left camera.
    normal: Matrix2<f64>,
    right_side: Vector2<f64>,
    /// By how many grey levels it stands out in each picture, in the mean; `None` where nothing of it is seen clearly.
    pub(super) above_in: [Option<f64>; 2],
    /// How full it is between its outlines, see [`LightAcross::full`], in the mean.
    pub(super) full: Option<f64>,
}

impl Light {
    /// On a part that pictures have this verdict on.
    pub(super) fn on(model: &PoseModel, verdict: &Verdict, views: &[View; 2]) -> Self {
        let (mut light, mut sums, mut counts, mut full) = (Self::default(), [0.0; 2], [0.0; 2], 0.0);
        let step = (APART_THICKNESSES * model.per_thickness).min(verdict.pieces.len() / PIECES_MIN).max(1);
        for piece in verdict.pieces.iter().step_by(step) {
            for (side, view) in
                views.iter().enumerate().filter(|(side, _)| piece[*side].sight == Sight::Clear)
            {
                let PieceSight { expected_px, across, half_width_px, seen_px, .. } = piece[side];
                let seen = seen_px.and_then(|px| view.profiler.light(expected_px, across, half_width_px, px));
                let Some(across_it) = seen else { continue };
                let across = view.rotation.tr_mul(&across.push(0.0)).xy();
                light.normal += across * across.transpose();
                light.right_side += across * across_it.aside;
                sums[side] += across_it.above;
                full += across_it.full;
                counts[side] += 1.0;
            }
        }
        let count = counts[0] + counts[1];
        if count > 0.0 {
            (light.normal, light.right_side) = (light.normal / count, light.right_side / count);
            light.full = Some(full / count);
        }
        light.above_in = [0, 1].map(|side: usize| (counts[side] > 0.0).then(|| sums[side] / counts[side]));
        light
    }

    /// By how many grey levels it stands out, in the mean of the pictures that show it clearly.
    pub(super) fn above(&self) -> Option<f64> {
        let [left, right] = self.above_in;
        left.zip(right).map(|(left, right)| f64::midpoint(left, right)).or(left).or(right)
    }

    /// How far a lamp displaces the part, in radii, where it displaces wire by `lamp_radii` across: what fits all its wire best,
    /// and nothing along it.
    pub(super) fn displaced(&self, lamp_radii: &Vector2<f64>) -> Vector3<f64> {
        let solved = (self.normal + Matrix2::identity() * ALONG_WEIGHT).try_inverse();
        solved.map_or(Vector2::zeros(), |inverse| inverse * (self.normal * lamp_radii)).push(0.0)
    }
}

/// How much lower than it lies dark wire of this half width is seen, in radii.
pub(super) fn seen_lower_radii(half_width_px: f64) -> f64 {
    (LOWER_BLURRED_PX2 / half_width_px.powi(2)).min(LOWER_RADII_MAX)
}

/// How far the lamp displaces what is seen of wire, in radii along x and y of the left camera.
pub(super) fn lamp_radii<'a>(lights: impl Iterator<Item = &'a Light>) -> Vector2<f64> {
    let (mut normal, mut right_side) = (Matrix2::identity() * ABOVE_PARTS, Vector2::zeros());
    for light in lights {
        normal += light.normal;
        right_side += light.right_side;
    }
    let lamp = normal.try_inverse().map_or(Vector2::zeros(), |inverse| inverse * right_side);
    lamp.cap_magnitude(LAMP_RADII_MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Straight wire in this direction, displaced so much across.
    fn straight(angle: f64, across_radii: f64) -> Light {
        let across = Vector2::new(-angle.sin(), angle.cos());
        Light { normal: across * across.transpose(), right_side: across * across_radii, ..Light::default() }
    }

    #[test]
    fn rods_in_different_directions_tell_where_the_lamp_is() {
        let lamp = Vector2::new(0.1, -0.05);
        let found_of = |lamp: Vector2<f64>| {
            let across = |angle: f64| Vector2::new(-angle.sin(), angle.cos());
            let light = |k: i32| {
                let angle = 0.4 * f64::from(k);
                straight(angle, lamp.dot(&across(angle)))
            };
            lamp_radii((0..12).map(light).collect::<Vec<_>>().iter())
        };
        let found = found_of(lamp);
        assert!((found - lamp).norm() < 0.01, "{found}");
        assert_eq!(lamp_radii([].iter()), Vector2::zeros());
        assert!((found_of(lamp * 99.0).norm() - LAMP_RADII_MAX).abs() < 1e-9);
        // One alone is not believed altogether, and displaced across only.
        let one = straight(0.0, 0.1);
        let found = lamp_radii([one].iter());
        assert!(found.x == 0.0 && (0.06..0.09).contains(&found.y), "{found}");
        let displaced = one.displaced(&lamp);
        assert!(displaced.x.abs() < 1e-9 && (displaced.y - lamp.y).abs() < 0.002, "{displaced}");
    }

    #[test]
    fn thick_dark_wire_is_seen_where_it_is_and_the_thinnest_not_below_itself() {
        assert!((seen_lower_radii(3.0) - 4.0 * seen_lower_radii(6.0)).abs() < 1e-9);
        assert!(seen_lower_radii(12.0) < 0.01 && (0.0..1.0).contains(&seen_lower_radii(0.1)));
    }
}
