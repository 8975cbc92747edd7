//! The file that keeps the place pattern's counters through a restart.

use std::fs::File;
use std::io;
use std::path::Path;

use firmware_bridge::config::read_toml;
use firmware_bridge::outside::read_text;

use super::RunError;
use crate::cell::core::PlaceRecord;
use crate::files::write_atomically;

/// Reads the record; a file that is not there is a tray that is empty.
///
/// # Errors
/// A file that is no record: nobody knows how full the tray is.
pub(in crate::commands) fn read(path: &Path) -> Result<PlaceRecord, RunError> {
    let bad = |reason: String| RunError::PlaceRecord { path: path.to_owned(), reason };
    match read_text(path) {
        Ok(text) => read_toml(&text).map_err(|error| bad(error.to_string())),
        Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(PlaceRecord::default()),
        Err(e) if e.kind() == io::ErrorKind::InvalidData => Err(bad("no text".into())),
        Err(reason) => Err(RunError::Unwritable { path: path.to_owned(), reason }),
    }
}

/// Writes the record so that it is on the disk, name and all, when this returns.
pub(super) fn write(path: &Path, record: &PlaceRecord) -> io::Result<()> {
    let text = toml::to_string(record).map_err(io::Error::other)?;
    write_atomically(path, text.as_bytes())?;
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    File::open(folder)?.sync_all()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn a_record_comes_back_and_a_broken_one_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("place.state");
        assert_eq!(read(&path).unwrap(), PlaceRecord::default());
        let record = PlaceRecord { next_slot: 7, next_id: 1 << 50, unfinished_id: 12 };
        write(&path, &record).unwrap();
        assert_eq!(read(&path).unwrap(), record);
        fs::write(&path, [0xff, 0xfe]).unwrap();
        assert!(read(&path).unwrap_err().to_string().contains("not a place record (no text)"));
        for (broken, why) in [
            ("", "(next_slot is missing"),
            ("next_slot = 1", "(next_id is missing"),
            (
                "next_slot = -1\nnext_id = 2",
                "line 1: next_slot = -1 is not possible; allowed: a whole number",
            ),
            ("next_slot = 1\nnext_id = 2\nx = 3", "line 3: x: there is no such key"),
            ("\0\0", "is no TOML"),
        ] {
            fs::write(&path, broken).unwrap();
            let message = read(&path).unwrap_err().to_string();
            assert!(message.contains(why), "{message}");
            assert!(message.contains("empty the tray and remove the file"), "{message}");
        }
    }
}
