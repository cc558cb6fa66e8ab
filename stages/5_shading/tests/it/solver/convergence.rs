//! How fast errors fall as pixels shrink: the discretisation alone, and the whole solver.

use super::analytic::{RADIUS, SHAPES, Seen};
use super::solved;
use rilievo_numerics::corner_grid::CornerGrid;
use rilievo_numerics::corner_poisson::CornerPoisson;
use rilievo_shading::paper::PaperOptions;

/// Errors over all pixels of the mask, over its inner half, and within two pixels of its edge.
#[derive(Clone, Copy, Debug, Default)]
struct Errors {
    all: f64,
    inner: f64,
    edge: f64,
}

/// Root mean squares of an error per pixel.
fn rms(seen: &Seen, errors: impl Iterator<Item = ((usize, usize), f64)>) -> Errors {
    let centre = (seen.size as f64 - 1.0) / 2.0;
    let mut sums = [(0.0, 0); 3];
    for ((x, y), error) in errors {
        let to_edge = RADIUS * seen.size as f64 - (x as f64 - centre).hypot(y as f64 - centre);
        for (sum, counted) in sums.iter_mut().zip([
            true,
            to_edge > 0.3 * RADIUS * seen.size as f64,
            to_edge < 2.0,
        ]) {
            if counted {
                sum.0 += error * error;
                sum.1 += 1;
            }
        }
    }
    let [all, inner, edge] = sums.map(|(sum, count)| (sum / f64::from(count)).sqrt());
    Errors { all, inner, edge }
}

/// Slopes known exactly at the pixels, integrated: relative depth and slopes against the truth.
fn integrated(seen: &Seen) -> (Errors, Errors) {
    let grid = CornerGrid::new(&seen.mask()).expect("a mask");
    let len = grid.num_cells.next_multiple_of(16);
    let (mut p, mut q) = (vec![0.0_f32; len], vec![0.0_f32; len]);
    for (k, (x, y)) in grid.pixels().enumerate() {
        [p[k], q[k]] = seen.slopes(x as f64, y as f64).map(|s| s as f32);
    }
    let mut system = CornerPoisson::new(&grid, &vec![1.0; grid.num_cells], 0.01);
    let mut rhs = vec![0.0; grid.padded_len()];
    grid.add_divergence(1.0, &p, &q, &mut rhs);
    let mut nodes = vec![0.0; grid.padded_len()];
    for _ in 0..20 {
        system.solve(&rhs, &mut nodes, 1e-6, 20);
    }
    let (mut gp, mut gq, mut values) = (p.clone(), q.clone(), p.clone());
    grid.gradient(&nodes, &mut gp, &mut gq);
    grid.values(&nodes, &mut values);
    let slopes = rms(
        seen,
        grid.pixels()
            .enumerate()
            .map(|(k, pixel)| (pixel, f64::from((gp[k] - p[k]).hypot(gq[k] - q[k])))),
    );
    let away: Vec<f64> = grid
        .pixels()
        .zip(&values)
        .map(|((x, y), &v)| f64::from(v) / seen.focal() - seen.at(x as f64, y as f64).0.z.ln())
        .collect();
    let mean = away.iter().sum::<f64>() / away.len() as f64;
    let depth = rms(seen, grid.pixels().zip(away.iter().map(|a| a - mean)));
    (slopes, depth)
}

/// Asserts a least order between all resolutions.
fn assert_order(what: &str, errors: &[f64], least: f64) {
    let orders: Vec<f64> = errors.windows(2).map(|w| (w[0] / w[1]).log2()).collect();
    println!("{what}: errors {errors:?}, orders {orders:.2?}");
    assert!(
        orders.iter().all(|&order| order >= least),
        "{what}: orders {orders:?} below {least}, errors {errors:?}"
    );
}

#[test]
fn integration_is_of_second_order_mask_edges_included() {
    for shape in SHAPES {
        let errors: Vec<(Errors, Errors)> = [24, 48, 96]
            .iter()
            .map(|&size| integrated(&Seen { shape, size }))
            .collect();
        let pick =
            |of: &dyn Fn(&(Errors, Errors)) -> f64| errors.iter().map(of).collect::<Vec<_>>();
        assert_order(&format!("{shape:?} depth"), &pick(&|e| e.1.all), 1.9);
        assert_order(
            &format!("{shape:?} depth at the edge"),
            &pick(&|e| e.1.edge),
            1.5,
        );
        assert_order(
            &format!("{shape:?} slopes inside"),
            &pick(&|e| e.0.inner),
            1.6,
        );
        // Slopes lose an order at the edge, where least squares are one-sided; the constant is small.
        assert_order(
            &format!("{shape:?} slopes at the edge"),
            &pick(&|e| e.0.edge),
            0.9,
        );
        let finest = errors[errors.len() - 1].0.edge;
        assert!(finest < 2e-4, "{shape:?}: {finest}");
    }
}

#[test]
fn the_solver_is_of_second_order_in_depth_and_exact_in_normals() {
    for shape in SHAPES {
        let (mut depths, mut edges) = (Vec::new(), Vec::new());
        for size in [48, 96, 192] {
            let seen = Seen { shape, size };
            let solution = solved(seen.view(), &PaperOptions::default());
            let view = &solution.views[0];
            let mask = seen.mask();
            let pixels: Vec<(usize, usize)> = (0..size * size)
                .map(|k| (k % size, k / size))
                .filter(|&(x, y)| *mask.at(x, y))
                .collect();
            let angle = rms(
                &seen,
                pixels.iter().map(|&(x, y)| {
                    let truth = seen.at(x as f64, y as f64).1;
                    let n = view.normal.normal(x, y).expect("a normal");
                    ((x, y), n.cross(&truth).norm().asin().to_degrees())
                }),
            );
            // Colours that no other slope has give normals whatever the size of the pixels.
            assert!(
                angle.all < 0.02 && angle.edge < 0.02,
                "{shape:?} {size}: {angle:?}"
            );
            let away: Vec<f64> = pixels
                .iter()
                .map(|&(x, y)| {
                    f64::from(*view.depth.at(x, y)).ln() - seen.at(x as f64, y as f64).0.z.ln()
                })
                .collect();
            // One image leaves the scale of depth free.
            let mean = away.iter().sum::<f64>() / away.len() as f64;
            let depth = rms(
                &seen,
                pixels.iter().copied().zip(away.iter().map(|a| a - mean)),
            );
            depths.push(depth.all);
            edges.push(depth.edge);
        }
        assert_order(&format!("{shape:?} depth"), &depths, 1.9);
        assert_order(&format!("{shape:?} depth at the edge"), &edges, 1.5);
    }
}
