mod colours;

use std::path::Path;

use super::*;
use crate::frame::{Frame, PixelFormat};
use crate::pose::drawn::DrawnPair;
use crate::pose::model::PoseModel;
use crate::rig::CameraModel;
use crate::session::Session;
use crate::vision::halve::thickness_px;

/// A frame of which every pixel is four.
fn doubled(frame: &Frame) -> Frame {
    assert_eq!(frame.format, PixelFormat::Rgb);
    let row = |y: usize| &frame.bytes[y * frame.stride_bytes..][..3 * frame.width];
    let twice = |row: &[u8]| row.chunks(3).flat_map(|pixel| [pixel, pixel].concat()).collect::<Vec<_>>();
    let rows = (0..frame.height).flat_map(|y| [twice(row(y)), twice(row(y))].concat());
    Frame::from_rgb(2 * frame.width, 2 * frame.height, rows.collect())
}

fn doubled_camera(camera: &CameraModel) -> CameraModel {
    let CameraModel { width, height, fx, fy, cx, cy, distortion } = *camera;
    let [cx, cy] = [cx, cy].map(|c| 2.0 * c + 0.5);
    CameraModel { width: 2 * width, height: 2 * height, fx: 2.0 * fx, fy: 2.0 * fy, cx, cy, distortion }
}

fn conveyor() -> (Session, Rig) {
    let replay = Path::new(env!("CARGO_MANIFEST_DIR")).join("replay/conveyor");
    (Session::open(&replay).unwrap(), Rig::read(replay.join("calibration.yaml")).unwrap())
}

/// The conveyor's rig as it was before its right camera turned by this much, in pixels: about the baseline, and at the rim.
fn before_turn(rig: Rig, rows_px: f64, rim_px: f64) -> Rig {
    let baseline = rig.right_eye().coords.normalize();
    let sight = rig.right_from_left.rotation.inverse() * Vector3::z();
    let sight = (sight - baseline * baseline.dot(&sight)).normalize();
    rig.with_right_turned(&-(baseline * (rows_px / rig.right.fy) + sight * (rim_px / 320.0)))
}

fn recognizer(rig: Rig) -> Recognizer {
    recognizer_with(Params::default(), rig)
}

fn recognizer_with(params: Params, rig: Rig) -> Recognizer {
    let rod = Path::new(env!("CARGO_MANIFEST_DIR")).join("replay/parts/rod-90.toml");
    Recognizer::new(params, rig, vec![Part::read(rod).unwrap()]).unwrap()
}

/// The pair of that number, each picture doubled so often.
fn frames(session: &Session, pair: usize, doublings: [usize; 2]) -> FramePair {
    let [Some(left), Some(right)] = &session.pairs[pair].pictures else { panic!("a whole pair") };
    let [left, right] = [(left, doublings[0]), (right, doublings[1])]
        .map(|(picture, times)| (0..times).fold(picture.read_raw().unwrap(), |frame, _| doubled(&frame)));
    FramePair { left, right }
}

fn doubled_rig(rig: &Rig, doublings: [usize; 2]) -> Rig {
    let times = |camera, times| (0..times).fold(camera, |camera, _| doubled_camera(&camera));
    Rig { left: times(rig.left, doublings[0]), right: times(rig.right, doublings[1]), ..*rig }
}

fn run(recognizer: &mut Recognizer, frames: &FramePair) -> Recognition {
    let mut found = Recognition::default();
    recognizer.run(frames, Budget::Iterations(100_000), 1, &mut found).unwrap();
    found
}

