//! The work plane of the thinning, and which of its tiles can still change.
//!
//! A tile is eight rows of a strip, 64 x 8 pixels. A sub-iteration first finds the deletions of all active tiles and
//! lists them, then carries them out: so that all of it reads the state before. A tile is active where it or a pixel
//! that touches it changed in one of the last two sub-iterations: otherwise the same sub-iteration found nothing
//! there the last time.

use super::Algorithm;
use super::delete::deletes;
use crate::level::Level;
use crate::vision::bits::{BitImage, PAD_ROWS};
use crate::vision::lanes::Lanes;
#[cfg(target_arch = "x86_64")]
use crate::vision::lanes::{Rows4, Rows8};

const TILE_ROWS: usize = 8;

/// The words of a tile in one cache line.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(64))]
struct Line([u64; TILE_ROWS]);

/// Deletions found in one tile.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C)]
struct Deletions {
    rows: Line,
    strip: u32,
    tile: u32,
}

/// Work plane and lists of one picture size.
#[derive(Clone, Debug)]
pub(super) struct Tiles {
    width: usize,
    height: usize,
    strips: usize,
    /// Tiles from one strip of the plane to the next: the picture's, and one of padding above and below.
    stride: usize,
    /// The picture with an empty strip on either side.
    plane: Vec<Line>,
    found: Vec<Deletions>,
    active: Active,
}

/// Sets of tiles. A strip has `words` words; bit `tile + 1`, so that the tile above has a bit as well. There is a
/// strip more on either side.
#[derive(Clone, Debug)]
struct Active {
    words: usize,
    /// Tiles with pixels at the start.
    filled: Vec<u64>,
    /// Tiles that the sub-iteration before changed or touched.
    last: Vec<u64>,
    /// The same of the one before that.
    last_but_one: Vec<u64>,
}

impl Tiles {
    pub(super) fn new(width: usize, height: usize) -> Self {
        let (strips, tiles) = (width.div_ceil(64), height.div_ceil(TILE_ROWS));
        let stride = tiles + 2 * PAD_ROWS / TILE_ROWS;
        // One word more than the bits need: a tile's bit is set together with the one below.
        let words = (tiles + 2).div_ceil(64) + 1;
        let set = vec![0; (strips + 2) * words];
        Self {
            width,
            height,
            strips,
            stride,
            plane: vec![Line::default(); (strips + 2) * stride],
            // One more than there can be: every active tile writes its entry, kept or not.
            found: vec![Deletions::default(); strips * tiles + 1],
            active: Active { words, filled: set.clone(), last: set.clone(), last_but_one: set },
        }
    }

    /// Takes the picture over.
    pub(super) fn read(&mut self, mask: &BitImage) {
        assert_eq!((mask.width(), mask.height()), (self.width, self.height), "size of the mask");
        let active = &mut self.active;
        active.filled.fill(0);
        let strips = mask.words().chunks_exact(self.stride * TILE_ROWS);
        for (s, strip) in strips.enumerate() {
            let lines = &mut self.plane[(s + 1) * self.stride..(s + 2) * self.stride];
            let filled = &mut active.filled[(s + 1) * active.words..(s + 2) * active.words];
            // Padding is copied too.
            for (tile, (line, words)) in lines.iter_mut().zip(strip.as_chunks::<TILE_ROWS>().0).enumerate() {
                line.0 = *words;
                let any = words.iter().fold(0, |any, &w| any | w) != 0;
                filled[tile / 64] |= (any as u64) << (tile % 64);
            }
            // It is empty; and should it not be, nothing is looked at beyond it.
            for tile in [0, self.stride - 1] {
                filled[tile / 64] &= !(1 << (tile % 64));
            }
        }
        active.last.copy_from_slice(&active.filled);
        active.last_but_one.copy_from_slice(&active.filled);
    }

    /// Hands the result over.
    pub(super) fn write(&self, skeleton: &mut BitImage) {
        assert_eq!((skeleton.width(), skeleton.height()), (self.width, self.height), "size of the skeleton");
        let strips = skeleton.words_mut().chunks_exact_mut(self.stride * TILE_ROWS);
        for (strip, lines) in strips.zip(self.plane[self.stride..].chunks_exact(self.stride)) {
            for (words, line) in strip.as_chunks_mut::<TILE_ROWS>().0.iter_mut().zip(lines) {
                *words = line.0;
            }
        }
    }

