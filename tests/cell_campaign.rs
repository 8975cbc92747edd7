//! Core, carrier and simulated arm on a simulated clock, with faults of the line and of the arm drawn from a seed: no
//! target is lost without a word, none is stale, and whatever happened, the cell picks again afterwards.
//!
//! `PICKCELL_CAMPAIGN_RUNS=10000 cargo test --release --test cell_campaign` is the long form; `PICKCELL_CAMPAIGN_FIRST` is
//! its first seed. Seeds take the dialects of arms in turn.

use std::collections::HashMap;

use firmware_bridge::config::{DialectName, Settings};
use firmware_bridge::link::{Link, SimulatedLink};
use firmware_bridge::message::{ArmAxes, Pose};
use firmware_bridge::simulate::{Fault, Faults};
use pickcell::arm::Arm;
use pickcell::camera::{Condition, Side};
use pickcell::cell::carrier::Carrier;
use pickcell::cell::core::{
    Candidate, Cause, Core, Event, Found, Grasp, Note, Operator, Params, PlaceRecord, STOP_NS, State,
};
use pickcell::cell::desk::{ColdSeat, Desk, GrabSeat, Letter, Paper, Seats};
use pickcell::frame::Frame;
use pickcell::time::Timestamp;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

const MS: i64 = 1_000_000;
const PERIOD_NS: i64 = 33 * MS;

const FAULTS: [Fault; 8] = [
    Fault::Silence,
    Fault::Garbage,
    Fault::LostBytes,
    Fault::DoubledBytes,
    Fault::Reset,
    Fault::Refused,
    Fault::NotHeld,
    Fault::Slow,
];

/// What became of the targets, as the notes tell it.
#[derive(Default)]
struct Told {
    ordered: Vec<u64>,
    ends: HashMap<u64, u32>,
    late: u32,
    done: u32,
    /// The newest ones.
    notes: Vec<Note>,
}

struct Campaign<'a> {
    grabs: [GrabSeat; 2],
    cold: ColdSeat,
    carrier: Carrier<'a>,
    now: Timestamp,
    told: Told,
    rng: Pcg64Mcg,
}

impl Campaign<'_> {
    /// Time passes, with every turn that core and arm ask for in it.
    fn pass(&mut self, ns: i64) {
        let until = Timestamp(self.now.0 + ns);
        self.carrier.turn(self.now);
        let mut turns = 0;
        while let Some(turn) = self.carrier.next_turn().filter(|&turn| turn < until) {
            self.now = self.now.max(turn);
            self.carrier.turn(self.now);
            turns += 1;
            assert!(turns < 20_000, "core or arm ask for themselves again and again");
        }
        self.now = until;
    }

    /// A period passes, then a pair comes and shows a part, which is found sooner or later, or too late.
    fn period(&mut self, x_mm: f64) {
        self.pass(PERIOD_NS);
        for side in Side::BOTH {
            let mut frame: Frame = self.grabs[side.index()].free.pop().expect("every frame comes back");
            frame.timestamp = self.now;
            self.carrier.letter(Letter::Frame(side, frame, Condition::Good, 0), self.now);
        }
        if let Some(work) = self.carrier.take_work() {
            let mut found = Found { parts: 1, ..Found::default() };
            let pose = Pose { position_mm: [x_mm, 50.0, 10.0], orientation_xyzw: [1.0, 0.0, 0.0, 0.0] };
            found.push(Candidate { fitness: 0.1, grasp: Grasp(pose), opening_mm: 8.0, ..Default::default() });
            let search_ns = self.rng.random_range(2 * MS..70 * MS);
            self.pass(search_ns);
            self.carrier.letter(Letter::Recognised(work.job.pair.number, found, work.file), self.now);
        }
        self.read();
    }

    fn read(&mut self) {
        while let Ok(paper) = self.cold.papers.pop() {
            if let Paper::Note(note, _) = &paper {
                self.told.notes.truncate(11);
                self.told.notes.insert(0, *note);
            }
            match paper {
                // Nothing is recorded here.
                Paper::Lone(..) => {}
                Paper::Pair(report, file) => {
                    self.told.ordered.extend(report.outcome.ok().map(|sent| sent.id));
                    file.into_iter().for_each(|file| self.cold.outbox.send(Letter::Filed(file)));
                }
                Paper::Note(Note::Ended { id, end }, _) => {
                    *self.told.ends.entry(id).or_default() += 1;
                    self.told.done += u32::from(end == pickcell::cell::core::TargetEnd::Done);
                }
                Paper::Note(Note::Sent { deadline_kept, .. }, _) => {
                    self.told.late += u32::from(!deadline_kept);
                }
                Paper::Note(..) => {}
            }
        }
        while let Some(letter) = self.carrier.next_letter() {
            self.carrier.letter(letter, self.now);
        }
    }

    /// The operator releases whenever the arm waits for it.
    fn release(&mut self) {
        if matches!(self.carrier.state(), State::Held | State::Alarmed) {
            self.carrier.event(&Event::Operator(Operator::Release), self.now);
        }
    }
}

