//! One V4L2 device node: what it offers, its format, its controls.
//!
//! Takes a path; gives safe calls that say what the driver said; decides nothing. Owns the descriptor; the
//! buffers are in [`super::buffers`].
//!
//! The crate `v4l` opens and closes the node, lists formats, sizes and rates, and sets the format and the rate. The
//! calls of `uapi` do what it does not:
//! - Who it is: its `query_caps` panics where the camera's name is cut in the middle of a character.
//! - Colours: its `Format` has no Y'CbCr encoding, and it panics at a colour space that it does not know.
//! - Controls: its `query_controls` panics at types it does not know, its `control` reads no bitmasks and integer menus.
//! - Streaming: its stream takes no buffer after a time-out, hides a buffer's error mark, and panics when dropped after
//!   the camera was pulled out.

use std::io;
use std::os::fd::BorrowedFd;
use std::os::unix::ffi::OsStrExt;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use ::v4l::device::Handle;
use ::v4l::format::{FieldOrder, Format, FourCC};
use ::v4l::fraction::Fraction;
use ::v4l::frameinterval::FrameIntervalEnum;
use ::v4l::framesize::FrameSizeEnum;
use ::v4l::parameters::Capabilities;
use ::v4l::video::Capture;
use ::v4l::video::capture::Parameters;
use rustix::event::{PollFd, PollFlags};
use rustix::io::FdFlags;
use serde::Serialize;

use super::uapi;

/// Most entries that are read from any of the driver's lists; none of a real camera is as long.
const ENTRIES_MAX: u32 = 512;

/// Who a device says it is.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Identity {
    /// Name of the kernel's driver.
    pub driver: String,
    /// Name of the camera.
    pub card: String,
    /// Where it is plugged in, as the driver names it.
    pub bus: String,
    /// It takes pictures, and this node delivers them through mapped buffers.
    #[serde(skip)]
    pub captures: bool,
}

/// A picture size that a camera offers, or a range of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Size {
    /// Width and height in pixels.
    One(u32, u32),
    /// Everything from the smallest to the largest, in steps.
    Range {
        /// Smallest width and height.
        min: (u32, u32),
        /// Largest width and height.
        max: (u32, u32),
        /// Steps of width and height, at least 1.
        step: (u32, u32),
    },
}

/// A frame rate that a camera offers, or a range of them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Rate {
    /// Frames a second.
    One(f64),
    /// Everything from the slowest to the fastest.
    Range(f64, f64),
}

/// The kind of a control.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ControlKind {
    /// A number of 32 bits.
    Integer,
    /// A number of 64 bits.
    Integer64,
    /// On or off.
    Boolean,
    /// One of several names.
    Menu,
    /// One of several numbers.
    IntegerMenu,
    /// A set of bits.
    Bitmask,
    /// Something to press.
    Button,
    /// Anything that has no single number as its value.
    Other,
}

/// A control as the driver describes it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ControlInfo {
    /// The kernel's number of it.
    #[serde(skip)]
    pub id: u32,
    /// Its name as `cell.toml` writes it: small letters, digits and underscores.
    pub name: String,
    /// Its kind.
    pub kind: ControlKind,
    /// Smallest value.
    pub minimum: i64,
    /// Largest value.
    pub maximum: i64,
    /// Step, at least 1.
    pub step: u64,
    /// Value after plugging in.
    pub default: i64,
    /// Entries of a menu: index and name (the number, for integer menus).
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub menu: Vec<(i64, String)>,
    /// It cannot be set.
    pub read_only: bool,
    /// Something else decides it now, an automatic for instance.
    pub inactive: bool,
}

/// The format that the driver has set.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DriverFormat {
    /// Four-character code.
    pub code: [u8; 4],
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Bytes from row to row, 0 for compressed formats.
    pub bytes_per_line: u32,
    /// Bytes that a buffer holds at most.
    pub size_image: u32,
    /// `v4l2_colorspace`.
    pub colorspace: u32,
    /// `v4l2_ycbcr_encoding`.
    pub ycbcr_encoding: u32,
    /// `v4l2_quantization`.
    pub quantization: u32,
}

