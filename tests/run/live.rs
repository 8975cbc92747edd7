//! A cell with cameras of its own, none of which is there.

use std::os::unix::net::UnixDatagram;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};

use super::{Cell, stderr};

/// The project's cell with cameras at these paths in place of the recorded session.
fn live(devices: [&str; 2]) -> Cell {
    let camera = |side: &str, device: &str| {
        format!(
            "[cameras.{side}]\ndevice = \"{device}\"\nformat = \"YUYV\"\nwidth = 640\nheight = 480\nrate_hz = 30\n"
        )
    };
    let rig = camera("left", devices[0]) + &camera("right", devices[1]) + "[rig]";
    Cell::new(&[("backend = \"replay\"", "backend = \"v4l2\""), ("[rig]", &rig)])
}

#[test]
fn a_camera_by_its_number_is_warned_of() {
    let cell = live(["/dev/video94", "/dev/video95"]);
    let output = cell.run(&[]);
    assert_eq!(output.status.code(), Some(2));
    let said = stderr(&output);
    let warning =
        "cameras.left.device = \"/dev/video94\" is a number that changes when cameras are plugged in anew";
    assert_eq!(said.matches(warning).count(), 1, "{said}");
}

#[test]
fn a_service_stands_before_its_cameras_and_says_what_it_waits_for() {
    let cell = live(["/dev/pickcell/left", "/dev/pickcell/right"]);
    let manager = UnixDatagram::bind(cell.path("notify")).unwrap();
    manager.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
    let mut child = Ended(
        cell.command(&["--wait"])
            .env("NOTIFY_SOCKET", cell.path("notify"))
            .env("WATCHDOG_USEC", "1000000")
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap(),
    );
    let until = Instant::now() + Duration::from_secs(60);
    let hear = |wanted: &[&str]| {
        loop {
            let mut text = [0; 1024];
            let n = manager.recv(&mut text).expect("a word of the cell");
            let text = String::from_utf8_lossy(&text[..n]).into_owned();
            if wanted.iter().all(|wanted| text.contains(wanted)) {
                return;
            }
            assert!(Instant::now() < until, "{wanted:?} is not said");
        }
    };
    hear(&["READY=1"]);
    hear(&["STATUS=", "left camera: unplugged", "right camera: unplugged", "| 0 pairs"]);
    hear(&["WATCHDOG=1"]);
    hear(&["WATCHDOG=1"]);
    kill_process(Pid::from_child(&child.0), Signal::TERM).unwrap();
    hear(&["STOPPING=1"]);
    assert_eq!(child.0.wait().unwrap().code(), Some(0));
}

/// A process that does not outlive its test.
struct Ended(Child);

impl Drop for Ended {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