fn params() -> Params {
    Params {
        window_ns: 13 * MS,
        period_ns: PERIOD_NS,
        deadline_ns: 66 * MS,
        wire_ns: 0,
        ttl_ms: 500,
        handed_over_lag_ns: 0,
        silence_ns: 1000 * MS,
        iterations: Some(1),
        seed: 1,
        repeated: Vec::new(),
        first_id: 1,
        place: None,
        record: PlaceRecord::default(),
        defer_ns: 500 * MS,
        same_part_mm: 5.0,
    }
}

fn settings(dialect: DialectName) -> Settings {
    let mut settings = Settings::parse(
        "[arm]\nbanner_wait_ms = 50\nhandshake_timeout_ms = 200\npick_timeout_ms = 3000\n\
         [workspace]\nmin_mm = [-200, -200, 0]\nmax_mm = [200, 200, 300]\n",
    )
    .unwrap();
    if dialect != DialectName::Own {
        settings.arm.dialect = dialect;
        settings.arm.axes = ArmAxes::Xyz;
        settings.arm.pick_timeout_ms = 60_000;
        settings.arm.moves.clear = vec!["G0 X-200 Y-200 Z300 F12000".into()];
    }
    settings
}

fn run(seed: u64, settings: &Settings) -> (u32, u64) {
    let faults = [FAULTS[(seed / 4) as usize % 8], FAULTS[(seed / 32) as usize % 8]];
    let (desk, Seats { grabs, cold, hub, .. }) = Desk::new(2, 16, 0).unwrap();
    let mut link = SimulatedLink::new(settings, seed as u32, Faults::new(seed, &faults)).unwrap();
    link.arm().set_tempo(4.0);
    let start = Timestamp(1_000_000 * MS);
    let arm = Arm(Link::Simulated(link));
    let carrier = Carrier::new(&desk, hub, Core::new(params(), settings, start), arm);
    let mut campaign = Campaign {
        grabs,
        cold,
        carrier,
        now: start,
        told: Told::default(),
        rng: Pcg64Mcg::seed_from_u64(seed),
    };
    for period in 0..400 {
        campaign.release();
        campaign.period(f64::from(period % 20) * 10.0 - 100.0);
    }
    // The faults end; what follows must be a cell that works.
    campaign.carrier.heal_arm();
    let before = campaign.told.done;
    // The move that a slow arm is at takes its time.
    for period in 0..3000 {
        campaign.release();
        campaign.period(f64::from(period % 20) * 10.0 - 100.0);
        if campaign.told.done > before {
            break;
        }
    }
    assert!(
        campaign.told.done > before,
        "seed {seed} {faults:?}: it picks again once the faults have ended; {:?}, {:?}",
        campaign.carrier.state(),
        campaign.told.notes
    );
    campaign.carrier.event(&Event::Stop, campaign.now);
    for _ in 0..=STOP_NS / (20 * MS) {
        if campaign.carrier.ending().is_none() {
            campaign.now = Timestamp(campaign.now.0 + 20 * MS);
            campaign.carrier.turn(campaign.now);
        }
    }
    campaign.read();
    assert!(campaign.carrier.ending().is_some(), "seed {seed}: it ends when asked to");
    for id in &campaign.told.ordered {
        assert_eq!(campaign.told.ends.get(id), Some(&1), "seed {seed} {faults:?}: target {id} ends once");
    }
    assert_eq!(campaign.told.late, 0, "seed {seed} {faults:?}: a target went out after its deadline");
    (campaign.told.done, desk.telemetry.count(Cause::Ordered))
}

#[test]
fn whatever_the_arm_does_every_target_ends_once_and_the_cell_goes_on() {
    let number = |name: &str, unset: u64| {
        std::env::var(name)
            .map_or(unset, |text| text.parse().unwrap_or_else(|_| panic!("{name} is a number")))
    };
    let (first, runs) = (number("PICKCELL_CAMPAIGN_FIRST", 0), number("PICKCELL_CAMPAIGN_RUNS", 128));
    let cells = [DialectName::Own, DialectName::Grbl, DialectName::Marlin, DialectName::Uarm].map(settings);
    let (mut done, mut ordered, mut failed) = (0, 0, Vec::new());
    for seed in first..first + runs {
        // Every seed is run, so that all that fail are known.
        match std::panic::catch_unwind(|| run(seed, &cells[seed as usize % 4])) {
            Ok((run_done, run_ordered)) => {
                done += u64::from(run_done);
                ordered += run_ordered;
            }
            Err(_) => failed.push(seed),
        }
    }
    println!("{runs} runs, {done} of {ordered} targets done");
    assert!(failed.is_empty(), "seeds {failed:?} fail; PICKCELL_CAMPAIGN_FIRST and _RUNS=1 run one alone");
    assert!(done > runs && ordered > done, "{done} of {ordered} targets done in {runs} runs");
}
