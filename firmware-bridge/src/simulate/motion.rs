//! The mechanics under a simulated firmware: straight moves with trapezoidal speed, a queue of them, a hold that
//! decelerates, a kill that does not.
//!
//! Takes targets in the base frame and the time; gives where the arm is, and what happened ([`Motion`]).

use super::Motion;
use crate::message::distance_mm;
use std::collections::VecDeque;

const S_NS: f64 = 1e9;

/// A planned move.
#[derive(Clone, Copy, Debug)]
struct Block {
    to_mm: [f64; 3],
    speed_mm_s: f64,
}

/// The move under way.
#[derive(Clone, Copy, Debug)]
struct Active {
    from_mm: [f64; 3],
    block: Block,
    length_mm: f64,
    peak_mm_s: f64,
    begin_ns: i64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Mode {
    /// Blocks wait for `start`.
    Waiting,
    Running,
    /// Decelerating since then, from this way along the block at this speed.
    Stopping {
        since_ns: i64,
        way_mm: f64,
        speed_mm_s: f64,
    },
    /// Stopped by a hold; the rest of the move is kept.
    Held,
}

/// An arm with a planner.
#[derive(Clone, Debug)]
pub(crate) struct Mechanics {
    /// At rest, or at the begin of the active move.
    position_mm: [f64; 3],
    queue: VecDeque<Block>,
    active: Option<Active>,
    mode: Mode,
    acceleration_mm_s2: f64,
    /// Factor on every speed.
    pub(crate) pace: f64,
    /// What happened, to be polled.
    pub(crate) motions: VecDeque<Motion>,
}

impl Mechanics {
    /// At rest at a point.
    pub(crate) fn new(position_mm: [f64; 3]) -> Self {
        Self {
            position_mm,
            queue: VecDeque::with_capacity(32),
            active: None,
            mode: Mode::Waiting,
            acceleration_mm_s2: 5000.0,
            pace: 1.0,
            motions: VecDeque::with_capacity(64),
        }
    }

    /// Appends a move; it waits for [`Mechanics::start`] unless others are under way.
    pub(crate) fn plan(&mut self, to_mm: [f64; 3], speed_mm_s: f64) {
        let speed_mm_s = (speed_mm_s * self.pace).clamp(0.5, 5000.0);
        self.queue.push_back(Block { to_mm, speed_mm_s });
    }

    /// Begins with the queue, if nothing is under way and no hold is on.
    pub(crate) fn start(&mut self, now_ns: i64) {
        if self.mode == Mode::Waiting && !self.queue.is_empty() {
            self.mode = Mode::Running;
            self.next(now_ns);
        }
    }

    fn next(&mut self, now_ns: i64) {
        let Some(block) = self.queue.pop_front() else {
            self.mode = Mode::Waiting;
            return;
        };
        let length_mm = distance_mm(self.position_mm, block.to_mm);
        let peak_mm_s = block.speed_mm_s.min((length_mm * self.acceleration_mm_s2).sqrt());
        self.active =
            Some(Active { from_mm: self.position_mm, block, length_mm, peak_mm_s, begin_ns: now_ns });
        if length_mm > 0.0 {
            self.motions.push_back(Motion::Began { to_mm: block.to_mm });
        }
    }

    /// Moves that are planned or under way.
    pub(crate) fn blocks(&self) -> usize {
        self.queue.len() + usize::from(self.active.is_some())
    }

    /// Whether it moves, also while a hold decelerates.
    pub(crate) fn is_moving(&self) -> bool {
        matches!(self.mode, Mode::Running | Mode::Stopping { .. })
    }

    /// Whether a hold has come to its end.
    pub(crate) fn is_held(&self) -> bool {
        self.mode == Mode::Held
    }

    /// Decelerates and keeps the rest.
    pub(crate) fn hold(&mut self, now_ns: i64) {
        self.advance(now_ns);
        match (self.mode, &self.active) {
            (Mode::Running, Some(active)) => {
                let (way_mm, speed_mm_s) = self.way(active, now_ns);
                self.mode = Mode::Stopping { since_ns: now_ns, way_mm, speed_mm_s };
            }
            (Mode::Waiting, _) => self.mode = Mode::Held,
            _ => {}
        }
    }

    /// Goes on after a hold, with what is left.
    pub(crate) fn resume(&mut self, now_ns: i64) {
        if self.mode != Mode::Held {
            return;
        }
        if let Some(active) = self.active.take() {
            self.queue.push_front(active.block);
        }
        self.mode = Mode::Waiting;
        self.start(now_ns);
    }

    /// Stops dead and forgets every move; whether it was moving.
    pub(crate) fn kill(&mut self, now_ns: i64) -> bool {
        self.advance(now_ns);
        let moving = self.is_moving();
        self.position_mm = self.position(now_ns);
        self.queue.clear();
        self.active = None;
        self.mode = Mode::Waiting;
        if moving {
            self.motions.push_back(Motion::Stopped { at_mm: self.position_mm });
        }
        moving
    }

    /// Somebody has put the arm here, or the switches were found.
    pub(crate) fn put(&mut self, position_mm: [f64; 3]) {
        self.position_mm = position_mm;
    }

