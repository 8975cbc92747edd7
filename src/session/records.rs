//! The records of an MCAP file, one after the other, up to its end or the place where it breaks off.
//!
//! Takes a file; gives records with the places where they stand; owns one record at a time, and the
//! messages of one chunk. Lengths that a damaged or hostile file states are checked against what the file holds before
//! anything is read or taken for it.

use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use mcap::records::{ChunkHeader, Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{MAGIC, McapError, parse_record};

/// Longest record, and longest content of a chunk, that is read: more than two pictures of the largest size.
const RECORD_BYTES_MAX: u64 = 1 << 30;
/// A byte of LZ4 becomes at most so many: a match grows by 255 with each byte of its length.
const LZ4_GROWTH_MAX: u64 = 256;
/// A byte of Zstandard becomes at most so many: a block of 128 KiB takes three bytes of head and one of content at
/// least (RFC 8878, section 3.1.1.2).
const ZSTD_GROWTH_MAX: u64 = 1 << 15;
/// Opcode and length in front of every record.
const HEAD_BYTES: u64 = 9;
/// Content of the last record, which says where the summary begins.
const FOOTER_BYTES: u64 = 20;

/// What is wrong with a recording.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// It cannot be read.
    #[error("{}: cannot read it: {reason}", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system said.
        reason: std::io::Error,
    },
    /// Nothing in it.
    #[error("{}: the file is empty; a recording that was cut off before its first second has nothing to show", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// Something else.
    #[error(
        "{}: not an MCAP file; a session is an .mcap file, or a folder with left/, right/ and session.toml", path.display()
    )]
    Foreign {
        /// The file.
        path: PathBuf,
    },
    /// Not what was written.
    #[error("{}: damaged at byte {at_byte}: {reason}; fetch the file again from where it was recorded, or copy what can be read of it with \
         `pickcell session recover`", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Where the record begins.
        at_byte: u64,
        /// What is wrong there.
        reason: Damage,
    },
    /// No pictures of two cameras.
    #[error(
        "{}: no pictures of two cameras in it; needed are messages foxglove.CompressedImage or foxglove.RawImage in \
         protobuf on one topic with left and one with right in its name; there are: {topics}{}", path.display(), end_of(*broken_at)
    )]
    NoPictures {
        /// The file.
        path: PathBuf,
        /// Topics with schema and encoding.
        topics: String,
        /// The byte at which it breaks off, if its end is missing.
        broken_at: Option<u64>,
    },
    /// A message that says something else than its schema promises.
    #[error("{}: the message on {topic} at byte {at_byte} cannot be read ({reason}); record it again", path.display())]
    Message {
        /// The file.
        path: PathBuf,
        /// Its topic.
        topic: String,
        /// Where its record, or the chunk that it is in, begins.
        at_byte: u64,
        /// What is wrong with it.
        reason: MessageError,
    },
}

/// That the end is missing, if it is.
fn end_of(broken_at: Option<u64>) -> String {
    broken_at.map_or_else(String::new, |byte| format!("; its end is missing: it breaks off at byte {byte}"))
}

