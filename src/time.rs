//! Time stamps and budgets; the only room that reads a clock.
//!
//! Every time in the cell is a count of nanoseconds of `CLOCK_MONOTONIC`, the clock that V4L2 stamps buffers
//! with. Pure rooms get a [`Timestamp`] or a [`Budget`] as an argument and never ask a clock themselves, except
//! that a [`Budget::Until`] asks it for them.

use std::time::Duration;

use serde::{Deserialize, Serialize};

/// A moment: nanoseconds of `CLOCK_MONOTONIC`. Signed, because a driver may stamp a frame a little ahead of now.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Timestamp(pub i64);

impl Timestamp {
    /// The present moment.
    pub fn now() -> Self {
        let t = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
        Self(t.tv_sec * 1_000_000_000 + t.tv_nsec)
    }

    /// Nanoseconds from `earlier` to `self`; negative where `earlier` is the later one.
    pub fn since(self, earlier: Timestamp) -> i64 {
        self.0.saturating_sub(earlier.0)
    }

    /// `self` moved by `duration` into the future.
    pub fn after(self, duration: Duration) -> Self {
        Self(self.0.saturating_add(i64::try_from(duration.as_nanos()).unwrap_or(i64::MAX)))
    }
}

/// What a search may use up. A live cell gives it the time that is left; tests, accuracy runs and replays give it
/// a count, so that their results do not depend on the machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Budget {
    /// Until this moment has come.
    Until(Timestamp),
    /// This many iterations (improvisations of Harmony Search, steps of the exhaustive search).
    Iterations(u64),
}

impl Budget {
    /// How often a clock budget really reads the clock: once in so many iterations.
    const CLOCK_STRIDE: u64 = 64;

    /// Whether nothing is left after `used` iterations.
    #[inline]
    pub fn is_spent(&self, used: u64) -> bool {
        match *self {
            Budget::Iterations(n) => used >= n,
            Budget::Until(end) => used.is_multiple_of(Self::CLOCK_STRIDE) && Timestamp::now() >= end,
        }
    }

    /// Whether its moment has come; a count of iterations has none.
    pub fn is_over(&self) -> bool {
        matches!(*self, Budget::Until(end) if Timestamp::now() >= end)
    }

    /// Half of the time that is left; a count of iterations stays.
    pub fn half(self) -> Budget {
        match self {
            Budget::Until(end) => {
                let now = Timestamp::now();
                Budget::Until(Timestamp(now.0 + end.since(now) / 2))
            }
            iterations => iterations,
        }
    }

    /// The budget that is left after `used` iterations.
    pub fn less(self, used: u64) -> Budget {
        match self {
            Budget::Iterations(n) => Budget::Iterations(n.saturating_sub(used)),
            until => until,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_counted_budget_ends_with_its_count() {
        assert!(!Budget::Iterations(3).is_spent(2));
        assert!(Budget::Iterations(3).is_spent(3));
        assert_eq!(Budget::Iterations(3).less(5), Budget::Iterations(0));
    }

    #[test]
    fn a_past_deadline_is_spent_at_once_and_ages_are_signed() {
        let now = Timestamp::now();
        assert!(Budget::Until(now).is_spent(0));
        assert!(now.since(now.after(Duration::from_millis(1))) == -1_000_000);
    }
}
