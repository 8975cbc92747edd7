//! Part files, as written to checked.

use std::path::{Path, PathBuf};

use firmware_bridge::config::{exactly, read_toml};
use firmware_bridge::outside::read_text;
use nalgebra::{Point3, Unit, Vector3};
use serde::Deserialize;

use super::centreline::{CentrelinePoint, bend_radius_max_mm};
use super::{
    ANCHORS_MAX, BEND_RADIUS_PER_THICKNESS, EDGES_MAX, NODES_MAX, NodeKind, Part, PartEdge, PartError,
    PartGrasp, PartNode,
};

/// Parts are thin things on a table; a coordinate beyond this is a slip of units.
const COORDINATE_MAX_MM: f64 = 10_000.0;
/// Thinner wire is a slip of units.
const THICKNESS_MIN_MM: f64 = 0.05;
/// Points of a few digits are believed to leave room for a bend.
const BEND_FITS: f64 = 1.001;
/// Of more wire not all would be looked at: it has a station a thickness and up to one more an edge, and there is room for
/// 1024 of a part.
const LENGTH_THICKNESSES_MAX: f64 = 900.0;
/// Approach and closing may be off the right angle by 1 degree (rounded digits); it is taken out.
const SQUARE_TOLERANCE: f64 = 0.018;

/// So many degrees may the direction of the wire that a grasp says be off (rounded digits, a wire that is a little bent) where the
/// wire has one direction, and so many near a bend or a junction, where it has several.
const ASKEW_DEG_MAX: f64 = 5.0;
const ASKEW_AT_BEND_DEG_MAX: f64 = 45.0;
/// A grasp may be so far beyond the wire's end (rounded digits), mm.
const BEYOND_MM_MAX: f64 = 0.01;

