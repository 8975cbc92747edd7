//! The cell's end of PickCell's own protocol (PROTOCOL.md): handshake, heartbeats, acknowledgements, resends.
//!
//! The arm tells its whole state in every [`Status`](crate::codec::Status), so a lost packet is made good by the next one, and nothing
//! the arm says needs an acknowledgement. The cell's commands carry rising sequence numbers; one is under way at a
//! time, and sent again, with the same number, until the arm's `acked` reaches it. Only a hold overtakes.
//!
//! What became of a pick whose acknowledgement fails to come is decided by the order of the line: a heartbeat that was
//! sent after it and came back with a smaller `acked` proves that the pick never arrived.

mod follow;
mod say;

use super::{Reports, Transmit};
use crate::codec::{Decoder, FromArm, PACKET_LEN_MAX, PacketError, ToArm, ToArmBody};
use crate::config::Settings;
use crate::gate::Gate;
use crate::message::{Command, Disconnect, HeldBy, Pick, Refusal, Report};

const MS: i64 = 1_000_000;

/// Commands that may wait behind the one under way.
const QUEUE_LEN: usize = 4;

/// Hellos without an answer after which text on the line is taken for another dialect.
const HELLOS_BEFORE_VERDICT: u32 = 3;

/// The state machine; see the module `dialect` for how to drive it.
#[derive(Debug)]
pub struct Own {
    gate: Gate,
    timing: Timing,
    reports: Reports,
    decoder: Decoder,
    phase: Phase,
    /// Number of the next session.
    next_session: u32,
    session: u32,
    /// Last sequence number given to a command.
    sequence: u32,
    /// The highest one that went out and is not proven lost: what the arm says before it has it is old.
    awaited: u32,
    queue: [Option<Pending>; QUEUE_LEN],
    hold: Option<Pending>,
    current: Option<Current>,
    beat: Beat,
    heard_ns: i64,
    announced: Announced,
    clear_of_view: bool,
    position_known: bool,
    /// Both frames of a pick must be later.
    not_before_ns: i64,
    /// Sequence of the last pick that was taken.
    pick_sequence: u32,
    noise: Noise,
}

/// Times from `[arm]`, ns.
#[derive(Debug)]
struct Timing {
    heartbeat_ns: i64,
    heartbeat_timeout_ms: u32,
    handshake_ns: i64,
    ack_ns: i64,
    resends: u32,
    pick_ns: i64,
    clear_dwell_ns: i64,
    /// One byte on the wire: ten bits.
    byte_ns: i64,
}

impl Timing {
    /// When the last byte of a packet that is made now is on the wire at the latest.
    fn written_ns(&self, now_ns: i64) -> i64 {
        now_ns + PACKET_LEN_MAX as i64 * self.byte_ns
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    /// No port.
    Down,
    /// Saying hello every `handshake_timeout_ms`.
    /// `sent_ns`: the oldest hello that a welcome may still answer; all of a session carry the same number.
    Shaking { next_ns: i64, sent_ns: Option<i64>, hellos: u32 },
    /// A session is open.
    Up,
}

/// A command that waits for its acknowledgement.
#[derive(Clone, Copy, Debug)]
struct Pending {
    sequence: u32,
    body: Body,
    /// When it is to be sent (again).
    due_ns: i64,
    attempts: u32,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Body {
    Pick,
    Hold,
    Release,
    Query { id: u64 },
    Unlock,
}

/// The pick that was taken and has not ended.
#[derive(Clone, Copy, Debug)]
struct Current {
    pick: Pick,
    sequence: u32,
    /// Whether its bytes were ever handed over.
    transmitted: bool,
    accepted: bool,
    moving: bool,
    /// When it must be complete.
    timeout_ns: i64,
    /// Number of the first heartbeat that went out after its bytes.
    probe: Option<u32>,
}

#[derive(Debug)]
struct Beat {
    next_ns: i64,
    number: u32,
    /// When `number` was sent, until it has come back.
    sent_ns: Option<i64>,
    /// The last two round trips.
    round_trips_ns: [i64; 2],
}

impl Beat {
    /// One way, ns; the worse of the last two.
    fn delay_ns(&self) -> i64 {
        self.round_trips_ns[0].max(self.round_trips_ns[1]) / 2
    }
}

/// What of the arm's state was last reported.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Announced {
    Nothing,
    Held(HeldBy),
    Ready,
    Busy,
    Alarm(u16),
}

/// Bytes that were no packet.
#[derive(Debug, Default)]
struct Noise {
    unreported: u32,
    /// Since the handshake began: all, and those that are printable text.
    bytes: u32,
    text: u32,
    verdict: bool,
}

impl Own {
    /// A machine without a port; `session_seed` is the number of its first session (0 is made 1).
    pub fn new(settings: &Settings, session_seed: u32) -> Self {
        let arm = &settings.arm;
        let ns = |ms: u32| i64::from(ms) * MS;
        Self {
            gate: Gate::new(settings),
            timing: Timing {
                heartbeat_ns: ns(arm.heartbeat_ms),
                heartbeat_timeout_ms: arm.heartbeat_timeout_ms,
                handshake_ns: ns(arm.handshake_timeout_ms),
                ack_ns: ns(arm.ack_timeout_ms),
                resends: arm.resends,
                pick_ns: ns(arm.pick_timeout_ms),
                clear_dwell_ns: ns(arm.clear_dwell_ms),
                byte_ns: 10_000_000_000 / i64::from(arm.baud),
            },
            reports: Reports::new(),
            decoder: Decoder::new(),
            phase: Phase::Down,
            next_session: session_seed.max(1),
            session: 0,
            sequence: 0,
            awaited: 0,
            queue: [None; QUEUE_LEN],
            hold: None,
            current: None,
            beat: Beat { next_ns: 0, number: 0, sent_ns: None, round_trips_ns: [0; 2] },
            heard_ns: 0,
            announced: Announced::Nothing,
            clear_of_view: false,
            position_known: true,
            not_before_ns: i64::MAX,
            pick_sequence: 0,
            noise: Noise::default(),
        }
    }

