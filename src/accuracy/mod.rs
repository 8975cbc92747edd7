//! How near recognition comes to the truth of rendered scenes.
//!
//! [`truth`] reads a folder of scenes, [`score`] compares what was recognised with what lies there.

pub mod score;
pub mod truth;
