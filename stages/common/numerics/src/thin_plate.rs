//! A thin plate through scattered values.
//!
//! **Problem.** Given values `v_k` with standard deviations `σ_k` at positions `x_k` in a rectangle,
//!
//! ```text
//! min_z  Σ_k ω_k (σ̄²/σ_k²) (z(x_k) − v_k)² + ρ ℓ⁴ ∫ z_xx² + 2 z_xy² + z_yy²,
//! ```
//!
//! `ρ` the density of the positions, `σ̄` the median deviation, `ω_k` robust weights. Structure finer
//! than the length `ℓ` is smoothed: `ℓ` is a quarter of the mean spacing of the points, so the plate
//! practically interpolates (measured: half a spacing costs a fifth of the accuracy after shading). `z` lives on a regular grid coarser
//! than the pixels, between whose nodes it is interpolated cubically.
//!
//! # Robustness
//! A plate that interpolates passes through false values too. The fit therefore starts stiff,
//! `ℓ` three spacings, where a false value stands out, and relaxes while weights are renewed.
//!
//! Source: Duchon 1977 (`duchon1977`), the biharmonic spline.

use crate::plate_solver::PlateSolver;
use crate::plate_system::{Functional, PixelNumbering, PlateError, PlateSystem};
use crate::robust::{SIGMA_FROM_MAD, median};
use rilievo_scene::Mask;

/// A value at a place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScatteredValue {
    /// Position, pixels.
    pub position: [f64; 2],
    /// Value.
    pub value: f64,
    /// Its standard deviation.
    pub sigma: f64,
}

/// Nodes along the longer side at most: enough for some thousand points, a tenth of a second.
const MAX_NODES_PER_SIDE: f64 = 120.0;
/// Stiffness of the robust rounds, in mean spacings.
const STIFFNESS: [f64; 4] = [3.0, 1.5, 0.8, 0.25];
/// Residuals beyond this many robust deviations are taken for false in a stiff round.
const OUTLIER_DEVIATIONS: f64 = 8.0;

/// The fitted plate.
#[derive(Clone, Debug)]
pub struct ThinPlate {
    origin: [f64; 2],
    spacing: f64,
    width: usize,
    height: usize,
    values: Vec<f64>,
    /// Which of the given values were taken for true.
    pub inliers: Vec<bool>,
}

