//! Grbl's end of the wire against what the other end says, byte by byte.

use super::status::{State, Status, is_banner, understood};
use super::*;
use crate::config::Settings;
use crate::dialect::TRANSMIT_LEN_MIN;
use crate::message::{Command, Failure, HeldBy, Pick, Refusal, Report};

fn settings(moves: &str) -> Settings {
    Settings::parse(&format!(
        "[arm]\ndialect = \"grbl\"\naxes = \"xyz\"\nbanner_wait_ms = 100\nlines_ahead = 15\n[arm.moves]\n{moves}\n\
         [workspace]\nmin_mm = [-200, -200, 0]\nmax_mm = [200, 200, 300]\n"
    ))
    .unwrap()
}

/// The cell's end, a clock, and a person who types what Grbl would say; the status is answered by itself.
struct Desk {
    grbl: Grbl,
    now_ns: i64,
    state: Option<&'static str>,
    reports: Vec<Report>,
}

impl Desk {
    fn new(moves: &str) -> Self {
        let grbl = Grbl::new(&settings(moves), 6).unwrap();
        let mut desk = Self { grbl, now_ns: 10_000 * MS, state: None, reports: Vec::new() };
        desk.grbl.on_link(true, desk.now_ns);
        desk
    }

    /// What is sent within so many ms, without the status questions; `|` before urgent bytes.
    fn wait(&mut self, ms: i64) -> String {
        let mut sent = String::new();
        let mut out = [0; TRANSMIT_LEN_MIN];
        for _ in 0..ms {
            self.now_ns += MS;
            while let Some(report) = self.grbl.poll(self.now_ns) {
                if !matches!(report, Report::Heartbeat { .. }) {
                    self.reports.push(report);
                }
            }
            loop {
                let done = self.grbl.transmit(self.now_ns, &mut out);
                if done.len == 0 {
                    break;
                }
                if let Some(id) = done.pick {
                    self.grbl.on_written(id, self.now_ns);
                }
                let text = out[..done.len].escape_ascii().to_string();
                sent.push_str(if done.urgent { "|" } else { "" });
                match (text.as_str(), self.state) {
                    ("?", Some(state)) => {
                        self.grbl.on_bytes(format!("<{state}>\r\n").as_bytes(), self.now_ns)
                    }
                    ("?", None) => {}
                    _ => sent.push_str(&text),
                }
            }
        }
        sent
    }

    fn hear(&mut self, text: &str) -> String {
        self.grbl.on_bytes(text.as_bytes(), self.now_ns);
        self.wait(2)
    }

    /// From now on the status is this one; what is sent until it was asked for often enough.
    fn status(&mut self, text: &'static str) -> String {
        self.state = Some(text);
        self.wait(300)
    }

    fn told(&mut self) -> Vec<Report> {
        std::mem::take(&mut self.reports)
    }

    fn connect(&mut self) {
        self.hear("\r\nGrbl 1.1h ['$' for help]\r\n");
        assert_eq!(self.status("Idle|MPos:0.000,0.000,0.000|FS:0,0|WCO:0.000,0.000,0.000"), "$I\\n");
        self.hear("[VER:1.1h.20190825:]\r\n[OPT:V,15,128]\r\nok\r\n");
        assert_eq!(self.told(), [Report::Connected { session: 7, held_by: HeldBy::Start }]);
    }

    fn make_ready(&mut self) {
        self.connect();
        self.grbl.command(Command::Release, self.now_ns).unwrap();
        assert_eq!(self.status("Idle|MPos:0.000,0.000,0.000"), "G90 G21 G94\\n");
        assert_eq!(self.hear("ok\r\n"), "M9\\n");
        self.hear("ok\r\n");
        assert_eq!(self.told(), [Report::Ready { clear_of_view: false }]);
    }

    fn pick(&mut self) -> Pick {
        let mut pick = crate::gate::tests::pick();
        pick.seen.left_ns = self.now_ns - MS;
        pick.seen.right_ns = self.now_ns - MS;
        pick.session = 7;
        self.now_ns += 2 * MS;
        pick.seen.left_ns += 2 * MS;
        pick.seen.right_ns += 2 * MS;
        pick
    }
}

