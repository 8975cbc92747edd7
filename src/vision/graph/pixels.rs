//! Which skeleton pixels are ends and which belong to junctions.

use super::classify::{Special, classify};
use super::{NodeKind, Params, Refusal};
use crate::level::Level;
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
    /// The node of each member.
    pub node_of: Vec<u32>,
    /// Pixels without any neighbour, up to the limit of nodes.
    pub alone: Vec<[u16; 2]>,
    /// Pixels that are neither member nor alone.
    pub chain_pixels: usize,
    /// The pixels that belong to a node.
    is_node: BitImage,
    /// Pixels with three or more branches that belong to no node yet.
    unclaimed: BitImage,
    /// Index into `members` of a pixel; only valid where `is_node`.
    label: Vec<u32>,
    special: Vec<Special>,
}

/// For the nine pixels of a 3 x 3 window, row by row, lowest bit first: [`branches`] of the one in the middle.
pub(super) static BRANCHES: [u8; 512] = branches_of_windows();

const fn branches_of_windows() -> [u8; 512] {
    // Place in the window of each direction.
    const PLACE: [u32; 8] = [1, 2, 5, 8, 7, 6, 3, 0];
    let mut table = [0; 512];
    let mut window = 0;
    while window < 512 {
        let (mut code, mut i) = (0u8, 0);
        while i < 8 {
            code |= ((window >> PLACE[i] & 1) as u8) << i;
            i += 1;
        }
        table[window] = branches_of_code(code);
        window += 1;
    }
    table
}

/// A corner counts only where no side joins it already.
const fn branches_of_code(code: u8) -> u8 {
    let sides = code & 0b0101_0101;
    let joined = sides.rotate_left(1) | sides.rotate_right(1);
    sides | (code & 0b1010_1010 & !joined)
}

/// The neighbours of a pixel that its lines go on to: bit `i` is direction `i`. A corner neighbour counts only where
/// no side neighbour joins it already.
pub fn branches(picture: &BitImage, x: i32, y: i32) -> u8 {
    let mut code = 0u8;
    for (i, (dx, dy)) in DIRECTIONS.into_iter().enumerate() {
        code |= (picture.get(x + dx, y + dy) as u8) << i;
    }
    branches_of_code(code)
}

impl Pixels {
    pub(super) fn new(params: &Params, width: usize, height: usize) -> Self {
        let nodes_max = params.nodes_max;
        let words = BitImage::new(width, height).words().len();
        Self {
            nodes_max,
            nodes: Vec::with_capacity(nodes_max as usize),
            members: Vec::with_capacity(params.points_max as usize),
            node_of: Vec::with_capacity(params.points_max as usize),
            alone: Vec::with_capacity(nodes_max as usize),
            chain_pixels: 0,
            is_node: BitImage::new(width, height),
            unclaimed: BitImage::new(width, height),
            label: vec![0; width * height],
            special: Vec::with_capacity(words),
        }
    }

    /// The index of the member at a pixel.
    #[inline]
    pub fn member_at(&self, x: u16, y: u16) -> Option<u32> {
        self.is_node
            .get(x as i32, y as i32)
            .then(|| self.label[y as usize * self.is_node.width() + x as usize])
    }

    pub(super) fn run(&mut self, level: Level, skeleton: &BitImage) -> Result<(), Refusal> {
        for &[x, y] in &self.members {
            self.is_node.set(x as usize, y as usize, false);
        }
        self.nodes.clear();
        self.members.clear();
        self.node_of.clear();
        self.alone.clear();
        let count = classify(level, skeleton, &mut self.special);
        let special = std::mem::take(&mut self.special);
        let result = self.claim_all(&special);
        if result.is_err() {
            self.unclaimed.clear();
        }
        let alone: usize = special.iter().map(|s| s.alone.count_ones() as usize).sum();
        self.chain_pixels = count.saturating_sub(alone + self.members.len());
        self.special = special;
        result
    }

    fn claim_all(&mut self, special: &[Special]) -> Result<(), Refusal> {
        for word in special {
            for x in bits(word.ends, word.x) {
                self.push(NodeKind::End)?;
                self.claim(x, word.y)?;
                self.close();
            }
            for x in bits(word.alone, word.x).take(self.alone.capacity() - self.alone.len()) {
                self.alone.push([x, word.y]);
            }
            for x in bits(word.junctions, word.x) {
                self.unclaimed.set(x as usize, word.y as usize, true);
            }
        }
        for word in special {
            for x in bits(word.junctions, word.x) {
                if self.unclaimed.get(x as i32, word.y as i32) {
                    self.push(NodeKind::Junction)?;
                    self.flood(x, word.y)?;
                    self.close();
                }
            }
        }
        Ok(())
    }

    /// All branch pixels that touch, directly or through others, become members of the newest node.
    fn flood(&mut self, x: u16, y: u16) -> Result<(), Refusal> {
        let mut next = self.members.len();
        self.unclaimed.set(x as usize, y as usize, false);
        self.claim(x, y)?;
        while next < self.members.len() {
            let [x, y] = self.members[next];
            next += 1;
            for (dx, dy) in DIRECTIONS {
                let (x, y) = (x as i32 + dx, y as i32 + dy);
                if self.unclaimed.get(x, y) {
                    self.unclaimed.set(x as usize, y as usize, false);
                    self.claim(x as u16, y as u16)?;
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

    fn claim(&mut self, x: u16, y: u16) -> Result<(), Refusal> {
        if self.members.len() == self.members.capacity() {
            return Err(Refusal::TooManyPoints { points_max: self.members.capacity() as u32 });
        }
        self.is_node.set(x as usize, y as usize, true);
        self.label[y as usize * self.is_node.width() + x as usize] = self.members.len() as u32;
        self.members.push([x, y]);
        self.node_of.push((self.nodes.len() - 1) as u32);
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

/// The columns of the set bits of a word whose bit 0 is column `x`.
fn bits(mut word: u64, x: u16) -> impl Iterator<Item = u16> {
    std::iter::from_fn(move || {
        let column = (word != 0).then(|| x + word.trailing_zeros() as u16);
        word &= word.wrapping_sub(1);
        column
    })
}
