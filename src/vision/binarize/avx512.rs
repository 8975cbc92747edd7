//! Pixels to bits, 64 bytes an instruction. The safe twin is [`super::plain`].
//!
//! All functions need AVX-512 F, BW, VBMI and VNNI and BMI2; everything is read through array references, so the
//! loads in [`load`] are the only unsafe code.

use super::auto::{self, Grid};
use super::kernel::{ByteBox, LevelBox, Luma, LumaLayout};
use super::rows::{self, Rows};
use crate::vision::bits::BitImage;
use std::arch::x86_64::*;
use std::ops::Range;

/// Bytes that the luma of 64 three-byte pixels is read from; the last 16 do not matter.
const THREE: usize = 208;

#[target_feature(enable = "avx512f,avx512bw,avx512vbmi,avx512vnni,bmi2")]
fn load(bytes: &[u8; 64]) -> __m512i {
    // SAFETY: the reference is to 64 readable bytes, and the load needs no alignment.
    unsafe { _mm512_loadu_si512(bytes.as_ptr().cast()) }
}

/// The 64 bytes from `at` on.
#[target_feature(enable = "avx512f,avx512bw,avx512vbmi,avx512vnni,bmi2")]
#[inline]
fn load_at(bytes: &[u8], at: usize) -> __m512i {
    match bytes[at..].first_chunk() {
        Some(bytes) => load(bytes),
        None => _mm512_setzero_si512(),
    }
}

