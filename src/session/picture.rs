//! A picture file, or a picture message of a recording, as a [`Frame`].

use std::io::Cursor;
use std::path::{Path, PathBuf};

use firmware_bridge::outside::read_up_to;
use image::metadata::Orientation;
use image::{ColorType, DynamicImage, ImageDecoder, ImageFormat, ImageReader};

use prost::Message;

use super::foxglove::{CompressedImage, ImageKind, RawImage, format_of};
use super::records::RecordingError;
use crate::frame::{ColourEncoding, Frame, PixelFormat, SIDE_PX_MAX};
use crate::vision::decode::on_one_line;

/// A picture that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum PictureError {
    /// The file cannot be read.
    #[error("{}: cannot read it: {reason}; give the path of a png or jpg picture", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system said.
        reason: std::io::Error,
    },
    /// The file is no PNG or JPEG, or is damaged.
    #[error("{}: not a whole png or jpg picture ({reason}); record or copy it again", path.display())]
    Broken {
        /// The file.
        path: PathBuf,
        /// What the decoder said, on one line.
        reason: String,
    },
    /// Without bytes.
    #[error("{}: is empty; record or copy it again", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// To be turned before it is looked at, as OpenCV does and a camera of a cell does not.
    #[error(
        "{}: its EXIF orientation says that it is to be turned or mirrored; OpenCV does so, so that for a calibration made with it the \
         pixels are to be turned (`mogrify -auto-orient`), else take the mark away (`exiftool -Orientation=`)", path.display()
    )]
    Turned {
        /// The file.
        path: PathBuf,
    },
    /// Neither PNG nor JPEG by its first bytes.
    #[error("{}: neither a png nor a jpg picture; record it as one of them, or convert it", path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
    },
    /// A message of another kind than its schema says.
    #[error("{}: no picture message ({reason}); record it again", path.display())]
    Message {
        /// The message.
        path: PathBuf,
        /// What the decoder said.
        reason: prost::DecodeError,
    },
    /// A raw picture in a format that no camera of a cell delivers.
    #[error("{}: pixels in the encoding {encoding:?}; possible are yuyv, nv12, rgb8, bgr8 and mono8", path.display())]
    Encoding {
        /// The message.
        path: PathBuf,
        /// As written.
        encoding: String,
    },
    /// Too few bytes for its size, or rows that overlap.
    #[error(
        "{}: {bytes} bytes with {step} a row for {width}x{height} pixels are no whole picture; record it again", path.display()
    )]
    Short {
        /// The message.
        path: PathBuf,
        /// What is there.
        bytes: usize,
        /// Bytes a row, as written.
        step: u32,
        /// Its width.
        width: u32,
        /// Its height.
        height: u32,
    },
    /// The recording that it is in.
    #[error(transparent)]
    Recording(#[from] RecordingError),
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
    let bytes = read_up_to(path, FILE_BYTES_MAX)
        .map_err(|reason| PictureError::Unreadable { path: path.to_owned(), reason })?;
    // Messages of a recording are as their camera sent them, and played as such.
    if is_to_be_turned(&bytes) {
        return Err(PictureError::Turned { path: path.to_owned() });
    }
    from_file(bytes, path)
}

/// No picture that is taken has a larger file: a device that never ends must not fill the memory.
const FILE_BYTES_MAX: u64 = 256 << 20;

/// Whether the EXIF orientation of a picture is another than 1; of a PNG if it stands before the picture, as cameras write it.
fn is_to_be_turned(bytes: &[u8]) -> bool {
    let reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format().ok();
    let orientation = reader.and_then(|reader| reader.into_decoder().ok()?.orientation().ok());
    orientation.is_some_and(|orientation| orientation != Orientation::NoTransforms)
}

/// Reads a picture file as [`read_picture`] does, but decodes a JPEG too.
///
/// # Errors
/// It cannot be read, is no whole picture, or larger than the cell takes.
pub fn read_raw_picture(path: &Path) -> Result<Frame, PictureError> {
    decoded(read_picture(path)?, path.to_owned())
}

/// The bytes of a png or jpg file; `path` is where they are from.
fn from_file(bytes: Vec<u8>, path: &Path) -> Result<Frame, PictureError> {
    if bytes.is_empty() {
        return Err(PictureError::Empty { path: path.to_owned() });
    }
    let broken = |error: image::ImageError| broken(path, error);
    let format = image::guess_format(&bytes).map_err(|_| PictureError::Foreign { path: path.to_owned() })?;
    let reader = || ImageReader::with_format(Cursor::new(&bytes), format);
    let (width, height) = match format {
        ImageFormat::Png | ImageFormat::Jpeg => reader().into_dimensions().map_err(broken)?,
        _ => return Err(PictureError::Foreign { path: path.to_owned() }),
    };
    check_size(width, height, path)?;
    let (width, height) = (width as usize, height as usize);
    if format == ImageFormat::Jpeg {
        let format = PixelFormat::Mjpeg;
        return Ok(Frame { bytes, format, width, height, ..Frame::default() });
    }
    let decoded = reader().decode().map_err(broken)?;
    // The decoder is content with all pixels. A file that ends there was not written or copied to its end.
    if !bytes.windows(PNG_END.len()).rev().any(|bytes| bytes == PNG_END) {
        let reason = "its end is missing".to_owned();
        return Err(PictureError::Broken { path: path.to_owned(), reason });
    }
    Ok(from_decoded(decoded, width, height))
}

/// Type and checksum of the last chunk of a PNG.
const PNG_END: &[u8] = b"IEND\xae\x42\x60\x82";

