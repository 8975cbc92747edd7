//! What the core wants done, and what it says about it.

use firmware_bridge::message::{Command, Disconnect, Failure, HeldBy, Refusal};
use serde::{Deserialize, Serialize};

use super::event::{Nothing, PlaceRecord};
use crate::camera::{Side, Trouble};
use crate::cell::pairing::{Handle, Pair};
use crate::time::{Budget, Timestamp};

/// One thing to do.
#[derive(Clone, Copy, Debug, PartialEq)]
#[expect(
    clippy::large_enum_variant,
    reason = "actions are handed over by value; nothing may be allocated for them"
)]
pub enum Action {
    /// Recognise this pair; answer with `Event::Recognised`. Never a second one before the answer.
    Recognise(Job),
    /// The pixels of this frame are not needed any more.
    Free(Handle),
    /// Say this to the arm.
    Arm(Command),
    /// Write and sync this record; answer with `Event::Persisted` or `Event::NotPersisted`.
    Persist(PlaceRecord),
    /// Tell people.
    Say(Note),
    /// All is ended; nothing will follow.
    End(Ending),
}

/// A search to be made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Job {
    /// The pair.
    pub pair: Pair,
    /// What it may use up.
    pub budget: Budget,
    /// Its seed: the cell's, and the pair's number.
    pub seed: u64,
}

/// How the cell ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// It was asked to, or its session is over.
    Done,
    /// The arm speaks another version of the protocol, or another dialect: the configuration is wrong.
    WrongArm,
}

/// What became of a target; exactly one for every target that was ordered.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum TargetEnd {
    /// The part lies in its place.
    Done,
    /// It was begun, or may have been, without success.
    Failed(Failure),
    /// It was never begun.
    Refused(Refusal),
    /// Nobody knows: link or controller died under it, or its time was over.
    Lost,
    /// The program ended before it did.
    Abandoned,
}

impl std::fmt::Display for TargetEnd {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            TargetEnd::Done => write!(f, "done"),
            TargetEnd::Failed(Failure::PartNotHeld) => write!(f, "failed: the part was not held"),
            TargetEnd::Failed(Failure::Held) => write!(f, "failed: interrupted by a hold"),
            TargetEnd::Failed(Failure::Alarm) => write!(f, "failed: alarm of the controller"),
            TargetEnd::Failed(Failure::Restarted) => write!(f, "failed: the controller restarted"),
            TargetEnd::Failed(Failure::TimedOut) => write!(f, "failed: it took too long"),
            TargetEnd::Failed(Failure::Controller { code }) => {
                write!(f, "failed: error {code} of the controller")
            }
            TargetEnd::Refused(refusal) => write!(f, "refused: {refusal}"),
            TargetEnd::Lost => write!(f, "lost: link or controller died under it, it is not sent again"),
            TargetEnd::Abandoned => write!(f, "unfinished when the cell stopped"),
        }
    }
}

/// Why a pair led to no target.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum NoPick {
    /// The recogniser offers nothing.
    Nothing(Nothing),
    /// The result came after the deadline.
    Late,
    /// The arm is not connected.
    ArmAbsent,
    /// The arm is on hold.
    OnHold,
    /// The controller is in alarm.
    InAlarm,
    /// Released, but not ready yet (homing, for example).
    ArmNotReady,
    /// A target is under way.
    ArmBusy,
    /// A picture was taken before the arm was clear of the view, or before the last target ended.
    NotClear,
    /// The next slot of the place pattern is not on disk yet.
    SlotNotSaved,
    /// Every slot of the place pattern is filled.
    PlaceFull,
    /// Every part in sight was tried and failed.
    AllDeferred,
    /// The last gate refused every candidate; this is the first one's refusal.
    Gate(Refusal),
    /// The cell is stopping.
    Stopping,
    /// A newer pair came before the recogniser was free.
    Superseded,
}

impl NoPick {
    /// All reasons in words; [`NoPick::kind`] is an index into it.
    pub const KINDS: [&str; 25] = [
        "bin empty",
        "nothing recognised",
        "all blocked",
        "search cut short",
        "bad picture",
        "picture over limits",
        "no base_from_left",
        "cameras mixed up",
        "picture white all over",
        "picture black all over",
        "picture is noise",
        "picture the same all over",
        "too late",
        "arm not connected",
        "on hold",
        "controller in alarm",
        "arm not ready",
        "arm busy",
        "arm in view",
        "slot not saved yet",
        "place pattern full",
        "all parts deferred",
        "refused by the last gate",
        "stopping",
        "recogniser busy",
    ];

