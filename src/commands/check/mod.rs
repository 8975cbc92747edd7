//! `pickcell check`: is this machine, and is this cell.toml, ready?
//!
//! Every finding is one line with its remedy. Exit code 0: ready (there may be warnings), 1: something would keep
//! the cell from picking, 2: cell.toml or a file that it names is wrong.

mod cameras;
mod files;
mod machine;
mod pair;

use std::fmt::Write as _;
use std::path::PathBuf;

use clap::{Args, ValueEnum};
use firmware_bridge::config::LinkName;
use serde::Serialize;

use crate::config::{Backend, Cell};

const EXAMPLES: &str = "\
Examples:
  pickcell check
  pickcell check --cell cell.toml --format json | jq '.findings[] | select(.level != \"ok\")'

Exit code: 0 ready (warnings are possible), 1 not ready, 2 cell.toml or a file that it names is wrong.";

/// Check whether this machine and this cell.toml are ready to run
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct CheckArgs {
    /// The cell to check
    #[arg(long, value_name = "FILE", default_value = "cell.toml")]
    cell: PathBuf,
    /// How the findings are printed
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

/// `--format`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// A line a finding, with its remedy
    Text,
    /// One JSON object
    Json,
}

/// How bad a finding is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    /// As it should be.
    Ok,
    /// The cell runs, but not as well as it could.
    Warning,
    /// The cell would not pick.
    Error,
    /// cell.toml or a file that it names is wrong.
    Wrong,
}

/// One thing that was looked at.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// How bad it is.
    pub level: Level,
    /// What was looked at: `calibration`, `left camera`, `locked memory`, …
    pub subject: String,
    /// What was found.
    pub finding: String,
    /// What to do about it.
    pub remedy: Option<String>,
}

/// All findings of a check, in the order they were made.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Findings {
    /// See [`Finding`].
    pub findings: Vec<Finding>,
}

impl Findings {
    fn ok(&mut self, subject: &str, finding: impl Into<String>) {
        self.add(Level::Ok, subject, finding.into(), None);
    }

    fn warning(&mut self, subject: &str, finding: impl Into<String>, remedy: impl Into<String>) {
        self.add(Level::Warning, subject, finding.into(), Some(remedy.into()));
    }

    fn error(&mut self, subject: &str, finding: impl Into<String>, remedy: impl Into<String>) {
        self.add(Level::Error, subject, finding.into(), Some(remedy.into()));
    }

    /// For errors that carry their remedy in their own words.
    fn wrong(&mut self, subject: &str, finding: impl Into<String>) {
        self.add(Level::Wrong, subject, finding.into(), None);
    }

    fn add(&mut self, level: Level, subject: &str, finding: String, remedy: Option<String>) {
        self.findings.push(Finding { level, subject: subject.to_owned(), finding, remedy });
    }

    /// 0, 1 or 2; see the module.
    pub fn exit_code(&self) -> u8 {
        match self.findings.iter().map(|finding| finding.level).max() {
            None | Some(Level::Ok | Level::Warning) => 0,
            Some(Level::Error) => 1,
            Some(Level::Wrong) => 2,
        }
    }

    fn in_words(&self) -> String {
        let mut text = String::new();
        for Finding { level, subject, finding, remedy } in &self.findings {
            let mark = match level {
                Level::Ok => "ok",
                Level::Warning => "WARNING",
                Level::Error | Level::Wrong => "ERROR",
            };
            let _ = writeln!(text, "{mark:<8} {subject}: {finding}");
            if let Some(remedy) = remedy {
                let _ = writeln!(text, "         → {remedy}");
            }
        }
        let count = |level| self.findings.iter().filter(|finding| finding.level == level).count();
        let errors = count(Level::Error) + count(Level::Wrong);
        let _ = match self.exit_code() {
            0 => writeln!(text, "ready, {} warning(s)", count(Level::Warning)),
            _ => writeln!(text, "not ready: {errors} error(s), {} warning(s)", count(Level::Warning)),
        };
        text
    }

    fn as_json(&self) -> String {
        #[derive(Serialize)]
        struct Report<'a> {
            ready: bool,
            findings: &'a [Finding],
        }
        let report = Report { ready: self.exit_code() == 0, findings: &self.findings };
        format!("{}\n", serde_json::to_string_pretty(&report).unwrap_or_default())
    }
}

/// Checks everything. Gives what stands on standard output, and the exit code.
pub fn run(args: &CheckArgs) -> (String, u8) {
    let findings = check(args);
    let text = match args.format {
        Format::Text => findings.in_words(),
        Format::Json => findings.as_json(),
    };
    (text, findings.exit_code())
}

fn check(args: &CheckArgs) -> Findings {
    let mut findings = Findings::default();
    let cell = match Cell::read(&args.cell) {
        Ok(cell) => cell,
        Err(error) => {
            findings.wrong("cell.toml", error.to_string());
            return findings;
        }
    };
    findings.ok("cell.toml", format!("{} is well formed", args.cell.display()));
    let rig = files::check(&cell, &mut findings);
    match cell.cameras.backend {
        Backend::V4l2 => cameras::check(&cell, rig.as_ref(), &mut findings),
        Backend::Replay => {}
    }
    if cell.plays_fast() && cell.arm_side.arm.link != LinkName::Replay {
        findings.error(
            "arm",
            "cameras.pace = \"fast\" would send recorded targets to a real arm; run refuses that",
            "take arm.link = \"replay\", or cameras.pace = \"realtime\"",
        );
    }
    if let Some(rig) = &rig {
        files::check_workspace(&cell, rig, &mut findings);
    }
    machine::check(&cell, &mut findings);
    findings
}

#[cfg(test)]
mod tests;
