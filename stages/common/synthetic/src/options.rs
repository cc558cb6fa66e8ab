//! Options of the synthetic scene and of its photographs.

use nalgebra::Point3;
use rilievo_scene::{Mesh, OptionError, RetiredKey, check_ranges, fulfils, in_range};
use serde::{Deserialize, Serialize};

/// Keys that the tables of `synth --config` had once, with what to do instead.
pub const RETIRED_KEYS: [(&str, &[RetiredKey]); 2] = [
    (
        "scene",
        &[
            fixed(&["height_m"], "it is fixed at .24 m"),
            fixed(&["albedo"], "it is fixed at .56, .53, .48"),
            fixed(&["mesh_spacing_m"], "it is fixed at 1.5 mm"),
        ],
    ),
    (
        "photographs",
        &[
            fixed(&["focal_in_widths"], "it is fixed at 1.35"),
            fixed(&["elevation_deg"], "it is fixed at 24 degrees"),
            fixed(&["edge_samples"], "it is fixed at 3"),
        ],
    ),
];

const fn fixed(path: &'static [&'static str], instead: &'static str) -> RetiredKey {
    RetiredKey { path, instead }
}

/// What stands on the mat.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Subject {
    /// A carved bust on a plinth: hair strands, folds, tool marks.
    #[default]
    Bust,
    /// A weathered stone without overhangs.
    Stone,
    /// A plain ellipsoid, for tests that want an analytic surface.
    Ellipsoid,
}

/// What shines on the scene.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Illumination {
    /// A window from one side of the front, a weaker one from the other, light from behind and
    /// above, and a grey room.
    #[default]
    Windows,
    /// One lamp of some ten degrees' half-width in a grey room: hard shadows, which want several
    /// hundred [`RenderOptions::shadow_rays`].
    Lamp,
    /// An overcast sky.
    Overcast,
    /// An orange and a blue window from either side of the front.
    TwoColors,
}

/// A matte sphere that lies on the mat.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BallOptions {
    /// Where it touches the mat, x and y, metres; the object stands on the origin and looks
    /// towards −y.
    pub at_m: [f64; 2],
    /// Its radius, metres.
    pub radius_m: f64,
}

impl BallOptions {
    /// Whether two spheres on one mat do not overlap: `d² ≥ (r₁ + r₂)² − (r₁ − r₂)²`.
    fn is_apart(&self, other: &Self) -> bool {
        let between = (0..2).map(|c| self.at_m[c] - other.at_m[c]);
        between.map(|d| d * d).sum::<f64>() >= 4.0 * self.radius_m * other.radius_m
    }

    /// Refuses a place in the object, as the rectangle around the vertices below the sphere's top.
    pub(crate) fn check_beside(&self, object: &Mesh) -> Result<(), OptionError> {
        let top = 2.0 * self.radius_m;
        let low = object.vertices.iter().filter(|v| f64::from(v[2]) <= top);
        let (mut from, mut to) = ([f64::MAX; 2], [f64::MIN; 2]);
        for vertex in low {
            for c in 0..2 {
                from[c] = from[c].min(f64::from(vertex[c]));
                to[c] = to[c].max(f64::from(vertex[c]));
            }
        }
        let outside = |c: usize| (from[c] - self.at_m[c]).max(self.at_m[c] - to[c]).max(0.0);
        fulfils(
            "more_spheres.at_m",
            self.at_m,
            outside(0).hypot(outside(1)) >= self.radius_m,
            || "lie beside the object, not in it",
        )
    }
}

/// The world in front of the camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SceneOptions {
    /// Seed of shape, relief, light and mat: another seed is another object.
    pub seed: u64,
    /// What stands on the mat.
    pub subject: Subject,
    /// What shines on it.
    pub illumination: Illumination,
    /// Height of the object, metres. Not a key, as all that is skipped here.
    #[serde(skip)]
    pub height_m: f64,
    /// Amplitude of the carved relief relative to the shape's own design, 0 for none. Above 2 the
    /// grooves shadow themselves.
    pub relief: f64,
    /// Albedo of object and sphere, red, green, blue.
    #[serde(skip)]
    pub albedo: [f64; 3],
    /// Relative standard deviation of the object's albedo, a fine speckle. It gives keypoints
    /// something to hold on to; shading takes it for shape.
    pub speckle: f64,
    /// Share of the albedo that soft-edged brownish stains take where they are darkest; 0 has none.
    pub stains: f64,
    /// Share of a smooth dielectric's mirror reflection (4 % at normal incidence, more when grazed)
    /// that the object adds to its matte light; 0 is matte, 1 is glazed.
    pub gloss: f64,
    /// Distance of windows and lamps from the middle of the object, metres; without it they are endlessly far. An overcast
    /// sky has none, and photos that obey eq. 1 exactly know no distance.
    pub lamps_at_m: Option<f64>,
    /// Radius of the reference sphere, metres; 0 for none.
    pub sphere_radius_m: f64,
    /// Further matte spheres on the mat.
    pub more_spheres: Vec<BallOptions>,
    /// Edge of the surface mesh, metres. Finer costs time with its third power, coarser loses
    /// relief in `mesh` (depth and normals are exact either way).
    #[serde(skip)]
    pub mesh_spacing_m: f64,
}

