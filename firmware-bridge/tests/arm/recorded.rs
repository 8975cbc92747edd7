//! The arm of a recorded session: what the contract asks of every link, and that it answers as the recorded one did.

use crate::bench::{Bench, DIALECTS, MS, settings};
use crate::cell::Way;
use firmware_bridge::config::DialectName;
use firmware_bridge::link::{Answers, RecordedLink, Said, What};
use firmware_bridge::message::{Command, Failure, HeldBy, Outcome, Pick, Refusal, Report, Waypoint};
use firmware_bridge::simulate::{Fault, Faults};

const PICKS: u64 = 6;

fn is_ready(report: &Report) -> bool {
    matches!(report, Report::Ready { .. })
}

/// What cell and arm say while an arm with faults picks.
fn conversation(dialect: DialectName, seed: u64) -> Vec<Said> {
    // A line that G-code controllers refuse ends in an alarm: these pick without faults.
    let faults = match dialect {
        DialectName::Own => Faults::new(seed, &[Fault::Refused, Fault::NotHeld]),
        _ => Faults::default(),
    };
    let mut bench = Bench::new(Way::Serial, dialect, faults);
    let mut said = Vec::new();
    bench.make_ready();
    // Between the handshake and the release 50 ms pass.
    let release_ns =
        bench.reports.iter().rev().find(|(_, r)| is_ready(r)).map_or(0, |(at_ns, _)| *at_ns - 10);
    said.push(Said { at_ns: release_ns, what: What::Command(Command::Release) });
    for id in 1..=PICKS {
        let pick = bench.pick(id);
        said.push(Said { at_ns: bench.now_ns, what: What::Command(Command::Pick(pick)) });
        bench.command(Command::Pick(pick)).unwrap();
        assert!(bench.run_until(60_000 * MS, is_ready), "{dialect:?}: {}", bench.tail());
        bench.run(30 * MS);
    }
    said.extend(bench.reports.iter().map(|&(at_ns, report)| Said { at_ns, what: What::Report(report) }));
    said.sort_by_key(|said| said.at_ns);
    said
}

/// A recorded arm on a clock.
struct Replay {
    link: RecordedLink,
    now_ns: i64,
    session: u32,
    heard: Vec<(i64, Report)>,
}

impl Replay {
    fn new(conversation: &[Said]) -> Self {
        let link = RecordedLink::new(&settings(DialectName::Own), Answers::new(conversation), 40);
        Self { link, now_ns: 5_000 * MS, session: 0, heard: Vec::new() }
    }

    /// Runs until `stop` says so of a report; at most a minute.
    fn run_until(&mut self, stop: impl Fn(&Report) -> bool) -> bool {
        let end_ns = self.now_ns + 60_000 * MS;
        loop {
            while let Some(report) = self.link.poll(self.now_ns) {
                if let Report::Connected { session, .. } = report {
                    self.session = session;
                }
                self.heard.push((self.now_ns, report));
                if stop(&report) {
                    return true;
                }
            }
            match self.link.next_deadline_ns() {
                Some(at_ns) if at_ns <= end_ns => self.now_ns = at_ns,
                _ => return false,
            }
        }
    }

    fn make_ready(&mut self) {
        assert!(self.run_until(|r| matches!(r, Report::Connected { .. })));
        self.link.command(Command::Release, self.now_ns).unwrap();
        assert!(self.run_until(is_ready), "{:?}", self.heard);
    }

    /// A pick that was seen just now.
    fn pick(&mut self, id: u64) -> Pick {
        let mut bench = Bench::new(Way::Serial, DialectName::Own, Faults::default());
        let mut pick = bench.pick(id);
        self.now_ns += 40 * MS;
        pick.seen.left_ns = self.now_ns - 20 * MS;
        pick.seen.right_ns = self.now_ns - 19 * MS;
        (pick.session, pick.sequence) = (self.session, id as u32);
        pick
    }
}

/// What was said about targets and between them, with the delay from the last target; numbers of targets from 1.
fn answers(said: impl Iterator<Item = (i64, What)>) -> Vec<(i64, Report)> {
    let mut since_ns = None;
    let mut answers = Vec::new();
    for (at_ns, what) in said {
        match what {
            What::Command(Command::Pick(_)) => since_ns = Some(at_ns),
            What::Command(_) | What::Report(Report::Heartbeat { .. } | Report::Garbage { .. }) => {}
            What::Report(report) => {
                let Some(since_ns) = since_ns else { continue };
                let report = match report {
                    Report::Sent { id, at_ns } => Report::Sent { id, at_ns: at_ns - since_ns },
                    other => other,
                };
                answers.push((at_ns - since_ns, report));
            }
        }
    }
    answers
}

