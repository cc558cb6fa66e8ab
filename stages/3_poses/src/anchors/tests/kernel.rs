//! The patch residual: its derivative, and its minimum from a displaced start.

use super::super::pair::PairGeometry;
use super::super::patch::align;
use super::super::plane::PatchPlane;
use super::super::sampling::{LocalWarp, Workspace, sample_source};
use super::super::working::WorkingView;
use super::scene::{Scene, Settings, Shape, photograph};
use rilievo_numerics::derivatives::jacobian_error;

fn working_views(scene: &Scene) -> Vec<WorkingView> {
    scene
        .posed
        .views
        .iter()
        .zip(&scene.photos.photos)
        .map(|(view, photo)| {
            let image = photo.linear().unwrap();
            WorkingView::new(photo, view, &image, 4.0).unwrap()
        })
        .collect()
}

fn square() -> (Scene, Vec<WorkingView>) {
    let shape = Shape::Square {
        height: 0.1,
        half_side: 0.6,
    };
    let settings = Settings {
        num_views: 3,
        ..Settings::default()
    };
    let scene = photograph(&[shape], &settings);
    let views = working_views(&scene);
    (scene, views)
}

/// True plane of the scene at a working pixel of the first view, by its depth map.
fn true_plane(scene: &Scene, view: &WorkingView, x: usize, y: usize) -> PatchPlane {
    let q = |x: usize, y: usize| {
        let pixel = view.photo_pixel(x as f64, y as f64);
        1.0 / scene.depth(0, [pixel.x, pixel.y]).unwrap()
    };
    PatchPlane {
        x,
        y,
        q: q(x, y),
        qx: 0.5 * (q(x + 1, y) - q(x - 1, y)),
        qy: 0.5 * (q(x, y + 1) - q(x, y - 1)),
    }
}

#[test]
fn derivatives_of_the_residual_agree_with_differences() {
    let (scene, mut views) = square();
    // On a ramp, interpolation and Sobel differences are exact: what remains is the warp.
    let (width, height) = (views[1].camera.width, views[1].camera.height);
    for y in 0..height {
        for x in 0..width {
            views[1].texels[y * width + x] = [0.01 * x as f32 - 0.02 * y as f32, 0.01, -0.02, 1.0];
        }
    }
    let pair = PairGeometry::new(&views[0], 1, &views[1]).unwrap();
    let (x, y) = (views[0].camera.width / 2, views[0].camera.height / 2);
    let plane = true_plane(&scene, &views[0], x, y);
    let mut ws = Workspace::default();
    ws.prepare(10);
    ws.load_template(&views[0], x, y).unwrap();
    let n = ws.len;
    // Unknowns in the unit of the depth's own size, so that one step suits all.
    let unit = [plane.q, 0.01 * plane.q, 0.01 * plane.q];
    let at = |p: &[f64]| PatchPlane {
        q: p[0] * unit[0],
        qx: plane.qx + p[1] * unit[1],
        qy: plane.qy + p[2] * unit[2],
        ..plane
    };
    // Values go through the f64 warp; the ramp is linear, so the residual is too.
    let residual = |p: &[f64], dx: f32, dy: f32| {
        let plane = at(p);
        let q = plane.q + plane.qx * f64::from(dx) + plane.qy * f64::from(dy);
        let (x, y) = (
            plane.x as f64 + f64::from(dx),
            plane.y as f64 + f64::from(dy),
        );
        let h = pair.warp.at(x, y, q);
        0.01 * h.x / h.z - 0.02 * h.y / h.z
    };
    let start = [1.0, 0.0, 0.0];
    let warp = LocalWarp::new(&pair, &at(&start)).unwrap();
    assert!(warp.fits(10, width, height));
    sample_source(&views[1], &warp, &mut ws, 0);
    let mut jacobian = Vec::new();
    for k in 0..n {
        let j = f64::from(ws.slope[k]);
        jacobian.extend([
            j * unit[0],
            j * f64::from(ws.dx[k]) * unit[1],
            j * f64::from(ws.dy[k]) * unit[2],
        ]);
    }
    let error = jacobian_error(
        &start,
        n,
        |p, out| {
            for (value, (&dx, &dy)) in out.iter_mut().zip(ws.dx.iter().zip(&ws.dy)) {
                *value = residual(p, dx, dy);
            }
        },
        &jacobian,
    );
    assert!(error < 1e-4, "{error:.2e}");
    // And the sampled values are those of the warp.
    let center = f64::from(views[1].texel(warp.center().0, warp.center().1)[0]);
    for k in 0..n {
        let sampled = f64::from(ws.residual[0][k]) + f64::from(ws.template[k]) + center;
        let direct = residual(&start, ws.dx[k], ws.dy[k]);
        assert!((sampled - direct).abs() < 1e-4, "{sampled} {direct}");
    }
}

#[test]
fn alignment_finds_the_plane_from_a_displaced_start() {
    let (scene, views) = square();
    let pairs: Vec<PairGeometry> = (1..3)
        .map(|k| PairGeometry::new(&views[0], k, &views[k]).unwrap())
        .collect();
    let sources: Vec<&PairGeometry> = pairs.iter().collect();
    let mut ws = Workspace::default();
    let (x, y) = (
        views[0].camera.width / 2 + 9,
        views[0].camera.height / 2 - 5,
    );
    let truth = true_plane(&scene, &views[0], x, y);
    let px = pairs[0].px_per_inverse_depth(x as f64, y as f64, truth.q);
    let start = PatchPlane {
        q: truth.q + 1.5 / px,
        qx: 0.0,
        qy: 0.0,
        ..truth
    };
    let found = align(&views, 0, &sources, &start, 14, &mut ws).unwrap();
    let error_px = (found.plane.q - truth.q).abs() * px;
    let slope_error = (found.plane.qx - truth.qx).hypot(found.plane.qy - truth.qy) / truth.q
        * views[0].camera.focal();
    assert!(
        error_px < 0.02 && slope_error < 0.02,
        "{error_px:.4} px, slope {slope_error:.4}"
    );
    assert!(found.correlation > 0.99 && found.num_sources == 2);
}
