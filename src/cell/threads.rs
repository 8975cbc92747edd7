//! The threads of a live cell, and nothing else: they carry letters, the carrier and its core do the rest.
//!
//! | thread | does | sleeps on | SCHED_FIFO |
//! |---|---|---|---|
//! | left, right | wait for a frame, hand it over | the camera | `grab_priority` |
//! | recognise | recognise a pair, kick the watchdog | an eventfd | `recognise_priority` |
//! | recognise-2, where wanted | the right picture of each pair | an eventfd | `recognise_priority` |
//! | arm | the core, the link to the arm | an eventfd and the link | `arm_priority` |
//! | cold | print, write, have pictures drawn and recorded by threads of the command | an eventfd | none |
//!
//! Between them lie wait-free rings ([`super::desk`]); who sends wakes whom it sends to. Nothing spins. A panic in any
//! of them stops the cell: the arm is told to hold, then the panic goes on; after one of the arm thread the link falls silent.

use std::io;
use std::sync::atomic::{AtomicBool, Ordering, fence};
use std::sync::{Arc, OnceLock};
use std::thread::{Builder, Scope};
use std::time::Duration;

use firmware_bridge::outside::ending_signals;
use rtrb::{Consumer, Producer, RingBuffer};
use signal_hook::consts::{SIGUSR1, SIGUSR2};
use signal_hook::iterator::Signals;

use super::carrier::Carrier;
use super::core::{Core, Ending, Event, Operator};
use super::desk::{Desk, GrabSeat, Hub, Letter, Outbox, Work};
use super::notify::Watchdog;
use super::realtime::{Granted, Wish, apply};
use super::recogniser::recognise;
use crate::arm::Arm;
use crate::camera::{Camera, Grab, Side};
use crate::frame::Frame;
use crate::handover::Waker;
use crate::hands;
use crate::recognize::Recognizer;
use crate::time::{Clocks, Sleep, Timestamp};

/// A grab thread looks this often whether the cell has ended.
const GRAB_TIMEOUT: Duration = Duration::from_millis(100);
/// The arm's thread looks around this often even if nobody calls.
const ROUND_NS: i64 = 500_000_000;
/// A stepped session goes on after so long without a pair (a picture that could not be read), ns.
const STEP_PATIENCE_NS: i64 = 200_000_000;

/// What is asked of a running cell from outside. Kept apart from the queues, so that it gets through full ones.
#[derive(Debug)]
pub struct Controls {
    stop: AtomicBool,
    hold: AtomicBool,
    release: AtomicBool,
    desk: Arc<Desk>,
}

impl Controls {
    /// Nothing asked yet.
    pub fn new(desk: Arc<Desk>) -> Self {
        let no = || AtomicBool::new(false);
        Self { stop: no(), hold: no(), release: no(), desk }
    }

    /// The cell is to end.
    pub fn stop(&self) {
        self.stop.store(true, Ordering::Release);
        self.desk.letters_waker.wake();
    }

    /// Whether it was asked to end.
    pub fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Acquire)
    }

    /// The operator wants something.
    pub fn operator(&self, operator: Operator) {
        match operator {
            Operator::Hold => self.hold.store(true, Ordering::Release),
            Operator::Release => self.release.store(true, Ordering::Release),
        }
        self.desk.letters_waker.wake();
    }
}

/// What signals reach, before there is a cell and with it.
#[derive(Default)]
pub struct Signalled {
    cell: OnceLock<Arc<Controls>>,
    hold: AtomicBool,
}

impl Signalled {
    /// There is a cell now. A hold that was asked for before is one of it.
    pub fn cell_stands(&self, controls: &Arc<Controls>) {
        self.cell.get_or_init(|| Arc::clone(controls));
        // Either this sees the hold, or the hold sees the cell.
        fence(Ordering::SeqCst);
        if self.hold.load(Ordering::Relaxed) {
            controls.operator(Operator::Hold);
        }
    }

