//! One list of checks for all dialects and links.

use crate::bench::{Bench, DIALECTS, MS};
use crate::cell::Way;
use firmware_bridge::config::DialectName;
use firmware_bridge::message::{Command, Disconnect, Failure, HeldBy, Outcome, Refusal, Report, Waypoint};
use firmware_bridge::simulate::{Faults, Motion};

/// Runs a check for every link and dialect, on a sound line.
fn for_all(check: impl Fn(&mut Bench, (Way, DialectName))) {
    for way in [Way::Serial, Way::SharedMemory { delay_ns: 20_000 }] {
        for dialect in DIALECTS {
            check(&mut Bench::new(way, dialect, Faults::default()), (way, dialect));
        }
    }
}

fn is_ready(report: &Report) -> bool {
    matches!(report, Report::Ready { .. })
}

#[test]
fn every_session_begins_on_hold_and_nothing_moves_before_the_release() {
    for_all(|bench, dialect| {
        assert!(bench.run_until(20_000 * MS, |r| matches!(r, Report::Connected { .. })), "{dialect:?}");
        bench.run(5_000 * MS);
        assert_eq!(bench.begun(0), [], "{dialect:?}");
        assert!(!bench.has(is_ready), "{dialect:?}");
        let pick = bench.pick(1);
        assert_eq!(bench.command(Command::Pick(pick)), Err(Refusal::OnHold), "{dialect:?}");
    });
}

#[test]
fn a_pick_is_sent_accepted_moving_done_and_the_arm_is_ready_again() {
    for_all(|bench, dialect| {
        bench.make_ready();
        let (start_ns, seen) = (bench.now_ns, bench.reports.len());
        let pick = bench.pick(1);
        bench.command(Command::Pick(pick)).unwrap();
        assert!(bench.run_until(60_000 * MS, is_ready), "{dialect:?}: {}", bench.tail());
        let about_pick: Vec<Report> = bench.reports[seen..]
            .iter()
            .map(|(_, report)| *report)
            .filter(|r| !matches!(r, Report::Heartbeat { .. } | Report::ClearOfView))
            .collect();
        let [Report::Sent { id: 1, at_ns }, rest @ ..] = &about_pick[..] else { panic!("{about_pick:?}") };
        assert!((start_ns..start_ns + 66 * MS).contains(at_ns), "{dialect:?}: written late");
        let accepted = Report::Accepted { id: 1 };
        let expected = [
            accepted,
            Report::Moving { id: 1 },
            Report::Done { id: 1 },
            Report::Ready { clear_of_view: true },
        ];
        assert_eq!(rest, expected, "{dialect:?}");
        let ways: Vec<[f64; 3]> = bench.begun(start_ns).into_iter().map(|(_, to_mm)| to_mm).collect();
        let mut ways = ways.iter();
        for (name, pose) in pick.poses() {
            assert!(
                ways.any(|way| *way == pose.position_mm),
                "{dialect:?}: {name} is not reached in its turn"
            );
        }
        assert!(bench.motions.iter().any(|(_, m)| *m == Motion::Closed { holds_part: true }), "{dialect:?}");
    });
}

#[test]
fn one_pick_at_a_time_and_each_sequence_once() {
    for_all(|bench, dialect| {
        bench.make_ready();
        let [first, second] = [bench.pick(1), bench.pick(2)];
        bench.command(Command::Pick(second)).unwrap();
        assert_eq!(bench.command(Command::Pick(first)), Err(Refusal::Busy), "{dialect:?}");
        assert!(bench.run_until(60_000 * MS, is_ready), "{dialect:?}");
        bench.run(100 * MS);
        let mut again = bench.pick(1);
        again.sequence = 1;
        assert_eq!(bench.command(Command::Pick(again)), Err(Refusal::OldSequence { last: 2 }), "{dialect:?}");
    });
}