#[test]
fn pictures_are_left_where_time_is_over_and_left_again() {
    let (session, rig) = conveyor();
    let frames = frames(&session, 0, [0; 2]);
    let mut recognizer = recognizer(rig);
    assert!(!run(&mut recognizer, &frames).parts.is_empty());
    for budget in [Budget::Until(Timestamp::now()), Budget::Repeated(Spent::ON_PICTURES)] {
        let mut found = Recognition::default();
        recognizer.run(&frames, budget, 1, &mut found).unwrap();
        assert!(found.parts.is_empty() && found.out_of_time, "{budget:?}");
        assert_eq!((found.no_pick, found.spent), (Some(NoPick::OutOfTime), Spent::ON_PICTURES), "{budget:?}");
    }
    // Nor is there anything of the pair before.
    assert!(recognizer.pictures().iter().all(|p| p.graph().nodes.is_empty() && p.nodes().is_empty()));
}

#[test]
fn thick_wire_is_recognised_in_half_the_size_as_in_a_picture_of_that_size() {
    let (session, rig) = conveyor();
    let mut small = recognizer(rig);
    for doublings in [1, 2] {
        let mut large = recognizer(doubled_rig(&rig, [doublings; 2]));
        for pair in 0..2 {
            let of_small = run(&mut small, &frames(&session, pair, [0, 0])).parts;
            let of_large = run(&mut large, &frames(&session, pair, [doublings; 2])).parts;
            assert_eq!([&small, &large].map(|r| r.pictures()[0].halvings()), [0, doublings]);
            assert!(of_small.len() > 5 && of_small.len() == of_large.len());
            for (a, b) in of_small.iter().zip(&of_large) {
                let moved = a.left_from_part.inverse() * b.left_from_part;
                assert!(moved.translation.vector.norm() < 1e-6 && moved.rotation.angle() < 1e-6, "{moved}");
                for (a, b) in a.nodes.iter().zip(&b.nodes) {
                    let px = (0..doublings).fold(a.left_px, |px, _| px.map(|px| 2.0 * px + 0.5));
                    assert!((b.left_px - px).norm() < 1e-4, "{a:?} {b:?}");
                }
            }
        }
    }
}

#[test]
fn both_pictures_are_looked_at_in_the_larger_size_that_one_of_them_wants() {
    let (session, rig) = conveyor();
    // The left camera has twice the focal length and size of the right one: only its wire is thick.
    let mut uneven = recognizer(doubled_rig(&rig, [1, 0]));
    let of_even = run(&mut recognizer(rig), &frames(&session, 1, [0, 0])).parts;
    let of_uneven = run(&mut uneven, &frames(&session, 1, [1, 0])).parts;
    assert_eq!(uneven.pictures().each_ref().map(Picture::halvings), [0, 0]);
    assert_eq!(of_even.len(), of_uneven.len());
    let near =
        |a: &FoundPart| of_uneven.iter().any(|b| (a.grasp.position_mm - b.grasp.position_mm).norm() < 1.0);
    // One of ten has an end hidden, and has slid a little along its wire.
    let found = of_even.iter().filter(|a| near(a)).count();
    assert!(found + 1 >= of_even.len(), "{found} of {}", of_even.len());
}

#[test]
fn the_grain_of_a_wall_does_not_make_thick_wire_thin_nor_a_pair_too_much() {
    let (session, rig) = conveyor();
    let mut params = Params::default();
    for range in &mut params.binarize {
        range.colour = binarize::ColourRange::Grey { min: 110, max: 255 };
    }
    let mut recognizer = recognizer_with(params, doubled_rig(&rig, [1; 2]));
    let mut pair = frames(&session, 1, [1; 2]);
    let without = run(&mut recognizer, &pair).parts.len();
    // Specks of one pixel in four; of the second rows there are more than a graph has room for.
    let is_light = |n: usize| n.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 62 == 1;
    for rows in [16, 64] {
        for frame in [&mut pair.left, &mut pair.right] {
            let grain = frame.bytes[..3 * 1280 * rows].chunks_mut(3).enumerate();
            grain.filter(|(n, _)| is_light(*n)).for_each(|(_, pixel)| pixel.fill(255));
        }
        let with = run(&mut recognizer, &pair).parts.len();
        assert!(thickness_px(recognizer.pictures()[0].whole_mask()) < 9.0);
        assert_eq!(recognizer.pictures().each_ref().map(Picture::halvings), [1, 1]);
        assert!(without > 5 && with == without, "{with} of {without}");
    }
}

