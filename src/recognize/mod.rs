//! Recognition: a pair of pictures in, ranked grasps out. Composes the stages; each is a library of its own.
//!
//! Nothing is kept from one pair to the next. After `new` nothing is allocated, except for JPEG other than baseline.
//!
//! ```
//! use pickcell::part::Part;
//! use pickcell::recognize::{Params, Recognition, Recognizer};
//! use pickcell::session::Session;
//! use pickcell::{frame::FramePair, rig::Rig, time::Budget};
//!
//! let replay = std::path::Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/replay"));
//! let rig = Rig::read(replay.join("conveyor/calibration.yaml"))?;
//! let rod = Part::read(replay.join("parts/rod-90.toml"))?;
//! let mut recognizer = Recognizer::new(Params::default(), rig, vec![rod])?;
//!
//! let session = Session::open(&replay.join("conveyor"))?;
//! let [Some(left), Some(right)] = &session.pairs[0].pictures else { panic!("a whole pair") };
//! let pair = FramePair { left: left.read()?, right: right.read()? };
//! let mut found = Recognition::default();
//! recognizer.run(&pair, Budget::Iterations(20_000), 1, &mut found)?;
//!
//! let first = &found.parts[0]; // the best one to take
//! assert_eq!(first.blocked, None);
//! // in the left camera's frame, which looks down on the bin half a metre below
//! assert!((440.0..500.0).contains(&first.grasp.position_mm.z));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod colours;
mod explanations;
mod found;
mod interrupted;
mod lamp;
mod lighting;
mod outcome;
mod params;
mod prepared;
mod result;
mod spread;
mod turned;
mod unexplained;
mod unknown;
mod views;
mod votes;

use nalgebra::{Isometry3, Vector3};

use crate::frame::{FramePair, LumaView};
use crate::grasp::{self, Blocked};
use crate::hands;
use crate::level::Level;
use crate::matching::hypotheses::{self, Hypothesis, SingleNode};
use crate::matching::lines::{self, Lines};
use crate::matching::search::Search;
use crate::part::Part;
use crate::picture::{Picture, halvings};
use crate::pose::gloss::Gloss;
use crate::pose::shadow::ShadowSide;
use crate::rig::Rig;
use crate::time::{Budget, Spent, Timestamp, Watch};
use crate::vision::beside::Beside;
use crate::vision::binarize;
use crate::vision::ridge::{self, Ridges};

use explanations::{Explanations, Scene};
use lighting::Lighting;
pub use params::Params;
use prepared::Prepared;
pub use result::{Doubt, FoundNode, FoundPart, NoPick, Recognition, Refusal, Seen, Side, StageTimes, Turned};
use unexplained::{is_claimed, unexplained_px};
use unknown::Unknown;
use views::{lit, views};
use votes::Votes;

/// Shares of the time that is left each time, in each go at a pair: for the search, for looking at what it found, which takes about as long, and
/// for the competition. The rest is for the grasps.
const SEARCH_SHARE: f64 = 0.5;
const LOOK_SHARE: f64 = 0.7;
const COMPETE_SHARE: f64 = 0.5;
/// Unexplained skeleton as long as this share of what must be seen of a part is reason to look for one: where it lies along
/// another, their wires have but one skeleton.
const UNEXPLAINED_SHARE: f64 = 0.5;
/// Most hypotheses of a pair.
const HYPOTHESES_MAX: usize = 16384;

/// The whole recognition with all its memory.
pub struct Recognizer {
    params: Params,
    /// Of the pictures as they are, and halved once, twice and so on; the right camera turned as is allowed for.
    scales: Vec<Scale>,
    parts: Vec<Prepared>,
    /// Of the thinnest part and of the thickest.
    thickness_mm: [f64; 2],
    pictures: [Picture; 2],
    votes: Votes,
    search: Search,
    pool: Vec<Hypothesis>,
    lines: Lines,
    explanations: Explanations,
    unknown: Unknown,
    gloss: Gloss,
    shadow_side: ShadowSide,
    lighting: Lighting,
    /// Where both pictures are asked for their colours.
    places: [Vec<Beside>; 2],
    second: Option<hands::Owner>,
    /// As calibrated.
    rig: Rig,
    /// The turn of the right camera that is allowed for, radians, along the left camera's axes.
    turn: Vector3<f64>,
}

