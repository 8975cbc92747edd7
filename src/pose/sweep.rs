//! Where the wire of a part is expected in a picture, eight of its stations at a time.
//!
//! Does for the stations of a pose what [`aim`](super::aim::aim) does for one piece of wire, with the eight side by side
//! in whatever registers the machine has; all levels give the same bits.

use std::ops::{Add, Div, Mul, Sub};

use nalgebra::{Isometry3, Matrix3, Point3, Vector2, Vector3, Vector6};

use super::aim::{aim, up};
use super::model::{PoseModel, Station};
use super::refine::View;
use crate::level::Level;
use crate::rig::CameraModel;

/// Stations of a step.
pub(super) const LANES: usize = 8;

/// A part at a pose, looked at by one camera after the other.
pub(super) struct Sweep {
    level: Level,
    /// From the part's frame to the left camera's.
    left_from_part: Isometry3<f64>,
    rotation: Matrix3<f64>,
    /// Where the part turns about, in the left camera's frame.
    centre: Point3<f64>,
    eye: Point3<f64>,
    radius_mm: f64,
    lift_radii: f64,
}

/// What is expected of one station in one picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Expected {
    /// The middle of what is seen.
    pub(super) px: Vector2<f64>,
    /// Unit vector across the wire.
    pub(super) across: Vector2<f64>,
    /// Half width of the silhouette.
    pub(super) half_width_px: f64,
    /// How far the middle moves across when the wire is raised by a radius.
    pub(super) lift_px: f64,
    /// How the middle moves across when the part is displaced and turned.
    pub(super) gradient: Vector6<f64>,
}

/// [`Expected`] of eight stations.
#[derive(Clone, Copy)]
pub(super) struct Eight {
    in_front: [bool; LANES],
    px: [Lanes; 2],
    across: [Lanes; 2],
    half_width_px: Lanes,
    lift_px: Lanes,
    gradient: [Lanes; 6],
}

impl Eight {
    /// Nothing is expected.
    pub(super) const NONE: Self = {
        let zero = Lanes([0.0; LANES]);
        Self {
            in_front: [false; LANES],
            px: [zero; 2],
            across: [zero; 2],
            half_width_px: zero,
            lift_px: zero,
            gradient: [zero; 6],
        }
    };

    /// The `lane`-th of them; `None` where the camera does not see it.
    pub(super) fn get(&self, lane: usize) -> Option<Expected> {
        let at = |two: &[Lanes; 2]| Vector2::new(two[0].0[lane], two[1].0[lane]);
        let px = at(&self.px);
        (self.in_front[lane] && px.x.is_finite() && px.y.is_finite()).then(|| Expected {
            px,
            across: at(&self.across),
            half_width_px: self.half_width_px.0[lane],
            lift_px: self.lift_px.0[lane],
            gradient: Vector6::from_fn(|row, _| self.gradient[row].0[lane]),
        })
    }
}

impl Sweep {
    /// `eye` is from where both cameras see the part, in the left camera's frame; `lift_radii` how far above the axis of
    /// the wire the middle of what is seen of it lies.
    pub(super) fn new(
        level: Level,
        model: &PoseModel,
        left_from_part: &Isometry3<f64>,
        eye: Point3<f64>,
        lift_radii: f64,
    ) -> Self {
        Self {
            level,
            left_from_part: *left_from_part,
            rotation: left_from_part.rotation.to_rotation_matrix().into_inner(),
            centre: left_from_part * model.centre_mm,
            eye,
            radius_mm: model.radius_mm,
            lift_radii,
        }
    }

