//! `[arm.moves]`: the lines of a pick as templates, checked when the program starts.
//!
//! Takes checked settings; gives a [`Program`] that fills lines with the numbers of a pick, without allocating; owns
//! what a list must hold. A list that is left out is the dialect's own. Everything is refused here that the gate
//! could not check later: unknown names, inches, relative moves, shifted coordinates, curves, macros, settings,
//! lines that are not understood.
//!
//! ```
//! use firmware_bridge::config::Settings;
//! let settings = Settings::parse(r#"
//! [arm]
//! dialect = "grbl"
//! axes = "xyz"
//! [arm.moves]
//! pick = ["G0 X{grasp_x} Y{grasp_y}", "G91"]
//! [workspace]
//! min_mm = [-200, -200, 0]
//! max_mm = [200, 200, 300]
//! "#);
//! assert_eq!(settings.unwrap_err().to_string(), "line 6: arm.moves.pick, line 2, \"G91\": G91 makes moves relative: PickCell's G-code is \
//!     absolute, write G0 or G1 with the coordinates");
//! ```

use super::defaults;
use super::line::LineBuf;
use super::values::{self, Slot, Tool};
use super::words::{self, Kind, LineFault, Token, Value};
use crate::config::{DialectName, Settings};
use crate::gate::Gate;
use crate::message::{ArmAxes, Pick, Waypoint};

/// Most lines in one list.
const LINES_MAX: usize = 64;
/// Most words behind a command.
const WORDS_MAX: usize = 7;
/// Longest wait in one line, ms.
const DWELL_MAX_MS: u32 = 60_000;
/// The entry of `arm.moves.pick` at which the arm is asked whether it holds a part.
const HELD_ENTRY: &str = "held?";

/// What is wrong with `[arm.moves]`.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TemplateError {
    /// A line.
    #[error("arm.moves.{list}, line {line}, {text:?}: {fault}")]
    Line {
        /// Which list.
        list: &'static str,
        /// Which line, counted from 1.
        line: usize,
        /// The line as written.
        text: String,
        /// What is wrong and what to do.
        fault: LineFault,
    },
    /// A list has too many lines.
    #[error("arm.moves.{list} has {lines} lines: at most {LINES_MAX} are allowed")]
    TooMany {
        /// Which list.
        list: &'static str,
        /// How many.
        lines: usize,
    },
    /// The pick does not go to the grasp.
    #[error("arm.moves.pick never uses {{{name}}}: without it the arm does not go to what was seen")]
    NoGrasp {
        /// The name that is missing.
        name: &'static str,
    },
    /// The arm is said to turn its tool, but no line does.
    #[error(
        "arm.axes = \"{axes}\", but no line of arm.moves.pick turns the tool: write axes = \"xyz\", or a pick with \
         {{grasp_yaw}} (dialect {dialect}'s own moves do not turn it)"
    )]
    NoTurn {
        /// The axes as written.
        axes: &'static str,
        /// The dialect.
        dialect: &'static str,
    },
    /// `held?` and `arm.moves.held` belong together.
    #[error("arm.moves.held and the entry \"held?\" in arm.moves.pick belong together: {missing} is missing")]
    Held {
        /// What is missing.
        missing: &'static str,
    },
    /// The question whether a part is held is none that this dialect has.
    #[error("arm.moves.held.ask = {ask:?} is not allowed: this dialect can be asked {allowed}")]
    HeldAsk {
        /// As written.
        ask: String,
        /// What there is.
        allowed: &'static str,
    },
    /// The sign of a held part is empty or too long.
    #[error(
        "arm.moves.held.expect = {expect:?} is not allowed: write 1 to 40 characters of the answer that only a held part gives"
    )]
    HeldExpect {
        /// As written.
        expect: String,
    },
    /// An own value is no number or has a taken name.
    #[error("arm.moves.values.{name} = {value} is not allowed: {why}")]
    OwnValue {
        /// Its name.
        name: String,
        /// Its value.
        value: String,
        /// Why not.
        why: &'static str,
    },
}