    /// Lets the time pass.
    pub(crate) fn advance(&mut self, now_ns: i64) {
        loop {
            let Some(active) = self.active else { return };
            match self.mode {
                Mode::Running => {
                    let end_ns = active.begin_ns + self.duration_ns(&active);
                    if now_ns < end_ns {
                        return;
                    }
                    self.position_mm = active.block.to_mm;
                    self.active = None;
                    if active.length_mm > 0.0 {
                        self.motions.push_back(Motion::Arrived { at_mm: self.position_mm });
                    }
                    self.next(end_ns);
                }
                Mode::Stopping { since_ns, speed_mm_s, .. } => {
                    let end_ns = since_ns + (speed_mm_s / self.acceleration_mm_s2 * S_NS) as i64;
                    if now_ns < end_ns {
                        return;
                    }
                    self.position_mm = self.position(end_ns);
                    self.mode = Mode::Held;
                    self.motions.push_back(Motion::Stopped { at_mm: self.position_mm });
                    return;
                }
                _ => return,
            }
        }
    }

    /// When something ends by itself.
    pub(crate) fn next_ns(&self) -> Option<i64> {
        let active = self.active.as_ref()?;
        match self.mode {
            Mode::Running => Some(active.begin_ns + self.duration_ns(active)),
            Mode::Stopping { since_ns, speed_mm_s, .. } => {
                Some(since_ns + (speed_mm_s / self.acceleration_mm_s2 * S_NS) as i64)
            }
            _ => None,
        }
    }

    /// Where it is.
    pub(crate) fn position(&self, now_ns: i64) -> [f64; 3] {
        let Some(active) = &self.active else { return self.position_mm };
        let way_mm = match self.mode {
            Mode::Running => self.way(active, now_ns).0,
            Mode::Stopping { since_ns, way_mm, speed_mm_s } => {
                let t = ((now_ns - since_ns) as f64 / S_NS).clamp(0.0, speed_mm_s / self.acceleration_mm_s2);
                way_mm + speed_mm_s * t - 0.5 * self.acceleration_mm_s2 * t * t
            }
            _ => return self.position_mm,
        };
        let share = if active.length_mm > 0.0 { (way_mm / active.length_mm).clamp(0.0, 1.0) } else { 1.0 };
        let mut at = active.from_mm;
        for (axis, value) in at.iter_mut().enumerate() {
            *value += (active.block.to_mm[axis] - *value) * share;
        }
        at
    }

    /// Where the last planned move ends.
    pub(crate) fn destination(&self) -> [f64; 3] {
        let active = self.active.map(|active| active.block.to_mm);
        self.queue.back().map(|block| block.to_mm).or(active).unwrap_or(self.position_mm)
    }

    fn duration_ns(&self, active: &Active) -> i64 {
        if active.length_mm <= 0.0 {
            return 0;
        }
        let ramp_s = active.peak_mm_s / self.acceleration_mm_s2;
        let cruise_s = (active.length_mm / active.peak_mm_s - ramp_s).max(0.0);
        ((2.0 * ramp_s + cruise_s) * S_NS) as i64
    }

    /// Way from the begin and speed at a moment of a running move.
    fn way(&self, active: &Active, now_ns: i64) -> (f64, f64) {
        if active.length_mm <= 0.0 {
            return (0.0, 0.0);
        }
        let (a, peak) = (self.acceleration_mm_s2, active.peak_mm_s);
        let t = ((now_ns - active.begin_ns) as f64 / S_NS).max(0.0);
        let ramp_s = peak / a;
        let whole_s = self.duration_ns(active) as f64 / S_NS;
        if t >= whole_s {
            (active.length_mm, 0.0)
        } else if t < ramp_s {
            (0.5 * a * t * t, a * t)
        } else if t > whole_s - ramp_s {
            let left = whole_s - t;
            (active.length_mm - 0.5 * a * left * left, a * left)
        } else {
            (0.5 * peak * ramp_s + peak * (t - ramp_s), peak)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    #[test]
    fn a_move_takes_its_time_and_arrives() {
        let mut arm = Mechanics::new([0.0; 3]);
        arm.plan([100.0, 0.0, 0.0], 100.0);
        arm.start(0);
        // 20 ms up, 980 ms at 100 mm/s, 20 ms down.
        arm.advance(1019 * MS);
        assert!(arm.is_moving() && (arm.position(510 * MS)[0] - 50.0).abs() < 1e-6);
        arm.advance(1021 * MS);
        assert!(!arm.is_moving());
        let arrived = Motion::Arrived { at_mm: [100.0, 0.0, 0.0] };
        assert_eq!(arm.motions.make_contiguous(), [Motion::Began { to_mm: [100.0, 0.0, 0.0] }, arrived]);
    }

    #[test]
    fn a_hold_decelerates_and_a_resume_finishes() {
        let mut arm = Mechanics::new([0.0; 3]);
        arm.plan([100.0, 0.0, 0.0], 100.0);
        arm.plan([100.0, 10.0, 0.0], 100.0);
        arm.start(0);
        arm.hold(500 * MS);
        assert!(!arm.is_held());
        arm.advance(550 * MS);
        assert!(arm.is_held());
        // 49 mm at 500 ms and 1 mm to stop.
        assert!((arm.position(600 * MS)[0] - 50.0).abs() < 1e-6);
        arm.resume(1000 * MS);
        arm.advance(10_000 * MS);
        assert_eq!(arm.position(10_000 * MS), [100.0, 10.0, 0.0]);
        assert_eq!(arm.blocks(), 0);
    }
}
