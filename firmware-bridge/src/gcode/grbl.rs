//! Grbl 1.1: lines acknowledged by `ok` or `error:N`, characters counted so that the receive buffer never
//! overflows, `?` for the state, `!` and 0x18 at once.
//!
//! How many lines may wait for their answer is `arm.lines_ahead`, one unless set: an answer lost on the wire would be
//! taken for that of the line before, and a refused line be followed by the next.
//!
//! `ok` means planned. That the arm has arrived is known from two things: `G4 P0`, which Grbl answers only when
//! every move is done, and then a status that was asked for after that answer and says `Idle`. (`Idle` alone is also
//! said between a line and the begin of its motion, and while a dwell runs.)
//!
//! Grbl's lines carry no checksum: a byte lost or doubled on the wire may make another coordinate of a good one. The
//! position is therefore watched while the arm moves, and a hold sent when it leaves the room between the points that
//! were sent: a status outside, and no next one inside. (Soft limits, `$20=1`, keep it from leaving the workspace at
//! all: switch them on.)
//!
//! Sources: Grbl v1.1 interface documentation (doc/markdown/interface.md), checked against its behaviour.

mod status;
mod wire;

use self::status::{State, Status, is_banner, is_first, understood};
use super::engine::Driver;
use super::line::{self, Assembler, LineBuf};
use super::wire::{CODE_UNANSWERED, CODE_UNNUMBERED, Event, Events, MS, put};
use super::words::Kind;
use std::collections::VecDeque;

/// An arm with Grbl 1.1.
pub type Grbl = Driver<GrblWire>;

/// Receive buffer unless `[OPT:…]` says that it is smaller, bytes.
const RX_LEN: usize = 128;
/// Most lines on their way, of the size of the planner.
const LINES_AHEAD_MAX: usize = 15;
/// A status that has not come after so long is asked for again.
const ASK_AGAIN: i64 = 250 * MS;
/// While something is waited for the status is asked for this often.
const ASK_OFTEN: i64 = 30 * MS;
/// While it moves the position is watched this often.
const ASK_MOVING: i64 = 60 * MS;
/// A stop byte is repeated after so long without effect, and replaced by a reset after [`STOP_RESET`].
const STOP_AGAIN: i64 = 150 * MS;
const STOP_RESET: i64 = 2500 * MS;
/// After a reset the banner comes within this time; an alarm delays it by half a second.
const BANNER: i64 = 3000 * MS;
/// The message of an alarm keeps it from answering for half a second: at least so long is not silence.
const SILENCE_MIN: i64 = 750 * MS;
/// `Idle` for so long with a line unanswered: its answer is lost.
const ANSWER_LOST: i64 = 1000 * MS;

/// The work offset comes with every tenth report at rest and every thirtieth in motion (config.h,
/// `REPORT_WCO_REFRESH_*`); after so many without one it never comes (`$10` of grblHAL).
const UNPLACED_MAX: u8 = 40;

/// Handshakes that end with something foreign before it is another dialect.
const DOUBTS_MAX: u8 = 2;

/// What the wire is doing by itself.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Chore {
    Closed,
    /// Waiting for a banner after the port was opened.
    Banner(i64),
    /// Asking for a first status since then.
    Greet(i64),
    /// `$I` is on its way since then.
    Info(i64),
    /// Lines may flow.
    None,
    /// `G4 P0` is on its way; then a status counts that was asked for from then on.
    Sync {
        done: bool,
    },
    /// `!` was sent first then, last then.
    Stop {
        since: i64,
        again: i64,
    },
    /// Waiting for `Idle`; a reset was sent then.
    Settle {
        reset: Option<i64>,
    },
    /// A reset, then `$X`, then `Idle`.
    Unlock {
        reset: Option<i64>,
        sent: bool,
    },
    /// The next status tells whether a part is held.
    Held,
}

/// A line on its way.
#[derive(Clone, Copy, Debug)]
struct Flight {
    len: usize,
    kind: Option<Kind>,
}

