//! When leaving an anchor out cannot pay, or another match is the same: the exact search's reasons not to visit most of
//! its tree.
//!
//! A match that leaves out an anchor is not given where one with a candidate for it is no less fit. Often that is certain
//! long before the match is complete: the candidate is at the right distance from everything that the open anchors may
//! still be, and the most that it can add to the means is less than what a left-out anchor costs.
//!
//! Adding values of sum X to a mean of sum S over n raises it by (X - x S/n) / (n + x), where x is their number: at most
//! by (X - x m) / (n' + x') for any m at most S/n, n' at most n, x' at most x, or not at all where that is negative.

use super::costs::Cost;
use super::exhaustive::{Exhaustive, Tree};
use super::fitness::UNMATCHED;
use super::neighbours::QUICK_WORDS;
use super::problem::Span;
use super::rows::CHUNK;

/// Rounding must not make a match out to be dominated that is not.
const MARGIN: f64 = 1e-6;
/// With more candidates an anchor is not asked about: too little is decided yet.
const CANDIDATES_MAX: u32 = 8;

impl Tree<'_, '_> {
    /// Whether another match is the same turned, and found, where this anchor is matched with candidate `n` or left out.
    #[inline]
    pub(super) fn is_turned(&self, anchor: usize, n: Option<usize>) -> bool {
        let Some((first, others)) = self.judge.model.turned else { return false };
        // What is left out comes behind all candidates.
        let n = n.map_or(UNMATCHED, |n| n as u16);
        if anchor == first {
            return (0..self.anchors()).any(|k| others >> k & 1 == 1 && self.chosen[k] < n);
        }
        let is_decided = (self.matched | self.left_out) >> first & 1 == 1;
        others >> anchor & 1 == 1 && is_decided && n < self.chosen[first]
    }

    /// Whether a left-out anchor could be matched too, for a fitness no worse, in every match that is still to come.
    pub(super) fn is_dominated(&mut self, depth: usize, open: u32, cost: &Cost) -> bool {
        if self.may_be_laid(depth, open) {
            return false;
        }
        let mut left_out = self.left_out;
        while left_out != 0 {
            let a = left_out.trailing_zeros() as usize;
            left_out &= left_out - 1;
            let measurable = cost.spans > 0 && !self.judge.model.has_lines() || self.is_joined(a);
            if !measurable || self.search.counts[depth][a] > CANDIDATES_MAX {
                continue;
            }
            for w in 0..self.words {
                let mut bits = self.domains(depth)[a * self.words + w];
                while bits != 0 {
                    let n = w * CHUNK + bits.trailing_zeros() as usize;
                    bits &= bits - 1;
                    // Rows of many words take long to fill: each is a step.
                    if self.words > QUICK_WORDS && !self.limits.allow_step(&mut self.search.steps) {
                        self.search.complete = false;
                        return true;
                    }
                    if self.goes_with_all(depth, a, n, open) && self.always_pays(depth, a, n, open, cost) {
                        return true;
                    }
                }
            }
        }
        false
    }

    /// Whether a match that is still to come may be one of which the whole part is laid, though it has spans: how much is missing so
    /// is not known before.
    fn may_be_laid(&self, depth: usize, open: u32) -> bool {
        let may_be_matched =
            |a: usize| self.matched >> a & 1 == 1 || open >> a & 1 == 1 && self.search.counts[depth][a] != 0;
        self.judge.model.has_lines() && (0..self.anchors()).any(|a| may_be_matched(a) && !self.is_joined(a))
    }

    /// Whether candidate `n` for anchor `a` goes with every candidate of the open anchors.
    fn goes_with_all(&mut self, depth: usize, a: usize, n: usize, open: u32) -> bool {
        let (words, all) = (self.words, self.anchors() * self.words);
        let Exhaustive { neighbours, domains, .. } = &mut *self.search;
        let (rows, domains) =
            (neighbours.of(self.candidates, a, n), &domains[depth * all..(depth + 1) * all]);
        let mut bits = open;
        while bits != 0 {
            let b = bits.trailing_zeros() as usize;
            bits &= bits - 1;
            let here = &domains[b * words..(b + 1) * words];
            if here.iter().zip(&rows[b * words..]).any(|(here, row)| here & !row != 0) {
                return false;
            }
        }
        true
    }

