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
