//! Simulated arms: the firmware's end of every dialect, with plausible timing and faults on demand.
//!
//! Takes the bytes that the cell sent and the time; gives the bytes that the firmware answers and a list of what
//! the arm physically did ([`Motion`]). Like the dialects these are state machines without a device or a clock:
//! tests drive them on a simulated clock, `firmware-bridge simulate` behind a pty, the driver in its own process.
//!
//! [`SimulatedArm`] is what others use; it holds a [`Firmware`]. Every firmware has the same shape: `on_bytes(bytes, now_ns)`, `poll(now_ns) -> Option<Motion>` (until `None`),
//! `transmit(now_ns, out) -> usize` (bytes to answer now), `next_deadline_ns()`, `reset(now_ns)` (somebody pressed the
//! button: it restarts at once, forgets everything and says its banner) and `heal()` (no further faults).

mod body;
mod grbl;
mod grbl_block;
mod marlin;
mod motion;
mod noise;
mod own;
mod uarm;

use crate::config::DialectName;
pub use body::Body;
pub use grbl::GrblFirmware;
pub use marlin::MarlinFirmware;
pub use own::OwnFirmware;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
pub use uarm::UarmFirmware;

/// A firmware of one dialect.
#[derive(Debug)]
#[allow(clippy::large_enum_variant)] // one a process, never moved after the start
pub enum Firmware {
    /// PickCell's own packets.
    Own(OwnFirmware),
    /// Grbl 1.1.
    Grbl(GrblFirmware),
    /// Marlin 2, and the uArm Swift Pro with firmware 3.
    Marlin(MarlinFirmware),
    /// uArm Swift Pro with firmware 4.
    Uarm(UarmFirmware),
}

/// Calls the same method of whichever firmware it is.
macro_rules! each {
    ($self:expr, $firmware:ident => $call:expr) => {
        match $self {
            Firmware::Own($firmware) => $call,
            Firmware::Grbl($firmware) => $call,
            Firmware::Marlin($firmware) => $call,
            Firmware::Uarm($firmware) => $call,
        }
    };
}

impl Firmware {
    fn new(dialect: DialectName, park_mm: [f64; 3], faults: Faults) -> Self {
        match dialect {
            DialectName::Own => Firmware::Own(OwnFirmware::new(park_mm, faults)),
            DialectName::Grbl => Firmware::Grbl(GrblFirmware::new(park_mm, faults)),
            DialectName::Marlin => Firmware::Marlin(MarlinFirmware::new(park_mm, faults)),
            DialectName::Uarm if faults.first_generation() => {
                Firmware::Marlin(MarlinFirmware::uarm_3(park_mm, faults))
            }
            DialectName::Uarm => Firmware::Uarm(UarmFirmware::new(park_mm, faults)),
        }
    }
}

/// Moves what fits of `said` into `out`; how much.
fn take(said: &mut VecDeque<u8>, out: &mut [u8]) -> usize {
    let len = out.len().min(said.len());
    for (to, from) in out.iter_mut().zip(said.drain(..len)) {
        *to = from;
    }
    len
}

/// A simulated arm: a firmware behind a line that may be bad.
///
/// The faults of the line (silence, garbage, lost and doubled bytes) are the same for all dialects and made here;
/// those of the arm (reset, refused, not held, slow) are the firmware's.
#[derive(Debug)]
pub struct SimulatedArm {
    firmware: Firmware,
    faults: Faults,
    rng: Pcg32,
    silent_until_ns: i64,
}

impl SimulatedArm {
    /// An arm that has just been switched on, standing at its park position out of the cameras' view.
    pub fn new(dialect: DialectName, park_mm: [f64; 3], faults: Faults) -> Self {
        Self {
            firmware: Firmware::new(dialect, park_mm, faults),
            faults,
            // Another stream than the firmware's.
            rng: Pcg32::seed_from_u64(!faults.seed),
            silent_until_ns: i64::MIN,
        }
    }

