//! Why a camera cannot be opened, in words, with what to do about it.

use std::io;
use std::path::{Path, PathBuf};

use super::controls::ControlFault;
use super::format;
use crate::camera::Trouble;
use crate::config::CameraSettings;

/// Why a camera cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum CameraError {
    /// The path leads nowhere, or to something that was pulled out.
    #[error(
        "camera {}: there is no such device; plug it in, or take its path from `pickcell devices`",
        device.display()
    )]
    Absent {
        /// Path of the device.
        device: PathBuf,
    },
    /// EACCES.
    #[error(
        "camera {}: no right to open it (EACCES); add the user to the group video and log in again, or install the \
         udev rule of deploy/",
        device.display()
    )]
    NoAccess {
        /// Path of the device.
        device: PathBuf,
    },
    /// EBUSY.
    #[error(
        "camera {}: another program has it (EBUSY); end that one, `fuser -v {}` names it",
        device.display(), device.display()
    )]
    Busy {
        /// Path of the device.
        device: PathBuf,
    },
    /// ENOSPC when the stream starts.
    #[error(
        "camera {}: its USB bus has no bandwidth left for {asked} (ENOSPC); plug one camera into a port of another \
         bus (`pickcell devices` shows the buses), or take MJPG, a smaller size or a lower rate",
        device.display()
    )]
    NoBandwidth {
        /// Path of the device.
        device: PathBuf,
        /// What was asked for.
        asked: String,
    },
    /// Something else.
    #[error("{} is not a camera: {reason}; take the path of one from `pickcell devices`", device.display())]
    NotACamera {
        /// Path of the device.
        device: PathBuf,
        /// What it is.
        reason: String,
    },
    /// The camera took the nearest that it has.
    #[error("camera {}: {asked} is not offered, the camera made {taken} of it; it offers: {offered}", device.display())]
    NotOffered {
        /// Path of the device.
        device: PathBuf,
        /// What was asked for.
        asked: String,
        /// What the driver took instead.
        taken: String,
        /// All it offers.
        offered: String,
    },
    /// A control.
    #[error("camera {}: {fault}", device.display())]
    Control {
        /// Path of the device.
        device: PathBuf,
        /// What is wrong with it.
        fault: ControlFault,
    },
    /// Any other error of the driver.
    #[error("camera {}: {step}: {reason}; unplug it and plug it in again", device.display())]
    Driver {
        /// Path of the device.
        device: PathBuf,
        /// What was tried.
        step: &'static str,
        /// What the system said.
        reason: io::Error,
    },
}

impl CameraError {
    pub(super) fn of(device: &Path, asked: &CameraSettings, step: &'static str, reason: io::Error) -> Self {
        let device = device.to_path_buf();
        match reason.raw_os_error() {
            Some(libc::ENOENT | libc::ENODEV | libc::ENXIO | libc::ENOTDIR) => CameraError::Absent { device },
            Some(libc::EACCES | libc::EPERM) => CameraError::NoAccess { device },
            Some(libc::EBUSY) => CameraError::Busy { device },
            Some(libc::ENOSPC) => CameraError::NoBandwidth { device, asked: in_words(asked) },
            Some(libc::ENOTTY | libc::EISDIR) => {
                CameraError::NotACamera { device, reason: "it is no V4L2 device".to_owned() }
            }
            _ => CameraError::Driver { device, step, reason },
        }
    }

    /// The same for the cell's core.
    pub fn trouble(&self) -> Trouble {
        match self {
            CameraError::Absent { .. } => Trouble::Unplugged,
            CameraError::NoAccess { .. } => Trouble::NoAccess,
            CameraError::Busy { .. } => Trouble::Busy,
            CameraError::NoBandwidth { .. } => Trouble::NoBandwidth,
            CameraError::NotACamera { .. } | CameraError::NotOffered { .. } | CameraError::Control { .. } => {
                Trouble::NotAsAsked
            }
            CameraError::Driver { reason, .. } => trouble(reason),
        }
    }
}

/// What an error of a streaming device means.
pub(super) fn trouble(error: &io::Error) -> Trouble {
    match error.raw_os_error() {
        Some(libc::ENODEV | libc::ENOENT | libc::ENXIO) => Trouble::Unplugged,
        Some(libc::EBUSY) => Trouble::Busy,
        Some(libc::ENOSPC) => Trouble::NoBandwidth,
        Some(libc::EACCES | libc::EPERM) => Trouble::NoAccess,
        errno => Trouble::Driver { errno: errno.unwrap_or(0) },
    }
}

/// `YUYV 640x480 at 30`.
pub(super) fn in_words(asked: &CameraSettings) -> String {
    let code = format::code_text(format::code(asked.format));
    format!("{code} {}x{} at {}", asked.width, asked.height, asked.rate_hz)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::v4l::tests::settings;

    #[test]
    fn error_numbers_are_told_in_words() {
        let asked = settings("/dev/cam1");
        let of = |errno| CameraError::of(&asked.device, &asked, "start", io::Error::from_raw_os_error(errno));
        let message = of(libc::ENOSPC).to_string();
        assert!(message.contains("no bandwidth left for YUYV 640x480 at 30 (ENOSPC)"), "{message}");
        assert!(message.contains("another bus") && message.contains("MJPG"), "{message}");
        assert!(of(libc::EBUSY).to_string().contains("`fuser -v /dev/cam1` names it"));
        assert!(of(libc::EACCES).to_string().contains("group video"));
        assert_eq!(of(libc::EIO).trouble(), Trouble::Driver { errno: libc::EIO });
        assert_eq!(of(libc::ENODEV).trouble(), Trouble::Unplugged);
    }
}
