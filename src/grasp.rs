//! From poses to targets: where and how the gripper takes each part, and why it does not take the others.
//!
//! Takes the recognised parts of a pair, gives for each a [`Grasp`] and the reason why it is blocked, if it is, and
//! ranks them. The tool's z axis is the approach, its x axis the closing direction of the fingers, so that its y axis
//! is the wire. Wire is round: the approach of the part file may turn about it, and the direction nearest to straight
//! down is taken.
//!
//! ```
//! use nalgebra::Isometry3;
//! use pickcell::grasp::{Blocked, Params, Placed, blocked, grasp_of};
//! use pickcell::part::Part;
//! use pickcell::pose::model::PoseModel;
//!
//! let rod = Part::read(concat!(env!("CARGO_MANIFEST_DIR"), "/replay/parts/rod-90.toml"))?;
//! let model = PoseModel::new(&rod);
//! // In the left camera's frame, z down: one rod on the floor, another across its middle.
//! let below = Isometry3::translation(0.0, 0.0, 480.0);
//! let above = Isometry3::new(nalgebra::Vector3::new(0.0, 0.0, 474.0), nalgebra::Vector3::z() * 1.57);
//! let sigma_mm = nalgebra::Vector3::repeat(0.2);
//! let placed = |left_from_part| Placed { part: &rod, model: &model, left_from_part, sigma_mm };
//! let all = [placed(&below), placed(&above)];
//!
//! let params = Params::default();
//! let mut grasps = all.map(|placed| grasp_of(&params, &placed));
//! let mut why = [None; 2];
//! blocked(&params, &all, &mut grasps, &mut why);
//! assert_eq!(why, [Some(Blocked::Covered), None]);
//! # Ok::<(), pickcell::part::PartError>(())
//! ```

pub use firmware_bridge::config::{Gripper, Workspace};
pub use firmware_bridge::message::ArmAxes;
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};

use crate::part::Part;
use crate::pose::model::{PoseModel, Station};

/// Why a recognised part is not offered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum Blocked {
    /// Another recognised part crosses over it.
    #[error("another part lies on it")]
    Covered,
    /// Something in the way of a finger.
    #[error("no room for the fingers")]
    NoRoom,
    /// Wire that no recognised part has shows where the fingers go, something lies on the part, or its wire is interrupted.
    #[error("something unknown is in the way")]
    Unknown,
    /// The tool point of the grasp, its approach or its retreat is outside the box.
    #[error("outside the workspace")]
    OutsideWorkspace,
    /// The approach is tilted more than the workspace allows.
    #[error("tilted too far")]
    TiltedTooFar,
    /// The arm's axes cannot take this tilt.
    #[error("the arm cannot tilt to it")]
    ArmCannotTilt,
    /// The arm's axes cannot take this turn about the vertical.
    #[error("the arm cannot turn to it")]
    ArmCannotTurn,
    /// The part's width needs a wider gripper.
    #[error("wider than the gripper opens")]
    TooWide,
    /// The pose is not known well enough.
    #[error("pose too uncertain")]
    Uncertain,
    /// It may lie elsewhere, or be something else: see [`is_proven`](crate::matching::select::is_proven).
    #[error("not proved by what is seen")]
    Unproven,
    /// The parts together tell that the right camera has turned, and by so much that not all of it is allowed for.
    #[error("the right camera does not stand as it was calibrated")]
    Turned,
    /// Time was over before all wire was looked at and all parts weighed: what may lie on the part is not known.
    #[error("search cut short before all wire was looked at")]
    OutOfTime,
}

/// What limits the grasps.
#[derive(Clone, Debug, PartialEq)]
pub struct Params {
    /// Pose of the left camera in the robot's base; `None`: grasps are in the left camera's frame, and its z axis
    /// is taken for straight down.
    pub base_from_left: Option<Isometry3<f64>>,
    /// Box and tilt; only with `base_from_left`.
    pub workspace: Option<Workspace>,
    /// Sizes of the gripper.
    pub gripper: Gripper,
    /// What the arm can turn.
    pub axes: ArmAxes,
    /// Tilt that an arm without tilting axes still takes, radians.
    pub tilt_tolerance_rad: f64,
    /// Turn that an arm without a yaw axis still takes, radians.
    pub yaw_tolerance_rad: f64,
    /// Largest standard deviation of the position, mm: twice that, and fingers pass thin wire.
    pub sigma_mm_max: f64,
}

