//! Rounding to whole numbers in steps that every register can do side by side: a conversion to an integer and back is done
//! one after the other on many machines, and a library function is called on some.

/// Added to a whole number from 0 to 2^51, leaves it as the lowest bits.
const WHOLE: f64 = (1u64 << 52) as f64;

/// The largest whole number that is not above this one, from 0 to 2^51.
#[inline(always)]
pub(crate) fn floor(v: f64) -> f64 {
    let rounded = (v + WHOLE) - WHOLE;
    if rounded > v { rounded - 1.0 } else { rounded }
}

/// The smallest whole number that is not below this one, from 0 to 2^51.
#[inline(always)]
pub(crate) fn ceil(v: f64) -> f64 {
    let rounded = (v + WHOLE) - WHOLE;
    if rounded < v { rounded + 1.0 } else { rounded }
}

/// As [`crate::vision::bits::nearest`], for places less than a million pixels from the picture.
#[inline(always)]
pub(crate) fn nearest(px: f64) -> f64 {
    const ABOVE_ZERO: f64 = (1 << 20) as f64;
    floor(px + (ABOVE_ZERO + 0.5)) - ABOVE_ZERO
}

/// A whole number from 0 to 255.
#[inline(always)]
pub(crate) fn byte(whole: f64) -> u8 {
    (whole + WHOLE).to_bits() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounding_is_that_of_the_library() {
        for k in 0..4000 {
            let v = f64::from(k) / 16.0 + if k % 3 == 0 { 1e-9 } else { 0.0 };
            assert_eq!((floor(v), ceil(v)), (v.floor(), v.ceil()), "{v}");
            assert_eq!(byte(v.floor()), v as u8, "{v}");
            for px in [v, -v, 600.0 * v] {
                assert_eq!(nearest(px), f64::from(crate::vision::bits::nearest(px)), "{px}");
            }
        }
    }
}
