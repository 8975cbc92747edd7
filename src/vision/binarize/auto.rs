//! A threshold from the histogram of the region.

use crate::frame::{Frame, LumaView};
use crate::vision::bits::BitImage;

/// Memory for finding thresholds.
#[derive(Clone, Debug)]
pub(super) struct Auto {
    histogram: [u32; 256],
}

impl Auto {
    pub(super) fn new(_width: usize, _height: usize) -> Self {
        Self { histogram: [0; 256] }
    }

    pub(super) fn run(
        &mut self,
        frame: &Frame,
        inverted: bool,
        region: Option<&BitImage>,
        bits: &mut BitImage,
    ) {
        bits.clear();
        let Some(luma) = LumaView::new(frame) else { return };
        self.histogram.fill(0);
        let inside = |x: usize, y: usize| region.is_none_or(|r| r.get(x as i32, y as i32));
        for y in (0..frame.height).step_by(4) {
            for x in (0..frame.width).step_by(4) {
                if inside(x, y) {
                    self.histogram[usize::from(luma.at(x, y))] += 1;
                }
            }
        }
        let total: u32 = self.histogram.iter().sum();
        let Some(threshold) = otsu(&self.histogram, total) else { return };
        for y in 0..frame.height {
            for x in 0..frame.width {
                if (luma.at(x, y) > threshold) != inverted {
                    bits.set(x, y, true);
                }
            }
        }
    }
}

/// The level that parts the histogram into two classes of greatest variance between them (Otsu 1979,
/// doi:10.1109/TSMC.1979.4310076); `None` where there are no two.
fn otsu(histogram: &[u32; 256], total: u32) -> Option<u8> {
    let sum: f64 = histogram.iter().enumerate().map(|(v, &n)| v as f64 * f64::from(n)).sum();
    let (mut below, mut sum_below) = (0.0, 0.0);
    let mut best = (0.0, None);
    for (v, &n) in histogram.iter().enumerate() {
        below += f64::from(n);
        sum_below += v as f64 * f64::from(n);
        let above = f64::from(total) - below;
        if below == 0.0 || above <= 0.0 {
            continue;
        }
        let contrast = (sum - sum_below) / above - sum_below / below;
        let between = below * above * contrast * contrast;
        if between > best.0 && contrast > 30.0 {
            best = (between, Some(v as u8));
        }
    }
    best.1
}
