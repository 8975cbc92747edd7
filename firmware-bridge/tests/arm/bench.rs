//! A cell's dialect and a simulated arm on one serial line, on a simulated clock.

use crate::cell::{Cell, Way};
use firmware_bridge::config::{DialectName, Settings};
use firmware_bridge::dialect::TRANSMIT_LEN_MIN;
use firmware_bridge::message::{ArmAxes, Command, Pick, Pose, Refusal, Report, Seen};
use firmware_bridge::simulate::{Faults, Motion, SimulatedArm};
use std::collections::VecDeque;

pub(crate) const MS: i64 = 1_000_000;
/// Ten bits at 115200 baud.
const BYTE_NS: i64 = 86_806;
/// From one end of the line to the other, unless a campaign wants it slower.
const LATENCY_NS: i64 = 200_000;
/// The tool's rest, out of the cameras' view.
pub(crate) const PARK_MM: [f64; 3] = [-200.0, -200.0, 250.0];

/// Every dialect that the contract holds for.
pub(crate) const DIALECTS: [DialectName; 4] =
    [DialectName::Own, DialectName::Grbl, DialectName::Marlin, DialectName::Uarm];

pub(crate) fn settings(dialect: DialectName) -> Settings {
    let text = "[workspace]\nmin_mm = [-200, -200, 0]\nmax_mm = [200, 200, 300]\n\
                [arm]\nbanner_wait_ms = 300\npick_timeout_ms = 60000\n";
    let mut settings = Settings::parse(text).unwrap();
    settings.arm.dialect = dialect;
    if dialect != DialectName::Own {
        settings.arm.axes = ArmAxes::Xyz;
        settings.arm.moves.clear = vec!["G0 X-200 Y-200 Z250 F12000".into()];
    }
    settings
}

/// One direction of the line: bytes with the moments when they leave and arrive.
struct Wire {
    latency_ns: i64,
    bytes: VecDeque<(i64, u8)>,
    free_ns: i64,
}

impl Wire {
    fn new(latency_ns: i64) -> Self {
        Self { latency_ns, bytes: VecDeque::new(), free_ns: 0 }
    }

    fn put(&mut self, bytes: &[u8], now_ns: i64) {
        self.free_ns = self.free_ns.max(now_ns);
        for &byte in bytes {
            self.free_ns += BYTE_NS;
            self.bytes.push_back((self.free_ns, byte));
        }
    }

    /// Throws away what has not left yet.
    fn purge(&mut self, now_ns: i64) {
        self.bytes.retain(|&(left_ns, _)| left_ns <= now_ns);
        self.free_ns = now_ns;
    }

    fn take(&mut self, now_ns: i64) -> Option<u8> {
        let (left_ns, byte) = *self.bytes.front()?;
        (left_ns + self.latency_ns <= now_ns).then(|| {
            self.bytes.pop_front();
            byte
        })
    }

    fn next_ns(&self) -> Option<i64> {
        self.bytes.front().map(|(left_ns, _)| left_ns + self.latency_ns)
    }
}

/// The line, both its ends, the clock, and what was seen so far.
pub(crate) struct Bench {
    pub(crate) now_ns: i64,
    pub(crate) cell: Cell,
    pub(crate) arm: SimulatedArm,
    settings: Settings,
    to_arm: Wire,
    to_cell: Wire,
    written: Option<(i64, u64)>,
    /// The cable is out: bytes vanish.
    pub(crate) cut: bool,
    pub(crate) reports: Vec<(i64, Report)>,
    pub(crate) motions: Vec<(i64, Motion)>,
    pub(crate) session: u32,
    sequence: u32,
    idle_steps: u32,
}

impl Bench {
    pub(crate) fn new(way: Way, dialect: DialectName, faults: Faults) -> Self {
        Self::with(way, settings(dialect), dialect, faults, LATENCY_NS)
    }

    /// A cell that expects one dialect and an arm that speaks another.
    pub(crate) fn of_two(cell: DialectName, arm: DialectName, faults: Faults) -> Self {
        Self::with(Way::Serial, settings(cell), arm, faults, LATENCY_NS)
    }

