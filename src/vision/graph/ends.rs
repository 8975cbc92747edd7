//! Ends put back to where the part ends.
//!
//! Thinning eats about half a thickness at each end. From the last skeleton
//! pixel the line's direction is followed outwards until the mask ends; grey values along three parallel rays then
//! give the place to a fraction of a pixel: where the profile crosses half way from the part's level to the
//! background's. Where the part fades into the dark the mask ends too early: there the difference to the floor on
//! both sides is followed until it drops at once.

use super::section::half_thickness_at_end;
use super::{Graph, NodeKind};
use crate::frame::{Frame, LumaView};
use crate::level::Level;
use crate::vision::bits::BitImage;
use std::ops::Range;

/// Distance of the outer rays from the middle one, in half thicknesses.
const RAY_OFFSET: f32 = 0.4;
/// Farthest that grey values may move an end from the mask's border, in pixels.
const SHIFT_MAX_PX: usize = 2;
/// Least difference of grey levels between part and background for grey values to count.
const CONTRAST_MIN: f32 = 12.0;

/// Puts all ends back; the result does not depend on the instructions.
pub(super) fn put_back(level: Level, mask: &BitImage, frame: Option<&Frame>, graph: &mut Graph) {
    match level {
        // SAFETY: `Graphs::with_level` lets only levels through that the machine has.
        #[cfg(target_arch = "x86_64")]
        Level::Avx512 => unsafe { put_back_avx512(mask, frame, graph) },
        // SAFETY: as above.
        #[cfg(target_arch = "x86_64")]
        Level::Avx2 => unsafe { put_back_avx2(mask, frame, graph) },
        _ => put_all_back(mask, frame, graph),
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,bmi1,bmi2,lzcnt,popcnt")]
fn put_back_avx512(mask: &BitImage, frame: Option<&Frame>, graph: &mut Graph) {
    put_all_back(mask, frame, graph);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi1,bmi2,popcnt")]
fn put_back_avx2(mask: &BitImage, frame: Option<&Frame>, graph: &mut Graph) {
    put_all_back(mask, frame, graph);
}

#[inline(always)]
fn put_all_back(mask: &BitImage, frame: Option<&Frame>, graph: &mut Graph) {
    let luma = frame.filter(|f| (f.width, f.height) == (mask.width(), mask.height())).and_then(LumaView::new);
    for e in 0..graph.edges.len() {
        for end in 0..2 {
            let n = graph.edges[e].nodes[end] as usize;
            if graph.nodes.get(n).is_some_and(|n| n.kind == NodeKind::End) {
                put_back_one(mask, luma.as_ref(), graph, e, end, n);
            }
        }
    }
}

/// A straight line outwards from a point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ray {
    pub(super) from: [f32; 2],
    pub(super) direction: [f32; 2],
}

impl Ray {
    /// The point this far along, and this far to the right of it.
    pub(super) fn at(self, along: f32, aside: f32) -> [f32; 2] {
        let ([x, y], [dx, dy]) = (self.from, self.direction);
        [x + along * dx - aside * dy, y + along * dy + aside * dx]
    }
}

#[inline(always)]
fn put_back_one(mask: &BitImage, luma: Option<&LumaView>, graph: &mut Graph, e: usize, end: usize, n: usize) {
    let chain = graph.edge_points(&graph.edges[e]);
    let half = half_thickness_at_end(mask, chain, end == 1, graph.edges[e].half_thickness_px.max(0.5));
    let Some(ray) = ray_at_end(chain, end == 1, half, graph.nodes[n].skeleton_px) else { return };
    let node = &mut graph.nodes[n];
    let (distance, seen) = match free_length(mask, ray, half) {
        Free::Ends(border) => distance_to_end(mask, luma, ray, half, border),
        Free::RunsInto(distance) => (distance.min(half), false),
    };
    let aside = middle_aside(mask, luma, ray, distance, half);
    node.position_px = ray.at(distance, aside);
    node.half_thickness_px = half;
    node.end_visible = seen;
}

/// The line through the end of a chain, from its last pixel outwards. Its direction comes from the pixels half a
/// thickness to two and a half thicknesses (at least 14 pixels) from the end: nearer ones bend into a corner of the
/// part.
pub(super) fn ray_at_end(chain: &[[u16; 2]], at_last: bool, half: f32, tip: [f32; 2]) -> Option<Ray> {
    let skip = (half as usize).min(chain.len() / 4);
    let take = ((4.0 * half) as usize).max(14).min(chain.len() - skip);
    if take < 2 {
        return None;
    }
    let mean = |range: Range<usize>| {
        let n = range.len() as f32;
        let range = if at_last { chain.len() - range.end..chain.len() - range.start } else { range };
        let sum = chain[range].iter().fold([0u32; 2], |s, p| [s[0] + p[0] as u32, s[1] + p[1] as u32]);
        [sum[0] as f32 / n, sum[1] as f32 / n]
    };
    let (near, far) = (mean(skip..skip + take / 2), mean(skip + take / 2..skip + take));
    let (dx, dy) = (near[0] - far[0], near[1] - far[1]);
    let length = (dx * dx + dy * dy).sqrt();
    if length < 0.1 {
        return None;
    }
    let on_line = Ray { from: near, direction: [dx / length, dy / length] };
    let along = (tip[0] - near[0]) * on_line.direction[0] + (tip[1] - near[1]) * on_line.direction[1];
    Some(Ray { from: on_line.at(along, 0.0), ..on_line })
}

/// What lies ahead of the last skeleton pixel.
enum Free {
    /// The mask ends here, with nothing beside it.
    Ends(f32),
    /// The mask goes on or widens into another part at this distance, or the picture ends there.
    RunsInto(f32),
}

/// Follows the mask outwards, a pixel at a time, and looks to both sides of the part.
fn free_length(mask: &BitImage, ray: Ray, half: f32) -> Free {
    let reach = (2.0 * half + 6.0) as i32;
    let aside = 1.3 * half + 1.5;
    let [middle, left, right] =
        [0.0, -aside, aside].map(|aside| Places::new(mask, Ray { from: ray.at(0.0, aside), ..ray }, 1.0));
    let mut beside = 0;
    for step in 0..reach {
        match middle.object(step) {
            None => return Free::RunsInto(step as f32),
            Some(false) => return Free::Ends(step as f32 - 0.5),
            Some(true) => {}
        }
        beside += (left.object(step) == Some(true)) as i32 + (right.object(step) == Some(true)) as i32;
        if beside > 2 {
            return Free::RunsInto(step as f32);
        }
    }
    Free::RunsInto(reach as f32)
}

/// Distance from the ray's beginning to the end of the part, whose mask ends at about `border`, and whether it was
/// seen to end there.
#[inline(always)]
fn distance_to_end(
    mask: &BitImage,
    luma: Option<&LumaView>,
    ray: Ray,
    half: f32,
    border: f32,
) -> (f32, bool) {
    let back = (border - half - 1.0).max(0.0);
    let (mut sum, mut count) = (0.0, 0.0);
    for offset in [0.0, -RAY_OFFSET, RAY_OFFSET] {
        let ray = Ray { from: ray.at(0.0, offset * half), ..ray };
        let Some(border) = border_in_mask(mask, ray, back, 2.0 * half + 8.0) else { continue };
        if let Some(luma) = luma {
            if offset == 0.0 {
                match fading(luma, ray, border, half) {
                    Fading::No => {}
                    Fading::EndsAt(distance) => return (distance, true),
                    Fading::GoesOn => return (border, false),
                }
            }
            sum += border_in_grey::<3>(luma, ray, border);
        } else {
            sum += border;
        }
        count += 1.0;
    }
    if count > 0.0 { (sum / count, true) } else { (border, true) }
}

/// How far to the right of the ray the middle of the part is: mean over sections a little before its end. 0 where
/// none is as wide as the part.
#[inline(always)]
fn middle_aside(mask: &BitImage, luma: Option<&LumaView>, ray: Ray, distance: f32, half: f32) -> f32 {
    let (mut sum, mut count) = (0.0, 0.0);
    for depth in [1.0, 1.8, 2.6] {
        let from = ray.at(distance - depth * half, 0.0);
        let [dx, dy] = ray.direction;
        let [right, left] = [Ray { from, direction: [-dy, dx] }, Ray { from, direction: [dy, -dx] }];
        let Some(right) = border_aside(mask, luma, right, half) else { continue };
        let Some(left) = border_aside(mask, luma, left, half) else { continue };
        if (0.6..1.5).contains(&((left + right) / (2.0 * half))) {
            sum += (right - left) / 2.0;
            count += 1.0;
        }
    }
    if count > 0.0 { sum / count } else { 0.0 }
}

/// Distance to the border on one side of the part, half of it as thick as given, from about its middle.
#[inline(always)]
fn border_aside(mask: &BitImage, luma: Option<&LumaView>, aside: Ray, half: f32) -> Option<f32> {
    let border = border_in_mask(mask, aside, (half - 2.0).max(0.0), 1.5 * half + 2.0)?;
    Some(match luma {
        Some(luma) => border_in_grey::<2>(luma, aside, border),
        None => border,
    })
}

/// Pixels of a mask along a ray, at equal steps.
#[derive(Clone, Copy)]
struct Places<'a> {
    mask: &'a BitImage,
    /// Pixel coordinates and steps with 16 fractional bits, half a pixel added.
    at: [i64; 2],
    step: [i64; 2],
}

impl<'a> Places<'a> {
    fn new(mask: &'a BitImage, ray: Ray, step_px: f32) -> Self {
        let fixed = |v: f32| (v * 65536.0) as i64;
        Self { mask, at: ray.from.map(|v| fixed(v + 0.5)), step: ray.direction.map(|v| fixed(v * step_px)) }
    }

    /// The pixel at a step; `None` outside the picture.
    #[inline]
    fn object(&self, step: i32) -> Option<bool> {
        let [x, y] = [0, 1].map(|i| (self.at[i] + self.step[i] * step as i64) >> 16);
        let inside = (x as u64) < self.mask.width() as u64 && (y as u64) < self.mask.height() as u64;
        inside.then(|| self.mask.get(x as i32, y as i32))
    }
}

/// Distance to the mask's border, looked for from `begin_px` on; `None` where it does not end within `reach_px` or
/// the picture ends first. Where the mask has ended before, the way back to it.
fn border_in_mask(mask: &BitImage, ray: Ray, begin_px: f32, reach_px: f32) -> Option<f32> {
    const STEP: f32 = 0.5;
    let places = Places::new(mask, ray, STEP);
    let begin = (begin_px / STEP) as i32;
    if places.object(begin)? {
        let border = (begin + 1..=(reach_px / STEP) as i32).find(|&i| places.object(i) != Some(true))?;
        places.object(border).map(|_| (border as f32 - 0.5) * STEP)
    } else {
        (0..begin).rev().find(|&i| places.object(i) == Some(true)).map(|i| (i as f32 + 0.5) * STEP)
    }
}

/// The mask's border refined: where grey values cross half way between the part, `DEPTH` pixels and one more before
/// the border, and what lies two and three pixels behind it.
#[inline(always)]
fn border_in_grey<const DEPTH: usize>(luma: &LumaView, ray: Ray, border: f32) -> f32 {
    let zero = DEPTH + 1;
    let grey: [f32; 8] = luma.profile(ray.at(border - zero as f32, 0.0), ray.direction);
    let inside = (grey[0] + grey[1]) / 2.0;
    let outside = (grey[zero + 2] + grey[zero + 3]) / 2.0;
    if (inside - outside).abs() < CONTRAST_MIN {
        return border;
    }
    let level = (inside + outside) / 2.0;
    let above = |i: usize| (grey[i] - level) * (inside - outside).signum();
    for i in zero - SHIFT_MAX_PX..zero + SHIFT_MAX_PX {
        let (before, after) = (above(i), above(i + 1));
        if before > 0.0 && after <= 0.0 {
            return border + i as f32 - zero as f32 + before / (before - after);
        }
    }
    border
}

/// Whether a part goes on in grey behind the mask's border.
enum Fading {
    No,
    /// It does, and ends there.
    EndsAt(f32),
    /// It does as far as was looked.
    GoesOn,
}

/// Follows the difference between the ray and the floor on both sides of it beyond the mask's border.
#[inline(always)]
fn fading(luma: &LumaView, ray: Ray, border: f32, half: f32) -> Fading {
    let aside = 2.2 * half + 2.0;
    let ahead = signal(luma, ray, border + 3.0, aside);
    if ahead < CONTRAST_MIN || ahead < 0.4 * signal(luma, ray, border - 3.0, aside) {
        Fading::No
    } else {
        faded(luma, ray, border, half, aside)
    }
}

/// [`fading`] of a part that does.
#[cold]
#[inline(never)]
fn faded(luma: &LumaView, ray: Ray, border: f32, half: f32, aside: f32) -> Fading {
    for step in 1..(10.0 * half) as i32 {
        let along = border + step as f32;
        let (before, now) = (signal(luma, ray, along - 3.0, aside), signal(luma, ray, along, aside));
        if now < 0.5 * before {
            return Fading::EndsAt(along - 0.5);
        }
    }
    Fading::GoesOn
}

/// By how much it is brighter at a place along the ray than so far aside of it.
#[inline(always)]
fn signal(luma: &LumaView, ray: Ray, along: f32, aside: f32) -> f32 {
    let [dx, dy] = ray.direction;
    let [left, here, right] = luma.profile(ray.at(along, -aside), [-dy * aside, dx * aside]);
    here - left.max(right)
}
