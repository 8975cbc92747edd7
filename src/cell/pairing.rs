//! Which left and right frame belong together.
//!
//! Takes frames of both sides in the order in which they arrive; gives pairs whose time stamps differ by at most a
//! window. Owns at most one waiting frame a side: the newest counts. With a window under half a frame period a
//! frame has at most one partner in it, so the first is the nearest.
//!
//! ```
//! use pickcell::camera::{Condition, Side};
//! use pickcell::cell::pairing::{FrameSeen, Handle, Pairing};
//! use pickcell::frame::TimestampMark;
//! use pickcell::time::Timestamp;
//!
//! let frame = |side, at_ms: i64| FrameSeen {
//!     handle: Handle(0),
//!     side,
//!     timestamp: Timestamp(1_000_000 * at_ms),
//!     mark: TimestampMark::EndOfFrame,
//!     sequence: 0,
//!     condition: Condition::default(),
//!     skipped: 0,
//! };
//! let mut pairing = Pairing::new(13_000_000); // of a camera with 30 frames a second
//! assert!(pairing.run(frame(Side::Left, 100)).pair.is_none());
//! let pair = pairing.run(frame(Side::Right, 103)).pair.unwrap();
//! assert_eq!((pair.number, pair.right.timestamp.since(pair.left.timestamp)), (1, 3_000_000));
//! // the right camera left one out: the waiting left frame will never have a partner
//! pairing.run(frame(Side::Left, 133));
//! let late = pairing.run(frame(Side::Right, 170));
//! assert_eq!(late.out_of_step, Some((Handle(0), 37_000_000)));
//! ```

use serde::{Deserialize, Serialize};

use crate::camera::{Condition, Side};
use crate::frame::TimestampMark;
use crate::time::Timestamp;

/// Where the carrier keeps the pixels of a frame; the core only passes it back.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Handle(pub u8);

/// All that decisions need to know of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FrameSeen {
    /// Its pixels.
    pub handle: Handle,
    /// Which camera.
    pub side: Side,
    /// When the light was seen.
    pub timestamp: Timestamp,
    /// What moment of the exposure that is.
    pub mark: TimestampMark,
    /// The driver's frame counter.
    pub sequence: u32,
    /// What the driver says about it.
    pub condition: Condition,
    /// Older frames that the driver had and that were skipped for this one.
    pub skipped: u32,
}

/// Two frames of one moment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Pair {
    /// Number of the pair since start, from 1.
    pub number: u64,
    /// The left frame.
    pub left: FrameSeen,
    /// The right frame.
    pub right: FrameSeen,
}

impl Pair {
    /// Time stamp of the older frame: deadlines count from it.
    pub fn earliest(&self) -> Timestamp {
        self.left.timestamp.min(self.right.timestamp)
    }
}

/// What became of a frame that arrived.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Paired {
    /// A pair, if the frame found its partner.
    pub pair: Option<Pair>,
    /// A frame that will never have one, because a newer one of its side came.
    pub superseded: Option<Handle>,
    /// A waiting frame of the other side that is already too old for this one, and by how many ns.
    pub out_of_step: Option<(Handle, i64)>,
}

/// The waiting frames.
#[derive(Clone, Debug)]
pub struct Pairing {
    window_ns: i64,
    waiting: [Option<FrameSeen>; 2],
    pairs: u64,
}

impl Pairing {
    /// Frames up to `window_ns` apart are a pair.
    pub fn new(window_ns: i64) -> Self {
        Self { window_ns, waiting: [None; 2], pairs: 0 }
    }

    /// Takes a frame.
    pub fn run(&mut self, frame: FrameSeen) -> Paired {
        let mut paired = Paired { pair: None, superseded: None, out_of_step: None };
        let (own, other) = (frame.side.index(), 1 - frame.side.index());
        paired.superseded = self.waiting[own].take().map(|old| old.handle);
        if let Some(partner) = self.waiting[other] {
            let later_ns = frame.timestamp.since(partner.timestamp);
            if later_ns.abs() <= self.window_ns {
                self.waiting[other] = None;
                self.pairs += 1;
                let (left, right) = if own == 0 { (frame, partner) } else { (partner, frame) };
                paired.pair = Some(Pair { number: self.pairs, left, right });
                return paired;
            }
            if later_ns > 0 {
                self.waiting[other] = None;
                paired.out_of_step = Some((partner.handle, later_ns));
            }
        }
        self.waiting[own] = Some(frame);
        paired
    }

    /// Lets go of the waiting frame of a side.
    pub fn forget(&mut self, side: Side) -> Option<Handle> {
        self.waiting[side.index()].take().map(|old| old.handle)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(side: Side, at: i64, handle: u8) -> FrameSeen {
        FrameSeen {
            handle: Handle(handle),
            side,
            timestamp: Timestamp(at),
            mark: TimestampMark::StartOfExposure,
            sequence: 0,
            condition: Condition::Good,
            skipped: 0,
        }
    }

    #[test]
    fn frames_within_the_window_are_a_pair_whoever_comes_first() {
        for (first, second) in [(Side::Left, Side::Right), (Side::Right, Side::Left)] {
            let mut pairing = Pairing::new(10);
            assert_eq!(pairing.run(frame(first, 100, 0)).pair, None);
            let pair = pairing.run(frame(second, 110, 1)).pair.unwrap();
            assert_eq!((pair.left.side, pair.right.side, pair.number), (Side::Left, Side::Right, 1));
            assert_eq!(pair.earliest(), Timestamp(100));
        }
    }

    #[test]
    fn the_newest_of_a_side_counts() {
        let mut pairing = Pairing::new(10);
        pairing.run(frame(Side::Left, 0, 0));
        assert_eq!(pairing.run(frame(Side::Left, 33, 1)).superseded, Some(Handle(0)));
        assert_eq!(pairing.run(frame(Side::Right, 34, 2)).pair.unwrap().left.handle, Handle(1));
    }

    #[test]
    fn a_frame_too_old_for_the_other_side_goes_and_one_too_new_waits() {
        let mut pairing = Pairing::new(10);
        pairing.run(frame(Side::Left, 0, 0));
        let late = pairing.run(frame(Side::Right, 20, 1));
        assert_eq!((late.pair, late.out_of_step), (None, Some((Handle(0), 20))));
        // A left frame older than the waiting right one: both wait, the next left may still fit.
        assert_eq!(pairing.run(frame(Side::Left, 5, 2)).out_of_step, None);
        let next = pairing.run(frame(Side::Left, 25, 3));
        assert_eq!((next.superseded, next.pair.unwrap().right.handle), (Some(Handle(2)), Handle(1)));
    }
}
