//! Which wire of a picture is claimed, and in which directions it lies there: a wire that crosses takes nothing away.
//!
//! The picture is divided into cells of three pixels. Straight wire is claimed as one bar, row by row.
//!
//! ```
//! use nalgebra::Vector2;
//! use pickcell::matching::claims::ClaimMap;
//! use pickcell::pose::verify::{PieceSight, Sight};
//!
//! let piece = |x: f64, y: f64, across| PieceSight {
//!     sight: Sight::Clear,
//!     expected_px: Vector2::new(x, y),
//!     across,
//!     half_width_px: 3.5,
//!     seen_px: None,
//! };
//! // Level wire from x = 20 to 80.
//! let wire = [20.0, 27.0, 34.0, 41.0, 48.0, 55.0, 62.0, 69.0, 76.0].map(|x| piece(x, 50.0, Vector2::y()));
//! let mut claims = ClaimMap::new(100, 100);
//! claims.claim(&wire);
//!
//! assert!(claims.is_claimed(&piece(50.0, 51.0, Vector2::y())), "the same wire once more");
//! assert!(!claims.is_claimed(&piece(50.0, 51.0, Vector2::x())), "wire that crosses it");
//! assert!(!claims.is_claimed(&piece(50.0, 58.0, Vector2::y())), "wire beside it");
//! ```

use nalgebra::Vector2;

use crate::pose::verify::{PieceSight, Sight};
use crate::vision::bits::nearest;
use crate::vision::whole::{ceil, floor};

/// Side of a cell, in pixels.
const CELL: usize = 3;
pub(crate) const CELL_PX: f64 = CELL as f64;
/// Directions told apart in a cell, over half a turn.
const DIRECTIONS: i32 = 32;
/// Claims of directions nearer than this many steps are the same wire.
const SAME_DIRECTION: i32 = 3;
/// Share of the width of a wire that is claimed.
const CLAIMED_WIDTH: f64 = 0.8;
/// How far pieces of one bar may lie beside its axis, and how much their half widths may differ, in pixels; and the cosine
/// of the angle by which they may turn, half a step of [`DIRECTIONS`].
const STRAIGHT_PX: f64 = 0.5;
const STRAIGHT_COS: f64 = 0.998_8;
/// Pieces of one bar lie nearer to each other than this many half widths.
const NEXT_HALF_WIDTHS: f64 = 3.0;
/// Rows and columns of cells that are cleared together; as many rows are worked out together.
const TILE_ROWS: usize = 8;
const TILE_COLUMNS: usize = 16;

/// Which stretches of wire are claimed in one picture.
#[derive(Clone, Debug)]
pub struct ClaimMap {
    columns: usize,
    rows: usize,
    /// Tiles side by side.
    tiles_across: usize,
    /// A bit for each direction in which wire is claimed, row by row, each as long as its tiles.
    cells: Vec<u32>,
    /// A bit for each tile in which one was claimed.
    claimed_tiles: Vec<u64>,
}

impl ClaimMap {
    /// For pictures of this size.
    pub fn new(width: usize, height: usize) -> Self {
        let [columns, rows] = [width, height].map(|px| (px as f64 / CELL_PX) as usize + 1);
        let (tiles_across, tiles_down) = (columns.div_ceil(TILE_COLUMNS), rows.div_ceil(TILE_ROWS));
        Self {
            columns,
            rows,
            tiles_across,
            cells: vec![0; tiles_across * TILE_COLUMNS * tiles_down * TILE_ROWS],
            claimed_tiles: vec![0; (tiles_across * tiles_down).div_ceil(64)],
        }
    }

    /// Nothing is claimed.
    pub fn clear(&mut self) {
        let stride = self.tiles_across * TILE_COLUMNS;
        for (k, claimed) in self.claimed_tiles.iter_mut().enumerate() {
            while *claimed != 0 {
                let tile = 64 * k + claimed.trailing_zeros() as usize;
                let first = tile / self.tiles_across * TILE_ROWS * stride;
                let first = first + tile % self.tiles_across * TILE_COLUMNS;
                for row in self.cells[first..].chunks_mut(stride).take(TILE_ROWS) {
                    row[..TILE_COLUMNS].fill(0);
                }
                *claimed &= *claimed - 1;
            }
        }
    }

