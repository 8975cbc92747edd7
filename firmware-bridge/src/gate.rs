//! The last gate: nothing stale, non-finite, outside the workspace, tilted too far, far from what was recognised or
//! seen while the arm was in view reaches a wire.
//!
//! Takes a [`Pick`] (or one point of a filled-in template line), the present moment and the moment before which no
//! picture counts; gives the reason why not. Owns the limits of `[workspace]`, `[gripper]` and `[arm]`. Every
//! dialect asks it when a pick comes and **again when its bytes are made**; driver and bridge both do.

use crate::config::Settings;
use crate::message::{ArmAxes, Pick, Pose, Refusal, Waypoint, distance_mm};

/// How far a quaternion's squared norm may be from 1.
const NORM_TOLERANCE: f64 = 1e-3;

/// The limits, ready to be compared with.
#[derive(Clone, Debug)]
pub struct Gate {
    min_mm: [f64; 3],
    max_mm: [f64; 3],
    /// Cosine of the largest tilt, of the workspace and of the axes together.
    tilt_cos_min: f64,
    /// Cosine of the largest tilt that the arm's axes forgive.
    axes_tilt_cos_min: f64,
    /// Closing direction of a gripper that cannot turn, and the cosine of the angle it forgives.
    fixed_closing: Option<([f64; 2], f64)>,
    jump_max_mm: f64,
    opening_max_mm: f64,
    opening_min_mm: f64,
}

impl Gate {
    /// From checked settings.
    pub fn new(settings: &Settings) -> Self {
        let workspace = &settings.workspace;
        let arm = &settings.arm;
        let yaw = settings.gripper.closing_yaw_deg.to_radians();
        Self {
            min_mm: workspace.min_mm,
            max_mm: workspace.max_mm,
            tilt_cos_min: workspace.tilt_max_deg.to_radians().cos(),
            axes_tilt_cos_min: match arm.axes {
                ArmAxes::Pose => -1.0,
                ArmAxes::Xyz | ArmAxes::XyzYaw => arm.tilt_tolerance_deg.to_radians().cos(),
            },
            fixed_closing: (arm.axes == ArmAxes::Xyz)
                .then(|| ([yaw.cos(), yaw.sin()], arm.yaw_tolerance_deg.to_radians().cos())),
            jump_max_mm: workspace.jump_max_mm,
            opening_max_mm: settings.gripper.opening_max_mm,
            opening_min_mm: settings.gripper.opening_min_mm,
        }
    }

    /// Everything about `pick` at `now_ns`. Both its frames must be later than `not_before_ns`: the later one of
    /// "the arm was last clear of the view" and "the previous target ended".
    pub fn check(&self, pick: &Pick, now_ns: i64, not_before_ns: i64) -> Result<(), Refusal> {
        self.check_time(pick, now_ns, not_before_ns)?;
        self.check_geometry(pick)
    }

    /// Only the times of `pick`: to be asked again when its bytes are made.
    pub fn check_time(&self, pick: &Pick, now_ns: i64, not_before_ns: i64) -> Result<(), Refusal> {
        const MS: i64 = 1_000_000;
        let ms = |ns: i64| u32::try_from(ns / MS).unwrap_or(u32::MAX);
        let ahead_ns = pick.seen.latest_ns().saturating_sub(now_ns);
        if ahead_ns > pick.seen.period_ns.max(0) {
            return Err(Refusal::FromFuture { ahead_ms: ms(ahead_ns) });
        }
        let max_ms = pick.deadline_ms.min(pick.ttl_ms);
        let age_ns = pick.age_ns(now_ns);
        if age_ns > i64::from(max_ms) * MS {
            return Err(Refusal::Stale { age_ms: ms(age_ns), max_ms });
        }
        if pick.seen.earliest_ns() <= not_before_ns {
            return Err(Refusal::SeenTooEarly);
        }
        Ok(())
    }

    /// Only the geometry of `pick`.
    pub fn check_geometry(&self, pick: &Pick) -> Result<(), Refusal> {
        if !pick.recognised_mm.iter().all(|v| v.is_finite()) {
            return Err(Refusal::NotFinite { at: Waypoint::Grasp });
        }
        for (at, pose) in pick.poses() {
            self.check_pose(at, pose)?;
            if at != Waypoint::Place {
                self.check_jump(at, distance_mm(pose.position_mm, pick.recognised_mm))?;
            }
        }
        let opening_mm = pick.opening_mm;
        if !(opening_mm >= self.opening_min_mm && opening_mm <= self.opening_max_mm) {
            return Err(Refusal::Opening { opening_mm: opening_mm as f32 });
        }
        Ok(())
    }

