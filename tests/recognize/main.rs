//! `pickcell recognize` from the outside: good pairs, bad input, exit codes, files.

mod refusals;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use serde_json::Value;

const ROOT: &str = env!("CARGO_MANIFEST_DIR");

fn pickcell(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_pickcell")).args(arguments).current_dir(ROOT).output().expect("starts")
}

/// The conveyor's rig and part, a counted budget, then `arguments`.
fn recognize(arguments: &[&str]) -> Output {
    let mut all = vec!["recognize", "--calibration", "replay/conveyor/calibration.yaml"];
    all.extend(["--part", "replay/parts/rod-90.toml", "--iterations", "200000"]);
    all.extend(arguments);
    pickcell(&all)
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Standard error of a call that must end with this exit code and leave standard output empty.
fn refusal(output: &Output, code: i32) -> String {
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{message}");
    assert!(output.stdout.is_empty(), "{}", text(&output.stdout));
    assert!(!message.contains("panicked"), "{message}");
    message
}

fn json_lines(output: &Output) -> Vec<Value> {
    text(&output.stdout).lines().map(|l| serde_json::from_str(l).expect("a line is one object")).collect()
}

const LEFT: &str = "replay/conveyor/left/0012.jpg";
const RIGHT: &str = "replay/conveyor/right/0012.jpg";

#[test]
fn a_pair_gives_one_json_object_with_every_key() {
    let output = recognize(&["--left", LEFT, "--right", RIGHT, "--format", "json", "--seed", "7"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let lines = json_lines(&output);
    assert_eq!(lines.len(), 1);
    let result = &lines[0];
    assert_eq!(result["seed"], 7);
    assert!(result.get("pair").is_none() && result.get("no_pick").is_some());
    assert!(result["nodes_left"].as_u64().unwrap() > 3 && result["nodes_right"].as_u64().unwrap() > 3);
    for stage in ["decode", "binarize", "thin", "graph", "match", "pose", "total"] {
        assert!(result["stages_us"][stage].as_f64().unwrap() >= 0.0, "{stage}");
    }
    let truth: Value =
        serde_json::from_str(&fs::read_to_string(format!("{ROOT}/replay/conveyor/truth/0012.json")).unwrap())
            .unwrap();
    let parts = result["parts"].as_array().unwrap();
    assert_eq!(parts.len(), truth["objects"].as_array().unwrap().len());
    for part in parts {
        let names: Vec<_> =
            part["nodes"].as_array().unwrap().iter().map(|n| n["name"].as_str().unwrap()).collect();
        assert_eq!((part["part"].as_str(), names), (Some("rod-90"), vec!["a", "b"]));
        let node = &part["nodes"][0];
        let seen = node["seen"].as_str().unwrap();
        assert!(["both", "left", "right", "none"].contains(&seen));
        assert_eq!(node["left_px"].as_array().unwrap().len(), 2);
        let grasp = &part["grasp"];
        assert_eq!(grasp["frame"], "left");
        let norm =
            |v: &Value| v.as_array().unwrap().iter().map(|x| x.as_f64().unwrap().powi(2)).sum::<f64>().sqrt();
        assert!(
            (norm(&grasp["axis"]) - 1.0).abs() < 1e-6
                && (norm(&grasp["orientation_xyzw"]) - 1.0).abs() < 1e-6
        );
        assert!(part["sigma_mm"].as_array().unwrap().iter().all(|s| s.as_f64().unwrap() > 0.0));
        assert!(part["sigma_axis_deg"].as_f64().unwrap() > 0.0 && part.get("blocked").is_some());
        assert!(nearest(&truth, part) < 4.0, "{part}");
    }
}

/// Distance of a part's grasp from that of the nearest true part, in mm.
fn nearest(truth: &Value, part: &Value) -> f64 {
    let point = |v: &Value| [0, 1, 2].map(|i| v["grasp"]["position_mm"][i].as_f64().unwrap());
    let found = point(part);
    let distance = |o: &Value| point(o).iter().zip(found).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
    truth["objects"].as_array().unwrap().iter().map(distance).fold(f64::MAX, f64::min)
}

#[test]
fn the_same_call_gives_the_same_parts_and_repeat_gives_percentiles() {
    let call = ["--left", LEFT, "--right", RIGHT, "--format", "json"];
    let once = json_lines(&recognize(&call));
    let many = json_lines(&recognize(&[&call[..], &["--repeat", "3"]].concat()));
    assert_eq!(once[0]["parts"], many[0]["parts"]);
    let total = &many[0]["stages_us"]["total"];
    assert!(
        total["p50"].as_f64().unwrap() > 0.0
            && total["p99"].as_f64().unwrap() >= total["p50"].as_f64().unwrap()
    );
}

#[test]
fn two_threads_find_what_one_finds() {
    // Rods over each other: ridges are looked for, too.
    let call = ["--left", "replay/conveyor/left/0003.jpg", "--right", "replay/conveyor/right/0003.jpg"];
    let [one, two] = ["1", "2"].map(|threads| {
        json_lines(&recognize(&[&call[..], &["--format", "json", "--threads", threads]].concat()))
    });
    assert_eq!(one[0]["parts"], two[0]["parts"]);
    assert!(one[0]["parts"].as_array().unwrap().len() > 5);
}

#[test]
fn stages_and_overlay_are_written_and_the_text_is_for_people() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (stages, overlay) = (at("deep/stages"), at("new/overlay.png"));
    let output = recognize(&[
        "--left",
        LEFT,
        "--right",
        RIGHT,
        "--stages",
        stages.to_str().unwrap(),
        "--overlay",
        overlay.to_str().unwrap(),
    ]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let table = text(&output.stdout);
    assert!(
        table.contains("can be picked") && table.contains("rod-90") && table.contains("sigma mm"),
        "{table}"
    );
    let mut names: Vec<_> =
        fs::read_dir(&stages).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    assert_eq!(
        names,
        [
            "left-binary.png",
            "left-graph.png",
            "left-skeleton.png",
            "overlay.png",
            "right-binary.png",
            "right-graph.png",
            "right-skeleton.png",
        ]
    );
    let picture = |path: &Path| image::open(path).unwrap().into_rgb8();
    let (mask, skeleton) =
        (picture(&stages.join("left-binary.png")), picture(&stages.join("left-skeleton.png")));
    assert_eq!(mask.dimensions(), (640, 480));
    let white = |p: &image::RgbImage| p.pixels().filter(|p| p.0 == [255; 3]).count();
    assert!(white(&mask) > 2 * white(&skeleton) && white(&skeleton) > 100);
    assert!(mask.pixels().zip(skeleton.pixels()).all(|(m, s)| s.0 == [0; 3] || m.0 == [255; 3]));
    let drawn = picture(&overlay);
    assert_eq!(drawn.dimensions(), (1284, 480));
    assert_eq!(drawn, picture(&stages.join("overlay.png")));
    let blue = drawn.pixels().filter(|p| p.0[2] > 200 && p.0[0] < 120).count();
    let red = drawn.pixels().filter(|p| p.0[0] > 200 && p.0[1] < 80 && p.0[2] < 80).count();
    assert!(blue > 300 && red > 100, "segments {blue}, fitness {red}");
}

/// A folder of one good pair and three bad ones.
fn folder_of_pairs() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    for name in ["a-good", "b-cut", "c-alone", "d-torn"] {
        fs::create_dir(at(name)).unwrap();
        fs::copy(format!("{ROOT}/{LEFT}"), at(name).join("left.jpg")).unwrap();
    }
    let right = fs::read(format!("{ROOT}/{RIGHT}")).unwrap();
    fs::write(at("a-good/right.jpg"), &right).unwrap();
    fs::write(at("b-cut/right.jpg"), &right[..right.len() / 2]).unwrap();
    // A segment of no length, of which the decoder says so on two lines.
    fs::write(at("d-torn/right.jpg"), [&right[..2], &[0xff, 0xe0, 0, 0], &right[2..]].concat()).unwrap();
    folder
}

#[test]
fn a_bad_pair_of_a_folder_is_one_line_and_the_rest_goes_on() {
    let (folder, out) = (folder_of_pairs(), tempfile::tempdir().unwrap());
    // From an earlier run: it does not stay beside those of this one.
    let stale = out.path().join("b-cut/results.json");
    fs::create_dir(stale.parent().unwrap()).unwrap();
    fs::write(&stale, "{}").unwrap();
    let arguments = ["--pairs", folder.path().to_str().unwrap(), "--out", out.path().to_str().unwrap()];
    let output = recognize(&[&arguments[..], &["--format", "json"]].concat());
    assert_eq!(output.status.code(), Some(1));
    assert!(
        text(&output.stderr).contains("3 of 4 pairs could not be recognised"),
        "{}",
        text(&output.stderr)
    );
    let lines = json_lines(&output);
    let names: Vec<_> = lines.iter().map(|l| l["pair"].as_str().unwrap()).collect();
    assert_eq!(names, ["a-good", "b-cut", "c-alone", "d-torn"]);
    assert!(!lines[0]["parts"].as_array().unwrap().is_empty());
    assert!(lines[1]["error"].as_str().unwrap().contains("b-cut/right.jpg: "), "{}", lines[1]);
    assert!(
        lines[2]["error"].as_str().unwrap().contains("right picture of this pair is missing"),
        "{}",
        lines[2]
    );
    let written: Value =
        serde_json::from_str(&fs::read_to_string(out.path().join("a-good/results.json")).unwrap()).unwrap();
    assert_eq!(written, lines[0]);
    let output = recognize(&arguments[..2]);
    let lines: Vec<_> = text(&output.stdout).lines().map(str::to_owned).collect();
    let last = lines.last().expect("a line a bad pair");
    assert!(
        last.starts_with("pair d-torn: error: ") && last.ends_with("; record or copy it again"),
        "{last}"
    );
    assert!(!stale.exists() && !out.path().join("c-alone").exists(), "nothing is written for a bad pair");
}

#[test]
fn a_session_folder_is_read_in_order_of_name() {
    let folder = tempfile::tempdir().unwrap();
    for side in ["left", "right"] {
        fs::create_dir(folder.path().join(side)).unwrap();
        for name in ["0019.jpg", "0018.jpg"] {
            let to = folder.path().join(side).join(name);
            fs::copy(format!("{ROOT}/replay/conveyor/{side}/{name}"), to).unwrap();
        }
    }
    let output = recognize(&["--pairs", folder.path().to_str().unwrap(), "--format", "json"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let names: Vec<_> = json_lines(&output).iter().map(|l| l["pair"].as_str().unwrap().to_owned()).collect();
    assert_eq!(names, ["0018", "0019"]);
}

#[test]
fn a_cell_gives_everything_and_grasps_are_in_the_base() {
    let output = pickcell(&[
        "recognize",
        "--cell",
        "cell.toml",
        "--left",
        LEFT,
        "--right",
        RIGHT,
        "--iterations",
        "200000",
        "--format",
        "json",
    ]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    assert_eq!(json_lines(&output)[0]["parts"][0]["grasp"]["frame"], "base");
}

#[test]
fn a_pair_without_time_or_iterations_offers_nothing_and_says_so() {
    let pair = ["--left", LEFT, "--right", RIGHT, "--format", "json"];
    let rig = ["recognize", "--calibration", "replay/conveyor/calibration.yaml"];
    let time = ["--part", "replay/parts/rod-90.toml", "--deadline-ms", "0.001"];
    let iterations = ["--part", "replay/parts/hook.toml", "--search", "random", "--iterations", "1"];
    for limit in [&time[..], &iterations] {
        let output = pickcell(&[&rig[..], &pair, limit].concat());
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        let result = &json_lines(&output)[0];
        assert_eq!(result["no_pick"], "search cut short", "{limit:?}");
        assert!(result["parts"].as_array().unwrap().iter().all(|part| !part["blocked"].is_null()));
    }
}

#[test]
fn overlay_and_stages_take_the_place_of_no_picture_that_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let [left, right] = [("left-binary.png", LEFT), ("r.png", RIGHT)].map(|(name, picture)| {
        fs::copy(format!("{ROOT}/{picture}"), at(name)).unwrap();
        at(name)
    });
    let before = fs::read(&left).unwrap();
    let to = |overlay: &str| recognize(&["--left", &left, "--right", &right, "--overlay", overlay]);
    assert!(refusal(&to(&left), 2).contains("left-binary.png: this file is read; give another name"));
    let stages = recognize(&["--left", &left, "--right", &right, "--stages", &at("")]);
    assert!(refusal(&stages, 2).contains("left-binary.png: this file is read; give another folder"));
    assert!(refusal(&to(&at("o.jpg")), 2).contains("o.jpg: it is a png; give a name that ends so"));
    assert!(fs::read(&left).unwrap() == before && !Path::new(&at("o.jpg")).exists());
    let output = to(&at("o.png"));
    assert!(output.status.success(), "{}", text(&output.stderr));
    // Again: it is there now.
    assert!(to(&at("o.png")).status.success());
}

#[test]
fn a_reader_that_goes_away_is_no_failure() {
    let mut child = Command::new(env!("CARGO_BIN_EXE_pickcell"))
        .args([
            "recognize",
            "--calibration",
            "replay/conveyor/calibration.yaml",
            "--part",
            "replay/parts/rod-90.toml",
        ])
        .args(["--left", LEFT, "--right", RIGHT, "--iterations", "1000"])
        .current_dir(ROOT)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert_eq!((output.status.code(), text(&output.stderr)), (Some(0), String::new()));
}

#[test]
fn a_result_that_cannot_be_written_is_named_with_its_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let taken: PathBuf = folder.path().join("taken.png");
    fs::create_dir(&taken).unwrap();
    let output = recognize(&["--left", LEFT, "--right", RIGHT, "--overlay", taken.to_str().unwrap()]);
    let message = refusal(&output, 2);
    assert!(message.contains("taken.png: cannot be written"), "{message}");
    assert!(message.ends_with("; a folder has this name: give another\n"), "{message}");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    for option in ["--out", "--stages"] {
        let output = recognize(&["--left", LEFT, "--right", RIGHT, option, "Cargo.toml"]);
        let message = refusal(&output, 2);
        assert!(
            message.contains("a file has the name of a folder that is needed: give another name"),
            "{message}"
        );
    }
}

#[test]
fn pictures_named_after_their_sides_have_the_name_of_their_folder() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("scene-01");
    fs::create_dir(&scene).unwrap();
    let paths = [("left.jpg", LEFT), ("right.jpg", RIGHT)].map(|(name, from)| {
        fs::copy(format!("{ROOT}/{from}"), scene.join(name)).unwrap();
        scene.join(name).to_str().unwrap().to_owned()
    });
    let out = folder.path().join("out");
    let output = recognize(&["--left", &paths[0], "--right", &paths[1], "--out", out.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    assert!(out.join("scene-01/results.json").is_file());
}
