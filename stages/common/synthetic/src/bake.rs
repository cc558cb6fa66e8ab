//! Shadows and bounced light, computed once for the resting scene.
//!
//! At a point `x` with normal `n` the light is `E(x, n) = E_env(n) − n·J(x)` with the deficit
//! `J = 1/π ∫_{hidden} (L_env(ω) − L_hit(ω)) ω dω` per channel: `E_env` is the irradiance without
//! any obstacle, and only the part of the hemisphere that something hides is sampled by rays, so
//! that their noise stays small. Being linear in `n`, `J` of a coarse point serves the fine relief
//! around it.
//!
//! Steps: `shadow_rays` directions, evenly spread over the hemisphere and turned anew at every
//! point; what they meet (object, sphere, mat); a first gathering in which hits are black; one
//! bounce in which they shine with their own first light; smoothing over neighbours.

use crate::environment::{Environment, Rgb};
use crate::mat::Mat;
use crate::noise::unit;
use crate::scene::{ReferenceSphere, Scene};
use nalgebra::{Matrix3, Point3, Rotation3, Vector3};
use rayon::prelude::*;
use rilievo_numerics::bvh::Bvh;
use rilievo_scene::Mesh;

/// The deficit of the three channels: `E = E_env − J n` with one row per channel.
pub(crate) type Deficit = Matrix3<f64>;

/// Rows and columns of the sphere's grid of latitudes and longitudes.
const SPHERE_ROWS: usize = 24;
const SPHERE_COLUMNS: usize = 48;
/// Points along each side of the mat's grid.
const MAT_SIDE: usize = 128;
/// Rounds of averaging with the neighbours: each halves the variance of the rays' noise again.
const SMOOTHING: usize = 2;

#[derive(Clone, Copy, Debug)]
enum Target {
    Object { triangle: u32 },
    Sphere { idx: usize, normal: Vector3<f64> },
    Mat { x: f64, y: f64 },
}

/// The directions from a point that meet something, and what.
type Hits = Vec<(Vector3<f64>, Target)>;

#[derive(Clone, Copy, Debug)]
struct Site {
    position: Point3<f64>,
    normal: Vector3<f64>,
}

/// What a bake needs to know of the scene.
pub(crate) struct Surroundings<'a> {
    pub mesh: &'a Mesh,
    pub bvh: &'a Bvh,
    pub spheres: &'a [ReferenceSphere],
    pub environment: &'a Environment,
    pub albedo: Rgb,
    /// Half the side of the square of the mat that may lie in shadow, metres.
    pub mat_reach: f64,
    /// Smallest distance that a ray must travel, metres.
    pub clearance: f64,
    pub seed: u64,
}

/// Deficits on all surfaces.
#[derive(Clone, Debug, Default)]
pub(crate) struct Bake {
    object: Vec<Deficit>,
    spheres: Vec<Vec<Deficit>>,
    mat: Vec<Deficit>,
    mat_reach: f64,
}

impl Bake {
    /// Casts the rays and gathers their light; without `bounce`, what hides the light is black.
    pub(crate) fn new(scene: &Surroundings<'_>, num_rays: usize, bounce: bool) -> Self {
        // Streams of random turns, 0 to 2 for object, first sphere and mat, then the other spheres.
        let mut groups = vec![(0_u32, object_sites(scene)), (2, mat_sites(scene))];
        let streams = std::iter::once(1).chain(3..);
        groups.extend(streams.zip(scene.spheres.iter().map(sphere_sites)));
        let hits: Vec<Vec<Hits>> = groups
            .iter()
            .map(|&(group, ref sites)| {
                sites
                    .par_iter()
                    .enumerate()
                    .map(|(i, site)| trace(scene, site, [group, i as u32], num_rays))
                    .collect()
            })
            .collect();
        let gather = |shine: &(dyn Fn(&Target) -> Rgb + Sync)| {
            let sites = groups.iter().map(|(_, sites)| sites);
            let mut parts = sites.zip(&hits).map(|group| {
                group
                    .1
                    .par_iter()
                    .zip(group.0)
                    .map(|(hits, site)| deficit(scene.environment, (site, hits), num_rays, shine))
                    .collect::<Vec<_>>()
            });
            let mut next = || parts.next().unwrap_or_default();
            let mut bake = Self {
                object: next(),
                mat: next(),
                spheres: scene.spheres.iter().map(|_| next()).collect(),
                mat_reach: scene.mat_reach,
            };
            bake.smooth(scene.mesh);
            bake
        };
        // The mat itself shines in the first round too: without that every surface near it would
        // lose the light from below that `E_env` promises.
        let mat_albedo = Mat::mean_albedo();
        let unshadowed = |x: f64, y: f64| {
            let at = Point3::new(x, y, 0.0);
            scene.environment.irradiance(&at, &Vector3::z())
        };
        let first = gather(&|target| match target {
            Target::Mat { x, y } => unshadowed(*x, *y).component_mul(&mat_albedo),
            _ => Rgb::zeros(),
        });
        if !bounce {
            return first;
        }
        let of_triangle: Vec<Rgb> = scene
            .mesh
            .triangles
            .par_iter()
            .map(|&[a, b, c]| {
                let normal = [a, b, c]
                    .map(|v| Vector3::from(scene.mesh.normals[v as usize].map(f64::from)))
                    .iter()
                    .sum::<Vector3<f64>>()
                    .normalize();
                let shadow = first.on_object([a, b, c], [1.0 / 3.0; 2]);
                let at = Point3::from(scene.mesh.vertices[a as usize].map(f64::from));
                (scene.environment.irradiance(&at, &normal) - shadow * normal)
                    .component_mul(&scene.albedo)
                    .sup(&Rgb::zeros())
            })
            .collect();
        gather(&|target| match target {
            Target::Mat { x, y } => (unshadowed(*x, *y) - first.on_mat(*x, *y) * Vector3::z())
                .component_mul(&mat_albedo)
                .sup(&Rgb::zeros()),
            Target::Sphere { idx, normal } => {
                let sphere = &scene.spheres[*idx];
                let at = Point3::from(sphere.center_in_world) + normal * sphere.radius;
                (scene.environment.irradiance(&at, normal) - first.on_sphere(*idx, normal) * normal)
                    .component_mul(&scene.albedo)
                    .sup(&Rgb::zeros())
            }
            Target::Object { triangle } => of_triangle[*triangle as usize],
        })
    }

