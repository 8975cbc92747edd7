//! The competition of explanations for the wire, and what is done to those that stand.

use arrayvec::ArrayVec;
use nalgebra::Vector3;

use super::{Explanation, Explanations};
use crate::matching::claims::ClaimMap;
use crate::matching::hypotheses::Hypothesis;
use crate::matching::select::{self, Worth};
use crate::pose::contact::{self, Placed};
use crate::pose::over;
use crate::pose::refine::View;
use crate::pose::slide;
use crate::pose::verify::verify;
use crate::recognize::lamp::Light;
use crate::recognize::prepared::Prepared;
use crate::recognize::result::PARTS_MAX;
use crate::time::Watch;

/// How often one that stands is dropped for others, at most.
const EXCHANGES_MAX: usize = 8;
/// By how much the others must be worth more together, and what each more must be worth besides, in mm of wire: of two ways to
/// explain the wire, that with fewer parts is likelier.
const EXCHANGE_MM: f64 = 1.0;
const PART_MM: f64 = 10.0;
/// Wire that stands out from the background by less than this share of what proven parts do in the median is of something else.
const DIM_SHARE: f64 = 0.5;
/// What is worth this share of its wire is nearly whole.
const NEARLY_WHOLE: f64 = 0.98;

impl Explanations {
    /// Claims the wire of those that would stand now and are worth all their wire, or where `nearly` most of it, besides what
    /// is claimed for certain.
    pub(in crate::recognize) fn claim_whole(
        &mut self,
        parts: &[Prepared],
        params: &select::Params,
        nearly: bool,
    ) {
        self.compete(parts, params, |explanation, worth| {
            let model = parts[explanation.hypothesis.part].pose_model();
            let Worth { now_mm, at_most_mm } = worth;
            // A wire that goes on does so in both pictures: one piece of it in one of them, a radius, is none. Half a piece
            // more, for what is left of a difference.
            let goes_on = at_most_mm - now_mm > 1.5 * params.against * model.radius_mm;
            explanation.has_claimed
                || now_mm >= model.length_mm
                || nearly && !goes_on && at_most_mm >= NEARLY_WHOLE * model.length_mm
        });
    }

    /// No part that is not longer need explain the wire again that is claimed now.
    pub(in crate::recognize) fn settle_claimed(&mut self, parts: &[Prepared]) {
        for k in 0..self.standing.len() {
            self.settle(self.standing[k], parts);
        }
    }

    /// Decides which stand, at most [`PARTS_MAX`], where those lie that nothing holds along themselves, and how the light lies on
    /// them, and which are proved; says whether there was time to weigh them all.
    pub(in crate::recognize) fn decide(
        &mut self,
        parts: &[Prepared],
        params: &select::Params,
        views: &[View; 2],
        exchanging: &mut Watch,
    ) -> bool {
        let mut in_time = self.weigh(parts, params, exchanging);
        if self.standing.len() > PARTS_MAX {
            // What there is no room for is not known to be anything.
            self.standing.truncate(PARTS_MAX);
            self.claim_standing();
            in_time = false;
        }
        let mut is_moved = false;
        for k in 0..self.standing.len() {
            is_moved |= self.centre(self.standing[k], parts, views);
        }
        if is_moved {
            self.claim_standing();
        }
        for &index in &self.standing {
            let Explanation { hypothesis, verdict, light, .. } = &mut self.list[index];
            *light = Light::on(parts[hypothesis.part].pose_model(), verdict, views);
        }
        self.prove(parts);
        if self.drop_unlikely(parts) {
            self.prove(parts);
        }
        in_time
    }

    /// Says of those that stand which are proved, given what all of them claim.
    fn prove(&mut self, parts: &[Prepared]) {
        for k in 0..self.standing.len() {
            let index = self.standing[k];
            let Explanation { hypothesis, fit, verdict, .. } = &self.list[index];
            let model = parts[hypothesis.part].pose_model();
            let overrun_mm = select::unclaimed_overrun_mm(model, verdict, &self.claims);
            self.list[index].is_proven =
                select::is_proven(model, fit, verdict, overrun_mm) && !self.may_be_kin(index, parts);
        }
    }

