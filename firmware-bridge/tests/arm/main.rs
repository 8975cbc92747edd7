//! What every link and dialect must keep to, against simulated arms on a simulated clock.

mod bench;
mod campaign;
mod cell;
mod contract;
mod recorded;