    /// Deficit on a triangle, `uv` the weights of its second and third vertex; zero without a bake.
    pub(crate) fn on_object(&self, vertices: [u32; 3], uv: [f64; 2]) -> Deficit {
        if self.object.is_empty() {
            return Deficit::zeros();
        }
        let [a, b, c] = vertices.map(|v| self.object[v as usize]);
        a * (1.0 - uv[0] - uv[1]) + b * uv[0] + c * uv[1]
    }

    /// Deficit on a sphere where its outward normal is `normal`; zero without a bake.
    pub(crate) fn on_sphere(&self, idx: usize, normal: &Vector3<f64>) -> Deficit {
        let Some(sphere) = self.spheres.get(idx) else {
            return Deficit::zeros();
        };
        let row = (normal.z.clamp(-1.0, 1.0).acos() / std::f64::consts::PI
            * (SPHERE_ROWS - 1) as f64)
            .min((SPHERE_ROWS - 1) as f64 - 1e-9);
        let turn = normal.y.atan2(normal.x) / std::f64::consts::TAU;
        let column = (turn - turn.floor()) * SPHERE_COLUMNS as f64;
        let (r, c) = (row as usize, column as usize % SPHERE_COLUMNS);
        let (fr, fc) = (row - r as f64, column - column.floor());
        let at = |r: usize, c: usize| sphere[r * SPHERE_COLUMNS + c % SPHERE_COLUMNS];
        (at(r, c) * (1.0 - fc) + at(r, c + 1) * fc) * (1.0 - fr)
            + (at(r + 1, c) * (1.0 - fc) + at(r + 1, c + 1) * fc) * fr
    }

    /// Deficit on the mat; zero beyond its reach.
    pub(crate) fn on_mat(&self, x: f64, y: f64) -> Deficit {
        let scaled = |c: f64| 0.5 * (c / self.mat_reach + 1.0) * (MAT_SIDE - 1) as f64;
        let (u, v) = (scaled(x), scaled(y));
        let limit = (MAT_SIDE - 1) as f64;
        if self.mat.is_empty() || !(0.0..limit).contains(&u) || !(0.0..limit).contains(&v) {
            return Deficit::zeros();
        }
        let (i, j) = (u as usize, v as usize);
        let (fu, fv) = (u - i as f64, v - j as f64);
        let at = |i: usize, j: usize| self.mat[j * MAT_SIDE + i];
        (at(i, j) * (1.0 - fu) + at(i + 1, j) * fu) * (1.0 - fv)
            + (at(i, j + 1) * (1.0 - fu) + at(i + 1, j + 1) * fu) * fv
    }

    fn smooth(&mut self, mesh: &Mesh) {
        for _ in 0..SMOOTHING {
            let mut sums = self.object.clone();
            let mut weights = vec![1.0; sums.len()];
            for triangle in &mesh.triangles {
                for k in 0..3 {
                    let (a, b) = (triangle[k] as usize, triangle[(k + 1) % 3] as usize);
                    // Every edge is met from both of its triangles.
                    sums[a] += self.object[b];
                    weights[a] += 1.0;
                }
            }
            for ((value, sum), weight) in self.object.iter_mut().zip(sums).zip(weights) {
                *value = sum / weight;
            }
            for sphere in &mut self.spheres {
                *sphere = blur(sphere, SPHERE_COLUMNS, true);
            }
            self.mat = blur(&self.mat, MAT_SIDE, false);
        }
    }
}