    /// Makes an arm of the own protocol move so many times as fast as an ordinary one; the others stay as they are.
    pub fn set_tempo(&mut self, tempo: f64) {
        if let Firmware::Own(firmware) = &mut self.firmware {
            firmware.set_tempo(tempo);
        }
    }

    /// Bytes that arrived over the line.
    pub fn on_bytes(&mut self, bytes: &[u8], now_ns: i64) {
        for &byte in bytes {
            for _ in 0..self.copies() {
                each!(&mut self.firmware, firmware => firmware.on_bytes(&[byte], now_ns));
            }
        }
    }

    /// Lets time pass; what the arm did. Call it until `None`.
    pub fn poll(&mut self, now_ns: i64) -> Option<Motion> {
        each!(&mut self.firmware, firmware => firmware.poll(now_ns))
    }

    /// Bytes to put on the line now; gives how many. `out` is at least 64 long.
    pub fn transmit(&mut self, now_ns: i64, out: &mut [u8]) -> usize {
        let mut said = [0; 64];
        // A third, so that doubled bytes and garbage fit as well.
        let room = (out.len() / 3).min(said.len());
        let mut len = each!(&mut self.firmware, firmware => firmware.transmit(now_ns, &mut said[..room]));
        if len > 0 && now_ns >= self.silent_until_ns && self.draw(Fault::Silence, 0.005) {
            self.silent_until_ns = now_ns + self.rng.random_range(100..1500) * 1_000_000;
        }
        while len > 0 && now_ns < self.silent_until_ns {
            len = each!(&mut self.firmware, firmware => firmware.transmit(now_ns, &mut said[..room]));
        }
        if len == 0 {
            return 0;
        }
        let mut end = 0;
        if self.draw(Fault::Garbage, 0.05) {
            end = self.rng.random_range(1..=room);
            self.rng.fill(&mut out[..end]);
        }
        for &byte in &said[..len] {
            for _ in 0..self.copies() {
                out[end] = byte;
                end += 1;
            }
        }
        end
    }

    /// From now on nothing goes wrong by itself.
    pub fn heal(&mut self) {
        self.faults.set = 0;
        self.silent_until_ns = i64::MIN;
        each!(&mut self.firmware, firmware => firmware.heal());
    }

    /// When something happens by itself.
    pub fn next_deadline_ns(&self) -> Option<i64> {
        each!(&self.firmware, firmware => firmware.next_deadline_ns())
    }

    /// Somebody pressed the button.
    pub fn reset(&mut self, now_ns: i64) {
        each!(&mut self.firmware, firmware => firmware.reset(now_ns));
    }

    /// How often this byte arrives.
    fn copies(&mut self) -> usize {
        const PER_BYTE: f64 = 0.0005;
        if self.draw(Fault::LostBytes, PER_BYTE) {
            0
        } else if self.draw(Fault::DoubledBytes, PER_BYTE) {
            2
        } else {
            1
        }
    }

    fn draw(&mut self, fault: Fault, probability: f64) -> bool {
        self.faults.has(fault) && self.rng.random_bool(probability)
    }
}

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
    #[value(alias = "lost")]
    LostBytes,
    /// Bytes arrive twice, both ways.
    #[value(alias = "doubled")]
    DoubledBytes,
    /// It restarts in the middle of a motion.
    Reset,
    /// It refuses a target.
    Refused,
    /// The gripper closes on nothing.
    #[value(alias = "part-not-held")]
    NotHeld,
    /// It begins late and moves at a tenth of its speed.
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

    /// Of two builds of a firmware that behave differently, whether it is the later one: with odd seeds.
    pub fn later_build(&self) -> bool {
        self.seed % 2 == 1
    }

    /// Of firmwares that share nothing but their purpose, whether it is the older one: with every fourth seed.
    pub fn first_generation(&self) -> bool {
        self.seed % 4 == 2
    }

    /// Whether this fault may happen.
    pub fn has(&self, fault: Fault) -> bool {
        self.set & (1 << fault as u32) != 0
    }
}
