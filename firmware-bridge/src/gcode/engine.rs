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

mod lines;

use super::template::{List, Program, Step};
use super::wire::{CODE_ELSEWHERE, CODE_UNANSWERED, Event, Events, MS, Wire};
use super::words::Kind;
use crate::config::{ConfigError, Settings};
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
    /// Something of it is on the wire (a question, a line before its first move): from then on its time to live
    /// counts, not the deadline of the target's bytes.
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
    history: [Option<(u64, Outcome)>; HISTORY],
    history_next: usize,
}

#[allow(private_bounds)]
impl<W: Wire> Driver<W> {
    /// All memory; checks the move templates. Session numbers start at `session_seed`.
    pub fn new(settings: &Settings, session_seed: u32) -> Result<Self, ConfigError> {
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
            Command::Pick(pick) => self.take_pick(pick, now_ns),
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
        if self.phase == Phase::Down {
            return None;
        }
        let wait = match self.stage {
            Stage::WaitingUntil(at) => Some(at),
            _ => None,
        };
        [self.wire.deadline_ns(), self.deadline_ns, wait].into_iter().flatten().min()
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
        self.current = Some(Current { pick, sent: W::CHECKS_REACH, begun: false, accepted: false });
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
        self.moved = false;
        self.position_tries = 0;
    }

    fn forget_lines(&mut self) {
        self.flight.clear();
        self.moved = false;
        self.deadline_ns = None;
        self.expected_mm = [None; 3];
        self.seen_mm = [None; 3];
    }

    /// Every event of the wire.
    fn digest(&mut self, now_ns: i64) {
        while let Some(event) = self.events.pop() {
            self.on_event(event, now_ns);
        }
        let bytes = core::mem::take(&mut self.events.garbage);
        if bytes > 0 {
            self.reports.push(Report::Garbage { bytes });
        }
    }

    fn on_event(&mut self, event: Event, now_ns: i64) {
        match event {
            Event::Up { restarted, alarm } => self.connected(restarted, alarm),
            Event::WrongDialect => self.reports.push(Report::WrongDialect),
            Event::Heartbeat(delay_us) => {
                // The longest of late, forgotten slowly.
                self.delay_us = delay_us.max(self.delay_us - self.delay_us / 16);
                self.reports.push(Report::Heartbeat { delay_us });
            }
            Event::LineDone => self.line_done(),
            Event::LineFailed(code) => self.line_failed(code, now_ns),
            Event::Standing(position_mm) => self.standing(position_mm, now_ns),
            Event::Resting(position_mm) => {
                self.seen_mm = position_mm;
                self.resting(position_mm, now_ns);
            }
            Event::Passing(position_mm) => self.passing(position_mm, now_ns),
            Event::Held(held) if self.stage == Stage::AskingHeld => {
                self.stage = Stage::Lines;
                if !held {
                    self.begin_list(List::Missed);
                }
            }
            Event::Reachable(reachable) => self.reachable(reachable, now_ns),
            Event::Stopped if self.phase == Phase::Stopping => self.stopped(),
            Event::Settled if self.stage == Stage::Settling && self.phase == Phase::Starting => {
                self.flight.clear();
                self.stage = Stage::Preamble(0);
            }
            Event::Unlocked if self.stage == Stage::Unlocking => {
                self.alarm = None;
                self.flight.clear();
                self.reports.push(Report::PositionUnknown);
                if self.unlock_only {
                    self.stopped();
                } else {
                    self.stage = Stage::Settling;
                    self.wire.settle(now_ns);
                }
            }
            Event::Alarm { code, position_lost } => self.in_alarm(code, position_lost),
            Event::OperatorHold => match self.phase {
                Phase::Ready | Phase::Working | Phase::Starting => {
                    self.begin_stop(Failure::Held, HeldBy::Operator, now_ns);
                }
                _ => {}
            },
            Event::Restarted => {
                if !W::KNOWS_POSITION {
                    self.reports.push(Report::PositionUnknown);
                }
                self.disconnect(Disconnect::Restarted, Phase::Connecting);
            }
            Event::Silent => {
                self.disconnect(Disconnect::Silent, Phase::Connecting);
                self.wire.greet(now_ns);
            }
            // A stop in the middle of a handshake ends it.
            Event::Stopped if self.phase == Phase::Connecting => self.wire.greet(now_ns),
            Event::Held(_) | Event::Stopped | Event::Settled | Event::Unlocked => {}
        }
    }

