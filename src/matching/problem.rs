//! What every search works on: the part's nodes, and the stereo nodes that may be them.
//!
//! A stereo node is a node of the left picture and a node of the right one that may show the same point, with that
//! point in space; [`gate`](super::gate) lists them.

use nalgebra::{Matrix2, Point3, Vector2, Vector3};

use super::nodes::{Leg, NodeRole};
use crate::part::{Part, PartEdge, Symmetry};
use crate::rig::Rig;

/// Most nodes (end points, junctions and bends) of a part's model.
/// [`Part`] files with more are refused where they are read.
pub const ANCHORS_MAX: usize = crate::part::ANCHORS_MAX;

/// A node of the part's model that an image node can be: an end point, a junction or a bend.
#[derive(Clone, Debug, PartialEq)]
pub struct Anchor {
    /// What it looks like.
    pub role: NodeRole,
    /// Place in the part's frame.
    pub position_mm: Point3<f64>,
    /// Unit directions in which wire leaves it, part's frame, with the length of the straight piece in mm.
    pub legs: Vec<(Vector3<f64>, f64)>,
    /// Whether a symmetry of the part puts an anchor before this one here: what is a pose by this one is the same by that.
    pub is_repeated: bool,
    /// Pairs of legs, each way round, that do not lie along one line, by their indices; of those that are the same by a
    /// symmetry of the part one.
    pub corners: Vec<[usize; 2]>,
}

impl Anchor {
    fn new(role: NodeRole, position_mm: Point3<f64>) -> Self {
        Self { role, position_mm, legs: Vec::new(), is_repeated: false, corners: Vec::new() }
    }

    fn find_corners(&self, part: &Part) -> Vec<[usize; 2]> {
        let legs = &self.legs;
        let is_corner = |&[i, j]: &[usize; 2]| legs[i].0.cross(&legs[j].0).norm() >= CORNER_SIN_MIN;
        let all = (0..legs.len()).flat_map(|i| (0..legs.len()).map(move |j| [i, j])).filter(is_corner);
        let stays = |s: &&Symmetry| {
            (s.part_from_part * self.position_mm - self.position_mm).norm() < part.thickness_mm / 2.0
        };
        let mut corners: Vec<[usize; 2]> = Vec::new();
        for corner in all {
            let comes_from = |known: &[usize; 2], s: &Symmetry| {
                let is_turned = |(from, to): (usize, usize)| {
                    (s.part_from_part * legs[from].0 - legs[to].0).norm() < CORNER_SIN_MIN / 2.0
                };
                known.iter().copied().zip(corner).all(is_turned)
            };
            let mut turns = part.symmetries.iter().filter(stays);
            if !turns.any(|s| corners.iter().any(|known| comes_from(known, s))) {
                corners.push(corner);
            }
        }
        corners
    }
}

/// Sine of the angle under which two legs lie along one line.
pub(super) const CORNER_SIN_MIN: f64 = 0.2;

/// Straight wire between two anchors: a piece, or a line of several.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Span {
    /// Index of an anchor.
    pub from: usize,
    /// Index of another anchor.
    pub to: usize,
    /// Distance between them.
    pub length_mm: f64,
    /// How many points of it are looked up in each picture.
    pub looks: u32,
    /// Of a line, which is made up of several pieces of wire, the anchors on it, one bit each: it is a span where all these are left
    /// out. Of a piece none.
    pub through: u32,
}

impl Span {
    /// A straight piece of this length.
    pub fn new(from: usize, to: usize, length_mm: f64) -> Self {
        let looks = (length_mm / LOOK_UP_STEP_MM).ceil().clamp(4.0, 64.0) as u32;
        Self { from, to, length_mm, looks, through: 0 }
    }

