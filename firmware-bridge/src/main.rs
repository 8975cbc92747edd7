//! `firmware-bridge`: the arm's side as a process of its own.

fn main() {}
