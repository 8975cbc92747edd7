//! The own protocol's machine alone, packet by packet; conversations are in tests/arm.

use super::*;
use crate::codec;
use crate::codec::tests::sealed;
use crate::gate::tests::settings;
use proptest::prelude::*;

/// Reports until there are none.
fn reports(own: &mut Own, now_ns: i64) -> Vec<Report> {
    std::iter::from_fn(|| own.poll(now_ns)).collect()
}

#[test]
fn an_arm_of_another_version_is_named_and_not_moved() {
    let mut own = Own::new(&settings(), 1);
    own.on_link(true, MS);
    let mut out = [0; crate::dialect::TRANSMIT_LEN_MIN];
    assert!(own.transmit(MS, &mut out).len > 0, "hello");
    // A welcome to session 1 as version 9 would say it.
    own.on_bytes(&sealed(&[0x89, 0, 1, 0, 0, 1, 1, 1, 0]), 2 * MS);
    assert_eq!(reports(&mut own, 2 * MS), [Report::WrongVersion { ours: 1, theirs: 9 }]);
    assert_eq!(own.command(Command::Release, 3 * MS), Err(Refusal::NotConnected));
}

#[test]
fn an_arm_that_echoes_or_prints_text_is_another_dialect() {
    let mut own = Own::new(&settings(), 1);
    own.on_link(true, 0);
    let mut out = [0; crate::dialect::TRANSMIT_LEN_MIN];
    let mut said = Vec::new();
    for second in 0..5 {
        let now_ns = second * 1000 * MS;
        let sent = own.transmit(now_ns, &mut out);
        own.on_bytes(&out[..sent.len], now_ns);
        own.on_bytes(b"Grbl 1.1h ['$' for help]\r\nerror:1\r\nerror:1\r\n", now_ns);
        own.on_bytes(b"ok T:21.3 /0.0 B:20.9 /0.0 T0:21.3 /0.0 @:0 B@:0\r\n", now_ns);
        said.extend(reports(&mut own, now_ns));
    }
    assert!(said.contains(&Report::WrongDialect), "{said:?}");
    assert!(!said.iter().any(|report| matches!(report, Report::Connected { .. })), "{said:?}");
}

fn hear(own: &mut Own, message: FromArm, now_ns: i64) {
    let mut out = [0; crate::dialect::TRANSMIT_LEN_MIN];
    let len = codec::encode(&message, &mut out).unwrap();
    own.on_bytes(&out[..len], now_ns);
}

/// An arm that is released, ready and clear of the view at 820 ms, and what it said last.
fn ready() -> (Own, codec::Status) {
    let mut own = Own::new(&settings(), 1);
    own.on_link(true, 0);
    let mut out = [0; crate::dialect::TRANSMIT_LEN_MIN];
    own.transmit(0, &mut out);
    let mut status = codec::Status {
        session: 1,
        echo: 0,
        acked: 0,
        arm: codec::ArmState::Held(HeldBy::Start),
        clear_of_view: true,
        position_known: true,
        last: None,
    };
    hear(&mut own, FromArm::Welcome(status), 800 * MS);
    own.command(Command::Release, 810 * MS).unwrap();
    own.transmit(810 * MS, &mut out);
    (status.acked, status.arm) = (1, codec::ArmState::Ready);
    hear(&mut own, FromArm::Status(status), 820 * MS);
    assert!(reports(&mut own, 820 * MS).contains(&Report::Ready { clear_of_view: true }));
    (own, status)
}

#[test]
fn a_ready_arm_that_comes_into_the_view_says_so_and_is_not_moved_by_what_was_seen_then() {
    let (mut own, mut status) = ready();
    status.clear_of_view = false;
    hear(&mut own, FromArm::Status(status), 830 * MS);
    assert_eq!(reports(&mut own, 830 * MS), [Report::Ready { clear_of_view: false }]);
    let pick = Command::Pick(crate::gate::tests::pick());
    assert_eq!(own.command(pick, 1010 * MS), Err(Refusal::SeenTooEarly));
    assert_eq!(reports(&mut own, 1010 * MS), [Report::Ready { clear_of_view: false }]);
    status.clear_of_view = true;
    hear(&mut own, FromArm::Status(status), 990 * MS);
    assert_eq!(reports(&mut own, 990 * MS), [Report::ClearOfView]);
    assert_eq!(own.command(pick, 1010 * MS), Ok(()));
}