    /// With settings and a delay of the line of one's own.
    pub(crate) fn with(
        way: Way,
        settings: Settings,
        arm: DialectName,
        faults: Faults,
        latency_ns: i64,
    ) -> Self {
        let mut bench = Self {
            now_ns: 1_000 * MS,
            cell: Cell::new(way, &settings, 100),
            arm: SimulatedArm::new(arm, PARK_MM, faults),
            settings,
            to_arm: Wire::new(latency_ns),
            to_cell: Wire::new(latency_ns),
            written: None,
            cut: false,
            reports: Vec::new(),
            motions: Vec::new(),
            session: 0,
            sequence: 0,
            idle_steps: 0,
        };
        bench.cell.on_link(true, bench.now_ns);
        bench
    }

    /// The cell's process is killed and another one starts: it knows nothing, but bytes under way stay under way.
    pub(crate) fn kill_cell(&mut self, session_seed: u32) {
        if !self.cell.kill_driver(&self.settings, session_seed) {
            self.written = None;
            self.cell.on_link(true, self.now_ns);
        }
    }

    /// The bridge's process is killed and another one starts, where there is one.
    pub(crate) fn kill_bridge(&mut self, session_seed: u32) {
        if self.cell.kill_bridge(&self.settings, session_seed) {
            self.written = None;
            self.cell.on_link(true, self.now_ns);
        }
    }

    pub(crate) fn command(&mut self, command: Command) -> Result<(), Refusal> {
        let answer = self.cell.command(command, self.now_ns);
        self.exchange();
        answer
    }

    /// Runs until `now_ns + duration_ns`, or until `stop` says so of a report.
    pub(crate) fn run_until(&mut self, duration_ns: i64, mut stop: impl FnMut(&Report) -> bool) -> bool {
        let end_ns = self.now_ns + duration_ns;
        loop {
            let seen = self.reports.len();
            self.exchange();
            if self.reports[seen..].iter().any(|(_, report)| stop(report)) {
                return true;
            }
            if self.now_ns >= end_ns {
                return false;
            }
            self.step(end_ns);
        }
    }

    pub(crate) fn run(&mut self, duration_ns: i64) {
        self.run_until(duration_ns, |_| false);
    }

    /// Moves the clock to the next moment when anything happens, at most to `end_ns`.
    fn step(&mut self, end_ns: i64) {
        let next = [
            self.cell.next_deadline_ns(),
            self.arm.next_deadline_ns(),
            self.to_arm.next_ns(),
            self.to_cell.next_ns(),
            self.written.map(|(at, _)| at),
            Some(self.to_arm.free_ns).filter(|&free| free > self.now_ns),
            Some(end_ns),
        ];
        let next_ns = next.into_iter().flatten().min().unwrap_or(end_ns);
        self.idle_steps = if next_ns > self.now_ns { 0 } else { self.idle_steps + 1 };
        assert!(
            self.idle_steps < 1000,
            "somebody wants to be woken for ever without anything to do at {}: cell {:?}, arm {:?}",
            self.now_ns,
            self.cell.next_deadline_ns(),
            self.arm.next_deadline_ns(),
        );
        // A pty or USB adapter wakes nobody more often than this.
        self.now_ns = next_ns.max(self.now_ns + 20_000).min(end_ns.max(self.now_ns));
    }

    /// Everything that can happen at this moment.
    fn exchange(&mut self) {
        loop {
            let before = (self.reports.len(), self.motions.len());
            let mut quiet = true;
            while let Some(byte) = self.to_arm.take(self.now_ns) {
                quiet = false;
                if !self.cut {
                    self.arm.on_bytes(&[byte], self.now_ns);
                }
            }
            while let Some(motion) = self.arm.poll(self.now_ns) {
                self.motions.push((self.now_ns, motion));
            }
            let mut out = [0; TRANSMIT_LEN_MIN];
            loop {
                let len = self.arm.transmit(self.now_ns, &mut out);
                if len == 0 {
                    break;
                }
                self.trace("<", &out[..len]);
                self.to_cell.put(&out[..len], self.now_ns);
            }
            while let Some(byte) = self.to_cell.take(self.now_ns) {
                quiet = false;
                if !self.cut {
                    self.cell.on_bytes(&[byte], self.now_ns);
                    self.poll_cell();
                }
            }
            self.poll_cell();
            self.transmit_cell();
            self.poll_cell();
            if quiet && before == (self.reports.len(), self.motions.len()) {
                return;
            }
        }
    }

