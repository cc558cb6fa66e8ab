//! What arrives at a point: a set of cells of the environment that it sees, and a polynomial of its
//! normal for what it meets instead.

use super::dome::Dome;
use super::surroundings::Surroundings;
use nalgebra::Vector3;
use rilievo_scene::SphericalHarmonics;
use serde::{Deserialize, Serialize};

/// Half-width of the smooth horizon: the sine of about 17°. Wider blurs the terminator, narrower
/// leaves the polynomial wrong for normals that move.
pub const HORIZON: f64 = 0.3;

/// Smallest sine of a ray's elevation over the surface: rays below are lifted to it.
const LIFT: f32 = 0.05;

/// The transfer of one point.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Transfer {
    /// The point, world.
    pub place: Vector3<f32>,
    /// Bit `k` is set where the way to cell `k` is free.
    pub visible: Vec<u64>,
    /// Normal for which the horizon was taken, world frame.
    pub normal: Vector3<f32>,
    /// Nine harmonics (world frame) per channel of what the surroundings send.
    pub nearby: [[f32; 9]; 3],
}

/// Coefficients `(c0, c1, c2)` of `max(0, x) ≈ c0 + c1 x + c2 x²` around elevation `x`.
#[inline]
fn horizon(x: f32) -> Option<[f32; 3]> {
    let h = HORIZON as f32;
    if x >= h {
        Some([0.0, 1.0, 0.0])
    } else if x > -h {
        Some([3.0 * h / 32.0, 0.5, 15.0 / (32.0 * h)])
    } else {
        None
    }
}

/// Adds `scale (c0 + c1 n·d + c2 (n·d)²)` to harmonics of `n`.
///
/// `(n·d)²` in the basis of eq. 1, with `n1² + n2² + n3² = 1`: `n3² = (1 + b₈)/3`,
/// `n1² + n2² = 1 − n3²`, `n1² − n2² = b₇`.
#[inline]
fn add(harmonics: &mut [f32; 9], d: &Vector3<f32>, c: [f32; 3], scale: f32) {
    let s1 = scale * c[1];
    harmonics[0] += s1 * d.x;
    harmonics[1] += s1 * d.y;
    harmonics[2] += s1 * d.z;
    harmonics[3] += scale * c[0];
    if c[2] != 0.0 {
        let s2 = scale * c[2];
        let (xx, yy, zz) = (d.x * d.x, d.y * d.y, d.z * d.z);
        let mean = 0.5 * (xx + yy);
        harmonics[3] += s2 * (mean + (zz - mean) / 3.0);
        harmonics[4] += 2.0 * s2 * d.x * d.y;
        harmonics[5] += 2.0 * s2 * d.x * d.z;
        harmonics[6] += 2.0 * s2 * d.y * d.z;
        harmonics[7] += 0.5 * s2 * (xx - yy);
        harmonics[8] += s2 * (zz - mean) / 3.0;
    }
}

/// Casts rays from a point towards all cells of a dome. `offset` lifts the start off the surface
/// (world's unit); `from_sphere` is the sphere on which the point lies.
pub fn transfer(
    surroundings: &Surroundings,
    point: &Vector3<f32>,
    normal: &Vector3<f32>,
    dome: &Dome,
    offset: f32,
    from_sphere: Option<usize>,
) -> Transfer {
    let scale = 4.0 / dome.cells.len() as f32;
    let start = point + normal * offset;
    let mut out = Transfer {
        place: *point,
        visible: vec![0; dome.cells.len().div_ceil(64)],
        normal: *normal,
        nearby: [[0.0; 9]; 3],
    };
    for (k, ray) in dome.rays_from(point).enumerate() {
        let d = ray.direction;
        let x = normal.dot(&d);
        let Some(c) = horizon(x) else { continue };
        let lifted = if x < LIFT {
            (d + normal * (LIFT - x)).normalize()
        } else {
            d
        };
        let scale = scale * ray.weight;
        match surroundings.cast(&start, &lifted, from_sphere) {
            Some(radiance) => {
                for (harmonics, value) in out.nearby.iter_mut().zip(radiance) {
                    add(harmonics, &d, c, scale * value);
                }
            }
            None => out.visible[k / 64] |= 1 << (k % 64),
        }
    }
    out
}