    /// The lines: straight wire through anchors, made up of pieces that go on in each other and in no third one, to within `off_mm`. Of
    /// a tee its bar. Of those that share a piece no two are spans of one match.
    fn of_lines(anchors: &[Anchor], pieces: &[Span], off_mm: f64) -> Vec<Span> {
        let other_end = |piece: &Span, at: usize| piece.from + piece.to - at;
        let is_between = |m: usize, [from, to]: [usize; 2]| {
            let [from, at, to] = [from, m, to].map(|a| anchors[a].position_mm);
            let (along, here) = (to - from, at - from);
            let share = here.dot(&along) / along.norm_squared();
            (0.0..1.0).contains(&share) && (here - along * share).norm() <= off_mm
        };
        // The only piece in which another goes on at one of its ends.
        let one_beyond = |piece: usize, at: usize| {
            let from = other_end(&pieces[piece], at);
            let goes_on = |&k: &usize| {
                let next = &pieces[k];
                k != piece
                    && (next.from == at || next.to == at)
                    && is_between(at, [from, other_end(next, at)])
            };
            let mut all = (0..pieces.len()).filter(goes_on);
            all.next().filter(|_| all.next().is_none())
        };
        let beyond = |piece: usize, at: usize| {
            one_beyond(piece, at).filter(|&next| one_beyond(next, at) == Some(piece))
        };
        let mut lines = Vec::new();
        for (first, begin) in (0..pieces.len()).flat_map(|k| [(k, pieces[k].from), (k, pieces[k].to)]) {
            let (mut piece, mut path) = (first, vec![begin, other_end(&pieces[first], begin)]);
            while let Some(next) = beyond(piece, path[path.len() - 1]) {
                let end = other_end(&pieces[next], path[path.len() - 1]);
                // What is a line is one in all its parts: those that do not end here have been asked.
                let is_line = |i: usize| path[i + 1..].iter().all(|&m| is_between(m, [path[i], end]));
                if path.contains(&end) || !(0..path.len() - 1).all(is_line) {
                    break;
                }
                if begin < end {
                    let length_mm = (anchors[end].position_mm - anchors[begin].position_mm).norm();
                    let through = path[1..].iter().fold(0, |bits, m| bits | 1 << m);
                    lines.push(Span { through, ..Span::new(begin, end, length_mm) });
                }
                path.push(end);
                piece = next;
            }
        }
        lines
    }
}

/// How far an anchor may be off the line through it, in thicknesses.
const LINE_THICKNESSES: f64 = 0.25;
/// Distance in mm between two points of the wire where foreground is looked up.
const LOOK_UP_STEP_MM: f64 = 4.0;

/// A piece of wire, straight or an arc of less than a right angle, along which foreground is looked up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WirePiece {
    /// Where it begins, its middle, and where it ends, part's frame.
    pub along_mm: [Point3<f64>; 3],
    /// How many points of it are looked up in each picture.
    pub looks: u32,
}

impl WirePiece {
    /// The straight pieces between anchors.
    pub(super) fn of_spans(anchors: &[Anchor], spans: &[Span]) -> Vec<Self> {
        let piece = |span: &Span| {
            let [from, to] = [span.from, span.to].map(|a| anchors[a].position_mm);
            Self { along_mm: [from, nalgebra::center(&from, &to), to], looks: span.looks }
        };
        spans.iter().map(piece).collect()
    }

    /// The pieces of all edges, bends as they are.
    fn of_bends(part: &Part) -> Vec<Self> {
        let longest_mm = (part.bend_radius_mm * PIECE_RAD).max(part.thickness_mm);
        let pieces = |edge: usize| {
            let length_mm = part.edge_length_mm(edge);
            let count = (length_mm / longest_mm).ceil();
            // Two steps a piece; a little more, lest rounding make it one step more.
            let line = part.centreline(edge, length_mm / (2.0 * count) * (1.0 + 1e-9));
            let looks = (length_mm / count / LOOK_UP_STEP_MM).ceil() as u32;
            let piece = |k: usize| Self { along_mm: [0, 1, 2].map(|on| line[k + on].position_mm), looks };
            (0..line.len() - 2).step_by(2).map(piece).collect::<Vec<_>>()
        };
        (0..part.edges.len()).flat_map(pieces).collect()
    }
}

/// Up to which angle a piece of wire is bent.
const PIECE_RAD: f64 = 0.5;
/// A bend is seen as a corner where it turns by at least this many radians, the wire is no farther from its corner, in
/// thicknesses, and goes on straight for at least so many thicknesses on both sides.
const CORNER_RAD_MIN: f64 = 0.5;
const CORNER_THICKNESSES_MAX: f64 = 0.75;
const STRAIGHT_THICKNESSES_MIN: f64 = 1.0;

/// Whether a part has bends that are not seen as corners.
fn is_smooth(part: &Part) -> bool {
    part.edges.iter().any(|edge| {
        let bends: Vec<(&Point3<f64>, f64)> = turns(edge, part).collect();
        let cut_mm = |turn_rad: f64| part.bend_radius_mm * (turn_rad / 2.0).tan();
        let off_mm = |turn_rad: f64| part.bend_radius_mm * (1.0 / (turn_rad / 2.0).cos() - 1.0);
        let [from, to] = [edge.from, edge.to].map(|n| (&part.nodes[n].position_mm, 0.0));
        let corners: Vec<_> = std::iter::once(from).chain(bends.iter().copied()).chain([to]).collect();
        let is_short = |legs: &[(&Point3<f64>, f64)]| {
            let straight_mm = (legs[1].0 - legs[0].0).norm() - cut_mm(legs[0].1) - cut_mm(legs[1].1);
            straight_mm < STRAIGHT_THICKNESSES_MIN * part.thickness_mm
        };
        let is_soft = |turn_rad: f64| {
            turn_rad < CORNER_RAD_MIN || off_mm(turn_rad) > CORNER_THICKNESSES_MAX * part.thickness_mm
        };
        bends.iter().any(|(_, turn_rad)| is_soft(*turn_rad))
            || !bends.is_empty() && corners.windows(2).any(is_short)
    })
}

