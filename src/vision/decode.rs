//! MJPEG frames to raw ones.
//!
//! Takes a [`Frame`]; gives a raw one: the frame itself where it is raw already, else the picture decoded into a
//! frame that [`Decoder`] owns and uses again. JPEG is full range BT.601 (JFIF), so the result is RGB or, where only
//! luma is wanted, the Y plane alone.
//!
//! Baseline pictures, which is what webcams send, with or without Huffman tables, are decoded here and allocate
//! nothing after `new`. Others (progressive, odd sampling) go to zune-jpeg, which allocates in every picture.
//!
//! ```
//! use pickcell::frame::{Frame, PixelFormat};
//! use pickcell::vision::decode::{DecodeError, Decoder, Output};
//!
//! let path = concat!(env!("CARGO_MANIFEST_DIR"), "/replay/conveyor/left/0000.jpg");
//! let bytes = std::fs::read(path)?;
//! let mut sent = Frame { bytes, format: PixelFormat::Mjpeg, width: 640, height: 480, ..Frame::default() };
//! let mut decoder = Decoder::new(Output::Grey, 640, 480);
//! let raw = decoder.run(&sent)?;
//! assert_eq!((raw.format, raw.bytes.len()), (PixelFormat::Grey, 640 * 480));
//!
//! sent.bytes.truncate(2000); // a transfer that broke off
//! assert!(decoder.run(&sent).is_err());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod baseline;
mod bits;
mod block;
mod huffman;
mod idct;
mod planes;
mod rows;
mod tables;
#[cfg(test)]
mod written;

use std::fmt::Display;

use crate::frame::{Frame, PixelFormat};
use crate::level::Level;
use crate::time::Timestamp;
use baseline::{Baseline, Fault};
use idct::Kernel;
use zune_core::{bytestream::ZCursor, colorspace::ColorSpace, options::DecoderOptions};
use zune_jpeg::JpegDecoder;

/// The picture with the standard Huffman tables, where it has none of its own: what other programs can read. `None`
/// where it needs nothing, or is no JPEG.
pub fn insert_tables(jpeg: &[u8]) -> Option<Vec<u8>> {
    let mut at = 2;
    // Markers with their lengths, up to the start of the scan.
    loop {
        let &[0xff, marker, high, low] = jpeg.get(at..at + 4)? else { return None };
        match marker {
            0xc4 => return None,
            0xda => break,
            _ => at += 2 + usize::from(u16::from_be_bytes([high, low])),
        }
    }
    Some([&jpeg[..at], &tables::STANDARD_TABLES, &jpeg[at..]].concat())
}

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
    #[error(
        "JPEG picture of {bytes} bytes is cut short: the camera or its cable dropped data, or the file was not copied whole; \
         record or copy it again"
    )]
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
    #[error("JPEG picture of {bytes} bytes is damaged: {reason}; record or copy it again")]
    Damaged {
        /// How many bytes there are.
        bytes: usize,
        /// What the decoder met, on one line.
        reason: String,
    },
    /// Other colours than luma and chroma, or grey; no webcam sends them.
    #[error(
        "JPEG picture has the colour components {components}, which are not supported; convert it to a png in RGB or grey"
    )]
    Colours {
        /// Which.
        components: &'static str,
    },
    /// Its moment had come before it was done; only of [`Decoder::run_until`].
    #[error("the time for decoding is over")]
    OutOfTime,
}

/// A message of another library without line breaks and runs of blanks: what is printed a line a picture.
pub(crate) fn on_one_line(message: impl Display) -> String {
    message.to_string().split_whitespace().collect::<Vec<_>>().join(" ")
}

/// The stage: owns the raw frame.
#[derive(Clone, Debug)]
pub struct Decoder {
    output: Output,
    raw: Frame,
    level: Level,
    baseline: Baseline,
}

impl Decoder {
    /// Allocates for pictures of this size in pixels.
    pub fn new(output: Output, width: usize, height: usize) -> Self {
        Self::with_level(output, width, height, Level::detect())
    }

