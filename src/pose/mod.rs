//! From a rough pose to one that agrees with the outlines in both pictures, with its uncertainty.
//!
//! | | |
//! |---|---|
//! | [`model`] | a part as stations along its wire |
//! | [`section`] | where its outline is, read across and along the wire |
//! | [`gloss`] | how far down its light the outline of polished wire is |
//! | [`refine`] | the pose that agrees best with all of them, and how sure it is |
//! | [`shading`], [`width`] | what light does to outlines, and what of it can be told from the part's own width |
//! | [`verify`] | what speaks for a pose and what against |
//! | [`slide`] | a part without ends goes to the middle of where it can lie |
//! | [`over`], [`contact`] | which of two wires lies on the other; wires do not go through each other |
//!
//! ```
//! use nalgebra::{Isometry3, Point3, Vector3};
//! use pickcell::frame::{Frame, LumaView, PixelFormat};
//! use pickcell::part::Part;
//! use pickcell::pose::model::PoseModel;
//! use pickcell::pose::refine::{Params, Refine, View};
//! use pickcell::pose::section::Profiler;
//! use pickcell::rig::{CameraModel, Rig};
//! use pickcell::vision::bits::BitImage;
//!
//! let camera = CameraModel::pinhole(640, 480, 600.0, 320.0, 240.0);
//! let rig = Rig { left: camera, right: camera, right_from_left: Isometry3::translation(-60.0, 0.0, 0.0) };
//! let rod = Part::read(concat!(env!("CARGO_MANIFEST_DIR"), "/replay/parts/rod-90.toml"))?;
//! let model = PoseModel::new(&rod);
//!
//! // Two pictures of it, drawn: bright where the ray through a pixel passes within a radius of its axis.
//! let truth = Isometry3::new(Vector3::new(20.0, -10.0, 470.0), Vector3::new(0.0, 0.1, 0.9));
//! let axis = rod.straight_axis().unwrap();
//! let half_mm = model.length_mm / 2.0;
//! let cameras_from_left = [Isometry3::identity(), rig.right_from_left];
//! let drawn = cameras_from_left.map(|camera_from_left| {
//!     let ends = [-half_mm, half_mm]
//!         .map(|mm| camera.project(&(camera_from_left * (truth * Point3::from(axis.scale(mm))))).unwrap());
//!     let (along, radius_px) = ((ends[1] - ends[0]).normalize(), model.radius_mm * 600.0 / 470.0);
//!     let mut bytes = Vec::new();
//!     let mut mask = BitImage::new(640, 480);
//!     for (y, x) in (0..480).flat_map(|y| (0..640).map(move |x| (y, x))) {
//!         let from = nalgebra::Vector2::new(x as f64, y as f64) - ends[0];
//!         let (at, beside) = (from.dot(&along), from.perp(&along).abs());
//!         let inside = (radius_px - beside).min(at).min((ends[1] - ends[0]).norm() - at);
//!         bytes.push((120.0 + 160.0 * inside.clamp(-0.5, 0.5)) as u8);
//!         mask.set(x, y, inside >= 0.0);
//!     }
//!     (Frame::from_grey(640, 480, bytes), mask)
//! });
//! let [left, right] = [0, 1].map(|side| View {
//!     camera: &camera,
//!     camera_from_left: cameras_from_left[side],
//!     rotation: cameras_from_left[side].rotation.to_rotation_matrix().into_inner(),
//!     profiler: Profiler::new(LumaView::new(&drawn[side].0).unwrap(), false, 12.0),
//!     mask: &drawn[side].1,
//! });
//!
//! // A rough pose, 3 mm and 3 degrees off.
//! let rough = truth * Isometry3::new(Vector3::new(2.0, 1.5, -1.5), Vector3::new(0.0, 0.03, 0.05));
//! // The drawing has no light: its outlines are those of the axis.
//! let params = Params { lift_radii: 0.0, ..Params::default() };
//! let mut refine = Refine::new(params, &rig);
//! let coarse = refine.coarse(&model, &rough, &[left, right]).unwrap();
//! let fit = refine.fine(&model, &coarse, &[left, right]).unwrap();
//! assert!((fit.left_from_part.translation.vector - truth.translation.vector).norm() < 0.3);
//!
//! // Without the binary pictures, where the rough pose is not far off.
//! let near = refine.near(&model, &rough, &[left, right]).unwrap();
//! assert!((near.translation.vector - truth.translation.vector).norm() < 1.0);
//! let far = truth * Isometry3::translation(0.0, 12.0, 0.0);
//! assert_eq!(refine.near(&model, &far, &[left, right]), None);
//! # Ok::<(), pickcell::part::PartError>(())
//! ```

mod aim;
pub mod contact;
pub mod end;
pub mod gloss;
pub mod model;
mod outlines;
pub mod over;
pub mod refine;
pub mod section;
pub mod shading;
pub mod slide;
mod sweep;
pub mod verify;
pub mod width;
