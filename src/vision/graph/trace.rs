//! The pixel chains between nodes, and closed loops.

use super::pixels::{BRANCHES, DIRECTIONS, Pixels, branches};
use super::{NONE, Params, Refusal};
use crate::vision::bits::{BitImage, PAD_ROWS};
use std::ops::Range;

/// A chain before spurs are cut.
#[derive(Clone, Debug, PartialEq)]
pub struct RawEdge {
    /// Its nodes, both [`NONE`] for a closed loop.
    pub nodes: [u32; 2],
    /// Range of [`Traced::points`]; the first and the last are pixels of the nodes.
    pub points: Range<u32>,
    /// Sum of its steps, in pixels.
    pub length_px: f32,
}

/// All chains.
#[derive(Clone, Debug)]
pub struct Traced {
    /// The chains.
    pub edges: Vec<RawEdge>,
    /// Their pixels.
    pub points: Vec<[u16; 2]>,
    /// Directions in which chains from a member of a node were walked, by member.
    walked: Vec<u8>,
    /// Pixels not yet walked over; only where there are loops.
    left: BitImage,
    limits: Params,
}

impl Traced {
    pub(super) fn new(params: &Params, width: usize, height: usize) -> Self {
        Self {
            edges: Vec::with_capacity(params.edges_max as usize),
            points: Vec::with_capacity(params.points_max as usize),
            walked: Vec::with_capacity(params.points_max as usize),
            left: BitImage::new(width, height),
            limits: *params,
        }
    }

    /// Where the pixels of a chain stand.
    pub fn range(&self, edge: u32) -> Range<usize> {
        let points = &self.edges[edge as usize].points;
        points.start as usize..points.end as usize
    }

    pub(super) fn run(&mut self, skeleton: &BitImage, pixels: &Pixels) -> Result<(), Refusal> {
        self.edges.clear();
        self.points.clear();
        self.walked.clear();
        self.walked.resize(pixels.members.len(), 0);
        let mut on_chains = 0;
        for (member, &[x, y]) in pixels.members.iter().enumerate() {
            let mut onward = branches(skeleton, x as i32, y as i32);
            while onward != 0 {
                let direction = onward.trailing_zeros() as usize;
                onward &= onward - 1;
                on_chains += self.chain(skeleton, pixels, member, direction)?;
            }
        }
        if on_chains < pixels.chain_pixels { self.loops(skeleton, pixels) } else { Ok(()) }
    }

    /// Walks from a member of a node in `direction` to the next node, unless that was done from the other side or
    /// leads to the same node at once; the number of pixels between the two.
    fn chain(
        &mut self,
        skeleton: &BitImage,
        pixels: &Pixels,
        member: usize,
        direction: usize,
    ) -> Result<usize, Refusal> {
        if self.walked[member] >> direction & 1 == 1 {
            return Ok(0);
        }
        let from = pixels.members[member];
        let begin = self.points.len();
        self.push(from)?;
        let (mut walk, mut direction) = (Walk::new(from), direction);
        let mut corners = 0;
        let arrived = loop {
            let straight = self.points.len();
            let onward = self.go_straight(skeleton, &mut walk, direction)?;
            corners += (self.points.len() - straight) * (direction & 1);
            // Neither an end nor a junction: exactly one way on.
            if onward.is_power_of_two() && self.points.len() < begin + 2 + pixels.chain_pixels {
                direction = onward.trailing_zeros() as usize;
                continue;
            }
            let [x, y] = walk.pixel();
            break pixels.member_at(x, y);
        };
        let Some(arrived) = arrived else { return Ok(0) };
        self.walked[arrived as usize] |= 1 << (direction ^ 4);
        let nodes = [member, arrived as usize].map(|m| pixels.node_of[m]);
        let between = self.points.len() - begin - 2;
        if between == 0 && nodes[0] == nodes[1] {
            self.points.truncate(begin);
            return Ok(0);
        }
        self.close(nodes, begin, corners)?;
        Ok(between)
    }

