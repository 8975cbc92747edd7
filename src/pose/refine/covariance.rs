//! How far a pose is off: what is different from place to place averages out over a wire, what the light does to all
//! of it does not.
//!
//! Sections a thickness apart err independently of each other (the autocorrelation of their residuals is nought), so
//! the covariance of the fit holds for that; where there are more sections, each counts for as much less. The rest are a
//! few ways in which all sections of a piece of wire err together, each with one unknown amplitude: what such a way does
//! to the pose is what the fit makes of errors of just that form, and its square is added. All amplitudes are in radii of
//! the wire, for they come from where the border of the lit region lies on its round surface.

use nalgebra::{Matrix3, Matrix6, Point3, SMatrix, Vector3};

use super::equations::{Doubt, Unknowns, start_sigma};
use super::turn::TurnSeen;
use super::{FINE_NEXT, Fit, Refine, Shading, View};
use crate::pose::model::PoseModel;

/// Least share of the assumed standard deviations that measurements have where they tell of a turn of the camera: what is
/// assumed has room for what light does to all of a wire, which is alike in both pictures.
const TURN_MISFIT_MIN: f64 = 0.4;

type Inverse = SMatrix<f64, 8, 8>;

/// Where a measurement comes from, and what it hangs on: the radius of the wire in pixels, and how far in pixels the
/// measured moves when the wire is raised by a radius.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Origin {
    /// The wire at this station.
    Section { side: usize, station: usize, radius_px: f64, lift_px: f64 },
    /// A free end, and the standard deviation of what its face is taken for.
    End { side: usize, index: usize, radius_px: f64, lift_px: f64, face_px: f64 },
}

/// A measurement at the refined pose.
pub(super) struct Observation {
    /// How it moves with all unknowns.
    pub(super) gradient: Unknowns,
    /// What it counts in the normal equations.
    pub(super) weight: f64,
    /// Seen minus expected, in pixels.
    pub(super) residual_px: f64,
    origin: Origin,
}

impl Observation {
    /// Whether the right picture shows it.
    pub(super) fn in_right(&self) -> bool {
        let (Origin::Section { side, .. } | Origin::End { side, .. }) = self.origin;
        side == 1
    }

    /// Adds what an error of `px` here does to the right side of the normal equations.
    fn add_error(&self, px: f64, to: &mut Unknowns) {
        *to += self.gradient * (self.weight * px);
    }
}

/// How sure a pose is, and what it says of the rig.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spread {
    /// Covariance of a small displacement (mm) and rotation (radians) about the part's centre, left camera's axes: of what
    /// is different from place to place, and of what the light does to all of the wire, polished or not.
    pub covariance: Matrix6<f64>,
    /// What the part tells of a turn of the right camera.
    pub turn: TurnSeen,
}

impl Refine {
    /// How sure the pose of the last [`Refine::fine`] is.
    pub fn spread(&mut self, model: &PoseModel, fit: &Fit, views: &[View; 2]) -> Spread {
        let pose = &fit.left_from_part;
        let (_, scales_px) = FINE_NEXT;
        let Self { observations, origins, params, eye, equations, .. } = self;
        let scale = scales_px[3] / params.section_sigma_px;
        observations.clear();
        let weighed = equations.weighed(scale).zip(origins.iter());
        observations.extend(weighed.map(|((gradient, weight, residual_px), origin)| Observation {
            gradient,
            weight,
            residual_px,
            origin: *origin,
        }));
        let solution = equations.solve(&Doubt {
            scales: &[scale],
            shading_sigma_px: params.shading_sigma_px,
            along: model.straight_along.map(|a| pose.rotation * a),
            start_sigma: start_sigma(model.radius_mm),
        });
        let Some(solution) = solution else {
            let [mm, radians] = start_sigma(model.radius_mm).map(|sigma| sigma * sigma);
            let covariance = Matrix6::from_diagonal(&[mm, mm, mm, radians, radians, radians].into());
            return Spread { covariance, ..Spread::default() };
        };
        let sight = (pose * model.centre_mm - *eye).normalize();
        let is_polished = views.iter().any(|view| view.profiler.is_polished());
        let shading = if is_polished { params.shading.polished() } else { params.shading };
        let inverse = solution.inverse();
        // Where there are more sections than independent ones each counts for as much less.
        let variance = |misfit: f64| misfit * misfit * model.per_thickness as f64;
        let right_eye = views[1].camera_from_left.inverse() * Point3::origin();
        Spread {
            covariance: covariance(
                &shading,
                model,
                observations,
                &inverse,
                variance(fit.misfit.max(1.0)),
                &sight,
            ),
            turn: TurnSeen::of(
                observations,
                &solution,
                variance(fit.misfit.max(TURN_MISFIT_MIN)),
                &(pose * model.centre_mm),
                &right_eye,
            ),
        }
    }
}

