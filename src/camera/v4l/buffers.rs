//! The driver's buffers: mapped once, filled by the driver, lent, and queued again.
//!
//! Takes an open, configured device; gives filled buffers and their bytes; owns the mapped memory. The rest of the
//! cameras' `unsafe` that is not in `uapi` is here.

use std::ffi::c_void;
use std::io;
use std::ptr::NonNull;

use rustix::mm::{MapFlags, ProtFlags};

use super::device::Device;
use super::uapi;

/// A filled buffer, taken from the driver: ours until it is queued again. Neither copied nor cloned, so that
/// nobody reads a buffer that the driver writes.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Filled {
    index: u32,
    /// Bytes that are in it.
    pub bytes_used: usize,
    /// The driver marked it as damaged.
    pub error: bool,
    /// Its stamp in ns, where the driver stamps with CLOCK_MONOTONIC.
    pub monotonic_ns: Option<i64>,
    /// The stamp is of the start of the exposure, not of the end of the frame.
    pub start_of_exposure: bool,
    /// The driver's frame counter.
    pub sequence: u32,
}

impl Filled {
    /// A buffer that no driver filled, for tests of what is made of its stamp.
    #[cfg(test)]
    pub(super) fn stamped(monotonic_ns: Option<i64>, start_of_exposure: bool) -> Self {
        Filled { monotonic_ns, start_of_exposure, ..Filled::default() }
    }
}

/// The driver's buffers, mapped. Streams while it lives.
#[derive(Debug)]
pub struct Buffers {
    maps: Vec<Map>,
}

#[derive(Debug)]
struct Map {
    at: NonNull<c_void>,
    length: usize,
}

// SAFETY: a mapping belongs to the process, not to the thread that made it.
unsafe impl Send for Map {}

impl Drop for Map {
    fn drop(&mut self) {
        // SAFETY: this range was mapped by `Buffers::start` and nothing borrows it any more.
        let _ = unsafe { rustix::mm::munmap(self.at.as_ptr(), self.length) };
    }
}

impl Buffers {
    /// Makes, maps and queues `count` buffers, and starts the stream.
    ///
    /// # Errors
    /// ENOSPC where the USB bus has no room for the stream, EBUSY where another program has the camera.
    pub fn start(device: &Device, count: u32) -> io::Result<Self> {
        let mut asked = uapi::RequestBuffers {
            count,
            kind: uapi::BUF_TYPE_VIDEO_CAPTURE,
            memory: uapi::MEMORY_MMAP,
            ..Default::default()
        };
        uapi::request_buffers(device.fd(), &mut asked)?;
        let mut buffers = Buffers { maps: Vec::with_capacity(asked.count as usize) };
        for index in 0..asked.count {
            let mut buffer = uapi::Buffer::mapped(index);
            uapi::query_buffer(device.fd(), &mut buffer)?;
            buffers.maps.push(map(device, &buffer)?);
        }
        for index in 0..asked.count {
            buffers.queue(device, Filled { index, ..Filled::default() })?;
        }
        uapi::stream_on(device.fd(), &mut { uapi::BUF_TYPE_VIDEO_CAPTURE })?;
        Ok(buffers)
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.maps.len()
    }

    /// Gives a buffer back to the driver.
    ///
    /// # Errors
    /// ENODEV where the camera was pulled out.
    pub fn queue(&mut self, device: &Device, filled: Filled) -> io::Result<()> {
        uapi::queue_buffer(device.fd(), &mut uapi::Buffer::mapped(filled.index))
    }

    /// Takes the next filled buffer; `None` where there is none.
    ///
    /// # Errors
    /// ENODEV where the camera was pulled out.
    pub fn dequeue(&mut self, device: &Device) -> io::Result<Option<Filled>> {
        let mut buffer = uapi::Buffer::mapped(0);
        match uapi::dequeue_buffer(device.fd(), &mut buffer) {
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(None),
            result => result?,
        }
        let Some(map) = self.maps.get(buffer.index as usize) else {
            return Err(io::Error::from_raw_os_error(libc::EINVAL));
        };
        let monotonic = buffer.flags & uapi::BUF_FLAG_TIMESTAMP_MASK == uapi::BUF_FLAG_TIMESTAMP_MONOTONIC;
        let uapi_stamp = buffer.timestamp;
        let stamp_ns = uapi_stamp
            .tv_sec
            .saturating_mul(1_000_000_000)
            .saturating_add(uapi_stamp.tv_usec.saturating_mul(1000));
        Ok(Some(Filled {
            index: buffer.index,
            bytes_used: (buffer.bytes_used as usize).min(map.length),
            error: buffer.flags & uapi::BUF_FLAG_ERROR != 0,
            monotonic_ns: monotonic.then_some(stamp_ns),
            start_of_exposure: buffer.flags & uapi::BUF_FLAG_TSTAMP_SRC_MASK == uapi::BUF_FLAG_TSTAMP_SRC_SOE,
            sequence: buffer.sequence,
        }))
    }

    /// The bytes of a buffer that is not with the driver.
    ///
    /// # Panics
    /// Where `filled` is none of these buffers.
    pub fn bytes(&self, filled: &Filled) -> &[u8] {
        let map = &self.maps[filled.index as usize];
        // SAFETY: the length is cut at the mapping's, and the driver writes only into queued buffers: this one is
        // ours until `queue`, which takes `filled` away and cannot be called while these bytes are borrowed.
        unsafe { std::slice::from_raw_parts(map.at.as_ptr().cast::<u8>(), filled.bytes_used.min(map.length)) }
    }

    /// Ends the stream and gives the memory back; a camera that is gone has nothing to end.
    pub fn stop(self, device: &Device) {
        let _ = uapi::stream_off(device.fd(), &mut { uapi::BUF_TYPE_VIDEO_CAPTURE });
        drop(self.maps);
        let mut none = uapi::RequestBuffers {
            kind: uapi::BUF_TYPE_VIDEO_CAPTURE,
            memory: uapi::MEMORY_MMAP,
            ..Default::default()
        };
        let _ = uapi::request_buffers(device.fd(), &mut none);
    }
}

fn map(device: &Device, buffer: &uapi::Buffer) -> io::Result<Map> {
    let length = buffer.length as usize;
    // SAFETY: a new mapping at an address of the kernel's choice touches nothing that is there.
    let at = unsafe {
        rustix::mm::mmap(
            std::ptr::null_mut(),
            length,
            ProtFlags::READ | ProtFlags::WRITE,
            MapFlags::SHARED,
            device.fd(),
            buffer.offset & 0xffff_ffff,
        )?
    };
    let at = NonNull::new(at).ok_or_else(|| io::Error::from_raw_os_error(libc::ENOMEM))?;
    Ok(Map { at, length })
}
