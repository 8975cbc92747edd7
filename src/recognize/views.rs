//! The pictures of a pair as pose estimation reads them.

use arrayvec::ArrayVec;
use nalgebra::{Isometry3, Vector2};

use super::Params;
use crate::frame::{FramePair, LumaView};
use crate::matching::problem::StereoNode;
use crate::picture::Picture;
use crate::pose::gloss::Gloss;
use crate::pose::refine::{self, View};
use crate::pose::section::{CONTRAST_MIN, HALF_WAY, Profiler};
use crate::pose::shading::Shading;
use crate::rig::Rig;
use crate::vision::graph::Graph;

/// Height of the line that is seen of a dark part above its axis, in radii: below it, for each camera sees more of the shadow on
/// its own side of the wire, down on the floor. From -0.2 to -0.5 on rendered floors, the less light comes from all sides.
const DARK_LIFT_RADII: f64 = -0.33;
/// At which level outlines of dark parts are taken, in 1/256 of the way from the floor's light to theirs: nearer to theirs than
/// half way, for shadows lie between.
pub(super) const DARK_OUTLINE_256: u8 = 144;

/// Refinement as the light wants it: dark parts on a light floor are seen whole, and the outline of an end is the rim of its
/// silhouette, 0.93 radii from the axis in the mean over the width that is looked at.
pub(super) fn lit(params: &Params) -> refine::Params {
    if params.binarize.iter().any(|b| b.inverted) {
        refine::Params {
            lift_radii: DARK_LIFT_RADII,
            end_lift_radii: [0.93, -0.93],
            faces_like_wire: true,
            outline_ratio: 1.0,
            shading: Shading { across: 0.1, lift: 0.2, end: 0.08, ..Shading::default() },
            ..params.refine
        }
    } else {
        params.refine
    }
}

/// What the light of a pair does to outlines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Lighting {
    /// At which level they are taken, see [`Profiler::with_outlines_at`].
    pub(super) outline_256: u8,
    /// Where the shadows of dark parts fall, along x and y of the left camera, see [`ShadowSide::radii`](crate::pose::shadow::ShadowSide::radii).
    pub(super) shadow_radii: Vector2<f64>,
}

impl Default for Lighting {
    /// That of dull wire under a lamp above.
    fn default() -> Self {
        Self { outline_256: HALF_WAY, shadow_radii: Vector2::zeros() }
    }
}

/// Depths of nodes of which the median is taken.
const DEPTHS_MAX: usize = 256;

/// At which level outlines are taken, where these nodes may lie: see [`Gloss`]. The same in both pictures, for the same
/// outlines are to be compared.
pub(super) fn outline_256<'a>(
    gloss: &mut Gloss,
    views: &[View; 2],
    graphs: [&Graph; 2],
    nodes: impl Iterator<Item = &'a StereoNode>,
    thinnest_mm: f64,
) -> u8 {
    let mut depths_mm: ArrayVec<f64, DEPTHS_MAX> =
        nodes.map(|node| node.point_mm.z).take(DEPTHS_MAX).collect();
    if depths_mm.is_empty() {
        return HALF_WAY;
    }
    let middle = depths_mm.len() / 2;
    let depth_mm = *depths_mm.select_nth_unstable_by(middle, f64::total_cmp).1;
    let levels = views.iter().zip(graphs).map(|(View { camera, profiler, .. }, graph)| {
        gloss.outline_256(graph, profiler, thinnest_mm * camera.fx / depth_mm)
    });
    levels.fold(HALF_WAY, u8::min)
}

pub(super) fn views<'a>(
    pictures: &'a [Picture; 2],
    rig: &'a Rig,
    pair: &'a FramePair,
    params: &Params,
    Lighting { outline_256, shadow_radii }: Lighting,
) -> Option<[View<'a>; 2]> {
    let view = |side: usize, frame, camera, camera_from_left: Isometry3<f64>| {
        let picture = &pictures[side];
        let luma = LumaView::new(picture.luma(frame))?;
        let rotation = camera_from_left.rotation.to_rotation_matrix().into_inner();
        let is_dark = params.binarize[side].inverted;
        let shadow = is_dark.then(|| (rotation * shadow_radii.push(0.0)).xy());
        Some(View {
            camera,
            rotation,
            camera_from_left,
            profiler: Profiler::new(luma, is_dark, CONTRAST_MIN)
                .with_outlines_at(outline_256)
                .with_shadow(shadow),
            mask: picture.mask(),
        })
    };
    Some([
        view(0, &pair.left, &rig.left, Isometry3::identity())?,
        view(1, &pair.right, &rig.right, rig.right_from_left)?,
    ])
}
