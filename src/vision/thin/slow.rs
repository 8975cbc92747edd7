//! The slow, obvious twin of the fast thinning: one pixel at a time, as the articles print it. Tests hold the
//! fast one against it.

use super::Algorithm;
use crate::vision::bits::BitImage;

/// Thins a picture pixel by pixel; same result as [`super::Thin::run`].
///
/// The names are the articles': `p2` is the pixel above, then clockwise to `p9`, above on the left. The outermost
/// pixels of the picture are never deleted, but count as neighbours.
pub(super) fn thin_slowly(algorithm: Algorithm, mask: &BitImage) -> BitImage {
    let mut picture = mask.clone();
    loop {
        let mut changed = false;
        for subiteration in 0..2 {
            let before = picture.clone();
            for y in 1..before.height().saturating_sub(1) {
                for x in 1..before.width().saturating_sub(1) {
                    let ring = neighbours(&before, x as i32, y as i32);
                    let delete = match algorithm {
                        Algorithm::ZhangSuen => zhang_suen_deletes(ring, subiteration),
                        Algorithm::GuoHall => guo_hall_deletes(ring, subiteration),
                    };
                    if delete && before.get(x as i32, y as i32) {
                        picture.set(x, y, false);
                        changed = true;
                    }
                }
            }
        }
        if !changed {
            return picture;
        }
    }
}

/// p2 to p9.
fn neighbours(picture: &BitImage, x: i32, y: i32) -> [bool; 8] {
    [(0, -1), (1, -1), (1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1)]
        .map(|(dx, dy)| picture.get(x + dx, y + dy))
}

fn zhang_suen_deletes(ring: [bool; 8], subiteration: usize) -> bool {
    let [p2, _, p4, _, p6, _, p8, _] = ring;
    let b = ring.iter().filter(|&&p| p).count();
    let a = (0..8).filter(|&i| !ring[i] && ring[(i + 1) % 8]).count();
    let (m1, m2) =
        if subiteration == 0 { (p2 && p4 && p6, p4 && p6 && p8) } else { (p2 && p4 && p8, p2 && p6 && p8) };
    a == 1 && (2..=6).contains(&b) && !m1 && !m2
}

fn guo_hall_deletes(ring: [bool; 8], subiteration: usize) -> bool {
    let [p2, p3, p4, p5, p6, p7, p8, p9] = ring;
    let sum = |terms: [bool; 4]| terms.iter().filter(|&&t| t).count();
    let c = sum([!p2 && (p3 || p4), !p4 && (p5 || p6), !p6 && (p7 || p8), !p8 && (p9 || p2)]);
    let n1 = sum([p9 || p2, p3 || p4, p5 || p6, p7 || p8]);
    let n2 = sum([p2 || p3, p4 || p5, p6 || p7, p8 || p9]);
    let m = if subiteration == 0 { (p6 || p7 || !p9) && p8 } else { (p2 || p3 || !p5) && p4 };
    c == 1 && (2..=3).contains(&n1.min(n2)) && !m
}
