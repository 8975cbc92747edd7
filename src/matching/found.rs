//! The matches that the searches of one part have met: each once, the fittest kept.

use super::fitness::StereoMatch;

/// Distinct matches under the threshold, with a limit.
#[derive(Clone, Debug)]
pub struct Found {
    matches: Vec<StereoMatch>,
    /// Of the first so many matches; the rest is worked out where one is looked for.
    hashes: Vec<u64>,
    /// Scratch of [`sort`](Self::sort).
    ranked: Vec<(i64, u16)>,
    unsorted: Vec<StereoMatch>,
    matches_max: usize,
    /// The greatest fitness, where there are as many as are kept.
    worst: f64,
}

impl Found {
    /// Memory for `matches_max` matches, one at least and 65 535 at most.
    pub fn new(matches_max: usize) -> Self {
        let matches_max = matches_max.clamp(1, u16::MAX as usize);
        Self {
            matches: Vec::with_capacity(matches_max),
            hashes: Vec::with_capacity(matches_max),
            ranked: Vec::with_capacity(matches_max),
            unsorted: Vec::with_capacity(matches_max),
            matches_max,
            worst: f64::INFINITY,
        }
    }

    /// The matches, fittest first after [`sort`](Self::sort).
    pub fn matches(&self) -> &[StereoMatch] {
        &self.matches
    }

    /// Forgets all.
    pub fn clear(&mut self) {
        self.matches.clear();
        self.hashes.clear();
    }

    /// Puts the fittest first; equal ones by their nodes.
    pub fn sort(&mut self) {
        let Self { matches, hashes, ranked, unsorted, .. } = self;
        unsorted.clear();
        unsorted.extend_from_slice(matches);
        ranked.clear();
        ranked.extend(unsorted.iter().enumerate().map(|(n, m)| (in_order(m.fitness), n as u16)));
        ranked.sort_unstable_by(|a, b| {
            a.0.cmp(&b.0).then_with(|| unsorted[a.1 as usize].nodes.cmp(&unsorted[b.1 as usize].nodes))
        });
        matches.clear();
        matches.extend(ranked.iter().map(|&(_, n)| unsorted[n as usize]));
        hashes.clear();
    }

    /// Whether a match of these nodes is in.
    pub fn contains(&mut self, found: &StereoMatch) -> bool {
        let known = self.hashes.len();
        self.hashes.extend(self.matches[known..].iter().map(hash));
        let hash = hash(found);
        let same = |(i, h): (usize, &u64)| *h == hash && self.matches[i].nodes == found.nodes;
        self.hashes.iter().enumerate().any(same)
    }

    /// The fitness from which on nothing more is kept: `fitness_max`, or that of the least fit where it is full.
    #[inline]
    pub fn threshold(&self, fitness_max: f64) -> f64 {
        if self.matches.len() < self.matches_max { fitness_max } else { fitness_max.min(self.worst) }
    }

    /// Takes a match; says whether it is new and was kept. Over the limit the least fit goes.
    pub fn insert(&mut self, found: StereoMatch) -> bool {
        !self.contains(&found) && self.insert_new(found)
    }

    /// Takes a match that is not in; says whether it was kept. Over the limit the least fit goes.
    pub fn insert_new(&mut self, found: StereoMatch) -> bool {
        if self.matches.len() == self.matches_max {
            if found.fitness >= self.worst {
                return false;
            }
            let worst = self.matches.iter().rposition(|m| m.fitness == self.worst).unwrap_or(0);
            self.matches.swap_remove(worst);
            self.hashes.truncate(worst);
        }
        self.matches.push(found);
        if self.matches.len() == self.matches_max {
            let worse = |a: f64, m: &StereoMatch| if m.fitness > a { m.fitness } else { a };
            self.worst = self.matches.iter().fold(f64::NEG_INFINITY, worse);
        }
        true
    }
}

/// A number that is in the order of [`f64::total_cmp`].
fn in_order(value: f64) -> i64 {
    let bits = value.to_bits() as i64;
    bits ^ (((bits >> 63) as u64) >> 1) as i64
}

fn hash(found: &StereoMatch) -> u64 {
    let word = |four: &[u16; 4]| four.iter().fold(0, |word, &n| word << 16 | n as u64);
    let (fours, _) = found.nodes.as_chunks::<4>();
    fours.iter().fold(0xcbf2_9ce4_8422_2325, |h, four| (h ^ word(four)).wrapping_mul(0x9e37_79b9_7f4a_7c15))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matching::problem::ANCHORS_MAX;

    #[test]
    fn each_match_is_kept_once_and_the_fittest_stay() {
        let of = |n: u16, fitness: f64| StereoMatch { nodes: [n; ANCHORS_MAX], fitness };
        let mut found = Found::new(2);
        assert!(found.insert(of(1, 0.5)) && !found.insert(of(1, 0.5)));
        assert!(found.threshold(1.0) == 1.0 && found.insert(of(2, 0.3)) && found.threshold(1.0) == 0.5);
        assert!(!found.insert(of(3, 0.9)));
        assert!(found.insert(of(4, 0.1)) && found.contains(&of(4, 0.1)) && !found.contains(&of(1, 0.5)));
        assert!(!found.insert(of(4, 0.0)) && found.insert_new(of(5, -0.0)) && !found.contains(&of(2, 0.3)));
        found.sort();
        assert_eq!(found.matches().iter().map(|m| m.fitness).collect::<Vec<_>>(), [0.0, 0.1]);
    }
}