    fn hold(&self) {
        self.hold.store(true, Ordering::Relaxed);
        fence(Ordering::SeqCst);
        if let Some(controls) = self.cell.get() {
            controls.operator(Operator::Hold);
        }
    }
}

/// Turns signals into wishes until the process ends: SIGINT, SIGTERM and SIGHUP stop, SIGUSR1 releases, SIGUSR2 holds.
/// Before there is a cell nothing can have moved: whoever is asked to end then ends at once, well.
///
/// # Errors
/// The system does not let signals be caught.
pub fn obey_signals(signalled: Arc<Signalled>) -> io::Result<()> {
    let mut signals = Signals::new(ending_signals().into_iter().chain([SIGUSR1, SIGUSR2]))?;
    Builder::new().name("signals".into()).spawn(move || {
        for signal in signals.forever() {
            match (signal, signalled.cell.get()) {
                (SIGUSR1, controls) => controls.iter().for_each(|c| c.operator(Operator::Release)),
                (SIGUSR2, _) => signalled.hold(),
                (_, Some(controls)) => controls.stop(),
                (_, None) => std::process::exit(0),
            }
        }
    })?;
    Ok(())
}

/// What the threads ask of the system.
#[derive(Clone, Debug)]
pub struct Wishes {
    /// The grab threads.
    pub grab: Wish,
    /// The recognise thread.
    pub recognise: Wish,
    /// The thread that shares the pictures with it.
    pub second: Wish,
    /// The arm's thread.
    pub arm: Wish,
    /// Stack of each of them, bytes.
    pub stack_bytes: usize,
}

/// What a thread got.
#[derive(Clone, Copy, Debug)]
pub struct ThreadRights {
    /// SCHED_FIFO.
    pub fifo: Granted,
    /// Its cores.
    pub cores: Granted,
    /// Its stack, bytes.
    pub stack_bytes: usize,
}

/// A cell that is ready to run.
pub struct Live {
    /// What the threads share.
    pub desk: Arc<Desk>,
    /// What each of them has for itself; the cold thread's is with whoever does the slow work.
    pub grabs: [GrabSeat; 2],
    /// The recogniser's.
    pub recognise: Outbox,
    /// The arm's thread's.
    pub hub: Hub,
    /// What is asked from outside.
    pub controls: Arc<Controls>,
    /// Left and right.
    pub cameras: [Camera; 2],
    /// For a session that waits for the cell: what wakes each side.
    pub steps: Option<[Arc<Waker>; 2]>,
    /// The recogniser.
    pub recognizer: Recognizer,
    /// The thread that its pictures are shared with, if any.
    pub second: Option<hands::Helper>,
    /// Grasps are given in the robot's base.
    pub in_base: bool,
    /// The decisions.
    pub core: Core,
    /// The arm.
    pub arm: Arm,
    /// What the threads ask of the system.
    pub wishes: Wishes,
}

/// Between the arm's thread and the recogniser.
#[derive(Debug)]
struct Bench {
    waker: Waker,
    quit: AtomicBool,
}

/// Stops the cell should its thread end by a panic.
struct StopOnPanic<'a>(&'a Controls);

impl Drop for StopOnPanic<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.stop();
        }
    }
}

/// Lets all other threads end when the arm's thread has, however it did.
struct QuitAll<'a>(&'a Bench, &'a Desk, &'a AtomicBool);

impl Drop for QuitAll<'_> {
    fn drop(&mut self) {
        self.0.quit.store(true, Ordering::Release);
        self.0.waker.wake();
        self.2.store(true, Ordering::Release);
        self.1.papers_waker.wake();
    }
}

