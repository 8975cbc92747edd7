//! The overlay pictures of a running cell, drawn in a thread of their own, so that lines, log and place records do
//! not wait for them.

use std::path::PathBuf;
use std::sync::Arc;
use std::thread::{Builder, JoinHandle};

use crossbeam_channel::{Receiver, Sender, unbounded};
use nalgebra::Isometry3;

use super::RunError;
use crate::cell::desk::File;
use crate::handover::Waker;
use crate::part::Part;
use crate::picture::Picture;
use crate::recognize::{Params, Side, StageTimes};
use crate::report::overlay::Overlay;
use crate::rig::Rig;
use crate::vision::decode::{Decoder, Output};

/// A pair to be drawn.
struct Order {
    name: String,
    caption: String,
    file: Box<File>,
}

/// A file that was drawn, or could not be.
type Drawn = (Box<File>, Result<(), RunError>);

/// The painter's thread, as the cold thread sees it.
pub(super) struct Studio {
    /// Has room for every file that there is: nobody waits to send.
    orders: Sender<Order>,
    drawn: Receiver<Drawn>,
    thread: JoinHandle<()>,
    under_way: usize,
}

impl Studio {
    /// Starts the thread; `waker` hears when a picture is drawn.
    pub(super) fn open(painter: Painter, waker: Arc<Waker>) -> std::io::Result<Self> {
        let (orders, ordered) = unbounded();
        let (finished, drawn) = unbounded();
        let thread =
            Builder::new().name("paint".into()).spawn(move || paint(painter, &ordered, &finished, &waker))?;
        Ok(Self { orders, drawn, thread, under_way: 0 })
    }

    /// Orders a picture; gives the file back where the painter has gone.
    pub(super) fn order(&mut self, name: String, caption: String, file: Box<File>) -> Result<(), Box<File>> {
        self.orders.send(Order { name, caption, file }).map_err(|refused| refused.into_inner().file)?;
        self.under_way += 1;
        Ok(())
    }

    /// A pair that was drawn; waits for it where more than `under_way_max` are not.
    pub(super) fn drawn(&mut self, under_way_max: usize) -> Option<Drawn> {
        let drawn = match self.under_way > under_way_max {
            true => self.drawn.recv().ok(),
            false => self.drawn.try_recv().ok(),
        };
        // A painter that has gone draws nothing any more.
        self.under_way = if drawn.is_some() { self.under_way - 1 } else { self.under_way.min(under_way_max) };
        drawn
    }

    /// Waits for all pictures; the first error.
    pub(super) fn close(mut self) -> Result<(), RunError> {
        let mut result = Ok(());
        while let Some((_, drawn)) = self.drawn(0) {
            result = result.and(drawn);
        }
        drop(self.orders);
        if let Err(panic) = self.thread.join() {
            std::panic::resume_unwind(panic);
        }
        result
    }
}

fn paint(mut painter: Painter, ordered: &Receiver<Order>, finished: &Sender<Drawn>, waker: &Waker) {
    for Order { name, caption, file } in ordered {
        let result = painter.paint(&name, &file, &caption);
        if finished.send((file, result)).is_err() {
            return;
        }
        waker.wake();
    }
}

/// Draws overlay pictures.
pub(super) struct Painter {
    folder: PathBuf,
    pictures: [Picture; 2],
    decoders: [Decoder; 2],
    parts: Vec<Part>,
    rig: Rig,
    base_from_left: Isometry3<f64>,
}

impl Painter {
    pub(super) fn new(folder: PathBuf, params: Params, rig: Rig, parts: Vec<Part>) -> Result<Self, RunError> {
        std::fs::create_dir_all(&folder)
            .map_err(|reason| RunError::Unwritable { path: folder.clone(), reason })?;
        let [left, right] = params.binarize.clone();
        let decoder = || Decoder::new(Output::Rgb, rig.left.width, rig.left.height);
        Ok(Self {
            folder,
            pictures: [
                Picture::new(left, &params, rig.left, &parts)?,
                Picture::new(right, &params, rig.right, &parts)?,
            ],
            decoders: [decoder(), decoder()],
            base_from_left: params.grasp.base_from_left.unwrap_or_default(),
            parts,
            rig,
        })
    }

    fn paint(&mut self, name: &str, file: &File, caption: &str) -> Result<(), RunError> {
        let [left, right] = &mut self.decoders;
        let (Ok(left), Ok(right)) = (left.run(&file.pair.left), right.run(&file.pair.right)) else {
            // The line of the pair says that it cannot be decoded; there is nothing to draw on.
            return Ok(());
        };
        let mut stages = StageTimes::default();
        for (picture, frame, side) in [(0, &file.pair.left, Side::Left), (1, &file.pair.right, Side::Right)] {
            // Refused before by the recogniser; what was made up to there is drawn.
            let _ = self.pictures[picture].run(frame, side, None, &mut stages);
        }
        let _ = Picture::agree(&mut self.pictures, [&file.pair.left, &file.pair.right], None, &mut stages);
        let overlay = Overlay {
            frames: [left, right],
            graphs: self.pictures.each_ref().map(|picture| (picture.graph(), picture.halvings())),
            rig: &file.recognition.rig(&self.rig),
            parts: &self.parts,
            found: &file.recognition.parts,
            base_from_left: self.base_from_left,
            caption,
        };
        let path = self.folder.join(format!("{name}.png"));
        overlay.draw().write_png(&path).map_err(|reason| RunError::Unwritable { path, reason })
    }
}
