//! Maps on the photos' own pixels.

use super::appearance;
use super::confidence;
use super::light::Light;
use super::shape::Surface;
use super::views::Scene;
use crate::error::ShadingError;
use rayon::prelude::*;
use rilievo_scene::{
    ConfidenceMap, DepthMap, LinearImage, NormalMap, Raster, ScratchError, ShadedView, ShadedViews,
};
use rilievo_stereo::between_levels;
use rilievo_stereo::level::{ViewGrid, depth_rasters};
use rilievo_stereo::{plate, spread};

/// The surface that was found, whose maps on the photos' own pixels are made view by view when they are asked for: those
/// of all views together are the largest thing of a run.
#[derive(Debug)]
pub struct ShapedViews {
    scene: Scene,
    surface: Box<dyn Surface>,
    /// Log depths at the finest level that was solved as a whole, at which light and pigment are known.
    depths: Vec<Vec<f64>>,
    /// The same as rasters.
    rasters: Vec<Raster<f32>>,
    light: Option<Light>,
}

impl ShapedViews {
    pub(crate) fn new(
        scene: Scene,
        surface: Box<dyn Surface>,
        depths: Vec<Vec<f64>>,
        light: Option<Light>,
    ) -> Self {
        let rasters = depth_rasters(&scene.pyramid[0], &depths);
        Self {
            scene,
            surface,
            depths,
            rasters,
            light,
        }
    }

