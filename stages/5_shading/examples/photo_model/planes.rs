//! Normals of references that have none of their own.

use nalgebra::Matrix3;
use rilievo_scene::{DepthMap, Intrinsics, Raster};

/// Normals of planes fitted to the points of a window, for references without normals of their own.
pub fn plane_normals(depth: &DepthMap, k: &Intrinsics, half: isize) -> Raster<[f32; 3]> {
    use rayon::prelude::*;
    let rows: Vec<Vec<[f32; 3]>> = (0..depth.height as isize)
        .into_par_iter()
        .map(|y| {
            (0..depth.width as isize)
                .map(|x| {
                    if *depth.at(x as usize, y as usize) <= 0.0 {
                        return [0.0; 3];
                    }
                    let (mut sum, mut square, mut count) =
                        (nalgebra::Vector3::zeros(), Matrix3::zeros(), 0.0);
                    for dy in -half..=half {
                        for dx in -half..=half {
                            if let Some(&z) = depth.get(x + dx, y + dy)
                                && z > 0.0
                            {
                                let p = nalgebra::Vector3::new(
                                    ((x + dx) as f64 - k.cx) / k.fx,
                                    ((y + dy) as f64 - k.cy) / k.fy,
                                    1.0,
                                ) * f64::from(z);
                                sum += p;
                                square += p * p.transpose();
                                count += 1.0;
                            }
                        }
                    }
                    if count < ((2 * half + 1) * (2 * half + 1)) as f64 * 0.7 {
                        return [0.0; 3];
                    }
                    let mean = sum / count;
                    let eigen = (square / count - mean * mean.transpose()).symmetric_eigen();
                    let n = eigen
                        .eigenvectors
                        .column(eigen.eigenvalues.imin())
                        .into_owned();
                    let n = if n.dot(&mean) > 0.0 { -n } else { n };
                    [n.x as f32, n.y as f32, n.z as f32]
                })
                .collect()
        })
        .collect();
    Raster {
        width: depth.width,
        height: depth.height,
        data: rows.concat(),
    }
}
