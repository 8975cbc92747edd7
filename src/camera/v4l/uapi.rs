//! The part of the kernel's `linux/videodev2.h` that a capture camera needs and the crate `v4l` leaves out or does
//! unsafely (see [`super::device`]), and the calls on it.
//!
//! Takes and gives the kernel's own structures, filled with zeros where nothing is said; owns nothing. All
//! `unsafe` of the cameras is in here, in the mapping of [`super::buffers`] and at the descriptor that a device lends.
//! Sizes and request numbers are asserted at compile time against what a C compiler prints for that header on x86-64
//! and arm64: `printf("%#lx %zu", VIDIOC_QBUF, sizeof(struct v4l2_buffer))`.

use std::io;
use std::os::fd::{AsRawFd, BorrowedFd};

pub(super) const BUF_TYPE_VIDEO_CAPTURE: u32 = 1;
pub(super) const MEMORY_MMAP: u32 = 1;

pub(super) const CAP_VIDEO_CAPTURE: u32 = 0x1;
pub(super) const CAP_STREAMING: u32 = 0x0400_0000;
pub(super) const CAP_DEVICE_CAPS: u32 = 0x8000_0000;
pub(super) const PIX_FMT_PRIV_MAGIC: u32 = 0xfeed_cafe;

pub(super) const BUF_FLAG_ERROR: u32 = 0x40;
pub(super) const BUF_FLAG_TIMESTAMP_MASK: u32 = 0xe000;
pub(super) const BUF_FLAG_TIMESTAMP_MONOTONIC: u32 = 0x2000;
pub(super) const BUF_FLAG_TSTAMP_SRC_MASK: u32 = 0x7_0000;
pub(super) const BUF_FLAG_TSTAMP_SRC_SOE: u32 = 0x1_0000;

pub(super) const CTRL_FLAG_DISABLED: u32 = 0x1;
pub(super) const CTRL_FLAG_READ_ONLY: u32 = 0x4;
pub(super) const CTRL_FLAG_INACTIVE: u32 = 0x10;
pub(super) const CTRL_FLAG_WRITE_ONLY: u32 = 0x40;
pub(super) const CTRL_FLAG_NEXT_CTRL: u32 = 0x8000_0000;

#[repr(C)]
#[derive(Clone, Copy, Default)]
pub(super) struct Capability {
    pub(super) driver: [u8; 16],
    pub(super) card: [u8; 32],
    pub(super) bus_info: [u8; 32],
    pub(super) version: u32,
    pub(super) capabilities: u32,
    pub(super) device_caps: u32,
    pub(super) reserved: [u32; 3],
}

#[repr(C)]
#[derive(Clone, Copy, Default)]
pub(super) struct PixFormat {
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) pixel_format: [u8; 4],
    pub(super) field: u32,
    pub(super) bytes_per_line: u32,
    pub(super) size_image: u32,
    pub(super) colorspace: u32,
    pub(super) private: u32,
    pub(super) flags: u32,
    pub(super) ycbcr_encoding: u32,
    pub(super) quantization: u32,
    pub(super) transfer: u32,
}

/// `v4l2_format` with its union as the picture format of a camera; the kernel's union is aligned to 8.
#[repr(C, align(8))]
#[derive(Clone, Copy)]
pub(super) struct Format {
    pub(super) kind: u32,
    pad: u32,
    pub(super) pix: PixFormat,
    rest: [u8; 152],
}

impl Format {
    pub(super) fn capture() -> Self {
        Format { kind: BUF_TYPE_VIDEO_CAPTURE, pad: 0, pix: PixFormat::default(), rest: [0; 152] }
    }
}

#[repr(C)]
#[derive(Clone, Copy, Default)]
pub(super) struct RequestBuffers {
    pub(super) count: u32,
    pub(super) kind: u32,
    pub(super) memory: u32,
    pub(super) capabilities: u32,
    pub(super) flags: u32,
}

#[repr(C)]
#[derive(Clone, Copy)]
pub(super) struct Buffer {
    pub(super) index: u32,
    pub(super) kind: u32,
    pub(super) bytes_used: u32,
    pub(super) flags: u32,
    pub(super) field: u32,
    pub(super) timestamp: libc::timeval,
    timecode: [u32; 4],
    pub(super) sequence: u32,
    pub(super) memory: u32,
    /// The union `m`: for mapped memory the offset to map.
    pub(super) offset: libc::c_ulong,
    pub(super) length: u32,
    reserved: [u32; 2],
}

