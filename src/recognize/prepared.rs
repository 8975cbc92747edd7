//! A part with all that recognition works out of it beforehand.

use std::f64::consts::FRAC_PI_2;

use nalgebra::{Isometry3, Point3, Vector2, Vector3};

use super::explanations::Explanation;
use super::params::Params;
use super::result::Seen;
use crate::grasp::Placed;
use crate::level::Level;
use crate::matching::fitness::Judge;
use crate::matching::nodes::{ImageNode, NodeRole};
use crate::matching::problem::MatchModel;
use crate::matching::select;
use crate::part::Part;
use crate::picture::Picture;
use crate::pose::model::PoseModel;
use crate::pose::verify::Stop;
use crate::rig::Rig;

/// Distance in pixels within which an image node is a part's end.
pub(super) const SAME_END_PX: f64 = 5.0;

/// In heaps wires meet or cross at more than so many times as many places as they end.
const HEAP_MIN: f64 = 2.5;

/// A part and all that is worked out of it beforehand.
pub(super) struct Prepared {
    pub(super) part: Part,
    /// With stations as they are else, and where wires lie dense.
    pose_models: [PoseModel; 2],
    is_dense: bool,
    pub(super) match_model: MatchModel,
    pub(super) stops: Vec<Stop>,
    /// Mean of nodes and bends, which no symmetry moves.
    middle_mm: Point3<f64>,
    /// Distances between its nodes and bends, the shortest first.
    pub(super) distances_mm: Vec<f64>,
    /// Slope in radians that some wire of the part has at least, however it lies: nought for a flat part.
    raised_rad: f64,
}

/// Has the parts' wire looked at as these pictures want it: twice as closely in heaps, where wires meet or cross at many more
/// places than they end.
pub(super) fn suit(parts: &mut [Prepared], pictures: &[Picture; 2]) {
    let count = |role: NodeRole| {
        let nodes = pictures.iter().flat_map(Picture::nodes);
        nodes.filter(|node| node.role == role).count()
    };
    let is_dense = count(NodeRole::Junction) as f64 > HEAP_MIN * count(NodeRole::End) as f64;
    parts.iter_mut().for_each(|part| part.is_dense = is_dense);
}

impl Prepared {
    pub(super) fn new(part: Part) -> Self {
        let pose_models = [PoseModel::new(&part), PoseModel::dense(&part)];
        let match_model = MatchModel::new(&part);
        let stops = stops_of(&match_model, &pose_models[0]);
        let anchors = &match_model.anchors;
        let sum = anchors.iter().map(|a| a.position_mm.coords).sum::<Vector3<f64>>();
        let middle_mm = Point3::from(sum / anchors.len().max(1) as f64);
        let raised_rad = raised_rad(&match_model);
        let mut distances_mm = match_model.distances_mm.clone();
        distances_mm.sort_by(f64::total_cmp);
        Self { part, pose_models, is_dense: false, match_model, stops, middle_mm, distances_mm, raised_rad }
    }

    /// The part as pose estimation sees it in the pair that is looked at.
    pub(super) fn pose_model(&self) -> &PoseModel {
        &self.pose_models[usize::from(self.is_dense)]
    }

    /// Most stations that [`Self::pose_model`] may have.
    pub(super) fn stations_max(&self) -> usize {
        self.pose_models[1].stations.len()
    }

