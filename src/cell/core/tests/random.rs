//! Random events in random order, also such as no honest arm or camera would send, and what must hold all the same.
//! The judge sees only events and actions; it shares nothing with the core.

use std::collections::HashMap;

use firmware_bridge::message::{Disconnect, Failure, Outcome, Refusal};
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::*;
use crate::camera::Trouble;

/// Follows events and actions and objects.
#[derive(Default)]
struct Judge {
    unfinished: Option<u64>,
    ordered: Vec<u64>,
    ends: HashMap<u64, u32>,
    /// Nothing may be sent: on hold, absent, in alarm, or released and not yet ready.
    held: bool,
    released: bool,
    operator_released: bool,
    clear_since: Option<i64>,
    ended_at: i64,
    out: HashMap<u8, u32>,
    searching: Option<Pair>,
    pairs: HashMap<u64, u32>,
    on_disk: Option<PlaceRecord>,
    stopped: bool,
    over: bool,
}

impl Judge {
    fn event(&mut self, event: &Event, now: i64) {
        match event {
            Event::Frame(frame) => *self.out.entry(frame.handle.0).or_default() += 1,
            Event::Arm(report) => self.report(report, now),
            Event::Persisted(record) => self.on_disk = Some(*record),
            Event::Operator(Operator::Release) => self.operator_released = true,
            Event::Operator(Operator::Hold) => (self.held, self.operator_released) = (true, false),
            Event::Suspended { .. } => {
                (self.held, self.released, self.operator_released) = (true, false, false);
                self.clear_since = None;
            }
            Event::Stop => self.stopped = true,
            Event::Recognised { .. } => self.searching = None,
            _ => {}
        }
    }

    fn report(&mut self, report: &Report, now: i64) {
        match report {
            Report::Ready { clear_of_view } if self.released => {
                self.held = false;
                if *clear_of_view {
                    self.clear_since = Some(self.clear_since.map_or(now, |since| since.min(now)));
                } else if self.clear_since.is_none() {
                    self.clear_since = Some(now + 50 * MS);
                }
            }
            Report::ClearOfView if self.released => self.clear_since = Some(now),
            Report::Connected { .. }
            | Report::Disconnected { .. }
            | Report::Held { .. }
            | Report::Alarm { .. }
            | Report::PositionUnknown
            | Report::ReportsLost => (self.held, self.released, self.clear_since) = (true, false, None),
            _ => {}
        }
    }

    fn action(&mut self, action: &Action, params: &Params, now: i64) {
        assert!(!self.over, "nothing follows the end");
        match action {
            Action::Free(handle) => {
                let out = self.out.get_mut(&handle.0).expect("a frame that was given");
                *out = out.checked_sub(1).expect("a frame is freed once");
            }
            Action::Recognise(job) => {
                assert!(self.searching.replace(job.pair).is_none(), "one search at a time");
            }
            Action::Arm(Command::Pick(pick)) => self.pick(pick, params, now),
            Action::Arm(Command::Release) => {
                assert!(std::mem::take(&mut self.operator_released), "resume = manual");
                assert!(!self.stopped, "no release after the stop");
                self.released = true;
            }
            Action::Arm(Command::Hold) => (self.held, self.released) = (true, false),
            Action::Say(Note::Ended { id, .. }) => {
                *self.ends.entry(*id).or_default() += 1;
                assert_eq!(self.unfinished.take(), Some(*id), "only what is under way can end");
                self.ended_at = now;
            }
            Action::Say(Note::Pair(report)) => *self.pairs.entry(report.pair.number).or_default() += 1,
            Action::End(_) => self.over = true,
            _ => {}
        }
    }

