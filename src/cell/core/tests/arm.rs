use firmware_bridge::message::{Disconnect, Failure, Refusal, Waypoint};

use super::*;

const PART: [f64; 3] = [10.0, 20.0, 5.0];
const OTHER: [f64; 3] = [60.0, 20.0, 5.0];

fn order(bench: &mut Bench) -> Pick {
    bench.recognise(found(&[PART])).unwrap();
    bench.ordered().unwrap()
}

#[test]
fn a_target_passes_through_all_its_stages() {
    let mut bench = Bench::looking(params(), &settings(""));
    let seen = bench.now;
    let pick = order(&mut bench);
    assert_eq!((pick.id, pick.session, pick.sequence), (100, 3, 1));
    assert_eq!(pick.approach.position_mm, [10.0, 20.0, 45.0]);
    assert_eq!(pick.retreat.position_mm, [10.0, 20.0, 65.0]);
    assert_eq!((pick.deadline_ms, pick.ttl_ms, pick.seen.left_ns), (66, 500, seen.0));
    let id = pick.id;
    assert_eq!(bench.state(), State::Ordered);
    bench.arm(Report::Sent { id, at_ns: seen.0 + 12 * MS });
    let sent = Note::Sent { id, frame_to_wire_ns: 12 * MS, deadline_kept: true };
    assert_eq!((bench.state(), &bench.actions[..]), (State::Sent, &[Action::Say(sent)][..]));
    bench.arm(Report::Accepted { id });
    assert_eq!(bench.state(), State::Accepted);
    bench.arm(Report::Moving { id });
    assert_eq!(bench.state(), State::Moving);
    assert_eq!(bench.recognise(found(&[OTHER])), Err(NoPick::ArmBusy));
    bench.arm(Report::Done { id });
    assert_eq!((bench.ends(), bench.state()), (Some(TargetEnd::Done), State::Releasing));
    assert_eq!(bench.recognise(found(&[OTHER])), Err(NoPick::ArmNotReady));
    bench.arm(Report::Ready { clear_of_view: true });
    bench.pass(MS);
    assert_eq!(bench.recognise(found(&[OTHER])).unwrap().id, 101);
    assert_eq!(bench.ordered().unwrap().sequence, 2);
}

#[test]
fn a_pair_counts_only_if_both_frames_are_later_than_clear_of_view_and_the_last_end() {
    // Clear of view long before the end of the motion: the end counts.
    let mut bench = Bench::looking(params(), &settings(""));
    let id = order(&mut bench).id;
    bench.arm(Report::Moving { id });
    bench.arm(Report::ClearOfView);
    bench.pass(20 * MS);
    bench.pair();
    bench.arm(Report::Done { id });
    bench.arm(Report::Ready { clear_of_view: true });
    bench.event(Event::Recognised { pair: 2, found: found(&[OTHER]) });
    assert_eq!(bench.outcome(), Some(Err(NoPick::NotClear)));
    // One frame a nanosecond before is enough to refuse; of two later ones a target is made.
    let ended = bench.now;
    for (left_ns, right_ns, expected) in
        [(1, 0, Err(NoPick::NotClear)), (0, 1, Err(NoPick::NotClear)), (1, 1, Ok(101))]
    {
        let left = bench.frame(Side::Left, Timestamp(ended.0 + left_ns));
        let right = bench.frame(Side::Right, Timestamp(ended.0 + right_ns));
        bench.event(Event::Frame(left));
        bench.event(Event::Frame(right));
        let pair = bench.job().unwrap().pair.number;
        bench.event(Event::Recognised { pair, found: found(&[OTHER]) });
        assert_eq!(bench.outcome().unwrap().map(|sent| sent.id), expected);
    }
}

#[test]
fn a_picture_from_before_ready_does_not_count_though_the_arm_was_clear() {
    let mut bench = Bench::new(params(), &settings(""));
    bench.arm(Report::Connected { session: 3, held_by: HeldBy::Start });
    bench.event(Event::Operator(Operator::Release));
    bench.arm(Report::ClearOfView);
    bench.pass(4 * MS);
    bench.pair();
    bench.pass(4 * MS);
    bench.arm(Report::Ready { clear_of_view: true });
    bench.event(Event::Recognised { pair: 1, found: found(&[PART]) });
    assert_eq!(bench.outcome(), Some(Err(NoPick::NotClear)));
    bench.pass(MS);
    order(&mut bench);
}

