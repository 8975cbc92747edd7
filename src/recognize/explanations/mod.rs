//! Explanations of the wire: hypotheses refined, judged, and let compete for it.
//!
//! Takes hypotheses, fittest first, and both pictures; gives those that stand. Owns the explanations and the maps of what
//! they claim.

mod competition;
mod kin;

use arrayvec::ArrayVec;
use nalgebra::{Isometry3, Matrix6, Vector2, Vector3};

use super::lamp::Light;
use super::prepared::{Prepared, SAME_END_PX};
use crate::matching::claims::ClaimMap;
use crate::matching::fitness::{UNMATCHED, Weights};
use crate::matching::hypotheses::Hypothesis;
use crate::matching::nodes::{ImageNode, NodeRole};
use crate::matching::problem::StereoNode;
use crate::matching::select::{self, Worth};
use crate::part::NODES_MAX;
use crate::pose::model::PoseModel;
use crate::pose::refine::{self, EndSighting, Fit, Refine, TurnSeen, View};
use crate::pose::verify::{Verdict, verify};
use crate::rig::Rig;
use crate::time::Watch;

/// Most explanations of a pair.
const EXPLANATIONS_MAX: usize = 1024;
/// Most coarse poses of a pair that are known to have been refined.
const REFINED_MAX: usize = 4096;
/// From this misfit on one of a part's ends may not be what it was taken for; and to which share of it another fit must bring it.
const DOUBTFUL_MISFIT: f64 = 1.1;
const BETTER_MISFIT: f64 = 0.8;
/// Two refined poses nearer than this are one.
const SAME_MM: f64 = 1.0;
/// A rough pose this near to a refined one would lead to it: where that is doubtful, where it is sound.
const SAME_ROUGH_MM: [f64; 2] = [2.0, 8.0];
/// The same for a coarse pose.
const SAME_COARSE_MM: [f64; 2] = [1.0, 8.0];
/// Two coarse poses nearer than this are refined to the same.
const SAME_START_MM: f64 = 0.5;
/// At how many places of a part at least it is asked whether its wire need be explained again, if it has as many stations.
const PROBES_MIN: usize = 8;

/// An explanation of some wire: a refined hypothesis.
pub(super) struct Explanation {
    pub(super) hypothesis: Hypothesis,
    pub(super) fit: Fit,
    pub(super) verdict: Verdict,
    /// See [`Spread`](crate::pose::refine::Spread).
    pub(super) covariance: Matrix6<f64>,
    /// What it says of the rig.
    pub(super) turn: TurnSeen,
    /// How the light lies on its wire, where it stands in the end.
    pub(super) light: Light,
    /// By how much it was moved for the lamp, mm, in the left camera's frame.
    pub(super) beside_mm: Vector3<f64>,
    /// Whether it is proved, see [`select::is_proven`], where it stands in the end.
    pub(super) is_proven: bool,
    /// Where its free ends are expected, left and right, that both pictures show.
    ends_px: ArrayVec<[Vector2<f64>; 2], NODES_MAX>,
    /// Whether these ends are known to be its own.
    has_ends: bool,
    /// How far wire goes on beyond it that is not known to be another's, as was last asked.
    pub(super) overrun_mm: f64,
    /// Whether its wire has been claimed before the competition.
    has_claimed: bool,
    /// Whether its wire is settled for all parts that are not longer.
    is_settled: bool,
    /// How wide its wire is seen in its light, where that may tell it from another part.
    width_ratio: Option<f64>,
    /// How far that is from how wide wire is seen in this pair, as a logarithm.
    unusual_ln: f64,
    /// What it is worth with nothing claimed.
    alone: Worth,
    /// How many stood when it was last asked what it is worth, and what it was worth then.
    worth: (u32, Worth),
    /// What it was worth when it stood, but for wire that goes on beyond it.
    stood_mm: f64,
    /// Whether it may not stand any more, and whether it is tried how the others fare without it.
    is_dropped: bool,
    is_left_out: bool,
}

