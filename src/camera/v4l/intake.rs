//! Which of the buffers that wait in the driver becomes the next frame. Pure: no device, no clock.
//!
//! The newest good one counts; older good ones are skipped and counted. A damaged or short one is told on its own,
//! in its place in the sequence, so that it can be counted by its cause.

use super::format::Rows;
use crate::camera::Condition;

/// How far from the end of a JPEG picture its end marker may lie, in bytes: cameras pad.
const PADDING_BYTES_MAX: usize = 4096;

/// What is to be done with a buffer that was offered.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Step<T> {
    /// Goes back to the driver unread.
    pub(super) skipped: Option<T>,
    /// No more buffers now.
    pub(super) full: bool,
}

/// What the next frame is made of.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Taken<T> {
    /// The buffer.
    pub(super) buffer: T,
    /// What is wrong with it.
    pub(super) condition: Condition,
    /// Older good buffers that were skipped for it.
    pub(super) skipped: u32,
}

/// Takes buffers in the driver's order; see the module.
#[derive(Debug)]
pub(super) struct Intake<T> {
    newest: Option<T>,
    bad: Option<(T, Condition)>,
    skipped: u32,
}

impl<T> Default for Intake<T> {
    fn default() -> Self {
        Intake { newest: None, bad: None, skipped: 0 }
    }
}

impl<T> Intake<T> {
    /// Offers the next buffer. Nothing is offered after a step that is full, before [`Intake::take`].
    pub(super) fn offer(&mut self, buffer: T, condition: Condition) -> Step<T> {
        if condition != Condition::Good {
            self.bad = Some((buffer, condition));
            return Step { skipped: None, full: true };
        }
        let skipped = self.newest.replace(buffer);
        self.skipped += u32::from(skipped.is_some());
        Step { skipped, full: false }
    }

    /// What was taken is not used: it counts as skipped for the next one.
    pub(super) fn skip(&mut self, taken: &Taken<T>) {
        self.skipped += taken.skipped + 1;
    }

    /// Whether a buffer is held that must be taken before more are offered.
    pub(super) fn is_full(&self) -> bool {
        self.bad.is_some()
    }

    /// The next frame's buffer: the newest good one, and on the next call the bad one that came after it.
    pub(super) fn take(&mut self) -> Option<Taken<T>> {
        if let Some(buffer) = self.newest.take() {
            let skipped = std::mem::take(&mut self.skipped);
            return Some(Taken { buffer, condition: Condition::Good, skipped });
        }
        let (buffer, condition) = self.bad.take()?;
        Some(Taken { buffer, condition, skipped: 0 })
    }
}

/// Whether the newest buffer that waits is also a young one. A driver that has filled all its buffers waits for the
/// first to be given back: what it filled last may be of any age. Where stamps tell the age nobody needs this.
#[derive(Debug)]
pub(super) struct Backlog {
    buffers: usize,
    /// Since the driver last had none to give.
    taken: usize,
    /// As many as there are had been taken when it last had none to give.
    was_full: bool,
}

impl Backlog {
    /// Of a driver with so many buffers.
    pub(super) fn new(buffers: usize) -> Self {
        Backlog { buffers, taken: 0, was_full: false }
    }

    /// A filled buffer was taken from the driver.
    pub(super) fn one_taken(&mut self) {
        self.taken += 1;
    }

    /// The driver has no filled buffer any more.
    pub(super) fn none_waits(&mut self) {
        self.was_full = self.taken >= self.buffers;
        self.taken = 0;
    }

    /// Whether all buffers were filled when the last one was taken.
    pub(super) fn is_of_unknown_age(&self) -> bool {
        self.was_full || self.taken >= self.buffers
    }
}

