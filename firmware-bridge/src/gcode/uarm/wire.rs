//! The [`Wire`] of the uArm: what the engine calls.

use super::*;
use crate::config::Settings;
use crate::gcode::wire::{About, Preamble, Wire};

impl Wire for UarmWire {
    const PREAMBLE: &'static [Preamble] = &[
        Preamble { text: "G90", optional: false },
        // Firmware 3 has no inches and does not know it.
        Preamble { text: "G21", optional: true },
    ];
    /// The encoders' reading and the commanded point differ by the arm's calibration.
    const TOLERANCE_MM: f64 = 10.0;
    const KNOWS_POSITION: bool = true;
    const CHECKS_REACH: bool = true;
    const WAITS_HERE: bool = true;
    const BEGIN_MS: u32 = 15;

    fn new(settings: &Settings) -> Self {
        let arm = &settings.arm;
        Self {
            incoming: Assembler::new(),
            chore: Chore::Closed,
            heartbeat: (i64::from(arm.heartbeat_ms) * MS).max(HEARTBEAT_MIN),
            silence: (i64::from(arm.heartbeat_timeout_ms) * MS).max(SILENCE_MIN),
            banner_wait: i64::from(arm.banner_wait_ms) * MS,
            handshake: (i64::from(arm.handshake_timeout_ms) * MS).max(ANSWER),
            tag: 0,
            flight: None,
            own_line: None,
            own_not_before: 0,
            urgent: None,
            ask: false,
            ask_sent: None,
            ask_since: None,
            next_ask: 0,
            realtime: true,
            realtime_certain: false,
            deaf_statuses: 0,
            half_line: false,
            doubted: false,
            unturned: 0,
            heard: 0,
            last_pose_mm: None,
            last_status_mm: None,
            rests: false,
            foreign: false,
            greeted_version: false,
            restarted: false,
            dirty: false,
            alarm: None,
            leave_alarm: false,
            idle_since: None,
            watch: None,
            next_watch: 0,
            runs: false,
            lingers: None,
            held_sign: arm.moves.held.as_ref().map_or_else(Box::default, |held| held.expect.as_str().into()),
        }
    }

    fn open(&mut self, now: i64) {
        self.greet(now);
        self.begin(Chore::Banner(now + self.banner_wait), now);
    }

    fn greet(&mut self, now: i64) {
        self.incoming.clear();
        self.dirty |= self.flight.is_some();
        self.urgent = None;
        self.ask = false;
        self.foreign = false;
        self.alarm = None;
        self.heard = now;
        self.say_hello(now);
    }

    fn close(&mut self) {
        self.dirty = true;
        self.begin(Chore::Closed, 0);
    }

    fn on_bytes(&mut self, bytes: &[u8], now: i64, events: &mut Events) {
        for &byte in bytes {
            if let Some(line) = self.incoming.push(byte) {
                self.text(line.text(), now, events);
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
            Chore::Greet(since) if now - since >= self.handshake => {
                if core::mem::take(&mut self.foreign) {
                    events.push(Event::WrongDialect);
                }
                // A hold left on by a cell that is gone keeps the firmware from answering: a reset ends it.
                let held = self.dirty || self.deaf_statuses > 0;
                self.say_hello(now);
                self.deaf_statuses = 1;
                if held {
                    self.urgent = Some(b"\x18");
                }
                return;
            }
            Chore::Stop { since, again, greeting } if now - again >= STOP_AGAIN => {
                self.chore = Chore::Stop { since, again: now, greeting };
                if self.realtime || (self.flight.is_none() && self.own_line.is_none()) {
                    self.send_stop(now);
                }
            }
            Chore::Settle { reset: Some(at), unlock } if now - at >= BANNER => {
                // Some builds start without a word.
                self.after_reset(unlock, now);
            }
            _ => {}
        }
        if let Some(flight) = self.flight
            && flight.patience.is_some_and(|patience| now - flight.sent >= patience)
        {
            self.flight = None;
            match flight.asked {
                Asked::Line(_) => events.push(Event::LineFailed(CODE_UNANSWERED)),
                Asked::Version | Asked::Stop | Asked::StopDone => {}
                _ => return events.push(Event::Silent),
            }
        }
        if self.polls() {
            if self.ask_sent.is_some_and(|at| now - at >= 2 * self.heartbeat) {
                self.ask_sent = None;
                self.deaf_statuses = self.deaf_statuses.saturating_add(1);
                if now - self.heard >= self.silence {
                    return events.push(Event::Silent);
                }
                let deaf = self.deaf_statuses >= DEAF_STATUSES && !self.realtime_certain;
                if deaf && self.flight.is_none() {
                    self.doubt(now);
                }
            }
            if now >= self.next_ask && self.ask_sent.is_none() {
                self.ask = true;
                let often = matches!(self.chore, Chore::Stop { .. } | Chore::Look(_));
                self.next_ask = now + if often { LOOK_AGAIN } else { self.heartbeat };
            }
        } else if self.chore == Chore::None
            && self.flight.is_none()
            && self.own_line.is_none()
            && now >= self.next_ask
        {
            self.next_ask = now + self.heartbeat;
            self.ask_pose(now);
        }
    }

    fn deadline_ns(&self) -> Option<i64> {
        let timer = match self.chore {
            Chore::Closed => return None,
            Chore::Banner(until) => return Some(until),
            Chore::Greet(since) => Some(since + self.handshake),
            Chore::Stop { again, .. } => Some(again + STOP_AGAIN),
            Chore::Settle { reset: Some(at), .. } => Some(at + BANNER),
            _ => None,
        };
        if self.urgent.is_some() || self.ask || self.leave_alarm {
            return Some(i64::MIN);
        }
        let watch = (self.moves() && self.watch.is_none()).then_some(self.next_watch);
        let own = (self.own_line.is_some() && self.flight.is_none()).then_some(self.own_not_before);
        let flight = self.flight.and_then(|flight| flight.patience.map(|patience| flight.sent + patience));
        let ask = match self.ask_sent {
            Some(at) if self.polls() => Some(at + 2 * self.heartbeat),
            _ if self.polls() || (self.chore == Chore::None && self.flight.is_none()) => Some(self.next_ask),
            _ => None,
        };
        [timer, own, flight, ask, watch].into_iter().flatten().min()
    }

    fn transmit(&mut self, now: i64, out: &mut [u8]) -> (usize, bool) {
        let mut len = 0;
        if let Some(bytes) = self.urgent.take() {
            put(out, &mut len, bytes);
            self.half_line = !self.realtime_certain && !bytes.ends_with(b"\n");
            return (len, true);
        }
        if core::mem::take(&mut self.leave_alarm) {
            put(out, &mut len, b"$X\n");
            return (len, false);
        }
        if core::mem::take(&mut self.ask) {
            put(out, &mut len, b"?");
            self.half_line |= !self.realtime_certain;
            self.ask_sent = Some(now);
            self.ask_since.get_or_insert(now);
            return (len, false);
        }
        if self.flight.is_none()
            && now >= self.own_not_before
            && let Some((line, asked)) = self.own_line.take()
        {
            return (self.launch(&line, asked, Some(ANSWER), now, out), false);
        }
        if self.moves() && self.watch.is_none() && now >= self.next_watch {
            let len = self.tagged(&LineBuf::of("P2220"), out);
            self.watch = Some(self.tag);
            self.next_watch = now + WATCH;
            return (len, false);
        }
        (0, false)
    }

    fn has_urgent(&self) -> bool {
        self.urgent.is_some()
    }

    fn takes(&self, _len: usize) -> bool {
        self.chore == Chore::None && self.flight.is_none() && self.own_line.is_none() && !self.dirty
    }

    fn send(&mut self, line: &LineBuf, about: About, now: i64, out: &mut [u8]) -> usize {
        let kind = about.kind;
        // Firmware 4 answers a move when it is done: the status and the pick's own time-out watch over it.
        let patience = match kind {
            Kind::Motion if self.realtime => None,
            Kind::Motion => Some(ANSWER_PLANNED),
            _ => Some(ANSWER),
        };
        self.idle_since = None;
        (self.watch, self.lingers) = (None, None);
        self.next_watch = now + WATCH;
        self.launch(line, Asked::Line(kind), patience, now, out)
    }

    fn sync(&mut self, now: i64) {
        self.look(LookFor::Sync, now);
    }

    fn stop(&mut self, now: i64) {
        match self.chore {
            Chore::Closed
            | Chore::Banner(_)
            | Chore::Greet(_)
            | Chore::Look(LookFor::Greeting)
            | Chore::Stop { greeting: true, .. } => {
                if self.realtime {
                    self.urgent = Some(b"!");
                    self.dirty = true;
                } else {
                    self.halt(true, now);
                }
            }
            _ => self.halt(false, now),
        }
    }

    fn settle(&mut self, now: i64) {
        if self.dirty && self.realtime {
            self.begin(Chore::Settle { reset: Some(now), unlock: false }, now);
            self.urgent = Some(b"\x18");
        } else {
            self.dirty = false;
            self.look(LookFor::Settled { unlock: false }, now);
        }
    }

    fn unlock(&mut self, now: i64) {
        self.alarm = None;
        if !self.realtime {
            self.dirty = false;
            return self.look(LookFor::Settled { unlock: true }, now);
        }
        self.begin(Chore::Settle { reset: Some(now), unlock: true }, now);
        self.urgent = Some(b"\x18");
    }

    fn ask_held(&mut self, question: &LineBuf, now: i64) {
        self.begin(Chore::Held, now);
        self.own_line = Some((*question, Asked::Held));
    }

    fn reach(&mut self, point_mm: [f64; 3], now: i64) {
        self.begin(Chore::Reach, now);
        let mut line = LineBuf::of("M2222");
        for (letter, value) in [b'X', b'Y', b'Z'].into_iter().zip(point_mm) {
            line.byte(b' ');
            line.byte(letter);
            // The gate has checked the point.
            let _ = line.decimal(value, 3);
        }
        line.text(" P0");
        self.own_line = Some((line, Asked::Reach));
    }
}
