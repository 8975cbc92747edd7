//! Whether a camera sees anything at all: a picture that is white, black or the same all over, or noise and nothing else, is no
//! empty bin.

use std::ops::RangeInclusive;

use crate::frame::Frame;
use crate::recognize::{Refusal, Side};
use crate::vision::bits::BitImage;

/// Luma of a camera that is saturated, and of one that sees no light: no floor is so dark, and no wire would stand out.
const WHITE_LUMA: RangeInclusive<u8> = 250..=255;
const BLACK_LUMA: RangeInclusive<u8> = 0..=8;
/// Luma of what is lit too little to be told from noise, on a floor most of which is black.
const DARK_LUMA: RangeInclusive<u8> = 0..=24;
/// What a picture that is the same all over differs by, in grey levels: by what a decoder rounds.
const FLAT_LEVELS: u8 = 1;
/// So many places are looked at for that, of which so many may be otherwise: one in a hundred.
const PLACES: u32 = 8192;
const OTHERS_MAX: u32 = PLACES / 100;
/// Side of the squares whose means are compared, in pixels, the least number of them, and the most rows of them that are looked at.
const SQUARE_PX: usize = 16;
const SQUARES_MIN: usize = 100;
const ROWS_MAX: usize = 32;
/// Standard deviation of a pixel's luma, as neighbours differ, from which on a picture may be noise.
const NOISE_LUMA_MIN: f64 = 5.0;
/// Of noise the means of squares scatter as their number of pixels says; the smoothing of a camera and JPEG make it up to five
/// times that. In the rendered scenes, empty bins among them, it is 1900 times and more: walls and light are no noise.
const SCATTER_MAX: f64 = 8.0;
/// How many times as much, or as little, pixels of noise differ farther apart than side by side; smoothing makes it more.
const EVENNESS_MAX: f64 = 2.0;
const APART_PX_MAX: usize = 2 * SQUARE_PX;
/// Of the variance of all, what hardly a piece of noise is calmer than, and how many pieces may be.
const CALM: f64 = 0.25;
const CALM_SHARE_MAX: f64 = 0.1;

/// Why the picture shows nothing, if so. `luma` is grey, `mask` what the colours make of it; bright parts alone
/// (`is_bright_on_dark`) are lost in white, dark ones may lie on a floor that is as bright as the camera sees.
pub(super) fn blind(luma: &Frame, mask: &BitImage, is_bright_on_dark: bool, side: Side) -> Option<Refusal> {
    let is_empty = mask.words().iter().all(|&word| word == 0);
    if is_all_of(luma, BLACK_LUMA) && (is_empty || is_black_object(luma, mask)) {
        return Some(Refusal::Black { side });
    }
    match is_empty {
        true if is_all_of(luma, DARK_LUMA) && is_half_of(luma, BLACK_LUMA) => Some(Refusal::Black { side }),
        true if is_bright_on_dark && is_all_of(luma, WHITE_LUMA) => Some(Refusal::White { side }),
        true if is_flat(luma) => Some(Refusal::Flat { side }),
        true if is_noise(luma) => Some(Refusal::Noise { side }),
        _ => None,
    }
}

/// Places all over a picture of this size, in no lattice that anything in it could share: steps of the plastic number's
/// powers, which lie evenly and never fall into step with a period.
fn places(width: usize, height: usize) -> impl Iterator<Item = (usize, usize)> {
    const STEPS: [u32; 2] = [3_242_174_889, 2_447_445_414];
    let along = |step: u32, k: u32, pixels: usize| {
        ((u64::from(step.wrapping_mul(k)) * pixels as u64) >> u32::BITS) as usize
    };
    (0..PLACES).map(move |k| (along(STEPS[0], k, width), along(STEPS[1], k, height)))
}

/// Whether 99 of 100 pixels are as light or dark as that. Of a picture that is not this is known after a few.
fn is_all_of(luma: &Frame, wanted: RangeInclusive<u8>) -> bool {
    others(luma, wanted).nth(OTHERS_MAX as usize).is_none()
}

/// The same of half of them.
fn is_half_of(luma: &Frame, wanted: RangeInclusive<u8>) -> bool {
    others(luma, wanted).nth(PLACES as usize / 2).is_none()
}

/// The luma of the places that are not as light or dark as that.
fn others(luma: &Frame, wanted: RangeInclusive<u8>) -> impl Iterator<Item = u8> {
    let at = places(luma.width, luma.height).map(|(x, y)| luma.bytes[y * luma.stride_bytes + x]);
    at.filter(move |v| !wanted.contains(v))
}

/// Whether 99 of 100 pixels are as light as the one in the middle. A sensor sees no two alike, but where it is saturated.
fn is_flat(luma: &Frame) -> bool {
    let level = luma.bytes[luma.height / 2 * luma.stride_bytes + luma.width / 2];
    let alike = level.saturating_sub(FLAT_LEVELS)..=level.saturating_add(FLAT_LEVELS);
    !WHITE_LUMA.contains(&level) && is_all_of(luma, alike)
}

