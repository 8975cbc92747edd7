//! What the checks say, message by message.

use std::path::PathBuf;

use nalgebra::Vector3;

use super::*;
use crate::vision::binarize::ColourRange;

/// A cell that is right, in a folder with the files that it names.
struct Bench {
    folder: tempfile::TempDir,
}

const GOOD: &str = r#"
[cameras]
backend = "v4l2"
pair_window_ms = 12.0

[cameras.left]
device = "/dev/v4l/by-path/left"
format = "YUYV"
width = 640
height = 480
rate_hz = 30.0
controls = { auto_exposure = "Manual Mode", exposure_time_absolute = 150, white_balance_automatic = false }

[cameras.right]
device = "/dev/v4l/by-path/right"
format = "YUYV"
width = 640
height = 480
rate_hz = 30.0

[rig]
calibration = "rig.yaml"
base_from_left = { translation_mm = [250.0, 0.0, 484.7], quaternion_xyzw = [1.0, 0.0, 0.0, 0.0] }

[recognition]
parts = ["rod.toml"]
colour = { min = [100, 100, 100], max = [255, 255, 255] }
region_px = [[10, 10], [630, 10], [630, 470], [10, 470]]
hmcr = 0.7

[deadline]
deadline_ms = 60

[place]
first_mm = [300.0, 100.0, 20.0]
column_step_mm = [20.0, 0.0, 0.0]
columns = 5
state = "place.state"

[realtime]
grab_priority = 31

[workspace]
min_mm = [100.0, -100.0, 0.0]
max_mm = [400.0, 100.0, 200.0]

[arm]
link = "serial"
port = "/dev/serial/by-id/arm"
"#;

impl Bench {
    fn new() -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        for name in ["rig.yaml", "rod.toml"] {
            std::fs::write(folder.path().join(name), "").expect("an empty file");
        }
        Bench { folder }
    }

    fn check(&self, text: &str) -> Result<Cell, ConfigError> {
        Cell::check(&Source { file: self.folder.path().join("cell.toml"), text: text.to_owned() })
    }

    /// The message for [`GOOD`] with one piece of its text replaced, without the folder's name.
    fn message(&self, was: &str, is: &str) -> String {
        assert!(GOOD.contains(was), "{was:?} is not in the good cell");
        let error = self.check(&GOOD.replacen(was, is, 1)).expect_err("a wrong cell");
        error.to_string().replace(&format!("{}/", self.folder.path().display()), "")
    }
}

#[test]
fn a_right_cell_is_read_with_its_defaults() {
    let bench = Bench::new();
    let cell = bench.check(GOOD).expect("a right cell");
    let period = Duration::from_millis(33);
    assert_eq!(cell.rig.calibration, bench.folder.path().join("rig.yaml"));
    assert_eq!(cell.recognition.parts, [bench.folder.path().join("rod.toml")]);
    assert_eq!(cell.recognition.colour, ColourRange::Rgb { min: [100; 3], max: [255; 3] });
    assert_eq!(cell.recognition.region_right_px[1], [630.0, 10.0]);
    assert_eq!((cell.recognition.seed, cell.recognition.harmony.hms), (1, 20));
    assert_eq!(cell.deadline(period), Duration::from_millis(60));
    assert_eq!(cell.cameras.pair_window(period), Duration::from_millis(12));
    assert_eq!((cell.realtime.grab_priority, cell.realtime.arm_priority), (31, 40));
    let left = cell.cameras.left.expect("a left camera");
    assert_eq!(left.device, PathBuf::from("/dev/v4l/by-path/left"));
    assert_eq!(left.controls["auto_exposure"], ControlValue::Name("Manual Mode".to_owned()));
    assert_eq!(left.controls["white_balance_automatic"], ControlValue::Boolean(false));
}

#[test]
fn deadline_and_window_follow_the_frame_period_unless_set() {
    let cell = Bench::new().check(&GOOD.replace("deadline_ms = 60", "").replace("pair_window_ms = 12.0", ""));
    let cell = cell.expect("a right cell");
    assert_eq!(cell.deadline(Duration::from_millis(40)), Duration::from_millis(80));
    assert_eq!(cell.cameras.pair_window(Duration::from_millis(40)), Duration::from_millis(16));
}

