//! What `check` finds about the machine: rights for real time, memory, cores, the arm's port, shared memory.

use std::io;
use std::path::Path;
use std::time::Duration;

use firmware_bridge::config::{LinkName, Resume, Settings};
use firmware_bridge::link::{self, SerialError, SharedError, SharedMemoryLink};
use firmware_bridge::message::Report;

use super::Findings;
use crate::cell::realtime::{Granted, Wish, apply, lock_memory};
use crate::commands::run::place;
use crate::config::{Cell, Scheduling};
use crate::files::can_write;
use crate::time::Timestamp;

/// Rights, memory, cores, and the way to the arm.
pub(super) fn check(cell: &Cell, findings: &mut Findings) {
    cores(cell, findings);
    scheduling(cell, findings);
    if cell.realtime.lock_memory {
        locked_memory(findings);
    }
    match cell.arm_side.arm.link {
        LinkName::Replay => findings.ok("arm", "that of the session, or simulated"),
        LinkName::Serial => match &cell.arm_side.arm.port {
            Some(port) => serial_port(port, cell.arm_side.arm.baud, findings),
            None => findings.wrong("arm", "link = \"serial\" needs arm.port"),
        },
        LinkName::SharedMemory => shared_memory(&cell.arm_side, findings),
    }
    arm_times(cell, findings);
    if let Some(place) = &cell.place {
        place_record(&place.state, findings);
    }
    if let Some(recording) = &cell.recording {
        writable("recording.folder", &recording.folder, findings);
    }
}

/// Keys of [arm] that are allowed, and may still not be what one wants.
fn arm_times(cell: &Cell, findings: &mut Findings) {
    let arm = &cell.arm_side.arm;
    if arm.resume == Resume::Auto && arm.link != LinkName::Replay {
        findings.warning(
            "arm.resume",
            "\"auto\": the arm begins to move by itself after a crash, a reset or a restart",
            "write resume = \"manual\" unless nobody can ever stand near the arm",
        );
    }
    let ttl = Duration::from_millis(arm.ttl_ms.into());
    if let Some(deadline) = cell.deadline.filter(|deadline| *deadline >= ttl) {
        findings.warning(
            "arm.ttl_ms",
            format!("targets live {} ms, the deadline is {} ms", ttl.as_millis(), deadline.as_millis()),
            "give targets more time to live than the deadline, or all that use it up come too late",
        );
    }
}

fn cores(cell: &Cell, findings: &mut Findings) {
    let there = std::thread::available_parallelism().map_or(1, usize::from);
    if let Some(core) = cell.realtime.cores.iter().find(|core| **core >= there) {
        findings.error(
            "cores",
            format!("realtime.cores names core {core}, this machine gives cores 0 to {}", there - 1),
            "name cores that are there, or leave the key out",
        );
    } else if there < 2 {
        findings.warning(
            "cores",
            "only one core: the kernel's own workers share it with the cell",
            "give the machine two cores",
        );
    } else {
        findings.ok("cores", format!("{there}"));
    }
}

fn scheduling(cell: &Cell, findings: &mut Findings) {
    if cell.realtime.scheduling == Scheduling::Normal {
        return findings.ok("real-time rights", "not asked for: realtime.scheduling = \"normal\"");
    }
    let realtime = &cell.realtime;
    let priority = realtime.arm_priority.max(realtime.grab_priority).max(realtime.recognise_priority);
    // The only proof is to ask for it, in a thread that ends at once.
    let wish = Wish { fifo_priority: Some(priority), cores: Vec::new(), prefault_bytes: 0 };
    match std::thread::spawn(move || apply(&wish).fifo).join() {
        Ok(Granted::No { errno }) => findings.warning(
            "real-time rights",
            format!(
                "SCHED_FIFO with priority {priority} is refused: {}",
                io::Error::from_raw_os_error(errno)
            ),
            "start the cell by the systemd unit of deploy/ (LimitRTPRIO), or give the user `rtprio 40` in \
             /etc/security/limits.d; without it a busy machine delays targets by many milliseconds",
        ),
        Ok(_) => findings.ok("real-time rights", format!("SCHED_FIFO up to priority {priority} is granted")),
        Err(_) => findings.warning("real-time rights", "not known", "try again"),
    }
}

