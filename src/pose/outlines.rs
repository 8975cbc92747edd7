//! Outlines of many pieces of wire, side by side.
//!
//! Does for up to [`LINES`] lines across wire what [`Profiler::across`] does for one, without a branch that depends on what
//! the picture shows, in whatever registers the machine has. It gives the same bits, on all levels.

use nalgebra::Vector2;

use super::section::{Profiler, SAMPLES_MAX, Section};
use crate::level::Level;
use crate::vision::whole::{byte, floor, nearest};

/// Lines that are looked at together: bytes of a 256-bit register.
pub(super) const LINES: usize = 32;
/// No sample.
const NONE: u8 = u8::MAX;

type Bytes = [u8; LINES];
type Numbers = [f64; LINES];

/// Workspace: lines across wire, and the grey values along them.
pub(super) struct Outlines {
    level: Level,
    count: usize,
    side: [usize; LINES],
    origin: [Numbers; 2],
    across: [Numbers; 2],
    half_width_px: Numbers,
    /// Row k: the k-th grey value of each line.
    samples: Box<[Bytes; SAMPLES_MAX]>,
    sections: [Option<Section>; LINES],
}

/// Where the grey values of each line are read, in rows or columns of the picture. All but the last two are whole numbers.
struct Reading {
    down: [bool; LINES],
    /// The row or column, and where in it the first sample lies.
    line: Numbers,
    first: Numbers,
    /// Samples on each side of the middle one.
    half: Numbers,
    /// How far from the middle one the peak may lie, and how far from that the floor.
    window: Numbers,
    span: Numbers,
    /// Where the wire's middle crosses the row or column.
    centre: Numbers,
    /// Pixels across the wire for one along the row or column; negative where these run against each other.
    cos: Numbers,
}

impl Outlines {
    pub(super) fn new(level: Level) -> Self {
        Self {
            level,
            count: 0,
            side: [0; LINES],
            origin: [[0.0; LINES]; 2],
            across: [[1.0; LINES]; 2],
            half_width_px: [1.0; LINES],
            samples: Box::new([[0; LINES]; SAMPLES_MAX]),
            sections: [None; LINES],
        }
    }

    /// The next lines will be others.
    pub(super) fn clear(&mut self) {
        self.count = 0;
    }

    /// Adds a line in one picture (0 left, 1 right), as long as there is room: see [`Profiler::across`].
    #[inline]
    pub(super) fn push(
        &mut self,
        side: usize,
        origin: Vector2<f64>,
        across: Vector2<f64>,
        half_width_px: f64,
    ) {
        let l = self.count;
        if l < LINES {
            self.count += 1;
            self.side[l] = side;
            (self.origin[0][l], self.origin[1][l]) = (origin.x, origin.y);
            (self.across[0][l], self.across[1][l]) = (across.x, across.y);
            self.half_width_px[l] = half_width_px;
        }
    }

