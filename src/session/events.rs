//! What a recording holds beside pictures: results of pairs, the arm's conversation, events, lines of the log.
//!
//! All of it is JSON with a JSON schema: small, and read by people and programs without this one. Times are the
//! messages' own; what stands inside as `…_ns` is wall time, ns since 1970.

use firmware_bridge::message::{Command, Refusal, Report};
use serde::{Deserialize, Serialize};

use crate::cell::core::Event;
use crate::frame::TimestampMark;

/// A topic of JSON messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(usize)]
pub enum Topic {
    /// [`PairRecord`].
    Pair,
    /// [`CommandRecord`].
    Command,
    /// [`ReportRecord`].
    Report,
    /// [`EventRecord`].
    Event,
    /// [`LogRecord`].
    Log,
}

impl Topic {
    /// All of them, in order.
    pub const ALL: [Topic; 5] = [Topic::Pair, Topic::Command, Topic::Report, Topic::Event, Topic::Log];

    /// As players list it.
    pub fn name(self) -> &'static str {
        match self {
            Topic::Pair => "/pair",
            Topic::Command => "/arm/command",
            Topic::Report => "/arm/report",
            Topic::Event => "/event",
            Topic::Log => "/log",
        }
    }

    /// Name of the schema.
    pub fn schema_name(self) -> &'static str {
        match self {
            Topic::Pair => "pickcell.Pair",
            Topic::Command => "pickcell.ArmCommand",
            Topic::Report => "pickcell.ArmReport",
            Topic::Event => "pickcell.Event",
            Topic::Log => "foxglove.Log",
        }
    }

    /// The schema, as JSON schema.
    pub fn schema(self) -> &'static str {
        match self {
            Topic::Pair => PAIR_SCHEMA,
            Topic::Command => {
                r#"{"title":"pickcell.ArmCommand","type":"object","properties":{"command":{},"refused":{}}}"#
            }
            Topic::Report => r#"{"title":"pickcell.ArmReport","type":"object","properties":{"report":{}}}"#,
            Topic::Event => r#"{"title":"pickcell.Event","type":"object","properties":{"event":{}}}"#,
            Topic::Log => LOG_SCHEMA,
        }
    }
}

const PAIR_SCHEMA: &str = r#"{"title":"pickcell.Pair","type":"object","properties":{
"number":{"type":"integer"},"name":{"type":"string"},
"stamps_ns":{"type":"array","items":{"type":"integer"}},"sequences":{"type":"array","items":{"type":"integer"}},
"marks":{"type":"array","items":{"type":"string"}},"pictures":{"type":"boolean"},"seed":{"type":"integer"},"iterations":{"type":"integer"},"out_of_time":{"type":"boolean"},
"looks":{"type":"integer"},"exchanges":{"type":"integer"},"late":{"type":"boolean"},"parts":{"type":"integer"},
"candidates":{"type":"array","items":{"type":"object","properties":{"part":{"type":"string"},
"fitness":{"type":"number"},"position_mm":{"type":"array","items":{"type":"number"}},
"orientation_xyzw":{"type":"array","items":{"type":"number"}},"opening_mm":{"type":"number"}}}},
"target":{"type":"integer"},"candidate":{"type":"integer"},"no_target":{"type":"string"},"error":{"type":"string"},
"time_ms":{"type":"number"},"deadline_kept":{"type":"boolean"}}}"#;

const LOG_SCHEMA: &str = r#"{"title":"foxglove.Log","type":"object","properties":{
"timestamp":{"type":"object","properties":{"sec":{"type":"integer"},"nsec":{"type":"integer"}}},
"level":{"type":"integer"},"message":{"type":"string"},"name":{"type":"string"},"file":{"type":"string"},
"line":{"type":"integer"}}}"#;

/// What became of a pair.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct PairRecord {
    /// Since the start of the cell, from 1.
    pub number: u64,
    /// As lines and pictures call it.
    pub name: String,
    /// When the light of the left and the right frame was seen, ns.
    pub stamps_ns: [i64; 2],
    /// The drivers' frame counters.
    pub sequences: [u32; 2],
    /// What moments of the exposures the stamps are.
    pub marks: [TimestampMark; 2],
    /// Whether its pictures are in the recording.
    pub pictures: bool,
    /// Seed of its search.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// Iterations that the search used up: the budget of a repetition.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub iterations: Option<u64>,
    /// Its time was over before the recognition was through.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub out_of_time: bool,
    /// Where its time was over while it looked at what the search had found.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub looks: Option<u64>,
    /// Where its time was over while parts were exchanged for others.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub exchanges: Option<u64>,
    /// Its time was over when the grasps were decided.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub late: bool,
    /// Parts recognised.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub parts: Option<usize>,
    /// Those that can be picked, best first.
    pub candidates: Vec<CandidateRecord>,
    /// The target it led to.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub target: Option<u64>,
    /// Which of the candidates that is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub candidate: Option<u8>,
    /// Why it led to none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub no_target: Option<String>,
    /// Why nothing could be looked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub error: Option<String>,
    /// From the older frame to the end of the recognition, ms.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub time_ms: Option<f64>,
    /// The result was there in time.
    pub deadline_kept: bool,
}

/// A part that can be picked.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct CandidateRecord {
    /// Name of its part file.
    pub part: String,
    /// Of its match.
    pub fitness: f64,
    /// Where to grasp, in the base frame (the left camera's where the base is not known).
    pub position_mm: [f64; 3],
    /// The tool there.
    pub orientation_xyzw: [f64; 4],
    /// Distance of the fingers at the approach.
    pub opening_mm: f64,
}

/// What was said to the arm.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CommandRecord {
    /// The command.
    pub command: Command,
    /// Why its side did not take it, if it did not.
    pub refused: Option<Refusal>,
}

/// What the arm said.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReportRecord {
    /// The report.
    pub report: Report,
}

/// What else happened to the core: cameras, place records, the operator.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EventRecord {
    /// The event.
    pub event: Event,
}

/// How loud a line of the log is, as Foxglove counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// All is well.
    Info = 2,
    /// Something is wrong.
    Warning = 3,
}

/// A line of the log, `foxglove.Log`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LogRecord {
    /// When.
    pub timestamp: LogTime,
    /// See [`Level`].
    pub level: u8,
    /// The line.
    pub message: String,
    /// Who says it.
    pub name: String,
    /// Empty.
    pub file: String,
    /// 0.
    pub line: u32,
}

/// A time as Foxglove's JSON has it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LogTime {
    /// Seconds since 1970.
    pub sec: i64,
    /// And ns.
    pub nsec: u32,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn schemas_are_json_and_topics_have_their_own_places() {
        for (i, topic) in Topic::ALL.into_iter().enumerate() {
            assert_eq!(topic as usize, i);
            let schema: serde_json::Value = serde_json::from_str(topic.schema()).unwrap();
            assert_eq!(schema["title"], topic.schema_name());
        }
    }

    #[test]
    fn what_the_arm_says_comes_back_from_json() {
        for report in
            [Report::ClearOfView, Report::Failed { id: 7, failure: firmware_bridge::message::Failure::Held }]
        {
            let text = serde_json::to_string(&ReportRecord { report }).unwrap();
            assert_eq!(serde_json::from_str::<ReportRecord>(&text).unwrap().report, report);
        }
        let record = PairRecord { number: 3, target: Some(9), ..Default::default() };
        let text = serde_json::to_string(&record).unwrap();
        assert!(!text.contains("no_target"), "{text}");
        assert_eq!(serde_json::from_str::<PairRecord>(&text).unwrap(), record);
    }
}
