//! A camera picture to a bit image: object = 1 (paper IV-A, Algorithm 2).
//!
//! Takes a [`Frame`] in any raw format, straight from the camera's bytes or their luma; gives a [`BitImage`]. Owns the region as
//! a bit mask and the memory for finding thresholds and dropping specks; allocates nothing after `new`.
//!
//! The printed Algorithm 2 compares "`Colormin < pixel > Colormax`" and paints such a pixel white; the paper's text
//! says the reverse (outside the range is 0). Here a pixel is object = 1 where every channel is in the range, both
//! ends included. Its loops, `x = 0 to x = Image.width` and `y = 0 to x = Image.height`, are read as every pixel once.
//!
//! ```
//! use pickcell::{frame::Frame, vision::{binarize::{Binarize, ColourRange, Params}, bits::BitImage}};
//! let frame = Frame::from_rgb(3, 1, vec![99, 200, 200,  100, 100, 100,  255, 255, 255]);
//! let params = Params { colour: ColourRange::Rgb { min: [100; 3], max: [255; 3] }, ..Params::default() };
//! let mut bits = BitImage::new(3, 1);
//! Binarize::new(params, 3, 1)?.run(&frame, &mut bits)?;
//! assert_eq!(bits.to_text(), ".##\n");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod auto;
#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod error;
mod grid;
mod kernel;
mod plain;
mod region;
mod rows;
mod speck;
#[cfg(test)]
mod tests;

pub use error::{ParamsError, Refusal};

use super::bits::BitImage;
use crate::frame::{ColourEncoding, Frame, PixelFormat, colour};
use crate::level::Level;
use kernel::{ByteBox, LevelBox};
pub(super) use kernel::{Luma, luma_row};
use rows::Rows;

/// Which pixels are object.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ColourRange {
    /// A box in RGB: every channel from `min` to `max`, both included.
    Rgb {
        /// Least R, G, B.
        min: [u8; 3],
        /// Greatest R, G, B.
        max: [u8; 3],
    },
    /// BT.601 luma from `min` to `max`, both included.
    Grey {
        /// Least luma.
        min: u8,
        /// Greatest luma.
        max: u8,
    },
    /// A threshold found anew in every picture, local where the light has a gradient.
    #[default]
    Auto,
}

/// What is object, and where.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Params {
    /// Which pixels are object.
    pub colour: ColourRange,
    /// Object is what is outside the range; with [`ColourRange::Auto`] what is darker than its surroundings.
    pub inverted: bool,
    /// Corners of a polygon (x, y in pixels, pixel centres at whole numbers), from 0 to the width and height; only
    /// pixels whose centre is inside can be object. Empty: the whole picture.
    pub region_px: Vec<[f32; 2]>,
    /// Objects of fewer pixels (connected over edges and corners) are dropped; 0 and 1 keep everything.
    pub speck_px_min: u32,
    /// How YUYV and NV12 encode colour; `None`: as each frame says.
    pub encoding: Option<ColourEncoding>,
}

/// Greatest width and height in pixels.
pub const SIZE_MAX: usize = 8192;

/// The stage: owns region, thresholds and speck memory.
#[derive(Clone, Debug)]
pub struct Binarize {
    params: Params,
    level: Level,
    width: usize,
    height: usize,
    region: Option<BitImage>,
    /// The box for bytes in the order R, G, B and in the order B, G, R.
    boxes: Box<[ByteBox; 2]>,
    /// Ends of a range of luma, a value a column.
    ends: [Vec<u8>; 2],
    auto: auto::Auto,
    specks: speck::Specks,
}

/// How many specks, and things that are none, a picture of this size may have: several times what noise makes in which parts are
/// still recognised.
fn specks_max(width: usize, height: usize) -> u32 {
    (width * height / 64).max(1024) as u32
}

impl Binarize {
    /// Checks `params` and allocates for pictures of this size in pixels; takes the best instructions there are.
    ///
    /// # Errors
    /// [`ParamsError`] says which parameter cannot be used.
    pub fn new(params: Params, width: usize, height: usize) -> Result<Self, ParamsError> {
        Self::with_level(params, width, height, Level::detect())
    }

