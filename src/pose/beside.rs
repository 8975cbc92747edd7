//! Places on a part's wire and on the floor beside it, see [`vision::beside`](crate::vision::beside).
//!
//! ```
//! use nalgebra::{Isometry3, Vector3};
//! use pickcell::part::Part;
//! use pickcell::pose::beside::along_part;
//! use pickcell::pose::drawn::DrawnPair;
//! use pickcell::pose::model::PoseModel;
//!
//! let rod = PoseModel::new(&Part::read(concat!(env!("CARGO_MANIFEST_DIR"), "/replay/parts/rod-90.toml"))?);
//! let pose = Isometry3::new(Vector3::new(20.0, -10.0, 470.0), Vector3::z() * 0.9);
//! let drawn = DrawnPair::new(&[(&rod, pose)]);
//! let [left, _] = drawn.views();
//! assert!(along_part(&rod, &pose, &left).count() > 5);
//! for place in along_part(&rod, &pose, &left) {
//!     let is_object = |px: nalgebra::Vector2<f64>| left.mask.get(px.x.round() as i32, px.y.round() as i32);
//!     assert!(place.wire_px.into_iter().all(is_object) && !is_object(place.floor_px));
//! }
//! # Ok::<(), pickcell::part::PartError>(())
//! ```

use nalgebra::{Isometry3, Vector2};

use super::aim::aim;
use super::model::PoseModel;
use super::refine::View;
use crate::vision::beside::{BESIDE_PX, Beside, INSIDE};
use crate::vision::bits::nearest;

/// Stations that are asked, about.
const STATIONS: usize = 5;

/// By how many grey levels wire is brighter than the floor beside it; the bright line of glossy dark wire is not asked.
pub fn contrast(place: &Beside, view: &View) -> f64 {
    // What lies outside takes the border's.
    let at = |px: f64| nearest(px).max(0) as usize;
    let luma = |px: Vector2<f64>| view.profiler.luma.at(at(px.x), at(px.y));
    let mut wire = place.wire_px.map(luma);
    wire.sort_unstable();
    f64::from(wire[1]) - f64::from(luma(place.floor_px))
}

/// Places along a part in about this pose where the binary picture shows its wire, on either side of it where it shows none.
pub fn along_part<'a>(
    model: &'a PoseModel,
    left_from_part: &'a Isometry3<f64>,
    view: &'a View,
) -> impl Iterator<Item = Beside> + 'a {
    let is_object = move |px: &Vector2<f64>| view.mask.get(nearest(px.x), nearest(px.y));
    let stations = || model.stations.iter().filter(|station| !station.at_joint);
    let places = stations().step_by((stations().count() / STATIONS).max(1)).filter_map(move |station| {
        let (point, tangent) = (left_from_part * station.position_mm, left_from_part * station.tangent);
        let aim = aim(model.radius_mm, &point, &tangent, view)?;
        let at = |px: f64| aim.px + aim.across * px;
        let wire_px = INSIDE.map(|share| at(share * aim.half_width_px));
        let sides = [-1.0, 1.0].map(|side| at(side * (aim.half_width_px + BESIDE_PX)));
        wire_px.iter().all(is_object).then_some((wire_px, sides))
    });
    places.flat_map(move |(wire_px, sides)| {
        let floors = sides.into_iter().filter(move |px| !is_object(px));
        floors.map(move |floor_px| Beside { wire_px, floor_px })
    })
}
