//! The result on top of both pictures, as the paper's figures 9 and 10.
//!
//! | what | how |
//! |---|---|
//! | skeleton, nodes | thin, grey-green; ends are small rings, junctions small discs |
//! | segments between matched nodes | blue, along the wire; thinner where the part cannot be picked |
//! | fitness | red, behind the part's rank and, where there are several kinds, its name |
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
use super::places::{Places, scale_of};
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
            let scale = scale_of(self.frames[side].width);
            graph(&mut canvas, self.graphs[side], offset, scale as f64);
            let view = View { side, offset, scale, overlay: self };
            // the best on top
            for found in self.found.iter().rev() {
                view.part(&mut canvas, found);
                view.grasp(&mut canvas, found);
            }
            view.labels(&mut canvas);
        }
        if !self.caption.is_empty() {
            let scale = 2 * scale_of(left.width);
            let low = (canvas.height() - (10 * scale).min(canvas.height())) as f64;
            canvas.text(Vector2::new(4.0, low), self.caption, scale, TEXT);
        }
        canvas
    }
}

/// Skeleton and nodes, thin.
fn graph(canvas: &mut Canvas, (graph, halvings): (&Graph, usize), offset: Vector2<f64>, wide: f64) {
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
            NodeKind::End => canvas.ring(at, 2.5 * wide, 1.5 * wide, END),
            NodeKind::Junction => canvas.disc(at, 1.5 * wide, JUNCTION),
        }
    }
}

/// One camera's picture on the canvas.
struct View<'a> {
    side: usize,
    offset: Vector2<f64>,
    /// See [`scale_of`].
    scale: usize,
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
            canvas.line(from, to, width * self.scale as f64, colour);
        }
    }

    fn ring(&self, canvas: &mut Canvas, at: Vector2<f64>, radius: f64, colour: Colour) {
        let wide = self.scale as f64;
        canvas.ring(at, radius * wide, 1.5 * wide, colour);
    }

    /// The segments between the nodes, along the wire.
    fn part(&self, canvas: &mut Canvas, found: &FoundPart) {
        let (colour, width) = if found.blocked.is_some() { (SEGMENT_BLOCKED, 1.0) } else { (SEGMENT, 2.0) };
        for [from, to] in self.wire(found).flatten() {
            self.line(canvas, from, to, width, colour);
        }
        for node in &found.nodes {
            if let Some(px) = self.project(&node.left_mm) {
                self.ring(canvas, px, 4.0, colour);
            }
        }
    }

    /// Short pieces of a part's wire, edge by edge.
    fn wire(&self, found: &FoundPart) -> impl Iterator<Item = Vec<[Point3<f64>; 2]>> {
        let part = self.overlay.parts.get(found.part);
        let edges = part
            .into_iter()
            .flat_map(|part| (0..part.edges.len()).map(move |edge| part.centreline(edge, STEP_MM)));
        edges.map(|points| {
            let pieces = points.windows(2);
            pieces.map(|pair| [0, 1].map(|i| found.left_from_part * pair[i].position_mm)).collect()
        })
    }

    fn grasp(&self, canvas: &mut Canvas, found: &FoundPart) {
        let left_from_base = self.overlay.base_from_left.inverse();
        let at = left_from_base * found.grasp.position_mm;
        let axis = |unit: Vector3<f64>| left_from_base * (found.grasp.orientation * unit);
        if found.blocked.is_some() {
            if let Some(px) = self.project(&at) {
                self.ring(canvas, px, 3.0, SEGMENT_BLOCKED);
            }
            return;
        }
        for [from, to] in self.fingers(found).into_iter().flatten() {
            self.line(canvas, from, to, 2.0, CLOSING);
        }
        self.line(canvas, at, at + axis(Vector3::y()) * AXIS_MM, 2.0, WIRE);
        self.line(canvas, at, at - axis(Vector3::z()) * AXIS_MM, 2.0, APPROACH);
        if let Some(px) = self.project(&at) {
            canvas.disc(px, 2.5 * self.scale as f64, APPROACH);
        }
    }

    /// The marks of both fingers, each two lines: from outside to where it stands before they close, and its breadth.
    fn fingers(&self, found: &FoundPart) -> [[[Point3<f64>; 2]; 2]; 2] {
        let left_from_base = self.overlay.base_from_left.inverse();
        let axis = |unit: Vector3<f64>| left_from_base * (found.grasp.orientation * unit);
        let (closing, wire) = (axis(Vector3::x()), axis(Vector3::y()) * 3.0);
        [-1.0, 1.0].map(|side| {
            let finger =
                left_from_base * found.grasp.position_mm + closing * (side * 0.5 * found.grasp.opening_mm);
            [[finger, finger + closing * (side * 0.5 * AXIS_MM)], [finger - wire, finger + wire]]
        })
    }

    /// Rank and fitness of each part, beside its grasp and on no finger. The best have the first choice.
    fn labels(&self, canvas: &mut Canvas) {
        let frame = self.overlay.frames[self.side];
        let size = Vector2::new(frame.width as f64, frame.height as f64);
        let mut places = Places::new(self.offset, self.offset + size);
        for found in self.overlay.found.iter().filter(|found| found.blocked.is_none()) {
            for [from, to] in self.fingers(found).into_iter().flatten() {
                if let (Some(from), Some(to)) = (self.project(&from), self.project(&to)) {
                    places.take(from.inf(&to).add_scalar(-1.0), from.sup(&to).add_scalar(1.0));
                }
            }
        }
        for found in self.overlay.found {
            self.wire(found)
                .flatten()
                .filter_map(|[from, _]| self.project(&from))
                .for_each(|px| places.show(px));
        }
        let left_from_base = self.overlay.base_from_left.inverse();
        for (i, found) in self.overlay.found.iter().enumerate() {
            let Some(at) = self.project(&(left_from_base * found.grasp.position_mm)) else { continue };
            let name = self.overlay.parts.get(found.part).filter(|_| self.overlay.parts.len() > 1);
            let name = name.map(|part| format!(" {}", part.name)).unwrap_or_default();
            let label = format!("{}{name}: {:.3}", i + 1, found.fitness);
            let gap = Vector2::new(9.0, 13.0) * self.scale as f64;
            // A blank behind it keeps the next one apart.
            let size = Canvas::text_size(&(label.clone() + " "), self.scale);
            let corner = places.beside(at, gap, size);
            canvas.text(corner, &label, self.scale, FITNESS);
        }
    }
}
