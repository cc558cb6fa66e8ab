//! Large colour views: one starts from 400 anchors; several stand side by side before the same
//! relief and are tied by 300 matches between neighbours.

use crate::{Failure, system};
use nalgebra::{Point3, Rotation3, Vector3};
use rilievo_scene::{Intrinsics, Lighting, Mask, RigidTransform, Silent, SphericalHarmonics};
use rilievo_shading::paper::{
    DepthAnchor, PaperOptions, ShadingProblem, ShadingView, ViewLight, ViewMatches, solve,
};
use rilievo_synthetic::testing::{PAPER_LIGHT, painted};
use std::sync::Arc;

#[derive(clap::Args)]
pub struct Arguments {
    #[arg(default_value_t = 12.0)]
    megapixels: f64,
    #[arg(long, default_value_t = 1)]
    views: usize,
}

/// Waves per frame height.
const WAVES: f64 = 12.0;
/// Step between cameras, in distances to the relief: ten degrees of triangulation.
const BASELINE: f64 = 0.17;

/// A relief around `z = 1`, and cameras along the x axis that look along z.
struct Relief {
    width: usize,
    height: usize,
    focal: f64,
}

impl Relief {
    fn new(megapixels: f64) -> Self {
        let height = (megapixels * 1e6 * 0.75).sqrt() as usize;
        let width = height * 4 / 3;
        Self {
            width,
            height,
            focal: 1.2 * width as f64,
        }
    }

    fn camera(&self) -> Intrinsics {
        let (cx, cy) = (self.width as f64 / 2.0, self.height as f64 / 2.0);
        Intrinsics::pinhole(self.width, self.height, self.focal, cx, cy)
    }

    /// Height above the camera plane, and its slopes, at world `x, y`.
    fn surface(&self, x: f64, y: f64) -> (f64, [f64; 2]) {
        let wave = self.height as f64 / WAVES / self.focal;
        let (sx, cx) = (x / wave).sin_cos();
        let (sy, cy) = (0.8 * y / wave).sin_cos();
        (1.0 + 0.5 * wave * sx * cy, [0.5 * cx * cy, -0.4 * sx * sy])
    }

    fn center(view: usize) -> f64 {
        BASELINE * view as f64
    }

    /// Depth and normal that a view sees at a pixel.
    fn seen(&self, view: usize, x: f64, y: f64) -> (f64, Vector3<f64>) {
        let camera = self.camera();
        let (u, v) = ((x - camera.cx) / self.focal, (y - camera.cy) / self.focal);
        let mut z = 1.0;
        // Newton's method along the ray; slopes along it are far below 1.
        for _ in 0..6 {
            let (wanted, [sx, sy]) = self.surface(Self::center(view) + u * z, v * z);
            z -= (z - wanted) / (1.0 - sx * u - sy * v);
        }
        let (_, [sx, sy]) = self.surface(Self::center(view) + u * z, v * z);
        (z, Vector3::new(sx, sy, -1.0).normalize())
    }

    fn view(&self, index: usize) -> ShadingView {
        let rows = PAPER_LIGHT.map(SphericalHarmonics);
        let image = painted(&self.camera(), 0.0, |[x, y]| {
            let (_, n) = self.seen(index, x, y);
            Some(rows.map(|row| row.evaluate(&n)))
        });
        let mut view = ShadingView::new(
            format!("view{index}"),
            Arc::new(image),
            Mask::filled(self.width, self.height, true),
            self.camera(),
            ViewLight::Uniform(Lighting {
                channels: rows.to_vec(),
            }),
        );
        view.cam_from_world = Some(RigidTransform::from_world_pose(
            Rotation3::identity(),
            Point3::new(Self::center(index), 0.0, 0.0),
        ));
        view
    }

    /// `num` pixels spread over the frame.
    fn spread(&self, num: usize) -> impl Iterator<Item = [f64; 2]> + '_ {
        (0..num).map(move |k| {
            let share = |step: usize| 0.02 + 0.96 * ((k * step + 13) % num) as f64 / num as f64;
            [
                share(197) * self.width as f64,
                share(71) * self.height as f64,
            ]
        })
    }

    fn anchors(&self) -> Vec<DepthAnchor> {
        self.spread(400)
            .map(|pixel| DepthAnchor {
                pixel,
                depth: self.seen(0, pixel[0], pixel[1]).0,
                sigma_ln_depth: 0.5 / self.focal,
            })
            .collect()
    }

    /// Points of a view where the next one sees them.
    fn matches(&self, first: usize) -> ViewMatches {
        let pixels = self
            .spread(300)
            .filter_map(|[x, y]| {
                let (z, _) = self.seen(first, x, y);
                let moved = x - self.focal * BASELINE / z;
                (moved > 1.0).then_some([x, y, moved, y])
            })
            .collect();
        ViewMatches {
            views: [first, first + 1],
            pixels,
        }
    }
}

pub fn measure(arguments: &Arguments) -> Result<(), Failure> {
    let relief = Relief::new(arguments.megapixels);
    let num_views = arguments.views;
    let mut problem = ShadingProblem {
        views: (0..num_views).map(|index| relief.view(index)).collect(),
        matches: (1..num_views)
            .map(|index| relief.matches(index - 1))
            .collect(),
    };
    if let [only] = problem.views.as_mut_slice() {
        only.anchors = relief.anchors();
    }
    let solution = solve(&problem, &PaperOptions::default(), &Silent)?;
    let mut total = 0.0;
    for (index, (view, facts)) in solution
        .views
        .iter()
        .zip(&solution.report.views)
        .enumerate()
    {
        let (mut angles, mut away, mut count) = (0.0, 0.0, 0);
        for y in (0..relief.height).step_by(7) {
            for x in (0..relief.width).step_by(7) {
                let (depth, truth) = relief.seen(index, x as f64, y as f64);
                if let Some(n) = view.normal.normal(x, y) {
                    angles += n.angle(&truth).to_degrees();
                    away += (f64::from(*view.depth.at(x, y)) / depth - 1.0).abs();
                    count += 1;
                }
            }
        }
        let (seconds, count) = (&facts.seconds, f64::from(count.max(1)));
        total += seconds.total;
        println!(
            "{} {}x{}: {:.1} s (start {:.1}, theta {:.1}, z {:.1}), mean angle {:.3} deg, depth {:.4} %",
            view.name,
            relief.width,
            relief.height,
            seconds.total,
            seconds.start,
            seconds.theta,
            seconds.z,
            angles / count,
            100.0 * away / count,
        );
    }
    let peak = system::peak_memory().map_or(f64::NAN, |bytes| bytes as f64 / 1e6);
    println!("{num_views} view(s): {total:.1} s, peak {peak:.0} MB");
    Ok(())
}
