//! Which of two wires that cross lies on top, from what the pictures show.
//!
//! The upper wire goes through a crossing as bright along its middle as beside it; the lower one is interrupted there by
//! the flanks of the upper one, which the light leaves dark, and by its shadow.

use super::aim::aim;
use super::contact::Passing;
use super::refine::View;

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
    let sin = aim_a.along.perp(&aim_b.along).abs();
    if sin < CROSSING_SIN_MIN {
        return None;
    }
    // Seen at an angle, axes of different height cross beside the crossing seen from above.
    let apart = aim_b.px - aim_a.px;
    let middle_a = aim_a.px + aim_a.along * (apart.perp(&aim_b.along) / aim_a.along.perp(&aim_b.along));
    let dip = |at, along, other_half_px: f64| view.profiler.dip(at, along, other_half_px / sin + 1.5);
    let of_a = dip(middle_a, aim_a.along, aim_b.half_width_px)?;
    let of_b = dip(middle_a, aim_b.along, aim_a.half_width_px)?;
    Some(of_b - of_a)
}
