//! The arm of the cell: [`Arm`] over firmware-bridge's links.
//!
//! Takes commands, gives reports; owns the link. Driven by one thread. A session with messages of an arm is
//! answered by [`Arm::recorded`]; one without gets the simulated one, which is a link like the others: same dialect, same gate,
//! same bytes, only the far end is made up.

use std::os::fd::BorrowedFd;

use firmware_bridge::config::Settings;
use firmware_bridge::link::{Answers, Link, LinkError};
use firmware_bridge::message::{Command, Refusal, Report};

use crate::time::Timestamp;

/// The arm: serial line, shared memory, the recorded or the simulated one, as `[arm]` says.
#[derive(Debug)]
pub struct Arm(pub Link);

impl Arm {
    /// Opens the link that `[arm]` names.
    ///
    /// # Errors
    /// What is missing or taken, with the remedy.
    pub fn open(settings: &Settings, session_seed: u32) -> Result<Self, LinkError> {
        Ok(Self(Link::open(settings, session_seed)?))
    }

    /// Like [`Arm::open`], but a serial port that is not there or cannot be opened yet is waited for, as one that was
    /// unplugged is.
    ///
    /// # Errors
    /// What else is missing or taken, with the remedy.
    pub fn open_or_wait(settings: &Settings, session_seed: u32) -> Result<Self, LinkError> {
        Ok(Self(Link::open_or_wait(settings, session_seed)?))
    }

    /// The arm of a recorded session, which answers the n-th target as it answered its n-th.
    pub fn recorded(settings: &Settings, answers: Answers, session_seed: u32) -> Self {
        Self(Link::recorded(settings, answers, session_seed))
    }

    /// Makes a simulated arm move so many times as fast as an ordinary one; others stay as they are.
    pub fn hasten(&mut self, tempo: f64) {
        if let Link::Simulated(link) = &mut self.0 {
            link.arm().set_tempo(tempo);
        }
    }

    /// Ends the faults of a simulated arm; others stay as they are.
    pub fn heal(&mut self) {
        if let Link::Simulated(link) = &mut self.0 {
            link.arm().heal();
        }
    }

    /// Says something to the arm.
    ///
    /// # Errors
    /// Why it was not taken.
    pub fn command(&mut self, command: Command, now: Timestamp) -> Result<(), Refusal> {
        self.0.command(command, now.0)
    }

    /// The next thing that the arm says.
    pub fn poll(&mut self, now: Timestamp) -> Option<Report> {
        self.0.poll(now.0)
    }

    /// The latest moment to poll again.
    pub fn next_poll(&self) -> Option<Timestamp> {
        self.0.next_deadline_ns().map(Timestamp)
    }

    /// Sleeps until `until`, until the arm says something, or until `wake` can be read.
    pub fn wait(&self, until: Timestamp, wake: BorrowedFd<'_>) {
        self.0.wait(until.0, Some(wake));
    }
}
