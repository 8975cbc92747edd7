//! Thinning (paper IV-B): a binary picture to its skeleton, lines one pixel wide that keep the picture's topology.
//!
//! Takes a [`BitImage`], gives a [`BitImage`] of the same size; owns the work planes. Both algorithms delete border
//! pixels in two alternating sub-iterations until nothing changes:
//!
//! - Zhang and Suen, "A fast parallel algorithm for thinning digital patterns", 1984, DOI 10.1145/357994.358023
//! - Guo and Hall, "Parallel thinning with two-subiteration algorithms", 1989, DOI 10.1145/62065.62074 (A1)
//!
//! The result is pixel-identical with OpenCV's `ximgproc.thinning`, which never deletes the outermost pixels of the
//! picture but counts them as neighbours. 64 pixels are one word, and regions where nothing changes are skipped.

pub mod slow;

use crate::vision::bits::{BitImage, PAD_ROWS};

/// Which thinning.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Algorithm {
    /// Zhang and Suen 1984: smooth lines, diagonals up to two pixels wide.
    #[default]
    ZhangSuen,
    /// Guo and Hall 1989: diagonals one pixel wide, more spurs.
    GuoHall,
}

/// Parameters of the thinning.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Params {
    /// Which thinning; Zhang-Suen unless set.
    pub algorithm: Algorithm,
}

/// Workspace of the thinning for one picture size.
///
/// ```
/// use pickcell::vision::{bits::BitImage, thin::{Params, Thin}};
/// let mask = BitImage::from_text("
///     ...........
///     .#########.
///     .#########.
///     .#########.
///     ...........");
/// let mut skeleton = BitImage::new(11, 5);
/// Thin::new(Params::default(), 11, 5).run(&mask, &mut skeleton);
/// assert_eq!(skeleton.to_text(), "
/// ...........
/// ...........
/// ..#######..
/// ...........
/// ...........
/// ".trim_start());
/// ```
#[derive(Clone, Debug)]
pub struct Thin {
    params: Params,
    before: BitImage,
}

impl Thin {
    /// A workspace for pictures of `width` x `height` pixels.
    pub fn new(params: Params, width: usize, height: usize) -> Self {
        Self { params, before: BitImage::new(width, height) }
    }

    /// Thins `mask` into `skeleton`.
    ///
    /// # Panics
    /// Where a picture has not the size given to [`Thin::new`].
    pub fn run(&mut self, mask: &BitImage, skeleton: &mut BitImage) {
        assert_eq!(
            (mask.width(), mask.height()),
            (self.before.width(), self.before.height()),
            "size of the mask"
        );
        skeleton.copy_from(mask);
        loop {
            let mut changed = false;
            for subiteration in 0..2 {
                self.before.copy_from(skeleton);
                changed |= self.subiterate(subiteration, skeleton);
            }
            if !changed {
                return;
            }
        }
    }

    fn subiterate(&self, subiteration: usize, picture: &mut BitImage) -> bool {
        let (strips, stride, height) = (picture.strips(), picture.strip_stride(), picture.height());
        let before = self.before.words();
        let mut changed = false;
        for s in 0..strips {
            let mut inner = picture.strip_mask(s);
            if s == 0 {
                inner &= !1;
            }
            if s == strips - 1 {
                inner &= !(1 << ((picture.width() - 1) % 64));
            }
            for y in 1..height.saturating_sub(1) {
                let i = s * stride + PAD_ROWS + y;
                if before[i] == 0 {
                    continue;
                }
                let row = |i: usize| {
                    let west = if s == 0 { 0 } else { before[i - stride] };
                    let east = if s == strips - 1 { 0 } else { before[i + stride] };
                    [before[i] << 1 | west >> 63, before[i], before[i] >> 1 | east << 63]
                };
                let ([p9, p2, p3], [p8, p1, p4], [p7, p6, p5]) = (row(i - 1), row(i), row(i + 1));
                let ring = [p2, p3, p4, p5, p6, p7, p8, p9];
                let delete = match self.params.algorithm {
                    Algorithm::ZhangSuen => zhang_suen_deletes(ring, subiteration),
                    Algorithm::GuoHall => guo_hall_deletes(ring, subiteration),
                } & p1
                    & inner;
                if delete != 0 {
                    picture.words_mut()[i] = p1 & !delete;
                    changed = true;
                }
            }
        }
        changed
    }
}