    fn connected(&mut self, restarted: bool, alarm: Option<u16>) {
        self.session = self.session.wrapping_add(1);
        self.last_sequence = None;
        self.held_by = match (alarm, self.connected_before, restarted) {
            (Some(_), _, _) => HeldBy::Alarm,
            (None, false, _) => HeldBy::Start,
            (None, true, true) => HeldBy::ControllerReset,
            (None, true, false) => HeldBy::LinkLost,
        };
        self.connected_before = true;
        self.alarm = alarm;
        self.phase = Phase::Held;
        self.forget_lines();
        self.reports.push(Report::Connected { session: self.session, held_by: self.held_by });
        if let Some(code) = alarm {
            self.reports.push(Report::Alarm { code });
        }
    }

    /// The link or the controller is gone: nobody knows what became of a pick that was begun.
    fn disconnect(&mut self, cause: Disconnect, phase: Phase) {
        let was_connected = !matches!(self.phase, Phase::Down | Phase::Connecting);
        if let Some(current) = self.current.take() {
            let id = current.pick.id;
            let (report, outcome) = if current.begun {
                (Report::Lost { id }, Outcome::Unknown)
            } else {
                (Report::Refused { id, refusal: Refusal::NotConnected }, Outcome::Refused)
            };
            self.finish(report, id, outcome);
        }
        self.events.clear();
        self.forget_lines();
        self.phase = phase;
        self.alarm = None;
        if was_connected {
            self.reports.push(Report::Disconnected { cause });
        }
    }

    fn finish(&mut self, report: Report, id: u64, outcome: Outcome) {
        self.history[self.history_next] = Some((id, outcome));
        self.history_next = (self.history_next + 1) % HISTORY;
        self.reports.push(report);
    }

    /// Stops the arm; when that is confirmed the pick ends as `ending`.
    fn begin_stop(&mut self, ending: Failure, by: HeldBy, now_ns: i64) {
        self.wire.stop(now_ns);
        if self.phase == Phase::Connecting {
            return;
        }
        if self.phase != Phase::Stopping {
            self.ending = ending;
        }
        self.held_by = by;
        self.phase = Phase::Stopping;
        self.stage = Stage::Lines;
        self.deadline_ns = Some(now_ns + STOP_NS);
    }

    fn stopped(&mut self) {
        self.phase = Phase::Held;
        // It stands somewhere on its way.
        self.forget_lines();
        self.end_current(self.ending);
        self.reports.push(Report::Held { by: self.held_by });
    }

    /// Ends the pick without success.
    fn end_current(&mut self, failure: Failure) {
        let Some(current) = self.current.take() else { return };
        let id = current.pick.id;
        if current.begun {
            self.finish(Report::Failed { id, failure }, id, Outcome::Failed);
        } else {
            let refusal = if failure == Failure::Alarm { Refusal::InAlarm } else { Refusal::OnHold };
            self.finish(Report::Refused { id, refusal }, id, Outcome::Refused);
        }
    }

    fn in_alarm(&mut self, code: u16, position_lost: bool) {
        if self.phase == Phase::Connecting || (self.phase == Phase::Held && self.alarm == Some(code)) {
            return;
        }
        self.alarm = Some(code);
        self.held_by = HeldBy::Alarm;
        self.phase = Phase::Held;
        self.stage = Stage::Lines;
        self.forget_lines();
        self.end_current(Failure::Alarm);
        self.reports.push(Report::Alarm { code });
        if position_lost {
            self.reports.push(Report::PositionUnknown);
        }
        self.reports.push(Report::Held { by: HeldBy::Alarm });
    }

    fn out_of_time(&mut self, now_ns: i64) {
        match self.phase {
            Phase::Working | Phase::Starting => self.begin_stop(Failure::TimedOut, HeldBy::Alarm, now_ns),
            Phase::Stopping => self.on_event(Event::Silent, now_ns),
            _ => {}
        }
    }

