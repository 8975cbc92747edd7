//! Time stamps and budgets; the only room that reads a clock.
//!
//! Every time in the cell is a count of nanoseconds of `CLOCK_BOOTTIME`. V4L2 stamps buffers with `CLOCK_MONOTONIC`,
//! which stands still while the machine is suspended: a picture of before would look fresh after. The cell's clock goes
//! on, and [`Sleep`] makes its times of the drivers' stamps and notices suspends. Pure rooms get a
//! [`Timestamp`] or a [`Budget`] as an argument; nothing that they decide depends on a clock, except where a
//! [`Budget::Until`] asks it for them. They ask how late it is to tell how long their stages took.

use std::time::Duration;

use serde::{Deserialize, Serialize};

/// A moment: nanoseconds of `CLOCK_BOOTTIME`. Signed, because a driver may stamp a frame a little ahead of now.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Timestamp(pub i64);

impl Timestamp {
    /// The present moment.
    pub fn now() -> Self {
        Self(read_ns(rustix::time::ClockId::Boottime))
    }

    /// Whether this moment has come.
    pub fn is_past(self) -> bool {
        Self::now() >= self
    }

    /// Nanoseconds from `earlier` to `self`; negative where `earlier` is the later one.
    pub fn since(self, earlier: Timestamp) -> i64 {
        self.0.saturating_sub(earlier.0)
    }

    /// Nanoseconds from `earlier` to `self`; 0 where `earlier` is the later one.
    pub fn ns_since(self, earlier: Timestamp) -> u64 {
        self.since(earlier).max(0).unsigned_abs()
    }

    /// `self` moved by `duration` into the future.
    pub fn after(self, duration: Duration) -> Self {
        Self(self.0.saturating_add(i64::try_from(duration.as_nanos()).unwrap_or(i64::MAX)))
    }
}

fn read_ns(clock: rustix::time::ClockId) -> i64 {
    let t = rustix::time::clock_gettime(clock);
    t.tv_sec * 1_000_000_000 + t.tv_nsec
}

/// The cell's clock and the one that stands still in a suspend, read one after the other.
#[derive(Clone, Copy, Debug)]
pub struct Clocks {
    /// The cell's.
    pub cell: Timestamp,
    /// Of `CLOCK_MONOTONIC`, read second.
    pub monotonic_ns: i64,
}

impl Clocks {
    /// Reads both; neither is a system call.
    pub fn now() -> Self {
        let cell = Timestamp::now();
        Self { cell, monotonic_ns: read_ns(rustix::time::ClockId::Monotonic) }
    }

    /// How long the machine was suspended since it was started, or less by what passed between the two readings.
    fn slept_ns(self) -> i64 {
        self.cell.0.saturating_sub(self.monotonic_ns)
    }
}

/// A suspend is longer; a thread that has to wait between the two readings of [`Clocks::now`] is not taken for one, ns.
const SLEEP_NS_MIN: i64 = 10_000_000;

/// How long the machine was suspended since it was started, as far as is known.
#[derive(Clone, Copy, Debug)]
pub struct Sleep {
    /// The longest that was read: no reading is too long.
    slept_ns: i64,
}

impl Sleep {
    /// Suspends from now on are noticed. Of several readings the best counts, or a later one would look like a suspend.
    pub fn until_now(mut read: impl FnMut() -> Clocks) -> Self {
        Self { slept_ns: (0..4).map(|_| read().slept_ns()).max().unwrap_or(0) }
    }

    /// For how long the machine was suspended since the last look, ns, if it was.
    pub fn look(&mut self, clocks: Clocks) -> Option<i64> {
        let more_ns = clocks.slept_ns().saturating_sub(self.slept_ns);
        self.slept_ns = self.slept_ns.saturating_add(more_ns.max(0));
        (more_ns >= SLEEP_NS_MIN).then_some(more_ns)
    }

    /// The cell's time of a moment of `CLOCK_MONOTONIC` since the last suspend.
    pub fn cell_time(&self, monotonic_ns: i64) -> Timestamp {
        Timestamp(monotonic_ns.saturating_add(self.slept_ns))
    }
}

/// Wall time minus [`Timestamp`] time at this moment, ns: what makes dates of the cell's times.
pub fn wall_from_cell_ns() -> i64 {
    read_ns(rustix::time::ClockId::Realtime) - Timestamp::now().0
}