impl Buffer {
    pub(super) fn mapped(index: u32) -> Self {
        Buffer {
            index,
            kind: BUF_TYPE_VIDEO_CAPTURE,
            bytes_used: 0,
            flags: 0,
            field: 0,
            timestamp: libc::timeval { tv_sec: 0, tv_usec: 0 },
            timecode: [0; 4],
            sequence: 0,
            memory: MEMORY_MMAP,
            offset: 0,
            length: 0,
            reserved: [0; 2],
        }
    }
}

#[repr(C)]
#[derive(Clone, Copy)]
pub(super) struct QueryControl {
    pub(super) id: u32,
    pub(super) kind: u32,
    pub(super) name: [u8; 32],
    pub(super) minimum: i64,
    pub(super) maximum: i64,
    pub(super) step: u64,
    pub(super) default_value: i64,
    pub(super) flags: u32,
    pub(super) elem_size: u32,
    pub(super) elems: u32,
    pub(super) nr_of_dims: u32,
    dims: [u32; 4],
    reserved: [u32; 32],
}

impl QueryControl {
    pub(super) fn with_id(id: u32) -> Self {
        QueryControl {
            id,
            kind: 0,
            name: [0; 32],
            minimum: 0,
            maximum: 0,
            step: 0,
            default_value: 0,
            flags: 0,
            elem_size: 0,
            elems: 0,
            nr_of_dims: 0,
            dims: [0; 4],
            reserved: [0; 32],
        }
    }
}

/// `v4l2_querymenu`; the union as bytes: a name, or a number of 8 bytes for integer menus.
#[repr(C)]
#[derive(Clone, Copy, Default)]
pub(super) struct QueryMenu {
    pub(super) id: u32,
    pub(super) index: u32,
    pub(super) name: [u8; 32],
    pub(super) reserved: u32,
}

#[repr(C, packed)]
#[derive(Clone, Copy, Default)]
struct ExtControl {
    id: u32,
    size: u32,
    reserved: u32,
    value: [u8; 8],
}

#[repr(C)]
struct ExtControls {
    which: u32,
    count: u32,
    error_index: u32,
    request_fd: i32,
    reserved: u32,
    controls: *mut ExtControl,
}

/// The number of an ioctl: direction (1 write, 2 read), size of the argument, 'V', number.
const fn request(direction: u32, size: usize, number: u32) -> u32 {
    direction << 30 | (size as u32) << 16 | (b'V' as u32) << 8 | number
}

const QUERYCAP: u32 = request(2, size_of::<Capability>(), 0);
const G_FMT: u32 = request(3, size_of::<Format>(), 4);
const REQBUFS: u32 = request(3, size_of::<RequestBuffers>(), 8);
const QUERYBUF: u32 = request(3, size_of::<Buffer>(), 9);
const QBUF: u32 = request(3, size_of::<Buffer>(), 15);
const DQBUF: u32 = request(3, size_of::<Buffer>(), 17);
const STREAMON: u32 = request(1, 4, 18);
const STREAMOFF: u32 = request(1, 4, 19);
const QUERYMENU: u32 = request(3, size_of::<QueryMenu>(), 37);
const G_EXT_CTRLS: u32 = request(3, size_of::<ExtControls>(), 71);
const S_EXT_CTRLS: u32 = request(3, size_of::<ExtControls>(), 72);
const QUERY_EXT_CTRL: u32 = request(3, size_of::<QueryControl>(), 103);

#[cfg(target_pointer_width = "64")]
const _: () = {
    assert!(QUERYCAP == 0x8068_5600 && G_FMT == 0xc0d0_5604);
    assert!(REQBUFS == 0xc014_5608 && QUERYBUF == 0xc058_5609 && QBUF == 0xc058_560f && DQBUF == 0xc058_5611);
    assert!(STREAMON == 0x4004_5612 && STREAMOFF == 0x4004_5613);
    assert!(QUERYMENU == 0xc02c_5625 && G_EXT_CTRLS == 0xc020_5647 && S_EXT_CTRLS == 0xc020_5648);
    assert!(QUERY_EXT_CTRL == 0xc0e8_5667 && size_of::<ExtControl>() == 20);
    assert!(std::mem::offset_of!(Format, pix) == 8 && std::mem::offset_of!(Buffer, timestamp) == 24);
    assert!(std::mem::offset_of!(Buffer, sequence) == 56 && std::mem::offset_of!(Buffer, offset) == 64);
    assert!(
        std::mem::offset_of!(QueryControl, minimum) == 40 && std::mem::offset_of!(QueryControl, flags) == 72
    );
    assert!(std::mem::offset_of!(ExtControls, controls) == 24);
};

