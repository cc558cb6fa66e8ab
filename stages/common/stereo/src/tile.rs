//! Parts of a level: a window of one view with what its sources see of it, as a small level of its own.
//!
//! What is local at a fine level (the photos' agreement, shading, nearness, a plate among measured depths) is worked
//! on tile by tile: the memory is a tile's, whatever the photo's size. Tiles overlap, and their results are blended:
//! a pixel's shares in all tiles that hold it sum to one, and fall to zero before a tile's border, where half of a
//! pixel's surroundings are missing.

use crate::camera::Warp;
use crate::level::{Level, ViewGrid};
use crate::stored::StoredLevel;
use crate::window::Window;
use rilievo_scene::ScratchError;

/// Pixels that a tile reaches beyond its core: what gain fields and the shading's correction average over.
pub const MARGIN_PX: usize = 32;
/// Outermost pixels of a tile, which take no share: plates and slopes end there.
const GUARD_PX: usize = 8;
/// Pixels kept around what a source sees of a tile: the tile's surface moves, and interpolation reaches out.
const SOURCE_MARGIN_PX: f64 = 24.0;
/// Pixels of a tile are landed in a source by such steps along rows and columns.
const LANDING_STEP: u32 = 4;

/// A part of a level.
#[derive(Debug)]
pub struct Tile {
    /// The tile's view, and behind it what its sources see; only the first has sources.
    pub level: Level,
    /// Log depths of these views.
    pub depths: Vec<Vec<f64>>,
    /// Places of the tile's pixels in the whole view's raster, row times width plus column.
    pub places: Vec<u32>,
    /// Share of each of them in the blend.
    pub shares: Vec<f32>,
    /// Column and row of the tile's corner in the whole view.
    pub corner: (usize, usize),
}

/// Cores of about equal size, sides at most `size` pixels, that cover a view's masked pixels, row by row.
pub fn cores(view: &ViewGrid, size: usize) -> Vec<Window> {
    let (width, height) = (view.mask.width, view.mask.height);
    // A small rest at the end would lie within its neighbour's margin.
    let cuts = |length: usize| -> Vec<usize> {
        let count = length.div_ceil(size.max(2 * MARGIN_PX)).max(1);
        (0..=count).map(|k| k * length / count).collect()
    };
    let (columns, rows) = (cuts(width), cuts(height));
    let mut cores = Vec::new();
    for y in rows.windows(2) {
        for x in columns.windows(2) {
            let core = Window {
                x0: x[0],
                y0: y[0],
                width: x[1] - x[0],
                height: y[1] - y[0],
            };
            if is_masked(view, &core) {
                cores.push(core);
            }
        }
    }
    cores
}

/// Whether any pixel of a window is of the object.
fn is_masked(view: &ViewGrid, window: &Window) -> bool {
    (window.y0..window.y0 + window.height).any(|y| {
        let row = y * view.mask.width + window.x0;
        view.mask.data[row..row + window.width].contains(&true)
    })
}

impl Tile {
    /// The part of view `index` around `core`, at the level's surface.
    ///
    /// # Errors
    /// When a view or a surface cannot be read.
    pub fn cut(level: &StoredLevel, index: usize, core: &Window) -> Result<Self, ScratchError> {
        let size = level.views[index].size(level.at);
        let window = widened(core, size);
        let view = level.cut(index, &window)?;
        let depth = level.surface.cut(index, &window, &view.pixels)?;
        let (xs, ys) = (&view.pixels.xs, &view.pixels.ys);
        let places = xs.iter().zip(ys);
        let places = places
            .map(|(&x, &y)| (y + window.y0 as u32) * size.0 as u32 + x + window.x0 as u32)
            .collect();
        let shares = (0..view.pixels.len())
            .map(|p| {
                let x = share(
                    xs[p] as usize,
                    window.width,
                    [window.x0 > 0, window.x0 + window.width < size.0],
                );
                let y = share(
                    ys[p] as usize,
                    window.height,
                    [window.y0 > 0, window.y0 + window.height < size.1],
                );
                x * y
            })
            .collect();
        let (mut views, mut depths, mut sources) = (vec![view], vec![depth], Vec::new());
        for &j in &level.sources[index] {
            let Some(warp) = Warp::between(&views[0].camera, level.views[j].camera(level.at))
            else {
                continue;
            };
            let size = level.views[j].size(level.at);
            let Some(seen) = landing(&views[0], &depths[0], &warp, size) else {
                continue;
            };
            let source = level.cut(j, &seen)?;
            if source.pixels.is_empty() {
                continue;
            }
            sources.push(views.len());
            depths.push(level.surface.cut(j, &seen, &source.pixels)?);
            views.push(source);
        }
        let mut lists = vec![sources];
        lists.resize(views.len(), Vec::new());
        Ok(Self {
            level: Level::new(views, &lists),
            depths,
            places,
            shares,
            corner: (window.x0, window.y0),
        })
    }

