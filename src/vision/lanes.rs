//! Rows of a picture side by side in one register: the words of eight rows in one 512-bit register, four in one of
//! 256 bits, or one in a plain word. All three give the same bits; the plain word is the safe twin of the others.
//!
//! A function of three bits is named by its truth table: bit `4a + 2b + c` of the table is the result. Tables are
//! written with the constants [`A`], [`B`] and [`C`], so that `A & B | C` reads as the function that it is.
//!
//! A value of a register type is the proof that the machine has its instructions: only [`Lanes::load`] and
//! [`Lanes::splat`], which make one, are unsafe.

/// Table of the first operand.
pub(crate) const A: i32 = 0xf0;
/// Table of the second operand.
pub(crate) const B: i32 = 0xcc;
/// Table of the third operand.
pub(crate) const C: i32 = 0xaa;

/// Table of the function that is 1 where `table` is 0.
pub(crate) const fn not(table: i32) -> i32 {
    table ^ 0xff
}

/// One register of rows.
pub(crate) trait Lanes: Copy {
    /// Rows, that is words, a register.
    const ROWS: usize;
    /// `ROWS` words from memory.
    ///
    /// # Safety
    /// The machine has the type's instructions, and `ROWS` words can be read at `from`.
    unsafe fn load(from: *const u64) -> Self;
    /// The same word in all rows.
    ///
    /// # Safety
    /// The machine has the type's instructions.
    unsafe fn splat(word: u64) -> Self;
    /// `ROWS` words to memory.
    ///
    /// # Safety
    /// `ROWS` words can be written at `to`.
    unsafe fn store(self, to: *mut u64);
    /// Any function of three bits, see the module.
    fn ternary<const TABLE: i32>(a: Self, b: Self, c: Self) -> Self;
    /// Every pixel's left neighbour; `west` is the same rows one strip to the left.
    fn left_neighbours(self, west: Self) -> Self;
    /// Every pixel's right neighbour; `east` is the same rows one strip to the right.
    fn right_neighbours(self, east: Self) -> Self;
    /// Bit i: row i shares a bit with `mask`'s row i.
    fn rows_sharing(self, mask: Self) -> u8;
}

/// What a register can do where it has no instruction for functions of three bits.
trait Terms: Copy {
    fn and(self, other: Self) -> Self;
    fn or(self, other: Self) -> Self;
    fn xor(self, other: Self) -> Self;
    /// Not self, and other.
    fn not_and(self, other: Self) -> Self;
    fn ones(self) -> Self;
}

/// [`Lanes::ternary`] from two-bit functions; the table is a constant, so only the terms it needs remain.
#[inline(always)]
fn ternary_by_terms<T: Terms, const TABLE: i32>(a: T, b: T, c: T) -> T {
    // With c fixed, the table is a function of a and b; then c chooses between the two.
    let even = TABLE & 1 | TABLE >> 1 & 2 | TABLE >> 2 & 4 | TABLE >> 3 & 8;
    let odd = TABLE >> 1 & 1 | TABLE >> 2 & 2 | TABLE >> 3 & 4 | TABLE >> 4 & 8;
    let (when_c, unless_c) = (binary(odd, a, b), binary(even, a, b));
    match (even, odd) {
        (even, odd) if even == odd => when_c,
        (0, _) => when_c.and(c),
        (_, 0) => c.not_and(unless_c),
        (_, 15) => unless_c.or(c),
        (15, _) => when_c.or(c.xor(c.ones())),
        (even, odd) if even ^ odd == 15 => unless_c.xor(c),
        _ => when_c.xor(unless_c).and(c).xor(unless_c),
    }
}

/// Function of two bits with the table `nibble`: bit `2a + b` is the result.
#[inline(always)]
fn binary<T: Terms>(nibble: i32, a: T, b: T) -> T {
    let ones = a.ones();
    match nibble {
        0b0000 => ones.xor(ones),
        0b0001 => a.or(b).xor(ones),
        0b0010 => a.not_and(b),
        0b0011 => a.xor(ones),
        0b0100 => b.not_and(a),
        0b0101 => b.xor(ones),
        0b0110 => a.xor(b),
        0b0111 => a.and(b).xor(ones),
        0b1000 => a.and(b),
        0b1001 => a.xor(b).xor(ones),
        0b1010 => b,
        0b1011 => a.xor(ones).or(b),
        0b1100 => a,
        0b1101 => b.xor(ones).or(a),
        0b1110 => a.or(b),
        _ => ones,
    }
}

