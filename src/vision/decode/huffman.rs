//! Entropy-coded data of a baseline JPEG: bits, Huffman tables, coefficients (ITU-T T.81, annex F.2).

use super::baseline::Fault;

/// Codes up to this length are looked up at once.
const FAST_BITS: u32 = 10;

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
pub(super) fn zigzag(k: usize) -> usize {
    usize::from(ZIGZAG[k])
}

/// One Huffman table.
#[derive(Clone, Debug)]
pub(super) struct Huffman {
    /// By the next bits: length of the code times 256 plus its symbol; 0 where it is longer.
    fast: Box<[u16; 1 << FAST_BITS]>,
    /// By the next bits, where code and coefficient are in them: its value, the run of zeros before it (8 bits) and
    /// the length of both (8 bits); else 0.
    quick: Box<[i32; 1 << FAST_BITS]>,
    /// By length: beyond the last code of it, as if all codes had 16 bits.
    beyond: [u32; 17],
    /// By length: add to a code for the place of its symbol.
    offset: [i32; 17],
    symbols: [u8; 256],
}

impl Huffman {
    /// A table without codes.
    pub(super) fn empty() -> Self {
        let (fast, quick) = (Box::new([0; 1 << FAST_BITS]), Box::new([0; 1 << FAST_BITS]));
        Self { fast, quick, beyond: [0; 17], offset: [0; 17], symbols: [0; 256] }
    }

    /// Reads a table from number of codes by length (16 bytes) and symbols (T.81, annex C).
    pub(super) fn read(&mut self, counts: &[u8; 16], symbols: &[u8]) -> Result<(), Fault> {
        self.fast.fill(0);
        self.symbols.fill(0);
        self.symbols[..symbols.len()].copy_from_slice(symbols);
        let (mut code, mut first) = (0u32, 0usize);
        for length in 1..=16u32 {
            let count = usize::from(counts[length as usize - 1]);
            self.offset[length as usize] = first as i32 - code as i32;
            for symbol in &symbols[first..first + count] {
                if code >= 1 << length {
                    return Err(Fault::Damaged("Huffman table with more codes than there can be"));
                }
                if length <= FAST_BITS {
                    let begin = (code << (FAST_BITS - length)) as usize;
                    let entry = (length as u16) << 8 | u16::from(*symbol);
                    self.fast[begin..begin + (1 << (FAST_BITS - length))].fill(entry);
                }
                code += 1;
            }
            self.beyond[length as usize] = code << (16 - length);
            first += count;
            code <<= 1;
        }
        for (next, (quick, &entry)) in self.quick.iter_mut().zip(self.fast.iter()).enumerate() {
            let (length, run, size) =
                (u32::from(entry >> 8), i32::from(entry >> 4 & 15), u32::from(entry & 15));
            let fits = entry != 0 && size != 0 && length + size <= FAST_BITS;
            *quick = if fits {
                let value = (next >> (FAST_BITS - length - size)) as i32 & ((1 << size) - 1);
                signed(value, size) << 16 | run << 8 | (length + size) as i32
            } else {
                0
            };
        }
        Ok(())
    }

    /// The next symbol.
    #[inline(always)]
    fn symbol(&self, bits: &mut Bits<'_>) -> Result<u8, Fault> {
        let entry = self.fast[bits.peek(FAST_BITS) as usize];
        if entry != 0 {
            bits.skip(u32::from(entry >> 8));
            return Ok(entry as u8);
        }
        let next = bits.peek(16);
        for length in FAST_BITS + 1..=16 {
            if next < self.beyond[length as usize] {
                bits.skip(length);
                let place = (next >> (16 - length)) as i32 + self.offset[length as usize];
                return self.symbols.get(place as usize).copied().ok_or(Fault::Damaged("bad Huffman code"));
            }
        }
        Err(Fault::Damaged("bad Huffman code"))
    }
}

/// A difference or coefficient of `size` bits (T.81, figure F.12).
#[inline(always)]
fn signed(value: i32, size: u32) -> i32 {
    if value < (1 << size) >> 1 { value - (1 << size) + 1 } else { value }
}

/// The bits of a scan, without stuffing; beyond its end zeros.
pub(super) struct Bits<'a> {
    data: &'a [u8],
    at: usize,
    /// The next bits, from the top.
    buffer: u64,
    count: u32,
    /// How many bits at the end of the buffer are made up.
    made_up: u32,
}

impl<'a> Bits<'a> {
    pub(super) fn new(data: &'a [u8]) -> Self {
        Self { data, at: 0, buffer: 0, count: 0, made_up: 0 }
    }

