//! The points of ridges: pixels through which the middle of a bright line goes.
//!
//! Takes luma, mask and area; gives [`Point`]s in the order of strips and rows; owns the smoothed rows. The sums go
//! over 64 pixels or 16 at a time, in whatever registers the machine has; all levels give the same bits.

use super::Area;
use crate::frame::LumaView;
use crate::level::Level;
use crate::time::Timestamp;
use crate::vision::bits::BitImage;

#[derive(Clone, Copy, Debug)]
pub(super) struct Point {
    pub(super) at: [f32; 2],
    pub(super) along: [f32; 2],
    pub(super) taken: bool,
}

/// Widest half of the Gaussian's window, in pixels.
const REACH_MAX: usize = 12;
const TAPS_MAX: usize = 2 * REACH_MAX + 1;
/// Least standard deviation of the Gaussian in pixels: below, its samples are no Gaussian.
const SIGMA_PX_MIN: f64 = 1.0;

/// A Gaussian and its derivatives, sampled. The first derivative is antisymmetric, the others are symmetric, so that what
/// is as far to one side as to the other is multiplied together.
struct Kernels {
    reach: usize,
    taps: [[f32; TAPS_MAX]; 3],
}

impl Kernels {
    fn new(sigma: f64) -> Self {
        let reach = ((3.0 * sigma).ceil() as usize).min(REACH_MAX);
        let [mut plain, mut first, mut second] = [[0f32; TAPS_MAX]; 3];
        let weight = |t: f64| (-t * t / (2.0 * sigma * sigma)).exp();
        let offset = |k: usize| k as f64 - reach as f64;
        let sum: f64 = (0..=2 * reach).map(|k| weight(offset(k))).sum();
        for k in 0..=2 * reach {
            let t = offset(k);
            let g = weight(t) / sum;
            plain[k] = g as f32;
            // Correlated, not convolved: the sign of the first derivative is turned.
            first[k] = (g * t / (sigma * sigma)) as f32;
            second[k] = (g * (t * t / (sigma * sigma) - 1.0) / (sigma * sigma)) as f32;
        }
        // What cutting the window off leaves of a flat picture's second derivative.
        let rest = second.iter().sum::<f32>() / (2 * reach + 1) as f32;
        second[..=2 * reach].iter_mut().for_each(|t| *t -= rest);
        Self { reach, taps: [plain, first, second] }
    }
}

/// Pixels whose derivatives are summed at a time.
const GROUP: usize = 16;

/// Finds the points.
#[derive(Clone, Debug)]
pub(super) struct Finder {
    strength_min: f32,
    level: Level,
    width: usize,
    /// For each strip and tap 64 pixels of a row smoothed along x: plain, first and second derivative.
    rows: Vec<[[f32; 64]; 3]>,
    /// For each strip the first row that was not smoothed.
    smoothed: Vec<usize>,
}

/// What is looked for where.
struct Task<'a> {
    luma: LumaView<'a>,
    mask: &'a BitImage,
    area: &'a Area,
    sign: f32,
    kernels: Kernels,
    /// The Gaussian's variance.
    scale: f32,
    /// When to stop.
    end: Option<Timestamp>,
}

impl Finder {
    pub(super) fn new(strength_min: f32, width: usize, level: Level) -> Self {
        let strips = width.div_ceil(64);
        Self {
            strength_min,
            level,
            width,
            rows: vec![[[0.0; 64]; 3]; strips * TAPS_MAX],
            smoothed: vec![0; strips],
        }
    }

