//! The `pickcell` program.
fn main() {}
