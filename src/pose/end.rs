//! Where a wire ends, to a fraction of a pixel.
//!
//! Grey values along the wire, and along several lines beside its axis, fall from the wire's level to the floor's where it
//! ends; it ends where they have fallen half the way, on all lines about level.

use arrayvec::ArrayVec;
use nalgebra::Vector2;

use super::section::{Profiler, SAMPLES_MAX};

/// Within how many pixels an end is looked for at most: both sides of it fit into a line then.
const SEARCH_PX_MAX: f64 = 20.0;
/// How far behind an end it must be floor, in pixels.
const BEHIND_END_PX: f64 = 4.0;
/// How bright it may be behind an end, from floor (0) to wire (1).
const BEHIND_END_MAX: f64 = 0.35;

/// How an end is looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EndLook {
    /// Along one line.
    Quick,
    /// Along several lines side by side, which must end about level: what a neighbour hides ends obliquely.
    Close,
}

/// Where an end is looked at closely, in half widths from the middle: two lines on each side.
const END_RAYS: [f64; 5] = [-0.5, -0.25, 0.0, 0.25, 0.5];
/// How far the middles of both sides of these are apart.
const END_SIDES_APART: f64 = 0.75;
/// Tangent of the angle by which an end may seem cut obliquely. Of ends that are nobody else's, 97 in 100 are below 0.42.
const END_SLANT_MAX: f64 = 0.5;

/// Where a profile, bright up to `well_inside`, has first fallen half the way to `floor`, in samples.
fn fallen_half_way(profile: &[f64], well_inside: usize, floor: f64) -> Option<f64> {
    let level = profile[..well_inside].iter().sum::<f64>() / well_inside as f64;
    let at = (level + floor) / 2.0;
    // What has fallen so far before it should have ends somewhere else.
    let i = (well_inside..profile.len()).find(|&i| profile[i] <= at).filter(|&i| profile[i - 1] > at)?;
    Some((i - 1) as f64 + (profile[i - 1] - at) / (profile[i - 1] - profile[i]))
}

