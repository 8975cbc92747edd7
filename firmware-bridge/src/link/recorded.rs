//! The arm of a recorded session: answers the n-th target as that arm answered its n-th, after the same time.
//!
//! Takes what cell and arm said to each other while the session was recorded; gives the same answers again, with
//! the numbers of this run. Owns the list and what of it is still to come. No thread, no randomness, no clock: the same
//! commands at the same times get the same answers. The last gate is asked as for any other arm.
//!
//! What was said is kept by the command that it answers: to the n-th target everything about that target, whenever it
//! came, and everything else up to the next command (clear of the view, ready, an alarm, a lost connection); to the n-th
//! release what followed it. Holds, unlocks, questions and handshakes are answered at once, as a sound arm does; a
//! handshake or a hold more or less than in the recording moves the releases against it, and with them how long each
//! takes.
//! - A recording that ends before a target did says that the target is lost.
//! - What only the recorded operator could end does not stop this run, whose operator has not caused it. A hold of his,
//!   by command or by a button at the arm, is left out together with its release: a target that it interrupted fails
//!   again, and the arm is ready after that. An alarm comes again, and is followed by the hold of a controller that was
//!   reset. An arm that he had to release at the start is here one that was just switched on.
//! - When the answers are used up, the next target is refused with [`Refusal::NoRecordedAnswer`] and the arm is on hold
//!   by [`HeldBy::RecordingOver`], which only an operator ends, until the target after that.

use std::collections::VecDeque;

use crate::config::Settings;
use crate::gate::Gate;
use crate::message::{Command, Disconnect, Failure, HeldBy, Outcome, Pick, Refusal, Report};

/// A piece of a recorded conversation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Said {
    /// When, ns of any clock.
    pub at_ns: i64,
    /// What, and by whom.
    pub what: What,
}

/// What was said, and by whom.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(clippy::large_enum_variant)] // read once, at the start
pub enum What {
    /// The cell, and the arm's side took it.
    Command(Command),
    /// The arm's side.
    Report(Report),
}

/// A report, and how long after its command it came.
type Answer = (i64, Report);

/// A recorded conversation, sorted by what answers what.
#[derive(Clone, Debug, PartialEq)]
pub struct Answers {
    held_by: HeldBy,
    /// From when the arm is first asked to when it connects.
    connects_after_ns: i64,
    releases: Vec<Vec<Answer>>,
    picks: Vec<Vec<Answer>>,
}

/// Whom the reports without a target's number answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Asked {
    Nobody,
    Release,
    Pick,
}

impl Answers {
    /// Sorts a conversation, which is in order of time.
    pub fn new(conversation: &[Said]) -> Self {
        let mut answers =
            Self { held_by: HeldBy::Start, connects_after_ns: 0, releases: Vec::new(), picks: Vec::new() };
        let first = conversation.iter().find_map(|said| match said.what {
            What::Report(Report::Connected { held_by, .. }) => Some(without_operator(held_by)),
            _ => None,
        });
        answers.held_by = first.unwrap_or(HeldBy::Start);
        let mut asked = Asked::Nobody;
        // The recorded operator holds the arm, which this run's does not.
        let mut is_left_out = false;
        let (mut release_ns, mut pick_ns, mut pick_id) = (0, 0, None);
        for said in conversation {
            match said.what {
                What::Command(Command::Pick(pick)) => {
                    (asked, pick_ns, pick_id) = (Asked::Pick, said.at_ns, Some(pick.id));
                    answers.picks.push(Vec::new());
                }
                What::Command(Command::Release) if std::mem::take(&mut is_left_out) => asked = Asked::Nobody,
                What::Command(Command::Release) => {
                    (asked, release_ns) = (Asked::Release, said.at_ns);
                    answers.releases.push(Vec::new());
                }
                What::Command(Command::Query { .. }) => {}
                What::Command(command) => {
                    asked = Asked::Nobody;
                    is_left_out |= command == Command::Hold;
                }
                What::Report(Report::Held { by: HeldBy::Command | HeldBy::Operator }) => is_left_out = true,
                What::Report(report) => {
                    let about = target_of(&report);
                    let is_own = about.is_some() && about == pick_id;
                    let (list, since_ns) = match asked {
                        _ if is_own => (answers.picks.last_mut(), pick_ns),
                        _ if about.is_some() || !is_kept(&report) => continue,
                        Asked::Pick => (answers.picks.last_mut(), pick_ns),
                        Asked::Release => (answers.releases.last_mut(), release_ns),
                        Asked::Nobody => continue,
                    };
                    if let Some(list) = list {
                        let report = match report {
                            Report::Connected { session, held_by } => {
                                is_left_out = false;
                                Report::Connected { session, held_by: without_operator(held_by) }
                            }
                            Report::Held { by: HeldBy::Alarm } => AFTER_ALARM,
                            other => other,
                        };
                        list.push((said.at_ns.saturating_sub(since_ns).max(0), report));
                    }
                }
            }
        }
        let last = answers.picks.len().saturating_sub(1);
        answers.picks.iter_mut().enumerate().for_each(|(n, list)| complete(list, n == last));
        // A release that the recorded operator took back makes this arm ready: this run's has not.
        answers.releases.iter_mut().for_each(|list| go_on(list, 0));
        answers
    }

