//! Rights that the threads ask the system for: SCHED_FIFO, cores, locked and prefaulted memory.
//!
//! Takes what cell.toml asks for; gives what was granted, to be said in the log. Driver and bridge run without any of
//! it.

use std::fmt;
use std::path::Path;

use serde::Deserialize;

use crate::config::{ConfigError, Fault, TextError, read_toml};
use crate::outside::read_text;
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use rustix::thread::{CpuSet, sched_setaffinity};

/// Bit of CAP_IPC_LOCK in the capability sets of `/proc/self/status`.
const CAP_IPC_LOCK: u32 = 14;

/// What a thread asks for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Wish {
    /// SCHED_FIFO with this priority, 10 to 40; `None`: the normal scheduler.
    pub fifo_priority: Option<u8>,
    /// Cores it may run on; empty: all.
    pub cores: Vec<usize>,
    /// So much of its stack is touched before it starts, bytes.
    pub prefault_bytes: usize,
}

/// What one of the wishes came to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Granted {
    /// It was granted.
    Yes,
    /// It was not asked for.
    NotAsked,
    /// The system refused.
    No {
        /// `errno`.
        errno: i32,
    },
}

impl fmt::Display for Granted {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Granted::Yes => write!(f, "granted"),
            Granted::NotAsked => write!(f, "not asked for"),
            Granted::No { errno } => {
                write!(f, "not granted ({})", std::io::Error::from_raw_os_error(*errno))
            }
        }
    }
}

/// What a thread got.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rights {
    /// SCHED_FIFO.
    pub fifo: Granted,
    /// The cores.
    pub cores: Granted,
}

/// How hot threads are scheduled.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Scheduling {
    /// SCHED_FIFO where the system grants it.
    #[default]
    Fifo,
    /// The normal scheduler.
    Normal,
}

/// What `[realtime]` of a cell.toml says of the thread that has the arm; its other keys are the driver's.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(default)]
pub struct ArmThread {
    /// How it is scheduled.
    pub scheduling: Scheduling,
    /// Its SCHED_FIFO priority, 10 to 40.
    pub arm_priority: u8,
    /// Cores it may run on; empty: all but the last one.
    pub cores: Vec<usize>,
    /// Lock all memory.
    pub lock_memory: bool,
}

impl Default for ArmThread {
    fn default() -> Self {
        Self { scheduling: Scheduling::Fifo, arm_priority: 40, cores: Vec::new(), lock_memory: true }
    }
}

impl ArmThread {
    /// Reads and checks the table; where there is none, what is asked for unless something else is said.
    ///
    /// # Errors
    /// A file that cannot be read, a value of the wrong type, a priority out of range.
    pub fn read(path: &Path) -> Result<Self, ConfigError> {
        let text = read_text(path).map_err(|source| ConfigError::Read { path: path.into(), source })?;
        Self::parse(&text).map_err(|error| ConfigError::File { path: path.into(), error })
    }

    fn parse(text: &str) -> Result<Self, TextError> {
        #[derive(Deserialize)]
        struct File {
            #[serde(default)]
            realtime: ArmThread,
        }
        let thread = read_toml::<File>(text)?.realtime;
        if !(10..=40).contains(&thread.arm_priority) {
            let allowed = "10 to 40 (interrupt threads have 50)";
            return Err(TextError::of(
                text,
                Fault::value("realtime.arm_priority", thread.arm_priority, allowed),
            ));
        }
        Ok(thread)
    }

    /// What the thread asks the system for.
    pub fn wish(&self, prefault_bytes: usize) -> Wish {
        Wish {
            fifo_priority: (self.scheduling == Scheduling::Fifo).then_some(self.arm_priority),
            cores: if self.cores.is_empty() { hot_cores() } else { self.cores.clone() },
            prefault_bytes,
        }
    }
}

/// Applies a wish to the calling thread.
pub fn apply(wish: &Wish) -> Rights {
    prefault_stack(wish.prefault_bytes);
    let fifo = wish.fifo_priority.map_or(Granted::NotAsked, set_fifo);
    let cores = if wish.cores.is_empty() {
        Granted::NotAsked
    } else {
        let mut set = CpuSet::new();
        wish.cores.iter().filter(|&&core| core < CpuSet::MAX_CPU).for_each(|&core| set.set(core));
        match sched_setaffinity(None, &set) {
            Ok(()) => Granted::Yes,
            Err(e) => Granted::No { errno: e.raw_os_error() },
        }
    };
    Rights { fifo, cores }
}

