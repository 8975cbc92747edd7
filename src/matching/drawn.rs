//! Drawn scenes: parts of known pose as image nodes and masks, for examples, tests and benches of the searches.

use nalgebra::{Isometry3, Point3, Rotation3, Translation3, UnitQuaternion, Vector2, Vector3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;

use super::candidates::Candidates;
use super::fitness::{Judge, Weights};
use super::gate::{Gate, GateParams};
use super::nodes::{ImageNode, NodeRole};
use super::problem::{Anchor, MatchModel, Span, WirePiece};
use crate::level::Level;
use crate::rig::{CameraModel, Rig};
use crate::vision::bits::BitImage;

/// A scene of equal parts, each a chain of straight pieces, with all that the searches take.
#[derive(Clone, Debug)]
pub struct DrawnScene {
    /// Two cameras, 60 mm apart, 640x480, with some distortion.
    pub rig: Rig,
    /// What the wires leave on the left and right picture.
    pub masks: [BitImage; 2],
    /// The part.
    pub model: MatchModel,
    /// Nodes of the left and the right picture, in no order.
    pub nodes: [Vec<ImageNode>; 2],
    /// The poses of the parts.
    pub left_from_part: Vec<Isometry3<f64>>,
    /// The closed gate, already run.
    pub gate: Gate,
    /// What it let through.
    pub candidates: Candidates,
}

/// Noise of a node in pixels, as the end points of the scenes have it.
const NOISE_PX: f64 = 0.3;

impl DrawnScene {
    /// `parts` parts of `anchors` nodes each (2 to 32) at random poses; `seed` draws them.
    pub fn new(anchors: usize, parts: usize, seed: u64) -> Self {
        Self::of(chain(anchors), parts, seed)
    }

    /// The same of a part that is not larger.
    pub fn of(model: MatchModel, parts: usize, seed: u64) -> Self {
        let mut random = Pcg32::seed_from_u64(seed);
        let mut left = CameraModel::pinhole(640, 480, 600.0, 320.0, 240.0);
        left.distortion[..2].copy_from_slice(&[-0.08, 0.02]);
        let tilt = UnitQuaternion::from_euler_angles(0.0, 0.06, 0.004);
        let right_from_left = Isometry3::from_parts(Translation3::new(-60.0, 0.4, 2.0), tilt);
        let rig = Rig { left, right: left, right_from_left };
        let mut scene = Self {
            rig,
            masks: [BitImage::new(640, 480), BitImage::new(640, 480)],
            nodes: Default::default(),
            left_from_part: Vec::new(),
            gate: Gate::new(GateParams::default()),
            candidates: Candidates::new(GateParams::default().nodes_max),
            model,
        };
        while scene.left_from_part.len() < parts {
            let place = Vector3::new(
                random.random_range(-170.0..170.0),
                random.random_range(-120.0..120.0),
                random.random_range(480.0..520.0),
            );
            let flat = Rotation3::from_axis_angle(&Vector3::z_axis(), random.random_range(0.0..6.3));
            let tilt = Rotation3::from_axis_angle(&Vector3::x_axis(), random.random_range(-0.3..0.3));
            let pose = Isometry3::from_parts(place.into(), (tilt * flat).into());
            scene.place(pose, &mut random);
        }
        for side in 0..2 {
            let nodes = &mut scene.nodes[side];
            for i in (1..nodes.len()).rev() {
                nodes.swap(i, random.random_range(0..=i as u32) as usize);
            }
        }
        let [l, r] = &scene.nodes;
        scene.gate.run(&scene.rig, l, r, [0.0, 1e9]);
        scene.candidates.fill(&scene.rig.geometry(), scene.gate.nodes(), l, r, true);
        scene
    }

    /// Puts a part there, if both cameras see it.
    fn place(&mut self, pose: Isometry3<f64>, random: &mut Pcg32) {
        let cameras = [self.rig.left, self.rig.right];
        let project = |side: usize, p: &Point3<f64>| {
            if side == 0 { self.rig.project_left(p) } else { self.rig.project_right(p) }
        };
        let points: Vec<Point3<f64>> = self.model.anchors.iter().map(|a| pose * a.position_mm).collect();
        let seen: Option<Vec<[Vector2<f64>; 2]>> =
            points.iter().map(|p| Some([project(0, p)?, project(1, p)?])).collect();
        let Some(seen) = seen else { return };
        if !seen.iter().flatten().all(|px| cameras[0].sees(*px, 12.0)) {
            return;
        }
        for span in self.model.pieces() {
            for step in 0..=400 {
                let at = points[span.from] + (points[span.to] - points[span.from]) * (step as f64 / 400.0);
                for side in 0..2 {
                    if let Some(px) = project(side, &at) {
                        blot(&mut self.masks[side], px);
                    }
                }
            }
        }
        for (anchor, seen) in self.model.anchors.iter().zip(seen) {
            for side in 0..2 {
                let mut noise = || random.random_range(-NOISE_PX..NOISE_PX);
                let px = seen[side] + Vector2::new(noise(), noise());
                self.nodes[side].push(ImageNode::bare(anchor.role, px, &cameras[side]));
            }
        }
        self.left_from_part.push(pose);
    }

    /// What matches of this scene are judged by.
    pub fn judge(&self) -> Judge<'_> {
        Judge {
            rig: &self.rig,
            masks: [&self.masks[0], &self.masks[1]],
            model: &self.model,
            weights: Weights::default(),
            length_tolerance_mm: 6.0,
            level: Level::detect(),
        }
    }
}

/// Wire 5 pixels thick about here.
fn blot(mask: &mut BitImage, px: Vector2<f64>) {
    let (cx, cy) = (px.x.round() as i32, px.y.round() as i32);
    for y in cy - 2..=cy + 2 {
        for x in cx - 2..=cx + 2 {
            if x >= 0 && y >= 0 && (x as usize) < mask.width() && (y as usize) < mask.height() {
                mask.set(x as usize, y as usize, true);
            }
        }
    }
}

/// A flat chain of straight pieces of different lengths about its middle, like a spring steel hook: a rod of 90 mm
/// for two nodes.
fn chain(nodes: usize) -> MatchModel {
    let (mut at, mut heading) = (Point3::origin(), 0.0f64);
    let mut points = vec![at];
    for k in 1..nodes {
        let length = if nodes == 2 { 90.0 } else { 22.0 + 7.0 * ((k * 5) % 4) as f64 };
        at += Vector3::new(heading.cos(), heading.sin(), 0.0) * length;
        points.push(at);
        heading += [1.2, -0.9, -1.4, 1.0, 0.7][k % 5];
    }
    let middle = points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / nodes as f64;
    points.iter_mut().for_each(|p| *p -= middle);
    let end = |k: usize| k == 0 || k + 1 == nodes;
    let anchors = points.iter().enumerate().map(|(k, p)| Anchor {
        role: if end(k) { NodeRole::End } else { NodeRole::Bend },
        position_mm: *p,
        legs: Vec::new(),
        is_repeated: false,
        corners: Vec::new(),
    });
    let spans = points.windows(2).enumerate().map(|(k, w)| Span::new(k, k + 1, (w[1] - w[0]).norm()));
    let (anchors, spans): (Vec<_>, Vec<_>) = (anchors.collect(), spans.collect());
    MatchModel {
        wire: WirePiece::of_spans(&anchors, &spans),
        smooth: false,
        anchors,
        spans,
        distances_mm: points.iter().flat_map(|a| points.iter().map(move |b| (a - b).norm())).collect(),
        thickness_mm: 2.5,
        straight: nodes == 2,
        turned: None,
    }
}
