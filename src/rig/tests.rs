//! Reference values: `python3 tests/rig_reference.py`, OpenCV 5.0.

use std::fs;
use std::path::PathBuf;

use nalgebra::Vector3;
use proptest::prelude::*;

use super::*;

const ALL: [f64; 14] =
    [-0.12, 0.03, -4e-4, 7e-4, 0.2, 0.11, -0.05, 0.07, 1e-3, -2e-3, 3e-3, -4e-3, 0.02, -0.03];

/// Coefficients, the pixels of (30, -20, 480) and (-95, 70, 500), the derivative of the first by its point.
const PROJECTED: [(usize, [f64; 4], [f64; 6]); 6] = [
    (
        0,
        [397.56875, 193.25416666666666, 94.29100000000003, 411.01800000000003],
        [2.5022916666666664, 0.0, -0.15639322916666665, 0.0, 2.497291666666667, 0.10405381944444443],
    ),
    (
        4,
        [397.5318086329637, 193.27919593452827, 95.92820236278777, 409.8217818580046],
        [2.4990007776, 0.0012884385590, -0.156133863662, 0.0012858640419, 2.4950338167, 0.10387937587],
    ),
    (
        5,
        [397.53181132990693, 193.27919414015872, 95.92031506298358, 409.82758193985296],
        [2.4990012409, 0.0012881896104, -0.156133902993, 0.0012856155907, 2.4950350721, 0.10387940203],
    ),
    (
        8,
        [397.4853978858874, 193.31007460825535, 97.26888818418968, 408.83588203294937],
        [2.4953201572, 0.0027108355260, -0.155844558350, 0.0027054188203, 2.4925435132, 0.10368689104],
    ),
    (
        12,
        [397.4920984488048, 193.3302124546487, 97.32833665271164, 409.02130898389737],
        [2.4956258843, 0.0025070174982, -0.155872158708, 0.0036278125739, 2.4919285840, 0.10360361938],
    ),
    (
        14,
        [397.6041045309529, 193.31318723099184, 97.86939126870922, 408.4469982777042],
        [2.5040465609, 0.0056417628217, -0.156267836611, 0.0020114697529, 2.4929482699, 0.10374712772],
    ),
];

fn camera(coefficients: usize) -> CameraModel {
    let mut distortion = [0.0; 14];
    distortion[..coefficients].copy_from_slice(&ALL[..coefficients]);
    CameraModel { width: 640, height: 480, fx: 1201.1, fy: 1198.7, cx: 322.5, cy: 243.2, distortion }
}

fn conveyor() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("replay/conveyor/calibration.yaml")
}

fn rig() -> Rig {
    Rig::read(conveyor()).unwrap()
}

#[test]
fn projection_and_its_derivative_are_opencvs_for_every_count_of_coefficients() {
    for (n, px, jacobian) in PROJECTED {
        let camera = camera(n);
        let (first, j) = camera.project_with_jacobian(&Point3::new(30.0, -20.0, 480.0)).unwrap();
        let second = camera.project(&Point3::new(-95.0, 70.0, 500.0)).unwrap();
        for (ours, theirs) in [first.x, first.y, second.x, second.y].iter().zip(px) {
            assert!((ours - theirs).abs() < 1e-9, "{n} coefficients: {ours} for {theirs}");
        }
        for (ours, theirs) in j.transpose().iter().zip(jacobian) {
            assert!((ours - theirs).abs() < 2e-6, "{n} coefficients: {ours} for {theirs}");
        }
    }
}

#[test]
fn undistortion_triangulation_and_essential_matrix_are_opencvs() {
    let rig = rig();
    let left = rig.left.undistort(Vector2::new(140.25, 410.5));
    let right = rig.right.undistort(Vector2::new(150.75, 398.125));
    assert!((left - Vector2::new(-0.15243542347523018, 0.14000614418637047)).norm() < 1e-12);
    assert!((right - Vector2::new(-0.14997753601266267, 0.13751538507507077)).norm() < 1e-12);
    let seen = rig.triangulate(left, right).unwrap();
    let theirs = Point3::new(-66.3811213375143, 60.45399145852732, 435.57295870180894);
    assert!((seen.point_left_mm - theirs).norm() < 1e-4, "{seen:?}");
    assert!((seen.residual_px - 2.1192813331688414).abs() < 1e-6, "{seen:?}");
    let geometry = rig.geometry();
    assert!((geometry.epipolar_offset_px(left, right).abs() - seen.residual_px).abs() < 0.01);
    let e = geometry.essential;
    assert!((e[(1, 2)] - 64.42172953701296).abs() < 1e-9 && (e[(2, 0)] - 1.8639962926988778).abs() < 1e-9);
}