impl ThinPlate {
    /// Fits a plate over the rectangle from `low` to `high` (pixels); `None` without points.
    ///
    /// # Errors
    /// [`PlateError`] when the system cannot be factorised.
    pub fn fit(
        low: [f64; 2],
        high: [f64; 2],
        points: &[ScatteredValue],
    ) -> Result<Option<Self>, PlateError> {
        let inside = |p: &ScatteredValue| {
            (0..2).all(|a| p.position[a] >= low[a] && p.position[a] <= high[a])
                && p.value.is_finite()
                && p.sigma > 0.0
        };
        let mut inliers: Vec<bool> = points.iter().map(inside).collect();
        let num = inliers.iter().filter(|&&i| i).count();
        if num == 0 {
            return Ok(None);
        }
        let extent = [high[0] - low[0], high[1] - low[1]];
        let area = (extent[0].max(1.0)) * (extent[1].max(1.0));
        let point_spacing = (area / num as f64).sqrt();
        let spacing = (extent[0].max(extent[1]) / MAX_NODES_PER_SIDE)
            .max(point_spacing / 6.0)
            .max(1.0);
        let nodes = |extent: f64| (extent / spacing).ceil() as usize + 3;
        let (width, height) = (nodes(extent[0]), nodes(extent[1]));
        // One node beyond the rectangle on every side, for the cubic interpolation.
        let origin = [low[0] - spacing, low[1] - spacing];
        let numbering = PixelNumbering::new(&Mask::filled(width, height, true));
        let solver = PlateSolver::direct(&numbering)?;
        let mut sigmas: Vec<f64> = points
            .iter()
            .zip(&inliers)
            .filter(|&(_, &i)| i)
            .map(|(p, _)| p.sigma)
            .collect();
        let typical = median(&mut sigmas).unwrap_or(1.0);
        let mut plate = Self {
            origin,
            spacing,
            width,
            height,
            values: vec![0.0; width * height],
            inliers: inliers.clone(),
        };
        // A plane needs three points; fewer give a constant.
        let mut weights: Vec<f64> = inliers.iter().map(|&i| f64::from(u8::from(i))).collect();
        let mut system = PlateSystem::new(numbering.len());
        for stiffness in STIFFNESS {
            if stiffness < 0.5 {
                // The last round only interpolates: residuals of true values on sharp relief must
                // not weaken them.
                for (weight, &inlier) in weights.iter_mut().zip(&inliers) {
                    *weight = f64::from(u8::from(inlier));
                }
            }
            let length = stiffness * point_spacing / spacing;
            let density = num as f64 * spacing * spacing / area;
            let bending = density * length.powi(4);
            system.clear();
            plate.add_bending(&numbering, &mut system, bending);
            for (point, &weight) in points.iter().zip(&weights) {
                if weight > 0.0 {
                    let relative = (typical / point.sigma).powi(2).clamp(1e-4, 1e4);
                    let functional = plate.bilinear(point.position);
                    system.add_square(&numbering, &functional, weight * relative, point.value);
                }
            }
            plate.values = solver.solve(&system)?;
            let residual =
                |p: &ScatteredValue| (plate.bilinear(p.position).of(&plate.values) - p.value).abs();
            let mut residuals: Vec<f64> = points
                .iter()
                .zip(&inliers)
                .filter(|&(_, &i)| i)
                .map(|(p, _)| residual(p))
                .collect();
            let scale = SIGMA_FROM_MAD * median(&mut residuals).unwrap_or(0.0) + 1e-12;
            for ((point, weight), inlier) in points.iter().zip(&mut weights).zip(&mut inliers) {
                if *inlier {
                    let t = residual(point) / (scale + 3.0 * point.sigma);
                    *weight = 1.0 / (1.0 + (t / 3.0).powi(2)).powi(2);
                    if stiffness >= 1.0 && t > OUTLIER_DEVIATIONS {
                        *weight = 0.0;
                        *inlier = false;
                    }
                }
            }
        }
        plate.inliers = inliers;
        Ok(Some(plate))
    }

    fn add_bending(&self, numbering: &PixelNumbering, system: &mut PlateSystem, bending: f64) {
        let at = |x: usize, y: usize| y * self.width + x;
        for y in 0..self.height {
            for x in 0..self.width {
                let mut add = |terms: &[(usize, f64)], weight: f64| {
                    let mut functional = Functional::default();
                    for &(node, c) in terms {
                        functional.push(node, c);
                    }
                    system.add_square(numbering, &functional, weight, 0.0);
                };
                for (dx, dy) in [(1, 0), (0, 1)] {
                    let (right, below) = (x + dx, y + dy);
                    if x >= dx && y >= dy && right < self.width && below < self.height {
                        let [before, here] = [at(x - dx, y - dy), at(x, y)];
                        let after = at(right, below);
                        add(&[(before, 1.0), (here, -2.0), (after, 1.0)], bending);
                    }
                }
                if x + 1 < self.width && y + 1 < self.height {
                    add(
                        &[
                            (at(x, y), 1.0),
                            (at(x + 1, y), -1.0),
                            (at(x, y + 1), -1.0),
                            (at(x + 1, y + 1), 1.0),
                        ],
                        2.0 * bending,
                    );
                }
                // Fewer than three points leave tilts free: hold them far below everything else.
                system.add_point(at(x, y), 1e-9, 0.0);
            }
        }
    }