    /// Drops those in doubt that are likely no parts at all, but a bin's rim, a wall's shadow, a line on the floor: they
    /// stand out from the background much less than what is proven, or show no end and hardly more of their wire, or lie in
    /// another. Says whether there were any.
    fn drop_unlikely(&mut self, parts: &[Prepared]) -> bool {
        let (list, before) = (&self.list, self.standing.len());
        let above = |index: &usize| list[*index].light.above();
        let proven = self.standing.iter().filter(|index| list[**index].is_proven);
        let mut proven_above: ArrayVec<f64, PARTS_MAX> = proven.filter_map(above).collect();
        proven_above.sort_unstable_by(f64::total_cmp);
        let usual = proven_above.get(proven_above.len() / 2);
        let is_dim =
            |index: &usize| above(index).zip(usual).is_some_and(|(above, usual)| above < DIM_SHARE * usual);
        let placed = |index: usize| {
            let Explanation { hypothesis, fit, .. } = &list[index];
            (parts[hypothesis.part].pose_model(), &fit.left_from_part)
        };
        self.tried.clone_from(&self.standing);
        let lies_in_another = |&index: &usize| {
            let others = self.tried.iter().filter(|&&other| other != index);
            others.copied().any(|other| contact::overlap(placed(index), placed(other)))
        };
        self.standing.retain(|index| {
            list[*index].is_proven
                || !is_dim(index) && !select::is_unlikely(&list[*index].verdict) && !lies_in_another(index)
        });
        let are_dropped = self.standing.len() < before;
        if are_dropped {
            self.claim_standing();
        }
        are_dropped
    }

    /// Those that stand, the most valuable first.
    pub(in crate::recognize) fn standing(&self) -> impl Iterator<Item = &Explanation> {
        self.standing.iter().map(|&index| &self.list[index])
    }

    /// Claims the wire of those that stand, and no other.
    fn claim_standing(&mut self) {
        self.claims.iter_mut().for_each(ClaimMap::clear);
        for k in 0..self.standing.len() {
            self.claim(self.standing[k]);
        }
    }

    /// Moves those that stand out of each other, where they cross.
    pub(in crate::recognize) fn press_apart(
        &mut self,
        parts: &[Prepared],
        down: &Vector3<f64>,
        views: &[View; 2],
    ) {
        let standing = &self.standing;
        for (k, &one) in standing.iter().enumerate() {
            for &other in &standing[..k] {
                let Ok([a, b]) = self.list.get_disjoint_mut([one, other]) else { continue };
                let [mut a, mut b] = [a, b].map(|e| Placed {
                    model: parts[e.hypothesis.part].pose_model(),
                    left_from_part: &mut e.fit.left_from_part,
                    covariance: &mut e.covariance,
                });
                contact::press_apart(&mut a, &mut b, down, |a, b| over::is_over(a, b, views));
            }
        }
    }

