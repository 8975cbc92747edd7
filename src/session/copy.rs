//! A recording copied into a new one: the piece between two moments, or all that can be read of a damaged one.
//!
//! Takes an MCAP file, also of another program; gives a file with an index. What does not belong to a moment (schemas,
//! channels, metadata, attachments) is copied in any case, so that a piece can be replayed as the whole can. A pair is
//! taken or left as one: its two pictures and what was found in them. Nothing is there under the new name before it is
//! whole.

use std::collections::{HashMap, HashSet};
use std::fs::File;
use std::io::{self, BufWriter};
use std::ops::Range;
use std::path::{Path, PathBuf};

use mcap::records::Record;
use mcap::{Attachment, Compression, McapError, WriteOptions};

use super::events::{PairRecord, Topic};
use super::recording;
use super::records::{MessageAt, RecordAt, RecordingError, RecordingFile};
use super::writer::CHUNK_BYTES;
use crate::files;

/// What a copy came to.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Copied {
    /// Messages in it, of all topics.
    pub messages: u64,
    /// Its size.
    pub bytes: u64,
    /// Pairs with both pictures; of a rescue not counted.
    pub pairs: usize,
    /// The bytes of the old file at which something could not be read.
    pub lost_at: Vec<u64>,
    /// Messages that were read, but of which nothing says what they are.
    pub unknown: u64,
}

/// Why there is no copy.
#[derive(Debug, thiserror::Error)]
pub enum CopyError {
    /// The old file.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// A session in a folder.
    #[error("{}: a folder is no recording; copy its pictures instead", path.display())]
    Folder {
        /// The folder.
        path: PathBuf,
    },
    /// From after to.
    #[error("--from {from_s:?} is after --to {to_s:?}; give the earlier one as --from")]
    Backwards {
        /// As asked, s.
        from_s: f64,
        /// As asked, s.
        to_s: f64,
    },
    /// No picture in the piece.
    #[error(
        "{}: no pair of pictures {}; there are pictures from 0 s to {last_s:.3} s", path.display(), piece_in_words(*from_s, *to_s)
    )]
    Nothing {
        /// The old file.
        path: PathBuf,
        /// As asked, s.
        from_s: f64,
        /// As asked, s.
        to_s: f64,
        /// When the last one was seen, s.
        last_s: f64,
    },
    /// Nothing that a copy could hold.
    #[error("{}: no message in it can be read; there is nothing to recover", path.display())]
    NoMessages {
        /// The old file.
        path: PathBuf,
    },
    /// The new file is there already.
    #[error("{}: is there already; give --out a name that is free", path.display())]
    Taken {
        /// The new file.
        path: PathBuf,
    },
    /// The new file cannot be written.
    #[error("{}: cannot write it: {reason}; make room, or give --out another place", path.display())]
    Write {
        /// The new file.
        path: PathBuf,
        /// What went wrong.
        reason: io::Error,
    },
    /// A record that the old file contradicts itself in.
    #[error("{}: the copy cannot be made: {reason}; try `pickcell session recover`", path.display())]
    Record {
        /// The old file.
        path: PathBuf,
        /// What the library says.
        reason: McapError,
    },
    /// As the system says it, before it is known of which file.
    #[error(transparent)]
    Io(#[from] io::Error),
}

/// A number that has hundreds of digits is told by its exponent.
fn piece_in_words(from_s: f64, to_s: f64) -> String {
    match to_s.is_finite() {
        true => format!("from {from_s:?} s to {to_s:?} s"),
        false => format!("from {from_s:?} s on"),
    }
}

impl CopyError {
    /// Whether another command line, or another file, would have done.
    pub fn is_usage(&self) -> bool {
        use io::ErrorKind::{InvalidFilename, InvalidInput, NotADirectory, NotFound};
        match self {
            CopyError::Write { reason, .. } | CopyError::Io(reason) => {
                matches!(reason.kind(), InvalidFilename | InvalidInput | NotADirectory | NotFound)
            }
            _ => true,
        }
    }
}

