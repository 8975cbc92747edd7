//! How long a target takes through shared memory, from the driver's clock reading before it is published to the
//! bridge's after it was woken, read it and unpacked it, two processes, one target a millisecond.
//!
//! `cargo bench -p firmware-bridge --bench shared_memory`

use firmware_bridge::link::shared::{CellRecord, Ports, Side};
use firmware_bridge::link::{clock_ns, wait_for};
use firmware_bridge::message::{Command, Pick, Pose, Seen};
use std::io::{BufRead, BufReader};
use std::process::{Command as Process, Stdio};
use std::time::Duration;

const TARGETS: u32 = 5000;
/// The first ones find cold caches and unconnected ports.
const WARM_UP: u32 = 200;

fn main() {
    let mut arguments = std::env::args().skip(1).skip_while(|argument| argument != "receive");
    match arguments.nth(1) {
        Some(service) => receive(&service),
        None => send(),
    }
}

fn target() -> Pick {
    let pose = Pose { position_mm: [1.0, 2.0, 3.0], orientation_xyzw: [1.0, 0.0, 0.0, 0.0] };
    Pick {
        id: 1,
        session: 1,
        sequence: 1,
        seen: Seen::default(),
        deadline_ms: 66,
        ttl_ms: 500,
        recognised_mm: [1.0, 2.0, 3.0],
        approach: pose,
        grasp: pose,
        retreat: pose,
        place: pose,
        opening_mm: 8.0,
        slot: 0,
    }
}

fn send() {
    let service = format!("bench-{}", std::process::id());
    let ports = Ports::open(&service, Side::Driver).expect("the service can be made");
    let program = std::env::current_exe().expect("this program has a path");
    let mut bridge = Process::new(program)
        .args(["receive", &service])
        .stdout(Stdio::piped())
        .spawn()
        .expect("this program can be started");
    let mut answers = BufReader::new(bridge.stdout.take().expect("it was piped")).lines();
    answers.next().expect("the other side stands").expect("and says so");
    let mut record = CellRecord { cell: 1, bridge: 1, sent_ns: 0, newest: 0, commands: [None; 4] };
    let pick = target();
    for number in 1..=TARGETS + WARM_UP {
        record.newest = number;
        record.commands[number as usize % 4] = Some(Command::Pick(pick));
        record.sent_ns = clock_ns();
        ports.publish(&record);
        std::thread::sleep(Duration::from_millis(1));
    }
    for line in answers {
        println!("{}", line.expect("text"));
    }
    bridge.wait().expect("it ends");
}

fn receive(service: &str) {
    let ports = Ports::open(service, Side::Bridge).expect("the service can be opened");
    println!("ready");
    let mut delays_ns = Vec::with_capacity(TARGETS as usize);
    let mut last_ns = clock_ns();
    while clock_ns() - last_ns < 1_000_000_000 {
        wait_for(&[Some(ports.fd())], last_ns + 1_000_000_000);
        while let Some(record) = ports.receive::<CellRecord>() {
            last_ns = clock_ns();
            if record.newest > WARM_UP {
                delays_ns.push(last_ns - record.sent_ns);
            }
        }
    }
    delays_ns.sort_unstable();
    let us = |share: f64| delays_ns[((delays_ns.len() - 1) as f64 * share) as usize] as f64 / 1000.0;
    println!("a target through shared memory to the bridge, {} of {TARGETS} received", delays_ns.len());
    println!(
        "p50 {:.1} us   p90 {:.1} us   p99 {:.1} us   max {:.1} us",
        us(0.5),
        us(0.9),
        us(0.99),
        us(1.0)
    );
}
