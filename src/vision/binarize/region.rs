//! The region of interest: a polygon to a bit mask.

use super::ParamsError;
use crate::vision::bits::BitImage;

/// The pixels whose centres are inside the polygon.
///
/// # Errors
/// Fewer than 3 corners, a corner outside the picture, sides that cross, nothing inside.
pub(super) fn mask(polygon: &[[f32; 2]], width: usize, height: usize) -> Result<BitImage, ParamsError> {
    let corners = polygon.len();
    if corners < 3 {
        return Err(ParamsError::RegionCorners { corners });
    }
    for (index, &[x, y]) in polygon.iter().enumerate() {
        let inside = (0.0..=width as f32).contains(&x) && (0.0..=height as f32).contains(&y);
        if !inside {
            return Err(ParamsError::RegionOutside { index, x, y, width, height });
        }
    }
    check_crossings(polygon)?;
    let mut image = BitImage::new(width, height);
    let mut crossings = Vec::with_capacity(corners);
    for y in 0..height {
        crossings.clear();
        crossings
            .extend((0..corners).filter_map(|i| crossing(polygon[i], polygon[(i + 1) % corners], y as f32)));
        crossings.sort_by(f32::total_cmp);
        for pair in crossings.chunks_exact(2) {
            let first = pair[0].ceil().max(0.0) as usize;
            let last = pair[1].floor().min(width as f32 - 1.0);
            if last >= 0.0 {
                (first..=last as usize).for_each(|x| image.set(x, y, true));
            }
        }
    }
    if image.count() == 0 || area(polygon) < 1.0 {
        return Err(ParamsError::RegionEmpty { corners });
    }
    Ok(image)
}

/// Where the side from `a` to `b` crosses row `y`; the upper end belongs to a side, the lower one does not.
fn crossing(a: [f32; 2], b: [f32; 2], y: f32) -> Option<f32> {
    let (upper, lower) = if a[1] <= b[1] { (a, b) } else { (b, a) };
    (upper[1] <= y && y < lower[1])
        .then(|| upper[0] + (y - upper[1]) / (lower[1] - upper[1]) * (lower[0] - upper[0]))
}

/// Area in square pixels (shoelace formula).
fn area(polygon: &[[f32; 2]]) -> f64 {
    let next = polygon.iter().cycle().skip(1);
    let cross = |(a, b): (&[f32; 2], &[f32; 2])| {
        f64::from(a[0]) * f64::from(b[1]) - f64::from(b[0]) * f64::from(a[1])
    };
    polygon.iter().zip(next).map(cross).sum::<f64>().abs() / 2.0
}

fn check_crossings(polygon: &[[f32; 2]]) -> Result<(), ParamsError> {
    let n = polygon.len();
    let side = |i: usize| (polygon[i], polygon[(i + 1) % n]);
    for first in 0..n {
        for second in first + 2..n {
            if (second + 1) % n != first && cross(side(first), side(second)) {
                return Err(ParamsError::RegionCrosses { first, second });
            }
        }
    }
    Ok(())
}

/// Whether two segments properly cross.
fn cross((a, b): ([f32; 2], [f32; 2]), (c, d): ([f32; 2], [f32; 2])) -> bool {
    let turn = |p: [f32; 2], q: [f32; 2], r: [f32; 2]| {
        let [px, py, qx, qy, rx, ry] = [p[0], p[1], q[0], q[1], r[0], r[1]].map(f64::from);
        ((qx - px) * (ry - py) - (qy - py) * (rx - px)).partial_cmp(&0.0)
    };
    let opposite = |s, t| {
        use std::cmp::Ordering::{Greater, Less};
        matches!((s, t), (Some(Less), Some(Greater)) | (Some(Greater), Some(Less)))
    };
    opposite(turn(a, b, c), turn(a, b, d)) && opposite(turn(c, d, a), turn(c, d, b))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn centres_inside_the_polygon_are_in_the_mask() {
        let m = mask(&[[1.0, 1.0], [4.0, 1.0], [4.0, 3.0], [1.0, 3.0]], 6, 4).expect("a rectangle");
        assert_eq!(m.to_text(), "......\n.####.\n.####.\n......\n");
        let all =
            mask(&[[0.0, 0.0], [70.0, 0.0], [70.0, 3.0], [0.0, 3.0]], 70, 3).expect("the whole picture");
        assert_eq!(all.count(), 210);
    }

    #[test]
    fn unusable_polygons_are_named() {
        let message = |p: &[[f32; 2]]| mask(p, 8, 8).expect_err("unusable").to_string();
        assert!(message(&[[0.0, 0.0], [1.0, 1.0]]).contains("2 corner(s); give at least 3"));
        assert!(
            message(&[[0.0, 0.0], [9.0, 1.0], [2.0, 2.0]])
                .contains("corner 1 is (9, 1), outside the 8x8 picture")
        );
        assert!(message(&[[0.0, f32::NAN], [3.0, 1.0], [2.0, 2.0]]).contains("corner 0 is (0, NaN)"));
        let bow = [[0.0, 0.0], [4.0, 4.0], [4.0, 0.0], [0.0, 4.0]];
        assert!(message(&bow).contains("after corner 0 and after corner 2 cross"));
        assert!(message(&[[0.0, 0.0], [4.0, 4.0], [2.0, 2.0]]).contains("has no area"));
    }
}
