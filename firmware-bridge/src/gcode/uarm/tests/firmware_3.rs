//! Firmware 3, as its Marlin_main.cpp, uArmSwift.cpp and uArmService.cpp answer.

use super::*;

const PARKED: [f64; 3] = [0.0, -200.0, 150.0];

/// What firmware 3 does while the test waits.
struct Arm {
    moving: bool,
    /// Where its encoders are.
    at_mm: [f64; 3],
    /// Where it was sent last.
    believed_mm: [f64; 3],
    turns_angles: bool,
    planned: bool,
}

impl Arm {
    fn parked() -> Self {
        Self { moving: false, at_mm: PARKED, believed_mm: PARKED, turns_angles: true, planned: true }
    }

    /// The answer to a line, if there is one. (The angles of this arm are its coordinates.)
    fn answer(&self, line: &str) -> String {
        let Some((tag, command)) = line.strip_prefix('#').and_then(|line| line.split_once(' ')) else {
            return if line == "M410" {
                "ok\n".into()
            } else {
                format!("echo:Unknown command: \"{line}\"\n")
            };
        };
        let [x, y, z] = self.at_mm;
        let [to_x, to_y, to_z] = self.believed_mm;
        let value = match command.split(' ').next().unwrap() {
            "P2203" => "V3.2.0".into(),
            "M2200" => format!("V{}", u8::from(self.moving)),
            "P2220" => format!("X{to_x:.2} Y{to_y:.2} Z{to_z:.2}"),
            "P2200" => format!("B{x:.2} L{y:.2} R{z:.2}"),
            "M2221" if self.turns_angles => format!("X{x:.2} Y{y:.2} Z{z:.2}"),
            "M2222" => "V1".into(),
            "G0" | "G1" if !self.planned => return String::new(),
            _ => String::new(),
        };
        format!("${tag} ok {value}\r\n")
    }
}

impl Desk {
    /// So many ms with this arm; what was sent, without its tags.
    fn with(&mut self, arm: &Arm, ms: i64) -> String {
        let mut all = String::new();
        for _ in 0..ms {
            let sent = self.wait(1);
            all += &self.answered(arm, &sent);
        }
        all
    }

    /// Answers what was sent; gives it without its tags.
    fn answered(&mut self, arm: &Arm, sent: &str) -> String {
        for line in sent.replace("\\n", "\n").replace('|', "").lines().filter(|line| !line.is_empty()) {
            self.uarm.on_bytes(arm.answer(line).as_bytes(), self.now_ns);
        }
        let untagged =
            |part: &str| part.trim_start_matches(|c: char| c.is_ascii_digit()).trim_start().to_owned();
        sent.split('#').map(untagged).collect()
    }

    /// A pick begins.
    fn pick_with(&mut self, arm: &Arm) {
        let sent = self.pick();
        self.answered(arm, &sent);
    }

    fn meet(arm: &Arm) -> Self {
        let mut desk = Self::new();
        desk.state = None;
        desk.uarm.on_bytes(b"start\r\necho:Marlin 1.1.0-RC6\r\n", desk.now_ns);
        desk.with(arm, 500);
        assert_eq!(desk.told(), [Report::Connected { session: 7, held_by: HeldBy::Start }]);
        desk
    }

    fn ready(arm: &Arm) -> Self {
        let mut desk = Self::meet(arm);
        desk.uarm.command(Command::Release, desk.now_ns).unwrap();
        desk.with(arm, 500);
        assert_eq!(desk.told(), [Report::Ready { clear_of_view: false }]);
        desk
    }
}

#[test]
fn it_is_stopped_by_a_bare_m410_and_only_its_encoders_say_that_it_stands() {
    let mut arm = Arm::parked();
    let mut desk = Desk::ready(&arm);
    desk.pick_with(&arm);
    arm.moving = true;
    desk.with(&arm, 50);
    desk.uarm.command(Command::Hold, desk.now_ns).unwrap();
    // G2203 alone, called a stop, waits until all moves are done.
    let sent = desk.with(&arm, 1);
    assert_eq!(sent, "|\\nM410\\nM2000\\n");
    // It goes on: M410 once more.
    let sent = desk.with(&arm, 100);
    assert!(sent.contains("|\\nM410\\n") && sent.contains("G2203\\nM2200\\n"), "{sent}");
    assert!(!desk.told().iter().any(|report| matches!(report, Report::Held { .. })));
    arm.moving = false;
    desk.with(&arm, 200);
    let failed = Report::Failed { id: 7, failure: Failure::Held };
    assert!(desk.told().ends_with(&[failed, Report::Held { by: HeldBy::Command }]));
}

