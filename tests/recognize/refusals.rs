//! What `pickcell recognize` refuses, and in which words.

use std::fs;

use super::{LEFT, RIGHT, ROOT, pickcell, recognize, refusal};

/// A file of this name and content in a folder.
fn file(folder: &tempfile::TempDir, name: &str, bytes: &[u8]) -> String {
    let path = folder.path().join(name);
    fs::write(&path, bytes).unwrap();
    path.to_str().unwrap().to_owned()
}

#[test]
fn wrong_usage_names_key_value_and_remedy() {
    let pair = ["--left", LEFT, "--right", RIGHT];
    let cases: [(&[&str], &str); 19] = [
        (&["--seed", "letters"], "invalid value 'letters' for '--seed <N>': must be a whole number from 0"),
        (&["--seed", "-1"], "invalid value '-1' for '--seed <N>'"),
        (&["--color-min", "1,2"], "must be three whole numbers from 0 to 255"),
        (&["--color-min", "9,9,300"], "invalid value '9,9,300' for '--color-min"),
        (
            &["--color-min", "9,200,9", "--color-max", "99,100,99"],
            "--color-min/--color-max green goes from 200 to 100",
        ),
        (
            &["--grey-min", "200", "--grey-max", "100"],
            "--grey-min/--grey-max goes from 200 to 100; give a minimum",
        ),
        (&["--color", "auto", "--grey-min", "3"], "cannot be used with"),
        (
            &["--region-px", "0,0", "700,0", "700,400"],
            "--region-px: corner 1 is (700, 0), outside the 640x480 picture",
        ),
        (&["--region-px", "0,0", "9,x", "7,4"], "must be two numbers, x,y in pixels"),
        (
            &["--region-px", "-10,-10", "700,0", "700,400"],
            "corner 0 is (-10, -10), outside the 640x480 picture",
        ),
        (&["--region-px=-10,-10", "90,0", "-.5,4", "--seed", "4"], "corner 0 is (-10, -10), outside"),
        (&["--region-px", "1,1", "90,0", "-.5,4", "--seed", "x"], "invalid value 'x' for '--seed <N>'"),
        (
            &["--grey-min", "-1"],
            "invalid value '-1' for '--grey-min <0..255>': must be a whole number from 0 to 255",
        ),
        (
            &["--grey-min", "x"],
            "invalid value 'x' for '--grey-min <0..255>': must be a whole number from 0 to 255",
        ),
        (&["--grey-max", "256"], "must be a whole number from 0 to 255"),
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
        (
            &["recognize"][..],
            "no calibration: give --cell FILE, which names all of it, or --calibration FILE and --part",
        ),
        (&["recognize", "--calibration", "replay/conveyor/calibration.yaml"], "no part: give --cell FILE"),
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
fn a_corner_in_a_cell_says_whose_picture_it_is_outside_of() {
    let folder = tempfile::tempdir().unwrap();
    let text = fs::read_to_string(format!("{ROOT}/cell.toml")).unwrap();
    let text = text.replace("\"replay/", &format!("\"{ROOT}/replay/"));
    let call = |regions: &str| {
        let text = text.replacen("[recognition]", &format!("[recognition]\nregion_px = {regions}"), 1);
        let cell = file(&folder, "cell.toml", text.as_bytes());
        refusal(&pickcell(&["recognize", "--cell", &cell, "--left", LEFT, "--right", RIGHT]), 2)
    };
    let (good, bad) = ("[[0, 0], [600, 0], [0, 400]]", "[[0, 0], [1000, 0], [0, 400]]");
    for (regions, key) in [
        (format!("{{ left = {good}, right = {bad} }}"), "recognition.region_px.right: corner 1 is (1000, 0)"),
        (format!("{{ left = {bad}, right = {good} }}"), "recognition.region_px.left: corner 1 is (1000, 0)"),
        (bad.to_owned(), "recognition.region_px: corner 1 is (1000, 0)"),
    ] {
        assert!(call(&regions).contains(key), "{regions}: {}", call(&regions));
    }
}

#[test]
fn accuracy_prints_no_table_without_its_parts() {
    let message = refusal(&pickcell(&["accuracy", "replay", "--parts", "/nowhere"]), 2);
    assert!(message.contains("part file /nowhere/"), "{message}");
    let message = refusal(&pickcell(&["accuracy", "replay", "--out", "Cargo.toml"]), 2);
    assert!(message.contains("--out Cargo.toml: cannot be written: "), "{message}");
}

#[test]
fn accuracy_counts_what_lies_in_a_refused_pair_as_missed() {
    let root = tempfile::tempdir().unwrap();
    let recorded = std::path::Path::new(ROOT).join("replay/conveyor");
    let conveyor = root.path().join("conveyor");
    for folder in ["left", "right", "truth"] {
        fs::create_dir_all(conveyor.join(folder)).unwrap();
    }
    let copy = |from: &str, to: &str| fs::copy(recorded.join(from), conveyor.join(to)).unwrap();
    for name in ["calibration.yaml", "set.json", "truth/0000.json", "truth/0001.json"] {
        copy(name, name);
    }
    for name in ["left/0000.jpg", "right/0000.jpg", "right/0001.jpg"] {
        copy(name, name);
    }
    copy("right/0001.jpg", "left/0001.jpg");
    let out = pickcell(&["accuracy", root.path().to_str().unwrap(), "--parts", "replay/parts"]);
    let [table, message] = [&out.stdout, &out.stderr].map(|bytes| String::from_utf8_lossy(bytes));
    assert_eq!(out.status.code(), Some(1), "{message}");
    assert!(message.contains("conveyor/0001: the left and the right picture are the same"), "{message}");
    assert!(table.contains("| conveyor | 2 | 20 | 1.000 | "), "{table}");
}

#[test]
fn one_overlay_is_not_for_a_session() {
    let folder = tempfile::tempdir().unwrap();
    let overlay = folder.path().join("overlay.png");
    let args = ["recognize", "--cell", "cell.toml", "--overlay", overlay.to_str().unwrap()];
    let message = refusal(&pickcell(&args), 2);
    assert!(message.contains("each pair of the session would take the place"), "{message}");
    assert!(!overlay.exists());
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
    let cases: [(String, &str); 8] = [
        (
            file(&folder, "no-end.png", &png[..png.len() - 4]),
            "no-end.png: not a whole png or jpg picture (its end",
        ),
        (file(&folder, "cut.jpg", &jpeg[..jpeg.len() / 2]), "cut.jpg: JPEG picture of"),
        (file(&folder, "cut.png", &png[..png.len() / 2]), "cut.png: not a whole png or jpg picture"),
        (file(&folder, "empty.jpg", b""), "empty.jpg: is empty; record or copy it again"),
        (file(&folder, "text.png", b"no picture at all"), "text.png: neither a png nor a jpg picture"),
        (
            file(&folder, "small.png", &png),
            "small.png: the right picture is 320x240 pixels, the calibration was made for 640x480",
        ),
        ("absent.jpg".to_owned(), "absent.jpg: cannot read it: No such file"),
        (
            comb_path.to_str().unwrap().to_owned(),
            "narrow the colour range (recognition.colour, --color-min) or the region",
        ),
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
    assert!(
        message.contains("narrow the colour range (recognition.colour, --color-min) or the region"),
        "{message}"
    );
    let black = file(&folder, "black.png", b"");
    image::GrayImage::from_fn(640, 480, |x, y| image::Luma([((x * y) % 4) as u8])).save(&black).unwrap();
    // Whatever is taken for parts, and dark ones too.
    for colours in [&[][..], &["--inverted"], &["--grey-min", "100"], &["--grey-min", "100", "--inverted"]] {
        let message = refusal(&recognize(&[&["--left", &black, "--right", LEFT][..], colours].concat()), 2);
        assert!(
            message.contains("left picture is black all over, or nearly so: look at the light"),
            "{colours:?}: {message}"
        );
    }
    let noise = folder.path().join("noise.png");
    let mut state = 1u32;
    let noisy = image::RgbImage::from_fn(640, 480, |_, _| {
        image::Rgb([0; 3].map(|_: u8| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as u8
        }))
    });
    noisy.save(&noise).unwrap();
    let message = refusal(&recognize(&["--left", noise.to_str().unwrap(), "--right", RIGHT]), 2);
    assert!(message.contains("left picture is noise and nothing else: look at the light"), "{message}");
    let of_adobe = b"\xff\xee\x00\x0eAdobe\x00\x64\x00\x00\x00\x00\x00";
    let in_rgb = file(&folder, "rgb.jpg", &[&jpeg[..2], of_adobe, &jpeg[2..]].concat());
    let message = refusal(&recognize(&["--left", LEFT, "--right", &in_rgb]), 2);
    assert!(message.contains("rgb.jpg: JPEG picture has the colour components R, G, B"), "{message}");
    assert!(!message.contains(LEFT), "{message}");
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
