//! Ridges of brightness: where wires lie that the binary picture cannot tell apart.
//!
//! Wires that touch are one region of the mask, and its skeleton runs between them; but each wire is brighter along
//! its middle than at its flanks. Takes the luma and the mask of one picture; gives [`Stretch`]es, the straight pieces of
//! wire that ridges show, followed through what crosses them; owns the filtered rows and the points of the ridges.
//!
//! A pixel is on a ridge where the picture, smoothed by a Gaussian, has its extremum across the direction of least
//! curvature within that pixel, after Steger, "An Unbiased Detector of Curvilinear Structures",
//! doi:10.1109/34.659930, equations (10) to (14). Stretches grow from a point of a ridge both ways as long as further
//! points lie on one line with it; where a neighbour on top hides them, over a gap that is foreground and no longer than
//! what has been seen.
//!
//! ```
//! use pickcell::frame::{Frame, LumaView, PixelFormat};
//! use pickcell::vision::bits::BitImage;
//! use pickcell::vision::ridge::{Area, Params, Ridges};
//!
//! // Two wires side by side, 8 pixels thick each, brightest along their middles: one region of the mask.
//! let (width, height) = (320, 64);
//! let mut bytes = Vec::new();
//! let mut mask = BitImage::new(width, height);
//! for (y, x) in (0..height).flat_map(|y| (20..300).map(move |x| (y, x))) {
//!     let beside = [28.0, 36.0].map(|middle: f64| (y as f64 - middle).abs() / 4.0);
//!     mask.set(x, y, beside.iter().any(|b| *b <= 1.0));
//! }
//! for y in 0..height {
//!     let beside = [28.0, 36.0].map(|middle: f64| (y as f64 - middle).abs() / 4.0);
//!     let light = beside.map(|b| 160.0 * (1.0 - b * b).max(0.0).sqrt());
//!     let row = |x| if (20..300).contains(&x) { (40.0 + light[0].max(light[1])) as u8 } else { 40 };
//!     bytes.extend((0..width).map(row));
//! }
//! let frame = Frame::from_grey(width, height, bytes);
//! let mut everywhere = Area::new(width, height);
//! everywhere.include(width / 2, height / 2, width);
//! let mut ridges = Ridges::new(Params::default(), width, height);
//! ridges.run(LumaView::new(&frame).unwrap(), &mask, &everywhere, false, 4.0, None);
//! let mut rows: Vec<f64> = ridges.stretches().iter().map(|s| s.ends_px[0].y).collect();
//! rows.sort_by(f64::total_cmp);
//! assert_eq!(rows.iter().map(|y| y.round()).collect::<Vec<_>>(), [28.0, 36.0]);
//! let mut few = Ridges::new(Params { stretches_max: 1, ..Params::default() }, width, height);
//! few.run(LumaView::new(&frame).unwrap(), &mask, &everywhere, false, 4.0, None);
//! assert!(few.is_full() && !ridges.is_full());
//! ```

mod area;
mod points;

use nalgebra::{Matrix2, Vector2};

use super::bits::{BitImage, nearest, vector};
use crate::frame::LumaView;
use crate::level::Level;
use crate::time::Timestamp;
use points::{Finder, Point};

pub use area::Area;

/// How ridges are found and followed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params {
    /// Standard deviation of the Gaussian, in half widths of the wire: small, so that the seam between two wires that
    /// touch is not smoothed away.
    pub sigma_half_widths: f64,
    /// Curvature across the ridge times the Gaussian's variance, at least, in grey levels: six standard deviations of
    /// what noise of 3 grey levels makes of it.
    pub strength_min: f32,
    /// How far a point may lie beside the line of its stretch, in pixels: the pixel it is taken from, and its error.
    pub beside_px_max: f64,
    /// Cosine of the angle between the directions of a point and its stretch, at least.
    pub direction_cos_min: f64,
    /// Longest stretch that a neighbour hides, in half widths: a wire of the same width at 20 degrees hides 6.
    pub gap_half_widths_max: f64,
    /// Shortest stretch, in half widths: shorter ones have no direction to speak of.
    pub length_half_widths_min: f64,
    /// Most points of ridges.
    pub points_max: usize,
    /// Most stretches.
    pub stretches_max: usize,
}