#[test]
fn a_pick_that_waited_for_the_line_is_checked_again_when_its_bytes_are_made() {
    let (mut own, _) = ready();
    let mut bytes = [0; crate::dialect::TRANSMIT_LEN_MIN];
    // Seen at 1000 ms with a deadline of 66 ms; the line takes about 20 ms for it.
    own.command(Command::Pick(crate::gate::tests::pick()), 1010 * MS).unwrap();
    let mut long_after = own.transmit(1055 * MS, &mut bytes);
    while long_after.len > 0 {
        assert_eq!(long_after.pick, None, "its last byte would be late");
        long_after = own.transmit(1055 * MS, &mut bytes);
    }
    let refusal = Refusal::Stale { age_ms: 76, max_ms: 66 };
    assert_eq!(reports(&mut own, 1055 * MS), [Report::Refused { id: 7, refusal }]);
}

#[test]
fn a_lost_pick_is_not_made_anew_where_its_bytes_would_be_late() {
    let (mut own, status) = ready();
    let mut bytes = [0; crate::dialect::TRANSMIT_LEN_MIN];
    own.command(Command::Pick(crate::gate::tests::pick()), 1010 * MS).unwrap();
    while own.transmit(1010 * MS, &mut bytes).pick.is_none() {}
    reports(&mut own, 1010 * MS);
    // At 1055 ms the pick is fresh, its last byte would not be; the heartbeat proves that the first packet is lost.
    let mut heartbeats = 0;
    while own.transmit(1055 * MS, &mut bytes).len > 0 {
        heartbeats += 1;
        assert!(heartbeats < 10, "heartbeats without a pause");
        let echoed = codec::Status { echo: own.beat.number, ..status };
        hear(&mut own, FromArm::Status(echoed), 1055 * MS);
    }
    let refused = Report::Refused { id: 7, refusal: Refusal::NotAcknowledged };
    let ready = Report::Ready { clear_of_view: true };
    let said = reports(&mut own, 1055 * MS);
    assert!(said.contains(&refused) && said.contains(&ready), "{said:?}");
}

proptest! {
    #[test]
    fn whatever_a_sound_packet_says_nothing_panics_and_a_pick_ends_at_most_once(
        steps in proptest::collection::vec((0u8..8, 0u32..4, 0u32..6, 0u8..6, any::<bool>(), 0i64..200), 1..200),
    ) {
        let mut own = Own::new(&settings(), 1);
        let (mut now_ns, mut next_id, mut ends) = (1000 * MS, 1, std::collections::BTreeMap::new());
        own.on_link(true, now_ns);
        let mut out = [0; crate::dialect::TRANSMIT_LEN_MIN];
        for (action, session, number, state, flag, wait_ms) in steps {
            now_ns += wait_ms * MS;
            let arm = match state {
                0 => codec::ArmState::Held(HeldBy::Operator),
                1 => codec::ArmState::Busy,
                2 => codec::ArmState::Alarm { code: 9 },
                _ => codec::ArmState::Ready,
            };
            let progress = [codec::Progress::Accepted, codec::Progress::Moving, codec::Progress::Done];
            let last = codec::LastPick { id: u64::from(number), progress: progress[number as usize % 3] };
            let status = codec::Status {
                session: if flag { own.session } else { session },
                echo: number,
                acked: number,
                arm,
                clear_of_view: flag,
                position_known: state != 4,
                last: flag.then_some(last),
            };
            match action {
                0 => own.on_link(flag, now_ns),
                1 => {
                    let mut pick = crate::gate::tests::pick();
                    (pick.id, pick.session, pick.sequence) = (next_id, own.session, next_id as u32);
                    pick.seen = crate::message::Seen { left_ns: now_ns, right_ns: now_ns, period_ns: MS };
                    if own.command(Command::Pick(pick), now_ns).is_ok() {
                        ends.insert(next_id, 0);
                        next_id += 1;
                    }
                }
                2 => {
                    let commands = [Command::Hold, Command::Release, Command::Query { id: 1 }, Command::Unlock];
                    let _ = own.command(commands[number as usize % 4], now_ns);
                }
                3 => own.on_bytes(&[number as u8; 9], now_ns),
                4 => drop(own.transmit(now_ns, &mut out)),
                _ => {
                    let message =
                        if action == 5 { FromArm::Welcome(status) } else { FromArm::Status(status) };
                    let len = codec::encode(&message, &mut out).unwrap();
                    own.on_bytes(&out[..len], now_ns);
                }
            }
            for report in reports(&mut own, now_ns) {
                if let Report::Done { id }
                | Report::Failed { id, .. }
                | Report::Refused { id, .. }
                | Report::Lost { id } = report
                {
                    *ends.get_mut(&id).expect("only what was taken") += 1;
                }
            }
        }
        prop_assert!(ends.values().all(|ends| *ends <= 1));
    }
}
