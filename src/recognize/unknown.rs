//! Wire that no recognised part has, and the parts that it is in the way of.
//!
//! Such wire is a part that was missed, or none of those that are looked for. Where both pictures show it at the fingers
//! of a grasp, or beside the part, the part is left; so it is where neither picture shows its wire and nothing known lies
//! there. Was not all wire looked at, because time was over, much is unknown, and only a part that stands alone is taken.

use nalgebra::{UnitQuaternion, Vector2, Vector3};

use super::explanations::Explanation;
use super::prepared::Prepared;
use super::result::FoundPart;
use crate::grasp;
use crate::matching::claims::{CELL_PX, ClaimMap};
use crate::matching::select;
use crate::picture::Picture;
use crate::pose::verify::{PieceSight, Sight};
use crate::rig::Rig;
use crate::vision::bits::{nearest, vector};

/// In half widths of the wire: nearer to the middle of one of its pieces, which are two apart, the skeleton is its own; and
/// within which the middle of another wire would touch it, half as many again for what thinning displaces.
const OWN_HALF_WIDTHS: f64 = 1.5;
const NEAR_HALF_WIDTHS: f64 = 3.0;
/// So much farther: what a part claims beside its wire is not seen to be another's.
const CLAIMED_BESIDE_PX: f64 = 2.0 * CELL_PX;
/// Places across and along a finger at which the masks are asked; and a finger meets something where more than one in so many
/// of them is object.
const FINGER_SAMPLES: usize = 6;
const FINGER_SHARE: usize = 8;

/// Skeletons without what recognised parts claim.
pub(super) struct Unknown {
    left_and_right_px: [Vec<Vector2<f64>>; 2],
}

/// Where wire would be in the way of a part that is to be taken.
#[derive(Clone, Copy)]
enum Place {
    /// Where the fingers come down.
    Fingers,
    /// Beside this piece of its wire, which the other then crosses or lies along.
    Beside(usize),
}

/// A part that is to be taken, and what is known of it.
pub(super) struct Taken<'a> {
    pub(super) params: &'a grasp::Params,
    pub(super) rig: &'a Rig,
    pub(super) prepared: &'a Prepared,
    pub(super) explanation: &'a Explanation,
    pub(super) found: &'a FoundPart,
}

impl Unknown {
    /// With room for all of both skeletons.
    pub(super) fn new(pictures: &[Picture; 2]) -> Self {
        Self {
            left_and_right_px: pictures.each_ref().map(|p| Vec::with_capacity(p.graph().points.capacity())),
        }
    }

    /// Finds what the parts that claim all this do not have.
    pub(super) fn find(&mut self, pictures: &[Picture; 2], claims: &[ClaimMap; 2]) {
        for side in 0..2 {
            let unknown_px = &mut self.left_and_right_px[side];
            unknown_px.clear();
            let points = pictures[side].graph().points.iter();
            unknown_px
                .extend(points.filter(|&&point| !claims[side].is_claimed_by_any(point)).map(|&p| vector(p)));
        }
    }

    /// Whether both pictures show wire where the fingers go, or beside the part's, or something that has no wire lies on it.
    pub(super) fn is_in_the_way(
        &self,
        taken: &Taken,
        pictures: &[Picture; 2],
        claims: &[ClaimMap; 2],
    ) -> bool {
        let wire_px = |side: usize| self.left_and_right_px[side].iter().copied();
        // What is at a place shows there in both.
        let shows_at =
            |place: Place| [0, 1].into_iter().all(|side| taken.shows_at(place, side, wire_px(side)));
        taken.places().any(shows_at)
            || taken.hidden(claims).any(|piece| piece.iter().any(|p| p.sight != Sight::OneSide))
            || taken.is_met_by_mask(pictures, claims)
    }
}

fn skeleton(picture: &Picture) -> impl Iterator<Item = Vector2<f64>> {
    picture.graph().points.iter().map(|&p| vector(p))
}

