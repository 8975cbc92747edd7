//! Local thickness, measured in the mask.

use super::{Graph, NONE};
use crate::vision::bits::BitImage;

/// Sections an edge.
const SECTIONS: usize = 7;
/// Wire so many times as thick or as thin is another; and by what share of its thickness that of a wire varies.
const ANOTHER_WIRE: f32 = 1.5;
const EVEN: f32 = 0.2;
/// Longest run that is followed, in pixels each way.
const RUN_MAX: i32 = 128;

/// Object pixels in a row through (x, y), both ways along (dx, dy), up to `RUN_MAX` each way.
pub(super) fn run(mask: &BitImage, x: i32, y: i32, dx: i32, dy: i32) -> i32 {
    run_up_to(mask, [x, y], [dx, dy], RUN_MAX)
}

fn run_up_to(mask: &BitImage, [x, y]: [i32; 2], [dx, dy]: [i32; 2], run_max: i32) -> i32 {
    let one_way = |sign: i32| {
        (1..run_max).find(|i| !mask.get(x + sign * i * dx, y + sign * i * dy)).unwrap_or(run_max) - 1
    };
    if !mask.get(x, y) { 0 } else { 1 + one_way(1) + one_way(-1) }
}

/// The same along the column.
fn run_in_column(mask: &BitImage, [x, y]: [u16; 2]) -> i32 {
    let (x, y) = (x as usize, y as usize);
    let strip = mask.strip(x / 64);
    let object = |word: &&u64| **word >> (x % 64) & 1 == 1;
    let up = strip[..y].iter().rev().take(RUN_MAX as usize - 1).take_while(object).count();
    let here = strip[y..].iter().take(RUN_MAX as usize).take_while(object).count();
    if here == 0 { 0 } else { (up + here) as i32 }
}

/// The same along the row.
fn run_in_row(mask: &BitImage, [x, y]: [u16; 2]) -> i32 {
    let (x, y) = (x as usize, y as usize);
    let word = |s: usize| mask.strip(s)[y];
    let (s, bit) = (x / 64, x as u32 % 64);
    let mut right = (word(s) >> bit).trailing_ones();
    if right == 0 {
        return 0;
    }
    let mut next = s + 1;
    while (bit + right).is_multiple_of(64) && next < mask.strips() && right < RUN_MAX as u32 {
        let more = word(next).trailing_ones();
        right += more;
        next += 1;
        if more < 64 {
            break;
        }
    }
    let mut left = (word(s) << (63 - bit)).leading_ones() - 1;
    let mut next = s;
    while left >= bit && (left - bit).is_multiple_of(64) && next > 0 && left < RUN_MAX as u32 {
        next -= 1;
        let more = word(next).leading_ones();
        left += more;
        if more < 64 {
            break;
        }
    }
    (left.min(RUN_MAX as u32 - 1) + right.min(RUN_MAX as u32)) as i32
}