    /// Which of [`NoPick::KINDS`].
    pub fn kind(&self) -> usize {
        const NOTHINGS: usize = Nothing::Flat as usize + 1;
        match self {
            NoPick::Nothing(nothing) => *nothing as usize,
            NoPick::Late => NOTHINGS,
            NoPick::ArmAbsent => NOTHINGS + 1,
            NoPick::OnHold => NOTHINGS + 2,
            NoPick::InAlarm => NOTHINGS + 3,
            NoPick::ArmNotReady => NOTHINGS + 4,
            NoPick::ArmBusy => NOTHINGS + 5,
            NoPick::NotClear => NOTHINGS + 6,
            NoPick::SlotNotSaved => NOTHINGS + 7,
            NoPick::PlaceFull => NOTHINGS + 8,
            NoPick::AllDeferred => NOTHINGS + 9,
            NoPick::Gate(_) => NOTHINGS + 10,
            NoPick::Stopping => NOTHINGS + 11,
            NoPick::Superseded => NOTHINGS + 12,
        }
    }
}

impl std::fmt::Display for NoPick {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(Self::KINDS[self.kind()])?;
        match self {
            NoPick::Gate(refusal) => write!(f, ": {refusal}"),
            _ => Ok(()),
        }
    }
}

/// What became of a pair.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PairReport {
    /// The pair.
    pub pair: Pair,
    /// When the core was finished with it.
    pub at: Timestamp,
    /// The target it led to, or why it led to none.
    pub outcome: Result<TargetSent, NoPick>,
    /// The result was there before the deadline.
    pub deadline_kept: bool,
}

/// A target that went to the arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TargetSent {
    /// Its number.
    pub id: u64,
    /// Which of the candidates.
    pub candidate: u8,
}

/// Why the cell stopped, or cannot go on as it should. Each says one thing.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Alarm {
    /// A camera says why it gives nothing.
    CameraLost {
        /// Which.
        side: Side,
        /// Why.
        trouble: Trouble,
    },
    /// A camera gives nothing and says nothing.
    CameraSilent {
        /// Which.
        side: Side,
    },
    /// Both cameras deliver, but never within the window.
    CamerasOutOfStep {
        /// The last distance, µs.
        skew_us: i64,
    },
    /// The link to the arm is gone.
    ArmLost {
        /// How it was noticed.
        cause: Disconnect,
    },
    /// The arm has never answered.
    ArmSilent,
    /// The arm is on hold and waits for the operator's release.
    OnHold {
        /// Why.
        by: HeldBy,
    },
    /// The controller refuses to move.
    Controller {
        /// The dialect's number.
        code: u16,
    },
    /// The arm's coordinates mean nothing until it was homed.
    PositionUnknown,
    /// A target took longer than it may; the arm is told to hold.
    TargetTimedOut {
        /// The target.
        id: u64,
    },
    /// Reports of the arm were lost; a new session is opened.
    ReportsLost,
    /// The place pattern is full.
    PlaceFull,
    /// The place record cannot be written; nothing is sent.
    PlaceNotSaved,
    /// Nobody knows whether a part lies in this slot; it is left out.
    SlotLeftOut {
        /// The slot.
        slot: u32,
    },
    /// Every part in sight was tried and failed.
    AllDeferred,
    /// The arm speaks another version of the protocol.
    WrongVersion {
        /// Ours.
        ours: u16,
        /// The arm's.
        theirs: u16,
    },
    /// What answers is no arm of this dialect.
    WrongDialect,
    /// The machine was suspended to RAM; the arm is told to hold, and only the operator releases it.
    Suspended {
        /// For so long, rounded up.
        seconds: u64,
    },
    /// A release that came while there was nothing to release.
    NothingToRelease,
}

