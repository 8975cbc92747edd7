//! Spurs cut, and junctions that are none any more dissolved.
//!
//! A spur is an edge from a junction to an end that is shorter than the lines at that junction are thick: a bump of
//! the border, or one leg of the fork that a flat end is thinned to. So are loops from a junction to itself of that
//! size. Where every edge of a junction is a spur, the two longest stay: a short part, not a bump.

use super::pixels::Pixels;
use super::trace::Traced;
use super::{Edge, Graph, NONE, Node, NodeKind, Params};
use super::{regrow, section::thickness_around};
use crate::vision::bits::BitImage;
use std::ops::Range;

/// Rounds of cutting and joining; each can make new spurs only from shorter ones.
const ROUNDS_MAX: usize = 4;

/// A stretch of one traced chain, walked forward or backward.
#[derive(Clone, Copy, Debug)]
struct Piece {
    edge: u32,
    backward: bool,
}

/// One or several traced chains that are one edge.
#[derive(Clone, Debug)]
struct Joined {
    nodes: [u32; 2],
    pieces: [u32; 2],
    length_px: f32,
    /// Thickness in the middle of the longest piece.
    thickness_px: f32,
    alive: bool,
}

/// Edges after cutting; owns the lists of the rounds.
#[derive(Clone, Debug)]
pub struct Pruned {
    edges: Vec<Joined>,
    pieces: Vec<Piece>,
    edges_before: Vec<Joined>,
    pieces_before: Vec<Piece>,
    /// Edge ends by node: `incident[first[n]..first[n + 1]]` are `2 * edge + end`.
    first: Vec<u32>,
    incident: Vec<u32>,
    kinds: Vec<NodeKind>,
    renumbered: Vec<u32>,
}

impl Pruned {
    pub(super) fn new(params: &Params) -> Self {
        let (nodes, edges) = (params.nodes_max as usize, params.edges_max as usize);
        Self {
            edges: Vec::with_capacity(edges),
            pieces: Vec::with_capacity(edges),
            edges_before: Vec::with_capacity(edges),
            pieces_before: Vec::with_capacity(edges),
            first: Vec::with_capacity(nodes + 1),
            incident: Vec::with_capacity(2 * edges),
            kinds: Vec::with_capacity(nodes),
            renumbered: Vec::with_capacity(nodes),
        }
    }

    pub(super) fn run(&mut self, mask: &BitImage, pixels: &Pixels, traced: &Traced) {
        self.kinds.clear();
        self.kinds.extend(pixels.nodes.iter().map(|n| n.kind));
        self.edges.clear();
        self.pieces.clear();
        for (i, edge) in traced.edges.iter().enumerate() {
            let middle = traced.points[(edge.points.start + edge.points.end) as usize / 2];
            self.pieces.push(Piece { edge: i as u32, backward: false });
            self.edges.push(Joined {
                nodes: edge.nodes,
                pieces: [i as u32, i as u32 + 1],
                length_px: edge.length_px,
                thickness_px: thickness_around(mask, middle),
                alive: true,
            });
        }
        for _ in 0..ROUNDS_MAX {
            self.list_incident();
            let cut = self.cut(mask, pixels);
            if cut {
                self.list_incident();
            }
            if !self.join() && !cut {
                break;
            }
        }
        self.list_incident();
    }

    /// Fills `first` and `incident` from the living edges.
    fn list_incident(&mut self) {
        let nodes = self.kinds.len();
        self.first.clear();
        self.first.resize(nodes + 1, 0);
        let ends = |edge: &Joined| if edge.alive { edge.nodes } else { [NONE; 2] };
        for n in self.edges.iter().flat_map(ends).filter(|&n| n != NONE) {
            self.first[n as usize + 1] += 1;
        }
        for n in 0..nodes {
            self.first[n + 1] += self.first[n];
        }
        self.incident.clear();
        self.incident.resize(self.first[nodes] as usize, 0);
        for (i, edge) in self.edges.iter().enumerate() {
            for (end, n) in ends(edge).into_iter().enumerate().filter(|&(_, n)| n != NONE) {
                // Filled from the back, so that `first` can count down to the beginnings.
                let slot = &mut self.first[n as usize + 1];
                *slot -= 1;
                self.incident[*slot as usize] = (2 * i + end) as u32;
            }
        }
        // Every count ran down to the beginning of its own node: shift them back into place.
        self.first.remove(0);
        self.first.push(self.incident.len() as u32);
    }

    fn incident_to(&self, n: u32) -> &[u32] {
        &self.incident[self.first[n as usize] as usize..self.first[n as usize + 1] as usize]
    }

