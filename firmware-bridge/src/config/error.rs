//! What can be wrong with the tables of cell.toml that belong to the arm's side.

use std::path::{Path, PathBuf};

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
    /// Something in a file.
    #[error("{}: {error}", path.display())]
    File {
        /// Which file.
        path: PathBuf,
        /// What is wrong in it.
        error: Box<ConfigError>,
    },
    /// It is no TOML, or a key is unknown or of the wrong type.
    #[error("{0}")]
    Toml(#[from] toml::de::Error),
    /// A move template is not allowed.
    #[error(transparent)]
    Template(#[from] crate::gcode::template::TemplateError),
    /// A value is not allowed.
    #[error("{key} = {value} is not allowed: it must be {allowed}")]
    Value {
        /// Table and key.
        key: &'static str,
        /// What was written.
        value: String,
        /// What may be written.
        allowed: String,
    },
    /// A key is missing that other keys make necessary.
    #[error("{key} is missing: {because}")]
    Missing {
        /// Table and key.
        key: &'static str,
        /// What needs it, and an example.
        because: &'static str,
    },
}

impl ConfigError {
    /// The same, of the file at `path`.
    pub(crate) fn of(self, path: &Path) -> Self {
        ConfigError::File { path: path.into(), error: Box::new(self) }
    }
}
