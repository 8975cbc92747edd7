//! Which part of a picture is looked at.

use crate::vision::bits::BitImage;

/// The part of a picture that is looked at, a bit a pixel.
#[derive(Clone, Debug)]
pub struct Area {
    bits: BitImage,
}

impl Area {
    /// Nothing of a picture of this size.
    pub fn new(width: usize, height: usize) -> Self {
        Self { bits: BitImage::new(width, height) }
    }

    /// Nothing.
    pub fn clear(&mut self) {
        self.bits.words_mut().fill(0);
    }

    /// Adds the square within `margin_px` of a pixel.
    pub fn include(&mut self, x: usize, y: usize, margin_px: usize) {
        let (width, height) = (self.bits.width(), self.bits.height());
        if width == 0 || height == 0 {
            return;
        }
        let (from, to) = (x.saturating_sub(margin_px), (x + margin_px).min(width - 1));
        let rows = y.saturating_sub(margin_px)..(y + margin_px + 1).min(height);
        for strip in from / 64..=to / 64 {
            let (first, last) = (from.max(64 * strip) % 64, to.min(64 * strip + 63) % 64);
            let columns = (u64::MAX << first) & (u64::MAX >> (63 - last));
            for word in self.bits.strip_mut(strip).iter_mut().take(rows.end).skip(rows.start) {
                *word |= columns;
            }
        }
    }

    /// The pixels of a row of a strip of 64.
    pub(super) fn row(&self, strip: usize, y: usize) -> u64 {
        self.bits.strip(strip)[y]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_square_is_kept_to_the_picture() {
        let mut area = Area::new(100, 50);
        area.include(62, 10, 3);
        area.include(99, 49, 2);
        area.include(300, 300, 2);
        let has = |x: usize, y: usize| area.row(x / 64, y) >> (x % 64) & 1 == 1;
        let expected =
            |x: usize, y: usize| ((59..=65).contains(&x) && (7..=13).contains(&y)) || (x >= 97 && y >= 47);
        assert!((0..100).all(|x| (0..50).all(|y| has(x, y) == expected(x, y))));
        area.clear();
        assert_eq!(area.row(0, 10), 0);
    }
}