    /// Makes sure of at least 48 bits.
    #[inline(always)]
    fn refill(&mut self) {
        if self.count >= 48 {
            return;
        }
        if let Some(bytes) = self.data.get(self.at..).and_then(|rest| rest.first_chunk()) {
            let next = u64::from_be_bytes(*bytes);
            // Whether a byte is 0xff: a zero byte of the complement.
            if (!next).wrapping_sub(0x0101_0101_0101_0101) & next & 0x8080_8080_8080_8080 == 0 {
                let taken = (64 - self.count) / 8;
                self.buffer |= next >> (64 - 8 * taken) << (64 - 8 * taken - self.count);
                self.count += 8 * taken;
                self.at += taken as usize;
                return;
            }
        }
        self.refill_slowly();
    }

    #[cold]
    fn refill_slowly(&mut self) {
        while self.count <= 56 {
            let byte = match (self.data.get(self.at), self.data.get(self.at + 1)) {
                (Some(0xff), Some(0)) => {
                    self.at += 2;
                    0xff
                }
                (Some(0xff), _) | (None, _) => {
                    self.made_up += 8;
                    0
                }
                (Some(&byte), _) => {
                    self.at += 1;
                    byte
                }
            };
            self.buffer |= u64::from(byte) << (56 - self.count);
            self.count += 8;
        }
    }

    #[inline(always)]
    fn peek(&self, bits: u32) -> u32 {
        (self.buffer >> (64 - bits)) as u32
    }

    #[inline(always)]
    fn skip(&mut self, bits: u32) {
        self.buffer <<= bits;
        self.count = self.count.wrapping_sub(bits);
    }

    /// The next `size` bits as a difference (T.81, F.2.2.1).
    #[inline(always)]
    fn difference(&mut self, size: u32) -> i32 {
        // Two shifts, for a size of 0.
        let value = (self.buffer >> 1 >> (63 - size)) as i32;
        self.skip(size);
        signed(value, size)
    }

    /// Fails where bits beyond the end were used.
    pub(super) fn check(&self) -> Result<(), Fault> {
        if self.count < self.made_up { Err(Fault::Damaged("picture data end too early")) } else { Ok(()) }
    }

    /// Goes on behind the restart marker that must come now.
    pub(super) fn restart(&mut self) -> Result<(), Fault> {
        self.check()?;
        let rest = self.data.get(self.at..).unwrap_or_default();
        let fill = rest.iter().take_while(|&&byte| byte == 0xff).count();
        if fill == 0 || !matches!(rest.get(fill), Some(0xd0..=0xd7)) {
            return Err(Fault::Damaged("a restart marker is missing"));
        }
        self.at += fill + 1;
        (self.buffer, self.count, self.made_up) = (0, 0, 0);
        Ok(())
    }
}

/// Reads a block into `block` (all zeros before), each coefficient times its `scale`; the place of the last one that
/// is not 0, in zigzag order.
#[inline(always)]
pub(super) fn read_block(
    bits: &mut Bits<'_>,
    dc: &Huffman,
    ac: &Huffman,
    scale: &[f32; 64],
    last_dc: &mut i32,
    block: &mut [f32; 64],
) -> Result<usize, Fault> {
    bits.refill();
    let size = dc.symbol(bits)?;
    if size > 15 {
        return Err(Fault::Damaged("bad size of a coefficient"));
    }
    *last_dc = last_dc.wrapping_add(bits.difference(u32::from(size)));
    block[0] = *last_dc as f32 * scale[0];
    let (mut k, mut last) = (1, 0);
    while k < 64 {
        bits.refill();
        let quick = ac.quick[bits.peek(FAST_BITS) as usize];
        if quick != 0 {
            k += (quick >> 8 & 15) as usize;
            if k > 63 {
                return Err(TOO_MANY);
            }
            bits.skip((quick & 255) as u32);
            let place = zigzag(k) & 63;
            block[place] = (quick >> 16) as f32 * scale[place];
            last = k;
            k += 1;
            continue;
        }
        let symbol = ac.symbol(bits)?;
        let (run, size) = (usize::from(symbol >> 4), u32::from(symbol & 15));
        if size == 0 {
            if run < 15 {
                break;
            }
            k += 16;
            continue;
        }
        k += run;
        if k > 63 {
            return Err(TOO_MANY);
        }
        let place = zigzag(k) & 63;
        block[place] = bits.difference(size) as f32 * scale[place];
        last = k;
        k += 1;
    }
    Ok(last)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coefficients_run_along_the_diagonals() {
        let begin: Vec<usize> = (0..10).map(zigzag).collect();
        assert_eq!(begin, [0, 8, 1, 2, 9, 16, 24, 17, 10, 3]);
        let mut all: Vec<usize> = (0..64).map(zigzag).collect();
        assert_eq!(all[63], 63);
        all.sort_unstable();
        assert_eq!(all, (0..64).collect::<Vec<_>>());
    }

    #[test]
    fn bits_lose_their_stuffing_and_end_in_zeros() {
        let mut bits = Bits::new(&[0xff, 0, 0x81, 0xff, 0xd9]);
        bits.refill();
        assert_eq!(bits.peek(24), 0xff_81_00);
        bits.skip(16);
        assert_eq!(bits.check(), Ok(()));
        bits.skip(1);
        assert!(bits.check().is_err());
    }
}