#[test]
fn a_wall_of_light_does_not_make_thin_wire_thick() {
    let (session, rig) = conveyor();
    let mut pair = frames(&session, 1, [0, 0]);
    // A grey range has it all as object; the local threshold would not.
    let mut params = Params::default();
    for range in &mut params.binarize {
        range.colour = binarize::ColourRange::Grey { min: 110, max: 255 };
    }
    let mut recognizer = recognizer_with(params, rig);
    let without = run(&mut recognizer, &pair).parts.len();
    for frame in [&mut pair.left, &mut pair.right] {
        frame.bytes[..3 * 640 * 30].fill(255);
    }
    let with = run(&mut recognizer, &pair).parts.len();
    assert_eq!(recognizer.pictures().each_ref().map(Picture::halvings), [0, 0]);
    assert!(without > 5 && with == without, "{with} of {without}");
}

#[test]
fn what_has_the_largest_fitness_allowed_is_no_part() {
    let (session, rig) = conveyor();
    let pair = frames(&session, 0, [0, 0]);
    let parts_under = |fitness_max| {
        let mut params = Params::default();
        params.search.fitness_max = fitness_max;
        run(&mut recognizer_with(params, rig), &pair).parts
    };
    let all = parts_under(1.0);
    let few = parts_under(0.05);
    assert!(all.iter().any(|part| part.fitness > 0.05) && !few.is_empty());
    assert!(few.len() < all.len() && few.iter().all(|part| part.fitness < 0.05), "{few:?}");
    assert_eq!(parts_under(1e-6).len(), 0);
}

#[test]
fn parts_may_be_of_any_size() {
    let (session, rig) = conveyor();
    let rod = Part::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("replay/parts/rod-90.toml")).unwrap();
    let pair = frames(&session, 0, [0, 0]);
    let as_filed = run(&mut recognizer(rig), &pair).parts;
    // Cameras ten times as far apart, and a part ten times as large: the same pictures.
    let large = |v: f64| 10.0 * v;
    let mut large_rig = rig;
    large_rig.right_from_left.translation.vector *= 10.0;
    let mut large_rod = rod.clone();
    (large_rod.thickness_mm, large_rod.grasp.position_mm) =
        (large(rod.thickness_mm), rod.grasp.position_mm * 10.0);
    large_rod.nodes.iter_mut().for_each(|node| node.position_mm *= 10.0);
    let mut recognizer = Recognizer::new(Params::default(), large_rig, vec![large_rod]).unwrap();
    let found = run(&mut recognizer, &pair).parts;
    let is_there = |small: &FoundPart| {
        let at = small.left_from_part.translation.vector * 10.0;
        found.iter().any(|p| (p.left_from_part.translation.vector - at).norm() < 20.0)
    };
    let there = as_filed.iter().filter(|part| is_there(part)).count();
    assert!(there + 2 >= as_filed.len(), "{there} of {}: {found:?}", as_filed.len());
    // And one far thicker than anything there.
    let mut thick = rod;
    thick.thickness_mm = 20.0;
    let mut recognizer = Recognizer::new(Params::default(), rig, vec![thick]).unwrap();
    assert_eq!(run(&mut recognizer, &pair).parts.len(), 0);
}

