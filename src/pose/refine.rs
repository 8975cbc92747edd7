//! The pose that agrees best with the outlines in both pictures: robust least squares on reprojection.
//!
//! Every station of the part's centreline is projected into both pictures; across the wire there the outline is
//! measured, and its middle compared with the projection. Free ends that are seen are compared along the wire.
//! Gauss-Newton with a Geman-McClure loss turns and moves the part until both agree.
//!
//! The outline of a lit round wire is not its silhouette: light from above leaves its flanks dark, so the middle
//! between two outlines belongs to a point above the axis. [`Params::lift_radii`] says how far.

use nalgebra::{
    Isometry3, Matrix2x3, Matrix6, Point3, Rotation3, RowVector3, Translation3, Vector2, Vector3, Vector6,
};

use super::model::{PoseModel, Station};
use super::section::{Profiler, Section, mask_run};
use crate::rig::{CameraModel, Rig};
use crate::vision::bits::BitImage;

/// Most measurements of one fit.
const OBSERVATIONS_MAX: usize = 1024;

/// See [`Observation::patience`].
const END_PATIENCE: f64 = 3.0;

/// Where the width is looked at before an end, in half widths.
const BARE_HALF_WIDTHS: [f64; 3] = [0.8, 1.6, 2.8];

/// How a pose is refined.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params {
    /// Height of the point that the middle of the outline shows above the wire's axis, in radii, 0 to 1.
    pub lift_radii: f64,
    /// Width of the outline over the wire's diameter where only one side is seen.
    pub outline_ratio: f64,
    /// Standard deviation of a section's middle, in pixels.
    pub section_sigma_px: f64,
    /// Standard deviation of an end, in pixels.
    pub end_sigma_px: f64,
    /// How far beyond the seen outline of an end the wire reaches, in radii.
    pub end_reach_radii: f64,
    /// Rounds with the binary picture, from the rough pose on.
    pub coarse_rounds: u32,
    /// Rounds with the grey values.
    pub fine_rounds: u32,
}

impl Default for Params {
    fn default() -> Self {
        Self {
            lift_radii: 0.36,
            outline_ratio: 0.85,
            section_sigma_px: 0.15,
            end_sigma_px: 0.3,
            end_reach_radii: 0.0,
            coarse_rounds: 2,
            fine_rounds: 3,
        }
    }
}

/// One picture, as pose estimation reads it.
#[derive(Clone, Copy)]
pub struct View<'a> {
    /// Its camera.
    pub camera: &'a CameraModel,
    /// From the left camera's frame to this camera's.
    pub camera_from_left: Isometry3<f64>,
    /// Its grey values.
    pub profiler: Profiler<'a>,
    /// Its binary picture.
    pub mask: &'a BitImage,
}

/// What one picture shows at one station.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sighting {
    /// What was measured, if anything.
    pub section: Option<Section>,
    /// Whether the expected middle is object in the binary picture.
    pub object: bool,
    /// The expected middle.
    pub expected_px: Vector2<f64>,
    /// Unit vector across the wire.
    pub across: Vector2<f64>,
    /// Expected half width of the silhouette.
    pub half_width_px: f64,
}

/// A refined pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fit {
    /// From the part's frame to the left camera's.
    pub left_from_part: Isometry3<f64>,
    /// Covariance of a small displacement (mm) and rotation (radians) about the part's centre, left camera's axes,
    /// in units of the assumed standard deviations.
    pub covariance: Matrix6<f64>,
    /// Root of the weighted mean square of the residuals, in assumed standard deviations.
    pub misfit: f64,
    /// Number of measurements that the fit believes.
    pub believed: usize,
}

struct Observation {
    residual: f64,
    gradient: Vector6<f64>,
    sigma: f64,
    /// Residual at which belief has halved, over that of a section: an end is seldom mistaken.
    patience: f64,
}

/// Workspace of pose refinement.
pub struct Refine {
    params: Params,
    observations: Vec<Observation>,
    left_from_right_centre: Point3<f64>,
}

