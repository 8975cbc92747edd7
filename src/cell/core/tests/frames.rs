use super::*;
use crate::camera::Trouble;

#[test]
fn a_pair_is_searched_until_the_deadline_less_the_wire() {
    let mut bench = Bench::new(params(), &settings(""));
    bench.pair();
    let job = bench.job().unwrap();
    assert_eq!(job.budget, Budget::Until(Timestamp(bench.now.0 + 65 * MS)));
    assert_eq!((job.pair.number, job.seed), (1, 8));
    let mut counted = Bench::new(Params { iterations: Some(500), ..params() }, &settings(""));
    counted.pair();
    assert_eq!(counted.job().unwrap().budget, Budget::Iterations(500));
}

#[test]
fn while_the_recogniser_is_busy_only_the_newest_pair_waits() {
    let mut bench = Bench::new(params(), &settings(""));
    bench.pair();
    for _ in 0..3 {
        bench.pass(33 * MS);
        bench.pair();
        assert_eq!(bench.job(), None);
    }
    assert_eq!(bench.outcome(), Some(Err(NoPick::Superseded)));
    assert_eq!(bench.count(Cause::Superseded), 2);
    bench.event(Event::Recognised { pair: 1, found: Found::nothing(Nothing::BinEmpty) });
    assert_eq!(bench.outcome(), Some(Err(NoPick::Late)));
    assert_eq!(bench.job().unwrap().pair.number, 4);
    // An overrun costs its own pair, not the next.
    bench.event(Event::Recognised { pair: 4, found: Found::nothing(Nothing::BinEmpty) });
    assert_eq!(bench.outcome(), Some(Err(NoPick::Nothing(Nothing::BinEmpty))));
    assert_eq!(bench.count(Cause::DeadlineMissed), 1);
}

#[test]
fn bad_frames_are_counted_by_cause_and_never_paired() {
    let mut bench = Bench::new(params(), &settings(""));
    for (condition, ahead_ms, cause) in [
        (Condition::Damaged, 0, Cause::Damaged),
        (Condition::Short, 0, Cause::Short),
        (Condition::Good, 34, Cause::Future),
    ] {
        let mut frame = bench.frame(Side::Left, Timestamp(bench.now.0 + ahead_ms * MS));
        frame.condition = condition;
        assert_eq!(bench.event(Event::Frame(frame)), [Action::Free(frame.handle)]);
        assert_eq!(bench.count(cause), 1, "{cause:?}");
    }
    let right = bench.frame(Side::Right, bench.now);
    assert_eq!(bench.event(Event::Frame(right)), []);
    assert_eq!((bench.count(Cause::Frames), bench.count(Cause::Pairs)), (4, 0));
}

#[test]
fn missing_frames_are_seen_in_the_sequence_and_in_the_time_stamps() {
    // (steps of the sequence, periods between the stamps, skipped) -> (gap, missing)
    for (steps, periods, skipped, gap, missing) in [
        (1, 1, 0, 0, 0),
        (3, 3, 0, 2, 0),
        (3, 3, 2, 0, 0),
        (1, 4, 0, 0, 3),
        (2, 4, 0, 1, 2),
        (u32::MAX, 1, 0, 0, 0),
    ] {
        let mut bench = Bench::new(params(), &settings(""));
        let mut frame = bench.frame(Side::Left, bench.now);
        frame.sequence = 5;
        bench.event(Event::Frame(frame));
        bench.pass(periods * 33 * MS);
        let mut next = bench.frame(Side::Left, bench.now);
        next.sequence = 5u32.wrapping_add(steps);
        next.skipped = skipped;
        bench.event(Event::Frame(next));
        assert_eq!(
            (bench.count(Cause::Gap), bench.count(Cause::Missing)),
            (gap, missing),
            "{steps} {periods}"
        );
    }
}

#[test]
fn a_silent_camera_is_said_once_and_so_is_its_return() {
    let mut bench = Bench::new(params(), &settings(""));
    bench.arm(Report::Connected { session: 3, held_by: HeldBy::Start });
    assert_eq!(bench.core.next_tick(), Some(Timestamp(bench.now.0 + 800 * MS)));
    bench.pass(799 * MS);
    assert_eq!(bench.alarms(), []);
    bench.pass(MS);
    let silent = Side::BOTH.map(|side| Alarm::CameraSilent { side });
    assert_eq!(bench.alarms(), silent);
    bench.pass(5000 * MS);
    assert_eq!(bench.alarms(), []);
    assert_eq!(bench.core.next_tick(), None);
    let frame = bench.frame(Side::Right, bench.now);
    assert_eq!(bench.event(Event::Frame(frame)), [Action::Say(Note::CameraBack { side: Side::Right })]);
}

