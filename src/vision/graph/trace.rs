//! The pixel chains between nodes, and closed loops.

use super::pixels::{DIRECTIONS, Pixels, branches};
use super::{NONE, Params, Refusal};
use crate::vision::bits::BitImage;
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
    /// Chain pixels not yet walked over.
    left: BitImage,
}

impl Traced {
    pub(super) fn new(params: &Params, width: usize, height: usize) -> Self {
        Self {
            edges: Vec::with_capacity(params.edges_max as usize),
            points: Vec::with_capacity(params.points_max as usize),
            left: BitImage::new(width, height),
        }
    }

    pub(super) fn run(
        &mut self,
        params: &Params,
        skeleton: &BitImage,
        pixels: &Pixels,
    ) -> Result<(), Refusal> {
        self.edges.clear();
        self.points.clear();
        self.left.copy_from(skeleton);
        for &[x, y] in &pixels.members {
            self.left.set(x as usize, y as usize, false);
        }
        for (n, node) in pixels.nodes.iter().enumerate() {
            for &[x, y] in pixels.members_of(node) {
                let onward = branches(skeleton, x as i32, y as i32);
                for direction in (0..8).filter(|d| onward >> d & 1 == 1) {
                    self.chain(params, skeleton, pixels, n as u32, [x, y], direction)?;
                }
            }
        }
        for s in 0..skeleton.strips() {
            for y in 0..skeleton.height() {
                while self.left.strip(s)[y] != 0 {
                    let x = s * 64 + self.left.strip(s)[y].trailing_zeros() as usize;
                    self.closed_loop(params, skeleton, [x as u16, y as u16])?;
                }
            }
        }
        Ok(())
    }

    /// Where the pixels of a chain stand.
    pub fn range(&self, edge: u32) -> Range<usize> {
        let points = &self.edges[edge as usize].points;
        points.start as usize..points.end as usize
    }

    /// Walks from a pixel of node `n` in `direction` to the next node.
    fn chain(
        &mut self,
        params: &Params,
        skeleton: &BitImage,
        pixels: &Pixels,
        n: u32,
        from: [u16; 2],
        direction: usize,
    ) -> Result<(), Refusal> {
        let first = step(from, direction);
        let second = pixels.node_at(first[0], first[1]);
        match second {
            // Two nodes side by side: the one with the smaller number draws the edge.
            Some(m) if m <= n => return Ok(()),
            None if !self.left.get(first[0] as i32, first[1] as i32) => return Ok(()),
            _ => {}
        }
        let begin = self.begin(params, from)?;
        let (mut at, mut direction, mut length) = (first, direction, step_length(direction));
        loop {
            self.push(params, at)?;
            if let Some(m) = pixels.node_at(at[0], at[1]) {
                return self.close(params, [n, m], begin, length);
            }
            self.left.set(at[0] as usize, at[1] as usize, false);
            let onward = branches(skeleton, at[0] as i32, at[1] as i32) & !(1 << (direction ^ 4));
            direction = onward.trailing_zeros() as usize & 7;
            length += step_length(direction);
            at = step(at, direction);
        }
    }

    /// Walks around a loop without nodes. A pixel without neighbours is none.
    fn closed_loop(&mut self, params: &Params, skeleton: &BitImage, from: [u16; 2]) -> Result<(), Refusal> {
        self.left.set(from[0] as usize, from[1] as usize, false);
        let onward = branches(skeleton, from[0] as i32, from[1] as i32);
        if onward == 0 {
            return Ok(());
        }
        let begin = self.begin(params, from)?;
        let mut direction = onward.trailing_zeros() as usize;
        let mut length = step_length(direction);
        let mut at = step(from, direction);
        while at != from {
            self.push(params, at)?;
            self.left.set(at[0] as usize, at[1] as usize, false);
            let onward = branches(skeleton, at[0] as i32, at[1] as i32) & !(1 << (direction ^ 4));
            direction = onward.trailing_zeros() as usize & 7;
            length += step_length(direction);
            at = step(at, direction);
        }
        self.close(params, [NONE, NONE], begin, length)
    }

    fn begin(&mut self, params: &Params, from: [u16; 2]) -> Result<u32, Refusal> {
        let begin = self.points.len() as u32;
        self.push(params, from)?;
        Ok(begin)
    }

    fn push(&mut self, params: &Params, at: [u16; 2]) -> Result<(), Refusal> {
        if self.points.len() >= params.points_max as usize {
            return Err(Refusal::TooManyPoints { points_max: params.points_max });
        }
        self.points.push(at);
        Ok(())
    }

    fn close(&mut self, params: &Params, nodes: [u32; 2], begin: u32, length_px: f32) -> Result<(), Refusal> {
        if self.edges.len() >= params.edges_max as usize {
            return Err(Refusal::TooManyEdges { edges_max: params.edges_max });
        }
        self.edges.push(RawEdge { nodes, points: begin..self.points.len() as u32, length_px });
        Ok(())
    }
}

fn step([x, y]: [u16; 2], direction: usize) -> [u16; 2] {
    let (dx, dy) = DIRECTIONS[direction];
    [x.wrapping_add_signed(dx as i16), y.wrapping_add_signed(dy as i16)]
}

fn step_length(direction: usize) -> f32 {
    if direction.is_multiple_of(2) { 1.0 } else { std::f32::consts::SQRT_2 }
}
