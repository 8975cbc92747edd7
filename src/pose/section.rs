//! Where a wire lies across a line in the picture, to a fraction of a pixel.
//!
//! A profile of grey values across the wire falls from the wire's level to the background's on both sides; the
//! outline is taken where it has fallen half the way, of polished wire farther down (see [`gloss`](super::gloss)), of
//! dark wire a little less far, for shadows lie below.

use std::ops::Range;

use nalgebra::Vector2;

use crate::frame::LumaView;
use crate::vision::bits::{BitImage, nearest};

/// Most grey values of a line.
pub(super) const SAMPLES_MAX: usize = 96;
/// Steps from one outline to the other in which the light between them is added up.
const LIGHT_STEPS: usize = 12;
/// A lamp at one side moves both borders of the lit region that way, so much for each half width that the light between them lies
/// beside their middle: 1 to 2 on a matte cylinder. Blur leaves the borders where they are and makes the light between them even,
/// the more the thinner the wire is: so much over the square of its half width in pixels. Both from rendered scenes of 18 rigs,
/// of wire 3 to 10 pixels wide.
const ASIDE_PER_SKEW: f64 = 1.2;
const ASIDE_BLURRED_PX2: f64 = 28.0;
/// The same for a shadow beside a dark wire that is as dark as the wire.
const ASIDE_PER_SHADOW: f64 = 0.25;
/// Where beyond the outlines of a dark wire its shadow is looked for, in pixels.
const BESIDE_PX: [f64; 4] = [1.0, 1.5, 2.0, 2.5];
/// How far beside a crossing the light of a wire is looked at, in pixels.
pub(super) const DIP_BESIDE_PX: usize = 5;
/// Half the way from the background to the brightest of the wire, where the outline of a dull wire is.
pub const HALF_WAY: u8 = 128;
/// From so many widths on it is no shadow that joins a dark wire, but another wire.
const SHADOW_WIDTHS_MAX: f64 = 1.2;
/// The same where it is known on which side the shadow lies, as it is of wire that it falls so much across.
const SURE_WIDTHS_MAX: f64 = 2.2;
const SURE_ACROSS: f64 = 1.0 / 3.0;
/// The difference of the steepness of both outlines, over their sum, that says as much as a shadow known to fall straight across.
const STEEPER_PER_ACROSS: f64 = 0.6;

/// The outline of a wire along a line across it, as signed distances in pixels from the line's origin.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Section {
    /// The outline on the negative side, where it is seen against background.
    pub low_px: Option<f64>,
    /// The outline on the positive side.
    pub high_px: Option<f64>,
    /// Whether one of them was a shadow's, on a side that is known, and is where the wire's must be.
    pub is_off_shadow: bool,
}

impl Section {
    /// Middle and width, where both outlines are seen.
    pub fn middle_and_width(&self) -> Option<(f64, f64)> {
        Some(((self.low_px? + self.high_px?) / 2.0, self.high_px? - self.low_px?))
    }
}

/// The light of a wire between the borders of its outline.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightAcross {
    /// How much lighter (dark parts: darker) it is in the mean than at the borders, in grey levels.
    pub above: f64,
    /// The same over that of the brightest place between them: less where a bright line runs along a dull wire.
    pub full: f64,
    /// How far the middle between the outlines lies beside the axis, in half widths of the wire, as the light between them tells,
    /// and of dark parts the shadow beyond them; nought where the lamp is above the wire.
    pub aside: f64,
}

/// Grey levels between wire and background from which an outline is believed.
pub const CONTRAST_MIN: f64 = 12.0;

/// Reads grey profiles of one picture.
#[derive(Clone, Copy)]
pub struct Profiler<'a> {
    pub(super) luma: LumaView<'a>,
    /// +1 for parts brighter than the floor, -1 for darker ones.
    pub(super) sign: f64,
    /// Grey levels by which wire and background differ at least.
    pub(super) contrast_min: f64,
    /// How far above the background an outline is taken, in 1/256 of the way to the brightest of the wire.
    pub(super) outline_256: u8,
    /// Where shadows fall, see [`Profiler::with_shadow`].
    pub(super) shadow: Option<Vector2<f64>>,
}

