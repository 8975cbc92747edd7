//! The small tables: `[rig]`, `[deadline]`, `[place]`, `[realtime]`.

use std::path::PathBuf;
use std::time::Duration;

use firmware_bridge::config::{Arm, Gripper, Settings, Workspace, exactly};
use firmware_bridge::realtime::Scheduling;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use serde::Deserialize;

use super::error::ConfigError;
use super::source::Source;

/// The three tables of firmware-bridge, by its own checks.
pub(super) fn arm_side(
    source: &Source,
    arm: Arm,
    workspace: Workspace,
    gripper: Gripper,
) -> Result<Settings, ConfigError> {
    let mut settings = Settings { arm, workspace, gripper };
    settings.check().map_err(|fault| source.wrong(fault))?;
    if let Some(port) = &settings.arm.port {
        settings.arm.port = Some(source.folder().join(port));
    }
    Ok(settings)
}

/// `[rig]`: how the cameras see, and where they stand.
#[derive(Clone, Debug, PartialEq)]
pub struct Rig {
    /// The stereo calibration: OpenCV YAML, or the left one of two ROS `camera_info` files.
    pub calibration: PathBuf,
    /// Pose of the left camera in the robot's base, mm. `None`: grasps are given in the left camera's frame.
    pub base_from_left: Option<Isometry3<f64>>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WrittenRig {
    calibration: String,
    base_from_left: Option<WrittenPose>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct WrittenPose {
    #[serde(deserialize_with = "exactly")]
    translation_mm: [f64; 3],
    #[serde(deserialize_with = "exactly")]
    quaternion_xyzw: [f64; 4],
}

impl WrittenRig {
    pub(super) fn check(self, source: &Source) -> Result<Rig, ConfigError> {
        let calibration = source.existing("rig.calibration", &self.calibration)?;
        let base_from_left = self.base_from_left.map(|pose| pose.check(source)).transpose()?;
        Ok(Rig { calibration, base_from_left })
    }
}

impl WrittenPose {
    fn check(self, source: &Source) -> Result<Isometry3<f64>, ConfigError> {
        let translation = vector_mm(source, "rig.base_from_left.translation_mm", self.translation_mm)?;
        let [x, y, z, w] = self.quaternion_xyzw;
        let quaternion = Quaternion::new(w, x, y, z);
        let norm = quaternion.norm();
        if !(norm.is_finite() && (norm - 1.0).abs() < 1e-3) {
            let value = format!("{:?} (length {norm:.4})", self.quaternion_xyzw);
            let allowed = "a unit quaternion [x, y, z, w], length 1 to within 0.001";
            return Err(source.refuse("rig.base_from_left.quaternion_xyzw", value, allowed));
        }
        Ok(Isometry3::from_parts(
            Translation3::from(translation),
            UnitQuaternion::from_quaternion(quaternion),
        ))
    }
}

/// Farthest point that a cell may name, in mm from the base.
const REACH_MM_MAX: f64 = 100_000.0;

fn vector_mm(source: &Source, key: &str, value: [f64; 3]) -> Result<Vector3<f64>, ConfigError> {
    if value.iter().all(|v| v.is_finite() && v.abs() <= REACH_MM_MAX) {
        return Ok(Vector3::from(value));
    }
    let allowed = format!("three finite lengths in mm, each at most {REACH_MM_MAX}");
    Err(source.refuse(key, format!("{value:?}"), allowed))
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WrittenDeadline {
    deadline_ms: Option<f64>,
}

impl WrittenDeadline {
    pub(super) fn check(self, source: &Source) -> Result<Option<Duration>, ConfigError> {
        match self.deadline_ms {
            None => Ok(None),
            Some(ms) if ms.is_finite() && (1.0..=60_000.0).contains(&ms) => {
                Ok(Some(Duration::from_secs_f64(ms / 1e3)))
            }
            Some(ms) => Err(source.refuse("deadline.deadline_ms", ms, "milliseconds from 1 to 60000")),
        }
    }
}

/// `[place]`: a grid of slots that parts are put into, row by row. All in the base frame.
#[derive(Clone, Debug, PartialEq)]
pub struct PlaceGrid {
    /// Tool point at the first slot, mm.
    pub first_mm: Vector3<f64>,
    /// From a slot to the next in its row, mm.
    pub column_step_mm: Vector3<f64>,
    /// From a row to the next, mm.
    pub row_step_mm: Vector3<f64>,
    /// Slots in a row.
    pub columns: u32,
    /// Rows.
    pub rows: u32,
    /// Turn of the gripper about base z at the slots, radians; 0: the fingers close along base x.
    pub yaw_rad: f64,
    /// The file that keeps the counters through a restart.
    pub state: PathBuf,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WrittenPlace {
    #[serde(deserialize_with = "exactly")]
    first_mm: [f64; 3],
    #[serde(default, deserialize_with = "exactly")]
    column_step_mm: [f64; 3],
    #[serde(default, deserialize_with = "exactly")]
    row_step_mm: [f64; 3],
    #[serde(default = "one")]
    columns: i64,
    #[serde(default = "one")]
    rows: i64,
    #[serde(default)]
    yaw_deg: f64,
    state: String,
}

fn one() -> i64 {
    1
}

impl WrittenPlace {
    pub(super) fn check(self, source: &Source) -> Result<PlaceGrid, ConfigError> {
        let columns = source.whole("place.columns", self.columns, 1..=1000, "1 to 1000")?;
        let rows = source.whole("place.rows", self.rows, 1..=1000, "1 to 1000")?;
        for (key, step, count) in [
            ("place.column_step_mm", self.column_step_mm, columns),
            ("place.row_step_mm", self.row_step_mm, rows),
        ] {
            if count > 1 && step == [0.0; 3] {
                return Err(source.refuse(key, "[0, 0, 0]", "a step that is not zero, in mm"));
            }
        }
        if self.state.trim().is_empty() {
            return Err(source.refuse("place.state", "\"\"", "a file for the pattern's counters"));
        }
        if !(self.yaw_deg.is_finite() && self.yaw_deg.abs() <= 360.0) {
            return Err(source.refuse("place.yaw_deg", self.yaw_deg, "degrees from -360 to 360"));
        }
        Ok(PlaceGrid {
            first_mm: vector_mm(source, "place.first_mm", self.first_mm)?,
            column_step_mm: vector_mm(source, "place.column_step_mm", self.column_step_mm)?,
            row_step_mm: vector_mm(source, "place.row_step_mm", self.row_step_mm)?,
            columns,
            rows,
            yaw_rad: self.yaw_deg.to_radians(),
            state: source.resolve(&self.state),
        })
    }
}

/// `[realtime]`: rights that the threads ask the system for. What is not granted is said in the log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Realtime {
    /// How the hot threads are scheduled.
    pub scheduling: Scheduling,
    /// SCHED_FIFO priority of the two grab threads, 10 to 40.
    pub grab_priority: u8,
    /// SCHED_FIFO priority of the recognising thread, 10 to 40.
    pub recognise_priority: u8,
    /// SCHED_FIFO priority of the arm's thread, 10 to 40.
    pub arm_priority: u8,
    /// Cores that the hot threads may run on. Empty: all but the last one, which is left to the kernel's workers.
    pub cores: Vec<usize>,
    /// Lock and prefault all memory.
    pub lock_memory: bool,
    /// Stack of each hot thread, KiB.
    pub stack_kib: usize,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WrittenRealtime {
    #[serde(default)]
    scheduling: Scheduling,
    grab_priority: Option<i64>,
    recognise_priority: Option<i64>,
    arm_priority: Option<i64>,
    #[serde(default)]
    cores: Vec<i64>,
    lock_memory: Option<bool>,
    stack_kib: Option<i64>,
}

impl WrittenRealtime {
    pub(super) fn check(self, source: &Source) -> Result<Realtime, ConfigError> {
        let priority = |name: &str, written: Option<i64>, default: i64| {
            let allowed = "10 to 40 (interrupt threads have 50; above them the cameras would starve)";
            source.whole(&format!("realtime.{name}"), written.unwrap_or(default), 10..=40, allowed)
        };
        let core = |&core: &i64| {
            let allowed = "numbers of cores, counted from 0, under 1024";
            source.whole("realtime.cores", core, 0..=1023, allowed)
        };
        let stack_kib = self.stack_kib.unwrap_or(1024);
        let stack_kib = source.whole("realtime.stack_kib", stack_kib, 256..=65_536, "256 to 65536 KiB")?;
        Ok(Realtime {
            scheduling: self.scheduling,
            grab_priority: priority("grab_priority", self.grab_priority, 30)?,
            recognise_priority: priority("recognise_priority", self.recognise_priority, 20)?,
            arm_priority: priority("arm_priority", self.arm_priority, 40)?,
            cores: self.cores.iter().map(core).collect::<Result<_, _>>()?,
            lock_memory: self.lock_memory.unwrap_or(true),
            stack_kib,
        })
    }
}
