//! The tests of pixels, independent of the instruction set, and the choice among the sets.

use super::auto::Auto;
use super::plain;
use super::rows::Rows;
use super::speck::Specks;
#[cfg(target_arch = "x86_64")]
use super::{avx2, avx512};
use crate::frame::colour::Ycbcr;
use crate::frame::{Frame, PixelFormat};
use crate::level::Level;
use crate::vision::bits::BitImage;
use std::ops::Range;

/// A box in three interleaved bytes a pixel, both ends included, laid out for the 192 bytes of 64 pixels.
#[derive(Clone, Debug)]
pub(super) struct ByteBox {
    /// Least value of every byte.
    pub(super) lo: [u8; 192],
    /// Greatest value of every byte.
    pub(super) hi: [u8; 192],
}

impl ByteBox {
    /// The box for bytes in this order.
    pub(super) fn new(lo: [u8; 3], hi: [u8; 3]) -> Self {
        Self { lo: std::array::from_fn(|i| lo[i % 3]), hi: std::array::from_fn(|i| hi[i % 3]) }
    }
}

/// A box in the levels (1/64) that Y'CbCr converts to, both ends included.
#[derive(Clone, Copy, Debug)]
pub(super) struct LevelBox {
    pub(super) ycbcr: Ycbcr,
    pub(super) lo: [i16; 3],
    pub(super) hi: [i16; 3],
}

impl LevelBox {
    /// A box in R'G'B'.
    pub(super) fn rgb(ycbcr: Ycbcr, min: [u8; 3], max: [u8; 3]) -> Self {
        use crate::frame::colour::level_range;
        let ranges: [(i16, i16); 3] = std::array::from_fn(|c| level_range(min[c], max[c]));
        Self { ycbcr, lo: ranges.map(|r| r.0), hi: ranges.map(|r| r.1) }
    }

    /// A range of BT.601 luma: its gains stand in for those of G, and the other two channels are always inside.
    pub(super) fn luma(ycbcr: Ycbcr, min: u8, max: u8) -> Self {
        let mut range = Self::rgb(ycbcr, [0, min, 0], [255, max, 255]);
        (range.ycbcr.g_u, range.ycbcr.g_v) = (ycbcr.l_u, ycbcr.l_v);
        range
    }
}

/// Where luma is in the bytes of a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::vision) enum LumaLayout {
    /// BT.601 luma of three bytes R, G, B.
    Rgb,
    /// BT.601 luma of three bytes B, G, R.
    Bgr,
    /// The only byte.
    Single,
    /// The first of two bytes.
    Pair,
}

/// The luma of a picture, to be tested or read.
#[derive(Clone, Copy)]
pub(in crate::vision) struct Luma<'a> {
    pub(super) rows: Rows<'a>,
    pub(super) layout: LumaLayout,
}

impl<'a> Luma<'a> {
    /// That of a raw frame, of YUV as it is coded.
    pub(in crate::vision) fn of(frame: &'a Frame) -> Self {
        let layout = match frame.format {
            PixelFormat::Rgb => LumaLayout::Rgb,
            PixelFormat::Bgr => LumaLayout::Bgr,
            PixelFormat::Grey | PixelFormat::Nv12 | PixelFormat::Mjpeg => LumaLayout::Single,
            PixelFormat::Yuyv => LumaLayout::Pair,
        };
        Self { rows: Rows::of(frame), layout }
    }
}

/// Calls the function of this name in the module of the instruction set.
macro_rules! dispatch {
    ($level:expr, $name:ident($($arg:expr),*)) => {
        match $level {
            #[cfg(target_arch = "x86_64")]
            // SAFETY: the stages take only levels that `Level::available` found on this machine.
            Level::Avx512 => unsafe { avx512::$name($($arg),*) },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: as above.
            Level::Avx2 => unsafe { avx2::$name($($arg),*) },
            _ => plain::$name($($arg),*),
        }
    };
}

/// Object: all three bytes in the box.
pub(super) fn byte_box(level: Level, rows: Rows<'_>, range: &ByteBox, bits: &mut BitImage) {
    dispatch!(level, byte_box(rows, range, bits))
}

/// Object: all three levels in the box; `chroma` apart, or `None` where it lies between the Y values (YUYV).
pub(super) fn level_box(
    level: Level,
    y: Rows<'_>,
    chroma: Option<Rows<'_>>,
    range: &LevelBox,
    bits: &mut BitImage,
) {
    dispatch!(level, level_box(y, chroma, range, bits))
}

/// Object: luma from `lo` to `hi`, both included, which have a value for every column of the strips.
pub(super) fn luma_between(
    level: Level,
    luma: Luma<'_>,
    ys: Range<usize>,
    lo: &[u8],
    hi: &[u8],
    bits: &mut BitImage,
) {
    dispatch!(level, luma_between(luma, ys, lo, hi, bits))
}

/// The luma of row `y` to whole blocks of 64 bytes; YUV as it is coded.
pub(in crate::vision) fn luma_row(level: Level, luma: Luma<'_>, y: usize, row: &mut [u8]) {
    dispatch!(level, luma_row(luma, y, row))
}

/// Object: brighter, or where `dark` darker, than the background around.
pub(super) fn auto(level: Level, auto: &mut Auto, luma: Luma<'_>, dark: bool, bits: &mut BitImage) {
    dispatch!(level, auto(auto, luma, dark, bits))
}

/// Drops objects of fewer than `least` pixels.
pub(super) fn drop_specks(level: Level, specks: &mut Specks, bits: &mut BitImage, least: u32) {
    dispatch!(level, drop_specks(specks, bits, least))
}
