//! What can be wrong with a `cell.toml`, said with file, line, key, value and what is allowed.

use std::path::PathBuf;

use firmware_bridge::config::TextError;

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
    /// Something in it.
    #[error("{}", error.in_file(file))]
    Text {
        /// The file as it was named.
        file: PathBuf,
        /// What is wrong, and where.
        error: TextError,
    },
}
