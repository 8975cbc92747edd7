//! What a match that is not complete costs at least, which is when the exact search turns back.

use super::exhaustive::Tree;
use super::fitness::ROUNDING;
use super::measures::Measured;
use super::problem::Span;

/// What the matched nodes cost already, before weights and means.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Cost {
    pub(super) length_3d_mm: f32,
    pub(super) length_2d_px: f32,
    pub(super) missing: u32,
    pub(super) gap_px: f32,
    /// Spans with both ends matched, and looks at both pictures on them.
    pub(super) spans: u32,
    pub(super) looks: u32,
}

impl Cost {
    #[inline]
    fn add(&mut self, measured: Measured, span: &Span) {
        self.length_3d_mm += measured.length_3d_mm;
        self.length_2d_px += measured.length_2d_px;
        self.missing += measured.missing;
        self.spans += 1;
        self.looks += 2 * span.looks;
    }
}

/// Weights over the most that a mean can be taken of.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Rates {
    length_3d_per_mm: f64,
    length_2d_per_px: f64,
    missing: f64,
    gap_per_px: f64,
    left_out: f64,
}

impl Tree<'_, '_> {
    /// Where no more matches are kept, those that are no fitter than the kept ones need not be found.
    pub(super) fn limit(&self) -> f64 {
        self.found.threshold(self.limits.fitness_max)
    }

    /// Spans of an anchor that is left out are not measured, and lines through none but such anchors are: these are in the mean at
    /// most, for where more anchors are left out no more spans appear than vanish.
    pub(super) fn rates_now(&self) -> Rates {
        let (w, model) = (&self.judge.weights, self.judge.model);
        let (mut spans, mut looks) = (0, 0);
        let may_count = |s: &&Span| {
            (self.left_out >> s.from | self.left_out >> s.to) & 1 == 0 && s.through & !self.left_out == 0
        };
        for span in model.spans.iter().filter(may_count) {
            (spans, looks) = (spans + 1, looks + 2 * span.looks);
        }
        let (spans, looks) = (spans.max(1) as f64, looks.max(1) as f64);
        Rates {
            length_3d_per_mm: w.length_3d_per_mm / spans,
            length_2d_per_px: w.length_2d_per_px / (2.0 * spans),
            missing: w.missing / looks,
            gap_per_px: w.gap_per_px / model.anchors.len() as f64,
            left_out: self.left_out.count_ones() as f64 * w.unmatched,
        }
    }

    #[inline]
    fn rates(&self) -> &Rates {
        &self.rates[self.left_out.count_ones() as usize]
    }

    /// Whether what is matched costs too much already.
    #[inline]
    pub(super) fn is_over(&self, cost: &Cost) -> bool {
        let r = self.rates();
        let bound = cost.length_3d_mm as f64 * r.length_3d_per_mm
            + cost.length_2d_px as f64 * r.length_2d_per_px
            + cost.missing as f64 * r.missing
            + cost.gap_px as f64 * r.gap_per_px
            + r.left_out;
        bound >= self.limit() * ROUNDING
    }

    /// Whether candidate `n` for `anchor` puts the fitness over the limit by its place and lengths alone.
    #[inline]
    pub(super) fn is_out_of_length(&self, anchor: usize, n: usize, mut cost: Cost) -> bool {
        let new = &self.all[n];
        cost.gap_px += new.gap_px;
        for at in self.joints(anchor) {
            let (k, other) = self.joint(at);
            if let Some(other) = self.all.get(self.chosen[other] as usize).filter(|_| self.is_span(k)) {
                let span = &self.judge.model.spans[k];
                cost.length_3d_mm += self.judge.length_3d_mm(span, new, other);
                if self.is_over(&cost) {
                    return true;
                }
                cost.length_2d_px += self.judge.length_2d_px(span, new, other);
            }
        }
        self.is_over(&cost)
    }

    /// The cost with candidate `n` for `anchor`; `None` where it puts the fitness over the limit.
    pub(super) fn cost_with(&mut self, anchor: usize, n: usize, mut cost: Cost) -> Option<Cost> {
        cost.gap_px += self.all[n].gap_px;
        for at in self.joints(anchor) {
            let (k, other) = self.joint(at);
            if self.matched >> other & 1 == 1 && self.is_span(k) {
                cost.add(self.span(k, n as u16, self.chosen[other])?, &self.judge.model.spans[k]);
            }
        }
        (!self.is_over(&cost)).then_some(cost)
    }

    /// The cost where `anchor` is left out, and what it lies on is a span; `None` where it puts the fitness over the limit.
    pub(super) fn cost_without(&mut self, anchor: usize, mut cost: Cost) -> Option<Cost> {
        for k in self.lines_through(anchor) {
            let span = &self.judge.model.spans[k];
            cost.add(self.span(k, self.chosen[span.from], self.chosen[span.to])?, span);
        }
        (!self.is_over(&cost)).then_some(cost)
    }

    /// What span `k` costs between two candidates; `None` where that is too much for any match.
    #[inline]
    pub(super) fn span(&mut self, k: usize, a: u16, b: u16) -> Option<Measured> {
        self.search.measures.span(self.judge, self.all, k, a, b)
    }
}
