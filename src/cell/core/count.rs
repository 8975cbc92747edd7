//! What is counted, by cause.

/// A thing that is counted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(usize)]
pub enum Cause {
    /// Frames that arrived.
    Frames,
    /// Frames skipped in the driver for a newer one.
    Skipped,
    /// Frames missing in the driver's count.
    Gap,
    /// Frames missing by their time stamps, with no gap in the count.
    Missing,
    /// Frames marked as damaged.
    Damaged,
    /// Frames cut short.
    Short,
    /// Frames stamped more than a period into the future.
    Future,
    /// Frames without a partner when the next of their side came.
    Unpaired,
    /// Frames further from the other side's than the window.
    OutOfStep,
    /// Pairs.
    Pairs,
    /// Pairs that a newer one replaced before the recogniser was free.
    Superseded,
    /// Pairs whose result came after the deadline.
    DeadlineMissed,
    /// Parts recognised.
    Parts,
    /// Targets ordered.
    Ordered,
    /// Targets whose last byte is on the wire.
    Sent,
    /// Targets sent after the deadline.
    SentLate,
    /// Targets done.
    Done,
    /// Targets failed.
    Failed,
    /// Targets refused.
    Refused,
    /// Targets lost.
    Lost,
    /// Targets that were unfinished at the end.
    Abandoned,
    /// Candidates that the last gate refused before they were ordered.
    GateRefused,
    /// Bytes from the arm that were no message.
    GarbageBytes,
    /// Reports about a target that is not under way.
    StrayReports,
    /// Times the arm was lost.
    ArmLost,
    /// Times a camera was lost or silent.
    CameraLost,
}

impl Cause {
    /// All of them, in order.
    pub const ALL: [Cause; 26] = [
        Cause::Frames,
        Cause::Skipped,
        Cause::Gap,
        Cause::Missing,
        Cause::Damaged,
        Cause::Short,
        Cause::Future,
        Cause::Unpaired,
        Cause::OutOfStep,
        Cause::Pairs,
        Cause::Superseded,
        Cause::DeadlineMissed,
        Cause::Parts,
        Cause::Ordered,
        Cause::Sent,
        Cause::SentLate,
        Cause::Done,
        Cause::Failed,
        Cause::Refused,
        Cause::Lost,
        Cause::Abandoned,
        Cause::GateRefused,
        Cause::GarbageBytes,
        Cause::StrayReports,
        Cause::ArmLost,
        Cause::CameraLost,
    ];

    /// In words, as the summary prints it.
    pub fn name(self) -> &'static str {
        match self {
            Cause::Frames => "frames",
            Cause::Skipped => "frames skipped for newer ones",
            Cause::Gap => "frames missing in the sequence",
            Cause::Missing => "frames missing by their time stamps",
            Cause::Damaged => "frames damaged",
            Cause::Short => "frames cut short",
            Cause::Future => "frames from the future",
            Cause::Unpaired => "frames without a partner",
            Cause::OutOfStep => "frames out of step",
            Cause::Pairs => "pairs",
            Cause::Superseded => "pairs skipped, recogniser busy",
            Cause::DeadlineMissed => "deadline misses",
            Cause::Parts => "parts found",
            Cause::Ordered => "targets ordered",
            Cause::Sent => "targets sent",
            Cause::SentLate => "targets sent late",
            Cause::Done => "targets done",
            Cause::Failed => "targets failed",
            Cause::Refused => "targets refused",
            Cause::Lost => "targets lost",
            Cause::Abandoned => "targets unfinished at the end",
            Cause::GateRefused => "candidates refused by the last gate",
            Cause::GarbageBytes => "bytes of garbage from the arm",
            Cause::StrayReports => "stray reports of the arm",
            Cause::ArmLost => "times the arm was lost",
            Cause::CameraLost => "times a camera was lost",
        }
    }
}

/// A number for every [`Cause`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts([u64; Cause::ALL.len()]);

impl Counts {
    /// Adds `n`.
    pub fn add(&mut self, cause: Cause, n: u64) {
        self.0[cause as usize] = self.0[cause as usize].saturating_add(n);
    }

    /// So many up to now.
    pub fn get(&self, cause: Cause) -> u64 {
        self.0[cause as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_cause_has_its_own_place() {
        for (i, cause) in Cause::ALL.into_iter().enumerate() {
            assert_eq!(cause as usize, i);
        }
    }
}
