//! What is said about tables that are wrong, message by message.

use super::*;

const BOX: &str = "[workspace]\nmin_mm = [0, 0, 0]\nmax_mm = [1, 1, 1]\n";

fn complaint(text: &str) -> String {
    Settings::parse(text).unwrap_err().to_string()
}

#[test]
fn tables_of_others_are_ignored_and_defaults_are_allowed_values() {
    let settings = Settings::parse(&format!("{BOX}[cameras]\nbackend = \"v4l\"\n")).unwrap();
    assert_eq!(settings.arm, Arm::default());
    assert_eq!(settings.gripper, Gripper::default());
}

#[test]
fn an_error_of_a_file_names_the_file() {
    let path = std::env::temp_dir().join(format!("firmware-bridge-config-{}.toml", std::process::id()));
    std::fs::write(&path, format!("{BOX}[arm]\nresends = 99\n[realtime]\narm_priority = 99\n")).unwrap();
    let named = |message: String| message.starts_with(&format!("{}, line ", path.display()));
    assert!(named(Settings::read(&path).unwrap_err().to_string()));
    assert!(named(crate::realtime::ArmThread::read(&path).unwrap_err().to_string()));
    std::fs::remove_file(&path).unwrap();
}

#[test]
fn an_error_names_key_value_and_what_is_allowed() {
    for (text, message) in [
        ("[arm]\nresends = 99", "line 5: arm.resends = 99 is not possible; allowed: 0 to 20"),
        (
            "[arm]\nresends = -3",
            "line 5: arm.resends = -3 is not possible; allowed: a whole number, 0 or more",
        ),
        (
            "[arm]\nresends = 5000000000",
            "line 5: arm.resends = 5000000000 is not possible; allowed: a smaller whole number",
        ),
        (
            "[arm]\nttl_ms = 66.7",
            "line 5: arm.ttl_ms = 66.7 is not possible; allowed: a whole number, 0 or more",
        ),
        (
            "[arm]\ndialect = \"gcode\"",
            "line 5: arm.dialect = \"gcode\" is not possible; allowed: \"own\", \"grbl\", \"marlin\", \"uarm\"",
        ),
        (
            "[arm]\nresume = \"never\"",
            "line 5: arm.resume = \"never\" is not possible; allowed: \"manual\", \"auto\"",
        ),
        ("[arm]\nport = 3", "line 5: arm.port = 3 is not possible; allowed: a text in quotes"),
        ("[arm]\nlink = 3", "line 5: arm.link = 3 is not possible; allowed: a text in quotes"),
        (
            "[arm]\nservice = \"a/b\"",
            "line 5: arm.service = \"a/b\" is not possible; allowed: 1 to 64 of A-Z a-z 0-9 - _ .",
        ),
        (
            "[arm]\nlink = \"serial\"",
            "line 4: arm.port is missing; link = \"serial\" needs the device, e.g. port = \"/dev/ttyUSB0\"",
        ),
        (
            "[arm.moves]\nstart = [\"G21\", 7]",
            "line 5: arm.moves.start: value 2 = 7 is not possible; allowed: a text in quotes",
        ),
        (
            "[arm.moves]\nstart = \"G21\"",
            "line 5: arm.moves.start = \"G21\" is not possible; allowed: a list in [ ]",
        ),
        (
            "[arm.moves.values]\nfeed = \"x\"",
            "line 5: arm.moves.values.feed = \"x\" is not possible; allowed: a number",
        ),
        ("[arm.moves]\nheld = 3", "line 5: arm.moves.held = 3 is not possible; allowed: a table"),
        (
            "[arm.moves]\nheld = { ask = \"?\" }",
            "line 5: arm.moves.held.expect is missing; add it: it has no default",
        ),
        (
            "[gripper]\nopening = 3",
            "line 5: gripper.opening: there is no such key; allowed here: opening_max_mm, opening_min_mm, \
             clearance_mm, finger_thickness_mm, finger_width_mm, finger_depth_mm, approach_mm, retreat_mm, \
             closing_yaw_deg",
        ),
        ("[arm", "line 4: \"[arm\" is no TOML: unclosed table, expected `]`"),
        (
            "[arm]\nbaud = 9600\nbaud = 1200",
            "line 6: \"baud = 1200\" is no TOML: duplicate key; remove one of the two",
        ),
    ] {
        assert_eq!(complaint(&format!("{BOX}{text}\n")), message);
    }
    for (text, message) in [
        (
            "min_mm = [0, 0, 0]\nmax_mm = [1, nan, 1]",
            "line 3: workspace.max_mm = NaN is not possible; allowed: -100000 to 100000",
        ),
        (
            "min_mm = [0, 0, 0]\nmax_mm = [1, 1, -1]",
            "line 3: workspace.max_mm = [1.0, 1.0, -1.0] is not possible; allowed: above workspace.min_mm = \
             [0.0, 0.0, 0.0] on every axis",
        ),
        (
            "min_mm = [0, 0, 0, 0]\nmax_mm = [1, 1, 1]",
            "line 2: workspace.min_mm = [0, 0, 0, 0] is not possible; allowed: a list of 3 values",
        ),
        (
            "min_mm = [0, \"a\", 0]\nmax_mm = [1, 1, 1]",
            "line 2: workspace.min_mm: value 2 = \"a\" is not possible; allowed: a number",
        ),
        (
            "min_mm = [\n  0,\n  0,\n]\nmax_mm = [1, 1, 1]",
            "line 2: workspace.min_mm = [ 0, 0, ] is not possible; allowed: a list of 3 values",
        ),
        ("min_mm = [0, 0, 0]", "line 1: workspace.max_mm is missing; add it: it has no default"),
    ] {
        assert_eq!(complaint(&format!("[workspace]\n{text}\n")), message);
    }
    assert_eq!(complaint("[arm]\n"), "workspace is missing; add it: it has no default");
}

#[test]
fn a_move_that_is_not_allowed_is_found_in_the_file() {
    let arm = "[arm]\ndialect = \"grbl\"\naxes = \"xyz\"\n[arm.moves]\n";
    let pick = "\"G0 X{grasp_x} Y{grasp_y} Z{grasp_z}\"";
    for (moves, begin) in [
        (
            format!("pick = [\n{pick},\n\"G91\",\n]"),
            "line 10: arm.moves.pick, line 2, \"G91\": G91 makes moves",
        ),
        ("pick = [\"G0 X1\"]".to_owned(), "line 8: arm.moves.pick never uses {grasp_x}"),
        ("values = { feed = 1e9 }".to_owned(), "line 8: arm.moves.values.feed = 1000000000 is not allowed"),
        (format!("pick = [{pick}, \"held?\"]"), "line 7: arm.moves.held and the entry"),
        (
            format!("pick = [{pick}, \"held?\"]\n[arm.moves.held]\nask = \"!\"\nexpect = \"V\""),
            "line 10: arm.moves.held.ask = \"!\" is not allowed",
        ),
    ] {
        let message = complaint(&format!("{BOX}{arm}{moves}\n"));
        assert!(message.starts_with(begin), "{message}\nwanted: {begin}");
    }
    let turns = complaint(&format!("{BOX}{}", arm.replace("xyz", "pose")));
    assert!(turns.starts_with("line 6: arm.axes = \"pose\", but no line"), "{turns}");
}
