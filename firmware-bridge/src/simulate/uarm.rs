//! A uArm Swift Pro with firmware 4 (built on Grbl 0.9), as its documentation and its behaviour on a wire describe
//! it.
//!
//! `#n command` is answered by `$n ok …` or `$n E22`; the answer to a command comes when the arm stands, that to a
//! query (`P…`) at once, so a query overtakes a move. One query and 20 commands fit; the command after a delay
//! waits for it. `?`, `!`, `~` and 0x18 act when they arrive, and while a hold is on nothing but `?` is answered.
//! Lines that begin with anything but `#`, `G`, `M`, `P`, `$` are ignored. What is wrong in a way that the firmware
//! has no number for is answered by the bare tag.

use super::motion::Mechanics;
use super::noise::Noise;
use super::{Faults, Motion};
use std::collections::VecDeque;

const MS: i64 = 1_000_000;
const RX_LEN: usize = 128;
const LINE_LEN: usize = 80;
const COMMANDS: usize = 20;
const COMMAND_LEN: usize = 50;
const BLOCKS: usize = 15;
const BOOT_NS: i64 = 1500 * MS;
const LINE_NS: i64 = 1_500_000;
/// Reach of this simulated arm: distance from the base's axis and height, mm (the real one is a narrower shell).
const RADIUS_MAX_MM: f64 = 400.0;
const HEIGHT_MM: [f64; 2] = [-120.0, 350.0];
const BANNER: &str = "\r\nGrbl 0.9j ['$' for help]\r\n@1\n";

#[derive(Clone, Copy, Debug, PartialEq)]
enum Busy {
    Off,
    Boot(i64),
    Line(i64),
    PlannerFull { to_mm: [f64; 3], speed_mm_s: f64 },
    Free,
}

/// The simulated controller.
#[derive(Debug)]
pub struct UarmFirmware {
    park_mm: [f64; 3],
    noise: Noise,
    arm: Mechanics,
    busy: Busy,
    alarm: bool,
    held: bool,
    rx: VecDeque<u8>,
    line: Vec<u8>,
    overflow: bool,
    /// Built since 2019: it says nothing of a reset, and leaves no alarm.
    silent_reset: bool,
    /// Commands that wait, with their tags.
    commands: VecDeque<(String, String)>,
    query: Option<(String, String)>,
    /// Answers that wait until the arm stands.
    answers: VecDeque<String>,
    delay_until_ns: i64,
    feed_mm_min: f64,
    relative: bool,
    asked: bool,
    reset_asked: bool,
    gripper_closed: bool,
    pump_on: bool,
    holds_part: bool,
    out: VecDeque<u8>,
}

impl UarmFirmware {
    /// Switched off, the arm at its park position; it boots at the first call.
    pub fn new(park_mm: [f64; 3], faults: Faults) -> Self {
        let noise = Noise::new(faults);
        let mut arm = Mechanics::new(park_mm);
        arm.pace = noise.pace();
        Self {
            park_mm,
            noise,
            arm,
            busy: Busy::Off,
            alarm: false,
            held: false,
            rx: VecDeque::with_capacity(RX_LEN),
            line: Vec::with_capacity(LINE_LEN),
            overflow: false,
            silent_reset: faults.later_build(),
            commands: VecDeque::with_capacity(COMMANDS),
            query: None,
            answers: VecDeque::with_capacity(COMMANDS),
            delay_until_ns: i64::MIN,
            feed_mm_min: 0.0,
            relative: false,
            asked: false,
            reset_asked: false,
            gripper_closed: false,
            pump_on: false,
            holds_part: false,
            out: VecDeque::with_capacity(512),
        }
    }

    /// Bytes that arrive.
    pub fn on_bytes(&mut self, bytes: &[u8], now_ns: i64) {
        self.run(now_ns);
        for &byte in bytes {
            match byte {
                _ if matches!(self.busy, Busy::Off | Busy::Boot(_)) => {}
                0x18 => self.reset_asked = true,
                b'?' => self.asked = true,
                b'!' if !self.alarm && !self.held => {
                    self.held = true;
                    self.arm.hold(now_ns);
                }
                b'~' if self.held && self.arm.is_held() => {
                    self.held = false;
                    self.arm.resume(now_ns);
                }
                b'!' | b'~' | b'@' | 0x80.. => {}
                _ if self.rx.len() < RX_LEN => self.rx.push_back(byte),
                _ => {}
            }
            self.run(now_ns);
        }
    }