fn broken(path: &Path, error: image::ImageError) -> PictureError {
    let mut reason = on_one_line(error);
    // The decoder shows what it is made of.
    if reason.contains("CRC error") {
        reason = "a checksum is wrong".to_owned();
    }
    PictureError::Broken { path: path.to_owned(), reason }
}

fn check_size(width: u32, height: u32, path: &Path) -> Result<(), PictureError> {
    match width > SIDE_PX_MAX || height > SIDE_PX_MAX {
        true => Err(PictureError::TooLarge { path: path.to_owned(), width, height }),
        false => Ok(()),
    }
}

/// The picture in a message of a recording; `place` says where that stands.
pub(super) fn from_message(
    message: &[u8],
    kind: ImageKind,
    encoding: ColourEncoding,
    place: PathBuf,
) -> Result<Frame, PictureError> {
    let message_error = |reason| PictureError::Message { path: place.clone(), reason };
    let raw = match kind {
        ImageKind::Compressed => {
            let image = CompressedImage::decode(message).map_err(message_error)?;
            return from_file(image.data, &place);
        }
        ImageKind::Raw => RawImage::decode(message).map_err(message_error)?,
    };
    let RawImage { width, height, step, data, .. } = raw;
    check_size(width, height, &place)?;
    let Some(format) = format_of(&raw.encoding) else {
        return Err(PictureError::Encoding { path: place, encoding: raw.encoding });
    };
    let frame = Frame {
        bytes: data,
        format,
        width: width as usize,
        height: height as usize,
        stride_bytes: step as usize,
        encoding,
        ..Frame::default()
    };
    let bytes = frame.bytes.len();
    let whole = frame.stride_bytes >= frame.row_bytes() && bytes >= frame.bytes_needed();
    if width == 0 || height == 0 || !whole {
        return Err(PictureError::Short { path: place, bytes, step, width, height });
    }
    Ok(frame)
}

/// The picture without compression.
pub(super) fn decoded(frame: Frame, path: PathBuf) -> Result<Frame, PictureError> {
    if frame.format != PixelFormat::Mjpeg {
        return Ok(frame);
    }
    let decoded = image::load_from_memory_with_format(&frame.bytes, ImageFormat::Jpeg)
        .map_err(|error| broken(&path, error))?;
    Ok(from_decoded(decoded, frame.width, frame.height))
}

fn from_decoded(decoded: DynamicImage, width: usize, height: usize) -> Frame {
    match decoded.color() {
        ColorType::L8 | ColorType::La8 | ColorType::L16 | ColorType::La16 => {
            Frame::from_grey(width, height, decoded.into_luma8().into_raw())
        }
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
        assert!(message("text.jpg").contains("text.jpg: neither a png nor a jpg picture; record it as one"));
        std::fs::write(at("empty.png"), "").unwrap();
        assert!(message("empty.png").ends_with("empty.png: is empty; record or copy it again"));
        let mut changed = whole.clone();
        let at_checksum = whole.windows(4).position(|bytes| bytes == b"IDAT").unwrap() - 9;
        changed[at_checksum] ^= 1;
        std::fs::write(at("changed.png"), changed).unwrap();
        let changed = message("changed.png");
        assert!(changed.contains("not a whole png or jpg picture (a checksum is wrong)"), "{changed}");
        let missing = message("none.png");
        assert!(missing.contains("none.png: cannot read it: No such file or directory"), "{missing}");
        assert!(missing.ends_with("; give the path of a png or jpg picture"), "{missing}");
    }

    #[test]
    fn a_png_without_its_end_is_not_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        image::RgbImage::new(64, 64).save(&path).unwrap();
        let whole = std::fs::read(&path).unwrap();
        for missing in [1, 4, 12] {
            std::fs::write(&path, &whole[..whole.len() - missing]).unwrap();
            let message = read_picture(&path).unwrap_err().to_string();
            assert!(message.contains("a.png: not a whole png or jpg picture"), "{missing}: {message}");
        }
        std::fs::write(&path, [&whole[..], b"and what some programs put behind it"].concat()).unwrap();
        assert!(read_picture(&path).is_ok());
    }

    #[test]
    fn a_picture_that_is_to_be_turned_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        image::RgbImage::new(8, 8).save(at("a.jpg")).unwrap();
        let jpeg = std::fs::read(at("a.jpg")).unwrap();
        for orientation in [1, 6] {
            // A directory of one entry: the orientation.
            let tiff = b"MM\0\x2a\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0";
            let tiff = [&tiff[..], &[orientation, 0, 0, 0, 0, 0, 0]].concat();
            let length = [0, 2 + 6 + tiff.len() as u8];
            let app1 = [b"\xff\xe1", &length[..], b"Exif\0\0", &tiff].concat();
            std::fs::write(at("b.jpg"), [&jpeg[..2], &app1, &jpeg[2..]].concat()).unwrap();
            let read = read_picture(&at("b.jpg"));
            match orientation {
                1 => assert!(read.is_ok()),
                _ => assert!(read.unwrap_err().to_string().contains("b.jpg: its EXIF orientation says")),
            }
        }
    }

    #[test]
    fn what_the_decoder_says_stays_on_one_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.jpg");
        // A segment of no length.
        std::fs::write(&path, [0xff, 0xd8, 0xff, 0xe0, 0, 0, 0xff, 0xd9]).unwrap();
        let message = read_picture(&path).unwrap_err().to_string();
        assert!(
            message.contains("a.jpg: not a whole png or jpg picture (") && !message.contains('\n'),
            "{message:?}"
        );
    }
}
