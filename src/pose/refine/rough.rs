//! Rough poses, moved to where the pictures roughly have the part.

use nalgebra::{Isometry3, Vector6};

use super::equations::{Measurement, Solution};
use super::measure::measure_ends;
use super::{Refine, STATIONS_MAX, View, each_expected};
use crate::pose::end::EndLook;
use crate::pose::model::PoseModel;
use crate::pose::section::{is_sure, mask_run};

/// Once in so many thicknesses wire is looked at while the pose is rough, but at no fewer places than this, or at all there are.
const COARSE_THICKNESSES: usize = 3;
const COARSE_STATIONS_MIN: usize = 8;
/// A rough pose that moved by less than this, in radii of the wire, need not be moved again before it is refined.
const COARSE_SETTLED_RADII: f64 = 1.5;
/// How far the outlines are looked for around a rough pose, and the residuals at which belief has halved, in pixels.
const NEAR: (f64, [f64; 2]) = (3.5, [1.5, 0.5]);
/// From this misfit on the grey values around a rough pose are not those of its part.
const NEAR_MISFIT_MAX: f64 = 1.0;

impl Refine {
    /// Moves `start`, a rough pose, to where the binary pictures and the ends have it. `None` where too much of the wire is
    /// [missing](super::Params::missing_max) there: what moves the pose afterwards is pixels.
    pub fn coarse(
        &mut self,
        model: &PoseModel,
        start: &Isometry3<f64>,
        views: &[View; 2],
    ) -> Option<Isometry3<f64>> {
        let mut pose = *start;
        for round in 0..self.params.coarse_rounds {
            let (search_px, scale_px) = if round == 0 { (7.0, 4.0) } else { (4.0, 2.0) };
            self.observe_masks(model, &pose, views, search_px);
            // Where touching wires leave the mask nothing to say, the grey values may.
            let step = self.solve(model, &mut pose, &[scale_px; 2]).map(|solution| solution.step);
            if step.is_some_and(|step| reach_mm(model, &step) < COARSE_SETTLED_RADII * model.radius_mm) {
                break;
            }
        }
        (self.missing(model, &pose, views) <= self.params.missing_max).then_some(pose)
    }

    /// Moves `start`, a rough pose, to where the grey values near it have the part: where wires touch, the binary pictures
    /// may lead a [coarse](Refine::coarse) pose astray. `None` where no end is seen, and where a third or more of what is
    /// looked at says something else.
    pub fn near(
        &mut self,
        model: &PoseModel,
        start: &Isometry3<f64>,
        views: &[View; 2],
    ) -> Option<Isometry3<f64>> {
        let (search_px, scales_px) = NEAR;
        let stride = coarse_stride(model);
        self.look(model, start, views, search_px, (stride, EndLook::Quick));
        if !self.shows_end() {
            return None;
        }
        self.observe_outlines(model, search_px);
        let mut pose = *start;
        let Solution { misfit, believed, .. } = self.solve(model, &mut pose, &scales_px)?;
        let stations = model.stations.iter().take(STATIONS_MAX).step_by(stride).filter(|s| !s.at_joint);
        let ends = self.ends.iter().flatten().flatten().filter(|end| end.beyond_px.is_some());
        let looked = 2 * stations.count() + ends.count();
        (misfit < NEAR_MISFIT_MAX && 3 * believed > 2 * looked).then_some(pose)
    }

    /// Share of the wire, the mean of both pictures, where the masks have nothing.
    fn missing(&self, model: &PoseModel, pose: &Isometry3<f64>, views: &[View; 2]) -> f64 {
        let stations = model.stations.iter().step_by(2);
        let looked = 2 * stations.len();
        let mut there = 0;
        self.expect(model, stations, pose, views, |side, px, across| {
            there += usize::from(mask_run(views[side].mask, px, across, 2.0, 0.0).is_some());
        });
        (looked - there) as f64 / looked.max(1) as f64
    }

    fn observe_masks(&mut self, model: &PoseModel, pose: &Isometry3<f64>, views: &[View; 2], search_px: f64) {
        let sweep = self.sweep(model, pose);
        let Self { equations, params, .. } = self;
        equations.clear();
        let stations = model.stations.iter().take(STATIONS_MAX).step_by(coarse_stride(model));
        let stations = stations.filter(|s| !s.at_joint);
        each_expected(&sweep, stations, views, |_, side, there| {
            let View { mask, profiler, .. } = &views[side];
            let shadow_above = profiler.shadow_along(&there.across);
            let widest_px = 3.2 * there.half_width_px + 1.0;
            let run = mask_run(mask, there.px, there.across, search_px, widest_px);
            let Some((middle, width)) = run.filter(|(_, width)| *width <= widest_px) else {
                return;
            };
            // What is wider is the shadow beside it.
            let shadow_px =
                if is_sure(shadow_above) { (width - 2.0 * there.half_width_px).max(0.0) } else { 0.0 };
            let middle = middle - (shadow_px / 2.0).copysign(shadow_above);
            equations.push(&Measurement {
                residual_px: middle,
                gradient: there.gradient,
                sigma_px: 2.0 * params.section_sigma_px,
                patience: 1.0,
                shaded: model.straight_along.map(|_| side),
            });
        });
        self.look_at_ends(model, pose, views, search_px + 4.0, EndLook::Quick);
        let Self { equations, ends, params, .. } = self;
        measure_ends(params, ends, |measurement, _| equations.push(&measurement));
    }
}

/// Every so many stations are looked at while the pose is rough; all of bent parts, whose pieces are short, unless they are long.
fn coarse_stride(model: &PoseModel) -> usize {
    if model.straight_along.is_none() && model.per_thickness > 1 {
        return 1;
    }
    (COARSE_THICKNESSES * model.per_thickness).min(model.stations.len() / COARSE_STATIONS_MIN).max(1)
}

/// How far a small twist about the part's centre moves its ends, at most.
fn reach_mm(model: &PoseModel, twist: &Vector6<f64>) -> f64 {
    twist.fixed_rows::<3>(0).norm() + twist.fixed_rows::<3>(3).norm() * model.length_mm / 2.0
}

#[cfg(test)]
mod tests {
    use nalgebra::{Translation3, Vector3};

    use super::super::Params;
    use super::*;
    use crate::part::Part;
    use crate::pose::drawn::DrawnPair;

    #[test]
    fn a_rough_pose_half_of_which_lies_on_the_floor_is_none_though_an_end_of_it_is_seen() {
        let [short, long] = ["rod-60", "rod-90"].map(|name| {
            let file = format!("{}/replay/parts/{name}.toml", env!("CARGO_MANIFEST_DIR"));
            PoseModel::new(&Part::read(file).expect("a part"))
        });
        let lies = Isometry3::new(Vector3::new(0.0, 0.0, 470.0), Vector3::new(0.0, 0.0, 0.9));
        let drawn = DrawnPair::new(&[(&short, lies)]);
        let mut refine = Refine::new(Params { lift_radii: 0.0, ..Params::default() }, &drawn.rig);
        assert!(refine.coarse(&short, &lies, &drawn.views()).is_some());
        // From the same end on.
        let shift_mm = short.straight_mm[0][0] - long.straight_mm[0][0];
        assert_eq!(refine.coarse(&long, &(lies * Translation3::from(shift_mm)), &drawn.views()), None);
        assert!(refine.shows_end());
    }
}