    pub(super) fn placed<'a>(
        &'a self,
        left_from_part: &'a Isometry3<f64>,
        sigma_mm: Vector3<f64>,
    ) -> Placed<'a> {
        Placed { part: &self.part, model: self.pose_model(), left_from_part, sigma_mm }
    }

    /// What its rough poses are judged by.
    pub(super) fn judge<'a>(
        &'a self,
        rig: &'a Rig,
        pictures: &'a [Picture; 2],
        params: &Params,
    ) -> Judge<'a> {
        Judge {
            rig,
            masks: [pictures[0].mask(), pictures[1].mask()],
            model: &self.match_model,
            weights: params.weights,
            length_tolerance_mm: params.search.length_tolerance_mm,
            level: Level::detect(),
        }
    }

    /// Its nodes at a pose: in the left camera's frame, in both pictures, and whether these show one there.
    pub(super) fn nodes_seen<'a>(
        &'a self,
        rig: &'a Rig,
        pose: &'a Isometry3<f64>,
        image_nodes: [&'a [ImageNode]; 2],
    ) -> impl Iterator<Item = (Point3<f64>, [Vector2<f64>; 2], Seen)> {
        let sees = move |side: usize, px: &Vector2<f64>| {
            image_nodes[side].iter().any(|n| {
                n.role != NodeRole::Bend && (n.position_px - px).norm_squared() < SAME_END_PX * SAME_END_PX
            })
        };
        self.part.nodes.iter().map(move |node| {
            let left_mm = pose * node.position_mm;
            let px = [rig.project_left(&left_mm), rig.project_right(&left_mm)].map(Option::unwrap_or_default);
            let seen = match (sees(0, &px[0]), sees(1, &px[1])) {
                (true, true) => Seen::Both,
                (true, false) => Seen::Left,
                (false, true) => Seen::Right,
                (false, false) => Seen::None,
            };
            (left_mm, px, seen)
        })
    }

    /// How many of its nodes no picture shows.
    pub(super) fn unseen(&self, rig: &Rig, pose: &Isometry3<f64>, image_nodes: [&[ImageNode]; 2]) -> usize {
        self.nodes_seen(rig, pose, image_nodes).filter(|(.., seen)| *seen == Seen::None).count()
    }

    /// Length of wire that must be seen of it, in radii.
    pub(super) fn least_seen_radii(&self, share: f64) -> f64 {
        share * self.pose_model().length_mm / self.pose_model().radius_mm
    }

    /// Whether a straight piece of it is steeper than parts lie: `slope_rad_max`, and more for a part that is not flat.
    pub(super) fn is_too_steep(
        &self,
        left_from_part: &Isometry3<f64>,
        down: &Vector3<f64>,
        slope_rad_max: f64,
    ) -> bool {
        let slope = |leg: &(Vector3<f64>, f64)| (left_from_part * leg.0).dot(down).abs();
        let steepest =
            self.match_model.anchors.iter().flat_map(|a| a.legs.iter().map(slope)).fold(0.0, f64::max);
        steepest > self.slope_sin_max(slope_rad_max)
    }

    /// Sine of the slope up to which its straight pieces lie.
    pub(super) fn slope_sin_max(&self, slope_rad_max: f64) -> f64 {
        (slope_rad_max + 2.0 * self.raised_rad).min(FRAC_PI_2).sin()
    }

    /// The first explanation of this part, whose index is `part`, that lies near a pose: nearer than the first distance in
    /// mm, or the second where nothing speaks against the explanation.
    pub(super) fn place_among(
        &self,
        explanations: &[Explanation],
        part: usize,
        pose: &Isometry3<f64>,
        near_mm: [f64; 2],
    ) -> Option<usize> {
        let middle = pose * self.middle_mm;
        // The mean of distances is at least the distance of the means.
        let is_far = |e: &Explanation| {
            (e.fit.left_from_part * self.middle_mm - middle).norm() >= near_mm[0].max(near_mm[1])
        };
        explanations.iter().position(|e| {
            e.hypothesis.part == part && !is_far(e) && {
                let distance_mm = self.distance_mm(&e.fit.left_from_part, pose);
                distance_mm < near_mm[0]
                    || distance_mm < near_mm[1]
                        && select::is_sound(&e.fit, &e.verdict, e.overrun_mm)
                        && self.beside_mm(&e.fit.left_from_part, pose) < self.pose_model().radius_mm
            }
        })
    }

    /// How far two poses of the part lie beside each other; displacement along a straight part does not count.
    fn beside_mm(&self, a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
        match self.pose_model().straight_along {
            Some(along) => {
                let (along, centre) = (a * along, self.pose_model().centre_mm);
                (b * centre - a * centre).cross(&along).norm()
            }
            None => self.distance_mm(a, b),
        }
    }

    /// Whether the part at a pose `b` is but another place along the wire that it has at a pose `a`.
    pub(super) fn is_same_wire(&self, a: &Isometry3<f64>, b: &Isometry3<f64>) -> bool {
        let apart_mm = (a * self.middle_mm - b * self.middle_mm).norm();
        apart_mm < self.pose_model().length_mm / 2.0
            && self.beside_mm(a, b) < SAME_WIRE_RADII * self.pose_model().radius_mm
    }

    /// Whether two poses are nearer to each other than so much.
    pub(super) fn is_near(&self, a: &Isometry3<f64>, b: &Isometry3<f64>, near_mm: f64) -> bool {
        // The mean of distances is at least the distance of the means.
        (a * self.middle_mm - b * self.middle_mm).norm() < near_mm && self.distance_mm(a, b) < near_mm
    }

    /// Mean distance of the part's nodes and bends between two poses, under the symmetry that makes it least.
    pub(super) fn distance_mm(&self, a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
        let anchors = &self.match_model.anchors;
        let mean = |turn: &Isometry3<f64>| {
            let b = b * turn;
            anchors.iter().map(|p| (a * p.position_mm - b * p.position_mm).norm()).sum::<f64>()
                / anchors.len() as f64
        };
        self.part
            .symmetries
            .iter()
            .map(|s| mean(&s.part_from_part))
            .fold(mean(&Isometry3::identity()), f64::min)
    }
}