    /// With `BENCH_TRACE` set, what both sides say is printed as it is said.
    fn trace(&self, way: &str, bytes: &[u8]) {
        if std::env::var_os("BENCH_TRACE").is_some() {
            println!("{:>9.3} {way} {}", self.now_ns as f64 / 1e9, bytes.escape_ascii());
        }
    }

    fn poll_cell(&mut self) {
        while let Some(report) = self.cell.poll(self.now_ns) {
            if let Report::Connected { session, .. } = report {
                self.session = session;
                self.sequence = 0;
            }
            self.reports.push((self.now_ns, report));
        }
    }

    fn transmit_cell(&mut self) {
        if let Some((at_ns, id)) = self.written.filter(|(at_ns, _)| *at_ns <= self.now_ns) {
            self.written = None;
            self.cell.on_written(id, at_ns);
        }
        let mut out = [0; TRANSMIT_LEN_MIN];
        loop {
            // While bytes are being written only urgent ones may come; asking for them would also make others.
            let busy = self.to_arm.free_ns > self.now_ns;
            if busy && !self.cell.has_urgent() {
                return;
            }
            let sent = self.cell.transmit(self.now_ns, &mut out);
            if sent.urgent {
                self.to_arm.purge(self.now_ns);
                self.written = None;
            }
            if sent.len == 0 {
                return;
            }
            self.trace(if sent.urgent { "!>" } else { ">" }, &out[..sent.len]);
            self.to_arm.put(&out[..sent.len], self.now_ns);
            if let Some(id) = sent.pick {
                self.written = Some((self.to_arm.free_ns, id));
            }
        }
    }

    /// A pick seen 20 ms ago, with x and y of its own, so that no damage to one number makes it another pick.
    pub(crate) fn pick(&mut self, id: u64) -> Pick {
        self.sequence += 1;
        let [x, y] = [id, id * 37].map(|n| (n % 500) as f64 * 0.5 - 125.0);
        let at = |x, y, z| Pose { position_mm: [x, y, z], orientation_xyzw: [1.0, 0.0, 0.0, 0.0] };
        let seen_ns = self.now_ns - 20 * MS;
        Pick {
            id,
            session: self.session,
            sequence: self.sequence,
            seen: Seen { left_ns: seen_ns, right_ns: seen_ns + MS, period_ns: 33 * MS },
            deadline_ms: 66,
            ttl_ms: 500,
            recognised_mm: [x, y, 10.0],
            approach: at(x, y, 50.0),
            grasp: at(x, y, 10.0),
            retreat: at(x, y, 70.0),
            place: at(150.0, 150.0, 20.0),
            opening_mm: 8.0,
            slot: 0,
        }
    }

    /// Shakes hands, releases and waits until the arm is ready.
    pub(crate) fn make_ready(&mut self) {
        assert!(self.run_until(20_000 * MS, |r| matches!(r, Report::Connected { .. })), "{}", self.tail());
        self.run(50 * MS);
        self.command(Command::Release).unwrap();
        assert!(self.run_until(20_000 * MS, |r| matches!(r, Report::Ready { .. })), "{}", self.tail());
        self.run(50 * MS);
    }

    /// The moments and targets of all motions begun since `from_ns`.
    pub(crate) fn begun(&self, from_ns: i64) -> Vec<(i64, [f64; 3])> {
        let begun = |&(at_ns, motion): &(i64, Motion)| match motion {
            Motion::Began { to_mm } if at_ns >= from_ns => Some((at_ns, to_mm)),
            _ => None,
        };
        self.motions.iter().filter_map(begun).collect()
    }

    /// The newest reports, for messages of failed checks.
    pub(crate) fn tail(&self) -> String {
        let told = self.reports.iter().filter(|(_, report)| !matches!(report, Report::Heartbeat { .. }));
        let told: Vec<_> = told.map(|(at_ns, report)| format!("{} ms {report:?}", at_ns / MS)).collect();
        told[told.len().saturating_sub(15)..].join("\n")
    }

    pub(crate) fn has(&self, wanted: impl Fn(&Report) -> bool) -> bool {
        self.reports.iter().any(|(_, report)| wanted(report))
    }
}
