//! A bad day: which of the arm's faults happens when, drawn from the seed. (A bad line is made for all dialects in
//! one place, see [`SimulatedArm`](super::SimulatedArm).)

use super::{Fault, Faults};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;

/// Share of moves during which the controller restarts.
const RESET_SHARE: f64 = 0.02;
/// Share of moves that are refused.
const REFUSED_SHARE: f64 = 0.03;
/// Share of grips that hold nothing.
const NOT_HELD_SHARE: f64 = 0.3;

/// The draws of one simulated firmware.
#[derive(Clone, Debug)]
pub(crate) struct Noise {
    faults: Faults,
    random: Pcg32,
    /// When the controller restarts in the move under way.
    restart_ns: Option<i64>,
}

impl Noise {
    pub(crate) fn new(faults: Faults) -> Self {
        Self { faults, random: Pcg32::seed_from_u64(faults.seed), restart_ns: None }
    }

    /// From now on nothing goes wrong.
    pub(crate) fn heal(&mut self) {
        self.faults.set = 0;
        self.restart_ns = None;
    }

    fn happens(&mut self, fault: Fault, share: f64) -> bool {
        self.faults.has(fault) && self.random.random_bool(share)
    }

    /// A move begins: the controller may restart in it.
    pub(crate) fn begin_move(&mut self, now_ns: i64) {
        if self.restart_ns.is_none() && self.happens(Fault::Reset, RESET_SHARE) {
            self.restart_ns = Some(now_ns + self.random.random_range(5..400) * 1_000_000);
        }
    }

    /// Whether the moment of the restart has come; true once.
    pub(crate) fn restarts(&mut self, now_ns: i64) -> bool {
        self.restart_ns.take_if(|at| *at <= now_ns).is_some()
    }

    /// When that is.
    pub(crate) fn restart_ns(&self) -> Option<i64> {
        self.restart_ns
    }

    /// The controller has restarted already.
    pub(crate) fn forget_restart(&mut self) {
        self.restart_ns = None;
    }

    /// Whether this move is refused.
    pub(crate) fn refuses(&mut self) -> bool {
        self.happens(Fault::Refused, REFUSED_SHARE)
    }

    /// Whether a grip holds a part.
    pub(crate) fn holds(&mut self) -> bool {
        !self.happens(Fault::NotHeld, NOT_HELD_SHARE)
    }

    /// Factor on every speed.
    pub(crate) fn pace(&self) -> f64 {
        if self.faults.has(Fault::Slow) { 0.1 } else { 1.0 }
    }
}