/// See [`super::kernel::byte_box`].
#[target_feature(enable = "avx512f,avx512bw,avx512vbmi,avx512vnni,bmi2")]
pub(super) fn byte_box(rows: Rows<'_>, range: &ByteBox, bits: &mut BitImage) {
    let lo = [0, 64, 128].map(|at| load_at(&range.lo, at));
    let span = [0, 1, 2].map(|i| _mm512_sub_epi8(load_at(&range.hi, 64 * i), lo[i]));
    let ys = 0..bits.height();
    rows::each(rows, ys, bits, |_, bytes: &[u8; 192]| {
        let inside =
            |i: usize| _mm512_cmple_epu8_mask(_mm512_sub_epi8(load_at(bytes, 64 * i), lo[i]), span[i]);
        let (a, b, c) = (inside(0), inside(1), inside(2));
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
    y_offset: __m512i,
    y: __m512i,
    blue_red: __m512i,
    green: __m512i,
    lo: [__m512i; 3],
    hi: [__m512i; 3],
    even: __m512i,
    odd: __m512i,
}

impl Levels {
    #[target_feature(enable = "avx512f,avx512bw,avx512vbmi,avx512vnni,bmi2")]
    fn new(range: &LevelBox) -> Self {
        let c = &range.ycbcr;
        let pair = |u: i16, v: i16| _mm512_set1_epi32(i32::from(u) & 0xffff | i32::from(v) << 16);
        Self {
            y_offset: _mm512_set1_epi16(c.y_offset << 7),
            y: _mm512_set1_epi16(c.y),
            blue_red: pair(c.b_u, c.r_v),
            green: pair(c.g_u, c.g_v),
            lo: range.lo.map(|v| _mm512_set1_epi16(v)),
            hi: range.hi.map(|v| _mm512_set1_epi16(v)),
            even: _mm512_broadcast_i32x4(_mm_set_epi8(13, 12, 13, 12, 9, 8, 9, 8, 5, 4, 5, 4, 1, 0, 1, 0)),
            odd: _mm512_broadcast_i32x4(_mm_set_epi8(15, 14, 15, 14, 11, 10, 11, 10, 7, 6, 7, 6, 3, 2, 3, 2)),
        }
    }

    /// 32 pixels, Y in the low byte of a lane and Cb, Cr by turns in the high one.
    #[target_feature(enable = "avx512f,avx512bw,avx512vbmi,avx512vnni,bmi2")]
    #[inline]
    fn inside(&self, pixels: __m512i) -> u32 {
        let y = _mm512_srli_epi16::<1>(_mm512_slli_epi16::<8>(pixels));
        let y = _mm512_mulhrs_epi16(_mm512_sub_epi16(y, self.y_offset), self.y);
        // (pixels & 0xff00) ^ 0x8000 is (chroma - 128) << 8.
        let (high, sign) = (_mm512_set1_epi16(0xff00u16 as i16), _mm512_set1_epi16(i16::MIN));
        let chroma = _mm512_ternarylogic_epi32::<0x78>(sign, pixels, high);
        let blue_red = _mm512_mulhrs_epi16(chroma, self.blue_red);
        let green = _mm512_mulhrs_epi16(chroma, self.green);
        let green = _mm512_add_epi16(green, _mm512_rol_epi32::<16>(green));
        let levels = [
            _mm512_adds_epi16(y, _mm512_shuffle_epi8(blue_red, self.odd)),
            _mm512_adds_epi16(y, green),
            _mm512_adds_epi16(y, _mm512_shuffle_epi8(blue_red, self.even)),
        ];
        let mut inside = u32::MAX;
        for c in 0..3 {
            inside = _mm512_mask_cmpge_epi16_mask(inside, levels[c], self.lo[c]);
            inside = _mm512_mask_cmple_epi16_mask(inside, levels[c], self.hi[c]);
        }
        inside
    }
}

/// See [`super::kernel::level_box`].
#[target_feature(enable = "avx512f,avx512bw,avx512vbmi,avx512vnni,bmi2")]
pub(super) fn level_box(y: Rows<'_>, chroma: Option<Rows<'_>>, range: &LevelBox, bits: &mut BitImage) {
    let levels = Levels::new(range);
    let word = |low, high| u64::from(levels.inside(low)) | u64::from(levels.inside(high)) << 32;
    let ys = 0..bits.height();
    match chroma {
        None => rows::each(y, ys, bits, |_, b: &[u8; 128]| word(load_at(b, 0), load_at(b, 64))),
        Some(chroma) => {
            let widen = |i: usize, y: __m512i, c: __m512i| {
                let index: [u8; 64] = std::array::from_fn(|k| (32 * i + k / 2) as u8 | (k as u8 % 2) << 6);
                _mm512_permutex2var_epi8(y, load(&index), c)
            };
            rows::each_with_chroma(y, chroma, bits, |y, c| {
                let (y, c) = (load(y), load(c));
                word(widen(0, y, c), widen(1, y, c))
            });
        }
    }
}

/// Luma of 64 pixels of three bytes; `red_first` for R, G, B, else B, G, R.
#[target_feature(enable = "avx512f,avx512bw,avx512vbmi,avx512vnni,bmi2")]
#[inline]
fn luma_of_three(bytes: &[u8; THREE], red_first: bool) -> __m512i {
    // Four bytes a pixel: first, G, third, G. A weight is 128 times its first part plus its second.
    let spread: [u8; 64] = std::array::from_fn(|k| (k / 4 * 3 + [0, 1, 2, 1][k % 4]) as u8);
    let weights = |r: i8, g: [i8; 2], b: i8| {
        let (first, third) = if red_first { (r, b) } else { (b, r) };
        _mm512_set1_epi32(i32::from_le_bytes([first as u8, g[0] as u8, third as u8, g[1] as u8]))
    };
    let (coarse, fine) = (weights(77, [75, 75], 29), weights(-58, [17, 18], 23));
    let half = _mm512_set1_epi32(128);
    let sixteen = |i: usize| {
        let pixels = _mm512_permutexvar_epi8(load(&spread), load_at(bytes, 48 * i));
        let sum = _mm512_slli_epi32::<7>(_mm512_dpbusd_epi32(half, pixels, coarse));
        _mm512_srli_epi32::<15>(_mm512_dpbusd_epi32(sum, pixels, fine))
    };
    let low = _mm512_packus_epi32(sixteen(0), sixteen(1));
    let high = _mm512_packus_epi32(sixteen(2), sixteen(3));
    // Packing works within 128 bits: what stands there is a 4x4 table of four pixels each, to be transposed.
    let transpose = _mm512_set_epi32(15, 11, 7, 3, 14, 10, 6, 2, 13, 9, 5, 1, 12, 8, 4, 0);
    _mm512_permutexvar_epi32(transpose, _mm512_packus_epi16(low, high))
}

/// The first of every two bytes.
#[target_feature(enable = "avx512f,avx512bw,avx512vbmi,avx512vnni,bmi2")]
#[inline]
fn luma_of_pairs(bytes: &[u8; 128]) -> __m512i {
    let index: [u8; 64] = std::array::from_fn(|k| 2 * k as u8);
    _mm512_permutex2var_epi8(load_at(bytes, 0), load(&index), load_at(bytes, 64))
}

/// See [`super::kernel::luma_between`].
#[target_feature(enable = "avx512f,avx512bw,avx512vbmi,avx512vnni,bmi2")]
pub(super) fn luma_between(luma: Luma<'_>, ys: Range<usize>, lo: &[u8], hi: &[u8], bits: &mut BitImage) {
    let word = |s: usize, luma: __m512i| {
        let above = _mm512_cmpge_epu8_mask(luma, load_at(lo, 64 * s));
        _mm512_mask_cmple_epu8_mask(above, luma, load_at(hi, 64 * s))
    };
    match luma.layout {
        LumaLayout::Rgb => rows::each(luma.rows, ys, bits, |s, b| word(s, luma_of_three(b, true))),
        LumaLayout::Bgr => rows::each(luma.rows, ys, bits, |s, b| word(s, luma_of_three(b, false))),
        LumaLayout::Single => rows::each(luma.rows, ys, bits, |s, b| word(s, load(b))),
        LumaLayout::Pair => rows::each(luma.rows, ys, bits, |s, b| word(s, luma_of_pairs(b))),
    }
}

/// See [`super::kernel::luma_row`].
#[target_feature(enable = "avx512f,avx512bw,avx512vbmi,avx512vnni,bmi2")]
pub(super) fn luma_row(luma: Luma<'_>, y: usize, row: &mut [u8]) {
    let (mut three, mut two, mut one) = ([0; THREE], [0; 128], [0; 64]);
    for (s, out) in row.as_chunks_mut::<64>().0.iter_mut().enumerate() {
        let luma = match luma.layout {
            LumaLayout::Rgb => luma_of_three(luma.rows.at(y, s, &mut three), true),
            LumaLayout::Bgr => luma_of_three(luma.rows.at(y, s, &mut three), false),
            LumaLayout::Single => load(luma.rows.at(y, s, &mut one)),
            LumaLayout::Pair => luma_of_pairs(luma.rows.at(y, s, &mut two)),
        };
        // SAFETY: the reference is to 64 writable bytes, and the store needs no alignment.
        unsafe { _mm512_storeu_si512(out.as_mut_ptr().cast(), luma) };
    }
}

/// See [`super::auto::thresholds`].
#[target_feature(enable = "avx512f,avx512bw,avx512vbmi,avx512vnni,bmi2")]
pub(super) fn thresholds(grid: &mut Grid, dark: bool) -> bool {
    auto::thresholds(grid, dark)
}