    /// Works out where at most [`LANES`] stations are expected in these pictures.
    pub(super) fn expect<const N: usize>(
        &self,
        stations: &[&Station],
        views: &[View; N],
        expected: &mut [Eight; N],
    ) {
        let upright = |camera: &CameraModel| camera.distortion[12] == 0.0 && camera.distortion[13] == 0.0;
        if !views.iter().all(|view| upright(view.camera)) {
            for (eight, view) in expected.iter_mut().zip(views) {
                *eight = self.one_by_one(stations, view);
            }
            return;
        }
        match self.level {
            // SAFETY: `Level::detect` and `Level::available` name only levels that the machine has.
            #[cfg(target_arch = "x86_64")]
            Level::Avx512 => unsafe { self.expect_avx512(stations, views, expected) },
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            Level::Avx2 => unsafe { self.expect_avx2(stations, views, expected) },
            _ => self.expect_lanes(stations, views, expected),
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl")]
    fn expect_avx512<const N: usize>(
        &self,
        stations: &[&Station],
        views: &[View; N],
        expected: &mut [Eight; N],
    ) {
        self.expect_lanes(stations, views, expected);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn expect_avx2<const N: usize>(
        &self,
        stations: &[&Station],
        views: &[View; N],
        expected: &mut [Eight; N],
    ) {
        self.expect_lanes(stations, views, expected);
    }

    #[inline(always)]
    fn expect_lanes<const N: usize>(
        &self,
        stations: &[&Station],
        views: &[View; N],
        expected: &mut [Eight; N],
    ) {
        let (mut position, mut tangent) = ([Lanes::all(0.0); 3], [Lanes::all(0.0); 3]);
        for (lane, station) in stations.iter().enumerate().take(LANES) {
            for k in 0..3 {
                position[k].0[lane] = station.position_mm[k];
                tangent[k].0[lane] = station.tangent[k];
            }
        }
        let point = turned(&self.rotation, position, &self.left_from_part.translation.vector);
        let tangent = turned(&self.rotation, tangent, &Vector3::zeros());
        // As `up`.
        let to_eye = minus(splat(&self.eye.coords), point);
        let aside = minus(to_eye, times(tangent, dot(tangent, to_eye)));
        let raised = times(aside, Lanes::all(self.radius_mm) / dot(aside, aside).sqrt().at_least(1e-9));
        let lifted = plus(point, times(raised, Lanes::all(self.lift_radii)));
        let arm = minus(point, splat(&self.centre.coords));
        for (eight, view) in expected.iter_mut().zip(views) {
            self.in_view(view, lifted, tangent, raised, arm, eight);
        }
    }

    /// As [`aim`], then its gradient across.
    #[inline(always)]
    fn in_view(
        &self,
        view: &View,
        lifted: [Lanes; 3],
        tangent: [Lanes; 3],
        raised: [Lanes; 3],
        arm: [Lanes; 3],
        eight: &mut Eight,
    ) {
        let at = turned(&view.rotation, lifted, &view.camera_from_left.translation.vector);
        let (zero, by_z) = (Lanes::all(0.0), Lanes::all(1.0) / at[2]);
        let norm = [at[0] * by_z, at[1] * by_z];
        let (px, by_norm) = distorted(view.camera, norm);
        // Pixels per mm in the left camera's axes.
        let back = view.rotation.transpose();
        let row_of = |[a, b]: [Lanes; 2]| [a * by_z, b * by_z, zero - (a * norm[0] + b * norm[1]) * by_z];
        let (of_x, of_y) = (row_of(by_norm[0]), row_of(by_norm[1]));
        let (of_x, of_y) = (turned(&back, of_x, &Vector3::zeros()), turned(&back, of_y, &Vector3::zeros()));
        let along = [dot(of_x, tangent), dot(of_y, tangent)];
        let length = (along[0] * along[0] + along[1] * along[1]).sqrt();
        let across = [zero - along[1] / length, along[0] / length];
        let force = plus(times(of_x, across[0]), times(of_y, across[1]));
        let torque = [
            arm[1] * force[2] - arm[2] * force[1],
            arm[2] * force[0] - arm[0] * force[2],
            arm[0] * force[1] - arm[1] * force[0],
        ];
        for (lane, in_front) in eight.in_front.iter_mut().enumerate() {
            *in_front = at[2].0[lane] > 1e-9 && length.0[lane] >= 1e-6;
        }
        (eight.px, eight.across) = (px, across);
        eight.half_width_px = dot(force, force).sqrt() * Lanes::all(self.radius_mm);
        eight.lift_px = dot(force, raised);
        eight.gradient = [force[0], force[1], force[2], torque[0], torque[1], torque[2]];
    }

    /// The same without lanes: for lenses that lanes do not know, and the twin to test against.
    fn one_by_one(&self, stations: &[&Station], view: &View) -> Eight {
        let mut eight = Eight::NONE;
        for (lane, station) in stations.iter().enumerate() {
            let point = self.left_from_part * station.position_mm;
            let tangent = self.left_from_part.rotation * station.tangent;
            let raised = up(&self.eye, &point, &tangent) * self.radius_mm;
            let Some(aim) = aim(self.radius_mm, &(point + raised * self.lift_radii), &tangent, view) else {
                continue;
            };
            let gradient = aim.gradient(&aim.across, &(point - self.centre));
            eight.in_front[lane] = true;
            for k in 0..2 {
                (eight.px[k].0[lane], eight.across[k].0[lane]) = (aim.px[k], aim.across[k]);
            }
            eight.half_width_px.0[lane] = aim.half_width_px;
            eight.lift_px.0[lane] = (aim.jacobian * raised).dot(&aim.across);
            for (lanes, g) in eight.gradient.iter_mut().zip(gradient.iter()) {
                lanes.0[lane] = *g;
            }
        }
        eight
    }
}

/// As [`CameraModel::distort_with_jacobian`], without a tilted sensor: pixels, and their derivative row by row.
#[inline(always)]
fn distorted(camera: &CameraModel, [x, y]: [Lanes; 2]) -> ([Lanes; 2], [[Lanes; 2]; 2]) {
    let k = |index: usize| Lanes::all(camera.distortion[index]);
    let (k1, k2, p1, p2, k3, k4, k5, k6) = (k(0), k(1), k(2), k(3), k(4), k(5), k(6), k(7));
    let (s1, s2, s3, s4) = (k(8), k(9), k(10), k(11));
    let (one, two, three, six) = (Lanes::all(1.0), Lanes::all(2.0), Lanes::all(3.0), Lanes::all(6.0));
    let (x2, y2, xy) = (x * x, y * y, x * y);
    let r2 = x2 + y2;
    let above = one + r2 * (k1 + r2 * (k2 + r2 * k3));
    let below = one / (one + r2 * (k4 + r2 * (k5 + r2 * k6)));
    let radial = above * below;
    let above_r2 = k1 + r2 * (two * k2 + r2 * three * k3);
    let below_r2 = k4 + r2 * (two * k5 + r2 * three * k6);
    let slope = two * (above_r2 - radial * below_r2) * below;
    let prism_x = two * (s1 + two * s2 * r2);
    let prism_y = two * (s3 + two * s4 * r2);
    let xd = x * radial + two * p1 * xy + p2 * (r2 + two * x2) + r2 * (s1 + s2 * r2);
    let yd = y * radial + p1 * (r2 + two * y2) + two * p2 * xy + r2 * (s3 + s4 * r2);
    let cross = xy * slope + two * (p1 * x + p2 * y);
    let (fx, cx) = (Lanes::all(camera.fx), Lanes::all(camera.cx));
    let (fy, cy) = (Lanes::all(camera.fy), Lanes::all(camera.cy));
    let by_norm = [
        [fx * (radial + x2 * slope + two * p1 * y + six * p2 * x + prism_x * x), fx * (cross + prism_x * y)],
        [fy * (cross + prism_y * x), fy * (radial + y2 * slope + six * p1 * y + two * p2 * x + prism_y * y)],
    ];
    ([fx * xd + cx, fy * yd + cy], by_norm)
}

/// Eight numbers side by side.
#[derive(Clone, Copy, Debug)]
struct Lanes([f64; LANES]);

impl Lanes {
    #[inline(always)]
    fn all(value: f64) -> Self {
        Self([value; LANES])
    }

    #[inline(always)]
    fn each(mut self, other: Self, of: impl Fn(f64, f64) -> f64) -> Self {
        for l in 0..LANES {
            self.0[l] = of(self.0[l], other.0[l]);
        }
        self
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        self.each(self, |v, _| v.sqrt())
    }

    #[inline(always)]
    fn at_least(self, least: f64) -> Self {
        self.each(self, |v, _| v.max(least))
    }
}

impl Add for Lanes {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.each(other, |a, b| a + b)
    }
}

impl Sub for Lanes {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.each(other, |a, b| a - b)
    }
}

impl Mul for Lanes {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.each(other, |a, b| a * b)
    }
}

