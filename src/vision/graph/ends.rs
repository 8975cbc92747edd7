//! Ends put back to where the part ends.
//!
//! Thinning eats about half a thickness at each end. From the last skeleton pixel the line's direction is followed
//! outwards until the mask ends; grey values along three parallel rays then give the place to a fraction of a
//! pixel: where the profile crosses half way from the part's level to the background's.

use super::{Graph, NodeKind};
use crate::frame::{Frame, PixelFormat};
use crate::vision::bits::BitImage;

/// Distance of the outer rays from the middle one, in half thicknesses.
const RAY_OFFSET: f32 = 0.4;
/// Farthest that grey values may move an end from the mask's border, in pixels.
const SHIFT_MAX_PX: f32 = 2.0;
/// Least difference of grey levels between part and background for grey values to count.
const CONTRAST_MIN: f32 = 12.0;

/// Puts all ends back.
pub(super) fn put_back(mask: &BitImage, frame: Option<&Frame>, graph: &mut Graph) {
    let frame = frame
        .filter(|f| f.format != PixelFormat::Mjpeg && (f.width, f.height) == (mask.width(), mask.height()));
    for e in 0..graph.edges.len() {
        for end in 0..2 {
            let n = graph.edges[e].nodes[end] as usize;
            if graph.nodes.get(n).is_some_and(|n| n.kind == NodeKind::End) {
                put_back_one(mask, frame, graph, e, end, n);
            }
        }
    }
}

fn put_back_one(mask: &BitImage, frame: Option<&Frame>, graph: &mut Graph, e: usize, end: usize, n: usize) {
    let half = graph.edges[e].half_thickness_px.max(0.5);
    let chain = graph.edge_points(&graph.edges[e]);
    let Some((origin, direction)) = line_at_end(chain, end == 1, half) else { return };
    let tip = graph.nodes[n].skeleton_px;
    let along = (tip[0] - origin[0]) * direction[0] + (tip[1] - origin[1]) * direction[1];
    let tip_on_line = [origin[0] + along * direction[0], origin[1] + along * direction[1]];

    let (mut sum, mut seen) = (0.0, 0);
    let reach = 1.6 * half + 3.0;
    for offset in [-RAY_OFFSET, 0.0, RAY_OFFSET] {
        let from =
            [tip_on_line[0] - offset * half * direction[1], tip_on_line[1] + offset * half * direction[0]];
        let Some(border) = border_in_mask(mask, from, direction, reach) else { continue };
        sum += frame.map_or(border, |f| border_in_grey(f, from, direction, border, half));
        seen += 1;
    }
    let node = &mut graph.nodes[n];
    node.end_visible = seen >= 2;
    let distance = if node.end_visible { sum / seen as f32 } else { half };
    node.position_px = [tip_on_line[0] + distance * direction[0], tip_on_line[1] + distance * direction[1]];
}

/// A point on the line's end and the direction outwards, from the pixels half a thickness to two and a half
/// thicknesses from the end: nearer ones bend into a corner of the part.
fn line_at_end(chain: &[[u16; 2]], at_last: bool, half: f32) -> Option<([f32; 2], [f32; 2])> {
    let skip = (half as usize).min(chain.len() / 4);
    let take = ((4.0 * half) as usize).max(6).min(chain.len() - skip);
    let pick = |i: usize| {
        let p = if at_last { chain[chain.len() - 1 - i] } else { chain[i] };
        [p[0] as f32, p[1] as f32]
    };
    if take < 2 {
        return None;
    }
    let mean = |range: std::ops::Range<usize>| {
        let n = range.len() as f32;
        let sum = range.map(pick).fold([0.0, 0.0], |s, p| [s[0] + p[0], s[1] + p[1]]);
        [sum[0] / n, sum[1] / n]
    };
    let (near, far) = (mean(skip..skip + take / 2), mean(skip + take / 2..skip + take));
    let (dx, dy) = (near[0] - far[0], near[1] - far[1]);
    let length = dx.hypot(dy);
    (length > 0.1).then(|| (near, [dx / length, dy / length]))
}