#[test]
fn the_same_targets_get_the_same_answers_after_the_same_time() {
    let mut ends = [0; 3];
    for dialect in DIALECTS {
        for seed in 1..=4 {
            let recorded = conversation(dialect, seed);
            let mut replay = Replay::new(&recorded);
            replay.make_ready();
            let mut said = Vec::new();
            for id in 1..=PICKS {
                let pick = replay.pick(id);
                said.push((replay.now_ns, What::Command(Command::Pick(pick))));
                replay.heard.clear();
                replay.link.command(Command::Pick(pick), replay.now_ns).unwrap();
                assert!(replay.run_until(is_ready), "{dialect:?}: {:?}", replay.heard);
                said.extend(replay.heard.iter().map(|&(at_ns, report)| (at_ns, What::Report(report))));
            }
            let expected = answers(recorded.iter().map(|said| (said.at_ns, said.what)));
            let got = answers(said.into_iter());
            // When the bytes were written stands in the report itself; it is heard a little later.
            let plain = |list: Vec<(i64, Report)>| {
                list.into_iter()
                    .map(|(after_ns, report)| match report {
                        Report::Sent { id, .. } => (after_ns, Report::Sent { id, at_ns: 0 }),
                        other => (after_ns, other),
                    })
                    .collect::<Vec<_>>()
            };
            for (_, report) in &got {
                ends[0] += usize::from(matches!(report, Report::Done { .. }));
                ends[1] +=
                    usize::from(matches!(report, Report::Failed { failure: Failure::PartNotHeld, .. }));
                ends[2] += usize::from(matches!(report, Report::Refused { .. }));
            }
            assert_eq!(plain(got), plain(expected), "{dialect:?}, seed {seed}");
        }
    }
    assert!(ends.iter().all(|&n| n > 0), "done, not held, refused: {ends:?}");
}

#[test]
fn when_the_answers_are_used_up_the_target_is_refused_and_the_arm_on_hold() {
    let mut replay = Replay::new(&[]);
    replay.make_ready();
    let pick = replay.pick(1);
    assert_eq!(replay.link.command(Command::Pick(pick), replay.now_ns), Err(Refusal::NoRecordedAnswer));
    assert_eq!(
        Refusal::NoRecordedAnswer.to_string(),
        "the answers of the recorded session's arm are used up"
    );
    assert!(replay.run_until(|r| *r == Report::Held { by: HeldBy::RecordingOver }));
    assert_eq!(replay.link.poll(replay.now_ns), None, "it is not ready besides");
    assert_eq!(replay.link.command(Command::Pick(pick), replay.now_ns), Err(Refusal::OnHold));
}

#[test]
fn a_recording_that_ends_before_its_target_loses_it() {
    let mut recorded = conversation(DialectName::Own, 1);
    let moving = recorded.iter().position(|s| matches!(s.what, What::Report(Report::Moving { .. }))).unwrap();
    recorded.truncate(moving + 1);
    let mut replay = Replay::new(&recorded);
    replay.make_ready();
    let picks = recorded.iter().filter(|said| matches!(said.what, What::Command(Command::Pick(_)))).count();
    for id in 1..=picks as u64 {
        let pick = replay.pick(id);
        replay.link.command(Command::Pick(pick), replay.now_ns).unwrap();
        replay.run_until(|r| is_ready(r) || matches!(r, Report::Held { .. }));
    }
    let tail: Vec<_> = replay.heard.iter().rev().take(3).map(|(_, report)| *report).collect();
    let [Report::Held { by: HeldBy::RecordingOver }, Report::Lost { id }, Report::Moving { id: moved }] =
        tail[..]
    else {
        panic!("{tail:?}")
    };
    assert_eq!(id, moved);
}

