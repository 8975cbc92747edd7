//! Baseline JPEG as webcams send it, decoded without allocating: one scan, 8 bits, Y alone or with Cb and Cr at
//! whole or half size (ITU-T T.81). All else is [`Fault::Unsupported`].

use super::bits::{Bits, Data, Room};
use super::block::zigzag;
use super::huffman::{Class, Huffman};
use super::idct::Kernel;
use super::rows::Rows;
use super::tables::STANDARD_TABLES;
use super::{block, idct, planes};
use crate::time::Timestamp;

/// Why a picture was not decoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Fault {
    /// A JPEG of another kind; another decoder may know it.
    Unsupported,
    /// No decoder can.
    Damaged(&'static str),
    /// Another size than was set up: width, height.
    Size(usize, usize),
    /// Time was over.
    Late,
}

/// One component of the picture.
#[derive(Clone, Copy, Debug, Default)]
struct Component {
    id: u8,
    /// Blocks across and down in a unit.
    across: usize,
    down: usize,
    quantization: usize,
    dc: usize,
    ac: usize,
}

/// All memory for pictures of one size.
#[derive(Clone, Debug)]
pub(super) struct Baseline {
    width: usize,
    height: usize,
    /// Y, Cb, Cr; rows as long as the units are wide.
    samples: [Vec<u8>; 3],
    strides: [usize; 3],
    standard: Box<[Huffman; 4]>,
    /// Tables of the picture: DC 0, AC 0, DC 1, AC 1.
    tables: Box<[Huffman; 4]>,
    own: [bool; 4],
    scales: [[f32; 64]; 4],
    /// Which of them this picture has given.
    is_quantized: [bool; 4],
    components: [Component; 3],
    count: usize,
    restart_interval: usize,
    room: Room,
    rows: [Rows; 3],
    mixed: Vec<u16>,
    wide: [Vec<u8>; 2],
}

impl Baseline {
    pub(super) fn new(width: usize, height: usize) -> Self {
        let (w, h) = (width.next_multiple_of(16), height.next_multiple_of(16));
        let empty = || Box::new([(); 4].map(|()| Huffman::empty()));
        let mut decoder = Self {
            width,
            height,
            samples: [(); 3].map(|()| vec![0; w * h]),
            strides: [0; 3],
            standard: empty(),
            tables: empty(),
            own: [false; 4],
            scales: [[0.0; 64]; 4],
            is_quantized: [false; 4],
            components: [Component::default(); 3],
            count: 0,
            restart_interval: 0,
            // With three components at most six in a unit of 16 pixels.
            room: Room::new(w / 16 * 6),
            rows: [w / 8 * 2, w / 8, w / 8].map(Rows::new),
            mixed: vec![0; w / 2 + 2],
            wide: [vec![0; w], vec![0; w]],
        };
        let read = decoder.read_tables(&STANDARD_TABLES);
        assert!(read.is_ok(), "the standard's tables are good");
        std::mem::swap(&mut decoder.standard, &mut decoder.tables);
        decoder
    }

    /// Reads a whole picture to Y, Cb and Cr samples; only to Y where `luma_only`. It is asked how late it is with every row
    /// of units.
    #[inline(always)]
    pub(super) fn read(
        &mut self,
        kernel: impl Kernel,
        jpeg: &[u8],
        luma_only: bool,
        end: Option<Timestamp>,
    ) -> Result<(), Fault> {
        self.own = [false; 4];
        self.is_quantized = [false; 4];
        self.restart_interval = 0;
        self.count = 0;
        let mut at = 2;
        loop {
            let Some(&[marker, kind, high, low]) = jpeg.get(at..).and_then(|rest| rest.first_chunk()) else {
                return Err(Fault::Damaged("no picture data"));
            };
            if (marker, kind) == (0xff, 0xff) {
                at += 1;
                continue;
            }
            let length = usize::from(u16::from_be_bytes([high, low]));
            let Some(segment) = jpeg.get(at + 4..at + 2 + length).filter(|_| marker == 0xff && length >= 2)
            else {
                return Err(Fault::Damaged("bad segment"));
            };
            at += 2 + length;
            match kind {
                0xc4 => self.read_tables(&jpeg[at - length - 2..at])?,
                0xdb => self.read_quantization(segment)?,
                0xc0 | 0xc1 => self.read_frame(segment)?,
                0xc2..=0xcf => return Err(Fault::Unsupported),
                0xdd => {
                    let interval = segment.first_chunk().ok_or(Fault::Damaged("bad restart interval"))?;
                    self.restart_interval = usize::from(u16::from_be_bytes(*interval));
                }
                // Adobe's marker may mean other colours.
                0xee if segment.starts_with(b"Adobe") => return Err(Fault::Unsupported),
                0xda => {
                    self.read_scan_header(segment)?;
                    return match luma_only {
                        true => self.read_scan::<true>(kernel, &jpeg[at..], end),
                        false => self.read_scan::<false>(kernel, &jpeg[at..], end),
                    };
                }
                _ => {}
            }
        }
    }

