//! Where frames come from: `enum` [`Camera`] over a recorded session or a V4L2 device.
//!
//! Takes a recycled [`Frame`]; gives it back filled by the one copy of the pixels, with the time stamp and the
//! state the driver gave it. A camera owns its device or file and the pause between attempts to open it again;
//! it makes no decision about a frame: damaged and short ones are handed on with their [`Condition`] and the
//! cell's core counts them.

pub mod replay;
pub mod v4l;

use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::frame::Frame;

pub use replay::ReplayCamera;

/// Which of the two.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Side {
    /// The left camera.
    Left,
    /// The right camera.
    Right,
}

impl Side {
    /// Both, left first.
    pub const BOTH: [Side; 2] = [Side::Left, Side::Right];

    /// 0 for left, 1 for right.
    pub fn index(self) -> usize {
        self as usize
    }

    /// `left` or `right`.
    pub fn name(self) -> &'static str {
        match self {
            Side::Left => "left",
            Side::Right => "right",
        }
    }
}

/// What the driver says about a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Condition {
    /// Nothing bad.
    #[default]
    Good,
    /// Marked as damaged (`V4L2_BUF_FLAG_ERROR`, or a picture that does not decode).
    Damaged,
    /// Fewer bytes than its format needs.
    Short,
}

/// Why a camera gives no frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Trouble {
    /// The device is gone.
    Unplugged,
    /// It is there and sends nothing.
    Stalled,
    /// The machine was suspended to RAM.
    Suspended,
    /// The USB bus has no bandwidth left (ENOSPC).
    NoBandwidth,
    /// Another program has it (EBUSY).
    Busy,
    /// No right to open it (EACCES).
    NoAccess,
    /// It no longer offers the format, the size or a control that cell.toml asks for.
    NotAsAsked,
    /// The driver reports an error number that none of the others explains.
    Driver {
        /// `errno`.
        errno: i32,
    },
}

impl std::fmt::Display for Trouble {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Trouble::Unplugged => write!(f, "unplugged; plug it in again, the cell goes on by itself"),
            Trouble::Stalled => write!(f, "there, but sends no frames; it is opened anew"),
            Trouble::Suspended => write!(f, "the machine was suspended; it is opened anew"),
            Trouble::NoBandwidth => write!(
                f,
                "no bandwidth left on its USB bus (ENOSPC); plug it into another port, take MJPG or a smaller size"
            ),
            Trouble::Busy => write!(f, "in use by another program (EBUSY); close that one"),
            Trouble::NoAccess => {
                write!(
                    f,
                    "no right to open it (EACCES); add the user to the group video or install the udev rule"
                )
            }
            Trouble::NotAsAsked => {
                write!(f, "no longer offers what cell.toml asks for; compare with `pickcell devices`")
            }
            Trouble::Driver { errno } => write!(f, "error {errno} from the driver; it is opened anew"),
        }
    }
}

/// What one [`Camera::grab`] brought.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Grab {
    /// The frame is filled.
    Frame {
        /// What the driver says about it.
        condition: Condition,
        /// Older frames that waited in the driver and were skipped for this one.
        skipped: u32,
    },
    /// Nothing within the time given; the frame is as it was.
    TimedOut,
    /// The camera gives no frames. Said once a reason; further grabs try to open it again with back-off.
    Lost(Trouble),
    /// It is open again, its controls are set. Said once.
    Back,
    /// A recorded session is over; no frame will come any more.
    Ended,
}

/// A camera.
#[derive(Debug)]
pub enum Camera {
    /// One side of a recorded session.
    Replay(ReplayCamera),
    /// A V4L2 device.
    V4l(Box<v4l::V4lCamera>),
}

impl Camera {
    /// Waits for the next frame, at most `timeout`, and copies it into `frame`. Blocks in the kernel, never spins.
    pub fn grab(&mut self, frame: &mut Frame, timeout: Duration) -> Grab {
        match self {
            Camera::Replay(camera) => camera.grab(frame, timeout),
            Camera::V4l(camera) => camera.grab(frame, timeout),
        }
    }
}
