//! Prints what a camera brings: `cargo run --example grab -- cell.toml left 10` for ten seconds of the left camera.

use std::process::ExitCode;
use std::time::Duration;

use pickcell::camera::v4l::V4lCamera;
use pickcell::camera::{Condition, Grab};
use pickcell::config::Cell;
use pickcell::frame::Frame;
use pickcell::time::Timestamp;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [cell, side, seconds] = arguments.as_slice() else {
        eprintln!("usage: grab CELL left|right SECONDS");
        return ExitCode::from(2);
    };
    match watch(cell, side, seconds) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::from(2)
        }
    }
}

fn watch(cell: &str, side: &str, seconds: &str) -> Result<(), Box<dyn std::error::Error>> {
    let cell = Cell::read(cell.as_ref())?;
    let settings = if side == "left" { cell.cameras.left } else { cell.cameras.right };
    let seconds: u64 = seconds.parse()?;
    let mut camera = V4lCamera::open(settings.ok_or("this cell has no such camera")?)?;
    let mut frame = Frame::default();
    let begin = Timestamp::now();
    let end = begin.after(Duration::from_secs(seconds));
    while Timestamp::now() < end {
        let grab = camera.grab(&mut frame, Duration::from_millis(100));
        let now = Timestamp::now();
        let at_ms = now.since(begin) / 1_000_000;
        match grab {
            Grab::TimedOut => {}
            Grab::Frame { condition: Condition::Good, skipped } => println!(
                "{at_ms} ms: frame {} of {} bytes, {} us old ({:?}), {skipped} skipped",
                frame.sequence,
                frame.bytes.len(),
                now.since(frame.timestamp) / 1000,
                frame.mark,
            ),
            other => println!("{at_ms} ms: {other:?}, sequence {}", frame.sequence),
        }
    }
    Ok(())
}
