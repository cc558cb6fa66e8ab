//! Where the errors lie: a map per view, and the cloud coloured by its signed distance from the
//! true surface.
//!
//! A point `p` whose nearest true triangle has the corner `a` and the outward normal `n` deviates by
//! `±|p − M|`, positive where `n·(p − a) > 0`: material where there is none.

use super::estimate::Estimate;
use crate::exit::Failure;
use crate::report::ViewErrors;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use rilievo_io::write_cloud_ply;
use rilievo_scene::{Mesh, PointCloud, Raster, WorldCoordinates};
use rilievo_synthetic::compare::{MeshDistance, Similarity, TruthView};
use std::path::Path;

/// Error maps of the views that have both maps and truth, "no value" being negative.
pub(super) fn maps(
    estimate: &Estimate,
    views: &[TruthView],
    scale: f64,
) -> Result<Vec<ViewErrors>, Failure> {
    let mut errors = Vec::new();
    for truth in views {
        let (width, height) = truth.maps.size();
        let Some(depth) = estimate.depth(&truth.name)? else {
            continue;
        };
        if (depth.width, depth.height) != (width, height) {
            continue;
        }
        let depth_rel = truth.maps.depth().map(|true_depth| {
            Raster::from_fn(width, height, |x, y| {
                let (found, z) = (f64::from(*depth.at(x, y)), f64::from(*true_depth.at(x, y)));
                if found > 0.0 && z > 0.0 {
                    ((scale * found - z) / z).abs() as f32
                } else {
                    -1.0
                }
            })
        });
        let normal = estimate.normal(&truth.name)?;
        let normal_deg = match (truth.maps.normal(), normal) {
            (Some(t), Some(n)) if (n.width, n.height) == (width, height) => {
                Some(Raster::from_fn(width, height, |x, y| {
                    let compared = *depth.at(x, y) > 0.0 && truth.maps.is_known(x, y);
                    match (n.normal(x, y), t.normal(x, y)) {
                        (Some(a), Some(b)) if compared => a.angle(&b).to_degrees() as f32,
                        _ => -1.0,
                    }
                }))
            }
            _ => None,
        };
        errors.push(ViewErrors {
            name: truth.name.clone(),
            depth_rel,
            normal_deg,
        });
    }
    Ok(errors)
}

/// Signed distances of the cloud's points from the true surface, truth's unit.
pub(super) fn deviations(
    cloud: &PointCloud,
    surface: &Mesh,
    similarity: &Similarity,
    spacing: f64,
) -> Vec<f64> {
    let Some(distance) = MeshDistance::new(surface, spacing) else {
        return Vec::new();
    };
    let corner = |v: u32| Vector3::from(surface.vertices[v as usize].map(f64::from));
    cloud
        .points
        .par_iter()
        .map(|point| {
            let p = similarity.apply(&Point3::from(point.position.map(f64::from)));
            let (size, triangle) = distance.nearest(&p);
            let [a, b, c] = surface.triangles[triangle].map(corner);
            let normal = (b - a).cross(&(c - a));
            size.copysign(normal.dot(&(p.coords - a)))
        })
        .collect()
}

/// Writes the cloud coloured from blue (inside by `max` or more) over white to red (outside).
pub(super) fn write_deviations(
    path: &Path,
    cloud: &PointCloud,
    deviations: &[f64],
    max: f64,
    world: WorldCoordinates,
) -> Result<(), Failure> {
    let points = cloud.points.iter().zip(deviations).map(|(point, &d)| {
        let mut point = *point;
        point.color = diverging(d / max);
        point
    });
    let colored = PointCloud {
        points: points.collect(),
    };
    write_cloud_ply(path, &colored, world).map_err(Failure::from)
}

/// Blue at −1, white at 0, red at 1: distinct for the colour-blind too.
fn diverging(share: f64) -> [u8; 3] {
    const INSIDE: [f64; 3] = [33.0, 102.0, 172.0];
    const OUTSIDE: [f64; 3] = [178.0, 24.0, 43.0];
    let end = if share < 0.0 { INSIDE } else { OUTSIDE };
    // What is no number is as far as can be.
    let t = if share.is_nan() {
        1.0
    } else {
        share.abs().min(1.0)
    };
    end.map(|e| (255.0 + t * (e - 255.0)).round() as u8)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rilievo_scene::CloudPoint;

    #[test]
    fn outside_is_positive_and_red() {
        let surface = Mesh {
            vertices: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            triangles: vec![[0, 1, 2]],
            ..Mesh::default()
        };
        let points = [0.02, -0.01].map(|z| CloudPoint {
            position: [0.25, 0.25, z],
            normal: [0.0, 0.0, 1.0],
            color: [0; 3],
            confidence: 1.0,
            num_views: 2,
        });
        let cloud = PointCloud {
            points: points.to_vec(),
        };
        let found = deviations(&cloud, &surface, &Similarity::identity("test"), 0.05);
        assert!(
            (found[0] - 0.02).abs() < 1e-7 && (found[1] + 0.01).abs() < 1e-7,
            "{found:?}"
        );
        assert_eq!(diverging(1.0), [178, 24, 43]);
        assert_eq!(diverging(-2.0), [33, 102, 172]);
        assert_eq!(diverging(0.0), [255; 3]);
    }
}
