//! The objects as implicit functions.
//!
//! A surface is the zero set of `f(p)`, negative inside, `p` in units of the object's height with
//! the base at `z = 0`, the front towards −y. `f` is a smooth union of ellipsoids, capsules and
//! cylinders, minus a relief `d(p)` that is carved into it: `f = base(p) + d(p)`. It is near
//! enough to a distance (`|∇f|` about 1 at the surface) for Newton's method along a ray.
//!
//! Sources: smooth minimum of Quílez, "Smooth minimum", 2013 (quadratic); ellipsoid bound of the
//! same author.

use crate::noise::{gradient_noise, unit};
use crate::options::Subject;
use nalgebra::{Rotation3, Vector3};

/// An object with its seed.
#[derive(Clone, Debug)]
pub(crate) struct Shape {
    subject: Subject,
    relief: f64,
    seed: u32,
    /// Turns and leans the head against the chest.
    head_from_body: Rotation3<f64>,
    /// Per-seed proportions, each about 1.
    stretch: [f64; 6],
    /// Number of hair strands around the head, and how much they wave.
    strands: (f64, f64),
    /// Facets of the stone: unit normals and offsets.
    facets: Vec<(Vector3<f64>, f64)>,
}

fn ellipsoid(p: &Vector3<f64>, center: [f64; 3], radii: [f64; 3]) -> f64 {
    let q = p - Vector3::from(center);
    let r = Vector3::from(radii);
    let k0 = q.component_div(&r).norm();
    let k1 = q.component_div(&r.component_mul(&r)).norm();
    if k1 < 1e-12 {
        return -r.min();
    }
    k0 * (k0 - 1.0) / k1
}

fn capsule(p: &Vector3<f64>, a: [f64; 3], b: [f64; 3], radius_a: f64, radius_b: f64) -> f64 {
    let a = Vector3::from(a);
    let ab = Vector3::from(b) - a;
    let t = ((p - a).dot(&ab) / ab.norm_squared()).clamp(0.0, 1.0);
    (p - a - ab * t).norm() - (radius_a + t * (radius_b - radius_a))
}

/// An upright cylinder from `low` to `high` with rounded edges.
fn cylinder(p: &Vector3<f64>, radius: f64, low: f64, high: f64, rounding: f64) -> f64 {
    let across = p.x.hypot(p.y) - radius + rounding;
    let along = (p.z - 0.5 * (low + high)).abs() - 0.5 * (high - low) + rounding;
    across.max(along).min(0.0) + across.max(0.0).hypot(along.max(0.0)) - rounding
}

/// Smooth minimum: the union of two bodies with a fillet of about `k`.
fn union(a: f64, b: f64, k: f64) -> f64 {
    let h = (k - (a - b).abs()).max(0.0) / k;
    a.min(b) - 0.25 * h * h * k
}

/// Smooth maximum: the intersection.
fn intersection(a: f64, b: f64, k: f64) -> f64 {
    -union(-a, -b, k)
}

fn smoothstep(low: f64, high: f64, x: f64) -> f64 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

impl Shape {
    pub(crate) fn new(subject: Subject, relief: f64, seed: u64) -> Self {
        let seed = seed as u32 ^ (seed >> 32) as u32;
        let between =
            |item: u32, low: f64, high: f64| low + (high - low) * unit([seed, item, 1, 0]);
        let head_from_body = Rotation3::from_euler_angles(
            between(1, -0.10, 0.10),
            between(2, -0.08, 0.08),
            between(3, -0.30, 0.30),
        );
        let stretch = std::array::from_fn(|i| between(10 + i as u32, 0.93, 1.07));
        let facets = (0..9)
            .map(|i| {
                let angle = std::f64::consts::TAU * (i as f64 / 9.0 + between(30 + i, -0.05, 0.05));
                let up = between(40 + i, -0.25, 0.9);
                let normal = Vector3::new(angle.cos(), angle.sin(), up).normalize();
                (normal, between(50 + i, 0.24, 0.31) + 0.14 * up.max(0.0))
            })
            .collect();
        Self {
            subject,
            relief,
            seed,
            head_from_body,
            stretch,
            strands: (between(20, 22.0, 32.0), between(21, 0.6, 1.4)),
            facets,
        }
    }

    /// Corners of a box around the surface, in heights.
    pub(crate) fn bounds(&self) -> (Vector3<f64>, Vector3<f64>) {
        let [x, y, low, high] = match self.subject {
            Subject::Bust => [0.43, 0.31, -0.01, 1.06],
            Subject::Stone => [0.48, 0.48, -0.01, 1.04],
            Subject::Ellipsoid => [0.40, 0.40, -0.01, 1.01],
        };
        (Vector3::new(-x, -y, low), Vector3::new(x, y, high))
    }

