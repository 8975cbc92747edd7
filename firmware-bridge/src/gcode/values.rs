//! The named values of a template: which names there are, and their numbers for a pick.

use crate::config::{Gripper, Moves};
use crate::message::{ArmAxes, Pick, Pose, Waypoint};

/// A value as the compiled template holds it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Slot {
    /// A number from the text or from `arm.moves.values`, with its decimals.
    Literal(f64, u8),
    /// A part of one of the four poses.
    Pose(Waypoint, Part),
    /// The highest z of the four poses: the height for moves across the cell.
    TravelZ,
    /// Distance of the fingers at the approach, mm.
    Opening,
    /// The same as thousandths of `gripper.opening_max_mm`.
    OpeningPermille,
    /// Number of the place slot.
    PlaceNumber,
}

/// A part of a pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Part {
    /// Coordinate of the tool point: 0 = x, 1 = y, 2 = z, mm.
    Axis(u8),
    /// Direction in which the fingers close, degrees about base z from base x.
    Yaw,
    /// Turn about base y, degrees (angles in the order z, y, x).
    Pitch,
    /// Turn about base x, degrees.
    Roll,
    /// Angle of a wrist servo that turns with the arm's base (uArm): 90 = fingers close along the arm, 0 to 180.
    Wrist,
}

const PARTS: [(&str, Part); 7] = [
    ("x", Part::Axis(0)),
    ("y", Part::Axis(1)),
    ("z", Part::Axis(2)),
    ("yaw", Part::Yaw),
    ("pitch", Part::Pitch),
    ("roll", Part::Roll),
    ("wrist", Part::Wrist),
];

const WAYPOINTS: [(&str, Waypoint); 4] = [
    ("approach", Waypoint::Approach),
    ("grasp", Waypoint::Grasp),
    ("retreat", Waypoint::Retreat),
    ("place", Waypoint::Place),
];

const OTHERS: [(&str, Slot); 4] = [
    ("travel_z", Slot::TravelZ),
    ("opening", Slot::Opening),
    ("opening_permille", Slot::OpeningPermille),
    ("slot", Slot::PlaceNumber),
];

/// The slot of a built-in name.
pub(crate) fn built_in(name: &str) -> Option<Slot> {
    if let Some((_, slot)) = OTHERS.iter().find(|(other, _)| *other == name) {
        return Some(*slot);
    }
    let (waypoint, part) = name.split_once('_')?;
    let (_, waypoint) = WAYPOINTS.iter().find(|(n, _)| *n == waypoint)?;
    let (_, part) = PARTS.iter().find(|(n, _)| *n == part)?;
    Some(Slot::Pose(*waypoint, *part))
}

/// The slot of a name: built in, or one of `arm.moves.values`.
pub(crate) fn slot(name: &str, moves: &Moves) -> Option<Slot> {
    built_in(name).or_else(|| moves.values.get(name).map(|&value| Slot::Literal(value, 3)))
}

/// The names there are, for a message.
pub(crate) fn known(moves: &Moves) -> String {
    let mut text = String::from(
        "there are {approach_…}, {grasp_…}, {retreat_…}, {place_…} with x, y, z, yaw, pitch, roll or wrist, {travel_z}, {opening}, {opening_permille}, {slot}",
    );
    for name in moves.values.keys() {
        text.push_str(&format!(", {{{name}}}"));
    }
    text.push_str("; your own go into arm.moves.values");
    text
}

impl Slot {
    /// How many decimals it is written with.
    pub(crate) fn decimals(self) -> u8 {
        match self {
            Slot::Literal(_, decimals) => decimals,
            Slot::Pose(_, Part::Axis(_)) | Slot::TravelZ => 3,
            Slot::Pose(..) | Slot::Opening => 2,
            Slot::OpeningPermille | Slot::PlaceNumber => 0,
        }
    }

    /// The most characters that it can take.
    pub(crate) fn width_max(self) -> usize {
        match self {
            Slot::Literal(value, decimals) => format!("{value:.*}", usize::from(decimals)).len(),
            Slot::Pose(_, Part::Axis(_)) | Slot::TravelZ => "-100000.000".len(),
            Slot::Pose(..) | Slot::Opening => "-180.00".len(),
            Slot::OpeningPermille => "1000".len(),
            Slot::PlaceNumber => "999999".len(),
        }
    }