impl TemplateError {
    /// The dotted key that it is about; of a list, with the number of its entry.
    pub(crate) fn key(&self) -> String {
        match self {
            TemplateError::Line { list, line, .. } => format!("arm.moves.{list}.{line}"),
            TemplateError::TooMany { list, .. } => format!("arm.moves.{list}"),
            TemplateError::NoGrasp { .. } => "arm.moves.pick".to_owned(),
            TemplateError::NoTurn { .. } => "arm.axes".to_owned(),
            TemplateError::Held { .. } => "arm.moves.held".to_owned(),
            TemplateError::HeldAsk { .. } => "arm.moves.held.ask".to_owned(),
            TemplateError::HeldExpect { .. } => "arm.moves.held.expect".to_owned(),
            TemplateError::OwnValue { name, .. } => format!("arm.moves.values.{name}"),
        }
    }
}

/// One line, ready to be filled.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Template {
    letter: char,
    code: u16,
    pub(crate) kind: Kind,
    words: [Option<(char, Option<Slot>)>; WORDS_MAX],
    /// How long the line waits by itself, ms.
    pub(crate) dwell_ms: u32,
}

/// A filled line.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Filled {
    /// Its text, without an end.
    pub(crate) text: LineBuf,
    /// Where it goes, as printed, mm.
    pub(crate) point_mm: [Option<f64>; 3],
}

/// One entry of a list.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Step {
    /// A line.
    Line(Template),
    /// Ask whether a part is held.
    Held,
}

/// The lists of an arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum List {
    /// After every release.
    Start,
    /// A pick.
    Pick,
    /// Instead of the rest of a pick, when no part is held.
    Missed,
    /// Out of the cameras' view.
    Clear,
}

/// All the lines of an arm, checked.
#[derive(Clone, Debug)]
pub struct Program {
    start: Box<[Step]>,
    pick: Box<[Step]>,
    missed: Box<[Step]>,
    clear: Box<[Step]>,
    /// The question whether a part is held.
    pub(crate) held: Option<LineBuf>,
    tool: Tool,
}

impl Program {
    /// Checks `[arm.moves]` of the settings against their dialect, workspace and axes. The dialect must be one of
    /// G-code.
    pub fn compile(settings: &Settings) -> Result<Self, TemplateError> {
        let moves = &settings.arm.moves;
        for (name, value) in &moves.values {
            let why = if !value.is_finite() || value.abs() >= 1e6 {
                "it must be a number below a million"
            } else if values::built_in(name).is_some() {
                "the name is taken by PickCell, choose another"
            } else {
                continue;
            };
            return Err(TemplateError::OwnValue { name: name.clone(), value: value.to_string(), why });
        }
        let own = defaults::moves(settings.arm.dialect, settings.arm.axes);
        let or_own = |list: &[String], own: &[&str]| -> Vec<String> {
            if list.is_empty() { own.iter().map(|&s| s.to_owned()).collect() } else { list.to_vec() }
        };
        let compiler = Compiler { settings, gate: Gate::new(settings) };
        let program = Self {
            start: compiler.list("start", &or_own(&moves.start, own.start))?,
            pick: compiler.list("pick", &or_own(&moves.pick, own.pick))?,
            missed: compiler.list("missed", &or_own(&moves.missed, own.missed))?,
            clear: compiler.list("clear", &moves.clear)?,
            held: compiler.held()?,
            tool: Tool::new(&settings.gripper, settings.arm.axes),
        };
        program.check_pick(settings)?;
        Ok(program)
    }

