//! An open serial port.
//!
//! Takes a path and a speed; gives a descriptor that never blocks; owns it. The crate `serialport` opens and
//! configures it: exclusive, raw, 8N1, no flow control. Reads, writes and waits go to the descriptor itself, because
//! that crate waits in its own `read` and `write`, and its `flush` waits for a line that may never drain.

use super::serial::SerialError;
use rustix::fd::{AsFd, AsRawFd, BorrowedFd};
use rustix::fs::{Mode, OFlags};
use rustix::io::Errno;
use rustix::termios::{ControlModes, OptionalActions, QueueSelector};
use serialport::{DataBits, FlowControl, Parity, StopBits, TTYPort};
use std::path::Path;

/// See the module. Closed when dropped.
#[derive(Debug)]
pub(super) struct Port {
    tty: TTYPort,
}

impl AsFd for Port {
    #[allow(unsafe_code)]
    fn as_fd(&self) -> BorrowedFd<'_> {
        // SAFETY: `tty` owns the descriptor and closes it when it is dropped, which the borrow of `self` prevents.
        unsafe { BorrowedFd::borrow_raw(self.tty.as_raw_fd()) }
    }
}

impl Port {
    /// Opens and configures the device at `path`; what was received before is thrown away.
    ///
    /// # Errors
    /// A port that is not there, busy, forbidden or no serial device.
    pub(super) fn open(path: &Path, baud: u32) -> Result<Self, SerialError> {
        let tty = serialport::new(path.to_string_lossy(), baud)
            .data_bits(DataBits::Eight)
            .parity(Parity::None)
            .stop_bits(StopBits::One)
            .flow_control(FlowControl::None)
            .exclusive(true)
            .open_native()
            .map_err(|reason| explain(path, baud, reason))?;
        let port = Self { tty };
        port.settle().map_err(|reason| configure_error(path, baud, reason))?;
        Ok(port)
    }

    /// What the crate leaves open: no waiting, and the modem lines stay as they are when the port is closed, because
    /// many a board resets when they fall.
    fn settle(&self) -> Result<(), Errno> {
        rustix::fs::fcntl_setfl(self, OFlags::NONBLOCK)?;
        let mut termios = rustix::termios::tcgetattr(self)?;
        termios.control_modes &= !ControlModes::HUPCL;
        rustix::termios::tcsetattr(self, OptionalActions::Now, &termios)?;
        rustix::termios::tcflush(self, QueueSelector::IOFlush)
    }
}

/// The crate keeps a kind of error only; the number that names the remedy comes from asking the system again.
fn explain(path: &Path, baud: u32, reason: serialport::Error) -> SerialError {
    if reason.kind() == serialport::ErrorKind::NoDevice {
        return open_error(path, Errno::BUSY);
    }
    match probe(path, baud) {
        Err(error) => error,
        Ok(()) => SerialError::Refused { path: path.into(), baud, reason },
    }
}

/// Whether a port can be opened and is a serial one. Sends nothing and leaves its settings, so that an arm goes on
/// undisturbed.
///
/// # Errors
/// A port that is not there, busy, forbidden or no serial device.
pub fn probe(path: &Path, baud: u32) -> Result<(), SerialError> {
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let port = rustix::fs::open(path, flags, Mode::empty()).map_err(|reason| open_error(path, reason))?;
    rustix::termios::tcgetattr(&port).map_err(|reason| configure_error(path, baud, reason))?;
    Ok(())
}

fn open_error(path: &Path, reason: Errno) -> SerialError {
    let remedy = match reason {
        Errno::NOENT | Errno::NXIO | Errno::NODEV => {
            "is it plugged in and switched on? `pickcell devices` lists the serial ports"
        }
        Errno::ACCESS | Errno::PERM => {
            "add the user to the group dialout (then log in again) or set a udev rule"
        }
        Errno::BUSY => "another program has it open: end that one",
        Errno::ISDIR => "arm.port must name a device, not a folder",
        _ => "check arm.port",
    };
    SerialError::Open { path: path.into(), reason, remedy }
}

fn configure_error(path: &Path, baud: u32, reason: Errno) -> SerialError {
    let remedy = match reason {
        Errno::NOTTY => "it is no serial device: check arm.port",
        Errno::BUSY => "another program has it open: end that one",
        Errno::INVAL => "it does not know this speed: check arm.baud",
        _ => "check arm.port and arm.baud",
    };
    SerialError::Configure { path: path.into(), baud, reason, remedy }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::serial::tests::pty;
    use rustix::termios::{InputModes, LocalModes, OutputModes};

    #[test]
    fn a_pty_takes_every_speed_and_is_raw() {
        let (_master, path) = pty();
        for baud in [300, 115_200, 250_000, 3_000_000, 1_234_567] {
            let port = Port::open(&path, baud).unwrap();
            let termios = rustix::termios::tcgetattr(&port).unwrap();
            assert_eq!(termios.output_speed(), baud);
            assert!(
                !termios.local_modes.intersects(LocalModes::ICANON | LocalModes::ECHO | LocalModes::ISIG)
            );
            assert!(
                !termios.input_modes.intersects(InputModes::IXON | InputModes::IXOFF | InputModes::ICRNL)
            );
            assert!(!termios.output_modes.contains(OutputModes::OPOST));
            let unwanted = ControlModes::CSTOPB | ControlModes::CRTSCTS | ControlModes::HUPCL;
            assert!(!termios.control_modes.intersects(unwanted | ControlModes::PARENB));
            let nothing = rustix::io::read(&port, &mut [0; 8]);
            assert_eq!(nothing, Err(Errno::AGAIN), "a read waits for nobody");
        }
    }

    #[test]
    fn a_port_is_for_one_program_at_a_time() {
        let (_master, path) = pty();
        let first = Port::open(&path, 9600).unwrap();
        let told = Port::open(&path, 9600).unwrap_err().to_string();
        assert!(told.contains("another program has it open: end that one"), "{told}");
        drop(first);
        assert!(Port::open(&path, 9600).is_ok());
    }
}
