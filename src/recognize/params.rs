//! What recognition is told.

use crate::grasp;
use crate::matching::fitness::Weights;
use crate::matching::gate::GateParams;
use crate::matching::hypotheses::SingleParams;
use crate::matching::{lines, nodes, search, select};
use crate::pose::refine;
use crate::rig::Rig;
use crate::vision::binarize::{self, ColourRange};
use crate::vision::{graph, ridge, thin};

/// By what factor at least the thickness of dark wire may differ from the part's: shadow as dark as the wire makes it look twice as
/// thick and more.
const DARK_THICKNESS_FACTOR_MAX: f64 = 2.6;
/// What recognition is told.
#[derive(Clone, Debug, PartialEq)]
pub struct Params {
    /// Which pixels are object, left and right; they may differ in their regions.
    pub binarize: [binarize::Params; 2],
    /// How masks are thinned.
    pub thin: thin::Params,
    /// Limits of the graphs; `None`: the default for the size.
    pub graph: Option<graph::Params>,
    /// How bends are found.
    pub nodes: nodes::Params,
    /// Which image nodes may show the same point; their depth follows from rig and parts.
    pub gate: GateParams,
    /// Weights of the fitness terms.
    pub weights: Weights,
    /// Which search, and its limits.
    pub search: search::Params,
    /// What single nodes need to hold a pose.
    pub single: SingleParams,
    /// How wires that touch are told apart.
    pub ridges: ridge::Params,
    /// What straight wire in space needs to hold a pose; its depth follows from rig and parts.
    pub lines: lines::Params,
    /// How poses are refined.
    pub refine: refine::Params,
    /// Steepest slope of a straight piece of wire against the level, radians.
    pub slope_rad_max: f64,
    /// When an explanation stands.
    pub select: select::Params,
    /// What limits the grasps.
    pub grasp: grasp::Params,
}

impl Params {
    /// Whether parts may be darker than the floor, in either picture: a range of colours does not tell.
    pub fn may_be_dark(&self) -> bool {
        self.binarize.iter().any(|range| range.inverted || range.colour != ColourRange::Auto)
    }

    /// The gate for parts this far away, as their light wants it.
    pub(super) fn gate_at(&self, depth_mm: [f64; 2]) -> GateParams {
        let least = if self.may_be_dark() { DARK_THICKNESS_FACTOR_MAX } else { 0.0 };
        let thickness_factor_max = self.gate.thickness_factor_max.max(least);
        GateParams { depth_mm, thickness_factor_max, ..self.gate }
    }
}

/// How far away parts can be seen at all: not nearer than half the baseline, where no lens shows both cameras the same, and
/// not so far that the thickest is thinner than a pixel.
pub(super) fn depth_mm(rig: &Rig, thickest_mm: f64) -> [f64; 2] {
    let focal_px = [rig.left, rig.right].iter().flat_map(|c| [c.fx, c.fy]).fold(0.0, f64::max);
    [rig.right_from_left.translation.vector.norm() / 2.0, focal_px * thickest_mm]
}

impl Default for Params {
    fn default() -> Self {
        Self {
            binarize: Default::default(),
            thin: Default::default(),
            graph: None,
            nodes: Default::default(),
            gate: Default::default(),
            weights: Default::default(),
            search: Default::default(),
            single: Default::default(),
            ridges: Default::default(),
            lines: Default::default(),
            refine: Default::default(),
            slope_rad_max: 50f64.to_radians(),
            select: Default::default(),
            grasp: Default::default(),
        }
    }
}
