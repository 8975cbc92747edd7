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
/// A difference in width is told to about so many pixels, and shadow lies about a radius lower than the wire: that much is
/// needed to believe in a direction.
const NOISE_PX: f64 = 0.5;

/// Adds up what many wires show.
pub struct ShadowSide {
    outlines: Outlines,
    normal: Matrix2<f64>,
    right_side: Vector2<f64>,
}

impl ShadowSide {
    /// With instructions of this level.
    pub fn new(level: Level) -> Self {
        Self { outlines: Outlines::new(level), normal: Matrix2::zeros(), right_side: Vector2::zeros() }
    }

    /// Forgets what was seen.
    pub fn clear(&mut self) {
        (self.normal, self.right_side) = (Matrix2::zeros(), Vector2::zeros());
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
            // By how many pixels what lies a radius lower, and at the same place of the left picture, is farther across in the right one.
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
            let differs_px = right_px - left_px;
            if is_wire(left_px) && is_wire(right_px) && differs_px.abs() < DIFFERS_MAX * silhouette_px {
                self.normal += across * across.transpose() * moves_px.powi(2);
                self.right_side += across * (moves_px * differs_px);
            }
        }
    }

    /// Where shadows fall, along x and y of the left camera: how many radii lower than the wire's outline the shadow's is on the far side of wire
    /// across that direction. Nought where nothing tells.
    pub fn radii(&self) -> Vector2<f64> {
        let inverse = (self.normal + Matrix2::identity() * NOISE_PX.powi(2)).try_inverse();
        inverse.map_or(Vector2::zeros(), |inverse| inverse * self.right_side)
    }
}
