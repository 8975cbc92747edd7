use std::fs;

use super::*;

fn part(name: &str) -> Part {
    Part::read(format!("{}/replay/parts/{name}.toml", env!("CARGO_MANIFEST_DIR"))).unwrap()
}

fn turns(part: &Part) -> Vec<&[usize]> {
    part.symmetries.iter().map(|s| s.node_permutation.as_slice()).collect()
}

#[test]
fn the_symmetries_of_the_five_parts_are_found_from_their_shape() {
    assert_eq!(turns(&part("rod-60")), [[0, 1], [1, 0]]);
    assert_eq!(turns(&part("rod-90")), [[0, 1], [1, 0]]);
    assert_eq!(turns(&part("hook")), [[0, 1]]);
    assert_eq!(turns(&part("tee")), [[0, 1, 2, 3], [1, 0, 2, 3]]);
    assert_eq!(turns(&part("zed")), [[0, 1], [1, 0]]);
    assert!(part("rod-60").is_straight() && !part("zed").is_straight());
    assert_eq!(part("tee").nodes[3].kind, NodeKind::Junction);
    assert_eq!(part("tee").nodes[2].kind, NodeKind::End);
    for name in ["rod-60", "tee", "zed"] {
        let part = part(name);
        for s in &part.symmetries {
            for (i, node) in part.nodes.iter().enumerate() {
                let image = part.nodes[s.node_permutation[i]].position_mm;
                assert!((s.part_from_part * node.position_mm - image).norm() < 1e-6, "{name}");
            }
        }
    }
}

#[test]
fn grasps_slide_only_where_the_file_allows() {
    let with = |slide: &str| {
        let hook = format!(
            "name='v'\nthickness_mm=2\nnode=[{{name='a',position_mm=[40,0,0]}},{{name='b',position_mm=[0,30,0]}}]\n\
             edge=[{{from='a',to='b',via=[[0,0,0]]}}]\n\
             [grasp]\nposition_mm=[20,0,0]\napproach=[0,0,-1]\nclosing=[0,1,0]\nwidth_mm=8\n{slide}"
        );
        Part::parse(&hook, "v.toml")
    };
    assert_eq!(with("").unwrap().grasp.slide_mm, 0.0);
    assert_eq!(with("slide_mm=15").unwrap().grasp.slide_mm, 15.0);
    // Beyond, one way the wire ends, the other way it bends.
    assert!(with("slide_mm=25").unwrap_err().to_string().contains("mm are possible"));
}

#[test]
fn a_grasp_lies_on_the_wire() {
    let with = |b: &str, via: &str, position: &str| {
        Part::parse(
            &format!(
                "name='v'\nthickness_mm=2\nnode=[{{name='a',position_mm=[40,0,0]}},{{name='b',position_mm={b}}}]\n\
                 edge=[{{from='a',to='b',via={via}}}]\n\
                 [grasp]\nposition_mm={position}\napproach=[0,0,-1]\nclosing=[0,1,0]\nwidth_mm=8\n"
            ),
            "v.toml",
        )
    };
    let (hook, rod) = (("[0,30,0]", "[[0,0,0]]"), ("[-40,0,0]", "[]"));
    for (b, via) in [hook, rod] {
        assert!(with(b, via, "[20,0.5,0.5]").is_ok());
        for off in ["[20,3,0]", "[20,0,-2]", "[20,-7,0]"] {
            let refusal = with(b, via, off).unwrap_err().to_string();
            assert!(refusal.contains("mm from the wire's axis; put it on that"), "{refusal}");
        }
    }
    // The corner itself is beside the wire, which is bent there.
    assert!(with(hook.0, hook.1, "[0,0,0]").is_ok());
    // On which side of a rod it lay nobody could see.
    assert_eq!(with(rod.0, rod.1, "[20,0.5,0.5]").unwrap().grasp.position_mm, Point3::new(20.0, 0.0, 0.0));
}

