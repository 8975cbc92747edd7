//! What of the background is none: dense parts that the opening took for floor, and shadows on a floor that is nearly as bright as
//! the parts.

use super::super::grid::{self, MARGIN};
use super::{Grid, OFFSET, factor, level_at};

/// Contrast from which on a background against the median one may be dense parts, and contrast that their samples then
/// have among each other at least; a brighter table or glare is more even. Where it is floor beside a single part after all,
/// the floor around is as bright, and nothing is lost.
const DENSE_MIN: f32 = 1.5;
const UNEVEN_MIN: f32 = 1.8;
/// How much brighter floor may be than most of the background.
const FLOOR_SPREAD: f32 = 1.2;

/// Where the floor in the light would be object against its shadows, fills shadows that are narrow; says whether it is so
/// anywhere. `parts`: the least contrast of parts.
#[inline(always)]
pub(super) fn light_floor<const DARK: bool>(grid: &mut Grid, parts: f32) -> bool {
    if DARK {
        return false;
    }
    let (usual, offset) = (f32::from(grid.usual), f32::from(OFFSET));
    let shadow_max = ((usual + offset) * FLOOR_SPREAD / parts - offset).max(0.0) as u8;
    let mut is_anywhere = false;
    for (row, region) in grid.background.chunks(grid.pitch).zip(grid.region.chunks(grid.columns)) {
        let is_shadow = |(&b, &inside): (&u8, &u8)| b < shadow_max && inside != 0;
        is_anywhere |= row.iter().zip(region).fold(false, |any, sample| any | is_shadow(sample));
    }
    if !is_anywhere {
        return false;
    }
    fill_narrow::<DARK>(grid);
    for (background, &opened) in grid.background.iter_mut().zip(&grid.strong) {
        *background = if opened < shadow_max { *background } else { opened };
    }
    true
}

/// Fills what of the background is narrow and darker (for dark parts lighter) than what is to both sides of it.
#[inline(always)]
pub(super) fn fill_narrow<const DARK: bool>(grid: &mut Grid) {
    let (rows, columns, pitch) = (grid.rows, grid.columns, grid.pitch);
    grid.strong.copy_from_slice(&grid.background);
    grid::pad(&grid.strong, &mut grid.background, rows, columns, pitch);
    grid::slide_back::<DARK>(&mut grid.background, pitch);
    grid::slide::<DARK>(&mut grid.background, pitch);
}

/// Takes the background of samples that lie among dense parts from those around.
#[inline(always)]
pub(super) fn see_through<const DARK: bool>(grid: &mut Grid) {
    if mark_unknown::<DARK>(grid) {
        fill_inwards::<DARK>(grid);
    }
}

/// Marks in `contrast` the samples whose background may be that of parts; says whether there may be any.
#[inline(always)]
fn mark_unknown<const DARK: bool>(grid: &mut Grid) -> bool {
    let (rows, columns, pitch) = (grid.rows, grid.columns, grid.pitch);
    if grid.inside == 0 {
        return false;
    }
    let median = grid.usual_background();
    grid.usual = median;
    let beyond = |level: u8, limit: u8| if DARK { level < limit } else { level > limit };
    let like_parts = level_at::<DARK>(median, factor::<DARK>(DENSE_MIN));
    // All are looked at, many at once, which is faster than to stop at the first.
    let like_parts_anywhere = grid
        .contrast
        .iter()
        .zip(&grid.region)
        .fold(0, |found, (&b, &inside)| found | if beyond(b, like_parts) { inside } else { 0 });
    if like_parts_anywhere == 0 {
        return false;
    }
    // The brightest (or darkest) samples of the squares.
    grid.strong.fill(if DARK { 255 } else { 0 });
    for y in 0..rows {
        let out = &mut grid.strong[(y + MARGIN / 2) * pitch + MARGIN / 2..][..columns];
        out.copy_from_slice(&grid.level[y * pitch..][..columns]);
    }
    grid::slide_back::<DARK>(&mut grid.strong, pitch);
    let uneven = factor::<DARK>(UNEVEN_MIN);
    for y in 0..rows {
        for x in 0..columns {
            let (background, most) = (grid.background[y * pitch + x], grid.strong[y * pitch + x]);
            let dense = beyond(background, like_parts) && beyond(most, level_at::<DARK>(background, uneven));
            grid.contrast[y * columns + x] = if dense { UNKNOWN } else { KNOWN };
        }
    }
    true
}

/// Gives samples marked as unknown the background of known neighbours, from the border inwards.
#[inline(always)]
fn fill_inwards<const DARK: bool>(grid: &mut Grid) {
    let (rows, columns, pitch) = (grid.rows, grid.columns, grid.pitch);
    let mut changed = true;
    while changed {
        changed = false;
        for (y, x) in (0..rows).flat_map(|y| (0..columns).map(move |x| (y, x))) {
            if grid.contrast[y * columns + x] != UNKNOWN {
                continue;
            }
            let around = (y.saturating_sub(1)..(y + 2).min(rows))
                .flat_map(|v| (x.saturating_sub(1)..(x + 2).min(columns)).map(move |u| (u, v)))
                .filter(|&(u, v)| grid.contrast[v * columns + u] == KNOWN)
                .map(|(u, v)| grid.background[v * pitch + u]);
            if let Some(floor) = if DARK { around.max() } else { around.min() } {
                grid.background[y * pitch + x] = floor;
                grid.contrast[y * columns + x] = NEWS;
                changed = true;
            }
        }
        grid.contrast.iter_mut().filter(|c| **c == NEWS).for_each(|c| *c = KNOWN);
    }
}

/// What is known of a sample's background.
const KNOWN: u8 = 0;
const UNKNOWN: u8 = 1;
/// Known since this round.
const NEWS: u8 = 2;
