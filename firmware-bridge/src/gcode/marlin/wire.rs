//! The [`Wire`] of Marlin: what the engine calls.

use super::*;
use crate::config::Settings;
use crate::gcode::wire::{About, Preamble, Wire};

impl Wire for MarlinWire {
    const PREAMBLE: &'static [Preamble] = &[
        Preamble { text: "G90", optional: false },
        // Only builds with INCH_MODE_SUPPORT know it; the others have nothing but millimetres.
        Preamble { text: "G21", optional: true },
    ];
    const TOLERANCE_MM: f64 = 0.5;
    const KNOWS_POSITION: bool = false;
    const CHECKS_REACH: bool = false;
    const WAITS_HERE: bool = false;
    /// `BLOCK_DELAY_FOR_1ST_MOVE`: a first move waits 100 ms for others to come (Marlin 2, planner.h).
    const BEGIN_MS: u32 = 115;

    fn new(settings: &Settings) -> Self {
        let arm = &settings.arm;
        Self {
            incoming: Assembler::new(),
            chore: Chore::Closed,
            heartbeat: (i64::from(arm.heartbeat_ms) * MS).max(HEARTBEAT_MIN),
            banner_wait: i64::from(arm.banner_wait_ms) * MS,
            handshake: (i64::from(arm.handshake_timeout_ms) * MS).max(1500 * MS),
            tries_max: arm.resends.min(TRIES_MAX),
            number: 0,
            flight: None,
            urgent: None,
            own_line: None,
            answered: None,
            questions: 0,
            held_up_until: None,
            position_mm: None,
            steps: None,
            steps_before: None,
            quickstop: false,
            stuck: 0,
            resend_ok_until: None,
            moves_ahead: 0,
            own_not_before: 0,
            next_poll: 0,
            polling: false,
            asked_since: None,
            foreign: false,
            restarted: false,
            dead: false,
            held_sign: arm.moves.held.as_ref().map_or_else(Box::default, |held| held.expect.as_str().into()),
            held: false,
            emergency_parser: false,
        }
    }

    fn open(&mut self, now: i64) {
        self.greet(now);
        self.begin(Chore::Banner(now + self.banner_wait));
    }

    fn greet(&mut self, now: i64) {
        self.incoming.clear();
        self.foreign = false;
        self.dead = false;
        self.emergency_parser = false;
        self.say_hello(now);
        // Moves of a cell that is gone are thrown away before anything new. A line cut in the middle by that
        // cell has a number and no checksum: ending it makes the controller refuse it.
        self.urgent = Some(LineBuf::of("\nM410\n"));
    }

    fn close(&mut self) {
        self.begin(Chore::Closed);
        self.urgent = None;
    }

    fn on_bytes(&mut self, bytes: &[u8], now: i64, events: &mut Events) {
        for &byte in bytes {
            if let Some(line) = self.incoming.push(byte) {
                self.text(line.text(), now, events);
                if let Some(flight) = self.flight.as_mut().filter(|flight| flight.ok_seen)
                    && flight.is_answered(self.answered)
                {
                    flight.patience = flight.patience.min(now - flight.sent + SECOND_OK);
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
                    self.greet(now);
                }
                return;
            }
            Chore::Greet(_, since) if now - since >= self.greeting() => {
                if core::mem::take(&mut self.foreign) {
                    events.push(Event::WrongDialect);
                }
                return self.greet(now);
            }
            Chore::Stop { since, .. } if now - since >= STOP_LOST => {
                self.begin(Chore::None);
                return events.push(Event::Silent);
            }
            Chore::Stop { since, .. }
                if self.emergency_parser && self.stuck >= SIGNS_STUCK && now - since >= STOP_UNTAKEN =>
            {
                return self.kill(events);
            }
            Chore::Stop { sent: 1, since, .. } => {
                if now - since >= STOP_AGAIN {
                    self.stop_again("M410\n", now);
                    self.own("M114", Kind::Modal);
                }
                return;
            }
            _ => {}
        }
        if self.flight.is_some_and(|f| f.resend.is_none() && now - f.sent >= f.patience) {
            self.unanswered(now, events);
        }
        let idle = self.flight.is_none() && self.own_line.is_none() && !self.dead;
        if idle && self.chore == Chore::None && now >= self.next_poll {
            self.next_poll = now + self.heartbeat;
            self.polling = true;
            self.own("M114", Kind::Modal);
        }
    }

    fn deadline_ns(&self) -> Option<i64> {
        let timer = match self.chore {
            Chore::Closed => return None,
            Chore::Banner(until) => return Some(until),
            Chore::Greet(_, since) => Some(since + self.greeting()),
            Chore::Stop { sent: 1, since, .. } => Some(since + STOP_AGAIN),
            Chore::Stop { since, .. } if self.emergency_parser && self.stuck >= SIGNS_STUCK => {
                Some(since + STOP_UNTAKEN)
            }
            Chore::Stop { since, .. } => Some(since + STOP_LOST),
            Chore::None if !self.dead && self.flight.is_none() => Some(self.next_poll),
            _ => None,
        };
        if self.urgent.is_some() {
            return Some(i64::MIN);
        }
        let own = (self.own_line.is_some() && self.flight.is_none()).then_some(self.own_not_before);
        let flight = self.flight.map(|flight| flight.resend.unwrap_or(flight.sent + flight.patience));
        [timer, own, flight].into_iter().flatten().min()
    }

    fn transmit(&mut self, now: i64, out: &mut [u8]) -> (usize, bool) {
        if let Some(line) = self.urgent.take() {
            let mut len = 0;
            put(out, &mut len, line.as_bytes());
            self.quickstop = true;
            return (len, true);
        }
        if let Some(flight) = &mut self.flight {
            if flight.resend.is_some_and(|at| now >= at) {
                flight.resend = None;
                flight.sent = now;
                flight.fault = None;
                if flight.expires_ns.is_some_and(|at| now >= at) {
                    // Under its number goes a question instead: is the number taken already, the move was.
                    flight.text = LineBuf::of("M114");
                    flight.asks = Some(Question::Position);
                    flight.replaced += 1;
                    self.answered = None;
                }
                return (Self::encode(flight, out), false);
            }
            return (0, false);
        }
        if now < self.own_not_before {
            return (0, false);
        }
        let Some((line, kind)) = self.own_line.take() else { return (0, false) };
        if line.as_bytes() == b"M114" {
            self.asked_since.get_or_insert(now);
        }
        let patience = match kind {
            Kind::Dwell => ANSWER_WAITING,
            _ => self.patience(),
        };
        (self.launch(line, None, patience, now, out), false)
    }

    fn has_urgent(&self) -> bool {
        self.urgent.is_some()
    }

    fn takes(&self, _len: usize) -> bool {
        self.chore == Chore::None && self.flight.is_none() && self.own_line.is_none() && !self.dead
    }

    fn send(&mut self, line: &LineBuf, about: About, now: i64, out: &mut [u8]) -> usize {
        let About { kind, dwell_ms, expires_ns } = about;
        let patience = match kind {
            Kind::Motion if self.moves_ahead < MOVES_AHEAD => ANSWER,
            Kind::Motion => ANSWER_WAITING,
            Kind::Dwell => ANSWER_WAITING + i64::from(dwell_ms) * MS,
            Kind::Home => ANSWER_HOME,
            Kind::Action => ANSWER_ACTION,
            Kind::Modal => ANSWER,
        };
        self.next_poll = now + self.heartbeat;
        self.moves_ahead += u32::from(kind == Kind::Motion);
        let len = self.launch(*line, Some(kind), patience, now, out);
        if let Some(flight) = &mut self.flight {
            flight.expires_ns = expires_ns;
        }
        len
    }

    fn sync(&mut self, _now: i64) {
        self.turn_to(Chore::Sync(Asking::Wait));
        self.own("M400", Kind::Dwell);
    }

    fn stop(&mut self, now: i64) {
        self.urgent = Some(LineBuf::of("\nM410\n"));
        if !matches!(self.chore, Chore::Closed | Chore::Banner(_) | Chore::Greet(..)) {
            self.begin(Chore::Stop { sent: 1, since: now, last: now, asking: Asking::Look, looks: 0 });
        }
    }

    fn settle(&mut self, _now: i64) {
        self.turn_to(Chore::Settle(Asking::Wait));
        self.own("M400", Kind::Dwell);
    }

    fn unlock(&mut self, _now: i64) {
        self.dead = false;
        // M999 leaves the state "stopped"; a killed controller needs its button, and then says its banner.
        self.turn_to(Chore::Unlock);
        self.own("M999", Kind::Modal);
    }

    fn ask_held(&mut self, question: &LineBuf, _now: i64) {
        self.turn_to(Chore::Held);
        self.held = false;
        self.own_line = Some((*question, Kind::Modal));
    }

    fn reach(&mut self, _point_mm: [f64; 3], _now: i64) {}
}
