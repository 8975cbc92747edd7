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
    assert!(graph.edges[0].closed);
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
                assert!((graph.edges[0].length_px - 140.0).abs() < 4.0, "{what}");
            }
        }
    }
}