    /// Its number for this pick; a slot that needs a pick has none (NaN, which no line takes) without one.
    pub(crate) fn value(self, pick: Option<&Pick>, tool: &Tool) -> f64 {
        if let Slot::Literal(value, _) = self {
            return value;
        }
        let Some(pick) = pick else { return f64::NAN };
        match self {
            Slot::Literal(value, _) => value,
            Slot::Pose(waypoint, part) => part.of(pose(pick, waypoint), tool),
            Slot::TravelZ => pick.poses().iter().fold(f64::NEG_INFINITY, |z, (_, p)| z.max(p.position_mm[2])),
            Slot::Opening => pick.opening_mm,
            Slot::OpeningPermille => (pick.opening_mm / tool.opening_max_mm * 1000.0).clamp(0.0, 1000.0),
            Slot::PlaceNumber => f64::from(pick.slot),
        }
    }
}

/// What of the settings the values need.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tool {
    opening_max_mm: f64,
    axes: ArmAxes,
}

impl Tool {
    pub(crate) fn new(gripper: &Gripper, axes: ArmAxes) -> Self {
        Self { opening_max_mm: gripper.opening_max_mm, axes }
    }
}

/// One of the four poses of a pick (a line's own point belongs to none: the grasp stands in).
fn pose(pick: &Pick, waypoint: Waypoint) -> &Pose {
    match waypoint {
        Waypoint::Approach => &pick.approach,
        Waypoint::Retreat => &pick.retreat,
        Waypoint::Place => &pick.place,
        Waypoint::Grasp | Waypoint::Line => &pick.grasp,
    }
}

impl Part {
    fn of(self, pose: &Pose, tool: &Tool) -> f64 {
        let [x, y, z, w] = pose.orientation_xyzw;
        let closing = pose.closing();
        let yaw = closing[1].atan2(closing[0]).to_degrees();
        match self {
            Part::Axis(axis) => pose.position_mm[usize::from(axis)],
            // Parallel fingers: a half turn is the same grasp, so the smaller turn is taken.
            Part::Yaw if tool.axes != ArmAxes::Pose => half_turn(yaw),
            Part::Yaw => yaw,
            Part::Pitch => (2.0 * (w * y - z * x)).clamp(-1.0, 1.0).asin().to_degrees(),
            Part::Roll => (2.0 * (w * x + y * z)).atan2(1.0 - 2.0 * (x * x + y * y)).to_degrees(),
            Part::Wrist => {
                let base = pose.position_mm[1].atan2(pose.position_mm[0]).to_degrees();
                half_turn(yaw - base) + 90.0
            }
        }
    }
}

/// An angle in degrees brought to −90 (excluded) to 90 by half turns.
fn half_turn(angle_deg: f64) -> f64 {
    let turned = angle_deg.rem_euclid(180.0);
    if turned > 90.0 { turned - 180.0 } else { turned }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gate::tests::pick;

    fn value(name: &str, pick: &Pick) -> f64 {
        let tool = Tool::new(&Gripper::default(), ArmAxes::XyzYaw);
        built_in(name).unwrap().value(Some(pick), &tool)
    }

    #[test]
    fn names_give_the_numbers_of_the_pick() {
        let mut pick = pick();
        pick.slot = 12;
        pick.opening_mm = 15.0;
        assert_eq!(value("grasp_x", &pick), 10.0);
        assert_eq!(value("place_y", &pick), 100.0);
        assert_eq!(value("travel_z", &pick), 65.0);
        assert_eq!(value("opening", &pick), 15.0);
        assert_eq!(value("opening_permille", &pick), 500.0);
        assert_eq!(value("slot", &pick), 12.0);
        assert_eq!(value("grasp_roll", &pick).abs(), 180.0);
        assert_eq!(built_in("grasp"), None);
        assert_eq!(built_in("feed"), None);
    }

    #[test]
    fn yaw_is_the_closing_direction_and_wrist_is_relative_to_the_arm() {
        let mut pick = pick();
        let half = 60f64.to_radians();
        pick.grasp.orientation_xyzw = [half.cos(), half.sin(), 0.0, 0.0];
        // Fingers close along 120 degrees, which is the same as −60.
        assert!((value("grasp_yaw", &pick) + 60.0).abs() < 1e-9);
        pick.grasp.position_mm = [100.0, 100.0, 5.0];
        assert!((value("grasp_wrist", &pick) - 165.0).abs() < 1e-9);
    }
}
