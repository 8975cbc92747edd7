//! The languages of arms, each a state machine without a device, a thread or a clock.
//!
//! Takes [`Command`]s and the bytes that arrived; gives [`Report`]s and the bytes to send; owns the handshake,
//! heartbeats, acknowledgements, time-outs and the queue of lines of one arm. All memory is taken in `new`.
//!
//! Every dialect has the same shape:
//! - `new(&Settings, session_seed) -> Result<Self, TemplateError>`: takes all memory, checks the move templates; every
//!   handshake makes a new session number that starts at `session_seed` (random, so that two processes differ);
//! - `on_link(up, now_ns)`: the port was opened (the handshake begins) or is gone (an unfinished pick is
//!   [`Report::Lost`]);
//! - `on_bytes(bytes, now_ns)`: bytes that arrived; at most 256 a call, then `poll` until it gives `None`;
//! - `command(command, now_ns)`: `Ok` = every pick taken ends with exactly one report
//!   (`Done`/`Failed`/`Refused`/`Lost`); `Err` = it was not taken at all. After either an arm that takes the next one
//!   says [`Report::Ready`], also where it was ready before. `Hold` is never refused;
//! - `poll(now_ns)`: time passes; the next report. Call it until `None`, at every wake-up and by
//!   `next_deadline_ns`;
//! - `transmit(now_ns, out)`: the next bytes to write **now**. Call it again only when they are written. The
//!   gate checks a pick once more in here, with `now_ns`, at the moment its bytes are made;
//! - `has_urgent()`: whether the next `transmit` gives urgent bytes, see below;
//! - `on_written(id, at_ns)`: the bytes with [`Transmit::pick`] are written: gives [`Report::Sent`];
//! - `next_deadline_ns()`: when `poll`/`transmit` have something to do even if no byte arrives.
//!
//! **Urgent bytes.** A link that is still writing calls `transmit` only when `has_urgent()` says so. When [`Transmit::urgent`] is set the link throws away what it has not yet written
//! (its own rest and the kernel's queue) and writes these first. A dialect therefore makes urgent bytes that are
//! understood after any cut, and treats everything before them as perhaps lost.

use crate::config::{DialectName, Settings};
use crate::gcode::template::TemplateError;
use crate::gcode::{Grbl, Marlin, Uarm};
use crate::message::{Command, Refusal, Report};

mod own;

pub use own::Own;

/// One arm's language. The variants differ only in what they put on the wire.
#[derive(Debug)]
#[allow(clippy::large_enum_variant)] // one a process, never moved after the start
pub enum Dialect {
    /// PickCell's own packets.
    Own(Own),
    /// Grbl 1.1.
    Grbl(Grbl),
    /// Marlin 2.
    Marlin(Marlin),
    /// uArm Swift Pro.
    Uarm(Uarm),
}

/// Calls the same method of whichever dialect it is.
macro_rules! each {
    ($self:expr, $dialect:ident => $call:expr) => {
        match $self {
            Dialect::Own($dialect) => $call,
            Dialect::Grbl($dialect) => $call,
            Dialect::Marlin($dialect) => $call,
            Dialect::Uarm($dialect) => $call,
        }
    };
}

impl Dialect {
    /// The dialect that `[arm]` names, without a port yet.
    ///
    /// # Errors
    /// A move template of `[arm.moves]` that cannot be taken.
    pub fn new(settings: &Settings, session_seed: u32) -> Result<Self, TemplateError> {
        match settings.arm.dialect {
            DialectName::Own => Ok(Dialect::Own(Own::new(settings, session_seed))),
            DialectName::Grbl => Ok(Dialect::Grbl(Grbl::new(settings, session_seed)?)),
            DialectName::Marlin => Ok(Dialect::Marlin(Marlin::new(settings, session_seed)?)),
            DialectName::Uarm => Ok(Dialect::Uarm(Uarm::new(settings, session_seed)?)),
        }
    }

    /// The port was opened (the handshake begins), or is gone.
    pub fn on_link(&mut self, up: bool, now_ns: i64) {
        each!(self, dialect => dialect.on_link(up, now_ns));
    }

