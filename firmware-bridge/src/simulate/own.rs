//! A firmware that speaks PickCell's own protocol: the arm's end of `dialect::own`, as PROTOCOL.md asks for it.
//!
//! Rests at its park position out of view, executes one pick at a time as straight legs, holds on command, when the
//! heartbeat stops and after every start, and remembers its last pick through a restart.

use super::{Body, Fault, Faults, Motion};
use crate::codec::{
    self, ArmRefusal, ArmState, Decoder, FromArm, LastPick, PACKET_LEN_MAX, Progress, Status, ToArm,
    ToArmBody, WirePick, WirePose,
};
use crate::message::{Failure, HeldBy};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;
use std::collections::VecDeque;

const MS: i64 = 1_000_000;

/// Ordinary speed of the tool, mm/s.
const SPEED_MM_S: f64 = 500.0;
/// From a packet's last byte to the begin of motion.
const BEGIN_NS: i64 = 5 * MS;
/// Time the fingers take.
const FINGERS_NS: i64 = 120 * MS;
/// From a restart to the first word.
const BOOT_NS: i64 = 250 * MS;

/// The firmware.
#[derive(Debug)]
pub struct OwnFirmware {
    decoder: Decoder,
    out: VecDeque<u8>,
    motions: VecDeque<Motion>,
    rng: Pcg32,
    faults: Faults,
    park_mm: [f64; 3],
    body: Body,
    boots_ns: Option<i64>,
    session: u32,
    echo: u32,
    acked: u32,
    heard_ns: i64,
    heartbeat_timeout_ns: i64,
    held_by: Option<HeldBy>,
    last: Option<LastPick>,
    work: Work,
    told: Option<(ArmState, bool, Option<LastPick>)>,
    /// So many times as fast as an ordinary arm.
    tempo: f64,
}

/// What the arm is at.
#[derive(Clone, Copy, Debug)]
enum Work {
    Nothing,
    /// A pick that begins soon.
    Waiting {
        pick: WirePick,
        begin_ns: i64,
        expires_ns: i64,
    },
    /// A step of a pick, with the moment when a step that is no leg ends.
    Pick {
        pick: WirePick,
        step: usize,
        until_ns: Option<i64>,
        /// When this pick's restart comes.
        reset_ns: Option<i64>,
        holds_part: bool,
    },
    /// On its way out of view.
    Parking,
}

impl OwnFirmware {
    /// An arm that has just started at its park position.
    pub fn new(park_mm: [f64; 3], faults: Faults) -> Self {
        Self {
            decoder: Decoder::new(),
            out: VecDeque::with_capacity(4096),
            motions: VecDeque::with_capacity(256),
            rng: Pcg32::seed_from_u64(faults.seed),
            faults,
            park_mm,
            body: Body::new(park_mm, SPEED_MM_S),
            boots_ns: None,
            session: 0,
            echo: 0,
            acked: 0,
            heard_ns: 0,
            heartbeat_timeout_ns: i64::MAX,
            held_by: Some(HeldBy::Start),
            last: None,
            work: Work::Nothing,
            told: None,
            tempo: 1.0,
        }
    }

    /// Makes it move so many times as fast as an ordinary arm: for endurance tests of the cell, which would wait for
    /// the arm most of the time.
    pub fn set_tempo(&mut self, tempo: f64) {
        self.tempo = tempo;
        self.body.speed_mm_s = SPEED_MM_S * tempo;
    }

    fn hasten(&self, ns: i64) -> i64 {
        (ns as f64 / self.tempo) as i64
    }

    /// Bytes that arrived.
    pub fn on_bytes(&mut self, bytes: &[u8], now_ns: i64) {
        if self.boots_ns.is_some() {
            return;
        }
        for &byte in bytes {
            if let Some(Ok(message)) = self.decoder.push::<ToArm>(byte) {
                self.on_message(message, now_ns);
            }
        }
    }

    /// Lets time pass; what the arm did.
    pub fn poll(&mut self, now_ns: i64) -> Option<Motion> {
        if self.boots_ns.is_some_and(|at| at <= now_ns) {
            self.boots_ns = None;
            let status = self.status(now_ns);
            self.say(FromArm::Welcome(status));
        }
        if self.boots_ns.is_none() {
            if self.session != 0
                && self.held_by.is_none()
                && now_ns.saturating_sub(self.heard_ns) > self.heartbeat_timeout_ns
            {
                self.hold(HeldBy::HeartbeatLost, now_ns);
            }
            self.work(now_ns);
            self.tell_changes(now_ns);
        }
        self.motions.pop_front()
    }

    /// Bytes to answer now.
    pub fn transmit(&mut self, _now_ns: i64, out: &mut [u8]) -> usize {
        super::take(&mut self.out, out)
    }

    /// When something happens by itself.
    pub fn next_deadline_ns(&self) -> Option<i64> {
        if self.boots_ns.is_some() {
            return self.boots_ns;
        }
        let silent = (self.session != 0 && self.held_by.is_none())
            .then(|| self.heard_ns.saturating_add(self.heartbeat_timeout_ns).saturating_add(1));
        let work = match self.work {
            Work::Nothing | Work::Parking => None,
            Work::Waiting { begin_ns, .. } => Some(begin_ns),
            Work::Pick { until_ns, reset_ns, .. } => until_ns.into_iter().chain(reset_ns).min(),
        };
        silent.into_iter().chain(work).chain(self.body.arrives_ns()).min()
    }