/// Runs a cell until it ends. `told` hears once from every hot thread what it was granted; `cold` does the slow work
/// in a thread of its own: it is called whenever there may be something to do, and once at the end.
///
/// # Errors
/// A thread that cannot be started.
pub fn run<C>(live: Live, told: impl Fn(&str, ThreadRights) + Sync, mut cold: C) -> io::Result<Ending>
where
    C: FnMut() + Send,
{
    let Live {
        desk,
        grabs,
        recognise,
        hub,
        controls,
        cameras,
        steps,
        mut recognizer,
        second,
        in_base,
        core,
        arm,
        wishes,
    } = live;
    let (desk, controls, told) = (&*desk, &*controls, &told);
    let bench = &Bench { waker: Waker::new()?, quit: AtomicBool::new(false) };
    let cold_quit = &AtomicBool::new(false);
    // The core orders one search at a time.
    let (orders, ordered) = RingBuffer::new(1);
    std::thread::scope(|scope| {
        let cold_thread = Builder::new().name("cold".into()).spawn_scoped(scope, move || {
            let _guard = StopOnPanic(controls);
            cold_loop(desk, cold_quit, &mut cold);
        })?;
        // Whoever fails to start lets those end that have started.
        let quit_all = QuitAll(bench, desk, cold_quit);
        let stack = wishes.stack_bytes;
        hot(scope, "recognise", stack, &wishes.recognise, told, move || {
            let _guard = StopOnPanic(controls);
            recognise_loop(bench, ordered, recognise, &mut recognizer, in_base);
        })?;
        if let Some(second) = second {
            hot(scope, "recognise-2", stack, &wishes.second, told, move || second.work())?;
        }
        for ((side, mut camera), mut seat) in Side::BOTH.into_iter().zip(cameras).zip(grabs) {
            hot(scope, side.name(), stack, &wishes.grab, told, move || {
                let _guard = StopOnPanic(controls);
                grab_loop(bench, side, &mut camera, &mut seat);
            })?;
        }
        let carrier = Carrier::new(desk, hub, core, arm);
        let arm_thread = hot(scope, "arm", stack, &wishes.arm, told, move || {
            let _quit_all = quit_all;
            arm_loop(desk, controls, bench, steps.as_ref(), carrier, orders)
        })?;
        let ending = arm_thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        cold_thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        Ok(ending)
    })
}

/// Starts a hot thread that first asks for its rights.
fn hot<'scope, 'env, T: Send + 'scope>(
    scope: &'scope Scope<'scope, 'env>,
    name: &'static str,
    stack_bytes: usize,
    wish: &Wish,
    told: &'scope (impl Fn(&str, ThreadRights) + Sync),
    work: impl FnOnce() -> T + Send + 'scope,
) -> io::Result<std::thread::ScopedJoinHandle<'scope, T>> {
    let wish = wish.clone();
    Builder::new().name(name.into()).stack_size(stack_bytes).spawn_scoped(scope, move || {
        let rights = apply(&wish);
        told(name, ThreadRights { fifo: rights.fifo, cores: rights.cores, stack_bytes });
        work()
    })
}

fn grab_loop(bench: &Bench, side: Side, camera: &mut Camera, seat: &mut GrabSeat) {
    let mut frame = Frame::default();
    let mut have = false;
    while !bench.quit.load(Ordering::Acquire) {
        if !have {
            match seat.free.pop() {
                Ok(free) => (frame, have) = (free, true),
                Err(_) => {
                    // All frames are under way; the driver keeps the newest meanwhile.
                    std::thread::sleep(Duration::from_millis(1));
                    continue;
                }
            }
        }
        match camera.grab(&mut frame, GRAB_TIMEOUT) {
            Grab::Frame { condition, skipped } => {
                have = false;
                seat.outbox.send(Letter::Frame(side, std::mem::take(&mut frame), condition, skipped));
            }
            Grab::TimedOut => {}
            Grab::Lost(trouble) => seat.outbox.send(Letter::Lost(side, trouble)),
            Grab::Back => seat.outbox.send(Letter::Back(side)),
            Grab::Ended => {
                seat.outbox.send(Letter::Ended(side));
                break;
            }
        }
    }
}

