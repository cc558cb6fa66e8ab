//! The world in front of the camera.

use crate::environment::{Environment, Rgb, fibonacci};
use crate::error::SyntheticError;
use crate::given;
use crate::mat::Mat;
use crate::noise::gradient_noise;
use crate::options::SceneOptions;
use crate::shape::Shape;
use crate::surface::extract;
use nalgebra::{Point3, Vector3};
use rilievo_numerics::bvh::Bvh;
use rilievo_scene::{Mesh, fulfils};

/// How much of each colour a stain takes, the most first.
const BROWN: Rgb = Rgb::new(0.75, 0.9, 1.0);

/// Share of the lamps' distance up to which object and spheres may reach from the middle: nearer to the lamps the cells that stand
/// for them show.
const MAX_REACH: f64 = 0.7;

/// A reference sphere, metres, world frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReferenceSphere {
    /// Centre.
    pub center_in_world: [f64; 3],
    /// Radius.
    pub radius: f64,
}

impl ReferenceSphere {
    /// A sphere that lies on the mat.
    fn on_mat([x, y]: [f64; 2], radius: f64) -> Self {
        Self {
            center_in_world: [x, y, radius],
            radius,
        }
    }

    /// Parameter at which a ray of unit direction enters, from outside.
    pub(crate) fn meet(&self, origin: &Point3<f64>, direction: &Vector3<f64>) -> Option<f64> {
        let to_center = Point3::from(self.center_in_world) - origin;
        let along = to_center.dot(direction);
        let across2 = to_center.norm_squared() - along * along;
        let half2 = self.radius * self.radius - across2;
        (half2 > 0.0 && along > 0.0).then(|| along - half2.sqrt())
    }
}

/// An object, reference spheres and a printed mat under one environment; z points up, metres,
/// the mat lies in `z = 0`, the object stands on the origin and looks towards −y.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The options that made it.
    pub options: SceneOptions,
    /// The object's surface.
    pub mesh: Mesh,
    /// The reference spheres.
    pub spheres: Vec<ReferenceSphere>,
    /// The exact surface; absent where a mesh was given, which then is the surface.
    pub(crate) shape: Option<Shape>,
    pub(crate) bvh: Bvh,
    pub(crate) mat: Mat,
    pub(crate) environment: Environment,
}

impl Scene {
    /// The scene of `rilievo demo` with another seed.
    ///
    /// # Errors
    /// [`SyntheticError::EmptyShape`] when the seed's shape vanishes.
    pub fn demo(seed: u64) -> Result<Self, SyntheticError> {
        Self::new(SceneOptions {
            seed,
            ..SceneOptions::default()
        })
    }

    /// Builds a scene.
    ///
    /// # Errors
    /// Unusable options, or a shape without surface.
    pub fn new(options: SceneOptions) -> Result<Self, SyntheticError> {
        options.validate()?;
        let height = options.height_m;
        let shape = Shape::new(options.subject, options.relief, options.seed);
        let mesh = extract(
            &shape,
            options.mesh_spacing_m / height,
            height,
            options.seed,
        )?;
        Self::around(options, mesh, Some(shape))
    }

    /// Builds a scene around a given mesh instead of a made object: moved onto the mat's middle and
    /// scaled to the height of the options; z is up, −y the front. Its normals, made where it has
    /// none, are the surface's.
    ///
    /// # Errors
    /// Unusable options, or a mesh without triangles, with corners that are not there or numbers
    /// that are none, or flat.
    pub fn with_mesh(options: SceneOptions, mesh: Mesh) -> Result<Self, SyntheticError> {
        options.validate()?;
        let mesh = given::standing(mesh, options.height_m)
            .map_err(|reason| SyntheticError::Mesh { reason })?;
        Self::around(options, mesh, None)
    }

