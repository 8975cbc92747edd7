//! Parts that are less of the picture than the samples of the grid can tell: the last one in a bin, a short pin.
//!
//! Looked for where the samples show none, in every second row. They must stand out from most of the background, not only from
//! what is darker (for dark parts lighter) around them: a bin's rim beside its dark wall is as narrow as they are.

use super::{BRIGHTEST_MAX, CONTRAST_MIN, CONTRAST_STEPS, Contrasts, Grid, OFFSET, factor, level_at};

/// So many pixels at least must stand out, which is less than any part has that can be recognised.
const PART_PX_MIN: usize = 60;
/// Rows from one to the next that is looked at.
const ROWS: usize = 2;

/// Thresholds for such parts, and the background that they are for in place of the grid's; `None` where there are none, and
/// the background stays.
#[inline(always)]
pub(super) fn find<const DARK: bool>(
    grid: &mut Grid,
    row: &mut [u8],
    luma_row: impl Fn(usize, &mut [u8]),
) -> Option<Contrasts> {
    let least = grid.least_contrast();
    let usual = grid.usual_background();
    let behind = |background: u8| if DARK { background.min(usual) } else { background.max(usual) };
    let standing_out = CONTRAST_MIN.max(least);
    let limit = factor::<DARK>(standing_out);
    // How many pixels have which contrast.
    let mut counts = [0usize; 256];
    for y in (0..grid.height).step_by(ROWS) {
        luma_row(y, row);
        let cells = (y / grid.step).min(grid.rows - 1);
        let backgrounds = &grid.background[cells * grid.pitch..][..grid.columns];
        let inside = &grid.region[cells * grid.columns..][..grid.columns];
        let pixels = row[..grid.width].chunks(grid.step);
        for (pixels, (&background, &inside)) in pixels.zip(backgrounds.iter().zip(inside)) {
            let background = behind(background);
            let level = level_at::<DARK>(background, limit);
            let beyond = |pixel: u8| if DARK { pixel < level } else { pixel > level };
            // Most cells have none, which is told for all their pixels at once.
            if inside == 0 || !pixels.iter().fold(false, |any, &pixel| any | beyond(pixel)) {
                continue;
            }
            for &pixel in pixels.iter().filter(|pixel| beyond(**pixel)) {
                let [pixel, background] = [pixel, background].map(|v| f32::from(v) + f32::from(OFFSET));
                let contrast = if DARK { background / pixel } else { pixel / background };
                counts[(contrast * CONTRAST_STEPS).min(255.0) as usize] += 1;
            }
        }
    }
    let all: usize = counts.iter().sum();
    let wanted = PART_PX_MIN / ROWS;
    if all < wanted {
        return None;
    }
    // The contrast that so many have or more.
    let reached_by = |many: usize| {
        let mut above = 0;
        let found = (0..counts.len()).rev().find(|&contrast| {
            above += counts[contrast];
            above >= many
        });
        found.map_or(0.0, |contrast| contrast as f32 / CONTRAST_STEPS)
    };
    let parts = reached_by(wanted).min(1.0 + BRIGHTEST_MAX * (reached_by(all.div_ceil(2)) - 1.0));
    for background in &mut grid.background {
        *background = behind(*background);
    }
    Some(Contrasts::between::<DARK>(parts, least))
}