#[test]
fn after_a_target_that_was_not_taken_the_next_goes_out_when_the_link_says_ready() {
    let mut bench = Bench::looking(params(), &settings(""));
    let id = order(&mut bench).id;
    bench.event(Event::NotTaken { id, refusal: Refusal::SeenTooEarly });
    assert_eq!(bench.ends(), Some(TargetEnd::Refused(Refusal::SeenTooEarly)));
    bench.pass(MS);
    assert_eq!(bench.recognise(found(&[PART])), Err(NoPick::ArmNotReady));
    bench.arm(Report::Ready { clear_of_view: true });
    bench.pass(MS);
    assert_eq!(order(&mut bench).id, id + 1);
}

#[test]
fn a_stamp_at_the_end_of_the_frame_is_taken_for_a_period_earlier() {
    for (mark, ahead_ms, sent) in [
        (TimestampMark::StartOfExposure, 1, true),
        (TimestampMark::EndOfFrame, 33, false),
        (TimestampMark::EndOfFrame, 34, true),
        (TimestampMark::HandedOver, 40, false),
        (TimestampMark::HandedOver, 41, true),
    ] {
        let mut bench = Bench::looking(Params { handed_over_lag_ns: 41 * MS, ..params() }, &settings(""));
        bench.pass((ahead_ms - 1) * MS);
        for side in Side::BOTH {
            let mut frame = bench.frame(side, bench.now);
            frame.mark = mark;
            // Clear since 1 ms before `looking` returned.
            frame.timestamp = Timestamp(frame.timestamp.0 + i64::from(sent));
            bench.event(Event::Frame(frame));
        }
        bench.event(Event::Recognised { pair: 1, found: found(&[PART]) });
        assert_eq!(bench.ordered().is_some(), sent, "{mark:?} {ahead_ms}");
    }
}

#[test]
fn an_arm_that_comes_into_the_view_while_it_is_ready_is_waited_for() {
    let mut bench = Bench::looking(params(), &settings(""));
    bench.arm(Report::Ready { clear_of_view: false });
    bench.pass(1000 * MS);
    assert_eq!(bench.state(), State::Looking);
    assert_eq!(bench.recognise(found(&[PART])), Err(NoPick::NotClear));
    bench.arm(Report::ClearOfView);
    bench.pass(MS);
    assert!(bench.recognise(found(&[PART])).is_ok());
}

#[test]
fn an_arm_that_never_answers_is_said_once() {
    let mut bench = Bench::new(params(), &settings(""));
    bench.pass(7900 * MS);
    assert!(!bench.alarms().contains(&Alarm::ArmSilent));
    bench.pass(100 * MS);
    assert!(bench.alarms().contains(&Alarm::ArmSilent));
    bench.pass(60_000 * MS);
    assert!(!bench.alarms().contains(&Alarm::ArmSilent));
    let mut bench = Bench::looking(params(), &settings(""));
    bench.pass(60_000 * MS);
    assert!(!bench.alarms().contains(&Alarm::ArmSilent));
}

#[test]
fn an_arm_that_never_says_it_is_clear_gets_its_dwell() {
    let mut bench = Bench::new(params(), &settings(""));
    bench.arm(Report::Connected { session: 3, held_by: HeldBy::Start });
    bench.event(Event::Operator(Operator::Release));
    bench.arm(Report::Ready { clear_of_view: false });
    bench.pass(51 * MS);
    let id = order(&mut bench).id;
    bench.arm(Report::Done { id });
    bench.arm(Report::Ready { clear_of_view: false });
    bench.pass(20 * MS);
    assert_eq!(bench.recognise(found(&[OTHER])), Err(NoPick::NotClear));
    bench.arm(Report::Ready { clear_of_view: false });
    bench.pass(21 * MS);
    assert!(bench.recognise(found(&[OTHER])).is_ok());
}

