//! A controller with Grbl 1.1h, as its documentation and its behaviour on a wire describe it.
//!
//! Real-time bytes act when they arrive; lines wait in a receive buffer of 128 bytes, whose overflow is lost. `ok`
//! means planned; with 15 blocks planned the next line waits. Spindle, coolant and dwells wait until the arm
//! stands, and while they do the state is `Idle`. A hold decelerates (`Hold:1`, then `Hold:0`) and stops the reading
//! of lines; a soft reset in motion raises ALARM:3 and half a second passes before the banner. Homing answers
//! nothing until it has ended. The work offset is the park position, so that `MPos` is zero at the start.

use super::grbl_block::{self, Block, Command, Modal};
use super::motion::Mechanics;
use super::noise::Noise;
use super::{Faults, Motion};
use std::collections::VecDeque;

const MS: i64 = 1_000_000;
const RX_LEN: usize = 128;
const LINE_LEN: usize = 80;
const BLOCKS: usize = 15;
/// From power to banner.
const BOOT_NS: i64 = 800 * MS;
/// Reading, parsing and planning one line.
const LINE_NS: i64 = 900_000;
/// `report_alarm_message` waits so long after an alarm.
const ALARM_NS: i64 = 500 * MS;
const HOMING_NS: i64 = 3000 * MS;
const RAPID_MM_S: f64 = 200.0;
const BANNER: &str = "\r\nGrbl 1.1h ['$' for help]\r\n";
const LOCKED: &str = "[MSG:'$H'|'$X' to unlock]\r\n";

/// What the main program is doing.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Busy {
    /// Not powered yet.
    Off,
    /// Until the banner.
    Boot(i64),
    /// Until the message of an alarm is out; then the reset that raised it goes on.
    AlarmMessage(i64),
    /// Hard or soft limit: nothing but a reset helps.
    Locked,
    /// Between two lines.
    Line(i64),
    /// A move waits for a free block.
    PlannerFull { to_mm: [f64; 3], speed_mm_s: f64 },
    /// Waits for standstill, then does this.
    Sync(After),
    /// A dwell.
    Dwell(i64),
    /// Homing; answers nothing.
    Homing(i64),
    /// Reads lines.
    Free,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum After {
    Dwell(f64),
    Outputs { spindle_on: bool, coolant_on: bool },
}

/// The simulated controller.
#[derive(Debug)]
pub struct GrblFirmware {
    park_mm: [f64; 3],
    noise: Noise,
    arm: Mechanics,
    busy: Busy,
    alarm: bool,
    check: bool,
    /// A hold was asked for or is on.
    held: bool,
    homing_enabled: bool,
    modal: Modal,
    rx: VecDeque<u8>,
    line: Vec<u8>,
    overflow: bool,
    comment: Option<u8>,
    /// Reports until the next work offset in a status.
    wco_counter: u8,
    asked: bool,
    reset_asked: bool,
    holds_part: bool,
    spindle_on: bool,
    coolant_on: bool,
    out: VecDeque<u8>,
}

