//! What pose estimation needs of a part, worked out once: points along its centreline and its free ends.

use std::ops::Range;

use nalgebra::{Point3, Vector3};

use crate::part::Part;

/// The wire of a bent part has two points a thickness up to this length, in thicknesses: it consists of short pieces, whose
/// direction few points would tell. Other wire has one. Short parts have more, so many in all, but no more than so many a
/// thickness.
const DENSE_THICKNESSES_MAX: f64 = 128.0;
const STATIONS_MIN: f64 = 20.0;
const PER_THICKNESS_MAX: f64 = 4.0;

/// From this angle in radians on, over a thickness, a wire bends.
const BEND_RAD: f64 = 0.09;
/// A straight piece turns by less than this from one end to the other, in radians: it strays from the line between them by an
/// eighth of that share of its length.
const STRETCH_RAD_MAX: f64 = 0.15;

/// A point of the centreline at which the wire's place in the pictures is measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Station {
    /// Place in the part's frame.
    pub position_mm: Point3<f64>,
    /// Unit direction of the wire there, in the part's frame.
    pub tangent: Vector3<f64>,
    /// Index of the part's edge.
    pub edge: usize,
    /// Length of centreline this station stands for.
    pub length_mm: f64,
    /// Whether another wire of the part joins so near that the section across is not that of one wire.
    pub at_joint: bool,
    /// Index of the straight piece of wire it lies on.
    pub stretch: usize,
    /// Where it lies on that, from -0.5 at one end to 0.5 at the other.
    pub share: f64,
}

/// Up to eight stations in a row, and the ball around their wire's axis: what is far from the ball is far from all of them.
#[derive(Clone, Debug, PartialEq)]
pub struct Cluster {
    /// Which.
    pub stations: Range<usize>,
    /// The ball's centre, in the part's frame.
    pub centre_mm: Point3<f64>,
    /// Its radius.
    pub reach_mm: f64,
}

/// Most stations of a cluster.
const CLUSTER: usize = 8;

/// A free end of the part.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FreeEnd {
    /// Place in the part's frame.
    pub position_mm: Point3<f64>,
    /// Unit direction out of the part.
    pub outward: Vector3<f64>,
}

/// A part as pose estimation sees it.
#[derive(Clone, Debug)]
pub struct PoseModel {
    /// Points along the centreline.
    pub stations: Vec<Station>,
    /// How many stations there are on a thickness of wire, which do not err independently of each other.
    pub per_thickness: usize,
    /// All stations, a few at a time.
    pub clusters: Vec<Cluster>,
    /// The ends of its straight pieces of wire, in its frame.
    pub straight_mm: Vec<[Point3<f64>; 2]>,
    /// Nodes with one edge.
    pub ends: Vec<FreeEnd>,
    /// Radius of the wire.
    pub radius_mm: f64,
    /// Length of all wire.
    pub length_mm: f64,
    /// Middle of the stations: the point that rotations turn about.
    pub centre_mm: Point3<f64>,
    /// For a straight part its direction; it has no angle about that.
    pub straight_along: Option<Vector3<f64>>,
}

impl PoseModel {
    /// Works out the stations of `part`.
    pub fn new(part: &Part) -> Self {
        Self::with_stations(part, per_thickness(part, !part.is_straight()))
    }

    /// The same, with at least two stations a thickness of straight wire, too, unless it is very long: where others lie across
    /// much of it, few of one would be left.
    pub fn dense(part: &Part) -> Self {
        Self::with_stations(part, per_thickness(part, true))
    }

