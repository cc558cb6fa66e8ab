//! Smooth corrections of the views' depths, `z' = z e^{u(x, y)}`, with `u` bilinear between nodes of a coarse grid.

use crate::view::View;

/// Nodes of one view's correction.
#[derive(Clone, Debug)]
pub(crate) struct Grid {
    /// Index of the first node among all unknowns.
    pub start: usize,
    pub columns: usize,
    pub rows: usize,
    /// Focal length, pixels: from a change of log depth to footprints.
    pub focal_px: f64,
}

/// Corrections of all views.
#[derive(Clone, Debug)]
pub(crate) struct Corrections {
    pub grids: Vec<Grid>,
    /// Changes of log depth at the nodes.
    pub values: Vec<f64>,
    pub spacing_px: f64,
}

impl Corrections {
    /// No correction of any view, on nodes so many pixels apart.
    pub fn none(views: &[View], spacing_px: f64) -> Self {
        let grids = grids_of(views, spacing_px);
        let num_nodes = grids.iter().map(|g| g.columns * g.rows).sum();
        Self {
            grids,
            values: vec![0.0; num_nodes],
            spacing_px,
        }
    }

    /// Change of the log depth at a pixel of a view.
    #[inline]
    pub fn at(&self, view: usize, x: usize, y: usize) -> f64 {
        let nodes = self.grids[view].nodes(x as f64, y as f64, self.spacing_px);
        nodes
            .iter()
            .map(|(node, weight)| self.values[*node] * weight)
            .sum()
    }

    /// A depth of a view as it is corrected; 0 stays.
    #[inline]
    pub fn corrected(&self, view: usize, x: usize, y: usize, depth: f32) -> f32 {
        if depth > 0.0 {
            (f64::from(depth) * self.at(view, x, y).exp()) as f32
        } else {
            depth
        }
    }
}

fn grids_of(views: &[View], spacing_px: f64) -> Vec<Grid> {
    let mut start = 0;
    views
        .iter()
        .map(|view| {
            let nodes = |pixels: usize| ((pixels - 1) as f64 / spacing_px).ceil() as usize + 1;
            let grid = Grid {
                start,
                columns: nodes(view.camera.width).max(2),
                rows: nodes(view.camera.height).max(2),
                focal_px: view.camera.focal_px(),
            };
            start += grid.columns * grid.rows;
            grid
        })
        .collect()
}

impl Grid {
    /// The four nodes around a pixel, with their weights.
    #[inline]
    pub fn nodes(&self, x: f64, y: f64, spacing_px: f64) -> [(usize, f64); 4] {
        let (u, v) = (x / spacing_px, y / spacing_px);
        let i = (u as usize).min(self.columns - 2);
        let j = (v as usize).min(self.rows - 2);
        let (fu, fv) = (u - i as f64, v - j as f64);
        let at = |i: usize, j: usize| self.start + j * self.columns + i;
        [
            (at(i, j), (1.0 - fu) * (1.0 - fv)),
            (at(i + 1, j), fu * (1.0 - fv)),
            (at(i, j + 1), (1.0 - fu) * fv),
            (at(i + 1, j + 1), fu * fv),
        ]
    }
}