/// What [`Device::wait`] saw.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Readiness {
    /// A filled buffer waits.
    Filled,
    /// Nothing came in time.
    Quiet,
    /// The driver signals an error: unplugged, or the stream broke down.
    Broken,
}

/// An open device node.
pub struct Device {
    node: ::v4l::Device,
    handle: Arc<Handle>,
}

impl std::fmt::Debug for Device {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Device").field("fd", &self.handle.fd()).finish()
    }
}

/// A call of the crate, again where a signal interrupted it. The crate panics at what it does not know: that is
/// [`io::ErrorKind::InvalidData`] here.
fn asked<T>(call: impl Fn() -> io::Result<T>) -> io::Result<T> {
    loop {
        match catch_unwind(AssertUnwindSafe(&call)) {
            Ok(Err(error)) if error.kind() == io::ErrorKind::Interrupted => {}
            Ok(result) => return result,
            Err(_) => return Err(io::ErrorKind::InvalidData.into()),
        }
    }
}

impl Device {
    /// Opens a node for reading and writing, without ever blocking in it.
    ///
    /// # Errors
    /// What the system says.
    pub fn open(path: &Path) -> io::Result<Self> {
        if path.as_os_str().as_bytes().contains(&0) {
            return Err(io::Error::from_raw_os_error(libc::EINVAL));
        }
        let node = ::v4l::Device::with_path(path)?;
        let device = Device { handle: node.handle(), node };
        rustix::io::fcntl_setfd(device.fd(), FdFlags::CLOEXEC)?;
        Ok(device)
    }

