//! What a part looks like: nodes, wires between them, where it is grasped, and which turns leave it the same.
//!
//! Takes part files ([`Part::read`]) and gives the model that matching, pose and grasp use. Owns the file's format,
//! the rounding of corners ([`Part::centreline`]) and the search for symmetries.
//!
//! ```
//! let tee = pickcell::part::Part::read(concat!(env!("CARGO_MANIFEST_DIR"), "/replay/parts/tee.toml"))?;
//! assert_eq!((tee.nodes.len(), tee.edges.len()), (4, 3));
//! // as it is, and turned by 180 degrees about the stem: a and b change places
//! assert_eq!(tee.symmetries.len(), 2);
//! assert_eq!(tee.symmetries[1].node_permutation, [1, 0, 2, 3]);
//! # Ok::<(), pickcell::part::PartError>(())
//! ```

mod centreline;
mod error;
mod file;
mod symmetry;

use nalgebra::{Isometry3, Point3, Unit, Vector3};

pub use centreline::CentrelinePoint;
pub use error::PartError;

/// Nodes a part may have.
pub const NODES_MAX: usize = 32;
/// Edges a part may have.
pub const EDGES_MAX: usize = 64;
/// Most nodes and `via` points of a part together: what the search keeps memory for.
pub const ANCHORS_MAX: usize = 32;
/// Bend radius of the wire's axis over its thickness, where the part file does not say: what wire of 2.5 mm bent
/// about 3 mm has.
pub const BEND_RADIUS_PER_THICKNESS: f64 = 1.2;

/// A part of round wire or rod.
#[derive(Clone, Debug, PartialEq)]
pub struct Part {
    /// Its name, in every output.
    pub name: String,
    /// Diameter of the wire in mm, above 0.
    pub thickness_mm: f64,
    /// Radius of the wire's axis in a bend, in mm, 0 or more. The key `bend_radius_mm` of the part file may be left
    /// out: then [`BEND_RADIUS_PER_THICKNESS`] times the thickness.
    pub bend_radius_mm: f64,
    /// End points and junctions, in the order of the file.
    pub nodes: Vec<PartNode>,
    /// Wires between nodes, in the order of the file.
    pub edges: Vec<PartEdge>,
    /// Where the gripper takes it.
    pub grasp: PartGrasp,
    /// Every proper rotation that maps the part onto itself, the identity first. A straight part turns freely about
    /// its axis besides; see [`is_straight`](Self::is_straight).
    pub symmetries: Vec<Symmetry>,
}

/// An end point or a junction.
#[derive(Clone, Debug, PartialEq)]
pub struct PartNode {
    /// Its name, in every output.
    pub name: String,
    /// On the wire's axis, in the part's frame.
    pub position_mm: Point3<f64>,
    /// What it is.
    pub kind: NodeKind,
}

/// What a node is, by the number of wires that end there.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum NodeKind {
    /// The flat end of one wire.
    End,
    /// Three or more wires meet.
    Junction,
}

/// A wire from node to node.
#[derive(Clone, Debug, PartialEq)]
pub struct PartEdge {
    /// Index of the node where it begins.
    pub from: usize,
    /// Index of the node where it ends.
    pub to: usize,
    /// The corners on the way as they were without a bend radius, in the part's frame.
    pub via: Vec<Point3<f64>>,
}

/// Where and how the gripper takes the part, in the part's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PartGrasp {
    /// On the wire's axis.
    pub position_mm: Point3<f64>,
    /// The way the gripper comes. It may turn about the wire's axis.
    pub approach: Unit<Vector3<f64>>,
    /// The way the fingers close, perpendicular to the approach.
    pub closing: Unit<Vector3<f64>>,
    /// Opening of the fingers, in mm.
    pub width_mm: f64,
    /// How far from there along the wire, which is straight so far, the part may be taken as well, either way, in mm: where
    /// there is no room for the fingers, say.
    pub slide_mm: f64,
}

/// A rotation that maps the part onto itself.
#[derive(Clone, Debug, PartialEq)]
pub struct Symmetry {
    /// Node `i` comes to lie where node `node_permutation[i]` was.
    pub node_permutation: Vec<usize>,
    /// Part from part: `part_from_part * nodes[i] = nodes[node_permutation[i]]`.
    pub part_from_part: Isometry3<f64>,
}

impl Part {
    /// Whether all of the part lies on one line, so that it looks the same however it is turned about that line.
    pub fn is_straight(&self) -> bool {
        self.straight_axis().is_some()
    }

    /// The direction of the line that all of the part lies on, if there is one.
    pub fn straight_axis(&self) -> Option<Unit<Vector3<f64>>> {
        symmetry::line_of(&self.corner_points(), self.symmetry_tolerance_mm())
    }

    /// Direction of the wire at the grasp, approach × closing.
    pub fn grasp_axis(&self) -> Unit<Vector3<f64>> {
        Unit::new_normalize(self.grasp.approach.cross(&self.grasp.closing))
    }

    /// How many wires end at a node; one that begins and ends there counts twice.
    pub fn degree(&self, node: usize) -> usize {
        self.edges.iter().map(|e| usize::from(e.from == node) + usize::from(e.to == node)).sum()
    }

    /// Nodes and `via` corners: the points that fix the part's shape.
    fn corner_points(&self) -> Vec<Point3<f64>> {
        let nodes = self.nodes.iter().map(|n| n.position_mm);
        nodes.chain(self.edges.iter().flat_map(|e| e.via.iter().copied())).collect()
    }

    /// Two shapes that differ by less look the same to the cameras.
    fn symmetry_tolerance_mm(&self) -> f64 {
        0.1 * self.thickness_mm
    }
}

#[cfg(test)]
mod tests;
