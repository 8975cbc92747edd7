//! On which side of dark wire its shadow lies.
//!
//! Shadow as dark as the wire makes it look wider, and no brightness tells which of its outlines is the shadow's. But shadow lies
//! lower than the wire, and so the camera on its side sees more of it than the other: the two see the wire differently wide, by
//! what the disparity differs. And wire that lies across the direction in which shadows fall looks wider than wire along it.
//! One wire shows that with the noise of its outlines and with neighbours beside it; all wires of a bin together show the direction.
//!
//! ```
//! use nalgebra::{Isometry3, Vector3};
//! use pickcell::level::Level;
//! use pickcell::part::Part;
//! use pickcell::pose::drawn::DrawnPair;
//! use pickcell::pose::model::PoseModel;
//! use pickcell::pose::shadow::ShadowSide;
//!
//! let rod = PoseModel::new(&Part::read(concat!(env!("CARGO_MANIFEST_DIR"), "/replay/parts/rod-90.toml"))?);
//! let rods = [0.4, 1.0, 1.6, 2.2, 2.8].map(|turn| {
//!     Isometry3::new(Vector3::new(90.0 * (turn - 1.6), 0.0, 470.0), Vector3::new(0.0, 0.0, turn))
//! });
//! // Of each rod something as dark as itself can be seen 2 mm to the right of it and 3 mm lower.
//! let shadows = rods.map(|rod| Isometry3::translation(2.0, 0.0, 3.0) * rod);
//! let drawn: Vec<_> = rods.iter().chain(&shadows).map(|pose| (&rod, *pose)).collect();
//! let drawn = DrawnPair::new(&drawn);
//! let mut side = ShadowSide::new(Level::detect());
//! rods.iter().for_each(|pose| side.look_at(&rod, pose, &drawn.views()));
//! let falls = side.falls().unwrap();
//! assert!(falls.x > 0.8, "{falls}");
//! # Ok::<(), pickcell::part::PartError>(())
//! ```

use arrayvec::ArrayVec;
use nalgebra::{Isometry3, Matrix2, Vector2};

use super::aim::aim;
use super::model::PoseModel;
use super::outlines::{LINES, Outlines};
use super::refine::View;
use crate::level::Level;

/// How far from where a wire is expected its outlines are looked for, in pixels.
const SEARCH_PX: f64 = 1.5;
/// How wide wire with its shadow is seen, over the wire's silhouette, and by how much of that differently at most: beyond, it is
/// something else.
const WIDTHS: [f64; 2] = [0.6, 2.6];
const DIFFERS_MAX: f64 = 0.35;
/// What differs by so many pixels in width from picture to picture, or by so many widths from what is expected, is half believed.
const NOISE_PX: f64 = 0.25;
const NOISE_WIDTHS: f64 = 0.25;
/// How many widths wider wire looks for each radius that its shadow's outline lies lower than its own, and at most.
const WIDTHS_PER_RADIUS: f64 = 0.9;
const WIDER_WIDTHS_MAX: f64 = 0.9;
/// Wire without shadow is about as wide as this share of what is seen is not.
const BARE_SHARE: f64 = 0.15;
/// But no wider than this over its silhouette, where all wire has its shadow beside it.
const BARE_MAX: f64 = 1.0;
/// Directions that are tried, all around, and how much lower shadows may lie, in radii.
const DIRECTIONS: usize = 36;
const LOWER_RADII: [f64; 3] = [0.3, 0.6, 1.0];
/// By how much a direction must explain a place better than no shadow does, in the mean, where 1 is all there is to explain of one
/// cue; and how much of the places' squared directions must lie across a wire for that to be told.
const LIKER_MIN: f64 = 0.02;
const TOLD_MIN: f64 = 0.1;
/// Places that are collected, and that are asked.
const PLACES_MAX: usize = 2048;
const ASKED_MAX: usize = 256;

/// Collects what many wires show.
pub struct ShadowSide {
    outlines: Outlines,
    places: Vec<Place>,
    widths: Vec<f64>,
}

