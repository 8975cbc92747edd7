//! The states of the drawing in [`super`].

/// What the arm is doing, as the drawing names it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// Not connected.
    Absent,
    /// On hold.
    Held,
    /// The controller refuses to move.
    Alarmed,
    /// Released, not ready yet.
    Releasing,
    /// Ready; a picture without the arm is waited for.
    Looking,
    /// A target is on its way to the wire.
    Ordered,
    /// Its last byte is on the wire.
    Sent,
    /// The arm has taken it.
    Accepted,
    /// The arm moves.
    Moving,
    /// The cell is ending.
    Stopping,
}

impl State {
    /// All of them, in order.
    pub const ALL: [State; 10] = [
        State::Absent,
        State::Held,
        State::Alarmed,
        State::Releasing,
        State::Looking,
        State::Ordered,
        State::Sent,
        State::Accepted,
        State::Moving,
        State::Stopping,
    ];
}

impl std::fmt::Display for State {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            State::Absent => "arm not connected",
            State::Held => "on hold",
            State::Alarmed => "controller in alarm",
            State::Releasing => "released, arm not ready yet",
            State::Looking => "looking",
            State::Ordered => "target ordered",
            State::Sent => "target sent",
            State::Accepted => "target accepted",
            State::Moving => "arm moving",
            State::Stopping => "stopping",
        })
    }
}
