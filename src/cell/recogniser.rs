//! One pair of the cell through recognition, its result as the core needs it.

use firmware_bridge::message::Pose;

use super::core::{Candidate, Found, Grasp, Nothing};
use super::desk::{File, Work};
use crate::recognize::{FoundPart, NoPick, Recognizer, Refusal};
use crate::time::Timestamp;

/// Recognises the pair of `work` into its file. Grasps can be candidates only `in_base`: if the rig says where the
/// cameras stand.
pub fn recognise(recognizer: &mut Recognizer, work: &mut Work, in_base: bool) -> Found {
    let Work { job, file } = work;
    file.begun = Timestamp::now();
    let result = recognizer.run(&file.pair, job.budget, job.seed, &mut file.recognition);
    file.refusal = result.err();
    file.finished = Timestamp::now();
    match &file.refusal {
        Some(Refusal::Size { .. } | Refusal::Damaged { .. } | Refusal::Binarize { .. }) => {
            Found::nothing(Nothing::BadPicture)
        }
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
        free.for_each(|part| found.push(candidate(part)));
    } else if free.count() > 0 {
        found.nothing = Some(Nothing::NoBase);
    }
    found
}

fn candidate(part: &FoundPart) -> Candidate {
    let rotation = part.grasp.orientation.quaternion();
    Candidate {
        part: u16::try_from(part.part).unwrap_or(u16::MAX),
        fitness: part.fitness as f32,
        grasp: Grasp(Pose {
            position_mm: part.grasp.position_mm.coords.into(),
            orientation_xyzw: [rotation.i, rotation.j, rotation.k, rotation.w],
        }),
        opening_mm: part.grasp.opening_mm,
    }
}
