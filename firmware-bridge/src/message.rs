//! What the cell and an arm say to each other, whatever link and dialect carries it.
//!
//! Takes nothing, owns nothing: plain `Copy` values. The cell says a [`Command`], the arm's side answers with
//! [`Report`]s. All times are nanoseconds of the cell's clock (`CLOCK_BOOTTIME`); a link to another clock (serial)
//! converts at its border. Lengths are millimetres in the base frame.
//!
//! # The order of things
//! 1. A dialect shakes hands by itself as soon as its link is up. The end of the handshake is
//!    [`Report::Connected`] with the number of the new **session**. The arm is then **on hold**, always.
//! 2. [`Command::Release`] ends the hold. Who may give it (the operator, or the cell itself with
//!    `resume = "auto"`) is the cell's decision; [`HeldBy`] tells it why the arm is on hold.
//! 3. [`Report::Ready`]: at rest, nothing unfinished, one [`Command::Pick`] is welcome.
//! 4. [`Report::Sent`] (the bytes that may start motion are written), [`Report::Accepted`] (understood and
//!    checked by the arm: not completion), [`Report::Moving`], and exactly one of [`Report::Done`],
//!    [`Report::Failed`], [`Report::Refused`] for every pick that [`Command::Pick`] took without a refusal.
//!    Then `Ready` again. Where the link or the controller dies in between, the end is [`Report::Lost`]:
//!    nobody knows whether it was executed; it is never sent again under the same id.
//! 5. [`Command::Hold`] stops motion at once, overtaking everything; [`Report::Held`] confirms.

mod refusal;

use core::fmt;
use serde::{Deserialize, Serialize};

pub use refusal::Refusal;

/// A tool pose in the base frame. Tool z points out of the gripper along the approach, x along the closing
/// direction of the fingers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// The tool point, millimetres.
    pub position_mm: [f64; 3],
    /// Base-from-tool rotation, unit quaternion x, y, z, w.
    pub orientation_xyzw: [f64; 4],
}

impl Pose {
    /// Direction of the tool's z axis (out of the gripper) in the base frame; as long as the quaternion's norm
    /// squared.
    pub fn approach(&self) -> [f64; 3] {
        let [x, y, z, w] = self.orientation_xyzw;
        [2.0 * (x * z + y * w), 2.0 * (y * z - x * w), w * w + z * z - x * x - y * y]
    }

    /// Direction of the tool's x axis (the fingers close along it) in the base frame.
    pub fn closing(&self) -> [f64; 3] {
        let [x, y, z, w] = self.orientation_xyzw;
        [w * w + x * x - y * y - z * z, 2.0 * (x * y + z * w), 2.0 * (x * z - y * w)]
    }

    /// Direction of the tool's y axis (along the wire between the fingers) in the base frame.
    pub fn wire(&self) -> [f64; 3] {
        let [x, y, z, w] = self.orientation_xyzw;
        [2.0 * (x * y - z * w), w * w + y * y - x * x - z * z, 2.0 * (y * z + x * w)]
    }
}

pub(crate) fn distance_mm(a: [f64; 3], b: [f64; 3]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1]).hypot(a[2] - b[2])
}

/// When the two pictures were taken that a pick rests on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Seen {
    /// Time of the left frame, ns of the cell's clock.
    pub left_ns: i64,
    /// Time of the right frame, ns.
    pub right_ns: i64,
    /// Frame period, ns: a frame may lie this far in the future (some drivers stamp ahead), not further.
    pub period_ns: i64,
}

impl Seen {
    /// The older of the two frames: ages count from it.
    pub fn earliest_ns(&self) -> i64 {
        self.left_ns.min(self.right_ns)
    }

    /// The newer of the two frames.
    pub fn latest_ns(&self) -> i64 {
        self.left_ns.max(self.right_ns)
    }
}

