//! The uArm's end of the wire against what the other end says, byte by byte.

use super::*;
use crate::config::Settings;
use crate::dialect::TRANSMIT_LEN_MIN;
use crate::message::{Command, Failure, HeldBy, Refusal, Report};

mod firmware_3;

/// The cell's end, a clock, and a person who types what the uArm would say; `?` is answered by itself.
struct Desk {
    uarm: Uarm,
    now_ns: i64,
    state: Option<&'static str>,
    reports: Vec<Report>,
}

const STANDS: &str = "Idle,MPos:1.000,2.000,3.000,WPos:1.000,2.000,3.000";

impl Desk {
    fn new() -> Self {
        let settings = Settings::parse(
            "[arm]\ndialect = \"uarm\"\naxes = \"xyz\"\nbanner_wait_ms = 100\n\
             [workspace]\nmin_mm = [-200, -200, 0]\nmax_mm = [200, 200, 300]\n",
        )
        .unwrap();
        let uarm = Uarm::new(&settings, 6).unwrap();
        let mut desk = Self { uarm, now_ns: 10_000 * MS, state: Some(STANDS), reports: Vec::new() };
        desk.uarm.on_link(true, desk.now_ns);
        desk
    }

    /// What is sent within so many ms, without `?`, `|` before urgent bytes.
    fn wait(&mut self, ms: i64) -> String {
        let mut sent = String::new();
        let mut out = [0; TRANSMIT_LEN_MIN];
        for _ in 0..ms {
            self.now_ns += MS;
            while let Some(report) = self.uarm.poll(self.now_ns) {
                if !matches!(report, Report::Heartbeat { .. }) {
                    self.reports.push(report);
                }
            }
            loop {
                let done = self.uarm.transmit(self.now_ns, &mut out);
                if done.len == 0 {
                    break;
                }
                sent.push_str(if done.urgent { "|" } else { "" });
                let text = out[..done.len].escape_ascii().to_string();
                match (text.as_str(), self.state) {
                    ("?", Some(state)) => {
                        self.uarm.on_bytes(format!("<{state}>\r\n").as_bytes(), self.now_ns)
                    }
                    ("?", None) => {}
                    _ => sent.push_str(&text),
                }
            }
        }
        sent
    }

    fn hear(&mut self, text: &str) -> String {
        self.uarm.on_bytes(text.as_bytes(), self.now_ns);
        self.wait(2)
    }

    /// Answers the question for the encoders until they are not asked any more; what is sent then.
    fn stand(&mut self, mut sent: String, at: &str) -> String {
        for _ in 0..4 {
            let Some(tag) = sent.strip_prefix('#').and_then(|rest| rest.strip_suffix(" P2220\\n")) else {
                break;
            };
            let answer = format!("${tag} ok {at}\n");
            sent = self.hear(&answer) + &self.wait(70);
        }
        sent
    }

    fn told(&mut self) -> Vec<Report> {
        std::mem::take(&mut self.reports)
    }

    fn connect(&mut self) {
        assert_eq!(self.hear("@1\n"), "#1 P2203\\n");
        let sent = self.hear("$1 ok V4.9.0\n");
        assert_eq!(sent, "#2 P2220\\n");
        self.stand(sent, "X200.0000 Y0.0000 Z150.0000");
        assert_eq!(self.told(), [Report::Connected { session: 7, held_by: HeldBy::Start }]);
    }

    fn make_ready(&mut self) {
        self.connect();
        self.uarm.command(Command::Release, self.now_ns).unwrap();
        let sent = self.wait(2);
        let sent = self.stand(sent, "X200.0000 Y0.0000 Z150.0000");
        assert!(sent.ends_with(" G90\\n"), "{sent}");
        assert!(self.hear("$6 ok\n").ends_with("#7 G21\\n"));
        assert!(self.hear("$7 E20\n").ends_with("#8 M2232 V0\\n"));
        self.hear("$8 ok\n");
        assert_eq!(self.told(), [Report::Ready { clear_of_view: false }]);
    }

    fn pick(&mut self) -> String {
        let mut pick = crate::gate::tests::pick();
        pick.seen.left_ns = self.now_ns + MS;
        pick.seen.right_ns = self.now_ns + MS;
        pick.session = 7;
        self.now_ns += 2 * MS;
        self.uarm.command(Command::Pick(pick), self.now_ns).unwrap();
        self.wait(1)
    }

    /// A pick whose points were all said to be in reach; its first move.
    fn begun(&mut self) -> String {
        self.make_ready();
        let mut sent = self.pick();
        for tag in 9..13 {
            assert!(sent.starts_with(&format!("#{tag} M2222 X")) && sent.ends_with(" P0\\n"), "{sent}");
            sent = self.hear(&format!("${tag} ok V1\n"));
        }
        sent
    }
}

