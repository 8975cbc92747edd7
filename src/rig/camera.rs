//! One camera: pinhole and lens distortion, forwards and backwards.
//!
//! The model is OpenCV's, with all 14 coefficients
//! (<https://docs.opencv.org/4.x/d9/d0c/group__calib3d.html>, "Detailed Description"): radial (rational),
//! tangential, thin prism, tilted sensor. Normalised coordinates are `x = X / Z`, `y = Y / Z`; pixel centres are
//! at whole numbers.

use nalgebra::{Matrix2, Matrix2x3, Matrix3, Point3, Vector2, Vector3};

use super::RigError;

/// Pinhole and distortion of one camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraModel {
    /// Picture width in pixels.
    pub width: usize,
    /// Picture height in pixels.
    pub height: usize,
    /// Focal length along x in pixels, above 0.
    pub fx: f64,
    /// Focal length along y in pixels, above 0.
    pub fy: f64,
    /// Principal point, x in pixels.
    pub cx: f64,
    /// Principal point, y in pixels.
    pub cy: f64,
    /// `k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4 tauX tauY`, OpenCV's order; 0 where the calibration has fewer.
    pub distortion: [f64; 14],
}

/// Newton steps at most; from the fixed-point start it takes 2 to 5 wherever the lens model is one to one.
const NEWTON_STEPS: usize = 40;
/// A distorted normalised coordinate is met to this: 1e-9 px at any usual focal length.
const TOLERANCE: f64 = 1e-13;

impl CameraModel {
    /// A camera without distortion.
    pub fn pinhole(width: usize, height: usize, focal_px: f64, cx: f64, cy: f64) -> Self {
        Self { width, height, fx: focal_px, fy: focal_px, cx, cy, distortion: [0.0; 14] }
    }

    /// The camera of the same picture at half its size, of which a pixel is four of this one's.
    pub fn halved(&self) -> Self {
        let Self { width, height, fx, fy, cx, cy, distortion } = *self;
        Self {
            width: width / 2,
            height: height / 2,
            fx: fx / 2.0,
            fy: fy / 2.0,
            cx: (cx - 0.5) / 2.0,
            cy: (cy - 0.5) / 2.0,
            distortion,
        }
    }

    /// Where a point of the camera's frame (OpenCV axes, any one unit of length) is seen: distorted pixels. `None`
    /// where it is not in front of the camera, or its pixel is not finite (what is infinitely far in front, its x and y
    /// finite, is seen at the principal point). The picture's border is not looked at; far outside of
    /// the field of view (as a rule beyond 1.5 times the corner's radius) strong barrel distortion folds over,
    /// here as in OpenCV.
    #[inline]
    pub fn project(&self, point_camera_mm: &Point3<f64>) -> Option<Vector2<f64>> {
        let p = point_camera_mm;
        if p.z <= 1e-9 {
            return None;
        }
        let px = self.distort(Vector2::new(p.x / p.z, p.y / p.z));
        (px.x.is_finite() && px.y.is_finite()).then_some(px)
    }

