//! Anchors against true depth.
//!
//! Printed: anchors a view, share of the mask within 20 px of one, outliers (more than 3 px in the
//! nearest views or 1 % of depth), depth errors after one scale, and the ratio of the 68th
//! percentile of |error| to the predicted deviation in quintiles of the prediction.

use crate::data_set::Set;
use crate::growth::{mean, quantile};
use crate::{Failure, system};
use nalgebra::{Point2, Point3};
use rilievo_poses::anchors::{AnchorOptions, find};
use rilievo_scene::{AnchorObservation, PosedView, PosedViews, Raster, Silent};
use std::path::PathBuf;

#[derive(clap::Args)]
pub struct Arguments {
    /// A data set
    set: PathBuf,
    /// Names of the views to use; all by default
    #[arg(long, value_delimiter = ',')]
    views: Vec<String>,
    /// Takes `linear/NAME.png` for the photos
    #[arg(long)]
    linear: bool,
    /// Options as JSON
    #[arg(long, default_value = "{}")]
    options: String,
    /// The poses of a run, its `3_poses/posed_views.json`, for the true ones
    #[arg(long)]
    poses: Option<PathBuf>,
    /// Step to which alone the true depth is known, metres
    #[arg(long, default_value_t = 0.0)]
    truth_step: f64,
}

/// Replaces the true poses by those of a run, matched by file name.
fn use_poses(posed: &mut PosedViews, run: &PosedViews) -> Result<(), Failure> {
    for view in &mut posed.views {
        let mut others = run.views.iter();
        let found = others.find(|other| other.file_name == view.file_name);
        let found = found.ok_or_else(|| format!("no pose of {}", view.file_name))?;
        view.cam_from_world = found.cam_from_world;
        view.intrinsics = found.intrinsics;
    }
    if posed.views.len() == run.views.len() {
        posed.points = run.points.clone();
    }
    Ok(())
}

/// True depth at a sub-pixel position, bilinear away from depth edges.
fn true_depth(depth: &Raster<f32>, [x, y]: [f64; 2]) -> Option<f64> {
    let near = f64::from(*depth.get(x.round() as isize, y.round() as isize)?);
    if near <= 0.0 {
        return None;
    }
    let (x0, y0) = (x.floor(), y.floor());
    let (fx, fy) = (x - x0, y - y0);
    let mut sum = 0.0;
    for (u, v, w) in [
        (0, 0, (1.0 - fx) * (1.0 - fy)),
        (1, 0, fx * (1.0 - fy)),
        (0, 1, (1.0 - fx) * fy),
        (1, 1, fx * fy),
    ] {
        let z = depth.get(x0 as isize + u, y0 as isize + v);
        let z = z.map_or(0.0, |&z| f64::from(z));
        if z <= 0.0 || (z / near - 1.0).abs() > 0.004 {
            return Some(near);
        }
        sum += w * z;
    }
    Some(sum)
}

/// Median over the three nearest views of the distance between the pixels of an observation's true
/// and found point.
fn distance_px(views: &[PosedView], o: &AnchorObservation, true_depth: f64) -> f64 {
    let own = &views[o.view.0];
    let at = |depth: f64| {
        let in_camera = own.intrinsics.unproject(&Point2::from(o.pixel), depth);
        own.cam_from_world.inverse().apply(&in_camera)
    };
    let (found, right) = (at(o.depth), at(true_depth));
    let towards = |view: &PosedView| view.cam_from_world.center_in_source() - right;
    let others = views.iter().enumerate().filter(|(j, _)| *j != o.view.0);
    let mut near: Vec<(f64, f64)> = others
        .filter_map(|(_, view)| {
            let project = |p: &Point3<f64>| view.intrinsics.project(&view.cam_from_world.apply(p));
            let distance = (project(&found)? - project(&right)?).norm();
            Some((towards(own).angle(&towards(view)), distance))
        })
        .collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut nearest: Vec<f64> = near.iter().take(3).map(|n| n.1).collect();
    quantile(&mut nearest, 0.5)
}

pub fn measure(arguments: &Arguments) -> Result<(), Failure> {
    let mut set = Set::load(&arguments.set, arguments.linear, &arguments.views)?;
    set.clip(0.99);
    if let Some(path) = &arguments.poses {
        use_poses(
            &mut set.posed,
            &serde_json::from_slice(&std::fs::read(path)?)?,
        )?;
    }
    let options: AnchorOptions = serde_json::from_str(&arguments.options)?;
    let (before, clock) = (system::cpu_seconds(), std::time::Instant::now());
    let (anchors, report) = find(&set.photos, &set.posed, &options, None, &Silent)?;
    let (cpu, wall) = (
        system::cpu_seconds() - before,
        clock.elapsed().as_secs_f64(),
    );

    let views = &set.posed.views;
    let depths = views.iter().map(|view| set.true_depth(&view.name));
    let depths = depths.collect::<Result<Vec<_>, _>>()?;
    let observations = anchors.iter().flat_map(|anchor| &anchor.observations);
    let observations: Vec<(&AnchorObservation, Option<f64>)> = observations
        .map(|o| (o, true_depth(&depths[o.view.0], o.pixel)))
        .collect();
    let ratios = observations
        .iter()
        .filter_map(|(o, z)| Some(o.depth / (*z)?));
    let scale = quantile(&mut ratios.collect::<Vec<_>>(), 0.5);
    // Errors with the deviation that was predicted; the truth's own is part of it.
    let good: Vec<(f64, f64)> = observations
        .iter()
        .filter_map(|&(o, z)| {
            let z = z?;
            let error = (o.depth / z / scale - 1.0).abs();
            let of_truth = arguments.truth_step / 12.0_f64.sqrt() / z;
            let is_good = error <= 0.01 && distance_px(views, o, z * scale) <= 3.0;
            is_good.then_some((o.sigma_ln_depth.hypot(of_truth), error))
        })
        .collect();
    let mut errors: Vec<f64> = good.iter().map(|g| g.1).collect();
    let mut scores = good;
    scores.sort_by(|a, b| a.0.total_cmp(&b.0));
    let quintiles = scores.chunks(scores.len().div_ceil(5).max(1)).map(|chunk| {
        let mut z: Vec<f64> = chunk.iter().map(|(sigma, error)| error / sigma).collect();
        format!("{:.2}", quantile(&mut z, 0.6827))
    });
    let coverage: Vec<f64> = report.views.iter().filter_map(|v| v.coverage).collect();
    let of_view = |v| observations.iter().filter(|(o, _)| o.view.0 == v).count();
    let counts: Vec<usize> = (0..views.len()).map(of_view).collect();
    let megapixels = depths.iter().map(|d| d.data.len()).sum::<usize>() as f64 / 1e6;
    println!(
        "{}: {} anchors (noise factor {:.1}), per view {:.0} {counts:?}, coverage {:.3}, outliers {:.2} %, depth {:.4}/{:.4} %, scale {scale:.5}, error/sigma [{}], cpu {cpu:.2} s = {:.2} s/Mpx/view, wall {wall:.2} s",
        arguments.set.display(),
        anchors.len(),
        report.noise_factor.unwrap_or(f64::NAN),
        observations.len() as f64 / views.len() as f64,
        mean(&coverage),
        100.0 * (1.0 - errors.len() as f64 / observations.len().max(1) as f64),
        100.0 * quantile(&mut errors, 0.5),
        100.0 * quantile(&mut errors, 0.9),
        quintiles.collect::<Vec<_>>().join(" "),
        cpu / megapixels,
    );
    Ok(())
}