#[test]
fn a_right_camera_that_has_turned_is_told_and_allowed_for() {
    let (session, rig) = conveyor();
    // The pictures are what they are: it is the calibration that is turned, the other way.
    let (rows_px, rim_px) = (0.6, 0.8);
    let calibrated = before_turn(rig, rows_px, rim_px);
    let mut as_it_stands = recognizer(rig);
    let mut as_calibrated = recognizer(calibrated);
    for pair in 0..3 {
        let frames = frames(&session, pair, [0, 0]);
        let right = run(&mut as_it_stands, &frames);
        let told = right.turned.unwrap();
        assert!(told.rows_px.abs() < 0.15 && !told.is_allowed_for(), "{told:?}");
        let found = run(&mut as_calibrated, &frames);
        let told = found.turned.unwrap();
        assert!((told.rows_px - rows_px).abs() < 0.15 && told.is_allowed_for(), "{told:?}");
        assert!((told.rim_px - rim_px).abs() < 0.4, "{told:?}");
        let is_there = |a: &FoundPart| {
            found.parts.iter().any(|b| (a.grasp.position_mm - b.grasp.position_mm).norm() < 1.5)
        };
        let there = right.parts.iter().filter(|part| is_there(part)).count();
        // Rods along the baseline of which an end is hidden move by more.
        assert!(there + 2 >= right.parts.len() && there > 5, "{there} of {}", right.parts.len());
        // What was allowed for in one pair is forgotten in the next.
        assert_eq!(run(&mut as_calibrated, &frames).turned, found.turned);
    }
    assert_eq!(*as_calibrated.rig(), calibrated);
    let allowed_for = run(&mut as_calibrated, &frames(&session, 0, [0, 0])).rig(&calibrated);
    let left = allowed_for.right_from_left.rotation.angle_to(&rig.right_from_left.rotation);
    assert!(left * rig.right.fy < 0.5, "{left} radians");
}

/// The right camera upside down: its picture, and how it stands then.
fn upside_down(rig: Rig, frames: FramePair) -> (Rig, FramePair) {
    let CameraModel { width, height, cx, cy, mut distortion, .. } = rig.right;
    let [cx, cy] = [width as f64 - 1.0 - cx, height as f64 - 1.0 - cy];
    // The tangential coefficients; the thin prism is not there.
    distortion[2..4].iter_mut().for_each(|p| *p = -*p);
    let right = CameraModel { cx, cy, distortion, ..rig.right };
    let rolled = Isometry3::rotation(Vector3::z() * std::f64::consts::PI);
    let frame = frames.right;
    let bytes = frame.bytes.chunks(3).rev().flatten().copied().collect();
    let right_frame = Frame::from_rgb(frame.width, frame.height, bytes);
    let rig = Rig { right, right_from_left: rolled * rig.right_from_left, ..rig };
    (rig, FramePair { left: frames.left, right: right_frame })
}

#[test]
fn cameras_may_be_rolled_against_each_other() {
    let (session, rig) = conveyor();
    let mut offered = [0; 2];
    for pair in [0, 3, 5, 9, 12] {
        let upright = frames(&session, pair, [0, 0]);
        let expected = run(&mut recognizer(rig), &upright);
        let (rolled, upside_down) = upside_down(rig, upright);
        let found = run(&mut recognizer(rolled), &upside_down);
        assert!(found.turned.unwrap().doubt.is_none(), "{:?}", found.turned);
        for (offered, found) in offered.iter_mut().zip([&expected, &found]) {
            *offered += found.parts.iter().filter(|p| p.blocked.is_none()).count();
        }
        for part in &expected.parts {
            let at_mm = part.grasp.position_mm;
            let off_mm =
                found.parts.iter().map(|p| (p.grasp.position_mm - at_mm).norm()).fold(99.0, f64::min);
            assert!(off_mm < 1.0, "{off_mm} {at_mm}");
        }
    }
    // Thinning is not the same from all sides, so what is just certain enough may not be.
    assert!(offered[0] > 8 && offered[1].abs_diff(offered[0]) <= 1, "{offered:?}");
}

