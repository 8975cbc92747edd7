//! What the core does about single events, in tables; the random sequences are in `random`.

mod arm;
mod frames;
mod place;
mod random;

use firmware_bridge::config::Settings;
use firmware_bridge::message::{HeldBy, Pick, Pose, Report};

use super::*;
use crate::camera::Condition;

pub(super) const MS: i64 = 1_000_000;

/// The core, a clock, and the actions of the last event.
pub(super) struct Bench {
    pub(super) core: Core,
    pub(super) now: Timestamp,
    pub(super) actions: Vec<Action>,
    handles: u8,
}

pub(super) fn settings(extra: &str) -> Settings {
    let text = format!(
        "[arm]\nclear_dwell_ms = 50\nretries = 1\npick_timeout_ms = 5000\n{extra}\n\
         [workspace]\nmin_mm = [-200, -200, 0]\nmax_mm = [200, 200, 300]\ntilt_max_deg = 30\n"
    );
    Settings::parse(&text).unwrap()
}

pub(super) fn params() -> Params {
    Params {
        window_ns: 10 * MS,
        period_ns: 33 * MS,
        deadline_ns: 66 * MS,
        wire_ns: MS,
        ttl_ms: 500,
        handed_over_lag_ns: 0,
        silence_ns: 800 * MS,
        iterations: None,
        seed: 7,
        repeated: Vec::new(),
        first_id: 100,
        place: None,
        record: PlaceRecord::default(),
        defer_ns: 10_000 * MS,
        same_part_mm: 10.0,
    }
}

pub(super) fn down(position_mm: [f64; 3]) -> Pose {
    Pose { position_mm, orientation_xyzw: [1.0, 0.0, 0.0, 0.0] }
}

pub(super) fn found(positions_mm: &[[f64; 3]]) -> Found {
    let mut found = Found { parts: positions_mm.len() as u16, ..Found::default() };
    for &position_mm in positions_mm {
        found.push(Candidate {
            fitness: 0.1,
            grasp: Grasp(down(position_mm)),
            opening_mm: 8.0,
            ..Default::default()
        });
    }
    found
}

impl Bench {
    pub(super) fn new(params: Params, settings: &Settings) -> Self {
        let now = Timestamp(1_000_000 * MS);
        Self { core: Core::new(params, settings, now), now, actions: Vec::new(), handles: 0 }
    }

    /// A cell whose arm is released, ready and clear since now.
    pub(super) fn looking(params: Params, settings: &Settings) -> Self {
        let mut bench = Self::new(params, settings);
        bench.arm(Report::Connected { session: 3, held_by: HeldBy::Start });
        bench.event(Event::Operator(Operator::Release));
        bench.arm(Report::Ready { clear_of_view: true });
        bench.pass(MS);
        bench
    }

    pub(super) fn event(&mut self, event: Event) -> &[Action] {
        let mut actions = Actions::new();
        self.core.run(&event, self.now, &mut actions);
        self.actions = actions.iter().collect();
        &self.actions
    }

    pub(super) fn arm(&mut self, report: Report) -> &[Action] {
        self.event(Event::Arm(report))
    }

    /// Lets time pass, with a tick at the end.
    pub(super) fn pass(&mut self, ns: i64) -> &[Action] {
        self.now = Timestamp(self.now.0 + ns);
        self.event(Event::Tick)
    }

    pub(super) fn frame(&mut self, side: Side, timestamp: Timestamp) -> FrameSeen {
        self.handles = (self.handles + 1) % HANDLES as u8;
        FrameSeen {
            handle: Handle(self.handles),
            side,
            timestamp,
            mark: TimestampMark::StartOfExposure,
            sequence: 0,
            condition: Condition::Good,
            skipped: 0,
        }
    }

    /// A pair seen now.
    pub(super) fn pair(&mut self) -> &[Action] {
        let left = self.frame(Side::Left, self.now);
        let right = self.frame(Side::Right, self.now);
        self.event(Event::Frame(left));
        self.event(Event::Frame(right))
    }

    pub(super) fn job(&self) -> Option<Job> {
        self.actions.iter().find_map(|action| match action {
            Action::Recognise(job) => Some(*job),
            _ => None,
        })
    }

    /// A pair seen now, its result 10 ms later.
    pub(super) fn recognise(&mut self, found: Found) -> Result<TargetSent, NoPick> {
        self.pair();
        let pair = self.job().expect("the recogniser is free").pair.number;
        self.now = Timestamp(self.now.0 + 10 * MS);
        self.event(Event::Recognised { pair, found });
        self.outcome().expect("every pair is reported")
    }

    pub(super) fn outcome(&self) -> Option<Result<TargetSent, NoPick>> {
        self.actions.iter().find_map(|action| match action {
            Action::Say(Note::Pair(report)) => Some(report.outcome),
            _ => None,
        })
    }

    pub(super) fn is_ended(&self) -> bool {
        self.core.phase == Phase::Ended
    }

    pub(super) fn ordered(&self) -> Option<Pick> {
        self.actions.iter().find_map(|action| match action {
            Action::Arm(Command::Pick(pick)) => Some(*pick),
            _ => None,
        })
    }

    pub(super) fn alarms(&self) -> Vec<Alarm> {
        let alarm = |action: &Action| match action {
            Action::Say(Note::Alarm(alarm)) => Some(*alarm),
            _ => None,
        };
        self.actions.iter().filter_map(alarm).collect()
    }

    pub(super) fn commands(&self) -> Vec<Command> {
        let command = |action: &Action| match action {
            Action::Arm(command) => Some(*command),
            _ => None,
        };
        self.actions.iter().filter_map(command).collect()
    }

    pub(super) fn ends(&self) -> Option<TargetEnd> {
        self.actions.iter().find_map(|action| match action {
            Action::Say(Note::Ended { end, .. }) => Some(*end),
            _ => None,
        })
    }

    pub(super) fn count(&self, cause: Cause) -> u64 {
        self.core.counts().get(cause)
    }

    pub(super) fn state(&self) -> State {
        self.core.state()
    }
}
