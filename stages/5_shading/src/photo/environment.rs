//! The environment and its light on the current shape, with shadow and bounce.
//!
//! Rays from the pixels of the next coarser level against the solid that the depth maps carve, the
//! spheres and the ground; the environment fitted on object pixels and the known light's samples
//! (`known_light`) together, still in the world or, for a light fixed to the camera, still in the
//! camera's frame, where every view casts the same rays in directions of its own; coefficients
//! interpolated to the level. Pigment, and an albedo of the sphere that differs from the object's,
//! are divided out of the samples before a second fit. `distant` does without rays.

use super::hidden_light;
use super::known_light::KnownLight;
use super::light::{self, FIT_PIXELS, Light, rotation, without_pigment};
use super::light_distance;
use super::shading::PixelHarmonics;
use nalgebra::Vector3;
use rayon::prelude::*;
use rilievo_numerics::robust::median;
use rilievo_photometry::harmonics::{fit_robust, rotate, rotate_harmonics};
use rilievo_photometry::visibility::{
    DepthView, Dome, EmittingSphere, EnvironmentFit, EnvironmentSample, Ground, Surroundings,
    Transfer, Volume, directions, fit_environment, transfer,
};
use rilievo_scene::team::divided;
use rilievo_scene::{
    Intrinsics, LightKind, Lighting, RigidTransform, SphericalHarmonics, Team, TeamError,
};
use rilievo_stereo::between_levels;
use rilievo_stereo::level::{Level, LevelView};
use rilievo_stereo::surfaces::incidence_weights;
use std::ops::Range;

/// Voxels along the object's longest side.
const MAX_VOXELS: usize = 224;
/// Object pixels of all views together on which the environment is fitted: the light is the same
/// for all, so that many views add nothing.
const MAX_FIT_PIXELS: usize = 96_000;
/// Object pixels of all views together on which the distance of the light is found: one number.
const DISTANCE_PIXELS: usize = 3000;
/// Smoothness of the environment, relative.
const SMOOTHNESS: f64 = 1e-3;
/// Belief in pigment, and departure of the sphere's albedo, below which a second fit changes
/// nothing.
const MIN_BELIEF: f64 = 0.05;
const MIN_RATIO: f32 = 0.03;
/// Influence of all points of the known light against all object pixels of one view.
const KNOWN_SHARE: f32 = 5.0;
/// Sum of a sample's channels below which it is too dark to be used.
const MIN_INTENSITY: f32 = 1e-4;

/// What the light is fitted with, apart from the shape.
pub(crate) struct LightScene<'a> {
    pub known: &'a KnownLight,
    pub ground: Option<&'a Ground>,
    pub num_rays: usize,
    /// The processes among which the views' rays are divided.
    pub team: &'a dyn Team,
}

/// The environment's cells in the world: the same for all views where the light is fixed in the world, turned with
/// each view where it is fixed to the camera.
struct Rays {
    by_frame: Vec<Dome>,
}

impl Rays {
    fn new(
        num_rays: usize,
        kind: LightKind,
        level: &Level,
        around: &Sphere,
        nearness: f32,
    ) -> Self {
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
        let dome = |cells| Dome {
            cells,
            center: around.center,
            nearness,
        };
        Self {
            by_frame: by_frame.into_iter().map(dome).collect(),
        }
    }

    /// Those of a view.
    fn of(&self, view: usize) -> &Dome {
        &self.by_frame[view.min(self.by_frame.len() - 1)]
    }
}

/// What encloses the object.
struct Sphere {
    center: Vector3<f32>,
    radius: f32,
}

impl Sphere {
    fn around(volume: &Volume) -> Self {
        let (low, high) = volume.corners();
        Self {
            center: nalgebra::center(&low, &high).coords,
            radius: 0.5 * (high - low).norm(),
        }
    }
}

/// Depths and normals of all views.
type Shape<'a> = (&'a [Vec<f64>], &'a [Vec<[f64; 3]>]);

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
    let around = Sphere::around(&volume);
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
    let rays = |nearness: f32| Rays::new(scene.num_rays, known.kind, level, &around, nearness);
    let nearness = lit.nearness(&around, &rays);
    let rays = rays(nearness);
    let transfers = lit.transfers(&rays, scene.team)?;
    let cast = Cast {
        level,
        lit,
        rays,
        transfers,
    };
    let light = cast.fitted(depths, normals);
    Ok(light.map(|light| Light {
        distance: (nearness > 0.0).then(|| 1.0 / f64::from(nearness)),
        ..light
    }))
}

