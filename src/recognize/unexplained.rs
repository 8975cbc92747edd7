//! Which wire no part explains yet.

use nalgebra::Vector2;

use crate::matching::claims::ClaimMap;
use crate::picture::Picture;
use crate::vision::ridge;

/// Length of the skeleton that no part claims, in pixels; `area` becomes where it is.
pub(super) fn unexplained_px(
    picture: &Picture,
    claims: &ClaimMap,
    half_px: f64,
    area: &mut ridge::Area,
) -> f64 {
    area.clear();
    let margin_px = (MARGIN_HALF_WIDTHS * half_px) as usize;
    let mut count = 0u32;
    for &[x, y] in &picture.graph().points {
        if !claims.is_claimed_by_any([x, y]) {
            count += 1;
            if !count.is_multiple_of(AREA_STRIDE) {
                continue;
            }
            // The mask reaches about half a wire farther than its skeleton, and what is put back there.
            area.include(x.into(), y.into(), margin_px);
        }
    }
    f64::from(count)
}

/// How far from the skeleton ridges are looked for: of two wires that touch each is one half width away, of three two;
/// and around which of its pixels.
const MARGIN_HALF_WIDTHS: f64 = 4.0;
const AREA_STRIDE: u32 = 4;

/// Whether most of a stretch is claimed.
pub(super) fn is_claimed(claims: &ClaimMap, stretch: &ridge::Stretch) -> bool {
    let [from, to] = stretch.ends_px;
    let Some(along) = (to - from).try_normalize(1e-9) else { return true };
    let across = Vector2::new(-along.y, along.x);
    let claimed =
        (0..=8).filter(|&k| claims.is_claimed_at(&(from + (to - from) * (k as f64 / 8.0)), &across));
    claimed.count() > 6
}
