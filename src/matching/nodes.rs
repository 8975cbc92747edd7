//! Image nodes: what a picture's graph offers to be matched with a node of the part's model (paper IV-C, IV-D).
//!
//! Takes the [`Graph`] of one picture and gives [`ImageNode`]s: its end points and junctions, and the bends of its
//! edges, each with the directions in which wire leaves it. A bend is where two straight pieces of a chain meet;
//! its place is the meeting point of the lines through both, which is where a part file puts a `via`.
//!
//! ```
//! use nalgebra::Vector2;
//! use pickcell::matching::nodes::{ImageNodes, NodeRole, Params};
//! use pickcell::rig::{CameraModel, UndistortTable};
//! use pickcell::vision::bits::BitImage;
//! use pickcell::vision::graph::{self, Graph, Graphs};
//! use pickcell::vision::thin::{self, whole::WholeThin};
//!
//! // A hook, five pixels thick: level wire, and upright wire at its right end.
//! let mut mask = BitImage::new(160, 120);
//! for (x, y) in (28..100).flat_map(|y| (20..121).map(move |x| (x, y))) {
//!     mask.set(x, y, y <= 32 || x >= 116);
//! }
//! let (mut skeleton, mut graph) = (mask.clone(), Graph::default());
//! WholeThin::new(thin::Params::default(), 160, 120).run(&mask, &mut skeleton);
//! Graphs::new(graph::Params::for_size(160, 120), 160, 120).run(&skeleton, &mask, None, &mut graph)?;
//!
//! let rays = UndistortTable::new(&CameraModel::pinhole(160, 120, 150.0, 80.0, 60.0), 0.005);
//! let mut nodes = ImageNodes::new(Params::default());
//! assert!(nodes.run(&graph, &mask, &rays, None)?);
//! let [a, b, bend] = nodes.nodes() else { panic!("two ends and a bend") };
//! assert_eq!([a.role, b.role, bend.role], [NodeRole::End, NodeRole::End, NodeRole::Bend]);
//! assert!((bend.position_px - Vector2::new(118.0, 30.0)).norm() < 1.5 && bend.legs().len() == 2);
//!
//! let mut few = ImageNodes::new(Params { nodes_max: 2, ..Params::default() });
//! let refusal = few.run(&graph, &mask, &rays, None).unwrap_err().to_string();
//! assert!(refusal.starts_with("the picture has more than 2 end points, junctions and bends"));
//! # Ok::<(), graph::Refusal>(())
//! ```

use nalgebra::Vector2;

use crate::pose::section::mask_run;
use crate::rig::{CameraModel, UndistortTable};
use crate::time::Timestamp;
use crate::vision::bits::{BitImage, vector};
use crate::vision::graph::{Graph, NONE, NodeKind, Refusal};

/// Most directions kept of one node.
pub const LEGS_MAX: usize = 5;

/// What a node of a picture is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum NodeRole {
    /// A wire ends here.
    End,
    /// Wires meet or cross here.
    Junction,
    /// A wire changes its direction here.
    Bend,
}

/// A piece of wire that leaves a node.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Leg {
    /// Unit vector away from the node, in pixels.
    pub direction_px: Vector2<f64>,
    /// A point on the leg well away from the node, in normalised image coordinates.
    pub far_ray: Vector2<f64>,
    /// A point on the leg near the node, in normalised image coordinates.
    pub near_ray: Vector2<f64>,
}

/// A node of one picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageNode {
    /// What it is.
    pub role: NodeRole,
    /// Its place in pixels of the camera (distorted).
    pub position_px: Vector2<f64>,
    /// Its place in normalised image coordinates (undistorted).
    pub ray: Vector2<f64>,
    /// Half the thickness of the wire here, in pixels; 0 where unknown.
    pub half_thickness_px: f64,
    /// Whether the wire's end is seen against the background (ends only).
    pub end_visible: bool,
    legs: [Leg; LEGS_MAX],
    leg_count: u8,
}

impl ImageNode {
    /// The wire that leaves the node.
    pub fn legs(&self) -> &[Leg] {
        &self.legs[..self.leg_count as usize]
    }

    pub(super) fn push_leg(&mut self, leg: Leg) {
        if (self.leg_count as usize) < LEGS_MAX {
            self.legs[self.leg_count as usize] = leg;
            self.leg_count += 1;
        }
    }
}

impl ImageNode {
    /// A node without wire, for scenes that are drawn.
    pub fn bare(role: NodeRole, position_px: Vector2<f64>, camera: &CameraModel) -> Self {
        Self {
            role,
            position_px,
            ray: camera.undistort(position_px),
            half_thickness_px: 0.0,
            end_visible: role == NodeRole::End,
            legs: Default::default(),
            leg_count: 0,
        }
    }
}

/// Once in so many edges it is asked how late it is.
const CLOCK_STRIDE: usize = 8;

/// How bends are found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params {
    /// A bend turns by at least this many radians.
    pub bend_angle_rad_min: f64,
    /// Length over which a direction is measured, in half thicknesses.
    pub reach_half_thicknesses: f64,
    /// Most image nodes of a picture, bends too.
    pub nodes_max: usize,
}

