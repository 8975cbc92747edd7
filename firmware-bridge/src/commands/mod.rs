//! The commands of `firmware-bridge`, one file each, and what they share: log, signals, exit codes.

pub(crate) mod run;
pub(crate) mod simulate;

use firmware_bridge::config::ConfigError;
use firmware_bridge::link::LinkError;
use firmware_bridge::log;
use firmware_bridge::outside::ending_signals;
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::process::ExitCode;

/// Text for people, JSON for programs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Format {
    /// One line an event.
    Text,
    /// One JSON object an event.
    Json,
}

/// Why a command ended otherwise than well.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Failure {
    #[error(transparent)]
    Config(#[from] ConfigError),
    #[error(transparent)]
    Link(#[from] LinkError),
    #[error("{} exists and is no link to a terminal: choose another name for --pty", .0.display())]
    NotALink(PathBuf),
    #[error("cannot make the link {}: {reason}; choose another name for --pty", path.display())]
    MakeLink { path: PathBuf, reason: std::io::Error },
    #[error("--park-mm {0} is no point: give x,y,z in mm, e.g. --park-mm 0,-150,200")]
    Park(String),
    #[error("cannot make a pty: {0}; is /dev/pts mounted?")]
    Pty(std::io::Error),
    #[error("the pty broke: {0}")]
    PtyBroken(std::io::Error),
    #[error("the arm speaks version {theirs} of the own protocol, this program {ours}: update one of them")]
    WrongVersion { ours: u16, theirs: u16 },
    #[error(
        "what answers on the arm's port is no arm of this dialect: check arm.dialect, arm.port and arm.baud"
    )]
    WrongDialect,
    #[error("cannot catch signals: {0}")]
    Signals(std::io::Error),
}

impl Failure {
    /// 2 for what the user can mend by other arguments or another cell.toml, 1 for the rest.
    pub(crate) fn exit_code(&self) -> ExitCode {
        match self {
            Failure::Config(_)
            | Failure::Link(_)
            | Failure::NotALink(_)
            | Failure::MakeLink { .. }
            | Failure::Park(_)
            | Failure::WrongVersion { .. }
            | Failure::WrongDialect => 2.into(),
            Failure::Pty(_) | Failure::PtyBroken(_) | Failure::Signals(_) => 1.into(),
        }
    }
}

/// The receiving end of a socket into which the signals that end a process put a byte.
pub(crate) fn catch_signals() -> Result<UnixStream, Failure> {
    let pair = || -> std::io::Result<UnixStream> {
        let (read, write) = UnixStream::pair()?;
        read.set_nonblocking(true)?;
        for signal in ending_signals() {
            signal_hook::low_level::pipe::register(signal, write.try_clone()?)?;
        }
        Ok(read)
    };
    pair().map_err(Failure::Signals)
}

/// Whether a signal has come.
pub(crate) fn signalled(mut signals: &UnixStream) -> bool {
    matches!(std::io::Read::read(&mut signals, &mut [0; 8]), Ok(len) if len > 0)
}

/// Says why a command failed, and gives the exit code.
pub(crate) fn fail(failure: &Failure, format: Format) -> ExitCode {
    log::fail("firmware-bridge", failure, format == Format::Json);
    failure.exit_code()
}
