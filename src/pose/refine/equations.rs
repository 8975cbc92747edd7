//! The robust normal equations of a fit: measurements in, a step of the pose and how sure it is out.
//!
//! Measurements are kept eight to a block, column beside column, so that eight are weighed at a time in whatever
//! registers the machine has; all levels give the same bits.

use nalgebra::{Cholesky, Const, SMatrix, SVector, Vector3, Vector6};

use super::STATIONS_MAX;
use crate::level::Level;

/// Most measurements of one fit: of all stations and ends in both pictures.
pub(super) const MEASUREMENTS_MAX: usize = 2 * STATIONS_MAX + 128;
/// Measurements of a block.
const LANES: usize = 8;
/// Blocks that are weighed before their products are added up.
const BLOCKS_AT_ONCE: usize = 8;
/// Displacement and rotation of the part, then the offset of all sections in each picture.
const UNKNOWNS: usize = 8;
/// Fewest measurements that must be believed.
const BELIEVED_MIN: usize = 6;
/// What the pictures do not fix stays where it was, within about so many radii of the wire, and radians.
const START_RADII: f64 = 3.3;
const START_RAD: f64 = 0.2;
/// What is left of that where a pose may lie anywhere.
const AT_LARGE: f64 = 1e-4;

type Lanes = [f64; LANES];
pub(super) type Unknowns = SVector<f64, UNKNOWNS>;

/// A distance between what is seen and what is expected.
pub(super) struct Measurement {
    /// Seen minus expected, in pixels.
    pub(super) residual_px: f64,
    /// How the expected moves with displacement and rotation.
    pub(super) gradient: Vector6<f64>,
    /// Standard deviation, in pixels.
    pub(super) sigma_px: f64,
    /// Residual at which belief has halved, over that of a section: an end is seldom mistaken.
    pub(super) patience: f64,
    /// The picture whose shading moves it, if any.
    pub(super) shaded: Option<usize>,
}

#[derive(Clone, Copy, Debug)]
struct Block {
    residual: Lanes,
    /// A column for each unknown.
    gradient: [Lanes; UNKNOWNS],
    /// One over the standard deviation; 0 where there is no measurement.
    by_sigma: Lanes,
    by_patience: Lanes,
}

const EMPTY: Block = Block {
    residual: [0.0; LANES],
    gradient: [[0.0; LANES]; UNKNOWNS],
    by_sigma: [0.0; LANES],
    by_patience: [1.0; LANES],
};

/// How much a solution doubts its measurements, and what it knows besides.
#[derive(Clone, Copy, Debug)]
pub(super) struct Doubt<'a> {
    /// Residual at which the belief in a section has halved, in its standard deviations, in each round of reweighting.
    pub(super) scales: &'a [f64],
    /// Standard deviation of the offset that shading gives all sections of a picture, in pixels.
    pub(super) shading_sigma_px: f64,
    /// A direction about which the part has no angle.
    pub(super) along: Option<Vector3<f64>>,
    /// See [`start_sigma`].
    pub(super) start_sigma: [f64; 2],
}

/// Standard deviations of where a pose is started from, in mm and radians, with wire of this radius.
pub(super) fn start_sigma(radius_mm: f64) -> [f64; 2] {
    [START_RADII * radius_mm, START_RAD]
}

/// A step of the pose, and how well the measurements agree on it.
pub(super) struct Solution {
    normal: Cholesky<f64, Const<UNKNOWNS>>,
    start_sigma: [f64; 2],
    /// Displacement in mm and rotation in radians.
    pub(super) step: Vector6<f64>,
    /// Root of the weighted mean square of the residuals, in standard deviations.
    pub(super) misfit: f64,
    /// Number of measurements believed.
    pub(super) believed: usize,
}

impl Solution {
    /// Inverse of the normal equations, of displacement in mm, rotation in radians, and the offset of all sections in
    /// each picture in pixels: the covariance of these, in units of the assumed standard deviations.
    pub(super) fn inverse(&self) -> SMatrix<f64, UNKNOWNS, UNKNOWNS> {
        self.normal.inverse()
    }

