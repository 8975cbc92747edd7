//! Command line and cell.toml → everything that a cell is made of.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use firmware_bridge::codec::PACKET_LEN_MAX;
use firmware_bridge::config::{DialectName, LinkName, Settings};
use firmware_bridge::link::Answers;
use firmware_bridge::message::Pose;

use super::args::{Overlays, Rate, RunArgs};
use super::{RunError, place};
use crate::arm::Arm;
use crate::camera::replay::Pace;
use crate::camera::{Camera, ReplayCamera, Side};
use crate::cell::core::{Core, Params, PlacePattern, PlaceRecord, Repeated};
use crate::cell::desk::{Desk, Seats};
use crate::cell::fast::{Moment, Schedule};
use crate::cell::realtime::{Wish, hot_cores};
use crate::cell::threads::Wishes;
use crate::config::{Backend, CameraSettings, Cell, PlaceGrid, Realtime, Scheduling};
use crate::handover::Waker;
use crate::hands;
use crate::part::Part;
use crate::recognize::Recognizer;
use crate::rig::Rig;
use crate::session::{Fate, RecordedPair, Session};
use crate::time::{Timestamp, wall_ms};

/// Budget of a search, in iterations, where a session is played as fast as possible and nothing else is said.
const FAST_ITERATIONS: u64 = 1_000_000;
/// Pairs of a recorded session that may wait for their overlay pictures.
const OVERLAY_FILES_MAX: usize = 64;
/// Pairs that may wait for being recorded: half a second of ordinary cameras.
const RECORDING_FILES: usize = 16;
/// Events that may wait for being recorded.
const LOGGED: usize = 1024;
/// A camera that is not there at the start, or not allowed yet, may still come for so long.
const CAMERA_PATIENCE: Duration = Duration::from_secs(5);
/// A camera that gives nothing for so long is silent, unless three of its periods are longer.
const SILENCE: Duration = Duration::from_millis(800);
/// How long a part is left alone whose targets failed.
const DEFER: Duration = Duration::from_secs(30);
/// Two grasps of one model closer than this are the same part, mm.
const SAME_PART_MM: f64 = 10.0;
/// The simulated arm of a soak is so many times as fast as an ordinary one, or there would be few targets to time.
const SOAK_TEMPO: f64 = 100.0;
/// Longest first line of a G-code pick, bytes.
const GCODE_LINE_BYTES: usize = 80;

/// A cell, ready to run.
pub(super) struct Setup {
    pub(super) cell: Cell,
    pub(super) core: Core,
    pub(super) arm: Arm,
    pub(super) cameras: [Camera; 2],
    pub(super) steps: Option<[Arc<Waker>; 2]>,
    pub(super) recognizer: Recognizer,
    /// The thread that its pictures are shared with, if any.
    pub(super) second: Option<hands::Helper>,
    pub(super) desk: Arc<Desk>,
    pub(super) seats: Seats,
    pub(super) wishes: Wishes,
    /// On the session's own time.
    pub(super) fast: bool,
    pub(super) period: Duration,
    /// When its pairs are played on the session's own time.
    pub(super) schedule: Schedule,
    pub(super) rig: Rig,
    pub(super) parts: Vec<Part>,
    /// Names of a recorded session's pairs; empty for live cameras.
    pub(super) names: Vec<String>,
}

/// The two cameras and what goes with them.
struct Eyes {
    cameras: [Camera; 2],
    steps: Option<[Arc<Waker>; 2]>,
    period: Duration,
    frame_bytes: usize,
    names: Vec<String>,
    pairs: usize,
    replayed: bool,
    /// What the session's arm answered, if it has one.
    arm: Option<Answers>,
    /// How the session's pairs were searched.
    repeated: Vec<Option<Repeated>>,
    /// When they are played on the session's own time.
    schedule: Schedule,
}

