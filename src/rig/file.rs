//! Calibration files: OpenCV FileStorage YAML and pairs of ROS camera_info to a [`Rig`], and back.

use std::fmt::Write as _;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use firmware_bridge::outside::read_bytes;
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector2, Vector3};

use super::yaml::{self, Entry, Matrix, Value};
use super::{CameraModel, Rig, RigError};
use crate::frame::SIDE_PX_MAX;

/// RᵀR may differ from 1 by this: a rotation typed with four digits passes (1.7e-4), a scaled or sheared one not.
const ROTATION_TOLERANCE: f64 = 2e-4;
/// Shorter baselines are taken for metres in place of millimetres; longer ones for micrometres, or for none.
const BASELINE_MM: RangeInclusive<f64> = 1.0..=10_000.0;
/// Focal length over the longer side of the picture: from what sees 170 degrees to a telescope.
const FOCAL_WIDTHS: RangeInclusive<f64> = 0.04..=100.0;
/// How far from itself a pixel may come back whose distortion is taken off and put on again.
const UNDONE_PX_MAX: f64 = 0.5;
/// How many times the tangent of a ray's angle a lens may make of it, or the other way round, half way out.
const TURNED_MAX: f64 = 4.0;
/// So many of a file's keys are named where one is missing.
const KEYS_SHOWN_MAX: usize = 12;
impl Rig {
    /// Reads a calibration: an OpenCV FileStorage YAML file with `image_width image_height M1 D1 M2 D2 R T` (T in
    /// mm; other keys are ignored), or a pair of ROS camera_info files (either file, or their folder). 0, 4, 5, 8,
    /// 12 or 14 distortion coefficients.
    ///
    /// The ROS files hold no R and T; they follow from the rectification: `R = R2ᵀ R1`, `T = R2ᵀ t` with
    /// `t = P2[0,3] / P2[0,0]` metres along x.
    ///
    /// # Errors
    /// [`RigError`]: names file, key, value and remedy.
    pub fn read(path: impl AsRef<Path>) -> Result<Rig, RigError> {
        match Source::find(path.as_ref())? {
            Source::OpenCv(file) => file.opencv(),
            Source::Ros(left, right) => ros(&File::read(&left)?, &File::read(&right)?),
        }
    }

    /// The files that [`Rig::read`] takes a calibration from: one of OpenCV, or the left and the right one of ROS.
    ///
    /// # Errors
    /// There is none, or which ones is not clear.
    pub fn files(path: impl AsRef<Path>) -> Result<Vec<PathBuf>, RigError> {
        Ok(match Source::find(path.as_ref())? {
            Source::OpenCv(file) => vec![file.path],
            Source::Ros(left, right) => vec![left, right],
        })
    }

    /// Writes the rig as OpenCV FileStorage YAML, whole or not at all. [`Rig::read`] gives the same numbers back, R
    /// to rounding, if it is one that it would take: numbers are not checked here.
    ///
    /// # Errors
    /// [`RigError::TwoSizes`] where the cameras' sizes differ, [`RigError::Write`] where the disk refuses.
    pub fn write(&self, path: impl AsRef<Path>) -> Result<(), RigError> {
        let path = path.as_ref();
        let (left, right) = ((self.left.width, self.left.height), (self.right.width, self.right.height));
        if left != right {
            return Err(RigError::TwoSizes { path: path.to_owned(), left, right });
        }
        crate::files::write_atomically(path, self.to_opencv_yaml().as_bytes())
            .map_err(|source| RigError::Write { path: path.to_owned(), source })
    }

    fn to_opencv_yaml(self) -> String {
        let mut text =
            format!("%YAML:1.0\n---\nimage_width: {}\nimage_height: {}\n", self.left.width, self.left.height);
        for (index, camera) in [(1, &self.left), (2, &self.right)] {
            let m = Matrix3::new(camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0);
            put_matrix(&mut text, &format!("M{index}"), 3, 3, m.transpose().as_slice());
            let used = camera.distortion.iter().rposition(|&d| d != 0.0).map_or(0, |last| last + 1);
            let count = [5, 8, 12, 14].into_iter().find(|&n| n >= used).unwrap_or(14);
            put_matrix(&mut text, &format!("D{index}"), 1, count, &camera.distortion[..count]);
        }
        let rotation = self.right_from_left.rotation.to_rotation_matrix().into_inner();
        put_matrix(&mut text, "R", 3, 3, rotation.transpose().as_slice());
        put_matrix(&mut text, "T", 3, 1, self.right_from_left.translation.vector.as_slice());
        text
    }
}

