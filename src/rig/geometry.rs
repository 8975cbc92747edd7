//! Two cameras: epipolar geometry and triangulation, on normalised image coordinates.

use nalgebra::{Matrix2, Matrix3, Point3, Vector2, Vector3};

use super::Rig;

/// The stereo geometry of a [`Rig`], worked out once for the hot path.
///
/// ```
/// let rig = pickcell::rig::Rig::read(concat!(env!("CARGO_MANIFEST_DIR"), "/replay/conveyor/calibration.yaml"))?;
/// let geometry = rig.geometry();
/// let point = nalgebra::Point3::new(12.0, -7.0, 480.0);
/// let left = rig.left.undistort(rig.project_left(&point).unwrap());
/// let right = rig.right.undistort(rig.project_right(&point).unwrap());
/// assert!(right.push(1.0).dot(&(geometry.essential * left.push(1.0))).abs() < 1e-6);
/// // A pixel lower in the right picture, the two need no more than that to agree.
/// let lower = right + nalgebra::Vector2::new(0.0, 1.0 / rig.right.fy);
/// assert!((0.6..1.0).contains(&geometry.epipolar_offset_px(left, lower).abs()));
/// # Ok::<(), pickcell::rig::RigError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StereoGeometry {
    /// Rotation of `right_from_left`.
    pub rotation: Matrix3<f64>,
    /// Translation of `right_from_left` in mm.
    pub translation_mm: Vector3<f64>,
    /// `E` of `x_rightᵀ E x_left = 0`, with `x = (x, y, 1)` normalised and T in mm.
    pub essential: Matrix3<f64>,
    /// Focal lengths (fx, fy) of the left camera in pixels.
    pub focal_left_px: Vector2<f64>,
    /// Focal lengths (fx, fy) of the right camera in pixels.
    pub focal_right_px: Vector2<f64>,
}

/// A point seen by both cameras.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Triangulated {
    /// The point in the left camera's frame.
    pub point_left_mm: Point3<f64>,
    /// Root of the summed squared corrections that make the four image coordinates agree, in undistorted pixels:
    /// the least reprojection error that any point has. With independent noise of σ a coordinate it is |N(0, σ)|.
    pub residual_px: f64,
    /// The corrected left image point, normalised.
    pub left_norm: Vector2<f64>,
    /// The corrected right image point, normalised.
    pub right_norm: Vector2<f64>,
}

impl StereoGeometry {
    /// From a rig.
    pub fn new(rig: &Rig) -> Self {
        let rotation = rig.right_from_left.rotation.to_rotation_matrix().into_inner();
        let translation_mm = rig.right_from_left.translation.vector;
        Self {
            rotation,
            translation_mm,
            essential: translation_mm.cross_matrix() * rotation,
            focal_left_px: Vector2::new(rig.left.fx, rig.left.fy),
            focal_right_px: Vector2::new(rig.right.fx, rig.right.fy),
        }
    }

    /// How far two image points are from being pictures of one point, in pixels, with the sign of the epipolar
    /// constraint: to first order the root of the summed squared corrections that both need (Sampson distance). Not a number for
    /// points that are none, and for such as overflow.
    #[inline]
    pub fn epipolar_offset_px(&self, left_norm: Vector2<f64>, right_norm: Vector2<f64>) -> f64 {
        let line_right = self.essential * left_norm.push(1.0);
        let line_left = self.essential.tr_mul(&right_norm.push(1.0));
        let c = right_norm.push(1.0).dot(&line_right);
        let l = line_left.xy().component_div(&self.focal_left_px);
        let r = line_right.xy().component_div(&self.focal_right_px);
        let gradient = (l.norm_squared() + r.norm_squared()).sqrt();
        if gradient == 0.0 { 0.0 } else { c / gradient }
    }

    /// The point that both cameras see, with the least reprojection error: the image points are moved onto each
    /// other's epipolar lines by the least squared correction in pixels (Lindstrom, "Triangulation Made Easy",
    /// `niter2`, doi:10.1109/CVPR.2010.5539785), then their rays meet. `None` where the rays are parallel, meet
    /// behind a camera, or a coordinate is not finite.
    #[inline]
    pub fn triangulate(&self, left_norm: Vector2<f64>, right_norm: Vector2<f64>) -> Option<Triangulated> {
        let (left, right, residual_px) = self.correct(left_norm, right_norm);
        // z (R u) + T is parallel to v
        let (u, v) = (left.push(1.0), right.push(1.0));
        let ray = self.rotation * u;
        let across = v.cross(&ray);
        let sine2 = across.norm_squared() / (v.norm_squared() * ray.norm_squared());
        let z = -across.dot(&v.cross(&self.translation_mm)) / across.norm_squared();
        let z_right = ray.z * z + self.translation_mm.z;
        // 1e-14: rays within 1e-7 rad of parallel, further than any camera can tell from infinity
        (sine2 > 1e-14 && z > 0.0 && z_right > 0.0 && z.is_finite() && residual_px.is_finite()).then(|| {
            Triangulated {
                point_left_mm: Point3::from(u * z),
                residual_px,
                left_norm: left,
                right_norm: right,
            }
        })
    }

    /// The optimal correction of both image points and its size in pixels.
    #[inline]
    fn correct(&self, left: Vector2<f64>, right: Vector2<f64>) -> (Vector2<f64>, Vector2<f64>, f64) {
        // In units of pixels: x' = f x. There all four coordinates have the same noise, as the method wants.
        let (fl, fr) = (self.focal_left_px, self.focal_right_px);
        let e = &self.essential;
        let line_right = e * left.push(1.0);
        let line_left = e.tr_mul(&right.push(1.0));
        let c = right.push(1.0).dot(&line_right);
        let corner = Matrix2::new(
            e.m11 / (fr.x * fl.x),
            e.m12 / (fr.x * fl.y),
            e.m21 / (fr.y * fl.x),
            e.m22 / (fr.y * fl.y),
        );
        let n = line_right.xy().component_div(&fr);
        let m = line_left.xy().component_div(&fl);
        let a = n.dot(&(corner * m));
        let b = 0.5 * (n.norm_squared() + m.norm_squared());
        if b <= 0.0 {
            return (left, right, 0.0); // both at the epipoles: nothing to correct
        }
        let d = (b * b - a * c).max(0.0).sqrt();
        let first = c / (b + d);
        let n2 = n - corner * m * first;
        let m2 = m - corner.tr_mul(&n) * first;
        let second = first * 2.0 * d / (n2.norm_squared() + m2.norm_squared());
        let (move_right, move_left) = (n2 * second, m2 * second);
        let residual_px = (move_right.norm_squared() + move_left.norm_squared()).sqrt();
        (left - move_left.component_div(&fl), right - move_right.component_div(&fr), residual_px)
    }
}