/// The states after the answers to one target that was done, with `between` said 5 ms after it; then what this run hears.
fn heard_after(connected: HeldBy, between: &[What]) -> Vec<Report> {
    let pick = Bench::new(Way::Serial, DialectName::Own, Faults::default()).pick(1);
    let ready = What::Report(Report::Ready { clear_of_view: true });
    let head = [
        What::Report(Report::Connected { session: 9, held_by: connected }),
        What::Command(Command::Release),
        ready,
        What::Command(Command::Pick(pick)),
        What::Report(Report::Moving { id: 1 }),
    ];
    let said = head.iter().chain(between);
    let recorded: Vec<_> = said.zip(0..).map(|(what, n)| Said { at_ns: n * 5 * MS, what: *what }).collect();
    let mut replay = Replay::new(&recorded);
    assert!(replay.run_until(|r| matches!(r, Report::Connected { held_by: HeldBy::Start, .. })));
    replay.link.command(Command::Release, replay.now_ns).unwrap();
    assert!(replay.run_until(is_ready));
    let pick = replay.pick(1);
    replay.heard.clear();
    replay.link.command(Command::Pick(pick), replay.now_ns).unwrap();
    replay.run_until(|_| false);
    replay.heard.iter().map(|(_, report)| *report).collect()
}

#[test]
fn what_only_the_recorded_operator_could_end_does_not_stop_this_run() {
    let report = What::Report;
    let (moving, ready) = (Report::Moving { id: 1 }, Report::Ready { clear_of_view: true });
    let reset = Report::Held { by: HeldBy::ControllerReset };
    let failed = |failure| Report::Failed { id: 1, failure };
    for held_by in [HeldBy::Alarm, HeldBy::Command, HeldBy::Operator, HeldBy::RecordingOver, HeldBy::Start] {
        let done = [report(Report::Done { id: 1 }), report(ready)];
        assert_eq!(heard_after(held_by, &done), [moving, Report::Done { id: 1 }, ready]);
    }
    let alarm = Report::Alarm { code: 1 };
    let in_alarm = [report(alarm), report(failed(Failure::Alarm))];
    assert_eq!(heard_after(HeldBy::Start, &in_alarm), [moving, alarm, failed(Failure::Alarm), reset]);
    let unlocked = [
        report(Report::Done { id: 1 }),
        report(ready),
        report(alarm),
        report(Report::Held { by: HeldBy::Alarm }),
    ];
    assert_eq!(heard_after(HeldBy::Start, &unlocked), [moving, Report::Done { id: 1 }, ready, alarm, reset]);
    let button = Report::Held { by: HeldBy::Operator };
    let pressed =
        [report(button), report(failed(Failure::Held)), What::Command(Command::Release), report(ready)];
    assert_eq!(heard_after(HeldBy::Start, &pressed), [moving, failed(Failure::Held), ready]);
    // A target that never ended, with others after it: lost, and on it goes.
    let next = Bench::new(Way::Serial, DialectName::Own, Faults::default()).pick(2);
    let silent =
        [What::Command(Command::Hold), What::Command(Command::Release), What::Command(Command::Pick(next))];
    assert_eq!(heard_after(HeldBy::Start, &silent), [moving, Report::Lost { id: 1 }, ready]);
}

#[test]
fn a_release_of_the_recorded_operators_hold_is_no_answer_to_a_release_of_this_run() {
    let at = |ms: i64, what| Said { at_ns: ms * MS, what };
    let ready = What::Report(Report::Ready { clear_of_view: true });
    let release = What::Command(Command::Release);
    let connected = What::Report(Report::Connected { session: 9, held_by: HeldBy::Start });
    let recorded = [
        at(0, connected),
        at(1, release),
        at(2, ready),
        at(10, What::Command(Command::Hold)),
        at(11, What::Report(Report::Held { by: HeldBy::Command })),
        at(20, release),
        at(120, ready),
        at(200, connected),
        at(201, release),
        at(208, ready),
    ];
    let mut replay = Replay::new(&recorded);
    for expected_ms in [1, 7] {
        assert!(replay.run_until(|r| matches!(r, Report::Connected { .. })));
        let released_ns = replay.now_ns;
        replay.link.command(Command::Release, released_ns).unwrap();
        assert!(replay.run_until(is_ready));
        assert_eq!((replay.now_ns - released_ns) / MS, expected_ms);
        replay.link.command(Command::Hello, replay.now_ns).unwrap();
    }
}

