//! A picture at half its size, for wire that is many pixels thick.
//!
//! A pixel of the half is four of the whole. What wire is told by, its skeleton, its ends and its outlines, is found to a
//! share of a pixel in either; the half has a quarter of the work, and skeletons that stray half as far where wires
//! meet. Pixel centres are at whole numbers: `x` of the whole is `(x - 0.5) / 2` of the half, and so is the camera's
//! principal point, see [`CameraModel::halved`](crate::rig::CameraModel::halved).
//!
//! ```
//! use pickcell::vision::bits::BitImage;
//! use pickcell::vision::halve::{halve_mask, thickness_px};
//!
//! // A level wire, 12 pixels thick.
//! let mut mask = BitImage::new(200, 100);
//! for (x, y) in (0..200).flat_map(|x| (40..52).map(move |y| (x, y))) {
//!     mask.set(x, y, true);
//! }
//! assert!((thickness_px(&mask) - 12.0).abs() < 0.1);
//! let mut half = BitImage::new(100, 50);
//! halve_mask(&mask, &mut half);
//! assert!((20..26).all(|y| half.get(50, y)) && !half.get(50, 19) && !half.get(50, 26));
//! ```

use nalgebra::Vector2;

use crate::frame::Frame;
use crate::level::Level;
use crate::vision::bits::{BitImage, PAD_ROWS};

/// Mean thickness of what a mask shows, taken for wire, in pixels; 0 where there is nothing. Wire that crosses or
/// touches makes it more, by about a tenth where wires lie in all directions.
pub fn thickness_px(mask: &BitImage) -> f64 {
    thickness_with(Level::detect(), mask)
}

fn thickness_with(level: Level, mask: &BitImage) -> f64 {
    match level {
        // SAFETY: `Level::detect` and `Level::available` name only what the machine has, and POPCNT is of it.
        #[cfg(target_arch = "x86_64")]
        Level::Avx512 | Level::Avx2 => unsafe { thickness_popcnt(mask) },
        _ => thickness(mask),
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "popcnt")]
fn thickness_popcnt(mask: &BitImage) -> f64 {
    thickness(mask)
}

#[inline(always)]
fn thickness(mask: &BitImage) -> f64 {
    let (mut area, mut beside, mut above) = (0u32, 0u32, 0u32);
    for s in 0..mask.strips() {
        let before = s.checked_sub(1).map(|before| mask.strip(before));
        let mut higher = 0;
        for (y, &word) in mask.strip(s).iter().enumerate() {
            if word != 0 {
                let carried = before.map_or(0, |before| before[y] >> 63);
                area += word.count_ones();
                beside += (word & !(word << 1 | carried)).count_ones();
                above += (word & !higher).count_ones();
            }
            higher = word;
        }
    }
    // Wire of one direction has a border pixel to its left for each pixel that it rises, one above for each that it
    // goes aside.
    f64::from(area) / f64::from(beside).hypot(above.into()).max(1.0)
}

/// Makes `half`, of half the size of `mask`: object where two or more of four pixels are.
///
/// # Panics
/// Where `half` is not half as wide and high, rounded down.
pub fn halve_mask(mask: &BitImage, half: &mut BitImage) {
    assert_eq!((half.width(), half.height()), (mask.width() / 2, mask.height() / 2), "half the size");
    let rows = half.height();
    for s in 0..half.strips() {
        let exists = half.strip_mask(s);
        let (low, high) = (mask.strip(2 * s), (2 * s + 1 < mask.strips()).then(|| mask.strip(2 * s + 1)));
        let begin = s * half.strip_stride() + PAD_ROWS;
        for (y, word) in half.words_mut()[begin..begin + rows].iter_mut().enumerate() {
            let two_rows = |strip: &[u64]| two_of_four(strip[2 * y], strip[2 * y + 1]);
            *word = (two_rows(low) | high.map_or(0, two_rows) << 32) & exists;
        }
    }
}

/// For each pair of columns of two rows, whether two or more of its four bits are set, 32 pairs in the lower half.
fn two_of_four(upper: u64, lower: u64) -> u64 {
    let (upper_right, lower_right) = (upper >> 1, lower >> 1);
    let either = (upper | upper_right) & (lower | lower_right);
    even_bits(upper & upper_right | lower & lower_right | either)
}

