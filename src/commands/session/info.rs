//! `pickcell session info`: what is in a recorded session.

use crate::camera::replay::is_only_of;
use std::fmt::Write;
use std::path::Path;

use firmware_bridge::link::What;
use firmware_bridge::message::{Command, Report};
use serde_json::{Value, json};

use super::Format;
use crate::camera::Side;
use crate::cell::core::TargetEnd;
use crate::frame::Frame;
use crate::session::foxglove::encoding_name;
use crate::session::{Session, SessionError};

/// Reads the session; gives what to print.
///
/// # Errors
/// It cannot be read.
pub(super) fn run(path: &Path, format: Format) -> Result<String, SessionError> {
    let session = Session::open(path)?;
    let info = Info::new(&session)?;
    Ok(match format {
        Format::Text => info.text(&session),
        Format::Json => info.json(&session).to_string() + "\n",
    })
}

/// A target and what became of it.
struct Target {
    id: u64,
    end: Option<TargetEnd>,
    took_s: f64,
}

struct Info {
    whole: usize,
    lone: [usize; 2],
    duration_s: f64,
    formats: [Option<String>; 2],
    targets: Vec<Target>,
}

impl Info {
    fn new(session: &Session) -> Result<Self, SessionError> {
        let has = |side: Side, pair: &crate::session::RecordedPair| pair.pictures[side.index()].is_some();
        let lone = |side: Side| {
            let other = Side::BOTH[1 - side.index()];
            session.pairs.iter().filter(|pair| has(side, pair) && !has(other, pair)).count()
        };
        let lone = Side::BOTH.map(lone);
        let mut formats = [None, None];
        for (side, format) in formats.iter_mut().enumerate() {
            for picture in session.pairs.iter().filter_map(|pair| pair.pictures[side].as_ref()) {
                match picture.read() {
                    // It came damaged from its camera.
                    Err(error) if is_only_of(picture, &error) => continue,
                    read => *format = Some(format_of(&read?)),
                }
                break;
            }
        }
        let last_ns = session.pairs.last().map_or(0, |pair| pair.after_ns);
        Ok(Self {
            whole: session.whole_pairs(),
            lone,
            duration_s: last_ns as f64 / 1e9,
            formats,
            targets: targets(session),
        })
    }

    fn text(&self, session: &Session) -> String {
        let mut text = String::new();
        let mut row = |name: &str, value: String| {
            let _ = writeln!(text, "{name:<28} {value}");
        };
        row("session", session.path.display().to_string());
        if let Some(byte) = session.broken_at {
            row("end", format!("missing: it breaks off at byte {byte}"));
        }
        row("pairs", self.whole.to_string());
        for (side, lone) in Side::BOTH.into_iter().zip(self.lone).filter(|&(_, lone)| lone > 0) {
            row(&format!("{} pictures alone", side.name()), lone.to_string());
        }
        row("rate", format!("{:.3} a second", session.rate_hz));
        row("duration", format!("{:.3} s", self.duration_s));
        for (side, format) in Side::BOTH.into_iter().zip(&self.formats) {
            row(side.name(), format.clone().unwrap_or_else(|| "no picture".into()));
        }
        let results = &session.results;
        if results.pairs > 0 {
            row("results", results.pairs.to_string());
            row("  without pictures", results.without_pictures.to_string());
            row("  deadline misses", results.deadline_misses.to_string());
            row("  with a target", results.targets.to_string());
            results.no_target.iter().for_each(|(why, n)| row(&format!("  no target: {why}"), n.to_string()));
            let [left, right] = results.frames_missing;
            row("frames missing", format!("{left} left, {right} right"));
        }
        if session.arm.is_empty() {
            row("arm", "nothing recorded; a replay has the simulated one".into());
        } else {
            row("targets of the arm", self.targets.len().to_string());
        }
        for target in &self.targets {
            row(&format!("  {}", target.id), format!("{} ({:.3} s)", target.outcome(), target.took_s));
        }
        text
    }

