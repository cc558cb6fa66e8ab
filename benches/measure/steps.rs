//! Nanoseconds per pixel of a whole solve's θ- and z-steps, and the z-step's time over that of
//! reading and writing its fields once per sweep at copy bandwidth.

use crate::Failure;
use rilievo_numerics::corner_grid::CornerGrid;
use rilievo_numerics::corner_poisson::CornerPoisson;
use rilievo_scene::{DepthMap, Intrinsics, Lighting, Mask, Silent, SphericalHarmonics};
use rilievo_shading::paper::{PaperOptions, ShadingProblem, ShadingView, ViewLight, solve};
use rilievo_synthetic::testing::{PAPER_LIGHT, painted};
use std::hint::black_box;
use std::sync::Arc;
use std::time::Instant;

/// Side of the square image: 400² = 160 000 pixels, the size of the paper's objects.
const SIZE: usize = 400;

fn problem() -> ShadingProblem {
    let rows = PAPER_LIGHT.map(SphericalHarmonics);
    let centre = SIZE as f64 / 2.0;
    let camera = Intrinsics::pinhole(SIZE, SIZE, 3.0 * SIZE as f64, centre, centre);
    let image = painted(&camera, 0.0, |[x, y]| {
        let (p, q) = ((x / 23.0).sin(), 0.7 * (y / 31.0).cos());
        let n = nalgebra::Vector3::new(p, q, -1.0).normalize();
        Some(rows.map(|row| row.evaluate(&n)))
    });
    let channels = rows.to_vec();
    let mut view = ShadingView::new(
        "bench",
        Arc::new(image),
        Mask::filled(SIZE, SIZE, true),
        camera,
        ViewLight::Uniform(Lighting { channels }),
    );
    view.initial_depth = Some(DepthMap::filled(SIZE, SIZE, 1.0));
    ShadingProblem {
        views: vec![view],
        matches: Vec::new(),
    }
}

/// Shortest of some runs, seconds.
fn shortest(num_runs: usize, mut run: impl FnMut()) -> f64 {
    let one = |_| {
        let begun = Instant::now();
        run();
        begun.elapsed().as_secs_f64()
    };
    (0..num_runs).map(one).fold(f64::INFINITY, f64::min)
}

/// Bytes per second of a copy of 256 MiB, read and write counted.
fn copy_bandwidth() -> f64 {
    let source = vec![1.0_f32; 1 << 26];
    let mut target = vec![0.0_f32; 1 << 26];
    let seconds = shortest(3, || {
        target.copy_from_slice(black_box(&source));
        black_box(&mut target);
    });
    8.0 * source.len() as f64 / seconds
}

pub fn measure() -> Result<(), Failure> {
    let (problem, options) = (problem(), PaperOptions::default());
    let bandwidth = copy_bandwidth();
    let solution = solve(&problem, &options, &Silent)?;
    let facts = &solution.report.views[0];
    // Pixel-iterations over all levels.
    let sizes = facts
        .iterations
        .iter()
        .map(|i| 0.25_f64.powi(i.level as i32));
    let work = (SIZE * SIZE) as f64 * sizes.sum::<f64>();
    println!(
        "theta-step {:.1} ns, z-step {:.1} ns per pixel and iteration; copy {:.1} GB/s",
        1e9 * facts.seconds.theta / work,
        1e9 * facts.seconds.z / work,
        bandwidth / 1e9
    );
    let solving = shortest(10, || {
        black_box(solve(&problem, &options, &Silent).is_ok());
    });
    println!("160 000 pixels in colour: {solving:.3} s");

    let grid = CornerGrid::new(&Mask::filled(2000, 1000, true)).ok_or("no grid")?;
    let mut system = CornerPoisson::new(&grid, &vec![1.0; grid.num_cells], 0.01);
    let rhs: Vec<f32> = (0..grid.padded_len())
        .map(|i| ((i * 7919) % 13) as f32 - 6.0)
        .collect();
    let mut x = vec![0.0; grid.padded_len()];
    let begun = Instant::now();
    let info = system.solve(&rhs, &mut x, 1e-12, 5);
    let seconds = begun.elapsed().as_secs_f64() / info.num_iterations.max(1) as f64;
    // Per conjugate-gradient step the finest level is swept seven times (two residuals, two Jacobi,
    // restriction, prolongation, product) over three fields each, coarse levels of two families add
    // two thirds, and vectors five more sweeps over two fields.
    let bytes = 4.0 * grid.padded_len() as f64 * (7.0 * 3.0 * (1.0 + 2.0 / 3.0) + 5.0 * 2.0);
    println!(
        "z-step on 2 M pixels: {:.1} ms a step, {:.2} times the bandwidth bound of its sweeps",
        1e3 * seconds,
        seconds * bandwidth / bytes
    );
    Ok(())
}