impl Transfer {
    /// Of a point in the centre that sees the whole environment over its horizon, and nothing else.
    pub fn open(normal: &Vector3<f32>, dome: &Dome) -> Self {
        Self {
            place: dome.center,
            visible: vec![u64::MAX; dome.cells.len().div_ceil(64)],
            normal: *normal,
            nearby: [[0.0; 9]; 3],
        }
    }

    /// Harmonics (world frame) of everything that arrives: `environment` holds a radiance per
    /// cell of the dome that rays were cast to, `bounce` scales what the surroundings send.
    pub fn harmonics(
        &self,
        dome: &Dome,
        environment: &[[f32; 3]],
        bounce: [f32; 3],
    ) -> [[f32; 9]; 3] {
        let scale = 4.0 / dome.cells.len() as f32;
        let mut out = self.nearby;
        for (harmonics, b) in out.iter_mut().zip(bounce) {
            harmonics.iter_mut().for_each(|v| *v *= b);
        }
        for (k, ray) in dome.rays_from(&self.place).enumerate() {
            if self.visible[k / 64] & (1 << (k % 64)) == 0 {
                continue;
            }
            if let Some(c) = horizon(self.normal.dot(&ray.direction)) {
                for (harmonics, &l) in out.iter_mut().zip(&environment[k]) {
                    add(harmonics, &ray.direction, c, scale * ray.weight * l);
                }
            }
        }
        out
    }

    /// Weight of every cell in the point's intensity at its normal.
    pub fn row(&self, dome: &Dome) -> Vec<f32> {
        let scale = 4.0 / dome.cells.len() as f32;
        dome.rays_from(&self.place)
            .enumerate()
            .map(|(k, ray)| {
                let x = self.normal.dot(&ray.direction);
                match horizon(x) {
                    Some(c) if self.visible[k / 64] & (1 << (k % 64)) != 0 => {
                        scale * ray.weight * (c[0] + x * (c[1] + x * c[2]))
                    }
                    _ => 0.0,
                }
            })
            .collect()
    }

