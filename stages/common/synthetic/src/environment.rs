//! The light: a soft environment, its irradiance, and its nine harmonics.
//!
//! Radiance `L(ω) = g(ω_z) + Σ_k c_k exp(κ_k (ω·d_k − 1))` per channel from above (a room or sky
//! `g` that brightens towards the zenith, windows and lamps as lobes), and from below the radiance
//! of the mat, `L = ρ_mat E(ẑ)`. Irradiance over π on an unshadowed surface, `E(n) = 1/π ∫ L(ω)
//! max(0, n·ω) dω`, is tabulated; a surface of albedo ρ then shines with `ρ E(n)`.
//!
//! Lamps nearby are the same lobes painted on a glowing dome of radius `D` around the middle of the object, matte and so of one
//! radiance from everywhere: along `ω` from the place `x` comes what the dome shows where that ray meets it. Their share of the
//! irradiance is summed over cells of the dome.
//!
//! The nine harmonics are the least-squares fit of eq. 1 to `E` over all normals; Basri and Jacobs
//! (PAMI 2003) bound what it leaves at 2 % for distant light.

use crate::noise::unit;
use crate::options::Illumination;
use nalgebra::{Point3, Rotation3, SMatrix, SVector, Vector3};
use rilievo_scene::SphericalHarmonics;

/// Red, green, blue.
pub(crate) type Rgb = Vector3<f64>;

#[derive(Clone, Debug)]
struct Lobe {
    direction: Vector3<f64>,
    concentration: f64,
    color: Rgb,
}

/// An environment with its irradiance table.
#[derive(Clone, Debug)]
pub(crate) struct Environment {
    lobes: Vec<Lobe>,
    zenith: Rgb,
    horizon: Rgb,
    ground: Rgb,
    /// Irradiance over π on an octahedral grid of normals.
    table: Vec<Rgb>,
    /// Where the lobes are lamps nearby.
    near: Option<Near>,
}

/// Lamps nearby.
#[derive(Clone, Debug)]
struct Near {
    /// Middle of the object, world.
    middle: Point3<f64>,
    /// Radius of the dome.
    radius: f64,
    /// Directions of the bright cells from the middle, with their radiance.
    cells: Vec<(Vector3<f64>, Rgb)>,
    /// Irradiance over π of all but them.
    room: Vec<Rgb>,
}

impl Near {
    /// Direction from the middle of what a ray from a place within the dome meets; outside there is no lamp.
    fn met(&self, place: &Point3<f64>, direction: &Vector3<f64>) -> Option<Vector3<f64>> {
        let offset = (place - self.middle) / self.radius;
        let inside = 1.0 - offset.norm_squared();
        let along = offset.dot(direction);
        (inside > 0.0).then(|| offset + direction * ((along * along + inside).sqrt() - along))
    }

    /// Irradiance over π of the bright cells.
    fn irradiance(&self, place: &Point3<f64>, n: &Vector3<f64>) -> Rgb {
        let offset = (self.middle - place) / self.radius;
        let mut sum = Rgb::zeros();
        for (cell, radiance) in &self.cells {
            let way = cell + offset;
            let (cosine, facing) = (way.dot(n), way.dot(cell));
            if cosine > 0.0 && facing > 0.0 {
                sum += radiance * (cosine * facing / way.norm_squared().powi(2));
            }
        }
        sum * (4.0 / NUM_DIRECTIONS as f64)
    }
}

/// Side of the table; bilinear interpolation then errs by less than 3e-4 of the irradiance.
const TABLE: usize = 96;
/// Directions of the quadrature.
const NUM_DIRECTIONS: usize = 3000;

/// Point `k` of `n` of an even spread over the sphere.
pub(crate) fn fibonacci(k: usize, n: usize) -> Vector3<f64> {
    const GOLDEN_ANGLE: f64 = 2.399_963_229_728_653;
    let z = 1.0 - (2 * k + 1) as f64 / n as f64;
    let r = (1.0 - z * z).max(0.0).sqrt();
    let angle = GOLDEN_ANGLE * k as f64;
    Vector3::new(r * angle.cos(), r * angle.sin(), z)
}

/// Folds a direction onto the square `[-1, 1]²`.
fn octahedral(n: &Vector3<f64>) -> (f64, f64) {
    let sum = n.x.abs() + n.y.abs() + n.z.abs();
    let (x, y) = (n.x / sum, n.y / sum);
    if n.z >= 0.0 {
        return (x, y);
    }
    ((1.0 - y.abs()) * x.signum(), (1.0 - x.abs()) * y.signum())
}

