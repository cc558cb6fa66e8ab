//! What rays can meet: the carved solid, the reference spheres, the ground.

use super::volume::Volume;
use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

/// A reference sphere with the radiance of its surface, as nine harmonics per channel of the world
/// normal (a matte sphere under a distant light).
#[derive(Clone, Debug)]
pub struct EmittingSphere {
    /// Centre, world.
    pub center: Point3<f32>,
    /// Radius, world's unit.
    pub radius: f32,
    /// Radiance over world normals.
    pub radiance: rilievo_scene::Lighting,
}

/// A plane with a texture of radiances.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Ground {
    /// Texture origin: its corner.
    pub corner: Point3<f32>,
    /// Unit axis along columns.
    pub along: Vector3<f32>,
    /// Unit axis along rows.
    pub across: Vector3<f32>,
    /// Unit normal towards the object.
    pub normal: Vector3<f32>,
    /// Edge of a texel.
    pub texel: f32,
    /// Columns and rows.
    pub size: [usize; 2],
    /// Radiance, `None` where no view sees the ground.
    pub texture: Vec<Option<[f32; 3]>>,
}

impl Ground {
    /// Radiance where a ray meets the textured part.
    pub fn cast(&self, start: &Vector3<f32>, direction: &Vector3<f32>) -> Option<[f32; 3]> {
        let slope = direction.dot(&self.normal);
        // Rays within half a degree of the plane meet it beyond any texture.
        if slope > -0.01 {
            return None;
        }
        let height = (start - self.corner.coords).dot(&self.normal);
        let t = height.max(0.0) / -slope;
        let offset = start + direction * t - self.corner.coords;
        let (u, v) = (
            offset.dot(&self.along) / self.texel,
            offset.dot(&self.across) / self.texel,
        );
        if !(u >= 0.0 && v >= 0.0 && u < self.size[0] as f32 && v < self.size[1] as f32) {
            return None;
        }
        self.texture[v as usize * self.size[0] + u as usize]
    }
}

/// Everything near the object.
#[derive(Clone, Debug)]
pub struct Surroundings {
    /// The object.
    pub volume: Volume,
    /// The reference spheres.
    pub spheres: Vec<EmittingSphere>,
    /// The ground, where it was found.
    pub ground: Option<Ground>,
}

impl EmittingSphere {
    /// Distance at which a ray from outside meets it.
    pub fn meet(&self, start: &Vector3<f32>, direction: &Vector3<f32>) -> Option<f32> {
        let offset = start - self.center.coords;
        let b = offset.dot(direction);
        let discriminant = b * b - (offset.norm_squared() - self.radius * self.radius);
        if !(discriminant > 0.0 && b < 0.0) {
            return None;
        }
        let t = -b - discriminant.sqrt();
        (t > 0.0).then_some(t)
    }

    /// What it sends back along a ray that meets it at distance `t`.
    fn radiance_along(&self, start: &Vector3<f32>, direction: &Vector3<f32>, t: f32) -> [f32; 3] {
        let n = (start - self.center.coords + direction * t) / self.radius;
        let n = Vector3::new(f64::from(n.x), f64::from(n.y), f64::from(n.z)).normalize();
        let channels = &self.radiance.channels;
        std::array::from_fn(|c| {
            let channel = channels.get(c.min(channels.len().saturating_sub(1)));
            channel.map_or(0.0, |l| l.evaluate(&n).max(0.0) as f32)
        })
    }
}

