//! What is wrong in a TOML file, in the words of whoever wrote it: line, key, value and what to write instead.
//!
//! Takes the text and what the TOML reader says about it, or what a check refuses; gives a [`TextError`]. The names that
//! a program has for its types are not repeated.
//!
//! ```
//! use firmware_bridge::config::{Fault, TextError, read_toml};
//!
//! #[derive(Debug, serde::Deserialize)]
//! struct Session {
//!     rate_hz: f64,
//! }
//! let error = read_toml::<Session>("# 20 pairs\nrate_hz = \"fast\"\n").unwrap_err();
//! assert_eq!(error.to_string(), "line 2: rate_hz = \"fast\" is not possible; allowed: a number");
//!
//! let text = "rate_hz = -3\n";
//! let session: Session = read_toml(text)?;
//! let refused = TextError::of(text, Fault::value("rate_hz", session.rate_hz, "frames a second above 0"));
//! assert_eq!(refused.line, Some(1));
//! # Ok::<(), TextError>(())
//! ```

use std::fmt::Display;
use std::ops::Range;
use std::path::Path;

use serde::de::DeserializeOwned;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use crate::gcode::template::TemplateError;

/// Longest piece of a file that a message repeats, characters: 1e308 has as many digits.
const WRITTEN_CHARS_MAX: usize = 200;

/// What is wrong with a key, and what to do. Keys are dotted; of a list, entries count from 1.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Fault {
    /// A key that no table has.
    #[error("{key}: there is no such key; allowed here: {allowed}")]
    UnknownKey {
        /// The key.
        key: String,
        /// The keys of that table.
        allowed: String,
    },
    /// A key that is needed is not there.
    #[error("{key} is missing; {remedy}")]
    Missing {
        /// The key.
        key: String,
        /// What to write there.
        remedy: String,
    },
    /// A value that its key does not allow.
    #[error("{key} = {value} is not possible; allowed: {allowed}")]
    Value {
        /// The key.
        key: String,
        /// The value as written.
        value: String,
        /// What is allowed, with unit.
        allowed: String,
    },
    /// A path leads nowhere.
    #[error("{key} = {value:?}: no such file or folder ({path}); paths start at the folder of cell.toml")]
    NoSuchPath {
        /// The key.
        key: String,
        /// The path as written.
        value: String,
        /// The path as it was looked for.
        path: String,
    },
    /// Something else under a key.
    #[error("{problem}")]
    Other {
        /// The key.
        key: &'static str,
        /// What is wrong and what to do, key and value too.
        problem: String,
    },
    /// A move template is not allowed.
    #[error(transparent)]
    Template(#[from] TemplateError),
    /// A line is no TOML.
    #[error("{written:?} is no TOML: {problem}")]
    NoToml {
        /// The line.
        written: String,
        /// What is wrong with it, and what was expected.
        problem: String,
    },
}

impl Fault {
    /// A value that the checks refuse.
    pub fn value(key: &str, value: impl Display, allowed: impl Into<String>) -> Self {
        Fault::Value { key: key.to_owned(), value: shortened(&value.to_string()), allowed: allowed.into() }
    }

    /// Where to look for it: the key, or of a key that is not there the table.
    fn place(&self) -> String {
        match self {
            Fault::UnknownKey { key, .. } | Fault::Value { key, .. } | Fault::NoSuchPath { key, .. } => {
                key.clone()
            }
            Fault::Missing { key, .. } => key.rsplit_once('.').map_or("", |(table, _)| table).to_owned(),
            Fault::Other { key, .. } => (*key).to_owned(),
            Fault::Template(error) => error.key(),
            Fault::NoToml { .. } => String::new(),
        }
    }
}

/// What is wrong in a text, and in which line.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}{fault}", line.map_or(String::new(), |line| format!("line {line}: ")))]
pub struct TextError {
    /// Counted from 1; `None` where it is not known.
    pub line: Option<usize>,
    /// What is wrong.
    pub fault: Box<Fault>,
}

impl TextError {
    /// A fault of this text, with the line of its key or of the nearest table above that.
    pub fn of(text: &str, fault: Fault) -> Self {
        let root = DeTable::parse(text).ok();
        let at = root.and_then(|root| find(root.get_ref(), &fault.place()));
        TextError { line: at.map(|at| line(text, at.start)), fault: Box::new(fault) }
    }

    /// The message with the name of the file: `cell.toml, line 12: …`.
    pub fn in_file(&self, file: &Path) -> String {
        let between = if self.line.is_some() { ", " } else { ": " };
        format!("{}{between}{self}", file.display())
    }
}

/// The text as `T`.
///
/// # Errors
/// The first thing that is wrong: no TOML, a key that `T` does not know, one that it misses, a value of another kind.
pub fn read_toml<T: DeserializeOwned>(text: &str) -> Result<T, TextError> {
    toml::from_str(text).map_err(|error| explain(text, &error))
}

