//! `pickcell recognize` from the outside: good pairs, bad input, exit codes, files.

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

/// A folder of one good pair and two bad ones.
fn folder_of_pairs() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    for name in ["a-good", "b-cut", "c-alone"] {
        fs::create_dir(at(name)).unwrap();
        fs::copy(format!("{ROOT}/{LEFT}"), at(name).join("left.jpg")).unwrap();
    }
    let right = fs::read(format!("{ROOT}/{RIGHT}")).unwrap();
    fs::write(at("a-good/right.jpg"), &right).unwrap();
    fs::write(at("b-cut/right.jpg"), &right[..right.len() / 2]).unwrap();
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
        text(&output.stderr).contains("2 of 3 pairs could not be recognised"),
        "{}",
        text(&output.stderr)
    );
    let lines = json_lines(&output);
    let names: Vec<_> = lines.iter().map(|l| l["pair"].as_str().unwrap()).collect();
    assert_eq!(names, ["a-good", "b-cut", "c-alone"]);
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
fn wrong_usage_names_key_value_and_remedy() {
    let pair = ["--left", LEFT, "--right", RIGHT];
    let cases: [(&[&str], &str); 13] = [
        (&["--seed", "letters"], "invalid value 'letters' for '--seed <N>': must be a whole number from 0"),
        (&["--seed", "-1"], "invalid value '-1' for '--seed <N>'"),
        (&["--color-min", "1,2"], "must be three whole numbers from 0 to 255"),
        (&["--color-min", "9,9,300"], "invalid value '9,9,300' for '--color-min"),
        (&["--color-min", "9,200,9", "--color-max", "99,100,99"], "green goes from 200 to 100"),
        (
            &["--grey-min", "200", "--grey-max", "100"],
            "grey_min/grey_max goes from 200 to 100; give a minimum",
        ),
        (&["--color", "auto", "--grey-min", "3"], "cannot be used with"),
        (&["--region-px", "0,0", "700,0", "700,400"], "(700, 0), outside the 640x480 picture"),
        (&["--region-px", "0,0", "9,x", "7,4"], "must be two numbers, x,y in pixels"),
        (&["--threads", "3"], "must be a whole number from 1 to 2"),
        (&["--repeat", "0"], "must be a whole number from 1 to"),
        (&["--min-speck-px", "-5"], "'-5' for '--min-speck-px <PIXELS>': must be a whole number from 0"),
        (
            &["--search", "magic"],
            "[possible values: auto, harmony, improved, self-adaptive, random, exhaustive]",
        ),
    ];
    for (arguments, wanted) in cases {
        let message = refusal(&recognize(&[&pair[..], arguments].concat()), 2);
        assert!(message.contains(wanted), "{message}\nwanted: {wanted}");
    }
    for (arguments, wanted) in [
        (&["recognize"][..], "--calibration <FILE>"),
        (&["recognize", "--cell", "absent.toml"], "absent.toml"),
        (&["recognise"], "unrecognized subcommand"),
    ] {
        let message = refusal(&pickcell(arguments), 2);
        assert!(message.contains(wanted), "{message}\nwanted: {wanted}");
    }
    let message = refusal(&recognize(&[]), 2);
    assert!(message.contains("no pictures: give --left and --right, or --pairs"), "{message}");
    let both = ["--deadline-ms", "30"];
    assert!(refusal(&recognize(&[&pair[..], &both].concat()), 2).contains("cannot be used with"));
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

/// A file of this name and content in a folder.
fn file(folder: &tempfile::TempDir, name: &str, bytes: &[u8]) -> String {
    let path = folder.path().join(name);
    fs::write(&path, bytes).unwrap();
    path.to_str().unwrap().to_owned()
}

#[test]
fn one_picture_for_both_cameras_is_refused() {
    let message = refusal(&recognize(&["--left", LEFT, "--right", LEFT]), 2);
    assert!(message.contains("the left and the right picture are the same"), "{message}");
}

#[test]
fn bad_pictures_are_refused_and_nothing_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let jpeg = fs::read(format!("{ROOT}/{RIGHT}")).unwrap();
    let mut png = Vec::new();
    let small = image::RgbImage::from_pixel(320, 240, image::Rgb([40; 3]));
    small.write_to(&mut std::io::Cursor::new(&mut png), image::ImageFormat::Png).unwrap();
    // white lines, two pixels apart: far more lines than any bin shows
    let comb =
        image::GrayImage::from_fn(640, 480, |x, y| image::Luma([255 * u8::from((x / 2 + y / 2) % 2 == 0)]));
    let comb_path = folder.path().join("comb.png");
    comb.save(&comb_path).unwrap();
    let cases: [(String, &str); 7] = [
        (file(&folder, "cut.jpg", &jpeg[..jpeg.len() / 2]), "cut.jpg: JPEG picture of"),
        (file(&folder, "cut.png", &png[..png.len() / 2]), "cut.png: not a whole png or jpg picture"),
        (file(&folder, "empty.jpg", b""), "empty.jpg: neither a png nor a jpg picture"),
        (file(&folder, "text.png", b"no picture at all"), "text.png: neither a png nor a jpg picture"),
        (
            file(&folder, "small.png", &png),
            "small.png: the right picture is 320x240 pixels, the calibration was made for 640x480",
        ),
        ("absent.jpg".to_owned(), "absent.jpg: cannot read it: No such file"),
        (comb_path.to_str().unwrap().to_owned(), "narrow the colour range or the region"),
    ];
    let out = folder.path().join("out");
    for (path, wanted) in cases {
        let stages = ["--stages", out.to_str().unwrap(), "--color-min", "100,100,100"];
        let message = refusal(&recognize(&[&["--left", LEFT, "--right", &path][..], &stages].concat()), 2);
        assert!(message.contains(wanted), "{message}\nwanted: {wanted}");
        assert!(!out.exists(), "{path}");
    }
    let white = folder.path().join("white.png");
    image::GrayImage::from_pixel(640, 480, image::Luma([255])).save(&white).unwrap();
    let white = white.to_str().unwrap();
    let message = refusal(&recognize(&["--left", LEFT, "--right", white]), 2);
    assert!(message.contains("right picture is white all over: less light"), "{message}");
    let message = refusal(&recognize(&["--left", white, "--right", white, "--grey-min", "100"]), 2);
    assert!(message.contains("narrow the colour range or the region"), "{message}");
    let black = file(&folder, "black.png", b"");
    image::GrayImage::from_fn(640, 480, |x, y| image::Luma([((x * y) % 4) as u8])).save(&black).unwrap();
    let message = refusal(&recognize(&["--left", &black, "--right", LEFT]), 2);
    assert!(message.contains("left picture is black all over: light, the cap of the lens"), "{message}");
    let message = refusal(&recognize(&["--left", LEFT, "--right", "/dev/zero"]), 2);
    assert!(message.contains("/dev/zero: is no regular file"), "{message}");
}

