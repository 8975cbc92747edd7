//! What the two sides publish.

use crate::message::{Command, Report};
use serde::{Deserialize, Serialize};

/// Commands that one record of the driver carries.
pub(crate) const COMMANDS: usize = 4;
/// Reports that one record of the bridge carries.
pub(crate) const REPORTS: usize = 16;

/// The driver's state.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CellRecord {
    /// Number of this life of the driver (a new one after every loss), not 0.
    pub cell: u32,
    /// The life of the bridge that this is for; 0 = not known yet.
    pub bridge: u32,
    /// When it was published, ns.
    pub sent_ns: i64,
    /// Number of the newest command, counted from 1.
    pub newest: u32,
    /// The last commands; number n at index n % 4.
    pub commands: [Option<Command>; COMMANDS],
}

/// The bridge's state.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ArmRecord {
    /// Number of this life of the bridge (a new one after every loss of the driver), not 0.
    pub bridge: u32,
    /// The life of the driver that this is for; 0 = none.
    pub cell: u32,
    /// When it was published, ns.
    pub sent_ns: i64,
    /// Number of the newest command that was carried out or refused.
    pub acked: u32,
    /// Number of the newest report, counted from 1.
    pub newest: u32,
    /// The last reports; number n at index n % 16.
    pub reports: [Option<Report>; REPORTS],
}