impl GrblFirmware {
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
            check: false,
            held: false,
            homing_enabled: false,
            modal: Modal::new(),
            rx: VecDeque::with_capacity(RX_LEN),
            line: Vec::with_capacity(LINE_LEN),
            overflow: false,
            comment: None,
            wco_counter: 0,
            asked: false,
            reset_asked: false,
            holds_part: false,
            spindle_on: false,
            coolant_on: false,
            out: VecDeque::with_capacity(512),
        }
    }

    /// The same with limit switches (`$22=1`): locked until `$H` or `$X` after every start.
    pub fn with_homing(park_mm: [f64; 3], faults: Faults) -> Self {
        Self { homing_enabled: true, alarm: true, ..Self::new(park_mm, faults) }
    }

    /// Bytes that arrive.
    pub fn on_bytes(&mut self, bytes: &[u8], now_ns: i64) {
        self.run(now_ns);
        for &byte in bytes {
            match byte {
                // The processor is still in its boot loader.
                _ if matches!(self.busy, Busy::Off | Busy::Boot(_)) => {}
                0x18 => self.reset_asked = true,
                b'?' => self.asked = true,
                b'!' => self.hold(now_ns),
                b'~' => self.resume(now_ns),
                0x84 => self.hold(now_ns),
                0x80.. => {}
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
            Busy::Boot(at) | Busy::AlarmMessage(at) | Busy::Line(at) | Busy::Dwell(at) | Busy::Homing(at) => {
                Some(at)
            }
            Busy::Off => Some(i64::MIN),
            _ => None,
        };
        [busy, self.arm.next_ns(), self.noise.restart_ns()].into_iter().flatten().min()
    }

    /// The button: power-on without a power-off. Somebody puts the arm back to its park position.
    pub fn reset(&mut self, now_ns: i64) {
        self.arm.kill(now_ns);
        self.arm.put(self.park_mm);
        self.arm.motions.push_back(Motion::Restarted);
        self.outputs(false, false);
        self.out.clear();
        self.alarm = self.homing_enabled;
        self.forget();
        self.busy = Busy::Boot(now_ns + BOOT_NS);
    }

    /// No further faults.
    pub fn heal(&mut self) {
        self.noise.heal();
        self.arm.pace = 1.0;
    }

    /// Raises a soft-limit alarm, as a target beyond the travel does with `$20=1`.
    pub fn soft_limit(&mut self, now_ns: i64) {
        self.arm.kill(now_ns);
        self.say("ALARM:2\r\n[MSG:Reset to continue]\r\n");
        self.outputs(false, false);
        self.alarm = true;
        self.busy = Busy::Locked;
    }

    fn forget(&mut self) {
        self.rx.clear();
        self.line.clear();
        self.overflow = false;
        self.comment = None;
        self.modal = Modal::new();
        self.held = false;
        self.check = false;
        self.asked = false;
        self.reset_asked = false;
        self.noise.forget_restart();
        self.wco_counter = 0;
    }

    fn say(&mut self, text: &str) {
        self.out.extend(text.as_bytes());
    }

    fn hold(&mut self, now_ns: i64) {
        let ignored =
            self.alarm || self.check || matches!(self.busy, Busy::Homing(_) | Busy::Locked | Busy::Off);
        if !ignored && !self.held {
            self.held = true;
            self.arm.hold(now_ns);
        }
    }

    fn resume(&mut self, now_ns: i64) {
        if self.held && self.arm.is_held() {
            self.held = false;
            self.arm.resume(now_ns);
        }
    }

    /// The main program, until it has nothing to do at `now_ns`.
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

    /// One step of the main program; whether there may be another.
    fn step(&mut self, now_ns: i64) -> bool {
        if self.reset_asked && !matches!(self.busy, Busy::Boot(_) | Busy::AlarmMessage(_)) {
            self.soft_reset(now_ns);
            return true;
        }
        let silent =
            matches!(self.busy, Busy::Boot(_) | Busy::AlarmMessage(_) | Busy::Homing(_) | Busy::Locked);
        if self.asked && !silent {
            self.asked = false;
            self.status(now_ns);
        }
        match self.busy {
            Busy::Boot(at) if now_ns >= at => self.banner(),
            Busy::AlarmMessage(at) if now_ns >= at => self.banner(),
            Busy::Homing(at) if now_ns >= at => {
                self.arm.put(self.park_mm);
                self.alarm = false;
                self.reply_ok(now_ns);
            }
            Busy::Dwell(at) if now_ns >= at => self.reply_ok(now_ns),
            Busy::Line(at) if now_ns >= at => self.busy = Busy::Free,
            // A hold suspends the main program wherever it waits or would read on.
            _ if self.held => return false,
            Busy::PlannerFull { to_mm, speed_mm_s } if self.arm.blocks() < BLOCKS => {
                self.arm.plan(to_mm, speed_mm_s);
                self.reply_ok(now_ns);
            }
            Busy::Sync(after) if self.arm.blocks() == 0 => match after {
                After::Dwell(seconds) => self.busy = Busy::Dwell(now_ns + (seconds * 1e9) as i64),
                After::Outputs { spindle_on, coolant_on } => {
                    self.outputs(spindle_on, coolant_on);
                    self.reply_ok(now_ns);
                }
            },
            Busy::PlannerFull { .. } | Busy::Sync(_) => {
                if self.arm.is_moving() || self.arm.blocks() == 0 {
                    return false;
                }
                self.start_cycle(now_ns);
            }
            Busy::Free => return self.read(now_ns),
            _ => return false,
        }
        true
    }

    /// Takes bytes until a line is complete; without bytes the planned moves begin.
    fn read(&mut self, now_ns: i64) -> bool {
        while let Some(byte) = self.rx.pop_front() {
            if matches!(byte, b'\n' | b'\r') {
                self.execute(now_ns);
                self.line.clear();
                self.overflow = false;
                self.comment = None;
                return true;
            }
            match (self.comment, byte) {
                (Some(b'('), b')') => self.comment = None,
                (Some(_), _) => {}
                (None, b'(' | b';') => self.comment = Some(byte),
                (None, 0..=b' ' | b'/') => {}
                (None, _) if self.line.len() >= LINE_LEN - 1 => self.overflow = true,
                (None, _) => self.line.push(byte.to_ascii_uppercase()),
            }
        }
        if self.arm.blocks() > 0 && !self.arm.is_moving() {
            self.start_cycle(now_ns);
            return true;
        }
        false
    }

    fn start_cycle(&mut self, now_ns: i64) {
        self.noise.begin_move(now_ns);
        self.arm.start(now_ns);
    }

    fn reply_ok(&mut self, now_ns: i64) {
        self.say("ok\r\n");
        self.busy = Busy::Line(now_ns + LINE_NS);
    }

    fn reply_error(&mut self, code: u8, now_ns: i64) {
        self.say(&format!("error:{code}\r\n"));
        self.busy = Busy::Line(now_ns + LINE_NS);
    }

    fn execute(&mut self, now_ns: i64) {
        let line = String::from_utf8_lossy(&self.line).into_owned();
        if self.overflow {
            return self.reply_error(11, now_ns);
        }
        if line.is_empty() {
            return self.reply_ok(now_ns);
        }
        if let Some(system) = line.strip_prefix('$') {
            return self.system(system, now_ns);
        }
        if self.alarm {
            return self.reply_error(9, now_ns);
        }
        match grbl_block::parse(&line, &self.modal) {
            Err(code) => self.reply_error(code, now_ns),
            Ok(block) => self.block(block, now_ns),
        }
    }

    fn block(&mut self, block: Block, now_ns: i64) {
        self.modal = block.modal;
        if self.check {
            return self.reply_ok(now_ns);
        }
        match block.command {
            Command::None => self.reply_ok(now_ns),
            Command::Dwell(seconds) => self.busy = Busy::Sync(After::Dwell(seconds)),
            Command::Outputs { spindle_on, coolant_on } => {
                let spindle_on = spindle_on.unwrap_or(self.spindle_on);
                let coolant_on = coolant_on.unwrap_or(self.coolant_on);
                self.busy = Busy::Sync(After::Outputs { spindle_on, coolant_on });
            }
            Command::Move { words, rapid } => {
                let mut to_mm = self.arm.destination();
                for (axis, word) in words.iter().enumerate() {
                    let Some(value) = word else { continue };
                    let base = if self.modal.relative { to_mm[axis] } else { 0.0 };
                    to_mm[axis] = base + value * if self.modal.inches { 25.4 } else { 1.0 };
                }
                if self.noise.refuses() {
                    return self.reply_error(33, now_ns);
                }
                let speed_mm_s = if rapid { RAPID_MM_S } else { self.modal.feed_mm_min / 60.0 };
                self.busy = Busy::PlannerFull { to_mm, speed_mm_s };
            }
        }
    }

    fn system(&mut self, text: &str, now_ns: i64) {
        let idle = !self.arm.is_moving() && self.arm.blocks() == 0 && !self.held && !self.check;
        match text {
            "" => {
                self.say("[HLP:$$ $# $G $I $N $x=val $Nx=line $J=line $SLP $C $X $H ~ ! ? ctrl-x]\r\n");
                self.reply_ok(now_ns);
            }
            "X" => {
                if self.alarm {
                    self.alarm = false;
                    self.say("[MSG:Caution: Unlocked]\r\n");
                }
                self.reply_ok(now_ns);
            }
            "G" => {
                self.say("[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F0 S0]\r\n");
                self.reply_ok(now_ns);
            }
            "C" if self.check => {
                self.say("[MSG:Disabled]\r\n");
                self.reset_asked = true;
            }
            "C" if idle && !self.alarm => {
                self.check = true;
                self.say("[MSG:Enabled]\r\n");
                self.reply_ok(now_ns);
            }
            _ if !idle => self.reply_error(8, now_ns),
            "I" => {
                self.say("[VER:1.1h.20190825:]\r\n[OPT:V,15,128]\r\n");
                self.reply_ok(now_ns);
            }
            "H" if !self.homing_enabled => self.reply_error(5, now_ns),
            "H" => self.busy = Busy::Homing(now_ns + HOMING_NS),
            _ => self.reply_error(3, now_ns),
        }
    }

    fn soft_reset(&mut self, now_ns: i64) {
        let homing = matches!(self.busy, Busy::Homing(_));
        let moving = self.arm.kill(now_ns);
        self.outputs(false, false);
        self.forget();
        if moving || homing {
            self.alarm = true;
            self.say(if homing { "ALARM:6\r\n" } else { "ALARM:3\r\n" });
            self.busy = Busy::AlarmMessage(now_ns + ALARM_NS);
        } else {
            self.banner();
        }
    }

    fn banner(&mut self) {
        self.say(BANNER);
        if self.alarm {
            self.say(LOCKED);
        }
        self.busy = Busy::Free;
    }

    /// Spindle or coolant is the gripper: either closes it.
    fn outputs(&mut self, spindle_on: bool, coolant_on: bool) {
        let (was, is) = (self.spindle_on || self.coolant_on, spindle_on || coolant_on);
        (self.spindle_on, self.coolant_on) = (spindle_on, coolant_on);
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
        } else if self.check {
            "Check"
        } else if self.held {
            if self.arm.is_held() { "Hold:0" } else { "Hold:1" }
        } else if self.arm.is_moving() {
            "Run"
        } else {
            "Idle"
        };
        let at = self.arm.position(now_ns);
        let m = [0, 1, 2].map(|axis| at[axis] - self.park_mm[axis]);
        let free = BLOCKS - self.arm.blocks().min(BLOCKS);
        let mut text = format!(
            "<{state}|MPos:{:.3},{:.3},{:.3}|Bf:{free},{}|FS:0,0",
            m[0],
            m[1],
            m[2],
            RX_LEN - self.rx.len()
        );
        if self.holds_part {
            text.push_str("|Pn:P");
        }
        if self.wco_counter == 0 {
            let w = self.park_mm.map(|v| 0.0 - v);
            text.push_str(&format!("|WCO:{:.3},{:.3},{:.3}", w[0], w[1], w[2]));
        } else if self.wco_counter == 1 {
            text.push_str("|Ov:100,100,100");
        }
        self.wco_counter = (self.wco_counter + 1) % 10;
        text.push_str(">\r\n");
        self.say(&text);
    }
}

#[cfg(test)]
mod tests;
