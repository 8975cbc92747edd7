//! Dropping small objects, at a cost that grows with the number of small and ragged things, not with the picture.
//!
//! Every object has a topmost run of pixels, with nothing above it. Such runs are found 64 pixels at a time; from
//! each the object is followed in a strip 64 pixels wide until it has enough pixels, which for a real one is after
//! a few rows. Only what stays small, or is wide for its size, is followed to its end.

use crate::vision::bits::{BitImage, PAD_ROWS};

/// Memory for following objects.
#[derive(Clone, Debug)]
pub(super) struct Specks {
    /// The object being followed within its strip, a word a row; 0 between objects.
    object: Vec<u64>,
    /// The object being followed without a strip.
    wide: Wide,
    /// So many objects are looked at in a picture at most, and so many were in the last one.
    objects_max: u32,
    looked_at: u32,
}

/// A strip of columns, whose left one may be outside the picture.
#[derive(Clone, Copy)]
struct Strip {
    left: i32,
}

/// What following an object in a strip showed.
enum Followed {
    /// It has enough pixels.
    Large,
    /// It is small and has these rows.
    Small(usize, usize),
    /// It is small so far but goes on beside the strip; it has these rows.
    Beyond(usize, usize),
}

impl Specks {
    pub(super) fn new(width: usize, height: usize, objects_max: u32) -> Self {
        Self { object: vec![0; height], wide: Wide::new(width, height), objects_max, looked_at: 0 }
    }

    /// Whether the last picture had more objects than are looked at: the rest of it still has its specks.
    pub(super) fn were_too_many(&self) -> bool {
        self.looked_at > self.objects_max
    }

    /// Drops 8-connected objects of fewer than `least` pixels.
    #[inline(always)]
    pub(super) fn drop_smaller(&mut self, bits: &mut BitImage, least: u32) {
        self.looked_at = 0;
        if least < 2 {
            return;
        }
        for s in 0..bits.strips() {
            for y in (0..bits.height()).step_by(ROWS) {
                let mut ends = top_ends(bits, s, y);
                if ends == [0; ROWS] {
                    continue;
                }
                for (y, ends) in (y..).zip(&mut ends) {
                    while *ends != 0 {
                        let x = s * 64 + ends.trailing_zeros() as usize;
                        *ends &= *ends - 1;
                        self.looked_at += 1;
                        if self.were_too_many() {
                            return;
                        }
                        self.examine(bits, x, y, least);
                    }
                }
            }
        }
    }

    /// Drops the object at a pixel if it is small.
    fn examine(&mut self, bits: &mut BitImage, x: usize, y: usize, least: u32) {
        if !bits.get(x as i32, y as i32) {
            return;
        }
        let strip = Strip { left: x as i32 - 32 };
        let (first, last) = match self.follow(bits, strip, y, least) {
            Followed::Large => return,
            Followed::Small(first, last) => {
                for row in first..=last {
                    strip.clear(bits, row, self.object[row]);
                }
                (first, last)
            }
            Followed::Beyond(first, last) => {
                self.wide.drop_if_smaller(bits, x, y, least);
                (first, last)
            }
        };
        self.object[first..=last].fill(0);
    }

    /// Follows the object whose pixel is at bit 32 of row `y`; leaves it in `self.object` unless it is large.
    fn follow(&mut self, bits: &BitImage, strip: Strip, y: usize, least: u32) -> Followed {
        let height = bits.height();
        let (mut first, mut last) = (y, y);
        self.object[y] = fill(1 << 32, strip.row(bits, y));
        let (mut pixels, mut edges) = (self.object[y].count_ones(), self.object[y]);
        loop {
            let before = pixels;
            // Down to the last row and beyond, then up again, until a round finds nothing new.
            let mut row = first;
            while row < height && (row <= last || self.object[row - 1] != 0) && pixels < least {
                self.grow(bits, strip, row, first, last, &mut pixels, &mut edges);
                last = last.max(row);
                row += 1;
            }
            let mut row = last;
            while pixels < least && (row > first || self.object[first] != 0) {
                self.grow(bits, strip, row, first, last, &mut pixels, &mut edges);
                first = first.min(row);
                if row == 0 {
                    break;
                }
                row -= 1;
            }
            if pixels >= least {
                self.object[first..=last].fill(0);
                return Followed::Large;
            }
            if pixels == before {
                break;
            }
        }
        // In the outermost columns it may go on beside them.
        if edges & (1 | 1 << 63) != 0 { Followed::Beyond(first, last) } else { Followed::Small(first, last) }
    }

