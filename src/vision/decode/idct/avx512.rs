//! The transform of two blocks beside each other, a row of both a register. The safe twin is [`super::Plain`], as for
//! [`super::avx2`].
//!
//! [`load`], [`store`] and the promise of [`Avx512::new`] are the only unsafe code.

use super::{Avx2, Kernel};
use std::arch::x86_64::*;

/// The kernel; a value of it is the proof that the machine has AVX-512 F, BW, DQ and VL.
#[derive(Clone, Copy)]
pub(in super::super) struct Avx512(Avx2);

impl Avx512 {
    /// # Safety
    /// The machine has AVX2 and AVX-512 F, BW, DQ and VL.
    pub(in super::super) unsafe fn new() -> Self {
        // SAFETY: the caller's promise.
        Self(unsafe { Avx2::new() })
    }
}

impl Kernel for Avx512 {
    #[inline(always)]
    fn transform(self, first: f32, block: &mut [i16; 64], scales: &[f32; 64], out: &mut [u8], stride: usize) {
        self.0.transform(first, block, scales, out, stride);
    }

    #[inline(always)]
    fn transform_two(
        self,
        firsts: [f32; 2],
        blocks: &mut [[i16; 64]; 2],
        scales: &[f32; 64],
        out: &mut [u8],
        stride: usize,
    ) {
        // SAFETY: the value proves the instructions.
        unsafe { transform_two(firsts, blocks, scales, out, stride) }
    }
}

type Rows = [__m512; 8];

/// Row `i` of both blocks times its scales.
#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl")]
#[inline]
fn load(blocks: &[[i16; 64]; 2], scales: &[f32; 64], i: usize) -> __m512 {
    let [left, right] = blocks.each_ref().map(|block| &block.as_chunks::<8>().0[i]);
    let scales = &scales.as_chunks::<8>().0[i];
    // SAFETY: the references are to 16, 16 and 32 readable bytes, and the loads need no alignment.
    let (left, right, scales) = unsafe {
        (
            _mm_loadu_si128(left.as_ptr().cast()),
            _mm_loadu_si128(right.as_ptr().cast()),
            _mm256_loadu_ps(scales.as_ptr()),
        )
    };
    let levels = _mm512_cvtepi32_ps(_mm512_cvtepi16_epi32(_mm256_set_m128i(right, left)));
    _mm512_mul_ps(levels, _mm512_broadcast_f32x8(scales))
}

/// Eight rows of 16 samples to places `stride` apart.
#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl")]
#[inline]
fn store(rows: [__m512i; 2], out: &mut [u8], stride: usize) {
    let out = out[..7 * stride + 16].as_mut_ptr();
    for (i, four) in rows.into_iter().enumerate() {
        let four = [
            _mm512_castsi512_si128(four),
            _mm512_extracti32x4_epi32::<1>(four),
            _mm512_extracti32x4_epi32::<2>(four),
            _mm512_extracti32x4_epi32::<3>(four),
        ];
        for (k, row) in four.into_iter().enumerate() {
            // SAFETY: the last of the rows, 7, has its 16 bytes within the slice, and the stores need no alignment.
            unsafe { _mm_storeu_si128(out.add((4 * i + k) * stride).cast(), row) };
        }
    }
}

#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl")]
#[inline]
fn transform_two(
    firsts: [f32; 2],
    blocks: &mut [[i16; 64]; 2],
    scales: &[f32; 64],
    out: &mut [u8],
    stride: usize,
) {
    let mut rows: Rows = [_mm512_setzero_ps(); 8];
    for (i, row) in rows.iter_mut().enumerate() {
        *row = load(blocks, scales, i);
    }
    // Their places in the blocks are 0.
    rows[0] = _mm512_mask_blend_ps(1, rows[0], _mm512_set1_ps(firsts[0]));
    rows[0] = _mm512_mask_blend_ps(1 << 8, rows[0], _mm512_set1_ps(firsts[1]));
    *blocks = [[0; 64]; 2];
    let samples = columns(turned(columns(rows))).map(|row| rounded(row));
    // Four bytes of each of four rows: the left halves of the first block, of the second, then the right halves.
    let mixed = |i: usize| {
        let (above, below) = (
            _mm512_packs_epi32(samples[i], samples[i + 1]),
            _mm512_packs_epi32(samples[i + 2], samples[i + 3]),
        );
        let order = _mm512_setr_epi32(0, 8, 4, 12, 1, 9, 5, 13, 2, 10, 6, 14, 3, 11, 7, 15);
        _mm512_permutexvar_epi32(order, _mm512_packus_epi16(above, below))
    };
    store([mixed(0), mixed(4)], out, stride);
}

