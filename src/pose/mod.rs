//! From a rough pose to one that agrees with the outlines in both pictures, with its uncertainty.
//!
//! | | |
//! |---|---|
//! | [`model`] | a part as stations along its wire |
//! | [`section`] | where its outline is, read across and along the wire |
//! | [`beside`] | where wire and the floor beside it are asked for their colours |
//! | [`gloss`] | how far down its light the outline of polished wire is |
//! | [`shadow`] | on which side of dark wire its shadow lies |
//! | [`refine`] | the pose that agrees best with all of them, and how sure it is |
//! | [`shading`], [`width`] | what light does to outlines, and what of it can be told from the part's own width |
//! | [`verify`] | what speaks for a pose and what against |
//! | [`slide`] | a part without ends goes to the middle of where it can lie |
//! | [`over`], [`contact`] | which of two wires lies on the other; wires do not go through each other |
//! | [`drawn`] | pictures of known poses, for examples |
//!
//! ```
//! use nalgebra::{Isometry3, Vector3};
//! use pickcell::part::Part;
//! use pickcell::pose::drawn::DrawnPair;
//! use pickcell::pose::model::PoseModel;
//! use pickcell::pose::refine::{Params, Refine};
//!
//! let rod = Part::read(concat!(env!("CARGO_MANIFEST_DIR"), "/replay/parts/rod-90.toml"))?;
//! let model = PoseModel::new(&rod);
//! let truth = Isometry3::new(Vector3::new(20.0, -10.0, 470.0), Vector3::new(0.0, 0.1, 0.9));
//! let drawn = DrawnPair::new(&[(&model, truth)]);
//! let views = drawn.views();
//!
//! // A rough pose, 3 mm and 3 degrees off.
//! let rough = truth * Isometry3::new(Vector3::new(2.0, 1.5, -1.5), Vector3::new(0.0, 0.03, 0.05));
//! // The drawing has no light: its outlines are those of the axis.
//! let params = Params { lift_radii: 0.0, ..Params::default() };
//! let mut refine = Refine::new(params, &drawn.rig);
//! let coarse = refine.coarse(&model, &rough, &views).unwrap();
//! let fit = refine.fine(&model, &coarse, &views).unwrap();
//! assert!((fit.left_from_part.translation.vector - truth.translation.vector).norm() < 0.3);
//!
//! // Without the binary pictures, where the rough pose is not far off.
//! let near = refine.near(&model, &rough, &views).unwrap();
//! assert!((near.translation.vector - truth.translation.vector).norm() < 1.0);
//! let far = truth * Isometry3::translation(0.0, 12.0, 0.0);
//! assert_eq!(refine.near(&model, &far, &views), None);
//! # Ok::<(), pickcell::part::PartError>(())
//! ```

mod aim;
pub mod beside;
pub mod contact;
pub mod drawn;
pub mod end;
pub mod gloss;
pub mod model;
mod outlines;
pub mod over;
pub mod refine;
pub mod section;
pub mod shading;
pub mod shadow;
pub mod slide;
mod sweep;
pub mod verify;
pub mod width;