    /// Bytes that arrived, at most [`RECEIVE_LEN_MAX`] a call.
    pub fn on_bytes(&mut self, bytes: &[u8], now_ns: i64) {
        each!(self, dialect => dialect.on_bytes(bytes, now_ns));
    }

    /// What the cell wants.
    ///
    /// # Errors
    /// Why it was not taken; nothing of it will be sent.
    pub fn command(&mut self, command: Command, now_ns: i64) -> Result<(), Refusal> {
        each!(self, dialect => dialect.command(command, now_ns))
    }

    /// Lets time pass; the next report.
    pub fn poll(&mut self, now_ns: i64) -> Option<Report> {
        each!(self, dialect => dialect.poll(now_ns))
    }

    /// The next bytes to write now; `out` is at least [`TRANSMIT_LEN_MIN`] long.
    pub fn transmit(&mut self, now_ns: i64, out: &mut [u8]) -> Transmit {
        each!(self, dialect => dialect.transmit(now_ns, out))
    }

    /// Whether the next `transmit` gives urgent bytes; a link asks while it is still writing others.
    pub fn has_urgent(&self) -> bool {
        each!(self, dialect => dialect.has_urgent())
    }

    /// The bytes that hold the begin of a pick are written.
    pub fn on_written(&mut self, id: u64, at_ns: i64) {
        each!(self, dialect => dialect.on_written(id, at_ns));
    }

    /// When `poll` or `transmit` have something to do without a byte arriving; in the past = now.
    pub fn next_deadline_ns(&self) -> Option<i64> {
        each!(self, dialect => dialect.next_deadline_ns())
    }
}

/// Most bytes that `on_bytes` may be given at once, so that their reports fit into [`Reports`].
pub const RECEIVE_LEN_MAX: usize = 256;

/// What `transmit` put into the buffer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Transmit {
    /// How many bytes, 0 = nothing to send now.
    pub len: usize,
    /// They overtake everything that is not yet written.
    pub urgent: bool,
    /// They hold the begin of this pick's motion: when they are written the link calls `on_written`.
    pub pick: Option<u64>,
}

/// Smallest buffer that `transmit` may be given, bytes: the longest packet or line of any dialect.
pub const TRANSMIT_LEN_MIN: usize = 320;

/// Reports that wait to be polled, oldest first; a fixed ring.
#[derive(Clone, Debug)]
pub struct Reports {
    ring: [Option<Report>; Reports::CAPACITY],
    first: usize,
    len: usize,
    overrun: bool,
}

impl Reports {
    /// How many reports fit.
    pub const CAPACITY: usize = 64;

    /// An empty ring.
    pub fn new() -> Self {
        Self { ring: [None; Self::CAPACITY], first: 0, len: 0, overrun: false }
    }

    /// Appends; a report that does not fit is dropped and [`Report::ReportsLost`] follows the last that did.
    pub fn push(&mut self, report: Report) {
        if self.len == Self::CAPACITY {
            self.overrun = true;
            return;
        }
        self.ring[(self.first + self.len) % Self::CAPACITY] = Some(report);
        self.len += 1;
    }

    /// Takes the oldest.
    pub fn pop(&mut self) -> Option<Report> {
        if self.len == 0 {
            return core::mem::take(&mut self.overrun).then_some(Report::ReportsLost);
        }
        let report = self.ring[self.first].take();
        self.first = (self.first + 1) % Self::CAPACITY;
        self.len -= 1;
        report
    }

    /// Whether nothing waits.
    pub fn is_empty(&self) -> bool {
        self.len == 0 && !self.overrun
    }
}

impl Default for Reports {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_ring_says_that_reports_are_lost() {
        let mut reports = Reports::new();
        for id in 0..=Reports::CAPACITY as u64 {
            reports.push(Report::Done { id });
        }
        for id in 0..Reports::CAPACITY as u64 {
            assert_eq!(reports.pop(), Some(Report::Done { id }));
        }
        assert_eq!(reports.pop(), Some(Report::ReportsLost));
        assert_eq!(reports.pop(), None);
        assert!(reports.is_empty());
    }
}
