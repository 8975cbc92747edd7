//! The place pattern: which slot is next, and the record of it that survives a crash.
//!
//! A slot is reserved on disk, together with the number of the target that may fill it, before that target is sent;
//! the reservation is made ahead, while the arm gets ready, so that no target waits for the disk. After a crash the
//! arm is asked what became of the target. Where it cannot tell, the slot is left out: rather a gap in the tray than
//! two parts in one slot.

use firmware_bridge::message::{Command, Failure, Outcome, Pose};

use super::PlacePattern;
use super::action::{Action, Actions, Alarm, Note, TargetEnd};
use super::event::PlaceRecord;
use crate::time::Timestamp;

/// How long an answer about an unfinished target is waited for, how long before an arm that is at it is asked again, and how
/// long before a record is written again, ns.
const PATIENCE_NS: i64 = 1_000_000_000;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Reservation {
    /// Nothing on disk allows a target.
    None,
    /// On its way to the disk.
    Writing,
    /// The disk refused; tried again then.
    Refused(Timestamp),
    /// On disk.
    Made,
    /// The target's end is not known; the arm has to be asked.
    InQuestion,
    /// It was asked; no answer until then means that it cannot tell.
    Asked(Timestamp),
    /// It is still at it; asked again then.
    Unfinished(Timestamp),
}

#[derive(Clone, Debug)]
pub(super) struct Place {
    pattern: Option<PlacePattern>,
    record: PlaceRecord,
    reservation: Reservation,
    full_was_said: bool,
    refusal_was_said: bool,
}

impl Place {
    pub(super) fn new(pattern: Option<PlacePattern>, record: PlaceRecord) -> Self {
        let in_question = pattern.is_some() && record.unfinished_id != 0;
        let reservation = if in_question { Reservation::InQuestion } else { Reservation::None };
        Self { pattern, record, reservation, full_was_said: false, refusal_was_said: false }
    }

    fn slots(&self) -> u32 {
        self.pattern.map_or(0, |p| p.columns.saturating_mul(p.rows))
    }

    /// Every slot is used up.
    pub(super) fn is_full(&self) -> bool {
        self.pattern.is_some() && self.record.next_slot >= self.slots() && !self.in_question()
    }

    /// What became of a target has to be found out before anything is released.
    pub(super) fn in_question(&self) -> bool {
        use Reservation::{Asked, InQuestion, Unfinished};
        matches!(self.reservation, InQuestion | Asked(_) | Unfinished(_))
    }

    /// The target number, slot and tool pose that may be used now; `fallback` where there is no pattern.
    pub(super) fn slot(&self, next_id: u64, fallback: Pose) -> Option<(u64, u32, Pose)> {
        let Some(pattern) = self.pattern else { return Some((next_id, 0, fallback)) };
        if self.reservation != Reservation::Made {
            return None;
        }
        let slot = self.record.next_slot;
        let (row, column) = (f64::from(slot / pattern.columns), f64::from(slot % pattern.columns));
        let mut pose = pattern.first;
        for axis in 0..3 {
            pose.position_mm[axis] += column * pattern.column_step_mm[axis] + row * pattern.row_step_mm[axis];
        }
        Some((self.record.unfinished_id, slot, pose))
    }

    /// Puts a reservation for the target `next_id` on its way to the disk where one is due; whether it took the
    /// number.
    pub(super) fn reserve(&mut self, next_id: u64, actions: &mut Actions) -> bool {
        if self.reservation != Reservation::None {
            return false;
        }
        if self.pattern.is_none() || self.is_full() {
            if self.is_full() && !std::mem::replace(&mut self.full_was_said, true) {
                actions.say(Note::Alarm(Alarm::PlaceFull));
            }
            return false;
        }
        self.record.unfinished_id = next_id;
        self.record.next_id = next_id + 1;
        self.write(Reservation::Writing, actions);
        true
    }

    fn write(&mut self, reservation: Reservation, actions: &mut Actions) {
        self.reservation = reservation;
        actions.push(Action::Persist(self.record));
    }

    pub(super) fn persisted(&mut self, record: PlaceRecord) {
        if record == self.record && self.reservation == Reservation::Writing {
            self.reservation = Reservation::Made;
            self.refusal_was_said = false;
        }
    }

