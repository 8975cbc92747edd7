//! Pixels to bits, 32 bytes an instruction. The safe twin is [`super::plain`].
//!
//! All functions need AVX2 and BMI2; everything is read through array references, so [`load`], [`load_half`]
//! and [`store`] are the only unsafe code.

use super::auto::{self, Auto};
use super::kernel::{ByteBox, LevelBox, Luma, LumaLayout};
use super::rows::{self, Rows};
use super::speck::Specks;
use crate::vision::bits::BitImage;
use std::arch::x86_64::*;
use std::ops::Range;

/// The 32 bytes from `at` on.
#[target_feature(enable = "avx2,bmi2")]
#[inline]
fn load(bytes: &[u8], at: usize) -> __m256i {
    match bytes[at..].first_chunk::<32>() {
        // SAFETY: the reference is to 32 readable bytes, and the load needs no alignment.
        Some(bytes) => unsafe { _mm256_loadu_si256(bytes.as_ptr().cast()) },
        None => _mm256_setzero_si256(),
    }
}

/// The 16 bytes from `at` on.
#[target_feature(enable = "avx2,bmi2")]
#[inline]
fn load_half(bytes: &[u8], at: usize) -> __m128i {
    match bytes[at..].first_chunk::<16>() {
        // SAFETY: the reference is to 16 readable bytes, and the load needs no alignment.
        Some(bytes) => unsafe { _mm_loadu_si128(bytes.as_ptr().cast()) },
        None => _mm_setzero_si128(),
    }
}

#[target_feature(enable = "avx2,bmi2")]
#[inline]
fn store(low: __m256i, high: __m256i, bytes: &mut [u8; 64]) {
    let out = bytes.as_mut_ptr().cast::<__m256i>();
    // SAFETY: the reference is to 64 writable bytes, two vectors, and the stores need no alignment.
    unsafe {
        _mm256_storeu_si256(out, low);
        _mm256_storeu_si256(out.add(1), high);
    }
}

/// Bits of the bytes from `lo` to `hi`, both included.
#[target_feature(enable = "avx2,bmi2")]
#[inline]
fn between(x: __m256i, lo: __m256i, hi: __m256i) -> u32 {
    let above = _mm256_cmpeq_epi8(_mm256_max_epu8(x, lo), x);
    let below = _mm256_cmpeq_epi8(_mm256_min_epu8(x, hi), x);
    _mm256_movemask_epi8(_mm256_and_si256(above, below)) as u32
}

#[inline]
fn joined(low: u32, high: u32) -> u64 {
    u64::from(low) | u64::from(high) << 32
}

/// See [`super::kernel::byte_box`].
#[target_feature(enable = "avx2,bmi2")]
pub(super) fn byte_box(rows: Rows<'_>, range: &ByteBox, bits: &mut BitImage) {
    let (lo, hi) = ([0, 32, 64].map(|at| load(&range.lo, at)), [0, 32, 64].map(|at| load(&range.hi, at)));
    let ys = 0..bits.height();
    rows::each(rows, ys, bits, |_, bytes: &[u8; 192]| {
        let mut inside = [0; 6];
        for (i, inside) in inside.iter_mut().enumerate() {
            // The box repeats after 96 bytes, which are three registers.
            *inside = between(load(bytes, 32 * i), lo[i % 3], hi[i % 3]);
        }
        let [a, b, c] = [0, 2, 4].map(|i| joined(inside[i], inside[i + 1]));
        let a = a & (a >> 1 | b << 63) & (a >> 2 | b << 62);
        let b = b & (b >> 1 | c << 63) & (b >> 2 | c << 62);
        let c = c & (c >> 1) & (c >> 2);
        _pext_u64(a, 0x9249_2492_4924_9249)
            | _pext_u64(b, 0x4924_9249_2492_4924) << 22
            | _pext_u64(c, 0x2492_4924_9249_2492) << 43
    });
}

/// A [`LevelBox`] in registers.
struct Levels {
    y_offset: __m256i,
    y: __m256i,
    blue_red: __m256i,
    green: __m256i,
    lo: [__m256i; 3],
    hi: [__m256i; 3],
    even: __m256i,
    odd: __m256i,
    swap: __m256i,
}