/// Asks for it as `run` does; it ends with this process.
fn locked_memory(findings: &mut Findings) {
    match lock_memory() {
        Granted::No { errno } => findings.warning(
            "locked memory",
            format!("memory cannot be locked without limit: {}", io::Error::from_raw_os_error(errno)),
            "start the cell by the systemd unit of deploy/ (LimitMEMLOCK), or give the user `memlock unlimited` in \
             /etc/security/limits.d",
        ),
        granted => findings.ok("locked memory", granted.to_string()),
    }
}

fn serial_port(port: &Path, baud: u32, findings: &mut Findings) {
    let subject = "serial port";
    let shown = port.display();
    match link::probe(port, baud) {
        Ok(()) => findings.ok(subject, format!("{shown} can be opened")),
        Err(SerialError::Open { reason, remedy, .. }) => {
            findings.error(subject, format!("{shown}: {reason}"), remedy)
        }
        Err(error) => findings.wrong(subject, error.to_string()),
    }
}

/// Opens the driver's end, as the cell would, and listens whether a bridge answers.
fn shared_memory(settings: &Settings, findings: &mut Findings) {
    let subject = "shared memory";
    let service = &settings.arm.service;
    let mut link = match SharedMemoryLink::open(settings, std::process::id()) {
        Ok(link) => link,
        Err(error @ SharedError::Taken { .. }) => return findings.wrong(subject, error.to_string()),
        Err(error) => {
            // The message carries its remedy behind the colon.
            let text = error.to_string();
            let (what, remedy) = text.rsplit_once(": ").unwrap_or((&text, "try again"));
            return findings.error(subject, what, remedy);
        }
    };
    let end = Timestamp::now().after(Duration::from_millis(u64::from(2 * settings.arm.heartbeat_timeout_ms)));
    while Timestamp::now() < end {
        if let Some(Report::Connected { .. }) = link.poll(Timestamp::now().0) {
            return findings.ok(subject, format!("a bridge answers on service {service:?}"));
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    findings.warning(
        subject,
        format!("service {service:?} can be used, no bridge answers"),
        "start `firmware-bridge run` as the same user; a service must not have PrivateTmp=yes",
    );
}

/// Whether the record of the place pattern can be read, and written anew.
fn place_record(path: &Path, findings: &mut Findings) {
    let subject = "place.state";
    if let Err(error) = place::read(path) {
        return findings.wrong(subject, error.to_string());
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    writable(subject, folder.unwrap_or(Path::new(".")), findings);
}

/// Whether a folder that the cell writes into is there, or can be made.
fn writable(subject: &str, folder: &Path, findings: &mut Findings) {
    let shown = folder.display();
    if !folder.exists() {
        let made = folder.ancestors().find(|ancestor| ancestor.exists() || ancestor.as_os_str().is_empty());
        let above = made.filter(|above| !above.as_os_str().is_empty()).unwrap_or(Path::new("."));
        // Rights say nothing of a file system that takes no files.
        match can_write(above) {
            Ok(()) => findings.ok(subject, format!("{shown} will be made")),
            Err(error) => findings.error(
                subject,
                format!("{shown} is not there and cannot be made: {error}"),
                format!(
                    "make it, with write access for the cell's user, or name another in cell.toml ({subject})"
                ),
            ),
        }
        return;
    }
    // The only proof is a file: rights say nothing of a disk that is full.
    match can_write(folder) {
        Ok(()) => findings.ok(subject, format!("{shown} can be written")),
        Err(error) => findings.error(
            subject,
            format!("{shown} cannot be written: {error}"),
            "give the cell's user write access, and make room on the disk",
        ),
    }
}