/// Distance from `from` to the mask's border; `None` where it does not end within `reach_px` or the picture ends
/// first.
fn border_in_mask(mask: &BitImage, from: [f32; 2], direction: [f32; 2], reach_px: f32) -> Option<f32> {
    const STEP: f32 = 0.25;
    let mut distance = 0.0;
    while distance <= reach_px {
        let (x, y) = (from[0] + distance * direction[0], from[1] + distance * direction[1]);
        let (x, y) = (x.round() as i32, y.round() as i32);
        if x < 0 || y < 0 || x >= mask.width() as i32 || y >= mask.height() as i32 {
            return None;
        }
        if !mask.get(x, y) {
            return Some(distance - STEP / 2.0);
        }
        distance += STEP;
    }
    None
}

/// The mask's border refined: where grey values cross half way between the part and what lies behind its end.
fn border_in_grey(frame: &Frame, from: [f32; 2], direction: [f32; 2], border: f32, half: f32) -> f32 {
    let at =
        |distance: f32| grey_at(frame, from[0] + distance * direction[0], from[1] + distance * direction[1]);
    let depth = half.clamp(2.0, 4.0);
    let (Some(inside), Some(outside)) = (
        mean_of([at(border - depth), at(border - depth - 0.5), at(border - depth - 1.0)]),
        mean_of([at(border + 2.5), at(border + 3.0), at(border + 3.5)]),
    ) else {
        return border;
    };
    if (inside - outside).abs() < CONTRAST_MIN {
        return border;
    }
    let level = (inside + outside) / 2.0;
    let share = |v: f32| (v - level) / (inside - level);
    let (mut before, mut distance) = (None::<f32>, border - SHIFT_MAX_PX);
    while distance <= border + SHIFT_MAX_PX {
        let Some(now) = at(distance).map(share) else { return border };
        if let Some(before) = before.filter(|&b| b > 0.0 && now <= 0.0) {
            return distance - 0.5 * (-now) / (before - now);
        }
        before = Some(now);
        distance += 0.5;
    }
    border
}

fn mean_of(values: [Option<f32>; 3]) -> Option<f32> {
    let [a, b, c] = values;
    Some((a? + b? + c?) / 3.0)
}

/// BT.601 luma between pixels, bilinear; `None` at the picture's rim and beyond.
fn grey_at(frame: &Frame, x: f32, y: f32) -> Option<f32> {
    if !(x >= 0.0 && y >= 0.0 && x < (frame.width - 1) as f32 && y < (frame.height - 1) as f32) {
        return None;
    }
    let (u, v) = (x as usize, y as usize);
    let (a, b) = (x - u as f32, y - v as f32);
    let upper = luma(frame, u, v)? * (1.0 - a) + luma(frame, u + 1, v)? * a;
    let lower = luma(frame, u, v + 1)? * (1.0 - a) + luma(frame, u + 1, v + 1)? * a;
    Some(upper * (1.0 - b) + lower * b)
}

fn luma(frame: &Frame, x: usize, y: usize) -> Option<f32> {
    let row = y * frame.stride_bytes;
    let bytes = &frame.bytes;
    let rgb = |r: u8, g: u8, b: u8| 0.299 * r as f32 + 0.587 * g as f32 + 0.114 * b as f32;
    match frame.format {
        PixelFormat::Rgb => bytes.get(row + 3 * x..row + 3 * x + 3).map(|p| rgb(p[0], p[1], p[2])),
        PixelFormat::Bgr => bytes.get(row + 3 * x..row + 3 * x + 3).map(|p| rgb(p[2], p[1], p[0])),
        PixelFormat::Grey | PixelFormat::Nv12 => bytes.get(row + x).map(|&v| v as f32),
        PixelFormat::Yuyv => bytes.get(row + 2 * x).map(|&v| v as f32),
        PixelFormat::Mjpeg => None,
    }
}
