//! The slow work beside a running cell: lines, overlay pictures, log, place record, the table at the end.

use std::io::{self, IsTerminal, Write};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use firmware_bridge::outside::has_room;
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;

use super::args::{Format, Lines, Overlays, RunArgs};
use super::calibration::Calibration;
use super::entries::line_of;
use super::paint::{Painter, Studio};
use super::record::Recorder;
use super::standing::{self, Standing};
use super::summary::{self, Endurance};
use super::{RunError, place};
use crate::camera::Side;
use crate::cell::core::{Note, PairReport, TargetEnd};
use crate::cell::desk::{ColdSeat, Desk, File, Letter, Paper};
use crate::cell::notify;
use crate::cell::realtime::resident_bytes;
use crate::cell::threads::Controls;
use crate::config::{Backend, Cell, Pace};
use crate::frame::Frame;
use crate::part::Part;
use crate::recognize::FoundPart;
use crate::rig::Rig;
use crate::time::Timestamp;

/// systemd is told new counts so often, and other news at most so often, ns.
const STATUS_NS: i64 = 2_000_000_000;
const CHANGED_STATUS_NS: i64 = 200_000_000;
/// How long the table at the end waits for somebody to take it.
const LAST_WORDS: Duration = Duration::from_secs(2);
/// How often one that waits for a reader looks whether it is to end.
const ROOM_PAUSE: Duration = Duration::from_millis(100);

/// Everything that the cold thread has to do with.
pub(super) struct Cold {
    desk: Arc<Desk>,
    seat: ColdSeat,
    format: Format,
    lines: Lines,
    bar: ProgressBar,
    recorder: Option<Recorder>,
    studio: Option<Studio>,
    /// Pairs that may be with the recorder while the next one is recognised.
    unwritten_max: usize,
    /// Pairs that may be with the painter while the next one is recognised.
    undrawn_max: usize,
    parts: Vec<Part>,
    names: Vec<String>,
    state_file: Option<PathBuf>,
    /// Why it could not be written, as it was said.
    unwritten: Option<String>,
    deadline_ns: i64,
    endurance: Option<Endurance>,
    /// Parts found, by model.
    found: Vec<u64>,
    /// Pairs that took longer than the deadline by the wall clock, also where the session's own time stood still.
    slow: u64,
    calibration: Calibration,
    pairs: u64,
    standing: Standing,
    /// What systemd was told last, and when.
    status: (String, Timestamp),
    failed: Option<RunError>,
    /// Why no more overlay pictures are drawn.
    undrawn: Option<RunError>,
    controls: Arc<Controls>,
    /// A session on its own time leaves no line out.
    waits_for_readers: bool,
}

impl Cold {
    pub(super) fn new(
        args: &RunArgs,
        cell: &Cell,
        (desk, controls, seat): (Arc<Desk>, Arc<Controls>, ColdSeat),
        rig: &Rig,
        parts: Vec<Part>,
        names: Vec<String>,
        period: Duration,
    ) -> Result<Self, RunError> {
        let replayed = cell.cameras.backend == Backend::Replay;
        let fast = replayed && cell.cameras.pace == Pace::Fast;
        let draw = args.soak.is_none() && args.overlay.map_or(replayed, |overlay| overlay == Overlays::All);
        let studio = match draw {
            true => {
                let painter = Painter::new(args.out.clone(), cell.recognition_params(), *rig, parts.clone())?;
                let waker = Arc::clone(&desk.papers_waker);
                Some(Studio::open(painter, waker).map_err(RunError::System)?)
            }
            false => None,
        };
        let waker = Arc::clone(&desk.papers_waker);
        let recorder = Recorder::open(cell, &parts, period, waker).map_err(RunError::System)?;
        let total = args.soak.unwrap_or(names.len() as u64);
        Ok(Self {
            format: args.format,
            lines: if args.soak.is_some() { Lines::None } else { args.lines },
            bar: progress_bar(total, args.format),
            recorder,
            studio,
            unwritten_max: if fast { 0 } else { usize::MAX },
            // A session on its own time leaves no picture out: it waits for the painter.
            undrawn_max: if fast { 1 } else { usize::MAX },
            found: vec![0; parts.len()],
            parts,
            names,
            state_file: cell.place.as_ref().map(|place| place.state.clone()),
            unwritten: None,
            deadline_ns: i64::try_from(cell.deadline(period).as_nanos()).unwrap_or(i64::MAX),
            endurance: args.soak.map(Endurance::new),
            slow: 0,
            calibration: Calibration::default(),
            pairs: 0,
            standing: Standing::default(),
            status: (String::new(), Timestamp::default()),
            failed: None,
            undrawn: None,
            controls,
            waits_for_readers: fast,
            desk,
            seat,
        })
    }