    /// Restarts: stops, forgets the session, remembers the last pick.
    pub fn reset(&mut self, now_ns: i64) {
        let stopped = self.body.stop(now_ns);
        self.motions.extend(stopped);
        self.motions.push_back(Motion::Restarted);
        if let Some(last) = self.last.as_mut().filter(|last| !last.progress.is_final()) {
            last.progress = match last.progress {
                Progress::Accepted => Progress::Refused(ArmRefusal::OnHold),
                _ => Progress::Failed(Failure::Restarted),
            };
        }
        self.out.clear();
        self.decoder.clear();
        self.boots_ns = Some(now_ns + BOOT_NS);
        (self.session, self.echo, self.acked) = (0, 0, 0);
        self.heartbeat_timeout_ns = i64::MAX;
        self.held_by = Some(HeldBy::Start);
        self.work = Work::Nothing;
        self.told = None;
    }

    /// From now on nothing goes wrong by itself.
    pub fn heal(&mut self) {
        self.faults.set = 0;
        self.body.speed_mm_s = SPEED_MM_S * self.tempo;
    }

    fn on_message(&mut self, message: ToArm, now_ns: i64) {
        match message.body {
            ToArmBody::Hello { session, heartbeat_timeout_ms } => {
                self.heard_ns = now_ns;
                if session != self.session {
                    self.hold(HeldBy::LinkLost, now_ns);
                    (self.session, self.echo, self.acked) = (session, 0, 0);
                    self.heartbeat_timeout_ns = i64::from(heartbeat_timeout_ms) * MS;
                }
                let status = self.status(now_ns);
                self.say(FromArm::Welcome(status));
            }
            ToArmBody::Heartbeat { session, number } => {
                if session == self.session {
                    self.heard_ns = now_ns;
                    self.echo = number;
                }
                self.say_status(now_ns);
            }
            // A hold is obeyed in every session and however often it comes.
            ToArmBody::Hold => {
                self.acked = self.acked.max(message.sequence);
                self.hold(HeldBy::Command, now_ns);
                self.say_status(now_ns);
            }
            // The same command again: only the answer got lost.
            _ if message.sequence <= self.acked => self.say_status(now_ns),
            body => {
                self.acked = message.sequence;
                self.heard_ns = now_ns;
                self.on_command(body, now_ns);
                self.say_status(now_ns);
            }
        }
    }

    fn on_command(&mut self, body: ToArmBody, now_ns: i64) {
        match body {
            ToArmBody::Pick(pick) => self.on_pick(pick, now_ns),
            ToArmBody::Release { session } if session == self.session && session != 0 => {
                self.held_by = None;
                if matches!(self.work, Work::Nothing) && self.body.position_mm(now_ns) != self.park_mm {
                    self.go(self.park_mm, now_ns);
                    self.work = Work::Parking;
                }
            }
            ToArmBody::Query { id } => {
                let progress = self.last.filter(|last| last.id == id).map(|last| last.progress);
                self.say(FromArm::Outcome { id, progress });
            }
            // This arm has no alarm to leave.
            ToArmBody::Unlock { .. } => self.hold(HeldBy::Alarm, now_ns),
            _ => {}
        }
    }

    fn on_pick(&mut self, pick: WirePick, now_ns: i64) {
        let refusal = if pick.session != self.session {
            Some(ArmRefusal::WrongSession)
        } else if self.held_by.is_some() {
            Some(ArmRefusal::OnHold)
        } else if !matches!(self.work, Work::Nothing) {
            // The one under way stays the last pick; the cell never does this.
            return;
        } else if pick.ttl_ms == 0 {
            Some(ArmRefusal::Expired)
        } else if !pick.is_finite() {
            Some(ArmRefusal::NotFinite)
        } else if self.draw(Fault::Refused, 0.2) {
            Some(ArmRefusal::Unreachable)
        } else {
            None
        };
        let progress = refusal.map_or(Progress::Accepted, Progress::Refused);
        self.last = Some(LastPick { id: pick.id, progress });
        if refusal.is_none() {
            let expires_ns = now_ns + i64::from(pick.ttl_ms) * MS;
            let slow = self.draw(Fault::Slow, 0.3);
            let begin_ns =
                now_ns + if slow { self.rng.random_range(10..600) * MS } else { self.hasten(BEGIN_NS) };
            self.work = Work::Waiting { pick, begin_ns, expires_ns };
        }
    }

    /// Stops; a pick under way has failed, one that was not begun never will be.
    fn hold(&mut self, by: HeldBy, now_ns: i64) {
        match core::mem::replace(&mut self.work, Work::Nothing) {
            Work::Waiting { .. } => self.progress(Progress::Refused(ArmRefusal::OnHold)),
            Work::Pick { .. } => self.progress(Progress::Failed(Failure::Held)),
            Work::Nothing | Work::Parking => {}
        }
        let stopped = self.body.stop(now_ns);
        self.motions.extend(stopped);
        self.held_by.get_or_insert(by);
    }