    pub(super) fn fd(&self) -> BorrowedFd<'_> {
        // SAFETY: the handle closes the descriptor when it is dropped, which the borrow of `self` prevents.
        unsafe { BorrowedFd::borrow_raw(self.handle.fd()) }
    }

    /// Who it is.
    ///
    /// # Errors
    /// ENOTTY where it is no V4L2 device.
    pub fn identity(&self) -> io::Result<Identity> {
        let mut caps = uapi::Capability::default();
        uapi::query_capability(self.fd(), &mut caps)?;
        let has_own = caps.capabilities & uapi::CAP_DEVICE_CAPS != 0;
        let own = if has_own { caps.device_caps } else { caps.capabilities };
        let needed = uapi::CAP_VIDEO_CAPTURE | uapi::CAP_STREAMING;
        Ok(Identity {
            driver: uapi::text(&caps.driver),
            card: uapi::text(&caps.card),
            bus: uapi::text(&caps.bus_info),
            captures: own & needed == needed,
        })
    }

    /// The four-character codes of the formats it offers.
    pub fn formats(&self) -> Vec<[u8; 4]> {
        let formats = asked(|| self.node.enum_formats()).unwrap_or_default();
        formats.into_iter().map(|format| format.fourcc.repr).collect()
    }

    /// The sizes it offers in a format.
    pub fn sizes(&self, code: [u8; 4]) -> Vec<Size> {
        let sizes = asked(|| self.node.enum_framesizes(FourCC { repr: code })).unwrap_or_default();
        let size = |size| match size {
            FrameSizeEnum::Discrete(one) => Size::One(one.width, one.height),
            FrameSizeEnum::Stepwise(range) => Size::Range {
                min: (range.min_width, range.min_height),
                max: (range.max_width, range.max_height),
                step: (range.step_width.max(1), range.step_height.max(1)),
            },
        };
        sizes.into_iter().map(|entry| size(entry.size)).collect()
    }

    /// The rates it offers in a format and size.
    pub fn rates(&self, code: [u8; 4], width: u32, height: u32) -> Vec<Rate> {
        let fourcc = FourCC { repr: code };
        let intervals = asked(|| self.node.enum_frameintervals(fourcc, width, height)).unwrap_or_default();
        let hertz =
            |interval: Fraction| f64::from(interval.denominator) / f64::from(interval.numerator.max(1));
        let rate = |interval| match interval {
            FrameIntervalEnum::Discrete(one) => Rate::One(hertz(one)),
            FrameIntervalEnum::Stepwise(range) => Rate::Range(hertz(range.max), hertz(range.min)),
        };
        intervals.into_iter().map(|entry| rate(entry.interval)).collect()
    }

    /// Sets the format nearest to this one and says what it is now.
    ///
    /// # Errors
    /// EBUSY where another program streams.
    pub fn set_format(&self, code: [u8; 4], width: u32, height: u32) -> io::Result<DriverFormat> {
        let format = Format {
            field_order: FieldOrder::Progressive,
            ..Format::new(width, height, FourCC { repr: code })
        };
        match asked(|| self.node.set_format(&format)) {
            // It is set; only the description of it is beyond the crate.
            Err(error) if error.kind() == io::ErrorKind::InvalidData => {}
            result => drop(result?),
        }
        // Once more, for the colours.
        let mut format = uapi::Format::capture();
        uapi::get_format(self.fd(), &mut format)?;
        let pix = format.pix;
        // Drivers from before these fields existed leave the mark out: then they are not filled in either.
        let extended = pix.private == uapi::PIX_FMT_PRIV_MAGIC;
        Ok(DriverFormat {
            code: pix.pixel_format,
            width: pix.width,
            height: pix.height,
            bytes_per_line: pix.bytes_per_line,
            size_image: pix.size_image,
            colorspace: pix.colorspace,
            ycbcr_encoding: if extended { pix.ycbcr_encoding } else { 0 },
            quantization: if extended { pix.quantization } else { 0 },
        })
    }

    /// Sets the frame rate nearest to this one and says what it is now; `None` where the device has no rate to set.
    ///
    /// # Errors
    /// What the driver says.
    pub fn set_rate(&self, rate_hz: f64) -> io::Result<Option<f64>> {
        let interval = if rate_hz.fract() == 0.0 {
            Fraction::new(1, rate_hz as u32)
        } else {
            Fraction::new(1_000_000, (rate_hz * 1e6).round() as u32)
        };
        let now = match asked(|| self.node.set_params(&Parameters::new(interval))) {
            Err(error) if error.raw_os_error() == Some(libc::ENOTTY) => return Ok(None),
            result => result?,
        };
        let interval = now.interval;
        if !now.capabilities.contains(Capabilities::TIME_PER_FRAME) || interval.numerator == 0 {
            return Ok(None);
        }
        Ok(Some(f64::from(interval.denominator) / f64::from(interval.numerator)))
    }

    /// Its controls with their menus, headings and disabled ones left out.
    pub fn controls(&self) -> Vec<ControlInfo> {
        let mut controls = Vec::new();
        let mut id = 0;
        for _ in 0..ENTRIES_MAX {
            let mut query = uapi::QueryControl::with_id(id | uapi::CTRL_FLAG_NEXT_CTRL);
            if uapi::query_control(self.fd(), &mut query).is_err() || query.id <= id {
                break;
            }
            id = query.id;
            const HEADING: u32 = 6;
            if query.kind != HEADING && query.flags & uapi::CTRL_FLAG_DISABLED == 0 {
                controls.push(self.describe(&query));
            }
        }
        controls
    }

    fn describe(&self, query: &uapi::QueryControl) -> ControlInfo {
        let kind = match query.kind {
            1 => ControlKind::Integer,
            2 => ControlKind::Boolean,
            3 => ControlKind::Menu,
            4 => ControlKind::Button,
            5 => ControlKind::Integer64,
            8 => ControlKind::Bitmask,
            9 => ControlKind::IntegerMenu,
            _ => ControlKind::Other,
        };
        let kind = if query.elems > 1 || query.nr_of_dims > 0 { ControlKind::Other } else { kind };
        let mut menu = Vec::new();
        if matches!(kind, ControlKind::Menu | ControlKind::IntegerMenu) {
            let entries = query.minimum.max(0)..=query.maximum.min(ENTRIES_MAX.into());
            for index in entries {
                // Drivers list a range and refuse what is missing in it.
                let mut entry = uapi::QueryMenu { id: query.id, index: index as u32, ..Default::default() };
                if uapi::query_menu(self.fd(), &mut entry).is_ok() {
                    let name = entry.name;
                    let number = i64::from_ne_bytes(std::array::from_fn(|i| name[i]));
                    let is_menu = kind == ControlKind::Menu;
                    menu.push((index, if is_menu { uapi::text(&name) } else { number.to_string() }));
                }
            }
        }
        ControlInfo {
            id: query.id,
            name: control_name(&uapi::text(&query.name)),
            kind,
            minimum: query.minimum,
            maximum: query.maximum,
            step: query.step.max(1),
            default: query.default_value,
            menu,
            read_only: query.flags & uapi::CTRL_FLAG_READ_ONLY != 0,
            inactive: query.flags & uapi::CTRL_FLAG_INACTIVE != 0,
        }
    }

    /// A control as it is now: another control may have made it active or inactive.
    ///
    /// # Errors
    /// What the driver says.
    pub fn control(&self, id: u32) -> io::Result<ControlInfo> {
        let mut query = uapi::QueryControl::with_id(id);
        uapi::query_control(self.fd(), &mut query)?;
        Ok(self.describe(&query))
    }

    /// The value of a control; `None` for those that have none.
    ///
    /// # Errors
    /// What the driver says.
    pub fn value(&self, control: &ControlInfo) -> io::Result<Option<i64>> {
        let mut query = uapi::QueryControl::with_id(control.id);
        uapi::query_control(self.fd(), &mut query)?;
        let mute = matches!(control.kind, ControlKind::Button | ControlKind::Other);
        if mute || query.flags & uapi::CTRL_FLAG_WRITE_ONLY != 0 {
            return Ok(None);
        }
        uapi::get_control(self.fd(), control.id, control.kind == ControlKind::Integer64).map(Some)
    }

    /// Sets a control that has a number as its value.
    ///
    /// # Errors
    /// What the driver says; EINVAL for kinds without a number.
    pub fn set_value(&self, control: &ControlInfo, value: i64) -> io::Result<()> {
        if control.kind == ControlKind::Other {
            return Err(io::Error::from_raw_os_error(libc::EINVAL));
        }
        uapi::set_control(self.fd(), control.id, control.kind == ControlKind::Integer64, value)
    }

    /// Waits for a filled buffer.
    ///
    /// # Errors
    /// What the system says; an interrupted wait is [`Readiness::Quiet`].
    pub fn wait(&self, timeout: Duration) -> io::Result<Readiness> {
        let mut fds = [PollFd::from_borrowed_fd(self.fd(), PollFlags::IN)];
        let timeout = rustix::time::Timespec {
            tv_sec: timeout.as_secs().min(3600) as _,
            tv_nsec: timeout.subsec_nanos().into(),
        };
        match rustix::event::poll(&mut fds, Some(&timeout)) {
            Ok(0) | Err(rustix::io::Errno::INTR) => return Ok(Readiness::Quiet),
            result => result?,
        };
        let seen = fds[0].revents();
        // A device that was pulled out raises errors at once and for ever; a filled buffer may still wait then.
        Ok(if seen.contains(PollFlags::IN) && !seen.contains(PollFlags::HUP) {
            Readiness::Filled
        } else {
            Readiness::Broken
        })
    }
}