    fn pick(&mut self, pick: &Pick, params: &Params, now: i64) {
        assert_eq!(self.unfinished.replace(pick.id), None, "two unfinished targets");
        assert!(!self.held && self.released, "a target while on hold");
        assert!(!self.stopped, "a target after the stop");
        assert!(self.ordered.last().is_none_or(|&last| last < pick.id), "numbers rise");
        self.ordered.push(pick.id);
        assert!(now - pick.seen.earliest_ns() <= params.deadline_ns, "a stale target");
        let clear_since = self.clear_since.take().expect("the arm was clear of the view");
        assert!(pick.seen.earliest_ns() > clear_since, "seen before the arm was clear");
        assert!(pick.seen.earliest_ns() > self.ended_at, "seen before the last target ended");
        if params.place.is_some() {
            let on_disk = self.on_disk.expect("a slot on disk");
            assert_eq!((on_disk.unfinished_id, on_disk.next_slot), (pick.id, pick.slot), "slot not on disk");
        }
    }
}

/// What an honest arm would say next, or anything at all.
fn report(rng: &mut impl Rng, state: State, id: u64) -> Report {
    if rng.random_range(0..8) != 0 {
        return match state {
            State::Absent => Report::Connected { session: rng.random(), held_by: HeldBy::Start },
            State::Held | State::Alarmed | State::Stopping => Report::Held { by: HeldBy::Command },
            State::Releasing => Report::Ready { clear_of_view: rng.random() },
            State::Looking => Report::Heartbeat { delay_us: 10 },
            State::Ordered => Report::Sent { id, at_ns: 0 },
            State::Sent => Report::Accepted { id },
            State::Accepted => Report::Moving { id },
            State::Moving => Report::Done { id },
        };
    }
    let held_by =
        [HeldBy::Start, HeldBy::Command, HeldBy::LinkLost, HeldBy::Operator][rng.random_range(0..4)];
    // Now and then about another target than the one under way.
    let id = if rng.random_range(0..8) == 0 { id.wrapping_sub(1) } else { id };
    match rng.random_range(0..40) {
        0 => Report::Connected { session: rng.random(), held_by },
        1 => Report::Disconnected { cause: Disconnect::Silent },
        2 => Report::Alarm { code: 1 },
        3 => Report::PositionUnknown,
        4 => Report::ReportsLost,
        5 => Report::Garbage { bytes: 3 },
        6 => Report::Lost { id },
        7 => Report::Refused { id, refusal: Refusal::Unreachable },
        8 => Report::Failed { id, failure: Failure::PartNotHeld },
        9 => Report::Outcome { id, outcome: Outcome::Done },
        10 => Report::Outcome { id, outcome: Outcome::Unknown },
        11..14 => Report::Held { by: held_by },
        14..17 => Report::Accepted { id },
        17..20 => Report::Moving { id },
        20..24 => Report::Done { id },
        24..26 => Report::ClearOfView,
        26..28 => Report::Sent { id, at_ns: 0 },
        28..30 => Report::Heartbeat { delay_us: 10 },
        _ => Report::Ready { clear_of_view: rng.random() },
    }
}

struct Run {
    bench: Bench,
    judge: Judge,
    params: Params,
    to_write: Option<PlaceRecord>,
}

impl Run {
    fn new(seed: u64) -> Self {
        let place = PlacePattern {
            first: down([-150.0, -100.0, 20.0]),
            column_step_mm: [20.0, 0.0, 0.0],
            row_step_mm: [0.0; 3],
            columns: 10,
            rows: 1,
        };
        let params = Params { place: seed.is_multiple_of(2).then_some(place), ..params() };
        let bench = Bench::new(params.clone(), &settings(""));
        let judge = Judge { held: true, ended_at: i64::MIN, ..Judge::default() };
        Self { bench, judge, params, to_write: None }
    }

    fn event(&mut self, event: Event) {
        let now = self.bench.now.0;
        self.judge.event(&event, now);
        for action in self.bench.event(event).to_vec() {
            self.judge.action(&action, &self.params, now);
            if let Action::Persist(record) = action {
                self.to_write = Some(record);
            }
        }
    }

