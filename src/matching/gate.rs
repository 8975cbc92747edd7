//! Which pairs of image nodes may show the same point: the candidates that all searches take.
//!
//! The epipolar test comes first, in single precision and for all right nodes of a left one in a row; what wire leaves in
//! other directions in one picture than in the other goes next, and only what is left is triangulated. What is in a bin lies at
//! about one depth: where enough ends and bends have but one partner, these tell it, and pairs far from it are left out. With
//! [`Mode::None`] a pair is left out only where it shows no point in space, or lies farther from the line than any camera that
//! was calibrated once.

use nalgebra::{Matrix2, Vector2, Vector3};

use super::nodes::{ImageNode, LEGS_MAX, NodeRole};
use super::problem::{StereoNode, common_role, is_same_direction};
use super::rows::{self, CHUNK, for_bits};
use crate::level::Level;
use crate::rig::{Rig, StereoGeometry};

/// Which nodes of the right picture may go with a node of the left one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Mode {
    /// Those near its epipolar line that wire leaves in the same direction, at a depth and of a thickness that a part can have.
    #[default]
    Epipolar,
    /// All: what does not fit is left to the fitness.
    None,
}

/// Limits of the gate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GateParams {
    /// Whether the gate is closed.
    pub mode: Mode,
    /// Distance from the epipolar line at most, for two ends or two bends, in pixels.
    pub gap_px_max: f64,
    /// The same where one of them is a junction, whose place depends on what crosses there.
    pub junction_gap_px_max: f64,
    /// Distance from the epipolar line at most with [`Mode::None`], in pixels. One such node costs a match of two a
    /// fitness of 1 by default.
    pub open_gap_px_max: f64,
    /// Cosine of the angle between the directions in which both pictures show the same wire, at least: up to 30 degrees
    /// for its slope, and what a short piece of skeleton tells amiss.
    pub leg_cos_min: f64,
    /// Depth of a part's points in the left camera's frame, in mm.
    pub depth_mm: [f64; 2],
    /// From so many ends and bends on that have but one partner these tell the depth of all.
    pub only_min: usize,
    /// By what factor the depth of others may be less or more than theirs.
    pub depth_factor: f64,
    /// By what factor the thickness seen may differ from the part's; of dark parts the recogniser allows more.
    pub thickness_factor_max: f64,
    /// Most stereo nodes.
    pub nodes_max: usize,
}

impl Default for GateParams {
    fn default() -> Self {
        Self {
            mode: Mode::Epipolar,
            gap_px_max: 2.0,
            junction_gap_px_max: 5.0,
            open_gap_px_max: 40.0,
            leg_cos_min: std::f64::consts::FRAC_1_SQRT_2,
            depth_mm: [100.0, 2000.0],
            only_min: 6,
            depth_factor: 1.3,
            thickness_factor_max: 1.8,
            nodes_max: 4096,
        }
    }
}

impl GateParams {
    /// Distance from the epipolar line at most for two nodes that look like this together.
    fn gap_max(&self, role: NodeRole) -> f64 {
        match (self.mode, role) {
            (Mode::None, _) => self.open_gap_px_max,
            (Mode::Epipolar, NodeRole::Junction) => self.junction_gap_px_max,
            (Mode::Epipolar, _) => self.gap_px_max,
        }
    }

    /// Whether a pair is one that the closed gate would let through by its gap.
    pub fn is_near(&self, node: &StereoNode) -> bool {
        let most = if node.role == NodeRole::Junction { self.junction_gap_px_max } else { self.gap_px_max };
        node.gap_px <= most
    }
}

