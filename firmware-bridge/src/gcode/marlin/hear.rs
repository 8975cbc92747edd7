//! What Marlin says, line by line, and what becomes of the line on its way.

use super::*;

impl MarlinWire {
    pub(super) fn text(&mut self, text: &str, now: i64, events: &mut Events) {
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
            self.stuck = self.stuck.saturating_add(1);
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
        if text == "Cap:EMERGENCY_PARSER:1" {
            self.emergency_parser = true;
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
        self.held_up_until = None;
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
        let may_ask = self.flight.as_ref().is_some_and(|flight| self.may_ask(flight));
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
            if flight.is_answered(self.answered) {
                return self.done(now, events);
            }
            if flight.asks.is_none() || (flight.ok_seen && may_ask) {
                return self.ask_anew(now + RESEND_PAUSE);
            }
            // It may wait behind something that takes its time.
            (flight.taken, flight.resend, flight.tries) = (true, None, 0);
            let stopping = matches!(self.chore, Chore::Stop { .. });
            (flight.sent, flight.patience) = (now, if stopping { ANSWER_WAITED } else { ANSWER_WAITING });
            self.resend_ok_until = Some(now + RESEND_PAUSE);
            self.stuck = self.stuck.saturating_add(1);
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

    /// The line was taken, its answer is lost or late: asks behind it, at that moment.
    pub(super) fn ask_anew(&mut self, at: i64) {
        if self.polling && self.chore != Chore::None {
            // Something else is waiting for it.
            self.polling = false;
            self.flight = None;
            return;
        }
        let number = self.next_number();
        let Some(flight) = &mut self.flight else { return };
        if flight.asks.is_none() {
            flight.text = LineBuf::of("M114");
            flight.asks = Some(Question::Position);
            flight.expires_ns = None;
        }
        (flight.number, self.number) = (number, number);
        (flight.taken, flight.ok_seen, flight.tries) = (false, false, 0);
        flight.patience = ANSWER;
        flight.resend = Some(at);
        self.questions = self.questions.saturating_add(1);
        self.answered = None;
    }

    fn ok(&mut self, rest: &str, now: i64, events: &mut Events) {
        if self.resend_ok_until.take().is_some_and(|until| now < until) {
            return;
        }
        // The `ok` behind a `Resend:` acknowledges nothing.
        if self.flight.is_some_and(|flight| flight.resend.is_some()) {
            return;
        }
        self.stuck = 0;
        // One less waits.
        self.questions = self.questions.saturating_sub(1);
        let Some(flight) = &self.flight else { return };
        let numbered = rest.trim_start().strip_prefix('N').and_then(line::leading_integer);
        if numbered.is_some_and(|(number, _)| number != flight.number) {
            return;
        }
        self.done(now, events);
    }

    /// The line on its way is acknowledged.
    pub(super) fn done(&mut self, now: i64, events: &mut Events) {
        let Some(mut flight) = self.flight.take() else { return };
        if flight.asks.is_some() && !flight.is_answered(self.answered) {
            // The `ok` of something else.
            flight.ok_seen = true;
            self.flight = Some(flight);
            return;
        }
        // Behind a command that waits, or a planner that is being cleaned, an answer takes as long as that.
        let held_up = flight.held_up_until.is_some() || self.quickstop;
        if flight.asks.is_some() {
            self.quickstop = false;
            self.questions = 0;
        } else if matches!(flight.kind, Some(Kind::Dwell | Kind::Home)) || flight.text.as_bytes() == b"M400" {
            self.held_up_until = Some(flight.sent + flight.patience.max(ANSWER_WAITING));
        }
        if flight.replaced > 0 {
            return events.push(Event::LineExpired);
        }
        if flight.kind.is_some() {
            let asked = flight.asks.map(|_| self.position_mm.unwrap_or_default());
            let done = asked.map_or(Event::LineDone, Event::LineTaken);
            return events.push(flight.fault.map_or(done, Event::LineFailed));
        }
        if flight.asks == Some(Question::Position)
            && let Some(since) = self.asked_since.take()
            && (now - since < ANSWER || !held_up)
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
}

/// Whether a text says a word, in capitals or not.
fn says(text: &str, word: &str) -> bool {
    text.as_bytes().windows(word.len()).any(|part| part.eq_ignore_ascii_case(word.as_bytes()))
}
