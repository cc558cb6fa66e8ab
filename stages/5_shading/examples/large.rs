//! Time and memory of one large colour view from an anchored start: `large [MEGAPIXELS]`.

use rilievo_scene::{Intrinsics, Lighting, LinearImage, Mask, Silent, SphericalHarmonics};
use rilievo_shading::{DepthAnchor, ShadingOptions, ShadingProblem, ShadingView, ViewLight, solve};
use std::sync::Arc;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let megapixels: f64 = std::env::args().nth(1).map_or(Ok(12.0), |v| v.parse())?;
    let height = (megapixels * 1e6 * 0.75).sqrt() as usize;
    let width = height * 4 / 3;
    let focal = 1.2 * width as f64;
    let (cx, cy) = (width as f64 / 2.0, height as f64 / 2.0);
    // Relief in pixels of log depth times focal length; waves of fixed share of the frame.
    let wave = height as f64 / 12.0;
    let unknown = |x: f64, y: f64| 0.5 * wave * (x / wave).sin() * (0.8 * y / wave).cos();
    let rows = [
        [-0.2, -0.2, -1.0, 0.4, 0.1, -0.1, -0.1, -0.1, 0.05],
        [0.0, 0.2, -1.0, 0.3, 0.0, 0.2, 0.1, 0.0, 0.1],
        [0.2, -0.2, -1.0, 0.2, -0.1, 0.0, 0.0, 0.1, 0.0],
    ]
    .map(SphericalHarmonics);
    let normal = |x: f64, y: f64| {
        let p = 0.5 * (x / wave).cos() * (0.8 * y / wave).cos();
        let q = -0.4 * (x / wave).sin() * (0.8 * y / wave).sin();
        let (u, v) = ((x - cx) / focal, (y - cy) / focal);
        nalgebra::Vector3::new(p, q, -1.0 - u * p - v * q).normalize()
    };
    let mut image = LinearImage::filled(width, height, 3, 0.0);
    for y in 0..height {
        for x in 0..width {
            let n = normal(x as f64, y as f64);
            for (c, row) in rows.iter().enumerate() {
                image.pixel_mut(x, y)[c] = row.evaluate(&n) as f32;
            }
        }
    }
    let mut view = ShadingView::new(
        "large",
        Arc::new(image),
        Mask::filled(width, height, true),
        Intrinsics::pinhole(width, height, focal, cx, cy),
        ViewLight::Uniform(Lighting {
            channels: rows.to_vec(),
        }),
    );
    for k in 0..400_usize {
        let x = (0.02 + 0.96 * ((k * 197) % 400) as f64 / 400.0) * width as f64;
        let y = (0.02 + 0.96 * ((k * 71 + 13) % 400) as f64 / 400.0) * height as f64;
        view.anchors.push(DepthAnchor {
            pixel: [x, y],
            depth: (unknown(x, y) / focal).exp(),
            sigma_ln_depth: 0.5 / focal,
        });
    }
    let problem = ShadingProblem {
        views: vec![view],
        matches: Vec::new(),
    };
    let solution = solve(&problem, &ShadingOptions::default(), &Silent)?;
    let facts = &solution.report.views[0];
    let normals = &solution.views[0].normal;
    let (mut sum, mut count) = (0.0, 0);
    for y in (0..height).step_by(7) {
        for x in (0..width).step_by(7) {
            if let Some(n) = normals.normal(x, y) {
                let cosine = n.dot(&normal(x as f64, y as f64)).clamp(-1.0, 1.0);
                sum += cosine.acos().to_degrees();
                count += 1;
            }
        }
    }
    let memory = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let peak = memory
        .lines()
        .find(|line| line.starts_with("VmHWM"))
        .unwrap_or("peak memory unknown");
    println!(
        "{width}x{height}: {:.1} s (start {:.1}, theta {:.1}, z {:.1}), mean angle {:.3} deg, {peak}",
        facts.seconds.total,
        facts.seconds.start,
        facts.seconds.theta,
        facts.seconds.z,
        sum / f64::from(count.max(1)),
    );
    Ok(())
}
