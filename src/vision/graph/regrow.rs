//! What thinning ate of lines along a diagonal, put back.
//!
//! Zhang-Suen deletes the ends of diagonal lines two pixels wide, one pixel a round, as long as anything changes: of
//! a rod at 45 degrees a single pixel may be left in its middle. Where the mask goes on behind the last pixel of a
//! chain for longer than half a thickness, its middle is followed until it ends, and the chain goes on there.

use super::ends::{Ray, ray_at_end};
use super::section::run;
use crate::vision::bits::BitImage;

/// A piece of mask is long where it is this many times as long as thick.
const ELONGATION_MIN: f32 = 2.5;
/// Thickest line that is followed, in pixels.
const THICKNESS_MAX_PX: f32 = 64.0;

/// Appends to `points`, from near to far, the middle of the mask behind one end of the chain `points[begin..]`, as
/// far as thinning would have left it. Whether there was any. Nothing is appended over `points_max`.
pub(super) fn extend(
    mask: &BitImage,
    points: &mut Vec<[u16; 2]>,
    begin: usize,
    at_last: bool,
    thickness_px: f32,
    points_max: usize,
) -> bool {
    let half = (thickness_px / 2.0).max(0.5);
    let chain = &points[begin..];
    let tip = if at_last { chain[chain.len() - 1] } else { chain[0] };
    let tip_px = tip.map(f32::from);
    let ray = if chain.len() as f32 > thickness_px.max(5.0) {
        ray_at_end(chain, at_last, half, tip_px)
    } else {
        // Too short to tell a direction: the mask's.
        let away = if at_last { chain[0] } else { chain[chain.len() - 1] };
        let onward = [0, 1].map(|i| tip[i] as f32 - away[i] as f32);
        long_diagonal(mask, tip, thickness_px).map(|d| {
            let backwards = onward[0] * d[0] + onward[1] * d[1] < 0.0;
            Ray { from: tip_px, direction: if backwards { d.map(|v| -v) } else { d } }
        })
    };
    let Some(ray) = ray else { return false };
    let clear = |along: f32| {
        let [x, y] = ray.at(along, 0.0);
        !mask.get(x.round() as i32, y.round() as i32)
    };
    let eaten = 1.7 * half + 3.0;
    if thickness_px > THICKNESS_MAX_PX || clear(eaten) || clear(eaten / 2.0) {
        return false;
    }
    let before = points.len();
    follow(mask, ray, half, points, points_max);
    // As thinning does: half a thickness short of the end.
    let keep = (points.len() - before).saturating_sub(half.round() as usize);
    points.truncate(before + keep);
    keep > 0
}

/// A line for a pixel that is all thinning left of a long part: both ways from it. Whether there was one.
pub(super) fn from_pixel(
    mask: &BitImage,
    pixel: [u16; 2],
    points: &mut Vec<[u16; 2]>,
    points_max: usize,
) -> Option<f32> {
    let thickness = super::section::thickness_around(mask, pixel);
    long_diagonal(mask, pixel, thickness)?;
    let begin = points.len();
    if begin >= points_max {
        return None;
    }
    points.push(pixel);
    let any = extend(mask, points, begin, true, thickness, points_max);
    // The second way: the chain now has a direction, or still the mask's, turned by its order.
    points[begin..].reverse();
    let other = extend(mask, points, begin, true, thickness, points_max);
    if !any && !other {
        points.truncate(begin);
        return None;
    }
    Some(thickness)
}

/// Unit vector along the diagonal in which the mask is long; `None` where it is not.
fn long_diagonal(mask: &BitImage, [x, y]: [u16; 2], thickness_px: f32) -> Option<[f32; 2]> {
    let (x, y) = (x as i32, y as i32);
    let (down, up) = (run(mask, x, y, 1, 1), run(mask, x, y, 1, -1));
    let unit = std::f32::consts::FRAC_1_SQRT_2;
    let long = down.max(up) as f32 * std::f32::consts::SQRT_2;
    (long > ELONGATION_MIN * thickness_px).then_some([unit, if down > up { unit } else { -unit }])
}

/// Follows the middle of the mask from the ray's beginning until the mask ends or widens.
fn follow(mask: &BitImage, ray: Ray, half: f32, points: &mut Vec<[u16; 2]>, points_max: usize) {
    let reach = 1.4 * half + 2.0;
    let mut here = ray;
    for step in 1..mask.width() + mask.height() {
        here.from = here.at(1.0, 0.0);
        let [x, y] = here.from.map(f32::round);
        if points.len() >= points_max || !mask.get(x as i32, y as i32) {
            return;
        }
        let (Some(left), Some(right)) = (border_aside(mask, here, -reach), border_aside(mask, here, reach))
        else {
            return;
        };
        here.from = here.at(0.0, ((right - left) / 2.0).clamp(-0.5, 0.5));
        // The direction: from the beginning to here, once that is long enough to know better.
        let (dx, dy) = (here.from[0] - ray.from[0], here.from[1] - ray.from[1]);
        let length = dx.hypot(dy);
        if step > 8 && length > 4.0 {
            here.direction = [dx / length, dy / length];
        }
        let pixel = here.from.map(|v| v.round().max(0.0) as u16);
        if points.last() != Some(&pixel) && mask.get(pixel[0] as i32, pixel[1] as i32) {
            points.push(pixel);
        }
    }
}

/// Distance to the mask's border to the right of a ray's beginning, or to its left where `reach` is negative;
/// `None` where the mask goes on.
fn border_aside(mask: &BitImage, ray: Ray, reach: f32) -> Option<f32> {
    let steps = (2.0 * reach.abs()) as i32;
    (1..=steps).map(|i| i as f32 * 0.5).find(|&aside| {
        let [x, y] = ray.at(0.0, aside.copysign(reach));
        !mask.get(x.round() as i32, y.round() as i32)
    })
}