#[test]
fn points_behind_and_rays_that_do_not_meet_are_none() {
    let rig = rig();
    assert!(rig.left.project(&Point3::new(0.0, 0.0, 0.0)).is_none());
    assert!(rig.left.project(&Point3::new(1.0, 1.0, -5.0)).is_none());
    assert!(rig.left.project(&Point3::new(f64::NAN, 1.0, 5.0)).is_none());
    let g = rig.geometry();
    let far = Vector2::new(0.1, 0.1);
    let parallel = g.rotation * far.push(1.0);
    assert!(rig.triangulate(far, parallel.xy() / parallel.z).is_none());
    // the right ray turned outwards meets the left one behind the cameras
    assert!(rig.triangulate(far, parallel.xy() / parallel.z + Vector2::new(0.05, 0.0)).is_none());
    assert!(rig.triangulate(Vector2::new(f64::NAN, 0.0), far).is_none());
    let baseline_point = Point3::from(rig.right_from_left.inverse().translation.vector * 2.0);
    assert!(rig.triangulation_covariance(&baseline_point, 0.1).is_none());
}

#[test]
fn covariance_is_the_spread_of_triangulated_noise() {
    use rand::{RngExt, SeedableRng};
    let rig = rig();
    let point = Point3::new(20.0, -15.0, 485.0);
    let (l, r) = (rig.project_left(&point).unwrap(), rig.project_right(&point).unwrap());
    let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(7);
    // uniform noise of σ = 0.2 px
    let mut noise = || {
        let mut one = || (rng.random::<f64>() - 0.5) * 0.2 * 12f64.sqrt();
        Vector2::new(one(), one())
    };
    let n = 4000;
    let mut sum = Matrix3::zeros();
    for _ in 0..n {
        let seen =
            rig.triangulate(rig.left.undistort(l + noise()), rig.right.undistort(r + noise())).unwrap();
        let d: Vector3<f64> = seen.point_left_mm - point;
        sum += d * d.transpose() / n as f64;
    }
    let stated = rig.triangulation_covariance(&point, 0.2).unwrap();
    for i in 0..3 {
        let ratio = sum[(i, i)] / stated[(i, i)];
        assert!((0.9..1.1).contains(&ratio), "axis {i}: {ratio}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn undistort_is_the_reverse_of_distort(x in -0.3f64..0.3, y in -0.25f64..0.25, which in 0usize..6) {
        let camera = camera([0, 4, 5, 8, 12, 14][which]);
        let norm = Vector2::new(x, y);
        prop_assert!((camera.undistort(camera.distort(norm)) - norm).norm() < 1e-11);
    }

    /// The slow twin descends on the reprojection error itself.
    #[test]
    fn triangulation_has_the_least_reprojection_error(
        x in -80f64..80.0, y in -60f64..60.0, z in 380f64..600.0,
        noise in prop::array::uniform4(-1.5f64..1.5),
    ) {
        let mut rig = rig();
        rig.left.distortion = [0.0; 14];
        rig.right.distortion = [0.0; 14];
        let point = Point3::new(x, y, z);
        let l = rig.project_left(&point).unwrap() + Vector2::new(noise[0], noise[1]);
        let r = rig.project_right(&point).unwrap() + Vector2::new(noise[2], noise[3]);
        let seen = rig.triangulate(rig.left.undistort(l), rig.right.undistort(r)).unwrap();
        let error = |p: &Point3<f64>| {
            let l = (rig.project_left(p).unwrap() - l).norm_squared();
            (l + (rig.project_right(p).unwrap() - r).norm_squared()).sqrt()
        };
        let mut best = point;
        let turn = rig.right_from_left.rotation.to_rotation_matrix().into_inner();
        for _ in 0..20 {
            let (pl, jl) = rig.left.project_with_jacobian(&best).unwrap();
            let (pr, jr) = rig.right.project_with_jacobian(&(rig.right_from_left * best)).unwrap();
            let jr = jr * turn;
            let step = (jl.tr_mul(&jl) + jr.tr_mul(&jr)).try_inverse().unwrap()
                * (jl.tr_mul(&(pl - l)) + jr.tr_mul(&(pr - r)));
            best -= step;
        }
        prop_assert!((error(&seen.point_left_mm) - error(&best)).abs() < 1e-6);
        prop_assert!((seen.residual_px - error(&best)).abs() < 1e-6);
        prop_assert!((seen.point_left_mm - best).norm() < 1e-3);
    }

    /// Whatever stands in the file: a rig whose numbers are finite, or an error.
    #[test]
    fn no_text_makes_the_reader_panic(at in 0usize..1300, cut in 0usize..40, put in "[-0-9a-zM.,:!\\[\\]\" \n]{0,8}") {
        let mut text = fs::read_to_string(conveyor()).unwrap();
        let begin = at.min(text.len());
        text.replace_range(begin..(begin + cut).min(text.len()), &put);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("rig.yaml");
        fs::write(&path, text).unwrap();
        if let Ok(rig) = Rig::read(&path) {
            let corner = rig.left.undistort(Vector2::new(639.0, 479.0));
            prop_assert!(rig.geometry().essential.iter().chain(corner.iter()).all(|v| v.is_finite()), "{rig:?}");
        }
    }

    #[test]
    fn the_table_undistorts_within_its_stated_error(x in -0.5f64..639.5, y in -0.5f64..479.5) {
        let camera = CameraModel { fx: 520.0, fy: 520.0, ..camera(8) };
        let table = UndistortTable::new(&camera, 0.005);
        prop_assert!(table.error_px() <= 0.005);
        let px = Vector2::new(x, y);
        prop_assert!((camera.distort(table.undistort(px)) - px).norm() < 0.01);
    }
}

#[test]
fn the_table_falls_back_outside_of_the_picture() {
    let table = UndistortTable::new(&camera(5), 0.005);
    for px in [Vector2::new(-500.0, 10.0), Vector2::new(1e4, 1e4), Vector2::new(f64::NAN, 0.0)] {
        let exact = camera(5).undistort(px);
        assert!(table.undistort(px) == exact || exact.x.is_nan());
    }
}

#[test]
fn a_written_rig_reads_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rig.yaml");
    for coefficients in [0, 5, 8, 12, 14] {
        let rig = Rig { left: camera(coefficients), ..rig() };
        rig.write(&path).unwrap();
        let back = Rig::read(&path).unwrap();
        assert_eq!((back.left, back.right), (rig.left, rig.right));
        assert!(
            (back.right_from_left.to_homogeneous() - rig.right_from_left.to_homogeneous()).norm() < 1e-12
        );
        let with_mark = ["\u{feff}".as_bytes(), &std::fs::read(&path).unwrap()].concat();
        std::fs::write(&path, with_mark).unwrap();
        assert_eq!(Rig::read(&path).unwrap(), back);
    }
    let two = Rig { left: CameraModel { width: 800, ..camera(5) }, ..rig() };
    let message = two.write(&path).unwrap_err().to_string();
    assert!(message.contains("(800, 480)") && message.contains("(640, 480)"), "{message}");
}