/// Moved to 0..=255 and rounded; what is below 0 the packing makes 0.
#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl")]
#[inline]
fn rounded(x: __m512) -> __m512i {
    _mm512_cvtps_epi32(_mm512_min_ps(_mm512_add_ps(x, _mm512_set1_ps(128.0)), _mm512_set1_ps(255.0)))
}

/// See [`super::columns`].
#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl")]
#[inline]
fn columns(r: Rows) -> Rows {
    let times = |x, k| _mm512_mul_ps(x, _mm512_set1_ps(k));
    let (sum, difference) = (_mm512_add_ps(r[0], r[4]), _mm512_sub_ps(r[0], r[4]));
    let outer = _mm512_add_ps(r[2], r[6]);
    let inner = _mm512_sub_ps(times(_mm512_sub_ps(r[2], r[6]), std::f32::consts::SQRT_2), outer);
    let even = [
        _mm512_add_ps(sum, outer),
        _mm512_add_ps(difference, inner),
        _mm512_sub_ps(difference, inner),
        _mm512_sub_ps(sum, outer),
    ];
    let (z13, z10) = (_mm512_add_ps(r[5], r[3]), _mm512_sub_ps(r[5], r[3]));
    let (z11, z12) = (_mm512_add_ps(r[1], r[7]), _mm512_sub_ps(r[1], r[7]));
    let odd0 = _mm512_add_ps(z11, z13);
    let z5 = times(_mm512_add_ps(z10, z12), 1.847_759_1);
    let odd1 = _mm512_sub_ps(_mm512_sub_ps(z5, times(z10, 2.613_126)), odd0);
    let odd2 = _mm512_sub_ps(times(_mm512_sub_ps(z11, z13), std::f32::consts::SQRT_2), odd1);
    let odd3 = _mm512_sub_ps(_mm512_sub_ps(z5, times(z12, 1.082_392_2)), odd2);
    [
        _mm512_add_ps(even[0], odd0),
        _mm512_add_ps(even[1], odd1),
        _mm512_add_ps(even[2], odd2),
        _mm512_add_ps(even[3], odd3),
        _mm512_sub_ps(even[3], odd3),
        _mm512_sub_ps(even[2], odd2),
        _mm512_sub_ps(even[1], odd1),
        _mm512_sub_ps(even[0], odd0),
    ]
}

/// Rows of both blocks become columns; quarters of the results: the left half of the first block, of the second, then
/// their right halves.
#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl")]
#[inline]
fn turned(r: Rows) -> Rows {
    let pair = |i: usize| (_mm512_unpacklo_ps(r[i], r[i + 1]), _mm512_unpackhi_ps(r[i], r[i + 1]));
    let [(a0, a1), (b0, b1), (c0, c1), (d0, d1)] = [pair(0), pair(2), pair(4), pair(6)];
    let four = |a, b| (_mm512_shuffle_ps::<0x44>(a, b), _mm512_shuffle_ps::<0xee>(a, b));
    let [(l0, l1), (l2, l3)] = [four(a0, b0), four(a1, b1)];
    let [(h0, h1), (h2, h3)] = [four(c0, d0), four(c1, d1)];
    let low = |l, h| _mm512_shuffle_f32x4::<0b10_00_10_00>(l, h);
    let high = |l, h| _mm512_shuffle_f32x4::<0b11_01_11_01>(l, h);
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
