//! Answers that come sooner than they should.

use super::*;

#[test]
fn builds_that_say_ok_before_what_they_were_asked_for_are_understood() {
    let mut desk = Desk::new();
    desk.wait(2);
    desk.hear("start\r\n");
    desk.hear("ok\r\n");
    desk.hear("FIRMWARE_NAME:Marlin 2.1.2\r\nCap:EEPROM:1\r\n");
    assert_eq!(desk.wait(40), "N2 M114\\n");
    desk.hear("ok\r\nX:0.0 Y:0.0 Z:0.0 E:0.0 Count: A:0 B:0 C:0\r\n");
    desk.wait(40);
    assert_eq!(desk.told(), [Report::Connected { session: 7, held_by: HeldBy::Start }]);
}

#[test]
fn an_answer_too_early_for_a_quick_stop_says_that_it_was_not_taken() {
    let mut desk = Desk::new();
    desk.make_ready();
    desk.pick();
    desk.hear("ok\r\n");
    desk.marlin.command(Command::Hold, desk.now_ns).unwrap();
    assert_eq!(desk.wait(300), "|\\nM410\\n|M410\\nN10 M114\\n");
    // A planner that is being cleaned would say nothing for a second.
    let sent = desk.hear(&at(3.0)) + &desk.wait(60);
    assert_eq!(sent, "|\\nM410\\nN11 M114\\n");
    desk.wait(1000);
    desk.hear("ok\r\n");
    assert_eq!(desk.hear(&at(3.0)) + &desk.wait(60), "N12 M114\\n");
    assert_eq!(desk.hear(&at(3.0)), "N13 M400\\n");
    desk.hear("ok\r\n");
    desk.hear(&at(3.0));
    assert!(desk.told().ends_with(&[Report::Held { by: HeldBy::Command }]));
}

#[test]
fn an_ok_that_comes_before_the_wait_is_over_makes_no_lost_connection_of_the_silence_after_it() {
    let mut desk = Desk::new();
    desk.wait_for_moves();
    // The `ok` of M400 at once; then nothing is read, let alone answered, until the arm stands.
    assert_eq!(desk.hear("ok\r\n"), "N12 M114\\n");
    let sent = desk.wait(4000);
    assert_eq!(sent, "N12 M114\\n");
    desk.hear("ok\r\n");
    let there = "X:10.00 Y:20.00 Z:5.00 E:0.00 Count X:1 Y:2 Z:3\r\n";
    let next = desk.hear(there) + &desk.wait(40);
    assert_eq!(next, "N13 M106 S255\\n");
    // The copy of the question is refused.
    desk.hear("Error: expected line 13 got 12\r\nResend:13\r\nok\r\n");
    assert_eq!(desk.wait(30), "N13 M106 S255\\n");
    assert_eq!(desk.hear("ok\r\n"), "N14 G4 P400\\n");
    desk.hear("ok\r\n");
    assert!(desk.wait(3000).starts_with("N15 G1 X10.000"));
    assert!(!desk.told().iter().any(|report| matches!(report, Report::Disconnected { .. })));
    // A link that stays silent is lost all the same.
    desk.wait(6000);
    assert!(desk.told().contains(&Report::Lost { id: 7 }));
}
