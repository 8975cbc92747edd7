//! What Grbl says of itself: banner, version, status report.

use super::super::line;

const MM_PER_INCH: f64 = 25.4;

/// The state in a status report.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum State {
    Idle,
    Run,
    /// Decelerating.
    Holding,
    /// Held, or a door closed again: nothing moves.
    Held,
    Jog,
    Alarm,
    /// Open door, check mode, sleep: nothing moves.
    Blocked,
    Home,
}

/// `Grbl 1.1h ['$' for help]`, `GrblHAL 1.1f […]`, also with a byte lost.
pub(super) fn is_banner(text: &str) -> bool {
    text.starts_with("Grbl") || text.ends_with("for help]") || text.ends_with("for info]")
}

/// Whether a version number, as in `1.1h` or `1.1h.20190825:`, is 1.1 or later.
pub(super) fn understood(version: &str) -> bool {
    number(version).is_none_or(|number| number >= (1, 1))
}

/// Whether it is 1.1, as Grbl and grblHAL say; `1.3a` is Grbl_Esp32, `3.7` FluidNC.
pub(super) fn is_first(version: &str) -> bool {
    number(version) == Some((1, 1))
}

fn number(version: &str) -> Option<(u32, u32)> {
    let (major, rest) = line::leading_integer(version.trim_start())?;
    let minor = rest.strip_prefix('.').and_then(line::leading_integer).map_or(0, |(minor, _)| minor);
    Some((major, minor))
}

/// A status report.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Status {
    pub(super) state: State,
    machine_mm: Option<[f64; 3]>,
    work_mm: Option<[f64; 3]>,
    pub(super) offset_mm: Option<[f64; 3]>,
}

impl Status {
    /// What stands between `<` and `>`.
    pub(super) fn parse(text: &str) -> Option<Self> {
        let mut fields = text.split('|');
        let name = fields.next()?;
        let (name, detail) = name.split_once(':').unwrap_or((name, ""));
        let state = match (name, detail) {
            ("Idle", _) => State::Idle,
            ("Run", _) => State::Run,
            ("Hold", "1") => State::Holding,
            ("Hold", _) | ("Door", "0") => State::Held,
            ("Door", "2" | "3") => State::Holding,
            ("Door" | "Check" | "Sleep" | "Tool", _) => State::Blocked,
            ("Jog", _) => State::Jog,
            ("Alarm", _) => State::Alarm,
            ("Home", _) => State::Home,
            _ => return None,
        };
        let mut status = Self { state, machine_mm: None, work_mm: None, offset_mm: None };
        for field in fields {
            match field.split_once(':') {
                Some(("MPos", at)) => status.machine_mm = point_mm(at),
                Some(("WPos", at)) => status.work_mm = point_mm(at),
                Some(("WCO", at)) => status.offset_mm = point_mm(at),
                _ => {}
            }
        }
        Some(status)
    }

    /// In work coordinates, where they are known.
    pub(super) fn position_mm(&self, offset_mm: Option<[f64; 3]>) -> [Option<f64>; 3] {
        match (self.work_mm, self.machine_mm, offset_mm) {
            (Some(work), _, _) => work.map(Some),
            (None, Some(machine), Some(offset)) => [0, 1, 2].map(|axis| Some(machine[axis] - offset[axis])),
            _ => [None; 3],
        }
    }
}

/// Three coordinates as Grbl writes them: millimetres with three decimals or, with `$13=1`, inches with four
/// (`N_DECIMAL_COORDVALUE_MM` and `_INCH` in config.h).
fn point_mm(text: &str) -> Option<[f64; 3]> {
    let point = line::triple(text)?;
    let four_decimals =
        |number: &str| number.split_once('.').is_some_and(|(_, decimals)| decimals.len() == 4);
    let in_inches = text.split(',').take(3).all(four_decimals);
    Some(if in_inches { point.map(|value| value * MM_PER_INCH) } else { point })
}