fn recognise_loop(
    bench: &Bench,
    mut ordered: Consumer<Work>,
    mut outbox: Outbox,
    recognizer: &mut Recognizer,
    in_base: bool,
) {
    let mut watchdog = Watchdog::from_environment();
    while !bench.quit.load(Ordering::Acquire) {
        watchdog.kick(Timestamp::now());
        bench.waker.wait(Some(watchdog.every()));
        let Ok(mut work) = ordered.pop() else { continue };
        let found = recognise(recognizer, &mut work, in_base);
        outbox.send(Letter::Recognised(work.job.pair.number, found, work.file));
    }
}

fn arm_loop(
    desk: &Desk,
    controls: &Controls,
    bench: &Bench,
    steps: Option<&[Arc<Waker>; 2]>,
    mut carrier: Carrier<'_>,
    mut orders: Producer<Work>,
) -> Ending {
    let mut stepped = Timestamp::now();
    let mut sleep = Sleep::until_now(Clocks::now);
    let mut stopped = false;
    loop {
        desk.letters_waker.clear();
        let clocks = Clocks::now();
        let now = clocks.cell;
        // Before any letter: those that wait may be of before.
        if let Some(for_ns) = sleep.look(clocks) {
            carrier.event(&Event::Suspended { for_ns }, now);
        }
        // Of two wishes of which nobody knows the order the hold is the one that stays.
        if controls.release.swap(false, Ordering::AcqRel) {
            carrier.event(&Event::Operator(Operator::Release), now);
        }
        if controls.hold.swap(false, Ordering::AcqRel) {
            carrier.event(&Event::Operator(Operator::Hold), now);
        }
        if !stopped && controls.is_stopped() {
            stopped = true;
            carrier.event(&Event::Stop, now);
        }
        while let Some(letter) = carrier.next_letter() {
            carrier.letter(letter, Timestamp::now());
            pass_on(&mut carrier, bench, &mut orders);
        }
        carrier.turn(Timestamp::now());
        pass_on(&mut carrier, bench, &mut orders);
        if let Some(ending) = carrier.ending() {
            return ending;
        }
        let now = Timestamp::now();
        if let Some(sides) = steps {
            let stuck = now.since(stepped) > STEP_PATIENCE_NS && !carrier.is_searching();
            if std::mem::take(&mut carrier.pairs_finished) > 0 || stuck {
                stepped = now;
                sides.iter().for_each(|side| side.wake());
            }
        }
        let until = Timestamp(now.0 + ROUND_NS);
        let until = carrier.next_turn().map_or(until, |turn| turn.min(until));
        carrier.arm().wait(until, std::os::fd::AsFd::as_fd(&desk.letters_waker));
    }
}

fn pass_on(carrier: &mut Carrier<'_>, bench: &Bench, orders: &mut Producer<Work>) {
    if let Some(work) = carrier.take_work() {
        assert!(orders.push(work).is_ok(), "the core orders one search at a time");
        bench.waker.wake();
    }
}

fn cold_loop(desk: &Desk, quit: &AtomicBool, cold: &mut impl FnMut()) {
    loop {
        desk.papers_waker.wait(Some(Duration::from_millis(500)));
        let ending = quit.load(Ordering::Acquire);
        cold();
        if ending {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hold_before_there_is_a_cell_is_one_of_it() {
        for held in [false, true] {
            let signalled = Signalled::default();
            if held {
                signalled.hold();
            }
            let (desk, _seats) = Desk::new(0, 16, 16).unwrap();
            let controls = Arc::new(Controls::new(Arc::new(desk)));
            signalled.cell_stands(&controls);
            assert_eq!(controls.hold.swap(false, Ordering::AcqRel), held);
            signalled.hold();
            assert!(controls.hold.load(Ordering::Acquire));
        }
    }
}