#[test]
fn the_size_of_the_pictures_is_checked() {
    rig().check_size(640, 480).unwrap();
    let message = rig().check_size(1280, 720).unwrap_err().to_string();
    assert_eq!(
        message,
        "the left picture is 1280x720 pixels, the calibration was made for 640x480; take pictures of that size, or \
         calibrate at the pictures' size"
    );
}

/// The message for the conveyor's file with one thing replaced.
fn refusal(from: &str, to: &str) -> String {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rig.yaml");
    let text = fs::read_to_string(conveyor()).unwrap();
    assert!(text.contains(from), "{from}");
    fs::write(&path, text.replacen(from, to, 1)).unwrap();
    let message = Rig::read(&path).unwrap_err().to_string();
    assert!(message.starts_with("calibration ") && message.contains("rig.yaml"), "{message}");
    message
}

#[test]
fn what_is_wrong_in_a_file_is_named_with_key_value_and_remedy() {
    let cases = [
        ("image_width: 640\n", "", "image_width is missing; the size in pixels"),
        (
            "image_width: 640",
            "image_width: -640",
            "image_width = -640: must be a whole number of pixels from 1",
        ),
        ("image_height: 480", "image_height: 0", "image_height = 0: must be a whole number"),
        ("M2:", "M3:", "M2 is missing; the 3x3 camera matrix"),
        ("T: !!", "t: !!", "T is missing; three numbers"),
        ("1201.127417730653", ".Nan", "M1[0,0] = NaN: must be finite; calibrate again"),
        ("9.0038338196653172", ".Inf", "T[2,0] = inf: must be finite"),
        (
            "322.4702019852449",
            "-1",
            "M1 = cx -1: the principal point lies in the picture, 0 to 640 here; calibrate",
        ),
        ("322.4702019852449", "1e300", "M1 = cx 1e300: "),
        ("-0.11957844649995428", "1e6", "D1 = [1000000.0,"),
        ("1201.127417730653", "-1201.1", "M1 = fx -1201.1: a focal length is 0.04 to 100 times the longer"),
        ("0.98983000226569451", "1.98983", "is no rotation: RᵀR differs from 1 by"),
        ("-63.789745829089803, 0.47779105799731192, 9.0038338196653172", "0., 0., 0.", "a baseline of 0 mm"),
        (
            "-63.789745829089803, 0.47779105799731192, 9.0038338196653172",
            "-0.064, 0., 0.",
            "multiply it by 1000",
        ),
        ("-63.789745829089803", "-1e9", "a baseline of 1e9 mm; it must be 1 to 10000 mm"),
        ("rows: 3\n   cols: 1", "rows: 1\n   cols: 2", "T says 1 rows and 2 cols but has 3 numbers"),
        (
            "rows: 3\n   cols: 3",
            "rows: 9\n   cols: 1",
            "M1 = a matrix of 9 rows and 1 columns: must have 3 rows",
        ),
        (
            "cols: 5\n   dt: d\n   data: [ -0.11957844649995428,",
            "cols: 4\n   dt: i\n   data: [",
            "dt = i is not d or f",
        ),
        (
            "cols: 5\n   dt: d\n   data: [ -0.11957844649995428,",
            "cols: 6\n   dt: d\n   data: [ 1., 2.,",
            "D1 = 6 coefficients: 0, 4, 5, 8, 12 or 14",
        ),
        (
            " 9.0038338196653172 ]",
            "",
            "line 41: T: the list of numbers does not end with ]; the file is truncated",
        ),
        ("image_width: 640", "image_width: 640\nimage_width: 640", "line 4: image_width is there twice"),
        ("%YAML:1.0", "\u{89}PNG", "is no `key: value`; the file is truncated or is not a calibration"),
    ];
    for (from, to, wanted) in cases {
        let message = refusal(from, to);
        assert!(message.contains(wanted), "{message}\nwanted: {wanted}");
    }
    let absent = Rig::read("/nowhere/rig.yaml").unwrap_err().to_string();
    assert!(absent.starts_with("calibration /nowhere/rig.yaml: No such file"), "{absent}");
}

