//! What the arm says: sessions, acknowledgements, the pick's progress, the arm's state.

use super::{Announced, Beat, Body, Current, MS, Own, Pending, Phase, QUEUE_LEN};
use crate::codec::{self, ArmRefusal, ArmState, FromArm, Progress, Status};
use crate::message::{Disconnect, HeldBy, Outcome, Pick, Refusal, Report, Waypoint};

impl Own {
    pub(super) fn on_wrong_version(&mut self, theirs: u8) {
        if matches!(self.phase, Phase::Shaking { .. }) && !self.noise.verdict {
            self.noise.verdict = true;
            self.reports.push(Report::WrongVersion { ours: codec::VERSION.into(), theirs: theirs.into() });
        }
    }

    pub(super) fn on_message(&mut self, message: FromArm, now_ns: i64) {
        match (message, self.phase) {
            (FromArm::Welcome(status), Phase::Shaking { sent_ns: Some(sent_ns), .. })
                if status.session == self.session =>
            {
                self.connect(&status, sent_ns, now_ns);
            }
            (FromArm::Welcome(status) | FromArm::Status(status), Phase::Up) => {
                self.on_status(&status, now_ns)
            }
            (FromArm::Outcome { id, progress }, Phase::Up) => {
                self.heard_ns = now_ns;
                self.reports.push(Report::Outcome { id, outcome: outcome(progress) });
            }
            _ => {}
        }
    }

    fn connect(&mut self, status: &Status, sent_ns: i64, now_ns: i64) {
        self.phase = Phase::Up;
        self.sequence = 0;
        self.awaited = 0;
        self.pick_sequence = 0;
        self.queue = [None; QUEUE_LEN];
        self.hold = None;
        self.heard_ns = now_ns;
        self.beat = Beat { next_ns: now_ns, number: 0, sent_ns: None, round_trips_ns: [now_ns - sent_ns; 2] };
        self.announced = Announced::Nothing;
        self.clear_of_view = false;
        self.position_known = true;
        self.not_before_ns = i64::MAX;
        let held_by = match status.arm {
            ArmState::Held(by) => by,
            ArmState::Alarm { .. } => HeldBy::Alarm,
            ArmState::Ready | ArmState::Busy => HeldBy::Start,
        };
        self.reports.push(Report::Connected { session: self.session, held_by });
        if let ArmState::Held(by) = status.arm {
            self.announced = Announced::Held(by);
        }
        if matches!(status.arm, ArmState::Ready | ArmState::Busy) {
            // Every session begins on hold; an arm that forgot is told.
            self.start_hold(now_ns);
        }
        self.on_status(status, now_ns);
    }

    fn on_status(&mut self, status: &Status, now_ns: i64) {
        if status.session != self.session {
            let cause = if status.session == 0 { Disconnect::Restarted } else { Disconnect::NewSession };
            self.disconnect(cause, now_ns);
            return;
        }
        self.heard_ns = now_ns;
        self.on_echo(status.echo, now_ns);
        self.on_acked(status.acked);
        self.follow_pick(status, now_ns);
        self.follow_view(status, now_ns);
        self.follow_state(status, now_ns);
    }

    fn on_echo(&mut self, echo: u32, now_ns: i64) {
        if echo == self.beat.number
            && let Some(sent_ns) = self.beat.sent_ns.take()
        {
            self.beat.round_trips_ns = [self.beat.round_trips_ns[1], now_ns - sent_ns];
            let delay_us = u32::try_from((now_ns - sent_ns) / 2000).unwrap_or(0);
            self.reports.push(Report::Heartbeat { delay_us });
        }
    }

    fn on_acked(&mut self, acked: u32) {
        if self.hold.is_some_and(|hold| hold.attempts > 0 && hold.sequence <= acked) {
            self.hold = None;
            self.announced = Announced::Nothing;
        }
        while let Some(head) = self.queue[0].filter(|head| head.attempts > 0 && head.sequence <= acked) {
            if matches!(head.body, Body::Release | Body::Unlock) {
                self.announced = Announced::Nothing;
            }
            self.drop_head();
        }
    }

