//! A live camera.
//!
//! Takes its [`CameraSettings`]; gives a [`Grab`] a call; owns the device, its mapped buffers and the pause until
//! the next attempt to open it. It is opened by its stable path, with exactly the format, size and rate asked for,
//! its controls set and read back, after every loss anew.
//!
//! ```text
//!          opened (*)                  first frame: Back
//!  closed ────────► awaiting the first ────────────────► streaming
//!    ▲                     │ none in time                    │ unplugged, stalled, error: Lost
//!    └─────────────────────┴─────────────────────────────────┘   pause: 0.1 s, doubled up to 2 s
//!
//!  (*) where the first attempt fails: Lost
//! ```

pub mod buffers;
pub mod controls;
pub mod device;
mod error;
pub mod format;
mod intake;
pub mod list;
mod uapi;

use std::io;
use std::time::Duration;

use crate::camera::{Condition, Grab, Trouble};
use crate::config::CameraSettings;
use crate::frame::{ColourEncoding, Frame, TimestampMark};
use crate::time::{Clocks, Sleep, Timestamp};
use buffers::{Buffers, Filled};
use device::{Device, DriverFormat, Readiness};
pub use error::CameraError;
use error::{in_words, trouble};
use format::Rows;
use intake::{Backlog, Intake, Taken};

/// Buffers that the driver fills in turn.
const BUFFERS: u32 = 4;

/// A camera that sends nothing for so long, or for four frame periods, has stalled.
const STALL_AFTER: Duration = Duration::from_millis(700);

/// A camera that was just opened may take so long to its first frame.
const FIRST_FRAME_WITHIN: Duration = Duration::from_secs(4);

/// The first pause before a lost camera is opened again, and the longest.
const REOPEN_PAUSE: (Duration, Duration) = (Duration::from_millis(100), Duration::from_secs(2));

/// Of RGB3, the largest of the formats.
const BYTES_PER_PIXEL_MAX: usize = 3;

/// A stamp further ahead than this, or further before the stream began, is not of the clock that its flag names, ns.
const STAMP_OFF_NS_MAX: i64 = 10_000_000_000;

/// An open device that streams.
#[derive(Debug)]
struct Stream {
    // Before the device, so that the memory goes before the descriptor.
    buffers: Buffers,
    device: Device,
    intake: Intake<Filled>,
    rows: Option<Rows>,
    encoding: ColourEncoding,
    buffer_bytes: usize,
    began: Timestamp,
    backlog: Backlog,
    quiet_until: Timestamp,
}

/// A V4L2 camera; see the module.
#[derive(Debug)]
pub struct V4lCamera {
    settings: CameraSettings,
    stream: Option<Stream>,
    retry_at: Timestamp,
    pause: Duration,
    /// Why it gives no frames, as was last said.
    lost: Option<Trouble>,
    unknown_clock_told: bool,
    told: Option<String>,
    sleep: Sleep,
}

impl V4lCamera {
    /// Opens it and starts its stream.
    ///
    /// # Errors
    /// What is in the way, with what to do about it.
    pub fn open(settings: CameraSettings) -> Result<Self, CameraError> {
        V4lCamera::open_within(settings, Duration::ZERO)
    }

    /// Like [`open`](V4lCamera::open), but waits at most `patience` for a device that is not there or forbidden: at
    /// boot USB cameras come after the services, and udev takes a link away for a moment when it makes it anew.
    ///
    /// # Errors
    /// What is in the way, with what to do about it; at once, unless it is [`CameraError::Absent`] or
    /// [`CameraError::NoAccess`].
    pub fn open_within(settings: CameraSettings, patience: Duration) -> Result<Self, CameraError> {
        let until = Timestamp::now().after(patience);
        let stream = loop {
            match Stream::open(&settings) {
                Err(CameraError::Absent { .. } | CameraError::NoAccess { .. })
                    if Timestamp::now() < until =>
                {
                    std::thread::sleep(REOPEN_PAUSE.0)
                }
                opened => break opened?,
            }
        };
        let mut camera = V4lCamera::closed(settings);
        camera.stream = Some(stream);
        Ok(camera)
    }