/// Covariance of a pose about the part's centre: displacement in mm, then rotation in radians. `inverse` is that of
/// the fit's normal equations, `variance` by how much the squares of its residuals exceed what was assumed, `sight` the unit
/// vector along the line of sight.
fn covariance(
    shading: &Shading,
    model: &PoseModel,
    observations: &[Observation],
    inverse: &Inverse,
    variance: f64,
    sight: &Vector3<f64>,
) -> Matrix6<f64> {
    let mut covariance: Matrix6<f64> = inverse.fixed_view::<6, 6>(0, 0) * variance;
    let [across, lift] = [shading.across, shading.lift].map(|radii| radii * model.radius_mm);
    let displaced = Matrix3::identity() * across.powi(2)
        + sight * sight.transpose() * (lift.powi(2) - across.powi(2)).max(0.0);
    let mut position = covariance.fixed_view_mut::<3, 3>(0, 0);
    position += displaced;
    let mut add = |error: &Unknowns| {
        let moved = (inverse * error).fixed_rows::<6>(0).into_owned();
        covariance += moved * moved.transpose();
    };
    let piece = |o: &Observation| match o.origin {
        Origin::Section { station, .. } => (true, model.stations[station].stretch),
        Origin::End { index, .. } => (false, index),
    };
    let mut ends_lifted = Unknowns::zeros();
    for together in observations.chunk_by(|a, b| piece(a) == piece(b)) {
        let [mut first, mut second] = [Unknowns::zeros(); 2];
        for o in together {
            match o.origin {
                Origin::Section { station, radius_px, lift_px, .. } => {
                    let share = model.stations[station].share;
                    o.add_error(shading.turn_across * share * radius_px, &mut first);
                    o.add_error(shading.turn_lift * share * lift_px, &mut second);
                }
                Origin::End { radius_px, lift_px, face_px, .. } => {
                    o.add_error((shading.end * radius_px).hypot(face_px), &mut first);
                    o.add_error(shading.end_lift * lift_px, &mut ends_lifted);
                }
            }
        }
        add(&first);
        add(&second);
    }
    add(&ends_lifted);
    covariance
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point3, Vector6};

    use super::*;
    use crate::pose::model::Station;

    /// A straight wire along x, seen from above by one camera, 2 pixels a mm.
    fn seen_from_above(with_ends: bool) -> (PoseModel, Vec<Observation>) {
        let station = |k: usize| Station {
            position_mm: Point3::new(3.0 * k as f64 - 30.0, 0.0, 0.0),
            tangent: Vector3::x(),
            edge: 0,
            length_mm: 3.0,
            at_joint: false,
            stretch: 0,
            share: k as f64 / 20.0 - 0.5,
        };
        let model = PoseModel {
            per_thickness: 1,
            clusters: Vec::new(),
            stations: (0..=20).map(station).collect(),
            ends: vec![],
            radius_mm: 1.5,
            length_mm: 60.0,
            centre_mm: Point3::origin(),
            straight_mm: Vec::new(),
            straight_along: Some(Vector3::x()),
        };
        let observation = |gradient: Vector6<f64>, weight, origin| Observation {
            gradient: gradient.fixed_resize(0.0),
            weight,
            residual_px: 0.0,
            origin,
        };
        let across = |(k, s): (usize, &Station)| {
            let gradient = Vector6::new(0.0, 2.0, 0.0, 0.0, 0.0, 2.0 * s.position_mm.x);
            observation(
                gradient,
                100.0,
                Origin::Section { side: 0, station: k, radius_px: 3.0, lift_px: 0.0 },
            )
        };
        let mut observations: Vec<_> = model.stations.iter().enumerate().map(across).collect();
        if with_ends {
            observations.extend([0, 1].map(|index| {
                let gradient = Vector6::new(2.0, 0.0, 0.0, 0.0, 0.0, 0.0);
                observation(
                    gradient,
                    50.0,
                    Origin::End { side: 0, index, radius_px: 3.0, lift_px: 0.0, face_px: 0.0 },
                )
            }));
        }
        (model, observations)
    }

    fn spread(shading: &Shading, with_ends: bool) -> Matrix6<f64> {
        let (model, observations) = seen_from_above(with_ends);
        let mut normal = Inverse::identity() * 0.04;
        for o in &observations {
            normal += o.gradient * o.gradient.transpose() * o.weight;
        }
        covariance(shading, &model, &observations, &normal.try_inverse().unwrap(), 1.0, &Vector3::z())
    }

    #[test]
    fn what_light_does_to_all_of_a_wire_does_not_average_out() {
        let none =
            Shading { across: 0.0, lift: 0.0, turn_across: 0.0, turn_lift: 0.0, end: 0.0, end_lift: 0.0 };
        let light = Shading::default();
        let (fit, all) = (spread(&none, true), spread(&light, true));
        let sigma = |c: &Matrix6<f64>, k: usize| c[(k, k)].sqrt();
        // 21 sections of 0.1 pixels fix the place across to a hundredth of a mm; the light does not.
        assert!(sigma(&fit, 1) < 0.012 && (sigma(&all, 1) - light.across * 1.5).abs() < 0.005, "{fit} {all}");
        // Over its length of 60 mm.
        let turned = light.turn_across * 1.5 / 60.0;
        assert!((sigma(&all, 5) - turned).abs() < 0.3 * turned, "{}", sigma(&all, 5));
    }

    #[test]
    fn a_wire_without_ends_may_have_slid() {
        let shading = Shading::default();
        let (seen, hidden) = (spread(&shading, true), spread(&shading, false));
        assert!(seen[(0, 0)].sqrt() < 0.1 && hidden[(0, 0)].sqrt() > 4.0, "{seen} {hidden}");
    }
}