/// Grbl's end of the wire.
#[derive(Debug)]
pub struct GrblWire {
    incoming: Assembler,
    chore: Chore,
    heartbeat: i64,
    silence: i64,
    banner_wait: i64,
    handshake: i64,
    rx_len: usize,
    lines_ahead: usize,
    flights: VecDeque<Flight>,
    urgent: Option<u8>,
    own_line: Option<LineBuf>,
    /// `?` is to be sent; it was sent then.
    ask: bool,
    asked: Option<i64>,
    /// The first `?` that no status has answered; one that comes late must not look as if it came fast.
    asked_since: Option<i64>,
    /// The status that comes answers a `?` sent after the chore began.
    fresh: bool,
    next_ask: i64,
    heard: i64,
    /// Handshakes without an answer.
    unanswered: u8,
    /// Something was said that Grbl does not say.
    foreign: bool,
    /// It last said a version before 1.1.
    old_version: bool,
    /// So many handshakes ended with either of them; one may be a byte that got lost.
    doubts: u8,
    restarted: bool,
    /// Lines may be left in the controller.
    dirty: bool,
    alarm: Option<u16>,
    /// After a limit alarm nothing but a reset is listened to.
    locked: bool,
    idle_since: Option<i64>,
    offset_mm: Option<[f64; 3]>,
    /// Statuses of the handshake that did not tell where it stands.
    unplaced: u8,
    /// `G4 P0` waits for the moves. The ports to the ESP32, whose versions are later than 1.1, leave it out.
    zero_dwell_waits: bool,
    held_sign: Box<str>,
}

impl GrblWire {
    fn begin(&mut self, chore: Chore, now: i64) {
        self.chore = chore;
        // A status already on its way was asked for too early.
        self.fresh = false;
        self.next_ask = now;
        self.idle_since = None;
    }

    fn reset(&mut self) {
        self.urgent = Some(0x18);
        self.flights.clear();
        self.own_line = None;
        self.dirty = false;
        self.asked = None;
        self.asked_since = None;
        self.locked = false;
        self.alarm = None;
        self.incoming.clear();
    }

    fn used(&self) -> usize {
        self.flights.iter().map(|flight| flight.len).sum()
    }

    fn homing(&self) -> bool {
        self.flights.iter().any(|flight| flight.kind == Some(Kind::Home))
    }

    fn text(&mut self, text: &str, now: i64, events: &mut Events) {
        if let Some(status) = text.strip_prefix('<').and_then(|t| t.strip_suffix('>')) {
            return match Status::parse(status) {
                Some(status) => self.status(&status, text, now, events),
                None => {
                    // Grbl 0.9 and the uArm write commas.
                    self.foreign |= ["Idle,", "Alarm,"].iter().any(|begin| status.starts_with(begin));
                    events.garbage += text.len() as u32;
                }
            };
        }
        if text == "ok" {
            self.answered(Ok(()), now, events);
        } else if let Some(code) = text.strip_prefix("error:") {
            let code = line::leading_integer(code.trim()).map_or(CODE_UNNUMBERED, |(code, _)| code as u16);
            self.answered(Err(code), now, events);
        } else if let Some(code) = text.strip_prefix("ALARM:") {
            let code = line::leading_integer(code.trim()).map_or(0, |(code, _)| code as u16);
            self.alarmed(code, events);
        } else if is_banner(text) {
            self.banner(text, now, events);
        } else if let Some(options) = text.strip_prefix("[OPT:") {
            // Options, planner blocks, receive buffer; grblHAL appends more.
            let len = options.trim_end_matches(']').split(',').nth(2).and_then(line::leading_integer);
            // Larger ones are of no use, and the number may have lost a comma on its way.
            if let Some((len, _)) = len.filter(|&(len, _)| len >= 64) {
                self.rx_len = (len as usize).min(RX_LEN);
            }
        } else if let Some(version) = text.strip_prefix("[VER:") {
            self.old_version = !understood(version);
            self.zero_dwell_waits = is_first(version);
        } else if text.starts_with('[') || text.starts_with('>') || text.starts_with('$') {
            // Messages, start-up lines, settings.
        } else {
            events.garbage += text.len() as u32;
            let other = ["start", "echo:", "@", "Marlin", "E2"];
            self.foreign |= other.iter().any(|begin| text.starts_with(begin));
        }
    }

