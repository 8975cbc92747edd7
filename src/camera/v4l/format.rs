//! What a camera offers, whether it is what was asked for, and what the driver says about its colours.

use serde::Serialize;

use super::device::{Device, DriverFormat, Rate, Size};
use crate::config::CameraSettings;
use crate::frame::{ColourEncoding, PixelFormat, QuantizationRange, YcbcrMatrix};

/// Two rates nearer than this share are the same: drivers count in units of 100 ns.
const RATE_SHARE: f64 = 0.005;

/// The V4L2 four-character code of a format.
pub fn code(format: PixelFormat) -> [u8; 4] {
    *match format {
        PixelFormat::Rgb => b"RGB3",
        PixelFormat::Bgr => b"BGR3",
        PixelFormat::Grey => b"GREY",
        PixelFormat::Yuyv => b"YUYV",
        PixelFormat::Nv12 => b"NV12",
        PixelFormat::Mjpeg => b"MJPG",
    }
}

/// A four-character code as text; big-endian variants carry a mark in the highest bit.
pub fn code_text(code: [u8; 4]) -> String {
    let printable = |b: u8| if (b' '..=b'~').contains(&b) { char::from(b) } else { '?' };
    let big_endian = code[3] & 0x80 != 0;
    let bytes = [code[0], code[1], code[2], code[3] & 0x7f];
    let text: String = bytes.into_iter().map(printable).collect();
    format!("{}{}", text.trim_end(), if big_endian { "-BE" } else { "" })
}

/// One format that a camera offers, with its sizes and their rates.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OfferedFormat {
    /// Four-character code.
    pub format: String,
    /// Sizes, as the driver orders them.
    pub sizes: Vec<OfferedSize>,
}

/// One size, or a range of sizes, and its rates.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OfferedSize {
    /// `640x480`, or `160x120 to 1920x1080 in steps of 2x2`.
    pub size: String,
    /// Frames a second; two with `rates_are_range`.
    pub rates_hz: Vec<f64>,
    /// `rates_hz` are the slowest and the fastest, and all between is offered.
    pub rates_are_range: bool,
}

/// Everything that a camera offers.
pub fn offered(device: &Device) -> Vec<OfferedFormat> {
    let sizes = |code| device.sizes(code).into_iter().map(|size| offered_size(device, code, size)).collect();
    device
        .formats()
        .into_iter()
        .map(|code| OfferedFormat { format: code_text(code), sizes: sizes(code) })
        .collect()
}

fn offered_size(device: &Device, code: [u8; 4], size: Size) -> OfferedSize {
    let (text, (width, height)) = match size {
        Size::One(width, height) => (format!("{width}x{height}"), (width, height)),
        Size::Range { min, max, step } => {
            (format!("{}x{} to {}x{} in steps of {}x{}", min.0, min.1, max.0, max.1, step.0, step.1), max)
        }
    };
    let rates = device.rates(code, width, height);
    let is_range = matches!(rates.first(), Some(Rate::Range(..)));
    let round = |hz: f64| (hz * 1000.0).round() / 1000.0;
    let rates_hz = rates.iter().flat_map(|rate| match *rate {
        Rate::One(hz) => vec![round(hz)],
        Rate::Range(slow, fast) => vec![round(slow), round(fast)],
    });
    OfferedSize { size: text, rates_hz: rates_hz.collect(), rates_are_range: is_range }
}

/// The offer in words: `YUYV 640x480 at 30, 15; MJPG 640x480 at 30`.
pub fn in_words(offer: &[OfferedFormat]) -> String {
    let size = |size: &OfferedSize| {
        let between = if size.rates_are_range { " to " } else { ", " };
        let rates: Vec<_> = size.rates_hz.iter().map(f64::to_string).collect();
        match rates.is_empty() {
            true => size.size.clone(),
            false => format!("{} at {}", size.size, rates.join(between)),
        }
    };
    let format = |format: &OfferedFormat| {
        let sizes: Vec<_> = format.sizes.iter().map(size).collect();
        format!("{} {}", format.format, sizes.join(", "))
    };
    let words: Vec<_> = offer.iter().map(format).collect();
    if words.is_empty() { "nothing".to_owned() } else { words.join("; ") }
}

/// Whether the driver, which never refuses but takes the nearest it has, took what was asked for.
///
/// # Errors
/// What it took instead, in words.
pub fn check_taken(asked: &CameraSettings, taken: &DriverFormat, rate_hz: Option<f64>) -> Result<(), String> {
    let same = taken.code == code(asked.format) && (taken.width, taken.height) == (asked.width, asked.height);
    if !same {
        return Err(format!("{} {}x{}", code_text(taken.code), taken.width, taken.height));
    }
    match rate_hz {
        Some(rate) if (rate - asked.rate_hz).abs() > RATE_SHARE * asked.rate_hz => {
            Err(format!("{:.3} frames a second", rate))
        }
        _ => Ok(()),
    }
}

/// How the camera encodes colour: what `cell.toml` says, else what the driver says, else BT.601 in limited range
/// (V4L2's own defaults for its colour spaces).
pub fn encoding(asked: &CameraSettings, taken: &DriverFormat) -> ColourEncoding {
    const COLORSPACE_REC709: u32 = 3;
    const COLORSPACE_JPEG: u32 = 7;
    let matrix = match (taken.ycbcr_encoding, taken.colorspace) {
        (2 | 4, _) | (0, COLORSPACE_REC709) => YcbcrMatrix::Bt709,
        _ => YcbcrMatrix::Bt601,
    };
    let range = match (taken.quantization, taken.colorspace) {
        (1, _) | (0, COLORSPACE_JPEG) => QuantizationRange::Full,
        _ => QuantizationRange::Limited,
    };
    ColourEncoding { matrix: asked.matrix.unwrap_or(matrix), range: asked.range.unwrap_or(range) }
}

