//! The arm as the core sees it: link, hold, readiness, the one unfinished target.

use firmware_bridge::message::{Command, Failure, HeldBy, Pick, Report};

use super::action::{Action, Actions, Alarm, Ending, Note, TargetEnd};
use super::count::Cause;
use super::event::{Candidate, Operator};
use super::{Core, Phase, State};
use crate::time::Timestamp;

/// An arm that has not answered for so long since the start is said to be silent, ns: boards restart when their port is
/// opened, and a bridge may be started after the cell.
const SILENT_NS: i64 = 8_000_000_000;
/// A link says itself that a pick takes too long, when the arm stands: it takes up to ten seconds to stop one. Only a link that
/// does not is told to begin anew.
pub(super) const STOPPING_NS: i64 = 11_000_000_000;
/// A released arm may home first, for which links wait three minutes.
const STARTING_NS: i64 = 190_000_000_000;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Link {
    Absent,
    Held,
    Alarmed,
    /// Released; ready until then, or held again.
    Releasing(Timestamp),
    Released,
}

#[derive(Clone, Copy, Debug)]
struct Unfinished {
    id: u64,
    stage: State,
    part: u16,
    filed_mm: [f64; 3],
    failures_before: u32,
    seen_ns: i64,
    /// Over by then, or lost.
    until: Timestamp,
}

/// The arm's side of the core's state.
#[derive(Clone, Debug)]
pub(super) struct ArmSide {
    link: Link,
    ever_connected: bool,
    session: u32,
    sequence: u32,
    next_id: u64,
    unfinished: Option<Unfinished>,
    ready: bool,
    clear_since: Option<Timestamp>,
    /// It has said in this session that it is clear of the view: it will say so again, a dwell proves nothing.
    says_clear: bool,
    dwell_until: Option<Timestamp>,
    ended_at: Timestamp,
    /// A hold was commanded and not confirmed yet.
    hold_unconfirmed: bool,
    /// The operator holds: nothing but the operator may release.
    held_by_operator: bool,
    release_wanted: bool,
    /// When it is said that the arm does not answer; `None`: it has, or it was said.
    silent_at: Option<Timestamp>,
}

impl ArmSide {
    pub(super) fn new(first_id: u64, now: Timestamp) -> Self {
        Self {
            link: Link::Absent,
            ever_connected: false,
            session: 0,
            sequence: 0,
            next_id: first_id.max(1),
            unfinished: None,
            ready: false,
            clear_since: None,
            says_clear: false,
            dwell_until: None,
            ended_at: Timestamp(i64::MIN),
            hold_unconfirmed: false,
            held_by_operator: false,
            release_wanted: false,
            silent_at: Some(Timestamp(now.0.saturating_add(SILENT_NS))),
        }
    }

    pub(super) fn state(&self) -> State {
        match self.link {
            Link::Absent => State::Absent,
            Link::Held => State::Held,
            Link::Alarmed => State::Alarmed,
            Link::Releasing(_) => State::Releasing,
            Link::Released => match &self.unfinished {
                Some(target) => target.stage,
                None if self.ready => State::Looking,
                None => State::Releasing,
            },
        }
    }

    pub(super) fn is_connected(&self) -> bool {
        self.link != Link::Absent
    }

    /// Nothing moves any more, as far as can be known.
    pub(super) fn is_quiet(&self) -> bool {
        self.link == Link::Absent || (!self.hold_unconfirmed && self.unfinished.is_none())
    }

    pub(super) fn unfinished(&self) -> Option<u64> {
        self.unfinished.map(|target| target.id)
    }

    pub(super) fn is_clear(&self) -> bool {
        self.clear_since.is_some()
    }

    /// Pictures have to be taken after this moment.
    pub(super) fn not_before(&self) -> Timestamp {
        self.clear_since.unwrap_or(Timestamp(i64::MAX)).max(self.ended_at)
    }

    pub(super) fn next_id(&self) -> u64 {
        self.next_id
    }

    pub(super) fn next_sequence(&self) -> (u32, u32) {
        (self.session, self.sequence.wrapping_add(1))
    }

    pub(super) fn order(
        &mut self,
        pick: &Pick,
        candidate: &Candidate,
        failures_before: u32,
        until: Timestamp,
    ) {
        self.sequence = pick.sequence;
        self.next_id = self.next_id.max(pick.id + 1);
        self.ready = false;
        self.clear_since = None;
        self.dwell_until = None;
        self.unfinished = Some(Unfinished {
            id: pick.id,
            stage: State::Ordered,
            part: candidate.part,
            filed_mm: candidate.filed_mm(),
            failures_before,
            seen_ns: pick.seen.earliest_ns(),
            until,
        });
    }

