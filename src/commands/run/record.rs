//! The recording of a running cell, written in a thread of its own, so that lines, log and place records do not wait
//! for it.
//!
//! A recording that cannot be begun or cannot go on ends with a message; the cell goes on. What is handed over after
//! that comes back at once.

use std::path::PathBuf;
use std::thread::{Builder, JoinHandle};
use std::time::Duration;

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded, unbounded};
use std::sync::Arc;

use super::entries::{about, add_recognition, record_of, said_to};
use crate::camera::Side;
use crate::cell::core::{NoPick, PairReport};
use crate::cell::desk::{File, Logged};
use crate::config::{Cell, KeptPictures, Recording, WhenFull};
use crate::frame::Frame;
use crate::handover::Waker;
use crate::part::Part;
use crate::session::events::{Level, PairRecord, Topic};
use crate::session::{About, RecordingWriter, WriteError};
use crate::telemetry::Telemetry;
use crate::time::{Timestamp, utc_name};

/// Orders without a file that wait at most; a disk that hangs must not fill the memory.
const ORDERS: usize = 8192;
/// What was written is handed to the system this often, ns, and the disk is made to take it this often.
const FLUSH_NS: i64 = 500_000_000;
const SYNC_NS: i64 = 5_000_000_000;
/// Of a recording that begins anew when its file is full, so many files are kept.
const FILES_KEPT: usize = 2;

/// Something to be written.
enum Order {
    Pair { record: Box<PairRecord>, at: Timestamp, file: Option<Box<File>>, caption: String },
    Logged(Box<Logged>),
    Line(Level, Timestamp, String),
    Lone(Side, Frame),
}

/// A pair that was written, as far as it could be.
pub(super) struct Written {
    pub(super) name: String,
    pub(super) caption: String,
    pub(super) file: Box<File>,
}

/// What a recording came to.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Tally {
    /// The newest file.
    pub(super) path: PathBuf,
    /// Pairs with their pictures.
    pub(super) pairs: u64,
    /// Bytes in all files.
    pub(super) bytes: u64,
    /// Time that the thread worked, ns.
    pub(super) busy_ns: i64,
    /// Records for which there was no room.
    pub(super) lost: u64,
    /// Pairs that were written without pictures, because all files were under way.
    pub(super) bare: u64,
}

impl Tally {
    /// What is missing in it, by name.
    pub(super) fn losses(&self, telemetry: &Telemetry) -> [(&'static str, u64); 3] {
        [
            ("pairs recorded without pictures", self.bare),
            ("events not recorded", self.lost + telemetry.unlogged()),
            ("frames without a search not recorded", telemetry.unkept()),
        ]
    }

    /// File, size and cost.
    pub(super) fn in_words(&self) -> String {
        let per_pair = |n: f64| n / self.pairs.max(1) as f64;
        format!(
            "recorded in {}: {:.1} MB, {:.0} kB and {:.2} ms of its thread a pair",
            self.path.display(),
            self.bytes as f64 / 1e6,
            per_pair(self.bytes as f64 / 1e3),
            per_pair(self.busy_ns as f64 / 1e6)
        )
    }
}

/// The recorder's thread, as the cold thread sees it.
pub(super) struct Recorder {
    orders: Sender<Order>,
    written: Receiver<Written>,
    spare: Receiver<(Side, Frame)>,
    thread: JoinHandle<Tally>,
    under_way: usize,
    lost: u64,
    bare: u64,
}

impl Recorder {
    /// Begins the recording that the cell wants, if it wants one; `waker` hears when a pair is written.
    pub(super) fn open(
        cell: &Cell,
        parts: &[Part],
        period: Duration,
        waker: Arc<Waker>,
    ) -> std::io::Result<Option<Self>> {
        let Some(settings) = cell.recording.clone() else { return Ok(None) };
        let about = about(cell, period);
        let names = parts.iter().map(|part| part.name.clone()).collect();
        let book = match Book::begin(settings, about, names) {
            Ok(book) => book,
            Err(error) => {
                tracing::error!("{error}; the cell runs without a recording");
                return Ok(None);
            }
        };
        let (orders, ordered) = bounded(ORDERS);
        let (finished, written) = unbounded();
        let (spares, spare) = unbounded();
        let thread = Builder::new().name("record".into()).spawn(move || {
            let mut book = book;
            book.work(&ordered, &Done { pairs: finished, frames: spares, waker })
        })?;
        Ok(Some(Self { orders, written, spare, thread, under_way: 0, lost: 0, bare: 0 }))
    }

