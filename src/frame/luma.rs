//! Reading the luma of single pixels and between pixels, with format and stride looked up once.

use super::{ColourEncoding, Frame, PixelFormat, colour};
use crate::level::Level;

/// Places of a line that are read together; lines have whole blocks of them.
const BLOCK: usize = 16;
/// Up to here places are told in 32 bits, 16 of them for the share of a pixel.
const FIXED_PX_MAX: usize = 1 << 15;

/// The luma of one frame, for measuring edges: format, stride and colour conversion are looked up once, so that
/// a sample between four pixels takes a few nanoseconds.
#[derive(Clone, Copy)]
pub struct LumaView<'a> {
    bytes: &'a [u8],
    width: usize,
    height: usize,
    stride: usize,
    reading: Reading,
    level: Level,
}

#[derive(Clone, Copy)]
enum Reading {
    /// Red, green, blue or the reverse, by the weights in the order of the bytes.
    Weighted([i32; 3]),
    /// Every `step` bytes a luma value of full range.
    Plain { step: usize },
    /// Every `step` bytes a Y value of limited range.
    Limited { step: usize, ycbcr: colour::Ycbcr },
    /// Luma that needs chroma as well: YUYV where `interleaved`, else NV12.
    Ycbcr { interleaved: bool, ycbcr: colour::Ycbcr },
}

impl<'a> LumaView<'a> {
    /// A view of this frame; `None` for MJPEG and for an empty or short picture.
    pub fn new(frame: &'a Frame) -> Option<Self> {
        Self::with_encoding(frame, frame.encoding)
    }

    /// A view that reads YUYV and NV12 by this encoding whatever the frame says.
    pub fn with_encoding(frame: &'a Frame, encoding: ColourEncoding) -> Option<Self> {
        let (w, h) = (frame.width, frame.height);
        if w == 0 || h == 0 || frame.format == PixelFormat::Mjpeg || frame.bytes.len() < frame.bytes_needed()
        {
            return None;
        }
        let [r, g, b] = colour::LUMA_WEIGHTS;
        let ycbcr = colour::Ycbcr::new(encoding);
        let reading = match frame.format {
            PixelFormat::Rgb => Reading::Weighted([r, g, b]),
            PixelFormat::Bgr => Reading::Weighted([b, g, r]),
            PixelFormat::Grey => Reading::Plain { step: 1 },
            _ => {
                let interleaved = frame.format == PixelFormat::Yuyv;
                let step = if interleaved { 2 } else { 1 };
                if ycbcr.l_u != 0 || ycbcr.l_v != 0 {
                    Reading::Ycbcr { interleaved, ycbcr }
                } else if ycbcr.y_offset == 0 {
                    Reading::Plain { step }
                } else {
                    Reading::Limited { step, ycbcr }
                }
            }
        };
        Some(Self {
            bytes: &frame.bytes,
            width: w,
            height: h,
            stride: frame.stride_bytes,
            reading,
            level: Level::detect(),
        })
    }

    /// Picture width in pixels.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Picture height in pixels.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Luma of a pixel; coordinates beyond the picture take its border.
    #[inline]
    pub fn at(&self, x: usize, y: usize) -> u8 {
        let (x, y) = (x.min(self.width - 1), y.min(self.height - 1));
        let row = y * self.stride;
        match self.reading {
            Reading::Weighted(w) => {
                let p = &self.bytes[row + 3 * x..row + 3 * x + 3];
                let sum = i32::from(p[0]) * w[0] + i32::from(p[1]) * w[1] + i32::from(p[2]) * w[2];
                ((sum + (1 << (colour::LUMA_SHIFT - 1))) >> colour::LUMA_SHIFT) as u8
            }
            Reading::Plain { step } => self.bytes[row + step * x],
            Reading::Limited { step, ycbcr } => ycbcr.luma(self.bytes[row + step * x], 128, 128),
            Reading::Ycbcr { interleaved: true, ycbcr } => {
                let chroma = row + 2 * (x & !1);
                ycbcr.luma(self.bytes[row + 2 * x], self.bytes[chroma + 1], self.bytes[chroma + 3])
            }
            Reading::Ycbcr { interleaved: false, ycbcr } => {
                let chroma = (self.height + y / 2) * self.stride + (x & !1);
                ycbcr.luma(self.bytes[row + x], self.bytes[chroma], self.bytes[chroma + 1])
            }
        }
    }

