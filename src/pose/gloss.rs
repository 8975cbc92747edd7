//! At which level the outline of wire is taken in a picture.
//!
//! Dull wire ends where its light has fallen half the way to the floor's. On polished wire lies a bright line, and half way
//! from that is the border of the line, which is neither where the wire ends nor the same place of it for both cameras. So the
//! level is lowered until the outlines are about as wide as the thinnest wire may be.
//!
//! ```
//! use pickcell::frame::{Frame, LumaView};
//! use pickcell::level::Level;
//! use pickcell::pose::gloss::Gloss;
//! use pickcell::pose::section::{CONTRAST_MIN, HALF_WAY, Profiler};
//! use pickcell::vision::bits::BitImage;
//! use pickcell::vision::graph::{Graph, Graphs, Params};
//! use pickcell::vision::thin::{self, Thin};
//!
//! // Three level wires 7 pixels thick, dull or with a bright line of 3 pixels along their middle.
//! let level_of = |grey: fn(i32) -> u8| {
//!     let beside = |y: i32| (y - 20).rem_euclid(40).min((20 - y).rem_euclid(40));
//!     let pixels = || (0..120).flat_map(|y| (0..160).map(move |x| (x, y)));
//!     let is_wire = |x: i32, y: i32| (10..150).contains(&x) && beside(y) <= 3;
//!     let light = pixels().map(|(x, y)| if is_wire(x, y) { grey(beside(y)) } else { 35 });
//!     let picture = Frame::from_grey(160, 120, light.collect());
//!     let (mut mask, mut skeleton, mut graph) = (BitImage::new(160, 120), BitImage::new(160, 120), Graph::default());
//!     pixels().for_each(|(x, y)| mask.set(x as usize, y as usize, is_wire(x, y)));
//!     Thin::new(thin::Params::default(), 160, 120).run(&mask, &mut skeleton);
//!     Graphs::new(Params::default(), 160, 120).run(&skeleton, &mask, Some(&picture), &mut graph).unwrap();
//!     let profiler = Profiler::new(LumaView::new(&picture).unwrap(), false, CONTRAST_MIN);
//!     Gloss::new(Level::detect()).outline_256(&graph, &profiler, 7.0)
//! };
//! assert_eq!(level_of(|_| 200), HALF_WAY);
//! assert!(level_of(|beside| if beside <= 1 { 230 } else { 110 }) < HALF_WAY);
//! ```

use arrayvec::ArrayVec;
use nalgebra::Vector2;

use super::outlines::{LINES, Outlines};
use super::section::Profiler;
use crate::level::Level;
use crate::vision::graph::{Edge, Graph};

/// Levels that are tried, highest first, in 1/256 of the way from the floor to the brightest of the wire.
const LEVELS_256: [u8; 4] = [128, 96, 64, 48];
/// Width of the outlines over that of the silhouette from which a level does: of dull wire it is 0.7 or more.
const WIDE_MIN: f64 = 0.65;
/// Sections that are looked at, about, and fewest that say anything.
const SECTIONS: usize = 20;
const SECTIONS_MIN: usize = 5;
/// How far from the ends of its chain a section lies, in half thicknesses, and over how much of the chain its direction is
/// taken, each way, in pixels.
const CLEAR_HALF_WIDTHS: f32 = 4.0;
const DIRECTION_PX: usize = 6;
/// How far from the skeleton the outlines are looked for, in pixels.
const SEARCH_PX: f64 = 1.5;

/// Looks at how polished wire is.
pub struct Gloss {
    outlines: Outlines,
}

impl Gloss {
    /// With instructions of this level.
    pub fn new(level: Level) -> Self {
        Self { outlines: Outlines::new(level) }
    }

    /// At which level outlines are to be taken in a picture with this skeleton, where the silhouette of the thinnest wire is so
    /// wide: see [`Profiler::with_outlines_at`].
    pub fn outline_256(&mut self, graph: &Graph, profiler: &Profiler, silhouette_px: f64) -> u8 {
        let is_wide = |&level_256: &u8| {
            let profiler = profiler.with_outlines_at(level_256);
            let width_px = median_width_px(graph, &profiler, &mut self.outlines);
            width_px.is_none_or(|width_px| width_px >= WIDE_MIN * silhouette_px)
        };
        let [.., lowest] = LEVELS_256;
        LEVELS_256.into_iter().find(is_wide).unwrap_or(lowest)
    }
}

/// Median width of the outlines at places spread over the skeleton; `None` where there are too few.
fn median_width_px(graph: &Graph, profiler: &Profiler, outlines: &mut Outlines) -> Option<f64> {
    let clear_places = |edge: &Edge| {
        let clear = (CLEAR_HALF_WIDTHS * edge.half_thickness_px) as usize + DIRECTION_PX;
        clear..edge.points.len().saturating_sub(clear)
    };
    let apart = graph.edges.iter().map(|edge| clear_places(edge).len()).sum::<usize>() / SECTIONS + 1;
    outlines.clear();
    // From one chain on to the next.
    let mut skipped = 0;
    for edge in &graph.edges {
        let points = graph.edge_points(edge);
        let places = clear_places(edge);
        let taken = places.len().saturating_sub(skipped).div_ceil(apart);
        let next = skipped + taken * apart - places.len();
        for at in places.skip(std::mem::replace(&mut skipped, next)).step_by(apart) {
            let place = |k: usize| Vector2::from(points[k].map(f64::from));
            let along = place(at + DIRECTION_PX) - place(at - DIRECTION_PX);
            if let Some(along) = along.try_normalize(1e-9) {
                let across = Vector2::new(-along.y, along.x);
                outlines.push(0, place(at), across, edge.half_thickness_px.into());
            }
        }
    }
    let sections = outlines.sections([profiler; 2], SEARCH_PX).iter().flatten();
    let widths = sections.filter_map(|section| Some(section.middle_and_width()?.1));
    let mut widths_px: ArrayVec<f64, LINES> = widths.collect();
    let middle = widths_px.len() / 2;
    (widths_px.len() >= SECTIONS_MIN).then(|| *widths_px.select_nth_unstable_by(middle, f64::total_cmp).1)
}