    /// Hands over a pair; gives its file back where nobody will.
    pub(super) fn pair(
        &mut self,
        name: String,
        caption: String,
        report: &PairReport,
        file: Option<Box<File>>,
    ) -> Result<(), Box<File>> {
        let record = Box::new(PairRecord { name, number: report.pair.number, ..record_of(report) });
        let with_file = file.is_some();
        let recognised = !matches!(report.outcome, Err(NoPick::Superseded | NoPick::Stopping));
        self.bare += u64::from(recognised && !with_file);
        // A disk that hangs must not keep the cell's lines and place records waiting.
        match self.orders.try_send(Order::Pair { record, at: report.at, file, caption }) {
            Ok(()) => self.under_way += usize::from(with_file),
            Err(refused) => {
                self.lost += 1;
                if let Order::Pair { file: Some(file), .. } = refused.into_inner() {
                    return Err(file);
                }
            }
        }
        Ok(())
    }

    /// Hands over a frame that led to no search; gives it back where nobody will.
    pub(super) fn lone(&mut self, side: Side, frame: Frame) -> Result<(), Frame> {
        match self.orders.try_send(Order::Lone(side, frame)).map_err(|refused| refused.into_inner()) {
            Err(Order::Lone(_, frame)) => {
                self.lost += 1;
                Err(frame)
            }
            _ => Ok(()),
        }
    }

    /// A frame without a search that was written.
    pub(super) fn spare(&mut self) -> Option<(Side, Frame)> {
        self.spare.try_recv().ok()
    }

    /// Hands over what was logged.
    pub(super) fn logged(&mut self, logged: Logged) {
        self.lost += u64::from(self.orders.try_send(Order::Logged(Box::new(logged))).is_err());
    }

    /// Hands over a line of the log.
    pub(super) fn line(&mut self, level: Level, at: Timestamp, line: String) {
        self.lost += u64::from(self.orders.try_send(Order::Line(level, at, line)).is_err());
    }

    /// A pair that was written; waits for it where more than `under_way_max` are not.
    pub(super) fn written(&mut self, under_way_max: usize) -> Option<Written> {
        let written = match self.under_way > under_way_max {
            true => self.written.recv().ok(),
            false => self.written.try_recv().ok(),
        };
        self.under_way =
            if written.is_some() { self.under_way - 1 } else { self.under_way.min(under_way_max) };
        written
    }

    /// Waits until all is written, and ends the file.
    pub(super) fn close(self) -> Tally {
        drop(self.orders);
        let tally = self.thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        Tally { lost: self.lost, bare: self.bare, ..tally }
    }
}

/// The way back of what was written.
struct Done {
    pairs: Sender<Written>,
    frames: Sender<(Side, Frame)>,
    waker: Arc<Waker>,
}

impl Done {
    fn pair(&self, written: Written) {
        if self.pairs.send(written).is_ok() {
            self.waker.wake();
        }
    }

    fn lone(&self, side: Side, frame: Frame) {
        if self.frames.send((side, frame)).is_ok() {
            self.waker.wake();
        }
    }
}

/// The files of a recording; none any more where it has ended.
struct Book {
    settings: Recording,
    about: About,
    names: Vec<String>,
    writer: Option<RecordingWriter>,
    files: Vec<PathBuf>,
    finished_bytes: u64,
    tally: Tally,
    /// Pairs that were written with their pictures; they count when they are in the file.
    pairs: u64,
    flushed: Timestamp,
    synced: Timestamp,
}

impl Book {
    fn begin(settings: Recording, about: About, names: Vec<String>) -> Result<Self, WriteError> {
        let now = Timestamp::now();
        let mut book = Self {
            settings,
            about,
            names,
            writer: None,
            files: Vec::new(),
            finished_bytes: 0,
            tally: Tally::default(),
            pairs: 0,
            flushed: now,
            synced: now,
        };
        book.next_file()?;
        Ok(book)
    }

