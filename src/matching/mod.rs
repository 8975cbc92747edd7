//! Nodes of both pictures matched with the part's model (paper III and IV-D), and the pose that follows.
//!
//! ```text
//! Graph ─ nodes ─ ImageNode ─ gate ─ StereoNode ─ candidates ─ search ─ StereoMatch ─ hypotheses ─ pose
//!                                                              │ exhaustive, harmony, random
//!                                                              └ fitness
//! ```

pub mod candidates;
pub mod claims;
mod costs;
mod dominance;
pub mod drawn;
pub mod exhaustive;
pub mod fitness;
pub mod found;
pub mod gate;
pub mod harmony;
pub mod hypotheses;
pub mod improved;
pub mod length_table;
mod limits;
pub mod lines;
pub mod looks;
pub mod measures;
pub mod neighbours;
pub mod nodes;
pub mod open;
mod pairs;
pub mod placement;
pub mod pool;
pub mod problem;
pub mod random;
pub mod rows;
pub mod search;
pub mod select;
pub mod self_adaptive;
