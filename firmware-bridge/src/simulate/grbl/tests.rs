//! What a host sees of this Grbl, as transcripts.

use super::*;

struct Desk {
    grbl: GrblFirmware,
    now_ns: i64,
}

impl Desk {
    fn new(grbl: GrblFirmware) -> Self {
        let mut desk = Self { grbl, now_ns: 0 };
        assert_eq!(desk.wait(1000), "\r\nGrbl 1.1h ['$' for help]\r\n");
        desk
    }

    fn plain() -> Self {
        Self::new(GrblFirmware::new([0.0; 3], Faults::default()))
    }

    /// What it says within so many ms.
    fn wait(&mut self, ms: i64) -> String {
        let mut said = Vec::new();
        for _ in 0..ms * 10 {
            self.now_ns += MS / 10;
            let mut out = [0; 64];
            loop {
                let len = self.grbl.transmit(self.now_ns, &mut out);
                said.extend_from_slice(&out[..len]);
                if len == 0 {
                    break;
                }
            }
        }
        String::from_utf8(said).unwrap()
    }

    fn say(&mut self, text: &str, ms: i64) -> String {
        self.grbl.on_bytes(text.as_bytes(), self.now_ns);
        self.wait(ms)
    }

    fn state(&mut self) -> String {
        let status = self.say("?", 1);
        status[1..].split('|').next().unwrap().to_owned()
    }
}

#[test]
fn ok_is_planned_and_idle_is_arrived() {
    let mut desk = Desk::plain();
    assert_eq!(desk.say("G90 G21 G94\n", 5), "ok\r\n");
    assert_eq!(desk.say("g0 x100 (far) ; away\n", 5), "ok\r\n");
    assert_eq!(desk.state(), "Run");
    assert_eq!(desk.say("G4 P0\n", 100), "");
    assert_eq!(desk.wait(1000), "ok\r\n");
    assert!(desk.say("?", 1).starts_with("<Idle|MPos:100.000,0.000,0.000|Bf:15,128|FS:0,0"));
}

#[test]
fn errors_have_their_numbers() {
    let mut desk = Desk::plain();
    for (line, answer) in [
        ("G1 X1", "error:22"),
        ("M400", "error:20"),
        ("G0 X1 X2", "error:25"),
        ("G90 G91", "error:21"),
        ("X", "error:2"),
        ("*", "error:1"),
        ("G4", "error:28"),
        ("$H", "error:5"),
        ("$Q", "error:3"),
        ("", "ok"),
        (&"X1".repeat(50), "error:11"),
    ] {
        assert_eq!(desk.say(&format!("{line}\n"), 5), format!("{answer}\r\n"), "{line}");
    }
}

#[test]
fn the_receive_buffer_loses_what_does_not_fit_and_the_planner_makes_lines_wait() {
    let mut desk = Desk::plain();
    for n in 0..15 {
        assert_eq!(desk.say(&format!("G1 X{n}.5 F60\n"), 5), "ok\r\n", "{n}");
    }
    // The sixteenth waits for a block, and everything behind it in the buffer.
    assert_eq!(desk.say("G1 X99 F60\n", 5), "");
    desk.say(&"G1 X1 Y1 Z1\n".repeat(12), 1);
    assert_eq!(desk.grbl.rx.len(), 128);
    assert!(desk.say("?", 1).contains("|Bf:0,0|"));
    // A hold is obeyed all the same.
    desk.say("!", 100);
    assert_eq!(desk.state(), "Hold:0");
}

#[test]
fn a_hold_keeps_the_rest_and_a_reset_in_motion_is_an_alarm() {
    let mut desk = Desk::plain();
    desk.say("G0 X100\n", 100);
    assert_eq!(desk.say("!", 1), "");
    assert_eq!(desk.state(), "Hold:1");
    desk.wait(100);
    assert_eq!(desk.state(), "Hold:0");
    assert_eq!(desk.say("G0 X0\n", 100), "");
    desk.say("~", 100);
    assert_eq!(desk.state(), "Run");
    let said = desk.say("\x18", 499);
    assert_eq!(said, "ALARM:3\r\n");
    assert_eq!(desk.wait(10), "\r\nGrbl 1.1h ['$' for help]\r\n[MSG:'$H'|'$X' to unlock]\r\n");
    assert_eq!(desk.say("G0 X0\n", 5), "error:9\r\n");
    assert_eq!(desk.say("$X\n", 5), "[MSG:Caution: Unlocked]\r\nok\r\n");
    assert_eq!(desk.state(), "Idle");
}

#[test]
fn homing_answers_nothing_until_it_is_done() {
    let mut grbl = Desk { grbl: GrblFirmware::with_homing([0.0; 3], Faults::default()), now_ns: 0 };
    assert!(grbl.wait(1000).ends_with("[MSG:'$H'|'$X' to unlock]\r\n"));
    assert_eq!(grbl.say("$H\n", 1000), "");
    assert_eq!(grbl.say("?", 1000), "");
    assert_eq!(
        grbl.wait(1000),
        "ok\r\n<Idle|MPos:0.000,0.000,0.000|Bf:15,128|FS:0,0|WCO:0.000,0.000,0.000>\r\n"
    );
}

#[test]
fn a_soft_limit_locks_everything_but_a_reset() {
    let mut desk = Desk::plain();
    desk.grbl.soft_limit(desk.now_ns);
    assert_eq!(desk.wait(1), "ALARM:2\r\n[MSG:Reset to continue]\r\n");
    assert_eq!(desk.say("?$X\n", 100), "");
    assert!(desk.say("\x18", 10).contains("Grbl 1.1h"));
    assert_eq!(desk.state(), "Alarm");
}