#[test]
fn the_cell_comes_up_on_hold_and_says_so() {
    let mut bench = Bench::new(params(), &settings(""));
    assert_eq!(bench.recognise(found(&[PART])), Err(NoPick::ArmAbsent));
    bench.arm(Report::Connected { session: 1, held_by: HeldBy::Start });
    assert_eq!((bench.alarms(), bench.commands()), (vec![Alarm::OnHold { by: HeldBy::Start }], vec![]));
    assert_eq!(bench.recognise(found(&[PART])), Err(NoPick::OnHold));
    // A stray word of being ready releases nothing.
    bench.arm(Report::Ready { clear_of_view: true });
    assert_eq!(bench.state(), State::Held);
    bench.event(Event::Operator(Operator::Release));
    assert_eq!((bench.commands(), bench.state()), (vec![Command::Release], State::Releasing));
    assert_eq!(bench.recognise(found(&[PART])), Err(NoPick::ArmNotReady));
}

#[test]
fn who_may_release_depends_on_why_it_holds() {
    use HeldBy::*;
    for (by, auto) in [
        (Start, true),
        (ControllerReset, true),
        (HeartbeatLost, true),
        (LinkLost, true),
        (Command, false),
        (Alarm, false),
        (Operator, false),
    ] {
        for (resume, expected) in [("manual", false), ("auto", auto)] {
            let mut bench = Bench::new(params(), &settings(&format!("resume = \"{resume}\"")));
            bench.arm(Report::Connected { session: 1, held_by: by });
            let released = bench.commands() == [firmware_bridge::message::Command::Release];
            assert_eq!(released, expected, "{by:?} {resume}");
            assert_eq!(bench.alarms().is_empty(), expected, "a hold that stays is said");
        }
    }
}

#[test]
fn the_operators_hold_outlives_a_reconnection() {
    let mut bench = Bench::looking(params(), &settings("resume = \"auto\""));
    bench.event(Event::Operator(Operator::Hold));
    assert_eq!((bench.commands(), bench.state()), (vec![Command::Hold], State::Held));
    bench.arm(Report::Disconnected { cause: Disconnect::PortGone });
    bench.arm(Report::Connected { session: 4, held_by: HeldBy::Start });
    assert_eq!(bench.commands(), []);
    bench.event(Event::Operator(Operator::Release));
    assert_eq!(bench.commands(), [Command::Release]);
}

#[test]
fn after_a_suspend_nothing_moves_before_the_operators_release() {
    let mut bench = Bench::looking(params(), &settings("resume = \"auto\""));
    let id = order(&mut bench).id;
    bench.arm(Report::Sent { id, at_ns: bench.now.0 });
    let before = bench.now;
    bench.now = Timestamp(before.0 + 3_600_000 * MS);
    bench.event(Event::Suspended { for_ns: 3_599_999 * MS });
    assert_eq!(bench.alarms(), [Alarm::Suspended { seconds: 3600 }]);
    assert_eq!(bench.commands(), [Command::Hold, Command::Hello]);
    assert_eq!((bench.ends(), bench.state()), (Some(TargetEnd::Lost), State::Absent));
    // The arm held by itself when the heartbeat stopped; without a suspend `auto` would release it.
    bench.arm(Report::Connected { session: 4, held_by: HeldBy::HeartbeatLost });
    assert_eq!((bench.commands(), bench.state()), (vec![], State::Held));
    bench.event(Event::Operator(Operator::Release));
    assert_eq!(bench.commands(), [Command::Release]);
    bench.arm(Report::Ready { clear_of_view: true });
    bench.pass(MS);
    assert!(bench.recognise(found(&[OTHER])).is_ok());
}

#[test]
fn a_result_from_before_a_suspend_is_late_and_one_of_after_it_finds_the_arm_on_hold() {
    let mut bench = Bench::looking(params(), &settings(""));
    bench.pair();
    let pair = bench.job().unwrap().pair.number;
    bench.now = Timestamp(bench.now.0 + 60_000 * MS);
    bench.event(Event::Suspended { for_ns: 60_000 * MS });
    bench.event(Event::Recognised { pair, found: found(&[PART]) });
    assert_eq!(bench.outcome(), Some(Err(NoPick::Late)));
    // Shorter than the deadline: it is not late, and still no target of a world that may have changed.
    bench.arm(Report::Connected { session: 4, held_by: HeldBy::Command });
    bench.event(Event::Operator(Operator::Release));
    bench.arm(Report::Ready { clear_of_view: true });
    bench.pass(MS);
    bench.pair();
    let pair = bench.job().unwrap().pair.number;
    bench.event(Event::Suspended { for_ns: 20 * MS });
    bench.event(Event::Recognised { pair, found: found(&[PART]) });
    assert_eq!(bench.outcome(), Some(Err(NoPick::ArmAbsent)));
    assert_eq!(bench.ordered(), None);
}

