//! Marlin's end of the wire against what the other end says, byte by byte.

use super::*;
use crate::config::Settings;
use crate::dialect::TRANSMIT_LEN_MIN;
use crate::message::{Command, Disconnect, Failure, HeldBy, Refusal, Report};

mod early;
mod late;

/// The cell's end, a clock, and a person who types what Marlin would say.
struct Desk {
    marlin: Marlin,
    now_ns: i64,
    reports: Vec<Report>,
    /// The longest delay of the line that was measured.
    delay_us: u32,
}

impl Desk {
    fn new() -> Self {
        let settings = Settings::parse(
            "[arm]\ndialect = \"marlin\"\naxes = \"xyz\"\nbanner_wait_ms = 100\nheartbeat_ms = 10000\n\
             heartbeat_timeout_ms = 60000\n[workspace]\nmin_mm = [-200, -200, 0]\nmax_mm = [200, 200, 300]\n",
        )
        .unwrap();
        let marlin = Marlin::new(&settings, 6).unwrap();
        let mut desk = Self { marlin, now_ns: 10_000 * MS, reports: Vec::new(), delay_us: 0 };
        desk.marlin.on_link(true, desk.now_ns);
        desk
    }

    /// What is sent within so many ms, its checksums looked at and left out, `|` before urgent bytes.
    fn wait(&mut self, ms: i64) -> String {
        let mut sent = String::new();
        let mut out = [0; TRANSMIT_LEN_MIN];
        for _ in 0..ms {
            self.now_ns += MS;
            while let Some(report) = self.marlin.poll(self.now_ns) {
                match report {
                    Report::Heartbeat { delay_us } => self.delay_us = self.delay_us.max(delay_us),
                    _ => self.reports.push(report),
                }
            }
            loop {
                let done = self.marlin.transmit(self.now_ns, &mut out);
                if done.len == 0 {
                    break;
                }
                sent.push_str(if done.urgent { "|" } else { "" });
                let text = core::str::from_utf8(&out[..done.len]).unwrap();
                sent.push_str(&without_checksum(text).escape_default().to_string());
            }
        }
        sent
    }

    fn hear(&mut self, text: &str) -> String {
        self.marlin.on_bytes(text.as_bytes(), self.now_ns);
        self.wait(2)
    }

    fn told(&mut self) -> Vec<Report> {
        std::mem::take(&mut self.reports)
    }

    fn connect(&mut self) {
        assert_eq!(self.wait(2), "|\\nM410\\n");
        assert_eq!(self.hear("start\r\necho:Marlin 2.1.2\r\n"), "N1 M115\\n");
        // An `ok` too many is not the answer.
        assert_eq!(self.hear("ok\r\n"), "");
        assert_eq!(
            self.hear("FIRMWARE_NAME:Marlin 2.1.2 (Dec 2024)\r\nCap:EEPROM:1\r\nok\r\n"),
            "N2 M114\\n"
        );
        // Some builds answer on the line of the `ok`.
        self.hear("ok N2 P15 B3 X:0.00 Y:0.00 Z:0.00 E:0.00 Count X:0 Y:0 Z:0\r\n");
        assert_eq!(self.told(), [Report::Connected { session: 7, held_by: HeldBy::Start }]);
    }

    fn make_ready(&mut self) {
        self.connect();
        self.marlin.command(Command::Release, self.now_ns).unwrap();
        assert_eq!(self.wait(2), "N3 M400\\n");
        assert_eq!(self.hear("ok\r\n"), "N4 M114\\n");
        assert_eq!(self.hear(&at(0.0)), "N5 G90\\n");
        assert_eq!(self.hear("ok\r\n"), "N6 G21\\n");
        // A build without inches does not know G21.
        assert_eq!(self.hear("echo:Unknown command: \"G21\"\r\nok\r\n"), "N7 M107\\n");
        self.hear("ok\r\n");
        assert_eq!(self.told(), [Report::Ready { clear_of_view: false }]);
    }

    /// A pick whose moves were all acknowledged: M400 waits for them.
    fn wait_for_moves(&mut self) {
        self.make_ready();
        self.pick();
        self.hear("ok\r\n");
        self.hear("ok\r\n");
        assert_eq!(self.hear("ok\r\n"), "N11 M400\\n");
    }

    /// A pick whose first move is on its way.
    fn pick(&mut self) -> String {
        let mut pick = crate::gate::tests::pick();
        pick.seen.left_ns = self.now_ns + MS;
        pick.seen.right_ns = self.now_ns + MS;
        pick.session = 7;
        self.now_ns += 2 * MS;
        self.marlin.command(Command::Pick(pick), self.now_ns).unwrap();
        self.wait(1)
    }
}

