//! The `pickcell` program.

use std::fmt::Display;
use std::io::Write;
use std::process::ExitCode;

use clap::{Parser, Subcommand, ValueEnum};
use firmware_bridge::log;
use pickcell::commands::{accuracy, check, devices, recognize, run, session};
use tracing_subscriber::EnvFilter;

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
    let cli = Cli::parse_from(recognize::corners_as_values(std::env::args_os()));
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
            Err(e) if accuracy::is_closed_pipe(&*e) => ExitCode::SUCCESS,
            Err(e) => fail(cli.log_format, &e, accuracy::exit_code(&*e)),
        },
        Command::Devices(args) => print(cli.log_format, &devices::run(&args), 0),
        Command::Session(args) => match session::run(&args) {
            Ok(text) => print(cli.log_format, &text, 0),
            Err(e) => fail(cli.log_format, &e, e.exit_code()),
        },
        Command::Check(args) => {
            let (text, code) = check::run(&args);
            print(cli.log_format, &text, code)
        }
    }
}

/// Puts a result on standard output. Whoever reads it may have gone; that it has no room is a failure.
fn print(format: LogFormat, text: &str, code: u8) -> ExitCode {
    let mut out = std::io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => {
            fail(format, &format!("cannot write to standard output: {e}"), code.max(1))
        }
        _ => code.into(),
    }
}

/// Diagnostics go to standard error; `PICKCELL_LOG` chooses what, as in `PICKCELL_LOG=debug`.
fn start_log(format: LogFormat) {
    let filter = EnvFilter::try_from_env("PICKCELL_LOG").unwrap_or_else(|_| EnvFilter::new("info"));
    log::start(filter, format == LogFormat::Json);
}

/// Says what went wrong, and gives the exit code.
fn fail(format: LogFormat, error: &dyn Display, code: u8) -> ExitCode {
    log::fail("error", error, format == LogFormat::Json);
    code.into()
}
