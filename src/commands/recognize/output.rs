//! Results as JSON and as text.

use std::fmt::Write as _;
use std::io::{self, Write};

use nalgebra::{UnitQuaternion, Vector3};
use serde::Serialize;

use crate::part::Part;
use crate::recognize::{FoundPart, Recognition, Seen, StageTimes, Turned};

/// One pair's result, as it is printed and written to results.json.
#[derive(Serialize)]
pub(in crate::commands) struct PairResult<'a> {
    #[serde(skip_serializing_if = "Option::is_none")]
    pair: Option<&'a str>,
    parts: Vec<PartResult<'a>>,
    no_pick: Option<String>,
    nodes_left: usize,
    nodes_right: usize,
    seed: u64,
    right_camera_turned: Option<TurnedResult>,
    stages_us: Stages,
}

/// See [`Turned`].
#[derive(Serialize)]
struct TurnedResult {
    rows_px: f64,
    rows_sigma_px: f64,
    rim_px: f64,
    rim_sigma_px: f64,
    along_px: f64,
    along_sigma_px: f64,
    allowed_for: bool,
    in_doubt: Option<String>,
    #[serde(skip)]
    words: String,
}

#[derive(Serialize)]
struct PartResult<'a> {
    part: &'a str,
    fitness: f64,
    nodes: Vec<NodeResult<'a>>,
    grasp: GraspResult,
    sigma_mm: [f64; 3],
    sigma_axis_deg: f64,
    blocked: Option<String>,
    iterations: u64,
}

#[derive(Serialize)]
struct NodeResult<'a> {
    name: &'a str,
    camera_mm: [f64; 3],
    left_px: [f64; 2],
    right_px: [f64; 2],
    seen: &'static str,
}

#[derive(Serialize)]
struct GraspResult {
    position_mm: [f64; 3],
    axis: [f64; 3],
    orientation_xyzw: [f64; 4],
    frame: &'static str,
    slid_mm: f64,
}

/// A bad pair of a folder.
#[derive(Serialize)]
pub(super) struct PairError<'a> {
    pub(super) pair: &'a str,
    pub(super) error: String,
}

/// Wall times of the stages, both pictures together.
#[derive(Serialize)]
struct Stages {
    decode: Time,
    binarize: Time,
    thin: Time,
    graph: Time,
    #[serde(rename = "match")]
    matching: Time,
    pose: Time,
    total: Time,
}

/// Microseconds: of one run, or of many.
#[derive(Serialize)]
#[serde(untagged)]
enum Time {
    One(f64),
    Many { p50: f64, p99: f64 },
}

impl Stages {
    /// `runs` is not empty.
    fn new(runs: &[StageTimes]) -> Self {
        Self {
            decode: Time::new(runs, |t| t.decode_ns),
            binarize: Time::new(runs, |t| t.binarize_ns),
            thin: Time::new(runs, |t| t.thin_ns),
            graph: Time::new(runs, |t| t.graph_ns),
            matching: Time::new(runs, |t| t.match_ns),
            pose: Time::new(runs, |t| t.pose_ns),
            total: Time::new(runs, |t| t.total_ns),
        }
    }

    fn named(&self) -> [(&'static str, &Time); 7] {
        [
            ("decode", &self.decode),
            ("binarize", &self.binarize),
            ("thin", &self.thin),
            ("graph", &self.graph),
            ("match", &self.matching),
            ("pose", &self.pose),
            ("total", &self.total),
        ]
    }
}

impl Time {
    fn new(runs: &[StageTimes], stage: impl Fn(&StageTimes) -> u64) -> Self {
        let mut sorted: Vec<u64> = runs.iter().map(stage).collect();
        sorted.sort_unstable();
        // nearest rank
        let rank = |share: f64| {
            let index = ((share * sorted.len() as f64).ceil() as usize).saturating_sub(1);
            sorted.get(index).map_or(0.0, |&ns| ns as f64 / 1000.0)
        };
        match runs.len() {
            1 => Time::One(rank(1.0)),
            _ => Time::Many { p50: rank(0.5), p99: rank(0.99) },
        }
    }
}

impl<'a> PairResult<'a> {
    /// `frame` is where grasps are given: `left` or `base`. `runs` holds the times of every repetition.
    pub(in crate::commands) fn new(
        pair: Option<&'a str>,
        found: &Recognition,
        parts: &'a [Part],
        frame: &'static str,
        runs: &[StageTimes],
    ) -> Self {
        let result = |f: &FoundPart| PartResult::new(f, &parts[f.part], frame);
        Self {
            pair,
            parts: found.parts.iter().map(result).collect(),
            no_pick: found.no_pick.map(|reason| reason.to_string()),
            nodes_left: found.nodes_left,
            nodes_right: found.nodes_right,
            seed: found.seed,
            right_camera_turned: found.turned.as_ref().map(TurnedResult::new),
            stages_us: Stages::new(runs),
        }
    }

    /// One line.
    pub(in crate::commands) fn to_json(&self) -> String {
        to_json(self)
    }