/// Wall time, ms since 1970; 0 before.
pub fn wall_ms() -> u64 {
    u64::try_from(read_ns(rustix::time::ClockId::Realtime) / 1_000_000).unwrap_or(0)
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
    /// What a recognition had that is made once more.
    Repeated(Spent),
}

/// What a recognition used up: a repetition stops where time had stopped it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Spent {
    /// Iterations of its searches.
    pub iterations: u64,
    /// Where the looks at what the searches had found were stopped: [`Watch::rang_after`].
    pub looks: Option<u64>,
    /// The same of the competition's exchanges.
    pub exchanges: Option<u64>,
    /// Time was over when the grasps were decided.
    pub late: bool,
}

impl Spent {
    /// Of a recognition whose time was over before both pictures' graphs were there.
    pub const ON_PICTURES: Self = Self { iterations: 0, looks: Some(0), exchanges: Some(0), late: true };
}

impl Budget {
    /// How often a clock budget really reads the clock: once in so many iterations.
    const CLOCK_STRIDE: u64 = 64;

    /// Whether nothing is left after `used` iterations.
    #[inline]
    pub fn is_spent(&self, used: u64) -> bool {
        match *self {
            Budget::Iterations(n) | Budget::Repeated(Spent { iterations: n, .. }) => used >= n,
            Budget::Until(end) => used.is_multiple_of(Self::CLOCK_STRIDE) && end.is_past(),
        }
    }

    /// Whether its moment has come; a count of iterations has none.
    pub fn is_over(&self) -> bool {
        matches!(*self, Budget::Until(end) if end.is_past())
    }

    /// The moment at which it is over; `None` where that is no moment.
    pub fn end(&self) -> Option<Timestamp> {
        if let Budget::Until(end) = *self { Some(end) } else { None }
    }

    /// Whether its moment has come, or had when the recognition was made first.
    pub fn is_late(&self) -> bool {
        self.is_over() || matches!(*self, Budget::Repeated(Spent { late: true, .. }))
    }

    /// Watches over the looks at what the searches have found, for this share of the time that is left.
    pub fn looks(self, share: f64) -> Watch {
        self.watch(share, |spent| spent.looks)
    }

    /// Watches over the competition's exchanges, for this share of the time that is left.
    pub fn exchanges(self, share: f64) -> Watch {
        self.watch(share, |spent| spent.exchanges)
    }

    fn watch(self, share: f64, rang_after: impl Fn(&Spent) -> Option<u64>) -> Watch {
        let rings = match self.share(share) {
            Budget::Until(end) => Rings::At(end),
            Budget::Iterations(_) => Rings::Never,
            Budget::Repeated(spent) => rang_after(&spent).map_or(Rings::Never, Rings::After),
        };
        Watch { rings, asked: 0, rang: false }
    }

    /// This share of the time that is left, 0 to 1; a count of iterations stays.
    pub fn share(self, share: f64) -> Budget {
        match self {
            Budget::Until(end) => {
                let now = Timestamp::now();
                Budget::Until(Timestamp(now.0.saturating_add((end.since(now) as f64 * share) as i64)))
            }
            counted => counted,
        }
    }

    /// The budget that is left after `used` iterations.
    pub fn less(self, used: u64) -> Budget {
        match self {
            Budget::Iterations(n) => Budget::Iterations(n.saturating_sub(used)),
            Budget::Repeated(spent) => {
                Budget::Repeated(Spent { iterations: spent.iterations.saturating_sub(used), ..spent })
            }
            until => until,
        }
    }
}

/// Is asked now and then whether time is over, and knows how often it was not.
#[derive(Clone, Copy, Debug)]
pub struct Watch {
    rings: Rings,
    asked: u64,
    rang: bool,
}

#[derive(Clone, Copy, Debug)]
enum Rings {
    At(Timestamp),
    After(u64),
    Never,
}

impl Watch {
    /// Whether time is over.
    pub fn is_over(&mut self) -> bool {
        self.rang |= match self.rings {
            Rings::At(end) => end.is_past(),
            Rings::After(asked) => self.asked >= asked,
            Rings::Never => false,
        };
        self.asked += u64::from(!self.rang);
        self.rang
    }

