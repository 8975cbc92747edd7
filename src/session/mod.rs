//! Recorded sessions: what two cameras saw, and what the arm said meanwhile.
//!
//! Takes a recording (one MCAP file) or a folder with `left/`, `right/` (png or jpg, paired by equal names) and
//! `session.toml` (`rate_hz`); gives the pairs in their order, as [`Frame`]s like those of a camera: a JPEG stays as it
//! is ([MJPEG](crate::frame::PixelFormat::Mjpeg)), a PNG becomes RGB or grey, a raw picture keeps its format. A
//! recording has its own time stamps, in a folder they are index / rate.
//!
//! A recording is read through once when it is opened: its records are checked, its pictures are found, not kept. One
//! that breaks off (a power cut, a kill) is read up to there, and says so.

pub mod copy;
pub mod events;
mod folder;
pub mod foxglove;
mod picture;
mod recording;
mod records;
mod writer;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

pub use folder::{FolderError, is_picture};
pub use picture::{PictureError, read_picture, read_raw_picture};
pub use records::{Damage, MessageAt, MessageError, RecordingError, RecordingFile};
pub use writer::{About, PAIR_WINDOW, RecordingWriter, WriteError};

use crate::frame::{ColourEncoding, Frame, TimestampMark};
use crate::time::Spent;
use events::PairRecord;
use firmware_bridge::link::Said;
use foxglove::ImageKind;

/// What is wrong with a session.
#[derive(Debug, thiserror::Error)]
pub enum SessionError {
    /// A folder.
    #[error(transparent)]
    Folder(#[from] FolderError),
    /// A file.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// A picture that cannot be used.
    #[error(transparent)]
    Picture(#[from] PictureError),
    /// Only lone pictures.
    #[error(
        "{}: no pair in it: to no picture of the left camera there is one of the right; in a folder a pair is two pictures of one name", path.display()
    )]
    NoPair {
        /// The session.
        path: PathBuf,
    },
}

/// A picture of a session, where it lies.
#[derive(Clone, Debug)]
pub enum RecordedPicture {
    /// A png or jpg.
    File(PathBuf),
    /// A message of a recording.
    Message {
        /// The recording.
        file: Arc<RecordingFile>,
        /// Its topic.
        topic: Arc<str>,
        /// Where in it.
        at: MessageAt,
        /// Of which kind.
        kind: ImageKind,
        /// What the recording says about its colours.
        encoding: ColourEncoding,
    },
}

impl RecordedPicture {
    /// Reads it; see [`read_picture`].
    ///
    /// # Errors
    /// It cannot be read, is no picture, or larger than the cell takes.
    pub fn read(&self) -> Result<Frame, PictureError> {
        match self {
            RecordedPicture::File(path) => read_picture(path),
            RecordedPicture::Message { file, at, kind, encoding, .. } => {
                picture::from_message(&file.message(*at)?, *kind, *encoding, self.place())
            }
        }
    }

    /// Reads it, and decodes a JPEG too.
    ///
    /// # Errors
    /// It cannot be read, is no whole picture, or larger than the cell takes.
    pub fn read_raw(&self) -> Result<Frame, PictureError> {
        picture::decoded(self.read()?, self.place())
    }

    /// Where it lies, for messages: the file, and of a recording the topic and the byte.
    pub fn place(&self) -> PathBuf {
        match self {
            RecordedPicture::File(path) => path.clone(),
            RecordedPicture::Message { file, topic, at, .. } => {
                format!("{}, {topic} at byte {}", file.path().display(), at.byte).into()
            }
        }
    }
}

/// One moment of a session. A side is `None` where its camera had left the picture out.
#[derive(Clone, Debug)]
pub struct RecordedPair {
    /// File name without its ending, or the pair's name or number in a recording.
    pub name: String,
    /// From the first pair to this one, ns.
    pub after_ns: i64,
    /// The pictures, left and right.
    pub pictures: [Option<RecordedPicture>; 2],
    /// What moment of the exposure their times are, left and right.
    pub marks: [TimestampMark; 2],
    /// What the recorded cell did with it, where that is known.
    pub fate: Option<Fate>,
}

