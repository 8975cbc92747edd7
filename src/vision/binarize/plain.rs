//! Pixels to bits on every machine: loops over bytes and 64-bit words, and the twin that the others must equal.

use super::auto::{self, Auto};
use super::kernel::{ByteBox, LevelBox, Luma, LumaLayout};
use super::rows::{self, Rows};
use super::speck::Specks;
use crate::frame::colour;
use crate::vision::bits::BitImage;
use std::ops::Range;

/// See [`super::kernel::byte_box`].
pub(super) fn byte_box(rows: Rows<'_>, range: &ByteBox, bits: &mut BitImage) {
    let ys = 0..bits.height();
    rows::each(rows, ys, bits, |_, bytes: &[u8; 192]| {
        let mut inside = [0; 192];
        for i in 0..192 {
            inside[i] = u8::from((range.lo[i] <= bytes[i]) & (bytes[i] <= range.hi[i]));
        }
        let (words, _) = inside.as_chunks::<64>();
        all_three([gather(&words[0]), gather(&words[1]), gather(&words[2])])
    });
}

/// 64 bytes that are 0 or 1 to 64 bits.
fn gather(flags: &[u8; 64]) -> u64 {
    let (eights, _) = flags.as_chunks::<8>();
    eights.iter().rev().fold(0, |word, &eight| {
        // Byte i is moved to bit 56 + i, and no two products share a bit.
        word << 8 | u64::from_le_bytes(eight).wrapping_mul(0x0102_0408_1020_4080) >> 56
    })
}

/// Of 192 bits, whether all three of a pixel are set.
pub(super) fn all_three([a, b, c]: [u64; 3]) -> u64 {
    let a = a & (a >> 1 | b << 63) & (a >> 2 | b << 62);
    let b = b & (b >> 1 | c << 63) & (b >> 2 | c << 62);
    let c = c & (c >> 1) & (c >> 2);
    third_bits(a) | (a >> 63) << 21 | third_bits(b >> 2) << 22 | third_bits(c >> 1) << 43
}

/// Bits 0, 3, 6 … 60 to bits 0 … 20.
fn third_bits(x: u64) -> u64 {
    let x = x & 0x1249_2492_4924_9249;
    let x = (x ^ x >> 2) & 0x10c3_0c30_c30c_30c3;
    let x = (x ^ x >> 4) & 0x100f_00f0_0f00_f00f;
    let x = (x ^ x >> 8) & 0x001f_0000_ff00_00ff;
    let x = (x ^ x >> 16) & 0x001f_0000_0000_ffff;
    (x ^ x >> 32) & 0x001f_ffff
}

/// See [`super::kernel::level_box`].
pub(super) fn level_box(y: Rows<'_>, chroma: Option<Rows<'_>>, range: &LevelBox, bits: &mut BitImage) {
    let word = |y: &[u8; 64], u: &[u8; 64], v: &[u8; 64]| {
        let mut flags = [0; 64];
        for i in 0..64 {
            let l = range.ycbcr.levels(y[i], u[i], v[i]);
            let inside = |c: usize| (range.lo[c] <= l[c]) & (l[c] <= range.hi[c]);
            flags[i] = u8::from(inside(0) & inside(1) & inside(2));
        }
        gather(&flags)
    };
    let ys = 0..bits.height();
    match chroma {
        None => rows::each(y, ys, bits, |_, b: &[u8; 128]| {
            let (mut y, mut u, mut v) = ([0; 64], [0; 64], [0; 64]);
            for (i, four) in b.as_chunks::<4>().0.iter().enumerate() {
                (y[2 * i], y[2 * i + 1]) = (four[0], four[2]);
                (u[2 * i], u[2 * i + 1]) = (four[1], four[1]);
                (v[2 * i], v[2 * i + 1]) = (four[3], four[3]);
            }
            word(&y, &u, &v)
        }),
        Some(chroma) => rows::each_with_chroma(y, chroma, bits, |y, c| {
            let (mut u, mut v) = ([0; 64], [0; 64]);
            for (i, two) in c.as_chunks::<2>().0.iter().enumerate() {
                (u[2 * i], u[2 * i + 1]) = (two[0], two[0]);
                (v[2 * i], v[2 * i + 1]) = (two[1], two[1]);
            }
            word(y, &u, &v)
        }),
    }
}

