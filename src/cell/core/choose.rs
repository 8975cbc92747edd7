//! From what was found to one target, or the reason why there is none.

use firmware_bridge::message::{Command, Pick, Pose, Refusal, Seen};

use super::action::{Action, Actions, Alarm, NoPick, Note, TargetSent};
use super::arm::STOPPING_NS;
use super::count::Cause;
use super::event::{Candidate, Found, Nothing};
use super::{Core, Phase, State};
use crate::cell::pairing::Pair;
use crate::time::Timestamp;

/// Parts that are remembered because their targets failed.
const TRIED_MAX: usize = 16;

#[derive(Clone, Copy, Debug)]
struct Attempt {
    part: u16,
    position_mm: [f64; 3],
    failures: u32,
    until: Timestamp,
}

/// Parts whose targets failed, by where they lay.
#[derive(Clone, Debug)]
pub(super) struct Tried {
    attempts: [Option<Attempt>; TRIED_MAX],
    /// It was said that nothing else is left.
    pub(super) said: bool,
}

impl Tried {
    pub(super) fn new() -> Self {
        Self { attempts: [None; TRIED_MAX], said: false }
    }

    pub(super) fn clear(&mut self) {
        *self = Self::new();
    }

    fn find(&self, part: u16, position_mm: [f64; 3], same_part_mm: f64, now: Timestamp) -> Option<usize> {
        let near = |a: &Attempt| {
            let square: f64 = a.position_mm.iter().zip(position_mm).map(|(p, q)| (p - q) * (p - q)).sum();
            a.part == part && now < a.until && square <= same_part_mm * same_part_mm
        };
        self.attempts.iter().position(|attempt| attempt.as_ref().is_some_and(near))
    }

    /// How often the part at this place has failed.
    pub(super) fn failures(
        &self,
        part: u16,
        position_mm: [f64; 3],
        same_part_mm: f64,
        now: Timestamp,
    ) -> u32 {
        let found = self.find(part, position_mm, same_part_mm, now);
        found.and_then(|i| self.attempts[i]).map_or(0, |attempt| attempt.failures)
    }

    /// Remembers a failure until `until`, in the place of the oldest where there is no room.
    pub(super) fn failed(
        &mut self,
        part: u16,
        position_mm: [f64; 3],
        failures: u32,
        same_part_mm: f64,
        (now, until): (Timestamp, Timestamp),
    ) {
        let slot = self.find(part, position_mm, same_part_mm, now).unwrap_or_else(|| {
            let age = |i: &usize| self.attempts[*i].map_or(i64::MIN, |attempt| attempt.until.0);
            (0..TRIED_MAX).min_by_key(age).unwrap_or(0)
        });
        self.attempts[slot] = Some(Attempt { part, position_mm, failures, until });
    }
}

impl Core {
    /// The target that this result leads to, ordered, or why there is none.
    pub(super) fn decide(
        &mut self,
        pair: &Pair,
        found: &Found,
        now: Timestamp,
        actions: &mut Actions,
    ) -> Result<TargetSent, NoPick> {
        if now.since(pair.earliest()) > self.params.deadline_ns {
            return Err(NoPick::Late);
        }
        if found.candidates().is_empty() {
            return Err(NoPick::Nothing(found.nothing.unwrap_or(Nothing::NothingRecognised)));
        }
        self.may_send(pair)?;
        let mut refused = None;
        for (i, candidate) in found.candidates().iter().enumerate() {
            let failures =
                self.tried.failures(candidate.part, candidate.filed_mm(), self.params.same_part_mm, now);
            if failures > self.settings.arm.retries {
                continue;
            }
            let pick = self.pick(pair, candidate).ok_or(NoPick::SlotNotSaved)?;
            match self.gate.check(&pick, now.0, self.arm.not_before().0) {
                Ok(()) => {
                    self.order(pick, candidate, failures, now, actions);
                    return Ok(TargetSent { id: pick.id, candidate: i as u8 });
                }
                Err(refusal) => {
                    self.counts.add(Cause::GateRefused, 1);
                    refused = refused.or(Some(refusal));
                }
            }
        }
        match refused {
            Some(refusal) => Err(NoPick::Gate(refusal)),
            None => {
                if !std::mem::replace(&mut self.tried.said, true) {
                    actions.say(Note::Alarm(Alarm::AllDeferred));
                }
                Err(NoPick::AllDeferred)
            }
        }
    }

