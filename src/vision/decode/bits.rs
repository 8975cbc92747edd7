//! The bits of a scan (ITU-T T.81, F.2.2.5): its data up to a marker, freed of stuffing, and a window over them.

use super::baseline::Fault;
use super::huffman::{Entry, Pair};

/// Bytes of a window.
const WINDOW: usize = 8;

/// Bytes copied together.
const RUN: usize = 32;

/// What a block needs at most: 64 coefficients of 31 bits, in bytes.
const BLOCK_BYTES: usize = 248;

/// Bytes that the window may be ahead of what is used, and some more.
const AHEAD: usize = 64;

/// Cameras may leave some bits before a marker besides the seven that fill a byte.
const UNUSED_BITS: usize = 48;

/// Memory for the data of some rows of blocks without stuffing.
#[derive(Clone, Debug)]
pub(super) struct Room(Vec<u8>);

impl Room {
    /// For rows of at most so many blocks of all components.
    pub(super) fn new(blocks: usize) -> Self {
        // Twice what a row needs, so that little is moved.
        Self(vec![0; 2 * row_bytes(blocks) + RUN + WINDOW])
    }
}

fn row_bytes(blocks: usize) -> usize {
    blocks * BLOCK_BYTES + AHEAD
}

/// The data of a scan from marker to marker, without stuffing; zeros behind.
pub(super) struct Data<'a> {
    raw: &'a [u8],
    /// The first byte of `raw` that was not taken.
    next: usize,
    plain: &'a mut [u8],
    /// How many bytes of `plain` were taken.
    taken: usize,
    /// Whether a marker or nothing stands at `next`.
    ended: bool,
    row_bytes: usize,
}

impl<'a> Data<'a> {
    /// `blocks`: of all components in a row.
    pub(super) fn new(raw: &'a [u8], room: &'a mut Room, blocks: usize) -> Self {
        let row_bytes = row_bytes(blocks);
        let mut data = Self { raw, next: 0, plain: &mut room.0, taken: 0, ended: false, row_bytes };
        data.take();
        data
    }

    /// Takes what the next row of blocks can need.
    #[inline(always)]
    pub(super) fn ready(&mut self, bits: &mut Bits) {
        if self.ended || self.taken >= bits.at + self.row_bytes {
            return;
        }
        // The window's bytes stay, too.
        let begin = bits.at.saturating_sub(WINDOW);
        self.plain.copy_within(begin..self.taken, 0);
        self.taken -= begin;
        bits.at -= begin;
        self.take();
    }

    #[inline(always)]
    fn take(&mut self) {
        while self.taken + RUN + WINDOW <= self.plain.len() {
            let from = self.raw.get(self.next..).and_then(|rest| rest.first_chunk::<RUN>());
            if let (Some(from), Some(to)) = (from, self.plain[self.taken..].first_chunk_mut::<RUN>()) {
                *to = *from;
                let plain = if from.iter().fold(false, |found, &byte| found | (byte == 0xff)) {
                    from.iter().take_while(|&&byte| byte != 0xff).count()
                } else {
                    RUN
                };
                self.next += plain;
                self.taken += plain;
                if plain == RUN {
                    continue;
                }
            }
            let (byte, length) = match (self.raw.get(self.next), self.raw.get(self.next + 1)) {
                (Some(0xff), Some(0)) => (0xff, 2),
                (Some(0xff), _) | (None, _) => {
                    self.ended = true;
                    break;
                }
                (Some(&byte), _) => (byte, 1),
            };
            self.plain[self.taken] = byte;
            self.taken += 1;
            self.next += length;
        }
        self.plain[self.taken..self.taken + WINDOW].fill(0);
    }

    /// What was taken, and a window of zeros.
    #[inline(always)]
    pub(super) fn bytes(&self) -> &[u8] {
        &self.plain[..self.taken + WINDOW]
    }

    /// Fails where bits beyond the end were used.
    #[inline(always)]
    pub(super) fn check(&self, bits: &Bits) -> Result<(), Fault> {
        if bits.used_bits() > 8 * self.taken {
            return Err(Fault::Damaged("picture data end too early"));
        }
        Ok(())
    }

    /// Goes on behind the restart marker that must come now, behind no more than [`UNUSED_BITS`].
    pub(super) fn restart(&mut self, bits: &mut Bits) -> Result<(), Fault> {
        self.check(bits)?;
        let near = 8 * self.taken <= bits.used_bits() + UNUSED_BITS;
        let rest = self.raw.get(self.next..).unwrap_or_default();
        let fill = rest.iter().take_while(|&&byte| byte == 0xff).count();
        let marker = matches!(rest.get(fill), Some(0xd0..=0xd7));
        if !self.ended || !near || fill == 0 || !marker {
            return Err(Fault::Damaged("a restart marker is missing"));
        }
        self.next += fill + 1;
        (self.taken, self.ended) = (0, false);
        self.take();
        *bits = Bits::new(self);
        Ok(())
    }
}

