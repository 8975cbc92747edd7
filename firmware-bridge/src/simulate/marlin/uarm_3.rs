//! The uArm Swift Pro with firmware 3, a Marlin 1.1 with lines and answers of its own.
//!
//! `#n command` is answered by `$n ok …` in the order of the queue, a move when it is planned. A line of another kind
//! is complained about and not answered. M410 without a tag acts when it is read; M2000 does the same and reads the
//! encoders; G2203 waits until all moves are done. P2220 is where it was sent, P2200 what the encoders see (here the
//! angles are the coordinates), M2200 whether it moves. Bytes of firmware 4 are text.

use super::{Busy, COMMAND_NS, MarlinFirmware, leading};
use crate::simulate::Faults;

pub(super) const BANNER: &str = "start\r\necho:Marlin 1.1.0-RC6\r\n";

/// The answer to the command at work.
#[derive(Debug, Default)]
pub(super) struct Answer {
    tag: String,
    value: String,
    error: Option<&'static str>,
}

impl Answer {
    pub(super) fn take(&mut self) -> String {
        let Self { tag, value, error } = core::mem::take(self);
        error.map_or_else(|| format!("{tag}ok{value}"), |error| format!("{tag}{error}"))
    }

    pub(super) fn refuse(&mut self, error: &'static str) {
        self.error = Some(error);
    }
}

impl MarlinFirmware {
    /// A uArm with firmware 3, switched off.
    pub fn uarm_3(park_mm: [f64; 3], faults: Faults) -> Self {
        let mut firmware = Self::new(park_mm, faults);
        (firmware.advanced_ok, firmware.emergency_parser, firmware.keepalive) = (false, false, true);
        firmware.uarm = Some(Answer::default());
        firmware
    }

    /// A command without its tag, if there is something left to do for Marlin.
    pub(super) fn untagged<'a>(&mut self, text: &'a str, now_ns: i64) -> Option<&'a str> {
        let Some(answer) = &mut self.uarm else { return Some(text) };
        let mut command = text;
        if let Some(tagged) = text.strip_prefix('#') {
            let digits = tagged.chars().take_while(char::is_ascii_digit).count();
            answer.tag = format!("${} ", &tagged[..digits]);
            command = tagged[digits..].trim_start();
        }
        if !command.starts_with(['G', 'M', 'P', 'T']) {
            self.uarm = Some(Answer::default());
            self.say(&format!("echo:Unknown command: \"{text}\"\r\n"));
            self.queue.pop_front();
            self.busy = Busy::Command(now_ns + COMMAND_NS);
            return None;
        }
        let words: Vec<_> = command.split(' ').collect();
        let word = |letter: char| {
            words.iter().skip(1).find_map(|word| word.strip_prefix(letter)).map(leading).unwrap_or(0.0)
        };
        let point =
            |[a, b, c]: [char; 3], at: [f64; 3]| format!(" {a}{:.2} {b}{:.2} {c}{:.2}", at[0], at[1], at[2]);
        let moving = self.arm.is_moving() || self.arm.blocks() > 0;
        let grip = if !self.closed { 0 } else { 1 + u8::from(self.holds_part) };
        let value = match words[0] {
            "P2203" => " V3.2.0".into(),
            "P2220" => point(['X', 'Y', 'Z'], self.arm.destination()),
            "P2200" => point(['B', 'L', 'R'], self.arm.position(now_ns)),
            "M2221" => point(['X', 'Y', 'Z'], ['B', 'L', 'R'].map(word)),
            "M2222" => " V1".into(),
            "M2200" => format!(" V{}", u8::from(moving)),
            "P2231" | "P2232" => format!(" V{grip}"),
            "P2233" => " V0".into(),
            "M2231" | "M2232" => {
                self.grip(word('V') > 0.0);
                String::new()
            }
            "M2000" => {
                self.quick_stop(now_ns);
                String::new()
            }
            "G2203" => {
                self.busy = Busy::Sync(0);
                return None;
            }
            _ => return Some(command),
        };
        if let Some(answer) = &mut self.uarm {
            answer.value = value;
        }
        self.finish(now_ns);
        None
    }
}
