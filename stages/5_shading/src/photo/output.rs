//! Maps on the photos' own pixels.

use super::level;
use super::plate;
use super::views::Scene;
use rayon::prelude::*;
use rilievo_numerics::plate_system::OUTSIDE;
use rilievo_scene::{DepthMap, NormalMap, ShadedView, ShadedViews};

/// Depth and normals of all views from log depths of a level; coarser ones are interpolated, and
/// leave the rim that has no parents without a value.
pub(crate) fn maps(scene: &Scene, at: usize, depths: &[Vec<f64>]) -> ShadedViews {
    let views = scene
        .frames
        .par_iter()
        .enumerate()
        .map(|(i, frame)| {
            let fine = &scene.pyramid[0].views[i];
            let mut values = depths[i].clone();
            let mut known = vec![true; values.len()];
            let mut normals = plate::normals(&scene.pyramid[at].views[i], &values);
            for finer in (0..at).rev() {
                let (child, parent) = (
                    &scene.pyramid[finer].views[i],
                    &scene.pyramid[finer + 1].views[i],
                );
                let (up, up_known) = level::upsample(parent, child, &values);
                (normals, known) = (0..child.pixels.len())
                    .map(|p| {
                        let (x, y) = (child.pixels.xs[p] / 2, child.pixels.ys[p] / 2);
                        let inside =
                            x < parent.pixels.width as u32 && y < parent.pixels.height as u32;
                        let number = if inside {
                            parent.pixels.number[y as usize * parent.pixels.width + x as usize]
                        } else {
                            OUTSIDE
                        };
                        if number == OUTSIDE || !known[number as usize] || !up_known[p] {
                            ([0.0; 3], false)
                        } else {
                            (normals[number as usize], true)
                        }
                    })
                    .unzip();
                values = up;
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
            if !frame.rectification.is_identity() {
                (depth, normal) = frame.rectification.bend_back(&frame.mask, &depth, &normal);
            }
            ShadedView {
                view: frame.view,
                name: frame.name.clone(),
                depth,
                normal,
                confidence: None,
                rendered: None,
                albedo: None,
            }
        })
        .collect();
    ShadedViews { views }
}
