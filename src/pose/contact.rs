//! Wires that cross do not go through each other.
//!
//! Takes poses of two parts with their covariances; where their wires cross, seen from above, heights and pictures together
//! tell which lies on top, and their axes are nearer to each other than the radii allow, moves both into contact, which is how parts lie on
//! each other: as the state of a Kalman filter follows a measurement that the gap between them is nought. The pose that is
//! known less moves more.
//!
//! ```
//! use nalgebra::{Isometry3, Matrix6, Vector3, Vector6};
//! use pickcell::part::Part;
//! use pickcell::pose::contact::{Placed, press_apart};
//! use pickcell::pose::model::PoseModel;
//!
//! let rod = Part::read(concat!(env!("CARGO_MANIFEST_DIR"), "/replay/parts/rod-90.toml"))?; // 3 mm thick
//! let model = PoseModel::new(&rod);
//! // Their axes cross 0.2 mm apart; the upper one is known to a millimetre, the lower one to a tenth.
//! let lying = |yaw, depth_mm| Isometry3::new(Vector3::z() * depth_mm, Vector3::z() * yaw);
//! let mut poses = [lying(0.0, 499.8), lying(1.2, 500.0)];
//! let known = |mm: f64| Matrix6::from_diagonal(&Vector6::new(mm * mm, mm * mm, mm * mm, 3e-5, 3e-5, 3e-5));
//! let mut covariances = [known(1.0), known(0.1)];
//!
//! let ([upper, lower], [upper_known, lower_known]) = (&mut poses, &mut covariances);
//! let mut upper = Placed { model: &model, left_from_part: upper, covariance: upper_known };
//! let mut lower = Placed { model: &model, left_from_part: lower, covariance: lower_known };
//! press_apart(&mut upper, &mut lower, &Vector3::z(), |_, _| Some(true));
//!
//! // A thickness apart now; what was known less has moved, and is known better.
//! let [upper, lower] = poses.map(|pose| pose.translation.z);
//! assert!((upper - 497.0).abs() < 0.2 && (lower - 500.0).abs() < 0.1);
//! assert!(covariances[0][(2, 2)].sqrt() < 0.3);
//! # Ok::<(), pickcell::part::PartError>(())
//! ```

use nalgebra::{Isometry3, Matrix3, Matrix6, Point3, Vector3, Vector6};

use super::model::PoseModel;
use super::refine::moved;

/// Sine of the angle between wires below which they lie beside each other rather than cross.
const CROSSING_SIN_MIN: f64 = 0.17;
/// Logarithm of the odds at which the heights alone say which wire lies on top; what the pictures add to it, which are right
/// about 13 times in 14 where the heights leave doubt; and the odds under which nobody knows.
const SURE_ODDS: f64 = 5.0;
const PICTURE_ODDS: f64 = 2.5;
const ODDS_MIN: f64 = 1.0;
/// A distance that is wrong by more of them is due to a pose that is wrong altogether.
const WRONG_SIGMAS: f64 = 4.0;
/// Standard deviation of a wire's radius and straightness, in radii.
const SLACK_RADII: f64 = 0.1;

/// A part at a pose.
pub struct Placed<'a> {
    /// Its shape.
    pub model: &'a PoseModel,
    /// From its frame to the left camera's.
    pub left_from_part: &'a mut Isometry3<f64>,
    /// Of a small displacement (mm) and rotation (radians) about [`PoseModel::centre_mm`], left camera's axes.
    pub covariance: &'a mut Matrix6<f64>,
}

/// Where a straight piece of wire passes another, in the left camera's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Passing {
    /// A point of its axis.
    pub at_mm: Point3<f64>,
    /// Unit direction of its axis.
    pub along: Vector3<f64>,
    /// Radius of the wire.
    pub radius_mm: f64,
    /// How far from there the nearer end of the piece is.
    pub to_end_mm: f64,
}