/// One ioctl, again where a signal interrupted it.
///
/// # Safety
/// `request` is one that reads and writes at most a `T`, and whatever pointers are in `argument` are good for
/// what the kernel does with them.
unsafe fn call<T>(fd: BorrowedFd<'_>, request: u32, argument: &mut T) -> io::Result<()> {
    loop {
        // SAFETY: the descriptor is open for as long as it is borrowed; the rest is the caller's promise.
        let result = unsafe { libc::ioctl(fd.as_raw_fd(), request as _, std::ptr::from_mut(argument)) };
        if result >= 0 {
            return Ok(());
        }
        let error = io::Error::last_os_error();
        if error.kind() != io::ErrorKind::Interrupted {
            return Err(error);
        }
    }
}

macro_rules! safe_calls {
    ($($(#[$doc:meta])* $name:ident($argument:ty) = $request:ident;)*) => {$(
        $(#[$doc])*
        pub(super) fn $name(fd: BorrowedFd<'_>, argument: &mut $argument) -> io::Result<()> {
            // SAFETY: the size of the argument is part of the request's number, and it holds no pointers.
            unsafe { call(fd, $request, argument) }
        }
    )*};
}

safe_calls! {
    /// Who the device is and what it can do.
    query_capability(Capability) = QUERYCAP;
    /// The format that is set.
    get_format(Format) = G_FMT;
    /// Makes or, with a count of 0, drops the buffers.
    request_buffers(RequestBuffers) = REQBUFS;
    /// Length and offset of the buffer of this index.
    query_buffer(Buffer) = QUERYBUF;
    /// Gives a buffer to the driver.
    queue_buffer(Buffer) = QBUF;
    /// Takes a filled buffer from the driver; EAGAIN where there is none.
    dequeue_buffer(Buffer) = DQBUF;
    /// Begins to stream.
    stream_on(u32) = STREAMON;
    /// Ends to stream; all buffers are the program's again.
    stream_off(u32) = STREAMOFF;
    /// A control by id, or the next one after it.
    query_control(QueryControl) = QUERY_EXT_CTRL;
    /// An entry of a menu.
    query_menu(QueryMenu) = QUERYMENU;
}

/// Reads a control; 64-bit ones with `wide`. Not for strings and compound controls: those need a payload.
pub(super) fn get_control(fd: BorrowedFd<'_>, id: u32, wide: bool) -> io::Result<i64> {
    let value = control_call(fd, G_EXT_CTRLS, id, [0; 8])?;
    Ok(if wide { i64::from_ne_bytes(value) } else { narrow(value).into() })
}

/// Writes a control; 64-bit ones with `wide`. Not for strings and compound controls: those need a payload.
pub(super) fn set_control(fd: BorrowedFd<'_>, id: u32, wide: bool, value: i64) -> io::Result<()> {
    let mut bytes = [0; 8];
    if wide {
        bytes = value.to_ne_bytes();
    } else {
        let value = i32::try_from(value).map_err(|_| io::Error::from_raw_os_error(libc::ERANGE))?;
        bytes[..4].copy_from_slice(&value.to_ne_bytes());
    }
    control_call(fd, S_EXT_CTRLS, id, bytes).map(drop)
}

fn narrow(value: [u8; 8]) -> i32 {
    let [a, b, c, d, ..] = value;
    i32::from_ne_bytes([a, b, c, d])
}

fn control_call(fd: BorrowedFd<'_>, request: u32, id: u32, value: [u8; 8]) -> io::Result<[u8; 8]> {
    let mut control = ExtControl { id, size: 0, reserved: 0, value };
    let mut controls = ExtControls {
        which: id & 0x0fff_0000,
        count: 1,
        error_index: 0,
        request_fd: 0,
        reserved: 0,
        controls: &raw mut control,
    };
    // SAFETY: `controls` points to one control that lives through the call. Callers ask only for controls without
    // payload, so the kernel takes no pointer out of `value`.
    unsafe { call(fd, request, &mut controls)? };
    Ok(control.value)
}

/// The text of a field that ends with its first zero byte.
pub(super) fn text(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|&b| b == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..end]).trim().to_owned()
}
