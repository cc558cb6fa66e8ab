//! The other views that see a point of a view's surface, and the choice of those that are asked.

use crate::camera::Landing;
use crate::level::{Level, LevelView};
use nalgebra::Point3;
use rilievo_scene::{MIN_TRIANGULATION_ANGLE_DEG, Raster};

/// Another view that has a surface where a point lands.
#[derive(Clone, Copy, Debug)]
pub struct Sighting<'a> {
    /// The view's place among the sources.
    pub source: usize,
    /// The view.
    pub view: &'a LevelView,
    /// Where the point lands in it.
    pub at: Landing,
    /// How much farther than the view's own surface the point lies, log depth.
    pub behind: f64,
}

impl Sighting<'_> {
    /// Whether the point is on the view's surface, up to a difference of log depth: no nearer
    /// surface hides it.
    #[inline]
    pub fn is_within(&self, tolerance: f64) -> bool {
        self.behind.abs() <= tolerance
    }

    /// Whether the photo is unclipped there: its intensities may be compared.
    #[inline]
    pub fn is_unclipped(&self) -> bool {
        self.view.is_unclipped_at(self.at.u, self.at.v)
    }
}

impl Level {
    /// Where source `k` of view `index` sees a pixel at log depth `zeta`, if it is before that
    /// camera.
    #[inline]
    pub fn landing(&self, index: usize, k: usize, pixel: usize, zeta: f64) -> Option<Landing> {
        let (x, y) = self.views[index].xy(pixel);
        self.sources[index][k].1.land(x, y, zeta)
    }

    /// What source `k` of view `index` has where a pixel at log depth `zeta` lands; `rasters` are
    /// the log depths of all views ([`depth_rasters`](crate::level::depth_rasters)).
    #[inline]
    pub fn sighting(
        &self,
        rasters: &[Raster<f32>],
        index: usize,
        k: usize,
        (pixel, zeta): (usize, f64),
    ) -> Option<Sighting<'_>> {
        let j = self.sources[index][k].0;
        let (at, view) = (self.landing(index, k, pixel, zeta)?, &self.views[j]);
        let behind = at.zeta - view.depth_at(&rasters[j], at.u, at.v)?;
        Some(Sighting {
            source: k,
            view,
            at,
            behind,
        })
    }

    /// [`Self::sighting`] in every source that has a surface there.
    #[inline]
    pub fn sightings<'a>(
        &'a self,
        rasters: &'a [Raster<f32>],
        index: usize,
        point: (usize, f64),
    ) -> impl Iterator<Item = Sighting<'a>> {
        (0..self.sources[index].len()).filter_map(move |k| self.sighting(rasters, index, k, point))
    }
}

/// Most views that one is compared with: which of them agree is kept in the bits of a byte.
pub const MAX_SOURCES: usize = 8;

/// For every view the others whose line of sight to a point `target` in the world differs by about
/// 20°, best first.
///
/// A narrow angle measures depth badly, a wide one sees another side; one below [`MIN_TRIANGULATION_ANGLE_DEG`], of
/// copies, measures none, and is taken only where there is no other. At most [`MAX_SOURCES`] are chosen.
pub fn choose_sources(
    views: &[LevelView],
    target: &Point3<f64>,
    max_num_sources: usize,
) -> Vec<Vec<usize>> {
    let directions: Vec<_> = views
        .iter()
        .map(|v| (v.camera.center - target).normalize())
        .collect();
    let degrees = |i: usize, j: usize| {
        let angle = directions[i].dot(&directions[j]).clamp(-1.0, 1.0).acos();
        angle.to_degrees()
    };
    let is_apart = |i: usize, j: usize| degrees(i, j) >= MIN_TRIANGULATION_ANGLE_DEG;
    let misfit = |i: usize, j: usize| {
        let degrees = degrees(i, j);
        if degrees < 20.0 {
            (20.0 - degrees) / 10.0
        } else {
            (degrees - 20.0) / 25.0
        }
    };
    (0..views.len())
        .map(|i| {
            let others = (0..views.len()).filter(|&j| j != i);
            let mut ranked: Vec<(f64, usize)> = others.map(|j| (misfit(i, j), j)).collect();
            ranked.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            if ranked.iter().any(|&(_, j)| is_apart(i, j)) {
                ranked.retain(|&(_, j)| is_apart(i, j));
            }
            let chosen = ranked.into_iter().take(max_num_sources.min(MAX_SOURCES));
            chosen.map(|(_, j)| j).collect()
        })
        .collect()
}
