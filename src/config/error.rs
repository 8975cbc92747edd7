//! What can be wrong with a `cell.toml`, said with file, line, key, value and what is allowed.

use std::fmt;
use std::path::PathBuf;

/// Where in the file something stands: `cell.toml, line 12`, or only the file where the line is unknown.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Location {
    /// The file as it was named.
    pub file: PathBuf,
    /// Line, counted from 1.
    pub line: Option<usize>,
}

impl fmt::Display for Location {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.line {
            Some(line) => write!(f, "{}, line {line}", self.file.display()),
            None => write!(f, "{}", self.file.display()),
        }
    }
}

/// A `cell.toml` that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file itself could not be read.
    #[error("{}: cannot read it: {reason}; name the cell's file with --cell FILE", file.display())]
    Unreadable {
        /// The file as it was named.
        file: PathBuf,
        /// What the system said.
        reason: std::io::Error,
    },
    /// Not TOML, or not the right kind of value under a key.
    #[error("{location}: {}{message}", key_prefix(key))]
    Malformed {
        /// File and line.
        location: Location,
        /// Dotted key, empty where the text is no TOML.
        key: String,
        /// What is wrong, with what was expected.
        message: String,
    },
    /// A key that no table has.
    #[error("{location}: {key}: there is no such key; allowed here: {allowed}")]
    UnknownKey {
        /// File and line.
        location: Location,
        /// Dotted key.
        key: String,
        /// The keys of that table.
        allowed: String,
    },
    /// A key that is needed is not there.
    #[error("{location}: {key} is missing; {remedy}")]
    Missing {
        /// File and line of the table.
        location: Location,
        /// Dotted key.
        key: String,
        /// What to write there.
        remedy: String,
    },
    /// A value outside what its key allows.
    #[error("{location}: {key} = {value} is not possible; allowed: {allowed}")]
    Value {
        /// File and line.
        location: Location,
        /// Dotted key.
        key: String,
        /// The value as written.
        value: String,
        /// What is allowed, with unit.
        allowed: String,
    },
    /// A path in the file leads nowhere.
    #[error("{location}: {key} = {value:?}: no such file or folder ({}); paths start at the folder of cell.toml", path.display())]
    NoSuchPath {
        /// File and line.
        location: Location,
        /// Dotted key.
        key: String,
        /// The path as written.
        value: String,
        /// The path as it was looked for.
        path: PathBuf,
    },
    /// One of the tables that firmware-bridge reads.
    #[error("{location}: {message}")]
    ArmSide {
        /// File and line.
        location: Location,
        /// What firmware-bridge says about it.
        message: String,
    },
}

fn key_prefix(key: &str) -> String {
    if key.is_empty() { String::new() } else { format!("{key}: ") }
}
