//! The engine: what is sent when, for all dialects of G-code.
//!
//! Takes commands, time and the events of a [`Wire`]; gives reports and lines; owns the arm's state, the pick under
//! way and its place in the templates. Moves that follow each other are sent as fast as the wire takes them;
//! before anything else (gripper, wait, question, end) the arm must stand where it was sent. Whatever goes
//! wrong ends in a stop and a hold.
//!
//! ```text
//! down ── port ──> connecting ── handshake ──> held <──────────────── stopping <── hold, error, alarm, time-out
//!                       ^                       │ release                              │
//!                       │ silence, banner       v                                      │
//!                       └──────────────── starting ──> ready ── pick ──> working ──────┘
//!                                                        ^───── done ───────┘
//! ```

mod events;
mod lines;

use super::template::{List, Program, Step, TemplateError};
use super::wire::{Events, MS, Wire};
use super::words::Kind;
use crate::config::Settings;
use crate::dialect::{Reports, Transmit};
use crate::gate::Gate;
use crate::message::{Command, Disconnect, Failure, HeldBy, Outcome, Pick, Refusal, Report, Waypoint};
use std::collections::VecDeque;

/// Longest time from a release to the arm being ready, homing included.
const START_NS: i64 = 180_000 * MS;
/// Longest time for a stop to be confirmed.
const STOP_NS: i64 = 10_000 * MS;
/// How often a position is asked again when it is not the commanded one (a byte may have been lost).
const POSITION_TRIES: u8 = 3;
/// How far outside the room between its points an arm may be seen on its way, mm.
const ROOM_MM: f64 = 2.0;
/// How long it is asked again before it is taken to be outside.
const STRAY_NS: i64 = 60 * MS;
/// Where an arm says that it stands and where it was sent are the same: a position has two decimals.
const ARRIVED_MM: f64 = 0.02;
/// How many picks the engine remembers the outcome of.
const HISTORY: usize = 32;
/// Most lines on their way.
const FLIGHT_MAX: usize = 32;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Down,
    Connecting,
    Held,
    /// Getting ready after a release.
    Starting,
    Ready,
    /// A pick, or the way out of the view after it.
    Working,
    Stopping,
}

/// Within the lines of a list.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    /// The wire throws away what a stop left behind.
    Settling,
    /// An alarm is being left first.
    Unlocking,
    /// The line of the preamble with this index is next.
    Preamble(u8),
    /// The pose of the pick with this index is asked about.
    Reaching(u8),
    Lines,
    Syncing,
    AskingHeld,
    WaitingUntil(i64),
}

#[derive(Clone, Copy, Debug)]
struct Current {
    pick: Pick,
    /// A line of it before its first move is on the wire: from then on its time to live counts, not the deadline of the
    /// target's bytes.
    sent: bool,
    /// The bytes of its first move were made.
    begun: bool,
    /// Its first move was acknowledged.
    accepted: bool,
}

/// A dialect of G-code: the engine with its wire.
#[derive(Debug)]
pub struct Driver<W> {
    wire: W,
    program: Program,
    gate: Gate,
    events: Events,
    reports: Reports,
    phase: Phase,
    stage: Stage,
    list: List,
    next: usize,
    flight: VecDeque<Kind>,
    /// Moves were sent since the arm was last seen standing.
    moved: bool,
    expected_mm: [Option<f64>; 3],
    /// Where it was last seen, mm.
    seen_mm: [Option<f64>; 3],
    /// Smallest and largest coordinate of the moves under way and of where they began, mm.
    room_mm: [Option<(f64, f64)>; 3],
    position_tries: u8,
    /// It was last seen outside that room, and is stopped then unless it is seen inside.
    stray_until_ns: Option<i64>,
    deadline_ns: Option<i64>,
    session: u32,
    last_sequence: Option<u32>,
    connected_before: bool,
    current: Option<Current>,
    /// How the pick ends when the stop is confirmed.
    ending: Failure,
    held_by: HeldBy,
    alarm: Option<u16>,
    unlock_only: bool,
    clear_of_view: bool,
    /// One way to the controller, µs.
    delay_us: u32,
    not_before_ns: i64,
    pick_timeout_ns: i64,
    /// One byte on the wire: ten bits.
    byte_ns: i64,
    history: [Option<(u64, Outcome)>; HISTORY],
    history_next: usize,
}