    /// One pose: finite, a rotation, inside the box, not tilted too far, within what the axes can turn.
    pub fn check_pose(&self, at: Waypoint, pose: &Pose) -> Result<(), Refusal> {
        let norm: f64 = pose.orientation_xyzw.iter().map(|v| v * v).sum();
        // A NaN fails the comparison, and so does an infinity.
        let is_rotation = (norm - 1.0).abs() <= NORM_TOLERANCE;
        if !is_rotation || !pose.position_mm.iter().all(|v| v.is_finite()) {
            return Err(Refusal::NotFinite { at });
        }
        self.check_box(at, pose.position_mm.map(Some))?;
        let down = (-pose.approach()[2] / norm).clamp(-1.0, 1.0);
        if down < self.tilt_cos_min - 1e-9 {
            return Err(Refusal::Tilted { at, tilt_deg: down.acos().to_degrees() as f32 });
        }
        if down < self.axes_tilt_cos_min - 1e-9 {
            return Err(Refusal::Axes { at });
        }
        if let Some(([x, y], cos_min)) = self.fixed_closing {
            let closing = pose.closing();
            let flat = closing[0].hypot(closing[1]);
            // Parallel fingers: a half turn is the same grasp.
            if (closing[0] * x + closing[1] * y).abs() < (cos_min - 1e-9) * flat {
                return Err(Refusal::Axes { at });
            }
        }
        Ok(())
    }

    /// A point of a template line that belongs to `pick`; `None` = the line leaves that axis where it is. Where
    /// all three are given the point must also be near the recognised grasp or the place.
    pub fn check_line(&self, pick: &Pick, point_mm: [Option<f64>; 3]) -> Result<(), Refusal> {
        self.check_box(Waypoint::Line, point_mm)?;
        if let [Some(x), Some(y), Some(z)] = point_mm {
            let near = distance_mm([x, y, z], pick.recognised_mm)
                .min(distance_mm([x, y, z], pick.place.position_mm));
            self.check_jump(Waypoint::Line, near)?;
        }
        Ok(())
    }

    /// Coordinates (those given): finite and inside the box.
    pub fn check_box(&self, at: Waypoint, point_mm: [Option<f64>; 3]) -> Result<(), Refusal> {
        for (axis, value) in point_mm.iter().enumerate() {
            let Some(value_mm) = *value else { continue };
            if !value_mm.is_finite() {
                return Err(Refusal::NotFinite { at });
            }
            if value_mm < self.min_mm[axis] || value_mm > self.max_mm[axis] {
                return Err(Refusal::OutsideWorkspace { at, axis: axis as u8, value_mm: value_mm as f32 });
            }
        }
        Ok(())
    }

    /// Smallest and largest coordinate of the workspace box along an axis (0 = x), mm.
    pub fn bounds_mm(&self, axis: usize) -> (f64, f64) {
        (self.min_mm[axis], self.max_mm[axis])
    }