    pub(super) fn not_persisted(&mut self, now: Timestamp, actions: &mut Actions) {
        if self.reservation == Reservation::Writing {
            self.reservation = Reservation::Refused(Timestamp(now.0.saturating_add(PATIENCE_NS)));
            if !std::mem::replace(&mut self.refusal_was_said, true) {
                actions.say(Note::Alarm(Alarm::PlaceNotSaved));
            }
        }
    }

    /// A target that had the slot is over.
    pub(super) fn target_ended(&mut self, end: TargetEnd, actions: &mut Actions) {
        if self.pattern.is_none() {
            return;
        }
        match end {
            TargetEnd::Done => self.fill(actions),
            TargetEnd::Refused(_) | TargetEnd::Failed(Failure::PartNotHeld) => self.free(),
            TargetEnd::Failed(_) => self.leave_out(actions),
            TargetEnd::Lost | TargetEnd::Abandoned => self.reservation = Reservation::InQuestion,
        }
    }

    /// The arm can be asked now.
    pub(super) fn ask(&mut self, now: Timestamp, actions: &mut Actions) {
        if self.in_question() {
            self.reservation = Reservation::Asked(Timestamp(now.0.saturating_add(PATIENCE_NS)));
            actions.push(Action::Arm(Command::Query { id: self.record.unfinished_id }));
        }
    }

    /// The arm is gone; it will be asked when it is back.
    pub(super) fn arm_lost(&mut self) {
        if self.in_question() {
            self.reservation = Reservation::InQuestion;
        }
    }

    /// The arm's answer.
    pub(super) fn answered(&mut self, id: u64, outcome: Outcome, now: Timestamp, actions: &mut Actions) {
        if !self.in_question() || id != self.record.unfinished_id {
            return;
        }
        match outcome {
            Outcome::Done => self.fill(actions),
            Outcome::Failed | Outcome::Unknown => self.leave_out(actions),
            Outcome::Refused => self.free(),
            Outcome::Unfinished => {
                self.reservation = Reservation::Unfinished(Timestamp(now.0.saturating_add(PATIENCE_NS)));
            }
        }
    }

    pub(super) fn time_passes(&mut self, now: Timestamp, actions: &mut Actions) {
        match self.reservation {
            Reservation::Asked(until) if now >= until => self.leave_out(actions),
            Reservation::Unfinished(again) if now >= again => self.ask(now, actions),
            Reservation::Refused(again) if now >= again => self.free(),
            _ => {}
        }
    }

    pub(super) fn next_tick(&self) -> Option<Timestamp> {
        match self.reservation {
            Reservation::Asked(at) | Reservation::Unfinished(at) | Reservation::Refused(at) => Some(at),
            _ => None,
        }
    }

    /// The operator has emptied a full tray, of which he was told; after a restart he is told by the first release.
    pub(super) fn start_over(&mut self) {
        if self.is_full() && self.full_was_said {
            self.record.next_slot = 0;
            self.full_was_said = false;
            self.free();
        }
    }

    /// The cell ends with nothing under way: the reserved slot is free.
    pub(super) fn give_up_reservation(&mut self, actions: &mut Actions) {
        if matches!(self.reservation, Reservation::Made | Reservation::Writing) {
            self.record.unfinished_id = 0;
            self.write(Reservation::None, actions);
        }
    }

    fn fill(&mut self, actions: &mut Actions) {
        actions.say(Note::SlotFilled { slot: self.record.next_slot });
        self.record.next_slot += 1;
        self.record.unfinished_id = 0;
        // Also where the tray is full now and no reservation follows.
        self.write(Reservation::None, actions);
    }

    fn leave_out(&mut self, actions: &mut Actions) {
        actions.say(Note::Alarm(Alarm::SlotLeftOut { slot: self.record.next_slot }));
        self.record.next_slot += 1;
        self.record.unfinished_id = 0;
        self.write(Reservation::None, actions);
    }

    fn free(&mut self) {
        self.record.unfinished_id = 0;
        self.reservation = Reservation::None;
    }
}