#[test]
fn bad_calibrations_and_parts_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let rig = fs::read_to_string(format!("{ROOT}/replay/conveyor/calibration.yaml")).unwrap();
    let part = fs::read_to_string(format!("{ROOT}/replay/parts/rod-90.toml")).unwrap();
    let call = |calibration: &str, parts: &[&str]| {
        let mut all = vec!["recognize", "--calibration", calibration, "--left", LEFT, "--right", RIGHT];
        parts.iter().for_each(|part| all.extend(["--part", part]));
        refusal(&pickcell(&all), 2)
    };
    let rod = "replay/parts/rod-90.toml";
    for (from, to, wanted) in [
        ("M2:", "m2:", "bad.yaml: M2 is missing"),
        ("1201.127417730653", ".Nan", "M1[0,0] = NaN: must be finite"),
        ("0.98983000226569451", "0.5", "R = [0.5,"),
        ("1201.127417730653", "1e300", "M1 = fx 1e300: a focal length is 0.04 to 100 times the longer side"),
        ("1201.127417730653", "1e-3", "M1 = fx 0.001: a focal length"),
        (
            "image_width: 640",
            "image_width: 1280",
            "the left picture is 640x480 pixels, the calibration was made for 1280x480",
        ),
    ] {
        let message = call(&file(&folder, "bad.yaml", rig.replacen(from, to, 1).as_bytes()), &[rod]);
        assert!(message.contains(wanted), "{message}\nwanted: {wanted}");
    }
    assert!(call("absent.yaml", &[rod]).contains("calibration absent.yaml: No such file"));
    let calibration = "replay/conveyor/calibration.yaml";
    for (from, to, wanted) in [
        (
            "to = \"b\"",
            "to = \"z\"",
            "bad.toml: edge 1: to = \"z\" is no node of this part; its nodes are a, b",
        ),
        (
            "thickness_mm",
            "thickness",
            "bad.toml, line 3: thickness: there is no such key; allowed here: name, thickness_mm",
        ),
        ("[45.0, 0.0, 0.0]", "[-45.0, 0.0, 0.0]", "has zero length"),
    ] {
        let message = call(calibration, &[&file(&folder, "bad.toml", part.replacen(from, to, 1).as_bytes())]);
        assert!(message.contains(wanted), "{message}\nwanted: {wanted}");
    }
    let twin = file(&folder, "twin.toml", part.as_bytes());
    assert!(call(calibration, &[rod, &twin]).contains("both have name = \"rod-90\""));
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
fn a_result_that_cannot_be_written_is_a_failed_job() {
    let folder = tempfile::tempdir().unwrap();
    let taken: PathBuf = folder.path().join("taken.png");
    fs::create_dir(&taken).unwrap();
    let output = recognize(&["--left", LEFT, "--right", RIGHT, "--overlay", taken.to_str().unwrap()]);
    let message = refusal(&output, 1);
    assert!(message.contains("taken.png: cannot be written"), "{message}");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}
