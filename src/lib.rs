//! The driver of one robot cell: two webcams look into a bin of thin parts, the arm gets grasp targets.
//!
//! ```text
//! camera ─ FramePair ─ BitImage ─ Skeleton ─ Graph ─ StereoMatch ─ PartPose ─ GraspTarget ─ arm
//!          pair        binarize   thin       graph   harmony       pose       grasp
//! ```

pub mod accuracy;
pub mod arm;
pub mod camera;
pub mod cell;
pub mod commands;
pub mod config;
pub mod files;
pub mod frame;
pub mod grasp;
pub mod handover;
pub mod matching;
pub mod part;
pub mod picture;
pub mod pose;
pub mod recognize;
pub mod report;
pub mod rig;
pub mod session;
pub mod telemetry;
pub mod time;
pub mod vision;