    /// [`project`](Self::project) and the derivative of the pixel by the point, in pixels a millimetre.
    #[inline]
    pub fn project_with_jacobian(
        &self,
        point_camera_mm: &Point3<f64>,
    ) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
        let p = point_camera_mm;
        if p.z <= 1e-9 {
            return None;
        }
        let inv_z = 1.0 / p.z;
        let norm = Vector2::new(p.x * inv_z, p.y * inv_z);
        let (px, by_norm) = self.distort_with_jacobian(norm);
        if !(px.x.is_finite() && px.y.is_finite()) {
            return None;
        }
        let norm_by_point = Matrix2x3::new(inv_z, 0.0, -norm.x * inv_z, 0.0, inv_z, -norm.y * inv_z);
        Some((px, by_norm * norm_by_point))
    }

    /// Normalised image coordinates to distorted pixels.
    #[inline]
    pub fn distort(&self, norm: Vector2<f64>) -> Vector2<f64> {
        let d = self.distort_norm(norm);
        Vector2::new(self.fx * d.x + self.cx, self.fy * d.y + self.cy)
    }

    /// [`distort`](Self::distort) and the derivative of the pixel by the normalised coordinates.
    #[inline]
    pub fn distort_with_jacobian(&self, norm: Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        let (d, j) = self.distort_norm_with_jacobian(norm);
        let px = Vector2::new(self.fx * d.x + self.cx, self.fy * d.y + self.cy);
        (px, Matrix2::new(self.fx * j.m11, self.fx * j.m12, self.fy * j.m21, self.fy * j.m22))
    }

    /// Distorted pixels to normalised image coordinates, the reverse of [`distort`](Self::distort) to better than
    /// 1e-9: OpenCV's fixed-point iteration for a start, damped Newton steps for the rest. Where no ray is seen at
    /// this pixel (outside of the part of the plane that the lens model covers) it is the nearest found, finite for
    /// a finite pixel.
    pub fn undistort(&self, px: Vector2<f64>) -> Vector2<f64> {
        let target = Vector2::new((px.x - self.cx) / self.fx, (px.y - self.cy) / self.fy);
        if self.distortion == [0.0; 14] {
            return target;
        }
        // Two rounds of x = (target - tangential) / radial, or the target itself where that leaves the plane.
        let at_target = self.distort_norm(target);
        let closer = target - (at_target - target);
        let mut norm = target - (self.distort_norm(closer) - closer);
        let (mut value, mut jacobian) = self.distort_norm_with_jacobian(norm);
        let mut error = (value - target).norm();
        let start_error = (at_target - target).norm();
        if error.is_nan() || error >= start_error {
            (norm, error) = (target, start_error);
            (value, jacobian) = self.distort_norm_with_jacobian(norm);
        }
        for _ in 0..NEWTON_STEPS {
            if error <= TOLERANCE {
                break;
            }
            let Some(inverse) = jacobian.try_inverse() else { break };
            let step = inverse * (value - target);
            let mut scale = 1.0;
            let mut improved = false;
            while scale > 1e-3 {
                let next = norm - step * scale;
                let (next_value, next_jacobian) = self.distort_norm_with_jacobian(next);
                let next_error = (next_value - target).norm();
                if next_error < error {
                    (norm, value, jacobian, error) = (next, next_value, next_jacobian, next_error);
                    improved = true;
                    break;
                }
                scale *= 0.5;
            }
            if !improved {
                break;
            }
        }
        norm
    }

    /// Mean focal length in pixels.
    pub fn focal_px(&self) -> f64 {
        0.5 * (self.fx + self.fy)
    }

    /// Whether a pixel lies in the picture, `border_px` inside of its edge.
    pub fn sees(&self, px: Vector2<f64>, border_px: f64) -> bool {
        px.x >= border_px
            && px.y >= border_px
            && px.x <= self.width as f64 - 1.0 - border_px
            && px.y <= self.height as f64 - 1.0 - border_px
    }

    /// Whether the camera was calibrated for pictures of this size; `camera` is its name for the message.
    ///
    /// # Errors
    /// [`RigError::Size`] names the camera and both sizes.
    pub fn check_size(&self, camera: &'static str, width: usize, height: usize) -> Result<(), RigError> {
        let (calibrated, picture) = ((self.width, self.height), (width, height));
        if calibrated == picture { Ok(()) } else { Err(RigError::Size { camera, calibrated, picture }) }
    }

    #[inline]
    fn distort_norm(&self, norm: Vector2<f64>) -> Vector2<f64> {
        let [k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, ..] = self.distortion;
        let (x, y) = (norm.x, norm.y);
        let r2 = x * x + y * y;
        let radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)));
        let xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) + r2 * (s1 + s2 * r2);
        let yd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y + r2 * (s3 + s4 * r2);
        match self.tilt() {
            None => Vector2::new(xd, yd),
            Some(tilt) => {
                let v = tilt * Vector3::new(xd, yd, 1.0);
                Vector2::new(v.x / v.z, v.y / v.z)
            }
        }
    }

    #[inline]
    fn distort_norm_with_jacobian(&self, norm: Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        let [k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, ..] = self.distortion;
        let (x, y) = (norm.x, norm.y);
        let r2 = x * x + y * y;
        let above = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let below = 1.0 / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)));
        let radial = above * below;
        // derivative of the radial factor by r², doubled because d r² = 2 (x dx + y dy)
        let above_r2 = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3);
        let below_r2 = k4 + r2 * (2.0 * k5 + r2 * 3.0 * k6);
        let slope = 2.0 * (above_r2 - radial * below_r2) * below;
        let (prism_x, prism_y) = (2.0 * (s1 + 2.0 * s2 * r2), 2.0 * (s3 + 2.0 * s4 * r2));
        let value = Vector2::new(
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) + r2 * (s1 + s2 * r2),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y + r2 * (s3 + s4 * r2),
        );
        let cross = x * y * slope + 2.0 * (p1 * x + p2 * y);
        let jacobian = Matrix2::new(
            radial + x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x + prism_x * x,
            cross + prism_x * y,
            cross + prism_y * x,
            radial + y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x + prism_y * y,
        );
        let Some(tilt) = self.tilt() else { return (value, jacobian) };
        let v = tilt * Vector3::new(value.x, value.y, 1.0);
        let tilted = Vector2::new(v.x / v.z, v.y / v.z);
        let by_flat = Matrix2::new(
            tilt.m11 - tilted.x * tilt.m31,
            tilt.m12 - tilted.x * tilt.m32,
            tilt.m21 - tilted.y * tilt.m31,
            tilt.m22 - tilted.y * tilt.m32,
        ) / v.z;
        (tilted, by_flat * jacobian)
    }

    /// The homography of a tilted sensor (Scheimpflug), `None` for an upright one.
    #[inline]
    fn tilt(&self) -> Option<Matrix3<f64>> {
        let [tau_x, tau_y] = [self.distortion[12], self.distortion[13]];
        if tau_x == 0.0 && tau_y == 0.0 {
            return None;
        }
        let ((sx, cx), (sy, cy)) = (tau_x.sin_cos(), tau_y.sin_cos());
        let about_x = Matrix3::new(1.0, 0.0, 0.0, 0.0, cx, sx, 0.0, -sx, cx);
        let about_y = Matrix3::new(cy, 0.0, -sy, 0.0, 1.0, 0.0, sy, 0.0, cy);
        let r = about_y * about_x;
        Some(Matrix3::new(r.m33, 0.0, -r.m13, 0.0, r.m33, -r.m23, 0.0, 0.0, 1.0) * r)
    }
}
