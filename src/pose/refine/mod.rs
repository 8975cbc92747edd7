//! The pose that agrees best with the outlines in both pictures: robust least squares on reprojection.
//!
//! Every station of the part's centreline is projected into both pictures; across the wire there the outline is
//! measured, and its middle compared with the projection. Free ends that are seen are compared along the wire.
//! Gauss-Newton with a Geman-McClure loss turns and moves the part until both agree. What is measured does not depend
//! on the pose, only where it is looked for: a picture is read again only where the pose has moved far.
//!
//! The outline of a lit round wire is not its silhouette: light from above leaves its flanks dark, so the middle
//! between two outlines belongs to a point above the axis. [`Params::lift_radii`] says how far, and
//! [`Params::end_lift_radii`] for ends. Both were measured on rendered scenes of seven rigs, over which they differ
//! by 0.07 and 0.1 radii.

mod covariance;
mod ends;
mod equations;
mod measure;
mod params;
mod rough;
mod turn;

use arrayvec::ArrayVec;
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, Vector2, Vector3, Vector6};

use covariance::Origin;
pub use covariance::Spread;
pub use ends::EndSighting;
use equations::{Doubt, Equations, MEASUREMENTS_MAX, Measurement, Solution, start_sigma};
use measure::{measure_ends, measure_outlines};
pub use params::Params;
pub use turn::TurnSeen;

use super::aim::{aim, up};
use super::end::EndLook;
use super::model::{PoseModel, Station};
use super::outlines::{LINES, Outlines};
use super::section::{Profiler, Section};
use super::shading::Shading;
use super::sweep::{Eight, Expected, LANES, Sweep};
use super::width::UsualWidth;
use crate::level::Level;
use crate::rig::{CameraModel, Rig};
use crate::vision::bits::{BitImage, nearest};

/// Most stations of a part that are looked at.
pub(crate) const STATIONS_MAX: usize = 1024;
/// How far the outlines are looked for at first and later, and the residuals at which belief has halved, in pixels.
const FINE_FIRST: (f64, [f64; 4]) = (2.5, [1.5, 3.5 / 3.0, 2.5 / 3.0, 0.5]);
const FINE_NEXT: (f64, [f64; 4]) = (1.5, [0.7, 1.9 / 3.0, 1.7 / 3.0, 0.5]);
/// A pose that moved the wire by less than this in the pictures need not be looked at again.
const SETTLED_PX: f64 = 0.7;

/// One picture, as pose estimation reads it.
#[derive(Clone, Copy)]
pub struct View<'a> {
    /// Its camera.
    pub camera: &'a CameraModel,
    /// From the left camera's frame to this camera's.
    pub camera_from_left: Isometry3<f64>,
    /// The same rotation as a matrix.
    pub rotation: Matrix3<f64>,
    /// Its grey values.
    pub profiler: Profiler<'a>,
    /// Its binary picture.
    pub mask: &'a BitImage,
}

/// What one picture shows at one station, with distances from where the wire is expected.
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
    /// How far it moves across when the wire is raised by a radius.
    lift_px: f64,
    gradient: Vector6<f64>,
}

/// A refined pose.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Fit {
    /// From the part's frame to the left camera's.
    pub left_from_part: Isometry3<f64>,
    /// Root of the weighted mean square of the residuals, in assumed standard deviations.
    pub misfit: f64,
    /// Number of measurements that the fit believes.
    pub believed: usize,
}

/// Workspace of pose refinement.
pub struct Refine {
    params: Params,
    equations: Equations,
    outlines: Outlines,
    sightings: Vec<[Option<Sighting>; 2]>,
    ends: Vec<[Option<EndSighting>; 2]>,
    /// The end that is not asked, by its index among the model's.
    unasked_end: Option<usize>,
    /// Where the measurements of the equations come from.
    origins: Vec<Origin>,
    /// What the refined pose is measured with.
    observations: Vec<covariance::Observation>,
    /// Seen widths, to take their median.
    ratios: Vec<f64>,
    eye: Point3<f64>,
}

