//! What systemd is told: ready, status, and that the recognise loop is alive.
//!
//! Takes the service manager's wishes from the environment; owns a socket to it. Without a service manager nothing
//! is done. The watchdog is kicked without an allocation, from the recognise loop itself, also while that waits for a
//! camera: what is watched is the loop that matters.

use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::time::Duration;

use sd_notify::NotifyState;

use crate::time::Timestamp;

/// The service manager, or none.
#[derive(Debug)]
pub struct Watchdog {
    socket: Option<UnixDatagram>,
    every: Duration,
    kicked: Timestamp,
}

impl Watchdog {
    /// As `NOTIFY_SOCKET`, `WATCHDOG_USEC` and `WATCHDOG_PID` say.
    pub fn from_environment() -> Self {
        let wanted = sd_notify::watchdog_enabled();
        let socket = wanted.and_then(|_| connect(&std::env::var("NOTIFY_SOCKET").ok()?));
        // Twice as often as asked for, as its manual says; without one the loop still wakes now and then.
        let every = wanted.map_or(Duration::from_secs(1), |limit| limit / 2);
        Self { socket, every, kicked: Timestamp::default() }
    }

    /// How long the loop may sleep.
    pub fn every(&self) -> Duration {
        self.every / 2
    }

    /// The loop is alive.
    pub fn kick(&mut self, now: Timestamp) {
        let due = now.since(self.kicked) >= i64::try_from(self.every.as_nanos() / 2).unwrap_or(i64::MAX);
        if let (true, Some(socket)) = (due, &self.socket) {
            self.kicked = now;
            // A service manager that does not listen is no reason to stop picking.
            let _ = socket.send(b"WATCHDOG=1");
        }
    }
}

fn connect(address: &str) -> Option<UnixDatagram> {
    let address = match address.strip_prefix('@') {
        Some(name) => SocketAddr::from_abstract_name(name).ok()?,
        None => SocketAddr::from_pathname(address).ok()?,
    };
    let socket = UnixDatagram::unbound().ok()?;
    socket.connect_addr(&address).ok()?;
    socket.set_nonblocking(true).ok()?;
    Some(socket)
}

/// The cell is configured and runs; it need not see anything yet.
pub fn ready() {
    let _ = sd_notify::notify(&[NotifyState::Ready]);
}

/// One line about what the cell is doing.
pub fn status(text: &str) {
    let _ = sd_notify::notify(&[NotifyState::Status(text)]);
}

/// The cell is ending.
pub fn stopping() {
    let _ = sd_notify::notify(&[NotifyState::Stopping]);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_watched_loop_kicks_through_its_socket_and_not_too_often() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("notify");
        let manager = UnixDatagram::bind(&path).unwrap();
        manager.set_nonblocking(true).unwrap();
        let socket = connect(path.to_str().unwrap());
        assert!(socket.is_some());
        let mut watchdog = Watchdog { socket, every: Duration::from_secs(1), kicked: Timestamp(0) };
        let heard = |manager: &UnixDatagram| {
            let mut text = [0; 32];
            manager.recv(&mut text).map(|n| text[..n].to_vec()).unwrap_or_default()
        };
        watchdog.kick(Timestamp(499_000_000));
        assert_eq!(heard(&manager), b"");
        watchdog.kick(Timestamp(500_000_000));
        assert_eq!(heard(&manager), b"WATCHDOG=1");
        assert!(connect("/nowhere/at/all").is_none());
    }
}