/// Workspace that lists the stereo nodes of a pair.
///
/// ```
/// use pickcell::matching::drawn::DrawnScene;
/// use pickcell::matching::gate::{Gate, GateParams, Mode};
///
/// let scene = DrawnScene::new(2, 8, 1); // eight rods: sixteen nodes in each picture
/// let [left, right] = &scene.nodes;
/// let pairs = |mode| {
///     let mut gate = Gate::new(GateParams { mode, ..GateParams::default() });
///     gate.run(&scene.rig, left, right, [0.0, 1e9]); // of any thickness
///     gate.nodes().to_vec()
/// };
/// let (closed, open) = (pairs(Mode::Epipolar), pairs(Mode::None));
/// assert!(closed.len() < open.len() && open.len() <= 16 * 16);
/// // Every end is among them.
/// for (pose, end) in scene.left_from_part.iter().flat_map(|pose| scene.model.anchors.iter().map(move |a| (pose, a))) {
///     let at_mm = pose * end.position_mm;
///     assert!(closed.iter().any(|node| (node.point_mm - at_mm).norm() < 8.0));
/// }
/// ```
#[derive(Clone, Debug)]
pub struct Gate {
    params: GateParams,
    nodes: Vec<StereoNode>,
    level: Level,
    /// Filled up with what is not a number to a multiple of [`CHUNK`].
    right_rays: [Vec<f32>; 2],
    /// One bit a right node: whether it is near the line.
    near: Vec<u64>,
    /// How many partners every node has, left and right.
    partners: [Vec<u32>; 2],
    /// Depths of pairs that have no other.
    depths_mm: Vec<f64>,
    truncated: bool,
}

impl Gate {
    /// Reserves all memory.
    pub fn new(params: GateParams) -> Self {
        let row = || Vec::with_capacity(ROW);
        let near = Vec::with_capacity(ROW / CHUNK);
        Self {
            params,
            nodes: Vec::with_capacity(params.nodes_max),
            level: Level::detect(),
            right_rays: [row(), row()],
            near,
            partners: [0, 1].map(|_| Vec::with_capacity(ROW)),
            depths_mm: Vec::with_capacity(ROW),
            truncated: false,
        }
    }

    /// The stereo nodes of the last [`Gate::run`].
    pub fn nodes(&self) -> &[StereoNode] {
        &self.nodes
    }

    /// Whether there were more than `nodes_max`, so that some were left out.
    pub fn is_truncated(&self) -> bool {
        self.truncated
    }

    /// Lists the stereo nodes for parts between `thickness_mm[0]` and `thickness_mm[1]` thick.
    pub fn run(&mut self, rig: &Rig, left: &[ImageNode], right: &[ImageNode], thickness_mm: [f64; 2]) {
        self.nodes.clear();
        self.truncated = false;
        let geometry = rig.geometry();
        let focal_px = (rig.right.fx + rig.right.fy) / 2.0;
        let across = rig.right_from_left_across();
        let Self { params, nodes, level, right_rays, near, truncated, .. } = self;
        let words = right.len().div_ceil(CHUNK);
        for (axis, list) in right_rays.iter_mut().enumerate() {
            list.clear();
            list.extend(right.iter().map(|r| r.ray[axis] as f32));
            list.resize(words * CHUNK, f32::NAN);
        }
        near.resize(words, 0);
        let [xs, ys] = [&right_rays[0][..], &right_rays[1][..]];
        let widest = params.gap_max(NodeRole::Junction).max(params.gap_max(NodeRole::End));
        // a little wider for single precision: what each pair is allowed is looked at below
        let widest = (widest * (1.0 + 1e-6)) as f32;
        for (i, l) in left.iter().enumerate() {
            let line = geometry.essential * Vector3::new(l.ray.x, l.ray.y, 1.0);
            let scaled = (line * (focal_px / line.x.hypot(line.y).max(1e-12))).map(|v| v as f32);
            rows::near_line(*level, [xs, ys], scaled.into(), widest, near);
            for_bits(near, |j| {
                let r = &right[j];
                let gap_px = (scaled.x * xs[j] + scaled.y * ys[j] + scaled.z).abs() as f64;
                if common_role(l.role, r.role).is_none_or(|role| gap_px > params.gap_max(role))
                    || params.mode == Mode::Epipolar && !shows_same_wire(params, &across, l, r)
                {
                    return;
                }
                let Some(node) = stereo_node(params, &geometry, [left, right], i, j, gap_px) else {
                    return;
                };
                let any_thickness = params.mode == Mode::None || node.role == NodeRole::Junction;
                if any_thickness || thickness_fits(params, l, r, node.point_mm.z, rig, thickness_mm) {
                    *truncated |= nodes.len() == params.nodes_max;
                    if !*truncated {
                        nodes.push(node);
                    }
                }
            });
            if *truncated {
                break;
            }
        }
        if self.params.mode == Mode::Epipolar {
            self.leave_out_far(left.len(), right.len());
        }
    }