/// What is lit: pixels of a level at a shape, and points of the known light.
struct Lit<'a> {
    rays_at: &'a Level,
    shape: Shape<'a>,
    known: &'a KnownLight,
    surroundings: &'a Surroundings,
}

/// The rays that were cast from a level, and the level that is lit by them.
struct Cast<'a> {
    level: &'a Level,
    lit: Lit<'a>,
    rays: Rays,
    transfers: Vec<Vec<Transfer>>,
}

/// What the environment is fitted on.
struct Samples {
    all: Vec<EnvironmentSample>,
    /// View and pixel of the first ones, which are the object's.
    owners: Vec<(usize, usize)>,
    /// The others, by group of the known light.
    groups: Vec<Range<usize>>,
}

impl Lit<'_> {
    /// What the pixels of every view see.
    fn transfers(&self, rays: &Rays, team: &dyn Team) -> Result<Vec<Vec<Transfer>>, TeamError> {
        divided(team, self.rays_at.views.len(), 1, |i| {
            let of_view: Vec<Transfer> = (0..self.rays_at.views[i].pixels.len())
                .into_par_iter()
                .with_min_len(128)
                .map(|p| self.transfer(rays, i, p))
                .collect();
            Ok(of_view)
        })
    }

    /// What pixel `p` of view `i` sees.
    fn transfer(&self, rays: &Rays, i: usize, p: usize) -> Transfer {
        let (view, (depths, normals)) = (&self.rays_at.views[i], self.shape);
        let (x, y) = view.xy(p);
        let at = view.camera.unproject(x, y, depths[i][p].exp()).coords;
        let n = view.camera.rotation.tr_mul(&Vector3::from(normals[i][p]));
        let (at, n) = (at.map(|v| v as f32), n.map(|v| v as f32));
        let offset = self.surroundings.volume.start_height(&at, &n);
        transfer(self.surroundings, &at, &n, rays.of(i), offset, None)
    }

    /// Object pixels, about `per_view` of each view, with what `transfer_of` says that they see; and points of the
    /// known light.
    fn samples(
        &self,
        rays: &Rays,
        per_view: usize,
        transfer_of: impl Fn(usize, usize) -> Transfer + Sync,
    ) -> Samples {
        let (mut all, mut owners) = (Vec::new(), Vec::new());
        for (i, view) in self.rays_at.views.iter().enumerate() {
            let step = (view.pixels.len() / per_view).max(1);
            let pixels = (0..view.pixels.len()).step_by(step);
            let usable = pixels.filter(|&p| {
                view.shows_surface(p) && view.intensity(p).iter().sum::<f32>() >= MIN_INTENSITY
            });
            owners.extend(usable.map(|p| (i, p)));
        }
        let of_object = owners.par_iter().map(|&(i, p)| {
            let intensity = self.rays_at.views[i].intensity(p);
            sample(&transfer_of(i, p), rays.of(i), intensity, 1.0)
        });
        all.par_extend(of_object);
        let known = self.known;
        let num_points: usize = known.groups.iter().map(|group| group.points.len()).sum();
        let weight = KNOWN_SHARE * per_view as f32 / num_points.max(1) as f32;
        let mut groups = Vec::with_capacity(known.groups.len());
        for group in &known.groups {
            let of_group = group.points.par_iter().map(|p| {
                let rays = rays.of(p.view);
                let t = match group.sphere {
                    Some(k) => {
                        let EmittingSphere { center, radius, .. } = &self.surroundings.spheres[k];
                        let at = center.coords + p.normal * *radius;
                        let offset = 0.02 * radius;
                        transfer(self.surroundings, &at, &p.normal, rays, offset, Some(k))
                    }
                    None => Transfer::open(&p.normal, rays),
                };
                sample(&t, rays, p.intensity, weight)
            });
            let is_lit = |s: &EnvironmentSample| s.intensity.iter().sum::<f32>() > MIN_INTENSITY;
            let of_group: Vec<EnvironmentSample> = of_group.filter(is_lit).collect();
            groups.push(all.len()..all.len() + of_group.len());
            all.extend(of_group);
        }
        Samples {
            all,
            owners,
            groups,
        }
    }

    /// One over the distance of the light, in the world's unit; 0 where it may be endlessly far. A light that was
    /// given tells nothing of it.
    fn nearness(&self, around: &Sphere, rays: &dyn Fn(f32) -> Rays) -> f32 {
        let per_view = (DISTANCE_PIXELS / self.rays_at.views.len()).max(1);
        let spheres = self.surroundings.spheres.iter();
        let reaches =
            spheres.map(|sphere| (sphere.center.coords - around.center).norm() + sphere.radius);
        let reach = reaches.fold(around.radius, f32::max);
        let residuals = |nearness: f32| {
            let rays = rays(nearness);
            let cast = |i: usize, p: usize| self.transfer(&rays, i, p);
            let mut samples = self.samples(&rays, per_view, cast);
            if self
                .known
                .groups
                .last()
                .is_some_and(|group| group.sphere.is_none())
            {
                let open = samples.groups.pop().map_or(0, |range| range.len());
                samples.all.truncate(samples.all.len() - open);
            }
            let cells = &rays.of(0).cells;
            let fit = fit_environment(&samples.all, cells, SMOOTHNESS)?;
            let ratios = samples.ratios(&fit);
            samples.divide_by(&ratios);
            Some(fit_environment(&samples.all, cells, SMOOTHNESS)?.residuals)
        };
        light_distance::nearness(around.radius, reach, &residuals)
    }
}

