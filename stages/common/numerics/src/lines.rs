//! Lines in space.

use nalgebra::{Matrix3, Point3, Vector3};

/// Sums of the normal equations of the point nearest to all lines, each a point and a unit direction `d`:
/// `Σ (I − d dᵀ) x = Σ (I − d dᵀ) c`.
pub fn normal_equations(
    lines: impl IntoIterator<Item = (Point3<f64>, Vector3<f64>)>,
) -> (Matrix3<f64>, Vector3<f64>) {
    let mut matrix = Matrix3::zeros();
    let mut right = Vector3::zeros();
    for (center, direction) in lines {
        let across = Matrix3::identity() - direction * direction.transpose();
        matrix += across;
        right += across * center.coords;
    }
    (matrix, right)
}

/// The point nearest to all lines; `None` where they are parallel.
pub fn nearest_point(
    lines: impl IntoIterator<Item = (Point3<f64>, Vector3<f64>)>,
) -> Option<Point3<f64>> {
    let (matrix, right) = normal_equations(lines);
    Some(Point3::from(matrix.try_inverse()? * right))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_meet_where_they_cross_and_halfway_where_they_pass() {
        let along_x = (Point3::new(-3.0, 1.0, 0.0), Vector3::x());
        let along_y = (Point3::new(2.0, 5.0, 1.0), Vector3::y());
        let found = nearest_point([along_x, along_y]).unwrap();
        assert!(
            (found - Point3::new(2.0, 1.0, 0.5)).norm() < 1e-12,
            "{found}"
        );
        assert_eq!(nearest_point([along_x, along_x]), None);
        assert_eq!(nearest_point([]), None);
    }
}
