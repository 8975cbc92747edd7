//! A threshold found in the picture, local where the light has a gradient.
//!
//! Luma is sampled on a grid of at most 80 columns. The grey opening of the samples (erosion, then dilation by a
//! square; for dark parts the closing) is the background without what is thinner than the square: it follows
//! gradients, glare and the shadows of the bin's walls. What counts is then the contrast `(luma + 16) /
//! (background + 16)`, which a change of the light leaves alone; the 16 keeps noise in the dark small.
//!
//! Where parts lie so dense that the square sees no floor, what the opening gives is parts: brighter than most of the
//! background, and uneven. There the background is taken from around. Where parts throw shadows on a floor that is not much
//! darker than they are, the opening gives shadow, against which the floor in the light would be object. There the background
//! is closed.
//!
//! From the histogram of the contrasts inside the region come the spread of the background (median and 16th
//! percentile) and the contrast of the parts (its upper end). Clear is twice as bright; less may be a bin's rim beside its
//! dark wall. Where nothing is clear the background is closed (for dark parts opened), which takes the shadow of such a wall
//! out of it, and so the contrast from the rim: then less will do, of bright parts on a light floor or dark ones on a grey
//! one. Before that, pixels that are clear against most of the background are looked for between the samples: the last
//! part in a bin may be less of the picture than they can tell. Without any of these nothing is object.
//! Else the threshold lies a third of the way from background to parts, and a quarter of the way near samples that
//! are beyond half way: so dim ends of a part are kept while the bin's rim, dim all along, is not. Of dark parts, whose
//! shadows are dark, too, it lies half way, a little less near such samples. Between the samples thresholds are interpolated.

mod background;
mod lone;

use super::grid::{self, MARGIN};
use crate::vision::bits::BitImage;
use background::{fill_narrow, light_floor, see_through};
use std::ops::Range;

/// Greatest number of columns of the grid.
const COLUMNS_MAX: usize = 80;
/// Greatest number of rows of the grid.
const ROWS_MAX: usize = 60;
/// Added to luma and background before they are compared, in grey levels: noise and stray light of a webcam.
const OFFSET: u16 = 16;
/// Contrasts are counted in this many steps to 1.
const CONTRAST_STEPS: f32 = 32.0;
/// Least contrast of parts. A bin's rim beside its dark wall reaches 1.9.
const CONTRAST_MIN: f32 = 2.0;
/// Least contrast of parts against a background without the shadows of walls, and least difference in grey levels. Bright parts
/// in the dark, where most of the background is below 20, need differ by less: by so many times that, but no less than noise.
const FAINT_MIN: f32 = 1.3;
const FAINT_LEVELS_MIN: f32 = 30.0;
const FAINT_LEVELS_PER_LEVEL: f32 = 1.5;
const NOISE_LEVELS: f32 = 12.0;
/// The contrast of the parts is what one sample in so many reaches; a rod is at least as much of the picture.
const SAMPLES_PER_PART: usize = 800;
/// That contrast is at most so many times the median one of what stands out, both less 1: parts above the shadow of others
/// are no brighter than on bare floor.
const BRIGHTEST_MAX: f32 = 1.8;
/// The threshold is at least so many standard deviations above the median contrast of the background.
const SIGMAS: f32 = 6.0;
/// Least standard deviation of the background's contrast: half of a step.
const SIGMA_MIN: f32 = 0.03;
/// Of the way from the background's light to that of the parts: threshold near strong samples, elsewhere, and what is strong. Between
/// dark parts and a light floor lie their shadows; beyond half way a bright line along dark wire would be lost.
const WAYS: [f32; 3] = [0.25, 1.0 / 3.0, 0.5];
const DARK_WAYS: [f32; 3] = [0.4, 0.5, 2.0 / 3.0];

/// Memory for finding thresholds.
#[derive(Clone, Debug)]
pub(super) struct Auto {
    grid: Grid,
    /// Luma of a row, later thresholds of a row: a value a pixel.
    row: Vec<u8>,
    /// The other end of the range.
    end: Vec<u8>,
}

/// What is known of every sample. All arrays have `pitch` columns, and a margin that the sliding windows need.
#[derive(Clone, Debug)]
struct Grid {
    /// Pixels of the picture.
    width: usize,
    height: usize,
    /// Pixels from one sample to the next; even.
    step: usize,
    columns: usize,
    rows: usize,
    pitch: usize,
    /// Luma, later thresholds.
    level: Vec<u8>,
    background: Vec<u8>,
    strong: Vec<u8>,
    /// Contrasts without margins; 0 outside the region.
    contrast: Vec<u8>,
    /// 255 inside the region, 0 outside; as `contrast`.
    region: Vec<u8>,
    /// Samples inside the region.
    inside: usize,
    /// The median of the background inside the region, as it was opened.
    usual: u8,
    /// Thresholds between two rows, times 4, the outermost ones twice.
    between: Vec<u16>,
    /// Thresholds of pixels left and right of every sample.
    halves: Vec<u8>,
}

