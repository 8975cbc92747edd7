//! Straight wire in space, from [stretches](crate::vision::ridge::Stretch) of both pictures, and the rough poses that it
//! holds: a straight part along one line, any other with a corner where two lines meet.
//!
//! In a heap neither the ends nor the corners of a part need be nodes of the graph: a neighbour hides them, or touching
//! wires are one region. Their straight pieces still show as ridges. A stretch of the left and one of the right picture
//! that can be the same wire are a [`SpaceLine`]: where the planes through both and their cameras meet, seen from one
//! place to another. Wire along the baseline has no such line; it is taken to lie level, at the depth that its ends tell.
//!
//! ```
//! use nalgebra::{Isometry3, Point3, Vector3};
//! use pickcell::matching::lines::{Lines, Params};
//! use pickcell::rig::{CameraModel, Rig};
//! use pickcell::time::Budget;
//! use pickcell::vision::ridge::Stretch;
//!
//! let camera = CameraModel::pinhole(640, 480, 600.0, 320.0, 240.0);
//! let rig = Rig { left: camera, right: camera, right_from_left: Isometry3::translation(-60.0, 0.0, 0.0) };
//! // A wire 60 mm long whose middle no picture shows: each sees another piece of it.
//! let at = |along_mm: f64| Point3::new(5.0, -30.0 + along_mm, 480.0 + 0.2 * along_mm);
//! let seen = |project: &dyn Fn(&Point3<f64>) -> nalgebra::Vector2<f64>, from_mm, to_mm| {
//!     let ends_px = [project(&at(from_mm)), project(&at(to_mm))];
//!     Stretch { ends_px, seen_px: (ends_px[1] - ends_px[0]).norm() }
//! };
//! let left = seen(&|p| rig.project_left(p).unwrap(), 0.0, 40.0);
//! let right = seen(&|p| rig.project_right(p).unwrap(), 10.0, 60.0);
//!
//! let mut lines = Lines::new(Params { lines_max: 1, ..Params::default() }, 16);
//! let mut looking = Budget::Iterations(0).looks(1.0); // takes all time it needs
//! lines.run(&rig, [[&left].into_iter(), [&right].into_iter()], &Vector3::z(), 0.7, &mut looking);
//! let line = lines.lines()[0];
//! let wire = (at(60.0) - at(0.0)).normalize();
//! assert!(line.along.cross(&wire).norm() < 1e-6);
//! assert!((at(20.0) - line.origin_mm).cross(&line.along).norm() < 1e-6, "the wire lies on the line");
//! assert!(lines.is_full(), "another would not have found room");
//! ```

use nalgebra::{Isometry3, Point3, Vector2, Vector3};

use super::fitness::{Judge, UNMATCHED};
use super::hypotheses::Hypothesis;
use super::placement::motion_of_directions;
use super::problem::{ANCHORS_MAX, CORNER_SIN_MIN};
use crate::rig::{Rig, StereoGeometry};
use crate::time::Watch;
use crate::vision::ridge::Stretch;

/// What lines need.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params {
    /// Depth of wire in the left camera's frame, in mm.
    pub depth_mm: [f64; 2],
    /// The sine of the angle between the planes of both pictures, at least.
    pub hold_min: f64,
    /// Epipolar distance of the ends of wire along the baseline, at most, in pixels: ridges end up to half a wire early.
    pub end_gap_px_max: f64,
    /// Two places along a line nearer than this are one, in mm: refinement finds either from the other.
    pub same_place_mm: f64,
    /// Two lines that pass each other nearer than this may meet in a corner, in mm: two errors of depth.
    pub corner_mm_max: f64,
    /// The angle of a corner may differ from the model's by this many radians.
    pub angle_tolerance_rad: f64,
    /// Share of the part's wire that must be foreground.
    pub coverage_min: f64,
    /// Most lines.
    pub lines_max: usize,
}

impl Default for Params {
    fn default() -> Self {
        Self {
            depth_mm: [100.0, 2000.0],
            hold_min: 0.02,
            end_gap_px_max: 3.0,
            same_place_mm: 3.0,
            corner_mm_max: 5.0,
            angle_tolerance_rad: 15f64.to_radians(),
            coverage_min: 0.9,
            lines_max: 2048,
        }
    }
}

