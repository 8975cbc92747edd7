//! Which pairs of image nodes may show the same point: the candidates that all searches take.
//!
//! The epipolar test comes first, in single precision and for all right nodes of a left one in a row; only what it
//! leaves is triangulated. With [`Mode::None`] a pair is left out only where no match under the threshold could
//! hold it: where it shows no point in space, or its gap alone costs more.

use nalgebra::{Vector2, Vector3};

use super::nodes::{ImageNode, NodeRole};
use super::problem::{StereoNode, common_role};
use super::rows::{self, CHUNK, for_bits};
use crate::rig::{Rig, StereoGeometry};
use crate::vision::level::Level;

/// Which nodes of the right picture may go with a node of the left one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Mode {
    /// Those near its epipolar line, at a depth and of a thickness that a part can have.
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
    /// Distance from the epipolar line at most with [`Mode::None`], in pixels. The default costs two nodes alone a
    /// fitness of 1.
    pub open_gap_px_max: f64,
    /// Depth of a part's points in the left camera's frame, in mm.
    pub depth_mm: [f64; 2],
    /// By what factor the thickness seen may differ from the part's.
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
            depth_mm: [100.0, 2000.0],
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
/// use nalgebra::{Isometry3, Vector3};
/// use pickcell::matching::gate::{Gate, GateParams};
/// use pickcell::rig::{CameraModel, Rig};
///
/// let camera = CameraModel::pinhole(640, 480, 600.0, 320.0, 240.0);
/// let right_from_left = Isometry3::translation(-60.0, 0.0, 0.0);
/// let rig = Rig { left: camera, right: camera, right_from_left };
/// let mut gate = Gate::new(GateParams::default());
/// gate.run(&rig, &[], &[], [2.0, 4.0]);
/// assert!(gate.nodes().is_empty());
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
            truncated: false,
        }
    }

    /// The stereo nodes of the last [`Gate::run`].
    pub fn nodes(&self) -> &[StereoNode] {
        &self.nodes
    }

    /// Whether there were more than `nodes_max`.
    pub fn is_truncated(&self) -> bool {
        self.truncated
    }

    /// Lists the stereo nodes for parts between `thickness_mm[0]` and `thickness_mm[1]` thick.
    pub fn run(&mut self, rig: &Rig, left: &[ImageNode], right: &[ImageNode], thickness_mm: [f64; 2]) {
        self.nodes.clear();
        self.truncated = false;
        let geometry = rig.geometry();
        let focal_px = (rig.right.fx + rig.right.fy) / 2.0;
        let Self { params, nodes, level, right_rays, near, truncated } = self;
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
                if common_role(l.role, r.role).is_none_or(|role| gap_px > params.gap_max(role)) {
                    return;
                }
                let Some((node, z_mm)) = stereo_node(params, &geometry, [left, right], i, j, gap_px) else {
                    return;
                };
                let any_thickness = params.mode == Mode::None || node.role == NodeRole::Junction;
                if any_thickness || thickness_fits(params, l, r, z_mm, rig, thickness_mm) {
                    *truncated |= nodes.len() == params.nodes_max;
                    if !*truncated {
                        nodes.push(node);
                    }
                }
            });
            if *truncated {
                return;
            }
        }
    }
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
pub(super) const ROW: usize = 1024;

/// Two image nodes as one point; `None` where no point in space looks like both.
pub(super) fn stereo_node(
    params: &GateParams,
    geometry: &StereoGeometry,
    [left, right]: [&[ImageNode]; 2],
    i: usize,
    j: usize,
    gap_px: f64,
) -> Option<(StereoNode, f64)> {
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
    Some((StereoNode { left, right, point_mm: seen.point_left_mm, seen_px, gap_px, role }, z))
}

/// The gap of one pair, in pixels.
pub(super) fn gap_px(geometry: &StereoGeometry, left: &ImageNode, right: &ImageNode) -> f64 {
    let line = geometry.essential * left.ray.push(1.0);
    let focal_px = (geometry.focal_right_px.x + geometry.focal_right_px.y) / 2.0;
    focal_px * line.dot(&right.ray.push(1.0)).abs() / line.x.hypot(line.y).max(1e-12)
}