/// Where a calibration stands.
enum Source {
    OpenCv(File),
    Ros(PathBuf, PathBuf),
}

impl Source {
    fn find(path: &Path) -> Result<Self, RigError> {
        if path.is_dir() {
            return Self::in_folder(path);
        }
        let file = File::read(path)?;
        if file.has("M1") || !(file.has("camera_matrix") || file.has("K") || file.has("k")) {
            return Ok(Self::OpenCv(file));
        }
        pair_of(path).map(|(left, right)| Self::Ros(left, right))
    }

    fn in_folder(folder: &Path) -> Result<Self, RigError> {
        for ending in ["_camera_info.yaml", "_camera_info.yml", ".yaml", ".yml"] {
            let (left, right) = (folder.join(format!("left{ending}")), folder.join(format!("right{ending}")));
            match (left.is_file(), right.is_file()) {
                (true, true) => return Ok(Self::Ros(left, right)),
                (false, false) => {}
                (has_left, _) => {
                    let wanted = if has_left { "right" } else { "left" };
                    return Err(RigError::Pair { path: folder.to_owned(), wanted });
                }
            }
        }
        let opencv = folder.join("calibration.yaml");
        if opencv.is_file() {
            return Ok(Self::OpenCv(File::read(&opencv)?));
        }
        let failed = |source| RigError::Read { path: folder.to_owned(), source };
        let there = folder.read_dir().map_err(failed)?.filter_map(|entry| Some(entry.ok()?.path()));
        let yaml = there.filter(|path| path.extension().is_some_and(|e| e == "yaml" || e == "yml"));
        let mut pairs: Vec<_> = yaml.filter_map(|path| pair_of(&path).ok()).collect();
        pairs.sort();
        pairs.dedup();
        match pairs.len() {
            1 => Ok(pairs.remove(0)).map(|(left, right)| Self::Ros(left, right)),
            0 => Err(RigError::Pair { path: folder.to_owned(), wanted: "left" }),
            count => Err(RigError::Pairs { path: folder.to_owned(), count }),
        }
    }
}

fn put_matrix(text: &mut String, key: &str, rows: usize, columns: usize, row_by_row: &[f64]) {
    let list: Vec<String> = row_by_row.iter().map(|v| format!("{v:?}")).collect();
    // writing to a String cannot fail
    let _ = writeln!(
        text,
        "{key}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: [ {} ]",
        list.join(", ")
    );
}

/// The two files of a ROS pair of which one is given: the name's last `left` or `right` is exchanged.
fn pair_of(path: &Path) -> Result<(PathBuf, PathBuf), RigError> {
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let (from, to) = match (name.rfind("left"), name.rfind("right")) {
        (Some(l), Some(r)) if l > r => ("left", "right"),
        (Some(_), None) => ("left", "right"),
        (_, Some(_)) => ("right", "left"),
        (None, None) => return Err(RigError::Pair { path: path.to_owned(), wanted: "other" }),
    };
    let at = name.rfind(from).unwrap_or(0);
    let other = path.with_file_name(format!("{}{to}{}", &name[..at], &name[at + from.len()..]));
    if !other.is_file() {
        return Err(RigError::Pair { path: path.to_owned(), wanted: to });
    }
    Ok(if from == "left" { (path.to_owned(), other) } else { (other, path.to_owned()) })
}

fn ros(left: &File, right: &File) -> Result<Rig, RigError> {
    let (left_camera, left_rotation, left_shift_mm) = left.ros_camera()?;
    let (right_camera, right_rotation, right_shift_mm) = right.ros_camera()?;
    if left_shift_mm.norm() > 0.0 && right_shift_mm.norm() == 0.0 {
        let problem = format!(
            "must be 0 for the left camera, and is in {}: exchange the two files, or their names",
            right.path.display()
        );
        let row = usize::from(left_shift_mm.x == 0.0);
        let key = format!("projection_matrix[{row},3] / [{row},{row}]");
        return Err(left.value(&key, &short(left_shift_mm[row] / 1000.0), &problem));
    }
    let shift_mm = right_shift_mm - left_shift_mm;
    let rotation = right_rotation.inverse() * left_rotation;
    let translation = right_rotation.inverse() * shift_mm;
    right.check_baseline(
        &translation,
        "projection_matrix",
        "P[0,3] is -f * baseline in metres, and 0 for the left camera",
    )?;
    Ok(Rig {
        left: left_camera,
        right: right_camera,
        right_from_left: Isometry3::from_parts(Translation3::from(translation), rotation),
    })
}

