//! The light of an outer iteration: nine coefficients per pixel of every view, fitted on the current shape.
//!
//! Rays from the pixels of the next coarser level against the solid that the depth
//! maps carve, the spheres and the ground; the environment fitted on object pixels and what stage 4 knows
//! of the light (`known_light`) together, still in the world or, for a light fixed to the
//! camera, still in the camera's frame, where every view casts the same rays in directions of its own;
//! coefficients interpolated to the level. Pigment, and an albedo of the sphere that differs from the
//! object's, are divided out of the samples before a second fit. `distant` does without rays.

use super::albedo::{self, Albedo};
use super::hidden_light;
use super::known_light::{KnownGroup, KnownLight};
use super::shading::{self, PixelHarmonics, PixelLight};
use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use rayon::prelude::*;
use rilievo_numerics::robust::median;
use rilievo_photometry::harmonics::{fit_robust, rotate, rotate_harmonics};
use rilievo_photometry::visibility::{
    DepthView, EmittingSphere, EnvironmentFit, EnvironmentSample, Ground, Surroundings, Transfer,
    Volume, directions, fit_environment, transfer,
};
use rilievo_scene::team::divided;
use rilievo_scene::{
    Intrinsics, LightKind, Lighting, RigidTransform, SphericalHarmonics, Team, TeamError,
};
use rilievo_stereo::between_levels;
use rilievo_stereo::level::{Level, LevelView};
use rilievo_stereo::plate;
use rilievo_stereo::spread;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// The light of all views at one level.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Light {
    /// Per view and masked pixel of the level that it was fitted at, camera frame; finer levels interpolate them.
    pub harmonics: Vec<Vec<PixelHarmonics>>,
    /// Median relative residual per view, at the shape that it was fitted on, pigment divided out.
    pub residuals: Vec<f64>,
    /// Pigment, where it was looked for.
    pub pigment: Option<Albedo>,
    /// Per view, what falls on a surface in the open, camera frame.
    pub in_the_open: Vec<Lighting>,
    /// Per view and masked pixel, how far shading may move the surface, 0 to 1; empty: everywhere.
    pub trust: Vec<Vec<f32>>,
    /// Log depth difference at which another view's intensity no longer counts; 0 where the views are lit
    /// differently.
    pub mean_tolerance: f64,
    /// Exponent of openness, as the photos show it ([`hidden_light`]); none where the light moves with the camera or
    /// is taken to cast no shadow.
    pub openness_exponent: Option<f32>,
}

impl Light {
    /// Median over the views.
    pub fn residual(&self) -> f64 {
        let known = self.residuals.iter().copied().filter(|r| r.is_finite());
        median(&mut known.collect::<Vec<f64>>()).unwrap_or(1.0)
    }

    /// The light of a view's pixels, whose `harmonics` are of the same level as everything else.
    pub fn of<'a>(&'a self, view: usize, harmonics: &'a [PixelHarmonics]) -> PixelLight<'a> {
        PixelLight {
            harmonics,
            pigment: self.pigment_of(view),
            trust: self.trust.get(view).map(Vec::as_slice),
            mean_tolerance: self.mean_tolerance,
            openness_exponent: self.openness_exponent.unwrap_or(0.0),
        }
    }

    /// The coefficients of a view at the level that they were fitted at.
    pub fn own(&self, view: usize) -> Cow<'_, [PixelHarmonics]> {
        Cow::Borrowed(&self.harmonics[view])
    }

    /// Pigment of a view's pixels.
    pub fn pigment_of(&self, view: usize) -> Option<&[[f32; 3]]> {
        self.pigment.as_ref().map(|p| p.relative[view].as_slice())
    }
}

/// What the light is fitted with, apart from the shape.
pub(crate) struct LightScene<'a> {
    pub known: &'a KnownLight,
    pub ground: Option<&'a Ground>,
    pub num_rays: usize,
    /// The processes among which the views' rays are divided.
    pub team: &'a dyn Team,
}

