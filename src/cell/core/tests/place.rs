use firmware_bridge::message::{Disconnect, Failure, Outcome};

use super::*;

const PART: [f64; 3] = [10.0, 20.0, 5.0];

fn with_place(record: PlaceRecord) -> Params {
    let place = PlacePattern {
        first: down([-150.0, -100.0, 20.0]),
        column_step_mm: [20.0, 0.0, 0.0],
        row_step_mm: [0.0, 30.0, 0.0],
        columns: 2,
        rows: 2,
    };
    Params { place: Some(place), record, ..params() }
}

fn persisted(bench: &mut Bench) -> PlaceRecord {
    let record = bench.actions.iter().find_map(|action| match action {
        Action::Persist(record) => Some(*record),
        _ => None,
    });
    let record = record.expect("a record to write");
    bench.event(Event::Persisted(record));
    record
}

fn released(record: PlaceRecord) -> Bench {
    let mut bench = Bench::new(with_place(record), &settings(""));
    bench.arm(Report::Connected { session: 3, held_by: HeldBy::Start });
    bench.event(Event::Operator(Operator::Release));
    bench.arm(Report::Ready { clear_of_view: true });
    bench
}

#[test]
fn no_target_before_its_slot_is_on_disk() {
    let mut bench = released(PlaceRecord::default());
    let reserve = bench.actions.clone();
    bench.pass(MS);
    assert_eq!(bench.recognise(found(&[PART])), Err(NoPick::SlotNotSaved));
    bench.actions = reserve;
    let record = persisted(&mut bench);
    assert_eq!(record, PlaceRecord { next_slot: 0, next_id: 101, unfinished_id: 100 });
    bench.recognise(found(&[PART])).unwrap();
    let pick = bench.ordered().unwrap();
    assert_eq!((pick.id, pick.slot, pick.place.position_mm), (100, 0, [-150.0, -100.0, 20.0]));
}

#[test]
fn slots_are_filled_row_by_row_until_the_tray_is_full_and_emptied() {
    let mut bench = released(PlaceRecord::default());
    let mut places = Vec::new();
    for slot in 0..4 {
        persisted(&mut bench);
        bench.pass(MS);
        let id = bench.recognise(found(&[PART])).unwrap().id;
        places.push(bench.ordered().unwrap().place.position_mm);
        bench.arm(Report::Done { id });
        assert!(bench.actions.contains(&Action::Say(Note::SlotFilled { slot })));
        let record = PlaceRecord { next_slot: slot + 1, next_id: id + 1, unfinished_id: 0 };
        assert_eq!(persisted(&mut bench), record, "a filled slot is on disk even if nothing follows");
        bench.arm(Report::Ready { clear_of_view: true });
    }
    assert_eq!(places, [[-150., -100., 20.], [-130., -100., 20.], [-150., -70., 20.], [-130., -70., 20.]]);
    assert_eq!(bench.alarms(), [Alarm::PlaceFull]);
    bench.pass(MS);
    assert_eq!(bench.recognise(found(&[PART])), Err(NoPick::PlaceFull));
    bench.event(Event::Operator(Operator::Release));
    assert_eq!((persisted(&mut bench).next_slot, bench.alarms()), (0, vec![]));
    bench.pass(MS);
    assert!(bench.recognise(found(&[PART])).is_ok());
}

#[test]
fn a_tray_that_was_full_before_the_restart_is_said_to_be_before_it_counts_as_emptied() {
    let full = PlaceRecord { next_slot: 4, next_id: 105, unfinished_id: 0 };
    let mut bench = released(full);
    let alarms = bench.alarms();
    assert!(alarms.ends_with(&[Alarm::PlaceFull]), "{alarms:?}");
    assert_eq!(bench.recognise(found(&[PART])), Err(NoPick::PlaceFull));
    bench.event(Event::Operator(Operator::Release));
    assert_eq!((persisted(&mut bench).next_slot, bench.alarms()), (0, vec![]));
}

