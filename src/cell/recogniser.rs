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
    match &file.refusal {
        Some(Refusal::Binarize { reason: binarize::Refusal::Specks { .. }, .. }) => {
            Found::nothing(Nothing::OverLimits)
        }
        Some(Refusal::Size { .. } | Refusal::Damaged { .. } | Refusal::Binarize { .. }) => {
            Found::nothing(Nothing::BadPicture)
        }
        Some(Refusal::Same | Refusal::Exchanged) => Found::nothing(Nothing::MixedUp),
        Some(_) => Found::nothing(Nothing::OverLimits),
        None => found(file, in_base),
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
    use crate::grasp::Placed;
    use crate::part::Part;
    use crate::pose::model::PoseModel;

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