/// A numbered line without its checksum, which must be right; other lines as they are.
fn without_checksum(text: &str) -> String {
    if !text.starts_with('N') {
        return text.into();
    }
    let (line, sum) = text.trim_end().split_once('*').expect("a numbered line has a checksum");
    assert_eq!(line.bytes().fold(0, |sum, byte| sum ^ byte).to_string(), sum, "{text}");
    format!("{line}\n")
}

/// An answer to M114 with all coordinates alike.
fn at(mm: f64) -> String {
    let steps = mm * 80.0;
    format!("X:{mm:.2} Y:{mm:.2} Z:{mm:.2} E:0.00 Count X:{steps} Y:{steps} Z:{steps}\r\nok\r\n")
}

/// What Marlin says to a line that it has already.
fn taken(number: u32) -> String {
    let next = number + 1;
    format!("Error:Line Number is not Last Line Number+1, Last Line: {number}\r\nResend: {next}\r\nok\r\n")
}

#[test]
fn moves_are_numbered_one_by_one_and_stand_before_the_gripper() {
    let mut desk = Desk::new();
    desk.make_ready();
    assert_eq!(desk.pick(), "N8 G0 X10.000 Y20.000 Z65.000 F6000\\n");
    assert_eq!(desk.wait(100), "");
    assert_eq!(desk.hear("ok N8 P14 B3\r\n"), "N9 G0 Z45.000 F6000\\n");
    // The acknowledgement of another line.
    assert_eq!(desk.hear("ok N8 P14 B3\r\n"), "");
    assert_eq!(desk.hear("ok\r\n"), "N10 G1 X10.000 Y20.000 Z5.000 F1500\\n");
    // M400 waits for as long as the moves take.
    assert_eq!(desk.hear("ok\r\n"), "N11 M400\\n");
    for _ in 0..5 {
        assert_eq!(desk.wait(2000), "");
        assert_eq!(desk.hear("echo:busy: processing\r\n"), "");
    }
    assert_eq!(desk.hear("ok\r\n"), "N12 M114\\n");
    assert_eq!(desk.hear("X:10.00 Y:20.00 Z:5.00 E:0.00 Count X:1 Y:2 Z:3\r\nok\r\n"), "N13 M106 S255\\n");
}

#[test]
fn an_ok_too_many_closes_no_gripper_before_the_moves_are_done() {
    let mut desk = Desk::new();
    desk.make_ready();
    desk.pick();
    desk.hear("ok\r\n");
    desk.hear("ok\r\n");
    // Two come for the last move; the second is taken for that of M400, and M114 is sent while the arm moves.
    assert_eq!(desk.hear("ok\r\nok\r\n"), "N11 M400\\n");
    assert_eq!(desk.hear("ok\r\n"), "N12 M114\\n");
    // It waits behind the M400. Sent again it is known to have been taken, and left alone.
    let mut sent = desk.wait(260);
    assert_eq!(sent, "N12 M114\\n");
    sent = desk.hear(&taken(12));
    for _ in 0..4 {
        sent += &desk.wait(1900);
        sent += &desk.hear("echo:busy: processing\r\n");
    }
    assert_eq!(sent, "");
    // The `ok` of M400, then the answer.
    assert_eq!(desk.hear("ok\r\n"), "");
    assert_eq!(desk.hear("X:10.00 Y:20.00 Z:5.00 E:0.00 Count X:1 Y:2 Z:3\r\nok\r\n"), "N13 M106 S255\\n");
    // A servo's delay is no silence.
    assert_eq!(desk.wait(900), "");
}

#[test]
fn an_answer_that_is_lost_is_asked_for_anew() {
    let mut desk = Desk::new();
    desk.make_ready();
    let polled = desk.wait(10_000);
    assert_eq!(polled, "N8 M114\\n");
    // Its line came damaged, its `ok` whole.
    desk.hear("X:1\u{e4}.00 Y:0.00 Z:0.00 E:0.00 Count X:0 Y:0 Z:0\r\nok\r\n");
    assert_eq!(desk.wait(250), polled);
    assert_eq!(desk.hear(&taken(8)), "");
    assert_eq!(desk.wait(30), "N9 M114\\n");
    // Both are lost: a link that complains is alive, and five seconds later it is asked anew as well.
    assert_eq!(desk.wait(260), "N9 M114\\n");
    desk.hear("Error:Line Number is not Last Line Number+1, Last Line: 9\r\nResend: 10\r\n");
    assert_eq!(desk.wait(4900), "");
    assert_eq!(desk.wait(200), "N10 M114\\n");
    desk.hear(&at(0.0));
    assert!(!desk.told().iter().any(|report| matches!(report, Report::Disconnected { .. })));
}

