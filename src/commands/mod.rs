//! One file a command: parse, build, run, exit code.

pub mod accuracy;
pub mod check;
pub mod devices;
pub mod pictures;
pub mod recognize;
pub mod run;
pub mod session;
