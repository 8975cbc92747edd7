//! Skeleton to graph (paper IV-C): end points and junctions as nodes, the pixel chains between them as edges.
//!
//! Takes a skeleton, the mask it came from and, where there is one, the picture; gives a [`Graph`]; owns the work
//! lists. In order:
//!
//! 1. [`pixels`]: every skeleton pixel is told by its number of branches: one is an end, three or more a junction.
//!    Two pixels that touch by a corner belong together only where no side neighbour joins them already, so the
//!    corners of a staircase are no junctions. Junction pixels that touch are one node, at their centroid.
//! 2. [`trace`]: chains between nodes, and closed loops.
//! 3. [`prune`]: spurs shorter than the part is thick go; a junction left with two edges dissolves. What Zhang-Suen
//!    ate of lines along a diagonal, up to all but a pixel, is put back.
//! 4. [`section`] and [`ends`]: local thickness, and ends put back to where the part ends.
//!
//! Positions are in distorted pixels, pixel centres at whole numbers.

mod classify;
pub mod ends;
pub mod pixels;
pub mod prune;
mod regrow;
pub mod section;
pub mod trace;

use crate::frame::Frame;
use crate::level::Level;
use crate::time::Timestamp;
use crate::vision::bits::BitImage;
use std::ops::Range;

/// In [`Edge::nodes`]: a closed loop has no nodes.
pub const NONE: u32 = u32::MAX;

/// What a node is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NodeKind {
    /// The end of a line.
    End,
    /// A point where three or more lines meet.
    Junction,
}

/// A point of the picture where lines end or meet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Node {
    /// What it is.
    pub kind: NodeKind,
    /// Distorted pixel. Junction: centroid of its cluster. End: put back to where the part ends, to sub-pixel.
    pub position_px: [f32; 2],
    /// The same before the end was put back: the last pixel of the skeleton, about half a thickness from the end.
    pub skeleton_px: [f32; 2],
    /// Number of edges that end here; a loop from a node to itself counts twice.
    pub degree: u8,
    /// Half the thickness of the part here: the largest of the edges that end here, in pixels.
    pub half_thickness_px: f32,
    /// Whether the part was seen to end here. `false` where it goes on under a neighbour or leaves the picture, and
    /// for junctions.
    pub end_visible: bool,
}

/// A chain of skeleton pixels between two nodes, or a closed loop.
#[derive(Clone, Debug, PartialEq)]
pub struct Edge {
    /// Indices into [`Graph::nodes`], both [`NONE`] for a closed loop without nodes.
    pub nodes: [u32; 2],
    /// Range of [`Graph::points`], in order from `nodes[0]` to `nodes[1]`; neighbours in it touch except where a
    /// junction was dissolved.
    pub points: Range<u32>,
    /// Half the thickness of the part: median of sections across it, in pixels.
    pub half_thickness_px: f32,
}

/// Nodes and edges of one picture.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Graph {
    /// End points and junctions.
    pub nodes: Vec<Node>,
    /// Chains between them.
    pub edges: Vec<Edge>,
    /// Skeleton pixels (x, y) of all edges, and those that Zhang-Suen should have left along diagonals.
    pub points: Vec<[u16; 2]>,
}

impl Graph {
    /// Empties it and keeps its memory.
    pub fn clear(&mut self) {
        self.nodes.clear();
        self.edges.clear();
        self.points.clear();
    }

    /// Memory for the largest graph that the limits allow: none is taken later.
    pub fn reserve(&mut self, params: &Params) {
        self.nodes.reserve(params.nodes_max as usize);
        self.edges.reserve(params.edges_max as usize);
        // Those that were traced, and as many where ends grow again.
        self.points.reserve(2 * params.points_max as usize);
    }

    /// The pixels of an edge, in order from its first node to its second.
    pub fn edge_points(&self, edge: &Edge) -> &[[u16; 2]] {
        &self.points[edge.points.start as usize..edge.points.end as usize]
    }
}

/// What to do where a picture shows too much.
const NARROWER: &str = "narrow the colour range (recognition.colour, --color-min) or the region (recognition.region_px, --region-px)";

/// Why a picture gives no graph. The picture shows too much: the colour range, the light or the region is wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum Refusal {
    /// More end points and junctions than the limit.
    #[error("the picture has more than {nodes_max} end points and junctions: {NARROWER}")]
    TooManyNodes {
        /// The limit.
        nodes_max: u32,
    },
    /// More end points, junctions and bends than can be matched, see [`crate::matching::nodes`].
    #[error("the picture has more than {nodes_max} end points, junctions and bends: {NARROWER}")]
    TooManyImageNodes {
        /// The limit.
        nodes_max: u32,
    },
    /// More edges than the limit.
    #[error("the picture has more than {edges_max} lines: {NARROWER}")]
    TooManyEdges {
        /// The limit.
        edges_max: u32,
    },
    /// More skeleton pixels than the limit.
    #[error("the picture has more than {points_max} skeleton pixels: {NARROWER}")]
    TooManyPoints {
        /// The limit.
        points_max: u32,
    },
}

