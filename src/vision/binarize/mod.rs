//! A camera picture to a bit image: object = 1 (paper IV-A, Algorithm 2).
//!
//! Takes a [`Frame`] in any raw format, straight from the camera's bytes; gives a [`BitImage`]. Owns the region as
//! a bit mask and the memory for finding thresholds and dropping specks; allocates nothing after `new`.
//!
//! The printed Algorithm 2 compares "`Colormin < pixel > Colormax`" and paints such a pixel white; the paper's text
//! says the reverse (outside the range is 0). Here a pixel is object = 1 where every channel is in the range, both
//! ends included.
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
mod plain;
mod region;
mod speck;

use super::bits::BitImage;
use crate::frame::{ColourEncoding, Frame, PixelFormat};

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

/// Parameters that cannot be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ParamsError {
    /// A range whose least value is above its greatest.
    #[error(
        "colour range is empty: {key} goes from {min} to {max}; give a minimum that is not above the maximum"
    )]
    EmptyRange {
        /// Which range, and for a box which channel.
        key: &'static str,
        /// Least value.
        min: u8,
        /// Greatest value.
        max: u8,
    },
    /// Too few corners.
    #[error("region_px has {corners} corner(s); give at least 3, or none for the whole picture")]
    RegionCorners {
        /// How many.
        corners: usize,
    },
    /// A corner that is no number or not in the picture.
    #[error(
        "region_px: corner {index} is ({x}, {y}), outside the {width}x{height} picture; x must be 0 to {width} and y 0 to {height}"
    )]
    RegionOutside {
        /// Which corner, from 0.
        index: usize,
        /// Its x.
        x: f32,
        /// Its y.
        y: f32,
        /// Picture width.
        width: usize,
        /// Picture height.
        height: usize,
    },
    /// Two sides cross.
    #[error(
        "region_px: the sides after corner {first} and after corner {second} cross; list the corners in order around the region"
    )]
    RegionCrosses {
        /// First corner of one side.
        first: usize,
        /// First corner of the other.
        second: usize,
    },
    /// No area.
    #[error(
        "region_px has no area ({corners} corners on a line or all at one place); give corners around the bin"
    )]
    RegionEmpty {
        /// How many corners.
        corners: usize,
    },
    /// A picture without pixels or too large.
    #[error("picture size {width}x{height}: width and height must be 1 to {max}", max = SIZE_MAX)]
    Size {
        /// Picture width.
        width: usize,
        /// Picture height.
        height: usize,
    },
}

/// Greatest width and height in pixels.
pub const SIZE_MAX: usize = 8192;

/// A picture that cannot be binarized.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// Frame or bit image of another size than `new` was told.
    #[error(
        "picture is {width}x{height} where {wanted_width}x{wanted_height} was set up; set the camera's size or the calibration's"
    )]
    Size {
        /// The frame's or bit image's width.
        width: usize,
        /// The frame's or bit image's height.
        height: usize,
        /// Width of `new`.
        wanted_width: usize,
        /// Height of `new`.
        wanted_height: usize,
    },
    /// A JPEG: decode it first.
    #[error("picture is still MJPEG; decode it first")]
    Compressed,
    /// Fewer bytes than size, stride and format need.
    #[error("picture has {bytes} bytes where its size and format need {needed}; the frame was cut short")]
    Short {
        /// Bytes there.
        bytes: usize,
        /// Bytes needed.
        needed: usize,
    },
    /// A distance between rows that is less than a row.
    #[error("picture has rows of {stride_bytes} bytes, less than its {width} pixels need")]
    Stride {
        /// Bytes between rows.
        stride_bytes: usize,
        /// Picture width.
        width: usize,
    },
}

/// The stage: owns region, thresholds and speck memory.
#[derive(Clone, Debug)]
pub struct Binarize {
    params: Params,
    width: usize,
    height: usize,
    region: Option<BitImage>,
    auto: auto::Auto,
    specks: speck::Specks,
}

impl Binarize {
    /// Checks `params` and allocates for pictures of this size in pixels.
    ///
    /// # Errors
    /// [`ParamsError`] says which parameter cannot be used.
    pub fn new(params: Params, width: usize, height: usize) -> Result<Self, ParamsError> {
        if width == 0 || height == 0 || width > SIZE_MAX || height > SIZE_MAX {
            return Err(ParamsError::Size { width, height });
        }
        let check =
            |key, min, max| if min > max { Err(ParamsError::EmptyRange { key, min, max }) } else { Ok(()) };
        match params.colour {
            ColourRange::Rgb { min, max } => {
                for (channel, key) in
                    ["color_min/color_max red", "color_min/color_max green", "color_min/color_max blue"]
                        .into_iter()
                        .enumerate()
                {
                    check(key, min[channel], max[channel])?;
                }
            }
            ColourRange::Grey { min, max } => check("grey_min/grey_max", min, max)?,
            ColourRange::Auto => {}
        }
        let region = match params.region_px.as_slice() {
            [] => None,
            polygon => Some(region::mask(polygon, width, height)?),
        };
        let auto = auto::Auto::new(width, height);
        Ok(Self { params, width, height, region, auto, specks: speck::Specks::new(width, height) })
    }

    /// The parameters of `new`.
    pub fn params(&self) -> &Params {
        &self.params
    }

    /// Where objects can be; `None`: everywhere.
    pub fn region(&self) -> Option<&BitImage> {
        self.region.as_ref()
    }

    /// Whether luma alone is looked at, so that MJPEG may be decoded to grey.
    pub fn needs_luma_only(&self) -> bool {
        !matches!(self.params.colour, ColourRange::Rgb { .. })
    }

    /// Writes every pixel of `bits`.
    ///
    /// # Errors
    /// [`Refusal`] for frames of another size, compressed or short ones; `bits` is then unchanged.
    pub fn run(&mut self, frame: &Frame, bits: &mut BitImage) -> Result<(), Refusal> {
        self.check(frame, bits)?;
        let encoding = self.params.encoding.unwrap_or(frame.encoding);
        match self.params.colour {
            ColourRange::Rgb { min, max } => plain::rgb_box(frame, encoding, min, max, bits),
            ColourRange::Grey { min, max } => plain::grey_range(frame, encoding, min, max, bits),
            ColourRange::Auto => self.auto.run(frame, self.params.inverted, self.region.as_ref(), bits),
        }
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
        self.specks.drop_smaller(bits, self.params.speck_px_min);
        Ok(())
    }

    fn check(&self, frame: &Frame, bits: &BitImage) -> Result<(), Refusal> {
        for (width, height) in [(frame.width, frame.height), (bits.width(), bits.height())] {
            if (width, height) != (self.width, self.height) {
                let (wanted_width, wanted_height) = (self.width, self.height);
                return Err(Refusal::Size { width, height, wanted_width, wanted_height });
            }
        }
        let row_bytes = match frame.format {
            PixelFormat::Mjpeg => return Err(Refusal::Compressed),
            PixelFormat::Rgb | PixelFormat::Bgr => 3 * frame.width,
            PixelFormat::Grey => frame.width,
            PixelFormat::Yuyv => 2 * frame.width.next_multiple_of(2),
            PixelFormat::Nv12 => frame.width.next_multiple_of(2),
        };
        if frame.stride_bytes < row_bytes {
            return Err(Refusal::Stride { stride_bytes: frame.stride_bytes, width: frame.width });
        }
        let (bytes, needed) = (frame.bytes.len(), frame.bytes_needed());
        if bytes < needed {
            return Err(Refusal::Short { bytes, needed });
        }
        Ok(())
    }
}
