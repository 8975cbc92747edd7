//! One template line as written → its words, or why it cannot be understood.
//!
//! Takes text; gives the command and its parameters, upper case, comments dropped; owns the list of what may stand
//! in a template for each dialect and the reasons for what may not. A template may only say what the gate can
//! check: absolute moves in millimetres, waits, and switching of outputs.

use crate::config::DialectName;

/// What may be wrong with one template line; each says what to write instead.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LineFault {
    /// Nothing but white space or a comment.
    #[error("the line is empty: delete it")]
    Empty,
    /// `{x` or `x}`.
    #[error("a brace is not closed or not opened: write values as {{grasp_x}}")]
    Brace,
    /// `(` without `)`.
    #[error("the comment has no end: close it with ) or delete it")]
    Comment,
    /// Something that is no word of G-code.
    #[error(
        "{found:?} is not understood: a line is a command and words such as X{{grasp_x}} or F1500, plain numbers without exponent"
    )]
    Word {
        /// From where on.
        found: String,
    },
    /// A name that nothing defines.
    #[error("unknown name {{{name}}}: {known}")]
    Name {
        /// The name.
        name: String,
        /// The names there are.
        known: String,
    },
    /// Two commands on one line.
    #[error("more than one command on the line ({first} and {second}): write one command a line")]
    TwoCommands {
        /// The first one.
        first: String,
        /// The one too many.
        second: String,
    },
    /// Words without a command.
    #[error("the line has no command: begin it with G0 or G1")]
    NoCommand,
    /// A command that must not stand in a template.
    #[error("{command} {why}")]
    Forbidden {
        /// The command.
        command: String,
        /// Why not, and what to write instead.
        why: &'static str,
    },
    /// A word that the command does not take, or takes once.
    #[error("{command} takes {allowed} here, each once, not another {letter}")]
    Parameter {
        /// The command.
        command: String,
        /// The word's letter.
        letter: char,
        /// What it takes.
        allowed: &'static str,
    },
    /// A move to nowhere.
    #[error("{command} needs at least one of {needed}")]
    Incomplete {
        /// The command.
        command: String,
        /// What it needs.
        needed: &'static str,
    },
    /// A feed move whose speed is not stated.
    #[error(
        "G1 has no speed: write F (mm/min) on the first G1 of the list, the controller's last one is not known"
    )]
    NoFeed,
    /// A number that the word cannot have.
    #[error("{letter}{value} is not allowed: it must be {allowed}")]
    Value {
        /// The word's letter.
        letter: char,
        /// What was written.
        value: String,
        /// What may be written.
        allowed: String,
    },
    /// Longer than the controller's buffer.
    #[error(
        "the line may become {len} characters long, the controller takes {max}: leave words out or make it two lines"
    )]
    TooLong {
        /// With the longest numbers.
        len: usize,
        /// What fits.
        max: usize,
    },
}

/// What a line does, as far as its order among the others matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// A move; may follow the move before without a stop between them.
    Motion,
    /// Switches something (gripper, pump): only when the arm stands where it should.
    Action,
    /// A wait: only when the arm stands where it should.
    Dwell,
    /// Sets a mode that the gate relies on.
    Modal,
    /// Finds the reference switches.
    Home,
}

/// A number as written, or a name in braces.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Value {
    /// With the number of decimals that were written.
    Number(f64, u8),
    Name(String),
    /// Only `G28 X` has letters without a number.
    None,
}

/// A word: a letter and what stands behind it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Token {
    pub(crate) letter: char,
    pub(crate) value: Value,
}

/// What a command is and takes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rule {
    pub(crate) kind: Kind,
    /// Letters of its parameters.
    pub(crate) letters: &'static str,
    /// At least one of these must be there.
    pub(crate) needs: &'static str,
}

/// Splits a line into words.
pub(crate) fn split(text: &str) -> Result<Vec<Token>, LineFault> {
    let text = without_comment(text)?;
    let mut tokens = Vec::new();
    let mut rest = text.trim();
    if rest.is_empty() {
        return Err(LineFault::Empty);
    }
    while let Some(letter) = rest.chars().next() {
        if matches!(letter, '{' | '}') {
            return Err(LineFault::Brace);
        }
        if !letter.is_ascii_alphabetic() {
            return Err(LineFault::Word { found: rest.into() });
        }
        let (value, after) = value(&rest[1..], rest)?;
        tokens.push(Token { letter: letter.to_ascii_uppercase(), value });
        rest = after.trim_start();
    }
    Ok(tokens)
}