fn explain(text: &str, error: &toml::de::Error) -> TextError {
    let message = error.message().trim_end().replace('\n', " ");
    // What the file itself misses stands at no line.
    let of_file = |span: &Range<usize>| span.is_empty() && message.starts_with("missing field");
    let span = error.span().filter(|span| text.get(span.clone()).is_some() && !of_file(span));
    let at = span.as_ref().map(|span| line(text, span.start));
    let root = DeTable::parse(text).ok();
    let found = span.and_then(|span| key_at(root.as_ref()?.get_ref(), &span));
    let (key, value) = found.map_or((String::new(), ""), |(key, at)| (key, text.get(at).unwrap_or("")));
    let named = message.split('`').nth(1).unwrap_or("");
    let fault = if message.starts_with("unknown field") {
        let allowed: Vec<&str> = message.split('`').skip(3).step_by(2).collect();
        let key = if key.ends_with(named) { key } else { join(&key, named) };
        Fault::UnknownKey { key, allowed: allowed.join(", ") }
    } else if message.starts_with("missing field") {
        Fault::Missing { key: join(&key, named), remedy: "add it: it has no default".to_owned() }
    } else if let (Some((_, expected)), false) =
        (["expected ", "wanted "].iter().find_map(|word| message.rsplit_once(word)), key.is_empty())
    {
        let allowed = match message.starts_with("unknown variant") {
            true => expected.trim_start_matches("one of ").replace(" or ", ", ").replace('`', "\""),
            false => in_words(expected, message.starts_with("invalid value"), value),
        };
        Fault::value(&key, value.lines().map(str::trim).collect::<Vec<_>>().join(" "), allowed)
    } else {
        let written = text.lines().nth(at.unwrap_or(1) - 1).unwrap_or("");
        let remedy = if message == "duplicate key" { "; remove one of the two" } else { "" };
        Fault::NoToml { written: shortened(written.trim()), problem: format!("{message}{remedy}") }
    };
    TextError { line: at, fault: Box::new(fault) }
}

/// What a program calls a type, in words, for a value of another type or, with `no_room`, one that is out of its range.
fn in_words(expected: &str, no_room: bool, value: &str) -> String {
    match expected {
        "u8" | "u16" | "u32" | "u64" | "usize" if no_room && !value.starts_with('-') => {
            "a smaller whole number"
        }
        "u8" | "u16" | "u32" | "u64" | "usize" => "a whole number, 0 or more",
        "i64" => "a whole number",
        "f64" => "a number",
        "a boolean" => "true or false",
        "a string" | "path string" | "string or table" => "a text in quotes",
        "a sequence" if value.starts_with("[[") => "something else than tables under heads in [[ ]]",
        "a sequence" if value.starts_with('[') => "tables, each under a head in [[ ]]",
        "a sequence" => "a list in [ ]",
        "a map" => "a table",
        other if other.starts_with("struct ") => "a table",
        other => other,
    }
    .to_owned()
}

fn line(text: &str, byte: usize) -> usize {
    1 + text.as_bytes()[..byte.min(text.len())].iter().filter(|&&b| b == b'\n').count()
}

fn shortened(written: &str) -> String {
    match written.char_indices().nth(WRITTEN_CHARS_MAX) {
        Some((end, _)) => format!("{}…", &written[..end]),
        None => written.to_owned(),
    }
}

/// A key below a table, `cameras.left`, or below an entry of a list, `edge 2: from`.
fn join(table: &str, key: &str) -> String {
    match table {
        "" => key.to_owned(),
        entry if entry.contains(' ') => format!("{entry}: {key}"),
        table => format!("{table}.{key}"),
    }
}

/// Where a dotted key stands, in which a number is the entry of a list; or the deepest part of it that exists.
fn find(root: &DeTable<'_>, key: &str) -> Option<Range<usize>> {
    let mut parts = key.split('.');
    let (name, mut value) = root.get_key_value(parts.next()?)?;
    let mut at = name.span();
    for part in parts {
        let below = match value.get_ref() {
            DeValue::Table(table) => table.get_key_value(part).map(|(name, value)| (name.span(), value)),
            DeValue::Array(entries) => {
                let entry = part.parse::<usize>().ok().and_then(|entry| entries.get(entry.checked_sub(1)?));
                entry.map(|value| (value.span(), value))
            }
            _ => None,
        };
        let Some(below) = below else { break };
        (at, value) = below;
    }
    Some(at)
}

/// The innermost key whose name or value covers `span`, and where its value stands.
fn key_at(table: &DeTable<'_>, span: &Range<usize>) -> Option<(String, Range<usize>)> {
    table.iter().find_map(|(name, value)| {
        let named = || covers(&name.span(), span).then(|| (name.get_ref().to_string(), value.span()));
        value_at(name.get_ref(), value, span).or_else(named)
    })
}

fn value_at(name: &str, value: &Spanned<DeValue<'_>>, span: &Range<usize>) -> Option<(String, Range<usize>)> {
    // A table's own span is that of its head, what is in it stands below.
    let below = match value.get_ref() {
        DeValue::Table(table) => key_at(table, span).map(|(key, at)| (join(name, &key), at)),
        DeValue::Array(entries) => entries.iter().zip(1..).find_map(|(entry, number)| {
            let of = matches!(entry.get_ref(), DeValue::Table(_) | DeValue::Array(_));
            let name = if of { format!("{name} {number}") } else { format!("{name}: value {number}") };
            value_at(&name, entry, span)
        }),
        _ => None,
    };
    below.or_else(|| covers(&value.span(), span).then(|| (name.to_owned(), value.span())))
}

fn covers(outer: &Range<usize>, inner: &Range<usize>) -> bool {
    outer.start <= inner.start && inner.end <= outer.end
}
