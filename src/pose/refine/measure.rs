//! What is seen of a part, as measurements of its pose.

use super::covariance::Origin;
use super::equations::Measurement;
use super::{EndSighting, Params, Sighting};
use crate::pose::model::PoseModel;
use crate::pose::width::UsualWidth;

/// See [`Measurement::patience`].
const END_PATIENCE: f64 = 1.5;

/// Gives what is seen of the wire across it, measured, and where each measurement comes from.
pub(super) fn measure_outlines(
    params: &Params,
    model: &PoseModel,
    sightings: &[[Option<Sighting>; 2]],
    usual: &[UsualWidth; 2],
    search_px: f64,
    mut each: impl FnMut(Measurement, Origin),
) {
    for (k, (station, seen)) in model.stations.iter().zip(sightings).enumerate() {
        if station.at_joint {
            continue;
        }
        for (side, (seen, usual)) in seen.iter().zip(usual).enumerate() {
            let Some((sighting, section)) = seen.as_ref().and_then(|s| Some((s, s.section?))) else {
                continue;
            };
            let half_width_px = sighting.half_width_px;
            if let Some((residual_px, sigma_px)) =
                usual.middle_of(&section, half_width_px, search_px, params.section_sigma_px)
            {
                // The outline that the light leaves is the wire's own, not that of a line above or below its axis.
                let lifted_px =
                    if section.is_off_shadow { params.lift_radii * sighting.lift_px } else { 0.0 };
                let residual_px = residual_px + lifted_px;
                let shaded = model.straight_along.map(|_| side);
                each(
                    Measurement { residual_px, gradient: sighting.gradient, sigma_px, patience: 1.0, shaded },
                    Origin::Section { side, station: k, radius_px: half_width_px, lift_px: sighting.lift_px },
                );
            }
        }
    }
}

/// The same of the ends, along the wire.
pub(super) fn measure_ends(
    params: &Params,
    ends: &[[Option<EndSighting>; 2]],
    mut each: impl FnMut(Measurement, Origin),
) {
    for (index, end) in ends.iter().enumerate() {
        for (side, end) in end.iter().enumerate() {
            let Some((end, residual_px)) = end.as_ref().and_then(|end| Some((end, end.beyond_px?))) else {
                continue;
            };
            each(
                Measurement {
                    residual_px,
                    gradient: end.gradient,
                    sigma_px: params.end_sigma_px.hypot(end.face_px),
                    patience: END_PATIENCE,
                    shaded: None,
                },
                Origin::End {
                    side,
                    index,
                    radius_px: end.half_width_px,
                    lift_px: end.lift_px,
                    face_px: end.face_px,
                },
            );
        }
    }
}