/// A straight piece of wire in space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpaceLine {
    /// A point of it, left camera's frame.
    pub origin_mm: Point3<f64>,
    /// Unit direction.
    pub along: Vector3<f64>,
    /// Where along it each picture sees it begin and end, from `origin_mm`, in mm.
    pub seen_mm: [[f64; 2]; 2],
}

impl SpaceLine {
    fn at(&self, place_mm: f64) -> Point3<f64> {
        self.origin_mm + self.along * place_mm
    }

    /// What at least one picture sees.
    fn extent_mm(&self) -> [f64; 2] {
        let [l, r] = self.seen_mm;
        [l[0].min(r[0]), l[1].max(r[1])]
    }
}

/// A stretch with the rays through its ends.
#[derive(Clone, Copy, Debug)]
struct Seen {
    rays: [Vector2<f64>; 2],
    /// Normal of the plane through it and its camera, left camera's axes.
    normal: Vector3<f64>,
}

/// Workspace.
#[derive(Clone, Debug)]
pub struct Lines {
    params: Params,
    seen: [Vec<Seen>; 2],
    lines: Vec<SpaceLine>,
}

impl Lines {
    /// Reserves all memory; `stretches_max` a picture.
    pub fn new(params: Params, stretches_max: usize) -> Self {
        let seen = || Vec::with_capacity(stretches_max);
        Self { params, seen: [seen(), seen()], lines: Vec::with_capacity(params.lines_max) }
    }

    /// The lines of the last run.
    pub fn lines(&self) -> &[SpaceLine] {
        &self.lines
    }

    /// Whether there was no room for more in the last run, so that some may have been left out.
    pub fn is_full(&self) -> bool {
        self.lines.len() == self.params.lines_max
    }

    /// Lists the lines that stretches of both pictures show, not steeper than `slope_sin_max` against `down`, until time is
    /// over.
    pub fn run<'a>(
        &mut self,
        rig: &Rig,
        stretches: [impl Iterator<Item = &'a Stretch>; 2],
        down: &Vector3<f64>,
        slope_sin_max: f64,
        looking: &mut Watch,
    ) {
        let geometry = rig.geometry();
        let left_from_right = geometry.rotation.transpose();
        let across = rig.right_from_left_across();
        let [left, right] = stretches;
        let normal = |rays: &[Vector2<f64>; 2]| rays[0].push(1.0).cross(&rays[1].push(1.0)).normalize();
        self.seen.iter_mut().for_each(Vec::clear);
        self.seen[0].extend(left.map(|s| {
            let rays = s.ends_px.map(|p| rig.left.undistort(p));
            Seen { rays, normal: normal(&rays) }
        }));
        self.seen[1].extend(right.map(|s| {
            let rays = s.ends_px.map(|p| rig.right.undistort(p));
            Seen { rays, normal: left_from_right * normal(&rays) }
        }));
        self.lines.clear();
        let Self { params, seen: [left, right], lines } = self;
        let mut keep = |line: SpaceLine| {
            let [from, to] = line.extent_mm();
            let deep = |place: f64| (params.depth_mm[0]..=params.depth_mm[1]).contains(&line.at(place).z);
            if lines.len() < params.lines_max
                && line.along.dot(down).abs() <= slope_sin_max
                && deep(from)
                && deep(to)
                && overlap_share(&line.seen_mm) >= OVERLAP_MIN
            {
                lines.push(line);
            }
        };
        for l in left.iter() {
            if looking.is_over() {
                return;
            }
            let a = across * (l.rays[1] - l.rays[0]);
            for r in right.iter() {
                let b = r.rays[1] - r.rays[0];
                let cos = a.dot(&b) / (a.norm() * b.norm());
                if cos.abs() < DIRECTION_COS_MIN {
                    continue;
                }
                let r = if cos < 0.0 { Seen { rays: [r.rays[1], r.rays[0]], ..*r } } else { *r };
                match held_line(params, &geometry, l, &r) {
                    Some(line) => keep(line),
                    None => level_lines(params, &geometry, down, [l, &r], &mut keep),
                }
            }
        }
    }

