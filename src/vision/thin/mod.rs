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

mod delete;
#[cfg(test)]
mod slow;
mod tiles;
pub mod whole;

use crate::level::Level;
use crate::vision::bits::BitImage;
use tiles::Tiles;

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
/// ..######...
/// ...........
/// ...........
/// ".trim_start());
/// ```
#[derive(Clone, Debug)]
pub struct Thin {
    params: Params,
    level: Level,
    tiles: Tiles,
}

impl Thin {
    /// A workspace for pictures of `width` x `height` pixels, with the best instructions of this machine.
    pub fn new(params: Params, width: usize, height: usize) -> Self {
        Self::with_level(params, width, height, Level::detect())
    }

    /// A workspace that uses other instructions; the result is the same.
    ///
    /// # Panics
    /// Where the machine has not got them.
    pub fn with_level(params: Params, width: usize, height: usize, level: Level) -> Self {
        assert!(Level::available().contains(&level), "this machine has no {}", level.name());
        Self { params, level, tiles: Tiles::new(width, height) }
    }

    /// Thins `mask` into `skeleton`.
    ///
    /// # Panics
    /// Where a picture has not the size given to [`Thin::new`].
    pub fn run(&mut self, mask: &BitImage, skeleton: &mut BitImage) {
        self.tiles.read(mask);
        // Two sub-iterations in a row without a change: finished.
        let (mut subiteration, mut quiet) = (0, 0);
        while quiet < 2 {
            let changed = self.tiles.subiterate(self.level, self.params.algorithm, subiteration);
            quiet = if changed { 0 } else { quiet + 1 };
            subiteration = 1 - subiteration;
        }
        self.tiles.write(skeleton);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Every level of this machine against the slow twin.
    fn check(algorithm: Algorithm, mask: &BitImage) -> Result<(), TestCaseError> {
        let expected = slow::thin_slowly(algorithm, mask).to_text();
        for &level in Level::available() {
            let mut skeleton = BitImage::new(mask.width(), mask.height());
            let mut thin = Thin::with_level(Params { algorithm }, mask.width(), mask.height(), level);
            // The second time in the same workspace must give the same.
            for _ in 0..2 {
                thin.run(mask, &mut skeleton);
                prop_assert_eq!(skeleton.to_text(), expected.clone(), "{:?} {:?}", algorithm, level);
            }
        }
        Ok(())
    }

    #[test]
    fn what_stands_in_the_padding_is_not_looked_at() {
        let mut mask = BitImage::new(70, 20);
        (0..70).for_each(|x| (5..9).for_each(|y| mask.set(x, y, true)));
        for &level in Level::available() {
            let thinned = |mask: &BitImage| {
                let mut skeleton = BitImage::new(70, 20);
                Thin::with_level(Params::default(), 70, 20, level).run(mask, &mut skeleton);
                skeleton.to_text()
            };
            let mut padded = mask.clone();
            let words = padded.words_mut();
            let last = words.len() - 1;
            (words[0], words[last]) = (u64::MAX, u64::MAX);
            assert_eq!(thinned(&padded), thinned(&mask), "{level:?}");
        }
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
                check(algorithm, &mask)?;
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
                check(algorithm, &mask)?;
            }
        }
    }
}