    /// The same of a pose that may lie anywhere.
    pub(super) fn inverse_at_large(&self) -> Option<SMatrix<f64, UNKNOWNS, UNKNOWNS>> {
        let lower = self.normal.l();
        let mut normal = lower * lower.transpose();
        for (i, sigma) in self.start_sigma.iter().flat_map(|sigma| [sigma; 3]).enumerate() {
            normal[(i, i)] -= (1.0 - AT_LARGE) / (sigma * sigma);
        }
        normal.cholesky().map(|normal| normal.inverse())
    }
}

/// Sums over all measurements.
struct Sums {
    /// Lower half, a column after the other.
    normal: SMatrix<f64, UNKNOWNS, UNKNOWNS>,
    right_side: Unknowns,
    weights: f64,
    squares: f64,
    believed: usize,
}

/// The measurements of a fit.
pub(super) struct Equations {
    level: Level,
    blocks: Vec<Block>,
    count: usize,
}

impl Equations {
    /// Reserves all memory.
    pub(super) fn new(level: Level) -> Self {
        Self { level, blocks: Vec::with_capacity(MEASUREMENTS_MAX / LANES), count: 0 }
    }

    /// The instructions it uses.
    pub(super) fn level(&self) -> Level {
        self.level
    }

    pub(super) fn clear(&mut self) {
        self.blocks.clear();
        self.count = 0;
    }

    /// Adds a measurement, as long as there is room.
    pub(super) fn push(&mut self, m: &Measurement) {
        if self.count == MEASUREMENTS_MAX {
            return;
        }
        let lane = self.count % LANES;
        if lane == 0 {
            self.blocks.push(EMPTY);
        }
        self.count += 1;
        let Some(block) = self.blocks.last_mut() else { return };
        block.residual[lane] = m.residual_px;
        for (column, g) in block.gradient.iter_mut().zip(m.gradient.iter()) {
            column[lane] = *g;
        }
        if let Some(side) = m.shaded {
            block.gradient[6 + side][lane] = 1.0;
        }
        block.by_sigma[lane] = 1.0 / m.sigma_px;
        block.by_patience[lane] = 1.0 / m.patience;
    }

    /// Takes a step of the pose off what is measured.
    pub(super) fn step(&mut self, step: &Vector6<f64>) {
        for Block { residual, gradient, .. } in &mut self.blocks {
            for (column, step) in gradient.iter().zip(step.iter()) {
                for (residual, g) in residual.iter_mut().zip(column) {
                    *residual -= g * step;
                }
            }
        }
    }

    /// Of each measurement how it moves with all unknowns, its weight in the normal equations, where the step is nought
    /// and belief has halved at `scale`, and its residual in pixels.
    pub(super) fn weighed(&self, scale: f64) -> impl Iterator<Item = (Unknowns, f64, f64)> {
        (0..self.count).map(move |k| {
            let (Block { residual, gradient, by_sigma, by_patience }, lane) =
                (&self.blocks[k / LANES], k % LANES);
            let e = residual[lane] * by_sigma[lane];
            let belief = 1.0 / (1.0 + (e / scale * by_patience[lane]).powi(2));
            let gradient = Unknowns::from_fn(|row, _| gradient[row][lane]);
            (gradient, (belief * by_sigma[lane]).powi(2), residual[lane])
        })
    }