impl<'a> Profiler<'a> {
    /// `dark_parts`: the parts are darker than the floor.
    pub fn new(luma: LumaView<'a>, dark_parts: bool, contrast_min: f64) -> Self {
        let (sign, shadow) = if dark_parts { (-1.0, Some(Vector2::zeros())) } else { (1.0, None) };
        Self { luma, sign, contrast_min, outline_256: HALF_WAY, shadow }
    }

    /// The same, with outlines so far above the background, in 1/256 of the way to the brightest of the wire; else half way.
    pub fn with_outlines_at(self, outline_256: u8) -> Self {
        Self { outline_256, ..self }
    }

    /// The same, with the shadow taken off that joins wire and falls this way in the picture, at most 1 long, see
    /// [`ShadowSide::falls`]; nought where it is not known which way, as else of dark wire. `None`: outlines are taken as they are seen.
    ///
    /// [`ShadowSide::falls`]: super::shadow::ShadowSide::falls
    pub fn with_shadow(self, shadow: Option<Vector2<f64>>) -> Self {
        Self { shadow, ..self }
    }

    /// How much of its way a shadow falls along a direction in the picture, -1 to 1; across a wire, to its positive side. Nought
    /// where that is not known, and of bright wire.
    pub(super) fn shadow_along(&self, direction: &Vector2<f64>) -> f64 {
        self.shadow.map_or(0.0, |shadow| shadow.dot(direction))
    }

    /// Whether outlines are taken lower than half way.
    pub fn is_polished(&self) -> bool {
        self.outline_256 < HALF_WAY
    }

    /// Whether the parts are darker than the background.
    pub fn dark_parts(&self) -> bool {
        self.sign < 0.0
    }

    pub(super) fn inside(&self, at: Vector2<f64>) -> bool {
        (0.0..=(self.luma.width() - 1) as f64).contains(&at.x)
            && (0.0..=(self.luma.height() - 1) as f64).contains(&at.y)
    }

    /// The outline of the wire whose middle is expected within `search_px` of `origin`, along the unit vector
    /// `across`, with a half width of about `half_width_px`. `None` where the profile leaves the picture or shows
    /// no wire.
    ///
    /// Pixels are read along the row or column through the wire that is nearer to `across`; distances along it are
    /// turned into distances across a straight wire.
    pub fn across(
        &self,
        origin: Vector2<f64>,
        across: Vector2<f64>,
        half_width_px: f64,
        search_px: f64,
    ) -> Option<Section> {
        let down = across.x.abs() < across.y.abs();
        let (cos, sin) = if down { (across.y, across.x) } else { (across.x, across.y) };
        let (along_line, beside_line) = if down { (origin.y, origin.x) } else { (origin.x, origin.y) };
        let line = f64::from(nearest(beside_line));
        // Where the wire's middle crosses the row or column.
        let centre = along_line - (line - beside_line) * sin / cos;
        let scale = cos.abs();
        let px = |t: f64| t / scale;
        let half = (px(half_width_px + search_px + 4.0) as usize + 1).min((SAMPLES_MAX - 1) / 2);
        let first = f64::from(nearest(centre) - half as i32);
        let (length, lines) = if down {
            (self.luma.height(), self.luma.width())
        } else {
            (self.luma.width(), self.luma.height())
        };
        if !(first >= 0.0
            && first + 2.0 * half as f64 + 1.0 <= length as f64
            && line >= 0.0
            && line < lines as f64)
        {
            return None;
        }
        let mut bytes = [0u8; SAMPLES_MAX];
        let bytes = &mut bytes[..=2 * half];
        let (x, y) = if down { (line, first) } else { (first, line) };
        self.luma.read_line(x as usize, y as usize, down, bytes);
        if self.dark_parts() {
            bytes.iter_mut().for_each(|b| *b = 255 - *b);
        }
        let window = (px(search_px + 0.5 * half_width_px) as usize).min(half);
        let span = px(2.0 * half_width_px + 3.0) as usize;
        let level = (self.contrast_min, self.outline_256);
        let fall = outline(bytes, half - window..half + window + 1, span, level)?;
        let to_px = |at: f64| (first + at - centre) * scale;
        let outlines = [fall.low, fall.high].map(|c| c.map(|c| to_px(c.at)));
        let steepness = [fall.low, fall.high].map(|c| c.map_or(0.0, |c| c.steepness));
        Some(self.section(outlines, steepness, (across, cos), half_width_px))
    }

