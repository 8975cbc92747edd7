//! The `pickcell` program.

use std::fmt::Display;
use std::io::Write;
use std::process::ExitCode;

use clap::{Parser, Subcommand, ValueEnum};
use pickcell::commands::{accuracy, check, devices, recognize, run, session};

/// Drives a robot cell: two webcams see thin parts in a bin, the arm gets grasp targets
#[derive(Parser)]
#[command(
    version,
    after_help = "Results go to standard output, diagnostics to standard error.\nExit code: 0 done, 1 the job failed, 2 wrong usage or configuration."
)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    /// How diagnostics are written
    #[arg(long, global = true, value_enum, default_value_t = LogFormat::Text)]
    log_format: LogFormat,
}

#[derive(Subcommand)]
enum Command {
    Run(run::RunArgs),
    Recognize(Box<recognize::RecognizeArgs>),
    Accuracy(accuracy::Accuracy),
    Devices(devices::DevicesArgs),
    Check(check::CheckArgs),
    Session(session::SessionArgs),
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum LogFormat {
    /// Lines for people
    Text,
    /// One JSON object a line
    Json,
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    start_log(cli.log_format);
    match cli.command {
        Command::Run(args) => match run::run(&args) {
            Ok(()) => ExitCode::SUCCESS,
            Err(e) if e.is_closed_pipe() => ExitCode::SUCCESS,
            Err(e) => fail(cli.log_format, &e, e.exit_code()),
        },
        Command::Recognize(args) => match recognize::run(&args) {
            Ok(()) => ExitCode::SUCCESS,
            Err(e) if e.is_closed_pipe() => ExitCode::SUCCESS,
            Err(e) => fail(cli.log_format, &e, e.exit_code()),
        },
        Command::Accuracy(args) => match accuracy::run(&args) {
            Ok(code) => code.into(),
            Err(e) => fail(cli.log_format, &e, 1),
        },
        Command::Devices(args) => print(&devices::run(&args), 0),
        Command::Session(args) => match session::run(&args) {
            Ok(text) => print(&text, 0),
            Err(e) => fail(cli.log_format, &e, 2),
        },
        Command::Check(args) => {
            let (text, code) = check::run(&args);
            print(&text, code)
        }
    }
}

/// Puts a result on standard output; whoever reads it may have gone.
fn print(text: &str, code: u8) -> ExitCode {
    drop(std::io::stdout().write_all(text.as_bytes()));
    code.into()
}

/// Diagnostics go to standard error; `PICKCELL_LOG` chooses what, as in `PICKCELL_LOG=debug`.
fn start_log(format: LogFormat) {
    use tracing_subscriber::EnvFilter;
    let filter = EnvFilter::try_from_env("PICKCELL_LOG").unwrap_or_else(|_| EnvFilter::new("info"));
    let log = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::IsTerminal::is_terminal(&std::io::stderr()));
    let started = match format {
        LogFormat::Text => log.with_target(false).try_init(),
        LogFormat::Json => log.json().try_init(),
    };
    // a second logger in one process is no reason to stop
    drop(started);
}

/// Says what went wrong, and gives the exit code.
fn fail(format: LogFormat, error: &dyn Display, code: u8) -> ExitCode {
    match format {
        // standard error may be closed: nothing is left to say it to
        LogFormat::Text => drop(writeln!(std::io::stderr(), "error: {error}")),
        LogFormat::Json => tracing::error!("{error}"),
    }
    code.into()
}
