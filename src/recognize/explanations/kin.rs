//! Parts of about the same shape, of thicker and of thinner wire: their poses are the same, and nothing but the width that their
//! wire is seen with tells them apart.
//!
//! A bright line along dull wire makes it narrower; the light across it tells by how much. What is left light makes of all wire
//! of a bin alike. So the usual width is that at which most explanations agree, and
//! where that leaves a choice, as with one part alone, the one that light makes as a rule.

use arrayvec::ArrayVec;
use nalgebra::{Isometry3, Point3};

use super::{Explanation, Explanations, Scene};
use crate::matching::select;
use crate::part::NODES_MAX;
use crate::recognize::lamp::Light;
use crate::recognize::prepared::Prepared;

/// Parts have about the same shape where no distance between nodes or bends differs by more than this share of their length.
const SHAPE_SHARE: f64 = 0.1;
/// What wire costs that is seen e times as wide or as narrow as usual, in mm.
const WIDTH_MM: f64 = 30.0;
/// How much nearer to the usual width that of a part must be than that of its kin, as a logarithm; and, were all parts that kin,
/// how much farther the usual width would be from that as a rule: dim light makes all wire of a bin a fifth narrower.
const TELL_APART_LN: f64 = 0.12;
const TELL_USUAL_LN: f64 = 0.18;
/// By how many standard deviations of the widths in a bin thicknesses must differ. Before any width is seen that deviation is taken
/// for this, as a logarithm, which then counts as one part.
const TELL_APART_SIGMAS: f64 = 5.0;
const SIGMA_LN: f64 = 0.08;
/// How full of light wire is across as a rule, see [`crate::pose::section::LightAcross::full`], and how much wider, as a logarithm, it
/// is seen per such unit: of rendered rods of 20 rigs, dull ones and bright ones in one bin, the widths differ by 2 to 4 % with that
/// (standard deviation) instead of 5 to 8 %; by 7 % instead of 10 % in bad light, 10 % instead of 12 % where they are 5 pixels wide.
const FULL: f64 = 0.72;
const WIDER_PER_FULL: f64 = 1.3;
/// Widths whose quotient has a logarithm below this agree somewhat; and how much less the usual width is worth, as a share of
/// all explanations, that is e times another than as a rule.
const AGREE: f64 = 0.12;
const AS_A_RULE: f64 = 0.25;
/// So many widths are tried above and below that as a rule, four to where two agree no more: half as wide to twice as wide.
const WIDTHS: u32 = 24;
/// Two parts at the same place whose worth differs by less, in mm, apart from what their width costs, cannot be told apart by
/// anything but that.
const TELL_APART_MM: f64 = 2.0;
/// Their nodes are nearer than this then, in mm, in the mean; and where they are nearer than that, nothing but their width may.
const SAME_PLACE_MM: f64 = 4.0;
const SAME_ENDS_MM: f64 = 0.5;
/// Of wire thinner than this in a picture, in pixels, the width says nothing: blur makes it up.
const TELLING_PX_MIN: f64 = 3.0;

impl Prepared {
    /// Whether another part has about the same shape as this one, and may be of other wire.
    fn is_kin(&self, other: &Self) -> bool {
        let [a, b] = [self, other].map(|p| p.pose_model());
        let off_mm = SHAPE_SHARE * a.length_mm.max(b.length_mm);
        !std::ptr::eq(self, other)
            && (a.length_mm - b.length_mm).abs() <= off_mm
            && self.distances_mm.len() == other.distances_mm.len()
            && self.distances_mm.iter().zip(&other.distances_mm).all(|(a, b)| (a - b).abs() <= off_mm)
    }

    /// Whether another part need not explain wire again that this one has for certain.
    pub(super) fn settles_for(&self, other: &Self) -> bool {
        other.pose_model().length_mm <= self.pose_model().length_mm && !self.is_kin(other)
    }
}

/// For each part whether it has kin.
pub(super) fn have_kin(parts: &[Prepared]) -> Vec<bool> {
    parts.iter().map(|part| parts.iter().any(|other| part.is_kin(other))).collect()
}

impl Explanations {
    /// Finds what speaks against the thickness of the wire of parts that have kin.
    pub(super) fn weigh_kin(&mut self) {
        if !self.have_kin.contains(&true) {
            return;
        }
        self.usual_width_ln = self.usual_width_ln();
        for e in &mut self.list[..self.count] {
            e.unusual_ln = e.width_ratio.map_or(0.0, |width| (width.ln() - self.usual_width_ln).abs());
        }
    }

    /// How wide the wire of one is seen over how wide such is as a rule in its light, if that can tell it from its kin.
    pub(super) fn width_in_its_light(&self, index: usize, scene: &Scene) -> Option<f64> {
        let Explanation { hypothesis, verdict, .. } = &self.list[index];
        let ratio = verdict.width_ratio.filter(|_| self.have_kin[hypothesis.part])?;
        if scene.views.iter().any(|view| view.profiler.dark_parts() || view.profiler.is_polished()) {
            return Some(ratio);
        }
        let light = Light::on(scene.parts[hypothesis.part].pose_model(), verdict, &scene.views);
        Some(ratio * (WIDER_PER_FULL * (FULL - light.full?)).exp())
    }

