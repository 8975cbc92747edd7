//! Intrinsics, distortion and stereo geometry of two cameras.
//!
//! Takes a calibration file ([`Rig::read`]) and gives what turns pixels to rays and rays to points:
//! [`CameraModel`] (points are undistorted, never pictures), [`StereoGeometry`] (epipolar distance, triangulation
//! by least reprojection error) and [`UndistortTable`] (the same undistortion by look-up). Owns the files'
//! formats: OpenCV FileStorage YAML, read and written, and pairs of ROS camera_info.
//!
//! ```
//! use nalgebra::Point3;
//! let path = concat!(env!("CARGO_MANIFEST_DIR"), "/replay/conveyor/calibration.yaml");
//! let rig = pickcell::rig::Rig::read(path)?;
//! let point = Point3::new(12.0, -7.0, 480.0);
//! let left = rig.left.undistort(rig.project_left(&point).unwrap());
//! let right = rig.right.undistort(rig.project_right(&point).unwrap());
//! let seen = rig.triangulate(left, right).unwrap();
//! assert!((seen.point_left_mm - point).norm() < 1e-6 && seen.residual_px < 1e-6);
//! # Ok::<(), pickcell::rig::RigError>(())
//! ```

mod camera;
mod error;
mod file;
mod geometry;
mod table;
mod yaml;

use nalgebra::{Isometry3, Matrix2, Matrix3, Point3, UnitQuaternion, Vector2, Vector3};

pub use camera::CameraModel;
pub use error::RigError;
pub use geometry::{StereoGeometry, Triangulated};
pub use table::UndistortTable;

/// Baselines outside of this are most likely centimetres, metres or a slip, in mm.
const USUAL_BASELINE_MM: std::ops::RangeInclusive<f64> = 15.0..=2000.0;

/// Two cameras and how they stand to each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rig {
    /// The left camera; its frame is the rig's.
    pub left: CameraModel,
    /// The right camera.
    pub right: CameraModel,
    /// `X_right = R X_left + T`, T in mm.
    pub right_from_left: Isometry3<f64>,
}

impl Rig {
    /// Where the left camera sees a point of the left camera's frame; see [`CameraModel::project`].
    #[inline]
    pub fn project_left(&self, point_left_mm: &Point3<f64>) -> Option<Vector2<f64>> {
        self.left.project(point_left_mm)
    }

    /// Where the right camera sees a point of the left camera's frame; see [`CameraModel::project`].
    #[inline]
    pub fn project_right(&self, point_left_mm: &Point3<f64>) -> Option<Vector2<f64>> {
        self.right.project(&(self.right_from_left * point_left_mm))
    }

    /// What of the turn from the left camera's frame to the right one's is seen across the line of sight: directions in the left
    /// picture as the right one sees them, but for what is foreshortened. One camera may be rolled against the other.
    pub fn right_from_left_across(&self) -> Matrix2<f64> {
        self.right_from_left.rotation.to_rotation_matrix().matrix().fixed_view::<2, 2>(0, 0).into_owned()
    }

    /// The stereo geometry, worked out once. Hot code keeps it; the methods below make it anew at every call.
    pub fn geometry(&self) -> StereoGeometry {
        StereoGeometry::new(self)
    }

    /// The point that explains both image points best; see [`StereoGeometry::triangulate`].
    pub fn triangulate(&self, left_norm: Vector2<f64>, right_norm: Vector2<f64>) -> Option<Triangulated> {
        self.geometry().triangulate(left_norm, right_norm)
    }

    /// Covariance in mm² of a triangulated point of the left camera's frame, where every image coordinate has
    /// independent noise of `sigma_px`: σ² (JᵀJ)⁻¹ with the Jacobian of all four coordinates. `None` where the
    /// cameras do not fix the point (not in front of both, on the baseline, at infinity).
    ///
    /// ```
    /// let rig = pickcell::rig::Rig::read(concat!(env!("CARGO_MANIFEST_DIR"), "/replay/conveyor/calibration.yaml"))?;
    /// let covariance = rig.triangulation_covariance(&nalgebra::Point3::new(0.0, 0.0, 480.0), 0.2).unwrap();
    /// let [across_mm, along_mm] = [covariance.m22, covariance.m33].map(f64::sqrt);
    /// assert!(across_mm < 0.15 && along_mm > 3.0 * across_mm, "depth is known least");
    /// # Ok::<(), pickcell::rig::RigError>(())
    /// ```
    pub fn triangulation_covariance(
        &self,
        point_left_mm: &Point3<f64>,
        sigma_px: f64,
    ) -> Option<Matrix3<f64>> {
        let (_, left) = self.left.project_with_jacobian(point_left_mm)?;
        let (_, right) = self.right.project_with_jacobian(&(self.right_from_left * point_left_mm))?;
        let right = right * self.right_from_left.rotation.to_rotation_matrix().into_inner();
        let information = left.tr_mul(&left) + right.tr_mul(&right);
        let covariance = information.cholesky()?.inverse() * (sigma_px * sigma_px);
        covariance.iter().all(|v| v.is_finite()).then_some(covariance)
    }

    /// Distance of the two cameras' centres in mm.
    pub fn baseline_mm(&self) -> f64 {
        self.right_from_left.translation.vector.norm()
    }

    /// What may be wrong with where the cameras stand, though it can be: a slip of units, or T the wrong way round, after which
    /// nothing is recognised.
    pub fn doubt(&self) -> Option<String> {
        let baseline_mm = self.baseline_mm();
        if !USUAL_BASELINE_MM.contains(&baseline_mm) {
            return Some(format!(
                "the cameras stand {baseline_mm:.1} mm apart: T must be in millimetres (not in centimetres or metres), P[0,3] \
                 of ROS files in metres; see whether it is"
            ));
        }
        (self.right_from_left.translation.x > 0.5 * baseline_mm).then(|| {
            "the right camera stands at the left of the left one: T may be the wrong way round (it is the left camera's origin \
             in the right camera's frame, its x below 0 as a rule, as the right camera's P[0,3] of ROS files), or the cameras \
             are exchanged; see whether they are"
                .to_owned()
        })
    }

    /// The right camera's optical centre, mm, in the left camera's frame.
    pub fn right_eye(&self) -> Point3<f64> {
        self.right_from_left.inverse() * Point3::origin()
    }

    /// The rig whose right camera has turned about its optical centre by this rotation vector, radians, along the left
    /// camera's axes.
    pub fn with_right_turned(&self, turn: &Vector3<f64>) -> Self {
        let rotation = self.right_from_left.rotation * UnitQuaternion::new(-turn);
        let translation = -(rotation * self.right_eye().coords);
        Self { right_from_left: Isometry3::from_parts(translation.into(), rotation), ..*self }
    }

    /// Whether both cameras were calibrated for pictures of this size.
    ///
    /// # Errors
    /// [`RigError::Size`] names the camera and both sizes.
    pub fn check_size(&self, width: usize, height: usize) -> Result<(), RigError> {
        self.left.check_size("left", width, height)?;
        self.right.check_size("right", width, height)
    }
}

#[cfg(test)]
mod tests;
