//! Walks a picture in blocks of 64 pixels, a word of the bit image each. Reads by bounds-checked slices, so that
//! the code for one instruction set needs no pointer arithmetic.

use crate::vision::bits::{BitImage, PAD_ROWS};
use std::ops::Range;

/// Rows of bytes, `block` bytes to 64 pixels.
#[derive(Clone, Copy)]
pub(super) struct Rows<'a> {
    pub(super) bytes: &'a [u8],
    pub(super) stride: usize,
    pub(super) block: usize,
}

impl<'a> Rows<'a> {
    /// The `N` bytes from the beginning of block `s` of row `y`; `spare` is filled and lent where the picture ends
    /// sooner.
    #[inline(always)]
    pub(super) fn at<'b, const N: usize>(&self, y: usize, s: usize, spare: &'b mut [u8; N]) -> &'b [u8; N]
    where
        'a: 'b,
    {
        let rest = self.bytes.get(y * self.stride + s * self.block..).unwrap_or_default();
        if let Some(whole) = rest.first_chunk() {
            return whole;
        }
        spare[..rest.len()].copy_from_slice(rest);
        spare
    }
}

/// Sets the words of rows `ys` to what `word` makes of their bytes; it is given strip and bytes.
#[inline(always)]
pub(super) fn each<const N: usize>(
    rows: Rows<'_>,
    ys: Range<usize>,
    bits: &mut BitImage,
    word: impl Fn(usize, &[u8; N]) -> u64,
) {
    let (strips, stride) = (bits.strips(), bits.strip_stride());
    let last = bits.strip_mask(strips - 1);
    let words = bits.words_mut();
    let mut spare = [0; N];
    for y in ys {
        for s in 0..strips {
            let mask = if s + 1 == strips { last } else { u64::MAX };
            words[s * stride + PAD_ROWS + y] = word(s, rows.at(y, s, &mut spare)) & mask;
        }
    }
}

/// As [`each`] for pictures with chroma in rows of its own, one for two rows of luma.
#[inline(always)]
pub(super) fn each_with_chroma(
    luma: Rows<'_>,
    chroma: Rows<'_>,
    bits: &mut BitImage,
    word: impl Fn(&[u8; 64], &[u8; 64]) -> u64,
) {
    let (strips, stride, height) = (bits.strips(), bits.strip_stride(), bits.height());
    let last = bits.strip_mask(strips - 1);
    let words = bits.words_mut();
    let (mut spare, mut spare_chroma) = ([0; 64], [0; 64]);
    for y in 0..height {
        for s in 0..strips {
            let mask = if s + 1 == strips { last } else { u64::MAX };
            let chroma = chroma.at(y / 2, s, &mut spare_chroma);
            words[s * stride + PAD_ROWS + y] = word(luma.at(y, s, &mut spare), chroma) & mask;
        }
    }
}
