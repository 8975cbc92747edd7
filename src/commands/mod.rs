//! One file a command: parse, build, run, exit code.

pub mod accuracy;