    /// What [`Profiler::across`] of its picture says of each line.
    pub(super) fn sections(&mut self, profilers: [&Profiler; 2], search_px: f64) -> &[Option<Section>] {
        match self.level {
            // SAFETY: `Level::detect` and `Level::available` name only levels that the machine has.
            #[cfg(target_arch = "x86_64")]
            Level::Avx512 => unsafe { self.find_avx512(profilers, search_px) },
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            Level::Avx2 => unsafe { self.find_avx2(profilers, search_px) },
            _ => self.find(profilers, search_px),
        }
        &self.sections[..self.count]
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl")]
    fn find_avx512(&mut self, profilers: [&Profiler; 2], search_px: f64) {
        self.find(profilers, search_px);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn find_avx2(&mut self, profilers: [&Profiler; 2], search_px: f64) {
        self.find(profilers, search_px);
    }

    #[inline(always)]
    fn find(&mut self, profilers: [&Profiler; 2], search_px: f64) {
        let reading = self.reading(search_px);
        let lanes = self.lanes();
        let (mut is_inside, mut count) = ([false; LINES], 0);
        let (mut contrast_min, mut outline_256) = ([NONE; LINES], [0; LINES]);
        for l in 0..self.count {
            let profiler = profilers[self.side[l]];
            contrast_min[l] = profiler.contrast_min.ceil() as u8;
            outline_256[l] = profiler.outline_256;
            let samples = self.read(profiler, &reading, l);
            is_inside[l] = samples > 0;
            count = count.max(samples);
        }
        let falls = falls(&self.samples[..count], &reading, &contrast_min, &outline_256);
        let (low, high) = (self.crossings(&falls[0]), self.crossings(&falls[1]));
        let [mut low_px, mut high_px] = [[0.0; LINES]; 2];
        for l in 0..lanes {
            let (first, centre, cos) = (reading.first[l], reading.centre[l], reading.cos[l]);
            let to_px = |at: f64| (first + at - centre) * cos.abs();
            (low_px[l], high_px[l]) = (to_px(low.at[l]), to_px(high.at[l]));
        }
        for l in 0..self.count {
            let [is_low, is_high] = falls.each_ref().map(|falls| falls.below[l] != NONE);
            let outlines = [is_low.then_some(low_px[l]), is_high.then_some(high_px[l])];
            let steepness = [low.steepness[l], high.steepness[l]];
            let across = Vector2::new(self.across[0][l], self.across[1][l]);
            let profiler = profilers[self.side[l]];
            let section =
                profiler.section(outlines, steepness, (across, reading.cos[l]), self.half_width_px[l]);
            let is_seen = is_inside[l] & (is_low | is_high);
            self.sections[l] = is_seen.then_some(section);
        }
    }

    /// So many lanes are worked out that all lines are.
    fn lanes(&self) -> usize {
        self.count.next_multiple_of(8).min(LINES)
    }

    #[inline(always)]
    fn reading(&self, search_px: f64) -> Reading {
        let Self { origin: [x, y], across: [across_x, across_y], half_width_px, .. } = self;
        let mut r = Reading {
            down: [false; LINES],
            line: [0.0; LINES],
            first: [0.0; LINES],
            half: [0.0; LINES],
            window: [0.0; LINES],
            span: [0.0; LINES],
            centre: [0.0; LINES],
            cos: [1.0; LINES],
        };
        for l in 0..self.lanes() {
            let down = across_x[l].abs() < across_y[l].abs();
            let (cos, sin) = if down { (across_y[l], across_x[l]) } else { (across_x[l], across_y[l]) };
            let (along_line, beside_line) = if down { (y[l], x[l]) } else { (x[l], y[l]) };
            let line = nearest(beside_line);
            let centre = along_line - (line - beside_line) * sin / cos;
            let samples = |px: f64, most: f64| floor((px / cos.abs()).max(0.0).min(most));
            let half = samples(half_width_px[l] + search_px + 4.0, (SAMPLES_MAX / 2 - 2) as f64) + 1.0;
            r.down[l] = down;
            (r.line[l], r.first[l], r.half[l]) = (line, nearest(centre) - half, half);
            r.window[l] = samples(search_px + 0.5 * half_width_px[l], half);
            // A span that leaves the line on both sides is as good as any longer one.
            r.span[l] = samples(2.0 * half_width_px[l] + 3.0, SAMPLES_MAX as f64);
            (r.centre[l], r.cos[l]) = (centre, cos);
        }
        r
    }

    /// Reads a line; gives its number of samples, none where it does not lie in the picture.
    #[inline(always)]
    fn read(&mut self, profiler: &Profiler, reading: &Reading, l: usize) -> usize {
        let luma = &profiler.luma;
        let (down, line, first) = (reading.down[l], reading.line[l], reading.first[l]);
        let samples = 2.0 * reading.half[l] + 1.0;
        let (length, lines) =
            if down { (luma.height(), luma.width()) } else { (luma.width(), luma.height()) };
        if !((first >= 0.0) & (first + samples <= length as f64) & (line >= 0.0) & (line < lines as f64)) {
            return 0;
        }
        let [line, first, samples] = [line, first, samples].map(|v| v as u32 as usize);
        let (x, y) = if down { (line, first) } else { (first, line) };
        let turned = if profiler.dark_parts() { 255 } else { 0 };
        let rows = &mut self.samples[..samples];
        luma.each_of_line(x, y, down, samples, |k, byte| rows[k][l] = byte ^ turned);
        samples
    }

    /// Where the lines cross their levels.
    #[inline(always)]
    fn crossings(&self, falls: &Falls) -> Crossings {
        let (mut a, mut b) = ([0.0; LINES], [0.0; LINES]);
        for l in 0..self.count {
            // Of lines that do not fall any two samples do.
            let at = |k: u8| f64::from(self.samples[usize::from(k) % SAMPLES_MAX][l]);
            (a[l], b[l]) = (at(falls.above[l]), at(falls.below[l]));
        }
        let mut c = Crossings { at: [0.0; LINES], steepness: [0.0; LINES] };
        for l in 0..self.lanes() {
            let (above, below) = (f64::from(falls.above[l]), f64::from(falls.below[l]));
            let level = f64::from(falls.at_256[l]) / 256.0;
            c.at[l] = above + (below - above) * (a[l] - level) / (a[l] - b[l]);
            c.steepness[l] = a[l] - b[l];
        }
        c
    }
}

/// Where lines have fallen to the level of their outlines on one side of their peaks.
struct Falls {
    /// In 1/256 of a grey level.
    at_256: [u16; LINES],
    /// The last sample above and the first at or below; [`NONE`] where it does not fall.
    above: Bytes,
    below: Bytes,
}

/// Where the lines cross their levels, in samples, and how much they fall from one sample to the next.
struct Crossings {
    at: Numbers,
    steepness: Numbers,
}

/// See [`super::section::outline`].
#[inline(always)]
fn falls(samples: &[Bytes], reading: &Reading, contrast_min: &Bytes, outline_256: &Bytes) -> [Falls; 2] {
    let [mut from, mut to, mut last, mut span] = [[0u8; LINES]; 4];
    for l in 0..LINES {
        let (half, window) = (reading.half[l], reading.window[l]);
        (from[l], to[l]) = (byte(half - window), byte(half + window));
        (last[l], span[l]) = (byte(2.0 * half), byte(reading.span[l]));
    }
    let (mut peak, mut level) = (from, [0u8; LINES]);
    for (s, row) in (0u8..).zip(samples) {
        for l in 0..LINES {
            let is_higher = (row[l] > level[l]) & (s >= from[l]) & (s <= to[l]);
            peak[l] = if is_higher { s } else { peak[l] };
            level[l] = if is_higher { row[l] } else { level[l] };
        }
    }
    let [mut low_end, mut high_end] = [[0u8; LINES]; 2];
    for l in 0..LINES {
        low_end[l] = peak[l].saturating_sub(span[l]);
        high_end[l] = peak[l].saturating_add(span[l]).min(last[l]);
    }
    let (mut low_floor, mut high_floor) = (level, level);
    for (s, row) in (0u8..).zip(samples) {
        for l in 0..LINES {
            let (is_low, is_high) = ((s >= low_end[l]) & (s <= peak[l]), (s >= peak[l]) & (s <= high_end[l]));
            low_floor[l] = if is_low { row[l].min(low_floor[l]) } else { low_floor[l] };
            high_floor[l] = if is_high { row[l].min(high_floor[l]) } else { high_floor[l] };
        }
    }
    // A sample is at or below a level where it is at or below that rounded down.
    let ([mut low_256, mut high_256], [mut low_at, mut high_at]) = ([[0u16; LINES]; 2], [[0u8; LINES]; 2]);
    for l in 0..LINES {
        let at_256 =
            |floor: u8| (u16::from(floor) << 8) + u16::from(level[l] - floor) * u16::from(outline_256[l]);
        (low_256[l], high_256[l]) = (at_256(low_floor[l]), at_256(high_floor[l]));
        (low_at[l], high_at[l]) = ((low_256[l] >> 8) as u8, (high_256[l] >> 8) as u8);
    }
    let (mut low, mut high) = ([NONE; LINES], [NONE; LINES]);
    for (s, row) in (0u8..).zip(samples) {
        for l in 0..LINES {
            let is_low = (s >= low_end[l]) & (s < peak[l]) & (row[l] <= low_at[l]);
            low[l] = if is_low { s } else { low[l] };
            let is_high = (s > peak[l]) & (s <= high_end[l]) & (row[l] <= high_at[l]);
            high[l] = if is_high { high[l].min(s) } else { high[l] };
        }
    }
    let (mut above_low, mut above_high) = (low, high);
    for l in 0..LINES {
        low[l] = if level[l] - low_floor[l] >= contrast_min[l] { low[l] } else { NONE };
        high[l] = if level[l] - high_floor[l] >= contrast_min[l] { high[l] } else { NONE };
        (above_low[l], above_high[l]) = (low[l].wrapping_add(1), high[l].wrapping_sub(1));
    }
    [
        Falls { at_256: low_256, above: above_low, below: low },
        Falls { at_256: high_256, above: above_high, below: high },
    ]
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};

    use super::*;
    use crate::frame::{Frame, LumaView};

    /// Wires of some widths and directions over noise, and places on, beside and outside of them.
    #[test]
    fn many_lines_together_say_what_each_one_says() {
        let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(11);
        let (w, h) = (120, 90);
        for case in 0..60 {
            let dark = case % 2 == 1;
            let wires: Vec<[f64; 4]> = (0..5)
                .map(|_| {
                    [
                        random.random_range(0.0..120.0),
                        random.random_range(0.0..90.0),
                        random.random_range(0.0..3.2),
                        random.random_range(0.5..20.0),
                    ]
                })
                .collect();
            let noise = random.random_range(0..90);
            let mut grey = Vec::new();
            for (y, x) in (0..h).flat_map(|y| (0..w).map(move |x| (y, x))) {
                let beside = |[wx, wy, angle, half]: &[f64; 4]| {
                    (half - ((x as f64 - wx) * angle.sin() - (y as f64 - wy) * angle.cos()).abs())
                        .clamp(0.0, 1.0)
                };
                let wire = wires.iter().map(beside).fold(0.0, f64::max);
                grey.push((40.0 + 120.0 * wire) as u8 + random.random_range(0..=noise));
            }
            let frame = if case % 3 == 0 {
                Frame::from_rgb(w, h, grey.iter().flat_map(|v| [*v, v / 2, 255 - v]).collect())
            } else {
                Frame::from_grey(w, h, grey)
            };
            let luma = LumaView::new(&frame).unwrap();
            let contrast_min = [0.0, 7.5, 40.2][case % 3];
            let shadow = [None, Some(Vector2::zeros()), Some(Vector2::new(0.8, -0.6))][case / 2 % 3];
            let profilers = [
                Profiler::new(luma, dark, 12.0).with_shadow(shadow),
                Profiler::new(luma, !dark, contrast_min).with_outlines_at([128, 64, 250, 1][case % 4]),
            ];
            let search_px = [1.0, 1.5, 2.5, 7.0][case % 4];
            for &level in Level::available() {
                let mut outlines = Outlines::new(level);
                let mut expected = Vec::new();
                for l in 0..LINES {
                    let [wx, wy, angle, half] = wires[l % 5];
                    let along = random.random_range(-60.0..60.0);
                    let (sin, cos) = (angle + random.random_range(-0.3..0.3f64)).sin_cos();
                    let origin = Vector2::new(wx + along * cos, wy + along * sin)
                        + Vector2::new(random.random_range(-3.0..3.0), random.random_range(-3.0..3.0));
                    let across = if l % 2 == 0 { Vector2::new(-sin, cos) } else { Vector2::new(sin, -cos) };
                    outlines.push(l % 2, origin, across, half);
                    expected.push(profilers[l % 2].across(origin, across, half, search_px));
                }
                assert_eq!(
                    outlines.sections([&profilers[0], &profilers[1]], search_px),
                    expected,
                    "{level:?}"
                );
            }
        }
    }

    #[test]
    fn what_is_far_outside_or_not_finite_is_not_seen() {
        let frame = Frame::from_grey(40, 30, vec![100; 1200]);
        let profiler = Profiler::new(LumaView::new(&frame).unwrap(), false, 12.0);
        let mut outlines = Outlines::new(Level::detect());
        for odd in [f64::NAN, f64::INFINITY, -1e300, 1e12, 3e9] {
            outlines.push(0, Vector2::new(odd, 10.0), Vector2::y(), 3.0);
            outlines.push(1, Vector2::new(10.0, odd), Vector2::new(odd, 0.5), 3.0);
            outlines.push(1, Vector2::new(20.0, 15.0), Vector2::x(), odd);
        }
        assert!(outlines.sections([&profiler; 2], 2.0).iter().all(Option::is_none));
    }
}