    /// One that is not open: [`V4lCamera::grab`] opens it when it comes, as one that was unplugged.
    pub fn closed(settings: CameraSettings) -> Self {
        Self {
            settings,
            stream: None,
            retry_at: Timestamp::default(),
            pause: REOPEN_PAUSE.0,
            lost: None,
            unknown_clock_told: false,
            told: None,
            sleep: Sleep::until_now(Clocks::now),
        }
    }

    /// Bytes that a frame of it has at most, for the pool; while it is closed, those of the largest format in its size.
    pub fn frame_bytes_max(&self) -> usize {
        let most = self.settings.width as usize * self.settings.height as usize * BYTES_PER_PIXEL_MAX;
        self.stream.as_ref().map_or(most, |stream| stream.buffer_bytes)
    }

    /// Waits for the next frame, at most `timeout`, and copies it into `frame`. Damaged and short ones bring no
    /// bytes. While the camera is away this is where it is opened again.
    pub fn grab(&mut self, frame: &mut Frame, timeout: Duration) -> Grab {
        let until = Timestamp::now().after(timeout);
        match self.stream.is_some() {
            true => self.grab_open(frame, until),
            false => self.reopen(until),
        }
    }

    fn reopen(&mut self, until: Timestamp) -> Grab {
        let now = Timestamp::now();
        if now < self.retry_at {
            std::thread::sleep(between(now, self.retry_at.min(until)));
            return Grab::TimedOut;
        }
        match Stream::open(&self.settings) {
            Ok(stream) => self.stream = Some(stream),
            Err(error) => {
                self.tell(&error);
                return self.lose(error.trouble());
            }
        }
        Grab::TimedOut
    }

    /// Says why the camera does not come back: once, until something else is in the way.
    fn tell(&mut self, error: &CameraError) {
        let problem = error.to_string();
        if self.told.as_ref() != Some(&problem) {
            tracing::warn!("cannot be opened: {problem}");
            self.told = Some(problem);
        }
    }

    fn back_off(&mut self) {
        self.retry_at = Timestamp::now().after(self.pause);
        self.pause = (2 * self.pause).min(REOPEN_PAUSE.1);
    }

    fn grab_open(&mut self, frame: &mut Frame, until: Timestamp) -> Grab {
        let Some(stream) = self.stream.as_mut() else { return Grab::TimedOut };
        let taken = match stream.next(until) {
            Ok(Some(taken)) => taken,
            Ok(None) if Timestamp::now() < stream.quiet_until => return Grab::TimedOut,
            Ok(None) => return self.lose(Trouble::Stalled),
            Err(error) => return self.lose(trouble(&error)),
        };
        // After the buffer was taken, so that none of before a suspend gets a stamp of after it. The camera may have lost
        // its power and its controls, and what waits in the driver may be of before.
        let clocks = Clocks::now();
        if self.sleep.look(clocks).is_some() {
            return self.lose(Trouble::Suspended);
        }
        let now = clocks.cell;
        stream.quiet_until = now.after(stall_after(&self.settings));
        if self.lost.take().is_some() {
            self.pause = REOPEN_PAUSE.0;
            self.told = None;
            // The frame that proved it is old by the time anyone hears of it: the next one counts.
            return match stream.give_back(taken.buffer) {
                Ok(()) => Grab::Back,
                Err(error) => self.lose(trouble(&error)),
            };
        }
        let (stamp, mark) = stamp(&taken.buffer, &self.sleep, stream.began, now);
        if mark == TimestampMark::HandedOver {
            if !std::mem::replace(&mut self.unknown_clock_told, true) {
                let device = self.settings.device.display();
                tracing::warn!(%device, "time stamps are of an unknown clock; the time of dequeue is taken instead");
            }
            if taken.condition == Condition::Good && stream.backlog.is_of_unknown_age() {
                stream.intake.skip(&taken);
                return match stream.give_back(taken.buffer) {
                    Ok(()) => Grab::TimedOut,
                    Err(error) => self.lose(trouble(&error)),
                };
            }
        }
        let grab = Grab::Frame { condition: taken.condition, skipped: taken.skipped };
        (frame.timestamp, frame.mark) = (stamp, mark);
        match stream.copy(taken, &self.settings, frame) {
            Ok(()) => grab,
            // The frame is copied and good; the next grab will find out what is wrong with the camera.
            Err(error) => {
                tracing::debug!(%error, "buffer not taken back");
                grab
            }
        }
    }

