use proptest::prelude::*;

use super::*;

/// Two rods, 90 mm long and 3 mm thick, level: one along x at the origin, the other turned by `yaw`, its middle at
/// this place.
fn of_two(yaw: f64, middle_mm: [f64; 3]) -> (Crossing, [Option<Blocked>; 2]) {
    of_two_known(yaw, middle_mm, 0.1)
}

/// The same, with their places known to so much.
fn of_two_known(yaw: f64, middle_mm: [f64; 3], sigma_mm: f64) -> (Crossing, [Option<Blocked>; 2]) {
    let file = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("replay/parts/rod-90.toml");
    let part = Part::read(file).unwrap();
    let model = PoseModel::new(&part);
    let rod = |yaw: f64, middle_mm: [f64; 3]| {
        let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), yaw) * turned_to_x(&model);
        let middle = Point3::from(middle_mm) - turn * model.centre_mm.coords;
        Isometry3::from_parts(middle.coords.into(), turn.into())
    };
    let poses = [rod(0.0, [0.0, 0.0, 500.0]), rod(yaw, middle_mm)];
    let placed = poses.each_ref().map(|left_from_part| Placed {
        part: &part,
        model: &model,
        left_from_part,
        sigma_mm: Vector3::repeat(sigma_mm),
    });
    let params = Params::default();
    let mut why = [None; 2];
    blocked(&params, &placed, &mut placed.map(|p| grasp_of(&params, &p)), &mut why);
    (crossing(&params, &placed[0], &placed[1]), why)
}

fn turned_to_x(model: &PoseModel) -> Rotation3<f64> {
    Rotation3::rotation_between(&model.straight_along.unwrap(), &Vector3::x()).unwrap()
}

const UPRIGHT: f64 = std::f64::consts::FRAC_PI_2;

#[test]
fn a_part_whose_end_juts_out_over_another_covers_it() {
    // How far its end stands off the other's axis; over the edge is 3 mm, to the sum of the radii.
    let jutting = |off_mm: f64, x_mm: f64| of_two(UPRIGHT, [x_mm, 45.0 + off_mm, 497.0]);
    for tenth in 0..60 {
        let x_mm = 0.1 * f64::from(tenth) - 44.0;
        let (crossing, why) = jutting(2.9, x_mm);
        assert_eq!(crossing, Crossing { second_over: true, ..Crossing::default() }, "{x_mm}");
        assert_eq!(why, [Some(Blocked::Covered), None]);
        assert_eq!(jutting(3.1, x_mm).0, Crossing::default(), "{x_mm}");
    }
}

#[test]
fn an_end_that_lies_on_the_flank_of_another_covers_it() {
    // Its end hangs over by a sixth of the sum of the radii; where they touch it is 1.66 mm higher.
    let flank = |off_mm: f64, by_mm: f64| of_two(UPRIGHT, [0.0, 45.0 + off_mm, 500.0 - by_mm]).0;
    let [first_over, second_over] =
        [true, false].map(|first| Crossing { first_over: first, second_over: !first, ..Crossing::default() });
    for by_mm in [0.9, 1.66, 3.0] {
        assert_eq!(flank(2.5, by_mm), second_over, "{by_mm}");
        assert_eq!(flank(2.5, -by_mm), first_over, "{by_mm}");
    }
    // Side by side on one floor, by what their heights and places are known to.
    for (off_mm, by_mm) in [(2.5, 0.7), (2.8, 1.4), (3.0, 3.0)] {
        assert_eq!(flank(off_mm, by_mm), Crossing::default(), "{off_mm} {by_mm}");
    }
}

#[test]
fn the_one_on_top_is_offered_and_neither_is_where_they_go_through_each_other() {
    // They cross far from where either is gripped.
    let over = |by_mm: f64| of_two(UPRIGHT, [30.0, 30.0, 500.0 - by_mm]).1;
    assert_eq!(over(3.0), [Some(Blocked::Covered), None]);
    assert_eq!(over(-3.0), [None, Some(Blocked::Covered)]);
    for by_mm in [-1.4, -0.1, 0.0, 0.1, 1.4] {
        assert_eq!(over(by_mm), [Some(Blocked::Uncertain); 2], "{by_mm}");
    }
}

#[test]
fn heights_that_are_not_known_well_do_not_tell_which_lies_on_top() {
    let over = |sigma_mm: f64| of_two_known(UPRIGHT, [30.0, 30.0, 497.0], sigma_mm).1;
    assert_eq!(over(0.9), [Some(Blocked::Covered), None]);
    assert_eq!(over(1.2), [Some(Blocked::Covered), Some(Blocked::Uncertain)]);
}

