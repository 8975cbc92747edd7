//! Dropping small objects.

use crate::vision::bits::BitImage;

/// Memory for following an object.
#[derive(Clone, Debug)]
pub(super) struct Specks {
    seen: BitImage,
    stack: Vec<(u16, u16)>,
}

impl Specks {
    pub(super) fn new(width: usize, height: usize) -> Self {
        Self { seen: BitImage::new(width, height), stack: Vec::with_capacity(width * height) }
    }

    /// Drops 8-connected objects of fewer than `least` pixels.
    pub(super) fn drop_smaller(&mut self, bits: &mut BitImage, least: u32) {
        if least < 2 {
            return;
        }
        self.seen.clear();
        for y in 0..bits.height() {
            for x in 0..bits.width() {
                if bits.get(x as i32, y as i32) && !self.seen.get(x as i32, y as i32) {
                    self.follow(bits, x, y, least);
                }
            }
        }
    }

    fn follow(&mut self, bits: &mut BitImage, x: usize, y: usize, least: u32) {
        self.stack.clear();
        self.stack.push((x as u16, y as u16));
        self.seen.set(x, y, true);
        let mut next = 0;
        while next < self.stack.len() {
            let (x, y) = self.stack[next];
            next += 1;
            for (dx, dy) in [(-1, -1), (0, -1), (1, -1), (-1, 0), (1, 0), (-1, 1), (0, 1), (1, 1)] {
                let (nx, ny) = (i32::from(x) + dx, i32::from(y) + dy);
                if bits.get(nx, ny) && !self.seen.get(nx, ny) {
                    self.seen.set(nx as usize, ny as usize, true);
                    self.stack.push((nx as u16, ny as u16));
                }
            }
        }
        if self.stack.len() < least as usize {
            for &(x, y) in &self.stack {
                bits.set(usize::from(x), usize::from(y), false);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn objects_below_the_size_are_dropped_and_corners_connect() {
        let mut p = BitImage::from_text("#...##\n.#....\n..#..#\n");
        Specks::new(6, 3).drop_smaller(&mut p, 3);
        assert_eq!(p.to_text(), "#.....\n.#....\n..#...\n");
    }
}