impl Default for Params {
    fn default() -> Self {
        Self {
            sigma_half_widths: 0.35,
            strength_min: 3.5,
            beside_px_max: 1.3,
            direction_cos_min: 0.94,
            gap_half_widths_max: 12.0,
            length_half_widths_min: 4.0,
            points_max: 1 << 15,
            stretches_max: 512,
        }
    }
}

/// A straight piece of wire in one picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stretch {
    /// Where it is seen to begin and to end, in pixels.
    pub ends_px: [Vector2<f64>; 2],
    /// Length of it on which the ridge is seen, in pixels.
    pub seen_px: f64,
}

/// Workspace.
#[derive(Clone, Debug)]
pub struct Ridges {
    params: Params,
    width: usize,
    finder: Finder,
    points: Vec<Point>,
    /// Index + 1 of the point of each pixel.
    map: Vec<u32>,
    stretches: Vec<Stretch>,
}

impl Ridges {
    /// Reserves all memory for pictures of this size.
    pub fn new(params: Params, width: usize, height: usize) -> Self {
        Self {
            params,
            width,
            finder: Finder::new(params.strength_min, width, Level::detect()),
            points: Vec::with_capacity(params.points_max),
            map: vec![0; width * height],
            stretches: Vec::with_capacity(params.stretches_max),
        }
    }

    /// The stretches of the last run.
    pub fn stretches(&self) -> &[Stretch] {
        &self.stretches
    }

    /// Whether there was no room for more in the last run, so that some may have been left out.
    pub fn is_full(&self) -> bool {
        self.points.len() == self.params.points_max || self.stretches.len() == self.params.stretches_max
    }

    /// Finds the stretches of wire about `half_width_px` thick to both sides of its middle, within `area`, until `end`.
    /// `dark`: the wire is darker than the floor.
    ///
    /// # Panics
    /// Where the sizes differ from those in [`Ridges::new`].
    pub fn run(
        &mut self,
        luma: LumaView,
        mask: &BitImage,
        area: &Area,
        dark: bool,
        half_width_px: f64,
        end: Option<Timestamp>,
    ) {
        assert_eq!((luma.width(), luma.width() * luma.height()), (self.width, self.map.len()), "size");
        for p in &self.points {
            self.map[pixel_of(p.at, self.width)] = 0;
        }
        self.points.clear();
        self.stretches.clear();
        let sigma = self.params.sigma_half_widths * half_width_px;
        self.finder.run(luma, mask, area, dark, sigma, end, &mut self.points);
        for (p, number) in self.points.iter().zip(1..) {
            self.map[pixel_of(p.at, self.width)] = number;
        }
        for seed in 0..self.points.len() {
            if self.stretches.len() == self.params.stretches_max || end.is_some_and(Timestamp::is_past) {
                return;
            }
            if !self.points[seed].taken
                && let Some(stretch) = self.grow(seed, mask, half_width_px)
            {
                self.stretches.push(stretch);
            }
        }
    }