    /// Displaces those that stand by so much each, in mm of the left camera's frame.
    pub(in crate::recognize) fn displace<'a>(&mut self, by_mm: impl Iterator<Item = &'a Vector3<f64>>) {
        for (&index, by_mm) in self.standing.iter().zip(by_mm) {
            self.list[index].fit.left_from_part.translation.vector += by_mm;
            self.list[index].beside_mm = *by_mm;
        }
    }

    /// Moves a part that nothing holds along itself to the middle of where it can lie, and looks at it there; says whether
    /// it has.
    fn centre(&mut self, index: usize, parts: &[Prepared], views: &[View; 2]) -> bool {
        let Self { list, refine, .. } = self;
        let Explanation { hypothesis, fit, verdict, covariance, turn, .. } = &mut list[index];
        let prepared = &parts[hypothesis.part];
        let (pose_model, stops) = (prepared.pose_model(), &prepared.stops);
        if verdict.ends_shown > 0 {
            return false;
        }
        let middle = slide::to_middle(refine, pose_model, &fit.left_from_part, views);
        let Some(there) = middle.and_then(|middle| refine.again(pose_model, &middle, views)) else {
            return false;
        };
        *fit = there;
        verify(refine, pose_model, stops, &fit.left_from_part, views, verdict);
        let spread = refine.spread(pose_model, fit, views);
        (*covariance, *turn) = (spread.covariance, spread.turn);
        true
    }

    /// Decides which stand. What is worth most may take wire from two that together are worth more: those that leave doubt
    /// are dropped where the others then make more of the wire. Is time over, what stands stays; says whether it was not.
    pub(super) fn weigh(
        &mut self,
        parts: &[Prepared],
        params: &select::Params,
        exchanging: &mut Watch,
    ) -> bool {
        if self.decided != Some(self.count) {
            self.compete(parts, params, |_, _| true);
        }
        let mut best_mm = self.together_mm(parts, params);
        for _ in 0..EXCHANGES_MAX {
            self.tried.clear();
            self.tried.extend(&self.standing);
            self.find_rivals(parts);
            let mut best = None;
            let (mut is_changed, mut in_time) = (false, true);
            for k in 0..self.tried.len() {
                let index = self.tried[k];
                if exchanging.is_over() {
                    (best, in_time) = (None, false);
                    break;
                }
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
                std::mem::swap(&mut self.standing, &mut self.tried);
                self.claim_standing();
            }
            return in_time && self.readmit(parts, params, exchanging);
        }
        self.readmit(parts, params, exchanging)
    }

    /// Of those that were dropped for others those stand after all which explain enough that the others do not. Says whether
    /// there was time for it.
    fn readmit(&mut self, parts: &[Prepared], params: &select::Params, exchanging: &mut Watch) -> bool {
        while self.list[..self.count].iter().any(|e| e.is_dropped) {
            if exchanging.is_over() {
                return false;
            }
            let dropped = (0..self.count).filter(|&k| self.list[k].is_dropped && !self.standing.contains(&k));
            let worth_mm = |k: usize| self.list[k].worth(parts, params, &self.claims).now_mm;
            let most = dropped.map(|k| (k, worth_mm(k))).max_by(|a, b| a.1.total_cmp(&b.1));
            let Some((index, _)) = most.filter(|(_, worth_mm)| *worth_mm > PART_MM) else { break };
            self.claim(index);
            self.standing.push(index);
        }
        true
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
            let model = parts[e.hypothesis.part].pose_model();
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
    /// but for those that `may_stand` refuses, which is given what they are worth.
    fn compete(
        &mut self,
        parts: &[Prepared],
        params: &select::Params,
        may_stand: impl Fn(&Explanation, Worth) -> bool,
    ) {
        self.claims.iter_mut().for_each(ClaimMap::clear);
        self.weigh_kin();
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
        may_stand: impl Fn(&Explanation, Worth) -> bool,
    ) -> f64 {
        self.claims.iter_mut().for_each(ClaimMap::clear);
        for explanation in &mut self.list[..self.count] {
            let stays = !explanation.is_dropped && !explanation.is_left_out;
            explanation.worth = (0, if stays { explanation.alone } else { Worth::NONE });
        }
        self.standing.clear();
        let mut refused = false;
        while let Some((index, worth)) = self.most_valuable(parts, params, self.standing.len() as u32) {
            if may_stand(&self.list[index], worth) {
                self.claim(index);
                self.standing.push(index);
                self.list[index].stood_mm = worth.at_most_mm;
            } else {
                refused = true;
            }
        }
        self.decided = (!refused).then_some(self.count);
        self.together_mm(parts, params)
    }

    /// What those that stand are worth together, in mm, less [`PART_MM`] for each. Wire that goes on beyond one is no riddle
    /// where another has claimed it in the end.
    fn together_mm(&self, parts: &[Prepared], params: &select::Params) -> f64 {
        let worths = self.standing.iter().map(|&index| {
            let Explanation { hypothesis, verdict, stood_mm, .. } = &self.list[index];
            let model = parts[hypothesis.part].pose_model();
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
    pub(super) fn worth(&self, parts: &[Prepared], params: &select::Params, claims: &[ClaimMap; 2]) -> Worth {
        let model = parts[self.hypothesis.part].pose_model();
        let Worth { now_mm, at_most_mm } = select::worth(params, model, &self.fit, &self.verdict, claims);
        Worth { now_mm: now_mm - self.kin_mm(), at_most_mm: at_most_mm - self.kin_mm() }
    }
}