fn set_fifo(priority: u8) -> Granted {
    let param = libc::sched_param { sched_priority: i32::from(priority) };
    // SAFETY: 0 is the calling thread, `param` outlives the call, which only reads it.
    let result = unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const param) };
    match result {
        0 => Granted::Yes,
        _ => Granted::No { errno: std::io::Error::last_os_error().raw_os_error().unwrap_or(0) },
    }
}

/// Locks all memory of the process, present and future, where nothing can fail later for it: without a limit, or
/// with the right to pass over it. Under a limit a later allocation would be refused instead.
pub fn lock_memory() -> Granted {
    let unlimited = Rlimit { current: None, maximum: None };
    let raised = getrlimit(Resource::Memlock).current.is_none()
        || setrlimit(Resource::Memlock, unlimited).is_ok()
        || may_lock_without_limit();
    if !raised {
        return Granted::No { errno: libc::EPERM };
    }
    // SAFETY: takes flags only; changes how pages are kept, not what is in them.
    match unsafe { libc::mlockall(libc::MCL_CURRENT | libc::MCL_FUTURE) } {
        0 => Granted::Yes,
        _ => Granted::No { errno: std::io::Error::last_os_error().raw_os_error().unwrap_or(0) },
    }
}

fn may_lock_without_limit() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let effective = status.lines().find_map(|line| line.strip_prefix("CapEff:"));
    let bits = effective.and_then(|hex| u64::from_str_radix(hex.trim(), 16).ok()).unwrap_or(0);
    bits & (1 << CAP_IPC_LOCK) != 0
}

/// Touches `bytes` of the stack below this frame, a page at a time.
#[inline(never)]
fn prefault_stack(bytes: usize) {
    const PIECE: usize = 16 << 10;
    let mut piece = [0u8; PIECE];
    for page in piece.chunks_mut(4096) {
        page[0] = 1;
    }
    std::hint::black_box(&mut piece);
    if bytes > PIECE {
        prefault_stack(bytes - PIECE);
    }
    std::hint::black_box(&piece);
}

/// Cores for the hot threads where cell.toml names none: all but the last, which is left to the kernel's workers;
/// with one core that one.
pub fn hot_cores() -> Vec<usize> {
    let count = std::thread::available_parallelism().map_or(1, usize::from);
    (0..count.saturating_sub(1).max(1)).collect()
}

/// Resident memory of the process, bytes; 0 where the system does not say.
pub fn resident_bytes() -> u64 {
    let statm = std::fs::read_to_string("/proc/self/statm").unwrap_or_default();
    let pages: u64 = statm.split_whitespace().nth(1).and_then(|pages| pages.parse().ok()).unwrap_or(0);
    pages * rustix::param::page_size() as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_without_wishes_asks_for_nothing() {
        let wish = Wish { fifo_priority: None, cores: vec![], prefault_bytes: 64 << 10 };
        assert_eq!(apply(&wish), Rights { fifo: Granted::NotAsked, cores: Granted::NotAsked });
    }

    #[test]
    fn the_bridge_reads_what_concerns_its_thread_and_leaves_the_rest_to_the_driver() {
        assert_eq!(ArmThread::parse("[arm]\n").unwrap(), ArmThread::default());
        let text =
            "[realtime]\nscheduling = \"normal\"\ngrab_priority = 31\ncores = [0]\nlock_memory = false\n";
        let thread = ArmThread::parse(text).unwrap();
        assert!(!thread.lock_memory);
        assert_eq!(thread.wish(64), Wish { fifo_priority: None, cores: vec![0], prefault_bytes: 64 });
        assert_eq!(
            ArmThread::parse("[realtime]\narm_priority = 90\n").unwrap_err().to_string(),
            "line 2: realtime.arm_priority = 90 is not possible; allowed: 10 to 40 (interrupt threads have 50)"
        );
    }

    #[test]
    fn refusals_are_said_in_words() {
        assert_eq!(
            Granted::No { errno: libc::EPERM }.to_string(),
            "not granted (Operation not permitted (os error 1))"
        );
    }

    #[test]
    fn a_core_that_is_not_there_is_refused() {
        let wish = Wish { fifo_priority: None, cores: vec![1023], prefault_bytes: 0 };
        let rights = std::thread::spawn(move || apply(&wish)).join().unwrap();
        assert_eq!(rights.cores, Granted::No { errno: libc::EINVAL });
    }

    #[test]
    fn a_core_is_left_to_the_kernel_and_memory_is_in_use() {
        assert!(!hot_cores().is_empty());
        assert!(resident_bytes() > 100_000);
    }
}