    /// Huffman tables: whole segments with their markers.
    fn read_tables(&mut self, mut segments: &[u8]) -> Result<(), Fault> {
        const BAD: Fault = Fault::Damaged("bad Huffman table");
        while let Some((&[_, _, high, low], rest)) = segments.split_first_chunk() {
            let length = usize::from(u16::from_be_bytes([high, low]));
            let (mut tables, behind) = rest.split_at_checked(length.saturating_sub(2)).ok_or(BAD)?;
            segments = behind;
            while let Some((&[kind], rest)) = tables.split_first_chunk() {
                let (counts, rest) = rest.split_first_chunk::<16>().ok_or(BAD)?;
                let symbols: usize = counts.iter().map(|&n| usize::from(n)).sum();
                let (symbols, rest) =
                    rest.split_at_checked(symbols).filter(|s| s.0.len() <= 256).ok_or(BAD)?;
                tables = rest;
                let (place, class) = match kind {
                    0x00 => (0, Class::Dc),
                    0x10 => (1, Class::Ac),
                    0x01 => (2, Class::Dc),
                    0x11 => (3, Class::Ac),
                    _ => return Err(Fault::Unsupported),
                };
                self.tables[place].read(class, counts, symbols)?;
                self.own[place] = true;
            }
        }
        Ok(())
    }

    fn read_quantization(&mut self, mut segment: &[u8]) -> Result<(), Fault> {
        while let Some((&[kind], rest)) = segment.split_first_chunk() {
            let (wide, id) = (kind >> 4 != 0, usize::from(kind & 15));
            let bytes = if wide { 128 } else { 64 };
            let (values, rest) =
                rest.split_at_checked(bytes).ok_or(Fault::Damaged("bad quantization table"))?;
            segment = rest;
            let scales = self.scales.get_mut(id).ok_or(Fault::Damaged("bad quantization table"))?;
            for k in 0..64 {
                let value = if wide {
                    f32::from(u16::from_be_bytes([values[2 * k], values[2 * k + 1]]))
                } else {
                    f32::from(values[k])
                };
                let place = zigzag(k);
                scales[place] = value * idct::scale(place);
            }
            self.is_quantized[id] = true;
        }
        Ok(())
    }

    fn read_frame(&mut self, segment: &[u8]) -> Result<(), Fault> {
        let Some((&[precision, h1, h0, w1, w0, count], parts)) = segment.split_first_chunk() else {
            return Err(Fault::Damaged("bad frame header"));
        };
        let (height, width) =
            (usize::from(u16::from_be_bytes([h1, h0])), usize::from(u16::from_be_bytes([w1, w0])));
        if (width, height) != (self.width, self.height) {
            return Err(Fault::Size(width, height));
        }
        let (parts, rest) = parts.as_chunks::<3>();
        if precision != 8 || !matches!(count, 1 | 3) || self.count != 0 {
            return Err(Fault::Unsupported);
        }
        if parts.len() != usize::from(count) || !rest.is_empty() {
            return Err(Fault::Damaged("bad frame header"));
        }
        self.count = parts.len();
        for (component, &[id, sampling, quantization]) in self.components.iter_mut().zip(parts) {
            let (across, down) = (usize::from(sampling >> 4), usize::from(sampling & 15));
            let quantization = usize::from(quantization) & 3;
            *component = Component { id, across, down, quantization, ..Component::default() };
        }
        if self.count == 1 {
            // The only component is read block by block whatever its sampling.
            (self.components[0].across, self.components[0].down) = (1, 1);
        }
        let sampling = self.components.map(|c| (c.across, c.down));
        let luma = matches!(sampling[0], (1, 1) | (2, 1) | (2, 2));
        if !luma || self.count == 3 && sampling[1..] != [(1, 1); 2] || self.components[0].id == b'R' {
            return Err(Fault::Unsupported);
        }
        Ok(())
    }

    fn read_scan_header(&mut self, segment: &[u8]) -> Result<(), Fault> {
        let Some((&count, rest)) = segment.split_first() else {
            return Err(Fault::Damaged("bad scan header"));
        };
        let (parts, _) = rest.as_chunks::<2>();
        if self.count == 0 {
            return Err(Fault::Damaged("picture data without a frame header"));
        }
        if usize::from(count) != self.count || parts.len() < self.count {
            return Err(Fault::Unsupported);
        }
        for (component, &[id, tables]) in self.components[..self.count].iter_mut().zip(parts) {
            if id != component.id || tables & 0xee != 0 {
                return Err(Fault::Unsupported);
            }
            component.dc = 2 * usize::from(tables >> 4);
            component.ac = 2 * usize::from(tables & 1) + 1;
        }
        if self.components[..self.count].iter().any(|c| !self.is_quantized[c.quantization]) {
            return Err(Fault::Damaged("no quantization table"));
        }
        Ok(())
    }