    /// The outline of a wire from where its borders are seen along a row or column, the one before the middle first, and how steep
    /// they are. `cos` is the part of `across` along the row or column: where it is negative, the first border is the positive side's.
    #[inline]
    pub(super) fn section(
        &self,
        [mut low, mut high]: [Option<f64>; 2],
        steepness: [f64; 2],
        (across, cos): (Vector2<f64>, f64),
        half_width_px: f64,
    ) -> Section {
        let is_off_shadow = self.shadow.is_some() && {
            let shadow_above = self.shadow_along(&across) * cos.signum();
            without_shadow(steepness, shadow_above, &mut low, &mut high, 2.0 * half_width_px)
        };
        let (low_px, high_px) = if cos < 0.0 { (high.map(|h| -h), low.map(|l| -l)) } else { (low, high) };
        Section { low_px, high_px, is_off_shadow }
    }

    /// The light between the borders of a wire's outline, along the unit vector `across`; from where the middle between them
    /// is, in pixels from `origin`, and how far they are apart. `None` where it leaves the picture, or shows no light.
    pub fn light(
        &self,
        origin: Vector2<f64>,
        across: Vector2<f64>,
        half_width_px: f64,
        (middle, width): (f64, f64),
    ) -> Option<LightAcross> {
        let reach = across * (width / 2.0);
        let middle = origin + across * middle;
        if !self.inside(middle - reach) || !self.inside(middle + reach) {
            return None;
        }
        let step = reach * (2.0 / LIGHT_STEPS as f64);
        let mut light = [[0f32; 16]];
        self.luma.read_lines(&[(middle - reach).into()], step.into(), &mut light, LIGHT_STEPS + 1);
        let light = light[0].map(|l| self.sign * f64::from(l));
        let floor = (light[0] + light[LIGHT_STEPS]) / 2.0;
        let (mut sum, mut moment, mut most) = (0.0, 0.0, 0f64);
        for (k, light) in light.iter().enumerate().take(LIGHT_STEPS).skip(1) {
            let share = 2.0 * k as f64 / LIGHT_STEPS as f64 - 1.0;
            let above = (light - floor).max(0.0);
            sum += above;
            moment += above * share;
            most = most.max(above);
        }
        if sum <= 0.0 {
            return None;
        }
        let above = sum / (LIGHT_STEPS - 1) as f64;
        let aside = if self.dark_parts() {
            let shadow = (self.beside(middle, reach, across) - self.beside(middle, -reach, -across)) / above;
            ASIDE_PER_SHADOW * shadow.clamp(-1.0, 1.0)
        } else {
            let skew = moment / sum * width / (2.0 * half_width_px);
            let blurred = if self.is_polished() { 0.0 } else { ASIDE_BLURRED_PX2 / half_width_px.powi(2) };
            skew * blurred.max(ASIDE_PER_SKEW)
        };
        Some(LightAcross { above, full: above / most, aside })
    }

    /// How dark it is in the mean just beyond an outline, so far from the middle of a dark wire, outwards.
    fn beside(&self, middle: Vector2<f64>, reach: Vector2<f64>, outwards: Vector2<f64>) -> f64 {
        let dark = |beyond_px: f64| {
            let at = middle + reach + outwards * beyond_px;
            self.sign * f64::from(self.luma.sample(at.x as f32, at.y as f32))
        };
        BESIDE_PX.iter().map(|px| dark(*px)).sum::<f64>() / BESIDE_PX.len() as f64
    }