    /// The same of an arm that connects so long after it is first asked.
    pub fn connecting_after(self, connects_after_ns: i64) -> Self {
        Self { connects_after_ns, ..self }
    }
}

/// What follows an alarm, which the recorded operator had to end.
const AFTER_ALARM: Report = Report::Held { by: HeldBy::ControllerReset };

/// What holds this run's arm, of which no operator knows yet, where that held the recorded one.
fn without_operator(held_by: HeldBy) -> HeldBy {
    match held_by {
        HeldBy::Command | HeldBy::Alarm | HeldBy::Operator | HeldBy::RecordingOver => HeldBy::Start,
        by @ (HeldBy::Start | HeldBy::ControllerReset | HeldBy::HeartbeatLost | HeldBy::LinkLost) => by,
    }
}

/// The target that a report is about.
fn target_of(report: &Report) -> Option<u64> {
    match *report {
        Report::Sent { id, .. }
        | Report::Accepted { id }
        | Report::Refused { id, .. }
        | Report::Moving { id }
        | Report::Done { id }
        | Report::Failed { id, .. }
        | Report::Lost { id } => Some(id),
        _ => None,
    }
}

/// The same report about another target.
fn about(report: Report, id: u64, at_ns: i64) -> Report {
    match report {
        Report::Sent { .. } => Report::Sent { id, at_ns },
        Report::Accepted { .. } => Report::Accepted { id },
        Report::Refused { refusal, .. } => Report::Refused { id, refusal },
        Report::Moving { .. } => Report::Moving { id },
        Report::Done { .. } => Report::Done { id },
        Report::Failed { failure, .. } => Report::Failed { id, failure },
        Report::Lost { .. } => Report::Lost { id },
        other => other,
    }
}

fn is_end(report: &Report) -> bool {
    matches!(
        report,
        Report::Done { .. } | Report::Failed { .. } | Report::Refused { .. } | Report::Lost { .. }
    )
}

/// What an arm says without a target's number that makes a difference to the cell.
fn is_kept(report: &Report) -> bool {
    matches!(
        report,
        Report::Connected { .. }
            | Report::Disconnected { .. }
            | Report::Ready { .. }
            | Report::ClearOfView
            | Report::Held { .. }
            | Report::Alarm { .. }
            | Report::PositionUnknown
    )
}

/// Every target ends, and something follows its end.
fn complete(list: &mut Vec<Answer>, is_last: bool) {
    list.sort_by_key(|(after_ns, _)| *after_ns);
    let last_ns = list.last().map_or(0, |(after_ns, _)| *after_ns);
    let end = list.iter().position(|(_, report)| is_end(report));
    if end.is_none() {
        list.push((last_ns, Report::Lost { id: 0 }));
    }
    match end {
        None if is_last => list.push((last_ns, Report::Held { by: HeldBy::RecordingOver })),
        None => go_on(list, list.len() - 1),
        Some(end) => go_on(list, end),
    }
}