impl Refine {
    /// For this rig; reserves all memory.
    pub fn new(params: Params, rig: &Rig) -> Self {
        Self {
            params,
            observations: Vec::with_capacity(OBSERVATIONS_MAX),
            left_from_right_centre: rig.right_from_left.inverse() * Point3::origin(),
        }
    }

    /// The parameters.
    pub fn params(&self) -> &Params {
        &self.params
    }

    /// Unit vector from a point of a wire towards the cameras, at right angles to the wire: the side that is lit.
    pub fn upward(&self, point: &Point3<f64>, tangent: &Vector3<f64>) -> Vector3<f64> {
        let eye = nalgebra::center(&Point3::origin(), &self.left_from_right_centre);
        let to_eye = eye - point;
        let across = to_eye - tangent * tangent.dot(&to_eye);
        across / across.norm().max(1e-9)
    }

    /// Looks at one station in one picture. `None` where it is out of the picture.
    pub fn sight(
        &self,
        model: &PoseModel,
        station: &Station,
        left_from_part: &Isometry3<f64>,
        view: &View,
        search_px: f64,
    ) -> Option<Sighting> {
        let aim = self.aim(
            model.radius_mm,
            &(left_from_part * station.position_mm),
            &(left_from_part * station.tangent),
            view,
        )?;
        Some(Sighting {
            section: view.profiler.across(aim.px, aim.across, aim.half_width_px, search_px),
            object: view.mask.get(aim.px.x.round() as i32, aim.px.y.round() as i32),
            expected_px: aim.px,
            across: aim.across,
            half_width_px: aim.half_width_px,
        })
    }

    fn aim(&self, radius_mm: f64, point: &Point3<f64>, tangent: &Vector3<f64>, view: &View) -> Option<Aim> {
        let lifted = point + self.upward(point, tangent) * (self.params.lift_radii * radius_mm);
        aim(radius_mm, &lifted, tangent, view)
    }

    /// Refines `start`, a rough pose, in both pictures. `None` where too little of the part is seen to hold it.
    pub fn run(&mut self, model: &PoseModel, start: &Isometry3<f64>, views: &[View; 2]) -> Option<Fit> {
        let mut pose = *start;
        for round in 0..self.params.coarse_rounds {
            self.observe_masks(model, &pose, views, if round == 0 { 7.0 } else { 4.0 });
            self.step(model, &mut pose, if round == 0 { 4.0 } else { 2.0 } / self.params.section_sigma_px)?;
        }
        let mut fit = None;
        for round in 0..self.params.fine_rounds {
            let (search_px, scale_px) = match round {
                0 => (2.5, 1.5),
                1 => (1.5, 0.7),
                _ => (1.0, 0.5),
            };
            self.observe_outlines(model, &pose, views, search_px);
            fit = Some(self.step(model, &mut pose, scale_px / self.params.section_sigma_px)?);
        }
        fit
    }

    fn observe_masks(&mut self, model: &PoseModel, pose: &Isometry3<f64>, views: &[View; 2], search_px: f64) {
        self.observations.clear();
        let centre = pose * model.centre_mm;
        for station in model.stations.iter().filter(|s| !s.at_joint) {
            let (point, tangent) = (pose * station.position_mm, pose * station.tangent);
            for view in views {
                let Some(aim) = self.aim(model.radius_mm, &point, &tangent, view) else { continue };
                let Some((middle, width)) = mask_run(view.mask, aim.px, aim.across, search_px) else {
                    continue;
                };
                if width > 3.2 * aim.half_width_px + 1.0 {
                    continue;
                }
                self.push(
                    aim.gradient(&aim.across, &(point - centre)),
                    middle,
                    2.0 * self.params.section_sigma_px,
                    1.0,
                );
            }
        }
        self.observe_ends(model, pose, views, search_px + 4.0);
    }