#[test]
fn one_that_was_stopped_and_believes_to_be_elsewhere_is_not_moved() {
    let mut arm = Arm::parked();
    let mut desk = Desk::ready(&arm);
    desk.uarm.command(Command::Hold, desk.now_ns).unwrap();
    desk.with(&arm, 300);
    desk.told();
    arm.believed_mm = [30.0, 20.0, 10.0];
    desk.uarm.command(Command::Release, desk.now_ns).unwrap();
    let sent = desk.with(&arm, 300);
    assert!(sent.contains("P2220\\n") && !sent.contains("G90"), "{sent}");
    assert!(desk.told().contains(&Report::Alarm { code: 1000 }));
    // An unlock does not make it right, a restart does.
    desk.uarm.command(Command::Unlock, desk.now_ns).unwrap();
    assert!(!desk.with(&arm, 300).contains("\\x18"));
    assert!(desk.told().contains(&Report::Alarm { code: 1000 }));
    desk.uarm.on_bytes(b"start\r\n", desk.now_ns);
    arm.believed_mm = PARKED;
    desk.with(&arm, 300);
    desk.told();
    desk.uarm.command(Command::Release, desk.now_ns).unwrap();
    assert!(desk.with(&arm, 300).contains("G90"));
}

#[test]
fn one_that_counts_steps_and_does_not_get_on_is_stopped_before_its_pick_times_out() {
    for blocked in [true, false] {
        let mut arm = Arm::parked();
        let mut desk = Desk::ready(&arm);
        desk.pick_with(&arm);
        arm.moving = true;
        let mut sent = String::new();
        for _ in 0..30 {
            sent += &desk.with(&arm, 100);
            arm.at_mm[0] += if blocked { 0.01 } else { 0.2 };
        }
        assert_eq!(sent.contains("|"), blocked, "{sent}");
        arm.moving = false;
        if blocked {
            desk.with(&arm, 300);
            let failed = Report::Failed { id: 7, failure: Failure::Controller { code: 1000 } };
            assert!(desk.told().ends_with(&[failed, Report::Held { by: HeldBy::Alarm }]));
        }
    }
}

#[test]
fn what_it_planned_is_not_where_it_is() {
    let mut arm = Arm::parked();
    let mut desk = Desk::ready(&arm);
    desk.pick_with(&arm);
    desk.with(&arm, 20);
    arm.believed_mm = [10.0, 20.0, 5.0];
    // Standing, and far from the point: no gripper closes.
    let sent = desk.with(&arm, 1000);
    assert!(sent.contains("M410") && !sent.contains("M2232 V1"), "{sent}");
}

#[test]
fn a_build_that_turns_no_angles_is_asked_for_what_it_has() {
    let mut arm = Arm::parked();
    arm.turns_angles = false;
    let mut desk = Desk::ready(&arm);
    desk.uarm.command(Command::Hold, desk.now_ns).unwrap();
    assert!(desk.with(&arm, 300).ends_with("P2220\\n"));
    assert!(desk.told().ends_with(&[Report::Held { by: HeldBy::Command }]));
}

#[test]
fn a_move_of_many_short_ones_is_answered_late() {
    let mut arm = Arm::parked();
    let mut desk = Desk::ready(&arm);
    arm.planned = false;
    desk.pick_with(&arm);
    assert!(!desk.with(&arm, 8000).contains('|'));
    let told = desk.told();
    assert!(!told.iter().any(|report| matches!(report, Report::Failed { .. })), "{told:?}");
}

#[test]
fn bytes_of_firmware_4_spoil_no_line_of_it() {
    // Its boot is longer than a greeting waits: a reset byte goes out, which begins a line for it.
    let mut desk = Desk::new();
    desk.state = None;
    desk.hear("start\r\necho:Marlin 1.1.0-RC6\r\n");
    let sent = desk.wait(8000);
    assert!(sent.contains("|\\x18\\n#") && !sent.contains("\\x18#"), "{sent}");
    assert!(!desk.told().contains(&Report::WrongDialect));
    desk.with(&Arm::parked(), 2500);
    assert!(desk.told().iter().any(|report| matches!(report, Report::Connected { .. })));
}

#[test]
fn a_firmware_that_does_not_know_the_stop_of_firmware_3_is_stopped_as_firmware_4() {
    let mut desk = Desk::meet(&Arm::parked());
    desk.uarm.command(Command::Hold, desk.now_ns).unwrap();
    let sent = desk.wait(1);
    let tag = sent.split('#').nth(1).and_then(|sent| sent.split(' ').next()).unwrap().to_owned();
    assert_eq!(desk.hear(&format!("${tag} E20\n")), "|!");
}
