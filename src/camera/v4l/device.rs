//! One V4L2 device node: what it offers, its format, its controls.
//!
//! Takes a path; gives safe calls that say what the driver said; decides nothing. Owns the descriptor; the
//! buffers are in [`super::buffers`].

use std::io;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::path::Path;
use std::time::Duration;

use rustix::event::{PollFd, PollFlags};
use rustix::fs::{Mode, OFlags};
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
#[derive(Debug)]
pub struct Device {
    fd: OwnedFd,
}

impl Device {
    /// Opens a node for reading and writing, without ever blocking in it.
    ///
    /// # Errors
    /// What the system says.
    pub fn open(path: &Path) -> io::Result<Self> {
        let flags = OFlags::RDWR | OFlags::NONBLOCK | OFlags::CLOEXEC;
        Ok(Device { fd: rustix::fs::open(path, flags, Mode::empty())? })
    }

    pub(super) fn fd(&self) -> BorrowedFd<'_> {
        self.fd.as_fd()
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
        let entry = |index| {
            let kind = uapi::BUF_TYPE_VIDEO_CAPTURE;
            let mut entry = uapi::FormatDescription { index, kind, ..Default::default() };
            uapi::enumerate_format(self.fd(), &mut entry).ok().map(|()| entry.pixel_format)
        };
        (0..ENTRIES_MAX).map_while(entry).collect()
    }

    /// The sizes it offers in a format.
    pub fn sizes(&self, code: [u8; 4]) -> Vec<Size> {
        let entry = |index| {
            let mut entry = uapi::FrameSize { index, pixel_format: code, ..Default::default() };
            uapi::enumerate_size(self.fd(), &mut entry).ok()?;
            let [a, b, c, d, e, f] = entry.size;
            Some(match entry.kind {
                1 => Size::One(a, b),
                _ => Size::Range { min: (a, d), max: (b, e), step: (c.max(1), f.max(1)) },
            })
        };
        (0..ENTRIES_MAX).map_while(entry).collect()
    }

    /// The rates it offers in a format and size.
    pub fn rates(&self, code: [u8; 4], width: u32, height: u32) -> Vec<Rate> {
        let hertz =
            |interval: uapi::Fraction| f64::from(interval.denominator) / f64::from(interval.numerator.max(1));
        let entry = |index| {
            let mut entry =
                uapi::FrameInterval { index, pixel_format: code, width, height, ..Default::default() };
            uapi::enumerate_interval(self.fd(), &mut entry).ok()?;
            let [shortest, longest, _] = entry.interval;
            Some(match entry.kind {
                1 => Rate::One(hertz(shortest)),
                _ => Rate::Range(hertz(longest), hertz(shortest)),
            })
        };
        (0..ENTRIES_MAX).map_while(entry).collect()
    }

    /// Sets the format nearest to this one and says what it is now.
    ///
    /// # Errors
    /// EBUSY where another program streams.
    pub fn set_format(&self, code: [u8; 4], width: u32, height: u32) -> io::Result<DriverFormat> {
        let mut format = uapi::Format::capture(uapi::PixFormat {
            width,
            height,
            pixel_format: code,
            field: uapi::FIELD_NONE,
            private: uapi::PIX_FMT_PRIV_MAGIC,
            ..Default::default()
        });
        uapi::set_format(self.fd(), &mut format)?;
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
        let time_per_frame = if rate_hz.fract() == 0.0 {
            uapi::Fraction { numerator: 1, denominator: rate_hz as u32 }
        } else {
            uapi::Fraction { numerator: 10_000_000, denominator: (rate_hz * 1e7).round() as u32 }
        };
        let mut parameters = uapi::StreamParameters::capture(time_per_frame);
        match uapi::set_parameters(self.fd(), &mut parameters) {
            Err(error) if error.raw_os_error() == Some(libc::ENOTTY) => return Ok(None),
            result => result?,
        }
        let now = parameters.time_per_frame;
        if parameters.capability & uapi::CAP_TIMEPERFRAME == 0 || now.numerator == 0 {
            return Ok(None);
        }
        Ok(Some(f64::from(now.denominator) / f64::from(now.numerator)))
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
        let mut fds = [PollFd::new(&self.fd, PollFlags::IN)];
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