/// Moves two parts out of each other, and their covariances to what is known then. `down`: unit vector in the left
/// camera's frame. `is_over` says whether the first of two wires lies over the second, `None` if that cannot be told; it is
/// asked where the poses do not tell.
pub fn press_apart(
    a: &mut Placed,
    b: &mut Placed,
    down: &Vector3<f64>,
    mut is_over: impl FnMut(&Passing, &Passing) -> Option<bool>,
) {
    let centre = |p: &Placed| *p.left_from_part * p.model.centre_mm;
    if (centre(a) - centre(b)).norm() > (a.model.length_mm + b.model.length_mm) / 2.0 {
        return;
    }
    for one in 0..a.model.straight_mm.len() {
        for other in 0..b.model.straight_mm.len() {
            let piece = |p: &Placed, k: usize| p.model.straight_mm[k].map(|end| *p.left_from_part * end);
            let Some([at_a, at_b]) = crossing(piece(a, one), piece(b, other), down) else { continue };
            let passing = |p: &Placed, k: usize, at_mm: Point3<f64>| {
                let [from, to] = piece(p, k);
                let to_end_mm = (at_mm - from).norm().min((at_mm - to).norm());
                Passing { at_mm, along: (to - from).normalize(), radius_mm: p.model.radius_mm, to_end_mm }
            };
            let (of_a, of_b) = (passing(a, one, at_a), passing(b, other, at_b));
            press(a, b, &of_a, &of_b, down, &mut is_over);
        }
    }
}

/// Where two straight pieces cross, seen along `down`: the points of both axes; `None` where they do not, or not at enough
/// of an angle.
fn crossing(a: [Point3<f64>; 2], b: [Point3<f64>; 2], down: &Vector3<f64>) -> Option<[Point3<f64>; 2]> {
    let (u, v) = (a[1] - a[0], b[1] - b[0]);
    if u.cross(&v).norm() < CROSSING_SIN_MIN * u.norm() * v.norm() {
        return None;
    }
    let shares = Matrix3::from_columns(&[u, -v, -down]).try_inverse()? * (b[0] - a[0]);
    let inside = |share: f64| (0.0..=1.0).contains(&share);
    (inside(shares.x) && inside(shares.y)).then(|| [a[0] + u * shares.x, b[0] + v * shares.y])
}

/// Whether two parts at these poses (from their frames to the left camera's) lie lengthwise in each other, as no wires do:
/// further than both are thick along each other, with less than half of what radii allow between their axes.
pub fn overlap(a: (&PoseModel, &Isometry3<f64>), b: (&PoseModel, &Isometry3<f64>)) -> bool {
    let radii_mm = a.0.radius_mm + b.0.radius_mm;
    let piece = |pose: &Isometry3<f64>, piece: &[Point3<f64>; 2]| piece.map(|end| pose * end);
    a.0.straight_mm.iter().any(|of_a| {
        let [from, to] = piece(a.1, of_a);
        let length_mm = (to - from).norm();
        let along = (to - from) / length_mm;
        b.0.straight_mm.iter().any(|of_b| {
            let [start, end] = piece(b.1, of_b);
            let other = (end - start).normalize();
            let reach_mm = [start, end].map(|point| (point - from).dot(&along).clamp(0.0, length_mm));
            let is_beside = |at_mm: f64| {
                let away = from + along * at_mm - start;
                (away - other * away.dot(&other)).norm() < radii_mm / 2.0
            };
            along.cross(&other).norm() < CROSSING_SIN_MIN
                && (reach_mm[0] - reach_mm[1]).abs() > 2.0 * radii_mm
                && reach_mm.into_iter().all(is_beside)
        })
    })
}

