//! Places on wire and on the floor beside it: what tells parts from the floor is asked there. Here those all along the edges of a
//! graph; of parts, see [`pose::beside`](crate::pose::beside).
//!
//! ```
//! use nalgebra::Vector2;
//! use pickcell::vision::beside::along_edges;
//! use pickcell::vision::bits::BitImage;
//! use pickcell::vision::graph::{Graph, Graphs, Params};
//! use pickcell::vision::thin::{self, Thin};
//!
//! let mut mask = BitImage::new(64, 40);
//! (18..22).for_each(|y| (10..54).for_each(|x| mask.set(x, y, true)));
//! let (mut skeleton, mut graph) = (mask.clone(), Graph::default());
//! Thin::new(thin::Params::default(), 64, 40).run(&mask, &mut skeleton);
//! Graphs::new(Params::default(), 64, 40).run(&skeleton, &mask, None, &mut graph)?;
//! assert!(along_edges(&graph, &mask, 100).count() > 10);
//! for place in along_edges(&graph, &mask, 100) {
//!     let is_object = |px: Vector2<f64>| mask.get(px.x.round() as i32, px.y.round() as i32);
//!     assert!(place.wire_px.into_iter().all(is_object) && !is_object(place.floor_px));
//! }
//! # Ok::<(), pickcell::vision::graph::Refusal>(())
//! ```

use nalgebra::Vector2;

use super::bits::{BitImage, nearest, vector};
use super::graph::{Edge, Graph};

/// Pixels of the skeleton that are asked, one in at least so many, and over how many of them to either side its direction is taken.
const STRIDE_MIN: usize = 5;
const ARM: usize = 4;
/// How far beside the wire the floor is looked at, in pixels: behind what lens and JPEG blur.
pub(crate) const BESIDE_PX: f64 = 3.0;
/// Places on wire, in half widths from its middle: glossy dark wire has a bright line there.
pub(crate) const INSIDE: [f64; 3] = [-0.5, 0.0, 0.5];

/// Places across a wire: on it, and on the floor at one side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beside {
    /// On the wire, from one side to the other.
    pub wire_px: [Vector2<f64>; 3],
    /// Beside it; may lie outside of the picture.
    pub floor_px: Vector2<f64>,
}

/// At most so many places all along the edges of `graph`, on either side of them where `mask` shows nothing.
pub fn along_edges<'a>(
    graph: &'a Graph,
    mask: &'a BitImage,
    places_max: usize,
) -> impl Iterator<Item = Beside> + 'a {
    let inner = |edge: &Edge| ARM..graph.edge_points(edge).len().saturating_sub(ARM);
    let pixels: usize = graph.edges.iter().map(|edge| inner(edge).len()).sum();
    let stride = STRIDE_MIN.max((2 * pixels).div_ceil(places_max.max(1)));
    let all = graph.edges.iter().flat_map(move |edge| inner(edge).map(move |i| (edge, i)));
    let places = all.step_by(stride).flat_map(move |(edge, i)| {
        let (chain, half_px) = (graph.edge_points(edge), f64::from(edge.half_thickness_px));
        let along = vector(chain[i + ARM]) - vector(chain[i - ARM]);
        let across = Vector2::new(-along.y, along.x).try_normalize(0.5);
        across.into_iter().flat_map(move |across| {
            let at = move |px: f64| vector(chain[i]) + across * px;
            let wire_px = INSIDE.map(|share| at(share * half_px));
            let sides = [-1.0, 1.0].map(|side| at(side * (half_px + BESIDE_PX))).into_iter();
            sides
                .filter(|px| !mask.get(nearest(px.x), nearest(px.y)))
                .map(move |floor_px| Beside { wire_px, floor_px })
        })
    });
    places.take(places_max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vision::graph::{Graphs, Params};
    use crate::vision::thin::{self, Thin};

    #[test]
    fn few_places_lie_on_all_edges() {
        let mut mask = BitImage::new(128, 128);
        for bar in 0..10 {
            (0..4).for_each(|y| (10..118).for_each(|x| mask.set(x, 6 + 12 * bar + y, true)));
        }
        let (mut skeleton, mut graph) = (mask.clone(), Graph::default());
        Thin::new(thin::Params::default(), 128, 128).run(&mask, &mut skeleton);
        Graphs::new(Params::default(), 128, 128).run(&skeleton, &mask, None, &mut graph).expect("a graph");
        let bars_of = |places_max| {
            let places: Vec<_> = along_edges(&graph, &mask, places_max).collect();
            assert!(places.len() <= places_max, "{} of {places_max}", places.len());
            let mut bars: Vec<_> = places.iter().map(|place| place.wire_px[1].y as usize / 12).collect();
            bars.dedup();
            bars.len()
        };
        assert_eq!([1000, 60, 20].map(bars_of), [10; 3]);
        assert_eq!([0, 2].map(bars_of), [0, 1]);
    }
}
