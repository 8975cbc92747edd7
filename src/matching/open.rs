//! The open gate (`gate = "none"`): any node of the left picture with any node of the right one.
//!
//! A table of left by right nodes is filled on demand: a pair is triangulated the first time it is asked for. It has
//! room for 2^16 pairs; where there are more, a pair may push another one out, which is then worked out again.

use super::candidates::{Candidate, curve};
use super::gate::{GateParams, ROW, gap_px, stereo_node};
use super::nodes::ImageNode;
use super::problem::StereoNode;
use crate::rig::StereoGeometry;

const SLOTS: usize = 1 << 16;

/// Workspace of the open gate.
#[derive(Clone, Debug)]
pub struct OpenPairs {
    params: GateParams,
    slots: Vec<(u64, Candidate)>,
    /// Tells this pair of pictures from those before.
    pictures: u32,
    /// Image nodes of each picture along a Hilbert curve.
    order: [Vec<u16>; 2],
    stereo: Vec<StereoNode>,
}

/// Pictures and rig that an open gate works on.
#[derive(Clone, Copy)]
pub struct Pictures<'a> {
    /// The rig's geometry.
    pub geometry: &'a StereoGeometry,
    /// Image nodes, left and right.
    pub nodes: [&'a [ImageNode]; 2],
}

impl OpenPairs {
    /// Reserves all memory.
    pub fn new(params: GateParams) -> Self {
        Self {
            params,
            slots: vec![(0, Candidate::unexplained(0, 0)); SLOTS],
            pictures: 0,
            order: [Vec::with_capacity(ROW), Vec::with_capacity(ROW)],
            stereo: Vec::with_capacity(params.nodes_max),
        }
    }

    /// Begins with a new pair of pictures.
    pub fn begin(&mut self, nodes: [&[ImageNode]; 2]) {
        self.pictures = self.pictures.wrapping_add(1);
        if self.pictures == 0 {
            // every 2^32 pairs of pictures: nothing may be taken for one of them
            self.slots.fill((0, Candidate::unexplained(0, 0)));
            self.pictures = 1;
        }
        self.stereo.clear();
        for (order, nodes) in self.order.iter_mut().zip(nodes) {
            order.clear();
            order.extend(0..nodes.len().min(u16::MAX as usize) as u16);
            order.sort_unstable_by_key(|&n| {
                let px = nodes[n as usize].position_px;
                (curve([px.x as f32, px.y as f32]), n)
            });
        }
    }

    /// Number of left and right nodes.
    #[inline]
    pub fn len(&self) -> [usize; 2] {
        [self.order[0].len(), self.order[1].len()]
    }

    /// Whether a picture has no node.
    pub fn is_empty(&self) -> bool {
        self.len().contains(&0)
    }

    /// The pair of the nodes of these ranks along the curves.
    #[inline]
    pub fn candidate(&mut self, pictures: &Pictures, ranks: [u16; 2]) -> Candidate {
        let [l, r] = [self.order[0][ranks[0] as usize], self.order[1][ranks[1] as usize]];
        let key = (self.pictures as u64) << 32 | (l as u64) << 16 | r as u64;
        let slot = (l as usize * self.order[1].len() + r as usize) % SLOTS;
        let (kept, candidate) = &mut self.slots[slot];
        if *kept != key {
            (*kept, *candidate) = (key, work_out(&self.params, pictures, l as usize, r as usize));
        }
        *candidate
    }

    /// The stereo node of a pair that is part of a match; `None` where there is no room for more.
    pub fn stereo_node(&mut self, pictures: &Pictures, candidate: &Candidate) -> Option<u16> {
        let same = |n: &StereoNode| n.left == candidate.left && n.right == candidate.right;
        if let Some(known) = self.stereo.iter().position(same) {
            return Some(known as u16);
        }
        if self.stereo.len() == self.params.nodes_max {
            return None;
        }
        let (i, j) = (candidate.left as usize, candidate.right as usize);
        let gap = candidate.gap_px as f64;
        let node = stereo_node(&self.params, pictures.geometry, pictures.nodes, i, j, gap)?;
        self.stereo.push(node);
        Some(self.stereo.len() as u16 - 1)
    }

    /// The stereo nodes of the matches so far.
    pub fn nodes(&self) -> &[StereoNode] {
        &self.stereo
    }
}

#[cold]
fn work_out(params: &GateParams, pictures: &Pictures, l: usize, r: usize) -> Candidate {
    let [left, right] = pictures.nodes;
    let gap = gap_px(pictures.geometry, &left[l], &right[r]);
    match stereo_node(params, pictures.geometry, [left, right], l, r, gap) {
        Some(node) => Candidate::new(pictures.geometry, 0, &node, left, right),
        None => Candidate::unexplained(l, r),
    }
}