/// What both pictures show at one place of a wire.
struct Place {
    /// Unit vector across it in the left picture.
    across: Vector2<f64>,
    /// By how many pixels what lies a radius lower, and at the same place of the left picture, is farther across in the right one.
    moves_px: f64,
    /// How much wider the right one shows it, in pixels.
    wider_px: f64,
    /// How wide both show it in the mean, over the wire's silhouette.
    widths: f64,
}

impl ShadowSide {
    /// With instructions of this level.
    pub fn new(level: Level) -> Self {
        Self {
            outlines: Outlines::new(level),
            places: Vec::with_capacity(PLACES_MAX),
            widths: Vec::with_capacity(ASKED_MAX),
        }
    }

    /// Forgets what was seen.
    pub fn clear(&mut self) {
        self.places.clear();
    }

    /// Adds what is seen of a part in about this pose.
    pub fn look_at(&mut self, model: &PoseModel, left_from_part: &Isometry3<f64>, views: &[View; 2]) {
        let bare = views.each_ref().map(|view| view.profiler.with_shadow(None));
        let mut signs = [(Vector2::zeros(), 0.0, [0.0; 2]); LINES / 2];
        let mut count = 0;
        self.outlines.clear();
        let stations = || model.stations.iter().filter(|station| !station.at_joint);
        for station in stations().step_by(stations().count().div_ceil(signs.len()).max(1)) {
            let point = left_from_part * station.position_mm;
            let tangent = left_from_part * station.tangent;
            let [left, right] = views.each_ref().map(|view| aim(model.radius_mm, &point, &tangent, view));
            let (Some(left), Some(right)) = (left, right) else { continue };
            let lower = point.coords.normalize() * model.radius_mm;
            let moves_px = (right.jacobian * lower).dot(&right.across);
            signs[count] = (left.across, moves_px, [left.half_width_px, right.half_width_px]);
            count += 1;
            for (side, aim) in [left, right].iter().enumerate() {
                self.outlines.push(side, aim.px, aim.across, aim.half_width_px);
            }
        }
        let sections = self.outlines.sections(bare.each_ref(), SEARCH_PX);
        let widths_px = sections.iter().map(|section| Some(section.as_ref()?.middle_and_width()?.1));
        let widths_px: ArrayVec<Option<f64>, LINES> = widths_px.collect();
        for ((across, moves_px, half_width_px), widths_px) in signs.iter().zip(widths_px.chunks_exact(2)) {
            let (Some(left_px), Some(right_px)) = (widths_px[0], widths_px[1]) else { continue };
            let [left, right] = [left_px / (2.0 * half_width_px[0]), right_px / (2.0 * half_width_px[1])];
            let is_wire = |widths: f64| (WIDTHS[0]..WIDTHS[1]).contains(&widths);
            if is_wire(left)
                && is_wire(right)
                && (right - left).abs() < DIFFERS_MAX
                && self.places.len() < PLACES_MAX
            {
                let wider_px = (right - left) * 2.0 * half_width_px[1];
                let widths = f64::midpoint(left, right);
                self.places.push(Place { across: *across, moves_px: *moves_px, wider_px, widths });
            }
        }
    }