/// What is wrong with the bytes of a picture. `rows` is `None` for JPEG, which is whole where it begins with its
/// start marker and ends, padding aside, with its end marker.
pub(super) fn condition(marked_damaged: bool, bytes: &[u8], rows: Option<Rows>) -> Condition {
    let whole = match rows {
        Some(rows) => bytes.len() >= rows.bytes_needed(),
        None => {
            let tail = &bytes[bytes.len().saturating_sub(PADDING_BYTES_MAX)..];
            bytes.starts_with(&[0xff, 0xd8]) && tail.windows(2).any(|two| two == [0xff, 0xd9])
        }
    };
    match (whole, marked_damaged) {
        (false, _) => Condition::Short,
        (true, true) => Condition::Damaged,
        (true, false) => Condition::Good,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::v4l::format::rows;
    use crate::frame::PixelFormat;

    fn taken(buffer: u32, condition: Condition, skipped: u32) -> Option<Taken<u32>> {
        Some(Taken { buffer, condition, skipped })
    }

    #[test]
    fn the_newest_counts_and_the_others_go_back() {
        let mut intake = Intake::default();
        assert_eq!(intake.offer(1, Condition::Good), Step { skipped: None, full: false });
        assert_eq!(intake.offer(2, Condition::Good), Step { skipped: Some(1), full: false });
        assert_eq!(intake.offer(3, Condition::Good), Step { skipped: Some(2), full: false });
        assert_eq!(intake.take(), taken(3, Condition::Good, 2));
        assert_eq!(intake.take(), None);
        assert_eq!(intake.offer(4, Condition::Good), Step { skipped: None, full: false });
        assert_eq!(intake.take(), taken(4, Condition::Good, 0));
    }

    #[test]
    fn what_was_not_used_counts_as_skipped() {
        let mut intake = Intake::default();
        intake.offer(1, Condition::Good);
        intake.offer(2, Condition::Good);
        let old = intake.take().unwrap();
        intake.skip(&old);
        intake.offer(3, Condition::Good);
        assert_eq!(intake.take(), taken(3, Condition::Good, 2));
    }

    #[test]
    fn the_newest_of_a_full_backlog_may_be_of_any_age() {
        let mut backlog = Backlog::new(3);
        let mut drained = |taken: usize, to_the_end: bool| {
            (0..taken).for_each(|_| backlog.one_taken());
            if to_the_end {
                backlog.none_waits();
            }
            backlog.is_of_unknown_age()
        };
        assert!(!drained(2, true));
        assert!(drained(3, true));
        assert!(!drained(1, true));
        // A damaged one ends a look early; what waits behind it is as old.
        assert!(!drained(1, false));
        assert!(drained(2, true));
        assert!(!drained(0, true));
        assert!(drained(3, false));
    }

    #[test]
    fn bad_ones_are_told_one_by_one_in_their_place() {
        let mut intake = Intake::default();
        intake.offer(1, Condition::Good);
        assert_eq!(intake.offer(2, Condition::Damaged), Step { skipped: None, full: true });
        assert_eq!(intake.take(), taken(1, Condition::Good, 0));
        assert!(intake.is_full());
        assert_eq!(intake.take(), taken(2, Condition::Damaged, 0));
        assert!(!intake.is_full());
        assert_eq!(intake.offer(3, Condition::Short), Step { skipped: None, full: true });
        assert_eq!(intake.take(), taken(3, Condition::Short, 0));
    }

    #[test]
    fn cut_and_marked_pictures_are_told_apart() {
        let grey = rows(PixelFormat::Grey, 4, 2, 4);
        assert_eq!(condition(false, &[0; 8], grey), Condition::Good);
        assert_eq!(condition(true, &[0; 8], grey), Condition::Damaged);
        assert_eq!(condition(true, &[0; 7], grey), Condition::Short);
        assert_eq!(condition(false, &[], grey), Condition::Short);
        let jpeg = [0xff, 0xd8, 1, 2, 3, 0xff, 0xd9, 0, 0];
        assert_eq!(condition(false, &jpeg, None), Condition::Good);
        assert_eq!(condition(true, &jpeg, None), Condition::Damaged);
        assert_eq!(condition(false, &jpeg[..5], None), Condition::Short);
        assert_eq!(condition(false, &jpeg[1..], None), Condition::Short);
        assert_eq!(condition(false, &[], None), Condition::Short);
    }
}
