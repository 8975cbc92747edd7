//! The free ends of a part, as both pictures show them.

use nalgebra::{Isometry3, Point3, Vector2, Vector6};

use super::{Refine, View, profilers, seen};
use crate::pose::aim::{aim, up};
use crate::pose::end::EndLook;
use crate::pose::model::PoseModel;
use crate::pose::outlines::{LINES, Outlines};
use crate::pose::section::{Profiler, Section};
use crate::pose::width::{ONE_WIRE, is_one_wire};
use crate::vision::bits::{BitImage, nearest};

/// Where the width is looked at before an end, in half widths; the last one not of a dark wire, which its shadow
/// widens on one side.
const BARE_HALF_WIDTHS: [f64; 3] = [0.8, 1.6, 2.8];
/// How far the outlines are looked for there, in pixels.
const BARE_SEARCH_PX: f64 = 1.5;
/// See [`EndSighting::mask_beyond_px`].
const HIDDEN_PX_MAX: u32 = 12;

/// How far beyond an end of dark wire its shadow is taken for wire, in radii, where it falls straight on; a standard deviation.
const END_SHADOW_RADII: f64 = 0.84;
/// So many of these standard deviations may be shadow.
const SHADOW_SIGMAS: f64 = 2.0;

/// A free end in one picture: how far beyond the expected place it is seen.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EndSighting {
    /// In pixels; `None` where something hides it.
    pub beyond_px: Option<f64>,
    /// The expected place.
    pub expected_px: Vector2<f64>,
    /// Unit vector out of the part.
    pub outward: Vector2<f64>,
    /// Length of mask from the expected place outwards where the end is hidden, up to 12.
    pub mask_beyond_px: f64,
    pub(super) half_width_px: f64,
    /// Standard deviation of what the face of the end, and the shadow behind it, is taken for.
    pub(super) face_px: f64,
    /// That of the shadow alone.
    pub(super) shadow_px: f64,
    /// How far it moves along when the wire is raised by a radius.
    pub(super) lift_px: f64,
    pub(super) gradient: Vector6<f64>,
}

impl EndSighting {
    /// How far it is seen from where it is expected, in pixels, but for shadow behind it.
    pub fn off_px(&self) -> Option<f64> {
        let beyond_px = self.beyond_px?;
        let shadow_px = beyond_px.min(SHADOW_SIGMAS * self.shadow_px).max(0.0);
        Some((beyond_px - shadow_px).abs())
    }

    /// Where the wire just before it, where it is seen, is looked at: places of its middle.
    fn before(&self, profiler: &Profiler) -> impl Iterator<Item = Vector2<f64>> {
        let places = if profiler.dark_parts() { &BARE_HALF_WIDTHS[..2] } else { &BARE_HALF_WIDTHS[..] };
        self.beyond_px.into_iter().flat_map(move |beyond| {
            places
                .iter()
                .map(move |back| self.expected_px + self.outward * (beyond - back * self.half_width_px))
        })
    }

    fn across(&self) -> Vector2<f64> {
        Vector2::new(-self.outward.y, self.outward.x)
    }

    /// Whether what is seen across it is as wide as one wire.
    fn is_one_wire(&self, section: &Option<Section>) -> bool {
        section.and_then(|s| s.middle_and_width()).is_some_and(|(middle, width)| {
            is_one_wire(width, 2.0 * self.half_width_px, ONE_WIRE)
                && middle.abs() < 0.5 * self.half_width_px + 1.0
        })
    }

    /// How far the mask goes on along the wire beyond its expected end.
    fn mask_beyond_px(&self, mask: &BitImage) -> f64 {
        let object = |k: u32| {
            let at = self.expected_px + self.outward * f64::from(k);
            mask.get(nearest(at.x), nearest(at.y))
        };
        f64::from((0..HIDDEN_PX_MAX).find(|&k| !object(k + 1)).unwrap_or(HIDDEN_PX_MAX))
    }
}

/// Leaves those ends for seen before which the wire is as wide as one wire: an end that lies on another wire is not where
/// the bright region ends, nor one of which a neighbour hides a corner.
fn keep_bare(ends: &mut [[Option<EndSighting>; 2]], outlines: &mut Outlines, profilers: [&Profiler; 2]) {
    for ends in ends.chunks_mut(LINES / (2 * BARE_HALF_WIDTHS.len())) {
        outlines.clear();
        for (side, end) in seen(ends) {
            for middle in end.before(profilers[side]) {
                outlines.push(side, middle, end.across(), end.half_width_px);
            }
        }
        let mut sections = outlines.sections(profilers, BARE_SEARCH_PX).iter();
        for (side, end) in seen(ends) {
            let count = end.before(profilers[side]).count();
            let are_one_wire: usize =
                sections.by_ref().take(count).map(|s| usize::from(end.is_one_wire(s))).sum();
            end.beyond_px = end.beyond_px.filter(|_| are_one_wire == count);
        }
    }
}

