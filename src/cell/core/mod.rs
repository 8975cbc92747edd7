//! Every decision of the cell: one [`Event`] and its time in, [`Action`]s out.
//!
//! Takes events; gives actions; owns the pairing, the state of the arm, the place pattern and the memory of failed
//! attempts. Pure: no clock, no device, no thread, no allocation, no lock. The same events at the same times give
//! the same actions, so a recording of the events is a recording of the cell.
//!
//! # The arm
//! ```text
//!                 ┌────────────────────── Disconnected, WrongVersion, ReportsLost, a suspend (any state)
//!                 ▼
//!            ┌─────────┐ Connected  ┌─────────┐  Unlock,        ┌──────────┐
//!            │ Absent  │───────────▶│  Held   │◀────────────────│ Alarmed  │◀── Alarm (from any state)
//!            └─────────┘            └─────────┘  then Held      └──────────┘
//!                                    │     ▲ ▲
//!         operator, or resume = auto │     │ └───── Held (from any state): operator, button, watchdog, reset
//!       (and no slot is in question) │     │
//!                                    ▼     │ no Ready in time
//!                                ┌───────────┐
//!                                │ Releasing │      homing, start moves
//!                                └───────────┘
//!                                    │ Ready
//!                                    ▼
//!            ┌───────────────▶  ┌─────────┐   a result of a pair, both of whose frames were taken after
//!            │ Ready, and       │ Looking │   the arm was last clear of the view and after the last target
//!            │ clear of view    └─────────┘   ended, in time, past the gate, its slot on disk
//!            │ or dwell over         │
//!            │                       ▼ Command::Pick
//!            │                  ┌─────────┐ Sent ┌──────┐ Accepted ┌──────────┐ Moving ┌────────┐
//!            │                  │ Ordered │─────▶│ Sent │─────────▶│ Accepted │───────▶│ Moving │
//!            │                  └─────────┘      └──────┘          └──────────┘        └────────┘
//!            │                       │               │                  │                  │
//!            │                       ▼               ▼                  ▼                  ▼
//!            └──── Done · Failed · Refused · Lost: exactly one of them for every target (Note::Ended)
//! ```
//! A part whose target failed is tried again from a new pair, up to `retries` times; then the next best part is
//! taken; when every part in sight was tried, that is said and they are left alone for `defer_ns`.
//!
//! Recognition runs on every pair, whatever the arm does; only in `Looking` may its result become a target.
//!
//! # Start and end
//! The cell starts on hold. What the arm says about the target that was unfinished when the last run ended decides
//! about its slot, before anything is released. `Event::Stop` tells the arm to hold, waits for its word (at most
//! [`STOP_NS`]) and ends. The end of a recorded session first lets the pair and the target under way end.

mod action;
mod arm;
mod cameras;
mod choose;
mod count;
mod event;
mod place;
mod state;

use firmware_bridge::config::{Resume, Settings};
use firmware_bridge::gate::Gate;
use firmware_bridge::message::{Command, Pose};

pub use action::{Action, Actions, Alarm, Ending, Job, NoPick, Note, PairReport, TargetEnd, TargetSent};
pub use count::{Cause, Counts};
pub use event::{CANDIDATES_MAX, Candidate, Event, Found, Grasp, Nothing, Operator, PlaceRecord};
pub use state::State;

use super::pairing::{FrameSeen, Handle, Pair, Pairing};
use crate::camera::Side;
use crate::frame::TimestampMark;
use crate::time::{Budget, Spent, Timestamp};
use arm::ArmSide;
use cameras::CameraState;
use choose::Tried;
use place::Place;

/// How long `Event::Stop` waits for the arm to say that it holds, ns: Marlin cleans its planner for up to three seconds, and
/// needs half a second more to be killed where it moves on all the same.
pub const STOP_NS: i64 = 4_000_000_000;

/// What the core needs to know of its cell.
#[derive(Clone, Debug, PartialEq)]
pub struct Params {
    /// Frames further apart are no pair, ns.
    pub window_ns: i64,
    /// Frame period, ns.
    pub period_ns: i64,
    /// From the older frame to the last byte of its target on the wire, ns.
    pub deadline_ns: i64,
    /// Part of the deadline that is kept for the target's way to the wire, ns.
    pub wire_ns: i64,
    /// Time to live of a target, ms.
    pub ttl_ms: u32,
    /// How long before a time stamp marked [`TimestampMark::HandedOver`] the picture may have been taken, ns; 0 for
    /// a replayed session. For the end of a frame it is a period, for the start of the exposure nothing.
    pub handed_over_lag_ns: i64,
    /// A camera that gives nothing for so long is called silent, ns.
    pub silence_ns: i64,
    /// Budget of a search in iterations; `None`: until the deadline.
    pub iterations: Option<u64>,
    /// Seed of all searches.
    pub seed: u64,
    /// Budgets and seeds of single searches, by the number of their left frame: a recorded session is searched as it was.
    pub repeated: Vec<Option<Repeated>>,
    /// Number of the first target, above every number ever given away.
    pub first_id: u64,
    /// Where parts go.
    pub place: Option<PlacePattern>,
    /// How far the pattern was filled when the last run ended.
    pub record: PlaceRecord,
    /// How long a part is left alone whose targets failed, ns.
    pub defer_ns: i64,
    /// Two grasps of one part model closer than this are the same part, mm.
    pub same_part_mm: f64,
}

