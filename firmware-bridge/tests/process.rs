//! The program itself: simulated arm, bridge and a driver's end of the shared memory, as processes.

use clap::ValueEnum;
use firmware_bridge::config::Settings;
use firmware_bridge::link::{Link, clock_ns};
use firmware_bridge::message::{ArmAxes, Command, Disconnect, Pick, Pose, Refusal, Report, Seen};
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command as Process, Stdio};

const MS: i64 = 1_000_000;
/// No check waits longer for anything.
const PATIENCE_NS: i64 = 30_000 * MS;

/// A process of the program; killed at the end of the test if it still runs.
struct Running(Child);

impl Running {
    fn start(arguments: &[&str]) -> Self {
        // The tests may run under nohup, which a program would heed.
        let mut process = Process::new("env");
        process.args(["--default-signal=HUP", env!("CARGO_BIN_EXE_firmware-bridge")]).args(arguments);
        Self(process.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap())
    }

    fn terminate(&mut self) -> Option<i32> {
        let pid = rustix::process::Pid::from_child(&self.0);
        rustix::process::kill_process(pid, rustix::process::Signal::TERM).unwrap();
        self.0.wait().unwrap().code()
    }

    fn end(mut self) -> (Option<i32>, String) {
        let code = self.0.wait().unwrap().code();
        let mut said = String::new();
        self.0.stderr.take().unwrap().read_to_string(&mut said).unwrap();
        (code, said)
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn wait_for_file(path: &Path) {
    let start_ns = clock_ns();
    while !path.exists() {
        assert!(clock_ns() - start_ns < PATIENCE_NS, "{} does not appear", path.display());
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
}

fn simulate(pty: &Path, dialect: &str, more: &[&str]) -> Running {
    let arguments = ["simulate", "--pty", pty.to_str().unwrap(), "--dialect", dialect];
    let arm = Running::start(&[&arguments[..], more].concat());
    wait_for_file(pty);
    arm
}

/// A cell.toml in `folder`, with a service name of this process's own.
fn write_cell(folder: &Path, name: &str, link: &str) -> (PathBuf, Settings) {
    let path = folder.join("cell.toml");
    let service = format!("test-{}-{name}", std::process::id());
    let text = format!(
        "[arm]\nlink = \"{link}\"\nport = \"arm\"\nservice = \"{service}\"\n\
         [workspace]\nmin_mm = [-300, -300, 0]\nmax_mm = [300, 300, 300]\n"
    );
    std::fs::write(&path, text).unwrap();
    let settings = Settings::read(&path).unwrap();
    (path, settings)
}

/// Polls until a report is what is waited for; gives it.
fn wait_report(link: &mut Link, wanted: impl Fn(&Report) -> bool) -> Report {
    let start_ns = clock_ns();
    let mut seen = Vec::new();
    loop {
        while let Some(report) = link.poll(clock_ns()) {
            if wanted(&report) {
                return report;
            }
            seen.push(report);
        }
        assert!(clock_ns() - start_ns < PATIENCE_NS, "only {seen:?}");
        link.wait(link.next_deadline_ns().unwrap_or(i64::MAX).min(clock_ns() + 100 * MS), None);
    }
}

fn wait_connected(link: &mut Link) -> u32 {
    match wait_report(link, |r| matches!(r, Report::Connected { .. })) {
        Report::Connected { session, .. } => session,
        _ => unreachable!("that was waited for"),
    }
}

fn pick(id: u64, session: u32) -> Pick {
    let at = |x, y, z| Pose { position_mm: [x, y, z], orientation_xyzw: [1.0, 0.0, 0.0, 0.0] };
    let now_ns = clock_ns();
    Pick {
        id,
        session,
        sequence: id as u32,
        seen: Seen { left_ns: now_ns - 2 * MS, right_ns: now_ns - MS, period_ns: 33 * MS },
        // A test machine may be busy.
        deadline_ms: 3000,
        ttl_ms: 3000,
        recognised_mm: [10.0, 20.0, 10.0],
        approach: at(10.0, 20.0, 50.0),
        grasp: at(10.0, 20.0, 10.0),
        retreat: at(10.0, 20.0, 70.0),
        place: at(100.0, 100.0, 20.0),
        opening_mm: 8.0,
        slot: 0,
    }
}

/// Releases, waits until the arm is ready and a picture after that could have been taken, and picks.
fn place_one(link: &mut Link, session: u32, id: u64) {
    link.command(Command::Release, clock_ns()).unwrap();
    wait_report(link, |r| matches!(r, Report::Ready { .. }));
    std::thread::sleep(std::time::Duration::from_millis(20));
    link.command(Command::Pick(pick(id, session)), clock_ns()).unwrap();
    wait_report(link, |r| *r == Report::Done { id });
}

#[test]
fn the_own_dialect_picks_over_a_pty() {
    pick_over_a_pty("own");
}

#[test]
fn grbl_picks_over_a_pty() {
    pick_over_a_pty("grbl");
}

#[test]
fn marlin_picks_over_a_pty() {
    pick_over_a_pty("marlin");
}

#[test]
fn uarm_picks_over_a_pty() {
    pick_over_a_pty("uarm");
}

/// A serial driver places a part with the simulated arm, which then ends cleanly.
fn pick_over_a_pty(dialect: &str) {
    let folder = tempfile::tempdir().unwrap();
    let pty = folder.path().join("arm");
    let placed = folder.path().join("placed");
    let note = format!("echo placed >>{}", placed.display());
    let mut arm = simulate(&pty, dialect, &["--format", "json", "--on-place", &note]);
    let (_, mut settings) = write_cell(folder.path(), "serial", "serial");
    settings.arm.dialect = firmware_bridge::config::DialectName::from_str(dialect, false).unwrap();
    settings.arm.banner_wait_ms = 200;
    if dialect != "own" {
        settings.arm.axes = ArmAxes::Xyz;
    }
    let mut link = Link::open(&settings, 7).unwrap();
    let session = wait_connected(&mut link);
    place_one(&mut link, session, 1);
    wait_for_file(&placed);
    assert_eq!(arm.terminate(), Some(0));
    assert!(!pty.is_symlink(), "the link is removed");
    let said: Vec<String> =
        BufReader::new(arm.0.stdout.take().unwrap()).lines().map(Result::unwrap).collect();
    let grasp = "\"motion\": \"arrived\", \"at_mm\": [10.000, 20.000, 10.000] }";
    assert_eq!(said.iter().filter(|line| line.ends_with(grasp)).count(), 1, "{said:?}");
    assert_eq!(said.iter().filter(|line| line.contains("\"holds_part\": true")).count(), 1, "{said:?}");
    wait_report(&mut link, |r| *r == Report::Disconnected { cause: Disconnect::PortGone });
}

#[test]
fn targets_go_through_shared_memory_and_either_side_may_be_killed() {
    let folder = tempfile::tempdir().unwrap();
    let _arm = simulate(&folder.path().join("arm"), "own", &[]);
    let (cell, settings) = write_cell(folder.path(), "shared", "shared-memory");
    let run = ["run", "--cell", cell.to_str().unwrap()];
    // The driver first, the bridge later.
    let mut link = Link::open(&settings, 7).unwrap();
    assert_eq!(link.command(Command::Release, clock_ns()), Err(Refusal::NotConnected));
    let mut bridge = Running::start(&run);
    let session = wait_connected(&mut link);
    place_one(&mut link, session, 1);
    // The bridge is killed in the middle of a pick and comes back.
    std::thread::sleep(std::time::Duration::from_millis(20));
    link.command(Command::Pick(pick(2, session)), clock_ns()).unwrap();
    wait_report(&mut link, |r| *r == Report::Moving { id: 2 });
    bridge.0.kill().unwrap();
    wait_report(&mut link, |r| *r == Report::Lost { id: 2 });
    bridge.0.wait().unwrap();
    let mut bridge = Running::start(&run);
    let second = wait_connected(&mut link);
    assert_ne!(second, session);
    place_one(&mut link, second, 3);
    // Another driver takes over where one ended without a word.
    drop(link);
    let mut link = Link::open(&settings, 8).unwrap();
    let third = wait_connected(&mut link);
    let early = link.command(Command::Pick(pick(4, third)), clock_ns());
    assert_eq!(early, Err(Refusal::OnHold));
    place_one(&mut link, third, 5);
    let second_driver = Link::open(&settings, 9).unwrap_err().to_string();
    assert!(second_driver.contains("another driver already uses"), "{second_driver}");
    assert_eq!(bridge.terminate(), Some(0));
}

#[test]
fn wrong_usage_ends_with_2_and_a_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let run = |text: &str| {
        let cell = folder.path().join("cell.toml");
        std::fs::write(&cell, text).unwrap();
        Running::start(&["run", "--cell", cell.to_str().unwrap()]).end()
    };
    let workspace = "[workspace]\nmin_mm = [0, 0, 0]\nmax_mm = [1, 1, 1]\n";
    let (code, said) = run(&format!("{workspace}[arm]\nlink = \"shared-memory\"\n"));
    assert!(code == Some(2) && said.contains("arm.port is missing"), "{said}");
    let (code, said) = run(&format!("{workspace}[arm]\nport = \"/dev/no-such-arm\"\n"));
    assert!(code == Some(2) && said.contains("/dev/no-such-arm") && said.contains("plugged in"), "{said}");
    let (code, said) = run("[workspace]\n");
    assert!(code == Some(2) && said.contains("min_mm"), "{said}");
    let (code, said) = Running::start(&["run", "--cell", "/no/such.toml"]).end();
    assert!(code == Some(2) && said.contains("/no/such.toml") && said.contains("--cell"), "{said}");
    let taken = folder.path().join("taken");
    std::fs::write(&taken, "").unwrap();
    let (code, said) =
        Running::start(&["simulate", "--pty", taken.to_str().unwrap(), "--dialect", "own"]).end();
    assert!(code == Some(2) && said.contains("choose another name for --pty"), "{said}");
    assert!(taken.exists(), "somebody else's file stays");
    let (code, said) =
        Running::start(&["simulate", "--pty", "x", "--dialect", "own", "--faults", "fire"]).end();
    assert!(code == Some(2) && said.contains("lost-bytes"), "{said}");
}

#[test]
fn a_bridge_that_meets_another_dialect_ends_with_2() {
    use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
    let folder = tempfile::tempdir().unwrap();
    let printer = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
    grantpt(&printer).unwrap();
    unlockpt(&printer).unwrap();
    let device = ptsname(&printer, Vec::new()).unwrap().into_string().unwrap();
    let (cell, settings) = write_cell(folder.path(), "dialect", "shared-memory");
    let text = std::fs::read_to_string(&cell).unwrap();
    let text = text.replace("\"arm\"", &format!("\"{device}\"\nhandshake_timeout_ms = 50"));
    std::fs::write(&cell, text).unwrap();
    let mut bridge = Running::start(&["run", "--cell", cell.to_str().unwrap()]);
    let start_ns = clock_ns();
    while bridge.0.try_wait().unwrap().is_none() {
        assert!(
            clock_ns() - start_ns < PATIENCE_NS,
            "{}: the bridge takes text for an arm",
            settings.arm.service
        );
        let _ = rustix::io::write(&printer, b"echo:Unknown command: \r\nok\r\n");
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    let (code, said) = bridge.end();
    assert!(code == Some(2) && said.contains("no arm of this dialect: check arm.dialect"), "{said}");
}

#[test]
fn a_service_of_another_kind_is_named_with_a_remedy() {
    use iceoryx2::prelude::*;
    let folder = tempfile::tempdir().unwrap();
    let (_, settings) = write_cell(folder.path(), "taken", "shared-memory");
    set_log_level(LogLevel::Fatal);
    let node = NodeBuilder::new().create::<ipc::Service>().unwrap();
    let name = format!("pickcell/{}/to-arm", settings.arm.service);
    let _other = node
        .service_builder(&name.as_str().try_into().unwrap())
        .publish_subscribe::<u64>()
        .open_or_create()
        .unwrap();
    let said = Link::open(&settings, 1).unwrap_err().to_string();
    assert!(
        said.contains("is taken by something else") && said.contains("choose another arm.service"),
        "{said}"
    );
}

#[test]
fn a_log_that_cannot_be_written_stops_nothing_and_a_failure_is_a_line_of_it() {
    let full = || Stdio::from(std::fs::File::options().write(true).open("/dev/full").unwrap());
    let mut program = Process::new(env!("CARGO_BIN_EXE_firmware-bridge"));
    program.args(["run", "--cell", "/nowhere/cell.toml"]);
    assert_eq!(program.stderr(full()).status().unwrap().code(), Some(2));
    let said = program.args(["--log-format", "json"]).stderr(Stdio::piped()).output().unwrap();
    let line = String::from_utf8(said.stderr).unwrap();
    assert!(line.starts_with('{') && line.contains("ERROR") && line.contains("/nowhere/cell.toml"), "{line}");
}

#[test]
fn the_journal_gets_priorities_and_a_bridge_waits_for_its_arm() {
    use std::os::unix::fs::MetadataExt;
    let folder = tempfile::tempdir().unwrap();
    let journal = |name: &str| {
        let file = std::fs::File::create(folder.path().join(name)).unwrap();
        let about = file.metadata().unwrap();
        (file, format!("{}:{}", about.dev(), about.ino()))
    };
    let (cell, _) = write_cell(folder.path(), "journal", "shared-memory");
    let program = |wait: &[&str], name: &str| {
        let (file, stream) = journal(name);
        let mut program = Process::new(env!("CARGO_BIN_EXE_firmware-bridge"));
        program.args(["run", "--cell", cell.to_str().unwrap()]).args(wait);
        Running(program.env("JOURNAL_STREAM", stream).stderr(file).spawn().unwrap())
    };
    let mut hasty = program(&[], "hasty");
    assert_eq!(hasty.0.wait().unwrap().code(), Some(2));
    let said = std::fs::read_to_string(folder.path().join("hasty")).unwrap();
    assert!(said.starts_with("<3>firmware-bridge: cannot open the arm's serial port"), "{said}");
    let mut patient = program(&["--wait"], "patient");
    let said = || std::fs::read_to_string(folder.path().join("patient")).unwrap();
    let wait_for = |words: &str| {
        let start_ns = clock_ns();
        while !said().contains(words) {
            assert!(clock_ns() - start_ns < PATIENCE_NS, "{words:?} in {}", said());
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
    };
    wait_for("<6>the bridge stands port=");
    let _arm = simulate(&folder.path().join("arm"), "own", &[]);
    wait_for("<6>arm report=Connected");
    assert_eq!(patient.terminate(), Some(0));
}

#[test]
fn a_hang_up_ends_a_bridge_well() {
    let folder = tempfile::tempdir().unwrap();
    let _arm = simulate(&folder.path().join("arm"), "own", &[]);
    let (cell, _) = write_cell(folder.path(), "hangup", "shared-memory");
    let mut bridge = Running::start(&["run", "--cell", cell.to_str().unwrap()]);
    let mut log = BufReader::new(bridge.0.stderr.take().unwrap()).lines();
    log.by_ref().find(|line| line.as_ref().unwrap().contains("Connected")).expect("the arm is met").unwrap();
    let pid = rustix::process::Pid::from_child(&bridge.0);
    rustix::process::kill_process(pid, rustix::process::Signal::HUP).unwrap();
    assert_eq!(bridge.0.wait().unwrap().code(), Some(0));
    assert!(log.map(Result::unwrap).last().unwrap().contains("the bridge ends"));
}
