//! What the threads of a cell share: the frames, the files of pairs, the letters between them, the measurements.
//!
//! What goes from thread to thread goes through bounded channels, what lies in stock (frames, files) through bounded
//! queues. Every file and frame has one owner and is moved. All of it is made before the threads start. Nobody waits
//! inside a channel for something to come: a receiver sleeps on its waker, so that to send takes no lock.

use std::io;

use crossbeam_channel::{Receiver, Sender, bounded};
use crossbeam_queue::ArrayQueue;

use super::core::{Found, Job, Note, PairReport, PlaceRecord};
use crate::camera::{Condition, FramePool, Side, Trouble};
use crate::frame::{Frame, FramePair};
use crate::handover::Waker;
use crate::recognize::{Recognition, Refusal};
use crate::telemetry::Telemetry;
use crate::time::Timestamp;

/// Letters to the arm's thread without a frame in them that wait at most.
const LETTERS: usize = 32;
/// Papers to the cold thread that wait at most.
const PAPERS: usize = 1024;

/// All that is known of a pair: made once, used again and again.
#[derive(Debug, Default)]
pub struct File {
    /// The pictures.
    pub pair: FramePair,
    /// What was found in them.
    pub recognition: Recognition,
    /// Why nothing could be looked for.
    pub refusal: Option<Refusal>,
    /// When the recognition began.
    pub begun: Timestamp,
    /// When it was finished.
    pub finished: Timestamp,
}

/// To the arm's thread.
#[derive(Debug)]
#[expect(clippy::large_enum_variant, reason = "letters are moved through a queue that was made before")]
pub enum Letter {
    /// A camera has a frame.
    Frame(Side, Frame, Condition, u32),
    /// A camera gives nothing any more.
    Lost(Side, Trouble),
    /// It does again.
    Back(Side),
    /// Its session is over.
    Ended(Side),
    /// The recogniser is finished.
    Recognised(u64, Found, Box<File>),
    /// The cold thread has written and synced a record, or could not.
    Persisted(PlaceRecord, bool),
}

/// To the cold thread.
#[derive(Debug)]
pub enum Paper {
    /// Something to say.
    Note(Note, Timestamp),
    /// A pair is finished with; its file where there was one to spare.
    Pair(PairReport, Option<Box<File>>),
}

/// A pair on its way to the recogniser.
#[derive(Debug)]
pub struct Work {
    /// What is to be done.
    pub job: Job,
    /// The pictures.
    pub pair: FramePair,
}

/// A bounded channel with both of its ends; many may send, one thread takes.
#[derive(Debug)]
pub struct Tray<T> {
    sender: Sender<T>,
    receiver: Receiver<T>,
}

impl<T> Tray<T> {
    /// Room for `len`, all of it made now.
    fn new(len: usize) -> Self {
        let (sender, receiver) = bounded(len);
        Self { sender, receiver }
    }

    /// Puts `value` in, without waiting.
    ///
    /// # Errors
    /// Gives it back where there is no room.
    pub fn try_send(&self, value: T) -> Result<(), T> {
        self.sender.try_send(value).map_err(|refused| refused.into_inner())
    }

    /// Puts `value` in and waits for room if there is none.
    fn send(&self, value: T) {
        // It fails only without a receiver, which is here.
        let _ = self.sender.send(value);
    }

    /// Takes the oldest, without waiting.
    pub fn try_recv(&self) -> Option<T> {
        self.receiver.try_recv().ok()
    }
}

/// Everything that is shared.
#[derive(Debug)]
pub struct Desk {
    /// Free frames.
    pub pool: FramePool,
    /// Free files.
    pub files: ArrayQueue<Box<File>>,
    /// To the arm's thread.
    pub letters: Tray<Letter>,
    /// Wakes the arm's thread.
    pub letters_waker: Waker,
    /// To the cold thread.
    pub papers: Tray<Paper>,
    /// To the cold thread, before any paper: records to be written, synced and answered.
    pub records: Tray<PlaceRecord>,
    /// Wakes the cold thread.
    pub papers_waker: Waker,
    /// What is measured.
    pub telemetry: Telemetry,
}

impl Desk {
    /// `files` pairs may be looked at by the cold thread at a time; frames have room for `frame_bytes`.
    ///
    /// # Errors
    /// The system has no descriptor left.
    pub fn new(files: usize, frame_bytes: usize) -> io::Result<Self> {
        // One file is with the recogniser, one on its way to the core.
        let files = files + 2;
        let frames = 2 * files + super::core::HANDLES + 4;
        let free = ArrayQueue::new(files);
        for _ in 0..files {
            let pushed = free.push(Box::default());
            assert!(pushed.is_ok(), "room for {files} files");
        }
        Ok(Self {
            pool: FramePool::new(frames, frame_bytes),
            files: free,
            letters: Tray::new(frames + LETTERS),
            letters_waker: Waker::new()?,
            papers: Tray::new(PAPERS),
            records: Tray::new(4),
            papers_waker: Waker::new()?,
            telemetry: Telemetry::new(),
        })
    }

    /// Sends a letter to the arm's thread. There is room for every frame of the pool and more; should that thread
    /// be stopped for so long that there is none, the sender sleeps rather than lose a word.
    pub fn send(&self, letter: Letter) {
        if let Err(letter) = self.letters.try_send(letter) {
            self.letters_waker.wake();
            self.letters.send(letter);
        }
        self.letters_waker.wake();
    }

    /// Gives the pictures of a file back, and the file.
    pub fn give_back(&self, mut file: Box<File>) {
        self.pool.give(std::mem::take(&mut file.pair.left));
        self.pool.give(std::mem::take(&mut file.pair.right));
        let pushed = self.files.push(file);
        assert!(pushed.is_ok(), "a file that is not from this desk");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_tray_gives_back_what_it_cannot_take() {
        let tray = Tray::new(2);
        assert_eq!((tray.try_send(1), tray.try_send(2), tray.try_send(3)), (Ok(()), Ok(()), Err(3)));
        assert_eq!(tray.try_recv(), Some(1));
        assert_eq!(tray.try_send(4), Ok(()));
        assert_eq!((tray.try_recv(), tray.try_recv(), tray.try_recv()), (Some(2), Some(4), None));
    }

    #[test]
    fn no_letter_is_lost_while_the_arms_thread_is_away() {
        let desk = Desk::new(0, 0).unwrap();
        let room = std::iter::from_fn(|| desk.letters.try_send(Letter::Ended(Side::Left)).ok()).count();
        std::thread::scope(|scope| {
            let sender = scope.spawn(|| desk.send(Letter::Ended(Side::Right)));
            desk.letters_waker.wait(None);
            let taken = std::iter::from_fn(|| desk.letters.try_recv()).count();
            sender.join().unwrap();
            let rest = std::iter::from_fn(|| desk.letters.try_recv()).count();
            assert_eq!(taken + rest, room + 1);
        });
    }
}
