//! What `check` says about cells without hardware.

use std::fs;
use std::path::{Path, PathBuf};

use super::*;

fn project() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// A copy of the project's cell with one piece of it replaced; paths still lead into the project.
fn changed(was: &str, is: &str) -> (tempfile::TempDir, PathBuf) {
    let text = fs::read_to_string(project().join("cell.toml")).expect("the project's cell");
    assert!(text.contains(was), "{was:?} is not in the project's cell");
    let replay = format!("\"{}/replay/", project().display());
    let text = text.replacen(was, is, 1).replace("\"replay/", &replay);
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = folder.path().join("cell.toml");
    fs::write(&file, text).expect("a file");
    (folder, file)
}

fn findings(cell: &Path) -> Findings {
    check(&CheckArgs { cell: cell.to_owned(), format: Format::Text })
}

fn complaint(was: &str, is: &str) -> (u8, String) {
    let (_folder, cell) = changed(was, is);
    let findings = findings(&cell);
    let worst = findings.findings.iter().max_by_key(|finding| finding.level).expect("a finding");
    let remedy = worst.remedy.clone().unwrap_or_default();
    (findings.exit_code(), format!("{}: {} → {remedy}", worst.subject, worst.finding))
}

#[test]
fn the_cell_that_comes_with_the_project_is_ready() {
    let findings = findings(&project().join("cell.toml"));
    assert_eq!(findings.exit_code(), 0, "{}", findings.in_words());
    let subjects: Vec<_> = findings.findings.iter().map(|finding| finding.subject.as_str()).collect();
    for subject in ["cell.toml", "calibration", "parts", "session", "workspace", "place", "cores", "arm"] {
        assert!(subjects.contains(&subject), "{subject} in {subjects:?}");
    }
    let json: serde_json::Value = serde_json::from_str(&findings.as_json()).expect("json");
    assert_eq!(json["ready"], true);
    assert_eq!(json["findings"][0]["level"], "ok");
}

#[test]
fn a_cell_that_is_wrong_ends_with_2() {
    let (code, text) = complaint("threads = 2", "threads = 3");
    assert_eq!(code, 2);
    assert!(text.contains("recognition.threads = 3 is not possible; allowed: 1 or 2"), "{text}");
    let (code, text) = complaint("session = \"replay/conveyor\"", "session = \"replay/parts\"");
    assert_eq!((code, text.starts_with("session: ")), (2, true), "{text}");
    let (code, text) =
        complaint("# region_px = [[0, 0], [640, 0], [640", "region_px = [[0, 0], [700, 0], [640");
    assert_eq!(code, 2);
    let wanted =
        "cell.toml, line 44: recognition.region_px: corner 1 is (700, 0), outside the 640x480 picture";
    assert!(text.contains(wanted), "{text}");
    let (code, text) = complaint(
        "# region_px = [[0, 0], [640, 0], [640, 480], [0, 480]]",
        "region_px = { left = [[0, 0], [640, 0], [640, 480]], right = [[0, 0], [1000, 0], [640, 480]] }",
    );
    assert_eq!(code, 2);
    assert!(text.starts_with("right picture: "), "{text}");
    assert!(text.contains("line 44: recognition.region_px.right: corner 1 is (1000, 0), outside"), "{text}");
    let missing = findings(Path::new("/nowhere/cell.toml"));
    assert_eq!(missing.exit_code(), 2);
    assert!(missing.in_words().contains("name the cell's file with --cell FILE"));
}

#[test]
fn what_would_keep_the_cell_from_picking_ends_with_1() {
    let (code, text) = complaint("max_mm = [420.0, 260.0, 220.0]", "max_mm = [420.0, 160.0, 220.0]");
    assert_eq!(code, 1);
    assert!(
        text.contains("slot in column 1 of row 1 at (160.0, 170.0, 20.0) mm is outside the workspace"),
        "{text}"
    );
    let (code, text) = complaint("# jump_max_mm = 150.0", "jump_max_mm = 20.0");
    assert_eq!(code, 1);
    assert!(text.contains("workspace.jump_max_mm is 20 → make gripper.approach_mm"), "{text}");
    let (code, text) = complaint("link = \"replay\"", "link = \"serial\"\nport = \"/dev/none\"");
    assert_eq!(code, 1);
    assert!(text.contains("/dev/none: No such file or directory (os error 2) → is it plugged in"), "{text}");
    let (code, text) = complaint("translation_mm = [230.0,", "translation_mm = [2300.0,");
    assert_eq!(code, 1);
    assert!(text.contains("both cameras see 0 % of its floor → no part that the cameras see"), "{text}");
    let (code, text) = complaint("base_from_left =", "# base_from_left =");
    assert_eq!(code, 1);
    assert!(text.contains("measure the pose of the left camera in the robot's base"), "{text}");
    let (code, text) = complaint("# cores = [0]", "cores = [900]");
    assert_eq!(code, 1);
    assert!(text.contains("realtime.cores names core 900"), "{text}");
}

#[test]
fn a_regular_file_is_no_serial_port() {
    let (code, text) = complaint("link = \"replay\"", "link = \"serial\"\nport = \"cell.toml\"");
    assert_eq!(code, 2);
    assert!(text.contains("it is no serial device"), "{text}");
}

#[test]
fn a_real_arm_that_resumes_by_itself_is_warned_of() {
    let (_folder, cell) =
        changed("link = \"replay\"", "link = \"serial\"\nttl_ms = 50\nport = \"/dev/ptmx\"");
    let text =
        fs::read_to_string(&cell).expect("a cell").replace("# deadline_ms = 66.7", "deadline_ms = 66.7");
    fs::write(&cell, text).expect("a file");
    let words = findings(&cell).in_words();
    assert!(words.contains("WARNING  arm.resume: \"auto\": the arm begins to move by itself"), "{words}");
    assert!(words.contains("WARNING  arm.ttl_ms: targets live 50 ms, the deadline is 66 ms"), "{words}");
}