fn press(
    a: &mut Placed,
    b: &mut Placed,
    of_a: &Passing,
    of_b: &Passing,
    down: &Vector3<f64>,
    is_over: &mut impl FnMut(&Passing, &Passing) -> Option<bool>,
) {
    let normal = of_a.along.cross(&of_b.along).normalize();
    let up = if normal.dot(down) < 0.0 { normal } else { -normal };
    // How the distance of the axes grows with displacement and rotation of a part.
    let gradient = |p: &Placed, at: &Point3<f64>| -> Vector6<f64> {
        let turn = (at - *p.left_from_part * p.model.centre_mm).cross(&up);
        Vector6::new(up.x, up.y, up.z, turn.x, turn.y, turn.z)
    };
    let (by_a, by_b) = (gradient(a, &of_a.at_mm), -gradient(b, &of_b.at_mm));
    let slack_mm = SLACK_RADII * of_a.radius_mm.hypot(of_b.radius_mm);
    let [var_a, var_b] = [(&*a, &by_a), (&*b, &by_b)].map(|(p, by)| by.dot(&(*p.covariance * by)));
    let variance = var_a + var_b + slack_mm * slack_mm;
    let sigma_mm = variance.sqrt();
    let apart_mm = up.dot(&(of_a.at_mm - of_b.at_mm));
    // Wires that touch are a sum of radii apart, this way round or that.
    let touching_mm = of_a.radius_mm + of_b.radius_mm;
    let mut odds = 2.0 * apart_mm * touching_mm / variance;
    if odds.abs() < SURE_ODDS {
        odds += is_over(of_a, of_b).map_or(0.0, |over| if over { PICTURE_ODDS } else { -PICTURE_ODDS });
    }
    if odds.abs() < ODDS_MIN {
        return;
    }
    let sign = if odds > 0.0 { 1.0 } else { -1.0 };
    let gap_mm = sign * apart_mm - touching_mm;
    // What is not finite is left, too.
    if !(-WRONG_SIGMAS * sigma_mm..0.0).contains(&gap_mm) {
        return;
    }
    follow(a, &(by_a * sign), gap_mm, variance, variance - var_a);
    follow(b, &(by_b * sign), gap_mm, variance, variance - var_b);
}

