//! From a rough pose to one that agrees with the outlines in both pictures, with its uncertainty.

mod aim;
pub mod contact;
pub mod model;
pub mod over;
pub mod refine;
pub mod section;
pub mod shading;
pub mod slide;
mod sweep;
pub mod verify;
pub mod width;
