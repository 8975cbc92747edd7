//! The recording of a running cell, written in a thread of its own, so that lines, log and place records do not wait
//! for it.
//!
//! A recording that cannot be begun or cannot go on ends with a message; the cell goes on. What is handed over after
//! that comes back at once.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::thread::{Builder, JoinHandle};
use std::time::Duration;

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded, unbounded};
use std::sync::Arc;

use crate::camera::Side;
use crate::cell::core::{Event, NoPick, Note, PairReport, TargetEnd};
use crate::cell::desk::{File, Logged, Said};
use crate::config::{Cell, KeptPictures, Recording, WhenFull};
use crate::handover::Waker;
use crate::part::Part;
use crate::session::events::{
    CandidateRecord, CommandRecord, EventRecord, Level, PairRecord, ReportRecord, Topic,
};
use crate::session::{About, RecordingWriter, WriteError};
use crate::telemetry::Telemetry;
use crate::time::{Timestamp, utc_name, wall_from_cell_ns};

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
    pub(super) fn losses(&self, telemetry: &Telemetry) -> [(&'static str, u64); 2] {
        [
            ("pairs recorded without pictures", self.bare),
            ("events not recorded", self.lost + telemetry.unlogged()),
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
        let thread = Builder::new().name("record".into()).spawn(move || {
            let mut book = book;
            book.work(&ordered, &finished, &waker)
        })?;
        Ok(Some(Self { orders, written, thread, under_way: 0, lost: 0, bare: 0 }))
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

fn about(cell: &Cell, period: Duration) -> About {
    let mut files: Vec<PathBuf> = vec![cell.rig.calibration.clone()];
    files.extend(cell.recognition.parts.iter().cloned());
    let name = |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let read = |path: &PathBuf| std::fs::read(path).ok().map(|content| (name(path), content));
    let rate_hz = 1.0 / period.as_secs_f64().max(1e-9);
    let metadata = [
        ("version", env!("CARGO_PKG_VERSION").to_owned()),
        ("rate_hz", format!("{rate_hz:.6}")),
        ("deadline_ms", format!("{:.3}", cell.deadline(period).as_secs_f64() * 1e3)),
    ];
    About {
        wall_from_cell_ns: wall_from_cell_ns(),
        metadata: metadata
            .map(|(key, value)| (key.to_owned(), value))
            .into_iter()
            .collect::<BTreeMap<_, _>>(),
        files: [("cell.toml".to_owned(), cell.text.clone().into_bytes())]
            .into_iter()
            .chain(files.iter().filter_map(read))
            .collect(),
    }
}

/// What the core says about a pair.
fn record_of(report: &PairReport) -> PairRecord {
    let pair = &report.pair;
    PairRecord {
        stamps_ns: [pair.left.timestamp.0, pair.right.timestamp.0],
        sequences: [pair.left.sequence, pair.right.sequence],
        target: report.outcome.ok().map(|sent| sent.id),
        candidate: report.outcome.ok().map(|sent| sent.candidate),
        no_target: report.outcome.err().map(|why| why.to_string()),
        deadline_kept: report.deadline_kept,
        ..PairRecord::default()
    }
}

/// What the recogniser found in it.
fn add_recognition(record: &mut PairRecord, file: &File, names: &[String]) {
    let earliest = record.stamps_ns[0].min(record.stamps_ns[1]);
    record.time_ms = Some(file.finished.since(Timestamp(earliest)) as f64 / 1e6);
    record.error = file.refusal.as_ref().map(ToString::to_string);
    if file.refusal.is_some() {
        return;
    }
    let found = &file.recognition;
    record.seed = Some(found.seed);
    record.iterations = Some(found.iterations);
    record.parts = Some(found.parts.len());
    let free = found.parts.iter().filter(|part| part.blocked.is_none());
    record.candidates.extend(free.map(|part| {
        let rotation = part.grasp.orientation.quaternion();
        CandidateRecord {
            part: names.get(part.part).cloned().unwrap_or_default(),
            fitness: part.fitness,
            position_mm: part.grasp.position_mm.coords.into(),
            orientation_xyzw: [rotation.i, rotation.j, rotation.k, rotation.w],
            opening_mm: part.grasp.opening_mm,
        }
    }));
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
            flushed: now,
            synced: now,
        };
        book.next_file()?;
        Ok(book)
    }

    /// Begins a file named after the time, and lets go of those that are too many.
    fn next_file(&mut self) -> Result<(), WriteError> {
        let wall_ns = Timestamp::now().0.saturating_add(self.about.wall_from_cell_ns);
        let path = self.settings.folder.join(format!("{}.mcap", utc_name(wall_ns)));
        self.writer = Some(RecordingWriter::create(&path, &self.about)?);
        tracing::info!(file = %path.display(), "recording");
        self.tally.path.clone_from(&path);
        self.files.push(path);
        while self.files.len() > FILES_KEPT {
            // Whoever has moved or removed it meanwhile may have done so.
            let _ = std::fs::remove_file(self.files.remove(0));
        }
        Ok(())
    }

    fn work(&mut self, ordered: &Receiver<Order>, finished: &Sender<Written>, waker: &Waker) -> Tally {
        loop {
            let left_ns = (FLUSH_NS - Timestamp::now().since(self.flushed)).clamp(0, FLUSH_NS);
            let order = ordered.recv_timeout(Duration::from_nanos(left_ns as u64));
            let begun = Timestamp::now();
            let more = !matches!(order, Err(RecvTimeoutError::Disconnected));
            if let Ok(order) = order
                && let Some(written) = self.write(order)
                && finished.send(written).is_ok()
            {
                waker.wake();
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

    fn write(&mut self, order: Order) -> Option<Written> {
        match order {
            Order::Pair { mut record, at, mut file, caption } => {
                let written = self.pair(&mut record, at, file.as_deref_mut());
                self.give_up_on(written);
                file.map(|file| Written { name: record.name, caption, file })
            }
            Order::Logged(logged) => {
                let Logged { at, said } = *logged;
                let written = self.writer.as_mut().map_or(Ok(()), |writer| said_to(writer, at, said));
                self.give_up_on(written);
                None
            }
            Order::Line(level, at, line) => {
                let written = self.writer.as_mut().map_or(Ok(()), |writer| writer.line(level, at, &line));
                self.give_up_on(written);
                None
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
                self.tally.pairs += 1;
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
            Ok(bytes) => self.tally.bytes = self.finished_bytes + bytes,
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

/// A note as a line of the log; none for pairs, which have a topic of their own.
pub(super) fn line_of(note: &Note) -> Option<(Level, String)> {
    Some(match note {
        Note::Pair(_) => return None,
        Note::Sent { id, frame_to_wire_ns, deadline_kept } => {
            let kept = if *deadline_kept { "kept" } else { "missed" };
            let ms = *frame_to_wire_ns as f64 / 1e6;
            (Level::Info, format!("target {id} on the wire {ms:.2} ms after its frame, deadline {kept}"))
        }
        Note::Accepted { id } => (Level::Info, format!("target {id} accepted")),
        Note::Ended { id, end } => {
            let level = if *end == TargetEnd::Done { Level::Info } else { Level::Warning };
            (level, format!("target {id} {end}"))
        }
        Note::Alarm(alarm) => (Level::Warning, alarm.to_string()),
        Note::CameraBack { side } => (Level::Info, format!("{} camera delivers again", side.name())),
        Note::Connected { session } => (Level::Info, format!("arm connected, session {session}")),
        Note::Released => (Level::Info, "arm released".into()),
        Note::Ready => (Level::Info, "arm ready".into()),
        Note::SlotFilled { slot } => (Level::Info, format!("slot {slot} filled")),
    })
}

fn said_to(writer: &mut RecordingWriter, at: Timestamp, said: Said) -> Result<(), WriteError> {
    match said {
        Said::Event(Event::Arm(report)) => writer.record(Topic::Report, at, &ReportRecord { report }),
        Said::Event(event) => writer.record(Topic::Event, at, &EventRecord { event }),
        Said::Command(command, refused) => {
            writer.record(Topic::Command, at, &CommandRecord { command, refused })
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
        let mut recorder = Recorder { orders, written, thread, under_way: 0, lost: 0, bare: 0 };
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
        assert_eq!((recorder.lost, recorder.bare, recorder.under_way), (2, 1, 0));
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