    fn with_stations(part: &Part, per_thickness: usize) -> Self {
        let radius_mm = part.thickness_mm / 2.0;
        let step_mm = part.thickness_mm / per_thickness as f64;
        let joints: Vec<Point3<f64>> = (0..part.nodes.len())
            .filter(|&n| part.degree(n) > 1)
            .map(|n| part.nodes[n].position_mm)
            .collect();
        let mut stations = Vec::new();
        for edge in 0..part.edges.len() {
            let line = part.centreline(edge, step_mm);
            for pair in line.windows(2) {
                let position_mm = nalgebra::center(&pair[0].position_mm, &pair[1].position_mm);
                let along = pair[1].position_mm - pair[0].position_mm;
                let length_mm = along.norm();
                if length_mm < 1e-9 {
                    continue;
                }
                stations.push(Station {
                    position_mm,
                    tangent: along / length_mm,
                    edge,
                    length_mm,
                    stretch: 0,
                    share: 0.0,
                    at_joint: joints.iter().any(|j| (position_mm - j).norm() < 1.6 * part.thickness_mm),
                });
            }
        }
        find_stretches(&mut stations, step_mm / part.thickness_mm);
        let length_mm = stations.iter().map(|s| s.length_mm).sum();
        let centre =
            stations.iter().map(|s| s.position_mm.coords * s.length_mm).sum::<Vector3<f64>>() / length_mm;
        Self {
            ends: free_ends(part, step_mm),
            per_thickness,
            straight_along: part.is_straight().then(|| stations[0].tangent),
            straight_mm: straight_pieces(&stations),
            clusters: clusters_of(&stations),
            stations,
            radius_mm,
            length_mm,
            centre_mm: centre.into(),
        }
    }
}

/// How many stations a thickness of a part's wire has, which is to be looked at closely or not.
fn per_thickness(part: &Part, closely: bool) -> usize {
    let wire_mm = (0..part.edges.len()).map(|edge| part.edge_length_mm(edge)).sum::<f64>();
    let thicknesses = wire_mm / part.thickness_mm;
    let least = if closely && thicknesses <= DENSE_THICKNESSES_MAX { 2.0 } else { 1.0 };
    (STATIONS_MIN / thicknesses).ceil().clamp(least, PER_THICKNESS_MAX) as usize
}

/// Tells straight pieces of wire apart; the stations lie so many thicknesses from each other. Wire that bends little from one
/// to the next is no longer straight where it has turned by [`STRETCH_RAD_MAX`] in all.
fn find_stretches(mut stations: &mut [Station], step_thicknesses: f64) {
    let (straight_cos, stretch_cos) = ((BEND_RAD * step_thicknesses).cos(), STRETCH_RAD_MAX.cos());
    let mut stretch = 0;
    while let [first, ..] = stations {
        let first = *first;
        let goes_on = |two: &[Station]| {
            first.edge == two[1].edge
                && two[0].tangent.dot(&two[1].tangent) > straight_cos
                && first.tangent.dot(&two[1].tangent) > stretch_cos
        };
        let count = 1 + stations.windows(2).take_while(|two| goes_on(two)).count();
        let (piece, rest) = stations.split_at_mut(count);
        for (k, station) in piece.iter_mut().enumerate() {
            (station.stretch, station.share) = (stretch, (k as f64 + 0.5) / count as f64 - 0.5);
        }
        (stretch, stations) = (stretch + 1, rest);
    }
}

fn clusters_of(stations: &[Station]) -> Vec<Cluster> {
    let edges = stations.chunk_by(|a, b| a.edge == b.edge);
    let mut next = 0;
    let cluster = |stations: &[Station]| {
        let first = next;
        next += stations.len();
        let sum = stations.iter().map(|s| s.position_mm.coords).sum::<Vector3<f64>>();
        let centre_mm = Point3::from(sum / stations.len() as f64);
        let reach = |s: &Station| (s.position_mm - centre_mm).norm() + s.length_mm / 2.0;
        let reach_mm = stations.iter().map(reach).fold(0.0, f64::max);
        Cluster { stations: first..next, centre_mm, reach_mm }
    };
    edges.flat_map(|edge| edge.chunks(CLUSTER)).map(cluster).collect()
}