    /// Begins a file named after the time, and lets go of those that are too many.
    fn next_file(&mut self) -> Result<(), WriteError> {
        let mut wall_ns = Timestamp::now().0.saturating_add(self.about.wall_from_cell_ns);
        let (path, writer) = loop {
            let path = self.settings.folder.join(format!("{}.mcap", utc_name(wall_ns)));
            match RecordingWriter::create(&path, &self.about) {
                // Another cell has begun one in the same millisecond.
                Err(error) if error.is_taken() => wall_ns = wall_ns.saturating_add(1_000_000),
                made => break (path, made?),
            }
        };
        self.writer = Some(writer);
        tracing::info!(file = %path.display(), "recording");
        self.tally.path.clone_from(&path);
        self.files.push(path);
        while self.files.len() > FILES_KEPT {
            // Whoever has moved or removed it meanwhile may have done so.
            let _ = std::fs::remove_file(self.files.remove(0));
        }
        Ok(())
    }

    fn work(&mut self, ordered: &Receiver<Order>, done: &Done) -> Tally {
        loop {
            let left_ns = (FLUSH_NS - Timestamp::now().since(self.flushed)).clamp(0, FLUSH_NS);
            let order = ordered.recv_timeout(Duration::from_nanos(left_ns as u64));
            let begun = Timestamp::now();
            let more = !matches!(order, Err(RecvTimeoutError::Disconnected));
            if let Ok(order) = order {
                self.write(order, done);
            }
            if more {
                self.keep_up(begun);
            } else {
                self.end();
            }
            self.tally.busy_ns += Timestamp::now().since(begun);
            if !more {
                return self.tally.clone();
            }
        }
    }

    fn write(&mut self, order: Order, done: &Done) {
        match order {
            Order::Pair { mut record, at, mut file, caption } => {
                let written = self.pair(&mut record, at, file.as_deref_mut());
                self.give_up_on(written);
                if let Some(file) = file {
                    done.pair(Written { name: record.name, caption, file });
                }
            }
            Order::Logged(logged) => {
                let Logged { at, said } = *logged;
                let written = self.writer.as_mut().map_or(Ok(()), |writer| said_to(writer, at, said));
                self.give_up_on(written);
            }
            Order::Line(level, at, line) => {
                let written = self.writer.as_mut().map_or(Ok(()), |writer| writer.line(level, at, &line));
                self.give_up_on(written);
            }
            Order::Lone(side, mut frame) => {
                let kept = self.settings.pictures == KeptPictures::All;
                let writer = self.writer.as_mut().filter(|_| kept);
                let written = writer.map_or(Ok(()), |writer| writer.frame(side, &mut frame));
                self.give_up_on(written);
                done.lone(side, frame);
            }
        }
    }

    fn pair(
        &mut self,
        record: &mut PairRecord,
        at: Timestamp,
        file: Option<&mut File>,
    ) -> Result<(), WriteError> {
        let Some(writer) = &mut self.writer else { return Ok(()) };
        let keep = match self.settings.pictures {
            KeptPictures::All => true,
            KeptPictures::Targets => record.target.is_some(),
            KeptPictures::None => false,
        };
        if let Some(file) = file {
            add_recognition(record, file, &self.names);
            if keep {
                writer.frame(Side::Left, &mut file.pair.left)?;
                writer.frame(Side::Right, &mut file.pair.right)?;
                record.pictures = true;
                self.pairs += 1;
            }
        }
        record.stamps_ns = record.stamps_ns.map(|ns| writer.wall_ns(Timestamp(ns)));
        writer.record(Topic::Pair, at, record)
    }

