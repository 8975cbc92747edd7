//! What `check` finds in the files that a cell names: calibration, parts, session, region, workspace.

use std::path::Path;
use std::time::{Duration, UNIX_EPOCH};

use nalgebra::{Point3, Vector3};

use super::Findings;
use super::pair;
use crate::camera::replay::is_only_of;
use crate::config::{Backend, Cell};
use crate::frame::FramePair;
use crate::grasp;
use crate::part::Part;
use crate::rig::Rig;
use crate::session::Session;
use crate::time::wall_ms;
use crate::vision::binarize::Binarize;

/// After so long a calibration should be looked at again: screws settle, mounts creep.
const CALIBRATION_AGE_MAX: Duration = Duration::from_secs(90 * 24 * 3600);

/// By so many degrees parts that lie flat are measured tilted now and then, cameras and floor being what they are.
const TILT_MEASURED_DEG: f64 = 2.0;

/// So many pictures of a session are looked at.
const PICTURES_MAX: usize = 1000;

/// Calibration, parts, session, region. Gives the rig where it can be read.
pub(super) fn check(cell: &Cell, findings: &mut Findings) -> Option<Rig> {
    let rig = calibration(cell, findings);
    match Part::read_all(&cell.recognition.parts) {
        Ok(parts) => {
            let names: Vec<_> = parts.iter().map(|part| part.name.as_str()).collect();
            findings.ok("parts", names.join(", "));
            gripper(cell, &parts, findings);
        }
        Err(error) => findings.wrong("parts", error.to_string()),
    }
    if cell.cameras.backend == Backend::Replay {
        session(cell, rig.as_ref(), findings);
    }
    if let Some(rig) = &rig {
        region(cell, rig, findings);
    }
    rig
}

/// Whether the gripper can take the parts, and the last gate lets it.
fn gripper(cell: &Cell, parts: &[Part], findings: &mut Findings) {
    let (gripper, workspace) = (&cell.arm_side.gripper, &cell.arm_side.workspace);
    for part in parts {
        let opening_mm = grasp::opening_mm(gripper, part);
        if opening_mm > gripper.opening_max_mm {
            findings.warning(
                "gripper",
                format!(
                    "{} needs {opening_mm} mm between the fingers, they open to {} mm",
                    part.name, gripper.opening_max_mm
                ),
                "see gripper.opening_max_mm, gripper.clearance_mm and the part's grasp.width_mm: it will never be taken",
            );
        }
    }
    let farthest_mm = gripper.approach_mm.max(gripper.retreat_mm);
    if farthest_mm > workspace.jump_max_mm {
        findings.error(
            "gripper",
            format!("it comes from and goes {farthest_mm} mm away, workspace.jump_max_mm is {}", workspace.jump_max_mm),
            "make gripper.approach_mm and gripper.retreat_mm smaller: the last gate would refuse every target",
        );
    }
    let thickest_mm = parts.iter().map(|part| part.thickness_mm).fold(0.0, f64::max);
    if let Some(place) = &cell.place {
        let is_short = |count: u32, step_mm: &Vector3<f64>| count > 1 && step_mm.norm() < thickest_mm;
        if is_short(place.columns, &place.column_step_mm) || is_short(place.rows, &place.row_step_mm) {
            findings.warning(
                "place",
                format!("slots are nearer to each other than a part is thick, {thickest_mm} mm"),
                "see place.column_step_mm and place.row_step_mm: parts are put on each other",
            );
        }
    }
}

