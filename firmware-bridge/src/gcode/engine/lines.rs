//! Which line is sent next, and whether it may be.

use super::super::line::LineBuf;
use super::super::template::{List, Step};
use super::super::wire::{About, MS, Wire};
use super::super::words::Kind;
use super::{Driver, FLIGHT_MAX, Phase, Stage};
use crate::dialect::Transmit;
use crate::message::{Failure, Outcome, Pick, Refusal, Report, Waypoint};

/// Number, checksum and end that a wire puts around a line, bytes.
const FRAME_LEN: usize = 16;
/// A controller that is asked whether it reaches the poses of a pick may begin it this much after the deadline of the
/// target's bytes: the questions carry the target, and are within the deadline. An answer that got lost takes longer.
const REACH_MS: u32 = 100;

#[allow(private_bounds)]
impl<W: Wire> Driver<W> {
    /// Sends the next line that may be sent.
    pub(super) fn pump(&mut self, now_ns: i64, out: &mut [u8]) -> Transmit {
        if !matches!(self.phase, Phase::Working | Phase::Starting) {
            return Transmit::default();
        }
        loop {
            match self.stage {
                Stage::Preamble(index) => return self.preamble(index, now_ns, out),
                Stage::WaitingUntil(at) if now_ns >= at => self.stage = Stage::Lines,
                Stage::Lines => {}
                _ => return Transmit::default(),
            }
            if self.stage != Stage::Lines {
                continue;
            }
            let step = self.program.list(self.list).get(self.next).copied();
            let kind = match step {
                Some(Step::Line(line)) => Some(line.kind),
                _ => None,
            };
            if kind != Some(Kind::Motion) {
                // Everything but a move waits for the moves before it.
                if !self.flight.is_empty() {
                    return Transmit::default();
                }
                if self.moved {
                    self.stage = Stage::Syncing;
                    self.wire.sync(now_ns);
                    return self.own_bytes(now_ns, out);
                }
            }
            match step {
                None => {
                    self.end_list(now_ns);
                    if !matches!(self.phase, Phase::Working | Phase::Starting) {
                        return Transmit::default();
                    }
                }
                Some(Step::Held) => {
                    self.next += 1;
                    let Some(question) = &self.program.held else { continue };
                    self.stage = Stage::AskingHeld;
                    self.wire.ask_held(question, now_ns);
                    return self.own_bytes(now_ns, out);
                }
                Some(Step::Line(line)) if line.kind == Kind::Dwell && W::WAITS_HERE => {
                    self.next += 1;
                    self.stage = Stage::WaitingUntil(now_ns + i64::from(line.dwell_ms) * MS);
                }
                Some(Step::Line(_)) => return self.send_line(now_ns, out),
            }
        }
    }

    fn own_bytes(&mut self, now_ns: i64, out: &mut [u8]) -> Transmit {
        let (len, urgent) = self.wire.transmit(now_ns, out);
        Transmit { len, urgent, pick: None }
    }

    fn preamble(&mut self, index: u8, now_ns: i64, out: &mut [u8]) -> Transmit {
        let Some(line) = W::PREAMBLE.get(usize::from(index)) else {
            self.stage = Stage::Lines;
            return self.pump(now_ns, out);
        };
        if !self.flight.is_empty() || !self.wire.takes(line.text.len()) {
            return Transmit::default();
        }
        self.flight.push_back(Kind::Modal);
        let text = LineBuf::of(line.text);
        let len =
            self.wire.send(&text, About { kind: Kind::Modal, dwell_ms: 0, expires_ns: None }, now_ns, out);
        Transmit { len, urgent: false, pick: None }
    }

