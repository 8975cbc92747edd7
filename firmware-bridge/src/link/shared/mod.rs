//! Shared memory between the driver and `firmware-bridge run`: latest record only, both ways.
//!
//! Each side publishes its whole state (a *record*) at every change and with every heartbeat, and reads only the
//! newest record of the other side. A record carries the last few commands or reports with running numbers, so that
//! nothing is lost when one record overtakes another, and nothing is done twice.
//!
//! Either side may be killed and started again at any time, in any order. Each draws a number for its life: a record
//! that is not addressed to *this* life of the other side is only read for who is there. So a bridge never executes
//! what an earlier driver left behind, or what was meant for an earlier bridge; a new driver always gets a new
//! session from the arm, on hold; a bridge whose driver falls silent holds the arm.

mod bridge_end;
mod cell_end;
mod ports;
mod record;

pub use bridge_end::BridgeEnd;
pub use cell_end::CellEnd;
pub use ports::{Ports, Side};
pub use record::{ArmRecord, CellRecord};

use crate::config::Settings;
use crate::message::{Command, Refusal, Report};
use rustix::fd::BorrowedFd;

/// The number of the next life after `life`; a step that nobody's neighbouring seed meets.
fn next_life(life: u32) -> u32 {
    life.wrapping_mul(1_664_525).wrapping_add(1_013_904_223).max(1)
}

/// Why the shared memory cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum SharedError {
    /// Something else goes by this name.
    #[error(
        "the shared-memory service \"{service}\" is taken by something else ({detail}): choose another arm.service, the same for driver and bridge"
    )]
    Taken {
        /// Name of the service.
        service: String,
        /// What does not fit.
        detail: String,
    },
    /// A second process for the same side.
    #[error(
        "another {side} already uses the shared-memory service \"{service}\": end it, or choose another arm.service for one of the two cells"
    )]
    InUse {
        /// Name of the service.
        service: String,
        /// "driver" or "bridge".
        side: &'static str,
    },
    /// The system refuses.
    #[error(
        "the shared-memory service \"{service}\" cannot be opened ({detail}): driver and bridge must run as the same user and share /tmp and /dev/shm (PrivateTmp=no)"
    )]
    Failed {
        /// Name of the service.
        service: String,
        /// What failed.
        detail: String,
    },
}

/// The driver's end of the shared memory.
#[derive(Debug)]
pub struct SharedMemoryLink {
    end: CellEnd,
    ports: Ports,
}

impl SharedMemoryLink {
    /// Opens the service that `[arm] service` names. Whether a bridge is there shows later, as a report.
    ///
    /// # Errors
    /// The name is taken, another driver uses it, or the system refuses.
    pub fn open(settings: &Settings, session_seed: u32) -> Result<Self, SharedError> {
        let ports = Ports::open(&settings.arm.service, Side::Driver)?;
        Ok(Self { end: CellEnd::new(settings, super::life_number(session_seed)), ports })
    }

    /// See [`super::Link::command`].
    pub fn command(&mut self, command: Command, now_ns: i64) -> Result<(), Refusal> {
        let answer = self.end.command(command, now_ns);
        self.publish(now_ns);
        answer
    }

    /// See [`super::Link::poll`].
    pub fn poll(&mut self, now_ns: i64) -> Option<Report> {
        if let Some(report) = self.end.poll(now_ns) {
            return Some(report);
        }
        if let Some(record) = self.ports.receive() {
            self.end.on_record(&record, now_ns);
        }
        self.publish(now_ns);
        self.end.poll(now_ns)
    }

    /// See [`super::Link::next_deadline_ns`].
    pub fn next_deadline_ns(&self) -> Option<i64> {
        Some(self.end.next_deadline_ns())
    }

    /// What to wait for.
    pub fn fd(&self) -> Option<BorrowedFd<'_>> {
        Some(self.ports.fd())
    }

    fn publish(&mut self, now_ns: i64) {
        if let Some(record) = self.end.record(now_ns) {
            self.ports.publish(&record);
        }
    }
}
