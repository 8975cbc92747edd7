//! What light does to the outlines of a wire, and how far that may vary.

/// Standard deviations of what light does to the outlines of a wire, in radii.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shading {
    /// What the whole part seems displaced across, but for what a lamp at one side does to all parts.
    pub across: f64,
    /// Height above the axis of the line that is seen, between lamps: the whole part seems displaced along the line of
    /// sight.
    pub lift: f64,
    /// Change of the first from one end of a straight piece of wire to the other.
    pub turn_across: f64,
    /// Change of the second.
    pub turn_lift: f64,
    /// What moves an end outwards in both pictures.
    pub end: f64,
    /// Height above the axis of the line that is seen of an end.
    pub end_lift: f64,
}

impl Shading {
    /// The same on polished wire, whose bright line is not where light and shade of a dull one would be.
    pub fn polished(self) -> Self {
        self.times(2.0)
    }

    /// So many times as much.
    pub fn times(self, times: f64) -> Self {
        let Self { across, lift, turn_across, turn_lift, end, end_lift } = self;
        Self {
            across: times * across,
            lift: times * lift,
            turn_across: times * turn_across,
            turn_lift: times * turn_lift,
            end: times * end,
            end_lift: times * end_lift,
        }
    }
}

impl Default for Shading {
    fn default() -> Self {
        Self { across: 0.02, lift: 0.07, turn_across: 0.035, turn_lift: 0.14, end: 0.025, end_lift: 0.15 }
    }
}
