//! What a host sees of this Marlin, as transcripts.

use super::*;

struct Desk {
    marlin: MarlinFirmware,
    now_ns: i64,
}

impl Desk {
    fn new(marlin: MarlinFirmware) -> Self {
        let mut desk = Self { marlin, now_ns: 0 };
        assert!(desk.wait(1500).starts_with("start\r\n"));
        desk
    }

    fn wait(&mut self, ms: i64) -> String {
        let mut said = Vec::new();
        for _ in 0..ms * 10 {
            self.now_ns += MS / 10;
            let mut out = [0; 64];
            loop {
                let len = self.marlin.transmit(self.now_ns, &mut out);
                said.extend_from_slice(&out[..len]);
                if len == 0 {
                    break;
                }
            }
        }
        String::from_utf8(said).unwrap()
    }

    fn say(&mut self, text: &str, ms: i64) -> String {
        self.marlin.on_bytes(text.as_bytes(), self.now_ns);
        self.wait(ms)
    }
}

fn numbered(number: u32, text: &str) -> String {
    let line = format!("N{number} {text}");
    let sum = line.bytes().fold(0, |sum, byte| sum ^ byte);
    format!("{line}*{sum}\n")
}

#[test]
fn numbers_and_checksums_are_looked_at() {
    let mut desk = Desk::new(MarlinFirmware::new([0.0; 3], Faults::default()));
    assert_eq!(numbered(0, "M110 N0"), "N0 M110 N0*125\n");
    assert_eq!(desk.say("N0 M110 N0*125\n", 5), "ok\r\n");
    assert_eq!(desk.say(&numbered(1, "G90"), 5), "ok\r\n");
    let twice = "Error:Line Number is not Last Line Number+1, Last Line: 1\r\nResend: 2\r\nok\r\n";
    assert_eq!(desk.say(&numbered(1, "G90"), 5), twice);
    assert_eq!(desk.say("N2 G91*1\n", 5), "Error:checksum mismatch, Last Line: 1\r\nResend: 2\r\nok\r\n");
    assert_eq!(
        desk.say("N2 G91\n", 5),
        "Error:No Checksum with line number, Last Line: 1\r\nResend: 2\r\nok\r\n"
    );
    assert_eq!(desk.say("G21\n", 5), "ok\r\n");
    assert_eq!(desk.say("G123\n", 5), "echo:Unknown command: \"G123\"\r\nok\r\n");
    assert_eq!(desk.say("\n; nothing\n", 5), "");
}

#[test]
fn m400_waits_and_says_busy() {
    let mut desk = Desk::new(MarlinFirmware::new([0.0; 3], Faults::new(1, &[])));
    desk.say("N0 M110 N0*125\n", 5);
    assert_eq!(desk.say(&numbered(1, "G1 X50 F600"), 5), "ok N1 P14 B4\r\n");
    assert_eq!(desk.say(&numbered(2, "M400"), 3000), "echo:busy: processing\r\n");
    assert_eq!(desk.say("M114\n", 1000), "echo:busy: processing\r\n");
    let said = desk.wait(2000);
    assert!(
        said.ends_with("ok N2 P15 B3\r\nX:50.00 Y:0.00 Z:0.00 E:0.00 Count X:4000 Y:0 Z:0\r\nok P15 B4\r\n"),
        "{said}"
    );
}

#[test]
fn m410_is_read_before_the_queue_and_m112_ends_everything() {
    let mut desk = Desk::new(MarlinFirmware::new([0.0; 3], Faults::default()));
    // The move begins 100 ms after it was planned.
    desk.say("G1 X50 F600\n", 200);
    desk.say("M400\n", 100);
    // For a second, and for another one when it comes out of the queue.
    assert_eq!(desk.say("M410\n", 990), "");
    assert_eq!(desk.wait(20), "ok\r\n");
    assert_eq!(desk.say("G1 X0\n", 900), "");
    assert_eq!(desk.wait(100), "ok\r\nok\r\n");
    desk.say("M410\n", 2100);
    let said = desk.say("M114\n", 10);
    let at: f64 = said[2..].split(' ').next().unwrap().parse().unwrap();
    assert!(at > 1.0 && at < 3.0, "{said}");
    assert!(desk.say("M112\n", 10).starts_with("Error:Printer halted. kill() called!"));
    assert_eq!(desk.say("M114\n", 1000), "");
    desk.marlin.reset(desk.now_ns);
    assert!(desk.wait(1500).starts_with("start\r\n"));
}

#[test]
fn a_uarm_with_firmware_3_answers_by_tags_and_is_stopped_by_a_bare_m410() {
    let mut desk = Desk::new(MarlinFirmware::uarm_3([0.0, -200.0, 150.0], Faults::new(2, &[])));
    assert_eq!(desk.say("#1 P2203\n", 5), "$1 ok V3.2.0\r\n");
    assert_eq!(desk.say("?#2 P2203\n", 5), "echo:Unknown command: \"?#2 P2203\"\r\n");
    assert_eq!(desk.say("#3 G0 X50 Y-200 Z150 F600\n#4 M2200\n", 300), "$3 ok\r\n$4 ok V1\r\n");
    assert_eq!(desk.say("#5 P2220\n", 5), "$5 ok X50.00 Y-200.00 Z150.00\r\n");
    assert_eq!(desk.say("#6 M2221 B1.5 L2 R-3\n", 5), "$6 ok X1.50 Y2.00 Z-3.00\r\n");
    // What is called its stop only waits.
    assert_eq!(desk.say("#7 G2203\n", 1000), "");
    assert_eq!(desk.say("M410\n", 20), "$7 ok\r\nok\r\n");
    assert_eq!(desk.say("#8 M2200\n", 5), "$8 ok V0\r\n");
    let said = desk.say("#9 P2200\n", 5);
    assert!(said.starts_with("$9 ok B1"), "{said}");
}