    /// Whether candidate `n` for the left-out anchor `a` lowers the fitness of whatever is matched in the end, which has a
    /// span.
    fn always_pays(&mut self, depth: usize, a: usize, n: usize, open: u32, cost: &Cost) -> bool {
        // what the spans of the anchor add at most
        let (mut length_3d_mm, mut length_2d_px, mut missing) = (0f64, 0f64, 0);
        // of these, spans to what is matched already
        let (mut spans, mut looks) = (0, 0);
        for at in self.joints(a) {
            let (k, other) = self.joint(at);
            let span = &self.judge.model.spans[k];
            if span.through & self.matched != 0 {
                continue;
            }
            if self.matched >> other & 1 == 1 {
                let Some(measured) = self.span(k, n as u16, self.chosen[other]) else { return false };
                length_3d_mm += measured.length_3d_mm as f64;
                length_2d_px += measured.length_2d_px as f64;
                missing += measured.missing;
                // What may turn out to be no span counts as one where that is worse.
                if self.is_span(k) {
                    (spans, looks) = (spans + 1, looks + 2 * span.looks as i32);
                }
            } else if open >> other & 1 == 1 {
                let Some(most) = self.most_of(depth, k, n, other) else { return false };
                length_3d_mm += most.0;
                length_2d_px += most.1;
                missing += most.2;
            }
        }
        let (w, model) = (&self.judge.weights, self.judge.model);
        // Lines through the anchor are no spans any more; of those that may be none in the end nothing is known but that they have no
        // more looks than their pieces.
        spans -= self.lines_through(a).count() as i32;
        let may_be_span = |span: &Span| {
            let may_be_matched = |end: usize| (self.matched | open) >> end & 1 == 1;
            let is_open = span.through >> a & 1 == 1 && span.through & self.matched == 0;
            is_open && may_be_matched(span.from) && may_be_matched(span.to)
        };
        for (_, span) in model.lines().filter(|(_, span)| may_be_span(span)) {
            looks -= 2 * span.looks as i32;
        }
        if spans < 0 {
            return false;
        }
        let looks = looks.max(0);
        let (spans_max, looks_max) = self.search.measures.most();
        let matched = self.matched.count_ones();
        let rise =
            |sum: f64, count: f64, mean: f64, base: f64| ((sum - count * mean) / (base + count)).max(0.0);
        let (x, x_looks) = (spans as f64, looks as f64);
        let (base, base_looks) = (cost.spans as f64, cost.looks as f64);
        let worse = w.length_3d_per_mm * rise(length_3d_mm, x, cost.length_3d_mm as f64 / spans_max, base)
            + w.length_2d_per_px / 2.0 * rise(length_2d_px, x, cost.length_2d_px as f64 / spans_max, base)
            + w.missing * rise(missing as f64, x_looks, cost.missing as f64 / looks_max, base_looks)
            + w.gap_per_px * rise(self.all[n].gap_px as f64, 1.0, 0.0, matched as f64);
        worse <= w.unmatched - MARGIN
    }

    /// The most that span `k` costs from candidate `n` to any candidate of the open anchor `other`;
    /// `None` where one of them is too much for any match.
    fn most_of(&mut self, depth: usize, k: usize, n: usize, other: usize) -> Option<(f64, f64, u32)> {
        let mut most = (0f64, 0f64, 0u32);
        for w in 0..self.words {
            let mut bits = self.domains(depth)[other * self.words + w];
            while bits != 0 {
                let c = (w * CHUNK) as u16 + bits.trailing_zeros() as u16;
                bits &= bits - 1;
                let measured = self.span(k, n as u16, c)?;
                most.0 = most.0.max(measured.length_3d_mm as f64);
                most.1 = most.1.max(measured.length_2d_px as f64);
                most.2 = most.2.max(measured.missing);
            }
        }
        Some(most)
    }
}