/// Where the thresholds are, as contrasts.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Contrasts {
    near: f32,
    elsewhere: f32,
    strong: f32,
}

impl Contrasts {
    /// Between the background and parts of this contrast, and no less than the least.
    #[inline(always)]
    fn between<const DARK: bool>(parts: f32, least: f32) -> Self {
        let [near, elsewhere, strong] = if DARK { DARK_WAYS } else { WAYS }.map(|way| {
            let contrast =
                if DARK { 1.0 / (1.0 - way * (1.0 - 1.0 / parts)) } else { 1.0 + way * (parts - 1.0) };
            contrast.max(least)
        });
        Self { near, elsewhere, strong }
    }
}

impl Auto {
    /// Memory for pictures of this size; only samples in `region` count.
    pub(super) fn new(width: usize, height: usize, region: Option<&BitImage>) -> Self {
        let padded = width.next_multiple_of(64);
        Self { grid: Grid::new(width, height, region), row: vec![0; padded], end: vec![255; padded] }
    }
}

/// Brighter (or, where `dark`, darker) than the background around to `bits`. `luma_row` gives the luma of a row,
/// `luma_between` tests rows against the two ends of a range.
#[inline(always)]
pub(super) fn run(
    auto: &mut Auto,
    dark: bool,
    bits: &mut BitImage,
    luma_row: impl Fn(usize, &mut [u8]),
    luma_between: impl Fn(Range<usize>, &[u8], &[u8], &mut BitImage),
) {
    let Auto { grid, row, end } = auto;
    for y in 0..grid.rows {
        luma_row((y * grid.step + grid.step / 2).min(grid.height - 1), row);
        grid.sample(y, row);
    }
    let is_found = match dark {
        true => thresholds_for::<true>(grid, row, &luma_row),
        false => thresholds_for::<false>(grid, row, &luma_row),
    };
    if !is_found {
        bits.clear();
        return;
    }
    let half = grid.step / 2;
    for band in 0..2 * grid.rows {
        let last = if band + 1 == 2 * grid.rows { bits.height() } else { (band + 1) * half };
        let ys = (band * half).min(bits.height())..last.min(bits.height());
        grid.spread(band, row);
        // Where nothing can be that bright (or dark), what the camera clips is not.
        for (end, &threshold) in end.iter_mut().zip(&*row) {
            *end = if dark { u8::from(threshold == 0) } else { 255 - u8::from(threshold == 255) };
        }
        let (lo, hi) = if dark { (&*end, &*row) } else { (&*row, &*end) };
        luma_between(ys, lo, hi, bits);
    }
}

impl Grid {
    fn new(width: usize, height: usize, region: Option<&BitImage>) -> Self {
        let step = width.div_ceil(COLUMNS_MAX).max(height.div_ceil(ROWS_MAX)).next_multiple_of(2);
        // A picture smaller than a step has one sample, of its border.
        let samples = |pixels: usize| (pixels.max(step) - 1 - step / 2) / step + 1;
        let (columns, rows) = (samples(width), samples(height));
        let pitch = columns + 2 * MARGIN;
        let mut region_of_samples = vec![0; columns * rows];
        for (i, sample) in region_of_samples.iter_mut().enumerate() {
            let (x, y) = (i % columns * step + step / 2, i / columns * step + step / 2);
            let (x, y) = (x.min(width - 1), y.min(height - 1));
            if region.is_none_or(|r| r.get(x as i32, y as i32)) {
                *sample = 255;
            }
        }
        let zeros = vec![0; (pitch * (rows + 2 * MARGIN)).next_multiple_of(64) + 64];
        Self {
            width,
            height,
            step,
            columns,
            rows,
            pitch,
            level: zeros.clone(),
            background: zeros.clone(),
            strong: zeros,
            contrast: vec![0; columns * rows],
            inside: region_of_samples.iter().filter(|&&sample| sample != 0).count(),
            region: region_of_samples,
            usual: 0,
            between: vec![0; columns + 2],
            halves: vec![0; 2 * columns],
        }
    }

    /// Takes every `step`th value of a row of luma.
    #[inline(always)]
    fn sample(&mut self, row: usize, luma: &[u8]) {
        let out = &mut self.level[row * self.pitch..][..self.columns];
        // A picture narrower than half a step has its border's.
        let first = (self.step / 2).min(self.width - 1);
        if self.step == 8 && first == 4 {
            for (out, eight) in out.iter_mut().zip(luma.as_chunks::<8>().0) {
                *out = eight[4];
            }
        } else {
            for (out, &v) in out.iter_mut().zip(luma[first..].iter().step_by(self.step)) {
                *out = v;
            }
        }
    }

