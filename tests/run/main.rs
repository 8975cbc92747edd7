//! `pickcell run` as a whole program, on the session that comes with the project and on bad input.

mod live;

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use firmware_bridge::message::{Command as ArmCommand, Failure, HeldBy, Pick, Pose, Refusal, Report, Seen};
use firmware_bridge::outside::has_room;
use pickcell::camera::Side;
use pickcell::session::events::{CommandRecord, ReportRecord, Topic};
use pickcell::session::{About, RecordingWriter, Session};
use pickcell::time::Timestamp;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use tempfile::TempDir;

/// A copy of the project's cell in a folder of its own, changed by replacing text.
struct Cell {
    folder: TempDir,
}

impl Cell {
    fn new(changes: &[(&str, &str)]) -> Self {
        let project = Path::new(env!("CARGO_MANIFEST_DIR"));
        let mut text = fs::read_to_string(project.join("cell.toml")).unwrap();
        let replay = format!("{}/", project.join("replay").display());
        text = text.replace("\"replay/", &format!("\"{replay}"));
        for (from, to) in changes {
            assert!(text.contains(from), "{from:?} is in cell.toml");
            text = text.replacen(from, to, 1);
        }
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("cell.toml"), text).unwrap();
        Self { folder }
    }

    fn fast(changes: &[(&str, &str)]) -> Self {
        Self::new(&[&[("pace = \"realtime\"", "pace = \"fast\"")], changes].concat())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn command(&self, args: &[&str]) -> Command {
        // The tests may run under nohup, which a program would heed.
        let mut command = Command::new("env");
        command.args(["--default-signal=HUP", env!("CARGO_BIN_EXE_pickcell")]);
        command.arg("run").args(args).current_dir(self.folder.path()).env_remove("NOTIFY_SOCKET");
        command
    }

    fn run(&self, args: &[&str]) -> Output {
        self.command(args).output().unwrap()
    }
}

fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

/// The number behind a name in the table.
fn row(table: &str, name: &str) -> Option<u64> {
    let line = table.lines().find(|line| line.trim_start().starts_with(name))?;
    line.trim_start()[name.len()..].split_whitespace().next()?.parse().ok()
}

#[test]
fn a_session_gives_a_line_and_a_picture_a_pair_and_a_table() {
    let cell = Cell::fast(&[]);
    let output = cell.run(&[]);
    let text = stdout(&output);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    for i in 0..20 {
        assert!(text.contains(&format!("\npair {i:04}  ")) || text.starts_with("pair 0000  "), "{i}: {text}");
        let picture = image::open(cell.path(&format!("out/{i:04}.png"))).unwrap();
        assert!(picture.width() > 1280 && picture.height() == 480);
    }
    assert_eq!((row(&text, "pairs"), row(&text, "frames")), (Some(20), Some(40)));
    assert!(row(&text, "parts found").unwrap() > 80, "{text}");
    assert_eq!(row(&text, "targets sent"), row(&text, "targets done"));
    assert!(row(&text, "targets sent").unwrap() >= 1);
    assert!(text.contains("no target: arm busy") && text.contains("frame to wire"));
    assert!(fs::read_to_string(cell.path("out/place.state")).unwrap().contains("next_slot = 1"));
}

#[test]
fn a_picture_that_cannot_be_written_takes_no_line_and_no_table() {
    let cell = Cell::fast(&[]);
    fs::create_dir_all(cell.path("out/0003.png/in-the-way")).unwrap();
    let output = cell.run(&[]);
    let (text, said) = (stdout(&output), stderr(&output));
    assert!(!output.status.success() && said.contains("the cell goes on without overlay pictures"), "{said}");
    assert!(text.contains("\npair 0019  ") && row(&text, "pairs") == Some(20), "{text}");
    assert!(row(&text, "targets sent").unwrap() >= 1);
}

#[test]
fn lines_may_be_left_to_the_pairs_where_something_changes() {
    let lines = |lines: &str| {
        let output = Cell::fast(&[]).run(&["--overlay", "none", "--lines", lines]);
        stdout(&output).lines().filter(|line| line.starts_with("pair ")).map(why).collect::<Vec<_>>()
    };
    fn why(line: &str) -> String {
        // Without the target's number, which is another in every run.
        line.rsplit_once("  ").unwrap().1.replace(char::is_numeric, "")
    }
    let all = lines("all");
    assert_eq!(all.len(), 20);
    let mut changes = all.clone();
    changes.dedup_by(|b, a| a == b && !b.starts_with("target"));
    assert!(changes.len() < 20);
    assert_eq!(lines("changes"), changes);
    assert!(lines("none").is_empty());
}