#[test]
fn what_the_gate_refuses_never_moves_anything() {
    for_all(|bench, dialect| {
        bench.make_ready();
        let start_ns = bench.now_ns;
        let mut outside = bench.pick(1);
        outside.place.position_mm[0] = 500.0;
        let refused = Refusal::OutsideWorkspace { at: Waypoint::Place, axis: 0, value_mm: 500.0 };
        assert_eq!(bench.command(Command::Pick(outside)), Err(refused), "{dialect:?}");
        let mut stale = bench.pick(2);
        stale.seen.left_ns -= 100 * MS;
        assert!(matches!(bench.command(Command::Pick(stale)), Err(Refusal::Stale { .. })), "{dialect:?}");
        let mut early = bench.pick(3);
        early.seen.left_ns -= 45 * MS;
        assert_eq!(bench.command(Command::Pick(early)), Err(Refusal::SeenTooEarly), "{dialect:?}");
        let mut foreign = bench.pick(4);
        foreign.session += 1;
        let current = bench.session;
        assert_eq!(
            bench.command(Command::Pick(foreign)),
            Err(Refusal::WrongSession { current }),
            "{dialect:?}"
        );
        bench.run(3_000 * MS);
        assert_eq!(bench.begun(start_ns), [], "{dialect:?}");
    });
}

#[test]
fn an_arm_that_did_not_get_a_pick_says_again_that_it_is_ready() {
    for_all(|bench, dialect| {
        bench.make_ready();
        let (mut not_taken, mut refused) = (0, 0);
        // The oldest ones the link refuses at once; the younger ones are too old when the bridge has them, or when their
        // bytes were on the wire.
        for late_us in [5_000, 10, -10, -5_000, -5_500, -7_500, -10_000, -12_500] {
            let mut pick = bench.pick(1);
            bench.run(100 * MS);
            pick.seen.left_ns = bench.now_ns - 66 * MS - late_us * 1000;
            pick.seen.right_ns = pick.seen.left_ns;
            pick.ttl_ms = pick.deadline_ms;
            let said = bench.reports.len();
            not_taken += u32::from(bench.command(Command::Pick(pick)).is_err());
            let at_once = bench.reports[said..].iter().any(|(_, report)| is_ready(report));
            assert!(
                at_once || bench.run_until(60_000 * MS, is_ready),
                "{dialect:?} {late_us}: {}",
                bench.tail()
            );
            refused +=
                bench.reports[said..].iter().filter(|(_, r)| matches!(r, Report::Refused { .. })).count();
        }
        assert!(not_taken >= 2 && refused >= 1, "{dialect:?}: {not_taken} not taken, {refused} refused");
        bench.run(200 * MS);
        let pick = bench.pick(2);
        bench.command(Command::Pick(pick)).unwrap();
        assert!(
            bench.run_until(60_000 * MS, |r| *r == Report::Done { id: 2 }),
            "{dialect:?}: {}",
            bench.tail()
        );
    });
}

#[test]
fn a_hold_stops_a_motion_within_50_ms_and_only_a_release_ends_it() {
    for_all(|bench, dialect| {
        bench.make_ready();
        let pick = bench.pick(1);
        bench.command(Command::Pick(pick)).unwrap();
        assert!(bench.run_until(5_000 * MS, |r| matches!(r, Report::Moving { .. })), "{dialect:?}");
        bench.run(100 * MS);
        let hold_ns = bench.now_ns;
        bench.command(Command::Hold).unwrap();
        assert!(
            // A Marlin says nothing for a second after each of the three M410.
            bench.run_until(6_000 * MS, |r| matches!(r, Report::Held { .. })),
            "{dialect:?}: {:?}",
            bench.reports
        );
        let stopped =
            bench.motions.iter().find(|(at, m)| *at >= hold_ns && matches!(m, Motion::Stopped { .. }));
        let (stopped_ns, _) = stopped.expect("it stops");
        assert!(stopped_ns - hold_ns <= 50 * MS, "{dialect:?}: after {} ms", (stopped_ns - hold_ns) / MS);
        bench.run(5_000 * MS);
        assert!(bench.has(|r| *r == Report::Failed { id: 1, failure: Failure::Held }), "{dialect:?}");
        assert_eq!(bench.begun(hold_ns), [], "{dialect:?}");
        let second = bench.pick(2);
        assert_eq!(bench.command(Command::Pick(second)), Err(Refusal::OnHold), "{dialect:?}");
        bench.command(Command::Release).unwrap();
        assert!(bench.run_until(20_000 * MS, is_ready), "{dialect:?}: {}", bench.tail());
        let grasp_mm = pick.grasp.position_mm;
        assert!(bench.begun(hold_ns).iter().all(|(_, to_mm)| *to_mm != grasp_mm), "{dialect:?}: it went on");
    });
}

