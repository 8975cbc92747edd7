//! Huffman tables of a baseline JPEG (ITU-T T.81, annexes C and F.2): one look tells what comes next.

use super::baseline::Fault;

/// Codes up to this length are looked up at once: of differences, and of coefficients. More would leave the
/// first-level cache no room for all tables of a picture.
const DC_BITS: u32 = 8;
const AC_BITS: u32 = 10;

/// Length of an [`Entry`]: of the 57 bits that a refill gives, two of them (or two pairs) leave enough for another
/// look.
const LENGTH_MAX: u32 = (57 - AC_BITS) / 2;

/// Step of an [`Entry`] at the end of a block: beyond it.
const END: u32 = 64;
/// Step of an [`Entry`] that does not tell: a long code, none, or one that is not a coefficient.
const RARE: u32 = 255;

/// What a table is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Class {
    /// Differences of first coefficients; a symbol is a size.
    Dc,
    /// Other coefficients; a symbol is a run of zeros and a size.
    Ac,
}

impl Class {
    /// Codes up to this length are looked up at once.
    fn fast_bits(self) -> u32 {
        match self {
            Class::Dc => DC_BITS,
            Class::Ac => AC_BITS,
        }
    }
}

/// What the next bits mean: from the low end a byte each for the length of code and coefficient, the step from the
/// coefficient before, the length of the code, and 63 less the size of the coefficient.
#[derive(Clone, Copy, Debug)]
pub(super) struct Entry(u32);

impl Entry {
    const UNKNOWN: Self = Self(RARE << 8);

    fn new(class: Class, symbol: u8, length: u32) -> Self {
        let (run, size) = (u32::from(symbol >> 4), u32::from(symbol & 15));
        let step = match (class, run, size) {
            _ if length + size > LENGTH_MAX => return Self::UNKNOWN,
            (Class::Dc, 0, _) => 0,
            (Class::Ac, 0..15, 0) => END,
            (Class::Dc, ..) | (Class::Ac, _, 0) => return Self::UNKNOWN,
            (Class::Ac, ..) => run + 1,
        };
        Self((63 - size) << 24 | length << 16 | step << 8 | (length + size))
    }

    /// Length of code and coefficient.
    #[inline(always)]
    pub(super) fn length(self) -> u32 {
        self.0 & 255
    }

    /// `window` without them. The shift takes the low bits by itself, one step less to the next look.
    #[inline(always)]
    pub(super) fn behind(self, window: u64) -> u64 {
        window << (self.0 & 63)
    }

    /// How many coefficients farther this one is; more than 63 for the end of the block or what is to be looked up
    /// with [`Huffman::symbol`].
    fn step(self) -> usize {
        (self.0 >> 8 & 255) as usize
    }

    /// Whether it is no coefficient of this block.
    fn is_beyond(self) -> bool {
        self.step() >= END as usize
    }

    fn code_length(self) -> u32 {
        self.0 >> 16 & 255
    }

    #[inline(always)]
    pub(super) fn is_rare(self) -> bool {
        self.step() == RARE as usize
    }

    /// The coefficient or difference, which may have no bits, that stands at the top of `window` behind its code.
    #[inline(always)]
    pub(super) fn value(self, window: u64) -> i32 {
        signed(window << (self.0 >> 16 & 63), self.0 >> 24)
    }
}

/// Two coefficients that the next bits mean, or one twice; from the low end a byte each for the length of both, step,
/// begin and 63 less the size of the first, the same of the second.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pair(u64);

impl Pair {
    /// Of an entry and the one behind it, where that one is known.
    fn new(first: Entry, second: Option<Entry>) -> Self {
        let [length, step, begin, beyond] = first.0.to_le_bytes();
        Self(u64::from_le_bytes(match second.map(|second| second.0.to_le_bytes()) {
            Some([length2, step2, begin2, beyond2]) => {
                [length + length2, step, begin, beyond, step2, length + begin2, beyond2, 0]
            }
            None => [length, step, begin, beyond, 0, begin, beyond, 0],
        }))
    }

    /// Steps to the first and on to the second, see [`Entry::step`].
    #[inline(always)]
    pub(super) fn steps(self) -> (usize, usize) {
        ((self.0 >> 8 & 255) as usize, (self.0 >> 32 & 255) as usize)
    }

    #[inline(always)]
    pub(super) fn is_end(self) -> bool {
        self.steps().0 == END as usize
    }

    /// Length of both.
    #[inline(always)]
    pub(super) fn length(self) -> u32 {
        self.0 as u32 & 255
    }

    /// `window` without them. The shift takes the low bits by itself, one step less to the next look.
    #[inline(always)]
    pub(super) fn behind(self, window: u64) -> u64 {
        window << (self.0 & 63)
    }

    /// The coefficients.
    #[inline(always)]
    pub(super) fn values(self, window: u64) -> (i32, i32) {
        let value = |at: u32| coefficient(window << (self.0 >> at & 63), (self.0 >> (at + 8)) as u32 & 255);
        (value(16), value(40))
    }
}