/// One target: pick a part here, put it there.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pick {
    /// Never used twice in the life of a cell, also not for a retry.
    pub id: u64,
    /// The session that [`Report::Connected`] announced; a pick of another session is refused.
    pub session: u32,
    /// Rises with every pick of a session; an arm drops one that does not.
    pub sequence: u32,
    /// The pictures it rests on.
    pub seen: Seen,
    /// From [`Seen::earliest_ns`] to the last byte on the wire, ms; later it is not sent.
    pub deadline_ms: u32,
    /// From [`Seen::earliest_ns`] to the begin of motion, ms; later an arm does not begin it.
    pub ttl_ms: u32,
    /// The grasp as recognised, before anything was added to it: the middle of the part where it is gripped, mm.
    pub recognised_mm: [f64; 3],
    /// Before the grasp, fingers open.
    pub approach: Pose,
    /// Where the fingers close.
    pub grasp: Pose,
    /// After the fingers closed.
    pub retreat: Pose,
    /// Where the fingers open again.
    pub place: Pose,
    /// Distance of the fingers at the approach, mm.
    pub opening_mm: f64,
    /// Number of the place slot, counted from 0.
    pub slot: u32,
}

impl Pick {
    /// The four poses in the order in which the tool reaches them, with their names.
    pub fn poses(&self) -> [(Waypoint, &Pose); 4] {
        [
            (Waypoint::Approach, &self.approach),
            (Waypoint::Grasp, &self.grasp),
            (Waypoint::Retreat, &self.retreat),
            (Waypoint::Place, &self.place),
        ]
    }

    /// Age at `now_ns`, ns; negative for a frame stamped ahead.
    pub fn age_ns(&self, now_ns: i64) -> i64 {
        now_ns.saturating_sub(self.seen.earliest_ns())
    }
}

/// A place that a check may complain about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Waypoint {
    /// Before the grasp.
    Approach,
    /// Where the fingers close.
    Grasp,
    /// After the fingers closed.
    Retreat,
    /// Where the fingers open.
    Place,
    /// A point of a filled-in move template.
    Line,
}

impl fmt::Display for Waypoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Waypoint::Approach => "approach",
            Waypoint::Grasp => "grasp",
            Waypoint::Retreat => "retreat",
            Waypoint::Place => "place",
            Waypoint::Line => "template line",
        })
    }
}

/// What the cell says to an arm. Heartbeats and handshakes are the dialects' own business.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[allow(clippy::large_enum_variant)] // no boxes: it is also used without an allocator
pub enum Command {
    /// Shake hands anew: a new session. What was not begun is dropped by both sides, the arm is on hold.
    Hello,
    /// Execute this. Taken only between [`Report::Ready`] and the next command.
    Pick(Pick),
    /// Stop moving now and stay. Overtakes everything, is never refused.
    Hold,
    /// The hold ends. An interrupted pick does **not** go on: it ends as failed with [`Failure::Held`].
    Release,
    /// What became of the pick with this id? Answered by [`Report::Outcome`].
    Query {
        /// The id of the pick.
        id: u64,
    },
    /// Leave an alarm (`$X`, `M999`, …): the position is unknown afterwards and the arm is on hold.
    Unlock,
}

/// What the arm's side says.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Report {
    /// The handshake is complete, a new session begins, the arm is on hold.
    Connected {
        /// Number of this session; picks carry it.
        session: u32,
        /// Why the arm is on hold.
        held_by: HeldBy,
    },
    /// The link is gone or the arm is silent; the dialect keeps trying to shake hands.
    Disconnected {
        /// How it was noticed.
        cause: Disconnect,
    },
    /// At rest and released, nothing unfinished.
    Ready {
        /// The arm stands out of the cameras' view. False: the cell waits for [`Report::ClearOfView`] from an arm that
        /// says such things, else its dwell, before it trusts a picture. Said again when a ready arm comes into the view.
        clear_of_view: bool,
    },
    /// The arm has left the cameras' view (may come before `Done`).
    ClearOfView,
    /// The last of the bytes that can start the pick's motion went out.
    Sent {
        /// The pick.
        id: u64,
        /// When, ns.
        at_ns: i64,
    },
    /// The arm has understood the pick and will begin it. Not completion.
    Accepted {
        /// The pick.
        id: u64,
    },
    /// The pick was not and will never be executed.
    Refused {
        /// The pick.
        id: u64,
        /// Why.
        refusal: Refusal,
    },
    /// Its motion has begun.
    Moving {
        /// The pick.
        id: u64,
    },
    /// The part lies in its place.
    Done {
        /// The pick.
        id: u64,
    },
    /// It was begun, or may have been, and ended without success.
    Failed {
        /// The pick.
        id: u64,
        /// Why.
        failure: Failure,
    },
    /// Link or controller died under it: whether it was executed is unknown. Never sent again.
    Lost {
        /// The pick.
        id: u64,
    },
    /// Answer to [`Command::Query`].
    Outcome {
        /// The pick that was asked about.
        id: u64,
        /// What became of it.
        outcome: Outcome,
    },
    /// The arm stands still and stays until [`Command::Release`].
    Held {
        /// Why.
        by: HeldBy,
    },
    /// The controller refuses to move until [`Command::Unlock`].
    Alarm {
        /// The dialect's own number of it.
        code: u16,
    },
    /// The controller was reset or lost steps: its coordinates mean nothing until it was homed.
    PositionUnknown,
    /// A heartbeat came back.
    Heartbeat {
        /// One way, µs: half the measured round trip.
        delay_us: u32,
    },
    /// The other side speaks another version of the own protocol. No motion.
    WrongVersion {
        /// Our version.
        ours: u16,
        /// The arm's version.
        theirs: u16,
    },
    /// What answers is not an arm of this dialect. No motion.
    WrongDialect,
    /// Bytes that were no message of the dialect, or carried a number that is none.
    Garbage {
        /// How many bytes.
        bytes: u32,
    },
    /// More reports came than were polled; some are gone. To be treated like a lost connection.
    ReportsLost,
}

