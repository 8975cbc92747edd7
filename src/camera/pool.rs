//! The frames that circulate in the cell.
//!
//! Takes empty frames back, gives them out; owns all pixel memory of the cell: after [`FramePool::new`] nothing is
//! allocated for pictures that fit `capacity_bytes`. Lock-free: grab threads take, the arm's thread gives back.

use crossbeam_queue::ArrayQueue;

use crate::frame::Frame;

/// A fixed number of frames.
#[derive(Debug)]
pub struct FramePool {
    free: ArrayQueue<Frame>,
}

impl FramePool {
    /// `count` frames with room for `capacity_bytes` each, every page of it touched.
    pub fn new(count: usize, capacity_bytes: usize) -> Self {
        let free = ArrayQueue::new(count.max(1));
        for _ in 0..count {
            // Filled with something else than zeros, or the system would map one page for all of it.
            let mut bytes = vec![1; capacity_bytes];
            bytes.clear();
            let pushed = free.push(Frame { bytes, ..Frame::default() });
            assert!(pushed.is_ok(), "the pool holds {count} frames");
        }
        Self { free }
    }

    /// A free frame; `None` where all are in use.
    pub fn take(&self) -> Option<Frame> {
        self.free.pop()
    }

    /// Gives a frame back.
    ///
    /// # Panics
    /// Where more frames come back than were taken.
    pub fn give(&self, frame: Frame) {
        assert!(self.free.push(frame).is_ok(), "a frame that is not from this pool");
    }

    /// Free frames at this moment.
    pub fn free(&self) -> usize {
        self.free.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_go_out_and_come_back_with_their_memory() {
        let pool = FramePool::new(2, 100);
        let (a, b) = (pool.take().unwrap(), pool.take().unwrap());
        assert!(a.bytes.is_empty() && a.bytes.capacity() >= 100);
        assert!(pool.take().is_none());
        pool.give(b);
        assert_eq!(pool.free(), 1);
        pool.give(a);
    }
}