/// Copies the pairs of which a picture was seen between two moments, counted from the first picture, and what happened
/// from the first of them to the one behind the last.
///
/// # Errors
/// There is no such recording, nothing in the piece, or the new file cannot be made; then it is not there.
pub fn cut(from: &Path, seconds: (f64, f64), to: &Path) -> Result<Copied, CopyError> {
    let (from_s, to_s) = seconds;
    if from_s > to_s {
        return Err(CopyError::Backwards { from_s, to_s });
    }
    let file = open(from)?;
    let moments = recording::moments(&file)?;
    let first_ns = moments.first().map_or(0, |moment| moment.0);
    let after_s = |wall_ns: i64| wall_ns.saturating_sub(first_ns) as f64 / 1e9;
    let begin = moments.partition_point(|moment| after_s(moment.0) < from_s);
    let end = moments.partition_point(|moment| after_s(moment.0) <= to_s);
    let pairs =
        moments[begin.min(end)..end].iter().filter(|(_, sides)| sides.iter().all(Option::is_some)).count();
    if pairs == 0 {
        let last_s = moments.last().map_or(0.0, |moment| after_s(moment.0));
        return Err(CopyError::Nothing { path: from.to_owned(), from_s, to_s, last_s });
    }
    // Handshake and release come before the first picture, the last answers after the last one.
    let wall_ns = |i: usize| moments.get(i).map_or(i64::MAX, |moment| moment.0);
    let piece = Piece {
        during: if begin == 0 { i64::MIN } else { wall_ns(begin) }..wall_ns(end),
        pictures: pictures(&moments),
        wanted: pictures(&moments[begin..end]),
    };
    let copied = make(from, to, |copier| {
        file.walk(|record| copier.record(record, &|at, message| piece.has(at, message)))?;
        file.attachments(|record| copier.record(record, &|_, _| true))?;
        Ok(Vec::new())
    })?;
    Ok(Copied { pairs, ..copied })
}

/// Copies all that can be read.
///
/// # Errors
/// There is no such file, nothing in it can be read, or the new file cannot be made; then it is not there.
pub fn recover(from: &Path, to: &Path) -> Result<Copied, CopyError> {
    let file = open(from)?;
    make(from, to, |copier| {
        let lost_at = file.salvage(|record| copier.record(record, &|_, _| true))?;
        match copier.messages {
            0 => Err(CopyError::NoMessages { path: from.to_owned() }),
            _ => Ok(lost_at),
        }
    })
}

fn open(path: &Path) -> Result<RecordingFile, CopyError> {
    match path.is_dir() {
        true => Err(CopyError::Folder { path: path.to_owned() }),
        false => Ok(RecordingFile::open(path)?),
    }
}

fn pictures(moments: &[recording::Moment]) -> HashSet<MessageAt> {
    moments.iter().flat_map(|(_, sides)| sides.iter().flatten()).map(|seen| seen.at).collect()
}

/// What is to be copied.
struct Piece {
    /// Wall time, ns.
    during: Range<i64>,
    /// All pictures of the two cameras.
    pictures: HashSet<MessageAt>,
    /// Those in the piece.
    wanted: HashSet<MessageAt>,
}

/// A message on its way.
struct Passing<'a> {
    logged_ns: i64,
    topic: Option<Topic>,
    data: &'a [u8],
}

impl Piece {
    fn has(&self, at: MessageAt, message: &Passing<'_>) -> bool {
        if self.pictures.contains(&at) {
            return self.wanted.contains(&at);
        }
        // A result is logged after the next pair was seen; it belongs to its own.
        let seen_ns = match message.topic {
            Some(Topic::Pair) => serde_json::from_slice::<PairRecord>(message.data)
                .ok()
                .and_then(|pair| pair.stamps_ns.into_iter().min()),
            _ => None,
        };
        self.during.contains(&seen_ns.unwrap_or(message.logged_ns))
    }
}

