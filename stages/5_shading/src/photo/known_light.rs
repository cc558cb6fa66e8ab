//! What stage 4 knows of the light, exposures divided out.

use nalgebra::{Point3, Vector3};
use rilievo_photometry::harmonics::fit_robust;
use rilievo_photometry::visibility::EmittingSphere;
use rilievo_scene::{LightKind, LightSample, Lighting, LightingCalibration, LocatedSphere};

/// A point with a known normal and the intensity that a photo shows of it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct KnownPoint {
    /// Unit, world frame.
    pub normal: Vector3<f32>,
    pub intensity: [f32; 3],
    /// The view in whose light it was seen.
    pub view: usize,
}

/// Points of one paint: of one sphere, or in the open.
#[derive(Clone, Debug)]
pub(crate) struct KnownGroup {
    /// Index into [`KnownLight::spheres`]; `None` in the open, where nothing hides the environment.
    pub sphere: Option<usize>,
    pub points: Vec<KnownPoint>,
}

/// The samples of the light, and the spheres, which hide and send light.
#[derive(Clone, Debug)]
pub(crate) struct KnownLight {
    pub kind: LightKind,
    pub spheres: Vec<EmittingSphere>,
    /// Of the spheres that see the object's light; what was given comes last.
    pub groups: Vec<KnownGroup>,
}

impl KnownLight {
    /// What spheres say alone, thinned to about `most` points.
    pub fn of_spheres(&self, most: usize) -> Self {
        let groups = self.groups.iter().filter(|group| group.sphere.is_some());
        let count: usize = groups.clone().map(|group| group.points.len()).sum();
        let thinned = |group: &KnownGroup| KnownGroup {
            sphere: group.sphere,
            points: group
                .points
                .iter()
                .step_by(count.div_ceil(most).max(1))
                .copied()
                .collect(),
        };
        Self {
            kind: self.kind,
            spheres: self.spheres.clone(),
            groups: groups.map(thinned).collect(),
        }
    }

    /// From stage 4's samples; `gains` are the exposures of the views. A sphere of which nothing is
    /// known is left out, and hides nothing; one that sees another light than the object gives no
    /// samples.
    pub fn new(
        lighting: &LightingCalibration,
        spheres: &[LocatedSphere],
        gains: &[[f64; 3]],
    ) -> Self {
        let rejected = lighting.rejected_spheres();
        let mut known = Self {
            kind: lighting.kind,
            spheres: Vec::new(),
            groups: Vec::new(),
        };
        let points_of = |sphere: Option<usize>| -> Vec<KnownPoint> {
            let samples = lighting.samples.iter().filter(|s| s.sphere == sphere);
            samples.map(|sample| point(sample, gains)).collect()
        };
        for (k, sphere) in spheres.iter().enumerate() {
            let points = points_of(Some(k));
            let Some(seen) = emitting(sphere, &points) else {
                continue;
            };
            if !rejected.contains(&k) {
                known.groups.push(KnownGroup {
                    sphere: Some(known.spheres.len()),
                    points,
                });
            }
            known.spheres.push(seen);
        }
        let points = points_of(None);
        if !points.is_empty() {
            known.groups.push(KnownGroup {
                sphere: None,
                points,
            });
        }
        known
    }
}

fn point(sample: &LightSample, gains: &[[f64; 3]]) -> KnownPoint {
    let view = sample.view.0;
    KnownPoint {
        normal: Vector3::from(sample.normal_in_world),
        intensity: std::array::from_fn(|c| {
            let gain = if sample.has_gain { gains[view][c] } else { 1.0 };
            sample.intensity[c] / gain as f32
        }),
        view,
    }
}

/// A sphere that sends what the photos show of it.
fn emitting(sphere: &LocatedSphere, points: &[KnownPoint]) -> Option<EmittingSphere> {
    let normals: Vec<Vector3<f64>> = points
        .iter()
        .map(|p| p.normal.map(f64::from).normalize())
        .collect();
    let mut channels = Vec::new();
    for c in 0..3 {
        let values: Vec<f64> = points.iter().map(|p| f64::from(p.intensity[c])).collect();
        let fit = fit_robust(&normals, &values, None).ok()?;
        channels.push(fit.coefficients);
    }
    Some(EmittingSphere {
        center: Point3::from(sphere.center_in_world.map(|c| c as f32)),
        radius: sphere.radius as f32,
        radiance: Lighting { channels },
    })
}
