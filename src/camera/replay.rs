//! One side of a recorded session, played as if a camera stood there.
//!
//! Takes the pictures of a [`Session`] and a [`Pace`]; gives frames at their time. A replayed frame's time stamp is
//! the moment at which its pair is handed over. That moment is agreed once for both sides, so pictures of two
//! different pairs are never taken for one, however the two threads are scheduled.

use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::Duration;

use super::{Condition, Grab, Side};
use crate::frame::{Frame, TimestampMark};
use crate::handover::Waker;
use crate::session::{PictureError, RecordedPair, RecordedPicture, Session, SessionError};
use crate::time::Timestamp;

/// Decoded pictures are kept in memory up to this size, both sides together; the rest is read when it is due.
const KEPT_BYTES_MAX: usize = 512 << 20;

/// Longest wait for the first pair.
const FIRST_WAIT_MAX: Duration = Duration::from_secs(1);

/// Longest pause between two pairs of a stepped session, ns.
const BREATH_NS_MAX: i64 = 5_000_000;

/// How fast a session is played.
#[derive(Clone, Debug)]
pub enum Pace {
    /// A pair every so often.
    Every(Duration),
    /// At the times at which the session was recorded.
    AsRecorded,
    /// The next pair when the cell has finished the last one: whoever finishes a pair wakes both. Only pairs of which
    /// both pictures are there and whole, and that the recorded cell had time for, are played.
    Stepped([Arc<Waker>; 2]),
}

#[derive(Debug)]
enum Picture {
    Kept(Frame),
    Stored(RecordedPicture),
    /// It came from its camera so.
    Damaged,
    Absent,
    /// Not played: of a stepped session a pair that the cell would not finish.
    LeftOut,
}

/// When each pair was handed over, 0 = not yet.
#[derive(Debug)]
struct Moments {
    start: Timestamp,
    at: Vec<AtomicI64>,
    /// From the first pair of a round to each, and to the first of the next round, ns. Empty where nothing is planned.
    plan_ns: Vec<i64>,
}

impl Moments {
    /// The moment of pair `index`: now, if the other side has not been there.
    fn agree(&self, index: usize) -> Timestamp {
        let now = Timestamp::now();
        match self.at[index].compare_exchange(0, now.0, Ordering::Relaxed, Ordering::Relaxed) {
            Ok(_) => now,
            Err(earlier) => Timestamp(earlier),
        }
    }

    /// Not before its time, and not so soon after its predecessor that a late session bunches up.
    fn due(&self, index: usize) -> Timestamp {
        let planned = self.planned(index);
        let previous = match index.checked_sub(1).map(|i| self.at[i].load(Ordering::Relaxed)) {
            None | Some(0) => return planned,
            Some(previous) => Timestamp(previous),
        };
        let apart_ns = planned.since(self.planned(index - 1)).max(0);
        planned.max(Timestamp(previous.0.saturating_add(apart_ns / 10 * 9)))
    }

    fn planned(&self, index: usize) -> Timestamp {
        let Some((round_ns, offsets_ns)) = self.plan_ns.split_last() else { return self.start };
        let rounds = i64::try_from(index / offsets_ns.len().max(1)).unwrap_or(i64::MAX);
        let offset_ns = offsets_ns.get(index % offsets_ns.len().max(1)).copied().unwrap_or(0);
        Timestamp(self.start.0.saturating_add(round_ns.saturating_mul(rounds)).saturating_add(offset_ns))
    }
}

fn read(picture: &RecordedPicture, raw: bool) -> Result<Frame, PictureError> {
    if raw { picture.read_raw() } else { picture.read() }
}

/// One side of a session.
#[derive(Debug)]
pub struct ReplayCamera {
    side: Side,
    pictures: Vec<Picture>,
    /// What moments of their exposures the times are.
    marks: Vec<TimestampMark>,
    moments: Arc<Moments>,
    pace: Pace,
    /// Pictures are decoded before they are played.
    raw: bool,
    /// Next pair; the session starts anew at its end until `at` of all pairs are used up.
    next: usize,
    /// The last pair that was played.
    previous: Option<usize>,
}

