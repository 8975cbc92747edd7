//! Baseline pictures written from chosen coefficients, and decoded: every sampling, size and restart interval.

use super::block::zigzag;
use super::tables::STANDARD_TABLES;
use super::{Decoder, Output};
use crate::frame::{Frame, PixelFormat};
use crate::level::Level;
use proptest::prelude::*;

/// Quantization of all components.
const QUANTIZATION: u8 = 3;

/// A picture as coefficients: blocks in the order of the scan, coefficients in zigzag order.
#[derive(Debug)]
struct Written {
    width: usize,
    height: usize,
    across: usize,
    down: usize,
    colour: bool,
    restart_interval: usize,
    blocks: Vec<[i32; 64]>,
}

/// Code of a symbol in a standard table (in the order of the file) and its length.
fn code(table: usize, symbol: u8) -> (u32, u32) {
    let mut segments = &STANDARD_TABLES[..];
    for _ in 0..table {
        segments = &segments[2 + usize::from(u16::from_be_bytes([segments[2], segments[3]]))..];
    }
    let (counts, symbols) = segments[5..].split_at(16);
    let (mut code, mut place) = (0, 0);
    for (length, &count) in (1..).zip(counts) {
        for _ in 0..count {
            if symbols[place] == symbol {
                return (code, length);
            }
            (code, place) = (code + 1, place + 1);
        }
        code <<= 1;
    }
    panic!("symbol {symbol} is not in table {table}");
}

/// Bits with stuffing.
#[derive(Default)]
struct Bytes {
    bytes: Vec<u8>,
    bits: Vec<bool>,
}

impl Bytes {
    fn push(&mut self, (value, length): (u32, u32)) {
        self.bits.extend((0..length).rev().map(|bit| value >> bit & 1 != 0));
    }

    /// A symbol and the value behind it.
    fn coefficient(&mut self, table: usize, run: u32, value: i32) {
        let size = 32 - value.unsigned_abs().leading_zeros();
        self.push(code(table, (run << 4 | size) as u8));
        let bits = if value < 0 { value - 1 } else { value };
        self.push((bits as u32, size));
    }

    fn block(&mut self, tables: usize, difference: i32, block: &[i32; 64]) {
        self.coefficient(tables, 0, difference);
        let mut run = 0;
        for &value in &block[1..] {
            if value == 0 {
                run += 1;
                continue;
            }
            while run > 15 {
                self.push(code(tables + 1, 0xf0));
                run -= 16;
            }
            self.coefficient(tables + 1, run, value);
            run = 0;
        }
        if run > 0 {
            self.push(code(tables + 1, 0));
        }
    }

    /// Fills the last byte with ones.
    fn flush(&mut self) {
        for bits in self.bits.chunks(8) {
            let byte = (0..8).fold(0, |byte, i| byte << 1 | u8::from(*bits.get(i).unwrap_or(&true)));
            self.bytes.push(byte);
            if byte == 0xff {
                self.bytes.push(0);
            }
        }
        self.bits.clear();
    }
}

impl Written {
    fn units(&self) -> (usize, usize) {
        (self.width.div_ceil(8 * self.across), self.height.div_ceil(8 * self.down))
    }

    /// Blocks of luma in a unit, and all.
    fn blocks_in_unit(&self) -> (usize, usize) {
        let luma = self.across * self.down;
        (luma, if self.colour { luma + 2 } else { luma })
    }

    /// Coefficient `k` of block `i` of the scan; they come again when there are no more.
    fn block(&self, i: usize) -> &[i32; 64] {
        &self.blocks[i % self.blocks.len()]
    }