    /// As [`Binarize::new`] with other instructions, for comparing them; those this machine lacks are not used.
    ///
    /// # Errors
    /// [`ParamsError`] says which parameter cannot be used.
    pub fn with_level(
        params: Params,
        width: usize,
        height: usize,
        level: Level,
    ) -> Result<Self, ParamsError> {
        if width == 0 || height == 0 || width > SIZE_MAX || height > SIZE_MAX {
            return Err(ParamsError::Size { width, height });
        }
        params.colour.check()?;
        let region = match params.region_px.as_slice() {
            [] => None,
            polygon => Some(region::mask(polygon, width, height)?),
        };
        let ([r0, g0, b0], [r1, g1, b1]) = match params.colour {
            ColourRange::Rgb { min, max } => (min, max),
            _ => ([0; 3], [255; 3]),
        };
        Ok(Self {
            level: level.supported(),
            boxes: Box::new([
                ByteBox::new([r0, g0, b0], [r1, g1, b1]),
                ByteBox::new([b0, g0, r0], [b1, g1, r1]),
            ]),
            ends: [vec![0; width.next_multiple_of(64)], vec![0; width.next_multiple_of(64)]],
            auto: auto::Auto::new(width, height, region.as_ref()),
            specks: speck::Specks::new(width, height, specks_max(width, height)),
            params,
            width,
            height,
            region,
        })
    }

    /// The parameters of `new`.
    pub fn params(&self) -> &Params {
        &self.params
    }

    /// Where objects can be; `None`: everywhere.
    pub fn region(&self) -> Option<&BitImage> {
        self.region.as_ref()
    }

    /// Whether MJPEG may be decoded to luma alone: for a range of luma, given or found in the picture.
    pub fn needs_luma_only(&self) -> bool {
        matches!(self.params.colour, ColourRange::Grey { .. } | ColourRange::Auto)
    }

    /// How the YUV of a frame is read.
    pub fn encoding(&self, frame: &Frame) -> ColourEncoding {
        self.params.encoding.unwrap_or(frame.encoding)
    }

    /// Writes every pixel of `bits`.
    ///
    /// # Errors
    /// [`Refusal`] for frames of another size, compressed or short ones; `bits` is then unchanged. And for more specks than one
    /// in 64 pixels (1024 in small pictures): a picture of noise, not an empty one.
    pub fn run(&mut self, frame: &Frame, bits: &mut BitImage) -> Result<(), Refusal> {
        self.check(frame)?;
        self.check_size(bits.width(), bits.height())?;
        let ycbcr = colour::Ycbcr::new(self.encoding(frame));
        let luma = Luma::of(frame);
        match self.params.colour {
            ColourRange::Rgb { min, max } => self.rgb_box(frame, ycbcr, min, max, bits),
            ColourRange::Grey { min, max } => self.grey_range(frame, ycbcr, min, max, bits),
            ColourRange::Auto => kernel::auto(self.level, &mut self.auto, luma, self.params.inverted, bits),
        }
        self.invert_and_cut(bits);
        kernel::drop_specks(self.level, &mut self.specks, bits, self.params.speck_px_min);
        if self.specks.were_too_many() {
            return Err(Refusal::Specks { specks_max: specks_max(bits.width(), bits.height()) });
        }
        Ok(())
    }

    fn rgb_box(
        &mut self,
        frame: &Frame,
        ycbcr: colour::Ycbcr,
        min: [u8; 3],
        max: [u8; 3],
        bits: &mut BitImage,
    ) {
        let rows = Rows::of(frame);
        match frame.format {
            PixelFormat::Rgb => kernel::byte_box(self.level, rows, &self.boxes[0], bits),
            PixelFormat::Bgr => kernel::byte_box(self.level, rows, &self.boxes[1], bits),
            PixelFormat::Yuyv | PixelFormat::Nv12 => {
                let range = LevelBox::rgb(ycbcr, min, max);
                kernel::level_box(self.level, rows, chroma_of(frame), &range, bits);
            }
            PixelFormat::Grey | PixelFormat::Mjpeg => {
                // R = G = B: inside all three ranges at once, which may be none.
                let lo = min.into_iter().fold(0, u8::max);
                let hi = max.into_iter().fold(255, u8::min);
                self.luma_range(frame, lo, hi, bits);
            }
        }
    }

