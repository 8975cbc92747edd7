//! Coefficients of a block from the bits of a scan (ITU-T T.81, F.2.2).

use super::baseline::Fault;
use super::bits::Bits;
use super::huffman::{Huffman, signed};

const TOO_MANY: Fault = Fault::Damaged("more than 64 coefficients in a block");

/// Place in the block of the k-th coefficient (T.81, figure A.6); blocks are stored column by column.
const ZIGZAG: [u8; 64] = {
    let mut order = [0; 64];
    let (mut k, mut diagonal) = (0, 0);
    while diagonal < 15 {
        let mut step = 0;
        while step <= diagonal {
            // Odd diagonals run down, even ones up.
            let (x, y) = if diagonal % 2 == 1 { (diagonal - step, step) } else { (step, diagonal - step) };
            if x < 8 && y < 8 {
                order[k] = (8 * x + y) as u8;
                k += 1;
            }
            step += 1;
        }
        diagonal += 1;
    }
    order
};

/// Where the k-th coefficient of a table stands.
#[inline(always)]
pub(super) fn zigzag(k: usize) -> usize {
    usize::from(ZIGZAG[k])
}

/// Reads a block: the difference of its first coefficient, the others into `block` (all zeros before). The place of
/// the last one, in zigzag order, 0 where there is none but the first.
#[inline(always)]
pub(super) fn read(
    bits: &mut Bits,
    bytes: &[u8],
    (dc, ac): (&Huffman, &Huffman),
    block: &mut [i16; 64],
) -> Result<(i32, usize), Fault> {
    let mut own = *bits;
    own.refill(bytes);
    let mut difference = 0;
    first(&mut own, bytes, dc, |value| difference = value)?;
    let last = others(&mut own, bytes, ac, |k, value| block[zigzag(k & 63) & 63] = value as i16)?;
    *bits = own;
    Ok((difference, last))
}

/// Goes on behind a block that nobody wants; it can be as bad as others.
#[inline(always)]
pub(super) fn skip(bits: &mut Bits, bytes: &[u8], (dc, ac): (&Huffman, &Huffman)) -> Result<(), Fault> {
    let mut own = *bits;
    own.refill(bytes);
    first(&mut own, bytes, dc, |_| {})?;
    others(&mut own, bytes, ac, |_, _| {})?;
    *bits = own;
    Ok(())
}

/// Reads the difference of the first coefficient.
#[inline(always)]
fn first(bits: &mut Bits, bytes: &[u8], dc: &Huffman, take: impl FnOnce(i32)) -> Result<(), Fault> {
    let entry = dc.look(bits.window);
    if entry.is_rare() {
        let (length, value) = rare_first(dc, bits.window)?;
        take(value);
        bits.skip(length);
        bits.refill(bytes);
    } else {
        take(entry.value(bits.window));
        bits.skip_entry(entry);
    }
    Ok(())
}

/// Reads the other coefficients; the place of the last one.
#[inline(always)]
fn others(
    bits: &mut Bits,
    bytes: &[u8],
    ac: &Huffman,
    mut take: impl FnMut(usize, i32),
) -> Result<usize, Fault> {
    let mut k = 0;
    let mut pair = ac.look_twice(bits.window);
    loop {
        // Two pairs (or the first coefficient and a pair) from one refill, the second of one turn and the first of the
        // next. The look at the next pair need not wait for it.
        for refill in [true, false] {
            let (step, step2) = pair.steps();
            let (first, next) = (k + step, k + step + step2);
            if next < 63 {
                let values = pair.values(bits.window);
                take(first, values.0);
                take(next, values.1);
                bits.skip_pair(pair);
                pair = ac.look_twice(bits.window);
                if refill {
                    bits.refill(bytes);
                }
                k = next;
                continue;
            }
            if pair.is_end() {
                bits.skip_pair(pair);
                return Ok(k);
            }
            bits.refill(bytes);
            let (length, next, value) = rare(ac, bits.window, k)?;
            bits.skip(length);
            if next > 63 {
                return Ok(k);
            }
            k = next;
            if value != 0 {
                take(k, value);
            }
            if k == 63 {
                return Ok(k);
            }
            bits.refill(bytes);
            pair = ac.look_twice(bits.window);
        }
    }
}