/// What goes with one size of the pictures.
struct Scale {
    rig: Rig,
    ridges: [Ridges; 2],
    /// What no part explains for certain.
    areas: [ridge::Area; 2],
}

impl Scale {
    fn new(rig: Rig, params: ridge::Params) -> Self {
        Self {
            areas: [&rig.left, &rig.right].map(|c| ridge::Area::new(c.width, c.height)),
            ridges: [&rig.left, &rig.right].map(|c| Ridges::new(params, c.width, c.height)),
            rig,
        }
    }
}

impl Recognizer {
    /// Reserves all memory for pictures of the calibration's size.
    ///
    /// # Errors
    /// Where the colour range, the region or the size of the pictures cannot be used.
    ///
    /// # Panics
    /// Where a part is none that [`Part::read`] takes: without nodes or edges, or with a length that is no positive number.
    pub fn new(params: Params, rig: Rig, parts: Vec<Part>) -> Result<Self, binarize::ParamsError> {
        let [left, right] = params.binarize.clone();
        let picture = |range, camera| Picture::new(range, &params, camera, &parts);
        let pictures = [picture(left, rig.left)?, picture(right, rig.right)?];
        let cameras = halvings(rig.left).zip(halvings(rig.right));
        let scales = cameras.map(|(left, right)| Scale::new(Rig { left, right, ..rig }, params.ridges));
        let scales = scales.collect();
        let thickness_mm = parts.iter().map(|part| part.thickness_mm);
        let thickness_mm =
            [thickness_mm.clone().fold(f64::INFINITY, f64::min), thickness_mm.fold(0.0, f64::max)];
        let depth_mm = params::depth_mm(&rig, thickness_mm[1]);
        let parts: Vec<Prepared> = parts.into_iter().map(Prepared::new).collect();
        Ok(Self {
            votes: Votes::new(thickness_mm, depth_mm),
            thickness_mm,
            search: Search::new(params.search, params.gate_at(depth_mm), parts.len()),
            pool: Vec::with_capacity(HYPOTHESES_MAX),
            lines: Lines::new(lines::Params { depth_mm, ..params.lines }, params.ridges.stretches_max),
            explanations: Explanations::new(params.refine, &rig, params.nodes.nodes_max, &parts),
            unknown: Unknown::new(&pictures),
            gloss: Gloss::new(Level::detect()),
            shadow_side: ShadowSide::new(Level::detect()),
            lighting: Lighting::default(),
            places: [0, 1].map(|_| Vec::with_capacity(colours::PLACES_MAX)),
            pictures,
            params,
            scales,
            parts,
            second: None,
            rig,
            turn: Vector3::zeros(),
        })
    }

    /// Has a second thread look at the right picture of each pair while this one looks at the left. The result does not
    /// depend on it. The other half of [`hands::hands`] must be at [`work`](hands::Helper::work) there, or gone: each pair waits for it.
    pub fn share_with(&mut self, second: hands::Owner) {
        self.second = Some(second);
    }

    /// The rig, as calibrated.
    pub fn rig(&self) -> &Rig {
        &self.rig
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
        if budget == Budget::Repeated(Spent::ON_PICTURES) || !self.look(pair, budget.end(), &mut stages)? {
            (out.out_of_time, out.no_pick, out.spent) = (true, Some(NoPick::OutOfTime), Spent::ON_PICTURES);
            stages.total_ns = Timestamp::now().ns_since(begin);
            out.stages = stages;
            return Ok(());
        }
        let looked_at = Timestamp::now();
        self.lighting = Lighting::default();
        let told_by_ends = self.turn_told_by_ends()?;
        stages.match_ns = Timestamp::now().ns_since(looked_at);
        let nodes = |p: &Picture| p.graph().nodes.len();
        (out.nodes_left, out.nodes_right) = (nodes(&self.pictures[0]), nodes(&self.pictures[1]));
        prepared::suit(&mut self.parts, &self.pictures);
        let (looking, exchanging) = (budget.looks(LOOK_SHARE), budget.exchanges(COMPETE_SHARE));
        let mut job = Job { pair, budget, seed, looking, exchanging, stages };
        let in_time = self.recognise_turned(told_by_ends, &mut job, out);
        let Job { looking, exchanging, mut stages, .. } = job;
        (out.spent.looks, out.spent.exchanges) = (looking.rang_after(), exchanging.rang_after());
        out.out_of_time |= !in_time;
        let recognised = Timestamp::now();
        self.grasp(pair, in_time, out);
        out.spent.late = budget.is_late();
        if out.spent.late {
            out.out_of_time = true;
            for found in &mut out.parts {
                found.blocked.get_or_insert(Blocked::OutOfTime);
            }
        }
        out.no_pick = self.no_pick(out);
        let end = Timestamp::now();
        stages.pose_ns += end.ns_since(recognised);
        stages.total_ns = end.ns_since(begin);
        out.stages = stages;
        Ok(())
    }

