//! Which pairs of image nodes may show the same point: the candidates that all searches take.
//!
//! The epipolar test comes first, in single precision and for all right nodes of a left one in a row; only what it
//! leaves is triangulated. With [`Mode::None`] a pair is left out only where no match under the threshold could
//! hold it: where it shows no point in space, or its gap alone costs more.

use nalgebra::{Vector2, Vector3};

use super::nodes::{ImageNode, NodeRole};
use super::problem::{StereoNode, common_role};
use crate::rig::{Rig, StereoGeometry};

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
    right_rays: [Vec<f32>; 2],
    gaps_px: Vec<f32>,
    truncated: bool,
}

impl Gate {
    /// Reserves all memory.
    pub fn new(params: GateParams) -> Self {
        let row = || Vec::with_capacity(ROW);
        Self {
            params,
            nodes: Vec::with_capacity(params.nodes_max),
            right_rays: [row(), row()],
            gaps_px: row(),
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
        for axis in 0..2 {
            self.right_rays[axis].clear();
            self.right_rays[axis].extend(right.iter().map(|r| r.ray[axis] as f32));
        }
        let widest = match self.params.mode {
            Mode::Epipolar => self.params.junction_gap_px_max.max(self.params.gap_px_max),
            Mode::None => self.params.open_gap_px_max,
        };
        for (i, l) in left.iter().enumerate() {
            let line = geometry.essential * Vector3::new(l.ray.x, l.ray.y, 1.0);
            let scaled = (line * (focal_px / line.x.hypot(line.y).max(1e-12))).map(|v| v as f32);
            let [xs, ys] = &self.right_rays;
            self.gaps_px.clear();
            self.gaps_px
                .extend(xs.iter().zip(ys).map(|(x, y)| (scaled.x * x + scaled.y * y + scaled.z).abs()));
            for j in 0..right.len() {
                let gap_px = self.gaps_px[j] as f64;
                // the comparison also refuses what is not a number
                if gap_px.is_nan() || gap_px > widest {
                    continue;
                }
                let Some((node, z_mm)) = stereo_node(&self.params, &geometry, [left, right], i, j, gap_px)
                else {
                    continue;
                };
                let thick = self.params.mode == Mode::None
                    || node.role == NodeRole::Junction
                    || self.thickness_fits(l, &right[j], z_mm, rig, thickness_mm);
                if !thick || (self.params.mode == Mode::Epipolar && !self.params.is_near(&node)) {
                    continue;
                }
                if self.nodes.len() == self.params.nodes_max {
                    self.truncated = true;
                    return;
                }
                self.nodes.push(node);
            }
        }
    }

    fn thickness_fits(
        &self,
        l: &ImageNode,
        r: &ImageNode,
        z_mm: f64,
        rig: &Rig,
        thickness_mm: [f64; 2],
    ) -> bool {
        let seen_mm = (l.half_thickness_px / rig.left.fx + r.half_thickness_px / rig.right.fx) * z_mm;
        let factor = self.params.thickness_factor_max;
        seen_mm == 0.0 || (thickness_mm[0] / factor..=thickness_mm[1] * factor).contains(&seen_mm)
    }
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