    /// Leaves out what is far from the depth of those that can be paired but one way.
    fn leave_out_far(&mut self, left: usize, right: usize) {
        let Self { params, nodes, partners, depths_mm, .. } = self;
        for (partners, count) in partners.iter_mut().zip([left, right]) {
            partners.clear();
            partners.resize(count, 0);
        }
        for node in &*nodes {
            partners[0][node.left as usize] += 1;
            partners[1][node.right as usize] += 1;
        }
        let is_only = |n: &&StereoNode| {
            n.role != NodeRole::Junction
                && partners[0][n.left as usize] == 1
                && partners[1][n.right as usize] == 1
        };
        depths_mm.clear();
        depths_mm.extend(nodes.iter().filter(is_only).map(|n| n.point_mm.z).take(ROW));
        if depths_mm.len() < params.only_min {
            return;
        }
        depths_mm.sort_unstable_by(f64::total_cmp);
        // Some of them only seem to be pairs.
        let few = depths_mm.len() / 4;
        let [nearest, farthest] = [depths_mm[few], depths_mm[depths_mm.len() - 1 - few]];
        let factor = params.depth_factor;
        nodes.retain(|n| (nearest / factor..=farthest * factor).contains(&n.point_mm.z));
    }
}

/// Whether wire leaves two nodes in the same direction: a bend in two of them, any other in one at least. `across` as in
/// [`is_same_direction`].
fn shows_same_wire(params: &GateParams, across: &Matrix2<f64>, l: &ImageNode, r: &ImageNode) -> bool {
    let [left, right] = [l, r].map(ImageNode::legs);
    // Of a node with more wire than it has room for not all of it is known.
    let is_known = |legs: usize| (1..LEGS_MAX).contains(&legs);
    if !is_known(left.len()) || !is_known(right.len()) {
        return true;
    }
    let is_shown = |leg| right.iter().any(|r| is_same_direction(across, leg, r, params.leg_cos_min));
    let wanted = if common_role(l.role, r.role) == Some(NodeRole::Bend) { 2 } else { 1 };
    left.iter().filter(|leg| is_shown(leg)).count() >= wanted
}

fn thickness_fits(
    params: &GateParams,
    l: &ImageNode,
    r: &ImageNode,
    z_mm: f64,
    rig: &Rig,
    thickness_mm: [f64; 2],
) -> bool {
    let seen_mm = (l.half_thickness_px / rig.left.fx + r.half_thickness_px / rig.right.fx) * z_mm;
    let factor = params.thickness_factor_max;
    seen_mm == 0.0 || (thickness_mm[0] / factor..=thickness_mm[1] * factor).contains(&seen_mm)
}

/// Image nodes of a picture that memory is reserved for; more are taken at the price of an allocation.
pub(super) const ROW: usize = 4096;

/// Two image nodes as one point; `None` where no point in space looks like both.
pub(super) fn stereo_node(
    params: &GateParams,
    geometry: &StereoGeometry,
    [left, right]: [&[ImageNode]; 2],
    i: usize,
    j: usize,
    gap_px: f64,
) -> Option<StereoNode> {
    let (l, r) = (&left[i], &right[j]);
    let role = common_role(l.role, r.role)?;
    let seen = geometry.triangulate(l.ray, r.ray)?;
    let z = seen.point_left_mm.z;
    if !(params.depth_mm[0]..=params.depth_mm[1]).contains(&z) {
        return None;
    }
    // A correction of a few pixels is the same before and after the lens to within its local stretch.
    let moved = |node: &ImageNode, norm: Vector2<f64>, focal_px: Vector2<f64>| {
        node.position_px + (norm - node.ray).component_mul(&focal_px)
    };
    let seen_px = [
        moved(l, seen.left_norm, geometry.focal_left_px),
        moved(r, seen.right_norm, geometry.focal_right_px),
    ];
    let (left, right) = (i as u16, j as u16);
    Some(StereoNode { left, right, point_mm: seen.point_left_mm, seen_px, gap_px, role })
}

