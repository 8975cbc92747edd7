//! Thinning that loses no wire.
//!
//! Zhang and Suen's algorithm erases diagonals that become two pixels wide: of an evenly thick wire at 45 degrees nothing
//! may be left but a pixel. Guo and Hall's keeps them. Where wire lies far from all that the first has left, that of the
//! second is taken, from there to where it meets the first.

use super::{Algorithm, Params, Thin};
use crate::level::Level;
use crate::vision::bits::{BitImage, PAD_ROWS};

/// Rows of a block.
const BLOCK_ROWS: usize = 8;
/// Columns to both sides of a skeleton, in its block of rows and those above and below it, that it is the skeleton of.
const NEAR_COLUMNS: u32 = 11;
/// Rows above and below a block whose mask is thinned with it: a line goes on into the next block, which has skeleton in it
/// or in the one beyond; one more block keeps the cut away.
const AROUND_ROWS: usize = 3 * BLOCK_ROWS;
/// Shifts by which a bit is spread over so many columns to one side.
const SPREAD: [u32; 4] = [1, 2, 4, NEAR_COLUMNS - 7];
/// So many columns of a block with object pixels far from all skeleton are a lost wire.
const LOST_COLUMNS_MIN: u32 = 8;

/// Workspace of the thinning for one picture size.
///
/// ```
/// use pickcell::vision::{bits::BitImage, thin::{Params, Thin, whole::WholeThin}};
/// let mut mask = BitImage::new(64, 64);
/// for (x, y) in (5i32..55).flat_map(|y| (5..55).map(move |x| (x, y))) {
///     // A wire at 45 degrees.
///     mask.set(x as usize, y as usize, (-3..3).contains(&(x - y)) && (20..100).contains(&(x + y)));
/// }
/// let mut skeleton = mask.clone();
/// Thin::new(Params::default(), 64, 64).run(&mask, &mut skeleton);
/// assert!(skeleton.count() < 3);
/// WholeThin::new(Params::default(), 64, 64).run(&mask, &mut skeleton);
/// assert!(skeleton.count() > 30);
/// ```
#[derive(Debug)]
pub struct WholeThin {
    thin: Thin,
    /// Where the first is Zhang and Suen's.
    instead: Option<Instead>,
    blocks: Blocks,
}

/// Guo and Hall's thinning, and what is taken of it.
#[derive(Debug)]
struct Instead {
    /// The mask about what is lost, as far as that can be from all skeleton.
    part: BitImage,
    thin: Thin,
    skeleton: BitImage,
    /// Pixels to be looked at.
    open: Vec<[i32; 2]>,
    taken: Vec<[i32; 2]>,
}

impl WholeThin {
    /// A workspace for pictures of `width` x `height` pixels, with the best instructions of this machine; reserves all
    /// memory.
    pub fn new(params: Params, width: usize, height: usize) -> Self {
        Self::with_level(params, width, height, Level::detect())
    }

    /// A workspace that uses other instructions; the result is the same.
    ///
    /// # Panics
    /// Where the machine has not got them.
    pub fn with_level(params: Params, width: usize, height: usize, level: Level) -> Self {
        let most = 4 * (width + height);
        let instead = || Instead {
            part: BitImage::new(width, height),
            thin: Thin::with_level(Params { algorithm: Algorithm::GuoHall }, width, height, level),
            skeleton: BitImage::new(width, height),
            open: Vec::with_capacity(8 * most),
            taken: Vec::with_capacity(most),
        };
        Self {
            thin: Thin::with_level(params, width, height, level),
            instead: (params.algorithm == Algorithm::ZhangSuen).then(instead),
            blocks: Blocks::new(width, height),
        }
    }

    /// Thins `mask` into `skeleton`.
    ///
    /// # Panics
    /// Where a picture has not the size given to [`WholeThin::new`].
    pub fn run(&mut self, mask: &BitImage, skeleton: &mut BitImage) {
        self.thin.run(mask, skeleton);
        let Self { instead: Some(instead), blocks, .. } = self else { return };
        blocks.find(skeleton);
        let mut lost = 0;
        blocks.for_lost(mask, |_, _, columns| lost += columns.count_ones());
        if lost >= LOST_COLUMNS_MIN {
            instead.part.clear();
            blocks.for_lost(mask, |strip, block, _| instead.copy_around(strip, block, mask));
            instead.thin.run(&instead.part, &mut instead.skeleton);
            instead.taken.clear();
            blocks.for_lost(mask, |strip, block, columns| instead.take(strip, block, columns, skeleton));
            for [x, y] in &instead.taken {
                skeleton.set(*x as usize, *y as usize, true);
            }
        }
    }
}