    /// Takes into the object what of `row` touches the rows above and below.
    #[allow(clippy::too_many_arguments)]
    fn grow(
        &mut self,
        bits: &BitImage,
        strip: Strip,
        row: usize,
        first: usize,
        last: usize,
        pixels: &mut u32,
        edges: &mut u64,
    ) {
        let above = if row > first { self.object[row - 1] } else { 0 };
        let below = if row < last { self.object[row + 1] } else { 0 };
        let beside = above | below;
        let here = self.object[row];
        let seeds = here | beside | beside << 1 | beside >> 1;
        let object = fill(seeds, strip.row(bits, row));
        *pixels += object.count_ones() - here.count_ones();
        *edges |= object;
        self.object[row] = object;
    }
}

impl Strip {
    /// The 64 pixels of a row from the strip's left on.
    fn row(self, bits: &BitImage, y: usize) -> u64 {
        let word = |s: i32| if s < 0 || s as usize >= bits.strips() { 0 } else { bits.strip(s as usize)[y] };
        let (s, shift) = (self.left.div_euclid(64), self.left.rem_euclid(64));
        if shift == 0 { word(s) } else { word(s) >> shift | word(s + 1) << (64 - shift) }
    }

    /// Sets pixels of a row to background.
    fn clear(self, bits: &mut BitImage, y: usize, pixels: u64) {
        let (s, shift) = (self.left.div_euclid(64), self.left.rem_euclid(64));
        for (s, pixels) in
            [(s, pixels << shift), (s + 1, if shift == 0 { 0 } else { pixels >> (64 - shift) })]
        {
            if pixels != 0 {
                bits.strip_mut(s as usize)[y] &= !pixels;
            }
        }
    }
}

/// The runs of `row` that hold a seed.
fn fill(seeds: u64, row: u64) -> u64 {
    // A carry runs from a seed to the end of its run; the same in mirror writing finds the beginning.
    let to_end = |seeds: u64, row: u64| ((row.wrapping_add(seeds) ^ row) | seeds) & row;
    let seeds = to_end(seeds & row, row);
    to_end(seeds.reverse_bits(), row.reverse_bits()).reverse_bits()
}

/// Rows looked at together: a 512-bit register of words. The picture's padding is at least as high.
const ROWS: usize = 8;

/// The last pixels of the runs in eight words that touch nothing in the rows above. A run that comes from the word
/// before may be listed although it touches something there; following it puts that right.
#[inline(always)]
fn top_ends(bits: &BitImage, s: usize, y: usize) -> [u64; ROWS] {
    let rows = |s: usize, up: usize| -> [u64; ROWS] {
        let begin = s * bits.strip_stride() + PAD_ROWS + y - up;
        bits.words().get(begin..).and_then(|words| words.first_chunk()).copied().unwrap_or_default()
    };
    let (row, above) = (rows(s, 0), rows(s, 1));
    let left = if s == 0 { [0; ROWS] } else { rows(s - 1, 1) };
    let (right, next) =
        if s + 1 == bits.strips() { ([0; ROWS], [0; ROWS]) } else { (rows(s + 1, 1), rows(s + 1, 0)) };
    // A loop: the closure of `from_fn` would not be compiled for the instructions of who calls this.
    let mut ends = [0; ROWS];
    for i in 0..ROWS {
        let above = above[i] | above[i] << 1 | above[i] >> 1 | left[i] >> 63 | right[i] << 63;
        // A carry runs from what touches to the end of its run.
        let seeds = above & row[i];
        let touched = (row[i].wrapping_add(seeds) ^ row[i]) | seeds;
        ends[i] = row[i] & !(row[i] >> 1 | next[i] << 63) & !touched;
    }
    ends
}

