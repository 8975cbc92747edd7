//! What the light of a pair does to outlines, found out before poses are refined.

use arrayvec::ArrayVec;
use nalgebra::Vector2;

use super::views::views;
use super::{Recognizer, rig_of};
use crate::frame::FramePair;
use crate::matching::problem::StereoNode;
use crate::picture::Picture;
use crate::pose::gloss::Gloss;
use crate::pose::refine::View;
use crate::pose::section::HALF_WAY;
use crate::vision::graph::Graph;

/// At which level outlines of dark parts are taken, in 1/256 of the way from the floor's light to theirs: nearer to theirs than
/// half way, for shadows lie between.
const DARK_OUTLINE_256: u8 = 144;
/// Most hypotheses that are asked where shadows fall.
const SHADOWS_MAX: usize = 160;
/// Depths of nodes of which the median is taken.
const DEPTHS_MAX: usize = 256;

/// What the light of a pair does to outlines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Lighting {
    /// Whether parts are darker than the floor.
    pub(super) dark: bool,
    /// How many times as far as in luma outlines may be displaced.
    pub(super) displaced_times: f64,
    /// Whether it was judged in this pair if grey values stand for colours.
    pub(super) is_hue_judged: bool,
    /// At which level they are taken, see [`Profiler::with_outlines_at`](crate::pose::section::Profiler::with_outlines_at).
    pub(super) outline_256: u8,
    /// Where the shadows of dark parts fall, see [`ShadowSide::falls`](crate::pose::shadow::ShadowSide::falls); nought where
    /// that is not known.
    pub(super) shadow: Vector2<f64>,
}

impl Default for Lighting {
    /// That of dull bright wire under a lamp above.
    fn default() -> Self {
        Self {
            dark: false,
            displaced_times: 1.0,
            is_hue_judged: false,
            outline_256: HALF_WAY,
            shadow: Vector2::zeros(),
        }
    }
}

impl Recognizer {
    /// Finds out at which level outlines are to be taken, and where the shadows of dark parts fall.
    pub(super) fn judge_lighting(&mut self, pair: &FramePair) {
        let Self { pictures, scales, thickness_mm, parts, search, pool, gloss, shadow_side, .. } = self;
        let rig = rig_of(scales, pictures);
        let dark = self.lighting.dark;
        (self.lighting.outline_256, self.lighting.shadow) = (HALF_WAY, Vector2::zeros());
        if dark {
            self.lighting.outline_256 = DARK_OUTLINE_256;
        }
        let Some(views) = views(pictures, rig, pair, self.lighting) else { return };
        if dark {
            shadow_side.clear();
            for hypothesis in pool.iter().take(SHADOWS_MAX) {
                let model = parts[hypothesis.part].pose_model();
                shadow_side.look_at(model, &hypothesis.left_from_part, &views);
            }
            self.lighting.shadow = shadow_side.falls().unwrap_or_default();
        } else {
            let graphs = pictures.each_ref().map(Picture::graph);
            let nodes = search.near_nodes().map(|(_, node)| node);
            self.lighting.outline_256 = outline_256(gloss, &views, graphs, nodes, thickness_mm[0]);
        }
    }
}

/// At which level outlines are taken, where these nodes may lie: see [`Gloss`]. The same in both pictures, for the same
/// outlines are to be compared.
fn outline_256<'a>(
    gloss: &mut Gloss,
    views: &[View; 2],
    graphs: [&Graph; 2],
    nodes: impl Iterator<Item = &'a StereoNode>,
    thinnest_mm: f64,
) -> u8 {
    let mut depths_mm: ArrayVec<f64, DEPTHS_MAX> =
        nodes.map(|node| node.point_mm.z).take(DEPTHS_MAX).collect();
    if depths_mm.is_empty() {
        return HALF_WAY;
    }
    let middle = depths_mm.len() / 2;
    let depth_mm = *depths_mm.select_nth_unstable_by(middle, f64::total_cmp).1;
    let levels = views.iter().zip(graphs).map(|(View { camera, profiler, .. }, graph)| {
        gloss.outline_256(graph, profiler, thinnest_mm * camera.fx / depth_mm)
    });
    levels.fold(HALF_WAY, u8::min)
}