    /// Appends the points to `points`, as many as it has room for, until `end`. `sigma` is the Gaussian's, in pixels.
    #[expect(clippy::too_many_arguments)]
    pub(super) fn run(
        &mut self,
        luma: LumaView,
        mask: &BitImage,
        area: &Area,
        dark: bool,
        sigma: f64,
        end: Option<Timestamp>,
        points: &mut Vec<Point>,
    ) {
        let sigma = sigma.clamp(SIGMA_PX_MIN, REACH_MAX as f64 / 3.0);
        let sign = if dark { -1.0 } else { 1.0 };
        let task =
            Task { luma, mask, area, sign, kernels: Kernels::new(sigma), scale: (sigma * sigma) as f32, end };
        match self.level {
            // SAFETY: `Level::detect` and `Level::available` name only levels that the machine has.
            #[cfg(target_arch = "x86_64")]
            Level::Avx512 => unsafe { self.find_avx512(&task, points) },
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            Level::Avx2 => unsafe { self.find_avx2(&task, points) },
            _ => self.find(&task, points),
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl")]
    fn find_avx512(&mut self, task: &Task, points: &mut Vec<Point>) {
        self.find(task, points);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn find_avx2(&mut self, task: &Task, points: &mut Vec<Point>) {
        self.find(task, points);
    }

    #[inline(always)]
    fn find(&mut self, task: &Task, points: &mut Vec<Point>) {
        let (reach, height) = (task.kernels.reach, task.luma.height());
        self.smoothed.fill(0);
        for y in 0..height {
            if task.end.is_some_and(Timestamp::is_past) {
                return;
            }
            for strip in 0..self.smoothed.len() {
                let word = task.mask.strip(strip)[y] & task.area.row(strip, y);
                if word == 0 {
                    continue;
                }
                // Rows up to y + reach are needed; those from y - reach on may still be there.
                let last = (y + reach).min(height - 1);
                for row in self.smoothed[strip].max(y.saturating_sub(reach))..=last {
                    self.smooth(task, strip, row);
                }
                self.smoothed[strip] = last + 1;
                for first in (0..64).step_by(GROUP) {
                    let pixels = word >> first & ((1 << GROUP) - 1);
                    if pixels != 0 {
                        self.look(task, 64 * strip + first, y, pixels, points);
                    }
                }
            }
        }
    }

    /// Smooths 64 pixels of a row along x.
    #[inline(always)]
    fn smooth(&mut self, task: &Task, strip: usize, y: usize) {
        let Kernels { reach, taps } = &task.kernels;
        let from = (64 * strip).saturating_sub(*reach);
        let to = (64 * strip + 64 + reach).min(self.width);
        let mut bytes = [0; 64 + 2 * REACH_MAX];
        let bytes = &mut bytes[..to - from];
        task.luma.read_line(from, y, false, bytes);
        // Beyond the picture its border goes on.
        let mut padded = [0.0; 64 + 2 * REACH_MAX];
        let before = reach - (64 * strip - from);
        padded[..before].fill(task.sign * f32::from(bytes[0]));
        padded[before + bytes.len()..].fill(task.sign * f32::from(bytes[bytes.len() - 1]));
        for (p, b) in padded[before..].iter_mut().zip(bytes) {
            *p = task.sign * f32::from(*b);
        }
        let out = &mut self.rows[strip * TAPS_MAX + y % TAPS_MAX];
        for x in (0..64).step_by(GROUP) {
            let at = |k: usize| -> &[f32; GROUP] {
                padded[x + k..].first_chunk().expect("64 pixels after every tap")
            };
            let middle = at(*reach);
            let [mut plain, mut first, mut second] = [[0f32; GROUP]; 3];
            for i in 0..GROUP {
                plain[i] = taps[0][*reach] * middle[i];
                second[i] = taps[2][*reach] * middle[i];
            }
            for k in 1..=*reach {
                let (before, after) = (at(reach - k), at(reach + k));
                for i in 0..GROUP {
                    let (both, more) = (before[i] + after[i], after[i] - before[i]);
                    plain[i] += taps[0][reach + k] * both;
                    first[i] += taps[1][reach + k] * more;
                    second[i] += taps[2][reach + k] * both;
                }
            }
            out[0][x..x + GROUP].copy_from_slice(&plain);
            out[1][x..x + GROUP].copy_from_slice(&first);
            out[2][x..x + GROUP].copy_from_slice(&second);
        }
    }

    /// Notes those of the `pixels` from (x, y) on, a bit each, through which a ridge passes.
    #[inline(always)]
    fn look(&self, task: &Task, x: usize, y: usize, pixels: u64, points: &mut Vec<Point>) {
        let (kernels, height) = (&task.kernels, task.luma.height());
        let [mut gx, mut gy, mut gxx, mut gxy, mut gyy] = [[0f32; GROUP]; 5];
        let (reach, [g, g1, g2]) = (kernels.reach, &kernels.taps);
        let group = |k: usize, d: usize| -> &[f32; GROUP] {
            let row = (y + k).saturating_sub(reach).min(height - 1);
            let smoothed = &self.rows[x / 64 * TAPS_MAX + row % TAPS_MAX];
            smoothed[d][x % 64..].first_chunk().expect("a strip is whole groups")
        };
        let (plain, first, second) = (group(reach, 0), group(reach, 1), group(reach, 2));
        for i in 0..GROUP {
            gx[i] = g[reach] * first[i];
            gxx[i] = g[reach] * second[i];
            gyy[i] = g2[reach] * plain[i];
        }
        for k in 1..=reach {
            let (above, below) = (reach - k, reach + k);
            let (plain, first, second) = (group(above, 0), group(above, 1), group(above, 2));
            let (plain_below, first_below, second_below) =
                (group(below, 0), group(below, 1), group(below, 2));
            for i in 0..GROUP {
                gx[i] += g[below] * (first[i] + first_below[i]);
                gy[i] += g1[below] * (plain_below[i] - plain[i]);
                gxx[i] += g[below] * (second[i] + second_below[i]);
                gxy[i] += g1[below] * (first_below[i] - first[i]);
                gyy[i] += g2[below] * (plain[i] + plain_below[i]);
            }
        }
        let [mut curvature, mut dx, mut dy, mut along_x, mut along_y] = [[0f32; GROUP]; 5];
        let mut passes = [0u8; GROUP];
        for i in 0..GROUP {
            let half = (gxx[i] - gyy[i]) / 2.0;
            curvature[i] = (gxx[i] + gyy[i]) / 2.0 - (half * half + gxy[i] * gxy[i]).sqrt();
            let ridge = ridge_through(curvature[i], [gx[i], gy[i]], [gxx[i], gxy[i], gyy[i]]);
            ([dx[i], dy[i], along_x[i], along_y[i]], passes[i]) = ridge;
            passes[i] &= if -curvature[i] * task.scale >= self.strength_min { 0xff } else { 0 };
        }
        let mut left = u128::from_le_bytes(passes);
        while left != 0 {
            let i = left.trailing_zeros() as usize / 8;
            left &= !(0xff << (8 * i));
            if pixels >> i & 1 == 1 && points.len() < points.capacity() {
                let at = [(x + i) as f32 + dx[i], y as f32 + dy[i]];
                points.push(Point { at, along: [along_x[i], along_y[i]], taken: false });
            }
        }
    }
}

/// Where the ridge is from a pixel's middle, and its direction, and all bits set if it passes through the pixel: from the
/// most negative curvature, the gradient and the second derivatives xx, xy, yy. Without branches, so that it is done for
/// many pixels at a time.
#[inline(always)]
fn ridge_through(curvature: f32, [gx, gy]: [f32; 2], [gxx, gxy, gyy]: [f32; 3]) -> ([f32; 4], u8) {
    // The eigenvector, from the row of the matrix that is longer.
    let (a, b) = ((gxy, curvature - gxx), (curvature - gyy, gxy));
    let square = |(x, y): (f32, f32)| x * x + y * y;
    let longer = square(a) > square(b);
    let (nx, ny) = (if longer { a.0 } else { b.0 }, if longer { a.1 } else { b.1 });
    let norm = square((nx, ny)).sqrt();
    let (nx, ny) = (nx / norm, ny / norm);
    let t = -(gx * nx + gy * ny) / curvature;
    // A little over half a pixel, so that no ridge slips between two; but kept to the pixel.
    let passes = (norm >= 1e-6) & ((t * nx).abs() <= 0.6) & ((t * ny).abs() <= 0.6);
    // A NaN, which passes nowhere, stays one.
    let kept = |off: f32| off.clamp(-0.49, 0.49);
    ([kept(t * nx), kept(t * ny), -ny, nx], if passes { 0xff } else { 0 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Frame;

    #[test]
    fn all_levels_give_the_same_points() {
        let (width, height) = (150, 70);
        let bytes: Vec<u8> = (0..width * height)
            .map(|i| {
                let (x, y) = ((i % width) as f32, (i / width) as f32);
                let wave = (0.4 * x + 0.15 * y).sin() * 60.0 + (0.05 * x * y).cos() * 40.0;
                (128.0 + wave) as u8
            })
            .collect();
        let frame = Frame::from_grey(width, height, bytes);
        let mut mask = BitImage::new(width, height);
        (0..width * height).filter(|i| i % 7 != 0).for_each(|i| mask.set(i % width, i / width, true));
        let mut area = Area::new(width, height);
        area.include(width / 2, height / 2, width);
        let found: Vec<Vec<[f32; 4]>> = Level::available()
            .iter()
            .map(|&level| {
                let mut points = Vec::with_capacity(width * height);
                let luma = LumaView::new(&frame).unwrap();
                Finder::new(3.5, width, level).run(luma, &mask, &area, false, 1.3, None, &mut points);
                points.iter().map(|p| [p.at[0], p.at[1], p.along[0], p.along[1]]).collect()
            })
            .collect();
        assert!(found[0].len() > 200, "{} points", found[0].len());
        assert!(found.windows(2).all(|two| two[0] == two[1]), "levels differ");
    }
}