#[test]
fn a_reflection_is_no_rotation_and_no_distortion_is_allowed() {
    let row = "0.98983000226569451, 0.036582848903190628,\n       0.13747094886128527";
    let turned = "-0.98983000226569451, -0.036582848903190628,\n       -0.13747094886128527";
    assert!(refusal(row, turned).contains("a reflection"));
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rig.yaml");
    let text = fs::read_to_string(conveyor()).unwrap();
    let begin = text.find("D1:").unwrap();
    let end = text.find("M2:").unwrap();
    let none = "D1: !!opencv-matrix\n   rows: 0\n   cols: 0\n   dt: u\n   data: [ ]\n";
    fs::write(&path, format!("{}{none}extra: !!opencv-matrix\n   rows: 1\n{}", &text[..begin], &text[end..]))
        .unwrap();
    assert_eq!(Rig::read(&path).unwrap().left.distortion, [0.0; 14]);
}

#[test]
fn ros_pairs_give_the_rig_of_the_opencv_file() {
    let conveyor = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/ros-camera-info");
    let opencv = rig();
    for path in
        [conveyor.clone(), conveyor.join("left_camera_info.yaml"), conveyor.join("right_camera_info.yaml")]
    {
        let ros = Rig::read(&path).unwrap();
        assert_eq!((ros.left, ros.right), (opencv.left, opencv.right));
        let off = ros.right_from_left.inverse() * opencv.right_from_left;
        assert!(off.translation.vector.norm() < 1e-6 && off.rotation.angle() < 1e-9, "{off}");
    }
}

#[test]
fn what_is_wrong_in_a_ros_pair_is_named() {
    let from = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/ros-camera-info");
    let read = |name: &str| fs::read_to_string(from.join(name)).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let (left, right) =
        (folder.path().join("left_camera_info.yaml"), folder.path().join("right_camera_info.yaml"));
    fs::write(&left, read("left_camera_info.yaml")).unwrap();
    for path in [folder.path(), &left] {
        let message = Rig::read(path).unwrap_err().to_string();
        assert!(message.contains("the right camera's file is not beside it"), "{message}");
    }
    for (replace, by, wanted) in [
        (
            "plumb_bob",
            "equidistant",
            "distortion_model = equidistant: only plumb_bob and rational_polynomial",
        ),
        ("projection_matrix", "projection", "projection_matrix is missing; the 3x4 projection"),
        ("rectification_matrix", "rectification", "rectification_matrix is missing"),
    ] {
        fs::write(&right, read("right_camera_info.yaml").replacen(replace, by, 1)).unwrap();
        let message = Rig::read(&left).unwrap_err().to_string();
        assert!(message.contains(wanted), "{message}");
    }
    // both cameras the left one: no baseline
    fs::write(&right, read("left_camera_info.yaml")).unwrap();
    let message = Rig::read(folder.path()).unwrap_err().to_string();
    assert!(message.contains("projection_matrix = [0, 0, 0]: a baseline of 0 mm"), "{message}");
}