    fn frame(&self) -> Frame {
        let count = if self.colour { 3 } else { 1 };
        let [h, w] = [self.height, self.width].map(|size| (size as u16).to_be_bytes());
        let mut out = Bytes::default();
        out.bytes.extend([0xff, 0xd8, 0xff, 0xdb, 0, 67, 0]);
        out.bytes.extend([QUANTIZATION; 64]);
        out.bytes.extend([0xff, 0xc0, 0, 8 + 3 * count, 8, h[0], h[1], w[0], w[1], count]);
        out.bytes.extend([1, (self.across << 4 | self.down) as u8, 0]);
        (2..=count).for_each(|id| out.bytes.extend([id, 0x11, 0]));
        out.bytes.extend([0xff, 0xdd, 0, 4]);
        out.bytes.extend((self.restart_interval as u16).to_be_bytes());
        out.bytes.extend([0xff, 0xda, 0, 6 + 2 * count, count, 1, 0x00]);
        (2..=count).for_each(|id| out.bytes.extend([id, 0x11]));
        out.bytes.extend([0, 63, 0]);
        let ((across, down), (luma, all)) = (self.units(), self.blocks_in_unit());
        let mut last = [0; 3];
        for unit in 0..across * down {
            if self.restart_interval != 0 && unit != 0 && unit % self.restart_interval == 0 {
                out.flush();
                out.bytes.extend([0xff, 0xd0 + (unit / self.restart_interval - 1) as u8 % 8]);
                last = [0; 3];
            }
            for b in 0..all {
                let c = (b + 1).saturating_sub(luma);
                let block = self.block(unit * all + b);
                out.block(if c == 0 { 0 } else { 2 }, block[0] - last[c], block);
                last[c] = block[0];
            }
        }
        out.flush();
        out.bytes.extend([0xff, 0xd9]);
        let (width, height) = (self.width, self.height);
        Frame { bytes: out.bytes, format: PixelFormat::Mjpeg, width, height, ..Frame::default() }
    }

    /// Luma by the definition (T.81, A.3.3).
    fn luma(&self) -> Vec<f64> {
        let ((across, _), (_, all)) = (self.units(), self.blocks_in_unit());
        let mut out = vec![0.0; self.width * self.height];
        for (i, out) in out.iter_mut().enumerate() {
            let (x, y) = (i % self.width, i / self.width);
            let unit = y / (8 * self.down) * across + x / (8 * self.across);
            let block = self.block(unit * all + y / 8 % self.down * self.across + x / 8 % self.across);
            let mut sum = 0.0;
            for (k, &value) in block.iter().enumerate().filter(|(_, value)| **value != 0) {
                let (u, v) = (zigzag(k) / 8, zigzag(k) % 8);
                let wave = |at: usize, k: usize| {
                    let c = if k == 0 { std::f64::consts::FRAC_1_SQRT_2 } else { 1.0 };
                    c * ((2 * (at % 8) + 1) as f64 * k as f64 * std::f64::consts::PI / 16.0).cos()
                };
                sum += f64::from(value * i32::from(QUANTIZATION)) * wave(x, u) * wave(y, v) / 4.0;
            }
            *out = (sum + 128.0).clamp(0.0, 255.0);
        }
        out
    }
}

prop_compose! {
    fn block()(
        first in -340..340i32, others in proptest::collection::vec((1usize..64, -1023..=1023i32, 0..10), 0..20),
        every in 0..12,
    ) -> [i32; 64] {
        let mut block = [i32::from(every == 0); 64];
        block[0] = first;
        others.into_iter().for_each(|(k, value, less)| block[k] = value >> less);
        block
    }
}

prop_compose! {
    fn written()(
        (width, height) in (1usize..70, 1usize..40), (across, down) in prop_oneof![Just((1, 1)), Just((2, 1)), Just((2, 2))],
        colour in any::<bool>(), restart_interval in 0usize..6, blocks in proptest::collection::vec(block(), 1..30),
    ) -> Written {
        let (across, down) = if colour { (across, down) } else { (1, 1) };
        Written { width, height, across, down, colour, restart_interval, blocks }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]

    #[test]
    fn written_pictures_decode_to_their_luma_on_all_instructions(written in written()) {
        let (frame, expected) = (written.frame(), written.luma());
        let mut first = None;
        for &level in Level::available() {
            let decode = |output| {
                let mut decoder = Decoder::with_level(output, written.width, written.height, level);
                decoder.run(&frame).expect("a good picture").bytes.clone()
            };
            let (grey, rgb) = (decode(Output::Grey), decode(Output::Rgb));
            for (i, (&got, want)) in grey.iter().zip(&expected).enumerate() {
                prop_assert!((f64::from(got) - want).abs() < 0.52, "{} {} at {}", got, want, i);
            }
            if !written.colour {
                prop_assert_eq!(&rgb, &grey.iter().flat_map(|&y| [y; 3]).collect::<Vec<_>>());
            }
            let first = first.get_or_insert_with(|| rgb.clone());
            prop_assert_eq!(first, &rgb, "{:?}", level);
        }
    }
}
