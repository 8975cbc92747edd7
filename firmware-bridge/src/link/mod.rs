//! What carries a dialect's bytes, or the messages themselves, to an arm.
//!
//! Takes [`Command`]s, gives [`Report`]s; owns the device. All links have one shape, are driven by one thread (in the
//! driver the arm's thread, in the bridge the main one) and never block outside of `wait`:
//! - `command(command, now_ns)`: as in [`crate::dialect`]; what can be written is written at once;
//! - `poll(now_ns)`: reads and writes what there is; the next report. Call it until `None`;
//! - `wait(until_ns, wake)`: sleeps until then, until something arrives, or until `wake` can be read;
//! - `next_deadline_ns()`: the latest moment to call `poll` again if nothing arrives.
//!
//! ```no_run
//! # use firmware_bridge::{config::Settings, link::{Link, clock_ns}};
//! let settings = Settings::read("cell.toml".as_ref())?;
//! let mut link = Link::open(&settings, 4711)?;
//! loop {
//!     while let Some(report) = link.poll(clock_ns()) {
//!         println!("{report:?}");
//!     }
//!     link.wait(clock_ns() + 10_000_000, None);
//! }
//! # #[allow(unreachable_code)]
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod port;
mod recorded;
mod serial;
pub mod shared;
mod simulated;

pub use port::probe;
pub use recorded::{Answers, RecordedLink, Said, What};
pub use serial::{SerialError, SerialLink};
pub use shared::{SharedError, SharedMemoryLink};
pub use simulated::SimulatedLink;

use crate::config::{LinkName, Settings};
use crate::gcode::template::TemplateError;
use crate::message::{Command, Refusal, Report};
use crate::simulate::Faults;
use rustix::event::{PollFd, PollFlags};
use rustix::fd::BorrowedFd;

/// One of the links.
#[derive(Debug)]
#[allow(clippy::large_enum_variant)] // one a process
pub enum Link {
    /// A serial line of this process.
    Serial(SerialLink),
    /// Shared memory to `firmware-bridge run`.
    SharedMemory(SharedMemoryLink),
    /// A simulated arm in this process.
    Simulated(SimulatedLink),
    /// The arm of a recorded session.
    Recorded(RecordedLink),
}

/// Why a link cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// A move template cannot be taken.
    #[error(transparent)]
    Template(#[from] TemplateError),
    /// The serial line.
    #[error(transparent)]
    Serial(#[from] SerialError),
    /// The shared memory.
    #[error(transparent)]
    SharedMemory(#[from] SharedError),
}

/// Calls the same method of whichever link it is.
macro_rules! each {
    ($self:expr, $link:ident => $call:expr) => {
        match $self {
            Link::Serial($link) => $call,
            Link::SharedMemory($link) => $call,
            Link::Simulated($link) => $call,
            Link::Recorded($link) => $call,
        }
    };
}

impl Link {
    /// Opens the link that `[arm]` names (`replay`: a simulated arm without faults). `session_seed` decides the sessions of a
    /// simulated arm; the others mix it with time and process, so that two openings always differ.
    ///
    /// # Errors
    /// What is missing or taken, with the remedy. Later losses are not errors: the link says
    /// [`Report::Disconnected`] and tries again by itself.
    pub fn open(settings: &Settings, session_seed: u32) -> Result<Self, LinkError> {
        match settings.arm.link {
            LinkName::Serial => Ok(Link::Serial(SerialLink::open(settings, session_seed)?)),
            LinkName::SharedMemory => Ok(Link::SharedMemory(SharedMemoryLink::open(settings, session_seed)?)),
            LinkName::Replay => {
                Ok(Link::Simulated(SimulatedLink::new(settings, session_seed, Faults::default())?))
            }
        }
    }

    /// Like [`Link::open`], but a serial port that is not there or cannot be opened yet is waited for, as one that was
    /// unplugged is: a service may be started before its devices.
    ///
    /// # Errors
    /// What else is missing or taken, with the remedy.
    pub fn open_or_wait(settings: &Settings, session_seed: u32) -> Result<Self, LinkError> {
        match settings.arm.link {
            LinkName::Serial => Ok(Link::Serial(SerialLink::open_or_wait(settings, session_seed)?)),
            _ => Link::open(settings, session_seed),
        }
    }

    /// The arm of a recorded session, by its answers; `session_seed` decides the numbers of its sessions.
    pub fn recorded(settings: &Settings, answers: Answers, session_seed: u32) -> Self {
        Link::Recorded(RecordedLink::new(settings, answers, session_seed))
    }

    /// What the cell wants.
    ///
    /// # Errors
    /// Why it was not taken; nothing of it will be sent.
    pub fn command(&mut self, command: Command, now_ns: i64) -> Result<(), Refusal> {
        each!(self, link => link.command(command, now_ns))
    }

    /// Reads and writes what there is; the next report.
    pub fn poll(&mut self, now_ns: i64) -> Option<Report> {
        each!(self, link => link.poll(now_ns))
    }

    /// The latest moment to call `poll` again.
    pub fn next_deadline_ns(&self) -> Option<i64> {
        each!(self, link => link.next_deadline_ns())
    }

    /// Sleeps until `until_ns`, until something arrives, or until `wake` can be read.
    pub fn wait(&self, until_ns: i64, wake: Option<BorrowedFd<'_>>) {
        let own = match self {
            Link::Serial(link) => link.fd(),
            Link::SharedMemory(link) => link.fd(),
            Link::Simulated(_) | Link::Recorded(_) => None,
        };
        wait_for(&[own, wake], until_ns);
    }
}

/// A number that differs between processes and between two openings of one: what begins with it (sessions, lives) is
/// never taken for what was before. `seed` alone would not do, a caller may always give the same.
pub fn life_number(seed: u32) -> u32 {
    let time = clock_ns() as u64 ^ u64::from(std::process::id()) << 40 ^ u64::from(seed) << 20;
    // Fibonacci hashing spreads neighbours.
    (time.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 32) as u32
}

/// The cell's clock: nanoseconds of `CLOCK_BOOTTIME`. Unlike `CLOCK_MONOTONIC` it goes on while the machine is
/// suspended, so that whatever waited through a suspend is as old as it is: targets are stale, heartbeats are missed.
pub fn clock_ns() -> i64 {
    let t = rustix::time::clock_gettime(rustix::time::ClockId::Boottime);
    t.tv_sec * 1_000_000_000 + t.tv_nsec
}

/// Sleeps until one of `fds` (at most four) can be read or `until_ns` has come.
pub fn wait_for(fds: &[Option<BorrowedFd<'_>>], until_ns: i64) {
    let left_ns = until_ns.saturating_sub(clock_ns()).clamp(0, 3_600_000_000_000);
    let timeout =
        rustix::event::Timespec { tv_sec: left_ns / 1_000_000_000, tv_nsec: left_ns % 1_000_000_000 };
    // Without a descriptor there is still a time to sleep; any open one fills the unused places.
    let stdin = rustix::stdio::stdin();
    let filler = fds.iter().flatten().next().unwrap_or(&stdin);
    let mut polled: [PollFd<'_>; 4] =
        std::array::from_fn(|_| PollFd::from_borrowed_fd(*filler, PollFlags::empty()));
    let mut len = 0;
    for (slot, fd) in polled.iter_mut().zip(fds.iter().flatten()) {
        *slot = PollFd::from_borrowed_fd(*fd, PollFlags::IN);
        len += 1;
    }
    // An interrupted sleep is a short one.
    let _ = rustix::event::poll(&mut polled[..len], Some(&timeout));
}