    /// Works off all papers that wait, and before each whatever has to be on the disk.
    pub(super) fn work(&mut self) {
        loop {
            self.write_records();
            self.record_log();
            self.fetch_written();
            self.fetch_drawn();
            match self.seat.papers.pop() {
                Ok(Paper::Note(note, at)) => self.note(&note, at),
                Ok(Paper::Pair(report, file)) => self.pair(&report, file),
                Ok(Paper::Lone(side, frame)) => self.lone(side, frame),
                Err(_) => break,
            }
        }
        self.tell_status();
    }

    fn write_records(&mut self) {
        while let Ok(record) = self.seat.records.pop() {
            let written = self.state_file.as_ref().map_or(Ok(()), |path| place::write(path, &record));
            self.tell_unwritten(written.as_ref().err().map(ToString::to_string));
            self.seat.outbox.send(Letter::Persisted(record, written.is_ok()));
        }
    }

    /// Says why the record cannot be written: once, until something else is in the way.
    fn tell_unwritten(&mut self, reason: Option<String>) {
        if let (Some(reason), Some(path)) = (&reason, &self.state_file)
            && self.unwritten.as_ref() != Some(reason)
        {
            let path = path.display();
            self.log(|| tracing::error!("{path}: cannot write the place record: {reason}; make room, or give the cell's user the right"));
        }
        self.unwritten = reason;
    }

    fn record_log(&mut self) {
        while let Ok(logged) = self.seat.log.pop() {
            if let Some(recorder) = &mut self.recorder {
                recorder.logged(logged);
            }
        }
    }

    fn fetch_written(&mut self) {
        while let Some(written) = self.recorder.as_mut().and_then(|r| r.written(self.unwritten_max)) {
            self.order_picture(written.name, written.caption, written.file);
        }
        while let Some((side, frame)) = self.recorder.as_mut().and_then(Recorder::spare) {
            self.seat.outbox.send(Letter::Spare(side, frame));
        }
    }

    fn lone(&mut self, side: Side, frame: Frame) {
        let back = match &mut self.recorder {
            Some(recorder) => recorder.lone(side, frame).err(),
            None => Some(frame),
        };
        if let Some(frame) = back {
            self.seat.outbox.send(Letter::Spare(side, frame));
        }
    }

    fn fetch_drawn(&mut self) {
        while let Some((file, result)) = self.studio.as_mut().and_then(|s| s.drawn(self.undrawn_max)) {
            self.seat.outbox.send(Letter::Filed(file));
            if let (Err(reason), None) = (result, &self.undrawn) {
                self.log(|| tracing::error!("{reason}; the cell goes on without overlay pictures"));
                self.undrawn = Some(reason);
            }
        }
    }

    fn tell_status(&mut self) {
        let telemetry = &self.desk.telemetry;
        let words = self.standing.words(telemetry.state());
        let (told, at) = &self.status;
        let now = Timestamp::now();
        let pause_ns = if *told == words { STATUS_NS } else { CHANGED_STATUS_NS };
        if now.since(*at) >= pause_ns {
            notify::status(&format!("{words} | {}", standing::counts(telemetry)));
            self.status = (words, now);
        }
    }

    fn note(&mut self, note: &Note, at: Timestamp) {
        self.standing.hear(note);
        if let (Some(recorder), Some((level, line))) = (&mut self.recorder, line_of(note)) {
            recorder.line(level, at, line);
        }
        // A soak would say so some hundred thousand times; its table counts them.
        let routine = matches!(
            note,
            Note::Sent { .. }
                | Note::Accepted { .. }
                | Note::Ready
                | Note::Ended { end: TargetEnd::Done, .. }
        );
        if routine && self.endurance.is_some() {
            return;
        }
        let at_ms = at.0 / 1_000_000;
        match *note {
            Note::Pair(_) => {}
            Note::Sent { id, frame_to_wire_ns, deadline_kept } => {
                let frame_to_wire_ms = frame_to_wire_ns as f64 / 1e6;
                self.log(|| tracing::info!(id, frame_to_wire_ms, deadline_kept, at_ms, "target on the wire"));
            }
            Note::Accepted { id } => self.log(|| tracing::info!(id, at_ms, "target accepted")),
            Note::Ended { id, end: end @ TargetEnd::Done } => {
                self.log(|| tracing::info!(id, at_ms, "target {end}"));
            }
            Note::Ended { id, end } => self.log(|| tracing::warn!(id, at_ms, "target {end}")),
            Note::Alarm(alarm) => self.log(|| tracing::warn!(at_ms, "{alarm}")),
            Note::CameraBack { side } => {
                self.log(|| tracing::info!(at_ms, "{} camera delivers again", side.name()));
            }
            Note::Connected { session } => self.log(|| tracing::info!(session, at_ms, "arm connected")),
            Note::Released => self.log(|| tracing::info!(at_ms, "arm released")),
            Note::Ready => self.log(|| tracing::info!(at_ms, "arm ready")),
            Note::SlotFilled { slot } => self.log(|| tracing::info!(slot, at_ms, "slot filled")),
        }
    }