impl Setup {
    pub(super) fn new(args: &RunArgs) -> Result<Self, RunError> {
        let cell = Cell::read(&args.cell)?;
        let rig = Rig::read(&cell.rig.calibration)?;
        if let Some(doubt) = rig.doubt() {
            tracing::warn!("{}: {doubt}", cell.rig.calibration.display());
        }
        let parts = Part::read_all(&cell.recognition.parts)?;
        let recognizer = Recognizer::new(cell.recognition_params(), rig, parts.clone());
        let mut recognizer = recognizer.map_err(|error| cell.region_error(&error, &rig))?;
        let mut cell = cell;
        if args.soak.is_some() {
            // Nobody empties the tray of a soak.
            cell.place = None;
            // One period, not two: pairs must not even overlap.
            if let Rate::Hz(hz) = args.rate {
                cell.deadline.get_or_insert(Duration::from_secs_f64(1.0 / hz));
            }
        }
        let simulated = cell.arm_side.arm.link == LinkName::Replay;
        let record = cell.place.as_ref().map(|place| place_record(place, simulated)).transpose()?;
        let record = record.unwrap_or_default();
        let fast = args.soak.is_none() && cell.plays_fast();
        let out_of_time = if fast { Some("cameras.pace = \"fast\"") } else { args.soak.map(|_| "--soak") };
        if let Some(what) = out_of_time.filter(|_| !simulated && cell.cameras.backend == Backend::Replay) {
            return Err(RunError::RealArm { what });
        }
        let mut second = None;
        if cell.recognition.threads > 1 && !fast {
            let (owner, helper) = hands::hands().map_err(RunError::System)?;
            recognizer.share_with(owner);
            second = Some(helper);
        }
        let mut eyes = eyes(args, &cell, fast)?;
        cell.check_pair_window(eyes.period)?;
        let mut arm = match eyes.arm.take().filter(|_| simulated && args.soak.is_none()) {
            Some(answers) => {
                tracing::info!("the arm answers as that of the recorded session did");
                Arm::recorded(&cell.arm_side, answers, session_seed())
            }
            None if args.wait => Arm::open_or_wait(&cell.arm_side, session_seed())?,
            None => Arm::open(&cell.arm_side, session_seed())?,
        };
        if args.soak.is_some() {
            arm.hasten(SOAK_TEMPO);
        }
        let params = params(args, &cell, &eyes, record, fast);
        let core = Core::new(params, &cell.arm_side, Timestamp::now());
        let files = match args.overlay {
            _ if args.soak.is_some() || fast => 2,
            Some(Overlays::None) => 2,
            None if !eyes.replayed => 2,
            _ => eyes.pairs.clamp(2, OVERLAY_FILES_MAX),
        };
        let (more_files, logged) = match &cell.recording {
            Some(_) if fast => (0, LOGGED),
            Some(_) => (RECORDING_FILES, LOGGED),
            None => (0, 0),
        };
        let (desk, seats) =
            Desk::new(files + more_files, eyes.frame_bytes, logged).map_err(RunError::System)?;
        let desk = Arc::new(desk);
        let wishes = wishes(&cell.realtime);
        let Eyes { cameras, steps, period, names, schedule, .. } = eyes;
        Ok(Self {
            cell,
            core,
            arm,
            cameras,
            steps,
            recognizer,
            second,
            desk,
            seats,
            wishes,
            fast,
            period,
            schedule,
            rig,
            parts,
            names,
        })
    }
}

fn place_record(place: &PlaceGrid, simulated: bool) -> Result<PlaceRecord, RunError> {
    let mut record = place::read(&place.state)?;
    if simulated && record.next_slot >= place.columns * place.rows {
        tracing::info!("the tray of the simulated arm is full; it is taken for emptied");
        record.next_slot = 0;
    }
    let unwritable = |reason| RunError::Unwritable { path: place.state.clone(), reason };
    if let Some(folder) = place.state.parent() {
        std::fs::create_dir_all(folder).map_err(unwritable)?;
    }
    // Rather now than when the first part hangs in the gripper.
    place::write(&place.state, &record).map_err(unwritable)?;
    Ok(record)
}

fn eyes(args: &RunArgs, cell: &Cell, fast: bool) -> Result<Eyes, RunError> {
    match (cell.cameras.backend, &cell.cameras.session) {
        (Backend::Replay, Some(folder)) => replayed(args, folder, fast),
        _ if args.soak.is_some() => Err(RunError::SoakNeedsReplay),
        _ => live(cell, args.wait),
    }
}