    /// From graphs to parts, with the right camera turned as is allowed for; says whether there was time for all.
    fn recognise(&mut self, job: &mut Job, out: &mut Recognition) -> bool {
        let begin = Timestamp::now();
        let Job { pair, budget, seed, looking, exchanging, stages } = job;
        out.parts.clear();
        out.out_of_time = false;
        self.search(budget.less(out.spent.iterations).share(SEARCH_SHARE), *seed, out);
        let matched = Timestamp::now();
        self.judge_colours(pair, budget.end());
        self.judge_lighting(pair);
        let refine = lit(self.params.refine, self.lighting);
        self.explanations.clear(refine, self.pictures.each_ref().map(Picture::nodes));
        looking.set_again(*budget, LOOK_SHARE);
        let mut all_looked_at = self.explain(pair, false, looking);
        if all_looked_at && !looking.is_over() && self.search_ends(looking, out) {
            all_looked_at = self.explain(pair, true, looking);
        }
        if all_looked_at && !looking.is_over() && self.search_ridges(pair, looking, out) {
            all_looked_at = self.explain(pair, true, looking);
        }
        all_looked_at &= !looking.is_over();
        exchanging.set_again(*budget, COMPETE_SHARE);
        let in_time = self.compete(pair, exchanging, out) && all_looked_at;
        stages.match_ns += matched.ns_since(begin);
        stages.pose_ns += Timestamp::now().ns_since(matched);
        in_time
    }

    /// Takes both pictures through their stages; says whether there was time.
    fn look(
        &mut self,
        pair: &FramePair,
        end: Option<Timestamp>,
        stages: &mut StageTimes,
    ) -> Result<bool, Refusal> {
        let [left, right] = &mut self.pictures;
        let mut of_right = StageTimes::default();
        let is_shared = self.second.is_some();
        let (left, right) = hands::both(
            &mut self.second,
            || left.run(&pair.left, Side::Left, end, stages),
            || right.run(&pair.right, Side::Right, end, &mut of_right),
        );
        stages.with(&of_right, if is_shared { u64::max } else { |left, right| left + right });
        let frames = [&pair.left, &pair.right];
        let in_time = left? & right? && Picture::agree(&mut self.pictures, frames, end, stages)?;
        let is_empty = self.pictures.iter().any(|picture| picture.graph().edges.is_empty());
        if !in_time {
            self.pictures.iter_mut().for_each(Picture::forget);
        }
        if in_time && !is_empty && pair.left.bytes == pair.right.bytes {
            return Err(Refusal::Same);
        }
        Ok(in_time)
    }

