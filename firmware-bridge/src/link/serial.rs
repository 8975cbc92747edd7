//! A dialect on a serial line.
//!
//! The device is a [`Port`]: exclusive, raw, 8N1, without flow control, and never waited for. Bytes are handed to the
//! kernel only as fast as the line takes them, so that a hold has at most one packet before it, and that one is
//! thrown away. A port that vanished is opened again with growing pauses.

use super::LinkError;
use super::port::Port;
use crate::config::Settings;
use crate::dialect::{Dialect, RECEIVE_LEN_MAX, TRANSMIT_LEN_MIN};
use crate::message::{Command, Refusal, Report};
use rustix::fd::{AsFd, BorrowedFd};
use rustix::io::Errno;
use rustix::termios::QueueSelector;
use std::path::{Path, PathBuf};

const MS: i64 = 1_000_000;

/// Why a serial port cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum SerialError {
    /// `arm.port` is not set.
    #[error("arm.port is missing: name the serial device of the arm, e.g. port = \"/dev/ttyUSB0\"")]
    NoPort,
    /// It cannot be opened.
    #[error("cannot open the arm's serial port {}: {reason}; {remedy}", path.display())]
    Open {
        /// The device.
        path: PathBuf,
        /// What the system says.
        reason: Errno,
        /// What to do.
        remedy: &'static str,
    },
    /// It is no serial device, or does not know this speed.
    #[error("cannot set {} to {baud} baud: {reason}; {remedy}", path.display())]
    Configure {
        /// The device.
        path: PathBuf,
        /// `arm.baud`.
        baud: u32,
        /// What the system says.
        reason: Errno,
        /// What to do.
        remedy: &'static str,
    },
    /// It is a serial device that does not take the settings.
    #[error("cannot set {} to {baud} baud: {reason}; check arm.port and arm.baud", path.display())]
    Refused {
        /// The device.
        path: PathBuf,
        /// `arm.baud`.
        baud: u32,
        /// What is wrong.
        reason: serialport::Error,
    },
}

impl SerialError {
    /// Whether it may be otherwise in a while, with the same configuration.
    fn may_pass(&self) -> bool {
        match self {
            SerialError::Open { reason, .. } => *reason != Errno::ISDIR,
            SerialError::Configure { reason, .. } => !matches!(*reason, Errno::NOTTY | Errno::INVAL),
            SerialError::NoPort | SerialError::Refused { .. } => false,
        }
    }
}

/// A dialect, its port, and what is under way between them.
#[derive(Debug)]
pub struct SerialLink {
    dialect: Dialect,
    path: PathBuf,
    baud: u32,
    byte_ns: i64,
    port: Option<Port>,
    /// What `transmit` gave and the kernel has not taken yet.
    rest: [u8; TRANSMIT_LEN_MIN],
    rest_from: usize,
    rest_to: usize,
    rest_pick: Option<u64>,
    /// When the line will have sent everything.
    free_ns: i64,
    reopen_min_ns: i64,
    reopen_max_ns: i64,
    /// The next attempt to open the port, and the pause after it.
    reopen_ns: i64,
    reopen_pause_ns: i64,
    /// What was last said to be in the way of that.
    told: Option<String>,
}

impl SerialLink {
    /// Opens `[arm] port`.
    ///
    /// # Errors
    /// A port that is not there, busy, forbidden or no serial device; a move template that cannot be taken.
    pub fn open(settings: &Settings, session_seed: u32) -> Result<Self, LinkError> {
        Self::with(settings, session_seed, |path, baud| Port::open(path, baud).map(Some))
    }

    /// Like [`SerialLink::open`], but a port that is not there, busy or forbidden is waited for, as one that was unplugged
    /// is; the log says why.
    ///
    /// # Errors
    /// A port that is no serial device or does not take the speed; a move template that cannot be taken.
    pub fn open_or_wait(settings: &Settings, session_seed: u32) -> Result<Self, LinkError> {
        Self::with(settings, session_seed, |path, baud| match Port::open(path, baud) {
            Err(error) if error.may_pass() => {
                tracing::warn!("{error}; waiting for it");
                Ok(None)
            }
            opened => opened.map(Some),
        })
    }

