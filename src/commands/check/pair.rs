//! What `check` finds in one pair of pictures: it recognises them, as the cell would.

use super::Findings;
use crate::config::Cell;
use crate::frame::FramePair;
use crate::part::Part;
use crate::recognize::{NoPick, Recognition, Recognizer};
use crate::rig::Rig;
use crate::time::Budget;

/// Enough for any pair.
const ITERATIONS: u64 = 100_000;

/// Recognises a pair; `name` is its name for people.
pub(super) fn check(cell: &Cell, rig: &Rig, frames: &FramePair, name: &str, findings: &mut Findings) {
    // What is wrong with parts and region is told elsewhere.
    let Ok(parts) = Part::read_all(&cell.recognition.parts) else { return };
    let Ok(mut recognizer) = Recognizer::new(cell.recognition_params(), *rig, parts) else { return };
    let mut found = Recognition::default();
    match recognizer.run(frames, Budget::Iterations(ITERATIONS), cell.recognition.seed, &mut found) {
        Ok(()) => {
            let free = found.parts.iter().filter(|part| part.blocked.is_none()).count();
            let no_pick = found.no_pick.map(|reason| format!("; no pick: {reason}")).unwrap_or_default();
            let parts = found.parts.len();
            let seen = format!("{name}: parts {parts}, to be picked {free}{no_pick}");
            let doubt = found.turned.and_then(|turned| Some((turned.doubt?, turned)));
            match (doubt, found.no_pick) {
                (Some((doubt, turned)), _) => findings.warning(
                    "recognition",
                    format!("{seen}; {turned}; {doubt}"),
                    "calibrate again, or look whether the calibration is that of these cameras",
                ),
                (None, Some(NoPick::NothingRecognised)) => findings.warning(
                    "recognition",
                    seen,
                    "look at the pictures of `pickcell recognize --stages`, the part files and the calibration",
                ),
                (None, Some(NoPick::BinEmpty)) => findings.warning(
                    "recognition",
                    seen,
                    "put parts under the cameras; if some are there, look at recognition.colour, inverted and region_px",
                ),
                _ => findings.ok("recognition", seen),
            }
        }
        Err(refusal) => findings.warning(
            "recognition",
            format!("{name}: {refusal}"),
            "`run` offers nothing of such a pair; `pickcell recognize --stages` shows what was seen",
        ),
    }
}
