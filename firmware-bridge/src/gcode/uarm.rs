//! uArm Swift Pro: `#n command` answered by `$n ok …` or `$n E22`, one command and one question at a time.
//!
//! Firmware 4 (built on Grbl 0.9) answers a move when it is done, stops at `!` and says its state at `?`; firmware 3
//! (built on Marlin 1.1) answers it when it is planned, stops at a bare M410 and is asked M2200 whether it moves. Either
//! way an arm counts as arrived when two readings of its encoders in a row agree: P2220, which firmware 3 answers
//! with where it was sent, so there the angles of P2200 turned into a point by M2221. The encoders outlive a restart: the
//! position is never unknown. Tags are not used again for a long time, so that an answer that comes
//! late, or in another order, finds nobody waiting.
//!
//! Sources: uArm Swift Pro protocol V4 and its firmware's behaviour (github.com/uArm-Developer/SwiftProForArduino).

mod hear;
mod wire;

use super::engine::Driver;
use super::line::{self, Assembler, LineBuf};
use super::wire::{CODE_ELSEWHERE, CODE_UNANSWERED, CODE_UNNUMBERED, Event, Events, MS, put};
use super::words::Kind;

/// A uArm Swift Pro.
pub type Uarm = Driver<UarmWire>;

/// A question, and a command that does not move, is answered within this time.
const ANSWER: i64 = 1500 * MS;
/// Firmware 3 cuts a move into short ones and answers when the last of them fits into its planner.
const ANSWER_PLANNED: i64 = 30_000 * MS;
/// Readings of the encoders are this far apart in time, and agree within so much when the arm stands.
const LOOK_AGAIN: i64 = 60 * MS;
const AGREE_MM: f64 = 1.0;
const STOP_AGAIN: i64 = 120 * MS;
/// An answer without a point may have lost it on its way.
const UNTURNED_MAX: u8 = 3;
/// Firmware 3 and its encoders differ by no more about where it stands.
const BELIEF_MM: f64 = 10.0;
/// Statuses that do not come: a firmware that did not say its version knows no `?`.
const DEAF_STATUSES: u8 = 3;
/// After a reset the first firmwares 4 say a banner, half a second later when they had to stop; later ones are silent.
const BANNER: i64 = 1000 * MS;
const HEARTBEAT_MIN: i64 = 200 * MS;
const SILENCE_MIN: i64 = 750 * MS;
/// `Idle` for so long with a line unanswered: its answer is lost.
const ANSWER_LOST: i64 = 800 * MS;
const TAG_MAX: u32 = 9999;
/// While a move is on its way the encoders are read this often. (Firmware 4 answers late while it plans a long G1.)
const WATCH: i64 = 250 * MS;
/// The controller says that it moves and the encoders do not: something blocks the arm, or its motors have no power.
const STALLED: i64 = 2000 * MS;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Chore {
    Closed,
    Banner(i64),
    /// Version, then whether it stands; since then.
    Greet(i64),
    None,
    /// Looking whether it stands; what for.
    Look(LookFor),
    /// Being stopped since then, stop bytes last sent then; to greet or because somebody wants it.
    Stop {
        since: i64,
        again: i64,
        greeting: bool,
    },
    /// A reset was sent then.
    Settle {
        reset: Option<i64>,
        unlock: bool,
    },
    Held,
    Reach,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum LookFor {
    Greeting,
    Sync,
    Settled { unlock: bool },
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Asked {
    Version,
    Pose,
    /// P2200, of firmware 3.
    Angles,
    /// P2220 of firmware 3: where it believes to be.
    Believed,
    /// M2200.
    Moving,
    Held,
    Reach,
    /// M2000, behind M410: later builds of firmware 3 read their encoders anew.
    Stop,
    /// G2203: firmware 3 answers when it stands.
    StopDone,
    Line(Kind),
}

/// A command or question on its way.
#[derive(Clone, Copy, Debug)]
struct Flight {
    tag: u32,
    asked: Asked,
    sent: i64,
    patience: Option<i64>,
}

/// The uArm's end of the wire.
#[derive(Debug)]
pub struct UarmWire {
    incoming: Assembler,
    chore: Chore,
    heartbeat: i64,
    silence: i64,
    banner_wait: i64,
    handshake: i64,
    tag: u32,
    flight: Option<Flight>,
    own_line: Option<(LineBuf, Asked)>,
    /// Not to be sent before.
    own_not_before: i64,
    urgent: Option<&'static [u8]>,
    ask: bool,
    ask_sent: Option<i64>,
    /// The first `?` that no status has answered; one that comes late must not look as if it came fast.
    ask_since: Option<i64>,
    next_ask: i64,
    /// `?`, `!` and 0x18 are understood.
    realtime: bool,
    /// The version says so; silence does not change it.
    realtime_certain: bool,
    deaf_statuses: u8,
    /// Bytes that are a line's begin for firmware 3 went out and the version is not certain.
    half_line: bool,
    /// The version was asked for again, because the statuses do not come.
    doubted: bool,
    /// So often in a row firmware 3 had no point for its encoders' angles.
    unturned: u8,
    heard: i64,
    last_pose_mm: Option<[f64; 3]>,
    last_status_mm: Option<[f64; 3]>,
    /// The status since the look began says that it stands.
    rests: bool,
    foreign: bool,
    greeted_version: bool,
    restarted: bool,
    dirty: bool,
    alarm: Option<u16>,
    /// `$X` is to be sent.
    leave_alarm: bool,
    /// Standing with a line unanswered since then.
    idle_since: Option<i64>,
    /// Tag of the question for the encoders during a move.
    watch: Option<u32>,
    next_watch: i64,
    /// The last status says that it moves.
    runs: bool,
    /// Where the encoders have been, within [`AGREE_MM`], since then.
    lingers: Option<([f64; 3], i64)>,
    held_sign: Box<str>,
}

impl UarmWire {
    fn begin(&mut self, chore: Chore, now: i64) {
        self.chore = chore;
        self.flight = None;
        self.own_line = None;
        self.own_not_before = now;
        self.leave_alarm = false;
        self.last_pose_mm = None;
        self.last_status_mm = None;
        self.rests = false;
        self.watch = None;
        self.runs = false;
        self.lingers = None;
        self.next_ask = now + self.heartbeat;
    }

    fn own(&mut self, text: &str, asked: Asked, not_before: i64) {
        self.own_line = Some((LineBuf::of(text), asked));
        self.own_not_before = not_before;
    }

    fn look(&mut self, what_for: LookFor, now: i64) {
        self.begin(Chore::Look(what_for), now);
        self.look_again(now);
        // A status on its way was asked for too early.
        self.ask_sent = None;
        self.next_ask = now;
    }

    /// Asks where it stands; firmware 3 first whether it does.
    fn look_again(&mut self, not_before: i64) {
        if self.realtime {
            self.own("P2220", Asked::Pose, not_before);
        } else {
            self.own("M2200", Asked::Moving, not_before);
        }
    }

    /// Firmware 3 knows how to turn its encoders' angles into a point; its first builds answer without one.
    fn turns_angles(&self) -> bool {
        self.unturned < UNTURNED_MAX
    }

    /// Asks the encoders.
    fn ask_pose(&mut self, not_before: i64) {
        if self.realtime || !self.turns_angles() {
            self.own("P2220", Asked::Pose, not_before);
        } else {
            self.own("P2200", Asked::Angles, not_before);
        }
    }

    fn launch(
        &mut self,
        text: &LineBuf,
        asked: Asked,
        patience: Option<i64>,
        now: i64,
        out: &mut [u8],
    ) -> usize {
        let len = self.tagged(text, out);
        self.flight = Some(Flight { tag: self.tag, asked, sent: now, patience });
        len
    }

    /// Puts `#n text` into `out`, with a tag of its own.
    fn tagged(&mut self, text: &LineBuf, out: &mut [u8]) -> usize {
        self.tag = self.tag % TAG_MAX + 1;
        let mut head = LineBuf::new();
        head.byte(b'#');
        head.integer(u64::from(self.tag));
        head.byte(b' ');
        let mut len = 0;
        if core::mem::take(&mut self.half_line) {
            put(out, &mut len, b"\n");
        }
        put(out, &mut len, head.as_bytes());
        put(out, &mut len, text.as_bytes());
        put(out, &mut len, b"\n");
        len
    }

    /// The reset has thrown everything away. If it found the arm still decelerating it left an alarm, which `$X` ends
    /// and without which it does nothing.
    fn after_reset(&mut self, unlock: bool, now: i64) {
        self.dirty = false;
        self.alarm = None;
        self.ask_since = None;
        self.look(LookFor::Settled { unlock }, now);
        self.own_not_before = now + LOOK_AGAIN;
        self.leave_alarm = true;
    }

    fn say_hello(&mut self, now: i64) {
        self.begin(Chore::Greet(now), now);
        self.realtime = true;
        self.realtime_certain = false;
        self.unturned = 0;
        self.deaf_statuses = 0;
        self.greeted_version = false;
        self.ask_sent = None;
        self.ask_since = None;
        self.own("P2203", Asked::Version, now);
    }

    /// A firmware whose version is not known answers no `?`.
    fn doubt(&mut self, now: i64) {
        if self.chore != Chore::Look(LookFor::Greeting) {
            self.realtime &= self.dirty;
        } else if !core::mem::replace(&mut self.doubted, true) {
            // Its version may have lost a byte.
            self.say_hello(now);
        } else {
            self.realtime = false;
            self.look(LookFor::Greeting, now);
        }
    }

    /// A move is on its way, of a firmware that answers questions meanwhile.
    fn moves(&self) -> bool {
        let line = self.flight.is_some_and(|flight| flight.asked == Asked::Line(Kind::Motion));
        line && self.realtime && self.chore == Chore::None
    }

    fn halt(&mut self, greeting: bool, now: i64) {
        self.begin(Chore::Stop { since: now, again: now, greeting }, now);
        self.dirty = true;
        self.next_ask = now;
        self.send_stop(now);
    }

    fn send_stop(&mut self, now: i64) {
        if self.realtime {
            self.urgent = Some(b"!");
        } else {
            // Without a tag, because only then it is looked at before the queue.
            self.urgent = Some(b"\nM410\n");
            self.own("M2000", Asked::Stop, now);
        }
    }

    fn stopped(&mut self, greeting: bool, now: i64, events: &mut Events) {
        self.begin(Chore::None, now);
        events.push(if greeting {
            Event::Up { restarted: core::mem::take(&mut self.restarted), alarm: None }
        } else {
            Event::Stopped([None; 3])
        });
    }

    /// Whether `?` is asked for now.
    fn polls(&self) -> bool {
        self.realtime
            && self.greeted_version
            && !matches!(
                self.chore,
                Chore::Banner(_) | Chore::Greet(_) | Chore::Settle { reset: Some(_), .. }
            )
    }
}

#[cfg(test)]
mod tests;