/// A part as the search sees it.
#[derive(Clone, Debug, PartialEq)]
pub struct MatchModel {
    /// Its nodes and bends.
    pub anchors: Vec<Anchor>,
    /// Its straight pieces, and behind them its lines.
    pub spans: Vec<Span>,
    /// All its wire.
    pub wire: Vec<WirePiece>,
    /// Whether some of it bends where no corner is seen: its nodes do not tell how it lies then.
    pub smooth: bool,
    /// Distances between all anchors in mm, row by row.
    pub distances_mm: Vec<f64>,
    /// Thickness of the wire.
    pub thickness_mm: f64,
    /// Whether all anchors lie on one line.
    pub straight: bool,
    /// Where the part looks the same turned, the first anchor that turning moves, and those in whose place it comes, one bit
    /// each. Of all matches that are the same turned, one has there the candidate with the lowest number.
    pub turned: Option<(usize, u32)>,
}

/// At a `via` that turns by less, in radians, the wire goes straight on.
const BEND_RAD_MIN: f64 = 0.09;

/// Where an edge bends, and by how much. A straight part has no bends: what turns within so little cannot be seen.
fn turns<'a>(edge: &'a PartEdge, part: &Part) -> impl Iterator<Item = (&'a Point3<f64>, f64)> {
    let [from, to] = [edge.from, edge.to].map(|n| part.nodes[n].position_mm);
    let turn = move |k: usize| {
        let at = &edge.via[k];
        let before = k.checked_sub(1).map_or(from, |k| edge.via[k]);
        let after = edge.via.get(k + 1).copied().unwrap_or(to);
        (at, (at - before).angle(&(after - at)))
    };
    let vias = if part.is_straight() { 0 } else { edge.via.len() };
    (0..vias).map(turn).filter(|(_, turn_rad)| *turn_rad >= BEND_RAD_MIN)
}

impl MatchModel {
    /// Takes the anchors and spans from a part: its nodes first, then the bends of its edges.
    ///
    /// # Panics
    /// Where the part has more than [`ANCHORS_MAX`] nodes and bends; [`Part`] files are checked for that before.
    pub fn new(part: &Part) -> Self {
        let role = |n: usize| if part.degree(n) == 1 { NodeRole::End } else { NodeRole::Junction };
        let mut anchors: Vec<Anchor> =
            part.nodes.iter().enumerate().map(|(n, node)| Anchor::new(role(n), node.position_mm)).collect();
        let mut spans = Vec::new();
        for edge in &part.edges {
            let mut previous = edge.from;
            for (via, _) in turns(edge, part) {
                anchors.push(Anchor::new(NodeRole::Bend, *via));
                spans.push((previous, anchors.len() - 1));
                previous = anchors.len() - 1;
            }
            spans.push((previous, edge.to));
        }
        assert!(anchors.len() <= ANCHORS_MAX, "part {} has {} nodes and bends", part.name, anchors.len());
        let mut spans: Vec<Span> = spans
            .into_iter()
            .map(|(from, to)| {
                let along = anchors[to].position_mm - anchors[from].position_mm;
                let length_mm = along.norm();
                anchors[from].legs.push((along / length_mm, length_mm));
                anchors[to].legs.push((-along / length_mm, length_mm));
                Span::new(from, to, length_mm)
            })
            .collect();
        let comes_to = |j: usize, k: usize| {
            let [from, to]: [Point3<f64>; 2] = [j, k].map(|a: usize| anchors[a].position_mm);
            let near = |s: &Symmetry| (s.part_from_part * from - to).norm() < part.thickness_mm / 2.0;
            j != k && part.symmetries.iter().any(near)
        };
        let moved =
            |j: usize| (0..anchors.len()).filter(|&k| comes_to(j, k)).fold(0, |bits, k| bits | 1 << k);
        let turned = (0..anchors.len()).map(|j| (j, moved(j))).find(|(_, others)| *others != 0);
        let repeated: Vec<bool> = (0..anchors.len()).map(|k| (0..k).any(|j| comes_to(j, k))).collect();
        for (anchor, is_repeated) in anchors.iter_mut().zip(repeated) {
            anchor.is_repeated = is_repeated;
            anchor.corners = anchor.find_corners(part);
        }
        let distances_mm = anchors
            .iter()
            .flat_map(|a| anchors.iter().map(move |b| (a.position_mm - b.position_mm).norm()))
            .collect();
        let smooth = is_smooth(part);
        let wire = if smooth { WirePiece::of_bends(part) } else { WirePiece::of_spans(&anchors, &spans) };
        if !part.is_straight() {
            // Of a straight part no anchor is left out.
            spans.extend(Span::of_lines(&anchors, &spans, part.thickness_mm * LINE_THICKNESSES));
        }
        Self {
            anchors,
            spans,
            wire,
            smooth,
            distances_mm,
            thickness_mm: part.thickness_mm,
            straight: part.is_straight(),
            turned,
        }
    }