    /// Lets time pass; what the arm did.
    pub fn poll(&mut self, now_ns: i64) -> Option<Motion> {
        self.run(now_ns);
        self.arm.motions.pop_front()
    }

    /// Bytes that it says now.
    pub fn transmit(&mut self, now_ns: i64, out: &mut [u8]) -> usize {
        self.run(now_ns);
        super::take(&mut self.out, out)
    }

    /// When something happens by itself.
    pub fn next_deadline_ns(&self) -> Option<i64> {
        let busy = match self.busy {
            Busy::Boot(at) | Busy::Line(at) => Some(at),
            Busy::Off => Some(i64::MIN),
            _ => None,
        };
        let delayed = self.busy == Busy::Free && !self.commands.is_empty() && !self.held;
        let delay = delayed.then_some(self.delay_until_ns);
        [busy, delay, self.arm.next_ns(), self.noise.restart_ns()].into_iter().flatten().min()
    }

    /// The button. Its encoders know where it stands; somebody has put it back to its park position all the same.
    pub fn reset(&mut self, now_ns: i64) {
        self.arm.kill(now_ns);
        self.arm.put(self.park_mm);
        self.arm.motions.push_back(Motion::Restarted);
        self.grip(false, false);
        self.out.clear();
        self.commands.clear();
        self.query = None;
        self.answers.clear();
        self.alarm = false;
        self.noise.forget_restart();
        self.forget();
        self.busy = Busy::Boot(now_ns + BOOT_NS);
    }

    /// No further faults.
    pub fn heal(&mut self) {
        self.noise.heal();
        self.arm.pace = 1.0;
    }

    fn forget(&mut self) {
        self.rx.clear();
        self.line.clear();
        self.overflow = false;
        self.held = false;
        self.asked = false;
        self.reset_asked = false;
        self.relative = false;
        self.delay_until_ns = i64::MIN;
    }

    fn say(&mut self, text: &str) {
        self.out.extend(text.as_bytes());
    }

    fn run(&mut self, now_ns: i64) {
        if self.busy == Busy::Off {
            self.busy = Busy::Boot(now_ns + BOOT_NS);
        }
        if self.noise.restarts(now_ns) && self.arm.is_moving() {
            self.reset(now_ns);
        }
        self.arm.advance(now_ns);
        while self.step(now_ns) {
            self.arm.advance(now_ns);
        }
    }

    fn step(&mut self, now_ns: i64) -> bool {
        if self.reset_asked && !matches!(self.busy, Busy::Boot(_)) {
            self.soft_reset(now_ns);
            return true;
        }
        if self.asked && !matches!(self.busy, Busy::Boot(_)) {
            self.asked = false;
            self.status(now_ns);
        }
        match self.busy {
            Busy::Boot(at) if now_ns >= at => {
                self.say(BANNER);
                self.busy = Busy::Free;
            }
            Busy::Boot(_) => return false,
            Busy::Line(at) if now_ns >= at => self.busy = Busy::Free,
            Busy::Line(_) => return false,
            _ if self.held => return false,
            Busy::PlannerFull { to_mm, speed_mm_s } if self.arm.blocks() < BLOCKS => {
                self.arm.plan(to_mm, speed_mm_s);
                self.busy = Busy::Line(now_ns + LINE_NS);
            }
            Busy::Free => return self.main_loop(now_ns),
            _ => {
                if self.arm.is_moving() {
                    return false;
                }
                self.arm.start(now_ns);
            }
        }
        true
    }

