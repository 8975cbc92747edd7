//! Scenes with known truth: `sets/<set>/scene-NN/{left,right}.jpg` with `truth.json`, `sets/<set>/calibration.yaml`
//! and `set.json`, or a sequence `left/NNNN`, `right/NNNN`, `truth/NNNN.json`.

use std::path::{Path, PathBuf};

use nalgebra::{Point3, Vector3};
use serde::Deserialize;

use crate::session::is_picture;

/// Scenes of one rig.
#[derive(Clone, Debug)]
pub struct SceneSet {
    /// Its name.
    pub name: String,
    /// The rig's calibration.
    pub calibration: PathBuf,
    /// Names of the parts that may lie there.
    pub parts: Vec<String>,
    /// Whether the parts are darker than the floor.
    pub dark_parts: bool,
    /// The scenes, in order of name.
    pub scenes: Vec<Scene>,
}

/// One pair of pictures and its truth.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Its name.
    pub name: String,
    /// Left and right picture.
    pub pictures: [PathBuf; 2],
    /// The truth file.
    pub truth: PathBuf,
}

/// What lies in a scene.
#[derive(Clone, Debug, Deserialize)]
pub struct Truth {
    /// The parts.
    pub objects: Vec<Object>,
    /// The floor: normal · x = offset, left camera.
    pub floor_plane: Plane,
}

/// A plane in the left camera's frame.
#[derive(Clone, Copy, Debug, Deserialize)]
pub struct Plane {
    /// Unit normal.
    pub normal: [f64; 3],
    /// Distance from the origin along the normal.
    pub offset_mm: f64,
}

/// A part in its place.
#[derive(Clone, Debug, Deserialize)]
pub struct Object {
    /// Name of the part.
    pub part: String,
    /// Its nodes.
    pub nodes: Vec<NodeTruth>,
    /// Its grasp.
    pub grasp: GraspTruth,
    /// Share of the outline in sight, left picture.
    pub visible_left: f64,
    /// The same, right picture.
    pub visible_right: f64,
    /// Whether something lies over it.
    #[serde(default)]
    pub occluded: bool,
}

/// A node's place in the left camera's frame.
#[derive(Clone, Debug, Deserialize)]
pub struct NodeTruth {
    /// Its name.
    pub name: String,
    /// Its place.
    pub camera_mm: [f64; 3],
    /// Its projection into the left picture, pixels.
    pub left_px: [f64; 2],
}

/// Where a part is to be grasped.
#[derive(Clone, Copy, Debug, Deserialize)]
pub struct GraspTruth {
    /// Left camera's frame.
    pub position_mm: [f64; 3],
    /// Direction of the wire, sign-free.
    pub axis: [f64; 3],
}

#[derive(Deserialize)]
struct SetFile {
    parts: Vec<String>,
    #[serde(default)]
    dark_parts: bool,
}

/// Scenes that cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum TruthError {
    /// A file is missing or unreadable.
    #[error("cannot read {path}: {source}")]
    Read {
        /// Which.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A file is not what it should be.
    #[error("{path} is no truth of a scene: {source}")]
    Json {
        /// Which.
        path: PathBuf,
        /// Why.
        source: serde_json::Error,
    },
    /// A scene without one of its pictures.
    #[error(
        "{folder}: there is a truth, but no picture {stem}.png or {stem}.jpg; put it there, or take the truth away"
    )]
    NoPicture {
        /// Where it should be.
        folder: PathBuf,
        /// Its name without the ending.
        stem: String,
    },
    /// A folder without scenes.
    #[error(
        "{0} holds no scenes: expected sets/<set>/scene-NN/truth.json or truth/NNNN.json with left/ and right/"
    )]
    Empty(PathBuf),
}

/// All sets below `root`, in order of name.
///
/// # Errors
/// [`TruthError`] names the file.
pub fn read_sets(root: &Path) -> Result<Vec<SceneSet>, TruthError> {
    let mut sets = Vec::new();
    for folder in folders(&root.join("sets")).into_iter().chain(folders(root)) {
        let scenes = if folder.join("truth").is_dir() { sequence(&folder)? } else { scenes(&folder)? };
        if scenes.is_empty() {
            continue;
        }
        let set: SetFile = read_json(&folder.join("set.json"))?;
        sets.push(SceneSet {
            name: folder.file_name().unwrap_or_default().to_string_lossy().into_owned(),
            calibration: folder.join("calibration.yaml"),
            parts: set.parts,
            dark_parts: set.dark_parts,
            scenes,
        });
    }
    if sets.is_empty() { Err(TruthError::Empty(root.into())) } else { Ok(sets) }
}

/// Reads one truth file.
///
/// # Errors
/// [`TruthError`] names the file.
pub fn read_truth(path: &Path) -> Result<Truth, TruthError> {
    read_json(path)
}

fn read_json<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T, TruthError> {
    let text =
        std::fs::read_to_string(path).map_err(|source| TruthError::Read { path: path.into(), source })?;
    serde_json::from_str(&text).map_err(|source| TruthError::Json { path: path.into(), source })
}

fn folders(root: &Path) -> Vec<PathBuf> {
    entries(root).into_iter().filter(|p| p.is_dir()).collect()
}

fn entries(root: &Path) -> Vec<PathBuf> {
    let mut all: Vec<PathBuf> =
        std::fs::read_dir(root).map(|d| d.filter_map(|e| Some(e.ok()?.path())).collect()).unwrap_or_default();
    all.sort();
    all
}

fn scenes(folder: &Path) -> Result<Vec<Scene>, TruthError> {
    let scene = |f: PathBuf| {
        let pictures = [picture(&f, "left")?, picture(&f, "right")?];
        let name = f.file_name().unwrap_or_default().to_string_lossy().into_owned();
        Ok(Scene { name, pictures, truth: f.join("truth.json") })
    };
    folders(folder).into_iter().filter(|f| f.join("truth.json").is_file()).map(scene).collect()
}

fn sequence(folder: &Path) -> Result<Vec<Scene>, TruthError> {
    let scene = |truth: PathBuf| {
        let name = truth.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let pictures = [picture(&folder.join("left"), &name)?, picture(&folder.join("right"), &name)?];
        Ok(Scene { name, pictures, truth })
    };
    let is_truth = |path: &PathBuf| path.extension().is_some_and(|ending| ending == "json");
    entries(&folder.join("truth")).into_iter().filter(is_truth).map(scene).collect()
}

fn picture(folder: &Path, stem: &str) -> Result<PathBuf, TruthError> {
    let is_it = |path: &PathBuf| path.file_stem().is_some_and(|of| of == stem) && is_picture(path);
    let found = entries(folder).into_iter().find(is_it);
    found.ok_or_else(|| TruthError::NoPicture { folder: folder.into(), stem: stem.into() })
}

impl Object {
    /// Places of its nodes by name.
    pub fn node(&self, name: &str) -> Option<Point3<f64>> {
        self.nodes.iter().find(|n| n.name == name).map(|n| n.camera_mm.into())
    }

    /// Whether at least 80 % of it are in sight in both pictures.
    pub fn is_visible(&self) -> bool {
        self.visible_left.min(self.visible_right) >= 0.8
    }
}

impl Plane {
    /// Height of a point above it.
    pub fn height_mm(&self, point: &Point3<f64>) -> f64 {
        // The normal points towards the camera, which is at the origin.
        let height = Vector3::from(self.normal).dot(&point.coords) - self.offset_mm;
        if self.offset_mm > 0.0 { -height } else { height }
    }
}
