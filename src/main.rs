//! The `pickcell` program.
use clap::Parser;

#[derive(Parser)]
enum Cli {
    Accuracy(pickcell::commands::accuracy::Accuracy),
}

fn main() -> std::process::ExitCode {
    let result = match Cli::parse() {
        Cli::Accuracy(a) => pickcell::commands::accuracy::run(&a),
    };
    match result {
        Ok(code) => code.into(),
        Err(e) => {
            eprintln!("{e}");
            1.into()
        }
    }
}
