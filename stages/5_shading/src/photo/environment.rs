//! The environment and its light on the current shape, with shadow and bounce.
//!
//! Rays from the pixels of the next coarser level against the solid that the depth maps carve, the
//! spheres and the ground; the environment fitted on object pixels and the known light's samples
//! (`known_light`) together, still in the world or, for a light fixed to the camera, still in the
//! camera's frame, where every view casts the same rays in directions of its own; endlessly far, or
//! on a dome at the distance that explains the photos best (`light_distance`); coefficients
//! interpolated to the level. Pigment, and an albedo of the sphere that differs from the object's,
//! are divided out of the samples before a second fit. `distant` does without rays.

use super::hidden_light;
use super::known_light::KnownLight;
use super::light::{self, FIT_PIXELS, Light, rotation, without_pigment};
use super::lit::{BoundingSphere, Domes, Lit, SMOOTHNESS, Shape, known_ratio};
use super::shading::PixelHarmonics;
use rayon::prelude::*;
use rilievo_photometry::harmonics::{fit_robust, rotate, rotate_harmonics};
use rilievo_photometry::visibility::{
    DepthView, Dome, EnvironmentFit, EnvironmentSample, Ground, Surroundings, Transfer, Volume,
    directions, fit_environment,
};
use rilievo_scene::{
    Intrinsics, LightKind, Lighting, RigidTransform, SphericalHarmonics, Team, TeamError,
};
use rilievo_stereo::between_levels;
use rilievo_stereo::level::{Level, LevelView};
use rilievo_stereo::surfaces::incidence_weights;
use std::borrow::Cow;

/// Voxels along the object's longest side.
const MAX_VOXELS: usize = 224;
/// Object pixels of all views together on which the environment is fitted: the light is the same
/// for all, so that many views add nothing.
const MAX_FIT_PIXELS: usize = 96_000;
/// Belief in pigment, and departure of the sphere's albedo, below which a second fit changes
/// nothing.
const MIN_BELIEF: f64 = 0.05;
const MIN_RATIO: f32 = 0.03;

/// What the light is fitted with, apart from the shape.
pub(crate) struct LightScene<'a> {
    pub known: &'a KnownLight,
    pub ground: Option<&'a Ground>,
    pub num_rays: usize,
    /// The processes among which the views' rays are divided.
    pub team: &'a dyn Team,
}

/// Per-pixel light with visibility at `level`, rays cast from the pixels of `rays_at`, the next
/// coarser level (or the same). `None` where no environment can be fitted.
pub(crate) fn visible(
    level: &Level,
    depths: &[Vec<f64>],
    rays_at: &Level,
    scene: &LightScene,
) -> Result<Option<Light>, TeamError> {
    let coarse: Vec<Vec<f64>> = (0..level.views.len())
        .into_par_iter()
        .map(|i| between_levels::reduce(&level.views[i], &rays_at.views[i], &depths[i]))
        .collect();
    let (fine, rough) = (
        light::normals(level, depths),
        light::normals(rays_at, &coarse),
    );
    visible_on(level, (depths, &fine), rays_at, (&coarse, &rough), scene)
}

/// [`visible`], with the normals given.
pub(crate) fn visible_on(
    level: &Level,
    (depths, normals): Shape,
    rays_at: &Level,
    coarse: Shape,
    scene: &LightScene,
) -> Result<Option<Light>, TeamError> {
    let Some(volume) = Volume::carve(&depth_views(level, depths), MAX_VOXELS) else {
        return Ok(None);
    };
    let known = scene.known;
    let around = BoundingSphere::of(&volume);
    let surroundings = Surroundings {
        volume,
        spheres: known.spheres.clone(),
        ground: scene.ground.cloned(),
    };
    let lit = Lit {
        rays_at,
        shape: coarse,
        known,
        surroundings: &surroundings,
    };
    let domes = |nearness| Domes::new(scene.num_rays, known.kind, level, around.center, nearness);
    let nearness = lit.nearness(&around, &domes);
    let domes = domes(nearness);
    let transfers = lit.transfers(&domes, scene.team)?;
    let cast = Cast {
        level,
        lit,
        domes,
        transfers,
    };
    let light = cast.fitted(depths, normals);
    Ok(light.map(|light| Light {
        distance: (nearness > 0.0).then(|| 1.0 / f64::from(nearness)),
        ..light
    }))
}

/// The rays that were cast from a level, and the level that is lit by them.
struct Cast<'a> {
    level: &'a Level,
    lit: Lit<'a>,
    domes: Domes,
    transfers: Vec<Vec<Transfer>>,
}