#[test]
fn keys_that_nobody_reads_are_errors() {
    let bench = Bench::new();
    assert_eq!(
        bench.message("hmcr = 0.7", "hmrc = 0.7"),
        "cell.toml, line 29: recognition.hmrc: there is no such key; allowed here: parts, colour, inverted, \
         region_px, min_speck_px, thin, search, hms, hmcr, par, par_min, par_max, gate, seed, iterations, \
         fitness_max, threads"
    );
    assert_eq!(
        bench.message("width = 640", "breadth = 640"),
        "cell.toml, line 9: cameras.left.breadth: there is no such key; allowed here: device, format, width, \
         height, rate_hz, matrix, range, controls"
    );
    let message = bench.message("[deadline]", "[deadlines]");
    assert!(message.starts_with("cell.toml, line 31: deadlines: there is no such key"), "{message}");
    let message = bench.message("link = \"serial\"", "speed = 3");
    assert!(
        message.starts_with("cell.toml, line 48: arm.speed: there is no such key; allowed here: link, port")
    );
    let message = bench.message("quaternion_xyzw", "rotation");
    assert!(message.contains("rig.base_from_left.rotation: there is no such key"), "{message}");
}

#[test]
fn values_out_of_range_name_key_value_and_what_is_allowed() {
    let bench = Bench::new();
    for (was, is, message) in [
        (
            "hmcr = 0.7",
            "hmcr = 1.4",
            "cell.toml, line 29: recognition.hmcr = 1.4 is not possible; allowed: a rate from 0 to 1, without unit",
        ),
        (
            "hmcr = 0.7",
            "hmcr = nan",
            "cell.toml, line 29: recognition.hmcr = NaN is not possible; allowed: a rate from 0 to 1, without unit",
        ),
        (
            "\"YUYV\"",
            "\"YUY2\"",
            "cell.toml, line 8: cameras.left.format = \"YUY2\" is not possible; allowed: \"YUYV\", \"MJPG\", \
             \"GREY\", \"RGB3\", \"BGR3\", \"NV12\"",
        ),
        (
            "width = 640",
            "width = 0",
            "cell.toml, line 9: cameras.left.width = 0 is not possible; allowed: an even number of pixels from 2 \
             to 8192",
        ),
        (
            "pair_window_ms = 12.0",
            "pair_window_ms = 20.0",
            "cell.toml, line 4: cameras.pair_window_ms = 20 is not possible; allowed: milliseconds above 0, at \
             most half a frame period (16.67)",
        ),
        (
            "by-path/right",
            "by-path/left",
            "cell.toml, line 15: cameras.right.device = \"/dev/v4l/by-path/left\" is not possible; allowed: \
             another device than that of cameras.left",
        ),
        (
            "[1.0, 0.0, 0.0, 0.0]",
            "[1.0, 1.0, 0.0, 0.0]",
            "cell.toml, line 23: rig.base_from_left.quaternion_xyzw = [1.0, 1.0, 0.0, 0.0] (length 1.4142) is not \
             possible; allowed: a unit quaternion [x, y, z, w], length 1 to within 0.001",
        ),
        (
            "[1.0, 0.0, 0.0, 0.0]",
            "[1.0, 0.0, 0.0, 0.0, 0.0]",
            "cell.toml, line 23: rig.base_from_left.quaternion_xyzw = [1.0, 0.0, 0.0, 0.0, 0.0] is not possible; \
             allowed: a list of 4 values",
        ),
        (
            "deadline_ms = 60",
            "deadline_ms = 0",
            "cell.toml, line 32: deadline.deadline_ms = 0 is not possible; allowed: milliseconds from 1 to 60000",
        ),
        (
            "grab_priority = 31",
            "grab_priority = 99",
            "cell.toml, line 41: realtime.grab_priority = 99 is not possible; allowed: 10 to 40 (interrupt threads \
             have 50; above them the cameras would starve)",
        ),
        (
            "max_mm = [400.0, 100.0, 200.0]",
            "max_mm = [400.0, -100.0, 200.0]",
            "cell.toml, line 45: workspace.max_mm = [400.0, -100.0, 200.0] is not possible; allowed: above \
             workspace.min_mm = [100.0, -100.0, 0.0] on every axis",
        ),
        (
            "link = \"serial\"",
            "link = \"serial\"\nresends = 99",
            "cell.toml, line 49: arm.resends = 99 is not possible; allowed: 0 to 20",
        ),
        (
            "column_step_mm = [20.0, 0.0, 0.0]",
            "",
            "cell.toml, line 34: place.column_step_mm = [0, 0, 0] is not possible; allowed: a step that is not \
             zero, in mm",
        ),
    ] {
        assert_eq!(bench.message(was, is), message);
    }
}