impl ReplayCamera {
    /// Both sides of `session`, which is repeated until `pairs` pairs were played. The first pair is due a period
    /// from now, after a second at the latest. `raw`: JPEG pictures are decoded beforehand, as a camera without
    /// compression delivers them. A picture of a recording that came damaged from its camera is played as damaged.
    ///
    /// # Errors
    /// A picture file that cannot be read; a recording that cannot, or has no whole picture of a side.
    pub fn both(session: &Session, pace: &Pace, pairs: usize, raw: bool) -> Result<[Self; 2], SessionError> {
        let first_after = match pace {
            Pace::Every(period) => *period,
            Pace::AsRecorded => session.period(),
            Pace::Stepped(_) => Duration::ZERO,
        };
        let moments = Arc::new(Moments {
            start: Timestamp::now().after(first_after.min(FIRST_WAIT_MAX)),
            at: (0..pairs).map(|_| AtomicI64::new(0)).collect(),
            plan_ns: plan(session, pace),
        });
        let mut kept = 0;
        let mut side = |side: Side| -> Result<Self, SessionError> {
            let mut pictures = Vec::with_capacity(session.pairs.len());
            let (mut is_any_whole, mut first_error) = (false, None);
            let played = |pair: &&RecordedPair| !matches!(pace, Pace::Stepped(_)) || pair.is_stepped();
            let marks = session.pairs.iter().filter(played).map(|pair| pair.marks[side.index()]).collect();
            for pair in session.pairs.iter().filter(played) {
                let Some(picture) = &pair.pictures[side.index()] else {
                    pictures.push(Picture::Absent);
                    continue;
                };
                let frame = match read(picture, raw) {
                    Ok(frame) => frame,
                    Err(error) if is_only_of(picture, &error) => {
                        first_error.get_or_insert(error);
                        pictures.push(Picture::Damaged);
                        continue;
                    }
                    Err(error) => return Err(error.into()),
                };
                is_any_whole = true;
                kept += frame.bytes.len();
                pictures.push(match kept <= KEPT_BYTES_MAX {
                    true => Picture::Kept(frame),
                    false => Picture::Stored(picture.clone()),
                });
            }
            if let (Some(error), false) = (first_error, is_any_whole) {
                return Err(error.into());
            }
            Ok(Self {
                side,
                pictures,
                marks,
                moments: Arc::clone(&moments),
                pace: pace.clone(),
                raw,
                next: 0,
                previous: None,
            })
        };
        let mut sides = [side(Side::Left)?, side(Side::Right)?];
        if let Pace::Stepped(_) = pace {
            leave_out_damaged(&mut sides);
        }
        Ok(sides)
    }

    /// The largest picture of this side that is kept in memory, bytes.
    pub fn largest_bytes(&self) -> usize {
        let bytes = |picture: &Picture| match picture {
            Picture::Kept(frame) => frame.bytes.len(),
            _ => 0,
        };
        self.pictures.iter().map(bytes).max().unwrap_or(0)
    }

    /// Waits until the next picture is due, at most `timeout`.
    pub fn grab(&mut self, frame: &mut Frame, timeout: Duration) -> Grab {
        let give_up = Timestamp::now().after(timeout);
        while self.next < self.moments.at.len() && !self.pictures.is_empty() {
            if let Picture::LeftOut = self.pictures[self.next % self.pictures.len()] {
                self.next += 1;
                continue;
            }
            if !self.wait_due(give_up) {
                return Grab::TimedOut;
            }
            let index = self.next;
            self.next += 1;
            self.previous = Some(index);
            let condition = match &self.pictures[index % self.pictures.len()] {
                Picture::Absent | Picture::LeftOut => continue,
                Picture::Damaged => Condition::Damaged,
                Picture::Kept(kept) => {
                    copy(kept, frame);
                    Condition::Good
                }
                Picture::Stored(picture) => match read(picture, self.raw) {
                    Ok(read) => {
                        copy(&read, frame);
                        Condition::Good
                    }
                    Err(_) => Condition::Damaged,
                },
            };
            frame.timestamp = self.moments.agree(index);
            frame.mark = self.marks[index % self.pictures.len()];
            frame.sequence = index as u32;
            return Grab::Frame { condition, skipped: 0 };
        }
        Grab::Ended
    }

    /// Sleeps for a ninth of the time that the last pair took. A cell that is never out of work would keep its core
    /// to itself; the kernel then takes it away from real-time threads for 50 ms in every second.
    fn take_breath(&self, previous: usize) {
        let last = self.moments.at[previous].load(Ordering::Relaxed);
        let took = Timestamp::now().since(Timestamp(last)).clamp(0, BREATH_NS_MAX * 9);
        std::thread::sleep(Duration::from_nanos(took as u64 / 9));
    }

    /// Whether the next picture is due before `give_up`; sleeps until then.
    fn wait_due(&self, give_up: Timestamp) -> bool {
        match &self.pace {
            Pace::Every(_) | Pace::AsRecorded => {
                let due = self.moments.due(self.next);
                sleep_until(due.min(give_up));
                due <= give_up
            }
            Pace::Stepped(wakers) => {
                let left_ns = give_up.ns_since(Timestamp::now());
                let Some(previous) = self.previous else { return true };
                let woken = wakers[self.side.index()].wait(Some(Duration::from_nanos(left_ns)));
                if woken && left_ns > 0 {
                    self.take_breath(previous);
                }
                woken
            }
        }
    }
}