/// Why the arm is on hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum HeldBy {
    /// The first handshake of a connection with a controller that has just started (or cannot tell).
    Start,
    /// [`Command::Hold`].
    Command,
    /// The controller was reset while the cell was connected.
    ControllerReset,
    /// The other side's heartbeat stopped.
    HeartbeatLost,
    /// The line was gone; the controller itself was not reset.
    LinkLost,
    /// The controller is, or was, in alarm.
    Alarm,
    /// A button at the arm (door, feed hold).
    Operator,
    /// The arm of a recorded session has no further answer. Never on a wire.
    RecordingOver,
}

/// How a lost connection was noticed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Disconnect {
    /// The device has vanished or cannot be opened.
    PortGone,
    /// No heartbeat, acknowledgement or status within its time.
    Silent,
    /// The controller announced a start.
    Restarted,
    /// The other side opened a new session.
    NewSession,
}

/// What became of a pick, as far as the arm knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Outcome {
    /// The arm never heard of it, has forgotten it, or cannot tell in its dialect.
    Unknown,
    /// Accepted or under way.
    Unfinished,
    /// Completed.
    Done,
    /// Ended without success.
    Failed,
    /// Refused, never begun.
    Refused,
}

/// Why a begun pick did not succeed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Failure {
    /// The gripper closed on nothing, or lost the part.
    PartNotHeld,
    /// It was interrupted by a hold.
    Held,
    /// The controller raised an alarm.
    Alarm,
    /// It took longer than `pick_timeout_ms`.
    TimedOut,
    /// The controller answered a motion line with an error.
    Controller {
        /// The dialect's own number of it.
        code: u16,
    },
    /// The controller was restarted.
    Restarted,
}

/// What an arm can turn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum ArmAxes {
    /// Position only: the tool points straight down and does not turn.
    #[serde(rename = "xyz")]
    Xyz,
    /// Position and rotation about the vertical.
    #[serde(rename = "xyz+yaw")]
    XyzYaw,
    /// Any orientation.
    #[default]
    #[serde(rename = "pose")]
    Pose,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tool_axes_are_the_columns_of_the_rotation() {
        let down = Pose { position_mm: [0.0; 3], orientation_xyzw: [1.0, 0.0, 0.0, 0.0] };
        assert_eq!(down.approach(), [0.0, 0.0, -1.0]);
        assert_eq!(down.closing(), [1.0, 0.0, 0.0]);
        assert_eq!(down.wire(), [0.0, -1.0, 0.0]);
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let about_z = Pose { position_mm: [0.0; 3], orientation_xyzw: [0.0, 0.0, half, half] };
        let [x, y, z] = about_z.closing();
        assert!(x.abs() < 1e-12 && (y - 1.0).abs() < 1e-12 && z.abs() < 1e-12);
    }

    #[test]
    fn refusals_say_what_and_how_much() {
        let far = Refusal::OutsideWorkspace { at: Waypoint::Place, axis: 1, value_mm: 412.5 };
        assert_eq!(far.to_string(), "outside the workspace: place y = 412.5 mm");
        assert_eq!(Refusal::Stale { age_ms: 90, max_ms: 66 }.to_string(), "stale: 90 ms old, 66 ms allowed");
    }
}