/// Wire along which a grasp may slide strays from a straight line by less than this share of its thickness.
const STRAIGHT_SHARE: f64 = 0.02;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FileText {
    name: String,
    thickness_mm: f64,
    bend_radius_mm: Option<f64>,
    #[serde(default)]
    node: Vec<NodeText>,
    #[serde(default)]
    edge: Vec<EdgeText>,
    grasp: GraspText,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct NodeText {
    name: String,
    #[serde(deserialize_with = "exactly")]
    position_mm: [f64; 3],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct EdgeText {
    from: String,
    to: String,
    #[serde(default)]
    via: Vec<Triple>,
}

#[derive(Clone, Copy, Deserialize)]
struct Triple(#[serde(deserialize_with = "exactly")] [f64; 3]);

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct GraspText {
    #[serde(deserialize_with = "exactly")]
    position_mm: [f64; 3],
    #[serde(deserialize_with = "exactly")]
    approach: [f64; 3],
    #[serde(deserialize_with = "exactly")]
    closing: [f64; 3],
    width_mm: f64,
    #[serde(default)]
    slide_mm: f64,
}

impl Part {
    /// Reads a part file: `name`, `thickness_mm`, `bend_radius_mm` (may be left out), `[[node]]` with `name` and
    /// `position_mm`, `[[edge]]` with `from`, `to` and `via`, `[grasp]` with `position_mm`, `approach`, `closing`
    /// and `width_mm`. Nodes are end points and junctions; a bend is a `via`, given as the sharp corner.
    ///
    /// # Errors
    /// [`PartError`]: names file, key, value and remedy.
    pub fn read(path: impl AsRef<Path>) -> Result<Part, PartError> {
        let path = path.as_ref();
        let read = read_text(path);
        let text = read.map_err(|source| PartError::Read { path: path.to_owned(), source })?;
        Self::parse(&text, path)
    }

    /// Reads several files, in order.
    ///
    /// # Errors
    /// [`PartError`], also where two parts have one name.
    pub fn read_all<P: AsRef<Path>>(paths: &[P]) -> Result<Vec<Part>, PartError> {
        let mut parts: Vec<Part> = Vec::with_capacity(paths.len());
        for path in paths {
            let path = path.as_ref();
            let part = Self::read(path)?;
            if let Some(first) = parts.iter().position(|p| p.name == part.name) {
                let (first, second) = (paths[first].as_ref().to_owned(), path.to_owned());
                return Err(PartError::TwoOfOneName { name: part.name, first, second });
            }
            parts.push(part);
        }
        Ok(parts)
    }

    /// A part from the text of its file; `path` is for the messages.
    ///
    /// # Errors
    /// [`PartError`]: names file, key, value and remedy.
    pub fn parse(text: &str, path: impl Into<PathBuf>) -> Result<Part, PartError> {
        let path = path.into();
        let file: FileText =
            read_toml(text).map_err(|error| PartError::Toml { path: path.clone(), error })?;
        Check { path: &path }.part(file)
    }
}

/// Turns the text into a part, or says what is wrong.
struct Check<'a> {
    path: &'a Path,
}

impl Check<'_> {
    fn part(&self, file: FileText) -> Result<Part, PartError> {
        if file.name.trim().is_empty() || file.name.chars().any(char::is_control) {
            return Err(self.value("name", format!("{:?}", file.name), "must be a word that can be printed"));
        }
        let thickness_mm = self.length("thickness_mm", file.thickness_mm)?;
        if thickness_mm < THICKNESS_MIN_MM {
            let problem = format!("must be at least {THICKNESS_MIN_MM} mm; no camera sees thinner wire");
            return Err(self.value("thickness_mm", thickness_mm, &problem));
        }
        let bend_radius_mm = file.bend_radius_mm.unwrap_or(BEND_RADIUS_PER_THICKNESS * thickness_mm);
        if !(0.0..=COORDINATE_MAX_MM).contains(&bend_radius_mm) {
            return Err(self.value("bend_radius_mm", bend_radius_mm, "must be 0 or more, or be left out"));
        }
        let nodes = self.nodes(&file.node)?;
        let edges = self.edges(&file.edge, &nodes)?;
        let grasp = self.grasp(&file.grasp, thickness_mm)?;
        let symmetries = Vec::new();
        let name = file.name;
        let mut part = Part { name, thickness_mm, bend_radius_mm, nodes, edges, grasp, symmetries };
        self.graph(&mut part)?;
        self.lengths(&part, file.bend_radius_mm)?;
        self.grasp_on_wire(&part)?;
        if let Some(axis) = part.straight_axis() {
            // How it is turned about its axis nobody sees.
            let from = part.nodes[0].position_mm;
            part.grasp.position_mm = from + *axis * axis.dot(&(part.grasp.position_mm - from));
        }
        self.slides_on_wire(&part)?;
        part.symmetries = part.find_symmetries();
        Ok(part)
    }

    fn nodes(&self, texts: &[NodeText]) -> Result<Vec<PartNode>, PartError> {
        if texts.len() < 2 || texts.len() > NODES_MAX {
            let problem = format!(
                "{} [[node]] tables; a part has 2 to {NODES_MAX} end points and junctions (a closed ring, which has \
                 none, is not recognised)",
                texts.len()
            );
            return Err(self.shape(problem));
        }
        let mut nodes: Vec<PartNode> = Vec::with_capacity(texts.len());
        for text in texts {
            if text.name.trim().is_empty() || text.name.chars().any(char::is_control) {
                return Err(self.value(
                    "node name",
                    format!("{:?}", text.name),
                    "must be a word that can be printed",
                ));
            }
            if nodes.iter().any(|n| n.name == text.name) {
                let problem = "two nodes have this name; give every node a name of its own";
                return Err(self.value("node name", format!("{:?}", text.name), problem));
            }
            let position_mm = self.point(&format!("node {}: position_mm", text.name), text.position_mm)?;
            nodes.push(PartNode { name: text.name.clone(), position_mm, kind: NodeKind::End });
        }
        Ok(nodes)
    }

    fn edges(&self, texts: &[EdgeText], nodes: &[PartNode]) -> Result<Vec<PartEdge>, PartError> {
        if texts.is_empty() || texts.len() > EDGES_MAX {
            let problem = format!(
                "{} [[edge]] tables; a part has 1 to {EDGES_MAX} wires between its nodes",
                texts.len()
            );
            return Err(self.shape(problem));
        }
        let mut edges: Vec<PartEdge> = Vec::with_capacity(texts.len());
        for (i, text) in texts.iter().enumerate() {
            let find = |key: &'static str, name: &str| {
                nodes.iter().position(|n| n.name == name).ok_or_else(|| PartError::UnknownNode {
                    path: self.path.to_owned(),
                    edge: i + 1,
                    key,
                    node: name.to_owned(),
                    known: nodes.iter().map(|n| n.name.as_str()).collect::<Vec<_>>().join(", "),
                })
            };
            let (from, to) = (find("from", &text.from)?, find("to", &text.to)?);
            let key = format!("edge {} ({} to {}): via", i + 1, text.from, text.to);
            let via = text.via.iter().map(|&Triple(p)| self.point(&key, p)).collect::<Result<Vec<_>, _>>()?;
            let edge = PartEdge { from, to, via };
            if edges.iter().any(|e| *e == edge || *e == reversed(&edge)) {
                return Err(self.shape(format!(
                    "edge {} ({} to {}) is there twice; remove one",
                    i + 1,
                    text.from,
                    text.to
                )));
            }
            edges.push(edge);
        }
        let vias: usize = edges.iter().map(|e| e.via.len()).sum();
        if nodes.len() + vias > ANCHORS_MAX {
            return Err(self.shape(format!(
                "{} nodes and {vias} via points; a part has {ANCHORS_MAX} of both together at most, leave out the \
                 bends that turn least",
                nodes.len()
            )));
        }
        Ok(edges)
    }

    fn grasp(&self, text: &GraspText, thickness_mm: f64) -> Result<PartGrasp, PartError> {
        let position_mm = self.point("grasp: position_mm", text.position_mm)?;
        let approach = self.direction("grasp: approach", text.approach)?;
        let closing = self.direction("grasp: closing", text.closing)?;
        let cosine = approach.dot(&closing);
        if cosine.abs() > SQUARE_TOLERANCE {
            let angle = cosine.clamp(-1.0, 1.0).acos().to_degrees();
            let problem = format!("is {angle:.1} degrees from approach; it must be perpendicular to it");
            return Err(self.value("grasp: closing", format!("{:?}", text.closing), &problem));
        }
        let closing = Unit::new_normalize(closing.into_inner() - approach.into_inner() * cosine);
        let width_mm = self.length("grasp: width_mm", text.width_mm)?;
        if width_mm <= thickness_mm {
            let problem = format!("the fingers must open wider than thickness_mm = {thickness_mm}");
            return Err(self.value("grasp: width_mm", width_mm, &problem));
        }
        let slide_mm = text.slide_mm;
        if !(0.0..=COORDINATE_MAX_MM).contains(&slide_mm) {
            let problem = format!("must be 0 to {COORDINATE_MAX_MM} mm");
            return Err(self.value("grasp: slide_mm", slide_mm, &problem));
        }
        Ok(PartGrasp { position_mm, approach, closing, width_mm, slide_mm })
    }

    /// Sets what every node is, and checks that all hang together.
    fn graph(&self, part: &mut Part) -> Result<(), PartError> {
        for i in 0..part.nodes.len() {
            let name = &part.nodes[i].name;
            part.nodes[i].kind = match part.degree(i) {
                0 => {
                    return Err(
                        self.shape(format!("node {name} is on no edge; remove it or add its [[edge]]"))
                    );
                }
                1 => NodeKind::End,
                2 => {
                    let problem = "joins two edges only: make them one edge, with this point as `via` if it is a bend (a closed \
                         ring, which has no end and no junction, is not recognised)";
                    return Err(self.shape(format!("node {name} {problem}")));
                }
                _ => NodeKind::Junction,
            };
        }
        let mut reached = vec![false; part.nodes.len()];
        reached[0] = true;
        for _ in 0..part.nodes.len() {
            for e in &part.edges {
                let either = reached[e.from] || reached[e.to];
                (reached[e.from], reached[e.to]) = (either, either);
            }
        }
        match reached.iter().position(|r| !r) {
            None => Ok(()),
            Some(i) => Err(self.shape(format!(
                "no way leads along the edges from node {} to node {}; a part is one piece, make two part files",
                part.nodes[0].name, part.nodes[i].name
            ))),
        }
    }

    /// No stretch of an edge is without length, folds back on itself, or is shorter than the wire is thick.
    fn lengths(&self, part: &Part, bend_radius_mm: Option<f64>) -> Result<(), PartError> {
        for (i, edge) in part.edges.iter().enumerate() {
            let (from, to) = (&part.nodes[edge.from], &part.nodes[edge.to]);
            let mut corners = vec![from.position_mm];
            corners.extend_from_slice(&edge.via);
            corners.push(to.position_mm);
            let name = format!("edge {} ({} to {})", i + 1, from.name, to.name);
            let legs: Vec<Vector3<f64>> = corners.windows(2).map(|c| c[1] - c[0]).collect();
            if legs.iter().any(|l| l.norm() < 1e-3) {
                return Err(self.shape(format!(
                    "{name} has zero length between two points that follow each other; move or remove one"
                )));
            }
            if legs.windows(2).any(|l| l[0].angle(&l[1]) > 3.1) {
                return Err(self
                    .shape(format!("{name} turns back on itself at a via; a bend is at most 177 degrees")));
            }
            let fits_mm = bend_radius_max_mm(&legs);
            if bend_radius_mm.is_some_and(|radius_mm| radius_mm > BEND_FITS * fits_mm) {
                let problem = format!("does not fit between the legs of {name}; at most {fits_mm:.2} does");
                return Err(self.value("bend_radius_mm", part.bend_radius_mm, &problem));
            }
            let length = part.edge_length_mm(i);
            if length < part.thickness_mm {
                let problem = format!(
                    "is shorter than thickness_mm = {}; it cannot be seen as a wire",
                    part.thickness_mm
                );
                return Err(self.value(&format!("{name}: length in mm"), format!("{length:.3}"), &problem));
            }
        }
        let wire_mm: f64 = (0..part.edges.len()).map(|edge| part.edge_length_mm(edge)).sum();
        let longest_mm = LENGTH_THICKNESSES_MAX * part.thickness_mm;
        if wire_mm > longest_mm {
            return Err(self.shape(format!(
                "its wire is {wire_mm:.0} mm long; of wire {} mm thick at most {longest_mm:.0} mm are looked at",
                part.thickness_mm
            )));
        }
        for (i, a) in part.nodes.iter().enumerate() {
            if let Some(b) = part.nodes[..i].iter().find(|b| (b.position_mm - a.position_mm).norm() < 1e-3) {
                return Err(self
                    .shape(format!("nodes {} and {} lie at the same place; make them one", b.name, a.name)));
            }
        }
        Ok(())
    }

    /// The grasp is on the wire, and the fingers close across it.
    fn grasp_on_wire(&self, part: &Part) -> Result<(), PartError> {
        let grasp = part.grasp.position_mm;
        let length: f64 = (0..part.edges.len()).map(|e| part.edge_length_mm(e)).sum();
        let step_mm = (0.25 * part.thickness_mm).max(length / 10_000.0);
        let lines: Vec<_> = (0..part.edges.len()).map(|edge| part.centreline(edge, step_mm)).collect();
        let near: Vec<_> = lines.iter().flatten().collect();
        let distance = |p: &Point3<f64>| (p - grasp).norm();
        let least = near.iter().map(|p| distance(&p.position_mm)).fold(f64::MAX, f64::min);
        // The wire passes inside of its corners.
        let is_corner =
            part.edges.iter().flat_map(|e| &e.via).any(|via| distance(via) < part.thickness_mm / 2.0);
        let shown = format!("[{}, {}, {}]", grasp.x, grasp.y, grasp.z);
        if least > part.thickness_mm / 2.0 + step_mm / 2.0 && !is_corner {
            let problem = format!("is {least:.1} mm from the wire's axis; put it on that");
            return Err(self.value("grasp: position_mm", shown, &problem));
        }
        for (edge, line) in part.edges.iter().zip(&lines) {
            let [from, to] = [line[0], line[line.len() - 1]];
            for (node, end, outward) in [(edge.from, from, -from.tangent), (edge.to, to, to.tangent)] {
                let beyond_mm = (grasp - end.position_mm).dot(&outward);
                let is_nearest = distance(&end.position_mm) <= least;
                if part.nodes[node].kind == NodeKind::End && is_nearest && beyond_mm > BEYOND_MM_MAX {
                    let name = &part.nodes[node].name;
                    let problem =
                        format!("is {beyond_mm:.2} mm beyond the wire's end {name}; put it on the wire");
                    return Err(self.value("grasp: position_mm", shown, &problem));
                }
            }
        }
        let axis = part.grasp_axis();
        let askew_deg =
            |p: &&CentrelinePoint, way: &Vector3<f64>| p.tangent.dot(way).abs().min(1.0).acos().to_degrees();
        let around = || near.iter().copied().filter(|p| distance(&p.position_mm) < least + part.thickness_mm);
        let least_deg = around().map(|p| askew_deg(&p, &axis)).fold(f64::MAX, f64::min);
        let is_bent = around().any(|p| around().any(|q| askew_deg(&p, &q.tangent) > ASKEW_DEG_MAX));
        let most_deg = if is_bent { ASKEW_AT_BEND_DEG_MAX } else { ASKEW_DEG_MAX };
        if least_deg > most_deg {
            let c = part.grasp.closing;
            let problem = format!(
                "does not close across the wire; approach × closing must be the wire's direction at the grasp, and is \
                 {least_deg:.1} degrees from it (at most {most_deg} here)"
            );
            return Err(self.value("grasp: closing", format!("[{}, {}, {}]", c.x, c.y, c.z), &problem));
        }
        Ok(())
    }

    /// The wire is straight as far as the grasp may slide.
    fn slides_on_wire(&self, part: &Part) -> Result<(), PartError> {
        let PartGrasp { position_mm, slide_mm, .. } = part.grasp;
        let length: f64 = (0..part.edges.len()).map(|e| part.edge_length_mm(e)).sum();
        let step_mm = (0.25 * part.thickness_mm).max(length / 2000.0);
        let pieces: Vec<[Point3<f64>; 2]> = (0..part.edges.len())
            .flat_map(|edge| {
                let points = part.centreline(edge, step_mm);
                points.windows(2).map(|p| [p[0].position_mm, p[1].position_mm]).collect::<Vec<_>>()
            })
            .collect();
        let off_mm = |along_mm: f64| {
            let there = position_mm + part.grasp_axis().into_inner() * along_mm;
            let off_mm = pieces.iter().map(|[from, to]| {
                let piece = to - from;
                let share = ((there - from).dot(&piece) / piece.norm_squared()).clamp(0.0, 1.0);
                (from + piece * share - there).norm()
            });
            off_mm.fold(f64::MAX, f64::min)
        };
        let allowed_mm = off_mm(0.0) + STRAIGHT_SHARE * part.thickness_mm;
        let is_wire = |along_mm: f64| off_mm(along_mm) < allowed_mm;
        let steps = (slide_mm / step_mm).ceil() as usize;
        let slides = (1..=steps).map(|k| slide_mm * k as f64 / steps as f64);
        let possible_mm = slides.take_while(|mm| is_wire(*mm) && is_wire(-mm)).last().unwrap_or(0.0);
        if possible_mm < slide_mm {
            let problem = format!(
                "the wire ends or bends so far from position_mm, or approach × closing is not quite its direction; \
                 {possible_mm:.1} mm are possible"
            );
            return Err(self.value("grasp: slide_mm", slide_mm, &problem));
        }
        Ok(())
    }

    fn point(&self, key: &str, p: [f64; 3]) -> Result<Point3<f64>, PartError> {
        if p.iter().all(|v| v.abs() <= COORDINATE_MAX_MM) {
            return Ok(Point3::from(p));
        }
        Err(self.value(
            key,
            format!("{p:?}"),
            &format!("must be three numbers from -{COORDINATE_MAX_MM} to {COORDINATE_MAX_MM}"),
        ))
    }

    fn direction(&self, key: &str, d: [f64; 3]) -> Result<Unit<Vector3<f64>>, PartError> {
        let vector = Vector3::from(d);
        let unit = Unit::try_new(vector, 1e-9).filter(|u| u.iter().all(|v| v.is_finite()));
        unit.ok_or_else(|| self.value(key, format!("{d:?}"), "must be a direction: three numbers, not all 0"))
    }

    fn length(&self, key: &str, mm: f64) -> Result<f64, PartError> {
        if mm > 0.0 && mm <= COORDINATE_MAX_MM {
            return Ok(mm);
        }
        Err(self.value(key, mm, &format!("must be above 0 and at most {COORDINATE_MAX_MM} mm")))
    }

    fn value(&self, key: &str, value: impl ToString, problem: &str) -> PartError {
        let (key, value) = (key.to_owned(), value.to_string());
        PartError::Value { path: self.path.to_owned(), key, value, problem: problem.to_owned() }
    }

    fn shape(&self, problem: String) -> PartError {
        PartError::Shape { path: self.path.to_owned(), problem }
    }
}

fn reversed(edge: &PartEdge) -> PartEdge {
    PartEdge { from: edge.to, to: edge.from, via: edge.via.iter().rev().copied().collect() }
}
