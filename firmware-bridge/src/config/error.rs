//! What can be wrong with the tables of cell.toml that belong to the arm's side.

use std::path::PathBuf;

use super::fault::TextError;

/// What is wrong with a cell.toml.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// It cannot be read.
    #[error("cannot read {path}: {source}; name a cell.toml with --cell")]
    Read {
        /// Which file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// Something in it.
    #[error("{}", error.in_file(path))]
    File {
        /// Which file.
        path: PathBuf,
        /// What is wrong in it.
        error: TextError,
    },
}