/// The rig of the conveyor's file with another T.
fn with_translation(t: &str) -> Rig {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rig.yaml");
    let text = fs::read_to_string(conveyor()).unwrap();
    let was = "-63.789745829089803, 0.47779105799731192, 9.0038338196653172";
    assert!(text.contains(was));
    fs::write(&path, text.replacen(was, t, 1)).unwrap();
    Rig::read(&path).unwrap()
}

#[test]
fn a_translation_the_wrong_way_round_or_in_centimetres_is_doubted() {
    assert_eq!(rig().doubt(), None);
    let turned =
        with_translation("63.789745829089803, -0.47779105799731192, -9.0038338196653172").doubt().unwrap();
    assert!(turned.contains("T may be the wrong way round"), "{turned}");
    let short =
        with_translation("-6.3789745829089803, 0.047779105799731192, 0.90038338196653172").doubt().unwrap();
    assert!(short.contains("stand 6.4 mm apart: T must be in millimetres (not in centimetres"), "{short}");
}

#[test]
fn files_of_opencvs_stereo_sample_of_other_names_and_formats_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("intrinsics.yml");
    let text = fs::read_to_string(conveyor()).unwrap();
    let (m1, r) = (text.find("M1:").unwrap(), text.find("\nR:").unwrap() + 1);
    let refusal = |text: &str| {
        fs::write(&path, text).unwrap();
        Rig::read(&path).unwrap_err().to_string()
    };
    let intrinsics = refusal(&text[m1..r]);
    assert!(
        intrinsics.contains("T is missing; OpenCV's stereo sample writes two files: join"),
        "{intrinsics}"
    );
    let q = text[r..].replacen("\nT:", "\nQ: 1\nT:", 1);
    let extrinsics = refusal(&q);
    assert!(
        extrinsics.contains("M1 is missing; OpenCV's stereo sample writes two files: join"),
        "{extrinsics}"
    );
    assert!(extrinsics.ends_with("; the file has R, Q, T"), "{extrinsics}");
    let other = refusal(&text.replace("M1:", "cameraMatrix1:"));
    assert!(
        other.contains("M1 is missing; the 3x3") && other.contains("image_height, cameraMatrix1, D1"),
        "{other}"
    );
    for (text, format) in
        [("<?xml version=\"1.0\"?>\n", "is XML; write it as YAML"), ("{\n", "is JSON; write it")]
    {
        let message = refusal(text);
        assert!(message.contains(format), "{message}");
    }
}

#[test]
fn ros_pairs_of_other_names_are_read_by_their_folder_and_exchanged_ones_refused() {
    let from = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/ros-camera-info");
    let folder = tempfile::tempdir().unwrap();
    let [left, right] = ["ost_left.yaml", "ost_right.yaml"].map(|name| folder.path().join(name));
    fs::copy(from.join("left_camera_info.yaml"), &left).unwrap();
    fs::copy(from.join("right_camera_info.yaml"), &right).unwrap();
    fs::write(folder.path().join("notes.yaml"), "a: 1").unwrap();
    assert_eq!(Rig::read(folder.path()).unwrap(), Rig::read(&left).unwrap());
    fs::copy(from.join("left_camera_info.yaml"), &right).unwrap();
    fs::copy(from.join("right_camera_info.yaml"), &left).unwrap();
    let message = Rig::read(folder.path()).unwrap_err().to_string();
    assert!(message.contains("ost_left.yaml: projection_matrix[0,3] / [0,0] = -0.06"), "{message}");
    assert!(message.contains("ost_right.yaml: exchange the two files"), "{message}");
    for camera in ["left", "right"] {
        let file = format!("{camera}_camera_info.yaml");
        fs::copy(from.join(&file), folder.path().join(format!("b_{file}"))).unwrap();
    }
    let message = Rig::read(folder.path()).unwrap_err().to_string();
    assert!(message.contains("2 pairs of camera_info files"), "{message}");
}