#[test]
fn a_place_record_that_cannot_be_used_and_a_recording_that_cannot_be_made_are_found() {
    let state = "state = \"out/place.state\"";
    let (code, text) = complaint(state, "state = \"/proc/place.state\"");
    assert_eq!((code, text.starts_with("place.state: /proc cannot be written: ")), (1, true), "{text}");
    let (code, text) = complaint(state, "state = \"/proc/x/y\"");
    assert_eq!((code, text.contains("/proc/x is not there and cannot be made: ")), (1, true), "{text}");
    let (code, text) = complaint(state, "state = \"/proc\"");
    assert_eq!(
        (code, text.starts_with("place.state: /proc: cannot read or write it: ")),
        (2, true),
        "{text}"
    );
    let (code, text) = complaint(state, "state = \"cell.toml\"");
    assert_eq!((code, text.contains("not a place record")), (2, true), "{text}");
    let (code, text) = complaint(state, "state = \"\"");
    assert_eq!((code, text.contains("place.state = \"\" is not possible")), (2, true), "{text}");
    let (code, text) = complaint("[realtime]", "[recording]\nfolder = \"/proc\"\n[realtime]");
    assert_eq!((code, text.starts_with("recording.folder: /proc cannot be written: ")), (1, true), "{text}");
}

#[test]
fn what_run_refuses_of_a_real_arm_is_no_ready_cell() {
    let fast = ("pace = \"realtime\"", "pace = \"fast\"");
    let (_folder, cell) = changed(fast.0, fast.1);
    assert_eq!(findings(&cell).exit_code(), 0);
    let text = fs::read_to_string(&cell).expect("the cell");
    fs::write(&cell, text.replacen("link = \"replay\"", "link = \"shared-memory\"", 1)).expect("a file");
    let findings = findings(&cell);
    assert!(findings.exit_code() > 0 && findings.in_words().contains("recorded targets to a real arm"));
}

#[test]
fn every_picture_of_a_session_is_looked_at() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let there = project().join("replay/conveyor");
    fs::write(folder.path().join("session.toml"), "rate_hz = 30").expect("a file");
    for side in ["left", "right"] {
        fs::create_dir(folder.path().join(side)).expect("a folder");
        for name in ["0000.jpg", "0001.jpg"] {
            fs::copy(there.join(side).join(name), folder.path().join(side).join(name)).expect("a copy");
        }
    }
    let session = format!("session = {:?}", folder.path());
    let last = folder.path().join("right/0001.jpg");
    let small = image::GrayImage::from_pixel(32, 24, image::Luma([9]));
    small.save(&last).expect("a picture");
    let (code, text) = complaint("session = \"replay/conveyor\"", &session);
    assert_eq!((code, text.contains("right/0001.jpg: ") && text.contains("32x24")), (0, true), "{text}");
    fs::write(&last, "no picture").expect("a file");
    let (code, text) = complaint("session = \"replay/conveyor\"", &session);
    assert_eq!((code, text.contains("right/0001.jpg")), (2, true), "{text}");
}

#[test]
fn what_the_gripper_cannot_take_and_the_tray_cannot_hold_is_a_warning() {
    let (code, text) = complaint("opening_max_mm = 30.0", "opening_max_mm = 5.0");
    assert_eq!(code, 0);
    assert!(text.contains("gripper: rod-90 needs 8 mm between the fingers, they open to 5 mm"), "{text}");
    let (code, text) = complaint("column_step_mm = [20.0, 0.0, 0.0]", "column_step_mm = [0.5, 0.0, 0.0]");
    assert_eq!(code, 0);
    assert!(text.contains("place: slots are nearer to each other than a part is thick, 3 mm"), "{text}");
    let calibration = project().join("replay/conveyor/calibration.yaml");
    let rig = fs::read_to_string(&calibration).expect("a calibration");
    let (folder, cell) =
        changed("calibration = \"replay/conveyor/calibration.yaml\"", "calibration = \"rig.yaml\"");
    let exchanged = rig.replacen("-63.789745829089803", "63.789745829089803", 1);
    fs::write(folder.path().join("rig.yaml"), exchanged).expect("a file");
    let said = findings(&cell).in_words();
    assert!(said.contains("the right camera stands at the left of the left one"), "{said}");
}

#[test]
fn one_pair_is_recognised_and_what_blocks_all_parts_is_a_warning() {
    let said = findings(&project().join("cell.toml")).in_words();
    assert!(said.contains("ok       recognition: pair 0000: "), "{said}");
    let (code, text) = complaint("colour = \"auto\"", "colour = { grey_min = 254, grey_max = 255 }");
    assert_eq!((code, text.contains("no pick: bin empty → put parts")), (0, true), "{text}");
    let (code, text) = complaint("colour = \"auto\"", "colour = { grey_min = 0, grey_max = 255 }");
    assert_eq!((code, text.starts_with("recognition: pair 0000: left picture")), (0, true), "{text}");
    let (code, text) = complaint("tilt_max_deg = 40.0", "tilt_max_deg = 0.0");
    assert_eq!((code, text.starts_with("workspace.tilt_max_deg: 0 degrees: ")), (0, true), "{text}");
    let (code, text) = complaint("# pair_window_ms = 13.3", "pair_window_ms = 40.0");
    assert_eq!((code, text.contains("cameras.pair_window_ms = 40 is not possible")), (2, true), "{text}");
}