    fn check_pick(&self, settings: &Settings) -> Result<(), TemplateError> {
        let uses = |wanted: &dyn Fn(Slot) -> bool| {
            self.pick.iter().any(|step| match step {
                Step::Line(line) => line.words.iter().flatten().any(|(_, slot)| slot.is_some_and(wanted)),
                Step::Held => false,
            })
        };
        for (axis, name) in ["grasp_x", "grasp_y", "grasp_z"].into_iter().enumerate() {
            if !uses(&|slot| slot == Slot::Pose(Waypoint::Grasp, values::Part::Axis(axis as u8))) {
                return Err(TemplateError::NoGrasp { name });
            }
        }
        let turns =
            uses(&|slot| matches!(slot, Slot::Pose(_, part) if !matches!(part, values::Part::Axis(_))));
        let axes = match settings.arm.axes {
            ArmAxes::Xyz => "xyz",
            ArmAxes::XyzYaw => "xyz+yaw",
            ArmAxes::Pose => "pose",
        };
        if settings.arm.axes != ArmAxes::Xyz && !turns {
            return Err(TemplateError::NoTurn { axes, dialect: defaults::name(settings.arm.dialect) });
        }
        let asks = self.pick.iter().any(|step| matches!(step, Step::Held));
        match (asks, &self.held) {
            (true, None) => Err(TemplateError::Held { missing: "arm.moves.held" }),
            (false, Some(_)) => Err(TemplateError::Held { missing: "the entry" }),
            _ => Ok(()),
        }
    }

    /// The steps of a list.
    pub(crate) fn list(&self, list: List) -> &[Step] {
        match list {
            List::Start => &self.start,
            List::Pick => &self.pick,
            List::Missed => &self.missed,
            List::Clear => &self.clear,
        }
    }

    /// The values that lines are filled with.
    pub(crate) fn tool(&self) -> &Tool {
        &self.tool
    }

    /// Whether the list of `arm.moves.start` finds the reference switches.
    pub(crate) fn homes(&self) -> bool {
        self.start.iter().any(|step| matches!(step, Step::Line(line) if line.kind == Kind::Home))
    }
}

impl Template {
    /// The line with the numbers of this pick; `None` where one of them is no number.
    pub(crate) fn fill(&self, pick: Option<&Pick>, tool: &Tool) -> Option<Filled> {
        let mut text = LineBuf::new();
        let mut point_mm = [None; 3];
        text.byte(self.letter as u8);
        // `$H` has no number.
        if self.letter == '$' {
            text.byte(b'H');
            return Some(Filled { text, point_mm });
        }
        text.integer(u64::from(self.code));
        for &(letter, slot) in self.words.iter().flatten() {
            text.byte(b' ');
            text.byte(letter as u8);
            let Some(slot) = slot else { continue };
            let value = slot.value(pick, tool);
            if !text.decimal(value, slot.decimals()) {
                return None;
            }
            if let (Kind::Motion, Some(axis)) = (self.kind, axis(letter)) {
                let scale = 10f64.powi(i32::from(slot.decimals()));
                point_mm[axis] = Some((value * scale).round() / scale);
            }
        }
        (!text.overflowed()).then_some(Filled { text, point_mm })
    }

    /// Characters with the longest numbers.
    fn len_max(&self) -> usize {
        let word = |&(_, slot): &(char, Option<Slot>)| 2 + slot.map_or(0, Slot::width_max);
        1 + self.code.to_string().len() + self.words.iter().flatten().map(word).sum::<usize>()
    }
}

fn axis(letter: char) -> Option<usize> {
    ['X', 'Y', 'Z'].into_iter().position(|axis| axis == letter)
}

struct Compiler<'a> {
    settings: &'a Settings,
    gate: Gate,
}

