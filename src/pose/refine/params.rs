//! How a pose is refined.

use crate::pose::shading::Shading;

/// How a pose is refined.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params {
    /// Height of the point that the middle of the outline shows above the wire's axis, in radii, -1 to 1.
    pub lift_radii: f64,
    /// Width of the outline over the wire's diameter where only one side is seen.
    pub outline_ratio: f64,
    /// Standard deviation of a section's middle, in pixels.
    pub section_sigma_px: f64,
    /// Standard deviation of what shading moves all sections of a straight wire alike in one picture, in pixels.
    pub shading_sigma_px: f64,
    /// What else the light does to the outlines.
    pub shading: Shading,
    /// Standard deviation of an end, in pixels.
    pub end_sigma_px: f64,
    /// Height above the axis, in radii, of the outline of an end that leans up or away, whose face is not seen: where the
    /// lit upper side stops. Then for one of which the face is seen, and as light as the wire: the lower rim.
    pub end_lift_radii: [f64; 2],
    /// Whether faces always are as light or dark as the wire, as those of dark parts are. Else light comes from above.
    pub faces_like_wire: bool,
    /// How far beyond the seen outline of an end the wire reaches, in radii.
    pub end_reach_radii: f64,
    /// Rounds with the binary picture, from the rough pose on.
    pub coarse_rounds: u32,
    /// Rounds with the grey values, at most.
    pub fine_rounds: u32,
    /// Share of background along the wire up to which a [coarse](super::Refine::coarse) pose is refined: half more than [a part
    /// may have](crate::matching::select::Params::missing_max).
    pub missing_max: f64,
}

impl Default for Params {
    fn default() -> Self {
        Self {
            lift_radii: 0.36,
            outline_ratio: 0.85,
            section_sigma_px: 0.15,
            shading_sigma_px: 0.01,
            shading: Shading::default(),
            end_sigma_px: 0.14,
            end_lift_radii: [0.6, -0.93],
            faces_like_wire: false,
            end_reach_radii: 0.03,
            coarse_rounds: 2,
            fine_rounds: 6,
            missing_max: 0.12,
        }
    }
}

impl Params {
    /// Height above the axis of what is seen of an end that leans up by an angle with this sine, and its standard
    /// deviation, in radii. The light from above that the face gets is `lean_sin` of what the wire gets; whether it
    /// looks like wire or like floor depends on where exactly the lamp is.
    pub(super) fn end_lift(&self, lean_sin: f64, sees_face: bool) -> (f64, f64) {
        let [upper, lower] = self.end_lift_radii;
        if !sees_face {
            (upper, 0.0)
        } else if self.faces_like_wire {
            (lower, 0.0)
        } else {
            let like_wire = lean_sin.max(0.0);
            let sigma = (upper - lower) * (like_wire * (1.0 - like_wire)).sqrt();
            (upper + (lower - upper) * like_wire, sigma)
        }
    }
}