    /// Luma of `out.len()` pixels from (x, y) on, to the right or, where `down`, downwards.
    ///
    /// # Panics
    /// Where they leave the picture.
    #[inline]
    pub fn read_line(&self, x: usize, y: usize, down: bool, out: &mut [u8]) {
        self.each_of_line(x, y, down, out.len(), |k, luma| out[k] = luma);
    }

    /// Gives luma of `count` pixels from (x, y) on, to the right or, where `down`, downwards, each with its number.
    ///
    /// # Panics
    /// Where they leave the picture.
    #[inline(always)]
    pub fn each_of_line(
        &self,
        x: usize,
        y: usize,
        down: bool,
        count: usize,
        mut each: impl FnMut(usize, u8),
    ) {
        let (dx, dy) = if down { (0, 1) } else { (1, 0) };
        assert!(
            x + dx * count <= self.width + (1 - dx) && y + dy * count <= self.height + (1 - dy),
            "line in picture"
        );
        if let Reading::Weighted(w) = self.reading {
            let step = if down { self.stride } else { 3 };
            let begin = y * self.stride + 3 * x;
            let bytes = &self.bytes[begin..begin + (count.max(1) - 1) * step + 3];
            for k in 0..count {
                let p = &bytes[k * step..k * step + 3];
                let sum = i32::from(p[0]) * w[0] + i32::from(p[1]) * w[1] + i32::from(p[2]) * w[2];
                each(k, ((sum + (1 << (colour::LUMA_SHIFT - 1))) >> colour::LUMA_SHIFT) as u8);
            }
        } else if let Reading::Plain { step: bytes } = self.reading {
            let begin = y * self.stride + bytes * x;
            let step = if down { self.stride } else { bytes };
            let bytes = &self.bytes[begin..begin + (count.max(1) - 1) * step + 1];
            for k in 0..count {
                each(k, bytes[k * step]);
            }
        } else {
            for k in 0..count {
                each(k, self.at(x + dx * k, y + dy * k));
            }
        }
    }

    /// Luma between the four nearest pixels, bilinear, not rounded; pixel centres are at whole numbers. Beyond the
    /// picture its border goes on; a NaN coordinate counts as 0. Places in grey pictures are rounded to 1/256 pixel.
    #[inline]
    pub fn sample(&self, x: f32, y: f32) -> f32 {
        let mut value = [[0.0; BLOCK]];
        self.read_lines(&[[x.into(), y.into()]], [0.0; 2], &mut value, 1);
        value[0][0]
    }

    /// Reads [`LumaView::sample`] at `count` places along each of some lines side by side: the first at `from`, the others
    /// `step` apart. What stands behind them in a line is any number then.
    ///
    /// # Panics
    /// Where `count` is more than `LEN`, which is a multiple of 16.
    #[inline]
    pub fn read_lines<const LEN: usize>(
        &self,
        from: &[[f64; 2]],
        step: [f64; 2],
        lines: &mut [[f32; LEN]],
        count: usize,
    ) {
        const { assert!(LEN.is_multiple_of(BLOCK), "lines of whole blocks") };
        assert!(count <= LEN, "{count} places in a line of {LEN}");
        match self.reading {
            Reading::Weighted(w) => self.read_one_by_one(from, step, lines, count, |x, y| {
                let p = y * self.stride + 3 * x;
                let p = &self.bytes[p..p + 3];
                (i32::from(p[0]) * w[0] + i32::from(p[1]) * w[1] + i32::from(p[2]) * w[2]) as f32
                    * (1.0 / (1 << colour::LUMA_SHIFT) as f32)
            }),
            Reading::Plain { step: 1 } if from.iter().all(|from| self.is_line_inside(*from, step, count)) => {
                self.read_inside(from, step, lines, count)
            }
            Reading::Plain { step: bytes } => self.read_one_by_one(from, step, lines, count, |x, y| {
                f32::from(self.bytes[y * self.stride + bytes * x])
            }),
            Reading::Limited { step: bytes, .. } => self.read_one_by_one(from, step, lines, count, |x, y| {
                // Black is 16 and white 235, as in `Ycbcr`.
                let luma = f32::from(self.bytes[y * self.stride + bytes * x]);
                ((luma - 16.0) * (255.0 / 219.0)).clamp(0.0, 255.0)
            }),
            Reading::Ycbcr { .. } => {
                self.read_one_by_one(from, step, lines, count, |x, y| f32::from(self.at(x, y)))
            }
        }
    }

