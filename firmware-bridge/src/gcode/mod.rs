//! Arms that speak G-code: Grbl, Marlin, uArm.
//!
//! One engine ([`Driver`]) decides what is sent when, the same for all three: handshake, hold and release, the
//! lines of a pick one after another, standstill and position checked before a gripper moves and at the end. What
//! differs is the wire: how a line is numbered, acknowledged, refused and sent again, how the arm is asked where it
//! is, how it is stopped. The moves themselves are templates, checked when the program starts.
//! `firmware-bridge/GCODE.md` says all of it with the bytes.

mod defaults;
mod engine;
mod grbl;
pub(crate) mod line;
mod marlin;
pub mod template;
mod uarm;
mod values;
mod wire;
mod words;

pub use engine::Driver;
pub use grbl::Grbl;
pub use marlin::Marlin;
pub use uarm::Uarm;