    /// A hold was commanded: from here on nothing may move.
    pub(super) fn await_hold(&mut self) {
        if self.link != Link::Alarmed {
            self.link = Link::Held;
        }
        self.hold_unconfirmed = true;
        self.release_wanted = false;
        self.not_ready();
    }

    fn not_ready(&mut self) {
        self.ready = false;
        self.clear_since = None;
        self.dwell_until = None;
    }

    pub(super) fn next_tick(&self) -> Option<Timestamp> {
        let releasing = match self.link {
            Link::Releasing(until) => Some(until),
            _ => None,
        };
        let target = self.unfinished.map(|target| target.until);
        [releasing, self.dwell_until, target, self.silent_at].into_iter().flatten().min()
    }

    /// Moves the unfinished target on; whether the report is about it.
    fn stage(&mut self, id: u64, stage: State) -> bool {
        match &mut self.unfinished {
            Some(target) if target.id == id => {
                target.stage = stage;
                true
            }
            _ => false,
        }
    }
}

impl Core {
    pub(super) fn arm_says(&mut self, report: &Report, now: Timestamp, actions: &mut Actions) {
        match *report {
            Report::Connected { session, held_by } => self.connected(session, held_by, now, actions),
            Report::Disconnected { cause } => {
                self.arm_gone(now, actions);
                actions.say(Note::Alarm(Alarm::ArmLost { cause }));
            }
            Report::ReportsLost => {
                self.arm_gone(now, actions);
                actions.say(Note::Alarm(Alarm::ReportsLost));
                actions.push(Action::Arm(Command::Hello));
            }
            Report::Ready { clear_of_view } => self.arm_ready(clear_of_view, now, actions),
            Report::ClearOfView => {
                self.arm.says_clear = true;
                if matches!(self.arm.link, Link::Released | Link::Releasing(_)) {
                    self.arm.clear_since = Some(now);
                    self.arm.dwell_until = None;
                }
            }
            Report::Sent { id, at_ns } => self.sent(id, at_ns, actions),
            Report::Accepted { id } => match self.arm.stage(id, State::Accepted) {
                true => actions.say(Note::Accepted { id }),
                false => self.counts.add(Cause::StrayReports, 1),
            },
            Report::Moving { id } => {
                if !self.arm.stage(id, State::Moving) {
                    self.counts.add(Cause::StrayReports, 1);
                }
            }
            Report::Done { id } => self.end_target(id, TargetEnd::Done, now, actions),
            Report::Failed { id, failure } => self.end_target(id, TargetEnd::Failed(failure), now, actions),
            Report::Refused { id, refusal } => self.end_target(id, TargetEnd::Refused(refusal), now, actions),
            Report::Lost { id } => self.end_target(id, TargetEnd::Lost, now, actions),
            Report::Outcome { id, outcome } => self.place.answered(id, outcome, now, actions),
            Report::Held { by } => self.held(by, now, actions),
            Report::Alarm { code } => {
                self.arm.link = Link::Alarmed;
                self.arm.hold_unconfirmed = false;
                self.arm.release_wanted = false;
                self.arm.not_ready();
                actions.say(Note::Alarm(Alarm::Controller { code }));
            }
            Report::PositionUnknown => {
                if matches!(self.arm.link, Link::Released | Link::Releasing(_)) {
                    self.arm.link = Link::Held;
                }
                self.arm.not_ready();
                actions.say(Note::Alarm(Alarm::PositionUnknown));
            }
            Report::Heartbeat { .. } => {}
            Report::WrongVersion { ours, theirs } => {
                self.wrong_arm(Alarm::WrongVersion { ours, theirs }, now, actions);
            }
            Report::WrongDialect => self.wrong_arm(Alarm::WrongDialect, now, actions),
            Report::Garbage { bytes } => self.counts.add(Cause::GarbageBytes, u64::from(bytes)),
        }
    }

    fn connected(&mut self, session: u32, held_by: HeldBy, now: Timestamp, actions: &mut Actions) {
        if let Some(id) = self.arm.unfinished() {
            self.end_target(id, TargetEnd::Lost, now, actions);
        }
        self.arm.ever_connected = true;
        self.arm.silent_at = None;
        self.arm.session = session;
        self.arm.sequence = 0;
        self.arm.says_clear = false;
        actions.say(Note::Connected { session });
        self.place.ask(now, actions);
        self.held(held_by, now, actions);
        if matches!(self.phase, Phase::Stopping(_)) {
            actions.push(Action::Arm(Command::Hold));
        }
    }