    /// One turn of the main loop: a line, the query, a command, the moves, the answers.
    fn main_loop(&mut self, now_ns: i64) -> bool {
        let mut went_on = self.read();
        if let Some((tag, line)) = self.query.take() {
            let answer = self.ask(&line, now_ns);
            self.say(&format!("{tag}{answer}\n"));
            went_on = true;
        }
        if now_ns >= self.delay_until_ns
            && let Some((tag, line)) = self.commands.pop_front()
        {
            let answer = self.execute(&line, now_ns);
            let space = if tag.is_empty() || answer.is_empty() { "" } else { " " };
            self.answers.push_back(format!("{tag}{space}{answer}\n"));
            went_on = true;
        }
        if self.arm.blocks() > 0 && !self.arm.is_moving() && !self.alarm && self.busy == Busy::Free {
            self.noise.begin_move(now_ns);
            self.arm.start(now_ns);
            went_on = true;
        }
        if self.arm.blocks() == 0 && self.busy == Busy::Free {
            while let Some(answer) = self.answers.pop_front() {
                self.say(&answer);
            }
        }
        went_on
    }

    /// Takes at most one line.
    fn read(&mut self) -> bool {
        while let Some(byte) = self.rx.pop_front() {
            match byte {
                b'\n' | b'\r' => {
                    let line = String::from_utf8_lossy(&self.line).into_owned();
                    self.line.clear();
                    self.receive(&line);
                    return true;
                }
                0..=b' ' | b'/' => {}
                _ if self.line.len() >= LINE_LEN - 1 => self.line.clear(),
                _ => self.line.push(byte.to_ascii_uppercase()),
            }
        }
        false
    }

    fn receive(&mut self, line: &str) {
        let (tag, command) = match line.strip_prefix('#') {
            Some(tagged) => {
                let digits = tagged.chars().take_while(char::is_ascii_digit).count();
                let tag = if digits > 0 { format!("${}", &tagged[..digits]) } else { String::new() };
                (tag, &tagged[digits..])
            }
            None => (String::new(), line),
        };
        match command.chars().next() {
            Some('$') if tag.is_empty() => {
                if command == "$X" && self.alarm {
                    self.alarm = false;
                    self.say("[Caution: Unlocked]\r\n");
                }
                self.say("ok\r\n");
            }
            // The real one copies without looking at the length.
            Some(_) if command.len() >= COMMAND_LEN => self.say("crash"),
            // One query fits; the one before is forgotten.
            Some('P') => self.query = Some((tag, command.into())),
            Some(_) if !tag.is_empty() || command.starts_with(['G', 'M']) => {
                if self.commands.len() >= COMMANDS {
                    self.say("E23 buffer full\r\n");
                } else {
                    self.commands.push_back((tag, command.into()));
                }
            }
            _ => {}
        }
    }

    /// The answer to a query, with the space before it.
    fn ask(&self, line: &str, now_ns: i64) -> String {
        match line {
            "P2201" => " ok SwiftPro".into(),
            "P2202" => " ok V3.3.1".into(),
            "P2203" => " ok V4.9.0".into(),
            "P2220" => {
                let at = self.arm.position(now_ns);
                // The encoders see steps of about a quarter of a millimetre.
                let [x, y, z] = at.map(|v| (v * 4.0).round() / 4.0);
                format!(" ok X{x:.4} Y{y:.4} Z{z:.4}")
            }
            "P2231" => format!(" ok V{}", grip_state(self.pump_on, self.holds_part)),
            "P2232" => format!(" ok V{}", grip_state(self.gripper_closed, self.holds_part)),
            "P2233" => " ok V0".into(),
            _ => " E20".into(),
        }
    }