    /// Closes the camera; until there are frames again the cell hears of it once a reason: a cable that was pulled and
    /// goes into a port without bandwidth is no longer unplugged.
    fn lose(&mut self, trouble: Trouble) -> Grab {
        if let Some(stream) = self.stream.take() {
            stream.buffers.stop(&stream.device);
        }
        self.back_off();
        match self.lost.replace(trouble) == Some(trouble) {
            true => Grab::TimedOut,
            false => Grab::Lost(trouble),
        }
    }
}

impl Drop for V4lCamera {
    fn drop(&mut self) {
        if let Some(stream) = self.stream.take() {
            stream.buffers.stop(&stream.device);
        }
    }
}

fn stall_after(settings: &CameraSettings) -> Duration {
    STALL_AFTER.max(4 * settings.period())
}

fn between(from: Timestamp, to: Timestamp) -> Duration {
    Duration::from_nanos(to.ns_since(from))
}

impl Stream {
    fn open(asked: &CameraSettings) -> Result<Self, CameraError> {
        let error = |step| move |reason| CameraError::of(&asked.device, asked, step, reason);
        let device = Device::open(&asked.device).map_err(error("open"))?;
        let identity = device.identity().map_err(error("ask who it is"))?;
        if !identity.captures {
            let reason = format!("{} ({}) delivers no pictures here", identity.card, identity.driver);
            return Err(CameraError::NotACamera { device: asked.device.clone(), reason });
        }
        let taken = configure(&device, asked)?;
        set_controls(&device, asked)?;
        let width = taken.width as usize;
        let rows = format::rows(asked.format, width, taken.height as usize, taken.bytes_per_line as usize);
        let encoding = format::encoding(asked, &taken);
        let buffers = Buffers::start(&device, BUFFERS).map_err(error("start the stream"))?;
        let quiet_until = Timestamp::now().after(FIRST_FRAME_WITHIN.max(10 * asked.period()));
        let buffer_bytes = rows.map_or(taken.size_image as usize, |rows| rows.row_bytes * rows.rows);
        let intake = Intake::default();
        let backlog = Backlog::new(buffers.count());
        let began = Timestamp::now();
        Ok(Stream { buffers, device, intake, rows, encoding, buffer_bytes, began, backlog, quiet_until })
    }

    /// The next buffer; `None` where none came until `until`, or the camera has been quiet for too long.
    fn next(&mut self, until: Timestamp) -> io::Result<Option<Taken<Filled>>> {
        if !self.intake.is_full() {
            let timeout = between(Timestamp::now(), until.min(self.quiet_until));
            match self.device.wait(timeout)? {
                Readiness::Quiet => {
                    self.backlog.none_waits();
                    return Ok(None);
                }
                Readiness::Filled => {}
                Readiness::Broken => {
                    // The error number tells an unplugged camera from a broken stream.
                    return match self.buffers.dequeue(&self.device) {
                        Err(error) => Err(error),
                        Ok(_) => Err(io::Error::from_raw_os_error(libc::EIO)),
                    };
                }
            }
            self.drain()?;
        }
        Ok(self.intake.take())
    }

