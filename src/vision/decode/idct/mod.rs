//! The inverse cosine transform of a block in the scaled form of Arai, Agui and Nakajima (Trans. IEICE E71, 1988),
//! as eight columns at a time; the scale goes into the quantization table.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;

#[cfg(target_arch = "x86_64")]
pub(super) use {avx2::Avx2, avx512::Avx512};

/// Scale factors of the form, by row and by column.
const SCALE: [f64; 8] =
    [1.0, 1.387039845, 1.306562965, 1.175875602, 1.0, 0.785694958, 0.541196100, 0.275899379];

/// What a coefficient of this place is multiplied by, besides its quantization.
pub(super) fn scale(place: usize) -> f32 {
    (SCALE[place / 8] * SCALE[place % 8] / 8.0) as f32
}

type Row = [f32; 8];

#[inline(always)]
fn add(a: Row, b: Row) -> Row {
    let mut sum = a;
    for i in 0..8 {
        sum[i] += b[i];
    }
    sum
}

#[inline(always)]
fn sub(a: Row, b: Row) -> Row {
    let mut difference = a;
    for i in 0..8 {
        difference[i] -= b[i];
    }
    difference
}

#[inline(always)]
fn times(a: Row, k: f32) -> Row {
    let mut product = a;
    for v in &mut product {
        *v *= k;
    }
    product
}

/// The transform of eight columns.
#[inline(always)]
fn columns(r: [Row; 8]) -> [Row; 8] {
    // Even part.
    let (sum, difference) = (add(r[0], r[4]), sub(r[0], r[4]));
    let outer = add(r[2], r[6]);
    let inner = sub(times(sub(r[2], r[6]), std::f32::consts::SQRT_2), outer);
    let even = [add(sum, outer), add(difference, inner), sub(difference, inner), sub(sum, outer)];
    // Odd part.
    let (z13, z10) = (add(r[5], r[3]), sub(r[5], r[3]));
    let (z11, z12) = (add(r[1], r[7]), sub(r[1], r[7]));
    let odd0 = add(z11, z13);
    let z5 = times(add(z10, z12), 1.847_759_1);
    let odd1 = sub(sub(z5, times(z10, 2.613_126)), odd0);
    let odd2 = sub(times(sub(z11, z13), std::f32::consts::SQRT_2), odd1);
    let odd3 = sub(sub(z5, times(z12, 1.082_392_2)), odd2);
    [
        add(even[0], odd0),
        add(even[1], odd1),
        add(even[2], odd2),
        add(even[3], odd3),
        sub(even[3], odd3),
        sub(even[2], odd2),
        sub(even[1], odd1),
        sub(even[0], odd0),
    ]
}

/// The transform as some instructions do it; all give the same bits.
pub(super) trait Kernel: Copy {
    /// Coefficients, stored column by column, times their `scales`, to 8x8 samples, which go to `out` in rows
    /// `stride` apart. The first coefficient is `first`, which has its scale already; `block` has 0 there and is all
    /// zeros afterwards.
    fn transform(self, first: f32, block: &mut [i16; 64], scales: &[f32; 64], out: &mut [u8], stride: usize);

    /// The same of two blocks beside each other.
    #[inline(always)]
    fn transform_two(
        self,
        firsts: [f32; 2],
        blocks: &mut [[i16; 64]; 2],
        scales: &[f32; 64],
        out: &mut [u8],
        stride: usize,
    ) {
        for (i, (first, block)) in firsts.into_iter().zip(blocks).enumerate() {
            self.transform(first, block, scales, &mut out[8 * i..], stride);
        }
    }
}

/// The kernel of every machine, and the twin of the others.
#[derive(Clone, Copy)]
pub(super) struct Plain;

impl Kernel for Plain {
    #[inline(always)]
    fn transform(self, first: f32, block: &mut [i16; 64], scales: &[f32; 64], out: &mut [u8], stride: usize) {
        let mut scaled = [0.0; 64];
        for (to, (&level, scale)) in scaled.iter_mut().zip(block.iter().zip(scales)) {
            *to = f32::from(level) * scale;
        }
        scaled[0] = first;
        *block = [0; 64];
        transform(&scaled, out, stride);
    }
}