#[test]
fn a_grasp_closes_across_the_wire_and_not_beyond_its_end() {
    let with = |position: &str, closing: &str| {
        let rod =
            fs::read_to_string(format!("{}/replay/parts/rod-90.toml", env!("CARGO_MANIFEST_DIR"))).unwrap();
        let rod = rod.replace("position_mm = [0.0, 0.0, 0.0]", position);
        Part::parse(&rod.replace("closing = [0.0, 1.0, 0.0]", closing), "r.toml").map_err(|e| e.to_string())
    };
    let (middle, across) = ("position_mm = [0.0, 0.0, 0.0]", "closing = [0.0, 1.0, 0.0]");
    assert!(with("position_mm = [45.0, 0.0, 0.0]", "closing = [0.06, 1.0, 0.0]").is_ok());
    let beyond = with("position_mm = [46.0, 0.0, 0.0]", across).unwrap_err();
    assert!(beyond.contains("position_mm = [46, 0, 0]: is 1.00 mm beyond the wire's end b"), "{beyond}");
    for (closing, deg) in
        [("closing = [0.17633, 1.0, 0.0]", "10.0"), ("closing = [0.7071, 0.7071, 0.0]", "45.0")]
    {
        let askew = with(middle, closing).unwrap_err();
        assert!(askew.contains(&format!("{deg} degrees from it (at most 5 here)")), "{askew}");
    }
    // Where the wire bends it has more than one direction.
    let hook = fs::read_to_string(format!("{}/replay/parts/hook.toml", env!("CARGO_MANIFEST_DIR"))).unwrap();
    let corner = hook.replace("position_mm = [25.0, 0.0, 0.0]", "position_mm = [1.0, 1.0, 0.0]");
    let corner = corner.replace(across, "closing = [0.7071, 0.7071, 0.0]");
    assert!(Part::parse(&corner, "h.toml").is_ok());
}

#[test]
fn wire_too_long_for_its_thickness_is_refused() {
    let rod = |thickness_mm: f64| {
        Part::parse(
            &format!(
                "name='r'\nthickness_mm={thickness_mm}\n\
                 node=[{{name='a',position_mm=[-450,0,0]}},{{name='b',position_mm=[450,0,0]}}]\n\
                 edge=[{{from='a',to='b'}}]\n\
                 [grasp]\nposition_mm=[0,0,0]\napproach=[0,0,-1]\nclosing=[0,1,0]\nwidth_mm=8\n"
            ),
            "r.toml",
        )
    };
    assert!(rod(1.0).is_ok());
    let refusal = rod(0.99).unwrap_err().to_string();
    assert!(refusal.contains("900 mm long; of wire 0.99 mm thick at most 891 mm"), "{refusal}");
}

#[test]
fn a_planar_hook_with_equal_legs_turns_over_and_a_cross_has_eight_turns() {
    let hook = "name='v'\nthickness_mm=2\nnode=[{name='a',position_mm=[30,0,0]},{name='b',position_mm=[0,30,0]}]\n\
                edge=[{from='a',to='b',via=[[0,0,0]]}]\n\
                [grasp]\nposition_mm=[15,0,0]\napproach=[0,0,-1]\nclosing=[0,1,0]\nwidth_mm=8\n";
    let v = Part::parse(hook, "v.toml").unwrap();
    assert_eq!(turns(&v), [[0, 1], [1, 0]]);
    let about = v.symmetries[1].part_from_part.rotation.axis().unwrap();
    assert!((about.x.abs() - about.y.abs()).abs() < 1e-9 && about.z.abs() < 1e-9);
    let cross = "name='x'\nthickness_mm=2\nnode=[{name='a',position_mm=[30,0,0]},{name='b',position_mm=[0,30,0]},\
                 {name='c',position_mm=[-30,0,0]},{name='d',position_mm=[0,-30,0]},{name='j',position_mm=[0,0,0]}]\n\
                 edge=[{from='a',to='j'},{from='b',to='j'},{from='c',to='j'},{from='j',to='d'}]\n\
                 [grasp]\nposition_mm=[15,0,0]\napproach=[0,0,-1]\nclosing=[0,1,0]\nwidth_mm=8\n";
    assert_eq!(Part::parse(cross, "x.toml").unwrap().symmetries.len(), 8);
}