/// The length of a first coefficient and its difference.
#[cold]
#[inline(never)]
fn rare_first(dc: &Huffman, window: u64) -> Result<(u32, i32), Fault> {
    let (size, length) = dc.symbol(window)?;
    if size > 15 {
        return Err(Fault::Damaged("bad size of a coefficient"));
    }
    let size = u32::from(size);
    Ok((length + size, signed(window << length, 63 - size)))
}

/// What comes behind the k-th coefficient where it is neither short nor the end: its length, its place (more than 63
/// for none), and its value, 0 for a run of zeros.
#[cold]
#[inline(never)]
fn rare(ac: &Huffman, window: u64, k: usize) -> Result<(u32, usize, i32), Fault> {
    let (symbol, length) = ac.symbol(window)?;
    let (run, size) = (usize::from(symbol >> 4), u32::from(symbol & 15));
    match (run, size) {
        (15, 0) => Ok((length, k + 16, 0)),
        (_, 0) => Ok((length, 64, 0)),
        _ if k + run + 1 > 63 => Err(TOO_MANY),
        _ => Ok((length + size, k + run + 1, signed(window << length, 63 - size))),
    }
}

#[cfg(test)]
mod tests {
    use super::super::bits::{Data, Room};
    use super::super::huffman::{Class, tests::counts};
    use super::*;
    use proptest::prelude::*;

    /// [`read`] symbol by symbol.
    fn read_slowly(
        bits: &mut Bits,
        bytes: &[u8],
        (dc, ac): (&Huffman, &Huffman),
        block: &mut [i16; 64],
    ) -> Result<(i32, usize), Fault> {
        bits.refill(bytes);
        let (length, difference) = rare_first(dc, bits.window)?;
        bits.skip(length);
        let mut k = 0;
        while k < 63 {
            bits.refill(bytes);
            let (length, next, value) = rare(ac, bits.window, k)?;
            bits.skip(length);
            if next > 63 {
                break;
            }
            k = next;
            if value != 0 {
                block[zigzag(k)] = value as i16;
            }
        }
        Ok((difference, k))
    }

    proptest! {
        #[test]
        fn blocks_are_read_and_skipped_as_symbol_by_symbol(
            choices in proptest::array::uniform2(proptest::array::uniform16(any::<u8>())),
            few in 1u8..9, sizes in 1u8..17, symbols in proptest::collection::vec(any::<u8>(), 256),
            raw in proptest::collection::vec(any::<u8>(), 0..600),
        ) {
            let (mut dc, mut ac) = (Huffman::empty(), Huffman::empty());
            for (table, class, choices) in [(&mut dc, Class::Dc, choices[0]), (&mut ac, Class::Ac, choices[1])] {
                let counts = counts(choices, few);
                let all = counts.iter().map(|&n| usize::from(n)).sum();
                let symbols = symbols[..all].iter().map(|&symbol| match class {
                    Class::Dc => symbol % 16 % sizes,
                    Class::Ac => (symbol & 0x30) | (symbol % 16 % sizes),
                });
                prop_assert_eq!(table.read(class, &counts, &symbols.collect::<Vec<_>>()), Ok(()));
            }
            let mut room = Room::new(8);
            let data = Data::new(&raw, &mut room, 8);
            let (bytes, tables) = (data.bytes(), (&dc, &ac));
            let [mut fast, mut slow, mut skipped] = [(); 3].map(|()| Bits::new(&data));
            for _ in 0..8 {
                let (mut block, mut expected) = ([0; 64], [0; 64]);
                let result = read_slowly(&mut slow, bytes, tables, &mut expected);
                prop_assert_eq!(read(&mut fast, bytes, tables, &mut block), result);
                prop_assert_eq!(skip(&mut skipped, bytes, tables), result.map(|_| ()));
                if result.is_err() {
                    break;
                }
                prop_assert_eq!(block, expected);
                prop_assert_eq!((fast.used_bits(), skipped.used_bits()), (slow.used_bits(), slow.used_bits()));
            }
        }
    }

    #[test]
    fn coefficients_run_along_the_diagonals() {
        let begin: Vec<usize> = (0..10).map(zigzag).collect();
        assert_eq!(begin, [0, 8, 1, 2, 9, 16, 24, 17, 10, 3]);
        let mut all: Vec<usize> = (0..64).map(zigzag).collect();
        assert_eq!(all[63], 63);
        all.sort_unstable();
        assert_eq!(all, (0..64).collect::<Vec<_>>());
    }
}
