//! The bridge's side of the conversation through records.

use super::record::{ArmRecord, COMMANDS, CellRecord, REPORTS};
use crate::config::Settings;
use crate::message::{Command, HeldBy, Outcome, Refusal, Report};

const MS: i64 = 1_000_000;

/// State machine of the bridge's end: records and the arm's reports in, records out; commands go to whatever
/// `carry` leads to, a link in the process and a dialect in tests.
#[derive(Debug)]
pub struct BridgeEnd {
    heartbeat_ns: i64,
    timeout_ns: i64,
    record: ArmRecord,
    publish_due: bool,
    next_beat_ns: i64,
    heard_ns: i64,
    /// The arm was released, as far as is known.
    released: bool,
    /// It holds because its driver was lost, and for no other reason.
    driver_lost: bool,
}

impl BridgeEnd {
    /// A bridge that knows of no driver yet; `seed` differs between processes.
    pub fn new(settings: &Settings, seed: u32) -> Self {
        let arm = &settings.arm;
        let record = ArmRecord {
            bridge: seed.max(1),
            cell: 0,
            sent_ns: 0,
            acked: 0,
            newest: 0,
            reports: [None; REPORTS],
        };
        Self {
            heartbeat_ns: i64::from(arm.heartbeat_ms) * MS,
            timeout_ns: i64::from(arm.heartbeat_timeout_ms) * MS,
            record,
            publish_due: true,
            next_beat_ns: i64::MIN,
            heard_ns: 0,
            released: false,
            driver_lost: false,
        }
    }

    /// Whether a driver is connected.
    pub fn has_cell(&self) -> bool {
        self.record.cell != 0
    }

    /// A record of the driver; its new commands go to `carry`.
    pub fn on_record(
        &mut self,
        record: &CellRecord,
        now_ns: i64,
        mut carry: impl FnMut(Command) -> Result<(), Refusal>,
    ) {
        if now_ns - record.sent_ns > self.timeout_ns {
            // It waited while this process stood still or the machine was suspended: nothing in it counts any more.
            return;
        }
        if record.bridge != self.record.bridge {
            // Not for this life of the bridge: a driver that has to hear of it first.
            if self.has_cell() && record.cell != self.record.cell {
                self.drop_cell(&mut carry);
            }
            self.publish_due = true;
            return;
        }
        if record.cell != self.record.cell {
            self.record.cell = record.cell;
            (self.record.acked, self.record.newest) = (0, 0);
            self.record.reports = [None; REPORTS];
            self.publish_due = true;
            // Whatever an earlier driver left is dropped, and the arm is on hold.
            let _ = carry(Command::Hello);
        }
        self.heard_ns = now_ns;
        if record.newest != self.record.acked {
            self.carry_out(record, &mut carry);
        }
    }

    /// A report of the arm's.
    pub fn on_report(&mut self, report: Report) {
        match report {
            Report::Ready { .. } | Report::Moving { .. } => (self.released, self.driver_lost) = (true, false),
            Report::Held { .. } | Report::Connected { .. } | Report::Alarm { .. } => self.released = false,
            _ => {}
        }
        let report = self.with_true_cause(report);
        if !self.has_cell() {
            return;
        }
        self.record.newest = self.record.newest.wrapping_add(1);
        self.record.reports[self.record.newest as usize % REPORTS] = Some(report);
        self.publish_due = true;
    }

    /// Lets time pass: without its driver the arm is held.
    pub fn run_timers(&mut self, now_ns: i64, mut carry: impl FnMut(Command) -> Result<(), Refusal>) {
        if self.has_cell() && now_ns - self.heard_ns > self.timeout_ns {
            self.drop_cell(&mut carry);
        }
    }

    /// The record to publish now, if there is a reason to.
    pub fn record(&mut self, now_ns: i64) -> Option<ArmRecord> {
        if !self.publish_due && now_ns < self.next_beat_ns {
            return None;
        }
        self.publish_due = false;
        self.next_beat_ns = now_ns + self.heartbeat_ns;
        self.record.sent_ns = now_ns;
        Some(self.record)
    }