    fn grow(&mut self, seed: usize, mask: &BitImage, half_width_px: f64) -> Option<Stretch> {
        self.points[seed].taken = true;
        let origin = vector(self.points[seed].at);
        let mut line = Line::new(origin, vector(self.points[seed].along));
        line.add(origin);
        let gap_max = self.params.gap_half_widths_max * half_width_px;
        let mut reached = [0.0f64; 2];
        let mut seen = 1.0;
        for (way, reached) in [1.0, -1.0].into_iter().zip(&mut reached) {
            let (mut at, mut gap) = (0.0, 0.0);
            loop {
                at += way;
                let place = line.origin + line.along * (line.place_of(origin) + at);
                if !mask.get(nearest(place.x), nearest(place.y)) {
                    break;
                }
                match self.point_near(place, &line) {
                    Some(point) => {
                        self.points[point].taken = true;
                        line.add(vector(self.points[point].at));
                        (gap, *reached) = (0.0, at);
                        seen += 1.0;
                    }
                    None => {
                        gap += 1.0;
                        if gap > gap_max.min(seen) {
                            break;
                        }
                    }
                }
            }
        }
        let length = reached[0] - reached[1];
        if length < self.params.length_half_widths_min * half_width_px || 3.0 * seen < length {
            return None;
        }
        let from = line.place_of(origin);
        let at = |t: f64| line.origin + line.along * (from + t);
        Some(Stretch { ends_px: [at(reached[1]), at(reached[0])], seen_px: seen })
    }

    /// A point that nobody has taken, at this place of a line.
    fn point_near(&self, place: Vector2<f64>, line: &Line) -> Option<usize> {
        let across = Vector2::new(-line.along.y, line.along.x);
        [0.0, 1.0, -1.0].into_iter().find_map(|beside| {
            let at = place + across * beside;
            let (x, y) = (usize::try_from(nearest(at.x)).ok()?, usize::try_from(nearest(at.y)).ok()?);
            if x >= self.width {
                return None;
            }
            let index = (*self.map.get(y * self.width + x)?).checked_sub(1)? as usize;
            let point = &self.points[index];
            let off = (vector(point.at) - line.origin).dot(&across);
            let turn = vector(point.along).dot(&line.along);
            (!point.taken
                && off.abs() <= self.params.beside_px_max
                && turn.abs() >= self.params.direction_cos_min)
                .then_some(index)
        })
    }
}

fn pixel_of(at: [f32; 2], width: usize) -> usize {
    (at[1].round() as usize) * width + at[0].round() as usize
}

/// The line through points, in the least-squares sense.
struct Line {
    origin: Vector2<f64>,
    along: Vector2<f64>,
    count: f64,
    sum: Vector2<f64>,
    squares: Matrix2<f64>,
}

/// From this many points on their line is better than the direction of the first.
const LINE_POINTS_MIN: f64 = 8.0;
/// From this many points on a single one hardly moves the line.
const LINE_POINTS_MANY: f64 = 32.0;

impl Line {
    fn new(origin: Vector2<f64>, along: Vector2<f64>) -> Self {
        Self { origin, along, count: 0.0, sum: Vector2::zeros(), squares: Matrix2::zeros() }
    }

    fn add(&mut self, at: Vector2<f64>) {
        self.count += 1.0;
        self.sum += at;
        self.squares += at * at.transpose();
        if self.count < LINE_POINTS_MIN || self.count > LINE_POINTS_MANY && self.count % 4.0 != 0.0 {
            return;
        }
        self.origin = self.sum / self.count;
        let spread = self.squares / self.count - self.origin * self.origin.transpose();
        // The direction in which they are spread most, from the row of the matrix that is longer.
        let (half, mixed) = ((spread.m11 - spread.m22) / 2.0, spread.m12);
        let root = (half * half + mixed * mixed).sqrt();
        let most =
            if half > 0.0 { Vector2::new(root + half, mixed) } else { Vector2::new(mixed, root - half) };
        let Some(along) = most.try_normalize(1e-12) else { return };
        self.along = if along.dot(&self.along) < 0.0 { -along } else { along };
    }

