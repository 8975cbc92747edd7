//! What can be wrong with part files.

use std::io;
use std::path::PathBuf;

use firmware_bridge::config::TextError;

/// A part file that cannot be used: names file, key, value and what to do.
#[derive(Debug, thiserror::Error)]
pub enum PartError {
    /// The file cannot be read.
    #[error("part file {path}: {source}; give the path of a TOML file with name, thickness_mm, [[node]], [[edge]] and [grasp]", path = .path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// No TOML, an unknown key, a missing one, or a value of another type.
    #[error("part file {}", error.in_file(path))]
    Toml {
        /// The file.
        path: PathBuf,
        /// What is wrong, and where.
        error: TextError,
    },
    /// A key has a value that cannot be.
    #[error("part file {path}: {key} = {value}: {problem}", path = .path.display())]
    Value {
        /// The file.
        path: PathBuf,
        /// The key, with the node or edge that it belongs to.
        key: String,
        /// The value.
        value: String,
        /// What is wrong and what is allowed.
        problem: String,
    },
    /// An edge names a node that is not there.
    #[error("part file {path}: edge {edge}: {key} = \"{node}\" is no node of this part; its nodes are {known}", path = .path.display())]
    UnknownNode {
        /// The file.
        path: PathBuf,
        /// The edge, counted from 1.
        edge: usize,
        /// `from` or `to`.
        key: &'static str,
        /// The name.
        node: String,
        /// The names there are.
        known: String,
    },
    /// The nodes and edges do not make a part.
    #[error("part file {path}: {problem}", path = .path.display())]
    Shape {
        /// The file.
        path: PathBuf,
        /// What is wrong and what to do.
        problem: String,
    },
    /// Two files with parts of one name.
    #[error("part files {first} and {second}: both have name = \"{name}\"; every part needs a name of its own", first = .first.display(), second = .second.display())]
    TwoOfOneName {
        /// The name.
        name: String,
        /// The file that had it first.
        first: PathBuf,
        /// The other one.
        second: PathBuf,
    },
}
