//! Dialects and the driver's end of the shared memory allocate nothing after `new`.

use firmware_bridge::config::{DialectName, Settings};
use firmware_bridge::dialect::{Dialect, TRANSMIT_LEN_MIN};
use firmware_bridge::link::shared::{BridgeEnd, CellEnd};
use firmware_bridge::message::{ArmAxes, Command, Pick, Pose, Report, Seen};
use firmware_bridge::simulate::{Faults, SimulatedArm};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

const MS: i64 = 1_000_000;

/// The system's allocator, counting for the thread that asked for it.
struct Counting;

thread_local! {
    static ALLOCATIONS: Cell<Option<u64>> = const { Cell::new(None) };
}

// SAFETY: every call goes on to the system's allocator unchanged.
#[allow(unsafe_code)]
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let _ = ALLOCATIONS.try_with(|count| count.set(count.get().map(|n| n + 1)));
        // SAFETY: the caller keeps the contract of `alloc`.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller keeps the contract of `dealloc`, and all memory comes from `System`.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// What `work` gives; it must not allocate.
fn without_allocations<T>(what: &str, work: impl FnOnce() -> T) -> T {
    ALLOCATIONS.set(Some(0));
    let result = work();
    let count = ALLOCATIONS.take();
    assert_eq!(count, Some(0), "{what} allocates");
    result
}

fn settings(dialect: DialectName) -> Settings {
    let text =
        "[workspace]\nmin_mm = [-200, -200, 0]\nmax_mm = [200, 200, 300]\n[arm]\nbanner_wait_ms = 100\n";
    let mut settings = Settings::parse(text).unwrap();
    settings.arm.dialect = dialect;
    if dialect != DialectName::Own {
        settings.arm.axes = ArmAxes::Xyz;
    }
    settings
}

fn pick(session: u32, sequence: u32, now_ns: i64) -> Pick {
    let at = |z| Pose { position_mm: [10.0, 20.0, z], orientation_xyzw: [1.0, 0.0, 0.0, 0.0] };
    Pick {
        id: u64::from(sequence),
        session,
        sequence,
        seen: Seen { left_ns: now_ns, right_ns: now_ns, period_ns: 33 * MS },
        deadline_ms: 66,
        ttl_ms: 500,
        recognised_mm: [10.0, 20.0, 10.0],
        approach: at(50.0),
        grasp: at(10.0),
        retreat: at(70.0),
        place: at(20.0),
        opening_mm: 8.0,
        slot: 0,
    }
}

/// Picks twice with a dialect and its simulated arm; counts in the dialect only.
fn run(name: DialectName) {
    let settings = settings(name);
    let mut cell = Dialect::new(&settings, 5).unwrap();
    let mut arm = SimulatedArm::new(name, [-200.0, -200.0, 250.0], Faults::default());
    let (mut now_ns, mut session, mut sequence, mut done, mut held) = (1000 * MS, 0, 0, 0, false);
    let mut ready_ns = None;
    cell.on_link(true, now_ns);
    while done < 2 || !held {
        assert!(now_ns < 200_000 * MS, "{name:?}: only {done} done");
        let mut bytes = [0; TRANSMIT_LEN_MIN];
        let sent = without_allocations("transmit", || cell.transmit(now_ns, &mut bytes));
        arm.on_bytes(&bytes[..sent.len], now_ns);
        if let Some(id) = sent.pick {
            cell.on_written(id, now_ns);
        }
        while arm.poll(now_ns).is_some() {}
        let len = arm.transmit(now_ns, &mut bytes[..192]);
        without_allocations("on_bytes", || cell.on_bytes(&bytes[..len], now_ns));
        while let Some(report) = without_allocations("poll", || cell.poll(now_ns)) {
            match report {
                Report::Connected { session: new, .. } => {
                    session = new;
                    without_allocations("release", || cell.command(Command::Release, now_ns)).unwrap();
                }
                Report::Ready { .. } => ready_ns = Some(now_ns),
                Report::Done { .. } => done += 1,
                Report::Held { .. } => held = true,
                _ => {}
            }
        }
        if ready_ns.is_some_and(|at| at + MS < now_ns) {
            ready_ns = None;
            sequence += 1;
            let next = if done < 2 { Command::Pick(pick(session, sequence, now_ns)) } else { Command::Hold };
            without_allocations("command", || cell.command(next, now_ns)).unwrap();
        }
        now_ns += MS;
    }
}

#[test]
fn dialects_allocate_nothing_after_new() {
    for dialect in [DialectName::Own, DialectName::Grbl, DialectName::Marlin, DialectName::Uarm] {
        run(dialect);
    }
}

#[test]
fn the_shared_memory_ends_allocate_nothing_after_new() {
    let settings = settings(DialectName::Own);
    let mut driver = CellEnd::new(&settings, 1);
    let mut bridge = BridgeEnd::new(&settings, 2);
    let mut seen = 0;
    for step in 0..2000 {
        let now_ns = (1000 + step) * MS;
        without_allocations("the exchange of records", || {
            if let Some(record) = driver.record(now_ns) {
                bridge.on_record(&record, now_ns, |_| Ok(()));
            }
            bridge.run_timers(now_ns, |_| Ok(()));
            bridge.on_report(Report::Heartbeat { delay_us: 1 });
            if let Some(record) = bridge.record(now_ns) {
                driver.on_record(&record, now_ns);
            }
            while driver.poll(now_ns).is_some() {
                seen += 1;
            }
        });
    }
    assert!(seen > 1000);
}