#[test]
fn a_hold_waits_for_its_confirmation_before_it_is_released() {
    let mut bench = Bench::looking(params(), &settings(""));
    bench.event(Event::Operator(Operator::Hold));
    bench.event(Event::Operator(Operator::Release));
    assert_eq!(bench.commands(), []);
    bench.arm(Report::Held { by: HeldBy::Command });
    assert_eq!(bench.commands(), [Command::Release]);
    bench.event(Event::Operator(Operator::Release));
    assert_eq!(bench.alarms(), [Alarm::NothingToRelease]);
}

#[test]
fn an_alarm_is_left_by_unlock_then_release() {
    let mut bench = Bench::looking(params(), &settings("resume = \"auto\""));
    bench.arm(Report::Alarm { code: 3 });
    assert_eq!((bench.state(), bench.alarms()), (State::Alarmed, vec![Alarm::Controller { code: 3 }]));
    assert_eq!(bench.recognise(found(&[PART])), Err(NoPick::InAlarm));
    bench.event(Event::Operator(Operator::Release));
    assert_eq!(bench.commands(), [Command::Unlock]);
    bench.arm(Report::Held { by: HeldBy::Alarm });
    assert_eq!(bench.commands(), [Command::Release]);
}

#[test]
fn a_part_is_tried_again_then_the_next_best_then_that_is_said() {
    let mut bench = Bench::looking(params(), &settings(""));
    let fail = |bench: &mut Bench, expected: Result<u8, NoPick>| {
        let sent = bench.recognise(found(&[PART, OTHER]));
        assert_eq!(sent.map(|sent| sent.candidate), expected);
        if let Ok(TargetSent { id, .. }) = sent {
            bench.arm(Report::Failed { id, failure: Failure::PartNotHeld });
            bench.arm(Report::Ready { clear_of_view: true });
            bench.pass(MS);
        }
    };
    for candidate in [0, 0, 1, 1] {
        fail(&mut bench, Ok(candidate));
    }
    fail(&mut bench, Err(NoPick::AllDeferred));
    assert_eq!(bench.alarms(), [Alarm::AllDeferred]);
    fail(&mut bench, Err(NoPick::AllDeferred));
    assert_eq!(bench.alarms(), []);
    // Not for ever.
    bench.pass(10_000 * MS);
    fail(&mut bench, Ok(0));
    assert_eq!((bench.count(Cause::Failed), bench.count(Cause::Ordered)), (5, 5));
}

#[test]
fn a_refusal_of_the_part_itself_is_not_tried_again_and_one_of_the_moment_is() {
    let tilted = Refusal::Tilted { at: Waypoint::Grasp, tilt_deg: 50.0 };
    for (refusal, next) in [(tilted, 1), (Refusal::Unreachable, 1), (Refusal::Busy, 0), (Refusal::OnHold, 0)]
    {
        let mut bench = Bench::looking(params(), &settings(""));
        let id = order(&mut bench).id;
        bench.arm(Report::Refused { id, refusal });
        assert_eq!(bench.ends(), Some(TargetEnd::Refused(refusal)));
        bench.arm(Report::Ready { clear_of_view: true });
        bench.pass(MS);
        assert_eq!(bench.recognise(found(&[PART, OTHER])).unwrap().candidate, next, "{refusal:?}");
    }
}

#[test]
fn the_gate_passes_over_a_candidate_and_gives_its_reason_when_none_is_left() {
    let mut bench = Bench::looking(params(), &settings(""));
    let outside = [190.0, 0.0, 290.0];
    assert_eq!(bench.recognise(found(&[outside, PART])).unwrap().candidate, 1);
    let id = bench.ordered().unwrap().id;
    bench.arm(Report::Done { id });
    bench.arm(Report::Ready { clear_of_view: true });
    bench.pass(MS);
    let why = bench.recognise(found(&[outside])).unwrap_err();
    let NoPick::Gate(refusal) = why else { panic!("{why:?}") };
    assert_eq!(refusal.to_string(), "outside the workspace: approach z = 330.0 mm");
}

