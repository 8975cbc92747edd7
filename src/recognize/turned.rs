//! A right camera that has turned since the rig was calibrated: told by the parts of a pair, and allowed for.
//!
//! Half a pixel across the baseline is a fortieth of a degree; webcams on their stands turn by that from one day to the
//! next. Wire along the baseline then lies millimetres too high or too low, and is taken for wire of another slope. All
//! parts of a pair together tell it to a twentieth of a pixel.

use nalgebra::{Matrix3, Vector3};

use super::result::{Doubt, FoundPart, Recognition, Turned};
use super::votes::Exchanged;
use super::{Job, Recognizer, Refusal, Scale, rig_of};
use crate::picture::Picture;
use crate::pose::refine::TurnSeen;
use crate::rig::Rig;

/// How often a pair is recognised anew because the right camera is seen to have turned, or turned further.
const TURNS_MAX: usize = 4;

/// Nothing is allowed for that is not so many standard deviations large.
const CERTAIN_SIGMAS: f64 = 3.0;
/// What is certain is allowed for once more where so much is left of it, of what the model leaves.
const WORTH_IT: f64 = 0.5;
/// What the model of wire and ends leaves of a turn that is none, in pixels, whatever the number of parts.
const MODEL_SIGMA_PX: [f64; 2] = [0.04, 0.08];
/// Webcams turn by less than this from one day to the next, in radians about the baseline and about the line of sight: two pixels
/// of a picture of 640x480 through a lens of 31 degrees. One that was knocked farther has turned along the baseline as well.
const FAR_RAD: [f64; 2] = [0.00175, 0.00625];
/// Where no part is recognised, so many ends of wire in each picture are more than those of a few foreign things.
const ENDS_WITHOUT_PARTS_MIN: u32 = 8;
/// Information, per square radian, beside which all other is none.
const PINNED: f64 = 1e18;
/// A camera has not turned by more than about this, in radians: where nothing is seen of a turn there is none.
const TURN_SIGMA: f64 = 0.02;

impl Recognizer {
    /// From graphs to parts, with the right camera as its ends tell, and anew as it stands where the parts tell that for
    /// certain, until nothing is left of it; says whether there was time for all.
    pub(super) fn recognise_turned(
        &mut self,
        told_by_ends: Vector3<f64>,
        job: &mut Job,
        out: &mut Recognition,
    ) -> bool {
        let mut go = |this: &mut Self, turn: Vector3<f64>, out: &mut Recognition| {
            this.turn_right(turn);
            let in_time = this.recognise(job, out);
            (in_time, this.judge_turn(out).filter(|_| in_time && !out.out_of_time))
        };
        let (mut in_time, mut more) = go(self, told_by_ends, out);
        for _ in 0..TURNS_MAX {
            let Some(turn) = more else { break };
            let (before, parts) = (self.turn, out.parts.len());
            (in_time, more) = go(self, before + turn, out);
            // What explains the pictures worse is not how the camera stands; one of ten parts may have been none.
            if in_time && !out.out_of_time && 10 * out.parts.len() < 9 * parts {
                (in_time, _) = go(self, before, out);
                break;
            }
        }
        in_time
    }

    /// The turn of the right camera, radians, along the left camera's axes, that ends in both pictures tell before anything is
    /// recognised; nought where they tell none.
    pub(super) fn turn_told_by_ends(&mut self) -> Result<Vector3<f64>, Refusal> {
        let Self { votes, pictures, scales, rig, .. } = self;
        let calibrated = Rig { right_from_left: rig.right_from_left, ..*rig_of(scales, pictures) };
        let turn = votes.turn(&calibrated, pictures.each_ref().map(Picture::nodes));
        turn.map(Option::unwrap_or_default).map_err(|Exchanged| Refusal::Exchanged)
    }

    /// Allows for this turn of the right camera, radians, along the left camera's axes.
    fn turn_right(&mut self, turn: Vector3<f64>) {
        self.turn = turn;
        for Scale { rig, .. } in &mut self.scales {
            *rig = Rig { right_from_left: self.rig.right_from_left, ..*rig }.with_right_turned(&turn);
        }
    }

    /// Says in `out` how far the right camera has turned; gives what is to be allowed for beyond what is.
    fn judge_turn(&self, out: &mut Recognition) -> Option<Vector3<f64>> {
        let mut seen = TurnSeen::default();
        self.explanations.standing().for_each(|explanation| seen += &explanation.turn);
        out.turned = None;
        let model_px = f64::from(1 << self.pictures[0].halvings());
        let (told, more) = turned(&self.scales[0].rig, &seen, &self.turn, model_px)?;
        let ends_apart = self.are_ends_apart(&out.parts).then_some(Doubt::EndsApart);
        // Where nothing is recognised they tell nothing else.
        if ends_apart.is_some() || !out.parts.is_empty() {
            out.turned = Some(Turned { allowed_for: self.turn, doubt: ends_apart.or(told.doubt), ..told });
        }
        more
    }