#[test]
fn what_the_end_of_a_target_means_for_its_slot() {
    // (end, slot of the next target; None = the arm is asked first)
    for (report, slot) in [
        (Report::Failed { id: 100, failure: Failure::PartNotHeld }, Some(0)),
        (Report::Refused { id: 100, refusal: firmware_bridge::message::Refusal::Busy }, Some(0)),
        (Report::Failed { id: 100, failure: Failure::TimedOut }, Some(1)),
        (Report::Failed { id: 100, failure: Failure::Held }, Some(1)),
        (Report::Lost { id: 100 }, None),
    ] {
        let mut bench = released(PlaceRecord::default());
        persisted(&mut bench);
        bench.pass(MS);
        bench.recognise(found(&[PART])).unwrap();
        bench.arm(report);
        bench.arm(Report::Ready { clear_of_view: true });
        match slot {
            Some(slot) => assert_eq!(
                persisted(&mut bench),
                PlaceRecord { next_slot: slot, next_id: 102, unfinished_id: 101 },
                "{report:?}"
            ),
            None => assert!(!bench.actions.iter().any(|a| matches!(a, Action::Persist(_)))),
        }
    }
}

#[test]
fn an_unfinished_target_is_asked_about_before_anything_is_released() {
    let record = PlaceRecord { next_slot: 1, next_id: 500, unfinished_id: 499 };
    for (outcome, next_slot) in
        [(Outcome::Done, 2), (Outcome::Refused, 1), (Outcome::Failed, 2), (Outcome::Unknown, 2)]
    {
        let mut bench = Bench::new(with_place(record), &settings("resume = \"auto\""));
        bench.arm(Report::Connected { session: 3, held_by: HeldBy::Start });
        assert_eq!(bench.commands(), [Command::Query { id: 499 }]);
        for _ in 0..3 {
            bench.arm(Report::Outcome { id: 499, outcome: Outcome::Unfinished });
            assert_eq!(bench.commands(), []);
            bench.pass(1000 * MS);
            assert_eq!(bench.commands(), [Command::Query { id: 499 }]);
        }
        bench.arm(Report::Outcome { id: 499, outcome });
        assert_eq!(bench.commands(), [Command::Release]);
        let left_out = bench.alarms() == [Alarm::SlotLeftOut { slot: 1 }];
        assert_eq!(left_out, matches!(outcome, Outcome::Failed | Outcome::Unknown), "{outcome:?}");
        bench.arm(Report::Ready { clear_of_view: true });
        let record = persisted(&mut bench);
        assert_eq!((record.next_slot, record.unfinished_id), (next_slot, 500), "{outcome:?}");
    }
}

#[test]
fn an_arm_that_does_not_answer_cannot_tell() {
    let record = PlaceRecord { next_slot: 1, next_id: 500, unfinished_id: 499 };
    let mut bench = Bench::new(with_place(record), &settings("resume = \"auto\""));
    bench.arm(Report::Connected { session: 3, held_by: HeldBy::Start });
    bench.arm(Report::Disconnected { cause: Disconnect::Silent });
    bench.pass(2000 * MS);
    bench.arm(Report::Connected { session: 4, held_by: HeldBy::Start });
    assert_eq!(bench.commands(), [Command::Query { id: 499 }]);
    bench.pass(1000 * MS);
    assert_eq!(bench.commands(), [Command::Release]);
    assert!(bench.alarms().contains(&Alarm::SlotLeftOut { slot: 1 }));
}

#[test]
fn a_disk_that_refuses_is_said_and_tried_again() {
    let mut bench = released(PlaceRecord::default());
    bench.event(Event::NotPersisted);
    assert_eq!(bench.alarms(), [Alarm::PlaceNotSaved]);
    bench.pass(989 * MS);
    assert_eq!(bench.recognise(found(&[PART])), Err(NoPick::SlotNotSaved));
    bench.pass(MS);
    persisted(&mut bench);
    assert!(bench.recognise(found(&[PART])).is_ok());
}

#[test]
fn a_clean_end_leaves_no_slot_in_question_and_an_unclean_one_does() {
    let mut bench = released(PlaceRecord::default());
    persisted(&mut bench);
    bench.event(Event::Stop);
    bench.arm(Report::Held { by: HeldBy::Command });
    assert_eq!(persisted(&mut bench), PlaceRecord { next_slot: 0, next_id: 101, unfinished_id: 0 });

    let mut bench = released(PlaceRecord::default());
    persisted(&mut bench);
    bench.pass(MS);
    bench.recognise(found(&[PART])).unwrap();
    bench.event(Event::Stop);
    bench.pass(STOP_NS);
    assert!(!bench.actions.iter().any(|a| matches!(a, Action::Persist(_))));
    assert_eq!(bench.ends(), Some(TargetEnd::Abandoned));
}
