//! What the uArm says, line by line: answers, readings of its encoders, statuses, reports.

use super::*;
use crate::message::distance_mm;

impl UarmWire {
    pub(super) fn text(&mut self, text: &str, now: i64, events: &mut Events) {
        if let Some(status) = text.strip_prefix('<').and_then(|t| t.strip_suffix('>')) {
            self.heard = now;
            return self.status(status, now, events);
        }
        // Version 4.10 writes the pressure that it measures before the answer to P2231, on its line.
        if let Some((_, answer)) = text.rsplit_once('$')
            && let Some((tag, rest)) = line::leading_integer(answer)
        {
            self.heard = now;
            return self.answer(tag, rest.trim(), now, events);
        }
        if text == "@1" || text.starts_with("Grbl 0.9") || text == "start" {
            return self.banner(now, events);
        }
        if text.starts_with("@5 V0") {
            // The motors lost their power.
            return events.push(Event::OperatorHold);
        }
        if text.starts_with("ALARM") {
            self.alarm = Some(1);
            self.flight = None;
            match self.chore {
                Chore::Closed
                | Chore::Banner(_)
                | Chore::Greet(_)
                | Chore::Settle { .. }
                | Chore::Stop { .. } => {}
                _ => {
                    self.begin(Chore::None, now);
                    events.push(Event::Alarm { code: 1, position_lost: false });
                }
            }
            return;
        }
        if let Some(code) = text.strip_prefix('E').and_then(line::leading_integer) {
            // "E23 buffer full" comes without a tag.
            if matches!(self.flight, Some(Flight { asked: Asked::Line(_), .. })) {
                self.flight = None;
                events.push(Event::LineFailed(code.0 as u16));
            }
            return;
        }
        // Later builds of firmware 4 say `ok @9 V0` to a stop byte, and who they are before their banner.
        let chat = ["@", "[", "ok", "OK", "device name", "soft ver", "api ver", "work mode"];
        // Firmware 3 starts with the `echo:` lines of its Marlin.
        let unknown = text.starts_with("echo:Unknown command");
        let known =
            chat.iter().any(|begin| text.starts_with(begin)) || (text.starts_with("echo:") && !unknown);
        if !known {
            let other = unknown || text.starts_with("Grbl") || text.starts_with("error:");
            self.foreign |= other && matches!(self.chore, Chore::Greet(_));
            events.garbage += text.len() as u32;
        }
    }

    fn banner(&mut self, now: i64, events: &mut Events) {
        self.alarm = None;
        match self.chore {
            Chore::Closed => {}
            Chore::Settle { reset: Some(_), unlock } => self.after_reset(unlock, now),
            // The banner has two lines.
            Chore::Look(LookFor::Settled { .. }) => {}
            Chore::Banner(_) | Chore::Greet(_) | Chore::Look(LookFor::Greeting) => {
                self.restarted = true;
                self.dirty = false;
                self.say_hello(now);
            }
            _ => {
                self.restarted = true;
                self.dirty = false;
                events.push(Event::Restarted);
                self.say_hello(now);
            }
        }
    }

