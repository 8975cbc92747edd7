//! Which part of a picture is looked at.

/// Rows of a tile of [`Area`].
const TILE_ROWS: usize = 16;

/// The part of a picture that is looked at: tiles of 64 x 16 pixels.
#[derive(Clone, Debug)]
pub struct Area {
    /// For each 16 rows a bit a strip of 64 columns; the last bit is for all strips beyond it.
    tiles: Vec<u64>,
}

impl Area {
    /// Nothing of a picture of this height.
    pub fn new(height: usize) -> Self {
        Self { tiles: vec![0; height.div_ceil(TILE_ROWS)] }
    }

    /// Nothing.
    pub fn clear(&mut self) {
        self.tiles.fill(0);
    }

    /// Adds the tiles within `margin_px` of a pixel.
    pub fn include(&mut self, x: usize, y: usize, margin_px: usize) {
        let strip = |x: usize| (x / 64).min(63);
        let (from, to) = (strip(x.saturating_sub(margin_px)), strip(x + margin_px));
        let strips = (u64::MAX << from) & (u64::MAX >> (63 - to));
        let rows = y.saturating_sub(margin_px) / TILE_ROWS..=(y + margin_px) / TILE_ROWS;
        for tiles in self.tiles.iter_mut().skip(*rows.start()).take(rows.count()) {
            *tiles |= strips;
        }
    }

    pub(super) fn has(&self, strip: usize, y: usize) -> bool {
        self.tiles.get(y / TILE_ROWS).is_some_and(|tiles| tiles >> strip.min(63) & 1 == 1)
    }
}