#[test]
fn a_right_camera_that_was_knocked_is_allowed_for_and_nothing_is_offered() {
    let (session, rig) = conveyor();
    for (rows_px, rim_px) in [(4.0, 0.0), (-25.0, 3.0), (0.0, -6.0)] {
        let mut as_calibrated = recognizer(before_turn(rig, rows_px, rim_px));
        for pair in 0..2 {
            let frames = frames(&session, pair, [0, 0]);
            let right = run(&mut recognizer(rig), &frames);
            let found = run(&mut as_calibrated, &frames);
            let told = found.turned.unwrap();
            assert!((told.rows_px - rows_px).abs() < 0.3 && (told.rim_px - rim_px).abs() < 0.5, "{told:?}");
            assert!(told.doubt.is_some() && found.parts.iter().all(|part| part.blocked.is_some()));
            let is_there = |a: &FoundPart| {
                found.parts.iter().any(|b| (a.grasp.position_mm - b.grasp.position_mm).norm() < 2.0)
            };
            let there = right.parts.iter().filter(|part| is_there(part)).count();
            assert!(there + 2 >= right.parts.len() && there > 5, "{there} of {}", right.parts.len());
        }
    }
}

#[test]
fn rods_are_offered_as_no_thinner_or_thicker_ones() {
    let (session, rig) = conveyor();
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("replay/parts");
    let text = std::fs::read_to_string(folder.join("rod-90.toml")).unwrap();
    let rod_of = |thickness_mm: f64| {
        let thickness = format!("thickness_mm = {thickness_mm:.1}");
        Part::parse(&text.replace("thickness_mm = 3.0", &thickness), "rod.toml").unwrap()
    };
    let offered = |light: f64, other_mm: Option<f64>| {
        let parts = [3.0]
            .into_iter()
            .chain(other_mm)
            .enumerate()
            .map(|(k, thickness_mm)| Part { name: format!("rod {k}"), ..rod_of(thickness_mm) });
        let mut recognizer = Recognizer::new(Params::default(), rig, parts.collect()).unwrap();
        let mut counts = [0, 0];
        for pair in (0..session.pairs.len()).step_by(6) {
            let mut frames = frames(&session, pair, [0, 0]);
            for frame in [&mut frames.left, &mut frames.right] {
                frame.bytes.iter_mut().for_each(|v| *v = (f64::from(*v) * light) as u8);
            }
            for part in run(&mut recognizer, &frames).parts.iter().filter(|part| part.blocked.is_none()) {
                counts[part.part] += 1;
            }
        }
        counts
    };
    for light in [1.0, 0.5] {
        for other_mm in [2.2, 2.4, 2.6, 2.8, 3.3, 3.6, 3.9] {
            assert_eq!(offered(light, Some(other_mm))[1], 0, "{other_mm} mm, light {light}");
        }
        let alone = offered(light, None);
        assert!(alone[0] > 8);
        for other_mm in [1.9, 4.5] {
            assert_eq!(offered(light, Some(other_mm)), alone, "{other_mm} mm, light {light}");
        }
    }
}

#[test]
fn parts_that_look_longer_than_their_files_are_told() {
    let (session, rig) = conveyor();
    let baseline = rig.right_eye().coords.normalize();
    let sight = rig.right_from_left.rotation.inverse() * Vector3::z();
    let upright = sight.cross(&baseline).normalize();
    // Turned towards the left camera the right one sees things farther along the baseline, as if they were farther away.
    let turn = upright * (-0.8 / rig.right.fx);
    let [mut as_it_stands, mut as_calibrated] = [rig, rig.with_right_turned(&-turn)].map(recognizer);
    let depth_mm = |found: &Recognition| {
        let depths = found.parts.iter().map(|part| part.left_from_part.translation.z);
        depths.sum::<f64>() / found.parts.len() as f64
    };
    for pair in 0..2 {
        let frames = frames(&session, pair, [0, 0]);
        let [right, wrong] = [&mut as_it_stands, &mut as_calibrated].map(|r| run(r, &frames));
        let along_px = |found: &Recognition| found.turned.unwrap().along_px;
        assert!(along_px(&right).abs() < 0.3 && (along_px(&wrong) - 0.8).abs() < 0.3, "{:?}", wrong.turned);
        assert!(depth_mm(&wrong) > depth_mm(&right) + 1.0);
    }
}

