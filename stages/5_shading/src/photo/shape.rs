//! The surface of all views at a level that is in memory, or out of core.

use rilievo_scene::ScratchError;
use rilievo_stereo::level::ViewGrid;
use rilievo_stereo::stored::StoredSurface;
use serde::{Deserialize, Serialize};
use std::fmt::Debug;

/// The surface of all views at one level.
pub(crate) trait Surface: Debug + Send + Sync {
    /// Number of the level.
    fn level(&self) -> usize;

    /// Log depths of a view with the pixels `grid`, and where they are known.
    fn of_view(&self, i: usize, grid: &ViewGrid) -> Result<(Vec<f64>, Vec<bool>), ScratchError>;
}

/// The surface of all views at a level that is solved as a whole.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Shape {
    pub at: usize,
    /// Log depths.
    pub depths: Vec<Vec<f64>>,
}

/// The surface of all views at a finer level, out of core. Where no coarser level reaches, its
/// depths are not known.
#[derive(Debug)]
pub(crate) struct FineShape {
    pub at: usize,
    pub surface: StoredSurface,
}

impl Surface for Shape {
    fn level(&self) -> usize {
        self.at
    }

    fn of_view(&self, i: usize, _: &ViewGrid) -> Result<(Vec<f64>, Vec<bool>), ScratchError> {
        let depth = self.depths[i].clone();
        let known = vec![true; depth.len()];
        Ok((depth, known))
    }
}

impl Surface for FineShape {
    fn level(&self) -> usize {
        self.at
    }

    fn of_view(&self, i: usize, grid: &ViewGrid) -> Result<(Vec<f64>, Vec<bool>), ScratchError> {
        let depth = self.surface.get(i, &grid.pixels)?;
        Ok((depth, self.surface.known(i, &grid.pixels)?))
    }
}