/// A number as people write it, if it is one of theirs.
fn short(number: f64) -> String {
    if number == 0.0 || (1e-6..1e9).contains(&number.abs()) {
        number.to_string()
    } else {
        format!("{number:e}")
    }
}

/// Whether the distortion of a lens can be undone over the middle half of its picture, and is none that turns rays by a multiple
/// of their angle: farther out many a good calibration bends back.
fn is_undone(camera: &CameraModel) -> bool {
    let centre = Vector2::new(camera.cx, camera.cy);
    let quarter = Vector2::new(camera.width as f64, camera.height as f64) / 4.0;
    let places = (-1..=1).flat_map(|x| (-1..=1).map(move |y| Vector2::new(f64::from(x), f64::from(y))));
    places.map(|place| centre + place.component_mul(&quarter)).all(|px| {
        let ray = camera.undistort(px);
        let back = camera.project(&Point3::new(ray.x, ray.y, 1.0));
        let straight = (px - centre).component_div(&Vector2::new(camera.fx, camera.fy)).norm();
        let is_lens = (straight / TURNED_MAX..=straight * TURNED_MAX).contains(&ray.norm());
        back.is_some_and(|back| (back - px).norm() < UNDONE_PX_MAX) && (is_lens || straight == 0.0)
    })
}

/// One calibration file, its keys and its name for messages.
struct File {
    path: PathBuf,
    entries: Vec<Entry>,
}

impl File {
    fn read(path: &Path) -> Result<Self, RigError> {
        let failed = |source| RigError::Read { path: path.to_owned(), source };
        let bytes = read_bytes(path).map_err(failed)?;
        let text = String::from_utf8_lossy(&bytes);
        // Some editors put a byte-order mark before the text.
        let text = text.trim_start_matches('\u{feff}');
        for (begin, format) in [('<', "XML"), ('{', "JSON")] {
            if text.trim_start().starts_with(begin) {
                return Err(RigError::Foreign { path: path.to_owned(), format });
            }
        }
        let entries = yaml::parse(text).map_err(|e| syntax(path, &e))?;
        if entries.is_empty() {
            let empty = yaml::SyntaxError { line: 1, problem: "no key in it".into() };
            return Err(syntax(path, &empty));
        }
        Ok(Self { path: path.to_owned(), entries })
    }

    fn has(&self, key: &str) -> bool {
        self.entries.iter().any(|(k, _)| k == key)
    }

    fn opencv(&self) -> Result<Rig, RigError> {
        let have = |keys: &[&str]| keys.iter().all(|key| self.has(key));
        let is_intrinsics = have(&["M1", "M2"]) && !self.has("R") && !self.has("T");
        let is_extrinsics = have(&["R", "T", "Q"]) && !self.has("M1");
        if is_intrinsics || is_extrinsics {
            return Err(self.missing(
                if is_intrinsics { "T" } else { "M1" },
                "OpenCV's stereo sample writes two files: join intrinsics.yml and extrinsics.yml to one, and add \
                 `image_width: 640` and `image_height: 480`, the size of the pictures",
            ));
        }
        let left = self.camera("M1", "D1")?;
        let right = self.camera("M2", "D2")?;
        let rotation = self.rotation("R")?;
        let t =
            self.matrix("T", "three numbers, the left camera's origin in the right camera's frame in mm")?;
        if !matches!((t.rows, t.columns), (3, 1) | (1, 3)) {
            return Err(self.shape("T", t, "3 rows and 1 column"));
        }
        let translation = Vector3::from_column_slice(&t.data);
        self.check_baseline(
            &translation,
            "T",
            "T is in millimetres: where the file has metres, multiply it by 1000",
        )?;
        Ok(Rig {
            left,
            right,
            right_from_left: Isometry3::from_parts(Translation3::from(translation), rotation),
        })
    }