    /// When something has to happen by itself.
    pub fn next_deadline_ns(&self) -> i64 {
        if self.publish_due {
            return i64::MIN;
        }
        let silent_ns = if self.has_cell() { self.heard_ns + self.timeout_ns + 1 } else { i64::MAX };
        self.next_beat_ns.min(silent_ns)
    }

    /// The arm itself only knows that it was told to hold. A driver that was killed has not told it so.
    fn with_true_cause(&self, report: Report) -> Report {
        let by = HeldBy::HeartbeatLost;
        match report {
            Report::Held { by: HeldBy::Command } if self.driver_lost => Report::Held { by },
            Report::Connected { session, held_by: HeldBy::Command } if self.driver_lost => {
                Report::Connected { session, held_by: by }
            }
            _ => report,
        }
    }

    fn carry_out(&mut self, record: &CellRecord, carry: &mut impl FnMut(Command) -> Result<(), Refusal>) {
        let new = record.newest.wrapping_sub(self.record.acked).min(COMMANDS as u32);
        let numbers = (0..new).rev().map(|back| record.newest.wrapping_sub(back));
        let commands = || numbers.clone().filter_map(|number| record.commands[number as usize % COMMANDS]);
        let is_hold = |(_, command): &(usize, Command)| matches!(command, Command::Hold);
        let hold = commands().enumerate().filter(is_hold).last().map(|(at, _)| at);
        for (at, command) in commands().enumerate() {
            // A hold overtakes what came with it: nothing before it begins any more.
            let answer = match hold {
                Some(hold) if at < hold && matches!(command, Command::Pick(_)) => Err(Refusal::OnHold),
                Some(hold) if at < hold && !matches!(command, Command::Query { .. }) => continue,
                _ => carry(command),
            };
            match command {
                Command::Hold => (self.released, self.driver_lost) = (false, false),
                Command::Release if answer.is_ok() => (self.released, self.driver_lost) = (true, false),
                _ => {}
            }
            match (command, answer) {
                (Command::Pick(pick), Err(refusal)) => {
                    self.on_report(Report::Refused { id: pick.id, refusal })
                }
                (Command::Query { id }, Err(_)) => {
                    self.on_report(Report::Outcome { id, outcome: Outcome::Unknown })
                }
                _ => {}
            }
        }
        self.record.acked = record.newest;
        self.publish_due = true;
    }