impl Compiler<'_> {
    fn list(&self, list: &'static str, lines: &[String]) -> Result<Box<[Step]>, TemplateError> {
        if lines.len() > LINES_MAX {
            return Err(TemplateError::TooMany { list, lines: lines.len() });
        }
        let mut feed = false;
        let mut steps = Vec::with_capacity(lines.len());
        for (index, text) in lines.iter().enumerate() {
            if list == "pick" && text.trim() == HELD_ENTRY {
                steps.push(Step::Held);
                continue;
            }
            let line = self.line(list, text, &mut feed).map_err(|fault| TemplateError::Line {
                list,
                line: index + 1,
                text: text.clone(),
                fault,
            })?;
            steps.push(Step::Line(line));
        }
        Ok(steps.into())
    }

    fn line(&self, list: &'static str, text: &str, feed: &mut bool) -> Result<Template, LineFault> {
        let dialect = self.settings.arm.dialect;
        let starting = list == "start";
        if dialect == DialectName::Grbl && starting && text.trim().eq_ignore_ascii_case("$h") {
            return Ok(Template { letter: '$', code: 0, kind: Kind::Home, words: [None; 7], dwell_ms: 0 });
        }
        let tokens = words::split(text)?;
        let is_command = |token: &&Token| matches!(token.letter, 'G' | 'M');
        let mut commands = tokens.iter().filter(is_command);
        let command = commands.next().ok_or(LineFault::NoCommand)?;
        let Value::Number(number, _) = command.value else {
            return Err(LineFault::Word { found: text.trim().into() });
        };
        let rule = words::rule(dialect, command.letter, number, starting)?;
        let name = format!("{}{number}", command.letter);
        if let Some(second) = commands.next() {
            let Value::Number(other, _) = second.value else {
                return Err(LineFault::Word { found: text.trim().into() });
            };
            // A forbidden one is named as such, wherever it stands.
            words::rule(dialect, second.letter, other, starting)?;
            return Err(LineFault::TwoCommands { first: name, second: format!("{}{other}", second.letter) });
        }
        if !matches!(tokens[0].letter, 'G' | 'M') {
            return Err(LineFault::NoCommand);
        }
        let mut line = Template {
            letter: command.letter,
            code: number as u16,
            kind: rule.kind,
            words: [None; WORDS_MAX],
            dwell_ms: 0,
        };
        for (count, token) in tokens[1..].iter().enumerate() {
            let twice = line.words.iter().flatten().any(|(letter, _)| *letter == token.letter);
            if !rule.letters.contains(token.letter) || twice || count == WORDS_MAX {
                let allowed = if rule.letters.is_empty() { "no words" } else { rule.letters };
                return Err(LineFault::Parameter { command: name, letter: token.letter, allowed });
            }
            line.words[count] = Some((token.letter, self.slot(list, &name, token, rule.kind)?));
        }
        let has = |letter: char| tokens[1..].iter().any(|token| token.letter == letter);
        if !rule.needs.is_empty() && !rule.needs.chars().any(has) {
            return Err(LineFault::Incomplete { command: name, needed: rule.needs });
        }
        if rule.kind == Kind::Motion {
            *feed |= has('F');
            if number == 1.0 && !*feed {
                return Err(LineFault::NoFeed);
            }
        }
        self.check_line(&mut line)?;
        Ok(line)
    }

    /// The value of a word, its name looked up.
    fn slot(&self, list: &str, command: &str, token: &Token, kind: Kind) -> Result<Option<Slot>, LineFault> {
        match &token.value {
            Value::Number(number, decimals) => Ok(Some(Slot::Literal(*number, *decimals))),
            Value::None if kind == Kind::Home => Ok(None),
            Value::None => Err(LineFault::Incomplete {
                command: format!("{command} {}", token.letter),
                needed: "a number or a {name}",
            }),
            Value::Name(name) => {
                let moves = &self.settings.arm.moves;
                let slot = values::slot(name, moves);
                let without_pick = matches!(list, "start" | "clear");
                match slot {
                    Some(slot) if !without_pick || matches!(slot, Slot::Literal(..)) => Ok(Some(slot)),
                    Some(_) => Err(LineFault::Name {
                        name: name.clone(),
                        known:
                            "this list also runs without a pick, write numbers or names of arm.moves.values"
                                .into(),
                    }),
                    None => Err(LineFault::Name { name: name.clone(), known: values::known(moves) }),
                }
            }
        }
    }

    /// Limits of one understood line: literal coordinates, speeds, waits, length.
    fn check_line(&self, line: &mut Template) -> Result<(), LineFault> {
        let dialect = self.settings.arm.dialect;
        let workspace = &self.settings.workspace;
        for &(letter, slot) in line.words.iter().flatten() {
            let Some(Slot::Literal(value, decimals)) = slot else { continue };
            let written = format!("{value:.*}", usize::from(decimals));
            let refuse = |allowed: String| Err(LineFault::Value { letter, value: written, allowed });
            match (line.kind, letter) {
                (Kind::Motion, 'X' | 'Y' | 'Z') => {
                    let axis = axis(letter).unwrap_or(0);
                    let mut point = [None; 3];
                    point[axis] = Some(value);
                    if self.gate.check_box(Waypoint::Line, point).is_err() {
                        let (min, max) = (workspace.min_mm[axis], workspace.max_mm[axis]);
                        return refuse(format!("inside [workspace], {min} to {max}"));
                    }
                }
                (Kind::Motion, 'F') if value <= 0.0 => return refuse("a speed above 0, mm/min".into()),
                (Kind::Dwell, 'P' | 'S') => {
                    let seconds = letter == 'S' || dialect == DialectName::Grbl;
                    let ms = if seconds { value * 1000.0 } else { value };
                    if !(ms >= 0.0 && ms <= f64::from(DWELL_MAX_MS)) {
                        return refuse(format!("a wait of 0 to {} s", DWELL_MAX_MS / 1000));
                    }
                    line.dwell_ms = ms as u32;
                }
                (Kind::Action, 'N') if line.code == 2202 && value != 3.0 => {
                    return refuse("3, the wrist: the gate cannot check the other joints".into());
                }
                (Kind::Action, 'P' | 'S' | 'V' | 'N') if value < 0.0 => return refuse("0 or more".into()),
                _ => {}
            }
        }
        let dwell_named = line.kind == Kind::Dwell
            && line.words.iter().flatten().any(|(_, slot)| !matches!(slot, Some(Slot::Literal(..))));
        if dwell_named {
            return Err(LineFault::Incomplete {
                command: "a wait".into(),
                needed: "a number, or a name of arm.moves.values",
            });
        }
        let max = line_len_max(dialect);
        let len = line.len_max();
        if len > max { Err(LineFault::TooLong { len, max }) } else { Ok(()) }
    }

    fn held(&self) -> Result<Option<LineBuf>, TemplateError> {
        let Some(held) = &self.settings.arm.moves.held else { return Ok(None) };
        let allowed = defaults::held_questions(self.settings.arm.dialect);
        let ask = held.ask.trim();
        if !allowed.split(", ").any(|question| question == ask) {
            return Err(TemplateError::HeldAsk { ask: held.ask.clone(), allowed });
        }
        if held.expect.is_empty() || held.expect.len() > 40 || !held.expect.is_ascii() {
            return Err(TemplateError::HeldExpect { expect: held.expect.clone() });
        }
        Ok(Some(LineBuf::of(ask)))
    }
}

/// Longest line of a template, characters, so that with tag, number and checksum it fits the controller's buffer.
fn line_len_max(dialect: DialectName) -> usize {
    match dialect {
        // LINE_BUFFER_SIZE is 80, older builds 70.
        DialectName::Grbl => 69,
        // CMD_BUFFER_SIZE is 50 and its end is not checked.
        DialectName::Uarm => 48,
        // MAX_CMD_SIZE is 96: "N1234567 " in front, "*255" behind.
        DialectName::Marlin | DialectName::Own => 80,
    }
}

#[cfg(test)]
mod tests;
