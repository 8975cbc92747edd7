//! `simulate`: a simulated arm behind a pty.

use super::{Failure, Format};
use clap::Args;
use firmware_bridge::config::DialectName;
use firmware_bridge::link::{clock_ns, wait_for};
use firmware_bridge::simulate::{Fault, Faults, Motion, SimulatedArm};
use rustix::fd::{AsFd, OwnedFd};
use rustix::fs::{Mode, OFlags};
use rustix::io::Errno;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::OptionalActions;
use std::ffi::OsString;
use std::io::Write;
use std::os::unix::ffi::OsStringExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command as Process, Stdio};

#[derive(Args)]
#[command(
    after_help = "Example:\n  firmware-bridge simulate --pty /tmp/arm --dialect grbl --seed 7 --faults reset,slow\n  \
                        (then in cell.toml: link = \"serial\", port = \"/tmp/arm\", dialect = \"grbl\")"
)]
pub(crate) struct Arguments {
    /// Symbolic link to make to the pty; removed at the end.
    #[arg(long, value_name = "LINK")]
    pty: PathBuf,
    /// Language the arm speaks.
    #[arg(long)]
    dialect: DialectName,
    /// Seed of the faults and of everything else that is drawn.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// What goes wrong now and then, separated by commas.
    #[arg(long, value_delimiter = ',', value_name = "FAULT,…")]
    faults: Vec<Fault>,
    /// Rest position out of the cameras' view, mm in the base frame: x,y,z, also as three values.
    #[arg(long, default_value = "0,0,200", allow_hyphen_values = true, value_name = "X,Y,Z")]
    park_mm: String,
    /// The second and third value where `--park-mm` is followed by three.
    #[arg(hide = true, num_args = 0..=2, allow_negative_numbers = true)]
    park_rest_mm: Vec<String>,
    /// Speed of the line; answers take as long as they would on it.
    #[arg(long, default_value_t = 115_200, value_parser = clap::value_parser!(u32).range(1200..=4_000_000))]
    baud: u32,
    /// Shell command to run whenever a part was placed, e.g. to bring the next scene into view.
    #[arg(long, value_name = "COMMAND")]
    on_place: Option<String>,
    /// How to print what the arm does.
    #[arg(long, default_value = "text")]
    format: Format,
}

/// The terminal's master end, and a slave end so that it outlives its users.
struct Pty {
    master: OwnedFd,
    _slave: OwnedFd,
    link: PathBuf,
    device: PathBuf,
}

impl Pty {
    fn new(link: &Path) -> Result<Self, Failure> {
        let (master, slave, device) = open_pty().map_err(|errno| Failure::Pty(errno.into()))?;
        match std::fs::symlink_metadata(link) {
            Ok(data)
                if data.is_symlink()
                    && std::fs::read_link(link).is_ok_and(|to| to.starts_with("/dev/pts")) =>
            {
                let _ = std::fs::remove_file(link);
            }
            Ok(_) => return Err(Failure::NotALink(link.into())),
            Err(_) => {}
        }
        std::os::unix::fs::symlink(&device, link)
            .map_err(|reason| Failure::MakeLink { path: link.into(), reason })?;
        Ok(Self { master, _slave: slave, link: link.into(), device })
    }
}

impl Drop for Pty {
    fn drop(&mut self) {
        // Somebody else may have taken the name meanwhile.
        if std::fs::read_link(&self.link).is_ok_and(|to| to == self.device) {
            let _ = std::fs::remove_file(&self.link);
        }
    }
}

fn open_pty() -> Result<(OwnedFd, OwnedFd, PathBuf), Errno> {
    let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
    grantpt(&master)?;
    unlockpt(&master)?;
    rustix::fs::fcntl_setfl(&master, OFlags::NONBLOCK)?;
    let device = PathBuf::from(OsString::from_vec(ptsname(&master, Vec::new())?.into_bytes()));
    let slave = rustix::fs::open(&device, OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC, Mode::empty())?;
    // Until somebody opens it as a serial port it must not echo what the arm says back to the arm.
    let mut termios = rustix::termios::tcgetattr(&slave)?;
    termios.make_raw();
    rustix::termios::tcsetattr(&slave, OptionalActions::Now, &termios)?;
    Ok((master, slave, device))
}

pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let signals = super::catch_signals()?;
    let park_mm = park(&arguments.park_mm, &arguments.park_rest_mm)?;
    let pty = Pty::new(&arguments.pty)?;
    let mut arm =
        SimulatedArm::new(arguments.dialect, park_mm, Faults::new(arguments.seed, &arguments.faults));
    tracing::info!(link = %pty.link.display(), device = %pty.device.display(), "the arm listens");
    let byte_ns = 10_000_000_000 / i64::from(arguments.baud);
    let start_ns = clock_ns();
    let mut line_free_ns = start_ns;
    let mut bytes = [0; 256];
    let mut holds_part = false;
    let mut placed: Option<Child> = None;
    while !super::signalled(&signals) {
        let now_ns = clock_ns();
        match rustix::io::read(&pty.master, &mut bytes) {
            Ok(len) => arm.on_bytes(&bytes[..len], now_ns),
            Err(Errno::AGAIN | Errno::INTR) => {}
            Err(errno) => return Err(Failure::PtyBroken(errno.into())),
        }
        while let Some(motion) = arm.poll(now_ns) {
            print_motion(motion, now_ns - start_ns, arguments.format);
            match (motion, &arguments.on_place) {
                (Motion::Closed { holds_part: holds }, _) => holds_part = holds,
                (Motion::Opened, Some(command)) if holds_part => {
                    holds_part = false;
                    start(command, &mut placed);
                }
                _ => {}
            }
        }
        let mut until_ns = arm.next_deadline_ns().unwrap_or(i64::MAX);
        if now_ns >= line_free_ns {
            let len = arm.transmit(now_ns, &mut bytes);
            // A line that nobody reads loses what is said on it.
            let _ = rustix::io::write(&pty.master, &bytes[..len]);
            if len > 0 {
                line_free_ns = now_ns + len as i64 * byte_ns;
                until_ns = line_free_ns;
            }
        } else {
            until_ns = until_ns.min(line_free_ns);
        }
        wait_for(&[Some(pty.master.as_fd()), Some(signals.as_fd())], until_ns);
    }
    Ok(())
}

/// Three numbers, between commas, spaces or both.
fn park(first: &str, rest: &[String]) -> Result<[f64; 3], Failure> {
    let written = [first, &rest.join(" ")].join(" ");
    let numbers = written.split([',', ' ']).filter(|word| !word.is_empty());
    let numbers: Option<Vec<f64>> =
        numbers.map(|word| word.parse().ok().filter(|value: &f64| value.abs() < 1e6)).collect();
    let point: Option<[f64; 3]> = numbers.and_then(|numbers| numbers.try_into().ok());
    point.ok_or_else(|| Failure::Park(written.trim().into()))
}

/// Runs a shell command beside the arm; the one before it is collected.
fn start(command: &str, running: &mut Option<Child>) {
    if let Some(mut earlier) = running.take()
        && !matches!(earlier.try_wait(), Ok(Some(_)))
    {
        tracing::warn!(command, "the last one still runs: ended");
        let _ = earlier.kill();
        let _ = earlier.wait();
    }
    match Process::new("/bin/sh").args(["-c", command]).stdin(Stdio::null()).stdout(Stdio::null()).spawn() {
        Ok(child) => *running = Some(child),
        Err(error) => tracing::error!(command, %error, "cannot be started"),
    }
}

/// One line; somebody who waits for it sees it at once.
fn print_motion(motion: Motion, since_start_ns: i64, format: Format) {
    let seconds = since_start_ns as f64 / 1e9;
    let mut out = std::io::stdout().lock();
    let point = |at: [f64; 3]| format!("{:.3}, {:.3}, {:.3}", at[0], at[1], at[2]);
    // Standard output may be closed; the arm lives on.
    let _ = match format {
        Format::Text => {
            let what = match motion {
                Motion::Began { to_mm } => format!("moves to      {}", point(to_mm)),
                Motion::Arrived { at_mm } => format!("has arrived   {}", point(at_mm)),
                Motion::Stopped { at_mm } => format!("stopped at    {}", point(at_mm)),
                Motion::Closed { holds_part: true } => "fingers closed, part held".into(),
                Motion::Closed { holds_part: false } => "fingers closed on nothing".into(),
                Motion::Opened => "fingers opened".into(),
                Motion::Restarted => "controller restarted".into(),
            };
            writeln!(out, "{seconds:10.3} s  {what}")
        }
        Format::Json => {
            let what = match motion {
                Motion::Began { to_mm } => format!("\"began\", \"to_mm\": [{}]", point(to_mm)),
                Motion::Arrived { at_mm } => format!("\"arrived\", \"at_mm\": [{}]", point(at_mm)),
                Motion::Stopped { at_mm } => format!("\"stopped\", \"at_mm\": [{}]", point(at_mm)),
                Motion::Closed { holds_part } => format!("\"closed\", \"holds_part\": {holds_part}"),
                Motion::Opened => "\"opened\"".into(),
                Motion::Restarted => "\"restarted\"".into(),
            };
            writeln!(out, "{{ \"time_s\": {seconds:.3}, \"motion\": {what} }}")
        }
    };
    let _ = out.flush();
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        arguments: Arguments,
    }

    fn parked(values: &[&str]) -> Result<[f64; 3], Failure> {
        let line =
            ["simulate", "--pty", "arm", "--park-mm"].iter().chain(values).chain(&["--dialect", "own"]);
        let arguments = Line::try_parse_from(line).unwrap().arguments;
        park(&arguments.park_mm, &arguments.park_rest_mm)
    }

    #[test]
    fn the_rest_position_may_be_written_with_commas_or_spaces() {
        for values in [&["-1,2.5,-3"][..], &["-1", "2.5", "-3"], &["-1,", "2.5,", "-3"], &["-1, 2.5, -3"]] {
            assert_eq!(parked(values).unwrap(), [-1.0, 2.5, -3.0], "{values:?}");
        }
        let complaint = parked(&["1,2"]).unwrap_err().to_string();
        assert_eq!(complaint, "--park-mm 1,2 is no point: give x,y,z in mm, e.g. --park-mm 0,-150,200");
        assert!(parked(&["1,2,nan"]).is_err() && parked(&["1,2,3", "4"]).is_err());
    }
}
