//! The luma of a whole picture, a byte a pixel.
//!
//! Takes a raw [`Frame`]; gives its BT.601 luma of full range, as [`Frame::luma`] defines it, in a grey frame that
//! [`LumaPlane`] owns. One pass; whoever measures grey values many times reads it faster than the camera's bytes.
//!
//! ```
//! use pickcell::frame::Frame;
//! use pickcell::vision::luma::LumaPlane;
//!
//! let red = Frame::from_rgb(2, 1, vec![255, 0, 0, 0, 0, 0]);
//! assert_eq!(LumaPlane::new(2, 1).run(&red, red.encoding).bytes[..2], [76, 0]);
//! ```

use super::binarize::{self, Luma};
use crate::frame::colour::Ycbcr;
use crate::frame::{ColourEncoding, Frame, PixelFormat};
use crate::level::Level;
use crate::time::Timestamp;

/// After so many rows it is asked how late it is.
pub(super) const CLOCK_ROWS: usize = 16;

/// The stage: owns the plane.
#[derive(Clone, Debug)]
pub struct LumaPlane {
    level: Level,
    plane: Frame,
}

impl LumaPlane {
    /// Allocates for pictures of this size in pixels.
    pub fn new(width: usize, height: usize) -> Self {
        Self::with_level(width, height, Level::detect())
    }

    /// As [`LumaPlane::new`] with other instructions, for comparing them; those this machine lacks are not used.
    pub fn with_level(width: usize, height: usize, level: Level) -> Self {
        // Rows of whole blocks.
        let stride_bytes = width.max(1).next_multiple_of(64);
        let bytes = vec![0; stride_bytes * height];
        let format = PixelFormat::Grey;
        let plane = Frame { bytes, format, width, height, stride_bytes, ..Frame::default() };
        Self { level: level.supported(), plane }
    }

    /// The luma of `frame`, whose YUV is read by `encoding`. Black where the frame is compressed or of another size, and
    /// where it ends short.
    pub fn run(&mut self, frame: &Frame, encoding: ColourEncoding) -> &Frame {
        self.run_until(frame, encoding, None);
        &self.plane
    }

    /// As [`LumaPlane::run`], broken off at this moment where it is given; says whether there was time.
    pub fn run_until(&mut self, frame: &Frame, encoding: ColourEncoding, end: Option<Timestamp>) -> bool {
        let Self { level, plane } = self;
        if frame.format == PixelFormat::Mjpeg || (frame.width, frame.height) != (plane.width, plane.height) {
            plane.bytes.fill(0);
            return true;
        }
        let (luma, ycbcr) = (Luma::of(frame), Ycbcr::new(encoding));
        let is_yuv = matches!(frame.format, PixelFormat::Yuyv | PixelFormat::Nv12);
        let needs_chroma = is_yuv && (ycbcr.l_u, ycbcr.l_v) != (0, 0);
        let levels = (is_yuv && !needs_chroma && ycbcr.y_offset != 0)
            .then(|| std::array::from_fn::<u8, 256, _>(|y| ycbcr.luma(y as u8, 128, 128)));
        for (y, row) in plane.bytes.chunks_exact_mut(plane.stride_bytes).enumerate() {
            if y.is_multiple_of(CLOCK_ROWS) && end.is_some_and(Timestamp::is_past) {
                return false;
            }
            binarize::luma_row(*level, luma, y, row);
            if needs_chroma {
                with_chroma(frame, &ycbcr, y, &mut row[..frame.width]);
            } else if let Some(levels) = &levels {
                row.iter_mut().for_each(|y| *y = levels[usize::from(*y)]);
            }
        }
        true
    }

    /// The plane of the last run.
    pub fn plane(&self) -> &Frame {
        &self.plane
    }
}

/// Of Y'CbCr by another matrix than BT.601's, where luma depends on chroma as well: row `y` holds Y.
fn with_chroma(frame: &Frame, ycbcr: &Ycbcr, y: usize, row: &mut [u8]) {
    let (at, step) = match frame.format {
        PixelFormat::Yuyv => (y * frame.stride_bytes + 1, 4),
        _ => ((frame.height + y / 2) * frame.stride_bytes, 2),
    };
    let chroma = frame.bytes.get(at..).unwrap_or_default().chunks(step);
    let distance = step / 2;
    for (pair, chroma) in row.chunks_mut(2).zip(chroma) {
        let [u, v] = [0, distance].map(|i| chroma.get(i).copied().unwrap_or(128));
        pair.iter_mut().for_each(|y| *y = ycbcr.luma(*y, u, v));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{LumaView, QuantizationRange, YcbcrMatrix};
    use rand::{RngExt, SeedableRng};

    #[test]
    fn every_pixel_is_what_the_frame_says_with_all_instructions() {
        let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(3);
        let formats = [
            (PixelFormat::Rgb, 3),
            (PixelFormat::Bgr, 3),
            (PixelFormat::Grey, 1),
            (PixelFormat::Yuyv, 2),
            (PixelFormat::Nv12, 1),
        ];
        for (format, pixel) in formats {
            for matrix in [YcbcrMatrix::Bt601, YcbcrMatrix::Bt709] {
                for range in [QuantizationRange::Limited, QuantizationRange::Full] {
                    let (width, height, stride_bytes) = (70, 5, 70 * pixel + 6);
                    let encoding = ColourEncoding { matrix, range };
                    let mut frame =
                        Frame { format, width, height, stride_bytes, encoding, ..Frame::default() };
                    frame.bytes = (0..frame.bytes_needed()).map(|_| random.random_range(0..=255)).collect();
                    let view = LumaView::new(&frame).unwrap();
                    for level in Level::available() {
                        let mut stage = LumaPlane::with_level(width, height, *level);
                        let plane = LumaView::new(stage.run(&frame, encoding)).unwrap();
                        for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
                            assert_eq!(
                                plane.at(x, y),
                                view.at(x, y),
                                "{format:?} {encoding:?} {level:?} {x} {y}"
                            );
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn what_is_late_is_not_begun() {
        let white = Frame::from_rgb(64, 40, vec![255; 3 * 64 * 40]);
        let mut stage = LumaPlane::new(64, 40);
        assert!(!stage.run_until(&white, white.encoding, Some(Timestamp(0))));
        assert_eq!(stage.plane().luma(0, 0), 0);
        assert!(stage.run_until(&white, white.encoding, None));
        assert_eq!(stage.plane().luma(63, 39), 255);
    }

    #[test]
    fn a_short_frame_is_black_where_it_ends() {
        let short = Frame { bytes: vec![255; 3 * 64], ..Frame::from_rgb(64, 2, vec![255; 3 * 128]) };
        let mut stage = LumaPlane::new(64, 2);
        let plane = stage.run(&short, short.encoding);
        assert_eq!((plane.luma(63, 0), plane.luma(0, 1)), (255, 0));
        let narrow = Frame::from_rgb(63, 2, vec![255; 3 * 126]);
        assert!(stage.run(&narrow, narrow.encoding).bytes.iter().all(|&luma| luma == 0));
        let empty = Frame { height: 3, ..Frame::default() };
        assert_eq!(LumaPlane::new(0, 3).run(&empty, narrow.encoding).width, 0);
    }
}
