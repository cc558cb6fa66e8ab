//! Normals of planes fitted to windows of a depth map.
//!
//! On a plane `a X + b Y + c Z = 1`, the inverse depth `1/z = a u + b v + c` is linear in the
//! normalised pixel `(u, v)`, so that each window is a 3×3 normal system, and `n ∝ −(a, b, c)`.

use nalgebra::{Matrix3, Point2, Vector3};
use rilievo_scene::{DepthMap, Intrinsics, NormalMap, Raster};

/// Half the side of the windows of planes, pixels: 21×21, about the detail that a stereo surface
/// of a hand-sized object resolves.
pub(super) const PLANE_HALF_WINDOW_PX: usize = 10;
/// Share of a window that must be filled for its plane to count.
const MIN_WINDOW_SHARE: f64 = 0.3;

/// Normals of planes fitted to the depths inside `mask` over windows of `2 half + 1` pixels.
pub fn plane_normals(
    depth: &DepthMap,
    mask: &Raster<bool>,
    intrinsics: &Intrinsics,
    half: usize,
) -> NormalMap {
    let (width, height) = (depth.width, depth.height);
    // Moments of each pixel: uu, uv, vv, u, v, 1, u/z, v/z, 1/z.
    let moments = |x: usize, y: usize| -> [f64; 9] {
        if !*mask.at(x, y) {
            return [0.0; 9];
        }
        let n = intrinsics.normalized(&Point2::new(x as f64, y as f64));
        let w = 1.0 / f64::from(*depth.at(x, y));
        [
            n.x * n.x,
            n.x * n.y,
            n.y * n.y,
            n.x,
            n.y,
            1.0,
            n.x * w,
            n.y * w,
            w,
        ]
    };
    // Sums over the window's rows, per column; then a sliding sum over its columns.
    let mut columns = vec![[0.0; 9]; width];
    let add_row = |columns: &mut [[f64; 9]], y: usize, sign: f64| {
        for (x, column) in columns.iter_mut().enumerate() {
            for (sum, m) in column.iter_mut().zip(moments(x, y)) {
                *sum += sign * m;
            }
        }
    };
    for y in 0..half.min(height) {
        add_row(&mut columns, y, 1.0);
    }
    let mut normals = NormalMap::filled(width, height, [0.0; 3]);
    let full = ((2 * half + 1) * (2 * half + 1)) as f64;
    for y in 0..height {
        if y + half < height {
            add_row(&mut columns, y + half, 1.0);
        }
        if y > half {
            add_row(&mut columns, y - half - 1, -1.0);
        }
        let mut window = [0.0; 9];
        let slide = |window: &mut [f64; 9], x: usize, sign: f64| {
            for (sum, c) in window.iter_mut().zip(columns[x]) {
                *sum += sign * c;
            }
        };
        for x in 0..half.min(width) {
            slide(&mut window, x, 1.0);
        }
        for x in 0..width {
            if x + half < width {
                slide(&mut window, x + half, 1.0);
            }
            if x > half {
                slide(&mut window, x - half - 1, -1.0);
            }
            let plane = (*mask.at(x, y) && window[5] > MIN_WINDOW_SHARE * full)
                .then(|| plane_of(&window))
                .flatten();
            if let Some(n) = plane {
                *normals.at_mut(x, y) = [n.x as f32, n.y as f32, n.z as f32];
            }
        }
    }
    normals
}

/// Normal of the plane whose inverse depth fits the window's moments, towards the camera.
fn plane_of(m: &[f64; 9]) -> Option<Vector3<f64>> {
    // About the window's centroid the system is well scaled however far off the axis it lies.
    let (u, v, w) = (m[3] / m[5], m[4] / m[5], m[8] / m[5]);
    let uu = m[0] / m[5] - u * u;
    let uv = m[1] / m[5] - u * v;
    let vv = m[2] / m[5] - v * v;
    let uw = m[6] / m[5] - u * w;
    let vw = m[7] / m[5] - v * w;
    let system = Matrix3::new(uu, uv, 0.0, uv, vv, 0.0, 0.0, 0.0, 1.0);
    let determinant = uu * vv - uv * uv;
    // A window filled along a line only has no plane.
    if determinant.is_nan() || determinant <= 1e-3 * uu * vv {
        return None;
    }
    let slopes = system.try_inverse()? * Vector3::new(uw, vw, 0.0);
    let normal = -Vector3::new(slopes.x, slopes.y, w - slopes.x * u - slopes.y * v);
    normal.try_normalize(0.0)
}
