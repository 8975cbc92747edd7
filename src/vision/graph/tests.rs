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