    /// Flushes when it is time, and begins the next file or ends where this one is full.
    fn keep_up(&mut self, now: Timestamp) {
        if now.since(self.flushed) < FLUSH_NS {
            return;
        }
        self.flushed = now;
        let Some(writer) = &mut self.writer else { return };
        let mut size = writer.flush();
        if size.is_ok() && now.since(self.synced) >= SYNC_NS {
            self.synced = now;
            size = writer.sync().and(size);
        }
        match size {
            Ok(bytes) if bytes >= self.settings.file_bytes_max => self.full(),
            Ok(bytes) => {
                self.tally.pairs = self.pairs;
                self.tally.bytes = self.finished_bytes + bytes;
            }
            Err(error) => self.give_up_on(Err(error)),
        }
    }

    fn full(&mut self) {
        self.end();
        match self.settings.when_full {
            WhenFull::Stop => tracing::warn!(
                "{}: full ({} MB, recording.file_mb_max); the recording ends, the cell goes on",
                self.tally.path.display(),
                self.settings.file_bytes_max / 1_000_000
            ),
            WhenFull::NextFile => {
                let begun = self.next_file();
                self.give_up_on(begun);
            }
        }
    }

    fn end(&mut self) {
        let Some(writer) = self.writer.take() else { return };
        match writer.finish() {
            Ok(bytes) => {
                self.finished_bytes += bytes;
                self.tally.bytes = self.finished_bytes;
                self.tally.pairs = self.pairs;
            }
            Err(error) => tracing::error!("{error}"),
        }
    }

    fn give_up_on(&mut self, written: Result<(), WriteError>) {
        if let Err(error) = written {
            tracing::error!("{error}; the cell goes on");
            // Its end cannot be written either. Where none is open, the last one is counted already.
            if self.writer.take().is_some() {
                self.finished_bytes += std::fs::metadata(&self.tally.path).map_or(0, |about| about.len());
                self.tally.bytes = self.finished_bytes;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Condition;
    use crate::cell::pairing::{FrameSeen, Handle, Pair};
    use crate::frame::TimestampMark;

    #[test]
    fn a_recorder_that_hangs_keeps_nobody_waiting() {
        let (orders, _hanging) = bounded(1);
        let (_finished, written) = unbounded();
        let thread = std::thread::spawn(Tally::default);
        let (_spares, spare) = unbounded();
        let mut recorder = Recorder { orders, written, spare, thread, under_way: 0, lost: 0, bare: 0 };
        recorder.line(Level::Info, Timestamp(1), "one".into());
        let seen = |side| FrameSeen {
            handle: Handle(0),
            side,
            timestamp: Timestamp(1),
            mark: TimestampMark::HandedOver,
            sequence: 1,
            condition: Condition::Good,
            skipped: 0,
        };
        let pair = Pair { number: 1, left: seen(Side::Left), right: seen(Side::Right) };
        let outcome = Err(NoPick::Late);
        let report = PairReport { pair, at: Timestamp(2), outcome, deadline_kept: true };
        let back = recorder.pair("1".into(), String::new(), &report, Some(Box::default()));
        assert!(back.is_err(), "the file comes back");
        assert!(recorder.pair("1".into(), String::new(), &report, None).is_ok());
        assert!(recorder.lone(Side::Left, Frame::default()).is_err(), "the frame comes back");
        assert_eq!((recorder.lost, recorder.bare, recorder.under_way), (3, 1, 0));
    }

    #[test]
    fn the_bytes_of_a_full_file_are_counted_once_where_the_next_cannot_be_made() {
        let folder = tempfile::tempdir().unwrap();
        let settings = Recording {
            folder: folder.path().join("recordings"),
            pictures: KeptPictures::All,
            file_bytes_max: 1,
            when_full: WhenFull::NextFile,
        };
        let mut book = Book::begin(settings, About::default(), Vec::new()).unwrap();
        book.settings.folder = folder.path().join("recordings/none.mcap");
        std::fs::write(&book.settings.folder, "no folder").unwrap();
        book.full();
        let bytes = std::fs::metadata(&book.tally.path).unwrap().len();
        assert_eq!((book.tally.bytes, book.writer.is_some()), (bytes, false));
    }
}