    /// Solves for the step that explains the measurements, by Gauss-Newton with a Geman-McClure loss, reweighted once
    /// for each scale of `doubt`. `None` where too few are believed.
    pub(super) fn solve(&self, doubt: &Doubt) -> Option<Solution> {
        let mut unknowns = Unknowns::zeros();
        let mut last = None;
        for &scale in doubt.scales {
            let mut sums = self.sum(&unknowns, scale);
            if sums.believed < BELIEVED_MIN {
                return None;
            }
            if let Some(a) = doubt.along {
                for c in 0..3 {
                    for r in c..3 {
                        sums.normal[(3 + r, 3 + c)] += a[r] * a[c] * 1e6;
                    }
                }
            }
            for i in 0..UNKNOWNS {
                let sigma = doubt.start_sigma.get(i / 3).copied().unwrap_or(doubt.shading_sigma_px);
                sums.normal[(i, i)] += 1.0 / (sigma * sigma);
            }
            let normal = sums.normal.cholesky()?;
            unknowns = normal.solve(&sums.right_side);
            if !unknowns.iter().all(|v: &f64| v.is_finite()) {
                return None;
            }
            last = Some((normal, (sums.squares / sums.weights).sqrt(), sums.believed));
        }
        let (normal, misfit, believed) = last?;
        let start_sigma = doubt.start_sigma;
        Some(Solution { normal, start_sigma, step: unknowns.fixed_rows::<6>(0).into(), misfit, believed })
    }