    /// What stands behind `$n`.
    fn answer(&mut self, tag: u32, rest: &str, now: i64, events: &mut Events) {
        if self.watch == Some(tag) {
            self.watch = None;
            if let Some(pose_mm) = pose(rest) {
                self.moved_to(pose_mm, now, events);
            }
            return;
        }
        let Some(flight) = self.flight.filter(|flight| flight.tag == tag) else { return };
        self.flight = None;
        let (word, value) = rest.split_once(' ').unwrap_or((rest, ""));
        let ok = word.eq_ignore_ascii_case("ok");
        let code = word
            .strip_prefix('E')
            .and_then(line::leading_integer)
            .map_or(CODE_UNNUMBERED, |(code, _)| code as u16);
        if !matches!(flight.asked, Asked::Line(_)) {
            let delay_us = u32::try_from((now - flight.sent) / 2000).unwrap_or(u32::MAX);
            events.push(Event::Heartbeat(delay_us));
        }
        match flight.asked {
            Asked::Line(_) if ok => events.push(Event::LineDone),
            Asked::Line(_) => events.push(Event::LineFailed(code)),
            Asked::Version => {
                let major = line::leading_integer(value.trim_start_matches(['V', 'v']));
                self.realtime = major.is_none_or(|(major, _)| major >= 4);
                self.realtime_certain = major.is_some();
                self.doubted &= major.is_none();
                self.greeted_version = true;
                self.look(LookFor::Greeting, now);
            }
            Asked::Moving => {
                if !ok {
                    // Only firmware 4 does not know the question.
                    self.realtime = true;
                }
                self.moving(ok && value.contains("V1"), now);
            }
            Asked::Angles => self.turned(ok.then_some(value), now),
            Asked::Believed => self.believes(pose(value), now, events),
            Asked::Pose => self.posed(ok, value, now, events),
            Asked::Held => {
                self.chore = Chore::None;
                events.push(Event::Held(ok && rest.contains(&*self.held_sign)));
            }
            Asked::Reach => {
                self.chore = Chore::None;
                // A firmware that does not know the question leaves the answer to the move itself.
                events.push(Event::Reachable(!(ok && value.contains("V0")) && code != 22));
            }
            Asked::Stop if !ok => {
                // It is no firmware 3: stop it as firmware 4 is stopped.
                self.realtime = true;
                self.urgent = Some(b"!");
            }
            Asked::Stop => self.own("G2203", Asked::StopDone, now),
            // The encoders say whether it does.
            Asked::StopDone => self.look_again(now),
        }
    }

    /// Firmware 3 says whether it moves.
    fn moving(&mut self, moving: bool, now: i64) {
        self.runs = moving;
        match self.chore {
            Chore::Look(LookFor::Greeting) if moving => self.halt(true, now),
            Chore::Stop { .. } if moving => self.send_stop(now),
            _ => self.ask_pose(now),
        }
    }

    /// The angles of firmware 3's encoders are made a point by itself.
    fn turned(&mut self, angles: Option<&str>, now: i64) {
        let mut line = LineBuf::of("M2221");
        for letter in ['B', 'L', 'R'] {
            let angle = angles.and_then(|angles| line::word(angles, letter));
            line.byte(b' ');
            line.byte(letter as u8);
            if !angle.is_some_and(|angle| line.decimal(angle, 3)) {
                // A byte lost, or an encoder.
                return self.look_again(now + LOOK_AGAIN);
            }
        }
        self.own_line = Some((line, Asked::Pose));
        self.own_not_before = now;
    }

    /// After a stop firmware 3 may go on from where its encoders never were: only a restart reads them.
    fn believes(&mut self, pose_mm: Option<[f64; 3]>, now: i64, events: &mut Events) {
        let (Some(believed), Some(seen)) = (pose_mm, self.last_pose_mm) else {
            return self.own("P2220", Asked::Believed, now + LOOK_AGAIN);
        };
        let unlock = self.chore == Chore::Look(LookFor::Settled { unlock: true });
        self.begin(Chore::None, now);
        events.push(match (distance_mm(believed, seen) <= BELIEF_MM, unlock) {
            (false, _) => Event::Alarm { code: CODE_ELSEWHERE, position_lost: true },
            (true, false) => Event::Settled,
            (true, true) => Event::Unlocked,
        });
    }