    fn held(&mut self, by: HeldBy, now: Timestamp, actions: &mut Actions) {
        let was_held = self.arm.link == Link::Held && !self.arm.hold_unconfirmed;
        self.arm.link = Link::Held;
        self.arm.hold_unconfirmed = false;
        self.arm.not_ready();
        if let Some(target) = &mut self.arm.unfinished {
            // It ends as failed or lost; a link that forgets to say so is not waited for very long.
            target.until = target.until.min(Timestamp(now.0.saturating_add(1_000_000_000)));
        }
        let of_itself = match by {
            HeldBy::Start | HeldBy::ControllerReset | HeldBy::HeartbeatLost | HeldBy::LinkLost => true,
            HeldBy::Command | HeldBy::Alarm | HeldBy::Operator | HeldBy::RecordingOver => false,
        };
        self.arm.held_by_operator |= by == HeldBy::Operator;
        if of_itself && !self.manual() && !self.arm.held_by_operator {
            self.arm.release_wanted = true;
        } else if !was_held && !self.arm.release_wanted && self.phase == Phase::Running {
            actions.say(Note::Alarm(Alarm::OnHold { by }));
        }
    }

    fn arm_gone(&mut self, now: Timestamp, actions: &mut Actions) {
        if let Some(id) = self.arm.unfinished() {
            self.end_target(id, TargetEnd::Lost, now, actions);
        }
        self.counts.add(Cause::ArmLost, 1);
        self.arm.link = Link::Absent;
        self.arm.hold_unconfirmed = false;
        self.arm.release_wanted = false;
        self.arm.not_ready();
        self.place.arm_lost();
    }

    /// After a suspend nothing is known of the arm: its heartbeat stopped, it went on to the end of its move or holds, and
    /// reports are gone. It is told to hold, and a new session begins. Hours may have passed and hands be in the cell: it
    /// moves on the operator's word only, whatever `resume` says.
    pub(super) fn arm_was_suspended(&mut self, now: Timestamp, actions: &mut Actions) {
        if matches!(self.phase, Phase::Stopping(_) | Phase::Ended) {
            return;
        }
        self.arm.held_by_operator = true;
        self.arm.release_wanted = false;
        let still_awaited = self.arm.silent_at.is_some();
        self.arm.silent_at = still_awaited.then_some(Timestamp(now.0.saturating_add(SILENT_NS)));
        if self.arm.is_connected() {
            actions.push(Action::Arm(Command::Hold));
            actions.push(Action::Arm(Command::Hello));
            self.arm_gone(now, actions);
        }
    }

    fn wrong_arm(&mut self, alarm: Alarm, now: Timestamp, actions: &mut Actions) {
        actions.say(Note::Alarm(alarm));
        if self.arm.ever_connected {
            self.arm_gone(now, actions);
        } else {
            self.end(Ending::WrongArm, now, actions);
        }
    }

    fn arm_ready(&mut self, clear_of_view: bool, now: Timestamp, actions: &mut Actions) {
        // On hold, or with a target under way, it was said before the arm heard of that.
        if !matches!(self.arm.link, Link::Releasing(_) | Link::Released) || self.arm.unfinished.is_some() {
            return;
        }
        let was_ready = std::mem::replace(&mut self.arm.ready, true);
        if !was_ready {
            actions.say(Note::Ready);
        }
        self.arm.link = Link::Released;
        let dwell_ms = self.settings.arm.clear_dwell_ms;
        if clear_of_view {
            self.arm.says_clear = true;
            // From here on and not from when it came out of the view: no link's gate counts from later.
            self.arm.clear_since = Some(now);
            self.arm.dwell_until = None;
        } else if self.arm.says_clear {
            self.arm.clear_since = None;
            self.arm.dwell_until = None;
        } else if !was_ready {
            self.arm.clear_since = None;
            self.arm.dwell_until = Some(Timestamp(now.0.saturating_add(i64::from(dwell_ms) * 1_000_000)));
        }
    }

