//! The colours of a raw frame, pixel by pixel.

use super::colour::Ycbcr;
use super::{ColourEncoding, Frame, PixelFormat};

/// A raw frame that holds as many bytes as it must.
#[derive(Clone, Copy, Debug)]
pub struct RgbView<'a> {
    frame: &'a Frame,
    ycbcr: Ycbcr,
}

impl<'a> RgbView<'a> {
    /// Of a frame whose YUV is read by `encoding`; `None` for MJPEG and for an empty or short picture.
    pub fn with_encoding(frame: &'a Frame, encoding: ColourEncoding) -> Option<Self> {
        let is_whole = frame.width > 0 && frame.height > 0 && frame.bytes.len() >= frame.bytes_needed();
        (is_whole && frame.format != PixelFormat::Mjpeg).then(|| Self { frame, ycbcr: Ycbcr::new(encoding) })
    }

    /// R, G, B of a pixel; coordinates beyond the picture take its border.
    #[inline]
    pub fn at(&self, x: usize, y: usize) -> [u8; 3] {
        let Frame { format, width, height, stride_bytes, bytes, .. } = self.frame;
        let (x, y) = (x.min(width - 1), y.min(height - 1));
        let row = &bytes[y * stride_bytes..];
        match format {
            PixelFormat::Rgb => [row[3 * x], row[3 * x + 1], row[3 * x + 2]],
            PixelFormat::Bgr => [row[3 * x + 2], row[3 * x + 1], row[3 * x]],
            PixelFormat::Grey => [row[x]; 3],
            PixelFormat::Yuyv => {
                let pair = x & !1;
                self.ycbcr.rgb(row[2 * x], row[2 * pair + 1], row[2 * pair + 3])
            }
            PixelFormat::Nv12 => {
                let chroma = &bytes[(height + y / 2) * stride_bytes + (x & !1)..];
                self.ycbcr.rgb(row[x], chroma[0], chroma[1])
            }
            PixelFormat::Mjpeg => [0; 3],
        }
    }
}
