//! The command line of `pickcell run`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use crate::commands::whole;

/// Run the cell: cameras in, grasp targets out to the arm
///
/// Prints a line for every frame pair and a table at the end; draws an overlay picture a pair of a recorded session.
#[derive(Args, Debug)]
#[command(after_help = "\
Example: pickcell run --cell cell.toml
         pickcell run --soak 20000 --rate 30

Signals: SIGINT, SIGTERM, SIGHUP: no further target, the arm is told to hold and has four seconds to confirm it, exit.
         SIGUSR1: the operator's release. SIGUSR2: the operator's hold. Software is no emergency stop.
Exit code: 0 done, 1 the job failed, 2 wrong usage or configuration.")]
pub struct RunArgs {
    /// The cell
    #[arg(long, value_name = "FILE", default_value = "cell.toml")]
    pub cell: PathBuf,
    /// Budget of every search in iterations instead of the time that the deadline leaves, and of those of a recording
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = whole::<u64>(1, u64::MAX))]
    pub iterations: Option<u64>,
    /// Seed of all searches instead of the cell's and those of a recording
    #[arg(long, allow_hyphen_values = true, value_parser = whole::<u64>(0, u64::MAX))]
    pub seed: Option<u64>,
    /// Folder of the overlay pictures
    #[arg(long, value_name = "DIR", default_value = "out")]
    pub out: PathBuf,
    /// Which pairs get an overlay picture; default: all of a recorded session, none of live cameras and of a soak
    #[arg(long, value_enum, conflicts_with = "soak")]
    pub overlay: Option<Overlays>,
    /// Which pairs get a line on standard output
    #[arg(long, value_enum, default_value_t = Lines::All, conflicts_with = "soak")]
    pub lines: Lines,
    /// How results are written to standard output
    #[arg(long, value_enum, default_value_t = Format::Text)]
    pub format: Format,
    /// Wait for cameras and a serial port that are not there or cannot be opened yet, as a service does that is started
    /// before them; without it that is an error, of cameras after five seconds
    #[arg(long)]
    pub wait: bool,
    /// Endurance test: repeat the recorded session until so many pairs were played, print no lines, draw nothing, fail (exit
    /// code 1) on a missed deadline or growing memory. Where the cell sets no deadline, it is one period of --rate
    #[arg(long, value_name = "PAIRS", allow_hyphen_values = true, value_parser = whole::<u64>(1, 100_000_000))]
    pub soak: Option<u64>,
    /// Decode the JPEG pictures of a recorded session beforehand, as cameras without compression deliver them
    #[arg(long)]
    pub raw: bool,
    /// Pairs a second of a soak, or max: as fast as the cell takes them
    #[arg(long, value_name = "HZ", default_value = "max", requires = "soak")]
    pub rate: Rate,
}

/// Which pairs get an overlay picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Overlays {
    /// Every pair
    All,
    /// No pair
    None,
}

/// Which pairs get a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Lines {
    /// Every pair
    All,
    /// Those that lead to a target, or to none for another reason than the pair before
    Changes,
    /// No pair
    None,
}

/// How results are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// Lines for people
    Text,
    /// One JSON object a pair, one at the end
    Json,
}

/// Pairs a second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Rate {
    /// As fast as the cell takes them.
    Max,
    /// So many.
    Hz(f64),
}

impl std::str::FromStr for Rate {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.parse() {
            _ if text == "max" => Ok(Rate::Max),
            Ok(hz) if (0.1..=1000.0).contains(&hz) => Ok(Rate::Hz(hz)),
            _ => Err("a rate is max, or pairs a second from 0.1 to 1000".into()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rate_is_a_number_or_max() {
        assert_eq!("max".parse(), Ok(Rate::Max));
        assert_eq!("30".parse(), Ok(Rate::Hz(30.0)));
        for bad in ["0", "-1", "fast", "nan", "1e9"] {
            assert!(bad.parse::<Rate>().unwrap_err().contains("from 0.1 to 1000"), "{bad}");
        }
    }
}