    /// Walks on as long as the only way on is the same direction; the ways on from where it stops. A loop of its own,
    /// as the processor then guesses right and need not wait for the words of each pixel.
    #[inline]
    fn go_straight(&mut self, skeleton: &BitImage, walk: &mut Walk, direction: usize) -> Result<u8, Refusal> {
        let (same, back) = (1 << direction, 1 << (direction ^ 4));
        loop {
            walk.step(direction);
            self.push(walk.pixel())?;
            let onward = walk.branches(skeleton) & !back;
            if onward != same {
                return Ok(onward);
            }
        }
    }

    /// Walks around the loops without nodes.
    fn loops(&mut self, skeleton: &BitImage, pixels: &Pixels) -> Result<(), Refusal> {
        self.left.copy_from(skeleton);
        for &[x, y] in self.points.iter().chain(&pixels.members) {
            self.left.set(x as usize, y as usize, false);
        }
        for s in 0..skeleton.strips() {
            for y in 0..skeleton.height() {
                while self.left.strip(s)[y] != 0 {
                    let x = s * 64 + self.left.strip(s)[y].trailing_zeros() as usize;
                    self.closed_loop(skeleton, [x as u16, y as u16])?;
                }
            }
        }
        Ok(())
    }

    /// Walks around one loop. A pixel without neighbours is none.
    fn closed_loop(&mut self, skeleton: &BitImage, from: [u16; 2]) -> Result<(), Refusal> {
        self.left.set(from[0] as usize, from[1] as usize, false);
        let mut walk = Walk::new(from);
        let mut onward = walk.branches(skeleton);
        if onward == 0 {
            return Ok(());
        }
        let (begin, mut corners) = (self.points.len(), 0);
        loop {
            self.push(walk.pixel())?;
            let direction = onward.trailing_zeros() as usize & 7;
            corners += direction & 1;
            walk.step(direction);
            let [x, y] = walk.pixel();
            if [x, y] == from || !self.left.get(x as i32, y as i32) {
                break;
            }
            self.left.set(x as usize, y as usize, false);
            onward = walk.branches(skeleton) & !(1 << (direction ^ 4));
        }
        self.close([NONE, NONE], begin, corners)
    }

    #[inline]
    fn push(&mut self, at: [u16; 2]) -> Result<(), Refusal> {
        if self.points.len() >= self.limits.points_max as usize {
            return Err(Refusal::TooManyPoints { points_max: self.limits.points_max });
        }
        self.points.push(at);
        Ok(())
    }

    fn close(&mut self, nodes: [u32; 2], begin: usize, corners: usize) -> Result<(), Refusal> {
        if self.edges.len() >= self.limits.edges_max as usize {
            return Err(Refusal::TooManyEdges { edges_max: self.limits.edges_max });
        }
        let steps = self.points.len() - begin - (nodes[0] != NONE) as usize;
        let length_px = steps as f32 + corners as f32 * (std::f32::consts::SQRT_2 - 1.0);
        self.edges.push(RawEdge { nodes, points: begin as u32..self.points.len() as u32, length_px });
        Ok(())
    }
}

/// A place in a skeleton.
#[derive(Clone, Copy)]
struct Walk {
    x: i32,
    y: i32,
}

impl Walk {
    fn new([x, y]: [u16; 2]) -> Self {
        Self { x: x as i32, y: y as i32 }
    }

    #[inline]
    fn pixel(self) -> [u16; 2] {
        [self.x as u16, self.y as u16]
    }

    #[inline]
    fn step(&mut self, direction: usize) {
        let (dx, dy) = DIRECTIONS[direction & 7];
        self.x += dx;
        self.y += dy;
    }

    /// [`branches`] here, by three words and a table.
    #[inline]
    fn branches(self, skeleton: &BitImage) -> u8 {
        let (stride, x, y) = (skeleton.strip_stride(), self.x as usize, self.y as usize);
        let (strip, bit) = (x / 64, x % 64);
        if bit == 0 || bit == 63 {
            return branches(skeleton, self.x, self.y);
        }
        // The rows above and below the picture are padding.
        let middle = strip * stride + PAD_ROWS + y;
        let rows = &skeleton.words()[middle - 1..middle + 2];
        let three = |row: u64| (row >> (bit - 1)) as usize & 7;
        BRANCHES[three(rows[0]) | three(rows[1]) << 3 | three(rows[2]) << 6]
    }
}