    /// Whether a target may be sent at all because of this pair.
    fn may_send(&self, pair: &Pair) -> Result<(), NoPick> {
        if matches!(self.phase, Phase::Stopping(_) | Phase::Ended) {
            return Err(NoPick::Stopping);
        }
        match self.arm.state() {
            State::Looking => {}
            State::Absent => return Err(NoPick::ArmAbsent),
            State::Held => return Err(NoPick::OnHold),
            State::Alarmed => return Err(NoPick::InAlarm),
            State::Releasing => return Err(NoPick::ArmNotReady),
            State::Stopping => return Err(NoPick::Stopping),
            State::Ordered | State::Sent | State::Accepted | State::Moving => return Err(NoPick::ArmBusy),
        }
        if self.place.is_full() {
            return Err(NoPick::PlaceFull);
        }
        let taken = self.taken_from(&pair.left).min(self.taken_from(&pair.right));
        if !self.arm.is_clear() || taken <= self.arm.not_before() {
            return Err(NoPick::NotClear);
        }
        Ok(())
    }

    /// `None` while the slot it would need is not on disk.
    fn pick(&self, pair: &Pair, candidate: &Candidate) -> Option<Pick> {
        let gripper = &self.settings.gripper;
        let grasp = candidate.grasp.0;
        let [x, y, z] = grasp.position_mm;
        let away = grasp.approach().map(|v| -v * gripper.approach_mm);
        let approach = Pose { position_mm: [x + away[0], y + away[1], z + away[2]], ..grasp };
        let retreat = Pose { position_mm: [x, y, z + gripper.retreat_mm], ..grasp };
        let (id, slot, place) = self.place.slot(self.arm.next_id(), retreat)?;
        let (session, sequence) = self.arm.next_sequence();
        Some(Pick {
            id,
            session,
            sequence,
            seen: Seen {
                left_ns: pair.left.timestamp.0,
                right_ns: pair.right.timestamp.0,
                period_ns: self.params.period_ns,
            },
            // Rounded up: the core itself counts in nanoseconds, the gate on the other side in milliseconds.
            deadline_ms: u32::try_from(
                self.params.deadline_ns / 1_000_000 + i64::from(self.params.deadline_ns % 1_000_000 > 0),
            )
            .unwrap_or(u32::MAX),
            ttl_ms: self.params.ttl_ms,
            recognised_mm: grasp.position_mm,
            approach,
            grasp,
            retreat,
            place,
            opening_mm: candidate.opening_mm,
            slot,
        })
    }

    fn order(
        &mut self,
        pick: Pick,
        candidate: &Candidate,
        failures: u32,
        now: Timestamp,
        actions: &mut Actions,
    ) {
        self.tried.said = false;
        self.counts.add(Cause::Ordered, 1);
        let timeout_ns = i64::from(self.settings.arm.pick_timeout_ms) * 1_000_000;
        let until = Timestamp(now.0.saturating_add(timeout_ns + STOPPING_NS));
        self.arm.order(&pick, candidate, failures, until);
        actions.push(Action::Arm(Command::Pick(pick)));
    }

    /// Whether this refusal speaks against the part itself, so that trying it again is of no use.
    pub(super) fn blames_part(refusal: &Refusal) -> bool {
        matches!(
            refusal,
            Refusal::NotFinite { .. }
                | Refusal::OutsideWorkspace { .. }
                | Refusal::Tilted { .. }
                | Refusal::Jump { .. }
                | Refusal::Axes { .. }
                | Refusal::Opening { .. }
                | Refusal::Unreachable
                | Refusal::ByArm { .. }
        )
    }
}
