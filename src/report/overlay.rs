//! The result on top of both pictures, as the paper's figures 9 and 10.
//!
//! | what | how |
//! |---|---|
//! | skeleton, nodes | thin, grey-green; ends are small rings, junctions small discs |
//! | segments between matched nodes | blue, along the wire; thinner where the part cannot be picked |
//! | fitness | red, behind the part's rank |
//! | grasp | where the tool comes down: closing direction of the fingers red, wire green, approach yellow |
//!
//! ```
//! use pickcell::part::Part;
//! use pickcell::recognize::{Params, Recognition, Recognizer};
//! use pickcell::report::overlay::Overlay;
//! use pickcell::session::Session;
//! use pickcell::{frame::FramePair, rig::Rig, time::Budget};
//!
//! let replay = std::path::Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/replay"));
//! let rig = Rig::read(replay.join("conveyor/calibration.yaml"))?;
//! let parts = [Part::read(replay.join("parts/rod-90.toml"))?];
//! let mut recognizer = Recognizer::new(Params::default(), rig, parts.to_vec())?;
//! let session = Session::open(&replay.join("conveyor"))?;
//! let [Some(left), Some(right)] = &session.pairs[0].pictures else { panic!("a whole pair") };
//! let pair = FramePair { left: left.read_raw()?, right: right.read_raw()? };
//! let mut found = Recognition::default();
//! recognizer.run(&pair, Budget::Iterations(20_000), 1, &mut found)?;
//!
//! let [left, right] = recognizer.pictures();
//! let overlay = Overlay {
//!     frames: [&pair.left, &pair.right],
//!     graphs: [left, right].map(|picture| (picture.graph(), picture.halvings())),
//!     rig: recognizer.rig(),
//!     parts: &parts,
//!     found: &found.parts,
//!     base_from_left: Default::default(),
//!     caption: "",
//! };
//! let (with, without) = (overlay.draw(), Overlay { found: &[], ..overlay }.draw());
//! // Blue along the wire: the pixel at a recognised end has changed.
//! let end = found.parts[0].nodes[0].left_px;
//! let [x, y] = [end.x.round() as usize, end.y.round() as usize];
//! assert_ne!(with.pixel(x, y), without.pixel(x, y));
//! assert!(with.to_png()?.starts_with(b"\x89PNG"));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use nalgebra::{Isometry3, Point3, Vector2, Vector3};

use super::canvas::{Canvas, Colour};
use crate::frame::Frame;
use crate::part::Part;
use crate::recognize::FoundPart;
use crate::rig::Rig;
use crate::vision::graph::{Graph, NodeKind};
use crate::vision::halve::in_whole;

const SKELETON: Colour = [70, 160, 90];
const END: Colour = [255, 220, 0];
const JUNCTION: Colour = [255, 120, 0];
const SEGMENT: Colour = [30, 90, 255];
const SEGMENT_BLOCKED: Colour = [70, 110, 230];
const FITNESS: Colour = [255, 60, 60];
const CLOSING: Colour = [255, 60, 60];
const WIRE: Colour = [60, 230, 90];
const APPROACH: Colour = [255, 235, 60];
const TEXT: Colour = [255, 255, 255];

/// Length of the grasp's axes in mm.
const AXIS_MM: f64 = 10.0;
/// Distance of the points by which wires are drawn, in mm.
const STEP_MM: f64 = 1.0;
/// Columns between the two pictures.
const GAP_PX: usize = 4;

/// All that an overlay shows.
#[derive(Clone, Copy)]
pub struct Overlay<'a> {
    /// Uncompressed pictures, left and right.
    pub frames: [&'a Frame; 2],
    /// Their graphs, and how often the pictures were halved for them.
    pub graphs: [(&'a Graph, usize); 2],
    /// The cameras.
    pub rig: &'a Rig,
    /// The models that [`FoundPart::part`] counts.
    pub parts: &'a [Part],
    /// What was recognised, best first.
    pub found: &'a [FoundPart],
    /// Where grasps are given in the robot's base: its pose. Else the identity.
    pub base_from_left: Isometry3<f64>,
    /// A line below: why there is no pick, say. Empty: none.
    pub caption: &'a str,
}

impl Overlay<'_> {
    /// Draws both pictures side by side.
    pub fn draw(&self) -> Canvas {
        let [left, right] = self.frames;
        let mut canvas = Canvas::new(left.width + GAP_PX + right.width, left.height.max(right.height));
        let offsets = [0, left.width + GAP_PX];
        for (side, offset_px) in offsets.into_iter().enumerate() {
            let offset = Vector2::new(offset_px as f64, 0.0);
            canvas.put_frame(self.frames[side], offset_px);
            graph(&mut canvas, self.graphs[side], offset);
            let view = View { side, offset, overlay: self };
            let labels = view.label_places(&canvas);
            // the best on top
            for (i, found) in self.found.iter().enumerate().rev() {
                view.part(&mut canvas, found);
                view.grasp(&mut canvas, found);
                if let Some(at) = labels[i] {
                    canvas.text(at, &label(i + 1, found), label_scale(&canvas), FITNESS);
                }
            }
        }
        if !self.caption.is_empty() {
            let low = canvas.height() as f64 - 20.0;
            canvas.text(Vector2::new(4.0, low), self.caption, 2, TEXT);
        }
        canvas
    }
}

/// Skeleton and nodes, thin.
fn graph(canvas: &mut Canvas, (graph, halvings): (&Graph, usize), offset: Vector2<f64>) {
    let pixel = 1i64 << halvings;
    for &[x, y] in &graph.points {
        let [x, y] = [i64::from(x) * pixel + offset.x as i64, i64::from(y) * pixel];
        for (i, j) in (0..pixel).flat_map(|i| (0..pixel).map(move |j| (i, j))) {
            canvas.blend(x + i, y + j, SKELETON, 0.8);
        }
    }
    for node in &graph.nodes {
        let at = in_whole(Vector2::from(node.position_px.map(f64::from)), halvings) + offset;
        match node.kind {
            NodeKind::End => canvas.ring(at, 2.5, END),
            NodeKind::Junction => canvas.disc(at, 1.5, JUNCTION),
        }
    }
}

/// One camera's picture on the canvas.
struct View<'a> {
    side: usize,
    offset: Vector2<f64>,
    overlay: &'a Overlay<'a>,
}

