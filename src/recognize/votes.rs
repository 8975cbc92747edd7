//! How the right camera stands, told by ends of wire before anything is recognised.
//!
//! With the right camera turned by a few pixels no end lies on the epipolar line of its like, and what lies there by
//! chance is taken for it. So each end of the left picture votes for all turns that bring an end like it onto its line: one
//! of wire as thick in about the same direction, at a depth where a part would look so. Those that are not the same are
//! scattered; the turn that is has one vote of nearly every end that both cameras see.

use std::cmp::Reverse;
use std::ops::RangeInclusive;

use nalgebra::{Matrix2, Vector2, Vector3};

use super::turned::Axes;
use crate::matching::nodes::{ImageNode, NodeRole};
use crate::rig::Rig;

/// Ends of a picture that vote. Where there are more nobody does: most of them are not of parts.
const ENDS_MAX: usize = 256;
/// Pairs of ends alike that are kept.
const ALIKE_MAX: usize = 4096;
/// Up to which turns votes are counted, in pixels: across the baseline in steps of a half, and about the line of sight at
/// the rim in whole ones.
const ROWS_PX_MAX: f64 = 32.0;
const RIM_PX_MAX: i32 = 8;
const ROWS_STEP_PX: f64 = 0.5;
const ROWS: usize = 128;
/// An end is on its line where it is no farther from it than so many steps, and half a one more.
const ON_LINE_STEPS: i32 = 2;
const ON_LINE_PX: f64 = 1.25;
/// Turns so many steps apart are different ones: no end is on its line with both.
const APART_STEPS: usize = 6;
/// The cosine between the directions of wire of ends alike is more than this.
const DIRECTION_COS_MIN: f64 = 0.8;
/// By what factor wire may look thicker or thinner than a part's would at the depth of the pair.
const THICKNESS_FACTOR_MAX: f64 = 1.8;
/// Ends are apart where fewer than one in so many has one like it on its line. Of heaps nearly every second has.
const APART_SHARE: u32 = 4;
/// So many more votes than the camera has as calibrated, and so many times as many, tell a turn.
const MORE_MIN: u32 = 3;
const TIMES_MIN: f64 = 1.5;
/// The same of what the most have of turns that are quite another: the most of a hundred are more than those of one.
const RIVAL_TIMES_MIN: f64 = 1.25;

/// An end of wire, looked at straight away from the baseline.
#[derive(Clone, Copy)]
struct End {
    /// Along the baseline and across, in pixels.
    at_px: Vector2<f64>,
    direction: Vector2<f64>,
    half_thickness_px: f64,
}

/// An end of the left picture and one of the right that is like it.
#[derive(Clone, Copy)]
struct Alike {
    left: usize,
    /// How much lower the right one lies than it should.
    offset_px: f64,
    /// Where that lies along the baseline: -1 and 1 are the rims.
    along: f64,
}

/// Workspace of the votes.
pub(super) struct Votes {
    /// How thick wire of a part may look at its depth, and at which depths.
    seen_mm: RangeInclusive<f64>,
    depth_mm: RangeInclusive<f64>,
    /// Of both pictures; after a look at them exchanged, of the right one first.
    ends: [Vec<End>; 2],
    /// Those of a left end behind each other.
    alike: Vec<Alike>,
    /// How many ends have one like them on their lines with the camera as it is taken to stand, where ends voted.
    votes: Option<u32>,
}

/// The pictures are those of the other camera each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Exchanged;

/// Whether so many votes are more than those by more than chance, and so many times as many.
fn are_more(votes: u32, than: u32, times: f64) -> bool {
    votes >= than + MORE_MIN && f64::from(votes) >= times * f64::from(than)
}

impl Votes {
    /// For parts between these thicknesses at these depths; reserves all memory.
    pub(super) fn new(thickness_mm: [f64; 2], depth_mm: [f64; 2]) -> Self {
        let [thinnest_mm, thickest_mm] = thickness_mm;
        Self {
            seen_mm: thinnest_mm / THICKNESS_FACTOR_MAX..=thickest_mm * THICKNESS_FACTOR_MAX,
            depth_mm: depth_mm[0]..=depth_mm[1],
            ends: [0, 1].map(|_| Vec::with_capacity(ENDS_MAX)),
            alike: Vec::with_capacity(ALIKE_MAX),
            votes: None,
        }
    }