#[test]
fn parts_are_taken_beside_their_grasp_where_there_is_no_room_at_it() {
    let (session, rig) = conveyor();
    let rod = Part::read(concat!(env!("CARGO_MANIFEST_DIR"), "/replay/parts/rod-90.toml")).unwrap();
    let [mut at_it, mut beside] = [0.0, 30.0].map(|slide_mm| {
        let mut rod = rod.clone();
        rod.grasp.slide_mm = slide_mm;
        Recognizer::new(Params::default(), rig, vec![rod]).unwrap()
    });
    let mut offered = [0; 2];
    for pair in [0, 3, 6, 9] {
        let frames = frames(&session, pair, [0, 0]);
        let found = [&mut at_it, &mut beside].map(|recognizer| run(recognizer, &frames));
        for (offered, found) in offered.iter_mut().zip(&found) {
            *offered += found.parts.iter().filter(|part| part.blocked.is_none()).count();
        }
        for part in &found[1].parts {
            let at_it = found[0].parts.iter().find(|p| p.left_from_part == part.left_from_part).unwrap();
            let moved_mm = part.grasp.position_mm - at_it.grasp.position_mm;
            assert!((moved_mm - at_it.grasp.axis * part.grasp.slid_mm).norm() < 1e-9);
            if part.grasp.slid_mm == 0.0 {
                assert_eq!(part, at_it);
            } else {
                assert_eq!(at_it.blocked, Some(Blocked::NoRoom));
                assert!(part.grasp.slid_mm.abs() <= 30.0 && part.sigma_mm != at_it.sigma_mm);
            }
        }
    }
    assert!(offered[1] > offered[0] + 3, "{offered:?}");
}

#[test]
fn nothing_is_offered_where_the_ends_of_wire_do_not_lie_where_they_should() {
    let (session, rig) = conveyor();
    let mut parts = 0;
    for rows_px in [40.0, 60.0, -90.0] {
        let mut as_calibrated = recognizer(before_turn(rig, rows_px, 0.0));
        for pair in 0..4 {
            let found = run(&mut as_calibrated, &frames(&session, pair, [0, 0]));
            assert!(found.parts.iter().all(|part| part.blocked.is_some()), "{found:?}");
            let doubt = found.turned.and_then(|turned| turned.doubt);
            assert_eq!(doubt, Some(Doubt::EndsApart), "{rows_px} {pair}: {found:?}");
            parts += found.parts.len();
        }
    }
    assert!(parts > 0);
}

#[test]
fn exchanged_pictures_are_refused() {
    let (session, rig) = conveyor();
    let mut found = Recognition::default();
    for pair in 0..4 {
        let frames = frames(&session, pair, [0, 0]);
        let exchanged = FramePair { left: frames.right, right: frames.left };
        let refusal = recognizer(rig).run(&exchanged, Budget::Iterations(200_000), 1, &mut found);
        assert_eq!(refusal, Err(Refusal::Exchanged));
        assert!(found.parts.is_empty());
    }
}