impl Samples {
    /// Albedo of every group of the known light over the object's.
    fn ratios(&self, fit: &EnvironmentFit) -> Vec<[f32; 3]> {
        let groups = self.groups.iter();
        groups
            .map(|range| known_ratio(&self.all[range.clone()], fit))
            .collect()
    }

    /// The known light as of the object's paint.
    fn divide_by(&mut self, ratios: &[[f32; 3]]) {
        for (range, &ratio) in self.groups.iter().zip(ratios) {
            for sample in &mut self.all[range.clone()] {
                sample.intensity = without_pigment(sample.intensity, ratio);
            }
        }
    }
}

impl Cast<'_> {
    /// The light of the environment, with what pigment and paint of the spheres leave divided out.
    fn fitted(&self, depths: &[Vec<f64>], normals: &[Vec<[f64; 3]>]) -> Option<Light> {
        let cells = &self.rays.of(0).cells;
        let fit_of = |samples: &[EnvironmentSample]| fit_environment(samples, cells, SMOOTHNESS);
        let known = self.lit.known;
        let per_view = FIT_PIXELS
            .min(MAX_FIT_PIXELS / self.transfers.len().max(1))
            .max(1);
        let seen = |i: usize, p: usize| self.transfers[i][p].clone();
        let mut samples = self.lit.samples(&self.rays, per_view, seen);
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
        let of_environment = open_harmonics(fit, self.rays.of(0).cells.len());
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
                            let of_world = t.harmonics(self.rays.of(i), &fit.radiance, fit.bounce);
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

fn sample(t: &Transfer, rays: &Dome, intensity: [f32; 3], weight: f32) -> EnvironmentSample {
    EnvironmentSample {
        row: t.row(rays),
        nearby: t.nearby_intensity(),
        intensity,
        weight,
    }
}

/// Nine harmonics of what falls on a surface in the open, in the centre of the environment and its own frame.
fn open_harmonics(fit: &EnvironmentFit, num_rays: usize) -> Lighting {
    const NUM_NORMALS: usize = 400;
    let rays = Dome::far(directions(num_rays));
    let (mut normals, mut values) = (Vec::new(), [const { Vec::new() }; 3]);
    for normal in directions(NUM_NORMALS) {
        let row = Transfer::open(&normal, &rays).row(&rays);
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

/// A sphere's albedo over the object's, or a given light's over that of the photos: median ratio
/// between the points' intensities and those of the fitted light.
fn known_ratio(samples: &[EnvironmentSample], fit: &EnvironmentFit) -> [f32; 3] {
    let fitted: Vec<[f32; 3]> = samples.iter().map(|s| fit.intensity(s)).collect();
    std::array::from_fn(|c| {
        let mut ratios: Vec<f64> = samples
            .iter()
            .zip(&fitted)
            .filter(|(_, light)| light[c] > 1e-4)
            .map(|(s, light)| f64::from(s.intensity[c] / light[c]))
            .collect();
        median(&mut ratios).unwrap_or(1.0) as f32
    })
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