    /// What the surroundings send at the point's normal.
    pub fn nearby_intensity(&self) -> [f32; 3] {
        let h = SphericalHarmonics::basis(&self.normal);
        self.nearby
            .map(|l| l.iter().zip(&h).map(|(a, b)| a * b).sum())
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::super::{DepthView, EmittingSphere, Volume, directions};
    use super::*;

    #[test]
    fn harmonics_are_the_sum_over_the_rays() {
        let rays = Dome::far(directions(128));
        let normal = Vector3::new(0.2, -0.3, -0.9).normalize();
        let mut seen = Transfer {
            place: Vector3::zeros(),
            visible: vec![0; 2],
            normal,
            nearby: [[0.0; 9]; 3],
        };
        let environment: Vec<[f32; 3]> = (0..128)
            .map(|k| [0.5 + (k % 7) as f32 * 0.1, 1.0, 0.2 * (k % 3) as f32])
            .collect();
        // Every other ray leads out, the others bring a constant from the surroundings.
        for (k, d) in rays.cells.iter().enumerate() {
            if let Some(c) = horizon(normal.dot(d)) {
                if k % 2 == 0 {
                    seen.visible[k / 64] |= 1 << (k % 64);
                } else {
                    for harmonics in &mut seen.nearby {
                        add(harmonics, d, c, 4.0 / 128.0 * 0.3);
                    }
                }
            }
        }
        let light = seen.harmonics(&rays, &environment, [1.0, 0.5, 2.0]);
        // A normal 4° away from the one for which the horizon was taken.
        let moved = (normal + Vector3::new(0.05, 0.03, 0.02)).normalize();
        let h = SphericalHarmonics::basis(&moved.map(f64::from));
        for channel in 0..3 {
            let bounce = [1.0, 0.5, 2.0][channel];
            let expected: f32 = rays
                .cells
                .iter()
                .enumerate()
                .filter_map(|(k, d)| {
                    let c = horizon(normal.dot(d))?;
                    let x = moved.dot(d);
                    let radiance = if k % 2 == 0 {
                        environment[k][channel]
                    } else {
                        0.3 * bounce
                    };
                    Some(4.0 / 128.0 * radiance * (c[0] + x * (c[1] + x * c[2])))
                })
                .sum();
            let value: f64 = light[channel]
                .iter()
                .zip(&h)
                .map(|(l, b)| f64::from(*l) * b)
                .sum();
            assert!(
                (value - f64::from(expected)).abs() < 1e-5,
                "channel {channel}: {value} against {expected}"
            );
        }
    }

    /// A plate of two by two at z = 2 that looks to −z, and a luminous sphere before it.
    fn plate_and_sphere() -> Surroundings {
        let view = DepthView {
            intrinsics: rilievo_scene::Intrinsics::pinhole(16, 16, 16.0, 7.5, 7.5),
            cam_from_world: rilievo_scene::RigidTransform {
                rotation: nalgebra::UnitQuaternion::identity(),
                translation: Vector3::zeros(),
            },
            depth: rilievo_scene::Raster::filled(16, 16, 2.0),
            weight: rilievo_scene::Raster::filled(16, 16, 1.0),
            image: rilievo_scene::LinearImage::filled(16, 16, 3, 0.3),
            cut_by_frame: false,
        };
        let mut glow = SphericalHarmonics::default();
        glow.0[3] = 0.4;
        Surroundings {
            volume: Volume::carve(&[view], 32).unwrap(),
            spheres: vec![EmittingSphere {
                center: nalgebra::Point3::new(0.5, 0.0, 1.4),
                radius: 0.3,
                radiance: rilievo_scene::Lighting {
                    channels: vec![glow; 3],
                },
            }],
            ground: None,
        }
    }

    #[test]
    fn harmonics_agree_with_a_dense_sum_of_rays() {
        let surroundings = plate_and_sphere();
        let sky = |d: &Vector3<f32>| 0.5 + 0.4 * d.x - 0.3 * d.z;
        let (point, normal) = (Vector3::new(0.05, 0.0, 2.0), Vector3::new(0.0, 0.0, -1.0));
        let offset = 0.1;
        let rays = Dome::far(directions(512));
        let environment: Vec<[f32; 3]> = rays.cells.iter().map(|d| [sky(d); 3]).collect();
        let seen = transfer(&surroundings, &point, &normal, &rays, offset, None);
        let light = seen.harmonics(&rays, &environment, [1.0; 3])[1];
        let dense = directions(20_000);
        for moved in [normal, Vector3::new(0.08, -0.05, -1.0).normalize()] {
            let expected: f32 = dense
                .iter()
                .filter(|d| moved.dot(d) > 0.0)
                .map(|d| {
                    let start = point + normal * offset;
                    let radiance = surroundings.cast(&start, d, None);
                    let l = radiance.map_or(sky(d), |rgb| rgb[1]);
                    4.0 / dense.len() as f32 * l * moved.dot(d)
                })
                .sum();
            let h = SphericalHarmonics::basis(&moved.map(f64::from));
            let value: f64 = light.iter().zip(&h).map(|(l, b)| f64::from(*l) * b).sum();
            let error = (value / f64::from(expected) - 1.0).abs();
            assert!(error < 0.03, "{value} against {expected} at {moved:?}");
        }
    }

    /// The scene of [`plate_and_sphere`] by its equations: first what a ray meets of the sphere, then
    /// the plate z = 2 within the frame of its camera.
    fn radiance_by_equations(start: &Vector3<f32>, d: &Vector3<f32>, sky: f32) -> f32 {
        let offset = start - Vector3::new(0.5, 0.0, 1.4);
        let b = offset.dot(d);
        let discriminant = b * b - (offset.norm_squared() - 0.3 * 0.3);
        if discriminant > 0.0 && -b - discriminant.sqrt() > 0.0 {
            return 0.4;
        }
        let t = (2.0 - start.z) / d.z;
        let meets = start + d * t;
        if d.z > 0.0 && t > 0.0 && meets.x.abs() < 1.0 && meets.y.abs() < 1.0 {
            return 0.3;
        }
        sky
    }

    #[test]
    fn every_points_harmonics_agree_with_sums_over_rays_by_equations() {
        let surroundings = plate_and_sphere();
        let sky = |d: &Vector3<f32>| 0.5 + 0.4 * d.x - 0.3 * d.z;
        let rays = Dome::far(directions(512));
        let environment: Vec<[f32; 3]> = rays.cells.iter().map(|d| [sky(d); 3]).collect();
        let dense = directions(4_000);
        let facing = Vector3::new(0.0, 0.0, -1.0);
        let (mut worst, mut sum, mut count) = (0.0_f64, 0.0, 0.0);
        for i in 0..13 {
            for j in 0..7 {
                let point = Vector3::new(0.1 * i as f32 - 0.6, 0.1 * j as f32 - 0.3, 2.0);
                let offset = surroundings.volume.start_height(&point, &facing);
                let seen = transfer(&surroundings, &point, &facing, &rays, offset, None);
                let light = seen.harmonics(&rays, &environment, [1.0; 3])[1];
                for normal in [facing, Vector3::new(0.12, -0.08, -1.0).normalize()] {
                    let expected: f64 = dense
                        .iter()
                        .filter(|d| normal.dot(d) > 0.0)
                        .map(|d| {
                            let start = point + facing * 1e-3;
                            let l = radiance_by_equations(&start, d, sky(d));
                            f64::from(4.0 / dense.len() as f32 * l * normal.dot(d))
                        })
                        .sum();
                    let h = SphericalHarmonics::basis(&normal.map(f64::from));
                    let value: f64 = light.iter().zip(&h).map(|(l, b)| f64::from(*l) * b).sum();
                    let error = (value / expected - 1.0).abs();
                    worst = worst.max(error);
                    sum += error;
                    count += 1.0;
                }
            }
        }
        // 512 rays resolve a sphere's disc to some of its area, the horizon is smooth by design.
        let mean = sum / count;
        println!("harmonics against dense rays: mean {mean:.4}, worst {worst:.4}");
        assert!(mean < 0.01 && worst < 0.04, "mean {mean}, worst {worst}");
    }

    #[test]
    fn a_start_is_low_on_a_plate_and_lifted_out_of_the_solid() {
        let volume = plate_and_sphere().volume;
        let facing = Vector3::new(0.0, 0.0, -1.0);
        let on = volume.start_height(&Vector3::new(0.0, 0.0, 2.0), &facing) / volume.voxel;
        assert!((0.5..=0.75).contains(&on), "{on} voxels over the plate");
        let below = Vector3::new(0.0, 0.0, 2.0 + volume.voxel);
        let lifted = volume.start_height(&below, &facing) / volume.voxel;
        assert!(
            (1.25..=1.75).contains(&lifted),
            "{lifted} voxels from one voxel below"
        );
        let outside = Vector3::new(0.0, 0.0, -50.0);
        let free = volume.start_height(&outside, &facing) / volume.voxel;
        assert!((free - 0.5).abs() < 1e-6, "{free} voxels in the open");
    }

    #[test]
    fn an_open_sky_of_one_radiance_is_one() {
        let rays = Dome::far(directions(512));
        let normal = Vector3::new(0.0_f32, 0.6, -0.8);
        let mut seen = Transfer {
            place: Vector3::zeros(),
            visible: vec![0; 8],
            normal,
            nearby: [[0.0; 9]; 3],
        };
        for (k, d) in rays.cells.iter().enumerate() {
            if normal.dot(d) > -(HORIZON as f32) {
                seen.visible[k / 64] |= 1 << (k % 64);
            }
        }
        let sum: f32 = seen.row(&rays).iter().sum();
        // The smooth horizon adds a little light beyond the sharp one.
        assert!((sum - 1.0).abs() < 0.02, "{sum}");
    }
}
