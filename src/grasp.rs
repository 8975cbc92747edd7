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
//! let placed = |left_from_part| Placed { part: &rod, model: &model, left_from_part, sigma_mm: 0.2 };
//! let all = [placed(&below), placed(&above)];
//!
//! let params = Params::default();
//! let why = [0, 1].map(|i| blocked(&params, &all, i, &grasp_of(&params, &all[i])));
//! assert_eq!(why, [Some(Blocked::Covered), None]);
//! # Ok::<(), pickcell::part::PartError>(())
//! ```

use firmware_bridge::config::{Gripper, Workspace};
use firmware_bridge::message::ArmAxes;
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};

use crate::part::Part;
use crate::pose::model::PoseModel;

/// Why a recognised part is not offered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum Blocked {
    /// Another recognised part crosses over it.
    #[error("another part lies on it")]
    Covered,
    /// Something in the way of a finger.
    #[error("no room for the fingers")]
    NoRoom,
    /// Wire that no recognised part has shows where the fingers go, or where something crosses the part.
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
    /// The parts together tell that the right camera has turned, and by so much that not all of it is allowed for.
    #[error("the right camera does not stand as it was calibrated")]
    Turned,
    /// The budget was spent before all wire was looked at: what may lie on the part is not known.
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
    /// Largest standard deviation of the position, mm.
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
            sigma_mm_max: 3.0,
        }
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
    /// Largest standard deviation of its position, mm.
    pub sigma_mm: f64,
}

/// How far apart the axes of two wires must be in height, in sums of their radii, for one to lie on the other rather
/// than beside it. Where they cross it is 1 or more, less the error of two depths.
const OVER_MIN: f64 = 0.5;

/// Direction straight down in the left camera's frame.
pub fn down_in_left(params: &Params) -> Vector3<f64> {
    match &params.base_from_left {
        Some(base_from_left) => base_from_left.rotation.inverse() * -Vector3::z(),
        None => Vector3::z(),
    }
}

/// How far apart the fingers are when they come down on a part.
pub fn opening_mm(gripper: &Gripper, part: &Part) -> f64 {
    part.grasp.width_mm.max(part.thickness_mm + gripper.clearance_mm)
}

/// The grasp of a part, whether or not it can be reached.
pub fn grasp_of(params: &Params, placed: &Placed) -> Grasp {
    let out_from_left = params.base_from_left.unwrap_or_default();
    let out_from_part = out_from_left * placed.left_from_part;
    let down = if params.base_from_left.is_some() { -Vector3::z() } else { Vector3::z() };
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
    }
}

/// Why the part `index` of `all` cannot be taken with `grasp`; `None` where it can.
pub fn blocked(params: &Params, all: &[Placed], index: usize, grasp: &Grasp) -> Option<Blocked> {
    let gripper = &params.gripper;
    if all[index].sigma_mm > params.sigma_mm_max {
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
    if params.axes == ArmAxes::Xyz
        && yaw_off_rad(grasp, gripper.closing_yaw_deg.to_radians()) > params.yaw_tolerance_rad
    {
        return Some(Blocked::ArmCannotTurn);
    }
    if all.iter().enumerate().any(|(k, other)| k != index && lies_over(params, other, &all[index])) {
        return Some(Blocked::Covered);
    }
    let others = all.iter().enumerate().filter(|(k, _)| *k != index).map(|(_, p)| p);
    (!fingers_fit(params, others, grasp)).then_some(Blocked::NoRoom)
}

/// Angle between the closing direction and a fixed gripper's, in the horizontal plane; the fingers are alike.
fn yaw_off_rad(grasp: &Grasp, closing_yaw_rad: f64) -> f64 {
    let closing = grasp.orientation * Vector3::x();
    let off = (closing.y.atan2(closing.x) - closing_yaw_rad).rem_euclid(std::f64::consts::PI);
    off.min(std::f64::consts::PI - off)
}

/// Whether `upper` crosses over `lower`, seen straight from above.
pub fn lies_over(params: &Params, upper: &Placed, lower: &Placed) -> bool {
    let down = down_in_left(params);
    let reach = upper.model.radius_mm + lower.model.radius_mm;
    // In the lower part's frame its stations stand as they are.
    let lower_from_upper = lower.left_from_part.inverse() * upper.left_from_part;
    let down = lower.left_from_part.rotation.inverse() * down;
    let beside = |apart: &Vector3<f64>| (apart - down * down.dot(apart)).norm_squared();
    let far = (upper.model.length_mm + lower.model.length_mm) / 2.0 + reach;
    let centre = lower.model.centre_mm;
    if beside(&(lower_from_upper * upper.model.centre_mm - centre)) > far * far {
        return false;
    }
    let [above, below] = [upper, lower].map(|p| &p.model.stations);
    upper.model.clusters.iter().any(|high| {
        let centre = lower_from_upper * high.centre_mm;
        lower.model.clusters.iter().any(|low| {
            let near = high.reach_mm + low.reach_mm + reach;
            beside(&(centre - low.centre_mm)) < near * near
                && above[high.stations.clone()].iter().any(|u| {
                    let at = lower_from_upper * u.position_mm;
                    below[low.stations.clone()].iter().any(|l| {
                        let apart = at - l.position_mm;
                        // Stations lie nearer to each other than a thickness: no crossing falls between them.
                        -down.dot(&apart) > OVER_MIN * reach && beside(&apart) < reach * reach
                    })
                })
        })
    })
}

/// How far from the tool point the open fingers reach, in mm, across the approach.
pub fn fingers_reach_mm(gripper: &Gripper, grasp: &Grasp) -> f64 {
    (grasp.opening_mm / 2.0 + gripper.finger_thickness_mm).hypot(gripper.finger_width_mm / 2.0)
}

/// Whether both fingers can come down beside the wire without meeting another part.
fn fingers_fit<'a>(params: &Params, mut others: impl Iterator<Item = &'a Placed<'a>>, grasp: &Grasp) -> bool {
    let gripper = &params.gripper;
    let out_from_left = params.base_from_left.unwrap_or_default();
    let tool_from_out = grasp.orientation.inverse();
    let inner = grasp.opening_mm / 2.0;
    let outer = inner + gripper.finger_thickness_mm;
    !others.any(|other| {
        let radius = other.model.radius_mm;
        let tool_from_part = out_from_left * other.left_from_part;
        other.model.stations.iter().any(|s| {
            let at = tool_from_out * (tool_from_part * s.position_mm - grasp.position_mm);
            let x = at.x.abs();
            x > inner - radius
                && x < outer + radius
                && at.y.abs() < gripper.finger_width_mm / 2.0 + radius
                && at.z < gripper.finger_depth_mm + radius
        })
    })
}