/// What became of a pair in the cell that was recorded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fate {
    /// It was recognised, or its pictures were refused.
    Searched {
        /// What repeats its search.
        search: Option<RecordedSearch>,
        /// From the older frame until the cell had decided about it, ns.
        after_ns: i64,
    },
    /// The recogniser had no time for it, or the cell had ended.
    LeftOut,
}

/// A search that can be repeated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RecordedSearch {
    /// Its seed.
    pub seed: u64,
    /// What it used up.
    pub spent: Spent,
    /// It was stopped there, and would have gone on.
    pub out_of_time: bool,
}

impl RecordedPair {
    /// Whether it has both pictures.
    pub fn is_whole(&self) -> bool {
        self.pictures.iter().all(Option::is_some)
    }

    /// Whether a session that is played pair by pair has it: both pictures, and a cell that had time for it.
    pub fn is_stepped(&self) -> bool {
        self.is_whole() && self.fate != Some(Fate::LeftOut)
    }
}

/// What a recording says about its pairs, added up.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Results {
    /// Pairs with a result.
    pub pairs: u64,
    /// Those whose pictures are not in the recording.
    pub without_pictures: u64,
    /// Those that led to a target.
    pub targets: u64,
    /// Why others led to none, and how often.
    pub no_target: BTreeMap<String, u64>,
    /// Results that came too late.
    pub deadline_misses: u64,
    /// Frames missing in the drivers' counts, left and right.
    pub frames_missing: [u64; 2],
    last: Option<[u32; 2]>,
}

impl Results {
    fn add(&mut self, pair: &PairRecord) {
        self.pairs += 1;
        self.without_pictures += u64::from(!pair.pictures);
        self.targets += u64::from(pair.target.is_some());
        self.deadline_misses += u64::from(!pair.deadline_kept);
        if let Some(why) = &pair.no_target {
            *self.no_target.entry(why.clone()).or_default() += 1;
        }
        if let Some(last) = self.last.replace(pair.sequences) {
            for (side, missing) in self.frames_missing.iter_mut().enumerate() {
                // A driver that was opened anew counts from 0 again; that is no gap.
                let steps = pair.sequences[side].wrapping_sub(last[side]);
                *missing += if (1..=1000).contains(&steps) { u64::from(steps - 1) } else { 0 };
            }
        }
    }
}

/// A session that was opened: which pictures there are.
#[derive(Clone, Debug)]
pub struct Session {
    /// The file or folder.
    pub path: PathBuf,
    /// Pairs a second; of a recording, by the middle one of the times between two pairs.
    pub rate_hz: f64,
    /// In their order; at least one.
    pub pairs: Vec<RecordedPair>,
    /// What cell and arm said to each other, in order; empty where nothing was recorded of it.
    pub arm: Vec<Said>,
    /// From the first word of the arm to the first picture, where both are recorded, ns; less than nought where the arm
    /// connected after that.
    pub arm_lead_ns: Option<i64>,
    /// What a recording says about its pairs.
    pub results: Results,
    /// The byte at which a recording breaks off whose end is missing.
    pub broken_at: Option<u64>,
}

impl Session {
    /// Lists a session. The pictures are not decoded yet.
    ///
    /// # Errors
    /// The first thing that is wrong with it.
    pub fn open(path: &Path) -> Result<Self, SessionError> {
        let session = if path.is_file() { recording::open(path)? } else { folder::open(path)? };
        match session.whole_pairs() {
            0 => Err(SessionError::NoPair { path: path.to_owned() }),
            _ => Ok(session),
        }
    }

    /// How many pairs have both pictures.
    pub fn whole_pairs(&self) -> usize {
        self.pairs.iter().filter(|pair| pair.is_whole()).count()
    }

    /// Time from one pair to the next; at most a day.
    pub fn period(&self) -> Duration {
        Duration::from_secs_f64((1.0 / self.rate_hz).min(86_400.0))
    }

    /// What to tell people about a recording whose end is missing.
    pub fn break_note(&self) -> Option<String> {
        self.broken_at.map(|byte| {
            format!(
                "{}: its end is missing: it breaks off at byte {byte}; what stands before is used ({} pairs)",
                self.path.display(),
                self.whole_pairs()
            )
        })
    }
}

#[cfg(test)]
mod tests;