/// The list ends, after `from`, in something that the cell goes on from without an operator.
fn go_on(list: &mut Vec<Answer>, from: usize) {
    let last_ns = list.last().map_or(0, |(after_ns, _)| *after_ns);
    let says_state = |(_, report): &Answer| is_kept(report) && *report != Report::ClearOfView;
    let state = list.iter().rposition(says_state).map(|place| (place, list[place].1));
    match state {
        Some((_, Report::Alarm { .. } | Report::PositionUnknown)) => list.push((last_ns, AFTER_ALARM)),
        Some((place, Report::Ready { .. })) if place < from => {
            list.push((last_ns, Report::Ready { clear_of_view: true }));
        }
        None => list.push((last_ns, Report::Ready { clear_of_view: true })),
        Some(_) => {}
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Absent,
    Held,
    Alarmed,
    Released,
}

/// The arm of a recorded session.
#[derive(Debug)]
pub struct RecordedLink {
    gate: Gate,
    answers: Answers,
    /// What is still to come, in order of time.
    coming: VecDeque<(i64, Report)>,
    state: State,
    ready: bool,
    /// What it said of that last.
    clear_of_view: bool,
    session: u32,
    sequence: u32,
    releases: usize,
    picks: usize,
    /// The target that has not ended.
    unfinished: Option<u64>,
    /// The last one that has, and how.
    last: Option<(u64, Outcome)>,
    not_before_ns: i64,
    /// From ready to clear of the view, where the arm does not say the latter.
    clear_dwell_ns: i64,
    first: First,
}

/// The connection that needs no handshake.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum First {
    /// Nobody has asked the arm yet.
    Unasked,
    DueAt(i64),
    Made,
}

impl RecordedLink {
    /// An arm that has just been switched on; `session_seed` decides the number of its first session.
    pub fn new(settings: &Settings, answers: Answers, session_seed: u32) -> Self {
        let longest = answers.picks.iter().chain(&answers.releases).map(Vec::len).max().unwrap_or(0);
        Self {
            gate: Gate::new(settings),
            coming: VecDeque::with_capacity(longest + 16),
            answers,
            state: State::Absent,
            ready: false,
            clear_of_view: false,
            session: session_seed,
            sequence: 0,
            releases: 0,
            picks: 0,
            unfinished: None,
            last: None,
            not_before_ns: i64::MAX,
            clear_dwell_ns: i64::from(settings.arm.clear_dwell_ms) * 1_000_000,
            first: First::Unasked,
        }
    }

    /// See [`super::Link::command`].
    pub fn command(&mut self, command: Command, now_ns: i64) -> Result<(), Refusal> {
        match command {
            Command::Pick(pick) => {
                return self.take(&pick, now_ns).inspect_err(|_| {
                    if self.ready {
                        self.say(now_ns, Report::Ready { clear_of_view: self.clear_of_view });
                    }
                });
            }
            Command::Hold => {
                self.interrupt(now_ns);
                if self.state != State::Absent {
                    self.say(now_ns, Report::Held { by: HeldBy::Command });
                }
                return Ok(());
            }
            Command::Hello => {
                self.interrupt(now_ns);
                self.first = First::Made;
                self.say(now_ns, Report::Disconnected { cause: Disconnect::NewSession });
                self.say(now_ns, Report::Connected { session: 0, held_by: HeldBy::LinkLost });
                return Ok(());
            }
            _ if self.state == State::Absent => return Err(Refusal::NotConnected),
            Command::Release => self.release(now_ns),
            Command::Unlock => self.say(now_ns, Report::Held { by: HeldBy::Alarm }),
            Command::Query { id } => {
                let outcome = match self.last {
                    _ if self.unfinished == Some(id) => Outcome::Unfinished,
                    Some((last, outcome)) if last == id => outcome,
                    _ => Outcome::Unknown,
                };
                self.say(now_ns, Report::Outcome { id, outcome });
            }
        }
        Ok(())
    }

    /// See [`super::Link::poll`].
    pub fn poll(&mut self, now_ns: i64) -> Option<Report> {
        if self.first == First::Unasked {
            self.first = First::DueAt(now_ns.saturating_add(self.answers.connects_after_ns));
        }
        if matches!(self.first, First::DueAt(at_ns) if at_ns <= now_ns) {
            self.first = First::Made;
            let held_by = self.answers.held_by;
            self.say(now_ns, Report::Connected { session: 0, held_by });
        }
        let &(due_ns, report) = self.coming.front()?;
        if due_ns > now_ns {
            return None;
        }
        self.coming.pop_front();
        Some(self.become_so(report, now_ns))
    }

    /// See [`super::Link::next_deadline_ns`].
    pub fn next_deadline_ns(&self) -> Option<i64> {
        let first = match self.first {
            First::Unasked => Some(i64::MIN),
            First::DueAt(at_ns) => Some(at_ns),
            First::Made => None,
        };
        self.coming.front().map(|(due_ns, _)| *due_ns).into_iter().chain(first).min()
    }

