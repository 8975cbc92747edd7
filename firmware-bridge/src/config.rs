//! `[arm]`, `[workspace]` and `[gripper]` of cell.toml: as written → checked.
//!
//! Takes the text of a cell.toml; gives [`Settings`]; other tables are not this crate's and are ignored, unknown
//! keys inside these three are errors. The driver's configuration embeds [`Arm`], [`Workspace`] and [`Gripper`]
//! as they are and calls [`Settings::check`].
//!
//! ```
//! let settings = firmware_bridge::config::Settings::parse(r#"
//! [arm]
//! link = "serial"                 # replay | serial | shared-memory
//! port = "/dev/serial/by-id/usb-FTDI_FT232R_A50285BI-if00-port0"
//! baud = 115200
//! dialect = "grbl"                # own | grbl | marlin | uarm
//! axes = "xyz"                    # xyz | xyz+yaw | pose
//! resume = "manual"               # manual | auto
//!
//! [arm.moves]                     # only for G-code dialects; left out = the dialect's own
//! values = { feed = 6000, slow = 1500 }
//! pick = [
//!   "G0 X{approach_x} Y{approach_y} Z{approach_z}",
//!   "G1 X{grasp_x} Y{grasp_y} Z{grasp_z} F{slow}",
//!   "M3 S1000",
//!   "G4 P0.2",
//!   "G0 X{retreat_x} Y{retreat_y} Z{retreat_z}",
//!   "G0 X{place_x} Y{place_y} Z{place_z}",
//!   "M5",
//! ]
//! clear = ["G0 X0 Y0 Z180"]
//!
//! [workspace]                     # box of the tool point in the base frame
//! min_mm = [-200, -200, -5]
//! max_mm = [200, 200, 300]
//! tilt_max_deg = 40
//! jump_max_mm = 120
//!
//! [gripper]
//! opening_max_mm = 30
//! "#).unwrap();
//! assert_eq!(settings.arm.resends, 3);
//! ```

mod error;
mod fault;

use crate::message::ArmAxes;
use crate::outside::read_text;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

pub use error::ConfigError;
pub use fault::{Fault, TextError, read_toml};

/// The tables of cell.toml that belong to the arm's side.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// `[arm]`.
    #[serde(default)]
    pub arm: Arm,
    /// `[workspace]`.
    pub workspace: Workspace,
    /// `[gripper]`.
    #[serde(default)]
    pub gripper: Gripper,
}

/// `[arm]`: which arm, over which link, how long to wait for what.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Arm {
    /// What carries targets to the arm.
    pub link: LinkName,
    /// Device of the serial line; needed for `link = "serial"` and by the bridge process. Prefer a path under
    /// /dev/serial/by-id, which stays when the arm is plugged in elsewhere.
    pub port: Option<PathBuf>,
    /// Bits per second, 1200 to 4 000 000.
    pub baud: u32,
    /// The language the arm speaks.
    pub dialect: DialectName,
    /// What the arm can turn.
    pub axes: ArmAxes,
    /// Who ends a hold after a crash, a kill, the watchdog or a reset of the controller.
    pub resume: Resume,
    /// Name of the shared-memory service, 1 to 64 of `A-Z a-z 0-9 - _ .`. Driver and bridge need the same.
    pub service: String,
    /// Time to live of a target: from the older frame to the begin of motion, ms, 10 to 60 000.
    pub ttl_ms: u32,
    /// A heartbeat is sent (own protocol, shared memory) or the status asked for (G-code) this often, ms, 10 to
    /// 10 000.
    pub heartbeat_ms: u32,
    /// Silence of the other side for so long is a lost connection, ms, more than twice `heartbeat_ms`, up to
    /// 60 000. The arm holds by itself after the same time.
    pub heartbeat_timeout_ms: u32,
    /// How long to wait for a banner after opening a port before asking, ms, 0 to 60 000. Boards like the Arduino
    /// restart when the port is opened.
    pub banner_wait_ms: u32,
    /// One attempt of a handshake, ms, 10 to 60 000; then the next.
    pub handshake_timeout_ms: u32,
    /// A message or line not acknowledged for so long (beyond what the line itself takes) is sent again where the
    /// dialect allows it, ms, 5 to 60 000.
    pub ack_timeout_ms: u32,
    /// How often a message is sent again, 0 to 20; then the connection is given up and made anew.
    pub resends: u32,
    /// Grbl: how many lines may wait for their answer, 1 to 15. More make many short moves smoother; but if an answer
    /// is lost on the line, a refused move is noticed only after those behind it have begun.
    pub lines_ahead: u32,
    /// A pick must be complete within this time after it was sent, ms, 100 to 600 000.
    pub pick_timeout_ms: u32,
    /// For arms that do not report being clear of the view: how long after the end of the motion the cell waits
    /// before it trusts a picture, ms, 0 to 60 000.
    pub clear_dwell_ms: u32,
    /// How often the cell tries again to pick the same part before it goes on to the next best, 0 to 20.
    pub retries: u32,
    /// Pause before the first attempt to open a vanished port again, ms, 10 to 60 000; doubles every time.
    pub reopen_min_ms: u32,
    /// The longest pause between such attempts, ms, `reopen_min_ms` to 60 000.
    pub reopen_max_ms: u32,
    /// For an arm that cannot tilt its tool (`xyz`, `xyz+yaw`): tilt of a grasp from straight down that it may
    /// still take, degrees, 0 to 90.
    pub tilt_tolerance_deg: f64,
    /// For an arm that cannot turn its tool (`xyz`): angle between the grasp's closing direction and the
    /// gripper's (`gripper.closing_yaw_deg`) that it may still take, degrees, 0 to 90. 90 for suction or a magnet.
    pub yaw_tolerance_deg: f64,
    /// The moves of a pick as lines of G-code.
    pub moves: Moves,
}

