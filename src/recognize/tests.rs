use std::path::Path;

use super::*;
use crate::frame::{Frame, PixelFormat};
use crate::rig::CameraModel;
use crate::session::Session;

/// A frame of which every pixel is four.
fn doubled(frame: &Frame) -> Frame {
    assert_eq!(frame.format, PixelFormat::Rgb);
    let row = |y: usize| &frame.bytes[y * frame.stride_bytes..][..3 * frame.width];
    let twice = |row: &[u8]| row.chunks(3).flat_map(|pixel| [pixel, pixel].concat()).collect::<Vec<_>>();
    let rows = (0..frame.height).flat_map(|y| [twice(row(y)), twice(row(y))].concat());
    Frame::from_rgb(2 * frame.width, 2 * frame.height, rows.collect())
}

fn doubled_camera(camera: &CameraModel) -> CameraModel {
    let CameraModel { width, height, fx, fy, cx, cy, distortion } = *camera;
    let [cx, cy] = [cx, cy].map(|c| 2.0 * c + 0.5);
    CameraModel { width: 2 * width, height: 2 * height, fx: 2.0 * fx, fy: 2.0 * fy, cx, cy, distortion }
}

#[test]
fn thick_wire_is_recognised_in_half_the_size_as_in_a_picture_of_that_size() {
    let replay = Path::new(env!("CARGO_MANIFEST_DIR")).join("replay");
    let session = Session::open(&replay.join("conveyor")).unwrap();
    let rig = Rig::read(replay.join("conveyor/calibration.yaml")).unwrap();
    let rod = || vec![Part::read(replay.join("parts/rod-90.toml")).unwrap()];
    let large_rig = Rig { left: doubled_camera(&rig.left), right: doubled_camera(&rig.right), ..rig };
    let mut small = Recognizer::new(Params::default(), rig, rod()).unwrap();
    let mut large = Recognizer::new(Params::default(), large_rig, rod()).unwrap();
    let mut found = [Recognition::default(), Recognition::default()];
    for pair in &session.pairs[..3] {
        let [Some(left), Some(right)] = &pair.pictures else { panic!("a whole pair") };
        let frames = FramePair { left: left.read_raw().unwrap(), right: right.read_raw().unwrap() };
        let large_frames = FramePair { left: doubled(&frames.left), right: doubled(&frames.right) };
        let [of_small, of_large] = &mut found;
        small.run(&frames, Budget::Iterations(100_000), 1, of_small).unwrap();
        large.run(&large_frames, Budget::Iterations(100_000), 1, of_large).unwrap();
        assert_eq!([small.pictures()[0].halvings(), large.pictures()[0].halvings()], [0, 1]);
        assert!(of_small.parts.len() > 5 && of_small.parts.len() == of_large.parts.len());
        for (a, b) in of_small.parts.iter().zip(&of_large.parts) {
            let moved = a.left_from_part.inverse() * b.left_from_part;
            assert!(moved.translation.vector.norm() < 1e-6 && moved.rotation.angle() < 1e-6, "{moved}");
            for (a, b) in a.nodes.iter().zip(&b.nodes) {
                assert!((b.left_px - a.left_px.map(|px| 2.0 * px + 0.5)).norm() < 1e-4, "{a:?} {b:?}");
            }
        }
    }
}