#[test]
fn what_is_not_a_number_is_not_offered() {
    let offered = |middle_mm, sigma_mm| of_two_known(UPRIGHT, middle_mm, sigma_mm).1[1].is_none();
    let apart_mm = [200.0, 0.0, 500.0];
    assert!(offered(apart_mm, 0.1));
    assert!(!offered(apart_mm, f64::NAN) && !offered(apart_mm, f64::INFINITY));
    for axis in 0..3 {
        let mut nowhere_mm = apart_mm;
        nowhere_mm[axis] = f64::NAN;
        assert!(!offered(nowhere_mm, 0.1), "{axis}");
    }
}

#[test]
fn fingers_neither_close_on_two_wires_nor_rise_into_another() {
    // Another wire, 2.4 mm thick, whose middle is here in the tool's axes; the tool leans by so much.
    let text =
        include_str!("../../replay/parts/rod-90.toml").replace("thickness_mm = 3.0", "thickness_mm = 2.4");
    let part = Part::parse(&text, "thin.toml").unwrap();
    let model = PoseModel::new(&part);
    let fit = |at_mm: [f64; 3], lean: f64| {
        let tool = Rotation3::from_axis_angle(&Vector3::x_axis(), lean);
        let grasp = Grasp {
            position_mm: Point3::new(10.0, 20.0, 500.0),
            axis: tool * Vector3::y(),
            orientation: UnitQuaternion::from_rotation_matrix(&tool),
            opening_mm: 8.0,
            tilt_rad: lean,
            slid_mm: 0.0,
        };
        // Along the tool's y axis.
        let along = Rotation3::from_axis_angle(&Vector3::z_axis(), UPRIGHT) * turned_to_x(&model);
        let turn = tool * along;
        let middle = grasp.position_mm + tool * Vector3::from(at_mm);
        let pose = Isometry3::from_parts((middle - turn * model.centre_mm).into(), turn.into());
        let other = Placed { part: &part, model: &model, left_from_part: &pose, sigma_mm: Vector3::zeros() };
        !meets_fingers(&Params::default(), &other, &grasp, false)
    };
    let Gripper { finger_depth_mm, finger_thickness_mm, .. } = Gripper::default();
    let beside_mm = 4.0 + finger_thickness_mm + 1.2;
    assert!(!fit([2.4, 0.0, 0.0], 0.0) && !fit([beside_mm - 0.1, 0.0, 0.0], 0.0));
    assert!(fit([beside_mm + 0.1, 0.0, 0.0], 0.0));
    assert!(fit([2.4, 0.0, finger_depth_mm + 1.3], 0.0) && !fit([2.4, 0.0, finger_depth_mm + 1.1], 0.0));
    // What ends before the fingers is in their way where they rise straight up and not along their approach.
    let before_mm = -45.0 - Gripper::default().finger_width_mm / 2.0 - 1.5;
    let high = [4.0, before_mm, -30.0];
    assert!(fit(high, 0.0));
    assert!(fit(high, 0.3) != fit(high, -0.3));
}

#[test]
fn wires_side_by_side_are_in_the_way_of_fingers_and_not_on_each_other() {
    for beside_mm in [2.7, 3.0, 3.3] {
        let (crossing, why) = of_two(0.0, [30.0, beside_mm, 500.0]);
        assert_eq!(crossing, Crossing::default(), "{beside_mm}");
        assert_eq!(why, [Some(Blocked::NoRoom); 2], "{beside_mm}");
    }
}

#[test]
fn a_grasp_slides_along_the_wire_to_where_there_is_room() {
    let mut part = Part::read(concat!(env!("CARGO_MANIFEST_DIR"), "/replay/parts/rod-90.toml")).unwrap();
    let params = Params { base_from_left: None, ..Params::default() };
    let mut taken = |slide_mm: f64, second_mm: f64| {
        part.grasp.slide_mm = slide_mm;
        let model = PoseModel::new(&part);
        let turn = turned_to_x(&model);
        let rods = [[0.0, 0.0], [second_mm, 5.2]].map(|[x_mm, y_mm]| {
            let middle_mm = Vector3::new(x_mm, y_mm, 500.0);
            Isometry3::from_parts((middle_mm - turn * model.centre_mm.coords).into(), turn.into())
        });
        let placed = rods.each_ref().map(|left_from_part| Placed {
            part: &part,
            model: &model,
            left_from_part,
            sigma_mm: Vector3::repeat(0.1),
        });
        let mut grasps = placed.map(|p| grasp_of(&params, &p));
        let mut why = [None; 2];
        blocked(&params, &placed, &mut grasps, &mut why);
        (grasps, why)
    };
    // The second lies 5.2 mm beside the first, and begins 10 mm before its middle.
    let (grasps, why) = taken(0.0, 35.0);
    assert!(why == [Some(Blocked::NoRoom); 2] && grasps.iter().all(|grasp| grasp.slid_mm == 0.0));
    let (grasps, why) = taken(30.0, 35.0);
    assert_eq!(why, [None; 2]);
    let [first, second] = grasps.map(|grasp| grasp.position_mm.x);
    // Half a finger, and half the wire, away from its end, and no farther than needed.
    let away_mm = Gripper::default().finger_width_mm / 2.0 + 1.5;
    assert!((-10.0 - away_mm - SLIDE_STEP_MM..=-10.0 - away_mm).contains(&first), "{first}");
    assert!((45.0 + away_mm..=45.0 + away_mm + SLIDE_STEP_MM).contains(&second), "{second}");
    // Too little, and where no other place has room.
    assert_eq!(taken(8.0, 35.0).1, [Some(Blocked::NoRoom); 2]);
    assert_eq!(taken(40.0, 1.0).1, [Some(Blocked::NoRoom); 2]);
}