impl Default for Arm {
    fn default() -> Self {
        Self {
            link: LinkName::Replay,
            port: None,
            baud: 115_200,
            dialect: DialectName::Own,
            axes: ArmAxes::Pose,
            resume: Resume::Manual,
            service: "pickcell".into(),
            ttl_ms: 500,
            heartbeat_ms: 100,
            heartbeat_timeout_ms: 500,
            banner_wait_ms: 2000,
            handshake_timeout_ms: 1000,
            ack_timeout_ms: 100,
            resends: 3,
            lines_ahead: 1,
            pick_timeout_ms: 30_000,
            clear_dwell_ms: 0,
            retries: 1,
            reopen_min_ms: 100,
            reopen_max_ms: 5000,
            tilt_tolerance_deg: 10.0,
            yaw_tolerance_deg: 10.0,
            moves: Moves::default(),
        }
    }
}

/// `[arm.moves]`: templates of G-code lines. A name in braces is replaced by its value: those of the pick
/// (`{grasp_x}`, `{place_yaw}`, …, see `template`) and those of `values`. An empty list means the dialect's own.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Moves {
    /// Sent once after every release, before the first pick (units, homing).
    pub start: Vec<String>,
    /// From rest to the part lying in its place. The entry `"held?"` asks whether a part is held, see `held`.
    pub pick: Vec<String>,
    /// Instead of what follows `"held?"` in `pick`, when no part is held: open the fingers, get up.
    pub missed: Vec<String>,
    /// Out of the cameras' view; when it has ended the arm is clear of the view.
    pub clear: Vec<String>,
    /// How the arm is asked whether it holds a part.
    pub held: Option<Held>,
    /// Numbers of your own, usable as `{name}`.
    pub values: BTreeMap<String, f64>,
}

/// `[arm.moves]` `held`: a question to the controller and the sign of a held part in its answer.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Held {
    /// The question: Grbl `?` (status report), Marlin `M119` (switches), uArm `P2231` (pump), `P2232` (gripper) or
    /// `P2233` (switch).
    pub ask: String,
    /// What only the answer for a held part contains, e.g. `Pn:P`, `z_probe: TRIGGERED`, `V2`.
    pub expect: String,
}

/// What carries targets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LinkName {
    /// The arm of the recorded session, or the simulated one in the same process.
    #[default]
    Replay,
    /// A serial line of this process.
    Serial,
    /// Shared memory to `firmware-bridge run`.
    SharedMemory,
}

/// Languages of arms.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "std", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum DialectName {
    /// PickCell's own packets, see PROTOCOL.md.
    #[default]
    Own,
    /// Grbl 1.1.
    Grbl,
    /// Marlin 2.
    Marlin,
    /// uArm Swift Pro.
    Uarm,
}

/// Who ends a hold after something went wrong.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Resume {
    /// The operator.
    #[default]
    Manual,
    /// The cell itself.
    Auto,
}