impl Surroundings {
    /// Radiance that arrives at `start` against `direction` from the surroundings; `None` when the ray
    /// leaves into the environment. `from_sphere`: the sphere on which the ray starts.
    pub fn cast(
        &self,
        start: &Vector3<f32>,
        direction: &Vector3<f32>,
        from_sphere: Option<usize>,
    ) -> Option<[f32; 3]> {
        // The object stands nearest; a ray that meets it is not followed behind it. The spheres' sides
        // that face the object are the ones that the object's rays meet.
        if let Some(radiance) = self.volume.cast(start, direction) {
            return Some(radiance);
        }
        let nearest = self
            .spheres
            .iter()
            .enumerate()
            .filter(|(k, _)| from_sphere != Some(*k))
            .filter_map(|(_, sphere)| Some((sphere.meet(start, direction)?, sphere)))
            .min_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((t, sphere)) = nearest {
            return Some(sphere.radiance_along(start, direction, t));
        }
        self.ground.as_ref()?.cast(start, direction)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::super::DepthView;
    use super::*;
    use rilievo_scene::{
        Intrinsics, Lighting, LinearImage, Raster, RigidTransform, SphericalHarmonics,
    };

    fn ball(x: f32, radius: f32, radiance: f64) -> EmittingSphere {
        let constant = SphericalHarmonics([0.0, 0.0, 0.0, radiance, 0.0, 0.0, 0.0, 0.0, 0.0]);
        EmittingSphere {
            center: Point3::new(x, 0.0, 0.0),
            radius,
            radiance: Lighting {
                channels: vec![constant; 3],
            },
        }
    }

    /// Two spheres on the x axis, the object far below them.
    fn two_spheres() -> Surroundings {
        let view = DepthView {
            intrinsics: Intrinsics::pinhole(16, 16, 16.0, 7.5, 7.5),
            cam_from_world: RigidTransform {
                translation: [0.0, 0.0, -50.0].into(),
                ..RigidTransform::identity()
            },
            depth: Raster::filled(16, 16, 2.0),
            weight: Raster::filled(16, 16, 1.0),
            image: LinearImage::filled(16, 16, 3, 0.3),
            cut_by_frame: false,
        };
        Surroundings {
            volume: Volume::carve(&[view], 32).unwrap(),
            spheres: vec![ball(2.0, 0.5, 0.2), ball(5.0, 1.0, 0.7)],
            ground: None,
        }
    }

    #[test]
    fn a_ray_meets_the_nearer_of_two_spheres_and_not_the_one_it_starts_on() {
        let surroundings = two_spheres();
        let cast = |x: f32, y: f32, towards: f32, on: Option<usize>| {
            let start = Vector3::new(x, y, 0.0);
            let radiance = surroundings.cast(&start, &Vector3::new(towards, 0.0, 0.0), on);
            radiance.map(|rgb| (100.0 * rgb[1]).round())
        };
        // From both sides the nearer one, and past the smaller one the one behind it.
        assert_eq!(cast(0.0, 0.0, 1.0, None), Some(20.0));
        assert_eq!(cast(9.0, 0.0, -1.0, None), Some(70.0));
        assert_eq!(cast(0.0, 0.8, 1.0, None), Some(70.0));
        assert_eq!(cast(0.0, 1.2, 1.0, None), None);
        // From one sphere's surface, which rounding may put inside it, the other.
        assert_eq!(cast(2.499, 0.0, 1.0, Some(0)), Some(70.0));
        assert_eq!(cast(4.001, 0.0, -1.0, Some(1)), Some(20.0));
        assert_eq!(cast(1.501, 0.0, -1.0, Some(0)), None);
    }

    #[test]
    fn two_spheres_hide_a_part_of_the_sky_from_each_other() {
        use super::super::{Dome, directions, transfer};
        let surroundings = two_spheres();
        let rays = Dome::far(directions(2048));
        // Facing each other, on the smaller sphere and on the larger one.
        for (on, x, normal) in [(0, 2.5, 1.0), (1, 4.0, -1.0)] {
            let normal = Vector3::new(normal, 0.0, 0.0);
            let at = Vector3::new(x, 0.0, 0.0);
            let seen = transfer(&surroundings, &at, &normal, &rays, 0.0, Some(on));
            let other = &surroundings.spheres[1 - on];
            // A sphere overhead takes sin² of its angular radius from the irradiance.
            let sine = other.radius / (other.center.x - x);
            let sky: f32 = seen.row(&rays).iter().sum();
            assert!(
                (sky - (1.0 - sine * sine)).abs() < 0.02,
                "{sky} for sphere {on}"
            );
            let radiance = other.radiance.channels[0].0[3] as f32;
            let sent = seen.nearby_intensity()[0];
            let expected = radiance * sine * sine;
            assert!((sent - expected).abs() < 0.02, "{sent} for {expected}");
        }
    }
}
