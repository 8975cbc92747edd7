//! A picture file as a [`Frame`].

use std::io::Cursor;
use std::path::{Path, PathBuf};

use image::{ColorType, DynamicImage, ImageFormat, ImageReader};

use crate::frame::{Frame, PixelFormat};

/// Largest width or height of a picture, pixels.
const SIDE_PX_MAX: u32 = 8192;

/// A picture that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum PictureError {
    /// The file cannot be read.
    #[error("{}: cannot read it: {reason}", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system said.
        reason: std::io::Error,
    },
    /// The file is no PNG or JPEG, or is damaged.
    #[error("{}: not a whole png or jpg picture ({reason}); record it again", path.display())]
    Broken {
        /// The file.
        path: PathBuf,
        /// What the decoder said.
        reason: image::ImageError,
    },
    /// Neither PNG nor JPEG by its first bytes.
    #[error("{}: neither a png nor a jpg picture", path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
    },
    /// Too large.
    #[error("{}: {width}x{height} pixels; at most {SIDE_PX_MAX} a side are possible", path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Its width.
        width: u32,
        /// Its height.
        height: u32,
    },
}

/// Reads a picture file. A JPEG keeps its bytes ([`PixelFormat::Mjpeg`]; only its header is looked at), a PNG is
/// decoded to grey where it is grey and to RGB otherwise.
///
/// # Errors
/// It cannot be read, is no picture, or larger than the cell takes.
pub fn read_picture(path: &Path) -> Result<Frame, PictureError> {
    let bytes =
        std::fs::read(path).map_err(|reason| PictureError::Unreadable { path: path.to_owned(), reason })?;
    let broken = |reason| PictureError::Broken { path: path.to_owned(), reason };
    let format = image::guess_format(&bytes).map_err(|_| PictureError::Foreign { path: path.to_owned() })?;
    let reader = || ImageReader::with_format(Cursor::new(&bytes), format);
    let (width, height) = match format {
        ImageFormat::Png | ImageFormat::Jpeg => reader().into_dimensions().map_err(broken)?,
        _ => return Err(PictureError::Foreign { path: path.to_owned() }),
    };
    if width > SIDE_PX_MAX || height > SIDE_PX_MAX {
        return Err(PictureError::TooLarge { path: path.to_owned(), width, height });
    }
    let (width, height) = (width as usize, height as usize);
    if format == ImageFormat::Jpeg {
        let format = PixelFormat::Mjpeg;
        return Ok(Frame { bytes, format, width, height, ..Frame::default() });
    }
    let decoded = reader().decode().map_err(broken)?;
    Ok(from_decoded(decoded, width, height))
}

/// Reads a picture file as [`read_picture`] does, but decodes a JPEG too.
///
/// # Errors
/// It cannot be read, is no whole picture, or larger than the cell takes.
pub fn read_raw_picture(path: &Path) -> Result<Frame, PictureError> {
    let frame = read_picture(path)?;
    if frame.format != PixelFormat::Mjpeg {
        return Ok(frame);
    }
    let decoded = image::load_from_memory_with_format(&frame.bytes, ImageFormat::Jpeg)
        .map_err(|reason| PictureError::Broken { path: path.to_owned(), reason })?;
    Ok(from_decoded(decoded, frame.width, frame.height))
}

fn from_decoded(decoded: DynamicImage, width: usize, height: usize) -> Frame {
    match decoded.color() {
        ColorType::L8 | ColorType::La8 | ColorType::L16 | ColorType::La16 => Frame {
            bytes: decoded.into_luma8().into_raw(),
            format: PixelFormat::Grey,
            width,
            height,
            stride_bytes: width,
            ..Frame::default()
        },
        _ => Frame::from_rgb(width, height, decoded.into_rgb8().into_raw()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn png_becomes_rgb_or_grey_and_jpeg_stays() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        image::RgbImage::from_pixel(4, 2, image::Rgb([1, 2, 3])).save(at("a.png")).unwrap();
        let frame = read_picture(&at("a.png")).unwrap();
        assert_eq!((frame.format, frame.width, frame.height), (PixelFormat::Rgb, 4, 2));
        assert_eq!((frame.stride_bytes, &frame.bytes[..3]), (12, &[1, 2, 3][..]));
        image::GrayImage::from_pixel(4, 2, image::Luma([7])).save(at("g.png")).unwrap();
        assert_eq!(read_picture(&at("g.png")).unwrap().format, PixelFormat::Grey);
        image::RgbImage::from_pixel(8, 8, image::Rgb([200, 2, 3])).save(at("j.jpg")).unwrap();
        let frame = read_picture(&at("j.jpg")).unwrap();
        assert_eq!((frame.format, frame.width), (PixelFormat::Mjpeg, 8));
        assert_eq!(frame.bytes, std::fs::read(at("j.jpg")).unwrap());
        let raw = read_raw_picture(&at("j.jpg")).unwrap();
        assert_eq!((raw.format, raw.bytes.len()), (PixelFormat::Rgb, 3 * 64));
    }

    #[test]
    fn broken_and_foreign_files_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        image::RgbImage::new(64, 64).save(at("a.png")).unwrap();
        let whole = std::fs::read(at("a.png")).unwrap();
        std::fs::write(at("cut.png"), &whole[..whole.len() / 2]).unwrap();
        std::fs::write(at("text.jpg"), "hello").unwrap();
        let message = |name: &str| read_picture(&at(name)).unwrap_err().to_string();
        assert!(message("cut.png").contains("cut.png: not a whole png or jpg picture"));
        assert!(message("text.jpg").ends_with("text.jpg: neither a png nor a jpg picture"));
        assert!(message("none.png").contains("none.png: cannot read it"));
    }
}
