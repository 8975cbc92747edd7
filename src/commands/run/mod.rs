//! `pickcell run`: the cell itself, with live cameras or a recorded session.

mod args;
mod calibration;
mod cold;
mod entries;
mod error;
mod paint;
pub(super) mod place;
mod record;
mod setup;
mod standing;
mod summary;

use std::sync::Arc;

pub use args::RunArgs;
pub use error::RunError;

use self::cold::Cold;
use self::setup::Setup;
use crate::cell::carrier::Carrier;
use crate::cell::core::Ending;
use crate::cell::desk::Seats;
use crate::cell::fast::Fast;
use crate::cell::notify;
use crate::cell::realtime::{Granted, lock_memory};
use crate::cell::threads::{self, Controls, Live, Signalled};
use crate::time::Timestamp;

/// Runs the cell until its session or somebody ends it.
///
/// # Errors
/// [`RunError`]; its exit code says whether the job or what was given to it is to blame.
pub fn run(args: &RunArgs) -> Result<(), RunError> {
    let signalled = Arc::new(Signalled::default());
    threads::obey_signals(Arc::clone(&signalled)).map_err(RunError::System)?;
    let Setup {
        cell,
        core,
        arm,
        cameras,
        steps,
        recognizer,
        second,
        desk,
        seats,
        wishes,
        fast,
        period,
        schedule,
        rig,
        parts,
        names,
    } = Setup::new(args)?;
    let controls = Arc::new(Controls::new(Arc::clone(&desk)));
    signalled.cell_stands(&controls);
    let in_base = cell.rig.base_from_left.is_some();
    let Seats { grabs, recognise, cold, hub } = seats;
    let mut cold =
        Cold::new(args, &cell, (Arc::clone(&desk), Arc::clone(&controls), cold), &rig, parts, names, period)?;
    notify::ready();
    let ending = if fast {
        let sides: Vec<_> = steps.into_iter().flatten().collect();
        let next = || sides.iter().for_each(|side| side.wake());
        let carrier = Carrier::new(&desk, hub, core, arm);
        let start = Timestamp::now();
        let fast =
            Fast { grabs, cameras, next: &next, period, schedule, recognizer, in_base, carrier, start };
        fast.run(|| controls.is_stopped(), || cold.work())
    } else {
        say_memory(if cell.realtime.lock_memory { lock_memory() } else { Granted::NotAsked });
        let live = Live {
            desk: Arc::clone(&desk),
            grabs,
            recognise,
            hub,
            controls,
            cameras,
            steps,
            recognizer,
            second,
            in_base,
            core,
            arm,
            wishes,
        };
        let told = |name: &str, rights: threads::ThreadRights| say_rights(name, &rights);
        let cold = &mut cold;
        threads::run(live, told, move || cold.work()).map_err(RunError::System)?
    };
    notify::stopping();
    match (cold.finish(), ending) {
        (Err(failed), Ending::WrongArm) if !failed.is_closed_pipe() => Err(failed),
        (_, Ending::WrongArm) => Err(RunError::WrongArm),
        (finished, Ending::Done) => finished,
    }
}

fn say_memory(granted: Granted) {
    tracing::info!(%granted, "locked memory");
}

fn say_rights(thread: &str, rights: &threads::ThreadRights) {
    let (fifo, cores, stack_kib) = (rights.fifo, rights.cores, rights.stack_bytes >> 10);
    tracing::info!(thread, sched_fifo = %fifo, cores = %cores, stack_kib, "real-time rights");
}
