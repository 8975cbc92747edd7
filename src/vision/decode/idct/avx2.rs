//! The transform with a row of eight numbers a register. The safe twin is [`super::Plain`]; both do the same
//! operations in the same order, so they give the same bits.
//!
//! [`load`], [`store`] and the promise of [`Avx2::new`] are the only unsafe code.

use super::Kernel;
use std::arch::x86_64::*;

/// The kernel; a value of it is the proof that the machine has AVX2.
#[derive(Clone, Copy)]
pub(in super::super) struct Avx2(());

impl Avx2 {
    /// # Safety
    /// The machine has AVX2.
    pub(in super::super) unsafe fn new() -> Self {
        Self(())
    }
}

impl Kernel for Avx2 {
    #[inline(always)]
    fn transform(self, first: f32, block: &mut [i16; 64], scales: &[f32; 64], out: &mut [u8], stride: usize) {
        // SAFETY: the value proves AVX2.
        unsafe { transform(first, block, scales, out, stride) }
    }
}

type Rows = [__m256; 8];

/// Row `i` of the block times its scales.
#[target_feature(enable = "avx2")]
#[inline]
fn load(block: &[i16; 64], scales: &[f32; 64], i: usize) -> __m256 {
    let (levels, scales) = (&block.as_chunks::<8>().0[i], &scales.as_chunks::<8>().0[i]);
    // SAFETY: the references are to 16 and 32 readable bytes, and the loads need no alignment.
    let (levels, scales) =
        unsafe { (_mm_loadu_si128(levels.as_ptr().cast()), _mm256_loadu_ps(scales.as_ptr())) };
    _mm256_mul_ps(_mm256_cvtepi32_ps(_mm256_cvtepi16_epi32(levels)), scales)
}

/// Eight rows of samples to places `stride` apart.
#[target_feature(enable = "avx2")]
#[inline]
fn store(rows: [__m128i; 4], out: &mut [u8], stride: usize) {
    let out = out[..7 * stride + 8].as_mut_ptr();
    for (i, pair) in rows.into_iter().enumerate() {
        // SAFETY: the last of the rows, 7, has its 8 bytes within the slice, and the stores need no alignment.
        unsafe {
            _mm_storel_epi64(out.add(2 * i * stride).cast(), pair);
            _mm_storeh_pd(out.add((2 * i + 1) * stride).cast(), _mm_castsi128_pd(pair));
        }
    }
}

#[target_feature(enable = "avx2")]
#[inline]
fn transform(first: f32, block: &mut [i16; 64], scales: &[f32; 64], out: &mut [u8], stride: usize) {
    let mut rows: Rows = [_mm256_setzero_ps(); 8];
    for (i, row) in rows.iter_mut().enumerate() {
        *row = load(block, scales, i);
    }
    // Its place in the block is 0.
    rows[0] = _mm256_add_ps(rows[0], _mm256_zextps128_ps256(_mm_set_ss(first)));
    *block = [0; 64];
    let samples = columns(turned(columns(rows))).map(|row| rounded(row));
    // Four bytes of each of four rows, their left halves before their right ones.
    let mixed = |i: usize| {
        let (above, below) = (
            _mm256_packs_epi32(samples[i], samples[i + 1]),
            _mm256_packs_epi32(samples[i + 2], samples[i + 3]),
        );
        let order = _mm256_setr_epi32(0, 4, 1, 5, 2, 6, 3, 7);
        _mm256_permutevar8x32_epi32(_mm256_packus_epi16(above, below), order)
    };
    let halves = |rows| (_mm256_castsi256_si128(rows), _mm256_extracti128_si256::<1>(rows));
    let ((a, b), (c, d)) = (halves(mixed(0)), halves(mixed(4)));
    store([a, b, c, d], out, stride);
}

/// Moved to 0..=255 and rounded; what is below 0 the packing makes 0.
#[target_feature(enable = "avx2")]
#[inline]
fn rounded(x: __m256) -> __m256i {
    _mm256_cvtps_epi32(_mm256_min_ps(_mm256_add_ps(x, _mm256_set1_ps(128.0)), _mm256_set1_ps(255.0)))
}

/// See [`super::columns`].
#[target_feature(enable = "avx2")]
#[inline]
fn columns(r: Rows) -> Rows {
    let times = |x, k| _mm256_mul_ps(x, _mm256_set1_ps(k));
    let (sum, difference) = (_mm256_add_ps(r[0], r[4]), _mm256_sub_ps(r[0], r[4]));
    let outer = _mm256_add_ps(r[2], r[6]);
    let inner = _mm256_sub_ps(times(_mm256_sub_ps(r[2], r[6]), std::f32::consts::SQRT_2), outer);
    let even = [
        _mm256_add_ps(sum, outer),
        _mm256_add_ps(difference, inner),
        _mm256_sub_ps(difference, inner),
        _mm256_sub_ps(sum, outer),
    ];
    let (z13, z10) = (_mm256_add_ps(r[5], r[3]), _mm256_sub_ps(r[5], r[3]));
    let (z11, z12) = (_mm256_add_ps(r[1], r[7]), _mm256_sub_ps(r[1], r[7]));
    let odd0 = _mm256_add_ps(z11, z13);
    let z5 = times(_mm256_add_ps(z10, z12), 1.847_759_1);
    let odd1 = _mm256_sub_ps(_mm256_sub_ps(z5, times(z10, 2.613_126)), odd0);
    let odd2 = _mm256_sub_ps(times(_mm256_sub_ps(z11, z13), std::f32::consts::SQRT_2), odd1);
    let odd3 = _mm256_sub_ps(_mm256_sub_ps(z5, times(z12, 1.082_392_2)), odd2);
    [
        _mm256_add_ps(even[0], odd0),
        _mm256_add_ps(even[1], odd1),
        _mm256_add_ps(even[2], odd2),
        _mm256_add_ps(even[3], odd3),
        _mm256_sub_ps(even[3], odd3),
        _mm256_sub_ps(even[2], odd2),
        _mm256_sub_ps(even[1], odd1),
        _mm256_sub_ps(even[0], odd0),
    ]
}

/// Rows become columns.
#[target_feature(enable = "avx2")]
#[inline]
fn turned(r: Rows) -> Rows {
    let pair = |i: usize| (_mm256_unpacklo_ps(r[i], r[i + 1]), _mm256_unpackhi_ps(r[i], r[i + 1]));
    let [(a0, a1), (b0, b1), (c0, c1), (d0, d1)] = [pair(0), pair(2), pair(4), pair(6)];
    let four = |a, b| (_mm256_shuffle_ps::<0x44>(a, b), _mm256_shuffle_ps::<0xee>(a, b));
    let [(l0, l1), (l2, l3)] = [four(a0, b0), four(a1, b1)];
    let [(h0, h1), (h2, h3)] = [four(c0, d0), four(c1, d1)];
    let low = |l, h| _mm256_permute2f128_ps::<0x20>(l, h);
    let high = |l, h| _mm256_permute2f128_ps::<0x31>(l, h);
    [
        low(l0, h0),
        low(l1, h1),
        low(l2, h2),
        low(l3, h3),
        high(l0, h0),
        high(l1, h1),
        high(l2, h2),
        high(l3, h3),
    ]
}