    /// Claims the wire that pieces, one after the other, are seen of.
    pub fn claim<'a>(&mut self, wire: impl IntoIterator<Item = &'a PieceSight>) {
        let mut pieces = wire.into_iter().filter(|piece| piece.sight != Sight::Outside).peekable();
        while let Some(first) = pieces.next() {
            let mut last = first;
            while let Some(next) = pieces.next_if(|next| goes_straight_on(first, last, next)) {
                last = next;
            }
            self.claim_bar(first, last);
        }
    }

    /// Claims straight wire from half a width before the middle of one piece to as much behind that of another one.
    fn claim_bar(&mut self, first: &PieceSight, last: &PieceSight) {
        let chord = (last.expected_px - first.expected_px) / CELL_PX;
        let length = chord.norm();
        let along = if length > 1.0 { chord / length } else { Vector2::new(-first.across.y, first.across.x) };
        let half_width = (first.half_width_px + last.half_width_px) / (2.0 * CELL_PX);
        // The bar touches cells whose middle is no farther from it than this.
        let margin = 0.5 * (along.x.abs() + along.y.abs());
        let (reach, half_length) = (half_width * CLAIMED_WIDTH + margin, length / 2.0 + half_width + margin);
        let middle = (first.expected_px + last.expected_px) / (2.0 * CELL_PX);
        let tall = half_length * along.y.abs() + reach * along.x.abs();
        let Some([top, bottom]) = whole_within(middle.y - tall, middle.y + tall, self.rows) else { return };
        let direction = 1u32 << direction_of(&Vector2::new(-along.y, along.x));
        // In each row the bar is what lies between both its sides and between both its ends.
        let sides = Strip::new(along.y, -along.x, reach);
        let ends = Strip::new(along.x, along.y, half_length);
        for tile_row in top / TILE_ROWS..=bottom / TILE_ROWS {
            let first = tile_row * TILE_ROWS;
            let (mut from, mut end) = ([0.0; TILE_ROWS], [0.0; TILE_ROWS]);
            for k in 0..TILE_ROWS {
                let down = (first + k) as f64 - middle.y;
                let ([side_a, side_b], [end_a, end_b]) = (sides.at(down), ends.at(down));
                from[k] = ceil((middle.x + side_a.max(end_a)).max(0.0));
                end[k] = floor((middle.x + side_b.min(end_b) + 1.0).max(0.0).min(self.columns as f64));
            }
            let (mut leftmost, mut rightmost) = (self.columns, 0);
            for row in first.max(top)..=bottom.min(first + TILE_ROWS - 1) {
                let [from, end] = [from, end].map(|columns| columns[row - first] as u32 as usize);
                if from < end {
                    let row = &mut self.cells[row * self.tiles_across * TILE_COLUMNS..];
                    row[from..end].iter_mut().for_each(|cell| *cell |= direction);
                    (leftmost, rightmost) = (leftmost.min(from), rightmost.max(end - 1));
                }
            }
            // None where nothing of the bar lies in the picture.
            for column in leftmost / TILE_COLUMNS..=rightmost / TILE_COLUMNS {
                let tile = tile_row * self.tiles_across + column;
                self.claimed_tiles[tile / 64] |= 1 << (tile % 64);
            }
        }
    }

    /// Directions in which wire is claimed at a place, a bit each.
    fn at(&self, px: &Vector2<f64>) -> u32 {
        // What is negative is large then.
        self.in_cell([px.x, px.y].map(|px| nearest(px / CELL_PX) as usize))
    }

    fn in_cell(&self, [column, row]: [usize; 2]) -> u32 {
        if column < self.columns && row < self.rows {
            self.cells[row * self.tiles_across * TILE_COLUMNS + column]
        } else {
            0
        }
    }

    /// Whether the middle of a piece lies on claimed wire of the same direction.
    pub fn is_claimed(&self, piece: &PieceSight) -> bool {
        self.is_claimed_at(&piece.expected_px, &piece.across)
    }

    /// Whether a place lies on claimed wire of any direction.
    pub fn is_claimed_at_all(&self, px: &Vector2<f64>) -> bool {
        self.at(px) != 0
    }

    /// Whether a pixel, column and row, lies on claimed wire.
    pub fn is_claimed_by_any(&self, [x, y]: [u16; 2]) -> bool {
        // The nearest cell: a pixel more, rounded down.
        self.in_cell([x, y].map(|px| (usize::from(px) + CELL / 2) / CELL)) != 0
    }

    /// Whether a place lies on claimed wire of another direction than the one that `across` is at right angles to.
    pub fn is_claimed_across(&self, px: &Vector2<f64>, across: &Vector2<f64>) -> bool {
        self.at(px) & !same_directions(across) != 0
    }

    /// Whether a place lies on claimed wire of the direction that `across` is at right angles to.
    pub fn is_claimed_at(&self, px: &Vector2<f64>, across: &Vector2<f64>) -> bool {
        let claimed = self.at(px);
        claimed != 0 && claimed & same_directions(across) != 0
    }
}