    /// By how many grey levels the light along a wire, the unit vector `along`, falls within `near_px` of a place, below
    /// what it is on the brighter side beside that. `None` where that leaves the picture.
    pub fn dip(&self, place: Vector2<f64>, along: Vector2<f64>, near_px: f64) -> Option<f64> {
        const SAMPLES_PER_PX: f64 = 2.0;
        let near = (near_px * SAMPLES_PER_PX) as usize;
        let count = (2 * (near + DIP_BESIDE_PX * SAMPLES_PER_PX as usize) + 1).min(SAMPLES_MAX);
        let step = along / SAMPLES_PER_PX;
        let from = place - step * (count / 2) as f64;
        if !self.inside(from) || !self.inside(from + step * (count - 1) as f64) {
            return None;
        }
        let mut light = [[0f32; SAMPLES_MAX]];
        self.luma.read_lines(&[from.into()], step.into(), &mut light, count);
        let light = &light[0][..count];
        let light_at = |range: Range<usize>| light[range].iter().map(|l| self.sign * f64::from(*l));
        let before = (count / 2).checked_sub(near).filter(|before| *before > 0)?;
        let mean = |range: Range<usize>| light_at(range).sum::<f64>() / before as f64;
        let level = mean(0..before).max(mean(count - before..count));
        Some(level - light_at(before..count - before).fold(f64::INFINITY, f64::min))
    }
}

/// Where a profile has fallen to the level of an outline on both sides of its peak.
struct Fall {
    low: Option<Crossing>,
    high: Option<Crossing>,
}

/// Where a profile falls below a level, in samples, and how much it falls from one sample to the next.
#[derive(Clone, Copy)]
struct Crossing {
    at: f64,
    steepness: f64,
}

/// Whether it is known on which side of wire its shadow lies, see [`Profiler::shadow_along`].
pub(super) fn is_sure(shadow_above: f64) -> bool {
    shadow_above.abs() >= SURE_ACROSS
}

/// Takes the shadow off that joins a dark wire on a light floor: where the outlines are farther apart than the wire is
/// wide, one of them is that of the shadow, by what is known of where it falls (`shadow_above`: see [`Profiler::shadow_along`]),
/// and by the steepness of both, of which the flatter is likely the shadow's. Says whether one was taken off of which the side is
/// known: then the other is the wire's own, and not what shadows on both sides have made of it.
fn without_shadow(
    [low_steepness, high_steepness]: [f64; 2],
    shadow_above: f64,
    low_px: &mut Option<f64>,
    high_px: &mut Option<f64>,
    width_px: f64,
) -> bool {
    let (Some(low), Some(high)) = (*low_px, *high_px) else { return false };
    let widths_max = if is_sure(shadow_above) { SURE_WIDTHS_MAX } else { SHADOW_WIDTHS_MAX };
    if !(width_px..widths_max * width_px).contains(&(high - low)) {
        return false;
    }
    let flatter_above = (low_steepness - high_steepness) / (low_steepness + high_steepness);
    if flatter_above + STEEPER_PER_ACROSS * shadow_above > 0.0 {
        *high_px = Some(low + width_px);
    } else {
        *low_px = Some(high - width_px);
    }
    is_sure(shadow_above)
}