/// The bits of even numbers, side by side in the lower half.
fn even_bits(mut word: u64) -> u64 {
    word &= 0x5555_5555_5555_5555;
    for (shift, kept) in [
        (1, 0x3333_3333_3333_3333),
        (2, 0x0f0f_0f0f_0f0f_0f0f),
        (4, 0x00ff_00ff_00ff_00ff),
        (8, 0x0000_ffff_0000_ffff),
        (16, 0x0000_0000_ffff_ffff),
    ] {
        word = (word | word >> shift) & kept;
    }
    word
}

/// Makes `half`, of half the size of `luma`: means of four pixels. Both are grey.
///
/// # Panics
/// Where `half` is not half as wide and high, rounded down, or a frame is shorter than its size says.
pub fn halve_luma(luma: &Frame, half: &mut Frame) {
    assert_eq!((half.width, half.height), (luma.width / 2, luma.height / 2), "half the size");
    let row = |y: usize| &luma.bytes[y * luma.stride_bytes..][..2 * half.width];
    for (y, into) in half.bytes.chunks_mut(half.stride_bytes.max(1)).take(half.height).enumerate() {
        let upper = row(2 * y).chunks_exact(2);
        let lower = row(2 * y + 1).chunks_exact(2);
        for (mean, (upper, lower)) in into.iter_mut().zip(upper.zip(lower)) {
            let sum = |two: &[u8]| u16::from(two[0]) + u16::from(two[1]);
            *mean = ((sum(upper) + sum(lower) + 2) >> 2) as u8;
        }
    }
}

/// A place of a picture that was halved so many times in the whole.
pub fn in_whole(half_px: Vector2<f64>, times: usize) -> Vector2<f64> {
    (0..times).fold(half_px, |px, _| px.map(|px| 2.0 * px + 0.5))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::CameraModel;
    use nalgebra::Point3;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_pixel_of_the_half_is_what_two_of_its_four_are(
            (width, height) in (2usize..200, 2usize..20),
            seed in any::<u64>(),
        ) {
            let mut mask = BitImage::new(width, height);
            let mut state = seed | 1;
            for (x, y) in (0..width).flat_map(|x| (0..height).map(move |y| (x, y))) {
                state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                mask.set(x, y, state >> 62 & 1 == 1);
            }
            let mut half = BitImage::new(width / 2, height / 2);
            half.words_mut().fill(0);
            halve_mask(&mask, &mut half);
            for (x, y) in (0..width / 2).flat_map(|x| (0..height / 2).map(move |y| (x, y))) {
                let four = [(0, 0), (1, 0), (0, 1), (1, 1)];
                let set = four.iter().filter(|(i, j)| mask.get((2 * x + i) as i32, (2 * y + j) as i32));
                prop_assert_eq!(half.get(x as i32, y as i32), set.count() >= 2, "{} {}", x, y);
            }
            let beyond = half.strip_mask(half.strips() - 1);
            prop_assert!(half.strip(half.strips() - 1).iter().all(|word| word & !beyond == 0));
        }
    }

    #[test]
    fn slanting_wire_is_as_thick_as_it_is() {
        for angle_deg in [0.0f64, 20.0, 45.0, 70.0, 90.0] {
            let (sin, cos) = angle_deg.to_radians().sin_cos();
            let mut mask = BitImage::new(400, 400);
            for (x, y) in (0..400).flat_map(|x| (0..400).map(move |y| (x, y))) {
                let (dx, dy) = (x as f64 - 200.0, y as f64 - 200.0);
                if (dx * cos + dy * sin).abs() < 150.0 && (dy * cos - dx * sin).abs() < 8.0 {
                    mask.set(x, y, true);
                }
            }
            let thickness = thickness_px(&mask);
            assert!((thickness - 16.0).abs() < 1.5, "{angle_deg} degrees: {thickness}");
            assert!(Level::available().iter().all(|level| thickness_with(*level, &mask) == thickness));
        }
        assert_eq!(thickness_px(&BitImage::new(64, 64)), 0.0);
    }

    #[test]
    fn light_is_the_mean_of_four_and_a_place_is_found_again() {
        let luma = Frame::from_grey(5, 3, vec![0, 1, 254, 255, 9, 2, 3, 255, 255, 9, 9, 9, 9, 9, 9]);
        let mut half = Frame::from_grey(2, 1, vec![0; 2]);
        halve_luma(&luma, &mut half);
        assert_eq!(half.bytes, [2, 255]);
        let camera = CameraModel::pinhole(640, 480, 600.0, 320.0, 240.0);
        let point = Point3::new(10.0, -7.0, 500.0);
        let quarter = camera.halved().halved().project(&point).unwrap();
        assert!((in_whole(quarter, 2) - camera.project(&point).unwrap()).norm() < 1e-9);
    }
}