#[test]
fn a_quick_stop_takes_seconds_and_leaves_open_whether_the_last_line_was_taken() {
    for was_taken in [true, false] {
        let mut desk = Desk::new();
        desk.make_ready();
        desk.pick();
        assert!(desk.hear("ok\r\n").starts_with("N9 G0"));
        desk.marlin.command(Command::Hold, desk.now_ns).unwrap();
        assert_eq!(desk.wait(300), "|\\nM410\\n|M410\\nN10 M114\\n");
        // Nothing is heard while the planner is being cleaned, then the `ok`s of N9 and of the M410s.
        assert_eq!(desk.wait(2000), "");
        if was_taken {
            assert_eq!(desk.hear("ok\r\nok\r\nok\r\nok\r\n"), "");
        } else {
            assert_eq!(desk.hear(&taken(8)), "");
            assert_eq!(desk.wait(30), "N9 M114\\n");
        }
        desk.hear(&at(3.0));
        let sent = desk.wait(60);
        let next = if was_taken { 11 } else { 10 };
        assert_eq!(sent, format!("N{next} M114\\n"));
        assert_eq!(desk.hear(&at(3.0)), format!("N{} M400\\n", next + 1));
        assert_eq!(desk.hear("ok\r\n"), format!("N{} M114\\n", next + 2));
        desk.hear(&at(3.0));
        let failed = Report::Failed { id: 7, failure: Failure::Held };
        assert!(desk.told().ends_with(&[failed, Report::Held { by: HeldBy::Command }]));
    }
}

#[test]
fn a_controller_that_has_counted_for_another_host_says_which_number_comes() {
    let mut desk = Desk::new();
    assert_eq!(desk.wait(102), "|\\nM410\\n|\\nM410\\nN1 M115\\n");
    desk.hear(&format!("ok\r\n{}", taken(5733)));
    assert_eq!(desk.wait(30), "N5734 M115\\n");
    assert_eq!(desk.hear("FIRMWARE_NAME:Marlin 2.1.2\r\nok\r\n"), "N5735 M114\\n");
    desk.hear(&at(0.0));
    assert_eq!(desk.told(), [Report::Connected { session: 7, held_by: HeldBy::Start }]);
}

#[test]
fn a_line_is_sent_again_when_it_is_asked_for_and_never_when_it_was_taken() {
    let mut desk = Desk::new();
    desk.make_ready();
    let line = desk.pick();
    let refused = "Error:checksum mismatch, Last Line: 7\r\nResend: 8\r\nok\r\n";
    assert_eq!(desk.hear(refused), "");
    assert_eq!(desk.wait(30), line);
    // No answer: the number makes it safe to send it again.
    assert_eq!(desk.wait(300), line);
    // It had been taken: whether only the acknowledgement was lost or it waits says the answer to a question behind it.
    assert_eq!(desk.hear(&taken(8)), "");
    assert_eq!(desk.wait(30), "N9 M114\\n");
    let there = "X:10.00 Y:20.00 Z:65.00 E:0.00 Count X:1 Y:2 Z:3\r\nok\r\n";
    assert!(desk.hear(there).starts_with("N10 G0 Z45.000"));
    // Elsewhere: it was refused, and that got lost, too.
    let mut desk = Desk::new();
    desk.make_ready();
    desk.pick();
    desk.wait(260);
    desk.hear(&taken(8));
    assert_eq!(desk.wait(30), "N9 M114\\n");
    assert_eq!(desk.hear(&at(0.0)), "|\\nM410\\n");
}

#[test]
fn a_first_move_that_got_lost_is_not_sent_again_when_it_is_stale() {
    // The controller has not taken the number: what comes under it now is a question, and the pick is refused.
    let mut desk = Desk::new();
    desk.make_ready();
    desk.pick();
    desk.wait(240);
    desk.hear("Error:checksum mismatch, Last Line: 7\r\nResend: 8\r\nok\r\n");
    desk.now_ns += 400 * MS;
    assert_eq!(desk.wait(2), "N8 M114\\n");
    desk.hear(&at(0.0));
    let told = desk.told();
    assert!(matches!(told[0], Report::Refused { id: 7, refusal: Refusal::Stale { .. } }), "{told:?}");
    // The answer to the question is lost, too, and now the number is taken: by the question, or by the move.
    let mut desk = Desk::new();
    desk.make_ready();
    desk.pick();
    desk.now_ns += 600 * MS;
    assert_eq!(desk.wait(2), "N8 M114\\n");
    assert_eq!(desk.wait(250), "N8 M114\\n");
    let sent = desk.hear(&taken(8));
    assert_eq!(sent, "|\\nM410\\n");
    // It had taken it, and only its answer was lost: then it is under way.
    let mut desk = Desk::new();
    desk.make_ready();
    desk.pick();
    desk.now_ns += 600 * MS;
    assert_eq!(desk.wait(2), "N8 M114\\n");
    let sent = desk.hear(&taken(8));
    assert_eq!(sent, "N9 G0 Z45.000 F6000\\n");
}