    /// Whether hardly any end of wire as thick as that of these parts, or as most wire in the pictures, has its like on its line.
    fn are_ends_apart(&self, parts: &[FoundPart]) -> bool {
        if parts.is_empty() {
            let [left, right] = self.pictures.each_ref().map(Picture::half_width_px);
            return self.votes.are_apart([left.min(right), left.max(right)], ENDS_WITHOUT_PARTS_MIN);
        }
        // Ends say nothing of parts that have none.
        if parts.iter().all(|found| self.parts[found.part].pose_model().ends.is_empty()) {
            return false;
        }
        let focal_px = rig_of(&self.scales, &self.pictures).right.focal_px();
        let centre = |found: &FoundPart| found.left_from_part * self.parts[found.part].pose_model().centre_mm;
        let depth_mm = || parts.iter().map(|found| centre(found).z);
        let [nearest, farthest] = [depth_mm().fold(f64::MAX, f64::min), depth_mm().fold(0.0, f64::max)];
        let [thinnest_mm, thickest_mm] = self.thickness_mm;
        self.votes
            .are_apart([thinnest_mm / farthest, thickest_mm / nearest].map(|share| 0.5 * focal_px * share), 1)
    }
}

/// What is told of a turn about one direction, in pixels.
struct Told {
    px: f64,
    sigma_px: f64,
    is_certain: bool,
    /// Whether what is not allowed for yet is worth another go.
    is_worth_it: bool,
    /// Whether what is not allowed for yet is certain by itself, or what is allowed for is not.
    in_doubt: bool,
    /// Whether it is more than [`FAR_RAD`] for certain.
    is_far: bool,
}

/// Directions of a turn, and what a turn about them does to the right picture.
pub(super) struct Axes {
    /// Along the left camera's axes: the baseline, what is upright upon it and the line of sight, and the latter made upright
    /// upon the baseline.
    pub(super) left_from_axes: Matrix3<f64>,
    /// Pixels a radian about the first and the last: of what is displaced across the baseline in the middle, and at the rim.
    pub(super) px_per_radian: [f64; 2],
}

impl Axes {
    pub(super) fn of(rig: &Rig) -> Option<Self> {
        let baseline = rig.right_eye().coords.try_normalize(1e-9)?;
        let sight = rig.right_from_left.rotation.inverse() * Vector3::z();
        let sight = (sight - baseline * baseline.dot(&sight)).try_normalize(1e-9)?;
        let camera = &rig.right;
        Some(Self {
            left_from_axes: Matrix3::from_columns(&[baseline, sight.cross(&baseline), sight]),
            px_per_radian: [f64::midpoint(camera.fx, camera.fy), 0.5 * camera.width as f64],
        })
    }
}

