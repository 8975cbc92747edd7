//! What the pairs of a run together tell of the calibration.

use serde_json::{Value, json};

use crate::recognize::{Doubt, Turned};

/// So many pairs with parts the mean is taken of, the newer ones weighing more; before so many nothing is said. Nor is it said
/// that ends lie apart before so many pairs in a row have it.
const PAIRS: u32 = 20;
/// A turn that is worth a new calibration, in pixels: about the baseline, at the rim, and along the baseline, where lengths in
/// part files that are wrong by half a percent look the same.
const LIMIT_PX: [f64; 3] = [0.15, 0.3, 1.0];
/// What is said is so many standard deviations large.
const CERTAIN_SIGMAS: f64 = 3.0;

/// How far the right camera has turned since the rig was calibrated.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Calibration {
    pairs: u32,
    /// About the baseline, at the rim, along the baseline.
    means: [Mean; 3],
    /// Pairs in a row whose ends lie apart.
    apart: u32,
    is_off: bool,
}

/// A mean of what weighs by its standard deviation and its age.
#[derive(Clone, Copy, Debug, Default)]
struct Mean {
    px: f64,
    weight: f64,
}

impl Mean {
    fn add(&mut self, px: f64, sigma_px: f64) {
        let weight = sigma_px.powi(-2);
        self.weight = self.weight * (1.0 - 1.0 / f64::from(PAIRS)) + weight;
        self.px += weight / self.weight * (px - self.px);
    }

    fn is_above(&self, limit_px: f64) -> bool {
        self.px.abs() > limit_px.max(CERTAIN_SIGMAS / self.weight.sqrt())
    }
}

impl Calibration {
    /// Takes what a pair tells; what is to be said, once it is certain.
    pub(super) fn pair(&mut self, turned: &Turned) -> Option<String> {
        self.apart = if turned.doubt == Some(Doubt::EndsApart) { self.apart.saturating_add(1) } else { 0 };
        // What then is recognised by chance tells nothing.
        if self.apart == 0 {
            self.add(turned);
        }
        let share = if self.is_off { 0.5 } else { 1.0 };
        let is_above = |(mean, limit_px): (&Mean, f64)| mean.is_above(share * limit_px);
        let is_turned = self.is_told() && self.means.iter().zip(LIMIT_PX).any(is_above);
        let is_off = is_turned || self.are_apart();
        let news = is_off && !self.is_off;
        self.is_off = is_off;
        news.then(|| format!("{}; calibrate again", self.words()))
    }

    fn add(&mut self, turned: &Turned) {
        self.pairs = self.pairs.saturating_add(1);
        let told = [
            (turned.rows_px, turned.rows_sigma_px),
            (turned.rim_px, turned.rim_sigma_px),
            (turned.along_px, turned.along_sigma_px),
        ];
        for (mean, (px, sigma_px)) in self.means.iter_mut().zip(told) {
            mean.add(px, sigma_px);
        }
    }

    fn are_apart(&self) -> bool {
        self.apart >= PAIRS
    }

    fn is_told(&self) -> bool {
        self.pairs >= PAIRS
    }

    fn words(&self) -> String {
        let [rows_px, rim_px, along_px] = self.means.map(|mean| mean.px);
        if self.are_apart() {
            return Turned { doubt: Some(Doubt::EndsApart), ..Turned::default() }.to_string();
        }
        let is_above = |n: usize| self.means[n].is_above(0.5 * LIMIT_PX[n]);
        let mut words = Vec::new();
        if is_above(0) || is_above(1) {
            let turned = Turned { rows_px, rim_px, ..Turned::default() };
            words.push(format!("{turned}; what is certain of that is allowed for"));
        }
        if is_above(2) {
            let longer = if along_px > 0.0 { "longer" } else { "shorter" };
            words.push(format!(
                "parts look {longer} than their files say: either these are wrong, or the right camera has turned by \
                 {along_px:+.2} px along the baseline and heights are wrong"
            ));
        }
        words.join("; ")
    }

    /// For the table, where it is off.
    pub(super) fn text(&self) -> Option<String> {
        self.is_off.then(|| self.words())
    }

