//! What goes from thread to thread of a cell: frames, files of pairs, letters, papers; and what all of them share.
//!
//! The arm's thread is the hub: every way leads from it or to it, and has one sender and one receiver, a wait-free
//! ring made before the threads start. So a thread that is interrupted in the middle of sending holds nobody up,
//! whatever the priorities: in a queue with several senders a receiver of higher priority would wait, spinning, for
//! one that it has itself put off its core. Every file and frame has one owner and is moved. Nobody waits inside a
//! ring: a receiver sleeps on its waker.
//!
//! ```text
//!  left ──┐ letters                free frames ┌──▶ left
//!  right ─┤                                    ├──▶ right
//!  recognise ─┼──────────▶  arm  ──────────────┼──▶ recognise   (a pair and a file to write into)
//!  cold ──┘                                    └──▶ cold        (papers, place records)
//! ```

use std::io;
use std::sync::Arc;
use std::time::Duration;

use rtrb::{Consumer, Producer, PushError, RingBuffer};

use firmware_bridge::message::{Command, Refusal as ArmRefusal};

use super::core::{Event, Found, Job, Note, PairReport, PlaceRecord};
use crate::camera::{Condition, Side, Trouble};
use crate::frame::{Frame, FramePair};
use crate::handover::Waker;
use crate::recognize::{Recognition, Refusal};
use crate::telemetry::Telemetry;
use crate::time::Timestamp;

/// Letters of one sender, beside those with a frame or a file in them, that wait at most.
const LETTERS: usize = 32;
/// Papers to the cold thread that wait at most.
const PAPERS: usize = 1024;
/// Place records that wait at most.
const RECORDS: usize = 4;
/// Frames of a side that led to no search and may wait for being recorded: half a second of one whose partner is away.
const LONE_FRAMES: usize = 16;
/// A sender whose ring is full tries again after so long.
const FULL_PAUSE: Duration = Duration::from_millis(1);

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

impl File {
    /// With memory for as much as can be known.
    fn with_room() -> Self {
        Self { recognition: Recognition::with_room(), ..Self::default() }
    }
}

/// To the arm's thread.
#[derive(Debug)]
#[expect(clippy::large_enum_variant, reason = "letters are moved through rings that were made before")]
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
    /// The cold thread needs a file no longer.
    Filed(Box<File>),
    /// The cold thread needs a lone frame no longer.
    Spare(Side, Frame),
}

/// To the cold thread.
#[derive(Debug)]
pub enum Paper {
    /// Something to say.
    Note(Note, Timestamp),
    /// A pair is finished with; its file where there was one to spare.
    Pair(PairReport, Option<Box<File>>),
    /// A frame that led to no search, to be recorded.
    Lone(Side, Frame),
}

/// Something that is written down, and when it was.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Logged {
    /// The cell's time.
    pub at: Timestamp,
    /// What.
    pub said: Said,
}

/// What goes into a recording beside the pairs.
#[derive(Clone, Copy, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "moved through a ring that was made before")]
pub enum Said {
    /// To the core.
    Event(Event),
    /// To the arm; why its side did not take it, if it did not.
    Command(Command, Option<ArmRefusal>),
}

/// A pair on its way to the recogniser.
#[derive(Debug)]
pub struct Work {
    /// What is to be done.
    pub job: Job,
    /// The pictures, and room for what is found in them.
    pub file: Box<File>,
}

/// What all threads share.
#[derive(Debug)]
pub struct Desk {
    /// Wakes the arm's thread.
    pub letters_waker: Arc<Waker>,
    /// Wakes the cold thread.
    pub papers_waker: Arc<Waker>,
    /// What is measured.
    pub telemetry: Telemetry,
}

/// A thread's way to the arm's thread.
#[derive(Debug)]
pub struct Outbox {
    letters: Producer<Letter>,
    waker: Arc<Waker>,
}

