//! The test vectors of PROTOCOL.md: the messages behind the names, compared with the packets written there.

use super::tests::{all, packet, wire_pick};
use super::*;
use std::collections::BTreeMap;
use std::fmt::Write;

fn to_arm() -> Vec<(&'static str, ToArm)> {
    let say = |sequence, body| ToArm { sequence, body };
    vec![
        // Session 300, heartbeat time-out 500 ms.
        ("hello", say(0, ToArmBody::Hello { session: 300, heartbeat_timeout_ms: 500 })),
        // Session 70000, id 2^40, 450 ms to live, slot 3, opening 7.5 mm, tool straight down; approach 10, 20, 45,
        // grasp 10, 20, 5, retreat 10, 20, 65, place -150, 100.25, 20.
        ("pick", say(2, ToArmBody::Pick(wire_pick()))),
        ("hold", say(5, ToArmBody::Hold)),
        ("release", say(1, ToArmBody::Release { session: 300 })),
        ("query", say(3, ToArmBody::Query { id: 1 << 40 })),
        ("heartbeat", say(0, ToArmBody::Heartbeat { session: 300, number: 128 })),
        ("unlock", say(4, ToArmBody::Unlock { session: 300 })),
    ]
}

fn from_arm() -> Vec<(&'static str, FromArm)> {
    let rest = Status {
        session: 300,
        echo: 128,
        acked: 2,
        arm: ArmState::Ready,
        clear_of_view: true,
        position_known: true,
        last: None,
    };
    let last = |progress| Some(LastPick { id: 1 << 40, progress });
    let not_held = last(Progress::Failed(Failure::PartNotHeld));
    let refused = last(Progress::Refused(ArmRefusal::Other { code: 1000 }));
    vec![
        ("started", {
            let arm = ArmState::Held(HeldBy::Start);
            FromArm::Welcome(Status { session: 0, echo: 0, acked: 0, arm, ..rest })
        }),
        (
            "welcome",
            FromArm::Welcome(Status { echo: 0, acked: 0, arm: ArmState::Held(HeldBy::LinkLost), ..rest }),
        ),
        ("ready", FromArm::Status(rest)),
        ("moving", {
            let last = last(Progress::Moving);
            FromArm::Status(Status { arm: ArmState::Busy, clear_of_view: false, last, ..rest })
        }),
        ("done", FromArm::Status(Status { last: last(Progress::Done), ..rest })),
        ("not-held", FromArm::Status(Status { last: not_held, ..rest })),
        ("refused-1000", FromArm::Status(Status { last: refused, ..rest })),
        (
            "alarm-3",
            FromArm::Status(Status { arm: ArmState::Alarm { code: 3 }, position_known: false, ..rest }),
        ),
        ("outcome-done", FromArm::Outcome { id: 1 << 40, progress: Some(Progress::Done) }),
        ("outcome-unknown", FromArm::Outcome { id: 1 << 40, progress: None }),
    ]
}

/// The vectors as they stand in PROTOCOL.md.
fn written() -> BTreeMap<(String, String), Vec<u8>> {
    let text = include_str!("../../PROTOCOL.md");
    let block = text
        .split("```vectors\n")
        .nth(1)
        .and_then(|rest| rest.split("```").next())
        .expect("a block of vectors");
    let vector = |line: &str| {
        let mut words = line.split_whitespace().map(String::from);
        let name = (words.next().unwrap(), words.next().unwrap());
        (name, words.map(|byte| u8::from_str_radix(&byte, 16).unwrap()).collect())
    };
    block.lines().map(vector).collect()
}

#[test]
fn the_vectors_of_the_document_are_those_of_the_code() {
    let mut made = BTreeMap::new();
    for (name, message) in to_arm() {
        made.insert(("to-arm".to_string(), name.to_string()), packet(&message));
        assert_eq!(all::<ToArm>(&mut Decoder::new(), &packet(&message)), [Ok(message)]);
    }
    for (name, message) in from_arm() {
        made.insert(("from-arm".to_string(), name.to_string()), packet(&message));
        assert_eq!(all::<FromArm>(&mut Decoder::new(), &packet(&message)), [Ok(message)]);
    }
    let mut expected = String::new();
    for ((direction, name), bytes) in &made {
        let hex: Vec<String> = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        writeln!(expected, "{direction} {name} {}", hex.join(" ")).unwrap();
    }
    assert!(made == written(), "the code makes these packets:\n{expected}");
}

#[test]
fn the_lengths_of_the_document_are_those_of_the_code() {
    let mut pick = wire_pick();
    (pick.session, pick.id, pick.ttl_ms, pick.slot) = (u32::MAX, u64::MAX, u32::MAX, u32::MAX);
    let longest = packet(&ToArm { sequence: u32::MAX, body: ToArmBody::Pick(pick) }).len();
    let last = LastPick { id: u64::MAX, progress: Progress::Failed(Failure::Controller { code: u16::MAX }) };
    let status = Status {
        session: u32::MAX,
        echo: u32::MAX,
        acked: u32::MAX,
        arm: ArmState::Alarm { code: u16::MAX },
        clear_of_view: true,
        position_known: true,
        last: Some(last),
    };
    let answer = packet(&FromArm::Status(status)).len();
    let text = include_str!("../../PROTOCOL.md");
    let said =
        format!("One packet to the arm is at most {longest}\nbytes, one from the arm at most {answer}.");
    assert!(text.contains(&said), "{said}");
}

#[test]
fn the_checksum_is_the_usual_one() {
    assert_eq!(CRC.checksum(b"123456789"), 0xCBF4_3926);
}
