//! Marlin 2: numbered lines with a checksum, one at a time, sent again on `Resend:` without ever being executed
//! twice.
//!
//! `ok` means planned. That the arm stands is known from the answer to an M114 behind an M400: commands are worked on
//! one after another, so that answer cannot come before every move is done, whatever `ok` too many was taken for that
//! of the M400. (M114 alone proves nothing: since 2.0.6 both its coordinates and its `Count` are those of the last
//! move that was planned, motion.cpp, `report_current_position_projected`.) An `ok` is not taken for the end of a
//! question whose answer has not come. M410 and M112 are sent without a number, because only then Marlin looks at
//! them before its queue; as one line at a time is on its way, the queue is never full and is read even while a
//! command waits. After M410 it answers nothing for a second (planner.cpp, `cleaning_buffer_counter`); whoever does
//! has not taken it. An arm whose firmware cuts its moves into pieces goes on with the next piece in version 1.1
//! (`prepare_kinematic_move_to`), and answers nothing before the end of the move: it gets M112.
//!
//! A build without `HOST_KEEPALIVE_FEATURE` says nothing while a command waits, for as long as that takes. A line that
//! it has is refused at once when it comes a second time, which shows that the link and the controller live; whether the line
//! is done shows the answer to an M114 behind it. No more than two of these wait in its queue, which holds four commands
//! and is not read when it is full.
//!
//! Which number comes next Marlin says itself, in `Resend:`; a line of the wire's own takes that number. (M110 would set
//! it once more when it is worked on, behind lines that were read meanwhile, and its `ok` looks like that of an
//! M410.) A move that is asked for under another number than its own is an end of the session.
//!
//! Sources: marlinfw.org/docs/gcode (M110, M112, M114, M115, M400, M410) and the firmware's queue.cpp, motion.cpp,
//! planner.cpp, gcode/host and gcode/control, versions 1.1 to 2.1.

mod chores;
mod hear;
mod wire;

use super::engine::Driver;
use super::line::{self, Assembler, LineBuf};
use super::wire::{CODE_UNANSWERED, CODE_UNKNOWN_COMMAND, CODE_UNNUMBERED, Event, Events, MS, put};
use super::words::Kind;

/// An arm with Marlin 2.
pub type Marlin = Driver<MarlinWire>;