/// How the rows of a picture lie in a buffer: bytes of a row, rows, and bytes from row to row. `None` for MJPEG.
pub fn rows(format: PixelFormat, width: usize, height: usize, bytes_per_line: usize) -> Option<Rows> {
    let (row_bytes, rows) = match format {
        PixelFormat::Rgb | PixelFormat::Bgr => (3 * width, height),
        PixelFormat::Grey => (width, height),
        PixelFormat::Yuyv => (2 * width, height),
        PixelFormat::Nv12 => (width, height + height / 2),
        PixelFormat::Mjpeg => return None,
    };
    Some(Rows { row_bytes, rows, stride_bytes: bytes_per_line.max(row_bytes) })
}

/// See [`rows`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rows {
    /// Bytes of a row that are picture.
    pub row_bytes: usize,
    /// Rows, those of the colour plane of NV12 included.
    pub rows: usize,
    /// Bytes from the beginning of a row to that of the next.
    pub stride_bytes: usize,
}

impl Rows {
    /// Bytes that a whole picture has at least; the padding of the last row may be missing.
    pub fn bytes_needed(&self) -> usize {
        (self.rows - 1) * self.stride_bytes + self.row_bytes
    }

    /// Copies the rows without their padding, once. `bytes` has at least [`Rows::bytes_needed`].
    pub fn copy(&self, bytes: &[u8], into: &mut Vec<u8>) {
        into.clear();
        if self.stride_bytes == self.row_bytes {
            into.extend_from_slice(&bytes[..self.bytes_needed()]);
            return;
        }
        for row in bytes.chunks(self.stride_bytes).take(self.rows) {
            into.extend_from_slice(&row[..self.row_bytes]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::v4l::tests::settings;

    fn asked() -> CameraSettings {
        settings("/dev/cam0")
    }

    fn taken() -> DriverFormat {
        DriverFormat {
            code: *b"YUYV",
            width: 640,
            height: 480,
            bytes_per_line: 1280,
            ..DriverFormat::default()
        }
    }

    #[test]
    fn only_what_was_asked_for_is_taken() {
        assert_eq!(check_taken(&asked(), &taken(), Some(30.0)), Ok(()));
        assert_eq!(check_taken(&asked(), &taken(), Some(1e7 / 333_333.0)), Ok(()));
        assert_eq!(check_taken(&asked(), &taken(), None), Ok(()));
        assert_eq!(check_taken(&asked(), &taken(), Some(15.0)), Err("15.000 frames a second".to_owned()));
        let smaller = DriverFormat { width: 320, height: 240, ..taken() };
        assert_eq!(check_taken(&asked(), &smaller, Some(30.0)), Err("YUYV 320x240".to_owned()));
        let other = DriverFormat { code: *b"Y16\xa0", ..taken() };
        assert_eq!(check_taken(&asked(), &other, Some(30.0)), Err("Y16-BE 640x480".to_owned()));
    }

    #[test]
    fn the_offer_is_told_in_words() {
        let size = |size: &str, rates: &[f64], rates_are_range| OfferedSize {
            size: size.to_owned(),
            rates_hz: rates.to_vec(),
            rates_are_range,
        };
        let offer = [
            OfferedFormat {
                format: "YUYV".to_owned(),
                sizes: vec![size("640x480", &[30.0, 15.0], false), size("320x240", &[1.0, 60.0], true)],
            },
            OfferedFormat { format: "MJPG".to_owned(), sizes: vec![size("640x480", &[], false)] },
        ];
        assert_eq!(in_words(&offer), "YUYV 640x480 at 30, 15, 320x240 at 1 to 60; MJPG 640x480");
        assert_eq!(in_words(&[]), "nothing");
    }

    #[test]
    fn colours_are_what_cell_toml_says_else_the_driver_else_bt601_limited() {
        let of = |asked: &CameraSettings, ycbcr_encoding, quantization, colorspace| {
            encoding(asked, &DriverFormat { ycbcr_encoding, quantization, colorspace, ..taken() })
        };
        assert_eq!(of(&asked(), 0, 0, 0), ColourEncoding::default());
        let full709 = ColourEncoding { matrix: YcbcrMatrix::Bt709, range: QuantizationRange::Full };
        assert_eq!(of(&asked(), 2, 1, 8), full709);
        assert_eq!(of(&asked(), 0, 0, 7).range, QuantizationRange::Full);
        assert_eq!(of(&asked(), 0, 0, 3).matrix, YcbcrMatrix::Bt709);
        let own = CameraSettings { matrix: Some(YcbcrMatrix::Bt601), ..asked() };
        assert_eq!(of(&own, 2, 0, 8).matrix, YcbcrMatrix::Bt601);
    }

    #[test]
    fn rows_lose_their_padding_in_the_one_copy() {
        let rows = rows(PixelFormat::Grey, 2, 3, 4).expect("not compressed");
        assert_eq!(rows.bytes_needed(), 10);
        let mut into = vec![9; 20];
        rows.copy(&[1, 2, 0, 0, 3, 4, 0, 0, 5, 6], &mut into);
        assert_eq!(into, [1, 2, 3, 4, 5, 6]);
        let nv12 = super::rows(PixelFormat::Nv12, 4, 2, 0).expect("not compressed");
        nv12.copy(&[1, 1, 1, 1, 2, 2, 2, 2, 5, 6, 5, 6, 0, 0], &mut into);
        assert_eq!(into, [1, 1, 1, 1, 2, 2, 2, 2, 5, 6, 5, 6]);
    }
}
