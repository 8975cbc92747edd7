//! Answers that come later than they should.

use super::*;

const THERE: &str = "X:10.00 Y:20.00 Z:5.00 E:0.00 Count X:1 Y:2 Z:3\r\nok\r\n";

#[test]
fn a_build_that_never_says_busy_is_waited_for_as_long_as_it_refuses_what_it_has() {
    let mut desk = Desk::new();
    desk.wait_for_moves();
    assert_eq!(desk.wait(5000), "N11 M400\\n");
    assert_eq!(desk.hear(&taken(11)) + &desk.wait(30), "N12 M114\\n");
    // Of its queue of four, M400 and two questions are taken; a third question would make it deaf.
    let mut sent = String::new();
    for _ in 0..40 {
        let more = desk.wait(500);
        if !more.is_empty() {
            let line = more.rsplit_once('N').map_or("", |(_, line)| line);
            desk.hear(&taken(line.split(' ').next().unwrap().parse().unwrap()));
        }
        sent += &more;
    }
    assert!(!sent.contains("N14") && sent.matches("N13 M114").count() > 2, "{sent}");
    assert_eq!(desk.hear("ok\r\n"), "");
    // Both are answered, and what stands there is asked once more.
    let next = desk.hear(&format!("{THERE}{THERE}")) + &desk.wait(40);
    assert_eq!(next, "N14 M114\\n");
    assert_eq!(desk.hear(THERE), "N15 M106 S255\\n");
    assert!(!desk.told().iter().any(|report| matches!(report, Report::Disconnected { .. })));
    // One that refuses nothing either is lost.
    desk.hear("ok\r\nok\r\n");
    desk.wait(20_000);
    assert!(desk.told().contains(&Report::Disconnected { cause: Disconnect::Silent }));
}

#[test]
fn a_wait_is_no_delay_of_the_line() {
    let mut desk = Desk::new();
    desk.wait_for_moves();
    // An `ok` before M400 has waited: the question behind it is answered three seconds later.
    assert_eq!(desk.hear("ok\r\n"), "N12 M114\\n");
    // It was taken, so a copy of it is refused meanwhile.
    desk.wait(2900);
    desk.hear(&taken(12));
    desk.wait(100);
    let sent = desk.hear(THERE) + &desk.wait(40);
    assert_eq!(sent, "N13 M106 S255\\n");
    assert!(desk.delay_us < 50_000, "{} us", desk.delay_us);
}

#[test]
fn a_build_that_reads_m410_at_once_and_does_not_answer_is_killed() {
    // A silent link proves nothing, and a build that reads M410 in its turn has not read it yet.
    for (parser, alive, killed) in [("1", true, true), ("0", true, false), ("1", false, false)] {
        let mut desk = Desk::new();
        desk.wait(2);
        desk.hear("start\r\n");
        desk.hear(&format!("FIRMWARE_NAME:Marlin 1.1\r\nCap:EMERGENCY_PARSER:{parser}\r\nok\r\n"));
        desk.hear(&at(0.0));
        desk.marlin.command(Command::Release, desk.now_ns).unwrap();
        for _ in 0..5 {
            desk.wait(2);
            desk.hear(&at(0.0));
        }
        assert!(desk.told().contains(&Report::Ready { clear_of_view: false }));
        desk.pick();
        desk.hear("ok\r\n");
        desk.marlin.command(Command::Hold, desk.now_ns).unwrap();
        // It refuses what it has already, busy with the pieces of its move, and answers nothing.
        let mut sent = String::new();
        for _ in 0..20 {
            let more = desk.wait(200);
            if let Some((_, line)) = more.rsplit_once('N').filter(|_| alive && !sent.is_empty()) {
                desk.hear(&taken(line.split(' ').next().unwrap().parse().unwrap()));
            }
            sent += &more;
        }
        assert_eq!(sent.contains("M112"), killed, "{sent}");
        assert_eq!(desk.told().contains(&Report::Alarm { code: 112 }), killed);
    }
}

#[test]
fn a_stop_that_leaves_it_where_the_move_was_to_end_leaves_its_position_unknown() {
    for (claimed, unknown) in [(THERE, true), (&*at(3.0), false)] {
        let mut desk = Desk::new();
        desk.make_ready();
        desk.pick();
        desk.hear("ok\r\n");
        desk.hear("ok\r\n");
        desk.marlin.command(Command::Hold, desk.now_ns).unwrap();
        desk.wait(1000);
        for _ in 0..5 {
            desk.hear(claimed);
            desk.wait(60);
        }
        let told = desk.told();
        assert_eq!(told.contains(&Report::PositionUnknown), unknown, "{told:?}");
        // The second in which the planner was being cleaned is no delay either.
        assert!(desk.delay_us < 50_000, "{} us", desk.delay_us);
        assert!(told.ends_with(&[Report::Held { by: HeldBy::Command }]), "{told:?}");
    }
}