impl Instead {
    /// Copies the mask about a block of rows of a strip.
    fn copy_around(&mut self, strip: usize, block: usize, mask: &BitImage) {
        let first = (block * BLOCK_ROWS).saturating_sub(AROUND_ROWS);
        let rows = first..((block + 1) * BLOCK_ROWS + AROUND_ROWS).min(mask.height());
        for strip in strip.saturating_sub(1)..(strip + 2).min(mask.strips()) {
            self.part.strip_mut(strip)[rows.clone()].copy_from_slice(&mask.strip(strip)[rows.clone()]);
        }
    }

    /// Takes the lines that begin in these columns of a block of rows, up to where they meet `skeleton`.
    fn take(&mut self, strip: usize, block: usize, columns: u64, skeleton: &BitImage) {
        for y in block * BLOCK_ROWS..((block + 1) * BLOCK_ROWS).min(skeleton.height()) {
            let mut begins = self.skeleton.strip(strip)[y] & columns;
            while begins != 0 {
                self.open.push([64 * strip as i32 + begins.trailing_zeros() as i32, y as i32]);
                begins &= begins - 1;
                self.follow(skeleton);
            }
        }
    }

    /// Takes what hangs together with the open pixels, each pixel once.
    fn follow(&mut self, skeleton: &BitImage) {
        while let Some([x, y]) = self.open.pop() {
            if !self.skeleton.get(x, y) || self.taken.len() + 2 > self.taken.capacity() {
                continue;
            }
            self.skeleton.set(x as usize, y as usize, false);
            self.taken.push([x, y]);
            let around = |reach: i32| {
                (-reach..=reach).flat_map(move |dy| (-reach..=reach).map(move |dx| [x + dx, y + dy]))
            };
            if around(1).any(|[x, y]| skeleton.get(x, y)) {
                continue;
            }
            if let Some([met_x, met_y]) = around(2).find(|[x, y]| skeleton.get(*x, *y)) {
                self.taken.push([(x + met_x) / 2, (y + met_y) / 2]);
            } else if self.open.len() + 9 <= self.open.capacity() {
                self.open.extend(around(1));
            }
        }
    }
}

/// Where there is skeleton, a word for each strip and block of rows, strip by strip.
#[derive(Debug)]
struct Blocks {
    blocks: usize,
    skeleton: Vec<u64>,
}

impl Blocks {
    fn new(width: usize, height: usize) -> Self {
        let (strips, blocks) = (width.div_ceil(64), height.div_ceil(BLOCK_ROWS));
        Self { blocks, skeleton: vec![0; strips * blocks] }
    }

    fn find(&mut self, skeleton: &BitImage) {
        for (strip, words) in self.skeleton.chunks_exact_mut(self.blocks.max(1)).enumerate() {
            for (word, rows) in words.iter_mut().zip(blocks(skeleton, strip)) {
                *word = any(rows);
            }
        }
    }

    /// Gives strip, block and those columns that have object pixels far from all skeleton, where there are any.
    fn for_lost(&self, mask: &BitImage, mut found: impl FnMut(usize, usize, u64)) {
        for strip in 0..mask.strips() {
            for (block, rows) in blocks(mask, strip).iter().enumerate() {
                let object = any(rows);
                if object != 0 {
                    let columns = self.far(object, strip, block);
                    if columns != 0 {
                        found(strip, block, columns);
                    }
                }
            }
        }
    }

    /// Skeleton in a block and those above and below it.
    fn around(&self, strip: usize, block: usize) -> u64 {
        let words = self.skeleton.chunks_exact(self.blocks).nth(strip);
        words.map_or(0, |words| any(&words[block.saturating_sub(1)..(block + 2).min(self.blocks)]))
    }

    /// These columns of a block but for those near a skeleton.
    fn far(&self, columns: u64, strip: usize, block: usize) -> u64 {
        let here = self.around(strip, block);
        let (mut left, mut right) = (here, here);
        for shift in SPREAD {
            (left, right) = (left | left >> shift, right | right << shift);
        }
        let far = columns & !(left | right);
        if far == 0 {
            return 0;
        }
        let west = strip.checked_sub(1).map_or(0, |west| self.around(west, block));
        let east = self.around(strip + 1, block);
        let (mut from_west, mut from_east) = (u128::from(west), u128::from(east) << 64);
        for shift in SPREAD {
            (from_west, from_east) = (from_west | from_west << shift, from_east | from_east >> shift);
        }
        far & !((from_west >> 64) as u64 | from_east as u64)
    }
}

/// The blocks of rows of a strip; the last one may end in padding.
fn blocks(picture: &BitImage, strip: usize) -> &[[u64; BLOCK_ROWS]] {
    let stride = picture.strip_stride();
    picture.words()[strip * stride..][PAD_ROWS..stride - PAD_ROWS].as_chunks().0
}

