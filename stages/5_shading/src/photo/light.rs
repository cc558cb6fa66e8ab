//! The light of a lap: nine coefficients per pixel of every view, fitted on the current shape.
//!
//! With visibility: rays from the pixels of the next coarser level against the solid that the depth
//! maps carve, the sphere and the ground; the environment fitted on object and sphere pixels together;
//! coefficients interpolated to the level. Without: nine distant harmonics, fitted robustly on the
//! current normals of all views (light fixed in the world) or of each (fixed to the camera).

use super::level::{Level, LevelView};
use super::plate;
use super::shading::{self, PixelHarmonics};
use super::surround::{SmallPhoto, look_at_sphere};
use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use rayon::prelude::*;
use rilievo_numerics::plate_system::OUTSIDE;
use rilievo_numerics::robust::median;
use rilievo_photometry::harmonics::{FitOptions, fit_robust, rotate, rotate_harmonics};
use rilievo_photometry::visibility::{
    DepthView, EnvironmentSample, Ground, Surroundings, Volume, WarmSphere, directions,
    fit_environment, transfer,
};
use rilievo_scene::{
    Intrinsics, LightKind, Lighting, LocatedSphere, Raster, RigidTransform, SphericalHarmonics,
};

/// The light of all views at one level.
#[derive(Clone, Debug)]
pub(crate) struct Light {
    /// Per view and masked pixel, camera frame.
    pub harmonics: Vec<Vec<PixelHarmonics>>,
    /// Median relative residual per view, at the shape that it was fitted on.
    pub residuals: Vec<f64>,
}

impl Light {
    /// Median over the views.
    pub fn residual(&self) -> f64 {
        median(&mut self.residuals.clone()).unwrap_or(f64::NAN)
    }
}

/// What the light is fitted with, apart from the shape.
pub(crate) struct LightScene<'a> {
    pub photos: &'a [SmallPhoto],
    pub sphere: Option<&'a LocatedSphere>,
    pub ground: Option<&'a Ground>,
    pub num_rays: usize,
}

/// Voxels along the object's longest side.
const MAX_VOXELS: usize = 224;
/// Object pixels of a view on which the environment is fitted.
const FIT_PIXELS: usize = 3000;
/// Smoothness of the environment, relative.
const SMOOTHNESS: f64 = 1e-3;
/// Influence of all sphere points against all object pixels of one view.
const SPHERE_SHARE: f32 = 5.0;

fn rotation(view: &LevelView) -> UnitQuaternion<f64> {
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(view.camera.rotation))
}

/// Nine distant harmonics on the current shape.
pub(crate) fn distant(level: &Level, depths: &[Vec<f64>], kind: LightKind) -> Option<Light> {
    let normals: Vec<Vec<[f64; 3]>> = level
        .views
        .par_iter()
        .zip(depths)
        .map(|(view, depth)| plate::normals(view, depth))
        .collect();
    let groups: Vec<Vec<usize>> = match kind {
        LightKind::World => vec![(0..level.views.len()).collect()],
        LightKind::Camera => (0..level.views.len()).map(|i| vec![i]).collect(),
    };
    let mut harmonics = vec![Vec::new(); level.views.len()];
    for group in groups {
        let (mut n, mut weights) = (Vec::new(), Vec::new());
        let mut values: [Vec<f64>; 3] = Default::default();
        for &i in &group {
            let view = &level.views[i];
            let step = (view.pixels.len() / FIT_PIXELS).max(1);
            for p in (0..view.pixels.len()).step_by(step) {
                if !view.is_usable(p) {
                    continue;
                }
                let rgb = view.intensity(p).map(f64::from);
                let m = normals[i][p];
                n.push(view.camera.rotation.tr_mul(&Vector3::new(m[0], m[1], m[2])));
                let mean = ((rgb[0] + rgb[1] + rgb[2]) / 3.0).max(1e-4);
                weights.push(1.0 / (mean * mean));
                for c in 0..3 {
                    values[c].push(rgb[c]);
                }
            }
        }
        let channels: Option<Vec<SphericalHarmonics>> = values
            .iter()
            .map(|v| {
                fit_robust(&n, v, Some(&weights), &FitOptions::default())
                    .ok()
                    .map(|fit| fit.coefficients)
            })
            .collect();
        let world = Lighting {
            channels: channels?,
        };
        for &i in &group {
            let own = rotate(&world, &rotation(&level.views[i]));
            let pixel = [0, 1, 2].map(|c| own.channels[c].0.map(|v| v as f32));
            harmonics[i] = vec![pixel; level.views[i].pixels.len()];
        }
    }
    Some(with_residuals(level, &normals, harmonics))
}

fn with_residuals(
    level: &Level,
    normals: &[Vec<[f64; 3]>],
    harmonics: Vec<Vec<PixelHarmonics>>,
) -> Light {
    let residuals = level
        .views
        .par_iter()
        .enumerate()
        .map(|(i, view)| {
            let mut r: Vec<f64> = (0..view.pixels.len())
                .step_by(3)
                .filter(|&p| view.is_usable(p))
                .map(|p| relative(&harmonics[i][p], normals[i][p], view.intensity(p)))
                .collect();
            median(&mut r).unwrap_or(f64::NAN)
        })
        .collect();
    Light {
        harmonics,
        residuals,
    }
}

