//! The improved Harmony Search (paper III-C, equations (2) to (4); Mahdavi et al., doi:10.1016/j.amc.2006.11.033):
//! PAR grows and the bandwidth shrinks with the improvisations of a round.
//!
//! The bandwidth is counted in ranks along the curve ([`pool`](super::pool)): a note is moved by 1 to `bw` ranks up or
//! down. `bw_max` is a quarter of all ranks, `bw_min` is 1: the next node along the curve. At the ends of the scale a
//! note stays inside. Beyond NI improvisations the rates stay where they are.

use super::harmony::Params;
use super::pool::{Dice, Note, SILENT};

/// Equation (2).
pub fn pitch_rate(params: &Params, generation: u32) -> f64 {
    params.par_min + (params.par_max - params.par_min) * progress(params, generation)
}

/// How far a round has come, 0 to 1.
pub(super) fn progress(params: &Params, generation: u32) -> f64 {
    (generation as f64 / params.improvisations.max(1) as f64).min(1.0)
}

/// Equations (3) and (4) for each scale: `bw_max * exp(c * gn)` with `c = ln(bw_min / bw_max) / NI`.
pub fn bandwidth(params: &Params, generation: u32, ranks: [usize; 2]) -> [u32; 2] {
    ranks.map(|n| {
        let (widest, narrowest) = ((n as f64 / 4.0).max(1.0), 1.0);
        let exponent = (narrowest / widest).ln() * progress(params, generation);
        (widest * exponent.exp()).round() as u32
    })
}

/// A note moved within the bandwidth.
pub fn moved(note: Note, bandwidth: [u32; 2], ranks: [usize; 2], dice: &mut Dice) -> Note {
    if note == SILENT {
        return note;
    }
    let mut moved = note;
    for scale in 0..2 {
        let last = ranks[scale].saturating_sub(1) as i64;
        let step = 1 + dice.below(bandwidth[scale]) as i64;
        let step = if dice.below(2) == 0 { step } else { -step };
        moved[scale] = (note[scale] as i64 + step).clamp(0, last) as u16;
    }
    moved
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn rates_run_from_one_end_to_the_other_over_the_improvisations() {
        let params = Params { improvisations: 100, par_min: 0.1, par_max: 0.5, ..Params::default() };
        for (generation, rate) in [(0, 0.1), (50, 0.3), (100, 0.5), (900, 0.5)] {
            assert!((pitch_rate(&params, generation) - rate).abs() < 1e-12);
        }
        assert_eq!([0, 50, 100, 900].map(|g| bandwidth(&params, g, [64, 1])[0]), [16, 4, 1, 1]);
    }

    #[test]
    fn a_move_keeps_to_the_bandwidth_and_the_scale() {
        let mut dice = Dice(rand_pcg::Pcg32::seed_from_u64(5));
        for _ in 0..200 {
            let [a, b] = moved([2, 0], [5, 1], [40, 1], &mut dice);
            assert!(a <= 7 && b == 0);
        }
        assert_eq!(moved(SILENT, [5, 1], [40, 1], &mut dice), SILENT);
    }
}