    /// Fills, checks and sends the line that is next.
    fn send_line(&mut self, now_ns: i64, out: &mut [u8]) -> Transmit {
        let Some(Step::Line(line)) = self.program.list(self.list).get(self.next).copied() else {
            return Transmit::default();
        };
        // After anything but a move the next line waits for its acknowledgement.
        let only_moves = self.flight.iter().all(|&kind| kind == Kind::Motion);
        if !only_moves || self.flight.len() >= FLIGHT_MAX {
            return Transmit::default();
        }
        let pick = self.current.map(|current| current.pick);
        let filled = line.fill(pick.as_ref(), self.program.tool());
        if !self.wire.takes(filled.map_or(0, |filled| filled.text.len())) {
            return Transmit::default();
        }
        let begun = self.current.is_none_or(|current| current.begun);
        let checked = filled
            .ok_or(Refusal::NotFinite { at: Waypoint::Line })
            .and_then(|filled| self.check_now(filled.point_mm, filled.text.len(), now_ns).map(|()| filled));
        let filled = match checked {
            Ok(filled) => filled,
            Err(refusal) if !begun => {
                self.refuse_current(refusal);
                return Transmit::default();
            }
            Err(_) => {
                self.stop_astray(now_ns);
                return self.own_bytes(now_ns, out);
            }
        };
        self.next += 1;
        self.flight.push_back(line.kind);
        if let Some(current) = &mut self.current {
            current.sent = true;
        }
        let mut begins = None;
        if line.kind == Kind::Motion {
            for axis in 0..3 {
                let from = self.expected_mm[axis].or(self.seen_mm[axis]);
                let room = self.room_mm[axis].filter(|_| self.moved).or(from.map(|at| (at, at)));
                let to = filled.point_mm[axis];
                // From an unknown place the way there is unknown too.
                self.room_mm[axis] =
                    room.map(|(low, high)| to.map_or((low, high), |to| (low.min(to), high.max(to))));
                self.expected_mm[axis] = to.or(self.expected_mm[axis]);
            }
            self.moved = true;
            if let Some(current) = self.current.as_mut().filter(|current| !current.begun) {
                current.begun = true;
                begins = Some(current.pick.id);
            }
        }
        if line.kind == Kind::Home {
            (self.expected_mm, self.seen_mm) = ([None; 3], [None; 3]);
        }
        let expires_ns = begins.and(self.current).map(|current| {
            self.expires_ns(&current.pick).saturating_sub(self.on_the_wire_ns(filled.text.len()))
        });
        let about = About { kind: line.kind, dwell_ms: line.dwell_ms, expires_ns };
        let len = self.wire.send(&filled.text, about, now_ns, out);
        Transmit { len, urgent: false, pick: begins }
    }

    /// A list has come to its end, the arm stands.
    fn end_list(&mut self, now_ns: i64) {
        let current = self.current.map(|current| current.pick.id);
        match (self.list, current) {
            (List::Pick, Some(id)) => {
                self.current = None;
                self.finish(Report::Done { id }, id, Outcome::Done);
            }
            (List::Missed, Some(_)) => self.end_current(Failure::PartNotHeld),
            _ => {}
        }
        self.clear_of_view = self.list == List::Clear;
        if self.list != List::Clear && !self.program.list(List::Clear).is_empty() {
            return self.begin_list(List::Clear);
        }
        if self.clear_of_view {
            self.reports.push(Report::ClearOfView);
        }
        self.phase = Phase::Ready;
        self.stage = Stage::Lines;
        self.deadline_ns = None;
        self.not_before_ns = now_ns;
        self.reports.push(Report::Ready { clear_of_view: self.clear_of_view });
    }

    /// When the bytes that begin a pick must be on the wire: the arm does not look at the time, so what the line takes
    /// to it is taken off the time to live.
    fn expires_ns(&self, pick: &Pick) -> i64 {
        let ttl_ms = pick.ttl_ms.saturating_sub(self.delay_us.div_ceil(1000) + W::BEGIN_MS);
        pick.seen.earliest_ns().saturating_add(i64::from(ttl_ms) * MS)
    }

    /// How long a line of so many characters is on its way out of the port.
    fn on_the_wire_ns(&self, len: usize) -> i64 {
        (len + FRAME_LEN) as i64 * self.byte_ns
    }

    /// The last gate, immediately before the bytes of a line of `len` characters are made: its coordinates, and as
    /// long as the pick has not begun also its time, as it will be when the last of them is on the wire.
    fn check_now(&self, point_mm: [Option<f64>; 3], len: usize, now_ns: i64) -> Result<(), Refusal> {
        let Some(current) = &self.current else { return self.gate.check_box(Waypoint::Line, point_mm) };
        if !current.begun {
            let mut pick = current.pick;
            pick.ttl_ms = u32::try_from((self.expires_ns(&pick) - pick.seen.earliest_ns()) / MS).unwrap_or(0);
            if current.sent {
                pick.deadline_ms = pick.ttl_ms;
            } else if W::CHECKS_REACH {
                pick.deadline_ms = pick.deadline_ms.saturating_add(REACH_MS).min(pick.ttl_ms);
            }
            let written_ns = now_ns.saturating_add(self.on_the_wire_ns(len));
            self.gate.check(&pick, written_ns, self.not_before_ns)?;
        }
        self.gate.check_line(&current.pick, point_mm)
    }
}
