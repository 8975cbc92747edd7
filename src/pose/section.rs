//! Where a wire lies across a line in the picture, to a fraction of a pixel.
//!
//! A profile of grey values across the wire falls from the wire's level to the background's on both sides; the
//! outline is taken where it has fallen half the way.

use nalgebra::Vector2;

use crate::frame::LumaView;
use crate::vision::bits::BitImage;

/// Samples a pixel along a profile.
const SAMPLES_PER_PX: f64 = 2.0;
const SAMPLES_MAX: usize = 96;

/// The outline of a wire along a line across it, as signed distances in pixels from the line's origin.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Section {
    /// The outline on the negative side, where it is seen against background.
    pub low_px: Option<f64>,
    /// The outline on the positive side.
    pub high_px: Option<f64>,
    /// Highest grey level of the wire (lowest for dark parts), 0..255.
    pub level: f64,
    /// Background grey level, the mean of both sides.
    pub background: f64,
}

impl Section {
    /// Middle and width, where both outlines are seen.
    pub fn middle_and_width(&self) -> Option<(f64, f64)> {
        Some(((self.low_px? + self.high_px?) / 2.0, self.high_px? - self.low_px?))
    }
}

/// Reads grey profiles of one picture.
#[derive(Clone, Copy)]
pub struct Profiler<'a> {
    luma: LumaView<'a>,
    /// +1 for parts brighter than the floor, -1 for darker ones.
    sign: f64,
    /// Grey levels by which wire and background differ at least.
    contrast_min: f64,
}

impl<'a> Profiler<'a> {
    /// `dark_parts`: the parts are darker than the floor.
    pub fn new(luma: LumaView<'a>, dark_parts: bool, contrast_min: f64) -> Self {
        Self { luma, sign: if dark_parts { -1.0 } else { 1.0 }, contrast_min }
    }

    fn inside(&self, at: Vector2<f64>) -> bool {
        (0.0..=(self.luma.width() - 1) as f64).contains(&at.x)
            && (0.0..=(self.luma.height() - 1) as f64).contains(&at.y)
    }

    fn sample(&self, at: Vector2<f64>) -> Option<f64> {
        self.inside(at).then(|| self.sign * self.luma.sample(at.x as f32, at.y as f32) as f64)
    }

    /// The outline of the wire whose middle is expected within `search_px` of `origin`, along the unit vector
    /// `across`, with a half width of about `half_width_px`. `None` where the profile leaves the picture or shows
    /// no wire.
    pub fn across(
        &self,
        origin: Vector2<f64>,
        across: Vector2<f64>,
        half_width_px: f64,
        search_px: f64,
    ) -> Option<Section> {
        let reach_px = (half_width_px + search_px + 4.0).min((SAMPLES_MAX / 2 - 1) as f64 / SAMPLES_PER_PX);
        let half = (reach_px * SAMPLES_PER_PX) as usize;
        let mut profile = [0.0; SAMPLES_MAX];
        for (i, p) in profile[..=2 * half].iter_mut().enumerate() {
            *p = self.sample(origin + across * ((i as f64 - half as f64) / SAMPLES_PER_PX))?;
        }
        let profile = &profile[..=2 * half];
        let window = (((search_px + 0.5 * half_width_px) * SAMPLES_PER_PX) as usize).min(half);
        let peak = (half - window..=half + window).max_by(|&a, &b| profile[a].total_cmp(&profile[b]))?;
        let level = profile[peak];
        let span = ((2.0 * half_width_px + 3.0) * SAMPLES_PER_PX) as usize;
        let low_end = peak.saturating_sub(span);
        let high_end = (peak + span).min(2 * half);
        let floor_low = profile[low_end..=peak].iter().copied().fold(f64::INFINITY, f64::min);
        let floor_high = profile[peak..=high_end].iter().copied().fold(f64::INFINITY, f64::min);
        let fallen = |floor: f64| level - floor >= self.contrast_min;
        let mut section = Section {
            level: self.sign * level,
            background: self.sign * (floor_low + floor_high) / 2.0,
            ..Section::default()
        };
        let to_px = |i: usize, j: usize, at: f64| {
            // Between sample i (above) and its neighbour j (at or below the level `at`).
            let f = (profile[i] - at) / (profile[i] - profile[j]);
            (i as f64 + (j as f64 - i as f64) * f - half as f64) / SAMPLES_PER_PX
        };
        if fallen(floor_low) {
            let at = (level + floor_low) / 2.0;
            section.low_px = (low_end..peak).rev().find(|&i| profile[i] <= at).map(|i| to_px(i + 1, i, at));
        }
        if fallen(floor_high) {
            let at = (level + floor_high) / 2.0;
            section.high_px = (peak + 1..=high_end).find(|&i| profile[i] <= at).map(|i| to_px(i - 1, i, at));
        }
        (section.low_px.is_some() || section.high_px.is_some()).then_some(section)
    }

    /// How far beyond `end` (in pixels, negative: before) the wire ends, along the unit vector `outward`, where
    /// it ends within `search_px` against the background; averaged over rays side by side.
    pub fn end(
        &self,
        end: Vector2<f64>,
        outward: Vector2<f64>,
        half_width_px: f64,
        search_px: f64,
    ) -> Option<f64> {
        let inside_px = (3.0 * half_width_px).max(search_px + 2.0);
        let outside_px = search_px + 4.0;
        let count = (((inside_px + outside_px) * SAMPLES_PER_PX) as usize + 1).min(SAMPLES_MAX);
        let side = Vector2::new(-outward.y, outward.x) * half_width_px;
        let mut profile = [0.0; SAMPLES_MAX];
        for (i, p) in profile[..count].iter_mut().enumerate() {
            let at = end + outward * (i as f64 / SAMPLES_PER_PX - inside_px);
            *p = (self.sample(at - side * 0.4)? + self.sample(at)? + self.sample(at + side * 0.4)?) / 3.0;
        }
        let profile = &profile[..count];
        let well_inside = ((inside_px - search_px - 1.0).max(1.0) * SAMPLES_PER_PX) as usize;
        let level = profile[..well_inside].iter().sum::<f64>() / well_inside as f64;
        let floor = profile[well_inside..].iter().copied().fold(f64::INFINITY, f64::min);
        if level - floor < self.contrast_min {
            return None;
        }
        let at = (level + floor) / 2.0;
        let i = (well_inside..count).find(|&i| profile[i] <= at)?;
        let f = (profile[i - 1] - at) / (profile[i - 1] - profile[i]);
        let px = (i as f64 - 1.0 + f) / SAMPLES_PER_PX - inside_px;
        (px.abs() <= search_px).then_some(px)
    }
}

/// Middle and width of the run of object pixels nearest to `origin` along `across`, looked for up to `search_px`
/// away; `None` where there is none.
pub fn mask_run(
    mask: &BitImage,
    origin: Vector2<f64>,
    across: Vector2<f64>,
    search_px: f64,
) -> Option<(f64, f64)> {
    let object = |t: i32| {
        let p = origin + across * (t as f64);
        mask.get(p.x.round() as i32, p.y.round() as i32)
    };
    let search = search_px as i32;
    let start =
        (0..=2 * search + 1).map(|k| if k % 2 == 0 { -(k / 2) } else { k / 2 + 1 }).find(|&t| object(t))?;
    let limit = 4 * search + 20;
    let (mut low, mut high) = (start, start);
    while low > start - limit && object(low - 1) {
        low -= 1;
    }
    while high < start + limit && object(high + 1) {
        high += 1;
    }
    Some(((low + high) as f64 / 2.0, (high - low + 1) as f64))
}
