//! Marlin 2: numbered lines with a checksum, one at a time, sent again on `Resend:` without ever being executed
//! twice.
//!
//! `ok` means planned. That the arm stands is known from the answer to an M114 behind an M400: commands are worked on
//! one after another, so that answer cannot come before every move is done, whatever `ok` too many was taken for that
//! of the M400. (M114 alone proves nothing: since 2.0.6 both its coordinates and its `Count` are those of the last
//! move that was planned, motion.cpp, `report_current_position_projected`.) An `ok` is not taken for the end of a
//! question whose answer has not come. M410 and M112 are sent without a number, because only then Marlin looks at
//! them before its queue; as one line at a time is on its way, the queue is never full and is read even while a
//! command waits. After M410 it answers nothing for a second (planner.cpp, `cleaning_buffer_counter`).
//!
//! Which number comes next Marlin says itself, in `Resend:`; a line of the wire's own takes that number. (M110 would set
//! it once more when it is worked on, behind lines that were read meanwhile, and its `ok` looks like that of an
//! M410.) A move that is asked for under another number than its own is an end of the session.
//!
//! Sources: marlinfw.org/docs/gcode (M110, M112, M114, M115, M400, M410) and the firmware's queue.cpp, motion.cpp,
//! planner.cpp, gcode/host and gcode/control, versions 1.1 to 2.1.

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
/// M410 takes a second, and one more when it comes out of the queue of a build without `EMERGENCY_PARSER`.
const ANSWER_STOPPED: i64 = 2500 * MS;
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
/// M410 is repeated: where a cut line came before it, it may be thrown away with that.
const STOP_AGAIN: [i64; 2] = [60 * MS, 200 * MS];
/// Steps that still change when they were looked at so often: the controller is killed (M112).
const STOP_LOOKS: u8 = 8;
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
    /// M410 was sent so many times, first then; then M114 until it rests, M400, M114.
    Stop {
        sent: usize,
        since: i64,
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
    /// The controller has its number: what is missing is its answer.
    taken: bool,
    /// An `ok` came, of this question or of something else.
    ok_seen: bool,
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
    position_mm: Option<[Option<f64>; 3]>,
    /// `Count` of the last two M114.
    steps: Option<[f64; 3]>,
    steps_before: Option<[f64; 3]>,
    /// M410 was sent and no question answered since.
    quickstop: bool,
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
    }

    /// Another chore, without a stop: a poll on its way is waited for, or its answer would be taken for another's.
    fn turn_to(&mut self, chore: Chore) {
        let polled = self.flight.filter(|_| self.polling);
        let since = self.asked_since.filter(|_| polled.is_some());
        self.begin(chore);
        (self.flight, self.polling, self.asked_since) = (polled, polled.is_some(), since);
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

    fn launch(
        &mut self,
        text: LineBuf,
        kind: Option<Kind>,
        patience: i64,
        now: i64,
        out: &mut [u8],
    ) -> usize {
        self.number = if self.number < NUMBER_MAX { self.number + 1 } else { 1 };
        let asks = match text.as_bytes() {
            b"M114" => Some(Question::Position),
            b"M115" => Some(Question::Who),
            b"M119" => Some(Question::Switches),
            _ => None,
        };
        self.answered = None;
        let flight = Flight {
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
            ok_seen: false,
        };
        self.flight = Some(flight);
        Self::encode(&flight, out)
    }

    fn text(&mut self, text: &str, now: i64, events: &mut Events) {
        if text == "start" {
            return self.banner(now, events);
        }
        if let Some(rest) = text.strip_prefix("ok")
            && (rest.is_empty() || rest.starts_with(' '))
        {
            // Some builds answer M114 and M105 on the line of the `ok`.
            if let Some(at) = rest.find("X:") {
                self.note_position(&rest[at..]);
            }
            return self.ok(rest, now, events);
        }
        let resend = text.strip_prefix("Resend:").or_else(|| text.strip_prefix("rs "));
        if let Some(number) = resend {
            let number = number.trim_start_matches(|c: char| !c.is_ascii_digit());
            if let Some((number, _)) = line::leading_integer(number) {
                self.resend(number, now, events);
            }
            return;
        }
        if text.starts_with("echo:busy") || text.starts_with("busy:") {
            if let Some(flight) = &mut self.flight {
                flight.sent = now;
            }
            return;
        }
        // "Printer stopped due to errors" stands without a sign before it.
        let stopped = text.starts_with("Printer stopped").then_some(text);
        if let Some(error) = text.strip_prefix("Error:").or_else(|| text.strip_prefix("!!")).or(stopped) {
            return self.error(error, events);
        }
        if self.chore == Chore::Held && !self.held_sign.is_empty() && text.contains(&*self.held_sign) {
            self.held = true;
        }
        if let Some(echo) = text.strip_prefix("echo:") {
            let unknown = echo.starts_with("Unknown command");
            // "Home XYZ First": the move was left out.
            let unhomed = echo.starts_with("Home ") && says(echo, "first");
            if let Some(flight) = self.flight.as_mut().filter(|_| unknown || unhomed) {
                flight.fault = Some(if unknown { CODE_UNKNOWN_COMMAND } else { CODE_UNNUMBERED });
            }
            return;
        }
        if text.starts_with("FIRMWARE_NAME:") {
            self.answered = Some(Question::Who);
            self.foreign = !text.contains("Marlin");
            return;
        }
        if text.starts_with("Reporting endstop") {
            self.answered = Some(Question::Switches);
            return;
        }
        let foreign = text.starts_with("Grbl") || text.starts_with("error:") || text.starts_with('$');
        if foreign && matches!(self.chore, Chore::Greet(..)) {
            self.foreign = true;
        }
        let known =
            text.starts_with("//") || text.starts_with("Marlin") || text.contains(':') || text == "wait";
        if !self.note_position(text) && !known {
            events.garbage += text.len() as u32;
        }
    }

    /// `X:10.00 Y:0.00 Z:5.00 E:0.00 Count X:800 …`; false where it is something else.
    fn note_position(&mut self, text: &str) -> bool {
        let text = text.trim_start();
        if !text.starts_with("X:") {
            return false;
        }
        let point_mm = ['X', 'Y', 'Z'].map(|axis| line::word(text, axis));
        if point_mm.iter().all(Option::is_some) {
            self.position_mm = Some(point_mm);
            self.answered = Some(Question::Position);
            // Arms and deltas count `A:… B:… C:…`, the angles of their motors.
            let count = text.split_once("Count").map_or("", |(_, count)| count);
            let steps = [('X', 'A'), ('Y', 'B'), ('Z', 'C')]
                .map(|(axis, motor)| line::word(count, axis).or_else(|| line::word(count, motor)));
            self.steps_before = self.steps;
            self.steps = match steps {
                [Some(x), Some(y), Some(z)] => Some([x, y, z]),
                _ => None,
            };
        }
        true
    }

    fn banner(&mut self, now: i64, events: &mut Events) {
        self.restarted = true;
        self.dead = false;
        self.number = 0;
        self.quickstop = false;
        match self.chore {
            Chore::Closed => {}
            Chore::Banner(_) | Chore::Greet(..) => self.say_hello(now),
            _ => {
                events.push(Event::Restarted);
                self.say_hello(now);
            }
        }
    }

    fn error(&mut self, error: &str, events: &mut Events) {
        // These come with a `Resend:`.
        if ["checksum", "line number", "expected line"].iter().any(|sign| says(error, sign)) {
            return;
        }
        if ["kill", "halted", "stopped"].iter().any(|sign| says(error, sign)) {
            self.dead = true;
            self.begin(Chore::None);
            return events.push(Event::Alarm { code: 112, position_lost: true });
        }
        if let Some(flight) = &mut self.flight {
            flight.fault = Some(CODE_UNNUMBERED);
        }
    }

    fn resend(&mut self, number: u32, now: i64, events: &mut Events) {
        let Some(flight) = &mut self.flight else { return };
        let unknown = matches!(self.chore, Chore::Greet(Greeting::Who, _));
        if number == flight.number + 1 && !unknown {
            // It was taken; only its `ok` was lost, or the answer too: then it is asked again.
            if flight.replaced > 0 {
                // Asked once, the move has the number. Asked twice, it may also be the first question that has it.
                let fault = if flight.replaced > 1 { Some(CODE_UNANSWERED) } else { flight.fault };
                self.flight = None;
                return events.push(fault.map_or(Event::LineDone, Event::LineFailed));
            }
            if flight.asks.is_none() || flight.asks == self.answered {
                return self.done(now, events);
            }
            if flight.ok_seen {
                return self.ask_anew();
            }
            // It may wait behind something that takes its time.
            (flight.taken, flight.resend) = (true, None);
            (flight.sent, flight.patience) = (now, ANSWER_WAITING);
            return;
        }
        // Nobody knows which number comes first, nor whether the line was taken that a stop came after.
        let stopped = matches!(self.chore, Chore::Stop { .. } | Chore::Settle(_) | Chore::Unlock);
        if number == flight.number
            || (unknown && number <= NUMBER_MAX)
            || (stopped && number + 1 == flight.number)
        {
            (flight.number, self.number) = (number, number);
            flight.resend.get_or_insert(now + RESEND_PAUSE);
        } else if number == 1 {
            // It has forgotten our numbers: restarted, and its banner got lost.
            self.banner(now, events);
        } else {
            // Another host is on the line.
            events.push(Event::Silent);
        }
    }

    /// The question was taken, its answer is lost.
    fn ask_anew(&mut self) {
        let Some(flight) = self.flight.take() else { return };
        if self.polling && self.chore != Chore::None {
            // Something else is waiting for it.
            self.polling = false;
        } else {
            self.own_line = Some((flight.text, Kind::Modal));
        }
    }

    fn ok(&mut self, rest: &str, now: i64, events: &mut Events) {
        let Some(flight) = &self.flight else { return };
        // The `ok` behind a `Resend:` acknowledges nothing.
        if flight.resend.is_some() {
            return;
        }
        let numbered = rest.trim_start().strip_prefix('N').and_then(line::leading_integer);
        if numbered.is_some_and(|(number, _)| number != flight.number) {
            return;
        }
        self.done(now, events);
    }

    /// The line on its way is acknowledged.
    fn done(&mut self, now: i64, events: &mut Events) {
        let Some(mut flight) = self.flight.take() else { return };
        if flight.asks.is_some() && !flight.is_answered(self.answered) {
            // The `ok` of something else.
            flight.ok_seen = true;
            self.flight = Some(flight);
            return;
        }
        self.quickstop &= flight.asks.is_none();
        if flight.replaced > 0 {
            return events.push(Event::LineExpired);
        }
        if flight.kind.is_some() {
            return events.push(flight.fault.map_or(Event::LineDone, Event::LineFailed));
        }
        if flight.asks == Some(Question::Position)
            && let Some(since) = self.asked_since.take()
        {
            // From the first time it was asked: an answer to that one must not look faster than it is.
            events.push(Event::Heartbeat(u32::try_from((now - since) / 2000).unwrap_or(u32::MAX)));
        }
        if core::mem::take(&mut self.polling) {
            if let Some(position_mm) = self.position_mm {
                events.push(Event::Resting(position_mm));
            }
            return;
        }
        self.go_on(now, events);
    }

    /// The wire's own next step in its chore.
    fn go_on(&mut self, now: i64, events: &mut Events) {
        match self.chore {
            Chore::Greet(Greeting::Who, _) => {
                if self.foreign {
                    return;
                }
                self.chore = Chore::Greet(Greeting::Where, now);
                self.own("M114", Kind::Modal);
            }
            Chore::Greet(Greeting::Where, _) => {
                self.begin(Chore::None);
                self.next_poll = now + self.heartbeat;
                events.push(Event::Up { restarted: core::mem::take(&mut self.restarted), alarm: None });
            }
            Chore::Sync(Asking::Where)
            | Chore::Settle(Asking::Where)
            | Chore::Stop { asking: Asking::Where, .. } => {
                let chore = self.chore;
                self.begin(Chore::None);
                self.moves_ahead = 0;
                self.next_poll = now + self.heartbeat;
                events.push(match chore {
                    Chore::Stop { .. } => Event::Stopped,
                    Chore::Settle(_) => Event::Settled,
                    _ => Event::Standing(self.position_mm.unwrap_or_default()),
                });
            }
            Chore::Stop { asking: Asking::Look, looks, .. } if !self.rests() => {
                if looks >= STOP_LOOKS {
                    // It moves on in spite of M410.
                    self.begin(Chore::None);
                    self.dead = true;
                    self.urgent = Some(LineBuf::of("\nM112\n"));
                    return events.push(Event::Alarm { code: 112, position_lost: true });
                }
                if let Chore::Stop { looks, .. } = &mut self.chore {
                    *looks += 1;
                }
                self.own("M114", Kind::Modal);
                self.own_not_before = now + LOOK_AGAIN;
            }
            Chore::Sync(asking) => self.chore = Chore::Sync(self.next_asking(asking)),
            Chore::Settle(asking) => self.chore = Chore::Settle(self.next_asking(asking)),
            Chore::Stop { sent, since, asking, looks } => {
                let asking = self.next_asking(asking);
                self.chore = Chore::Stop { sent, since, asking, looks };
            }
            Chore::Unlock => {
                self.begin(Chore::None);
                events.push(Event::Unlocked);
            }
            Chore::Held => {
                let held = core::mem::take(&mut self.held);
                self.begin(Chore::None);
                events.push(Event::Held(held));
            }
            Chore::Closed | Chore::Banner(_) | Chore::None => {}
        }
    }

    /// Two looks in a row found the steps alike, or it counts none.
    fn rests(&self) -> bool {
        self.steps == self.steps_before
    }

    fn next_asking(&mut self, asking: Asking) -> Asking {
        match asking {
            Asking::Look => {
                self.own("M400", Kind::Dwell);
                Asking::Wait
            }
            Asking::Wait | Asking::Where => {
                self.own("M114", Kind::Modal);
                Asking::Where
            }
        }
    }

    /// An answer has not come.
    fn unanswered(&mut self, now: i64, events: &mut Events) {
        let Some(flight) = &mut self.flight else { return };
        if flight.is_answered(self.answered) && flight.ok_seen {
            return self.done(now, events);
        }
        if flight.taken {
            return self.ask_anew();
        }
        flight.tries += 1;
        if flight.tries <= self.tries_max {
            // The number keeps it from being executed twice.
            flight.resend = Some(now);
            if flight.patience >= ANSWER_WAITING && flight.kind != Some(Kind::Home) {
                flight.patience = ANSWER_WAITED;
            }
            return;
        }
        events.push(Event::Silent);
    }
}

/// Whether a text says a word, in capitals or not.
fn says(text: &str, word: &str) -> bool {
    text.as_bytes().windows(word.len()).any(|part| part.eq_ignore_ascii_case(word.as_bytes()))
}

#[cfg(test)]
mod tests;
