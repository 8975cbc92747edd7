//! What stands in the recording of a run: made of what the cell, its core and its recogniser say.

use std::collections::BTreeMap;
use std::time::Duration;

use crate::cell::core::{Event, Note, PairReport, TargetEnd};
use crate::cell::desk::{File, Said};
use crate::config::Cell;
use crate::rig::Rig;
use crate::session::events::{
    CandidateRecord, CommandRecord, EventRecord, Level, PairRecord, ReportRecord, Topic,
};
use crate::session::{About, PAIR_WINDOW, RecordingWriter, WriteError};
use crate::time::{Spent, Timestamp, wall_from_cell_ns};

/// What stands in front of it.
pub(super) fn about(cell: &Cell, period: Duration) -> About {
    let mut paths = Rig::files(&cell.rig.calibration).unwrap_or_default();
    paths.extend(cell.recognition.parts.iter().cloned());
    let mut files = vec![("cell.toml".to_owned(), cell.text.clone().into_bytes())];
    for path in paths {
        let Ok(content) = std::fs::read(&path) else { continue };
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        // Two may have one name, in two folders.
        let is_taken = files.iter().any(|(taken, _)| *taken == name);
        files.push((if is_taken { path.display().to_string() } else { name }, content));
    }
    let rate_hz = 1.0 / period.as_secs_f64().max(1e-9);
    let metadata = [
        ("version", env!("CARGO_PKG_VERSION").to_owned()),
        ("rate_hz", format!("{rate_hz:.6}")),
        ("deadline_ms", format!("{:.3}", cell.deadline(period).as_secs_f64() * 1e3)),
        (PAIR_WINDOW, format!("{:.6}", cell.cameras.pair_window(period).as_secs_f64() * 1e3)),
    ];
    About {
        wall_from_cell_ns: wall_from_cell_ns(),
        metadata: metadata
            .map(|(key, value)| (key.to_owned(), value))
            .into_iter()
            .collect::<BTreeMap<_, _>>(),
        files,
    }
}

/// What the core says about a pair.
pub(super) fn record_of(report: &PairReport) -> PairRecord {
    let pair = &report.pair;
    PairRecord {
        stamps_ns: [pair.left.timestamp.0, pair.right.timestamp.0],
        sequences: [pair.left.sequence, pair.right.sequence],
        marks: [pair.left.mark, pair.right.mark],
        target: report.outcome.ok().map(|sent| sent.id),
        candidate: report.outcome.ok().map(|sent| sent.candidate),
        no_target: report.outcome.err().map(|why| why.to_string()),
        deadline_kept: report.deadline_kept,
        ..PairRecord::default()
    }
}

/// What the recogniser found in it.
pub(super) fn add_recognition(record: &mut PairRecord, file: &File, names: &[String]) {
    let earliest = record.stamps_ns[0].min(record.stamps_ns[1]);
    record.time_ms = Some(file.finished.since(Timestamp(earliest)) as f64 / 1e6);
    record.error = file.refusal.as_ref().map(ToString::to_string);
    if file.refusal.is_some() {
        return;
    }
    let found = &file.recognition;
    record.seed = Some(found.seed);
    let Spent { iterations, looks, exchanges, late } = found.spent;
    record.iterations = Some(iterations);
    (record.looks, record.exchanges, record.late) = (looks, exchanges, late);
    record.out_of_time = found.out_of_time;
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

pub(super) fn said_to(writer: &mut RecordingWriter, at: Timestamp, said: Said) -> Result<(), WriteError> {
    match said {
        Said::Event(Event::Arm(report)) => writer.record(Topic::Report, at, &ReportRecord { report }),
        Said::Event(event) => writer.record(Topic::Event, at, &EventRecord { event }),
        Said::Command(command, refused) => {
            writer.record(Topic::Command, at, &CommandRecord { command, refused })
        }
    }
}
