//! A controller with Marlin 2.1, as its documentation and its behaviour on a wire describe it.
//!
//! Numbered lines need a checksum and the next number, otherwise the receive buffer is thrown away and `Resend:`
//! asks for the right one; lines without a number are taken as they come. A queue of 4 commands, a planner of 16
//! moves; `ok` means done for commands and planned for moves. Commands that wait say `echo:busy: processing` every
//! two seconds, where the build has `HOST_KEEPALIVE_FEATURE`. M112, M410 act when they are read, before the queue, if
//! they have no number; reading goes on while a command waits, as long as the queue has room. For a second after M410
//! nothing is worked on and no move planned; a build without `EMERGENCY_PARSER` does the same once more when M410 comes
//! out of its queue. What M114 says, `Count` included, is where the last planned move ends; a build without
//! `HOST_KEEPALIVE_FEATURE`, one of version 1.1, says it when the arm stands. A servo keeps the firmware from reading
//! for 300 ms.

mod uarm_3;

use super::motion::Mechanics;
use super::noise::Noise;
use super::{Faults, Motion};
use std::collections::VecDeque;

const MS: i64 = 1_000_000;
const RX_LEN: usize = 128;
const QUEUE_LEN: usize = 4;
const COMMAND_LEN: usize = 96;
const BLOCKS: usize = 15;
const BOOT_NS: i64 = 1200 * MS;
/// Reading, parsing and executing one short command.
const COMMAND_NS: i64 = 700_000;
const BUSY_NS: i64 = 2000 * MS;
/// `BLOCK_DELAY_FOR_1ST_MOVE`: the first of less than three moves waits for others.
const FIRST_MOVE_NS: i64 = 100 * MS;
const MOVES_WITHOUT_DELAY: usize = 3;
const HOMING_NS: i64 = 4000 * MS;
/// `cleaning_buffer_counter`: after a quick stop.
const CLEANING_NS: i64 = 1000 * MS;
/// `SERVO_DELAY`.
const SERVO_NS: i64 = 300 * MS;
const BANNER: &str = "start\r\necho:Marlin 2.1.2.5\r\n\r\necho: Last Updated: 2024-12-01 | Author: (none, default config)\r\n\
                      echo: Free Memory: 5000  PlannerBufferBytes: 1200\r\n";

/// What the command at the head of the queue waits for.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Busy {
    Off,
    Boot(i64),
    /// Between two commands.
    Command(i64),
    PlannerFull {
        to_mm: [f64; 3],
        speed_mm_s: f64,
    },
    /// M400; a dwell follows, ns.
    Sync(i64),
    /// M114 of version 1.1.
    Standing,
    Until(i64),
    Homing(i64),
    /// M280, deaf.
    Servo(i64),
    Free,
    /// `kill()`: nothing but the button helps.
    Dead,
}

/// The simulated controller.
#[derive(Debug)]
pub struct MarlinFirmware {
    park_mm: [f64; 3],
    noise: Noise,
    arm: Mechanics,
    busy: Busy,
    busy_said_ns: i64,
    /// `ADVANCED_OK`: `ok N3 P15 B3`.
    advanced_ok: bool,
    /// `EMERGENCY_PARSER`: M410 acts once.
    emergency_parser: bool,
    /// `HOST_KEEPALIVE_FEATURE`.
    keepalive: bool,
    /// The planner is being cleaned.
    cleaning_until_ns: i64,
    rx: VecDeque<u8>,
    line: Vec<u8>,
    comment: bool,
    last_number: i64,
    queue: VecDeque<String>,
    feed_mm_min: f64,
    relative: bool,
    closed: bool,
    holds_part: bool,
    /// When moves that were planned at rest begin.
    first_move_ns: Option<i64>,
    /// What the uArm's firmware 3 has to say about the command at work.
    uarm: Option<uarm_3::Answer>,
    out: VecDeque<u8>,
}

impl MarlinFirmware {
    /// Switched off, the arm at its park position; it boots at the first call. The later build has `ADVANCED_OK` and
    /// `EMERGENCY_PARSER`, that of the first generation no `HOST_KEEPALIVE_FEATURE`.
    pub fn new(park_mm: [f64; 3], faults: Faults) -> Self {
        let noise = Noise::new(faults);
        let mut arm = Mechanics::new(park_mm);
        arm.pace = noise.pace();
        Self {
            park_mm,
            noise,
            arm,
            busy: Busy::Off,
            busy_said_ns: 0,
            advanced_ok: faults.later_build(),
            emergency_parser: faults.later_build(),
            keepalive: !faults.first_generation(),
            cleaning_until_ns: i64::MIN,
            rx: VecDeque::with_capacity(RX_LEN),
            line: Vec::with_capacity(COMMAND_LEN),
            comment: false,
            last_number: 0,
            queue: VecDeque::with_capacity(QUEUE_LEN),
            feed_mm_min: 3000.0,
            relative: false,
            closed: false,
            holds_part: false,
            first_move_ns: None,
            uarm: None,
            out: VecDeque::with_capacity(512),
        }
    }