/// Scaled coefficients to samples.
#[inline(always)]
fn transform(block: &[f32; 64], out: &mut [u8], stride: usize) {
    let (rows, _) = block.as_chunks::<8>();
    let half = columns([rows[0], rows[1], rows[2], rows[3], rows[4], rows[5], rows[6], rows[7]]);
    let mut turned = [[0.0; 8]; 8];
    for (y, row) in turned.iter_mut().enumerate() {
        for (x, v) in row.iter_mut().enumerate() {
            *v = half[x][y];
        }
    }
    let whole = columns(turned);
    // All 64 in one loop, which the compiler takes many at once.
    let mut samples = [0; 64];
    for (out, &v) in samples.iter_mut().zip(whole.as_flattened()) {
        *out = sample(v);
    }
    for (row, out) in samples.as_chunks::<8>().0.iter().zip(out.chunks_mut(stride)) {
        if let Some(out) = out.first_chunk_mut::<8>() {
            *out = *row;
        }
    }
}

/// A block without any coefficient but the first.
#[inline(always)]
pub(super) fn flat(first: f32, out: &mut [u8], stride: usize) {
    let value = sample(first);
    for out in out.chunks_mut(stride).take(8) {
        out[..8].fill(value);
    }
}

/// Rounds and moves to 0..=255. Beside 2^23 the last bit of an `f32` is worth 1.
#[inline(always)]
fn sample(x: f32) -> u8 {
    ((x + 128.0).clamp(0.0, 255.0) + 8_388_608.0).to_bits() as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::level::Level;
    use proptest::prelude::*;

    /// Two blocks for a kernel.
    struct Task {
        firsts: [f32; 2],
        blocks: [[i16; 64]; 2],
        scales: [f32; 64],
        stride: usize,
    }

    impl Task {
        /// The first block by itself, then both.
        fn with(&self, kernel: impl Kernel) -> [Vec<u8>; 2] {
            let (mut one, mut both) = (vec![0; 7 * self.stride + 8], vec![0; 7 * self.stride + 16]);
            let (mut block, mut blocks) = (self.blocks[0], self.blocks);
            kernel.transform(self.firsts[0], &mut block, &self.scales, &mut one, self.stride);
            kernel.transform_two(self.firsts, &mut blocks, &self.scales, &mut both, self.stride);
            assert_eq!((block, blocks), ([0; 64], [[0; 64]; 2]));
            [one, both]
        }
    }

    #[cfg(target_arch = "x86_64")]
    proptest! {
        #[test]
        fn all_instructions_give_the_same_samples(
            places in proptest::collection::vec((1usize..64, any::<i16>(), 0u32..16), 0..64),
            first in -3e9..3e9f32, quiet in 0u32..22, scale in 0.01..300.0f32, stride in 16usize..28,
        ) {
            let mut block = [0; 64];
            for (place, value, less) in places {
                block[place] = value >> less;
            }
            let scales = std::array::from_fn(|place| scale * super::scale(place));
            let first = first / (1 << quiet) as f32;
            // The other one: turned, and with another first coefficient.
            let mut other = block;
            other[1..].reverse();
            let task = Task { firsts: [first, 40.0 - first / 2.0], blocks: [block, other], scales, stride };
            let expected = task.with(Plain);
            for level in Level::available() {
                match level {
                    Level::Plain => {}
                    // SAFETY: the machine has it.
                    Level::Avx2 => prop_assert_eq!(&task.with(unsafe { Avx2::new() }), &expected),
                    // SAFETY: the machine has it.
                    Level::Avx512 => prop_assert_eq!(&task.with(unsafe { Avx512::new() }), &expected),
                }
            }
        }
    }

    #[test]
    fn a_block_is_the_sum_of_its_cosines() {
        let mut coefficients = [0.0; 64];
        for (place, value) in [(0, 80.0), (1, -60.0), (8, 45.0), (27, 30.0), (63, -20.0), (42, 12.5)] {
            coefficients[place] = value;
        }
        let scaled: [f32; 64] = std::array::from_fn(|i| coefficients[i % 8 * 8 + i / 8] * scale(i));
        let mut out = [0; 64];
        transform(&scaled, &mut out, 8);
        for y in 0..8 {
            for x in 0..8 {
                let mut sum = 0.0f64;
                for (place, &value) in coefficients.iter().enumerate() {
                    let (v, u) = (place / 8, place % 8);
                    let c = |k: usize| if k == 0 { std::f64::consts::FRAC_1_SQRT_2 } else { 1.0 };
                    let wave = |at: usize, k: usize| {
                        ((2 * at + 1) as f64 * k as f64 * std::f64::consts::PI / 16.0).cos()
                    };
                    sum += c(u) * c(v) / 4.0 * f64::from(value) * wave(x, u) * wave(y, v);
                }
                assert!((f64::from(out[8 * y + x]) - 128.0 - sum).abs() < 0.51, "({x}, {y})");
            }
        }
        let mut filled = [0; 64];
        flat(80.0 * scale(0), &mut filled, 8);
        assert_eq!(filled, [138; 64]);
    }
}
