//! A second pair of hands: a thread that does one half of a job while the thread that has the job does the other.
//!
//! As [`std::thread::scope`], which the tests hold it against, but with thread and memory that are there beforehand:
//! nothing is allocated, started or locked per job. Both sleep in the kernel while they wait for each other.
//!
//! ```
//! let (mut owner, helper) = pickcell::hands::hands()?;
//! let thread = std::thread::spawn(move || helper.work());
//! let words = ["one", "four"];
//! let (left, right) = owner.both(|| words[0].len(), || words[1].len());
//! assert_eq!((left, right), (3, 4));
//! drop(owner);
//! thread.join().unwrap();
//! # Ok::<(), std::io::Error>(())
//! ```

use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use rtrb::{Consumer, Producer, RingBuffer};

use crate::handover::Waker;

/// Both ends; [`Helper::work`] belongs into a thread of its own.
///
/// # Errors
/// The system has no descriptor left.
pub fn hands() -> io::Result<(Owner, Helper)> {
    let no = || AtomicBool::new(false);
    let bell =
        Arc::new(Bell { owner: Waker::new()?, helper: Waker::new()?, owner_gone: no(), helper_gone: no() });
    let (errands, to_do) = RingBuffer::new(1);
    let (finished, done) = RingBuffer::new(1);
    Ok((Owner { errands, done, bell: Arc::clone(&bell) }, Helper { to_do, finished, bell }))
}

/// What wakes each of them, and who is gone.
#[derive(Debug)]
struct Bell {
    owner: Waker,
    helper: Waker,
    owner_gone: AtomicBool,
    helper_gone: AtomicBool,
}

/// The end of the thread that has the jobs. The helper ends when this is dropped.
#[derive(Debug)]
pub struct Owner {
    errands: Producer<Errand>,
    done: Consumer<()>,
    bell: Arc<Bell>,
}

/// The other end.
#[derive(Debug)]
pub struct Helper {
    to_do: Consumer<Errand>,
    finished: Producer<()>,
    bell: Arc<Bell>,
}

/// A [`Job`] in the frame of [`Owner::both`], and how to do it.
#[derive(Debug)]
struct Errand {
    job: *mut (),
    work: unsafe fn(*mut ()),
}

// SAFETY: the job behind the pointer may be sent, which `Owner::both` asks of its parts.
unsafe impl Send for Errand {}

/// Work, and what came of it.
struct Job<F, T> {
    work: Option<F>,
    result: Option<thread::Result<T>>,
}

/// # Safety
/// `job` points to a `Job<F, T>` that nobody else uses meanwhile.
unsafe fn work_on<F: FnOnce() -> T, T>(job: *mut ()) {
    // SAFETY: the caller's promise.
    let job = unsafe { &mut *job.cast::<Job<F, T>>() };
    job.result = job.work.take().map(|work| catch_unwind(AssertUnwindSafe(work)));
}

/// Does `mine` here and `theirs` in `second`'s thread, or here too where there is none.
///
/// # Panics
/// If one of them does.
pub fn both<A, T: Send>(
    second: &mut Option<Owner>,
    mine: impl FnOnce() -> A,
    theirs: impl FnOnce() -> T + Send,
) -> (A, T) {
    match second {
        Some(second) => second.both(mine, theirs),
        None => (mine(), theirs()),
    }
}

impl Owner {
    /// Does `mine` here and `theirs` in the helper's thread, or here too where that has ended. Returns when both are done.
    ///
    /// # Panics
    /// If one of them does, after both are done.
    pub fn both<A, T: Send>(
        &mut self,
        mine: impl FnOnce() -> A,
        theirs: impl FnOnce() -> T + Send,
    ) -> (A, T) {
        self.both_of(mine, Job { work: Some(theirs), result: None })
    }

