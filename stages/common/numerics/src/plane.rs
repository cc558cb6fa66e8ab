//! Planes through points.

use nalgebra::{Matrix3, Point3, Vector3};

/// A plane through points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    /// Unit normal, of either sign.
    pub normal: Vector3<f64>,
    /// A point on it: the mean of its points.
    pub at: Point3<f64>,
    /// Standard deviation of the normal, radians.
    pub sigma: f64,
    /// Points that it was fitted to.
    pub num_points: usize,
}

impl Plane {
    /// The plane by least squares: its normal is the eigenvector of the smallest eigenvalue of the points' scatter, with
    /// the standard deviation `√(λ₀ / (N λ₁))`. `None` when the points lie on a line or are fewer than three.
    pub fn through(points: &[Point3<f64>]) -> Option<Self> {
        let at = mean(points);
        let scatter = points.iter().fold(Matrix3::zeros(), |sum, p| {
            let d = p - at;
            sum + d * d.transpose()
        });
        let eigen = scatter.symmetric_eigen();
        let mut order = [0, 1, 2];
        order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
        let [least, second] = [order[0], order[1]].map(|k| eigen.eigenvalues[k].max(0.0));
        if points.len() < 3 || second.is_nan() || second <= 16.0 * least {
            return None;
        }
        Some(Self {
            normal: eigen.eigenvectors.column(order[0]).into_owned(),
            at,
            sigma: (least / (points.len() as f64 * second)).sqrt(),
            num_points: points.len(),
        })
    }

    /// The plane that most of the points lie within `limit` of, among those that may be by their normal and a point on them:
    /// by `num_triples` random triples, always the same for the same number of points, and a fit to those near it.
    pub fn of_most(
        points: &[Point3<f64>],
        limit: f64,
        num_triples: usize,
        may_be: impl Fn(&Vector3<f64>, &Point3<f64>) -> bool,
    ) -> Option<Self> {
        if points.len() < 3 {
            return None;
        }
        let near = |normal: &Vector3<f64>, at: &Point3<f64>| {
            let (normal, at) = (*normal, *at);
            let is_near = move |p: &&Point3<f64>| (*p - at).dot(&normal).abs() <= limit;
            points.iter().filter(is_near).copied()
        };
        let mut best = (0, Vector3::zeros(), Point3::origin());
        for triple in crate::random::triples(points.len()).take(num_triples) {
            let [a, b, c] = triple.map(|k| points[k]);
            let Some(normal) = (b - a).cross(&(c - a)).try_normalize(limit * limit) else {
                continue;
            };
            if !may_be(&normal, &a) {
                continue;
            }
            let support = near(&normal, &a).count();
            if support > best.0 {
                best = (support, normal, a);
            }
        }
        if best.0 == 0 {
            return None;
        }
        let first = Self::through(&near(&best.1, &best.2).collect::<Vec<_>>())?;
        Self::through(&near(&first.normal, &first.at).collect::<Vec<_>>())
            .filter(|plane| may_be(&plane.normal, &plane.at))
    }

    /// Signed distance of a point, on the side of the normal.
    pub fn distance(&self, point: &Point3<f64>) -> f64 {
        (point - self.at).dot(&self.normal)
    }

    /// The same plane with its normal on the side where the points' mean lies.
    #[must_use]
    pub fn facing(self, points: &[Point3<f64>]) -> Self {
        let sum: f64 = points.iter().map(|p| self.distance(p)).sum();
        Self {
            normal: self.normal * sum.signum(),
            ..self
        }
    }
}

fn mean(points: &[Point3<f64>]) -> Point3<f64> {
    let sum: Vector3<f64> = points.iter().map(|p| p.coords).sum();
    Point3::from(sum / points.len().max(1) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A grid on `z = 0.1 x + 2`, and as many points again off it.
    fn scene() -> Vec<Point3<f64>> {
        let at = |k: usize| [(k % 20) as f64, (k / 20) as f64];
        let on = (0..400)
            .map(at)
            .map(|[x, y]| Point3::new(x, y, 0.1 * x + 2.0));
        let off = (0..300).map(|k| (k, at(k)));
        let off =
            off.map(|(k, [x, y])| Point3::new(x, y, 3.5 + 7.0 * ((k * k) as f64 * 0.37).sin()));
        on.chain(off).collect()
    }

    #[test]
    fn the_plane_of_most_points_is_found_among_others() {
        let plane = Plane::of_most(&scene(), 0.01, 300, |_, _| true).unwrap();
        let expected = Vector3::new(-0.1, 0.0, 1.0).normalize();
        assert!(plane.normal.cross(&expected).norm() < 1e-3, "{plane:?}");
        assert!((400..420).contains(&plane.num_points), "{plane:?}");
        let above = plane.facing(&[Point3::new(0.0, 0.0, 9.0)]);
        assert!(above.distance(&Point3::new(0.0, 0.0, 3.0)) > 0.9);
    }

    #[test]
    fn no_plane_is_found_where_none_may_be() {
        assert_eq!(Plane::of_most(&scene(), 0.01, 300, |_, _| false), None);
    }

    #[test]
    fn points_on_a_line_have_no_plane_and_planes_that_may_not_be_are_not_found() {
        let line: Vec<_> = (0..50)
            .map(|k| Point3::new(k as f64, 2.0 * k as f64, 1.0))
            .collect();
        assert_eq!(Plane::of_most(&line, 0.01, 100, |_, _| true), None);
        let steep = |normal: &Vector3<f64>, _: &Point3<f64>| normal.z.abs() < 0.5;
        let found = Plane::of_most(&scene(), 0.01, 300, steep);
        assert!(
            found.is_none_or(|plane| plane.normal.z.abs() < 0.5),
            "{found:?}"
        );
        assert_eq!(Plane::through(&line[..2]), None);
    }
}
