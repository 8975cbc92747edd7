use super::*;

fn graph_of(skeleton: &BitImage, mask: &BitImage) -> Graph {
    let mut graph = Graph::default();
    let (w, h) = (mask.width(), mask.height());
    Graphs::new(Params::default(), w, h).run(skeleton, mask, None, &mut graph).unwrap();
    graph
}

#[test]
fn a_ring_is_a_closed_loop_without_nodes() {
    let ring = BitImage::from_text(
        "..........
         ..######..
         .#......#.
         .#......#.
         .#......#.
         ..######..
         ..........",
    );
    let graph = graph_of(&ring, &ring);
    assert!(graph.nodes.is_empty());
    assert_eq!(graph.edges.len(), 1);
    assert_eq!(graph.edges[0].nodes, [NONE; 2]);
    assert_eq!(graph.edge_points(&graph.edges[0]).len(), ring.count());
}

#[test]
fn a_staircase_has_no_junctions() {
    let stairs = BitImage::from_text(
        "##........
         .##.......
         ..##......
         ...##.....
         ....#####.",
    );
    let graph = graph_of(&stairs, &stairs);
    assert_eq!(graph.nodes.len(), 2);
    assert!(graph.nodes.iter().all(|n| n.kind == NodeKind::End));
    assert_eq!(graph.edges.len(), 1);
}

/// A rod of this length and thickness about a centre, at an angle to the x axis.
fn rod(centre: [f32; 2], degrees: f32, length: f32, thickness: f32) -> BitImage {
    let mut mask = BitImage::new(200, 200);
    let (sin, cos) = degrees.to_radians().sin_cos();
    for y in 0..200 {
        for x in 0..200 {
            let (dx, dy) = (x as f32 - centre[0], y as f32 - centre[1]);
            let (along, across) = (dx * cos + dy * sin, dy * cos - dx * sin);
            mask.set(x, y, along.abs() < length / 2.0 && across.abs() < thickness / 2.0);
        }
    }
    mask
}

#[test]
fn rods_are_found_whole_at_any_angle_with_both_algorithms() {
    use crate::vision::thin::{self, Algorithm, Thin};
    let mut skeleton = BitImage::new(200, 200);
    for algorithm in [Algorithm::ZhangSuen, Algorithm::GuoHall] {
        for (i, degrees) in
            [0.0f32, 10.0, 30.0, 43.0, 44.5, 45.0, 46.0, 60.0, 89.0, 90.0, 120.0, 135.0, 170.0]
                .into_iter()
                .enumerate()
        {
            for thickness in [4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 12.0] {
                let centre = [100.0 + 0.25 * (i % 4) as f32, 100.0 + 0.125 * (i % 3) as f32];
                let mask = rod(centre, degrees, 140.0, thickness);
                Thin::new(thin::Params { algorithm }, 200, 200).run(&mask, &mut skeleton);
                let graph = graph_of(&skeleton, &mask);
                let what = format!("{algorithm:?}, {degrees} degrees, {thickness} px thick: {graph:?}");
                assert_eq!((graph.nodes.len(), graph.edges.len()), (2, 1), "{what}");
                let [a, b] = graph.edges[0].nodes.map(|n| graph.nodes[n as usize]);
                assert!(a.end_visible && b.end_visible, "{what}");
                let (dx, dy) = (b.position_px[0] - a.position_px[0], b.position_px[1] - a.position_px[1]);
                assert!((dx.hypot(dy) - 140.0).abs() < 2.5, "{what}");
                let (sin, cos) = degrees.to_radians().sin_cos();
                for node in [a, b] {
                    let p = node.position_px;
                    let across = (p[1] - centre[1]) * cos - (p[0] - centre[0]) * sin;
                    assert!(across.abs() < 1.2, "{across} px aside, {what}");
                }
                assert!((graph.edges[0].half_thickness_px - thickness / 2.0).abs() < 0.8, "{what}");
            }
        }
    }
}

fn graph_by_thinning(mask: &BitImage) -> Graph {
    use crate::vision::thin::{self, Thin};
    let mut skeleton = BitImage::new(mask.width(), mask.height());
    Thin::new(thin::Params::default(), mask.width(), mask.height()).run(mask, &mut skeleton);
    graph_of(&skeleton, mask)
}

fn united(mut a: BitImage, b: &BitImage) -> BitImage {
    for (a, b) in a.words_mut().iter_mut().zip(b.words()) {
        *a |= b;
    }
    a
}