impl Default for Params {
    fn default() -> Self {
        Self { bend_angle_rad_min: 25f64.to_radians(), reach_half_thicknesses: 5.0, nodes_max: 4096 }
    }
}

/// Workspace that lists the image nodes of one picture.
#[derive(Clone, Debug)]
pub struct ImageNodes {
    params: Params,
    nodes: Vec<ImageNode>,
    bends: Vec<(usize, Vector2<f64>)>,
}

impl ImageNodes {
    /// Reserves all memory.
    pub fn new(params: Params) -> Self {
        Self { params, nodes: Vec::with_capacity(params.nodes_max), bends: Vec::with_capacity(64) }
    }

    /// The nodes found by the last [`ImageNodes::run`].
    pub fn nodes(&self) -> &[ImageNode] {
        &self.nodes
    }

    /// Has no nodes any more.
    pub fn clear(&mut self) {
        self.nodes.clear();
    }

    /// Lists the nodes of `graph`, bends last; `rays` of the camera that it was seen with. Is broken off at `end`; says
    /// whether it was not.
    ///
    /// # Errors
    /// Where there are more than `nodes_max`, bends too.
    pub fn run(
        &mut self,
        graph: &Graph,
        mask: &BitImage,
        rays: &UndistortTable,
        end: Option<Timestamp>,
    ) -> Result<bool, Refusal> {
        self.clear();
        let too_many = Refusal::TooManyImageNodes { nodes_max: self.params.nodes_max as u32 };
        if graph.nodes.len() > self.params.nodes_max {
            return Err(too_many);
        }
        for node in &graph.nodes {
            let position_px = vector(node.position_px);
            self.nodes.push(ImageNode {
                role: match node.kind {
                    NodeKind::End => NodeRole::End,
                    NodeKind::Junction => NodeRole::Junction,
                },
                position_px,
                ray: rays.undistort(position_px),
                half_thickness_px: node.half_thickness_px as f64,
                end_visible: node.end_visible,
                legs: Default::default(),
                leg_count: 0,
            });
        }
        for (e, edge) in graph.edges.iter().enumerate() {
            if e.is_multiple_of(CLOCK_STRIDE) && end.is_some_and(Timestamp::is_past) {
                return Ok(false);
            }
            let chain = &graph.points[edge.points.start as usize..edge.points.end as usize];
            let reach = self.reach_px(edge.half_thickness_px as f64);
            if chain.len() < 4 {
                continue;
            }
            self.find_bends(chain, reach);
            if self.nodes.len() + self.bends.len() > self.params.nodes_max {
                return Err(too_many);
            }
            self.add_chain(edge.nodes, chain, reach, edge.half_thickness_px as f64, mask, rays);
        }
        Ok(true)
    }

    fn reach_px(&self, half_thickness_px: f64) -> f64 {
        (self.params.reach_half_thicknesses * half_thickness_px).clamp(6.0, 24.0)
    }

    /// Fills `bends` with the chain indices of the sharpest turns and the place where the pieces' lines meet.
    fn find_bends(&mut self, chain: &[[u16; 2]], reach: f64) {
        self.bends.clear();
        let arm = reach as usize;
        if chain.len() < 2 * arm + 1 {
            return;
        }
        let around = |i: usize| {
            let (a, b, c) = (vector(chain[i - arm]), vector(chain[i]), vector(chain[i + arm]));
            (b - a, c - b)
        };
        let turn_at = |i: usize| {
            let (before, after) = around(i);
            angle_between(before, after)
        };
        let (sin, cos) = self.params.bend_angle_rad_min.sin_cos();
        let mut i = arm;
        while i + arm < chain.len() {
            // The sine of the angle by which the turn is more than the least.
            let (before, after) = around(i);
            if before.perp(&after).abs() * cos < before.dot(&after) * sin {
                i += 1;
                continue;
            }
            // The middle of the stretch that turns, weighted by how much it turns.
            let (mut weight, mut sum, begin) = (0.0, 0.0, i);
            while i + arm < chain.len() && i - begin <= 2 * arm {
                let turn = turn_at(i);
                if turn < 0.6 * self.params.bend_angle_rad_min {
                    break;
                }
                let w = turn.powi(2);
                weight += w;
                sum += w * i as f64;
                i += 1;
            }
            let middle = ((sum / weight).round() as usize).clamp(arm, chain.len() - 1 - arm);
            if let Some(corner) = corner_of(chain, middle, arm)
                && self.bends.len() < self.bends.capacity()
            {
                self.bends.push((middle, corner));
            }
            i += arm;
        }
    }

