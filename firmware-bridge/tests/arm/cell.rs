//! The cell's side of the line: a dialect in its own process, or one in a bridge behind shared memory.

use firmware_bridge::config::Settings;
use firmware_bridge::dialect::{Dialect, Transmit};
use firmware_bridge::link::shared::{ArmRecord, BridgeEnd, CellEnd, CellRecord};
use firmware_bridge::message::{Command, Refusal, Report};

/// How the cell reaches the serial line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Way {
    /// The driver has the port.
    Serial,
    /// Driver, shared memory, bridge; records are read so long after they were published.
    SharedMemory {
        /// Delay, ns.
        delay_ns: i64,
    },
}

/// What stands at the cell's end of the line.
#[derive(Debug)]
#[allow(clippy::large_enum_variant)]
pub(crate) enum Cell {
    Serial(Dialect),
    SharedMemory(Bridged),
}

/// Driver and bridge with a slot each way that holds the newest record only.
#[derive(Debug)]
pub(crate) struct Bridged {
    driver: CellEnd,
    bridge: BridgeEnd,
    dialect: Dialect,
    to_bridge: Slot<CellRecord>,
    to_driver: Slot<ArmRecord>,
    /// The driver's process is stopped.
    stopped: bool,
}

/// Where one side publishes and the other reads, some time later, what is newest then.
#[derive(Debug)]
struct Slot<R> {
    delay_ns: i64,
    newest: Option<R>,
    read_ns: i64,
}

impl<R> Slot<R> {
    fn new(delay_ns: i64) -> Self {
        Self { delay_ns, newest: None, read_ns: 0 }
    }

    fn publish(&mut self, record: R, now_ns: i64) {
        if self.newest.replace(record).is_none() {
            self.read_ns = now_ns + self.delay_ns;
        }
    }

    fn read(&mut self, now_ns: i64) -> Option<R> {
        if self.read_ns <= now_ns { self.newest.take() } else { None }
    }

    fn next_ns(&self) -> Option<i64> {
        self.newest.is_some().then_some(self.read_ns)
    }
}

impl Bridged {
    /// Everything that happens in both processes at this moment.
    fn carry(&mut self, now_ns: i64) {
        while let Some(report) = self.dialect.poll(now_ns) {
            self.bridge.on_report(report);
        }
        if let Some(record) = self.driver.record(now_ns).filter(|_| !self.stopped) {
            self.to_bridge.publish(record, now_ns);
        }
        let mut to_arm = |command| self.dialect.command(command, now_ns);
        if let Some(record) = self.to_bridge.read(now_ns) {
            self.bridge.on_record(&record, now_ns, &mut to_arm);
        }
        self.bridge.run_timers(now_ns, &mut to_arm);
        if let Some(record) = self.bridge.record(now_ns) {
            self.to_driver.publish(record, now_ns);
        }
        if let Some(record) = self.to_driver.read(now_ns).filter(|_| !self.stopped) {
            self.driver.on_record(&record, now_ns);
        }
    }

    fn next_ns(&self) -> i64 {
        let driver_ns = if self.stopped { i64::MAX } else { self.driver.next_deadline_ns() };
        let own = driver_ns.min(self.bridge.next_deadline_ns());
        self.to_bridge.next_ns().into_iter().chain(self.to_driver.next_ns()).fold(own, i64::min)
    }
}

impl Cell {
    pub(crate) fn new(way: Way, settings: &Settings, seed: u32) -> Self {
        let dialect = Dialect::new(settings, seed).unwrap();
        match way {
            Way::Serial => Cell::Serial(dialect),
            Way::SharedMemory { delay_ns } => Cell::SharedMemory(Bridged {
                driver: CellEnd::new(settings, seed ^ 0xA5A5),
                bridge: BridgeEnd::new(settings, seed ^ 0x5A5A),
                dialect,
                to_bridge: Slot::new(delay_ns),
                to_driver: Slot::new(delay_ns),
                stopped: false,
            }),
        }
    }

    fn dialect(&mut self) -> &mut Dialect {
        match self {
            Cell::Serial(dialect) => dialect,
            Cell::SharedMemory(bridged) => &mut bridged.dialect,
        }
    }

    pub(crate) fn on_link(&mut self, up: bool, now_ns: i64) {
        self.dialect().on_link(up, now_ns);
    }

    pub(crate) fn on_bytes(&mut self, bytes: &[u8], now_ns: i64) {
        self.dialect().on_bytes(bytes, now_ns);
    }

    pub(crate) fn command(&mut self, command: Command, now_ns: i64) -> Result<(), Refusal> {
        match self {
            Cell::Serial(dialect) => dialect.command(command, now_ns),
            Cell::SharedMemory(bridged) => {
                let answer = bridged.driver.command(command, now_ns);
                bridged.carry(now_ns);
                answer
            }
        }
    }

    pub(crate) fn poll(&mut self, now_ns: i64) -> Option<Report> {
        match self {
            Cell::Serial(dialect) => dialect.poll(now_ns),
            Cell::SharedMemory(bridged) => {
                bridged.carry(now_ns);
                if bridged.stopped { None } else { bridged.driver.poll(now_ns) }
            }
        }
    }

    pub(crate) fn transmit(&mut self, now_ns: i64, out: &mut [u8]) -> Transmit {
        self.dialect().transmit(now_ns, out)
    }

    pub(crate) fn has_urgent(&mut self) -> bool {
        self.dialect().has_urgent()
    }

    pub(crate) fn on_written(&mut self, id: u64, at_ns: i64) {
        self.dialect().on_written(id, at_ns);
    }

    pub(crate) fn next_deadline_ns(&self) -> Option<i64> {
        match self {
            Cell::Serial(dialect) => dialect.next_deadline_ns(),
            Cell::SharedMemory(bridged) => Some(
                bridged.dialect.next_deadline_ns().map_or(bridged.next_ns(), |at| at.min(bridged.next_ns())),
            ),
        }
    }

    /// The driver's process is stopped, or goes on, where it is not the one with the port.
    pub(crate) fn stop_driver(&mut self, stop: bool) {
        if let Cell::SharedMemory(bridged) = self {
            bridged.stopped = stop;
        }
    }

    /// The process that decides is killed and another one starts. True where the port stays open in between.
    pub(crate) fn kill_driver(&mut self, settings: &Settings, seed: u32) -> bool {
        match self {
            Cell::Serial(dialect) => {
                *dialect = Dialect::new(settings, seed).unwrap();
                false
            }
            Cell::SharedMemory(bridged) => {
                bridged.driver = CellEnd::new(settings, seed);
                true
            }
        }
    }

    /// The process that has the port is killed and another one starts. False where there is no such process beside
    /// the driver's.
    pub(crate) fn kill_bridge(&mut self, settings: &Settings, seed: u32) -> bool {
        match self {
            Cell::Serial(_) => false,
            Cell::SharedMemory(bridged) => {
                bridged.dialect = Dialect::new(settings, seed).unwrap();
                bridged.bridge = BridgeEnd::new(settings, seed);
                true
            }
        }
    }
}