    fn place_of(&self, at: Vector2<f64>) -> f64 {
        (at - self.origin).dot(&self.along)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Frame;

    /// A picture of round wires of 7 pixels diameter, brightest along their middles.
    fn picture(wires: &[[[f64; 2]; 2]]) -> (Frame, BitImage) {
        let (w, h) = (160, 120);
        let mut mask = BitImage::new(w, h);
        let mut bytes = vec![30u8; w * h];
        for y in 0..h {
            for x in 0..w {
                let at = Vector2::new(x as f64, y as f64);
                for [a, b] in wires {
                    let (a, b) = (Vector2::from(*a), Vector2::from(*b));
                    let along = (b - a) / (b - a).norm();
                    let t = (at - a).dot(&along);
                    let off = (at - a).perp(&along).abs() / 3.5;
                    if (0.0..=(b - a).norm()).contains(&t) && off < 1.0 {
                        bytes[y * w + x] =
                            bytes[y * w + x].max(60 + (140.0 * (1.0 - off * off).sqrt()) as u8);
                        mask.set(x, y, true);
                    }
                }
            }
        }
        (Frame::from_grey(w, h, bytes), mask)
    }

    fn stretches(wires: &[[[f64; 2]; 2]]) -> Vec<Stretch> {
        let (frame, mask) = picture(wires);
        let mut ridges = Ridges::new(Params::default(), frame.width, frame.height);
        ridges.run(LumaView::new(&frame).unwrap(), &mask, &whole(), false, 3.5, None);
        ridges.stretches().to_vec()
    }

    fn whole() -> Area {
        let mut area = Area::new(160, 120);
        area.include(80, 60, 80);
        area
    }

    fn shows(stretch: &Stretch, wire: &[[f64; 2]; 2]) -> bool {
        let [a, b] = wire.map(Vector2::from);
        let off = |p: Vector2<f64>| (p - a).perp(&(b - a)).abs() / (b - a).norm();
        let [from, to] = stretch.ends_px;
        off(from) < 0.5 && off(to) < 0.5 && (to - from).norm() > (b - a).norm() - 8.0
    }

    #[test]
    fn wires_that_touch_are_told_apart() {
        let wires = [[[20.0, 40.0], [140.0, 52.0]], [[20.0, 47.5], [140.0, 59.5]]];
        let found = stretches(&wires);
        assert!(wires.iter().all(|w| found.iter().any(|s| shows(s, w))), "{found:?}");
    }

    #[test]
    fn a_wire_is_followed_under_one_that_crosses_it() {
        let wires = [[[20.0, 60.0], [140.0, 60.0]], [[60.0, 10.0], [90.0, 110.0]]];
        let found = stretches(&wires);
        assert!(wires.iter().all(|w| found.iter().any(|s| shows(s, w))), "{found:?}");
    }

    #[test]
    fn nothing_is_found_outside_the_area() {
        let (frame, mask) = picture(&[[[20.0, 60.0], [140.0, 60.0]]]);
        let mut ridges = Ridges::new(Params::default(), frame.width, frame.height);
        let luma = LumaView::new(&frame).unwrap();
        let mut area = Area::new(frame.width, frame.height);
        area.include(90, 60, 10);
        ridges.run(luma, &mask, &area, false, 3.5, None);
        let [from, to] = ridges.stretches()[0].ends_px;
        assert!(from.x > 79.0 && to.x < 101.0 && (to.x - from.x) > 18.0, "{from} {to}");
        area.clear();
        area.include(90, 100, 10);
        ridges.run(luma, &mask, &area, false, 3.5, None);
        assert!(ridges.stretches().is_empty());
    }

    #[test]
    fn bare_floor_has_none_and_a_second_run_forgets_the_first() {
        let (frame, mask) = picture(&[[[20.0, 60.0], [140.0, 60.0]]]);
        let luma = LumaView::new(&frame).unwrap();
        let mut ridges = Ridges::new(Params::default(), frame.width, frame.height);
        ridges.run(luma, &mask, &whole(), false, 3.5, None);
        let first = ridges.stretches().to_vec();
        assert!(!first.is_empty());
        ridges.run(luma, &BitImage::new(frame.width, frame.height), &whole(), false, 3.5, None);
        assert!(ridges.stretches().is_empty());
        ridges.run(luma, &mask, &whole(), false, 3.5, Some(Timestamp(0)));
        assert!(ridges.stretches().is_empty(), "time is over");
        ridges.run(luma, &mask, &whole(), false, 3.5, None);
        assert_eq!(ridges.stretches(), first);
    }
}