    /// The driver is gone: the arm stops, and only a new conversation moves it again.
    fn drop_cell(&mut self, carry: &mut impl FnMut(Command) -> Result<(), Refusal>) {
        let _ = carry(Command::Hold);
        (self.driver_lost, self.released) = (self.driver_lost || self.released, false);
        self.record.cell = 0;
        self.record.bridge = super::next_life(self.record.bridge);
        self.publish_due = true;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gate::tests::{pick, settings};
    use proptest::prelude::*;

    fn record(bridge: u32, newest: u32, commands: [Option<Command>; COMMANDS]) -> CellRecord {
        CellRecord { cell: 9, bridge, sent_ns: 0, newest, commands }
    }

    /// What a bridge of life 5 carries to the arm for this record.
    fn carried(end: &mut BridgeEnd, record: &CellRecord) -> Vec<Command> {
        let mut carried = Vec::new();
        end.on_record(record, 0, |command| {
            carried.push(command);
            Ok(())
        });
        carried
    }

    #[test]
    fn what_was_meant_for_another_life_of_the_bridge_is_not_carried() {
        let mut end = BridgeEnd::new(&settings(), 5);
        let left = [None, Some(Command::Pick(pick())), None, None];
        assert_eq!(carried(&mut end, &record(4, 1, left)), []);
        assert!(!end.has_cell());
        assert_eq!(carried(&mut end, &record(5, 0, [None; COMMANDS])), [Command::Hello]);
        assert!(end.has_cell());
    }

    #[test]
    fn a_release_that_waited_through_a_suspend_is_not_carried() {
        let mut end = BridgeEnd::new(&settings(), 5);
        carried(&mut end, &record(5, 0, [None; COMMANDS]));
        let mut waited = record(5, 1, [None, Some(Command::Release), None, None]);
        waited.sent_ns = 100 * MS;
        let hour_ns = 3_600_000 * MS;
        let mut all = Vec::new();
        let mut carry = |command| {
            all.push(command);
            Ok(())
        };
        end.on_record(&waited, hour_ns, &mut carry);
        end.run_timers(hour_ns, &mut carry);
        assert_eq!((all, end.has_cell()), (vec![Command::Hold], false));
    }

    #[test]
    fn a_hold_for_a_lost_driver_is_told_from_one_that_the_driver_wanted() {
        for (commands, cause) in [
            (vec![Command::Release], HeldBy::HeartbeatLost),
            (vec![Command::Release, Command::Hold], HeldBy::Command),
            (vec![], HeldBy::Command),
        ] {
            let mut end = BridgeEnd::new(&settings(), 5);
            carried(&mut end, &record(5, 0, [None; COMMANDS]));
            end.on_report(Report::Connected { session: 1, held_by: HeldBy::Start });
            for (at, command) in commands.iter().enumerate() {
                let mut all = [None; COMMANDS];
                all[at + 1] = Some(*command);
                assert_eq!(carried(&mut end, &record(5, at as u32 + 1, all)), [*command]);
            }
            end.run_timers(i64::MAX, |_| Ok(()));
            assert!(!end.has_cell());
            end.on_report(Report::Held { by: HeldBy::Command });
            let life = end.record(0).unwrap().bridge;
            assert_eq!(carried(&mut end, &record(life, 0, [None; COMMANDS])), [Command::Hello]);
            end.on_report(Report::Connected { session: 2, held_by: HeldBy::Command });
            let said = end.record(0).unwrap().reports[1];
            assert_eq!(said, Some(Report::Connected { session: 2, held_by: cause }), "{commands:?}");
        }
    }

    #[test]
    fn a_hold_makes_void_what_came_with_it() {
        let mut end = BridgeEnd::new(&settings(), 5);
        carried(&mut end, &record(5, 0, [None; COMMANDS]));
        let commands =
            [None, Some(Command::Pick(pick())), Some(Command::Hold), Some(Command::Query { id: 3 })];
        assert_eq!(carried(&mut end, &record(5, 3, commands)), [Command::Hold, Command::Query { id: 3 }]);
        let said = end.record(0).unwrap().reports[1];
        assert_eq!(said, Some(Report::Refused { id: 7, refusal: Refusal::OnHold }));
        assert_eq!(carried(&mut end, &record(5, 3, commands)), [], "nothing twice");
    }

    #[test]
    fn the_longest_records_fit_into_shared_memory() {
        let mut longest = pick();
        (longest.id, longest.session, longest.sequence) = (u64::MAX, u32::MAX, u32::MAX);
        (longest.deadline_ms, longest.ttl_ms, longest.slot) = (u32::MAX, u32::MAX, u32::MAX);
        longest.seen = crate::message::Seen { left_ns: i64::MIN, right_ns: i64::MIN, period_ns: i64::MIN };
        let mut bytes = [0; crate::link::shared::ports::RECORD_LEN_MAX];
        let mut cell = record(u32::MAX, u32::MAX, [Some(Command::Pick(longest)); COMMANDS]);
        (cell.cell, cell.sent_ns) = (u32::MAX, i64::MIN);
        postcard::to_slice(&cell, &mut bytes).unwrap();
        let refusal = Refusal::Stale { age_ms: u32::MAX, max_ms: u32::MAX };
        let reports = [Some(Report::Refused { id: u64::MAX, refusal }); REPORTS];
        let sent_ns = i64::MIN;
        let arm = ArmRecord {
            bridge: u32::MAX,
            cell: u32::MAX,
            sent_ns,
            acked: u32::MAX,
            newest: u32::MAX,
            reports,
        };
        postcard::to_slice(&arm, &mut bytes).unwrap();
    }

    proptest! {
        #[test]
        fn no_record_makes_a_bridge_panic(numbers in proptest::collection::vec((4u32..6, any::<u32>(), 0u8..5), 1..30)) {
            let mut end = BridgeEnd::new(&settings(), 5);
            for (bridge, newest, kind) in numbers {
                let command = [None, Some(Command::Hold), Some(Command::Release), Some(Command::Pick(pick()))];
                let command = command.get(usize::from(kind)).copied().flatten();
                let carried = carried(&mut end, &record(bridge, newest, [command; COMMANDS]));
                prop_assert!(carried.len() <= COMMANDS + 1);
            }
        }
    }
}
