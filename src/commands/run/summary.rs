//! The table at the end, the verdict of a soak.

use std::fmt::Write;

use serde_json::{Value, json};

use super::calibration::Calibration;
use super::record::Tally;
use crate::cell::core::Cause;
use crate::telemetry::{Stage, Summary, Telemetry};

/// Counts that the table shows even when they are zero.
const ALWAYS: [Cause; 5] = [Cause::Pairs, Cause::Parts, Cause::Sent, Cause::Done, Cause::DeadlineMissed];

/// How much memory may grow over a soak: what the allocator and the kernel keep back, bytes.
const GROWTH_BYTES_MAX: u64 = 4 << 20;

fn counts(telemetry: &Telemetry, slow: u64) -> impl Iterator<Item = (Cause, u64)> {
    Cause::ALL.into_iter().map(move |cause| {
        let more = if cause == Cause::DeadlineMissed { slow } else { 0 };
        (cause, telemetry.count(cause) + more)
    })
}

/// The table for people. `found` are parts by model, `slow` deadline misses that the core's clock did not see.
pub(super) fn text(
    telemetry: &Telemetry,
    found: &[(&str, u64)],
    slow: u64,
    calibration: &Calibration,
    recorded: Option<&Tally>,
) -> String {
    let mut table = String::from("\n");
    let mut row = |name: &str, value: u64| {
        let _ = writeln!(table, "{name:<40} {value:>9}");
    };
    for (cause, count) in counts(telemetry, slow) {
        if count > 0 || ALWAYS.contains(&cause) {
            row(cause.name(), count);
        }
        if cause == Cause::Parts {
            found.iter().for_each(|(name, count)| row(&format!("  {name}"), *count));
        }
    }
    telemetry.no_picks().for_each(|(why, count)| row(&format!("no target: {why}"), count));
    if telemetry.unshown() > 0 {
        row("pairs without a line or picture", telemetry.unshown());
    }
    if let Some(tally) = recorded {
        row("pairs recorded with pictures", tally.pairs);
        for (name, count) in tally.losses(telemetry).into_iter().filter(|&(_, count)| count > 0) {
            row(name, count);
        }
        let _ = writeln!(table, "{}", tally.in_words());
    }
    if let Some(words) = calibration.text() {
        let _ = writeln!(table, "{words}");
    }
    let _ = writeln!(
        table,
        "\n{:<20} {:>9} {:>9} {:>9} {:>9} {:>9}",
        "latency, ms", "count", "p50", "p99", "p99.9", "max"
    );
    for stage in Stage::ALL {
        let Summary { count, p50_ns, p99_ns, p999_ns, max_ns } = telemetry.stage(stage).summary();
        if count > 0 {
            let [p50, p99, p999, max] = [p50_ns, p99_ns, p999_ns, max_ns].map(|ns| ns as f64 / 1e6);
            let _ = writeln!(
                table,
                "{:<20} {count:>9} {p50:>9.3} {p99:>9.3} {p999:>9.3} {max:>9.3}",
                stage.name()
            );
        }
    }
    table.trim_end().to_owned()
}

/// The same for programs.
pub(super) fn json(
    telemetry: &Telemetry,
    found: &[(&str, u64)],
    slow: u64,
    calibration: &Calibration,
    recorded: Option<&Tally>,
) -> Value {
    let counts: serde_json::Map<_, _> = counts(telemetry, slow)
        .map(|(cause, count)| (cause.name().replace(' ', "_"), json!(count)))
        .collect();
    let stages: serde_json::Map<_, _> = Stage::ALL
        .into_iter()
        .map(|stage| {
            let s = telemetry.stage(stage).summary();
            let us = |ns: u64| ns as f64 / 1e3;
            let row = json!({
                "count": s.count, "p50": us(s.p50_ns), "p99": us(s.p99_ns), "p999": us(s.p999_ns), "max": us(s.max_ns)
            });
            (stage.name().replace(' ', "_"), row)
        })
        .collect();
    let found: serde_json::Map<_, _> =
        found.iter().map(|(name, count)| ((*name).to_owned(), json!(count))).collect();
    let no_picks: serde_json::Map<_, _> =
        telemetry.no_picks().map(|(why, count)| (why.to_owned(), json!(count))).collect();
    let recording = recorded.map(|tally| {
        let losses: serde_json::Map<_, _> = tally
            .losses(telemetry)
            .into_iter()
            .map(|(name, count)| (name.replace(' ', "_"), json!(count)))
            .collect();
        json!({ "file": tally.path, "pairs": tally.pairs, "bytes": tally.bytes, "losses": losses })
    });
    json!({ "summary": {
        "counts": counts, "parts": found, "no_target": no_picks, "recording": recording,
        "calibration": calibration.json(), "stages_us": stages
    } })
}