/// Whether the colours take black itself for parts, and not what little stands out from it.
fn is_black_object(luma: &Frame, mask: &BitImage) -> bool {
    let black = places(luma.width, luma.height).filter(|&(x, y)| {
        mask.get(x as i32, y as i32) && BLACK_LUMA.contains(&luma.bytes[y * luma.stride_bytes + x])
    });
    black.take(OTHERS_MAX as usize + 1).count() > OTHERS_MAX as usize
}

/// Whether each pixel is by itself everywhere, as with the cap on the lens and the gain turned up: nothing is an edge, or lighter
/// than elsewhere, even over whole squares of pixels.
fn is_noise(luma: &Frame) -> bool {
    let (columns, rows) = (luma.width / SQUARE_PX, luma.height / SQUARE_PX);
    if columns * rows < SQUARES_MIN {
        return false;
    }
    let row = |y: usize| &luma.bytes[y * luma.stride_bytes..][..columns * SQUARE_PX];
    let ys = || (0..rows).step_by(rows.div_ceil(ROWS_MAX));
    let count = (columns * ys().len()) as f64;
    // Pixels differ by twice the variance of each; some rows tell.
    let variance_of = |row: &[u8], apart: usize| {
        // No row is longer than 65535 pixels: a sum of so many squares is no more than 32 bits hold.
        let squares = row.iter().zip(&row[apart..]).map(|(a, b)| u32::from(a.abs_diff(*b)).pow(2));
        f64::from(squares.sum::<u32>()) / (2 * (row.len() - apart)) as f64
    };
    let looked_at = || ys().map(|y| row(y * SQUARE_PX));
    let variance_at = |apart| looked_at().map(|row| variance_of(row, apart)).sum::<f64>() / ys().len() as f64;
    let variance = variance_at(1);
    if variance < NOISE_LUMA_MIN * NOISE_LUMA_MIN {
        return false;
    }
    // A grid or a weave comes back after its pitch; of noise pixels farther apart differ no more and no less.
    let is_even = |apart| (1.0 / EVENNESS_MAX..EVENNESS_MAX).contains(&(variance_at(apart) / variance));
    if !(2..=APART_PX_MAX).all(is_even) {
        return false;
    }
    // Noise is everywhere; between thin lines there is none.
    let pieces = looked_at().flat_map(|row| row.chunks_exact(SQUARE_PX));
    let calm = pieces.filter(|piece| variance_of(piece, 1) < CALM * variance).count();
    if calm as f64 > CALM_SHARE_MAX * count {
        return false;
    }
    let (mut sum, mut sum_of_squares) = (0.0, 0.0);
    for y in ys() {
        for x in 0..columns {
            let pixels = (0..SQUARE_PX).flat_map(|i| &row(y * SQUARE_PX + i)[x * SQUARE_PX..][..SQUARE_PX]);
            let mean = f64::from(pixels.map(|&v| u32::from(v)).sum::<u32>()) / (SQUARE_PX * SQUARE_PX) as f64;
            sum += mean;
            sum_of_squares += mean * mean;
        }
    }
    let of_squares = sum_of_squares / count - (sum / count).powi(2);
    of_squares * ((SQUARE_PX * SQUARE_PX) as f64) < SCATTER_MAX * variance
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg32;

    use super::*;
    use crate::vision::luma::LumaPlane;

    const SIZE: [usize; 2] = [640, 480];
    const WHITE: Refusal = Refusal::White { side: Side::Right };
    const BLACK: Refusal = Refusal::Black { side: Side::Right };
    const FLAT: Refusal = Refusal::Flat { side: Side::Right };
    const NOISE: Refusal = Refusal::Noise { side: Side::Right };

    fn grey(mut level: impl FnMut(usize, usize) -> f64) -> Frame {
        let [width, height] = SIZE;
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let bytes = pixels.map(|(x, y)| level(x, y).clamp(0.0, 255.0) as u8).collect();
        Frame::from_grey(width, height, bytes)
    }

    /// About normal: twelve uniform numbers.
    fn normal(random: &mut Pcg32) -> f64 {
        (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0
    }

    #[test]
    fn a_camera_without_a_signal_is_no_empty_bin() {
        for level in [60.0, 128.0, 230.0] {
            let but_a_row = |x: usize, y: usize| if y == 0 { 40.0 } else { level + ((x / 8 + y) % 2) as f64 };
            assert_eq!(seen(&grey(but_a_row)), Some(FLAT), "{level}");
            assert_eq!(seen(&grey(|x, _| level + x as f64 / 100.0)), None, "light falls off");
        }
        let mut random = Pcg32::seed_from_u64(1);
        assert_eq!(seen(&grey(|_, _| 60.0 + 1.5 * normal(&mut random))), None, "a sensor's noise");
    }

    #[test]
    fn parts_lit_too_little_to_be_told_from_noise_are_no_empty_bin() {
        let bin = |floor: f64, wire: f64| grey(move |x, _| if x % 20 < 3 { wire } else { floor });
        assert_eq!(seen(&bin(4.0, 14.0)), Some(BLACK));
        assert_eq!([seen(&bin(4.0, 60.0)), seen(&bin(14.0, 20.0))], [None, None]);
    }

    fn seen(luma: &Frame) -> Option<Refusal> {
        blind(luma, &BitImage::new(SIZE[0], SIZE[1]), true, Side::Right)
    }

    #[test]
    fn random_noise_is_seen_as_such_and_a_floor_with_noise_is_not() {
        let mut random = Pcg32::seed_from_u64(1);
        let noise = |mean: f64, sigma: f64, random: &mut Pcg32| grey(|_, _| mean + sigma * normal(random));
        for (mean, sigma) in [(60.0, 40.0), (100.0, 10.0), (20.0, 30.0)] {
            assert_eq!(seen(&noise(mean, sigma, &mut random)), Some(NOISE), "{mean} {sigma}");
        }
        // What is left of it after a camera's JPEG of middling quality.
        let mut jpeg = Vec::new();
        image::codecs::jpeg::JpegEncoder::new_with_quality(&mut jpeg, 70)
            .encode(&noise(60.0, 40.0, &mut random).bytes, 640, 480, image::ExtendedColorType::L8)
            .unwrap();
        let decoded = image::load_from_memory(&jpeg).unwrap().into_luma8().into_raw();
        assert_eq!(seen(&Frame::from_grey(640, 480, decoded)), Some(NOISE));
        let rgb = (0..640 * 480 * 3).map(|_| random.random::<u8>()).collect();
        let rgb = Frame::from_rgb(640, 480, rgb);
        assert_eq!(seen(LumaPlane::new(640, 480).run(&rgb, rgb.encoding)), Some(NOISE));
        // An even floor with the noise of a good camera, and one with much of it whose light falls off by a fifth.
        assert_eq!(seen(&noise(100.0, 3.0, &mut random)), None);
        let uneven = grey(|x, _| 100.0 * (1.0 - 0.2 * x as f64 / 640.0) + 10.0 * normal(&mut random));
        assert_eq!(seen(&uneven), None);
        let walled = grey(|x, _| if x < 40 { 60.0 } else { 100.0 } + 10.0 * normal(&mut random));
        assert_eq!(seen(&walled), None);
    }

    #[test]
    fn a_grid_of_any_pitch_is_neither_white_nor_black_all_over() {
        for pitch in 2..50 {
            let on_grid = |x: usize, y: usize| x.is_multiple_of(pitch) || y.is_multiple_of(pitch);
            let on_slope = |x: usize, y: usize| (x + y).is_multiple_of(pitch);
            for line in [255.0, 0.0] {
                assert_eq!(
                    seen(&grey(|x, y| if on_slope(x, y) { line } else { 255.0 - line })),
                    None,
                    "{pitch}"
                );
                assert_eq!(
                    seen(&grey(|x, y| if on_grid(x, y) { line } else { 255.0 - line })),
                    None,
                    "{pitch}"
                );
            }
        }
        assert_eq!(seen(&grey(|x, y| if x == y { 0.0 } else { 253.0 })), Some(WHITE));
        assert_eq!(seen(&grey(|x, y| if x == y { 99.0 } else { ((x * y) % 4) as f64 })), Some(BLACK));
    }

    #[test]
    fn black_is_no_bin_whatever_the_colours_make_of_it() {
        let [width, height] = SIZE;
        let (mut all, empty) = (BitImage::new(width, height), BitImage::new(width, height));
        (0..height).for_each(|y| (0..width).for_each(|x| all.set(x, y, true)));
        for is_bright_on_dark in [false, true] {
            for mask in [&all, &empty] {
                assert_eq!(blind(&grey(|_, _| 3.0), mask, is_bright_on_dark, Side::Right), Some(BLACK));
            }
        }
        // A bright rod on black velvet, less than a hundredth of the picture.
        let is_rod = |x: usize, y: usize| (200..300).contains(&x) && (100..105).contains(&y);
        let mut rod = BitImage::new(width, height);
        (100..105).for_each(|y| (200..300).for_each(|x| rod.set(x, y, true)));
        assert_eq!(
            blind(&grey(|x, y| if is_rod(x, y) { 180.0 } else { 2.0 }), &rod, true, Side::Right),
            None
        );
        // Dark parts: a floor in full light may be white.
        assert_eq!(blind(&grey(|_, _| 255.0), &empty, false, Side::Right), None);
    }
}