fn relative(light: &PixelHarmonics, normal: [f64; 3], rgb: [f32; 3]) -> f64 {
    let s = shading::render(light, normal);
    let mean = (rgb.iter().sum::<f32>() / 3.0).max(1e-5);
    let sum: f64 = (0..3)
        .map(|c| ((s[c] - f64::from(rgb[c])) / f64::from(mean)).powi(2))
        .sum();
    (sum / 3.0).sqrt()
}

/// Per-pixel light with visibility at `level`, rays cast from the pixels of `rays_at`, the next coarser
/// level (or the same).
pub(crate) fn visible(
    level: &Level,
    depths: &[Vec<f64>],
    rays_at: &Level,
    scene: &LightScene,
) -> Option<Light> {
    let coarse: Vec<Vec<f64>> = (0..level.views.len())
        .into_par_iter()
        .map(|i| reduce(&level.views[i], &rays_at.views[i], &depths[i]))
        .collect();
    let coarse_normals: Vec<Vec<[f64; 3]>> = rays_at
        .views
        .par_iter()
        .zip(&coarse)
        .map(|(view, depth)| plate::normals(view, depth))
        .collect();
    let volume = Volume::carve(&depth_views(level, depths), MAX_VOXELS)?;
    let offset = 1.25 * volume.voxel;
    let sphere = scene.sphere.and_then(|s| look_at_sphere(s, scene.photos));
    let surroundings = Surroundings {
        volume,
        sphere: sphere
            .as_ref()
            .map(|(_, warm): &(_, WarmSphere)| warm.clone()),
        ground: scene.ground.cloned(),
    };
    let rays = directions(scene.num_rays);
    let transfers: Vec<Vec<_>> = (0..rays_at.views.len())
        .map(|i| {
            let view = &rays_at.views[i];
            (0..view.pixels.len())
                .into_par_iter()
                .with_min_len(128)
                .map(|p| {
                    let (x, y) = view.xy(p);
                    let at = view.camera.unproject(x, y, coarse[i][p].exp()).coords;
                    let n = coarse_normals[i][p];
                    let n = view.camera.rotation.tr_mul(&Vector3::new(n[0], n[1], n[2]));
                    transfer(
                        &surroundings,
                        &at.map(|v| v as f32),
                        &n.map(|v| v as f32),
                        &rays,
                        offset,
                        false,
                    )
                })
                .collect()
        })
        .collect();
    let mut samples = Vec::new();
    for (i, view) in rays_at.views.iter().enumerate() {
        let step = (view.pixels.len() / FIT_PIXELS).max(1);
        for p in (0..view.pixels.len()).step_by(step) {
            let intensity = view.intensity(p);
            if !view.is_usable(p) || intensity.iter().sum::<f32>() < 1e-4 {
                continue;
            }
            let t: &rilievo_photometry::visibility::Transfer = &transfers[i][p];
            samples.push(EnvironmentSample {
                row: t.row(&rays),
                nearby: t.nearby_intensity(),
                intensity,
                weight: 1.0,
            });
        }
    }
    if let Some((points, warm)) = &sphere {
        let weight = SPHERE_SHARE * FIT_PIXELS as f32 / points.len().max(1) as f32;
        let extra: Vec<EnvironmentSample> = points
            .par_iter()
            .map(|p| {
                let at = warm.center.coords + p.normal * warm.radius;
                let t = transfer(
                    &surroundings,
                    &at,
                    &p.normal,
                    &rays,
                    0.02 * warm.radius,
                    true,
                );
                EnvironmentSample {
                    row: t.row(&rays),
                    nearby: t.nearby_intensity(),
                    intensity: p.radiance,
                    weight,
                }
            })
            .filter(|s| s.intensity.iter().sum::<f32>() > 1e-4)
            .collect();
        samples.extend(extra);
    }
    let fit = fit_environment(&samples, &rays, SMOOTHNESS)?;
    let normals: Vec<Vec<[f64; 3]>> = level
        .views
        .par_iter()
        .zip(depths)
        .map(|(view, depth)| plate::normals(view, depth))
        .collect();
    let harmonics = (0..level.views.len())
        .map(|i| {
            let turn = rotation(&level.views[i]);
            let own: Vec<PixelHarmonics> = transfers[i]
                .par_iter()
                .with_min_len(256)
                .map(|t| {
                    t.harmonics(&rays, &fit.radiance, fit.bounce).map(|l| {
                        let world = SphericalHarmonics(l.map(f64::from));
                        rotate_harmonics(&world, &turn).0.map(|v| v as f32)
                    })
                })
                .collect();
            spread(&rays_at.views[i], &level.views[i], &own)
        })
        .collect();
    Some(with_residuals(level, &normals, harmonics))
}

