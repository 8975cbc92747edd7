//! Explanations of the wire: hypotheses refined, judged, and let compete for it.
//!
//! Takes hypotheses, fittest first, and both pictures; gives those that stand. Owns the explanations and the maps of what
//! they claim.

use arrayvec::ArrayVec;
use nalgebra::{Isometry3, Matrix6, Vector2, Vector3};

use super::prepared::Prepared;
use crate::matching::fitness::UNMATCHED;
use crate::matching::hypotheses::Hypothesis;
use crate::matching::nodes::{ImageNode, NodeRole};
use crate::matching::problem::StereoNode;
use crate::matching::select::{self, ClaimMap, Worth};
use crate::part::NODES_MAX;
use crate::pose::contact::{self, Placed};
use crate::pose::over;
use crate::pose::refine::{self, Fit, Refine, View};
use crate::pose::shading::Shading;
use crate::pose::slide;
use crate::pose::verify::{Verdict, verify};
use crate::rig::Rig;
use crate::time::Budget;

/// Most explanations of a pair.
const EXPLANATIONS_MAX: usize = 1024;
/// Two refined poses nearer than this are one.
const SAME_MM: f64 = 1.0;
/// A rough pose this near to a refined one would lead to it: where that is doubtful, where it is sound.
const SAME_ROUGH_MM: [f64; 2] = [2.0, 8.0];
/// The same for a coarse pose.
const SAME_COARSE_MM: [f64; 2] = [1.0, 8.0];
/// How often one that stands is dropped for others, at most.
const EXCHANGES_MAX: usize = 8;
/// By how much the others must be worth more together, and what each more must be worth besides, in mm of wire: of two ways to
/// explain the wire, that with fewer parts is likelier.
const EXCHANGE_MM: f64 = 1.0;
const PART_MM: f64 = 10.0;
/// Distance in pixels within which an image node is a part's end.
pub(super) const SAME_END_PX: f64 = 5.0;

