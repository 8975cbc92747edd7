//! The pictures of a pair as pose estimation reads them.

use nalgebra::Isometry3;

use super::lighting::Lighting;
use crate::frame::{FramePair, LumaView};
use crate::picture::Picture;
use crate::pose::refine::{self, View};
use crate::pose::section::{CONTRAST_MIN, Profiler};
use crate::pose::shading::Shading;
use crate::rig::Rig;

/// Height of the line that is seen of a dark part above its axis, in radii: below it, for each camera sees more of the shadow on
/// its own side of the wire, down on the floor. From -0.2 to -0.5 on rendered floors, the less light comes from all sides.
const DARK_LIFT_RADII: f64 = -0.33;

/// Refinement as the light wants it: dark parts on a light floor are seen whole, and the outline of an end is the rim of its
/// silhouette, 0.93 radii from the axis in the mean over the width that is looked at.
pub(super) fn lit(params: refine::Params, lighting: Lighting) -> refine::Params {
    let lit = if lighting.dark {
        refine::Params {
            lift_radii: DARK_LIFT_RADII,
            end_lift_radii: [0.93, -0.93],
            faces_like_wire: true,
            outline_ratio: 1.0,
            shading: Shading { across: 0.1, lift: 0.2, end: 0.08, ..Shading::default() },
            ..params
        }
    } else {
        params
    };
    refine::Params { shading: lit.shading.times(lighting.displaced_times), ..lit }
}

pub(super) fn views<'a>(
    pictures: &'a [Picture; 2],
    rig: &'a Rig,
    pair: &'a FramePair,
    lighting: Lighting,
) -> Option<[View<'a>; 2]> {
    let view = |side: usize, frame, camera, camera_from_left: Isometry3<f64>| {
        let picture = &pictures[side];
        let luma = LumaView::new(picture.luma(frame))?;
        let rotation = camera_from_left.rotation.to_rotation_matrix().into_inner();
        let shadow = lighting.dark.then(|| (rotation * lighting.shadow.push(0.0)).xy());
        Some(View {
            camera,
            rotation,
            camera_from_left,
            profiler: Profiler::new(luma, lighting.dark, CONTRAST_MIN)
                .with_outlines_at(lighting.outline_256)
                .with_shadow(shadow),
            mask: picture.mask(),
        })
    };
    Some([
        view(0, &pair.left, &rig.left, Isometry3::identity())?,
        view(1, &pair.right, &rig.right, rig.right_from_left)?,
    ])
}
