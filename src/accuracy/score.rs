//! Compares recognised parts with the truth.
//!
//! A detection belongs to a part of the same name, one to one, nearest first; it is right where its nodes are less
//! than [`GATE_MM`] away in the mean, under the symmetry of the part that makes the distance least.

use nalgebra::{Isometry3, Point3, Vector3};

use super::truth::{Object, Truth};
use crate::part::Part;
use crate::recognize::{FoundPart, Recognition};

/// Mean distance of the nodes up to which a detection is right, in mm.
pub const GATE_MM: f64 = 4.0;

/// Sums over scenes.
#[derive(Clone, Debug, Default)]
pub struct Score {
    /// Scenes.
    pub scenes: usize,
    /// Parts that lie there.
    pub objects: usize,
    /// Of them at least 80 % in sight in both pictures.
    pub visible: usize,
    /// Parts recognised.
    pub detections: usize,
    /// Of them right.
    pub correct: usize,
    /// Visible parts that were found.
    pub visible_found: usize,
    /// Parts offered to the arm.
    pub offered: usize,
    /// Of them right and with nothing over them.
    pub offered_free: usize,
    /// Scenes with parts.
    pub picks: usize,
    /// Scenes whose first pick is right.
    pub first_right: usize,
    /// Scenes whose first pick is right and has nothing over it.
    pub first_free: usize,
    /// Distances of all nodes of right detections, mm.
    pub node_mm: Vec<f64>,
    /// Distances of their grasps, mm.
    pub grasp_mm: Vec<f64>,
    /// Angles of their wires at the grasp, degrees.
    pub axis_deg: Vec<f64>,
    /// Height of their grasps above the true ones, mm.
    pub height_mm: Vec<f64>,
    /// Errors of the grasp along the axes of its frame, in reported standard deviations.
    pub sigmas: Vec<f64>,
    /// Whole recognitions, milliseconds.
    pub total_ms: Vec<f64>,
}

/// One right or wrong detection, for a list.
#[derive(Clone, Debug)]
pub struct Verdict {
    /// Index into the detections.
    pub detection: usize,
    /// The object it belongs to and the mean distance of the nodes; `None`: nothing lies there.
    pub object: Option<(usize, f64)>,
}

impl Score {
    /// Adds a scene; gives a verdict for every detection.
    pub fn add(&mut self, truth: &Truth, found: &Recognition, parts: &[Part]) -> Vec<Verdict> {
        self.scenes += 1;
        self.objects += truth.objects.len();
        self.visible += truth.objects.iter().filter(|o| o.is_visible()).count();
        self.detections += found.parts.len();
        self.total_ms.push(found.stages.total_ns as f64 / 1e6);
        let owners = assign(truth, found, parts);
        for (f, owner) in found.parts.iter().zip(&owners) {
            self.offered += usize::from(f.blocked.is_none());
            let Some((o, _)) = owner else { continue };
            let object = &truth.objects[*o];
            self.offered_free += usize::from(f.blocked.is_none() && !object.occluded);
            self.correct += 1;
            self.visible_found += object.is_visible() as usize;
            self.add_errors(truth, object, f, &parts[f.part]);
        }
        if !truth.objects.is_empty() {
            self.picks += 1;
            if let Some(Some((o, _))) = owners.first() {
                self.first_right += 1;
                self.first_free += !truth.objects[*o].occluded as usize;
            }
        }
        owners.into_iter().enumerate().map(|(detection, object)| Verdict { detection, object }).collect()
    }

    fn add_errors(&mut self, truth: &Truth, object: &Object, found: &FoundPart, part: &Part) {
        let (_, nodes) = distance_mm(found, object, part);
        self.node_mm.extend(nodes);
        let true_position = Point3::from(object.grasp.position_mm);
        // A part that looks the same when turned may be taken at any of the places that look the same.
        let turned = part.symmetries.iter().map(|s| found.left_from_part * s.part_from_part);
        let pose = turned.fold(found.left_from_part, |best, pose| {
            let off_mm = |pose: &Isometry3<f64>| (pose * part.grasp.position_mm - true_position).norm();
            if off_mm(&pose) < off_mm(&best) { pose } else { best }
        });
        let seen = pose * part.grasp.position_mm;
        let error = seen - true_position;
        self.grasp_mm.push(error.norm());
        let axis = pose * part.grasp.approach.cross(&part.grasp.closing);
        let true_axis = Vector3::from(object.grasp.axis);
        let cos = (axis.dot(&true_axis) / axis.norm() / true_axis.norm()).abs().min(1.0);
        self.axis_deg.push(cos.acos().to_degrees());
        self.height_mm.push(truth.floor_plane.height_mm(&seen) - truth.floor_plane.height_mm(&true_position));
        // The scenes have no robot: the grasp's frame is the left camera's.
        self.sigmas.extend((0..3).map(|k| error[k].abs() / found.sigma_mm[k].max(1e-9)));
    }