/// The gap of one pair, in pixels.
pub(super) fn gap_px(geometry: &StereoGeometry, left: &ImageNode, right: &ImageNode) -> f64 {
    let line = geometry.essential * left.ray.push(1.0);
    let focal_px = (geometry.focal_right_px.x + geometry.focal_right_px.y) / 2.0;
    focal_px * line.dot(&right.ray.push(1.0)).abs() / line.x.hypot(line.y).max(1e-12)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matching::drawn::DrawnScene;
    use crate::matching::nodes::Leg;
    use crate::rig::CameraModel;

    /// Whether a pair shows an end or bend of a part that was drawn.
    fn is_true(scene: &DrawnScene, node: &StereoNode) -> bool {
        let anchors = || scene.model.anchors.iter().map(|a| a.position_mm);
        let mut points = scene.left_from_part.iter().flat_map(|pose| anchors().map(move |p| pose * p));
        points.any(|p| (p - node.point_mm).norm() < 10.0)
    }

    #[test]
    fn nodes_that_wire_leaves_in_other_directions_are_no_pair() {
        let rig = DrawnScene::new(2, 1, 1).rig;
        let is_pair = |left_deg: &[f64], right_deg: &[f64], role| {
            let node = |camera: &CameraModel, place_px: Vector2<f64>, legs_deg: &[f64]| {
                let mut node = ImageNode::bare(role, place_px, camera);
                for angle_deg in legs_deg {
                    let (sin, cos) = angle_deg.to_radians().sin_cos();
                    node.push_leg(Leg { direction_px: Vector2::new(cos, sin), ..Leg::default() });
                }
                node
            };
            let left_px = Vector2::new(400.0, 240.0);
            let point_mm = rig.left.undistort(left_px).push(1.0) * 480.0;
            let right_px = rig.project_right(&point_mm.into()).expect("before the right camera");
            let (left, right) = (node(&rig.left, left_px, left_deg), node(&rig.right, right_px, right_deg));
            let mut gate = Gate::new(GateParams::default());
            gate.run(&rig, &[left], &[right], [0.0, 1e9]);
            gate.nodes().len() == 1
        };
        let (end, junction, bend) = (NodeRole::End, NodeRole::Junction, NodeRole::Bend);
        assert!(is_pair(&[20.0], &[50.0], end) && !is_pair(&[20.0], &[200.0], end));
        // One wire of a junction may be the same, both of a bend must be.
        assert!(is_pair(&[0.0, 90.0, 180.0], &[100.0, 220.0, 310.0], junction));
        assert!(!is_pair(&[0.0, 90.0], &[160.0, 250.0], junction));
        assert!(is_pair(&[0.0, 90.0], &[10.0, 80.0], bend) && !is_pair(&[0.0, 90.0], &[10.0, 180.0], bend));
        // Nothing is known of a node without wire, and not all of one with more than there is room for.
        assert!(is_pair(&[], &[0.0], end) && is_pair(&[0.0; LEGS_MAX], &[180.0], junction));
    }

    #[test]
    fn pairs_far_from_the_depth_of_the_bin_are_left_out() {
        for seed in 0..8 {
            let scene = DrawnScene::new(2, 15, seed);
            let [left, right] = &scene.nodes;
            let [all, near] = [usize::MAX, GateParams::default().only_min].map(|only_min| {
                let mut gate = Gate::new(GateParams { only_min, ..GateParams::default() });
                gate.run(&scene.rig, left, right, [0.0, 9.0]);
                gate.nodes().to_vec()
            });
            let [all_true, near_true] =
                [&all, &near].map(|nodes| nodes.iter().filter(|n| is_true(&scene, n)).count());
            assert_eq!(all_true, near_true, "seed {seed}");
            assert!(near.len() < all.len(), "{} of {}", near.len(), all.len());
            assert!(near.iter().all(|n| (300.0..800.0).contains(&n.point_mm.z)));
        }
    }
}
