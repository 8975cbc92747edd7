//! Pixels to bits, 64 bytes an instruction. The safe twin is [`super::plain`].
//!
//! All functions need AVX-512 F, BW, VBMI and VNNI and BMI2; everything is read through array references, so
//! [`load`] and [`store`] are the only unsafe code.

use super::auto::{self, Auto};
use super::kernel::{ByteBox, LevelBox, Luma, LumaLayout};
use super::rows::{self, Rows};
use super::speck::Specks;
use crate::vision::bits::BitImage;
use std::arch::x86_64::*;
use std::ops::Range;

/// Of 48 bytes, first, G, third, G of each of 16 pixels.
const SPREAD: [u8; 64] = spread(0);
/// The same of bytes 16 to 63.
const SPREAD_LAST: [u8; 64] = spread(16);
/// Every second of 128 bytes.
const EVERY_SECOND: [u8; 64] = {
    let mut index = [0; 64];
    let mut k = 0;
    while k < 64 {
        index[k] = 2 * k as u8;
        k += 1;
    }
    index
};
/// The bytes of two registers by turns: of their lower halves, of their upper ones.
const INTERLEAVED: [[u8; 64]; 2] = {
    let mut index = [[0; 64]; 2];
    let mut k = 0;
    while k < 64 {
        index[0][k] = (k / 2) as u8 | ((k % 2) << 6) as u8;
        index[1][k] = (32 + k / 2) as u8 | ((k % 2) << 6) as u8;
        k += 1;
    }
    index
};

/// One of three interleaved channels of 192 bytes: first what the first two registers have of it, then those and
/// what the third one has.
const CHANNELS: [[[u8; 64]; 2]; 3] = {
    let mut index = [[[0; 64]; 2]; 3];
    let mut channel = 0;
    while channel < 3 {
        let mut k = 0;
        while k < 64 {
            let byte = 3 * k + channel;
            let first = byte < 128;
            index[channel][0][k] = if first { byte as u8 } else { 0 };
            index[channel][1][k] = if first { k as u8 } else { 64 + (byte - 128) as u8 };
            k += 1;
        }
        channel += 1;
    }
    index
};

const fn spread(first: u8) -> [u8; 64] {
    let mut index = [0; 64];
    let mut k = 0;
    while k < 64 {
        index[k] = first + (k / 4 * 3) as u8 + [0, 1, 2, 1][k % 4];
        k += 1;
    }
    index
}

#[target_feature(enable = "avx512f,avx512bw,avx512vbmi,avx512vnni,bmi2")]
#[inline]
fn load(bytes: &[u8; 64]) -> __m512i {
    // SAFETY: the reference is to 64 readable bytes, and the load needs no alignment.
    unsafe { _mm512_loadu_si512(bytes.as_ptr().cast()) }
}

#[target_feature(enable = "avx512f,avx512bw,avx512vbmi,avx512vnni,bmi2")]
#[inline]
fn store(x: __m512i, bytes: &mut [u8; 64]) {
    // SAFETY: the reference is to 64 writable bytes, and the store needs no alignment.
    unsafe { _mm512_storeu_si512(bytes.as_mut_ptr().cast(), x) };
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
    let lo = [0, 1, 2].map(|c| _mm512_set1_epi8(range.lo[c] as i8));
    let span = [0, 1, 2].map(|c| _mm512_set1_epi8((range.hi[c] - range.lo[c]) as i8));
    let ys = 0..bits.height();
    rows::each(rows, ys, bits, |_, bytes: &[u8; 192]| {
        let [a, b, c] = [0, 64, 128].map(|at| load_at(bytes, at));
        let mut inside = u64::MAX;
        for channel in 0..3 {
            let [from_two, from_third] = &CHANNELS[channel];
            let plane = _mm512_permutex2var_epi8(a, load(from_two), b);
            let plane = _mm512_permutex2var_epi8(plane, load(from_third), c);
            let above = _mm512_sub_epi8(plane, lo[channel]);
            inside = _mm512_mask_cmple_epu8_mask(inside, above, span[channel]);
        }
        inside
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
        for c in [0, 1, 2] {
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
            let widen =
                |i: usize, y: __m512i, c: __m512i| _mm512_permutex2var_epi8(y, load(&INTERLEAVED[i]), c);
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
fn luma_of_three(bytes: &[u8; 192], red_first: bool) -> __m512i {
    // A weight is 128 times its first part plus its second.
    let weights = |r: i8, g: [i8; 2], b: i8| {
        let (first, third) = if red_first { (r, b) } else { (b, r) };
        _mm512_set1_epi32(i32::from_le_bytes([first as u8, g[0] as u8, third as u8, g[1] as u8]))
    };
    let (coarse, fine) = (weights(77, [75, 75], 29), weights(-58, [17, 18], 23));
    let half = _mm512_set1_epi32(128);
    let sixteen = |i: usize| {
        // The last load must end with the block.
        let (at, spread) = if i < 3 { (48 * i, &SPREAD) } else { (128, &SPREAD_LAST) };
        let pixels = _mm512_permutexvar_epi8(load(spread), load_at(bytes, at));
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
    _mm512_permutex2var_epi8(load_at(bytes, 0), load(&EVERY_SECOND), load_at(bytes, 64))
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
    match luma.layout {
        LumaLayout::Rgb => luma.rows.each_of_row(y, row, |b, out| store(luma_of_three(b, true), out)),
        LumaLayout::Bgr => luma.rows.each_of_row(y, row, |b, out| store(luma_of_three(b, false), out)),
        LumaLayout::Single => luma.rows.each_of_row(y, row, |b: &[u8; 64], out| *out = *b),
        LumaLayout::Pair => luma.rows.each_of_row(y, row, |b, out| store(luma_of_pairs(b), out)),
    }
}

/// See [`super::kernel::auto`].
#[target_feature(enable = "avx512f,avx512bw,avx512vbmi,avx512vnni,bmi2")]
pub(super) fn auto(auto: &mut Auto, luma: Luma<'_>, dark: bool, bits: &mut BitImage) {
    let row_of = |y, row: &mut [u8]| luma_row(luma, y, row);
    auto::run(auto, dark, bits, row_of, |ys, lo, hi, bits| luma_between(luma, ys, lo, hi, bits));
}

/// See [`super::kernel::drop_specks`].
#[target_feature(enable = "avx512f,avx512bw,avx512vbmi,avx512vnni,bmi2")]
pub(super) fn drop_specks(specks: &mut Specks, bits: &mut BitImage, least: u32) {
    specks.drop_smaller(bits, least);
}