    /// How wide the wire of this pair is seen, over how wide it is as a rule, as a logarithm.
    fn usual_width_ln(&self) -> f64 {
        let is_known = |e: &&Explanation| select::is_sound(&e.fit, &e.verdict, e.overrun_mm);
        let widths = || self.all().iter().filter(is_known).filter_map(|e| e.width_ratio);
        let agreement = |usual_ln: f64| {
            let agrees = |width: f64| (1.0 - (width.ln() - usual_ln).abs() / AGREE).max(0.0);
            widths().map(|width| agrees(width) - AS_A_RULE * usual_ln.abs()).sum::<f64>()
        };
        let tried = (1..=WIDTHS).flat_map(|k| [1.0, -1.0].map(|way| way * f64::from(k) * (AGREE / 4.0)));
        let (mut best_ln, mut most) = (0.0, agreement(0.0));
        for usual_ln in tried {
            let agreed = agreement(usual_ln);
            if agreed > most {
                (best_ln, most) = (usual_ln, agreed);
            }
        }
        best_ln
    }

    /// Standard deviation of the widths of those that stand from what they should be, as a logarithm.
    fn width_sigma_ln(&self) -> f64 {
        let known =
            || self.standing.iter().map(|&index| &self.list[index]).filter(|e| e.width_ratio.is_some());
        let squares = known().map(|e| e.unusual_ln.powi(2)).sum::<f64>() + SIGMA_LN * SIGMA_LN;
        (squares / (known().count() + 1) as f64).sqrt()
    }

    /// Whether one that stands could as well be a part of thicker or thinner wire.
    pub(super) fn may_be_kin(&self, index: usize, parts: &[Prepared]) -> bool {
        let standing = &self.list[index];
        let part = standing.hypothesis.part;
        if !self.have_kin[part] {
            return false;
        }
        let (prepared, pose) = (&parts[part], &standing.fit.left_from_part);
        let thinnest_px = standing.verdict.pieces.iter().flatten().map(|seen| 2.0 * seen.half_width_px);
        let is_thin = thinnest_px.fold(f64::INFINITY, f64::min) < TELLING_PX_MIN;
        let sigma_ln = self.width_sigma_ln();
        let is_told = |e: &Explanation, thicker_ln: f64| {
            let (Some(width), Some(as_kin)) = (standing.width_ratio, e.width_ratio) else { return false };
            let usual_of_kin_ln = self.usual_width_ln + (as_kin / width).ln();
            !is_thin
                && thicker_ln > TELL_APART_SIGMAS * sigma_ln
                && usual_of_kin_ln.abs() > self.usual_width_ln.abs() + TELL_USUAL_LN
                && e.unusual_ln > standing.unusual_ln + TELL_APART_LN
        };
        self.all().iter().any(|e| {
            let other = &parts[e.hypothesis.part];
            let [radius, other_radius] = [prepared, other].map(|p| p.pose_model().radius_mm);
            let thicker_ln = (radius / other_radius).ln().abs();
            if !prepared.is_kin(other) || is_told(e, thicker_ln) {
                return false;
            }
            // With its ends just there a thinner or thicker one may be it whatever it is worth: whether all are seen is chance.
            let worth_mm = |e: &Explanation| e.alone.now_mm + e.kin_mm();
            let less_mm = worth_mm(standing) - worth_mm(e);
            match ends_apart_mm([prepared, other], [pose, &e.fit.left_from_part]) {
                ..SAME_ENDS_MM if thicker_ln > 0.0 => e.alone.now_mm > 0.0,
                ..SAME_PLACE_MM => is_thin && thicker_ln > 0.0 || less_mm < TELL_APART_MM,
                _ => false,
            }
        })
    }
}

impl Explanation {
    /// What speaks against the thickness of its wire, in mm.
    pub(super) fn kin_mm(&self) -> f64 {
        WIDTH_MM * self.unusual_ln
    }
}

/// How far the free ends of a part, or its nodes where it has none, lie from the nearest ones of another, in the mean.
fn ends_apart_mm([one, other]: [&Prepared; 2], [a, b]: [&Isometry3<f64>; 2]) -> f64 {
    let mine = ends_of(one);
    let theirs = ends_of(other);
    let nearest_mm = |mine: &Point3<f64>| {
        theirs.iter().map(|theirs| (a * mine - b * theirs).norm()).fold(f64::MAX, f64::min)
    };
    mine.iter().map(nearest_mm).sum::<f64>() / mine.len().max(1) as f64
}

