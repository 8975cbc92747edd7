//! The driver's side of the conversation through records.

use super::record::{ArmRecord, COMMANDS, CellRecord, REPORTS};
use crate::config::Settings;
use crate::dialect::Reports;
use crate::gate::Gate;
use crate::message::{Command, Disconnect, Pick, Refusal, Report};

const MS: i64 = 1_000_000;

/// State machine of the driver's end: commands and records in, reports and records out.
#[derive(Debug)]
pub struct CellEnd {
    gate: Gate,
    heartbeat_ns: i64,
    timeout_ns: i64,
    clear_dwell_ns: i64,
    reports: Reports,
    record: CellRecord,
    publish_due: bool,
    next_beat_ns: i64,
    /// The bridge knows this life of the driver, and this life of the bridge is the one it knows.
    up: bool,
    heard_ns: i64,
    acked: u32,
    /// Number of the newest report that was read.
    seen: u32,
    session: u32,
    state: State,
    /// The pick that was taken and has not ended.
    current: Option<u64>,
    pick_sequence: u32,
    not_before_ns: i64,
}

/// What is known of the arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    NotConnected,
    OnHold,
    InAlarm,
    Busy,
    Ready { clear_of_view: bool },
}

impl CellEnd {
    /// A driver that knows of no bridge yet; `seed` differs between processes.
    pub fn new(settings: &Settings, seed: u32) -> Self {
        let arm = &settings.arm;
        let record =
            CellRecord { cell: seed.max(1), bridge: 0, sent_ns: 0, newest: 0, commands: [None; COMMANDS] };
        Self {
            gate: Gate::new(settings),
            heartbeat_ns: i64::from(arm.heartbeat_ms) * MS,
            timeout_ns: i64::from(arm.heartbeat_timeout_ms) * MS,
            clear_dwell_ns: i64::from(arm.clear_dwell_ms) * MS,
            reports: Reports::new(),
            record,
            publish_due: true,
            next_beat_ns: i64::MIN,
            up: false,
            heard_ns: 0,
            acked: 0,
            seen: 0,
            session: 0,
            state: State::NotConnected,
            current: None,
            pick_sequence: 0,
            not_before_ns: i64::MAX,
        }
    }

    /// What the cell wants.
    ///
    /// # Errors
    /// Why it was not taken.
    pub fn command(&mut self, command: Command, now_ns: i64) -> Result<(), Refusal> {
        match command {
            Command::Hello => self.disconnect(Disconnect::NewSession),
            // Without a bridge that knows this driver the arm is on hold.
            Command::Hold if !self.up => {}
            Command::Hold => self.put_hold(),
            _ if !self.up || self.state == State::NotConnected => return Err(Refusal::NotConnected),
            Command::Pick(pick) => self.take_pick(pick, now_ns).inspect_err(|_| {
                if let State::Ready { clear_of_view } = self.state {
                    self.reports.push(Report::Ready { clear_of_view });
                }
            })?,
            _ => self.put(command)?,
        }
        Ok(())
    }

    /// A record of the bridge.
    pub fn on_record(&mut self, record: &ArmRecord, now_ns: i64) {
        if record.bridge != self.record.bridge {
            // A bridge that was started anew, or one that had lost this driver.
            if self.up {
                self.disconnect(Disconnect::Restarted);
            }
            self.record.bridge = record.bridge;
            self.publish_due = true;
        }
        if record.cell != self.record.cell {
            if self.up {
                self.disconnect(Disconnect::NewSession);
            }
            return;
        }
        self.up = true;
        self.heard_ns = now_ns;
        self.acked = record.acked;
        let new = record.newest.wrapping_sub(self.seen);
        if new > REPORTS as u32 {
            self.reports.push(Report::ReportsLost);
        }
        for number in record.newest.wrapping_sub(new.min(REPORTS as u32))..record.newest {
            if let Some(report) = record.reports[(number.wrapping_add(1) as usize) % REPORTS]
                && self.concerns(&report)
            {
                self.follow(&report, now_ns);
                self.reports.push(report);
            }
        }
        self.seen = record.newest;
    }

    /// Lets time pass; the next report.
    pub fn poll(&mut self, now_ns: i64) -> Option<Report> {
        if self.up && now_ns - self.heard_ns > self.timeout_ns {
            self.disconnect(Disconnect::Silent);
        }
        self.reports.pop()
    }

