//! Carries events to the core and its actions to whom they concern. Decides nothing, owns no thread, reads no clock.
//!
//! Takes letters and the time; owns the core, the arm and the frames that the core has not let go. The live cell
//! runs it in the arm's thread; a session played as fast as possible runs it on the session's own time.

use super::core::{Action, Actions, Core, Ending, Event, Job, Note, PairReport, State};
use super::desk::{Desk, File, Hub, Letter, Paper, Said, Work};
use super::pairing::{FrameSeen, Handle};
use crate::arm::Arm;
use crate::camera::{Condition, Side};
use crate::frame::{Frame, FramePair};
use crate::telemetry::Stage;
use crate::time::Timestamp;

const HANDLES: usize = super::core::HANDLES;

/// Where the pixels of a handle are.
#[derive(Debug, Default)]
enum Place {
    #[default]
    Free,
    Here(Side, Frame),
    /// With the recogniser, later with the cold thread, which sends it back.
    Lent,
}

/// The carrier.
pub struct Carrier<'a> {
    desk: &'a Desk,
    hub: Hub,
    core: Core,
    arm: Arm,
    actions: Actions,
    shelf: [Place; HANDLES],
    arrivals: [Timestamp; HANDLES],
    /// The file of the pair that the core is just being told of.
    file: Option<Box<File>>,
    /// What the core wants recognised.
    ordered: Option<(Job, FramePair)>,
    /// Pairs that were finished since somebody last looked.
    pub pairs_finished: u32,
    /// Of the last pair, from its older frame to the end of its recognition.
    frame_to_result_ns: i64,
    ending: Option<Ending>,
}

impl<'a> Carrier<'a> {
    /// Everything at rest.
    pub fn new(desk: &'a Desk, hub: Hub, core: Core, arm: Arm) -> Self {
        Self {
            desk,
            hub,
            core,
            arm,
            actions: Actions::new(),
            shelf: Default::default(),
            arrivals: [Timestamp::default(); HANDLES],
            file: None,
            ordered: None,
            pairs_finished: 0,
            frame_to_result_ns: 0,
            ending: None,
        }
    }

    /// Whether a pair is with the recogniser.
    pub fn is_searching(&self) -> bool {
        self.shelf.iter().any(|place| matches!(place, Place::Lent))
    }

    /// For the recogniser: what the core wants recognised, once.
    pub fn take_work(&mut self) -> Option<Work> {
        let (job, pair) = self.ordered.take()?;
        let mut file = self.hub.file().expect("a file is kept for the recogniser");
        file.pair = pair;
        Some(Work { job, file })
    }

    /// The next letter that waits.
    pub fn next_letter(&mut self) -> Option<Letter> {
        self.hub.letter()
    }

    /// A frame that was not filled.
    pub fn give(&mut self, side: Side, frame: Frame) {
        self.hub.give(side, frame);
    }

    /// How it ended, once it has.
    pub fn ending(&self) -> Option<Ending> {
        self.ending
    }

    /// What the arm is doing.
    pub fn state(&self) -> State {
        self.core.state()
    }

    /// The arm, to wait for it.
    pub fn arm(&self) -> &Arm {
        &self.arm
    }

    /// Ends the faults of a simulated arm.
    pub fn heal_arm(&mut self) {
        self.arm.heal();
    }

    /// When to come again if nothing happens.
    pub fn next_turn(&self) -> Option<Timestamp> {
        self.core.next_tick().into_iter().chain(self.arm.next_poll()).min()
    }

    /// A letter has come.
    pub fn letter(&mut self, letter: Letter, now: Timestamp) {
        match letter {
            Letter::Frame(side, frame, condition, skipped) => {
                self.frame(side, frame, condition, skipped, now)
            }
            Letter::Lost(side, trouble) => self.event(&Event::CameraLost { side, trouble }, now),
            Letter::Back(side) => self.event(&Event::CameraBack { side }, now),
            Letter::Ended(side) => self.event(&Event::CameraEnded { side }, now),
            Letter::Recognised(pair, found, file) => {
                self.measure(&file);
                self.file = Some(file);
                self.event(&Event::Recognised { pair, found }, now);
                if let Some(file) = self.file.take() {
                    // The core had already given the pair up.
                    self.hub.give_back(file);
                }
            }
            Letter::Filed(file) => self.hub.give_back(file),
            Letter::Spare(side, frame) => self.hub.take_back(side, frame),
            Letter::Persisted(record, true) => self.event(&Event::Persisted(record), now),
            Letter::Persisted(_, false) => self.event(&Event::NotPersisted, now),
        }
    }

    /// Hears what the arm has to say, and lets time pass.
    pub fn turn(&mut self, now: Timestamp) {
        while let Some(report) = self.arm.poll(now) {
            self.event(&Event::Arm(report), now);
        }
        self.event(&Event::Tick, now);
    }

    /// Tells the core, and does what it says.
    pub fn event(&mut self, event: &Event, now: Timestamp) {
        self.log_event(event, now);
        let mut actions = std::mem::take(&mut self.actions);
        actions.clear();
        self.core.run(event, now, &mut actions);
        for action in actions.iter() {
            self.act(action, now);
        }
        self.actions = actions;
        self.desk.telemetry.publish(self.core.state(), self.core.counts());
    }

    fn frame(&mut self, side: Side, mut frame: Frame, condition: Condition, skipped: u32, now: Timestamp) {
        if condition != Condition::Good {
            // What is in it is of an earlier picture.
            frame.bytes.clear();
        }
        let Some(slot) = self.shelf.iter().position(|place| matches!(place, Place::Free)) else {
            // The core holds fewer frames than there are places; a frame more than that is not one of them.
            self.hub.give(side, frame);
            return;
        };
        let seen = FrameSeen {
            handle: Handle(slot as u8),
            side,
            timestamp: frame.timestamp,
            mark: frame.mark,
            sequence: frame.sequence,
            condition,
            skipped,
        };
        self.arrivals[slot] = now;
        self.desk.telemetry.record(Stage::Transfer, now.since(frame.timestamp));
        self.shelf[slot] = Place::Here(side, frame);
        self.event(&Event::Frame(seen), now);
    }