/// How far the right camera has turned, as all parts together tell, and what is to be allowed for beyond the `before` that
/// was: a rotation vector, radians, along the left camera's axes, if that is certain. The model's pixels are `model_px` of
/// the pictures'.
///
/// A turn about what is upright upon the baseline changes distances and nothing else: parts that are longer than their files
/// say look the same. It is solved for and not believed.
fn turned(
    rig: &Rig,
    seen: &TurnSeen,
    before: &Vector3<f64>,
    model_px: f64,
) -> Option<(Turned, Option<Vector3<f64>>)> {
    let Axes { left_from_axes, px_per_radian } = Axes::of(rig)?;
    let normal =
        left_from_axes.tr_mul(&(seen.normal * left_from_axes)) + Matrix3::identity() / TURN_SIGMA.powi(2);
    let right_side = left_from_axes.tr_mul(&seen.right_side);
    let covariance = normal.try_inverse()?;
    let free = covariance * right_side;
    if !free.iter().all(|radians| radians.is_finite()) {
        return None;
    }
    let before = left_from_axes.tr_mul(before);
    let [rows, rim] = [(0, 0), (2, 1)].map(|(axis, k)| {
        let sigma_px =
            (covariance[(axis, axis)].sqrt() * px_per_radian[k]).hypot(MODEL_SIGMA_PX[k] * model_px);
        let [before_px, more_px] = [before[axis], free[axis]].map(|radians| radians * px_per_radian[k]);
        let px = before_px + more_px;
        let is_certain = px.abs() > CERTAIN_SIGMAS * sigma_px;
        let missing_px = if is_certain { more_px } else { -before_px };
        let is_worth_it = missing_px.abs() > WORTH_IT * MODEL_SIGMA_PX[k] * model_px;
        Told {
            px,
            sigma_px,
            is_certain,
            is_worth_it,
            in_doubt: more_px.abs() > CERTAIN_SIGMAS * sigma_px || is_worth_it && !is_certain,
            is_far: is_certain && px.abs() > FAR_RAD[k] * px_per_radian[k],
        }
    });
    let told = Turned {
        rows_px: rows.px,
        rows_sigma_px: rows.sigma_px,
        rim_px: rim.px,
        rim_sigma_px: rim.sigma_px,
        along_px: -free.y * px_per_radian[0],
        along_sigma_px: covariance[(1, 1)].sqrt() * px_per_radian[0],
        doubt: if rows.in_doubt || rim.in_doubt {
            Some(Doubt::Rest)
        } else {
            (rows.is_far || rim.is_far).then_some(Doubt::Far)
        },
        ..Turned::default()
    };
    if !(rows.is_worth_it || rim.is_worth_it) {
        return Some((told, None));
    }
    // What is not certain is not allowed for; the rest is solved for without it.
    let (mut pinned, mut right_side) = (normal, right_side);
    for (axis, of_axis) in [(0, rows), (2, rim)] {
        if !of_axis.is_certain {
            pinned[(axis, axis)] += PINNED;
            right_side[axis] -= PINNED * before[axis];
        }
    }
    let mut turn = pinned.try_inverse()? * right_side;
    turn.y = 0.0;
    Some((told, Some(left_from_axes * turn)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::CameraModel;

    fn rig() -> Rig {
        let camera = CameraModel::pinhole(640, 480, 700.0, 320.0, 240.0);
        let right_from_left = nalgebra::Isometry3::translation(-60.0, 0.0, 0.0);
        Rig { left: camera, right: camera, right_from_left }
    }

    /// Parts that tell this turn, radians, as surely as this, in pixels.
    fn seen(turn: &Vector3<f64>, sigma_px: f64) -> TurnSeen {
        let normal = Matrix3::identity() * (700.0 / sigma_px).powi(2);
        TurnSeen { normal, right_side: normal * turn }
    }

    #[test]
    fn only_what_is_certain_is_allowed_for_and_distances_never() {
        let none = Vector3::zeros();
        let half_a_pixel = Vector3::new(0.5 / 700.0, 0.5 / 700.0, 0.0);
        let (told, more) = turned(&rig(), &seen(&half_a_pixel, 0.05), &none, 1.0).unwrap();
        assert!(
            (told.rows_px - 0.5).abs() < 0.01 && told.rim_px.abs() < 0.01 && told.doubt == Some(Doubt::Rest),
            "{told:?}"
        );
        let more = more.unwrap();
        assert!((more.x * 700.0 - 0.5).abs() < 0.01 && more.y == 0.0 && more.z == 0.0, "{more}");
        // What is allowed for already is told with the rest, and not allowed for twice.
        let (told, more) = turned(&rig(), &seen(&none, 0.05), &more, 1.0).unwrap();
        assert!((told.rows_px - 0.5).abs() < 0.01 && told.doubt.is_none() && more.is_none());
        let (told, more) = turned(&rig(), &seen(&half_a_pixel, 0.3), &none, 1.0).unwrap();
        assert!(more.is_none() && told.rows_sigma_px > 0.29, "{told:?}");
        // Nor is what ends told before; where there is no time to do without it, it stays in doubt.
        let doubtful = Vector3::new(0.0, 0.0, 0.1 / 320.0);
        let (told, more) = turned(&rig(), &seen(&Vector3::zeros(), 0.1), &doubtful, 1.0).unwrap();
        assert!(
            told.doubt == Some(Doubt::Rest) && (more.unwrap() + doubtful).norm() < 1e-9,
            "{told:?} {more:?}"
        );
        // Parts as if seen from farther along the baseline are longer ones, and said to look so.
        let longer = Vector3::new(0.0, -0.5 / 700.0, 0.0);
        let (told, more) = turned(&rig(), &seen(&longer, 0.05), &none, 1.0).unwrap();
        assert!(
            (told.along_px - 0.5).abs() < 0.01 && told.along_sigma_px < 0.06 && more.is_none(),
            "{told:?}"
        );
        // Without parts nothing is known, and nothing is turned.
        let (told, more) = turned(&rig(), &TurnSeen::default(), &none, 1.0).unwrap();
        assert!(more.is_none() && told.rows_px == 0.0 && told.rows_sigma_px > 10.0, "{told:?}");
    }

    #[test]
    fn a_turn_about_the_line_of_sight_is_told_at_the_rim() {
        let turn = Vector3::new(0.0, 0.0, 1.0 / 320.0);
        let (told, more) = turned(&rig(), &seen(&turn, 0.05), &Vector3::zeros(), 1.0).unwrap();
        assert!(told.rows_px.abs() < 0.01 && (told.rim_px - 1.0).abs() < 0.01, "{told:?}");
        assert!((more.unwrap() - turn).norm() < 1e-4);
    }
}
