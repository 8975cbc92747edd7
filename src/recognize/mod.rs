//! Recognition: a pair of pictures in, ranked grasps out. Composes the stages; each is a library of its own.
//!
//! Nothing is kept from one pair to the next. After the first pairs nothing is allocated, except by the JPEG decoder.

mod params;
mod prepared;
mod result;
mod spread;
mod unexplained;
mod views;

use arrayvec::ArrayVec;
use nalgebra::{Isometry3, Vector2};

use crate::frame::{FramePair, LumaView};
use crate::grasp::{self, Blocked, Placed};
use crate::matching::fitness::{Judge, UNMATCHED};
use crate::matching::hypotheses::{self, Hypothesis};
use crate::matching::lines::{self, Lines};
use crate::matching::nodes::{self, NodeRole};
use crate::matching::search::Search;
use crate::matching::select::{self, ClaimMap};
use crate::part::{NODES_MAX, Part};
use crate::picture::Picture;
use crate::pose::refine::{Fit, Refine};
use crate::pose::verify::{Verdict, verify};
use crate::rig::Rig;
use crate::time::{Budget, Timestamp};
use crate::vision::binarize;
use crate::vision::ridge::{self, Ridges};

pub use params::Params;
use prepared::Prepared;
pub use result::{FoundNode, FoundPart, NoPick, Recognition, Refusal, Seen, Side, StageTimes};
use spread::sigmas;
use unexplained::{half_width_px, is_claimed, is_explained, unexplained_px};
use views::{lit, views};

/// An explanation of some wire: a refined hypothesis.
struct Explanation {
    hypothesis: Hypothesis,
    fit: Fit,
    verdict: Verdict,
    worth_mm: f64,
}

/// Most hypotheses and explanations of a pair.
const HYPOTHESES_MAX: usize = 16384;
const EXPLANATIONS_MAX: usize = 2048;
const PARTS_MAX: usize = 128;

/// The whole recognition with all its memory.
pub struct Recognizer {
    params: Params,
    rig: Rig,
    parts: Vec<Prepared>,
    pictures: [Picture; 2],
    search: Search,
    pool: Vec<Hypothesis>,
    refine: Refine,
    ridges: [Ridges; 2],
    /// What no part explains for certain.
    areas: [ridge::Area; 2],
    lines: Lines,
    explanations: Vec<Explanation>,
    explained: usize,
    claims: [ClaimMap; 2],
    /// Image nodes, left and right, that are ends of parts recognised for certain.
    ends_taken: [Vec<bool>; 2],
}

impl Recognizer {
    /// Reserves all memory for pictures of the calibration's size.
    ///
    /// # Errors
    /// Where the colour range or the region cannot be used.
    pub fn new(params: Params, rig: Rig, parts: Vec<Part>) -> Result<Self, binarize::ParamsError> {
        let [left, right] = params.binarize.clone();
        let picture = |b, camera: &crate::rig::CameraModel| Picture::new(b, &params, *camera);
        let pictures = [picture(left, &rig.left)?, picture(right, &rig.right)?];
        let claims = [&rig.left, &rig.right].map(|c| ClaimMap::new(c.width, c.height));
        let parts: Vec<Prepared> = parts.into_iter().map(Prepared::new).collect();
        Ok(Self {
            search: Search::new(params.search, params.gate, parts.len()),
            pool: Vec::with_capacity(HYPOTHESES_MAX),
            refine: Refine::new(lit(&params), &rig),
            areas: [&rig.left, &rig.right].map(|c| ridge::Area::new(c.width, c.height)),
            ridges: [&rig.left, &rig.right].map(|c| Ridges::new(params.ridges, c.width, c.height)),
            lines: Lines::new(
                lines::Params { depth_mm: params.gate.depth_mm, ..params.lines },
                params.ridges.stretches_max,
            ),
            explanations: Vec::with_capacity(EXPLANATIONS_MAX),
            explained: 0,
            claims,
            ends_taken: [0, 1].map(|_| Vec::with_capacity(params.nodes.nodes_max)),
            pictures,
            params,
            rig,
            parts,
        })
    }

