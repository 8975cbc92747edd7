//! One camera picture as the driver delivered it, and two of them that belong together.

use crate::time::Timestamp;

/// How the bytes of a frame are to be read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum PixelFormat {
    /// 3 bytes a pixel: red, green, blue (V4L2 `RGB3`).
    #[default]
    Rgb,
    /// 3 bytes a pixel: blue, green, red (V4L2 `BGR3`).
    Bgr,
    /// 1 byte a pixel (V4L2 `GREY`).
    Grey,
    /// 2 bytes a pixel: Y0 U Y1 V (V4L2 `YUYV`).
    Yuyv,
    /// A plane of Y, then a plane of U V pairs at half size both ways (V4L2 `NV12`).
    Nv12,
    /// One JPEG picture, with or without Huffman tables (V4L2 `MJPG`).
    Mjpeg,
}

/// Which matrix turns Y'CbCr to R'G'B'.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum YcbcrMatrix {
    /// ITU-R BT.601, what webcams use unless they say otherwise.
    #[default]
    Bt601,
    /// ITU-R BT.709.
    Bt709,
}

/// Which code values stand for black and white.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum QuantizationRange {
    /// Y from 16 to 235, Cb and Cr from 16 to 240.
    #[default]
    Limited,
    /// All from 0 to 255.
    Full,
}

/// How YUYV and NV12 bytes encode colour. Without effect on the other formats: RGB, grey and MJPEG are full range.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct ColourEncoding {
    /// The matrix.
    pub matrix: YcbcrMatrix,
    /// The range.
    pub range: QuantizationRange,
}

/// What moment of the exposure a frame's time stamp marks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum TimestampMark {
    /// The exposure began (V4L2 `V4L2_BUF_FLAG_TSTAMP_SRC_SOE`).
    StartOfExposure,
    /// The last pixel was read out (V4L2 `V4L2_BUF_FLAG_TSTAMP_SRC_EOF`).
    EndOfFrame,
    /// The driver's clock is unknown: the moment the buffer was dequeued, or a replayed frame was handed over.
    #[default]
    HandedOver,
}

/// One picture. The one copy of the pixels: everything later reads these bytes.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Frame {
    /// The bytes; for [`PixelFormat::Mjpeg`] the compressed picture, else rows of `stride_bytes`.
    pub bytes: Vec<u8>,
    /// How to read them.
    pub format: PixelFormat,
    /// Picture width in pixels.
    pub width: usize,
    /// Picture height in pixels.
    pub height: usize,
    /// Distance between the beginnings of two rows (of the Y plane for NV12), in bytes.
    pub stride_bytes: usize,
    /// Colour encoding of the YUV formats.
    pub encoding: ColourEncoding,
    /// When the light was seen.
    pub timestamp: Timestamp,
    /// What moment of the exposure that is.
    pub mark: TimestampMark,
    /// The driver's frame counter.
    pub sequence: u32,
}

/// The two pictures of one moment.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FramePair {
    /// The left camera's.
    pub left: Frame,
    /// The right camera's.
    pub right: Frame,
}

impl Frame {
    /// A frame of tightly packed RGB bytes.
    ///
    /// # Panics
    /// Where `bytes` is not `3 * width * height` long.
    pub fn from_rgb(width: usize, height: usize, bytes: Vec<u8>) -> Self {
        assert_eq!(bytes.len(), 3 * width * height, "RGB bytes of a {width}x{height} picture");
        Frame { bytes, format: PixelFormat::Rgb, width, height, stride_bytes: 3 * width, ..Frame::default() }
    }
}
