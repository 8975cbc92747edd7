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
//! | `[recording]` | [`Recording`] |
//! | `[arm]`, `[workspace]`, `[gripper]` | firmware-bridge, which the bridge process reads the same file with |

mod cameras;
mod error;
mod recognition;
mod recording;
mod source;
mod tables;

use std::path::{Path, PathBuf};
use std::time::Duration;

use firmware_bridge::config::{Fault, Settings};
use serde::Deserialize;

use crate::matching::harmony;
use crate::vision::binarize::{Binarize, ParamsError};
use crate::{recognize, rig};

pub use crate::vision::binarize::ColourRange;
pub use crate::vision::thin::Algorithm as ThinMethod;
pub use cameras::{Backend, CameraSettings, Cameras, ControlValue, Pace};
pub use error::ConfigError;
pub use firmware_bridge::realtime::Scheduling;
pub use recognition::{Gate, Harmony, Recognition, SearchMethod};
pub use recording::{KeptPictures, Recording, WhenFull};
pub use source::Source;
pub use tables::{PlaceGrid, Realtime, Rig};

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
    /// What is recorded of every run. `None`: nothing.
    pub recording: Option<Recording>,
    /// `[arm]`, `[workspace]` and `[gripper]`, as the bridge process reads them from the same file.
    pub arm_side: Settings,
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
    recording: Option<recording::Written>,
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
            recording: written.recording.map(|recording| recording.check(source)).transpose()?,
            arm_side,
        })
    }

    /// What the recogniser is to be made with, left and right regions, workspace, gripper and axes included. Budget,
    /// seed and threads are arguments of its runs.
    pub fn recognition_params(&self) -> recognize::Params {
        let mut params = recognize::Params::default();
        let written = &self.recognition;
        let regions = [&written.region_left_px, &written.region_right_px];
        for (pixels, region) in params.binarize.iter_mut().zip(regions) {
            pixels.colour = written.colour;
            pixels.inverted = written.inverted;
            pixels.speck_px_min = written.min_speck_px;
            pixels.region_px = region.iter().map(|&[x, y]| [x as f32, y as f32]).collect();
        }
        params.thin.algorithm = written.thin;
        if let Some(fitness_max) = written.fitness_max {
            params.search.fitness_max = fitness_max;
        }
        params.search.method = written.search.into();
        params.gate.mode = written.gate.into();
        let Harmony { hms, hmcr, par, par_min, par_max } = written.harmony;
        params.search.harmony = harmony::Params { hms, hmcr, par, par_min, par_max, ..params.search.harmony };
        let Settings { arm, workspace, gripper } = &self.arm_side;
        params.grasp.base_from_left = self.rig.base_from_left;
        params.grasp.workspace = self.rig.base_from_left.map(|_| *workspace);
        params.grasp.gripper = *gripper;
        params.grasp.axes = arm.axes;
        params.grasp.tilt_tolerance_rad = arm.tilt_tolerance_deg.to_radians();
        params.grasp.yaw_tolerance_rad = arm.yaw_tolerance_deg.to_radians();
        params
    }

    /// What the recogniser says of `region_px`, which it compares with the calibration's size, as an error of the file. It
    /// takes the left picture first.
    pub fn region_error(&self, error: &ParamsError, rig: &rig::Rig) -> ConfigError {
        let [left, _] = self.recognition_params().binarize;
        let is_left = Binarize::new(left, rig.left.width, rig.left.height).err().as_ref() == Some(error);
        self.region_error_of(if is_left { "left" } else { "right" }, error)
    }

    /// What is said of the region of one picture, as an error of the file; names the side where each has its own.
    pub fn region_error_of(&self, side: &str, error: &ParamsError) -> ConfigError {
        let Recognition { region_left_px, region_right_px, .. } = &self.recognition;
        let key = if region_left_px == region_right_px { "region_px" } else { &format!("region_px.{side}") };
        let problem = format!("recognition.{}", error.to_string().replacen("region_px", key, 1));
        let source = Source { file: self.file.clone(), text: self.text.clone() };
        source.wrong(Fault::Other { key: "recognition.region_px", problem })
    }

    /// Whether recorded pairs are played as fast as they are taken, by a clock of their own.
    pub fn plays_fast(&self) -> bool {
        self.cameras.backend == Backend::Replay && self.cameras.pace == Pace::Fast
    }

    /// Whether the pairing window is at most half of a session's frame period, which is known when the session is open.
    ///
    /// # Errors
    /// It is more; names the key.
    pub fn check_pair_window(&self, period: Duration) -> Result<(), ConfigError> {
        // A rate that was measured may be off a little.
        match self.cameras.pair_window.filter(|window| *window > period.mul_f64(0.525)) {
            None => Ok(()),
            Some(window) => {
                let source = Source { file: self.file.clone(), text: self.text.clone() };
                let [window_ms, period_ms] = [window, period].map(|time| time.as_secs_f64() * 1e3);
                Err(cameras::refused_window(&source, window_ms, period_ms))
            }
        }
    }

    /// Time from a frame's stamp to the last byte of its target on the wire: `deadline_ms`, or two frame periods.
    pub fn deadline(&self, period: Duration) -> Duration {
        self.deadline.unwrap_or(2 * period)
    }
}

#[cfg(test)]
mod tests;
