//! The log of a program: standard error, as lines for people, as JSON, or as the journal of systemd wants it.
//!
//! Where standard error is the journal's, a line begins with its priority in angle brackets (sd-daemon(3)), so that
//! `journalctl -p warning` finds it, and leaves out time and level, which the journal has already.

use std::fmt::{self, Display};
use std::io::{self, IsTerminal, Write};
use std::time::Duration;

use tracing::{Event, Level, Subscriber};
use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt::format::Writer;
use tracing_subscriber::fmt::{FmtContext, FormatEvent, FormatFields};
use tracing_subscriber::registry::LookupSpan;

use crate::outside::has_room;

/// Standard error for a log: what cannot be written there at once is lost. A full disk, a paused terminal, or a reader
/// that has gone must not stop an arm; a logger that gets an error would complain on standard error, and panic over that.
#[derive(Debug, Default)]
pub struct LogOutput;

impl Write for LogOutput {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if has_room(io::stderr(), Duration::ZERO) {
            let _ = io::stderr().write_all(bytes);
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Starts the log of this process; a second start does nothing.
pub fn start(filter: EnvFilter, json: bool) {
    let log = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(|| LogOutput)
        .with_ansi(io::stderr().is_terminal());
    let started = match (json, is_journal()) {
        (false, false) => log.with_target(false).try_init(),
        (true, false) => log.json().try_init(),
        (false, true) => {
            log.with_target(false).with_level(false).without_time().map_event_format(Prioritised).try_init()
        }
        (true, true) => log.json().map_event_format(Prioritised).try_init(),
    };
    drop(started);
}

/// Says why a program ends, where its log goes: `error` behind `prefix`, or a line of JSON.
pub fn fail(prefix: &str, error: &dyn Display, json: bool) {
    match json {
        true => tracing::error!("{error}"),
        false => {
            let priority = if is_journal() { PRIORITY_ERROR } else { "" };
            drop(writeln!(LogOutput, "{priority}{prefix}: {error}"));
        }
    }
}

const PRIORITY_ERROR: &str = "<3>";

/// What the journal is told about a line of this level.
fn priority(level: Level) -> &'static str {
    match level {
        Level::ERROR => PRIORITY_ERROR,
        Level::WARN => "<4>",
        Level::INFO => "<6>",
        _ => "<7>",
    }
}

/// Whether standard error goes to the journal itself, as `JOURNAL_STREAM` says (systemd.exec(5)).
fn is_journal() -> bool {
    let Ok(stream) = std::env::var("JOURNAL_STREAM") else { return false };
    rustix::fs::fstat(io::stderr()).is_ok_and(|stat| stream == format!("{}:{}", stat.st_dev, stat.st_ino))
}

/// Another format with the priority in front of it.
struct Prioritised<F>(F);

impl<S, N, F> FormatEvent<S, N> for Prioritised<F>
where
    S: Subscriber + for<'a> LookupSpan<'a>,
    N: for<'a> FormatFields<'a> + 'static,
    F: FormatEvent<S, N>,
{
    fn format_event(
        &self,
        context: &FmtContext<'_, S, N>,
        mut writer: Writer<'_>,
        event: &Event<'_>,
    ) -> fmt::Result {
        writer.write_str(priority(*event.metadata().level()))?;
        self.0.format_event(context, writer, event)
    }
}