#[test]
fn a_fast_session_is_the_same_every_time() {
    let results = || fast_lines(&Cell::fast(&[]));
    assert_eq!(results(), results());
}

/// The lines of pairs, without what differs from run to run.
fn pair_lines(output: &Output) -> Vec<Value> {
    assert_eq!(output.status.code(), Some(0), "{}", stderr(output));
    let mut lines: Vec<Value> =
        stdout(output).lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    lines.pop();
    for line in &mut lines {
        let line = line.as_object_mut().unwrap();
        line.remove("time_ms");
        line.remove("deadline_kept");
        // Numbers of targets rise from run to run.
        let sent = line["target"].is_number();
        line.insert("target".into(), sent.into());
    }
    lines
}

fn fast_lines(cell: &Cell) -> Vec<Value> {
    pair_lines(&cell.run(&["--format", "json", "--overlay", "none", "--seed", "5"]))
}

#[test]
fn a_recorded_run_is_the_same_when_it_is_run_again() {
    let settings = "[recording]\nfolder = \"recordings\"\n[realtime]";
    let cell = Cell::fast(&[("[realtime]", settings)]);
    let lines = fast_lines(&cell);
    let files: Vec<_> = fs::read_dir(cell.path("recordings")).unwrap().map(|e| e.unwrap().path()).collect();
    let [file] = &files[..] else { panic!("one file a run: {files:?}") };
    let again = Cell::fast(&[("session = \"", &format!("session = \"{}\" # \"", file.display()))]);
    assert_eq!(fast_lines(&again), lines);
    assert_eq!(lines.len(), 20);
}

#[test]
fn a_run_under_its_deadline_replayed_gives_the_same_targets() {
    // Four seconds of the conveyor, at its own pace: some targets of an arm that takes its time.
    let cell = Cell::new(&[(
        "[realtime]",
        "[realtime]\nscheduling = \"normal\"\n[recording]\nfolder = \"recordings\"\n",
    )]);
    let conveyor = Path::new(env!("CARGO_MANIFEST_DIR")).join("replay/conveyor");
    for side in ["left", "right"] {
        fs::create_dir_all(cell.path("long").join(side)).unwrap();
        for i in 0..120 {
            let picture = conveyor.join(format!("{side}/{:04}.jpg", i % 20));
            fs::copy(picture, cell.path(&format!("long/{side}/{i:04}.jpg"))).unwrap();
        }
    }
    fs::write(cell.path("long/session.toml"), "rate_hz = 30").unwrap();
    let play = |cell: &Cell, path: &Path| {
        let text = fs::read_to_string(cell.path("cell.toml")).unwrap();
        let text =
            text.replacen(&format!("\"{}\"", conveyor.display()), &format!("\"{}\"", path.display()), 1);
        // Without place records: how long the disk takes for one is not repeated.
        let (head, tail) = (text.find("[place]").unwrap(), text.find("[realtime]").unwrap());
        fs::write(cell.path("cell.toml"), text[..head].to_owned() + &text[tail..]).unwrap();
    };
    play(&cell, &cell.path("long"));
    let lines = |cell: &Cell| -> Vec<Value> {
        let mut lines = pair_lines(&cell.run(&["--format", "json", "--overlay", "none"]));
        // A pair for which there was no time is not searched again either.
        lines.retain(|line| !line["parts"].is_null());
        lines
    };
    let recorded = lines(&cell);
    let file = fs::read_dir(cell.path("recordings")).unwrap().next().unwrap().unwrap().path();
    let again = Cell::fast(&[("seed = 1 ", "seed = 77 ")]);
    play(&again, &file);
    let replayed = lines(&again);
    assert!(recorded.iter().filter(|line| line["target"] == true).count() >= 2, "{recorded:?}");
    for (before, after) in recorded.iter().zip(&replayed) {
        assert_eq!(before, after);
    }
    assert_eq!(recorded.len(), replayed.len());
}

/// A pick as a recording holds it, and what the arm said to it and when, ms.
type Answered<'a> = (u64, &'a [(i64, Report)]);

