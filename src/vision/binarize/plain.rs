//! The obvious twin: a pixel at a time.

use crate::frame::{ColourEncoding, Frame, LumaView, PixelFormat, colour};
use crate::vision::bits::BitImage;

/// Writes `bits` from a test of each pixel.
fn write(bits: &mut BitImage, object: impl Fn(usize, usize) -> bool) {
    let (width, strips) = (bits.width(), bits.strips());
    for s in 0..strips {
        for (y, word) in bits.strip_mut(s).iter_mut().enumerate() {
            let columns = s * 64..(s * 64 + 64).min(width);
            *word = columns.fold(0, |w, x| w | (object(x, y) as u64) << (x % 64));
        }
    }
}

/// The box in RGB, ends included.
pub(super) fn rgb_box(
    frame: &Frame,
    encoding: ColourEncoding,
    min: [u8; 3],
    max: [u8; 3],
    bits: &mut BitImage,
) {
    let ycbcr = colour::Ycbcr::new(encoding);
    let bytes = frame.bytes.as_slice();
    let stride = frame.stride_bytes;
    let inside = |rgb: [u8; 3]| (0..3).all(|c| (min[c]..=max[c]).contains(&rgb[c]));
    match frame.format {
        PixelFormat::Rgb => write(bits, |x, y| {
            let p = y * stride + 3 * x;
            inside([bytes[p], bytes[p + 1], bytes[p + 2]])
        }),
        PixelFormat::Bgr => write(bits, |x, y| {
            let p = y * stride + 3 * x;
            inside([bytes[p + 2], bytes[p + 1], bytes[p]])
        }),
        PixelFormat::Grey | PixelFormat::Mjpeg => write(bits, |x, y| inside([bytes[y * stride + x]; 3])),
        PixelFormat::Yuyv => write(bits, |x, y| {
            let pair = y * stride + 2 * (x & !1);
            inside(ycbcr.rgb(bytes[y * stride + 2 * x], bytes[pair + 1], bytes[pair + 3]))
        }),
        PixelFormat::Nv12 => write(bits, |x, y| {
            let chroma = (frame.height + y / 2) * stride + (x & !1);
            inside(ycbcr.rgb(bytes[y * stride + x], bytes[chroma], bytes[chroma + 1]))
        }),
    }
}

/// The range of BT.601 luma, ends included.
pub(super) fn grey_range(frame: &Frame, encoding: ColourEncoding, min: u8, max: u8, bits: &mut BitImage) {
    if let Some(luma) = LumaView::with_encoding(frame, encoding) {
        write(bits, |x, y| (min..=max).contains(&luma.at(x, y)));
    }
}