    /// For programs; `null` as long as there were too few pairs.
    pub(super) fn json(&self) -> Value {
        if !self.is_told() && !self.is_off {
            return Value::Null;
        }
        let [rows_px, rim_px, along_px] = self.means.map(|mean| self.is_told().then_some(mean.px));
        json!({
            "rows_px": rows_px,
            "rim_px": rim_px,
            "along_px": along_px,
            "are_ends_apart": self.are_apart(),
            "is_off": self.is_off,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn turned(rows_px: f64, rim_px: f64, sigma_px: f64) -> Turned {
        let along_sigma_px = sigma_px;
        Turned {
            rows_px,
            rows_sigma_px: sigma_px,
            rim_px,
            rim_sigma_px: sigma_px,
            along_sigma_px,
            ..Turned::default()
        }
    }

    #[test]
    fn a_turned_camera_is_said_once_and_again_after_it_was_set_right() {
        let mut calibration = Calibration::default();
        let mut said = |rows_px: f64, pairs: u32| {
            let turned = turned(rows_px, 0.0, 0.05);
            (0..pairs).filter_map(|_| calibration.pair(&turned)).collect::<Vec<_>>()
        };
        assert!(said(0.1, 100).is_empty() && said(0.9, 1).is_empty(), "one pair is none");
        let words = said(0.5, 100);
        assert!(words.len() == 1 && words[0].contains("px across the baseline"), "{words:?}");
        assert!(said(0.12, 100).is_empty() && said(0.5, 100).is_empty());
        assert!(said(0.0, 100).is_empty());
        assert_eq!(said(-0.5, 100).len(), 1);
        assert!(calibration.text().is_some_and(|words| words.contains("-0.50 px across")));
        assert!(calibration.json()["rows_px"].as_f64().is_some_and(|px| (px + 0.5).abs() < 0.01));
    }

    #[test]
    fn parts_that_look_longer_than_their_files_are_said() {
        let mut calibration = Calibration::default();
        let longer = Turned { along_px: 1.2, ..turned(0.0, 0.0, 0.05) };
        let words: Vec<String> = (0..PAIRS).filter_map(|_| calibration.pair(&longer)).collect();
        assert!(words.len() == 1 && words[0].starts_with("parts look longer"), "{words:?}");
        let (shorter_px, rows_px) = (-1.2, 0.5);
        for _ in 0..100 {
            calibration.pair(&Turned { along_px: shorter_px, ..turned(rows_px, 0.0, 0.05) });
        }
        let words = calibration.text().unwrap();
        assert!(words.contains("+0.50 px across") && words.contains("parts look shorter"), "{words}");
    }

    #[test]
    fn ends_that_lie_apart_are_said_and_what_is_recognised_then_tells_nothing() {
        let mut calibration = Calibration::default();
        let apart = Turned { doubt: Some(Doubt::EndsApart), ..turned(3.0, 0.0, 0.05) };
        assert!((1..PAIRS).all(|_| calibration.pair(&apart).is_none()) && calibration.json().is_null());
        let words = calibration.pair(&apart).unwrap();
        assert!(words.contains("do not stand as they were calibrated; calibrate again"), "{words}");
        let told = calibration.json();
        assert!(told["are_ends_apart"] == true && told["rows_px"].is_null(), "{told}");
        assert!((0..2 * PAIRS).all(|_| calibration.pair(&turned(0.0, 0.0, 0.05)).is_none()));
        assert_eq!((calibration.text(), &calibration.json()["is_off"]), (None, &Value::Bool(false)));
    }

    #[test]
    fn what_pairs_hardly_know_is_not_said() {
        let mut calibration = Calibration::default();
        for _ in 0..50 {
            assert_eq!(calibration.pair(&turned(0.05, 2.0, 6.0)), None);
        }
        // One that knows outweighs them all.
        assert!(calibration.pair(&turned(0.5, 0.0, 0.05)).is_some());
    }

    #[test]
    fn a_few_pairs_tell_nothing() {
        let mut calibration = Calibration::default();
        let turned = turned(2.0, 0.0, 0.05);
        assert!((1..PAIRS).all(|_| calibration.pair(&turned).is_none()) && calibration.json().is_null());
        assert!(calibration.pair(&turned).is_some());
    }
}
