//! How one thread wakes another: [`Waker`].
//!
//! A thread that has nothing to do sleeps in the kernel on its waker's descriptor, together with whatever device it
//! serves; nothing spins. What is handed over goes through the rings of [`crate::cell::desk`].

use std::io;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::time::Duration;

use rustix::event::{EventfdFlags, PollFd, PollFlags, Timespec, eventfd, poll};

/// Wakes a thread that sleeps in [`Waker::wait`] or polls [`Waker::as_fd`]. An eventfd: a wake that comes while
/// nobody sleeps is kept, several are one.
#[derive(Debug)]
pub struct Waker {
    fd: OwnedFd,
}

impl Waker {
    /// A waker that was not woken.
    ///
    /// # Errors
    /// The system has no descriptor left.
    pub fn new() -> io::Result<Self> {
        Ok(Self { fd: eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK)? })
    }

    /// Wakes. One system call that never blocks.
    pub fn wake(&self) {
        // The only failure is a counter at its limit, which is a wake that was not fetched.
        let _ = rustix::io::write(&self.fd, &1u64.to_ne_bytes());
    }

    /// Forgets wakes that came so far; whether there were any.
    pub fn clear(&self) -> bool {
        let mut count = [0; 8];
        rustix::io::read(&self.fd, &mut count).is_ok()
    }

    /// Sleeps until woken, at most `timeout` (`None`: for ever), and clears. Whether it was woken; a signal ends the
    /// sleep early.
    pub fn wait(&self, timeout: Option<Duration>) -> bool {
        let timeout = timeout.map(|t| Timespec {
            tv_sec: i64::try_from(t.as_secs()).unwrap_or(i64::MAX),
            tv_nsec: i64::from(t.subsec_nanos()),
        });
        // EINTR is an early end of the sleep, which every caller allows for.
        let _ = poll(&mut [PollFd::new(&self.fd, PollFlags::IN)], timeout.as_ref());
        self.clear()
    }
}

impl AsFd for Waker {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.fd.as_fd()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wake_before_the_sleep_is_kept() {
        let waker = Waker::new().unwrap();
        assert!(!waker.wait(Some(Duration::from_millis(1))));
        waker.wake();
        waker.wake();
        assert!(waker.wait(None));
        assert!(!waker.wait(Some(Duration::ZERO)));
    }

    #[test]
    fn a_sleeping_thread_is_woken() {
        let waker = Waker::new().unwrap();
        std::thread::scope(|scope| {
            let sleeper = scope.spawn(|| waker.wait(None));
            waker.wake();
            assert!(sleeper.join().unwrap());
        });
    }
}
