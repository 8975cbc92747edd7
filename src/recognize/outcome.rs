//! From explanations to the outcome: which parts there are, which can be taken, in which order.

use arrayvec::ArrayVec;
use nalgebra::Vector3;

use super::explanations::Explanation;
use super::found::found;
use super::interrupted::is_interrupted;
use super::lamp::{lamp_radii, seen_lower_radii};
use super::result::{FoundPart, NoPick, PARTS_MAX, Recognition};
use super::unknown::Taken;
use super::views::views;
use super::{Recognizer, rig_of};
use crate::frame::FramePair;
use crate::grasp::{self, Blocked, Grasp, Placed};
use crate::time::Watch;

impl Recognizer {
    /// Lets the explanations compete; those that stand are the parts. Says whether there was time for it.
    pub(super) fn compete(
        &mut self,
        pair: &FramePair,
        exchanging: &mut Watch,
        out: &mut Recognition,
    ) -> bool {
        let Self { explanations, parts, scales, pictures, params, lighting, .. } = self;
        let rig = rig_of(scales, pictures);
        let Some(views) = views(pictures, rig, pair, *lighting) else { return true };
        let in_time = explanations.decide(parts, &params.select, &views, exchanging);
        explanations.press_apart(parts, &grasp::down_in_left(&params.grasp), &views);
        let prepared = |e: &Explanation| &parts[e.hypothesis.part];
        let lights = explanations.standing().map(|e| &e.light);
        let lamp_radii = lamp_radii(lights);
        let camera_px = f64::from(1 << pictures[0].halvings());
        let lower_radii = |e: &Explanation| match e.verdict.pieces.first() {
            Some([left, right]) if lighting.dark => {
                seen_lower_radii(camera_px * f64::midpoint(left.half_width_px, right.half_width_px))
            }
            _ => 0.0,
        };
        let beside = explanations.standing().map(|e| {
            let seen_radii = e.light.displaced(&lamp_radii) + Vector3::z() * lower_radii(e);
            seen_radii * -prepared(e).pose_model().radius_mm
        });
        let beside_mm: ArrayVec<Vector3<f64>, PARTS_MAX> = beside.collect();
        explanations.displace(beside_mm.iter());
        let standing = explanations.standing();
        out.parts.extend(standing.map(|explanation| {
            found(params, rig, pictures, prepared(explanation), explanation, out.spent.iterations)
        }));
        in_time
    }

    /// Finds what is blocked and ranks; was there no time for all, what does not stand alone is blocked.
    pub(super) fn grasp(&mut self, pair: &FramePair, in_time: bool, out: &mut Recognition) {
        let Self { parts, params, scales, pictures, explanations, unknown, lighting, .. } = self;
        let rig = rig_of(scales, pictures);
        let views = views(pictures, rig, pair, *lighting);
        let placed: ArrayVec<Placed, PARTS_MAX> =
            out.parts.iter().map(|f| parts[f.part].placed(&f.left_from_part, f.sigma_mm)).collect();
        let mut blocked = [None; PARTS_MAX];
        let mut grasps: ArrayVec<Grasp, PARTS_MAX> = out.parts.iter().map(|f| f.grasp).collect();
        grasp::blocked(&params.grasp, &placed, &mut grasps, &mut blocked);
        drop(placed);
        let turned = out.turned.is_some_and(|turned| turned.doubt.is_some()).then_some(Blocked::Turned);
        if in_time && !out.parts.is_empty() {
            unknown.find(pictures, explanations.claims());
        }
        let judged = grasps.iter().zip(blocked).zip(explanations.standing());
        for (found, ((grasp, blocked), explanation)) in out.parts.iter_mut().zip(judged) {
            if grasp.slid_mm != 0.0 {
                found.slide_to(grasp, &params.grasp, &parts[found.part], explanation);
            }
            let uncertain = match found.proven {
                true => (!params.grasp.is_certain(&found.sigma_mm)).then_some(Blocked::Uncertain),
                false => Some(Blocked::Unproven),
            };
            found.blocked = blocked.or(uncertain).or(turned).or_else(|| {
                let prepared = &parts[found.part];
                if views.as_ref().is_some_and(|v| is_interrupted(prepared.pose_model(), explanation, v)) {
                    return Some(Blocked::Unknown);
                }
                let taken = Taken { params: &params.grasp, rig, prepared, explanation, found };
                match in_time {
                    true => unknown
                        .is_in_the_way(&taken, pictures, explanations.claims())
                        .then_some(Blocked::Unknown),
                    false => {
                        (!taken.stands_alone(pictures, explanations.claims())).then_some(Blocked::OutOfTime)
                    }
                }
            });
        }
        // What was moved since it was judged may show a node less. It is in the way of others none the less.
        out.parts.retain(|f| f.fitness < params.search.fitness_max);
        // What is free of others comes before what may have something on it, and that which may not be there at all last. What has no
        // room is mostly free of others, proven or not; what is proven and covered hardly ever.
        let rank = |f: &FoundPart| match f.blocked {
            None => 0,
            Some(Blocked::Covered | Blocked::Uncertain) if !f.proven => 4,
            Some(Blocked::Covered) => 3,
            Some(Blocked::Uncertain | Blocked::Unproven) => 2,
            Some(_) => 1,
        };
        // An unstable sort allocates nothing; places settle ties the same way every time.
        let place = |f: &FoundPart| f.left_from_part.translation.z;
        out.parts.sort_unstable_by(|a, b| {
            rank(a)
                .cmp(&rank(b))
                .then(b.proven.cmp(&a.proven))
                .then(b.sound.cmp(&a.sound))
                .then(b.clear.total_cmp(&a.clear))
                .then(place(a).total_cmp(&place(b)))
        });
    }

    pub(super) fn no_pick(&self, out: &Recognition) -> Option<NoPick> {
        if out.parts.iter().any(|p| p.blocked.is_none()) {
            return None;
        }
        Some(if out.out_of_time {
            NoPick::OutOfTime
        } else if !out.parts.is_empty() {
            NoPick::AllBlocked
        } else if self.pictures.iter().all(|p| p.graph().edges.is_empty()) {
            NoPick::BinEmpty
        } else {
            NoPick::NothingRecognised
        })
    }
}
