//! The surface at a level that is in memory, or out of core.

use rilievo_scene::ScratchError;
use rilievo_stereo::level::ViewGrid;
use rilievo_stereo::stored::StoredSurface;
use serde::{Deserialize, Serialize};

/// The surface of all views at a level that is solved as a whole.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Shape {
    pub at: usize,
    /// Log depths.
    pub depths: Vec<Vec<f64>>,
}

/// The surface of all views at a finer level, out of core. Where no coarser level reaches, its depths are not known.
#[derive(Debug)]
pub(crate) struct FineShape {
    pub at: usize,
    pub surface: StoredSurface,
}

/// The surface that was found.
#[derive(Debug)]
pub(crate) enum FoundShape {
    Whole(Shape),
    Fine(FineShape),
}

impl FoundShape {
    /// Number of its level.
    pub fn at(&self) -> usize {
        match self {
            Self::Whole(shape) => shape.at,
            Self::Fine(shape) => shape.at,
        }
    }

    pub fn of_view(
        &self,
        i: usize,
        grid: &ViewGrid,
    ) -> Result<(Vec<f64>, Vec<bool>), ScratchError> {
        match self {
            Self::Whole(shape) => Ok(shape.of_view(i)),
            Self::Fine(shape) => shape.of_view(i, grid),
        }
    }
}

impl Shape {
    /// Log depths of a view, all of them known.
    pub fn of_view(&self, i: usize) -> (Vec<f64>, Vec<bool>) {
        let depth = self.depths[i].clone();
        let known = vec![true; depth.len()];
        (depth, known)
    }
}

impl FineShape {
    /// Log depths of a view, and where they are known.
    pub fn of_view(
        &self,
        i: usize,
        grid: &ViewGrid,
    ) -> Result<(Vec<f64>, Vec<bool>), ScratchError> {
        let depth = self.surface.get(i, &grid.pixels)?;
        Ok((depth, self.surface.known(i, &grid.pixels)?))
    }
}
