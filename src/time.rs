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

/// Wall time minus [`Timestamp`] time at this moment, ns: what makes dates of the cell's times.
pub fn wall_from_cell_ns() -> i64 {
    let wall = rustix::time::clock_gettime(rustix::time::ClockId::Realtime);
    wall.tv_sec * 1_000_000_000 + wall.tv_nsec - Timestamp::now().0
}

/// A wall time as the name of a file: `2026-03-01T12-30-05.250Z`, proleptic Gregorian, UTC.
pub fn utc_name(wall_ns: i64) -> String {
    let ms = wall_ns.div_euclid(1_000_000);
    let (days, ms_of_day) = (ms.div_euclid(86_400_000), ms.rem_euclid(86_400_000));
    // Days since 0000-03-01 in eras of 400 years: months of 30.6 days from March on, the leap day at the end.
    let since_march = days + 719_468;
    let (era, day_of_era) = (since_march.div_euclid(146_097), since_march.rem_euclid(146_097));
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_from_march = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month_from_march + 2) / 5 + 1;
    let month = if month_from_march < 10 { month_from_march + 3 } else { month_from_march - 9 };
    let year = year_of_era + era * 400 + i64::from(month <= 2);
    let [h, m, s] = [3_600_000, 60_000, 1000].map(|unit| ms_of_day / unit);
    let (minute, second, milli) = (m % 60, s % 60, ms_of_day % 1000);
    format!("{year:04}-{month:02}-{day:02}T{h:02}-{minute:02}-{second:02}.{milli:03}Z")
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
    fn a_wall_time_has_its_date_as_name() {
        let name = |seconds: i64| utc_name(seconds * 1_000_000_000 + 250_000_000);
        assert_eq!(name(0), "1970-01-01T00-00-00.250Z");
        assert_eq!(name(951_782_400), "2000-02-29T00-00-00.250Z");
        assert_eq!(name(1_772_368_205), "2026-03-01T12-30-05.250Z");
        assert_eq!(name(4_107_542_399), "2100-02-28T23-59-59.250Z");
        assert_eq!(name(4_107_542_400), "2100-03-01T00-00-00.250Z");
    }

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