#[test]
fn an_empty_or_crooked_colour_range_is_refused() {
    let bench = Bench::new();
    let good = "{ min = [100, 100, 100], max = [255, 255, 255] }";
    for bad in [
        "{ min = [100, 100, 100], max = [255, 90, 255] }",
        "{ min = [100, 100], max = [255, 90, 255] }",
        "{ min = [100, 100, 100], max = [255, 255, 256] }",
        "{ grey_min = 200, grey_max = 100 }",
        "{ grey_min = 200 }",
        "\"white\"",
        "7",
    ] {
        let message = bench.message(good, bad);
        assert!(message.starts_with("cell.toml, line 27: recognition.colour = "), "{message}");
        assert!(message.contains("no minimum above its maximum"), "{message}");
    }
    let cell =
        bench.check(&GOOD.replace(good, "{ grey_min = 100, grey_max = 100 }")).expect("one grey value");
    assert_eq!(cell.recognition.colour, ColourRange::Grey { min: 100, max: 100 });
}

#[test]
fn missing_keys_and_files_are_named() {
    let bench = Bench::new();
    assert_eq!(
        bench.message("calibration = \"rig.yaml\"\n", ""),
        "cell.toml, line 21: rig.calibration is missing; add it: it has no default"
    );
    assert_eq!(
        bench.message("backend = \"v4l2\"", "backend = \"replay\""),
        "cell.toml, line 2: cameras.session is missing; backend = \"replay\" needs the recorded session: an .mcap \
         file or a folder with left/, right/ and session.toml"
    );
    assert_eq!(
        bench.message("parts = [\"rod.toml\"]", "parts = [\"hook.toml\"]"),
        "cell.toml, line 26: recognition.parts = \"hook.toml\": no such file or folder (hook.toml); paths start at \
         the folder of cell.toml"
    );
    assert_eq!(
        bench.message("port = \"/dev/serial/by-id/arm\"\n", ""),
        "cell.toml, line 47: arm.port is missing; link = \"serial\" needs the device, e.g. port = \"/dev/ttyUSB0\""
    );
    assert_eq!(
        bench.message("[workspace]", "[gripper]").split(';').next(),
        Some("cell.toml, line 45: gripper.max_mm: there is no such key")
    );
    let error = Cell::read(&bench.folder.path().join("none.toml")).expect_err("no file");
    assert!(error.to_string().contains("none.toml: cannot read it: "), "{error}");
    assert!(error.to_string().ends_with("name the cell's file with --cell FILE"), "{error}");
}

#[test]
fn wrong_kinds_and_broken_toml_name_their_line() {
    let bench = Bench::new();
    for (was, is, message) in [
        (
            "width = 640",
            "width = \"wide\"",
            "cell.toml, line 9: cameras.left.width = \"wide\" is not possible; allowed: a whole number",
        ),
        (
            "width = 640",
            "width = -640",
            "cell.toml, line 9: cameras.left.width = -640 is not possible; allowed: an even number of pixels from 2 to \
             8192",
        ),
        (
            "hmcr = 0.7",
            "seed = -1",
            "cell.toml, line 29: recognition.seed = -1 is not possible; allowed: a whole number, 0 or more",
        ),
        (
            "hmcr = 0.7",
            "threads = 1.5",
            "cell.toml, line 29: recognition.threads = 1.5 is not possible; allowed: a whole number",
        ),
        (
            "hmcr = 0.7",
            "min_speck_px = -20",
            "cell.toml, line 29: recognition.min_speck_px = -20 is not possible; allowed: a number of pixels from 0 to \
             67108864",
        ),
        (
            "hmcr = 0.7",
            "inverted = \"no\"",
            "cell.toml, line 29: recognition.inverted = \"no\" is not possible; allowed: true or false",
        ),
        (
            "hmcr = 0.7",
            "thin = \"zs\"",
            "cell.toml, line 29: recognition.thin = \"zs\" is not possible; allowed: \"zhang-suen\", \"guo-hall\"",
        ),
        (
            "[\"rod.toml\"]",
            "[\"rod.toml\", 3]",
            "cell.toml, line 26: recognition.parts: value 2 = 3 is not possible; allowed: a text in quotes",
        ),
        (
            "columns = 5",
            "columns = -3",
            "cell.toml, line 37: place.columns = -3 is not possible; allowed: 1 to 1000",
        ),
        (
            "grab_priority = 31",
            "cores = [0, -1]",
            "cell.toml, line 41: realtime.cores = -1 is not possible; allowed: numbers of cores, counted from 0, under \
             1024",
        ),
        (
            "backend = \"v4l2\"",
            "backend = \"usb\"",
            "cell.toml, line 3: cameras.backend = \"usb\" is not possible; allowed: \"v4l2\", \"replay\"",
        ),
        ("[rig]", "[rig", "cell.toml, line 21: \"[rig\" is no TOML: unclosed table, expected `]`"),
        (
            "link = \"serial\"",
            "dialect = \"grbl\"\naxes = \"xyz\"\nmoves = { pick = [\"G91\"] }",
            "cell.toml, line 50: arm.moves.pick, line 1, \"G91\": G91 makes moves relative: PickCell's G-code is \
             absolute, write G0 or G1 with the coordinates",
        ),
    ] {
        assert_eq!(bench.message(was, is), message);
    }
}

