//! The exact search for a part of two nodes that look alike and one span, as every straight wire is: its matches are
//! pairs of candidates.
//!
//! Takes and gives what [`exhaustive`](super::exhaustive) does and finds the same pairs, of the same fitness. Its tree
//! would keep rows, measures and domains for anchors that there are not. Here each pair is measured once and given both
//! ways round, also where the part looks the same turned: from its other end a refinement looks at other places of the
//! wire, and where much is covered one of the two may get there and the other not. A step is a candidate or a pair.

use super::candidates::{Candidate, Candidates};
use super::exhaustive::{Exhaustive, Limits};
use super::fitness::{Judge, ROUNDING, StereoMatch, Terms, UNMATCHED, may_be};
use super::found::Found;
use super::measures::measure;
use super::problem::{ANCHORS_MAX, MatchModel};
use super::rows::{self, CHUNK};

/// Whether all matches of a part are pairs that may be turned round.
pub(super) fn is_pair(model: &MatchModel) -> bool {
    let [a, b] = &model.anchors[..] else { return false };
    let [span] = &model.spans[..] else { return false };
    a.role == b.role && span.from != span.to && model.required() == 2
}

impl Exhaustive {
    /// The search of [`run`](Exhaustive::run), for a part that [`is_pair`].
    pub(super) fn run_pairs(
        &mut self,
        judge: &Judge,
        candidates: &Candidates,
        limits: Limits,
        found: &mut Found,
    ) {
        let (all, words) = (candidates.all(), candidates.points().words());
        let role = judge.model.anchors[0].role;
        let wanted_mm = [judge.model.distance_mm(0, 1) as f32];
        let Exhaustive { level, domains, steps, complete, .. } = self;
        let (domain, row) = domains.split_at_mut(words);
        let row = &mut row[..words];
        for (word, candidates) in domain.iter_mut().zip(all.chunks(CHUNK)) {
            let fits = |c: &Candidate| c.explained && may_be(role, c.role);
            *word = candidates.iter().enumerate().fold(0, |word, (n, c)| word | (fits(c) as u64) << n);
        }
        let gap_share = judge.weights.gap_per_px / 2.0;
        for n in 0..all.len() {
            if domain[n / CHUNK] >> (n % CHUNK) & 1 == 0 {
                continue;
            }
            if !limits.allow_step(steps) {
                *complete = false;
                return;
            }
            let from = &all[n];
            if from.gap_px as f64 * gap_share >= found.threshold(limits.fitness_max) * ROUNDING {
                continue;
            }
            let at = (from.point_mm, [from.left, from.right]);
            let tolerance_mm = judge.length_tolerance_mm as f32;
            rows::at_distance(*level, candidates.points(), at, &wanted_mm, tolerance_mm, row);
            // those before were its partners already
            for w in n / CHUNK..words {
                let after = if w == n / CHUNK { u64::MAX << (n % CHUNK) } else { u64::MAX };
                let mut bits = row[w] & domain[w] & after;
                while bits != 0 {
                    let m = w * CHUNK + bits.trailing_zeros() as usize;
                    bits &= bits - 1;
                    if !limits.allow_step(steps) {
                        *complete = false;
                        return;
                    }
                    let limit = found.threshold(limits.fitness_max);
                    if let Some(fitness) = pair_fitness(judge, [from, &all[m]], limit) {
                        let mut nodes = [UNMATCHED; ANCHORS_MAX];
                        [nodes[0], nodes[1]] = [from.stereo, all[m].stereo];
                        found.insert_new(StereoMatch { nodes, fitness });
                        [nodes[0], nodes[1]] = [all[m].stereo, from.stereo];
                        found.insert_new(StereoMatch { nodes, fitness });
                    }
                }
            }
        }
    }
}

/// The fitness of a pair at the model's distance; `None` where it is `limit` or more.
#[inline]
fn pair_fitness(judge: &Judge, [from, to]: [&Candidate; 2], limit: f64) -> Option<f64> {
    let (span, w) = (&judge.model.spans[0], &judge.weights);
    let gap_px = (from.gap_px + to.gap_px) as f64 / 2.0;
    let looks = f64::from(2 * span.looks);
    let left = limit * ROUNDING - gap_px * w.gap_per_px;
    let measured = measure(judge, span, [from, to], left, 1.0, looks)?;
    let terms = Terms {
        length_3d_mm: measured.length_3d_mm as f64,
        length_2d_px: measured.length_2d_px as f64 / 2.0,
        missing: f64::from(measured.missing) / looks,
        gap_px,
        unmatched: 0.0,
        contradictions: 0.0,
    };
    Some(terms.fitness(w)).filter(|fitness| *fitness < limit)
}