/// How far two places of a part that are one wire lie beside each other: errors of depth, in radii.
const SAME_WIRE_RADII: f64 = 2.0;

/// See [`Prepared::raised_rad`]: of a part that is not flat the least over many ways in which it may lie.
fn raised_rad(model: &MatchModel) -> f64 {
    let legs = || model.anchors.iter().flat_map(|a| a.legs.iter().map(|leg| leg.0));
    let steepest = |up: &Vector3<f64>| legs().map(|leg| leg.dot(up).abs()).fold(0.0, f64::max);
    let across = legs().flat_map(|a| legs().filter_map(move |b| a.cross(&b).try_normalize(0.05)));
    let ways = (0..WAYS_UP).map(|k| {
        // Evenly over a half sphere: the golden angle on.
        let z = (f64::from(k) + 0.5) / f64::from(WAYS_UP);
        let (sin, cos) = (f64::from(k) * GOLDEN_ANGLE_RAD).sin_cos();
        let r = (1.0 - z * z).sqrt();
        Vector3::new(r * cos, r * sin, z)
    });
    let least = across.chain(ways).map(|up| steepest(&up)).fold(1.0, f64::min);
    if model.straight || least < FLAT_SIN { 0.0 } else { least.asin() }
}

/// Ways in which a part may lie that are tried.
const WAYS_UP: u32 = 2000;
const GOLDEN_ANGLE_RAD: f64 = 2.399_963_229_728_653;
/// Wires that can all lie this near to the level make a flat part.
const FLAT_SIN: f64 = 0.05;

/// Where the wire of a part stops or turns away.
fn stops_of(model: &MatchModel, pose_model: &PoseModel) -> Vec<Stop> {
    let mut stops = Vec::new();
    for anchor in &model.anchors {
        for (leg, _) in &anchor.legs {
            let goes_on = anchor.legs.iter().any(|(other, _)| other.dot(leg) < -0.9);
            if !goes_on {
                let end =
                    pose_model.ends.iter().position(|e| (e.position_mm - anchor.position_mm).norm() < 1e-6);
                stops.push(Stop { position_mm: anchor.position_mm, onward: -leg, end });
            }
        }
    }
    stops
}
