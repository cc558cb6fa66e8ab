//! RGB-D refinement: `rgbd_refine DATA_DIR [column-major]`, with the folder's `image.png`, `mask.png`, `depth.exr`
//! and `camera.json`, at the authors' settings: albedo 1, nine harmonics fitted on the rough depth,
//! weights shading 1, prior on log depth 500, area 0.05. `column-major` reads a depth file whose
//! values were written column by column.

use nalgebra::{SMatrix, SVector, Vector3};
use rilievo_scene::{DepthMap, Intrinsics, Lighting, LinearImage, Silent, SphericalHarmonics};
use rilievo_shading::paper::{
    DepthPrior, PaperOptions, ShadingProblem, ShadingView, ViewLight, solve,
};
use std::path::Path;
use std::sync::Arc;

type Failure = Box<dyn std::error::Error>;

fn main() -> Result<(), Failure> {
    let folder = std::env::args()
        .nth(1)
        .ok_or("usage: rgbd_refine DATA_DIR")?;
    let folder = Path::new(&folder);
    let camera: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(folder.join("camera.json"))?)?;
    let k = |row: usize, column: usize| camera["K"][row][column].as_f64().unwrap_or(f64::NAN);
    let rgb = image::open(folder.join("image.png"))?.to_rgb8();
    let (width, height) = (rgb.width() as usize, rgb.height() as usize);
    let image = LinearImage {
        width,
        height,
        channels: 3,
        data: rgb
            .into_raw()
            .iter()
            .map(|&v| f32::from(v) / 255.0)
            .collect(),
    };
    let mask = rilievo_io::read_mask(&folder.join("mask.png"))?;
    let mut depth = rilievo_io::read_depth(&folder.join("depth.exr"))?;
    if std::env::args().nth(2).as_deref() == Some("column-major") {
        let stored = depth.data.clone();
        depth = DepthMap::from_fn(width, height, |x, y| stored[x * height + y]);
    }
    let intrinsics = Intrinsics {
        fy: k(1, 1),
        ..Intrinsics::pinhole(width, height, k(0, 0), k(0, 2), k(1, 2))
    };

    // Normals of the rough depth by central differences, and a least-squares fit per channel.
    let mut normal_matrix = SMatrix::<f64, 9, 9>::zeros();
    let mut right = [SVector::<f64, 9>::zeros(); 3];
    // Half the window, pixels.
    let w = 3_usize;
    for y in 1..height - 1 {
        for x in 1..width - 1 {
            let z = |x: usize, y: usize| f64::from(*depth.at(x, y));
            // Slopes of a plane fitted over a window: single differences of a depth in whole
            // millimetres are mostly noise.
            let (mut sx, mut sy, mut squares) = (0.0, 0.0, 0.0);
            let mut complete = x >= w && y >= w && x + w < width && y + w < height;
            for dy in -(w as isize)..=w as isize {
                for dx in -(w as isize)..=w as isize {
                    let (i, j) = (x as isize + dx, y as isize + dy);
                    complete &= mask.contains(i, j) && depth.get(i, j).is_some_and(|&z| z > 0.0);
                    if complete {
                        let l = z(i as usize, j as usize).ln();
                        sx += dx as f64 * l;
                        sy += dy as f64 * l;
                        squares += (dx * dx) as f64;
                    }
                }
            }
            if !complete {
                continue;
            }
            let (p, q) = (intrinsics.fx * sx / squares, intrinsics.fy * sy / squares);
            let (u, v) = (
                (x as f64 - intrinsics.cx) / intrinsics.fx,
                (y as f64 - intrinsics.cy) / intrinsics.fy,
            );
            let n = Vector3::new(p, q, -1.0 - u * p - v * q).normalize();
            let h = SVector::<f64, 9>::from(SphericalHarmonics::basis(&n));
            normal_matrix += h * h.transpose();
            for (c, right) in right.iter_mut().enumerate() {
                *right += h * f64::from(image.pixel(x, y)[c]);
            }
        }
    }
    let solver = normal_matrix
        .cholesky()
        .ok_or("the lighting is not determined")?;
    let lighting = Lighting {
        channels: right
            .iter()
            .map(|right| SphericalHarmonics(solver.solve(right).into()))
            .collect(),
    };

    let mut view = ShadingView::new(
        "image",
        Arc::new(image),
        mask,
        intrinsics,
        ViewLight::Uniform(lighting),
    );
    view.prior = Some(DepthPrior {
        depth,
        weight: 500.0,
    });
    let options = PaperOptions {
        area_weight: 0.05,
        ..PaperOptions::default()
    };
    let begun = std::time::Instant::now();
    let problem = ShadingProblem {
        views: vec![view],
        matches: Vec::new(),
    };
    let solution = solve(&problem, &options, &Silent)?;
    let facts = &solution.report.views[0];
    println!(
        "energy {:.1}: shading {:.1}, prior {:.1}, area {:.1}; {:.2} s, {} iterations",
        facts.energy_shading + facts.energy_prior + facts.energy_area,
        facts.energy_shading,
        facts.energy_prior,
        facts.energy_area,
        begun.elapsed().as_secs_f64(),
        facts.iterations.len()
    );
    Ok(())
}