fn calibration(cell: &Cell, findings: &mut Findings) -> Option<Rig> {
    let path = &cell.rig.calibration;
    let rig = match Rig::read(path) {
        Ok(rig) => rig,
        Err(error) => {
            findings.wrong("calibration", error.to_string());
            return None;
        }
    };
    let (width, height) = (rig.left.width, rig.left.height);
    let baseline_mm = rig.baseline_mm();
    let about = format!("{}: {width}x{height}, baseline {baseline_mm:.1} mm", path.display());
    match rig.doubt() {
        None => findings.ok("calibration", about),
        Some(doubt) => findings.warning("calibration", about, doubt),
    }
    if let Some(age) = age(path).filter(|age| *age > CALIBRATION_AGE_MAX) {
        findings.warning(
            "calibration age",
            format!("the file is {} days old", age.as_secs() / 86_400),
            "calibrate again if a camera was touched since",
        );
    }
    let cameras = [("left", &cell.cameras.left), ("right", &cell.cameras.right)];
    for (side, camera) in cameras {
        let Some(camera) = camera.as_ref().filter(|_| cell.cameras.backend == Backend::V4l2) else {
            continue;
        };
        let calibrated = if side == "left" { &rig.left } else { &rig.right };
        if let Err(error) = calibrated.check_size(side, camera.width as usize, camera.height as usize) {
            findings.wrong(&format!("calibration for the {side} camera"), error.to_string());
        }
    }
    Some(rig)
}

fn age(path: &Path) -> Option<Duration> {
    let changed = std::fs::metadata(path).ok()?.modified().ok()?;
    let since_1970 = changed.duration_since(UNIX_EPOCH).ok()?;
    Duration::from_millis(wall_ms()).checked_sub(since_1970)
}

fn session(cell: &Cell, rig: Option<&Rig>, findings: &mut Findings) {
    let Some(path) = &cell.cameras.session else { return };
    let session = match Session::open(path) {
        Ok(session) => session,
        Err(error) => return findings.wrong("session", error.to_string()),
    };
    if let Some(note) = session.break_note() {
        findings.warning("session", note, "record it again where the rest of it matters");
    }
    let about =
        format!("{}: {} pairs at {:.4} a second", path.display(), session.whole_pairs(), session.rate_hz);
    let pictures = session.pairs.iter().flat_map(|pair| pair.pictures.iter().flatten());
    let (mut size, mut damaged, mut other_size) = (None, 0, None);
    for picture in pictures.take(PICTURES_MAX) {
        match picture.read() {
            // Played as what it is: a picture that came damaged from its camera.
            Err(error) if is_only_of(picture, &error) => damaged += 1,
            Err(error) => return findings.wrong("session", error.to_string()),
            Ok(frame) => match rig.map(|rig| rig.check_size(frame.width, frame.height)) {
                Some(Err(error)) => {
                    other_size.get_or_insert(format!("{}: {error}", picture.place().display()));
                }
                _ => size = Some((frame.width, frame.height)),
            },
        }
    }
    match (size, &other_size) {
        (Some((width, height)), _) => findings.ok("session", format!("{about}, {width}x{height}")),
        (None, Some(error)) => return findings.wrong("session", error.clone()),
        (None, None) => return findings.wrong("session", format!("{about}, no whole picture in them")),
    }
    if let Err(error) = cell.check_pair_window(session.period()) {
        findings.wrong("pairing", error.to_string());
    }
    let whole = session.pairs.iter().find_map(|pair| {
        let [Some(left), Some(right)] = &pair.pictures else { return None };
        Some((&pair.name, FramePair { left: left.read().ok()?, right: right.read().ok()? }))
    });
    if let (Some(rig), Some((name, frames))) = (rig, whole) {
        pair::check(cell, rig, &frames, &format!("pair {name}"), findings);
    }
    if let Some(error) = other_size {
        findings.warning("session", error, "nothing is recognised in such pictures; take them out");
    }
    if damaged > 0 {
        findings.warning(
            "session",
            format!("{damaged} damaged pictures"),
            "they are counted, not recognised",
        );
    }
}

fn region(cell: &Cell, rig: &Rig, findings: &mut Findings) {
    let params = cell.recognition_params().binarize;
    let cameras = [("left", &rig.left), ("right", &rig.right)];
    for (params, (side, camera)) in params.into_iter().zip(cameras) {
        let whole = params.region_px.is_empty();
        match Binarize::new(params, camera.width, camera.height) {
            Err(error) => {
                findings.wrong(&format!("{side} picture"), cell.region_error_of(side, &error).to_string())
            }
            Ok(binarize) => {
                let seen: u32 = binarize
                    .region()
                    .map_or(0, |region| region.words().iter().map(|word| word.count_ones()).sum());
                if !whole && seen == 0 {
                    findings.error(
                        &format!("region of the {side} picture"),
                        "no pixel is inside",
                        "give region_px a polygon with an area, corners in order",
                    );
                }
            }
        }
    }
}

