//! Distances of one point to many, compared with many lengths at once: the inner loop of all searches by length.
//!
//! [`within`] gives one bit a point and length. The AVX-512 version computes the same sums in the same order as the
//! plain one, so both give the same bits; a test compares them.

use crate::vision::level::Level;

/// Points as three lists of coordinates, filled up with infinity to a multiple of [`CHUNK`].
#[derive(Clone, Debug, Default)]
pub struct Points {
    xs: Vec<f32>,
    ys: Vec<f32>,
    zs: Vec<f32>,
    len: usize,
}

/// Points a word of the answer.
pub const CHUNK: usize = 64;

impl Points {
    /// Memory for this many points.
    pub fn with_capacity(points: usize) -> Self {
        let list = || Vec::with_capacity(points.next_multiple_of(CHUNK));
        Self { xs: list(), ys: list(), zs: list(), len: 0 }
    }

    /// Takes these points.
    pub fn fill(&mut self, points: impl Iterator<Item = [f32; 3]>) {
        let Self { xs, ys, zs, len } = self;
        xs.clear();
        ys.clear();
        zs.clear();
        for [x, y, z] in points {
            xs.push(x);
            ys.push(y);
            zs.push(z);
        }
        *len = xs.len();
        let padded = len.next_multiple_of(CHUNK);
        for list in [xs, ys, zs] {
            list.resize(padded, f32::INFINITY);
        }
    }

    /// How many points.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Words a row of the answer has.
    pub fn words(&self) -> usize {
        self.xs.len() / CHUNK
    }
}

/// The square of the least and the greatest distance, mm².
pub type Limits = (f32, f32);

/// Limits about a length.
pub fn limits(length_mm: f64, tolerance_mm: f64) -> Limits {
    let (low, high) = ((length_mm - tolerance_mm).max(0.0) as f32, (length_mm + tolerance_mm) as f32);
    (low * low, high * high)
}

/// Sets bit `n` of row `r` of `rows` (of [`Points::words`] words each) where the distance of point `n` from `at`,
/// squared, is within `limits[r]`, ends included.
///
/// # Panics
/// Where `rows` is shorter than one row for each of the limits.
pub fn within(level: Level, points: &Points, at: [f32; 3], limits: &[Limits], rows: &mut [u64]) {
    assert!(rows.len() >= limits.len() * points.words(), "rows for all limits");
    #[cfg(target_arch = "x86_64")]
    if level == Level::Avx512 {
        // SAFETY: `Level::Avx512` is only made where the processor has it; the lists hold `words() * 64` values each
        // (private fields, filled in `fill` alone), and the length of `rows` was checked above.
        unsafe { within_avx512(points, at, limits, rows) };
        return;
    }
    let _ = level;
    within_plain(points, at, limits, rows);
}

fn within_plain(points: &Points, at: [f32; 3], limits: &[Limits], rows: &mut [u64]) {
    let words = points.words();
    let mut squared = [0f32; CHUNK];
    for w in 0..words {
        let chunk = w * CHUNK..(w + 1) * CHUNK;
        let (xs, ys, zs) = (&points.xs[chunk.clone()], &points.ys[chunk.clone()], &points.zs[chunk]);
        for (k, s) in squared.iter_mut().enumerate() {
            let (x, y, z) = (xs[k] - at[0], ys[k] - at[1], zs[k] - at[2]);
            *s = x * x + y * y + z * z;
        }
        for (r, &(low, high)) in limits.iter().enumerate() {
            let mut word = 0;
            for (k, &s) in squared.iter().enumerate() {
                word |= (((s >= low) & (s <= high)) as u64) << k;
            }
            rows[r * words + w] = word;
        }
    }
}

/// # Safety
/// The processor has AVX-512 F; `rows` holds `limits.len() * points.words()` words.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f")]
unsafe fn within_avx512(points: &Points, at: [f32; 3], limits: &[Limits], rows: &mut [u64]) {
    use std::arch::x86_64::*;
    let words = points.words();
    let [ax, ay, az] = at.map(|v| _mm512_set1_ps(v));
    for w in 0..words {
        let mut squared = [_mm512_setzero_ps(); 4];
        for (q, s) in squared.iter_mut().enumerate() {
            let i = w * CHUNK + q * 16;
            // SAFETY: i + 16 <= words * 64, the length of each list.
            let (x, y, z) = unsafe {
                (
                    _mm512_loadu_ps(points.xs.as_ptr().add(i)),
                    _mm512_loadu_ps(points.ys.as_ptr().add(i)),
                    _mm512_loadu_ps(points.zs.as_ptr().add(i)),
                )
            };
            let (x, y, z) = (_mm512_sub_ps(x, ax), _mm512_sub_ps(y, ay), _mm512_sub_ps(z, az));
            *s = _mm512_add_ps(_mm512_add_ps(_mm512_mul_ps(x, x), _mm512_mul_ps(y, y)), _mm512_mul_ps(z, z));
        }
        for (r, &(low, high)) in limits.iter().enumerate() {
            let (low, high) = (_mm512_set1_ps(low), _mm512_set1_ps(high));
            let mut word = 0;
            for (q, &s) in squared.iter().enumerate() {
                let fits =
                    _mm512_mask_cmp_ps_mask::<_CMP_LE_OQ>(_mm512_cmp_ps_mask::<_CMP_GE_OQ>(s, low), s, high);
                word |= (fits as u64) << (16 * q);
            }
            rows[r * words + w] = word;
        }
    }
}

/// Calls `found` with the number of every set bit, lowest first.
#[inline]
pub fn for_bits(words: &[u64], mut found: impl FnMut(usize)) {
    for (w, &word) in words.iter().enumerate() {
        let mut left = word;
        while left != 0 {
            found(w * CHUNK + left.trailing_zeros() as usize);
            left &= left - 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn every_level_finds_the_same_points(
            points in prop::collection::vec(prop::array::uniform3(-200f32..200.0), 1..300),
            lengths in prop::collection::vec(1f64..300.0, 1..5),
        ) {
            let mut lists = Points::with_capacity(300);
            lists.fill(points.iter().copied());
            let limits: Vec<Limits> = lengths.iter().map(|l| limits(*l, 6.0)).collect();
            let mut plain = vec![0; limits.len() * lists.words()];
            within_plain(&lists, points[0], &limits, &mut plain);
            for level in Level::available() {
                let mut rows = vec![!0; plain.len()];
                within(*level, &lists, points[0], &limits, &mut rows);
                prop_assert_eq!(&rows, &plain);
            }
            for (r, l) in lengths.iter().enumerate() {
                let mut bits = Vec::new();
                for_bits(&plain[r * lists.words()..(r + 1) * lists.words()], |n| bits.push(n));
                let distance = |p: &[f32; 3]| -> f64 {
                    (0..3).map(|k| (p[k] - points[0][k]).powi(2) as f64).sum::<f64>().sqrt()
                };
                // a thousandth of a millimetre of doubt for single precision
                for (n, p) in points.iter().enumerate() {
                    let off = (distance(p) - l).abs();
                    prop_assert!(off >= 5.999 || bits.contains(&n));
                    prop_assert!(off <= 6.001 || !bits.contains(&n));
                }
            }
        }
    }
}