    /// Fills the pool with rough poses of all parts, fittest first: those that single nodes hold with the wire that leaves
    /// them, each for an iteration of the budget, and those of matches.
    fn search(&mut self, budget: Budget, seed: u64, out: &mut Recognition) {
        let Self { pictures, scales, parts, thickness_mm, search, pool, params, .. } = self;
        let rig = rig_of(scales, pictures);
        let [left, right] = [pictures[0].nodes(), pictures[1].nodes()];
        pool.clear();
        let judge_of = |part: usize| parts[part].judge(rig, pictures, params);
        let down = grasp::down_in_left(&params.grasp);
        let may_lie =
            |part: usize, pose: &Isometry3<f64>| !parts[part].is_too_steep(pose, &down, params.slope_rad_max);
        search.begin(rig, left, right, *thickness_mm);
        let mut used = 0;
        for index in 0..parts.len() {
            let judge = judge_of(index);
            for (n, node) in search.near_nodes() {
                if budget.is_spent(used) || budget.is_over() {
                    out.out_of_time = true;
                    break;
                }
                used += 1;
                let images = [&left[node.left as usize], &right[node.right as usize]];
                let single = SingleNode { index: n, node, images };
                let may_lie = |pose: &Isometry3<f64>| may_lie(index, pose);
                hypotheses::of_single_node(&params.single, index, &judge, &single, &down, may_lie, pool);
            }
        }
        search.run_exact(judge_of, budget.less(used));
        used += search.iterations();
        search.run_by_chance(rig, [left, right], judge_of, budget, &mut used, seed);
        out.spent.iterations += used;
        out.out_of_time |= search.is_out_of_time();
        let matches: usize = (0..parts.len()).map(|p| search.matches(p).len()).sum();
        // What there is no room for is not looked at: the least fit.
        let room = HYPOTHESES_MAX.saturating_sub(matches);
        if pool.len() == HYPOTHESES_MAX || pool.len() > room {
            out.out_of_time = true;
            pool.sort_unstable_by(|a, b| a.fitness.total_cmp(&b.fitness));
            pool.truncate(room);
        }
        for (index, prepared) in parts.iter().enumerate() {
            for found in search.matches(index) {
                if pool.len() < HYPOTHESES_MAX {
                    let pose = hypotheses::of_match(index, &prepared.match_model, found, search.nodes());
                    pool.extend(pose.filter(|h| may_lie(index, &h.left_from_part)));
                }
            }
        }
        pool.sort_unstable_by(|a, b| a.fitness.total_cmp(&b.fitness));
    }

    /// Fills the pool with rough poses of bent parts that ends hold which no explanation has; says whether there are any. As
    /// what is looked at, they cost time, but no iterations.
    fn search_ends(&mut self, looking: &mut Watch, out: &mut Recognition) -> bool {
        let Self { pictures, scales, parts, search, pool, params, explanations, .. } = self;
        let rig = rig_of(scales, pictures);
        let [left, right] = [pictures[0].nodes(), pictures[1].nodes()];
        let down = grasp::down_in_left(&params.grasp);
        pool.clear();
        for (index, prepared) in parts.iter().enumerate().filter(|(_, p)| !p.match_model.straight) {
            let judge = prepared.judge(rig, pictures, params);
            let may_lie = |pose: &Isometry3<f64>| !prepared.is_too_steep(pose, &down, params.slope_rad_max);
            let free_ends =
                || search.near_nodes().filter(|(_, node)| !explanations.has_end(node, prepared, parts));
            for (n, node) in free_ends() {
                if looking.is_over() {
                    break;
                }
                let images = [&left[node.left as usize], &right[node.right as usize]];
                let single = SingleNode { index: n, node, images };
                hypotheses::of_single_end(&params.single, index, &judge, &single, &down, may_lie, pool);
                if !prepared.match_model.smooth {
                    continue;
                }
                for (m, other) in free_ends().take_while(|(m, _)| *m < n) {
                    if looking.is_over() {
                        break;
                    }
                    let images = [&left[other.left as usize], &right[other.right as usize]];
                    let other = SingleNode { index: m, node: other, images };
                    let two = [&single, &other];
                    hypotheses::of_two_ends(&params.single, index, &judge, two, &down, may_lie, pool);
                }
            }
        }
        out.out_of_time |= pool.len() == HYPOTHESES_MAX;
        pool.sort_unstable_by(|a, b| a.fitness.total_cmp(&b.fitness));
        !pool.is_empty()
    }

