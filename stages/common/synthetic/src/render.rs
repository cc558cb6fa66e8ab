//! Photographs of a scene by ray casting.
//!
//! Intensity of a surface point: `I = g ρ(x) E(x, n)` with exposure `g`, albedo ρ and the
//! irradiance over π of [`crate::bake`], or exactly `I = g ρ(x)/ρ̄ · l·h(n)` (eq. 1) under
//! [`LightModel::Harmonics`].
//!
//! Steps: a ray per pixel centre against mesh, sphere and mat; on the object Newton's method along
//! the ray from the mesh onto the implicit surface, whose gradient is the normal (depth and normal
//! are exact, not those of the mesh; a given mesh is the surface itself); pixels on edges again
//! with several rays; exposure and noise.

use crate::bake::{Bake, Deficit, Surroundings};
use crate::cameras::{intrinsics, place};
use crate::environment::{Environment, Rgb};
use crate::error::SyntheticError;
use crate::mat::Mat;
use crate::options::{LightModel, RenderOptions};
use crate::scene::Scene;
use crate::sensor;
use crate::shape::Shape;
use crate::view::RenderedView;
use nalgebra::{Point2, Point3, Vector3};
use rayon::prelude::*;
use rilievo_numerics::robust::quantile;
use rilievo_scene::{
    DepthMap, Intrinsics, Lighting, LinearImage, Mask, NormalMap, RigidTransform,
    SphericalHarmonics,
};

/// Linear value of the brightest surface: as bright as it gets without clipping, also when the
/// exposure drifts a little.
const WHITE: f64 = 0.82;
/// Newton steps along a ray.
const MAX_NUM_STEPS: usize = 6;
/// Distance from the surface, in heights, that ends them: below the rounding of an f32 depth.
const STEP_TOLERANCE: f64 = 1e-9;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Object,
    Sphere(usize),
    Ground,
    Air,
}

#[derive(Clone, Copy, Debug)]
struct Sample {
    color: Rgb,
    kind: Kind,
    depth: f64,
    normal_in_cam: Vector3<f64>,
}

/// An environment and what the scene hides of it.
#[derive(Debug)]
struct Lit {
    environment: Environment,
    bake: Bake,
}

impl Lit {
    fn new(scene: &Scene, environment: Environment, options: &RenderOptions) -> Self {
        let bake = if options.light == LightModel::Harmonics {
            Bake::default()
        } else {
            Bake::new(
                &Surroundings {
                    mesh: &scene.mesh,
                    bvh: &scene.bvh,
                    spheres: &scene.spheres,
                    environment: &environment,
                    albedo: Rgb::from(scene.options.albedo),
                    mat_reach: 1.8 * scene.options.height_m,
                    clearance: 0.2 * scene.options.mesh_spacing_m,
                    seed: scene.options.seed,
                },
                options.shadow_rays,
                options.light == LightModel::Bounce,
            )
        };
        Self { environment, bake }
    }
}

/// A scene that is lit and posed, ready to be photographed view by view.
#[derive(Debug)]
pub struct Renderer<'a> {
    scene: &'a Scene,
    options: RenderOptions,
    cameras: Vec<RigidTransform>,
    intrinsics: Intrinsics,
    /// One for all photos, or on a turntable one for each.
    lights: Vec<Lit>,
    exposure: f64,
}

impl<'a> Renderer<'a> {
    /// Places cameras, computes the light on all surfaces and fixes the exposure.
    ///
    /// # Errors
    /// Unusable options.
    pub fn new(scene: &'a Scene, options: &RenderOptions) -> Result<Self, SyntheticError> {
        options.validate()?;
        let cameras = place(scene, options);
        let lights = if options.turntable {
            let azimuth = |pose: &RigidTransform| {
                let center = pose.center_in_source();
                center.x.atan2(-center.y)
            };
            cameras
                .iter()
                .map(|pose| Lit::new(scene, scene.turned_light(azimuth(pose)), options))
                .collect()
        } else {
            vec![Lit::new(scene, scene.environment.clone(), options)]
        };
        let mut renderer = Self {
            scene,
            options: options.clone(),
            cameras,
            intrinsics: intrinsics(options),
            lights,
            exposure: 1.0,
        };
        renderer.exposure = WHITE / renderer.brightest();
        Ok(renderer)
    }

    /// Number of photos.
    pub fn num_views(&self) -> usize {
        self.options.num_views
    }