impl Profiler<'_> {
    /// How far beyond `end` (in pixels, negative: before) the wire ends, along the unit vector `outward`, where
    /// it ends within `search_px` against the background. `None` where it does not, where that leaves the picture, and where
    /// `search_px` is more than 20, for which a line has not samples enough.
    pub fn end(
        &self,
        end: Vector2<f64>,
        outward: Vector2<f64>,
        half_width_px: f64,
        search_px: f64,
        look: EndLook,
    ) -> Option<f64> {
        if !(0.0..=SEARCH_PX_MAX).contains(&search_px) {
            return None;
        }
        let samples_per_px = match look {
            EndLook::Quick => 1.0,
            EndLook::Close => 2.0,
        };
        let outside_px = search_px + BEHIND_END_PX + 0.5;
        // Of thick wire, as much as a line has samples for.
        let inside_max_px = (SAMPLES_MAX - 1) as f64 / samples_per_px - outside_px;
        let inside_px = (3.0 * half_width_px).max(search_px + 2.0).min(inside_max_px);
        let count = ((inside_px + outside_px) * samples_per_px) as usize + 1;
        let beside = Vector2::new(-outward.y, outward.x) * half_width_px;
        let step = outward / samples_per_px;
        let beside_px: &[f64] = match look {
            EndLook::Quick => &[0.0],
            EndLook::Close => &END_RAYS,
        };
        let from: ArrayVec<[f64; 2], 5> =
            beside_px.iter().map(|ray| (end - outward * inside_px + beside * *ray).into()).collect();
        let is_inside = |from: &[f64; 2]| {
            let from = Vector2::from(*from);
            self.inside(from) && self.inside(from + step * (count - 1) as f64)
        };
        if !(is_inside(&from[0]) && is_inside(&from[from.len() - 1])) {
            return None;
        }
        let mut rays = [[0f32; SAMPLES_MAX]; END_RAYS.len()];
        self.luma.read_lines(&from, step.into(), &mut rays, count);
        let light = |light: f32| f64::from(light) * self.sign;
        let well_inside = ((inside_px - search_px - 1.0).max(1.0) * samples_per_px) as usize;
        let mut profile = [0.0; SAMPLES_MAX];
        let profile = &mut profile[..count];
        // Of one line the others are dark.
        let [a, b, middle, c, d] = &rays;
        for (i, p) in profile.iter_mut().enumerate() {
            *p = light((a[i] + b[i]) + middle[i] + (c[i] + d[i])) / from.len() as f64;
        }
        let level = profile[..well_inside].iter().sum::<f64>() / well_inside as f64;
        let floor = profile[well_inside..].iter().copied().fold(f64::INFINITY, f64::min);
        if level - floor < self.contrast_min {
            return None;
        }
        let at = fallen_half_way(profile, well_inside, floor)?;
        // Behind an end is floor; a dark seam with another wire behind it is none.
        let after = |px: f64| (at.ceil() as usize + (px * samples_per_px) as usize).min(count);
        let bright = floor + BEHIND_END_MAX * (level - floor);
        if profile[after(1.0)..after(BEHIND_END_PX)].iter().any(|&v| v > bright) {
            return None;
        }
        let px = at / samples_per_px - inside_px;
        if px.abs() > search_px {
            return None;
        }
        if let EndLook::Close = look {
            let mut ends_at = |one: &[f32], other: &[f32]| {
                for (i, p) in profile.iter_mut().enumerate() {
                    *p = light(one[i] + other[i]) / 2.0;
                }
                fallen_half_way(profile, well_inside, floor)
            };
            let slant_px = (ends_at(c, d)? - ends_at(a, b)?).abs() / samples_per_px;
            if slant_px > END_SLANT_MAX * END_SIDES_APART * half_width_px {
                return None;
            }
        }
        Some(px)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::frame::{Frame, LumaView};
    use crate::pose::section::CONTRAST_MIN;

    /// A level wire of this half width around y = 60 that ends at x = 100, on a dark floor.
    fn wire(half_width_px: f64) -> Frame {
        let grey = |x: f64, y: f64| {
            let inside = (half_width_px - (y - 60.0).abs()).min(100.0 - x).clamp(-0.5, 0.5);
            (110.0 + 150.0 * inside) as u8
        };
        let pixels = (0..120).flat_map(|y| (0..160).map(move |x| grey(x.into(), y.into())));
        Frame::from_grey(160, 120, pixels.collect())
    }

    #[test]
    fn ends_of_thin_and_thick_wire_are_found() {
        for half_width_px in [1.5, 3.0, 8.0, 12.0, 16.0, 25.0, 40.0] {
            let frame = wire(half_width_px);
            let profiler = Profiler::new(LumaView::new(&frame).unwrap(), false, CONTRAST_MIN);
            for (look, search_px) in [(EndLook::Quick, 11.0), (EndLook::Close, 6.0)] {
                let expected = Vector2::new(97.6, 60.0);
                let seen = profiler.end(expected, Vector2::x(), half_width_px, search_px, look);
                assert!(seen.is_some_and(|px| (px - 2.4).abs() < 0.1), "{half_width_px} {look:?}: {seen:?}");
            }
        }
    }

    #[test]
    fn what_rises_where_it_should_have_fallen_ends_nowhere() {
        assert_eq!(fallen_half_way(&[10.0, 10.0, 2.0, 1.0, 0.0], 2, 0.0), Some(1.625));
        assert_eq!(fallen_half_way(&[30.0, 0.0, 2.0, 1.0, 0.0], 2, 0.0), None);
    }

    proptest! {
        #[test]
        fn any_look_at_any_picture_ends(
            (x, y) in (-50.0..250.0, -50.0..200.0), angle in 0.0..std::f64::consts::TAU,
            half_width_px in 0.0..200.0, search_px in -1.0..60.0, quick: bool, noise: [u8; 16],
        ) {
            let pixels = (0..160 * 120).map(|k: usize| noise[(k / 5 + k / 160) % 16]);
            let frame = Frame::from_grey(160, 120, pixels.collect());
            let profiler = Profiler::new(LumaView::new(&frame).unwrap(), false, CONTRAST_MIN);
            let outward = Vector2::new(f64::cos(angle), f64::sin(angle));
            let look = if quick { EndLook::Quick } else { EndLook::Close };
            let seen = profiler.end(Vector2::new(x, y), outward, half_width_px, search_px, look);
            prop_assert!(seen.is_none_or(|px| px.abs() <= search_px));
        }
    }
}