impl Div for Lanes {
    type Output = Self;
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        self.each(other, |a, b| a / b)
    }
}

#[inline(always)]
fn dot(a: [Lanes; 3], b: [Lanes; 3]) -> Lanes {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
fn splat(v: &Vector3<f64>) -> [Lanes; 3] {
    [Lanes::all(v.x), Lanes::all(v.y), Lanes::all(v.z)]
}

#[inline(always)]
fn plus(a: [Lanes; 3], b: [Lanes; 3]) -> [Lanes; 3] {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

#[inline(always)]
fn minus(a: [Lanes; 3], b: [Lanes; 3]) -> [Lanes; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(always)]
fn times(a: [Lanes; 3], by: Lanes) -> [Lanes; 3] {
    [a[0] * by, a[1] * by, a[2] * by]
}

/// `rotation * at + shift`.
#[inline(always)]
fn turned(r: &Matrix3<f64>, at: [Lanes; 3], shift: &Vector3<f64>) -> [Lanes; 3] {
    let turned = [
        dot(splat(&Vector3::new(r.m11, r.m12, r.m13)), at),
        dot(splat(&Vector3::new(r.m21, r.m22, r.m23)), at),
        dot(splat(&Vector3::new(r.m31, r.m32, r.m33)), at),
    ];
    plus(turned, splat(shift))
}

#[cfg(test)]
mod tests {
    use nalgebra::{Translation3, UnitQuaternion};

    use super::*;
    use crate::frame::{Frame, LumaView};
    use crate::part::Part;
    use crate::pose::section::Profiler;
    use crate::vision::bits::BitImage;

    fn with_views<T>(distortion: [f64; 14], test: impl FnOnce(&[View; 2]) -> T) -> T {
        let camera = CameraModel { distortion, ..CameraModel::pinhole(640, 480, 1100.0, 330.0, 245.0) };
        let frame = Frame::from_rgb(640, 480, vec![0; 640 * 480 * 3]);
        let mask = BitImage::new(640, 480);
        let right = Isometry3::from_parts(
            Translation3::new(-70.0, 1.5, 4.0),
            UnitQuaternion::from_euler_angles(0.01, 0.12, -0.02),
        );
        let view = |camera_from_left: Isometry3<f64>| View {
            camera: &camera,
            rotation: camera_from_left.rotation.to_rotation_matrix().into_inner(),
            camera_from_left,
            profiler: Profiler::new(LumaView::new(&frame).unwrap(), false, 12.0),
            mask: &mask,
        };
        test(&[view(Isometry3::identity()), view(right)])
    }

    fn swept(level: Level, views: &[View; 2]) -> Vec<[Option<Expected>; 2]> {
        let zed = Part::read(std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("replay/parts/zed.toml"));
        let model = PoseModel::new(&zed.unwrap());
        let pose = Isometry3::from_parts(
            Translation3::new(12.0, -20.0, 500.0),
            UnitQuaternion::from_euler_angles(0.3, -0.2, 1.1),
        );
        let sweep = Sweep::new(level, &model, &pose, Point3::new(35.0, 0.0, 0.0), 0.36);
        let stations: Vec<&Station> = model.stations.iter().collect();
        let mut all = Vec::new();
        for eight in stations.chunks(LANES) {
            let mut fast = [Eight::NONE; 2];
            sweep.expect(eight, views, &mut fast);
            for lane in 0..eight.len() {
                let slow = [0, 1].map(|side: usize| sweep.one_by_one(eight, &views[side]).get(lane));
                let fast = [0, 1].map(|side: usize| fast[side].get(lane));
                for (fast, slow) in fast.iter().flatten().zip(slow.iter().flatten()) {
                    let far = |a: f64, b: f64| (a - b).abs() > 1e-9 * b.abs().max(1.0);
                    let off = (fast.px - slow.px).norm() > 1e-9
                        || (fast.across - slow.across).norm() > 1e-9
                        || far(fast.half_width_px, slow.half_width_px)
                        || far(fast.lift_px, slow.lift_px)
                        || fast.gradient.iter().zip(slow.gradient.iter()).any(|(a, b)| far(*a, *b));
                    assert!(!off, "{fast:?} {slow:?}");
                }
                assert_eq!(fast.map(|e| e.is_some()), slow.map(|e| e.is_some()));
                all.push(fast);
            }
        }
        assert!(all.len() > 20 && all.iter().flatten().all(|e| e.is_some()));
        all
    }

    #[test]
    fn eight_at_a_time_are_as_one_by_one_and_all_levels_agree() {
        let lens = [-0.21, 0.08, 1e-3, -2e-3, 0.03, 0.01, -0.02, 0.005, 1e-3, 2e-4, -1e-3, 1e-4, 0.0, 0.0];
        with_views(lens, |views| {
            let plain = swept(Level::Plain, views);
            for level in Level::available() {
                assert_eq!(swept(*level, views), plain, "{level:?}");
            }
        });
    }

    #[test]
    fn a_tilted_sensor_is_looked_at_one_by_one() {
        let mut lens = [0.0; 14];
        (lens[0], lens[12], lens[13]) = (-0.2, 0.01, -0.02);
        with_views(lens, |views| swept(Level::detect(), views));
    }

    #[test]
    fn what_is_behind_the_camera_is_not_seen() {
        with_views([0.0; 14], |views| {
            let rod =
                Part::read(std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("replay/parts/rod-90.toml"));
            let model = PoseModel::new(&rod.unwrap());
            let behind = Isometry3::translation(0.0, 0.0, -100.0);
            let sweep = Sweep::new(Level::detect(), &model, &behind, Point3::origin(), 0.36);
            let mut seen = [Eight::NONE; 2];
            sweep.expect(&[&model.stations[0]], views, &mut seen);
            assert!(seen.iter().all(|eight| eight.get(0).is_none() && eight.get(7).is_none()));
        });
    }
}
