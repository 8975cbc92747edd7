//! What a span costs between two candidates, measured once: the exact search comes back to a pair in many matches, and
//! so do the other way round and another span of the same length.

use super::candidates::Candidate;
use super::fitness::{Judge, is_bare};
use super::problem::Span;

/// A span between two candidates.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Measured {
    /// Difference of equation (7).
    pub length_3d_mm: f32,
    /// Sum over both pictures of the difference of equation (8).
    pub length_2d_px: f32,
    /// Background pixels of the `2 * looks` of both pictures.
    pub missing: u32,
}

/// Workspace that keeps the latest measures.
#[derive(Clone, Debug)]
pub struct Measures {
    /// By what was measured: the run, the span or another of its length, its candidates, the lower first.
    slots: Vec<(u64, Option<Measured>)>,
    run: u64,
    /// For every span the first one of its length.
    alike: Vec<u8>,
    /// Whatever the other spans cost, a match with more is over the limit.
    cost_max: f64,
    /// The most spans of the part that are measured in a match, and looks at both pictures on all of them.
    spans: f64,
    looks: f64,
}

const SLOTS_LOG2: u32 = 12;
/// The run is told by the highest 24 bits of a key, the span by the next 8.
const RUNS: u64 = 1 << 24;
const SPANS_KEPT: usize = 1 << 8;

impl Measures {
    /// Reserves all memory.
    pub fn new() -> Self {
        let (slots, alike) = (vec![(0, None); 1 << SLOTS_LOG2], Vec::with_capacity(SPANS_KEPT));
        Self { slots, run: 0, alike, cost_max: 0.0, spans: 1.0, looks: 1.0 }
    }

    /// Begins with a part and a pair of pictures; matches of a fitness of `fitness_max` or more are none.
    pub fn begin(&mut self, judge: &Judge, fitness_max: f64) {
        self.run += 1;
        if self.run == RUNS {
            self.slots.fill((0, None));
            self.run = 1;
        }
        let spans = &judge.model.spans;
        self.alike.clear();
        self.alike.extend(spans.iter().take(SPANS_KEPT).enumerate().map(|(k, span)| {
            let same = |s: &Span| s.length_mm == span.length_mm && s.looks == span.looks;
            spans[..k].iter().position(same).unwrap_or(k) as u8
        }));
        self.cost_max = fitness_max;
        let pieces = judge.model.pieces();
        self.spans = pieces.len().max(1) as f64;
        self.looks = pieces.iter().map(|s| 2 * s.looks).sum::<u32>().max(1) as f64;
    }

    /// The most spans of the part that are measured in a match, and looks at both pictures on all of them.
    #[inline]
    pub fn most(&self) -> (f64, f64) {
        (self.spans, self.looks)
    }

    /// What span `k` of the judge's part costs between two candidates; `None` where no match under the limit has it.
    #[inline]
    pub fn span(&mut self, judge: &Judge, all: &[Candidate], k: usize, a: u16, b: u16) -> Option<Measured> {
        let (low, high) = if a < b { (a, b) } else { (b, a) };
        let Some(&alike) = self.alike.get(k) else { return self.measure(judge, all, k, low, high) };
        let key = self.run << 40 | (alike as u64) << 32 | (low as u64) << 16 | high as u64;
        let slot = (key.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> (64 - SLOTS_LOG2)) as usize;
        if self.slots[slot].0 != key {
            self.slots[slot] = (key, self.measure(judge, all, k, low, high));
        }
        self.slots[slot].1
    }

    #[inline(never)]
    fn measure(&self, judge: &Judge, all: &[Candidate], k: usize, from: u16, to: u16) -> Option<Measured> {
        let ends = [&all[from as usize], &all[to as usize]];
        measure(judge, &judge.model.spans[k], ends, self.cost_max, self.spans, self.looks)
    }
}

/// What a span costs between two candidates; `None` where it is `left` or more, as one of `spans` spans with together
/// `looks` looks. What is cheap comes first. The other spans can only thin a cost out to its share of the mean.
#[inline]
pub(super) fn measure(
    judge: &Judge,
    span: &Span,
    [from, to]: [&Candidate; 2],
    mut left: f64,
    spans: f64,
    looks: f64,
) -> Option<Measured> {
    let w = &judge.weights;
    let length_3d_mm = judge.length_3d_mm(span, from, to);
    left -= length_3d_mm as f64 * w.length_3d_per_mm / spans;
    if left <= 0.0 {
        return None;
    }
    let length_2d_px = judge.length_2d_px(span, from, to);
    left -= length_2d_px as f64 * w.length_2d_per_px / (2.0 * spans);
    if left <= 0.0 {
        return None;
    }
    let enough = ((left * looks / w.missing) as u32).min(span.looks);
    let missing = judge.missing(span, from, to, enough);
    (missing <= enough && !is_bare(span, missing)).then_some(Measured { length_3d_mm, length_2d_px, missing })
}

impl Default for Measures {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matching::drawn::DrawnScene;

    #[test]
    fn a_span_is_measured_as_the_fitness_does_or_is_over_the_limit() {
        let scene = DrawnScene::new(3, 6, 4);
        let (judge, all) = (scene.judge(), scene.candidates.all());
        let mut measures = Measures::new();
        for fitness_max in [0.3, 2.0] {
            measures.begin(&judge, fitness_max);
            let mut kept = 0;
            for again in [false, true] {
                for k in 0..2 {
                    for n in 0..all.len() * all.len() {
                        let (from, to) = ((n / all.len()) as u16, (n % all.len()) as u16);
                        let (a, b) = (&all[from as usize], &all[to as usize]);
                        let span = &scene.model.spans[k];
                        let missing = judge.missing(span, a, b, u32::MAX);
                        let (l3, l2) = (judge.length_3d_mm(span, a, b), judge.length_2d_px(span, a, b));
                        let looks: u32 = scene.model.spans.iter().map(|s| 2 * s.looks).sum();
                        let cost = l3 as f64 * judge.weights.length_3d_per_mm / 2.0
                            + l2 as f64 * judge.weights.length_2d_per_px / 4.0
                            + missing as f64 * judge.weights.missing / looks as f64;
                        match measures.span(&judge, all, k, from, to) {
                            Some(m) => {
                                assert_eq!((m.length_3d_mm, m.length_2d_px, m.missing), (l3, l2, missing));
                                kept += !again as u32;
                            }
                            None => assert!(is_bare(span, missing) || cost > fitness_max * 0.999),
                        }
                    }
                }
            }
            assert!(kept >= 12);
        }
    }
}
