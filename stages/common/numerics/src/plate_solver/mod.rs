//! Solvers of the plate's systems over one numbering of pixels.

mod cholesky;
mod gradients;

use crate::plate_system::{PixelNumbering, PlateError, PlateSystem};
use cholesky::Cholesky;
use gradients::ConjugateGradients;

/// A solver of systems over one numbering: set up once, used often.
#[derive(Debug)]
pub struct PlateSolver(Kind);

#[derive(Debug)]
enum Kind {
    Direct(Box<Cholesky>),
    Iterative(ConjugateGradients),
}

impl PlateSolver {
    /// Exact, by a factorisation (approximate minimum degree): time and memory grow faster than the
    /// number of pixels, about 1 kB a pixel at half a million.
    ///
    /// # Errors
    /// When the factorisation does not fit its index type or memory.
    pub fn direct(numbering: &PixelNumbering) -> Result<Self, PlateError> {
        Cholesky::new(numbering).map(|solver| Self(Kind::Direct(Box::new(solver))))
    }

    /// To two digits, by conjugate gradients from zero: for increments of a surface that is about
    /// right already. Time is proportional to the number of pixels, memory to that of the rectangle around them.
    pub fn iterative(numbering: &PixelNumbering) -> Self {
        Self(Kind::Iterative(ConjugateGradients::new(numbering)))
    }

    /// Solves `H x = b`.
    ///
    /// # Errors
    /// [`PlateError::NotPositiveDefinite`].
    pub fn solve(&self, system: &PlateSystem) -> Result<Vec<f64>, PlateError> {
        match &self.0 {
            Kind::Direct(solver) => solver.solve(system),
            Kind::Iterative(solver) => solver.solve(system),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plate_system::Functional;
    use rilievo_scene::Raster;

    fn disc() -> PixelNumbering {
        PixelNumbering::new(&Raster::from_fn(17, 13, |x, y| {
            (x as i32 - 8).pow(2) + (y as i32 - 6).pow(2) < 38
        }))
    }

    /// Squared second differences of unit weight.
    fn plate(numbering: &PixelNumbering) -> PlateSystem {
        let mut system = PlateSystem::new(numbering.len());
        let mut bend = |terms: &[(Option<usize>, f64)], weight: f64| {
            let mut f = Functional::default();
            for &(pixel, c) in terms {
                let Some(pixel) = pixel else { return };
                f.push(pixel, c);
            }
            system.add_square(numbering, &f, weight, 0.0);
        };
        for i in 0..numbering.len() {
            let at = |dx, dy| numbering.neighbour(i, dx, dy);
            for (dx, dy) in [(1, 0), (0, 1)] {
                bend(
                    &[(at(-dx, -dy), 1.0), (Some(i), -2.0), (at(dx, dy), 1.0)],
                    1.0,
                );
            }
            bend(
                &[
                    (Some(i), 1.0),
                    (at(1, 0), -1.0),
                    (at(0, 1), -1.0),
                    (at(1, 1), 1.0),
                ],
                2.0,
            );
        }
        system
    }

    fn largest(values: impl Iterator<Item = f64>) -> f64 {
        values.map(f64::abs).fold(0.0, f64::max)
    }

    #[test]
    fn a_plane_through_two_rows_of_points_is_continued_exactly() {
        let numbering = disc();
        let mut system = plate(&numbering);
        let truth: Vec<f64> = numbering
            .xs
            .iter()
            .zip(&numbering.ys)
            .map(|(&x, &y)| 0.3 * f64::from(x) - 0.2 * f64::from(y) + 1.0)
            .collect();
        for (i, &value) in truth.iter().enumerate() {
            if (5..=6).contains(&numbering.ys[i]) {
                system.add_point(i, 3.0, value);
            }
            system.add_point(i, 1e-12, value);
        }
        let x = PlateSolver::direct(&numbering).and_then(|solver| solver.solve(&system));
        let Ok(x) = x else { panic!("{x:?}") };
        let worst = largest(x.iter().zip(&truth).map(|(a, b)| a - b));
        assert!(worst < 1e-7, "{worst}");
        let product = system.multiply(&numbering, &x);
        let residual = largest(product.iter().zip(&system.rhs).map(|(a, b)| a - b));
        assert!(residual < 1e-9, "{residual}");
    }

    #[test]
    fn conjugate_gradients_reach_what_the_factorisation_finds() {
        let numbering = disc();
        // Stiff as in an outer iteration: sixty times the hold of each pixel's own value.
        let mut system = plate(&numbering);
        for row in &mut system.coefficients {
            *row = row.map(|c| 60.0 * c);
        }
        for i in 0..numbering.len() {
            let (x, y) = (f64::from(numbering.xs[i]), f64::from(numbering.ys[i]));
            system.add_point(i, 1.0, (0.7 * x).sin() + (0.9 * y).cos());
        }
        let exact = PlateSolver::direct(&numbering).and_then(|solver| solver.solve(&system));
        let near = PlateSolver::iterative(&numbering).solve(&system);
        let (Ok(exact), Ok(near)) = (exact, near) else {
            panic!("no solution")
        };
        let size = largest(exact.iter().copied());
        let apart = largest(exact.iter().zip(&near).map(|(a, b)| a - b));
        assert!(apart < 0.02 * size, "{apart} of {size}");
    }

    #[test]
    fn conjugate_gradients_know_every_neighbour_on_masks_of_any_shape() {
        let masks = [
            // The whole frame; columns and rows of one pixel; holes, gaps in rows, and rows without any.
            Raster::from_fn(9, 7, |_, _| true),
            Raster::from_fn(1, 20, |_, _| true),
            Raster::from_fn(20, 1, |_, _| true),
            Raster::from_fn(1, 1, |_, _| true),
            Raster::from_fn(23, 19, |x, y| (7 * x + 5 * y) % 4 != 0 && y % 6 != 3),
            Raster::from_fn(12, 12, |x, y| x % 11 == 0 || y % 11 == 0),
        ];
        for mask in masks {
            let numbering = PixelNumbering::new(&mask);
            let mut system = plate(&numbering);
            for i in 0..numbering.len() {
                let value = ((3 * i % 7) as f64 - 3.0) * 0.5;
                system.add_point(i, 0.5 + (i % 3) as f64, value);
            }
            let exact = PlateSolver::direct(&numbering).and_then(|s| s.solve(&system));
            let near = PlateSolver::iterative(&numbering).solve(&system);
            let (Ok(exact), Ok(near)) = (exact, near) else {
                panic!("no solution")
            };
            let size = largest(exact.iter().copied());
            let apart = largest(exact.iter().zip(&near).map(|(a, b)| a - b));
            assert!(
                apart < 0.03 * size,
                "{} pixels: {apart} of {size}",
                exact.len()
            );
        }
    }

    #[test]
    fn a_matrix_that_is_not_positive_definite_is_refused() {
        let numbering = disc();
        let mut system = plate(&numbering);
        for i in 0..numbering.len() {
            system.add_point(i, -0.5, 1.0);
        }
        let refused = PlateError::NotPositiveDefinite {
            num_unknowns: numbering.len(),
        };
        let direct = PlateSolver::direct(&numbering).and_then(|solver| solver.solve(&system));
        assert_eq!(direct, Err(refused.clone()));
        assert_eq!(
            PlateSolver::iterative(&numbering).solve(&system),
            Err(refused)
        );
    }
}