/// See [`super::kernel::luma_between`].
pub(super) fn luma_between(luma: Luma<'_>, ys: Range<usize>, lo: &[u8], hi: &[u8], bits: &mut BitImage) {
    let word = |s: usize, luma: &[u8; 64]| {
        let (lo, hi) = (&lo[s * 64..s * 64 + 64], &hi[s * 64..s * 64 + 64]);
        let mut flags = [0; 64];
        for i in 0..64 {
            flags[i] = u8::from((lo[i] <= luma[i]) & (luma[i] <= hi[i]));
        }
        gather(&flags)
    };
    match luma.layout {
        LumaLayout::Rgb => rows::each(luma.rows, ys, bits, |s, b| word(s, &luma_of_three::<0>(b))),
        LumaLayout::Bgr => rows::each(luma.rows, ys, bits, |s, b| word(s, &luma_of_three::<2>(b))),
        LumaLayout::Single => rows::each(luma.rows, ys, bits, word),
        LumaLayout::Pair => rows::each(luma.rows, ys, bits, |s, b| word(s, &luma_of_pairs(b))),
    }
}

/// See [`super::kernel::luma_row`].
pub(super) fn luma_row(luma: Luma<'_>, y: usize, row: &mut [u8]) {
    match luma.layout {
        LumaLayout::Rgb => luma.rows.each_of_row(y, row, |b, out| *out = luma_of_three::<0>(b)),
        LumaLayout::Bgr => luma.rows.each_of_row(y, row, |b, out| *out = luma_of_three::<2>(b)),
        LumaLayout::Single => luma.rows.each_of_row(y, row, |b, out| *out = *b),
        LumaLayout::Pair => luma.rows.each_of_row(y, row, |b, out| *out = luma_of_pairs(b)),
    }
}

/// Luma of 64 pixels whose red is byte `RED` of three.
fn luma_of_three<const RED: usize>(bytes: &[u8; 192]) -> [u8; 64] {
    std::array::from_fn(|i| {
        colour::luma_of_rgb([bytes[3 * i + RED], bytes[3 * i + 1], bytes[3 * i + 2 - RED]])
    })
}

/// The first of every two bytes.
fn luma_of_pairs(bytes: &[u8; 128]) -> [u8; 64] {
    std::array::from_fn(|i| bytes[2 * i])
}

/// See [`super::kernel::auto`].
pub(super) fn auto(auto: &mut Auto, luma: Luma<'_>, dark: bool, bits: &mut BitImage) {
    let row_of = |y, row: &mut [u8]| luma_row(luma, y, row);
    auto::run(auto, dark, bits, row_of, |ys, lo, hi, bits| luma_between(luma, ys, lo, hi, bits));
}

/// See [`super::kernel::drop_specks`].
pub(super) fn drop_specks(specks: &mut Specks, bits: &mut BitImage, least: u32) {
    specks.drop_smaller(bits, least);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_are_gathered_in_order() {
        let flags: [u8; 64] = std::array::from_fn(|i| u8::from([0, 1, 9, 40, 63].contains(&i)));
        assert_eq!(gather(&flags), 1 | 1 << 1 | 1 << 9 | 1 << 40 | 1 << 63);
    }

    #[test]
    fn a_pixel_needs_all_its_three_bits() {
        for pixel in 0..64 {
            let mut bits = [0u64; 3];
            for bit in 3 * pixel..3 * pixel + 3 {
                bits[bit / 64] |= 1 << (bit % 64);
            }
            assert_eq!(all_three(bits), 1 << pixel);
            bits[(3 * pixel + 1) / 64] ^= 1 << ((3 * pixel + 1) % 64);
            assert_eq!(all_three(bits), 0);
        }
    }
}