#[test]
fn silence_loses_the_pick_and_busy_does_not() {
    let mut desk = Desk::new();
    desk.make_ready();
    desk.pick();
    for _ in 0..20 {
        desk.wait(200);
        desk.hear("echo:busy: processing\r\n");
    }
    assert!(desk.told().iter().all(|report| !matches!(report, Report::Disconnected { .. })));
    let sent = desk.wait(1000);
    assert!(sent.contains("|\\nM410\\n") && sent.ends_with("N9 M115\\n"), "{sent}");
    assert_eq!(desk.told(), [Report::Lost { id: 7 }, Report::Disconnected { cause: Disconnect::Silent }]);
}

#[test]
fn what_marlin_does_not_do_fails_the_pick() {
    for (complaint, code) in [
        ("echo:Unknown command: \"G0 X\"\r\nok\r\n", 1001),
        ("echo:Home XYZ First\r\nok\r\n", 1002),
        ("Error:something\r\nok\r\n", 1002),
    ] {
        let mut desk = Desk::new();
        desk.make_ready();
        desk.pick();
        assert_eq!(desk.hear(complaint), "|\\nM410\\n");
        assert_eq!(desk.wait(1000), "|M410\\nN9 M114\\n");
        desk.hear("ok\r\n");
        desk.hear(&at(3.0));
        desk.wait(60);
        assert_eq!(desk.hear(&at(3.0)), "N11 M400\\n");
        desk.hear("ok\r\n");
        desk.hear(&at(3.0));
        let failed = Report::Failed { id: 7, failure: Failure::Controller { code } };
        assert!(desk.told().ends_with(&[failed, Report::Held { by: HeldBy::Alarm }]), "{complaint}");
    }
}

#[test]
fn an_arm_that_moves_on_in_spite_of_m410_is_killed() {
    let mut desk = Desk::new();
    desk.make_ready();
    desk.pick();
    desk.hear("ok\r\n");
    desk.marlin.command(Command::Hold, desk.now_ns).unwrap();
    desk.wait(1000);
    desk.hear("ok\r\n");
    let mut sent = String::new();
    for n in 0..12 {
        sent += &desk.hear(&at(f64::from(n)));
        sent += &desk.wait(60);
    }
    assert!(sent.ends_with("|\\nM112\\n"), "{sent}");
    let told = desk.told();
    assert!(
        told.contains(&Report::Alarm { code: 112 }) && told.contains(&Report::PositionUnknown),
        "{told:?}"
    );
    // Only its button helps; then it says its banner.
    assert_eq!(desk.wait(5000), "");
    assert_eq!(desk.hear("start\r\n"), "N1 M115\\n");
}

#[test]
fn a_restart_is_noticed_by_its_banner_or_by_its_numbers() {
    let mut desk = Desk::new();
    desk.make_ready();
    desk.pick();
    assert_eq!(desk.hear("start\r\n"), "N1 M115\\n");
    let restarted = [
        Report::PositionUnknown,
        Report::Lost { id: 7 },
        Report::Disconnected { cause: Disconnect::Restarted },
    ];
    assert_eq!(desk.told(), restarted);
    let mut desk = Desk::new();
    desk.make_ready();
    desk.pick();
    desk.hear("Error:Line Number is not Last Line Number+1, Last Line: 0\r\nResend: 1\r\n");
    assert_eq!(desk.told(), restarted);
    let mut desk = Desk::new();
    desk.make_ready();
    desk.pick();
    desk.hear("Error:Line Number is not Last Line Number+1, Last Line: 41\r\nResend: 42\r\n");
    assert_eq!(desk.told(), [Report::Lost { id: 7 }, Report::Disconnected { cause: Disconnect::Silent }]);
}

