//! Writes a recording: one MCAP file that Foxglove opens as it is.
//!
//! Takes frames, records and their times; owns the file. Message times are wall time, which is the cell's time plus one
//! offset, agreed when the file is begun and written into its metadata. A chunk is ended after at most
//! [`CHUNK_BYTES`] and at every [`flush`](RecordingWriter::flush), because a chunk that is cut gives nothing back.
//! LZ4, because the processor has other work: it makes pictures without compression about a third smaller at some
//! hundred megabytes a second, and loses no time on JPEG.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use mcap::records::MessageHeader;
use mcap::{Attachment, Compression, McapError, WriteOptions};
use prost::Message;
use serde::Serialize;

use super::events::{Level, LogRecord, LogTime, Topic};
use super::foxglove::{self, CompressedImage, ImageKind, RawImage};
use crate::camera::Side;
use crate::frame::{ColourEncoding, Frame};
use crate::time::Timestamp;
use crate::vision::decode::insert_tables;

/// A chunk is ended when it has grown to this.
pub(super) const CHUNK_BYTES: u64 = 256 << 10;

/// Name of the metadata record.
pub(super) const METADATA: &str = "pickcell";

/// Its entry for how far apart the frames of a pair may be in the cell that was recorded, ms.
pub const PAIR_WINDOW: &str = "pair_window_ms";

/// A recording that cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// Its file cannot be made.
    #[error("{}: no recording can be made there: {reason}; check recording.folder and its rights", path.display())]
    Create {
        /// The file or its folder.
        path: PathBuf,
        /// What the system said.
        reason: std::io::Error,
    },
    /// It was begun, and cannot go on.
    #[error("{}: the recording ends here: {}; what was written stays readable", path.display(), in_words(reason))]
    Write {
        /// The file.
        path: PathBuf,
        /// What went wrong.
        reason: McapError,
    },
}

impl WriteError {
    /// Whether a file of this name is there already.
    pub fn is_taken(&self) -> bool {
        matches!(self, Self::Create { path, reason } if reason.kind() == std::io::ErrorKind::AlreadyExists && path.is_file())
    }
}

fn in_words(reason: &McapError) -> String {
    match reason {
        McapError::Io(io) => io.to_string(),
        other => other.to_string(),
    }
}

/// What stands in front of a recording.
#[derive(Clone, Debug, Default)]
pub struct About {
    /// Wall time minus the cell's time, ns.
    pub wall_from_cell_ns: i64,
    /// Anything worth knowing, by name.
    pub metadata: BTreeMap<String, String>,
    /// Files that belong to it: name and content.
    pub files: Vec<(String, Vec<u8>)>,
}

/// A recording that is being written.
pub struct RecordingWriter {
    path: PathBuf,
    /// The same file, to ask for its size.
    file: File,
    writer: mcap::Writer<BufWriter<File>>,
    wall_from_cell_ns: i64,
    topics: [u16; Topic::ALL.len()],
    images: [Option<(ImageKind, ColourEncoding, u16)>; 2],
    /// Messages so far, by channel.
    counts: Vec<u32>,
    /// The message that is being made.
    message: Vec<u8>,
}