#[test]
fn a_pick_goes_down_the_wire_move_by_move_and_stops_before_the_gripper() {
    let mut desk = Desk::new("");
    desk.make_ready();
    let pick = desk.pick();
    desk.grbl.command(Command::Pick(pick), desk.now_ns).unwrap();
    assert_eq!(desk.wait(2), "G0 X10.000 Y20.000 Z65.000\\nG0 Z45.000\\nG1 X10.000 Y20.000 Z5.000 F1500\\n");
    assert_eq!(desk.hear("ok\r\nok\r\n"), "");
    assert_eq!(desk.hear("ok\r\n"), "G4 P0\\n");
    // Idle before the answer to G4 proves nothing.
    assert_eq!(desk.status("Idle|MPos:0.000,0.000,0.000"), "");
    assert_eq!(desk.status("Run|MPos:5.000,10.000,40.000"), "");
    desk.hear("ok\r\n");
    assert_eq!(desk.status("Idle|MPos:10.000,20.000,5.000"), "M8\\n");
    assert_eq!(desk.hear("ok\r\n"), "G4 P0.4\\n");
    let at_ns = desk.now_ns;
    let told = desk.told();
    assert!(matches!(told[0], Report::Sent { id: 7, at_ns: written } if written < at_ns));
    assert_eq!(told[1..], [Report::Accepted { id: 7 }, Report::Moving { id: 7 }]);
}

#[test]
fn never_more_characters_are_on_their_way_than_the_buffer_holds() {
    let far = "\"G1 X{grasp_x} Y{grasp_y} Z{grasp_z} A{grasp_yaw} F1500.1234\"";
    let mut desk = Desk::new(&format!("pick = [{}]", [far; 9].join(", ")));
    desk.make_ready();
    let pick = desk.pick();
    desk.grbl.command(Command::Pick(pick), desk.now_ns).unwrap();
    let first = desk.wait(5);
    let len = first.replace("\\n", "\n").len();
    assert!(len <= 128 && len > 128 - len / 2, "{len}: {first}");
    let next = desk.hear("ok\r\n");
    assert_eq!(next.matches("\\n").count(), 1, "{next}");
}

#[test]
fn an_error_stops_the_arm_and_fails_the_pick() {
    let mut desk = Desk::new("");
    desk.make_ready();
    let pick = desk.pick();
    desk.grbl.command(Command::Pick(pick), desk.now_ns).unwrap();
    desk.wait(2);
    assert_eq!(desk.hear("ok\r\nerror:33\r\n"), "|!");
    desk.status("Hold:0|MPos:1.000,2.000,65.000");
    let failed = Report::Failed { id: 7, failure: Failure::Controller { code: 33 } };
    assert!(desk.told().ends_with(&[failed, Report::Held { by: HeldBy::Alarm }]));
    assert_eq!(desk.grbl.command(Command::Pick(pick), desk.now_ns), Err(Refusal::OnHold));
    // The release throws away what the controller still has.
    desk.grbl.command(Command::Release, desk.now_ns).unwrap();
    assert_eq!(desk.status("Hold:0|MPos:1.000,2.000,65.000"), "|\\x18");
    desk.state = Some("Idle|MPos:1.000,2.000,65.000");
    let sent = desk.hear("\r\nGrbl 1.1h ['$' for help]\r\n") + &desk.wait(50);
    assert_eq!(sent, "G90 G21 G94\\n");
}

/// On its way to Z65.
fn on_its_way() -> Desk {
    let mut desk = Desk::new("");
    desk.make_ready();
    desk.status("Idle|MPos:0.000,0.000,0.000");
    let pick = desk.pick();
    desk.grbl.command(Command::Pick(pick), desk.now_ns).unwrap();
    desk.wait(2);
    desk.hear("ok\r\nok\r\nok\r\n");
    assert_eq!(desk.status("Run|MPos:2.000,4.000,40.000"), "");
    desk
}

#[test]
fn an_arm_that_leaves_the_room_between_its_points_is_stopped() {
    let mut desk = on_its_way();
    // Z65.000 became Z650 on the wire.
    let sent = desk.status("Run|MPos:2.000,4.000,80.000");
    assert!(sent.starts_with("|!"), "{sent}");
    desk.status("Hold:0|MPos:2.000,4.000,90.000");
    let failed = Report::Failed { id: 7, failure: Failure::Controller { code: 1000 } };
    assert!(desk.told().contains(&failed));
}