    fn grey_range(&mut self, frame: &Frame, ycbcr: colour::Ycbcr, min: u8, max: u8, bits: &mut BitImage) {
        let (rows, is_yuv) = (Rows::of(frame), matches!(frame.format, PixelFormat::Yuyv | PixelFormat::Nv12));
        if is_yuv && (ycbcr.l_u, ycbcr.l_v) != (0, 0) {
            let range = LevelBox::luma(ycbcr, min, max);
            kernel::level_box(self.level, rows, chroma_of(frame), &range, bits);
        } else if is_yuv {
            // Luma grows with Y, so that a range of the one is a range of the other.
            let inside = |y: &u8| (min..=max).contains(&ycbcr.luma(*y, 128, 128));
            let lo = (0..=255).find(inside).unwrap_or(255);
            let hi = (0..=255).rev().find(inside).unwrap_or(0);
            self.luma_range(frame, lo, hi, bits);
        } else {
            self.luma_range(frame, min, max, bits);
        }
    }

    fn luma_range(&mut self, frame: &Frame, lo: u8, hi: u8, bits: &mut BitImage) {
        self.ends[0].fill(lo);
        self.ends[1].fill(hi);
        let luma = Luma::of(frame);
        kernel::luma_between(self.level, luma, 0..self.height, &self.ends[0], &self.ends[1], bits);
    }

    fn invert_and_cut(&self, bits: &mut BitImage) {
        // A threshold of its own picture has looked for dark parts already.
        let invert = self.params.inverted && self.params.colour != ColourRange::Auto;
        for s in 0..bits.strips() {
            let flip = if invert { bits.strip_mask(s) } else { 0 };
            match &self.region {
                Some(region) => {
                    for (word, inside) in bits.strip_mut(s).iter_mut().zip(region.strip(s)) {
                        *word = (*word ^ flip) & inside;
                    }
                }
                None if invert => bits.strip_mut(s).iter_mut().for_each(|word| *word ^= flip),
                None => {}
            }
        }
    }

    fn check_size(&self, width: usize, height: usize) -> Result<(), Refusal> {
        if (width, height) != (self.width, self.height) {
            let (wanted_width, wanted_height) = (self.width, self.height);
            return Err(Refusal::Size { width, height, wanted_width, wanted_height });
        }
        Ok(())
    }

    /// Whether a frame can be binarized.
    ///
    /// # Errors
    /// [`Refusal`] for frames of another size, compressed or short ones.
    pub fn check(&self, frame: &Frame) -> Result<(), Refusal> {
        self.check_size(frame.width, frame.height)?;
        if frame.format == PixelFormat::Mjpeg {
            return Err(Refusal::Compressed);
        }
        if frame.stride_bytes < frame.row_bytes() {
            return Err(Refusal::Stride { stride_bytes: frame.stride_bytes, width: frame.width });
        }
        let (bytes, needed) = (frame.bytes.len(), frame.bytes_needed());
        if bytes < needed {
            return Err(Refusal::Short { bytes, needed });
        }
        Ok(())
    }
}

impl ColourRange {
    fn check(&self) -> Result<(), ParamsError> {
        let check =
            |key, min, max| if min > max { Err(ParamsError::EmptyRange { key, min, max }) } else { Ok(()) };
        match *self {
            ColourRange::Rgb { min, max } => {
                let keys =
                    ["color_min/color_max red", "color_min/color_max green", "color_min/color_max blue"];
                (0..3).try_for_each(|c| check(keys[c], min[c], max[c]))
            }
            ColourRange::Grey { min, max } => check("grey_min/grey_max", min, max),
            ColourRange::Auto => Ok(()),
        }
    }
}

/// The rows of chroma where they lie apart.
fn chroma_of(frame: &Frame) -> Option<Rows<'_>> {
    let bytes = frame.bytes.get(frame.height * frame.stride_bytes..).unwrap_or_default();
    (frame.format == PixelFormat::Nv12).then_some(Rows { bytes, stride: frame.stride_bytes })
}