impl RecordingWriter {
    /// Begins a file that is not there yet, and its folder.
    ///
    /// # Errors
    /// It cannot be made.
    pub fn create(path: &Path, about: &About) -> Result<Self, WriteError> {
        let cannot = |reason| WriteError::Create { path: path.to_owned(), reason };
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder).map_err(cannot)?;
        }
        let file = File::create_new(path).map_err(cannot)?;
        let buffered = BufWriter::with_capacity(1 << 20, file.try_clone().map_err(cannot)?);
        let options = WriteOptions::new()
            .library(concat!("pickcell ", env!("CARGO_PKG_VERSION")))
            .compression(Some(Compression::Lz4))
            .chunk_size(Some(CHUNK_BYTES))
            // Every chunk has its own.
            .calculate_data_section_crc(false)
            // A chunk's length then stands in front of it before its content does.
            .disable_seeking(true);
        let begun = options.create(buffered).and_then(|writer| begin(writer, about));
        let (writer, topics) = begun.map_err(|reason| WriteError::Write { path: path.to_owned(), reason })?;
        Ok(Self {
            path: path.to_owned(),
            file,
            writer,
            wall_from_cell_ns: about.wall_from_cell_ns,
            topics,
            images: [None; 2],
            counts: Vec::new(),
            message: Vec::new(),
        })
    }

    /// The cell's time as wall time, ns.
    pub fn wall_ns(&self, at: Timestamp) -> i64 {
        at.0.saturating_add(self.wall_from_cell_ns)
    }

    /// Writes a picture. The frame is as before afterwards.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn frame(&mut self, side: Side, frame: &mut Frame) -> Result<(), WriteError> {
        let written = self.try_frame(side, frame);
        self.checked(written)
    }

    /// Writes a record to its topic.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn record(&mut self, topic: Topic, at: Timestamp, record: &impl Serialize) -> Result<(), WriteError> {
        self.message.clear();
        let json = serde_json::to_writer(&mut self.message, record).map_err(|e| McapError::Io(e.into()));
        let written = json.and_then(|()| self.send(self.topics[topic as usize], self.wall_ns(at)));
        self.checked(written)
    }

    /// Writes a line of the log.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn line(&mut self, level: Level, at: Timestamp, message: &str) -> Result<(), WriteError> {
        let wall_ns = self.wall_ns(at);
        let timestamp = LogTime {
            sec: wall_ns.div_euclid(1_000_000_000),
            nsec: wall_ns.rem_euclid(1_000_000_000) as u32,
        };
        let name = "pickcell".to_owned();
        let (message, file) = (message.to_owned(), String::new());
        let record = LogRecord { timestamp, level: level as u8, message, name, file, line: 0 };
        self.record(Topic::Log, at, &record)
    }

    /// Ends the chunk, and hands all to the system; gives the size of the file, bytes.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn flush(&mut self) -> Result<u64, WriteError> {
        let flushed = self.writer.flush();
        let size = flushed.and_then(|()| Ok(self.file.metadata()?.len()));
        self.checked(size)
    }

    /// Has the disk take what was flushed.
    ///
    /// # Errors
    /// It does not.
    pub fn sync(&self) -> Result<(), WriteError> {
        self.checked(self.file.sync_data().map_err(McapError::Io))
    }

    /// Writes the index; gives the size of the file, bytes.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn finish(mut self) -> Result<u64, WriteError> {
        let finished = self.writer.finish();
        let size = finished.and_then(|_| Ok(self.file.metadata()?.len()));
        self.checked(size)
    }

    fn try_frame(&mut self, side: Side, frame: &mut Frame) -> Result<(), McapError> {
        let kind = ImageKind::of(frame.format);
        let channel = self.image_channel(side, kind, frame.encoding)?;
        let wall_ns = self.wall_ns(frame.timestamp);
        let timestamp = Some(foxglove::timestamp(wall_ns));
        let frame_id = side.name().to_owned();
        self.message.clear();
        // The pixels are lent to the message for as long as it is written.
        let encoded = match kind {
            ImageKind::Compressed => {
                let with_tables = insert_tables(&frame.bytes);
                let data = with_tables.unwrap_or_else(|| std::mem::take(&mut frame.bytes));
                let image = CompressedImage { timestamp, frame_id, data, format: "jpeg".into() };
                let encoded = image.encode(&mut self.message);
                if frame.bytes.is_empty() {
                    frame.bytes = image.data;
                }
                encoded
            }
            ImageKind::Raw => {
                let image = RawImage {
                    timestamp,
                    frame_id,
                    width: frame.width as u32,
                    height: frame.height as u32,
                    encoding: foxglove::encoding_name(frame.format).unwrap_or_default().into(),
                    step: frame.stride_bytes as u32,
                    data: std::mem::take(&mut frame.bytes),
                };
                let encoded = image.encode(&mut self.message);
                frame.bytes = image.data;
                encoded
            }
        };
        encoded.map_err(|e| McapError::Io(std::io::Error::other(e)))?;
        self.send(channel, wall_ns)
    }

    /// The channel of a side's pictures; another one where their format has changed.
    fn image_channel(
        &mut self,
        side: Side,
        kind: ImageKind,
        encoding: ColourEncoding,
    ) -> Result<u16, McapError> {
        if let Some((old_kind, old_encoding, channel)) = self.images[side.index()]
            && (old_kind, old_encoding) == (kind, encoding)
        {
            return Ok(channel);
        }
        let schema = self.writer.add_schema(kind.schema_name(), "protobuf", &kind.schema())?;
        let topic = format!("/{}/image", side.name());
        let metadata = match kind {
            ImageKind::Compressed => BTreeMap::new(),
            ImageKind::Raw => foxglove::colour_metadata(encoding),
        };
        let channel = self.writer.add_channel(schema, &topic, "protobuf", &metadata)?;
        self.images[side.index()] = Some((kind, encoding, channel));
        Ok(channel)
    }

    /// Writes the message that was made.
    fn send(&mut self, channel_id: u16, wall_ns: i64) -> Result<(), McapError> {
        let place = usize::from(channel_id);
        if self.counts.len() <= place {
            self.counts.resize(place + 1, 0);
        }
        let sequence = self.counts[place];
        self.counts[place] = sequence.wrapping_add(1);
        let time = u64::try_from(wall_ns).unwrap_or(0);
        let header = MessageHeader { channel_id, sequence, log_time: time, publish_time: time };
        self.writer.write_to_known_channel(&header, &self.message)
    }

    fn checked<T>(&self, result: Result<T, McapError>) -> Result<T, WriteError> {
        result.map_err(|reason| WriteError::Write { path: self.path.clone(), reason })
    }
}