/// The environment's directions in the world: the same for all views where the light is fixed in the
/// world, turned with each view where it is fixed to the camera.
struct Rays {
    by_frame: Vec<Vec<Vector3<f32>>>,
}

impl Rays {
    fn new(num_rays: usize, kind: LightKind, level: &Level) -> Self {
        let rays = directions(num_rays);
        let by_frame = match kind {
            LightKind::World => vec![rays],
            LightKind::Camera => level
                .views
                .iter()
                .map(|view| {
                    let world_from_cam = view.camera.rotation.transpose().map(|v| v as f32);
                    rays.iter().map(|d| world_from_cam * d).collect()
                })
                .collect(),
        };
        Self { by_frame }
    }

    /// Those of a view.
    fn of(&self, view: usize) -> &[Vector3<f32>] {
        &self.by_frame[view.min(self.by_frame.len() - 1)]
    }
}

/// Voxels along the object's longest side.
const MAX_VOXELS: usize = 224;
/// Object pixels of a view on which the environment is fitted, and of all views together: the light is the same for all,
/// so that many views tell no more of it.
pub(crate) const FIT_PIXELS: usize = 3000;
const MAX_FIT_PIXELS: usize = 96_000;
/// Smoothness of the environment, relative.
const SMOOTHNESS: f64 = 1e-3;
/// Relative depth, in pixel footprints, at which another view's intensity counts half.
const MEAN_TOLERANCE_PX: f64 = 1.8;
/// Belief in pigment, and departure of the sphere's albedo, below which a second fit changes nothing.
const MIN_BELIEF: f64 = 0.05;
const MIN_RATIO: f32 = 0.03;
/// Influence of all points of the known light against all object pixels of one view.
const KNOWN_SHARE: f32 = 5.0;

pub(crate) fn rotation(view: &LevelView) -> UnitQuaternion<f64> {
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(view.camera.rotation))
}

/// The light with its residuals on a shape's normals. Where it is fixed to the camera, the views see
/// a point under different light, and their mean says nothing.
pub(crate) fn with_residuals(
    level: &Level,
    normals: &[Vec<[f64; 3]>],
    harmonics: Vec<Vec<PixelHarmonics>>,
    in_the_open: Vec<Lighting>,
    pigment: Option<Albedo>,
    kind: LightKind,
) -> Light {
    let residuals = level
        .views
        .par_iter()
        .enumerate()
        .map(|(i, view)| {
            let mut r: Vec<f64> = (0..view.pixels.len())
                .step_by(3)
                .filter(|&p| view.shows_surface(p))
                .map(|p| {
                    let mut rgb = view.intensity(p);
                    if let Some(pigment) = &pigment {
                        rgb = without_pigment(rgb, pigment.relative[i][p]);
                    }
                    relative(&harmonics[i][p], normals[i][p], rgb)
                })
                .collect();
            median(&mut r).unwrap_or(f64::NAN)
        })
        .collect();
    Light {
        harmonics,
        residuals,
        pigment,
        in_the_open,
        trust: Vec::new(),
        mean_tolerance: match kind {
            LightKind::World => MEAN_TOLERANCE_PX / level.focal(),
            LightKind::Camera => 0.0,
        },
        openness_exponent: None,
    }
}

fn without_pigment(rgb: [f32; 3], albedo: [f32; 3]) -> [f32; 3] {
    std::array::from_fn(|c| rgb[c] / albedo[c].max(0.1))
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
) -> Result<Option<Light>, TeamError> {
    let coarse: Vec<Vec<f64>> = (0..level.views.len())
        .into_par_iter()
        .map(|i| reduce_depth(&level.views[i], &rays_at.views[i], &depths[i]))
        .collect();
    let normals = |at: &Level, depths: &[Vec<f64>]| -> Vec<Vec<[f64; 3]>> {
        at.views
            .par_iter()
            .zip(depths)
            .map(|(view, depth)| plate::normals(view, depth))
            .collect()
    };
    let (fine, rough) = (normals(level, depths), normals(rays_at, &coarse));
    visible_on(level, (depths, &fine), rays_at, (&coarse, &rough), scene)
}