/// Parameters of the graph: its limits, which are its memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Params {
    /// Most end points and junctions before spurs are cut; 2048 by default, as many as a search looks through in its time.
    pub nodes_max: u32,
    /// Most edges before spurs are cut; 4096 by default.
    pub edges_max: u32,
    /// Most skeleton pixels; 32768 at 640x480.
    pub points_max: u32,
}

impl Params {
    /// The default limits for a picture size: wire is longer in more pixels, but there are not more parts.
    pub fn for_size(width: usize, height: usize) -> Self {
        let scale = (width * height).div_ceil(640 * 480).max(1) as u32;
        Self { nodes_max: 2048, edges_max: 4096, points_max: 32768 * scale }
    }
}

impl Default for Params {
    fn default() -> Self {
        Self::for_size(640, 480)
    }
}

/// Workspace of the graph for one picture size; owns all its memory.
///
/// ```
/// use pickcell::vision::{bits::BitImage, graph::{Graph, Graphs, NodeKind, Params}};
/// let skeleton = BitImage::from_text("
///     ..........
///     .########.
///     ....#.....
///     ....#.....
///     ....#.....
///     ....#.....
///     ..........");
/// let mut graph = Graph::default();
/// let mut graphs = Graphs::new(Params::default(), 10, 7);
/// graphs.run(&skeleton, &skeleton, None, &mut graph).unwrap();
/// assert_eq!(graph.nodes.iter().filter(|n| n.kind == NodeKind::End).count(), 3);
/// assert_eq!(graph.nodes.iter().filter(|n| n.kind == NodeKind::Junction).count(), 1);
/// assert_eq!(graph.edges.len(), 3);
/// ```
#[derive(Clone, Debug)]
pub struct Graphs {
    params: Params,
    level: Level,
    width: usize,
    height: usize,
    pixels: pixels::Pixels,
    traced: trace::Traced,
    pruned: prune::Pruned,
}

impl Graphs {
    /// A workspace for pictures of `width` x `height` pixels, with the best instructions of this machine.
    ///
    /// # Panics
    /// Where a side is longer than 65535 pixels.
    pub fn new(params: Params, width: usize, height: usize) -> Self {
        Self::with_level(params, width, height, Level::detect())
    }

    /// A workspace that uses other instructions; the result is the same.
    ///
    /// # Panics
    /// Where a side is longer than 65535 pixels, or the machine has not got the instructions.
    pub fn with_level(params: Params, width: usize, height: usize, level: Level) -> Self {
        assert!(Level::available().contains(&level), "this machine has no {}", level.name());
        assert!(width <= u16::MAX as usize && height <= u16::MAX as usize, "{width}x{height} picture");
        Self {
            params,
            level,
            width,
            height,
            pixels: pixels::Pixels::new(&params, width, height),
            traced: trace::Traced::new(&params, width, height),
            pruned: prune::Pruned::new(&params),
        }
    }

    /// The graph of `skeleton`. `mask` is the picture it was thinned from; `frame` is the camera's picture, for the
    /// grey values at the ends: without it, or with a format that is still compressed, ends lie at the mask's border.
    ///
    /// # Errors
    /// Where the picture goes over a limit of [`Params`]; `graph` is empty then.
    ///
    /// # Panics
    /// Where a picture has not the size given to [`Graphs::new`].
    pub fn run(
        &mut self,
        skeleton: &BitImage,
        mask: &BitImage,
        frame: Option<&Frame>,
        graph: &mut Graph,
    ) -> Result<(), Refusal> {
        self.run_until(skeleton, mask, frame, graph, None).map(|_| ())
    }

    /// As [`Graphs::run`], broken off at `end` where it is given; says whether there was time. `graph` is empty where there was
    /// none.
    ///
    /// # Errors
    /// As [`Graphs::run`].
    ///
    /// # Panics
    /// As [`Graphs::run`].
    pub fn run_until(
        &mut self,
        skeleton: &BitImage,
        mask: &BitImage,
        frame: Option<&Frame>,
        graph: &mut Graph,
        end: Option<Timestamp>,
    ) -> Result<bool, Refusal> {
        for picture in [skeleton, mask] {
            assert_eq!((picture.width(), picture.height()), (self.width, self.height), "size of the picture");
        }
        graph.clear();
        graph.reserve(&self.params);
        let is_late = || end.is_some_and(Timestamp::is_past);
        self.pixels.run(self.level, skeleton)?;
        if is_late() {
            return Ok(false);
        }
        self.traced.run(skeleton, &self.pixels)?;
        if is_late() {
            return Ok(false);
        }
        self.pruned.run(mask, &self.pixels, &self.traced);
        if is_late() {
            return Ok(false);
        }
        self.pruned.write(&self.params, mask, &self.pixels, &self.traced, graph);
        section::measure(mask, graph);
        if is_late() {
            graph.clear();
            return Ok(false);
        }
        ends::put_back(self.level, mask, frame, graph);
        Ok(true)
    }
}

#[cfg(test)]
mod tests;
