//! What a harmony is made of: notes, and the pool that they are drawn from.
//!
//! A variable of a harmony is an anchor of the part; its value, a [`Note`], says which nodes of both pictures are
//! taken for it. Nodes are discrete and have no natural order, but neighbours on the wire and on the floor are
//! neighbours in the picture. So nodes are numbered along a Hilbert curve through the picture: these ranks are the
//! scale on which a bandwidth, a largest and a smallest value mean something.
//!
//! * Closed gate: a note is the rank of a candidate (a stereo node), by its left node.
//! * Open gate: a note is two ranks, one of a left node and one of a right node, moved apart from each other.
//! * [`SILENT`]: the anchor is not matched. Drawn only with a closed gate and for parts that hold a pose without all
//!   nodes; the paper matches all.

use rand::Rng;
use rand_pcg::Pcg32;

use super::candidates::{Candidate, Candidates};
use super::fitness::{Judge, StereoMatch, Terms, UNMATCHED};
use super::length_table::LengthTable;
use super::open::{OpenPairs, Pictures};
use super::problem::ANCHORS_MAX;

/// The value of one variable: ranks along the curves.
pub type Note = [u16; 2];

/// An anchor that is not matched.
pub const SILENT: Note = [u16::MAX; 2];

/// The candidates of one part.
pub enum Pool<'a> {
    /// Stereo nodes that can be one point.
    Gated {
        /// All of them, along the curve.
        candidates: &'a Candidates,
        /// The pairs of this part's lengths.
        table: &'a LengthTable,
        /// Whether notes are drawn from the table.
        by_length: bool,
    },
    /// Any left node with any right node.
    Open {
        /// The table of those asked for.
        pairs: &'a mut OpenPairs,
        /// Where they come from.
        pictures: Pictures<'a>,
    },
}

/// Once in so many draws the first anchor is left out, where the part can spare it.
const FIRST_SILENT: u32 = 8;

impl Pool<'_> {
    /// Whether there is nothing to draw.
    pub fn is_empty(&self) -> bool {
        match self {
            Pool::Gated { candidates, .. } => candidates.all().is_empty(),
            Pool::Open { pairs, .. } => pairs.is_empty(),
        }
    }

    /// How many ranks there are on each scale.
    pub fn ranks(&self) -> [usize; 2] {
        match self {
            Pool::Gated { candidates, .. } => [candidates.all().len(), 1],
            Pool::Open { pairs, .. } => pairs.len(),
        }
    }

    /// The anchor at a place of the order in which a harmony is made, and the one it hangs on.
    #[inline]
    pub fn anchor(&self, place: usize, anchors: usize) -> (usize, usize) {
        match self {
            Pool::Gated { table, .. } => table.anchor(place),
            // Algorithm 3 takes them as they come; before the first is the last
            Pool::Open { .. } => (place, (place + anchors - 1) % anchors),
        }
    }

    /// A random note for the anchor at `place`; `parent` is the note of the anchor it hangs on.
    pub fn draw(&self, place: usize, parent: Note, can_spare: bool, dice: &mut Dice) -> Note {
        let (table, by_length) = match self {
            Pool::Open { pairs, .. } => return pairs.len().map(|n| dice.below(n as u32) as u16),
            Pool::Gated { table, by_length, .. } => (table, *by_length),
        };
        let list = match place {
            0 if can_spare && dice.below(FIRST_SILENT) == 0 => return SILENT,
            0 if by_length => table.first(),
            _ if by_length && parent != SILENT => table.at_length(place, parent[0] as usize),
            _ => table.fitting(place),
        };
        let list = if list.is_empty() && !can_spare { table.fitting(place) } else { list };
        let silent = (can_spare && place > 0) as usize;
        match list.get(dice.below((list.len() + silent) as u32) as usize) {
            Some(&rank) => [rank, 0],
            None => SILENT,
        }
    }

    /// Another candidate at the model's distance from the parent's; `None` where the table knows none.
    pub fn neighbour_at_length(&self, place: usize, parent: Note, dice: &mut Dice) -> Option<Note> {
        let Pool::Gated { table, by_length: true, .. } = self else { return None };
        let list = match place {
            0 => table.first(),
            _ if parent == SILENT => return None,
            _ => table.at_length(place, parent[0] as usize),
        };
        list.get(dice.below(list.len() as u32) as usize).map(|&rank| [rank, 0])
    }

    fn candidate(&mut self, note: Note) -> Candidate {
        match self {
            Pool::Gated { candidates, .. } => candidates.all()[note[0] as usize],
            Pool::Open { pairs, pictures } => pairs.candidate(pictures, note),
        }
    }

    /// The terms of a harmony, `None` where its fitness is `limit` or more.
    pub fn judge(&mut self, judge: &Judge, notes: &[Note], limit: f64) -> Option<Terms> {
        let empty = Candidate::unexplained(0, 0);
        let mut few = [empty; 4];
        let mut many;
        let played: &mut [Candidate] = if notes.len() <= few.len() {
            &mut few
        } else {
            many = [empty; ANCHORS_MAX];
            &mut many
        };
        for (played, &note) in played.iter_mut().zip(notes).filter(|(_, n)| **n != SILENT) {
            *played = self.candidate(note);
        }
        let mut chosen = [None; ANCHORS_MAX];
        for ((chosen, played), note) in chosen.iter_mut().zip(played.iter()).zip(notes) {
            *chosen = (*note != SILENT).then_some(played);
        }
        judge.terms(&chosen[..notes.len()], limit)
    }

    /// A harmony as a match; `None` where there is no room for its stereo nodes.
    pub fn match_of(&mut self, notes: &[Note], fitness: f64) -> Option<StereoMatch> {
        let mut nodes = [UNMATCHED; ANCHORS_MAX];
        for (node, &note) in nodes.iter_mut().zip(notes).filter(|(_, n)| **n != SILENT) {
            let candidate = self.candidate(note);
            *node = match self {
                Pool::Gated { .. } => candidate.stereo,
                Pool::Open { pairs, pictures } => pairs.stereo_node(pictures, &candidate)?,
            };
        }
        Some(StereoMatch { nodes, fitness })
    }
}

/// Random numbers that are the same on every machine.
#[derive(Clone, Debug)]
pub struct Dice(pub Pcg32);

impl Dice {
    /// From 0 to `n - 1`, or 0 for `n` = 0; even to within n / 2^32.
    #[inline]
    pub fn below(&mut self, n: u32) -> u32 {
        ((self.0.next_u32() as u64 * n as u64) >> 32) as u32
    }

    /// From 0 up to but not including 1.
    #[inline]
    pub fn share(&mut self) -> f64 {
        self.0.next_u32() as f64 / (1u64 << 32) as f64
    }
}
