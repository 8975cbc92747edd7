//! The cameras as the core sees them: frames and what is missing between them, silence, pairs.

use super::action::{Action, Actions, Alarm, Note};
use super::{Cause, Core, NoPick, Phase};
use crate::camera::{Condition, Side};
use crate::cell::pairing::FrameSeen;
use crate::time::Timestamp;

/// So many frames in a row without a partner, both cameras delivering, are out of step.
const OUT_OF_STEP_FRAMES: u32 = 10;

/// One of them.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct CameraState {
    /// When its last frame came.
    pub(super) last_arrival: Option<Timestamp>,
    /// That frame's time stamp and number.
    pub(super) last_frame: Option<(Timestamp, u32)>,
    /// Why it gives nothing, as was last said.
    pub(super) lost: Option<Alarm>,
    /// A session that is over.
    pub(super) ended: bool,
}

impl Core {
    pub(super) fn lose_camera(&mut self, side: Side, alarm: Alarm, actions: &mut Actions) {
        let camera = &mut self.cameras[side.index()];
        let said = camera.lost;
        if said.is_none() {
            camera.last_frame = None;
            self.counts.add(Cause::CameraLost, 1);
        }
        // What the camera says itself tells more than its silence, whichever came first.
        let is_news = match alarm {
            Alarm::CameraSilent { .. } => said.is_none(),
            _ => said != Some(alarm),
        };
        if is_news {
            camera.lost = Some(alarm);
            actions.say(Note::Alarm(alarm));
        }
        if let Some(handle) = self.pairing.forget(side) {
            actions.push(Action::Free(handle));
        }
    }

    /// The machine was suspended. Frames of before are old on the cell's clock, and so is what rests on them; here is what
    /// would wait for them, and the arm.
    pub(super) fn suspended(&mut self, for_ns: i64, now: Timestamp, actions: &mut Actions) {
        let seconds = for_ns.max(0).unsigned_abs().div_ceil(1_000_000_000);
        actions.say(Note::Alarm(Alarm::Suspended { seconds }));
        for side in Side::BOTH {
            // Neither silence nor a gap: nobody took pictures.
            let camera = &mut self.cameras[side.index()];
            (camera.last_arrival, camera.last_frame) = (Some(now), None);
            if let Some(handle) = self.pairing.forget(side) {
                self.counts.add(Cause::Unpaired, 1);
                actions.push(Action::Free(handle));
            }
        }
        self.arm_was_suspended(now, actions);
    }

    pub(super) fn camera_is_back(&mut self, side: Side, actions: &mut Actions) {
        if self.cameras[side.index()].lost.take().is_some() {
            actions.say(Note::CameraBack { side });
        }
    }

    pub(super) fn camera_ended(&mut self, side: Side, now: Timestamp, actions: &mut Actions) {
        self.cameras[side.index()].ended = true;
        if self.cameras.iter().all(|camera| camera.ended) && self.phase == Phase::Running {
            let pick_ns = i64::from(self.settings.arm.pick_timeout_ms) * 1_000_000;
            self.phase = Phase::Draining(Timestamp(now.0.saturating_add(pick_ns)));
            for side in Side::BOTH {
                if let Some(handle) = self.pairing.forget(side) {
                    self.counts.add(Cause::Unpaired, 1);
                    actions.push(Action::Free(handle));
                }
            }
        }
    }

    pub(super) fn frame(&mut self, frame: FrameSeen, now: Timestamp, actions: &mut Actions) {
        self.counts.add(Cause::Frames, 1);
        self.counts.add(Cause::Skipped, u64::from(frame.skipped));
        self.camera_is_back(frame.side, actions);
        self.count_missing(&frame);
        let camera = &mut self.cameras[frame.side.index()];
        camera.last_arrival = Some(now);
        camera.last_frame = Some((frame.timestamp, frame.sequence));
        let future = frame.timestamp.since(now) > self.params.period_ns;
        let bad = match frame.condition {
            Condition::Damaged => Some(Cause::Damaged),
            Condition::Short => Some(Cause::Short),
            Condition::Good => future.then_some(Cause::Future),
        };
        let stopping = matches!(self.phase, Phase::Stopping(_));
        if let Some(cause) = bad {
            self.counts.add(cause, 1);
        }
        if bad.is_some() || stopping {
            actions.push(Action::Free(frame.handle));
            return;
        }
        self.pair_up(frame, now, actions);
    }

    /// Counts the frames between this one and the last of its side.
    fn count_missing(&mut self, frame: &FrameSeen) {
        let Some((timestamp, sequence)) = self.cameras[frame.side.index()].last_frame else { return };
        let steps = frame.sequence.wrapping_sub(sequence);
        // A driver that was opened anew counts from 0 again; that is no gap.
        let gap = match steps {
            1..=1000 => u64::from(steps - 1).saturating_sub(u64::from(frame.skipped)),
            _ => 0,
        };
        self.counts.add(Cause::Gap, gap);
        let periods =
            (frame.timestamp.since(timestamp) + self.params.period_ns / 2) / self.params.period_ns.max(1);
        let missing = u64::try_from(periods - 1).unwrap_or(0);
        self.counts.add(Cause::Missing, missing.saturating_sub(gap + u64::from(frame.skipped)));
    }

    fn pair_up(&mut self, frame: FrameSeen, now: Timestamp, actions: &mut Actions) {
        let paired = self.pairing.run(frame);
        if let Some(handle) = paired.superseded {
            self.counts.add(Cause::Unpaired, 1);
            actions.push(Action::Free(handle));
        }
        if let Some((handle, skew_ns)) = paired.out_of_step {
            self.counts.add(Cause::OutOfStep, 1);
            actions.push(Action::Free(handle));
            self.alone_in_a_row = self.alone_in_a_row.saturating_add(1);
            if self.alone_in_a_row == OUT_OF_STEP_FRAMES {
                actions.say(Note::Alarm(Alarm::CamerasOutOfStep { skew_us: skew_ns / 1000 }));
            }
        }
        let Some(pair) = paired.pair else { return };
        self.alone_in_a_row = 0;
        self.counts.add(Cause::Pairs, 1);
        if self.searching.is_none() {
            self.search(pair, actions);
        } else if let Some(older) = self.waiting.replace(pair) {
            self.counts.add(Cause::Superseded, 1);
            self.finish_pair(&older, now, Err(NoPick::Superseded), actions);
        }
    }
}