impl Default for Params {
    fn default() -> Self {
        Self {
            base_from_left: None,
            workspace: None,
            gripper: Gripper::default(),
            axes: ArmAxes::Pose,
            tilt_tolerance_rad: 10f64.to_radians(),
            yaw_tolerance_rad: 10f64.to_radians(),
            sigma_mm_max: 1.5,
        }
    }
}

impl Params {
    /// Whether a position with these standard deviations, mm, is known well enough. What is not a number is not.
    pub fn is_certain(&self, sigma_mm: &Vector3<f64>) -> bool {
        sigma_mm.iter().all(|sigma| *sigma <= self.sigma_mm_max)
    }
}

/// How the gripper takes a part, in the base frame (without one: in the left camera's).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grasp {
    /// Tool point.
    pub position_mm: Point3<f64>,
    /// Unit direction of the wire: approach × closing.
    pub axis: Vector3<f64>,
    /// Tool in that frame: z along the approach, x along the closing direction.
    pub orientation: UnitQuaternion<f64>,
    /// Distance of the fingers when they come down.
    pub opening_mm: f64,
    /// Angle of the approach to straight down, radians.
    pub tilt_rad: f64,
    /// How far along its axis it is from where the part file has it, mm.
    pub slid_mm: f64,
}

impl Grasp {
    /// The same, so much farther along the wire.
    fn slid(&self, by_mm: f64) -> Self {
        Self { position_mm: self.position_mm + self.axis * by_mm, slid_mm: self.slid_mm + by_mm, ..*self }
    }

    /// The tool point in the left camera's frame.
    pub fn position_left_mm(&self, params: &Params) -> Point3<f64> {
        params.base_from_left.unwrap_or_default().inverse() * self.position_mm
    }
}

/// A part in its place, as grasping sees it.
#[derive(Clone, Copy)]
pub struct Placed<'a> {
    /// The part.
    pub part: &'a Part,
    /// Its stations.
    pub model: &'a PoseModel,
    /// Its pose.
    pub left_from_part: &'a Isometry3<f64>,
    /// Standard deviations of its position along the axes of the base (without one: of the left camera), mm.
    pub sigma_mm: Vector3<f64>,
}

/// How far apart the axes of two wires must be in height, for one to lie on the other rather than beside it, as a share of how
/// far apart they are where they touch: the sum of their radii where they cross, less where one hangs over the other's edge.
const OVER_MIN: f64 = 0.5;
/// How many standard deviations of the difference in height make it sure.
const SURE_SIGMAS: f64 = 2.0;
/// Nearer beside each other than this, in sums of their radii, they do not lie along each other.
const OVERHANG_MAX: f64 = 0.9;
/// How far apart the axes of two wires of about the same height are beside each other at least, in sums of their radii.
/// Where they lie along each other it is 1, less the error of two places.
const BESIDE_MIN: f64 = 0.6;

/// In which steps a grasp slides along the wire, mm, and in how many at most either way.
const SLIDE_STEP_MM: f64 = 2.0;
const SLIDE_STEPS_MAX: f64 = 16.0;

/// A part's own wire no farther from the line of the wire that is gripped, in its radii, goes on along it.
const GRIPPED_RADII: f64 = 1.5;

/// Direction straight down in the left camera's frame.
pub fn down_in_left(params: &Params) -> Vector3<f64> {
    params.base_from_left.unwrap_or_default().rotation.inverse() * down(params)
}

/// Direction straight down in the frame of the grasps.
fn down(params: &Params) -> Vector3<f64> {
    if params.base_from_left.is_some() { -Vector3::z() } else { Vector3::z() }
}

/// How far apart the fingers are when they come down on a part.
pub fn opening_mm(gripper: &Gripper, part: &Part) -> f64 {
    part.grasp.width_mm.max(part.thickness_mm + gripper.clearance_mm)
}

/// The grasp of a part, whether or not it can be reached.
pub fn grasp_of(params: &Params, placed: &Placed) -> Grasp {
    let out_from_left = params.base_from_left.unwrap_or_default();
    let out_from_part = out_from_left * placed.left_from_part;
    let down = down(params);
    let file = &placed.part.grasp;
    let wire = (out_from_part * file.approach.cross(&file.closing)).normalize();
    let as_filed = out_from_part * file.approach.into_inner();
    let steepest = down - wire * wire.dot(&down);
    // A wire that stands upright has no steepest approach; the part file's own then serves.
    let approach = steepest.try_normalize(1e-3).unwrap_or(as_filed);
    let closing = wire.cross(&approach);
    // The fingers are alike: of the two ways to close, the one nearer to base x.
    let (closing, wire) = if closing.x < 0.0 { (-closing, -wire) } else { (closing, wire) };
    let axes = Matrix3::from_columns(&[closing, wire, approach]);
    let gripper = &params.gripper;
    Grasp {
        position_mm: out_from_part * file.position_mm,
        axis: wire,
        orientation: UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes)),
        opening_mm: opening_mm(gripper, placed.part),
        tilt_rad: approach.angle(&down),
        slid_mm: 0.0,
    }
}