/// Makes the new file with what `fill` copies, which gives where something was lost.
fn make(
    from: &Path,
    to: &Path,
    fill: impl FnOnce(&mut Copier<'_>) -> Result<Vec<u64>, CopyError>,
) -> Result<Copied, CopyError> {
    let copied = files::write_new(to, |file| {
        let mut copier = Copier {
            file,
            out: None,
            messages: 0,
            unknown: 0,
            schemas: HashMap::new(),
            channels: HashMap::new(),
        };
        let lost_at = fill(&mut copier)?;
        copier.finish(lost_at)
    });
    copied.map_err(|error| match error {
        CopyError::Io(reason) if reason.kind() == io::ErrorKind::AlreadyExists => {
            CopyError::Taken { path: to.to_owned() }
        }
        CopyError::Io(reason) => CopyError::Write { path: to.to_owned(), reason },
        CopyError::Record { reason, .. } => CopyError::Record { path: from.to_owned(), reason },
        other => other,
    })
}

type Out<'a> = mcap::Writer<BufWriter<&'a File>>;

/// Writes what passes by.
struct Copier<'a> {
    file: &'a File,
    out: Option<Out<'a>>,
    messages: u64,
    /// Messages of no channel.
    unknown: u64,
    /// By the numbers of the old file: name, encoding, content.
    schemas: HashMap<u16, (String, String, Vec<u8>)>,
    /// By the numbers of the old file: that of the new one, and which topic of ours it is.
    channels: HashMap<u16, (u16, Option<Topic>)>,
}

impl<'a> Copier<'a> {
    fn record(
        &mut self,
        RecordAt { at, record }: RecordAt<'_>,
        wanted: &dyn Fn(MessageAt, &Passing<'_>) -> bool,
    ) -> Result<(), CopyError> {
        match record {
            Record::Header(header) => {
                self.out(&header.profile)?;
            }
            Record::Schema { header, data } => {
                self.schemas.insert(header.id, (header.name, header.encoding, data.into_owned()));
            }
            Record::Channel(channel) => {
                let schema = self.schemas.get(&channel.schema_id).cloned();
                let is_record = |topic: &Topic| {
                    schema.as_ref().is_some_and(|(name, ..)| topic.schema_name() == name)
                        && channel.message_encoding == "json"
                };
                let topic = Topic::ALL.into_iter().find(is_record);
                let out = self.out("")?;
                let schema_id = match &schema {
                    Some((name, encoding, data)) => out.add_schema(name, encoding, data).map_err(refused)?,
                    None => 0,
                };
                let (name, encoding) = (&channel.topic, &channel.message_encoding);
                let id = out.add_channel(schema_id, name, encoding, &channel.metadata).map_err(refused)?;
                self.channels.insert(channel.id, (id, topic));
            }
            Record::Message { header, data } => {
                let Some(&(channel_id, topic)) = self.channels.get(&header.channel_id) else {
                    self.unknown += 1;
                    return Ok(());
                };
                let logged_ns = i64::try_from(header.log_time).unwrap_or(i64::MAX);
                if wanted(at, &Passing { logged_ns, topic, data: &data }) {
                    let header = mcap::records::MessageHeader { channel_id, ..header };
                    self.out("")?.write_to_known_channel(&header, &data).map_err(refused)?;
                    self.messages += 1;
                }
            }
            Record::Metadata(metadata) => self.out("")?.write_metadata(&metadata).map_err(refused)?,
            Record::Attachment { header, data, .. } => {
                let attachment = Attachment {
                    log_time: header.log_time,
                    create_time: header.create_time,
                    name: header.name,
                    media_type: header.media_type,
                    data,
                };
                self.out("")?.attach(&attachment).map_err(refused)?;
            }
            _ => {}
        }
        Ok(())
    }

    /// The new file; its head is written with the first record.
    fn out(&mut self, profile: &str) -> Result<&mut Out<'a>, CopyError> {
        if self.out.is_none() {
            let options = WriteOptions::new()
                .profile(profile)
                .library(concat!("pickcell ", env!("CARGO_PKG_VERSION")))
                .compression(Some(Compression::Lz4))
                .chunk_size(Some(CHUNK_BYTES));
            let buffered = BufWriter::with_capacity(1 << 20, self.file);
            self.out = Some(options.create(buffered).map_err(refused)?);
        }
        Ok(self.out.as_mut().expect("it was just made"))
    }

