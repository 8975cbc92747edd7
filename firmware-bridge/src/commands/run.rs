//! `run`: targets from shared memory to a serial arm.

use super::Failure;
use clap::Args;
use firmware_bridge::config::Settings;
use firmware_bridge::link::shared::{BridgeEnd, CellRecord, Ports, Side};
use firmware_bridge::link::{SerialLink, clock_ns, life_number, wait_for};
use firmware_bridge::message::{Command, Report};
use firmware_bridge::realtime::{self, ArmThread, Granted};
use rustix::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::path::PathBuf;

/// How long the arm has to confirm the last hold, ns: a Marlin that goes on needs three and a half seconds to be stopped for good.
const FAREWELL_NS: i64 = 4_000_000_000;
/// So much of the stack is touched before the first target, bytes; the bridge uses less.
const PREFAULT_BYTES: usize = 256 << 10;

#[derive(Args)]
#[command(after_help = "Example:\n  firmware-bridge run --cell cell.toml\n\n\
                        The driver's cell.toml has link = \"shared-memory\" and the same arm.service; arm.port, arm.baud, \
                        arm.dialect and arm.moves are this side's.")]
pub(crate) struct Arguments {
    /// The cell: [arm], [workspace], [gripper] and, of [realtime], what concerns the arm's thread are read, arm.link
    /// is not.
    #[arg(long, default_value = "cell.toml", value_name = "FILE")]
    cell: PathBuf,
    /// Wait for a serial port that is not there or cannot be opened yet, as a service does that is started before it;
    /// else that is an error.
    #[arg(long)]
    wait: bool,
}

/// Both ends of the bridge.
struct Bridge {
    end: BridgeEnd,
    ports: Ports,
    arm: SerialLink,
    /// The arm has answered as it should at least once.
    met: bool,
}

pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let signals = super::catch_signals()?;
    let settings = Settings::read(&arguments.cell)?;
    let thread = ArmThread::read(&arguments.cell)?;
    let arm = match arguments.wait {
        true => SerialLink::open_or_wait(&settings, 1)?,
        false => SerialLink::open(&settings, 1)?,
    };
    let ports =
        Ports::open(&settings.arm.service, Side::Bridge).map_err(firmware_bridge::link::LinkError::from)?;
    tracing::info!(port = %arm.path().display(), service = settings.arm.service, "the bridge stands");
    ask_for_rights(&thread);
    let mut bridge = Bridge { end: BridgeEnd::new(&settings, life_number(2)), ports, arm, met: false };
    let result = bridge.serve(&signals);
    bridge.say_farewell();
    result
}

/// Asks the system for what the arm's thread is to have, and says what came of it.
fn ask_for_rights(thread: &ArmThread) {
    let memory = if thread.lock_memory { realtime::lock_memory() } else { Granted::NotAsked };
    tracing::info!(granted = %memory, "locked memory");
    let rights = realtime::apply(&thread.wish(PREFAULT_BYTES));
    tracing::info!(thread = "arm", sched_fifo = %rights.fifo, cores = %rights.cores, "real-time rights");
}

impl Bridge {
    /// Carries until a signal comes or the arm turns out to be another one.
    fn serve(&mut self, signals: &UnixStream) -> Result<(), Failure> {
        while !super::signalled(signals) {
            let now_ns = clock_ns();
            let arm = &mut self.arm;
            let mut carry = |command: Command| {
                tracing::debug!(?command, "carried");
                arm.command(command, now_ns)
            };
            let had_cell = self.end.has_cell();
            if let Some(record) = self.ports.receive::<CellRecord>() {
                self.end.on_record(&record, now_ns, &mut carry);
            }
            self.end.run_timers(now_ns, &mut carry);
            match (had_cell, self.end.has_cell()) {
                (false, true) => tracing::info!("a driver is there"),
                (true, false) => tracing::warn!("the driver is gone: the arm holds"),
                _ => {}
            }
            while let Some(report) = self.arm.poll(now_ns) {
                self.on_report(report)?;
            }
            if let Some(record) = self.end.record(now_ns) {
                self.ports.publish(&record);
            }
            let until_ns = self.end.next_deadline_ns().min(self.arm.next_deadline_ns().unwrap_or(i64::MAX));
            wait_for(&[Some(self.ports.fd()), self.arm.fd(), Some(signals.as_fd())], until_ns);
        }
        Ok(())
    }

    fn on_report(&mut self, report: Report) -> Result<(), Failure> {
        match report {
            Report::Heartbeat { .. } => {}
            // A restarted arm of the right kind may stammer; one that never spoke right is another one.
            Report::WrongVersion { ours, theirs } if !self.met => {
                return Err(Failure::WrongVersion { ours, theirs });
            }
            Report::WrongDialect if !self.met => return Err(Failure::WrongDialect),
            Report::Connected { .. } => {
                self.met = true;
                tracing::info!(?report, "arm");
            }
            _ => tracing::info!(?report, "arm"),
        }
        self.end.on_report(report);
        Ok(())
    }

    /// The arm holds before the bridge goes, whatever it was doing.
    fn say_farewell(&mut self) {
        let start_ns = clock_ns();
        let _ = self.arm.command(Command::Hold, start_ns);
        loop {
            let now_ns = clock_ns();
            let mut held = false;
            while let Some(report) = self.arm.poll(now_ns) {
                held |= matches!(
                    report,
                    Report::Held { .. } | Report::Disconnected { .. } | Report::Alarm { .. }
                );
            }
            if held || !self.met || now_ns - start_ns > FAREWELL_NS {
                tracing::info!(held, "the bridge ends");
                return;
            }
            wait_for(
                &[self.arm.fd()],
                self.arm.next_deadline_ns().unwrap_or(i64::MAX).min(now_ns + 10_000_000),
            );
        }
    }
}