    /// How many anchors must be matched: all of a straight part, else half of them and three at least, which hold a
    /// pose.
    pub fn required(&self) -> usize {
        let all = self.anchors.len();
        if self.straight { all } else { all.div_ceil(2).max(3).min(all) }
    }

    /// The spans that are no lines.
    #[inline]
    pub fn pieces(&self) -> &[Span] {
        &self.spans[..self.spans.partition_point(|span| span.through == 0)]
    }

    /// Whether it has lines.
    #[inline]
    pub fn has_lines(&self) -> bool {
        self.spans.last().is_some_and(|span| span.through != 0)
    }

    /// The lines with their indices among the spans, last first.
    #[inline]
    pub fn lines(&self) -> impl Iterator<Item = (usize, &Span)> {
        self.spans.iter().enumerate().rev().take_while(|(_, span)| span.through != 0)
    }

    /// Distance between two anchors in mm.
    #[inline]
    pub fn distance_mm(&self, a: usize, b: usize) -> f64 {
        self.distances_mm[a * self.anchors.len() + b]
    }
}

/// A node of the left picture and one of the right that may show the same point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StereoNode {
    /// Index of the left picture's node.
    pub left: u16,
    /// Index of the right picture's node.
    pub right: u16,
    /// The point, left camera's frame.
    pub point_mm: Point3<f64>,
    /// Where the point is seen in the left and in the right picture, in pixels: between its node and the other
    /// node's epipolar line.
    pub seen_px: [Vector2<f64>; 2],
    /// Distance of the right node from the left node's epipolar line, in pixels.
    pub gap_px: f64,
    /// Whether both look like ends, both like bends, or one of them is a junction.
    pub role: NodeRole,
}

/// What two nodes are together; `None` where they cannot be the same point. An end that another wire hides in one
/// picture is a junction there.
pub(super) fn common_role(left: NodeRole, right: NodeRole) -> Option<NodeRole> {
    use NodeRole::*;
    match (left, right) {
        (End, End) => Some(End),
        (Bend, Bend) => Some(Bend),
        (Junction, _) | (_, Junction) => Some(Junction),
        _ => None,
    }
}

/// Whether a leg of the left picture and one of the right lead in the same direction, to within an angle of this cosine;
/// `across` is [`Rig::right_from_left_across`].
pub(super) fn is_same_direction(across: &Matrix2<f64>, left: &Leg, right: &Leg, cos_min: f64) -> bool {
    let seen_by_right = across * left.direction_px;
    seen_by_right.dot(&right.direction_px) >= cos_min * seen_by_right.norm()
}

