//! A dialect and a simulated arm in one process, joined byte by byte without a delay: for replays of sessions without
//! an arm, for tests of the driver, and for a first look at the program without hardware.

use crate::config::Settings;
use crate::dialect::{Dialect, TRANSMIT_LEN_MIN};
use crate::gcode::template::TemplateError;
use crate::message::{Command, Refusal, Report};
use crate::simulate::{Faults, SimulatedArm};

/// Both ends of the line.
#[derive(Debug)]
pub struct SimulatedLink {
    dialect: Dialect,
    arm: SimulatedArm,
    started: bool,
}

impl SimulatedLink {
    /// An arm of the dialect that `[arm]` names, seeded. It parks in the upper corner of the workspace.
    ///
    /// # Errors
    /// A move template that cannot be taken.
    pub fn new(settings: &Settings, session_seed: u32, faults: Faults) -> Result<Self, TemplateError> {
        let workspace = &settings.workspace;
        let park_mm = [workspace.min_mm[0], workspace.min_mm[1], workspace.max_mm[2]];
        Ok(Self {
            dialect: Dialect::new(settings, session_seed)?,
            arm: SimulatedArm::new(settings.arm.dialect, park_mm, faults),
            started: false,
        })
    }

    /// The arm, to disturb it.
    pub fn arm(&mut self) -> &mut SimulatedArm {
        &mut self.arm
    }

    /// See [`super::Link::command`].
    pub fn command(&mut self, command: Command, now_ns: i64) -> Result<(), Refusal> {
        let answer = self.dialect.command(command, now_ns);
        self.exchange(now_ns);
        answer
    }

    /// See [`super::Link::poll`].
    pub fn poll(&mut self, now_ns: i64) -> Option<Report> {
        if !self.started {
            self.started = true;
            self.dialect.on_link(true, now_ns);
        }
        if let Some(report) = self.dialect.poll(now_ns) {
            return Some(report);
        }
        self.exchange(now_ns);
        self.dialect.poll(now_ns)
    }

    /// See [`super::Link::next_deadline_ns`].
    pub fn next_deadline_ns(&self) -> Option<i64> {
        if !self.started {
            return Some(i64::MIN);
        }
        self.dialect.next_deadline_ns().into_iter().chain(self.arm.next_deadline_ns()).min()
    }

    /// Carries what both sides have to say, one piece each way; `poll` comes again while there are reports.
    fn exchange(&mut self, now_ns: i64) {
        let mut bytes = [0; TRANSMIT_LEN_MIN];
        loop {
            let sent = self.dialect.transmit(now_ns, &mut bytes);
            self.arm.on_bytes(&bytes[..sent.len], now_ns);
            if let Some(id) = sent.pick {
                self.dialect.on_written(id, now_ns);
            }
            while self.arm.poll(now_ns).is_some() {}
            let answered = self.arm.transmit(now_ns, &mut bytes[..192]);
            self.dialect.on_bytes(&bytes[..answered], now_ns);
            if sent.len == 0 && answered == 0 {
                return;
            }
            if answered > 0 {
                // Room for the reports of one piece is certain, for more it is not.
                return;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gate::tests::{pick, settings};

    #[test]
    fn a_pick_is_placed_by_the_simulated_arm() {
        let mut link = SimulatedLink::new(&settings(), 9, Faults::default()).unwrap();
        let (mut now_ns, mut session, mut done) = (1_000_000_000, 0, false);
        while now_ns < 20_000_000_000 && !done {
            while let Some(report) = link.poll(now_ns) {
                match report {
                    Report::Connected { session: new, .. } => {
                        session = new;
                        link.command(Command::Release, now_ns).unwrap();
                    }
                    Report::Ready { .. } if !done => {
                        let mut pick = pick();
                        pick.session = session;
                        pick.seen.left_ns = now_ns + 1;
                        pick.seen.right_ns = now_ns + 2;
                        link.command(Command::Pick(pick), now_ns).unwrap();
                    }
                    Report::Done { id: 7 } => done = true,
                    _ => {}
                }
            }
            now_ns = link.next_deadline_ns().unwrap_or(0).max(now_ns + 100_000);
        }
        assert!(done);
    }
}