/// Depths and normals of all views.
type Shape<'a> = (&'a [Vec<f64>], &'a [Vec<[f64; 3]>]);

/// [`visible`], with the normals given.
pub(crate) fn visible_on(
    level: &Level,
    (depths, normals): Shape,
    rays_at: &Level,
    (coarse, coarse_normals): Shape,
    scene: &LightScene,
) -> Result<Option<Light>, TeamError> {
    let Some(volume) = Volume::carve(&depth_views(level, depths), MAX_VOXELS) else {
        return Ok(None);
    };
    let known = scene.known;
    let surroundings = Surroundings {
        volume,
        spheres: known.spheres.clone(),
        ground: scene.ground.cloned(),
    };
    let rays = Rays::new(scene.num_rays, known.kind, level);
    let transfers = divided(scene.team, rays_at.views.len(), 1, |i| {
        let view = &rays_at.views[i];
        let of_view: Vec<Transfer> = (0..view.pixels.len())
            .into_par_iter()
            .with_min_len(128)
            .map(|p| {
                let (x, y) = view.xy(p);
                let at = view.camera.unproject(x, y, coarse[i][p].exp()).coords;
                let n = coarse_normals[i][p];
                let n = view.camera.rotation.tr_mul(&Vector3::new(n[0], n[1], n[2]));
                let (at, n) = (at.map(|v| v as f32), n.map(|v| v as f32));
                let offset = surroundings.volume.start_height(&at, &n);
                transfer(&surroundings, &at, &n, rays.of(i), offset, None)
            })
            .collect();
        Ok::<_, TeamError>(of_view)
    })?;
    let num_views = rays_at.views.len();
    let fit_pixels = FIT_PIXELS.min(MAX_FIT_PIXELS / num_views.max(1)).max(1);
    let (mut samples, mut owners) = (Vec::new(), Vec::new());
    for (i, view) in rays_at.views.iter().enumerate() {
        let step = (view.pixels.len() / fit_pixels).max(1);
        for p in (0..view.pixels.len()).step_by(step) {
            let intensity = view.intensity(p);
            if !view.shows_surface(p) || intensity.iter().sum::<f32>() < 1e-4 {
                continue;
            }
            let t: &Transfer = &transfers[i][p];
            samples.push(EnvironmentSample {
                row: t.row(rays.of(i)),
                nearby: t.nearby_intensity(),
                intensity,
                weight: 1.0,
            });
            owners.push((i, p));
        }
    }
    let num_points: usize = known.groups.iter().map(|group| group.points.len()).sum();
    let weight = KNOWN_SHARE * fit_pixels as f32 / num_points.max(1) as f32;
    let mut of_groups = Vec::with_capacity(known.groups.len());
    for group in &known.groups {
        let extra: Vec<EnvironmentSample> = group
            .points
            .par_iter()
            .map(|p| {
                let rays = rays.of(p.view);
                let t = match group.sphere {
                    Some(k) => {
                        let EmittingSphere { center, radius, .. } = &surroundings.spheres[k];
                        let at = center.coords + p.normal * *radius;
                        let offset = 0.02 * radius;
                        transfer(&surroundings, &at, &p.normal, rays, offset, Some(k))
                    }
                    None => Transfer::open(&p.normal, rays.len()),
                };
                EnvironmentSample {
                    row: t.row(rays),
                    nearby: t.nearby_intensity(),
                    intensity: p.intensity,
                    weight,
                }
            })
            .filter(|s| s.intensity.iter().sum::<f32>() > 1e-4)
            .collect();
        of_groups.push(samples.len()..samples.len() + extra.len());
        samples.extend(extra);
    }
    // What comes from elsewhere may be of another strength, which object and spheres tell.
    let is_open = |(_, group): &(_, &KnownGroup)| group.sphere.is_none();
    if let Some((range, _)) = of_groups.iter().zip(&known.groups).find(is_open) {
        let of_scene = fit_environment(&samples[..range.start], rays.of(0), SMOOTHNESS);
        let Some(of_scene) = of_scene else {
            return Ok(None);
        };
        let ratio = known_ratio(&samples[range.clone()], &of_scene);
        for sample in &mut samples[range.clone()] {
            sample.intensity = std::array::from_fn(|c| sample.intensity[c] / ratio[c].max(1e-6));
        }
    }
    let Some(mut fit) = fit_environment(&samples, rays.of(0), SMOOTHNESS) else {
        return Ok(None);
    };
    let interpolated = |fit: &EnvironmentFit| -> Vec<Vec<PixelHarmonics>> {
        (0..level.views.len())
            .map(|i| {
                let turn = rotation(&level.views[i]);
                let own: Vec<PixelHarmonics> = transfers[i]
                    .par_iter()
                    .with_min_len(256)
                    .map(|t| {
                        t.harmonics(rays.of(i), &fit.radiance, fit.bounce).map(|l| {
                            let world = SphericalHarmonics(l.map(f64::from));
                            rotate_harmonics(&world, &turn).0.map(|v| v as f32)
                        })
                    })
                    .collect();
                finer(&rays_at.views[i], &level.views[i], &own)
            })
            .collect()
    };
    let in_the_open = |fit: &EnvironmentFit| -> Vec<Lighting> {
        let of_environment = open_harmonics(fit, scene.num_rays);
        let views = level.views.iter();
        views
            .map(|view| match known.kind {
                LightKind::World => rotate(&of_environment, &rotation(view)),
                LightKind::Camera => of_environment.clone(),
            })
            .collect()
    };
    let of_fit = |fit: &EnvironmentFit| {
        let (harmonics, open) = (interpolated(fit), in_the_open(fit));
        with_residuals(level, normals, harmonics, open, None, known.kind)
    };
    let mut light = of_fit(&fit);
    let pigment = albedo::estimate(level, depths, &|i| light.own(i), light.mean_tolerance);
    let ratios: Vec<[f32; 3]> = of_groups
        .iter()
        .map(|range| known_ratio(&samples[range.clone()], &fit))
        .collect();
    let other_paint = ratios.iter().flatten().any(|r| (r - 1.0).abs() > MIN_RATIO);
    if pigment.belief > MIN_BELIEF || other_paint {
        let relative: Vec<Vec<[f32; 3]>> = (0..level.views.len())
            .map(|i| reduce(&level.views[i], &rays_at.views[i], &pigment.relative[i]))
            .collect();
        for (sample, &(i, p)) in samples.iter_mut().zip(&owners) {
            sample.intensity = without_pigment(sample.intensity, relative[i][p]);
        }
        for (range, ratio) in of_groups.into_iter().zip(ratios) {
            for sample in &mut samples[range] {
                sample.intensity = without_pigment(sample.intensity, ratio);
            }
        }
        let Some(again) = fit_environment(&samples, rays.of(0), SMOOTHNESS) else {
            return Ok(None);
        };
        fit = again;
        light = of_fit(&fit);
    }
    let pigment = albedo::estimate(level, depths, &|i| light.own(i), light.mean_tolerance);
    let mut light = with_residuals(
        level,
        normals,
        light.harmonics,
        light.in_the_open,
        Some(pigment),
        known.kind,
    );
    if known.kind == LightKind::World {
        light.openness_exponent = Some(hidden_light::exponent(
            &level.views,
            depths,
            &|i| light.own(i),
            light.pigment.as_ref(),
        ));
    }
    Ok(Some(light))
}