impl Refine {
    pub(super) fn look_at_ends(
        &mut self,
        model: &PoseModel,
        pose: &Isometry3<f64>,
        views: &[View; 2],
        search_px: f64,
        how: EndLook,
    ) {
        let centre = pose * model.centre_mm;
        let Self { ends, outlines, params, eye, unasked_end, .. } = self;
        ends.clear();
        for end in &model.ends {
            let (point, outward) = (pose * end.position_mm, pose.rotation * end.outward);
            let raised = up(eye, &point, &outward) * model.radius_mm;
            let lean_sin = (*eye - point).normalize().dot(&outward);
            ends.push([0, 1].map(|side| {
                let view = &views[side];
                let faces = view.camera_from_left.inverse_transform_point(&Point3::origin());
                let sees_face = (faces - point).dot(&outward) > 0.0;
                let (lift_radii, lift_sigma) = params.end_lift(lean_sin, sees_face);
                let aim = aim(model.radius_mm, &(point + raised * lift_radii), &outward, view)?;
                let face_px = lift_sigma * lean_sin * aim.half_width_px;
                let shadow_onward = view.profiler.shadow_along(&aim.along).max(0.0);
                let shadow_px = END_SHADOW_RADII * shadow_onward * aim.half_width_px;
                Some(EndSighting {
                    beyond_px: view.profiler.end(aim.px, aim.along, aim.half_width_px, search_px, how),
                    expected_px: aim.px,
                    outward: aim.along,
                    mask_beyond_px: 0.0,
                    face_px: (face_px * face_px + shadow_px * shadow_px).sqrt(),
                    shadow_px,
                    half_width_px: aim.half_width_px,
                    lift_px: (aim.jacobian * raised).dot(&aim.along),
                    gradient: aim.gradient(&aim.along, &(point - centre)),
                })
            }));
        }
        if let Some(unasked) = unasked_end.and_then(|index| ends.get_mut(index)) {
            unasked.iter_mut().flatten().for_each(|end| end.beyond_px = None);
        }
        keep_bare(ends, outlines, profilers(views));
        for (side, end) in seen(ends) {
            if let Some(beyond_px) = &mut end.beyond_px {
                *beyond_px += params.end_reach_radii * end.half_width_px;
            } else if how == EndLook::Close {
                end.mask_beyond_px = end.mask_beyond_px(views[side].mask);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{Frame, LumaView};
    use crate::level::Level;

    /// Whether an end is bare of a level wire 6 pixels wide, beside which something lies that begins some pixels before
    /// the end; dark on a light floor, or with all light turned round.
    fn is_bare(dark_parts: bool, begins_before_px: i32) -> bool {
        let grey = |x: i32, y: i32| match y {
            17..=22 if x <= 40 => 50u8,
            23..=26 if x <= 40 - begins_before_px => 60 + 30 * (y - 22) as u8,
            _ => 200,
        };
        let pixels = (0..40).flat_map(|y| (0..60).map(move |x| grey(x, y)));
        let pixels = pixels.flat_map(|v| [if dark_parts { v } else { 255 - v }; 3]);
        let frame = Frame::from_rgb(60, 40, pixels.collect());
        let end = EndSighting {
            beyond_px: Some(0.0),
            expected_px: Vector2::new(40.5, 19.5),
            outward: Vector2::x(),
            half_width_px: 3.0,
            ..EndSighting::default()
        };
        let mut ends = [[Some(end), None]];
        let profiler = Profiler::new(LumaView::new(&frame).unwrap(), dark_parts, 12.0);
        keep_bare(&mut ends, &mut Outlines::new(Level::Plain), [&profiler; 2]);
        ends[0][0].unwrap().beyond_px.is_some()
    }

    #[test]
    fn only_close_to_its_end_must_a_dark_wire_be_bare_of_shadow() {
        assert!(is_bare(true, 8) && !is_bare(true, 4));
        assert!(is_bare(false, 10) && !is_bare(false, 8));
    }

    #[test]
    fn an_end_that_is_seen_too_far_on_where_its_shadow_lies_may_be_where_it_should() {
        let off = |beyond_px: f64, shadow_px: f64| {
            EndSighting { beyond_px: Some(beyond_px), shadow_px, ..EndSighting::default() }.off_px().unwrap()
        };
        assert_eq!((off(3.0, 0.0), off(3.0, 1.0), off(1.5, 1.0)), (3.0, 1.0, 0.0));
        assert_eq!((off(-3.0, 0.0), off(-3.0, 1.0)), (3.0, 3.0));
    }
}