    /// Camera of photo `idx`.
    ///
    /// # Errors
    /// An index beyond the last photo.
    pub fn camera(&self, idx: usize) -> Result<(Intrinsics, RigidTransform), SyntheticError> {
        let pose = self.cameras.get(idx).ok_or(SyntheticError::NoSuchView {
            idx,
            num_views: self.cameras.len(),
        })?;
        Ok((self.intrinsics, *pose))
    }

    /// Light of photo `idx`.
    fn lit(&self, idx: usize) -> &Lit {
        &self.lights[idx.min(self.lights.len() - 1)]
    }

    /// Linear intensity of the brightest surface before exposure.
    fn brightest(&self) -> f64 {
        let scene = self.scene;
        let lit = self.lit(0);
        let paper = lit
            .environment
            .irradiance(&Point3::origin(), &Vector3::z())
            .component_mul(&Mat::paper())
            .max();
        let mut on_object: Vec<f64> = scene
            .mesh
            .normals
            .par_iter()
            .zip(&scene.mesh.vertices)
            .enumerate()
            .map(|(v, (n, at))| {
                let at = Point3::from(at.map(f64::from));
                let normal = Vector3::from(n.map(f64::from));
                let deficit = lit.bake.on_object([v as u32; 3], [0.0; 2]);
                (lit.environment.irradiance(&at, &normal) - deficit * normal)
                    .component_mul(&Rgb::from(scene.options.albedo))
                    .max()
            })
            .collect();
        // A few bright grains of the relief may clip, as they do in photographs.
        paper.max(quantile(&mut on_object, 0.999).unwrap_or(paper))
    }

    /// Takes photo `idx`.
    ///
    /// # Errors
    /// An index beyond the last photo.
    pub fn render(&self, idx: usize) -> Result<RenderedView, SyntheticError> {
        let (camera, pose) = self.camera(idx)?;
        let (width, height) = (camera.width, camera.height);
        let seed = self.scene.options.seed;
        let gain = sensor::exposure_gain(seed, idx, self.options.exposure_drift_ev);
        let rotation = pose.rotation.to_rotation_matrix();
        let scale = self.exposure * gain;
        let lighting = {
            let rows = self.lit(idx).environment.harmonics(&rotation);
            let albedo = self.scene.options.albedo;
            Lighting {
                channels: (0..3)
                    .map(|c| SphericalHarmonics(rows[c].0.map(|l| l * albedo[c] * scale)))
                    .collect(),
            }
        };
        let shot = Shot {
            renderer: self,
            lit: self.lit(idx),
            camera,
            pose,
            center: pose.center_in_source(),
            scale,
            lighting: &lighting,
        };
        let centers: Vec<Sample> = (0..height)
            .into_par_iter()
            .flat_map_iter(|y| {
                let shot = &shot;
                (0..width).map(move |x| shot.sample(x as f64, y as f64))
            })
            .collect();
        let mut image = LinearImage::filled(width, height, 3, 0.0);
        image
            .data
            .par_chunks_mut(3 * width)
            .enumerate()
            .for_each(|(y, row)| {
                for x in 0..width {
                    let color = if on_edge(&centers, width, height, x, y) {
                        shot.average(x, y)
                    } else {
                        centers[y * width + x].color
                    };
                    for c in 0..3 {
                        row[3 * x + c] = color[c] as f32;
                    }
                }
            });
        sensor::add_noise(&mut image, seed, idx, self.options.noise);
        let mask = |kind: Kind| Mask {
            width,
            height,
            data: centers.iter().map(|s| s.kind == kind).collect(),
        };
        let on_object = |s: &&Sample| s.kind == Kind::Object;
        let mut albedo = LinearImage::filled(width, height, 3, 0.0);
        let pixels = albedo.data.chunks_exact_mut(3).zip(&centers).enumerate();
        for (i, (pixel, sample)) in pixels.filter(|(_, (_, s))| on_object(s)) {
            let ray = camera.ray(&Point2::new((i % width) as f64, (i / width) as f64));
            let at = shot.center + pose.rotation.inverse() * ray * sample.depth;
            pixel.copy_from_slice(
                &<[f64; 3]>::from(self.scene.object_albedo(&at)).map(|a| a as f32),
            );
        }
        Ok(RenderedView {
            name: format!("IMG_{:04}", idx + 1),
            object_mask: mask(Kind::Object),
            sphere_masks: (0..self.scene.spheres.len())
                .map(|k| mask(Kind::Sphere(k)))
                .collect(),
            depth: DepthMap {
                width,
                height,
                data: centers
                    .iter()
                    .map(|s| Some(s).filter(on_object).map_or(0.0, |s| s.depth as f32))
                    .collect(),
            },
            normal: NormalMap {
                width,
                height,
                data: centers
                    .iter()
                    .map(|s| {
                        Some(s)
                            .filter(on_object)
                            .map_or([0.0; 3], |s| s.normal_in_cam.map(|c| c as f32).into())
                    })
                    .collect(),
            },
            image,
            albedo,
            intrinsics: camera,
            cam_from_world: pose,
            lighting,
            gain,
        })
    }
}

