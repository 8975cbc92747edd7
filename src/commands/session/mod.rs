//! `pickcell session`: what is in a recorded session; a piece of one; what is left of a damaged one.

mod info;

use std::path::{Path, PathBuf};

use clap::{Args, Subcommand, ValueEnum};
use serde_json::json;

use crate::session::SessionError;
use crate::session::copy::{self, Copied, CopyError};

/// Look at recorded sessions, cut pieces out of them, recover damaged ones
#[derive(Args, Debug)]
#[command(after_help = "Example: pickcell session info replay/conveyor")]
pub struct SessionArgs {
    #[command(subcommand)]
    command: SessionCommand,
}

#[derive(Subcommand, Debug)]
enum SessionCommand {
    /// Say what is in a session: pairs, rate, duration, formats, what is missing, targets and what became of them
    #[command(after_help = "\
Example: pickcell session info recordings/2026-03-01T12-30-05.250Z.mcap

Exit code: 0 done, 2 no session, or one that is damaged.")]
    Info(InfoArgs),
    /// Copy a piece of a recording into a new file
    ///
    /// Pairs are copied whole, with what was found in them and what cell and arm said meanwhile; cell.toml, calibration
    /// and part files come along. Replayed, its arm begins ready, also where a target was under way.
    #[command(after_help = "\
Example: pickcell session cut recordings/2026-03-01T12-30-05.250Z.mcap --from 12.5 --to 20 --out jam.mcap

Exit code: 0 done, 1 the new file cannot be written, 2 wrong usage, or no such recording.
The new file is there whole or not at all, and replaces none.")]
    Cut(CutArgs),
    /// Copy all that can be read of a damaged recording into a new file
    ///
    /// Also of one whose end is missing after a kill or a power cut: this one can be replayed as it is, and gets an index by
    /// this, which players need to jump in it.
    #[command(after_help = "\
Example: pickcell session recover recordings/2026-03-01T12-30-05.250Z.mcap --out whole.mcap

Exit code: 0 done, 1 the new file cannot be written, 2 wrong usage, or nothing to recover.
The new file is there whole or not at all, and replaces none.")]
    Recover(RecoverArgs),
}

#[derive(Args, Debug)]
struct InfoArgs {
    /// The recording (.mcap), or a folder with left/, right/ and session.toml
    session: PathBuf,
    /// How it is written
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

#[derive(Args, Debug)]
struct CutArgs {
    /// The recording (.mcap)
    recording: PathBuf,
    /// Where the piece begins, seconds after the first picture
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0, allow_negative_numbers = true, value_parser = seconds)]
    from: f64,
    /// Where it ends; else with the recording
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true, value_parser = seconds)]
    to: Option<f64>,
    /// The new file
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// How it is told
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

#[derive(Args, Debug)]
struct RecoverArgs {
    /// The recording (.mcap)
    recording: PathBuf,
    /// The new file
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// How it is told
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    /// Lines for people
    Text,
    /// One JSON object
    Json,
}

/// Why there is no answer.
#[derive(Debug, thiserror::Error)]
pub enum SessionCommandError {
    /// No session.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// No copy of it.
    #[error(transparent)]
    Copy(#[from] CopyError),
}

impl SessionCommandError {
    /// Of the program.
    pub fn exit_code(&self) -> u8 {
        match self {
            SessionCommandError::Copy(error) if !error.is_usage() => 1,
            _ => 2,
        }
    }
}

/// Does what is asked; gives what to print.
///
/// # Errors
/// A session cannot be read, or no copy of it be made.
pub fn run(args: &SessionArgs) -> Result<String, SessionCommandError> {
    match &args.command {
        SessionCommand::Info(args) => Ok(info::run(&args.session, args.format)?),
        SessionCommand::Cut(args) => {
            let seconds = (args.from, args.to.unwrap_or(f64::INFINITY));
            let copied = copy::cut(&args.recording, seconds, &args.out)?;
            Ok(told(&args.out, &copied, args.format))
        }
        SessionCommand::Recover(args) => {
            let copied = copy::recover(&args.recording, &args.out)?;
            Ok(told(&args.out, &copied, args.format))
        }
    }
}

fn told(out: &Path, copied: &Copied, format: Format) -> String {
    let Copied { messages, bytes, pairs, lost_at, unknown } = copied;
    if format == Format::Json {
        let pairs = (*pairs > 0).then_some(pairs);
        let about = json!({
            "session": out, "messages": messages, "bytes": bytes, "pairs": pairs, "lost_at_bytes": lost_at,
            "unknown_messages": unknown,
        });
        return about.to_string() + "\n";
    }
    let pairs = if *pairs > 0 { format!("{pairs} pairs, ") } else { String::new() };
    let megabytes = *bytes as f64 / 1e6;
    let mut text = format!("{}: {pairs}{messages} messages, {megabytes:.1} MB\n", out.display());
    if let (Some(first), n) = (lost_at.first(), lost_at.len()) {
        let places = if n == 1 { String::new() } else { format!(" and at {} places behind it", n - 1) };
        text += &format!("lost: what stood at byte {first} of the old file{places}\n");
    }
    if *unknown > 0 {
        text += &format!("left out: {unknown} messages of which nothing says any more what they are\n");
    }
    text
}

/// A time in a recording.
fn seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(seconds) if seconds.is_finite() && seconds >= 0.0 => Ok(seconds),
        _ => Err("needed are seconds after the first picture, 0 or more, as in 12.5".into()),
    }
}
