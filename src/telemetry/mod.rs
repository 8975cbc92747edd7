//! What is measured: written by the real-time threads, read by the others.
//!
//! Takes durations and counts; gives quantiles and a table; owns the buckets. Writing is a relaxed atomic addition:
//! no lock, no allocation, no clock.

mod histogram;

use std::sync::atomic::{AtomicU8, AtomicU64, Ordering};

pub use histogram::{Histogram, Summary};

use crate::cell::core::{Cause, Counts, NoPick, State};

/// A part of the way from light to wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(usize)]
pub enum Stage {
    /// From a frame's time stamp to its arrival in the cell.
    Transfer,
    /// From the arrival of the later frame of a pair to the begin of its recognition.
    Queue,
    /// Decompression, both pictures.
    Decode,
    /// Pixels to bits.
    Binarize,
    /// Bits to skeletons.
    Thin,
    /// Skeletons to graphs.
    Graph,
    /// Search.
    Match,
    /// Refinement and grasps.
    Pose,
    /// The whole recognition.
    Recognition,
    /// From the end of the recognition to the last byte of the target on the wire.
    Wire,
    /// From the older frame's time stamp to the end of the recognition.
    FrameToResult,
    /// From the older frame's time stamp to the last byte of the target on the wire.
    FrameToWire,
}

impl Stage {
    /// All of them, in order.
    pub const ALL: [Stage; 12] = [
        Stage::Transfer,
        Stage::Queue,
        Stage::Decode,
        Stage::Binarize,
        Stage::Thin,
        Stage::Graph,
        Stage::Match,
        Stage::Pose,
        Stage::Recognition,
        Stage::Wire,
        Stage::FrameToResult,
        Stage::FrameToWire,
    ];

    /// As the table prints it.
    pub fn name(self) -> &'static str {
        match self {
            Stage::Transfer => "transfer",
            Stage::Queue => "queue",
            Stage::Decode => "decode",
            Stage::Binarize => "binarize",
            Stage::Thin => "thin",
            Stage::Graph => "graph",
            Stage::Match => "match",
            Stage::Pose => "pose",
            Stage::Recognition => "recognition",
            Stage::Wire => "wire",
            Stage::FrameToResult => "frame to result",
            Stage::FrameToWire => "frame to wire",
        }
    }
}

/// Everything that is measured in a cell.
#[derive(Debug)]
pub struct Telemetry {
    stages: [Histogram; Stage::ALL.len()],
    counts: [AtomicU64; Cause::ALL.len()],
    no_picks: [AtomicU64; NoPick::KINDS.len()],
    state: AtomicU8,
    unshown: AtomicU64,
    unlogged: AtomicU64,
    unkept: AtomicU64,
}

impl Telemetry {
    /// Nothing measured yet.
    pub fn new() -> Self {
        Self {
            stages: std::array::from_fn(|_| Histogram::new()),
            counts: std::array::from_fn(|_| AtomicU64::new(0)),
            no_picks: std::array::from_fn(|_| AtomicU64::new(0)),
            state: AtomicU8::new(State::Absent as u8),
            unshown: AtomicU64::new(0),
            unlogged: AtomicU64::new(0),
            unkept: AtomicU64::new(0),
        }
    }

    /// Records how long a stage took.
    pub fn record(&self, stage: Stage, ns: i64) {
        self.stages[stage as usize].record(u64::try_from(ns).unwrap_or(0));
    }

    /// The durations of a stage.
    pub fn stage(&self, stage: Stage) -> &Histogram {
        &self.stages[stage as usize]
    }

    /// Makes the core's state and counts readable for the other threads.
    pub fn publish(&self, state: State, counts: &Counts) {
        self.state.store(state as u8, Ordering::Relaxed);
        for cause in Cause::ALL {
            self.counts[cause as usize].store(counts.get(cause), Ordering::Relaxed);
        }
    }

    /// What the arm is doing.
    pub fn state(&self) -> State {
        State::ALL[usize::from(self.state.load(Ordering::Relaxed))]
    }

    /// So many up to now.
    pub fn count(&self, cause: Cause) -> u64 {
        self.counts[cause as usize].load(Ordering::Relaxed)
    }

    /// A pair led to no target.
    pub fn add_no_pick(&self, why: &NoPick) {
        self.no_picks[why.kind()].fetch_add(1, Ordering::Relaxed);
    }

    /// Reasons for no target and how often, those that came up.
    pub fn no_picks(&self) -> impl Iterator<Item = (&'static str, u64)> + '_ {
        let counts = self.no_picks.iter().map(|count| count.load(Ordering::Relaxed));
        NoPick::KINDS.into_iter().zip(counts).filter(|&(_, count)| count > 0)
    }

    /// A pair was handled, but the threads that print and draw had no room for it.
    pub fn add_unshown(&self) {
        self.unshown.fetch_add(1, Ordering::Relaxed);
    }

    /// An event was to be recorded, but there was no room for it.
    pub fn add_unlogged(&self) {
        self.unlogged.fetch_add(1, Ordering::Relaxed);
    }

    /// Events that are not in the recording for want of room.
    pub fn unlogged(&self) -> u64 {
        self.unlogged.load(Ordering::Relaxed)
    }

    /// A frame that led to no search was to be recorded, but there was no room for it.
    pub fn add_unkept(&self) {
        self.unkept.fetch_add(1, Ordering::Relaxed);
    }

    /// Frames without a search that are not in the recording for want of room.
    pub fn unkept(&self) -> u64 {
        self.unkept.load(Ordering::Relaxed)
    }

    /// Pairs without a picture for want of room.
    pub fn unshown(&self) -> u64 {
        self.unshown.load(Ordering::Relaxed)
    }
}

impl Default for Telemetry {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stages_and_counts_have_their_own_places() {
        let telemetry = Telemetry::new();
        for (i, stage) in Stage::ALL.into_iter().enumerate() {
            assert_eq!(stage as usize, i);
            telemetry.record(stage, i as i64);
            assert_eq!(telemetry.stage(stage).summary().count, 1);
        }
        let mut counts = Counts::default();
        counts.add(Cause::Sent, 3);
        for state in State::ALL {
            telemetry.publish(state, &counts);
            assert_eq!(telemetry.state(), state);
        }
        assert_eq!((telemetry.count(Cause::Sent), telemetry.count(Cause::Done)), (3, 0));
        telemetry.add_no_pick(&NoPick::ArmBusy);
        assert_eq!(telemetry.no_picks().collect::<Vec<_>>(), [("arm busy", 1)]);
        assert_eq!(NoPick::Superseded.to_string(), "recogniser busy");
        assert_eq!(NoPick::KINDS.last(), Some(&"recogniser busy"));
    }
}