/// An explanation of some wire: a refined hypothesis.
pub(super) struct Explanation {
    pub(super) hypothesis: Hypothesis,
    pub(super) fit: Fit,
    pub(super) verdict: Verdict,
    /// See [`Refine::covariance`].
    pub(super) covariance: Matrix6<f64>,
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
    pub(super) parts: &'a [Prepared],
    pub(super) views: [View<'a>; 2],
    /// Nodes of the left and the right picture.
    pub(super) image_nodes: [&'a [ImageNode]; 2],
    /// Nodes of the search.
    pub(super) stereo_nodes: &'a [StereoNode],
    /// Unit vector downwards in the left camera's frame, and how steep wire may be.
    pub(super) down: Vector3<f64>,
    pub(super) slope_rad_max: f64,
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
    /// For image nodes, left and right, the length in mm of the longest part recognised for certain that ends there.
    ends_taken: [Vec<f64>; 2],
    /// Coarse poses that show no end.
    endless: Vec<(Hypothesis, Isometry3<f64>)>,
    /// Those that stand, the most valuable first, and of how many explanations; `None` where that is not known yet.
    standing: (Option<usize>, Vec<usize>),
    /// Indices of those that stood before one was left out.
    tried: Vec<usize>,
    /// Indices of those that might stand in the place of others.
    rivals: Vec<usize>,
}

impl Explanations {
    /// Reserves all memory.
    pub(super) fn new(params: refine::Params, rig: &Rig, nodes_max: usize, parts: &[Prepared]) -> Self {
        let most = |count: fn(&Prepared) -> usize| parts.iter().map(count).max().unwrap_or(0);
        let (stations, stops) = (most(|p| p.pose_model.stations.len()), most(|p| p.stops.len()));
        let blank = || Explanation {
            hypothesis: Hypothesis::default(),
            fit: Fit::default(),
            verdict: Verdict::with_room(stations.min(refine::STATIONS_MAX), stops),
            covariance: Matrix6::zeros(),
            ends_px: ArrayVec::new(),
            has_ends: false,
            overrun_mm: 0.0,
            has_claimed: false,
            is_settled: false,
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
            ends_taken: [0, 1].map(|_| Vec::with_capacity(nodes_max)),
            endless: Vec::with_capacity(EXPLANATIONS_MAX),
            standing: (None, Vec::with_capacity(EXPLANATIONS_MAX)),
            tried: Vec::with_capacity(EXPLANATIONS_MAX),
            rivals: Vec::with_capacity(EXPLANATIONS_MAX),
        }
    }

    /// Forgets the last pair.
    pub(super) fn clear(&mut self, image_nodes: [&[ImageNode]; 2]) {
        self.count = 0;
        self.standing.0 = None;
        self.claims.iter_mut().chain(&mut self.settled).for_each(ClaimMap::clear);
        for (taken, nodes) in self.ends_taken.iter_mut().zip(image_nodes) {
            taken.clear();
            taken.resize(nodes.len(), 0.0);
        }
    }

    /// What light does to the outlines.
    pub(super) fn shading(&self) -> Shading {
        *self.refine.shading()
    }

    /// What is claimed: until the competition by what is certain, sound or whole, then by what stands.
    pub(super) fn claims(&self) -> &[ClaimMap; 2] {
        &self.claims
    }

    /// Refines and judges hypotheses, each pose once; says whether there was time and room for all. Wire and ends that a certain
    /// explanation has are not explained again, unless by a longer part, of which it may be a piece; and poses that show no
    /// end are looked at last, where no sound explanation has their wire. A count of iterations is for the searches: what they find is always looked at.
    pub(super) fn explain(&mut self, scene: &Scene, pool: &[Hypothesis], budget: Budget) -> bool {
        self.endless.clear();
        for hypothesis in pool {
            if budget.is_over() {
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
            let Some(pose) = self.refine.coarse(&prepared.pose_model, rough, &scene.views) else { continue };
            if !self.refine.shows_end() && self.endless.len() < EXPLANATIONS_MAX {
                self.endless.push((*hypothesis, pose));
            } else {
                self.conclude(scene, hypothesis, &pose);
            }
        }
        self.claim_sound(0, scene.parts);
        let known = self.count;
        let endless = std::mem::take(&mut self.endless);
        let mut in_time = true;
        for (hypothesis, pose) in &endless {
            in_time = !budget.is_over();
            if !in_time {
                break;
            }
            if !self.is_explained(scene, hypothesis.part, pose) {
                self.conclude(scene, hypothesis, pose);
            }
        }
        self.endless = endless;
        self.claim_sound(known, scene.parts);
        in_time && self.count < EXPLANATIONS_MAX
    }

    /// Refines a coarse pose and notes what comes of it.
    fn conclude(&mut self, scene: &Scene, hypothesis: &Hypothesis, pose: &Isometry3<f64>) {
        let prepared = &scene.parts[hypothesis.part];
        let model = &prepared.pose_model;
        if self.count == EXPLANATIONS_MAX {
            return;
        }
        if let Some(index) = prepared.place_among(self.all(), hypothesis.part, pose, SAME_COARSE_MM) {
            self.arrive_at(index, scene);
            return;
        }
        let Some(fit) = self.refine.fine(model, pose, &scene.views) else { return };
        let pose = &fit.left_from_part;
        if prepared.is_too_steep(pose, &scene.down, scene.slope_rad_max) {
            return;
        }
        if let Some(index) = prepared.place_among(self.all(), hypothesis.part, pose, [SAME_MM; 2]) {
            self.arrive_at(index, scene);
            return;
        }
        let explanation = &mut self.list[self.count];
        (explanation.hypothesis, explanation.fit) = (*hypothesis, fit);
        (explanation.has_ends, explanation.has_claimed, explanation.is_settled) = (false, false, false);
        let verdict = &mut explanation.verdict;
        verify(&self.refine, model, &prepared.stops, &fit.left_from_part, &scene.views, verdict);
        explanation.overrun_mm = verdict.overrun_mm;
        explanation.covariance = self.refine.covariance(model, &fit);
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
        self.count += 1;
        if select::is_certain(&fit, &self.list[index].verdict, model.ends.len()) {
            self.claim(index);
            self.settle(index, scene.parts);
            self.take_ends(index, scene);
        }
        self.claim_anchored(scene.parts);
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
        let length_mm = scene.parts[hypothesis.part].pose_model.length_mm;
        for end in ends_px {
            for (side, px) in end.iter().enumerate() {
                take_end(scene.image_nodes[side], px, &mut self.ends_taken[side], length_mm);
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
                    let model = &parts[e.hypothesis.part].pose_model;
                    e.overrun_mm = select::unclaimed_overrun_mm(model, &e.verdict, claims);
                    select::is_anchored(&e.fit, &e.verdict, e.overrun_mm)
                }
            };
            let Some(index) = self.list[..self.count].iter_mut().position(is_anchored) else { return };
            self.claim(index);
            let Explanation { hypothesis, verdict, .. } = &self.list[index];
            settle_for(&mut self.settled[hypothesis.part], verdict);
        }
    }

    fn all(&self) -> &[Explanation] {
        &self.list[..self.count]
    }

    fn claim(&mut self, index: usize) {
        self.list[index].has_claimed = true;
        for piece in &self.list[index].verdict.pieces {
            self.claims[0].claim(&piece[0]);
            self.claims[1].claim(&piece[1]);
        }
    }

    /// No part that is not longer need explain the wire of an explanation again.
    fn settle(&mut self, index: usize, parts: &[Prepared]) {
        if std::mem::replace(&mut self.list[index].is_settled, true) {
            return;
        }
        let Explanation { hypothesis, verdict, .. } = &self.list[index];
        let length_mm = parts[hypothesis.part].pose_model.length_mm;
        for (settled, part) in self.settled.iter_mut().zip(parts) {
            if part.pose_model.length_mm <= length_mm {
                settle_for(settled, verdict);
            }
        }
    }

    /// Claims the wire of all explanations from `first` on that nothing speaks against.
    fn claim_sound(&mut self, first: usize, parts: &[Prepared]) {
        for index in first..self.count {
            let Explanation { fit, verdict, overrun_mm, has_claimed, .. } = &self.list[index];
            if select::is_sound(fit, verdict, *overrun_mm) {
                if !has_claimed {
                    self.claim(index);
                }
                self.settle(index, parts);
            }
        }
    }

    fn takes_taken_end(&self, scene: &Scene, hypothesis: &Hypothesis) -> bool {
        let length_mm = scene.parts[hypothesis.part].pose_model.length_mm;
        hypothesis.nodes.iter().filter(|n| **n != UNMATCHED).any(|&n| {
            let node = &scene.stereo_nodes[n as usize];
            self.ends_taken[0][node.left as usize].max(self.ends_taken[1][node.right as usize]) >= length_mm
        })
    }

    /// Whether most of the wire that a part at a pose would explain need not be explained again.
    fn is_explained(&self, scene: &Scene, part: usize, pose: &Isometry3<f64>) -> bool {
        let model = &scene.parts[part].pose_model;
        let settled = &self.settled[part];
        let stations = &model.stations;
        let probes = stations.iter().step_by((stations.len() / 8).max(1));
        let (probed, mut claimed) = (probes.len(), 0);
        self.refine.expect(model, probes, pose, &scene.views, |side, px, across| {
            claimed += usize::from(side == 0 && settled.is_claimed_at(&px, &across));
        });
        2 * claimed > probed
    }

    /// Claims the wire of those that would stand now and are worth all their wire, besides what is claimed for certain.
    pub(super) fn claim_whole(&mut self, parts: &[Prepared], params: &select::Params) {
        self.compete(parts, params, |explanation, worth_mm| {
            explanation.has_claimed || worth_mm >= parts[explanation.hypothesis.part].pose_model.length_mm
        });
        for k in 0..self.standing.1.len() {
            self.settle(self.standing.1[k], parts);
        }
    }

    /// Decides which stand, at most so many, and where those lie that nothing holds along themselves.
    pub(super) fn decide(
        &mut self,
        parts: &[Prepared],
        params: &select::Params,
        views: &[View; 2],
        most: usize,
    ) {
        self.weigh(parts, params);
        self.standing.1.truncate(most);
        for k in 0..self.standing.1.len() {
            self.centre(self.standing.1[k], parts, views);
        }
    }

    /// Those that stand, the most valuable first.
    pub(super) fn standing(&self) -> impl Iterator<Item = &Explanation> {
        self.standing.1.iter().map(|&index| &self.list[index])
    }

    /// Moves those that stand out of each other, where they cross.
    pub(super) fn press_apart(&mut self, parts: &[Prepared], down: &Vector3<f64>, views: &[View; 2]) {
        let standing = &self.standing.1;
        for (k, &one) in standing.iter().enumerate() {
            for &other in &standing[..k] {
                let Ok([a, b]) = self.list.get_disjoint_mut([one, other]) else { continue };
                let [mut a, mut b] = [a, b].map(|e| Placed {
                    model: &parts[e.hypothesis.part].pose_model,
                    left_from_part: &mut e.fit.left_from_part,
                    covariance: &mut e.covariance,
                });
                contact::press_apart(&mut a, &mut b, down, |a, b| over::is_over(a, b, views));
            }
        }
    }

    /// Moves a part that nothing holds along itself to the middle of where it can lie, and looks at it there.
    fn centre(&mut self, index: usize, parts: &[Prepared], views: &[View; 2]) {
        let Explanation { hypothesis, fit, verdict, covariance, .. } = &mut self.list[index];
        let Prepared { pose_model, stops, .. } = &parts[hypothesis.part];
        if verdict.ends_shown > 0 || pose_model.straight_along.is_none() {
            return;
        }
        let middle = slide::to_middle(&self.refine, pose_model, &fit.left_from_part, views);
        if let Some(there) = self.refine.again(pose_model, &middle, views) {
            *fit = there;
            verify(&self.refine, pose_model, stops, &fit.left_from_part, views, verdict);
            *covariance = self.refine.covariance(pose_model, fit);
        }
    }

    /// Decides which stand. What is worth most may take wire from two that together are worth more: those that leave doubt
    /// are dropped where the others then make more of the wire.
    fn weigh(&mut self, parts: &[Prepared], params: &select::Params) {
        if self.standing.0 != Some(self.count) {
            self.compete(parts, params, |_, _| true);
        }
        let mut best_mm = self.together_mm(parts, params);
        for _ in 0..EXCHANGES_MAX {
            self.tried.clear();
            self.tried.extend(&self.standing.1);
            self.find_rivals(parts);
            let mut best = None;
            let mut is_changed = false;
            for k in 0..self.tried.len() {
                let index = self.tried[k];
                if !self.has_rivals(index, parts) {
                    continue;
                }
                is_changed = true;
                self.leave_out(index, parts);
                let worth_mm = self.hold(parts, params, |_, _| true);
                if worth_mm > best_mm + EXCHANGE_MM {
                    (best_mm, best) = (worth_mm, Some(index));
                }
            }
            if let Some(index) = best {
                self.leave_out(index, parts);
                self.list[..self.count].iter_mut().for_each(|e| e.is_dropped |= e.is_left_out);
                self.hold(parts, params, |_, _| true);
                continue;
            }
            if is_changed {
                // The claims are not those of what stands any more, and nobody asks for them.
                std::mem::swap(&mut self.standing.1, &mut self.tried);
            }
            return;
        }
    }

    /// Leaves out one that stands, and other places of the same part along its wire, but nothing else any more.
    fn leave_out(&mut self, index: usize, parts: &[Prepared]) {
        let Explanation { hypothesis: Hypothesis { part, .. }, fit, .. } = self.list[index];
        for e in &mut self.list[..self.count] {
            e.is_left_out = e.hypothesis.part == part
                && parts[part].is_same_wire(&fit.left_from_part, &e.fit.left_from_part);
        }
    }

    /// Fills `rivals` with those that have a case but for what stands, `tried`, and are more than other places of it.
    fn find_rivals(&mut self, parts: &[Prepared]) {
        let Self { list, count, tried, rivals, .. } = self;
        let list = &list[..*count];
        rivals.clear();
        rivals.extend((0..list.len()).filter(|&j| {
            let rival = &list[j];
            let prepared = &parts[rival.hypothesis.part];
            let pose = &rival.fit.left_from_part;
            rival.alone.now_mm > 0.0
                && !rival.is_dropped
                && !tried.iter().any(|&k| {
                    let standing = &list[k];
                    standing.hypothesis.part == rival.hypothesis.part
                        && prepared.is_same_wire(&standing.fit.left_from_part, pose)
                })
        }));
    }

    /// Whether one that stands leaves doubt, and rivals are near.
    fn has_rivals(&self, index: usize, parts: &[Prepared]) -> bool {
        let place = |e: &Explanation| {
            let model = &parts[e.hypothesis.part].pose_model;
            (e.fit.left_from_part * model.centre_mm, model.length_mm / 2.0)
        };
        let standing = &self.list[index];
        let (centre, half_mm) = place(standing);
        !select::is_sound(&standing.fit, &standing.verdict, standing.verdict.overrun_mm)
            && self.rivals.iter().any(|&j| {
                let (other, other_half_mm) = place(&self.list[j]);
                (other - centre).norm() < half_mm + other_half_mm
            })
    }

    /// Lets the explanations compete for the wire: the one that is worth most stands and claims its wire, then the next;
    /// but for those that `may_stand` refuses, which is given what they are worth in mm.
    fn compete(
        &mut self,
        parts: &[Prepared],
        params: &select::Params,
        may_stand: impl Fn(&Explanation, f64) -> bool,
    ) {
        self.claims.iter_mut().for_each(ClaimMap::clear);
        for explanation in &mut self.list[..self.count] {
            explanation.alone = explanation.worth(parts, params, &self.claims);
            (explanation.is_dropped, explanation.is_left_out) = (false, false);
        }
        self.hold(parts, params, may_stand);
    }

    /// Holds the competition without those that are dropped or left out; gives what those that stand are
    /// [worth together](Self::together_mm).
    fn hold(
        &mut self,
        parts: &[Prepared],
        params: &select::Params,
        may_stand: impl Fn(&Explanation, f64) -> bool,
    ) -> f64 {
        self.claims.iter_mut().for_each(ClaimMap::clear);
        for explanation in &mut self.list[..self.count] {
            let stays = !explanation.is_dropped && !explanation.is_left_out;
            explanation.worth = (0, if stays { explanation.alone } else { Worth::NONE });
        }
        self.standing.1.clear();
        let mut refused = false;
        while let Some((index, worth)) = self.most_valuable(parts, params, self.standing.1.len() as u32) {
            if may_stand(&self.list[index], worth.now_mm) {
                self.claim(index);
                self.standing.1.push(index);
                self.list[index].stood_mm = worth.at_most_mm;
            } else {
                refused = true;
            }
        }
        self.standing.0 = (!refused).then_some(self.count);
        self.together_mm(parts, params)
    }

    /// What those that stand are worth together, in mm, less [`PART_MM`] for each. Wire that goes on beyond one is no riddle
    /// where another has claimed it in the end.
    fn together_mm(&self, parts: &[Prepared], params: &select::Params) -> f64 {
        let worths = self.standing.1.iter().map(|&index| {
            let Explanation { hypothesis, verdict, stood_mm, .. } = &self.list[index];
            let model = &parts[hypothesis.part].pose_model;
            let overrun_mm = select::unclaimed_overrun_mm(model, verdict, &self.claims);
            stood_mm - params.against * overrun_mm - PART_MM
        });
        worths.sum()
    }

    /// The one that is worth most, given what the `standing` ones before have claimed, and what it is worth; once.
    fn most_valuable(
        &mut self,
        parts: &[Prepared],
        params: &select::Params,
        standing: u32,
    ) -> Option<(usize, Worth)> {
        loop {
            // A worth from before the last claim says only how much it is at most.
            let worth_mm = |e: &Explanation| match e.worth {
                (asked, worth) if asked == standing => worth.now_mm,
                (_, worth) => worth.at_most_mm,
            };
            let most = self.all().iter().map(worth_mm).enumerate().max_by(|a, b| a.1.total_cmp(&b.1));
            let (index, _) = most.filter(|(_, worth_mm)| *worth_mm > 0.0)?;
            let (asked, worth) = self.list[index].worth;
            if asked == standing {
                self.list[index].worth.1 = Worth::NONE;
                return Some((index, worth));
            }
            self.list[index].worth = (standing, self.list[index].worth(parts, params, &self.claims));
        }
    }
}

impl Explanation {
    /// What it is worth, given what is claimed.
    fn worth(&self, parts: &[Prepared], params: &select::Params, claims: &[ClaimMap; 2]) -> Worth {
        let model = &parts[self.hypothesis.part].pose_model;
        select::worth(params, model, &self.fit, &self.verdict, claims)
    }
}

/// Marks the wire of an explanation as settled.
fn settle_for(settled: &mut ClaimMap, verdict: &Verdict) {
    verdict.pieces.iter().for_each(|[left, _]| settled.claim(left));
}

/// Marks the end of a picture at a place as that of a part of this length: the nearest, for another wire may end beside it.
fn take_end(nodes: &[ImageNode], at: &Vector2<f64>, taken: &mut [f64], length_mm: f64) {
    let distance_px = |node: &ImageNode| (node.position_px - at).norm();
    let nearest = (0..nodes.len())
        .filter(|&n| nodes[n].role == NodeRole::End && distance_px(&nodes[n]) < SAME_END_PX)
        .min_by(|&a, &b| distance_px(&nodes[a]).total_cmp(&distance_px(&nodes[b])));
    if let Some(n) = nearest {
        taken[n] = taken[n].max(length_mm);
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use nalgebra::Point3;

    use super::*;
    use crate::frame::{Frame, FramePair};
    use crate::part::Part;
    use crate::recognize::views::views;
    use crate::recognize::{Params, Recognition, Recognizer};
    use crate::rig::CameraModel;
    use crate::session::read_picture;

    /// What a pair of the recorded session, ten rods over each other, made the recogniser know.
    fn after_a_pair() -> Recognizer {
        let replay = Path::new(env!("CARGO_MANIFEST_DIR")).join("replay");
        let picture =
            |side: &str| read_picture(&replay.join("conveyor").join(side).join("0000.jpg")).unwrap();
        let pair = FramePair { left: picture("left"), right: picture("right") };
        let rig = Rig::read(replay.join("conveyor/calibration.yaml")).unwrap();
        let part = Part::read(replay.join("parts/rod-90.toml")).unwrap();
        let mut recognizer = Recognizer::new(Params::default(), rig, vec![part]).unwrap();
        recognizer.run(&pair, Budget::Iterations(100_000), 1, &mut Recognition::default()).unwrap();
        recognizer
    }

    /// The competition with every worth asked again each time.
    fn compete_slowly(
        explanations: &mut Explanations,
        parts: &[Prepared],
        params: &select::Params,
    ) -> Vec<usize> {
        explanations.claims.iter_mut().for_each(ClaimMap::clear);
        let mut standing = Vec::new();
        loop {
            let most = (0..explanations.count)
                .filter(|i| !standing.contains(i))
                .map(|i| (i, explanations.list[i].worth(parts, params, &explanations.claims).now_mm))
                .max_by(|a, b| a.1.total_cmp(&b.1));
            let Some((index, _)) = most.filter(|(_, worth_mm)| *worth_mm > 0.0) else { return standing };
            explanations.claim(index);
            standing.push(index);
        }
    }

    #[test]
    fn the_competition_ends_as_if_every_worth_were_asked_again_each_time() {
        let Recognizer { mut explanations, parts, params, .. } = after_a_pair();
        let expected = compete_slowly(&mut explanations, &parts, &params.select);
        explanations.standing.0 = None;
        explanations.weigh(&parts, &params.select);
        assert_eq!(explanations.standing.1, expected);
        // What is known already is not held again, and the same.
        explanations.weigh(&parts, &params.select);
        assert_eq!(explanations.standing.1, expected);
        assert_eq!(expected.len(), 10);
        assert!(explanations.count > 10, "others were refused");
    }

    /// Lit rods of 3 mm from one place to another, both in the left camera's frame, on a dark floor.
    fn drawn(rig: &Rig, rods: &[[Point3<f64>; 2]]) -> FramePair {
        let frame = |side: usize| {
            let see = |p: &Point3<f64>| if side == 0 { rig.project_left(p) } else { rig.project_right(p) };
            let rods: Vec<_> = rods.iter().map(|rod| rod.map(|p| see(&p).unwrap())).collect();
            let grey = |x: usize, y: usize| {
                let px = Vector2::new(x as f64, y as f64);
                let covered = |[a, b]: &[Vector2<f64>; 2]| {
                    let along = (b - a).normalize();
                    let half_px = 1.5 * 1150.0 / 500.0;
                    let inside = (px - a).dot(&along).min((b - px).dot(&along));
                    let beside = half_px - (px - a).perp(&along).abs();
                    (inside + 0.5).clamp(0.0, 1.0) * (beside + 0.5).clamp(0.0, 1.0) * (1.0 + 0.05 * beside)
                };
                40.0 + 140.0 * rods.iter().map(covered).fold(0.0, f64::max)
            };
            let pixels = (0..480).flat_map(|y| (0..640).flat_map(move |x| [(x, y); 3]));
            Frame::from_rgb(640, 480, pixels.map(|(x, y)| grey(x, y) as u8).collect())
        };
        FramePair { left: frame(0), right: frame(1) }
    }

    fn rod(name: &str, length_mm: f64) -> Part {
        let half = length_mm / 2.0;
        let text = format!(
            "name = '{name}'\nthickness_mm = 3.0\nnode = [{{ name = 'a', position_mm = [-{half:.1}, 0.0, 0.0] }}, \
             {{ name = 'b', position_mm = [{half:.1}, 0.0, 0.0] }}]\nedge = [{{ from = 'a', to = 'b' }}]\n\
             grasp = {{ position_mm = [0.0, 0.0, 0.0], approach = [0.0, 0.0, -1.0], closing = [0.0, 1.0, 0.0], \
             width_mm = 8.0 }}\n"
        );
        Part::parse(&text, "test.toml").unwrap()
    }

    #[test]
    fn two_that_explain_all_wire_stand_before_one_that_explains_most_of_it() {
        let camera = CameraModel::pinhole(640, 480, 1150.0, 320.0, 240.0);
        let rig =
            Rig { left: camera, right: camera, right_from_left: Isometry3::translation(-60.0, 0.0, 0.0) };
        // End to end, without a gap that the mask would show: a rod of 120 mm fits the middle, too.
        let along = Vector3::new(0.5, 0.8, 0.0).normalize();
        let at = |mm: f64| Point3::new(30.0, 0.0, 500.0) + along * mm;
        let pair = drawn(&rig, &[[at(-75.0), at(75.0)]]);
        let mut recognizer =
            Recognizer::new(Params::default(), rig, vec![rod("rod-120", 120.0), rod("rod-75", 75.0)])
                .unwrap();
        let mut found = Recognition::default();
        recognizer.run(&pair, Budget::Iterations(100_000), 1, &mut found).unwrap();
        let mut middles: Vec<_> = found
            .parts
            .iter()
            .map(|p| (p.part, (p.left_from_part.translation.vector - at(0.0).coords).dot(&along)))
            .collect();
        middles.sort_by(|a, b| a.1.total_cmp(&b.1));
        let [(1, first), (1, second)] = middles[..] else { panic!("{middles:?}") };
        assert!((first + 37.5).abs() < 1.0 && (second - 37.5).abs() < 1.0, "{first} {second}");
    }

    #[test]
    fn a_rod_with_both_ends_on_others_lies_in_the_middle_of_where_it_can() {
        let camera = CameraModel::pinhole(640, 480, 1150.0, 320.0, 240.0);
        let rig =
            Rig { left: camera, right: camera, right_from_left: Isometry3::translation(-60.0, 0.0, 0.0) };
        let (along, across) =
            (Vector3::new(0.5, 0.8, 0.0).normalize(), Vector3::new(0.8, -0.5, 0.0).normalize());
        let at = |mm: f64, beside_mm: f64| Point3::new(30.0, 0.0, 500.0) + along * mm + across * beside_mm;
        let pair = drawn(
            &rig,
            &[
                [at(-37.5, 0.0), at(37.5, 0.0)],
                [at(-37.5, -20.0), at(-37.5, 20.0)],
                [at(37.5, -20.0), at(37.5, 20.0)],
            ],
        );
        let mut recognizer = Recognizer::new(Params::default(), rig, vec![rod("rod-75", 75.0)]).unwrap();
        recognizer.run(&pair, Budget::Iterations(100_000), 1, &mut Recognition::default()).unwrap();
        let Recognizer { pictures, rig, params, parts, explanations, .. } = recognizer;
        let views = views(&pictures, &rig, &pair, &params).unwrap();
        let turn = nalgebra::UnitQuaternion::rotation_between(&Vector3::x(), &along).unwrap();
        for displaced_mm in [-5.0, 0.0, 5.0] {
            let pose = Isometry3::from_parts(at(displaced_mm, 0.0).into(), turn);
            let found = slide::to_middle(&explanations.refine, &parts[0].pose_model, &pose, &views);
            let place_mm = (found.translation.vector - at(0.0, 0.0).coords).dot(&along);
            assert!(place_mm.abs() < 0.8, "{displaced_mm}: {place_mm}");
        }
    }
}
