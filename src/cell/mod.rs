//! The cell itself: [`core`] decides, everything else carries.
//!
//! ```text
//!  left grab ──┐ frames              ┌── pairs ──▶ recognise ──┐
//!              ├──────────▶ arm ─────┤                         │ results
//!  right grab ─┘          (core,     └── notes, files ──▶ cold │
//!                          link)  ◀────────────────────────────┘
//! ```

pub mod carrier;
pub mod core;
pub mod desk;
pub mod fast;
pub mod notify;
pub mod pairing;
pub use firmware_bridge::realtime;
pub mod recogniser;
pub mod threads;
