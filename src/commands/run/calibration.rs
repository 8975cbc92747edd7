//! What the pairs of a run together tell of the calibration.

use serde_json::{Value, json};

use crate::recognize::Turned;

/// Of so many pairs with parts the mean is taken, the newer ones weighing more; before so many nothing is said.
const PAIRS: u32 = 20;
/// A turn that is worth a new calibration, in pixels: about the baseline, and at the rim.
const LIMIT_PX: [f64; 2] = [0.15, 0.3];

/// How far the right camera has turned since the rig was calibrated.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Calibration {
    pairs: u32,
    mean_px: [f64; 2],
    is_off: bool,
}

impl Calibration {
    /// Takes what a pair tells; what is to be said, once it is certain.
    pub(super) fn pair(&mut self, turned: &Turned) -> Option<String> {
        self.pairs = self.pairs.saturating_add(1);
        let share = 1.0 / f64::from(self.pairs.min(PAIRS));
        for (mean_px, px) in self.mean_px.iter_mut().zip([turned.rows_px, turned.rim_px]) {
            *mean_px += share * (px - *mean_px);
        }
        let limits = if self.is_off { LIMIT_PX.map(|px| 0.5 * px) } else { LIMIT_PX };
        let is_off =
            self.is_told() && self.mean_px.iter().zip(limits).any(|(mean_px, px)| mean_px.abs() > px);
        let news = is_off && !self.is_off;
        self.is_off = is_off;
        news.then(|| format!("{}; what is certain of it is allowed for; calibrate again", self.words()))
    }

    fn is_told(&self) -> bool {
        self.pairs >= PAIRS
    }

    fn words(&self) -> String {
        let [rows_px, rim_px] = self.mean_px;
        format!(
            "the right camera has turned since it was calibrated: {rows_px:+.2} px across the baseline, {rim_px:+.2} px at the rim"
        )
    }

    /// For the table, where it is off.
    pub(super) fn text(&self) -> Option<String> {
        self.is_off.then(|| self.words())
    }

    /// For programs; `null` as long as there were too few pairs.
    pub(super) fn json(&self) -> Value {
        match self.is_told() {
            true => json!({ "rows_px": self.mean_px[0], "rim_px": self.mean_px[1], "is_off": self.is_off }),
            false => Value::Null,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_turned_camera_is_said_once_and_again_after_it_was_set_right() {
        let mut calibration = Calibration::default();
        let mut said = |rows_px: f64, pairs: u32| {
            let turned = Turned { rows_px, rows_sigma_px: 0.05, ..Turned::default() };
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
    fn a_few_pairs_tell_nothing() {
        let mut calibration = Calibration::default();
        let turned = Turned { rows_px: 2.0, ..Turned::default() };
        assert!((1..PAIRS).all(|_| calibration.pair(&turned).is_none()) && calibration.json().is_null());
        assert!(calibration.pair(&turned).is_some());
    }
}