    /// A table for people.
    pub(super) fn write_text(&self, out: &mut impl Write) -> io::Result<()> {
        let pickable = self.parts.iter().filter(|p| p.blocked.is_none()).count();
        if let Some(pair) = self.pair {
            write!(out, "pair {pair}: ")?;
        }
        write!(out, "{} parts, {pickable} can be picked; ", self.parts.len())?;
        if let Some(reason) = &self.no_pick {
            write!(out, "no pick: {reason}; ")?;
        }
        writeln!(out, "{} and {} nodes, {}", self.nodes_left, self.nodes_right, self.times())?;
        if let Some(turned) =
            self.right_camera_turned.as_ref().filter(|t| t.allowed_for || t.in_doubt.is_some())
        {
            let allowed = turned.in_doubt.as_deref().unwrap_or("that is allowed for");
            writeln!(out, "{}; {allowed}; calibrate again", turned.words)?;
        }
        if !self.parts.is_empty() {
            let frame = self.parts[0].grasp.frame;
            let grasp = format!("grasp in mm, {frame} frame");
            writeln!(
                out,
                "   # {:<12} fitness  {grasp:<26} {:<22} {:<17} blocked",
                "part", "wire", "sigma mm"
            )?;
        }
        for (i, p) in self.parts.iter().enumerate() {
            let numbers = |values: &[f64], width: usize, digits: usize| {
                values.iter().fold(String::new(), |mut text, v| {
                    // writing to a String cannot fail
                    let _ = write!(text, "{v:>width$.digits$} ");
                    text
                })
            };
            writeln!(
                out,
                "{:>4} {:<12} {:>7.3}  {:<26} {:<22} {:<17} {}",
                i + 1,
                p.part,
                p.fitness,
                numbers(&p.grasp.position_mm, 8, 2),
                numbers(&p.grasp.axis, 6, 3),
                numbers(&p.sigma_mm, 4, 2),
                p.blocked.as_deref().unwrap_or("-")
            )?;
        }
        Ok(())
    }

    fn times(&self) -> String {
        let list = self.stages_us.named().map(|(name, time)| match time {
            Time::One(us) => format!("{name} {us:.0}"),
            Time::Many { p50, p99 } => format!("{name} {p50:.0}/{p99:.0}"),
        });
        let unit = if matches!(self.stages_us.total, Time::One(_)) { "us" } else { "us (p50/p99)" };
        format!("{} {unit}", list.join(", "))
    }
}

impl TurnedResult {
    fn new(turned: &Turned) -> Self {
        let Turned { rows_px, rows_sigma_px, rim_px, rim_sigma_px, along_px, along_sigma_px, .. } = *turned;
        let [rows_px, rows_sigma_px, rim_px, rim_sigma_px, along_px, along_sigma_px] =
            rounded([rows_px, rows_sigma_px, rim_px, rim_sigma_px, along_px, along_sigma_px], 1e4);
        let (allowed_for, in_doubt) = (turned.is_allowed_for(), turned.doubt.map(|doubt| doubt.to_string()));
        let words = turned.to_string();
        Self {
            rows_px,
            rows_sigma_px,
            rim_px,
            rim_sigma_px,
            along_px,
            along_sigma_px,
            allowed_for,
            in_doubt,
            words,
        }
    }
}

impl<'a> PartResult<'a> {
    fn new(found: &FoundPart, part: &'a Part, frame: &'static str) -> Self {
        let nodes = part.nodes.iter().zip(&found.nodes).map(|(node, found)| NodeResult {
            name: &node.name,
            camera_mm: rounded(found.left_mm.coords.into(), 1e5),
            left_px: rounded(found.left_px.into(), 1e5),
            right_px: rounded(found.right_px.into(), 1e5),
            seen: match found.seen {
                Seen::Both => "both",
                Seen::Left => "left",
                Seen::Right => "right",
                Seen::None => "none",
            },
        });
        Self {
            part: &part.name,
            fitness: round(found.fitness, 1e6),
            nodes: nodes.collect(),
            grasp: GraspResult {
                position_mm: rounded(found.grasp.position_mm.coords.into(), 1e5),
                axis: unit(&found.grasp.axis),
                orientation_xyzw: quaternion(&found.grasp.orientation),
                frame,
                slid_mm: round(found.grasp.slid_mm, 1e5),
            },
            sigma_mm: rounded(found.sigma_mm.into(), 1e5),
            sigma_axis_deg: round(found.sigma_axis_rad.to_degrees(), 1e5),
            blocked: found.blocked.map(|reason| reason.to_string()),
            iterations: found.iterations,
        }
    }
}

/// A hundredth of a micrometre and a hundred-thousandth of a pixel are far below what is measured.
fn rounded<const N: usize>(values: [f64; N], steps: f64) -> [f64; N] {
    values.map(|v| round(v, steps))
}

fn round(value: f64, steps: f64) -> f64 {
    (value * steps).round() / steps
}

fn unit(axis: &Vector3<f64>) -> [f64; 3] {
    rounded((*axis).into(), 1e9)
}

fn quaternion(q: &UnitQuaternion<f64>) -> [f64; 4] {
    rounded([q.i, q.j, q.k, q.w], 1e9)
}

/// One line of JSON. Our own types have nothing that JSON cannot hold; a number that is not finite becomes null.
pub(super) fn to_json(value: &impl Serialize) -> String {
    serde_json::to_string(value).unwrap_or_else(|e| format!("{{\"error\":\"{e}\"}}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_nearest_ranks() {
        let runs: Vec<StageTimes> =
            (1..=200).map(|i| StageTimes { total_ns: i * 1000, ..StageTimes::default() }).collect();
        let stages = Stages::new(&runs);
        assert!(matches!(stages.total, Time::Many { p50: 100.0, p99: 198.0 }));
        assert!(matches!(Stages::new(&runs[..1]).total, Time::One(1.0)));
    }

    #[test]
    fn an_empty_result_has_every_key() {
        let found = Recognition::default();
        let result = PairResult::new(None, &found, &[], "left", &[StageTimes::default()]);
        assert_eq!(
            result.to_json(),
            "{\"parts\":[],\"no_pick\":null,\"nodes_left\":0,\"nodes_right\":0,\"seed\":0,\"right_camera_turned\":null,\"stages_us\":{\"decode\":0.0,\
             \"binarize\":0.0,\"thin\":0.0,\"graph\":0.0,\"match\":0.0,\"pose\":0.0,\"total\":0.0}}"
        );
    }
}