#[test]
fn a_crossing_has_four_ends_and_a_bridge_at_most() {
    for degrees in [65.0, 80.0, 95.0, 110.0] {
        let cross = united(rod([100.0, 100.0], 5.0, 150.0, 8.0), &rod([101.0, 99.0], degrees, 150.0, 8.0));
        let graph = graph_by_thinning(&cross);
        let ends = graph.nodes.iter().filter(|n| n.kind == NodeKind::End).count();
        let is_junction = |n: u32| graph.nodes[n as usize].kind == NodeKind::Junction;
        let bridges = graph.edges.iter().filter(|e| e.nodes.into_iter().all(is_junction)).count();
        assert_eq!(ends, 4, "{degrees} degrees: {:?}", graph.nodes);
        assert_eq!(graph.edges.len(), 4 + bridges, "{degrees} degrees: {:?}", graph.edges);
        assert!(bridges <= 1, "{degrees} degrees");
        let degree: usize = graph.nodes.iter().map(|n| n.degree as usize).sum();
        assert_eq!(degree, 2 * graph.edges.len());
    }
}

#[test]
fn bumps_of_the_border_are_cut_and_legs_stay() {
    let mut bumpy = rod([100.0, 100.0], 0.0, 150.0, 9.0);
    for x in 80..85 {
        for y in 91..96 {
            bumpy.set(x, y, true);
        }
    }
    let graph = graph_by_thinning(&bumpy);
    assert_eq!((graph.nodes.len(), graph.edges.len()), (2, 1), "{:?}", graph.nodes);
    let tee = united(rod([100.0, 100.0], 0.0, 150.0, 9.0), &rod([100.0, 122.0], 90.0, 44.0, 9.0));
    let graph = graph_by_thinning(&tee);
    assert_eq!((graph.nodes.len(), graph.edges.len()), (4, 3), "{:?}", graph.nodes);
    let junction = graph.nodes.iter().find(|n| n.kind == NodeKind::Junction).unwrap();
    assert_eq!(junction.degree, 3);
    let [x, y] = junction.position_px;
    assert!((x - 100.0).abs() < 2.0 && (y - 101.0).abs() < 3.0, "{junction:?}");
}

#[test]
fn edges_run_from_their_first_node_to_their_second() {
    let tee = united(rod([100.0, 100.0], 20.0, 150.0, 7.0), &rod([100.0, 130.0], 100.0, 60.0, 7.0));
    let graph = graph_by_thinning(&tee);
    for edge in &graph.edges {
        let points = graph.edge_points(edge);
        for (n, p) in [(edge.nodes[0], points.first()), (edge.nodes[1], points.last())] {
            let (node, p) = (graph.nodes[n as usize], p.unwrap());
            let (dx, dy) = (node.skeleton_px[0] - p[0] as f32, node.skeleton_px[1] - p[1] as f32);
            assert!(dx.hypot(dy) < 3.0, "{node:?} {p:?}");
        }
        for pair in points.windows(2) {
            let apart = pair[0][0].abs_diff(pair[1][0]).max(pair[0][1].abs_diff(pair[1][1]));
            assert!((1..=4).contains(&apart), "{pair:?}");
        }
    }
}

#[test]
fn grey_values_put_ends_to_a_fraction_of_a_pixel() {
    use crate::vision::thin::{self, Thin};
    let (width, height) = (200, 200);
    for (i, degrees) in [0.0f32, 17.0, 45.0, 63.0, 90.0, 152.0].into_iter().enumerate() {
        let centre = [100.0 + 0.31 * i as f32, 99.0 + 0.17 * i as f32];
        let (sin, cos) = degrees.to_radians().sin_cos();
        let mut frame = Frame::from_rgb(width, height, vec![40; 3 * width * height]);
        for (i, pixel) in frame.bytes.chunks_exact_mut(3).enumerate() {
            let (dx, dy) = ((i % width) as f32 - centre[0], (i / width) as f32 - centre[1]);
            let (along, across) = (dx * cos + dy * sin, dy * cos - dx * sin);
            let cover = |inside: f32| (inside + 0.5).clamp(0.0, 1.0);
            pixel.fill((40.0 + 160.0 * cover(60.0 - along.abs()) * cover(3.7 - across.abs())) as u8);
        }
        let grey: Vec<u8> = frame.bytes.chunks_exact(3).map(|p| if p[0] >= 100 { 255 } else { 0 }).collect();
        let mask = BitImage::from_grey(width, height, &grey);
        let (mut skeleton, mut graph) = (BitImage::new(width, height), Graph::default());
        Thin::new(thin::Params::default(), width, height).run(&mask, &mut skeleton);
        let mut first: Option<Graph> = None;
        for &level in Level::available() {
            Graphs::with_level(Params::default(), width, height, level)
                .run(&skeleton, &mask, Some(&frame), &mut graph)
                .unwrap();
            assert_eq!(graph.nodes.len(), 2, "{degrees} degrees");
            for node in &graph.nodes {
                let (dx, dy) = (node.position_px[0] - centre[0], node.position_px[1] - centre[1]);
                let (along, across) = (dx * cos + dy * sin, dy * cos - dx * sin);
                assert!(node.end_visible);
                assert!((along.abs() - 60.0).abs() < 0.35, "{along} along at {degrees} degrees");
                assert!(across.abs() < 0.35, "{across} across at {degrees} degrees");
            }
            assert_eq!(first.get_or_insert_with(|| graph.clone()), &graph, "{level:?}");
        }
    }
}

