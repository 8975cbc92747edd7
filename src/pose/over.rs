//! Which of two wires that cross lies on top, from what the pictures show.
//!
//! The upper wire goes through a crossing as bright along its middle as beside it; the lower one is interrupted there by
//! the flanks of the upper one, which the light leaves dark, and by its shadow.
//!
//! ```
//! use nalgebra::{Point3, Vector3};
//! use pickcell::frame::Frame;
//! use pickcell::pose::contact::Passing;
//! use pickcell::pose::drawn::DrawnPair;
//! use pickcell::pose::over::is_over;
//!
//! // Half a metre away at (0, 0) a level wire lies over an upright one, which its dark flanks interrupt. The right camera,
//! // 60 mm to the right, sees the crossing 72 pixels farther left.
//! let mut drawn = DrawnPair::new(&[]);
//! drawn.frames = [320, 248].map(|crossing_x: i32| {
//!     let pixels = (0..480).flat_map(|y: i32| {
//!         (0..640).map(move |x: i32| match ((y - 240).abs(), (x - crossing_x).abs()) {
//!             (0..=1, _) => 200,
//!             (2..=3, _) => 90,
//!             (_, 0..=1) => 190,
//!             (_, 2..=3) => 90,
//!             _ => 30,
//!         })
//!     });
//!     Frame::from_grey(640, 480, pixels.collect())
//! });
//! let wire = |along| Passing { at_mm: Point3::new(0.0, 0.0, 500.0), along, radius_mm: 2.5, to_end_mm: 50.0 };
//! let (level, upright) = (wire(Vector3::x()), wire(Vector3::y()));
//! assert_eq!(is_over(&level, &upright, &drawn.views()), Some(true));
//! assert_eq!(is_over(&upright, &level, &drawn.views()), Some(false));
//! ```

use super::aim::{Aim, aim};
use super::contact::Passing;
use super::refine::View;
use super::section::DIP_BESIDE_PX;

/// Sine of the angle at which wires cross in a picture, below which it says nothing.
const CROSSING_SIN_MIN: f64 = 0.25;
/// How much more the lower wire is interrupted than the upper one, in grey levels, at least: twice what noise of 3 grey
/// levels makes of the difference of two lowest values.
const DIFFERENCE_MIN: f64 = 8.0;

/// Whether the first of two wires lies over the second: where both pictures say so. `None` where they do not, or are of
/// different opinions.
pub fn is_over(a: &Passing, b: &Passing, views: &[View; 2]) -> Option<bool> {
    let [left, right] = [0, 1].map(|side: usize| more_interrupted(a, b, &views[side]));
    let (left, right) = (left?, right?);
    if left.abs().min(right.abs()) < DIFFERENCE_MIN || (left > 0.0) != (right > 0.0) {
        return None;
    }
    Some(left > 0.0)
}

/// By how many grey levels more the second is interrupted than the first.
fn more_interrupted(a: &Passing, b: &Passing, view: &View) -> Option<f64> {
    let aimed = |p: &Passing| aim(p.radius_mm, &p.at_mm, &p.along, view);
    let (aim_a, aim_b) = (aimed(a)?, aimed(b)?);
    let turn = aim_a.along.perp(&aim_b.along);
    let sin = turn.abs();
    if sin < CROSSING_SIN_MIN {
        return None;
    }
    // Seen at an angle, axes of different height cross beside the crossing seen from above.
    let apart = aim_b.px - aim_a.px;
    let crossing = aim_a.px + aim_a.along * (apart.perp(&aim_b.along) / turn);
    let dip = |of: &Passing, aim: &Aim, other_half_px: f64| {
        let near_px = other_half_px / sin + 1.5;
        // A wire that ends there is interrupted by its end.
        let to_end_px = of.to_end_mm * aim.half_width_px / of.radius_mm;
        if to_end_px < near_px + DIP_BESIDE_PX as f64 {
            return None;
        }
        view.profiler.dip(crossing, aim.along, near_px)
    };
    let of_a = dip(a, &aim_a, aim_b.half_width_px)?;
    let of_b = dip(b, &aim_b, aim_a.half_width_px)?;
    Some(of_b - of_a)
}

#[cfg(test)]
mod tests {
    use nalgebra::{Isometry3, Matrix3, Point3, Vector3};

    use super::*;
    use crate::frame::{Frame, LumaView};
    use crate::pose::section::Profiler;
    use crate::rig::CameraModel;
    use crate::vision::bits::BitImage;

    /// What two pictures tell of a level wire and one across it, 3 mm thick, both half a metre away: at the crossing the
    /// level one is seen whole, with flanks of this grey value.
    fn told(left_flank: u8, right_flank: u8, to_end_mm: f64) -> [Option<bool>; 2] {
        let camera = CameraModel::pinhole(200, 160, 1000.0, 100.0, 80.0);
        let right = Isometry3::translation(-10.0, 0.0, 0.0);
        let frame = |crossing_x: i32, flank: u8| {
            let pixels = (0..160).flat_map(|y: i32| {
                (0..200).map(move |x: i32| match ((x - crossing_x).abs(), (y - 80).abs()) {
                    (_, 0..=1) => 200u8,
                    (_, 2..=3) => flank,
                    (0..=1, _) => 190,
                    (2..=3, _) => 90,
                    _ => 30,
                })
            });
            Frame::from_rgb(200, 160, pixels.flat_map(|v| [v; 3]).collect())
        };
        let frames = [frame(100, left_flank), frame(80, right_flank)];
        let mask = BitImage::new(200, 160);
        let view = |side: usize, camera_from_left| View {
            camera: &camera,
            camera_from_left,
            rotation: Matrix3::identity(),
            profiler: Profiler::new(LumaView::new(&frames[side]).unwrap(), false, 12.0),
            mask: &mask,
        };
        let views = [view(0, Isometry3::identity()), view(1, right)];
        let wire = |along| Passing { at_mm: Point3::new(0.0, 0.0, 500.0), along, radius_mm: 1.5, to_end_mm };
        let (level, upright) = (wire(Vector3::x()), wire(Vector3::y()));
        [is_over(&level, &upright, &views), is_over(&upright, &level, &views)]
    }

    #[test]
    fn the_wire_that_is_not_interrupted_lies_over_the_other() {
        assert_eq!(told(90, 90, 40.0), [Some(true), Some(false)]);
    }

    #[test]
    fn wires_that_end_at_the_crossing_tell_nothing() {
        assert_eq!(told(90, 90, 3.0), [None; 2]);
    }

    #[test]
    fn without_dark_flanks_or_in_one_picture_alone_nothing_is_told() {
        assert_eq!(told(195, 195, 40.0), [None; 2]);
        assert_eq!(told(90, 195, 40.0), [None; 2]);
    }
}