/// The session of the project as a recording, with an arm of one's own.
fn recording(path: &Path, picks: &[Answered<'_>]) {
    let mut writer = RecordingWriter::create(path, &About::default()).unwrap();
    let conveyor = Session::open(&Path::new(env!("CARGO_MANIFEST_DIR")).join("replay/conveyor")).unwrap();
    for pair in &conveyor.pairs {
        for (side, picture) in Side::BOTH.into_iter().zip(&pair.pictures) {
            let mut frame = picture.as_ref().unwrap().read().unwrap();
            frame.timestamp = Timestamp(1 + pair.after_ns);
            writer.frame(side, &mut frame).unwrap();
        }
    }
    let report = |writer: &mut RecordingWriter, ms: i64, report: Report| {
        writer.record(Topic::Report, Timestamp(ms * 1_000_000), &ReportRecord { report }).unwrap();
    };
    report(&mut writer, 0, Report::Connected { session: 3, held_by: HeldBy::Start });
    for (n, (id, answers)) in picks.iter().enumerate() {
        let at_ms = 1000 * n as i64;
        let pose = Pose { position_mm: [0.0; 3], orientation_xyzw: [1.0, 0.0, 0.0, 0.0] };
        let pick = Pick {
            id: *id,
            session: 3,
            sequence: 1,
            seen: Seen::default(),
            deadline_ms: 0,
            ttl_ms: 0,
            recognised_mm: [0.0; 3],
            approach: pose,
            grasp: pose,
            retreat: pose,
            place: pose,
            opening_mm: 8.0,
            slot: 0,
        };
        let record = CommandRecord { command: ArmCommand::Pick(pick), refused: None };
        writer.record(Topic::Command, Timestamp(at_ms * 1_000_000), &record).unwrap();
        answers.iter().for_each(|&(after_ms, answer)| report(&mut writer, at_ms + after_ms, answer));
    }
    writer.finish().unwrap();
}

#[test]
fn a_recorded_arm_answers_as_it_did_until_its_answers_are_used_up() {
    let ready = Report::Ready { clear_of_view: true };
    let refused = Report::Refused { id: 6, refusal: Refusal::Unreachable };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    recording(
        &path,
        &[
            (
                5,
                &[
                    (2, Report::Sent { id: 5, at_ns: 0 }),
                    (4, Report::Accepted { id: 5 }),
                    (10, Report::Moving { id: 5 }),
                    (90, Report::Failed { id: 5, failure: Failure::PartNotHeld }),
                    (95, ready),
                ],
            ),
            (6, &[(3, Report::Sent { id: 6, at_ns: 0 }), (8, refused), (9, ready)]),
        ],
    );
    let cell = Cell::fast(&[("session = \"", &format!("session = \"{}\" # \"", path.display()))]);
    let output = cell.run(&["--overlay", "none"]);
    let (text, log) = (stdout(&output), stderr(&output));
    assert_eq!(output.status.code(), Some(0), "{log}");
    assert!(log.contains("the arm answers as that of the recorded session did"), "{log}");
    let said = [
        "failed: the part was not held",
        "refused: the arm cannot reach it",
        "answers of the recorded session's arm are used up",
        "arm on hold (RecordingOver)",
    ];
    let places: Vec<_> = said.iter().map(|words| log.find(words)).collect();
    assert!(places.iter().all(Option::is_some) && places.is_sorted(), "{places:?} in {log}");
    assert_eq!((row(&text, "targets failed"), row(&text, "targets refused")), (Some(1), Some(2)), "{text}");
    assert!(row(&text, "no target: on hold").unwrap() > 5, "{text}");
}

#[test]
fn a_recording_that_cannot_be_made_does_not_stop_the_cell() {
    let cell = Cell::fast(&[("[realtime]", "[recording]\nfolder = \"cell.toml/x\"\n[realtime]")]);
    let output = cell.run(&["--overlay", "none"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(stderr(&output).contains("the cell runs without a recording"), "{}", stderr(&output));
    assert_eq!(row(&stdout(&output), "pairs"), Some(20));
    let broken = |table: &str, message: &str| {
        let output = Cell::new(&[("[realtime]", &format!("[recording]\n{table}\n[realtime]"))]).run(&[]);
        assert_eq!(output.status.code(), Some(2));
        assert!(stderr(&output).contains(message), "{message:?} in {}", stderr(&output));
    };
    broken(
        "folder = \"x\"\nfile_mb_max = 0",
        "recording.file_mb_max = 0 is not possible; allowed: 1 to 10000000 MB",
    );
    broken("folder = \"\"", "recording.folder");
    broken("folder = \"x\"\npictures = \"some\"", "recording.pictures");
}

#[test]
fn a_session_at_its_own_pace_ends_by_itself() {
    let cell = Cell::new(&[]);
    let output = cell.run(&["--overlay", "none", "--iterations", "2000"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let text = stdout(&output);
    assert_eq!(row(&text, "pairs"), Some(20), "{text}");
    assert_eq!(text.lines().filter(|line| line.starts_with("pair ")).count(), 20);
    assert!(stderr(&output).contains("arm connected"));
}

/// A session that would take long; `then` is told when its first line is there.
fn disturbed(changes: &[(&str, &str)], then: impl Fn(Pid)) -> (i32, String, String) {
    let cell = Cell::new(changes);
    let session = cell.path("session");
    fs::create_dir(&session).unwrap();
    let conveyor = Path::new(env!("CARGO_MANIFEST_DIR")).join("replay/conveyor");
    for side in ["left", "right"] {
        std::os::unix::fs::symlink(conveyor.join(side), session.join(side)).unwrap();
    }
    fs::write(session.join("session.toml"), "rate_hz = 4.0").unwrap();
    let toml = fs::read_to_string(cell.path("cell.toml")).unwrap();
    let own = toml.replace(&format!("session = \"{}\"", conveyor.display()), "session = \"session\"");
    assert_ne!(toml, own);
    fs::write(cell.path("cell.toml"), own).unwrap();
    let mut child =
        cell.command(&["--overlay", "none"]).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let mut text = lines.next().unwrap().unwrap() + "\n";
    then(Pid::from_child(&child));
    lines.for_each(|line| text += &(line.unwrap() + "\n"));
    let output = child.wait_with_output().unwrap();
    (output.status.code().unwrap_or(-1), text, stderr(&output))
}

/// Runs a cell whose results nobody reads, for which there is no room any more; gives its exit code.
fn unread(cell: &Cell, then: impl Fn(Pid)) -> Option<i32> {
    let (_reader, mut writer) = std::io::pipe().unwrap();
    while has_room(&writer, Duration::ZERO) {
        writer.write_all(&[b'x'; 4096]).unwrap();
    }
    let mut run = cell.command(&["--overlay", "none", "--iterations", "2000"]);
    let mut child = run.stdout(writer.try_clone().unwrap()).stderr(writer).spawn().unwrap();
    let until = Instant::now() + Duration::from_secs(60);
    loop {
        then(Pid::from_child(&child));
        match child.try_wait().unwrap() {
            Some(status) => break status.code(),
            None if Instant::now() > until => {
                child.kill().unwrap();
                panic!("it waits for its reader");
            }
            None => std::thread::sleep(Duration::from_millis(20)),
        }
    }
}

#[test]
fn a_session_that_waits_for_its_reader_ends_when_it_is_told_to() {
    let begun = Instant::now();
    let told = |pid| {
        if begun.elapsed() > Duration::from_secs(1) {
            kill_process(pid, Signal::TERM).unwrap();
        }
    };
    assert_eq!(unread(&Cell::fast(&[]), told), Some(0));
    assert!(begun.elapsed() > Duration::from_secs(1), "it waited");
}

#[test]
fn a_reader_that_stands_still_holds_up_nothing() {
    let cell = Cell::new(&[]);
    assert_eq!(unread(&cell, |_| {}), Some(0));
    let record = fs::read_to_string(cell.path("out/place.state")).unwrap();
    assert!(!record.contains("next_slot = 0"), "a target was sent: {record}");
}

#[test]
fn sigterm_and_sigint_hold_the_arm_print_the_table_and_exit_with_0() {
    for signal in [Signal::TERM, Signal::INT] {
        let (code, text, log) = disturbed(&[], |pid| kill_process(pid, signal).unwrap());
        assert_eq!(code, 0, "{log}");
        assert!(row(&text, "pairs").unwrap() < 20 && text.contains("latency, ms"), "{text}");
    }
}

#[test]
fn an_arm_that_waits_for_the_operator_moves_after_sigusr1() {
    let manual = [("resume = \"auto\"", "resume = \"manual\"")];
    let (code, text, log) = disturbed(&manual, |pid| {
        kill_process(pid, Signal::USR1).unwrap();
    });
    assert_eq!(code, 0, "{log}");
    assert!(log.contains("arm on hold (Start); release it with SIGUSR1"), "{log}");
    assert!(row(&text, "targets done").unwrap() >= 1, "{text}");
}

#[test]
fn a_short_soak_keeps_its_deadlines_and_its_memory() {
    // The deadline is a generous one: this runs unoptimised on a busy machine.
    let cell = Cell::new(&[("# deadline_ms = 66.7", "deadline_ms = 5000.0")]);
    let output = cell.run(&["--soak", "60", "--raw"]);
    let text = stdout(&output);
    assert_eq!(output.status.code(), Some(0), "{text}{}", stderr(&output));
    assert!(text.contains("soak passed: 60 pairs, no deadline missed, memory flat"), "{text}");
    assert!(!cell.path("out/0000.png").exists() && !text.contains("pair 0000"));
    // A budget in iterations is used up, deadline or not, and takes ten times as long on any machine.
    let slow = Cell::new(&[
        ("# deadline_ms = 66.7", "deadline_ms = 1.0"),
        ("search = \"auto\"", "search = \"harmony\""),
    ]);
    let output = slow.run(&["--soak", "5", "--iterations", "1000000"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains(" of 5 deadlines missed"), "{}", stderr(&output));
    // Nor is it well because nobody reads on.
    let (reader, unread) = std::io::pipe().unwrap();
    drop(reader);
    let mut run = slow.command(&["--soak", "5", "--iterations", "1000000"]);
    assert_eq!(run.stdout(unread).stderr(Stdio::null()).status().unwrap().code(), Some(1));
}

#[test]
fn bad_input_is_named_with_its_remedy_and_ends_with_2() {
    let broken = |cell: &Cell, args: &[&str], message: &str| {
        let output = cell.run(args);
        assert_eq!(output.status.code(), Some(2), "{message}: {}", stderr(&output));
        assert!(stderr(&output).contains(message), "{message:?} in {}", stderr(&output));
        assert_eq!(stdout(&output), "");
    };
    broken(&Cell::new(&[]), &["--cell", "nowhere.toml"], "nowhere.toml: cannot read it");
    broken(&Cell::new(&[]), &["--seed", "abc"], "invalid value 'abc'");
    broken(&Cell::new(&[]), &["--rate", "30"], "--soak");
    broken(&Cell::new(&[]), &["--soak", "9", "--overlay", "all"], "cannot be used with '--overlay");
    broken(&Cell::new(&[]), &["--soak", "9", "--lines", "all"], "cannot be used with '--lines");
    let wide = Cell::new(&[("# pair_window_ms = 13.3", "pair_window_ms = 40.0")]);
    broken(
        &wide,
        &[],
        "cameras.pair_window_ms = 40 is not possible; allowed: milliseconds above 0, at most half a frame",
    );
    broken(&Cell::new(&[]), &["--soak", "9", "--rate", "fast"], "from 0.1 to 1000");
    broken(&Cell::new(&[("pace = \"realtime\"", "pace = \"slow\"")]), &[], "pace");
    // Last night's grasps at any other rate are for no real arm.
    let real = ("link = \"replay\"", "link = \"shared-memory\"");
    let fast = Cell::new(&[real, ("pace = \"realtime\"", "pace = \"fast\"")]);
    broken(&fast, &[], "cameras.pace = \"fast\" plays recorded pairs in other than their time");
    broken(&Cell::new(&[real]), &["--soak", "9"], "--soak plays recorded pairs");
    let cell = Cell::new(&[]);
    fs::create_dir(cell.path("out")).unwrap();
    fs::write(cell.path("out/place.state"), "garbage").unwrap();
    broken(&cell, &[], "empty the tray and remove the file");
    let cell = Cell::new(&[]);
    fs::write(cell.path("out"), "a file").unwrap();
    broken(&cell, &[], "cannot read or write it");
    let project = Path::new(env!("CARGO_MANIFEST_DIR")).join("replay/conveyor\"");
    let empty = Cell::new(&[(&format!("session = \"{}", project.display()), "session = \".\"")]);
    broken(&empty, &[], "session.toml: cannot read it");
}

#[test]
fn a_log_that_cannot_be_written_does_not_stop_the_cell() {
    let cell = Cell::fast(&[]);
    let full = || Stdio::from(fs::File::options().write(true).open("/dev/full").unwrap());
    let output = cell.command(&["--overlay", "none"]).stderr(full()).output().unwrap();
    assert_eq!((output.status.code(), row(&stdout(&output), "pairs")), (Some(0), Some(20)));
    let status = cell.command(&["--overlay", "none"]).stdout(full()).stderr(Stdio::null()).status().unwrap();
    assert_eq!(status.code(), Some(1));
}

#[test]
fn a_terminal_that_hangs_up_ends_the_cell_well() {
    let cell = Cell::new(&[("\"realtime\"", "\"realtime\"")]);
    let mut child =
        cell.command(&["--overlay", "none"]).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    lines.next().unwrap().unwrap();
    kill_process(Pid::from_child(&child), Signal::HUP).unwrap();
    let text: Vec<_> = lines.map(Result::unwrap).collect();
    assert_eq!(child.wait().unwrap().code(), Some(0));
    assert!(row(&text.join("\n"), "pairs").unwrap() < 20, "{text:?}");
}