    fn both_of<A, T: Send, F: FnOnce() -> T + Send>(
        &mut self,
        mine: impl FnOnce() -> A,
        mut job: Job<F, T>,
    ) -> (A, T) {
        let at = std::ptr::from_mut(&mut job).cast::<()>();
        let sent = self.errands.push(Errand { job: at, work: work_on::<F, T> }).is_ok();
        self.bell.helper.wake();
        let mine = catch_unwind(AssertUnwindSafe(mine));
        // From here on `job` is ours again: this waits until nobody works on it any more, or ever will.
        if !(sent && self.wait()) {
            // SAFETY: `at` points to `job`, which no helper has seen.
            unsafe { work_on::<F, T>(at) };
        }
        let mine = mine.unwrap_or_else(|panic| resume_unwind(panic));
        let theirs = job.result.expect("the work is done");
        (mine, theirs.unwrap_or_else(|panic| resume_unwind(panic)))
    }

    /// Sleeps until the errand is done; says no where the helper has ended without it.
    fn wait(&mut self) -> bool {
        loop {
            let gone = self.bell.helper_gone.load(Ordering::Acquire);
            // It may have finished just before it ended, so this is asked after that.
            if self.done.pop().is_ok() {
                return true;
            }
            if gone {
                return false;
            }
            self.bell.owner.wait(None);
        }
    }
}

impl Drop for Owner {
    fn drop(&mut self) {
        self.bell.owner_gone.store(true, Ordering::Release);
        self.bell.helper.wake();
    }
}

impl Helper {
    /// Does what the owner asks until that is dropped.
    pub fn work(mut self) {
        while !self.bell.owner_gone.load(Ordering::Acquire) {
            self.bell.helper.wait(None);
            while let Ok(errand) = self.to_do.pop() {
                // SAFETY: the owner keeps the job where it is, and its hands off, until it hears of the end.
                unsafe { (errand.work)(errand.job) };
                let told = self.finished.push(());
                assert!(told.is_ok(), "the owner waits for one errand at a time");
                self.bell.owner.wake();
            }
        }
    }
}

impl Drop for Helper {
    fn drop(&mut self) {
        self.bell.helper_gone.store(true, Ordering::Release);
        self.bell.owner.wake();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with_helper<T>(test: impl FnOnce(&mut Owner) -> T) -> T {
        let (mut owner, helper) = hands().unwrap();
        let thread = thread::spawn(move || helper.work());
        let result = test(&mut owner);
        drop(owner);
        thread.join().unwrap();
        result
    }

    fn half(numbers: &mut [u64], by: u64) -> u64 {
        numbers.iter_mut().for_each(|n| *n = n.wrapping_mul(by).rotate_left(7));
        numbers.iter().fold(0, |sum, n| sum ^ n)
    }

    #[test]
    fn both_halves_are_done_as_in_a_scope_of_threads() {
        let mut numbers: Vec<u64> = (0..2000).collect();
        let mut scoped = numbers.clone();
        with_helper(|owner| {
            for by in 1..500 {
                let (a, b) = numbers.split_at_mut(1000);
                let done = owner.both(|| half(a, by), || half(b, by));
                let (a, b) = scoped.split_at_mut(1000);
                let expected = thread::scope(|scope| {
                    let theirs = scope.spawn(|| half(b, by));
                    (half(a, by), theirs.join().unwrap())
                });
                assert_eq!(done, expected);
            }
        });
        assert_eq!(numbers, scoped);
    }

    #[test]
    fn the_halves_run_in_two_threads() {
        let here = thread::current().id();
        let (mine, theirs) = with_helper(|o| o.both(|| thread::current().id(), || thread::current().id()));
        assert!(mine == here && theirs != here);
    }

    #[test]
    fn a_panic_arrives_after_both_are_done_and_the_helper_goes_on() {
        with_helper(|owner| {
            for mine_fails in [true, false] {
                let done = AtomicBool::new(false);
                let fail = |fails: bool| match fails {
                    true => panic!("on purpose"),
                    false => done.store(true, Ordering::Release),
                };
                let both = || owner.both(|| fail(mine_fails), || fail(!mine_fails));
                assert!(catch_unwind(AssertUnwindSafe(both)).is_err());
                assert!(done.load(Ordering::Acquire));
            }
            assert_eq!(owner.both(|| 1, || 2), (1, 2));
        });
    }

    #[test]
    fn without_a_helper_the_owner_does_it_alone() {
        let (mut owner, helper) = hands().unwrap();
        drop(helper);
        assert_eq!(owner.both(|| 1, || 2), (1, 2));
        assert_eq!(owner.both(|| 3, || 4), (3, 4));
    }
}