fn replayed(args: &RunArgs, folder: &Path, fast: bool) -> Result<Eyes, RunError> {
    let session = Session::open(folder)?;
    if let Some(note) = session.break_note() {
        tracing::warn!("{note}");
    }
    let stepped = fast || (args.soak.is_some() && args.rate == Rate::Max);
    let steps = match stepped {
        true => Some([waker()?, waker()?]),
        false => None,
    };
    let period = match args.rate {
        Rate::Hz(hz) if args.soak.is_some() => Duration::from_secs_f64(1.0 / hz),
        _ => session.period(),
    };
    let timed = if args.soak.is_some() { Pace::Every(period) } else { Pace::AsRecorded };
    let pace = steps.clone().map_or(timed, Pace::Stepped);
    let played: Vec<&RecordedPair> =
        session.pairs.iter().filter(|pair| !stepped || pair.is_stepped()).collect();
    let names: Vec<_> = played.iter().map(|pair| pair.name.clone()).collect();
    let as_recorded = args.soak.is_none() && args.iterations.is_none() && args.seed.is_none();
    let repeated: Vec<_> = played.iter().map(|pair| as_recorded.then(|| repeated(pair)).flatten()).collect();
    if repeated.iter().any(Option::is_some) {
        tracing::info!(
            "searches have the budgets and seeds of the recording; --iterations or --seed gives others"
        );
    }
    let late_ns = session.arm_lead_ns.map_or(0, |ns| ns.saturating_neg().max(0));
    let arm = (!session.arm.is_empty()).then(|| Answers::new(&session.arm).connecting_after(late_ns));
    let schedule = Schedule {
        pairs: played.iter().map(|pair| moment(pair)).collect(),
        lead: session.arm_lead_ns.map_or(period, |ns| Duration::from_nanos(ns.max(0).unsigned_abs())),
    };
    let pairs = args.soak.map_or(names.len(), |pairs| usize::try_from(pairs).unwrap_or(usize::MAX));
    let sides = ReplayCamera::both(&session, &pace, pairs, args.raw)?;
    let frame_bytes = sides.iter().map(ReplayCamera::largest_bytes).max().unwrap_or(0);
    let cameras = sides.map(Camera::Replay);
    Ok(Eyes { cameras, steps, period, frame_bytes, names, pairs, replayed: true, arm, repeated, schedule })
}

/// What repeats the search of a recorded pair.
fn repeated(pair: &RecordedPair) -> Option<Repeated> {
    let Some(Fate::Searched { search: Some(search), .. }) = pair.fate else { return None };
    // One that ended by itself ends by itself again, and shall not be taken for one that was stopped there.
    let mut spent = search.spent;
    if !search.out_of_time {
        spent.iterations = spent.iterations.saturating_mul(2).max(FAST_ITERATIONS);
    }
    Some(Repeated { spent, seed: search.seed })
}

/// When a pair was seen, and how long after that the cell had decided about it.
fn moment(pair: &RecordedPair) -> Moment {
    let decided_after_ns = match pair.fate {
        Some(Fate::Searched { after_ns, .. }) => after_ns,
        _ => 0,
    };
    Moment { seen_ns: pair.after_ns, decided_after_ns }
}

fn waker() -> Result<Arc<Waker>, RunError> {
    Waker::new().map(Arc::new).map_err(RunError::System)
}

fn live(cell: &Cell, wait: bool) -> Result<Eyes, RunError> {
    use crate::camera::Trouble;
    use crate::camera::v4l::{V4lCamera, list};
    let (Some(left), Some(right)) = (&cell.cameras.left, &cell.cameras.right) else {
        unreachable!("a cell with live cameras has both: config checks it")
    };
    for (side, camera) in Side::BOTH.into_iter().zip([left, right]) {
        if let Some(better) = list::better_path(&camera.device) {
            let (side, device) = (side.name(), camera.device.display());
            tracing::warn!(
                "cameras.{side}.device = \"{device}\" is a number that changes when cameras are plugged in anew: left and \
                 right may change places; write {better} into cell.toml"
            );
        }
    }
    let open = |side: &'static str, settings: &CameraSettings| {
        let patience = if wait { Duration::ZERO } else { CAMERA_PATIENCE };
        match V4lCamera::open_within(settings.clone(), patience) {
            // It goes on trying, and says why it must.
            Err(reason) if wait && reason.trouble() != Trouble::NotAsAsked => {
                Ok(V4lCamera::closed(settings.clone()))
            }
            opened => opened.map_err(|reason| RunError::Camera { side, reason }),
        }
    };
    let opened = [open("left", left)?, open("right", right)?];
    let frame_bytes = opened.iter().map(V4lCamera::frame_bytes_max).max().unwrap_or(0);
    Ok(Eyes {
        cameras: opened.map(|camera| Camera::V4l(Box::new(camera))),
        steps: None,
        period: left.period(),
        frame_bytes,
        names: Vec::new(),
        pairs: 0,
        replayed: false,
        arm: None,
        repeated: Vec::new(),
        schedule: Schedule::default(),
    })
}