    fn check_jump(&self, at: Waypoint, distance_mm: f64) -> Result<(), Refusal> {
        if distance_mm > self.jump_max_mm {
            return Err(Refusal::Jump { at, distance_mm: distance_mm as f32 });
        }
        Ok(())
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::message::Seen;

    const MS: i64 = 1_000_000;

    /// A cell with a box of ±200 x ±200 x 0..300 mm.
    pub(crate) fn settings() -> Settings {
        Settings::parse(
            "[workspace]\nmin_mm = [-200, -200, 0]\nmax_mm = [200, 200, 300]\ntilt_max_deg = 30\n",
        )
        .unwrap()
    }

    /// An admissible pick, seen at 1 s, with a deadline of 66 ms.
    pub(crate) fn pick() -> Pick {
        let at = |x, y, z| Pose { position_mm: [x, y, z], orientation_xyzw: [1.0, 0.0, 0.0, 0.0] };
        Pick {
            id: 7,
            session: 1,
            sequence: 1,
            seen: Seen { left_ns: 1000 * MS, right_ns: 1001 * MS, period_ns: 33 * MS },
            deadline_ms: 66,
            ttl_ms: 500,
            recognised_mm: [10.0, 20.0, 5.0],
            approach: at(10.0, 20.0, 45.0),
            grasp: at(10.0, 20.0, 5.0),
            retreat: at(10.0, 20.0, 65.0),
            place: at(-150.0, 100.0, 20.0),
            opening_mm: 8.0,
            slot: 0,
        }
    }

    fn refuse(change: impl Fn(&mut Pick)) -> Refusal {
        let mut pick = pick();
        change(&mut pick);
        Gate::new(&settings()).check(&pick, 1030 * MS, 900 * MS).unwrap_err()
    }

    #[test]
    fn a_good_pick_passes() {
        assert_eq!(Gate::new(&settings()).check(&pick(), 1030 * MS, 900 * MS), Ok(()));
    }

    #[test]
    fn each_geometric_limit_refuses_by_itself() {
        assert_eq!(refuse(|p| p.place.position_mm[2] = f64::NAN), Refusal::NotFinite { at: Waypoint::Place });
        assert_eq!(
            refuse(|p| p.grasp.orientation_xyzw = [0.0; 4]),
            Refusal::NotFinite { at: Waypoint::Grasp }
        );
        assert_eq!(
            refuse(|p| p.place.position_mm[0] = -201.0),
            Refusal::OutsideWorkspace { at: Waypoint::Place, axis: 0, value_mm: -201.0 }
        );
        let half = 20f64.to_radians();
        let tilted = [half.cos(), 0.0, half.sin(), 0.0];
        assert!(matches!(
            refuse(|p| p.approach.orientation_xyzw = tilted),
            Refusal::Tilted { at: Waypoint::Approach, tilt_deg } if (tilt_deg - 40.0).abs() < 1e-3
        ));
        assert!(matches!(
            refuse(|p| p.recognised_mm[0] = -180.0),
            Refusal::Jump { at: Waypoint::Approach, distance_mm } if distance_mm > 190.0
        ));
        assert_eq!(refuse(|p| p.opening_mm = f64::NAN).to_string(), "the gripper cannot open NaN mm");
        assert_eq!(refuse(|p| p.opening_mm = 30.5), Refusal::Opening { opening_mm: 30.5 });
    }

    #[test]
    fn times_are_checked_against_now() {
        let gate = Gate::new(&settings());
        let check = |now_ms: i64, not_before_ms: i64| gate.check(&pick(), now_ms * MS, not_before_ms * MS);
        assert_eq!(check(1066, 0), Ok(()));
        assert_eq!(check(1067, 0), Err(Refusal::Stale { age_ms: 67, max_ms: 66 }));
        assert_eq!(check(970, 0), Ok(()));
        assert_eq!(check(960, 0), Err(Refusal::FromFuture { ahead_ms: 41 }));
        assert_eq!(check(1030, 1000), Err(Refusal::SeenTooEarly));
        assert_eq!(check(1030, 999), Ok(()));
    }

    #[test]
    fn an_arm_without_wrist_takes_what_its_tolerances_allow() {
        let mut settings = settings();
        settings.arm.axes = ArmAxes::Xyz;
        let gate = Gate::new(&settings);
        let turned = |yaw_deg: f64| {
            let half = (yaw_deg / 2.0).to_radians();
            Pose { position_mm: [0.0, 0.0, 10.0], orientation_xyzw: [half.cos(), half.sin(), 0.0, 0.0] }
        };
        let refused = Err(Refusal::Axes { at: Waypoint::Grasp });
        assert_eq!(gate.check_pose(Waypoint::Grasp, &turned(9.0)), Ok(()));
        assert_eq!(gate.check_pose(Waypoint::Grasp, &turned(-171.0)), Ok(()));
        assert_eq!(gate.check_pose(Waypoint::Grasp, &turned(12.0)), refused);
        settings.arm.axes = ArmAxes::XyzYaw;
        assert_eq!(Gate::new(&settings).check_pose(Waypoint::Grasp, &turned(80.0)), Ok(()));
        let half = 6f64.to_radians();
        let tilted =
            Pose { position_mm: [0.0, 0.0, 10.0], orientation_xyzw: [half.cos(), 0.0, half.sin(), 0.0] };
        assert_eq!(Gate::new(&settings).check_pose(Waypoint::Grasp, &tilted), refused);
    }

    #[test]
    fn lines_stay_in_the_box_and_near_the_grasp_or_the_place() {
        let gate = Gate::new(&settings());
        assert_eq!(gate.check_line(&pick(), [Some(10.0), None, None]), Ok(()));
        assert_eq!(gate.check_line(&pick(), [Some(-150.0), Some(100.0), Some(60.0)]), Ok(()));
        assert!(matches!(
            gate.check_line(&pick(), [None, None, Some(301.0)]),
            Err(Refusal::OutsideWorkspace { at: Waypoint::Line, axis: 2, .. })
        ));
        assert!(matches!(
            gate.check_line(&pick(), [Some(190.0), Some(-190.0), Some(20.0)]),
            Err(Refusal::Jump { at: Waypoint::Line, .. })
        ));
    }
}
