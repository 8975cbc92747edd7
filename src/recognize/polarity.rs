//! Whether parts are darker than what is around them.
//!
//! A threshold that is found looks for the one or the other as it is told. A range of colours may be the parts' or, inverted, the
//! floor's, and tells nothing about which is darker: the pictures do.

use nalgebra::Vector2;

use crate::frame::{FramePair, LumaView};
use crate::picture::Picture;
use crate::pose::section::CONTRAST_MIN;
use crate::vision::beside::{Beside, beside};
use crate::vision::binarize::ColourRange;
use crate::vision::bits::nearest;

/// So many places at least, and so many times as many as say otherwise, tell.
const PLACES_MIN: usize = 12;
const MAJORITY: usize = 2;

/// Whether the parts are darker than the floor; where the pictures do not tell, as the colours were given.
pub(super) fn parts_are_dark(pictures: &[Picture; 2], pair: &FramePair) -> bool {
    let range = pictures[0].range();
    if range.colour == ColourRange::Auto {
        return range.inverted;
    }
    let [mut darker, mut brighter] = [0, 0];
    for (picture, frame) in pictures.iter().zip([&pair.left, &pair.right]) {
        let Some(luma) = LumaView::new(picture.luma(frame)) else { continue };
        for contrast in contrasts(picture, &luma) {
            darker += usize::from(contrast <= -CONTRAST_MIN);
            brighter += usize::from(contrast >= CONTRAST_MIN);
        }
    }
    match (darker, brighter) {
        (most, few) if most >= PLACES_MIN.max(MAJORITY * few) => true,
        (few, most) if most >= PLACES_MIN.max(MAJORITY * few) => false,
        _ => range.inverted,
    }
}

/// By how many grey levels wire is brighter than the floor on either side of it, all along the skeleton.
fn contrasts<'a>(picture: &'a Picture, luma: &'a LumaView) -> impl Iterator<Item = f64> + 'a {
    let luma_at = |px: Vector2<f64>| {
        let (x, y) = (usize::try_from(nearest(px.x)).ok()?, usize::try_from(nearest(px.y)).ok()?);
        (x < luma.width() && y < luma.height()).then(|| f64::from(luma.at(x, y)))
    };
    beside(picture.graph(), picture.mask()).filter_map(move |Beside { wire_px, floor_px }| {
        let [a, b, c] = wire_px.map(luma_at);
        Some((a? + b? + c?) / 3.0 - luma_at(floor_px)?)
    })
}