/// The grasp with the approach of the part file, which need not be the steepest.
fn as_filed(params: &Params, placed: &Placed, grasp: &Grasp) -> Grasp {
    let out_from_part = params.base_from_left.unwrap_or_default() * placed.left_from_part;
    let file = &placed.part.grasp;
    let [closing, approach] = [file.closing, file.approach].map(|way| out_from_part * way.into_inner());
    let axes = Matrix3::from_columns(&[closing, approach.cross(&closing), approach]);
    Grasp {
        orientation: UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes)),
        ..*grasp
    }
}

/// Why parts cannot be taken, each with its grasp; `None` for those that can. A grasp for which there is no room, or that
/// is outside the workspace, slides along the wire as far as the part file allows to the nearest place where neither is so.
///
/// Parts beyond the last of `grasps` are asked only for what crosses over them.
///
/// # Panics
/// Where `why` has not a place for every part, or there are more `grasps` than parts.
pub fn blocked(params: &Params, all: &[Placed], grasps: &mut [Grasp], why: &mut [Option<Blocked>]) {
    why[..all.len()].fill(None);
    for (k, first) in all.iter().enumerate() {
        for (other, second) in all[..k].iter().enumerate() {
            let crossing = crossing(params, first, second);
            for (index, is_covered) in [(other, crossing.first_over), (k, crossing.second_over)] {
                if is_covered {
                    why[index] = Some(Blocked::Covered);
                } else if crossing.is_unclear {
                    why[index].get_or_insert(Blocked::Uncertain);
                }
            }
        }
    }
    for (index, (grasp, why)) in grasps.iter_mut().zip(why).enumerate() {
        let by_crossing = *why;
        let reason = |grasp: &Grasp| {
            // What of the part's own wire they meet where and as the part file has them come, its author wants.
            let is_wanted = |placed: &Placed| {
                grasp.slid_mm == 0.0 && meets_fingers(params, placed, &as_filed(params, placed, grasp), true)
            };
            let is_in_the_way = |(k, placed): (usize, &Placed)| {
                let its_own = k == index;
                meets_fingers(params, placed, grasp, its_own) && !(its_own && is_wanted(placed))
            };
            let has_no_room = || all.iter().enumerate().any(is_in_the_way);
            out_of_reach(params, &all[index], grasp)
                .or(by_crossing)
                .or_else(|| has_no_room().then_some(Blocked::NoRoom))
        };
        *why = reason(grasp);
        if matches!(why, Some(Blocked::NoRoom | Blocked::OutsideWorkspace)) && by_crossing.is_none() {
            let mut slid = slides_mm(all[index].part.grasp.slide_mm).map(|by_mm| grasp.slid(by_mm));
            if let Some(free) = slid.find(|grasp| reason(grasp).is_none()) {
                (*grasp, *why) = (free, None);
            }
        }
    }
}

/// The places to which a grasp is tried to slide, the nearest first, either way up to this.
fn slides_mm(most_mm: f64) -> impl Iterator<Item = f64> {
    let steps = (most_mm / SLIDE_STEP_MM).ceil().min(SLIDE_STEPS_MAX);
    (1..=steps as usize).flat_map(move |k| [1.0, -1.0].map(|way| way * most_mm * k as f64 / steps))
}