    /// The turn of the right camera, radians, along the left camera's axes, that far more ends vote for than for none;
    /// `None` where there is no such turn.
    ///
    /// # Errors
    /// [`Exchanged`] where even more ends vote for that.
    pub(super) fn turn(
        &mut self,
        rig: &Rig,
        [left, right]: [&[ImageNode]; 2],
    ) -> Result<Option<Vector3<f64>>, Exchanged> {
        self.votes = None;
        let Some(axes) = Axes::of(rig) else { return Ok(None) };
        if !self.find_alike(rig, &axes, [left, right], false) {
            return Ok(None);
        }
        let for_none = self.votes_for_none();
        self.votes = Some(for_none);
        let are_far_more = |votes: u32| are_more(votes, for_none, TIMES_MIN);
        // Of no more ends can the like be in the other picture; several that share one tell no turn.
        if !are_far_more(self.ends[0].len().min(self.ends[1].len()) as u32) {
            return Ok(None);
        }
        let (votes, turn, rival) = self.most_votes(&axes);
        if self.find_alike(rig, &axes, [right, left], true) {
            let for_exchanged = self.votes_for_none();
            if are_far_more(for_exchanged) && for_exchanged >= votes {
                return Err(Exchanged);
            }
        }
        if !are_far_more(votes) || !are_more(votes, rival, RIVAL_TIMES_MIN) {
            return Ok(None);
        }
        self.votes = Some(votes);
        Ok(Some(turn))
    }

    /// Whether hardly any end of wire between these half thicknesses, in pixels, has one like it on its line, of at least so
    /// many in each picture: then the cameras stand in yet another way.
    pub(super) fn are_apart(&self, half_thickness_px: [f64; 2], ends_min: u32) -> bool {
        let [thinnest, thickest] = half_thickness_px;
        let thickness_px = thinnest / THICKNESS_FACTOR_MAX..=thickest * THICKNESS_FACTOR_MAX;
        let of_parts = self.ends.each_ref().map(|ends| {
            ends.iter().filter(|end| thickness_px.contains(&end.half_thickness_px)).count() as u32
        });
        let fewer = of_parts[0].min(of_parts[1]);
        fewer >= ends_min && self.votes.is_some_and(|votes| APART_SHARE * votes < fewer)
    }

    fn votes_for_none(&self) -> u32 {
        let votes = |group: &&[Alike]| group.iter().any(|alike| alike.offset_px.abs() <= ON_LINE_PX);
        self.of_left_ends().filter(votes).count() as u32
    }

    fn of_left_ends(&self) -> impl Iterator<Item = &[Alike]> {
        self.alike.chunk_by(|a, b| a.left == b.left)
    }

    /// Fills `alike` with the ends of what the left and the right camera are taken to have seen, of the other camera each where
    /// these are `exchanged`; says whether there are not too many.
    fn find_alike(&mut self, rig: &Rig, axes: &Axes, nodes: [&[ImageNode]; 2], exchanged: bool) -> bool {
        let focal_px = axes.px_per_radian[0];
        let axes_from_left = axes.left_from_axes.transpose();
        let left_from_right = rig.right_from_left.rotation.inverse().to_rotation_matrix();
        let axes_from = [axes_from_left, axes_from_left * left_from_right.matrix()];
        for (side, camera) in [&rig.left, &rig.right].into_iter().enumerate() {
            let across = axes_from[side].fixed_view::<2, 2>(0, 0).into_owned();
            let ends = &mut self.ends[side];
            ends.clear();
            for node in nodes[side].iter().filter(|node| node.role == NodeRole::End && node.end_visible) {
                let ray = if exchanged { camera.undistort(node.position_px) } else { node.ray };
                let ray = axes_from[side] * ray.push(1.0);
                let Some(leg) = node.legs().first().filter(|_| ray.z > 0.0) else { continue };
                if ends.len() == ENDS_MAX {
                    return false;
                }
                ends.push(End {
                    at_px: ray.xy() * (focal_px / ray.z),
                    direction: across * leg.direction_px,
                    half_thickness_px: node.half_thickness_px,
                });
            }
        }
        self.alike.clear();
        let [left, right] = &self.ends;
        let disparity_mm = focal_px * rig.baseline_mm();
        for (n, l) in left.iter().enumerate() {
            for r in right {
                let apart_px = r.at_px - l.at_px;
                if apart_px.y.abs() > ROWS_PX_MAX + RIM_PX_MAX as f64
                    || l.direction.dot(&r.direction)
                        < DIRECTION_COS_MIN * l.direction.norm() * r.direction.norm()
                {
                    continue;
                }
                let depth_mm = disparity_mm / -apart_px.x;
                let seen_mm = (l.half_thickness_px + r.half_thickness_px) * depth_mm / focal_px;
                if !self.depth_mm.contains(&depth_mm) || !self.seen_mm.contains(&seen_mm) {
                    continue;
                }
                if self.alike.len() == ALIKE_MAX {
                    return false;
                }
                let along = r.at_px.x / axes.px_per_radian[1];
                self.alike.push(Alike { left: n, offset_px: apart_px.y, along });
            }
        }
        true
    }