    fn finish(mut self, lost_at: Vec<u64>) -> Result<Copied, CopyError> {
        self.out("")?.finish().map_err(refused)?;
        let bytes = self.file.metadata()?.len();
        Ok(Copied { messages: self.messages, bytes, pairs: 0, lost_at, unknown: self.unknown })
    }
}

/// What the library did not take, or could not write.
fn refused(reason: McapError) -> CopyError {
    match reason {
        McapError::Io(reason) => CopyError::Io(reason),
        reason => CopyError::Record { path: PathBuf::new(), reason },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Side;
    use crate::frame::{Frame, PixelFormat};
    use crate::session::events::Level;
    use crate::session::{About, RecordingWriter, Session};
    use crate::time::Timestamp;

    const MS: i64 = 1_000_000;

    /// Ten pairs 100 ms apart, the right picture 4 ms later; each with its result 50 ms later, and a line of the log.
    fn recording(folder: &Path) -> PathBuf {
        let path = folder.join("old.mcap");
        let about = About {
            wall_from_cell_ns: 1_700_000_000_000_000_000,
            files: vec![("cell.toml".into(), b"# a cell".to_vec())],
            ..About::default()
        };
        let mut writer = RecordingWriter::create(&path, &about).unwrap();
        writer.line(Level::Info, Timestamp(0), "hello").unwrap();
        for i in 0..10 {
            let seen = [100, 104].map(|ms| Timestamp(i * 100 * MS + ms * MS));
            for (side, timestamp) in Side::BOTH.into_iter().zip(seen) {
                let format = PixelFormat::Grey;
                let mut frame =
                    Frame { format, width: 2, height: 2, stride_bytes: 2, timestamp, ..Frame::default() };
                frame.bytes = vec![i as u8; 4];
                writer.frame(side, &mut frame).unwrap();
            }
            let stamps_ns = seen.map(|at| writer.wall_ns(at));
            let pair =
                PairRecord { number: i as u64, name: format!("p{i}"), stamps_ns, ..Default::default() };
            writer.record(Topic::Pair, Timestamp(seen[0].0 + 150 * MS), &pair).unwrap();
            // A chunk a pair.
            writer.flush().unwrap();
        }
        writer.finish().unwrap();
        path
    }

    /// First grey values of the pairs, results, and attached files.
    fn content(path: &Path) -> (Vec<u8>, u64, usize) {
        let session = Session::open(path).unwrap();
        assert_eq!(session.broken_at, None);
        let shown: Vec<_> = session
            .pairs
            .iter()
            .map(|pair| pair.pictures.each_ref().map(|p| p.as_ref().unwrap().read().unwrap().bytes[0]))
            .collect();
        assert!(shown.iter().all(|[left, right]| left == right), "{shown:?}");
        let bytes = std::fs::read(path).unwrap();
        let summary = mcap::Summary::read(&bytes).unwrap().expect("an index");
        (
            shown.into_iter().map(|[left, _]| left).collect(),
            session.results.pairs,
            summary.attachment_indexes.len(),
        )
    }

    #[test]
    fn a_piece_has_whole_pairs_with_their_results_and_the_files_that_belong_to_it() {
        let folder = tempfile::tempdir().unwrap();
        let old = recording(folder.path());
        // Between the pictures of a pair neither end cuts it.
        for (seconds, pairs, messages) in [
            ((0.0, f64::INFINITY), 0..10, 31),
            ((0.2, 0.402), 2..5, 9),
            ((0.202, 0.4), 3..5, 6),
            ((0.9, 1e300), 9..10, 3),
            ((0.0, 0.0), 0..1, 4),
        ] {
            let new = folder.path().join(format!("{}-{:e}.mcap", seconds.0, seconds.1));
            let copied = cut(&old, seconds, &new).unwrap();
            assert_eq!((copied.pairs, copied.messages), (pairs.len(), messages), "{seconds:?}");
            assert_eq!(copied.bytes, std::fs::metadata(&new).unwrap().len());
            assert_eq!(content(&new), (pairs.clone().collect(), pairs.len() as u64, 1), "{seconds:?}");
        }
    }

    #[test]
    fn what_a_damaged_chunk_and_a_missing_end_leave_is_recovered() {
        let folder = tempfile::tempdir().unwrap();
        let old = recording(folder.path());
        let whole = std::fs::read(&old).unwrap();
        let new = |name: &str| folder.path().join(name);
        let untouched = recover(&old, &new("a.mcap")).unwrap();
        assert_eq!((untouched.messages, untouched.lost_at.len()), (31, 0));
        assert_eq!(content(&new("a.mcap")), ((0..10).collect(), 10, 1));
        // The chunk of the fifth pair.
        let summary = mcap::Summary::read(&whole).unwrap().unwrap();
        let mut chunks: Vec<_> =
            summary.chunk_indexes.iter().map(|c| c.chunk_start_offset as usize).collect();
        chunks.sort_unstable();
        let at = chunks[chunks.len() - 6];
        let mut damaged = whole.clone();
        damaged[at + 80] ^= 0xff;
        std::fs::write(new("damaged.mcap"), &damaged).unwrap();
        assert!(Session::open(&new("damaged.mcap")).is_err());
        let copied = recover(&new("damaged.mcap"), &new("b.mcap")).unwrap();
        assert_eq!((copied.messages, copied.lost_at), (28, vec![at as u64]));
        assert_eq!(content(&new("b.mcap")), (vec![0, 1, 2, 3, 5, 6, 7, 8, 9], 9, 1));
        // Whichever it is, also the one that the channels stood in, what the others hold is still there.
        for (nth, at) in chunks.iter().enumerate() {
            let mut damaged = whole.clone();
            damaged[at + 80] ^= 0xff;
            let (old, rest) = (new("one.mcap"), new(&format!("rest-{nth}.mcap")));
            std::fs::write(&old, &damaged).unwrap();
            let copied = recover(&old, &rest).unwrap();
            assert_eq!((copied.lost_at, copied.unknown), (vec![*at as u64], 0));
            assert!(content(&rest).0.len() >= 9, "chunk {nth}");
        }
        damaged.truncate(chunks[chunks.len() - 2] + 20);
        std::fs::write(new("torn.mcap"), &damaged).unwrap();
        let copied = recover(&new("torn.mcap"), &new("c.mcap")).unwrap();
        assert_eq!(copied.lost_at.len(), 2);
        assert_eq!(content(&new("c.mcap")).0, [0, 1, 2, 3, 5, 6, 7]);
        let cut_too = cut(&new("c.mcap"), (0.3, 0.6), &new("d.mcap")).unwrap();
        assert_eq!(cut_too.pairs, 3);
    }

    #[test]
    fn what_cannot_be_copied_is_said_and_leaves_nothing_behind() {
        let folder = tempfile::tempdir().unwrap();
        let old = recording(folder.path());
        let new = folder.path().join("new.mcap");
        let message = |from: &Path, seconds, to: &Path| cut(from, seconds, to).unwrap_err().to_string();
        assert_eq!(
            message(&old, (3.0, 2.0), &new),
            "--from 3.0 is after --to 2.0; give the earlier one as --from"
        );
        assert!(
            message(&old, (5.0, 6.0), &new)
                .ends_with("no pair of pictures from 5.0 s to 6.0 s; there are pictures from 0 s to 0.900 s")
        );
        assert!(
            message(folder.path(), (0.0, 1.0), &new)
                .ends_with("a folder is no recording; copy its pictures instead")
        );
        assert!(
            message(&old, (0.0, 1.0), &old).ends_with("is there already; give --out a name that is free")
        );
        assert!(message(&new, (0.0, 1.0), &folder.path().join("x")).contains("new.mcap: cannot read it"));
        let absent = cut(&old, (0.0, 1.0), &folder.path().join("absent/x")).unwrap_err();
        assert!(absent.to_string().contains("cannot write it") && absent.is_usage(), "{absent}");
        std::fs::write(&new, &std::fs::read(&old).unwrap()[..30]).unwrap();
        let nothing = recover(&new, &folder.path().join("x")).unwrap_err();
        assert!(
            nothing.is_usage() && nothing.to_string().ends_with("there is nothing to recover"),
            "{nothing}"
        );
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2);
    }
}
