//! Looks at evenly spaced pixels of a curve in a binary picture: what most of a fitness costs.
//!
//! The AVX-512 version looks at sixteen pixels at once and makes the same sums in the same order as the plain one, so
//! both find the same; a test compares them.

use crate::level::Level;
use crate::vision::bits::BitImage;
#[cfg(target_arch = "x86_64")]
use crate::vision::bits::PAD_ROWS;

/// The parabola from one point of a picture through a middle to another, in pixels: `c[0] + s (c[1] + s c[2])` for x and
/// for y, with s from -1 to 1. The other way round it is the same to the last bit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parabola([[f32; 3]; 2]);

/// Moved up by so much, cutting off the decimals rounds to the nearest pixel left of and above the picture too.
const UP: f32 = 1024.5;

impl Parabola {
    /// Through three points.
    #[inline]
    pub fn new(from: [f32; 2], middle: [f32; 2], to: [f32; 2]) -> Self {
        Self([0, 1].map(|k| {
            let bend = (from[k] + to[k]) * 0.5 - middle[k];
            [middle[k] + UP, (to[k] - from[k]) * 0.5, bend]
        }))
    }

    /// The point at `s`, moved by [`UP`].
    #[inline]
    fn moved_up(&self, s: f32) -> [f32; 2] {
        self.0.map(|[c0, c1, c2]| c0 + s * (c1 + s * c2))
    }

    /// The point at `s`, -1 to 1.
    #[cfg(test)]
    pub(super) fn at(&self, s: f32) -> [f32; 2] {
        self.moved_up(s).map(|v| v - UP)
    }
}

/// Background among `looks` evenly spaced pixels of a curve; once they are more than `enough`, how many more does not
/// matter.
#[inline]
pub fn missing_on(level: Level, mask: &BitImage, curve: &Parabola, looks: u32, enough: u32) -> u32 {
    #[cfg(target_arch = "x86_64")]
    if level.supported() == Level::Avx512 {
        // SAFETY: the machine has AVX-512.
        return unsafe { missing_avx512(mask, curve, looks, enough) };
    }
    let _ = level;
    missing_plain(mask, curve, looks, enough)
}

fn missing_plain(mask: &BitImage, curve: &Parabola, looks: u32, enough: u32) -> u32 {
    /// Looks that are skipped at first: between nodes that nothing joins most is background, wherever one looks.
    const STRIDE: u32 = 8;
    let step = 1.0 / looks as f32;
    let mut missing = 0;
    for first in 0..STRIDE.min(looks) {
        for k in (first..looks).step_by(STRIDE as usize) {
            let s = (2 * k as i32 + 1 - looks as i32) as f32 * step;
            let [x, y] = curve.moved_up(s);
            // Far away is outside, also where the subtraction wraps.
            missing += !mask.get((x as i32).wrapping_sub(1024), (y as i32).wrapping_sub(1024)) as u32;
        }
        if missing > enough {
            break;
        }
    }
    missing
}

