//! What the three dialects do differently: a [`Wire`] carries lines to one kind of controller and says what comes
//! back, in the engine's words.

use super::line::LineBuf;
use super::words::Kind;
use crate::config::Settings;
use std::collections::VecDeque;

pub(crate) const MS: i64 = 1_000_000;

/// The engine's own code for "it stands elsewhere than it was sent".
pub(crate) const CODE_ELSEWHERE: u16 = 1000;
/// The controller did not know the command.
pub(crate) const CODE_UNKNOWN_COMMAND: u16 = 1001;
/// An error without a number.
pub(crate) const CODE_UNNUMBERED: u16 = 1002;
/// The answer to a line never came.
pub(crate) const CODE_UNANSWERED: u16 = 1003;

/// What a wire noticed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Event {
    /// The handshake is complete, the arm stands.
    Up {
        /// The controller said its banner since the last time.
        restarted: bool,
        /// It is in alarm.
        alarm: Option<u16>,
    },
    /// What answers speaks another dialect, or a version that is not understood.
    WrongDialect,
    /// The oldest line is acknowledged (planned or done).
    LineDone,
    /// The oldest line was taken and is done, its acknowledgement is lost; it says that it stands or will stand here.
    LineTaken([Option<f64>; 3]),
    /// The oldest line is refused.
    LineFailed(u16),
    /// The oldest line was never taken, and is too old to be sent again.
    LineExpired,
    /// Answer to [`Wire::sync`]: it stands, here.
    Standing([Option<f64>; 3]),
    /// It stands, here, without having been asked for it.
    Resting([Option<f64>; 3]),
    /// It moves, and is here.
    Passing([Option<f64>; 3]),
    /// Answer to [`Wire::stop`]; where it says that it stands, if it was asked.
    Stopped([Option<f64>; 3]),
    /// Answer to [`Wire::settle`]: lines may flow.
    Settled,
    /// Answer to [`Wire::unlock`].
    Unlocked,
    /// The controller raised an alarm, or is in one.
    Alarm {
        /// Its number.
        code: u16,
        /// Steps may have been lost.
        position_lost: bool,
    },
    /// Somebody at the arm stopped it.
    OperatorHold,
    /// It said its banner; a handshake follows by itself.
    Restarted,
    /// It says nothing any more.
    Silent,
    /// Answer to [`Wire::ask_held`].
    Held(bool),
    /// Answer to [`Wire::reach`].
    Reachable(bool),
    /// A question was answered after so long, one way, µs.
    Heartbeat(u32),
}

/// Events on their way to the engine.
#[derive(Debug)]
pub(crate) struct Events {
    ring: VecDeque<Event>,
    /// Bytes that were not understood.
    pub(crate) garbage: u32,
}

impl Events {
    const CAPACITY: usize = 320;

    pub(crate) fn new() -> Self {
        Self { ring: VecDeque::with_capacity(Self::CAPACITY), garbage: 0 }
    }

    pub(crate) fn push(&mut self, event: Event) {
        // 256 bytes hold at most 128 lines of two events.
        if self.ring.len() < Self::CAPACITY {
            self.ring.push_back(event);
        }
    }

    pub(crate) fn pop(&mut self) -> Option<Event> {
        self.ring.pop_front()
    }

    pub(crate) fn clear(&mut self) {
        self.ring.clear();
    }
}

/// A line that the engine sends after every release, before `arm.moves.start`.
pub(crate) struct Preamble {
    pub(crate) text: &'static str,
    /// A controller may not know it: one without inches has no G21.
    pub(crate) optional: bool,
}

/// What a wire needs to know of a line.
#[derive(Clone, Copy, Debug)]
pub(crate) struct About {
    pub(crate) kind: Kind,
    /// How long it waits by itself, ms.
    pub(crate) dwell_ms: u32,
    /// It begins a pick and must not be sent again after this moment.
    pub(crate) expires_ns: Option<i64>,
}

/// One kind of controller at the other end.
pub(crate) trait Wire: Sized {
    /// Absolute, in millimetres.
    const PREAMBLE: &'static [Preamble];
    /// How far from the commanded point the arm may stand, mm.
    const TOLERANCE_MM: f64;
    /// The position is read from encoders and outlives a restart.
    const KNOWS_POSITION: bool;
    /// It can be asked whether it reaches a point.
    const CHECKS_REACH: bool;
    /// Waits are made here instead of being sent.
    const WAITS_HERE: bool;
    /// From the last byte of a line to the begin of its motion, ms, besides the measured delay of the line.
    const BEGIN_MS: u32;

    /// All memory.
    fn new(settings: &Settings) -> Self;
    /// The port was opened: the controller may be about to restart; wait for its banner, then ask.
    fn open(&mut self, now_ns: i64);
    /// Ask anew, without waiting for a banner.
    fn greet(&mut self, now_ns: i64);
    /// The port is gone.
    fn close(&mut self);
    /// Bytes that came.
    fn on_bytes(&mut self, bytes: &[u8], now_ns: i64, events: &mut Events);
    /// Asks at once where the arm is on its way, if this wire asks that.
    fn ask_again(&mut self, _now_ns: i64) {}
    /// Time-outs.
    fn on_time(&mut self, now_ns: i64, events: &mut Events);
    /// When `on_time` or `transmit` have something to do.
    fn deadline_ns(&self) -> Option<i64>;
    /// The wire's own next bytes; how many and whether they are urgent.
    fn transmit(&mut self, now_ns: i64, out: &mut [u8]) -> (usize, bool);
    /// Whether urgent bytes wait.
    fn has_urgent(&self) -> bool;
    /// Whether a line of so many characters can be sent now.
    fn takes(&self, len: usize) -> bool;
    /// Sends a line: puts it with its number, checksum and end into `out`.
    fn send(&mut self, line: &LineBuf, about: About, now_ns: i64, out: &mut [u8]) -> usize;
    /// Waits until every move is done, then says where it stands.
    fn sync(&mut self, now_ns: i64);
    /// Stops motion at once.
    fn stop(&mut self, now_ns: i64);
    /// After a stop: throws away what the controller still has, so that lines may flow.
    fn settle(&mut self, now_ns: i64);
    /// Leaves an alarm.
    fn unlock(&mut self, now_ns: i64);
    /// Asks whether a part is held.
    fn ask_held(&mut self, question: &LineBuf, now_ns: i64);
    /// Asks whether a point can be reached.
    fn reach(&mut self, point_mm: [f64; 3], now_ns: i64);
}

/// Copies bytes behind those that are there; the buffers are made to fit.
pub(crate) fn put(out: &mut [u8], len: &mut usize, bytes: &[u8]) {
    let room = out.len().saturating_sub(*len);
    let count = bytes.len().min(room);
    out[*len..*len + count].copy_from_slice(&bytes[..count]);
    *len += count;
}