/// Following an object a pixel at a time.
#[derive(Clone, Debug)]
struct Wide {
    seen: BitImage,
    found: Vec<(u16, u16)>,
}

impl Wide {
    fn new(width: usize, height: usize) -> Self {
        Self { seen: BitImage::new(width, height), found: Vec::with_capacity(width * height) }
    }

    fn drop_if_smaller(&mut self, bits: &mut BitImage, x: usize, y: usize, least: u32) {
        self.found.clear();
        self.found.push((x as u16, y as u16));
        self.seen.set(x, y, true);
        let mut next = 0;
        while next < self.found.len() && self.found.len() < least as usize {
            let (x, y) = self.found[next];
            next += 1;
            for (dx, dy) in [(-1, -1), (0, -1), (1, -1), (-1, 0), (1, 0), (-1, 1), (0, 1), (1, 1)] {
                let (nx, ny) = (i32::from(x) + dx, i32::from(y) + dy);
                if bits.get(nx, ny) && !self.seen.get(nx, ny) {
                    self.seen.set(nx as usize, ny as usize, true);
                    self.found.push((nx as u16, ny as u16));
                }
            }
        }
        let small = self.found.len() < least as usize;
        for &(x, y) in &self.found {
            let (x, y) = (usize::from(x), usize::from(y));
            self.seen.set(x, y, false);
            if small {
                bits.set(x, y, false);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Every object from every pixel.
    fn slow(bits: &BitImage, least: u32) -> BitImage {
        let mut left = bits.clone();
        let mut wide = Wide::new(bits.width(), bits.height());
        for y in 0..bits.height() {
            for x in 0..bits.width() {
                if left.get(x as i32, y as i32) {
                    wide.drop_if_smaller(&mut left, x, y, least);
                }
            }
        }
        left
    }

    #[test]
    fn objects_below_the_size_are_dropped_and_corners_connect() {
        let mut p = BitImage::from_text("#...##\n.#....\n..#..#\n");
        Specks::new(6, 3, u32::MAX).drop_smaller(&mut p, 3);
        assert_eq!(p.to_text(), "#.....\n.#....\n..#...\n");
    }

    #[test]
    fn cups_spirals_and_bars_across_words_are_followed_to_their_end() {
        let text = "\
#.....#.#######.###################################################################.......
#.....#.#.....#...........................................................................
#.....#.#.###.#.##########................................................................
#.....#.#.#.#.#...........................................................................
#######.#...#.#...........................................................................
........#####.#...........................................................................
";
        let picture = BitImage::from_text(text);
        for least in [2, 10, 11, 17, 18, 24, 30, 67, 68, 100] {
            let mut p = picture.clone();
            Specks::new(90, 6, u32::MAX).drop_smaller(&mut p, least);
            assert_eq!(p.to_text(), slow(&picture, least).to_text(), "{least}");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(60))]

        #[test]
        fn what_is_dropped_is_what_a_pixel_at_a_time_drops(
            width in 1usize..200, height in 1usize..40, seed: u64, density in 1u64..9, least in 0u32..90
        ) {
            let mut state = seed | 1;
            let mut picture = BitImage::new(width, height);
            for y in 0..height {
                for x in 0..width {
                    state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                    picture.set(x, y, (state >> 33) % 16 < density);
                }
            }
            let mut p = picture.clone();
            Specks::new(width, height, u32::MAX).drop_smaller(&mut p, least);
            prop_assert_eq!(p.to_text(), slow(&picture, least).to_text());
        }
    }
}