impl Outbox {
    /// Sends a letter. There is room for every frame and file that this sender can have, and more; should the arm's
    /// thread be stopped for so long that there is none, the sender sleeps rather than lose a word.
    pub fn send(&mut self, letter: Letter) {
        let mut letter = letter;
        while let Err(PushError::Full(back)) = self.letters.push(letter) {
            if self.letters.is_abandoned() {
                return;
            }
            self.waker.wake();
            std::thread::sleep(FULL_PAUSE);
            letter = back;
        }
        self.waker.wake();
    }
}

/// What a grab thread has.
#[derive(Debug)]
pub struct GrabSeat {
    /// Free frames.
    pub free: Consumer<Frame>,
    /// To the arm's thread.
    pub outbox: Outbox,
}

/// What the cold thread has.
#[derive(Debug)]
pub struct ColdSeat {
    /// What to say and to draw.
    pub papers: Consumer<Paper>,
    /// Before any paper: records to be written, synced and answered.
    pub records: Consumer<PlaceRecord>,
    /// What is to be written down, where a recording is made.
    pub log: Consumer<Logged>,
    /// To the arm's thread.
    pub outbox: Outbox,
}

/// What the arm's thread has.
#[derive(Debug)]
pub struct Hub {
    letters: [Consumer<Letter>; 4],
    free: [Producer<Frame>; 2],
    #[expect(clippy::vec_box, reason = "files are large and handed on by their boxes")]
    stock: Vec<Box<File>>,
    papers: Producer<Paper>,
    records: Producer<PlaceRecord>,
    /// Frames of each side that may yet be lent for being recorded.
    lone: [usize; 2],
    /// Without room where nothing is recorded.
    log: Producer<Logged>,
    papers_waker: Arc<Waker>,
}

/// Everything that the threads of a cell have for themselves.
#[derive(Debug)]
pub struct Seats {
    /// Left and right.
    pub grabs: [GrabSeat; 2],
    /// The recogniser's way to the arm's thread.
    pub recognise: Outbox,
    /// The cold thread's.
    pub cold: ColdSeat,
    /// The arm's thread's.
    pub hub: Hub,
}

impl Desk {
    /// `files` pairs may be looked at by the cold thread at a time; frames have room for `frame_bytes`; so many
    /// `logged` wait at most to be written down, 0: nothing is. All memory is taken here.
    ///
    /// # Errors
    /// The system has no descriptor left.
    pub fn new(files: usize, frame_bytes: usize, logged: usize) -> io::Result<(Self, Seats)> {
        // One file is with the recogniser, one on its way to the core.
        let files = files + 2;
        let lone = if logged > 0 { LONE_FRAMES } else { 0 };
        // Of each side: one in every file, those that the core keeps, one that is filled and one on its way, and those
        // that wait for being recorded alone.
        let frames = files + super::core::HANDLES + 2 + lone;
        let letters_waker = Arc::new(Waker::new()?);
        let papers_waker = Arc::new(Waker::new()?);
        let way = |room: usize| {
            let (letters, inbox) = RingBuffer::new(room + LETTERS);
            (Outbox { letters, waker: Arc::clone(&letters_waker) }, inbox)
        };
        let grab = || {
            let (mut given, free) = RingBuffer::new(frames);
            for _ in 0..frames {
                given.push(touched(frame_bytes)).expect("a ring of so many frames");
            }
            let (outbox, inbox) = way(frames);
            (GrabSeat { free, outbox }, given, inbox)
        };
        let ((left, free_left, from_left), (right, free_right, from_right)) = (grab(), grab());
        let (recognise, from_recognise) = way(files);
        let (outbox, from_cold) = way(files + 2 * lone);
        let (to_papers, papers) = RingBuffer::new(PAPERS);
        let (to_records, records) = RingBuffer::new(RECORDS);
        let (to_log, log) = RingBuffer::new(logged);
        let hub = Hub {
            letters: [from_left, from_right, from_recognise, from_cold],
            free: [free_left, free_right],
            stock: (0..files).map(|_| Box::new(File::with_room())).collect(),
            papers: to_papers,
            records: to_records,
            lone: [lone; 2],
            log: to_log,
            papers_waker: Arc::clone(&papers_waker),
        };
        let cold = ColdSeat { papers, records, log, outbox };
        let desk = Self { letters_waker, papers_waker, telemetry: Telemetry::new() };
        Ok((desk, Seats { grabs: [left, right], recognise, cold, hub }))
    }
}

