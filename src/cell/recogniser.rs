//! One pair of the cell through recognition, its result as the core needs it.

use firmware_bridge::message::Pose;

use super::core::{Candidate, Found, Grasp, Nothing};
use super::desk::{File, Work};
use crate::grasp;
use crate::recognize::{NoPick, Recognizer, Refusal};
use crate::time::Timestamp;
use crate::vision::binarize;

/// Recognises the pair of `work` into its file. Grasps can be candidates only `in_base`: if the rig says where the
/// cameras stand.
pub fn recognise(recognizer: &mut Recognizer, work: &mut Work, in_base: bool) -> Found {
    let Work { job, file } = work;
    file.begun = Timestamp::now();
    let result = recognizer.run(&file.pair, job.budget, job.seed, &mut file.recognition);
    file.refusal = result.err();
    file.finished = Timestamp::now();
    file.refusal.map_or_else(|| found(file, in_base), |refusal| Found::nothing(nothing_in(&refusal)))
}

fn nothing_in(refusal: &Refusal) -> Nothing {
    match refusal {
        Refusal::Graph { .. } | Refusal::Binarize { reason: binarize::Refusal::Specks { .. }, .. } => {
            Nothing::OverLimits
        }
        Refusal::Size { .. } | Refusal::Damaged { .. } | Refusal::Binarize { .. } => Nothing::BadPicture,
        Refusal::Same | Refusal::Exchanged => Nothing::MixedUp,
        Refusal::White { .. } => Nothing::White,
        Refusal::Black { .. } => Nothing::Black,
        Refusal::Noise { .. } => Nothing::Noise,
        Refusal::Flat { .. } => Nothing::Flat,
    }
}

fn found(file: &File, in_base: bool) -> Found {
    let recognition = &file.recognition;
    let mut found = Found {
        parts: u16::try_from(recognition.parts.len()).unwrap_or(u16::MAX),
        iterations: recognition.spent.iterations,
        nothing: recognition.no_pick.map(|reason| match reason {
            NoPick::BinEmpty => Nothing::BinEmpty,
            NoPick::NothingRecognised => Nothing::NothingRecognised,
            NoPick::AllBlocked => Nothing::AllBlocked,
            NoPick::OutOfTime => Nothing::OutOfTime,
        }),
        ..Found::default()
    };
    let free = recognition.parts.iter().filter(|part| part.blocked.is_none());
    if in_base {
        free.for_each(|part| found.push(candidate_of(part.part, part.fitness, &part.grasp)));
    } else if free.count() > 0 {
        found.nothing = Some(Nothing::NoBase);
    }
    found
}

fn candidate_of(part: usize, fitness: f64, grasp: &grasp::Grasp) -> Candidate {
    let rotation = grasp.orientation.quaternion();
    Candidate {
        part: u16::try_from(part).unwrap_or(u16::MAX),
        fitness: fitness as f32,
        grasp: Grasp(Pose {
            position_mm: grasp.position_mm.coords.into(),
            orientation_xyzw: [rotation.i, rotation.j, rotation.k, rotation.w],
        }),
        opening_mm: grasp.opening_mm,
        slid_mm: grasp.slid_mm,
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};

    use super::*;
    use crate::cell::core;
    use crate::grasp::Placed;
    use crate::part::Part;
    use crate::pose::model::PoseModel;
    use crate::recognize::Side;

    #[test]
    fn a_picture_that_shows_nothing_is_told_as_what_it_is() {
        let side = Side::Right;
        let told = |refusal| core::NoPick::Nothing(nothing_in(&refusal)).to_string();
        assert_eq!(told(Refusal::White { side }), "picture white all over");
        assert_eq!(told(Refusal::Black { side }), "picture black all over");
        assert_eq!(told(Refusal::Noise { side }), "picture is noise");
        assert_eq!(told(Refusal::Flat { side }), "picture the same all over");
        let reason = binarize::Refusal::Specks { specks_max: 1 };
        assert_eq!(told(Refusal::Binarize { side, reason }), "picture over limits");
        assert_eq!(core::NoPick::Late.to_string(), "too late");
    }

    #[test]
    fn a_part_is_told_by_where_its_file_has_the_grasp_wherever_it_is_taken() {
        let rod = Part::read(concat!(env!("CARGO_MANIFEST_DIR"), "/replay/parts/rod-90.toml")).unwrap();
        let model = PoseModel::new(&rod);
        let turn = UnitQuaternion::from_euler_angles(0.2, -0.3, 1.1);
        let pose = nalgebra::Isometry3::from_parts(Vector3::new(10.0, 20.0, 480.0).into(), turn);
        let placed = Placed { part: &rod, model: &model, left_from_part: &pose, sigma_mm: Vector3::zeros() };
        let filed = grasp::grasp_of(&grasp::Params::default(), &placed);
        let slid =
            grasp::Grasp { position_mm: filed.position_mm + filed.axis * 12.0, slid_mm: 12.0, ..filed };
        let candidate = candidate_of(0, 0.1, &slid);
        let [x, y, z] = candidate.filed_mm();
        assert!((Vector3::new(x, y, z) - filed.position_mm.coords).norm() < 1e-9);
        assert!((Vector3::from(candidate.grasp.0.position_mm) - slid.position_mm.coords).norm() < 1e-12);
    }
}