#[allow(private_bounds)]
impl<W: Wire> Driver<W> {
    /// All memory; checks the move templates. Session numbers start at `session_seed`.
    pub fn new(settings: &Settings, session_seed: u32) -> Result<Self, TemplateError> {
        Ok(Self {
            wire: W::new(settings),
            program: Program::compile(settings)?,
            gate: Gate::new(settings),
            events: Events::new(),
            reports: Reports::new(),
            phase: Phase::Down,
            stage: Stage::Lines,
            list: List::Start,
            next: 0,
            flight: VecDeque::with_capacity(FLIGHT_MAX),
            moved: false,
            expected_mm: [None; 3],
            seen_mm: [None; 3],
            room_mm: [None; 3],
            stray_until_ns: None,
            position_tries: 0,
            deadline_ns: None,
            session: session_seed,
            last_sequence: None,
            connected_before: false,
            current: None,
            ending: Failure::Held,
            held_by: HeldBy::Start,
            alarm: None,
            unlock_only: false,
            clear_of_view: false,
            delay_us: 0,
            not_before_ns: i64::MIN,
            pick_timeout_ns: i64::from(settings.arm.pick_timeout_ms) * MS,
            byte_ns: 10_000_000_000 / i64::from(settings.arm.baud),
            history: [None; HISTORY],
            history_next: 0,
        })
    }

    /// The port was opened, or is gone.
    pub fn on_link(&mut self, up: bool, now_ns: i64) {
        if up {
            self.phase = Phase::Connecting;
            self.forget_lines();
            self.wire.open(now_ns);
        } else {
            self.wire.close();
            self.disconnect(Disconnect::PortGone, Phase::Down);
        }
    }

    /// Bytes that arrived.
    pub fn on_bytes(&mut self, bytes: &[u8], now_ns: i64) {
        if self.phase == Phase::Down {
            return;
        }
        for chunk in bytes.chunks(256) {
            self.wire.on_bytes(chunk, now_ns, &mut self.events);
            self.digest(now_ns);
        }
    }

    /// What the cell says. `Err`: it was not taken.
    pub fn command(&mut self, command: Command, now_ns: i64) -> Result<(), Refusal> {
        match command {
            Command::Pick(pick) => self.take_pick(pick, now_ns).inspect_err(|_| {
                if self.phase == Phase::Ready && self.alarm.is_none() {
                    self.reports.push(Report::Ready { clear_of_view: self.clear_of_view });
                }
            }),
            Command::Hold => {
                if self.phase != Phase::Down {
                    self.begin_stop(Failure::Held, HeldBy::Command, now_ns);
                }
                Ok(())
            }
            Command::Release => self.release(now_ns),
            Command::Unlock => self.unlock(now_ns),
            Command::Hello => {
                if self.phase == Phase::Down {
                    return Err(Refusal::NotConnected);
                }
                self.disconnect(Disconnect::NewSession, Phase::Connecting);
                self.wire.greet(now_ns);
                Ok(())
            }
            Command::Query { id } => {
                let current = self.current.filter(|current| current.pick.id == id);
                let known = self.history.iter().flatten().find(|(other, _)| *other == id);
                let outcome = match current {
                    Some(_) => Outcome::Unfinished,
                    None => known.map_or(Outcome::Unknown, |&(_, outcome)| outcome),
                };
                self.reports.push(Report::Outcome { id, outcome });
                Ok(())
            }
        }
    }

    /// Lets time pass; the next report.
    pub fn poll(&mut self, now_ns: i64) -> Option<Report> {
        if self.phase != Phase::Down {
            self.wire.on_time(now_ns, &mut self.events);
            self.digest(now_ns);
            if self.stray_until_ns.is_some_and(|at| now_ns >= at) {
                self.stop_astray(now_ns);
            }
            if self.deadline_ns.is_some_and(|at| now_ns >= at) {
                self.deadline_ns = None;
                self.out_of_time(now_ns);
            }
        }
        self.reports.pop()
    }

    /// The next bytes to write.
    pub fn transmit(&mut self, now_ns: i64, out: &mut [u8]) -> Transmit {
        if self.phase == Phase::Down {
            return Transmit::default();
        }
        let (len, urgent) = self.wire.transmit(now_ns, out);
        if len > 0 {
            return Transmit { len, urgent, pick: None };
        }
        self.pump(now_ns, out)
    }

    /// The bytes that begin this pick are written.
    pub fn on_written(&mut self, id: u64, at_ns: i64) {
        self.reports.push(Report::Sent { id, at_ns });
    }