/// Why a part cannot be taken, were it alone in the bin.
fn out_of_reach(params: &Params, placed: &Placed, grasp: &Grasp) -> Option<Blocked> {
    let gripper = &params.gripper;
    if !params.is_certain(&placed.sigma_mm) || !grasp.position_mm.iter().all(|mm| mm.is_finite()) {
        return Some(Blocked::Uncertain);
    }
    if grasp.opening_mm > gripper.opening_max_mm {
        return Some(Blocked::TooWide);
    }
    if let (Some(workspace), true) = (&params.workspace, params.base_from_left.is_some()) {
        if grasp.tilt_rad > workspace.tilt_max_deg.to_radians() {
            return Some(Blocked::TiltedTooFar);
        }
        let approach = grasp.orientation * Vector3::z();
        let reached = [
            grasp.position_mm,
            grasp.position_mm - approach * gripper.approach_mm,
            grasp.position_mm + Vector3::z() * gripper.retreat_mm,
        ];
        let inside =
            |p: &Point3<f64>| (0..3).all(|k| (workspace.min_mm[k]..=workspace.max_mm[k]).contains(&p[k]));
        if !reached.iter().all(inside) {
            return Some(Blocked::OutsideWorkspace);
        }
    }
    if params.axes != ArmAxes::Pose && grasp.tilt_rad > params.tilt_tolerance_rad {
        return Some(Blocked::ArmCannotTilt);
    }
    let yaw_off_rad = || yaw_off_rad(grasp, gripper.closing_yaw_deg.to_radians());
    (params.axes == ArmAxes::Xyz && yaw_off_rad() > params.yaw_tolerance_rad)
        .then_some(Blocked::ArmCannotTurn)
}

/// Angle between the closing direction and a fixed gripper's, in the horizontal plane; the fingers are alike.
fn yaw_off_rad(grasp: &Grasp, closing_yaw_rad: f64) -> f64 {
    let closing = grasp.orientation * Vector3::x();
    let off = (closing.y.atan2(closing.x) - closing_yaw_rad).rem_euclid(std::f64::consts::PI);
    off.min(std::f64::consts::PI - off)
}

/// What is seen straight from above where the wires of two parts cross.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Crossing {
    /// Somewhere the first part lies over the second.
    pub first_over: bool,
    /// Somewhere the second lies over the first.
    pub second_over: bool,
    /// Somewhere they cross, and their heights, in which nothing has them touch, do not tell which lies on top: they are about
    /// the same, and wires do not go through each other; or they are not known well enough.
    pub is_unclear: bool,
}

impl Crossing {
    /// Where a piece of the first is so far above and beside one of the second, and is surely one of them above the other from
    /// some height on; all in sums of their radii.
    fn note(&mut self, above: f64, beside: f64, surely: f64) {
        if beside < 1.0 {
            let touching = if beside < OVERHANG_MAX { (1.0 - beside * beside).sqrt() } else { 1.0 };
            let over = OVER_MIN * touching;
            self.first_over |= above > over;
            self.second_over |= above < -over;
            self.is_unclear |= beside < BESIDE_MIN && above.abs() <= surely;
        }
    }
}

/// How two parts cross.
pub fn crossing(params: &Params, first: &Placed, second: &Placed) -> Crossing {
    let down = down_in_left(params);
    let reach_mm = first.model.radius_mm + second.model.radius_mm;
    let far_mm = (first.model.length_mm + second.model.length_mm) / 2.0 + reach_mm;
    let [a, b] = [first, second].map(|part| part.left_from_part * part.model.centre_mm);
    let mut seen = Crossing::default();
    if beside_squared(&(a - b), &down) > far_mm * far_mm {
        return seen;
    }
    // In the second part's frame its stations stand as they are.
    let from_first = second.left_from_part.inverse() * first.left_from_part;
    let (turn, shift) = (from_first.rotation.to_rotation_matrix(), from_first.translation);
    let down = second.left_from_part.rotation.inverse() * down;
    let is_near = |apart: &Vector3<f64>, mm: f64| beside_squared(apart, &down) < mm * mm;
    let surely = OVER_MIN.max(SURE_SIGMAS * first.sigma_mm.z.hypot(second.sigma_mm.z) / reach_mm);
    let clusters =
        first.model.clusters.iter().flat_map(|a| second.model.clusters.iter().map(move |b| (a, b)));
    for (many, others) in clusters {
        let apart = shift * (turn * many.centre_mm) - others.centre_mm;
        if !is_near(&apart, many.reach_mm + others.reach_mm + reach_mm) {
            continue;
        }
        for a in &first.model.stations[many.stations.clone()] {
            let at = shift * (turn * a.position_mm);
            let lengths_mm = |b: &Station| (a.length_mm + b.length_mm) / 2.0;
            let others = second.model.stations[others.stations.clone()].iter();
            for b in others.filter(|b| is_near(&(at - b.position_mm), lengths_mm(b) + reach_mm)) {
                let halves = [turn * a.tangent * (a.length_mm / 2.0), b.tangent * (b.length_mm / 2.0)];
                let apart = nearest_from_above(&(at - b.position_mm), &halves, &down);
                let beside = beside_squared(&apart, &down).max(0.0).sqrt() / reach_mm;
                seen.note(-down.dot(&apart) / reach_mm, beside, surely);
            }
        }
    }
    seen
}