    fn drain(&mut self) -> io::Result<()> {
        // Twice around at most: a camera that fills faster than this empties must not hold the thread.
        for _ in 0..2 * self.buffers.count() {
            let Some(filled) = self.buffers.dequeue(&self.device)? else {
                self.backlog.none_waits();
                break;
            };
            self.backlog.one_taken();
            let condition = intake::condition(filled.error, self.buffers.bytes(&filled), self.rows);
            let step = self.intake.offer(filled, condition);
            if let Some(skipped) = step.skipped {
                self.buffers.queue(&self.device, skipped)?;
            }
            if step.full {
                break;
            }
        }
        Ok(())
    }

    /// The one copy of the pixels; then the buffer is the driver's again.
    fn copy(&mut self, taken: Taken<Filled>, asked: &CameraSettings, frame: &mut Frame) -> io::Result<()> {
        let bytes = self.buffers.bytes(&taken.buffer);
        frame.format = asked.format;
        frame.width = asked.width as usize;
        frame.height = asked.height as usize;
        frame.stride_bytes = self.rows.map_or(0, |rows| rows.row_bytes);
        frame.encoding = self.encoding;
        frame.sequence = taken.buffer.sequence;
        match (taken.condition, self.rows) {
            (Condition::Good, Some(rows)) => rows.copy(bytes, &mut frame.bytes),
            (Condition::Good, None) => {
                frame.bytes.clear();
                frame.bytes.extend_from_slice(bytes);
            }
            _ => frame.bytes.clear(),
        }
        self.give_back(taken.buffer)
    }

    fn give_back(&mut self, buffer: Filled) -> io::Result<()> {
        self.buffers.queue(&self.device, buffer)
    }
}

/// When the light was seen, and what moment of the exposure that is, in a stream that `began` then. However old a frame
/// is, it is not older than its stream: a stamp of long ago is the true one of a frame that waited while the process
/// stood still, and must not make it young.
fn stamp(filled: &Filled, sleep: &Sleep, began: Timestamp, now: Timestamp) -> (Timestamp, TimestampMark) {
    let of_its_clock =
        |stamp: &Timestamp| began.since(*stamp) <= STAMP_OFF_NS_MAX && stamp.since(now) <= STAMP_OFF_NS_MAX;
    match filled.monotonic_ns.map(|ns| sleep.cell_time(ns)).filter(of_its_clock) {
        Some(stamp) if filled.start_of_exposure => (stamp, TimestampMark::StartOfExposure),
        Some(stamp) => (stamp, TimestampMark::EndOfFrame),
        None => (now, TimestampMark::HandedOver),
    }
}

fn configure(device: &Device, asked: &CameraSettings) -> Result<DriverFormat, CameraError> {
    let error = |step| move |reason| CameraError::of(&asked.device, asked, step, reason);
    let code = format::code(asked.format);
    let not_offered = |taken| CameraError::NotOffered {
        device: asked.device.clone(),
        asked: in_words(asked),
        taken,
        offered: format::in_words(&format::offered(device)),
    };
    let taken = match device.set_format(code, asked.width, asked.height) {
        // Most drivers take the nearest they have; some have none.
        Err(reason) if reason.raw_os_error() == Some(libc::EINVAL) => Err(not_offered("nothing".to_owned())),
        result => result.map_err(error("set the format")),
    }?;
    let rate = device.set_rate(asked.rate_hz).map_err(error("set the frame rate"))?;
    format::check_taken(asked, &taken, rate).map_err(not_offered)?;
    Ok(taken)
}

fn set_controls(device: &Device, asked: &CameraSettings) -> Result<(), CameraError> {
    if asked.controls.is_empty() {
        return Ok(());
    }
    let fault = |fault| CameraError::Control { device: asked.device.clone(), fault };
    let plan = controls::plan(&device.controls(), &asked.controls).map_err(fault)?;
    controls::apply(
        &plan,
        |control| device.control(control.id),
        |control, value| device.set_value(control, value),
        |control| device.value(control),
    )
    .map_err(fault)
}

#[cfg(test)]
mod tests;