    fn pair(&mut self, report: &PairReport, file: Option<Box<File>>) {
        self.pairs += 1;
        if has_room(io::stderr(), Duration::ZERO) {
            self.bar.set_position(self.pairs);
        }
        let mut kept = report.deadline_kept;
        if let Some(file) = &file {
            kept &= file.finished.since(report.pair.earliest()) <= self.deadline_ns;
            self.slow += u64::from(!kept && report.deadline_kept);
            for part in &file.recognition.parts {
                self.found[part.part] += 1;
            }
            if let Some(words) = file.recognition.turned.and_then(|turned| self.calibration.pair(&turned)) {
                self.log(|| tracing::warn!("{words}"));
            }
        }
        let is_news = self.standing.pair(report.outcome);
        if let Some(endurance) = &mut self.endurance {
            endurance.pair(self.pairs, resident_bytes);
        }
        if self.lines == Lines::All || self.lines == Lines::Changes && is_news {
            self.tell_pair(report, file.as_deref(), kept);
        }
        let name = self.name(report);
        let caption = match &report.outcome {
            Ok(sent) => format!("target {}", sent.id),
            Err(why) => format!("no target: {why}"),
        };
        let back = match &mut self.recorder {
            Some(recorder) => recorder.pair(name.clone(), caption.clone(), report, file).err(),
            None => file,
        };
        if let Some(file) = back {
            self.order_picture(name, caption, file);
        }
    }

    fn name(&self, report: &PairReport) -> String {
        let sequence = report.pair.left.sequence as usize;
        match self.names.get(sequence % self.names.len().max(1)) {
            Some(name) => name.clone(),
            None => format!("{:06}", report.pair.number),
        }
    }

    fn tell_pair(&mut self, report: &PairReport, file: Option<&File>, kept: bool) {
        let name = self.name(report);
        let line = match self.format {
            Format::Text => self.text_line(&name, report, file, kept),
            Format::Json => self.json_line(&name, report, file, kept),
        };
        self.print(&line, Duration::ZERO);
    }

    fn text_line(&self, name: &str, report: &PairReport, file: Option<&File>, kept: bool) -> String {
        let mut line = format!("pair {name}  ");
        match file {
            None => line += "not recognised",
            Some(File { refusal: Some(refusal), .. }) => line += &refusal.to_string(),
            Some(File { recognition, .. }) => {
                let free = recognition.parts.iter().filter(|part| part.blocked.is_none()).count();
                line += &format!("{:2} parts, {free:2} free", recognition.parts.len());
                if let Some(best) = chosen(report, &recognition.parts) {
                    let [x, y, z] = best.grasp.position_mm.coords.into();
                    let (name, fitness) = (&self.parts[best.part].name, best.fitness);
                    line += &format!("  {name} fitness {fitness:.3} grasp ({x:.1}, {y:.1}, {z:.1}) mm");
                }
            }
        }
        if let Some(file) = file {
            let ms = file.finished.since(report.pair.earliest()) as f64 / 1e6;
            line += &format!("  {ms:.2} ms, deadline {}", if kept { "kept" } else { "missed" });
        }
        match &report.outcome {
            Ok(sent) => line + &format!("  target {} sent", sent.id),
            Err(why) => line + &format!("  no target: {why}"),
        }
    }