    /// Confidence, rendered image and albedo of a view's pixels at the finest level that was solved
    /// as a whole.
    fn rows(&self, i: usize) -> Rows {
        let scene = &self.scene;
        let (level, depth) = (&scene.pyramid[0], &self.depths[i]);
        let appearance = self.light.as_ref().map_or_else(Default::default, |light| {
            let harmonics = scene.harmonics(light, i, scene.finest);
            appearance::render(level, i, depth, &self.rasters, light, &harmonics)
        });
        let confidence = confidence::estimate(level, i, depth, &self.rasters, &appearance);
        let has_image = !appearance.rendered.is_empty();
        let row = |(p, &c): (usize, &f32)| {
            let mut row = [c, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
            if has_image {
                row[1..4].copy_from_slice(&appearance.rendered[p]);
                row[4..7].copy_from_slice(&appearance.albedo[p]);
            }
            row
        };
        Rows {
            values: confidence.iter().enumerate().map(row).collect(),
            has_image,
        }
    }

    /// Number of views.
    pub fn num_views(&self) -> usize {
        self.scene.frames.len()
    }

    /// All maps of a view.
    ///
    /// # Errors
    /// [`ShadingError::Scratch`] when they cannot be read back.
    pub fn view(&self, index: usize) -> Result<ShadedView, ShadingError> {
        let rows = self.rows(index);
        Ok(maps(&self.scene, &*self.surface, index, Some(rows))?)
    }

    /// All maps of all views.
    ///
    /// # Errors
    /// As [`Self::view`].
    pub fn views(&self) -> Result<ShadedViews, ShadingError> {
        let views = (0..self.num_views())
            .into_par_iter()
            .map(|i| self.view(i))
            .collect::<Result<_, _>>()?;
        Ok(ShadedViews { views })
    }
}

/// Confidence, rendered image and albedo of a view's masked pixels at the finest level that is
/// solved as a whole.
pub(crate) struct Rows {
    values: Vec<[f32; 7]>,
    has_image: bool,
}

/// Maps of a view from its surface, and from `rows` where there are any; coarser levels are
/// interpolated, and the rim that has no parents continues its neighbours.
pub(crate) fn maps(
    scene: &Scene,
    surface: &dyn Surface,
    i: usize,
    rows: Option<Rows>,
) -> Result<ShadedView, ScratchError> {
    let (frame, stored) = (&scene.frames[i], &scene.stored[i]);
    let mut grid = stored.grid(surface.level())?;
    let (mut values, mut known) = surface.of_view(i, &grid)?;
    let mut normals = plate::normals(&grid, &values);
    for finer in (0..surface.level()).rev() {
        let child = stored.grid(finer)?;
        normals = spread_normals(&grid, &child, &normals);
        (values, known) = between_levels::continued(&grid, &child, (&values, &known));
        grid = child;
    }
    let (width, height) = frame.size;
    let mut depth = DepthMap::filled(width, height, 0.0);
    let mut normal = NormalMap::filled(width, height, [0.0; 3]);
    for (p, n) in normals.iter().enumerate() {
        if !known[p] {
            continue;
        }
        let x = grid.pixels.xs[p] as usize + frame.corner.0;
        let y = grid.pixels.ys[p] as usize + frame.corner.1;
        *depth.at_mut(x, y) = values[p].exp() as f32;
        *normal.at_mut(x, y) = n.map(|v| v as f32);
    }
    drop((values, known, normals));
    let images = rows.map(|rows| images(scene, i, rows, &grid, &depth));
    drop(grid);
    if !frame.rectification.is_identity() {
        (depth, normal) = frame
            .rectification
            .bend_back(&frame.own_mask(), &depth, &normal);
    }
    let (confidence, [rendered, albedo]) = images
        .transpose()?
        .map_or((None, [None, None]), |(c, i)| (Some(c), i));
    Ok(ShadedView {
        view: frame.view,
        name: frame.name.clone(),
        depth,
        normal,
        confidence,
        rendered,
        albedo,
    })
}

/// Confidence, and where there are any the rendered image and the albedo, on the photo's own pixels.
fn images(
    scene: &Scene,
    index: usize,
    Rows {
        mut values,
        has_image,
    }: Rows,
    finest: &ViewGrid,
    depth: &DepthMap,
) -> Result<(ConfidenceMap, [Option<LinearImage>; 2]), ScratchError> {
    let mut parent = scene.stored[index].grid(scene.finest)?;
    for finer in (0..scene.finest).rev() {
        let child = scene.stored[index].grid(finer)?;
        values = spread::spread(&parent, &child, &values);
        parent = child;
    }
    let frame = &scene.frames[index];
    let mut raster = Raster::filled(depth.width, depth.height, [0.0_f32; 7]);
    for (p, value) in values.iter().enumerate() {
        let x = finest.pixels.xs[p] as usize + frame.corner.0;
        let y = finest.pixels.ys[p] as usize + frame.corner.1;
        if *depth.at(x, y) > 0.0 {
            *raster.at_mut(x, y) = *value;
        }
    }
    drop((values, parent));
    if !frame.rectification.is_identity() {
        raster = frame
            .rectification
            .bend_values_back(&frame.own_mask(), depth, &raster);
    }
    let confidence = Raster {
        width: raster.width,
        height: raster.height,
        data: raster.data.iter().map(|v| v[0].clamp(0.0, 1.0)).collect(),
    };
    let images = [(1, frame.gain), (4, [1.0; 3])]
        .map(|(first, gain)| has_image.then(|| image(&raster, first, gain)));
    Ok((confidence, images))
}

/// Three channels from the `first` on, each times its gain.
fn image(values: &Raster<[f32; 7]>, first: usize, gain: [f64; 3]) -> LinearImage {
    LinearImage {
        width: values.width,
        height: values.height,
        channels: 3,
        data: values
            .data
            .iter()
            .flat_map(|v| [0, 1, 2].map(|c| v[first + c] * gain[c] as f32))
            .collect(),
    }
}

/// Unit normals at the next finer level.
fn spread_normals(coarse: &ViewGrid, fine: &ViewGrid, normals: &[[f64; 3]]) -> Vec<[f64; 3]> {
    let single: Vec<[f32; 3]> = normals.iter().map(|n| n.map(|v| v as f32)).collect();
    spread::spread(coarse, fine, &single)
        .iter()
        .map(|n| {
            let n = n.map(f64::from);
            let length = n.iter().map(|v| v * v).sum::<f64>().sqrt();
            n.map(|v| v / length.max(f64::MIN_POSITIVE))
        })
        .collect()
}
