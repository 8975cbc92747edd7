//! An RGB picture to draw on. Coordinates are pixels, pixel centres at whole numbers; what is outside is left out.

use std::io::{self, Cursor};
use std::path::Path;

use image::{ImageFormat, RgbImage};
use nalgebra::Vector2;

use super::font;
use crate::frame::Frame;
use crate::vision::bits::BitImage;

/// R, G, B.
pub type Colour = [u8; 3];

/// An RGB picture to draw on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Canvas {
    width: usize,
    height: usize,
    bytes: Vec<u8>,
}

impl Canvas {
    /// A black one.
    pub fn new(width: usize, height: usize) -> Self {
        Self { width, height, bytes: vec![0; 3 * width * height] }
    }

    /// Width in pixels.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Height in pixels.
    pub fn height(&self) -> usize {
        self.height
    }

    /// The colour of a pixel inside.
    ///
    /// # Panics
    /// Outside the picture.
    pub fn pixel(&self, x: usize, y: usize) -> Colour {
        let at = 3 * (y * self.width + x);
        [self.bytes[at], self.bytes[at + 1], self.bytes[at + 2]]
    }

    /// Mixes a colour into a pixel; `share` from 0 (nothing) to 1 (all of it).
    pub fn blend(&mut self, x: i64, y: i64, colour: Colour, share: f64) {
        if x < 0 || y < 0 || x >= self.width as i64 || y >= self.height as i64 {
            return;
        }
        let at = 3 * (y as usize * self.width + x as usize);
        for (old, new) in self.bytes[at..at + 3].iter_mut().zip(colour) {
            *old = (f64::from(*old) * (1.0 - share) + f64::from(new) * share).round() as u8;
        }
    }

    /// Copies a raw frame with its upper left corner at (`left`, 0).
    pub fn put_frame(&mut self, frame: &Frame, left: usize) {
        for y in 0..frame.height {
            for x in 0..frame.width {
                self.blend((left + x) as i64, y as i64, frame.rgb(x, y), 1.0);
            }
        }
    }

    /// Mixes a colour into the object pixels of a bit image whose upper left corner is at (`left`, 0).
    pub fn put_bits(&mut self, bits: &BitImage, left: usize, colour: Colour, share: f64) {
        for y in 0..bits.height() {
            for x in (0..bits.width()).filter(|&x| bits.get(x as i32, y as i32)) {
                self.blend((left + x) as i64, y as i64, colour, share);
            }
        }
    }

    /// A smooth line of `width` pixels.
    pub fn line(&mut self, from: Vector2<f64>, to: Vector2<f64>, width: f64, colour: Colour) {
        let along = to - from;
        let length2 = along.norm_squared().max(1e-12);
        let distance = |p: Vector2<f64>| {
            let s = ((p - from).dot(&along) / length2).clamp(0.0, 1.0);
            (p - from - along * s).norm()
        };
        let reach = 0.5 * width + 1.0;
        let low = from.inf(&to).add_scalar(-reach);
        let high = from.sup(&to).add_scalar(reach);
        self.shade(low, high, colour, |p| 0.5 * width + 0.5 - distance(p));
    }

    /// A smooth circle of `width` pixels.
    pub fn ring(&mut self, centre: Vector2<f64>, radius: f64, width: f64, colour: Colour) {
        let reach = Vector2::repeat(radius + 0.5 * width + 1.0);
        let off = |p: Vector2<f64>| ((p - centre).norm() - radius).abs();
        self.shade(centre - reach, centre + reach, colour, |p| 0.5 * width + 0.5 - off(p));
    }

    /// A smooth disc.
    pub fn disc(&mut self, centre: Vector2<f64>, radius: f64, colour: Colour) {
        let reach = Vector2::repeat(radius + 1.0);
        self.shade(centre - reach, centre + reach, colour, |p| radius + 0.5 - (p - centre).norm());
    }

    /// Mixes `colour` into the pixels of a box, by `share` of their place, cut to 0..1.
    fn shade(
        &mut self,
        low: Vector2<f64>,
        high: Vector2<f64>,
        colour: Colour,
        share: impl Fn(Vector2<f64>) -> f64,
    ) {
        if !low.iter().chain(high.iter()).all(|v| v.is_finite()) {
            return;
        }
        let (right, bottom) = (self.width as f64 - 1.0, self.height as f64 - 1.0);
        let columns = low.x.max(0.0).ceil() as i64..=high.x.min(right).floor() as i64;
        for y in low.y.max(0.0).ceil() as i64..=high.y.min(bottom).floor() as i64 {
            for x in columns.clone() {
                let share = share(Vector2::new(x as f64, y as f64)).clamp(0.0, 1.0);
                if share > 0.0 {
                    self.blend(x, y, colour, share);
                }
            }
        }
    }

