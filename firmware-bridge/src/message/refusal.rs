//! Why a target or a command was not carried out.

use core::fmt;
use serde::{Deserialize, Serialize};

use super::Waypoint;

/// Why a pick is not executed, from whichever side.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Refusal {
    /// No handshake yet, or none any more.
    NotConnected,
    /// The arm is on hold.
    OnHold,
    /// A pick is unfinished.
    Busy,
    /// The controller is in alarm.
    InAlarm,
    /// The position is unknown; home and release first.
    PositionUnknown,
    /// It belongs to another session.
    WrongSession {
        /// The session that is current.
        current: u32,
    },
    /// Its sequence number does not rise.
    OldSequence {
        /// The last one that was taken.
        last: u32,
    },
    /// A coordinate or an angle is NaN or infinite, or a quaternion is no rotation.
    NotFinite {
        /// Where.
        at: Waypoint,
    },
    /// Older than its deadline or its time to live.
    Stale {
        /// Age, ms.
        age_ms: u32,
        /// What it may be, ms.
        max_ms: u32,
    },
    /// A frame time lies further in the future than a period.
    FromFuture {
        /// By how much, ms.
        ahead_ms: u32,
    },
    /// A frame was taken before the arm was last clear of the view, or before the previous target ended.
    SeenTooEarly,
    /// Outside the workspace box.
    OutsideWorkspace {
        /// Which pose.
        at: Waypoint,
        /// 0 = x, 1 = y, 2 = z.
        axis: u8,
        /// The coordinate, mm.
        value_mm: f32,
    },
    /// The tool is tilted further from straight down than allowed.
    Tilted {
        /// Which pose.
        at: Waypoint,
        /// Tilt, degrees.
        tilt_deg: f32,
    },
    /// Too far from the recognised grasp.
    Jump {
        /// Which pose.
        at: Waypoint,
        /// Distance, mm.
        distance_mm: f32,
    },
    /// The arm's axes cannot turn the tool this way.
    Axes {
        /// Which pose.
        at: Waypoint,
    },
    /// The opening is not within the gripper's range.
    Opening {
        /// What was asked, mm.
        opening_mm: f32,
    },
    /// The arm itself says it cannot reach it.
    Unreachable,
    /// The arm refused for a reason of its own.
    ByArm {
        /// The dialect's own number of it.
        code: u16,
    },
    /// The arm did not acknowledge it in time, and certainly did not begin it.
    NotAcknowledged,
    /// The other side of the link refused it (shared memory: the bridge's gate).
    ByBridge,
    /// The arm of a recorded session was given no target more.
    NoRecordedAnswer,
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Refusal::NotConnected => write!(f, "the arm is not connected"),
            Refusal::OnHold => write!(f, "the arm is on hold"),
            Refusal::Busy => write!(f, "the arm has an unfinished pick"),
            Refusal::InAlarm => write!(f, "the controller is in alarm"),
            Refusal::PositionUnknown => write!(f, "the arm's position is unknown"),
            Refusal::WrongSession { current } => write!(f, "it belongs to another session than {current}"),
            Refusal::OldSequence { last } => write!(f, "its sequence number is not above {last}"),
            Refusal::NotFinite { at } => write!(f, "the {at} pose is not finite or no rotation"),
            Refusal::Stale { age_ms, max_ms } => write!(f, "stale: {age_ms} ms old, {max_ms} ms allowed"),
            Refusal::FromFuture { ahead_ms } => write!(f, "a frame is {ahead_ms} ms in the future"),
            Refusal::SeenTooEarly => write!(f, "seen before the arm was clear of the view"),
            Refusal::OutsideWorkspace { at, axis, value_mm } => {
                let axis = ['x', 'y', 'z'].get(usize::from(axis)).copied().unwrap_or('?');
                write!(f, "outside the workspace: {at} {axis} = {value_mm:.1} mm")
            }
            Refusal::Tilted { at, tilt_deg } => write!(f, "the {at} pose is tilted {tilt_deg:.1} degrees"),
            Refusal::Jump { at, distance_mm } => {
                write!(f, "the {at} pose is {distance_mm:.1} mm away from the recognised grasp")
            }
            Refusal::Axes { at } => write!(f, "the arm's axes cannot reach the orientation of the {at} pose"),
            Refusal::Opening { opening_mm } => write!(f, "the gripper cannot open {opening_mm:.1} mm"),
            Refusal::Unreachable => write!(f, "the arm cannot reach it"),
            Refusal::ByArm { code } => write!(f, "the arm refused it with code {code}"),
            Refusal::NotAcknowledged => write!(f, "the arm did not acknowledge it"),
            Refusal::ByBridge => write!(f, "the bridge refused it"),
            Refusal::NoRecordedAnswer => {
                write!(f, "the answers of the recorded session's arm are used up")
            }
        }
    }
}

impl core::error::Error for Refusal {}
