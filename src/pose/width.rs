//! How wide a wire is seen, and where its middle is, given that.
//!
//! A wire is as wide at one place as at the next, but for what the light does to its outlines. Where it is wider or
//! narrower, a neighbour touches or hides one of its sides.

use super::section::Section;

/// Seen width of one wire over that of its silhouette: less than this, and a neighbour hides a part of it; more, and
/// one touches it.
pub(super) const ONE_WIRE: [f64; 2] = [0.5, 1.2];
/// How wide wire is seen at most whose silhouette is but a pixel or two wide: so many pixels, and so many times its silhouette. Half
/// way up, what a lens and a pixel blur by 0.6 to 0.8 pixels (standard deviation) is no narrower.
const BLURRED_PX: [f64; 2] = [1.2, 0.76];

/// Whether what is seen so wide may be one wire with a silhouette of this width, in pixels; `narrowest` and `widest` are shares of
/// that where it is not thin.
pub(super) fn is_one_wire(width_px: f64, silhouette_px: f64, [narrowest, widest]: [f64; 2]) -> bool {
    let [blur_px, share] = BLURRED_PX;
    let most_px = (widest * silhouette_px).max(blur_px + share * silhouette_px);
    (narrowest * silhouette_px..most_px).contains(&width_px)
}

/// Standard deviation of a normal distribution over the median of the distances from its middle.
const SIGMA_OVER_MEDIAN: f64 = 1.4826;
/// From so many standard deviations on a width is not the light's doing.
const ODD_SIGMAS: f64 = 3.0;
/// How much less a middle is worth of which one side is a guess, as a factor of its standard deviation.
const ONE_SIDE_SIGMAS: f64 = 4.0;

/// How wide a wire is seen in one picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UsualWidth {
    /// Over the width of its silhouette.
    pub ratio: f64,
    /// How far the ratio may be off this with no neighbour there.
    pub spread: f64,
}

impl UsualWidth {
    /// From the ratios of single places, which it reorders: their median, so that neighbours at less than half of the
    /// places do not matter. `None` without any.
    pub fn of(ratios: &mut [f64]) -> Option<Self> {
        let middle = ratios.len() / 2;
        if ratios.is_empty() {
            return None;
        }
        let ratio = *ratios.select_nth_unstable_by(middle, f64::total_cmp).1;
        ratios.iter_mut().for_each(|r| *r = (*r - ratio).abs());
        let median = *ratios.select_nth_unstable_by(middle, f64::total_cmp).1;
        Some(Self { ratio, spread: ODD_SIGMAS * SIGMA_OVER_MEDIAN * median })
    }

    /// Middle of a wire within about `search_px` and its standard deviation, from what is seen of its outline, in
    /// pixels; `sigma_px` is that of a wire with nothing beside it.
    pub fn middle_of(
        &self,
        section: &Section,
        half_width_px: f64,
        search_px: f64,
        sigma_px: f64,
    ) -> Option<(f64, f64)> {
        let near = |px: f64| px.abs() < search_px + 0.5 * half_width_px;
        if let (Some(ratio), Some((middle, _))) = (section.ratio(half_width_px), section.middle_and_width()) {
            // One outline is off by what the width is, the middle by half of that.
            let odd = ((ratio - self.ratio).abs() - self.spread).max(0.0);
            let odd_px = odd * half_width_px;
            return near(middle).then_some((middle, (sigma_px * sigma_px + odd_px * odd_px).sqrt()));
        }
        // Wider than the wire: something touches one side. The side nearer to its expected place is believed.
        let half = half_width_px * self.ratio;
        let low = section.low_px.map(|l| l + half).filter(|&m| near(m));
        let high = section.high_px.map(|h| h - half).filter(|&m| near(m));
        let middle = match (low, high) {
            (Some(l), Some(h)) if l.abs() > h.abs() => h,
            (Some(l), _) => l,
            (None, Some(h)) => h,
            (None, None) => return None,
        };
        Some((middle, ONE_SIDE_SIGMAS * sigma_px))
    }
}

impl Section {
    /// Seen width over that of the silhouette, where it may be one wire.
    pub fn ratio(&self, half_width_px: f64) -> Option<f64> {
        let (_, width) = self.middle_and_width()?;
        is_one_wire(width, 2.0 * half_width_px, ONE_WIRE).then_some(width / (2.0 * half_width_px))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn section(low: f64, high: f64) -> Section {
        Section { low_px: Some(low), high_px: Some(high), is_off_shadow: false }
    }

    #[test]
    fn a_wire_that_a_neighbour_touches_is_worth_less_there() {
        let mut ratios = [0.90, 0.91, 0.89, 0.90, 1.10, 0.90, 0.91];
        let usual = UsualWidth::of(&mut ratios).unwrap();
        assert_eq!(usual.ratio, 0.9);
        let (middle, sigma) = usual.middle_of(&section(-2.7, 2.7), 3.0, 1.5, 0.15).unwrap();
        assert_eq!((middle, sigma), (0.0, 0.15));
        // 0.6 pixels wider on one side: the middle is 0.3 off.
        let (middle, sigma) = usual.middle_of(&section(-2.7, 3.3), 3.0, 1.5, 0.15).unwrap();
        assert!((middle - 0.3).abs() < 1e-9 && sigma > 0.2, "{middle} {sigma}");
    }

    #[test]
    fn wire_of_a_pixel_or_two_is_seen_wider_than_it_is() {
        let seen = |width_px: f64, silhouette_px: f64| {
            section(-width_px / 2.0, width_px / 2.0).ratio(silhouette_px / 2.0).is_some()
        };
        assert!(seen(2.0, 1.2) && seen(2.3, 1.6) && !seen(3.0, 1.6));
        assert!(seen(4.7, 4.0) && !seen(4.9, 4.0) && !seen(1.9, 4.0));
    }

    #[test]
    fn of_a_wide_section_the_nearer_side_is_believed() {
        let usual = UsualWidth { ratio: 0.9, spread: 0.0 };
        let (middle, sigma) = usual.middle_of(&section(-2.6, 8.0), 3.0, 1.5, 0.15).unwrap();
        assert!((middle - 0.1).abs() < 1e-9 && sigma == 0.6, "{middle} {sigma}");
        assert_eq!(usual.middle_of(&Section::default(), 3.0, 1.5, 0.15), None);
        assert_eq!(UsualWidth::of(&mut []), None);
    }
}
