//! `cell.toml` as written → checked [`Cell`].
//!
//! One file is one cell. Every key carries its unit in its name, a key that nobody reads is an error, relative
//! paths start at the file, and every refusal names file, line, key, value and what is allowed. The stages know
//! nothing of this room: it builds their `Params`.
//!
//! | table | read by |
//! |---|---|
//! | `[cameras]`, `[cameras.left]`, `[cameras.right]` | [`Cameras`] |
//! | `[rig]` | [`Rig`] |
//! | `[recognition]` | [`Recognition`] |
//! | `[deadline]` | [`Cell::deadline`] |
//! | `[place]` | [`PlaceGrid`] |
//! | `[realtime]` | [`Realtime`] |
//! | `[arm]`, `[workspace]`, `[gripper]` | firmware-bridge, which the bridge process reads the same file with |

mod cameras;
mod error;
mod recognition;
mod source;
mod tables;

use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::Deserialize;

pub use cameras::{Backend, CameraSettings, Cameras, ControlValue, PICTURE_SIDE_PX_MAX, Pace, RATE_HZ_MAX};
pub use error::{ConfigError, Location};
pub use recognition::{Gate, Harmony, Recognition, SearchMethod};
pub use source::Source;
pub use tables::{PlaceGrid, Realtime, Rig, Scheduling};

/// One cell, checked. Files that it names exist; what is in them is read by the rooms they belong to.
#[derive(Clone, Debug)]
pub struct Cell {
    /// The file as it was named.
    pub file: PathBuf,
    /// Its text, as a recording keeps it.
    pub text: String,
    /// Where the frame pairs come from.
    pub cameras: Cameras,
    /// How the cameras stand.
    pub rig: Rig,
    /// What is looked for.
    pub recognition: Recognition,
    /// `deadline_ms`; see [`Cell::deadline`].
    pub deadline: Option<Duration>,
    /// Where parts are put. `None`: the arm drops them where its own moves say.
    pub place: Option<PlaceGrid>,
    /// Priorities, cores and memory of the threads.
    pub realtime: Realtime,
    /// `[arm]`, `[workspace]` and `[gripper]`, as the bridge process reads them from the same file.
    pub arm_side: firmware_bridge::config::Settings,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Written {
    cameras: cameras::Written,
    rig: tables::WrittenRig,
    recognition: recognition::Written,
    #[serde(default)]
    deadline: tables::WrittenDeadline,
    place: Option<tables::WrittenPlace>,
    #[serde(default)]
    realtime: tables::WrittenRealtime,
    #[serde(default)]
    arm: firmware_bridge::config::Arm,
    workspace: firmware_bridge::config::Workspace,
    #[serde(default)]
    gripper: firmware_bridge::config::Gripper,
}

impl Cell {
    /// Reads and checks a `cell.toml`.
    ///
    /// # Errors
    /// The first thing in it that is wrong.
    pub fn read(file: &Path) -> Result<Self, ConfigError> {
        Self::check(&Source::read(file)?)
    }

    /// Checks the text of a `cell.toml`.
    ///
    /// # Errors
    /// The first thing in it that is wrong.
    pub fn check(source: &Source) -> Result<Self, ConfigError> {
        let written: Written = source.parse()?;
        let arm_side = tables::arm_side(source, written.arm, written.workspace, written.gripper)?;
        Ok(Cell {
            file: source.file.clone(),
            text: source.text.clone(),
            cameras: written.cameras.check(source)?,
            rig: written.rig.check(source)?,
            recognition: written.recognition.check(source)?,
            deadline: written.deadline.check(source)?,
            place: written.place.map(|place| place.check(source)).transpose()?,
            realtime: written.realtime.check(source)?,
            arm_side,
        })
    }

    /// Time from a frame's stamp to the last byte of its target on the wire: `deadline_ms`, or two frame periods.
    pub fn deadline(&self, period: Duration) -> Duration {
        self.deadline.unwrap_or(2 * period)
    }
}

#[cfg(test)]
mod tests;