    /// The port was opened, or is gone.
    pub fn on_link(&mut self, up: bool, now_ns: i64) {
        if !up && self.phase == Phase::Down {
            return;
        }
        if self.phase != Phase::Down {
            self.disconnect(Disconnect::PortGone, now_ns);
        }
        self.decoder.clear();
        if up {
            self.shake(now_ns);
        } else {
            self.phase = Phase::Down;
            self.hold = None;
        }
    }

    /// Bytes that arrived.
    pub fn on_bytes(&mut self, bytes: &[u8], now_ns: i64) {
        if self.phase == Phase::Down {
            return;
        }
        for &byte in bytes {
            self.noise.bytes = self.noise.bytes.saturating_add(1);
            if matches!(byte, b' '..=b'~' | b'\r' | b'\n' | b'\t') {
                self.noise.text = self.noise.text.saturating_add(1);
            }
            match self.decoder.push::<FromArm>(byte) {
                None => {}
                Some(Ok(message)) => self.on_message(message, now_ns),
                Some(Err(PacketError::WrongVersion { theirs })) => self.on_wrong_version(theirs),
                Some(Err(PacketError::Garbage { bytes } | PacketError::UnknownMessage { bytes })) => {
                    self.noise.unreported =
                        self.noise.unreported.saturating_add(u32::try_from(bytes).unwrap_or(u32::MAX));
                }
            }
        }
        if self.decoder.unfinished() > PACKET_LEN_MAX {
            self.noise.unreported = self.noise.unreported.saturating_add(self.decoder.unfinished() as u32);
            self.decoder.clear();
        }
    }

    /// What the cell wants. See `dialect` for the meaning of `Ok` and `Err`.
    pub fn command(&mut self, command: Command, now_ns: i64) -> Result<(), Refusal> {
        match command {
            Command::Hello => {
                if self.phase != Phase::Down {
                    self.disconnect(Disconnect::NewSession, now_ns);
                }
                Ok(())
            }
            Command::Hold => {
                self.start_hold(now_ns);
                Ok(())
            }
            Command::Pick(pick) => self.take_pick(pick, now_ns).inspect_err(|_| {
                if self.announced == Announced::Ready && self.hold.is_none() && self.position_known {
                    self.reports.push(Report::Ready { clear_of_view: self.clear_of_view });
                }
            }),
            Command::Release => self.enqueue(Body::Release, now_ns),
            Command::Query { id } => self.enqueue(Body::Query { id }, now_ns),
            Command::Unlock => self.enqueue(Body::Unlock, now_ns),
        }
    }

    /// Lets time pass; the next report.
    pub fn poll(&mut self, now_ns: i64) -> Option<Report> {
        self.run_timers(now_ns);
        if self.noise.unreported > 0 {
            let bytes = core::mem::take(&mut self.noise.unreported);
            self.reports.push(Report::Garbage { bytes });
        }
        self.reports.pop()
    }

    /// The next bytes to write now; `out` is at least [`super::TRANSMIT_LEN_MIN`] long.
    pub fn transmit(&mut self, now_ns: i64, out: &mut [u8]) -> Transmit {
        if let Some(hold) = self.hold.filter(|hold| hold.due_ns <= now_ns) {
            let len = self.put(ToArm { sequence: hold.sequence, body: ToArmBody::Hold }, out);
            self.hold = Some(self.again(hold, now_ns));
            return Transmit { len, urgent: true, pick: None };
        }
        match self.phase {
            Phase::Down => Transmit::default(),
            Phase::Shaking { next_ns, hellos, sent_ns } if next_ns <= now_ns => {
                let next_ns = now_ns + self.timing.handshake_ns;
                let timeout_ns = i64::from(self.timing.heartbeat_timeout_ms) * MS;
                let sent_ns = sent_ns.filter(|sent_ns| now_ns - sent_ns < timeout_ns).or(Some(now_ns));
                self.phase = Phase::Shaking { next_ns, sent_ns, hellos: hellos.saturating_add(1) };
                let heartbeat_timeout_ms = self.timing.heartbeat_timeout_ms;
                let body = ToArmBody::Hello { session: self.session, heartbeat_timeout_ms };
                Transmit { len: self.put(ToArm { sequence: 0, body }, out), urgent: false, pick: None }
            }
            Phase::Shaking { .. } => Transmit::default(),
            Phase::Up => self.transmit_up(now_ns, out),
        }
    }