    /// Text with its upper left corner at `at`, letters of 5x8 dots `scale` pixels wide, with a dark rim that keeps
    /// it readable on any ground. It is moved so far that it stays inside.
    pub fn text(&mut self, at: Vector2<f64>, text: &str, scale: usize, colour: Colour) {
        let scale = scale.max(1) as i64;
        let advance = (font::COLUMNS as i64 + 1) * scale;
        let width = advance * text.chars().count() as i64;
        let inside = |v: f64, size: usize, need: i64| (v.round() as i64).min(size as i64 - need - 1).max(1);
        let left = inside(at.x, self.width, width);
        let top = inside(at.y, self.height, font::ROWS as i64 * scale);
        for (rim, colour) in [(1, [0, 0, 0]), (0, colour)] {
            for (i, letter) in text.chars().enumerate() {
                let left = left + advance * i as i64;
                self.letter(left, top, letter, scale, rim, colour);
            }
        }
    }

    /// Width and height of a text, its rim included.
    pub fn text_size(text: &str, scale: usize) -> Vector2<f64> {
        let columns = (font::COLUMNS + 1) * text.chars().count();
        Vector2::new((columns * scale + 1) as f64, (font::ROWS * scale + 2) as f64)
    }

    fn letter(&mut self, left: i64, top: i64, letter: char, scale: i64, rim: i64, colour: Colour) {
        let share = if rim > 0 { 0.7 } else { 1.0 };
        for (column, dots) in font::glyph(letter).into_iter().enumerate() {
            for row in (0..font::ROWS).filter(|row| dots >> row & 1 == 1) {
                let (x, y) = (left + column as i64 * scale, top + row as i64 * scale);
                for dy in -rim..scale + rim {
                    for dx in -rim..scale + rim {
                        self.blend(x + dx, y + dy, colour, share);
                    }
                }
            }
        }
    }

    /// The picture as PNG.
    ///
    /// # Errors
    /// Where the encoder fails, which for a picture with pixels it does not.
    pub fn to_png(&self) -> io::Result<Vec<u8>> {
        let mut png = Vec::new();
        let picture = RgbImage::from_raw(self.width as u32, self.height as u32, self.bytes.clone());
        let picture = picture.ok_or_else(|| io::Error::other("the picture is too large for a PNG file"))?;
        picture.write_to(&mut Cursor::new(&mut png), ImageFormat::Png).map_err(io::Error::other)?;
        Ok(png)
    }

    /// Writes a PNG file, whole or not at all.
    ///
    /// # Errors
    /// What the disk says.
    pub fn write_png(&self, path: &Path) -> io::Result<()> {
        crate::files::write_atomically(path, &self.to_png()?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_covers_its_pixels_and_stays_inside() {
        let mut canvas = Canvas::new(9, 5);
        canvas.line(Vector2::new(-50.0, 2.0), Vector2::new(6.0, 2.0), 1.0, [200, 100, 50]);
        for x in 0..9 {
            let wanted = if x <= 6 { [200, 100, 50] } else { [0, 0, 0] };
            assert_eq!(canvas.pixel(x, 2), wanted, "{x}");
            assert_eq!(canvas.pixel(x, 0), [0, 0, 0]);
        }
        canvas.line(Vector2::new(f64::NAN, 2.0), Vector2::new(1e300, 2.0), 1.0, [1, 1, 1]);
        canvas.disc(Vector2::new(1e12, -1e12), 3.0, [1, 1, 1]);
        canvas.ring(Vector2::new(4.0, 2.0), 2.0, 1.5, [9, 9, 9]);
        assert_eq!((canvas.pixel(4, 0), canvas.pixel(4, 2)), ([9, 9, 9], [200, 100, 50]));
    }

    #[test]
    fn text_is_drawn_in_its_colour_and_moved_inside() {
        let mut canvas = Canvas::new(20, 12);
        canvas.text(Vector2::new(500.0, -500.0), "1", 1, [255, 0, 0]);
        let red: Vec<_> = (0..240).filter(|i| canvas.pixel(i % 20, i / 20) == [255, 0, 0]).collect();
        // the dots of 42 7f 40
        assert_eq!(red.len(), 2 + 7 + 1);
        assert!(red.iter().all(|i| i % 20 >= 13));
    }

    #[test]
    fn a_png_reads_back() {
        let mut canvas = Canvas::new(3, 2);
        canvas.blend(2, 1, [10, 20, 30], 1.0);
        let back = image::load_from_memory(&canvas.to_png().unwrap()).unwrap().into_rgb8();
        assert_eq!((back.width(), back.height(), back.get_pixel(2, 1).0), (3, 2, [10, 20, 30]));
    }
}
