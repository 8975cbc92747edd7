//! A binary picture, 64 pixels a word.
//!
//! The picture is cut into vertical strips of 64 pixels. A strip is a run of words, one a row, with
//! [`PAD_ROWS`] rows of zeros above and below, so that eight rows of a strip are one 512-bit load and the rows
//! above and below them are the same load moved by one word.

use nalgebra::Vector2;

/// Rows of zeros above and below the picture in every strip.
pub const PAD_ROWS: usize = 8;

/// A binary picture; object = 1. Pixel `x` of a row is bit `x % 64` of the word of strip `x / 64`. Bits beyond
/// the width and the padding rows are always 0.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct BitImage {
    width: usize,
    height: usize,
    /// Words a strip, padding included.
    stride: usize,
    words: Vec<u64>,
}

impl BitImage {
    /// An empty picture of this size in pixels.
    pub fn new(width: usize, height: usize) -> Self {
        // A multiple of 8 plus the padding.
        let stride = height.next_multiple_of(8) + 2 * PAD_ROWS;
        Self { width, height, stride, words: vec![0; width.div_ceil(64) * stride] }
    }

    /// Width in pixels.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Height in pixels.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Number of strips.
    pub fn strips(&self) -> usize {
        self.width.div_ceil(64)
    }

    /// Words from one strip to the next; row `y` of strip `s` is `words()[s * strip_stride() + PAD_ROWS + y]`.
    pub fn strip_stride(&self) -> usize {
        self.stride
    }

    /// All words, padding included.
    pub fn words(&self) -> &[u64] {
        &self.words
    }

    /// All words, padding included. The caller keeps padding and bits beyond the width at 0.
    pub fn words_mut(&mut self) -> &mut [u64] {
        &mut self.words
    }

    /// The rows of strip `s`, without padding.
    ///
    /// # Panics
    /// Where there is no strip `s`.
    pub fn strip(&self, s: usize) -> &[u64] {
        let begin = s * self.strip_stride() + PAD_ROWS;
        &self.words[begin..begin + self.height]
    }

    /// The rows of strip `s`, without padding.
    ///
    /// # Panics
    /// Where there is no strip `s`.
    pub fn strip_mut(&mut self, s: usize) -> &mut [u64] {
        let begin = s * self.strip_stride() + PAD_ROWS;
        &mut self.words[begin..begin + self.height]
    }

    /// The bits that exist in a word of strip `s`.
    ///
    /// # Panics
    /// Where there is no strip `s`.
    pub fn strip_mask(&self, s: usize) -> u64 {
        assert!(s < self.strips(), "strip {s} of {}", self.strips());
        let bits = (self.width - s * 64).min(64);
        if bits == 64 { u64::MAX } else { (1 << bits) - 1 }
    }

    /// The pixel; 0 outside the picture.
    #[inline]
    pub fn get(&self, x: i32, y: i32) -> bool {
        // What is negative is very large without its sign.
        let (x, y) = (x as u32 as usize, y as u32 as usize);
        x < self.width
            && y < self.height
            && self.words[(x / 64) * self.stride + PAD_ROWS + y] >> (x % 64) & 1 == 1
    }

    /// Sets the pixel.
    ///
    /// # Panics
    /// Outside the picture.
    #[inline]
    pub fn set(&mut self, x: usize, y: usize, object: bool) {
        assert!(
            x < self.width && y < self.height,
            "pixel ({x}, {y}) of a {}x{} picture",
            self.width,
            self.height
        );
        let stride = self.strip_stride();
        let word = &mut self.words[(x / 64) * stride + PAD_ROWS + y];
        *word = *word & !(1 << (x % 64)) | (object as u64) << (x % 64);
    }

    /// Number of object pixels.
    pub fn count(&self) -> usize {
        self.words.iter().map(|w| w.count_ones() as usize).sum()
    }

    /// All pixels to background.
    pub fn clear(&mut self) {
        self.words.fill(0);
    }

    /// Takes over another picture of the same size without allocating.
    ///
    /// # Panics
    /// Where the sizes differ.
    pub fn copy_from(&mut self, other: &BitImage) {
        assert_eq!((self.width, self.height), (other.width, other.height), "sizes of two bit images");
        self.words.copy_from_slice(&other.words);
    }

    /// A picture drawn in text: `#` is object, anything else background, a line a row.
    ///
    /// ```
    /// let p = pickcell::vision::bits::BitImage::from_text("#..\n.##");
    /// assert_eq!((p.width(), p.height(), p.count()), (3, 2, 3));
    /// assert_eq!(p.to_text(), "#..\n.##\n");
    /// ```
    pub fn from_text(text: &str) -> Self {
        let rows: Vec<&str> = text.lines().map(str::trim).filter(|l| !l.is_empty()).collect();
        let mut image = Self::new(rows.iter().map(|r| r.len()).max().unwrap_or(0), rows.len());
        for (y, row) in rows.iter().enumerate() {
            for (x, c) in row.bytes().enumerate() {
                image.set(x, y, c == b'#');
            }
        }
        image
    }

    /// The reverse of [`BitImage::from_text`], with `.` for background.
    pub fn to_text(&self) -> String {
        let mut text = String::with_capacity((self.width + 1) * self.height);
        for y in 0..self.height {
            text.extend((0..self.width).map(|x| if self.get(x as i32, y as i32) { '#' } else { '.' }));
            text.push('\n');
        }
        text
    }

    /// The picture as one byte a pixel, 255 for object.
    pub fn to_grey(&self) -> Vec<u8> {
        let mut grey = Vec::with_capacity(self.width * self.height);
        for y in 0..self.height as i32 {
            grey.extend((0..self.width as i32).map(|x| if self.get(x, y) { 255u8 } else { 0 }));
        }
        grey
    }

    /// A picture from one byte a pixel, object where it is 128 or more.
    ///
    /// # Panics
    /// Where `grey` is not `width * height` long.
    pub fn from_grey(width: usize, height: usize, grey: &[u8]) -> Self {
        assert_eq!(grey.len(), width * height, "grey bytes of a {width}x{height} picture");
        let mut image = Self::new(width, height);
        for (i, &v) in grey.iter().enumerate() {
            if v >= 128 {
                image.set(i % width, i / width, true);
            }
        }
        image
    }
}

/// The nearest pixel; of what is no number, or millions of pixels away, one outside of any picture. `f64::round` is a function call on processors without SSE 4.1, which the program may run on.
#[inline]
pub fn nearest(px: f64) -> i32 {
    const ABOVE_ZERO: i32 = 1 << 20;
    ((px + (f64::from(ABOVE_ZERO) + 0.5)) as i32).wrapping_sub(ABOVE_ZERO)
}

/// A place in a picture, in pixels.
pub(crate) fn vector<T: Copy + Into<f64>>(p: [T; 2]) -> Vector2<f64> {
    Vector2::new(p[0].into(), p[1].into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_across_strips_keep_their_places() {
        let mut p = BitImage::new(130, 9);
        for &(x, y) in &[(0, 0), (63, 3), (64, 3), (129, 8)] {
            p.set(x, y, true);
            assert!(p.get(x as i32, y as i32));
        }
        assert_eq!(p.count(), 4);
        assert!(!p.get(-1, 0) && !p.get(130, 0) && !p.get(0, 9));
        assert_eq!(BitImage::from_grey(130, 9, &p.to_grey()), p);
        assert_eq!(p.strip_mask(2), 3);
    }
}