    /// Camera, rectifying rotation, and the shift of the rectified frame in mm.
    fn ros_camera(&self) -> Result<(CameraModel, UnitQuaternion<f64>, Vector3<f64>), RigError> {
        let key = |names: [&'static str; 3]| names.into_iter().find(|n| self.has(n)).unwrap_or(names[0]);
        if let Some(model) = self.scalar("distortion_model")?
            && !["plumb_bob", "rational_polynomial", ""].contains(&model)
        {
            let problem = "only plumb_bob and rational_polynomial are known; calibrate with one of them";
            return Err(self.value("distortion_model", model, problem));
        }
        let camera =
            self.camera(key(["camera_matrix", "K", "k"]), key(["distortion_coefficients", "D", "d"]))?;
        let rotation = self.rotation(key(["rectification_matrix", "R", "r"]))?;
        let name = key(["projection_matrix", "P", "p"]);
        let p = self.matrix(name, "the 3x4 projection matrix of the rectified camera")?;
        if p.data.len() != 12 || !matches!(p.rows, 1 | 3) {
            return Err(self.shape(name, p, "3 rows and 4 columns"));
        }
        if !(p.data[0] > 0.0 && p.data[5] > 0.0) {
            let focal = format!("focal lengths {} and {}", p.data[0], p.data[5]);
            return Err(self.value(
                name,
                &focal,
                "they must be above 0; calibrate the pair as a stereo pair",
            ));
        }
        let shift_mm = Vector3::new(p.data[3] / p.data[0], p.data[7] / p.data[5], 0.0) * 1000.0;
        Ok((camera, rotation, shift_mm))
    }

    fn camera(&self, matrix: &str, coefficients: &str) -> Result<CameraModel, RigError> {
        let (width, height) = (self.side("image_width", "width")?, self.side("image_height", "height")?);
        let m = self.matrix(matrix, "the 3x3 camera matrix [fx 0 cx; 0 fy cy; 0 0 1]")?;
        if m.data.len() != 9 || !matches!(m.rows, 1 | 3) {
            return Err(self.shape(matrix, m, "3 rows and 3 columns"));
        }
        let [fx, skew, cx, m10, fy, cy, m20, m21, m22] = m.data[..] else {
            return Err(self.shape(matrix, m, "3 rows and 3 columns"));
        };
        for (name, focal) in [("fx", fx), ("fy", fy)] {
            let widths = focal / width.max(height) as f64;
            if !FOCAL_WIDTHS.contains(&widths) {
                let value = format!("{name} {}", short(focal));
                let [least, most] = [FOCAL_WIDTHS.start(), FOCAL_WIDTHS.end()];
                let problem = format!(
                    "a focal length is {least} to {most} times the longer side of the picture; calibrate again"
                );
                return Err(self.value(matrix, &value, &problem));
            }
        }
        for (name, centre, side) in [("cx", cx, width), ("cy", cy, height)] {
            if !(0.0..=side as f64).contains(&centre) {
                let value = format!("{name} {}", short(centre));
                let problem =
                    format!("the principal point lies in the picture, 0 to {side} here; calibrate again");
                return Err(self.value(matrix, &value, &problem));
            }
        }
        // a skew that moves no pixel of the picture by a hundredth is rounding
        if skew.abs() * (height as f64) > 0.01 * fy || m10 != 0.0 || m20 != 0.0 || m21 != 0.0 || m22 != 1.0 {
            let value = format!("[{fx}, {skew}, {cx}; {m10}, {fy}, {cy}; {m20}, {m21}, {m22}]");
            return Err(self.value(
                matrix,
                &value,
                "must be [fx 0 cx; 0 fy cy; 0 0 1]; calibrate without skew",
            ));
        }
        let d = self
            .matrix(coefficients, "the distortion coefficients k1 k2 p1 p2 [k3 …]; `data: [ ]` for none")?;
        if !matches!(d.data.len(), 0 | 4 | 5 | 8 | 12 | 14) || (d.rows > 1 && d.columns > 1) {
            let value = format!("{} coefficients", d.data.len());
            return Err(self.value(
                coefficients,
                &value,
                "0, 4, 5, 8, 12 or 14 of them in OpenCV's order are allowed",
            ));
        }
        let mut distortion = [0.0; 14];
        distortion[..d.data.len()].copy_from_slice(&d.data);
        let camera = CameraModel { width, height, fx, fy, cx, cy, distortion };
        if !is_undone(&camera) {
            let value = format!("{:?}", d.data);
            return Err(self.value(
                coefficients,
                &value,
                "no lens does so: in the middle of the picture it cannot be undone, or multiplies angles; calibrate again",
            ));
        }
        Ok(camera)
    }

    fn rotation(&self, key: &str) -> Result<UnitQuaternion<f64>, RigError> {
        let m = self.matrix(key, "the 3x3 rotation")?;
        if m.data.len() != 9 || !matches!(m.rows, 1 | 3) {
            return Err(self.shape(key, m, "3 rows and 3 columns"));
        }
        let r = Matrix3::from_row_slice(&m.data);
        let off = (r.tr_mul(&r) - Matrix3::identity()).abs().max();
        if off > ROTATION_TOLERANCE || r.determinant() < 0.0 {
            let value = format!("{:?}", m.data);
            let problem = if off > ROTATION_TOLERANCE {
                format!(
                    "is no rotation: RᵀR differs from 1 by {off:.2e}, allowed is {ROTATION_TOLERANCE:.0e}; calibrate again"
                )
            } else {
                "is no rotation but a reflection: its determinant is -1; calibrate again".to_owned()
            };
            return Err(self.value(key, &value, &problem));
        }
        let nearest = Rotation3::from_matrix_eps(&r, 1e-15, 100, Rotation3::from_matrix_unchecked(r));
        Ok(UnitQuaternion::from_rotation_matrix(&nearest))
    }

    fn check_baseline(&self, translation_mm: &Vector3<f64>, key: &str, remedy: &str) -> Result<(), RigError> {
        let baseline = translation_mm.norm();
        if BASELINE_MM.contains(&baseline) {
            return Ok(());
        }
        let [x, y, z] = [translation_mm.x, translation_mm.y, translation_mm.z];
        let problem = format!(
            "a baseline of {} mm; it must be {} to {} mm. {remedy}",
            short((1e3 * baseline).round() / 1e3),
            BASELINE_MM.start(),
            BASELINE_MM.end()
        );
        Err(self.value(key, &format!("[{}, {}, {}]", short(x), short(y), short(z)), &problem))
    }

    /// A side of the picture in pixels.
    fn side(&self, key: &str, other_key: &str) -> Result<usize, RigError> {
        let remedy = "the size in pixels of the pictures that the calibration was made with, as `image_width: 640` and `image_height: 480`";
        let text = match self.scalar(key)? {
            Some(text) => text,
            None => self.scalar(other_key)?.ok_or_else(|| self.missing(key, remedy))?,
        };
        let side = text
            .parse::<f64>()
            .ok()
            .filter(|s| s.fract() == 0.0 && (1.0..=f64::from(SIDE_PX_MAX)).contains(s));
        side.map(|s| s as usize).ok_or_else(|| {
            self.value(key, text, &format!("must be a whole number of pixels from 1 to {SIDE_PX_MAX}"))
        })
    }

    fn scalar(&self, key: &str) -> Result<Option<&str>, RigError> {
        match self.entries.iter().find(|(k, _)| k == key).map(|(_, v)| v) {
            None => Ok(None),
            Some(Ok(Value::Scalar(text))) => Ok(Some(text)),
            Some(Ok(_)) => Err(self.value(key, "no single value", "write it as `key: value` on one line")),
            Some(Err(e)) => Err(syntax(&self.path, e)),
        }
    }

    /// A matrix of finite numbers.
    fn matrix(&self, key: &str, what: &'static str) -> Result<&Matrix, RigError> {
        let matrix = match self.entries.iter().find(|(k, _)| k == key).map(|(_, v)| v) {
            None => return Err(self.missing(key, what)),
            Some(Err(e)) => return Err(syntax(&self.path, e)),
            Some(Ok(Value::Matrix(matrix))) => matrix,
            Some(Ok(Value::Scalar(text))) => {
                return Err(self.value(key, text, &format!("is no matrix; it is {what}")));
            }
            Some(Ok(Value::Other)) => {
                return Err(self.value(
                    key,
                    "something else",
                    &format!("is no matrix of numbers; it is {what}"),
                ));
            }
        };
        if let Some(i) = matrix.data.iter().position(|v| !v.is_finite()) {
            let (row, column) = (i / matrix.columns, i % matrix.columns);
            let place = format!("{key}[{row},{column}]");
            return Err(self.value(&place, &matrix.data[i].to_string(), "must be finite; calibrate again"));
        }
        Ok(matrix)
    }

    fn missing(&self, key: &str, what: &str) -> RigError {
        let there: Vec<&str> =
            self.entries.iter().map(|(key, _)| key.as_str()).take(KEYS_SHOWN_MAX).collect();
        let more = if self.entries.len() > there.len() { ", …" } else { "" };
        let remedy = format!("{what}; the file has {}{more}", there.join(", "));
        RigError::Missing { path: self.path.clone(), key: key.to_owned(), remedy }
    }

    fn shape(&self, key: &str, m: &Matrix, allowed: &str) -> RigError {
        let value = format!("a matrix of {} rows and {} columns", m.rows, m.columns);
        self.value(key, &value, &format!("must have {allowed}"))
    }

    fn value(&self, key: &str, value: &str, problem: &str) -> RigError {
        let (key, value) = (key.to_owned(), value.to_owned());
        RigError::Value { path: self.path.clone(), key, value, problem: problem.to_owned() }
    }
}

fn syntax(path: &Path, e: &yaml::SyntaxError) -> RigError {
    RigError::Syntax { path: path.to_owned(), line: e.line, problem: e.problem.clone() }
}
