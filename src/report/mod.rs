//! Pictures for people: what each stage saw ([`stages`]), and the result on top of the camera's pictures
//! ([`overlay`]).
//!
//! Takes what recognition leaves behind and gives PNG bytes; decides nothing.

mod canvas;
mod font;
pub mod overlay;
mod places;
pub mod stages;

pub use canvas::{Canvas, Colour};