/// Moves a part by its share of closing a gap that grows by `gradient` and is `gap_mm`, with this variance, of which
/// `others` is not its own.
fn follow(p: &mut Placed, gradient: &Vector6<f64>, gap_mm: f64, variance: f64, others: f64) {
    let mut gain = *p.covariance * gradient / variance;
    if let Some(along) = p.model.straight_along {
        // Where no end is seen anything would slide a wire along itself; this does not.
        let along = *p.left_from_part * along;
        let mut shift = gain.fixed_rows_mut::<3>(0);
        let slide = along.dot(&shift);
        shift -= along * slide;
    }
    let kept = Matrix6::identity() - gain * gradient.transpose();
    *p.covariance = kept * *p.covariance * kept.transpose() + gain * gain.transpose() * others;
    *p.left_from_part = moved(p.left_from_part, &p.model.centre_mm, &(gain * -gap_mm));
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use nalgebra::{Translation3, UnitQuaternion};

    use super::*;
    use crate::part::Part;

    fn rod() -> PoseModel {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("replay/parts/rod-90.toml");
        PoseModel::new(&Part::read(file).unwrap())
    }

    /// A rod in a direction of the floor, its middle at this depth below the camera.
    fn lying(yaw: f64, depth_mm: f64) -> Isometry3<f64> {
        Isometry3::from_parts(
            Translation3::new(0.0, 0.0, depth_mm),
            UnitQuaternion::from_euler_angles(0.0, 0.0, yaw),
        )
    }

    fn covariance(mm: f64, degrees: f64) -> Matrix6<f64> {
        let [shift, turn] = [mm * mm, degrees.to_radians().powi(2)];
        Matrix6::from_diagonal(&Vector6::new(shift, shift, shift, turn, turn, turn))
    }

    /// Depths of both middles and the deviation of the first along the depth, after pressing.
    fn pressed(depths_mm: [f64; 2], sigmas_mm: [f64; 2], yaw: f64, is_over: Option<bool>) -> ([f64; 2], f64) {
        let model = rod();
        let mut poses = [lying(0.0, depths_mm[0]), lying(yaw, depths_mm[1])];
        let mut covariances = sigmas_mm.map(|mm| covariance(mm, 0.3));
        let ([pose_a, pose_b], [cov_a, cov_b]) = (&mut poses, &mut covariances);
        let mut a = Placed { model: &model, left_from_part: pose_a, covariance: cov_a };
        let mut b = Placed { model: &model, left_from_part: pose_b, covariance: cov_b };
        press_apart(&mut a, &mut b, &Vector3::z(), |_, _| is_over);
        let depth = |p: &Isometry3<f64>| (p * model.centre_mm).z;
        ([depth(&poses[0]), depth(&poses[1])], covariances[0][(2, 2)].sqrt())
    }

    #[test]
    fn wires_do_not_go_through_each_other_and_the_less_certain_one_moves() {
        // The first lies 0.2 mm above the second, which is well known; they are 3 mm thick.
        let ([above, below], sigma) = pressed([499.8, 500.0], [1.0, 0.1], 1.2, Some(true));
        assert!((above - 497.0).abs() < 0.15, "{above}");
        assert!((below - 500.0).abs() < 0.1, "{below}");
        assert!(sigma < 0.3, "{sigma}");
        // What is seen says that it lies below.
        let ([first, _], _) = pressed([499.8, 500.0], [1.2, 0.1], 1.2, Some(false));
        assert!((first - 503.0).abs() < 0.2, "{first}");
    }

    #[test]
    fn what_is_apart_or_beside_or_in_doubt_stays() {
        let still = ([499.9, 500.0], 1.0);
        assert_eq!(pressed([499.9, 500.0], [1.0, 0.1], 1.2, None), still, "nobody knows which is on top");
        assert_eq!(pressed([499.9, 500.0], [1.0, 0.1], 0.1, Some(true)), still, "they lie along each other");
        assert_eq!(pressed([496.9, 500.0], [1.0, 0.1], 1.2, Some(true)), ([496.9, 500.0], 1.0));
        assert_eq!(pressed([499.5, 500.0], [0.3, 0.1], 1.2, Some(true)).0[0], 499.5, "one of them is wrong");
        assert!(pressed([f64::NAN, 500.0], [0.3, 0.3], 1.2, Some(true)).0[1] == 500.0);
    }

    #[test]
    fn no_wire_lies_in_another() {
        let model = rod();
        let first = lying(0.0, 500.0);
        let overlaps = |x_mm: f64, y_mm: f64, yaw: f64| {
            let other = Translation3::new(x_mm, y_mm, 0.0) * lying(yaw, 500.5);
            overlap((&model, &first), (&model, &other)) && overlap((&model, &other), (&model, &first))
        };
        assert!(overlaps(50.0, 0.5, 0.0) && overlaps(-50.0, 0.5, std::f64::consts::PI));
        assert!(!overlaps(50.0, 3.0, 0.0), "beside each other");
        assert!(!overlaps(89.0, 0.0, 0.0), "end to end");
        assert!(!overlaps(0.0, 0.0, 0.1) && !overlaps(0.0, 0.0, 1.0), "across");
    }

    #[test]
    fn a_wire_does_not_slide_along_itself() {
        let model = rod();
        let mut poses = [lying(0.0, 499.0), lying(1.2, 500.0)];
        let mut covariances = [covariance(0.5, 0.3), covariance(0.5, 0.3)];
        // Hardly anything holds it along itself, and what is known of that hangs on its depth.
        covariances[0][(0, 0)] = 25.0;
        (covariances[0][(0, 2)], covariances[0][(2, 0)]) = (2.0, 2.0);
        let ([pose_a, pose_b], [cov_a, cov_b]) = (&mut poses, &mut covariances);
        let mut a = Placed { model: &model, left_from_part: pose_a, covariance: cov_a };
        let mut b = Placed { model: &model, left_from_part: pose_b, covariance: cov_b };
        press_apart(&mut a, &mut b, &Vector3::z(), |_, _| Some(true));
        let [first, second] = poses.map(|p| (p * model.centre_mm).coords);
        assert!((second - first).z > 2.7 && first.xy().norm() < 0.01, "{first} {second}");
        assert!(covariances.iter().all(|c| c.symmetric_eigenvalues().min() > 0.0));
    }

    #[test]
    fn pictures_are_weighed_against_depths() {
        let above =
            |depth_mm, sigma_mm, is_over| pressed([depth_mm, 500.0], [sigma_mm, 0.1], 1.2, is_over).0[0];
        // Depths that tell are believed, whatever is seen; those that leave some doubt where nothing else is.
        for is_over in [None, Some(false)] {
            assert!((above(498.0, 0.3, is_over) - 497.2).abs() < 0.2);
        }
        assert!((above(499.5, 1.0, None) - 497.1).abs() < 0.2 && above(499.8, 1.0, Some(false)) > 502.5);
    }
}