    /// The direction in which shadows fall, along x and y of the left camera, at most 1 long: less where the wires tell it only
    /// across themselves, as parallel ones do. `None` where nothing tells.
    pub fn falls(&mut self) -> Option<Vector2<f64>> {
        let Self { places, widths, .. } = self;
        let asked = || places.iter().step_by(places.len().div_ceil(ASKED_MAX).max(1));
        widths.clear();
        widths.extend(asked().map(|place| place.widths));
        if widths.is_empty() {
            return None;
        }
        let count = widths.len() as f64;
        let bare = (BARE_SHARE * count) as usize;
        let bare = widths.select_nth_unstable_by(bare, f64::total_cmp).1.min(BARE_MAX);
        let unlike = |radii: &Vector2<f64>| -> f64 {
            let of_place = |place: &Place| {
                let lower = place.across.dot(radii);
                // What is much wider in one picture is so for a neighbour, or for a shadow far below; that tells no more.
                let wider_px = place.wider_px.min(place.moves_px.abs()).max(-place.moves_px.abs());
                let wider = (place.widths - bare).clamp(0.0, WIDER_WIDTHS_MAX);
                doubt((wider_px - place.moves_px * lower) / NOISE_PX)
                    + doubt((wider - WIDTHS_PER_RADIUS * lower.abs()) / NOISE_WIDTHS)
            };
            asked().map(of_place).sum()
        };
        let directions = (0..DIRECTIONS).map(|k| {
            let (sin, cos) = (std::f64::consts::TAU * k as f64 / DIRECTIONS as f64).sin_cos();
            Vector2::new(cos, sin)
        });
        let with = |falls: Vector2<f64>| {
            LOWER_RADII.map(|radii| unlike(&(radii * falls))).into_iter().fold(f64::INFINITY, f64::min)
        };
        let best = directions.map(|falls| (falls, with(falls))).min_by(|a, b| a.1.total_cmp(&b.1));
        let most = unlike(&Vector2::zeros()) - LIKER_MIN * count;
        let (falls, _) = best.filter(|(_, unlike_with)| *unlike_with < most)?;
        let told = asked().map(|place| place.across * place.across.transpose()).sum::<Matrix2<f64>>();
        let told = (told / count).symmetric_eigen();
        let along = |k: usize| {
            let axis = told.eigenvectors.column(k);
            axis * (axis.dot(&falls) * (told.eigenvalues[k] / TOLD_MIN).min(1.0))
        };
        Some(along(0) + along(1))
    }
}

/// What is far off counts as 1, however far.
fn doubt(off: f64) -> f64 {
    off * off / (1.0 + off * off)
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};

    use super::*;

    fn place(angle: f64, wider_radii: f64) -> Place {
        let across = Vector2::new(angle.cos(), angle.sin());
        let moves_px = 0.55 * across.x;
        let widths = 1.0 + WIDTHS_PER_RADIUS * wider_radii.abs();
        Place { across, moves_px, wider_px: wider_radii * moves_px, widths }
    }

    #[test]
    fn most_wires_tell_where_shadows_fall_and_neighbours_do_not() {
        let mut side = ShadowSide::new(Level::Plain);
        assert_eq!(side.falls(), None);
        let truth = Vector2::new(-0.6, 0.8);
        let wires = |lower_radii: f64| {
            (0..12).map(|k| 0.5 * f64::from(k)).flat_map(move |angle| {
                let lower = lower_radii * Vector2::new(angle.cos(), angle.sin()).dot(&truth);
                (0..10).map(move |_| place(angle, lower))
            })
        };
        side.places.extend(wires(0.8));
        let found = side.falls().unwrap();
        assert!(found.angle(&truth).to_degrees() < 10.0, "{found}");
        // Of two rods the other picture shows more of a neighbour.
        side.places.extend((0..20).map(|k| place(0.3 * f64::from(k % 2), 4.0)));
        let found = side.falls().unwrap();
        assert!(found.angle(&truth).to_degrees() < 20.0, "{found}");
        side.clear();
        side.places.extend(wires(0.0));
        assert_eq!(side.falls(), None);
    }

    #[test]
    fn one_wire_tells_nothing_along_itself() {
        let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(3);
        for lower_radii in [0.0, 0.9] {
            let mut side = ShadowSide::new(Level::Plain);
            for k in 0..24 {
                let angle = 0.25 * f64::from(k);
                side.clear();
                side.places.extend((0..16).map(|_| {
                    let mut place = place(angle, lower_radii);
                    place.widths += random.random_range(-0.05..0.05);
                    place.wider_px += random.random_range(-0.1..0.1);
                    place
                }));
                let along = Vector2::new(-angle.sin(), angle.cos());
                assert!(side.falls().is_none_or(|falls| falls.dot(&along).abs() < 0.1), "{lower_radii} {k}");
            }
        }
    }
}