    /// Whether bytes wait that overtake everything.
    pub fn has_urgent(&self) -> bool {
        self.wire.has_urgent()
    }

    /// When there is something to do without a byte.
    pub fn next_deadline_ns(&self) -> Option<i64> {
        if !self.reports.is_empty() {
            return Some(i64::MIN);
        }
        if self.phase == Phase::Down {
            return None;
        }
        let wait = match self.stage {
            Stage::WaitingUntil(at) => Some(at),
            _ => None,
        };
        [self.wire.deadline_ns(), self.deadline_ns, self.stray_until_ns, wait].into_iter().flatten().min()
    }

    fn take_pick(&mut self, pick: Pick, now_ns: i64) -> Result<(), Refusal> {
        match self.phase {
            Phase::Down | Phase::Connecting => return Err(Refusal::NotConnected),
            _ if self.alarm.is_some() => return Err(Refusal::InAlarm),
            Phase::Held | Phase::Starting | Phase::Stopping => return Err(Refusal::OnHold),
            Phase::Working => return Err(Refusal::Busy),
            Phase::Ready => {}
        }
        if pick.session != self.session {
            return Err(Refusal::WrongSession { current: self.session });
        }
        if let Some(last) = self.last_sequence.filter(|&last| pick.sequence <= last) {
            return Err(Refusal::OldSequence { last });
        }
        self.gate.check(&pick, now_ns, self.not_before_ns)?;
        for list in [List::Pick, List::Missed] {
            for step in self.program.list(list) {
                let Step::Line(line) = step else { continue };
                let filled = line
                    .fill(Some(&pick), self.program.tool())
                    .ok_or(Refusal::NotFinite { at: Waypoint::Line })?;
                self.gate.check_line(&pick, filled.point_mm)?;
            }
        }
        self.last_sequence = Some(pick.sequence);
        self.current = Some(Current { pick, sent: false, begun: false, accepted: false });
        self.phase = Phase::Working;
        self.begin_list(List::Pick);
        self.deadline_ns = Some(now_ns + self.pick_timeout_ns);
        if W::CHECKS_REACH {
            self.stage = Stage::Reaching(0);
            self.wire.reach(pick.poses()[0].1.position_mm, now_ns);
        }
        Ok(())
    }

    fn release(&mut self, now_ns: i64) -> Result<(), Refusal> {
        match self.phase {
            Phase::Down | Phase::Connecting => return Err(Refusal::NotConnected),
            Phase::Stopping => return Err(Refusal::OnHold),
            Phase::Starting | Phase::Ready | Phase::Working => return Ok(()),
            Phase::Held => {}
        }
        // Homing makes an alarm good by itself; without it the operator has to unlock.
        let alarm = self.alarm.is_some();
        if alarm && !self.program.homes() {
            self.reports.push(Report::Alarm { code: self.alarm.unwrap_or(0) });
            return Err(Refusal::InAlarm);
        }
        self.phase = Phase::Starting;
        self.deadline_ns = Some(now_ns + START_NS);
        self.begin_list(List::Start);
        if alarm {
            self.unlock_only = false;
            self.stage = Stage::Unlocking;
            self.wire.unlock(now_ns);
        } else {
            self.stage = Stage::Settling;
            self.wire.settle(now_ns);
        }
        Ok(())
    }

    fn unlock(&mut self, now_ns: i64) -> Result<(), Refusal> {
        match self.phase {
            Phase::Down | Phase::Connecting => Err(Refusal::NotConnected),
            Phase::Held if self.alarm.is_some() => {
                self.phase = Phase::Stopping;
                self.deadline_ns = Some(now_ns + STOP_NS);
                self.held_by = HeldBy::Alarm;
                self.unlock_only = true;
                self.stage = Stage::Unlocking;
                self.wire.unlock(now_ns);
                Ok(())
            }
            _ => Ok(()),
        }
    }

    fn begin_list(&mut self, list: List) {
        self.list = list;
        self.next = 0;
        self.stage = Stage::Lines;
        self.rest();
        self.position_tries = 0;
    }

    /// No move is under way.
    fn rest(&mut self) {
        self.moved = false;
        self.stray_until_ns = None;
    }

    fn forget_lines(&mut self) {
        // A wait that was under way is over, too: nobody is to be woken for it.
        self.stage = Stage::Lines;
        self.flight.clear();
        self.rest();
        self.deadline_ns = None;
        self.expected_mm = [None; 3];
        self.seen_mm = [None; 3];
    }
}