    /// As [`Decoder::new`] with other instructions, for comparing them; those this machine lacks are not used.
    pub fn with_level(output: Output, width: usize, height: usize, level: Level) -> Self {
        let (format, channels) = match output {
            Output::Rgb => (PixelFormat::Rgb, 3),
            Output::Grey => (PixelFormat::Grey, 1),
        };
        let bytes = vec![0; channels * width * height];
        let raw = Frame { bytes, format, width, height, stride_bytes: channels * width, ..Frame::default() };
        Self { output, raw, level: level.supported(), baseline: Baseline::new(width, height) }
    }

    /// The picture that the last run decoded.
    pub fn raw(&self) -> &Frame {
        &self.raw
    }

    /// The raw frame of `frame`: itself, or its picture decoded.
    ///
    /// # Errors
    /// [`DecodeError`] for what is no JPEG picture, cut short, damaged, of another size, or in colours that give no luma.
    pub fn run<'a>(&'a mut self, frame: &'a Frame) -> Result<&'a Frame, DecodeError> {
        self.run_until(frame, None)
    }

    /// As [`Decoder::run`], broken off at this moment where it is given; JPEG other than baseline is decoded whole.
    ///
    /// # Errors
    /// Also [`DecodeError::OutOfTime`].
    pub fn run_until<'a>(
        &'a mut self,
        frame: &'a Frame,
        end: Option<Timestamp>,
    ) -> Result<&'a Frame, DecodeError> {
        if frame.format != PixelFormat::Mjpeg {
            return Ok(frame);
        }
        let bytes = frame.bytes.len();
        if !frame.bytes.starts_with(&[0xff, 0xd8]) {
            return Err(DecodeError::NotJpeg { bytes });
        }
        let jpeg = trimmed(&frame.bytes).ok_or(DecodeError::Truncated { bytes })?;
        let size = |width, height| {
            let (wanted_width, wanted_height) = (self.raw.width, self.raw.height);
            DecodeError::Size { width, height, wanted_width, wanted_height }
        };
        match decode(self.level, &mut self.baseline, jpeg, end, self.output, &mut self.raw.bytes) {
            Ok(()) => {}
            Err(Fault::Unsupported) => decode_unusual(jpeg, self.output, &mut self.raw, bytes)?,
            Err(Fault::Damaged(reason)) => return Err(DecodeError::Damaged { bytes, reason: reason.into() }),
            Err(Fault::Size(width, height)) => return Err(size(width, height)),
            Err(Fault::Late) => return Err(DecodeError::OutOfTime),
        }
        self.raw.timestamp = frame.timestamp;
        self.raw.mark = frame.mark;
        self.raw.sequence = frame.sequence;
        Ok(&self.raw)
    }
}

/// A baseline picture with the instructions there are; the result does not depend on them.
fn decode(
    level: Level,
    baseline: &mut Baseline,
    jpeg: &[u8],
    end: Option<Timestamp>,
    output: Output,
    out: &mut Vec<u8>,
) -> Result<(), Fault> {
    match level {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: `with_level` takes no level above what `Level::detect` found on this machine.
        Level::Avx512 => unsafe { decode_avx512(baseline, jpeg, end, output, out) },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: as above.
        Level::Avx2 => unsafe { decode_avx2(baseline, jpeg, end, output, out) },
        _ => decode_anywhere(idct::Plain, baseline, jpeg, end, output, out),
    }
}

/// [`decode_anywhere`] compiled for AVX-512.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi1,bmi2,avx512f,avx512bw,avx512dq,avx512vl")]
fn decode_avx512(
    baseline: &mut Baseline,
    jpeg: &[u8],
    end: Option<Timestamp>,
    output: Output,
    out: &mut Vec<u8>,
) -> Result<(), Fault> {
    // SAFETY: this function's own condition.
    let kernel = unsafe { idct::Avx512::new() };
    decode_anywhere(kernel, baseline, jpeg, end, output, out)
}