/// What is wrong with a message.
#[derive(Debug, thiserror::Error)]
pub enum MessageError {
    /// No protobuf of its schema.
    #[error("{0}")]
    Protobuf(#[from] prost::DecodeError),
    /// No JSON of its schema.
    #[error("{0}")]
    Json(#[from] serde_json::Error),
}

/// What is wrong with a record.
#[derive(Debug, thiserror::Error)]
pub enum Damage {
    /// Its length is not possible.
    #[error("a record of {bytes} bytes")]
    Length {
        /// As stated.
        bytes: u64,
    },
    /// It contradicts itself or its checksum.
    #[error("{0}")]
    Record(#[from] McapError),
}

/// Where a message stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct MessageAt {
    /// Where its record, or the chunk that it is in, begins.
    pub byte: u64,
    /// Which of the chunk's messages, counted from 0.
    pub index: u32,
}

/// A record with the place where it stands.
#[derive(Debug)]
pub struct RecordAt<'a> {
    /// Of a message: which of its chunk's; else 0.
    pub at: MessageAt,
    /// The record; chunks are unpacked.
    pub record: Record<'a>,
}

/// An MCAP file that is open.
#[derive(Debug)]
pub struct RecordingFile {
    path: PathBuf,
    file: File,
    bytes: u64,
    /// The messages that were read last: those of a chunk are mostly wanted one after the other.
    last: Mutex<Unpacked>,
}

/// What the messages of a chunk, or of a record at `byte`, say.
#[derive(Debug, Default)]
struct Unpacked {
    byte: u64,
    messages: Vec<Vec<u8>>,
}

impl RecordingFile {
    /// Opens it and looks at its first bytes.
    ///
    /// # Errors
    /// It cannot be read, is empty, or no MCAP file.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let unreadable = |reason| RecordingError::Unreadable { path: path.to_owned(), reason };
        // To open a pipe is to wait for who writes into it.
        let about = std::fs::metadata(path).map_err(unreadable)?;
        if !about.is_file() {
            return Err(RecordingError::Foreign { path: path.to_owned() });
        }
        let file = File::open(path).map_err(unreadable)?;
        let file = Self { path: path.to_owned(), file, bytes: about.len(), last: Mutex::default() };
        if file.bytes == 0 {
            return Err(RecordingError::Empty { path: file.path });
        }
        let mut magic = [0; MAGIC.len()];
        if file.bytes < MAGIC.len() as u64 || file.read(&mut magic, 0).is_err() || magic != *MAGIC {
            return Err(RecordingError::Foreign { path: file.path });
        }
        Ok(file)
    }