/// What hypotheses are held against.
pub(super) struct Scene<'a> {
    pub(super) rig: &'a Rig,
    pub(super) parts: &'a [Prepared],
    /// Parts of this fitness or more are none.
    pub(super) fitness_max: f64,
    pub(super) weights: &'a Weights,
    pub(super) views: [View<'a>; 2],
    /// Nodes of the left and the right picture.
    pub(super) image_nodes: [&'a [ImageNode]; 2],
    /// Nodes of the search.
    pub(super) stereo_nodes: &'a [StereoNode],
    /// Unit vector downwards in the left camera's frame, and how steep wire may be.
    pub(super) down: Vector3<f64>,
    pub(super) slope_rad_max: f64,
}

/// A coarse pose that was refined.
struct Refined {
    part: usize,
    coarse: Isometry3<f64>,
    /// Index of the explanation that it led to, if any.
    led_to: Option<usize>,
}

/// Workspace.
pub(super) struct Explanations {
    refine: Refine,
    /// The first `count` are of this pair; the others keep their memory.
    list: Vec<Explanation>,
    count: usize,
    claims: [ClaimMap; 2],
    /// For every part of the list, the wire in the left picture that it need not explain again.
    settled: Vec<ClaimMap>,
    /// For each part whether it has kin.
    have_kin: Vec<bool>,
    /// How wide wire is seen in this pair, over how wide as a rule, as a logarithm; for parts that have kin.
    usual_width_ln: f64,
    /// For image nodes, left and right, the longest part recognised for certain that ends there.
    ends_taken: [Vec<Option<usize>>; 2],
    /// Coarse poses that show no end.
    endless: Vec<(Hypothesis, Isometry3<f64>)>,
    /// Coarse poses that were refined.
    refined: Vec<Refined>,
    /// Indices of those that stand, the most valuable first.
    standing: Vec<usize>,
    /// Of how many explanations these are; `None` before the competition, and where some were refused.
    decided: Option<usize>,
    /// Indices of those that stood before one was left out.
    tried: Vec<usize>,
    /// Indices of those that might stand in the place of others.
    rivals: Vec<usize>,
}

impl Explanations {
    /// Reserves all memory.
    pub(super) fn new(params: refine::Params, rig: &Rig, nodes_max: usize, parts: &[Prepared]) -> Self {
        let most = |count: fn(&Prepared) -> usize| parts.iter().map(count).max().unwrap_or(0);
        let (stations, stops) = (most(Prepared::stations_max), most(|p| p.stops.len()));
        let blank = || Explanation {
            hypothesis: Hypothesis::default(),
            fit: Fit::default(),
            verdict: Verdict::with_room(stations.min(refine::STATIONS_MAX), stops),
            covariance: Matrix6::zeros(),
            turn: TurnSeen::default(),
            light: Light::default(),
            beside_mm: Vector3::zeros(),
            is_proven: false,
            ends_px: ArrayVec::new(),
            has_ends: false,
            overrun_mm: 0.0,
            has_claimed: false,
            is_settled: false,
            width_ratio: None,
            unusual_ln: 0.0,
            alone: Worth::NONE,
            worth: (0, Worth::NONE),
            stood_mm: 0.0,
            is_dropped: false,
            is_left_out: false,
        };
        Self {
            refine: Refine::new(params, rig),
            list: std::iter::repeat_with(blank).take(EXPLANATIONS_MAX).collect(),
            count: 0,
            claims: [&rig.left, &rig.right].map(|c| ClaimMap::new(c.width, c.height)),
            settled: parts.iter().map(|_| ClaimMap::new(rig.left.width, rig.left.height)).collect(),
            have_kin: kin::have_kin(parts),
            usual_width_ln: 0.0,
            ends_taken: [0, 1].map(|_| Vec::with_capacity(nodes_max)),
            endless: Vec::with_capacity(EXPLANATIONS_MAX),
            refined: Vec::with_capacity(REFINED_MAX),
            standing: Vec::with_capacity(EXPLANATIONS_MAX),
            decided: None,
            tried: Vec::with_capacity(EXPLANATIONS_MAX),
            rivals: Vec::with_capacity(EXPLANATIONS_MAX),
        }
    }

    /// Forgets the last pair; the next poses are refined with these.
    pub(super) fn clear(&mut self, params: refine::Params, image_nodes: [&[ImageNode]; 2]) {
        self.refine.set_params(params);
        self.count = 0;
        self.refined.clear();
        self.decided = None;
        self.claims.iter_mut().chain(&mut self.settled).for_each(ClaimMap::clear);
        for (taken, nodes) in self.ends_taken.iter_mut().zip(image_nodes) {
            taken.clear();
            taken.resize(nodes.len(), None);
        }
    }

    /// What is claimed: until the competition by what is certain, sound or whole, then by what stands.
    pub(super) fn claims(&self) -> &[ClaimMap; 2] {
        &self.claims
    }

    /// Refines and judges hypotheses, each pose once; says whether there was time and room for all. Wire and ends that a
    /// certain explanation has are not explained again, unless by a longer part, of which it may be a piece; and poses that
    /// show no end are looked at last, where no sound explanation has their wire. A count of iterations is for the
    /// searches: what they find is always looked at. Poses are made coarse with the binary pictures; where these have been
    /// asked before and have not explained all, `again`, with the grey values near them if possible.
    pub(super) fn explain(
        &mut self,
        scene: &Scene,
        pool: &[Hypothesis],
        again: bool,
        looking: &mut Watch,
    ) -> bool {
        self.endless.clear();
        for hypothesis in pool {
            if looking.is_over() {
                return false;
            }
            let prepared = &scene.parts[hypothesis.part];
            let rough = &hypothesis.left_from_part;
            if self.takes_taken_end(scene, hypothesis)
                || self.is_explained(scene, hypothesis.part, rough)
                || prepared.place_among(self.all(), hypothesis.part, rough, SAME_ROUGH_MM).is_some()
            {
                continue;
            }
            let model = prepared.pose_model();
            let near = again.then(|| self.refine.near(model, rough, &scene.views)).flatten();
            let Some(pose) = near.or_else(|| self.refine.coarse(model, rough, &scene.views)) else {
                continue;
            };
            if !self.refine.shows_end() && self.endless.len() < EXPLANATIONS_MAX {
                self.endless.push((*hypothesis, pose));
            } else {
                self.conclude(scene, hypothesis, &pose, looking);
            }
        }
        self.claim_sound(0, scene.parts);
        let known = self.count;
        let endless = std::mem::take(&mut self.endless);
        let mut in_time = true;
        for (hypothesis, pose) in &endless {
            in_time = !looking.is_over();
            if !in_time {
                break;
            }
            if !self.is_explained(scene, hypothesis.part, pose) {
                self.conclude(scene, hypothesis, pose, looking);
            }
        }
        self.endless = endless;
        self.claim_sound(known, scene.parts);
        in_time && self.count < EXPLANATIONS_MAX
    }

    /// Follows a coarse pose to where it leads, each but once.
    fn conclude(
        &mut self,
        scene: &Scene,
        hypothesis: &Hypothesis,
        coarse: &Isometry3<f64>,
        looking: &mut Watch,
    ) {
        if self.count == EXPLANATIONS_MAX {
            return;
        }
        let (part, prepared) = (hypothesis.part, &scene.parts[hypothesis.part]);
        let is_same = |r: &&Refined| r.part == part && prepared.is_near(&r.coarse, coarse, SAME_START_MM);
        let near = prepared.place_among(self.all(), part, coarse, SAME_COARSE_MM);
        let known = near.map(Some).or_else(|| Some(self.refined.iter().find(is_same)?.led_to));
        if let Some(led_to) = known {
            if let Some(index) = led_to {
                self.arrive_at(index, scene);
            }
            return;
        }
        let led_to = self.refine_to(scene, hypothesis, coarse, looking);
        if self.refined.len() < REFINED_MAX {
            self.refined.push(Refined { part, coarse: *coarse, led_to });
        }
    }

    /// Refines a coarse pose and notes what comes of it: the index of the explanation, if it is one.
    fn refine_to(
        &mut self,
        scene: &Scene,
        hypothesis: &Hypothesis,
        coarse: &Isometry3<f64>,
        looking: &mut Watch,
    ) -> Option<usize> {
        let prepared = &scene.parts[hypothesis.part];
        let model = prepared.pose_model();
        let mut fit = self.refine.fine(model, coarse, &scene.views)?;
        if fit.misfit > DOUBTFUL_MISFIT {
            fit = self.refit(model, coarse, fit, scene, looking)?;
        }
        let pose = &fit.left_from_part;
        if prepared.is_too_steep(pose, &scene.down, scene.slope_rad_max) {
            return None;
        }
        if let Some(index) = prepared.place_among(self.all(), hypothesis.part, pose, [SAME_MM; 2]) {
            self.arrive_at(index, scene);
            return Some(index);
        }
        let explanation = &mut self.list[self.count];
        (explanation.hypothesis, explanation.fit, explanation.unusual_ln) = (*hypothesis, fit, 0.0);
        (explanation.has_ends, explanation.has_claimed, explanation.is_settled) = (false, false, false);
        let verdict = &mut explanation.verdict;
        verify(&self.refine, model, &prepared.stops, &fit.left_from_part, &scene.views, verdict);
        let fitness = |unseen: usize| verdict.terms(unseen).fitness(scene.weights);
        if fitness(prepared.part.nodes.len()) >= scene.fitness_max
            && fitness(prepared.unseen(scene.rig, pose, scene.image_nodes)) >= scene.fitness_max
        {
            return None;
        }
        explanation.overrun_mm = verdict.overrun_mm;
        let spread = self.refine.spread(model, &fit, &scene.views);
        (explanation.covariance, explanation.turn) = (spread.covariance, spread.turn);
        explanation.ends_px.clear();
        for end in self.refine.ends() {
            if let [Some(left), Some(right)] = end
                && left.beyond_px.is_some()
                && right.beyond_px.is_some()
            {
                let _ = explanation.ends_px.try_push([left.expected_px, right.expected_px]);
            }
        }
        let index = self.count;
        self.list[index].width_ratio = self.width_in_its_light(index, scene);
        self.count += 1;
        if select::is_certain(&fit, &self.list[index].verdict, model.ends.len()) {
            self.claim(index);
            self.settle(index, scene.parts);
            self.take_ends(index, scene);
        }
        self.claim_anchored(scene.parts);
        Some(index)
    }

    /// A fit that explains the pictures much better than a doubtful one, where one of the ends is not what it was taken for; else the
    /// doubtful one. `None` where time is over.
    fn refit(
        &mut self,
        model: &PoseModel,
        coarse: &Isometry3<f64>,
        doubtful: Fit,
        scene: &Scene,
        looking: &mut Watch,
    ) -> Option<Fit> {
        let is_shown = |[left, right]: &[Option<EndSighting>; 2]| {
            [left, right].into_iter().flatten().any(|end| end.beyond_px.is_some())
        };
        let ends = self.refine.ends().iter().enumerate().filter(|(_, end)| is_shown(end));
        let shown: ArrayVec<usize, NODES_MAX> = ends.map(|(index, _)| index).collect();
        if shown.len() < 2 {
            return Some(doubtful);
        }
        let start = &doubtful.left_from_part;
        let mut best = None;
        let mut least = BETTER_MISFIT * doubtful.misfit;
        for end in shown {
            if looking.is_over() {
                return None;
            }
            if let Some(fit) = self.refine.without_end(model, start, &scene.views, end)
                && fit.misfit < least
                && fit.believed >= doubtful.believed
            {
                (best, least) = (Some(fit.left_from_part), fit.misfit);
            }
        }
        // What is seen is what is seen from there.
        let again = best.and_then(|pose| self.refine.again(model, &pose, &scene.views));
        again.or_else(|| self.refine.fine(model, coarse, &scene.views))
    }

    /// Another hypothesis has led to this explanation. Where both pictures show an end of it, what starts from that end
    /// leads here, and need not be looked at again.
    fn arrive_at(&mut self, index: usize, scene: &Scene) {
        let Explanation { fit, verdict, has_ends, .. } = &self.list[index];
        if !has_ends && select::is_anchored(fit, verdict, 0.0) {
            self.take_ends(index, scene);
        }
    }

    /// The ends of an explanation that both pictures show are those of no part that is not longer.
    fn take_ends(&mut self, index: usize, scene: &Scene) {
        let Explanation { hypothesis, ends_px, has_ends, .. } = &mut self.list[index];
        *has_ends = true;
        let length_mm = |part: usize| scene.parts[part].pose_model().length_mm;
        for end in ends_px {
            for (side, px) in end.iter().enumerate() {
                if let Some(n) = nearest_end(scene.image_nodes[side], px) {
                    let taken = &mut self.ends_taken[side][n];
                    let is_longer = taken.is_none_or(|by| length_mm(by) < length_mm(hypothesis.part));
                    *taken = if is_longer { Some(hypothesis.part) } else { *taken };
                }
            }
        }
    }

    /// Claims the wire of all explanations that are held along it. A claim may be what tells whose wire it is that goes on
    /// beyond another one.
    fn claim_anchored(&mut self, parts: &[Prepared]) {
        loop {
            let claims = &self.claims;
            let is_anchored = |e: &mut Explanation| {
                !e.has_claimed && {
                    let model = parts[e.hypothesis.part].pose_model();
                    e.overrun_mm = select::unclaimed_overrun_mm(model, &e.verdict, claims);
                    select::is_anchored(&e.fit, &e.verdict, e.overrun_mm)
                }
            };
            let Some(index) = self.list[..self.count].iter_mut().position(is_anchored) else { return };
            self.claim_first(index);
            let Explanation { hypothesis, verdict, .. } = &self.list[index];
            self.settled[hypothesis.part].claim(verdict.pieces.iter().map(|[left, _]| left));
        }
    }

    fn all(&self) -> &[Explanation] {
        &self.list[..self.count]
    }

    /// Claims the wire of an explanation before the competition.
    fn claim_first(&mut self, index: usize) {
        self.list[index].has_claimed = true;
        self.claim(index);
    }

    fn claim(&mut self, index: usize) {
        for (side, claims) in self.claims.iter_mut().enumerate() {
            claims.claim(self.list[index].verdict.pieces.iter().map(|piece| &piece[side]));
        }
    }

    /// No part that is not longer, but for its kin, need explain the wire of an explanation again.
    fn settle(&mut self, index: usize, parts: &[Prepared]) {
        if std::mem::replace(&mut self.list[index].is_settled, true) {
            return;
        }
        let Explanation { hypothesis, verdict, .. } = &self.list[index];
        for (settled, part) in self.settled.iter_mut().zip(parts) {
            if parts[hypothesis.part].settles_for(part) {
                settled.claim(verdict.pieces.iter().map(|[left, _]| left));
            }
        }
    }

    /// Claims the wire of all explanations from `first` on that nothing speaks against.
    fn claim_sound(&mut self, first: usize, parts: &[Prepared]) {
        for index in first..self.count {
            let Explanation { fit, verdict, overrun_mm, has_claimed, .. } = &self.list[index];
            if select::is_sound(fit, verdict, *overrun_mm) {
                if !has_claimed {
                    self.claim_first(index);
                }
                self.settle(index, parts);
            }
        }
    }

    fn takes_taken_end(&self, scene: &Scene, hypothesis: &Hypothesis) -> bool {
        let prepared = &scene.parts[hypothesis.part];
        let mut nodes = hypothesis.nodes.iter().filter(|n| **n != UNMATCHED);
        nodes.any(|&n| self.has_end(&scene.stereo_nodes[n as usize], prepared, scene.parts))
    }

    /// Whether a node is an end of an explanation that is held by it, and whose part is not shorter than this one, nor its kin.
    pub(super) fn has_end(&self, node: &StereoNode, prepared: &Prepared, parts: &[Prepared]) -> bool {
        let taken = [self.ends_taken[0][node.left as usize], self.ends_taken[1][node.right as usize]];
        taken.into_iter().flatten().any(|by| parts[by].settles_for(prepared))
    }

    /// Whether most of the wire that a part at a pose would explain need not be explained again.
    fn is_explained(&self, scene: &Scene, part: usize, pose: &Isometry3<f64>) -> bool {
        let model = scene.parts[part].pose_model();
        let settled = &self.settled[part];
        let stations = &model.stations;
        let probes = stations.iter().step_by((stations.len() / PROBES_MIN).max(1));
        let (probed, mut claimed) = (probes.len(), 0);
        let left = std::array::from_ref(&scene.views[0]);
        self.refine.expect(model, probes, pose, left, |_, px, across| {
            claimed += usize::from(settled.is_claimed_at(&px, &across));
        });
        2 * claimed > probed
    }
}

/// The end of a picture at a place: the nearest, for another wire may end beside it.
fn nearest_end(nodes: &[ImageNode], at: &Vector2<f64>) -> Option<usize> {
    let distance_px = |node: &ImageNode| (node.position_px - at).norm();
    (0..nodes.len())
        .filter(|&n| nodes[n].role == NodeRole::End && distance_px(&nodes[n]) < SAME_END_PX)
        .min_by(|&a, &b| distance_px(&nodes[a]).total_cmp(&distance_px(&nodes[b])))
}

#[cfg(test)]
mod tests;
