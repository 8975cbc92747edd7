//! The one definition of every colour conversion, in integers, so that all code paths agree to the bit.
//!
//! Luma of R'G'B' is BT.601's 0.299 R' + 0.587 G' + 0.114 B' with 15 fractional bits, rounded. R'G'B' of
//! Y'CbCr is the sum of at most three products, each rounded to 1/64 level, rounded again and clamped to 0..=255:
//! within one level of exact arithmetic, and it fits 16-bit lanes.

use super::{ColourEncoding, QuantizationRange, YcbcrMatrix};

/// BT.601 luma weights of R, G, B with [`LUMA_SHIFT`] fractional bits.
pub const LUMA_WEIGHTS: [i32; 3] = [9798, 19235, 3735];
/// Fractional bits of [`LUMA_WEIGHTS`].
pub const LUMA_SHIFT: u32 = 15;

/// BT.601 luma of full-range R'G'B'.
///
/// ```
/// use pickcell::frame::colour::luma_of_rgb;
/// assert_eq!((luma_of_rgb([255, 255, 255]), luma_of_rgb([255, 0, 0])), (255, 76));
/// ```
#[inline]
pub const fn luma_of_rgb(rgb: [u8; 3]) -> u8 {
    let [r, g, b] = LUMA_WEIGHTS;
    ((rgb[0] as i32 * r + rgb[1] as i32 * g + rgb[2] as i32 * b + (1 << (LUMA_SHIFT - 1))) >> LUMA_SHIFT)
        as u8
}

/// Fractional bits of the sums that [`Ycbcr`] forms.
pub const LEVEL_SHIFT: u32 = 6;

/// `(a * b + 2^14) >> 15`, what the instruction PMULHRSW does.
#[inline]
const fn mulhrs(a: i16, b: i16) -> i16 {
    ((a as i32 * b as i32 + 0x4000) >> 15) as i16
}

/// The conversion of one colour encoding: levels in 1/64 are
/// `mulhrs((Y - y_offset) << 7, y) + mulhrs((Cb - 128) << 8, _u) + mulhrs((Cr - 128) << 8, _v)`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ycbcr {
    /// Code value of black.
    pub y_offset: i16,
    /// Gain of Y with 14 fractional bits.
    pub y: i16,
    /// Gain of Cr in R with 13 fractional bits, as all that follow.
    pub r_v: i16,
    /// Gain of Cb in G.
    pub g_u: i16,
    /// Gain of Cr in G.
    pub g_v: i16,
    /// Gain of Cb in B.
    pub b_u: i16,
    /// Gain of Cb in BT.601 luma; 0 where the matrix is BT.601's own.
    pub l_u: i16,
    /// Gain of Cr in BT.601 luma; 0 where the matrix is BT.601's own.
    pub l_v: i16,
}

/// Rounds to 13 fractional bits.
const fn q13(x: f64) -> i16 {
    (x * 8192.0 + if x < 0.0 { -0.5 } else { 0.5 }) as i16
}

impl Ycbcr {
    /// The conversion for this encoding (ITU-R BT.601-7, BT.709-6).
    pub const fn new(encoding: ColourEncoding) -> Self {
        let (kr, kb) = match encoding.matrix {
            YcbcrMatrix::Bt601 => (0.299, 0.114),
            YcbcrMatrix::Bt709 => (0.2126, 0.0722),
        };
        let (y_offset, y_gain, c_gain) = match encoding.range {
            QuantizationRange::Limited => (16, 255.0 / 219.0, 255.0 / 224.0),
            QuantizationRange::Full => (0, 1.0, 1.0),
        };
        let kg = 1.0 - kr - kb;
        let r_v = 2.0 * (1.0 - kr) * c_gain;
        let b_u = 2.0 * (1.0 - kb) * c_gain;
        let (g_u, g_v) = (-b_u * kb / kg, -r_v * kr / kg);
        let (l_u, l_v) = match encoding.matrix {
            YcbcrMatrix::Bt601 => (0.0, 0.0),
            YcbcrMatrix::Bt709 => (0.587 * g_u + 0.114 * b_u, 0.299 * r_v + 0.587 * g_v),
        };
        Self {
            y_offset,
            y: q13(2.0 * y_gain),
            r_v: q13(r_v),
            g_u: q13(g_u),
            g_v: q13(g_v),
            b_u: q13(b_u),
            l_u: q13(l_u),
            l_v: q13(l_v),
        }
    }

