//! Which skeleton pixels are ends and which belong to junctions.

use super::{NodeKind, Params, Refusal};
use crate::vision::bits::BitImage;

/// Directions of the eight neighbours, clockwise from above; bit `i` of a neighbour code is direction `i`.
pub const DIRECTIONS: [(i32, i32); 8] =
    [(0, -1), (1, -1), (1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1)];

/// A node as its pixels tell it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RawNode {
    /// End or junction.
    pub kind: NodeKind,
    /// Centroid of its pixels.
    pub centroid_px: [f32; 2],
    /// Where its pixels stand in [`Pixels::members`].
    pub members: [u32; 2],
}

/// Nodes by their pixels.
#[derive(Clone, Debug)]
pub struct Pixels {
    nodes_max: u32,
    /// All nodes.
    pub nodes: Vec<RawNode>,
    /// Pixels of all nodes, node after node.
    pub members: Vec<[u16; 2]>,
    /// Pixels without any neighbour.
    pub alone: Vec<[u16; 2]>,
    /// The pixels that belong to a node.
    pub is_node: BitImage,
    /// Pixels with three or more branches.
    branch: BitImage,
    /// Node of a pixel; only valid where `is_node`.
    label: Vec<u16>,
}

/// The neighbours of a pixel that its lines go on to: bit `i` is direction `i`. A corner neighbour counts only where
/// no side neighbour joins it already.
#[inline]
pub fn branches(picture: &BitImage, x: i32, y: i32) -> u8 {
    let mut code = 0u8;
    for (i, (dx, dy)) in DIRECTIONS.into_iter().enumerate() {
        code |= (picture.get(x + dx, y + dy) as u8) << i;
    }
    let sides = code & 0b0101_0101;
    let joined = sides.rotate_left(1) | sides.rotate_right(1);
    sides | (code & 0b1010_1010 & !joined)
}

impl Pixels {
    pub(super) fn new(params: &Params, width: usize, height: usize) -> Self {
        let nodes_max = params.nodes_max.min(u16::MAX as u32);
        Self {
            nodes_max,
            nodes: Vec::with_capacity(nodes_max as usize),
            members: Vec::with_capacity(params.points_max as usize),
            alone: Vec::with_capacity(nodes_max as usize),
            is_node: BitImage::new(width, height),
            branch: BitImage::new(width, height),
            label: vec![0; width * height],
        }
    }

    /// The node that a pixel belongs to.
    #[inline]
    pub fn node_at(&self, x: u16, y: u16) -> Option<u32> {
        self.is_node
            .get(x as i32, y as i32)
            .then(|| self.label[y as usize * self.is_node.width() + x as usize] as u32)
    }

    /// The pixels of a node.
    pub fn members_of(&self, node: &RawNode) -> &[[u16; 2]] {
        &self.members[node.members[0] as usize..node.members[1] as usize]
    }

    pub(super) fn run(&mut self, skeleton: &BitImage) -> Result<(), Refusal> {
        self.nodes.clear();
        self.members.clear();
        self.alone.clear();
        self.is_node.clear();
        self.branch.clear();
        for s in 0..skeleton.strips() {
            for (y, &word) in skeleton.strip(s).iter().enumerate() {
                let mut word = word;
                while word != 0 {
                    let x = s * 64 + word.trailing_zeros() as usize;
                    word &= word - 1;
                    match branches(skeleton, x as i32, y as i32).count_ones() {
                        1 => {
                            self.push(NodeKind::End)?;
                            self.claim(x, y)?;
                            self.close();
                        }
                        // More of them than there can be nodes: dust, and not worth a look.
                        0 if self.alone.len() < self.alone.capacity() => {
                            self.alone.push([x as u16, y as u16])
                        }
                        3.. => self.branch.set(x, y, true),
                        _ => {}
                    }
                }
            }
        }
        for s in 0..skeleton.strips() {
            for y in 0..skeleton.height() {
                while self.branch.strip(s)[y] != 0 {
                    let x = s * 64 + self.branch.strip(s)[y].trailing_zeros() as usize;
                    self.push(NodeKind::Junction)?;
                    self.flood(x, y)?;
                    self.close();
                }
            }
        }
        Ok(())
    }

    /// All branch pixels that touch, directly or through others, become members of the newest node.
    fn flood(&mut self, x: usize, y: usize) -> Result<(), Refusal> {
        let mut next = self.members.len();
        self.branch.set(x, y, false);
        self.claim(x, y)?;
        while next < self.members.len() {
            let [x, y] = self.members[next];
            next += 1;
            for (dx, dy) in DIRECTIONS {
                let (x, y) = (x as i32 + dx, y as i32 + dy);
                if self.branch.get(x, y) {
                    self.branch.set(x as usize, y as usize, false);
                    self.claim(x as usize, y as usize)?;
                }
            }
        }
        Ok(())
    }

    fn push(&mut self, kind: NodeKind) -> Result<(), Refusal> {
        if self.nodes.len() >= self.nodes_max as usize {
            return Err(Refusal::TooManyNodes { nodes_max: self.nodes_max });
        }
        let begin = self.members.len() as u32;
        self.nodes.push(RawNode { kind, centroid_px: [0.0; 2], members: [begin, begin] });
        Ok(())
    }

    fn claim(&mut self, x: usize, y: usize) -> Result<(), Refusal> {
        if self.members.len() == self.members.capacity() {
            return Err(Refusal::TooManyPoints { points_max: self.members.capacity() as u32 });
        }
        self.members.push([x as u16, y as u16]);
        self.is_node.set(x, y, true);
        self.label[y * self.is_node.width() + x] = (self.nodes.len() - 1) as u16;
        Ok(())
    }

    fn close(&mut self) {
        let end = self.members.len() as u32;
        if let Some(node) = self.nodes.last_mut() {
            node.members[1] = end;
            let pixels = &self.members[node.members[0] as usize..];
            let (x, y) = pixels.iter().fold((0u64, 0u64), |(x, y), p| (x + p[0] as u64, y + p[1] as u64));
            let n = pixels.len() as f32;
            node.centroid_px = [x as f32 / n, y as f32 / n];
        }
    }
}
