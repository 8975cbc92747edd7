//! The text of a `cell.toml` and the way from a key or a byte position to its line.

use std::fmt::Display;
use std::ops::Range;
use std::path::{Path, PathBuf};

use firmware_bridge::outside::read_text;
use serde::de::DeserializeOwned;
use toml::de::{DeTable, DeValue};

use super::error::{ConfigError, Location};

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
    /// [`ConfigError::Malformed`], [`ConfigError::UnknownKey`], [`ConfigError::Missing`].
    pub fn parse<T: DeserializeOwned>(&self) -> Result<T, ConfigError> {
        toml::from_str(&self.text).map_err(|e| self.explain(&e))
    }

    /// The error about a value that the checks refuse.
    pub fn refuse(&self, key: &str, value: impl Display, allowed: impl Into<String>) -> ConfigError {
        ConfigError::Value {
            location: self.location(key),
            key: key.to_owned(),
            value: shortened(value.to_string()),
            allowed: allowed.into(),
        }
    }

    /// The error about a key that must be there.
    pub fn missing(&self, key: &str, remedy: impl Into<String>) -> ConfigError {
        let table = key.rsplit_once('.').map_or("", |(table, _)| table);
        ConfigError::Missing { location: self.location(table), key: key.to_owned(), remedy: remedy.into() }
    }

    /// A path as written under `key`, made to start at the file's folder; it has to exist.
    ///
    /// # Errors
    /// [`ConfigError::NoSuchPath`].
    pub fn existing(&self, key: &str, written: &str) -> Result<PathBuf, ConfigError> {
        let path = self.resolve(written);
        if path.exists() {
            return Ok(path);
        }
        Err(ConfigError::NoSuchPath {
            location: self.location(key),
            key: key.to_owned(),
            value: written.to_owned(),
            path,
        })
    }

    /// A path as written, made to start at the file's folder.
    pub fn resolve(&self, written: &str) -> PathBuf {
        let folder = self.folder();
        if folder == Path::new(".") { PathBuf::from(written) } else { folder.join(written) }
    }

    /// File and line of a dotted key (`cameras.left.width`), or of the nearest table above it.
    pub fn location(&self, key: &str) -> Location {
        let line = DeTable::parse(&self.text)
            .ok()
            .and_then(|root| find(root.get_ref(), key))
            .map(|span| self.line(span.start));
        Location { file: self.file.clone(), line }
    }

    fn line(&self, byte: usize) -> usize {
        1 + self.text.as_bytes()[..byte.min(self.text.len())].iter().filter(|&&b| b == b'\n').count()
    }

    fn explain(&self, error: &toml::de::Error) -> ConfigError {
        let message = error.message().trim_end().to_owned();
        let span = error.span();
        let location = Location { file: self.file.clone(), line: span.clone().map(|s| self.line(s.start)) };
        let key = match (DeTable::parse(&self.text), span) {
            (Ok(root), Some(span)) => key_at(root.get_ref(), &span),
            _ => String::new(),
        };
        if let Some((field, allowed)) = unknown_field(&message) {
            let key = if key.ends_with(field) { key } else { join(&key, field) };
            return ConfigError::UnknownKey { location, key, allowed };
        }
        if let Some(field) = quoted(&message).filter(|_| message.starts_with("missing field")) {
            let remedy = "this key has no default".to_owned();
            return ConfigError::Missing { location, key: join(&key, field), remedy };
        }
        ConfigError::Malformed { location, key, message: plain(&message.replace('\n', " ")) }
    }
}

/// Longest value that a message repeats, characters: 1e308 has as many digits.
const VALUE_CHARS_MAX: usize = 200;

fn shortened(value: String) -> String {
    match value.char_indices().nth(VALUE_CHARS_MAX) {
        Some((end, _)) => format!("{}…", &value[..end]),
        None => value,
    }
}

/// A message without the names that a program has for numbers.
fn plain(message: &str) -> String {
    let words = [
        ("expected u64", "expected a whole number, 0 or more"),
        ("expected usize", "expected a whole number, 0 or more"),
        ("expected u32", "expected a whole number from 0 to 4294967295"),
        ("expected u8", "expected a whole number from 0 to 255"),
        ("expected f64", "expected a number"),
    ];
    let of_program = words.iter().find_map(|(name, words)| Some((message.strip_suffix(name)?, words)));
    of_program.map_or_else(|| message.to_owned(), |(rest, words)| format!("{rest}{words}"))
}

/// `unknown field `x`, expected one of `a`, `b`` → ("x", "a, b").
fn unknown_field(message: &str) -> Option<(&str, String)> {
    let rest = message.strip_prefix("unknown field `")?;
    let (field, rest) = rest.split_once('`')?;
    let allowed: Vec<&str> = rest.split('`').skip(1).step_by(2).collect();
    let allowed = if allowed.is_empty() { "none".to_owned() } else { allowed.join(", ") };
    Some((field, allowed))
}

fn quoted(message: &str) -> Option<&str> {
    message.split('`').nth(1)
}

fn join(table: &str, key: &str) -> String {
    if table.is_empty() { key.to_owned() } else { format!("{table}.{key}") }
}

/// Where a dotted key stands; falls back to the deepest part of it that exists. A number in the key is an index.
fn find(table: &DeTable<'_>, key: &str) -> Option<Range<usize>> {
    let mut span = None;
    let mut table = table;
    for part in key.split('.') {
        let Some((name, value)) = table.iter().find(|(name, _)| name.get_ref() == part) else { break };
        span = Some(name.span());
        let DeValue::Table(inner) = value.get_ref() else { break };
        table = inner;
    }
    span
}

/// The dotted key whose name or value covers `span`.
fn key_at(table: &DeTable<'_>, span: &Range<usize>) -> String {
    for (name, value) in table.iter() {
        let own = name.span();
        let covers = |range: &Range<usize>| range.start <= span.start && span.end <= range.end;
        if let DeValue::Table(inner) = value.get_ref() {
            let below = key_at(inner, span);
            if !below.is_empty() {
                return join(name.get_ref(), &below);
            }
        }
        if covers(&own) || covers(&value.span()) {
            return name.get_ref().to_string();
        }
    }
    String::new()
}