    /// The record to publish now, if there is a reason to.
    pub fn record(&mut self, now_ns: i64) -> Option<CellRecord> {
        if !self.publish_due && now_ns < self.next_beat_ns {
            return None;
        }
        self.publish_due = false;
        self.next_beat_ns = now_ns + self.heartbeat_ns;
        self.record.sent_ns = now_ns;
        Some(self.record)
    }

    /// When `poll` or `record` have something to do by themselves.
    pub fn next_deadline_ns(&self) -> i64 {
        if self.publish_due || !self.reports.is_empty() {
            return i64::MIN;
        }
        let silent_ns = if self.up { self.heard_ns + self.timeout_ns + 1 } else { i64::MAX };
        self.next_beat_ns.min(silent_ns)
    }

    /// The last place is kept for a hold.
    fn put(&mut self, command: Command) -> Result<(), Refusal> {
        if self.record.newest.wrapping_sub(self.acked) >= COMMANDS as u32 - 1 {
            return Err(Refusal::Busy);
        }
        self.force(command);
        Ok(())
    }

    fn force(&mut self, command: Command) {
        self.record.newest = self.record.newest.wrapping_add(1);
        self.record.commands[self.record.newest as usize % COMMANDS] = Some(command);
        self.publish_due = true;
    }

    /// A hold always has room: where all places are taken the newest command is one already.
    fn put_hold(&mut self) {
        if self.record.newest.wrapping_sub(self.acked) < COMMANDS as u32 {
            self.force(Command::Hold);
        }
        if matches!(self.state, State::Ready { .. }) {
            self.state = State::OnHold;
        }
    }

    fn take_pick(&mut self, pick: Pick, now_ns: i64) -> Result<(), Refusal> {
        if pick.session != self.session {
            return Err(Refusal::WrongSession { current: self.session });
        }
        match self.state {
            State::Ready { .. } if self.current.is_none() => {}
            State::OnHold => return Err(Refusal::OnHold),
            State::InAlarm => return Err(Refusal::InAlarm),
            _ => return Err(Refusal::Busy),
        }
        if pick.sequence <= self.pick_sequence {
            return Err(Refusal::OldSequence { last: self.pick_sequence });
        }
        self.gate.check(&pick, now_ns, self.not_before_ns)?;
        self.put(Command::Pick(pick))?;
        self.pick_sequence = pick.sequence;
        self.current = Some(pick.id);
        self.state = State::Busy;
        Ok(())
    }

    /// The conversation with this bridge is over: a new life begins.
    fn disconnect(&mut self, cause: Disconnect) {
        if let Some(id) = self.current.take() {
            self.reports.push(Report::Lost { id });
        }
        if self.up && self.state != State::NotConnected {
            self.reports.push(Report::Disconnected { cause });
        }
        self.up = false;
        self.state = State::NotConnected;
        self.record.cell = super::next_life(self.record.cell);
        self.record.newest = 0;
        self.record.commands = [None; COMMANDS];
        (self.acked, self.seen) = (0, 0);
        self.not_before_ns = i64::MAX;
        self.publish_due = true;
    }

    /// Not the ends of what an earlier life of this driver had begun; it was told already.
    fn concerns(&self, report: &Report) -> bool {
        match *report {
            Report::Sent { id, .. }
            | Report::Accepted { id }
            | Report::Moving { id }
            | Report::Done { id }
            | Report::Failed { id, .. }
            | Report::Refused { id, .. }
            | Report::Lost { id } => self.current == Some(id),
            Report::Disconnected { .. } => self.state != State::NotConnected,
            _ => true,
        }
    }

    /// Keeps the mirror of the arm's state.
    fn follow(&mut self, report: &Report, now_ns: i64) {
        match *report {
            Report::Connected { session, .. } => {
                self.session = session;
                self.pick_sequence = 0;
                self.state = State::OnHold;
                self.not_before_ns = i64::MAX;
            }
            Report::Disconnected { .. } => self.state = State::NotConnected,
            Report::Held { .. } => self.state = State::OnHold,
            Report::Alarm { .. } => self.state = State::InAlarm,
            Report::ClearOfView => {
                self.not_before_ns = now_ns;
                if let State::Ready { clear_of_view } = &mut self.state {
                    *clear_of_view = true;
                }
            }
            Report::Ready { clear_of_view } => {
                self.state = State::Ready { clear_of_view };
                self.not_before_ns = now_ns + if clear_of_view { 0 } else { self.clear_dwell_ns };
            }
            Report::Done { id }
            | Report::Failed { id, .. }
            | Report::Refused { id, .. }
            | Report::Lost { id }
                if self.current == Some(id) =>
            {
                self.current = None;
            }
            _ => {}
        }
    }
}
