//! Ends, junction pixels and lone pixels of a skeleton, for 64 pixels a word.
//!
//! What counts as a branch is the same as in [`branches`](super::pixels::branches), its slow twin.

use crate::level::Level;
use crate::vision::bits::{BitImage, PAD_ROWS};
use crate::vision::lanes::{A, B, C, Lanes, not};
#[cfg(target_arch = "x86_64")]
use crate::vision::lanes::{Rows4, Rows8};

const TILE_ROWS: usize = 8;

/// What a word of the skeleton has besides plain chain pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Special {
    /// Column of bit 0.
    pub(super) x: u16,
    /// Row.
    pub(super) y: u16,
    /// Pixels with one branch.
    pub(super) ends: u64,
    /// Pixels with three branches or more.
    pub(super) junctions: u64,
    /// Pixels with none.
    pub(super) alone: u64,
}

/// Lists the words with special pixels, strip by strip from the top; the number of skeleton pixels.
pub(super) fn classify(level: Level, skeleton: &BitImage, list: &mut Vec<Special>) -> usize {
    list.clear();
    // SAFETY: `Graphs::with_level` lets only levels through that the machine has.
    unsafe {
        match level {
            #[cfg(target_arch = "x86_64")]
            Level::Avx512 => classify_avx512(skeleton, list),
            #[cfg(target_arch = "x86_64")]
            Level::Avx2 => classify_avx2(skeleton, list),
            _ => classify_with::<u64>(skeleton, list),
        }
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx512vbmi2,bmi1,bmi2,lzcnt,popcnt")]
fn classify_avx512(skeleton: &BitImage, list: &mut Vec<Special>) -> usize {
    // SAFETY: the function has the instructions of `Rows8`.
    unsafe { classify_with::<Rows8>(skeleton, list) }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi1,popcnt")]
fn classify_avx2(skeleton: &BitImage, list: &mut Vec<Special>) -> usize {
    // SAFETY: the function has the instructions of `Rows4`.
    unsafe { classify_with::<Rows4>(skeleton, list) }
}

/// # Safety
/// The machine has the instructions of `L`.
#[inline(always)]
unsafe fn classify_with<L: Lanes>(skeleton: &BitImage, list: &mut Vec<Special>) -> usize {
    let (stride, words) = (skeleton.strip_stride(), skeleton.words());
    let (tiles, strips) = ((stride - 2 * PAD_ROWS) / TILE_ROWS, skeleton.strips());
    let empty = [0u64; TILE_ROWS + 2];
    let mut count = 0;
    for s in 0..strips {
        for tile in 0..tiles {
            let begin = s * stride + PAD_ROWS + tile * TILE_ROWS;
            let rows = &words[begin..begin + TILE_ROWS];
            // SAFETY: every strip has padding above and below, so that the tile's rows moved by one up or down are
            // words of the picture; the strip beside it has the same rows, or is `empty`, which has two more. The
            // caller promises the instructions.
            unsafe {
                for r in (0..TILE_ROWS).step_by(L::ROWS) {
                    let here = L::load(rows.as_ptr().add(r));
                    if here.rows_sharing(here) == 0 {
                        continue;
                    }
                    let at = words.as_ptr().add(begin + r);
                    let west = if s > 0 { at.sub(stride) } else { empty.as_ptr().add(1) };
                    let east = if s + 1 < strips { at.add(stride) } else { empty.as_ptr().add(1) };
                    let planes = kinds::<L>(here, [west, at, east]);
                    let mut out = [[0u64; TILE_ROWS]; 3];
                    let mut any = 0;
                    for (plane, out) in planes.into_iter().zip(&mut out) {
                        plane.store(out.as_mut_ptr());
                        any |= plane.rows_sharing(plane);
                    }
                    count += rows[r..r + L::ROWS].iter().map(|w| w.count_ones() as usize).sum::<usize>();
                    while any != 0 {
                        let i = any.trailing_zeros() as usize;
                        any &= any - 1;
                        list.push(Special {
                            x: (s * 64) as u16,
                            y: (tile * TILE_ROWS + r + i) as u16,
                            ends: out[0][i],
                            junctions: out[1][i],
                            alone: out[2][i],
                        });
                    }
                }
            }
        }
    }
    count
}

/// Ends, junction pixels and lone pixels among `here`; `at` points to the same rows in the strip to the left, here
/// and to the right.
///
/// # Safety
/// The machine has the instructions of `L`; `L::ROWS` words, and one before and after, can be read at all of `at`.
#[inline(always)]
unsafe fn kinds<L: Lanes>(here: L, at: [*const u64; 3]) -> [L; 3] {
    let [west, middle, east] = at;
    // SAFETY: the caller's promise.
    let (north, south, [nw, ne], [w, e], [sw, se]) = unsafe {
        let north = L::load(middle.sub(1));
        let south = L::load(middle.add(1));
        let sides = |row: L, by: isize| {
            [row.left_neighbours(L::load(west.offset(by))), row.right_neighbours(L::load(east.offset(by)))]
        };
        (north, south, sides(north, -1), sides(here, 0), sides(south, 1))
    };
    // A corner counts only where no side joins it already.
    let corner = [free(ne, north, e), free(se, south, e), free(sw, south, w), free(nw, north, w)];
    // The number of branches in binary: ones, and four digits of twos.
    let (sum_a, twos_a) = add(north, e, south);
    let (sum_b, twos_b) = add(w, corner[0], corner[1]);
    let sum_c = L::ternary::<{ A ^ B }>(corner[2], corner[3], here);
    let twos_c = L::ternary::<{ A & B }>(corner[2], corner[3], here);
    let (ones, twos_d) = add(sum_a, sum_b, sum_c);
    let some_twos = L::ternary::<{ A | B | C }>(twos_a, twos_b, twos_c);
    let any_twos = L::ternary::<{ A | B }>(some_twos, twos_d, here);
    let pair = L::ternary::<{ (A & B) | (A & C) | (B & C) }>(twos_a, twos_b, twos_c);
    let four = L::ternary::<{ A | (B & C) }>(pair, some_twos, twos_d);
    let three = L::ternary::<{ A | (B & C) }>(four, ones, any_twos);
    [
        L::ternary::<{ A & not(B) & C }>(ones, any_twos, here),
        L::ternary::<{ A & B }>(three, here, here),
        L::ternary::<{ not(A | B) & C }>(ones, any_twos, here),
    ]
}

/// A corner that none of its two sides joins.
#[inline(always)]
fn free<L: Lanes>(corner: L, side: L, other: L) -> L {
    L::ternary::<{ A & not(B | C) }>(corner, side, other)
}

/// Sum of three bits: ones and twos.
#[inline(always)]
fn add<L: Lanes>(a: L, b: L, c: L) -> (L, L) {
    (L::ternary::<{ A ^ B ^ C }>(a, b, c), L::ternary::<{ (A & B) | (A & C) | (B & C) }>(a, b, c))
}

#[cfg(test)]
mod tests {
    use super::super::pixels::branches;
    use super::*;
    use rand::{RngExt, SeedableRng};

    #[test]
    fn every_level_equals_the_slow_twin() {
        let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(4);
        for (width, height, share) in
            [(1, 1, 1.0), (64, 8, 0.3), (65, 9, 0.5), (200, 50, 0.2), (131, 33, 0.8)]
        {
            let mut picture = BitImage::new(width, height);
            for i in 0..width * height {
                picture.set(i % width, i / width, random.random_bool(share));
            }
            for &level in Level::available() {
                let mut list = Vec::new();
                assert_eq!(classify(level, &picture, &mut list), picture.count());
                for y in 0..height {
                    for x in 0..width {
                        let special = list.iter().find(|s| (s.x as usize, s.y as usize) == (x / 64 * 64, y));
                        let special = special.copied().unwrap_or_default();
                        let kind =
                            [special.ends, special.junctions, special.alone].map(|w| w >> (x % 64) & 1 == 1);
                        let set = picture.get(x as i32, y as i32);
                        let count = branches(&picture, x as i32, y as i32).count_ones();
                        let expected = [count == 1, count >= 3, count == 0].map(|k| k && set);
                        assert_eq!(kind, expected, "({x}, {y}), {level:?}");
                    }
                }
            }
        }
    }
}
