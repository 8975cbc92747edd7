//! The matches that the searches of one part have met: each once, the fittest kept.

use super::fitness::StereoMatch;

/// Distinct matches under the threshold, with a limit.
#[derive(Clone, Debug)]
pub struct Found {
    matches: Vec<StereoMatch>,
    hashes: Vec<u64>,
    matches_max: usize,
    /// The greatest fitness.
    worst: f64,
}

impl Found {
    /// Memory for `matches_max` matches, one at least.
    pub fn new(matches_max: usize) -> Self {
        let matches_max = matches_max.max(1);
        Self {
            matches: Vec::with_capacity(matches_max),
            hashes: Vec::with_capacity(matches_max),
            matches_max,
            worst: f64::NEG_INFINITY,
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
        self.worst = f64::NEG_INFINITY;
    }

    /// Puts the fittest first; equal ones by their nodes.
    pub fn sort(&mut self) {
        self.matches
            .sort_unstable_by(|a, b| a.fitness.total_cmp(&b.fitness).then_with(|| a.nodes.cmp(&b.nodes)));
        self.hashes.clear();
        self.hashes.extend(self.matches.iter().map(hash));
    }

    /// Whether a match of these nodes is in.
    pub fn contains(&self, found: &StereoMatch) -> bool {
        self.place(found, hash(found)).is_some()
    }

    fn place(&self, found: &StereoMatch, hash: u64) -> Option<usize> {
        let same = |&(i, h): &(usize, &u64)| *h == hash && self.matches[i].nodes == found.nodes;
        self.hashes.iter().enumerate().find(same).map(|(i, _)| i)
    }

    /// The fitness from which on nothing more is kept: `fitness_max`, or that of the least fit where it is full.
    #[inline]
    pub fn threshold(&self, fitness_max: f64) -> f64 {
        if self.matches.len() < self.matches_max { fitness_max } else { fitness_max.min(self.worst) }
    }

    /// Takes a match; says whether it is new and was kept. Over the limit the least fit goes.
    pub fn insert(&mut self, found: StereoMatch) -> bool {
        let hash = hash(&found);
        let full = self.matches.len() == self.matches_max;
        if (full && found.fitness >= self.worst) || self.place(&found, hash).is_some() {
            return false;
        }
        if full {
            let worst = self.matches.iter().rposition(|m| m.fitness == self.worst).unwrap_or(0);
            self.matches.swap_remove(worst);
            self.hashes.swap_remove(worst);
        }
        self.matches.push(found);
        self.hashes.push(hash);
        self.worst = self.matches.iter().map(|m| m.fitness).fold(f64::NEG_INFINITY, f64::max);
        true
    }
}

fn hash(found: &StereoMatch) -> u64 {
    found.nodes.iter().fold(0xcbf2_9ce4_8422_2325, |h, &n| (h ^ n as u64).wrapping_mul(0x0100_0000_01b3))
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
        found.sort();
        assert_eq!(found.matches().iter().map(|m| m.fitness).collect::<Vec<_>>(), [0.1, 0.3]);
    }
}
