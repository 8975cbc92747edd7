//! What a template may say, and what is refused with which words.

use super::*;
use crate::gate::tests::pick;

fn settings(dialect: &str, axes: &str, moves: &str) -> Settings {
    let text = format!(
        "[arm]\ndialect = \"{dialect}\"\naxes = \"{axes}\"\n[arm.moves]\n{moves}\n\
         [workspace]\nmin_mm = [-200, -200, 0]\nmax_mm = [200, 200, 300]\n"
    );
    toml::from_str(&text).unwrap()
}

fn complaint(dialect: &str, moves: &str) -> String {
    Program::compile(&settings(dialect, "xyz", moves)).unwrap_err().to_string()
}

/// The complaint about one line in an otherwise good pick.
fn line_complaint(dialect: &str, line: &str) -> String {
    complaint(dialect, &format!("pick = [\"G0 X{{grasp_x}} Y{{grasp_y}} Z{{grasp_z}} F100\", {line:?}]"))
}

fn filled(program: &Program, list: List) -> Vec<String> {
    let fill = |step: &Step| match step {
        Step::Line(line) => {
            let filled = line.fill(Some(&pick()), program.tool()).unwrap();
            String::from_utf8(filled.text.as_bytes().to_vec()).unwrap()
        }
        Step::Held => "held?".into(),
    };
    program.list(list).iter().map(fill).collect()
}

#[test]
fn every_dialect_has_moves_of_its_own() {
    for dialect in ["grbl", "marlin", "uarm"] {
        let program = Program::compile(&settings(dialect, "xyz", "")).unwrap();
        let lines = filled(&program, List::Pick).join("\n");
        assert!(lines.contains("G1 X10.000 Y20.000 Z5.000 F1500"), "{dialect}: {lines}");
        assert!(!filled(&program, List::Missed).is_empty());
    }
    let program = Program::compile(&settings("uarm", "xyz+yaw", "")).unwrap();
    assert!(filled(&program, List::Pick).contains(&"G2202 N3 V26.57 F1000".into()));
}

#[test]
fn an_arm_that_should_turn_needs_moves_that_do() {
    let text = Program::compile(&settings("grbl", "pose", "")).unwrap_err().to_string();
    assert!(text.starts_with("arm.axes = \"pose\", but no line of arm.moves.pick turns the tool"), "{text}");
    let moves = "pick = [\"G0 X{grasp_x} Y{grasp_y} Z{grasp_z} A{grasp_yaw}\"]";
    let program = Program::compile(&settings("grbl", "xyz+yaw", moves)).unwrap();
    assert_eq!(filled(&program, List::Pick), ["G0 X10.000 Y20.000 Z5.000 A0.00"]);
}

#[test]
fn lines_name_list_line_and_remedy() {
    assert_eq!(
        line_complaint("grbl", "G1 X{grasp_q} F100"),
        "arm.moves.pick, line 2, \"G1 X{grasp_q} F100\": unknown name {grasp_q}: there are {approach_…}, {grasp_…}, \
         {retreat_…}, {place_…} with x, y, z, yaw, pitch, roll or wrist, {travel_z}, {opening}, \
         {opening_permille}, {slot}; your own go into arm.moves.values"
    );
    assert!(complaint("grbl", "start = [\"G0 X{grasp_x}\"]").contains("also runs without a pick"));
    assert!(line_complaint("grbl", "g91").contains("relative"));
    assert!(line_complaint("grbl", "G1 X5 G91 F100").contains("relative"));
    assert!(line_complaint("grbl", "G21 g20").contains("inches"));
    assert!(line_complaint("grbl", "G0 X1 G92 X0").contains("shifts"));
    assert!(line_complaint("marlin", "G90 G21").contains("one command a line"));
    assert!(line_complaint("grbl", "$H").contains("not understood"));
    assert!(line_complaint("grbl", "$110=500").contains("not understood"));
    assert!(line_complaint("marlin", "G28").contains("home in arm.moves.start"));
    assert!(line_complaint("grbl", "X5 Y5").contains("begin it with G0 or G1"));
    assert!(line_complaint("grbl", "F100 G1 X5").contains("begin it with G0 or G1"));
    assert!(line_complaint("grbl", "M98 P1").contains("macro"));
    assert!(
        line_complaint("grbl", "G0 X201")
            .contains("X201 is not allowed: it must be inside [workspace], -200 to 200")
    );
    assert!(line_complaint("grbl", "G0 X1 X2").contains("each once"));
    assert!(line_complaint("grbl", "G1 F100").contains("at least one of"));
    assert!(line_complaint("grbl", "G1 X F100").contains("a number or a {name}"));
    assert!(line_complaint("grbl", "G1 X5 F0").contains("above 0"));
    assert!(line_complaint("grbl", "G4 P61").contains("0 to 60 s"));
    assert!(line_complaint("uarm", "G2202 N1 V90 F100").contains("the wrist"));
    assert!(line_complaint("uarm", "M3 S100").contains("not understood in this dialect"));
    assert!(complaint("grbl", "pick = [\"G1 X{grasp_x}\"]").contains("G1 has no speed"));
    let long = "G1 X{grasp_x} Y{grasp_y} Z{grasp_z} A{grasp_yaw} B{grasp_pitch} C{grasp_roll} F1000";
    assert!(line_complaint("grbl", long).contains("the controller takes 69"));
}