    fn banner(&mut self, text: &str, now: i64, events: &mut Events) {
        self.restarted = true;
        self.flights.clear();
        self.own_line = None;
        self.asked = None;
        self.asked_since = None;
        self.offset_mm = None;
        self.unplaced = 0;
        self.dirty = false;
        self.locked = false;
        let version = text.split_once(' ').map_or("", |(_, version)| version);
        self.old_version = !understood(version);
        self.zero_dwell_waits = is_first(version);
        match self.chore {
            Chore::Closed => {}
            Chore::Settle { reset: Some(_) } => {
                self.restarted = false;
                self.begin(Chore::Settle { reset: None }, now);
            }
            Chore::Unlock { reset: Some(_), .. } => {
                self.restarted = false;
                self.own_line = Some(LineBuf::of("$X"));
                self.begin(Chore::Unlock { reset: None, sent: true }, now);
            }
            Chore::Banner(_) | Chore::Greet(_) | Chore::Info(_) => self.begin(Chore::Greet(now), now),
            _ => {
                events.push(Event::Restarted);
                self.begin(Chore::Greet(now), now);
            }
        }
    }

    fn alarmed(&mut self, code: u16, events: &mut Events) {
        self.alarm = Some(code);
        self.flights.clear();
        self.own_line = None;
        // Hard limit, abort in motion and failed homing lose steps; a soft limit or a probe does not.
        let position_lost = matches!(code, 1 | 3 | 6..=9);
        // Until it is reset Grbl now answers nothing.
        self.locked = matches!(code, 1 | 2);
        match self.chore {
            Chore::Banner(_) | Chore::Greet(_) | Chore::Info(_) | Chore::Closed => {}
            _ => {
                self.chore = Chore::None;
                events.push(Event::Alarm { code, position_lost });
            }
        }
    }

    /// An answer to the oldest line.
    fn answered(&mut self, answer: Result<(), u16>, now: i64, events: &mut Events) {
        let Some(flight) = self.flights.pop_front() else { return };
        self.idle_since = None;
        if flight.kind.is_some() {
            return events.push(answer.map_or_else(Event::LineFailed, |()| Event::LineDone));
        }
        match self.chore {
            Chore::Info(_) => self.up(events),
            Chore::Sync { done: false } => match answer {
                Ok(()) => self.begin(Chore::Sync { done: true }, now),
                Err(code) => {
                    self.chore = Chore::None;
                    events.push(Event::LineFailed(code));
                }
            },
            _ => {}
        }
    }

    /// A handshake that ended with something foreign: the second one is no accident.
    fn doubt(&mut self, events: &mut Events) {
        self.doubts += u8::from(self.foreign || self.old_version);
        if self.doubts >= DOUBTS_MAX {
            self.doubts = 0;
            self.foreign = false;
            events.push(Event::WrongDialect);
        }
    }

    fn up(&mut self, events: &mut Events) {
        self.unanswered = 0;
        if self.foreign || self.old_version {
            self.chore = Chore::Greet(self.heard);
            self.next_ask = self.heard + 2 * ASK_AGAIN;
            return self.doubt(events);
        }
        self.doubts = 0;
        self.chore = Chore::None;
        events.push(Event::Up { restarted: core::mem::take(&mut self.restarted), alarm: self.alarm });
    }