/// A window of 64 bits over the data.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bits {
    /// The next bits, from the top.
    pub(super) window: u64,
    /// How many bits of the window were used since it was filled.
    used: u32,
    /// The byte behind the window.
    at: usize,
}

impl Bits {
    /// At the beginning of the data.
    pub(super) fn new(data: &Data<'_>) -> Self {
        Self {
            window: data.plain.first_chunk().map_or(0, |bytes| u64::from_be_bytes(*bytes)),
            used: 0,
            at: WINDOW,
        }
    }

    /// How many bits of the data were used.
    #[inline(always)]
    pub(super) fn used_bits(&self) -> usize {
        8 * (self.at - WINDOW) + self.used as usize
    }

    /// At least 57 bits of the window become good. `bytes` are [`Data::bytes`].
    #[inline(always)]
    pub(super) fn refill(&mut self, bytes: &[u8]) {
        // The last window is zeros.
        let at = self.at.min(bytes.len() - WINDOW);
        let next = bytes[at..].first_chunk().map_or(0, |next| u64::from_be_bytes(*next));
        // Bits of a byte that is not counted as taken come again with the next refill: the same ones.
        self.window |= next >> 1 >> (!self.used & 63);
        self.at += self.used as usize / 8;
        self.used %= 8;
    }

    #[inline(always)]
    pub(super) fn skip_entry(&mut self, entry: Entry) {
        self.window = entry.behind(self.window);
        self.used += entry.length();
    }

    #[inline(always)]
    pub(super) fn skip_pair(&mut self, pair: Pair) {
        self.window = pair.behind(self.window);
        self.used += pair.length();
    }

    #[inline(always)]
    pub(super) fn skip(&mut self, length: u32) {
        self.window <<= length & 63;
        self.used += length & 63;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_lose_their_stuffing_and_end_in_zeros() {
        let mut room = Room::new(1);
        let data = Data::new(&[0xff, 0, 0x81, 0xff, 0xd9], &mut room, 1);
        let mut bits = Bits::new(&data);
        assert_eq!(bits.window >> 40, 0xff_81_00);
        bits.skip(16);
        assert_eq!(data.check(&bits), Ok(()));
        bits.skip(1);
        assert_eq!(data.check(&bits), Err(Fault::Damaged("picture data end too early")));
        for _ in 0..1000 {
            bits.refill(data.bytes());
            assert_eq!(bits.window, 0);
            bits.skip(57);
        }
    }

    #[test]
    fn rows_come_through_a_small_room() {
        let plain: Vec<u8> =
            (0..5000u32).map(|i| if i % 7 == 0 { 0xff } else { (i * i / 3) as u8 }).collect();
        let stuffed: Vec<u8> = plain
            .iter()
            .flat_map(|&byte| [byte, 0].into_iter().take(1 + usize::from(byte == 0xff)))
            .collect();
        let mut room = Room::new(1);
        let mut data = Data::new(&stuffed, &mut room, 1);
        let mut bits = Bits::new(&data);
        for row in plain.chunks(BLOCK_BYTES) {
            data.ready(&mut bits);
            for &byte in row {
                bits.refill(data.bytes());
                assert_eq!((bits.window >> 56) as u8, byte);
                bits.skip(8);
            }
            assert_eq!(data.check(&bits), Ok(()));
        }
        bits.skip(1);
        assert!(data.check(&bits).is_err());
    }

    #[test]
    fn a_restart_marker_stands_close_to_the_last_bit() {
        let missing = Err(Fault::Damaged("a restart marker is missing"));
        for (unused, marker, expected) in [
            (0, &[0xff, 0xd0][..], Ok(())),
            (6, &[0xff, 0xff, 0xd7], Ok(())),
            (7, &[0xff, 0xd0], missing),
            (0, &[0xff, 0xd9], missing),
            (0, &[], missing),
        ] {
            let raw = [&[1, 2, 3][..], &vec![4; unused], marker, &[0x55]].concat();
            let mut room = Room::new(1);
            let mut data = Data::new(&raw, &mut room, 1);
            let mut bits = Bits::new(&data);
            bits.skip(24);
            assert_eq!(data.restart(&mut bits), expected, "{unused} {marker:?}");
            if expected.is_ok() {
                assert_eq!(bits.window >> 56, 0x55);
            }
        }
    }
}