/// Of a pair with a damaged picture neither is played.
fn leave_out_damaged([left, right]: &mut [ReplayCamera; 2]) {
    for pair in left.pictures.iter_mut().zip(&mut right.pictures) {
        if matches!(pair, (Picture::Damaged, _) | (_, Picture::Damaged)) {
            (*pair.0, *pair.1) = (Picture::LeftOut, Picture::LeftOut);
        }
    }
}

/// Whether an error is of one picture of a recording, as its camera sent it, and not of the whole recording.
pub(crate) fn is_only_of(picture: &RecordedPicture, error: &PictureError) -> bool {
    matches!(picture, RecordedPicture::Message { .. }) && !matches!(error, PictureError::Recording(_))
}

/// See [`Moments::plan_ns`].
fn plan(session: &Session, pace: &Pace) -> Vec<i64> {
    let ns = |duration: Duration| i64::try_from(duration.as_nanos()).unwrap_or(i64::MAX);
    match pace {
        Pace::Every(period) => vec![0, ns(*period)],
        Pace::AsRecorded => {
            let last_ns = session.pairs.last().map_or(0, |pair| pair.after_ns);
            let round_ns = last_ns.saturating_add(ns(session.period()));
            session.pairs.iter().map(|pair| pair.after_ns).chain([round_ns]).collect()
        }
        Pace::Stepped(_) => Vec::new(),
    }
}

/// Copies pixels and what they are into a recycled frame.
fn copy(from: &Frame, to: &mut Frame) {
    to.bytes.clear();
    to.bytes.extend_from_slice(&from.bytes);
    to.format = from.format;
    (to.width, to.height, to.stride_bytes) = (from.width, from.height, from.stride_bytes);
    to.encoding = from.encoding;
}