    #[inline(always)]
    fn read_scan<const LUMA_ONLY: bool>(
        &mut self,
        kernel: impl Kernel,
        data: &[u8],
        end: Option<Timestamp>,
    ) -> Result<(), Fault> {
        let (across, down) = (self.components[0].across, self.components[0].down);
        let (units, unit_rows) = (self.width.div_ceil(8 * across), self.height.div_ceil(8 * down));
        self.strides = std::array::from_fn(|c| units * 8 * self.components[c].across);
        let blocks = self.components[..self.count].iter().map(|c| c.across * c.down).sum::<usize>();
        let mut data = Data::new(data, &mut self.room, units * blocks);
        let mut bits = Bits::new(&data);
        let tables = self.components.map(|component| {
            let table =
                |place: usize| if self.own[place] { &self.tables[place] } else { &self.standard[place] };
            (table(component.dc), table(component.ac))
        });
        let scales = self.components.map(|component| &self.scales[component.quantization]);
        let mut last_dc = [0i32; 3];
        self.rows.iter_mut().for_each(Rows::clear);
        let mut until_restart = self.restart_interval;
        for uy in 0..unit_rows {
            if end.is_some_and(Timestamp::is_past) {
                return Err(Fault::Late);
            }
            data.ready(&mut bits);
            for ux in 0..units {
                if self.restart_interval != 0 {
                    if until_restart == 0 {
                        data.restart(&mut bits)?;
                        last_dc = [0; 3];
                        until_restart = self.restart_interval;
                    }
                    until_restart -= 1;
                }
                for c in 0..self.count {
                    if LUMA_ONLY && c != 0 {
                        block::skip(&mut bits, data.bytes(), tables[c])?;
                        continue;
                    }
                    let (across, down) = if c == 0 { (across, down) } else { (1, 1) };
                    for by in 0..down {
                        for bx in 0..across {
                            let i = (by * units + ux) * across + bx;
                            let block = &mut self.rows[c].blocks[i];
                            let (difference, last) = block::read(&mut bits, data.bytes(), tables[c], block)?;
                            last_dc[c] = last_dc[c].wrapping_add(difference);
                            self.rows[c].set(i, last_dc[c] as f32 * scales[c][0], last != 0);
                        }
                    }
                }
            }
            data.check(&bits)?;
            let wanted = if LUMA_ONLY { 1 } else { self.count };
            for (c, scales) in scales.into_iter().enumerate().take(wanted) {
                let (across, down) = if c == 0 { (across, down) } else { (1, 1) };
                let (columns, stride) = (units * across, self.strides[c]);
                for by in 0..down {
                    let out = &mut self.samples[c][8 * (uy * down + by) * stride..];
                    self.rows[c].transform(kernel, (by * columns, columns), scales, out, stride);
                }
            }
        }
        Ok(())
    }

    /// Writes the luma of the picture that was read; where the samples are nothing else, they are given away for the
    /// old ones.
    pub(super) fn write_luma(&mut self, out: &mut Vec<u8>) {
        if self.strides[0] == self.width && self.samples[0].len() == out.len() {
            std::mem::swap(&mut self.samples[0], out);
            return;
        }
        for (out, y) in out.chunks_exact_mut(self.width).zip(self.samples[0].chunks(self.strides[0])) {
            out.copy_from_slice(&y[..self.width]);
        }
    }

    /// Writes the picture that was read as R, G, B. It is asked how late it is with every row of units.
    #[inline(always)]
    pub(super) fn write_rgb(&mut self, out: &mut [u8], end: Option<Timestamp>) -> Result<(), Fault> {
        let (across, down) = (self.components[0].across, self.components[0].down);
        let (columns, rows) = (self.width.div_ceil(across), self.height.div_ceil(down));
        for (y, out) in out.chunks_exact_mut(3 * self.width).enumerate() {
            if y.is_multiple_of(8 * down) && end.is_some_and(Timestamp::is_past) {
                return Err(Fault::Late);
            }
            let luma = &self.samples[0][y * self.strides[0]..][..self.width];
            if self.count == 1 {
                for (rgb, &y) in out.as_chunks_mut::<3>().0.iter_mut().zip(luma) {
                    *rgb = [y; 3];
                }
                continue;
            }
            let near = y / down;
            let far = match (down, y % 2) {
                (1, _) => near,
                (_, 0) => near.saturating_sub(1),
                _ => (near + 1).min(rows - 1),
            };
            let [_, u, v] = [0, 1, 2].map(|c| {
                [near, far].map(|row| {
                    &self.samples[c][(row * self.strides[c]).min(self.samples[c].len() - columns)..]
                        [..columns]
                })
            });
            if across == 1 {
                planes::rgb_row(luma, u[0], v[0], out);
            } else {
                for (wide, [near, far]) in self.wide.iter_mut().zip([u, v]) {
                    planes::widened_row(near, far, &mut self.mixed, wide);
                }
                planes::rgb_row(luma, &self.wide[0], &self.wide[1], out);
            }
        }
        Ok(())
    }
}
