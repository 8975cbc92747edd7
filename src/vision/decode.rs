//! MJPEG frames to raw ones.
//!
//! Takes a [`Frame`]; gives a raw one: the frame itself where it is raw already, else the picture decoded into a
//! frame that [`Decoder`] owns and uses again. JPEG is full range BT.601 (JFIF), so the result is RGB or, where only
//! luma is wanted, the Y plane alone.
//!
//! The decoder is zune-jpeg. What is ours (output, a copy of pictures without Huffman tables) is allocated once;
//! zune-jpeg itself allocates tables and row buffers anew in every picture.

mod tables;

use crate::frame::{Frame, PixelFormat};
use tables::STANDARD_TABLES;
use zune_core::{bytestream::ZCursor, colorspace::ColorSpace, options::DecoderOptions};
use zune_jpeg::JpegDecoder;

/// What a JPEG is decoded to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Output {
    /// R, G, B.
    #[default]
    Rgb,
    /// BT.601 luma alone, which is faster.
    Grey,
}

/// A picture that cannot be decoded.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// Not a JPEG at all.
    #[error("{bytes} bytes that are no JPEG picture (no start-of-image marker); is the camera set to MJPG?")]
    NotJpeg {
        /// How many bytes there are.
        bytes: usize,
    },
    /// Cut short: no end-of-image marker.
    #[error("JPEG picture of {bytes} bytes is cut short; the camera or its cable dropped data")]
    Truncated {
        /// How many bytes there are.
        bytes: usize,
    },
    /// A size other than the cell's.
    #[error(
        "JPEG picture is {width}x{height} where {wanted_width}x{wanted_height} is set up; set the camera's size or the calibration's"
    )]
    Size {
        /// Its width.
        width: usize,
        /// Its height.
        height: usize,
        /// Width of `new`.
        wanted_width: usize,
        /// Height of `new`.
        wanted_height: usize,
    },
    /// Damaged inside.
    #[error("JPEG picture of {bytes} bytes is damaged: {reason}")]
    Damaged {
        /// How many bytes there are.
        bytes: usize,
        /// What the decoder met.
        reason: String,
    },
}

/// The stage: owns the raw frame.
#[derive(Clone, Debug)]
pub struct Decoder {
    output: Output,
    raw: Frame,
    with_tables: Vec<u8>,
}

impl Decoder {
    /// Allocates for pictures of this size in pixels.
    pub fn new(output: Output, width: usize, height: usize) -> Self {
        let (format, channels) = match output {
            Output::Rgb => (PixelFormat::Rgb, 3),
            Output::Grey => (PixelFormat::Grey, 1),
        };
        let bytes = vec![0; channels * width * height];
        let raw = Frame { bytes, format, width, height, stride_bytes: channels * width, ..Frame::default() };
        Self { output, raw, with_tables: Vec::with_capacity(width * height + STANDARD_TABLES.len()) }
    }

    /// The picture that the last run decoded.
    pub fn raw(&self) -> &Frame {
        &self.raw
    }

    /// The raw frame of `frame`: itself, or its picture decoded.
    ///
    /// # Errors
    /// [`DecodeError`] for what is no JPEG picture, cut short, damaged or of another size.
    pub fn run<'a>(&'a mut self, frame: &'a Frame) -> Result<&'a Frame, DecodeError> {
        if frame.format != PixelFormat::Mjpeg {
            return Ok(frame);
        }
        let bytes = frame.bytes.len();
        if !frame.bytes.starts_with(&[0xff, 0xd8]) {
            return Err(DecodeError::NotJpeg { bytes });
        }
        let jpeg = trimmed(&frame.bytes).ok_or(DecodeError::Truncated { bytes })?;
        let damaged =
            |e: zune_jpeg::errors::DecodeErrors| DecodeError::Damaged { bytes, reason: e.to_string() };
        let space = match self.output {
            Output::Rgb => ColorSpace::RGB,
            Output::Grey => ColorSpace::Luma,
        };
        let jpeg = match tables_missing_at(jpeg) {
            Some(at) => {
                self.with_tables.clear();
                for part in [&jpeg[..at], &STANDARD_TABLES, &jpeg[at..]] {
                    self.with_tables.extend_from_slice(part);
                }
                &self.with_tables
            }
            None => jpeg,
        };
        let options = DecoderOptions::default().set_strict_mode(true).jpeg_set_out_colorspace(space);
        let mut decoder = JpegDecoder::new_with_options(ZCursor::new(jpeg), options);
        decoder.decode_headers().map_err(damaged)?;
        let (width, height) = decoder.dimensions().unwrap_or_default();
        if (width, height) != (self.raw.width, self.raw.height) {
            let (wanted_width, wanted_height) = (self.raw.width, self.raw.height);
            return Err(DecodeError::Size { width, height, wanted_width, wanted_height });
        }
        decoder.decode_into(&mut self.raw.bytes).map_err(damaged)?;
        self.raw.timestamp = frame.timestamp;
        self.raw.mark = frame.mark;
        self.raw.sequence = frame.sequence;
        Ok(&self.raw)
    }
}