    fn status(&mut self, status: &Status, text: &str, now: i64, events: &mut Events) {
        self.asked = None;
        if let Some(since) = self.asked_since.take() {
            events.push(Event::Heartbeat(u32::try_from((now - since) / 2000).unwrap_or(u32::MAX)));
        }
        self.offset_mm = status.offset_mm.or(self.offset_mm);
        if status.state == State::Alarm && self.alarm.is_none() {
            self.alarm = Some(0);
        } else if status.state != State::Alarm && !self.locked {
            self.alarm = None;
        }
        let fresh = core::mem::replace(&mut self.fresh, true);
        let position_mm = status.position_mm(self.offset_mm);
        match self.chore {
            Chore::Closed | Chore::Banner(_) => {}
            Chore::Greet(_) => self.greeted(status.state, position_mm[0].is_some(), now, events),
            Chore::None => self.watched(status.state, position_mm, now, events),
            _ if status.state == State::Alarm
                && !matches!(self.chore, Chore::Unlock { .. } | Chore::Info(_)) =>
            {
                self.chore = Chore::None;
                events.push(Event::Alarm { code: self.alarm.unwrap_or(0), position_lost: false });
            }
            Chore::Held if fresh => {
                let held = text.contains(&*self.held_sign);
                self.chore = Chore::None;
                events.push(Event::Held(held));
            }
            Chore::Sync { done } => match status.state {
                State::Idle if done && fresh => {
                    self.chore = Chore::None;
                    events.push(Event::Standing(position_mm));
                }
                State::Holding | State::Held | State::Blocked | State::Jog => {
                    events.push(Event::OperatorHold)
                }
                State::Idle if !done => self.watch_for_lost_answer(now, events),
                _ => {
                    self.idle_since = None;
                    events.push(Event::Passing(position_mm));
                }
            },
            Chore::Stop { .. } if fresh => match status.state {
                State::Idle | State::Held | State::Blocked => {
                    self.dirty = true;
                    self.chore = Chore::None;
                    events.push(Event::Stopped([None; 3]));
                }
                _ => {}
            },
            Chore::Settle { reset: None } if fresh => match status.state {
                State::Idle if !self.dirty && self.flights.is_empty() => {
                    self.chore = Chore::None;
                    events.push(Event::Resting(position_mm));
                    events.push(Event::Settled);
                }
                _ => {
                    self.reset();
                    self.begin(Chore::Settle { reset: Some(now) }, now);
                }
            },
            Chore::Unlock { reset: None, sent: true }
                if fresh
                    && self.flights.is_empty()
                    && self.own_line.is_none()
                    && status.state == State::Idle =>
            {
                self.chore = Chore::None;
                events.push(Event::Unlocked);
            }
            _ => {}
        }
    }

    /// A first status: nothing may move before the handshake goes on.
    fn greeted(&mut self, state: State, placed: bool, now: i64, events: &mut Events) {
        match state {
            State::Run | State::Jog | State::Holding | State::Home => {
                // The moves of a cell that is gone: they are held, and thrown away before anything new.
                self.urgent = Some(if state == State::Home { 0x18 } else { b'!' });
                self.dirty = true;
                self.next_ask = now + ASK_OFTEN;
            }
            State::Held | State::Blocked => {
                // `$I` would not be answered.
                self.dirty = true;
                self.up(events);
            }
            State::Idle | State::Alarm if !placed && self.unplaced < UNPLACED_MAX => {
                // `MPos` alone: nobody could see whether a first pick arrives.
                self.unplaced += 1;
                self.begin(Chore::Greet(now), now);
                self.next_ask = now + ASK_OFTEN;
            }
            State::Idle | State::Alarm => {
                self.own_line = Some(LineBuf::of("$I"));
                self.begin(Chore::Info(now), now);
            }
        }
    }

    /// A status while lines may flow.
    fn watched(&mut self, state: State, position_mm: [Option<f64>; 3], now: i64, events: &mut Events) {
        match state {
            State::Idle if self.flights.is_empty() => {
                self.idle_since = None;
                if !self.dirty {
                    events.push(Event::Resting(position_mm));
                }
            }
            State::Idle => self.watch_for_lost_answer(now, events),
            State::Alarm => {
                events.push(Event::Alarm { code: self.alarm.unwrap_or(0), position_lost: false });
            }
            State::Holding | State::Held | State::Blocked | State::Jog => events.push(Event::OperatorHold),
            // What was held goes on: a cycle start button at the machine. Its lines belong to a pick that has failed.
            State::Run if self.dirty => self.urgent = Some(b'!'),
            State::Run => {
                self.idle_since = None;
                events.push(Event::Passing(position_mm));
            }
            State::Home => self.idle_since = None,
        }
    }

    /// `Idle` although a line is unanswered: fine during a dwell, otherwise its answer is lost.
    fn watch_for_lost_answer(&mut self, now: i64, events: &mut Events) {
        let waits = self.flights.front().is_some_and(|flight| flight.kind == Some(Kind::Dwell));
        let since = *self.idle_since.get_or_insert(now);
        if !waits && now - since >= ANSWER_LOST {
            self.idle_since = None;
            events.push(Event::LineFailed(CODE_UNANSWERED));
        }
    }
}

#[cfg(test)]
mod tests;