#[test]
fn a_result_after_the_deadline_is_never_sent() {
    let mut bench = Bench::looking(params(), &settings(""));
    bench.pair();
    bench.pass(66 * MS + 1);
    bench.event(Event::Recognised { pair: 1, found: found(&[PART]) });
    assert_eq!((bench.outcome(), bench.ordered()), (Some(Err(NoPick::Late)), None));
    assert_eq!(bench.count(Cause::DeadlineMissed), 1);
}

#[test]
fn a_target_is_lost_with_its_link_and_said_once() {
    for report in [
        Report::Disconnected { cause: Disconnect::Silent },
        Report::Connected { session: 9, held_by: HeldBy::LinkLost },
        Report::ReportsLost,
    ] {
        let mut bench = Bench::looking(params(), &settings(""));
        let id = order(&mut bench).id;
        bench.arm(report);
        assert_eq!(bench.ends(), Some(TargetEnd::Lost), "{report:?}");
        assert_eq!(bench.arm(Report::Done { id }), [], "too late");
        assert_eq!((bench.count(Cause::Lost), bench.count(Cause::StrayReports)), (1, 1));
    }
}

#[test]
fn a_target_that_never_ends_is_held_lost_and_followed_by_a_new_session() {
    let mut bench = Bench::looking(params(), &settings("resume = \"auto\""));
    let id = order(&mut bench).id;
    // The link says so first, as a pick that failed, when the arm stands.
    bench.pass(5001 * MS);
    assert!(!bench.alarms().contains(&Alarm::TargetTimedOut { id }) && bench.commands().is_empty());
    bench.pass(11_000 * MS);
    assert!(bench.alarms().contains(&Alarm::TargetTimedOut { id }));
    assert_eq!(
        (bench.commands(), bench.ends()),
        (vec![Command::Hold, Command::Hello], Some(TargetEnd::Lost))
    );
    assert_eq!(bench.state(), State::Absent);
}

#[test]
fn stop_holds_the_arm_and_ends_when_it_says_so_or_after_a_while() {
    let mut bench = Bench::looking(params(), &settings(""));
    let id = order(&mut bench).id;
    bench.pair();
    bench.event(Event::Stop);
    assert_eq!((bench.commands(), bench.state()), (vec![Command::Hold], State::Stopping));
    bench.event(Event::Recognised { pair: 2, found: found(&[OTHER]) });
    assert_eq!(bench.outcome(), Some(Err(NoPick::Stopping)));
    let again =
        |bench: &Bench| Bench { core: bench.core.clone(), now: bench.now, actions: vec![], handles: 0 };
    let mut deaf = again(&bench);
    bench.arm(Report::Held { by: HeldBy::Command });
    assert_eq!(bench.actions, []);
    let mut silent = again(&bench);
    bench.arm(Report::Failed { id, failure: Failure::Held });
    assert_eq!(bench.actions.last(), Some(&Action::End(Ending::Done)));
    assert_eq!(bench.ends(), Some(TargetEnd::Failed(Failure::Held)));
    // It holds and forgets to say how the target ended; it does not even say that it holds.
    silent.pass(1000 * MS);
    assert_eq!((silent.ends(), silent.is_ended()), (Some(TargetEnd::Lost), true));
    deaf.pass(STOP_NS - 1);
    assert_eq!((deaf.ends(), deaf.is_ended()), (None, false));
    deaf.pass(1);
    assert_eq!((deaf.ends(), deaf.is_ended()), (Some(TargetEnd::Abandoned), true));
}

#[test]
fn an_arm_of_another_version_ends_the_cell_before_anything_moved_but_not_later() {
    let wrong = Report::WrongVersion { ours: 1, theirs: 2 };
    let mut bench = Bench::new(params(), &settings(""));
    bench.arm(wrong);
    assert_eq!(bench.actions.last(), Some(&Action::End(Ending::WrongArm)));
    assert!(bench.alarms()[0].to_string().contains("speaks version 2 of the protocol, this cell version 1"));
    let mut bench = Bench::looking(params(), &settings(""));
    bench.arm(wrong);
    assert_eq!((bench.is_ended(), bench.state()), (false, State::Absent));
}
