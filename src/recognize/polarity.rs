//! Whether parts are darker than what is around them.
//!
//! A threshold that is found looks for the one or the other as it is told. A range of colours may be the parts' or, inverted, the
//! floor's, and tells nothing about which is darker: the pictures do.

use nalgebra::Vector2;

use crate::frame::{FramePair, LumaView};
use crate::picture::Picture;
use crate::pose::section::CONTRAST_MIN;
use crate::vision::binarize::ColourRange;
use crate::vision::bits::{nearest, vector};

/// Places along the skeleton that are asked, and over how many of its pixels to either side its direction is taken there.
const STRIDE: usize = 5;
const ARM: usize = 4;
/// How far beside the mask the floor is looked at, in pixels: behind what lens and JPEG blur.
const BESIDE_PX: f64 = 3.0;
/// Places on wire whose luma counts as one, in half widths from its middle: glossy dark wire has a bright line there.
const INSIDE: [f64; 3] = [-0.6, 0.0, 0.6];
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
    let graph = picture.graph();
    let luma_at = |x: f64, y: f64| {
        let (x, y) = (usize::try_from(nearest(x)).ok()?, usize::try_from(nearest(y)).ok()?);
        (x < luma.width() && y < luma.height()).then(|| f64::from(luma.at(x, y)))
    };
    graph.edges.iter().flat_map(move |edge| {
        let (chain, half_px) = (graph.edge_points(edge), f64::from(edge.half_thickness_px));
        let places = (ARM..chain.len().saturating_sub(ARM)).step_by(STRIDE);
        places.flat_map(move |i| {
            let along = vector(chain[i + ARM]) - vector(chain[i - ARM]);
            let across = Vector2::new(-along.y, along.x).normalize();
            let at = move |px: f64| vector(chain[i]) + across * px;
            let inside = INSIDE.map(|share| at(share * half_px)).map(|px| luma_at(px.x, px.y));
            [-1.0, 1.0].into_iter().filter_map(move |side| {
                let beside = at(side * (half_px + BESIDE_PX));
                let floor = luma_at(beside.x, beside.y)
                    .filter(|_| !picture.mask().get(nearest(beside.x), nearest(beside.y)))?;
                let [a, b, c] = inside;
                Some((a? + b? + c?) / INSIDE.len() as f64 - floor)
            })
        })
    })
}