    /// Whether a pixel of the tile lies in `core`, which the tile was cut around.
    pub fn is_in(&self, core: &Window, pixel: usize) -> bool {
        let pixels = &self.level.views[0].pixels;
        let x = pixels.xs[pixel] as usize + self.corner.0;
        let y = pixels.ys[pixel] as usize + self.corner.1;
        (core.x0..core.x0 + core.width).contains(&x)
            && (core.y0..core.y0 + core.height).contains(&y)
    }
}

/// A core with its margin, as far as the view reaches.
fn widened(core: &Window, (width, height): (usize, usize)) -> Window {
    let (x0, y0) = (
        core.x0.saturating_sub(MARGIN_PX),
        core.y0.saturating_sub(MARGIN_PX),
    );
    Window {
        x0,
        y0,
        width: (core.x0 + core.width + MARGIN_PX).min(width) - x0,
        height: (core.y0 + core.height + MARGIN_PX).min(height) - y0,
    }
}

/// The share of place `at` of `count` along one axis; `goes_on`: other tiles lie before and behind.
fn share(at: usize, count: usize, goes_on: [bool; 2]) -> f32 {
    let ramp = (2 * (MARGIN_PX - GUARD_PX)) as f32;
    // Centres of pixels: a core's border lies between two of them, where both tiles have one half.
    let inner =
        |distance: usize| ((distance as f32 + 0.5 - GUARD_PX as f32) / ramp).clamp(0.0, 1.0);
    let before = if goes_on[0] { inner(at) } else { 1.0 };
    let behind = if goes_on[1] {
        inner(count - 1 - at)
    } else {
        1.0
    };
    before * behind
}