type Begun = (mcap::Writer<BufWriter<File>>, [u16; Topic::ALL.len()]);

/// What stands in front: metadata, files, the channels of the records.
fn begin(mut writer: mcap::Writer<BufWriter<File>>, about: &About) -> Result<Begun, McapError> {
    let mut metadata = about.metadata.clone();
    metadata.insert("wall_from_cell_ns".into(), about.wall_from_cell_ns.to_string());
    writer.write_metadata(&mcap::records::Metadata { name: METADATA.into(), metadata })?;
    for (name, content) in &about.files {
        writer.attach(&Attachment {
            log_time: 0,
            create_time: 0,
            name: name.clone(),
            media_type: "text/plain".into(),
            data: content.into(),
        })?;
    }
    let mut topics = [0; Topic::ALL.len()];
    for (topic, channel) in Topic::ALL.into_iter().zip(&mut topics) {
        let schema = writer.add_schema(topic.schema_name(), "jsonschema", topic.schema().as_bytes())?;
        *channel = writer.add_channel(schema, topic.name(), "json", &BTreeMap::new())?;
    }
    writer.flush()?;
    Ok((writer, topics))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::PixelFormat;
    use crate::session::Session;

    fn frame(format: PixelFormat, at: i64) -> Frame {
        let (width, height) = (6, 4);
        let row = Frame { format, width, height, ..Frame::default() }.row_bytes();
        let mut frame = Frame {
            format,
            width,
            height,
            stride_bytes: row + 2,
            timestamp: Timestamp(at),
            ..Frame::default()
        };
        frame.encoding.range = crate::frame::QuantizationRange::Full;
        frame.bytes = (0..frame.bytes_needed()).map(|i| (i * 7) as u8).collect();
        frame
    }

    #[test]
    fn frames_of_every_format_come_back_as_they_were() {
        let folder = tempfile::tempdir().unwrap();
        use PixelFormat::{Bgr, Grey, Nv12, Rgb, Yuyv};
        for format in [Rgb, Bgr, Grey, Yuyv, Nv12] {
            let path = folder.path().join(format!("new/{format:?}.mcap"));
            let mut about = About { wall_from_cell_ns: 1_700_000_000_000_000_000, ..Default::default() };
            if format == Grey {
                about.metadata.insert("rate_hz".into(), "30".into());
            }
            let mut writer = RecordingWriter::create(&path, &about).unwrap();
            for pair in 0..3 {
                for side in Side::BOTH {
                    let before = frame(format, 1000 + pair * 40_000_000);
                    let mut lent = before.clone();
                    writer.frame(side, &mut lent).unwrap();
                    assert_eq!(lent, before);
                }
            }
            writer.finish().unwrap();
            let session = Session::open(&path).unwrap();
            // What the file says, else what its time stamps say.
            let rate_hz = if format == Grey { 30.0 } else { 25.0 };
            assert_eq!((session.pairs.len(), session.rate_hz), (3, rate_hz));
            let read = session.pairs[1].pictures[1].as_ref().unwrap().read().unwrap();
            assert_eq!(Frame { timestamp: Timestamp(1000 + 40_000_000), ..read }, frame(format, 40_001_000));
        }
    }

    #[test]
    fn a_recording_is_never_written_over_and_its_folder_must_be_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        RecordingWriter::create(&path, &About::default()).unwrap().finish().unwrap();
        let message =
            |path: &Path| RecordingWriter::create(path, &About::default()).err().unwrap().to_string();
        assert!(message(&path).contains("a.mcap: no recording can be made there"));
        assert!(message(&path.join("b.mcap")).ends_with("check recording.folder and its rights"));
    }

    #[test]
    fn what_was_flushed_is_there_without_the_end() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        let mut writer = RecordingWriter::create(&path, &About::default()).unwrap();
        for side in Side::BOTH {
            writer.frame(side, &mut frame(PixelFormat::Yuyv, 5)).unwrap();
        }
        writer.line(Level::Info, Timestamp(7), "hello").unwrap();
        let size = writer.flush().unwrap();
        writer.frame(Side::Left, &mut frame(PixelFormat::Yuyv, 40_000_000)).unwrap();
        let copy = folder.path().join("b.mcap");
        fs::copy(&path, &copy).unwrap();
        let session = Session::open(&copy).unwrap();
        assert_eq!((session.pairs.len(), session.broken_at), (1, Some(size)));
    }
}