/// A part bent along a smooth arc of 70 mm, with a corner every 10 degrees in its file, and what draws it: short pieces.
fn arc() -> (Part, Vec<Isometry3<f64>>) {
    let (radius_mm, half_rad) = (70.0, 0.5);
    let at = |radius_mm: f64, angle: f64| radius_mm * Vector3::new(angle.sin(), angle.cos(), 0.0);
    let corner_mm = radius_mm / f64::cos(half_rad / 6.0);
    let corners = (0..6).map(|k| at(corner_mm, (f64::from(k) - 2.5) * half_rad / 3.0));
    let shown = |p: Vector3<f64>| format!("[{:.4}, {:.4}, 0]", p.x, p.y);
    let text = format!(
        "name='arc'\nthickness_mm=3\nbend_radius_mm={radius_mm}\n\
         node=[{{name='a',position_mm={}}},{{name='b',position_mm={}}}]\nedge=[{{from='a',to='b',via=[{}]}}]\n\
         [grasp]\nposition_mm=[0,{radius_mm},0]\napproach=[0,0,-1]\nclosing=[0,1,0]\nwidth_mm=8\n",
        shown(at(radius_mm, -half_rad)),
        shown(at(radius_mm, half_rad)),
        corners.map(shown).collect::<Vec<_>>().join(", ")
    );
    let pieces = (-23..=23).map(|k| {
        let angle = f64::from(k) / 23.0 * (half_rad - 1.6 / radius_mm);
        Isometry3::new(at(radius_mm, angle), Vector3::z() * -angle)
    });
    (Part::parse(&text, "arc.toml").unwrap(), pieces.collect())
}

#[test]
fn smooth_arcs_are_found_by_their_ends() {
    let (part, pieces) = arc();
    let piece = "name='piece'\nthickness_mm=3\n\
                 node=[{name='a',position_mm=[-1.6,0,0]},{name='b',position_mm=[1.6,0,0]}]\nedge=[{from='a',to='b'}]\n\
                 [grasp]\nposition_mm=[0,0,0]\napproach=[0,0,-1]\nclosing=[0,1,0]\nwidth_mm=8\n";
    let piece = PoseModel::new(&Part::parse(piece, "piece.toml").unwrap());
    for turn in [0.2, 1.4, 2.9] {
        let pose = Isometry3::new(Vector3::new(0.0, 0.0, 500.0), Vector3::z() * turn)
            * Isometry3::translation(0.0, -65.0, 0.0);
        let drawn: Vec<_> = pieces.iter().map(|place| (&piece, pose * place)).collect();
        let DrawnPair { rig, frames: [left, right], .. } = DrawnPair::new(&drawn);
        let mut recognizer = Recognizer::new(Params::default(), rig, vec![part.clone()]).unwrap();
        let found = run(&mut recognizer, &FramePair { left, right });
        let [found] = &found.parts[..] else { panic!("{turn}: {:?}", found.parts) };
        let farthest_mm = part.nodes.iter().map(|node| {
            let there = found.left_from_part * node.position_mm;
            part.nodes.iter().map(|n| (pose * n.position_mm - there).norm()).fold(99.0, f64::min)
        });
        assert!(farthest_mm.fold(0.0, f64::max) < 2.0 && found.proven, "{turn}: {found:?}");
    }
}

#[test]
fn wire_is_measured_closely_in_heaps_alone_and_what_was_seen_before_changes_nothing() {
    let rod = Path::new(env!("CARGO_MANIFEST_DIR")).join("replay/parts/rod-90.toml");
    let model = PoseModel::new(&Part::read(rod).unwrap());
    let [few, heap] = [2, 10].map(|each_way| DrawnPair::lattice(&model, each_way));
    let mut recognizer = recognizer(few.rig);
    let mut run = |drawn: &DrawnPair| {
        let [left, right] = drawn.frames.clone();
        let mut out = Recognition::default();
        recognizer.run(&FramePair { left, right }, Budget::Iterations(20_000), 1, &mut out).unwrap();
        (recognizer.parts[0].pose_model().per_thickness, out.parts)
    };
    let (first, of_few) = run(&few);
    let (second, of_heap) = run(&heap);
    assert_eq!((first, second, of_few.len()), (1, 2, 4));
    assert!(of_heap.len() > 10, "{}", of_heap.len());
    assert_eq!(run(&few), (1, of_few));
    assert_eq!(run(&heap), (2, of_heap));
}