    fn step(&mut self, rng: &mut Pcg64Mcg) {
        let wait_ms = [0, 0, 1, 5, 20, 60][rng.random_range(0..6)];
        let due = self.bench.now.0 + wait_ms * MS;
        // Ticks come when the core asked for them, as the carrier brings them.
        let mut ticks = 0;
        while let Some(tick) = self.bench.core.next_tick().filter(|tick| tick.0 <= due) {
            self.bench.now = tick.max(self.bench.now);
            self.event(Event::Tick);
            ticks += 1;
            assert!(ticks < 50, "a tick asks for itself again: {:?}", self.bench.core);
        }
        self.bench.now = Timestamp(due);
        let id = self.judge.unfinished.unwrap_or(100);
        match rng.random_range(0..100) {
            0..35 => {
                let age_ms = if rng.random() { 0 } else { rng.random_range(-40..80) };
                let at = Timestamp(due - age_ms * MS);
                for side in Side::BOTH {
                    let mut frame = self.bench.frame(side, at);
                    frame.sequence = rng.random_range(0..9);
                    if rng.random_range(0..12) == 0 {
                        frame.condition = Condition::Damaged;
                    }
                    if rng.random_range(0..12) != 0 {
                        self.event(Event::Frame(frame));
                    }
                }
            }
            35..60 => {
                if let Some(pair) = self.judge.searching {
                    let x = rng.random_range(-220.0..220.0);
                    let parts = [[x, 0.0, 10.0], [-x, 50.0, 10.0]];
                    self.event(Event::Recognised {
                        pair: pair.number,
                        found: found(&parts[..rng.random_range(0..3)]),
                    });
                }
            }
            60..84 => self.event(Event::Arm(report(rng, self.bench.state(), id))),
            84..90 => self.event(Event::Operator(Operator::Release)),
            90 => self.event(Event::Operator(Operator::Hold)),
            91..96 => {
                if let Some(record) = self.to_write.take() {
                    self.event(if rng.random_range(0..6) == 0 {
                        Event::NotPersisted
                    } else {
                        Event::Persisted(record)
                    });
                }
            }
            96 => self.event(Event::CameraLost { side: Side::Left, trouble: Trouble::Unplugged }),
            97 => self.event(Event::CameraBack { side: Side::Left }),
            98 if rng.random_range(0..4) == 0 => {
                let for_ns = rng.random_range(10 * MS..100_000 * MS);
                self.bench.now = Timestamp(due + for_ns);
                self.event(Event::Suspended { for_ns });
            }
            98 => self.event(Event::NotTaken { id, refusal: Refusal::Busy }),
            _ => self.event(Event::Recognised { pair: 1 << 40, found: found(&[[0.0; 3]]) }),
        }
    }
}

#[test]
fn whatever_happens_no_target_is_doubled_stale_lost_or_sent_on_hold() {
    let (mut ordered, mut done) = (0, 0);
    for seed in 0..1000 {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let mut run = Run::new(seed);
        for _ in 0..800 {
            run.step(&mut rng);
        }
        run.event(Event::Stop);
        run.bench.now = Timestamp(run.bench.now.0 + STOP_NS);
        if !run.judge.over {
            run.event(Event::Tick);
        }
        assert!(run.judge.over, "seed {seed}: a while after the stop all is over");
        for id in &run.judge.ordered {
            assert_eq!(run.judge.ends.get(id), Some(&1), "seed {seed}: every target ends exactly once");
        }
        assert!(run.judge.out.values().all(|&out| out == 0), "seed {seed}: every frame comes back");
        assert!(run.judge.pairs.values().all(|&said| said == 1), "seed {seed}: every pair is reported once");
        assert_eq!(run.bench.count(Cause::Pairs), run.judge.pairs.len() as u64);
        ordered += run.judge.ordered.len();
        done += run.bench.count(Cause::Done);
    }
    assert!(ordered > 1000 && done > 300, "the sequences reach the arm: {ordered} ordered, {done} done");
}

#[test]
fn the_same_events_give_the_same_actions() {
    let actions = |seed: u64| {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let mut run = Run::new(seed);
        let mut all = Vec::new();
        for _ in 0..300 {
            run.step(&mut rng);
            all.extend(run.bench.actions.iter().map(|action| format!("{action:?}")));
        }
        all
    };
    assert_eq!(actions(4), actions(4));
}
