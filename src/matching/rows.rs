//! Distances of one point to many, compared with many lengths at once, and what else is asked of many points in one go:
//! the inner loops of the gate and of all searches by length.
//!
//! The answers are rows of one bit a point. The AVX-512 versions compute the same sums in the same order as the
//! plain ones, so both give the same bits; tests compare them.

use crate::level::Level;

/// Points as three lists of coordinates, filled up with infinity to a multiple of [`CHUNK`], and the image nodes that
/// show them.
#[derive(Clone, Debug, Default)]
pub struct Points {
    xs: Vec<f32>,
    ys: Vec<f32>,
    zs: Vec<f32>,
    /// The left and the right node of each, filled up as well.
    image_nodes: [Vec<u16>; 2],
    len: usize,
}

/// Points a word of the answer.
pub const CHUNK: usize = 64;

impl Points {
    /// Memory for this many points.
    pub fn with_capacity(points: usize) -> Self {
        let padded = points.next_multiple_of(CHUNK);
        let list = || Vec::with_capacity(padded);
        let image_nodes = [Vec::with_capacity(padded), Vec::with_capacity(padded)];
        Self { xs: list(), ys: list(), zs: list(), image_nodes, len: 0 }
    }

    /// Takes these points, each with its left and its right node.
    pub fn fill(&mut self, points: impl Iterator<Item = ([f32; 3], [u16; 2])>) {
        let Self { xs, ys, zs, image_nodes: [lefts, rights], len } = self;
        [&mut *xs, &mut *ys, &mut *zs].into_iter().for_each(Vec::clear);
        [&mut *lefts, &mut *rights].into_iter().for_each(Vec::clear);
        for ([x, y, z], [left, right]) in points {
            xs.push(x);
            ys.push(y);
            zs.push(z);
            lefts.push(left);
            rights.push(right);
        }
        *len = xs.len();
        let padded = len.next_multiple_of(CHUNK);
        [xs, ys, zs].into_iter().for_each(|list| list.resize(padded, f32::INFINITY));
        [lefts, rights].into_iter().for_each(|list| list.resize(padded, u16::MAX));
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

/// Sets bit `n` of row `r` of `rows` (of [`Points::words`] words each) where the distance of point `n` from `at` differs from `wanted_mm[r]` by
/// `tolerance_mm` at most, and neither of its image nodes is that of `at`.
///
/// # Panics
/// Where `rows` is shorter than one row for each of the distances.
pub fn at_distance(
    level: Level,
    points: &Points,
    at: ([f32; 3], [u16; 2]),
    wanted_mm: &[f32],
    tolerance_mm: f32,
    rows: &mut [u64],
) {
    assert!(
        rows.len() >= wanted_mm.len() * points.words(),
        "{} words for {} rows",
        rows.len(),
        wanted_mm.len()
    );
    #[cfg(target_arch = "x86_64")]
    if level.supported() == Level::Avx512 {
        // SAFETY: the machine has AVX-512, and the length of `rows` was checked above.
        unsafe { at_distance_avx512(points, at, wanted_mm, tolerance_mm, rows) };
        return;
    }
    let _ = level;
    at_distance_plain(points, at, wanted_mm, tolerance_mm, rows);
}

fn at_distance_plain(
    points: &Points,
    (at, image_nodes): ([f32; 3], [u16; 2]),
    wanted_mm: &[f32],
    tolerance_mm: f32,
    rows: &mut [u64],
) {
    let words = points.words();
    let mut distance_mm = [0f32; CHUNK];
    for w in 0..words {
        let chunk = w * CHUNK..(w + 1) * CHUNK;
        let (xs, ys, zs) = (&points.xs[chunk.clone()], &points.ys[chunk.clone()], &points.zs[chunk.clone()]);
        for (k, distance) in distance_mm.iter_mut().enumerate() {
            let (x, y, z) = (xs[k] - at[0], ys[k] - at[1], zs[k] - at[2]);
            *distance = (x * x + y * y + z * z).sqrt();
        }
        let mut same = 0;
        for (list, node) in points.image_nodes.iter().zip(image_nodes) {
            for (k, other) in list[chunk.clone()].iter().enumerate() {
                same |= ((*other == node) as u64) << k;
            }
        }
        for (r, wanted) in wanted_mm.iter().enumerate() {
            let mut word = 0;
            for (k, distance) in distance_mm.iter().enumerate() {
                word |= (((distance - wanted).abs() <= tolerance_mm) as u64) << k;
            }
            rows[r * words + w] = word & !same;
        }
    }
}

/// # Safety
/// The processor has AVX-512 F and BW; `rows` holds `wanted_mm.len() * points.words()` words.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512bw")]
unsafe fn at_distance_avx512(
    points: &Points,
    (at, image_nodes): ([f32; 3], [u16; 2]),
    wanted_mm: &[f32],
    tolerance_mm: f32,
    rows: &mut [u64],
) {
    use std::arch::x86_64::*;
    let (words, quarters) = (points.words(), points.len().div_ceil(16));
    let [ax, ay, az] = at.map(|v| _mm512_set1_ps(v));
    let image_nodes = image_nodes.map(|n| _mm512_set1_epi16(n as i16));
    let tolerance = _mm512_set1_ps(tolerance_mm);
    for w in 0..words {
        let mut distances = [_mm512_set1_ps(f32::INFINITY); 4];
        let filled = (quarters - w * 4).min(4);
        for (q, distance) in distances.iter_mut().enumerate().take(filled) {
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
            let squared =
                _mm512_add_ps(_mm512_add_ps(_mm512_mul_ps(x, x), _mm512_mul_ps(y, y)), _mm512_mul_ps(z, z));
            *distance = _mm512_sqrt_ps(squared);
        }
        let mut same = 0;
        for (list, node) in points.image_nodes.iter().zip(image_nodes) {
            for half in 0..2 {
                // SAFETY: 64 w + 32 half + 32 <= words * 64, the length of each list.
                let others = unsafe { _mm512_loadu_epi16(list.as_ptr().add(w * CHUNK + half * 32).cast()) };
                same |= (_mm512_cmpeq_epi16_mask(others, node) as u64) << (32 * half);
            }
        }
        for (r, &wanted) in wanted_mm.iter().enumerate() {
            let wanted = _mm512_set1_ps(wanted);
            let mut word = 0;
            for (q, &distance) in distances.iter().enumerate().take(filled) {
                let off = _mm512_abs_ps(_mm512_sub_ps(distance, wanted));
                word |= (_mm512_cmp_ps_mask::<_CMP_LE_OQ>(off, tolerance) as u64) << (16 * q);
            }
            rows[r * words + w] = word & !same;
        }
    }
}

/// The common bits of two lists of rows of `words` words each, and how many every row has; only of rows with a bit in
/// `wanted`.
///
/// # Panics
/// Where a list has not all wanted rows.
#[inline]
pub fn intersect(
    level: Level,
    [a, b]: [&[u64]; 2],
    words: usize,
    wanted: u32,
    common: &mut [u64],
    counts: &mut [u32],
) {
    #[cfg(target_arch = "x86_64")]
    if level.supported() != Level::Plain {
        // SAFETY: the machine has a level above the plain one, and with it POPCNT.
        unsafe { intersect_counted([a, b], words, wanted, common, counts) };
        return;
    }
    let _ = level;
    intersect_any([a, b], words, wanted, common, counts);
}

/// # Safety
/// The processor has POPCNT.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "popcnt")]
unsafe fn intersect_counted(
    lists: [&[u64]; 2],
    words: usize,
    wanted: u32,
    common: &mut [u64],
    counts: &mut [u32],
) {
    intersect_any(lists, words, wanted, common, counts);
}

#[inline(always)]
fn intersect_any([a, b]: [&[u64]; 2], words: usize, wanted: u32, common: &mut [u64], counts: &mut [u32]) {
    let mut left = wanted;
    while left != 0 {
        let r = left.trailing_zeros() as usize;
        left &= left - 1;
        let row = r * words..(r + 1) * words;
        let (a, b) = (&a[row.clone()], &b[row.clone()]);
        let mut count = 0;
        for (common, (a, b)) in common[row].iter_mut().zip(a.iter().zip(b)) {
            *common = a & b;
            count += common.count_ones();
        }
        counts[r] = count;
    }
}

/// Sets bit `n` of `row` where point `n` of a picture is at most `widest_px` from a line; the distance is
/// `|line[0] x + line[1] y + line[2]|`. The lists are filled up with what is not a number to a multiple of [`CHUNK`].
///
/// # Panics
/// Where a list is shorter than [`CHUNK`] entries a word.
pub fn near_line(level: Level, [xs, ys]: [&[f32]; 2], line: [f32; 3], widest_px: f32, row: &mut [u64]) {
    let long = row.len() * CHUNK;
    assert!(
        xs.len() >= long && ys.len() >= long,
        "{} points for {} words",
        xs.len().min(ys.len()),
        row.len()
    );
    #[cfg(target_arch = "x86_64")]
    if level.supported() == Level::Avx512 {
        // SAFETY: the machine has AVX-512, and the lengths were checked above.
        unsafe { near_line_avx512([xs, ys], line, widest_px, row) };
        return;
    }
    let _ = level;
    near_line_plain([xs, ys], line, widest_px, row);
}

fn near_line_plain([xs, ys]: [&[f32]; 2], line: [f32; 3], widest_px: f32, row: &mut [u64]) {
    for (word, (xs, ys)) in row.iter_mut().zip(xs.chunks_exact(CHUNK).zip(ys.chunks_exact(CHUNK))) {
        *word = 0;
        for (k, (x, y)) in xs.iter().zip(ys).enumerate() {
            let gap_px = (line[0] * x + line[1] * y + line[2]).abs();
            *word |= ((gap_px <= widest_px) as u64) << k;
        }
    }
}

/// # Safety
/// The processor has AVX-512 F; the lists have 64 entries for every word of `row`.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f")]
unsafe fn near_line_avx512([xs, ys]: [&[f32]; 2], line: [f32; 3], widest_px: f32, row: &mut [u64]) {
    use std::arch::x86_64::*;
    let [a, b, c] = line.map(|v| _mm512_set1_ps(v));
    let widest = _mm512_set1_ps(widest_px);
    for (w, word) in row.iter_mut().enumerate() {
        *word = 0;
        for q in 0..4 {
            let i = w * CHUNK + q * 16;
            // SAFETY: i + 16 <= 64 (w + 1) <= the length of both lists.
            let (x, y) =
                unsafe { (_mm512_loadu_ps(xs.as_ptr().add(i)), _mm512_loadu_ps(ys.as_ptr().add(i))) };
            let gap =
                _mm512_abs_ps(_mm512_add_ps(_mm512_add_ps(_mm512_mul_ps(a, x), _mm512_mul_ps(b, y)), c));
            *word |= (_mm512_cmp_ps_mask::<_CMP_LE_OQ>(gap, widest) as u64) << (16 * q);
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

    /// Image nodes that some share.
    fn labelled(points: &[[f32; 3]]) -> impl Iterator<Item = ([f32; 3], [u16; 2])> {
        points.iter().enumerate().map(|(n, p)| (*p, [n as u16 / 2, (p[0].abs() / 20.0) as u16]))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn every_level_gives_the_same_rows(
            points in prop::collection::vec(prop::array::uniform3(-200f32..200.0), 1..300),
            lengths in prop::collection::vec(0f32..300.0, 1..5),
            tolerance in 0f32..20.0,
        ) {
            let mut lists = Points::with_capacity(300);
            lists.fill(labelled(&points));
            let words = lists.words();
            let mut plain = vec![0; lengths.len() * words];
            let at = labelled(&points).next().unwrap();
            at_distance_plain(&lists, at, &lengths, tolerance, &mut plain);
            for (n, (p, nodes)) in labelled(&points).enumerate() {
                let [x, y, z] = [0, 1, 2].map(|k| p[k] - points[0][k]);
                let distance = (x * x + y * y + z * z).sqrt();
                let apart = nodes[0] != at.1[0] && nodes[1] != at.1[1];
                for (r, length) in lengths.iter().enumerate() {
                    let bit = plain[r * words + n / CHUNK] >> (n % CHUNK) & 1 == 1;
                    prop_assert_eq!(bit, apart && (distance - length).abs() <= tolerance);
                }
            }
            let (mut xs, mut ys): (Vec<f32>, Vec<f32>) = points.iter().map(|p| (p[0], p[1])).unzip();
            [&mut xs, &mut ys].into_iter().for_each(|list| list.resize(words * CHUNK, f32::NAN));
            let line = [0.6, lengths[0] / 100.0, -tolerance];
            let mut near = vec![!0; words];
            near_line_plain([&xs, &ys], line, tolerance, &mut near);
            for level in Level::available() {
                let mut rows = vec![!0; plain.len()];
                at_distance(*level, &lists, at, &lengths, tolerance, &mut rows);
                prop_assert_eq!(&rows, &plain);
                let mut row = vec![!0; words];
                near_line(*level, [&xs, &ys], line, tolerance, &mut row);
                prop_assert_eq!(&row, &near);
                let (mut common, mut counts) = (vec![!0; 2 * words], [7; 2]);
                let twice = [near.clone(), near.clone()].concat();
                intersect(*level, [&twice, &twice], words, 2, &mut common, &mut counts);
                prop_assert_eq!(counts, [7, near.iter().map(|w| w.count_ones()).sum()]);
                prop_assert!(common[..words].iter().all(|w| *w == !0) && common[words..] == near);
                intersect(*level, [&near, &plain], words, 1, &mut common, &mut counts);
                prop_assert!((0..words).all(|w| common[w] == near[w] & plain[w]));
            }
        }
    }
}