    /// Adds the poses of part `part` that the lines hold to `pool`, until that is full or time is over.
    pub fn hypotheses(&self, part: usize, judge: &Judge, looking: &mut Watch, pool: &mut Vec<Hypothesis>) {
        let model = judge.model;
        let mut keep = |pose: Option<Isometry3<f64>>| {
            let Some(left_from_part) = pose.filter(|_| pool.len() < pool.capacity()) else { return };
            let Some(coverage) = judge.coverage(&left_from_part, self.params.coverage_min) else { return };
            let fitness = judge.weights.missing * (1.0 - coverage)
                + judge.weights.unmatched * model.anchors.len() as f64;
            pool.push(Hypothesis { part, left_from_part, fitness, nodes: [UNMATCHED; ANCHORS_MAX] });
        };
        if model.straight {
            let (leg, length_mm) = model.anchors[0].legs[0];
            let from = model.anchors[0].position_mm;
            for line in &self.lines {
                if looking.is_over() {
                    return;
                }
                self.places(line, length_mm, |begin| {
                    keep(motion_of_directions(&from, &line.at(begin), &[(leg, line.along)]))
                });
            }
        } else {
            self.corners(judge, looking, &mut keep);
        }
    }

    /// Where along a line a straight part of this length can begin: it ends where the line is seen to.
    fn places(&self, line: &SpaceLine, length_mm: f64, mut found: impl FnMut(f64)) {
        let [l, r] = line.seen_mm;
        let mut places = [l[0], r[0], l[1] - length_mm, r[1] - length_mm];
        places.sort_unstable_by(f64::total_cmp);
        let mut last = f64::NEG_INFINITY;
        for place in places {
            if place - last > self.params.same_place_mm {
                found(place);
                last = place;
            }
        }
    }

    /// Lays each corner of the model where two lines meet.
    fn corners(&self, judge: &Judge, looking: &mut Watch, keep: &mut impl FnMut(Option<Isometry3<f64>>)) {
        for (i, a) in self.lines.iter().enumerate() {
            if looking.is_over() {
                return;
            }
            for b in &self.lines[i + 1..] {
                let Some((corner, places)) = meeting(a, b, self.params.corner_mm_max) else { continue };
                for anchor in judge.model.anchors.iter().filter(|anchor| !anchor.is_repeated) {
                    for legs in &anchor.corners {
                        let [first, second] = legs.map(|leg| anchor.legs[leg]);
                        for sign in SIGNS {
                            let along = [a.along * sign[0], b.along * sign[1]];
                            let off = along[0].angle(&along[1]) - first.0.angle(&second.0);
                            if off.abs() < self.params.angle_tolerance_rad
                                && shows_leg(a, places[0], sign[0], first.1)
                                && shows_leg(b, places[1], sign[1], second.1)
                            {
                                let pairs = [(first.0, along[0]), (second.0, along[1])];
                                keep(motion_of_directions(&anchor.position_mm, &corner, &pairs));
                            }
                        }
                    }
                }
            }
        }
    }
}

const SIGNS: [[f64; 2]; 4] = [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]];
/// The pictures of a piece of wire differ in direction by less than 30 degrees, as far as slopes are allowed.
const DIRECTION_COS_MIN: f64 = 0.86;
/// What one picture sees of a line the other sees to this share, of the shorter of both.
const OVERLAP_MIN: f64 = 0.5;

fn overlap_share([l, r]: &[[f64; 2]; 2]) -> f64 {
    let both = l[1].min(r[1]) - l[0].max(r[0]);
    both / (l[1] - l[0]).min(r[1] - r[0]).max(1e-9)
}

