//! What a host sees of this uArm, as transcripts.

use super::*;

struct Desk {
    uarm: UarmFirmware,
    now_ns: i64,
}

impl Desk {
    fn new() -> Self {
        let mut desk = Self { uarm: UarmFirmware::new([200.0, 0.0, 150.0], Faults::default()), now_ns: 0 };
        assert_eq!(desk.wait(1600), "\r\nGrbl 0.9j ['$' for help]\r\n@1\n");
        desk
    }

    fn wait(&mut self, ms: i64) -> String {
        let mut said = Vec::new();
        for _ in 0..ms * 10 {
            self.now_ns += MS / 10;
            let mut out = [0; 64];
            loop {
                let len = self.uarm.transmit(self.now_ns, &mut out);
                said.extend_from_slice(&out[..len]);
                if len == 0 {
                    break;
                }
            }
        }
        String::from_utf8(said).unwrap()
    }

    fn say(&mut self, text: &str, ms: i64) -> String {
        self.uarm.on_bytes(text.as_bytes(), self.now_ns);
        self.wait(ms)
    }
}

#[test]
fn a_query_overtakes_a_move_and_the_move_is_answered_when_it_is_done() {
    let mut desk = Desk::new();
    assert_eq!(desk.say("#1 G0 X180 Y0 Z150 F600\n#2 P2220\n", 100), "$2 ok X200.0000 Y0.0000 Z150.0000\n");
    assert_eq!(desk.wait(3000), "$1 ok\n");
    assert_eq!(desk.say("#3 P2220\n", 5), "$3 ok X180.0000 Y0.0000 Z150.0000\n");
}

#[test]
fn errors_have_their_numbers_or_a_bare_tag() {
    let mut desk = Desk::new();
    for (line, answer) in [
        ("#4 G1 X180", "$4\n"),
        ("#1 G0 X500 Y0 Z150 F600", "$1 E22\n"),
        ("#2 M2200", "$2 E20\n"),
        ("#3 M2231 V7", "$3 E21\n"),
        ("#5 G0 X", "$5\n"),
        ("#6 M2222 X180 Y0 Z150 P0", "$6 ok V1\n"),
        ("#7 M2222 X500 Y0 Z150 P0", "$7 ok V0\n"),
        ("#8 M2222 X500 Y0 Z150", "$8 E21\n"),
        ("#9 P2232", "$9 ok V0\n"),
        ("N1 G0 X180", ""),
        ("M2232 V1", "ok\n"),
        ("#10 P2232", "$10 ok V2\n"),
    ] {
        assert_eq!(desk.say(&format!("{line}\n"), 5), answer, "{line}");
    }
}

#[test]
fn a_hold_answers_only_the_status_and_a_reset_forgets_what_moved() {
    let mut desk = Desk::new();
    desk.say("#1 G0 X150 Y0 Z150 F600\n", 500);
    desk.say("!", 100);
    assert!(desk.say("?", 1).starts_with("<Hold,MPos:195."));
    assert_eq!(desk.say("#2 P2220\n", 100), "");
    assert_eq!(desk.say("\x18", 5), "\r\nGrbl 0.9j ['$' for help]\r\n@1\n$1 ok\n");
    assert!(desk.say("?", 1).starts_with("<Idle,MPos:195."));
}

#[test]
fn the_later_build_says_nothing_of_a_reset_and_needs_no_unlock() {
    let uarm = UarmFirmware::new([200.0, 0.0, 150.0], Faults::new(1, &[]));
    let mut desk = Desk { uarm, now_ns: 0 };
    desk.wait(1600);
    desk.say("#1 G0 X150 Y0 Z150 F600\n", 500);
    assert!(desk.say("\x18", 5).starts_with("ok\n"));
    assert!(desk.say("?", 1).starts_with("<Idle,MPos:195."));
}

#[test]
fn a_delay_keeps_the_next_command_waiting() {
    let mut desk = Desk::new();
    assert_eq!(desk.say("#1 G2004 P200\n#2 M2232 V1\n", 100), "$1 ok\n");
    assert_eq!(desk.wait(200), "$2 ok\n");
}