/// Direction in space of a leg seen in both pictures, and how well it is held (0 to 1: the sine of the angle
/// between the planes through the leg and the two cameras). Left camera's frame, pointing away from the node.
pub fn leg_direction(rig: &Rig, left: &Leg, right: &Leg) -> Option<(Vector3<f64>, f64)> {
    let plane = |near: &Vector2<f64>, far: &Vector2<f64>| near.push(1.0).cross(&far.push(1.0));
    let left_from_right = rig.right_from_left.rotation.inverse();
    let nl = plane(&left.near_ray, &left.far_ray).try_normalize(1e-12)?;
    let nr = (left_from_right * plane(&right.near_ray, &right.far_ray)).try_normalize(1e-12)?;
    let along = nl.cross(&nr);
    let hold = along.norm();
    let direction = along.try_normalize(1e-9)?;
    // The picture says which way it leads.
    let shown = (left.far_ray - left.near_ray).push(0.0);
    Some((if direction.dot(&shown) < 0.0 { -direction } else { direction }, hold))
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    #[test]
    fn pieces_that_meet_in_line_make_up_others() {
        let lines = |nodes: &[(f64, f64)], edges: &[(usize, usize)]| {
            let anchor = |&(x, y): &(f64, f64)| Anchor::new(NodeRole::Junction, Point3::new(x, y, 0.0));
            let anchors: Vec<_> = nodes.iter().map(anchor).collect();
            let length_mm =
                |from: usize, to: usize| (anchors[to].position_mm - anchors[from].position_mm).norm();
            let pieces: Vec<_> = edges.iter().map(|&(a, b)| Span::new(a, b, length_mm(a, b))).collect();
            let mut lines: Vec<_> = Span::of_lines(&anchors, &pieces, 1.0)
                .iter()
                .map(|s| (s.from, s.to, s.through, s.length_mm.round()))
                .collect();
            lines.sort_by_key(|line| (line.0, line.1));
            lines
        };
        let cross = [(0.0, 0.0), (-20.0, 0.5), (0.0, 25.0), (30.0, 0.0), (0.0, -25.0)];
        assert_eq!(lines(&cross, &[(0, 1), (0, 2), (0, 3), (4, 0)]), [(1, 3, 1, 50.0), (2, 4, 1, 50.0)]);
        // A comb: a bar with two teeth.
        let comb = [(0.0, 0.0), (10.0, 0.0), (30.0, 0.0), (45.0, 0.0), (10.0, 9.0), (30.0, 9.0)];
        let of_comb = lines(&comb, &[(0, 1), (1, 2), (2, 3), (1, 4), (2, 5)]);
        assert_eq!(of_comb, [(0, 2, 0b10, 30.0), (0, 3, 0b110, 45.0), (1, 3, 0b100, 35.0)]);
        let ring = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)];
        assert_eq!(lines(&ring, &[(0, 1), (1, 2), (2, 3), (3, 0)]), []);
        // Where a wire may go on in two others, and where two wires lie between the same anchors, it goes on in none.
        let fork = [(0.0, 0.0), (-40.0, 0.0), (45.0, 0.9), (50.0, -0.9)];
        assert_eq!(lines(&fork, &[(0, 1), (0, 2), (0, 3)]), []);
        let eye = [(0.0, 0.0), (20.0, 0.0), (40.0, 0.0)];
        assert_eq!(lines(&eye, &[(0, 1), (1, 2), (1, 2)]), []);
        // Each corner of it lies on the line between its neighbours, but not on the line through all.
        let arc = [(0.0, 0.0), (20.0, 1.5), (40.0, 1.5), (60.0, 0.0)];
        assert_eq!(lines(&arc, &[(0, 1), (1, 2), (2, 3)]).len(), 2);
    }

    #[test]
    fn anchors_that_look_alike_are_known() {
        let model = |name: &str| {
            let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("replay/parts").join(name);
            MatchModel::new(&Part::read(file).unwrap())
        };
        let repeated = |m: &MatchModel| m.anchors.iter().map(|a| a.is_repeated).collect::<Vec<_>>();
        let corners = |m: &MatchModel| m.anchors.iter().map(|a| a.corners.len()).collect::<Vec<_>>();
        for (name, expected, turned, corners_expected) in [
            ("rod-90.toml", &[false, true][..], Some((0, 0b10)), &[0, 0][..]),
            // Either half of the bar with the leg is the same.
            ("tee.toml", &[false, true, false, false], Some((0, 0b10)), &[0, 0, 0, 2]),
            ("zed.toml", &[false, true, false, true], Some((0, 0b10)), &[0, 0, 2, 2]),
            ("hook.toml", &[false; 3], None, &[0, 0, 2]),
        ] {
            let model = model(name);
            assert_eq!((&repeated(&model)[..], model.turned), (expected, turned), "{name}");
            assert_eq!(corners(&model), corners_expected, "{name}");
        }
    }

    #[test]
    fn a_straight_part_has_no_bends_that_could_be_seen() {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("replay/parts/rod-90.toml");
        let mut part = Part::read(file).unwrap();
        let straight = MatchModel::new(&part);
        let [from, to] = [0, 1].map(|n| part.nodes[n].position_mm);
        let across = Vector3::z() * (0.08 * part.thickness_mm);
        part.edges[0].via = vec![from + (to - from) * (2.0 / (to - from).norm()) + across];
        assert_eq!(MatchModel::new(&part), straight);
        part.edges[0].via[0] += 10.0 * across;
        assert_eq!(MatchModel::new(&part).anchors.len(), 3);
    }
}