impl Terms for u64 {
    #[inline(always)]
    fn and(self, other: Self) -> Self {
        self & other
    }
    #[inline(always)]
    fn or(self, other: Self) -> Self {
        self | other
    }
    #[inline(always)]
    fn xor(self, other: Self) -> Self {
        self ^ other
    }
    #[inline(always)]
    fn not_and(self, other: Self) -> Self {
        !self & other
    }
    #[inline(always)]
    fn ones(self) -> Self {
        u64::MAX
    }
}

impl Lanes for u64 {
    const ROWS: usize = 1;

    #[inline(always)]
    unsafe fn load(from: *const u64) -> Self {
        // SAFETY: the caller's pointer can be read.
        unsafe { from.read() }
    }

    #[inline(always)]
    unsafe fn splat(word: u64) -> Self {
        word
    }

    #[inline(always)]
    unsafe fn store(self, to: *mut u64) {
        // SAFETY: the caller's pointer can be written.
        unsafe { to.write(self) }
    }

    #[inline(always)]
    fn ternary<const TABLE: i32>(a: Self, b: Self, c: Self) -> Self {
        ternary_by_terms::<u64, TABLE>(a, b, c)
    }

    #[inline(always)]
    fn left_neighbours(self, west: Self) -> Self {
        self << 1 | west >> 63
    }

    #[inline(always)]
    fn right_neighbours(self, east: Self) -> Self {
        self >> 1 | east << 63
    }

    #[inline(always)]
    fn rows_sharing(self, mask: Self) -> u8 {
        (self & mask != 0) as u8
    }
}

#[cfg(target_arch = "x86_64")]
pub(crate) use x86::{Rows4, Rows8};

#[cfg(target_arch = "x86_64")]
mod x86 {
    //! The registers of x86-64.
    use super::{Lanes, Terms, ternary_by_terms};
    use std::arch::x86_64::*;

    /// Four rows; the machine has AVX2.
    #[derive(Clone, Copy)]
    pub(crate) struct Rows4(__m256i);

    impl Lanes for Rows4 {
        const ROWS: usize = 4;

        #[inline(always)]
        unsafe fn load(from: *const u64) -> Self {
            // SAFETY: the caller has AVX2 and 4 words behind the pointer.
            Self(unsafe { _mm256_loadu_si256(from.cast()) })
        }

        #[inline(always)]
        unsafe fn splat(word: u64) -> Self {
            // SAFETY: the caller has AVX2.
            Self(unsafe { _mm256_set1_epi64x(word as i64) })
        }

        #[inline(always)]
        unsafe fn store(self, to: *mut u64) {
            // SAFETY: the caller has 4 words behind the pointer.
            unsafe { _mm256_storeu_si256(to.cast(), self.0) }
        }

        #[inline(always)]
        fn ternary<const TABLE: i32>(a: Self, b: Self, c: Self) -> Self {
            ternary_by_terms::<Self, TABLE>(a, b, c)
        }

        #[inline(always)]
        fn left_neighbours(self, west: Self) -> Self {
            // SAFETY: the operands prove AVX2.
            Self(unsafe { _mm256_or_si256(_mm256_slli_epi64::<1>(self.0), _mm256_srli_epi64::<63>(west.0)) })
        }

        #[inline(always)]
        fn right_neighbours(self, east: Self) -> Self {
            // SAFETY: the operands prove AVX2.
            Self(unsafe { _mm256_or_si256(_mm256_srli_epi64::<1>(self.0), _mm256_slli_epi64::<63>(east.0)) })
        }

        #[inline(always)]
        fn rows_sharing(self, mask: Self) -> u8 {
            // SAFETY: the operands prove AVX2.
            unsafe {
                let none = _mm256_cmpeq_epi64(_mm256_and_si256(self.0, mask.0), _mm256_setzero_si256());
                !(_mm256_movemask_pd(_mm256_castsi256_pd(none)) as u8) & 0b1111
            }
        }
    }

    impl Terms for Rows4 {
        #[inline(always)]
        fn and(self, other: Self) -> Self {
            // SAFETY: the operands prove AVX2.
            Self(unsafe { _mm256_and_si256(self.0, other.0) })
        }
        #[inline(always)]
        fn or(self, other: Self) -> Self {
            // SAFETY: the operands prove AVX2.
            Self(unsafe { _mm256_or_si256(self.0, other.0) })
        }
        #[inline(always)]
        fn xor(self, other: Self) -> Self {
            // SAFETY: the operands prove AVX2.
            Self(unsafe { _mm256_xor_si256(self.0, other.0) })
        }
        #[inline(always)]
        fn not_and(self, other: Self) -> Self {
            // SAFETY: the operands prove AVX2.
            Self(unsafe { _mm256_andnot_si256(self.0, other.0) })
        }
        #[inline(always)]
        fn ones(self) -> Self {
            // SAFETY: the operand proves AVX2.
            Self(unsafe { _mm256_set1_epi64x(-1) })
        }
    }

