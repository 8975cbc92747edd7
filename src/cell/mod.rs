//! The cell itself: [`core`] decides, everything else carries.

pub mod core;
pub mod pairing;