/// Thickness without regard to a direction: the shortest of the runs through a pixel along rows, columns and
/// diagonals, in pixels; up to 8 % too much.
pub fn thickness_around(mask: &BitImage, pixel: [u16; 2]) -> f32 {
    let straight = run_in_row(mask, pixel).min(run_in_column(mask, pixel));
    // Diagonals matter only where they are shorter.
    let run_max = straight.min(RUN_MAX);
    let pixel = pixel.map(i32::from);
    let slanted = run_up_to(mask, pixel, [1, 1], run_max).min(run_up_to(mask, pixel, [1, -1], run_max));
    (straight as f32).min(slanted as f32 * std::f32::consts::SQRT_2)
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

/// Median of sections across a chain. `None` for chains of less than five pixels.
fn median_thickness(mask: &BitImage, chain: &[[u16; 2]]) -> Option<f32> {
    if chain.len() < 5 {
        return None;
    }
    // From one eighth to seven eighths: sections at the ends would run into the neighbours there.
    let mut sections: [f32; SECTIONS] = std::array::from_fn(|i| {
        thickness_at(mask, chain, (chain.len() - 1) * (2 * i + 2) / (2 * SECTIONS + 2))
    });
    sections.sort_unstable_by(f32::total_cmp);
    Some(sections[SECTIONS / 2])
}

/// The section across a chain at one of its pixels: the run along the row or the column, whichever cuts the line more squarely,
/// times the cosine that is left.
#[inline(always)]
fn thickness_at(mask: &BitImage, chain: &[[u16; 2]], at: usize) -> f32 {
    let reach = 6.min(at).min(chain.len() - 1 - at).max(1);
    let (a, b) = (chain[at.saturating_sub(reach)], chain[(at + reach).min(chain.len() - 1)]);
    let (dx, dy) = (b[0] as f32 - a[0] as f32, b[1] as f32 - a[1] as f32);
    let length = (dx * dx + dy * dy).sqrt().max(1.0);
    if dx.abs() >= dy.abs() {
        run_in_column(mask, chain[at]) as f32 * dx.abs() / length
    } else {
        run_in_row(mask, chain[at]) as f32 * dy.abs() / length
    }
}

/// Half the thickness of wire at one end of a chain of this half thickness as a whole: of another wire, where a thicker and a thinner
/// one touch end to end.
#[inline(always)]
pub(super) fn half_thickness_at_end(mask: &BitImage, chain: &[[u16; 2]], at_last: bool, half: f32) -> f32 {
    let mut sections = [0.0f32; 3];
    for (k, section) in sections.iter_mut().enumerate() {
        let from_end = (2.0 * half) as usize * (k + 1);
        if from_end >= chain.len() {
            return half;
        }
        *section = thickness_at(mask, chain, if at_last { chain.len() - 1 - from_end } else { from_end });
    }
    sections.sort_unstable_by(f32::total_cmp);
    let [least, thickness, most] = sections;
    // Of thin wire runs differ by a pixel.
    let is_even = most - least <= (EVEN * thickness).max(1.0);
    let as_usual = (1.0 / ANOTHER_WIRE..ANOTHER_WIRE).contains(&(thickness / (2.0 * half)));
    if is_even && !as_usual { (thickness / 2.0).max(0.5) } else { half }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    #[test]
    fn an_end_has_the_thickness_of_its_own_wire() {
        // From left to right 15, then 5 pixels thick.
        let mut mask = BitImage::new(200, 60);
        for (x, y) in (10..190).flat_map(|x| (0..60).map(move |y| (x, y))) {
            let half: i32 = if x < 80 { 7 } else { 2 };
            mask.set(x, y, (y as i32 - 30).abs() <= half);
        }
        let chain: Vec<[u16; 2]> = (17..188).map(|x| [x, 30]).collect();
        let half = median_thickness(&mask, &chain).unwrap() / 2.0;
        assert_eq!(half, 2.5);
        let at_end = |mask: &BitImage, at_last| half_thickness_at_end(mask, &chain, at_last, half);
        assert_eq!([at_end(&mask, false), at_end(&mask, true)], [7.5, 2.5]);
        // What touches it here and there is no thicker wire.
        for (x, y) in (20..24).flat_map(|x| (38..50).map(move |y| (x, y))) {
            mask.set(x, y, true);
        }
        assert_eq!(at_end(&mask, false), 2.5);
    }

    #[test]
    fn runs_along_rows_and_columns_equal_the_slow_ones() {
        let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(9);
        for (width, height, share) in
            [(1, 1, 1.0), (200, 40, 1.0), (400, 300, 1.0), (333, 60, 0.97), (64, 9, 0.5)]
        {
            let mut mask = BitImage::new(width, height);
            for i in 0..width * height {
                mask.set(i % width, i / width, random.random_bool(share));
            }
            for _ in 0..300 {
                let (x, y) = (random.random_range(0..width), random.random_range(0..height));
                let at = [x as u16, y as u16];
                assert_eq!(run_in_row(&mask, at), run(&mask, x as i32, y as i32, 1, 0), "row at {at:?}");
                assert_eq!(
                    run_in_column(&mask, at),
                    run(&mask, x as i32, y as i32, 0, 1),
                    "column at {at:?}"
                );
            }
        }
    }
}