    /// Negative inside, positive outside; about a distance near the surface, in heights.
    pub(crate) fn value(&self, p: &Vector3<f64>) -> f64 {
        match self.subject {
            Subject::Bust => self.bust(p),
            Subject::Stone => self.stone(p),
            Subject::Ellipsoid => {
                ellipsoid(p, [0.0, 0.0, 0.5], [0.36, 0.30, 0.5]) + self.tool_marks(p, 1.0)
            }
        }
    }

    /// Unit normal, outwards.
    pub(crate) fn normal(&self, p: &Vector3<f64>) -> Vector3<f64> {
        // Differences along the corners of a tetrahedron: four evaluations instead of six. The
        // step leaves 1e-4 of curvature and 1e-9 of rounding.
        const STEP: f64 = 2e-7;
        let corners = [
            Vector3::new(1.0, -1.0, -1.0),
            Vector3::new(-1.0, -1.0, 1.0),
            Vector3::new(-1.0, 1.0, -1.0),
            Vector3::new(1.0, 1.0, 1.0),
        ];
        let mut gradient = Vector3::zeros();
        for corner in corners {
            gradient += corner * self.value(&(p + corner * STEP));
        }
        gradient.normalize()
    }

    /// Fine marks of the tool, everywhere: two octaves of noise.
    fn tool_marks(&self, p: &Vector3<f64>, weight: f64) -> f64 {
        if self.relief == 0.0 {
            return 0.0;
        }
        let stretched = Vector3::new(p.x, p.y, 0.6 * p.z);
        let coarse = gradient_noise(&(stretched / 0.045), self.seed ^ 0x51);
        let fine = gradient_noise(&(p / 0.019), self.seed ^ 0x52);
        self.relief * weight * (0.0042 * coarse + 0.0014 * fine)
    }

    fn bust(&self, p: &Vector3<f64>) -> f64 {
        let s = &self.stretch;
        let plinth = union(
            cylinder(p, 0.205 * s[0], 0.0, 0.055, 0.012),
            cylinder(p, 0.125 * s[1], 0.03, 0.24, 0.01),
            0.03,
        );
        if p.z < 0.08 {
            // Far below the chest nothing else reaches into the fillet.
            return plinth + self.tool_marks(p, 0.6);
        }
        let chest = {
            let torso = ellipsoid(p, [0.0, 0.015, 0.31], [0.37 * s[2], 0.185, 0.20]);
            intersection(torso, 0.175 - p.z + 0.25 * p.y, 0.05)
        };
        // Folds of the garment: waves that run round the neck, bent by noise.
        let bend = gradient_noise(&(p / 0.22), self.seed ^ 0x61);
        let fold = (std::f64::consts::TAU * (p.x.hypot(p.z - 0.55) / 0.062 + 1.6 * bend)).sin();
        let folds = 0.0075 * self.relief * (1.0 - smoothstep(0.36, 0.46, p.z)) * fold;
        let body = union(plinth, chest + folds, 0.04);

        let neck = capsule(p, [0.0, 0.03, 0.40], [0.0, 0.02, 0.64], 0.115, 0.09 * s[3]);
        let body = union(body, neck, 0.07);
        if p.z < 0.44 {
            return body + self.tool_marks(p, 1.0);
        }
        let pivot = Vector3::new(0.0, 0.0, 0.6);
        let q = self.head_from_body * (p - pivot) + pivot;
        let (head, hairiness) = self.head(&q);
        let marks = self.tool_marks(p, 0.55 + 0.45 * hairiness);
        union(body, head, 0.05) + marks
    }