/// A command that does not wait is answered within this time, or sent again; at most so often, so that a dead link is
/// noticed within a second.
const ANSWER: i64 = 250 * MS;
const TRIES_MAX: u32 = 2;
/// A servo takes its `SERVO_DELAY` of 300 ms, and Marlin reads nothing meanwhile.
const ANSWER_ACTION: i64 = 1000 * MS;
/// A command that waits says `busy` every two seconds, where the firmware was built with keep-alive.
const ANSWER_WAITING: i64 = 5000 * MS;
/// Sent again while it waits it is complained about at once.
const ANSWER_WAITED: i64 = 1000 * MS;
/// So many questions may wait in its queue behind a command that waits: there is room for M410 still.
const QUESTIONS_MAX: u8 = 2;
/// So often a line that was taken is sent again before all its answers are taken to be lost: 80 seconds.
const PROBES_MAX: u8 = 16;
/// M410 takes a second, and one more when it comes out of the queue of a build without `EMERGENCY_PARSER`.
const ANSWER_STOPPED: i64 = 2500 * MS;
/// With it two copies of M410 take two seconds at most; what is sent meanwhile is read.
const ANSWER_STOPPED_AT_ONCE: i64 = 1500 * MS;
/// A greeting that begins with it is given so long.
const GREETING: i64 = 8000 * MS;
/// So many moves certainly fit into the planner.
const MOVES_AHEAD: u32 = 6;
/// After M410 the steps are looked at this often.
const LOOK_AGAIN: i64 = 50 * MS;
/// Homing says `busy` every two seconds.
const ANSWER_HOME: i64 = 15_000 * MS;
/// After `Resend:` the rest of the refused bytes, and the `ok` that some builds add, pass by.
const RESEND_PAUSE: i64 = 25 * MS;
/// M410 is repeated once: where a cut line came before it, it may be thrown away with that. Every copy costs a build
/// without `EMERGENCY_PARSER` another second, so further ones follow only when it is seen that none was taken.
const STOP_AGAIN: i64 = 60 * MS;
/// Whatever is answered sooner after M410 says that it was not taken: `cleaning_buffer_counter` is a second.
const STOP_DEAF: i64 = 900 * MS;
/// Copies of M410; a build that does not know it takes none of them.
const STOPS_MAX: u8 = 4;
/// Steps that still change when they were looked at so often: the controller is killed (M112).
const STOP_LOOKS: u8 = 8;
/// A build that takes M410 when it is read works on its queue after this time, or it has not stopped: so many signs of life
/// besides an `ok` tell it from a link that is gone.
const STOP_UNTAKEN: i64 = 3500 * MS;
const SIGNS_STUCK: u8 = 2;
/// Without an answer after so long it is a lost connection.
const STOP_LOST: i64 = 8000 * MS;
/// Builds that say `ok` before what they were asked for say no second one after it.
const SECOND_OK: i64 = 30 * MS;
/// Longer numbers make longer lines than it reads.
const NUMBER_MAX: u32 = 9_999_999;
const HEARTBEAT_MIN: i64 = 250 * MS;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Chore {
    Closed,
    Banner(i64),
    /// M115, M114 follow each other; since then.
    Greet(Greeting, i64),
    /// Lines may flow.
    None,
    /// M400, then M114.
    Sync(Asking),
    /// M410 was sent so many times, first and last then; then M114 until it rests, M400, M114.
    Stop {
        sent: u8,
        since: i64,
        last: i64,
        asking: Asking,
        looks: u8,
    },
    Settle(Asking),
    /// M999 is on its way.
    Unlock,
    /// The answer to this command is being read.
    Held,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Greeting {
    Who,
    Where,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Asking {
    /// M114, to see whether the steps change.
    Look,
    /// M400 is next or on its way.
    Wait,
    /// M114 is next or on its way.
    Where,
}

/// The line on its way.
#[derive(Clone, Copy, Debug)]
struct Flight {
    text: LineBuf,
    /// `None` = the wire's own.
    kind: Option<Kind>,
    number: u32,
    sent: i64,
    patience: i64,
    tries: u32,
    /// To be sent again then.
    resend: Option<i64>,
    /// What the controller said against it.
    fault: Option<u16>,
    /// It ends with more than an `ok`.
    asks: Option<Question>,
    /// Not to be sent again after that.
    expires_ns: Option<i64>,
    /// How often a question was sent in its place since.
    replaced: u32,
    /// It may be at work for long, or stand behind something that is.
    waits: bool,
    /// The controller has its number: what is missing is its answer.
    taken: bool,
    /// How often it was sent again since.
    probes: u8,
    /// An `ok` came, of this question or of something else.
    ok_seen: bool,
    /// Until then silence may be that of the command before it, whose `ok` came too early.
    held_up_until: Option<i64>,
}

impl Flight {
    fn is_answered(&self, answered: Option<Question>) -> bool {
        self.asks.is_some() && self.asks == answered
    }
}

/// A question, whose answer comes before its `ok`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Question {
    Position,
    Who,
    Switches,
}

/// Marlin's end of the wire.
#[derive(Debug)]
pub struct MarlinWire {
    incoming: Assembler,
    chore: Chore,
    heartbeat: i64,
    banner_wait: i64,
    handshake: i64,
    tries_max: u32,
    /// Number of the last line that was sent.
    number: u32,
    flight: Option<Flight>,
    urgent: Option<LineBuf>,
    own_line: Option<(LineBuf, Kind)>,
    /// The answer to the question on its way.
    answered: Option<Question>,
    /// Questions that may be in its queue.
    questions: u8,
    /// So long the command that was acknowledged last may still be at work: a build that says `ok` before it has waited.
    held_up_until: Option<i64>,
    position_mm: Option<[Option<f64>; 3]>,
    /// `Count` of the last two M114.
    steps: Option<[f64; 3]>,
    steps_before: Option<[f64; 3]>,
    /// M410 was sent and no question answered since.
    quickstop: bool,
    /// Signs of life since then without an `ok`.
    stuck: u8,
    /// The `ok` that comes before then belongs to a `Resend:`.
    resend_ok_until: Option<i64>,
    moves_ahead: u32,
    own_not_before: i64,
    next_poll: i64,
    polling: bool,
    /// When the position that is asked for was first asked for.
    asked_since: Option<i64>,
    foreign: bool,
    restarted: bool,
    dead: bool,
    held_sign: Box<str>,
    held: bool,
    /// `EMERGENCY_PARSER`: M410 and M112 act when they are read.
    emergency_parser: bool,
}

impl MarlinWire {
    fn own(&mut self, text: &str, kind: Kind) {
        self.own_line = Some((LineBuf::of(text), kind));
        self.own_not_before = i64::MIN;
    }

    fn begin(&mut self, chore: Chore) {
        self.chore = chore;
        self.flight = None;
        self.own_line = None;
        self.polling = false;
        self.asked_since = None;
        self.steps = None;
        self.steps_before = None;
        self.questions = 0;
        self.stuck = 0;
    }

    /// Whether another question may be sent behind the line on its way.
    fn may_ask(&self, flight: &Flight) -> bool {
        !flight.waits || self.questions < QUESTIONS_MAX
    }

    /// How long an answer may take.
    fn patience(&self) -> i64 {
        match (self.quickstop, self.emergency_parser) {
            (false, _) => ANSWER,
            (true, false) => ANSWER_STOPPED,
            (true, true) => ANSWER_STOPPED_AT_ONCE,
        }
    }

    /// Another chore, without a stop: a poll on its way is waited for, or its answer would be taken for another's.
    fn turn_to(&mut self, chore: Chore) {
        let polled = self.flight.filter(|_| self.polling);
        let since = self.asked_since.filter(|_| polled.is_some());
        let questions = self.questions;
        self.begin(chore);
        (self.flight, self.polling, self.asked_since) = (polled, polled.is_some(), since);
        self.questions = questions;
    }

    /// How long a greeting may take.
    fn greeting(&self) -> i64 {
        if self.quickstop && !self.foreign { GREETING.max(self.handshake) } else { self.handshake }
    }

    fn say_hello(&mut self, now: i64) {
        self.begin(Chore::Greet(Greeting::Who, now));
        self.own("M115", Kind::Modal);
    }

    /// Puts the line on its way into `out`: `N12 G1 X1*27`.
    fn encode(flight: &Flight, out: &mut [u8]) -> usize {
        let mut line = LineBuf::new();
        line.byte(b'N');
        line.integer(u64::from(flight.number));
        line.byte(b' ');
        let mut len = 0;
        put(out, &mut len, line.as_bytes());
        put(out, &mut len, flight.text.as_bytes());
        let sum = out[..len].iter().fold(0, |sum, byte| sum ^ byte);
        let mut end = LineBuf::new();
        end.byte(b'*');
        end.integer(u64::from(sum));
        end.byte(b'\n');
        put(out, &mut len, end.as_bytes());
        len
    }

    fn next_number(&self) -> u32 {
        if self.number < NUMBER_MAX { self.number + 1 } else { 1 }
    }

    fn launch(
        &mut self,
        text: LineBuf,
        kind: Option<Kind>,
        patience: i64,
        now: i64,
        out: &mut [u8],
    ) -> usize {
        self.number = self.next_number();
        let asks = match text.as_bytes() {
            b"M114" => Some(Question::Position),
            b"M115" => Some(Question::Who),
            b"M119" => Some(Question::Switches),
            _ => None,
        };
        self.answered = None;
        self.questions = u8::from(asks.is_some());
        let held_up_until = self.held_up_until.take();
        let moves = matches!(kind, Some(Kind::Motion | Kind::Dwell | Kind::Home));
        let flight = Flight {
            waits: moves || text.as_bytes() == b"M400" || held_up_until.is_some() || self.quickstop,
            asks,
            text,
            kind,
            number: self.number,
            sent: now,
            patience,
            tries: 0,
            resend: None,
            fault: None,
            expires_ns: None,
            replaced: 0,
            taken: false,
            probes: 0,
            ok_seen: false,
            held_up_until,
        };
        self.flight = Some(flight);
        Self::encode(&flight, out)
    }
}

#[cfg(test)]
mod tests;