#[test]
fn a_status_that_may_have_lost_a_byte_is_asked_for_again_but_not_waited_for() {
    let mut desk = on_its_way();
    let outside = "<Run|MPos:2.000,4.000,400.000>\r\n";
    // The desk answers the question that follows as before.
    assert_eq!(desk.hear(outside) + &desk.wait(100), "");
    desk.state = None;
    assert_eq!(desk.hear(outside) + &desk.wait(56), "");
    assert!(desk.wait(4).starts_with("|!"));
}

#[test]
fn alarms_wait_for_an_unlock_and_a_release_alone_does_nothing() {
    let mut desk = Desk::new("");
    desk.make_ready();
    let pick = desk.pick();
    desk.grbl.command(Command::Pick(pick), desk.now_ns).unwrap();
    desk.wait(2);
    desk.hear("ok\r\nALARM:1\r\n");
    let told = desk.told();
    assert!(told.contains(&Report::Failed { id: 7, failure: Failure::Alarm }), "{told:?}");
    // It is on hold when it is unlocked, and not before: what holds is released, what is in alarm unlocked.
    assert!(told.ends_with(&[Report::Alarm { code: 1 }, Report::PositionUnknown]), "{told:?}");
    assert_eq!(desk.grbl.command(Command::Release, desk.now_ns), Err(Refusal::InAlarm));
    // Nothing is asked of a controller that is locked.
    assert_eq!(desk.wait(2000), "");
    desk.grbl.command(Command::Unlock, desk.now_ns).unwrap();
    assert_eq!(desk.wait(1), "|\\x18");
    let sent = desk.hear("\r\nGrbl 1.1h ['$' for help]\r\n[MSG:'$H'|'$X' to unlock]\r\n");
    assert_eq!(sent, "$X\\n");
    desk.told();
    desk.hear("[MSG:Caution: Unlocked]\r\nok\r\n");
    desk.status("Idle|MPos:1.000,2.000,65.000");
    assert_eq!(desk.told(), [Report::PositionUnknown, Report::Held { by: HeldBy::Alarm }]);
}

#[test]
fn homing_leaves_an_alarm_by_the_release() {
    let mut desk = Desk::new("start = [\"$H\"]");
    desk.hear("\r\nGrbl 1.1h ['$' for help]\r\n[MSG:'$H'|'$X' to unlock]\r\n");
    assert_eq!(desk.status("Alarm|MPos:0.000,0.000,0.000|WCO:0.000,0.000,0.000"), "$I\\n");
    desk.hear("[OPT:V,15,128]\r\nok\r\n");
    assert_eq!(
        desk.told(),
        [Report::Connected { session: 7, held_by: HeldBy::Alarm }, Report::Alarm { code: 0 }]
    );
    desk.grbl.command(Command::Release, desk.now_ns).unwrap();
    assert_eq!(desk.wait(1), "|\\x18");
    assert_eq!(desk.hear("\r\nGrbl 1.1h ['$' for help]\r\n"), "$X\\n");
    desk.hear("ok\r\n");
    assert_eq!(desk.status("Idle|MPos:0.000,0.000,0.000"), "G90 G21 G94\\n");
    assert_eq!(desk.hear("ok\r\n"), "$H\\n");
    // While it homes it answers nothing, and is not taken for dead.
    assert_eq!(desk.wait(20_000), "");
    desk.hear("ok\r\n");
    assert!(desk.told().contains(&Report::Ready { clear_of_view: false }));
}

#[test]
fn a_hold_at_the_arm_is_noticed_and_an_old_grbl_is_refused() {
    let mut desk = Desk::new("");
    desk.make_ready();
    let sent = desk.status("Door:1|MPos:0.000,0.000,0.000");
    assert_eq!(sent, "|!");
    desk.status("Door:1|MPos:0.000,0.000,0.000");
    assert_eq!(desk.told(), [Report::Held { by: HeldBy::Operator }]);

    let mut desk = Desk::new("");
    desk.hear("\r\nGrbl 0.9j ['$' for help]\r\n");
    desk.status("Idle|WPos:0.000,0.000,0.000");
    // A byte of the banner may have got lost: it is asked once more.
    desk.hear("ok\r\n");
    assert_eq!(desk.told(), []);
    desk.wait(600);
    desk.hear("ok\r\n");
    assert_eq!(desk.told(), [Report::WrongDialect]);
    assert_eq!(desk.grbl.command(Command::Release, desk.now_ns), Err(Refusal::NotConnected));
}