#[test]
fn the_delay_of_the_line_is_known_before_the_first_pick_and_taken_off_its_time_to_live() {
    // 40 ms each way and a move that begins 115 ms later: of 500 ms 345 are left, and the gate sees to them.
    let mut desk = Desk::new();
    desk.wait(2);
    desk.hear("start\r\n");
    desk.hear("FIRMWARE_NAME:Marlin 2.1.2\r\nok\r\n");
    desk.wait(76);
    desk.hear(&at(0.0));
    desk.told();
    desk.marlin.command(Command::Release, desk.now_ns).unwrap();
    desk.wait(2);
    desk.hear("ok\r\n");
    desk.wait(76);
    desk.hear(&at(0.0));
    for _ in 0..3 {
        desk.hear("ok\r\n");
    }
    assert_eq!(desk.told(), [Report::Ready { clear_of_view: false }]);
    let line = desk.pick();
    assert!(line.starts_with("N8 G0 X10.000"), "{line}");
    // Damaged on its way; asked for again before that moment and after it.
    let refused = "Error:checksum mismatch, Last Line: 7\r\nResend: 8\r\nok\r\n";
    desk.hear(refused);
    desk.now_ns += 220 * MS;
    assert_eq!(desk.wait(26), line);
    desk.hear(refused);
    desk.now_ns += 100 * MS;
    assert_eq!(desk.wait(26), "N8 M114\\n");
}

#[test]
fn positions_of_all_builds_are_read_and_prove_nothing_while_it_moves() {
    for at in [
        // An arm that counts the angles of its motors; a build that counts nothing; one from before 2.0.
        "X:10.00 Y:20.00 Z:5.00 E:0.00 Count A:100 B:1 C:2\r\nDEXARM Theta A:0.00  Theta B:0.00\r\nok\r\n",
        "X:10.00 Y:20.00 Z:5.00 E:0.00\r\nok\r\n",
        "X: 10.00 Y: 20.00 Z: 5.00 E: 0.00 Count X: 800 Y:1600 Z:2000\r\nok\r\n",
    ] {
        let mut desk = Desk::new();
        desk.wait_for_moves();
        // Somebody else's answer.
        assert_eq!(desk.hear(at), "N12 M114\\n", "{at}");
        assert_eq!(desk.wait(200), "");
        assert_eq!(desk.hear(at), "N13 M106 S255\\n", "{at}");
    }
}

#[test]
fn what_else_a_printer_says_does_no_harm() {
    let mut desk = Desk::new();
    desk.make_ready();
    desk.pick();
    for chatter in [
        "wait\r\n",
        " T:21.3 /0.0 B:20.1 /0.0 @:0 B@:0\r\n",
        "//action:notification ready\r\n",
        "echo:SD init fail\r\n",
        "echo:DEBUG:INFO\r\n",
        "Not SD printing\r\n",
        "echo: External Reset\r\nMarlin 2.1.2.5\r\n",
        "echo:enqueueing \"M117 hello\"\r\n",
        "FR:100%\r\n",
    ] {
        assert_eq!(desk.hear(chatter), "", "{chatter}");
    }
    assert!(desk.hear("ok T:21.3 /0.0 B:20.1 /0.0 @:0 B@:0\r\n").starts_with("N9 G0 Z45.000"));
    assert!(desk.hear("ok P15 B3\r\n").starts_with("N10 G1 X10.000"));
    for end in [
        "!! printer halted\r\n",
        "Error:Printer halted. kill() called!\r\n//action:poweroff\r\n",
        "Error:KILL caused by too much inactive time - current command: G1 X1\r\n",
        "Printer stopped due to errors. Fix the error and use M999 to restart. (Temperature is reset.)\r\nok\r\n",
    ] {
        let mut desk = Desk::new();
        desk.make_ready();
        desk.pick();
        assert_eq!(desk.hear(end), "", "{end}");
        assert!(desk.told().contains(&Report::Alarm { code: 112 }), "{end}");
    }
}

#[test]
fn a_poll_on_its_way_is_waited_for_before_anything_else_is_asked() {
    let mut desk = Desk::new();
    desk.make_ready();
    assert_eq!(desk.wait(10_000), "N8 M114\\n");
    desk.marlin.command(Command::Hold, desk.now_ns).unwrap();
    assert_eq!(desk.wait(1000), "|\\nM410\\n|M410\\nN9 M114\\n");
    desk.hear(&at(0.0));
    desk.wait(60);
    desk.hear(&at(0.0));
    desk.hear("ok\r\n");
    desk.hear(&at(0.0));
    assert!(desk.told().ends_with(&[Report::Held { by: HeldBy::Command }]));
    assert_eq!(desk.wait(10_000), "N13 M114\\n");
    desk.marlin.command(Command::Release, desk.now_ns).unwrap();
    // An `ok` too many, then the answer to the poll: only then M400 goes out.
    assert_eq!(desk.hear("ok\r\n"), "");
    assert_eq!(desk.hear(&at(0.0)), "N14 M400\\n");
}
