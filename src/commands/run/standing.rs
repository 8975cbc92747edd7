//! How the cell stands, in one line for the service manager: what keeps it from picking, if anything does, and the
//! counts.

use crate::cell::core::{Alarm, Cause, NoPick, Note, State, TargetSent};
use crate::telemetry::Telemetry;

/// What was said and still holds.
#[derive(Default)]
pub(super) struct Standing {
    /// Why a camera gives nothing.
    cameras: [Option<Alarm>; 2],
    /// Why the arm does not move, in the words of the last alarm.
    arm: Option<Alarm>,
    /// Why the last pair that was looked at led to no target.
    no_pick: Option<NoPick>,
}

impl Standing {
    /// Takes in what became of a pair; says whether that is news: a target, or another reason for none than before.
    pub(super) fn pair(&mut self, outcome: Result<TargetSent, NoPick>) -> bool {
        let no_pick = outcome.err();
        // Of a pair that a newer one replaced nothing is known.
        if no_pick == Some(NoPick::Superseded) {
            return false;
        }
        let kind = |no_pick: &Option<NoPick>| no_pick.as_ref().map(NoPick::kind);
        let is_news = no_pick.is_none() || kind(&no_pick) != kind(&self.no_pick);
        self.no_pick = no_pick;
        is_news
    }

    /// Takes in what else the core says.
    pub(super) fn hear(&mut self, note: &Note) {
        match *note {
            Note::Alarm(alarm @ (Alarm::CameraLost { side, .. } | Alarm::CameraSilent { side })) => {
                self.cameras[side.index()] = Some(alarm);
                self.no_pick = None;
            }
            Note::CameraBack { side } => self.cameras[side.index()] = None,
            Note::Alarm(
                alarm @ (Alarm::ArmLost { .. }
                | Alarm::ArmSilent
                | Alarm::OnHold { .. }
                | Alarm::Controller { .. }
                | Alarm::PositionUnknown
                | Alarm::TargetTimedOut { .. }
                | Alarm::ReportsLost
                | Alarm::WrongVersion { .. }
                | Alarm::WrongDialect
                | Alarm::Suspended { .. }),
            ) => self.arm = Some(alarm),
            Note::Connected { .. } | Note::Released | Note::Ready => self.arm = None,
            Note::Pair(_)
            | Note::Sent { .. }
            | Note::Accepted { .. }
            | Note::Ended { .. }
            | Note::Alarm(_)
            | Note::SlotFilled { .. } => {}
        }
    }

    /// All but the counts.
    pub(super) fn words(&self, state: State) -> String {
        let mut words: Vec<String> = self.cameras.iter().flatten().map(Alarm::to_string).collect();
        let stands = matches!(state, State::Absent | State::Held | State::Alarmed);
        match self.arm.filter(|_| stands) {
            Some(alarm) => words.push(alarm.to_string()),
            None => words.push(state.to_string()),
        }
        if let Some(why) = &self.no_pick {
            words.push(format!("last pair: {why}"));
        }
        words.join(" | ")
    }
}

/// The counts behind them.
pub(super) fn counts(telemetry: &Telemetry) -> String {
    let count = |cause| telemetry.count(cause);
    format!(
        "{} pairs, {} targets sent, {} done, {} deadline misses",
        count(Cause::Pairs),
        count(Cause::Sent),
        count(Cause::Done),
        count(Cause::DeadlineMissed)
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Side, Trouble};
    use firmware_bridge::message::HeldBy;

    #[test]
    fn it_names_what_keeps_the_cell_from_picking_until_that_is_over() {
        let mut standing = Standing::default();
        assert_eq!(standing.words(State::Absent), "arm not connected");
        standing.hear(&Note::Alarm(Alarm::ArmSilent));
        assert!(standing.words(State::Absent).starts_with("the arm does not answer"));
        standing.hear(&Note::Connected { session: 1 });
        standing.hear(&Note::Alarm(Alarm::OnHold { by: HeldBy::Start }));
        let lost = Alarm::CameraLost { side: Side::Right, trouble: Trouble::Unplugged };
        standing.hear(&Note::Alarm(lost));
        let words = standing.words(State::Held);
        assert!(words.contains("right camera: unplugged") && words.contains("SIGUSR1"), "{words}");
        standing.hear(&Note::CameraBack { side: Side::Right });
        standing.hear(&Note::Released);
        standing.hear(&Note::Ready);
        assert_eq!(standing.words(State::Looking), "looking");
        standing.hear(&Note::Alarm(Alarm::SlotLeftOut { slot: 3 }));
        assert_eq!(standing.words(State::Held), "on hold", "another alarm is no reason for it");
    }

    #[test]
    fn a_pair_is_news_where_it_leads_to_a_target_or_to_none_for_another_reason() {
        let mut standing = Standing::default();
        let mut is_news = |outcome| standing.pair(outcome);
        let target = Ok(TargetSent { id: 7, candidate: 0 });
        assert!(is_news(Err(NoPick::OnHold)));
        assert!(!is_news(Err(NoPick::OnHold)));
        assert!(
            !is_news(Err(NoPick::Superseded)) && !is_news(Err(NoPick::OnHold)),
            "of that nothing is known"
        );
        assert!(is_news(Err(NoPick::ArmBusy)) && is_news(target) && is_news(target));
        assert!(is_news(Err(NoPick::ArmBusy)));
        assert!(standing.words(State::Moving).ends_with("last pair: arm busy"));
    }
}