#[test]
fn a_hold_goes_out_within_50_ms_with_a_pick_half_written() {
    for_all(|bench, dialect| {
        bench.make_ready();
        let pick = bench.pick(1);
        bench.command(Command::Pick(pick)).unwrap();
        bench.run(2 * MS);
        let hold_ns = bench.now_ns;
        bench.command(Command::Hold).unwrap();
        assert!(
            bench.run_until(6_000 * MS, |r| matches!(r, Report::Held { .. })),
            "{dialect:?}: {:?}",
            bench.reports
        );
        bench.run(1_000 * MS);
        for (at_ns, to_mm) in bench.begun(hold_ns) {
            assert!(at_ns - hold_ns <= 50 * MS, "{dialect:?}: begins {to_mm:?} after a hold");
        }
        let ends = bench.reports.iter().filter(|(_, r)| {
            matches!(r, Report::Refused { id: 1, .. } | Report::Failed { id: 1, .. } | Report::Lost { id: 1 })
        });
        assert_eq!(ends.count(), 1, "{dialect:?}: {}", bench.tail());
    });
}

#[test]
fn a_pick_that_waited_through_a_suspend_never_begins() {
    for_all(|bench, dialect| {
        bench.make_ready();
        let pick = bench.pick(1);
        // Taken by the link, while no byte of it is on the wire yet.
        bench.cell.command(Command::Pick(pick), bench.now_ns).unwrap();
        bench.now_ns += 3_600_000 * MS;
        let woken_ns = bench.now_ns;
        bench.run(30_000 * MS);
        let grasp_mm = pick.grasp.position_mm;
        assert!(bench.begun(woken_ns).iter().all(|(_, to_mm)| *to_mm != grasp_mm), "{dialect:?}");
        let ends = bench.reports.iter().filter(|(_, r)| {
            matches!(r, Report::Refused { id: 1, .. } | Report::Failed { id: 1, .. } | Report::Lost { id: 1 })
        });
        assert_eq!(ends.count(), 1, "{dialect:?}: {}", bench.tail());
    });
}

#[test]
fn a_lost_link_loses_the_pick_and_the_next_session_begins_on_hold() {
    for_all(|bench, dialect| {
        bench.make_ready();
        let pick = bench.pick(1);
        bench.command(Command::Pick(pick)).unwrap();
        assert!(bench.run_until(5_000 * MS, |r| matches!(r, Report::Moving { .. })), "{dialect:?}");
        let old_session = bench.session;
        bench.cut = true;
        bench.cell.on_link(false, bench.now_ns);
        bench.run(700 * MS);
        bench.cut = false;
        bench.cell.on_link(true, bench.now_ns);
        assert!(bench.has(|r| *r == Report::Lost { id: 1 }), "{dialect:?}");
        assert!(bench.has(|r| *r == Report::Disconnected { cause: Disconnect::PortGone }), "{dialect:?}");
        assert!(bench.run_until(20_000 * MS, |r| matches!(r, Report::Connected { .. })), "{dialect:?}");
        assert_ne!(bench.session, old_session, "{dialect:?}");
        let next = bench.pick(2);
        assert_eq!(bench.command(Command::Pick(next)), Err(Refusal::OnHold), "{dialect:?}");
        bench.run(5_000 * MS);
        let resumed_ns = bench.now_ns;
        bench.run(5_000 * MS);
        assert_eq!(bench.begun(resumed_ns), [], "{dialect:?}: it moves without a release");
    });
}