    /// Eight rows; the machine has AVX-512 F, BW, DQ, VL and VBMI2.
    #[derive(Clone, Copy)]
    pub(crate) struct Rows8(__m512i);

    impl Lanes for Rows8 {
        const ROWS: usize = 8;

        #[inline(always)]
        unsafe fn load(from: *const u64) -> Self {
            // SAFETY: the caller has AVX-512 and 8 words behind the pointer.
            Self(unsafe { _mm512_loadu_si512(from.cast()) })
        }

        #[inline(always)]
        unsafe fn splat(word: u64) -> Self {
            // SAFETY: the caller has AVX-512.
            Self(unsafe { _mm512_set1_epi64(word as i64) })
        }

        #[inline(always)]
        unsafe fn store(self, to: *mut u64) {
            // SAFETY: the caller has 8 words behind the pointer.
            unsafe { _mm512_storeu_si512(to.cast(), self.0) }
        }

        #[inline(always)]
        fn ternary<const TABLE: i32>(a: Self, b: Self, c: Self) -> Self {
            // SAFETY: the operands prove AVX-512.
            Self(unsafe { _mm512_ternarylogic_epi64::<TABLE>(a.0, b.0, c.0) })
        }

        #[inline(always)]
        fn left_neighbours(self, west: Self) -> Self {
            // SAFETY: the operands prove AVX-512 VBMI2.
            Self(unsafe { _mm512_shldi_epi64::<1>(self.0, west.0) })
        }

        #[inline(always)]
        fn right_neighbours(self, east: Self) -> Self {
            // SAFETY: the operands prove AVX-512 VBMI2.
            Self(unsafe { _mm512_shrdi_epi64::<1>(self.0, east.0) })
        }

        #[inline(always)]
        fn rows_sharing(self, mask: Self) -> u8 {
            // SAFETY: the operands prove AVX-512.
            unsafe { _mm512_test_epi64_mask(self.0, mask.0) }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every table on every combination of bits, all registers of this machine against the plain definition.
    #[test]
    fn every_ternary_function_is_its_table() {
        const A8: [u64; 8] = [0xf0, 1, 2, 3, 4, 5, 6, u64::MAX << 8 | 0xf0];
        fn check<L: Lanes, const TABLE: i32>() {
            let (a, b, c) = (A8, A8.map(|w| w >> 2 | 0xcc), A8.map(|w| w << 3 ^ 0xaa));
            let mut result = [0u64; 8];
            // SAFETY: called for registers of this machine; 8 words are enough for any of them.
            unsafe {
                L::ternary::<TABLE>(L::load(a.as_ptr()), L::load(b.as_ptr()), L::load(c.as_ptr()))
                    .store(result.as_mut_ptr())
            };
            for i in 0..L::ROWS {
                for bit in 0..64 {
                    let of = |w: [u64; 8]| w[i] >> bit & 1;
                    let expected = TABLE >> (4 * of(a) + 2 * of(b) + of(c)) & 1;
                    assert_eq!(of(result), expected as u64, "table {TABLE:#x}, row {i}, bit {bit}");
                }
            }
        }
        fn all<L: Lanes>() {
            macro_rules! tables {
                ($($high:literal)*) => { $( {
                    check::<L, { $high * 16 }>(); check::<L, { $high * 16 + 1 }>(); check::<L, { $high * 16 + 2 }>();
                    check::<L, { $high * 16 + 3 }>(); check::<L, { $high * 16 + 4 }>(); check::<L, { $high * 16 + 5 }>();
                    check::<L, { $high * 16 + 6 }>(); check::<L, { $high * 16 + 7 }>(); check::<L, { $high * 16 + 8 }>();
                    check::<L, { $high * 16 + 9 }>(); check::<L, { $high * 16 + 10 }>(); check::<L, { $high * 16 + 11 }>();
                    check::<L, { $high * 16 + 12 }>(); check::<L, { $high * 16 + 13 }>(); check::<L, { $high * 16 + 14 }>();
                    check::<L, { $high * 16 + 15 }>();
                } )* };
            }
            tables!(0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15);
        }
        all::<u64>();
        #[cfg(target_arch = "x86_64")]
        for level in crate::level::Level::available() {
            match level {
                crate::level::Level::Plain => {}
                crate::level::Level::Avx2 => all::<Rows4>(),
                crate::level::Level::Avx512 => all::<Rows8>(),
            }
        }
    }
}
