//! What the benches of the pixel stages share: one camera's stages in a row, and two cameras on two threads.

#![allow(dead_code, missing_docs, unreachable_pub)]

use pickcell::frame::Frame;
use pickcell::level::Level;
use pickcell::vision::binarize::{self, Binarize, ColourRange};
use pickcell::vision::bits::BitImage;
use pickcell::vision::graph::{self, Graph, Graphs};
use pickcell::vision::thin::{self, Algorithm, Thin, whole::WholeThin};
use std::sync::mpsc::{Receiver, RecvError, SyncSender, TryRecvError, sync_channel};
use std::thread::JoinHandle;

/// The box that the rods of the drawn pictures lie in.
pub const COLOUR: ColourRange = ColourRange::Rgb { min: [100; 3], max: [255; 3] };

/// Binarize, thin and graph of one camera.
pub struct Eye {
    pub binarize: Binarize,
    pub thin: Thin,
    pub whole_thin: WholeThin,
    pub graphs: Graphs,
    pub mask: BitImage,
    pub skeleton: BitImage,
    pub graph: Graph,
}

impl Eye {
    pub fn new(width: usize, height: usize, algorithm: Algorithm, level: Level) -> Self {
        let colours = binarize::Params { colour: COLOUR, ..Default::default() };
        Self {
            binarize: Binarize::with_level(colours, width, height, level).expect("good parameters"),
            thin: Thin::with_level(thin::Params { algorithm }, width, height, level),
            whole_thin: WholeThin::with_level(thin::Params { algorithm }, width, height, level),
            graphs: Graphs::with_level(graph::Params::for_size(width, height), width, height, level),
            mask: BitImage::new(width, height),
            skeleton: BitImage::new(width, height),
            graph: Graph::default(),
        }
    }

    pub fn binarize(&mut self, frame: &Frame) {
        self.binarize.run(frame, &mut self.mask).expect("a good frame");
    }

    pub fn thin(&mut self) {
        self.thin.run(&self.mask, &mut self.skeleton);
    }

    pub fn graph(&mut self, frame: &Frame) {
        self.graphs.run(&self.skeleton, &self.mask, Some(frame), &mut self.graph).expect("within the limits");
    }

    /// Frame to graph, as a recogniser does it.
    pub fn run(&mut self, frame: &Frame) {
        self.binarize(frame);
        self.whole_thin.run(&self.mask, &mut self.skeleton);
        self.graph(frame);
    }
}

/// How two threads wait for each other.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Waits {
    /// In the kernel, as in a cell.
    Asleep,
    /// Spinning, which starves the kernel's own workers: what the stages alone take.
    Awake,
}

impl Waits {
    fn take<T>(self, from: &Receiver<T>) -> Result<T, RecvError> {
        loop {
            match from.try_recv() {
                Err(TryRecvError::Empty) if self == Waits::Awake => std::hint::spin_loop(),
                Err(TryRecvError::Empty) => return from.recv(),
                taken => return taken.map_err(|_| RecvError),
            }
        }
    }
}

/// A second thread that lives as long as this: it takes the right frame and its stages, and gives them back.
pub struct SecondCore {
    waits: Waits,
    work: Option<SyncSender<(Box<Eye>, Frame)>>,
    done: Receiver<(Box<Eye>, Frame)>,
    thread: Option<JoinHandle<()>>,
    /// The right camera's stages and frame while they are here.
    pub right: Option<(Box<Eye>, Frame)>,
}

impl SecondCore {
    pub fn new(waits: Waits, eye: Eye, frame: Frame) -> Self {
        let (work, todo) = sync_channel::<(Box<Eye>, Frame)>(1);
        let (finished, done) = sync_channel(1);
        let thread = std::thread::spawn(move || {
            while let Ok((mut eye, frame)) = waits.take(&todo) {
                eye.run(&frame);
                if finished.send((eye, frame)).is_err() {
                    return;
                }
            }
        });
        Self { waits, work: Some(work), done, thread: Some(thread), right: Some((Box::new(eye), frame)) }
    }

    /// Both pictures to graphs: right there, left here.
    pub fn run(&mut self, left: &mut Eye, frame: &Frame) {
        let right = self.right.take().expect("handed back");
        self.work.as_ref().expect("not dropped").send(right).expect("the thread lives");
        left.run(frame);
        self.right = Some(self.waits.take(&self.done).expect("the thread lives"));
    }
}

impl Drop for SecondCore {
    fn drop(&mut self) {
        self.work = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}
