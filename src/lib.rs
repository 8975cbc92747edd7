//! The driver of one robot cell: two webcams look into a bin of thin parts, the arm gets grasp targets.
//!
//! ```text
//! camera ─ FramePair ─ BitImage ─ Skeleton ─ Graph ─ StereoMatch ─ PartPose ─ GraspTarget ─ arm
//!          pair        binarize   thin       graph   harmony       pose       grasp
//! ```

pub mod camera;
pub mod config;
pub mod files;
pub mod frame;
pub mod handover;
pub mod part;
pub mod rig;
pub mod session;
pub mod time;
pub mod vision;
