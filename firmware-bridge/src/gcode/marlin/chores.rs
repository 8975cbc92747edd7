//! The wire's own next step, when a line of its own was answered or was not.

use super::*;

impl MarlinWire {
    /// The wire's own next step in its chore.
    pub(super) fn go_on(&mut self, now: i64, events: &mut Events) {
        match self.chore {
            Chore::Greet(Greeting::Who, _) => {
                if self.foreign {
                    return;
                }
                self.chore = Chore::Greet(Greeting::Where, now);
                self.own("M114", Kind::Modal);
            }
            Chore::Greet(Greeting::Where, _) => {
                self.begin(Chore::None);
                self.next_poll = now + self.heartbeat;
                events.push(Event::Up { restarted: core::mem::take(&mut self.restarted), alarm: None });
            }
            Chore::Sync(Asking::Where)
            | Chore::Settle(Asking::Where)
            | Chore::Stop { asking: Asking::Where, .. } => {
                let chore = self.chore;
                self.begin(Chore::None);
                self.moves_ahead = 0;
                self.next_poll = now + self.heartbeat;
                events.push(match chore {
                    Chore::Stop { .. } => Event::Stopped(self.position_mm.unwrap_or_default()),
                    Chore::Settle(_) => Event::Settled,
                    _ => Event::Standing(self.position_mm.unwrap_or_default()),
                });
            }
            Chore::Stop { asking: Asking::Look, sent, last, .. }
                if now - last < STOP_DEAF && sent < STOPS_MAX =>
            {
                self.stop_again("\nM410\n", now);
                self.steps = None;
                self.own("M114", Kind::Modal);
                self.own_not_before = now + LOOK_AGAIN;
            }
            Chore::Stop { asking: Asking::Look, looks, .. } if !self.rests() => {
                if looks >= STOP_LOOKS {
                    return self.kill(events);
                }
                if let Chore::Stop { looks, .. } = &mut self.chore {
                    *looks += 1;
                }
                self.own("M114", Kind::Modal);
                self.own_not_before = now + LOOK_AGAIN;
            }
            Chore::Sync(asking) => self.chore = Chore::Sync(self.next_asking(asking)),
            Chore::Settle(asking) => self.chore = Chore::Settle(self.next_asking(asking)),
            Chore::Stop { sent, since, last, asking, looks } => {
                let asking = self.next_asking(asking);
                self.chore = Chore::Stop { sent, since, last, asking, looks };
            }
            Chore::Unlock => {
                self.begin(Chore::None);
                events.push(Event::Unlocked);
            }
            Chore::Held => {
                let held = core::mem::take(&mut self.held);
                self.begin(Chore::None);
                events.push(Event::Held(held));
            }
            Chore::Closed | Chore::Banner(_) | Chore::None => {}
        }
    }

    /// It moves on in spite of M410.
    pub(super) fn kill(&mut self, events: &mut Events) {
        self.begin(Chore::None);
        self.dead = true;
        self.urgent = Some(LineBuf::of("\nM112\n"));
        events.push(Event::Alarm { code: 112, position_lost: true });
    }

    /// Another M410.
    pub(super) fn stop_again(&mut self, bytes: &str, now: i64) {
        self.urgent = Some(LineBuf::of(bytes));
        if let Chore::Stop { sent, last, .. } = &mut self.chore {
            *sent += 1;
            *last = now;
        }
    }

    /// Two looks in a row found the steps alike, or it counts none.
    fn rests(&self) -> bool {
        self.steps == self.steps_before
    }

    fn next_asking(&mut self, asking: Asking) -> Asking {
        match asking {
            Asking::Look => {
                self.own("M400", Kind::Dwell);
                Asking::Wait
            }
            Asking::Wait | Asking::Where => {
                self.own("M114", Kind::Modal);
                Asking::Where
            }
        }
    }

    /// An answer has not come.
    pub(super) fn unanswered(&mut self, now: i64, events: &mut Events) {
        let may_ask = self.flight.as_ref().is_some_and(|flight| self.may_ask(flight));
        let Some(flight) = &mut self.flight else { return };
        if flight.is_answered(self.answered) && flight.ok_seen {
            return self.done(now, events);
        }
        if flight.taken && may_ask {
            return self.ask_anew(now);
        }
        // Known to be taken, it is sent again all the same: that it is complained about shows that the link lives.
        flight.probes += u8::from(flight.taken);
        flight.taken = false;
        if flight.probes > PROBES_MAX {
            return events.push(Event::Silent);
        }
        flight.tries += 1;
        let until = flight.held_up_until.filter(|&until| now < until);
        if flight.tries <= self.tries_max || until.is_some() {
            // The number keeps it from being executed twice.
            flight.resend = Some(now);
            if let Some(until) = until {
                // A second copy will do: each is complained about when the wait is over, and a receive buffer is small.
                flight.tries = 1;
                flight.patience = until - now;
                return;
            }
            if flight.patience >= ANSWER_WAITING && flight.kind != Some(Kind::Home) {
                flight.patience = ANSWER_WAITED;
            }
            return;
        }
        events.push(Event::Silent);
    }
}