impl Levels {
    #[target_feature(enable = "avx2,bmi2")]
    fn new(range: &LevelBox) -> Self {
        let c = &range.ycbcr;
        let pair = |u: i16, v: i16| _mm256_set1_epi32(i32::from(u) & 0xffff | i32::from(v) << 16);
        let twice = |x| _mm256_broadcastsi128_si256(x);
        Self {
            y_offset: _mm256_set1_epi16(c.y_offset << 7),
            y: _mm256_set1_epi16(c.y),
            blue_red: pair(c.b_u, c.r_v),
            green: pair(c.g_u, c.g_v),
            lo: range.lo.map(|v| _mm256_set1_epi16(v)),
            hi: range.hi.map(|v| _mm256_set1_epi16(v)),
            even: twice(_mm_set_epi8(13, 12, 13, 12, 9, 8, 9, 8, 5, 4, 5, 4, 1, 0, 1, 0)),
            odd: twice(_mm_set_epi8(15, 14, 15, 14, 11, 10, 11, 10, 7, 6, 7, 6, 3, 2, 3, 2)),
            swap: twice(_mm_set_epi8(13, 12, 15, 14, 9, 8, 11, 10, 5, 4, 7, 6, 1, 0, 3, 2)),
        }
    }

    /// 16 pixels, Y in the low byte of a lane and Cb, Cr by turns in the high one; all ones where outside.
    #[target_feature(enable = "avx2,bmi2")]
    #[inline]
    fn outside(&self, pixels: __m256i) -> __m256i {
        let y = _mm256_srli_epi16::<1>(_mm256_slli_epi16::<8>(pixels));
        let y = _mm256_mulhrs_epi16(_mm256_sub_epi16(y, self.y_offset), self.y);
        // (pixels & 0xff00) ^ 0x8000 is (chroma - 128) << 8.
        let chroma = _mm256_and_si256(pixels, _mm256_set1_epi16(0xff00u16 as i16));
        let chroma = _mm256_xor_si256(chroma, _mm256_set1_epi16(i16::MIN));
        let blue_red = _mm256_mulhrs_epi16(chroma, self.blue_red);
        let green = _mm256_mulhrs_epi16(chroma, self.green);
        let green = _mm256_add_epi16(green, _mm256_shuffle_epi8(green, self.swap));
        let levels = [
            _mm256_adds_epi16(y, _mm256_shuffle_epi8(blue_red, self.odd)),
            _mm256_adds_epi16(y, green),
            _mm256_adds_epi16(y, _mm256_shuffle_epi8(blue_red, self.even)),
        ];
        let mut outside = _mm256_setzero_si256();
        for (level, (lo, hi)) in levels.into_iter().zip(self.lo.into_iter().zip(self.hi)) {
            outside = _mm256_or_si256(outside, _mm256_cmpgt_epi16(lo, level));
            outside = _mm256_or_si256(outside, _mm256_cmpgt_epi16(level, hi));
        }
        outside
    }

    /// 32 pixels.
    #[target_feature(enable = "avx2,bmi2")]
    #[inline]
    fn inside(&self, low: __m256i, high: __m256i) -> u32 {
        let outside = _mm256_packs_epi16(self.outside(low), self.outside(high));
        !_mm256_movemask_epi8(_mm256_permute4x64_epi64::<0b11_01_10_00>(outside)) as u32
    }
}

/// See [`super::kernel::level_box`].
#[target_feature(enable = "avx2,bmi2")]
pub(super) fn level_box(y: Rows<'_>, chroma: Option<Rows<'_>>, range: &LevelBox, bits: &mut BitImage) {
    let levels = Levels::new(range);
    let ys = 0..bits.height();
    match chroma {
        None => rows::each(y, ys, bits, |_, b: &[u8; 128]| {
            let inside = |at| levels.inside(load(b, at), load(b, at + 32));
            joined(inside(0), inside(64))
        }),
        Some(chroma) => rows::each_with_chroma(y, chroma, bits, |y, c| {
            let sixteen = |at| {
                let (y, c) = (load_half(y, at), load_half(c, at));
                _mm256_set_m128i(_mm_unpackhi_epi8(y, c), _mm_unpacklo_epi8(y, c))
            };
            joined(levels.inside(sixteen(0), sixteen(16)), levels.inside(sixteen(32), sixteen(48)))
        }),
    }
}