    fn observe_outlines(
        &mut self,
        model: &PoseModel,
        pose: &Isometry3<f64>,
        views: &[View; 2],
        search_px: f64,
    ) {
        self.observations.clear();
        let centre = pose * model.centre_mm;
        for station in model.stations.iter().filter(|s| !s.at_joint) {
            let (point, tangent) = (pose * station.position_mm, pose * station.tangent);
            for view in views {
                let Some(aim) = self.aim(model.radius_mm, &point, &tangent, view) else { continue };
                let Some(section) = view.profiler.across(aim.px, aim.across, aim.half_width_px, search_px)
                else {
                    continue;
                };
                let Some((middle, sigma)) = self.middle_of(&section, aim.half_width_px, search_px) else {
                    continue;
                };
                self.push(aim.gradient(&aim.across, &(point - centre)), middle, sigma, 1.0);
            }
        }
        self.observe_ends(model, pose, views, search_px + 3.5);
    }

    /// Middle of the wire and its standard deviation from what is seen of its outline.
    fn middle_of(&self, section: &Section, half_width_px: f64, search_px: f64) -> Option<(f64, f64)> {
        let Params { outline_ratio, section_sigma_px, .. } = self.params;
        let half = half_width_px * outline_ratio;
        let near = |px: f64| px.abs() < search_px + 0.5 * half_width_px;
        if let Some((middle, width)) = section.middle_and_width() {
            let ratio = width / (2.0 * half_width_px);
            if (0.5..1.2).contains(&ratio) {
                return near(middle).then_some((middle, section_sigma_px));
            }
        }
        // Wider than the wire: something touches one side. The side nearer to its expected place is believed.
        let low = section.low_px.map(|l| l + half).filter(|&m| near(m));
        let high = section.high_px.map(|h| h - half).filter(|&m| near(m));
        let middle = match (low, high) {
            (Some(l), Some(h)) if l.abs() > h.abs() => h,
            (Some(l), _) => l,
            (None, Some(h)) => h,
            (None, None) => return None,
        };
        Some((middle, 4.0 * section_sigma_px))
    }

    fn observe_ends(&mut self, model: &PoseModel, pose: &Isometry3<f64>, views: &[View; 2], search_px: f64) {
        let centre = pose * model.centre_mm;
        for end in &model.ends {
            let (point, outward) = (pose * end.position_mm, pose * end.outward);
            for view in views {
                let Some(aim) = self.aim(model.radius_mm, &point, &outward, view) else { continue };
                let Some(beyond) = view.profiler.end(aim.px, aim.along, aim.half_width_px, search_px) else {
                    continue;
                };
                if !self.end_is_bare(&aim, beyond, view) {
                    continue;
                }
                let beyond = beyond + self.params.end_reach_radii * aim.half_width_px;
                self.push(
                    aim.gradient(&aim.along, &(point - centre)),
                    beyond,
                    self.params.end_sigma_px,
                    END_PATIENCE,
                );
            }
        }
    }

    /// How far beyond the expected place a free end is seen in one picture, in pixels; `None` where something hides
    /// it.
    pub fn sight_end(
        &self,
        model: &PoseModel,
        end: &super::model::FreeEnd,
        left_from_part: &Isometry3<f64>,
        view: &View,
        search_px: f64,
    ) -> Option<f64> {
        let aim = self.aim(
            model.radius_mm,
            &(left_from_part * end.position_mm),
            &(left_from_part * end.outward),
            view,
        )?;
        let beyond = view.profiler.end(aim.px, aim.along, aim.half_width_px, search_px)?;
        self.end_is_bare(&aim, beyond, view)
            .then_some(beyond + self.params.end_reach_radii * aim.half_width_px)
    }

    /// Whether the wire just before an end seen `beyond` pixels beyond its expected place is as wide as one wire: an
    /// end that lies on another wire is not where the bright region ends.
    fn end_is_bare(&self, aim: &Aim, beyond: f64, view: &View) -> bool {
        BARE_HALF_WIDTHS.iter().all(|&back| {
            let at = aim.px + aim.along * (beyond - back * aim.half_width_px);
            view.profiler
                .across(at, aim.across, aim.half_width_px, 1.5)
                .and_then(|s| s.middle_and_width())
                .is_some_and(|(middle, width)| {
                    width < 2.4 * aim.half_width_px && middle.abs() < 0.5 * aim.half_width_px + 1.0
                })
        })
    }

