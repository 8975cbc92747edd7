//! Marlin 2: numbered lines with a checksum, one at a time, sent again on `Resend:` without ever being executed
//! twice.
//!
//! `ok` means planned. Whether the arm moves is asked by M114, whose `Count` are the motors' steps; when they rest, M400
//! and one more M114 confirm it. An `ok` is not taken for the end of a question whose answer has not come, so that
//! an `ok` too many does no harm. (Marlin 1 answers M114 only at rest: there M400 comes first, and a silent
//! controller is noticed later.) M410 and M112 are sent without a number, because only then Marlin looks at them
//! before its queue; as one line at a time is on its way, the queue is never full and is read even while a command
//! waits.
//!
//! Sources: marlinfw.org/docs/gcode (M110, M112, M114, M115, M400, M410) and /docs/development, checked against the
//! firmware's behaviour.

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
/// A command that waits says `busy` every two seconds, where the firmware was built with keep-alive.
const ANSWER_WAITING: i64 = 5000 * MS;
/// So many moves certainly fit into the planner.
const MOVES_AHEAD: u32 = 6;
/// While it moves the steps are asked for this often.
const LOOK_AGAIN: i64 = 50 * MS;
/// So many positions without `Count` are no accident.
const COUNTLESS_MAX: u8 = 3;
/// A first move waits 100 ms for others to come (`BLOCK_DELAY_FOR_1ST_MOVE` in planner.h): before that rest proves
/// nothing.
const FIRST_MOVE: i64 = 120 * MS;
/// Homing says `busy` every two seconds.
const ANSWER_HOME: i64 = 15_000 * MS;
/// After `Resend:` the rest of the refused bytes, and the `ok` that some builds add, pass by.
const RESEND_PAUSE: i64 = 25 * MS;
/// M410 is repeated: where a cut line came before it, it may be thrown away with that.
const STOP_AGAIN: [i64; 3] = [60 * MS, 150 * MS, 300 * MS];
/// Steps that still change when they were looked at so often: the controller is killed (M112).
const STOP_LOOKS: u8 = 8;
/// Without an answer after so long it is a lost connection.
const STOP_LOST: i64 = 4000 * MS;
const HEARTBEAT_MIN: i64 = 250 * MS;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Chore {
    Closed,
    Banner(i64),
    /// M110, M115, M114 follow each other; since then.
    Greet(Greeting, i64),
    /// Lines may flow.
    None,
    /// M114 until it rests, then M400, then M114.
    Sync(Asking),
    /// M410 was sent so many times, first then; then M110, M114 until it rests, M400, M114.
    Stop {
        sent: usize,
        since: i64,
        asking: Asking,
        looks: u8,
    },
    Settle(Asking),
    /// M110, then M999.
    Unlock {
        sent: bool,
    },
    /// The answer to this command is being read.
    Held,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Greeting {
    Number,
    Who,
    Where,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Asking {
    /// M110 is next or on its way.
    Number,
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
    /// M114 is answered only at rest, or does not tell rest.
    m114_waits: bool,
    /// Positions in a row without `Count`.
    countless: u8,
    /// It was silent while moves were watched; if it turns out to be alive, M114 waits.
    silent_looking: bool,
    moves_ahead: u32,
    /// When the newest move was acknowledged.
    move_taken: i64,
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

    /// Numbers begin anew: `N0 M110 N0`.
    fn renumber(&mut self) {
        self.number = u32::MAX;
        self.own("M110 N0", Kind::Modal);
    }

    fn say_hello(&mut self, now: i64) {
        self.begin(Chore::Greet(Greeting::Number, now));
        self.renumber();
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
        // u32::MAX + 1 = 0: the line that renumbers.
        self.number = self.number.wrapping_add(1);
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
        if let Some(error) = text.strip_prefix("Error:").or_else(|| text.strip_prefix("!!")) {
            return self.error(error, events);
        }
        if self.chore == Chore::Held && !self.held_sign.is_empty() && text.contains(&*self.held_sign) {
            self.held = true;
        }
        if let Some(echo) = text.strip_prefix("echo:") {
            let unknown = echo.starts_with("Unknown command");
            // "Home XYZ First": the move was left out.
            let unhomed = echo.starts_with("Home ") && echo.to_ascii_lowercase().ends_with("first");
            if let Some(flight) = self.flight.as_mut().filter(|_| unknown || unhomed) {
                flight.fault = Some(if unknown { CODE_UNKNOWN_COMMAND } else { CODE_UNNUMBERED });
            }
            return;
        }
        if text.starts_with("FIRMWARE_NAME:") {
            self.answered = Some(Question::Who);
            self.foreign = !text.contains("Marlin");
            self.m114_waits |= text.contains("Marlin 1") || text.contains("Marlin V1");
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
            text.starts_with("Cap:") || text.starts_with("//") || text.contains(':') || text == "wait";
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
            if let [Some(x), Some(y), Some(z)] = steps {
                self.countless = 0;
                self.steps_before = self.steps.replace([x, y, z]);
            } else {
                (self.steps, self.steps_before) = (None, None);
                // Once is a lost byte; a firmware without counts is asked to wait instead.
                self.countless = self.countless.saturating_add(1);
                self.m114_waits |= self.countless >= COUNTLESS_MAX;
            }
        }
        true
    }

    fn banner(&mut self, now: i64, events: &mut Events) {
        self.restarted = true;
        self.dead = false;
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
        let lower = error.to_ascii_lowercase();
        // These come with a `Resend:`.
        if ["checksum", "line number", "expected line"].iter().any(|sign| lower.contains(sign)) {
            return;
        }
        let dead = lower.contains("kill") || lower.contains("halted") || lower.contains("stopped");
        if dead {
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
        if number == flight.number.wrapping_add(1) {
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
            let (text, polling) = (flight.text, self.polling);
            self.flight = None;
            self.own_line = Some((text, Kind::Modal));
            self.polling = polling;
            return;
        }
        if number == flight.number || flight.number == 0 {
            flight.resend.get_or_insert(now + RESEND_PAUSE);
        } else {
            // It has forgotten our numbers: restarted without a word, or another host is on the line.
            events.push(Event::Silent);
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
        let Some(flight) = self.flight.take() else { return };
        if flight.asks.is_some() && flight.asks != self.answered {
            // The `ok` of something else.
            self.flight = Some(flight);
            return;
        }
        if flight.replaced > 0 {
            return events.push(Event::LineExpired);
        }
        if flight.kind.is_some() {
            self.move_taken = now;
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
            Chore::Greet(Greeting::Number, since) => {
                self.chore = Chore::Greet(Greeting::Who, since);
                self.own("M115", Kind::Modal);
            }
            Chore::Greet(Greeting::Who, since) => {
                if self.foreign {
                    return;
                }
                self.chore = Chore::Greet(Greeting::Where, since);
                self.own("M114", Kind::Modal);
            }
            Chore::Greet(Greeting::Where, _) => {
                self.begin(Chore::None);
                self.next_poll = now + self.heartbeat;
                // It was alive all the time: it just did not answer while it moved.
                self.m114_waits |= core::mem::take(&mut self.silent_looking) && !self.restarted;
                events.push(Event::Up { restarted: core::mem::take(&mut self.restarted), alarm: None });
            }
            Chore::Sync(Asking::Where)
            | Chore::Settle(Asking::Where)
            | Chore::Stop { asking: Asking::Where, .. } => {
                let chore = self.chore;
                self.begin(Chore::None);
                self.moves_ahead = 0;
                self.silent_looking = false;
                self.next_poll = now + self.heartbeat;
                events.push(match chore {
                    Chore::Stop { .. } => Event::Stopped,
                    Chore::Settle(_) => Event::Settled,
                    _ => Event::Standing(self.position_mm.unwrap_or_default()),
                });
            }
            Chore::Sync(Asking::Look) if !self.rests() => {
                self.look_again(now);
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
                self.look_again(now);
            }
            Chore::Sync(asking) => self.chore = Chore::Sync(self.next_asking(asking)),
            Chore::Settle(asking) => self.chore = Chore::Settle(self.next_asking(asking)),
            Chore::Stop { sent, since, asking, looks } => {
                // Before the wait it is seen whether there is anything to wait for.
                let asking = if asking == Asking::Number && !self.m114_waits {
                    self.own("M114", Kind::Modal);
                    Asking::Look
                } else {
                    self.next_asking(asking)
                };
                self.chore = Chore::Stop { sent, since, asking, looks };
            }
            Chore::Unlock { sent: false } => {
                self.chore = Chore::Unlock { sent: true };
                self.own("M999", Kind::Modal);
            }
            Chore::Unlock { sent: true } => {
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

    /// Two looks in a row found the steps alike, or looks tell nothing.
    fn rests(&self) -> bool {
        self.m114_waits || (self.steps.is_some() && self.steps == self.steps_before)
    }

    fn look_again(&mut self, now: i64) {
        self.own("M114", Kind::Modal);
        self.own_not_before = now + LOOK_AGAIN;
    }

    fn next_asking(&mut self, asking: Asking) -> Asking {
        match asking {
            Asking::Number | Asking::Look => {
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
        flight.tries += 1;
        if flight.tries <= self.tries_max {
            // The number keeps it from being executed twice.
            flight.resend = Some(now);
            return;
        }
        self.silent_looking = self.chore == Chore::Sync(Asking::Look);
        events.push(Event::Silent);
    }
}

#[cfg(test)]
mod tests;
