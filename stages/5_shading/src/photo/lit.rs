//! What is lit: pixels and points of the known light, and the samples that tell of their light.

use super::known_light::KnownLight;
use super::light::without_pigment;
use super::light_distance::{self, Evidence};
use nalgebra::Vector3;
use rayon::prelude::*;
use rilievo_numerics::robust::median;
use rilievo_photometry::visibility::{
    Dome, EmittingSphere, EnvironmentFit, EnvironmentSample, Surroundings, Transfer, Volume,
    directions, fit_environment, transfer,
};
use rilievo_scene::team::divided;
use rilievo_scene::{LightKind, Team, TeamError};
use rilievo_stereo::level::Level;
use std::borrow::Cow;
use std::ops::Range;

/// Smoothness of the environment, relative.
pub(crate) const SMOOTHNESS: f64 = 1e-3;
/// Object pixels of all views together, and points of the spheres, on which the distance of the light is found: one number.
const DISTANCE_PIXELS: usize = 3000;
/// Influence of all points of the known light against all object pixels of one view.
const KNOWN_SHARE: f32 = 5.0;
/// Sum of a sample's channels below which it is too dark to be used.
const MIN_INTENSITY: f32 = 1e-4;

/// The environment's dome: the same for all views where the light is fixed in the world; where it is fixed to the camera,
/// turned and moved with each view.
pub(crate) struct Domes {
    by_frame: Vec<Dome>,
}

impl Domes {
    /// Around a place of the world. For a light fixed to the camera that is the mean of where the cameras see it.
    pub fn new(
        num_cells: usize,
        kind: LightKind,
        level: &Level,
        center: Vector3<f32>,
        nearness: f32,
    ) -> Self {
        let cells = directions(num_cells);
        let by_frame = match kind {
            LightKind::World => vec![Dome {
                cells,
                center,
                nearness,
            }],
            LightKind::Camera => {
                let poses = level.views.iter().map(|view| {
                    let (turn, moved) = (view.camera.rotation, view.camera.translation);
                    (turn.map(|v| v as f32), moved.map(|v| v as f32))
                });
                let seen = poses.clone().map(|(turn, moved)| turn * center + moved);
                let in_camera = seen.sum::<Vector3<f32>>() / level.views.len().max(1) as f32;
                let dome = |(turn, moved): (nalgebra::Matrix3<f32>, Vector3<f32>)| Dome {
                    cells: cells.iter().map(|d| turn.tr_mul(d)).collect(),
                    center: turn.tr_mul(&(in_camera - moved)),
                    nearness,
                };
                poses.map(dome).collect()
            }
        };
        Self { by_frame }
    }

    /// The one of a view.
    pub fn of(&self, view: usize) -> &Dome {
        &self.by_frame[view.min(self.by_frame.len() - 1)]
    }

    /// Greatest distance of a point from the centre of a view's dome.
    fn offset(&self, point: &Vector3<f32>) -> f32 {
        let offsets = self
            .by_frame
            .iter()
            .map(|dome| (point - dome.center).norm());
        offsets.fold(0.0, f32::max)
    }
}

/// What encloses the object, in the world.
pub(crate) struct BoundingSphere {
    pub center: Vector3<f32>,
    pub radius: f32,
}

impl BoundingSphere {
    pub fn of(volume: &Volume) -> Self {
        let (low, high) = volume.corners();
        Self {
            center: nalgebra::center(&low, &high).coords,
            radius: 0.5 * (high - low).norm(),
        }
    }
}

/// Depths and normals of all views.
pub(crate) type Shape<'a> = (&'a [Vec<f64>], &'a [Vec<[f64; 3]>]);

/// What is lit: pixels of a level at a shape, and points of the known light.
pub(crate) struct Lit<'a> {
    pub rays_at: &'a Level,
    pub shape: Shape<'a>,
    pub known: &'a KnownLight,
    pub surroundings: &'a Surroundings,
}

/// What an environment is fitted on.
pub(crate) struct Samples {
    pub all: Vec<EnvironmentSample>,
    /// View and pixel of the first ones, which are the object's.
    pub owners: Vec<(usize, usize)>,
    /// The others, by group of the known light.
    pub groups: Vec<Range<usize>>,
    /// Where each of all lies, world.
    places: Vec<Vector3<f32>>,
}

