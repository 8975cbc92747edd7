//! The pictures of a pair as pose estimation reads them.

use nalgebra::Isometry3;

use super::Params;
use crate::frame::{FramePair, LumaView};
use crate::picture::Picture;
use crate::pose::refine::{self, View};
use crate::pose::section::Profiler;
use crate::pose::shading::Shading;
use crate::rig::Rig;

/// Refinement as the light wants it: dark parts on a light floor are seen whole, so that the middle
/// between their outlines is their axis, and the outline of an end is the rim of its silhouette, 0.93 radii from the axis
/// in the mean over the width that is looked at.
pub(super) fn lit(params: &Params) -> refine::Params {
    if params.binarize.iter().any(|b| b.inverted) {
        refine::Params {
            lift_radii: 0.0,
            end_lift_radii: [0.93, -0.93],
            faces_like_wire: true,
            outline_ratio: 1.0,
            shading: Shading {
                across: 0.04,
                across_per_skew: 0.0,
                lift: 0.2,
                end: 0.08,
                ..Shading::default()
            },
            ..params.refine
        }
    } else {
        params.refine
    }
}

pub(super) fn views<'a>(
    pictures: &'a [Picture; 2],
    rig: &'a Rig,
    pair: &'a FramePair,
    params: &Params,
) -> Option<[View<'a>; 2]> {
    let view = |picture: &'a Picture, frame, camera, camera_from_left: Isometry3<f64>, inverted| {
        Some(View {
            camera,
            rotation: camera_from_left.rotation.to_rotation_matrix().into_inner(),
            camera_from_left,
            profiler: Profiler::new(LumaView::new(picture.luma(frame))?, inverted, CONTRAST_MIN),
            mask: picture.mask(),
        })
    };
    Some([
        view(&pictures[0], &pair.left, &rig.left, Isometry3::identity(), params.binarize[0].inverted)?,
        view(&pictures[1], &pair.right, &rig.right, rig.right_from_left, params.binarize[1].inverted)?,
    ])
}

/// Grey levels between wire and background from which an outline is believed.
const CONTRAST_MIN: f64 = 12.0;