    /// A reading of the encoders.
    fn posed(&mut self, ok: bool, value: &str, now: i64, events: &mut Events) {
        let Some(pose_mm) = pose(value) else {
            // An early firmware 3 does not turn angles; NaN, or a byte lost: look again.
            self.unturned = self.unturned.saturating_add(u8::from(ok && value.is_empty()));
            events.garbage += value.len() as u32;
            if !ok || matches!(self.chore, Chore::Look(_) | Chore::Stop { .. }) {
                self.look_again(now + LOOK_AGAIN);
            }
            return;
        };
        if self.turns_angles() {
            self.unturned = 0;
        }
        if self.chore == Chore::None {
            return events.push(Event::Resting(pose_mm.map(Some)));
        }
        let before = self.last_pose_mm.replace(pose_mm);
        let stands = before.is_some_and(|before| distance_mm(before, pose_mm) <= AGREE_MM);
        let what_for = match self.chore {
            Chore::Look(what_for) => what_for,
            Chore::Stop { greeting, .. } if stands => return self.stopped(greeting, now, events),
            Chore::Stop { .. } => return self.look_again(now + LOOK_AGAIN),
            _ => return,
        };
        // Slow moves look like rest to the encoders; the status, where there is one, does not.
        let stands = stands && if self.realtime { self.rests } else { !self.runs };
        if !stands {
            let moves = before.is_some_and(|before| distance_mm(before, pose_mm) > AGREE_MM);
            if moves && what_for == LookFor::Greeting {
                // It moves although nobody here told it to.
                return self.halt(true, now);
            }
            self.look_again(now + LOOK_AGAIN);
            // Where it was sent does not change on the way.
            if self.realtime || self.turns_angles() {
                self.moved_to(pose_mm, now, events);
            }
            return;
        }
        if !self.realtime && self.turns_angles() && matches!(what_for, LookFor::Settled { .. }) {
            return self.own("P2220", Asked::Believed, now);
        }
        self.begin(Chore::None, now);
        events.push(match what_for {
            LookFor::Greeting => Event::Up { restarted: core::mem::take(&mut self.restarted), alarm: None },
            LookFor::Sync => Event::Standing(pose_mm.map(Some)),
            LookFor::Settled { unlock: false } => Event::Settled,
            LookFor::Settled { unlock: true } => Event::Unlocked,
        });
    }

    /// The encoders' reading while it is to move: an arm that does not get on although its controller counts steps is
    /// blocked, and must not be sent on from where nobody knows.
    fn moved_to(&mut self, pose_mm: [f64; 3], now: i64, events: &mut Events) {
        let gets_on = self.lingers.is_none_or(|(at, _)| distance_mm(at, pose_mm) > AGREE_MM);
        if gets_on || !self.runs {
            self.lingers = Some((pose_mm, now));
        } else if self.lingers.is_some_and(|(_, since)| now - since >= STALLED) {
            self.lingers = None;
            self.flight = None;
            events.push(Event::LineFailed(CODE_ELSEWHERE));
        }
    }

    /// `Hold,MPos:…` as Grbl 0.9 writes it.
    fn status(&mut self, status: &str, now: i64, events: &mut Events) {
        self.deaf_statuses = 0;
        self.ask_sent = None;
        if let Some(since) = self.ask_since.take() {
            events.push(Event::Heartbeat(u32::try_from((now - since) / 2000).unwrap_or(u32::MAX)));
        }
        let (state, rest) = status.split_once([',', '|']).unwrap_or((status, ""));
        if self.chore == Chore::Look(LookFor::Greeting) && matches!(state, "Run" | "Home" | "Hold") {
            // It moves, or a cell that is gone holds it: what it still has must go.
            return self.halt(true, now);
        }
        self.rests = matches!(state, "Idle" | "Alarm");
        self.runs = state == "Run";
        let at_mm = rest.strip_prefix("MPos:").and_then(line::triple);
        let before = core::mem::replace(&mut self.last_status_mm, at_mm);
        let still = match (before, at_mm) {
            (Some(before), Some(at)) => distance_mm(before, at) == 0.0,
            _ => false,
        };
        match (self.chore, state) {
            (Chore::Stop { greeting, .. }, "Hold" | "Idle" | "Alarm" | "Door") if still => {
                self.stopped(greeting, now, events);
            }
            (Chore::None | Chore::Look(LookFor::Sync), "Hold" | "Door") if !self.dirty => {
                events.push(Event::OperatorHold);
            }
            (Chore::None, "Idle") if self.flight.is_some() => {
                // It stands and has not answered: the answer is lost, or the line was.
                if now - *self.idle_since.get_or_insert(now) >= ANSWER_LOST {
                    self.idle_since = None;
                    self.flight = None;
                    events.push(Event::LineFailed(CODE_UNANSWERED));
                }
                return;
            }
            (Chore::None, "Alarm") if self.alarm.is_none() => {
                self.alarm = Some(1);
                self.flight = None;
                events.push(Event::Alarm { code: 1, position_lost: false });
            }
            _ => {}
        }
        self.idle_since = None;
    }
}

/// Where the encoders say that it is.
fn pose(answer: &str) -> Option<[f64; 3]> {
    match ['X', 'Y', 'Z'].map(|axis| line::word(answer, axis)) {
        [Some(x), Some(y), Some(z)] => Some([x, y, z]),
        _ => None,
    }
}