/// What to add to a coefficient with a 0 at its beginning: 1 less 2 to the power of its size, by 63 less the size.
const NEGATIVE: [i32; 64] = {
    let mut all = [0; 64];
    let mut size = 1;
    while size < 16 {
        all[63 - size] = 1 - (1 << size);
        size += 1;
    }
    all
};

/// [`signed`] of one or more bits.
#[inline(always)]
fn coefficient(bits: u64, beyond: u32) -> i32 {
    let positive = ((bits as i64) >> 63) as i32;
    (bits >> ((beyond + 1) & 63)) as i32 + (NEGATIVE[beyond as usize & 63] & !positive)
}

/// A difference or coefficient at the top of `bits`, of 63 - `beyond` of them (T.81, figure F.12): where its first
/// bit is 0 the others are those of its negative, inverted.
#[inline(always)]
pub(super) fn signed(bits: u64, beyond: u32) -> i32 {
    let negative = !((bits as i64) >> 63);
    let magnitude = ((bits ^ negative as u64) >> 1 >> (beyond & 63)) as i32;
    (magnitude ^ negative as i32) - negative as i32
}

/// One Huffman table.
#[derive(Clone, Debug)]
pub(super) struct Huffman {
    /// By the next bits, see [`Class::fast_bits`].
    entries: Box<[Entry; 1 << AC_BITS]>,
    /// By the next bits, the same with what comes behind; only of [`Class::Ac`].
    pairs: Box<[Pair; 1 << AC_BITS]>,
    /// What was read, if it was good: number of codes by length.
    counts: Option<[u8; 16]>,
    /// By length: beyond the last code of it, as if all codes had 16 bits.
    beyond: [u32; 17],
    /// By length: add to a code for the place of its symbol.
    offset: [i32; 17],
    symbols: [u8; 256],
}

impl Huffman {
    /// A table without codes.
    pub(super) fn empty() -> Self {
        let entries = Box::new([Entry::UNKNOWN; 1 << AC_BITS]);
        let pairs = Box::new([Pair::new(Entry::UNKNOWN, None); 1 << AC_BITS]);
        Self { entries, pairs, counts: None, beyond: [0; 17], offset: [0; 17], symbols: [0; 256] }
    }

    /// Reads a table from number of codes by length (16 bytes) and symbols (T.81, annex C).
    pub(super) fn read(&mut self, class: Class, counts: &[u8; 16], symbols: &[u8]) -> Result<(), Fault> {
        if self.counts == Some(*counts) && self.symbols[..symbols.len()] == *symbols {
            // Pictures of a camera have the same tables.
            return Ok(());
        }
        let fast_bits = class.fast_bits();
        self.counts = None;
        self.entries.fill(Entry::UNKNOWN);
        self.symbols.fill(0);
        self.symbols[..symbols.len()].copy_from_slice(symbols);
        let (mut code, mut first) = (0u32, 0usize);
        for length in 1..=16u32 {
            let count = usize::from(counts[length as usize - 1]);
            self.offset[length as usize] = first as i32 - code as i32;
            for &symbol in &symbols[first..first + count] {
                if code >= 1 << length {
                    return Err(Fault::Damaged("Huffman table with more codes than there can be"));
                }
                if length <= fast_bits {
                    let begin = (code << (fast_bits - length)) as usize;
                    self.entries[begin..begin + (1 << (fast_bits - length))]
                        .fill(Entry::new(class, symbol, length));
                }
                code += 1;
            }
            self.beyond[length as usize] = code << (16 - length);
            first += count;
            code <<= 1;
        }
        if class == Class::Ac {
            self.join();
        }
        self.counts = Some(*counts);
        Ok(())
    }

    /// Makes the pairs from the entries.
    fn join(&mut self) {
        for (next, (pair, &first)) in self.pairs.iter_mut().zip(self.entries.iter()).enumerate() {
            let known = AC_BITS.saturating_sub(first.length());
            let second = self.entries[next << (AC_BITS - known) & ((1 << AC_BITS) - 1)];
            let fits = !first.is_beyond()
                && !second.is_beyond()
                && second.code_length() <= known
                && first.length() + second.length() <= LENGTH_MAX;
            *pair = Pair::new(first, fits.then_some(second));
        }
    }

    /// The difference at the top of `window`.
    #[inline(always)]
    pub(super) fn look(&self, window: u64) -> Entry {
        self.entries[(window >> (64 - DC_BITS)) as usize]
    }

    /// The coefficients at the top of `window`.
    #[inline(always)]
    pub(super) fn look_twice(&self, window: u64) -> Pair {
        self.pairs[(window >> (64 - AC_BITS)) as usize]
    }