    fn sum(&self, unknowns: &Unknowns, scale: f64) -> Sums {
        match self.level {
            // SAFETY: `Level::detect` and `Level::available` name only levels that the machine has.
            #[cfg(target_arch = "x86_64")]
            Level::Avx512 => unsafe { self.sum_avx512(unknowns, scale) },
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            Level::Avx2 => unsafe { self.sum_avx2(unknowns, scale) },
            _ => self.sum_lanes(unknowns, scale),
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl")]
    fn sum_avx512(&self, unknowns: &Unknowns, scale: f64) -> Sums {
        self.sum_lanes(unknowns, scale)
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn sum_avx2(&self, unknowns: &Unknowns, scale: f64) -> Sums {
        self.sum_lanes(unknowns, scale)
    }

    /// The normal equations with the weights that the residuals after `unknowns` earn.
    #[inline(always)]
    fn sum_lanes(&self, unknowns: &Unknowns, scale: f64) -> Sums {
        let by_scale = 1.0 / scale;
        let mut normal = [[[0.0; LANES]; UNKNOWNS]; UNKNOWNS];
        let mut right_side = [[0.0; LANES]; UNKNOWNS];
        let [mut weights, mut squares, mut believed] = [[0.0; LANES]; 3];
        for blocks in self.blocks.chunks(BLOCKS_AT_ONCE) {
            let mut weight = [[0.0; LANES]; BLOCKS_AT_ONCE];
            for (block, weight) in blocks.iter().zip(&mut weight) {
                let Block { residual, gradient, by_sigma, by_patience } = block;
                let mut error = *residual;
                for (column, unknown) in gradient.iter().zip(unknowns.iter()) {
                    for l in 0..LANES {
                        error[l] -= column[l] * unknown;
                    }
                }
                for l in 0..LANES {
                    let e = error[l] * by_sigma[l];
                    let doubt = e * by_scale * by_patience[l];
                    let belief = 1.0 / (1.0 + doubt * doubt);
                    let w = belief * belief;
                    weights[l] += w;
                    squares[l] += w * e * e;
                    believed[l] += if w > 0.5 { 1.0 } else { 0.0 };
                    weight[l] = w * by_sigma[l] * by_sigma[l];
                }
            }
            let mut add =
                Products { blocks, weight: &weight, normal: &mut normal, right_side: &mut right_side };
            const { assert!(UNKNOWNS == 8, "a column each") };
            add.column::<0>();
            add.column::<1>();
            add.column::<2>();
            add.column::<3>();
            add.column::<4>();
            add.column::<5>();
            add.column::<6>();
            add.column::<7>();
        }
        // An empty lane is believed, but weighs nothing.
        let empty = (self.blocks.len() * LANES - self.count) as f64;
        let total = |lanes: &Lanes| lanes.iter().sum::<f64>();
        Sums {
            normal: SMatrix::from_fn(|r, c| if r >= c { total(&normal[c][r]) } else { 0.0 }),
            right_side: Unknowns::from_fn(|r, _| total(&right_side[r])),
            weights: total(&weights) - empty,
            squares: total(&squares),
            believed: (total(&believed) - empty) as usize,
        }
    }
}

/// Some weighed blocks, and the sums that their products go to.
struct Products<'a> {
    blocks: &'a [Block],
    weight: &'a [Lanes; BLOCKS_AT_ONCE],
    normal: &'a mut [[Lanes; UNKNOWNS]; UNKNOWNS],
    right_side: &'a mut [Lanes; UNKNOWNS],
}

impl Products<'_> {
    /// Adds those of one column. The sums of a single one stay in registers.
    #[inline(always)]
    fn column<const C: usize>(&mut self) {
        let (mut products, mut right) = (self.normal[C], self.right_side[C]);
        for (Block { residual, gradient, .. }, weight) in self.blocks.iter().zip(self.weight) {
            let mut weighed = gradient[C];
            for l in 0..LANES {
                weighed[l] *= weight[l];
                right[l] += weighed[l] * residual[l];
            }
            for r in C..UNKNOWNS {
                for l in 0..LANES {
                    products[r][l] += weighed[l] * gradient[r][l];
                }
            }
        }
        (self.normal[C], self.right_side[C]) = (products, right);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    const SCALES: [f64; 4] = [10.0, 8.0, 6.0, 3.0];
    const DOUBT: Doubt =
        Doubt { scales: &SCALES, shading_sigma_px: 0.01, along: None, start_sigma: [5.0, START_RAD] };

    /// Measurements of which a step explains all but every `wrong`th.
    fn measured(level: Level, step: &Vector6<f64>, count: usize, wrong: usize) -> Equations {
        let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(7);
        let mut equations = Equations::new(level);
        for k in 0..count {
            let gradient = Vector6::from_fn(|_, _| random.random_range(-2.0..2.0));
            let off = if k % wrong == wrong - 1 { 5.0 } else { random.random_range(-0.01..0.01) };
            equations.push(&Measurement {
                residual_px: gradient.dot(step) + off,
                gradient,
                sigma_px: 0.15,
                patience: 1.0,
                shaded: Some(k % 2),
            });
        }
        equations
    }

    #[test]
    fn the_step_is_found_whatever_a_few_measurements_say() {
        let step = Vector6::new(0.3, -0.2, 0.5, 0.02, -0.01, 0.03);
        let found = measured(Level::Plain, &step, 61, 8).solve(&DOUBT).unwrap();
        assert!((found.step - step).amax() < 0.01, "{}", found.step);
        assert_eq!(found.believed, 61 - 61 / 8);
        let sigma = found.inverse().diagonal().map(f64::sqrt);
        assert!(sigma.iter().take(6).all(|s| (0.001..0.1).contains(s)), "{sigma}");
    }

    #[test]
    fn too_few_measurements_are_none_and_more_than_there_is_room_for_are_left() {
        let step = Vector6::repeat(0.1);
        assert!(measured(Level::Plain, &step, 5, 99).solve(&DOUBT).is_none());
        assert!(measured(Level::Plain, &step, 6, 99).solve(&DOUBT).is_some());
        let many = measured(Level::Plain, &step, MEASUREMENTS_MAX + 100, 99_999);
        assert_eq!(many.solve(&DOUBT).unwrap().believed, MEASUREMENTS_MAX);
    }

    #[test]
    fn a_straight_part_is_not_turned_about_itself() {
        let step = Vector6::new(0.3, -0.2, 0.5, 0.0, 0.0, 0.2);
        let doubt = Doubt { along: Some(Vector3::z()), ..DOUBT };
        assert!(measured(Level::Plain, &step, 61, 99).solve(&doubt).unwrap().step[5].abs() < 1e-3);
    }

    #[test]
    fn all_levels_give_the_same_bits() {
        let step = Vector6::new(0.3, -0.2, 0.5, 0.02, -0.01, 0.03);
        let [first, others @ ..] = Level::available() else { return };
        let expected = measured(*first, &step, 203, 5).solve(&DOUBT).unwrap();
        for level in others {
            let found = measured(*level, &step, 203, 5).solve(&DOUBT).unwrap();
            assert_eq!((found.step, found.misfit), (expected.step, expected.misfit), "{level:?}");
        }
    }
}