fn depth_views(level: &Level, depths: &[Vec<f64>]) -> Vec<DepthView> {
    let weights = super::consensus::incidence_weights(level, depths);
    level
        .views
        .iter()
        .zip(depths)
        .zip(weights)
        .map(|((view, depth), weight)| {
            let camera = &view.camera;
            let metric: Vec<f64> = depth.iter().map(|z| z.exp()).collect();
            let mut intrinsics =
                Intrinsics::pinhole(camera.width, camera.height, camera.fx, camera.cx, camera.cy);
            intrinsics.fy = camera.fy;
            DepthView {
                intrinsics,
                cam_from_world: RigidTransform {
                    rotation: rotation(view),
                    translation: camera.translation,
                },
                depth: view.spread(&metric, 0.0),
                weight,
                image: view.image.clone(),
                cut_by_frame: view.cut_by_frame,
            }
        })
        .collect()
}

/// Log depth at the coarser level: mean of the four children (all are masked).
fn reduce(fine: &LevelView, coarse: &LevelView, depth: &[f64]) -> Vec<f64> {
    if fine.mask.width == coarse.mask.width {
        return depth.to_vec();
    }
    (0..coarse.pixels.len())
        .map(|p| {
            let (x, y) = (
                2 * coarse.pixels.xs[p] as usize,
                2 * coarse.pixels.ys[p] as usize,
            );
            let sum: f64 = [(0, 0), (1, 0), (0, 1), (1, 1)]
                .iter()
                .map(|&(dx, dy)| {
                    let number = fine.pixels.number[(y + dy) * fine.pixels.width + x + dx];
                    depth[number as usize]
                })
                .sum();
            0.25 * sum
        })
        .collect()
}

/// Interpolates per-pixel coefficients to a finer level: bilinear over the masked parents, the
/// nearest one where there is none.
pub(crate) fn spread(
    coarse: &LevelView,
    fine: &LevelView,
    values: &[PixelHarmonics],
) -> Vec<PixelHarmonics> {
    if fine.mask.width == coarse.mask.width {
        return values.to_vec();
    }
    let nearest = nearest_pixels(coarse);
    (0..fine.pixels.len())
        .into_par_iter()
        .with_min_len(512)
        .map(|i| {
            let (x, y) = fine.xy(i);
            let (x, y) = (0.5 * (x + 0.5) - 0.5, 0.5 * (y + 0.5) - 0.5);
            let (x0, y0) = (x.floor(), y.floor());
            let (mut out, mut total) = ([[0.0_f32; 9]; 3], 0.0_f32);
            for (dx, dy) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
                let weight = ((1.0 - (x - x0 - dx).abs()) * (1.0 - (y - y0 - dy).abs())) as f32;
                let (px, py) = (x0 + dx, y0 + dy);
                if weight <= 0.0 || px < 0.0 || py < 0.0 {
                    continue;
                }
                let (px, py) = (px as usize, py as usize);
                if px >= coarse.pixels.width || py >= coarse.pixels.height {
                    continue;
                }
                let number = coarse.pixels.number[py * coarse.pixels.width + px];
                if number == OUTSIDE {
                    continue;
                }
                for (o, v) in out.iter_mut().zip(&values[number as usize]) {
                    for (a, b) in o.iter_mut().zip(v) {
                        *a += weight * b;
                    }
                }
                total += weight;
            }
            if total > 0.0 {
                out.map(|l| l.map(|v| v / total))
            } else {
                let px = (x.round().max(0.0) as usize).min(coarse.pixels.width - 1);
                let py = (y.round().max(0.0) as usize).min(coarse.pixels.height - 1);
                values[*nearest.at(px, py) as usize]
            }
        })
        .collect()
}

/// Number of the nearest masked pixel of every raster position (two chamfer sweeps).
fn nearest_pixels(view: &LevelView) -> Raster<u32> {
    let (w, h) = (view.pixels.width as i64, view.pixels.height as i64);
    let mut number = view.pixels.number.clone();
    let mut distance: Vec<i64> = number
        .iter()
        .map(|&n| if n == OUTSIDE { i64::MAX / 4 } else { 0 })
        .collect();
    let mut sweep = |forward: bool| {
        let offsets: [(i64, i64, i64); 4] = [(-1, 0, 2), (0, -1, 2), (-1, -1, 3), (1, -1, 3)];
        for k in 0..w * h {
            let k = if forward { k } else { w * h - 1 - k };
            let (x, y) = (k % w, k / w);
            for (dx, dy, cost) in offsets {
                let (dx, dy) = if forward { (dx, dy) } else { (-dx, -dy) };
                let (ax, ay) = (x + dx, y + dy);
                if ax < 0 || ay < 0 || ax >= w || ay >= h {
                    continue;
                }
                let a = (ay * w + ax) as usize;
                if distance[a] + cost < distance[k as usize] {
                    distance[k as usize] = distance[a] + cost;
                    number[k as usize] = number[a];
                }
            }
        }
    };
    sweep(true);
    sweep(false);
    for n in &mut number {
        if *n == OUTSIDE {
            *n = 0;
        }
    }
    Raster {
        width: view.pixels.width,
        height: view.pixels.height,
        data: number,
    }
}