/// Finds the peak of `profile` within `window` and where it has fallen to so far above the lowest value within `span` samples,
/// see [`Profiler::with_outlines_at`], on each side where that is at least `contrast_min` lower.
fn outline(
    profile: &[u8],
    window: Range<usize>,
    span: usize,
    (contrast_min, outline_256): (f64, u8),
) -> Option<Fall> {
    let mut peak = window.start;
    for i in window {
        if profile[i] > profile[peak] {
            peak = i;
        }
    }
    let level = profile[peak];
    // In 1/256 of a grey level.
    let fallen_to = |floor: u8| {
        (f64::from(level) - f64::from(floor) >= contrast_min)
            .then(|| (u16::from(floor) << 8) + u16::from(level - floor) * u16::from(outline_256))
    };
    let falls_to = |at: u16| move |value: u8| u16::from(value) << 8 <= at;
    // Between a sample above and its neighbour at or below the level `at`.
    let crossing = |above: usize, below: usize, at: u16| {
        let at = f64::from(at) / 256.0;
        let (a, b) = (f64::from(profile[above]), f64::from(profile[below]));
        Crossing { at: above as f64 + (below as f64 - above as f64) * (a - at) / (a - b), steepness: a - b }
    };
    let low_end = peak.saturating_sub(span);
    let low = fallen_to(*profile[low_end..=peak].iter().min()?).and_then(|at| {
        let fallen = falls_to(at);
        let below = (low_end..peak).rev().find(|&i| fallen(profile[i]))?;
        Some(crossing(below + 1, below, at))
    });
    let high_end = (peak + span).min(profile.len() - 1);
    let high = fallen_to(*profile[peak..=high_end].iter().min()?).and_then(|at| {
        let fallen = falls_to(at);
        let below = (peak + 1..=high_end).find(|&i| fallen(profile[i]))?;
        Some(crossing(below - 1, below, at))
    });
    (low.is_some() || high.is_some()).then_some(Fall { low, high })
}

