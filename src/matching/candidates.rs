//! Stereo nodes made ready for the searches: in single precision, with everything that fitness reads of a node
//! side by side, worked out once a pair.
//!
//! ```
//! use pickcell::matching::candidates::{Candidates, curve};
//! use pickcell::matching::drawn::DrawnScene;
//!
//! let scene = DrawnScene::new(3, 4, 1);
//! let (stereo, [left, right]) = (scene.gate.nodes(), &scene.nodes);
//! let mut candidates = Candidates::new(stereo.len());
//! candidates.fill(&scene.rig.geometry(), stereo, left, right, true);
//!
//! // All stereo nodes, in the order of the curve; each says where it was seen, and which stereo node it is.
//! let all = candidates.all();
//! assert_eq!(all.len(), stereo.len());
//! assert!(all.is_sorted_by_key(|c| curve(c.node_px[0])));
//! for candidate in all {
//!     let of = &stereo[usize::from(candidate.stereo)];
//!     assert_eq!((candidate.left, candidate.right), (of.left, of.right));
//!     assert_eq!(candidate.node_px[0], left[usize::from(of.left)].position_px.cast::<f32>().data.0[0]);
//! }
//! ```

use nalgebra::Vector2;

use super::nodes::{ImageNode, NodeRole};
use super::problem::StereoNode;
use super::rows::Points;
use crate::rig::StereoGeometry;

/// A stereo node as the searches and the fitness see it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// The point in the left camera's frame.
    pub point_mm: [f32; 3],
    /// Its depth in the right camera's frame.
    pub right_z_mm: f32,
    /// Its nodes in the left and the right picture.
    pub node_px: [[f32; 2]; 2],
    /// Where the point is seen in the left and the right picture.
    pub seen_px: [[f32; 2]; 2],
    /// Distance of the right node from the left node's epipolar line.
    pub gap_px: f32,
    /// Index of the left picture's node.
    pub left: u16,
    /// Index of the right picture's node.
    pub right: u16,
    /// Index of the stereo node.
    pub stereo: u16,
    /// What it looks like.
    pub role: NodeRole,
    /// Whether a point in space explains both nodes; if not, the point above means nothing.
    pub explained: bool,
}

impl Candidate {
    /// From a stereo node.
    pub fn new(
        geometry: &StereoGeometry,
        stereo: usize,
        node: &StereoNode,
        left: &[ImageNode],
        right: &[ImageNode],
    ) -> Self {
        let single = |px: Vector2<f64>| [px.x as f32, px.y as f32];
        let p = &node.point_mm;
        let right_z = geometry.rotation.row(2).transpose().dot(&p.coords) + geometry.translation_mm.z;
        Self {
            point_mm: [p.x as f32, p.y as f32, p.z as f32],
            right_z_mm: right_z as f32,
            node_px: [
                single(left[node.left as usize].position_px),
                single(right[node.right as usize].position_px),
            ],
            seen_px: node.seen_px.map(single),
            gap_px: node.gap_px as f32,
            left: node.left,
            right: node.right,
            stereo: stereo as u16,
            role: node.role,
            explained: true,
        }
    }

    /// Two image nodes that no point explains.
    pub(super) fn unexplained(left: usize, right: usize) -> Self {
        Self {
            point_mm: [0.0; 3],
            right_z_mm: 1.0,
            node_px: [[0.0; 2]; 2],
            seen_px: [[0.0; 2]; 2],
            gap_px: 0.0,
            left: left as u16,
            right: right as u16,
            stereo: u16::MAX,
            role: NodeRole::Junction,
            explained: false,
        }
    }
}

/// The candidates of a pair of pictures.
#[derive(Clone, Debug)]
pub struct Candidates {
    all: Vec<Candidate>,
    points: Points,
    /// How far along the curve, and which stereo node.
    order: Vec<(u32, u16)>,
}

impl Candidates {
    /// Memory for this many.
    pub fn new(nodes_max: usize) -> Self {
        Self {
            all: Vec::with_capacity(nodes_max),
            points: Points::with_capacity(nodes_max),
            order: Vec::with_capacity(nodes_max),
        }
    }

    /// Takes the stereo nodes of a pair. With `along_curve` they are put in the order in which a Hilbert curve
    /// through the left picture meets them: the order that "nearby", "largest" and "smallest" mean to
    /// [`harmony`](super::harmony).
    pub fn fill(
        &mut self,
        geometry: &StereoGeometry,
        nodes: &[StereoNode],
        left: &[ImageNode],
        right: &[ImageNode],
        along_curve: bool,
    ) {
        let Self { all, points, order } = self;
        all.clear();
        let candidate = |i: usize| Candidate::new(geometry, i, &nodes[i], left, right);
        if along_curve {
            order.clear();
            let mut last = (None, 0);
            for (i, node) in nodes.iter().enumerate() {
                // the gate gives all stereo nodes of a left node one after the other
                if last.0 != Some(node.left) {
                    let px = left[node.left as usize].position_px;
                    last = (Some(node.left), curve([px.x as f32, px.y as f32]));
                }
                order.push((last.1, i as u16));
            }
            order.sort_unstable();
            all.extend(order.iter().map(|&(_, i)| candidate(i as usize)));
        } else {
            all.extend((0..nodes.len()).map(candidate));
        }
        points.fill(all.iter().map(|c| (c.point_mm, [c.left, c.right])));
    }

    /// All of them.
    pub fn all(&self) -> &[Candidate] {
        &self.all
    }

    /// Their points.
    pub fn points(&self) -> &Points {
        &self.points
    }
}

/// How far along a Hilbert curve over as many pixels as a picture may have a pixel lies.
pub fn curve(px: [f32; 2]) -> u32 {
    const LAST: u32 = u16::MAX as u32;
    let [mut x, mut y] = px.map(|v| v.clamp(0.0, LAST as f32) as u32);
    let (mut along, mut side) = (0, LAST.div_ceil(2));
    while side > 0 {
        let (right, up) = ((x & side != 0) as u32, (y & side != 0) as u32);
        along += side * side * ((3 * right) ^ up);
        if up == 0 {
            if right == 1 {
                (x, y) = (LAST - x, LAST - y);
            }
            (x, y) = (y, x);
        }
        side /= 2;
    }
    along
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_curve_meets_every_pixel_once_and_moves_by_one() {
        let mut met: Vec<(u32, i32, i32)> =
            (0..32).flat_map(|y| (0..32).map(move |x| (curve([x as f32, y as f32]), x, y))).collect();
        met.sort();
        for pair in met.windows(2) {
            assert_eq!(pair[1].0, pair[0].0 + 1);
            assert_eq!((pair[1].1 - pair[0].1).abs() + (pair[1].2 - pair[0].2).abs(), 1);
        }
    }
}