/// Watches the memory over a soak.
pub(super) struct Endurance {
    pairs: u64,
    /// After a tenth of all pairs, and at the last one: the cell gives back what it has when it ends.
    warm_bytes: Option<u64>,
    last_bytes: u64,
}

impl Endurance {
    pub(super) fn new(pairs: u64) -> Self {
        Self { pairs, warm_bytes: None, last_bytes: 0 }
    }

    pub(super) fn pair(&mut self, pairs: u64, resident_bytes: impl Fn() -> u64) {
        if self.warm_bytes.is_none() && pairs * 10 >= self.pairs {
            self.warm_bytes = Some(resident_bytes());
        }
        if pairs == self.pairs {
            self.last_bytes = resident_bytes();
        }
    }

    /// What was held, or what was not.
    pub(super) fn verdict(&self, telemetry: &Telemetry) -> Result<String, String> {
        let (warm_bytes, last_bytes) = (self.warm_bytes.unwrap_or(self.last_bytes), self.last_bytes);
        let mib = |bytes: u64| bytes as f64 / f64::from(1 << 20);
        let memory =
            format!("{:.1} MiB after a tenth, {:.1} MiB at the last pair", mib(warm_bytes), mib(last_bytes));
        let pairs = telemetry.count(Cause::Pairs);
        if pairs < self.pairs {
            return Err(format!("{pairs} of {} pairs were played", self.pairs));
        }
        let missed = telemetry.count(Cause::DeadlineMissed);
        if missed > 0 {
            return Err(format!("{missed} of {pairs} deadlines missed"));
        }
        if last_bytes > warm_bytes + GROWTH_BYTES_MAX {
            return Err(format!("memory grows: {memory}"));
        }
        Ok(format!("soak passed: {pairs} pairs, no deadline missed, memory flat ({memory})"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cell::core::{Counts, NoPick, State};

    fn telemetry(missed: u64) -> Telemetry {
        let telemetry = Telemetry::new();
        let mut counts = Counts::default();
        counts.add(Cause::Pairs, 20);
        counts.add(Cause::DeadlineMissed, missed);
        telemetry.publish(State::Looking, &counts);
        telemetry.record(Stage::Recognition, 1_000_000);
        telemetry.add_no_pick(&NoPick::OnHold);
        telemetry
    }

    #[test]
    fn the_table_names_what_there_was() {
        let table = text(&telemetry(0), &[("rod-90", 41)], 2, &Calibration::default(), None);
        for line in ["pairs 20", "rod-90 41", "deadline misses 2", "no target: on hold 1"] {
            let found = table.lines().any(|l| l.split_whitespace().collect::<Vec<_>>().join(" ") == line);
            assert!(found, "{line:?} in\n{table}");
        }
        assert!(table.contains("recognition") && !table.contains("transfer"));
        assert_eq!(
            json(&telemetry(0), &[], 0, &Calibration::default(), None)["summary"]["stages_us"]["recognition"]
                ["count"],
            1
        );
    }

    #[test]
    fn a_soak_fails_on_a_missed_deadline_a_missing_pair_and_growing_memory() {
        let mut endurance = Endurance::new(20);
        endurance.pair(1, || 7);
        endurance.pair(2, || 10 << 20);
        endurance.pair(3, || 99 << 20);
        endurance.pair(20, || 11 << 20);
        assert!(endurance.verdict(&telemetry(0)).unwrap().starts_with("soak passed: 20 pairs"));
        assert_eq!(endurance.verdict(&telemetry(1)).unwrap_err(), "1 of 20 deadlines missed");
        endurance.pair(20, || 15 << 20);
        let grown = endurance.verdict(&telemetry(0)).unwrap_err();
        assert!(grown.contains("10.0 MiB after a tenth, 15.0 MiB at the last pair"), "{grown}");
        assert_eq!(Endurance::new(21).verdict(&telemetry(0)).unwrap_err(), "20 of 21 pairs were played");
    }
}
