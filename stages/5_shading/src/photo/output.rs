//! Maps on the photos' own pixels.

use super::appearance::Appearance;
use super::views::Scene;
use rayon::prelude::*;
use rilievo_scene::{
    ConfidenceMap, DepthMap, LinearImage, NormalMap, Raster, ShadedView, ShadedViews,
};
use rilievo_stereo::between_levels;
use rilievo_stereo::level::LevelView;
use rilievo_stereo::{plate, spread};
use serde::{Deserialize, Serialize};

/// The surface of all views at one level.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Shape {
    pub at: usize,
    /// Log depths.
    pub depths: Vec<Vec<f64>>,
    /// Whether a pixel's depth is known: what no coarser level reaches is not.
    pub known: Vec<Vec<bool>>,
}

impl Shape {
    /// A surface that is known everywhere.
    pub fn new(at: usize, depths: Vec<Vec<f64>>) -> Self {
        let known = depths.iter().map(|depth| vec![true; depth.len()]).collect();
        Self { at, depths, known }
    }
}

/// The surface that was found, whose maps on the photos' own pixels are made view by view when they are asked for: those
/// of all views together are the largest thing of a run.
#[derive(Debug)]
pub struct ShapedViews {
    scene: Scene,
    shape: Shape,
    /// Level of the appearances.
    at: usize,
    /// Per view; none where nothing but the surface is asked for.
    appearances: Vec<Appearance>,
}

impl ShapedViews {
    pub(crate) fn new(
        scene: Scene,
        shape: Shape,
        (at, appearances): (usize, Vec<Appearance>),
    ) -> Self {
        Self {
            scene,
            shape,
            at,
            appearances,
        }
    }

    /// Number of views.
    pub fn num_views(&self) -> usize {
        self.scene.frames.len()
    }

    /// All maps of a view.
    pub fn view(&self, index: usize) -> ShadedView {
        let appearance = self.appearances.get(index).map(|a| (self.at, a));
        maps(&self.scene, &self.shape, index, appearance)
    }

    /// All maps of all views.
    pub fn views(&self) -> ShadedViews {
        let views = (0..self.num_views())
            .into_par_iter()
            .map(|i| self.view(i))
            .collect();
        ShadedViews { views }
    }
}

/// Maps of a view from its surface, and from an appearance at a level of its own where there is one; coarser levels are
/// interpolated, and the rim that has no parents continues its neighbours.
pub(crate) fn maps(
    scene: &Scene,
    shape: &Shape,
    i: usize,
    appearance: Option<(usize, &Appearance)>,
) -> ShadedView {
    let frame = &scene.frames[i];
    let fine = &scene.pyramid[0].views[i];
    let (mut values, mut known) = (shape.depths[i].clone(), shape.known[i].clone());
    let mut normals = plate::normals(&scene.pyramid[shape.at].views[i], &values);
    for finer in (0..shape.at).rev() {
        let (child, parent) = (
            &scene.pyramid[finer].views[i],
            &scene.pyramid[finer + 1].views[i],
        );
        normals = spread_normals(parent, child, &normals);
        (values, known) = between_levels::continued(parent, child, (&values, &known));
    }
    let (width, height) = (frame.mask.width, frame.mask.height);
    let mut depth = DepthMap::filled(width, height, 0.0);
    let mut normal = NormalMap::filled(width, height, [0.0; 3]);
    for (p, n) in normals.iter().enumerate() {
        if !known[p] {
            continue;
        }
        let x = fine.pixels.xs[p] as usize + frame.corner.0;
        let y = fine.pixels.ys[p] as usize + frame.corner.1;
        *depth.at_mut(x, y) = values[p].exp() as f32;
        *normal.at_mut(x, y) = n.map(|v| v as f32);
    }
    drop((values, known, normals));
    let images = appearance.map(|(at, appearance)| images(scene, at, i, appearance, &depth));
    if !frame.rectification.is_identity() {
        (depth, normal) = frame.rectification.bend_back(&frame.mask, &depth, &normal);
    }
    let (confidence, [rendered, albedo]) =
        images.map_or((None, [None, None]), |(c, i)| (Some(c), i));
    ShadedView {
        view: frame.view,
        name: frame.name.clone(),
        depth,
        normal,
        confidence,
        rendered,
        albedo,
    }
}

/// Confidence, and where there are any the rendered image and the albedo, on the photo's own pixels.
fn images(
    scene: &Scene,
    at: usize,
    index: usize,
    appearance: &Appearance,
    depth: &DepthMap,
) -> (ConfidenceMap, [Option<LinearImage>; 2]) {
    let has_image = !appearance.rendered.is_empty();
    let mut values: Vec<[f32; 7]> = appearance
        .confidence
        .iter()
        .enumerate()
        .map(|(p, &c)| {
            let mut row = [0.0; 7];
            row[0] = c;
            if has_image {
                row[1..4].copy_from_slice(&appearance.rendered[p]);
                row[4..7].copy_from_slice(&appearance.albedo[p]);
            }
            row
        })
        .collect();
    for finer in (0..at).rev() {
        let (child, parent) = (
            &scene.pyramid[finer].views[index],
            &scene.pyramid[finer + 1].views[index],
        );
        values = spread::spread(parent, child, &values);
    }
    let frame = &scene.frames[index];
    let pixels = &scene.pyramid[0].views[index].pixels;
    let mut raster = Raster::filled(depth.width, depth.height, [0.0_f32; 7]);
    for (p, value) in values.iter().enumerate() {
        let x = pixels.xs[p] as usize + frame.corner.0;
        let y = pixels.ys[p] as usize + frame.corner.1;
        if *depth.at(x, y) > 0.0 {
            *raster.at_mut(x, y) = *value;
        }
    }
    if !frame.rectification.is_identity() {
        raster = frame
            .rectification
            .bend_values_back(&frame.mask, depth, &raster);
    }
    let confidence = Raster {
        width: raster.width,
        height: raster.height,
        data: raster.data.iter().map(|v| v[0].clamp(0.0, 1.0)).collect(),
    };
    let images = [(1, frame.gain), (4, [1.0; 3])]
        .map(|(first, gain)| has_image.then(|| image(&raster, first, gain)));
    (confidence, images)
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
fn spread_normals(coarse: &LevelView, fine: &LevelView, normals: &[[f64; 3]]) -> Vec<[f64; 3]> {
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
