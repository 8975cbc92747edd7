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
    /// Room for their pixels, of which there are so many.
    pub points: Box<[[u16; 2]]>,
    count: usize,
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
            points: vec![[0; 2]; params.points_max as usize].into(),
            count: 0,
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
        self.count = 0;
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
        let begin = self.count;
        self.push(from)?;
        let (mut walk, mut direction) = (Walk::new(from), direction);
        let mut corners = 0;
        let arrived = loop {
            let straight = self.count;
            let onward = self.go_straight(skeleton, &mut walk, direction)?;
            corners += (self.count - straight) * (direction & 1);
            // Neither an end nor a junction: exactly one way on.
            if onward.is_power_of_two() && self.count < begin + 2 + pixels.chain_pixels {
                direction = onward.trailing_zeros() as usize;
                continue;
            }
            let [x, y] = walk.pixel();
            break pixels.member_at(x, y);
        };
        let Some(arrived) = arrived else { return Ok(0) };
        self.walked[arrived as usize] |= 1 << (direction ^ 4);
        let nodes = [member, arrived as usize].map(|m| pixels.node_of[m]);
        let between = self.count - begin - 2;
        if between == 0 && nodes[0] == nodes[1] {
            self.count = begin;
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
        let (dx, dy) = DIRECTIONS[direction & 7];
        let (words, mut here) = (skeleton.words(), walk.word(skeleton));
        let Some(room) = self.points.get_mut(self.count..) else { return Err(self.too_many()) };
        for (taken, place) in room.iter_mut().enumerate() {
            (walk.x, walk.y) = (walk.x + dx, walk.y + dy);
            here = here.wrapping_add_signed(dy as isize);
            *place = walk.pixel();
            let onward = match walk.x & 63 {
                0 | 63 => {
                    here = walk.word(skeleton);
                    branches(skeleton, walk.x, walk.y)
                }
                bit => branches_in(words, here, bit),
            };
            if onward & !back != same {
                self.count += taken + 1;
                return Ok(onward & !back);
            }
        }
        Err(self.too_many())
    }

    /// Walks around the loops without nodes.
    fn loops(&mut self, skeleton: &BitImage, pixels: &Pixels) -> Result<(), Refusal> {
        self.left.copy_from(skeleton);
        for &[x, y] in self.points[..self.count].iter().chain(&pixels.members) {
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
        let (begin, mut corners) = (self.count, 0);
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

    fn too_many(&self) -> Refusal {
        Refusal::TooManyPoints { points_max: self.limits.points_max }
    }

    #[inline]
    fn push(&mut self, at: [u16; 2]) -> Result<(), Refusal> {
        let Some(place) = self.points.get_mut(self.count) else { return Err(self.too_many()) };
        *place = at;
        self.count += 1;
        Ok(())
    }

    fn close(&mut self, nodes: [u32; 2], begin: usize, corners: usize) -> Result<(), Refusal> {
        if self.edges.len() >= self.limits.edges_max as usize {
            return Err(Refusal::TooManyEdges { edges_max: self.limits.edges_max });
        }
        let steps = self.count - begin - (nodes[0] != NONE) as usize;
        let length_px = steps as f32 + corners as f32 * (std::f32::consts::SQRT_2 - 1.0);
        self.edges.push(RawEdge { nodes, points: begin as u32..self.count as u32, length_px });
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

    /// Index of the word that it is in.
    #[inline]
    fn word(self, skeleton: &BitImage) -> usize {
        self.x as usize / 64 * skeleton.strip_stride() + PAD_ROWS + self.y as usize
    }

    /// [`branches`] here.
    #[inline]
    fn branches(self, skeleton: &BitImage) -> u8 {
        match self.x & 63 {
            0 | 63 => branches(skeleton, self.x, self.y),
            bit => branches_in(skeleton.words(), self.word(skeleton), bit),
        }
    }
}

/// [`branches`] of a bit, neither the first nor the last of its word, by three words and a table.
#[inline(always)]
fn branches_in(words: &[u64], here: usize, bit: i32) -> u8 {
    // The rows above and below the picture are padding.
    let rows = &words[here - 1..here + 2];
    let three = |row: u64| (row >> (bit - 1)) as usize & 7;
    BRANCHES[three(rows[0]) | three(rows[1]) << 3 | three(rows[2]) << 6]
}