    fn take(&mut self, pick: &Pick, now_ns: i64) -> Result<(), Refusal> {
        match self.state {
            State::Absent => return Err(Refusal::NotConnected),
            State::Held => return Err(Refusal::OnHold),
            State::Alarmed => return Err(Refusal::InAlarm),
            State::Released => {}
        }
        if pick.session != self.session {
            return Err(Refusal::WrongSession { current: self.session });
        }
        if self.unfinished.is_some() || !self.ready {
            return Err(Refusal::Busy);
        }
        if pick.sequence <= self.sequence {
            return Err(Refusal::OldSequence { last: self.sequence });
        }
        self.gate.check(pick, now_ns, self.not_before_ns)?;
        // What the arm would have said if nothing more had been asked of it.
        self.coming.clear();
        let Some(list) = self.answers.picks.get(self.picks) else {
            self.ready = false;
            self.say(now_ns, Report::Held { by: HeldBy::RecordingOver });
            return Err(Refusal::NoRecordedAnswer);
        };
        for &(after_ns, report) in list {
            let due_ns = now_ns.saturating_add(after_ns);
            self.coming.push_back((due_ns, about(report, pick.id, due_ns)));
        }
        self.picks += 1;
        self.sequence = pick.sequence;
        self.unfinished = Some(pick.id);
        self.ready = false;
        Ok(())
    }

    fn release(&mut self, now_ns: i64) {
        if self.state != State::Held {
            return;
        }
        self.state = State::Released;
        self.coming.clear();
        let ready = [(0, Report::Ready { clear_of_view: true })];
        let list = self.answers.releases.get(self.releases).map_or(&ready[..], Vec::as_slice);
        for &(after_ns, report) in list {
            self.coming.push_back((now_ns.saturating_add(after_ns), report));
        }
        self.releases += 1;
    }

    /// What was to come does not come any more; a target that was under way has failed.
    fn interrupt(&mut self, now_ns: i64) {
        self.coming.clear();
        if let Some(id) = self.unfinished {
            self.say(now_ns, Report::Failed { id, failure: Failure::Held });
        }
    }

    fn say(&mut self, now_ns: i64, report: Report) {
        let place = self.coming.partition_point(|(due_ns, _)| *due_ns <= now_ns);
        self.coming.insert(place, (now_ns, report));
    }

    /// What a report means for the arm itself.
    fn become_so(&mut self, report: Report, now_ns: i64) -> Report {
        match report {
            Report::Connected { held_by, .. } => {
                self.session = self.session.wrapping_add(1).max(1);
                self.sequence = 0;
                self.rest(State::Held);
                return Report::Connected { session: self.session, held_by };
            }
            Report::Disconnected { .. } => self.rest(State::Absent),
            Report::Held { .. } | Report::PositionUnknown => self.rest(State::Held),
            Report::Alarm { .. } => self.rest(State::Alarmed),
            Report::ClearOfView => {
                self.clear_of_view = true;
                self.not_before_ns = self.not_before_ns.min(now_ns);
            }
            Report::Ready { clear_of_view } => {
                (self.ready, self.clear_of_view) = (true, clear_of_view);
                let dwell_ns = if clear_of_view { 0 } else { self.clear_dwell_ns };
                self.not_before_ns = self.not_before_ns.min(now_ns.saturating_add(dwell_ns));
            }
            Report::Moving { .. } => self.not_before_ns = i64::MAX,
            Report::Done { id } => self.end(id, Outcome::Done, now_ns),
            Report::Failed { id, .. } => self.end(id, Outcome::Failed, now_ns),
            Report::Refused { id, .. } => self.end(id, Outcome::Refused, now_ns),
            Report::Lost { id } => self.end(id, Outcome::Unknown, now_ns),
            _ => {}
        }
        report
    }

    fn rest(&mut self, state: State) {
        self.state = state;
        self.ready = false;
        self.not_before_ns = i64::MAX;
    }

    fn end(&mut self, id: u64, outcome: Outcome, now_ns: i64) {
        self.unfinished = None;
        self.last = Some((id, outcome));
        if self.not_before_ns != i64::MAX {
            // No picture from before the end counts, however early the arm was out of the view.
            self.not_before_ns = self.not_before_ns.max(now_ns);
        }
    }
}