/// The line where the planes of two stretches meet; `None` where they hold none.
fn held_line(params: &Params, geometry: &StereoGeometry, l: &Seen, r: &Seen) -> Option<SpaceLine> {
    let along = l.normal.cross(&r.normal);
    if along.norm() < params.hold_min {
        return None;
    }
    let along = along.normalize();
    let right_eye = -(geometry.rotation.transpose() * geometry.translation_mm);
    let shown = l.rays[1].push(1.0) - l.rays[0].push(1.0);
    let along = if along.dot(&shown) < 0.0 { -along } else { along };
    let on_left = |ray: &Vector2<f64>| {
        let ray = ray.push(1.0);
        Point3::from(ray * (r.normal.dot(&right_eye) / r.normal.dot(&ray)))
    };
    let on_right = |ray: &Vector2<f64>| {
        let ray = geometry.rotation.transpose() * ray.push(1.0);
        Point3::from(right_eye - ray * (l.normal.dot(&right_eye) / l.normal.dot(&ray)))
    };
    let origin_mm = on_left(&l.rays[0]);
    let place = |p: Point3<f64>| (p - origin_mm).dot(&along);
    let seen_mm = [l.rays.map(|ray| place(on_left(&ray))), r.rays.map(|ray| place(on_right(&ray)))];
    let ordered = seen_mm.iter().all(|s| s[0].is_finite() && s[0] < s[1]);
    // Behind the cameras nothing is seen.
    (ordered && origin_mm.z > 0.0).then_some(SpaceLine { origin_mm, along, seen_mm })
}

/// Lines of two stretches along the baseline: through both ends where both fit, else level through either.
fn level_lines(
    params: &Params,
    geometry: &StereoGeometry,
    down: &Vector3<f64>,
    [l, r]: [&Seen; 2],
    keep: &mut impl FnMut(SpaceLine),
) {
    let end = |k: usize| {
        let gap_px = geometry.epipolar_offset_px(l.rays[k], r.rays[k]).abs();
        let seen = geometry.triangulate(l.rays[k], r.rays[k]).filter(|_| gap_px <= params.end_gap_px_max)?;
        Some(seen.point_left_mm)
    };
    let ends = [end(0), end(1)];
    if let [Some(a), Some(b)] = ends
        && let Some(along) = (b - a).try_normalize(1e-9)
    {
        let seen = [0.0, (b - a).norm()];
        keep(SpaceLine { origin_mm: a, along, seen_mm: [seen, seen] });
    }
    for (k, seen) in ends.iter().enumerate() {
        let Some(at) = seen else { continue };
        let [Some(a), Some(b)] = l.rays.map(|ray| on_level(&ray, at, down)) else { continue };
        let Some(along) = (b - a).try_normalize(1e-9) else { continue };
        let length = (b - a).norm();
        // The seen end is the place itself. The other is as far as the left picture shows: where the right one does, the slope says.
        let origin_mm = if k == 0 { *at } else { at - along * length };
        keep(SpaceLine { origin_mm, along, seen_mm: [[0.0, length]; 2] });
    }
}

/// Where a ray from the left camera meets the level plane, which `down` is at right angles to, through a place; `None` where it
/// does so behind the camera or never.
pub(super) fn on_level(
    ray: &Vector2<f64>,
    through: &Point3<f64>,
    down: &Vector3<f64>,
) -> Option<Point3<f64>> {
    let ray = ray.push(1.0);
    let times = through.coords.dot(down) / ray.dot(down);
    (times > 0.0 && times.is_finite()).then(|| Point3::from(ray * times))
}

/// Where two lines pass each other nearer than `apart_mm_max`: the middle, and its place along both.
fn meeting(a: &SpaceLine, b: &SpaceLine, apart_mm_max: f64) -> Option<(Point3<f64>, [f64; 2])> {
    let cos = a.along.dot(&b.along);
    let sine2 = 1.0 - cos * cos;
    if sine2 < CORNER_SIN_MIN * CORNER_SIN_MIN {
        return None;
    }
    let apart = b.origin_mm - a.origin_mm;
    let (da, db) = (apart.dot(&a.along), apart.dot(&b.along));
    let places = [(da - cos * db) / sine2, (cos * da - db) / sine2];
    let (pa, pb) = (a.at(places[0]), b.at(places[1]));
    ((pa - pb).norm() <= apart_mm_max).then(|| (nalgebra::center(&pa, &pb), places))
}