fn ends_of(prepared: &Prepared) -> ArrayVec<Point3<f64>, NODES_MAX> {
    let ends = &prepared.pose_model().ends;
    let nodes = prepared.part.nodes.iter().filter(|_| ends.is_empty());
    ends.iter().map(|end| end.position_mm).chain(nodes.map(|node| node.position_mm)).collect()
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::frame::FramePair;
    use crate::part::Part;
    use crate::pose::drawn::DrawnPair;
    use crate::pose::model::PoseModel;
    use crate::recognize::{Params, Recognition, Recognizer};
    use crate::time::Budget;

    fn rod(thickness_mm: f64) -> Part {
        let text = format!(
            "name='{thickness_mm}'\nthickness_mm={thickness_mm}\n\
             node=[{{name='a',position_mm=[-35,0,0]}},{{name='b',position_mm=[35,0,0]}}]\n\
             edge=[{{from='a',to='b'}}]\n\
             [grasp]\nposition_mm=[0,0,0]\napproach=[0,0,-1]\nclosing=[0,1,0]\nwidth_mm=8\n"
        );
        Part::parse(&text, "rod.toml").unwrap()
    }

    /// What level rods of these thicknesses, one beside the other, are recognised as, from left to right, and which of them are
    /// proven; with files for rods of these thicknesses.
    fn recognised(lying: &[f64], files: &[f64]) -> Vec<(f64, bool)> {
        let models: Vec<PoseModel> =
            lying.iter().map(|thickness_mm| PoseModel::new(&rod(*thickness_mm))).collect();
        let pose = |k: usize| {
            let at = Vector3::new(40.0 * k as f64 - 60.0, 0.0, 500.0);
            nalgebra::Isometry3::new(at, Vector3::z() * (1.2 + 0.1 * k as f64))
        };
        let placed: Vec<_> = models.iter().enumerate().map(|(k, model)| (model, pose(k))).collect();
        let drawn = DrawnPair::new(&placed);
        let [left, right] = drawn.frames;
        let parts = files.iter().map(|thickness_mm| rod(*thickness_mm)).collect();
        let mut recognizer = Recognizer::new(Params::default(), drawn.rig, parts).unwrap();
        let mut out = Recognition::default();
        recognizer.run(&FramePair { left, right }, Budget::Iterations(100_000), 1, &mut out).unwrap();
        out.parts.sort_by(|a, b| a.grasp.position_mm.x.total_cmp(&b.grasp.position_mm.x));
        out.parts.iter().map(|found| (files[found.part], found.proven)).collect()
    }

    #[test]
    fn rods_that_differ_in_thickness_alone_are_told_apart_whatever_the_order_of_their_files() {
        let lying = [3.0, 4.2, 3.0, 4.2];
        let expected = lying.map(|thickness_mm| (thickness_mm, true));
        for files in [[3.0, 4.2, 1.8], [1.8, 4.2, 3.0], [4.2, 3.0, 1.8]] {
            assert_eq!(recognised(&lying, &files), expected, "{files:?}");
        }
    }

    /// A rectangle with a bar across it: it has no end.
    fn theta(thickness_mm: f64) -> Part {
        let text = format!(
            "name='{thickness_mm}'\nthickness_mm={thickness_mm}\n\
             node=[{{name='a',position_mm=[-12,0,0]}},{{name='b',position_mm=[12,0,0]}}]\n\
             edge=[{{from='a',to='b'}},{{from='a',to='b',via=[[-12,14,0],[12,14,0]]}},\
             {{from='a',to='b',via=[[-12,-14,0],[12,-14,0]]}}]\n\
             [grasp]\nposition_mm=[0,0,0]\napproach=[0,0,-1]\nclosing=[0,1,0]\nwidth_mm=8\n"
        );
        Part::parse(&text, "theta.toml").unwrap()
    }

    #[test]
    fn kin_without_ends_lie_where_their_nodes_do() {
        for part in [rod, theta] {
            let parts = [2.0, 3.4].map(|thickness_mm| Prepared::new(part(thickness_mm)));
            let place = |x: f64| nalgebra::Isometry3::translation(x, 0.0, 500.0);
            let apart_mm = |x: f64| ends_apart_mm(parts.each_ref(), [&place(0.0), &place(x)]);
            assert_eq!([apart_mm(0.0), apart_mm(5.0)], [0.0, 5.0]);
            assert!(apart_mm(200.0) > 100.0);
        }
    }

    #[test]
    fn what_may_as_well_be_another_part_is_not_proven() {
        for other_mm in [3.0, 3.05, 3.2, 3.6] {
            let found = recognised(&[3.0, 3.0], &[3.0, other_mm]);
            assert!(found.len() == 2 && found.iter().all(|(_, proven)| !proven), "{found:?}");
        }
        assert_eq!(recognised(&[3.0, 3.0], &[3.0]), [(3.0, true); 2]);
        // Thin wire, whose width blur makes.
        let found = recognised(&[1.0, 1.0], &[1.0, 1.5]);
        assert!(found.len() == 2 && found.iter().all(|(_, proven)| !proven), "{found:?}");
        assert_eq!(recognised(&[1.0, 1.0], &[1.0]), [(1.0, true); 2]);
    }
}