    /// The rig.
    pub fn rig(&self) -> &Rig {
        &self.rig
    }

    /// The parts, in the order of [`FoundPart::part`].
    pub fn parts(&self) -> impl ExactSizeIterator<Item = &Part> {
        self.parts.iter().map(|p| &p.part)
    }

    /// What the stages made of the last pair: left, right.
    pub fn pictures(&self) -> &[Picture; 2] {
        &self.pictures
    }

    /// Recognises a pair.
    ///
    /// # Errors
    /// [`Refusal`] where the pictures cannot be used; `out` is empty then.
    pub fn run(
        &mut self,
        pair: &FramePair,
        budget: Budget,
        seed: u64,
        out: &mut Recognition,
    ) -> Result<(), Refusal> {
        let begin = Timestamp::now();
        out.parts.clear();
        *out = Recognition { parts: std::mem::take(&mut out.parts), seed, ..Recognition::default() };
        let mut stages = StageTimes::default();
        for (picture, frame, side) in [(0, &pair.left, Side::Left), (1, &pair.right, Side::Right)] {
            self.pictures[picture].run(frame, side, &mut stages)?;
        }
        let nodes = |p: &Picture| p.graph().nodes.len();
        (out.nodes_left, out.nodes_right) = (nodes(&self.pictures[0]), nodes(&self.pictures[1]));
        let seen = Timestamp::now();
        // What is found must be looked at, too, which takes about as long.
        self.search(budget.half(), seed, out);
        let matched = Timestamp::now();
        self.explained = 0;
        self.claims.iter_mut().for_each(ClaimMap::clear);
        for (taken, picture) in self.ends_taken.iter_mut().zip(&self.pictures) {
            taken.clear();
            taken.resize(picture.nodes().len(), false);
        }
        self.explain(pair, budget, out);
        if !budget.is_over() && self.search_ridges(pair) {
            self.explain(pair, budget, out);
        }
        self.compete(out);
        self.grasp(out);
        if budget.is_over() {
            out.out_of_time = true;
            for found in &mut out.parts {
                found.blocked.get_or_insert(Blocked::OutOfTime);
            }
        }
        out.no_pick = self.no_pick(out);
        let end = Timestamp::now();
        stages.match_ns = matched.since(seen).max(0) as u64;
        stages.pose_ns = end.since(matched).max(0) as u64;
        stages.total_ns = end.since(begin).max(0) as u64;
        out.stages = stages;
        Ok(())
    }

    /// Fills the pool with rough poses of all parts, fittest first: those of matches, and those that single nodes hold
    /// with the wire that leaves them. A single node costs an iteration of the budget.
    fn search(&mut self, budget: Budget, seed: u64, out: &mut Recognition) {
        let Self { pictures, rig, parts, search, pool, params, .. } = self;
        let [left, right] = [pictures[0].nodes(), pictures[1].nodes()];
        pool.clear();
        let thickness = parts.iter().map(|p| p.part.thickness_mm);
        let thickness_mm = [thickness.clone().fold(f64::INFINITY, f64::min), thickness.fold(0.0, f64::max)];
        let judge_of = |part: usize| Judge {
            rig,
            masks: [pictures[0].mask(), pictures[1].mask()],
            model: &parts[part].match_model,
            weights: params.weights,
            length_tolerance_mm: params.search.length_tolerance_mm,
        };
        search.begin(rig, left, right, thickness_mm);
        search.run_exact(judge_of, budget);
        (out.iterations, out.out_of_time) = (search.iterations(), search.is_out_of_time());
        for index in 0..parts.len() {
            let judge = judge_of(index);
            for (n, node) in search.near_nodes() {
                if budget.is_spent(out.iterations) {
                    out.out_of_time = true;
                    break;
                }
                out.iterations += 1;
                hypotheses::of_single_node(&params.single, index, &judge, rig, n, node, left, right, pool);
            }
        }
        search.run_by_chance(rig, [left, right], judge_of, budget, &mut out.iterations, seed);
        out.out_of_time |= search.is_out_of_time();
        let matches: usize = (0..parts.len()).map(|p| search.matches(p).len()).sum();
        pool.truncate(HYPOTHESES_MAX.saturating_sub(matches));
        for (index, prepared) in parts.iter().enumerate() {
            for found in search.matches(index) {
                if pool.len() < HYPOTHESES_MAX {
                    pool.extend(hypotheses::of_match(index, &prepared.match_model, found, search.nodes()));
                }
            }
        }
        let down = grasp::down_in_left(&params.grasp);
        let slope_sin_max = params.slope_rad_max.sin();
        pool.retain(|h| parts[h.part].slope_sin(&h.left_from_part, &down) <= slope_sin_max);
        pool.sort_unstable_by(|a, b| a.fitness.total_cmp(&b.fitness));
    }