/// [`decode_anywhere`] compiled for AVX2.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi1,bmi2")]
fn decode_avx2(
    baseline: &mut Baseline,
    jpeg: &[u8],
    end: Option<Timestamp>,
    output: Output,
    out: &mut Vec<u8>,
) -> Result<(), Fault> {
    // SAFETY: this function's own condition.
    let kernel = unsafe { idct::Avx2::new() };
    decode_anywhere(kernel, baseline, jpeg, end, output, out)
}

#[inline(always)]
fn decode_anywhere(
    kernel: impl Kernel,
    baseline: &mut Baseline,
    jpeg: &[u8],
    end: Option<Timestamp>,
    output: Output,
    out: &mut Vec<u8>,
) -> Result<(), Fault> {
    baseline.read(kernel, jpeg, output == Output::Grey, end)?;
    match output {
        Output::Rgb => baseline.write_rgb(out, end)?,
        Output::Grey => baseline.write_luma(out),
    }
    Ok(())
}

/// A picture of a kind that [`Baseline`] does not know.
fn decode_unusual(jpeg: &[u8], output: Output, raw: &mut Frame, bytes: usize) -> Result<(), DecodeError> {
    let damaged = |e: zune_jpeg::errors::DecodeErrors| DecodeError::Damaged { bytes, reason: on_one_line(e) };
    let space = match output {
        Output::Rgb => ColorSpace::RGB,
        Output::Grey => ColorSpace::Luma,
    };
    let options = DecoderOptions::default().set_strict_mode(true).jpeg_set_out_colorspace(space);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(jpeg), options);
    decoder.decode_headers().map_err(damaged)?;
    let (width, height) = decoder.dimensions().unwrap_or_default();
    if (width, height) != (raw.width, raw.height) {
        return Err(DecodeError::Size { width, height, wanted_width: raw.width, wanted_height: raw.height });
    }
    let space = decoder.input_colorspace().unwrap_or(ColorSpace::YCbCr);
    if output == Output::Grey && !matches!(space, ColorSpace::YCbCr | ColorSpace::Luma) {
        let count = decoder.info().map_or(0, |info| info.components);
        return Err(DecodeError::Colours { components: components_of(space, count) });
    }
    decoder.decode_into(&mut raw.bytes).map_err(damaged)
}

/// The names of the components; the decoder calls all that are not luma and chroma CMYK.
fn components_of(space: ColorSpace, count: u8) -> &'static str {
    match (space, count) {
        (_, 3) => "R, G, B",
        (ColorSpace::YCCK, _) => "Y, Cb, Cr, K",
        (_, 4) => "C, M, Y, K",
        _ => "of an unknown kind",
    }
}

