//! Grbl 1.1: lines acknowledged by `ok` or `error:N`, characters counted so that the receive buffer never
//! overflows, `?` for the state, `!` and 0x18 at once.
//!
//! `ok` means planned. That the arm has arrived is known from two things: `G4 P0`, which Grbl answers only when
//! every move is done, and then a status that was asked for after that answer and says `Idle`. (`Idle` alone is also
//! said between a line and the begin of its motion, and while a dwell runs.)
//!
//! Grbl's lines carry no checksum: a byte lost or doubled on the wire may make another coordinate of a good one. The
//! position is therefore watched while the arm moves, and a hold sent when it leaves the room between the points
//! that were sent. (Soft limits, `$20=1`, keep it from leaving the workspace at all: switch them on.)
//!
//! Sources: Grbl v1.1 interface documentation (doc/markdown/interface.md), checked against its behaviour.

use super::engine::Driver;
use super::line::{self, Assembler, LineBuf};
use super::wire::{CODE_UNANSWERED, CODE_UNNUMBERED, Event, Events, MS, Preamble, Wire, put};
use super::words::Kind;
use crate::config::Settings;
use std::collections::VecDeque;

/// An arm with Grbl 1.1.
pub type Grbl = Driver<GrblWire>;

/// Receive buffer unless `[OPT:…]` says that it is smaller, bytes.
const RX_LEN: usize = 128;
/// Most lines on their way, of the size of the planner.
const LINES_AHEAD: usize = 15;
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

