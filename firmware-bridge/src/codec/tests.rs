//! Round trips, resynchronisation after anything, and the vectors of PROTOCOL.md.

use super::*;
use proptest::prelude::*;

pub(super) fn wire_pick() -> WirePick {
    let at = |x, y, z| WirePose { position_mm: [x, y, z], orientation_xyzw: [1.0, 0.0, 0.0, 0.0] };
    WirePick {
        session: 70_000,
        id: 1 << 40,
        ttl_ms: 450,
        slot: 3,
        opening_mm: 7.5,
        approach: at(10.0, 20.0, 45.0),
        grasp: at(10.0, 20.0, 5.0),
        retreat: at(10.0, 20.0, 65.0),
        place: at(-150.0, 100.25, 20.0),
    }
}

fn status() -> Status {
    let last = LastPick { id: 9, progress: Progress::Failed(Failure::PartNotHeld) };
    Status {
        session: 5,
        echo: 6,
        acked: 7,
        arm: ArmState::Held(HeldBy::Operator),
        clear_of_view: true,
        position_known: true,
        last: Some(last),
    }
}

pub(super) fn packet<M: Message>(message: &M) -> Vec<u8> {
    let mut out = [0; PACKET_LEN_MAX];
    let len = encode(message, &mut out).unwrap();
    out[..len].to_vec()
}

pub(super) fn all<M: Message>(decoder: &mut Decoder, bytes: &[u8]) -> Vec<Result<M, PacketError>> {
    bytes.iter().filter_map(|&b| decoder.push(b)).collect()
}

#[test]
fn the_longest_messages_fit_and_come_back() {
    let mut pick = wire_pick();
    pick.id = u64::MAX;
    (pick.session, pick.ttl_ms, pick.slot) = (u32::MAX, u32::MAX, u32::MAX);
    let message = ToArm { sequence: u32::MAX, body: ToArmBody::Pick(pick) };
    assert_eq!(all(&mut Decoder::new(), &packet(&message)), [Ok(message)]);
    let welcome = FromArm::Welcome(status());
    assert_eq!(all(&mut Decoder::new(), &packet(&welcome)), [Ok(welcome)]);
}

#[test]
fn another_version_and_unknown_messages_are_told_apart_from_garbage() {
    let mut decoder = Decoder::new();
    let results: Vec<Result<ToArm, _>> = all(&mut decoder, &sealed(&[2, 0, 9]));
    assert_eq!(results, [Err(PacketError::WrongVersion { theirs: 2 })]);
    assert!(results[0].unwrap_err().to_string().contains("speaks version 2 of the protocol, this side 1"));
    let results: Vec<Result<ToArm, _>> = all(&mut decoder, &sealed(&[1, 0, 99]));
    assert_eq!(results, [Err(PacketError::UnknownMessage { bytes: 8 })]);
    let results: Vec<Result<ToArm, _>> = all(&mut decoder, b"start\nok\n\0");
    assert_eq!(results, [Err(PacketError::Garbage { bytes: 9 })]);
    let long = [7u8; PACKET_LEN_MAX + 40];
    let results: Vec<Result<ToArm, _>> = all(&mut decoder, &[&long[..], &[0]].concat());
    assert_eq!(results, [Err(PacketError::Garbage { bytes: PACKET_LEN_MAX + 40 })]);
}

/// A sound packet with this content.
pub(crate) fn sealed(content: &[u8]) -> Vec<u8> {
    let mut sealed = content.to_vec();
    sealed.extend(CRC.checksum(content).to_le_bytes());
    let mut out = cobs::encode_vec_like(&sealed);
    out.push(0);
    out
}

/// Plain COBS, written down anew from the definition.
mod cobs {
    pub(super) fn encode_vec_like(bytes: &[u8]) -> Vec<u8> {
        let mut out = Vec::new();
        for block in bytes.split(|&b| b == 0) {
            assert!(block.len() < 254);
            out.push(block.len() as u8 + 1);
            out.extend(block);
        }
        out
    }
}

#[test]
fn an_echo_is_no_answer() {
    let echo = packet(&ToArm { sequence: 1, body: ToArmBody::Hold });
    let results = all::<FromArm>(&mut Decoder::new(), &echo);
    assert!(matches!(results[..], [Err(PacketError::Garbage { .. })]));
}

#[test]
fn a_buffer_that_is_too_short_is_refused() {
    assert_eq!(encode(&ToArm { sequence: 1, body: ToArmBody::Hold }, &mut [0; 8]), Err(TooLong));
}

proptest! {
    #[test]
    fn garbage_never_panics_and_the_next_packet_is_found(garbage in proptest::collection::vec(any::<u8>(), 0..600)) {
        let mut decoder = Decoder::new();
        let _ = all::<FromArm>(&mut decoder, &garbage);
        // A packet starts with a delimiter, so whatever stands before it does no harm.
        let message = FromArm::Status(status());
        let last = all::<FromArm>(&mut decoder, &packet(&message)).pop();
        prop_assert_eq!(last, Some(Ok(message)));
    }

    #[test]
    fn a_damaged_packet_is_never_taken_for_another(at in 0usize..160, flip in 1u8..=255) {
        let message = ToArm { sequence: 4, body: ToArmBody::Pick(wire_pick()) };
        let mut bytes = packet(&message);
        let at = at % bytes.len();
        bytes[at] ^= flip;
        bytes.push(0);
        for result in all::<ToArm>(&mut Decoder::new(), &bytes) {
            // A damaged delimiter may leave the packet itself whole.
            prop_assert!(result.is_err() || result == Ok(message));
        }
    }

    #[test]
    fn a_lost_or_doubled_byte_is_never_taken_for_another(at in 0usize..160, double in any::<bool>()) {
        let message = ToArm { sequence: 4, body: ToArmBody::Pick(wire_pick()) };
        let mut bytes = packet(&message);
        let at = at % bytes.len();
        if double { bytes.insert(at, bytes[at]) } else { bytes.remove(at); }
        bytes.push(0);
        for result in all::<ToArm>(&mut Decoder::new(), &bytes) {
            prop_assert!(result.is_err() || result == Ok(message));
        }
    }
}