#[test]
fn a_part_that_leaves_the_picture_has_no_visible_end_there() {
    let mut mask = BitImage::new(200, 200);
    for x in 0..120 {
        for y in 90..98 {
            mask.set(x, y, true);
        }
    }
    let graph = graph_by_thinning(&mask);
    let ends: Vec<_> = graph.nodes.iter().map(|n| (n.position_px[0] > 100.0, n.end_visible)).collect();
    assert_eq!(ends.len(), 2, "{:?}", graph.nodes);
    assert!(ends.iter().all(|&(inside, visible)| inside == visible), "{:?}", graph.nodes);
}

#[test]
fn too_much_is_refused_with_its_limit() {
    use rand::{RngExt, SeedableRng};
    let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(3);
    let mut noise = BitImage::new(640, 480);
    for i in 0..640 * 480 {
        noise.set(i % 640, i / 640, random.random_bool(0.3));
    }
    let mut graph = Graph::default();
    let mut run = |params| {
        let mut graphs = Graphs::new(params, 640, 480);
        let first = graphs.run(&noise, &noise, None, &mut graph);
        // A refusal leaves nothing behind that a second run would trip over.
        assert_eq!(graphs.run(&noise, &noise, None, &mut graph), first);
        assert!(graph.nodes.is_empty() && graph.edges.is_empty() && graph.points.is_empty());
        first.unwrap_err()
    };
    let limits = Params::default();
    assert_eq!(run(limits), Refusal::TooManyNodes { nodes_max: 2048 });
    assert_eq!(
        run(limits).to_string(),
        "the picture has more than 2048 end points and junctions: narrow the colour range (recognition.colour, --color-min) or \
         the region (recognition.region_px, --region-px)"
    );
    let many = Params { nodes_max: 100_000, points_max: 300_000, ..limits };
    assert_eq!(run(many), Refusal::TooManyEdges { edges_max: 4096 });
    let few_points = Params { nodes_max: 100_000, points_max: 5000, ..limits };
    assert_eq!(run(few_points), Refusal::TooManyPoints { points_max: 5000 });
}

#[test]
fn a_graph_that_was_broken_off_is_empty_and_the_next_is_whole() {
    let picture = BitImage::from_text(
        "
        ..........
        .########.
        ....#.....
        ....#.....
        ....#.....
        ..........",
    );
    let (mut graphs, mut graph) = (Graphs::new(Params::default(), 10, 6), Graph::default());
    graphs.run(&picture, &picture, None, &mut graph).expect("within the limits");
    let whole = graph.clone();
    let late = Some(Timestamp(0));
    assert_eq!(graphs.run_until(&picture, &picture, None, &mut graph, late), Ok(false));
    assert_eq!(graph, Graph::default());
    graphs.run(&picture, &picture, None, &mut graph).expect("within the limits");
    assert_eq!(graph, whole);
}

#[test]
fn odd_pictures_neither_panic_nor_hang() {
    use crate::vision::thin::{self, Thin};
    use rand::{RngExt, SeedableRng};
    let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(7);
    for (width, height) in [(1, 1), (2, 3), (64, 64), (65, 7), (129, 40), (640, 480)] {
        let mut white = BitImage::new(width, height);
        for i in 0..width * height {
            white.set(i % width, i / width, true);
        }
        for share in [0.02, 0.5, 0.97] {
            let mut noise = white.clone();
            for i in 0..width * height {
                noise.set(i % width, i / width, random.random_bool(share));
            }
            let mut graph = Graph::default();
            let mut graphs = Graphs::new(Params::default(), width, height);
            let mut skeleton = white.clone();
            Thin::new(thin::Params::default(), width, height).run(&white, &mut skeleton);
            let _ = graphs.run(&skeleton, &white, None, &mut graph);
            let _ = graphs.run(&white, &white, None, &mut graph);
            let _ = graphs.run(&noise, &noise, None, &mut graph);
            let _ = graphs.run(&noise, &white, None, &mut graph);
            let empty = BitImage::new(width, height);
            let _ = graphs.run(&noise, &empty, None, &mut graph);
        }
    }
}