    fn with(
        settings: &Settings,
        session_seed: u32,
        open: impl FnOnce(&Path, u32) -> Result<Option<Port>, SerialError>,
    ) -> Result<Self, LinkError> {
        let arm = &settings.arm;
        let path = arm.port.clone().ok_or(SerialError::NoPort)?;
        let dialect = Dialect::new(settings, super::life_number(session_seed))?;
        let mut link = Self {
            dialect,
            port: open(&path, arm.baud)?,
            path,
            baud: arm.baud,
            byte_ns: 10_000_000_000 / i64::from(arm.baud),
            rest: [0; TRANSMIT_LEN_MIN],
            rest_from: 0,
            rest_to: 0,
            rest_pick: None,
            free_ns: 0,
            reopen_min_ns: i64::from(arm.reopen_min_ms) * MS,
            reopen_max_ns: i64::from(arm.reopen_max_ms) * MS,
            reopen_ns: 0,
            reopen_pause_ns: i64::from(arm.reopen_min_ms) * MS,
            told: None,
        };
        if link.port.is_some() {
            link.dialect.on_link(true, super::clock_ns());
        }
        Ok(link)
    }

    /// The device.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What to wait for, while the port is open.
    pub fn fd(&self) -> Option<BorrowedFd<'_>> {
        self.port.as_ref().map(|port| port.as_fd())
    }

    /// See [`super::Link::command`].
    pub fn command(&mut self, command: Command, now_ns: i64) -> Result<(), Refusal> {
        let answer = self.dialect.command(command, now_ns);
        self.write(now_ns);
        answer
    }

    /// See [`super::Link::poll`].
    pub fn poll(&mut self, now_ns: i64) -> Option<Report> {
        if let Some(report) = self.dialect.poll(now_ns) {
            return Some(report);
        }
        if self.port.is_none() {
            self.reopen(now_ns);
        }
        self.read(now_ns);
        self.write(now_ns);
        self.dialect.poll(now_ns)
    }

    /// See [`super::Link::next_deadline_ns`].
    pub fn next_deadline_ns(&self) -> Option<i64> {
        if self.port.is_none() {
            return Some(self.reopen_ns);
        }
        let dialect_ns = self.dialect.next_deadline_ns().unwrap_or(i64::MAX);
        if dialect_ns == i64::MIN {
            // Reports wait.
            return Some(dialect_ns);
        }
        if self.rest_from < self.rest_to {
            // The kernel's buffer is full: nobody reads at the other end.
            return Some(super::clock_ns() + 5 * MS);
        }
        // What is due while the line is busy waits for the line; a hold never does, it goes out in `command`.
        Some(dialect_ns.max(self.free_ns))
    }

    fn reopen(&mut self, now_ns: i64) {
        if now_ns < self.reopen_ns {
            return;
        }
        match Port::open(&self.path, self.baud) {
            Ok(port) => {
                self.port = Some(port);
                self.reopen_pause_ns = self.reopen_min_ns;
                self.told = None;
                self.dialect.on_link(true, now_ns);
            }
            Err(error) => {
                // Why, whenever that changes; that it is gone is said.
                let reason = error.to_string();
                if self.told.as_ref() != Some(&reason) {
                    tracing::warn!("{reason}");
                    self.told = Some(reason);
                }
                self.reopen_ns = now_ns + self.reopen_pause_ns;
                self.reopen_pause_ns = (2 * self.reopen_pause_ns).min(self.reopen_max_ns);
            }
        }
    }

    fn lost(&mut self, now_ns: i64) {
        self.port = None;
        (self.rest_from, self.rest_to, self.rest_pick) = (0, 0, None);
        self.free_ns = now_ns;
        self.reopen_ns = now_ns + self.reopen_min_ns;
        self.reopen_pause_ns = self.reopen_min_ns;
        self.dialect.on_link(false, now_ns);
    }

    /// One buffer at most, so that its reports fit; `poll` comes again as long as there are reports.
    fn read(&mut self, now_ns: i64) {
        let Some(port) = &self.port else { return };
        let mut bytes = [0; RECEIVE_LEN_MAX];
        match rustix::io::read(port, &mut bytes) {
            Ok(0) => self.lost(now_ns),
            Ok(len) => self.dialect.on_bytes(&bytes[..len], now_ns),
            Err(Errno::AGAIN | Errno::INTR) => {}
            Err(_) => self.lost(now_ns),
        }
    }

    fn write(&mut self, now_ns: i64) {
        loop {
            if self.dialect.has_urgent() {
                self.fill(now_ns);
            } else if self.rest_from == self.rest_to {
                if now_ns < self.free_ns {
                    return;
                }
                self.fill(now_ns);
            }
            let Some(port) = self.port.as_ref().filter(|_| self.rest_from < self.rest_to) else { return };
            match rustix::io::write(port, &self.rest[self.rest_from..self.rest_to]) {
                Ok(len) => self.written(len, now_ns),
                Err(Errno::INTR) => {}
                Err(Errno::AGAIN) => return,
                Err(_) => return self.lost(now_ns),
            }
        }
    }

    /// Takes the next bytes from the dialect.
    fn fill(&mut self, now_ns: i64) {
        let mut out = [0; TRANSMIT_LEN_MIN];
        let sent = self.dialect.transmit(now_ns, &mut out);
        if sent.urgent {
            (self.rest_from, self.rest_to, self.rest_pick) = (0, 0, None);
            self.free_ns = now_ns;
            if let Some(port) = &self.port {
                // Only the output queue, and without waiting for it. Where it cannot be, the hold waits for one packet.
                let _ = rustix::termios::tcflush(port, QueueSelector::OFlush);
            }
        }
        if sent.len > 0 {
            self.rest[..sent.len].copy_from_slice(&out[..sent.len]);
            (self.rest_from, self.rest_to, self.rest_pick) = (0, sent.len, sent.pick);
        }
    }

    fn written(&mut self, len: usize, now_ns: i64) {
        self.rest_from += len;
        self.free_ns = self.free_ns.max(now_ns) + len as i64 * self.byte_ns;
        if self.rest_from == self.rest_to
            && let Some(id) = self.rest_pick.take()
        {
            self.dialect.on_written(id, self.free_ns);
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::codec::{Decoder, ToArm, ToArmBody};
    use crate::gate::tests::settings;
    use crate::link::clock_ns;
    use rustix::fd::OwnedFd;
    use rustix::fs::OFlags;
    use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
    use std::os::unix::ffi::OsStringExt;

    pub(in crate::link) fn pty() -> (OwnedFd, PathBuf) {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
        grantpt(&master).unwrap();
        unlockpt(&master).unwrap();
        let name = ptsname(&master, Vec::new()).unwrap().into_bytes();
        (master, PathBuf::from(std::ffi::OsString::from_vec(name)))
    }

    fn complaint(port: &str, baud: u32) -> String {
        let mut settings = settings();
        settings.arm.port = Some(port.into());
        settings.arm.baud = baud;
        SerialLink::open(&settings, 1).unwrap_err().to_string()
    }

    #[test]
    fn errors_name_the_port_and_the_remedy() {
        let missing = complaint("/dev/no-such-arm", 115_200);
        assert!(missing.contains("/dev/no-such-arm") && missing.contains("is it plugged in"), "{missing}");
        let null = complaint("/dev/null", 9600);
        assert!(
            null.contains("cannot set /dev/null to 9600 baud") && null.contains("no serial device"),
            "{null}"
        );
        let folder = complaint("/dev", 9600);
        assert!(folder.contains("not a folder"), "{folder}");
    }

    #[test]
    fn a_vanished_port_is_reported_and_opened_again() {
        let (master, path) = pty();
        let folder = tempfile::tempdir().unwrap();
        let stable = folder.path().join("arm");
        std::os::unix::fs::symlink(&path, &stable).unwrap();
        let mut settings = settings();
        settings.arm.port = Some(stable.clone());
        settings.arm.reopen_min_ms = 10;
        settings.arm.reopen_max_ms = 20;
        let mut link = SerialLink::open(&settings, 1).unwrap();
        let mut bytes = [0; 64];
        // A hello is on the line.
        assert_eq!(link.poll(clock_ns()), None);
        assert!(rustix::io::read(&master, &mut bytes).unwrap() > 8);
        drop(master);
        link.poll(clock_ns());
        assert!(link.fd().is_none(), "the loss is noticed at once");
        let (master, path) = pty();
        std::fs::remove_file(&stable).unwrap();
        std::os::unix::fs::symlink(&path, &stable).unwrap();
        // Time is an argument: the pause is over.
        let mut now_ns = clock_ns() + 30 * MS;
        link.poll(now_ns);
        assert!(link.fd().is_some());
        now_ns += MS;
        link.poll(now_ns);
        assert!(rustix::io::read(&master, &mut bytes).unwrap() > 8, "hello again");
    }

    #[test]
    fn a_port_that_is_not_there_yet_is_waited_for_where_that_is_wanted() {
        let folder = tempfile::tempdir().unwrap();
        let stable = folder.path().join("arm");
        let mut settings = settings();
        settings.arm.port = Some(stable.clone());
        assert!(SerialLink::open(&settings, 1).is_err());
        let mut link = SerialLink::open_or_wait(&settings, 1).unwrap();
        assert_eq!((link.poll(clock_ns()), link.fd().is_none()), (None, true));
        assert_eq!(link.command(Command::Release, clock_ns()), Err(Refusal::NotConnected));
        let (master, path) = pty();
        std::os::unix::fs::symlink(&path, &stable).unwrap();
        link.poll(link.next_deadline_ns().unwrap());
        assert!(rustix::io::read(&master, &mut [0; 64]).unwrap() > 8, "a hello");
        settings.arm.port = Some("/dev/null".into());
        assert!(
            SerialLink::open_or_wait(&settings, 1).is_err(),
            "what is no serial device is not waited for"
        );
    }

    #[test]
    fn a_reader_that_sleeps_blocks_nobody_and_a_hold_finds_room() {
        let (master, path) = pty();
        let mut settings = settings();
        settings.arm.port = Some(path);
        settings.arm.handshake_timeout_ms = 10;
        let mut link = SerialLink::open(&settings, 1).unwrap();
        // Hellos until the pty holds no more (how many that are is the kernel's affair), and nobody reads.
        for step in 0..100_000 {
            link.poll(clock_ns() + step * 11 * MS);
            if link.rest_from < link.rest_to {
                break;
            }
        }
        assert!(link.rest_from < link.rest_to, "the pty is full");
        link.command(Command::Hold, clock_ns() + 2_000_000 * MS).unwrap();
        assert_eq!(link.rest_from, link.rest_to, "the hold is with the kernel");
        // What the reader's end has taken already stays before it; a real line has no such store.
        rustix::fs::fcntl_setfl(&master, OFlags::NONBLOCK).unwrap();
        let (mut decoder, mut bytes, mut last) = (Decoder::new(), [0; 8192], None);
        while let Ok(len) = rustix::io::read(&master, &mut bytes) {
            last = bytes[..len].iter().filter_map(|&byte| decoder.push::<ToArm>(byte)?.ok()).last().or(last);
        }
        assert_eq!(last.map(|message| message.body), Some(ToArmBody::Hold));
    }
}