    fn follow_pick(&mut self, status: &Status, now_ns: i64) {
        let Some(mut current) = self.current.filter(|current| current.transmitted) else { return };
        let id = current.pick.id;
        if status.acked < current.sequence {
            // A heartbeat that overtook nothing came back: the pick's packet did not arrive.
            if current.probe.is_some_and(|probe| status.echo >= probe) {
                self.retry_pick(current, now_ns);
            }
            return;
        }
        let Some(last) = status.last.filter(|last| last.id == id) else {
            // Acknowledged by something later, and the arm does not know it: it never arrived, and never will.
            self.current = None;
            self.reports.push(Report::Refused { id, refusal: Refusal::NotAcknowledged });
            return;
        };
        if !current.accepted && !matches!(last.progress, Progress::Refused(_)) {
            current.accepted = true;
            self.reports.push(Report::Accepted { id });
        }
        if !current.moving && matches!(last.progress, Progress::Moving | Progress::Done | Progress::Failed(_))
        {
            current.moving = true;
            self.reports.push(Report::Moving { id });
        }
        self.current = (!last.progress.is_final()).then_some(current);
        match last.progress {
            Progress::Accepted | Progress::Moving => {}
            Progress::Done => self.reports.push(Report::Done { id }),
            Progress::Failed(failure) => self.reports.push(Report::Failed { id, failure }),
            Progress::Refused(refusal) => {
                let refusal = from_arm(refusal, &current.pick, now_ns);
                self.reports.push(Report::Refused { id, refusal });
            }
        }
    }

    /// The pick's packet certainly got lost: once more, while it is fresh and may be sent again.
    fn retry_pick(&mut self, mut current: Current, now_ns: i64) {
        let id = current.pick.id;
        let head = self.queue[0].filter(|head| head.sequence == current.sequence);
        let spent = head.is_none_or(|head| head.attempts > self.timing.resends);
        let written_ns = self.timing.written_ns(now_ns);
        if spent || self.gate.check_time(&current.pick, written_ns, self.not_before_ns).is_err() {
            if head.is_some() {
                self.drop_head();
            }
            self.current = None;
            self.reports.push(Report::Refused { id, refusal: Refusal::NotAcknowledged });
            self.awaited = 0;
            self.ask_again(now_ns);
            return;
        }
        current.probe = None;
        self.current = Some(current);
        self.queue[0] = head.map(|head| Pending { due_ns: now_ns, ..head });
    }

    fn follow_view(&mut self, status: &Status, now_ns: i64) {
        if status.clear_of_view && !self.clear_of_view {
            self.not_before_ns = now_ns;
            self.reports.push(Report::ClearOfView);
        }
        if !status.clear_of_view && self.clear_of_view && status.arm == ArmState::Ready {
            // Moved by hand, or by something else than a pick: pictures count again when it says that it is clear.
            self.not_before_ns = i64::MAX;
            if self.announced == Announced::Ready && self.current.is_none() {
                self.reports.push(Report::Ready { clear_of_view: false });
            }
        }
        self.clear_of_view = status.clear_of_view;
        if !status.position_known && self.position_known {
            self.reports.push(Report::PositionUnknown);
        }
        self.position_known = status.position_known;
    }

    fn follow_state(&mut self, status: &Status, now_ns: i64) {
        let (state, report) = match status.arm {
            ArmState::Held(by) => (Announced::Held(by), Some(Report::Held { by })),
            ArmState::Alarm { code } => (Announced::Alarm(code), Some(Report::Alarm { code })),
            ArmState::Busy => (Announced::Busy, None),
            ArmState::Ready => {
                (Announced::Ready, Some(Report::Ready { clear_of_view: status.clear_of_view }))
            }
        };
        if state == self.announced {
            return;
        }
        if state == Announced::Ready {
            // What the arm said before it got the newest command says nothing about now.
            if self.current.is_some() || self.hold.is_some() || status.acked < self.awaited {
                return;
            }
            let dwell_ns = if status.clear_of_view { 0 } else { self.timing.clear_dwell_ns };
            self.not_before_ns = now_ns + dwell_ns;
        }
        self.announced = state;
        if let Some(report) = report {
            self.reports.push(report);
        }
    }
}

fn outcome(progress: Option<Progress>) -> Outcome {
    match progress {
        None => Outcome::Unknown,
        Some(Progress::Accepted | Progress::Moving) => Outcome::Unfinished,
        Some(Progress::Done) => Outcome::Done,
        Some(Progress::Failed(_)) => Outcome::Failed,
        Some(Progress::Refused(_)) => Outcome::Refused,
    }
}

fn from_arm(refusal: ArmRefusal, pick: &Pick, now_ns: i64) -> Refusal {
    match refusal {
        ArmRefusal::WrongSession => Refusal::WrongSession { current: pick.session },
        ArmRefusal::OnHold => Refusal::OnHold,
        ArmRefusal::Busy => Refusal::Busy,
        ArmRefusal::InAlarm => Refusal::InAlarm,
        ArmRefusal::PositionUnknown => Refusal::PositionUnknown,
        ArmRefusal::Expired => {
            let age_ms = u32::try_from(pick.age_ns(now_ns) / MS).unwrap_or(u32::MAX);
            Refusal::Stale { age_ms, max_ms: pick.ttl_ms }
        }
        ArmRefusal::NotFinite => Refusal::NotFinite { at: Waypoint::Grasp },
        ArmRefusal::Unreachable => Refusal::Unreachable,
        ArmRefusal::Other { code } => Refusal::ByArm { code },
    }
}