/// A bit for each direction that is the same as the one that `across` is at right angles to.
fn same_directions(across: &Vector2<f64>) -> u32 {
    let near = (1u32 << (2 * SAME_DIRECTION + 1)) - 1;
    near.rotate_left((direction_of(across) + DIRECTIONS - SAME_DIRECTION) as u32)
}

/// What lies no farther than given from a straight line through the origin, row by row.
struct Strip {
    slope: f64,
    half: f64,
}

impl Strip {
    /// `x` and `y`: unit vector across the line.
    fn new(x: f64, y: f64, reach: f64) -> Self {
        // A level line is taken for one that is so by less than a picture's width notices.
        let x = if x.abs() < 1e-9 { 1e-9 } else { x };
        Self { slope: -y / x, half: reach / x.abs() }
    }

    /// From where to where, in the row `down` below the origin.
    fn at(&self, down: f64) -> [f64; 2] {
        [self.slope * down - self.half, self.slope * down + self.half]
    }
}

/// Whether a bar from `first` to `last` may go on to the next piece.
fn goes_straight_on(first: &PieceSight, last: &PieceSight, next: &PieceSight) -> bool {
    (next.expected_px - first.expected_px).dot(&first.across).abs() < STRAIGHT_PX
        && next.across.dot(&first.across).abs() > STRAIGHT_COS
        && (next.half_width_px - first.half_width_px).abs() < STRAIGHT_PX
        && (next.expected_px - last.expected_px).norm() < NEXT_HALF_WIDTHS * next.half_width_px
}

/// The first and the last of the whole numbers below `count` from one number to another, if any.
fn whole_within(from: f64, to: f64, count: usize) -> Option<[usize; 2]> {
    let is_any = from <= to && to >= 0.0;
    let (from, to) = (from.max(0.0), to.min(count as f64 - 1.0));
    let below = from as usize;
    let first = below + usize::from((below as f64) < from);
    (is_any && first <= to as usize).then_some([first, to as usize])
}

/// The nearest of [`DIRECTIONS`], from 0 along x on.
fn direction_of(across: &Vector2<f64>) -> i32 {
    // Tangents of the angles in the middle between two directions, up to an eighth of a turn.
    const MIDDLES: [f64; 8] = [
        0.049_126_849_769_467_254,
        0.148_335_987_538_347_43,
        0.250_486_960_191_305_5,
        0.357_805_721_314_524_05,
        0.473_064_710_000_943_6,
        0.599_376_933_681_923_8,
        0.741_650_546_272_035_7,
        0.906_347_169_019_147_1,
    ];
    let (x, y) = (across.x.abs(), across.y.abs());
    let (less, more) = (x.min(y), x.max(y));
    let steps = MIDDLES.iter().filter(|&&tan| less > tan * more).count() as i32;
    let steep = if y > x { DIRECTIONS / 2 - steps } else { steps };
    if across.x * across.y < 0.0 { (DIRECTIONS - steep) % DIRECTIONS } else { steep }
}

#[cfg(test)]
pub(super) mod tests {
    use std::f64::consts::{SQRT_2, TAU};

    use proptest::prelude::*;

    use super::*;

    /// A piece of wire of seven pixels, clearly seen.
    pub(in super::super) fn piece(x: f64, y: f64, across: [f64; 2]) -> PieceSight {
        PieceSight {
            sight: Sight::Clear,
            expected_px: Vector2::new(x, y),
            across: Vector2::from(across).normalize(),
            half_width_px: 3.5,
            seen_px: Some((0.0, 7.0)),
        }
    }

