//! What the wire noticed, and what it means for the arm and its pick.

use super::super::wire::{CODE_ELSEWHERE, CODE_UNANSWERED, Event, Wire};
use super::super::words::Kind;
use super::*;

#[allow(private_bounds)]
impl<W: Wire> Driver<W> {
    /// Every event of the wire.
    pub(super) fn digest(&mut self, now_ns: i64) {
        while let Some(event) = self.events.pop() {
            self.on_event(event, now_ns);
        }
        let bytes = core::mem::take(&mut self.events.garbage);
        if bytes > 0 {
            self.reports.push(Report::Garbage { bytes });
        }
    }

    pub(super) fn on_event(&mut self, event: Event, now_ns: i64) {
        match event {
            Event::Up { restarted, alarm } => self.connected(restarted, alarm),
            Event::WrongDialect => self.reports.push(Report::WrongDialect),
            Event::Heartbeat(delay_us) => {
                // The longest of late, forgotten slowly.
                self.delay_us = delay_us.max(self.delay_us - self.delay_us / 16);
                self.reports.push(Report::Heartbeat { delay_us });
            }
            Event::LineDone => self.line_done(),
            // A refusal may be lost as well.
            Event::LineTaken(position_mm)
                if self.flight.front() == Some(&Kind::Motion) && self.is_elsewhere(position_mm) =>
            {
                self.line_failed(CODE_UNANSWERED, now_ns);
            }
            Event::LineTaken(_) => self.line_done(),
            Event::LineFailed(code) => self.line_failed(code, now_ns),
            Event::LineExpired => self.line_expired(now_ns),
            Event::Standing(position_mm) => self.standing(position_mm, now_ns),
            Event::Resting(position_mm) => {
                self.seen_mm = position_mm;
                self.resting(position_mm, now_ns);
            }
            Event::Passing(position_mm) => self.passing(position_mm, now_ns),
            Event::Held(held) if self.stage == Stage::AskingHeld => {
                self.stage = Stage::Lines;
                if !held {
                    self.begin_list(List::Missed);
                }
            }
            Event::Reachable(reachable) => self.reachable(reachable, now_ns),
            Event::Stopped(position_mm) if self.phase == Phase::Stopping => {
                if self.claims_arrival(position_mm) {
                    self.reports.push(Report::PositionUnknown);
                }
                self.stopped();
            }
            Event::Settled if self.stage == Stage::Settling && self.phase == Phase::Starting => {
                self.flight.clear();
                self.stage = Stage::Preamble(0);
            }
            Event::Unlocked if self.stage == Stage::Unlocking => {
                self.alarm = None;
                self.flight.clear();
                self.reports.push(Report::PositionUnknown);
                if self.unlock_only {
                    self.stopped();
                } else {
                    self.stage = Stage::Settling;
                    self.wire.settle(now_ns);
                }
            }
            Event::Alarm { code, position_lost } => self.in_alarm(code, position_lost),
            Event::OperatorHold => match self.phase {
                Phase::Ready | Phase::Working | Phase::Starting => {
                    self.begin_stop(Failure::Held, HeldBy::Operator, now_ns);
                }
                _ => {}
            },
            Event::Restarted => {
                if !W::KNOWS_POSITION {
                    self.reports.push(Report::PositionUnknown);
                }
                self.disconnect(Disconnect::Restarted, Phase::Connecting);
            }
            Event::Silent => {
                self.disconnect(Disconnect::Silent, Phase::Connecting);
                self.wire.greet(now_ns);
            }
            // A stop in the middle of a handshake ends it.
            Event::Stopped(_) if self.phase == Phase::Connecting => self.wire.greet(now_ns),
            Event::Held(_) | Event::Stopped(_) | Event::Settled | Event::Unlocked => {}
        }
    }

    fn connected(&mut self, restarted: bool, alarm: Option<u16>) {
        self.session = self.session.wrapping_add(1);
        self.last_sequence = None;
        self.held_by = match (alarm, self.connected_before, restarted) {
            (Some(_), _, _) => HeldBy::Alarm,
            (None, false, _) => HeldBy::Start,
            (None, true, true) => HeldBy::ControllerReset,
            (None, true, false) => HeldBy::LinkLost,
        };
        self.connected_before = true;
        self.alarm = alarm;
        self.phase = Phase::Held;
        self.forget_lines();
        self.reports.push(Report::Connected { session: self.session, held_by: self.held_by });
        if let Some(code) = alarm {
            self.reports.push(Report::Alarm { code });
        }
    }