    /// Cuts spurs; whether there were any.
    fn cut(&mut self, mask: &BitImage, pixels: &Pixels) -> bool {
        let mut any = false;
        for n in 0..self.kinds.len() as u32 {
            let slots = self.first[n as usize] as usize..self.first[n as usize + 1] as usize;
            if self.kinds[n as usize] != NodeKind::Junction || slots.len() < 3 {
                continue;
            }
            let thickness = self.thickness_at(n, mask, pixels);
            let is_spur = |edge: &Joined| {
                let [a, b] = edge.nodes;
                let other = if a == n { b } else { a };
                edge.length_px < thickness && (other == n || self.kinds[other as usize] == NodeKind::End)
            };
            let (mut spurs, mut longest) = (0, [(0.0f32, NONE); 2]);
            for &slot in &self.incident[slots.clone()] {
                let edge = &self.edges[slot as usize / 2];
                if is_spur(edge) {
                    spurs += 1;
                    if edge.length_px > longest[0].0 {
                        longest = [(edge.length_px, slot / 2), longest[0]];
                    } else if edge.length_px > longest[1].0 {
                        longest[1] = (edge.length_px, slot / 2);
                    }
                }
            }
            if spurs < slots.len() {
                longest = [(0.0, NONE); 2];
            }
            for slot in slots {
                let i = self.incident[slot] / 2;
                if is_spur(&self.edges[i as usize]) && longest.iter().all(|l| l.1 != i) {
                    self.edges[i as usize].alive = false;
                    any = true;
                }
            }
        }
        any
    }

    /// Thickness of the lines at a junction: the largest among its edges that are longer than thick, else what the
    /// mask measures at the junction itself.
    fn thickness_at(&self, n: u32, mask: &BitImage, pixels: &Pixels) -> f32 {
        let long = self
            .incident_to(n)
            .iter()
            .map(|&slot| &self.edges[slot as usize / 2])
            .filter(|edge| edge.length_px > edge.thickness_px)
            .map(|edge| edge.thickness_px)
            .fold(0.0, f32::max);
        if long > 0.0 {
            return long;
        }
        let [x, y] = pixels.nodes[n as usize].centroid_px;
        thickness_around(mask, [x.round() as u16, y.round() as u16])
    }

    /// Turns junctions with one edge into ends and joins the two edges of junctions with two; whether anything
    /// changed.
    fn join(&mut self) -> bool {
        let mut changed = false;
        for n in 0..self.kinds.len() {
            let degree = self.first[n + 1] - self.first[n];
            if self.kinds[n] == NodeKind::Junction && degree == 1 {
                self.kinds[n] = NodeKind::End;
                changed = true;
            }
            changed |= self.kinds[n] == NodeKind::Junction && degree == 2;
        }
        if !changed {
            return false;
        }
        std::mem::swap(&mut self.edges, &mut self.edges_before);
        std::mem::swap(&mut self.pieces, &mut self.pieces_before);
        self.edges.clear();
        self.pieces.clear();
        for n in 0..self.kinds.len() as u32 {
            if !self.dissolves(n) {
                for slot in self.first[n as usize]..self.first[n as usize + 1] {
                    self.walk(n, self.incident[slot as usize]);
                }
            }
        }
        // What is left are loops: closed ones, and those made of dissolved junctions alone.
        for i in 0..self.edges_before.len() as u32 {
            if self.edges_before[i as usize].alive {
                self.walk(self.edges_before[i as usize].nodes[0], 2 * i);
            }
        }
        true
    }

    fn dissolves(&self, n: u32) -> bool {
        self.kinds[n as usize] == NodeKind::Junction && self.incident_to(n).len() == 2
    }

    /// Follows an edge from node `n` through dissolved junctions to a node that stays.
    fn walk(&mut self, n: u32, slot: u32) {
        if !self.edges_before[slot as usize / 2].alive {
            return;
        }
        let begin = self.pieces.len() as u32;
        let mut joined =
            Joined { nodes: [n; 2], pieces: [begin; 2], length_px: 0.0, thickness_px: 0.0, alive: true };
        let (mut slot, mut longest) = (slot, -1.0);
        loop {
            let (i, backward) = (slot as usize / 2, slot % 2 == 1);
            let edge = &mut self.edges_before[i];
            edge.alive = false;
            joined.length_px += edge.length_px;
            if edge.length_px > longest {
                longest = edge.length_px;
                joined.thickness_px = edge.thickness_px;
            }
            let far = edge.nodes[1 - backward as usize];
            let pieces = edge.pieces[0] as usize..edge.pieces[1] as usize;
            if backward {
                let turned = |p: &Piece| Piece { edge: p.edge, backward: !p.backward };
                self.pieces.extend(self.pieces_before[pieces].iter().rev().map(turned));
            } else {
                self.pieces.extend_from_slice(&self.pieces_before[pieces]);
            }
            joined.nodes[1] = far;
            if far == NONE || !self.dissolves(far) {
                break;
            }
            let arrived = 2 * i as u32 + (1 - backward as u32);
            let onward = self.incident_to(far).iter().copied().find(|&s| s != arrived);
            match onward.filter(|&s| self.edges_before[s as usize / 2].alive) {
                Some(next) => slot = next,
                None => {
                    joined.nodes = [NONE; 2];
                    break;
                }
            }
        }
        joined.pieces[1] = self.pieces.len() as u32;
        self.edges.push(joined);
    }