#[test]
fn corners_are_rounded_with_the_bend_radius() {
    let hook = part("hook");
    assert_eq!(hook.bend_radius_mm, 3.0);
    // each leg loses 3 mm to the arc of a quarter turn
    let length = 75.0 - 6.0 + 3.0 * std::f64::consts::FRAC_PI_2;
    assert!((hook.edge_length_mm(0) - length).abs() < 1e-9);
    let line = hook.centreline(0, 0.5);
    assert_eq!(line[0].position_mm, hook.nodes[0].position_mm);
    assert!((line.last().unwrap().position_mm - hook.nodes[1].position_mm).norm() < 1e-9);
    let corner = Point3::origin();
    let inside = line.iter().map(|p| (p.position_mm - corner).norm()).fold(f64::MAX, f64::min);
    assert!((inside - 3.0 * (2f64.sqrt() - 1.0)).abs() < 0.02, "{inside}");
    for pair in line.windows(2) {
        let step = pair[1].position_mm - pair[0].position_mm;
        assert!((0.45..=0.5 + 1e-9).contains(&step.norm()), "{}", step.norm());
        assert!(step.normalize().dot(&pair[0].tangent) > 0.98);
    }
    let zed = part("zed");
    let points = zed.centreline(0, 0.1);
    let inside = points.iter().map(|p| (p.position_mm - zed.edges[0].via[0]).norm()).fold(f64::MAX, f64::min);
    assert!((inside - 3.0 * (1.0 / 30f64.to_radians().cos() - 1.0)).abs() < 0.01, "{inside}");
}

#[test]
fn the_radius_shrinks_where_the_legs_are_short() {
    let mut hook = part("hook");
    hook.bend_radius_mm = 1e3;
    let line = hook.centreline(0, 0.1);
    assert!((line[0].position_mm - hook.nodes[0].position_mm).norm() < 1e-9);
    // the short leg is all arc: radius 25 mm
    assert!((hook.edge_length_mm(0) - (25.0 + 25.0 * std::f64::consts::FRAC_PI_2)).abs() < 1e-9);
    hook.bend_radius_mm = 0.0;
    assert!((hook.edge_length_mm(0) - 75.0).abs() < 1e-9);
}

#[test]
fn a_bend_must_fit_between_its_legs() {
    let file = format!("{}/replay/parts/hook.toml", env!("CARGO_MANIFEST_DIR"));
    let text = fs::read_to_string(file).unwrap();
    let with = |radius_mm: f64| {
        let radius = format!("thickness_mm = 2.5\nbend_radius_mm = {radius_mm:?}");
        Part::parse(&text.replace("thickness_mm = 2.5", &radius), "hook.toml")
    };
    assert!(with(25.0).is_ok());
    let refused = with(25.1).unwrap_err().to_string();
    assert!(refused.contains("bend_radius_mm = 25.1: does not fit between the legs of edge 1"), "{refused}");
    assert!(refused.contains("at most 25.00"), "{refused}");
}