    /// Bytes that arrive.
    pub fn on_bytes(&mut self, bytes: &[u8], now_ns: i64) {
        self.run(now_ns);
        for &byte in bytes {
            let deaf = matches!(self.busy, Busy::Off | Busy::Boot(_) | Busy::Dead);
            if !deaf && self.rx.len() < RX_LEN {
                self.rx.push_back(byte);
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
            Busy::Boot(at) | Busy::Command(at) | Busy::Until(at) | Busy::Homing(at) | Busy::Servo(at) => {
                Some(at)
            }
            Busy::Off => Some(i64::MIN),
            Busy::PlannerFull { .. } | Busy::Sync(_) if self.keepalive => Some(self.busy_said_ns + BUSY_NS),
            _ => None,
        };
        let cleans = self.cleaning_until_ns > i64::MIN;
        let busy = if cleans { Some(self.cleaning_until_ns) } else { busy };
        [busy, self.arm.next_ns(), self.noise.restart_ns(), self.first_move_ns].into_iter().flatten().min()
    }

    /// The button. Somebody puts the arm back to its park position.
    pub fn reset(&mut self, now_ns: i64) {
        self.arm.kill(now_ns);
        self.arm.put(self.park_mm);
        self.arm.motions.push_back(Motion::Restarted);
        self.grip(false);
        self.rx.clear();
        self.line.clear();
        self.queue.clear();
        self.out.clear();
        self.last_number = 0;
        self.relative = false;
        self.noise.forget_restart();
        self.first_move_ns = None;
        self.cleaning_until_ns = i64::MIN;
        self.busy = Busy::Boot(now_ns + BOOT_NS);
    }

    /// No further faults.
    pub fn heal(&mut self) {
        self.noise.heal();
        self.arm.pace = 1.0;
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
        self.begin_first_move(now_ns);
    }

    fn begin_first_move(&mut self, now_ns: i64) {
        let many = self.arm.blocks() >= MOVES_WITHOUT_DELAY;
        if self.first_move_ns.is_some_and(|at| at <= now_ns || many) {
            self.first_move_ns = None;
            self.arm.start(now_ns);
        }
    }

    fn step(&mut self, now_ns: i64) -> bool {
        if !matches!(self.busy, Busy::Off | Busy::Boot(_) | Busy::Dead | Busy::Homing(_) | Busy::Servo(_)) {
            self.read(now_ns);
        }
        if now_ns < self.cleaning_until_ns && self.busy != Busy::Dead {
            return false;
        }
        self.cleaning_until_ns = i64::MIN;
        let waits =
            matches!(self.busy, Busy::PlannerFull { .. } | Busy::Sync(_) | Busy::Until(_) | Busy::Homing(_));
        if waits && self.keepalive && now_ns - self.busy_said_ns >= BUSY_NS {
            self.busy_said_ns = now_ns;
            self.say("echo:busy: processing\r\n");
        }
        match self.busy {
            Busy::Boot(at) if now_ns >= at => {
                self.say(if self.uarm.is_some() { uarm_3::BANNER } else { BANNER });
                self.busy = Busy::Free;
            }
            Busy::Command(at) if now_ns >= at => self.busy = Busy::Free,
            Busy::PlannerFull { to_mm, speed_mm_s } if self.arm.blocks() < BLOCKS => {
                self.arm.plan(to_mm, speed_mm_s);
                self.noise.begin_move(now_ns);
                if !self.arm.is_moving() {
                    // Marlin 1.1 begins at once.
                    let wait_ns = if self.uarm.is_some() { 0 } else { FIRST_MOVE_NS };
                    self.first_move_ns.get_or_insert(now_ns + wait_ns);
                }
                self.finish(now_ns);
            }
            Busy::Standing if self.arm.blocks() == 0 => {
                self.say_position();
                self.finish(now_ns);
            }
            Busy::Sync(dwell_ns) if self.arm.blocks() == 0 => self.busy = Busy::Until(now_ns + dwell_ns),
            Busy::Until(at) | Busy::Servo(at) if now_ns >= at => self.finish(now_ns),
            Busy::Homing(at) if now_ns >= at => {
                self.arm.put(self.park_mm);
                self.finish(now_ns);
            }
            Busy::Free => {
                let Some(command) = self.queue.front().cloned() else { return false };
                self.execute(&command, now_ns);
            }
            _ => return false,
        }
        true
    }

    /// Puts lines into the queue while it has room; urgent ones act at once.
    fn read(&mut self, now_ns: i64) {
        while self.queue.len() < QUEUE_LEN {
            let Some(byte) = self.rx.pop_front() else { return };
            match byte {
                b'\n' | b'\r' => {
                    self.comment = false;
                    let line = String::from_utf8_lossy(&self.line).trim_start().to_owned();
                    self.line.clear();
                    if !line.is_empty() {
                        self.take(line, now_ns);
                    }
                    if self.busy == Busy::Dead {
                        return;
                    }
                }
                b';' => self.comment = true,
                _ if self.comment || self.line.len() >= COMMAND_LEN - 1 => {}
                _ => self.line.push(byte),
            }
        }
    }

    fn take(&mut self, line: String, now_ns: i64) {
        if line.starts_with('N') {
            let renumber = line.contains("M110");
            let number_at = if renumber { line.rfind('N').unwrap_or(0) } else { 0 };
            let number = leading(&line[number_at + 1..]) as i64;
            if number != self.last_number + 1 && !renumber {
                return self.refuse_line("Line Number is not Last Line Number+1, Last Line: ");
            }
            let Some(star) = line.rfind('*') else {
                return self.refuse_line("No Checksum with line number, Last Line: ");
            };
            let sum = line.as_bytes()[..star].iter().fold(0, |sum, byte| sum ^ byte);
            if leading(&line[star + 1..]) as i64 != i64::from(sum) {
                return self.refuse_line("checksum mismatch, Last Line: ");
            }
            self.last_number = number;
        }
        match line.as_str() {
            _ if line.starts_with("M112") => {
                self.arm.kill(now_ns);
                self.first_move_ns = None;
                self.say("Error:Printer halted. kill() called!\r\n//action:poweroff\r\n");
                self.busy = Busy::Dead;
                return;
            }
            _ if line.starts_with("M410") => {
                self.quick_stop(now_ns);
                // A move that waited for room is not planned any more.
                if let Busy::PlannerFull { .. } = self.busy {
                    self.busy = Busy::Until(self.cleaning_until_ns);
                }
            }
            _ => {}
        }
        self.queue.push_back(line);
    }

    fn quick_stop(&mut self, now_ns: i64) {
        self.arm.kill(now_ns);
        self.first_move_ns = None;
        // Marlin 1.1 drops moves for a while and works on what follows.
        self.cleaning_until_ns = if self.uarm.is_some() { now_ns } else { now_ns + CLEANING_NS };
    }

    fn refuse_line(&mut self, why: &str) {
        self.rx.clear();
        let last = self.last_number;
        self.say(&format!("Error:{why}{last}\r\nResend: {}\r\nok\r\n", last + 1));
    }

    /// The command at the head of the queue is done.
    fn finish(&mut self, now_ns: i64) {
        let command = self.queue.pop_front().unwrap_or_default();
        let mut ok = self.uarm.as_mut().map_or_else(|| String::from("ok"), uarm_3::Answer::take);
        if self.advanced_ok {
            if let Some(numbered) = command.strip_prefix('N') {
                ok.push_str(&format!(" N{}", leading(numbered)));
            }
            let (blocks, room) = (BLOCKS - self.arm.blocks().min(BLOCKS), QUEUE_LEN - self.queue.len());
            ok.push_str(&format!(" P{blocks} B{room}"));
        }
        ok.push_str("\r\n");
        self.say(&ok);
        self.busy = Busy::Command(now_ns + COMMAND_NS);
    }

    fn execute(&mut self, line: &str, now_ns: i64) {
        self.busy_said_ns = now_ns;
        let text = line.split('*').next().unwrap_or("");
        let text = match text.strip_prefix('N') {
            Some(numbered) => numbered.trim_start_matches(|c: char| c.is_ascii_digit()).trim_start(),
            None => text,
        };
        let Some(text) = self.untagged(text, now_ns) else { return };
        let letter = text.chars().next().unwrap_or(' ').to_ascii_uppercase();
        let code = leading(text.get(1..).unwrap_or("")) as u32;
        let word = |letter: char| -> Option<f64> {
            let rest = text.get(1..)?;
            let at = rest.find(letter)?;
            Some(leading(&rest[at + 1..]))
        };
        match (letter, code) {
            ('G', 0 | 1) => return self.travel([word('X'), word('Y'), word('Z')], word('F')),
            ('G', 4) => {
                let ms = word('P').unwrap_or(0.0) + 1000.0 * word('S').unwrap_or(0.0);
                self.busy = Busy::Sync((ms * 1e6) as i64);
                return;
            }
            ('G', 28) => {
                self.arm.kill(now_ns);
                self.first_move_ns = None;
                self.busy = Busy::Homing(now_ns + HOMING_NS);
                return;
            }
            ('G', 90 | 91) => self.relative = code == 91,
            ('M', 410) if !self.emergency_parser => {
                self.quick_stop(now_ns);
                self.busy = Busy::Until(self.cleaning_until_ns);
                return;
            }
            // Worked on, it sets the number once more.
            ('M', 110) => self.last_number = word('N').map_or(self.last_number, |number| number as i64),
            ('G', 21 | 94 | 17) | ('M', 410 | 17 | 18 | 82 | 84 | 999) => {}
            ('M', 106) => self.grip(word('S').unwrap_or(255.0) > 0.0),
            ('M', 107) => self.grip(false),
            ('M', 280) => {
                self.grip(word('S').unwrap_or(0.0) > 45.0);
                self.busy = Busy::Servo(now_ns + SERVO_NS);
                return;
            }
            ('M', 400) => {
                self.busy = Busy::Sync(0);
                return;
            }
            ('M', 114) if !self.keepalive => {
                self.busy = Busy::Standing;
                return;
            }
            ('M', 114) => self.say_position(),
            ('M', 115) => self.say(&format!(
                "FIRMWARE_NAME:Marlin 2.1.2.5 (Dec  1 2024 12:00:00) SOURCE_CODE_URL:github.com/MarlinFirmware/Marlin \
                 PROTOCOL_VERSION:1.0 MACHINE_TYPE:Arm EXTRUDER_COUNT:0 UUID:cede2a2f-41a2-4748-9b12-c55c62f367ff\r\n\
                 Cap:EEPROM:1\r\nCap:EMERGENCY_PARSER:{}\r\n",
                u8::from(self.emergency_parser)
            )),
            ('M', 119) => {
                let probe = if self.holds_part { "TRIGGERED" } else { "open" };
                self.say(&format!(
                    "Reporting endstop status\r\nx_min: open\r\ny_min: open\r\nz_min: open\r\nz_probe: {probe}\r\n"
                ));
            }
            _ => self.say(&format!("echo:Unknown command: \"{text}\"\r\n")),
        }
        self.finish(now_ns);
    }

    fn say_position(&mut self) {
        let [x, y, z] = self.arm.destination();
        let steps = [x * 80.0, y * 80.0, z * 400.0];
        self.say(&format!(
            "X:{x:.2} Y:{y:.2} Z:{z:.2} E:0.00 Count X:{:.0} Y:{:.0} Z:{:.0}\r\n",
            steps[0], steps[1], steps[2]
        ));
    }

    fn travel(&mut self, words: [Option<f64>; 3], feed: Option<f64>) {
        if let Some(feed) = feed.filter(|&feed| feed > 0.0) {
            self.feed_mm_min = feed;
        }
        let mut to_mm = self.arm.destination();
        for (axis, word) in words.iter().enumerate() {
            let Some(value) = word else { continue };
            to_mm[axis] = value + if self.relative { to_mm[axis] } else { 0.0 };
        }
        if self.noise.refuses() {
            match &mut self.uarm {
                Some(answer) => answer.refuse("E22"),
                None => self.say("echo:Home XYZ First\r\n"),
            }
            to_mm = self.arm.destination();
        }
        self.busy = Busy::PlannerFull { to_mm, speed_mm_s: self.feed_mm_min / 60.0 };
    }

    fn grip(&mut self, close: bool) {
        if close && !self.closed {
            self.holds_part = self.noise.holds();
            self.arm.motions.push_back(Motion::Closed { holds_part: self.holds_part });
        } else if self.closed && !close {
            self.holds_part = false;
            self.arm.motions.push_back(Motion::Opened);
        }
        self.closed = close;
    }
}

/// The number at the begin of a text, 0 where there is none.
fn leading(text: &str) -> f64 {
    let text = text.trim_start();
    let end = text
        .char_indices()
        .find(|&(at, c)| !(c.is_ascii_digit() || c == '.' || (at == 0 && matches!(c, '-' | '+'))))
        .map_or(text.len(), |(at, _)| at);
    text[..end].parse().unwrap_or(0.0)
}

#[cfg(test)]
mod tests;