    /// Whether a line has all four pixels around each of its places.
    fn is_line_inside(&self, from: [f64; 2], step: [f64; 2], count: usize) -> bool {
        let [width, height] = [self.width, self.height].map(|px| px.min(FIXED_PX_MAX) as f64);
        let inside = |p: [f64; 2]| p[0] >= 0.0 && p[1] >= 0.0 && p[0] < width - 1.0 && p[1] < height - 1.0;
        let last = count.saturating_sub(1) as f64;
        inside(from) && inside([from[0] + step[0] * last, from[1] + step[1] * last])
    }

    /// [`LumaView::read_lines`] of a grey picture, all inside; places are rounded to 1/256 pixel.
    fn read_inside<const LEN: usize>(
        &self,
        from: &[[f64; 2]],
        step: [f64; 2],
        lines: &mut [[f32; LEN]],
        count: usize,
    ) {
        match self.level {
            // SAFETY: `Level::detect` names only what the machine has.
            #[cfg(target_arch = "x86_64")]
            Level::Avx512 => unsafe { self.read_blocks_avx512(from, step, lines, count) },
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            Level::Avx2 => unsafe { self.read_blocks_avx2(from, step, lines, count) },
            _ => self.read_blocks(from, step, lines, count),
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,bmi1,bmi2")]
    fn read_blocks_avx512<const LEN: usize>(
        &self,
        from: &[[f64; 2]],
        step: [f64; 2],
        lines: &mut [[f32; LEN]],
        count: usize,
    ) {
        self.read_blocks(from, step, lines, count);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,bmi1,bmi2")]
    fn read_blocks_avx2<const LEN: usize>(
        &self,
        from: &[[f64; 2]],
        step: [f64; 2],
        lines: &mut [[f32; LEN]],
        count: usize,
    ) {
        self.read_blocks(from, step, lines, count);
    }

    /// Of each line first where all bytes are, then all bytes, then all places are worked out side by side.
    #[inline(always)]
    fn read_blocks<const LEN: usize>(
        &self,
        from: &[[f64; 2]],
        step: [f64; 2],
        lines: &mut [[f32; LEN]],
        count: usize,
    ) {
        let fixed = |v: f64| (v * 65536.0) as i32;
        let (stride, [dx, dy]) = (self.stride as i32, step.map(fixed));
        // All of a block, also where the lines end before.
        let whole = count.next_multiple_of(BLOCK);
        let (mut at, mut upper, mut lower) = ([0i32; LEN], [0u16; LEN], [0u16; LEN]);
        for (line, from) in lines.iter_mut().zip(from) {
            let [x, y] = from.map(fixed);
            let x = |i: usize| x.wrapping_add(dx.wrapping_mul(i as i32));
            let y = |i: usize| y.wrapping_add(dy.wrapping_mul(i as i32));
            for (i, at) in at[..whole].iter_mut().enumerate() {
                *at = (y(i) >> 16).wrapping_mul(stride).wrapping_add(x(i) >> 16);
            }
            for (i, at) in at[..count].iter().enumerate() {
                let at = *at as usize;
                let two = |row: &[u8]| row.first_chunk().map_or(0, |two| u16::from_le_bytes(*two));
                (upper[i], lower[i]) = (two(&self.bytes[at..]), two(&self.bytes[at + self.stride..]));
            }
            for (i, level) in line[..whole].iter_mut().enumerate() {
                let (right, below) = (x(i) >> 8 & 0xff, y(i) >> 8 & 0xff);
                let row = |two: u16| {
                    let (a, b) = (i32::from(two & 0xff), i32::from(two >> 8));
                    (a << 8) + right * (b - a)
                };
                let (upper, lower) = (row(upper[i]), row(lower[i]));
                *level = ((upper << 8) + below * (lower - upper)) as f32 * (1.0 / 65536.0);
            }
        }
    }

    #[inline(always)]
    fn read_one_by_one<const LEN: usize>(
        &self,
        from: &[[f64; 2]],
        step: [f64; 2],
        lines: &mut [[f32; LEN]],
        count: usize,
        level: impl Fn(usize, usize) -> f32,
    ) {
        let last = [(self.width - 1) as f32, (self.height - 1) as f32];
        // On the last column or row the share of the neighbour before is 0 instead of that of one beyond.
        let (x_max, y_max) = (self.width.saturating_sub(2), self.height.saturating_sub(2));
        let (right, below) = (usize::from(self.width > 1), usize::from(self.height > 1));
        for (line, from) in lines.iter_mut().zip(from) {
            for (i, to) in line[..count].iter_mut().enumerate() {
                let x = ((from[0] + step[0] * i as f64) as f32).max(0.0).min(last[0]);
                let y = ((from[1] + step[1] * i as f64) as f32).max(0.0).min(last[1]);
                let (x0, y0) = ((x as u32 as usize).min(x_max), (y as u32 as usize).min(y_max));
                let (fx, fy) = (x - x0 as f32, y - y0 as f32);
                let (a, b) = (level(x0, y0), level(x0 + right, y0));
                let (c, d) = (level(x0, y0 + below), level(x0 + right, y0 + below));
                let (upper, lower) = (a + fx * (b - a), c + fx * (d - c));
                *to = upper + fy * (lower - upper);
            }
        }
    }

    /// [`LumaView::sample`] at `N` places, `step` apart, the first at `from`; places are rounded to 1/256 pixel, RGB
    /// and grey bytes not to whole levels.
    #[inline(always)]
    pub fn profile<const N: usize>(&self, from: [f32; 2], step: [f32; 2]) -> [f32; N] {
        const { assert!(N > 0, "a profile of no places") };
        let last = [0, 1].map(|axis: usize| from[axis] + (N - 1) as f32 * step[axis]);
        let [width, height] = [self.width, self.height].map(|px| px.min(FIXED_PX_MAX) as f32);
        let inside = |p: [f32; 2]| p[0] >= 1.0 && p[1] >= 1.0 && p[0] < width - 2.0 && p[1] < height - 2.0;
        // Eight bytes from any of the places on are bytes of the picture.
        let whole = self.width >= 8 && self.height > 2 && inside(from) && inside(last);
        match self.reading {
            Reading::Weighted(weights) if whole => {
                let light = |pixel: u32| {
                    let channel = |c: usize| (pixel >> (8 * c) & 255) as i32 * weights[c];
                    channel(0) + channel(1) + channel(2)
                };
                self.profile_inside(from, step, 3, colour::LUMA_SHIFT, |eight| {
                    [light(eight as u32), light((eight >> 24) as u32)]
                })
            }
            Reading::Plain { step: 1 } if whole => self
                .profile_inside(from, step, 1, 0, |eight| [(eight & 255) as i32, (eight >> 8 & 255) as i32]),
            _ => self.profile_by_samples(from, step),
        }
    }

    /// [`LumaView::profile`] of any picture, anywhere.
    #[inline(never)]
    fn profile_by_samples<const N: usize>(&self, from: [f32; 2], step: [f32; 2]) -> [f32; N] {
        let mut values = [0.0; N];
        for (i, value) in values.iter_mut().enumerate() {
            let [x, y] = [0, 1].map(|axis: usize| from[axis] + i as f32 * step[axis]);
            *value = self.sample(x, y);
        }
        values
    }

    /// All places inside. `pair` makes the luma of two neighbours, times `1 << shift`, from eight bytes. First all bytes
    /// are read, then the places are worked out side by side.
    #[inline(always)]
    fn profile_inside<const N: usize>(
        &self,
        from: [f32; 2],
        step: [f32; 2],
        bytes_a_pixel: usize,
        shift: u32,
        pair: impl Fn(u64) -> [i32; 2],
    ) -> [f32; N] {
        let fixed = |v: f32| (v * 65536.0) as i32;
        let ([mut x, mut y], [dx, dy]) = (from.map(fixed), step.map(fixed));
        let [mut upper, mut lower] = [[0u64; N]; 2];
        let [mut right, mut below] = [[0; N]; 2];
        for i in 0..N {
            let at = (y >> 16) as usize * self.stride + bytes_a_pixel * (x >> 16) as usize;
            let eight =
                |at: usize| self.bytes[at..].first_chunk().map_or(0, |bytes| u64::from_le_bytes(*bytes));
            (upper[i], lower[i]) = (eight(at), eight(at + self.stride));
            (right[i], below[i]) = (x >> 8 & 0xff, y >> 8 & 0xff);
            (x, y) = (x + dx, y + dy);
        }
        let mut values = [0.0; N];
        for i in 0..N {
            let row = |eight: u64| {
                let [a, b] = pair(eight);
                (a * 256 + right[i] * (b - a)) as f32
            };
            let (upper, lower) = (row(upper[i]), row(lower[i]));
            let level = upper + below[i] as f32 * (1.0 / 256.0) * (lower - upper);
            values[i] = level * (1.0 / (1u64 << (8 + shift)) as f32);
        }
        values
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    #[test]
    fn lines_of_grey_pictures_are_the_same_with_all_instructions() {
        let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(3);
        let (w, h) = (40, 30);
        let bytes: Vec<u8> = (0..w * h).map(|_| random.random_range(0..=255)).collect();
        let grey = |x: usize, y: usize| f64::from(bytes[y * w + x]);
        let format = PixelFormat::Grey;
        let frame =
            Frame { bytes: bytes.clone(), format, width: w, height: h, stride_bytes: w, ..Frame::default() };
        let view = LumaView::new(&frame).expect("a whole picture");
        for count in [1, 7, 16, 17, 45] {
            let [from, to] = [0, 1].map(|_| [random.random_range(1.0..37.9), random.random_range(1.0..27.9)]);
            let step = [0, 1].map(|axis: usize| (to[axis] - from[axis]) / 45.0);
            let beside = [from[0] + 0.7, from[1] - 0.6];
            let lines = Level::available().iter().map(|&level| {
                let mut lines = [[0.0; 48]; 2];
                LumaView { level, ..view }.read_lines(&[from, beside], step, &mut lines, count);
                lines.map(|line| line[..count].to_vec())
            });
            let lines: Vec<_> = lines.collect();
            assert!(lines.iter().all(|other| *other == lines[0]), "{count} places from {from:?} by {step:?}");
            for (from, line) in [from, beside].iter().zip(&lines[0]) {
                for (i, found) in line.iter().enumerate() {
                    let [x, y] = [0, 1].map(|axis: usize| from[axis] + step[axis] * i as f64);
                    let (x0, y0) = (x as usize, y as usize);
                    let (right, below) = (x.fract(), y.fract());
                    let row = |y: usize| grey(x0, y) * (1.0 - right) + grey(x0 + 1, y) * right;
                    let level = row(y0) * (1.0 - below) + row(y0 + 1) * below;
                    assert!((f64::from(*found) - level).abs() < 3.0, "{found} for {level}");
                }
            }
        }
    }

    #[test]
    fn a_profile_is_its_samples() {
        let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(2);
        let (w, h) = (40, 30);
        for format in [PixelFormat::Rgb, PixelFormat::Bgr, PixelFormat::Grey, PixelFormat::Yuyv] {
            let pixel = match format {
                PixelFormat::Grey => 1,
                PixelFormat::Yuyv => 2,
                _ => 3,
            };
            let bytes = (0..w * h * pixel).map(|_| random.random_range(0..=255)).collect();
            let frame =
                Frame { bytes, format, width: w, height: h, stride_bytes: w * pixel, ..Frame::default() };
            let view = LumaView::new(&frame).expect("a whole picture");
            for _ in 0..200 {
                let from = [random.random_range(-3.0..42.0), random.random_range(-3.0..32.0)];
                let step = [random.random_range(-1.0..1.0), random.random_range(-1.0..1.0f32)];
                let profile: [f32; 8] = view.profile(from, step);
                for (i, value) in profile.into_iter().enumerate() {
                    let sample = view.sample(from[0] + i as f32 * step[0], from[1] + i as f32 * step[1]);
                    assert!((value - sample).abs() < 3.0, "{value} for {sample}, {format:?}");
                }
            }
        }
    }
}