/// Square of the distance that two places, so far apart, have seen along `down`.
fn beside_squared(apart: &Vector3<f64>, down: &Vector3<f64>) -> f64 {
    apart.norm_squared() - down.dot(apart).powi(2)
}

/// From the second of two straight pieces to the first, where they are nearest to each other seen along `down`. Their
/// middles are `apart`, and each reaches from its middle by its vector, and as far the other way.
fn nearest_from_above(
    apart: &Vector3<f64>,
    [first, second]: &[Vector3<f64>; 2],
    down: &Vector3<f64>,
) -> Vector3<f64> {
    let [a, u, v] = [apart, first, second].map(|vector| vector - down * down.dot(vector));
    // What stands upright is a point, seen from above.
    let [uu, vv] = [&u, &v].map(|piece| piece.norm_squared().max(1e-12));
    let uv = u.dot(&v);
    let across = uu * vv - uv * uv;
    let to = if across > 1e-9 * uu * vv { (uv * v.dot(&a) - vv * u.dot(&a)) / across } else { 0.0 };
    let of_second = ((uv * to.clamp(-1.0, 1.0) + v.dot(&a)) / vv).clamp(-1.0, 1.0);
    let of_first = ((uv * of_second - u.dot(&a)) / uu).clamp(-1.0, 1.0);
    apart + first * of_first - second * of_second
}

/// How far from the tool point the open fingers reach, in mm, across the approach.
pub fn fingers_reach_mm(gripper: &Gripper, grasp: &Grasp) -> f64 {
    (grasp.opening_mm / 2.0 + gripper.finger_thickness_mm).hypot(gripper.finger_width_mm / 2.0)
}

/// Whether a part is met by the fingers that come down beside a wire and rise with it, or lies between them and would be
/// gripped as well; but for the wire itself, where it is `its_own`.
fn meets_fingers(params: &Params, placed: &Placed, grasp: &Grasp, its_own: bool) -> bool {
    let gripper = &params.gripper;
    let out_from_left = params.base_from_left.unwrap_or_default();
    let tool_from_out = Isometry3::from_parts(grasp.position_mm.into(), grasp.orientation).inverse();
    let tool_from_left = tool_from_out * out_from_left;
    // The part's own wires rise with the fingers.
    let retreat_mm = if its_own { 0.0 } else { gripper.retreat_mm };
    let retreat = tool_from_out * -down(params) * retreat_mm;
    // In shares of the retreat: while a place, which sinks past the fingers then, is within a distance of their middle.
    let within = |at: f64, by: f64, mm: f64| {
        let [a, b] = [(at - mm) / by, (at + mm) / by];
        match by.abs() < 1e-9 {
            true if at.abs() < mm => [0.0, 1.0],
            true => [1.0, 0.0],
            false => [a.min(b), a.max(b)],
        }
    };
    // What is so thick there, in the tool's axes.
    let is_met = |at: &Vector3<f64>, radius_mm: f64| {
        let across_mm = grasp.opening_mm / 2.0 + gripper.finger_thickness_mm + radius_mm;
        let x = within(at.x, retreat.x, across_mm);
        let y = within(at.y, retreat.y, gripper.finger_width_mm / 2.0 + radius_mm);
        let (from, to) = (x[0].max(y[0]).max(0.0), x[1].min(y[1]).min(1.0));
        // It is deepest at one end of that.
        let depth_mm = |share: f64| at.z - retreat.z * share;
        from < to && depth_mm(from).min(depth_mm(to)) < gripper.finger_depth_mm + radius_mm
    };
    let Placed { model, left_from_part, .. } = placed;
    let tool_from_part = tool_from_left * *left_from_part;
    let (turn, shift) = (tool_from_part.rotation.to_rotation_matrix(), tool_from_part.translation);
    let at = |place: &Point3<f64>| (shift * (turn * place)).coords;
    let is_gripped = |at: &Vector3<f64>| its_own && at.xz().norm() < GRIPPED_RADII * model.radius_mm;
    let clusters = model.clusters.iter();
    clusters.filter(|c| is_met(&at(&c.centre_mm), c.reach_mm + model.radius_mm)).any(|cluster| {
        model.stations[cluster.stations.clone()].iter().any(|s| {
            let (at, quarter) = (at(&s.position_mm), turn * s.tangent * (s.length_mm / 4.0));
            [at - quarter, at + quarter].iter().any(|at| !is_gripped(at) && is_met(at, model.radius_mm))
        })
    })
}

#[cfg(test)]
mod tests;
