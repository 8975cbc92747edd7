//! What can stop `pickcell run`.

use std::io;
use std::path::PathBuf;

use firmware_bridge::link::LinkError;

use crate::config::ConfigError;
use crate::files::is_full;
use crate::part::PartError;
use crate::rig::RigError;
use crate::session::SessionError;
use crate::vision::binarize::ParamsError;

/// Why the cell cannot run, or did not end well.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The cell's file.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The calibration.
    #[error(transparent)]
    Rig(#[from] RigError),
    /// A part file.
    #[error(transparent)]
    Part(#[from] PartError),
    /// Colour range or region.
    #[error(transparent)]
    Params(#[from] ParamsError),
    /// The recorded session.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// A camera.
    #[error("{side} camera: {reason}")]
    Camera {
        /// Which.
        side: &'static str,
        /// What is in the way.
        reason: crate::camera::v4l::CameraError,
    },
    /// The arm.
    #[error("arm: {0}")]
    Arm(#[from] LinkError),
    /// The arm speaks another version or dialect.
    #[error("the arm does not speak what cell.toml says; see the messages above")]
    WrongArm,
    /// `--soak` with live cameras.
    #[error("--soak repeats a recorded session; take a cell with backend = \"replay\"")]
    SoakNeedsReplay,
    /// Pairs in other than their time, and a real arm.
    #[error(
        "{what} plays recorded pairs in other than their time, and would send them to a real arm: take arm.link = \"replay\""
    )]
    RealArm {
        /// What does that.
        what: &'static str,
    },
    /// The record of the place pattern.
    #[error("{}: not a place record ({reason}); empty the tray and remove the file", path.display())]
    PlaceRecord {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// A file or folder that cannot be written.
    #[error("{}: cannot read or write it: {reason}; {}", path.display(), remedy(reason))]
    Unwritable {
        /// The file.
        path: PathBuf,
        /// What the system said.
        reason: io::Error,
    },
    /// Threads, descriptors, signals.
    #[error("the system refused a thread, a descriptor or a signal handler: {0}")]
    System(#[source] io::Error),
    /// Standard output.
    #[error("cannot write to standard output: {0}")]
    Stdout(#[source] io::Error),
    /// A soak that found something.
    #[error("soak failed: {0}")]
    Soak(String),
}

impl RunError {
    /// 2 where the configuration or the usage is to blame, else 1.
    pub fn exit_code(&self) -> u8 {
        match self {
            RunError::System(_) | RunError::Stdout(_) | RunError::Soak(_) => 1,
            // The next start may find room.
            RunError::Unwritable { reason, .. } if is_full(reason) => 1,
            _ => 2,
        }
    }

    /// Whoever read the results does not want any more of them.
    pub fn is_closed_pipe(&self) -> bool {
        matches!(self, RunError::Stdout(reason) if reason.kind() == io::ErrorKind::BrokenPipe)
    }
}

fn remedy(reason: &io::Error) -> &'static str {
    match is_full(reason) {
        true => "make room there",
        false => "check place.state, --out and the rights",
    }
}