#[test]
fn a_silent_arm_is_noticed_and_the_pick_is_lost() {
    for_all(|bench, dialect| {
        bench.make_ready();
        let pick = bench.pick(1);
        bench.command(Command::Pick(pick)).unwrap();
        assert!(bench.run_until(5_000 * MS, |r| matches!(r, Report::Moving { .. })), "{dialect:?}");
        bench.cut = true;
        let cut_ns = bench.now_ns;
        let noticed =
            bench.run_until(2_000 * MS, |r| *r == Report::Disconnected { cause: Disconnect::Silent });
        assert!(noticed && bench.now_ns - cut_ns < 1_000 * MS, "{dialect:?}: {}", bench.tail());
        assert!(bench.has(|r| *r == Report::Lost { id: 1 }), "{dialect:?}");
    });
}

#[test]
fn a_controller_that_restarts_is_on_hold_and_its_pick_is_lost() {
    for_all(|bench, dialect| {
        bench.make_ready();
        let pick = bench.pick(1);
        bench.command(Command::Pick(pick)).unwrap();
        assert!(bench.run_until(5_000 * MS, |r| matches!(r, Report::Moving { .. })), "{dialect:?}");
        bench.run(100 * MS);
        let reset_ns = bench.now_ns;
        bench.arm.reset(reset_ns);
        assert!(bench.run_until(20_000 * MS, |r| matches!(r, Report::Connected { .. })), "{dialect:?}");
        let ended = |r: &Report| matches!(r, Report::Lost { id: 1 } | Report::Failed { id: 1, .. });
        assert!(bench.has(ended), "{dialect:?}: {}", bench.tail());
        bench.run(3_000 * MS);
        assert_eq!(bench.begun(reset_ns), [], "{dialect:?}");
    });
}

#[test]
fn a_killed_cell_leaves_no_target_behind() {
    for_all(|bench, dialect| {
        for (kill_after_ms, id) in [(0, 1), (3, 2), (10, 3), (40, 4), (400, 5)] {
            bench.make_ready();
            let pick = bench.pick(id);
            bench.command(Command::Pick(pick)).unwrap();
            bench.run(kill_after_ms * MS);
            let killed_ns = bench.now_ns;
            bench.kill_cell(1000 * id as u32);
            assert!(bench.run_until(20_000 * MS, |r| matches!(r, Report::Connected { .. })), "{dialect:?}");
            bench.run(3_000 * MS);
            let late = bench.begun(killed_ns + 500 * MS);
            assert_eq!(late, [], "{dialect:?}: an old target begins after its time to live");
            bench.command(Command::Hello).unwrap();
        }
    });
}

#[test]
fn garbage_is_counted_and_does_no_harm() {
    for_all(|bench, dialect| {
        bench.make_ready();
        for n in 0..200u32 {
            let garbage: Vec<u8> = (0..64).map(|i| (n * 37 + i * 101 + i * i * n) as u8).collect();
            bench.cell.on_bytes(&garbage, bench.now_ns);
            bench.run(5 * MS);
        }
        bench.run(20_000 * MS);
        assert!(bench.has(|r| matches!(r, Report::Garbage { .. })), "{dialect:?}");
        bench.command(Command::Hello).unwrap();
        bench.make_ready();
        let pick = bench.pick(1);
        bench.command(Command::Pick(pick)).unwrap();
        let done = bench.run_until(60_000 * MS, |r| *r == Report::Done { id: 1 });
        assert!(done, "{dialect:?}: {}", bench.tail());
    });
}

#[test]
fn an_arm_of_another_dialect_is_never_moved() {
    for cell in DIALECTS {
        for arm in DIALECTS.into_iter().filter(|arm| *arm != cell) {
            let mut bench = Bench::of_two(cell, arm, Faults::default());
            bench.run(20_000 * MS);
            assert!(
                !bench.has(|r| matches!(r, Report::Connected { .. })),
                "{cell:?} takes {arm:?} for its own"
            );
            assert_eq!(bench.begun(0), [], "{cell:?} moves {arm:?}");
        }
    }
}