    /// Writes nodes, edges and points; lengths and thicknesses follow.
    pub(super) fn write(
        &mut self,
        params: &Params,
        mask: &BitImage,
        pixels: &Pixels,
        traced: &Traced,
        graph: &mut Graph,
    ) {
        self.renumbered.clear();
        for (n, raw) in pixels.nodes.iter().enumerate() {
            let degree = self.first[n + 1] - self.first[n];
            self.renumbered.push(if degree == 0 { NONE } else { graph.nodes.len() as u32 });
            if degree > 0 {
                graph.nodes.push(node(self.kinds[n], raw.centroid_px, degree));
            }
        }
        for joined in self.edges.iter().filter(|e| e.alive) {
            let begin = graph.points.len();
            for piece in &self.pieces[joined.pieces[0] as usize..joined.pieces[1] as usize] {
                append(&mut graph.points, begin, &traced.points[traced.range(piece.edge)], piece.backward);
            }
            let renumber = |n: u32| if n == NONE { NONE } else { self.renumbered[n as usize] };
            let nodes = joined.nodes.map(renumber);
            for (end, n) in nodes.into_iter().enumerate().filter(|&(_, n)| n != NONE) {
                if graph.nodes[n as usize].kind == NodeKind::End {
                    let tip =
                        regrow_end(params, mask, &mut graph.points, begin, end == 1, joined.thickness_px);
                    if let Some(tip) = tip {
                        graph.nodes[n as usize].skeleton_px = tip;
                        graph.nodes[n as usize].position_px = tip;
                    }
                }
            }
            graph.edges.push(edge(nodes, begin..graph.points.len(), joined.thickness_px));
        }
        for &pixel in &pixels.alone {
            let begin = graph.points.len();
            let room = graph.nodes.len() + 2 <= params.nodes_max as usize
                && graph.edges.len() < params.edges_max as usize;
            let points_max = if room { params.points_max as usize } else { 0 };
            if let Some(thickness) = regrow::from_pixel(mask, pixel, &mut graph.points, points_max) {
                let first = graph.nodes.len() as u32;
                for point in [graph.points[begin], graph.points[graph.points.len() - 1]] {
                    graph.nodes.push(node(NodeKind::End, point.map(f32::from), 1));
                }
                graph.edges.push(edge([first, first + 1], begin..graph.points.len(), thickness));
            }
        }
    }
}

fn node(kind: NodeKind, at: [f32; 2], degree: u32) -> Node {
    Node {
        kind,
        position_px: at,
        skeleton_px: at,
        degree: degree.min(u8::MAX as u32) as u8,
        half_thickness_px: 0.0,
        end_visible: false,
    }
}

fn edge(nodes: [u32; 2], points: Range<usize>, thickness_px: f32) -> Edge {
    Edge { nodes, points: points.start as u32..points.end as u32, half_thickness_px: thickness_px / 2.0 }
}

/// Appends a piece to the chain that began at `begin`; a pixel in which two pieces meet once only.
fn append(points: &mut Vec<[u16; 2]>, begin: usize, piece: &[[u16; 2]], backward: bool) {
    let first = if backward { piece.last() } else { piece.first() };
    if points.len() > begin && points.last() == first {
        points.pop();
    }
    if backward {
        points.extend(piece.iter().rev());
    } else {
        points.extend_from_slice(piece);
    }
}

/// Puts back what thinning ate of a diagonal at one end of the chain; its new last pixel.
fn regrow_end(
    params: &Params,
    mask: &BitImage,
    points: &mut Vec<[u16; 2]>,
    begin: usize,
    at_last: bool,
    thickness_px: f32,
) -> Option<[f32; 2]> {
    let chain_end = points.len();
    if !regrow::extend(mask, points, begin, at_last, thickness_px, params.points_max as usize) {
        return None;
    }
    let tip = points.last()?.map(f32::from);
    if !at_last {
        let grown = points.len() - chain_end;
        points[chain_end..].reverse();
        points[begin..].rotate_right(grown);
    }
    Some(tip)
}