#[test]
fn replay_needs_no_cameras() {
    let bench = Bench::new();
    std::fs::create_dir(bench.folder.path().join("conveyor")).expect("a folder");
    let text = format!(
        "[cameras]\nbackend = \"replay\"\nsession = \"conveyor\"\npace = \"fast\"\n{}",
        &GOOD[GOOD.find("[rig]").expect("a rig")..]
    );
    let cell = bench.check(&text).expect("a right cell");
    assert_eq!((cell.cameras.backend, cell.cameras.pace), (Backend::Replay, Pace::Fast));
    assert_eq!(cell.cameras.session, Some(bench.folder.path().join("conveyor")));
    assert!(cell.cameras.left.is_none());
}

#[test]
fn the_cell_that_comes_with_the_project_is_right() {
    let cell =
        Cell::read(&PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("cell.toml")).expect("a right cell");
    let base_from_left = cell.rig.base_from_left.expect("a base");
    // The camera looks down: its axis goes towards base −z, and it stands above the workspace.
    assert!((base_from_left * Vector3::z()).z < -0.99);
    let workspace = cell.arm_side.workspace;
    assert!(base_from_left.translation.z > workspace.max_mm[2]);
    let place = cell.place.expect("a place");
    let far = place.first_mm
        + f64::from(place.columns - 1) * place.column_step_mm
        + f64::from(place.rows - 1) * place.row_step_mm;
    for slot in [place.first_mm, far] {
        for axis in 0..3 {
            assert!(slot[axis] >= workspace.min_mm[axis] && slot[axis] <= workspace.max_mm[axis], "{slot}");
        }
    }
}

#[test]
fn numbers_are_asked_for_in_words_and_long_ones_are_cut() {
    let source = source::Source { file: "cell.toml".into(), text: "seed = -1".into() };
    let error = source.parse::<Seed>().unwrap_err().to_string();
    assert_eq!(error, "cell.toml, line 1: seed = -1 is not possible; allowed: a whole number, 0 or more");
    let long = source.refuse("seed", 1e308, "a small one").to_string();
    assert!(long.len() < 300 && long.contains("000… is not possible; allowed: a small one"), "{long}");
}

#[derive(Debug, serde::Deserialize)]
struct Seed {
    #[expect(dead_code, reason = "only read")]
    seed: u64,
}

proptest::proptest! {
    #![proptest_config(proptest::prelude::ProptestConfig::with_cases(128))]

    /// Whatever is cut out of a cell and put into its place: a cell or a message that names the file, never a panic.
    #[test]
    fn no_text_makes_the_reader_panic(
        at in 0usize..2000,
        length in 0usize..40,
        put in proptest::sample::select(vec![
            "", "[", "]", "=", "\"", "nan", "-1", "1e999", "{}", "[]", "\n[rig]\n", "\u{0}", "ä", "x = 1",
        ]),
    ) {
        let bench = Bench::new();
        let start = (0..=at % GOOD.len()).rev().find(|&i| GOOD.is_char_boundary(i)).unwrap_or(0);
        let end = (start + length).min(GOOD.len());
        let text = format!("{}{put}{}", &GOOD[..start], &GOOD[end..]);
        if let Err(error) = bench.check(&text) {
            proptest::prop_assert!(error.to_string().contains("cell.toml"), "{}", error);
        }
    }
}