/// # Safety
/// The processor has AVX-512 F and POPCNT.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,popcnt")]
unsafe fn missing_avx512(mask: &BitImage, curve: &Parabola, looks: u32, enough: u32) -> u32 {
    use std::arch::x86_64::*;
    let Parabola([[x0, x1, x2], [y0, y1, y2]]) = *curve;
    let (x0, x1, x2) = (_mm512_set1_ps(x0), _mm512_set1_ps(x1), _mm512_set1_ps(x2));
    let (y0, y1, y2) = (_mm512_set1_ps(y0), _mm512_set1_ps(y1), _mm512_set1_ps(y2));
    let step = _mm512_set1_ps(1.0 / looks as f32);
    let (width, height) = (_mm512_set1_epi32(mask.width() as i32), _mm512_set1_epi32(mask.height() as i32));
    let (stride, up) = (_mm512_set1_epi32(mask.strip_stride() as i32), _mm512_set1_epi32(1024));
    let one = _mm512_set1_epi32(1);
    let steps = _mm512_setr_epi32(0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30);
    let mut missing = 0;
    for first in (0..looks).step_by(16) {
        let k = _mm512_add_epi32(steps, _mm512_set1_epi32(2 * first as i32 + 1 - looks as i32));
        let s = _mm512_mul_ps(_mm512_cvtepi32_ps(k), step);
        let x = _mm512_add_ps(x0, _mm512_mul_ps(s, _mm512_add_ps(x1, _mm512_mul_ps(s, x2))));
        let y = _mm512_add_ps(y0, _mm512_mul_ps(s, _mm512_add_ps(y1, _mm512_mul_ps(s, y2))));
        // What no integer holds becomes the least one, less 1024 a large one: outside, as it is with `as`.
        let x = _mm512_sub_epi32(_mm512_cvttps_epi32(x), up);
        let y = _mm512_sub_epi32(_mm512_cvttps_epi32(y), up);
        let wanted = if looks - first < 16 { (1u16 << (looks - first)) - 1 } else { u16::MAX };
        let inside = _mm512_mask_cmplt_epu32_mask(_mm512_cmplt_epu32_mask(x, width), y, height) & wanted;
        // A word of 64 pixels is two of 32, the lower first.
        let row = _mm512_add_epi32(
            _mm512_mullo_epi32(_mm512_srli_epi32::<6>(x), stride),
            _mm512_add_epi32(y, _mm512_set1_epi32(PAD_ROWS as i32)),
        );
        let half = _mm512_and_epi32(_mm512_srli_epi32::<5>(x), one);
        let at = _mm512_add_epi32(_mm512_slli_epi32::<1>(row), half);
        // SAFETY: only pixels inside of the picture are read; the picture holds a word for each.
        let words = unsafe {
            _mm512_mask_i32gather_epi32::<4>(_mm512_setzero_si512(), inside, at, mask.words().as_ptr().cast())
        };
        let bit = _mm512_sllv_epi32(one, _mm512_and_epi32(x, _mm512_set1_epi32(31)));
        missing += (wanted & !_mm512_test_epi32_mask(words, bit)).count_ones();
        if missing > enough {
            break;
        }
    }
    missing
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn point() -> impl Strategy<Value = [f32; 2]> {
        let near = prop::array::uniform2(-40f32..240.0);
        let far =
            prop::array::uniform2(prop::sample::select(vec![f32::NAN, f32::INFINITY, -1e30, 1e30, 3e9, 0.0]));
        prop_oneof![8 => near, 1 => far]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(256))]
        #[test]
        fn every_level_sees_the_same_pixels(
            [from, middle, to] in prop::array::uniform3(point()),
            straight in any::<bool>(),
            looks in 1u32..=64,
            seed in any::<u64>(),
        ) {
            let mut mask = BitImage::new(199, 150);
            for y in 0..150 {
                for x in 0..199 {
                    let hash = (x as u64 / 5 + 1000 * (y as u64 / 4)).wrapping_mul(seed | 1);
                    mask.set(x, y, hash >> 60 & 1 == 1);
                }
            }
            let middle = if straight { [0, 1].map(|k| (from[k] + to[k]) / 2.0) } else { middle };
            let curve = Parabola::new(from, middle, to);
            let plain = missing_plain(&mask, &curve, looks, u32::MAX);
            prop_assert!(plain <= looks);
            let back = Parabola::new(to, middle, from);
            prop_assert_eq!(missing_plain(&mask, &back, looks, u32::MAX), plain);
            for level in Level::available() {
                prop_assert_eq!(missing_on(*level, &mask, &curve, looks, u32::MAX), plain);
                prop_assert_eq!(missing_on(*level, &mask, &curve, looks, 3) > 3, plain > 3);
            }
        }
    }

    #[test]
    fn background_and_what_is_outside_is_missing() {
        let mut mask = BitImage::new(80, 8);
        (0..40).for_each(|x| mask.set(x, 4, true));
        let along = Parabola::new([-40.0, 4.0], [20.0, 4.0], [80.0, 4.0]);
        for level in Level::available() {
            // a third lies left of the picture, a third on the wire
            assert_eq!(missing_on(*level, &mask, &along, 60, u32::MAX), 40, "{level:?}");
        }
    }
}