/// Nine harmonics of what falls on a surface in the open, in the environment's own frame.
fn open_harmonics(fit: &EnvironmentFit, num_rays: usize) -> Lighting {
    const NUM_NORMALS: usize = 400;
    let rays = directions(num_rays);
    let (mut normals, mut values) = (Vec::new(), [const { Vec::new() }; 3]);
    for normal in directions(NUM_NORMALS) {
        let row = Transfer::open(&normal, num_rays).row(&rays);
        for (c, values) in values.iter_mut().enumerate() {
            let light: f32 = row.iter().zip(&fit.radiance).map(|(t, l)| t * l[c]).sum();
            values.push(f64::from(light));
        }
        normals.push(normal.map(f64::from).normalize());
    }
    let channel = |values: &Vec<f64>| {
        let fitted = fit_robust(&normals, values, None);
        // Normals all over the sphere determine nine harmonics; darkness has none.
        fitted.map_or_else(|_| SphericalHarmonics::default(), |fit| fit.coefficients)
    };
    Lighting {
        channels: values.iter().map(channel).collect(),
    }
}

/// A sphere's albedo over the object's, or a given light's over that of the photos: median ratio between
/// what its points show and what the fitted light gives.
fn known_ratio(samples: &[EnvironmentSample], fit: &EnvironmentFit) -> [f32; 3] {
    std::array::from_fn(|c| {
        let mut ratios: Vec<f64> = samples
            .iter()
            .filter_map(|s| {
                let light: f32 = s.row.iter().zip(&fit.radiance).map(|(t, l)| t * l[c]).sum();
                let light = light + fit.bounce[c] * s.nearby[c];
                (light > 1e-4).then(|| f64::from(s.intensity[c] / light))
            })
            .collect();
        median(&mut ratios).unwrap_or(1.0) as f32
    })
}

