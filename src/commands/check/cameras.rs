//! What `check` finds about live cameras: it opens both as the cell would, and looks at what they bring.

use std::path::Path;
use std::time::Duration;

use super::{Findings, pair};
use crate::camera::v4l::list::{self, UsbPort};
use crate::camera::v4l::{CameraError, V4lCamera};
use crate::camera::{Condition, Grab};
use crate::config::{CameraSettings, Cell};
use crate::frame::{Frame, FramePair, PixelFormat, TimestampMark};
use crate::rig::Rig;
use crate::time::Timestamp;

/// How long the cameras are watched.
const WATCH: Duration = Duration::from_secs(2);

/// Bytes a second that one camera gets at most on a USB 2 bus: three packets of 1024 bytes in each of 8000
/// microframes (USB 2.0, 5.9.1).
const USB2_BYTES_PER_S: f64 = 24_576_000.0;

/// Share of a USB 2 bus that all isochronous streams may have together, in bytes a second: 80 % of 480 Mbit/s.
const USB2_BUS_BYTES_PER_S: f64 = 48_000_000.0;

/// Both cameras, their buses, transfer times, and what they bring.
pub(super) fn check(cell: &Cell, rig: Option<&Rig>, findings: &mut Findings) {
    let (Some(left), Some(right)) = (&cell.cameras.left, &cell.cameras.right) else { return };
    let mut opened = Vec::new();
    for (subject, settings) in [("left camera", left), ("right camera", right)] {
        stable(subject, &settings.device, findings);
        match V4lCamera::open(settings.clone()) {
            Ok(camera) => opened.push((subject, settings, camera)),
            Err(error) => not_opened(subject, &error, findings),
        }
    }
    let ports = [left, right].map(|settings| list::usb_port(&settings.device));
    if let [Some(left_port), Some(right_port)] = &ports {
        share_of_bus(left, right, left_port, right_port, findings);
    }
    for ((subject, settings), port) in
        [("left camera", left), ("right camera", right)].into_iter().zip(&ports)
    {
        transfer(subject, settings, port.as_ref(), cell, findings);
    }
    let watched: Vec<Watched> = std::thread::scope(|scope| {
        let threads = opened.into_iter().map(|(subject, settings, camera)| {
            scope.spawn(move || Watched { subject, settings, seen: watch(camera) })
        });
        let threads: Vec<_> = threads.collect();
        threads.into_iter().filter_map(|thread| thread.join().ok()).collect()
    });
    for watched in &watched {
        report(watched, findings);
    }
    if let [left, right] = watched.as_slice() {
        pairing(cell, &left.seen, &right.seen, left.settings.period(), findings);
        if let (Some(rig), Some(left), Some(right)) = (rig, &left.seen.last, &right.seen.last) {
            let frames = FramePair { left: left.clone(), right: right.clone() };
            pair::check(cell, rig, &frames, "what the cameras see", findings);
        }
    }
}

fn stable(subject: &str, device: &Path, findings: &mut Findings) {
    if let Some(better) = list::better_path(device) {
        findings.warning(
            subject,
            format!("{} is a number that changes when cameras are plugged in anew", device.display()),
            format!("write {better} into cell.toml"),
        );
    }
}

fn not_opened(subject: &str, error: &CameraError, findings: &mut Findings) {
    match error {
        CameraError::NotOffered { .. } | CameraError::NotACamera { .. } | CameraError::Control { .. } => {
            findings.wrong(subject, error.to_string());
        }
        _ => {
            // The message carries its remedy behind the semicolon.
            let text = error.to_string();
            let (what, remedy) = text.split_once("; ").unwrap_or((&text, "see `pickcell devices`"));
            findings.error(subject, what, remedy);
        }
    }
}

/// Bytes of a frame on the wire; about an eighth of the pixels' three bytes for MJPEG.
fn wire_bytes(settings: &CameraSettings) -> f64 {
    let pixels = f64::from(settings.width) * f64::from(settings.height);
    pixels
        * match settings.format {
            PixelFormat::Rgb | PixelFormat::Bgr => 3.0,
            PixelFormat::Yuyv => 2.0,
            PixelFormat::Nv12 => 1.5,
            PixelFormat::Grey => 1.0,
            PixelFormat::Mjpeg => 0.375,
        }
}

fn share_of_bus(
    left: &CameraSettings,
    right: &CameraSettings,
    left_port: &UsbPort,
    right_port: &UsbPort,
    findings: &mut Findings,
) {
    let about =
        |port: &UsbPort| format!("bus {} port {} at {} Mbit/s", port.bus, port.port, port.speed_mbit_s);
    let both = format!("left on {}, right on {}", about(left_port), about(right_port));
    let load = wire_bytes(left) * left.rate_hz + wire_bytes(right) * right.rate_hz;
    let high_speed = left_port.speed_mbit_s <= 480.0 || right_port.speed_mbit_s <= 480.0;
    if left_port.bus == right_port.bus && high_speed && load > 0.5 * USB2_BUS_BYTES_PER_S {
        findings.warning(
            "USB",
            format!(
                "{both}: one bus for both, {:.0} MB/s of its {:.0}",
                load / 1e6,
                USB2_BUS_BYTES_PER_S / 1e6
            ),
            "plug one camera into a port of another bus, or take MJPG or a smaller size",
        );
    } else {
        findings.ok("USB", both);
    }
}