#[test]
fn what_is_wrong_in_a_part_file_is_named() {
    let text = fs::read_to_string(format!("{}/replay/parts/tee.toml", env!("CARGO_MANIFEST_DIR"))).unwrap();
    let cases = [
        ("name = \"tee\"", "name = \"\"", "name = \"\": must be a word"),
        (
            "name = \"tee\"",
            "nme = \"tee\"",
            "line 2: nme: there is no such key; allowed here: name, thickness_mm, bend_radius_mm, node, edge, grasp",
        ),
        ("thickness_mm = 2.5", "thickness_mm = 0.0", "thickness_mm = 0: must be above 0"),
        ("thickness_mm = 2.5", "thickness_mm = 0.0025", "thickness_mm = 0.0025: must be at least 0.05 mm"),
        ("thickness_mm = 2.5", "thickness_mm = nan", "thickness_mm = NaN: must be above 0"),
        (
            "thickness_mm = 2.5",
            "thickness_mm = \"2\"",
            "line 3: thickness_mm = \"2\" is not possible; allowed: a number",
        ),
        ("name = \"tee\"", "name = 7", "line 2: name = 7 is not possible; allowed: a text in quotes"),
        (
            "thickness_mm = 2.5\n",
            "",
            "part file tee.toml: thickness_mm is missing; add it: it has no default",
        ),
        (
            "thickness_mm = 2.5",
            "thickness_mm 2.5",
            "line 3: \"thickness_mm 2.5\" is no TOML: key with no value",
        ),
        ("width_mm = 8.0", "", ": grasp.width_mm is missing; add it"),
        (
            "width_mm = 8.0",
            "width = 8.0",
            "grasp.width: there is no such key; allowed here: position_mm, approach",
        ),
        ("from = \"b\"\n", "", ": edge 2: from is missing; add it: it has no default"),
        ("via = []", "via = 3", ": edge 1: via = 3 is not possible; allowed: a list in [ ]"),
        (
            "via = []",
            "via = [[1, 2, \"x\"]]",
            ": edge 1: via 1: value 3 = \"x\" is not possible; allowed: a number",
        ),
        (
            "thickness_mm = 2.5",
            "thickness_mm = 2.5\nbend_radius_mm = -1.0",
            "bend_radius_mm = -1: must be 0 or more",
        ),
        (
            "[-25.0, 0.0, 0.0]",
            "[-25.0, 0.0]",
            "line 7: node 1: position_mm = [-25.0, 0.0] is not possible; allowed: a list of 3 values",
        ),
        (
            "[-25.0, 0.0, 0.0]",
            "[-25.0, inf, 0.0]",
            "node a: position_mm = [-25.0, inf, 0.0]: must be three numbers",
        ),
        ("name = \"b\"", "name = \"a\"", "node name = \"a\": two nodes have this name"),
        (
            "from = \"b\"",
            "from = \"q\"",
            "edge 2: from = \"q\" is no node of this part; its nodes are a, b, c, j",
        ),
        ("from = \"b\"\nto", "from = \"a\"\nto", "edge 2 (a to j) is there twice"),
        (
            "position_mm = [0.0, 30.0, 0.0]",
            "position_mm = [0.0, 0.0, 0.0]",
            "edge 3 (c to j) has zero length",
        ),
        (
            "position_mm = [0.0, 30.0, 0.0]",
            "position_mm = [0.0, 2.0, 0.0]",
            "length in mm = 2.000: is shorter than thickness_mm",
        ),
        ("via = []", "via = [[50.0, 0.0, 0.0]]", "turns back on itself"),
        (
            "position_mm = [0.0, 15.0, 0.0]",
            "position_mm = [0.0, 150.0, 0.0]",
            "grasp: position_mm = [0, 150, 0]: is 120.0 mm from",
        ),
        (
            "closing = [-1.0, 0.0, 0.0]",
            "closing = [-1.0, 0.0, 0.3]",
            "grasp: closing = [-1.0, 0.0, 0.3]: is 106.7 degrees from approach",
        ),
        (
            "closing = [-1.0, 0.0, 0.0]",
            "closing = [0.0, 1.0, 0.0]",
            "grasp: closing = [0, 1, 0]: does not close across the wire",
        ),
        (
            "approach = [0.0, 0.0, -1.0]",
            "approach = [0.0, 0.0, 0.0]",
            "grasp: approach = [0.0, 0.0, 0.0]: must be a direction",
        ),
        (
            "width_mm = 8.0",
            "width_mm = 2.0",
            "grasp: width_mm = 2: the fingers must open wider than thickness_mm = 2.5",
        ),
        (
            "width_mm = 8.0",
            "width_mm = 8.0\nslide_mm = 40.0",
            "grasp: slide_mm = 40: the wire ends or bends so far from position_mm, or approach × closing is not quite its direction; 15.",
        ),
        ("width_mm = 8.0", "width_mm = 8.0\nslide_mm = -1.0", "grasp: slide_mm = -1: must be 0 to"),
        ("[[edge]]\nfrom = \"c\"\nto = \"j\"\nvia = []", "", "node c is on no edge"),
        (
            "[grasp]",
            "[[grasp]]",
            ": grasp 1 = [[grasp]] is not possible; allowed: something else than tables",
        ),
        ("[[edge]]", "[[egde]]", ": egde: there is no such key; allowed here: name"),
    ];
    for (from, to, wanted) in cases {
        assert!(text.contains(from), "{from}");
        let message = Part::parse(&text.replacen(from, to, 1), "tee.toml").unwrap_err().to_string();
        assert!(message.starts_with("part file tee.toml"), "{message}");
        assert!(message.contains(wanted), "{message}\nwanted: {wanted}");
    }
    let rod = fs::read_to_string(format!("{}/replay/parts/rod-60.toml", env!("CARGO_MANIFEST_DIR"))).unwrap();
    let edge = rod.find("[[edge]]").unwrap()..rod.find("[grasp]").unwrap();
    let no_edge = format!("{}{}", &rod[..edge.start], &rod[edge.end..]);
    let message = Part::parse(&no_edge, "r.toml").unwrap_err().to_string();
    assert_eq!(message, "part file r.toml: 0 [[edge]] tables; a part has 1 to 64 wires between its nodes");
    let bend = "name='v'\nthickness_mm=2\nnode=[{name='a',position_mm=[30,0,0]},{name='m',position_mm=[0,0,0]},\
                {name='b',position_mm=[0,30,0]}]\nedge=[{from='a',to='m'},{from='m',to='b'}]\n\
                [grasp]\nposition_mm=[15,0,0]\napproach=[0,0,-1]\nclosing=[0,1,0]\nwidth_mm=8\n";
    let message = Part::parse(bend, "v.toml").unwrap_err().to_string();
    assert!(message.contains("node m joins two edges only: make them one edge"), "{message}");
}