    /// From now on it rings when this share of the time that is left by now is over, where a moment decides that. How often
    /// it was asked counts on.
    pub fn set_again(&mut self, budget: Budget, share: f64) {
        if let (Rings::At(end), Budget::Until(again)) = (&mut self.rings, budget.share(share)) {
            *end = again;
        }
    }

    /// The moment at which time is over; `None` where that is no moment.
    pub fn end(&self) -> Option<Timestamp> {
        if let Rings::At(end) = self.rings { Some(end) } else { None }
    }

    /// After how many questions it was over; `None` where it never was.
    pub fn rang_after(&self) -> Option<u64> {
        self.rang.then_some(self.asked)
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
    fn a_suspend_is_noticed_once_and_a_thread_that_was_kept_waiting_is_none() {
        const S: i64 = 1_000_000_000;
        let clocks = |cell_ns: i64, monotonic_ns: i64| Clocks { cell: Timestamp(cell_ns), monotonic_ns };
        // An hour was slept before the start; the first reading was interrupted for half a second.
        let mut delays_ns = [S / 2, 3, 40, 9].into_iter().cycle();
        let mut sleep = Sleep::until_now(|| clocks(3700 * S, 100 * S + delays_ns.next().unwrap_or_default()));
        assert_eq!(sleep.look(clocks(3701 * S, 101 * S)), None);
        assert_eq!(sleep.look(clocks(3702 * S, 102 * S + S / 3)), None);
        assert_eq!(sleep.look(clocks(3703 * S, 103 * S)), None);
        assert_eq!(sleep.cell_time(103 * S), Timestamp(3703 * S));
        assert_eq!(sleep.look(clocks(4000 * S, 110 * S)), Some(290 * S));
        assert_eq!(sleep.cell_time(110 * S), Timestamp(4000 * S));
        assert_eq!(sleep.look(clocks(4001 * S, 111 * S)), None);
    }

    #[test]
    fn the_cells_clock_is_none_that_stands_still_in_a_suspend() {
        let boot_ns = || read_ns(rustix::time::ClockId::Boottime);
        let (before, now, after) = (boot_ns(), Timestamp::now().0, boot_ns());
        assert!(before <= now && now <= after);
        assert!(
            firmware_bridge::link::clock_ns() - now < 60_000_000_000,
            "the arm's side has the same clock"
        );
    }

    #[test]
    fn a_counted_budget_ends_with_its_count() {
        assert!(!Budget::Iterations(3).is_spent(2));
        assert!(Budget::Iterations(3).is_spent(3));
        assert_eq!(Budget::Iterations(3).less(5), Budget::Iterations(0));
    }

    #[test]
    fn a_repetition_is_over_where_it_was_over_the_first_time() {
        let mut first = Budget::Until(Timestamp::now().after(Duration::from_millis(2))).looks(0.5);
        let asked = (0u64..).find(|_| first.is_over());
        assert!(first.is_over() && first.rang_after() == asked && asked.is_some());
        let spent = Spent { iterations: 7, looks: first.rang_after(), ..Spent::default() };
        let mut again = Budget::Repeated(spent).looks(0.5);
        assert_eq!((0u64..).find(|_| again.is_over()), asked);
        let mut endless = Budget::Repeated(spent).exchanges(0.5);
        assert!((0..1000).all(|_| !endless.is_over()) && endless.rang_after().is_none());
        assert!(Budget::Repeated(spent).is_spent(7) && !Budget::Repeated(spent).is_late());
    }

    #[test]
    fn a_watch_that_is_set_again_rings_later_and_counts_on() {
        let budget = Budget::Until(Timestamp::now().after(Duration::from_secs(3600)));
        let mut watch = Budget::Until(Timestamp::now().after(Duration::from_millis(20))).looks(0.5);
        assert!(!watch.is_over());
        watch.set_again(budget, 0.5);
        std::thread::sleep(Duration::from_millis(20));
        assert!(!watch.is_over() && watch.asked == 2);
        let mut counted = Budget::Repeated(Spent { looks: Some(1), ..Spent::default() }).looks(0.5);
        counted.set_again(budget, 0.5);
        assert!(!counted.is_over() && counted.is_over() && counted.rang_after() == Some(1));
    }

    #[test]
    fn a_past_deadline_is_spent_at_once_and_ages_are_signed() {
        let now = Timestamp::now();
        assert!(Budget::Until(now).is_spent(0));
        assert!(now.since(now.after(Duration::from_millis(1))) == -1_000_000);
    }
}