/// Whether a pixel differs from a neighbour in kind, or by more than a step in depth.
fn on_edge(samples: &[Sample], width: usize, height: usize, x: usize, y: usize) -> bool {
    let here = &samples[y * width + x];
    let differs = |x: usize, y: usize| {
        let there = &samples[y * width + x];
        there.kind != here.kind
            || (here.kind == Kind::Object && (there.depth / here.depth - 1.0).abs() > 4e-3)
    };
    (x > 0 && differs(x - 1, y))
        || (x + 1 < width && differs(x + 1, y))
        || (y > 0 && differs(x, y - 1))
        || (y + 1 < height && differs(x, y + 1))
}

/// Unit normal between those of a triangle's corners.
fn between(normals: [[f32; 3]; 3], [u, v]: [f64; 2]) -> Vector3<f64> {
    let [a, b, c] = normals.map(|n| Vector3::from(n.map(f64::from)));
    let sum = a * (1.0 - u - v) + b * u + c * v;
    sum.try_normalize(0.0).unwrap_or(a)
}

/// One camera at work.
struct Shot<'a> {
    renderer: &'a Renderer<'a>,
    lit: &'a Lit,
    camera: Intrinsics,
    pose: RigidTransform,
    center: Point3<f64>,
    /// From radiance to linear intensity.
    scale: f64,
    lighting: &'a Lighting,
}