#[test]
fn a_version_that_lost_a_byte_is_asked_for_again() {
    let mut desk = Desk::new("");
    desk.hear("\r\nGrbl .1h ['$' for help]\r\n");
    assert_eq!(desk.status("Idle|WPos:0.000,0.000,0.000"), "$I\\n");
    desk.hear("[VER:1.0h.20190825:]\r\nok\r\n");
    assert_eq!(desk.told(), []);
    assert_eq!(desk.wait(600), "$I\\n");
    desk.hear("[VER:1.1h.20190825:]\r\nok\r\n");
    assert_eq!(desk.told(), [Report::Connected { session: 7, held_by: HeldBy::Start }]);
}

#[test]
fn moves_of_a_cell_that_is_gone_are_held_before_anything_else() {
    let mut desk = Desk::new("");
    desk.wait(150);
    let sent = desk.status("Run|MPos:0.000,0.000,0.000|WCO:0.000,0.000,0.000");
    assert!(sent.starts_with("|!"), "{sent}");
    desk.status("Hold:1|MPos:1.000,0.000,0.000");
    desk.status("Hold:0|MPos:2.000,0.000,0.000");
    assert_eq!(desk.told(), [Report::Connected { session: 7, held_by: HeldBy::Start }]);
    desk.grbl.command(Command::Release, desk.now_ns).unwrap();
    assert_eq!(desk.status("Hold:0|MPos:2.000,0.000,0.000"), "|\\x18");
}

#[test]
fn reports_are_read_in_all_their_forms() {
    let state = |text: &str| Status::parse(text).map(|status| status.state);
    assert_eq!(state("Hold:1|MPos:0,0,0"), Some(State::Holding));
    assert_eq!(state("Door:0"), Some(State::Held));
    assert_eq!(state("Idle|WPos:1.0,2.0,3.0|FS:0,0|Ov:100,100,100|A:S"), Some(State::Idle));
    assert_eq!(state("Sleep"), Some(State::Blocked));
    assert_eq!(state("Idl|MPos:0,0,0"), None);
    let status = Status::parse("Run|MPos:1.000,2.000,3.000|WCO:10.000,0.000,-1.000|Pn:P").unwrap();
    assert_eq!(status.position_mm(status.offset_mm), [Some(-9.0), Some(2.0), Some(4.0)]);
    assert_eq!(status.position_mm(None), [None; 3]);
    assert_eq!(Status::parse("Idle|MPos:1.000,nan,3.000").unwrap().position_mm(Some([0.0; 3])), [None; 3]);
    assert!(is_banner("Grbl 1.1h ['$' for help]") && is_banner("rbl 1.1h ['$' for help]"));
    assert!(understood("1.1h") && understood("3.7 [FluidNC]") && !understood("0.9j") && !understood("1.0c"));
}

#[test]
fn relatives_of_grbl_are_understood() {
    for (banner, info) in [
        (
            "GrblHAL 1.1f ['$' or '$HELP' for help]",
            "[VER:1.1f.20240101:]\r\n[OPT:VNMSL,35,1024,3,0]\r\n[FIRMWARE:grblHAL]\r\nok\r\n",
        ),
        (
            "Grbl 3.7 [FluidNC v3.7.12 (wifi) '$' for help]",
            "[VER:3.7 FluidNC v3.7.12:]\r\n[OPT:MPHS]\r\n[MSG: Machine: Arm]\r\nok\r\n",
        ),
        ("Grbl 1.1h ['$' for help]", "[VER:1.1h.20190825:My arm]\r\n[OPT:V,15,128]\r\nok\r\n"),
    ] {
        let mut desk = Desk::new("");
        desk.hear(&format!("[MSG:INFO: starting]\r\n\r\n{banner}\r\n>G54:ok\r\n"));
        assert_eq!(
            desk.status("Idle|WPos:0.000,0.000,0.000|Bf:35,1023|FS:0,0|FW:grblHAL"),
            "$I\\n",
            "{banner}"
        );
        desk.hear(info);
        assert_eq!(desk.told(), [Report::Connected { session: 7, held_by: HeldBy::Start }], "{banner}");
    }
}