impl Refine {
    /// Refines with others from now on.
    pub fn set_params(&mut self, params: Params) {
        self.params = params;
    }

    /// For this rig; reserves all memory.
    pub fn new(params: Params, rig: &Rig) -> Self {
        let level = Level::detect();
        Self {
            params,
            equations: Equations::new(level),
            outlines: Outlines::new(level),
            sightings: Vec::with_capacity(STATIONS_MAX),
            ends: Vec::with_capacity(64),
            unasked_end: None,
            origins: Vec::with_capacity(MEASUREMENTS_MAX),
            observations: Vec::with_capacity(MEASUREMENTS_MAX),
            ratios: Vec::with_capacity(STATIONS_MAX),
            eye: nalgebra::center(&Point3::origin(), &rig.right_eye()),
        }
    }

    /// What both pictures show at every station of the part, at the pose of the last [`Refine::fine`].
    pub fn sightings(&self) -> &[[Option<Sighting>; 2]] {
        &self.sightings
    }

    /// What both pictures show at every free end of the part, at the pose of the last [`Refine::fine`].
    pub fn ends(&self) -> &[[Option<EndSighting>; 2]] {
        &self.ends
    }

    /// Whether a free end of the part is seen, at the pose looked at last.
    pub fn shows_end(&self) -> bool {
        self.ends.iter().flatten().flatten().any(|end| end.beyond_px.is_some())
    }

    /// Refines `start`, a [coarse](Refine::coarse) pose, with the grey values of both pictures. `None` where too little
    /// of the part is seen to hold it.
    pub fn fine(&mut self, model: &PoseModel, start: &Isometry3<f64>, views: &[View; 2]) -> Option<Fit> {
        let mut pose = *start;
        let mut last = None;
        for round in 0..self.params.fine_rounds {
            let (fit, shift_px) =
                self.round(model, &pose, views, if round == 0 { FINE_FIRST } else { FINE_NEXT })?;
            pose = fit.left_from_part;
            last = Some(fit);
            if shift_px < SETTLED_PX {
                break;
            }
        }
        last
    }

    /// As [`Refine::fine`], from a pose that is fine already, without asking where this end of the part is seen; then, with one
    /// more look, all ends are asked. A neighbour's end beside it may have been taken for it.
    pub fn without_end(
        &mut self,
        model: &PoseModel,
        start: &Isometry3<f64>,
        views: &[View; 2],
        end: usize,
    ) -> Option<Fit> {
        self.unasked_end = Some(end);
        let fit = self.fine(model, start, views);
        self.unasked_end = None;
        self.again(model, &fit?.left_from_part, views)
    }

    /// Refines a pose that is [fine](Refine::fine) already, or nearly so, with one more look. `None` where it is lost.
    pub fn again(&mut self, model: &PoseModel, start: &Isometry3<f64>, views: &[View; 2]) -> Option<Fit> {
        self.round(model, start, views, FINE_NEXT).map(|(fit, _)| fit)
    }

    /// One look at the grey values, and what it makes of a pose; with it how far that moved the wire, in pixels.
    fn round(
        &mut self,
        model: &PoseModel,
        start: &Isometry3<f64>,
        views: &[View; 2],
        (search_px, scales_px): (f64, [f64; 4]),
    ) -> Option<(Fit, f64)> {
        self.look(model, start, views, search_px, (1, EndLook::Close));
        self.observe_outlines(model, search_px);
        let mut left_from_part = *start;
        let Solution { step, misfit, believed, .. } = self.solve(model, &mut left_from_part, &scales_px)?;
        self.equations.step(&step);
        Some((Fit { left_from_part, misfit, believed }, self.shift(&step)))
    }

    fn sweep(&self, model: &PoseModel, pose: &Isometry3<f64>) -> Sweep {
        Sweep::new(self.equations.level(), model, pose, self.eye, self.params.lift_radii)
    }