fn params(args: &RunArgs, cell: &Cell, eyes: &Eyes, record: PlaceRecord, fast: bool) -> Params {
    let period = eyes.period;
    let ns = |duration: Duration| i64::try_from(duration.as_nanos()).unwrap_or(i64::MAX);
    let arm = &cell.arm_side.arm;
    Params {
        window_ns: ns(cell.cameras.pair_window(period)),
        period_ns: ns(period),
        deadline_ns: ns(cell.deadline(period)),
        wire_ns: wire_ns(&cell.arm_side),
        ttl_ms: arm.ttl_ms,
        // A frame of unknown clock was taken at most so long before it was dequeued: exposure and transfer.
        handed_over_lag_ns: if eyes.replayed { 0 } else { 2 * ns(period) },
        silence_ns: ns(SILENCE.max(3 * period)),
        iterations: args.iterations.or(cell.recognition.iterations).or(fast.then_some(FAST_ITERATIONS)),
        seed: args.seed.unwrap_or(cell.recognition.seed),
        repeated: eyes.repeated.clone(),
        first_id: first_id(),
        place: cell.place.as_ref().map(pattern),
        record,
        defer_ns: ns(DEFER),
        same_part_mm: SAME_PART_MM,
    }
}

/// How long a target takes to get out on its wire.
fn wire_ns(settings: &Settings) -> i64 {
    let arm = &settings.arm;
    let bytes = match arm.dialect {
        DialectName::Own => PACKET_LEN_MAX,
        _ => GCODE_LINE_BYTES,
    };
    match arm.link {
        // A start bit, eight data bits, a stop bit.
        LinkName::Serial => bytes as i64 * 10 * 1_000_000_000 / i64::from(arm.baud.max(1)),
        _ => 200_000,
    }
}

fn pattern(grid: &PlaceGrid) -> PlacePattern {
    let half = grid.yaw_rad / 2.0;
    // Straight down, turned about base z.
    let orientation_xyzw = [half.cos(), half.sin(), 0.0, 0.0];
    PlacePattern {
        first: Pose { position_mm: grid.first_mm.into(), orientation_xyzw },
        column_step_mm: grid.column_step_mm.into(),
        row_step_mm: grid.row_step_mm.into(),
        columns: grid.columns.max(1),
        rows: grid.rows.max(1),
    }
}

/// A number above every target's of earlier runs: they rise by far less than a thousand a second.
fn first_id() -> u64 {
    wall_ms()
}

/// Two processes differ in it.
fn session_seed() -> u32 {
    (first_id() as u32).rotate_left(8) ^ std::process::id()
}

fn wishes(realtime: &Realtime) -> Wishes {
    let cores = if realtime.cores.is_empty() { hot_cores() } else { realtime.cores.clone() };
    let stack_bytes = realtime.stack_kib << 10;
    let wish = |priority: u8| Wish {
        fifo_priority: (realtime.scheduling == Scheduling::Fifo).then_some(priority),
        cores: cores.clone(),
        // The upper end of the stack is in use already, and the guard page must stay untouched.
        prefault_bytes: stack_bytes.saturating_sub(128 << 10),
    };
    Wishes {
        grab: wish(realtime.grab_priority),
        recognise: wish(realtime.recognise_priority),
        // It has work for a moment a pair, so that it may have the core that is else left alone, too.
        second: Wish { cores: realtime.cores.clone(), ..wish(realtime.recognise_priority) },
        arm: wish(realtime.arm_priority),
        stack_bytes,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_wire_takes_as_long_as_its_bits() {
        let text = |arm: &str| format!("[arm]\n{arm}\n[workspace]\nmin_mm = [0, 0, 0]\nmax_mm = [1, 1, 1]\n");
        let ns = |arm: &str| wire_ns(&Settings::parse(&text(arm)).unwrap());
        assert_eq!(ns("link = \"replay\""), 200_000);
        let own = ns("link = \"serial\"\nport = \"/dev/x\"\nbaud = 1000000");
        assert_eq!(own, PACKET_LEN_MAX as i64 * 10_000);
        assert_eq!(
            ns("link = \"serial\"\nport = \"/dev/x\"\nbaud = 100000\ndialect = \"grbl\"\naxes = \"xyz\""),
            8_000_000
        );
    }

    #[test]
    fn a_place_points_down_and_turns_about_the_vertical() {
        let grid = PlaceGrid {
            first_mm: [1.0, 2.0, 3.0].into(),
            column_step_mm: [20.0, 0.0, 0.0].into(),
            row_step_mm: [0.0, 30.0, 0.0].into(),
            columns: 4,
            rows: 2,
            yaw_rad: 90f64.to_radians(),
            state: "place.state".into(),
        };
        let pose = pattern(&grid).first;
        assert!(pose.approach().iter().zip([0.0, 0.0, -1.0]).all(|(a, b)| (a - b).abs() < 1e-12));
        assert!(pose.closing().iter().zip([0.0, 1.0, 0.0]).all(|(a, b)| (a - b).abs() < 1e-12));
    }
}