#[test]
fn fingers_that_slide_along_a_wire_keep_away_from_the_others_of_the_part() {
    let tee = Part::read(concat!(env!("CARGO_MANIFEST_DIR"), "/replay/parts/tee.toml")).unwrap();
    let model = PoseModel::new(&tee);
    let pose = Isometry3::translation(0.0, 0.0, 500.0);
    let placed = Placed { part: &tee, model: &model, left_from_part: &pose, sigma_mm: Vector3::zeros() };
    let (params, radius_mm) = (Params::default(), tee.thickness_mm / 2.0);
    let filed = grasp_of(&params, &placed);
    // Its bar lies across the stem at the origin.
    let to_bar_mm = tee.grasp.position_mm.coords.norm();
    let towards_bar = -(filed.axis.dot(&tee.grasp.position_mm.coords)).signum();
    let reach_mm = params.gripper.finger_width_mm / 2.0 + radius_mm;
    let meets =
        |to_bar: f64| meets_fingers(&params, &placed, &filed.slid(towards_bar * (to_bar_mm - to_bar)), true);
    assert!(!meets(to_bar_mm) && !meets(reach_mm + 0.5));
    assert!(meets(reach_mm - 0.5) && meets(1.0));
}

/// A U of wire 2.5 mm thick, its legs 10 mm apart, gripped at one of them; leaning about that by this angle.
fn of_leaning_u(lean_deg: f64) -> Option<Blocked> {
    let text = "name='u'\nthickness_mm=2.5\nbend_radius_mm=3\n\
                node=[{name='a',position_mm=[50,0,0]},{name='b',position_mm=[50,10,0]}]\n\
                edge=[{from='a',to='b',via=[[0,0,0],[0,10,0]]}]\n\
                [grasp]\nposition_mm=[30,0,0]\napproach=[0,0,-1]\nclosing=[0,1,0]\nwidth_mm=8\n";
    let part = Part::parse(text, "u.toml").unwrap();
    let model = PoseModel::new(&part);
    // The approach looks away from the camera.
    let over = Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI - lean_deg.to_radians());
    let pose = Isometry3::from_parts(Vector3::new(0.0, 0.0, 500.0).into(), over.into());
    let placed =
        [Placed { part: &part, model: &model, left_from_part: &pose, sigma_mm: Vector3::repeat(0.1) }];
    let params = Params::default();
    let mut why = [None];
    blocked(&params, &placed, &mut placed.map(|p| grasp_of(&params, &p)), &mut why);
    why[0]
}

#[test]
fn fingers_that_come_otherwise_than_filed_keep_away_from_the_other_wires_of_the_part() {
    assert_eq!([0.0, 10.0, -10.0].map(of_leaning_u), [None; 3]);
    // The other leg is far below, or stands up beside a finger.
    assert_eq!([40.0, -40.0].map(of_leaning_u), [None, Some(Blocked::NoRoom)]);
}

proptest! {
    #[test]
    fn no_places_of_two_pieces_are_nearer_than_those_found(
        numbers: [i8; 9], shares in proptest::array::uniform2(-1.0..1.0),
    ) {
        let vector = |k: usize| Vector3::from_fn(|i, _| f64::from(numbers[k + i]) / 16.0);
        let (apart, [u, v]) = (vector(0), [vector(3), vector(6)]);
        let beside = |between: Vector3<f64>| between.xy().norm();
        let nearest = beside(nearest_from_above(&apart, &[u, v], &Vector3::z()));
        let [s, t] = shares;
        let ends = [-1.0, 1.0].into_iter().flat_map(|s| [-1.0, 1.0].map(|t| [s, t]));
        for [s, t] in ends.chain([[s, t], [s, 1.0], [-1.0, t]]) {
            prop_assert!(nearest <= beside(apart + u * s - v * t) + 1e-9);
        }
    }
}