    /// Moves the expected places by a step of the pose; gives the largest movement in pixels.
    fn shift(&mut self, step: &Vector6<f64>) -> f64 {
        let mut largest: f64 = 0.0;
        for sighting in self.sightings.iter_mut().flatten().flatten() {
            let moved = sighting.gradient.dot(step);
            sighting.expected_px += sighting.across * moved;
            if let Some(section) = &mut sighting.section {
                section.low_px = section.low_px.map(|l| l - moved);
                section.high_px = section.high_px.map(|h| h - moved);
            }
            largest = largest.max(moved.abs());
        }
        for end in self.ends.iter_mut().flatten().flatten() {
            let moved = end.gradient.dot(step);
            end.beyond_px = end.beyond_px.map(|b| b - moved);
            largest = largest.max(moved.abs());
        }
        largest
    }

    /// Looks at every `stride`th station and at the ends.
    fn look(
        &mut self,
        model: &PoseModel,
        pose: &Isometry3<f64>,
        views: &[View; 2],
        search_px: f64,
        (stride, how): (usize, EndLook),
    ) {
        let sweep = self.sweep(model, pose);
        let Self { sightings, outlines, .. } = self;
        sightings.clear();
        sightings.resize(model.stations.len().min(STATIONS_MAX), [None; 2]);
        let stations = model.stations.iter().take(STATIONS_MAX).step_by(stride);
        each_expected(&sweep, stations, views, |k, side, there| {
            let Expected { px, across, half_width_px, lift_px, gradient } = there;
            sightings[k * stride][side] = Some(Sighting {
                section: None,
                object: views[side].mask.get(nearest(px.x), nearest(px.y)),
                expected_px: px,
                across,
                half_width_px,
                lift_px,
                gradient,
            });
        });
        for sightings in sightings.chunks_mut(LINES / 2 * stride) {
            outlines.clear();
            for (side, s) in seen(sightings) {
                outlines.push(side, s.expected_px, s.across, s.half_width_px);
            }
            let sections = outlines.sections(profilers(views), search_px);
            seen(sightings).zip(sections).for_each(|((_, sighting), section)| sighting.section = *section);
        }
        self.look_at_ends(model, pose, views, search_px + 3.5, how);
    }

    /// Sets up the equations from what is seen.
    fn observe_outlines(&mut self, model: &PoseModel, search_px: f64) {
        let usual = [0, 1].map(|side| self.usual_width(model, side));
        let Self { equations, origins, sightings, ends, params, .. } = self;
        equations.clear();
        origins.clear();
        let mut each = |measurement: Measurement, origin| {
            // As many as the equations have room for.
            if origins.len() < MEASUREMENTS_MAX {
                equations.push(&measurement);
                origins.push(origin);
            }
        };
        measure_outlines(params, model, sightings, &usual, search_px, &mut each);
        measure_ends(params, ends, &mut each);
    }

    /// Seen width of the wire in one picture.
    fn usual_width(&mut self, model: &PoseModel, side: usize) -> UsualWidth {
        let Self { sightings, ratios, params, .. } = self;
        ratios.clear();
        let stations = model.stations.iter().zip(sightings.iter()).filter(|(station, _)| !station.at_joint);
        ratios.extend(stations.filter_map(|(_, seen)| {
            let sighting = seen[side].as_ref()?;
            sighting.section?.ratio(sighting.half_width_px)
        }));
        UsualWidth::of(ratios).unwrap_or(UsualWidth { ratio: params.outline_ratio, spread: 0.0 })
    }