impl Shot<'_> {
    /// Mean of a regular pattern of rays within a pixel.
    fn average(&self, x: usize, y: usize) -> Rgb {
        let n = self.renderer.options.edge_samples;
        let offset = |i: usize| (i as f64 + 0.5) / n as f64 - 0.5;
        let mut sum = Rgb::zeros();
        for j in 0..n {
            for i in 0..n {
                sum += self
                    .sample(x as f64 + offset(i), y as f64 + offset(j))
                    .color;
            }
        }
        sum / (n * n) as f64
    }

    fn sample(&self, x: f64, y: f64) -> Sample {
        let scene = self.renderer.scene;
        let ray_in_cam = self.camera.ray(&Point2::new(x, y));
        // With the ray scaled to z = 1, its parameter is the depth.
        let ray = self.pose.rotation.inverse() * ray_in_cam;
        let length = ray.norm();

        let object = scene
            .bvh
            .cast(
                self.center.coords.map(|c| c as f32).into(),
                ray.map(|c| c as f32).into(),
                1e-4,
                f32::INFINITY,
                false,
            )
            .map(|hit| (f64::from(hit.t), hit));
        let sphere = Scene::meet_sphere(&scene.spheres, &self.center, &(ray / length))
            .map(|(idx, t)| (t / length, idx));
        let ground = (ray.z < 0.0).then(|| -self.center.z / ray.z);
        let depth_of = |t: Option<f64>| t.unwrap_or(f64::INFINITY);
        let (t_object, t_sphere, t_ground) = (
            depth_of(object.map(|o| o.0)),
            depth_of(sphere.map(|s| s.0)),
            depth_of(ground),
        );
        if let Some((t, hit)) = object.filter(|_| t_object <= t_sphere && t_object <= t_ground) {
            let corners = scene.mesh.triangles[hit.triangle as usize];
            let uv = hit.uv.map(f64::from);
            let (depth, normal) = match &scene.shape {
                Some(shape) => {
                    let depth = self.onto_surface(shape, &ray, t);
                    let at = self.center + ray * depth;
                    (depth, shape.normal(&(at.coords / scene.options.height_m)))
                }
                None => (
                    t,
                    between(corners.map(|v| scene.mesh.normals[v as usize]), uv),
                ),
            };
            let at = self.center + ray * depth;
            let deficit = self.lit.bake.on_object(corners, uv);
            let albedo = scene.object_albedo(&at);
            let mut sample = self.lit(Kind::Object, depth, (&at, &normal), &albedo, &deficit);
            if scene.options.gloss > 0.0 {
                sample.color += self.reflection(&at, &(ray / length), &normal);
            }
            return sample;
        }
        if let Some((t, idx)) = sphere.filter(|_| t_sphere <= t_ground) {
            let at = self.center + ray * t;
            let s = &scene.spheres[idx];
            let normal = (at - Point3::from(s.center_in_world)) / s.radius;
            let deficit = self.lit.bake.on_sphere(idx, &normal);
            let albedo = Rgb::from(scene.options.albedo);
            return self.lit(Kind::Sphere(idx), t, (&at, &normal), &albedo, &deficit);
        }
        if let Some(t) = ground {
            let at = self.center + ray * t;
            let cosine = (-ray.z / length).max(0.05);
            let footprint = t * length / self.camera.focal_px() / cosine.sqrt();
            let albedo = scene.mat.albedo(at.x, at.y, footprint);
            let deficit = self.lit.bake.on_mat(at.x, at.y);
            return self.lit(Kind::Ground, t, (&at, &Vector3::z()), &albedo, &deficit);
        }
        Sample {
            color: self.lit.environment.radiance(&self.center, &(ray / length)) * self.scale,
            kind: Kind::Air,
            depth: 0.0,
            normal_in_cam: Vector3::zeros(),
        }
    }

    fn lit(
        &self,
        kind: Kind,
        depth: f64,
        (at, normal): (&Point3<f64>, &Vector3<f64>),
        albedo: &Rgb,
        deficit: &Deficit,
    ) -> Sample {
        let scene = self.renderer.scene;
        let normal_in_cam = self.pose.rotation * normal;
        let color = if self.renderer.options.light == LightModel::Harmonics {
            let mean = scene.options.albedo;
            Rgb::from_fn(|c, _| {
                albedo[c] / mean[c] * self.lighting.channels[c].evaluate(&normal_in_cam)
            })
        } else {
            let light = self.lit.environment.irradiance(at, normal) - deficit * normal;
            light.sup(&Rgb::zeros()).component_mul(albedo) * self.scale
        };
        Sample {
            color,
            kind,
            depth,
            normal_in_cam,
        }
    }

    /// What a smooth dielectric mirrors of the environment, by Schlick's approximation of Fresnel's
    /// term (Computer Graphics Forum 13, 1994); black where the object itself is mirrored.
    fn reflection(&self, at: &Point3<f64>, ray: &Vector3<f64>, normal: &Vector3<f64>) -> Rgb {
        const AT_NORMAL_INCIDENCE: f64 = 0.04;
        let scene = self.renderer.scene;
        let cosine = (-ray.dot(normal)).clamp(0.0, 1.0);
        let mirrored = ray - normal * (2.0 * ray.dot(normal));
        // Off the mesh, which the exact surface may lie under by an edge's sagitta.
        let clear = scene.options.mesh_spacing_m;
        let origin = at + normal * clear;
        let blocked = scene.bvh.cast(
            origin.coords.map(|c| c as f32).into(),
            mirrored.map(|c| c as f32).into(),
            clear as f32,
            f32::INFINITY,
            true,
        );
        if blocked.is_some() {
            return Rgb::zeros();
        }
        let share = AT_NORMAL_INCIDENCE + (1.0 - AT_NORMAL_INCIDENCE) * (1.0 - cosine).powi(5);
        self.lit.environment.radiance(at, &mirrored) * (scene.options.gloss * share * self.scale)
    }

    /// Moves a hit of the mesh along its ray onto the implicit surface.
    fn onto_surface(&self, shape: &Shape, ray: &Vector3<f64>, start: f64) -> f64 {
        let scene = self.renderer.scene;
        let to_heights = 1.0 / scene.options.height_m;
        let value = |t: f64| shape.value(&((self.center + ray * t).coords * to_heights));
        // The mesh lies within an edge's length of the surface, except where the ray grazes it.
        let reach = 2.0 * scene.options.mesh_spacing_m / ray.norm();
        let step = 1e-7 * start;
        let mut t = start;
        for _ in 0..MAX_NUM_STEPS {
            let f = value(t);
            if f.abs() < STEP_TOLERANCE {
                return t;
            }
            let slope = (value(t + step) - f) / step;
            let next = t - f / slope;
            if !next.is_finite() || (next - start).abs() > reach {
                return start;
            }
            t = next;
        }
        t
    }
}

/// Takes all photos.
///
/// # Errors
/// Unusable options.
pub fn render(scene: &Scene, options: &RenderOptions) -> Result<Vec<RenderedView>, SyntheticError> {
    let renderer = Renderer::new(scene, options)?;
    (0..renderer.num_views())
        .map(|i| renderer.render(i))
        .collect()
}