    fn work(&mut self, now_ns: i64) {
        let arrived = self.body.arrive(now_ns);
        self.motions.extend(arrived);
        match self.work {
            Work::Nothing => {}
            Work::Parking if arrived.is_some() => self.work = Work::Nothing,
            Work::Parking => {}
            Work::Waiting { begin_ns, .. } if begin_ns > now_ns => {}
            Work::Waiting { expires_ns, .. } if expires_ns < now_ns => {
                self.work = Work::Nothing;
                self.progress(Progress::Refused(ArmRefusal::Expired));
            }
            Work::Waiting { pick, .. } => self.begin(pick, now_ns),
            Work::Pick { reset_ns: Some(at), .. } if at <= now_ns => self.reset(now_ns),
            Work::Pick { until_ns: Some(at), .. } if at > now_ns => {}
            Work::Pick { until_ns: None, .. } if arrived.is_none() => {}
            Work::Pick { pick, step, reset_ns, holds_part, .. } => {
                self.step(pick, step + 1, reset_ns, holds_part, now_ns);
            }
        }
    }

    fn begin(&mut self, pick: WirePick, now_ns: i64) {
        self.progress(Progress::Moving);
        self.body.speed_mm_s =
            self.tempo * if self.draw(Fault::Slow, 0.3) { SPEED_MM_S / 10.0 } else { SPEED_MM_S };
        let reset = self.draw(Fault::Reset, 0.2);
        let reset_ns = reset.then(|| now_ns + self.rng.random_range(0..1000) * MS);
        let holds_part = !self.draw(Fault::NotHeld, 0.2);
        self.step(pick, 0, reset_ns, holds_part, now_ns);
    }

    /// Approach, grasp, close, retreat, place, open, park.
    fn step(&mut self, pick: WirePick, step: usize, reset_ns: Option<i64>, holds_part: bool, now_ns: i64) {
        let mut until_ns = None;
        match step {
            0 => self.go(position_mm(&pick.approach), now_ns),
            1 => self.go(position_mm(&pick.grasp), now_ns),
            2 => {
                self.motions.push_back(Motion::Closed { holds_part });
                until_ns = Some(now_ns + self.hasten(FINGERS_NS));
            }
            3 => self.go(position_mm(&pick.retreat), now_ns),
            // Without a part there is nothing to place.
            4 if holds_part => self.go(position_mm(&pick.place), now_ns),
            4 => self.go(self.park_mm, now_ns),
            5 if holds_part => {
                self.motions.push_back(Motion::Opened);
                until_ns = Some(now_ns + self.hasten(FINGERS_NS));
            }
            6 if holds_part => self.go(self.park_mm, now_ns),
            _ => {
                self.work = Work::Nothing;
                self.progress(match holds_part {
                    true => Progress::Done,
                    false => Progress::Failed(Failure::PartNotHeld),
                });
                return;
            }
        }
        self.work = Work::Pick { pick, step, until_ns, reset_ns, holds_part };
    }

    fn go(&mut self, to_mm: [f64; 3], now_ns: i64) {
        let motion = self.body.go(to_mm, now_ns);
        self.motions.push_back(motion);
    }

    fn progress(&mut self, progress: Progress) {
        if let Some(last) = &mut self.last {
            last.progress = progress;
        }
    }

    fn draw(&mut self, fault: Fault, probability: f64) -> bool {
        self.faults.has(fault) && self.rng.random_bool(probability)
    }

    fn arm_state(&self) -> ArmState {
        match (self.held_by, self.work) {
            (Some(by), _) => ArmState::Held(by),
            (None, Work::Nothing) => ArmState::Ready,
            (None, _) => ArmState::Busy,
        }
    }

    fn status(&self, now_ns: i64) -> Status {
        Status {
            session: self.session,
            echo: self.echo,
            acked: self.acked,
            arm: self.arm_state(),
            clear_of_view: self.body.position_mm(now_ns) == self.park_mm,
            position_known: true,
            last: self.last,
        }
    }

    fn tell_changes(&mut self, now_ns: i64) {
        let status = self.status(now_ns);
        let now = Some((status.arm, status.clear_of_view, status.last));
        if self.told != now && self.session != 0 {
            self.say_status(now_ns);
        }
        self.told = now;
    }

    fn say_status(&mut self, now_ns: i64) {
        let status = self.status(now_ns);
        self.told = Some((status.arm, status.clear_of_view, status.last));
        self.say(FromArm::Status(status));
    }

    fn say(&mut self, message: FromArm) {
        let mut packet = [0; PACKET_LEN_MAX];
        let len = codec::encode(&message, &mut packet).expect("the longest message fits");
        // A line that nobody reads must not fill the memory.
        if self.out.len() + len <= 4096 {
            self.out.extend(&packet[..len]);
        }
    }
}

fn position_mm(pose: &WirePose) -> [f64; 3] {
    pose.position_mm.map(f64::from)
}