    fn json(&self, session: &Session) -> Value {
        let results = &session.results;
        let target = |target: &Target| json!({ "id": target.id, "outcome": target.outcome(), "seconds": target.took_s });
        json!({
            "session": session.path,
            "broken_at_byte": session.broken_at,
            "pairs": self.whole,
            "alone": { "left": self.lone[0], "right": self.lone[1] },
            "rate_hz": session.rate_hz,
            "duration_s": self.duration_s,
            "formats": { "left": self.formats[0], "right": self.formats[1] },
            "results": (results.pairs > 0).then(|| json!({
                "pairs": results.pairs,
                "without_pictures": results.without_pictures,
                "deadline_misses": results.deadline_misses,
                "targets": results.targets,
                "no_target": results.no_target,
                "frames_missing": { "left": results.frames_missing[0], "right": results.frames_missing[1] },
            })),
            "targets": (!session.arm.is_empty()).then(|| self.targets.iter().map(target).collect::<Vec<_>>()),
        })
    }
}

impl Target {
    fn outcome(&self) -> String {
        self.end.as_ref().map_or_else(|| "not ended in the recording".into(), ToString::to_string)
    }
}

fn format_of(frame: &Frame) -> String {
    format!("{} {}x{}", encoding_name(frame.format).unwrap_or("jpeg"), frame.width, frame.height)
}

/// The targets of a conversation in their order.
fn targets(session: &Session) -> Vec<Target> {
    let mut targets: Vec<(i64, Target)> = Vec::new();
    for said in &session.arm {
        let (id, end) = match said.what {
            What::Command(Command::Pick(pick)) => {
                targets.push((said.at_ns, Target { id: pick.id, end: None, took_s: 0.0 }));
                continue;
            }
            What::Report(Report::Done { id }) => (id, TargetEnd::Done),
            What::Report(Report::Failed { id, failure }) => (id, TargetEnd::Failed(failure)),
            What::Report(Report::Refused { id, refusal }) => (id, TargetEnd::Refused(refusal)),
            What::Report(Report::Lost { id }) => (id, TargetEnd::Lost),
            _ => continue,
        };
        if let Some((since_ns, target)) = targets.last_mut()
            && target.id == id
        {
            target.end = Some(end);
            target.took_s = said.at_ns.saturating_sub(*since_ns) as f64 / 1e9;
        }
    }
    targets.into_iter().map(|(_, target)| target).collect()
}

#[cfg(test)]
mod tests {
    use firmware_bridge::link::Said;
    use firmware_bridge::message::Failure;

    use super::*;

    #[test]
    fn a_folder_is_told_in_words_and_as_json() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("replay/conveyor");
        let session = Session::open(&path).unwrap();
        let info = Info::new(&session).unwrap();
        let text = info.text(&session);
        let lines: Vec<_> =
            text.lines().map(|line| line.split_whitespace().collect::<Vec<_>>().join(" ")).collect();
        for line in ["pairs 20", "rate 30.000 a second", "duration 0.633 s", "left jpeg 640x480"] {
            assert!(lines.iter().any(|l| l == line), "{line:?} in\n{text}");
        }
        assert!(text.contains("nothing recorded; a replay has the simulated one"));
        let json = info.json(&session);
        assert_eq!((json["pairs"].as_u64(), &json["targets"]), (Some(20), &Value::Null));
    }

    #[test]
    fn targets_are_told_with_their_ends() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("replay/conveyor");
        let mut session = Session::open(&path).unwrap();
        let pick = |id: u64| {
            let pose = json!({ "position_mm": [0.0, 0.0, 0.0], "orientation_xyzw": [1.0, 0.0, 0.0, 0.0] });
            let pick = json!({
                "id": id, "session": 1, "sequence": id, "deadline_ms": 66, "ttl_ms": 500,
                "seen": { "left_ns": 0, "right_ns": 0, "period_ns": 0 }, "recognised_mm": [0.0, 0.0, 0.0],
                "approach": pose, "grasp": pose, "retreat": pose, "place": pose, "opening_mm": 8.0, "slot": 0,
            });
            What::Command(Command::Pick(serde_json::from_value(pick).unwrap()))
        };
        let failed = What::Report(Report::Failed { id: 1, failure: Failure::PartNotHeld });
        session.arm = [(0, pick(1)), (500_000_000, failed), (900_000_000, pick(2))]
            .map(|(at_ns, what)| Said { at_ns, what })
            .to_vec();
        let text = Info::new(&session).unwrap().text(&session);
        assert!(text.contains("failed: the part was not held (0.500 s)"), "{text}");
        assert!(text.contains("not ended in the recording"), "{text}");
    }
}
