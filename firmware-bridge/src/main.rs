//! `firmware-bridge`: the arm's side of a PickCell as a process of its own, and simulated arms.
//!
//! Exit codes: 0 done (also after SIGINT, SIGTERM or SIGHUP), 1 the job failed, 2 wrong usage or configuration.

mod commands;

use clap::{Parser, Subcommand};
use std::process::ExitCode;
use tracing_subscriber::EnvFilter;

/// The arm's side of a PickCell.
#[derive(Parser)]
#[command(version, about, max_term_width = 100)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
    /// How much to say on standard error: error, warn, info, debug, trace.
    #[arg(long, global = true, default_value = "info", value_name = "LEVEL")]
    log: tracing::level_filters::LevelFilter,
    /// Shape of the log lines.
    #[arg(long, global = true, default_value = "text", value_name = "FORMAT")]
    log_format: commands::Format,
}

#[derive(Subcommand)]
enum Command {
    /// Takes targets from shared memory and brings them to a serial arm of any dialect.
    Run(commands::run::Arguments),
    /// Is an arm: listens on a new pty, moves with plausible timing, prints what it does.
    Simulate(commands::simulate::Arguments),
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let filter = EnvFilter::new(arguments.log.to_string());
    firmware_bridge::log::start(filter, arguments.log_format == commands::Format::Json);
    let result = match arguments.command {
        Command::Run(arguments) => commands::run::run(&arguments),
        Command::Simulate(arguments) => commands::simulate::run(&arguments),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => commands::fail(&failure, arguments.log_format),
    }
}