    /// The link or the controller is gone: nobody knows what became of a pick that was begun.
    pub(super) fn disconnect(&mut self, cause: Disconnect, phase: Phase) {
        let was_connected = !matches!(self.phase, Phase::Down | Phase::Connecting);
        if let Some(current) = self.current.take() {
            let id = current.pick.id;
            let (report, outcome) = if current.begun {
                (Report::Lost { id }, Outcome::Unknown)
            } else {
                (Report::Refused { id, refusal: Refusal::NotConnected }, Outcome::Refused)
            };
            self.finish(report, id, outcome);
        }
        self.events.clear();
        self.forget_lines();
        self.phase = phase;
        self.alarm = None;
        if was_connected {
            self.reports.push(Report::Disconnected { cause });
        }
    }

    pub(super) fn finish(&mut self, report: Report, id: u64, outcome: Outcome) {
        self.history[self.history_next] = Some((id, outcome));
        self.history_next = (self.history_next + 1) % HISTORY;
        self.reports.push(report);
    }

    /// Stops the arm; when that is confirmed the pick ends as `ending`.
    pub(super) fn begin_stop(&mut self, ending: Failure, by: HeldBy, now_ns: i64) {
        self.wire.stop(now_ns);
        self.stray_until_ns = None;
        if self.phase == Phase::Connecting {
            return;
        }
        if self.phase != Phase::Stopping {
            self.ending = ending;
        }
        self.held_by = by;
        self.phase = Phase::Stopping;
        self.stage = Stage::Lines;
        self.deadline_ns = Some(now_ns + STOP_NS);
    }

    pub(super) fn stopped(&mut self) {
        self.phase = Phase::Held;
        // It stands somewhere on its way.
        self.forget_lines();
        self.end_current(self.ending);
        self.reports.push(Report::Held { by: self.held_by });
    }

    /// Stopped on its way it says that it stands where the move was to end: a firmware that counts a move as done when it
    /// has cut it into pieces. What it believes from now on is wrong by the rest of the move.
    fn claims_arrival(&self, position_mm: [Option<f64>; 3]) -> bool {
        let known = |position_mm: [Option<f64>; 3]| position_mm.iter().all(Option::is_some);
        let was_there = known(self.seen_mm) && !differ(self.seen_mm, position_mm, W::TOLERANCE_MM);
        let arrived = known(position_mm) && !differ(self.expected_mm, position_mm, ARRIVED_MM);
        self.moved && arrived && !was_there
    }

    /// Ends the pick without success.
    pub(super) fn end_current(&mut self, failure: Failure) {
        let Some(current) = self.current.take() else { return };
        let id = current.pick.id;
        if current.begun {
            self.finish(Report::Failed { id, failure }, id, Outcome::Failed);
        } else {
            let refusal = if failure == Failure::Alarm { Refusal::InAlarm } else { Refusal::OnHold };
            self.finish(Report::Refused { id, refusal }, id, Outcome::Refused);
        }
    }

    fn in_alarm(&mut self, code: u16, position_lost: bool) {
        if self.phase == Phase::Connecting || (self.phase == Phase::Held && self.alarm == Some(code)) {
            return;
        }
        self.alarm = Some(code);
        self.held_by = HeldBy::Alarm;
        self.phase = Phase::Held;
        self.stage = Stage::Lines;
        self.forget_lines();
        self.end_current(Failure::Alarm);
        self.reports.push(Report::Alarm { code });
        if position_lost {
            self.reports.push(Report::PositionUnknown);
        }
    }

    pub(super) fn out_of_time(&mut self, now_ns: i64) {
        match self.phase {
            Phase::Working | Phase::Starting => self.begin_stop(Failure::TimedOut, HeldBy::Alarm, now_ns),
            Phase::Stopping => self.on_event(Event::Silent, now_ns),
            _ => {}
        }
    }

    fn line_done(&mut self) {
        let kind = self.flight.pop_front();
        if let (Phase::Starting, Stage::Preamble(index)) = (self.phase, self.stage) {
            self.preamble_done(index);
        }
        let first = kind == Some(Kind::Motion) && self.phase == Phase::Working && self.list == List::Pick;
        if let Some(current) = self.current.as_mut().filter(|current| first && !current.accepted) {
            current.accepted = true;
            let id = current.pick.id;
            self.reports.push(Report::Accepted { id });
            self.reports.push(Report::Moving { id });
        }
    }

    fn preamble_done(&mut self, index: u8) {
        self.stage = Stage::Preamble(index + 1);
    }

    fn line_failed(&mut self, code: u16, now_ns: i64) {
        self.flight.pop_front();
        if let (Phase::Starting, Stage::Preamble(index)) = (self.phase, self.stage)
            && W::PREAMBLE.get(usize::from(index)).is_some_and(|line| line.optional)
            && code != CODE_UNANSWERED
        {
            return self.preamble_done(index);
        }
        if matches!(self.phase, Phase::Working | Phase::Starting) {
            self.begin_stop(Failure::Controller { code }, HeldBy::Alarm, now_ns);
        }
    }