    /// One sub-iteration; whether anything changed.
    pub(super) fn subiterate(&mut self, level: Level, algorithm: Algorithm, subiteration: usize) -> bool {
        // SAFETY: `Thin::with_level` lets only levels through that the machine has.
        let found = unsafe {
            match level {
                #[cfg(target_arch = "x86_64")]
                Level::Avx512 => self.pass_avx512(algorithm, subiteration),
                #[cfg(target_arch = "x86_64")]
                Level::Avx2 => self.pass_avx2(algorithm, subiteration),
                _ => self.pass::<u64>(algorithm, subiteration),
            }
        };
        found > 0
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx512vbmi2,bmi1,bmi2,lzcnt,popcnt")]
    fn pass_avx512(&mut self, algorithm: Algorithm, subiteration: usize) -> usize {
        // SAFETY: the function has the instructions of `Rows8`.
        unsafe { self.pass::<Rows8>(algorithm, subiteration) }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,bmi1")]
    fn pass_avx2(&mut self, algorithm: Algorithm, subiteration: usize) -> usize {
        // SAFETY: the function has the instructions of `Rows4`.
        unsafe { self.pass::<Rows4>(algorithm, subiteration) }
    }

    /// Finds and carries out the deletions of a sub-iteration; the number of changed tiles.
    ///
    /// # Safety
    /// The machine has the instructions of `L`.
    #[inline(always)]
    unsafe fn pass<L: Lanes>(&mut self, algorithm: Algorithm, subiteration: usize) -> usize {
        // SAFETY: the caller's promise.
        unsafe {
            let found = match (algorithm, subiteration) {
                (Algorithm::ZhangSuen, 0) => self.find::<L>(Algorithm::ZhangSuen, 0),
                (Algorithm::ZhangSuen, _) => self.find::<L>(Algorithm::ZhangSuen, 1),
                (Algorithm::GuoHall, 0) => self.find::<L>(Algorithm::GuoHall, 0),
                (Algorithm::GuoHall, _) => self.find::<L>(Algorithm::GuoHall, 1),
            };
            self.carry_out::<L>(found);
            found
        }
    }

    /// Lists the deletions in `found`; their number.
    ///
    /// # Safety
    /// The machine has the instructions of `L`.
    #[inline(always)]
    unsafe fn find<L: Lanes>(&mut self, algorithm: Algorithm, subiteration: usize) -> usize {
        let (words, stride) = (self.active.words, self.stride * TILE_ROWS);
        let keep = self.kept_rows();
        let last_tile = self.height.div_ceil(TILE_ROWS);
        let plane: *const u64 = self.plane.as_ptr().cast();
        let mut count = 0;
        for s in 1..=self.strips {
            let columns = self.inner_columns(s - 1);
            for w in 0..words {
                let i = s * words + w;
                let mut set = (self.active.last[i] | self.active.last_but_one[i]) & self.active.filled[i];
                while set != 0 {
                    let tile = w * 64 + set.trailing_zeros() as usize;
                    set &= set - 1;
                    let rows = &keep[(tile == 1) as usize + 2 * (tile == last_tile) as usize];
                    // One entry more than there are tiles, and `count` grows by at most one a tile.
                    let entry = &mut self.found[count];
                    let mut any = 0;
                    for r in (0..TILE_ROWS).step_by(L::ROWS) {
                        // SAFETY: `filled` has only tiles of the picture, that is strips 1 to `strips` of the plane
                        // and not their first or last tile: all eight neighbours of its words lie in the plane. The
                        // other pointers have eight words. The caller promises the instructions.
                        unsafe {
                            let at = plane.add(s * stride + tile * TILE_ROWS + r);
                            let ring = ring::<L>(at, stride);
                            let allowed = L::ternary::<{ 0xf0 & 0xcc & 0xaa }>(
                                L::load(at),
                                L::splat(columns),
                                L::load(rows.0.as_ptr().add(r)),
                            );
                            let delete = deletes(algorithm, subiteration, ring);
                            let delete = L::ternary::<{ 0xf0 & 0xcc }>(delete, allowed, allowed);
                            delete.store(entry.rows.0.as_mut_ptr().add(r));
                            any |= delete.rows_sharing(delete);
                        }
                    }
                    (entry.strip, entry.tile) = (s as u32, tile as u32);
                    count += (any != 0) as usize;
                }
            }
        }
        count
    }

    /// Deletes what `found` lists, and notes the tiles that were changed or touched.
    ///
    /// # Safety
    /// The machine has the instructions of `L`.
    #[inline(always)]
    unsafe fn carry_out<L: Lanes>(&mut self, found: usize) {
        let Active { words, last, last_but_one, .. } = &mut self.active;
        std::mem::swap(last, last_but_one);
        last.fill(0);
        for deletions in &self.found[..found] {
            let (strip, tile) = (deletions.strip as usize, deletions.tile as usize);
            let line = &mut self.plane[strip * self.stride + tile];
            // Bit i: something in row i is deleted; in its first, its last column.
            let (mut rows, mut first, mut end) = (0u8, 0u8, 0u8);
            for r in (0..TILE_ROWS).step_by(L::ROWS) {
                // SAFETY: both lines have eight words. The caller promises the instructions.
                unsafe {
                    let delete = L::load(deletions.rows.0.as_ptr().add(r));
                    let at = line.0.as_mut_ptr().add(r);
                    L::ternary::<{ 0xf0 & !0xcc }>(L::load(at), delete, delete).store(at);
                    rows |= delete.rows_sharing(delete) << r;
                    first |= delete.rows_sharing(L::splat(1)) << r;
                    end |= delete.rows_sharing(L::splat(1 << 63)) << r;
                }
            }
            let mut touch = |strip: usize, tiles: u128| {
                let (w, bit) = ((tile - 1) / 64, (tile - 1) % 64);
                let tiles = tiles << bit;
                last[strip * *words + w] |= tiles as u64;
                last[strip * *words + w + 1] |= (tiles >> 64) as u64;
            };
            // The tiles above, here and below, in three strips.
            let three = |rows: u8| ((rows & 1) | ((rows != 0) as u8) << 1 | rows >> 7 << 2) as u128;
            touch(strip, three(rows));
            touch(strip - 1, three(first));
            touch(strip + 1, three(end));
        }
    }

    /// Rows that may be deleted, for a tile in the middle, at the top, at the bottom, and both.
    fn kept_rows(&self) -> [Line; 4] {
        let (top, bottom) = (0, (self.height.max(1) - 1) % TILE_ROWS);
        std::array::from_fn(|kind| {
            let mut line = Line([u64::MAX; TILE_ROWS]);
            if kind & 1 != 0 {
                line.0[top] = 0;
            }
            if kind & 2 != 0 {
                line.0[bottom] = 0;
            }
            line
        })
    }

    /// Columns of strip `s` of the picture that may be deleted: not the picture's first and last.
    fn inner_columns(&self, s: usize) -> u64 {
        let first = if s == 0 { 1 } else { 0 };
        let last = if s == self.strips - 1 { 1 << ((self.width - 1) % 64) } else { 0 };
        !(first | last)
    }
}

/// The neighbours p2 to p9 of the words at `at`.
///
/// # Safety
/// `L::ROWS` words can be read at `at`, one before and after it, and the same one `stride` to either side.
#[inline(always)]
unsafe fn ring<L: Lanes>(at: *const u64, stride: usize) -> [L; 8] {
    // SAFETY: the caller's promise.
    unsafe {
        let row = |at: *const u64| (L::load(at.sub(stride)), L::load(at), L::load(at.add(stride)));
        let (north_west, north, north_east) = row(at.sub(1));
        let (west, here, east) = row(at);
        let (south_west, south, south_east) = row(at.add(1));
        [
            north,
            north.right_neighbours(north_east),
            here.right_neighbours(east),
            south.right_neighbours(south_east),
            south,
            south.left_neighbours(south_west),
            here.left_neighbours(west),
            north.left_neighbours(north_west),
        ]
    }
}
