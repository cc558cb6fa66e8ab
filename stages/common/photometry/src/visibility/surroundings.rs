//! What rays can meet: the carved solid, the reference sphere, the ground.

use super::volume::Volume;
use nalgebra::{Point3, Vector3};

/// The reference sphere with the radiance of its surface, as nine harmonics per channel of the world
/// normal (a matte sphere under a distant light).
#[derive(Clone, Debug)]
pub struct WarmSphere {
    /// Centre, world.
    pub center: Point3<f32>,
    /// Radius, world's unit.
    pub radius: f32,
    /// Radiance over world normals.
    pub radiance: rilievo_scene::Lighting,
}

/// A plane with a texture of radiances.
#[derive(Clone, Debug)]
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
    /// The reference sphere, where there is one.
    pub sphere: Option<WarmSphere>,
    /// The ground, where it was found.
    pub ground: Option<Ground>,
}

impl Surroundings {
    /// Radiance that arrives at `start` against `direction` from the surroundings; `None` when the ray
    /// leaves into the environment. `from_sphere` rays start on the sphere.
    pub fn cast(
        &self,
        start: &Vector3<f32>,
        direction: &Vector3<f32>,
        from_sphere: bool,
    ) -> Option<[f32; 3]> {
        // The object stands nearest; a ray that meets it is not followed behind it. The sphere's side
        // that faces the object is the one that the object's rays meet.
        if let Some(radiance) = self.volume.cast(start, direction) {
            return Some(radiance);
        }
        if !from_sphere && let Some(sphere) = &self.sphere {
            let offset = start - sphere.center.coords;
            let b = offset.dot(direction);
            let discriminant = b * b - (offset.norm_squared() - sphere.radius * sphere.radius);
            if discriminant > 0.0 && b < 0.0 {
                let t = -b - discriminant.sqrt();
                if t > 0.0 {
                    let n = (offset + direction * t) / sphere.radius;
                    let n = nalgebra::Vector3::new(f64::from(n.x), f64::from(n.y), f64::from(n.z))
                        .normalize();
                    let mut rgb = [0.0; 3];
                    for (c, value) in rgb.iter_mut().enumerate() {
                        let channels = &sphere.radiance.channels;
                        if let Some(l) = channels.get(c.min(channels.len().saturating_sub(1))) {
                            *value = l.evaluate(&n).max(0.0) as f32;
                        }
                    }
                    return Some(rgb);
                }
            }
        }
        self.ground.as_ref()?.cast(start, direction)
    }
}