    /// The symbol at the top of `window` and the length of its code, whatever they are.
    pub(super) fn symbol(&self, window: u64) -> Result<(u8, u32), Fault> {
        let next = (window >> 48) as u32;
        // Most that are asked for are too long to be looked up.
        let least = if next < self.beyond[AC_BITS as usize] { 1 } else { AC_BITS + 1 };
        for length in least..=16 {
            if next < self.beyond[length as usize] {
                let place = (next >> (16 - length)) as i32 + self.offset[length as usize];
                let symbol = self.symbols.get(place as usize).ok_or(Fault::Damaged("bad Huffman code"))?;
                return Ok((*symbol, length));
            }
        }
        Err(Fault::Damaged("bad Huffman code"))
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Numbers of codes by length from any numbers: at most `few` of a length, and seldom room left for more.
    pub(in super::super) fn counts(choices: [u8; 16], few: u8) -> [u8; 16] {
        let mut free = 1u32;
        choices.map(|choice| {
            free = 2 * free.min(1000);
            let count = (u32::from(choice) % u32::from(few + 1)).min(free);
            free -= count;
            count as u8
        })
    }

    #[test]
    fn values_are_those_of_the_standard() {
        // T.81, table F.1: sizes 0 to 3.
        let value = |bits: u64, size: u32| signed(if size == 0 { 0 } else { bits << (64 - size) }, 63 - size);
        assert_eq!(value(0, 0), 0);
        assert_eq!([0, 1].map(|bits| value(bits, 1)), [-1, 1]);
        assert_eq!([0, 1, 2, 3].map(|bits| value(bits, 2)), [-3, -2, 2, 3]);
        assert_eq!([0, 3, 4, 7].map(|bits| value(bits, 3)), [-7, -4, 4, 7]);
        assert_eq!([0, 0x7fff].map(|bits| value(bits, 15)), [-32767, 32767]);
    }

    proptest! {
        #[test]
        fn a_look_finds_what_the_search_finds(
            choices in proptest::array::uniform16(any::<u8>()), few in 1u8..9,
            symbols in proptest::collection::vec(any::<u8>(), 128),
            window in any::<u64>(), class in prop_oneof![Just(Class::Dc), Just(Class::Ac)],
        ) {
            let counts = counts(choices, few);
            let symbols = &symbols[..counts.iter().map(|&n| usize::from(n)).sum()];
            let mut table = Huffman::empty();
            prop_assert_eq!(table.read(class, &counts, symbols), Ok(()));
            let entry = table.entries[(window >> (64 - class.fast_bits())) as usize];
            if class == Class::Dc {
                prop_assert_eq!(table.look(window).0, entry.0);
            }
            match table.symbol(window) {
                Ok((symbol, length)) if !entry.is_rare() => {
                    prop_assert!(length <= class.fast_bits());
                    let (run, size) = (usize::from(symbol >> 4), u32::from(symbol & 15));
                    prop_assert_eq!(entry.length(), length + size);
                    prop_assert_eq!(entry.behind(window), window << (length + size));
                    prop_assert_eq!(entry.value(window), signed(window << length, 63 - size));
                    match class {
                        Class::Dc => prop_assert!(symbol < 16 && entry.step() == 0),
                        Class::Ac if size == 0 => prop_assert!(run < 15 && entry.step() == END as usize),
                        Class::Ac => prop_assert_eq!(entry.step(), run + 1),
                    }
                }
                Ok((symbol, length)) => {
                    let of_class = match class {
                        Class::Dc => symbol > 15,
                        Class::Ac => symbol == 0xf0,
                    };
                    let long = length > class.fast_bits() || length + u32::from(symbol & 15) > LENGTH_MAX;
                    prop_assert!(long || of_class);
                }
                Err(_) => prop_assert!(entry.is_rare()),
            }
        }

        #[test]
        fn a_pair_is_one_entry_or_two(
            choices in proptest::array::uniform16(any::<u8>()), few in 1u8..9,
            symbols in proptest::collection::vec(any::<u8>(), 128),
            window in any::<u64>(),
        ) {
            let counts = counts(choices, few);
            let symbols = &symbols[..counts.iter().map(|&n| usize::from(n)).sum()];
            let mut table = Huffman::empty();
            prop_assert_eq!(table.read(Class::Ac, &counts, symbols), Ok(()));
            let look = |window: u64| table.entries[(window >> (64 - AC_BITS)) as usize];
            let (first, pair) = (look(window), table.look_twice(window));
            prop_assert_eq!(pair.is_end(), first.step() == END as usize);
            prop_assert_eq!(pair.steps().0, first.step());
            prop_assert!(pair.length() <= LENGTH_MAX);
            let second = look(first.behind(window));
            let (last, step) = match pair.steps().1 {
                0 => (first, first.step()),
                step => (second, first.step() + step),
            };
            if first.is_beyond() {
                return Ok(());
            }
            let length = if step == first.step() { first.length() } else { first.length() + second.length() };
            prop_assert_eq!((pair.length(), pair.behind(window)), (length, window << length));
            prop_assert_eq!(pair.values(window).0, first.value(window));
            prop_assert_eq!(pair.values(window).1, last.value(window << (length - last.length())));
            prop_assert_eq!(step, first.step() + if length == first.length() { 0 } else { second.step() });
        }
    }
}