impl Lit<'_> {
    /// What the pixels of every view see.
    pub fn transfers(
        &self,
        domes: &Domes,
        team: &dyn Team,
    ) -> Result<Vec<Vec<Transfer>>, TeamError> {
        divided(team, self.rays_at.views.len(), 1, |i| {
            let of_view: Vec<Transfer> = (0..self.rays_at.views[i].pixels.len())
                .into_par_iter()
                .with_min_len(128)
                .map(|p| self.transfer(domes, i, p))
                .collect();
            Ok(of_view)
        })
    }

    /// What pixel `p` of view `i` sees.
    fn transfer(&self, domes: &Domes, i: usize, p: usize) -> Transfer {
        let (view, (depths, normals)) = (&self.rays_at.views[i], self.shape);
        let (x, y) = view.xy(p);
        let at = view.camera.unproject(x, y, depths[i][p].exp()).coords;
        let n = view.camera.rotation.tr_mul(&Vector3::from(normals[i][p]));
        let (at, n) = (at.map(|v| v as f32), n.map(|v| v as f32));
        let offset = self.surroundings.volume.start_height(&at, &n);
        transfer(self.surroundings, &at, &n, domes.of(i), offset, None)
    }

    /// Object pixels, about `per_view` of each view and clipped ones among them, with what `transfer_of` says that they see;
    /// and points of the known light.
    pub fn samples<'t>(
        &self,
        domes: &Domes,
        per_view: usize,
        transfer_of: impl Fn(usize, usize) -> Cow<'t, Transfer> + Sync,
    ) -> Samples {
        let mut owners = Vec::new();
        for (i, view) in self.rays_at.views.iter().enumerate() {
            let step = (view.pixels.len() / per_view).max(1);
            let pixels = (0..view.pixels.len()).step_by(step);
            let usable = pixels.filter(|&p| {
                !view.is_on_outline(p) && view.intensity(p).iter().sum::<f32>() >= MIN_INTENSITY
            });
            owners.extend(usable.map(|p| (i, p)));
        }
        let of_object = owners.par_iter().map(|&(i, p)| {
            let view = &self.rays_at.views[i];
            let (read, place) = sample(&transfer_of(i, p), domes.of(i), view.intensity(p), 1.0);
            let is_clipped = !view.is_usable(p);
            (EnvironmentSample { is_clipped, ..read }, place)
        });
        let mut all: Vec<_> = of_object.collect();
        let known = self.known;
        let num_points: usize = known.groups.iter().map(|group| group.points.len()).sum();
        let weight = KNOWN_SHARE * per_view as f32 / num_points.max(1) as f32;
        let mut groups = Vec::with_capacity(known.groups.len());
        for group in &known.groups {
            let of_group = group.points.par_iter().map(|p| {
                let dome = domes.of(p.view);
                let t = match group.sphere {
                    Some(k) => {
                        let EmittingSphere { center, radius, .. } = &self.surroundings.spheres[k];
                        let at = center.coords + p.normal * *radius;
                        let offset = 0.02 * radius;
                        transfer(self.surroundings, &at, &p.normal, dome, offset, Some(k))
                    }
                    None => Transfer::open(&p.normal, dome),
                };
                sample(&t, dome, p.intensity, weight)
            });
            let is_lit =
                |(s, _): &(EnvironmentSample, _)| s.intensity.iter().sum::<f32>() > MIN_INTENSITY;
            let of_group: Vec<_> = of_group.filter(is_lit).collect();
            groups.push(all.len()..all.len() + of_group.len());
            all.extend(of_group);
        }
        let (all, places) = all.into_iter().unzip();
        Samples {
            all,
            owners,
            groups,
            places,
        }
    }

    /// One over the distance of the light, in the world's unit; 0 where it may be endlessly far. A light that was
    /// given says nothing of it.
    pub fn nearness(&self, around: &BoundingSphere, domes: &dyn Fn(f32) -> Domes) -> f32 {
        let per_view = (DISTANCE_PIXELS / self.rays_at.views.len().max(1)).max(1);
        let known = self.known.of_spheres(DISTANCE_PIXELS);
        let lit = Lit {
            known: &known,
            ..*self
        };
        let far = domes(0.0);
        let spheres = self.surroundings.spheres.iter();
        let reaches = spheres.map(|sphere| far.offset(&sphere.center.coords) + sphere.radius);
        let reach = reaches.fold(far.offset(&around.center) + around.radius, f32::max);
        let evidence = |nearness: f32| {
            let domes = domes(nearness);
            let cast = |i: usize, p: usize| Cow::Owned(lit.transfer(&domes, i, p));
            let mut samples = lit.samples(&domes, per_view, cast);
            let cells = &domes.of(0).cells;
            let fit = fit_environment(&samples.all, cells, SMOOTHNESS)?;
            let ratios = samples.ratios(&fit);
            samples.divide_by(&ratios);
            let residuals = fit_environment(&samples.all, cells, SMOOTHNESS)?.residuals;
            let facts = samples.all.iter().zip(&samples.places).zip(residuals);
            // A bound that is met gains nothing and shows nothing.
            let facts = facts.filter(|((sample, _), _)| !sample.is_clipped);
            let facts = facts.map(|((sample, &place), residual)| Evidence {
                residual,
                weight: sample.weight,
                place,
            });
            Some(facts.collect())
        };
        light_distance::nearness(around.radius, reach, &evidence)
    }
}

impl Samples {
    /// Albedo of every group of the known light over the object's.
    pub fn ratios(&self, fit: &EnvironmentFit) -> Vec<[f32; 3]> {
        let groups = self.groups.iter();
        groups
            .map(|range| known_ratio(&self.all[range.clone()], fit))
            .collect()
    }

    /// The known light as of the object's paint.
    pub fn divide_by(&mut self, ratios: &[[f32; 3]]) {
        for (range, &ratio) in self.groups.iter().zip(ratios) {
            for sample in &mut self.all[range.clone()] {
                sample.intensity = without_pigment(sample.intensity, ratio);
            }
        }
    }
}

/// An unclipped sample, and where it lies.
fn sample(
    t: &Transfer,
    dome: &Dome,
    intensity: [f32; 3],
    weight: f32,
) -> (EnvironmentSample, Vector3<f32>) {
    let sample = EnvironmentSample {
        row: t.row(dome),
        nearby: t.nearby_intensity(),
        intensity,
        is_clipped: false,
        weight,
    };
    (sample, t.place)
}

/// A sphere's albedo over the object's, or a given light's over that of the photos: median ratio
/// between the points' intensities and those of the fitted light.
pub(crate) fn known_ratio(samples: &[EnvironmentSample], fit: &EnvironmentFit) -> [f32; 3] {
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
