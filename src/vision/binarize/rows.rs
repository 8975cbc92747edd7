//! Walks a picture in blocks of 64 pixels, a word of the bit image each. Reads by bounds-checked slices, so that
//! the code for one instruction set needs no pointer arithmetic.

use crate::frame::Frame;
use crate::vision::bits::{BitImage, PAD_ROWS};
use std::ops::Range;

/// Rows of bytes, `stride` apart.
#[derive(Clone, Copy)]
pub(in crate::vision) struct Rows<'a> {
    pub(super) bytes: &'a [u8],
    pub(super) stride: usize,
}

impl<'a> Rows<'a> {
    /// The rows of pixels, or of Y.
    pub(super) fn of(frame: &'a Frame) -> Self {
        Self { bytes: &frame.bytes, stride: frame.stride_bytes }
    }

    /// Row `y` and what follows it, as blocks and the rest.
    #[inline(always)]
    fn row<const BLOCK: usize>(&self, y: usize) -> (&'a [[u8; BLOCK]], &'a [u8]) {
        self.bytes.get(y * self.stride..).unwrap_or_default().as_chunks()
    }

    /// Block `s` of row `y`; filled up with zeros where the picture ends in it.
    #[inline(always)]
    fn block<const BLOCK: usize>(&self, y: usize, s: usize) -> [u8; BLOCK] {
        let (blocks, rest) = self.row(y);
        blocks.get(s).copied().unwrap_or_else(|| filled_up(if s == blocks.len() { rest } else { &[] }))
    }

    /// Calls `each` with every whole block of 64 bytes of `out` and the block of row `y` in its place.
    #[inline(always)]
    pub(super) fn each_of_row<const BLOCK: usize>(
        &self,
        y: usize,
        out: &mut [u8],
        each: impl Fn(&[u8; BLOCK], &mut [u8; 64]),
    ) {
        let (blocks, rest) = self.row::<BLOCK>(y);
        let mut spare;
        for (s, out) in out.as_chunks_mut::<64>().0.iter_mut().enumerate() {
            let block = match blocks.get(s) {
                Some(block) => block,
                None => {
                    spare = filled_up(if s == blocks.len() { rest } else { &[] });
                    &spare
                }
            };
            each(block, out);
        }
    }
}

/// A block that begins with these bytes.
fn filled_up<const BLOCK: usize>(bytes: &[u8]) -> [u8; BLOCK] {
    let mut block = [0; BLOCK];
    block[..bytes.len()].copy_from_slice(bytes);
    block
}

/// Sets the words of rows `ys` to what `word` makes of their bytes; it is given strip and bytes.
#[inline(always)]
pub(super) fn each<const BLOCK: usize>(
    rows: Rows<'_>,
    ys: Range<usize>,
    bits: &mut BitImage,
    word: impl Fn(usize, &[u8; BLOCK]) -> u64,
) {
    let (strips, stride) = (bits.strips(), bits.strip_stride());
    let last = bits.strip_mask(strips - 1);
    let words = bits.words_mut();
    let mut spare;
    for y in ys {
        let (blocks, rest) = rows.row::<BLOCK>(y);
        for (s, out) in words[PAD_ROWS + y..].iter_mut().step_by(stride).take(strips).enumerate() {
            // One call only, so that it is compiled into the loop.
            let block = match blocks.get(s) {
                Some(block) => block,
                None => {
                    spare = filled_up(if s == blocks.len() { rest } else { &[] });
                    &spare
                }
            };
            *out = word(s, block) & if s + 1 == strips { last } else { u64::MAX };
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
    let (mut spare, mut spare_chroma);
    for y in 0..height {
        let ((blocks, _), (chroma_blocks, _)) = (luma.row::<64>(y), chroma.row::<64>(y / 2));
        for (s, out) in words[PAD_ROWS + y..].iter_mut().step_by(stride).take(strips).enumerate() {
            let (block, chroma) = match (blocks.get(s), chroma_blocks.get(s)) {
                (Some(block), Some(chroma)) => (block, chroma),
                _ => {
                    (spare, spare_chroma) = (luma.block(y, s), chroma.block(y / 2, s));
                    (&spare, &spare_chroma)
                }
            };
            *out = word(block, chroma) & if s + 1 == strips { last } else { u64::MAX };
        }
    }
}