    /// Fills the pool with rough poses that straight wire holds which nothing explains for certain; says whether there
    /// are any.
    fn search_ridges(&mut self, pair: &FramePair) -> bool {
        let Self {
            pictures,
            rig,
            parts,
            pool,
            params,
            ridges,
            areas,
            lines,
            claims,
            explanations,
            explained,
            ..
        } = self;
        pool.clear();
        // What is sound is not explained again either, here where there is much to explain.
        for explanation in &explanations[..*explained] {
            if select::is_sound(&explanation.fit, &explanation.verdict) {
                for piece in &explanation.verdict.pieces {
                    claims[0].claim(&piece[0]);
                    claims[1].claim(&piece[1]);
                }
            }
        }
        let least_radii =
            parts.iter().map(|p| p.least_seen_radii(params.select.seen_min)).fold(f64::INFINITY, f64::min);
        let half_px = [0, 1].map(|side: usize| half_width_px(&pictures[side]));
        let enough = |side: usize| {
            unexplained_px(&pictures[side], &claims[side], &mut areas[side]) >= least_radii * half_px[side]
        };
        if ![0, 1].into_iter().all(enough) {
            return false;
        }
        for (side, frame) in [&pair.left, &pair.right].into_iter().enumerate() {
            let Some(luma) = LumaView::new(pictures[side].raw(frame)) else { return false };
            let dark = params.binarize[side].inverted;
            ridges[side].run(luma, pictures[side].mask(), &areas[side], dark, half_px[side]);
        }
        let down = grasp::down_in_left(&params.grasp);
        let slope_sin_max = params.slope_rad_max.sin();
        let [left, right] = [0, 1].map(|side: usize| {
            let claims = &claims[side];
            ridges[side].stretches().iter().filter(move |s| !is_claimed(claims, s))
        });
        lines.run(rig, [left, right], &down, slope_sin_max);
        for (index, prepared) in parts.iter().enumerate() {
            let judge = Judge {
                rig,
                masks: [pictures[0].mask(), pictures[1].mask()],
                model: &prepared.match_model,
                weights: params.weights,
                length_tolerance_mm: params.search.length_tolerance_mm,
            };
            lines.hypotheses(index, &judge, pool);
        }
        pool.retain(|h| parts[h.part].slope_sin(&h.left_from_part, &down) <= slope_sin_max);
        pool.sort_unstable_by(|a, b| a.fitness.total_cmp(&b.fitness));
        !pool.is_empty()
    }

