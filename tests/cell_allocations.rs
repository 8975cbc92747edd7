//! The loops of a running cell, with what they say for a recording, take no memory after their first pairs: a
//! counting allocator says so.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::path::Path;
use std::time::Duration;

use firmware_bridge::message::{Command, Report};
use pickcell::arm::Arm;
use pickcell::camera::replay::Pace;
use pickcell::camera::{Camera, Condition, Grab, ReplayCamera, Side};
use pickcell::cell::carrier::Carrier;
use pickcell::cell::core::{Core, Event, Operator, Params, PlaceRecord};
use pickcell::cell::desk::{Desk, Letter, Logged, Paper, Said, Seats};
use pickcell::cell::recogniser::recognise;
use pickcell::frame::FramePair;
use pickcell::recognize::{Recognition, Recognizer};
use pickcell::time::{Budget, Timestamp};

struct Counting;

thread_local! {
    static TAKEN: Cell<u64> = const { Cell::new(0) };
}

// SAFETY: hands every call to the system's allocator unchanged; the counter is a plain thread-local number.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        TAKEN.with(|taken| taken.set(taken.get() + 1));
        // SAFETY: the caller's promises are passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller's promises are passed on.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, new_size: usize) -> *mut u8 {
        TAKEN.with(|taken| taken.set(taken.get() + 1));
        // SAFETY: the caller's promises are passed on.
        unsafe { System.realloc(pointer, layout, new_size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

fn taken_by(work: impl FnOnce()) -> u64 {
    let before = TAKEN.with(Cell::get);
    work();
    TAKEN.with(Cell::get) - before
}

#[test]
fn nothing_is_allocated_between_two_pairs() {
    let project = Path::new(env!("CARGO_MANIFEST_DIR"));
    let cell = pickcell::config::Cell::read(&project.join("cell.toml")).unwrap();
    let rig = pickcell::rig::Rig::read(&cell.rig.calibration).unwrap();
    let parts = pickcell::part::Part::read_all(&cell.recognition.parts).unwrap();
    let mut recognizer = Recognizer::new(cell.recognition_params(), rig, parts).unwrap();
    let session = pickcell::session::Session::open(&project.join("replay/conveyor")).unwrap();
    const PAIRS: usize = 60;
    let sides = ReplayCamera::both(&session, &Pace::Every(Duration::ZERO), PAIRS, true).unwrap();
    let (desk, seats) = Desk::new(2, sides[0].largest_bytes(), 256).unwrap();
    let Seats { mut grabs, mut cold, hub, .. } = seats;
    let [mut left, mut right] = sides.map(Camera::Replay);
    let period_ns = 33_000_000;
    let params = Params {
        window_ns: 13_000_000,
        period_ns,
        deadline_ns: 66_000_000,
        wire_ns: 0,
        ttl_ms: 500,
        handed_over_lag_ns: 0,
        silence_ns: 1_000_000_000,
        iterations: Some(5000),
        seed: 1,
        repeated: Vec::new(),
        first_id: 1,
        place: None,
        record: PlaceRecord::default(),
        defer_ns: 1_000_000_000,
        same_part_mm: 10.0,
    };
    let mut arm = Arm::open(&cell.arm_side, 7).unwrap();
    arm.hasten(20.0);
    let mut now = Timestamp(1_000_000_000_000);
    let mut carrier = Carrier::new(&desk, hub, Core::new(params, &cell.arm_side, now), arm);
    let mut lone_frames = 0;
    let (mut arm_loop, mut recognise_loop, mut sent, mut parts_found) = (0, 0, 0, 0);
    for pair in 0..PAIRS {
        let warm = pair >= PAIRS / 3;
        let count = |total: &mut u64, taken: u64| *total += if warm { taken } else { 0 };
        count(
            &mut arm_loop,
            taken_by(|| {
                for _ in 0..33 {
                    now = Timestamp(now.0 + period_ns / 33);
                    carrier.turn(now);
                }
                carrier.event(&Event::Operator(Operator::Release), now);
                // A frame that nobody will pair, and then the pair.
                let mut lone = grabs[0].free.pop().unwrap();
                lone.bytes.resize(16, 7);
                lone.timestamp = Timestamp(now.0 - 20_000_000);
                carrier.letter(Letter::Frame(Side::Left, lone, Condition::Good, 0), now);
                for (side, camera) in [(Side::Left, &mut left), (Side::Right, &mut right)] {
                    let mut frame = grabs[side.index()].free.pop().unwrap();
                    assert!(matches!(camera.grab(&mut frame, Duration::from_secs(1)), Grab::Frame { .. }));
                    frame.timestamp = now;
                    carrier.letter(Letter::Frame(side, frame, Condition::Good, 0), now);
                }
            }),
        );
        let mut work = carrier.take_work().expect("every pair is searched");
        let mut found = None;
        count(&mut recognise_loop, taken_by(|| found = Some(recognise(&mut recognizer, &mut work, true))));
        let (found, number, file) = (found.unwrap(), work.job.pair.number, work.file);
        parts_found += u64::from(warm) * u64::from(found.parts);
        count(&mut arm_loop, taken_by(|| carrier.letter(Letter::Recognised(number, found, file), now)));
        while let Ok(paper) = cold.papers.pop() {
            match paper {
                Paper::Pair(report, file) => {
                    sent += usize::from(warm && report.outcome.is_ok());
                    file.into_iter().for_each(|file| cold.outbox.send(Letter::Filed(file)));
                }
                Paper::Lone(side, frame) => {
                    assert_eq!((side, &frame.bytes[..]), (Side::Left, &[7; 16][..]));
                    lone_frames += 1;
                    cold.outbox.send(Letter::Spare(side, frame));
                }
                Paper::Note(..) => {}
            }
        }
        while let Some(letter) = carrier.next_letter() {
            carrier.letter(letter, now);
        }
    }
    assert!(sent > 0, "targets go out while it is counted");
    assert_eq!(lone_frames, PAIRS, "frames without a partner go to the recording");
    let (mut commands, mut reports) = (0, 0);
    while let Ok(Logged { said, .. }) = cold.log.pop() {
        commands += usize::from(matches!(said, Said::Command(Command::Pick(_), None)));
        reports += usize::from(matches!(said, Said::Event(Event::Arm(Report::Done { .. }))));
    }
    assert!(commands >= sent && reports > 0, "all of it is recorded: {commands} targets, {reports} done");
    assert_eq!(arm_loop, 0, "allocations of the grab and arm loops");
    assert!(parts_found > 0, "parts are found while it is counted");
    assert_eq!(recognise_loop, 0, "allocations of the recognise loop");
}

#[test]
fn a_fuller_bin_than_any_before_takes_no_memory() {
    let project = Path::new(env!("CARGO_MANIFEST_DIR"));
    let cell = pickcell::config::Cell::read(&project.join("cell.toml")).unwrap();
    let rig = pickcell::rig::Rig::read(&cell.rig.calibration).unwrap();
    let parts = pickcell::part::Part::read_all(&cell.recognition.parts).unwrap();
    let mut recognizer = Recognizer::new(cell.recognition_params(), rig, parts).unwrap();
    let pair = |name: &str| {
        let picture = |side: &str| {
            pickcell::session::read_raw_picture(&project.join(format!("replay/conveyor/{side}/{name}.jpg")))
        };
        FramePair { left: picture("left").unwrap(), right: picture("right").unwrap() }
    };
    let (few, many) = (pair("0019"), pair("0000"));
    let mut found = Recognition::with_room();
    recognizer.run(&few, Budget::Iterations(5000), 1, &mut found).unwrap();
    let before = found.parts.len();
    let taken = taken_by(|| recognizer.run(&many, Budget::Iterations(5000), 1, &mut found).unwrap());
    assert!(found.parts.len() > before, "{before} parts, then {}", found.parts.len());
    assert_eq!(taken, 0, "allocations in the fuller one");
}