    /// The head in its own frame, and how much of the place is hair.
    fn head(&self, p: &Vector3<f64>) -> (f64, f64) {
        let s = &self.stretch;
        // The face is symmetric: one side is evaluated.
        let m = Vector3::new(p.x.abs(), p.y, p.z);
        let mut f = ellipsoid(p, [0.0, 0.01, 0.775], [0.148 * s[4], 0.185, 0.20]);
        let join = |f, q, center, radii, fillet| union(f, ellipsoid(q, center, radii), fillet);
        f = join(f, p, [0.0, -0.085, 0.645], [0.085, 0.085, 0.09], 0.09);
        f = join(f, &m, [0.072, -0.105, 0.705], [0.055, 0.06, 0.06], 0.05);
        let tip = [0.0, -0.218 * s[5], 0.715];
        let nose = capsule(p, [0.0, -0.170, 0.815], tip, 0.016, 0.026);
        f = union(f, nose, 0.035);
        f = join(f, &m, [0.022, -0.192, 0.708], [0.018, 0.022, 0.016], 0.015);
        let ends = ([0.022, -0.172, 0.826], [0.096, -0.132, 0.82]);
        let brow = capsule(&m, ends.0, ends.1, 0.016, 0.012);
        f = union(f, brow, 0.03);
        let socket = ellipsoid(&m, [0.06, -0.187, 0.787], [0.036, 0.034, 0.026]);
        f = intersection(f, -socket, 0.03);
        // Eye, lips, ear.
        f = join(f, &m, [0.058, -0.143, 0.785], [0.030, 0.028, 0.022], 0.006);
        f = join(f, p, [0.0, -0.165, 0.662], [0.046, 0.022, 0.010], 0.010);
        f = join(f, p, [0.0, -0.163, 0.640], [0.038, 0.022, 0.011], 0.010);
        f = join(f, &m, [0.150, 0.02, 0.755], [0.022, 0.036, 0.058], 0.015);

        // Hair: a shell behind the hairline, carved in strands that run down from the crown.
        let shell = ellipsoid(p, [0.0, 0.03, 0.80], [0.172, 0.192, 0.195]);
        let hairline = -(0.75 * (p.y + 0.055) + 0.66 * (p.z - 0.80));
        let hair = intersection(shell, hairline, 0.035);
        let hairiness = smoothstep(-0.012, 0.012, f - hair);
        if hairiness > 0.0 {
            let bend = gradient_noise(&(p / 0.13), self.seed ^ 0x71);
            let angle = p.x.atan2(p.y + 0.02) / std::f64::consts::TAU;
            // Near the crown the strands would become infinitely fine.
            let spread = smoothstep(0.045, 0.15, p.x.hypot(p.y + 0.02));
            let phase = self.strands.0 * angle + self.strands.1 * (bend + 4.0 * (p.z - 0.8));
            let strand = (std::f64::consts::TAU * phase).sin();
            let tuft = gradient_noise(
                &(Vector3::new(p.x, p.y, 0.5 * p.z) / 0.05),
                self.seed ^ 0x72,
            );
            let carved = hair + self.relief * (0.0060 * spread * strand + 0.007 * tuft);
            f = union(f, carved, 0.008);
        }
        (f, hairiness)
    }

    fn stone(&self, p: &Vector3<f64>) -> f64 {
        let mut f = ellipsoid(p, [0.0, 0.0, 0.46], [0.40, 0.36, 0.54]);
        for (normal, offset) in &self.facets {
            let plane = normal.dot(&(p - Vector3::new(0.0, 0.0, 0.46))) - offset;
            f = intersection(f, plane, 0.06);
        }
        f = intersection(f, -p.z, 0.01);
        let weathered = gradient_noise(&(p / 0.24), self.seed ^ 0x81)
            + 0.5 * gradient_noise(&(p / 0.11), self.seed ^ 0x82);
        let bent = p.z / 0.07 + 0.8 * gradient_noise(&(p / 0.2), self.seed ^ 0x83);
        let layers = (std::f64::consts::TAU * bent).sin();
        f + self.relief * (0.014 * weathered + 0.005 * layers) + self.tool_marks(p, 1.3)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normals_are_the_gradient_and_the_value_is_about_a_distance() {
        for subject in [Subject::Bust, Subject::Stone, Subject::Ellipsoid] {
            let shape = Shape::new(subject, 1.0, 5);
            let (mut checked, mut worst) = (0, 0.0_f64);
            for i in 0..400 {
                // March inwards from a random direction until the sign changes.
                let a = std::f64::consts::TAU * unit([i, 0, 0, 9]);
                let direction = Vector3::new(a.cos(), a.sin(), 0.0);
                let z = 0.1 + 0.8 * unit([i, 1, 0, 9]);
                let at = |t: f64| direction * t + Vector3::new(0.0, 0.0, z);
                let mut t = 0.6;
                for _ in 0..200 {
                    t -= 0.5 * shape.value(&at(t));
                }
                let p = at(t);
                if shape.value(&p).abs() > 1e-6 {
                    continue;
                }
                let n = shape.normal(&p);
                let h = 1e-5;
                let slope = (shape.value(&(p + n * h)) - shape.value(&(p - n * h))) / (2.0 * h);
                assert!((0.3..2.5).contains(&slope), "{subject:?} {p:?}: {slope}");
                let mut numeric = Vector3::zeros();
                for axis in 0..3 {
                    let mut e = Vector3::zeros();
                    e[axis] = 1e-6;
                    numeric[axis] = shape.value(&(p + e)) - shape.value(&(p - e));
                }
                worst = worst.max(numeric.normalize().angle(&n));
                checked += 1;
            }
            assert!(checked > 300, "{subject:?}: {checked}");
            assert!(worst < 2e-3, "{subject:?}: {worst} rad");
        }
    }
}