    /// Refines and judges the hypotheses, each pose once. Wire and ends that a certain explanation has are not
    /// explained again. A count of iterations is for the searches: what they find is always looked at; but when time is
    /// over, the rest is left.
    fn explain(&mut self, pair: &FramePair, budget: Budget, out: &mut Recognition) {
        let Self {
            pictures,
            rig,
            parts,
            pool,
            refine,
            explanations,
            explained,
            claims,
            search,
            ends_taken,
            params,
            ..
        } = self;
        let Some(views) = views(pictures, rig, pair, params) else { return };
        let down = grasp::down_in_left(&params.grasp);
        let slope_sin_max = params.slope_rad_max.sin();
        for hypothesis in pool.iter() {
            if *explained == EXPLANATIONS_MAX {
                return;
            }
            if budget.is_over() {
                out.out_of_time = true;
                return;
            }
            let prepared = &parts[hypothesis.part];
            let takes_taken_end = hypothesis.nodes.iter().filter(|n| **n != UNMATCHED).any(|&n| {
                let node = &search.nodes()[n as usize];
                ends_taken[0][node.left as usize] || ends_taken[1][node.right as usize]
            });
            if takes_taken_end || is_explained(refine, prepared, hypothesis, &views, claims) {
                continue;
            }
            let known = |pose: &Isometry3<f64>, near_mm| {
                prepared.is_among(&explanations[..*explained], hypothesis, pose, near_mm)
            };
            if known(&hypothesis.left_from_part, SAME_ROUGH_MM) {
                continue;
            }
            let model = &prepared.pose_model;
            let Some(pose) = refine.coarse(model, &hypothesis.left_from_part, &views) else { continue };
            if known(&pose, SAME_COARSE_MM) {
                continue;
            }
            let Some(fit) = refine.fine(model, &pose, &views) else { continue };
            if prepared.slope_sin(&fit.left_from_part, &down) > slope_sin_max
                || known(&fit.left_from_part, [SAME_MM; 2])
            {
                continue;
            }
            if *explained == explanations.len() {
                explanations.push(Explanation {
                    hypothesis: *hypothesis,
                    fit,
                    verdict: Verdict::default(),
                    worth_mm: 0.0,
                });
            }
            let explanation = &mut explanations[*explained];
            (explanation.hypothesis, explanation.fit) = (*hypothesis, fit);
            let verdict = &mut explanation.verdict;
            verify(refine, &prepared.pose_model, &prepared.stops, &fit.left_from_part, &views, verdict);
            *explained += 1;
            if select::is_certain(&fit, verdict, prepared.pose_model.ends.len()) {
                for piece in &verdict.pieces {
                    claims[0].claim(&piece[0]);
                    claims[1].claim(&piece[1]);
                }
                for end in refine.ends() {
                    for side in 0..2 {
                        let Some(end) = end[side] else { continue };
                        take_end(pictures[side].nodes(), &end.expected_px, &mut ends_taken[side]);
                    }
                }
            }
        }
    }

    /// Lets the explanations compete for the wire: the one that is worth most stands and claims its wire, then the next.
    fn compete(&mut self, out: &mut Recognition) {
        self.claims.iter_mut().for_each(ClaimMap::clear);
        for index in 0..self.explained {
            self.explanations[index].worth_mm = self.worth_mm(index);
        }
        while out.parts.len() < PARTS_MAX {
            let worth_most = (0..self.explained)
                .max_by(|&a, &b| self.explanations[a].worth_mm.total_cmp(&self.explanations[b].worth_mm));
            let Some(index) = worth_most.filter(|&i| self.explanations[i].worth_mm > 0.0) else { return };
            // What was claimed since can only have made it worth less; if it has not, nothing is worth more.
            let worth_mm = self.worth_mm(index);
            if worth_mm < self.explanations[index].worth_mm {
                self.explanations[index].worth_mm = worth_mm;
                continue;
            }
            self.explanations[index].worth_mm = f64::NEG_INFINITY;
            let explanation = &self.explanations[index];
            for piece in &explanation.verdict.pieces {
                self.claims[0].claim(&piece[0]);
                self.claims[1].claim(&piece[1]);
            }
            let found = self.found(explanation, out.iterations);
            out.parts.push(found);
        }
    }

    /// What an explanation is worth, given what is claimed.
    fn worth_mm(&self, index: usize) -> f64 {
        let e = &self.explanations[index];
        let model = &self.parts[e.hypothesis.part].pose_model;
        select::worth_mm(&self.params.select, model, &e.fit, &e.verdict, &self.claims)
            .unwrap_or(f64::NEG_INFINITY)
    }

