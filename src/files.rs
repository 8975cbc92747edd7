//! Files that are there whole or not at all.

use std::fs::{self, File};
use std::io::{self, Write};
use std::os::fd::AsRawFd;
use std::path::Path;

use rustix::fs::{AtFlags, CWD, Mode, OFlags};

/// Writes `bytes` to `path`: into a file of another name beside it, synced, then renamed. Whoever reads `path` sees
/// the old file or the whole new one.
///
/// # Errors
/// What the operating system said; nothing is left behind then.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> io::Result<()> {
    // Of a link what it points to is written, where that is.
    let real = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let path = real.as_path();
    let name = path
        .file_name()
        .ok_or_else(|| io::Error::new(io::ErrorKind::InvalidInput, "the path names no file"))?;
    let beside = path.with_file_name(format!(".{}.{}.part", name.to_string_lossy(), std::process::id()));
    let written = File::create(&beside)
        .and_then(|mut file| file.write_all(bytes).and_then(|()| file.sync_all()))
        .and_then(|()| fs::rename(&beside, path));
    if written.is_err() {
        let _ = fs::remove_file(&beside);
    }
    written
}

/// Has `write` fill a file that is not there yet, synced. Whoever is ended meanwhile leaves nothing behind, on file
/// systems that know files without names (ext4, XFS, Btrfs, tmpfs); on others a file beside it that ends in `.part`.
///
/// # Errors
/// What the operating system or `write` said, [`io::ErrorKind::AlreadyExists`] where `path` is taken; nothing is left
/// behind then.
pub fn write_new<T, E: From<io::Error>>(
    path: &Path,
    write: impl FnOnce(&mut File) -> Result<T, E>,
) -> Result<T, E> {
    if path.symlink_metadata().is_ok() {
        return Err(io::Error::from(io::ErrorKind::AlreadyExists).into());
    }
    let name = path
        .file_name()
        .ok_or_else(|| io::Error::new(io::ErrorKind::InvalidInput, "the path names no file"))?;
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if let Ok(nameless) = rustix::fs::open(folder, OFlags::TMPFILE | OFlags::RDWR | OFlags::CLOEXEC, READABLE)
    {
        let mut file = File::from(nameless);
        let written = write(&mut file)?;
        file.sync_all()?;
        let own = format!("/proc/self/fd/{}", file.as_raw_fd());
        rustix::fs::linkat(CWD, own, CWD, path, AtFlags::SYMLINK_FOLLOW).map_err(io::Error::from)?;
        return Ok(written);
    }
    let beside = path.with_file_name(format!(".{}.{}.part", name.to_string_lossy(), std::process::id()));
    let mut file = File::create_new(&beside)?;
    let written = write(&mut file).and_then(|written| {
        file.sync_all()?;
        fs::rename(&beside, path)?;
        Ok(written)
    });
    if written.is_err() {
        let _ = fs::remove_file(&beside);
    }
    written
}

/// What to do where a file or its folder cannot be written.
pub fn write_remedy(reason: &io::Error) -> &'static str {
    match reason.kind() {
        _ if is_full(reason) => "make room there",
        io::ErrorKind::AlreadyExists | io::ErrorKind::NotADirectory => {
            "a file has the name of a folder that is needed: give another name"
        }
        io::ErrorKind::IsADirectory => "a folder has this name: give another",
        _ => "give another place, or the right to write there",
    }
}

/// Whether it is the disk that has no room: the same call may do later.
pub fn is_full(reason: &io::Error) -> bool {
    matches!(reason.kind(), io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded)
}

/// Rights of a new file, before the process's mask.
const READABLE: Mode = Mode::from_raw_mode(0o666);

/// Whether a file can be written into `folder`; nothing is left of it.
///
/// # Errors
/// What the operating system said.
pub fn can_write(folder: &Path) -> io::Result<()> {
    let path = folder.join(format!(".pickcell-{}.check", std::process::id()));
    let mut file = File::options().write(true).create_new(true).open(&path)?;
    let written = file.write_all(&[0; 4096]).and_then(|()| file.sync_all());
    fs::remove_file(&path).and(written)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_that_can_be_written_is_left_as_it_was() {
        let folder = tempfile::tempdir().unwrap();
        can_write(folder.path()).unwrap();
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
        assert!(can_write(&folder.path().join("absent")).is_err());
        assert!(can_write(Path::new("/proc")).is_err());
    }

    #[test]
    fn of_a_link_what_it_points_to_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let [real, link] = ["real", "link"].map(|name| folder.path().join(name));
        write_atomically(&real, b"old").unwrap();
        std::os::unix::fs::symlink("real", &link).unwrap();
        write_atomically(&link, b"new").unwrap();
        assert!(link.is_symlink() && fs::read(&real).unwrap() == b"new");
    }

    #[test]
    fn a_new_file_is_there_whole_or_not_at_all_and_replaces_none() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        let with = |text: &'static str| move |file: &mut File| file.write_all(text.as_bytes());
        write_new(&path, with("one")).unwrap();
        let taken = write_new(&path, with("two")).unwrap_err();
        assert_eq!((taken.kind(), fs::read(&path).unwrap()), (io::ErrorKind::AlreadyExists, b"one".to_vec()));
        let failed = write_new(&folder.path().join("b"), |file| {
            file.write_all(b"half")?;
            Err::<(), _>(io::Error::other("no"))
        });
        assert_eq!(failed.unwrap_err().to_string(), "no");
        assert!(write_new(&folder.path().join("absent/b"), with("x")).is_err());
        assert!(write_new(Path::new("/"), with("x")).is_err());
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_file_is_replaced_whole_and_a_failure_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.json");
        write_atomically(&path, b"one").unwrap();
        write_atomically(&path, b"two").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"two");
        fs::create_dir(folder.path().join("taken")).unwrap();
        assert!(write_atomically(&folder.path().join("taken"), b"x").is_err());
        assert!(write_atomically(&folder.path().join("absent/b"), b"x").is_err());
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
    }
}
