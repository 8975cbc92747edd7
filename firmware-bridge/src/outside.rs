//! What a process has to do with the world that started it: signals that end it, outputs that nobody reads, and files
//! that somebody named.

use std::fs::File;
use std::io::{self, Read};
use std::os::fd::AsFd;
use std::os::unix::fs::FileTypeExt;
use std::path::Path;
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

/// Largest text file that is read: a thousand times what any cell needs. A device that never ends (/dev/zero) must
/// not fill the memory.
const TEXT_BYTES_MAX: u64 = 16 << 20;

/// The text of a file.
///
/// # Errors
/// What the system says; a file that is no UTF-8, or larger than 16 MiB.
pub fn read_text(path: &Path) -> io::Result<String> {
    String::from_utf8(read_bytes(path)?)
        .map_err(|e| io::Error::new(io::ErrorKind::InvalidData, e.utf8_error()))
}

/// The bytes of what should be a text file.
///
/// # Errors
/// What the system says; a file larger than 16 MiB; a pipe, which may never have an end.
pub fn read_bytes(path: &Path) -> io::Result<Vec<u8>> {
    read_up_to(path, TEXT_BYTES_MAX)
}

/// The bytes of a file of at most so many.
///
/// # Errors
/// What the system says; a larger file; a pipe, which may never have an end.
pub fn read_up_to(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    if std::fs::metadata(path)?.file_type().is_fifo() {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, "a pipe, not a file"));
    }
    let mut bytes = Vec::new();
    File::open(path)?.take(most + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most {
        let reason = format!("larger than {} MiB, which no such file is", most >> 20);
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, reason));
    }
    Ok(bytes)
}

/// The signals that ask a process to end: SIGINT, SIGTERM, and SIGHUP (its terminal is gone), unless whoever started
/// it wants that ignored, as nohup does.
pub fn ending_signals() -> Vec<i32> {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let hangup = (!ignores(&status, SIGHUP)).then_some(SIGHUP);
    [SIGINT, SIGTERM].into_iter().chain(hangup).collect()
}

/// Whether a `/proc/self/status` names the signal among the ignored ones.
fn ignores(status: &str, signal: i32) -> bool {
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0);
    mask >> (signal - 1) & 1 == 1
}

/// Whether a line can be written to an output without waiting, or can be within a time. A paused terminal, or a
/// reader that stands still, must not hold up what writes. What is broken does not wait either: there is room. A signal ends the wait.
pub fn has_room(output: impl AsFd, within: Duration) -> bool {
    let timeout = Timespec {
        tv_sec: i64::try_from(within.as_secs()).unwrap_or(i64::MAX),
        tv_nsec: i64::from(within.subsec_nanos()),
    };
    !matches!(poll(&mut [PollFd::new(&output, PollFlags::OUT)], Some(&timeout)), Ok(0) | Err(Errno::INTR))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    #[test]
    fn a_file_without_an_end_is_refused() {
        assert_eq!(read_text("/dev/zero".as_ref()).unwrap_err().kind(), io::ErrorKind::FileTooLarge);
        assert_eq!(read_text("/dev/null".as_ref()).unwrap(), "");
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        rustix::fs::mknodat(rustix::fs::CWD, &pipe, rustix::fs::FileType::Fifo, rustix::fs::Mode::RUSR, 0)
            .unwrap();
        assert_eq!(read_text(&pipe).unwrap_err().to_string(), "a pipe, not a file");
        assert_eq!(read_text("/".as_ref()).unwrap_err().kind(), io::ErrorKind::IsADirectory);
    }

    #[test]
    fn a_pipe_that_nobody_reads_has_no_room_until_somebody_does() {
        let (mut reader, mut writer) = io::pipe().unwrap();
        let mut written = 0;
        while has_room(&writer, Duration::ZERO) {
            writer.write_all(&[b'x'; 4096]).unwrap();
            written += 4096;
            assert!(written < 64 << 20, "it never fills");
        }
        assert!(!has_room(&writer, Duration::from_millis(5)));
        reader.read_exact(&mut vec![0; written]).unwrap();
        assert!(has_room(&writer, Duration::ZERO));
        drop(reader);
        assert!(has_room(&writer, Duration::ZERO), "what is broken does not wait");
    }

    #[test]
    fn an_ignored_signal_is_found_in_the_mask() {
        let status = "Name:\tx\nSigBlk:\t0000000000000001\nSigIgn:\t0000000000001001\nSigCgt:\t0\n";
        assert!(ignores(status, SIGHUP));
        assert!(!ignores(status, SIGTERM));
        assert!(!ignores("", SIGHUP));
        assert!(ending_signals().starts_with(&[SIGINT, SIGTERM]));
    }
}