#[test]
fn points_are_asked_about_and_each_move_waits_for_its_own_answer() {
    let mut desk = Desk::new();
    assert_eq!(desk.begun(), "#13 G0 X10.000 Y20.000 Z65.000 F6000\\n");
    // Reports, an old answer and another's answer mean nothing.
    assert_eq!(desk.hear("@3 X1 Y2 Z3 R4\n$12 ok V1\n$99 ok\nok\n"), "");
    // Version 4.10 writes what it measures before some answers, on their line.
    assert_eq!(desk.hear("value:0      value2:0$13 ok\n"), "#14 G0 X10.000 Y20.000 Z45.000 F6000\\n");
    assert_eq!(desk.hear("$14 OK\n"), "#15 G1 X10.000 Y20.000 Z5.000 F1500\\n");
    let sent = desk.hear("$15 ok\n");
    assert_eq!(sent, "#16 P2220\\n");
    // The gripper closes when the encoders agree with the point.
    let sent = desk.stand(sent, "X10.5000 Y19.5000 Z5.2500");
    assert_eq!(sent, "#18 M2232 V1\\n");
    // The wait behind it is made here.
    assert_eq!(desk.hear("$18 ok\n"), "");
    assert_eq!(desk.wait(700), "");
    assert_eq!(desk.wait(200), "#19 G1 X10.000 Y20.000 Z65.000 F3000\\n");
}

#[test]
fn an_unreachable_point_refuses_the_pick_before_anything_moves() {
    let mut desk = Desk::new();
    desk.make_ready();
    desk.pick();
    assert_eq!(desk.hear("$9 ok V1\n$10 ok V0\n"), "#10 M2222 X10.000 Y20.000 Z5.000 P0\\n");
    assert_eq!(desk.hear("$10 ok V0\n"), "");
    assert_eq!(
        desk.told(),
        [Report::Refused { id: 7, refusal: Refusal::Unreachable }, Report::Ready { clear_of_view: false }]
    );
}

#[test]
fn an_error_or_a_bare_tag_stops_the_arm_and_fails_the_pick() {
    for (answer, code) in [("$13 E22\n", 22), ("$13\n", 1002), ("E23 buffer full\n", 23)] {
        let mut desk = Desk::new();
        desk.begun();
        assert!(desk.hear(answer).starts_with("|!"), "{answer}");
        desk.state = Some("Hold,MPos:1.000,2.000,3.000,WPos:1.000,2.000,3.000");
        desk.wait(300);
        let failed = Report::Failed { id: 7, failure: Failure::Controller { code } };
        assert!(desk.told().ends_with(&[failed, Report::Held { by: HeldBy::Alarm }]), "{answer}");
        // The release resets it, which throws away what it holds back.
        desk.uarm.command(Command::Release, desk.now_ns).unwrap();
        assert_eq!(desk.wait(2), "|\\x18");
        desk.state = Some(STANDS);
        assert_eq!(desk.hear("\r\nGrbl 0.9j ['$' for help]\r\n@1\n"), "$X\\n");
        let sent = desk.hear("ok\n") + &desk.wait(70);
        assert!(sent.ends_with(" P2220\\n"), "{sent}");
    }
}

#[test]
fn an_arm_that_does_not_arrive_fails_the_pick_and_nan_is_looked_at_again() {
    let mut desk = Desk::new();
    desk.begun();
    desk.hear("$13 ok\n");
    desk.hear("$14 ok\n");
    desk.hear("$15 ok\n");
    desk.hear("$16 ok Xnan Y20.0000 Z5.0000\n");
    let mut sent = desk.wait(70);
    assert_eq!(sent, "#17 P2220\\n");
    for _ in 0..4 {
        sent = desk.stand(sent, "X10.0000 Y20.0000 Z60.0000");
    }
    assert!(sent.contains("|!"), "{sent}");
    assert!(desk.told().iter().any(|report| matches!(report, Report::Garbage { .. })));
}

#[test]
fn lost_statuses_make_no_other_firmware_of_one_that_said_its_version() {
    let mut desk = Desk::new();
    desk.connect();
    desk.state = None;
    for _ in 0..10 {
        desk.wait(400);
        // It answers its questions, so the line is alive.
        desk.hear("@3 X1 Y2 Z3 R4\n$999 ok\n");
    }
    desk.uarm.command(Command::Hold, desk.now_ns).unwrap();
    assert!(desk.wait(1).contains("|!"));
}

#[test]
fn a_session_that_ends_during_a_wait_wakes_nobody_for_it() {
    let mut desk = Desk::new();
    desk.begun();
    for tag in 13..16 {
        desk.hear(&format!("${tag} ok\n"));
    }
    desk.stand("#16 P2220\\n".into(), "X10.0000 Y20.0000 Z5.0000");
    desk.hear("$18 ok\n");
    desk.uarm.command(Command::Hello, desk.now_ns).unwrap();
    desk.state = None;
    desk.wait(1000);
    assert!(desk.uarm.next_deadline_ns().is_some_and(|at| at > desk.now_ns));
}

const RUNS: &str = "Run,MPos:1.000,2.000,3.000,WPos:1.000,2.000,3.000";

