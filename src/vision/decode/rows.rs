//! Blocks of a component between reading and transform: those of one row of units.

use super::idct::{self, Kernel};

/// Coefficients of one component, row by row.
#[derive(Clone, Debug)]
pub(super) struct Rows {
    /// The first coefficients, which have their scale.
    firsts: Vec<f32>,
    /// Whether a block has more than its first coefficient.
    more: Vec<bool>,
    /// The others, 0 at the first place; all zeros in blocks that were transformed.
    pub(super) blocks: Vec<[i16; 64]>,
}

impl Rows {
    /// For at most so many blocks.
    pub(super) fn new(blocks: usize) -> Self {
        Self { firsts: vec![0.0; blocks], more: vec![false; blocks], blocks: vec![[0; 64]; blocks] }
    }

    /// Forgets what an earlier picture left behind.
    pub(super) fn clear(&mut self) {
        self.blocks.fill([0; 64]);
    }

    /// Completes block `i`.
    #[inline(always)]
    pub(super) fn set(&mut self, i: usize, first: f32, more: bool) {
        (self.firsts[i], self.more[i]) = (first, more);
    }

    /// Transforms a row of `columns` blocks, the first of which is number `begin`, to samples in lines `stride` apart.
    #[inline(always)]
    pub(super) fn transform(
        &mut self,
        kernel: impl Kernel,
        (begin, columns): (usize, usize),
        scales: &[f32; 64],
        out: &mut [u8],
        stride: usize,
    ) {
        let range = begin..begin + columns;
        let (firsts, more) = (&self.firsts[range.clone()], &self.more[range.clone()]);
        let (pairs, last) = self.blocks[range].as_chunks_mut::<2>();
        let all = pairs.iter_mut().zip(firsts.as_chunks::<2>().0).zip(more.as_chunks::<2>().0);
        for (i, ((blocks, firsts), more)) in all.enumerate() {
            let out = &mut out[16 * i..];
            if more[0] | more[1] {
                kernel.transform_two(*firsts, blocks, scales, out, stride);
            } else {
                idct::flat(firsts[0], out, stride);
                idct::flat(firsts[1], &mut out[8..], stride);
            }
        }
        if let ([block], [.., first]) = (last, firsts) {
            kernel.transform(*first, block, scales, &mut out[8 * (columns - 1)..], stride);
        }
    }
}