    fn json_line(&self, name: &str, report: &PairReport, file: Option<&File>, kept: bool) -> String {
        let found = file.filter(|file| file.refusal.is_none()).map(|file| &file.recognition);
        let grasp = found.and_then(|found| chosen(report, &found.parts)).map(|best| {
            let p = best.grasp.position_mm;
            json!({ "part": self.parts[best.part].name, "fitness": best.fitness, "position_mm": [p.x, p.y, p.z] })
        });
        json!({
            "pair": name,
            "parts": found.map(|found| found.parts.len()),
            "free": found.map(|found| found.parts.iter().filter(|part| part.blocked.is_none()).count()),
            "grasp": grasp,
            "time_ms": file.map(|file| file.finished.since(report.pair.earliest()) as f64 / 1e6),
            "deadline_kept": kept,
            "target": report.outcome.as_ref().ok().map(|sent| sent.id),
            "no_target": report.outcome.as_ref().err().map(ToString::to_string),
            "error": file.and_then(|file| file.refusal.as_ref()).map(ToString::to_string),
        })
        .to_string()
    }

    /// Has the pair drawn, or gives its file back.
    fn order_picture(&mut self, name: String, caption: String, file: Box<File>) {
        let back = match &mut self.studio {
            Some(studio) if self.undrawn.is_none() => studio.order(name, caption, file).err(),
            _ => Some(file),
        };
        if let Some(file) = back {
            self.seat.outbox.send(Letter::Filed(file));
        }
    }

    /// Prints a line of the results; the first failure is kept for the end. A running cell leaves out lines that
    /// nobody takes (a paused terminal, a reader that stands still): they must not hold up the place records. One on its own
    /// time waits for readers until it is to end.
    fn print(&mut self, line: &str, within: Duration) {
        let waits_on = || self.waits_for_readers && !self.controls.is_stopped();
        let mut has_room_now = has_room(io::stdout(), within);
        while !has_room_now && waits_on() {
            has_room_now = has_room(io::stdout(), ROOM_PAUSE);
        }
        if !has_room_now {
            self.desk.telemetry.add_unshown();
        } else if self.failed.is_none() {
            let result = self.bar.suspend(|| writeln!(io::stdout().lock(), "{line}"));
            self.failed = result.err().map(RunError::Stdout);
        }
    }

    fn log(&self, say: impl FnOnce()) {
        if has_room(io::stderr(), Duration::ZERO) {
            self.bar.suspend(say);
        }
    }

    /// The table, and what went wrong, if anything did; that nobody reads the results any more, only where nothing else did.
    pub(super) fn finish(mut self) -> Result<(), RunError> {
        self.bar.finish_and_clear();
        self.unwritten_max = 0;
        self.record_log();
        self.fetch_written();
        let recorded = self.recorder.take().map(Recorder::close);
        let drawn = self.studio.take().map_or(Ok(()), Studio::close);
        let found: Vec<_> =
            self.parts.iter().map(|part| part.name.as_str()).zip(self.found.clone()).collect();
        let telemetry = &self.desk.telemetry;
        let table = match self.format {
            Format::Text => summary::text(telemetry, &found, self.slow, &self.calibration, recorded.as_ref()),
            Format::Json => {
                summary::json(telemetry, &found, self.slow, &self.calibration, recorded.as_ref()).to_string()
            }
        };
        let verdict = self
            .endurance
            .take()
            .map_or(Ok(String::new()), |endurance| endurance.verdict(telemetry).map(|line| line + "\n"));
        self.print(&table, LAST_WORDS);
        if let (Ok(line), Format::Text) = (&verdict, self.format)
            && !line.is_empty()
        {
            self.print(line.trim_end(), LAST_WORDS);
        }
        let (closed, failed) = match self.failed.take() {
            Some(failed) if failed.is_closed_pipe() => (Some(failed), None),
            failed => (None, failed),
        };
        let soaked = verdict.map_err(RunError::Soak);
        let failed = failed.or(self.undrawn.take()).or(drawn.err()).or(soaked.err()).or(closed);
        failed.map_or(Ok(()), Err)
    }
}

/// The part that the target is about; without one the best.
fn chosen<'a>(report: &PairReport, parts: &'a [FoundPart]) -> Option<&'a FoundPart> {
    let index = report.outcome.as_ref().map_or(0, |sent| usize::from(sent.candidate));
    parts.iter().filter(|part| part.blocked.is_none()).nth(index).or(parts.first())
}

fn progress_bar(total: u64, format: Format) -> ProgressBar {
    if format == Format::Json || !io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let bar = if total > 0 { ProgressBar::new(total) } else { ProgressBar::new_spinner() };
    let style = ProgressStyle::with_template("{elapsed_precise} {wide_bar} {pos}/{len} pairs");
    bar.with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}