/// The state in a status report.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Idle,
    Run,
    /// Decelerating.
    Holding,
    /// Held, or a door closed again: nothing moves.
    Held,
    Jog,
    Alarm,
    /// Open door, check mode, sleep: nothing moves.
    Blocked,
    Home,
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
    flights: VecDeque<Flight>,
    urgent: Option<u8>,
    own_line: Option<LineBuf>,
    /// `?` is to be sent; it was sent then.
    ask: bool,
    asked: Option<i64>,
    /// The status that comes answers a `?` sent after the chore began.
    fresh: bool,
    next_ask: i64,
    heard: i64,
    /// Handshakes without an answer.
    unanswered: u8,
    foreign: bool,
    restarted: bool,
    /// Lines may be left in the controller.
    dirty: bool,
    alarm: Option<u16>,
    /// After a limit alarm nothing but a reset is listened to.
    locked: bool,
    idle_since: Option<i64>,
    offset_mm: Option<[f64; 3]>,
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
                None => events.garbage += text.len() as u32,
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
            let len = options.trim_end_matches(']').rsplit(',').next().and_then(line::leading_integer);
            // Larger ones are of no use, and the number may have lost a comma on its way.
            if let Some((len, _)) = len.filter(|&(len, _)| len >= 64) {
                self.rx_len = (len as usize).min(RX_LEN);
            }
        } else if let Some(version) = text.strip_prefix("[VER:") {
            self.foreign |= !understood(version);
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
        self.offset_mm = None;
        self.dirty = false;
        self.locked = false;
        if !understood(text.split_once(' ').map_or("", |(_, version)| version)) {
            self.foreign = true;
        }
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

    fn up(&mut self, events: &mut Events) {
        self.unanswered = 0;
        if self.foreign {
            self.foreign = false;
            self.chore = Chore::Greet(self.heard);
            self.next_ask = self.heard + 4 * ASK_AGAIN;
            return events.push(Event::WrongDialect);
        }
        self.chore = Chore::None;
        events.push(Event::Up { restarted: core::mem::take(&mut self.restarted), alarm: self.alarm });
    }

    fn status(&mut self, status: &Status, text: &str, now: i64, events: &mut Events) {
        if let Some(asked) = self.asked.take() {
            events.push(Event::Heartbeat(u32::try_from((now - asked) / 2000).unwrap_or(u32::MAX)));
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
            Chore::Greet(_) => self.greeted(status.state, now, events),
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
                    events.push(Event::Stopped);
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
            Chore::Unlock { reset: None, sent: true } if fresh && self.flights.is_empty() => {
                if status.state == State::Idle {
                    self.chore = Chore::None;
                    events.push(Event::Unlocked);
                }
            }
            _ => {}
        }
    }

    /// A first status: nothing may move before the handshake goes on.
    fn greeted(&mut self, state: State, now: i64, events: &mut Events) {
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

impl Wire for GrblWire {
    const PREAMBLE: &'static [Preamble] = &[Preamble { text: "G90 G21 G94", optional: false }];
    const TOLERANCE_MM: f64 = 0.5;
    const KNOWS_POSITION: bool = false;
    const CHECKS_REACH: bool = false;
    const WAITS_HERE: bool = false;

    fn new(settings: &Settings) -> Self {
        let arm = &settings.arm;
        Self {
            incoming: Assembler::new(),
            chore: Chore::Closed,
            heartbeat: i64::from(arm.heartbeat_ms) * MS,
            silence: (i64::from(arm.heartbeat_timeout_ms) * MS).max(SILENCE_MIN),
            banner_wait: i64::from(arm.banner_wait_ms) * MS,
            handshake: i64::from(arm.handshake_timeout_ms) * MS,
            rx_len: RX_LEN,
            flights: VecDeque::with_capacity(LINES_AHEAD + 4),
            urgent: None,
            own_line: None,
            ask: false,
            asked: None,
            fresh: false,
            next_ask: 0,
            heard: 0,
            unanswered: 0,
            foreign: false,
            restarted: false,
            dirty: false,
            alarm: None,
            locked: false,
            idle_since: None,
            offset_mm: None,
            held_sign: arm.moves.held.as_ref().map_or_else(Box::default, |held| held.expect.as_str().into()),
        }
    }

    fn open(&mut self, now: i64) {
        self.greet(now);
        self.rx_len = RX_LEN;
        self.begin(Chore::Banner(now + self.banner_wait), now);
    }

    fn greet(&mut self, now: i64) {
        self.incoming.clear();
        // What was on its way may still be in the controller.
        self.dirty |= !self.flights.is_empty();
        self.flights.clear();
        self.own_line = None;
        self.urgent = None;
        self.ask = false;
        self.asked = None;
        self.unanswered = 0;
        self.foreign = false;
        self.alarm = None;
        self.locked = false;
        self.heard = now;
        self.begin(Chore::Greet(now), now);
    }

    fn close(&mut self) {
        self.chore = Chore::Closed;
        self.dirty = true;
    }

    fn on_bytes(&mut self, bytes: &[u8], now: i64, events: &mut Events) {
        for &byte in bytes {
            if let Some(line) = self.incoming.push(byte) {
                let before = events.garbage;
                self.text(line.text(), now, events);
                if events.garbage == before {
                    self.heard = now;
                }
            }
        }
        events.garbage += self.incoming.take_garbage();
    }

    fn on_time(&mut self, now: i64, events: &mut Events) {
        match self.chore {
            Chore::Closed => return,
            Chore::Banner(until) => {
                if now >= until {
                    self.begin(Chore::Greet(now), now);
                }
                return;
            }
            Chore::Greet(since) if now - since >= self.handshake => {
                self.unanswered = self.unanswered.saturating_add(1);
                if core::mem::take(&mut self.foreign) {
                    events.push(Event::WrongDialect);
                }
                // A limit alarm answers to nothing but a reset; nothing else is lost by one.
                if self.unanswered % 3 == 0 {
                    self.reset();
                }
                self.begin(Chore::Greet(now), now);
            }
            Chore::Info(since) if now - since >= self.handshake => {
                self.flights.clear();
                self.begin(Chore::Greet(now), now);
            }
            Chore::Stop { since, again } => {
                if now - since >= STOP_RESET {
                    self.reset();
                    self.dirty = true;
                    self.chore = Chore::Stop { since: now, again: now };
                } else if now - again >= STOP_AGAIN {
                    self.urgent = Some(b'!');
                    self.chore = Chore::Stop { since, again: now };
                }
            }
            Chore::Settle { reset: Some(at) } | Chore::Unlock { reset: Some(at), .. }
                if now - at >= BANNER =>
            {
                self.chore = Chore::None;
                return events.push(Event::Silent);
            }
            _ => {}
        }
        let waits_for_banner =
            matches!(self.chore, Chore::Settle { reset: Some(_) } | Chore::Unlock { reset: Some(_), .. });
        if self.homing() || self.locked || waits_for_banner {
            self.heard = now;
            return;
        }
        let greets = matches!(self.chore, Chore::Greet(_) | Chore::Info(_));
        if !greets && self.asked.is_some() && now - self.heard >= self.silence {
            return events.push(Event::Silent);
        }
        if self.asked.is_some_and(|at| now - at >= ASK_AGAIN) {
            self.asked = None;
        }
        if now >= self.next_ask && self.asked.is_none() && !matches!(self.chore, Chore::Info(_)) {
            self.ask = true;
            self.next_ask = now
                + match self.chore {
                    Chore::None | Chore::Greet(_) => self.heartbeat.max(ASK_OFTEN),
                    Chore::Sync { done: false } => self.heartbeat.min(ASK_MOVING),
                    _ => ASK_OFTEN,
                };
        }
    }

    fn deadline_ns(&self) -> Option<i64> {
        let timer = match self.chore {
            Chore::Closed => return None,
            Chore::Banner(until) => return Some(until),
            Chore::Greet(since) | Chore::Info(since) => Some(since + self.handshake),
            Chore::Stop { since, again } => Some((since + STOP_RESET).min(again + STOP_AGAIN)),
            Chore::Settle { reset: Some(at) } | Chore::Unlock { reset: Some(at), .. } => Some(at + BANNER),
            _ => None,
        };
        if self.ask || self.urgent.is_some() || self.own_line.is_some() {
            return Some(i64::MIN);
        }
        let waits = matches!(
            self.chore,
            Chore::Info(_) | Chore::Settle { reset: Some(_) } | Chore::Unlock { reset: Some(_), .. }
        );
        let polls = !(self.homing() || self.locked || waits);
        let ask = polls.then(|| match self.asked {
            Some(at) => (at + ASK_AGAIN).min(self.heard.max(at) + self.silence),
            None => self.next_ask,
        });
        [timer, ask].into_iter().flatten().min()
    }

    fn transmit(&mut self, now: i64, out: &mut [u8]) -> (usize, bool) {
        let mut len = 0;
        if let Some(byte) = self.urgent.take() {
            put(out, &mut len, &[byte]);
            return (len, true);
        }
        if core::mem::take(&mut self.ask) {
            put(out, &mut len, b"?");
            self.asked = Some(now);
            // The answer to this one belongs to the chore under way.
            self.fresh = true;
            return (len, false);
        }
        let fits = |line: &LineBuf| self.used() + line.len() < self.rx_len;
        if self.own_line.as_ref().is_some_and(fits) {
            let line = self.own_line.take().unwrap_or(LineBuf::new());
            put(out, &mut len, line.as_bytes());
            put(out, &mut len, b"\n");
            self.flights.push_back(Flight { len, kind: None });
        }
        (len, false)
    }

    fn has_urgent(&self) -> bool {
        self.urgent.is_some()
    }

    fn takes(&self, len: usize) -> bool {
        self.chore == Chore::None
            && self.alarm.is_none()
            && !self.dirty
            && self.flights.len() < LINES_AHEAD
            && self.used() + len < self.rx_len
    }

    fn send(&mut self, line: &LineBuf, kind: Kind, _dwell_ms: u32, _now: i64, out: &mut [u8]) -> usize {
        let mut len = 0;
        put(out, &mut len, line.as_bytes());
        put(out, &mut len, b"\n");
        self.flights.push_back(Flight { len, kind: Some(kind) });
        self.idle_since = None;
        len
    }

    fn sync(&mut self, now: i64) {
        self.own_line = Some(LineBuf::of("G4 P0"));
        self.begin(Chore::Sync { done: false }, now);
        self.next_ask = now + ASK_OFTEN;
    }

    fn stop(&mut self, now: i64) {
        // A homing cycle obeys nothing but a reset.
        self.urgent = Some(if self.homing() { 0x18 } else { b'!' });
        self.own_line = None;
        if !matches!(self.chore, Chore::Closed | Chore::Banner(_) | Chore::Greet(_) | Chore::Info(_)) {
            self.begin(Chore::Stop { since: now, again: now }, now);
        }
        self.dirty = true;
    }

    fn settle(&mut self, now: i64) {
        self.begin(Chore::Settle { reset: None }, now);
    }

    fn unlock(&mut self, now: i64) {
        self.reset();
        self.begin(Chore::Unlock { reset: Some(now), sent: false }, now);
    }

    fn ask_held(&mut self, _question: &LineBuf, now: i64) {
        self.begin(Chore::Held, now);
    }

    fn reach(&mut self, _point_mm: [f64; 3], _now: i64) {}
}

/// `Grbl 1.1h ['$' for help]`, `GrblHAL 1.1f […]`, also with a byte lost.
fn is_banner(text: &str) -> bool {
    text.starts_with("Grbl") || text.ends_with("for help]") || text.ends_with("for info]")
}

/// Whether a version number, as in `1.1h` or `1.1h.20190825:`, is 1.1 or later.
fn understood(version: &str) -> bool {
    let Some((major, rest)) = line::leading_integer(version.trim_start()) else { return true };
    let minor = rest.strip_prefix('.').and_then(line::leading_integer).map_or(0, |(minor, _)| minor);
    (major, minor) >= (1, 1)
}

/// A status report.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Status {
    state: State,
    machine_mm: Option<[f64; 3]>,
    work_mm: Option<[f64; 3]>,
    offset_mm: Option<[f64; 3]>,
}

impl Status {
    /// What stands between `<` and `>`.
    fn parse(text: &str) -> Option<Self> {
        let mut fields = text.split('|');
        let name = fields.next()?;
        let (name, detail) = name.split_once(':').unwrap_or((name, ""));
        let state = match (name, detail) {
            ("Idle", _) => State::Idle,
            ("Run", _) => State::Run,
            ("Hold", "1") => State::Holding,
            ("Hold", _) | ("Door", "0") => State::Held,
            ("Door", "2" | "3") => State::Holding,
            ("Door" | "Check" | "Sleep" | "Tool", _) => State::Blocked,
            ("Jog", _) => State::Jog,
            ("Alarm", _) => State::Alarm,
            ("Home", _) => State::Home,
            _ => return None,
        };
        let mut status = Self { state, machine_mm: None, work_mm: None, offset_mm: None };
        for field in fields {
            match field.split_once(':') {
                Some(("MPos", at)) => status.machine_mm = line::triple(at),
                Some(("WPos", at)) => status.work_mm = line::triple(at),
                Some(("WCO", at)) => status.offset_mm = line::triple(at),
                _ => {}
            }
        }
        Some(status)
    }

    /// In work coordinates, where they are known.
    fn position_mm(&self, offset_mm: Option<[f64; 3]>) -> [Option<f64>; 3] {
        match (self.work_mm, self.machine_mm, offset_mm) {
            (Some(work), _, _) => work.map(Some),
            (None, Some(machine), Some(offset)) => [0, 1, 2].map(|axis| Some(machine[axis] - offset[axis])),
            _ => [None; 3],
        }
    }
}

#[cfg(test)]
mod tests;