impl Cast<'_> {
    /// The light of the environment, with what pigment and paint of the spheres leave divided out.
    fn fitted(&self, depths: &[Vec<f64>], normals: &[Vec<[f64; 3]>]) -> Option<Light> {
        let cells = &self.domes.of(0).cells;
        let fit_of = |samples: &[EnvironmentSample]| fit_environment(samples, cells, SMOOTHNESS);
        let known = self.lit.known;
        let per_view = FIT_PIXELS
            .min(MAX_FIT_PIXELS / self.transfers.len().max(1))
            .max(1);
        let seen = |i: usize, p: usize| Cow::Borrowed(&self.transfers[i][p]);
        let mut samples = self.lit.samples(&self.domes, per_view, seen);
        // A light from elsewhere may be of another strength: object and spheres scale it.
        let is_open = known.groups.iter().position(|group| group.sphere.is_none());
        if let Some(range) = is_open.map(|k| samples.groups[k].clone()) {
            let of_scene = fit_of(&samples.all[..range.start])?;
            let ratio = known_ratio(&samples.all[range.clone()], &of_scene);
            for sample in &mut samples.all[range] {
                sample.intensity =
                    std::array::from_fn(|c| sample.intensity[c] / ratio[c].max(1e-6));
            }
        }
        let fit = fit_of(&samples.all)?;
        let mut light = self.light(&fit, normals);
        let pigment = light.estimate_pigment(self.level, depths);
        let ratios = samples.ratios(&fit);
        let other_paint = ratios.iter().flatten().any(|r| (r - 1.0).abs() > MIN_RATIO);
        if pigment.belief > MIN_BELIEF || other_paint {
            let views = self.level.views.iter().zip(&self.lit.rays_at.views);
            let relative: Vec<Vec<[f32; 3]>> = views
                .zip(&pigment.relative)
                .map(|((fine, coarse), relative)| reduce(fine, coarse, relative))
                .collect();
            for (sample, &(i, p)) in samples.all.iter_mut().zip(&samples.owners) {
                sample.intensity = without_pigment(sample.intensity, relative[i][p]);
            }
            samples.divide_by(&ratios);
            light = self.light(&fit_of(&samples.all)?, normals);
        }
        let mut light = light.with_pigment(self.level, depths, normals);
        if known.kind == LightKind::World {
            let views = &self.level.views;
            let pigment = light.pigment.as_ref();
            let exponent = hidden_light::exponent(views, depths, &|i| light.own(i), pigment);
            light.openness_exponent = Some(exponent);
        }
        Some(light)
    }

    /// The light of an environment, without pigment.
    fn light(&self, fit: &EnvironmentFit, normals: &[Vec<[f64; 3]>]) -> Light {
        let views = self.level.views.iter();
        let kind = self.lit.known.kind;
        let of_environment = open_harmonics(fit, self.domes.of(0).cells.len());
        let in_the_open = views.clone().map(|view| match kind {
            LightKind::World => rotate(&of_environment, &rotation(view)),
            LightKind::Camera => of_environment.clone(),
        });
        let harmonics =
            views
                .zip(&self.lit.rays_at.views)
                .enumerate()
                .map(|(i, (view, parent))| {
                    let turn = rotation(view);
                    let own: Vec<PixelHarmonics> = self.transfers[i]
                        .par_iter()
                        .with_min_len(256)
                        .map(|t| {
                            let of_world = t.harmonics(self.domes.of(i), &fit.radiance, fit.bounce);
                            of_world.map(|l| {
                                let world = SphericalHarmonics(l.map(f64::from));
                                rotate_harmonics(&world, &turn).0.map(|v| v as f32)
                            })
                        })
                        .collect();
                    light::finer(parent, view, &own)
                });
        let (harmonics, in_the_open) = (harmonics.collect(), in_the_open.collect());
        Light::new((self.level, normals), harmonics, in_the_open, kind)
    }
}

/// Nine harmonics of what falls on a surface in the open, in the centre of the environment and its own frame.
fn open_harmonics(fit: &EnvironmentFit, num_rays: usize) -> Lighting {
    const NUM_NORMALS: usize = 400;
    let dome = Dome::far(directions(num_rays));
    let (mut normals, mut values) = (Vec::new(), [const { Vec::new() }; 3]);
    for normal in directions(NUM_NORMALS) {
        let row = Transfer::open(&normal, &dome).row(&dome);
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

/// The views' depths and photos, of which the solid is carved. Beyond the frame that cuts the
/// object nothing is known.
fn depth_views(level: &Level, depths: &[Vec<f64>]) -> Vec<DepthView> {
    let views = level.views.iter().zip(depths);
    views
        .zip(incidence_weights(level, depths))
        .map(|((view, depth), weight)| {
            let camera = &view.camera;
            let metric: Vec<f64> = depth.iter().map(|z| z.exp()).collect();
            let mut depth = view.spread(&metric, 0.0);
            if view.cut_by_frame {
                for (k, z) in depth.data.iter_mut().enumerate() {
                    let (x, y) = ((k % camera.width) as i32, (k / camera.width) as i32);
                    if !view.mask.data[k] && !camera.shows(x, y) {
                        *z = f32::NAN;
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