/// Middle and width of the run of object pixels nearest to `origin` along `across`, looked for up to `search_px`
/// away; `None` where there is none. A run wider than `widest_px` is followed only until that is clear.
pub fn mask_run(
    mask: &BitImage,
    origin: Vector2<f64>,
    across: Vector2<f64>,
    search_px: f64,
    widest_px: f64,
) -> Option<(f64, f64)> {
    // In 1/65536 pixels, half a pixel on, so that what is before the point is the nearest pixel.
    // What is a million pixels away is outside, and stays so in whole numbers.
    let fixed = |v: f64| (v.clamp(-1e6, 1e6) * 65536.0) as i64;
    let ([x, y], [dx, dy]) = ([origin.x, origin.y].map(|v| fixed(v + 0.5)), [across.x, across.y].map(fixed));
    let object = |t: i32| {
        let at = |from: i64, step: i64| ((from + step * i64::from(t)) >> 16) as i32;
        mask.get(at(x, dx), at(y, dy))
    };
    let search = search_px as i32;
    let start =
        (0..=2 * search + 1).map(|k| if k % 2 == 0 { -(k / 2) } else { k / 2 + 1 }).find(|&t| object(t))?;
    let limit = widest_px as i32 + 1;
    let (mut low, mut high) = (start, start);
    while low > start - limit && object(low - 1) {
        low -= 1;
    }
    while high < start + limit && object(high + 1) {
        high += 1;
    }
    Some(((low + high) as f64 / 2.0, (high - low + 1) as f64))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Frame;

    /// A dark upright wire, 6 pixels wide around x = 20, on a light floor; its shadow to the right.
    fn dark_wire(shadow: &[u8]) -> Frame {
        let row: Vec<u8> = (0..40)
            .map(|x| match x {
                17..=22 => 50,
                23.. => shadow.get(x - 23).copied().unwrap_or(200),
                _ => 200,
            })
            .collect();
        Frame::from_rgb(40, 40, (0..40).flat_map(|_| row.iter().flat_map(|&v| [v; 3])).collect())
    }

    fn middle(frame: &Frame) -> f64 {
        let profiler = Profiler::new(LumaView::new(frame).unwrap(), true, 12.0);
        let at = Vector2::new(19.5, 20.0);
        profiler.across(at, Vector2::new(1.0, 0.0), 3.0, 1.5).unwrap().middle_and_width().unwrap().0
    }

    #[test]
    fn the_shadow_of_dark_wire_tells_on_which_side_the_lamp_is() {
        let aside = |frame: &Frame, across: Vector2<f64>| {
            let profiler = Profiler::new(LumaView::new(frame).unwrap(), true, 12.0);
            profiler.light(Vector2::new(19.5, 20.0), across, 3.0, (0.0, 6.0)).unwrap().aside
        };
        assert!(aside(&dark_wire(&[]), Vector2::x()).abs() < 1e-6);
        let shaded = dark_wire(&[170, 180, 190]);
        assert!(aside(&shaded, Vector2::x()) > 0.02 && aside(&shaded, -Vector2::x()) < -0.02);
    }

    #[test]
    fn a_wire_that_another_lies_over_is_interrupted_and_the_upper_one_is_not() {
        // The upper one lies level around y = 30, with dark flanks; the lower one upright around x = 30.
        let pixels = (0..60).flat_map(|y: i32| {
            (0..60).map(move |x: i32| match ((x - 30).abs(), (y - 30).abs()) {
                (_, 0..=1) => 200u8,
                (_, 2..=3) => 90,
                (0..=2, _) => 190,
                _ => 30,
            })
        });
        let frame = Frame::from_rgb(60, 60, pixels.flat_map(|v| [v; 3]).collect());
        let profiler = Profiler::new(LumaView::new(&frame).unwrap(), false, 12.0);
        let dip = |along| profiler.dip(Vector2::new(30.0, 30.0), along, 4.0).unwrap();
        assert!(dip(Vector2::x()) < 5.0, "{}", dip(Vector2::x()));
        assert!(dip(Vector2::y()) > 80.0, "{}", dip(Vector2::y()));
        assert_eq!(profiler.dip(Vector2::new(2.0, 30.0), Vector2::x(), 4.0), None);
    }

    #[test]
    fn the_outline_of_polished_wire_is_farther_down_its_light() {
        // A bright line upright around x = 19, on a body from 16 to 23.
        let row = (0..40).map(|x| match x {
            18..=20 => 235u8,
            16..=23 => 100,
            _ => 35,
        });
        let row: Vec<u8> = row.collect();
        let frame = Frame::from_grey(40, 40, (0..40).flat_map(|_| row.iter().copied()).collect());
        let profiler = Profiler::new(LumaView::new(&frame).unwrap(), false, CONTRAST_MIN);
        let seen = |profiler: Profiler| {
            let section = profiler.across(Vector2::new(19.5, 20.0), Vector2::x(), 4.0, 1.5);
            section.unwrap().middle_and_width().unwrap()
        };
        let ((line, line_px), (body, body_px)) = (seen(profiler), seen(profiler.with_outlines_at(64)));
        assert!((line + 0.5).abs() < 0.1 && (line_px - 3.5).abs() < 0.1, "{line} {line_px}");
        assert!(body.abs() < 0.1 && (body_px - 7.5).abs() < 0.1, "{body} {body_px}");
    }

    #[test]
    fn a_shadow_does_not_move_a_dark_wire() {
        let without = middle(&dark_wire(&[]));
        let with = middle(&dark_wire(&[115, 150, 180]));
        assert!(without.abs() < 0.05 && (with - without).abs() < 0.05, "{without} {with}");
    }

    #[test]
    fn a_shadow_as_dark_and_sharp_as_the_wire_is_taken_off_where_its_side_is_known() {
        // The shadow, darker than the wire even, makes it look twice as wide.
        let frame = dark_wire(&[45; 6]);
        let profiler = Profiler::new(LumaView::new(&frame).unwrap(), true, 12.0);
        let seen = |profiler: Profiler, across: Vector2<f64>| {
            profiler.across(Vector2::new(20.5, 20.0), across, 3.0, 1.5).unwrap()
        };
        let at_right = profiler.with_shadow(Some(Vector2::new(0.8, 0.6)));
        for across in [Vector2::x(), -Vector2::x()] {
            let section = seen(at_right, across);
            let (middle, width) = section.middle_and_width().unwrap();
            assert!((middle * across.x + 1.0).abs() < 0.1 && (width - 6.0).abs() < 1e-9, "{middle} {width}");
            assert!(section.is_off_shadow);
        }
        // It may be another wire as well, where that is not known, or what is seen is asked for.
        for unknown in [profiler, profiler.with_shadow(None)] {
            let section = seen(unknown, Vector2::x());
            assert!(section.middle_and_width().unwrap().1 > 11.0 && !section.is_off_shadow);
        }
    }
}