    /// Most votes, for which turn, and most of those for other ones: what is no end of a part, as the grain of a dark wall, votes
    /// for many turns alike.
    fn most_votes(&self, axes: &Axes) -> (u32, Vector3<f64>, u32) {
        let most = |rim_px: i32| {
            let votes = self.votes_for_rows(f64::from(rim_px)).into_iter().enumerate();
            votes.max_by_key(|&(row, votes)| (votes, Reverse(row))).map(|(row, votes)| (votes, row, rim_px))
        };
        let rims_px = -RIM_PX_MAX..=RIM_PX_MAX;
        let best = rims_px.filter_map(most).max_by_key(|&(votes, _, rim_px)| (votes, Reverse(rim_px.abs())));
        let (votes, row, rim_px) = best.unwrap_or_default();
        let rim_px = f64::from(rim_px);
        let others = self.votes_for_rows(rim_px).into_iter().enumerate();
        let rival =
            others.filter(|(other, _)| other.abs_diff(row) > APART_STEPS).map(|(_, votes)| votes).max();
        let px = self.mean_turn(row as f64 * ROWS_STEP_PX - ROWS_PX_MAX, rim_px);
        let turn = Vector3::new(px.x / axes.px_per_radian[0], 0.0, -px.y / axes.px_per_radian[1]);
        (votes, axes.left_from_axes * turn, rival.unwrap_or(0))
    }

    /// The votes for all turns across the baseline, with this one about the line of sight.
    fn votes_for_rows(&self, rim_px: f64) -> [u32; ROWS] {
        let mut votes = [0; ROWS];
        for group in self.of_left_ends() {
            let mut voted = 0u128;
            for alike in group {
                let row = ((alike.offset_px - rim_px * alike.along + ROWS_PX_MAX) / ROWS_STEP_PX).round();
                for row in (-ON_LINE_STEPS..=ON_LINE_STEPS).map(|step| row + f64::from(step)) {
                    voted |= if (0.0..ROWS as f64).contains(&row) { 1 << row as u32 } else { 0 };
                }
            }
            for (row, votes) in votes.iter_mut().enumerate() {
                *votes += (voted >> row & 1) as u32;
            }
        }
        votes
    }

    /// The turn, in pixels across the baseline and at the rim, that the ends tell together which voted for this one.
    fn mean_turn(&self, rows_px: f64, rim_px: f64) -> Vector2<f64> {
        let off = |alike: &Alike| alike.offset_px - rows_px - rim_px * alike.along;
        // Where all are in one place along the baseline nothing tells the second from the first.
        let mut normal = Matrix2::new(0.0, 0.0, 0.0, 0.1);
        let mut right_side = Vector2::zeros();
        for group in self.of_left_ends() {
            let nearest = group.iter().min_by(|a, b| off(a).abs().total_cmp(&off(b).abs()));
            if let Some(alike) = nearest.filter(|alike| off(alike).abs() <= ON_LINE_PX) {
                let row = Vector2::new(1.0, alike.along);
                normal += row * row.transpose();
                right_side += row * off(alike);
            }
        }
        let more = normal.try_inverse().map_or(Vector2::zeros(), |inverse| inverse * right_side);
        Vector2::new(rows_px, rim_px) + more
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};

    use super::*;
    use crate::rig::CameraModel;

    /// The votes of left ends that have ends like them so many pixels off their lines, each somewhere along the baseline.
    fn most_votes(offsets_px: impl Iterator<Item = Vec<f64>>) -> (u32, f64, u32) {
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(1);
        let mut votes = Votes::new([3.0; 2], [400.0, 600.0]);
        for (left, offsets_px) in offsets_px.enumerate() {
            let along = rng.random_range(-1.0..1.0);
            votes.alike.extend(offsets_px.into_iter().map(|offset_px| Alike { left, offset_px, along }));
        }
        let camera = CameraModel::pinhole(640, 480, 700.0, 320.0, 240.0);
        let right_from_left = nalgebra::Isometry3::translation(-60.0, 0.0, 0.0);
        let axes = Axes::of(&Rig { left: camera, right: camera, right_from_left }).unwrap();
        let (most, turn, rival) = votes.most_votes(&axes);
        (most, (axes.left_from_axes.tr_mul(&turn).x * 700.0), rival)
    }

    #[test]
    fn ends_of_parts_agree_on_a_turn_and_those_of_grain_on_none() {
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(2);
        let mut any = |range: std::ops::Range<f64>| rng.random_range(range);
        // Each end has its like, and another by chance.
        let parts: Vec<_> = (0..20).map(|_| vec![6.0 + any(-0.4..0.4), any(-30.0..30.0)]).collect();
        let (most, rows_px, rival) = most_votes(parts.into_iter());
        assert!(
            (rows_px - 6.0).abs() < 0.2 && are_more(most, rival, RIVAL_TIMES_MIN),
            "{most} {rows_px} {rival}"
        );
        // Grain of a wall that lies aslant: many like it somewhere along that.
        let grain: Vec<_> = (0..90).map(|_| (0..4).map(|_| any(-16.0..-4.0)).collect()).collect();
        let (most, rows_px, rival) = most_votes(grain.into_iter());
        assert!(!are_more(most, rival, RIVAL_TIMES_MIN), "{most} {rows_px} {rival}");
    }
}