#[test]
fn a_pick_goes_to_the_grasp_and_asks_what_it_can() {
    assert!(complaint("grbl", "pick = [\"G0 X{place_x}\"]").contains("never uses {grasp_x}"));
    let go = "\"G0 X{grasp_x} Y{grasp_y} Z{grasp_z}\"";
    assert!(complaint("grbl", &format!("pick = [{go}, \"held?\"]")).contains("arm.moves.held is missing"));
    let held = "held = { ask = \"?\", expect = \"Pn:P\" }";
    assert!(complaint("grbl", &format!("pick = [{go}]\n{held}")).contains("the entry is missing"));
    assert!(complaint("marlin", &format!("pick = [{go}, \"held?\"]\n{held}")).contains("can be asked M119"));
    let program =
        Program::compile(&settings("grbl", "xyz", &format!("pick = [{go}, \"held?\"]\n{held}"))).unwrap();
    assert_eq!(filled(&program, List::Pick)[1], "held?");
}

#[test]
fn own_values_are_numbers_with_free_names() {
    assert!(complaint("grbl", "values = { grasp_x = 3.0 }").contains("taken by PickCell"));
    assert!(complaint("grbl", "values = { feed = nan }").contains("must be a number"));
    let moves = "values = { feed = 2500 }\npick = [\"G1 X{grasp_x} Y{grasp_y} Z{grasp_z} F{feed} ; slowly\"]";
    let program = Program::compile(&settings("grbl", "xyz", moves)).unwrap();
    assert_eq!(filled(&program, List::Pick), ["G1 X10.000 Y20.000 Z5.000 F2500.000"]);
}

#[test]
fn homing_stands_in_start_only() {
    let program = Program::compile(&settings("grbl", "xyz", "start = [\"$h\"]")).unwrap();
    assert!(program.homes());
    assert_eq!(filled(&program, List::Start), ["$H"]);
    let program = Program::compile(&settings("marlin", "xyz", "start = [\"G28 X Y\"]")).unwrap();
    assert_eq!(filled(&program, List::Start), ["G28 X Y"]);
}

#[test]
fn a_number_that_is_none_fills_no_line() {
    let program = Program::compile(&settings("grbl", "xyz", "")).unwrap();
    let mut bad = pick();
    bad.grasp.position_mm[1] = f64::NAN;
    let unfilled = program.list(List::Pick).iter().any(|step| match step {
        Step::Line(line) => line.fill(Some(&bad), program.tool()).is_none(),
        Step::Held => false,
    });
    assert!(unfilled);
}

#[test]
fn the_first_cell_of_the_documentation_is_taken_with_every_dialect() {
    let page = include_str!("../../../GCODE.md");
    let text = page.split("```toml\n").nth(1).and_then(|rest| rest.split("```").next()).expect("an example");
    for dialect in ["grbl", "marlin", "uarm"] {
        let text = text.replace("dialect = \"grbl\"", &format!("dialect = \"{dialect}\""));
        let settings = Settings::parse(&text).unwrap_or_else(|error| panic!("{dialect}: {error}"));
        assert!(Program::compile(&settings).is_ok());
    }
    let unsaid = text.replace("axes = \"xyz\"", "");
    let complaint = Settings::parse(&unsaid).unwrap_err().to_string();
    assert!(complaint.contains("write axes = \"xyz\""), "{complaint}");
}