    /// Writes the threshold of every pixel of a band of rows half a step high. A band lies a quarter of a step
    /// from the samples' row, and so do the columns that have one threshold.
    #[inline(always)]
    fn spread(&mut self, band: usize, out: &mut [u8]) {
        let near = band / 2;
        let far = if band.is_multiple_of(2) { near.saturating_sub(1) } else { (near + 1).min(self.rows - 1) };
        let [near, far] = [near, far].map(|row| &self.level[row * self.pitch..][..self.columns]);
        for (out, (&near, &far)) in self.between[1..].iter_mut().zip(near.iter().zip(far)) {
            *out = 3 * u16::from(near) + u16::from(far);
        }
        self.between[0] = self.between[1];
        self.between[self.columns + 1] = self.between[self.columns];
        let columns = self.columns;
        let around = self.between[..columns].iter().zip(&self.between[1..=columns]).zip(&self.between[2..]);
        for (halves, ((&left, &here), &right)) in self.halves.as_chunks_mut::<2>().0.iter_mut().zip(around) {
            *halves = [((3 * here + left + 8) >> 4) as u8, ((3 * here + right + 8) >> 4) as u8];
        }
        if self.step == 8 {
            for (pixels, &threshold) in out.as_chunks_mut::<4>().0.iter_mut().zip(&self.halves) {
                // Four times the same; as a product the compiler takes many at once.
                *pixels = (u32::from(threshold) * 0x0101_0101).to_ne_bytes();
            }
        } else {
            for (pixels, &threshold) in out.chunks_mut(self.step / 2).zip(&self.halves) {
                pixels.fill(threshold);
            }
        }
        if let Some(rest) = out.get_mut(columns * self.step..) {
            rest.fill(self.halves[2 * columns - 1]);
        }
    }
}

/// Luma to thresholds, both in `level`; whether there is anything to be found.
#[inline(always)]
fn thresholds_for<const DARK: bool>(
    grid: &mut Grid,
    row: &mut [u8],
    luma_row: impl Fn(usize, &mut [u8]),
) -> bool {
    let (rows, columns, pitch) = (grid.rows, grid.columns, grid.pitch);
    grid::pad(&grid.level, &mut grid.background, rows, columns, pitch);
    grid::slide::<DARK>(&mut grid.background, pitch);
    grid::slide_back::<DARK>(&mut grid.background, pitch);
    see_through::<DARK>(grid);
    contrasts::<DARK>(grid);
    if grid.inside == 0 {
        return false;
    }
    let mut found = grid.contrasts::<DARK>(CONTRAST_MIN);
    if found.is_some_and(|found| light_floor::<DARK>(grid, found.elsewhere)) {
        contrasts::<DARK>(grid);
        found = grid.contrasts::<DARK>(CONTRAST_MIN);
    }
    let found = match found {
        Some(found) => Some(found),
        None => lone::find::<DARK>(grid, row, luma_row),
    };
    let found = match found {
        Some(found) => found,
        None => {
            // Parts that stand out less than a rim beside its wall's shadow may: without the shadow the rim does not.
            fill_narrow::<DARK>(grid);
            let least = FAINT_MIN.max(grid.faint_contrast::<DARK>());
            contrasts::<DARK>(grid);
            let Some(found) = grid.contrasts::<DARK>(least) else { return false };
            found
        }
    };
    mark_strong::<DARK>(grid, found.strong);
    grid::slide_back::<false>(&mut grid.strong, pitch);
    write_thresholds::<DARK>(grid, found);
    true
}

/// Contrast of every sample.
#[inline(always)]
fn contrasts<const DARK: bool>(grid: &mut Grid) {
    for y in 0..grid.rows {
        let at = y * grid.pitch..y * grid.pitch + grid.columns;
        let dense = y * grid.columns..(y + 1) * grid.columns;
        let samples =
            grid.level[at.clone()].iter().zip(&grid.background[at]).zip(&grid.region[dense.clone()]);
        for (out, ((&level, &background), &inside)) in grid.contrast[dense].iter_mut().zip(samples) {
            let level = f32::from(level) + f32::from(OFFSET);
            let background = f32::from(background) + f32::from(OFFSET);
            let contrast = if DARK { background / level } else { level / background };
            *out = rounded((contrast * CONTRAST_STEPS).min(255.0)) & inside;
        }
    }
}

/// A number from 0 to 255 to the nearest whole one. Beside 2^23 the last bit of an `f32` is worth 1; a cast would
/// keep the compiler from taking many at once.
#[inline(always)]
fn rounded(x: f32) -> u8 {
    (x + 8_388_608.0).to_bits() as u8
}

