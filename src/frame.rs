//! One camera picture as the driver delivered it, and two of them that belong together.

pub mod colour;
mod luma;
mod rgb;

pub use luma::LumaView;
pub use rgb::RgbView;

use std::ops::RangeInclusive;

use crate::time::Timestamp;

/// Widest and highest picture that is taken, in pixels.
pub const SIDE_PX_MAX: u32 = 8192;

/// Frames a second that cameras and sessions may have.
pub const RATE_HZ: RangeInclusive<f64> = 0.1..=1000.0;

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
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
pub enum TimestampMark {
    /// The exposure began (V4L2 `V4L2_BUF_FLAG_TSTAMP_SRC_SOE`).
    StartOfExposure,
    /// The last pixel was read out (V4L2 `V4L2_BUF_FLAG_TSTAMP_SRC_EOF`).
    EndOfFrame,
    /// The driver's clock is unknown: the moment the buffer was dequeued, or a replayed frame was handed over.
    #[default]
    HandedOver,
}

/// One picture. The one copy of the pixels; what is measured later is read from its
/// [luma](crate::vision::luma).
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

    /// A grey frame of tightly packed bytes.
    ///
    /// # Panics
    /// Where `bytes` is not `width * height` long.
    pub fn from_grey(width: usize, height: usize, bytes: Vec<u8>) -> Self {
        assert_eq!(bytes.len(), width * height, "bytes of a grey {width}x{height} picture");
        Frame { bytes, format: PixelFormat::Grey, width, height, stride_bytes: width, ..Frame::default() }
    }

    /// Bytes of one row of this format and width, without what is between rows; 0 for MJPEG.
    pub fn row_bytes(&self) -> usize {
        match self.format {
            PixelFormat::Rgb | PixelFormat::Bgr => self.width.saturating_mul(3),
            PixelFormat::Grey => self.width,
            PixelFormat::Yuyv => self.width.saturating_add(self.width % 2).saturating_mul(2),
            PixelFormat::Nv12 => self.width.saturating_add(self.width % 2),
            PixelFormat::Mjpeg => 0,
        }
    }

    /// Bytes that [`Frame::bytes`] must hold at least for this format, size and stride; 0 for MJPEG.
    pub fn bytes_needed(&self) -> usize {
        let row = match self.format {
            PixelFormat::Mjpeg => return 0,
            _ => self.row_bytes(),
        };
        let rows = match self.format {
            PixelFormat::Nv12 => self.height.saturating_add(self.height.div_ceil(2)),
            _ => self.height,
        };
        if rows == 0 { 0 } else { (rows - 1).saturating_mul(self.stride_bytes).saturating_add(row) }
    }

    /// BT.601 luma of a pixel; coordinates beyond the picture take its border. 0 for MJPEG and for an empty or
    /// short picture. For many pixels make a [`LumaView`] once.
    #[inline]
    pub fn luma(&self, x: usize, y: usize) -> u8 {
        LumaView::new(self).map_or(0, |view| view.at(x, y))
    }

    /// R, G, B of a pixel; coordinates beyond the picture take its border. Zeros for MJPEG and for an empty or
    /// short picture.
    pub fn rgb(&self, x: usize, y: usize) -> [u8; 3] {
        RgbView::with_encoding(self, self.encoding).map_or([0; 3], |view| view.at(x, y))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_of_every_format_are_read_where_they_lie() {
        let grey = |format, stride_bytes, bytes: &[u8]| Frame {
            bytes: bytes.to_vec(),
            format,
            width: 2,
            height: 2,
            stride_bytes,
            encoding: ColourEncoding { range: QuantizationRange::Full, ..Default::default() },
            ..Frame::default()
        };
        let frames = [
            grey(PixelFormat::Rgb, 7, &[1, 1, 1, 2, 2, 2, 0, 3, 3, 3, 4, 4, 4]),
            grey(PixelFormat::Bgr, 6, &[1, 1, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4]),
            grey(PixelFormat::Grey, 2, &[1, 2, 3, 4]),
            grey(PixelFormat::Yuyv, 5, &[1, 128, 2, 128, 0, 3, 128, 4, 128]),
            grey(PixelFormat::Nv12, 3, &[1, 2, 0, 3, 4, 0, 128, 128]),
        ];
        for f in &frames {
            assert_eq!(f.bytes.len(), f.bytes_needed(), "{:?}", f.format);
            for (i, (x, y)) in [(0, 0), (1, 0), (0, 1), (1, 1)].into_iter().enumerate() {
                assert_eq!(f.rgb(x, y), [i as u8 + 1; 3], "{:?}", f.format);
                assert_eq!(f.luma(x, y), i as u8 + 1, "{:?}", f.format);
            }
            assert_eq!(f.luma(9, 9), 4, "the border goes on");
            let view = LumaView::new(f).expect("a whole picture");
            assert_eq!(
                (view.sample(0.5, 0.5), view.sample(-3.0, 0.25), view.sample(0.0, f32::NAN)),
                (2.5, 1.5, 1.0)
            );
        }
    }

    #[test]
    fn short_and_compressed_pictures_have_no_pixels() {
        let short = Frame { bytes: vec![9; 11], ..Frame::from_rgb(2, 2, vec![9; 12]) };
        assert!(LumaView::new(&short).is_none());
        assert_eq!((short.luma(0, 0), short.rgb(0, 0)), (0, [0; 3]));
        let mjpeg =
            Frame { bytes: vec![9; 99], format: PixelFormat::Mjpeg, width: 2, height: 2, ..Frame::default() };
        assert!(LumaView::new(&mjpeg).is_none());
        assert!(LumaView::new(&Frame::default()).is_none());
    }
}
