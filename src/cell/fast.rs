//! A session played as fast as possible, on the session's own time: one thread, every pair, the same every time.
//!
//! The clock of the cell stands still while a pair is recognised and jumps from one pair to the next; the simulated
//! arm lives on the same clock. So nothing depends on the machine: neither which pairs are recognised, nor which of
//! them lead to a target.

use std::time::Duration;

use super::carrier::Carrier;
use super::core::Ending;
use super::desk::{GrabSeat, Letter, Work};
use super::notify::Watchdog;
use super::recogniser::recognise;
use crate::camera::{Camera, Condition, Grab, Side};
use crate::frame::Frame;
use crate::recognize::Recognizer;
use crate::time::Timestamp;

/// Turns of the arm between two pairs, at most: a simulated arm that asks for more stands still.
const TURNS_MAX: usize = 100_000;

/// A session that does not wait for the clock.
pub struct Fast<'a> {
    /// Where the frames come from and go to.
    pub grabs: [GrabSeat; 2],
    /// Both sides of the session, which give a frame at every grab.
    pub cameras: [Camera; 2],
    /// Wakes the sides.
    pub next: &'a dyn Fn(),
    /// From one pair to the next, where nothing else is planned.
    pub period: Duration,
    /// When they are played.
    pub schedule: Schedule,
    /// The recogniser.
    pub recognizer: Recognizer,
    /// Grasps are given in the robot's base.
    pub in_base: bool,
    /// The core and the arm.
    pub carrier: Carrier<'a>,
    /// When the session begins.
    pub start: Timestamp,
}

/// When the pairs of a session are played.
#[derive(Clone, Debug, Default)]
pub struct Schedule {
    /// By the numbers of their frames.
    pub pairs: Vec<Moment>,
    /// From the start to the first of them.
    pub lead: Duration,
}

/// When a pair is played.
#[derive(Clone, Copy, Debug, Default)]
pub struct Moment {
    /// After the first pair, ns.
    pub seen_ns: i64,
    /// So long after it was seen its result is there, ns.
    pub decided_after_ns: i64,
}

/// What a side has.
enum Grabbed {
    Frame(Frame, Condition, u32),
    Nothing,
    Ended,
}

impl Fast<'_> {
    /// Plays it all; `asked_to_stop` is looked at between pairs, `cold` works off the papers.
    pub fn run(mut self, asked_to_stop: impl Fn() -> bool, mut cold: impl FnMut()) -> Ending {
        let mut now = self.start;
        let mut watchdog = Watchdog::from_environment();
        loop {
            watchdog.kick(Timestamp::now());
            let grabbed = Side::BOTH.map(|side| self.grab(side));
            (self.next)();
            let moment = grabbed.iter().find_map(|grabbed| self.moment(grabbed));
            let begin = self.start.after(self.schedule.lead);
            let after_ns = |moment: Moment| Timestamp(begin.0.saturating_add(moment.seen_ns));
            let seen = moment.map_or(now.after(self.period), after_ns);
            now = self.live_until(now, seen, &mut cold);
            if asked_to_stop() {
                self.carrier.event(&super::core::Event::Stop, now);
                break;
            }
            let is_over = grabbed.iter().all(|grabbed| matches!(grabbed, Grabbed::Ended));
            for (side, grabbed) in Side::BOTH.into_iter().zip(grabbed) {
                self.hand_over(side, grabbed, seen, now);
            }
            let decided = Timestamp(seen.0.saturating_add(moment.unwrap_or_default().decided_after_ns));
            now = self.recognise(now, decided, &mut cold);
            self.clear_desk(now, &mut cold);
            if is_over {
                break;
            }
        }
        // What is under way ends, or its time does.
        while self.carrier.ending().is_none() {
            let then = now.after(self.period);
            now = self.live_until(now, then, &mut cold);
        }
        self.clear_desk(now, &mut cold);
        self.carrier.ending().unwrap_or(Ending::Done)
    }

    fn moment(&self, grabbed: &Grabbed) -> Option<Moment> {
        match grabbed {
            Grabbed::Frame(frame, Condition::Good, _) => {
                self.schedule.pairs.get(frame.sequence as usize).copied()
            }
            _ => None,
        }
    }

    /// Lets the arm and the core live until `until`, if that is still to come.
    fn live_until(&mut self, now: Timestamp, until: Timestamp, cold: &mut impl FnMut()) -> Timestamp {
        let (mut now, until) = (now, until.max(now));
        self.carrier.turn(now);
        for _ in 0..TURNS_MAX {
            self.clear_desk(now, cold);
            match self.carrier.next_turn() {
                Some(turn) if turn < until && self.carrier.ending().is_none() => now = now.max(turn),
                _ => break,
            }
            self.carrier.turn(now);
        }
        self.carrier.turn(until);
        until
    }

    /// Takes a side's next frame.
    fn grab(&mut self, side: Side) -> Grabbed {
        let Ok(mut frame) = self.grabs[side.index()].free.pop() else { return Grabbed::Nothing };
        match self.cameras[side.index()].grab(&mut frame, Duration::ZERO) {
            Grab::Frame { condition, skipped } => Grabbed::Frame(frame, condition, skipped),
            Grab::Ended => {
                self.carrier.give(side, frame);
                Grabbed::Ended
            }
            _ => Grabbed::Frame(frame, Condition::Damaged, 0),
        }
    }

    fn hand_over(&mut self, side: Side, grabbed: Grabbed, seen: Timestamp, now: Timestamp) {
        match grabbed {
            Grabbed::Frame(frame, condition, skipped) => {
                let frame = Frame { timestamp: seen, ..frame };
                self.carrier.letter(Letter::Frame(side, frame, condition, skipped), now);
            }
            Grabbed::Ended => self.carrier.letter(Letter::Ended(side), now),
            Grabbed::Nothing => {}
        }
    }

    /// Recognises what is ordered; the result is there when the recorded cell had decided, else at once.
    fn recognise(&mut self, now: Timestamp, decided: Timestamp, cold: &mut impl FnMut()) -> Timestamp {
        let mut now = now;
        while let Some(mut work) = self.carrier.take_work() {
            let found = recognise(&mut self.recognizer, &mut work, self.in_base);
            let Work { job, mut file } = work;
            // Told on the session's time, as if it had begun when the pair was there.
            let took_ns = file.finished.since(file.begun);
            (file.begun, file.finished) = (now, Timestamp(now.0 + took_ns));
            if decided > now {
                now = self.live_until(now, decided, cold);
            }
            self.carrier.letter(Letter::Recognised(job.pair.number, found, file), now);
        }
        now
    }

    fn clear_desk(&mut self, now: Timestamp, cold: &mut impl FnMut()) {
        cold();
        while let Some(letter) = self.carrier.next_letter() {
            self.carrier.letter(letter, now);
        }
    }
}
