//! The [`Wire`] of Grbl: what the engine calls.

use super::*;
use crate::config::Settings;
use crate::gcode::wire::{About, Preamble, Wire};

impl Wire for GrblWire {
    const PREAMBLE: &'static [Preamble] = &[Preamble { text: "G90 G21 G94", optional: false }];
    const TOLERANCE_MM: f64 = 0.5;
    const KNOWS_POSITION: bool = false;
    const CHECKS_REACH: bool = false;
    const WAITS_HERE: bool = false;
    const BEGIN_MS: u32 = 15;

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
            lines_ahead: arm.lines_ahead as usize,
            flights: VecDeque::with_capacity(LINES_AHEAD_MAX + 4),
            urgent: None,
            own_line: None,
            ask: false,
            asked: None,
            asked_since: None,
            fresh: false,
            next_ask: 0,
            heard: 0,
            unanswered: 0,
            foreign: false,
            old_version: false,
            doubts: 0,
            restarted: false,
            dirty: false,
            alarm: None,
            locked: false,
            idle_since: None,
            offset_mm: None,
            unplaced: 0,
            zero_dwell_waits: false,
            held_sign: arm.moves.held.as_ref().map_or_else(Box::default, |held| held.expect.as_str().into()),
        }
    }

    fn open(&mut self, now: i64) {
        self.greet(now);
        // Another program may have set another one meanwhile.
        self.offset_mm = None;
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
        self.asked_since = None;
        self.unanswered = 0;
        self.unplaced = 0;
        self.foreign = false;
        self.old_version = false;
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

    fn ask_again(&mut self, now: i64) {
        self.next_ask = now;
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
                self.doubt(events);
                self.asked_since = None;
                // A limit alarm answers to nothing but a reset; nothing else is lost by one.
                if self.unanswered.is_multiple_of(3) {
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
            self.asked_since.get_or_insert(now);
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
            && self.flights.len() < self.lines_ahead
            && self.used() + len < self.rx_len
    }

    fn send(&mut self, line: &LineBuf, about: About, _now: i64, out: &mut [u8]) -> usize {
        let mut len = 0;
        put(out, &mut len, line.as_bytes());
        put(out, &mut len, b"\n");
        self.flights.push_back(Flight { len, kind: Some(about.kind) });
        self.idle_since = None;
        len
    }

    fn sync(&mut self, now: i64) {
        let wait = if self.zero_dwell_waits { "G4 P0" } else { "G4 P0.001" };
        self.own_line = Some(LineBuf::of(wait));
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
