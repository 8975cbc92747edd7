//! Local thickness, measured in the mask.

use super::{Graph, NONE};
use crate::vision::bits::BitImage;

/// Sections an edge.
const SECTIONS: usize = 7;
/// Longest run that is followed, in pixels each way.
const RUN_MAX: i32 = 128;

/// Object pixels in a row through (x, y), both ways along (dx, dy).
pub(super) fn run(mask: &BitImage, x: i32, y: i32, dx: i32, dy: i32) -> i32 {
    let one_way = |sign: i32| {
        (1..RUN_MAX).find(|i| !mask.get(x + sign * i * dx, y + sign * i * dy)).unwrap_or(RUN_MAX) - 1
    };
    if !mask.get(x, y) { 0 } else { 1 + one_way(1) + one_way(-1) }
}

/// Thickness without regard to a direction: the shortest of the runs through a pixel along rows, columns and
/// diagonals, in pixels; up to 8 % too much.
pub fn thickness_around(mask: &BitImage, [x, y]: [u16; 2]) -> f32 {
    let (x, y) = (x as i32, y as i32);
    let straight = run(mask, x, y, 1, 0).min(run(mask, x, y, 0, 1)) as f32;
    let slanted = run(mask, x, y, 1, 1).min(run(mask, x, y, 1, -1)) as f32;
    straight.min(slanted * std::f32::consts::SQRT_2)
}

/// Fills in the half thickness of edges and nodes.
pub(super) fn measure(mask: &BitImage, graph: &mut Graph) {
    let Graph { nodes, edges, points } = graph;
    for edge in edges.iter_mut() {
        let chain = &points[edge.points.start as usize..edge.points.end as usize];
        if let Some(thickness) = median_thickness(mask, chain) {
            edge.half_thickness_px = thickness / 2.0;
        }
        for n in edge.nodes.into_iter().filter(|&n| n != NONE) {
            let node = &mut nodes[n as usize];
            node.half_thickness_px = node.half_thickness_px.max(edge.half_thickness_px);
        }
    }
}

/// Median of sections across a chain: the run along the row or the column, whichever cuts the line more squarely,
/// times the cosine that is left. `None` for chains of less than five pixels.
fn median_thickness(mask: &BitImage, chain: &[[u16; 2]]) -> Option<f32> {
    if chain.len() < 5 {
        return None;
    }
    let mut sections = [0.0f32; SECTIONS];
    for (i, section) in sections.iter_mut().enumerate() {
        // From one eighth to seven eighths: sections at the ends would run into the neighbours there.
        let at = (chain.len() - 1) * (2 * i + 2) / (2 * SECTIONS + 2);
        let reach = 6.min(at).min(chain.len() - 1 - at).max(1);
        let (a, b) = (chain[at.saturating_sub(reach)], chain[(at + reach).min(chain.len() - 1)]);
        let (dx, dy) = (b[0] as f32 - a[0] as f32, b[1] as f32 - a[1] as f32);
        let (x, y) = (chain[at][0] as i32, chain[at][1] as i32);
        let length = dx.hypot(dy).max(1.0);
        *section = if dx.abs() >= dy.abs() {
            run(mask, x, y, 0, 1) as f32 * dx.abs() / length
        } else {
            run(mask, x, y, 1, 0) as f32 * dy.abs() / length
        };
    }
    sections.sort_unstable_by(f32::total_cmp);
    Some(sections[SECTIONS / 2])
}