/// The picture up to its end-of-image marker; drivers may pad the buffer with zeros.
fn trimmed(bytes: &[u8]) -> Option<&[u8]> {
    let end = bytes.windows(2).rposition(|pair| pair == [0xff, 0xd9])?;
    Some(&bytes[..end + 2])
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::codecs::jpeg::JpegEncoder;
    use proptest::prelude::*;

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
    fn the_quantization_of_the_picture_before_is_not_used() {
        let good = jpeg(48, 32);
        let mut bad = good.clone();
        while let Some(at) = bad.bytes.windows(2).position(|pair| pair == [0xff, 0xdb]) {
            bad.bytes[at + 1] = 0xe1;
        }
        let mut decoder = Decoder::new(Output::Grey, 48, 32);
        decoder.run(&good).unwrap();
        let fault = decoder.run(&bad).expect_err("no tables");
        assert!(fault.to_string().contains("no quantization table"), "{fault}");
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
        let bare = without_tables(&frame);
        assert_eq!(decoder.run(&bare).expect("decodes").bytes, raw.bytes);
        let bytes = insert_tables(&bare.bytes).expect("tables are missing");
        assert!(image::load_from_memory(&bytes).is_ok());
        assert_eq!((insert_tables(&bytes), insert_tables(b"no picture")), (None, None));
        assert_eq!(decoder.run(&Frame { bytes, ..bare }).expect("decodes").bytes, raw.bytes);
        let grey = Decoder::new(Output::Grey, 48, 32).run(&frame).expect("decodes").clone();
        for (i, got) in grey.bytes.iter().enumerate() {
            assert!(got.abs_diff(raw.luma(i % 48, i / 48)) < 3);
        }
    }

    /// The first pictures of the recorded session: 640x480, chroma at half size both ways.
    fn recorded() -> Vec<Frame> {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/replay/conveyor/left");
        let mut paths: Vec<_> =
            std::fs::read_dir(folder).expect("the recorded session").flatten().map(|e| e.path()).collect();
        paths.sort();
        let frame = |path| Frame {
            bytes: std::fs::read(path).expect("a picture"),
            format: PixelFormat::Mjpeg,
            width: 640,
            height: 480,
            ..Frame::default()
        };
        paths.iter().take(2).map(frame).collect()
    }

    #[test]
    fn recorded_pictures_decode_as_another_decoder_does_on_all_instructions() {
        for frame in recorded() {
            let expected = image::load_from_memory(&frame.bytes).expect("decodes").to_rgb8().into_raw();
            let mut first = None;
            for &level in Level::available() {
                let raw =
                    Decoder::with_level(Output::Rgb, 640, 480, level).run(&frame).expect("decodes").clone();
                let differences = raw.bytes.iter().zip(&expected).map(|(a, b)| u32::from(a.abs_diff(*b)));
                assert!(differences.clone().max().is_some_and(|d| d < 8), "rounding alone differs");
                assert!(differences.sum::<u32>() < expected.len() as u32 / 4, "and seldom");
                assert_eq!(first.get_or_insert_with(|| raw.clone()), &raw, "{level:?}");
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(150))]

        #[test]
        fn no_damage_makes_it_panic(
            changes in proptest::collection::vec((0.0..1.0f64, any::<u8>(), 0usize..3), 1..5), keep in 0.0..1.5f64
        ) {
            let mut frame = jpeg(48, 32);
            for (place, byte, kind) in changes {
                let at = (place * frame.bytes.len() as f64) as usize;
                match kind {
                    0 => frame.bytes[at] = byte,
                    1 => drop(frame.bytes.remove(at)),
                    _ => frame.bytes.insert(at, byte),
                }
            }
            if keep < 1.0 {
                frame.bytes.truncate((keep * frame.bytes.len() as f64) as usize);
                frame.bytes.extend([0xff, 0xd9]);
            }
            for output in [Output::Rgb, Output::Grey] {
                let _ = Decoder::new(output, 48, 32).run(&frame);
            }
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
    fn what_was_broken_off_leaves_nothing_behind() {
        let (late, frames) = (Some(Timestamp(0)), recorded());
        let (first, second) = (&frames[0], &frames[1]);
        for level in Level::available() {
            let decoder = || Decoder::with_level(Output::Rgb, first.width, first.height, *level);
            let mut broken_off = decoder();
            assert_eq!(broken_off.run_until(first, late), Err(DecodeError::OutOfTime), "{level:?}");
            assert_eq!(broken_off.run(second), decoder().run(second), "{level:?}");
        }
        let raw = Frame::from_rgb(2, 1, vec![1; 6]);
        assert_eq!(Decoder::new(Output::Rgb, 2, 1).run_until(&raw, late), Ok(&raw), "nothing to be done");
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
        let cut = message(&good.bytes[..good.bytes.len() / 2]);
        assert!(cut.ends_with("record or copy it again"), "{cut}");
    }

    #[test]
    fn colours_without_luma_are_named() {
        let mut frame = jpeg(48, 32);
        // Adobe's marker: the components are not Y, Cb and Cr.
        frame.bytes.splice(2..2, *b"\xff\xee\x00\x0eAdobe\x00\x64\x00\x00\x00\x00\x00");
        assert!(Decoder::new(Output::Rgb, 48, 32).run(&frame).is_ok());
        let fault = Decoder::new(Output::Grey, 48, 32).run(&frame).expect_err("no luma").to_string();
        assert!(
            fault.contains("has the colour components R, G, B, which are not supported; convert"),
            "{fault}"
        );
    }
}