/// A search that is made once more.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Repeated {
    /// What it may use up.
    pub spent: Spent,
    /// Its seed.
    pub seed: u64,
}

/// A grid of slots, row by row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlacePattern {
    /// Tool pose at the first slot, base frame.
    pub first: Pose,
    /// From a slot to the next in its row, mm.
    pub column_step_mm: [f64; 3],
    /// From a row to the next, mm.
    pub row_step_mm: [f64; 3],
    /// Slots in a row, at least 1.
    pub columns: u32,
    /// Rows, at least 1.
    pub rows: u32,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Running,
    /// The session is over; what is under way may end, until then.
    Draining(Timestamp),
    /// Told to end; the arm's word is waited for, until then.
    Stopping(Timestamp),
    Ended,
}

/// The core of the cell.
#[derive(Clone, Debug)]
pub struct Core {
    params: Params,
    settings: Settings,
    gate: Gate,
    phase: Phase,
    cameras: [CameraState; 2],
    pairing: Pairing,
    alone_in_a_row: u32,
    searching: Option<Pair>,
    waiting: Option<Pair>,
    arm: ArmSide,
    place: Place,
    tried: Tried,
    counts: Counts,
}

impl Core {
    /// A cell on hold at the time `now`.
    pub fn new(params: Params, settings: &Settings, now: Timestamp) -> Self {
        let cameras = [CameraState { last_arrival: Some(now), ..CameraState::default() }; 2];
        Self {
            gate: Gate::new(settings),
            settings: settings.clone(),
            phase: Phase::Running,
            cameras,
            pairing: Pairing::new(params.window_ns),
            alone_in_a_row: 0,
            searching: None,
            waiting: None,
            arm: ArmSide::new(params.first_id.max(params.record.next_id), now),
            place: Place::new(params.place, params.record),
            tried: Tried::new(),
            counts: Counts::default(),
            params,
        }
    }

    /// What happened at `now`, and what is to be done about it: appended to `actions`.
    pub fn run(&mut self, event: &Event, now: Timestamp, actions: &mut Actions) {
        if self.phase == Phase::Ended {
            if let Event::Frame(frame) = event {
                actions.push(Action::Free(frame.handle));
            }
            return;
        }
        match *event {
            Event::Frame(frame) => self.frame(frame, now, actions),
            Event::CameraLost { side, trouble } => {
                self.lose_camera(side, Alarm::CameraLost { side, trouble }, actions);
            }
            Event::CameraBack { side } => {
                self.cameras[side.index()].last_arrival = Some(now);
                self.camera_is_back(side, actions);
            }
            Event::CameraEnded { side } => self.camera_ended(side, now, actions),
            Event::Recognised { pair, ref found } => self.recognised(pair, found, now, actions),
            Event::Arm(ref report) => self.arm_says(report, now, actions),
            Event::NotTaken { id, refusal } => self.end_target(id, TargetEnd::Refused(refusal), now, actions),
            Event::Persisted(record) => self.place.persisted(record),
            Event::NotPersisted => self.place.not_persisted(now, actions),
            Event::Operator(operator) => self.operator(operator, now, actions),
            Event::Suspended { for_ns } => self.suspended(for_ns, now, actions),
            Event::Stop => self.stop(now, actions),
            Event::Tick => {}
        }
        self.time_passes(now, actions);
    }

    /// When the core wants an `Event::Tick` at the latest.
    pub fn next_tick(&self) -> Option<Timestamp> {
        let silence = |camera: &CameraState| match camera {
            CameraState { lost: Some(_), .. } | CameraState { ended: true, .. } => None,
            camera => camera.last_arrival.map(|t| Timestamp(t.0.saturating_add(self.params.silence_ns))),
        };
        let phase = match self.phase {
            Phase::Draining(until) | Phase::Stopping(until) => Some(until),
            Phase::Running => None,
            Phase::Ended => return None,
        };
        let times = [
            phase,
            silence(&self.cameras[0]),
            silence(&self.cameras[1]),
            self.arm.next_tick(),
            self.place.next_tick(),
        ];
        times.into_iter().flatten().min()
    }

    /// What the arm is doing.
    pub fn state(&self) -> State {
        match self.phase {
            Phase::Stopping(_) | Phase::Ended => State::Stopping,
            _ => self.arm.state(),
        }
    }

    /// What was counted up to now.
    pub fn counts(&self) -> &Counts {
        &self.counts
    }