    /// Grid coordinates of a position, and the cell that holds it.
    fn cell(&self, position: [f64; 2]) -> (usize, usize, f64, f64) {
        let u = ((position[0] - self.origin[0]) / self.spacing).clamp(1.0, self.width as f64 - 2.0);
        let v =
            ((position[1] - self.origin[1]) / self.spacing).clamp(1.0, self.height as f64 - 2.0);
        let x = (u.floor() as usize)
            .min(self.width.saturating_sub(3))
            .max(1);
        let y = (v.floor() as usize)
            .min(self.height.saturating_sub(3))
            .max(1);
        (x, y, u - x as f64, v - y as f64)
    }

    fn bilinear(&self, position: [f64; 2]) -> Functional {
        let (x, y, s, t) = self.cell(position);
        let at = y * self.width + x;
        let mut functional = Functional::default();
        functional.push(at, (1.0 - s) * (1.0 - t));
        functional.push(at + 1, s * (1.0 - t));
        functional.push(at + self.width, (1.0 - s) * t);
        functional.push(at + self.width + 1, s * t);
        functional
    }

    /// The plate at a position in pixels (outside the rectangle: at its nearest point).
    pub fn at(&self, position: [f64; 2]) -> f64 {
        let (x, y, s, t) = self.cell(position);
        let cubic = |t: f64| {
            let (t2, t3) = (t * t, t * t * t);
            [
                0.5 * (-t + 2.0 * t2 - t3),
                0.5 * (2.0 - 5.0 * t2 + 3.0 * t3),
                0.5 * (t + 4.0 * t2 - 3.0 * t3),
                0.5 * (t3 - t2),
            ]
        };
        let (a, b) = (cubic(s), cubic(t));
        let mut sum = 0.0;
        for (j, b) in b.iter().enumerate() {
            for (i, a) in a.iter().enumerate() {
                let row = (y + j - 1).min(self.height - 1);
                let column = (x + i - 1).min(self.width - 1);
                sum += a * b * self.values[row * self.width + column];
            }
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(outliers: bool) -> Vec<ScatteredValue> {
        (0..150)
            .map(|k| {
                let (x, y) = (((k * 37) % 151) as f64 * 2.0, ((k * 61) % 113) as f64 * 2.0);
                let truth = 0.3 * x - 0.2 * y + 15.0 * (x / 60.0).sin();
                let wrong = outliers && k % 20 == 3;
                ScatteredValue {
                    position: [x, y],
                    value: truth + if wrong { 90.0 } else { 0.0 },
                    sigma: 0.1,
                }
            })
            .collect()
    }

    #[test]
    fn follows_a_smooth_surface_and_rejects_false_values() {
        for outliers in [false, true] {
            let points = points(outliers);
            let plate = ThinPlate::fit([0.0, 0.0], [302.0, 226.0], &points)
                .expect("solvable")
                .expect("points");
            let num_rejected = plate.inliers.iter().filter(|&&i| !i).count();
            assert_eq!(num_rejected, if outliers { 8 } else { 0 });
            let mut worst = 0.0_f64;
            for k in 0..200 {
                let (x, y) = (20.0 + (k % 20) as f64 * 13.0, 20.0 + (k / 20) as f64 * 18.0);
                let truth = 0.3 * x - 0.2 * y + 15.0 * (x / 60.0).sin();
                worst = worst.max((plate.at([x, y]) - truth).abs());
            }
            assert!(worst < 2.5, "{worst} with outliers {outliers}");
        }
    }

    #[test]
    fn one_point_gives_its_value_everywhere() {
        let only = ScatteredValue {
            position: [5.0, 6.0],
            value: 3.0,
            sigma: 1.0,
        };
        let plate = ThinPlate::fit([0.0, 0.0], [20.0, 10.0], &[only])
            .expect("solvable")
            .expect("point");
        let value = plate.at([5.0, 6.0]);
        assert!((value - 3.0).abs() < 1e-3, "{value}");
        assert!(
            ThinPlate::fit([0.0, 0.0], [20.0, 10.0], &[])
                .expect("solvable")
                .is_none()
        );
    }
}