    fn line_done(&mut self) {
        let kind = self.flight.pop_front();
        if let (Phase::Starting, Stage::Preamble(index)) = (self.phase, self.stage) {
            self.preamble_done(index);
        }
        let first = kind == Some(Kind::Motion) && self.phase == Phase::Working && self.list == List::Pick;
        if let Some(current) = self.current.as_mut().filter(|current| first && !current.accepted) {
            current.accepted = true;
            let id = current.pick.id;
            self.reports.push(Report::Accepted { id });
            self.reports.push(Report::Moving { id });
        }
    }

    fn preamble_done(&mut self, index: u8) {
        self.stage = Stage::Preamble(index + 1);
    }

    fn line_failed(&mut self, code: u16, now_ns: i64) {
        self.flight.pop_front();
        if let (Phase::Starting, Stage::Preamble(index)) = (self.phase, self.stage) {
            if W::PREAMBLE.get(usize::from(index)).is_some_and(|line| line.optional)
                && code != CODE_UNANSWERED
            {
                return self.preamble_done(index);
            }
        }
        if matches!(self.phase, Phase::Working | Phase::Starting) {
            self.begin_stop(Failure::Controller { code }, HeldBy::Alarm, now_ns);
        }
    }

    fn standing(&mut self, position_mm: [Option<f64>; 3], now_ns: i64) {
        if self.stage != Stage::Syncing || !matches!(self.phase, Phase::Working | Phase::Starting) {
            return;
        }
        if self.is_elsewhere(position_mm) {
            self.position_tries += 1;
            if self.position_tries < POSITION_TRIES {
                return self.wire.sync(now_ns);
            }
            return self.begin_stop(Failure::Controller { code: CODE_ELSEWHERE }, HeldBy::Alarm, now_ns);
        }
        self.position_tries = 0;
        self.moved = false;
        self.seen_mm = position_mm;
        self.stage = Stage::Lines;
    }

    /// Seen on its way: outside the room between its points a line was not understood as it was meant.
    fn passing(&mut self, position_mm: [Option<f64>; 3], now_ns: i64) {
        let outside = |axis: usize| match (position_mm[axis], self.room_mm[axis]) {
            (Some(at), Some((low, high))) => at < low - ROOM_MM || at > high + ROOM_MM,
            _ => false,
        };
        if self.moved && matches!(self.phase, Phase::Working | Phase::Starting) && (0..3).any(outside) {
            self.begin_stop(Failure::Controller { code: CODE_ELSEWHERE }, HeldBy::Alarm, now_ns);
        }
    }

    /// Seen at rest between picks: an arm that does not stand where it was left was moved, or restarted unheard.
    fn resting(&mut self, position_mm: [Option<f64>; 3], now_ns: i64) {
        if self.phase != Phase::Ready {
            return;
        }
        if !self.is_elsewhere(position_mm) {
            self.position_tries = 0;
            return;
        }
        self.position_tries += 1;
        if self.position_tries >= POSITION_TRIES {
            self.position_tries = 0;
            self.expected_mm = [None; 3];
            self.reports.push(Report::PositionUnknown);
            self.begin_stop(Failure::Held, HeldBy::Operator, now_ns);
        }
    }

    fn is_elsewhere(&self, position_mm: [Option<f64>; 3]) -> bool {
        let far = |axis: usize| match (self.expected_mm[axis], position_mm[axis]) {
            (Some(expected), Some(at)) => (expected - at).abs() > W::TOLERANCE_MM,
            _ => false,
        };
        (0..3).any(far)
    }

    fn reachable(&mut self, reachable: bool, now_ns: i64) {
        let (Stage::Reaching(index), Some(current)) = (self.stage, self.current) else { return };
        if !reachable {
            return self.refuse_current(Refusal::Unreachable);
        }
        match current.pick.poses().get(usize::from(index) + 1) {
            Some((_, pose)) => {
                self.stage = Stage::Reaching(index + 1);
                self.wire.reach(pose.position_mm, now_ns);
            }
            None => self.stage = Stage::Lines,
        }
    }

    /// The pick ends before it began; the arm has not moved.
    fn refuse_current(&mut self, refusal: Refusal) {
        let Some(current) = self.current.take() else { return };
        let id = current.pick.id;
        self.finish(Report::Refused { id, refusal }, id, Outcome::Refused);
        self.phase = Phase::Ready;
        self.stage = Stage::Lines;
        self.deadline_ns = None;
        self.reports.push(Report::Ready { clear_of_view: self.clear_of_view });
    }
}