/// Luma of 32 pixels of three bytes from `at` on; `red_first` for R, G, B, else B, G, R.
#[target_feature(enable = "avx2,bmi2")]
#[inline]
fn luma_of_three(bytes: &[u8; 192], at: usize, red_first: bool) -> __m256i {
    const __: i8 = -1;
    let twice = |x| _mm256_broadcastsi128_si256(x);
    let first_two = twice(_mm_setr_epi8(0, __, 1, __, 3, __, 4, __, 6, __, 7, __, 9, __, 10, __));
    let third = twice(_mm_setr_epi8(2, __, __, __, 5, __, __, __, 8, __, __, __, 11, __, __, __));
    let [r, g, b] = crate::frame::colour::LUMA_WEIGHTS;
    let (w0, w2) = if red_first { (r, b) } else { (b, r) };
    let (first_two_weights, third_weight) = (_mm256_set1_epi32(w0 | g << 16), _mm256_set1_epi32(w2));
    let half = _mm256_set1_epi32(1 << 14);
    let eight = |i: usize| {
        let (low, high) = (at + 24 * i, at + 24 * i + 12);
        let high = match high + 16 > bytes.len() {
            false => load_half(bytes, high),
            // The last load must end with the block.
            true => _mm_srli_si128::<4>(load_half(bytes, high - 4)),
        };
        let pixels = _mm256_set_m128i(high, load_half(bytes, low));
        let sum = _mm256_madd_epi16(_mm256_shuffle_epi8(pixels, first_two), first_two_weights);
        let sum = _mm256_add_epi32(sum, _mm256_madd_epi16(_mm256_shuffle_epi8(pixels, third), third_weight));
        _mm256_srli_epi32::<15>(_mm256_add_epi32(sum, half))
    };
    let low = _mm256_packus_epi32(eight(0), eight(1));
    let high = _mm256_packus_epi32(eight(2), eight(3));
    // Packing works within 128 bits.
    let order = _mm256_setr_epi32(0, 4, 1, 5, 2, 6, 3, 7);
    _mm256_permutevar8x32_epi32(_mm256_packus_epi16(low, high), order)
}

/// The first of every two of the 64 bytes from `at` on.
#[target_feature(enable = "avx2,bmi2")]
#[inline]
fn luma_of_pairs(bytes: &[u8; 128], at: usize) -> __m256i {
    let low_bytes = _mm256_set1_epi16(0xff);
    let half = |at| _mm256_and_si256(load(bytes, at), low_bytes);
    _mm256_permute4x64_epi64::<0b11_01_10_00>(_mm256_packus_epi16(half(at), half(at + 32)))
}

/// See [`super::kernel::luma_between`].
#[target_feature(enable = "avx2,bmi2")]
pub(super) fn luma_between(luma: Luma<'_>, ys: Range<usize>, lo: &[u8], hi: &[u8], bits: &mut BitImage) {
    let word = |s: usize, low: __m256i, high: __m256i| {
        let half = |x, at| between(x, load(lo, at), load(hi, at));
        joined(half(low, 64 * s), half(high, 64 * s + 32))
    };
    let three = |s, b: &[u8; 192], red_first| {
        word(s, luma_of_three(b, 0, red_first), luma_of_three(b, 96, red_first))
    };
    match luma.layout {
        LumaLayout::Rgb => rows::each(luma.rows, ys, bits, |s, b| three(s, b, true)),
        LumaLayout::Bgr => rows::each(luma.rows, ys, bits, |s, b| three(s, b, false)),
        LumaLayout::Single => {
            rows::each(luma.rows, ys, bits, |s, b: &[u8; 64]| word(s, load(b, 0), load(b, 32)))
        }
        LumaLayout::Pair => rows::each(luma.rows, ys, bits, |s, b: &[u8; 128]| {
            word(s, luma_of_pairs(b, 0), luma_of_pairs(b, 64))
        }),
    }
}

/// See [`super::kernel::luma_row`].
#[target_feature(enable = "avx2,bmi2")]
pub(super) fn luma_row(luma: Luma<'_>, y: usize, row: &mut [u8]) {
    let three = |b: &[u8; 192], out: &mut [u8; 64], red_first| {
        store(luma_of_three(b, 0, red_first), luma_of_three(b, 96, red_first), out);
    };
    match luma.layout {
        LumaLayout::Rgb => luma.rows.each_of_row(y, row, |b, out| three(b, out, true)),
        LumaLayout::Bgr => luma.rows.each_of_row(y, row, |b, out| three(b, out, false)),
        LumaLayout::Single => luma.rows.each_of_row(y, row, |b: &[u8; 64], out| *out = *b),
        LumaLayout::Pair => {
            luma.rows.each_of_row(y, row, |b, out| store(luma_of_pairs(b, 0), luma_of_pairs(b, 64), out));
        }
    }
}

/// See [`super::kernel::auto`].
#[target_feature(enable = "avx2,bmi2")]
pub(super) fn auto(auto: &mut Auto, luma: Luma<'_>, dark: bool, bits: &mut BitImage) {
    let row_of = |y, row: &mut [u8]| luma_row(luma, y, row);
    auto::run(auto, dark, bits, row_of, |ys, lo, hi, bits| luma_between(luma, ys, lo, hi, bits));
}

/// See [`super::kernel::drop_specks`].
#[target_feature(enable = "avx2,bmi2")]
pub(super) fn drop_specks(specks: &mut Specks, bits: &mut BitImage, least: u32) {
    specks.drop_smaller(bits, least);
}