    /// As it was named.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Shows every record up to the end of the data; chunks unpacked, attachments and indices left out. Gives the byte
    /// at which the file breaks off where its end is missing: there it ends, or stops making sense.
    ///
    /// # Errors
    /// It cannot be read, is damaged although its end is there, or the first error of `each`.
    pub fn walk<E: From<RecordingError>>(
        &self,
        mut each: impl FnMut(RecordAt<'_>) -> Result<(), E>,
    ) -> Result<Option<u64>, E> {
        let mut at = MAGIC.len() as u64;
        let mut record = Vec::new();
        loop {
            let Some((opcode, body_bytes)) = self.head(at)? else { return Ok(self.broken(at)?) };
            match opcode {
                op::DATA_END => return Ok((!self.has_end()?).then_some(self.bytes)),
                op::ATTACHMENT | op::MESSAGE_INDEX => {}
                _ => {
                    let loaded = self.load(at, body_bytes, &mut record);
                    match loaded.and_then(|()| self.unpack(at, &record, &mut each)) {
                        // Of the last pages a power cut may leave zeros, in the middle of a record too.
                        Err(RecordingError::Damaged { .. }) if !self.has_end()? => return Ok(Some(at)),
                        shown => shown??,
                    }
                }
            }
            at += HEAD_BYTES + body_bytes;
        }
    }

    /// Shows the attachments, up to the end of the data or the place where the file breaks off.
    ///
    /// # Errors
    /// It cannot be read, an attachment is damaged, or the first error of `each`.
    pub fn attachments<E: From<RecordingError>>(
        &self,
        mut each: impl FnMut(RecordAt<'_>) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut at = MAGIC.len() as u64;
        let mut record = Vec::new();
        while let Some((opcode, body_bytes)) = self.head(at)?.filter(|&(opcode, _)| opcode != op::DATA_END) {
            if opcode == op::ATTACHMENT {
                self.load(at, body_bytes, &mut record)?;
                self.unpack(at, &record, &mut each)??;
            }
            at += HEAD_BYTES + body_bytes;
        }
        Ok(())
    }

    /// Shows every record that can be read, attachments too, wherever the file is damaged; schemas and channels behind the
    /// first record as well, from the end of the file, for what is damaged may be what they stood in. Gives the bytes at
    /// which something is lost; the last of them, and all behind it, where the file breaks off.
    ///
    /// # Errors
    /// The file cannot be read, or the first error of `each`.
    pub fn salvage<E: From<RecordingError>>(
        &self,
        mut each: impl FnMut(RecordAt<'_>) -> Result<(), E>,
    ) -> Result<Vec<u64>, E> {
        let mut at = MAGIC.len() as u64;
        let (mut record, mut lost) = (Vec::new(), Vec::new());
        loop {
            let Some((opcode, body_bytes)) = self.head(at)? else {
                lost.push(at);
                return Ok(lost);
            };
            match opcode {
                op::DATA_END if self.has_end()? => return Ok(lost),
                op::DATA_END => {
                    lost.push(at);
                    return Ok(lost);
                }
                op::MESSAGE_INDEX => {}
                _ => {
                    let loaded = self.load(at, body_bytes, &mut record);
                    match loaded.and_then(|()| self.unpack(at, &record, &mut each)) {
                        Err(RecordingError::Damaged { .. }) => lost.push(at),
                        shown => shown??,
                    }
                }
            }
            if at == MAGIC.len() as u64 {
                self.channels_at_end(&mut each)?;
            }
            at += HEAD_BYTES + body_bytes;
        }
    }

    /// Shows the schemas and channels that stand a second time behind the data, as far as they can be read.
    fn channels_at_end<E: From<RecordingError>>(
        &self,
        each: &mut impl FnMut(RecordAt<'_>) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut record = Vec::new();
        let end = self.bytes.checked_sub(HEAD_BYTES + FOOTER_BYTES + MAGIC.len() as u64);
        let footer = match end.filter(|_| self.has_end().unwrap_or(false)) {
            Some(at) => self.head(at)?.filter(|head| *head == (op::FOOTER, FOOTER_BYTES)).map(|_| at),
            None => None,
        };
        let Some(footer) = footer else { return Ok(()) };
        let mut begin = [0; 8];
        self.read(&mut begin, footer + HEAD_BYTES)?;
        let mut at = u64::from_le_bytes(begin);
        while (MAGIC.len() as u64..footer).contains(&at) {
            let Some((opcode, body_bytes)) = self.head(at)? else { break };
            if matches!(opcode, op::SCHEMA | op::CHANNEL) {
                self.load(at, body_bytes, &mut record)?;
                match self.unpack(at, &record, each) {
                    Err(RecordingError::Damaged { .. }) => {}
                    shown => shown??,
                }
            }
            at += HEAD_BYTES + body_bytes;
        }
        Ok(())
    }

    /// The content of one message.
    ///
    /// # Errors
    /// It cannot be read or is damaged.
    pub fn message(&self, wanted: MessageAt) -> Result<Vec<u8>, RecordingError> {
        let mut last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        if last.byte != wanted.byte || last.messages.is_empty() {
            *last = Unpacked::default();
            let (mut record, mut messages) = (Vec::new(), Vec::new());
            if let Some((_, body_bytes)) = self.head(wanted.byte)? {
                self.load(wanted.byte, body_bytes, &mut record)?;
                self.unpack(wanted.byte, &record, &mut |RecordAt { record, .. }| {
                    if let Record::Message { data, .. } = record {
                        messages.push(data.into_owned());
                    }
                    Ok::<_, RecordingError>(())
                })??;
            }
            *last = Unpacked { byte: wanted.byte, messages };
        }
        let found = last.messages.get(wanted.index as usize).cloned();
        found.ok_or_else(|| self.damaged(wanted.byte, McapError::BadIndex.into()))
    }

    /// Opcode and length of the record at `at`; none where the file breaks off in it.
    fn head(&self, at: u64) -> Result<Option<(u8, u64)>, RecordingError> {
        let mut head = [0; HEAD_BYTES as usize];
        if self.bytes.saturating_sub(at) < HEAD_BYTES {
            return Ok(None);
        }
        self.read(&mut head, at)?;
        let [opcode, length @ ..] = head;
        let body_bytes = u64::from_le_bytes(length);
        // Opcode 0 is none: a file that lost power ends in zeros.
        let whole = opcode != 0 && body_bytes <= self.bytes - at - HEAD_BYTES;
        Ok(whole.then_some((opcode, body_bytes)))
    }

    /// Where nothing more can be read: the break of a file without its end, or damage.
    fn broken(&self, at: u64) -> Result<Option<u64>, RecordingError> {
        match self.has_end()? {
            true => Err(self.damaged(at, Damage::Length { bytes: self.bytes - at })),
            false => Ok(Some(at)),
        }
    }

    fn has_end(&self) -> Result<bool, RecordingError> {
        let mut end = [0; MAGIC.len()];
        let at = self.bytes - MAGIC.len() as u64;
        self.read(&mut end, at)?;
        Ok(at > 0 && end == *MAGIC)
    }

    /// Reads a whole record.
    fn load(&self, at: u64, body_bytes: u64, record: &mut Vec<u8>) -> Result<(), RecordingError> {
        if body_bytes > RECORD_BYTES_MAX {
            return Err(self.damaged(at, Damage::Length { bytes: body_bytes }));
        }
        record.resize((HEAD_BYTES + body_bytes) as usize, 0);
        self.read(record, at)
    }

    fn read(&self, to: &mut [u8], at: u64) -> Result<(), RecordingError> {
        let unreadable = |reason| RecordingError::Unreadable { path: self.path.clone(), reason };
        self.file.read_exact_at(to, at).map_err(unreadable)
    }

    fn damaged(&self, at_byte: u64, reason: Damage) -> RecordingError {
        RecordingError::Damaged { path: self.path.clone(), at_byte, reason }
    }

    /// Shows a record, or those in it; gives what `each` said about them.
    fn unpack<E>(
        &self,
        byte: u64,
        record: &[u8],
        each: &mut impl FnMut(RecordAt<'_>) -> Result<(), E>,
    ) -> Result<Result<(), E>, RecordingError> {
        let damaged = |reason: Damage| self.damaged(byte, reason);
        let (opcode, body) = (record[0], &record[HEAD_BYTES as usize..]);
        let parsed = parse_record(opcode, body).map_err(|e| damaged(e.into()))?;
        let Record::Chunk { header, data } = parsed else {
            return Ok(each(RecordAt { at: MessageAt { byte, index: 0 }, record: parsed }));
        };
        check_chunk(&header, &data).map_err(damaged)?;
        let bytes_max = body.len().max(header.uncompressed_size as usize);
        let mut reader = LinearReader::new_with_options(
            LinearReaderOptions::default()
                .with_skip_start_magic(true)
                .with_skip_end_magic(true)
                .with_prevalidate_chunk_crcs(true)
                .with_record_length_limit(bytes_max),
        );
        let (mut rest, mut index) = (record, 0);
        while let Some(event) = reader.next_event() {
            match event.map_err(|e| damaged(e.into()))? {
                LinearReadEvent::ReadRequest(wanted) => {
                    let (now, later) = rest.split_at(wanted.min(rest.len()));
                    reader.insert(now.len()).copy_from_slice(now);
                    reader.notify_read(now.len());
                    rest = later;
                }
                LinearReadEvent::Record { opcode, data } => {
                    let record = parse_inner(opcode, data).map_err(damaged)?;
                    let is_message = matches!(record, Record::Message { .. });
                    if let Err(own) = each(RecordAt { at: MessageAt { byte, index }, record }) {
                        return Ok(Err(own));
                    }
                    index += u32::from(is_message);
                }
            }
        }
        Ok(Ok(()))
    }
}

/// Only these stand in a chunk.
fn parse_inner(opcode: u8, body: &[u8]) -> Result<Record<'_>, Damage> {
    match opcode {
        op::SCHEMA | op::CHANNEL | op::MESSAGE => Ok(parse_record(opcode, body)?),
        _ => Err(McapError::BadIndex.into()),
    }
}

/// Whether the lengths that a chunk states can be. The reader of the library counts on those of an uncompressed one.
fn check_chunk(header: &ChunkHeader, data: &[u8]) -> Result<(), Damage> {
    let growth_max = match &*header.compression {
        "lz4" => LZ4_GROWTH_MAX,
        _ => ZSTD_GROWTH_MAX,
    };
    // Memory is taken for what is stated: no more than the content could become.
    let bytes_max = RECORD_BYTES_MAX.min((data.len() as u64).saturating_mul(growth_max));
    if header.uncompressed_size > bytes_max {
        return Err(Damage::Length { bytes: header.uncompressed_size });
    }
    let mut rest = data;
    while header.compression.is_empty() && !rest.is_empty() {
        let Some((head, body)) = rest.split_first_chunk::<{ HEAD_BYTES as usize }>() else {
            return Err(McapError::UnexpectedEoc.into());
        };
        let [_, length @ ..] = *head;
        let bytes = u64::from_le_bytes(length);
        match usize::try_from(bytes).ok().and_then(|bytes| body.get(bytes..)) {
            Some(after) => rest = after,
            None => return Err(Damage::Length { bytes }),
        }
    }
    Ok(())
}