fn exactly_one(u: [u64; 4]) -> u64 {
    let [a, b, c, d] = u;
    ((a ^ b) & !(c | d)) | ((c ^ d) & !(a | b))
}

fn zhang_suen_deletes([p2, p3, p4, p5, p6, p7, p8, p9]: [u64; 8], subiteration: usize) -> u64 {
    let rises = |a: u64, b: u64, c: u64| (!a & b) | (!b & c);
    let a1 = exactly_one([rises(p2, p3, p4), rises(p4, p5, p6), rises(p6, p7, p8), rises(p8, p9, p2)]);
    // With one run of neighbours, B >= 2 is a side and a corner of it, B <= 6 a side and a corner that are none.
    let two = (p2 | p4 | p6 | p8) & (p3 | p5 | p7 | p9);
    let seven = (p2 & p4 & p6 & p8) | (p3 & p5 & p7 & p9);
    let m = if subiteration == 0 { p4 & p6 & (p2 | p8) } else { p2 & p8 & (p4 | p6) };
    a1 & two & !seven & !m
}

fn guo_hall_deletes([p2, p3, p4, p5, p6, p7, p8, p9]: [u64; 8], subiteration: usize) -> u64 {
    let c1 = exactly_one([!p2 & (p3 | p4), !p4 & (p5 | p6), !p6 & (p7 | p8), !p8 & (p9 | p2)]);
    let at_least_two = |a: u64, b: u64, c: u64, d: u64| (a & b) | (c & d) | ((a | b) & (c | d));
    let (a, b, c, d) = (p9 | p2, p3 | p4, p5 | p6, p7 | p8);
    let (e, f, g, h) = (p2 | p3, p4 | p5, p6 | p7, p8 | p9);
    let two = at_least_two(a, b, c, d) & at_least_two(e, f, g, h);
    let four = (a & b & c & d) & (e & f & g & h);
    let m = if subiteration == 0 { (p6 | p7 | !p9) & p8 } else { (p2 | p3 | !p5) & p4 };
    c1 & two & !four & !m
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn thin(algorithm: Algorithm, mask: &BitImage) -> BitImage {
        let mut skeleton = BitImage::new(mask.width(), mask.height());
        Thin::new(Params { algorithm }, mask.width(), mask.height()).run(mask, &mut skeleton);
        skeleton
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]
        #[test]
        fn fast_equals_slow(width in 1usize..200, height in 1usize..40, blobs in prop::collection::vec((0usize..200, 0usize..40, 1usize..60, 1usize..20, any::<bool>()), 1..14)) {
            let mut mask = BitImage::new(width, height);
            for (x0, y0, w, h, object) in blobs {
                for y in y0..(y0 + h).min(height) {
                    for x in x0..(x0 + w).min(width) {
                        mask.set(x, y, object);
                    }
                }
            }
            for algorithm in [Algorithm::ZhangSuen, Algorithm::GuoHall] {
                prop_assert_eq!(thin(algorithm, &mask).to_text(), slow::thin_slowly(algorithm, &mask).to_text());
            }
        }

        #[test]
        fn fast_equals_slow_on_noise(width in 1usize..140, height in 1usize..30, share in 0.3f64..0.98, seed: u64) {
            use rand::{RngExt, SeedableRng};
            let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(seed);
            let mut mask = BitImage::new(width, height);
            for i in 0..width * height {
                mask.set(i % width, i / width, random.random_bool(share));
            }
            for algorithm in [Algorithm::ZhangSuen, Algorithm::GuoHall] {
                prop_assert_eq!(thin(algorithm, &mask).to_text(), slow::thin_slowly(algorithm, &mask).to_text());
            }
        }
    }
}