    fn found(&self, e: &Explanation, iterations: u64) -> FoundPart {
        let prepared = &self.parts[e.hypothesis.part];
        let pose = e.fit.left_from_part;
        let placed = prepared.placed(&pose, 0.0);
        let grasp = grasp::grasp_of(&self.params.grasp, &placed);
        let (sigma_mm, sigma_axis_rad) = sigmas(&self.params.grasp, prepared, &e.fit);
        let sees = |side: usize, px: &Vector2<f64>| {
            self.pictures[side]
                .nodes()
                .iter()
                .any(|n| n.role != NodeRole::Bend && (n.position_px - px).norm() < SAME_END_PX)
        };
        let nodes = prepared.part.nodes.iter().map(|node| {
            let left_mm = pose * node.position_mm;
            let left_px = self.rig.project_left(&left_mm).unwrap_or_default();
            let right_px = self.rig.project_right(&left_mm).unwrap_or_default();
            let seen = match (sees(0, &left_px), sees(1, &right_px)) {
                (true, true) => Seen::Both,
                (true, false) => Seen::Left,
                (false, true) => Seen::Right,
                (false, false) => Seen::None,
            };
            FoundNode { left_mm, left_px, right_px, seen }
        });
        let nodes: ArrayVec<FoundNode, NODES_MAX> = nodes.collect();
        let unseen = nodes.iter().filter(|n| n.seen == Seen::None).count();
        FoundPart {
            part: e.hypothesis.part,
            fitness: e.verdict.terms(unseen).fitness(&self.params.weights),
            left_from_part: pose,
            nodes,
            grasp,
            sigma_mm,
            sigma_axis_rad,
            blocked: None,
            iterations,
            sound: select::is_sound(&e.fit, &e.verdict),
            proven: select::is_proven(&prepared.pose_model, &e.fit, &e.verdict),
            clear: e.verdict.clear[0].min(e.verdict.clear[1]),
        }
    }

    /// Finds what is blocked and ranks.
    fn grasp(&self, out: &mut Recognition) {
        let placed: ArrayVec<Placed, PARTS_MAX> = out
            .parts
            .iter()
            .map(|f| self.parts[f.part].placed(&f.left_from_part, f.sigma_mm.max()))
            .collect();
        let blocked: ArrayVec<Option<Blocked>, PARTS_MAX> = (0..placed.len())
            .map(|i| grasp::blocked(&self.params.grasp, &placed, i, &out.parts[i].grasp))
            .collect();
        drop(placed);
        for (found, blocked) in out.parts.iter_mut().zip(blocked) {
            found.blocked = blocked.or((!found.proven).then_some(Blocked::Uncertain));
        }
        let rank = |f: &FoundPart| match f.blocked {
            None => 0,
            Some(Blocked::Covered) => 2,
            Some(_) => 1,
        };
        // An unstable sort allocates nothing; places settle ties the same way every time.
        let place = |f: &FoundPart| f.left_from_part.translation.z;
        out.parts.sort_unstable_by(|a, b| {
            rank(a)
                .cmp(&rank(b))
                .then(b.sound.cmp(&a.sound))
                .then(b.clear.total_cmp(&a.clear))
                .then(place(a).total_cmp(&place(b)))
        });
    }

    fn no_pick(&self, out: &Recognition) -> Option<NoPick> {
        if out.parts.iter().any(|p| p.blocked.is_none()) {
            return None;
        }
        let late = |p: &FoundPart| p.blocked == Some(Blocked::OutOfTime);
        Some(if out.parts.iter().any(late) || (out.parts.is_empty() && out.out_of_time) {
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

/// Two refined poses nearer than this are one.
const SAME_MM: f64 = 1.0;
/// A rough pose this near to a refined one would lead to it: where that is doubtful, where it is sound.
const SAME_ROUGH_MM: [f64; 2] = [2.0, 8.0];
/// The same for a coarse pose.
const SAME_COARSE_MM: [f64; 2] = [1.0, 8.0];
/// Distance in pixels within which an image node is a part's end.
const SAME_END_PX: f64 = 5.0;

/// Marks the end of a picture at a place: the nearest, for another wire may end beside it.
fn take_end(nodes: &[nodes::ImageNode], at: &Vector2<f64>, taken: &mut [bool]) {
    let distance_px = |node: &nodes::ImageNode| (node.position_px - at).norm();
    let nearest = (0..nodes.len())
        .filter(|&n| nodes[n].role == NodeRole::End && distance_px(&nodes[n]) < SAME_END_PX)
        .min_by(|&a, &b| distance_px(&nodes[a]).total_cmp(&distance_px(&nodes[b])));
    if let Some(n) = nearest {
        taken[n] = true;
    }
}