impl View<'_> {
    fn project(&self, point_left_mm: &Point3<f64>) -> Option<Vector2<f64>> {
        let rig = self.overlay.rig;
        let (px, camera) = match self.side {
            0 => (rig.project_left(point_left_mm)?, &rig.left),
            _ => (rig.project_right(point_left_mm)?, &rig.right),
        };
        camera.sees(px, -0.5).then_some(px + self.offset)
    }

    fn line(&self, canvas: &mut Canvas, from: Point3<f64>, to: Point3<f64>, width: f64, colour: Colour) {
        if let (Some(from), Some(to)) = (self.project(&from), self.project(&to)) {
            canvas.line(from, to, width, colour);
        }
    }

    /// The segments between the nodes, along the wire.
    fn part(&self, canvas: &mut Canvas, found: &FoundPart) {
        let Some(part) = self.overlay.parts.get(found.part) else { return };
        let (colour, width) = if found.blocked.is_some() { (SEGMENT_BLOCKED, 1.0) } else { (SEGMENT, 2.0) };
        for edge in 0..part.edges.len() {
            for pair in part.centreline(edge, STEP_MM).windows(2) {
                let [from, to] = [0, 1].map(|i| found.left_from_part * pair[i].position_mm);
                self.line(canvas, from, to, width, colour);
            }
        }
        for node in &found.nodes {
            if let Some(px) = self.project(&node.left_mm) {
                canvas.ring(px, 4.0, colour);
            }
        }
    }

    fn grasp(&self, canvas: &mut Canvas, found: &FoundPart) {
        let left_from_base = self.overlay.base_from_left.inverse();
        let grasp = &found.grasp;
        let at = left_from_base * grasp.position_mm;
        let axis = |unit: Vector3<f64>| left_from_base * (grasp.orientation * unit);
        if found.blocked.is_some() {
            if let Some(px) = self.project(&at) {
                canvas.ring(px, 3.0, SEGMENT_BLOCKED);
            }
            return;
        }
        // the fingers: from outside to where they stand before they close
        let closing = axis(Vector3::x());
        let half = 0.5 * grasp.opening_mm;
        for side in [-1.0, 1.0] {
            let finger = at + closing * (side * half);
            self.line(canvas, finger, finger + closing * (side * 0.5 * AXIS_MM), 2.0, CLOSING);
            let wire = axis(Vector3::y()) * 3.0;
            self.line(canvas, finger - wire, finger + wire, 2.0, CLOSING);
        }
        self.line(canvas, at, at + axis(Vector3::y()) * AXIS_MM, 2.0, WIRE);
        self.line(canvas, at, at - axis(Vector3::z()) * AXIS_MM, 2.0, APPROACH);
        if let Some(px) = self.project(&at) {
            canvas.disc(px, 2.5, APPROACH);
        }
    }

    /// Where rank and fitness of each part stand: beside its grasp, or as far below that as there is no other's. The best have
    /// the first choice.
    fn label_places(&self, canvas: &Canvas) -> Vec<Option<Vector2<f64>>> {
        let mut taken: Vec<(Vector2<f64>, Vector2<f64>)> = Vec::new();
        let place = |(i, found): (usize, &FoundPart)| {
            let at = self.overlay.base_from_left.inverse() * found.grasp.position_mm;
            let size = Canvas::text_size(&label(i + 1, found), label_scale(canvas));
            let beside = self.project(&at)? + Vector2::new(9.0, -13.0);
            let is_free = |at: &Vector2<f64>| !taken.iter().any(|other| overlap(&(*at, size), other));
            let below = (0..LABELS_ASIDE_MAX).map(|k| beside + Vector2::new(0.0, k as f64 * size.y));
            let free = below.into_iter().find(is_free).unwrap_or(beside);
            taken.push((free, size));
            Some(free)
        };
        self.overlay.found.iter().enumerate().map(place).collect()
    }
}

/// A label goes at most so many of its heights down to lie on no other.
const LABELS_ASIDE_MAX: usize = 4;

/// Rank and fitness.
fn label(rank: usize, found: &FoundPart) -> String {
    format!("{rank}: {:.3}", found.fitness)
}

fn label_scale(canvas: &Canvas) -> usize {
    if canvas.width() > 2000 { 3 } else { 1 }
}

/// Whether two boxes, each its upper left corner and size, share anything.
fn overlap(a: &(Vector2<f64>, Vector2<f64>), b: &(Vector2<f64>, Vector2<f64>)) -> bool {
    [0, 1].into_iter().all(|k| a.0[k] < b.0[k] + b.1[k] && b.0[k] < a.0[k] + a.1[k])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_overlap_where_they_share_a_place() {
        let at = |x: f64, y: f64| (Vector2::new(x, y), Vector2::new(40.0, 10.0));
        assert!(overlap(&at(0.0, 0.0), &at(39.0, -9.0)) && overlap(&at(0.0, 0.0), &at(0.0, 0.0)));
        assert!(!overlap(&at(0.0, 0.0), &at(40.0, 0.0)) && !overlap(&at(0.0, 0.0), &at(3.0, 10.0)));
    }
}