/// The value at the begin of `text`, and what follows; `word` is the whole rest of the line, for the message.
fn value<'a>(text: &'a str, word: &str) -> Result<(Value, &'a str), LineFault> {
    if let Some(inner) = text.strip_prefix('{') {
        let end = inner.find(['{', '}']).ok_or(LineFault::Brace)?;
        if !inner[end..].starts_with('}') {
            return Err(LineFault::Brace);
        }
        let after = &inner[end + 1..];
        if after.chars().next().is_some_and(|c| !c.is_whitespace() && !c.is_ascii_alphabetic()) {
            return Err(LineFault::Word { found: word.into() });
        }
        return Ok((Value::Name(inner[..end].trim().into()), after));
    }
    let end =
        text.find(|c: char| !(c.is_ascii_digit() || matches!(c, '+' | '-' | '.'))).unwrap_or(text.len());
    let (digits, after) = text.split_at(end);
    if digits.is_empty() {
        if text.is_empty() || text.starts_with(char::is_whitespace) {
            return Ok((Value::None, after));
        }
        let fault =
            if text.starts_with('}') { LineFault::Brace } else { LineFault::Word { found: word.into() } };
        return Err(fault);
    }
    let number = super::line::number(digits).ok_or_else(|| LineFault::Word { found: word.into() })?;
    if after.starts_with(['e', 'E'])
        && after[1..].starts_with(|c: char| c.is_ascii_digit() || matches!(c, '+' | '-'))
    {
        return Err(LineFault::Word { found: word.into() });
    }
    let decimals = digits.split_once('.').map_or(0, |(_, d)| d.len());
    if decimals > 4 || number.abs() >= 1e6 {
        return Err(LineFault::Word { found: word.into() });
    }
    Ok((Value::Number(number, decimals as u8), after))
}

/// The line without `(…)` and `;…`.
fn without_comment(text: &str) -> Result<String, LineFault> {
    let mut out = String::new();
    let mut rest = text;
    while let Some(at) = rest.find(['(', ';', ')']) {
        out.push_str(&rest[..at]);
        match rest.as_bytes()[at] {
            b';' => return Ok(out),
            b')' => return Err(LineFault::Comment),
            _ => {
                let end = rest[at..].find(')').ok_or(LineFault::Comment)?;
                out.push(' ');
                rest = &rest[at + end + 1..];
            }
        }
    }
    out.push_str(rest);
    Ok(out)
}

/// The rule for the command `letter``number` in this dialect; `starting` = the line stands in `arm.moves.start`.
pub(crate) fn rule(
    dialect: DialectName,
    letter: char,
    number: f64,
    starting: bool,
) -> Result<Rule, LineFault> {
    let code =
        if number.fract() == 0.0 && (0.0..65_536.0).contains(&number) { number as u32 } else { u32::MAX };
    let command = format!("{letter}{number}");
    let rule = |kind, letters, needs| Ok(Rule { kind, letters, needs });
    let (grbl, marlin, uarm) =
        (dialect == DialectName::Grbl, dialect == DialectName::Marlin, dialect == DialectName::Uarm);
    match (letter, code) {
        ('G', 0 | 1) if uarm => rule(Kind::Motion, "XYZF", "XYZ"),
        ('G', 0 | 1) => rule(Kind::Motion, "XYZABCF", "XYZABC"),
        ('G', 4) if grbl => rule(Kind::Dwell, "P", "P"),
        ('G', 4) => rule(Kind::Dwell, "PS", "PS"),
        ('G', 17 | 21 | 90 | 94) => rule(Kind::Modal, "", ""),
        ('G', 28) if marlin && starting => rule(Kind::Home, "XYZ", ""),
        ('G', 2202) if uarm => rule(Kind::Action, "NVF", "V"),
        ('M', 3 | 4) if !uarm => rule(Kind::Action, "S", ""),
        ('M', 5 | 7 | 8 | 9) if !uarm => rule(Kind::Action, "", ""),
        ('M', 42) if marlin => rule(Kind::Action, "PS", "PS"),
        ('M', 106) if marlin => rule(Kind::Action, "PS", ""),
        ('M', 107) if marlin => rule(Kind::Action, "P", ""),
        ('M', 280) if marlin => rule(Kind::Action, "PS", "S"),
        ('M', 1000..=1003) if marlin => rule(Kind::Action, "", ""),
        ('M', 400) if marlin => rule(Kind::Dwell, "", ""),
        ('M', 2231 | 2232) if uarm => rule(Kind::Action, "V", "V"),
        ('M', 2240) if uarm => rule(Kind::Action, "NV", "NV"),
        ('M' | 'G', _) => Err(LineFault::Forbidden { command, why: why_not(letter, number) }),
        _ => Err(LineFault::NoCommand),
    }
}