    #[test]
    fn a_wire_that_crosses_takes_no_claim_away() {
        let mut claims = ClaimMap::new(100, 100);
        let (level, upright) = (piece(50.0, 50.0, [0.0, 1.0]), piece(50.0, 50.0, [1.0, 0.0]));
        claims.claim([&level]);
        assert!(claims.is_claimed(&level) && !claims.is_claimed(&upright));
        claims.claim([&upright]);
        assert!(claims.is_claimed(&level) && claims.is_claimed(&upright));
        claims.clear();
        assert!(!claims.is_claimed(&level) && !claims.is_claimed_by_any([50, 50]));
    }

    proptest! {
        #[test]
        fn straight_wire_is_claimed_without_gaps(
            (x, y) in (60.0..140.0, 60.0..140.0), angle in 0.0..TAU, half_width_px in 0.5..12.0,
            (along, across) in (-3.0..3.0, -CLAIMED_WIDTH..CLAIMED_WIDTH),
        ) {
            let (sin, cos) = f64::sin_cos(angle);
            let axes = [Vector2::new(cos, sin), Vector2::new(-sin, cos)];
            let at = |along: f64, across: f64| {
                Vector2::new(x, y) + (axes[0] * along + axes[1] * across) * half_width_px
            };
            let wire = [-2.0, 0.0, 2.0].map(|along| {
                let place = at(along, 0.0);
                PieceSight { half_width_px, ..piece(place.x, place.y, axes[1].into()) }
            });
            let mut claims = ClaimMap::new(200, 200);
            claims.claim(&wire);
            prop_assert!(claims.is_claimed_at(&at(along, across), &axes[1]));
        }

        #[test]
        fn what_is_farther_than_a_cell_from_wire_is_not_claimed(
            (x, y) in (-20.0..220.0, -20.0..220.0), angle in 0.0..TAU, bend in -0.02..0.02,
            half_width_px in 0.5..12.0, count in 1usize..20,
            pixel in [0u16..200, 0u16..200],
        ) {
            let (mut place, mut angle) = (Vector2::new(x, y), angle);
            let mut wire = Vec::new();
            for _ in 0..count {
                let (sin, cos) = f64::sin_cos(angle);
                wire.push(PieceSight { half_width_px, ..piece(place.x, place.y, [-sin, cos]) });
                place += Vector2::new(cos, sin) * (2.0 * half_width_px);
                angle += bend;
            }
            let mut claims = ClaimMap::new(200, 200);
            claims.claim(&wire);
            let probe = Vector2::from(pixel.map(f64::from));
            let is_far = |piece: &PieceSight| {
                let from = probe - piece.expected_px;
                // The diagonal of a cell, and what a bar may lie beside bent wire.
                let away_px = CELL_PX * SQRT_2 + 2.0 * STRAIGHT_PX;
                from.dot(&piece.across).abs() > CLAIMED_WIDTH * half_width_px + away_px
                    || from.perp(&piece.across).abs() > half_width_px + away_px
            };
            prop_assert!(!wire.iter().all(is_far) || !claims.is_claimed_by_any(pixel));
            prop_assert_eq!(claims.is_claimed_by_any(pixel), claims.at(&probe) != 0);
        }
    }

    #[test]
    fn directions_are_rounded_angles() {
        for k in 0..1000 {
            let angle = f64::from(k) * 0.00731;
            let expected = ((angle / std::f64::consts::PI * 32.0).round() as i32).rem_euclid(32);
            assert_eq!(direction_of(&Vector2::new(angle.cos(), angle.sin())), expected, "{angle}");
        }
    }

    #[test]
    fn a_claim_holds_for_like_directions_and_not_for_the_wire_beside() {
        let mut claims = ClaimMap::new(100, 100);
        // The directions about half a turn are neighbours, too.
        claims.claim(&[piece(50.0, 50.0, [1.0, 0.05])]);
        assert!(claims.is_claimed(&piece(50.0, 50.0, [1.0, -0.05])));
        assert!(claims.is_claimed(&piece(50.0, 50.0, [-1.0, 0.05])));
        assert!(!claims.is_claimed(&piece(50.0, 50.0, [1.0, 0.8])));
        assert!(!claims.is_claimed(&piece(58.0, 50.0, [1.0, 0.05])));
    }
}