    /// Adds another score.
    pub fn merge(&mut self, o: &Score) {
        self.scenes += o.scenes;
        self.objects += o.objects;
        self.visible += o.visible;
        self.detections += o.detections;
        self.correct += o.correct;
        self.visible_found += o.visible_found;
        self.offered += o.offered;
        self.offered_free += o.offered_free;
        self.picks += o.picks;
        self.first_right += o.first_right;
        self.first_free += o.first_free;
        for (a, b) in [
            (&mut self.node_mm, &o.node_mm),
            (&mut self.grasp_mm, &o.grasp_mm),
            (&mut self.axis_deg, &o.axis_deg),
            (&mut self.height_mm, &o.height_mm),
            (&mut self.sigmas, &o.sigmas),
            (&mut self.total_ms, &o.total_ms),
        ] {
            a.extend(b);
        }
    }

    /// The heading of [`Score::row`].
    pub const HEADING: &'static str = "| set | scenes | parts | precision | recall 80 % | recall | node mm 50 · 95 % | grasp mm 50 · 95 % | axis ° 50 · 95 % | height mm | within 1σ · 2σ | first pick | nothing over it | offered | ms |\n|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|";

    /// A row of a table in Markdown.
    pub fn row(&self, name: &str) -> String {
        let share =
            |a: usize, b: usize| if b == 0 { "-".into() } else { format!("{:.3}", a as f64 / b as f64) };
        let two = |v: &[f64]| match v {
            [] => "-".into(),
            _ => format!("{:.2} · {:.2}", percentile(v, 0.5), percentile(v, 0.95)),
        };
        let within = |limit: f64| {
            let n = self.sigmas.iter().filter(|s| **s <= limit).count();
            if self.sigmas.is_empty() {
                "-".into()
            } else {
                format!("{:.0} %", 100.0 * n as f64 / self.sigmas.len() as f64)
            }
        };
        let height = match &self.height_mm[..] {
            [] => "-".into(),
            all => format!("{:+.2}", all.iter().sum::<f64>() / all.len() as f64),
        };
        format!(
            "| {name} | {} | {} | {} | {} | {} | {} | {} | {} | {height} | {} · {} | {}/{} | {}/{} | {}/{} | {:.2} |",
            self.scenes,
            self.objects,
            share(self.correct, self.detections),
            share(self.visible_found, self.visible),
            share(self.correct, self.objects),
            two(&self.node_mm),
            two(&self.grasp_mm),
            two(&self.axis_deg),
            within(1.0),
            within(2.0),
            self.first_right,
            self.picks,
            self.first_free,
            self.picks,
            self.offered_free,
            self.offered,
            percentile(&self.total_ms, 0.5),
        )
    }
}

/// The value that a share `q` of `values` does not exceed, between neighbours; NaN for none.
pub fn percentile(values: &[f64], q: f64) -> f64 {
    if values.is_empty() {
        return f64::NAN;
    }
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let at = q * (sorted.len() - 1) as f64;
    let (low, high) = (sorted[at.floor() as usize], sorted[at.ceil() as usize]);
    low + (high - low) * at.fract()
}

/// For every detection the object it belongs to and the mean distance of its nodes.
fn assign(truth: &Truth, found: &Recognition, parts: &[Part]) -> Vec<Option<(usize, f64)>> {
    let mut pairs: Vec<(usize, usize, f64)> = Vec::new();
    for (d, f) in found.parts.iter().enumerate() {
        for (o, object) in truth.objects.iter().enumerate() {
            if object.part == parts[f.part].name {
                let (mean, _) = distance_mm(f, object, &parts[f.part]);
                if mean < GATE_MM {
                    pairs.push((d, o, mean));
                }
            }
        }
    }
    pairs.sort_by(|a, b| a.2.total_cmp(&b.2));
    let mut owners = vec![None; found.parts.len()];
    let mut taken = vec![false; truth.objects.len()];
    for (d, o, mean) in pairs {
        if owners[d].is_none() && !taken[o] {
            owners[d] = Some((o, mean));
            taken[o] = true;
        }
    }
    owners
}

/// Mean distance of the nodes and the single ones, under the best symmetry.
fn distance_mm(found: &FoundPart, object: &Object, part: &Part) -> (f64, Vec<f64>) {
    let identity: Vec<usize> = (0..part.nodes.len()).collect();
    let orders = part.symmetries.iter().map(|s| &s.node_permutation).chain([&identity]);
    let mut best = (f64::INFINITY, Vec::new());
    for order in orders {
        let distances: Vec<f64> = part
            .nodes
            .iter()
            .enumerate()
            .map(|(n, node)| {
                let at = found.nodes[order[n]].left_mm;
                object.node(&node.name).map_or(f64::INFINITY, |t| (at - t).norm())
            })
            .collect();
        let mean = distances.iter().sum::<f64>() / distances.len() as f64;
        if mean < best.0 {
            best = (mean, distances);
        }
    }
    best
}