    /// R, G, B and BT.601 luma in 1/64 level, neither rounded to levels nor clamped.
    #[inline]
    pub const fn levels(&self, y: u8, u: u8, v: u8) -> [i16; 4] {
        let y = mulhrs((y as i16 - self.y_offset) << 7, self.y);
        let (u, v) = ((u as i16 - 128) << 8, (v as i16 - 128) << 8);
        [
            y.saturating_add(mulhrs(v, self.r_v)),
            y.saturating_add(mulhrs(u, self.g_u) + mulhrs(v, self.g_v)),
            y.saturating_add(mulhrs(u, self.b_u)),
            y.saturating_add(mulhrs(u, self.l_u) + mulhrs(v, self.l_v)),
        ]
    }

    /// R'G'B' of a pixel.
    #[inline]
    pub const fn rgb(&self, y: u8, u: u8, v: u8) -> [u8; 3] {
        let l = self.levels(y, u, v);
        [level(l[0]), level(l[1]), level(l[2])]
    }

    /// BT.601 luma of a pixel.
    #[inline]
    pub const fn luma(&self, y: u8, u: u8, v: u8) -> u8 {
        level(self.levels(y, u, v)[3])
    }
}

/// 1/64 levels to a level.
#[inline]
const fn level(l: i16) -> u8 {
    let v = (l as i32 + 32) >> LEVEL_SHIFT;
    if v < 0 {
        0
    } else if v > 255 {
        255
    } else {
        v as u8
    }
}

/// The range of 1/64 levels whose rounded, clamped level is in `min..=max`; both ends included.
pub const fn level_range(min: u8, max: u8) -> (i16, i16) {
    let lo = if min == 0 { i16::MIN } else { (min as i16) * 64 - 32 };
    let hi = if max == 255 { i16::MAX } else { (max as i16) * 64 + 31 };
    (lo, hi)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn encodings() -> impl Iterator<Item = ColourEncoding> {
        [YcbcrMatrix::Bt601, YcbcrMatrix::Bt709].into_iter().flat_map(|matrix| {
            [QuantizationRange::Limited, QuantizationRange::Full]
                .into_iter()
                .map(move |range| ColourEncoding { matrix, range })
        })
    }

    /// Exact arithmetic, straight from the recommendations.
    fn rgb_exact(e: ColourEncoding, y: u8, u: u8, v: u8) -> [f64; 3] {
        let (kr, kb) = if e.matrix == YcbcrMatrix::Bt601 { (0.299, 0.114) } else { (0.2126, 0.0722) };
        let (y, u, v) = (f64::from(y), f64::from(u) - 128.0, f64::from(v) - 128.0);
        let (y, u, v) = match e.range {
            QuantizationRange::Limited => ((y - 16.0) / 219.0, u / 224.0, v / 224.0),
            QuantizationRange::Full => (y / 255.0, u / 255.0, v / 255.0),
        };
        let r = y + 2.0 * (1.0 - kr) * v;
        let b = y + 2.0 * (1.0 - kb) * u;
        let g = (y - kr * r - kb * b) / (1.0 - kr - kb);
        [r, g, b].map(|c| (c * 255.0).clamp(0.0, 255.0))
    }

    #[test]
    fn conversion_is_within_one_level_of_exact_arithmetic() {
        for e in encodings() {
            let c = Ycbcr::new(e);
            for y in (0..=255).step_by(3) {
                for u in (0..=255).step_by(5) {
                    for v in (0..=255).step_by(5) {
                        let exact = rgb_exact(e, y, u, v);
                        for (got, want) in c.rgb(y, u, v).into_iter().zip(exact) {
                            assert!((f64::from(got) - want).abs() < 0.6, "{e:?} {y} {u} {v}: {got} {want}");
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn luma_of_greys_is_their_level_and_601_needs_no_chroma() {
        for g in 0..=255u8 {
            assert_eq!(luma_of_rgb([g; 3]), g);
        }
        for e in encodings() {
            let c = Ycbcr::new(e);
            assert_eq!(c.luma(if e.range == QuantizationRange::Full { 255 } else { 235 }, 128, 128), 255);
            assert_eq!((c.l_u == 0 && c.l_v == 0), e.matrix == YcbcrMatrix::Bt601);
        }
    }

    #[test]
    fn a_level_is_in_range_as_its_rounded_value_is() {
        for (min, max) in [(0, 255), (0, 10), (100, 255), (7, 7)] {
            let (lo, hi) = level_range(min, max);
            for l in i16::MIN..=i16::MAX {
                assert_eq!((lo..=hi).contains(&l), (min..=max).contains(&level(l)), "{l}");
            }
        }
    }
}
