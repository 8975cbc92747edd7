//! What `check` finds in one pair of pictures: it recognises them, as the cell would.

use super::Findings;
use crate::config::Cell;
use crate::frame::FramePair;
use crate::part::Part;
use crate::recognize::{Recognition, Recognizer};
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
            findings.ok("recognition", format!("{name}: {parts} parts, {free} can be picked{no_pick}"));
        }
        Err(refusal) => findings.warning(
            "recognition",
            format!("{name}: {refusal}"),
            "put parts under the cameras, and change light, [recognition] or calibration until a pair is recognised",
        ),
    }
}