    fn around(
        options: SceneOptions,
        mesh: Mesh,
        shape: Option<Shape>,
    ) -> Result<Self, SyntheticError> {
        for ball in &options.more_spheres {
            ball.check_beside(&mesh)?;
        }
        let height = options.height_m;
        let bvh = Bvh::new(&mesh);
        let balls = options.first_sphere().into_iter();
        let balls = balls.chain(options.more_spheres.iter().copied());
        let spheres: Vec<ReferenceSphere> = balls
            .map(|ball| ReferenceSphere::on_mat(ball.at_m, ball.radius_m))
            .collect();
        if let Some(distance) = options.lamps_at_m {
            let middle = options.middle();
            let vertices = mesh.vertices.iter().map(|v| Point3::from(v.map(f64::from)));
            let reaches = vertices.map(|v| (v - middle).norm());
            let balls = spheres.iter();
            let balls = balls.map(|s| (Point3::from(s.center_in_world) - middle).norm() + s.radius);
            let reach = reaches.chain(balls).fold(0.0, f64::max);
            let is_inside = reach <= MAX_REACH * distance;
            fulfils("lamps_at_m", distance, is_inside, || {
                format!(
                    "be {:.2} at least, so that object and spheres stand well before the lamps",
                    reach / MAX_REACH
                )
            })?;
        }
        Ok(Self {
            mat: Mat::new(options.seed, 1.75 * height, 1.35 * height),
            environment: Self::light(&options, 0.0),
            shape,
            bvh,
            mesh,
            spheres,
            options,
        })
    }

    /// The environment of the options, turned about the vertical by `turn` radians.
    fn light(options: &SceneOptions, turn: f64) -> Environment {
        let mat = Mat::mean_albedo();
        let far = Environment::new(options.seed, options.illumination, turn, mat);
        match options.lamps_at_m {
            Some(distance) => far.with_lamps_at(distance, options.middle()),
            None => far,
        }
    }

    /// The scene's environment, turned about the vertical by `turn` radians.
    pub(crate) fn turned_light(&self, turn: f64) -> Environment {
        Self::light(&self.options, turn)
    }

    /// The first sphere that a ray of unit direction enters, from outside: its index and the
    /// parameter there.
    pub(crate) fn meet_sphere(
        spheres: &[ReferenceSphere],
        origin: &Point3<f64>,
        direction: &Vector3<f64>,
    ) -> Option<(usize, f64)> {
        let met = spheres.iter().enumerate();
        met.filter_map(|(k, sphere)| Some((k, sphere.meet(origin, direction)?)))
            .min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Albedo of the object at a point of its surface.
    pub fn object_albedo(&self, point_in_world: &Point3<f64>) -> Vector3<f64> {
        let mut albedo = Rgb::from(self.options.albedo);
        let p = point_in_world.coords / self.options.height_m;
        let seed = self.options.seed as u32;
        if self.options.speckle > 0.0 {
            // Two octaves of unit variance together: gradient noise has a standard deviation of
            // 0.28.
            let speckle = gradient_noise(&(p / 0.010), seed ^ 0x91)
                + 0.7 * gradient_noise(&(p / 0.026), seed ^ 0x92);
            albedo *= 1.0 + self.options.speckle * speckle / 0.34;
        }
        if self.options.stains > 0.0 {
            let patches = gradient_noise(&(p / 0.16), seed ^ 0x93)
                + 0.3 * gradient_noise(&(p / 0.05), seed ^ 0x94);
            // A quarter of the surface, with soft edges.
            let depth = ((patches - 0.15) / 0.25).clamp(0.0, 1.0);
            let share = self.options.stains * depth * depth * (3.0 - 2.0 * depth);
            albedo = albedo.component_mul(&BROWN.map(|tint| 1.0 - share * tint));
        }
        albedo
    }

    /// Points around object and spheres: what every photo should show.
    pub(crate) fn outline(&self) -> Vec<Point3<f64>> {
        // A few hundred vertices reach the silhouette to within a hundredth of the object.
        let stride = (self.mesh.vertices.len() / 600).max(1);
        let object = self
            .mesh
            .vertices
            .iter()
            .step_by(stride)
            .map(|v| Point3::from(v.map(f64::from)));
        let spheres = self.spheres.iter().flat_map(|sphere| {
            (0..64).map(move |k| {
                Point3::from(sphere.center_in_world) + fibonacci(k, 64) * sphere.radius
            })
        });
        object.chain(spheres).collect()
    }
}
