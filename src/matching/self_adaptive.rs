//! The self-adaptive Harmony Search (paper III-C, equations (5) and (6); Wang and Huang,
//! doi:10.1016/j.eswa.2009.09.008): the memory itself says how far a note may be moved.
//!
//! The largest and smallest value of a variable are the highest and lowest rank along the curve
//! ([`pool`](super::pool)) that the memory has for that anchor. A note is moved towards one or the other, with even
//! chances, by a random share of the way; so the move shrinks as the memory agrees. PAR falls with the improvisations
//! of a round from `par_max` to `par_min`, as in the source; the paper gives no equation for it.

use super::harmony::Params;
use super::improved::progress;
use super::pool::{Dice, Note, SILENT};

/// The rate of moving a note.
pub fn pitch_rate(params: &Params, generation: u32) -> f64 {
    params.par_max - (params.par_max - params.par_min) * progress(params, generation)
}

/// A note moved by equation (5) or (6); `column` are the memory's notes of the same anchor.
pub fn moved(note: Note, column: impl Iterator<Item = Note>, dice: &mut Dice) -> Note {
    if note == SILENT {
        return note;
    }
    let (mut low, mut high) = (note, note);
    for other in column.filter(|n| *n != SILENT) {
        for scale in 0..2 {
            low[scale] = low[scale].min(other[scale]);
            high[scale] = high[scale].max(other[scale]);
        }
    }
    let mut moved = note;
    for scale in 0..2 {
        let (up, share) = (dice.below(2) == 0, dice.share());
        let way = if up { high[scale] - note[scale] } else { note[scale] - low[scale] };
        let step = (way as f64 * share).round() as u16;
        moved[scale] = if up { note[scale] + step } else { note[scale] - step };
    }
    moved
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn a_move_stays_between_the_memory_s_lowest_and_highest() {
        let mut dice = Dice(rand_pcg::Pcg32::seed_from_u64(5));
        let column = [[4, 0], [9, 3], SILENT, [6, 1]];
        let met: Vec<Note> = (0..300).map(|_| moved([6, 1], column.iter().copied(), &mut dice)).collect();
        assert!(met.iter().all(|[a, b]| (4..=9).contains(a) && *b <= 3));
        assert!(met.iter().any(|n| n[0] == 4) && met.iter().any(|n| n[0] == 9));
        assert_eq!(moved([6, 1], [[6, 1]].into_iter(), &mut dice), [6, 1], "an agreed memory moves nothing");
    }

    #[test]
    fn the_rate_falls() {
        let params = Params { improvisations: 10, par_min: 0.2, par_max: 0.6, ..Params::default() };
        for (generation, rate) in [(0, 0.6), (5, 0.4), (10, 0.2), (90, 0.2)] {
            assert!((pitch_rate(&params, generation) - rate).abs() < 1e-12);
        }
    }
}
