//! `[recording]`: what is kept of every run.

use std::path::PathBuf;

use serde::Deserialize;

use super::error::ConfigError;
use super::source::Source;

/// `[recording]`: one MCAP file a run, named after the time of its start.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Recording {
    /// Where the files go; made where it is not there.
    pub folder: PathBuf,
    /// Which pairs keep their pictures. Results, arm and events are always kept.
    pub pictures: KeptPictures,
    /// A file is full when it has grown to this, bytes.
    pub file_bytes_max: u64,
    /// What then.
    pub when_full: WhenFull,
}

/// Which pairs keep their pictures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum KeptPictures {
    /// Every pair: the recording can be replayed.
    #[default]
    All,
    /// Those that led to a target.
    Targets,
    /// None.
    None,
}

/// What happens when a file is full.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum WhenFull {
    /// The recording ends, the cell goes on.
    #[default]
    Stop,
    /// Another file is begun; of this run the newest two are kept.
    NextFile,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Written {
    folder: String,
    #[serde(default)]
    pictures: KeptPictures,
    file_mb_max: Option<i64>,
    #[serde(default)]
    when_full: WhenFull,
}

impl Written {
    pub(super) fn check(self, source: &Source) -> Result<Recording, ConfigError> {
        if self.folder.trim().is_empty() {
            return Err(source.refuse("recording.folder", "\"\"", "a folder for the recordings"));
        }
        let file_mb_max = self.file_mb_max.unwrap_or(4000);
        let file_mb_max: u64 =
            source.whole("recording.file_mb_max", file_mb_max, 1..=10_000_000, "1 to 10000000 MB")?;
        Ok(Recording {
            folder: source.resolve(&self.folder),
            pictures: self.pictures,
            file_bytes_max: file_mb_max * 1_000_000,
            when_full: self.when_full,
        })
    }
}
