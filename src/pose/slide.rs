//! Where along its wire a straight part lies that shows no end.
//!
//! Nothing holds such a part along itself but what is seen of its wire: it lies where there is wire, and not where wire
//! of its width is seen to go on beyond it. Where a neighbour hides both of its ends, that leaves some places; it most
//! likely lies in their middle.
//!
//! ```
//! use nalgebra::{Isometry3, Vector3};
//! use pickcell::part::Part;
//! use pickcell::pose::drawn::DrawnPair;
//! use pickcell::pose::model::PoseModel;
//! use pickcell::pose::refine::{Params, Refine};
//! use pickcell::pose::slide::to_middle;
//!
//! let model = PoseModel::new(&Part::read(concat!(env!("CARGO_MANIFEST_DIR"), "/replay/parts/rod-90.toml"))?);
//! let truth = Isometry3::new(Vector3::new(20.0, -10.0, 470.0), Vector3::z() * 0.9);
//! let drawn = DrawnPair::new(&[(&model, truth)]);
//! let refine = Refine::new(Params { lift_radii: 0.0, ..Params::default() }, &drawn.rig);
//!
//! // On the wire, but 9 mm too far along it.
//! let along = truth.rotation * model.straight_along.unwrap();
//! let mut slid = truth;
//! slid.translation.vector += along * 9.0;
//! let back = to_middle(&refine, &model, &slid, &drawn.views()).unwrap();
//! assert!((back.translation.vector - truth.translation.vector).norm() < 1.5);
//! assert_eq!(to_middle(&refine, &model, &back, &drawn.views()), None);
//! # Ok::<(), pickcell::part::PartError>(())
//! ```

use arrayvec::ArrayVec;
use nalgebra::{Isometry3, Translation3};

use super::model::PoseModel;
use super::refine::{Refine, View};
use super::verify::{Sight, sight_of};

/// Places that are looked at for each thickness of wire.
const PLACES_A_THICKNESS: f64 = 2.0;
/// Most places on the part: on longer wire they lie farther apart.
const PLACES_MAX: usize = 512;
/// How far a part may be displaced, in places, each way: five thicknesses, if the places lie as near.
const REACH: usize = 10;
/// Places of the part that are as good as the best, to this much of one picture's place of wire with both outlines.
const AS_GOOD: f64 = 0.25;

/// What it says for a part that a place lies on it rather than beyond it. Of 77 parts in rendered heaps that show no end,
/// anything near these ratios leaves half as many more than two thicknesses off as none would.
fn gain(sight: Sight) -> f64 {
    match sight {
        Sight::Clear => 3.0,
        Sight::OneSide => 2.0,
        Sight::Crossed | Sight::Outside => 0.0,
        Sight::Missing => -5.0,
    }
}

/// The pose of a straight part, displaced along itself to the middle of the places nearest to it where the wire is that both
/// pictures show (left camera's frame). `None` where it lies there, and of parts that are not straight.
pub fn to_middle(
    refine: &Refine,
    model: &PoseModel,
    pose: &Isometry3<f64>,
    views: &[View; 2],
) -> Option<Isometry3<f64>> {
    let along = model.straight_along?;
    let step_mm = (2.0 * model.radius_mm / PLACES_A_THICKNESS).max(model.length_mm / PLACES_MAX as f64);
    let inside = (model.length_mm / step_mm).round() as usize;
    let count = inside + 2 * REACH;
    let (along, centre) = (pose.rotation * along, pose * model.centre_mm);
    let at = |place: f64| centre + along * ((place - (count as f64 - 1.0) / 2.0) * step_mm);
    // Sums of what all places before one say.
    let mut sums: ArrayVec<f64, { PLACES_MAX + 2 * REACH + 1 }> = ArrayVec::new();
    let mut sum = 0.0;
    sums.push(sum);
    for place in 0..count {
        for view in views {
            let seen = refine.look_beyond(model.radius_mm, &at(place as f64), &along, view);
            sum += seen.map_or(0.0, |sighting| gain(sight_of(&sighting).0));
        }
        sums.push(sum);
    }
    let worth = |first: usize| sums[first + inside] - sums[first];
    let best = (0..=2 * REACH).map(worth).fold(f64::NEG_INFINITY, f64::max);
    let as_good = |first: &usize| worth(*first) >= best - AS_GOOD * gain(Sight::Clear);
    let nearest = (0..=2 * REACH).filter(as_good).min_by_key(|first| first.abs_diff(REACH))?;
    let first = (0..=nearest).rev().take_while(as_good).last()?;
    let last = (nearest..=2 * REACH).take_while(as_good).last()?;
    let displaced = (first + last) as f64 / 2.0 - REACH as f64;
    (displaced != 0.0).then(|| Translation3::from(along * (displaced * step_mm)) * pose)
}