    fn time_passes(&mut self, now: Timestamp, actions: &mut Actions) {
        for side in Side::BOTH {
            let camera = &self.cameras[side.index()];
            let quiet_ns = camera.last_arrival.map_or(0, |last| now.since(last));
            if quiet_ns >= self.params.silence_ns && !camera.ended {
                self.lose_camera(side, Alarm::CameraSilent { side }, actions);
            }
        }
        self.arm_time_passes(now, actions);
        match self.phase {
            Phase::Draining(until) => {
                let idle =
                    self.searching.is_none() && self.waiting.is_none() && self.arm.unfinished().is_none();
                if idle || now >= until {
                    self.stop(now, actions);
                }
            }
            Phase::Stopping(until) if self.arm.is_quiet() || now >= until => {
                self.end(Ending::Done, now, actions)
            }
            _ => {}
        }
    }

    // ---- recognition -------------------------------------------------------------------------------------------

    fn search(&mut self, pair: Pair, actions: &mut Actions) {
        self.searching = Some(pair);
        let until = pair.earliest().0.saturating_add(self.params.deadline_ns - self.params.wire_ns);
        let repeated = self.params.repeated.get(pair.left.sequence as usize).copied().flatten();
        let budget = match (repeated, self.params.iterations) {
            (Some(search), _) => Budget::Repeated(search.spent),
            (None, Some(iterations)) => Budget::Iterations(iterations),
            (None, None) => Budget::Until(Timestamp(until)),
        };
        let seed = repeated.map_or(self.params.seed.wrapping_add(pair.number), |search| search.seed);
        actions.push(Action::Recognise(Job { pair, budget, seed }));
    }

    fn recognised(&mut self, number: u64, found: &Found, now: Timestamp, actions: &mut Actions) {
        let Some(pair) = self.searching.filter(|pair| pair.number == number) else { return };
        self.searching = None;
        self.counts.add(Cause::Parts, u64::from(found.parts));
        let outcome = self.decide(&pair, found, now, actions);
        self.finish_pair(&pair, now, outcome, actions);
        if let Some(pair) = self.waiting.take() {
            match self.phase {
                Phase::Stopping(_) => self.finish_pair(&pair, now, Err(NoPick::Stopping), actions),
                _ => self.search(pair, actions),
            }
        }
    }

    fn finish_pair(
        &mut self,
        pair: &Pair,
        now: Timestamp,
        outcome: Result<TargetSent, NoPick>,
        actions: &mut Actions,
    ) {
        let deadline_kept = now.since(pair.earliest()) <= self.params.deadline_ns;
        if !deadline_kept && outcome != Err(NoPick::Superseded) {
            self.counts.add(Cause::DeadlineMissed, 1);
        }
        actions.say(Note::Pair(PairReport { pair: *pair, at: now, outcome, deadline_kept }));
        actions.push(Action::Free(pair.left.handle));
        actions.push(Action::Free(pair.right.handle));
    }

    /// When the light of this frame was collected at the earliest.
    fn taken_from(&self, frame: &FrameSeen) -> Timestamp {
        let lag_ns = match frame.mark {
            TimestampMark::StartOfExposure => 0,
            TimestampMark::EndOfFrame => self.params.period_ns,
            TimestampMark::HandedOver => self.params.handed_over_lag_ns,
        };
        Timestamp(frame.timestamp.0.saturating_sub(lag_ns))
    }

    // ---- the end -----------------------------------------------------------------------------------------------

    fn stop(&mut self, now: Timestamp, actions: &mut Actions) {
        if matches!(self.phase, Phase::Stopping(_) | Phase::Ended) {
            return;
        }
        self.phase = Phase::Stopping(Timestamp(now.0.saturating_add(STOP_NS)));
        for side in Side::BOTH {
            if let Some(handle) = self.pairing.forget(side) {
                actions.push(Action::Free(handle));
            }
        }
        if let Some(pair) = self.waiting.take() {
            self.finish_pair(&pair, now, Err(NoPick::Stopping), actions);
        }
        if self.arm.is_connected() {
            actions.push(Action::Arm(Command::Hold));
            self.arm.await_hold();
        }
    }

    fn end(&mut self, ending: Ending, now: Timestamp, actions: &mut Actions) {
        if let Some(pair) = self.searching.take() {
            self.finish_pair(&pair, now, Err(NoPick::Stopping), actions);
        }
        if let Some(id) = self.arm.unfinished() {
            // Its slot stays in question on disk: the next start asks about it.
            self.counts.add(Cause::Abandoned, 1);
            actions.say(Note::Ended { id, end: TargetEnd::Abandoned });
        } else {
            self.place.give_up_reservation(actions);
        }
        self.phase = Phase::Ended;
        actions.push(Action::End(ending));
    }

    fn manual(&self) -> bool {
        self.settings.arm.resume == Resume::Manual
    }
}

/// Frames that the carrier must be able to keep: two waiting, two in the search, two behind it, two on the way.
pub const HANDLES: usize = 8;

impl Handle {
    /// As an index below [`HANDLES`].
    pub fn index(self) -> usize {
        usize::from(self.0)
    }
}

#[cfg(test)]
mod tests;
