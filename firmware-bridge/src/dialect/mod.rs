//! The languages of arms, each a state machine without a device, a thread or a clock.
//!
//! Takes [`Command`](crate::message::Command)s and the bytes that arrived; gives [`Report`]s and the bytes to send; owns the handshake,
//! heartbeats, acknowledgements, time-outs and the queue of lines of one arm. All memory is taken in `new`.
//!
//! Every dialect has the same shape:
//! - `new(&Settings, session_seed) -> Result<Self, ConfigError>`: takes all memory, checks the move templates; every
//!   handshake makes a new session number that starts at `session_seed` (random, so that two processes differ);
//! - `on_link(up, now_ns)`: the port was opened (the handshake begins) or is gone (an unfinished pick is
//!   [`Report::Lost`]);
//! - `on_bytes(bytes, now_ns)`: bytes that arrived; at most 256 a call, then `poll` until it gives `None`;
//! - `command(command, now_ns)`: `Ok` = every pick taken ends with exactly one report
//!   (`Done`/`Failed`/`Refused`/`Lost`); `Err` = it was not taken at all. `Hold` is never refused;
//! - `poll(now_ns)`: time passes; the next report. Call it until `None`, at every wake-up and by
//!   `next_deadline_ns`;
//! - `transmit(now_ns, out)`: the next bytes to write **now**. Call it again only when they are written. The
//!   gate checks a pick once more in here, with `now_ns`, at the moment its bytes are made;
//! - `on_written(id, at_ns)`: the bytes with [`Transmit::pick`] are written: gives [`Report::Sent`];
//! - `next_deadline_ns()`: when `poll`/`transmit` have something to do even if no byte arrives.
//!
//! **Urgent bytes.** When [`Transmit::urgent`] is set the link throws away what it has not yet written
//! (its own rest and the kernel's queue) and writes these first. A dialect therefore makes urgent bytes that are
//! understood after any cut, and treats everything before them as perhaps lost.

use crate::message::Report;

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