/// Whether a line is seen where a leg of this length from `place` on, towards `sign`, would lie: over half of
/// what there can be.
fn shows_leg(line: &SpaceLine, place: f64, sign: f64, length_mm: f64) -> bool {
    let [from, to] = line.extent_mm();
    let leg = if sign > 0.0 { [place, place + length_mm] } else { [place - length_mm, place] };
    let shown = to.min(leg[1]) - from.max(leg[0]);
    shown > 0.5 * length_mm.min(to - from)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matching::fitness::Weights;
    use crate::matching::problem::MatchModel;
    use crate::part::Part;
    use crate::rig::CameraModel;
    use crate::time::{Budget, Spent};
    use crate::vision::bits::BitImage;

    const ROD: &str = "name = 'rod'\nthickness_mm = 3.0\n\
        node = [{ name = 'a', position_mm = [-45.0, 0.0, 0.0] }, { name = 'b', position_mm = [45.0, 0.0, 0.0] }]\n\
        edge = [{ from = 'a', to = 'b' }]\n\
        grasp = { position_mm = [0.0, 0.0, 0.0], approach = [0.0, 0.0, -1.0], closing = [0.0, 1.0, 0.0], width_mm = 8.0 }\n";
    const HOOK: &str = "name = 'hook'\nthickness_mm = 2.5\n\
        node = [{ name = 'a', position_mm = [50.0, 0.0, 0.0] }, { name = 'b', position_mm = [0.0, 25.0, 0.0] }]\n\
        edge = [{ from = 'a', to = 'b', via = [[0.0, 0.0, 0.0]] }]\n\
        grasp = { position_mm = [25.0, 0.0, 0.0], approach = [0.0, 0.0, -1.0], closing = [0.0, 1.0, 0.0], width_mm = 8.0 }\n";

    #[test]
    fn level_is_what_the_floor_is_and_not_the_picture() {
        // Cameras pitched by 30 degrees.
        let down = Vector3::new(0.0, 0.5, 0.75f64.sqrt());
        let through = Point3::new(20.0, -30.0, 500.0);
        for ray in [Vector2::new(0.1, 0.2), Vector2::new(-0.2, 0.0), Vector2::new(0.04, -0.06)] {
            let met = on_level(&ray, &through, &down).unwrap();
            assert!(
                (met - through).dot(&down).abs() < 1e-9 && (met.xy().coords / met.z - ray).norm() < 1e-12
            );
        }
        assert_eq!(on_level(&Vector2::new(0.0, -2.0), &through, &down), None);
    }

    /// Poses that the pieces of the part's wire hold, each seen from 0.2 to 0.9 of its length in the left and from 0.1
    /// to 0.9 in the right picture, on masks that are all foreground.
    fn poses(
        part: &str,
        pose: &Isometry3<f64>,
        pieces: &[[Point3<f64>; 2]],
    ) -> (MatchModel, Vec<Hypothesis>) {
        poses_in_time(Budget::Iterations(0), 0.0, part, pose, pieces)
    }

    /// The same with this budget, and the right camera rolled by so much against the left.
    fn poses_in_time(
        budget: Budget,
        roll_rad: f64,
        part: &str,
        pose: &Isometry3<f64>,
        pieces: &[[Point3<f64>; 2]],
    ) -> (MatchModel, Vec<Hypothesis>) {
        let camera = CameraModel::pinhole(640, 480, 600.0, 320.0, 240.0);
        let roll = Isometry3::rotation(Vector3::z() * roll_rad);
        let right_from_left = roll * Isometry3::translation(-60.0, 0.0, 0.0);
        let rig = Rig { left: camera, right: camera, right_from_left };
        let model = MatchModel::new(&Part::parse(part, "test.toml").unwrap());
        let mut mask = BitImage::new(640, 480);
        (0..480).for_each(|y| (0..640).for_each(|x| mask.set(x, y, true)));
        let stretch = |from: f64, [a, b]: &[Point3<f64>; 2], see: &dyn Fn(&Point3<f64>) -> Vector2<f64>| {
            let ends_px = [from, 0.9].map(|t| see(&(pose * (a + (b - a) * t))));
            Stretch { ends_px, seen_px: (ends_px[1] - ends_px[0]).norm() }
        };
        let left: Vec<_> =
            pieces.iter().map(|p| stretch(0.2, p, &|p| rig.project_left(p).unwrap())).collect();
        let right: Vec<_> =
            pieces.iter().map(|p| stretch(0.1, p, &|p| rig.project_right(p).unwrap())).collect();
        let mut lines = Lines::new(Params::default(), 64);
        let mut looking = budget.looks(1.0);
        lines.run(&rig, [left.iter(), right.iter()], &Vector3::z(), 0.8, &mut looking);
        let mut pool = Vec::with_capacity(256);
        let judge = Judge {
            rig: &rig,
            masks: [&mask, &mask],
            model: &model,
            weights: Weights::default(),
            length_tolerance_mm: 6.0,
            level: crate::level::Level::detect(),
        };
        lines.hypotheses(0, &judge, &mut looking, &mut pool);
        (model, pool)
    }

    fn farthest_mm(model: &MatchModel, a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
        model.anchors.iter().map(|p| (a * p.position_mm - b * p.position_mm).norm()).fold(0.0, f64::max)
    }

    #[test]
    fn a_straight_part_has_no_bends_wherever_its_file_has_a_via() {
        let rod = ROD.replace("to = 'b'", "to = 'b', via = [[20.0, 0.0, 0.0]]");
        let model = MatchModel::new(&Part::parse(&rod, "r.toml").unwrap());
        assert!(model.straight && model.anchors.len() == 2);
        assert_eq!(model.anchors[0].legs[0].1, 90.0);
    }

    #[test]
    fn a_straight_part_lies_along_its_line_from_where_it_is_seen() {
        let pose = Isometry3::new(Vector3::new(5.0, -8.0, 500.0), Vector3::new(0.0, 0.1, 1.2));
        let ends = [Point3::new(-45.0, 0.0, 0.0), Point3::new(45.0, 0.0, 0.0)];
        for roll_rad in [0.0, 0.7, 1.6, 3.1] {
            let (model, pool) = poses_in_time(Budget::Iterations(0), roll_rad, ROD, &pose, &[ends]);
            // The right picture shows all but a tenth: nearer than its 9 mm no place is told.
            assert!(pool.iter().any(|h| farthest_mm(&model, &h.left_from_part, &pose) < 9.1), "{roll_rad}");
            assert!(pool.iter().all(|h| {
                let begin = pose.inverse() * h.left_from_part * ends[0];
                begin.y.hypot(begin.z) < 0.01
            }));
        }
    }

    #[test]
    fn nothing_is_looked_for_once_time_is_over() {
        let pose = Isometry3::new(Vector3::new(5.0, -8.0, 500.0), Vector3::new(0.0, 0.1, 1.2));
        let ends = [Point3::new(-45.0, 0.0, 0.0), Point3::new(45.0, 0.0, 0.0)];
        // Over before the one line is found, before a part is laid along it, and after that.
        let found = [0, 1, 2].map(|looks| {
            let budget = Budget::Repeated(Spent { looks: Some(looks), ..Spent::default() });
            poses_in_time(budget, 0.0, ROD, &pose, &[ends]).1.len()
        });
        assert!(found[..2] == [0, 0] && found[2] > 0, "{found:?}");
    }

    #[test]
    fn a_bent_part_lies_where_two_lines_meet() {
        let pose = Isometry3::new(Vector3::new(5.0, -8.0, 500.0), Vector3::new(0.1, 0.0, 0.6));
        let corner = Point3::origin();
        let pieces = [[corner, Point3::new(50.0, 0.0, 0.0)], [corner, Point3::new(0.0, 25.0, 0.0)]];
        let (model, pool) = poses(HOOK, &pose, &pieces);
        assert!(pool.iter().any(|h| farthest_mm(&model, &h.left_from_part, &pose) < 0.5), "{pool:?}");
        assert!(poses(HOOK, &pose, &pieces[..1]).1.is_empty(), "one leg holds no pose");
    }
}