/// Warns where the bytes alone take half of the deadline.
fn transfer(
    subject: &str,
    settings: &CameraSettings,
    port: Option<&UsbPort>,
    cell: &Cell,
    findings: &mut Findings,
) {
    let Some(port) = port else { return };
    let bytes_per_s = USB2_BYTES_PER_S * (port.speed_mbit_s / 480.0).max(0.025);
    let transfer_ms = 1e3 * wire_bytes(settings) / bytes_per_s;
    let deadline_ms = 1e3 * cell.deadline(settings.period()).as_secs_f64();
    if let Some(remedy) = too_slow(transfer_ms, deadline_ms) {
        findings.warning(
            subject,
            format!("the transfer of a frame takes about {transfer_ms:.0} ms of the deadline of {deadline_ms:.0} ms"),
            remedy,
        );
    }
}

fn too_slow(transfer_ms: f64, deadline_ms: f64) -> Option<&'static str> {
    (2.0 * transfer_ms >= deadline_ms)
        .then_some("take MJPG, a smaller size or a faster port, or give the deadline more time")
}

struct Watched<'a> {
    subject: &'static str,
    settings: &'a CameraSettings,
    seen: Seen,
}

/// What came while a camera was watched.
#[derive(Debug, Default)]
struct Seen {
    stamps: Vec<Timestamp>,
    damaged: u32,
    short: u32,
    unknown_clock: bool,
    lost: Option<String>,
    /// The last good frame.
    last: Option<Frame>,
}

fn watch(mut camera: V4lCamera) -> Seen {
    let mut seen = Seen::default();
    let mut frame = Frame::default();
    let mut end = Timestamp::now().after(2 * WATCH);
    while Timestamp::now() < end {
        match camera.grab(&mut frame, Duration::from_millis(100)) {
            Grab::Frame { condition: Condition::Good, .. } => {
                if seen.stamps.is_empty() {
                    end = Timestamp::now().after(WATCH);
                }
                seen.unknown_clock |= frame.mark == TimestampMark::HandedOver;
                seen.stamps.push(frame.timestamp);
                // The next one is grabbed into the one before.
                std::mem::swap(seen.last.get_or_insert_default(), &mut frame);
            }
            Grab::Frame { condition: Condition::Damaged, .. } => seen.damaged += 1,
            Grab::Frame { condition: Condition::Short, .. } => seen.short += 1,
            Grab::Lost(trouble) => {
                seen.lost = Some(trouble.to_string());
                break;
            }
            Grab::TimedOut | Grab::Back | Grab::Ended => {}
        }
    }
    seen
}

impl Seen {
    fn rate_hz(&self) -> Option<f64> {
        let (first, last) = (self.stamps.first()?, self.stamps.last()?);
        let span_s = last.since(*first) as f64 / 1e9;
        (self.stamps.len() > 1 && span_s > 0.0).then(|| (self.stamps.len() - 1) as f64 / span_s)
    }
}

fn report(watched: &Watched, findings: &mut Findings) {
    let Watched { subject, settings, seen } = watched;
    if let Some(lost) = &seen.lost {
        return findings.error(subject, "it was lost while it was watched", lost.clone());
    }
    let Some(rate_hz) = seen.rate_hz() else {
        return findings.error(subject, "it sends no frames", "plug it in anew, or into another port");
    };
    let about = format!("{rate_hz:.1} frames a second of {}", settings.rate_hz);
    if rate_hz < 0.9 * settings.rate_hz {
        findings.warning(
            subject,
            about,
            "automatic exposure slows cameras down in the dark: set auto_exposure = \"Manual Mode\", an \
             exposure_time_absolute, and exposure_dynamic_framerate = false",
        );
    } else {
        findings.ok(subject, about);
    }
    if seen.damaged + seen.short > 0 {
        findings.warning(
            subject,
            format!("{} damaged and {} short frames", seen.damaged, seen.short),
            "take a shorter or better cable, no hub, or MJPG",
        );
    }
    if seen.unknown_clock {
        findings.warning(
            subject,
            "its time stamps are of an unknown clock; the time of hand-over is taken instead",
            "expect frames to look younger than they are: give the deadline less time",
        );
    }
}

fn pairing(cell: &Cell, left: &Seen, right: &Seen, period: Duration, findings: &mut Findings) {
    let Some(skew_ms) = median_skew_ms(&left.stamps, &right.stamps) else { return };
    let window_ms = 1e3 * cell.cameras.pair_window(period).as_secs_f64();
    let about =
        format!("the pictures of a pair are {skew_ms:.1} ms apart (median), the window is {window_ms:.1} ms");
    if skew_ms > window_ms {
        findings.warning(
            "pairing",
            about,
            "start again until they fall together, raise the rate, or widen cameras.pair_window_ms",
        );
    } else {
        findings.ok("pairing", about);
    }
}

/// The median distance from a left stamp to the nearest right one.
fn median_skew_ms(left: &[Timestamp], right: &[Timestamp]) -> Option<f64> {
    let nearest = |stamp: &Timestamp| right.iter().map(|other| other.since(*stamp).abs()).min();
    let mut skews: Vec<i64> = left.iter().filter_map(nearest).collect();
    skews.sort_unstable();
    skews.get(skews.len() / 2).map(|ns| *ns as f64 / 1e6)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rate_and_skew_come_from_the_stamps() {
        let every =
            |ms: i64, from: i64| (0..10).map(|i| Timestamp((from + ms * i) * 1_000_000)).collect::<Vec<_>>();
        let seen = Seen { stamps: every(40, 0), ..Seen::default() };
        assert!((seen.rate_hz().expect("ten frames") - 25.0).abs() < 1e-9);
        assert_eq!(Seen::default().rate_hz(), None);
        assert_eq!(median_skew_ms(&every(40, 0), &every(40, 7)), Some(7.0));
        assert_eq!(median_skew_ms(&every(40, 0), &[]), None);
    }

    #[test]
    fn a_transfer_of_half_the_deadline_is_told() {
        assert!(too_slow(33.0, 66.0).is_some());
        assert!(too_slow(25.0, 66.0).is_none());
    }
}