#[test]
fn commands_without_a_session_are_refused_except_a_hold() {
    for_all(|bench, dialect| {
        bench.cut = true;
        bench.run(100 * MS);
        let pick = bench.pick(1);
        assert_eq!(bench.command(Command::Pick(pick)), Err(Refusal::NotConnected), "{dialect:?}");
        assert_eq!(bench.command(Command::Release), Err(Refusal::NotConnected), "{dialect:?}");
        assert_eq!(bench.command(Command::Hold), Ok(()), "{dialect:?}");
        bench.run(10_000 * MS);
        assert!(!bench.has(|r| matches!(r, Report::Connected { .. })), "{dialect:?}");
    });
}

#[test]
fn a_query_is_answered() {
    for_all(|bench, dialect| {
        bench.make_ready();
        bench.command(Command::Query { id: 77 }).unwrap();
        let unknown = Report::Outcome { id: 77, outcome: Outcome::Unknown };
        bench.run(2_000 * MS);
        assert!(bench.has(|r| *r == unknown), "{dialect:?}: {}", bench.tail());
    });
}

#[test]
fn a_killed_bridge_loses_the_pick_and_the_next_one_begins_on_hold() {
    for dialect in DIALECTS {
        let way = Way::SharedMemory { delay_ns: 20_000 };
        let mut bench = Bench::new(way, dialect, Faults::default());
        for (kill_after_ms, id) in [(0, 1), (3, 2), (10, 3), (400, 4)] {
            bench.make_ready();
            let (session, pick) = (bench.session, bench.pick(id));
            bench.command(Command::Pick(pick)).unwrap();
            bench.run(kill_after_ms * MS);
            let killed_ns = bench.now_ns;
            bench.kill_bridge(1000 * id as u32);
            assert!(
                bench.run_until(20_000 * MS, |r| matches!(r, Report::Connected { .. })),
                "{}",
                bench.tail()
            );
            assert_ne!(bench.session, session, "{dialect:?}");
            let ends = bench.reports.iter().filter(
                |(_, r)| matches!(r, Report::Refused { id: of, .. } | Report::Lost { id: of } if *of == id),
            );
            assert_eq!(ends.count(), 1, "{dialect:?}: {}", bench.tail());
            bench.run(3_000 * MS);
            assert_eq!(bench.begun(killed_ns + 500 * MS), [], "{dialect:?}: an old target begins");
            bench.command(Command::Hello).unwrap();
        }
    }
}

#[test]
fn a_driver_that_falls_silent_is_held_by_the_bridge() {
    // The driver's process is stopped, not killed: its records come no more, the bridge lives on.
    for dialect in DIALECTS {
        let mut bench = Bench::new(Way::SharedMemory { delay_ns: 20_000 }, dialect, Faults::default());
        bench.make_ready();
        let pick = bench.pick(1);
        bench.command(Command::Pick(pick)).unwrap();
        assert!(bench.run_until(5_000 * MS, |r| matches!(r, Report::Moving { .. })), "{dialect:?}");
        bench.cell.stop_driver(true);
        let stopped_ns = bench.now_ns;
        bench.run(4_000 * MS);
        let begun = bench.begun(stopped_ns + 700 * MS);
        assert_eq!(begun, [], "{dialect:?}: moves without its driver");
        bench.cell.stop_driver(false);
        assert!(bench.run_until(20_000 * MS, |r| matches!(r, Report::Connected { .. })), "{}", bench.tail());
        assert!(bench.has(|r| *r == Report::Lost { id: 1 }), "{dialect:?}: {}", bench.tail());
    }
}

#[test]
fn the_own_protocol_remembers_its_last_pick_through_a_new_session() {
    let mut bench = Bench::new(Way::Serial, DialectName::Own, Faults::default());
    bench.make_ready();
    let pick = bench.pick(5);
    bench.command(Command::Pick(pick)).unwrap();
    assert!(bench.run_until(60_000 * MS, |r| *r == Report::Done { id: 5 }));
    bench.kill_cell(4000);
    assert!(
        bench.run_until(5_000 * MS, |r| matches!(r, Report::Connected { held_by: HeldBy::LinkLost, .. }))
    );
    bench.command(Command::Query { id: 5 }).unwrap();
    let done = Report::Outcome { id: 5, outcome: Outcome::Done };
    assert!(bench.run_until(1_000 * MS, |r| *r == done), "{}", bench.tail());
}