/// `[workspace]`: where the tool point may be, in the base frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Workspace {
    /// Lower corner of the box, mm.
    #[serde(deserialize_with = "exactly")]
    pub min_mm: [f64; 3],
    /// Upper corner of the box, mm; above the lower one on every axis.
    #[serde(deserialize_with = "exactly")]
    pub max_mm: [f64; 3],
    /// Largest tilt of the approach from straight down, degrees, 0 to 90.
    #[serde(default = "default_tilt_max_deg")]
    pub tilt_max_deg: f64,
    /// Largest distance of approach, grasp and retreat from the recognised grasp, mm, above 0. Points of move
    /// templates may also be this near to the place pose.
    #[serde(default = "default_jump_max_mm")]
    pub jump_max_mm: f64,
}

fn default_tilt_max_deg() -> f64 {
    40.0
}

fn default_jump_max_mm() -> f64 {
    150.0
}

/// `[gripper]`: two parallel fingers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Gripper {
    /// Widest distance of the fingers, mm, above 0.
    pub opening_max_mm: f64,
    /// Distance of the fingers where they no longer close, mm, from 0 to below `opening_max_mm`.
    pub opening_min_mm: f64,
    /// Added to the part's width on both sides together when the fingers come down, mm, 0 or more.
    pub clearance_mm: f64,
    /// Size of a finger along the closing direction, mm, above 0.
    pub finger_thickness_mm: f64,
    /// Size of a finger along the wire, mm, above 0.
    pub finger_width_mm: f64,
    /// How far the finger tips reach below the grasp, mm, 0 or more.
    pub finger_depth_mm: f64,
    /// Distance from the approach pose to the grasp, along the approach, mm, above 0.
    pub approach_mm: f64,
    /// Distance from the grasp to the retreat pose, straight up, mm, above 0.
    pub retreat_mm: f64,
    /// Closing direction of a gripper that cannot turn (`axes = "xyz"`), degrees about base z from base x, −180
    /// to 180.
    pub closing_yaw_deg: f64,
}

impl Default for Gripper {
    fn default() -> Self {
        Self {
            opening_max_mm: 30.0,
            opening_min_mm: 0.0,
            clearance_mm: 4.0,
            finger_thickness_mm: 4.0,
            finger_width_mm: 8.0,
            finger_depth_mm: 3.0,
            approach_mm: 40.0,
            retreat_mm: 60.0,
            closing_yaw_deg: 0.0,
        }
    }
}

/// So many values and not one more: serde by itself would leave out what follows, and a slip with it.
///
/// # Errors
/// Another number of values, or values of another type.
pub fn exactly<'de, D, T, const N: usize>(deserializer: D) -> Result<[T; N], D::Error>
where
    D: serde::Deserializer<'de>,
    T: Deserialize<'de>,
{
    let values = Vec::deserialize(deserializer)?;
    let len = values.len();
    let expected = format!("a list of {N} values");
    values.try_into().map_err(|_| serde::de::Error::invalid_length(len, &expected.as_str()))
}

impl Settings {
    /// Parses and checks the text of a cell.toml.
    ///
    /// # Errors
    /// The first thing in it that is wrong.
    pub fn parse(text: &str) -> Result<Self, TextError> {
        let settings: Settings = read_toml(text)?;
        settings.check().map_err(|fault| TextError::of(text, fault))?;
        Ok(settings)
    }

    /// Reads and checks a cell.toml; a relative `arm.port` starts at the file.
    ///
    /// # Errors
    /// A file that cannot be read; the first thing in it that is wrong.
    pub fn read(path: &Path) -> Result<Self, ConfigError> {
        let text = read_text(path).map_err(|source| ConfigError::Read { path: path.into(), source })?;
        let wrong = |error| ConfigError::File { path: path.into(), error };
        let mut settings = Self::parse(&text).map_err(wrong)?;
        if let (Some(port), Some(folder)) = (&settings.arm.port, path.parent()) {
            settings.arm.port = Some(folder.join(port));
        }
        Ok(settings)
    }

    /// Every value that has a range is checked against it.
    ///
    /// # Errors
    /// The first that is out of it, and the first move template that is not allowed.
    pub fn check(&self) -> Result<(), Fault> {
        self.arm.check()?;
        self.workspace.check()?;
        self.gripper.check()?;
        if self.arm.dialect != DialectName::Own {
            crate::gcode::template::Program::compile(self)?;
        }
        Ok(())
    }
}