/// The picture up to its end-of-image marker; drivers may pad the buffer with zeros.
fn trimmed(bytes: &[u8]) -> Option<&[u8]> {
    let end = bytes.windows(2).rposition(|pair| pair == [0xff, 0xd9])?;
    Some(&bytes[..end + 2])
}

/// Where Huffman tables must go in: before the scan of a picture that has none.
fn tables_missing_at(jpeg: &[u8]) -> Option<usize> {
    let mut at = 2;
    loop {
        let (&marker, &kind) = (jpeg.get(at)?, jpeg.get(at + 1)?);
        match (marker, kind) {
            (0xff, 0xff) => at += 1,
            (0xff, 0xc4) => return None,
            (0xff, 0xda) => return Some(at),
            (0xff, _) => at += 2 + usize::from(u16::from_be_bytes([*jpeg.get(at + 2)?, *jpeg.get(at + 3)?])),
            _ => return None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::codecs::jpeg::JpegEncoder;

    fn picture(width: usize, height: usize) -> Vec<u8> {
        (0..3 * width * height).map(|i| (i / 3 % width * 3 + i / (3 * width) * 2) as u8).collect()
    }

    fn jpeg(width: usize, height: usize) -> Frame {
        let mut bytes = Vec::new();
        JpegEncoder::new_with_quality(&mut bytes, 95)
            .encode(&picture(width, height), width as u32, height as u32, image::ExtendedColorType::Rgb8)
            .expect("encodes");
        Frame { bytes, format: PixelFormat::Mjpeg, width, height, sequence: 7, ..Frame::default() }
    }

    /// The picture without its Huffman tables, as many webcams send it.
    fn without_tables(frame: &Frame) -> Frame {
        let mut bytes = frame.bytes[..2].to_vec();
        let mut at = 2;
        loop {
            let end = at + 2 + usize::from(u16::from_be_bytes([frame.bytes[at + 2], frame.bytes[at + 3]]));
            match frame.bytes[at + 1] {
                0xda => break,
                0xc4 => {}
                _ => bytes.extend_from_slice(&frame.bytes[at..end]),
            }
            at = end;
        }
        bytes.extend_from_slice(&frame.bytes[at..]);
        assert!(bytes.len() < frame.bytes.len());
        Frame { bytes, ..frame.clone() }
    }

    #[test]
    fn a_picture_decodes_to_its_colours_with_or_without_tables() {
        let frame = jpeg(48, 32);
        let mut decoder = Decoder::new(Output::Rgb, 48, 32);
        let raw = decoder.run(&frame).expect("decodes").clone();
        assert_eq!((raw.format, raw.width, raw.height, raw.sequence), (PixelFormat::Rgb, 48, 32, 7));
        for (got, want) in raw.bytes.iter().zip(picture(48, 32)) {
            assert!(got.abs_diff(want) < 12, "{got} {want}");
        }
        assert_eq!(decoder.run(&without_tables(&frame)).expect("decodes").bytes, raw.bytes);
        let grey = Decoder::new(Output::Grey, 48, 32).run(&frame).expect("decodes").clone();
        for (i, got) in grey.bytes.iter().enumerate() {
            assert!(got.abs_diff(raw.luma(i % 48, i / 48)) < 3);
        }
    }

    #[test]
    fn raw_frames_pass_and_padding_is_ignored() {
        let raw = Frame::from_rgb(2, 1, vec![1; 6]);
        assert_eq!(Decoder::new(Output::Rgb, 2, 1).run(&raw), Ok(&raw));
        let mut padded = jpeg(16, 16);
        padded.bytes.extend([0; 100]);
        assert!(Decoder::new(Output::Rgb, 16, 16).run(&padded).is_ok());
    }

    #[test]
    fn bad_pictures_are_refused_in_words() {
        let good = jpeg(48, 32);
        let mut decoder = Decoder::new(Output::Rgb, 48, 32);
        let mut message = |bytes: &[u8]| {
            let frame = Frame { bytes: bytes.to_vec(), ..good.clone() };
            decoder.run(&frame).expect_err("bad").to_string()
        };
        assert!(message(b"").contains("0 bytes that are no JPEG"));
        assert!(message(&good.bytes[..good.bytes.len() / 2]).contains("is cut short"));
        assert!(message(&[0xff, 0xd8, 0xff, 0xd9]).contains("is damaged"));
        assert!(message(&jpeg(32, 32).bytes).contains("is 32x32 where 48x32 is set up"));
        for cut in 2..good.bytes.len() - 2 {
            let mut bytes = good.bytes[..cut].to_vec();
            bytes.extend([0xff, 0xd9]);
            let frame = Frame { bytes, ..good.clone() };
            let _ = Decoder::new(Output::Rgb, 48, 32).run(&frame);
        }
    }
}