    /// The first move of a pick was lost on its way and is too old by now: nothing of it was begun.
    fn line_expired(&mut self, now_ns: i64) {
        self.flight.pop_front();
        self.rest();
        self.expected_mm = self.seen_mm;
        let Some(current) = self.current.filter(|_| self.phase == Phase::Working) else { return };
        let ms = |ns: i64| u32::try_from(ns / MS).unwrap_or(u32::MAX);
        let (age_ms, max_ms) = (ms(current.pick.age_ns(now_ns)), current.pick.ttl_ms);
        self.refuse_current(Refusal::Stale { age_ms, max_ms });
    }

    fn standing(&mut self, position_mm: [Option<f64>; 3], now_ns: i64) {
        if self.stage != Stage::Syncing || !matches!(self.phase, Phase::Working | Phase::Starting) {
            return;
        }
        if self.is_elsewhere(position_mm) {
            self.position_tries += 1;
            if self.position_tries < POSITION_TRIES {
                return self.wire.sync(now_ns);
            }
            return self.stop_astray(now_ns);
        }
        self.position_tries = 0;
        self.rest();
        self.seen_mm = position_mm;
        self.stage = Stage::Lines;
    }

    /// Seen on its way: outside the room between its points a line was not understood as it was meant.
    fn passing(&mut self, position_mm: [Option<f64>; 3], now_ns: i64) {
        for (axis, at) in position_mm.iter().enumerate().filter_map(|(axis, at)| Some((axis, (*at)?))) {
            if self.moved && self.room_mm[axis].is_none() {
                // It set out from an unknown place: from here its way may lead anywhere in the workspace, not beyond.
                let (low, high) = self.gate.bounds_mm(axis);
                self.room_mm[axis] = Some((low.min(at), high.max(at)));
            }
        }
        let outside = |axis: usize| match (position_mm[axis], self.room_mm[axis]) {
            (Some(at), Some((low, high))) => at < low - ROOM_MM || at > high + ROOM_MM,
            _ => false,
        };
        let watched = self.moved && matches!(self.phase, Phase::Working | Phase::Starting);
        if !watched || !(0..3).any(outside) {
            self.stray_until_ns = None;
        } else if self.stray_until_ns.is_some() {
            self.stop_astray(now_ns);
        } else {
            // One digit lost on the way here looks the same, but not twice.
            self.stray_until_ns = Some(now_ns + STRAY_NS);
            self.wire.ask_again(now_ns);
        }
    }

    pub(super) fn stop_astray(&mut self, now_ns: i64) {
        self.begin_stop(Failure::Controller { code: CODE_ELSEWHERE }, HeldBy::Alarm, now_ns);
    }

    /// Seen at rest between picks: an arm that does not stand where it was left was moved, or restarted unheard.
    fn resting(&mut self, position_mm: [Option<f64>; 3], now_ns: i64) {
        if self.phase != Phase::Ready {
            return;
        }
        if !self.is_elsewhere(position_mm) {
            self.position_tries = 0;
            return;
        }
        self.position_tries += 1;
        if self.position_tries >= POSITION_TRIES {
            self.position_tries = 0;
            self.expected_mm = [None; 3];
            self.reports.push(Report::PositionUnknown);
            self.begin_stop(Failure::Held, HeldBy::Operator, now_ns);
        }
    }

    fn is_elsewhere(&self, position_mm: [Option<f64>; 3]) -> bool {
        differ(self.expected_mm, position_mm, W::TOLERANCE_MM)
    }

    fn reachable(&mut self, reachable: bool, now_ns: i64) {
        let (Stage::Reaching(index), Some(current)) = (self.stage, self.current) else { return };
        if !reachable {
            return self.refuse_current(Refusal::Unreachable);
        }
        match current.pick.poses().get(usize::from(index) + 1) {
            Some((_, pose)) => {
                self.stage = Stage::Reaching(index + 1);
                self.wire.reach(pose.position_mm, now_ns);
            }
            None => self.stage = Stage::Lines,
        }
    }

    /// The pick ends before it began; the arm has not moved.
    pub(super) fn refuse_current(&mut self, refusal: Refusal) {
        let Some(current) = self.current.take() else { return };
        let id = current.pick.id;
        self.finish(Report::Refused { id, refusal }, id, Outcome::Refused);
        self.phase = Phase::Ready;
        self.stage = Stage::Lines;
        self.deadline_ns = None;
        self.reports.push(Report::Ready { clear_of_view: self.clear_of_view });
    }
}

/// Whether two points are further apart than that in a coordinate that both have.
fn differ(one_mm: [Option<f64>; 3], other_mm: [Option<f64>; 3], by_mm: f64) -> bool {
    one_mm.iter().zip(other_mm).any(|(one, other)| match (one, other) {
        (Some(one), Some(other)) => (one - other).abs() > by_mm,
        _ => false,
    })
}