    /// Fills the pool with rough poses that straight wire holds which nothing explains for certain; says whether there
    /// are any.
    fn search_ridges(&mut self, pair: &FramePair, looking: &mut Watch, out: &mut Recognition) -> bool {
        // A little that is amiss with a part is no reason to look; but who looks, looks at that as well.
        let half_px = self.pictures.each_ref().map(Picture::half_width_px);
        for nearly in [true, false] {
            self.explanations.claim_whole(&self.parts, &self.params.select, nearly);
            if !self.find_unexplained(&half_px) {
                return false;
            }
        }
        self.explanations.settle_claimed(&self.parts);
        let Self { pictures, scales, parts, pool, params, lines, explanations, second, lighting, .. } = self;
        let Scale { rig, ridges, areas } = &mut scales[pictures[0].halvings()];
        pool.clear();
        let claims = explanations.claims();
        let (Some(left), Some(right)) =
            (LumaView::new(pictures[0].luma(&pair.left)), LumaView::new(pictures[1].luma(&pair.right)))
        else {
            return false;
        };
        let (pictures, areas) = (&*pictures, &*areas);
        let end = looking.end();
        let look = |ridges: &mut Ridges, luma: LumaView, side: usize| {
            ridges.run(luma, pictures[side].mask(), &areas[side], lighting.dark, half_px[side], end);
        };
        let [left_ridges, right_ridges] = &mut *ridges;
        hands::both(second, || look(left_ridges, left, 0), || look(right_ridges, right, 1));
        // What may have been broken off is not looked at, now or when it is done again.
        if looking.is_over() {
            return false;
        }
        let down = grasp::down_in_left(&params.grasp);
        let slope_sin_max = parts.iter().map(|p| p.slope_sin_max(params.slope_rad_max)).fold(0.0, f64::max);
        let [left, right] = [0, 1].map(|side: usize| {
            let claims = &claims[side];
            ridges[side].stretches().iter().filter(move |s| !is_claimed(claims, s))
        });
        lines.run(rig, [left, right], &down, slope_sin_max, looking);
        for (index, prepared) in parts.iter().enumerate() {
            let judge = prepared.judge(rig, pictures, params);
            lines.hypotheses(index, &judge, looking, pool);
        }
        // What there was no room for has not been looked at.
        out.out_of_time |=
            ridges.iter().any(Ridges::is_full) || lines.is_full() || pool.len() == HYPOTHESES_MAX;
        let slope_rad_max = params.slope_rad_max;
        pool.retain(|h| !parts[h.part].is_too_steep(&h.left_from_part, &down, slope_rad_max));
        pool.sort_unstable_by(|a, b| a.fitness.total_cmp(&b.fitness));
        !pool.is_empty()
    }

    /// Finds the areas of wire, half of it as wide as given, that nobody has claimed; says whether there is enough of it for
    /// a part.
    fn find_unexplained(&mut self, half_px: &[f64; 2]) -> bool {
        let Self { pictures, scales, parts, params, explanations, .. } = self;
        let areas = &mut scales[pictures[0].halvings()].areas;
        let share = UNEXPLAINED_SHARE * params.select.seen_min;
        let least_radii = parts.iter().map(|p| p.least_seen_radii(share)).fold(f64::INFINITY, f64::min);
        [0, 1].into_iter().all(|side: usize| {
            unexplained_px(&pictures[side], &explanations.claims()[side], half_px[side], &mut areas[side])
                >= least_radii * half_px[side]
        })
    }

    /// Holds the pool's hypotheses against both pictures, for the first time or `again`; says whether all of them.
    fn explain(&mut self, pair: &FramePair, again: bool, looking: &mut Watch) -> bool {
        let rig = rig_of(&self.scales, &self.pictures);
        let views = views(&self.pictures, rig, pair, self.lighting);
        let Some(views) = views else { return true };
        let scene = Scene {
            rig,
            parts: &self.parts,
            fitness_max: self.params.search.fitness_max,
            weights: &self.params.weights,
            views,
            image_nodes: self.pictures.each_ref().map(Picture::nodes),
            stereo_nodes: self.search.nodes(),
            down: grasp::down_in_left(&self.params.grasp),
            slope_rad_max: self.params.slope_rad_max,
        };
        self.explanations.explain(&scene, &self.pool, again, looking)
    }
}

/// A pair whose graphs are there, over all goes at it.
struct Job<'a> {
    pair: &'a FramePair,
    budget: Budget,
    seed: u64,
    /// Whether time for looking is over.
    looking: Watch,
    /// Whether time for the competition is over.
    exchanging: Watch,
    stages: StageTimes,
}

/// That of the size in which the pictures were looked at.
fn rig_of<'a>(scales: &'a [Scale], pictures: &[Picture; 2]) -> &'a Rig {
    &scales[pictures[0].halvings()].rig
}

#[cfg(test)]
mod tests;