fn from_octahedral(x: f64, y: f64) -> Vector3<f64> {
    let z = 1.0 - x.abs() - y.abs();
    if z >= 0.0 {
        return Vector3::new(x, y, z).normalize();
    }
    Vector3::new(
        (1.0 - y.abs()) * x.signum(),
        (1.0 - x.abs()) * y.signum(),
        z,
    )
    .normalize()
}

impl Lobe {
    /// Radiance from a direction; nothing comes through the mat.
    fn radiance(&self, direction: &Vector3<f64>) -> Rgb {
        if direction.z < 0.0 {
            return Rgb::zeros();
        }
        let fall = self.concentration * (direction.dot(&self.direction) - 1.0);
        self.color * fall.exp()
    }
}

/// Irradiance over π of an unshadowed surface under a radiance.
fn integrate(n: &Vector3<f64>, radiance: impl Fn(&Vector3<f64>) -> Rgb) -> Rgb {
    let mut sum = Rgb::zeros();
    for k in 0..NUM_DIRECTIONS {
        let direction = fibonacci(k, NUM_DIRECTIONS);
        let cosine = n.dot(&direction);
        if cosine > 0.0 {
            sum += radiance(&direction) * cosine;
        }
    }
    sum * (4.0 / NUM_DIRECTIONS as f64)
}

/// [`integrate`] on the octahedral grid of normals.
fn table(radiance: impl Fn(&Vector3<f64>) -> Rgb) -> Vec<Rgb> {
    let coordinate = |i: usize| 2.0 * i as f64 / (TABLE - 1) as f64 - 1.0;
    let normal = |i: usize| from_octahedral(coordinate(i % TABLE), coordinate(i / TABLE));
    (0..TABLE * TABLE)
        .map(|i| integrate(&normal(i), &radiance))
        .collect()
}

/// A table's value at a normal.
fn read(table: &[Rgb], n: &Vector3<f64>) -> Rgb {
    let (x, y) = octahedral(n);
    let scaled = |c: f64| (0.5 * (c + 1.0) * (TABLE - 1) as f64).clamp(0.0, (TABLE - 1) as f64);
    let (x, y) = (scaled(x), scaled(y));
    let (i, j) = ((x as usize).min(TABLE - 2), (y as usize).min(TABLE - 2));
    let (fx, fy) = (x - i as f64, y - j as f64);
    let at = |i: usize, j: usize| table[j * TABLE + i];
    (at(i, j) * (1.0 - fx) + at(i + 1, j) * fx) * (1.0 - fy)
        + (at(i, j + 1) * (1.0 - fx) + at(i + 1, j + 1) * fx) * fy
}