/// A frame with room for so many bytes, every page of it in memory.
fn touched(frame_bytes: usize) -> Frame {
    // Filled with something else than zeros, or the system would map one page for all of it.
    let mut bytes = vec![1; frame_bytes];
    bytes.clear();
    Frame { bytes, ..Frame::default() }
}

impl Hub {
    /// The next letter, if any waits; those of one sender in their order.
    pub fn letter(&mut self) -> Option<Letter> {
        self.letters.iter_mut().find_map(|inbox| inbox.pop().ok())
    }

    /// Gives a frame back to the side that filled it.
    ///
    /// # Panics
    /// Where more frames come back than there are.
    pub fn give(&mut self, side: Side, frame: Frame) {
        self.free[side.index()].push(frame).expect("no more frames than there are");
    }

    /// Takes a file from the stock.
    pub fn file(&mut self) -> Option<Box<File>> {
        self.stock.pop()
    }

    /// Whether a file can be lent to the cold thread and one is left for the recogniser.
    pub fn has_file(&self) -> bool {
        !self.stock.is_empty()
    }

    /// Gives the pictures of a file back, and the file.
    pub fn give_back(&mut self, mut file: Box<File>) {
        self.give(Side::Left, std::mem::take(&mut file.pair.left));
        self.give(Side::Right, std::mem::take(&mut file.pair.right));
        self.stock.push(file);
    }

    /// Whether a recording is made.
    pub fn records(&self) -> bool {
        self.log.buffer().capacity() > 0
    }

    /// Lends a frame that led to no search to the cold thread, which records it.
    ///
    /// # Errors
    /// Gives it back where too many of its side are under way.
    pub fn lend(&mut self, side: Side, frame: Frame) -> Result<(), Frame> {
        if self.lone[side.index()] == 0 {
            return Err(frame);
        }
        match self.tell(Paper::Lone(side, frame)) {
            Err(Paper::Lone(_, frame)) => return Err(frame),
            _ => self.lone[side.index()] -= 1,
        }
        Ok(())
    }

    /// A frame that was lent is back.
    pub fn take_back(&mut self, side: Side, frame: Frame) {
        self.lone[side.index()] += 1;
        self.give(side, frame);
    }

    /// Hands a paper to the cold thread.
    ///
    /// # Errors
    /// Gives it back where too many wait.
    pub fn tell(&mut self, paper: Paper) -> Result<(), Paper> {
        let told = self.papers.push(paper).map_err(|PushError::Full(paper)| paper);
        self.papers_waker.wake();
        told
    }

    /// Has something written down, if a recording is made; whether it will be. The cold thread is not woken: it comes
    /// by itself, and with every pair.
    pub fn log(&mut self, said: Said, at: Timestamp) -> bool {
        !self.records() || self.log.push(Logged { at, said }).is_ok()
    }