impl Default for SceneOptions {
    fn default() -> Self {
        Self {
            seed: 1,
            subject: Subject::Bust,
            illumination: Illumination::Windows,
            height_m: 0.24,
            relief: 1.0,
            albedo: [0.56, 0.53, 0.48],
            speckle: 0.03,
            stains: 0.0,
            gloss: 0.0,
            lamps_at_m: None,
            sphere_radius_m: 0.03,
            more_spheres: Vec::new(),
            mesh_spacing_m: 0.0015,
        }
    }
}

/// How light reaches the surface.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LightModel {
    /// Nine harmonics of the normal, no shadow and no bounce: the photos obey eq. 1 exactly.
    Harmonics,
    /// The environment with cast shadows and own shadows.
    Shadowed,
    /// Shadows and one bounce between object, sphere and mat.
    #[default]
    Bounce,
}

/// The photographs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RenderOptions {
    /// Number of photos.
    pub num_views: usize,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Angle between the first and the last camera, seen from the object, degrees; 360 closes the
    /// ring.
    pub arc_deg: f64,
    /// Share of the frame, from its centre, that object and spheres fill in every view; above 1 the
    /// frame cuts them.
    pub fill: f64,
    /// The object stands on a turntable: camera and light keep still, the object and its mat turn,
    /// without a photographer's unsteadiness. The light has its own direction in the middle view.
    pub turntable: bool,
    /// OpenCV distortion k1, k2, p1, p2, k3.
    pub distortion: [f64; 5],
    /// How light reaches the surface.
    pub light: LightModel,
    /// Standard deviation of the noise at white, relative (shot noise: it falls with the square
    /// root of the intensity), 0 for none.
    pub noise: f64,
    /// Standard deviation of the exposure from photo to photo, in stops.
    pub exposure_drift_ev: f64,
    /// Rays per side of a pixel on edges, against staircases; 1 leaves the centre ray.
    #[serde(skip)]
    pub edge_samples: usize,
    /// Rays per surface point for shadows and bounce.
    pub shadow_rays: usize,
}

impl Default for RenderOptions {
    fn default() -> Self {
        Self {
            num_views: 6,
            width: 640,
            height: 480,
            arc_deg: 75.0,
            fill: 0.9,
            turntable: false,
            distortion: [0.0; 5],
            light: LightModel::Bounce,
            noise: 0.004,
            exposure_drift_ev: 0.0,
            edge_samples: 3,
            shadow_rays: 80,
        }
    }
}

impl SceneOptions {
    /// The reference sphere, clear of the object by about its own size, so that it stays out of its
    /// shadow.
    pub(crate) fn first_sphere(&self) -> Option<BallOptions> {
        (self.sphere_radius_m > 0.0).then(|| BallOptions {
            at_m: [
                (0.40 + 0.22) * self.height_m + self.sphere_radius_m,
                -0.12 * self.height_m,
            ],
            radius_m: self.sphere_radius_m,
        })
    }

    /// Middle of the object, world.
    pub(crate) fn middle(&self) -> Point3<f64> {
        Point3::new(0.0, 0.0, 0.5 * self.height_m)
    }

    /// Checks every number.
    ///
    /// # Errors
    /// Names the first one that is out of its range.
    pub fn validate(&self) -> Result<(), OptionError> {
        in_range("height_m", self.height_m, 0.01..=10.0)?;
        in_range("relief", self.relief, 0.0..=5.0)?;
        for albedo in self.albedo {
            in_range("albedo", albedo, 0.01..=0.95)?;
        }
        in_range("speckle", self.speckle, 0.0..=0.3)?;
        in_range("stains", self.stains, 0.0..=0.9)?;
        in_range("gloss", self.gloss, 0.0..=1.0)?;
        if let Some(distance) = self.lamps_at_m {
            in_range("lamps_at_m", distance, 2.0 * self.height_m..=1000.0)?;
        }
        let widest = 0.5 * self.height_m;
        in_range("sphere_radius_m", self.sphere_radius_m, 0.0..=widest)?;
        for (k, ball) in self.more_spheres.iter().enumerate() {
            in_range("more_spheres.radius_m", ball.radius_m, 1e-6..=widest)?;
            for coordinate in ball.at_m {
                let reach = 10.0 * self.height_m;
                in_range("more_spheres.at_m", coordinate, -reach..=reach)?;
            }
            let mut before = self
                .first_sphere()
                .into_iter()
                .chain(self.more_spheres[..k].to_vec());
            let apart = before.all(|other| ball.is_apart(&other));
            fulfils(
                "more_spheres.at_m",
                ball.at_m,
                apart,
                || "lie beside the other spheres, not in one",
            )?;
        }
        let height = self.height_m;
        in_range(
            "mesh_spacing_m",
            self.mesh_spacing_m,
            height / 400.0..=height / 10.0,
        )
    }
}

impl RenderOptions {
    /// Checks every number.
    ///
    /// # Errors
    /// Names the first one that is out of its range.
    pub fn validate(&self) -> Result<(), OptionError> {
        for coefficient in self.distortion {
            in_range("distortion", coefficient, -0.5..=0.5)?;
        }
        check_ranges!(
            self;
            num_views in 1..=1000,
            width in 16..=20_000,
            height in 16..=20_000,
            arc_deg in 0.0..=360.0,
            fill in 0.1..=4.0,
            noise in 0.0..=0.2,
            exposure_drift_ev in 0.0..=3.0,
            edge_samples in 1..=8,
            shadow_rays in 16..=4096,
        )
    }
}