#[test]
fn what_a_button_at_the_machine_lets_go_on_after_a_hold_is_held_again() {
    let mut desk = Desk::new("");
    desk.make_ready();
    let pick = desk.pick();
    desk.grbl.command(Command::Pick(pick), desk.now_ns).unwrap();
    desk.wait(2);
    desk.grbl.command(Command::Hold, desk.now_ns).unwrap();
    desk.status("Hold:0|MPos:5.000,10.000,40.000|FS:0,0");
    let failed = Report::Failed { id: 7, failure: Failure::Held };
    assert!(desk.told().ends_with(&[failed, Report::Held { by: HeldBy::Command }]));
    // The cycle start button: Grbl goes on with the lines that it still has.
    assert!(desk.status("Run|MPos:6.000,12.000,39.000|FS:900,0").starts_with("|!"));
    assert_eq!(desk.status("Hold:0|MPos:7.000,13.000,38.000|FS:0,0"), "");
    assert_eq!(desk.told(), []);
    // A release throws them away.
    desk.grbl.command(Command::Release, desk.now_ns).unwrap();
    assert!(desk.wait(200).ends_with("|\\x18"));
}

#[test]
fn positions_in_inches_are_read_as_what_they_are() {
    let inches = "Run|WPos:1.0000,-2.0000,0.5000|FS:35.4,0|Ov:100,100,100|A:SF";
    let expected = [25.4, -50.8, 12.7];
    let near = |at: [Option<f64>; 3]| at.iter().zip(expected).all(|(a, b)| (a.unwrap() - b).abs() < 1e-9);
    assert!(near(Status::parse(inches).unwrap().position_mm(None)));
    let inches = "Idle|MPos:2.0000,0.0000,0.0000|Bf:15,128|FS:0,0|Pn:XYZ|WCO:1.0000,2.0000,-0.5000";
    let status = Status::parse(inches).unwrap();
    assert!(near(status.position_mm(status.offset_mm)));
    // One number with a digit doubled on the wire makes no inches.
    let mm = Status::parse("Idle|WPos:1.0000,-2.000,0.500").unwrap();
    assert_eq!(mm.position_mm(None), [Some(1.0), Some(-2.0), Some(0.5)]);
}

#[test]
fn a_controller_whose_place_is_not_known_yet_is_asked_until_it_is() {
    // Opened without a reset the work offset comes with the thirtieth report only.
    let mut desk = Desk::new("");
    desk.wait(102);
    for _ in 0..29 {
        let sent = desk.hear("<Idle|MPos:-10.000,0.000,0.000|FS:0,0>\r\n") + &desk.wait(40);
        assert_eq!(sent, "");
    }
    let sent = desk.hear("<Idle|MPos:-10.000,0.000,0.000|FS:0,0|WCO:5.000,0.000,0.000>\r\n");
    assert_eq!(sent, "$I\\n");
    // One that never says it can be used; work coordinates need none.
    for (status, count) in
        [("<Idle|MPos:0.000,0.000,0.000>\r\n", 41), ("<Idle|WPos:0.000,0.000,0.000>\r\n", 1)]
    {
        let mut desk = Desk::new("");
        desk.wait(102);
        let sent: Vec<_> = (0..count).map(|_| desk.hear(status) + &desk.wait(40)).collect();
        assert_eq!(sent.concat(), "$I\\n", "{status}");
        assert_eq!(sent.last().unwrap(), "$I\\n", "{status}");
    }
}

#[test]
fn ports_that_answer_a_dwell_of_zero_at_once_get_a_longer_one() {
    for (banner, info) in [
        (
            "Grbl 3.7 [FluidNC v3.7.8 (esp32-wifi) '$' for help]",
            "[VER:3.7 FluidNC v3.7.8 (esp32-wifi):]\r\n[OPT:PH]",
        ),
        ("Grbl 1.3a ['$' for help]", "[VER:1.3a.20220101:]\r\n[OPT:PHBW]"),
    ] {
        let mut desk = Desk::new("");
        desk.hear(&format!("[MSG:INFO: Using driver TMC]\r\n\r\n{banner}\r\n"));
        assert_eq!(desk.status("Idle|MPos:0.000,0.000,0.000|FS:0,0|WCO:0.000,0.000,0.000"), "$I\\n");
        desk.hear(&format!("{info}\r\nok\r\n"));
        desk.grbl.command(Command::Release, desk.now_ns).unwrap();
        desk.wait(300);
        desk.hear("ok\r\n");
        desk.hear("ok\r\n");
        let pick = desk.pick();
        desk.grbl.command(Command::Pick(pick), desk.now_ns).unwrap();
        desk.wait(2);
        assert_eq!(desk.hear("ok\r\nok\r\nok\r\n"), "G4 P0.001\\n", "{banner}");
    }
}