impl std::fmt::Display for Alarm {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match *self {
            Alarm::CameraLost { side, trouble } => write!(f, "{} camera: {trouble}", side.name()),
            Alarm::CameraSilent { side } => write!(f, "{} camera: sends no frames", side.name()),
            Alarm::CamerasOutOfStep { skew_us } => write!(
                f,
                "cameras out of step: {skew_us} µs apart; set both to the same rate, or widen pair_window_ms"
            ),
            Alarm::ArmLost { cause } => write!(f, "arm lost ({cause:?}); the cell goes on looking for it"),
            Alarm::ArmSilent => write!(
                f,
                "the arm does not answer; is it switched on (or, with shared memory, `firmware-bridge run` started)? \
                 Else check arm.port, arm.baud and arm.dialect"
            ),
            Alarm::OnHold { by } => {
                write!(f, "arm on hold ({by:?}); release it with SIGUSR1 when it is safe to move")
            }
            Alarm::Controller { code: 0 } => {
                write!(
                    f,
                    "controller in an alarm it does not name; look at the arm, then release it with SIGUSR1"
                )
            }
            Alarm::Controller { code } => {
                write!(f, "controller in alarm {code}; look at the arm, then release it with SIGUSR1")
            }
            Alarm::PositionUnknown => write!(f, "the arm does not know where it is; home it"),
            Alarm::TargetTimedOut { id } => write!(f, "target {id} took too long; the arm is told to hold"),
            Alarm::ReportsLost => write!(f, "reports of the arm were lost; shaking hands anew"),
            Alarm::PlaceFull => write!(f, "place pattern full; empty it, then release with SIGUSR1"),
            Alarm::PlaceNotSaved => {
                write!(
                    f,
                    "the place record cannot be written; nothing is sent. Check place.state and the disk"
                )
            }
            Alarm::SlotLeftOut { slot } => {
                write!(f, "nobody knows whether a part lies in slot {slot}; it is left out")
            }
            Alarm::AllDeferred => {
                write!(f, "every part in sight was tried and failed; they are left for a while")
            }
            Alarm::WrongVersion { ours, theirs } => write!(
                f,
                "the arm speaks version {theirs} of the protocol, this cell version {ours}; bring both to one version"
            ),
            Alarm::WrongDialect => {
                write!(f, "what answers is no arm of this dialect; check arm.dialect and arm.port")
            }
            Alarm::Suspended { seconds } => write!(
                f,
                "the machine was suspended for {seconds} s; the arm is told to hold: look at the cell, then release it \
                 with SIGUSR1. `systemctl mask sleep.target suspend.target` keeps the machine awake"
            ),
            Alarm::NothingToRelease => write!(f, "release without effect: no arm is on hold"),
        }
    }
}

/// What people and counters are told.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Note {
    /// A pair is finished with.
    Pair(PairReport),
    /// The last byte of a target is on the wire.
    Sent {
        /// The target.
        id: u64,
        /// From the older frame to the last byte, ns.
        frame_to_wire_ns: i64,
        /// Within the deadline.
        deadline_kept: bool,
    },
    /// The arm has taken a target; it is not done.
    Accepted {
        /// The target.
        id: u64,
    },
    /// A target is over.
    Ended {
        /// The target.
        id: u64,
        /// How.
        end: TargetEnd,
    },
    /// Something is wrong.
    Alarm(Alarm),
    /// A camera delivers again.
    CameraBack {
        /// Which.
        side: Side,
    },
    /// The arm shook hands.
    Connected {
        /// Number of the session.
        session: u32,
    },
    /// The arm is told to move again.
    Released,
    /// The arm is ready for targets.
    Ready,
    /// A slot of the place pattern is filled.
    SlotFilled {
        /// The slot.
        slot: u32,
    },
}

/// A list of actions with a fixed capacity.
#[derive(Clone, Debug)]
pub struct Actions {
    list: [Option<Action>; Actions::CAPACITY],
    len: usize,
}

impl Actions {
    /// No event leads to more.
    pub const CAPACITY: usize = 24;

    /// An empty list.
    pub fn new() -> Self {
        Self { list: [None; Self::CAPACITY], len: 0 }
    }

    /// Empties it.
    pub fn clear(&mut self) {
        self.len = 0;
    }

    /// Appends.
    ///
    /// # Panics
    /// Beyond [`Actions::CAPACITY`], which no sequence of events reaches.
    pub fn push(&mut self, action: Action) {
        self.list[self.len] = Some(action);
        self.len += 1;
    }

    /// Appends a note.
    pub fn say(&mut self, note: Note) {
        self.push(Action::Say(note));
    }

    /// In the order in which they are to be done.
    pub fn iter(&self) -> impl Iterator<Item = Action> + '_ {
        self.list[..self.len].iter().flatten().copied()
    }
}

impl Default for Actions {
    fn default() -> Self {
        Self::new()
    }
}