    /// Whether a hold has not gone out yet.
    pub fn has_urgent(&self) -> bool {
        self.hold.is_some_and(|hold| hold.attempts == 0)
    }

    /// The bytes that hold the begin of a pick are written.
    pub fn on_written(&mut self, id: u64, at_ns: i64) {
        self.reports.push(Report::Sent { id, at_ns });
    }

    /// When `poll` or `transmit` have something to do without a byte arriving.
    pub fn next_deadline_ns(&self) -> Option<i64> {
        if !self.reports.is_empty() || self.noise.unreported > 0 {
            return Some(i64::MIN);
        }
        let hold = self.hold.map(|hold| hold.due_ns);
        let phase = match self.phase {
            Phase::Down => None,
            Phase::Shaking { next_ns, .. } => Some(next_ns),
            Phase::Up => {
                let silent = self.heard_ns + i64::from(self.timing.heartbeat_timeout_ms) * MS + 1;
                let pick = self.current.map(|current| current.timeout_ns);
                let head = self.queue[0].map(|head| head.due_ns);
                [Some(silent), Some(self.beat.next_ns), pick, head].into_iter().flatten().min()
            }
        };
        hold.into_iter().chain(phase).min()
    }

    /// A hold goes out at the next `transmit`; what was not transmitted never will be.
    fn start_hold(&mut self, now_ns: i64) {
        if self.phase == Phase::Down {
            return;
        }
        self.queue = [None; QUEUE_LEN];
        if let Some(current) = self.current.filter(|current| !current.transmitted) {
            self.current = None;
            self.reports.push(Report::Refused { id: current.pick.id, refusal: Refusal::OnHold });
        }
        self.sequence += 1;
        self.hold = Some(Pending { sequence: self.sequence, body: Body::Hold, due_ns: now_ns, attempts: 0 });
    }

    fn shake(&mut self, now_ns: i64) {
        self.session = self.next_session;
        self.next_session = self.next_session.wrapping_add(1).max(1);
        self.phase = Phase::Shaking { next_ns: now_ns, sent_ns: None, hellos: 0 };
        self.noise = Noise { unreported: self.noise.unreported, ..Noise::default() };
        self.announced = Announced::Nothing;
        self.not_before_ns = i64::MAX;
    }

    /// The session is over: what was under way is lost, what was not sent is refused, and hellos begin.
    fn disconnect(&mut self, cause: Disconnect, now_ns: i64) {
        if let Some(current) = self.current.take() {
            let id = current.pick.id;
            self.reports.push(match current.transmitted {
                true => Report::Lost { id },
                false => Report::Refused { id, refusal: Refusal::NotConnected },
            });
        }
        self.queue = [None; QUEUE_LEN];
        if self.phase == Phase::Up {
            self.reports.push(Report::Disconnected { cause });
        }
        self.shake(now_ns);
    }

    fn run_timers(&mut self, now_ns: i64) {
        let resends = self.timing.resends;
        if self.hold.is_some_and(|hold| hold.due_ns <= now_ns && hold.attempts > resends) {
            self.hold = None;
            if self.phase == Phase::Up {
                self.disconnect(Disconnect::Silent, now_ns);
            }
        }
        match self.phase {
            Phase::Down => {}
            Phase::Shaking { hellos, .. } => {
                let text = self.noise.text >= 8 && self.noise.text >= self.noise.bytes / 10 * 9;
                if hellos >= HELLOS_BEFORE_VERDICT && text && !self.noise.verdict {
                    self.noise.verdict = true;
                    self.reports.push(Report::WrongDialect);
                }
            }
            Phase::Up => self.run_timers_up(now_ns),
        }
    }

    fn run_timers_up(&mut self, now_ns: i64) {
        if now_ns - self.heard_ns > i64::from(self.timing.heartbeat_timeout_ms) * MS {
            self.disconnect(Disconnect::Silent, now_ns);
            return;
        }
        if let Some(head) = self.queue[0]
            && head.body != Body::Pick
            && head.due_ns <= now_ns
            && head.attempts > self.timing.resends
        {
            self.disconnect(Disconnect::Silent, now_ns);
            return;
        }
        if let Some(current) = self.current.filter(|current| current.timeout_ns <= now_ns) {
            self.current = None;
            let failure = crate::message::Failure::TimedOut;
            self.reports.push(Report::Failed { id: current.pick.id, failure });
            self.start_hold(now_ns);
        }
    }
}

#[cfg(test)]
mod tests;