    fn sent(&mut self, id: u64, at_ns: i64, actions: &mut Actions) {
        let Some(target) = self.arm.unfinished.filter(|target| target.id == id) else {
            self.counts.add(Cause::StrayReports, 1);
            return;
        };
        self.arm.stage(id, State::Sent);
        let frame_to_wire_ns = at_ns.saturating_sub(target.seen_ns);
        let deadline_kept = frame_to_wire_ns <= self.params.deadline_ns;
        self.counts.add(Cause::Sent, 1);
        self.counts.add(Cause::SentLate, u64::from(!deadline_kept));
        actions.say(Note::Sent { id, frame_to_wire_ns, deadline_kept });
    }

    pub(super) fn end_target(&mut self, id: u64, end: TargetEnd, now: Timestamp, actions: &mut Actions) {
        let Some(target) = self.arm.unfinished.filter(|target| target.id == id) else {
            self.counts.add(Cause::StrayReports, 1);
            return;
        };
        self.arm.unfinished = None;
        self.arm.ended_at = now;
        self.counts.add(
            match end {
                TargetEnd::Done => Cause::Done,
                TargetEnd::Failed(_) => Cause::Failed,
                TargetEnd::Refused(_) => Cause::Refused,
                TargetEnd::Lost => Cause::Lost,
                TargetEnd::Abandoned => Cause::Abandoned,
            },
            1,
        );
        actions.say(Note::Ended { id, end });
        self.place.target_ended(end, actions);
        let failures = match end {
            TargetEnd::Failed(Failure::PartNotHeld | Failure::TimedOut | Failure::Controller { .. }) => {
                target.failures_before + 1
            }
            TargetEnd::Refused(refusal) if Self::blames_part(&refusal) => self.settings.arm.retries + 1,
            _ => return,
        };
        let until = Timestamp(now.0.saturating_add(self.params.defer_ns));
        let same_part_mm = self.params.same_part_mm;
        self.tried.failed(target.part, target.filed_mm, failures, same_part_mm, (now, until));
    }

    pub(super) fn operator(&mut self, operator: Operator, now: Timestamp, actions: &mut Actions) {
        match operator {
            Operator::Hold => {
                self.arm.held_by_operator = true;
                if self.arm.is_connected() {
                    actions.push(Action::Arm(Command::Hold));
                    self.arm.await_hold();
                }
            }
            Operator::Release => {
                self.tried.clear();
                let was_full = self.place.is_full();
                self.place.start_over();
                self.arm.held_by_operator = false;
                match self.arm.link {
                    Link::Held => self.arm.release_wanted = true,
                    Link::Alarmed => {
                        self.arm.release_wanted = true;
                        actions.push(Action::Arm(Command::Unlock));
                    }
                    _ if was_full => {}
                    _ => actions.say(Note::Alarm(Alarm::NothingToRelease)),
                }
            }
        }
        self.arm_time_passes(now, actions);
    }

    pub(super) fn arm_time_passes(&mut self, now: Timestamp, actions: &mut Actions) {
        if let Some(target) = self.arm.unfinished.filter(|target| now >= target.until) {
            actions.say(Note::Alarm(Alarm::TargetTimedOut { id: target.id }));
            actions.push(Action::Arm(Command::Hold));
            actions.push(Action::Arm(Command::Hello));
            self.arm_gone(now, actions);
        }
        if self.arm.dwell_until.is_some_and(|until| now >= until) {
            self.arm.clear_since = self.arm.dwell_until.take();
        }
        self.place.time_passes(now, actions);
        if matches!(self.arm.link, Link::Releasing(until) if now >= until) {
            actions.push(Action::Arm(Command::Hold));
            self.arm.await_hold();
        }
        if self.arm.silent_at.is_some_and(|at| now >= at) {
            self.arm.silent_at = None;
            actions.say(Note::Alarm(Alarm::ArmSilent));
        }
        if matches!(self.phase, Phase::Stopping(_) | Phase::Ended) {
            return;
        }
        self.release_if_wanted(now, actions);
        if self.arm.state() == State::Looking && self.place.reserve(self.arm.next_id, actions) {
            self.arm.next_id += 1;
        }
    }

    fn release_if_wanted(&mut self, now: Timestamp, actions: &mut Actions) {
        let arm = &mut self.arm;
        let at_rest = arm.link == Link::Held && !arm.hold_unconfirmed && arm.unfinished.is_none();
        if !(arm.release_wanted && at_rest) || self.place.in_question() {
            return;
        }
        arm.release_wanted = false;
        arm.link = Link::Releasing(Timestamp(now.0.saturating_add(STARTING_NS)));
        actions.push(Action::Arm(Command::Release));
        actions.say(Note::Released);
    }
}