#[test]
fn an_arm_that_is_blocked_on_its_way_is_stopped_long_before_its_pick_times_out() {
    let mut desk = Desk::new();
    desk.begun();
    desk.state = Some(RUNS);
    // It gets on at first; the answer to the move itself is still to come.
    assert_eq!(desk.wait(260), "#14 P2220\\n");
    assert_eq!(desk.hear("$14 ok X150.0000 Y10.0000 Z100.0000\n"), "");
    assert_eq!(desk.wait(250), "#15 P2220\\n");
    // From here it does not, while the controller goes on counting steps.
    let mut sent = desk.hear("$15 ok X140.0000 Y10.0000 Z90.0000\n");
    for tag in 16..26 {
        if sent.contains("|!") {
            break;
        }
        assert_eq!(desk.wait(250), format!("#{tag} P2220\\n"));
        sent = desk.hear(&format!("${tag} ok X140.2500 Y10.0000 Z89.7500\n"));
    }
    assert!(sent.contains("|!"), "{sent}");
    desk.state = Some("Hold,MPos:1.000,2.000,3.000,WPos:1.000,2.000,3.000");
    desk.wait(300);
    let failed = Report::Failed { id: 7, failure: Failure::Controller { code: 1000 } };
    assert!(desk.told().ends_with(&[failed, Report::Held { by: HeldBy::Alarm }]));
}

#[test]
fn a_slow_move_a_late_answer_and_a_move_that_is_over_are_no_stall() {
    let mut desk = Desk::new();
    desk.begun();
    desk.state = Some(RUNS);
    // 48 mm a minute, seen through encoders of half a millimetre.
    desk.wait(12);
    for (tag, tenths) in (14..44).zip((0..).step_by(2)) {
        assert_eq!(desk.wait(248), format!("#{tag} P2220\\n"));
        let z = 90.0 - f64::from(tenths / 5) / 2.0;
        assert_eq!(desk.hear(&format!("${tag} ok X140.0000 Y10.0000 Z{z:.4}\n")), "");
    }
    // A long G1 keeps the firmware from answering: it is asked once, and not again before it has answered.
    assert_eq!(desk.wait(5000), "#44 P2220\\n");
    assert_eq!(desk.hear("$13 ok\n"), "#45 G0 X10.000 Y20.000 Z45.000 F6000\\n");
    assert_eq!(desk.hear("$44 ok X10.0000 Y20.0000 Z65.0000\n"), "");
    assert_eq!(desk.hear("$45 ok\n"), "#46 G1 X10.000 Y20.000 Z5.000 F1500\\n");
    assert!(desk.told().iter().all(|report| !matches!(report, Report::Failed { .. })));
}

#[test]
fn reports_that_nobody_asked_for_mean_what_the_protocol_says() {
    // Timed positions (M2120), buttons, switch, "move done" (M2122), a stop byte's echo: nothing for the cell.
    for report in
        ["@3 X1 Y2 Z3 R90", "@4 N0 V1", "@4 N1 V2", "@6 N0 V1", "@7", "@9 V0", "ok @9 V0", "@5 V1", "@"]
    {
        let mut desk = Desk::new();
        desk.begun();
        assert_eq!(desk.hear(&format!("{report}\r\n")), "", "{report}");
        let told = desk.told();
        assert!(!told.iter().any(|report| matches!(report, Report::Garbage { .. })), "{report}: {told:?}");
        assert_eq!(desk.hear("$13 ok\n"), "#14 G0 X10.000 Y20.000 Z45.000 F6000\\n", "{report}");
    }
    // The motors' power is gone: nobody knows where the arm sank to.
    let mut desk = Desk::new();
    desk.begun();
    assert!(desk.hear("@5 V0\n").starts_with("|!"));
    desk.state = Some("Hold,MPos:1.000,2.000,3.000,WPos:1.000,2.000,3.000");
    desk.wait(300);
    let failed = Report::Failed { id: 7, failure: Failure::Held };
    assert!(desk.told().ends_with(&[failed, Report::Held { by: HeldBy::Operator }]));
    // It was switched off and on: what it says of itself, then `@1`.
    let mut desk = Desk::new();
    desk.begun();
    let told = "device name : SwiftPro\r\nsoft ver : V4.10.0\r\napi ver : V4.0.5\r\nwork mode : 0\r\n@1\n";
    assert!(desk.hear(told).ends_with(" P2203\\n"));
    let lost =
        [Report::Lost { id: 7 }, Report::Disconnected { cause: crate::message::Disconnect::Restarted }];
    assert!(desk.told().ends_with(&lost));
}

#[test]
fn a_firmware_that_is_silent_after_a_reset_is_asked_after_a_second() {
    let mut desk = Desk::new();
    desk.begun();
    desk.uarm.command(Command::Hold, desk.now_ns).unwrap();
    desk.state = Some("Hold,MPos:1.000,2.000,3.000,WPos:1.000,2.000,3.000");
    desk.hear("ok @9 V0\n");
    desk.wait(300);
    desk.uarm.command(Command::Release, desk.now_ns).unwrap();
    assert_eq!(desk.wait(2), "|\\x18");
    desk.state = Some(STANDS);
    // Built since 2019 it says nothing but `ok`.
    desk.hear("ok\n");
    let sent = desk.wait(1100);
    assert!(sent.starts_with("$X\\n#") && sent.ends_with(" P2220\\n"), "{sent}");
}
