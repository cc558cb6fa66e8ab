//! Errors over the whole truth mask, by region.
//!
//! A pixel without a normal counts as 90°. Regions, the first that holds:
//! `alone` no other view sees the point, `border` within five pixels of the mask's border, `edge` within
//! five pixels of a jump of depth, `inner` the rest.

use super::input::Input;
use super::picture;
use super::planes::plane_normals;
use rilievo_scene::{DepthMap, Raster, ShadedViews};
use std::error::Error;
use std::path::Path;

const NAMES: [&str; 4] = ["inner", "edge", "border", "alone"];
/// Half-width of the planes of a reference without normals: a smooth fused surface.
const HALF_WINDOW_PX: isize = 10;

/// Region of every pixel of every view, an index into `NAMES`.
pub fn regions(input: &Input) -> Vec<Raster<u8>> {
    (0..input.truth.len())
        .map(|i| {
            let depth = &input.truth[i].0;
            let focal = input.posed.views[i].intrinsics.fx;
            let outside = Raster::from_fn(depth.width, depth.height, |x, y| {
                *depth.at(x, y) <= 0.0
                    || x == 0
                    || y == 0
                    || x + 1 == depth.width
                    || y + 1 == depth.height
            });
            let (border, edge) = (widened(&outside), widened(&jumps(depth, focal)));
            Raster::from_fn(depth.width, depth.height, |x, y| {
                if *depth.at(x, y) <= 0.0 {
                    0
                } else if is_alone(input, i, x, y) {
                    3
                } else if *border.at(x, y) {
                    2
                } else {
                    u8::from(*edge.at(x, y))
                }
            })
        })
        .collect()
}

/// Pixels whose depth jumps to a neighbour by more than six pixel footprints.
fn jumps(depth: &DepthMap, focal: f64) -> Raster<bool> {
    Raster::from_fn(depth.width, depth.height, |x, y| {
        let z = *depth.at(x, y);
        [(1, 0), (0, 1)].iter().any(|&(dx, dy)| {
            depth
                .get(x as isize + dx, y as isize + dy)
                .is_some_and(|&other| {
                    z > 0.0 && other > 0.0 && (f64::from(other / z) - 1.0).abs() * focal > 6.0
                })
        })
    })
}

fn widened(set: &Raster<bool>) -> Raster<bool> {
    const RADIUS_PX: usize = 5;
    let wide = Raster::from_fn(set.width, set.height, |x, y| {
        (x.saturating_sub(RADIUS_PX)..=(x + RADIUS_PX).min(set.width - 1)).any(|a| *set.at(a, y))
    });
    Raster::from_fn(set.width, set.height, |x, y| {
        (y.saturating_sub(RADIUS_PX)..=(y + RADIUS_PX).min(set.height - 1)).any(|b| *wide.at(x, b))
    })
}

fn is_alone(input: &Input, view: usize, x: usize, y: usize) -> bool {
    // Depth difference of a point that another view sees, relative.
    const TOLERANCE: f64 = 0.005;
    let here = &input.posed.views[view];
    let z = f64::from(*input.truth[view].0.at(x, y));
    let k = &here.intrinsics;
    let ray = nalgebra::Vector3::new((x as f64 - k.cx) / k.fx, (y as f64 - k.cy) / k.fy, 1.0);
    let pose = &here.cam_from_world;
    let world = pose.rotation_matrix().tr_mul(&(ray * z - pose.translation));
    !input.posed.views.iter().enumerate().any(|(j, there)| {
        let p = there.cam_from_world.rotation_matrix() * world + there.cam_from_world.translation;
        let k = &there.intrinsics;
        let (u, v) = (k.fx * p.x / p.z + k.cx, k.fy * p.y / p.z + k.cy);
        j != view
            && p.z > 0.0
            && input.truth[j]
                .0
                .get(u.round() as isize, v.round() as isize)
                .is_some_and(|&other| (f64::from(other) / p.z - 1.0).abs() < TOLERANCE)
    })
}

fn quantile(values: &mut [f64], share: f64) -> f64 {
    rilievo_numerics::robust::quantile(values, share).unwrap_or(f64::NAN)
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// One line of accuracy; pictures into `pictures`, where given.
pub fn evaluate(
    input: &Input,
    regions: &[Raster<u8>],
    shaded: &ShadedViews,
    pictures: Option<&Path>,
) -> Result<String, Box<dyn Error>> {
    let (mut angles, mut ratios, mut missing) = (Vec::new(), Vec::new(), 0usize);
    let mut by_region: [Vec<f64>; 4] = Default::default();
    let mut per_view = String::new();
    for (i, view) in shaded.views.iter().enumerate() {
        let (depth, normal) = &input.truth[i];
        let k = &input.posed.views[i].intrinsics;
        let planes = normal.is_none().then(|| {
            (
                plane_normals(depth, k, HALF_WINDOW_PX),
                plane_normals(&view.depth, k, HALF_WINDOW_PX),
            )
        });
        let (reference, estimate) = match (normal, &planes) {
            (Some(n), _) => (n, &view.normal),
            (None, Some((a, b))) => (a, b),
            (None, None) => continue,
        };
        let mut error = Raster::filled(depth.width, depth.height, -1.0_f32);
        let mut own = Vec::new();
        for p in 0..depth.data.len() {
            if depth.data[p] <= 0.0 {
                continue;
            }
            if view.depth.data[p] > 0.0 {
                ratios.push(f64::from(view.depth.data[p] / depth.data[p]));
            } else {
                missing += 1;
            }
            let (a, b) = (reference.data[p], estimate.data[p]);
            if a == [0.0; 3] || (b == [0.0; 3] && planes.is_some()) {
                continue;
            }
            let dot: f64 = (0..3).map(|c| f64::from(a[c]) * f64::from(b[c])).sum();
            let angle = if b == [0.0; 3] {
                90.0
            } else {
                dot.clamp(-1.0, 1.0).acos().to_degrees()
            };
            error.data[p] = angle as f32;
            own.push(angle);
            by_region[usize::from(regions[i].data[p])].push(angle);
        }
        per_view += &format!(" {:.2}", mean(&own));
        angles.extend(own);
        if let Some(out) = pictures {
            std::fs::create_dir_all(out)?;
            picture::save(out, &view.name, &error, &view.normal, &view.depth, depth)?;
        }
    }
    let scale = quantile(&mut ratios, 0.5);
    let mut errors: Vec<f64> = ratios
        .iter()
        .map(|r| 100.0 * (r / scale - 1.0).abs())
        .collect();
    let shares: Vec<String> = NAMES
        .iter()
        .zip(&by_region)
        .map(|(name, own)| {
            let share = 100.0 * own.len() as f64 / angles.len().max(1) as f64;
            format!("{name} {:.2} ({share:.1} %)", mean(own))
        })
        .collect();
    Ok(format!(
        "normals {:.2} / {:.2} deg [{}]  depth {:.3} / {:.3} %  complete {:.4} |{per_view}",
        mean(&angles),
        quantile(&mut angles, 0.5),
        shares.join(", "),
        quantile(&mut errors, 0.5),
        quantile(&mut errors, 0.9),
        1.0 - missing as f64 / (missing + ratios.len()).max(1) as f64,
    ))
}