fn sleep_until(due: Timestamp) {
    let left = due.since(Timestamp::now());
    if left > 0 {
        std::thread::sleep(Duration::from_nanos(left as u64));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::PixelFormat;
    use crate::session::{About, RecordingWriter};

    /// Three pairs; the right picture of the second one is missing.
    fn session(folder: &std::path::Path) -> Session {
        let pair = |i: u8, right: bool| {
            let pictures = [Some(Side::Left), right.then_some(Side::Right)].map(|side| {
                side.map(|side| {
                    let path = folder.join(format!("{i}{}.png", side.name()));
                    image::GrayImage::from_pixel(2, 2, image::Luma([10 * i + side as u8]))
                        .save(&path)
                        .unwrap();
                    path
                })
            });
            let pictures = pictures.map(|path| path.map(RecordedPicture::File));
            let (marks, fate) = Default::default();
            RecordedPair { name: i.to_string(), after_ns: i64::from(i) * 1_000_000, pictures, marks, fate }
        };
        let pairs = vec![pair(0, true), pair(1, false), pair(2, true)];
        Session {
            path: folder.to_owned(),
            rate_hz: 1000.0,
            pairs,
            arm: Vec::new(),
            arm_lead_ns: None,
            results: Default::default(),
            broken_at: None,
        }
    }

    #[test]
    fn a_session_is_played_in_order_repeated_and_ends() {
        let folder = tempfile::tempdir().unwrap();
        let session = session(folder.path());
        let pace = Pace::Every(session.period());
        let [mut left, mut right] = ReplayCamera::both(&session, &pace, 4, false).unwrap();
        let all = |camera: &mut ReplayCamera| {
            let (mut frame, mut seen) = (Frame::default(), Vec::new());
            while let Grab::Frame { condition, .. } = camera.grab(&mut frame, Duration::from_secs(10)) {
                assert_eq!(condition, Condition::Good);
                seen.push((frame.bytes[0], frame.sequence, frame.timestamp));
            }
            assert_eq!(camera.grab(&mut frame, Duration::ZERO), Grab::Ended);
            seen
        };
        let (left, right) = (all(&mut left), all(&mut right));
        assert_eq!(left.iter().map(|f| (f.0, f.1)).collect::<Vec<_>>(), [(0, 0), (10, 1), (20, 2), (0, 3)]);
        assert_eq!(right.iter().map(|f| (f.0, f.1)).collect::<Vec<_>>(), [(1, 0), (21, 2), (1, 3)]);
        // One moment for both sides of a pair, rising, although one side was played long after the other.
        assert_eq!((left[0].2, left[2].2, left[3].2), (right[0].2, right[1].2, right[2].2));
        assert!(left.windows(2).all(|w| w[0].2 < w[1].2));
    }

    #[test]
    fn a_session_is_planned_as_it_was_recorded_and_anew_in_every_round() {
        let folder = tempfile::tempdir().unwrap();
        let mut session = session(folder.path());
        session.pairs[1].after_ns = 5_000_000;
        session.pairs[2].after_ns = 6_000_000;
        let moments =
            Moments { start: Timestamp(0), at: Vec::new(), plan_ns: plan(&session, &Pace::AsRecorded) };
        let planned: Vec<_> = (0..5).map(|i| moments.planned(i).0 / 1_000_000).collect();
        assert_eq!(planned, [0, 5, 6, 7, 12]);
        let every = Pace::Every(Duration::from_millis(2));
        let moments = Moments { start: Timestamp(0), at: Vec::new(), plan_ns: plan(&session, &every) };
        assert_eq!(moments.planned(4), Timestamp(8_000_000));
    }

    /// Four pairs 10 ms apart; the right picture of those in `damaged` is no picture.
    fn recording(folder: &std::path::Path, damaged: &[i64]) -> Session {
        let path = folder.join("a.mcap");
        let mut writer = RecordingWriter::create(&path, &About::default()).unwrap();
        for i in 0..4 {
            let grey = Frame::from_grey(2, 2, vec![i as u8; 4]);
            let broken = Frame { format: PixelFormat::Mjpeg, bytes: vec![1; 9], ..Frame::default() };
            let right = if damaged.contains(&i) { broken } else { grey.clone() };
            for (side, mut frame) in Side::BOTH.into_iter().zip([grey, right]) {
                frame.timestamp = Timestamp(1 + i * 10_000_000);
                writer.frame(side, &mut frame).unwrap();
            }
        }
        writer.finish().unwrap();
        Session::open(&path).unwrap()
    }

    #[test]
    fn a_damaged_picture_of_a_recording_is_played_as_damaged() {
        let folder = tempfile::tempdir().unwrap();
        let session = recording(folder.path(), &[0, 2]);
        let [_, mut right] = ReplayCamera::both(&session, &Pace::AsRecorded, 4, true).unwrap();
        let mut frame = Frame::default();
        for expected in [Condition::Damaged, Condition::Good, Condition::Damaged, Condition::Good] {
            let grab = right.grab(&mut frame, Duration::from_secs(10));
            assert_eq!(grab, Grab::Frame { condition: expected, skipped: 0 });
        }
        // Of a stepped session the whole pair is left out: the cell would not finish it.
        let wakers = [(); 2].map(|()| Arc::new(Waker::new().unwrap()));
        for mut camera in ReplayCamera::both(&session, &Pace::Stepped(wakers.clone()), 4, true).unwrap() {
            for expected in [1, 3] {
                let grab = camera.grab(&mut frame, Duration::ZERO);
                assert_eq!(
                    (grab, frame.bytes[0]),
                    (Grab::Frame { condition: Condition::Good, skipped: 0 }, expected)
                );
                wakers[camera.side.index()].wake();
            }
            assert_eq!(camera.grab(&mut frame, Duration::ZERO), Grab::Ended);
        }
    }

    #[test]
    fn a_side_without_a_whole_picture_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let session = recording(folder.path(), &[0, 1, 2, 3]);
        let error = ReplayCamera::both(&session, &Pace::AsRecorded, 4, false).unwrap_err().to_string();
        assert!(
            error.contains("/right/image at byte ") && error.contains("neither a png nor a jpg picture"),
            "{error}"
        );
    }

    #[test]
    fn nobody_waits_long_for_the_first_pair() {
        let folder = tempfile::tempdir().unwrap();
        let mut session = session(folder.path());
        session.rate_hz = 0.1;
        let [left, _] = ReplayCamera::both(&session, &Pace::AsRecorded, 3, false).unwrap();
        assert!(left.moments.start.since(Timestamp::now()) <= 1_000_000_000);
        session.rate_hz = 1e-300;
        assert_eq!(session.period(), Duration::from_secs(86_400));
    }

    #[test]
    fn a_stepped_session_waits_for_the_cell() {
        let folder = tempfile::tempdir().unwrap();
        let session = session(folder.path());
        let wakers = [(); 2].map(|()| Arc::new(Waker::new().unwrap()));
        let [mut left, _] = ReplayCamera::both(&session, &Pace::Stepped(wakers.clone()), 3, true).unwrap();
        let mut frame = Frame::default();
        let step = |camera: &mut ReplayCamera, frame: &mut Frame| camera.grab(frame, Duration::ZERO);
        for expected in [0, 20, 0] {
            assert!(matches!(step(&mut left, &mut frame), Grab::Frame { .. }));
            assert_eq!(frame.bytes[0], expected, "the pair without a right picture is left out");
            assert_eq!(
                step(&mut left, &mut frame),
                if frame.sequence < 2 { Grab::TimedOut } else { Grab::Ended }
            );
            wakers[0].wake();
        }
    }
}
