//! Drawn pictures: straight wires of known pose before two cameras, for examples of what is done with poses.

use std::f64::consts::FRAC_PI_2;

use nalgebra::{Isometry3, UnitQuaternion, Vector2, Vector3};

use super::model::PoseModel;
use super::refine::View;
use super::section::Profiler;
use crate::frame::{Frame, LumaView};
use crate::rig::{CameraModel, Rig};
use crate::vision::bits::BitImage;

/// A pair of pictures of straight wires, bright on a dark floor and without light: outlines are those of the axes.
#[derive(Clone, Debug)]
pub struct DrawnPair {
    /// Two cameras, 60 mm apart, 640x480, without distortion.
    pub rig: Rig,
    /// What the left and the right one see.
    pub frames: [Frame; 2],
    /// Which pixels of it are wire.
    pub masks: [BitImage; 2],
}

impl DrawnPair {
    /// Straight parts at these poses in the left camera's frame.
    ///
    /// # Panics
    /// A part that is bent, or not before both cameras.
    pub fn new(parts: &[(&PoseModel, Isometry3<f64>)]) -> Self {
        let camera = CameraModel::pinhole(640, 480, 600.0, 320.0, 240.0);
        let rig =
            Rig { left: camera, right: camera, right_from_left: Isometry3::translation(-60.0, 0.0, 0.0) };
        let [left, right] = cameras_from_left(&rig).map(|camera_from_left| {
            let wires: Vec<Wire> = parts
                .iter()
                .map(|(model, pose)| Wire::new(&camera, model, &(camera_from_left * pose)))
                .collect();
            let (mut bytes, mut mask) = (Vec::with_capacity(640 * 480), BitImage::new(640, 480));
            for (y, x) in (0..480).flat_map(|y| (0..640).map(move |x| (y, x))) {
                let px = Vector2::new(x as f64, y as f64);
                let inside = wires.iter().map(|wire| wire.inside_px(px)).fold(f64::NEG_INFINITY, f64::max);
                bytes.push((120.0 + 160.0 * inside.clamp(-0.5, 0.5)) as u8);
                mask.set(x, y, inside >= 0.0);
            }
            (Frame::from_grey(640, 480, bytes), mask)
        });
        Self { rig, frames: [left.0, right.0], masks: [left.1, right.1] }
    }

    /// So many level rods half a metre away in each of two directions, 7 mm from one to the next: each crosses all of the
    /// other direction.
    ///
    /// # Panics
    /// A part that is bent; a lattice larger than the pictures.
    pub fn lattice(rod: &PoseModel, each_way: usize) -> Self {
        let along = rod.straight_along.expect("a straight part");
        let lying = (0..2 * each_way).map(|k| {
            let turn = 0.5 + if k % 2 == 0 { 0.0 } else { FRAC_PI_2 };
            let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn);
            let aside_mm = 7.0 * ((k / 2) as f64 - (each_way - 1) as f64 / 2.0);
            let place = turn * Vector3::new(0.0, aside_mm, 0.0) + Vector3::new(0.0, 0.0, 500.0);
            let onto_x = UnitQuaternion::rotation_between(&along, &Vector3::x()).unwrap_or_default();
            (rod, Isometry3::from_parts(place.into(), turn * onto_x))
        });
        Self::new(&lying.collect::<Vec<_>>())
    }

    /// Both pictures as the stages take them.
    pub fn views(&self) -> [View<'_>; 2] {
        let cameras = [&self.rig.left, &self.rig.right];
        let cameras_from_left = cameras_from_left(&self.rig);
        [0, 1].map(|side| View {
            camera: cameras[side],
            camera_from_left: cameras_from_left[side],
            rotation: cameras_from_left[side].rotation.to_rotation_matrix().into_inner(),
            profiler: Profiler::new(LumaView::new(&self.frames[side]).expect("a grey picture"), false, 12.0),
            mask: &self.masks[side],
        })
    }
}

fn cameras_from_left(rig: &Rig) -> [Isometry3<f64>; 2] {
    [Isometry3::identity(), rig.right_from_left]
}

/// A wire in a picture.
struct Wire {
    begin_px: Vector2<f64>,
    along: Vector2<f64>,
    length_px: f64,
    radius_px: f64,
}

impl Wire {
    fn new(camera: &CameraModel, model: &PoseModel, camera_from_part: &Isometry3<f64>) -> Self {
        let [ends_mm] = model.straight_mm[..] else { panic!("a bent part") };
        let [begin_px, end_px] =
            ends_mm.map(|end| camera.project(&(camera_from_part * end)).expect("a part before the camera"));
        let depth_mm = (camera_from_part * model.centre_mm).z;
        Self {
            begin_px,
            along: (end_px - begin_px).normalize(),
            length_px: (end_px - begin_px).norm(),
            radius_px: model.radius_mm * camera.focal_px() / depth_mm,
        }
    }

    /// How far inside the outline a place lies; less than nought outside.
    fn inside_px(&self, px: Vector2<f64>) -> f64 {
        let from = px - self.begin_px;
        let (at, beside) = (from.dot(&self.along), from.perp(&self.along).abs());
        (self.radius_px - beside).min(at).min(self.length_px - at)
    }
}