    fn add_chain(
        &mut self,
        ends: [u32; 2],
        chain: &[[u16; 2]],
        reach: f64,
        half_thickness_px: f64,
        mask: &BitImage,
        rays: &UndistortTable,
    ) {
        let last = chain.len() - 1;
        let first_bend = self.bends.first().map_or(last, |b| b.0);
        let last_bend = self.bends.last().map_or(0, |b| b.0);
        let leg = |from: usize, to: usize| leg_of(chain, from, to, reach, half_thickness_px, mask, rays);
        let mut additions = [(usize::MAX, Leg::default()); 2];
        if ends[0] != NONE {
            additions[0] = (ends[0] as usize, leg(0, first_bend));
            additions[1] = (ends[1] as usize, leg(last, last_bend));
        }
        for (n, leg) in additions {
            if let Some(node) = self.nodes.get_mut(n) {
                node.push_leg(leg);
            }
        }
        for k in 0..self.bends.len() {
            let (at, corner) = self.bends[k];
            let before = if k == 0 { 0 } else { self.bends[k - 1].0 };
            let after = self.bends.get(k + 1).map_or(last, |b| b.0);
            let mut node = ImageNode {
                role: NodeRole::Bend,
                position_px: corner,
                ray: rays.undistort(corner),
                half_thickness_px,
                end_visible: false,
                legs: Default::default(),
                leg_count: 0,
            };
            node.push_leg(leg(at, before));
            node.push_leg(leg(at, after));
            self.nodes.push(node);
        }
    }
}

fn angle_between(a: Vector2<f64>, b: Vector2<f64>) -> f64 {
    a.perp(&b).abs().atan2(a.dot(&b))
}

/// The mean of up to `2 * spread + 1` chain points around `at`.
fn smoothed(chain: &[[u16; 2]], at: usize, spread: usize) -> Vector2<f64> {
    let begin = at.saturating_sub(spread);
    let end = (at + spread + 1).min(chain.len());
    chain[begin..end].iter().map(|&p| vector(p)).sum::<Vector2<f64>>() / (end - begin) as f64
}

/// Where the lines through the straight pieces on both sides of a bend meet; `None` where they are parallel or
/// meet far from the bend.
fn corner_of(chain: &[[u16; 2]], middle: usize, arm: usize) -> Option<Vector2<f64>> {
    let near = arm / 2;
    let far_before = middle.saturating_sub(3 * arm);
    let far_after = (middle + 3 * arm).min(chain.len() - 1);
    let (a0, a1) = (smoothed(chain, far_before, 1), smoothed(chain, middle - near, 1));
    let (b0, b1) = (smoothed(chain, far_after, 1), smoothed(chain, middle + near, 1));
    let (da, db) = (a1 - a0, b1 - b0);
    let cross = da.perp(&db);
    if cross.abs() < 0.2 * da.norm() * db.norm() {
        return None;
    }
    let corner = a0 + da * ((b0 - a0).perp(&db) / cross);
    ((corner - vector(chain[middle])).norm() < arm as f64).then_some(corner)
}

/// The leg that leaves chain point `from` towards chain point `to`.
fn leg_of(
    chain: &[[u16; 2]],
    from: usize,
    to: usize,
    reach: f64,
    half_thickness_px: f64,
    mask: &BitImage,
    rays: &UndistortTable,
) -> Leg {
    let span = from.abs_diff(to);
    let skip = ((1.2 * half_thickness_px).round() as usize).min(span / 3);
    let far = ((3.0 * reach) as usize).min(span.saturating_sub(skip).max(skip + 1).min(span));
    let at = |k: usize| if to > from { from + k } else { from - k };
    let (near_px, mut far_px) = (smoothed(chain, at(skip), 1), smoothed(chain, at(far), 1));
    if (far_px - near_px).norm() < TRACK_PX_MIN {
        far_px = track(mask, near_px, far_px, half_thickness_px);
    }
    let direction = far_px - near_px;
    let norm = direction.norm();
    Leg {
        direction_px: if norm > 1e-9 { direction / norm } else { Vector2::zeros() },
        far_ray: rays.undistort(far_px),
        near_ray: rays.undistort(near_px),
    }
}

/// Legs shorter than this are followed beyond their chain.
const TRACK_PX_MIN: f64 = 60.0;
/// How far they are followed.
const TRACK_PX_MAX: f64 = 90.0;

/// Steps in which thick wire is followed.
const TRACK_STEP_PX_MAX: f64 = 12.0;

/// Follows the wire in the mask from `near` over `far` straight on, through crossings, where its width is not that of
/// one wire and nothing is learnt; gives the farthest middle of it.
fn track(mask: &BitImage, near: Vector2<f64>, far: Vector2<f64>, half_thickness_px: f64) -> Vector2<f64> {
    let mut last = far;
    // Nearer than a thickness the outlines err alike.
    let step = (2.0 * half_thickness_px).clamp(2.0, TRACK_STEP_PX_MAX);
    let widest_px = 2.8 * half_thickness_px + 1.5;
    let mut distance = (far - near).norm() + step;
    while distance < TRACK_PX_MAX {
        let Some(direction) = (last - near).try_normalize(1e-9) else { break };
        let across = Vector2::new(-direction.y, direction.x);
        let run = mask_run(mask, near + direction * distance, across, 2.0, widest_px);
        let Some((middle, width)) = run else { break };
        if width < widest_px && middle.abs() < half_thickness_px {
            last = near + direction * distance + across * middle;
        }
        distance += step;
    }
    last
}
