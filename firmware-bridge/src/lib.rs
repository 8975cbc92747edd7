//! The arm's side of a PickCell: everything between a chosen grasp and the bytes on an arm's wire.
//!
//! | module | owns | |
//! |---|---|---|
//! | [`message`] | what the cell and an arm say to each other, whatever carries it | `no_std`, pure |
//! | [`codec`] | packets of the own protocol | `no_std`, pure |
//! | [`config`] | `[arm]`, `[workspace]`, `[gripper]` of cell.toml | cold |
//! | [`gate`] | the last check before a target is encoded | hot, pure |
//! | [`dialect`] | one state machine per language of arms: messages in, bytes out, and back | hot, pure |
//! | [`gcode`] | the dialects of G-code: move templates, Grbl, Marlin, uArm | hot but for the templates, pure |
//! | [`link`] | serial line, shared memory, simulated and recorded arm: what carries it | edge |
//! | [`log`] | standard error or the journal, of the driver too | edge |
//! | [`outside`] | signals, outputs and text files of a process, of the driver too | edge |
//! | [`realtime`] | rights that hot threads ask the system for, of the driver too | edge |
//! | [`simulate`] | the firmware's end of each language, with faults on demand | pure |
//!
//! Nothing here knows the driver. Pure modules get time (nanoseconds of `CLOCK_BOOTTIME`) and randomness as
//! arguments, and allocate nothing after `new`. Without the feature `std` only what a firmware needs is left.
#![cfg_attr(not(feature = "std"), no_std)]

pub mod codec;
pub mod message;

#[cfg(feature = "std")]
pub mod config;
#[cfg(feature = "std")]
pub mod dialect;
#[cfg(feature = "std")]
pub mod gate;
#[cfg(feature = "std")]
pub mod gcode;
#[cfg(feature = "std")]
pub mod link;
#[cfg(feature = "std")]
pub mod log;
#[cfg(feature = "std")]
pub mod outside;
#[cfg(feature = "std")]
pub mod realtime;
#[cfg(feature = "std")]
pub mod simulate;