fn depth_views(level: &Level, depths: &[Vec<f64>]) -> Vec<DepthView> {
    let weights = rilievo_stereo::surfaces::incidence_weights(level, depths);
    level
        .views
        .iter()
        .zip(depths)
        .zip(weights)
        .map(|((view, depth), weight)| {
            let camera = &view.camera;
            let metric: Vec<f64> = depth.iter().map(|z| z.exp()).collect();
            let mut depth = view.spread(&metric, 0.0);
            for y in 0..camera.height {
                for x in 0..camera.width {
                    let is_object = *view.mask.at(x, y);
                    if view.cut_by_frame && !is_object && !camera.shows(x as i32, y as i32) {
                        *depth.at_mut(x, y) = f32::NAN;
                    }
                }
            }
            DepthView {
                intrinsics: Intrinsics::undistorted(
                    (camera.width, camera.height),
                    [camera.fx, camera.fy, camera.cx, camera.cy],
                ),
                cam_from_world: RigidTransform {
                    rotation: rotation(view),
                    translation: camera.translation,
                },
                depth,
                weight,
                image: view.image.clone(),
                cut_by_frame: view.cut_by_frame,
            }
        })
        .collect()
}

/// Values at the coarser level: mean of the four children (all are masked).
fn reduce<const N: usize>(
    fine: &LevelView,
    coarse: &LevelView,
    values: &[[f32; N]],
) -> Vec<[f32; N]> {
    if fine.mask.width == coarse.mask.width {
        return values.to_vec();
    }
    (0..coarse.pixels.len())
        .map(|p| {
            let mut sum = [0.0; N];
            for child in between_levels::children(fine, coarse, p) {
                for (s, v) in sum.iter_mut().zip(&values[child]) {
                    *s += 0.25 * v;
                }
            }
            sum
        })
        .collect()
}

/// Log depth at the coarser level, or at the same.
fn reduce_depth(fine: &LevelView, coarse: &LevelView, depth: &[f64]) -> Vec<f64> {
    if fine.mask.width == coarse.mask.width {
        return depth.to_vec();
    }
    between_levels::reduce(fine, coarse, depth)
}

/// Coefficients at a finer level.
pub(crate) fn finer(
    coarse: &LevelView,
    fine: &LevelView,
    values: &[PixelHarmonics],
) -> Vec<PixelHarmonics> {
    let flat: Vec<[f32; 27]> = values
        .iter()
        .map(|l| std::array::from_fn(|k| l[k / 9][k % 9]))
        .collect();
    spread::spread(coarse, fine, &flat)
        .iter()
        .map(|l| std::array::from_fn(|c| std::array::from_fn(|k| l[9 * c + k])))
        .collect()
}