#[test]
fn two_parts_of_one_name_and_absent_files_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let rod = format!("{}/replay/parts/rod-60.toml", env!("CARGO_MANIFEST_DIR"));
    fs::copy(&rod, path("a.toml")).unwrap();
    fs::copy(&rod, path("b.toml")).unwrap();
    let message = Part::read_all(&[path("a.toml"), path("b.toml")]).unwrap_err().to_string();
    assert!(message.contains("a.toml and ") && message.contains("both have name = \"rod-60\""), "{message}");
    let message = Part::read(path("c.toml")).unwrap_err().to_string();
    assert!(message.contains("c.toml: No such file"), "{message}");
}

proptest::proptest! {
    #![proptest_config(proptest::prelude::ProptestConfig::with_cases(200))]

    /// Whatever stands in the file: a part or an error, and the part can be drawn.
    #[test]
    fn no_text_makes_the_reader_panic(at in 0usize..600, cut in 0usize..20, put in "[-0-9a-z.,\\[\\]\"= \n]{0,8}") {
        let mut text = fs::read_to_string(format!("{}/replay/parts/zed.toml", env!("CARGO_MANIFEST_DIR"))).unwrap();
        let begin = at.min(text.len());
        text.replace_range(begin..(begin + cut).min(text.len()), &put);
        if let Ok(part) = Part::parse(&text, "zed.toml") {
            for edge in 0..part.edges.len() {
                let points = part.centreline(edge, 1.0);
                proptest::prop_assert!(points.iter().all(|p| p.position_mm.coords.iter().all(|v| v.is_finite())));
            }
        }
    }
}

#[test]
fn more_nodes_and_bends_than_the_search_has_room_for_are_refused() {
    let zigzag = |bends: usize| {
        let via: Vec<String> = (0..bends).map(|k| format!("[{},{},0]", 10 * (k + 1), 20 * (k % 2))).collect();
        let last = 10 * (bends + 1);
        format!(
            "name='zigzag'\nthickness_mm=1\nnode=[{{name='a',position_mm=[0,9,0]}},\
             {{name='b',position_mm=[{last},9,0]}}]\nedge=[{{from='a',to='b',via=[{}]}}]\n\
             [grasp]\nposition_mm=[10,0,0]\napproach=[0,0,-1]\nclosing=[0,1,0]\nwidth_mm=8\n",
            via.join(",")
        )
    };
    let error = Part::parse(&zigzag(31), "z.toml").unwrap_err().to_string();
    assert!(error.contains("2 nodes and 31 via points; a part has 32 of both together at most"), "{error}");
    assert_eq!(Part::parse(&zigzag(30), "z.toml").unwrap().edges[0].via.len(), 30);
}