/// Why a command must not stand in a template.
fn why_not(letter: char, number: f64) -> &'static str {
    let tenths = (number * 10.0).round() as i64;
    match (letter, tenths) {
        ('G', 200) => "switches to inches: PickCell's G-code is in millimetres, leave it out",
        ('G', 910 | 911) => {
            "makes moves relative: PickCell's G-code is absolute, write G0 or G1 with the coordinates"
        }
        ('G', 920..=929 | 100) => {
            "shifts the coordinates under the gate: set the offset in [rig] or at the controller once"
        }
        ('G', 20 | 30 | 50 | 51) => "is a curve, whose way the gate cannot check: write several G1",
        ('G', 280 | 281 | 300 | 301) => {
            "goes to a point that the gate cannot see: write the point with G0, or home in arm.moves.start"
        }
        ('G', 530..=599) => {
            "changes the coordinates under the gate: leave it out, work in the one system that is set up"
        }
        ('G', 380..=389) => "moves until a probe touches, to a point that the gate cannot see: leave it out",
        ('M', 0 | 10 | 20 | 300 | 600) => "stops the program and waits for a person: leave it out",
        ('M', 970 | 980 | 990 | 320) => "runs a macro that the gate cannot see: write its lines here",
        ('M', 1100 | 1120 | 4100 | 1080 | 9990) => {
            "belongs to the driver, which sends it by itself: leave it out"
        }
        _ => "is not understood in this dialect: see the table of commands in GCODE.md",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fault(text: &str) -> String {
        split(text).unwrap_err().to_string()
    }

    #[test]
    fn words_are_split_whatever_their_case_and_spacing() {
        let tokens = split("g1x{grasp_x}Y-2.50 ; down (slowly)").unwrap();
        assert_eq!(
            tokens,
            [
                Token { letter: 'G', value: Value::Number(1.0, 0) },
                Token { letter: 'X', value: Value::Name("grasp_x".into()) },
                Token { letter: 'Y', value: Value::Number(-2.5, 2) },
            ]
        );
        assert_eq!(split("G0 (over the bin) Z5").unwrap().len(), 2);
    }

    #[test]
    fn what_cannot_be_understood_is_named() {
        assert!(fault("G1 X{grasp_x").contains("brace"));
        assert!(fault("G1 X}").contains("brace"));
        assert!(fault("G1 {grasp_x}").contains("brace"));
        assert!(fault("G1 X{{grasp_x}}").contains("brace"));
        assert!(fault("  ; nothing").contains("empty"));
        assert!(fault("G1 X1 (open").contains("comment"));
        assert!(fault("$H=3").contains("\"$H=3\""));
        assert!(fault("G1 X1e3").contains("exponent"));
        assert!(fault("G1 X{grasp_x}5").contains("not understood"));
        assert!(fault("G1 X1.23456").contains("not understood"));
        assert!(fault("G1 X\u{00e4}").contains("not understood"));
        assert!(fault("N10 G1 X1*27").contains("\"*27\""));
    }

    #[test]
    fn dangerous_commands_say_why_and_what_instead() {
        let why = |letter, number| rule(DialectName::Grbl, letter, number, false).unwrap_err().to_string();
        assert!(why('G', 91.0).starts_with("G91 makes moves relative"));
        assert!(why('G', 20.0).starts_with("G20 switches to inches"));
        assert!(why('G', 92.0).contains("shifts the coordinates"));
        assert!(why('G', 10.0).contains("shifts the coordinates"));
        assert!(why('G', 2.0).contains("several G1"));
        assert!(why('M', 98.0).contains("macro"));
        assert!(why('M', 400.0).contains("not understood in this dialect"));
        assert!(why('G', 0.5).contains("not understood"));
        assert!(why('X', 5.0).contains("begin it with G0 or G1"));
    }
}
