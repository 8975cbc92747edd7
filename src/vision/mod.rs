//! Pixels to nodes and edges: [`binarize`](mod@binarize) (paper IV-A), [`thin`](mod@thin) (IV-B),
//! [`graph`](mod@graph) (IV-C), on [packed bit images](bits::BitImage).

pub mod beside;
pub mod binarize;
pub mod bits;
pub mod decode;
pub mod graph;
pub mod halve;
pub mod hue;
mod lanes;
pub mod luma;
pub mod ridge;
pub mod thin;
pub(crate) mod whole;
