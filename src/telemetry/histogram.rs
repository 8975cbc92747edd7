//! A histogram of durations that any thread may write.
//!
//! Log-linear, as HdrHistogram: every power of two is cut into 64 equal buckets, so a quantile is exact to 1.6 %.

use std::sync::atomic::{AtomicU64, Ordering};

/// Buckets a power of two, as an exponent.
const SUB_BITS: u32 = 6;
/// Longer durations count as this one, ns (about 69 s).
const MAX_NS: u64 = (1 << 36) - 1;
const BUCKETS: usize = ((36 - SUB_BITS as usize) << SUB_BITS) + (1 << SUB_BITS);

/// Durations in ns.
#[derive(Debug)]
pub struct Histogram {
    buckets: Box<[AtomicU64; BUCKETS]>,
    max_ns: AtomicU64,
}

/// What a histogram says, durations in ns; all 0 where it is empty.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Summary {
    /// How many.
    pub count: u64,
    /// Half of them took no longer.
    pub p50_ns: u64,
    /// 99 % took no longer.
    pub p99_ns: u64,
    /// 99.9 % took no longer.
    pub p999_ns: u64,
    /// The longest.
    pub max_ns: u64,
}

/// The bucket of a duration: itself below 64, then 64 buckets an octave.
fn bucket(ns: u64) -> usize {
    let ns = ns.min(MAX_NS);
    let octave = (u64::BITS - ns.leading_zeros()).saturating_sub(SUB_BITS + 1);
    ((octave as usize) << SUB_BITS) + (ns >> octave) as usize
}

/// The largest duration of a bucket.
fn upper_ns(bucket: usize) -> u64 {
    let octave = (bucket >> SUB_BITS).saturating_sub(1);
    let base = (bucket - (octave << SUB_BITS)) as u64;
    ((base + 1) << octave) - 1
}

impl Histogram {
    /// An empty one.
    pub fn new() -> Self {
        Self { buckets: Box::new(std::array::from_fn(|_| AtomicU64::new(0))), max_ns: AtomicU64::new(0) }
    }

    /// Counts a duration.
    pub fn record(&self, ns: u64) {
        self.buckets[bucket(ns)].fetch_add(1, Ordering::Relaxed);
        self.max_ns.fetch_max(ns, Ordering::Relaxed);
    }

    /// How long the share `quantile` (0 to 1) of all durations took at most, ns; 0 where there are none.
    pub fn quantile_ns(&self, quantile: f64) -> u64 {
        let count: u64 = self.buckets.iter().map(|b| b.load(Ordering::Relaxed)).sum();
        let rank = ((count as f64 * quantile).ceil() as u64).max(1);
        let mut below = 0;
        for (i, bucket) in self.buckets.iter().enumerate() {
            below += bucket.load(Ordering::Relaxed);
            if below >= rank {
                return upper_ns(i).min(self.max_ns.load(Ordering::Relaxed));
            }
        }
        0
    }

    /// All of it at a glance.
    pub fn summary(&self) -> Summary {
        Summary {
            count: self.buckets.iter().map(|b| b.load(Ordering::Relaxed)).sum(),
            p50_ns: self.quantile_ns(0.5),
            p99_ns: self.quantile_ns(0.99),
            p999_ns: self.quantile_ns(0.999),
            max_ns: self.max_ns.load(Ordering::Relaxed),
        }
    }
}

impl Default for Histogram {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buckets_are_gapless_and_narrow() {
        assert_eq!(bucket(u64::MAX), BUCKETS - 1);
        for b in 0..BUCKETS {
            assert_eq!(bucket(upper_ns(b)), b);
            if b + 1 < BUCKETS {
                assert_eq!(bucket(upper_ns(b) + 1), b + 1);
                let lower = upper_ns(b) + 1;
                assert!((upper_ns(b + 1) - lower) as f64 <= lower as f64 / 64.0);
            }
        }
    }

    #[test]
    fn quantiles_agree_with_a_sorted_list() {
        let histogram = Histogram::new();
        let mut all: Vec<u64> = (0..10_000).map(|i: u64| i * i % 1_000_003).collect();
        all.iter().for_each(|&ns| histogram.record(ns));
        all.sort_unstable();
        for (quantile, rank) in [(0.5, 5000), (0.99, 9900), (0.999, 9990)] {
            let (exact, told) = (all[rank - 1] as f64, histogram.quantile_ns(quantile) as f64);
            assert!(told >= exact && told <= exact * 1.016, "{quantile}: {exact} {told}");
        }
        let summary = histogram.summary();
        assert_eq!((summary.count, summary.max_ns), (10_000, all[9999]));
        assert_eq!(Histogram::new().summary(), Summary::default());
    }
}
