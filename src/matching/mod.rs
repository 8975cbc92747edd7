//! Nodes of both pictures matched with the part's model (paper III and IV-D), and the pose that follows.

pub mod exhaustive;
pub mod fitness;
pub mod hypotheses;
pub mod nodes;
pub mod placement;
pub mod problem;
pub mod select;