/// Those that are longer than the pieces of a bend.
fn straight_pieces(stations: &[Station]) -> Vec<[Point3<f64>; 2]> {
    let ends = |stations: &[Station]| {
        let [first, .., last] = stations else { return None };
        let half = |s: &Station| s.tangent * (s.length_mm / 2.0);
        Some([first.position_mm - half(first), last.position_mm + half(last)])
    };
    stations.chunk_by(|a, b| a.stretch == b.stretch).filter_map(ends).collect()
}

fn free_ends(part: &Part, step_mm: f64) -> Vec<FreeEnd> {
    let mut ends = Vec::new();
    for (index, edge) in part.edges.iter().enumerate() {
        let line = part.centreline(index, step_mm);
        let (first, last) = (&line[0], &line[line.len() - 1]);
        if part.degree(edge.from) == 1 {
            ends.push(FreeEnd { position_mm: first.position_mm, outward: -first.tangent.into_inner() });
        }
        if part.degree(edge.to) == 1 {
            ends.push(FreeEnd { position_mm: last.position_mm, outward: last.tangent.into_inner() });
        }
    }
    ends
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn short_bent_and_dense_wire_has_stations_enough() {
        let per_thickness = |length_mm: f64, via: &str| {
            let (grasp, closing) =
                if via.is_empty() { ([1.0, 0.0, 0.0], [0, 1, 0]) } else { ([0.0, 10.0, 0.0], [1, 0, 0]) };
            let text = format!(
                "name = 'wire'\nthickness_mm = 2.0\n\
                 node = [{{ name = 'a', position_mm = [0, 0, 0] }}, {{ name = 'b', position_mm = [{length_mm}, 0, 0] }}]\n\
                 edge = [{{ from = 'a', to = 'b', via = [{via}] }}]\n\
                 grasp = {{ position_mm = {grasp:?}, approach = [0, 0, -1], closing = {closing:?}, width_mm = 8.0 }}\n"
            );
            let part = Part::parse(&text, "wire.toml").unwrap();
            [PoseModel::new(&part), PoseModel::dense(&part)].map(|model| model.per_thickness)
        };
        assert_eq!(per_thickness(100.0, ""), [1, 2]);
        assert_eq!(per_thickness(400.0, ""), [1, 1]);
        assert_eq!(per_thickness(16.0, ""), [3, 3]);
        assert_eq!(per_thickness(4.0, ""), [4, 4]);
        assert_eq!(per_thickness(100.0, "[0, 20, 0]"), [2, 2]);
        assert_eq!(per_thickness(400.0, "[0, 20, 0]"), [1, 1]);
    }

    #[test]
    fn straight_pieces_are_wire_even_of_a_soft_bend() {
        // A quarter of a ring of 60 mm, in chords that a bend radius rounds off.
        let (radius_mm, chords) = (60.0, 24);
        let on_ring = |k: i32| {
            let (sin, cos) = (std::f64::consts::FRAC_PI_2 * f64::from(k) / f64::from(chords)).sin_cos();
            format!("[{:.4}, {:.4}, 0.0]", radius_mm * cos, radius_mm * sin)
        };
        let via: Vec<String> = (1..chords).map(on_ring).collect();
        let text = format!(
            "name = 'arc'\nthickness_mm = 3.0\nbend_radius_mm = 58.0\n\
             node = [{{ name = 'a', position_mm = {} }}, {{ name = 'b', position_mm = {} }}]\n\
             edge = [{{ from = 'a', to = 'b', via = [{}] }}]\n\
             grasp = {{ position_mm = {}, approach = [0, 0, -1], closing = [1, 0, 0], width_mm = 8.0 }}\n",
            on_ring(0),
            on_ring(chords),
            via.join(", "),
            on_ring(chords / 2),
        );
        let model = PoseModel::new(&Part::parse(&text, "arc.toml").unwrap());
        assert!(model.straight_mm.len() > 3);
        for [a, b] in &model.straight_mm {
            let middle = nalgebra::center(a, b);
            let off_mm = (middle.coords.norm() - radius_mm).abs();
            assert!(off_mm < 0.2 * model.radius_mm, "{off_mm} mm off the wire");
        }
    }
}