#[test]
fn an_arm_that_does_not_say_when_it_is_clear_gets_its_dwell() {
    let mut recorded = conversation(DialectName::Own, 1);
    for said in &mut recorded {
        if let What::Report(Report::Ready { clear_of_view }) = &mut said.what {
            *clear_of_view = false;
        }
    }
    recorded.retain(|said| said.what != What::Report(Report::ClearOfView));
    let mut settings = settings(DialectName::Own);
    settings.arm.clear_dwell_ms = 300;
    let mut replay = Replay::new(&[]);
    replay.link = RecordedLink::new(&settings, Answers::new(&recorded), 40);
    replay.make_ready();
    replay.now_ns += 200 * MS;
    let early = replay.pick(1);
    assert_eq!(replay.link.command(Command::Pick(early), replay.now_ns), Err(Refusal::SeenTooEarly));
    let again = replay.link.poll(replay.now_ns);
    assert_eq!(again, Some(Report::Ready { clear_of_view: false }), "as ready as before");
    replay.now_ns += 200 * MS;
    let pick = replay.pick(1);
    assert_eq!(replay.link.command(Command::Pick(pick), replay.now_ns), Ok(()));
}

#[test]
fn an_arm_that_connects_late_does_so_whatever_is_asked_before() {
    let recorded = conversation(DialectName::Own, 1);
    for hold in [false, true] {
        let mut replay = Replay::new(&[]);
        let late = Answers::new(&recorded).connecting_after(300 * MS);
        replay.link = RecordedLink::new(&settings(DialectName::Own), late, 40);
        let begin_ns = replay.now_ns;
        assert_eq!(replay.link.poll(begin_ns), None);
        if hold {
            replay.link.command(Command::Hold, begin_ns).unwrap();
        }
        assert_eq!(replay.link.command(Command::Release, begin_ns), Err(Refusal::NotConnected));
        replay.make_ready();
        assert!(matches!(replay.heard[0], (at_ns, Report::Connected { .. }) if at_ns == begin_ns + 300 * MS));
        assert_eq!(replay.heard.iter().filter(|said| matches!(said.1, Report::Connected { .. })).count(), 1);
    }
}

#[test]
fn a_recorded_arm_keeps_the_contract() {
    let recorded = conversation(DialectName::Own, 2);
    let mut replay = Replay::new(&recorded);
    let early = replay.pick(1);
    assert_eq!(replay.link.command(Command::Pick(early), replay.now_ns), Err(Refusal::NotConnected));
    assert_eq!(replay.link.command(Command::Release, replay.now_ns), Err(Refusal::NotConnected));
    assert_eq!(replay.link.command(Command::Hold, replay.now_ns), Ok(()));
    assert!(replay.run_until(|r| matches!(r, Report::Connected { held_by: HeldBy::Start, .. })));
    let pick = replay.pick(1);
    assert_eq!(replay.link.command(Command::Pick(pick), replay.now_ns), Err(Refusal::OnHold));
    replay.link.command(Command::Release, replay.now_ns).unwrap();
    assert!(replay.run_until(is_ready));
    let mut outside = replay.pick(1);
    outside.place.position_mm[0] = 500.0;
    let refused = Refusal::OutsideWorkspace { at: Waypoint::Place, axis: 0, value_mm: 500.0 };
    assert_eq!(replay.link.command(Command::Pick(outside), replay.now_ns), Err(refused));
    let mut foreign = replay.pick(1);
    foreign.session += 1;
    let current = replay.session;
    let wrong = Err(Refusal::WrongSession { current });
    assert_eq!(replay.link.command(Command::Pick(foreign), replay.now_ns), wrong);
    let pick = replay.pick(1);
    replay.link.command(Command::Pick(pick), replay.now_ns).unwrap();
    let second = replay.pick(2);
    assert_eq!(replay.link.command(Command::Pick(second), replay.now_ns), Err(Refusal::Busy));
    replay.link.command(Command::Query { id: 1 }, replay.now_ns).unwrap();
    assert!(replay.run_until(|r| *r == Report::Outcome { id: 1, outcome: Outcome::Unfinished }));
    replay.link.command(Command::Hold, replay.now_ns).unwrap();
    assert!(replay.run_until(|r| *r == Report::Held { by: HeldBy::Command }));
    assert!(replay.heard.iter().any(|(_, r)| *r == Report::Failed { id: 1, failure: Failure::Held }));
    replay.link.command(Command::Query { id: 1 }, replay.now_ns).unwrap();
    assert!(replay.run_until(|r| *r == Report::Outcome { id: 1, outcome: Outcome::Failed }));
    replay.link.command(Command::Hello, replay.now_ns).unwrap();
    assert!(replay.run_until(|r| matches!(r, Report::Connected { .. })));
    assert_eq!(replay.session, current + 1);
    assert!(!replay.run_until(is_ready), "nothing moves before a release");
}
