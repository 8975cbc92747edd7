//! Where an exact search ends.

use crate::time::Budget;

/// Where the search ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Matches of this fitness or more are not found.
    pub fitness_max: f64,
    /// What it may use up.
    pub budget: Budget,
    /// Most nodes of the tree that are visited.
    pub steps_max: u64,
}

impl Limits {
    /// Counts a step, if there is one left.
    #[inline]
    pub(super) fn allow_step(&self, steps: &mut u64) -> bool {
        let allowed = *steps != self.steps_max && !self.budget.is_spent(*steps);
        *steps += allowed as u64;
        allowed
    }
}
