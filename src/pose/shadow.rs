//! On which side of dark wire its shadow lies.
//!
//! Shadow as dark as the wire makes it look wider, and no brightness tells which of its outlines is the shadow's. But shadow lies
//! lower than the wire, and so the camera on its side sees more of it than the other: the two see the wire differently wide, by
//! what the disparity differs. One wire shows that with the noise of its outlines, all wires of a bin together show
//! the direction in which shadows fall.
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
//! let found = side.radii();
//! assert!(found.x > 0.3 && found.y.abs() < 0.5 * found.x, "{found}");
//! # Ok::<(), pickcell::part::PartError>(())
//! ```

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
/// To how many pixels a difference in width is told. As shadow lies about a radius lower than the wire, as much as so many pixels for
/// each radius is needed to believe in a direction.
const NOISE_PX: f64 = 0.25;
/// How often those that differ from what most say are believed less.
const ROUNDS: usize = 8;
/// Places that there is room for.
const PLACES_MAX: usize = 1024;

/// Collects what many wires show.
pub struct ShadowSide {
    outlines: Outlines,
    places: Vec<Place>,
}

/// What both pictures show at one place of a wire.
struct Place {
    /// Unit vector across it in the left picture.
    across: Vector2<f64>,
    /// By how many pixels what lies a radius lower, and at the same place of the left picture, is farther across in the right one.
    moves_px: f64,
    /// How much wider the right one shows it, in pixels.
    wider_px: f64,
}

impl ShadowSide {
    /// With instructions of this level.
    pub fn new(level: Level) -> Self {
        Self { outlines: Outlines::new(level), places: Vec::with_capacity(PLACES_MAX) }
    }

    /// Forgets what was seen.
    pub fn clear(&mut self) {
        self.places.clear();
    }

    /// Adds what is seen of a part in about this pose.
    pub fn look_at(&mut self, model: &PoseModel, left_from_part: &Isometry3<f64>, views: &[View; 2]) {
        let bare = views.each_ref().map(|view| view.profiler.with_shadow(None));
        let mut signs = [(Vector2::zeros(), 0.0, 0.0); LINES / 2];
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
            signs[count] = (left.across, moves_px, left.half_width_px);
            count += 1;
            for (side, aim) in [left, right].iter().enumerate() {
                self.outlines.push(side, aim.px, aim.across, aim.half_width_px);
            }
        }
        let sections = self.outlines.sections(bare.each_ref(), SEARCH_PX);
        let widths_px = sections.iter().map(|section| Some(section.as_ref()?.middle_and_width()?.1));
        let widths_px: arrayvec::ArrayVec<Option<f64>, LINES> = widths_px.collect();
        for ((across, moves_px, half_width_px), widths_px) in signs.iter().zip(widths_px.chunks_exact(2)) {
            let (Some(left_px), Some(right_px)) = (widths_px[0], widths_px[1]) else { continue };
            let silhouette_px = 2.0 * half_width_px;
            let is_wire = |px: f64| (WIDTHS[0]..WIDTHS[1]).contains(&(px / silhouette_px));
            let wider_px = right_px - left_px;
            if is_wire(left_px)
                && is_wire(right_px)
                && wider_px.abs() < DIFFERS_MAX * silhouette_px
                && self.places.len() < PLACES_MAX
            {
                self.places.push(Place { across: *across, moves_px: *moves_px, wider_px });
            }
        }
    }

    /// Where shadows fall, along x and y of the left camera: how many radii lower than the wire's outline the shadow's is on the far side of wire
    /// across that direction. Nought where nothing tells.
    pub fn radii(&self) -> Vector2<f64> {
        let mut radii = Vector2::zeros();
        for round in 0..=ROUNDS {
            let (mut normal, mut right_side) = (Matrix2::identity() * NOISE_PX.powi(2), Vector2::zeros());
            for Place { across, moves_px, wider_px } in &self.places {
                // What is much wider in one picture is so for a neighbour, or for a shadow far below; that tells no more.
                let wider_px = wider_px.clamp(-moves_px.abs(), moves_px.abs());
                let odd = (wider_px - moves_px * across.dot(&radii)) / NOISE_PX;
                let belief = if round == 0 { 1.0 } else { (1.0 + odd * odd).powi(-2) };
                normal += across * across.transpose() * (belief * moves_px.powi(2));
                right_side += across * (belief * moves_px * wider_px);
            }
            radii = normal.try_inverse().map_or(Vector2::zeros(), |inverse| inverse * right_side);
        }
        radii
    }
}