impl Environment {
    /// Light of a kind and seed, turned about the vertical by `turn` radians. The front is −y.
    pub(crate) fn new(seed: u64, kind: Illumination, turn: f64, mat_albedo: Rgb) -> Self {
        let seed = seed as u32 ^ (seed >> 32) as u32;
        let between =
            |item: u32, low: f64, high: f64| low + (high - low) * unit([seed, item, 2, 0]);
        let side = if unit([seed, 0, 2, 0]) < 0.5 {
            -1.0
        } else {
            1.0
        };
        // Azimuth from the front, positive to the right.
        let lobe = |azimuth_deg: f64, elevation_deg: f64, concentration: f64, color: Rgb| {
            let (a, e) = (azimuth_deg.to_radians() + turn, elevation_deg.to_radians());
            Lobe {
                direction: Vector3::new(a.sin() * e.cos(), -a.cos() * e.cos(), e.sin()),
                concentration,
                color,
            }
        };
        let room = (Rgb::new(0.12, 0.125, 0.13), Rgb::new(0.06, 0.06, 0.065));
        let (lobes, (zenith, horizon)) = match kind {
            Illumination::Windows => (
                vec![
                    lobe(
                        side * between(1, 48.0, 68.0),
                        between(2, 34.0, 48.0),
                        between(3, 9.0, 13.0),
                        Rgb::new(1.0, 0.95, 0.86) * 4.6,
                    ),
                    lobe(
                        -side * between(4, 55.0, 85.0),
                        between(5, 22.0, 40.0),
                        between(6, 5.0, 8.0),
                        Rgb::new(0.74, 0.86, 1.0) * between(7, 0.35, 0.55),
                    ),
                    lobe(
                        180.0 + side * between(8, -40.0, 40.0),
                        between(9, 45.0, 60.0),
                        6.0,
                        Rgb::new(0.85, 0.92, 1.0) * between(10, 0.4, 0.7),
                    ),
                ],
                room,
            ),
            Illumination::Lamp => (
                vec![lobe(
                    side * between(1, 30.0, 60.0),
                    between(2, 35.0, 50.0),
                    60.0,
                    Rgb::new(1.0, 0.92, 0.8) * 22.0,
                )],
                room,
            ),
            // The overcast sky of Moon and Spencer (1942): (1 + 2 sin e)/3.
            Illumination::Overcast => (
                Vec::new(),
                (Rgb::new(0.95, 0.98, 1.0), Rgb::new(0.317, 0.327, 0.333)),
            ),
            Illumination::TwoColors => (
                vec![
                    lobe(
                        between(1, 40.0, 70.0),
                        between(2, 30.0, 45.0),
                        12.0,
                        Rgb::new(1.0, 0.45, 0.2) * 4.0,
                    ),
                    lobe(
                        -between(4, 40.0, 70.0),
                        between(5, 30.0, 45.0),
                        12.0,
                        Rgb::new(0.2, 0.45, 1.0) * 4.0,
                    ),
                ],
                room,
            ),
        };
        let mut environment = Self {
            lobes,
            zenith,
            horizon,
            ground: Rgb::zeros(),
            table: Vec::new(),
            near: None,
        };
        // The ground's own radiance does not light a surface that faces straight up.
        let up = integrate(&Vector3::z(), |d| environment.far_radiance(d));
        environment.ground = up.component_mul(&mat_albedo);
        environment.table = table(|d| environment.far_radiance(d));
        environment
    }

    /// With the lobes as lamps at a distance from the middle of the object.
    pub(crate) fn with_lamps_at(mut self, distance: f64, middle: Point3<f64>) -> Self {
        /// Share of the brightest cell's radiance below which a cell is dark.
        const DARK: f64 = 1e-3;
        let directions = (0..NUM_DIRECTIONS).map(|k| fibonacci(k, NUM_DIRECTIONS));
        let mut cells: Vec<_> = directions.map(|d| (d, self.of_lobes(&d))).collect();
        let most = cells
            .iter()
            .map(|(_, radiance)| radiance.max())
            .fold(0.0, f64::max);
        cells.retain(|(_, radiance)| radiance.max() > DARK * most);
        self.near = Some(Near {
            middle,
            radius: distance,
            cells,
            room: table(|d| self.room(d)),
        });
        self
    }

    /// Radiance of the lobes in a direction from the middle of the object.
    fn of_lobes(&self, direction: &Vector3<f64>) -> Rgb {
        self.lobes.iter().map(|lobe| lobe.radiance(direction)).sum()
    }

    /// Radiance without the lobes; from below, that of the unshadowed mat.
    fn room(&self, direction: &Vector3<f64>) -> Rgb {
        if direction.z < 0.0 {
            return self.ground;
        }
        self.horizon + (self.zenith - self.horizon) * direction.z
    }

    /// Radiance from a direction in the middle of the object.
    fn far_radiance(&self, direction: &Vector3<f64>) -> Rgb {
        let lobes = self.lobes.iter().map(|lobe| lobe.radiance(direction));
        lobes.fold(self.room(direction), |sum, lobe| sum + lobe)
    }

    /// Radiance at a place from a direction.
    pub(crate) fn radiance(&self, place: &Point3<f64>, direction: &Vector3<f64>) -> Rgb {
        match &self.near {
            None => self.far_radiance(direction),
            Some(near) => {
                let met = near.met(place, direction);
                let lamps = met.map_or_else(Rgb::zeros, |met| self.of_lobes(&met));
                self.room(direction) + lamps
            }
        }
    }

    /// Irradiance over π of an unshadowed surface at a place.
    pub(crate) fn irradiance(&self, place: &Point3<f64>, n: &Vector3<f64>) -> Rgb {
        match &self.near {
            None => read(&self.table, n),
            Some(near) => read(&near.room, n) + near.irradiance(place, n),
        }
    }

