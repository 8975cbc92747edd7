//! Sliding minima and maxima and ranks over small grids of bytes, written so that the compiler turns them into
//! vector instructions of whatever set the caller has.

/// Samples that a window is wide and high.
pub(super) const WINDOW: usize = 5;
/// Samples around a grid so that all windows that touch it fit: the window's width less 1.
pub(super) const MARGIN: usize = WINDOW - 1;

/// Copies a grid to the middle of a larger one, its outermost samples repeated all around. Both have `pitch` columns.
#[inline(always)]
pub(super) fn pad(from: &[u8], to: &mut [u8], rows: usize, columns: usize, pitch: usize) {
    for y in 0..rows + 2 * MARGIN {
        let row = &from[y.saturating_sub(MARGIN).min(rows - 1) * pitch..][..columns];
        let out = &mut to[y * pitch..][..columns + 2 * MARGIN];
        out[..MARGIN].fill(row[0]);
        out[MARGIN..MARGIN + columns].copy_from_slice(row);
        out[MARGIN + columns..].fill(row[columns - 1]);
    }
}

/// The extreme of the square window right of and below each sample: the least, or with `MAX` the greatest.
#[inline(always)]
pub(super) fn slide<const MAX: bool>(grid: &mut [u8], pitch: usize) {
    // Windows of 2, 4 and 5 in a row, each from two of the ones before.
    for shift in [1, 2, 1] {
        pairs::<MAX>(grid, shift * pitch);
    }
    for shift in [1, 2, 1] {
        pairs::<MAX>(grid, shift);
    }
}

/// The opposite extreme of the same window, which undoes its displacement.
#[inline(always)]
pub(super) fn slide_back<const MAX: bool>(grid: &mut [u8], pitch: usize) {
    if MAX { slide::<false>(grid, pitch) } else { slide::<true>(grid, pitch) }
}

/// Every byte to the extreme of itself and the one `shift` further on.
#[inline(always)]
fn pairs<const MAX: bool>(grid: &mut [u8], shift: usize) {
    const LANES: usize = 64;
    for at in (0..(grid.len() - shift).next_multiple_of(LANES) - LANES).step_by(LANES) {
        let Some(&further) = grid.get(at + shift..).and_then(|g| g.first_chunk::<LANES>()) else { return };
        let Some(here) = grid.get_mut(at..).and_then(|g| g.first_chunk_mut::<LANES>()) else { return };
        for (here, further) in here.iter_mut().zip(further) {
            *here = if MAX { (*here).max(further) } else { (*here).min(further) };
        }
    }
}

/// The value that `rank` of the bytes are below or before, in order of size.
#[inline(always)]
pub(super) fn ranked(bytes: &[u8], rank: usize) -> u8 {
    // The greatest value that at most `rank` bytes are below, bit by bit.
    let mut value = 0u8;
    for bit in (0..8).rev() {
        let higher = value | 1 << bit;
        if count_below(bytes, higher) <= rank {
            value = higher;
        }
    }
    value
}

/// How many bytes are below a value.
#[inline(always)]
fn count_below(bytes: &[u8], value: u8) -> usize {
    // 16-bit sums, because twice as many fit into a register as 32-bit ones.
    let parts = bytes.chunks(usize::from(u16::MAX));
    parts.map(|part| usize::from(part.iter().map(|&byte| u16::from(byte < value)).sum::<u16>())).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40))]

        #[test]
        fn ranks_are_those_of_the_sorted_bytes(bytes in proptest::collection::vec(any::<u8>(), 1..700), share in 0.0..1.0) {
            let rank = (share * bytes.len() as f64) as usize;
            let mut sorted = bytes.clone();
            sorted.sort_unstable();
            prop_assert_eq!(ranked(&bytes, rank), sorted[rank]);
        }

        #[test]
        fn opening_is_the_greatest_of_the_least_of_the_windows_around(
            columns in 1usize..20, rows in 1usize..15, bytes in proptest::collection::vec(any::<u8>(), 300)
        ) {
            let pitch = columns + 2 * MARGIN;
            let size = (pitch * (rows + 2 * MARGIN)).next_multiple_of(64) + 64;
            let (mut grid, mut opened) = (vec![0; size], vec![0; size]);
            for y in 0..rows {
                grid[y * pitch..][..columns].copy_from_slice(&bytes[y * columns..][..columns]);
            }
            pad(&grid, &mut opened, rows, columns, pitch);
            slide::<false>(&mut opened, pitch);
            slide_back::<false>(&mut opened, pitch);
            let at = |x: i32, y: i32| {
                let (x, y) = (x.clamp(0, columns as i32 - 1), y.clamp(0, rows as i32 - 1));
                bytes[y as usize * columns + x as usize]
            };
            let window = || (-2..=2).flat_map(|dy| (-2..=2).map(move |dx| (dx, dy)));
            for y in 0..rows {
                for x in 0..columns {
                    let least = |(cx, cy): (i32, i32)| {
                        window().map(|(dx, dy)| at(x as i32 + cx + dx, y as i32 + cy + dy)).min()
                    };
                    prop_assert_eq!(Some(opened[y * pitch + x]), window().filter_map(least).max());
                }
            }
        }
    }
}
