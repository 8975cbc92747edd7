//! The threshold of its own over all rendered scenes, against their truth; skipped where they are not there.

use nalgebra::Point3;
use pickcell::frame::Frame;
use pickcell::rig::Rig;
use pickcell::vision::binarize::{Binarize, Params};
use pickcell::vision::bits::BitImage;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// What was seen in the pictures of a set.
#[derive(Default)]
struct Seen {
    pictures: usize,
    centreline: usize,
    lost: usize,
    strays: usize,
    stray_pixels: usize,
}

/// A pair: pictures, truth, and whether parts are in it.
struct Pair {
    left: PathBuf,
    right: PathBuf,
    truth: PathBuf,
}

fn pairs(set: &Path) -> Vec<Pair> {
    let names = |folder: PathBuf| -> BTreeSet<String> {
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
        entries.map(|e| e.file_name().to_string_lossy().into_owned()).collect()
    };
    if set.join("truth").is_dir() {
        let truths = names(set.join("truth"));
        let stems = truths.iter().filter_map(|t| t.strip_suffix(".json")).step_by(5);
        return stems
            .map(|stem| Pair {
                left: set.join(format!("left/{stem}.png")),
                right: set.join(format!("right/{stem}.png")),
                truth: set.join(format!("truth/{stem}.json")),
            })
            .collect();
    }
    let scenes = names(set.into()).into_iter().filter(|name| name.starts_with("scene-"));
    scenes
        .map(|scene| Pair {
            left: set.join(&scene).join("left.jpg"),
            right: set.join(&scene).join("right.jpg"),
            truth: set.join(&scene).join("truth.json"),
        })
        .collect()
}

fn read(path: &Path) -> Frame {
    let picture = image::open(path).unwrap_or_else(|e| panic!("{}: {e}", path.display())).to_rgb8();
    Frame::from_rgb(picture.width() as usize, picture.height() as usize, picture.into_raw())
}

/// Points every third of a millimetre along the axes of all wires, in the left camera's frame.
fn centrelines(truth: &serde_json::Value) -> Vec<Point3<f64>> {
    let mut points = Vec::new();
    for object in truth["objects"].as_array().expect("objects") {
        let lines = object["centreline_camera_mm"].as_array().expect("centreline");
        let is_list = lines[0][0].is_array();
        for line in if is_list { lines.iter().collect() } else { vec![&object["centreline_camera_mm"]] } {
            let corners: Vec<Point3<f64>> = serde_json::from_value::<Vec<[f64; 3]>>(line.clone())
                .expect("points")
                .into_iter()
                .map(Point3::from)
                .collect();
            for pair in corners.windows(2) {
                let steps = (nalgebra::distance(&pair[0], &pair[1]) * 3.0).ceil() as usize;
                points.extend((0..=steps).map(|i| pair[0] + (pair[1] - pair[0]) * (i as f64 / steps as f64)));
            }
        }
    }
    points
}

/// Objects that no centreline pixel is in or beside, and their pixels.
fn strays(bits: &BitImage, centreline: &BTreeSet<(i32, i32)>) -> (usize, usize) {
    let mut seen = BitImage::new(bits.width(), bits.height());
    let (mut strays, mut pixels) = (0, 0);
    for (x0, y0) in (0..bits.height()).flat_map(|y| (0..bits.width()).map(move |x| (x, y))) {
        if !bits.get(x0 as i32, y0 as i32) || seen.get(x0 as i32, y0 as i32) {
            continue;
        }
        let mut stack = vec![(x0 as i32, y0 as i32)];
        let (mut size, mut known) = (0, false);
        seen.set(x0, y0, true);
        while let Some((x, y)) = stack.pop() {
            size += 1;
            for (nx, ny) in (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (x + dx, y + dy))) {
                known |= centreline.contains(&(nx, ny));
                if bits.get(nx, ny) && !seen.get(nx, ny) {
                    seen.set(nx as usize, ny as usize, true);
                    stack.push((nx, ny));
                }
            }
        }
        if !known {
            strays += 1;
            pixels += size;
        }
    }
    (strays, pixels)
}

fn look(set: &Path) -> Seen {
    let rig = Rig::read(set.join("calibration.yaml")).expect("calibration");
    let mut seen = Seen::default();
    for pair in pairs(set) {
        let text = std::fs::read_to_string(&pair.truth).expect("truth");
        let truth: serde_json::Value = serde_json::from_str(&text).expect("truth");
        if !truth["distractors"].as_array().is_none_or(Vec::is_empty) {
            continue;
        }
        let points = centrelines(&truth);
        for (path, is_left) in [(&pair.left, true), (&pair.right, false)] {
            let frame = read(path);
            let params = Params { speck_px_min: 20, ..Params::default() };
            let mut bits = BitImage::new(frame.width, frame.height);
            Binarize::new(params, frame.width, frame.height)
                .expect("good")
                .run(&frame, &mut bits)
                .expect("runs");
            let project = |p| if is_left { rig.project_left(p) } else { rig.project_right(p) };
            let pixels =
                points.iter().filter_map(project).map(|px| (px.x.round() as i32, px.y.round() as i32));
            let inside =
                |&(x, y): &(i32, i32)| x >= 0 && y >= 0 && x < frame.width as i32 && y < frame.height as i32;
            let centreline: BTreeSet<(i32, i32)> = pixels.filter(inside).collect();
            seen.pictures += 1;
            seen.centreline += centreline.len();
            seen.lost += centreline.iter().filter(|&&(x, y)| !bits.get(x, y)).count();
            let (strays, stray_pixels) = strays(&bits, &centreline);
            seen.strays += strays;
            seen.stray_pixels += stray_pixels;
        }
    }
    seen
}

#[test]
fn parts_are_in_the_mask_and_little_else_is_in_every_set() {
    let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/scenes");
    if !scenes.is_dir() {
        println!("skipped: {} is not there", scenes.display());
        return;
    }
    let mut sets: Vec<PathBuf> =
        std::fs::read_dir(scenes.join("sets")).expect("sets").flatten().map(|e| e.path()).collect();
    sets.push(scenes.join("conveyor"));
    sets.sort();
    println!("set               pictures  centreline lost  stray objects");
    for set in sets {
        let name = set.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let seen = look(&set);
        let lost = seen.lost as f64 / seen.centreline.max(1) as f64;
        println!(
            "{name:17} {:8} {:14.2} %  {:4} ({} px)",
            seen.pictures,
            100.0 * lost,
            seen.strays,
            seen.stray_pixels
        );
        assert!(lost < 0.005, "{name}: {:.2} % of the centrelines are not in the mask", 100.0 * lost);
        assert!(seen.strays * 10 <= seen.pictures, "{name}: {} objects that are no parts", seen.strays);
    }
}