/// Whether the workspace is where the cameras look.
pub(super) fn check_workspace(cell: &Cell, rig: &Rig, findings: &mut Findings) {
    let Some(base_from_left) = cell.rig.base_from_left else {
        findings.error(
            "workspace",
            "[rig] has no base_from_left, so that grasps are known in the camera's frame only",
            "measure the pose of the left camera in the robot's base (hand-eye calibration)",
        );
        return;
    };
    let workspace = &cell.arm_side.workspace;
    if workspace.tilt_max_deg < TILT_MEASURED_DEG {
        findings.warning(
            "workspace.tilt_max_deg",
            format!(
                "{} degrees: parts that lie flat are measured tilted by more, and would be blocked (\"tilted too far\")",
                workspace.tilt_max_deg
            ),
            "give it 5 or more",
        );
    }
    let [low, high] = [workspace.min_mm, workspace.max_mm];
    let camera = base_from_left.translation.vector;
    let inside = (0..3).all(|axis| camera[axis] >= low[axis] && camera[axis] <= high[axis]);
    if inside {
        findings.warning(
            "workspace",
            "the left camera stands inside it",
            "make [workspace] smaller, or see whether rig.base_from_left is right",
        );
    }
    let (seen, all) = seen_share(rig, &base_from_left, low, high);
    let about = format!(
        "{:.0} x {:.0} x {:.0} mm, both cameras see {:.0} % of its floor",
        high[0] - low[0],
        high[1] - low[1],
        high[2] - low[2],
        100.0 * f64::from(seen) / f64::from(all)
    );
    if seen == 0 {
        findings.error(
            "workspace",
            about,
            "no part that the cameras see can be inside; compare rig.base_from_left with [workspace]",
        );
    } else {
        findings.ok("workspace", about);
    }
    place(cell, findings);
}

/// Points of a grid over the box's floor that both cameras see, and all of them.
fn seen_share(
    rig: &Rig,
    base_from_left: &nalgebra::Isometry3<f64>,
    low: [f64; 3],
    high: [f64; 3],
) -> (u32, u32) {
    const STEPS: u32 = 32;
    let left_from_base = base_from_left.inverse();
    let mut seen = 0;
    for i in 0..=STEPS {
        for j in 0..=STEPS {
            let along =
                |axis: usize, n: u32| low[axis] + (high[axis] - low[axis]) * f64::from(n) / f64::from(STEPS);
            let point = left_from_base * Point3::new(along(0, i), along(1, j), low[2]);
            let left = rig.project_left(&point).is_some_and(|px| rig.left.sees(px, 0.0));
            let right = rig.project_right(&point).is_some_and(|px| rig.right.sees(px, 0.0));
            seen += u32::from(left && right);
        }
    }
    (seen, (STEPS + 1) * (STEPS + 1))
}

fn place(cell: &Cell, findings: &mut Findings) {
    let Some(place) = &cell.place else { return };
    let workspace = &cell.arm_side.workspace;
    let corner = |column: u32, row: u32| {
        place.first_mm + f64::from(column) * place.column_step_mm + f64::from(row) * place.row_step_mm
    };
    let (columns, rows) = (place.columns - 1, place.rows - 1);
    for (column, row) in [(0, 0), (columns, 0), (0, rows), (columns, rows)] {
        let slot = corner(column, row);
        if (0..3).any(|axis| slot[axis] < workspace.min_mm[axis] || slot[axis] > workspace.max_mm[axis]) {
            findings.error(
                "place",
                format!(
                    "slot in column {} of row {} at ({:.1}, {:.1}, {:.1}) mm is outside the workspace",
                    column + 1,
                    row + 1,
                    slot.x,
                    slot.y,
                    slot.z
                ),
                "move [place] or widen [workspace]: the last gate would refuse every target",
            );
            return;
        }
    }
    findings.ok(
        "place",
        format!("{} slots in {} row(s), all in the workspace", place.columns * place.rows, place.rows),
    );
}