impl Grid {
    /// The median of the background inside the region; `contrast` becomes the background there.
    #[inline(always)]
    fn usual_background(&mut self) -> u8 {
        for y in 0..self.rows {
            let row = y * self.columns..(y + 1) * self.columns;
            let samples =
                self.background[y * self.pitch..][..self.columns].iter().zip(&self.region[row.clone()]);
            for (out, (&background, &inside)) in self.contrast[row].iter_mut().zip(samples) {
                *out = background & inside;
            }
        }
        grid::ranked(&self.contrast, self.contrast.len() - self.inside + self.inside / 2)
    }

    /// The contrast that the least difference in grey levels has on most of the background.
    #[inline(always)]
    fn faint_contrast<const DARK: bool>(&mut self) -> f32 {
        let background = f32::from(self.usual_background());
        let usual = background + f32::from(OFFSET);
        if DARK {
            usual / (usual - FAINT_LEVELS_MIN).max(1.0)
        } else {
            (usual + (FAINT_LEVELS_PER_LEVEL * background).clamp(NOISE_LEVELS, FAINT_LEVELS_MIN)) / usual
        }
    }

    /// The contrast that so many samples inside the region are below, which has some.
    #[inline(always)]
    fn contrast_at(&self, rank: usize) -> f32 {
        // All that is not a sample inside the region is 0, below every contrast.
        let outside = self.contrast.len() - self.inside;
        f32::from(grid::ranked(&self.contrast, outside + rank)) / CONTRAST_STEPS
    }

    /// The contrast beyond which is no noise of the background.
    #[inline(always)]
    fn least_contrast(&self) -> f32 {
        let median = self.contrast_at(self.inside / 2);
        median + SIGMAS * (median - self.contrast_at(self.inside * 16 / 100)).max(SIGMA_MIN)
    }

    /// Thresholds from the histogram of the contrasts inside the region, which has some samples; `None` where no parts stand
    /// out by `contrast_min`.
    #[inline(always)]
    fn contrasts<const DARK: bool>(&self, contrast_min: f32) -> Option<Contrasts> {
        let contrast = &self.contrast[..];
        let parts = self.contrast_at(self.inside - 1 - self.inside / SAMPLES_PER_PART);
        let least = self.least_contrast();
        let standing_out = contrast_min.max(least);
        if parts < standing_out {
            return None;
        }
        let dimmer = contrast.iter().filter(|&&c| f32::from(c) < standing_out * CONTRAST_STEPS).count();
        let outside = contrast.len() - self.inside;
        let usual = self.contrast_at(dimmer - outside + (contrast.len() - dimmer) / 2);
        Some(Contrasts::between::<DARK>(parts.min(1.0 + BRIGHTEST_MAX * (usual - 1.0)), least))
    }
}

/// `(background + 16) * contrast - 16`, or for dark parts divided; 8 fractional bits.
#[inline(always)]
fn level_at<const DARK: bool>(background: u8, factor: u32) -> u8 {
    let level = ((u32::from(background) + u32::from(OFFSET)) * factor) >> 8;
    level.saturating_sub(u32::from(OFFSET)).min(255) as u8
}

/// What [`level_at`] multiplies by.
#[inline(always)]
fn factor<const DARK: bool>(contrast: f32) -> u32 {
    (256.0 * if DARK { 1.0 / contrast } else { contrast }) as u32
}

/// Samples beyond a contrast to 255, all others to 0, placed so that a window slid back is centred.
#[inline(always)]
fn mark_strong<const DARK: bool>(grid: &mut Grid, contrast: f32) {
    let factor = factor::<DARK>(contrast);
    grid.strong.fill(0);
    for y in 0..grid.rows {
        let at = y * grid.pitch..y * grid.pitch + grid.columns;
        let out = &mut grid.strong[(y + MARGIN / 2) * grid.pitch + MARGIN / 2..][..grid.columns];
        let samples = grid.level[at.clone()].iter().zip(&grid.background[at]);
        for (out, (&level, &background)) in out.iter_mut().zip(samples) {
            let least = level_at::<DARK>(background, factor);
            let strong = if DARK { level < least } else { level > least };
            *out = if strong { 255 } else { 0 };
        }
    }
}

/// The first level that is object (bright parts), or the last one (dark parts).
#[inline(always)]
fn write_thresholds<const DARK: bool>(grid: &mut Grid, found: Contrasts) {
    let (near, elsewhere) = (factor::<DARK>(found.near), factor::<DARK>(found.elsewhere));
    for y in 0..grid.rows {
        let at = y * grid.pitch..y * grid.pitch + grid.columns;
        let samples = grid.background[at.clone()].iter().zip(&grid.strong[at.clone()]);
        for (out, (&background, &strong)) in grid.level[at].iter_mut().zip(samples) {
            let factor = if strong != 0 { near } else { elsewhere };
            let level = level_at::<DARK>(background, factor);
            *out = if DARK { level } else { level.saturating_add(1) };
        }
    }
}