/// `value` within `low..=high`, or a fault of `key`.
fn within<T: PartialOrd + std::fmt::Display>(key: &str, value: T, low: T, high: T) -> Result<(), Fault> {
    if value >= low && value <= high {
        return Ok(());
    }
    Err(Fault::value(key, value, format!("{low} to {high}")))
}

impl Arm {
    fn check(&self) -> Result<(), Fault> {
        if self.link == LinkName::Serial && self.port.is_none() {
            let remedy = "link = \"serial\" needs the device, e.g. port = \"/dev/ttyUSB0\"".to_owned();
            return Err(Fault::Missing { key: "arm.port".to_owned(), remedy });
        }
        within("arm.baud", self.baud, 1200, 4_000_000)?;
        let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
        if self.service.is_empty() || self.service.len() > 64 || !self.service.chars().all(plain) {
            let service = format!("{:?}", self.service);
            return Err(Fault::value("arm.service", service, "1 to 64 of A-Z a-z 0-9 - _ ."));
        }
        within("arm.ttl_ms", self.ttl_ms, 10, 60_000)?;
        within("arm.heartbeat_ms", self.heartbeat_ms, 10, 10_000)?;
        within("arm.heartbeat_timeout_ms", self.heartbeat_timeout_ms, 2 * self.heartbeat_ms + 1, 60_000)?;
        within("arm.banner_wait_ms", self.banner_wait_ms, 0, 60_000)?;
        within("arm.handshake_timeout_ms", self.handshake_timeout_ms, 10, 60_000)?;
        within("arm.ack_timeout_ms", self.ack_timeout_ms, 5, 60_000)?;
        within("arm.resends", self.resends, 0, 20)?;
        within("arm.lines_ahead", self.lines_ahead, 1, 15)?;
        within("arm.pick_timeout_ms", self.pick_timeout_ms, 100, 600_000)?;
        within("arm.clear_dwell_ms", self.clear_dwell_ms, 0, 60_000)?;
        within("arm.retries", self.retries, 0, 20)?;
        within("arm.reopen_min_ms", self.reopen_min_ms, 10, 60_000)?;
        within("arm.reopen_max_ms", self.reopen_max_ms, self.reopen_min_ms, 60_000)?;
        within("arm.tilt_tolerance_deg", self.tilt_tolerance_deg, 0.0, 90.0)?;
        within("arm.yaw_tolerance_deg", self.yaw_tolerance_deg, 0.0, 90.0)
    }
}

impl Workspace {
    fn check(&self) -> Result<(), Fault> {
        const MM_MAX: f64 = 100_000.0;
        for axis in 0..3 {
            within("workspace.min_mm", self.min_mm[axis], -MM_MAX, MM_MAX)?;
            within("workspace.max_mm", self.max_mm[axis], -MM_MAX, MM_MAX)?;
            if self.max_mm[axis] <= self.min_mm[axis] {
                let allowed = format!("above workspace.min_mm = {:?} on every axis", self.min_mm);
                return Err(Fault::value("workspace.max_mm", format!("{:?}", self.max_mm), allowed));
            }
        }
        within("workspace.tilt_max_deg", self.tilt_max_deg, 0.0, 90.0)?;
        within("workspace.jump_max_mm", self.jump_max_mm, 0.001, MM_MAX)
    }
}

impl Gripper {
    fn check(&self) -> Result<(), Fault> {
        const MM_MAX: f64 = 1000.0;
        const ABOVE_0: f64 = 0.001;
        within("gripper.opening_max_mm", self.opening_max_mm, ABOVE_0, MM_MAX)?;
        within("gripper.opening_min_mm", self.opening_min_mm, 0.0, self.opening_max_mm)?;
        within("gripper.clearance_mm", self.clearance_mm, 0.0, MM_MAX)?;
        within("gripper.finger_thickness_mm", self.finger_thickness_mm, ABOVE_0, MM_MAX)?;
        within("gripper.finger_width_mm", self.finger_width_mm, ABOVE_0, MM_MAX)?;
        within("gripper.finger_depth_mm", self.finger_depth_mm, 0.0, MM_MAX)?;
        within("gripper.approach_mm", self.approach_mm, ABOVE_0, MM_MAX)?;
        within("gripper.retreat_mm", self.retreat_mm, ABOVE_0, MM_MAX)?;
        within("gripper.closing_yaw_deg", self.closing_yaw_deg, -180.0, 180.0)
    }
}

#[cfg(test)]
mod tests;
