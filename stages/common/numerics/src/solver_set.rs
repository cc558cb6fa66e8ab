//! The solvers of several views.

use crate::plate_solver::PlateSolver;
use crate::plate_system::{PixelNumbering, PlateError};
use std::sync::{Arc, OnceLock};

/// Solvers of the views of a level, one each, set up when they are asked for. Kept for the next time, or not: the memory
/// of all views' exact solvers is a good part of a run's.
#[derive(Debug)]
pub struct SolverSet {
    is_exact: bool,
    kept: Option<Vec<OnceLock<Arc<PlateSolver>>>>,
}

impl SolverSet {
    /// Exact solvers ([`PlateSolver::direct`]).
    pub fn direct(num_views: usize, keeps: bool) -> Self {
        Self::new(num_views, true, keeps)
    }

    /// Approximate ones ([`PlateSolver::iterative`]).
    pub fn iterative(num_views: usize, keeps: bool) -> Self {
        Self::new(num_views, false, keeps)
    }

    fn new(num_views: usize, is_exact: bool, keeps: bool) -> Self {
        let none = || (0..num_views).map(|_| OnceLock::new()).collect();
        Self {
            is_exact,
            kept: keeps.then(none),
        }
    }

    /// The solver of a view, whose pixels are always the same.
    ///
    /// # Errors
    /// When the factorisation does not fit its index type or memory.
    pub fn of(
        &self,
        view: usize,
        numbering: &PixelNumbering,
    ) -> Result<Arc<PlateSolver>, PlateError> {
        let place = self.kept.as_ref().and_then(|kept| kept.get(view));
        if let Some(solver) = place.and_then(OnceLock::get) {
            return Ok(solver.clone());
        }
        let solver = Arc::new(if self.is_exact {
            PlateSolver::direct(numbering)?
        } else {
            PlateSolver::iterative(numbering)
        });
        // Two threads never ask for the same view at once; if they did, both solvers are alike.
        Ok(place.map_or_else(
            || solver.clone(),
            |place| place.get_or_init(|| solver.clone()).clone(),
        ))
    }
}