    /// Nine harmonics of the irradiance in the middle of the object in a camera's frame, one row per channel.
    pub(crate) fn harmonics(&self, cam_from_world: &Rotation3<f64>) -> [SphericalHarmonics; 3] {
        let mut normal_matrix = SMatrix::<f64, 9, 9>::zeros();
        let mut right = [SVector::<f64, 9>::zeros(); 3];
        for k in 0..NUM_DIRECTIONS {
            let n_in_world = fibonacci(k, NUM_DIRECTIONS);
            let h =
                SVector::<f64, 9>::from(SphericalHarmonics::basis(&(cam_from_world * n_in_world)));
            normal_matrix += h * h.transpose();
            let irradiance = read(&self.table, &n_in_world);
            for c in 0..3 {
                right[c] += h * irradiance[c];
            }
        }
        let factor = normal_matrix.cholesky();
        right.map(|b| {
            SphericalHarmonics(
                factor
                    .as_ref()
                    .map_or_else(SVector::zeros, |f| f.solve(&b))
                    .into(),
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nine_harmonics_leave_little_and_turn_with_the_camera() {
        let environment = Environment::new(3, Illumination::Windows, 0.0, Rgb::repeat(0.4));
        let rotation = Rotation3::from_euler_angles(0.4, -1.0, 2.0);
        let harmonics = environment.harmonics(&rotation);
        let (mut square, mut total) = (0.0, 0.0);
        for k in 0..500 {
            let n = fibonacci(k, 500);
            let exact = environment.irradiance(&Point3::origin(), &n);
            for c in 0..3 {
                square += (harmonics[c].evaluate(&(rotation * n)) - exact[c]).powi(2);
                total += exact[c] * exact[c];
            }
        }
        let residual = (square / total).sqrt();
        assert!(residual < 0.04, "{residual}");
    }

    #[test]
    fn the_table_agrees_with_the_integral() {
        for (kind, most) in [
            (Illumination::Windows, 3e-3),
            (Illumination::Lamp, 6e-3),
            // The mat beyond the horizon is brighter than the sky there.
            (Illumination::Overcast, 6e-3),
            (Illumination::TwoColors, 3e-3),
        ] {
            let environment = Environment::new(4, kind, 0.0, Rgb::repeat(0.4));
            for k in 0..200 {
                let n = fibonacci(k, 200);
                let table = environment.irradiance(&Point3::origin(), &n);
                let exact = integrate(&n, |d| environment.far_radiance(d));
                let error = (table - exact).norm() / exact.norm();
                assert!(error < most, "{kind:?}, {n:?}: {error}");
            }
        }
    }

    #[test]
    fn a_turn_of_the_light_turns_its_irradiance() {
        let light =
            |turn: f64| Environment::new(5, Illumination::TwoColors, turn, Rgb::repeat(0.4));
        let (still, turned) = (light(0.0), light(0.7));
        // From the front (−y) to the right (+x) is a positive turn about +z.
        let rotation = Rotation3::from_axis_angle(&Vector3::z_axis(), 0.7);
        for k in 0..100 {
            let n = fibonacci(k, 100);
            let at = Point3::origin();
            let (a, b) = (
                still.irradiance(&at, &n),
                turned.irradiance(&at, &(rotation * n)),
            );
            let error = (a - b).norm() / a.norm();
            assert!(error < 1e-2, "{n:?}: {error}");
        }
    }

    #[test]
    fn light_of_lamps_nearby_is_the_integral_of_what_arrives() {
        let far = Environment::new(4, Illumination::Windows, 0.0, Rgb::repeat(0.4));
        let middle = Point3::new(0.0, 0.0, 0.12);
        let near = far.clone().with_lamps_at(0.8, middle);
        for k in 0..50 {
            let n = fibonacci(k, 50);
            let error = near.irradiance(&middle, &n) - far.irradiance(&middle, &n);
            assert!(error.norm() < 3e-3 * far.irradiance(&middle, &n).norm());
            let place = Point3::new(0.2, -0.1, 0.02);
            let exact = integrate(&n, |d| near.radiance(&place, d));
            let error = near.irradiance(&place, &n) - exact;
            assert!(error.norm() < 6e-3 * exact.norm(), "{n:?}: {error}");
        }
        // A facing surface half way to the lamp gets more, by less than the square: the lamp is wide.
        let lobe = far.lobes[0].direction;
        let of_lamps = |place: &Point3<f64>| {
            near.irradiance(place, &lobe).sum() - read(&far.table, &lobe).sum()
        };
        let gain = of_lamps(&(middle + lobe * 0.2));
        assert!(gain > 0.3 * read(&far.table, &lobe).sum(), "{gain}");
    }
}