    /// Moves `pose` by the step that explains the measurements while the residual at which belief has halved goes from
    /// the first of `scales_px` to the last.
    fn solve(&self, model: &PoseModel, pose: &mut Isometry3<f64>, scales_px: &[f64]) -> Option<Solution> {
        let scales: ArrayVec<f64, 4> = scales_px.iter().map(|px| px / self.params.section_sigma_px).collect();
        let solution = self.equations.solve(&Doubt {
            scales: &scales,
            shading_sigma_px: self.params.shading_sigma_px,
            along: model.straight_along.map(|a| pose.rotation * a),
            start_sigma: start_sigma(model.radius_mm),
        })?;
        *pose = moved(pose, &model.centre_mm, &solution.step);
        Some(solution)
    }

    /// Gives where the axis of the wire is expected at these stations, without looking: the index of the view, the place, and
    /// the unit vector across; nothing for what is behind a camera.
    pub fn expect<'a, const N: usize>(
        &self,
        model: &PoseModel,
        stations: impl Iterator<Item = &'a Station>,
        pose: &Isometry3<f64>,
        views: &[View; N],
        mut each: impl FnMut(usize, Vector2<f64>, Vector2<f64>),
    ) {
        let sweep = Sweep::new(self.equations.level(), model, pose, self.eye, 0.0);
        each_expected(&sweep, stations, views, |_, side, there| each(side, there.px, there.across));
    }

    /// Looks for wire at a place where the part has none, and gives what one picture shows there.
    pub fn look_beyond(
        &self,
        radius_mm: f64,
        point: &Point3<f64>,
        tangent: &Vector3<f64>,
        view: &View,
    ) -> Option<Sighting> {
        let lifted = point + up(&self.eye, point, tangent) * (self.params.lift_radii * radius_mm);
        let aim = aim(radius_mm, &lifted, tangent, view)?;
        Some(Sighting {
            section: view.profiler.across(aim.px, aim.across, aim.half_width_px, 1.0),
            object: view.mask.get(nearest(aim.px.x), nearest(aim.px.y)),
            expected_px: aim.px,
            across: aim.across,
            half_width_px: aim.half_width_px,
            ..Sighting::default()
        })
    }
}

/// All of both pictures that are there, with the picture.
fn seen<T>(of_both: &mut [[Option<T>; 2]]) -> impl Iterator<Item = (usize, &mut T)> {
    of_both
        .iter_mut()
        .flat_map(|both| both.iter_mut().enumerate())
        .filter_map(|(side, s)| Some((side, s.as_mut()?)))
}

fn profilers<'a>(views: &'a [View; 2]) -> [&'a Profiler<'a>; 2] {
    views.each_ref().map(|view| &view.profiler)
}

/// Gives where each station is expected, where that is in front of the camera: with its number and the picture.
#[inline(always)]
fn each_expected<'a, const N: usize>(
    sweep: &Sweep,
    stations: impl Iterator<Item = &'a Station>,
    views: &[View; N],
    mut each: impl FnMut(usize, usize, Expected),
) {
    let mut stations = stations.fuse();
    let mut first = 0;
    let mut expected = [Eight::NONE; N];
    loop {
        let eight: ArrayVec<&Station, LANES> = stations.by_ref().take(LANES).collect();
        if eight.is_empty() {
            return;
        }
        sweep.expect(&eight, views, &mut expected);
        for lane in 0..eight.len() {
            for (side, expected) in expected.iter().enumerate() {
                if let Some(there) = expected.get(lane) {
                    each(first + lane, side, there);
                }
            }
        }
        first += eight.len();
    }
}

/// `pose`, displaced and turned about the part's centre by a small twist in the left camera's axes.
pub(super) fn moved(pose: &Isometry3<f64>, centre_mm: &Point3<f64>, twist: &Vector6<f64>) -> Isometry3<f64> {
    let centre = (pose * centre_mm).coords;
    let shift: Vector3<f64> = twist.fixed_rows::<3>(0).into();
    let turn = Rotation3::new(Vector3::from(twist.fixed_rows::<3>(3)));
    let about_centre = Isometry3::from_parts(Translation3::from(centre + shift), turn.into());
    about_centre * Translation3::from(-centre) * pose
}