    fn execute(&mut self, line: &str, now_ns: i64) -> String {
        let Some(words) = words(line) else { return String::new() };
        let word = |letter: char| words.iter().find(|(l, _)| *l == letter).map(|(_, v)| *v);
        let (letter, code) = words.first().copied().unwrap_or((' ', 0.0));
        match (letter, code as u32) {
            ('G', 0 | 1) => {
                let mut to_mm = self.arm.destination();
                for (axis, letter) in ['X', 'Y', 'Z'].into_iter().enumerate() {
                    if let Some(value) = word(letter) {
                        to_mm[axis] = value + if self.relative { to_mm[axis] } else { 0.0 };
                    }
                }
                self.feed_mm_min = word('F').unwrap_or(self.feed_mm_min);
                if self.feed_mm_min <= 0.0 && code == 1.0 {
                    return String::new();
                }
                if !reachable(to_mm) || self.noise.refuses() {
                    return "E22".into();
                }
                let feed_mm_min = if self.feed_mm_min > 0.0 { self.feed_mm_min } else { 3000.0 };
                self.busy = Busy::PlannerFull { to_mm, speed_mm_s: feed_mm_min / 60.0 };
                "ok".into()
            }
            ('G', 90 | 91) => {
                self.relative = code == 91.0;
                "ok".into()
            }
            ('G', 21 | 94 | 17) => "ok".into(),
            ('G', 2004) => {
                self.delay_until_ns = now_ns + (word('P').unwrap_or(0.0) * 1e6) as i64;
                "ok".into()
            }
            ('G', 2202) if word('V').is_some() && word('F').is_some() => "ok".into(),
            ('M', 2222) => match (word('X'), word('Y'), word('Z'), word('P')) {
                (Some(x), Some(y), Some(z), Some(0.0)) => {
                    format!("ok V{}", u8::from(reachable([x, y, z])))
                }
                _ => "E21".into(),
            },
            ('M', 2231 | 2232) => match word('V') {
                Some(v) if v == 0.0 || v == 1.0 => {
                    let on = v == 1.0;
                    let (gripper, pump) =
                        if code == 2232.0 { (on, self.pump_on) } else { (self.gripper_closed, on) };
                    self.grip(gripper, pump);
                    "ok".into()
                }
                _ => "E21".into(),
            },
            ('M', 17 | 2122 | 2210) => "ok".into(),
            _ => "E20".into(),
        }
    }

    fn soft_reset(&mut self, now_ns: i64) {
        if self.arm.kill(now_ns) && !self.silent_reset {
            self.alarm = true;
            self.say("ALARM: Abort during cycle\r\n");
        }
        self.grip(false, false);
        self.forget();
        self.say(if self.silent_reset { "ok\n" } else { BANNER });
        self.busy = Busy::Free;
    }

    fn grip(&mut self, gripper: bool, pump: bool) {
        let (was, is) = (self.gripper_closed || self.pump_on, gripper || pump);
        (self.gripper_closed, self.pump_on) = (gripper, pump);
        if is && !was {
            self.holds_part = self.noise.holds();
            self.arm.motions.push_back(Motion::Closed { holds_part: self.holds_part });
        } else if was && !is {
            self.holds_part = false;
            self.arm.motions.push_back(Motion::Opened);
        }
    }

    fn status(&mut self, now_ns: i64) {
        let state = if self.alarm {
            "Alarm"
        } else if self.held {
            "Hold"
        } else if self.arm.is_moving() {
            "Run"
        } else {
            "Idle"
        };
        let [x, y, z] = self.arm.position(now_ns);
        self.say(&format!("<{state},MPos:{x:.3},{y:.3},{z:.3},WPos:{x:.3},{y:.3},{z:.3}>\r\n"));
    }
}

/// 0 open, 1 closed on nothing, 2 holding.
fn grip_state(on: bool, holds_part: bool) -> u8 {
    match (on, holds_part) {
        (false, _) => 0,
        (true, false) => 1,
        (true, true) => 2,
    }
}

fn reachable(at_mm: [f64; 3]) -> bool {
    at_mm[0].hypot(at_mm[1]) <= RADIUS_MAX_MM && at_mm[2] >= HEIGHT_MM[0] && at_mm[2] <= HEIGHT_MM[1]
}

/// Letters and numbers without spaces; nothing where a number is missing.
fn words(line: &str) -> Option<Vec<(char, f64)>> {
    let mut words = Vec::new();
    let mut rest = line;
    while let Some(letter) = rest.chars().next() {
        if !letter.is_ascii_uppercase() {
            return None;
        }
        let number = &rest[1..];
        let end = number.find(|c: char| !(c.is_ascii_digit() || ".+-".contains(c))).unwrap_or(number.len());
        words.push((letter, number[..end].parse().ok()?));
        rest = &number[end..];
    }
    Some(words)
}

#[cfg(test)]
mod tests;
