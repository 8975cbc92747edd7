//! Ranges of colours, on the recorded session repainted.

use super::*;
use crate::vision::binarize::ColourRange;

#[test]
fn whether_parts_are_dark_is_seen_whichever_way_their_range_is_given() {
    let (session, rig) = conveyor();
    let bright = frames(&session, 0, [0; 2]);
    let negative =
        |frame: &Frame| Frame { bytes: frame.bytes.iter().map(|v| 255 - v).collect(), ..frame.clone() };
    let dark = FramePair { left: negative(&bright.left), right: negative(&bright.right) };
    let all = run(&mut recognizer(rig), &bright).parts;
    let [light, low] = [[110, 255], [0, 109]];
    let rgb = |[min, max]: [u8; 2]| ColourRange::Rgb { min: [min; 3], max: [max; 3] };
    let grey = |[min, max]: [u8; 2]| ColourRange::Grey { min, max };
    let cases = [(&bright, false, light, low), (&dark, true, [0, 145], [146, 255])];
    for (pair, is_dark, of_parts, of_floor) in cases {
        for (colour, inverted) in [(rgb(of_parts), false), (grey(of_parts), false), (grey(of_floor), true)] {
            let mut params = Params::default();
            for range in &mut params.binarize {
                (range.colour, range.inverted) = (colour, inverted);
            }
            let mut recognizer = recognizer_with(params, rig);
            let found = run(&mut recognizer, pair).parts;
            assert_eq!(recognizer.lighting.dark, is_dark, "{colour:?} {inverted}");
            let is_found = |a: &&FoundPart| {
                found.iter().any(|b| (a.grasp.position_mm - b.grasp.position_mm).norm() < 2.0)
            };
            let count = all.iter().filter(is_found).count();
            assert!(10 * count >= 8 * all.len(), "{colour:?} {inverted}: {count} of {}", all.len());
        }
    }
}

#[test]
fn parts_as_bright_as_the_floor_are_recognised_by_their_colour() {
    let (session, rig) = conveyor();
    // Both have a luma of 116: grey values say nothing.
    let [floor, wire] = [[70.0, 150.0, 60.0], [196.0, 69.0, 147.0]];
    let coloured = |frame: &Frame| {
        let pixels = frame.bytes.chunks(3).flat_map(|rgb| {
            let t = (f64::from(rgb[0]) - 30.0) / 150.0;
            [0, 1, 2].map(|c| (floor[c] + (wire[c] - floor[c]) * t) as u8)
        });
        Frame::from_rgb(frame.width, frame.height, pixels.collect())
    };
    let mut params = Params::default();
    for range in &mut params.binarize {
        range.colour = ColourRange::Rgb { min: [120, 0, 0], max: [255, 120, 255] };
    }
    for doublings in [0, 1] {
        let grey = frames(&session, 0, [doublings; 2]);
        let pair = FramePair { left: coloured(&grey.left), right: coloured(&grey.right) };
        let rig = doubled_rig(&rig, [doublings; 2]);
        let all = run(&mut recognizer(rig), &grey).parts;
        let mut by_colour = recognizer_with(params.clone(), rig);
        let found = run(&mut by_colour, &pair).parts;
        assert_eq!(by_colour.pictures()[0].halvings(), doublings);
        let is_found =
            |a: &&FoundPart| found.iter().any(|b| (a.grasp.position_mm - b.grasp.position_mm).norm() < 1.0);
        let count = all.iter().filter(is_found).count();
        assert!(10 * count >= 8 * all.len(), "{count} of {}", all.len());
    }
}