/// The window of another view, of `size`, in which a tile's surface is seen; `None` where none of it is.
fn landing(view: &ViewGrid, depth: &[f64], warp: &Warp, size: (usize, usize)) -> Option<Window> {
    let (width, height) = (size.0 as f64, size.1 as f64);
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for (p, &zeta) in depth.iter().enumerate() {
        if !view.pixels.xs[p].is_multiple_of(LANDING_STEP)
            || !view.pixels.ys[p].is_multiple_of(LANDING_STEP)
        {
            continue;
        }
        let (x, y) = view.xy(p);
        let Some(landed) = warp.land(x, y, zeta) else {
            continue;
        };
        let at = [landed.u, landed.v];
        if at[0] < 0.0 || at[1] < 0.0 || at[0] >= width || at[1] >= height {
            continue;
        }
        for k in 0..2 {
            low[k] = low[k].min(at[k]);
            high[k] = high[k].max(at[k]);
        }
    }
    if low[0] > high[0] {
        return None;
    }
    let first = low.map(|v| (v - SOURCE_MARGIN_PX).max(0.0) as usize);
    let last = [
        (high[0] + SOURCE_MARGIN_PX).min(width - 1.0) as usize,
        (high[1] + SOURCE_MARGIN_PX).min(height - 1.0) as usize,
    ];
    Some(Window {
        x0: first[0],
        y0: first[1],
        width: last[0] + 1 - first[0],
        height: last[1] + 1 - first[1],
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::level::{LevelView, flat_view};
    use crate::stored::{StoredSurface, StoredView};
    use rilievo_scene::MemoryScratch;

    /// Two views of one camera and their surfaces, handed to `look` out of core.
    fn with_level(
        look: impl FnOnce(&StoredLevel, &LevelView, &[f64]) -> Result<(), ScratchError>,
    ) -> Result<(), ScratchError> {
        let view = flat_view(300, 170, 400.0);
        let depth: Vec<f64> = (0..view.pixels.len())
            .map(|p| 1e-3 * (0.1 * view.xy(p).0).sin())
            .collect();
        let stored = || StoredView::put(view.clone(), 500, &MemoryScratch);
        let views = [stored()?, stored()?];
        let surface = StoredSurface::new(&views, 0, &MemoryScratch)?;
        for i in 0..2 {
            surface.put(i, &view.pixels, &depth, None)?;
        }
        let level = StoredLevel {
            views: &views,
            at: 0,
            sources: &[vec![1], vec![0]],
            sharpness: &[1.0; 2],
            surface: &surface,
        };
        look(&level, &view, &depth)
    }

    /// Whatever the cores' size, every pixel's shares sum to one, and a pixel of a tile is the same pixel of the view.
    #[test]
    fn shares_sum_to_one_and_pixels_keep_their_place() -> Result<(), ScratchError> {
        with_level(|level, whole, depth| {
            for size in [64, 100, 290, 512] {
                let mut sums = vec![0.0_f64; whole.pixels.len()];
                let mut owners = vec![0; whole.pixels.len()];
                for core in cores(whole, size) {
                    let tile = Tile::cut(level, 0, &core)?;
                    let view = &tile.level.views[0];
                    for (p, &place) in tile.places.iter().enumerate() {
                        let number = whole.pixels.number[place as usize] as usize;
                        sums[number] += f64::from(tile.shares[p]);
                        owners[number] += usize::from(tile.is_in(&core, p));
                        let (x, y) = view.xy(p);
                        let (wx, wy) = whole.xy(number);
                        assert_eq!(
                            (x + tile.corner.0 as f64, y + tile.corner.1 as f64),
                            (wx, wy)
                        );
                        assert_eq!(tile.depths[0][p], depth[number]);
                        let [ray, same] = [view.camera.ray(x, y), whole.camera.ray(wx, wy)];
                        assert!((ray - same).norm() < 1e-12, "{ray} {same}");
                    }
                }
                let worst = sums.iter().fold(0.0_f64, |m, s| m.max((s - 1.0).abs()));
                assert!(worst < 1e-5, "size {size}: {worst}");
                assert!(owners.iter().all(|&count| count == 1), "size {size}");
            }
            Ok(())
        })
    }

    /// A tile's source holds what the tile sees of it: a point lands in the part where it lands in the whole.
    #[test]
    fn a_point_lands_in_the_part_where_it_lands_in_the_whole() -> Result<(), ScratchError> {
        with_level(|level, whole, _| {
            let core = Window {
                x0: 128,
                y0: 64,
                width: 64,
                height: 64,
            };
            let tile = Tile::cut(level, 0, &core)?;
            let (k, warp) = &tile.level.sources[0][0];
            let source = &tile.level.views[*k];
            assert!(source.pixels.len() < whole.pixels.len());
            for p in 0..tile.places.len() {
                let (x, y) = tile.level.views[0].xy(p);
                let Some(landed) = warp.land(x, y, tile.depths[0][p]) else {
                    panic!("pixel {p} does not land")
                };
                // Both views are the same camera: a pixel lands on itself.
                let number = whole.pixels.number[tile.places[p] as usize];
                let (wx, wy) = whole.xy(number as usize);
                let offset = (whole.camera.cx - source.camera.cx).round();
                assert!((landed.u + offset - wx).abs() < 1e-6, "{} {wx}", landed.u);
                assert!(landed.u >= 0.0 && landed.u < source.mask.width as f64);
                assert!(landed.v >= 0.0 && landed.v < source.mask.height as f64 && wy >= 0.0);
            }
            Ok(())
        })
    }
}
