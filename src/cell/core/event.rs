//! What happens to the cell: all that its core ever learns. A recording is a list of these with their times.

use firmware_bridge::message::{Pose, Refusal, Report};
use serde::{Deserialize, Serialize};

use crate::camera::{Side, Trouble};
use crate::cell::pairing::FrameSeen;

/// Most candidates that one recognition hands to the core, best first.
pub const CANDIDATES_MAX: usize = 8;

/// One thing that happened.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[expect(
    clippy::large_enum_variant,
    reason = "events are handed over by value; nothing may be allocated for them"
)]
pub enum Event {
    /// A camera delivered a frame.
    Frame(FrameSeen),
    /// A camera gives no frames, or still none for another reason.
    CameraLost {
        /// Which.
        side: Side,
        /// Why.
        trouble: Trouble,
    },
    /// It was opened again.
    CameraBack {
        /// Which.
        side: Side,
    },
    /// A recorded session is over on this side.
    CameraEnded {
        /// Which.
        side: Side,
    },
    /// The recogniser is finished with a pair.
    Recognised {
        /// Number of the pair.
        pair: u64,
        /// What it found.
        found: Found,
    },
    /// The arm's side said something.
    Arm(Report),
    /// The arm's side did not take a pick at all.
    NotTaken {
        /// The pick.
        id: u64,
        /// Why.
        refusal: Refusal,
    },
    /// A place record is written and synced.
    Persisted(PlaceRecord),
    /// It could not be written.
    NotPersisted,
    /// The operator wants something.
    Operator(Operator),
    /// The machine was suspended to RAM for so long; it goes on now.
    Suspended {
        /// On the cell's clock, ns.
        for_ns: i64,
    },
    /// The program is asked to end.
    Stop,
    /// Nothing but time passed.
    Tick,
}

/// What an operator can say.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Operator {
    /// Stop moving and stay.
    Hold,
    /// The hold ends.
    Release,
}

/// One part that can be picked.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Candidate {
    /// Which part file, counted from 0.
    pub part: u16,
    /// Fitness of the match, smaller is better.
    pub fitness: f32,
    /// Where to grasp, in the base frame.
    pub grasp: Grasp,
    /// Distance of the fingers at the approach, mm.
    pub opening_mm: f64,
    /// How far along the wire the grasp is from where the part file has it, mm.
    #[serde(default)]
    pub slid_mm: f64,
}

impl Candidate {
    /// Where the part file has its grasp, in the base frame: there the part is found again in the next pair, wherever on it
    /// there is room then.
    pub(in crate::cell) fn filed_mm(&self) -> [f64; 3] {
        let Pose { position_mm, .. } = self.grasp.0;
        let wire = self.grasp.0.wire();
        std::array::from_fn(|k| position_mm[k] - self.slid_mm * wire[k])
    }
}

/// A grasp pose that has a default: at the origin, pointing straight down.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Grasp(pub Pose);

impl Default for Grasp {
    fn default() -> Self {
        Grasp(Pose { position_mm: [0.0; 3], orientation_xyzw: [1.0, 0.0, 0.0, 0.0] })
    }
}

/// Why a recognition offers nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Nothing {
    /// There is nothing in the bin.
    BinEmpty,
    /// There is something, but none of the parts.
    NothingRecognised,
    /// Parts were recognised and every one of them is blocked.
    AllBlocked,
    /// The budget, in time or in iterations, was spent before anything that can be taken was recognised.
    OutOfTime,
    /// A picture could not be decoded or has another size than the calibration.
    BadPicture,
    /// A picture goes over a stated limit (too many specks, nodes or lines).
    OverLimits,
    /// Parts were recognised, but cell.toml does not say where the cameras stand (`rig.base_from_left`).
    NoBase,
    /// Both pictures are of one camera, or each is the other camera's.
    MixedUp,
    /// A picture is white all over.
    White,
    /// A picture is black all over.
    Black,
    /// A picture is noise and nothing else.
    Noise,
    /// A picture is the same all over. The last, as [`NoPick::kind`](super::NoPick::kind) counts on.
    Flat,
}

/// What a recognition found, as far as decisions go.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Found {
    /// Parts that can be picked, best first; `count` of them.
    pub candidates: [Candidate; CANDIDATES_MAX],
    /// How many candidates there are.
    pub count: u8,
    /// Parts recognised, those that cannot be picked too.
    pub parts: u16,
    /// Why there is no candidate.
    pub nothing: Option<Nothing>,
    /// Iterations that the search used: the budget of a replay.
    pub iterations: u64,
}

impl Found {
    /// A result without a part.
    pub fn nothing(why: Nothing) -> Self {
        Self { nothing: Some(why), ..Self::default() }
    }

    /// The candidates, best first.
    pub fn candidates(&self) -> &[Candidate] {
        &self.candidates[..usize::from(self.count).min(CANDIDATES_MAX)]
    }

    /// Appends a candidate; those beyond [`CANDIDATES_MAX`] are left out.
    pub fn push(&mut self, candidate: Candidate) {
        if usize::from(self.count) < CANDIDATES_MAX {
            self.candidates[usize::from(self.count)] = candidate;
            self.count += 1;
        }
    }
}

/// What survives a restart: how far the place pattern is filled, and the target whose end is not known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlaceRecord {
    /// Slots below this one are used up.
    pub next_slot: u32,
    /// Target numbers below this one were given away.
    pub next_id: u64,
    /// The target that may put a part into `next_slot`; 0: none.
    #[serde(default)]
    pub unfinished_id: u64,
}
