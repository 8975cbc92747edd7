//! What each stage made of a picture, as an engineer tunes with: mask, skeleton, graph.

use nalgebra::Vector2;

use super::canvas::{Canvas, Colour};
use super::places::{Places, scale_of};
use crate::vision::bits::BitImage;
use crate::vision::graph::{Graph, NONE, NodeKind};

const MASK: Colour = [60, 60, 60];
const END: Colour = [255, 220, 0];
const JUNCTION: Colour = [255, 60, 60];
/// One edge after the other.
const EDGES: [Colour; 6] =
    [[90, 200, 255], [130, 255, 130], [255, 150, 220], [255, 190, 90], [190, 160, 255], [120, 230, 210]];

/// A bit image in white on black.
pub fn bits(bits: &BitImage) -> Canvas {
    let mut canvas = Canvas::new(bits.width(), bits.height());
    canvas.put_bits(bits, 0, [255; 3], 1.0);
    canvas
}

/// Edges in turning colours on the dim mask, ends as yellow rings, junctions as red discs, each with its index.
pub fn graph(mask: &BitImage, graph: &Graph) -> Canvas {
    let mut canvas = Canvas::new(mask.width(), mask.height());
    canvas.put_bits(mask, 0, MASK, 1.0);
    let place = |index: u32| {
        let [x, y] = graph.nodes[index as usize].position_px;
        Vector2::new(f64::from(x), f64::from(y))
    };
    for (i, edge) in graph.edges.iter().enumerate() {
        let colour = EDGES[i % EDGES.len()];
        let points = graph.edge_points(edge);
        for &[x, y] in points {
            canvas.blend(i64::from(x), i64::from(y), colour, 1.0);
        }
        // from the skeleton's last pixel to where the part ends
        for (node, point) in edge.nodes.iter().zip([points.first(), points.last()]) {
            if let (true, Some(&[x, y])) = (*node != NONE, point) {
                canvas.line(Vector2::new(f64::from(x), f64::from(y)), place(*node), 1.0, colour);
            }
        }
    }
    let scale = scale_of(mask.width());
    let wide = scale as f64;
    let picture = Vector2::new(mask.width() as f64, mask.height() as f64);
    let mut places = Places::new(Vector2::zeros(), picture);
    for (i, node) in graph.nodes.iter().enumerate() {
        let at = place(i as u32);
        match node.kind {
            NodeKind::End => canvas.ring(at, 3.0 * wide, 1.5 * wide, END),
            NodeKind::Junction => canvas.disc(at, 2.0 * wide, JUNCTION),
        }
        places.take(at.add_scalar(-3.0 * wide), at.add_scalar(3.0 * wide));
    }
    for i in 0..graph.nodes.len() {
        let text = i.to_string();
        let gap = Vector2::new(5.0, 10.0) * wide;
        let corner = places.beside(place(i as u32), gap, Canvas::text_size(&text, scale));
        canvas.text(corner, &text, scale, [255; 3]);
    }
    canvas
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vision::graph::{Graphs, Params};

    #[test]
    fn mask_skeleton_and_nodes_are_where_they_were() {
        let mut mask = BitImage::new(60, 20);
        (10..50).for_each(|x| mask.set(x, 10, true));
        let white = bits(&mask);
        assert_eq!((white.pixel(10, 10), white.pixel(9, 10)), ([255; 3], [0; 3]));
        let mut found = Graph::default();
        Graphs::new(Params::default(), 60, 20).run(&mask, &mask, None, &mut found).unwrap();
        let drawn = graph(&mask, &found);
        assert_eq!(drawn.pixel(30, 10), EDGES[0]);
        let yellow = (0..1200).filter(|i| drawn.pixel(i % 60, i / 60) == END).count();
        assert!(yellow > 10, "{yellow}");
    }
}