fn any(words: &[u64]) -> u64 {
    words.iter().fold(0, |all, word| all | word)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A straight wire about a place of a picture of 200x150 pixels.
    fn wire(middle: [f64; 2], angle_deg: f64, width_px: f64) -> BitImage {
        let mut mask = BitImage::new(200, 150);
        let (sin, cos) = angle_deg.to_radians().sin_cos();
        for y in 0..150 {
            for x in 0..200 {
                let (dx, dy) = (x as f64 - middle[0], y as f64 - middle[1]);
                let (along, across) = (dx * cos + dy * sin, dy * cos - dx * sin);
                mask.set(x, y, along.abs() < 50.0 && across.abs() < width_px / 2.0);
            }
        }
        mask
    }

    fn left_of(algorithm: Algorithm, whole: bool, mask: &BitImage) -> usize {
        let (params, mut skeleton) = (Params { algorithm }, BitImage::new(200, 150));
        if whole {
            WholeThin::new(params, 200, 150).run(mask, &mut skeleton);
        } else {
            Thin::new(params, 200, 150).run(mask, &mut skeleton);
        }
        skeleton.count()
    }

    #[test]
    fn no_wire_is_lost_whatever_its_angle_and_width() {
        let mut erased = 0;
        for angle in [0.0, 20.0, 44.0, 44.5, 45.0, 45.5, 90.0, 134.7, 135.0, 135.3] {
            for step in 0..40 {
                let mask = wire([100.3, 75.1], angle, 2.0 + 0.25 * f64::from(step));
                erased += usize::from(left_of(Algorithm::ZhangSuen, false, &mask) < 40);
                for algorithm in [Algorithm::ZhangSuen, Algorithm::GuoHall] {
                    let left = left_of(algorithm, true, &mask);
                    assert!(left > 55, "{angle} {step} {algorithm:?}: {left}");
                }
            }
        }
        assert!(erased > 100, "{erased}");
    }

    /// Pixels that hang together with the first one.
    fn reached(mut skeleton: BitImage) -> usize {
        let (all, width) = (skeleton.count(), skeleton.width() as i32);
        let pixels = (0..width * skeleton.height() as i32).map(|i| [i % width, i / width]);
        let mut open: Vec<_> = pixels.into_iter().find(|[x, y]| skeleton.get(*x, *y)).into_iter().collect();
        while let Some([x, y]) = open.pop() {
            if skeleton.get(x, y) {
                skeleton.set(x as usize, y as usize, false);
                open.extend((-1..=1).flat_map(|dy| (-1..=1).map(move |dx| [x + dx, y + dy])));
            }
        }
        all - skeleton.count()
    }

    #[test]
    fn what_is_taken_hangs_together_with_what_was_there() {
        let mut lost = 0;
        for (angle, step) in
            [-60f64, -45.0, 0.0, 10.0, 80.0].into_iter().flat_map(|a| (0..40).map(move |s| (a, s)))
        {
            // Hooks of which a leg at 45 degrees may be lost.
            let width_px = 2.0 + 0.25 * f64::from(step);
            let mut mask = wire([60.0, 50.0], 45.0, width_px);
            let (sin, cos) = angle.to_radians().sin_cos();
            let other = wire([95.4 + 50.0 * cos, 85.4 + 50.0 * sin], angle, width_px);
            mask.words_mut().iter_mut().zip(other.words()).for_each(|(a, b)| *a |= b);
            let [mut plain, mut whole] = [(); 2].map(|()| BitImage::new(200, 150));
            Thin::new(Params::default(), 200, 150).run(&mask, &mut plain);
            WholeThin::new(Params::default(), 200, 150).run(&mask, &mut whole);
            lost += usize::from(plain.count() + 30 < whole.count());
            assert!(plain.words().iter().zip(whole.words()).all(|(p, w)| p & !w == 0), "{angle} {step}");
            assert_eq!(reached(whole.clone()), whole.count(), "{angle} {step}:\n{}", whole.to_text());
        }
        assert!(lost > 5, "{lost}");
    }

    #[test]
    fn what_is_not_lost_stays_as_it_is() {
        for (angle, width) in [(3.0, 6.0), (30.0, 9.0), (90.0, 20.0), (10.0, 20.0)] {
            let mask = wire([100.0, 75.0], angle, width);
            let [mut plain, mut whole] = [(); 2].map(|()| BitImage::new(200, 150));
            Thin::new(Params::default(), 200, 150).run(&mask, &mut plain);
            WholeThin::new(Params::default(), 200, 150).run(&mask, &mut whole);
            assert!(plain == whole, "{angle} {width}");
        }
    }
}