/// The name of a control as `cell.toml` writes it, as `v4l2-ctl` does: `Exposure Time, Absolute` →
/// `exposure_time_absolute`.
pub fn control_name(written: &str) -> String {
    let mut name = String::with_capacity(written.len());
    for c in written.chars() {
        if c.is_ascii_alphanumeric() {
            name.push(c.to_ascii_lowercase());
        } else if !name.is_empty() && !name.ends_with('_') {
            name.push('_');
        }
    }
    name.trim_end_matches('_').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::Cell;

    #[test]
    fn an_interrupted_call_is_made_again_and_a_panic_is_an_error() {
        let calls = Cell::new(0);
        let interrupted_once = || match calls.replace(calls.get() + 1) {
            0 => Err(io::ErrorKind::Interrupted.into()),
            _ => Ok(7),
        };
        assert_eq!(asked(interrupted_once).expect("the second answer"), 7);
        let panics = || -> io::Result<()> { panic!("Invalid colorspace") };
        assert_eq!(asked(panics).expect_err("a panic").kind(), io::ErrorKind::InvalidData);
    }

    #[test]
    fn a_path_that_no_system_can_open_is_an_error() {
        let path = Path::new(std::ffi::OsStr::from_bytes(b"/dev/video\0"));
        assert_eq!(Device::open(path).expect_err("no path").raw_os_error(), Some(libc::EINVAL));
    }
}
