//! A folder with `left/`, `right/` and `session.toml`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use firmware_bridge::config::{Fault, TextError, read_toml};
use serde::Deserialize;

use super::{RecordedPair, RecordedPicture, Results, Session};
use crate::camera::Side;
use crate::frame::RATE_HZ;

/// What is wrong with a session folder.
#[derive(Debug, thiserror::Error)]
pub enum FolderError {
    /// It is not there or not a folder.
    #[error(
        "{}: not a session folder ({reason}); a session is an .mcap file, or a folder with left/, right/ and session.toml", path.display()
    )]
    NoFolder {
        /// The folder as it was named.
        path: PathBuf,
        /// What the system said.
        reason: std::io::Error,
    },
    /// No `session.toml`.
    #[error("{}: cannot read it: {reason}; write one line into it, for example rate_hz = 30.0", path.display())]
    NoSettings {
        /// The file.
        path: PathBuf,
        /// What the system said.
        reason: std::io::Error,
    },
    /// A `session.toml` that is no TOML, has other keys than `rate_hz`, or a rate that none is.
    #[error("{}; all that it needs is a line like rate_hz = 30.0", error.in_file(path))]
    BadSettings {
        /// The file.
        path: PathBuf,
        /// What is wrong, and where.
        error: TextError,
    },
    /// Not one png or jpg on a side.
    #[error("{}: there is no png or jpg in it; a session needs pictures of both cameras", path.display())]
    NoPictures {
        /// The folder.
        path: PathBuf,
    },
    /// Two pictures that differ only in their ending.
    #[error("{} and {}: two pictures of one name; remove one", first.display(), second.display())]
    SameName {
        /// One.
        first: PathBuf,
        /// The other.
        second: PathBuf,
    },
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Settings {
    rate_hz: f64,
}

/// Lists a session folder. The pictures are not read yet.
///
/// # Errors
/// The first thing that is wrong with it.
pub(super) fn open(folder: &Path) -> Result<Session, FolderError> {
    std::fs::read_dir(folder).map_err(|reason| FolderError::NoFolder { path: folder.to_owned(), reason })?;
    let path = folder.join("session.toml");
    let text = firmware_bridge::outside::read_text(&path)
        .map_err(|reason| FolderError::NoSettings { path: path.clone(), reason })?;
    let bad = |error| FolderError::BadSettings { path: path.clone(), error };
    let Settings { rate_hz } = read_toml(&text).map_err(bad)?;
    if !RATE_HZ.contains(&rate_hz) {
        let allowed = format!("frames a second from {} to {}", RATE_HZ.start(), RATE_HZ.end());
        let fault = Fault::value("rate_hz", rate_hz, &allowed);
        return Err(bad(TextError::of(&text, fault)));
    }
    let mut names: BTreeMap<String, [Option<PathBuf>; 2]> = BTreeMap::new();
    for side in Side::BOTH {
        for (name, picture) in pictures_in(&folder.join(side.name()))? {
            names.entry(name).or_default()[side.index()] = Some(picture);
        }
    }
    let after_ns = |index: usize| (index as f64 * 1e9 / rate_hz) as i64;
    let pair = |(index, (name, pictures)): (usize, (String, [Option<PathBuf>; 2]))| RecordedPair {
        name,
        after_ns: after_ns(index),
        pictures: pictures.map(|picture| picture.map(RecordedPicture::File)),
        marks: Default::default(),
        fate: None,
    };
    let pairs = names.into_iter().enumerate().map(pair).collect();
    Ok(Session {
        path: folder.to_owned(),
        rate_hz,
        pairs,
        arm: Vec::new(),
        arm_lead_ns: None,
        results: Results::default(),
        broken_at: None,
    })
}

/// Whether a file is one of a picture, by its name.
pub fn is_picture(path: &Path) -> bool {
    let ending = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    matches!(&*ending, "png" | "jpg" | "jpeg")
}

/// Name without ending → file, of every picture in `folder`.
fn pictures_in(folder: &Path) -> Result<BTreeMap<String, PathBuf>, FolderError> {
    let no_folder = |reason| FolderError::NoFolder { path: folder.to_owned(), reason };
    let mut pictures = BTreeMap::new();
    for entry in std::fs::read_dir(folder).map_err(no_folder)? {
        let path = entry.map_err(no_folder)?.path();
        let (true, Some(stem)) = (is_picture(&path), path.file_stem()) else {
            continue;
        };
        let name = stem.to_string_lossy().into_owned();
        if let Some(first) = pictures.insert(name, path.clone()) {
            return Err(FolderError::SameName { first, second: path });
        }
    }
    if pictures.is_empty() {
        return Err(FolderError::NoPictures { path: folder.to_owned() });
    }
    Ok(pictures)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    fn folder(rate: &str, files: &[&str]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("session.toml"), rate).unwrap();
        for side in ["left", "right"] {
            std::fs::create_dir(folder.path().join(side)).unwrap();
        }
        for file in files {
            std::fs::write(folder.path().join(file), b"x").unwrap();
        }
        folder
    }

    #[test]
    fn pairs_are_listed_by_name_and_gaps_stay() {
        let folder = folder(
            "rate_hz = 10",
            &["left/b.png", "left/a.jpg", "left/notes.txt", "right/a.JPG", "right/c.png"],
        );
        let session = open(folder.path()).unwrap();
        assert_eq!(session.period(), Duration::from_millis(100));
        let there: Vec<_> =
            session.pairs.iter().map(|p| (&*p.name, p.pictures.each_ref().map(Option::is_some))).collect();
        assert_eq!(there, [("a", [true, true]), ("b", [true, false]), ("c", [false, true])]);
    }

    #[test]
    fn errors_name_the_file_and_the_remedy() {
        let message = |folder: &Path| open(folder).unwrap_err().to_string();
        assert!(
            message(Path::new("/nowhere"))
                .contains("a session is an .mcap file, or a folder with left/, right/")
        );
        let empty = tempfile::tempdir().unwrap();
        assert!(message(empty.path()).contains("session.toml: cannot read it"));
        for (text, wanted) in [
            ("rate_hz = 0", "line 1: rate_hz = 0 is not possible; allowed: frames a second from 0.1 to 1000"),
            ("rate_hz = \"x\"", "line 1: rate_hz = \"x\" is not possible; allowed: a number"),
            ("\nrate = 3", "line 2: rate: there is no such key; allowed here: rate_hz"),
            ("", "rate_hz is missing; add it: it has no default"),
            ("rate_hz 3", "line 1: \"rate_hz 3\" is no TOML: key with no value, expected `=`"),
        ] {
            let message = message(folder(text, &[]).path());
            let wanted = format!("{wanted}; all that it needs is a line like rate_hz = 30.0");
            assert!(message.contains("session.toml") && message.ends_with(&wanted), "{message}");
        }
        assert!(message(folder("rate_hz = 3", &[]).path()).contains("left: there is no png or jpg in it"));
        let lone = folder("rate_hz = 3", &["left/a.png", "right/b.png"]);
        assert!(Session::open(lone.path()).unwrap_err().to_string().contains("no pair in it"));
        let twice = folder("rate_hz = 3", &["left/a.png", "left/a.jpg", "right/a.png"]);
        assert!(message(twice.path()).contains("two pictures of one name"));
    }

    #[test]
    fn the_session_of_the_project_opens() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("replay/conveyor");
        let session = open(&folder).unwrap();
        assert_eq!((session.pairs.len(), session.rate_hz), (20, 30.0));
    }
}