#[test]
fn a_lost_camera_lets_go_of_its_waiting_frame() {
    let mut bench = Bench::new(params(), &settings(""));
    let frame = bench.frame(Side::Left, bench.now);
    bench.event(Event::Frame(frame));
    let trouble = Trouble::Unplugged;
    let alarm = Alarm::CameraLost { side: Side::Left, trouble };
    assert_eq!(
        bench.event(Event::CameraLost { side: Side::Left, trouble }),
        [Action::Say(Note::Alarm(alarm)), Action::Free(frame.handle)]
    );
    assert_eq!(bench.event(Event::CameraLost { side: Side::Left, trouble }), []);
    assert_eq!(
        bench.event(Event::CameraBack { side: Side::Left }),
        [Action::Say(Note::CameraBack { side: Side::Left })]
    );
    assert!(alarm.to_string().starts_with("left camera: unplugged"));
}

#[test]
fn a_lost_camera_says_why_whenever_the_reason_is_another() {
    let mut bench = Bench::new(params(), &settings(""));
    bench.arm(Report::Connected { session: 3, held_by: HeldBy::Start });
    bench.pass(800 * MS);
    assert_eq!(bench.alarms(), Side::BOTH.map(|side| Alarm::CameraSilent { side }));
    for trouble in [Trouble::Unplugged, Trouble::NoBandwidth, Trouble::Unplugged] {
        bench.event(Event::CameraLost { side: Side::Left, trouble });
        assert_eq!(bench.alarms(), [Alarm::CameraLost { side: Side::Left, trouble }]);
        bench.event(Event::CameraLost { side: Side::Left, trouble });
        assert_eq!(bench.alarms(), []);
        bench.pass(5000 * MS);
        assert_eq!(bench.alarms(), []);
    }
    assert_eq!(bench.count(Cause::CameraLost), 2, "each camera once, however often the reason changes");
}

#[test]
fn a_suspend_lets_go_of_waiting_frames_and_is_neither_silence_nor_a_gap() {
    let mut bench = Bench::new(params(), &settings(""));
    let frame = bench.frame(Side::Left, bench.now);
    bench.event(Event::Frame(frame));
    bench.now = Timestamp(bench.now.0 + 3_600_000 * MS);
    let actions = bench.event(Event::Suspended { for_ns: 3_599_000 * MS }).to_vec();
    assert_eq!(actions[1..], [Action::Free(frame.handle)]);
    assert_eq!(bench.alarms(), [Alarm::Suspended { seconds: 3599 }]);
    bench.pass(MS);
    assert_eq!(bench.alarms(), []);
    bench.pair();
    assert!(bench.job().is_some());
    assert_eq!((bench.count(Cause::Missing), bench.count(Cause::CameraLost)), (0, 0));
}

#[test]
fn cameras_out_of_step_are_said_once() {
    let mut bench = Bench::new(params(), &settings(""));
    let mut said = Vec::new();
    for _ in 0..20 {
        for side in Side::BOTH {
            bench.pass(16 * MS);
            let frame = bench.frame(side, bench.now);
            bench.event(Event::Frame(frame));
            said.extend(bench.alarms());
        }
    }
    assert_eq!(said, [Alarm::CamerasOutOfStep { skew_us: 16_000 }]);
    assert_eq!((bench.count(Cause::Pairs), bench.count(Cause::OutOfStep)), (0, 39));
}

#[test]
fn a_session_ends_when_both_sides_and_all_that_is_under_way_have_ended() {
    let mut bench = Bench::looking(params(), &settings(""));
    bench.pair();
    bench.event(Event::CameraEnded { side: Side::Left });
    bench.event(Event::CameraEnded { side: Side::Right });
    assert!(!bench.is_ended());
    bench.event(Event::Recognised { pair: 1, found: found(&[[0.0, 0.0, 10.0]]) });
    let id = bench.ordered().unwrap().id;
    bench.pass(100 * MS);
    assert!(!bench.is_ended());
    bench.arm(Report::Done { id });
    assert_eq!(bench.commands(), [Command::Hold]);
    bench.arm(Report::Held { by: HeldBy::Command });
    assert_eq!(bench.actions, [Action::End(Ending::Done)]);
    let frame = bench.frame(Side::Left, bench.now);
    assert_eq!(bench.event(Event::Frame(frame)), [Action::Free(frame.handle)]);
}