impl Taken<'_> {
    /// Whether both pictures show object where a finger comes down that no recognised part has: a wire that lies along the
    /// part or ends on it has no skeleton of its own.
    fn is_met_by_mask(&self, pictures: &[Picture; 2], claims: &[ClaimMap; 2]) -> bool {
        let Self { params, rig, found, .. } = self;
        let (gripper, grasp) = (&params.gripper, &found.grasp);
        let at_mm = found.grasp.position_left_mm(params);
        let left_from_out =
            params.base_from_left.map_or(UnitQuaternion::identity(), |pose| pose.rotation.inverse());
        let left_from_tool = left_from_out * grasp.orientation;
        let share = |k: usize| (k as f64 + 0.5) / FINGER_SAMPLES as f64;
        let samples =
            || (0..FINGER_SAMPLES).flat_map(|i| (0..FINGER_SAMPLES).map(move |j| [i, j].map(share)));
        [-1.0, 1.0].iter().any(|side_of_wire| {
            let corner = |across: f64, along: f64| {
                let across_mm = grasp.opening_mm / 2.0 + across * gripper.finger_thickness_mm;
                let along_mm = (along - 0.5) * gripper.finger_width_mm;
                at_mm + left_from_tool * Vector3::new(side_of_wire * across_mm, along_mm, 0.0)
            };
            [0, 1].into_iter().all(|side: usize| {
                let project = [Rig::project_left, Rig::project_right][side];
                let [Some(first), Some(across), Some(along)] =
                    [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)].map(|(a, b)| project(rig, &corner(a, b)))
                else {
                    return false;
                };
                let is_unknown = |[a, b]: &[f64; 2]| {
                    let px = first + (across - first) * *a + (along - first) * *b;
                    pictures[side].mask().get(nearest(px.x), nearest(px.y))
                        && !claims[side].is_claimed_at_all(&px)
                };
                FINGER_SHARE * samples().filter(is_unknown).count() > FINGER_SAMPLES * FINGER_SAMPLES
            })
        })
    }

    /// Pieces that neither picture shows clearly and beside which no recognised part lies.
    fn hidden<'b>(&'b self, claims: &'b [ClaimMap; 2]) -> impl Iterator<Item = &'b [PieceSight; 2]> {
        let pieces = self.prepared.pose_model().stations.iter().zip(&self.explanation.verdict.pieces);
        pieces.filter(|(station, _)| !station.at_joint).map(|(_, piece)| piece).filter(move |piece| {
            piece.iter().zip(claims).all(|(seen, claims)| {
                let PieceSight { sight, expected_px, across, half_width_px, .. } = seen;
                let beside = [-1.0, 1.0].map(|side| expected_px + across * (side * 2.0 * half_width_px));
                *sight != Sight::Clear
                    && !claims.is_claimed_across(expected_px, across)
                    && !beside.iter().any(|px| claims.is_claimed_at_all(px))
            })
        })
    }

    /// Whether it can be taken whatever else there is: it is certain by itself, both pictures show all its wire, so that
    /// nothing lies on it, and no other near it or where the fingers go.
    pub(super) fn stands_alone(&self, pictures: &[Picture; 2], claims: &[ClaimMap; 2]) -> bool {
        let Explanation { fit, verdict, .. } = self.explanation;
        let model = self.prepared.pose_model();
        let mut pieces = model.stations.iter().zip(&verdict.pieces);
        pieces.all(|(s, piece)| s.at_joint || piece.iter().all(|p| p.sight == Sight::Clear))
            && select::is_certain(fit, verdict, model.ends.len())
            && !self.places().any(|place| {
                [0, 1].into_iter().any(|side: usize| self.shows_at(place, side, skeleton(&pictures[side])))
            })
            && !self.is_met_by_mask(pictures, claims)
    }

    /// Where other wire is in the way.
    fn places(&self) -> impl Iterator<Item = Place> + '_ {
        let pieces = 0..self.explanation.verdict.pieces.len();
        std::iter::once(Place::Fingers).chain(pieces.map(Place::Beside))
    }

    /// Whether some of this wire is not the part's own and comes near such a place.
    fn shows_at(&self, place: Place, side: usize, wire_px: impl Iterator<Item = Vector2<f64>>) -> bool {
        let pieces = &self.explanation.verdict.pieces;
        let project = [Rig::project_left, Rig::project_right][side];
        let grasp_px = project(self.rig, &self.found.grasp.position_left_mm(self.params));
        // What is not seen may be anywhere.
        let (Some(grasp_px), Some(first)) = (grasp_px, pieces.first()) else { return true };
        let half_px = first[side].half_width_px;
        let (at_px, reach_px) = match place {
            Place::Fingers => {
                let radius_mm = self.prepared.pose_model().radius_mm;
                let fingers_mm = grasp::fingers_reach_mm(&self.params.gripper, &self.found.grasp) + radius_mm;
                (grasp_px, fingers_mm * half_px / radius_mm)
            }
            Place::Beside(piece) => {
                (pieces[piece][side].expected_px, NEAR_HALF_WIDTHS * half_px + CLAIMED_BESIDE_PX)
            }
        };
        let is_within =
            |px: &Vector2<f64>, of: &Vector2<f64>, px_max: f64| (px - of).norm_squared() < px_max * px_max;
        let is_own = |px: &Vector2<f64>| {
            pieces.iter().any(|p| is_within(px, &p[side].expected_px, OWN_HALF_WIDTHS * half_px))
        };
        // A few pixels beside a claim are none; a wire that comes near is seen over more than that.
        let many = half_px as usize + 1;
        wire_px.filter(|px| is_within(px, &at_px, reach_px) && !is_own(px)).take(many).count() == many
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Isometry3;

    use super::*;
    use crate::frame::FramePair;
    use crate::grasp::Blocked;
    use crate::part::Part;
    use crate::pose::drawn::DrawnPair;
    use crate::pose::model::PoseModel;
    use crate::recognize::{Params, Recognition, Recognizer};
    use crate::session::Session;
    use crate::time::Budget;
    use crate::vision::binarize::ColourRange;

    /// A part: whether it can be taken whatever else there is, whether something is in its way, by the masks alone, and why it is
    /// blocked.
    #[derive(Debug)]
    struct Known {
        alone: bool,
        in_the_way: bool,
        met_by_mask: bool,
        blocked: Option<Blocked>,
    }

    /// For the parts of a recorded pair: with what all of them claim, and with nothing claimed.
    fn of_pair(pair: usize) -> [Vec<Known>; 2] {
        let replay = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("replay");
        let session = Session::open(&replay.join("conveyor")).unwrap();
        let [Some(left), Some(right)] = &session.pairs[pair].pictures else { panic!("a whole pair") };
        let frames = FramePair { left: left.read().unwrap(), right: right.read().unwrap() };
        let rig = Rig::read(replay.join("conveyor/calibration.yaml")).unwrap();
        let rod = Part::read(replay.join("parts/rod-90.toml")).unwrap();
        let mut recognizer = Recognizer::new(Params::default(), rig, vec![rod]).unwrap();
        let mut out = Recognition::default();
        recognizer.run(&frames, Budget::Iterations(100_000), 1, &mut out).unwrap();
        let Recognizer { params, scales, parts, pictures, explanations, unknown, .. } = &mut recognizer;
        let rig = &scales[0].rig;
        let nothing = [&rig.left, &rig.right].map(|c| ClaimMap::new(c.width, c.height));
        [explanations.claims(), &nothing].map(|claims| {
            unknown.find(pictures, claims);
            let of = |explanation: &Explanation| {
                let is_it = |f: &&FoundPart| f.left_from_part == explanation.fit.left_from_part;
                let found = out.parts.iter().find(is_it).unwrap();
                let taken = Taken { params: &params.grasp, rig, prepared: &parts[0], explanation, found };
                Known {
                    alone: taken.stands_alone(pictures, claims),
                    met_by_mask: taken.is_met_by_mask(pictures, claims),
                    in_the_way: unknown.is_in_the_way(&taken, pictures, claims),
                    blocked: found.blocked,
                }
            };
            explanations.standing().map(of).collect()
        })
    }

    #[test]
    fn what_stands_alone_is_free_when_all_is_known() {
        let mut alone = 0;
        for pair in [0, 9, 12, 15, 19] {
            for part in of_pair(pair).iter().flatten().filter(|part| part.alone) {
                assert!(part.blocked.is_none() && !part.in_the_way, "pair {pair}: {part:?}");
                alone += 1;
            }
        }
        assert!(alone > 3, "{alone}");
    }

    #[test]
    fn wire_that_nobody_claims_is_in_the_way() {
        let [all_claimed, nothing_claimed] = of_pair(12);
        let count = |parts: &[Known], which: fn(&Known) -> bool| parts.iter().filter(|p| which(p)).count();
        assert_eq!(count(&all_claimed, |p| p.in_the_way), 0, "{all_claimed:?}");
        assert!(count(&nothing_claimed, |p| p.in_the_way) >= 2, "{nothing_claimed:?}");
    }

    #[test]
    fn what_the_masks_show_where_a_finger_comes_down_is_in_the_way_if_nobody_has_it() {
        let (mut beset, mut met) = (0, 0);
        for pair in 0..20 {
            let [all_claimed, nothing_claimed] = of_pair(pair);
            for (known, unknown) in all_claimed.iter().zip(&nothing_claimed) {
                assert!(!known.met_by_mask, "pair {pair}: {known:?}");
                assert!(!unknown.met_by_mask || unknown.in_the_way);
                if known.blocked == Some(Blocked::NoRoom) {
                    (beset, met) = (beset + 1, met + usize::from(unknown.met_by_mask));
                }
            }
        }
        // What is above or below the wire shows elsewhere.
        assert!(beset > 5 && met > 2, "{met} of {beset}");
    }

    #[test]
    fn nothing_stands_alone_in_a_heap() {
        let known = of_pair(0);
        assert!(known.iter().flatten().all(|part| !part.alone), "{known:?}");
    }

    /// Why an upright rod half a metre away is not offered over whose pictures, left and right, something is painted; the
    /// rod's middle is in row 240. From `min` on grey is object.
    fn blocked_under(rod: &Part, min: u8, paint: impl Fn(usize, usize) -> Option<u8>) -> Option<Blocked> {
        let model = PoseModel::new(rod);
        let turn = UnitQuaternion::rotation_between(&model.straight_along.unwrap(), &Vector3::y()).unwrap();
        let pose = Isometry3::from_parts(Vector3::new(0.0, 0.0, 500.0).into(), turn);
        let mut drawn = DrawnPair::new(&[(&model, pose)]);
        // The right camera sees it 72 pixels farther left.
        for (frame, moved) in drawn.frames.iter_mut().zip([0, 72]) {
            for (k, byte) in frame.bytes.iter_mut().enumerate() {
                *byte = paint(k % 640 + moved, k / 640).unwrap_or(*byte);
            }
        }
        let [left, right] = drawn.frames;
        let mut params = Params::default();
        for range in &mut params.binarize {
            range.colour = ColourRange::Grey { min, max: 255 };
        }
        let mut recognizer = Recognizer::new(params, drawn.rig, vec![rod.clone()]).unwrap();
        let mut out = Recognition::default();
        recognizer.run(&FramePair { left, right }, Budget::Iterations(100_000), 1, &mut out).unwrap();
        let [part] = &out.parts[..] else { panic!("{:?}", out.parts) };
        part.blocked
    }

    #[test]
    fn what_lies_on_a_part_and_is_none_is_in_the_way() {
        let unknown = Some(Blocked::Unknown);
        let rod = Part::read(concat!(env!("CARGO_MANIFEST_DIR"), "/replay/parts/rod-90.toml")).unwrap();
        let blocked_under = |paint: &dyn Fn(usize, usize) -> Option<u8>| blocked_under(&rod, 120, paint);
        assert_eq!(blocked_under(&|_, _| None), None);
        // A cord as dark as the floor, a coin, and wire much thinner than the rod across it, 15 to 25 mm from its middle.
        assert_eq!(blocked_under(&|_, y| (212..217).contains(&y).then_some(40)), unknown, "cord");
        let coin = |x: usize, y: usize| (x.abs_diff(320).pow(2) + y.abs_diff(215).pow(2) < 64).then_some(190);
        assert_eq!(blocked_under(&coin), unknown, "coin");
        // A thread a pixel wide, wherever the stations lie; one that lies over half of the wire's width is a scratch.
        for row in 208..220 {
            assert_eq!(blocked_under(&|_, y| (y == row).then_some(40)), unknown, "thread in row {row}");
            let scratch = |x: usize, y: usize| (y == row && x < 320).then_some(40);
            assert_eq!(blocked_under(&scratch), None, "scratch in row {row}");
        }
        let wire = |x: usize, y: usize| (x.abs_diff(320) < 30 && (214..216).contains(&y)).then_some(200);
        assert_eq!(blocked_under(&wire), unknown, "wire");
    }

    #[test]
    fn a_pin_with_a_band_across_it_is_not_offered_however_many_stations_it_covers() {
        let text = "name = 'pin'\nthickness_mm = 6.0\n\
            node = [{ name = 'a', position_mm = [0, -24, 0] }, { name = 'b', position_mm = [0, 24, 0] }]\n\
            edge = [{ from = 'a', to = 'b' }]\n\
            grasp = { position_mm = [0, 0, 0], approach = [0, 0, -1], closing = [1, 0, 0], width_mm = 12.0 }\n";
        let pin = Part::parse(text, "pin.toml").unwrap();
        assert_eq!(blocked_under(&pin, 60, |_, _| None), None);
        for (wide, row) in (1..7).flat_map(|wide| (224..234).map(move |row| (wide, row))) {
            let band = |_, y: usize| (row..row + wide).contains(&y).then_some(70);
            assert!(blocked_under(&pin, 60, band).is_some(), "{wide} rows from {row} on");
        }
    }
}
