//! What the cell says while a session stands: commands in their order, heartbeats, and the pick as long as the gate lets it
//! pass.

use super::{Announced, Body, Current, MS, Own, Pending, Phase};
use crate::codec::{self, ToArm, ToArmBody, WirePick};
use crate::dialect::Transmit;
use crate::message::{Pick, Refusal, Report};

impl Own {
    pub(super) fn transmit_up(&mut self, now_ns: i64, out: &mut [u8]) -> Transmit {
        if let Some(head) = self.queue[0].filter(|head| head.due_ns <= now_ns) {
            let body = match head.body {
                Body::Pick => return self.transmit_pick(head, now_ns, out),
                Body::Hold => ToArmBody::Hold,
                Body::Release => ToArmBody::Release { session: self.session },
                Body::Query { id } => ToArmBody::Query { id },
                Body::Unlock => ToArmBody::Unlock { session: self.session },
            };
            self.queue[0] = Some(self.again(head, now_ns));
            return Transmit {
                len: self.put(ToArm { sequence: head.sequence, body }, out),
                urgent: false,
                pick: None,
            };
        }
        if self.beat.next_ns <= now_ns {
            self.beat.number = self.beat.number.wrapping_add(1);
            self.beat.sent_ns = Some(now_ns);
            self.beat.next_ns = now_ns + self.timing.heartbeat_ns;
            if let Some(current) = &mut self.current
                && current.transmitted
            {
                current.probe.get_or_insert(self.beat.number);
            }
            let body = ToArmBody::Heartbeat { session: self.session, number: self.beat.number };
            return Transmit { len: self.put(ToArm { sequence: 0, body }, out), urgent: false, pick: None };
        }
        Transmit::default()
    }

    /// Makes the bytes of the pick, if the gate still lets it pass at the moment its last byte will be on the wire.
    pub(super) fn transmit_pick(&mut self, head: Pending, now_ns: i64, out: &mut [u8]) -> Transmit {
        let Some(current) = &mut self.current else {
            self.queue[0] = None;
            return Transmit::default();
        };
        let pick = current.pick;
        let written_ns = self.timing.written_ns(now_ns);
        let checked = self.gate.check(&pick, written_ns, self.not_before_ns);
        let spent = head.attempts > self.timing.resends;
        if let Some(refusal) = checked.err().or(spent.then_some(Refusal::NotAcknowledged)) {
            if current.transmitted {
                // Too late for another attempt. Whether the first one arrived the next heartbeat tells.
                self.queue[0] = Some(Pending { due_ns: i64::MAX, ..head });
                self.beat.next_ns = self.beat.next_ns.min(now_ns);
                return self.transmit_up(now_ns, out);
            }
            self.current = None;
            self.drop_head();
            self.reports.push(Report::Refused { id: pick.id, refusal });
            self.ask_again(now_ns);
            return Transmit::default();
        }
        current.transmitted = true;
        current.probe = None;
        current.timeout_ns = current.timeout_ns.min(now_ns + self.timing.pick_ns);
        let left_ns = i64::from(pick.ttl_ms) * MS - pick.age_ns(written_ns) - self.beat.delay_ns();
        let ttl_ms = u32::try_from(left_ns / MS).unwrap_or(0);
        self.queue[0] = Some(self.again(head, now_ns));
        let message = ToArm { sequence: head.sequence, body: ToArmBody::Pick(WirePick::new(&pick, ttl_ms)) };
        Transmit { len: self.put(message, out), urgent: false, pick: Some(pick.id) }
    }

    /// The arm never heard of the pick and is as ready as before: the next status shall say so again.
    pub(super) fn ask_again(&mut self, now_ns: i64) {
        self.announced = Announced::Nothing;
        self.beat.next_ns = self.beat.next_ns.min(now_ns);
    }

    pub(super) fn put(&mut self, message: ToArm, out: &mut [u8]) -> usize {
        self.awaited = self.awaited.max(message.sequence);
        codec::encode(&message, out).expect("the buffer is TRANSMIT_LEN_MIN long")
    }

    /// `pending` with one attempt more; what the line itself takes is no delay of the arm's.
    pub(super) fn again(&self, pending: Pending, now_ns: i64) -> Pending {
        let due_ns = now_ns + self.timing.ack_ns + 2 * self.beat.delay_ns();
        Pending { due_ns, attempts: pending.attempts + 1, ..pending }
    }

    pub(super) fn drop_head(&mut self) {
        self.queue[0] = None;
        self.queue.rotate_left(1);
    }

    pub(super) fn enqueue(&mut self, body: Body, now_ns: i64) -> Result<(), Refusal> {
        if self.phase != Phase::Up {
            return Err(Refusal::NotConnected);
        }
        let free = self.queue.iter_mut().find(|slot| slot.is_none()).ok_or(Refusal::Busy)?;
        self.sequence += 1;
        *free = Some(Pending { sequence: self.sequence, body, due_ns: now_ns, attempts: 0 });
        Ok(())
    }

    pub(super) fn take_pick(&mut self, pick: Pick, now_ns: i64) -> Result<(), Refusal> {
        if self.phase != Phase::Up {
            return Err(Refusal::NotConnected);
        }
        if pick.session != self.session {
            return Err(Refusal::WrongSession { current: self.session });
        }
        if self.current.is_some() {
            return Err(Refusal::Busy);
        }
        if self.hold.is_some() {
            return Err(Refusal::OnHold);
        }
        match self.announced {
            Announced::Ready if self.queue[0].is_none() => {}
            Announced::Held(_) => return Err(Refusal::OnHold),
            Announced::Alarm(_) => return Err(Refusal::InAlarm),
            _ => return Err(Refusal::Busy),
        }
        if !self.position_known {
            return Err(Refusal::PositionUnknown);
        }
        if pick.sequence <= self.pick_sequence {
            return Err(Refusal::OldSequence { last: self.pick_sequence });
        }
        self.gate.check(&pick, now_ns, self.not_before_ns)?;
        self.enqueue(Body::Pick, now_ns)?;
        self.pick_sequence = pick.sequence;
        self.announced = Announced::Busy;
        let timeout_ns = now_ns + self.timing.pick_ns;
        self.current = Some(Current {
            pick,
            sequence: self.sequence,
            transmitted: false,
            accepted: false,
            moving: false,
            timeout_ns,
            probe: None,
        });
        Ok(())
    }
}
