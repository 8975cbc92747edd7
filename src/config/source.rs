//! The text of a `cell.toml`, and what is said about it.

use std::fmt::Display;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use firmware_bridge::config::{Fault, TextError, read_toml};
use firmware_bridge::outside::read_text;
use serde::de::DeserializeOwned;

use super::error::ConfigError;

/// The file as text; knows where every key stands.
#[derive(Clone, Debug)]
pub struct Source {
    /// The file as it was named.
    pub file: PathBuf,
    /// Its contents.
    pub text: String,
}

impl Source {
    /// Reads the file.
    ///
    /// # Errors
    /// [`ConfigError::Unreadable`].
    pub fn read(file: &Path) -> Result<Self, ConfigError> {
        let text =
            read_text(file).map_err(|reason| ConfigError::Unreadable { file: file.to_path_buf(), reason })?;
        Ok(Source { file: file.to_path_buf(), text })
    }

    /// The folder that relative paths start at.
    pub fn folder(&self) -> &Path {
        match self.file.parent() {
            Some(folder) if !folder.as_os_str().is_empty() => folder,
            _ => Path::new("."),
        }
    }

    /// The file as `T`; the first error names its key and line.
    ///
    /// # Errors
    /// [`ConfigError::Text`].
    pub fn parse<T: DeserializeOwned>(&self) -> Result<T, ConfigError> {
        read_toml(&self.text).map_err(|error| ConfigError::Text { file: self.file.clone(), error })
    }

    /// The error about something in the text.
    pub fn wrong(&self, fault: Fault) -> ConfigError {
        ConfigError::Text { file: self.file.clone(), error: TextError::of(&self.text, fault) }
    }

    /// The error about a value that the checks refuse.
    pub fn refuse(&self, key: &str, value: impl Display, allowed: impl Into<String>) -> ConfigError {
        self.wrong(Fault::value(key, value, allowed))
    }

    /// The error about a key that must be there.
    pub fn missing(&self, key: &str, remedy: impl Into<String>) -> ConfigError {
        self.wrong(Fault::Missing { key: key.to_owned(), remedy: remedy.into() })
    }

    /// A whole number as written under `key`, if it is in the range; `allowed` says that in words.
    ///
    /// # Errors
    /// The number is out of the range.
    pub fn whole<T: TryFrom<i64>>(
        &self,
        key: &str,
        written: i64,
        range: RangeInclusive<i64>,
        allowed: &str,
    ) -> Result<T, ConfigError> {
        let number = T::try_from(written).ok().filter(|_| range.contains(&written));
        number.ok_or_else(|| self.refuse(key, written, allowed))
    }

    /// A path as written under `key`, made to start at the file's folder; it has to exist.
    ///
    /// # Errors
    /// Nothing is there.
    pub fn existing(&self, key: &str, written: &str) -> Result<PathBuf, ConfigError> {
        let path = self.resolve(written);
        if path.exists() {
            return Ok(path);
        }
        let (key, value, path) = (key.to_owned(), written.to_owned(), path.display().to_string());
        Err(self.wrong(Fault::NoSuchPath { key, value, path }))
    }

    /// A path as written, made to start at the file's folder.
    pub fn resolve(&self, written: &str) -> PathBuf {
        let folder = self.folder();
        if folder == Path::new(".") { PathBuf::from(written) } else { folder.join(written) }
    }
}