    fn act(&mut self, action: Action, now: Timestamp) {
        match action {
            Action::Recognise(job) => {
                let arrived = |handle: Handle| self.arrivals[handle.index()];
                let ready = arrived(job.pair.left.handle).max(arrived(job.pair.right.handle));
                let [left, right] = [job.pair.left.handle, job.pair.right.handle].map(|handle| {
                    match std::mem::replace(&mut self.shelf[handle.index()], Place::Lent) {
                        Place::Here(_, frame) => frame,
                        Place::Free | Place::Lent => unreachable!("the core gives every frame to one search"),
                    }
                });
                self.desk.telemetry.record(Stage::Queue, now.since(ready));
                self.ordered = Some((job, FramePair { left, right }));
            }
            Action::Free(handle) => {
                if let Place::Here(side, frame) = std::mem::take(&mut self.shelf[handle.index()]) {
                    self.let_go(side, frame);
                }
            }
            Action::Arm(command) => {
                let refused = self.arm.command(command, now).err();
                self.log(Said::Command(command, refused), now);
                if let (firmware_bridge::message::Command::Pick(pick), Some(refusal)) = (command, refused) {
                    // Heard at the next turn at the latest; within this one the core is busy with its own event.
                    self.not_taken(pick.id, refusal, now);
                }
            }
            Action::Persist(record) => {
                if !self.hub.persist(record) {
                    self.event_nested(&Event::NotPersisted, now);
                }
            }
            Action::Say(note) => self.say(note, now),
            Action::End(ending) => self.ending = Some(ending),
        }
    }

    /// A frame that led to no search goes back to its camera, by way of the recording where one is made: after a fault
    /// it tells what was seen.
    fn let_go(&mut self, side: Side, frame: Frame) {
        if frame.bytes.is_empty() || !self.hub.records() {
            self.hub.give(side, frame);
        } else if let Err(frame) = self.hub.lend(side, frame) {
            self.desk.telemetry.add_unkept();
            self.hub.give(side, frame);
        }
    }

    fn not_taken(&mut self, id: u64, refusal: firmware_bridge::message::Refusal, now: Timestamp) {
        self.event_nested(&Event::NotTaken { id, refusal }, now);
    }

    /// An event that follows from an action of the one that is being worked off.
    fn event_nested(&mut self, event: &Event, now: Timestamp) {
        self.log_event(event, now);
        let mut actions = Actions::new();
        self.core.run(event, now, &mut actions);
        for action in actions.iter() {
            self.act(action, now);
        }
    }

    /// What a recording does not have anyway: frames and results stand in it with their pairs.
    fn log_event(&mut self, event: &Event, now: Timestamp) {
        if !matches!(event, Event::Tick | Event::Frame(_) | Event::Recognised { .. }) {
            self.log(Said::Event(*event), now);
        }
    }

    fn log(&mut self, said: Said, now: Timestamp) {
        if !self.hub.log(said, now) {
            self.desk.telemetry.add_unlogged();
        }
    }

    fn say(&mut self, note: Note, now: Timestamp) {
        let paper = match note {
            Note::Pair(report) => {
                self.pairs_finished += 1;
                if let Err(why) = &report.outcome {
                    self.desk.telemetry.add_no_pick(why);
                }
                Paper::Pair(report, self.file_for(&report))
            }
            Note::Sent { frame_to_wire_ns, .. } => {
                self.desk.telemetry.record(Stage::FrameToWire, frame_to_wire_ns);
                let wire_ns = frame_to_wire_ns.saturating_sub(self.frame_to_result_ns);
                self.desk.telemetry.record(Stage::Wire, wire_ns);
                Paper::Note(note, now)
            }
            _ => Paper::Note(note, now),
        };
        if let Err(Paper::Pair(_, Some(file))) = self.hub.tell(paper) {
            self.desk.telemetry.add_unshown();
            self.hub.give_back(file);
        }
    }

    /// The file of the pair, for the cold thread, if the recogniser still finds one.
    fn file_for(&mut self, report: &PairReport) -> Option<Box<File>> {
        let of_this_pair = self.file.as_ref().is_some_and(|file| {
            file.pair.left.timestamp == report.pair.left.timestamp
                && file.pair.left.sequence == report.pair.left.sequence
        });
        if !of_this_pair {
            return None;
        }
        if !self.hub.has_file() {
            self.desk.telemetry.add_unshown();
            return None;
        }
        self.file.take()
    }

    fn measure(&mut self, file: &File) {
        let telemetry = &self.desk.telemetry;
        let stages = &file.recognition.stages;
        let earliest = file.pair.left.timestamp.min(file.pair.right.timestamp);
        self.frame_to_result_ns = file.finished.since(earliest);
        telemetry.record(Stage::FrameToResult, self.frame_to_result_ns);
        if file.refusal.is_some() {
            return;
        }
        for (stage, ns) in [
            (Stage::Decode, stages.decode_ns),
            (Stage::Binarize, stages.binarize_ns),
            (Stage::Thin, stages.thin_ns),
            (Stage::Graph, stages.graph_ns),
            (Stage::Match, stages.match_ns),
            (Stage::Pose, stages.pose_ns),
            (Stage::Recognition, stages.total_ns),
        ] {
            telemetry.record(stage, ns as i64);
        }
    }
}
