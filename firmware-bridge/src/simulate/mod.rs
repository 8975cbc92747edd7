//! Simulated arms: the firmware's end of every dialect, with plausible timing and faults on demand.
//!
//! Takes the bytes that the cell sent and the time; gives the bytes that the firmware answers and a list of what
//! the arm physically did ([`Motion`]). Like the dialects these are state machines without a device or a clock:
//! tests drive them on a simulated clock, `firmware-bridge simulate` behind a pty, the driver in its own process.
//!
//! Every firmware has the same shape: `on_bytes(bytes, now_ns)`, `poll(now_ns) -> Option<Motion>` (until `None`),
//! `transmit(now_ns, out) -> usize` (bytes to answer now), `next_deadline_ns()`, and `reset(now_ns)` (somebody
//! pressed the button: it restarts at once, forgets everything and says its banner).

use serde::{Deserialize, Serialize};

/// What a simulated arm physically does; the campaigns judge these, not what the wire says.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Motion {
    /// It starts towards this point of the base frame.
    Began {
        /// Where to, mm.
        to_mm: [f64; 3],
    },
    /// It has arrived.
    Arrived {
        /// Where, mm.
        at_mm: [f64; 3],
    },
    /// It stopped on the way.
    Stopped {
        /// Where, mm.
        at_mm: [f64; 3],
    },
    /// The fingers closed.
    Closed {
        /// Whether a part is between them.
        holds_part: bool,
    },
    /// The fingers opened.
    Opened,
    /// The controller restarted.
    Restarted,
}

/// What can go wrong with an arm, on demand.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Fault {
    /// It says nothing for a while (and goes on moving).
    Silence,
    /// Random bytes come between its answers.
    Garbage,
    /// Bytes get lost, both ways.
    LostBytes,
    /// Bytes arrive twice, both ways.
    DoubledBytes,
    /// It restarts in the middle of a motion.
    Reset,
    /// It refuses a target.
    Refused,
    /// The gripper closes on nothing.
    NotHeld,
    /// It moves at a tenth of its speed.
    Slow,
}

/// The faults of one simulated arm: which, and how often. Drawn from a seed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Faults {
    /// Seed of the draws.
    pub seed: u64,
    /// Bit set over [`Fault`] (`1 << fault as u32`).
    pub set: u32,
}

impl Faults {
    /// From a list, as on the command line.
    pub fn new(seed: u64, faults: &[Fault]) -> Self {
        Self { seed, set: faults.iter().fold(0, |set, &fault| set | 1 << fault as u32) }
    }

    /// Whether this fault may happen.
    pub fn has(&self, fault: Fault) -> bool {
        self.set & (1 << fault as u32) != 0
    }
}