    fn push(&mut self, gradient: Vector6<f64>, residual: f64, sigma: f64, patience: f64) {
        if self.observations.len() < OBSERVATIONS_MAX {
            self.observations.push(Observation { residual, gradient, sigma, patience });
        }
    }

    /// One Gauss-Newton step; `scale` is the residual, in standard deviations, at which belief has halved.
    fn step(&self, model: &PoseModel, pose: &mut Isometry3<f64>, scale: f64) -> Option<Fit> {
        let mut normal = Matrix6::zeros();
        let mut right_side = Vector6::zeros();
        let (mut weights, mut squares, mut believed) = (0.0, 0.0, 0);
        for o in &self.observations {
            let e = o.residual / o.sigma;
            let weight = 1.0 / (1.0 + (e / (scale * o.patience)).powi(2)).powi(2);
            let g = o.gradient / o.sigma;
            normal += g * g.transpose() * weight;
            right_side += g * (e * weight);
            weights += weight;
            squares += weight * e * e;
            believed += usize::from(weight > 0.5);
        }
        if believed < 6 {
            return None;
        }
        if let Some(along) = model.straight_along {
            let along = *pose * along;
            let mut block = normal.fixed_view_mut::<3, 3>(3, 3);
            block += along * along.transpose() * 1e6;
        }
        // What the pictures do not fix stays where it was: 5 mm, 0.2 rad.
        for i in 0..6 {
            normal[(i, i)] += if i < 3 { 1.0 / 25.0 } else { 1.0 / 0.04 };
        }
        let cholesky = normal.cholesky()?;
        let step = cholesky.solve(&right_side);
        if !step.iter().all(|v| v.is_finite()) {
            return None;
        }
        *pose = moved(pose, &model.centre_mm, &step);
        Some(Fit {
            left_from_part: *pose,
            covariance: cholesky.inverse(),
            misfit: (squares / weights).sqrt(),
            believed,
        })
    }
}

/// `pose`, displaced and turned about the part's centre by a small twist in the left camera's axes.
fn moved(pose: &Isometry3<f64>, centre_mm: &Point3<f64>, twist: &Vector6<f64>) -> Isometry3<f64> {
    let centre = (pose * centre_mm).coords;
    let shift: Vector3<f64> = twist.fixed_rows::<3>(0).into();
    let turn = Rotation3::new(Vector3::from(twist.fixed_rows::<3>(3)));
    let about_centre = Isometry3::from_parts(Translation3::from(centre + shift), turn.into());
    about_centre * Translation3::from(-centre) * pose
}

/// Where and how a piece of wire is expected in one picture.
struct Aim {
    px: Vector2<f64>,
    along: Vector2<f64>,
    across: Vector2<f64>,
    half_width_px: f64,
    /// Pixels per mm in the left camera's axes.
    jacobian: Matrix2x3<f64>,
}

impl Aim {
    /// Gradient of the pixel's movement along `direction` by displacement and rotation about a centre `arm` away.
    fn gradient(&self, direction: &Vector2<f64>, arm: &Vector3<f64>) -> Vector6<f64> {
        let row: RowVector3<f64> = direction.transpose() * self.jacobian;
        let force = row.transpose();
        let torque = arm.cross(&force);
        Vector6::new(force.x, force.y, force.z, torque.x, torque.y, torque.z)
    }
}

fn aim(radius_mm: f64, point: &Point3<f64>, tangent: &Vector3<f64>, view: &View) -> Option<Aim> {
    let in_camera = view.camera_from_left * point;
    let (px, jacobian) = view.camera.project_with_jacobian(&in_camera)?;
    let jacobian = jacobian * view.camera_from_left.rotation.to_rotation_matrix().matrix();
    let along = jacobian * tangent;
    let norm = along.norm();
    if norm < 1e-6 {
        return None;
    }
    let along = along / norm;
    let across = Vector2::new(-along.y, along.x);
    // A radius at right angles to the line of sight, as many pixels as the picture moves across the wire.
    let half_width_px = radius_mm * (across.transpose() * jacobian).norm();
    Some(Aim { px, along, across, half_width_px, jacobian })
}