    /// Has a place record written; whether there was room for it.
    pub fn persist(&mut self, record: PlaceRecord) -> bool {
        let taken = self.records.push(record).is_ok();
        self.papers_waker.wake();
        taken
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_and_files_go_round_with_their_memory() {
        let (_, mut seats) = Desk::new(0, 100, 0).unwrap();
        let mut file = seats.hub.file().unwrap();
        let [left, right] = &mut seats.grabs;
        file.pair = FramePair { left: left.free.pop().unwrap(), right: right.free.pop().unwrap() };
        assert!(file.pair.left.bytes.is_empty() && file.pair.left.bytes.capacity() >= 100);
        let free = left.free.slots();
        seats.cold.outbox.send(Letter::Filed(file));
        let Some(Letter::Filed(file)) = seats.hub.letter() else { panic!("the letter that was sent") };
        seats.hub.give_back(file);
        assert_eq!(seats.grabs[0].free.slots(), free + 1);
        assert!(seats.hub.letter().is_none());
    }

    #[test]
    fn so_many_lone_frames_are_lent_as_there_are_for_it_and_only_to_a_recording() {
        let (_, mut seats) = Desk::new(0, 10, 1).unwrap();
        let [left, _] = &mut seats.grabs;
        let all = left.free.slots();
        let mut lent = 0;
        while let Ok(frame) = left.free.pop() {
            match seats.hub.lend(Side::Left, frame) {
                Ok(()) => lent += 1,
                Err(frame) => seats.hub.give(Side::Left, frame),
            }
            if lent == LONE_FRAMES {
                break;
            }
        }
        let more = left.free.pop().unwrap();
        let back = seats.hub.lend(Side::Left, more).unwrap_err();
        seats.hub.give(Side::Left, back);
        assert_eq!(left.free.slots(), all - LONE_FRAMES);
        while let Ok(Paper::Lone(side, frame)) = seats.cold.papers.pop() {
            seats.cold.outbox.send(Letter::Spare(side, frame));
        }
        while let Some(Letter::Spare(side, frame)) = seats.hub.letter() {
            seats.hub.take_back(side, frame);
        }
        assert_eq!((seats.grabs[0].free.slots(), seats.hub.lone), (all, [LONE_FRAMES; 2]));
        let (_, mut seats) = Desk::new(0, 10, 0).unwrap();
        let frame = seats.grabs[0].free.pop().unwrap();
        assert!(seats.hub.lend(Side::Left, frame).is_err());
    }

    #[test]
    fn a_full_ring_of_papers_gives_back_what_it_cannot_take() {
        let (_, mut seats) = Desk::new(0, 0, 0).unwrap();
        let note = || Paper::Note(Note::Ready, Timestamp(0));
        assert_eq!(std::iter::from_fn(|| seats.hub.tell(note()).ok()).count(), PAPERS);
        assert!(matches!(seats.hub.tell(note()), Err(Paper::Note(Note::Ready, _))));
        assert!(seats.cold.papers.pop().is_ok());
        assert!(seats.hub.tell(note()).is_ok());
    }

    #[test]
    fn what_is_logged_waits_in_its_own_ring_where_a_recording_is_made() {
        let (_, mut seats) = Desk::new(0, 0, 2).unwrap();
        let said = Said::Event(Event::Stop);
        assert_eq!([1, 2, 3].map(|at| seats.hub.log(said, Timestamp(at))), [true, true, false]);
        assert_eq!(seats.cold.log.pop().unwrap(), Logged { at: Timestamp(1), said });
        let (_, mut seats) = Desk::new(0, 0, 0).unwrap();
        assert!(seats.hub.log(said, Timestamp(1)) && seats.cold.log.pop().is_err());
    }

    #[test]
    fn no_letter_is_lost_while_the_arms_thread_is_away() {
        let (desk, mut seats) = Desk::new(0, 0, 0).unwrap();
        let sent = 3 * LETTERS;
        std::thread::scope(|scope| {
            let outbox = &mut seats.recognise;
            let sender = scope.spawn(move || (0..sent).for_each(|_| outbox.send(Letter::Ended(Side::Right))));
            let mut taken = 0;
            while taken < sent {
                desk.letters_waker.wait(None);
                taken += std::iter::from_fn(|| seats.hub.letter()).count();
            }
            sender.join().unwrap();
            assert!(seats.hub.letter().is_none());
        });
    }

    #[test]
    fn who_sends_to_a_thread_that_has_ended_does_not_wait() {
        let (_, seats) = Desk::new(0, 0, 0).unwrap();
        let Seats { mut recognise, hub, .. } = seats;
        drop(hub);
        (0..3 * LETTERS).for_each(|_| recognise.send(Letter::Ended(Side::Right)));
    }
}