/// Weighted mean (1 2 1 both ways) over a grid, the columns closed to a ring where asked.
fn blur(grid: &[Deficit], columns: usize, ring: bool) -> Vec<Deficit> {
    let rows = grid.len() / columns.max(1);
    (0..grid.len())
        .map(|i| {
            let (r, c) = ((i / columns) as isize, (i % columns) as isize);
            let (mut sum, mut weight) = (Deficit::zeros(), 0.0);
            for dr in -1_isize..=1 {
                for dc in -1_isize..=1 {
                    let row = r + dr;
                    let column = if ring {
                        (c + dc).rem_euclid(columns as isize)
                    } else {
                        c + dc
                    };
                    if row >= 0 && row < rows as isize && column >= 0 && column < columns as isize {
                        let w = f64::from(((2 - dr.abs()) * (2 - dc.abs())) as i32);
                        sum += grid[row as usize * columns + column as usize] * w;
                        weight += w;
                    }
                }
            }
            sum / weight
        })
        .collect()
}

fn object_sites(scene: &Surroundings<'_>) -> Vec<Site> {
    scene
        .mesh
        .vertices
        .iter()
        .zip(&scene.mesh.normals)
        .map(|(p, n)| Site {
            position: Point3::from(p.map(f64::from)),
            normal: Vector3::from(n.map(f64::from)),
        })
        .collect()
}

fn sphere_sites(sphere: &ReferenceSphere) -> Vec<Site> {
    (0..SPHERE_ROWS * SPHERE_COLUMNS)
        .map(|i| {
            let polar =
                std::f64::consts::PI * (i / SPHERE_COLUMNS) as f64 / (SPHERE_ROWS - 1) as f64;
            let azimuth =
                std::f64::consts::TAU * (i % SPHERE_COLUMNS) as f64 / SPHERE_COLUMNS as f64;
            let normal = Vector3::new(
                polar.sin() * azimuth.cos(),
                polar.sin() * azimuth.sin(),
                polar.cos(),
            );
            Site {
                position: Point3::from(sphere.center_in_world) + normal * sphere.radius,
                normal,
            }
        })
        .collect()
}

fn mat_sites(scene: &Surroundings<'_>) -> Vec<Site> {
    let coordinate = |i: usize| scene.mat_reach * (2.0 * i as f64 / (MAT_SIDE - 1) as f64 - 1.0);
    (0..MAT_SIDE * MAT_SIDE)
        .map(|i| Site {
            position: Point3::new(coordinate(i % MAT_SIDE), coordinate(i / MAT_SIDE), 0.0),
            normal: Vector3::z(),
        })
        .collect()
}

/// The directions from a site that meet something, and what.
fn trace(scene: &Surroundings<'_>, site: &Site, item: [u32; 2], num_rays: usize) -> Hits {
    let turn = std::f64::consts::TAU * unit([scene.seed as u32, item[0], item[1], 1]);
    let jitter = unit([scene.seed as u32, item[0], item[1], 2]);
    let frame = Rotation3::rotation_between(&Vector3::z(), &site.normal)
        .unwrap_or_else(|| Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
    let origin = site.position + site.normal * scene.clearance;
    let mut hits = Vec::new();
    for k in 0..num_rays {
        const GOLDEN_ANGLE: f64 = 2.399_963_229_728_653;
        let z = 1.0 - (k as f64 + jitter) / num_rays as f64;
        let r = (1.0 - z * z).max(0.0).sqrt();
        let angle = turn + GOLDEN_ANGLE * k as f64;
        let direction = frame * Vector3::new(r * angle.cos(), r * angle.sin(), z);
        if let Some(target) = first_target(scene, &origin, &direction) {
            hits.push((direction, target));
        }
    }
    hits
}

fn first_target(
    scene: &Surroundings<'_>,
    origin: &Point3<f64>,
    direction: &Vector3<f64>,
) -> Option<Target> {
    let object = scene.bvh.cast(
        origin.coords.map(|c| c as f32).into(),
        direction.map(|c| c as f32).into(),
        scene.clearance as f32,
        f32::INFINITY,
        false,
    );
    let sphere =
        Scene::meet_sphere(scene.spheres, origin, direction).filter(|(_, t)| *t > scene.clearance);
    let object_t = object.map_or(f64::INFINITY, |h| f64::from(h.t));
    if let Some((idx, t)) = sphere.filter(|(_, t)| *t < object_t) {
        let s = &scene.spheres[idx];
        let normal = (origin + direction * t - Point3::from(s.center_in_world)) / s.radius;
        return Some(Target::Sphere { idx, normal });
    }
    if let Some(hit) = object {
        return Some(Target::Object {
            triangle: hit.triangle,
        });
    }
    if direction.z < 0.0 {
        let at = origin - direction * (origin.z / direction.z);
        // Beyond its reach the mat shines as the environment says.
        if at.x.abs() < scene.mat_reach && at.y.abs() < scene.mat_reach {
            return Some(Target::Mat { x: at.x, y: at.y });
        }
    }
    None
}

fn deficit(
    environment: &Environment,
    (site, hits): (&Site, &Hits),
    num_rays: usize,
    shine: &(dyn Fn(&Target) -> Rgb + Sync),
) -> Deficit {
    // Each of the rays stands for 2π / num_rays, and irradiance is kept divided by π.
    let weight = 2.0 / num_rays as f64;
    hits.iter()
        .map(|(direction, target)| {
            (environment.radiance(&site.position, direction) - shine(target))
                * direction.transpose()
                * weight
        })
        .sum()
}
